//! Depth: holes, their filling, and other sizes without averaging across a depth step.

use crate::image::{Depth, Mask, Plane};
use crate::tuning::tuning;

tuning! {
    /// Constants of depth: holes and steps.
    pub const DEPTH_PLANE: DepthPlaneTuning {
        /// Least depth that an indoor sensor or renderer gives; less is a hole.
        near: f32 = 1e-4,
            unit "meters", source Taste, effect "a larger value takes near readings for holes";
        /// Largest depth that an indoor sensor or renderer gives; more is a hole.
        far: f32 = 1e5,
            unit "meters", source Taste, effect "a smaller value takes distant readings for holes";
        /// Difference of the depths of neighbors, over the nearer one, above which they lie on
        /// different surfaces.
        step: f32 = 0.12,
            unit "1", source Taste, effect "a larger value joins surfaces across steps";
    }
}

/// A planar depth in meters is a hole: zero, negative, NaN, infinite, or outside
/// `DEPTH_PLANE.near`..=`DEPTH_PLANE.far`.
pub fn is_hole(z: f32) -> bool {
    !(DEPTH_PLANE.near..=DEPTH_PLANE.far).contains(&z)
}

/// Fills holes from the readings around them; `None` without any reading. Readings stay as they
/// are. The mask is 1 at holes.
///
/// Push-pull: a pyramid of weighted means, then every hole takes the interpolated value of the
/// finest level that has one. The means are of 1/z, which is linear over the image of a plane.
/// Readings where `untrusted` is above zero (panes that show the world outside) keep their own
/// value but fill nothing, unless nothing else is there.
///
/// # Panics
/// The sizes differ.
pub fn inpaint_depth(meters: &Plane<f32>, untrusted: &Plane<f32>) -> Option<(Depth, Mask)> {
    assert_eq!(meters.size(), untrusted.size(), "one trust per reading");
    let holes = meters.map(|z| if is_hole(z) { 1.0 } else { 0.0 });
    let pairs = || meters.pixels().iter().zip(untrusted.pixels());
    let all = !pairs().any(|(&z, &u)| !is_hole(z) && u <= 0.0);
    let known: Vec<(f32, f32)> = pairs()
        .map(|(&z, &u)| if is_hole(z) || (u > 0.0 && !all) { (0.0, 0.0) } else { (1.0 / z, 1.0) })
        .collect();
    if known.iter().all(|&(_, weight)| weight == 0.0) {
        return None;
    }
    let filled = push_pull(&Plane::new(meters.width(), meters.height(), known));
    let data = meters
        .pixels()
        .iter()
        .zip(filled.pixels())
        .map(|(&z, &q)| if is_hole(z) { 1.0 / q } else { z });
    Some((Depth(Plane::new(meters.width(), meters.height(), data.collect())), Mask(holes)))
}

/// Values of (value, weight) pixels, weights 0..1, completed where the weight is below one.
fn push_pull(level: &Plane<(f32, f32)>) -> Plane<f32> {
    let (w, h) = level.size();
    if (w, h) == (1, 1) {
        return level.map(|(value, _)| value);
    }
    let half = Plane::from_fn(w.div_ceil(2), h.div_ceil(2), |x, y| {
        let (mut value, mut weight) = (0.0, 0.0);
        for (at_x, at_y) in [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| (2 * x + i, 2 * y + j)) {
            if at_x < w && at_y < h {
                let (v, share) = level.get(at_x, at_y);
                value += v * share;
                weight += share;
            }
        }
        if weight > 0.0 { (value / weight, weight.min(1.0)) } else { (0.0, 0.0) }
    });
    let coarse = push_pull(&half);
    Plane::from_fn(w, h, |x, y| {
        let (value, weight) = level.get(x, y);
        if weight >= 1.0 { value } else { weight * value + (1.0 - weight) * between(&coarse, x, y) }
    })
}

/// The half-size plane, interpolated at the center of pixel (x, y) of the full size.
fn between(half: &Plane<f32>, x: usize, y: usize) -> f32 {
    // A full-size center lies a quarter of a half-size pixel from the nearest center: weights 3/4
    // and 1/4.
    let near_far = |at: usize, n: usize| {
        let near = at / 2;
        let far = if at.is_multiple_of(2) { near.saturating_sub(1) } else { (near + 1).min(n - 1) };
        (near, far)
    };
    let ((x0, x1), (y0, y1)) = (near_far(x, half.width()), near_far(y, half.height()));
    let row = |y: usize| 0.75 * half.get(x0, y) + 0.25 * half.get(x1, y);
    0.75 * row(y0) + 0.25 * row(y1)
}

/// Depth in another size: the median of the footprint where it shrinks; where it grows, linear
/// between readings of one surface and the nearest reading at a step. No value lies between two
/// surfaces.
pub fn resize_depth(depth: &Depth, width: usize, height: usize) -> Depth {
    let plane = &depth.0;
    if plane.size() == (width, height) {
        return depth.clone();
    }
    let (rx, ry) = (plane.width() as f64 / width as f64, plane.height() as f64 / height as f64);
    if rx >= 1.0 && ry >= 1.0 {
        // Pixels whose centers lie in the footprint; a footprint of at least a pixel holds one.
        let range = |i: usize, ratio: f64, n: usize| {
            let edge = |at: usize| ((at as f64 * ratio - 0.5).ceil() as usize).min(n);
            edge(i)..edge(i + 1)
        };
        let mut footprint = Vec::new();
        return Depth(Plane::from_fn(width, height, |x, y| {
            footprint.clear();
            for row in range(y, ry, plane.height()) {
                footprint.extend(range(x, rx, plane.width()).map(|column| plane.get(column, row)));
            }
            median(&mut footprint)
        }));
    }
    let neighbors = |i: usize, ratio: f64, n: usize| {
        let at = ((i as f64 + 0.5) * ratio - 0.5).clamp(0.0, (n - 1) as f64);
        (at as usize, (at as usize + 1).min(n - 1), at.fract() as f32)
    };
    Depth(Plane::from_fn(width, height, |x, y| {
        let (x0, x1, sx) = neighbors(x, rx, plane.width());
        let (y0, y1, sy) = neighbors(y, ry, plane.height());
        let corners = [plane.get(x0, y0), plane.get(x1, y0), plane.get(x0, y1), plane.get(x1, y1)];
        let (low, high) =
            corners.iter().fold((f32::MAX, 0.0f32), |(l, h), &z| (l.min(z), h.max(z)));
        if high - low > DEPTH_PLANE.step * low {
            corners[usize::from(sx >= 0.5) + 2 * usize::from(sy >= 0.5)]
        } else {
            let row = |a: f32, b: f32| a + (b - a) * sx;
            let (top, bottom) = (row(corners[0], corners[1]), row(corners[2], corners[3]));
            top + (bottom - top) * sy
        }
    }))
}

/// 1 / z, from 0 at the farthest to 1 at the nearest: the pixels with the largest parallax are
/// brightest.
pub fn nearness(depth: &Depth) -> Plane<f32> {
    let inverse = depth.0.map(|z| 1.0 / z);
    let (low, high) = inverse
        .pixels()
        .iter()
        .fold((f32::MAX, 0.0f32), |(low, high), &q| (low.min(q), high.max(q)));
    inverse.map(|q| (q - low) / (high - low).max(f32::MIN_POSITIVE))
}

/// The middle value; of two middle values their mean, or the nearer one when a step lies between
/// them.
fn median(values: &mut [f32]) -> f32 {
    values.sort_unstable_by(f32::total_cmp);
    let (low, high) = (values[(values.len() - 1) / 2], values[values.len() / 2]);
    if high - low > DEPTH_PLANE.step * low { low } else { 0.5 * (low + high) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trusted(plane: &Plane<f32>) -> Plane<f32> {
        plane.map(|_| 0.0)
    }

    #[test]
    fn holes_in_a_plane_are_filled_with_the_plane() {
        // 1/z linear in x: a slanted wall from 2 m to 4 m.
        let wall = |x: usize| 1.0 / (0.5 - 0.25 * x as f32 / 63.0);
        let mut depth = Plane::from_fn(64, 48, |x, _| wall(x));
        for y in 20..26 {
            for x in 30..36 {
                depth.set(x, y, f32::NAN);
            }
        }
        depth.set(0, 0, 0.0);
        depth.set(5, 5, -1.0);
        depth.set(6, 5, f32::INFINITY);
        depth.set(7, 5, 2e5);
        let (filled, holes) = inpaint_depth(&depth, &trusted(&depth)).expect("there are readings");
        assert_eq!(holes.0.pixels().iter().sum::<f32>(), 40.0);
        for y in 0..48 {
            for x in 0..64 {
                // The pyramid's cells are not centerd on the hole: 2 % of the wall's depth.
                let (got, wanted) = (filled.0.get(x, y), wall(x));
                assert!((got - wanted).abs() < 0.02 * wanted, "({x}, {y}): {got}, wanted {wanted}");
            }
        }
    }

    #[test]
    fn one_reading_is_enough_and_none_is_not() {
        let mut depth = Plane::filled(37, 5, 0.0);
        assert!(inpaint_depth(&depth, &trusted(&depth)).is_none());
        depth.set(36, 4, 2.5);
        let (filled, _) = inpaint_depth(&depth, &trusted(&depth)).expect("there is a reading");
        assert!(filled.0.pixels().iter().all(|&z| (z - 2.5).abs() < 1e-5));
    }

    #[test]
    fn panes_fill_nothing() {
        // A wall at 3 m, a pane that shows 100 m, a hole between them.
        let depth = Plane::from_fn(32, 32, |x, _| {
            if x < 14 {
                3.0
            } else if x < 18 {
                0.0
            } else {
                100.0
            }
        });
        let pane = Plane::from_fn(32, 32, |x, _| if x >= 18 { 1.0 } else { 0.0 });
        let (filled, _) = inpaint_depth(&depth, &pane).expect("there are readings");
        assert!((0..18).all(|x| (filled.0.get(x, 16) - 3.0).abs() < 1e-4));
        assert_eq!(filled.0.get(20, 16), 100.0);
    }

    #[test]
    fn other_sizes_never_hang_between_two_surfaces() {
        let depth = Depth(Plane::from_fn(60, 45, |x, y| if x * 3 + y < 97 { 2.0 } else { 5.0 }));
        for (w, h) in [(20, 15), (37, 28), (1, 1), (61, 46), (240, 180), (320, 30)] {
            let other = resize_depth(&depth, w, h);
            assert_eq!(other.0.size(), (w, h));
            assert!(other.0.pixels().iter().all(|&z| z == 2.0 || z == 5.0), "{w} x {h}");
        }
    }

    #[test]
    fn near_is_bright() {
        assert_eq!(
            nearness(&Depth(Plane::new(3, 1, vec![1.0, 2.0, 4.0]))).pixels(),
            [1.0, 1.0 / 3.0, 0.0]
        );
        assert_eq!(nearness(&Depth(Plane::filled(2, 1, 3.0))).pixels(), [0.0, 0.0]);
    }

    #[test]
    fn a_smooth_surface_keeps_its_depth() {
        let at = |x: f32| 2.0 + x;
        let depth = Depth(Plane::from_fn(64, 48, |x, _| at((x as f32 + 0.5) / 64.0)));
        for (w, h) in [(32, 24), (16, 12), (128, 96)] {
            let other = resize_depth(&depth, w, h);
            for x in 2..w - 2 {
                assert!((other.0.get(x, h / 2) - at((x as f32 + 0.5) / w as f32)).abs() < 1e-5);
            }
        }
    }
}
