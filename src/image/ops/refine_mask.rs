//! Refinement of ragged masks against a photo.
//!
//! Masks that people draw miss the true edge by a few pixels. In a band around the boundary of the
//! mask, the fraction a of each pixel that belongs to the masked thing is unknown; it minimizes
//! `a^T L a + sum_i l_i (a_i - m_i)^2` with the mask m, and a = m outside of the band. L is the
//! matting Laplacian of Levin, Lischinski and Weiss, "A closed-form solution to natural image
//! matting" (PAMI 30(2), 2008): within a window, a is an affine function of the guide, the color of
//! the photo and the logarithm of depth. Windows of 5 x 5 pixels let the conjugate gradients
//! converge in few iterations (He, Sun and Tang, "Fast matting using large kernel matting Laplacian
//! matrices", CVPR 2010); a product with L is one pass of the guided filter (He, Sun and Tang, PAMI
//! 35(6), 2013). The weight l of the mask is small where thing and surroundings differ in color or
//! depth, and large where the photo does not determine the edge.
//!
//! Large photos are solved at a size of at most `TUNING.long_side`, and the coefficients of the
//! affine functions are interpolated to the photo's size (He and Sun, "Fast guided filter",
//! arXiv:1505.00996). So time and memory of the solution are bounded for any photo.

use std::ops::{Add, Range};

use glam::{DMat4, Mat4, Vec3, Vec4};
use rayon::prelude::*;

use super::conjugate_gradients::conjugate_gradients;
use crate::image::{Depth, Picture, Plane, distance};
use crate::tuning::tuning;

tuning! {
    /// Constants of the refinement of masks.
    pub const TUNING: RefineMaskTuning {
        /// Longer side of a photo above which masks are solved at a smaller size.
        long_side: usize = 1280,
            unit "pixels", source Derived("half a second for the masks of a large photo"),
            effect "a larger value is slower and finds finer detail in large photos";
        /// Half width of the band around the boundary of a mask, over the photo's longer side.
        reach: f32 = 0.008,
            unit "1", source Measured("masks of photos are off by 2 to 4 pixels of 608"),
            effect "a larger value corrects larger errors, and takes more texture for an edge";
        /// Least half width of the band.
        min_reach: usize = 3,
            unit "pixels of the solution", source Taste, effect "a larger value corrects larger errors of small photos";
        /// Part of the half width of a thin piece of the mask, or of a thin gap, that the band may
        /// take.
        thin: f32 = 0.6,
            unit "1", source Taste, effect "a larger value lets thin pieces disappear";
        /// Half side of the windows in which alpha is an affine function of the guide.
        window: usize = 2,
            unit "pixels of the solution", source Measured("a ragged disc under noise: error 0.003 to 0.006, with 1 up to 0.011"),
            effect "a larger value averages more noise, and needs edges that are farther apart";
        /// Standard deviation of color in a window that counts as noise, over the mean color.
        noise: f32 = 0.02,
            unit "1", source Taste, effect "a larger value follows only stronger edges";
        /// Least standard deviation of color that is not noise.
        floor: f32 = 0.004,
            unit "units of the photo", source Derived("quantization of 8-bit photos"),
            effect "a larger value ignores edges in the dark";
        /// Standard deviation of the logarithm of depth that counts as noise.
        depth_noise: f32 = 0.02,
            unit "1", source Taste, effect "a larger value follows only larger steps of depth";
        /// Weight of the mask where the two sides of its boundary differ, and what it gains where
        /// they do not.
        trust: [f32; 2] = [0.0005, 100.0],
            unit "weight of a window", source Measured("a ragged disc: error 0.005 with 0.0005, 0.011 with 0.002"),
            effect "larger values keep more of the given mask";
        /// Difference |W - O| of the two sides over |W + O|, and of their logarithms of depth, at
        /// which that gain is 1 / e.
        different: [f32; 2] = [0.1, 0.1],
            unit "1", source Taste, effect "smaller values trust fainter edges";
        /// Largest number of iterations.
        iterations: usize = 100,
            unit "iterations", source Derived("the tolerance is met within 60"), effect "a smaller value is faster";
        /// Residual over that at the start at which the iteration ends.
        tolerance: f64 = 1e-3,
            unit "1", source Taste, effect "a smaller value is slower";
        /// Residual over the diagonal, root mean square, at which the iteration ends.
        exact: f64 = 1e-4,
            unit "alpha", source Derived("single precision"),
            effect "a smaller value amplifies rounding where the mask is exact";
        /// Distance from 0 and 1 within which an alpha is rounded.
        whole: f32 = 0.02,
            unit "1", source Taste, effect "a larger value leaves fewer mixed pixels";
    }
}

/// The fraction of each pixel that belongs to the thing that `mask` marks, 0..=1, with its edge
/// where the photo and the depth have it. All planes have one size.
///
/// The mask may be off by `TUNING.reach` of the longer side, or by `reach` pixels if that is more.
/// A wide soft edge of a mask stays as it is.
///
/// # Panics
/// The sizes differ.
pub fn refine_mask(
    mask: &Plane<f32>,
    photo: &Picture,
    depth: Option<&Depth>,
    reach: f32,
) -> Plane<f32> {
    assert_eq!(mask.size(), photo.0.size(), "a mask has its photo's size");
    assert!(depth.is_none_or(|depth| depth.0.size() == mask.size()), "depth at the photo's size");
    let (w, h) = mask.size();
    let step = w.max(h).div_ceil(TUNING.long_side).max(1);
    let long = (w.max(h) / step) as f32;
    let band = (TUNING.reach * long).max(reach / step as f32).ceil() as usize;
    let band = band.max(TUNING.min_reach);
    let Some(crop) = Crop::around(mask, step, band + 2 * TUNING.window) else {
        return mask.clone();
    };
    let guide = |x: usize, y: usize| {
        let z = depth.map_or(1.0, |depth| depth.0.get(x, y));
        photo.0.get(x, y).extend(z.max(f32::MIN_POSITIVE).ln())
    };
    let small = Plane::new(crop.columns, crop.rows, crop.means(guide));
    let given = Plane::new(crop.columns, crop.rows, crop.means(|x, y| mask.get(x, y)));
    let band = Band::of(&given, &small, band);
    if band.unknown.is_empty() {
        return mask.clone();
    }
    let matting = Matting::new(&small, &band);
    let alpha = matting.solve(&given, &band);
    let mut refined = mask.clone();
    let whole = |share: f32| {
        let share = share.clamp(0.0, 1.0);
        if (TUNING.whole..=1.0 - TUNING.whole).contains(&share) { share } else { share.round() }
    };
    if step == 1 {
        for &i in &band.unknown {
            let (x, y) = (i as usize % crop.columns, i as usize / crop.columns);
            refined.set(crop.left + x, crop.top + y, whole(alpha.pixels()[i as usize]));
        }
        return refined;
    }
    let affine = matting.affine(&alpha);
    for y in crop.top..(crop.top + crop.rows * step).min(h) {
        for x in crop.left..(crop.left + crop.columns * step).min(w) {
            let cell = ((x - crop.left) / step, (y - crop.top) / step);
            if band.is_unknown(cell) {
                let at = [(x, crop.left), (y, crop.top)]
                    .map(|(x, from)| ((x - from) as f32 + 0.5) / step as f32 - 0.5);
                let (slope, offset) = affine.at(at);
                refined.set(x, y, whole(slope.dot(guide(x, y)) + offset));
            }
        }
    }
    refined
}

/// The part of the photo around a mask, in cells of `step` x `step` pixels.
struct Crop {
    left: usize,
    top: usize,
    columns: usize,
    rows: usize,
    step: usize,
    /// Size of the photo.
    size: (usize, usize),
}

impl Crop {
    /// The bounding box of `mask`, `margin` cells wider; `None` if nothing is masked.
    fn around(mask: &Plane<f32>, step: usize, margin: usize) -> Option<Crop> {
        let (w, h) = mask.size();
        let (mut xs, mut ys) = ((usize::MAX, 0), (usize::MAX, 0));
        for (i, _) in mask.pixels().iter().enumerate().filter(|(_, share)| **share > 0.0) {
            xs = (xs.0.min(i % w), xs.1.max(i % w));
            ys = (ys.0.min(i / w), ys.1.max(i / w));
        }
        let cells = |(low, high): (usize, usize), n: usize| -> Range<usize> {
            (low / step).saturating_sub(margin)..(high / step + margin + 1).min(n.div_ceil(step))
        };
        (xs.0 <= xs.1).then(|| {
            let (xs, ys) = (cells(xs, w), cells(ys, h));
            let (left, top) = (xs.start * step, ys.start * step);
            Crop { left, top, columns: xs.len(), rows: ys.len(), step, size: (w, h) }
        })
    }

    /// Mean of `value` over the pixels of each cell.
    fn means<T>(&self, value: impl Fn(usize, usize) -> T + Sync) -> Vec<T>
    where
        T: Copy + Default + Send + Add<Output = T> + std::ops::Mul<f32, Output = T>,
    {
        let mean = |i: usize| {
            let cell = |at: usize, from: usize, n: usize| {
                let start = from + at * self.step;
                start..(start + self.step).min(n)
            };
            let xs = cell(i % self.columns, self.left, self.size.0);
            let ys = cell(i / self.columns, self.top, self.size.1);
            let count = (xs.len() * ys.len()) as f32;
            let all = ys.flat_map(|y| xs.clone().map(move |x| (x, y)));
            all.fold(T::default(), |sum, (x, y)| sum + value(x, y)) * (1.0 / count)
        };
        (0..self.columns * self.rows).into_par_iter().map(mean).collect()
    }
}

/// The cells whose alpha is unknown.
struct Band {
    /// Their indices, rising.
    unknown: Vec<u32>,
    /// Position in `unknown` of each cell, or `KNOWN`.
    place: Plane<u32>,
    /// Weight of the mask in each unknown cell.
    trust: Vec<f32>,
}

const KNOWN: u32 = u32::MAX;

impl Band {
    /// The cells within `reach` of the boundary of `mask`, without those that are wide soft edges,
    /// and at least `TUNING.thin` of the way to the middle of thin pieces.
    fn of(mask: &Plane<f32>, guide: &Plane<Vec4>, reach: usize) -> Band {
        let (w, h) = mask.size();
        let sure = |side: bool| {
            let depth = distance(&mask.map(|share| (share > 0.5) != side));
            let top = over_windows(&depth, reach, f32::max);
            Plane::from_fn(w, h, |x, y| {
                depth.get(x, y) > (TUNING.thin * top.get(x, y)).min(reach as f32)
            })
        };
        let (inside, outside) = (sure(true), sure(false));
        let hard = mask.map(|share| {
            f32::from(u8::from(!(TUNING.whole..=1.0 - TUNING.whole).contains(&share)))
        });
        let near_hard = over_windows(&hard, 1, f32::max);
        let is_unknown = |i: &u32| {
            let i = *i as usize;
            !inside.pixels()[i] && !outside.pixels()[i] && near_hard.pixels()[i] > 0.0
        };
        let unknown: Vec<u32> = (0..(w * h) as u32).filter(is_unknown).collect();
        let mut place = Plane::filled(w, h, KNOWN);
        unknown.iter().zip(0..).for_each(|(&i, at)| place.pixels_mut()[i as usize] = at);
        let mean = |side: &Plane<bool>| {
            let share = side.map(|is| f32::from(u8::from(is)));
            let sums = Plane::from_fn(w, h, |x, y| guide.get(x, y) * share.get(x, y));
            let counts = over_windows(&share, 2 * reach, f32::add);
            let sums = over_windows(&sums, 2 * reach, Vec4::add);
            move |i: usize| {
                let count = counts.pixels()[i];
                (count > 0.0).then(|| sums.pixels()[i] / count)
            }
        };
        let (own, other) = (mean(&inside), mean(&outside));
        let trust = |&i: &u32| {
            let alike = own(i as usize).zip(other(i as usize)).map_or(1.0, alike);
            TUNING.trust[0] + TUNING.trust[1] * alike
        };
        let trust = unknown.iter().map(trust).collect();
        Band { unknown, place, trust }
    }

    fn is_unknown(&self, (x, y): (usize, usize)) -> bool {
        self.place.get(x, y) != KNOWN
    }
}

/// Likeness of the two sides of a boundary, 1 if they are equal.
fn alike((own, other): (Vec4, Vec4)) -> f32 {
    let rgb = |guide: Vec4| guide.truncate();
    let step = (rgb(own) - rgb(other)).length();
    let color = step / (TUNING.different[0] * (rgb(own) + rgb(other)).length().max(TUNING.floor));
    let depth = (own.w - other.w) / TUNING.different[1];
    (-color * color - depth * depth).exp()
}

/// `join` of all values within `reach` rows and columns of each pixel.
pub(super) fn over_windows<T: Copy + Send + Sync>(
    plane: &Plane<T>,
    reach: usize,
    join: impl Fn(T, T) -> T + Sync,
) -> Plane<T> {
    let (w, h) = plane.size();
    let along = |plane: &Plane<T>, horizontal: bool| {
        let value = |i: usize| {
            let (x, y) = (i % w, i / w);
            let (at, n) = if horizontal { (x, w) } else { (y, h) };
            let get = |at: usize| if horizontal { plane.get(at, y) } else { plane.get(x, at) };
            let from = at.saturating_sub(reach);
            (from + 1..(at + reach + 1).min(n)).fold(get(from), |all, at| join(all, get(at)))
        };
        Plane::new(w, h, (0..w * h).into_par_iter().map(value).collect())
    };
    along(&along(plane, true), false)
}

/// One window: mean and inverse covariance of its guide. The covariance of a gray picture is almost
/// singular: single precision would not do.
struct Window {
    center: u32,
    mean: Vec4,
    inverse: DMat4,
}

/// The matting Laplacian of the windows that contain an unknown cell.
struct Matting<'a> {
    guide: &'a Plane<Vec4>,
    windows: Vec<Window>,
    /// Position in `windows` of the window around each cell, or `KNOWN`.
    place: Plane<u32>,
}

impl<'a> Matting<'a> {
    fn new(guide: &'a Plane<Vec4>, band: &Band) -> Matting<'a> {
        let (w, h) = guide.size();
        let mut place = Plane::filled(w, h, KNOWN);
        for &i in &band.unknown {
            cells((w, h), i as usize).for_each(|j| place.pixels_mut()[j] = 0);
        }
        let centers: Vec<u32> =
            (0..(w * h) as u32).filter(|&i| place.pixels()[i as usize] != KNOWN).collect();
        centers.iter().zip(0..).for_each(|(&i, at)| place.pixels_mut()[i as usize] = at);
        let window = |&center: &u32| {
            let own = || cells((w, h), center as usize).map(|j| guide.pixels()[j]);
            let scale = 1.0 / own().count() as f32;
            let mean = own().sum::<Vec4>() * scale;
            let product = |a: Vec4| Mat4::from_cols(a * a.x, a * a.y, a * a.z, a * a.w);
            let covariance =
                own().fold(Mat4::ZERO, |sum, value| sum + product(value - mean)) * scale;
            let level = TUNING.noise * TUNING.noise * mean.truncate().length_squared() / 3.0;
            let color = level + TUNING.floor * TUNING.floor;
            let noise = Vec3::splat(color).extend(TUNING.depth_noise * TUNING.depth_noise);
            let inverse =
                (covariance.as_dmat4() + DMat4::from_diagonal(noise.as_dvec4())).inverse();
            Window { center, mean, inverse }
        };
        let windows = centers.par_iter().map(window).collect();
        Matting { guide, windows, place }
    }

    /// Slope and offset in each window of the affine function of the guide that is nearest to
    /// `values`.
    fn fit(&self, values: &Plane<f32>) -> Vec<(Vec4, f32)> {
        let size = values.size();
        let fit = |window: &Window| {
            let (mut sum, mut moment, mut count) = (0.0, Vec4::ZERO, 0.0);
            for j in cells(size, window.center as usize) {
                let value = values.pixels()[j];
                sum += value;
                moment += value * (self.guide.pixels()[j] - window.mean);
                count += 1.0;
            }
            let slope = (window.inverse * (moment / count).as_dvec4()).as_vec4();
            (slope, sum / count - slope.dot(window.mean))
        };
        self.windows.par_iter().map(fit).collect()
    }

    /// The product of the Laplacian with `values` in each unknown cell, and the number of windows
    /// that contain it.
    fn product(&self, values: &Plane<f32>, band: &Band) -> Vec<f32> {
        let fits = self.fit(values);
        let row = |&i: &u32| {
            let (i, guide) = (i as usize, self.guide.pixels()[i as usize]);
            let terms = cells(values.size(), i).map(|j| {
                let (slope, offset) = fits[self.place.pixels()[j] as usize];
                values.pixels()[i] - slope.dot(guide) - offset
            });
            terms.sum()
        };
        band.unknown.par_iter().map(row).collect()
    }

    /// Alpha in all cells, by conjugate gradients from `mask` with the diagonal as preconditioner.
    fn solve(&self, mask: &Plane<f32>, band: &Band) -> Plane<f32> {
        let count = |&i: &u32| cells(mask.size(), i as usize).count() as f32;
        let counts: Vec<f32> = band.unknown.iter().map(count).collect();
        let weights: Vec<f32> = band.trust.iter().zip(&counts).map(|(t, n)| t * n).collect();
        let diagonal: Vec<f32> =
            weights.iter().zip(&counts).map(|(weight, n)| weight + n - 1.0).collect();
        // Outside of the band alpha is the nearer of 0 and 1, or that of a wide soft edge.
        let mut alpha = mask.clone();
        let residual = self.product(&alpha, band).into_iter().map(|value| -value).collect();
        let mut direction = Plane::filled(mask.width(), mask.height(), 0.0);
        let scale: f64 = diagonal.iter().map(|&d| f64::from(d)).sum();
        let enough =
            |energy: f64| (TUNING.tolerance.powi(2) * energy).max(TUNING.exact.powi(2) * scale);
        let cells = || band.unknown.iter().map(|&i| i as usize);
        let mut values: Vec<f32> = cells().map(|i| alpha.pixels()[i]).collect();
        let end = (enough, TUNING.iterations);
        conjugate_gradients(&mut values, residual, &diagonal, end, |along| {
            cells().zip(along).for_each(|(i, &step)| direction.pixels_mut()[i] = step);
            let mut image = self.product(&direction, band);
            image.iter_mut().zip(&weights).zip(along).for_each(|((l, w), p)| *l += w * p);
            image
        });
        cells().zip(values).for_each(|(i, value)| alpha.pixels_mut()[i] = value);
        alpha
    }

    /// The mean of the affine functions of all windows around each cell, which together give
    /// `alpha`.
    fn affine(&self, alpha: &Plane<f32>) -> Affine {
        let (w, h) = alpha.size();
        let fits = self.fit(alpha);
        let mean = |i: usize| {
            let own = cells((w, h), i).map(|j| self.place.pixels()[j]).filter(|at| *at != KNOWN);
            let (sum, count) = own.fold(((Vec4::ZERO, 0.0), 0.0), |((s, o), n), at| {
                let (slope, offset) = fits[at as usize];
                ((s + slope, o + offset), n + 1.0)
            });
            (sum.0 / f32::max(count, 1.0), sum.1 / f32::max(count, 1.0), count > 0.0)
        };
        Affine(Plane::new(w, h, (0..w * h).into_par_iter().map(mean).collect()))
    }
}

/// Indices of the cells in the window around cell `i`.
fn cells((w, h): (usize, usize), i: usize) -> impl Iterator<Item = usize> {
    let span =
        |at: usize, n: usize| at.saturating_sub(TUNING.window)..(at + TUNING.window + 1).min(n);
    let (xs, ys) = (span(i % w, w), span(i / w, h));
    ys.flat_map(move |y| xs.clone().map(move |x| y * w + x))
}

/// Slope and offset of alpha over the guide around each cell, and whether a window gives them.
struct Affine(Plane<(Vec4, f32, bool)>);

impl Affine {
    /// Slope and offset by bilinear interpolation at a position in cells, whose centers are whole
    /// numbers.
    fn at(&self, at: [f32; 2]) -> (Vec4, f32) {
        let (w, h) = self.0.size();
        let axis = |at: f32, n: usize| {
            let at = at.clamp(0.0, (n - 1) as f32);
            [(at as usize, 1.0 - at.fract()), ((at as usize + 1).min(n - 1), at.fract())]
        };
        let (mut slope, mut offset, mut total) = (Vec4::ZERO, 0.0, 0.0);
        for (y, wy) in axis(at[1], h) {
            for (x, wx) in axis(at[0], w) {
                let (s, o, is_given) = self.0.get(x, y);
                if is_given {
                    slope += wx * wy * s;
                    offset += wx * wy * o;
                    total += wx * wy;
                }
            }
        }
        let scale = 1.0 / f32::max(total, f32::MIN_POSITIVE);
        (slope * scale, offset * scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const THING: Vec3 = Vec3::new(1.0, 0.95, 0.8);
    const WALL: Vec3 = Vec3::new(0.3, 0.25, 0.2);

    fn hash(i: usize) -> f32 {
        (i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as f32 / (1u64 << 24) as f32 - 0.5
    }

    /// Distance of a pixel inside of a disc of radius `radius` around the middle.
    fn disc((w, h): (usize, usize), radius: f32, x: usize, y: usize) -> f32 {
        radius - (x as f32 - 0.5 * w as f32).hypot(y as f32 - 0.5 * h as f32)
    }

    fn mean_error(a: &Plane<f32>, b: &Plane<f32>, near: &Plane<bool>) -> f32 {
        let all = a.pixels().iter().zip(b.pixels()).zip(near.pixels()).filter(|(_, near)| **near);
        let (sum, count) =
            all.fold((0.0, 0.0), |(sum, n), ((a, b), _)| (sum + (a - b).abs(), n + 1.0));
        sum / count
    }

    /// A disc of two colors with a mask that is off by 2 to 4 pixels of 608: mean error in the band
    /// before and after.
    fn ragged_disc(size: (usize, usize), noise: f32, bias: f32) -> [f32; 2] {
        let (w, h) = size;
        let scale = w.max(h) as f32 / 608.0;
        let radius = 0.3 * h as f32;
        let truth = Plane::from_fn(w, h, |x, y| disc(size, radius, x, y).clamp(0.0, 1.0));
        let mut photo = truth.map(|a| WALL.lerp(THING, a));
        for (i, pixel) in photo.pixels_mut().iter_mut().enumerate() {
            *pixel += noise * Vec3::new(hash(3 * i), hash(3 * i + 1), hash(3 * i + 2));
        }
        let mask = Plane::from_fn(w, h, |x, y| {
            let turn = (y as f32 - 0.5 * h as f32).atan2(x as f32 - 0.5 * w as f32);
            let error = scale * (bias + 1.5 * (9.0 * turn).sin() + (23.0 * turn).cos());
            if disc(size, radius + error, x, y) > 0.5 { 1.0 } else { 0.0 }
        });
        let near = Plane::from_fn(w, h, |x, y| disc(size, radius, x, y).abs() < 5.0 * scale);
        let found = refine_mask(&mask, &Picture(photo), None, 0.0);
        [mean_error(&mask, &truth, &near), mean_error(&found, &truth, &near)]
    }

    #[test]
    fn a_ragged_mask_returns_to_the_edge() {
        for (size, noise, bias, most) in [
            ((304, 228), 0.03, 0.0, 0.02),
            ((608, 456), 0.03, 2.0, 0.02),
            ((608, 456), 0.03, -2.0, 0.02),
            ((2700, 1800), 0.03, 2.0, 0.02),
        ] {
            let [before, after] = ragged_disc(size, noise, bias);
            assert!(before > 5.0 * after && after < most, "{size:?} {bias}: {before} -> {after}");
        }
    }

    /// A straight edge at column 20.3 of 40; the mask ends three columns beside it.
    #[test]
    fn a_straight_edge_has_its_fraction() {
        let truth = |x: usize| (20.3 - x as f32).clamp(0.0, 1.0);
        let photo = Picture(Plane::from_fn(40, 30, |x, _| WALL.lerp(THING, truth(x))));
        for end in [18, 20, 21, 23] {
            let mask = Plane::from_fn(40, 30, |x, _| if x < end { 1.0 } else { 0.0 });
            let found = refine_mask(&mask, &photo, None, 5.0);
            for x in 0..40 {
                let got = found.get(x, 15);
                assert!((got - truth(x)).abs() < 0.03, "{end}, {x}: {got} of {}", truth(x));
            }
        }
    }

    #[test]
    fn depth_finds_the_edge_between_like_colors() {
        let photo = Picture(Plane::filled(40, 30, WALL));
        let depth = Depth(Plane::from_fn(40, 30, |x, _| if x < 20 { 2.0 } else { 3.0 }));
        let mask = Plane::from_fn(40, 30, |x, _| if x < 23 { 1.0 } else { 0.0 });
        let found = refine_mask(&mask, &photo, Some(&depth), 5.0);
        for x in 0..40 {
            let want = if x < 20 { 1.0 } else { 0.0 };
            assert!((found.get(x, 15) - want).abs() < 0.05, "{x}: {}", found.get(x, 15));
        }
    }

    #[test]
    fn masks_stay_where_the_photo_determines_nothing() {
        let even = Picture(Plane::filled(60, 40, WALL));
        let hard = Plane::from_fn(60, 40, |x, y| if x > 20 && y > 12 { 1.0 } else { 0.0 });
        let found = refine_mask(&hard, &even, None, 0.0);
        assert_eq!(found, hard);
        let soft = Plane::from_fn(60, 40, |x, _| x as f32 / 59.0);
        let found = refine_mask(&soft, &even, None, 0.0);
        let error = |(a, b): (&f32, &f32)| (a - b).abs();
        assert!(found.pixels().iter().zip(soft.pixels()).map(error).fold(0.0, f32::max) < 0.03);
        let empty = Plane::filled(60, 40, 0.0);
        assert_eq!(refine_mask(&empty, &even, None, 0.0), empty);
        assert_eq!(
            refine_mask(&Plane::filled(1, 1, 1.0), &Picture(Plane::filled(1, 1, WALL)), None, 0.0)
                .get(0, 0),
            1.0
        );
    }
}
