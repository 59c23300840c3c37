//! Fit of shapes, radiances and albedos together.
//!
//! The photo is `I_p = A_s(p) sum_k w_k u_k(p; theta)`, as in `radiance_fit`, with the unit layer
//! of a lobe `u = V E(theta) + J S(theta) / S(start)`. Visibility V and the form of the indirect
//! light J are held; the indirect light grows with the mean of the arriving light, S = sum over p
//! of V E. Its derivatives are closed forms. Radiances and albedos are eliminated (variable
//! projection, Golub and Pereyra 1973): with Z and W the derivatives of the model with respect to
//! theta and w after the albedos are eliminated, a step solves
//!
//!   (Z'Z - Z'W (W'W)^-1 W'Z + P + damping) step = Z'r - P offset,
//!
//! under Cauchy weights, with the prior P centered at the start (Levenberg 1944, Marquardt 1963).
//! Steps that do not lower the loss are shortened. Then shadows and bounces are traced again at the
//! new shapes, and their loss decides: a light whose move gains too little returns to its start.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::candidates::in_view;
use super::conditioning::{Conditioning, conditioning};
use super::fit_problem::{FIT_PROBLEM, Problem, scales};
use super::parameters::{DegreesOfFreedom, Parameter, parameters};
use super::{Column, LayerQuality, LightPrior, Receivers, Role, UnitLayer};
use crate::geometry::{Camera, RoomLayout};
use crate::image::Mask;
use crate::optics::nnls::solve_free;
use crate::optics::{Emitter, Gradient, Shape};
use crate::tuning::tuning;

/// A light whose shape is a variable of the fit.
pub struct LightVariable<'a> {
    /// Shape at the start of the fit.
    pub shape: Shape,
    /// Its pixels, if it is visible; of the photo's size.
    pub mask: Option<&'a Mask>,
    /// Free parameters of the shape.
    pub freedom: DegreesOfFreedom,
    /// True if the photo shows it; it selects the [`Role`] of its lobes.
    pub in_view: bool,
}

/// Bounds of the lights' positions.
pub struct Bounds<'a> {
    /// Camera of the photo.
    pub camera: &'a Camera,
    /// Box that positions stay in, if the points determine one.
    pub room: Option<&'a RoomLayout>,
}

/// Settings of [`fit_shapes`].
#[derive(Clone, Copy, Debug)]
pub struct ShapeSearch {
    /// Quality of each light's layer.
    pub quality: LayerQuality,
    /// Most times that shadows and bounces are traced again.
    pub rounds: usize,
    /// Most steps between two of these.
    pub steps: usize,
    /// Fraction of the first loss that the move of a light must save, in 0..1.
    pub min_gain: f64,
    /// Prior of the radiances.
    pub prior: LightPrior,
}

/// Result of [`fit_shapes`].
#[derive(Clone, Debug)]
pub struct ShapeFit {
    /// One shape per light; a light whose move gained too little keeps its shape to the bit.
    pub shapes: Vec<Shape>,
    /// Increase of the loss if each light alone returned to its start, as a fraction of the first
    /// loss; 0 where it stays.
    pub saved: Vec<f64>,
    /// Robust misfit and L1 costs, as a fraction of the photo's energy, before and after.
    pub loss: [f64; 2],
    /// Index of the light, and name, of each parameter.
    pub parameters: Vec<(usize, String)>,
    /// Conditioning of the parameters, at the first shapes.
    pub conditioning: Conditioning,
    /// Parameters whose data curvature is below the prior's.
    pub underdetermined: Vec<usize>,
}

tuning! {
    /// Constants of the fit of shapes.
    pub const TUNING: ShapeFitTuning {
        /// Cost of moving a parameter by its likely error. Model errors lie in patches, and a light
        /// that starts right can lower them by several percent: the prior prevents that move.
        prior_weight: f64 = 0.05,
            unit "fraction of the first loss", source Measured("tests/scenes/small"),
            effect "a larger value moves lights less";
        /// Least loss by which moves are measured: smaller ones (3 % of the photo's light) are
        /// noise of the rays.
        noise_loss: f64 = 1e-3,
            unit "fraction of the photo's energy", source Measured("no page records it"),
            effect "a larger value moves lights less";
        /// Longest step of a parameter: derivatives hold no farther.
        longest_step: f64 = 1.0,
            unit "likely errors", source Taste, effect "a larger value converges faster or fails";
        /// Iterations of the radiances from an equal start.
        cold_iterations: usize = 16,
            unit "iterations", source Measured("no page records it"),
            effect "a larger value is slower and more exact";
        /// Iterations of the radiances from the last radiances after a step.
        warm_iterations: usize = 4,
            unit "iterations", source Measured("no page records it"),
            effect "a larger value is slower and more exact";
        /// Damping at first, its factors after a good and a bad step, and its end.
        damping: [f64; 4] = [0.03, 0.2, 5.0, 1e4],
            unit "1", source Paper("Marquardt 1963"), effect "another value changes the speed of convergence";
        /// Ridge on the radiances where they are eliminated: the gauge makes their equations
        /// singular.
        ridge: f64 = 1e-6,
            unit "fraction of the diagonal", source Derived("rounding of 64 bits"),
            effect "a larger value leaves more of the radiances in the steps of shapes";
        /// Relative gain of a step below which the descent ends.
        min_gain: f64 = 1e-3,
            unit "fraction of the loss", source Taste, effect "a smaller value takes more steps";
        /// Largest ratio of the distances of a visible light before and after its move.
        max_distance_ratio: f32 = 1.6,
            unit "1", source Taste, effect "a larger value lets lights move farther";
        /// Largest ratio of the sizes of a light out of view before and after its move.
        max_size_ratio: f32 = 3.0,
            unit "1", source Taste, effect "a larger value lets lights grow and shrink more";
        /// Largest distance of a light outside of the room, unless it started there.
        max_outside: f32 = 0.35,
            unit "fraction of the room", source Taste, effect "a larger value lets lights move farther";
    }
}

impl Bounds<'_> {
    fn hold(&self, start: &Shape, shape: &Shape, freedom: DegreesOfFreedom) -> bool {
        let (Some((from, before)), Some((to, now))) =
            (start.bounding_sphere(), shape.bounding_sphere())
        else {
            return true;
        };
        if !(to.is_finite() && now.is_finite()) {
            return false;
        }
        let within = |ratio: f32, most: f32| (1.0 / most..=most).contains(&ratio);
        // Sun, sky and ground shine from outside, if they did at the start.
        let outside = |shape: &Shape| match shape {
            Shape::Window(w) => {
                w.lobes.each_ref().map(|lobe| lobe.direction.dot(w.x.cross(w.y)) < 0.0)
            }
            _ => [true; 3],
        };
        let through = outside(start).iter().zip(outside(shape)).all(|(before, now)| now || !before);
        let traced = match freedom {
            DegreesOfFreedom::Fixed => true,
            DegreesOfFreedom::InView => {
                within(to.length() / from.length(), TUNING.max_distance_ratio)
            }
            DegreesOfFreedom::OutOfView => {
                let out = |p: Vec3| self.room.map_or(0.0, |room| room.outside(p));
                let hidden = in_view(self.camera, from) || !in_view(self.camera, to);
                let same_side = (from.z < 0.0) == (to.z < 0.0);
                hidden
                    && same_side
                    && out(to) <= out(from).max(TUNING.max_outside)
                    && within(now / before, TUNING.max_size_ratio)
            }
        };
        through && traced
    }
}

/// A light with its traced layers.
#[derive(Clone)]
struct LightWithLayers {
    shape: Shape,
    layers: Vec<UnitLayer>,
    columns: Vec<Vec<Vec3>>,
}

impl LightWithLayers {
    fn new(shape: Shape, layers: Vec<UnitLayer>) -> LightWithLayers {
        LightWithLayers { columns: layers.iter().map(UnitLayer::sum).collect(), shape, layers }
    }

    /// Arriving light of a lobe, summed over the receivers.
    fn arriving(&self, lobe: usize, direct: impl Iterator<Item = f64>) -> f64 {
        direct.zip(&self.layers[lobe].lit).map(|(e, lit)| e * f64::from(*lit)).sum()
    }

    fn arriving_now(&self, lobe: usize) -> f64 {
        self.arriving(lobe, self.layers[lobe].direct.iter().map(|&e| f64::from(e)))
    }

    /// Columns of another shape, without new rays.
    fn columns_of(&self, shape: &Shape, positions: &[(Vec3, Vec3)]) -> Vec<Vec<Vec3>> {
        let emitter = Emitter::new(shape);
        let column = |lobe: usize| {
            let closed = |&(point, normal): &(Vec3, Vec3)| {
                emitter.irradiance(lobe, point, normal).unwrap_or(0.0)
            };
            let direct: Vec<f32> = positions.par_iter().with_min_len(64).map(closed).collect();
            let here = self.arriving_now(lobe);
            let arriving = self.arriving(lobe, direct.iter().map(|&e| f64::from(e)));
            let growth = if here > 0.0 { (arriving / here) as f32 } else { 0.0 };
            let UnitLayer { lit, indirect, .. } = &self.layers[lobe];
            (0..direct.len())
                .map(|p| indirect[p] * growth + Vec3::splat(direct[p] * lit[p]))
                .collect()
        };
        (0..self.layers.len()).map(column).collect()
    }

    /// Derivative of each lobe's column, per parameter.
    fn slopes(&self, parameters: &[Parameter], positions: &[(Vec3, Vec3)]) -> Vec<Vec<Vec<Vec3>>> {
        let emitter = Emitter::new(&self.shape);
        let pivot = self.shape.bounding_sphere().map_or(Vec3::ZERO, |(middle, _)| middle);
        let lobe = |lobe: usize| {
            let gradient =
                |&(point, normal): &(Vec3, Vec3)| emitter.gradient(lobe, point, normal, pivot);
            let gradients: Vec<Gradient> =
                positions.par_iter().with_min_len(64).map(gradient).collect();
            let here = self.arriving_now(lobe);
            let UnitLayer { lit, indirect, .. } = &self.layers[lobe];
            let slope = |parameter: &Parameter| {
                let direct: Vec<f64> =
                    gradients.iter().map(|g| parameter.rate(&self.shape, lobe, g)).collect();
                let arriving = self.arriving(lobe, direct.iter().copied());
                let growth = if here > 0.0 { (arriving / here) as f32 } else { 0.0 };
                (0..direct.len())
                    .map(|p| indirect[p] * growth + Vec3::splat(direct[p] as f32 * lit[p]))
                    .collect()
            };
            parameters.iter().map(slope).collect()
        };
        (0..self.layers.len()).map(lobe).collect()
    }
}

/// Radiances of some columns, and their loss.
#[derive(Clone)]
struct RadianceSolution {
    radiance: Vec<DVec3>,
    loss: f64,
}

struct ShapeProblem<'a> {
    receivers: &'a Receivers<'a>,
    lights: &'a [LightVariable<'a>],
    search: &'a ShapeSearch,
    positions: Vec<(Vec3, Vec3)>,
    /// Mean position of the receivers.
    lit: Vec3,
    /// Weight of the prior of shapes, as a fraction of the photo's energy.
    prior_weight: f64,
}

/// Normal equations of the parameters, with radiances and albedos eliminated; the photo's energy is
/// 1.
struct NormalEquations {
    gram: Vec<f64>,
    right: Vec<f64>,
}

/// Refines the shapes of lights. All shapes are returned as given where the photo is black or no
/// receiver is in use.
pub fn fit_shapes(
    receivers: &Receivers,
    lights: &[LightVariable],
    bounds: &Bounds,
    search: &ShapeSearch,
) -> ShapeFit {
    let positions = receivers.positions();
    let lit =
        positions.iter().map(|(point, _)| *point).sum::<Vec3>() / positions.len().max(1) as f32;
    let mut fit = ShapeProblem { receivers, lights, search, positions, lit, prior_weight: 0.0 };
    let trace = |light: &LightVariable, shape: &Shape| {
        LightWithLayers::new(shape.clone(), receivers.layers(shape, light.mask, search.quality))
    };
    let start: Vec<LightWithLayers> =
        lights.iter().map(|light| trace(light, &light.shape)).collect();
    let mut found = ShapeFit {
        shapes: lights.iter().map(|light| light.shape.clone()).collect(),
        saved: vec![0.0; lights.len()],
        loss: [0.0; 2],
        parameters: Vec::new(),
        conditioning: Conditioning::default(),
        underdetermined: Vec::new(),
    };
    if receivers.observations.photo.is_empty() || receivers.observations.white == 0.0 {
        return found;
    }
    let mut now = fit.solve_radiances(&columns_of(&start), None, TUNING.cold_iterations);
    found.loss = [now.loss; 2];
    let large = now.loss.max(TUNING.noise_loss);
    fit.prior_weight = TUNING.prior_weight * large;
    let mut traced = start.clone();
    for round in 0..search.rounds {
        let free = fit.parameters(&traced);
        let normal = fit.normal(&traced, &free, &now);
        if round == 0 {
            let n = free.len();
            found.conditioning = conditioning(&normal.gram, n);
            found.underdetermined =
                (0..n).filter(|i| normal.gram[i * n + i] < fit.prior_weight).collect();
            found.parameters =
                free.iter().map(|(light, parameter)| (*light, parameter.name())).collect();
        }
        let (shapes, stepped) = fit.descend(&traced, &now, (free, normal), bounds);
        let moved: Vec<usize> =
            (0..lights.len()).filter(|&i| shapes[i] != traced[i].shape).collect();
        if moved.is_empty() {
            break;
        }
        let mut tried = traced.clone();
        moved.iter().for_each(|&i| tried[i] = trace(&lights[i], &shapes[i]));
        let mut after = fit.solve_radiances(
            &columns_of(&tried),
            Some(&stepped.radiance),
            TUNING.warm_iterations,
        );
        let saved = fit.take_back(&start, &mut tried, &mut after, large);
        if fit.penalized_loss(&after, &tried) >= fit.penalized_loss(&now, &traced) {
            break;
        }
        (traced, now, found.saved) = (tried, after, saved);
        found.loss[1] = now.loss;
    }
    found.shapes = traced.into_iter().map(|light| light.shape).collect();
    found
}

fn columns_of(lights: &[LightWithLayers]) -> Vec<Vec<Vec3>> {
    lights.iter().flat_map(|light| light.columns.iter().cloned()).collect()
}

impl ShapeProblem<'_> {
    /// Takes back, light by light, each move that saves too little of the loss `large`: the new
    /// shadows may confirm one move and refute another. Returns the fraction that each move saves.
    fn take_back(
        &self,
        start: &[LightWithLayers],
        tried: &mut [LightWithLayers],
        after: &mut RadianceSolution,
        large: f64,
    ) -> Vec<f64> {
        let mut saved = vec![0.0; start.len()];
        for i in 0..start.len() {
            if tried[i].shape == start[i].shape {
                continue;
            }
            let with = self.penalized_loss(after, tried);
            let moved = std::mem::replace(&mut tried[i], start[i].clone());
            let without = self.solve_radiances(
                &columns_of(tried),
                Some(&after.radiance),
                TUNING.warm_iterations,
            );
            let share = (self.penalized_loss(&without, tried) - with) / large;
            if share < self.search.min_gain {
                *after = without;
            } else {
                (tried[i], saved[i]) = (moved, share);
            }
        }
        saved
    }

    fn parameters(&self, traced: &[LightWithLayers]) -> Vec<(usize, Parameter)> {
        let of = |(i, light): (usize, &LightWithLayers)| {
            parameters(&light.shape, self.lights[i].freedom, self.lit)
                .into_iter()
                .map(move |p| (i, p))
        };
        traced.iter().enumerate().flat_map(of).collect()
    }

    fn problem(&self, columns: &[Vec<Vec3>]) -> (Problem<'_>, Vec<f64>) {
        let roles = self.lights.iter().flat_map(|light| {
            (0..light.shape.lobes()).map(|lobe| Role::of_lobe(&light.shape, lobe, light.in_view))
        });
        let mut all: Vec<Column> =
            columns.iter().zip(roles).map(|(layer, role)| Column::new(role, layer)).collect();
        all.push(Column::new(Role::Ambient, &self.receivers.ambient));
        let scale = scales(all.iter());
        let observations = &self.receivers.observations;
        (
            Problem::new(
                observations,
                &all,
                &scale,
                &self.search.prior,
                f64::from(observations.white),
            ),
            scale,
        )
    }

    /// Radiances of the lobes and the ambient, from `start` or from equal contributions.
    fn solve_radiances(
        &self,
        columns: &[Vec<Vec3>],
        start: Option<&[DVec3]>,
        iterations: usize,
    ) -> RadianceSolution {
        let (problem, scale) = self.problem(columns);
        let lit = scale.iter().filter(|s| **s > 0.0).count().max(1);
        let share = |k: usize, s: f64| match start {
            _ if s == 0.0 => DVec3::ZERO,
            Some(start) => start[k] / s,
            None => DVec3::splat(1.0 / lit as f64),
        };
        let mut w: Vec<[f64; 3]> =
            scale.iter().enumerate().map(|(k, &s)| share(k, s).to_array()).collect();
        for _ in 0..iterations {
            problem.iterate(&mut w, FIT_PROBLEM.step_fraction);
        }
        let radiance = w.iter().zip(&scale).map(|(w, s)| DVec3::from_array(*w) * *s).collect();
        RadianceSolution { radiance, loss: problem.objective(&w) }
    }

    /// Loss and prior cost of the shapes.
    fn penalized_loss(&self, solution: &RadianceSolution, traced: &[LightWithLayers]) -> f64 {
        solution.loss + self.prior_cost(traced.iter().map(|light| &light.shape))
    }

    fn prior_cost<'s>(&self, shapes: impl Iterator<Item = &'s Shape>) -> f64 {
        let of = |(light, shape): (&LightVariable, &'s Shape)| -> f64 {
            let free = parameters(shape, light.freedom, self.lit);
            free.iter().map(|parameter| parameter.offset(&light.shape, shape).powi(2)).sum()
        };
        self.prior_weight * self.lights.iter().zip(shapes).map(of).sum::<f64>()
    }

    fn normal(
        &self,
        traced: &[LightWithLayers],
        free: &[(usize, Parameter)],
        now: &RadianceSolution,
    ) -> NormalEquations {
        let columns = columns_of(traced);
        let (problem, scale) = self.problem(&columns);
        let w: Vec<[f64; 3]> = now
            .radiance
            .iter()
            .zip(&scale)
            .map(|(w, s)| if *s > 0.0 { (*w / *s).to_array() } else { [0.0; 3] })
            .collect();
        // Per parameter, the derivative of the shading at the present radiances.
        let mut slopes: Vec<Vec<DVec3>> = Vec::new();
        let mut first = 0;
        for (i, light) in traced.iter().enumerate() {
            let own: Vec<Parameter> =
                free.iter().filter(|(j, _)| *j == i).map(|(_, p)| *p).collect();
            let lobes =
                if own.is_empty() { Vec::new() } else { light.slopes(&own, &self.positions) };
            for parameter in 0..own.len() {
                let sum = |p: usize| {
                    let parts = lobes.iter().enumerate();
                    parts
                        .map(|(k, lobe)| now.radiance[first + k] * lobe[parameter][p].as_dvec3())
                        .sum()
                };
                slopes.push((0..self.positions.len()).map(sum).collect());
            }
            first += light.layers.len();
        }
        let channels: Vec<NormalEquations> =
            (0..3).into_par_iter().map(|c| self.channel(&problem, &w, &slopes, c)).collect();
        let energy = problem.energy();
        let sum = |of: fn(&NormalEquations) -> &Vec<f64>| -> Vec<f64> {
            let mut sums = vec![0.0; of(&channels[0]).len()];
            channels.iter().for_each(|channel| {
                sums.iter_mut().zip(of(channel)).for_each(|(s, v)| *s += v / energy)
            });
            sums
        };
        NormalEquations { gram: sum(|normal| &normal.gram), right: sum(|normal| &normal.right) }
    }

    fn channel(
        &self,
        problem: &Problem,
        w: &[[f64; 3]],
        slopes: &[Vec<DVec3>],
        c: usize,
    ) -> NormalEquations {
        let (segment, segments) =
            (&self.receivers.observations.segment, self.receivers.observations.segments);
        let (columns, n) = (w.len(), slopes.len());
        // A light that is off stays off.
        let on: Vec<usize> = (0..columns).filter(|&k| w[k][c] > 0.0).collect();
        let size = n + on.len();
        let shading = problem.shading(w, c);
        let albedo = problem.albedo(&shading, c);
        let (residual, weight) = problem.residuals(&albedo, &shading, c);
        let row = |p: usize, row: &mut [f64]| {
            slopes.iter().zip(row.iter_mut()).for_each(|(slope, v)| *v = slope[p][c]);
            on.iter().zip(&mut row[n..]).for_each(|(&k, v)| *v = problem.layer[c][p * columns + k]);
        };
        let (mut norm, mut along, mut v) =
            (vec![0.0; segments], vec![0.0; segments * size], vec![0.0; size]);
        for (p, &s) in segment.iter().enumerate() {
            let s = s as usize;
            row(p, &mut v);
            norm[s] += weight[p] * shading[p] * shading[p];
            along[s * size..][..size]
                .iter_mut()
                .zip(&v)
                .for_each(|(a, v)| *a += weight[p] * v * shading[p]);
        }
        for (along, norm) in along.chunks_exact_mut(size.max(1)).zip(&norm) {
            along.iter_mut().for_each(|a| *a = if *norm > 0.0 { *a / norm } else { 0.0 });
        }
        let (mut all, mut right) = (vec![0.0; size * size], vec![0.0; n]);
        for (p, &s) in segment.iter().enumerate() {
            let s = s as usize;
            row(p, &mut v);
            v.iter_mut()
                .zip(&along[s * size..])
                .for_each(|(v, along)| *v = albedo[s] * (*v - along * shading[p]));
            right.iter_mut().zip(&v).for_each(|(r, v)| *r += weight[p] * v * residual[p]);
            for i in 0..size {
                let scaled = weight[p] * v[i];
                all[i * size..][..=i].iter_mut().zip(&v).for_each(|(sum, v)| *sum += scaled * v);
            }
        }
        let at = |i: usize, j: usize| all[i.max(j) * size + i.min(j)];
        // Elimination of the radiances: the Schur complement. The gauge makes their equations
        // singular, and a ridge selects the smallest solution.
        let m = on.len();
        let lights: Vec<f64> = (0..m * m)
            .map(|ij| (ij / m, ij % m))
            .map(|(i, j)| at(n + i, n + j) * if i == j { 1.0 + TUNING.ridge } else { 1.0 })
            .collect();
        let answers: Vec<Vec<f64>> = (0..n)
            .map(|i| {
                let b: Vec<f64> = (0..m).map(|k| at(n + k, i)).collect();
                solve_free(&lights, &b, &vec![true; m]).unwrap_or_else(|| vec![0.0; m])
            })
            .collect();
        let gram = (0..n * n)
            .map(|ij| (ij / n, ij % n))
            .map(|(i, j)| at(i, j) - (0..m).map(|k| at(n + k, i) * answers[j][k]).sum::<f64>());
        let gram: Vec<f64> = gram.collect();
        NormalEquations { gram, right }
    }

    /// Damped steps with visibility and the form of the indirect light held; returns the shapes and
    /// their radiances.
    fn descend(
        &self,
        traced: &[LightWithLayers],
        now: &RadianceSolution,
        (mut free, mut normal): (Vec<(usize, Parameter)>, NormalEquations),
        bounds: &Bounds,
    ) -> (Vec<Shape>, RadianceSolution) {
        let mut shapes: Vec<Shape> = traced.iter().map(|light| light.shape.clone()).collect();
        let mut here = traced.to_vec();
        let mut best = now.clone();
        let mut lowest = self.penalized_loss(now, traced);
        let [mut damping, good, bad, end] = TUNING.damping;
        for _ in 0..self.search.steps {
            let n = free.len();
            let offset = |i: usize| {
                let (light, parameter) = &free[i];
                parameter.offset(&self.lights[*light].shape, &shapes[*light])
            };
            let right: Vec<f64> =
                (0..n).map(|i| normal.right[i] - self.prior_weight * offset(i)).collect();
            let mut gram = normal.gram.clone();
            for i in 0..n {
                gram[i * n + i] +=
                    self.prior_weight + damping * (gram[i * n + i].max(0.0) + self.prior_weight);
            }
            let Some(step) = solve_free(&gram, &right, &vec![true; n]) else { break };
            let longest = step.iter().fold(TUNING.longest_step, |longest, s| longest.max(s.abs()));
            let mut tried = shapes.clone();
            for ((light, parameter), step) in free.iter().zip(&step) {
                tried[*light] =
                    parameter.moved(&tried[*light], step * TUNING.longest_step / longest);
            }
            for (i, light) in self.lights.iter().enumerate() {
                if !bounds.hold(&light.shape, &tried[i], light.freedom) {
                    tried[i] = shapes[i].clone();
                }
            }
            let columns: Vec<Vec<Vec3>> = traced
                .iter()
                .zip(&tried)
                .flat_map(|(light, shape)| {
                    if *shape == light.shape {
                        light.columns.clone()
                    } else {
                        light.columns_of(shape, &self.positions)
                    }
                })
                .collect();
            let after =
                self.solve_radiances(&columns, Some(&best.radiance), TUNING.warm_iterations);
            let loss = after.loss + self.prior_cost(tried.iter());
            if loss >= lowest || !loss.is_finite() {
                damping *= bad;
                if damping > end {
                    break;
                }
                continue;
            }
            let gain = (lowest - loss) / lowest;
            (shapes, best, lowest) = (tried, after, loss);
            if gain < TUNING.min_gain {
                break;
            }
            damping *= good;
            let mut columns = columns.into_iter();
            for (i, light) in here.iter_mut().enumerate() {
                light.columns = columns.by_ref().take(light.layers.len()).collect();
                light.shape = shapes[i].clone();
            }
            free = self.parameters(&here);
            normal = self.normal(&here, &free, &best);
        }
        (shapes, best)
    }
}

#[cfg(test)]
#[path = "shape_rooms.rs"]
mod shape_rooms;
