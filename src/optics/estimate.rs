//! Monte Carlo estimates with a standard error.
//!
//! The samples of one estimate come in [`BATCHES`] streams that are independent of each other. Inside a stream the points are
//! evenly spread, and no formula tells the error of such a sum; but the streams' means are independent and alike, so their
//! spread tells it: randomised quasi-Monte Carlo (L'Ecuyer, "Randomized Quasi-Monte Carlo", 2018).

use super::{Emitter, Points2};
use glam::Vec3;

/// Independent streams per estimate. A 95 % interval is Student's for one degree of freedom less: plus and minus 3.18 standard
/// errors.
pub const BATCHES: usize = 4;

/// The stream of a pixel for one lobe and batch.
pub fn stream(seed: u64, pixel: u32, lobe: usize, batch: usize) -> Points2 {
    Points2::new(seed, pixel, (lobe * BATCHES + batch) as u32)
}

/// Mean of the batches and its standard error.
pub fn mean(batches: &[f64; BATCHES]) -> (f64, f64) {
    let n = BATCHES as f64;
    let mean = batches.iter().sum::<f64>() / n;
    let squares: f64 = batches.iter().map(|b| (b - mean).powi(2)).sum();
    (mean, (squares / (n * (n - 1.0))).sqrt())
}

/// E / L of one lobe by `each` samples in every batch, and its standard error.
pub fn estimate(
    emitter: &Emitter,
    lobe: usize,
    (point, normal): (Vec3, Vec3),
    each: usize,
    seed: u64,
    pixel: u32,
) -> (f64, f64) {
    let Some(seen) = emitter.seen(lobe, point, normal) else { return (0.0, 0.0) };
    let batches = std::array::from_fn(|batch| {
        let points = stream(seed, pixel, lobe, batch);
        let parts = (0..each).filter_map(|i| seen.sample(i, points.get(i)));
        parts.map(|sample| f64::from(sample.part)).sum::<f64>() / each.max(1) as f64
    });
    mean(&batches)
}
