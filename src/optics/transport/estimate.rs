//! Monte Carlo estimates with a standard error, and the rounds in which they get better.
//!
//! The samples of one estimate come in [`BATCHES`] streams that are independent of each other.
//! Inside a stream the points are evenly spread, and no formula gives the error of such a sum; but
//! the streams' means are independent and identically distributed, so their spread estimates it:
//! randomized quasi-Monte Carlo (L'Ecuyer, "Randomized Quasi-Monte Carlo", 2018).

use glam::Vec3;
use rayon::prelude::*;

use crate::optics::{Emitter, Points2, Strategy};
use crate::tuning::tuning;

/// Independent streams per estimate.
pub const BATCHES: usize = TUNING.batches;

/// A 95 % interval is plus and minus this many standard errors: Student's for six degrees of
/// freedom, see `pooled`.
pub const INTERVAL: f64 = TUNING.interval;

tuning! {
    /// Constants of Monte Carlo estimates and their standard errors.
    pub const TUNING: NoiseTuning {
        /// Independent streams per estimate: three degrees of freedom of its own.
        batches: usize = 4,
            unit "streams", source Taste,
            effect "a larger value estimates errors more exactly, with less even points";
        /// Standard errors on either side of an estimate in an interval of 95 %.
        interval: f64 = 2.447,
            unit "standard errors", source Derived("Student's distribution with six degrees of freedom"),
            effect "a larger value widens the interval; no estimate changes";
        /// Pixels along each side of a tile, which is improved as a whole.
        tile: usize = 16,
            unit "pixels", source Taste, effect "a larger value spends samples more evenly";
    }
}

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
    let Some(seen) = emitter.sampler_at(lobe, point, normal) else { return (0.0, 0.0) };
    let batches = std::array::from_fn(|batch| {
        let points = stream(seed, pixel, lobe, batch);
        let parts = (0..each).filter_map(|i| seen.sample(&points, i));
        parts.map(|sample| f64::from(sample.contribution)).sum::<f64>() / each.max(1) as f64
    });
    mean(&batches)
}

/// The standard errors of the pixels of a tile, from the variances of their own batches; `None`
/// without anything to estimate.
///
/// Four batches estimate a variance poorly, and if few rays meet the edge of a shadow they all
/// agree although the truth lies between. So each variance is the mean of a pixel's own and that of
/// the 3 x 3 pixels around it: a compromise that holds in penumbrae three pixels wide, and behaves
/// like six degrees of freedom.
pub fn pooled<S>(tile: &Tile<S>, variances: &[Option<f64>]) -> Vec<f64> {
    // A border of one pixel around the tile, which holds nothing.
    const SIDE: usize = TUNING.tile + 2;
    let place = |pixel: usize| {
        (pixel / tile.width % TUNING.tile + 1) * SIDE + pixel % tile.width % TUNING.tile + 1
    };
    let mut cells = [(0.0, 0.0); SIDE * SIDE];
    for (&pixel, variance) in tile.pixels.iter().zip(variances) {
        cells[place(pixel)] = variance.map_or((0.0, 0.0), |v| (v, 1.0));
    }
    let around = |at: usize| {
        let cells = [at - SIDE, at, at + SIDE].into_iter().flat_map(|row| &cells[row - 1..row + 2]);
        cells.fold((0.0, 0.0), |sum, cell| (sum.0 + cell.0, sum.1 + cell.1))
    };
    let error = |(&pixel, variance): (&usize, &Option<f64>)| {
        let Some(own) = variance else { return 0.0 };
        let (sum, count) = around(place(pixel));
        (0.5 * (own + sum / count)).sqrt()
    };
    tile.pixels.iter().zip(variances).map(error).collect()
}

/// Settings of the sampling.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// The sampling strategy of directions to a window.
    pub strategy: Strategy,
    /// Samples per pixel and lobe, rounded up to whole batches; the least where there is a target.
    pub samples: usize,
    /// The most where there is a target.
    pub most: usize,
    /// Mean standard error of a tile, over the mean of its lobe in the whole picture, that is good
    /// enough; 0 stops at `samples`.
    pub target: f64,
    /// Samples of the first round, after which one may stop; `samples` where nobody will.
    pub first: usize,
    /// Another seed gives other noise.
    pub seed: u64,
}

impl Sampling {
    /// `samples` everywhere, in one round.
    pub fn fixed(samples: usize, seed: u64) -> Sampling {
        Sampling {
            strategy: Strategy::Best,
            samples,
            most: samples,
            target: 0.0,
            first: samples,
            seed,
        }
    }
}

/// Some pixels of one lobe, and their estimates so far.
pub struct Tile<S> {
    pub lobe: usize,
    /// Width of the whole picture, pixels.
    pub width: usize,
    pub pixels: Vec<usize>,
    /// One per pixel.
    pub sums: Vec<S>,
    /// Samples taken per pixel and batch.
    pub each: usize,
    pub measure: Measure,
    open: bool,
}

/// Sums over the pixels of a tile.
#[derive(Clone, Copy, Default)]
pub struct Measure {
    pub value: f64,
    pub error: f64,
}

/// The tiles of one lobe over a picture of this size, of the pixels (row by row) that `take` names;
/// none is empty.
pub fn tiles<S: Clone + Default>(
    lobe: usize,
    (width, height): (usize, usize),
    take: impl Fn(usize) -> bool,
) -> Vec<Tile<S>> {
    let mut tiles = Vec::new();
    for (top, left) in (0..height)
        .step_by(TUNING.tile)
        .flat_map(|y| (0..width).step_by(TUNING.tile).map(move |x| (y, x)))
    {
        let rows = top..(top + TUNING.tile).min(height);
        let columns = left..(left + TUNING.tile).min(width);
        let pixels = rows.flat_map(|y| columns.clone().map(move |x| y * width + x));
        let pixels: Vec<usize> = pixels.filter(|&pixel| take(pixel)).collect();
        if !pixels.is_empty() {
            let sums = vec![S::default(); pixels.len()];
            tiles.push(Tile {
                lobe,
                width,
                pixels,
                sums,
                each: 0,
                measure: Measure::default(),
                open: true,
            });
        }
    }
    tiles
}

/// Takes samples until there are enough, or `stop` returns true. Each round doubles those of the
/// tiles that are not good enough yet.
///
/// `extend` adds the samples of a range, in each batch, to the sums of a tile; `measure` returns
/// the state of the tile. `base` is, per lobe, the sum of the values known without samples, and the
/// number of all pixels. The result depends on `stop`, but not on the number of threads.
pub fn refine<S: Send + Sync>(
    tiles: &mut [Tile<S>],
    base: &[(f64, usize)],
    sampling: &Sampling,
    extend: impl Fn(&mut Tile<S>, std::ops::Range<usize>) + Sync,
    measure: impl Fn(&Tile<S>) -> Measure + Sync,
    stop: &(dyn Fn() -> bool + Sync),
) {
    let batches = |samples: usize| samples.div_ceil(BATCHES).max(1);
    let (least, most) = (batches(sampling.samples), batches(sampling.most.max(sampling.samples)));
    let mut each = batches(sampling.first).min(least);
    loop {
        tiles.par_iter_mut().filter(|tile| tile.open).for_each(|tile| {
            if tile.each == 0 || !stop() {
                extend(tile, tile.each..each);
                tile.each = each;
                tile.measure = measure(tile);
            }
        });
        if each >= least {
            let mut enough: Vec<f64> = base.iter().map(|(value, _)| *value).collect();
            tiles.iter().for_each(|tile| enough[tile.lobe] += tile.measure.value);
            enough
                .iter_mut()
                .zip(base)
                .for_each(|(sum, (_, count))| *sum *= sampling.target / (*count).max(1) as f64);
            for tile in tiles.iter_mut() {
                let good = tile.measure.error <= enough[tile.lobe] * tile.pixels.len() as f64;
                tile.open &= sampling.target > 0.0 && !good;
            }
        }
        let limit = if each < least { least } else { most };
        if each >= limit || !tiles.iter().any(|tile| tile.open) || stop() {
            return;
        }
        each = (2 * each).min(limit);
    }
}
