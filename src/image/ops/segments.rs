//! Surfaces of one material, from a photo alone: the classical color Retinex on regions.
//!
//! Retinex (Land and McCann 1971; the color form of Grosse et al., ICCV 2009): shading varies
//! slowly and is nearly gray, so a sharp step of intensity or a change of chromaticity between
//! neighbors is a change of albedo. Here pixels that no such step separates form a segment of one
//! albedo, and the albedos of segments are found together, in the logarithm, from the steps along
//! their borders.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::cell_noise::{noise_of_cells, without_noise};
use crate::image::{Albedo, Normal, Picture, Plane, intensity_and_chroma, log_above};
use crate::tuning::tuning;

/// The segment of each pixel, numbered from 0 without gaps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Segments {
    /// Segment of each pixel, 0..`count`.
    pub label: Plane<u32>,
    /// Number of segments.
    pub count: u32,
}

impl Segments {
    /// Checks that every label is below the number of segments.
    ///
    /// # Errors
    /// The rule that does not hold.
    pub fn check(&self) -> Result<(), String> {
        crate::image::rule(
            self.label.pixels().iter().all(|&label| label < self.count),
            "labels below the count of segments",
        )
    }
}

tuning! {
    /// Constants of segmentation and of color Retinex.
    pub const TUNING: SegmentsTuning {
        /// Least linear value that differs from black: about the first step of an 8-bit sRGB photo.
        black: f32 = 0.002,
            unit "units of the photo", source Derived("quantization of 8-bit photos"),
            effect "a larger value makes dark pixels alike";
        /// Difference of log color by which the own cell of a pixel is preferred to its neighbors.
        own_cell: f32 = 0.02,
            unit "1", source Taste, effect "a larger value makes the outlines of segments blockier";
        /// Noise of a pixel over that of its cell: in noisy photos, the own cell is preferred by as
        /// much.
        pixel_noise: f32 = 3.0,
            unit "1", source Derived("4 in cells of 4 x 4 independent pixels; noise is blurred"),
            effect "a larger value makes the outlines of segments of noisy photos blockier";
        /// Cosine between the normals of two cells above which shading is continuous between them.
        smooth_normal: f32 = 0.95,
            unit "1", source Taste, effect "a larger value takes more neighbors for creases";
        /// Change of log chromaticity below which two surfaces across a crease are of one material.
        same_chroma: f32 = 0.15,
            unit "1", source Taste, effect "a larger value gives more neighbors one albedo";
        /// Weights of the step of the photo and of equal albedos across a crease between surfaces
        /// of like chromaticity.
        crease_same: [f32; 2] = [0.05, 0.3],
            unit "weight of a step on a smooth surface", source Taste,
            effect "a larger second value gives such surfaces one albedo";
        /// Weight of the step of the photo across a crease between other surfaces.
        crease_other: f32 = 0.1,
            unit "weight of a step on a smooth surface", source Taste,
            effect "a larger value takes more of a change of shading for paint";
        /// Weight of the anchor to the photo's own colors, which keeps islands finite.
        anchor: f32 = 0.01,
            unit "weight of a step on a smooth surface", source Taste,
            effect "a larger value moves shading into the albedo";
        /// Contrast of the anchor over that of the segments' own colors.
        anchor_contrast: f32 = 0.5,
            unit "1", source Taste, effect "a larger value moves shading into the albedo";
        /// Gauss-Seidel sweeps.
        sweeps: usize = 200,
            unit "sweeps", source Derived("the change per sweep is then below a display step"),
            effect "a smaller value leaves differences between distant segments";
        /// Quantile of the luminance of the albedo that is scaled to the parameter `bright`.
        bright_tenths: usize = 9,
            unit "tenths", source Taste, effect "a larger value darkens rooms with few white surfaces";
        /// Mean albedo of rooms over its green: wood and cloth make it warm.
        warm_albedo: [f32; 3] = [1.06, 1.0, 0.95],
            unit "1", source Measured("four rooms of ../shared/truth; in 20 others 1.23, 1, 0.81 is worse"),
            effect "a larger first value makes the estimated light bluer";
        /// Weight of that mean against the photo's own hue, which cameras correct in part.
        warm_albedo_weight: f32 = 0.7,
            unit "1", source Measured("docs/estimation.md, against 0"),
            effect "a larger value attributes the photo's mean hue to light, a smaller one to albedo";
        /// Least and largest estimated albedo.
        albedo_range: [f32; 2] = [0.02, 0.95],
            unit "albedo", source Taste,
            effect "a wider range lets dark surfaces take very bright shading, and indirect light converge more slowly";
    }
}

/// Least steps between neighboring cells that separate segments.
#[derive(Clone, Copy, Debug)]
pub struct Steps {
    /// Change of log chromaticity (natural logarithm, Euclidean).
    pub chroma: f32,
    /// Change of log intensity.
    pub intensity: f32,
}

impl Picture {
    /// Means over blocks of `stride` x `stride` pixels; the last row and column of blocks may be
    /// cut short.
    pub fn blocks(&self, stride: usize) -> Picture {
        let (w, h) = self.0.size();
        Picture(Plane::from_fn(w.div_ceil(stride), h.div_ceil(stride), |bx, by| {
            let (xs, ys) =
                (bx * stride..((bx + 1) * stride).min(w), by * stride..((by + 1) * stride).min(h));
            let count = (xs.len() * ys.len()) as f32;
            ys.flat_map(|y| xs.clone().map(move |x| (x, y)))
                .map(|(x, y)| self.0.get(x, y))
                .sum::<Vec3>()
                / count
        }))
    }
}

fn log_rgb(rgb: Vec3) -> Vec3 {
    log_above(TUNING.black, rgb)
}

/// Pairs of 4-neighbors of a `w` x `h` grid, as indices.
fn neighbors(w: usize, h: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..w * h).flat_map(move |i| {
        let right = (i % w + 1 < w).then_some((i, i + 1));
        let below = (i / w + 1 < h).then_some((i, i + w));
        right.into_iter().chain(below)
    })
}

/// Segments of a photo: cells of `stride` x `stride` pixels that no step separates are joined, then
/// each pixel takes the cell, of the nine around it, whose color is nearest. Noise that would
/// separate cells is averaged out before.
pub fn segment(photo: &Picture, stride: usize, steps: Steps) -> Segments {
    let cells = photo.blocks(stride).0;
    let (w, h) = cells.size();
    let noisy = cells.map(log_rgb);
    let noise = noise_of_cells(&noisy);
    let smooth = without_noise(&noisy, &noise, steps.chroma);
    let log = smooth.pixels();
    let mut parent: Vec<u32> = (0..(w * h) as u32).collect();
    fn find(parent: &mut [u32], mut i: u32) -> u32 {
        while parent[i as usize] != i {
            parent[i as usize] = parent[parent[i as usize] as usize];
            i = parent[i as usize];
        }
        i
    }
    for (a, b) in neighbors(w, h) {
        let step = log[a] - log[b];
        let (intensity, chroma) = intensity_and_chroma(step);
        if chroma.length() < steps.chroma && intensity.abs() < steps.intensity {
            let (a, b) = (find(&mut parent, a as u32), find(&mut parent, b as u32));
            let (low, high) = (a.min(b), a.max(b));
            parent[high as usize] = low;
        }
    }
    let mut number = vec![u32::MAX; w * h];
    let mut count = 0;
    let mut cell_label = vec![0; w * h];
    for (i, label) in cell_label.iter_mut().enumerate() {
        let root = find(&mut parent, i as u32) as usize;
        if number[root] == u32::MAX {
            number[root] = count;
            count += 1;
        }
        *label = number[root];
    }
    let label = Plane::from_fn(photo.0.width(), photo.0.height(), |x, y| {
        let (cx, cy) = (x / stride, y / stride);
        let color = log_rgb(photo.0.get(x, y));
        let own = noise[cy * w + cx];
        let own_noise = own.separates(steps.chroma) * own.chroma;
        let preference = TUNING.own_cell + TUNING.pixel_noise * own_noise;
        let (mut best, mut distance) = (cell_label[cy * w + cx], f32::INFINITY);
        for ny in cy.saturating_sub(1)..(cy + 2).min(h) {
            for nx in cx.saturating_sub(1)..(cx + 2).min(w) {
                // The own cell is preferred at equal color.
                let d = (log[ny * w + nx] - color).length()
                    + if (nx, ny) == (cx, cy) { 0.0 } else { preference };
                if d < distance {
                    (best, distance) = (cell_label[ny * w + nx], d);
                }
            }
        }
        best
    });
    Segments { label, count }
}

/// One albedo per segment.
///
/// With a the log albedo of a segment and I the photo, minimizes over all a, per channel, `sum w_pq
/// (a_s(p) - a_s(q) - (log I_p - log I_q))^2 + sum v_pq (a_s(p) - a_s(q))^2 + anchor`, over
/// neighbors p, q in different segments. On a smooth surface (equal normals) shading is continuous
/// and the step is albedo: w = 1. Across a crease shading jumps: w is small, and surfaces of like
/// chromaticity are taken for the same material: v > 0. Then the mean chromaticity of the albedo
/// becomes a mean, in logarithms, of that under the photo's own white balance (gray shading) and of
/// that of rooms (gray world; Buchsbaum, J. Franklin Inst. 310, 1980), and the 90th percentile of
/// albedo luminance becomes `bright`.
pub fn retinex(
    photo: &Picture,
    normal: &Normal,
    segments: &Segments,
    stride: usize,
    bright: f32,
) -> Albedo {
    let cells = photo.blocks(stride).0;
    let (w, h) = cells.size();
    let at = |i: usize| {
        let (x, y) = (i % w * stride + stride / 2, i / w * stride + stride / 2);
        (x.min(photo.0.width() - 1), y.min(photo.0.height() - 1))
    };
    let label = |i: usize| segments.label.get(at(i).0, at(i).1) as usize;
    let count = segments.count as usize;
    let log: Vec<Vec3> = cells.pixels().iter().map(|&c| log_rgb(c)).collect();

    // Normal equations as a list of couplings per segment: weight x (a_s - a_t - step).
    let mut couplings: Vec<Vec<(usize, f32, Vec3)>> = vec![Vec::new(); count];
    for (p, q) in neighbors(w, h) {
        let (s, t) = (label(p), label(q));
        if s == t {
            continue;
        }
        let step = log[p] - log[q];
        let (np, nq) = (normal.0.get(at(p).0, at(p).1), normal.0.get(at(q).0, at(q).1));
        let smooth = np.dot(nq) > TUNING.smooth_normal;
        let alike = intensity_and_chroma(step).1.length() < TUNING.same_chroma;
        let (continuous, equal) = match (smooth, alike) {
            (true, _) => (1.0, 0.0),
            (false, true) => TUNING.crease_same.into(),
            (false, false) => (TUNING.crease_other, 0.0),
        };
        for (weight, step) in [(continuous, step), (equal, Vec3::ZERO)] {
            if weight > 0.0 {
                couplings[s].push((t, weight, step));
                couplings[t].push((s, weight, -step));
            }
        }
    }
    // Start from the photo's own mean color; a weak anchor to it keeps islands finite.
    let mut sum = vec![Vec3::ZERO; count];
    let mut cells_of = vec![0.0f32; count];
    for i in 0..w * h {
        sum[label(i)] += log[i];
        cells_of[label(i)] += 1.0;
    }
    let mean = log.iter().copied().sum::<Vec3>() / (w * h).max(1) as f32;
    let start: Vec<Vec3> =
        (0..count).map(|s| if cells_of[s] > 0.0 { sum[s] / cells_of[s] } else { mean }).collect();
    let mut a = start.clone();
    // Gauss-Seidel in a fixed order.
    for _ in 0..TUNING.sweeps {
        for s in 0..count {
            let (mut weight, mut value) = (
                TUNING.anchor,
                TUNING.anchor * (mean + TUNING.anchor_contrast * (start[s] - mean)),
            );
            for &(t, v, step) in &couplings[s] {
                weight += v;
                value += v * (a[t] + step);
            }
            a[s] = value / weight;
        }
    }
    // log albedo + log shading = log photo; with gray shading the photo's hue is the albedo's.
    let mean_albedo = (0..w * h).map(|i| a[label(i)]).sum::<Vec3>() / (w * h).max(1) as f32;
    let warm = Vec3::from(TUNING.warm_albedo.map(f32::ln));
    let (_, shift) = intensity_and_chroma(mean.lerp(warm, TUNING.warm_albedo_weight) - mean_albedo);
    let exp = |v: Vec3| Vec3::new(v.x.exp(), v.y.exp(), v.z.exp());
    let mut albedo: Vec<Vec3> = a.iter().map(|&v| exp(v + shift)).collect();
    let mut levels: Vec<f32> =
        (0..w * h).map(|i| crate::image::luminance(albedo[label(i)])).collect();
    levels.sort_by(f32::total_cmp);
    let level =
        levels.get(levels.len() * TUNING.bright_tenths / 10).copied().unwrap_or(1.0).max(1e-6);
    let [least, most] = TUNING.albedo_range.map(Vec3::splat);
    for value in &mut albedo {
        *value = (*value * (bright / level)).clamp(least, most);
    }
    Albedo(segments.label.map(|s| albedo[s as usize]))
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEPS: Steps = Steps { chroma: 0.06, intensity: 0.12 };

    /// Two paints on one flat wall under a smooth shading gradient.
    fn wall() -> (Picture, Normal) {
        let picture = Plane::from_fn(64, 48, |x, _| {
            let albedo = if x < 32 { Vec3::splat(0.8) } else { Vec3::new(0.6, 0.2, 0.1) };
            albedo * (0.4 + 0.6 * x as f32 / 64.0)
        });
        (Picture(picture), Normal(Plane::filled(64, 48, Vec3::Z)))
    }

    #[test]
    fn a_gradient_does_not_split_a_wall_and_a_paint_does() {
        let (photo, _) = wall();
        let segments = segment(&photo, 4, STEPS);
        assert_eq!(segments.count, 2);
        assert_eq!(segments.label.get(0, 0), segments.label.get(31, 40));
        assert_ne!(segments.label.get(0, 0), segments.label.get(33, 0));
    }

    #[test]
    fn noise_does_not_split_a_wall() {
        let (Picture(mut photo), _) = wall();
        // Blocks of 4 x 4 pixels whose channels are up to a seventh too dark or too bright.
        for (i, value) in photo.pixels_mut().iter_mut().enumerate() {
            let block = i / 64 / 4 * 16 + i % 64 / 4;
            let wrong = |c: usize| ((block * (7 + 4 * c)) % 13) as f32 / 6.0 - 1.0;
            *value *= Vec3::ONE + Vec3::from_array([0, 1, 2].map(wrong)) / 7.0;
        }
        let segments = segment(&Picture(photo), 4, STEPS);
        let largest = |x: usize| {
            let side: Vec<u32> =
                (0..48 * 32).map(|i| segments.label.get(x + i % 32, i / 32)).collect();
            (0..segments.count).map(|s| side.iter().filter(|&&l| l == s).count()).max()
        };
        assert!(largest(0) > Some(1400) && largest(32) > Some(1400), "of 1536: {segments:?}");
        assert_ne!(segments.label.get(16, 24), segments.label.get(48, 24));
    }

    #[test]
    fn the_albedo_ratio_of_two_paints_is_found() {
        let (photo, normal) = wall();
        // Dark enough that no channel reaches the largest albedo.
        let albedo = retinex(&photo, &normal, &segment(&photo, 4, STEPS), 4, 0.5).0;
        let ratio = albedo.get(10, 10) / albedo.get(50, 10);
        let truth = Vec3::new(0.8 / 0.6, 4.0, 8.0);
        // The border step also holds one cell of the gradient (4 / 64 x 0.6 / 0.7 = 5 %), and the
        // anchor pulls a little.
        assert!(((ratio - truth) / truth).abs().max_element() < 0.1, "{ratio} against {truth}");
    }

    #[test]
    fn the_hue_of_the_light_is_mostly_light() {
        // Gray walls in the light of a bulb: of the photo's hue 0.7 are light, 0.3 albedo.
        let light = Vec3::new(1.0, 0.6, 0.3);
        let photo = Picture(Plane::filled(64, 48, 0.5 * light));
        let normal = Normal(Plane::filled(64, 48, Vec3::Z));
        let albedo = retinex(&photo, &normal, &segment(&photo, 4, STEPS), 4, 0.75).0.get(9, 9);
        let wanted = |c: usize, warm: f32| {
            0.3 * (light[c] / light.y).ln() + 0.7 * warm.ln() - (albedo[c] / albedo.y).ln()
        };
        // The least linear value is added to the photo before its logarithm.
        assert!(wanted(0, 1.06).abs() < 0.01 && wanted(2, 0.95).abs() < 0.01, "{albedo}");
    }

    #[test]
    fn one_pixel_and_black_are_sound() {
        for photo in [Plane::filled(1, 1, Vec3::ONE), Plane::filled(5, 3, Vec3::ZERO)] {
            let normal = Normal(Plane::filled(photo.width(), photo.height(), Vec3::Z));
            let photo = Picture(photo);
            let segments = segment(&photo, 4, STEPS);
            assert_eq!(segments.count, 1);
            let albedo = retinex(&photo, &normal, &segments, 4, 0.8);
            assert!(albedo.0.pixels().iter().all(|a| a.is_finite() && a.min_element() > 0.0));
        }
    }
}
