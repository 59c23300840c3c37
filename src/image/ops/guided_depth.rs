//! Depth of few pixels brought to the size of its photo, whose edges tell where its steps are.
//!
//! Joint bilateral upsampling (Kopf et al., SIGGRAPH 2007) by weights of distance, color and
//! confidence; a weighted median in place of the mean (Ma et al., ICCV 2013) chooses the surface,
//! so that no value lies between two of them, and a weighted plane in 1 / z gives its depth.

use glam::{Mat3, Vec3};
use rayon::prelude::*;

use super::depth::DEPTH_PLANE;
use super::resample::resize;
use super::upsample::place;
use crate::image::{Depth, Picture, Plane, log_above};
use crate::tuning::tuning;

tuning! {
    /// Constants of the guided upsampling of depth.
    pub const TUNING: GuidedDepthTuning {
        /// Radius of the window.
        reach: usize = 2,
            unit "depth pixels", source Taste, effect "a larger value finds edges that the depth misses by more";
        /// Radius where nothing within `reach` is trusted.
        wide: usize = 5,
            unit "depth pixels", source Measured("docs/doubts.md"), effect "a larger value replaces wider bands of low confidence";
        /// Standard deviation of the weight of distance.
        distance: f32 = 0.5,
            unit "radius of the window", source Taste, effect "a larger value smooths more";
        /// Standard deviation of the weight of color.
        color: f32 = 0.25,
            unit "natural logarithm", source Taste, effect "a smaller value trusts weaker edges of the photo";
        /// Luminance below which colors do not differ.
        black: f32 = 0.01,
            unit "fraction of white", source Taste, effect "a smaller value trusts edges in dark noise";
        /// Least weight of a color and of a confidence.
        floor: f32 = 1e-3,
            unit "1", source Taste, effect "a larger value keeps more of what has no confidence";
        /// Confidence below which a number is not taken as it is.
        trusted: f32 = 0.5,
            unit "1", source Taste, effect "a larger value smooths more";
        /// Determinant of the normal equations up to which a plane is not determined.
        singular: f32 = 1e-4,
            unit "cube of the sum of weights", source Derived("single precision"), effect "a larger value takes the mean more often";
    }
}

/// Most pixels of the depth in a window.
const MOST_TAPS: usize = (2 * TUNING.wide + 1) * (2 * TUNING.wide + 1);

/// One pixel of the depth near a pixel of the photo.
#[derive(Clone, Copy)]
struct Tap {
    z: f32,
    weight: f32,
    /// Offset from the pixel of the photo, depth pixels.
    x: f32,
    y: f32,
}

/// The depth at the size of `photo`. `confidence` has the size of the depth, 0 to 1. Between pixels
/// of one surface, 1 / z is linear; at a step, the colors of the photo choose the surface.
///
/// # Panics
/// The confidence has another size than the depth.
pub fn guided_depth(depth: &Depth, confidence: Option<&Plane<f32>>, photo: &Picture) -> Depth {
    let plane = &depth.0;
    let (w, h) = plane.size();
    assert!(confidence.is_none_or(|c| c.size() == (w, h)), "a confidence has its depth's size");
    let log = |c: Vec3| log_above(TUNING.black, c);
    let colors = resize(&photo.0, w, h).map(log);
    let near = |at: f32, n: usize| (at.round().max(0.0) as usize).min(n - 1);
    let window = |at: f32, n: usize, reach: usize| {
        let near = near(at, n);
        near.saturating_sub(reach)..(near + reach + 1).min(n)
    };
    let trusts = |x: usize, y: usize| confidence.is_none_or(|c| c.get(x, y) >= TUNING.trusted);
    let reach = Plane::from_fn(w, h, |x, y| {
        let columns = window(x as f32, w, TUNING.reach);
        let finds = |y| columns.clone().any(|x| trusts(x, y));
        let mut rows = window(y as f32, h, TUNING.reach);
        if rows.any(finds) { TUNING.reach } else { TUNING.wide }
    });
    let even = Plane::from_fn(w, h, |x, y| {
        let (mut low, mut high, mut sure) = (f32::MAX, 0.0f32, true);
        for y in window(y as f32, h, TUNING.reach) {
            for x in window(x as f32, w, TUNING.reach) {
                let z = plane.get(x, y);
                (low, high) = (low.min(z), high.max(z));
                sure &= trusts(x, y);
            }
        }
        sure && high - low <= DEPTH_PLANE.step * low
    });
    let (full_w, full_h) = photo.0.size();
    let pixel = |i: usize| {
        let (px, py) = (i % full_w, i / full_w);
        let (fx, fy) = (place(px, full_w, w), place(py, full_h, h));
        let (x, y) = (near(fx, w), near(fy, h));
        let reach = reach.get(x, y);
        let (nx, ny) = (window(fx, w, reach), window(fy, h, reach));
        if even.get(x, y) {
            return linear(plane, fx, fy);
        }
        let color = log(photo.0.get(px, py));
        let mut taps = [Tap { z: 0.0, weight: 0.0, x: 0.0, y: 0.0 }; MOST_TAPS];
        let spread = TUNING.distance * reach as f32;
        let mut count = 0;
        for y in ny {
            for x in nx.clone() {
                let (dx, dy) = (x as f32 - fx, y as f32 - fy);
                let far = (dx * dx + dy * dy) / (2.0 * spread * spread);
                let other = (colors.get(x, y) - color).length_squared()
                    / (2.0 * TUNING.color * TUNING.color);
                let sure = confidence.map_or(1.0, |c| c.get(x, y).max(TUNING.floor));
                let weight = (-far).exp() * ((-other).exp() + TUNING.floor) * sure;
                taps[count] = Tap { z: plane.get(x, y), weight, x: dx, y: dy };
                count += 1;
            }
        }
        of_surface(&mut taps[..count])
    };
    let pixels = (0..full_w * full_h).into_par_iter().with_min_len(full_w).map(pixel).collect();
    Depth(Plane::new(full_w, full_h, pixels))
}

/// Depth at a place between the centers of pixels, linear in 1 / z.
fn linear(plane: &Plane<f32>, fx: f32, fy: f32) -> f32 {
    let axis = |at: f32, n: usize| {
        let at = at.clamp(0.0, (n - 1) as f32);
        (at as usize, (at as usize + 1).min(n - 1), at.fract())
    };
    let (x0, x1, sx) = axis(fx, plane.width());
    let (y0, y1, sy) = axis(fy, plane.height());
    let row = |y| {
        let (a, b) = (1.0 / plane.get(x0, y), 1.0 / plane.get(x1, y));
        a + (b - a) * sx
    };
    let (top, bottom) = (row(y0), row(y1));
    1.0 / (top + (bottom - top) * sy)
}

/// Depth of the surface that has the median of the weights: a plane in 1 / z through its pixels,
/// within their range.
fn of_surface(taps: &mut [Tap]) -> f32 {
    taps.sort_by(|a, b| a.z.total_cmp(&b.z));
    let half = 0.5 * taps.iter().map(|tap| tap.weight).sum::<f32>();
    let mut sum = 0.0;
    let middle = taps.iter().find(|tap| {
        sum += tap.weight;
        sum >= half
    });
    let middle = middle.unwrap_or(&taps[taps.len() - 1]).z;
    let near = |tap: &&Tap| (tap.z - middle).abs() <= DEPTH_PLANE.step * tap.z.min(middle);
    let (mut normal, mut right, mut weight) = (Mat3::ZERO, Vec3::ZERO, 0.0);
    let (mut low, mut high) = (f32::MAX, 0.0f32);
    for tap in taps.iter().filter(near) {
        let (row, q) = (Vec3::new(1.0, tap.x, tap.y), 1.0 / tap.z);
        normal += Mat3::from_cols(row, row * tap.x, row * tap.y) * tap.weight;
        right += row * (q * tap.weight);
        weight += tap.weight;
        (low, high) = (low.min(q), high.max(q));
    }
    let determined = normal.determinant() > TUNING.singular * weight * weight * weight;
    let q = if determined { (normal.inverse() * right).x } else { right.x / weight };
    1.0 / q.clamp(low, high)
}
