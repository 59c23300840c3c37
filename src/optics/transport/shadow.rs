//! Which share of a light's direct shading arrives.
//!
//! Rays go to the samples of the light that direct shading is made of, and each counts with its
//! part f of it: per lobe, visibility = sum of f V / sum of f. So a sun lobe gets the sun's shadow,
//! and a lamp half below the horizon that of its upper half. The standard error is that of a ratio:
//! with a and f the sums of a batch and R the ratio of all, the spread of a - R f over the batches,
//! divided by the mean f (Cochran, "Sampling Techniques", 6.4).

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use super::estimate::{BATCHES, Measure, Sampling, Tile, mean, pooled, refine, stream, tiles};
use crate::geometry::{Grid, Own, SceneMesh, Sight};
use crate::image::{Mask, Normal, Plane, Points};
use crate::optics::{Emitter, Shape};

/// Settings of the shadow estimate.
#[derive(Clone, Copy, Debug)]
pub struct ShadowQuality {
    /// Rays per traced pixel and lobe.
    pub sampling: Sampling,
    /// 1 traces every pixel, 2 every second one along each axis, and so on.
    pub stride: usize,
    /// The share of unknown rays that counts as lit, 0..1.
    pub assume_lit: f32,
    /// Whether unblocked rays that leave the view are unknown; else they are lit.
    pub outside_unknown: bool,
    /// Whether the points are above their surface already, as those of bodies are, so that rays
    /// start from them.
    pub lifted: bool,
}

/// Per lobe, shares of the unshadowed direct shading, 0..1.
#[derive(Default)]
pub struct ShadowEstimate {
    /// Seen to be lit, plus `assume_lit` times unknown.
    pub lit: Vec<Plane<f32>>,
    /// Standard error of `lit`.
    pub stderr: Vec<Plane<f32>>,
    /// Fraction of rays that pass behind a depth edge or, with `outside_unknown`, leave the view,
    /// regardless of the assumption about them.
    pub unknown: Vec<Plane<f32>>,
    /// Mean standard error of the shadowed direct shading over its mean, on the traced pixels, of
    /// all lobes together.
    pub relative_error: f64,
    /// Rays traced.
    pub rays: u64,
    /// Samples taken, of all traced pixels and lobes; those below the horizon need no ray.
    pub samples: u64,
    /// Traced pixels, of all lobes.
    pub pixels: usize,
}

/// Sums over the samples of one batch.
#[derive(Clone, Copy, Default)]
struct Sums {
    /// Sum of all contributions.
    all: f64,
    lit: f64,
    unknown: f64,
}

/// The estimate of one traced pixel.
#[derive(Clone, Copy, Default)]
struct Answer {
    /// Unshadowed shading, by the same samples.
    shading: f32,
    lit: f32,
    unknown: f32,
    stderr: f32,
    /// One where any light could arrive, else zero.
    valid: f32,
}

/// Shadows on all pixels of `points`, cast by `mesh`. `own` is the light's own surface: which of
/// the mesh, that it casts no shadow, and which of `points`, that they are neither lit nor unknown,
/// as no light reaches its own (convex) surface. Where no light arrives even without shadows, a
/// pixel counts as lit. Asked between rounds, `stop` may end it early.
pub fn shadow(
    mesh: &SceneMesh,
    points: &Points,
    normal: &Normal,
    shape: &Shape,
    own: Option<(&Own, &Mask)>,
    quality: ShadowQuality,
    stop: &(dyn Fn() -> bool + Sync),
) -> ShadowEstimate {
    if shape.lobes() == 0 {
        return ShadowEstimate::default();
    }
    let emitter = Emitter::with_strategy(shape, quality.sampling.strategy);
    let is_own = |pixel: usize| own.is_some_and(|(_, own)| own.0.pixels()[pixel] > 0.5);
    let passes = own.map(|(passes, _)| passes);
    let grid = Grid::new(points.0.size(), quality.stride);
    let lobes = 0..shape.lobes();
    let open_tiles = |lobe| tiles(lobe, grid.size(), |i| !is_own(grid.pixel(i)));
    let mut open: Vec<Tile<[Sums; BATCHES]>> = lobes.clone().flat_map(open_tiles).collect();
    let rays = AtomicU64::new(0);
    let extend = |tile: &mut Tile<[Sums; BATCHES]>, range: Range<usize>| {
        let mut traced = 0;
        for (&i, sums) in tile.pixels.iter().zip(&mut tile.sums) {
            let pixel = grid.pixel(i);
            let (point, n) = (points.0.pixels()[pixel], normal.0.pixels()[pixel]);
            let Some(seen) = emitter.sampler_at(tile.lobe, point, n) else { continue };
            let from = if quality.lifted { point } else { point + n * mesh.offset(point) };
            for (batch, sums) in sums.iter_mut().enumerate() {
                let stream = stream(quality.sampling.seed, pixel as u32, tile.lobe, batch);
                for sample in range.clone().filter_map(|i| seen.sample(&stream, i)) {
                    let part = f64::from(sample.contribution);
                    traced += 1;
                    sums.all += part;
                    match mesh.visibility(from, sample.position, passes) {
                        Sight::Lit if quality.outside_unknown && !mesh.in_view(sample.position) => {
                            sums.unknown += part
                        }
                        Sight::Lit => sums.lit += part,
                        Sight::Unknown => sums.unknown += part,
                        Sight::Blocked => {}
                    }
                }
            }
        }
        rays.fetch_add(traced, Ordering::Relaxed);
    };
    let assume = f64::from(quality.assume_lit);
    let measure = |tile: &Tile<[Sums; BATCHES]>| {
        let weighted = |answer: &Answer, v: f32| f64::from(answer.shading) * f64::from(v);
        answers(tile, assume).iter().fold(Measure::default(), |sum, answer| Measure {
            value: sum.value + weighted(answer, answer.lit),
            error: sum.error + weighted(answer, answer.stderr),
        })
    };
    let base = vec![(0.0, grid.len()); lobes.len()];
    refine(&mut open, &base, &quality.sampling, extend, measure, stop);
    let traced = by_receiver(&open, lobes.len(), grid.len(), assume);
    let sum = |of: fn(&Measure) -> f64| open.iter().fold(0.0, |sum, tile| sum + of(&tile.measure));
    let mut shadow = ShadowEstimate {
        lit: Vec::new(),
        stderr: Vec::new(),
        unknown: Vec::new(),
        relative_error: sum(|m| m.error) / sum(|m| m.value).max(f64::MIN_POSITIVE),
        rays: rays.into_inner(),
        samples: open.iter().map(|tile| (tile.pixels.len() * tile.each * BATCHES) as u64).sum(),
        pixels: open.iter().map(|tile| tile.pixels.len()).sum(),
    };
    let up = grid.spread(points, normal, |neighbors| -> [[f32; 3]; 3] {
        std::array::from_fn(|lobe| {
            traced.get(lobe).map_or([0.0; 3], |traced| blend(traced, neighbors))
        })
    });
    for lobe in lobes {
        let [lit, unknown, stderr] = planes(&up, lobe, &is_own);
        shadow.lit.push(lit);
        shadow.unknown.push(unknown);
        shadow.stderr.push(stderr);
    }
    shadow
}

/// The planes of one lobe, which are zero in the light's own pixels.
fn planes(
    up: &Plane<[[f32; 3]; 3]>,
    lobe: usize,
    is_own: &impl Fn(usize) -> bool,
) -> [Plane<f32>; 3] {
    [0, 1, 2].map(|k| {
        let pixel = |i: usize| if is_own(i) { 0.0 } else { up.pixels()[i][lobe][k] };
        Plane::new(up.width(), up.height(), (0..up.len()).map(pixel).collect())
    })
}

/// Estimates by lobe and receiver; the default where nothing was traced.
fn by_receiver(
    tiles: &[Tile<[Sums; BATCHES]>],
    lobes: usize,
    receivers: usize,
    assume_lit: f64,
) -> Vec<Vec<Answer>> {
    let mut traced = vec![vec![Answer::default(); receivers]; lobes];
    for tile in tiles {
        let all = tile.pixels.iter().zip(answers(tile, assume_lit));
        all.for_each(|(&i, answer)| traced[tile.lobe][i] = answer);
    }
    traced
}

impl ShadowEstimate {
    /// Gives all lobes one visibility, that of the light as a whole when every lobe has unit
    /// radiance: sum of E V / sum of E over the lobes, with E their unshadowed `direct` shading;
    /// the mean where no light arrives.
    ///
    /// # Panics
    /// If `direct` has other lobes or another size.
    pub fn average(&mut self, direct: &[Plane<f32>]) {
        assert_eq!(direct.len(), self.lit.len(), "direct shading has the lobes of the shadow");
        for pixel in 0..direct.first().map_or(0, Plane::len) {
            let total: f32 = direct.iter().map(|e| e.pixels()[pixel]).sum();
            let share = |e: &Plane<f32>| {
                if total > 0.0 { e.pixels()[pixel] / total } else { 1.0 / direct.len() as f32 }
            };
            let shares: Vec<f32> = direct.iter().map(share).collect();
            let mean = |of: &[Plane<f32>]| {
                of.iter().zip(&shares).map(|(v, w)| w * v.pixels()[pixel]).sum::<f32>()
            };
            // Lobes have rays of their own, so their variances add.
            let error = self
                .stderr
                .iter()
                .zip(&shares)
                .map(|(s, w)| (w * s.pixels()[pixel]).powi(2))
                .sum::<f32>()
                .sqrt();
            let (lit, unknown) = (mean(&self.lit).min(1.0), mean(&self.unknown).min(1.0));
            for (planes, value) in
                [(&mut self.lit, lit), (&mut self.unknown, unknown), (&mut self.stderr, error)]
            {
                planes.iter_mut().for_each(|plane| plane.pixels_mut()[pixel] = value);
            }
        }
    }
}

/// Lit and unknown share and the standard error of the former, of a pixel that draws from these
/// traced ones. Each of them has random numbers of its own, so their variances add, with the
/// squares of the weights.
fn blend(traced: &[Answer], neighbors: &[(usize, f32)]) -> [f32; 3] {
    let (mut lit, mut unknown, mut variance, mut valid) = (0.0, 0.0, 0.0, 0.0);
    for &(i, weight) in neighbors {
        let answer = &traced[i];
        lit += weight * answer.lit;
        unknown += weight * answer.unknown;
        variance += (weight * answer.stderr).powi(2);
        valid += weight * answer.valid;
    }
    // A pixel without light, even unshadowed, counts as lit.
    if valid > 0.0 {
        [(lit / valid).clamp(0.0, 1.0), (unknown / valid).clamp(0.0, 1.0), variance.sqrt() / valid]
    } else {
        [1.0, 0.0, 0.0]
    }
}

/// The estimates of a tile's pixels from their sums.
fn answers(tile: &Tile<[Sums; BATCHES]>, assume_lit: f64) -> Vec<Answer> {
    let samples = (BATCHES * tile.each) as f64;
    let answer = |sums: &[Sums; BATCHES]| {
        let total = |of: fn(&Sums) -> f64| sums.iter().map(of).sum::<f64>();
        let all = total(|s| s.all);
        if all <= 1e-30 {
            return (Answer::default(), None);
        }
        let arrives = |s: &Sums| s.lit + assume_lit * s.unknown;
        let lit = sums.iter().map(arrives).sum::<f64>() / all;
        let (_, spread) = mean(&std::array::from_fn(|b| arrives(&sums[b]) - lit * sums[b].all));
        let unknown = (total(|s| s.unknown) / all) as f32;
        let shading = (all / samples) as f32;
        let answer = Answer { shading, lit: lit as f32, unknown, stderr: 0.0, valid: 1.0 };
        (answer, Some((spread * BATCHES as f64 / all).powi(2)))
    };
    let (mut answers, variances): (Vec<Answer>, Vec<Option<f64>>) =
        tile.sums.iter().map(answer).unzip();
    // If all rays agree, the next one may still differ: by Laplace's rule of succession once in two
    // more than the tile cast.
    let rays = samples * variances.iter().flatten().count() as f64;
    let floor = 1.0 / (rays + 2.0) / samples;
    for (answer, error) in answers.iter_mut().zip(pooled(tile, &variances)) {
        answer.stderr = answer.valid * error.hypot(floor.sqrt()) as f32;
    }
    answers
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_average_keeps_the_light_that_arrives() {
        let planes = |values: [[f32; 3]; 2]| values.map(|v| Plane::new(3, 1, v.to_vec())).to_vec();
        // Two lobes on three pixels; the last gets no light.
        let direct = planes([[1.0, 3.0, 0.0], [3.0, 0.0, 0.0]]);
        let lit = planes([[0.2, 0.5, 1.0], [0.8, 1.0, 1.0]]);
        let unknown = planes([[0.4, 0.5, 0.0], [0.0, 0.0, 0.0]]);
        let stderr = planes([[0.4, 0.1, 0.0], [0.0, 0.0, 0.0]]);
        let mut shadow = ShadowEstimate { lit, stderr, unknown, ..ShadowEstimate::default() };
        shadow.average(&direct);
        for lobe in 0..2 {
            // 0.2 / 4 + 0.8 * 3 / 4 = 0.65; all powers of two but for the decimals' own rounding.
            for (got, wanted) in shadow.lit[lobe].pixels().iter().zip([0.65, 0.5, 1.0]) {
                assert!((got - wanted).abs() < 1e-6, "lobe {lobe}: wanted {wanted}, got {got}");
            }
            for (got, wanted) in shadow.unknown[lobe].pixels().iter().zip([0.1, 0.5, 0.0]) {
                assert!(
                    (got - wanted).abs() < 1e-6,
                    "lobe {lobe}: wanted {wanted} unknown, got {got}"
                );
            }
            for (got, wanted) in shadow.stderr[lobe].pixels().iter().zip([0.1, 0.1, 0.0]) {
                assert!(
                    (got - wanted).abs() < 1e-6,
                    "lobe {lobe}: wanted an error of {wanted}, got {got}"
                );
            }
        }
    }
}
