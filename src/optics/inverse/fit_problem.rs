//! Least-squares problem of the light fit, in 64 bits: the photo in units of its white, layers of
//! mean 1.
//!
//! `RadianceFit` and `ShapeFit` share it: residuals, albedos, weights and prior terms are computed
//! here only.

use rayon::prelude::*;

use super::{Column, LightPrior, Observations};
use crate::optics::nnls::{nnls, nnls_from};
use crate::tuning::tuning;

tuning! {
    /// Constants of the least-squares problem of the light fit.
    pub const FIT_PROBLEM: FitProblemTuning {
        /// Standard deviation of the model error as a fraction of a pixel's value.
        relative_error: f64 = 0.15,
            unit "1", source Measured("rooms of docs/accuracy.md"), effect "a larger value trusts bright pixels less";
        /// Floor of that standard deviation, about two 8-bit steps.
        error_floor: f64 = 0.01,
            unit "fraction of white", source Derived("quantization of 8-bit photos"),
            effect "a larger value trusts dark pixels less";
        /// Offset in the weight `sqrt(I) / (I + offset)^2` of a pixel of value I.
        weight_offset: f64 = 0.05,
            unit "fraction of white", source Taste, effect "a larger value moves weight from dark to bright pixels";
        /// Weight of a radiance's distance from the likely colors (daylight and bulbs), relative to
        /// the data.
        color_weight: f64 = 0.3,
            unit "1", source Measured("rooms of docs/accuracy.md"),
            effect "a larger value makes lights less colorful";
        /// Direction of warm light in log(r / g), 0, log(b / g): black bodies lie near this line,
        /// 2700 K at 1.7 times it from 6500 K.
        warm: [f64; 3] = [0.55, 0.0, -0.835],
            unit "1", source Derived("black bodies in linear Rec.709"),
            effect "another direction makes other colors likely";
        /// Largest distance of a likely color from the mean light along `warm`, in either
        /// direction.
        max_warmth: f64 = 1.5,
            unit "lengths of `warm`", source Taste, effect "a larger value makes more saturated bulbs likely";
        /// Least channel of a radiance of which the likely color is looked up.
        min_color: f64 = 0.02,
            unit "fraction of the sum of its channels", source Taste,
            effect "a larger value makes lights without one channel less warm or cold";
        /// Least radiance of which the likely color is looked up.
        min_radiance: f64 = 1e-12,
            unit "the mean shading", source Derived("rounding of 64 bits"),
            effect "none above rounding: the logarithm of 0 is avoided";
        /// Weight of staying at the last iterate, relative to the data: lights that look the same
        /// share equally.
        proximal_weight: f64 = 1e-9,
            unit "1", source Derived("rounding of 64 bits"),
            effect "columns that differ by more than 1e-4 do not feel it; a larger value slows convergence";
        /// Contribution to the mean shading below which a light is off.
        off: f64 = 1e-9,
            unit "fraction of the mean shading", source Derived("rounding of 64 bits"),
            effect "a larger value turns weak lights off; radiances in 1e6 : 1 remain distinguishable from off";
        /// Mean of a layer below which it is black.
        black_layer: f64 = 1e-30,
            unit "shading per unit radiance", source Derived("range of 32-bit numbers"),
            effect "a larger value gives fewer lights a radiance; those up to 1e30 times white are finite";
        /// Least albedo of a segment.
        min_albedo: f64 = 1e-3,
            unit "albedo", source Derived("rounding of 64 bits"),
            effect "a larger value lowers the shading of dark segments; a segment's shading stays finite";
        /// Unknowns up to which each iteration starts its active set from nothing; larger problems
        /// start from the last iterate.
        cold_start_unknowns: usize = 99,
            unit "unknowns of all channels", source Measured("run time; no page records it"),
            effect "a larger value is slower for many lights";
        /// Largest fraction of each computed step that is taken: weights and projection belong to
        /// the last iterate, and full steps overshoot.
        step_fraction: f64 = 0.7,
            unit "1", source Measured("no page records it"), effect "a larger value converges faster or oscillates";
    }
}

/// Expected model error of a pixel, in units of white.
fn sigma(value: f64) -> f64 {
    FIT_PROBLEM.relative_error * value + FIT_PROBLEM.error_floor
}

/// Factors that bring each column to mean 1, so that start, prior and tolerances have the same unit
/// for each; 0 for a black one.
pub(super) fn scales<'c>(columns: impl Iterator<Item = &'c Column<'c>>) -> Vec<f64> {
    let scale = |c: &Column| {
        let mean = c.layer.iter().map(|v| f64::from(v.element_sum())).sum::<f64>()
            / (3 * c.layer.len()) as f64;
        if mean > FIT_PROBLEM.black_layer { 1.0 / mean } else { 0.0 }
    };
    columns.map(scale).collect()
}

/// The data of one fit. Weights `w` of its methods have one entry per column and channel, in units
/// of mean shading.
pub(super) struct Problem<'a> {
    observations: &'a Observations,
    l1_weight: Vec<f64>,
    tikhonov_weight: Vec<f64>,
    hue_weight: Vec<f64>,
    /// Number of equal columns that each column stands for.
    pub count: Vec<f64>,
    /// Contribution of each column under the guess that all contribute equally.
    equal_share: f64,
    /// Per channel and pixel.
    photo: [Vec<f64>; 3],
    /// Weight of each pixel before the Cauchy weight, per channel.
    weight: [Vec<f64>; 3],
    /// Energy of the photo under these weights, per channel.
    energy: [f64; 3],
    /// Per channel, one row of all columns per pixel.
    pub layer: [Vec<f64>; 3],
    /// Mean of each column, per channel.
    pub mean: [Vec<f64>; 3],
}

impl<'a> Problem<'a> {
    /// The problem of `columns`, multiplied with `scale`, for a photo of this `white` > 0.
    pub fn new(
        observations: &'a Observations,
        columns: &[Column],
        scale: &[f64],
        prior: &LightPrior,
        white: f64,
    ) -> Problem<'a> {
        let columns: Vec<&Column> = columns.iter().collect();
        let count = vec![1.0; columns.len()];
        Problem::shared(observations, &columns, count, scale, prior, white)
    }

    /// The same with columns that stand for `count` equal ones each. Their weights are sums over
    /// the equal columns.
    pub fn shared(
        observations: &'a Observations,
        columns: &[&Column],
        count: Vec<f64>,
        scale: &[f64],
        prior: &LightPrior,
        white: f64,
    ) -> Problem<'a> {
        let (n, k) = (observations.photo.len(), columns.len());
        let photo = [0, 1, 2].map(|c| {
            observations.photo.iter().map(|v| f64::from(v[c]) / white).collect::<Vec<f64>>()
        });
        let layer = [0, 1, 2].map(|c| {
            let rows = (0..n).flat_map(|p| {
                columns.iter().zip(scale).map(move |(j, s)| f64::from(j.layer[p][c]) * s)
            });
            rows.collect::<Vec<f64>>()
        });
        let tikhonov_weight: Vec<f64> =
            columns.iter().map(|c| prior.tikhonov_weight(c.role)).collect();
        let guessed = tikhonov_weight
            .iter()
            .zip(scale)
            .zip(&count)
            .filter(|((t, s), _)| **t > 0.0 && **s > 0.0);
        let equal_share = 1.0 / guessed.map(|(_, count)| count).sum::<f64>().max(1.0);
        let weight = |i: &f64| i.sqrt() / (i + FIT_PROBLEM.weight_offset).powi(2);
        let weight = photo.each_ref().map(|photo| photo.iter().map(weight).collect::<Vec<f64>>());
        let energy = [0, 1, 2]
            .map(|c| weight[c].iter().zip(&photo[c]).map(|(weight, i)| weight * i * i).sum());
        Problem {
            observations,
            l1_weight: columns.iter().map(|c| prior.l1_weight(c.role)).collect(),
            tikhonov_weight,
            hue_weight: columns.iter().map(|c| prior.hue_weight(c.role)).collect(),
            count,
            equal_share,
            weight,
            energy,
            photo,
            mean: layer.each_ref().map(|layer| {
                (0..k).map(|j| layer.iter().skip(j).step_by(k).sum::<f64>() / n as f64).collect()
            }),
            layer,
        }
    }

    /// One iteration: moves `w` by the fraction `step` towards the solution of the problem
    /// linearized at `w`. Returns the Gram matrix of each channel, k x k, row by row.
    pub fn iterate(&self, w: &mut [[f64; 3]], step: f64) -> [Vec<f64>; 3] {
        let k = w.len();
        // The channels' equations, coupled only by the prior of colors: unknown c k + i is light i
        // in channel c.
        let size = 3 * k;
        let (mut all, mut right) = (vec![0.0; size * size], vec![0.0; size]);
        let mut color_weights = vec![0.0; k];
        let mut grams: [Vec<f64>; 3] = Default::default();
        let channels: Vec<Equations> =
            (0..3).into_par_iter().map(|c| self.equations(w, c)).collect();
        for (c, Equations { mut gram, mut b, energy }) in channels.into_iter().enumerate() {
            let gauge = self.energy[c];
            for i in 0..k {
                color_weights[i] +=
                    FIT_PROBLEM.color_weight / 3.0 * gram[i * k + i] / self.count[i];
                // The gauge, mean shading 1, as one more equation.
                b[i] += gauge * self.mean[c][i] - 0.5 * energy * self.l1_weight[i];
                for j in 0..k {
                    gram[i * k + j] += gauge * self.mean[c][i] * self.mean[c][j];
                }
            }
            grams[c] = gram.clone();
            for i in 0..k {
                b[i] += FIT_PROBLEM.proximal_weight * gram[i * k + i] * w[i][c];
                gram[i * k + i] *= 1.0 + FIT_PROBLEM.proximal_weight;
                b[i] += gauge * self.tikhonov_weight[i] * self.equal_share;
                gram[i * k + i] += gauge * self.tikhonov_weight[i] / self.count[i];
                right[c * k + i] = b[i];
                all[(c * k + i) * size + c * k..][..k].copy_from_slice(&gram[i * k..][..k]);
            }
        }
        let energy = self.energy() / 3.0;
        for i in 0..k {
            // |w - d (d . w)|^2 with d the likely color, and with d white, the color of the mean light: the
            // distance across d costs, the length along d does not.
            let d = likely_color(w[i]);
            let hue_weight = energy * self.hue_weight[i] / self.count[i];
            for (c, e) in (0..9).map(|n| (n / 3, n % 3)) {
                let own = f64::from(u8::from(c == e));
                let across =
                    color_weights[i] * (own - d[c] * d[e]) + hue_weight * (own - 1.0 / 3.0);
                all[(c * k + i) * size + e * k + i] += across;
            }
        }
        let start: Vec<f64> = (0..size).map(|i| w[i % k][i / k]).collect();
        let solved = if size > FIT_PROBLEM.cold_start_unknowns {
            nnls_from(&all, &right, &start)
        } else {
            nnls(&all, &right)
        };
        for (i, solved) in solved.into_iter().enumerate() {
            let old = &mut w[i % k][i / k];
            *old += step * (solved - *old);
            if solved == 0.0 && *old < FIT_PROBLEM.off {
                *old = 0.0;
            }
        }
        grams
    }

    /// Shading of each pixel in channel `c`.
    pub fn shading(&self, w: &[[f64; 3]], c: usize) -> Vec<f64> {
        self.layer[c]
            .chunks_exact(w.len())
            .map(|row| row.iter().zip(w).map(|(u, w)| u * w[c]).sum())
            .collect()
    }

    /// Residual of each pixel and its weight; both are 0 where a saturated pixel may be as bright
    /// as the model.
    pub fn residuals(&self, albedo: &[f64], shading: &[f64], c: usize) -> (Vec<f64>, Vec<f64>) {
        let Observations { segment, saturated, .. } = self.observations;
        let both = (0..shading.len()).map(|p| {
            let (wanted, model) = (self.photo[c][p], albedo[segment[p] as usize] * shading[p]);
            if saturated[p] && model >= wanted {
                return (0.0, 0.0);
            }
            let residual = wanted - model;
            (residual, self.weight[c][p] / (1.0 + (residual / sigma(wanted)).powi(2)))
        });
        both.unzip()
    }

    /// Gram matrix and right side of the step from `w`, with the albedos eliminated: the albedo of
    /// a segment absorbs the change of a light along its shading (variable projection, Golub and
    /// Pereyra 1973, linearized). Each column is projected before it is multiplied: the difference
    /// of two large products would cancel what distinguishes similar lights.
    fn equations(&self, w: &[[f64; 3]], c: usize) -> Equations {
        let (k, segment) = (w.len(), &self.observations.segment);
        let shading = self.shading(w, c);
        let albedo = self.albedo(&shading, c);
        let (residual, weight) = self.residuals(&albedo, &shading, c);
        let rows = || self.layer[c].chunks_exact(k).enumerate();
        let mut norm = vec![0.0; self.observations.segments];
        let mut along = vec![0.0; self.observations.segments * k];
        for (p, row) in rows() {
            let s = segment[p] as usize;
            norm[s] += weight[p] * shading[p] * shading[p];
            let along = &mut along[s * k..][..k];
            along.iter_mut().zip(row).for_each(|(a, u)| *a += weight[p] * u * shading[p]);
        }
        for (along, norm) in along.chunks_exact_mut(k).zip(&norm) {
            along.iter_mut().for_each(|a| *a = if *norm > 0.0 { *a / norm } else { 0.0 });
        }
        let (mut gram, mut b) = (vec![0.0; k * k], vec![0.0; k]);
        let mut v = vec![0.0; k];
        for (p, row) in rows() {
            let s = segment[p] as usize;
            for i in 0..k {
                v[i] = albedo[s] * (row[i] - along[s * k + i] * shading[p]);
                b[i] += weight[p] * albedo[s] * row[i] * residual[p];
                for j in 0..=i {
                    gram[i * k + j] += weight[p] * v[i] * v[j];
                }
            }
        }
        for i in 0..k {
            for j in 0..i {
                gram[j * k + i] = gram[i * k + j];
            }
        }
        for i in 0..k {
            b[i] += (0..k).map(|j| gram[i * k + j] * w[j][c]).sum::<f64>();
        }
        let energy = weight.iter().zip(&self.photo[c]).map(|(weight, i)| weight * i * i).sum();
        Equations { gram, b, energy }
    }

    /// Least-squares albedo of each segment under this shading: sum(w I E) / sum(w E^2) over its
    /// unsaturated pixels.
    pub fn albedo(&self, shading: &[f64], c: usize) -> Vec<f64> {
        let mut top = vec![0.0; self.observations.segments];
        let mut bottom = vec![0.0; self.observations.segments];
        for p in (0..shading.len()).filter(|&p| !self.observations.saturated[p]) {
            let (s, weight) = (self.observations.segment[p] as usize, self.weight[c][p]);
            top[s] += weight * self.photo[c][p] * shading[p];
            bottom[s] += weight * shading[p] * shading[p];
        }
        // A segment that is clipped everywhere, or in full shadow, is taken as white: it does not
        // constrain the lights.
        top.iter()
            .zip(&bottom)
            .map(|(t, b)| if *b > 0.0 { (t / b).max(FIT_PROBLEM.min_albedo) } else { 1.0 })
            .collect()
    }

    /// Weighted energy of the photo, summed over pixels and channels.
    pub fn energy(&self) -> f64 {
        self.energy.iter().sum()
    }

    /// The objective of the iterations without the Tikhonov and color terms: the weighted sum of
    /// the Cauchy losses sigma^2 log(1 + r^2) and the L1 costs, as a fraction of the photo's
    /// weighted energy.
    pub fn objective(&self, w: &[[f64; 3]]) -> f64 {
        let energy = self.energy();
        let channel = |c: usize| -> f64 {
            let shading = self.shading(w, c);
            let (residual, _) = self.residuals(&self.albedo(&shading, c), &shading, c);
            let cauchy = |p: usize| {
                let sigma = sigma(self.photo[c][p]);
                self.weight[c][p] * sigma * sigma * (residual[p] / sigma).powi(2).ln_1p()
            };
            (0..residual.len()).map(cauchy).sum()
        };
        let misfit: f64 = (0..3).map(channel).sum();
        let cost: f64 =
            self.l1_weight.iter().zip(w).map(|(l1, w)| l1 * w.iter().sum::<f64>() / 3.0).sum();
        if energy > 0.0 { misfit / energy + cost } else { cost }
    }

    /// Albedos of one channel, and the sum of log(1 + r^2) over the pixels.
    pub fn explained(&self, w: &[[f64; 3]], c: usize) -> (Vec<f64>, f64) {
        let shading = self.shading(w, c);
        let albedo = self.albedo(&shading, c);
        let (residual, _) = self.residuals(&albedo, &shading, c);
        let misfit = residual
            .iter()
            .zip(&self.photo[c])
            .map(|(r, &wanted)| (r / sigma(wanted)).powi(2).ln_1p());
        (albedo, misfit.sum())
    }
}

/// Normal equations `gram w = b` of one channel, and the photo's weighted energy.
struct Equations {
    gram: Vec<f64>,
    b: Vec<f64>,
    energy: f64,
}

/// The color nearest to `w` that daylight or a bulb may have, of unit length, in the gauge in which
/// the mean light is white.
///
/// Black bodies lie near the line log(r / g, b / g) = t (0.55, -0.835): 2700 K is at t = 1.7 from
/// 6500 K. The same holds for their ratios, and so in any white balance.
pub(super) fn likely_color(w: [f64; 3]) -> [f64; 3] {
    let FitProblemTuning { warm, max_warmth, min_color, min_radiance, .. } = FIT_PROBLEM;
    let floor = min_color * w.iter().sum::<f64>() + min_radiance;
    let [r, g, b] = w.map(|v| v.max(floor).ln());
    let t = (warm[0] * (r - g) + warm[2] * (b - g)).clamp(-max_warmth, max_warmth);
    let color = warm.map(|v| (v * t).exp());
    let length = color.iter().map(|v| v * v).sum::<f64>().sqrt();
    color.map(|v| v / length)
}
