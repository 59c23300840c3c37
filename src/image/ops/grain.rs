//! The noise of a photo, and new noise of the same strength for pixels that are drawn into it.
//!
//! The square root of a linear value has a noise that depends little on its level, as the variance
//! of photon noise is proportional to the level (Anscombe, "The transformation of Poisson, binomial
//! and negative-binomial data", Biometrika 35, 1948). All levels and deviations in this file are
//! those of square roots.
//!
//! **Strength.** The mean square of second differences `v(i - k) - 2 v(i) + v(i + k)` along both
//! axes is zero on any linear ramp (Immerkaer, "Fast noise variance estimation", CVIU 64(2), 1996,
//! uses such a filter). It is taken over blocks of the photo; of the blocks of one brightness, the
//! flattest ones show noise and no texture (Liu, Freeman, Szeliski, Kang, "Noise estimation from a
//! single image", CVPR 2006). Where even they show much more than those of another brightness,
//! they have texture and are left out. So each channel has a curve of the deviation over the level,
//! which is interpolated linearly.
//!
//! **Correlation.** Demosaicing, noise reduction and JPEG blur the noise. White noise of deviation
//! s under a normalized kernel with the autocorrelation r has the mean square
//! `s^2 (6 - 8 r(k) + 2 r(2k))`. The ratio for a short and a long spacing determines the width of a
//! Gaussian kernel, and one spacing then the deviation. The channels have one mean correlation.
//!
//! **New noise.** A tile of noise with unit variance is repeated over the picture and scaled by the
//! curve, as in Norkin and Birkbeck, "Film grain synthesis for AV1 video codec", DCC 2018. It is a
//! hash of the pixel's position: same position, same noise.

use glam::Vec3;
use rayon::prelude::*;

use crate::image::{Picture, Plane};
use crate::tuning::tuning;

tuning! {
    /// Constants of the noise of a photo.
    pub const TUNING: GrainTuning {
        /// Side of a block of pixels.
        block: usize = 16,
            unit "pixels", source Taste,
            effect "a larger value finds fewer blocks without texture, a smaller one counts less in each";
        /// Most blocks that are measured; in larger photos they are spread evenly.
        blocks: usize = 4096,
            unit "1", source Derived("2 million pixels are read, in milliseconds"),
            effect "a larger value takes more time";
        /// Fewest blocks of one brightness; a brightness with fewer has no point on the curve.
        min_blocks: usize = 8,
            unit "1", source Taste, effect "a larger value leaves rare levels to interpolation";
        /// Intervals of the level, which is 0..=1, with a point on the curve each.
        bins: usize = 8,
            unit "1", source Taste, effect "a larger value follows the curve closer, by fewer blocks each";
        /// Quantiles of the mean square among the blocks of one brightness, between which blocks
        /// are taken for flat.
        flat: [f32; 2] = [0.02, 0.15],
            unit "fraction", source Measured("walls of nine photos against their textures"),
            effect "larger values take texture for noise, smaller ones vary more";
        /// Mean square of noise over that of the blocks between these quantiles: they are the
        /// least noisy ones.
        selection: f32 = 1.18,
            unit "1", source Measured("white and blurred noise on a ramp: 0.95 to 1 of its deviation"),
            effect "a larger value adds stronger noise";
        /// Largest deviation of a brightness over that of the brightness with the least; for a
        /// darker one times the ratio of levels, by which noise that is the same at all linear
        /// levels rises. A brightness with more has texture in all blocks, and no point on the
        /// curve.
        max_rise: f32 = 1.3,
            unit "1", source Measured("walls of nine photos: 1.0 to 1.25"),
            effect "a larger value takes texture for noise, a smaller one drops brightnesses with more noise";
        /// Spacings of the second differences.
        spacings: [usize; 2] = [1, 3],
            unit "pixels", source Measured("autocorrelation of five photos: flat beyond 3 pixels"),
            effect "larger spacings see coarser noise, and more texture";
        /// Largest deviation of the kernel that blurs the noise.
        max_width: f32 = 2.0,
            unit "pixels", source Taste, effect "a larger value takes texture for coarse noise";
        /// Levels outside of which a block is not measured: noise is cut off at white, and steps of
        /// 8 bits are large near black.
        levels: [f32; 2] = [0.04, 0.96],
            unit "square root of linear", source Derived("sRGB in 8 bits"),
            effect "a wider range underestimates the noise near its ends";
        /// Level below which the relative deviation does not grow.
        darkest: f32 = 0.125,
            unit "square root of linear", source Taste,
            effect "a smaller value makes objects in dark places grainy when a light is added";
        /// Light of a pixel over its light without a lamp, up to which it keeps its noise.
        relit: f32 = 1.25,
            unit "1", source Taste, effect "a smaller value adds noise farther from lamps";
        /// Largest deviation of the noise that such a pixel gets, over its level.
        max_lacking: f32 = 0.15,
            unit "1", source Taste, effect "a larger value makes dark things around lamps that are off speckled";
        /// Deviation of the rounding to 8 bits, which the output has by itself.
        rounding: f32 = 0.289 / 255.0,
            unit "square root of linear", source Derived("uniform distribution over one step of 1/255"),
            effect "a larger value lowers the noise of photos with little";
        /// Deviation of the brightness with the least, below which there is no noise.
        least: f32 = 0.45 / 255.0,
            unit "square root of linear",
            source Measured("four rendered rooms without noise: 0 to 0.4 / 255; photos: 0.5 / 255 and more"),
            effect "a smaller value adds noise to rendered pictures";
    }
}

/// Side of the tile of noise, pixels: a power of two, at which a repetition is not visible.
const TILE: usize = 1 << 8;

/// The noise of a photo.
#[derive(Clone, Debug)]
pub struct Grain {
    /// For each channel, points (level, deviation) of its curve by increasing level; none without
    /// noise.
    curve: [Vec<[f32; 2]>; 3],
    /// Noise of unit variance.
    tile: Plane<Vec3>,
}

impl Grain {
    /// The noise of a linear photo whose white is 1; `None` where it has less than half a step
    /// of 8 bits, or where no brightness has eight blocks of 16 x 16 pixels.
    pub fn measure(photo: &Picture) -> Option<Grain> {
        let blocks = blocks(photo);
        let bins = [0, 1, 2].map(|channel| bins(&blocks, channel));
        let all = || bins.iter().flatten();
        let sum = |spacing: usize| {
            let squares = |bin: &Bin| -> f32 {
                bin.flat.iter().map(|block| block.square[spacing][bin.channel]).sum()
            };
            all().map(squares).sum()
        };
        let kernel = Kernel::new(width([0, 1].map(sum)));
        let flat = || all().flat_map(|bin| &bin.flat);
        let own: f32 = flat().map(|block| block.own).sum();
        let joint: f32 = flat().map(|block| block.joint).sum();
        let shared = if own > 0.0 { (joint / own).clamp(0.0, 1.0) } else { 0.0 };
        let deviation = |bin: &Bin| (bin.square / kernel.mean_square(TUNING.spacings[1])).sqrt();
        let curve = bins.each_ref().map(|bins| {
            if bins.iter().any(|bin| deviation(bin) < TUNING.least) {
                return Vec::new();
            }
            bins.iter().map(|bin| [bin.level, deviation(bin)]).collect()
        });
        let is_noisy = curve.iter().any(|points: &Vec<_>| !points.is_empty());
        is_noisy.then(|| Grain { curve, tile: tile(&kernel, shared) })
    }

    /// The same noise with `strength` times its deviation, 0 or more.
    pub fn scaled(mut self, strength: f32) -> Grain {
        self.curve.iter_mut().flatten().for_each(|point| point[1] *= strength);
        self
    }

    /// Factor of the linear value of a picture in each channel at pixel (x, y), 0 or more with mean
    /// 1: the noise over the level that a photo with this linear `level` has there.
    pub fn factor(&self, (x, y): (usize, usize), level: Vec3) -> Vec3 {
        let noise = self.tile.get(x % TILE, y % TILE);
        (Vec3::ONE + self.relative(level) * noise).max(Vec3::ZERO)
    }

    /// Fraction of the light of a pixel, without two of which it lacks no noise.
    pub fn few(&self) -> f32 {
        0.5 * (1.0 - 1.0 / TUNING.relit)
    }

    /// The noise over the level that pixel (x, y) of a photo lacks at the linear level `lower`,
    /// when it was photographed at `level`: -1 or more, and at most what makes it as bright as
    /// there.
    ///
    /// Variances of independent noise add up.
    pub fn lacking(&self, (x, y): (usize, usize), level: Vec3, lower: Vec3) -> Vec3 {
        if level.cmple(lower * TUNING.relit).all() {
            return Vec3::ZERO;
        }
        let [has, needs] = [level, lower * TUNING.relit].map(|level| self.relative(level));
        let lacks = (needs * needs - has * has).max(Vec3::ZERO).to_array();
        let deviation = Vec3::from_array(lacks.map(|square| square.sqrt().min(TUNING.max_lacking)));
        let noise = deviation * self.tile.get(x % TILE, y % TILE);
        let most = level / lower.max(Vec3::splat(f32::MIN_POSITIVE)) - Vec3::ONE;
        noise.min(most.max(Vec3::ZERO)).max(Vec3::NEG_ONE)
    }

    /// Standard deviation of the photo's noise over its level, at this linear level.
    ///
    /// With v^2 the level, `d(v^2) / v^2 = 2 dv / v`.
    pub fn relative(&self, level: Vec3) -> Vec3 {
        let root = level.to_array().map(|level| level.max(0.0).sqrt().max(TUNING.darkest));
        let root = Vec3::from_array(root);
        2.0 * self.deviation(root) / root
    }

    /// Standard deviation of the square root of a linear value, at this square root.
    pub(super) fn deviation(&self, root: Vec3) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|c| interpolate(&self.curve[c], root[c])))
    }
}

/// The value at `at` of a curve through points by increasing first number; constant beyond its
/// ends, 0 without points.
pub(super) fn interpolate(points: &[[f32; 2]], at: f32) -> f32 {
    let next = points.partition_point(|point| point[0] <= at);
    match (next.checked_sub(1).map(|i| points[i]), points.get(next)) {
        (Some(low), Some(high)) => low[1] + (at - low[0]) / (high[0] - low[0]) * (high[1] - low[1]),
        (Some(end), None) => end[1],
        (None, end) => end.map_or(0.0, |end| end[1]),
    }
}

/// Moments of one block of the photo.
#[derive(Debug)]
struct Block {
    /// Mean level of each channel.
    level: Vec3,
    /// Mean squares of second differences over 6, per spacing and channel, less the rounding.
    square: [Vec3; 2],
    /// Covariance of two channels in differences of the long spacing, mean of the three pairs.
    joint: f32,
    /// The same if the channels were equal but for their deviations.
    own: f32,
}

/// The flat blocks of one brightness in one channel.
struct Bin<'a> {
    channel: usize,
    /// Mean level.
    level: f32,
    /// Mean square at the long spacing.
    square: f32,
    flat: Vec<&'a Block>,
}

/// Blocks all over the photo in the order of their rows, without those at the ends of the range.
fn blocks(photo: &Picture) -> Vec<Block> {
    let (side, margin) = (TUNING.block, TUNING.spacings[1]);
    let (width, height) = photo.0.size();
    let count = |step: usize| [width, height].map(|n| n.saturating_sub(2 * margin) / (side * step));
    let step = (1..).find(|&step| count(step).iter().product::<usize>() <= TUNING.blocks);
    let step = step.unwrap_or(1);
    let [columns, rows] = count(step);
    let at = |i: usize| [i % columns, i / columns].map(|n| margin + n * side * step);
    let all = (0..columns * rows).into_par_iter().map(|i| block(photo, at(i)));
    let [low, high] = TUNING.levels;
    let in_range = |b: &Block| b.level.min_element() > low && b.level.max_element() < high;
    all.filter(in_range).collect()
}

/// The block whose first pixel this is.
fn block(photo: &Picture, [left, top]: [usize; 2]) -> Block {
    let (side, margin) = (TUNING.block, TUNING.spacings[1]);
    let window = side + 2 * margin;
    let root = |v: Vec3| Vec3::from_array(v.max(Vec3::ZERO).to_array().map(f32::sqrt));
    let values: Vec<Vec3> = (0..window * window)
        .map(|i| root(photo.0.get(left + i % window - margin, top + i / window - margin)))
        .collect();
    let inner = |i: usize| (i / side + margin) * window + i % side + margin;
    let count = (side * side) as f32;
    // Two axes, and the weights 1, -2, 1.
    let norm = 1.0 / (2.0 * 6.0 * count);
    let differences = |spacing: usize| {
        (0..side * side).map(inner).flat_map(move |i| [(i, spacing), (i, spacing * window)])
    };
    let second = |(i, k): (usize, usize)| values[i - k] - 2.0 * values[i] + values[i + k];
    let rounding = Vec3::splat(TUNING.rounding.powi(2));
    let square = TUNING.spacings.map(|spacing| {
        let sum: Vec3 = differences(spacing).map(second).map(|d| d * d).sum();
        (sum * norm - rounding).max(Vec3::ZERO)
    });
    let pairs = |v: Vec3| (v.x * v.y + v.y * v.z + v.z * v.x) / 3.0;
    let joint: f32 = differences(TUNING.spacings[1]).map(second).map(pairs).sum();
    Block {
        level: (0..side * side).map(|i| values[inner(i)]).sum::<Vec3>() / count,
        square,
        joint: joint * norm,
        own: pairs(root(square[1])),
    }
}

/// The flat blocks of a channel by brightness, for each brightness that has enough of them and
/// shows no texture in them.
fn bins(blocks: &[Block], channel: usize) -> Vec<Bin<'_>> {
    let bin = |block: &Block| (block.level[channel] * TUNING.bins as f32) as usize;
    let members =
        |i: usize| -> Vec<&Block> { blocks.iter().filter(|block| bin(block) == i).collect() };
    let mut bins: Vec<Bin> = (0..TUNING.bins).filter_map(|i| flat(members(i), channel)).collect();
    let least = bins.iter().min_by(|a, b| a.square.total_cmp(&b.square));
    let Some((level, square)) = least.map(|bin| (bin.level, bin.square)) else { return bins };
    bins.retain(|bin| {
        let rise = TUNING.max_rise * (level / bin.level).max(1.0);
        bin.square <= square * rise.powi(2)
    });
    bins
}

/// The flattest of these blocks in a channel; `None` if there are too few.
fn flat(mut blocks: Vec<&Block>, channel: usize) -> Option<Bin<'_>> {
    if blocks.len() < TUNING.min_blocks {
        return None;
    }
    let square = |block: &Block| block.square[1][channel];
    blocks.sort_by(|a, b| square(a).total_cmp(&square(b)));
    let [low, high] = TUNING.flat.map(|quantile| (quantile * blocks.len() as f32) as usize);
    let blocks = blocks[low..high.max(low + 1)].to_vec();
    let mean = |value: &dyn Fn(&Block) -> f32| {
        blocks.iter().map(|block| value(block)).sum::<f32>() / blocks.len() as f32
    };
    let (level, square) = (mean(&|block| block.level[channel]), mean(&square) * TUNING.selection);
    Some(Bin { channel, level, square, flat: blocks })
}

/// Deviation of the kernel for the mean squares at both spacings, by bisection: their ratio falls
/// with it.
fn width([fine, coarse]: [f32; 2]) -> f32 {
    let coarse = coarse * TUNING.selection;
    let [mut low, mut high] = [0.0, TUNING.max_width];
    // Each step halves the interval: a thousandth of a pixel.
    for _ in 0..11 {
        let middle = 0.5 * (low + high);
        let kernel = Kernel::new(middle);
        let [near, far] = TUNING.spacings.map(|spacing| kernel.mean_square(spacing));
        if fine * far < coarse * near { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// A sampled Gaussian whose squares sum to 1, of both axes alike, so that white noise keeps its
/// variance under it.
struct Kernel(Vec<f32>);

impl Kernel {
    /// The kernel of this deviation, in pixels.
    fn new(width: f32) -> Kernel {
        let reach = (3.0 * width).ceil() as i32;
        let tap = |d: i32| (-0.5 * (d as f32 / width.max(1e-3)).powi(2)).exp();
        let taps: Vec<f32> = (-reach..=reach).map(tap).collect();
        let norm = taps.iter().map(|tap| tap * tap).sum::<f32>().sqrt();
        Kernel(taps.iter().map(|tap| tap / norm).collect())
    }

    /// Correlation of two values of blurred white noise, `apart` pixels from each other along an
    /// axis.
    fn correlation(&self, apart: usize) -> f32 {
        self.0.iter().zip(self.0.iter().skip(apart)).map(|(a, b)| a * b).sum()
    }

    /// Mean square of second differences of noise with unit variance, over 6.
    fn mean_square(&self, spacing: usize) -> f32 {
        1.0 - (4.0 * self.correlation(spacing) - self.correlation(2 * spacing)) / 3.0
    }
}

/// Noise of unit variance under `kernel`, whose channels have the correlation `shared`; opposite
/// edges fit.
fn tile(kernel: &Kernel, shared: f32) -> Plane<Vec3> {
    let [common, single] = [shared.sqrt(), (1.0 - shared).sqrt()];
    let white = Plane::from_fn(TILE, TILE, |x, y| {
        let noise = |channel: usize| white([x, y, channel]);
        common * noise(3) + single * Vec3::from_array([0, 1, 2].map(noise))
    });
    let reach = kernel.0.len() / 2;
    let wrapped = |at: usize, tap: usize| (at + tap + TILE - reach) % TILE;
    let taps = || kernel.0.iter().enumerate();
    let wide = Plane::from_fn(TILE, TILE, |x, y| {
        taps().map(|(tap, weight)| *weight * white.get(wrapped(x, tap), y)).sum::<Vec3>()
    });
    Plane::from_fn(TILE, TILE, |x, y| {
        taps().map(|(tap, weight)| *weight * wide.get(x, wrapped(y, tap))).sum::<Vec3>()
    })
}

/// White noise of unit variance at a position: the sum of four uniform numbers, which is close to a
/// normal distribution, from the finalizer of SplitMix64 (Steele, Lea, Flood, "Fast splittable
/// pseudorandom number generators", OOPSLA 2014).
fn white([x, y, channel]: [usize; 3]) -> f32 {
    let mut bits =
        (((channel * TILE + y) * TILE + x + 1) as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^= bits >> 31;
    let sum: f32 = (0..4).map(|i| (bits >> (16 * i) & 0xffff) as f32 / 65535.0 - 0.5).sum();
    sum * 3.0f32.sqrt()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Independent numbers of a normal distribution, by Box and Muller.
    pub fn normal(count: usize) -> Vec<f32> {
        let mut state = 1u64;
        let mut uniform = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            ((state >> 40) as f32 + 0.5) / (1u64 << 24) as f32
        };
        let mut one = || {
            let (radius, angle) =
                ((-2.0 * uniform().ln()).sqrt(), std::f32::consts::TAU * uniform());
            radius * angle.cos()
        };
        (0..count).map(|_| one()).collect()
    }

    const SIZE: (usize, usize) = (400, 300);

    /// A ramp from 0.1 to 0.7 from left to right, darker in blue.
    fn ramp(x: usize) -> Vec3 {
        (0.1 + 0.6 * x as f32 / SIZE.0 as f32) * Vec3::new(1.0, 0.9, 0.5)
    }

    /// The ramp with `noise` at pixel (x, y) and its level.
    fn noisy(mut noise: impl FnMut(usize, usize, Vec3) -> Vec3) -> Picture {
        Picture(Plane::from_fn(SIZE.0, SIZE.1, |x, y| ramp(x) + noise(x, y, ramp(x))))
    }

    /// Deviation of a sensor that counts photons, which is 0.03 at level 1.
    fn photon(level: Vec3) -> Vec3 {
        0.03 * Vec3::from_array(level.to_array().map(f32::sqrt))
    }

    #[track_caller]
    fn near(got: f32, want: f32, relative: f32) {
        assert!((got / want - 1.0).abs() < relative, "{got} for {want}");
    }

    /// Correlation of red with itself one pixel to the right, and with green.
    fn correlations(grain: &Grain) -> [f32; 2] {
        let mean = |term: &dyn Fn(usize, usize) -> f32| {
            let all = (0..TILE * TILE).map(|i| f64::from(term(i % TILE, i / TILE)));
            (all.sum::<f64>() / (TILE * TILE) as f64) as f32
        };
        let red = |x: usize, y: usize| grain.tile.get(x % TILE, y).x;
        assert!(mean(&red).abs() < 0.05, "mean {}", mean(&red));
        near(mean(&|x, y| red(x, y).powi(2)), 1.0, 0.05);
        [mean(&|x, y| red(x, y) * red(x + 1, y)), mean(&|x, y| red(x, y) * grain.tile.get(x, y).y)]
    }

    #[test]
    fn known_white_noise_is_measured_at_each_level() {
        let values = normal(3 * SIZE.0 * SIZE.1);
        let white = |x: usize, y: usize| Vec3::from_slice(&values[3 * (y * SIZE.0 + x)..]);
        // The second is the same at all levels.
        let deviations: [fn(Vec3) -> Vec3; 2] = [photon, |_| Vec3::splat(0.01)];
        for deviation in deviations {
            let photo = noisy(|x, y, level| deviation(level) * white(x, y));
            let grain = Grain::measure(&photo).expect("it is noisy");
            for x in [60, 150, 250, 350] {
                let (got, want) = (grain.relative(ramp(x)), deviation(ramp(x)) / ramp(x));
                (0..3).for_each(|c| near(got[c], want[c], 0.15));
            }
            let [right, green] = correlations(&grain);
            assert!(right.abs() < 0.1 && green.abs() < 0.1, "{right}, {green}");
        }
    }

    #[test]
    fn blurred_gray_noise_keeps_its_correlation() {
        let values = normal((SIZE.0 + 2) * (SIZE.1 + 2));
        let blurred = |x: usize, y: usize| -> f32 {
            let tap = |i: usize| [1.0, 2.0, 1.0][i % 3] * [1.0, 2.0, 1.0][i / 3] / 16.0;
            (0..9).map(|i| tap(i) * values[(y + i / 3) * (SIZE.0 + 2) + x + i % 3]).sum()
        };
        let photo = noisy(|x, y, level| 2.0 * photon(level) * blurred(x, y));
        let grain = Grain::measure(&photo).expect("it is noisy");
        // The squares of 1, 2, 1 sum to 6, their products with the next to 4.
        for x in [60, 200, 350] {
            let (got, want) = (grain.relative(ramp(x)), photon(ramp(x)) / ramp(x) * 12.0 / 16.0);
            (0..3).for_each(|c| near(got[c], want[c], 0.15));
        }
        let [right, green] = correlations(&grain);
        near(right, 4.0 / 6.0, 0.1);
        assert!(green > 0.95, "{green}");
    }

    #[test]
    fn texture_is_not_noise() {
        let values = normal(SIZE.0 * SIZE.1);
        let photo = noisy(|x, y, level| {
            let weave = if y > 150 && (x / 4 + y / 4) % 2 == 0 { 0.2 } else { 0.0 };
            photon(level) * values[y * SIZE.0 + x] - weave * level
        });
        let grain = Grain::measure(&photo).expect("it is noisy");
        for x in [60, 200, 350] {
            near(grain.relative(ramp(x)).y, (photon(ramp(x)) / ramp(x)).y, 0.2);
        }
    }

    #[test]
    fn smooth_pictures_have_no_noise() {
        assert!(Grain::measure(&noisy(|_, _, _| Vec3::ZERO)).is_none());
        let srgb = |v: f32| {
            let code = (crate::image::Transfer::Srgb.encode(v) * 255.0).round() / 255.0;
            crate::image::Transfer::Srgb.decode(code)
        };
        let rounded = noisy(|_, _, level| Vec3::from_array(level.to_array().map(srgb)) - level);
        assert!(Grain::measure(&rounded).is_none());
        for (width, height) in [(0, 0), (1, 1), (12, 4), (22, 22), (6, 500)] {
            let small = Plane::from_fn(width, height, |x, y| Vec3::splat(((x + y) % 2) as f32));
            assert!(Grain::measure(&Picture(small)).is_none(), "{width} x {height}");
        }
    }

    #[test]
    fn a_pixel_without_its_lamp_lacks_the_noise_of_its_new_level() {
        let values = normal(SIZE.0 * SIZE.1);
        let photo = noisy(|x, y, level| photon(level) * values[y * SIZE.0 + x]);
        let grain = Grain::measure(&photo).expect("it is noisy");
        let (level, lower) = (Vec3::splat(0.64), Vec3::splat(0.09));
        let lacking = |i: usize| grain.lacking((i % TILE, i / TILE), level, lower).x;
        let square = (0..TILE * TILE).map(|i| lacking(i).powi(2)).sum::<f32>();
        // Of photons: the variance over the square of the level is inverse to the level.
        let counted = lower.x * TUNING.relit;
        let want = 0.03 * 0.03 * (1.0 / counted - 1.0 / level.x);
        near(square / (TILE * TILE) as f32, want, 0.3);
        let at_ends = [(TUNING.relit * lower, lower), (0.5 * lower, lower), (level, level)];
        assert!(at_ends.iter().all(|&(a, b)| grain.lacking((3, 5), a, b) == Vec3::ZERO));
        // Nothing becomes brighter than in the photo, or black.
        for i in 0..TILE * TILE {
            let factor = 1.0 + grain.lacking((i % TILE, i / TILE), 1.3 * lower, lower);
            assert!(factor.min_element() >= 0.0 && factor.max_element() <= 1.3 + 1e-5, "{factor}");
        }
        let from_black = grain.lacking((3, 5), level, Vec3::ZERO);
        assert!(from_black.is_finite(), "{from_black}");
    }

    #[test]
    fn factors_have_mean_one_and_follow_the_strength() {
        let values = normal(SIZE.0 * SIZE.1);
        let photo = noisy(|x, y, level| photon(level) * values[y * SIZE.0 + x]);
        let measured = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.expect("threads can be started").install(|| Grain::measure(&photo))
        };
        let grain = measured(1).expect("it is noisy");
        let level = Vec3::splat(0.36);
        let factors = |grain: &Grain| -> Vec<f32> {
            (0..TILE * TILE).map(|i| grain.factor((i % TILE, TILE + i / TILE), level).x).collect()
        };
        let deviation = |factors: &[f32]| {
            let square: f32 = factors.iter().map(|f| (f - 1.0).powi(2)).sum();
            (square / factors.len() as f32).sqrt()
        };
        let (one, half) = (factors(&grain), factors(&grain.clone().scaled(0.5)));
        near(one.iter().sum::<f32>() / one.len() as f32, 1.0, 0.01);
        near(deviation(&one), 0.03 / 0.6, 0.15);
        assert!(measured(3).is_some_and(|grain| factors(&grain) == one), "for any threads");
        near(deviation(&half), 0.5 * deviation(&one), 0.01);
        // A level that no block has: black stays finite.
        assert!(grain.factor((3, 5), Vec3::ZERO).is_finite());
    }
}
