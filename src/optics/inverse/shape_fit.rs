//! Where lights are, to what the photo tells: shapes, radiances and albedos that explain it together.
//!
//! The photo is `I_p = A_s(p) sum_k w_k u_k(p; theta)`, as in `radiance_fit`, with the unit layer of a lobe
//! `u = V E(theta) + J S(theta) / S(start)`: visibility V and the form of the indirect light J are held, the indirect light grows with
//! the light that arrives in the mean, S = sum over p of V E. Its derivatives are closed forms. Radiances and albedos are
//! eliminated (variable projection, Golub and Pereyra 1973): with Z and W the derivatives of the model with respect to theta and w
//! that are left when the albedos have answered, a step solves
//!
//!   (Z'Z - Z'W (W'W)^-1 W'Z + P + damping) step = Z'r - P offset,
//!
//! under Cauchy weights, with the prior P pulling to the start (Levenberg 1944, Marquardt 1963). Steps that do not lower the loss
//! are shortened. Then shadows and bounces are traced again where the lights are now, and what they say decides: a light that
//! does not earn its move goes back to where it was.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::candidates::in_view;
use super::conditioning::{Conditioning, conditioning};
use super::parameters::{Freedom, Parameter, parameters};
use super::radiance_fit::{Problem, STEP, scales};
use crate::geometry::Camera;
use crate::image::Mask;
use crate::optics::nnls::solve_free;
use {
    super::Column, super::LayerQuality, super::Receivers, super::RoomBox, super::UnitLayer, crate::optics::Emitter,
    crate::optics::Gradient, crate::optics::Shape,
};

/// A light whose shape may be refined.
pub struct Movable<'a> {
    pub shape: Shape,
    /// Its pixels, if it is seen; of the photo's size.
    pub own: Option<&'a Mask>,
    pub freedom: Freedom,
    /// Per lobe, as [`Column::penalty`].
    pub penalty: Vec<f64>,
}

/// What lights must not leave.
pub struct Bounds<'a> {
    pub camera: &'a Camera,
    pub room: Option<RoomBox>,
}

/// How shapes are fitted.
#[derive(Clone, Copy, Debug)]
pub struct ShapeSearch {
    pub quality: LayerQuality,
    /// Most times that shadows and bounces are traced again.
    pub rounds: usize,
    /// Most steps tried between.
    pub steps: usize,
    /// Share of the loss that the move of a light must save.
    pub worth: f64,
    /// Cost of the constant ambient, as [`Column::penalty`].
    pub ambient_penalty: f64,
}

/// What was found.
#[derive(Clone, Debug)]
pub struct ShapeFit {
    /// One per light; where it did not earn a move, what was given, to the bit.
    pub shapes: Vec<Shape>,
    /// What the loss would grow by if each light alone went back, as a share of the first loss; 0 where it stays.
    pub saved: Vec<f64>,
    /// Robust misfit and penalties, as a share of the photo's energy, before and after.
    pub loss: [f64; 2],
    /// The light and name of each parameter.
    pub parameters: Vec<(usize, String)>,
    /// How well the parameters can be told apart, where the lights started.
    pub conditioning: Conditioning,
    /// Parameters of which the photo tells less than the prior knows.
    pub untold: Vec<usize>,
}

/// What it costs to move a parameter by its likely error, as a share of the first loss. What the model cannot explain lies in
/// patches, and a light that starts right can lower it by several percent: it must not be led astray for that.
const PRIOR: f64 = 0.05;

/// A loss below it (of 3 % of the photo's light) is that of the rays' own noise: it counts as this much.
const FLOOR: f64 = 1e-3;

/// Longest step of a parameter, in likely errors: derivatives hold no farther.
const LONGEST: f64 = 1.0;

/// Turns of the radiances from an even start, and from where they were before a step.
const FIRST_TURNS: usize = 16;
const TURNS: usize = 4;

/// Damping at first, its factors after a good and a bad step, and where it ends.
const DAMPING: [f64; 4] = [0.03, 0.2, 5.0, 1e4];

/// Steps that save less of the loss are the last ones.
const SETTLED: f64 = 1e-3;

/// How far a light may come: ratio of distances of one that is seen, of sizes of one that is not, and how far out of the room
/// (as a share of it, see [`RoomBox::outside`]) unless it started there.
const NEARER: f32 = 1.6;
const LARGER: f32 = 3.0;
const OUTSIDE: f32 = 0.35;

impl Bounds<'_> {
    fn hold(&self, start: &Shape, shape: &Shape, freedom: Freedom) -> bool {
        let (Some((from, before)), Some((to, now))) = (start.bounding_sphere(), shape.bounding_sphere()) else {
            return true;
        };
        if !(to.is_finite() && now.is_finite()) {
            return false;
        }
        let within = |ratio: f32, most: f32| (1.0 / most..=most).contains(&ratio);
        // Sun, sky and ground are seen from inside, if they were.
        let outside = |shape: &Shape| match shape {
            Shape::Window(w) => w.lobes.each_ref().map(|lobe| lobe.direction.dot(w.x.cross(w.y)) < 0.0),
            _ => [true; 3],
        };
        let through = outside(start).iter().zip(outside(shape)).all(|(before, now)| now || !before);
        let placed = match freedom {
            Freedom::Fixed => true,
            Freedom::Seen => within(to.length() / from.length(), NEARER),
            Freedom::Unseen => {
                let out = |p: Vec3| self.room.as_ref().map_or(0.0, |room| room.outside(p));
                let hidden = in_view(self.camera, from) || !in_view(self.camera, to);
                let same_side = (from.z < 0.0) == (to.z < 0.0);
                hidden && same_side && out(to) <= out(from).max(OUTSIDE) && within(now / before, LARGER)
            }
        };
        through && placed
    }
}

/// A light with its layers traced.
#[derive(Clone)]
struct Placed {
    shape: Shape,
    layers: Vec<UnitLayer>,
    columns: Vec<Vec<Vec3>>,
}

impl Placed {
    fn new(shape: Shape, layers: Vec<UnitLayer>) -> Placed {
        Placed { columns: layers.iter().map(UnitLayer::sum).collect(), shape, layers }
    }

    /// Light that arrives of a lobe, summed over the receivers.
    fn arriving(&self, lobe: usize, direct: impl Iterator<Item = f64>) -> f64 {
        direct.zip(&self.layers[lobe].lit).map(|(e, lit)| e * f64::from(*lit)).sum()
    }

    fn arriving_here(&self, lobe: usize) -> f64 {
        self.arriving(lobe, self.layers[lobe].direct.iter().map(|&e| f64::from(e)))
    }

    /// The columns for another shape, as far as they can be told without rays.
    fn columns_of(&self, shape: &Shape, places: &[(Vec3, Vec3)]) -> Vec<Vec<Vec3>> {
        let emitter = Emitter::new(shape);
        let column = |lobe: usize| {
            let closed = |&(point, normal): &(Vec3, Vec3)| emitter.irradiance(lobe, point, normal).unwrap_or(0.0);
            let direct: Vec<f32> = places.par_iter().with_min_len(64).map(closed).collect();
            let here = self.arriving_here(lobe);
            let arriving = self.arriving(lobe, direct.iter().map(|&e| f64::from(e)));
            let growth = if here > 0.0 { (arriving / here) as f32 } else { 0.0 };
            let UnitLayer { lit, indirect, .. } = &self.layers[lobe];
            (0..direct.len()).map(|p| indirect[p] * growth + Vec3::splat(direct[p] * lit[p])).collect()
        };
        (0..self.layers.len()).map(column).collect()
    }

    /// Per lobe and parameter, the derivative of its column.
    fn slopes(&self, parameters: &[Parameter], places: &[(Vec3, Vec3)]) -> Vec<Vec<Vec<Vec3>>> {
        let emitter = Emitter::new(&self.shape);
        let pivot = self.shape.bounding_sphere().map_or(Vec3::ZERO, |(middle, _)| middle);
        let lobe = |lobe: usize| {
            let gradient = |&(point, normal): &(Vec3, Vec3)| emitter.gradient(lobe, point, normal, pivot);
            let gradients: Vec<Gradient> = places.par_iter().with_min_len(64).map(gradient).collect();
            let here = self.arriving_here(lobe);
            let UnitLayer { lit, indirect, .. } = &self.layers[lobe];
            let slope = |parameter: &Parameter| {
                let direct: Vec<f64> = gradients.iter().map(|g| parameter.rate(&self.shape, lobe, g)).collect();
                let arriving = self.arriving(lobe, direct.iter().copied());
                let growth = if here > 0.0 { (arriving / here) as f32 } else { 0.0 };
                (0..direct.len()).map(|p| indirect[p] * growth + Vec3::splat(direct[p] as f32 * lit[p])).collect()
            };
            parameters.iter().map(slope).collect()
        };
        (0..self.layers.len()).map(lobe).collect()
    }
}

/// Radiances for some columns, and the loss that they leave.
#[derive(Clone)]
struct Explained {
    radiance: Vec<DVec3>,
    loss: f64,
}

struct Fit<'a> {
    receivers: &'a Receivers<'a>,
    lights: &'a [Movable<'a>],
    search: &'a ShapeSearch,
    places: Vec<(Vec3, Vec3)>,
    /// The middle of the places.
    lit: Vec3,
    /// Weight of the prior, as a share of the photo's energy.
    prior: f64,
}

/// Normal equations of the parameters, radiances and albedos eliminated; the photo's energy is 1.
struct Normal {
    gram: Vec<f64>,
    right: Vec<f64>,
}

/// Refines the shapes of lights. What is given comes back where the photo is black or has nothing to tell.
pub fn fit_shapes(receivers: &Receivers, lights: &[Movable], bounds: &Bounds, search: &ShapeSearch) -> ShapeFit {
    let places = receivers.places();
    let lit = places.iter().map(|(point, _)| *point).sum::<Vec3>() / places.len().max(1) as f32;
    let mut fit = Fit { receivers, lights, search, places, lit, prior: 0.0 };
    let trace =
        |light: &Movable, shape: &Shape| Placed::new(shape.clone(), receivers.layers(shape, light.own, search.quality));
    let start: Vec<Placed> = lights.iter().map(|light| trace(light, &light.shape)).collect();
    let mut found = ShapeFit {
        shapes: lights.iter().map(|light| light.shape.clone()).collect(),
        saved: vec![0.0; lights.len()],
        loss: [0.0; 2],
        parameters: Vec::new(),
        conditioning: Conditioning::default(),
        untold: Vec::new(),
    };
    if receivers.evidence.photo.is_empty() || receivers.evidence.white == 0.0 {
        return found;
    }
    let mut now = fit.explain(&columns_of(&start), None, FIRST_TURNS);
    found.loss = [now.loss; 2];
    let large = now.loss.max(FLOOR);
    fit.prior = PRIOR * large;
    let mut placed = start.clone();
    for round in 0..search.rounds {
        let free = fit.parameters(&placed);
        let normal = fit.normal(&placed, &free, &now);
        if round == 0 {
            let n = free.len();
            found.conditioning = conditioning(&normal.gram, n);
            found.untold = (0..n).filter(|i| normal.gram[i * n + i] < fit.prior).collect();
            found.parameters = free.iter().map(|(light, parameter)| (*light, parameter.name())).collect();
        }
        let (shapes, stepped) = fit.descend(&placed, &now, (free, normal), bounds);
        let moved: Vec<usize> = (0..lights.len()).filter(|&i| shapes[i] != placed[i].shape).collect();
        if moved.is_empty() {
            break;
        }
        let mut tried = placed.clone();
        moved.iter().for_each(|&i| tried[i] = trace(&lights[i], &shapes[i]));
        let mut after = fit.explain(&columns_of(&tried), Some(&stepped.radiance), TURNS);
        // Each light by itself: what the rays say may be good for one move and bad for another.
        let mut saved = vec![0.0; lights.len()];
        for i in 0..lights.len() {
            if tried[i].shape == lights[i].shape {
                continue;
            }
            let with = fit.whole(&after, &tried);
            let moved = std::mem::replace(&mut tried[i], start[i].clone());
            let without = fit.explain(&columns_of(&tried), Some(&after.radiance), TURNS);
            let share = (fit.whole(&without, &tried) - with) / large;
            if share < search.worth {
                after = without;
            } else {
                (tried[i], saved[i]) = (moved, share);
            }
        }
        if fit.whole(&after, &tried) >= fit.whole(&now, &placed) {
            break;
        }
        (placed, now, found.saved) = (tried, after, saved);
        found.loss[1] = now.loss;
    }
    found.shapes = placed.into_iter().map(|light| light.shape).collect();
    found
}

fn columns_of(lights: &[Placed]) -> Vec<Vec<Vec3>> {
    lights.iter().flat_map(|light| light.columns.iter().cloned()).collect()
}

impl Fit<'_> {
    fn parameters(&self, placed: &[Placed]) -> Vec<(usize, Parameter)> {
        let of = |(i, light): (usize, &Placed)| {
            parameters(&light.shape, self.lights[i].freedom, self.lit).into_iter().map(move |p| (i, p))
        };
        placed.iter().enumerate().flat_map(of).collect()
    }

    fn problem(&self, columns: &[Vec<Vec3>]) -> (Problem<'_>, Vec<f64>) {
        let penalties = self.lights.iter().flat_map(|light| light.penalty.iter().copied());
        let mut all: Vec<Column> =
            columns.iter().zip(penalties).map(|(layer, penalty)| Column { layer, penalty, pull: 0.0 }).collect();
        all.push(Column { layer: &self.receivers.ambient, penalty: self.search.ambient_penalty, pull: 0.0 });
        let scale = scales(all.iter());
        let evidence = &self.receivers.evidence;
        (Problem::new(evidence, &all, &scale, f64::from(evidence.white)), scale)
    }

    /// Radiances of the lobes and the ambient, from `start` or an even share.
    fn explain(&self, columns: &[Vec<Vec3>], start: Option<&[DVec3]>, turns: usize) -> Explained {
        let (problem, scale) = self.problem(columns);
        let lit = scale.iter().filter(|s| **s > 0.0).count().max(1);
        let share = |k: usize, s: f64| match start {
            _ if s == 0.0 => DVec3::ZERO,
            Some(start) => start[k] / s,
            None => DVec3::splat(1.0 / lit as f64),
        };
        let mut w: Vec<[f64; 3]> = scale.iter().enumerate().map(|(k, &s)| share(k, s).to_array()).collect();
        for _ in 0..turns {
            problem.turn(&mut w, STEP);
        }
        let radiance = w.iter().zip(&scale).map(|(w, s)| DVec3::from_array(*w) * *s).collect();
        Explained { radiance, loss: problem.objective(&w) }
    }

    /// The loss together with what the prior takes for the way from the start.
    fn whole(&self, explained: &Explained, placed: &[Placed]) -> f64 {
        explained.loss + self.pull(placed.iter().map(|light| &light.shape))
    }

    fn pull<'s>(&self, shapes: impl Iterator<Item = &'s Shape>) -> f64 {
        let of = |(light, shape): (&Movable, &'s Shape)| -> f64 {
            let free = parameters(shape, light.freedom, self.lit);
            free.iter().map(|parameter| parameter.offset(&light.shape, shape).powi(2)).sum()
        };
        self.prior * self.lights.iter().zip(shapes).map(of).sum::<f64>()
    }

    fn normal(&self, placed: &[Placed], free: &[(usize, Parameter)], now: &Explained) -> Normal {
        let columns = columns_of(placed);
        let (problem, scale) = self.problem(&columns);
        let w: Vec<[f64; 3]> = now
            .radiance
            .iter()
            .zip(&scale)
            .map(|(w, s)| if *s > 0.0 { (*w / *s).to_array() } else { [0.0; 3] })
            .collect();
        // Per parameter, the derivative of the shading with the radiances as they are.
        let mut slopes: Vec<Vec<DVec3>> = Vec::new();
        let mut first = 0;
        for (i, light) in placed.iter().enumerate() {
            let own: Vec<Parameter> = free.iter().filter(|(j, _)| *j == i).map(|(_, p)| *p).collect();
            let lobes = if own.is_empty() { Vec::new() } else { light.slopes(&own, &self.places) };
            for parameter in 0..own.len() {
                let sum = |p: usize| {
                    let parts = lobes.iter().enumerate();
                    parts.map(|(k, lobe)| now.radiance[first + k] * lobe[parameter][p].as_dvec3()).sum()
                };
                slopes.push((0..self.places.len()).map(sum).collect());
            }
            first += light.layers.len();
        }
        let channels: Vec<Normal> = (0..3).into_par_iter().map(|c| self.channel(&problem, &w, &slopes, c)).collect();
        let energy = problem.energy();
        let sum = |of: fn(&Normal) -> &Vec<f64>| -> Vec<f64> {
            let mut sums = vec![0.0; of(&channels[0]).len()];
            channels.iter().for_each(|channel| sums.iter_mut().zip(of(channel)).for_each(|(s, v)| *s += v / energy));
            sums
        };
        Normal { gram: sum(|normal| &normal.gram), right: sum(|normal| &normal.right) }
    }

    fn channel(&self, problem: &Problem, w: &[[f64; 3]], slopes: &[Vec<DVec3>], c: usize) -> Normal {
        let (segment, segments) = (&self.receivers.evidence.segment, self.receivers.evidence.segments);
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
        let (mut norm, mut along, mut v) = (vec![0.0; segments], vec![0.0; segments * size], vec![0.0; size]);
        for (p, &s) in segment.iter().enumerate() {
            let s = s as usize;
            row(p, &mut v);
            norm[s] += weight[p] * shading[p] * shading[p];
            along[s * size..][..size].iter_mut().zip(&v).for_each(|(a, v)| *a += weight[p] * v * shading[p]);
        }
        for (along, norm) in along.chunks_exact_mut(size.max(1)).zip(&norm) {
            along.iter_mut().for_each(|a| *a = if *norm > 0.0 { *a / norm } else { 0.0 });
        }
        let (mut all, mut right) = (vec![0.0; size * size], vec![0.0; n]);
        for (p, &s) in segment.iter().enumerate() {
            let s = s as usize;
            row(p, &mut v);
            v.iter_mut().zip(&along[s * size..]).for_each(|(v, along)| *v = albedo[s] * (*v - along * shading[p]));
            right.iter_mut().zip(&v).for_each(|(r, v)| *r += weight[p] * v * residual[p]);
            for i in 0..size {
                let scaled = weight[p] * v[i];
                all[i * size..][..=i].iter_mut().zip(&v).for_each(|(sum, v)| *sum += scaled * v);
            }
        }
        let at = |i: usize, j: usize| all[i.max(j) * size + i.min(j)];
        // Radiances answer: the Schur complement. The gauge leaves their equations without one answer, and a ridge takes the smallest.
        let m = on.len();
        let lights: Vec<f64> = (0..m * m)
            .map(|ij| (ij / m, ij % m))
            .map(|(i, j)| at(n + i, n + j) * if i == j { 1.0 + 1e-6 } else { 1.0 })
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
        Normal { gram, right }
    }

    /// Damped steps with visibility and the form of the indirect light held, and what they lead to.
    fn descend(
        &self,
        placed: &[Placed],
        now: &Explained,
        (mut free, mut normal): (Vec<(usize, Parameter)>, Normal),
        bounds: &Bounds,
    ) -> (Vec<Shape>, Explained) {
        let mut shapes: Vec<Shape> = placed.iter().map(|light| light.shape.clone()).collect();
        let mut here = placed.to_vec();
        let mut best = now.clone();
        let mut lowest = self.whole(now, placed);
        let [mut damping, good, bad, end] = DAMPING;
        for _ in 0..self.search.steps {
            let n = free.len();
            let offset = |i: usize| {
                let (light, parameter) = &free[i];
                parameter.offset(&self.lights[*light].shape, &shapes[*light])
            };
            let right: Vec<f64> = (0..n).map(|i| normal.right[i] - self.prior * offset(i)).collect();
            let mut gram = normal.gram.clone();
            for i in 0..n {
                gram[i * n + i] += self.prior + damping * (gram[i * n + i].max(0.0) + self.prior);
            }
            let Some(step) = solve_free(&gram, &right, &vec![true; n]) else { break };
            let longest = step.iter().fold(LONGEST, |longest, s| longest.max(s.abs()));
            let mut tried = shapes.clone();
            for ((light, parameter), step) in free.iter().zip(&step) {
                tried[*light] = parameter.moved(&tried[*light], step * LONGEST / longest);
            }
            for (i, light) in self.lights.iter().enumerate() {
                if !bounds.hold(&light.shape, &tried[i], light.freedom) {
                    tried[i] = shapes[i].clone();
                }
            }
            let columns: Vec<Vec<Vec3>> = placed
                .iter()
                .zip(&tried)
                .flat_map(|(light, shape)| {
                    if *shape == light.shape { light.columns.clone() } else { light.columns_of(shape, &self.places) }
                })
                .collect();
            let after = self.explain(&columns, Some(&best.radiance), TURNS);
            let loss = after.loss + self.pull(tried.iter());
            if loss >= lowest || !loss.is_finite() {
                damping *= bad;
                if damping > end {
                    break;
                }
                continue;
            }
            let gain = (lowest - loss) / lowest;
            (shapes, best, lowest) = (tried, after, loss);
            if gain < SETTLED {
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
