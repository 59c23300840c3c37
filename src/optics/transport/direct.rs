//! Unshadowed direct shading of a whole picture by one light.

use rayon::prelude::*;

use super::estimate::{BATCHES, Measure, Sampling, Tile, mean, pooled, refine, stream, tiles};
use crate::image::{Normal, Plane, Points};
use crate::optics::{Emitter, Shape, Strategy};

/// Per lobe of unit radiance: irradiance / pi, and its standard error (zero where a closed form was
/// used).
pub struct DirectEstimate {
    /// Direct shading per lobe: irradiance / pi, per unit radiance.
    pub lobes: Vec<Plane<f32>>,
    /// Standard error of `lobes`; one plane per lobe.
    pub stderr: Vec<Plane<f32>>,
    /// Samples taken, of all pixels and lobes.
    pub samples: u64,
}

impl DirectEstimate {
    /// Mean standard error over mean value, of all lobes together.
    pub fn relative_error(&self) -> f64 {
        // The sum of nothing is -0.0, which would be shown with its sign.
        let sum = |planes: &[Plane<f32>]| {
            planes.iter().flat_map(|p| p.pixels()).fold(0.0, |sum, &v| sum + f64::from(v))
        };
        sum(&self.stderr) / sum(&self.lobes).max(f64::MIN_POSITIVE)
    }
}

/// Sums of the parts of the samples, per batch.
type BatchSums = [f64; BATCHES];

/// Closed forms where there are any, but for windows under a strategy that is there to be compared;
/// else samples. The planes are of one size. Asked between rounds, `stop` may end it early.
pub fn direct(
    points: &Points,
    normal: &Normal,
    shape: &Shape,
    sampling: &Sampling,
    stop: &(dyn Fn() -> bool + Sync),
) -> DirectEstimate {
    let emitter = Emitter::with_strategy(shape, sampling.strategy);
    let (width, height) = points.0.size();
    let at = |i: usize| (points.0.pixels()[i], normal.0.pixels()[i]);
    let compared = matches!(shape, Shape::Window(_)) && sampling.strategy != Strategy::Best;
    let exact = |lobe: usize| -> Vec<Option<f32>> {
        let pixels = (0..width * height).into_par_iter().with_min_len(width.max(1));
        pixels
            .map(|i| if compared { None } else { emitter.irradiance(lobe, at(i).0, at(i).1) })
            .collect()
    };
    let exact: Vec<Vec<Option<f32>>> = (0..shape.lobes()).map(exact).collect();

    let open = |(lobe, exact): (usize, &Vec<Option<f32>>)| {
        tiles(lobe, (width, height), |i| exact[i].is_none())
    };
    let mut open: Vec<Tile<BatchSums>> = exact.iter().enumerate().flat_map(open).collect();
    let known = |exact: &Vec<Option<f32>>| exact.iter().flatten().map(|&e| f64::from(e)).sum();
    let base: Vec<(f64, usize)> =
        exact.iter().map(|exact| (known(exact), width * height)).collect();
    let extend = |tile: &mut Tile<BatchSums>, range: std::ops::Range<usize>| {
        for (&pixel, sums) in tile.pixels.iter().zip(&mut tile.sums) {
            let Some(seen) = emitter.sampler_at(tile.lobe, at(pixel).0, at(pixel).1) else {
                continue;
            };
            for (batch, sum) in sums.iter_mut().enumerate() {
                let points = stream(sampling.seed, pixel as u32, tile.lobe, batch);
                let parts = range.clone().filter_map(|i| seen.sample(&points, i));
                parts.for_each(|sample| *sum += f64::from(sample.contribution));
            }
        }
    };
    let measure = |tile: &Tile<BatchSums>| {
        let add = |all: Measure, (value, error)| Measure {
            value: all.value + value,
            error: all.error + error,
        };
        answers(tile).into_iter().fold(Measure::default(), add)
    };
    refine(&mut open, &base, sampling, extend, measure, stop);

    let filled =
        |exact: &Vec<Option<f32>>| exact.iter().map(|e| e.unwrap_or(0.0)).collect::<Vec<f32>>();
    let mut lobes: Vec<Vec<f32>> = exact.iter().map(filled).collect();
    let mut stderr = vec![vec![0.0; width * height]; lobes.len()];
    for tile in &open {
        for (&pixel, (value, error)) in tile.pixels.iter().zip(answers(tile)) {
            lobes[tile.lobe][pixel] = value as f32;
            stderr[tile.lobe][pixel] = error as f32;
        }
    }
    let plane = |pixels: Vec<f32>| Plane::new(width, height, pixels);
    DirectEstimate {
        lobes: lobes.into_iter().map(plane).collect(),
        stderr: stderr.into_iter().map(plane).collect(),
        samples: open.iter().map(|tile| (tile.pixels.len() * tile.each * BATCHES) as u64).sum(),
    }
}

/// Value and standard error of each pixel of a tile.
fn answers(tile: &Tile<BatchSums>) -> Vec<(f64, f64)> {
    let means: Vec<(f64, f64)> =
        tile.sums.iter().map(|sums| mean(&sums.map(|sum| sum / tile.each as f64))).collect();
    let variances: Vec<Option<f64>> = means.iter().map(|(_, error)| Some(error * error)).collect();
    means.iter().zip(pooled(tile, &variances)).map(|((value, _), error)| (*value, error)).collect()
}
