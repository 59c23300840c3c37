//! How strong each light is: radiances and segment albedos that explain a photo together.
//!
//! The photo is `I_p = A_s(p) sum_k w_k u_k(p)` per colour channel, with u_k the unit layer of light k (its own shadow and its
//! own indirect light included), w_k >= 0 its radiance and A_s one albedo for all pixels of a segment. What tells the
//! lights apart is how shading varies *inside* a segment; the albedo of a segment takes up the rest, so that texture and
//! paint are never pressed into a light. Solved by turns: given w, each A_s is a ratio of sums; given A, w is a non-negative
//! least squares problem in what the albedos cannot take up (variable projection); a Cauchy weight keeps highlights and wrong shadows from pulling (iteratively reweighted).

use glam::{DVec3, Vec3};

use super::nnls;
use crate::image::{Mask, Picture, Segments, around, luminance};

/// A photo on the pixels that take part in a fit.
pub struct Evidence {
    /// Linear photo.
    pub photo: Vec<Vec3>,
    /// Segment of each pixel, below `segments`.
    pub segment: Vec<u32>,
    pub segments: usize,
    /// Where the photo is clipped: there the model may be brighter at no cost, but not darker.
    pub saturated: Vec<bool>,
}

impl Evidence {
    /// The photo at `pixels`: the mean over the pixels of the same segment within `radius` of each.
    pub fn at(photo: &Picture, clipped: &Mask, segments: &Segments, pixels: &[usize], radius: usize) -> Evidence {
        let (w, h) = photo.0.size();
        let mean = |&pixel: &usize| {
            let (x, y, label) = (pixel % w, pixel / w, segments.label.pixels()[pixel]);
            let (mut sum, mut clip, mut count) = (Vec3::ZERO, 0.0, 0.0);
            for y in y.saturating_sub(radius)..(y + radius + 1).min(h) {
                for x in x.saturating_sub(radius)..(x + radius + 1).min(w) {
                    if segments.label.get(x, y) == label {
                        sum += photo.0.get(x, y);
                        clip += clipped.0.get(x, y);
                        count += 1.0;
                    }
                }
            }
            (sum / count, clip / count > 0.02)
        };
        let (photo, saturated) = pixels.iter().map(mean).unzip();
        Evidence {
            photo,
            segment: pixels.iter().map(|&p| segments.label.pixels()[p]).collect(),
            segments: segments.count as usize,
            saturated,
        }
    }
}

/// The pixels of `candidates` that say something about the lights: bright enough to be told from black, and away (by two
/// pixels) from every one of `masks`, which mark lights and what is no part of the room.
pub fn evidence_pixels<'a>(
    candidates: impl Iterator<Item = usize>,
    photo: &Picture,
    masks: impl Iterator<Item = &'a Mask>,
) -> Vec<usize> {
    let taken = around(masks, photo.0.size(), 2);
    candidates.filter(|&i| !taken.pixels()[i] && luminance(photo.0.pixels()[i]) > 0.004).collect()
}

/// One light lobe's unit layer on the pixels of an [`Evidence`], and how much it must earn its place.
pub struct Column<'a> {
    pub layer: &'a [Vec3],
    /// Cost of explaining the whole photo by this column, as a share of the photo's weighted energy; 0 for a light that is
    /// seen.
    pub penalty: f64,
}

/// What a fit found.
#[derive(Clone, Debug)]
pub struct RadianceFit {
    /// Radiance per column.
    pub radiance: Vec<Vec3>,
    /// Albedo per segment.
    pub albedo: Vec<Vec3>,
    /// Mean of log(1 + r^2), r the residual over its expected size: 0 is perfect.
    pub loss: f64,
    /// Condition number of the columns in use, each scaled to unit length: large means that lights look alike.
    pub condition: f64,
}

/// Expected model error: a share of the pixel, plus a floor at about two 8-bit steps.
fn sigma(value: f64) -> f64 {
    0.15 * value + 0.01
}

/// A light has a colour of daylight or bulbs unless the photo says otherwise: weight of what is not, relative to the data.
const COLOUR_PULL: f64 = 0.3;

/// Least channel of a light over its largest, in the gauge in which the mean light is white: a bulb of 2500 K has 0.07. Without
/// it a change of colour would be a division by zero.
const PUREST: f64 = 0.07;

/// Share of each computed step that is taken: weights and projection belong to the last state, full steps overshoot.
const STEP: f64 = 0.7;

/// Fits radiances by `turns` rounds. The gauge (a light twice as bright in a room half as white looks the same) is set so
/// that the mean shading of each channel is 1; [`RadianceFit::with_albedo_of`] sets another.
pub fn fit_radiances(evidence: &Evidence, columns: &[Column], turns: usize) -> RadianceFit {
    let (n, k) = (evidence.photo.len(), columns.len());
    if n == 0 || k == 0 {
        return RadianceFit {
            radiance: vec![Vec3::ZERO; k],
            albedo: vec![Vec3::ZERO; evidence.segments],
            loss: 0.0,
            condition: 1.0,
        };
    }
    // Columns scaled to mean 1 so that the start, the penalty and the tolerances mean the same for each.
    let scale: Vec<f64> = columns
        .iter()
        .map(|c| c.layer.iter().map(|v| f64::from(v.element_sum())).sum::<f64>() / (3 * n) as f64)
        .map(|mean| if mean > 1e-12 { 1.0 / mean } else { 0.0 })
        .collect();
    let mut w = vec![[1.0 / k as f64; 3]; k];
    let photo: Vec<[f64; 3]> = evidence.photo.iter().map(|v| v.as_dvec3().to_array()).collect();
    let base_weight: Vec<[f64; 3]> = photo.iter().map(|v| v.map(|i| i.sqrt() / (i + 0.05).powi(2))).collect();
    let mut condition = 1.0;
    for _ in 0..turns {
        // The channels' equations, coupled only by the pull on each light's colour: unknown c k + i is light i in channel c.
        let size = 3 * k;
        let (mut all, mut right) = (vec![0.0; size * size], vec![0.0; size]);
        let mut pulls = vec![0.0; k];
        for c in 0..3 {
            let layer = |j: usize, p: usize| f64::from(columns[j].layer[p][c]) * scale[j];
            let shading: Vec<f64> = (0..n).map(|p| (0..k).map(|j| w[j][c] * layer(j, p)).sum()).collect();
            let albedo = segment_albedo(evidence, &base_weight, &photo, &shading, c);
            let (mut weight, mut residual) = (vec![0.0; n], vec![0.0; n]);
            let mut energy = 0.0;
            for p in 0..n {
                let (wanted, model) = (photo[p][c], albedo[evidence.segment[p] as usize] * shading[p]);
                if evidence.saturated[p] && model >= wanted {
                    continue;
                }
                residual[p] = wanted - model;
                let r = residual[p] / sigma(wanted);
                weight[p] = base_weight[p][c] / (1.0 + r * r);
                energy += weight[p] * wanted * wanted;
            }
            let mean: Vec<f64> = (0..k).map(|j| (0..n).map(|p| layer(j, p)).sum::<f64>() / n as f64).collect();
            let now: Vec<f64> = w.iter().map(|w| w[c]).collect();
            let (mut gram, mut b) = normal_equations(evidence, &weight, &albedo, &shading, &residual, &now, layer);
            for i in 0..k {
                pulls[i] += COLOUR_PULL / 3.0 * gram[i * k + i];
                b[i] += energy * (mean[i] - 0.5 * columns[i].penalty);
                // The gauge, mean shading 1, as one more equation.
                for j in 0..k {
                    gram[i * k + j] += energy * mean[i] * mean[j];
                }
            }
            if c == 1 {
                condition = condition_number(&gram, k);
            }
            for i in 0..k {
                right[c * k + i] = b[i];
                all[(c * k + i) * size + c * k..][..k].copy_from_slice(&gram[i * k..][..k]);
            }
        }
        for i in 0..k {
            // |w - d (d . w)|^2 with d the likely colour: costs what is across it, and nothing along it.
            let d = likely_colour(w[i]);
            for (c, e) in (0..9).map(|n| (n / 3, n % 3)) {
                let across = f64::from(u8::from(c == e)) - d[c] * d[e];
                all[(c * k + i) * size + e * k + i] += pulls[i] * across;
            }
        }
        for (i, solved) in nnls(&all, &right).into_iter().enumerate() {
            let old = &mut w[i % k][i / k];
            *old += STEP * (solved - *old);
        }
        // Gauge: mean shading 1 in each channel.
        for c in 0..3 {
            let mean = (0..k)
                .filter(|&j| scale[j] > 0.0)
                .map(|j| w[j][c] * columns[j].layer.iter().map(|v| f64::from(v[c])).sum::<f64>() * scale[j] / n as f64);
            let mean: f64 = mean.sum();
            if mean > 1e-12 {
                w.iter_mut().for_each(|v| v[c] /= mean);
            }
        }
    }
    for w in &mut w {
        let least = PUREST * w[0].max(w[1]).max(w[2]);
        w.iter_mut().for_each(|v| *v = v.max(least));
    }
    let mut loss = 0.0;
    let mut albedo = vec![Vec3::ZERO; evidence.segments];
    for c in 0..3 {
        let layer = |j: usize, p: usize| f64::from(columns[j].layer[p][c]) * scale[j];
        let shading: Vec<f64> = (0..n).map(|p| (0..k).map(|j| w[j][c] * layer(j, p)).sum()).collect();
        let a = segment_albedo(evidence, &base_weight, &photo, &shading, c);
        for p in 0..n {
            let (wanted, model) = (photo[p][c], a[evidence.segment[p] as usize] * shading[p]);
            if !(evidence.saturated[p] && model >= wanted) {
                let r = (wanted - model) / sigma(wanted);
                loss += (r * r).ln_1p();
            }
        }
        albedo.iter_mut().zip(&a).for_each(|(albedo, &a)| albedo[c] = a as f32);
    }
    let radiance = w.iter().zip(&scale).map(|(w, s)| (DVec3::from_array(*w) * *s).as_vec3()).collect();
    RadianceFit { radiance, albedo, loss: loss / (3 * n) as f64, condition }
}

impl RadianceFit {
    /// The same fit in the gauge in which albedo agrees, in the geometric mean over `segment`s, with `albedo`.
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
}

/// The nearest colour to `w` that daylight or a bulb may have, unit length, in the gauge in which the mean light is white.
///
/// Black bodies lie near the line log(r / g, b / g) = t (0.55, -0.835): 2700 K is at t = 1.7 from 6500 K. The same holds for
/// their ratios, and so in any white balance.
fn likely_colour(w: [f64; 3]) -> [f64; 3] {
    const WARM: [f64; 3] = [0.55, 0.0, -0.835];
    const MOST: f64 = 1.5;
    let floor = 0.02 * w.iter().sum::<f64>() + 1e-12;
    let [r, g, b] = w.map(|v| v.max(floor).ln());
    let t = (WARM[0] * (r - g) + WARM[2] * (b - g)).clamp(-MOST, MOST);
    let colour = WARM.map(|v| (v * t).exp());
    let length = colour.iter().map(|v| v * v).sum::<f64>().sqrt();
    colour.map(|v| v / length)
}

/// Gram matrix and right side of the step from the radiances `now`, after each segment's albedo has answered: what a light
/// moves along the shading of a segment is taken up by its albedo (variable projection, Golub and Pereyra 1973, linearised).
fn normal_equations(
    evidence: &Evidence,
    weight: &[f64],
    albedo: &[f64],
    shading: &[f64],
    residual: &[f64],
    now: &[f64],
    layer: impl Fn(usize, usize) -> f64,
) -> (Vec<f64>, Vec<f64>) {
    let k = now.len();
    let (mut gram, mut b) = (vec![0.0; k * k], vec![0.0; k]);
    let mut norm = vec![0.0; evidence.segments];
    let mut along = vec![0.0; evidence.segments * k];
    for p in 0..shading.len() {
        let s = evidence.segment[p] as usize;
        norm[s] += weight[p] * shading[p] * shading[p];
        for i in 0..k {
            let u = weight[p] * albedo[s] * layer(i, p);
            along[s * k + i] += u * shading[p];
            b[i] += u * residual[p];
            for j in 0..=i {
                gram[i * k + j] += u * albedo[s] * layer(j, p);
            }
        }
    }
    for (s, along) in along.chunks_exact(k).enumerate().filter(|&(s, _)| norm[s] > 1e-12) {
        for i in 0..k {
            for j in 0..=i {
                gram[i * k + j] -= along[i] * along[j] / norm[s];
            }
        }
    }
    for i in 0..k {
        for j in 0..i {
            gram[j * k + i] = gram[i * k + j];
        }
    }
    for i in 0..k {
        b[i] += (0..k).map(|j| gram[i * k + j] * now[j]).sum::<f64>();
    }
    (gram, b)
}

/// Least-squares albedo of each segment under the current shading: sum(w I E) / sum(w E^2).
fn segment_albedo(
    evidence: &Evidence,
    weight: &[[f64; 3]],
    photo: &[[f64; 3]],
    shading: &[f64],
    channel: usize,
) -> Vec<f64> {
    let mut top = vec![0.0; evidence.segments];
    let mut bottom = vec![0.0; evidence.segments];
    for p in 0..photo.len() {
        if evidence.saturated[p] {
            continue;
        }
        let s = evidence.segment[p] as usize;
        top[s] += weight[p][channel] * photo[p][channel] * shading[p];
        bottom[s] += weight[p][channel] * shading[p] * shading[p];
    }
    // A segment that is clipped everywhere, or in full shadow, is taken as white: it says nothing of the lights.
    top.iter().zip(&bottom).map(|(t, b)| if *b > 1e-12 { (t / b).max(1e-3) } else { 1.0 }).collect()
}

/// Condition number of the columns of a Gram matrix after scaling each to unit length, by Jacobi rotations.
fn condition_number(gram: &[f64], k: usize) -> f64 {
    let used: Vec<usize> = (0..k).filter(|&i| gram[i * k + i] > 0.0).collect();
    let m = used.len();
    let mut a: Vec<f64> = used
        .iter()
        .flat_map(|&i| used.iter().map(move |&j| (i, j)))
        .map(|(i, j)| gram[i * k + j] / (gram[i * k + i] * gram[j * k + j]).sqrt())
        .collect();
    for _ in 0..30 {
        for p in 0..m {
            for q in p + 1..m {
                if a[p * m + q].abs() < 1e-15 {
                    continue;
                }
                let theta = 0.5 * (a[q * m + q] - a[p * m + p]) / a[p * m + q];
                let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
                let t = if theta == 0.0 { 1.0 } else { t };
                let (cos, sin) = (1.0 / t.hypot(1.0), t / t.hypot(1.0));
                for i in 0..m {
                    let (x, y) = (a[i * m + p], a[i * m + q]);
                    (a[i * m + p], a[i * m + q]) = (cos * x - sin * y, sin * x + cos * y);
                }
                for i in 0..m {
                    let (x, y) = (a[p * m + i], a[q * m + i]);
                    (a[p * m + i], a[q * m + i]) = (cos * x - sin * y, sin * x + cos * y);
                }
            }
        }
    }
    let (low, high) =
        (0..m).map(|i| a[i * m + i]).fold((f64::INFINITY, 0.0f64), |(l, h), v| (l.min(v.max(1e-15)), h.max(v)));
    if m == 0 { 1.0 } else { high / low }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of pixels in four segments under two lights that fall off from either end.
    fn row() -> (Evidence, Vec<Vec3>, Vec<Vec3>) {
        let n = 400;
        let from = |x: f32| Vec3::splat(1.0 / (0.3 + x * x));
        let left: Vec<Vec3> = (0..n).map(|i| from(i as f32 / n as f32)).collect();
        let right: Vec<Vec3> = (0..n).map(|i| from(1.0 - i as f32 / n as f32)).collect();
        let paint = [Vec3::splat(0.8), Vec3::new(0.7, 0.2, 0.1), Vec3::new(0.1, 0.3, 0.6), Vec3::splat(0.3)];
        let segment: Vec<u32> = (0..n).map(|i| i as u32 / 100).collect();
        let (w0, w1) = (Vec3::new(0.3, 0.25, 0.2), Vec3::new(0.05, 0.1, 0.15));
        let photo = (0..n).map(|i| paint[i / 100] * (w0 * left[i] + w1 * right[i])).collect();
        (Evidence { photo, segment, segments: 4, saturated: vec![false; n] }, left, right)
    }

    fn columns<'a>(layers: &[&'a [Vec3]]) -> Vec<Column<'a>> {
        layers.iter().map(|layer| Column { layer, penalty: 0.0 }).collect()
    }

    #[test]
    fn shares_of_two_lights_over_unknown_paint_are_found() {
        let (evidence, left, right) = row();
        let fit = fit_radiances(&evidence, &columns(&[&left, &right]), 60);
        // Only the share of each light in each channel is determined: 0.3 : 0.05, 0.25 : 0.1, 0.2 : 0.15.
        let ratio = fit.radiance[1] / fit.radiance[0];
        let truth = Vec3::new(0.05 / 0.3, 0.4, 0.75);
        // The second light is 0.3 off the line of likely colours in log(r / g); the pull draws it half of the way.
        assert!(((ratio - truth) / truth).abs().max_element() < 0.2, "{ratio} against {truth}");
        assert!(fit.loss < 1e-2, "loss {}", fit.loss);
    }

    #[test]
    fn a_light_that_explains_nothing_gets_nothing() {
        let (evidence, left, right) = row();
        let stripes: Vec<Vec3> = (0..400).map(|i| Vec3::splat(if i % 2 == 0 { 1.0 } else { 0.0 })).collect();
        let mut columns = columns(&[&left, &right, &stripes]);
        columns[2].penalty = 0.02;
        let fit = fit_radiances(&evidence, &columns, 60);
        assert!(fit.radiance[2].max_element() < 1e-3 * fit.radiance[0].min_element(), "{:?}", fit.radiance);
    }

    #[test]
    fn clipped_pixels_do_not_darken_a_light() {
        let (mut evidence, left, right) = row();
        for p in 0..400 {
            // The left segment is white and clipped near its lamp.
            if evidence.photo[p].max_element() > 0.6 {
                evidence.saturated[p] = true;
                evidence.photo[p] = evidence.photo[p].min(Vec3::splat(0.6));
            }
        }
        let fit = fit_radiances(&evidence, &columns(&[&left, &right]), 60);
        let ratio = fit.radiance[1].y / fit.radiance[0].y;
        assert!((ratio - 0.4).abs() < 0.08, "ratio {ratio}");
    }

    #[test]
    fn degenerate_evidence_is_finite() {
        let empty = Evidence { photo: vec![], segment: vec![], segments: 0, saturated: vec![] };
        assert!(fit_radiances(&empty, &[], 5).radiance.is_empty());
        let n = 10;
        for photo in [vec![Vec3::ZERO; n], vec![Vec3::ONE; n]] {
            for saturated in [false, true] {
                let evidence =
                    Evidence { photo: photo.clone(), segment: vec![0; n], segments: 1, saturated: vec![saturated; n] };
                let (zero, one) = (vec![Vec3::ZERO; n], vec![Vec3::ONE; n]);
                let fit = fit_radiances(&evidence, &columns(&[&zero, &one, &one]), 10);
                assert!(fit.radiance.iter().all(|w| w.is_finite() && w.min_element() >= 0.0), "{fit:?}");
                assert!(fit.loss.is_finite() && fit.condition >= 1.0, "{fit:?}");
            }
        }
    }

    #[test]
    fn the_condition_number_of_two_columns_is_its_closed_form() {
        // Unit columns at angle t: eigenvalues 1 +- cos t.
        let c = 0.6;
        let got = condition_number(&[4.0, 2.0 * 3.0 * c, 2.0 * 3.0 * c, 9.0], 2);
        assert!((got - (1.0 + c) / (1.0 - c)).abs() < 1e-9, "{got}");
    }
}
