//! Radiances of the lights and albedos of the segments that explain a photo together.
//!
//! The photo is `I_p = A_s(p) sum_k w_k u_k(p)` per color channel, with u_k the unit layer of light
//! k (its own shadow and its own indirect light included), w_k >= 0 its radiance and A_s one albedo
//! for all pixels of a segment. The variation of shading *inside* a segment distinguishes the
//! lights. The albedo of a segment absorbs the rest, so that texture and paint are not attributed
//! to a light. The solver alternates: given w, each A_s is a ratio of sums; given A, w is a
//! non-negative least-squares problem in the part that the albedos cannot absorb (variable
//! projection, Golub and Pereyra 1973). A Cauchy weight limits the influence of highlights and
//! wrong shadows (iteratively reweighted least squares).
//!
//! All quantities are in units of the photo's white and of each layer's mean, so that neither the
//! photo's exposure nor the size and distance of a light matter. Layers are f32, sums f64. Normal
//! equations square the condition number, and lose nothing here: columns that differ by a fraction
//! d are resolved to 1e-16 / d^2 by 64-bit sums and to 6e-8 / d by 32-bit layers, which is the
//! larger for every d above 2e-9.

use glam::{DVec3, Vec3};

use super::conditioning::{Conditioning, conditioning};
use super::fit_problem::{FIT_PROBLEM, Problem, scales};
use super::{Column, LightPrior, Observations, Role};
use crate::image::luminance;
use crate::tuning::tuning;

tuning! {
    /// Constants of the fit of radiances and albedos.
    pub const RADIANCE_FIT: RadianceFitTuning {
        /// Largest number of lights of a photo: each costs rays of its own, and the time of a fit
        /// grows with the square of their number.
        max_lights: usize = 32,
            unit "lights", source Measured("run time; no page records it"),
            effect "scenes with more lights are refused";
        /// Relative change of a light in one iteration below which it has converged.
        tolerance: f64 = 1e-4,
            unit "1", source Measured("no page records it"), effect "a smaller value takes more iterations";
        /// Least channel of a light over its largest, in the gauge in which the mean light is
        /// white: a bulb of 2500 K has 0.07.
        min_channel: f64 = 0.07,
            unit "1", source Derived("black bodies"),
            effect "an edit of the color never divides by zero; a larger value makes warm lights paler";
        /// Factor on the step fraction after a step that reverses the last one, since iterations
        /// may circle around the minimum.
        step_cut: f64 = 0.5,
            unit "1", source Taste, effect "a smaller value stops oscillations earlier and is slower";
        /// Growth of the step fraction from one iteration to the next that goes on in its
        /// direction.
        step_growth: f64 = 1.1,
            unit "1", source Measured("no page records it"), effect "a larger value regains speed sooner";
    }
}

/// Result of [`fit_radiances`].
#[derive(Clone, Debug)]
pub struct RadianceFit {
    /// Radiance per column, linear RGB, >= 0, in units of the photo over the unit layer.
    pub radiance: Vec<Vec3>,
    /// Albedo per segment, linear RGB.
    pub albedo: Vec<Vec3>,
    /// Mean of log(1 + r^2), r the residual over its expected size: 0 is a perfect fit.
    pub loss: f64,
    /// The same at the start, where every light contributes equally.
    pub loss_before: f64,
    /// Conditioning of the columns, in the channel in which it is worst.
    pub conditioning: Conditioning,
    /// Number of iterations.
    pub iterations: usize,
    /// Largest relative change of a light in the last iteration.
    pub change: f64,
    /// Columns that still changed by more than `RADIANCE_FIT.tolerance` in the last iteration:
    /// empty when the fit converged.
    pub unsettled: Vec<usize>,
    /// Columns whose layer is black on all observations: they are unconstrained, and their radiance
    /// is 0.
    pub dark: Vec<usize>,
    /// Unknowns per channel: columns that are equal share one unknown.
    pub unknowns: usize,
    /// Unsaturated pixels beyond one per segment: each segment's albedo uses one up. Fewer than the
    /// columns that are not dark, less one for the gauge, leave radiances undetermined.
    pub degrees_of_freedom: usize,
}

/// Fits radiances in at most `iterations` iterations.
///
/// Each column's layer has one value per pixel of `observations`. The gauge (a light twice as
/// bright in a room half as reflective looks the same) is set so that the mean shading of each
/// channel is 1; [`RadianceFit::with_albedo_of`] sets another. A black photo gives radiances of 0.
///
/// # Panics
///
/// When a layer has fewer values than `observations` has pixels.
///
/// # Examples
///
/// Two lights fall off from either end of a wall of one paint; the second is half as bright:
///
/// ```
/// use glam::Vec3;
/// use relight::optics::inverse::{Column, LightPrior, Observations, Role, fit_radiances};
///
/// let falloff = |x: f32| Vec3::splat(1.0 / (0.3 + x * x));
/// let left: Vec<Vec3> = (0..100).map(|i| falloff(i as f32 / 100.0)).collect();
/// let right: Vec<Vec3> = left.iter().rev().copied().collect();
/// let photo = left.iter().zip(&right).map(|(l, r)| 0.2 * *l + 0.1 * *r).collect();
/// let observations =
///     Observations { photo, segment: vec![0; 100], segments: 1, saturated: vec![false; 100], white: 1.0 };
/// let columns = [Column::new(Role::Visible, &left), Column::new(Role::Visible, &right)];
/// let fit = fit_radiances(&observations, &columns, &LightPrior::default(), 200);
/// assert!((fit.radiance[1].x / fit.radiance[0].x - 0.5).abs() < 0.01);
/// ```
pub fn fit_radiances(
    observations: &Observations,
    columns: &[Column],
    prior: &LightPrior,
    iterations: usize,
) -> RadianceFit {
    fit_until(observations, columns, prior, iterations, RADIANCE_FIT.tolerance)
}

fn fit_until(
    observations: &Observations,
    columns: &[Column],
    prior: &LightPrior,
    iterations: usize,
    tolerance: f64,
) -> RadianceFit {
    let n = observations.photo.len();
    let white = f64::from(observations.white);
    let groups = equal_columns(columns, prior);
    let distinct: Vec<&Column> = groups.iter().map(|group| &columns[group[0]]).collect();
    let counts: Vec<f64> = groups.iter().map(|group| group.len() as f64).collect();
    let scale = scales(distinct.iter().copied());
    let lit: f64 =
        counts.iter().zip(&scale).map(|(count, &s)| if s > 0.0 { *count } else { 0.0 }).sum();
    let mut fit = RadianceFit {
        radiance: vec![Vec3::ZERO; columns.len()],
        albedo: vec![Vec3::ZERO; observations.segments],
        loss: 0.0,
        loss_before: 0.0,
        conditioning: Conditioning::default(),
        iterations: 0,
        change: 0.0,
        unsettled: Vec::new(),
        dark: members(&groups, |j| scale[j] == 0.0),
        unknowns: distinct.len(),
        degrees_of_freedom: degrees_of_freedom(observations),
    };
    if white == 0.0 || lit == 0.0 {
        return fit;
    }
    let problem = Problem::shared(observations, &distinct, counts, &scale, prior, white);
    // The weight of a group is that of its equal columns together.
    let mut w: Vec<[f64; 3]> = scale
        .iter()
        .zip(&problem.count)
        .map(|(&s, count)| [if s > 0.0 { count / lit } else { 0.0 }; 3])
        .collect();
    fit.loss_before = (0..3).map(|c| problem.explained(&w, c).1).sum::<f64>() / (3 * n) as f64;
    fit.iterate(&problem, &mut w, &groups, iterations, tolerance, &scale);
    set_gauge(&problem, &mut w);
    for c in 0..3 {
        let (albedo, loss) = problem.explained(&w, c);
        fit.loss += loss / (3 * n) as f64;
        fit.albedo.iter_mut().zip(&albedo).for_each(|(fitted, &a)| fitted[c] = (a * white) as f32);
    }
    for (j, group) in groups.iter().enumerate() {
        let each = (DVec3::from_array(w[j]) * scale[j] / problem.count[j]).as_vec3();
        group.iter().for_each(|&i| fit.radiance[i] = each);
    }
    fit
}

impl RadianceFit {
    /// Iterates until every light has converged or `iterations` are done, and records how it went.
    fn iterate(
        &mut self,
        problem: &Problem,
        w: &mut [[f64; 3]],
        groups: &[Vec<usize>],
        iterations: usize,
        tolerance: f64,
        scale: &[f64],
    ) {
        // A small step does not show convergence: changes are those of a step of the usual
        // fraction.
        let (mut step, mut direction) = (FIT_PROBLEM.step_fraction, vec![[0.0; 3]; w.len()]);
        let mut grams: [Vec<f64>; 3] = Default::default();
        while self.iterations < iterations {
            let (last, taken) = (w.to_vec(), step);
            grams = problem.iterate(w, step);
            self.iterations += 1;
            let moved =
                w.iter().zip(&last).map(|(w, last)| [0, 1, 2].map(|c| w[c] - last[c])).collect();
            let before = std::mem::replace(&mut direction, moved);
            let forward: f64 =
                direction.iter().flatten().zip(before.iter().flatten()).map(|(a, b)| a * b).sum();
            step = if forward < 0.0 {
                RADIANCE_FIT.step_cut * step
            } else {
                (RADIANCE_FIT.step_growth * step).min(FIT_PROBLEM.step_fraction)
            };
            // Per light, so that the weakest is as accurate as the strongest.
            let changes = w.iter().zip(&last).map(|(w, last)| {
                let largest =
                    |(s, m): (f64, f64), c: usize| (s.max(w[c]), m.max((w[c] - last[c]).abs()));
                let (size, moved) = (0..3).fold((0.0, 0.0), largest);
                if moved > 0.0 {
                    moved / size.max(FIT_PROBLEM.off) * FIT_PROBLEM.step_fraction / taken
                } else {
                    0.0
                }
            });
            let changes: Vec<f64> = changes.collect();
            self.change = changes.iter().copied().fold(0.0, f64::max);
            self.unsettled = members(groups, |j| changes[j] > tolerance);
            if self.unsettled.is_empty() {
                break;
            }
        }
        if self.iterations > 0 {
            self.conditioning = grouped_conditioning(&grams, groups, scale);
        }
    }

    /// The same fit in the gauge in which the albedo agrees, in the geometric mean over the pixels,
    /// with `albedo`.
    ///
    /// `segment` and `albedo` have one entry per pixel; a `segment` is an index into
    /// [`RadianceFit::albedo`]. Values of 0 are left out.
    ///
    /// # Panics
    ///
    /// When a `segment` is not below the number of segments of the fit.
    pub fn with_albedo_of(mut self, segment: &[u32], albedo: &[Vec3]) -> RadianceFit {
        let mut factor = Vec3::ONE;
        for c in 0..3 {
            let (mut sum, mut count) = (0.0f64, 0);
            for (&s, wanted) in segment.iter().zip(albedo) {
                let got = self.albedo[s as usize][c];
                if got > 0.0 && wanted[c] > 0.0 {
                    sum += f64::from(got / wanted[c]).ln();
                    count += 1;
                }
            }
            if count > 0 {
                factor[c] = (sum / f64::from(count)).exp() as f32;
            }
        }
        self.radiance.iter_mut().for_each(|w| *w *= factor);
        self.albedo.iter_mut().for_each(|a| *a /= factor);
        self
    }

    /// Luminance of the shading by the ambient columns and by all `columns` of the fit, summed over
    /// the pixels.
    pub fn residual_and_total(&self, columns: &[Column]) -> (f64, f64) {
        let (mut residual, mut total) = (0.0, 0.0);
        for (column, &w) in columns.iter().zip(&self.radiance) {
            let sum: f64 = column.layer.iter().map(|&u| f64::from(luminance(u * w))).sum();
            total += sum;
            residual += if column.role == Role::Ambient { sum } else { 0.0 };
        }
        (residual, total)
    }

    /// Loss by which candidates for a light are compared: the misfit, and `residual_weight` of the
    /// prior times the ambient's fraction of the light.
    pub fn selection_loss(&self, columns: &[Column], prior: &LightPrior) -> f64 {
        let (residual, total) = self.residual_and_total(columns);
        self.loss + if total > 0.0 { prior.residual_weight * residual / total } else { 0.0 }
    }
}

/// Scales `w` so that the mean shading of each channel is 1, and raises channels below
/// `RADIANCE_FIT.min_channel`.
fn set_gauge(problem: &Problem, w: &mut [[f64; 3]]) {
    for c in 0..3 {
        let mean: f64 = w.iter().zip(&problem.mean[c]).map(|(w, mean)| w[c] * mean).sum();
        if mean > FIT_PROBLEM.off {
            w.iter_mut().for_each(|v| v[c] /= mean);
        }
    }
    for w in w {
        let least = RADIANCE_FIT.min_channel * w[0].max(w[1]).max(w[2]);
        w.iter_mut().for_each(|v| *v = v.max(least));
    }
}

/// The columns of the groups that `test` accepts, in order.
fn members(groups: &[Vec<usize>], test: impl Fn(usize) -> bool) -> Vec<usize> {
    let mut all: Vec<usize> =
        (0..groups.len()).filter(|&j| test(j)).flat_map(|j| groups[j].iter().copied()).collect();
    all.sort_unstable();
    all
}

/// Groups of columns of equal layers and weights, ordered by their first member. No photo
/// distinguishes them, so that the fit has one unknown for each group: a hundred names of one lamp
/// cost as much as one.
fn equal_columns(columns: &[Column], prior: &LightPrior) -> Vec<Vec<usize>> {
    let weights = |column: &Column| {
        let role = column.role;
        (prior.l1_weight(role), prior.tikhonov_weight(role), prior.hue_weight(role))
    };
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (i, column) in columns.iter().enumerate() {
        let equal =
            |other: &Column| weights(other) == weights(column) && other.layer == column.layer;
        match groups.iter_mut().find(|group| equal(&columns[group[0]])) {
            Some(group) => group.push(i),
            None => groups.push(vec![i]),
        }
    }
    groups
}

/// Worst conditioning of the three channels, from the Gram matrices of the groups of equal columns.
fn grouped_conditioning(
    grams: &[Vec<f64>; 3],
    groups: &[Vec<usize>],
    scale: &[f64],
) -> Conditioning {
    if let Some((group, _)) =
        groups.iter().zip(scale).find(|(group, s)| group.len() > 1 && **s > 0.0)
    {
        return Conditioning::of_equals([group[0], group[1]]);
    }
    let worst = grams.iter().fold(Conditioning::default(), |worst, gram| {
        let found = conditioning(gram, groups.len());
        if found.number > worst.number { found } else { worst }
    });
    Conditioning {
        most_correlated: worst.most_correlated.map(|pair| pair.map(|j| groups[j][0])),
        ..worst
    }
}

/// Unsaturated pixels beyond one per segment.
fn degrees_of_freedom(observations: &Observations) -> usize {
    let mut used = vec![false; observations.segments];
    let mut count = 0;
    let pixels = observations.segment.iter().zip(&observations.saturated);
    for (&segment, _) in pixels.filter(|(_, saturated)| !**saturated) {
        count += usize::from(std::mem::replace(&mut used[segment as usize], true));
    }
    count
}

#[cfg(test)]
#[path = "stiff.rs"]
mod stiff;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Mask, Picture, Plane, Segments};

    /// A row of pixels in four segments under two lights that fall off from either end.
    fn row() -> (Observations, Vec<Vec3>, Vec<Vec3>) {
        let n = 400;
        let from = |x: f32| Vec3::splat(1.0 / (0.3 + x * x));
        let left: Vec<Vec3> = (0..n).map(|i| from(i as f32 / n as f32)).collect();
        let right: Vec<Vec3> = (0..n).map(|i| from(1.0 - i as f32 / n as f32)).collect();
        let paint = [
            Vec3::splat(0.8),
            Vec3::new(0.7, 0.2, 0.1),
            Vec3::new(0.1, 0.3, 0.6),
            Vec3::splat(0.3),
        ];
        let segment: Vec<u32> = (0..n).map(|i| i as u32 / 100).collect();
        let (w0, w1) = (Vec3::new(0.3, 0.25, 0.2), Vec3::new(0.05, 0.1, 0.15));
        let photo = (0..n).map(|i| paint[i / 100] * (w0 * left[i] + w1 * right[i])).collect();
        (
            Observations { photo, segment, segments: 4, saturated: vec![false; n], white: 1.0 },
            left,
            right,
        )
    }

    fn columns<'a>(layers: &[&'a [Vec3]]) -> Vec<Column<'a>> {
        layers.iter().map(|layer| Column::new(Role::Visible, layer)).collect()
    }

    #[test]
    fn shares_of_two_lights_over_unknown_paint_are_found() {
        let (observations, left, right) = row();
        let fit =
            fit_radiances(&observations, &columns(&[&left, &right]), &LightPrior::default(), 60);
        // Only the share of each light in each channel is determined: 0.3 : 0.05, 0.25 : 0.1, 0.2 :
        // 0.15.
        let ratio = fit.radiance[1] / fit.radiance[0];
        let truth = Vec3::new(0.05 / 0.3, 0.4, 0.75);
        // The second light is 0.3 off the line of likely colors in log(r / g); the prior draws it
        // half of the way.
        assert!(((ratio - truth) / truth).abs().max_element() < 0.2, "{ratio} against {truth}");
        assert!(fit.loss < 1e-2, "loss {}", fit.loss);
    }

    #[test]
    fn a_weight_of_the_hue_gives_the_lights_one_color() {
        let (observations, left, right) = row();
        let ratio = |hue_weight: f64| {
            let prior = LightPrior { hue_weight, ..LightPrior::default() };
            let fit = fit_radiances(&observations, &columns(&[&left, &right]), &prior, 200);
            fit.radiance[1] / fit.radiance[0]
        };
        let spread = |ratio: Vec3| ratio.max_element() / ratio.min_element();
        let [free, default, one] = [0.0, 0.003, 1e3].map(ratio);
        // Where the photo determines the colors, the default moves them little.
        assert!(((default - free) / free).abs().max_element() < 0.2, "{free} {default}");
        assert!(spread(one) < 1.01 && one.x > free.x && one.x < free.z, "{one}");
    }

    #[test]
    fn undetermined_light_is_shared_equally_and_determined_light_stays() {
        let (observations, left, right) = row();
        // Even inside each segment, so that its albedos take all of it up.
        let open: Vec<Vec3> =
            (0..400).map(|i| Vec3::splat([0.2, 1.0, 3.0, 0.5][i / 100])).collect();
        let mean = |layer: &[Vec3]| layer.iter().map(|v| v.y).sum::<f32>() / 400.0;
        let shares = |tikhonov_weight: f64| {
            let mut columns = columns(&[&left, &right, &open]);
            columns[2].role = Role::OutOfView;
            let prior = LightPrior { out_of_view: 1e-3, tikhonov_weight, ..LightPrior::default() };
            let fit = fit_radiances(&observations, &columns, &prior, 200);
            let gives: Vec<f32> = fit
                .radiance
                .iter()
                .zip([&left, &right, &open])
                .map(|(w, layer)| w.y * mean(layer))
                .collect();
            let all: f32 = gives.iter().sum();
            [gives[1] / gives[0], gives[2] / all]
        };
        let ([ratio, nothing], [guessed, share]) = (shares(0.0), shares(3e-3));
        assert!(
            nothing < 1e-3 && (share - 1.0 / 3.0).abs() < 0.15,
            "share {nothing}, with the guess {share}"
        );
        assert!((guessed / ratio - 1.0).abs() < 0.3, "{guessed} against {ratio}");
        // A heavier guess outweighs the photo.
        let [heavy, _] = shares(0.03);
        assert!(heavy > guessed && heavy < 1.0, "{heavy}");
    }

    #[test]
    fn a_light_that_explains_nothing_gets_nothing() {
        let (observations, left, right) = row();
        let stripes: Vec<Vec3> =
            (0..400).map(|i| Vec3::splat(if i % 2 == 0 { 1.0 } else { 0.0 })).collect();
        let mut columns = columns(&[&left, &right, &stripes]);
        columns[2].role = Role::OutOfView;
        let prior = LightPrior { out_of_view: 0.02, ..LightPrior::default() };
        let fit = fit_radiances(&observations, &columns, &prior, 60);
        assert!(
            fit.radiance[2].max_element() < 1e-3 * fit.radiance[0].min_element(),
            "{:?}",
            fit.radiance
        );
    }

    #[test]
    fn clipped_pixels_do_not_darken_a_light() {
        let (mut observations, left, right) = row();
        for p in 0..400 {
            // The left segment is white and clipped near its lamp.
            if observations.photo[p].max_element() > 0.6 {
                observations.saturated[p] = true;
                observations.photo[p] = observations.photo[p].min(Vec3::splat(0.6));
            }
        }
        let fit =
            fit_radiances(&observations, &columns(&[&left, &right]), &LightPrior::default(), 60);
        let ratio = fit.radiance[1].y / fit.radiance[0].y;
        assert!((ratio - 0.4).abs() < 0.08, "ratio {ratio}");
    }

    #[test]
    fn degenerate_evidence_is_finite() {
        let empty = Observations {
            photo: vec![],
            segment: vec![],
            segments: 0,
            saturated: vec![],
            white: 0.0,
        };
        assert!(fit_radiances(&empty, &[], &LightPrior::default(), 5).radiance.is_empty());
        let n = 10;
        for photo in [vec![Vec3::ZERO; n], vec![Vec3::ONE; n]] {
            for saturated in [false, true] {
                let (segment, white) = (vec![0; n], photo[0].x);
                let saturated = vec![saturated; n];
                let observations =
                    Observations { photo: photo.clone(), segment, segments: 1, saturated, white };
                let (zero, one) = (vec![Vec3::ZERO; n], vec![Vec3::ONE; n]);
                let fit = fit_radiances(
                    &observations,
                    &columns(&[&zero, &one, &one]),
                    &LightPrior::default(),
                    10,
                );
                assert!(
                    fit.radiance.iter().all(|w| w.is_finite() && w.min_element() >= 0.0),
                    "{fit:?}"
                );
                assert!(fit.loss.is_finite() && fit.conditioning.number >= 1.0, "{fit:?}");
            }
        }
    }

    #[test]
    fn where_albedo_is_known_radiances_need_no_smooth_surface() {
        // A paint of its own at every pixel, which a segment of one albedo would take for light.
        let (w, h) = (24, 16);
        let plane = |f: &dyn Fn(f32, f32) -> f32| {
            Plane::from_fn(w, h, |x, y| f(x as f32 / w as f32, y as f32 / h as f32))
        };
        let (left, right) = (
            plane(&|x, y| 0.1 + (1.0 - x).powi(2) * (0.5 + y)),
            plane(&|x, y| 0.05 + x * (1.2 - y)),
        );
        let wanted = [Vec3::new(1.0, 0.8, 0.5), Vec3::new(0.6, 0.8, 1.0)];
        let paint = Plane::from_fn(w, h, |x, y| {
            Vec3::splat(0.2 + 0.6 * ((x * 7 + y * 3) % 5) as f32 / 5.0)
        });
        let shading = |p: usize| left.pixels()[p] * wanted[0] + right.pixels()[p] * wanted[1];
        let photo = Picture(Plane::from_fn(w, h, |x, y| paint.get(x, y) * shading(y * w + x)));
        let segments = Segments { label: Plane::filled(w, h, 0), count: 1 };
        let pixels: Vec<usize> = (0..w * h).collect();
        let clipped = Mask(Plane::filled(w, h, 0.0));
        let observations =
            Observations::at(&photo, &clipped, &segments, &pixels, 0).over(paint.pixels());
        let layers = [&left, &right].map(|layer| layer.map(Vec3::splat).into_pixels());
        let columns: Vec<Column> =
            layers.iter().map(|layer| Column::new(Role::Visible, layer)).collect();
        let ones = vec![Vec3::ONE; pixels.len()];
        let fit = fit_radiances(&observations, &columns, &LightPrior::default(), 200)
            .with_albedo_of(&observations.segment, &ones);
        for (got, wanted) in fit.radiance.iter().zip(wanted) {
            // The prior of likely colors moves radiances that are not of a bulb or of daylight.
            assert!(
                ((*got - wanted) / wanted).abs().max_element() < 0.03,
                "{got} against {wanted}"
            );
        }
    }
}
