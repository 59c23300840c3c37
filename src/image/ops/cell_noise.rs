//! The noise of a photo between cells of pixels, and the colors of cells without it.
//!
//! Noise would split a wall into hundreds of segments. The color of a cell is the mean of its
//! pixels, and its noise depends on its level. Second differences along rows and columns of cells
//! are zero on any linear ramp (Immerkaer, "Fast noise variance estimation", CVIU 64(2), 1996), and
//! most cells of one level lie inside a surface, so that a low quantile of these differences shows
//! the noise. Where the noise would separate segments, a cell takes the mean of the cells around it
//! that differ from it by no more than noise (bilateral filter: Tomasi and Manduchi, "Bilateral
//! filtering for gray and color images", ICCV 1998).

use glam::Vec3;
use rayon::prelude::*;

use super::grain::interpolate;
use super::reflectance::smooth_step;
use crate::image::{Plane, intensity_and_chroma};
use crate::tuning::tuning;

tuning! {
    /// Constants of the noise of cells.
    pub const TUNING: CellNoiseTuning {
        /// Intervals of the level with equal numbers of cells, each with its noise.
        levels: usize = 8,
            unit "1", source Taste,
            effect "a larger value follows the noise closer, by fewer cells each";
        /// Quantile of the second differences of a level that determines its noise.
        quantile: f32 = 0.3,
            unit "1", source Taste, effect "a larger value takes texture and edges for noise";
        /// Magnitude of a number of a normal distribution at that quantile.
        quantile_of_one: f32 = 0.385_32,
            unit "standard deviations", source Derived("normal distribution"),
            effect "it belongs to the quantile";
        /// Length of two such numbers at that quantile.
        quantile_of_two: f32 = 0.844_60,
            unit "standard deviations", source Derived("Rayleigh distribution, sqrt(-2 log(0.7))"),
            effect "it belongs to the quantile";
        /// Noise of the difference in chromaticity of two cells, over the step that separates
        /// segments: up to the first a cell keeps its color, from the second on the mean replaces
        /// it.
        noisy: [f32; 2] = [0.5, 1.0],
            unit "1", source Measured("at level 0.2: 0.1 to 0.4 in five rooms through a camera, 1.2 to 1.9 in three noisy photos"),
            effect "smaller values smooth photos with less noise";
        /// Scale of the difference of two cells of one surface.
        range: f32 = 1.5,
            unit "standard deviations", source Measured("docs/estimation.md"),
            effect "a larger value joins surfaces that noise nearly hides";
        /// Distance along each axis up to which cells count.
        reach: usize = 4,
            unit "cells", source Taste, effect "a larger value smooths more, and is slower";
        /// Number of times that means are taken, each time of the last ones.
        passes: usize = 2,
            unit "1", source Taste, effect "a larger value makes noisy surfaces more even";
    }
}

/// Standard deviations of the noise in the log color of a cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct CellNoise {
    /// Deviation of the log intensity.
    intensity: f32,
    /// Deviation of the log chromaticity along each of two axes.
    pub chroma: f32,
}

impl CellNoise {
    /// Degree to which this noise separates segments, 0 to 1, when a change of log chromaticity by
    /// `chroma_step` does.
    pub fn separates(self, chroma_step: f32) -> f32 {
        let [not, fully] = TUNING.noisy;
        smooth_step(not, fully, std::f32::consts::SQRT_2 * self.chroma / chroma_step)
    }
}

/// The log colors of cells without the noise that separates segments.
///
/// Cells whose noise separates none keep their color to the bit.
pub(super) fn without_noise(
    log: &Plane<Vec3>,
    noise: &[CellNoise],
    chroma_step: f32,
) -> Plane<Vec3> {
    let (w, h) = log.size();
    let mut means = log.clone();
    for _ in 0..TUNING.passes {
        let smoothed = |i: usize| match noise[i].separates(chroma_step) {
            0.0 => log.pixels()[i],
            share => log.pixels()[i].lerp(mean_of_surface(&means, i, noise[i]), share),
        };
        means = Plane::new(w, h, (0..w * h).into_par_iter().map(smoothed).collect());
    }
    means
}

/// The mean of the cells around cell `i` that differ from it by no more than `noise`.
fn mean_of_surface(log: &Plane<Vec3>, i: usize, noise: CellNoise) -> Vec3 {
    let (w, h) = log.size();
    let (x, y, own) = (i % w, i / w, log.pixels()[i]);
    let near =
        |at: usize, end: usize| at.saturating_sub(TUNING.reach)..end.min(at + TUNING.reach + 1);
    let scale = |deviation: f32| 1.0 / (TUNING.range * deviation).max(f32::MIN_POSITIVE);
    let (per_intensity, per_chroma) = (scale(noise.intensity), scale(noise.chroma));
    let (mut sum, mut total) = (Vec3::ZERO, 0.0);
    for (x, y) in near(y, h).flat_map(|y| near(x, w).map(move |x| (x, y))) {
        let other = log.get(x, y);
        let (intensity, chroma) = intensity_and_chroma(other - own);
        let away = (intensity * per_intensity).powi(2) + (chroma * per_chroma).length_squared();
        let weight = (-0.5 * away).exp();
        sum += weight * other;
        total += weight;
    }
    sum / total
}

/// The noise of each cell, by the second differences of all cells of its level.
pub(super) fn noise_of_cells(log: &Plane<Vec3>) -> Vec<CellNoise> {
    let (w, h) = log.size();
    let level = |i: usize| intensity_and_chroma(log.pixels()[i]).0;
    let rows = (0..w * h).filter(|i| i % w > 0 && i % w + 1 < w).map(|i| (i, 1));
    let columns = (0..w * h).filter(|i| i / w > 0 && i / w + 1 < h).map(|i| (i, w));
    let difference = |(i, apart): (usize, usize)| {
        let [before, own, after] = [i - apart, i, i + apart].map(|i| log.pixels()[i]);
        // The squares of the weights 1, -2, 1 sum to 6.
        let (intensity, chroma) =
            intensity_and_chroma((before - 2.0 * own + after) / 6.0f32.sqrt());
        Difference { level: level(i), intensity: intensity.abs(), chroma: chroma.length() }
    };
    let mut differences: Vec<Difference> = rows.chain(columns).map(difference).collect();
    differences.sort_by(|a, b| a.level.total_cmp(&b.level));
    let size = differences.len().div_ceil(TUNING.levels).max(1);
    let levels: Vec<(f32, CellNoise)> = differences.chunks(size).map(noise_of_level).collect();
    let curve = |deviation: fn(CellNoise) -> f32| -> Vec<[f32; 2]> {
        levels.iter().map(|&(level, noise)| [level, deviation(noise)]).collect()
    };
    let (intensity, chroma) = (curve(|noise| noise.intensity), curve(|noise| noise.chroma));
    let at = |level: f32| CellNoise {
        intensity: interpolate(&intensity, level),
        chroma: interpolate(&chroma, level),
    };
    (0..w * h).map(|i| at(level(i))).collect()
}

/// A second difference of three cells.
struct Difference {
    /// Log intensity of the middle cell.
    level: f32,
    /// Magnitude of the difference in log intensity.
    intensity: f32,
    /// Length of the difference in log chromaticity.
    chroma: f32,
}

/// The median level of these differences, ordered by it, and their noise.
fn noise_of_level(differences: &[Difference]) -> (f32, CellNoise) {
    let quantile = |value: fn(&Difference) -> f32| {
        let mut values: Vec<f32> = differences.iter().map(value).collect();
        let at = (TUNING.quantile * (values.len() - 1) as f32) as usize;
        *values.select_nth_unstable_by(at, f32::total_cmp).1
    };
    let noise = CellNoise {
        intensity: quantile(|d| d.intensity) / TUNING.quantile_of_one,
        chroma: quantile(|d| d.chroma) / TUNING.quantile_of_two,
    };
    (differences[differences.len() / 2].level, noise)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::ops::grain::tests::normal;

    const SIZE: (usize, usize) = (80, 60);
    const STEP: f32 = 0.06;

    /// A dark paint at the left and a bright one at the right, both under a gradient, with noise of
    /// this deviation in each channel.
    fn wall(deviation: f32) -> Plane<Vec3> {
        let numbers = normal(3 * SIZE.0 * SIZE.1);
        Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            let noise = Vec3::from_slice(&numbers[3 * (y * SIZE.0 + x)..]);
            paint(x) + 0.01 * y as f32 + deviation * noise
        })
    }

    fn paint(x: usize) -> Vec3 {
        if x < 40 { Vec3::new(-2.0, -2.2, -2.6) } else { Vec3::new(-0.8, -0.8, -0.9) }
    }

    fn smoothed(log: &Plane<Vec3>) -> Plane<Vec3> {
        without_noise(log, &noise_of_cells(log), STEP)
    }

    #[test]
    fn known_noise_is_measured() {
        for deviation in [0.03, 0.1] {
            for noise in noise_of_cells(&wall(deviation)) {
                // The mean of three channels, and what remains along each axis across it.
                let ratios =
                    [noise.intensity * 3.0f32.sqrt() / deviation, noise.chroma / deviation];
                assert!(ratios.iter().all(|r| (0.85..1.2).contains(r)), "{deviation}: {ratios:?}");
            }
        }
    }

    #[test]
    fn little_noise_stays_to_the_bit() {
        let wall = wall(0.015);
        assert!(smoothed(&wall) == wall);
    }

    #[test]
    fn noise_becomes_the_surface_and_paint_stays() {
        let smooth = smoothed(&wall(0.1));
        let error = |x: usize, y: usize| smooth.get(x, y) - paint(x) - 0.01 * y as f32;
        let all = || (0..SIZE.0).flat_map(|x| (0..SIZE.1).map(move |y| error(x, y)));
        let square = all().map(|e| e.length_squared()).sum::<f32>() / (3 * all().count()) as f32;
        assert!(square.sqrt() < 0.03, "{}", square.sqrt());
        // Also beside the edge.
        for x in [39, 40] {
            let mean = (0..SIZE.1).map(|y| error(x, y)).sum::<Vec3>() / SIZE.1 as f32;
            assert!(mean.abs().max_element() < 0.03, "{x}: {mean}");
        }
    }

    #[test]
    fn small_and_even_planes_are_sound() {
        for (w, h) in [(1, 1), (2, 1), (1, 9), (3, 3)] {
            let even = Plane::filled(w, h, Vec3::splat(-1.0));
            assert!(smoothed(&even) == even);
        }
    }
}
