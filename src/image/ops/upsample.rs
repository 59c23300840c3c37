//! Joint bilateral upsampling: shading at working size brought to the photo's size without crossing
//! edges.

use glam::Vec3;

use crate::image::{Depth, Picture, Plane, log_above};
use crate::tuning::tuning;

/// Weights from each photo pixel to working pixels, found on demand from depth and color.
///
/// Kopf et al., Joint Bilateral Upsampling, SIGGRAPH 2007: a photo pixel takes the mean of the nine
/// working pixels around it, weighted by closeness in the plane (a tent of 1.5 working pixels), in
/// depth (5 % of it) and in log color. With both planes of one size, it is the identity.
pub struct Upsampler<'a> {
    photo: &'a Picture,
    full_depth: &'a Depth,
    small: &'a Picture,
    depth: &'a Depth,
}

tuning! {
    /// Constants of joint bilateral upsampling.
    pub const TUNING: UpsampleTuning {
        /// Half width of the tent by which neighbors are weighted in the plane.
        tent: f32 = 1.5,
            unit "working pixels", source Paper("Kopf et al., Joint Bilateral Upsampling, SIGGRAPH 2007"),
            effect "a larger value blurs shading; nine neighbors hold a tent of 1.5";
        /// Relative difference of depth at which a neighbor's weight is 1 / e.
        depth: f32 = 0.05,
            unit "1", source Taste, effect "a larger value blurs shading over steps";
        /// Difference of log color at which a neighbor's weight is 1 / e; wide enough for texture,
        /// which is not an edge of shading.
        color: f32 = 0.5,
            unit "1", source Taste, effect "a smaller value copies texture into shading";
        /// Floor of that weight: a pixel that is like none of its neighbors takes their plain mean.
        floor: f32 = 1e-6,
            unit "1", source Taste, effect "a larger value blurs shading over edges";
        /// Least linear value of which the logarithm is taken.
        black: f32 = 0.004,
            unit "units of the photo", source Derived("quantization of 8-bit photos"),
            effect "a larger value makes dark pixels alike";
    }
}

impl<'a> Upsampler<'a> {
    /// The upsampler from `small` and `depth`, of the working size, to `photo` and `full_depth`.
    ///
    /// # Panics
    /// A picture and its depth differ in size.
    pub fn new(
        photo: &'a Picture,
        full_depth: &'a Depth,
        small: &'a Picture,
        depth: &'a Depth,
    ) -> Upsampler<'a> {
        assert_eq!(photo.0.size(), full_depth.0.size(), "depth at the photo's size");
        assert_eq!(small.0.size(), depth.0.size(), "depth at working size");
        Upsampler { photo, full_depth, small, depth }
    }

    /// The working pixels that photo pixel (x, y) takes, for use on any number of planes.
    pub fn taps(&self, x: usize, y: usize) -> Taps {
        let (w, h) = self.small.0.size();
        let (full_w, full_h) = self.photo.0.size();
        let mut taps = Taps { index: [0; 9], weight: [0.0; 9], count: 0 };
        if (w, h) == (full_w, full_h) {
            taps.push(y * w + x, 1.0);
            return taps;
        }
        let (fx, fy) = (place(x, full_w, w), place(y, full_h, h));
        let z = self.full_depth.0.get(x, y);
        let color = log(self.photo.0.get(x, y));
        for (sx, sy) in neighbors((x, y), (full_w, full_h), (w, h)) {
            let near = (TUNING.tent - (sx as f32 - fx).abs()).max(0.0)
                * (TUNING.tent - (sy as f32 - fy).abs()).max(0.0);
            let i = sy * w + sx;
            let depth = (self.depth.0.pixels()[i] - z) / (TUNING.depth * z);
            let color = (log(self.small.0.pixels()[i]) - color).length_squared()
                / (TUNING.color * TUNING.color);
            // The floor keeps a pixel that is like none of its neighbors on their plain mean.
            taps.push(i, near * ((-depth * depth - color).exp() + TUNING.floor));
        }
        let sum: f32 = taps.weight.iter().sum();
        taps.weight.iter_mut().for_each(|weight| *weight /= sum);
        taps
    }
}

/// The position of pixel `at` of `full` in units of the pixels of `small`, whose centers are whole
/// numbers.
pub(super) fn place(at: usize, full: usize, small: usize) -> f32 {
    (at as f32 + 0.5) * small as f32 / full as f32 - 0.5
}

/// The pixels of a plane of size `small` that photo pixel `at` may take: nine around it, or itself
/// alone where both sizes are one.
pub fn neighbors(
    at: (usize, usize),
    full: (usize, usize),
    small: (usize, usize),
) -> impl Iterator<Item = (usize, usize)> {
    let range = |at: usize, full: usize, small: usize| {
        let near = place(at, full, small).max(0.0).round() as usize;
        near.saturating_sub(1)..(near + 2).min(small)
    };
    let (xs, ys) = if full == small {
        (at.0..at.0 + 1, at.1..at.1 + 1)
    } else {
        (range(at.0, full.0, small.0), range(at.1, full.1, small.1))
    };
    ys.flat_map(move |y| xs.clone().map(move |x| (x, y)))
}

/// Working pixels and their weights, which sum to 1.
pub struct Taps {
    index: [usize; 9],
    weight: [f32; 9],
    count: usize,
}

impl Taps {
    fn push(&mut self, index: usize, weight: f32) {
        (self.index[self.count], self.weight[self.count]) = (index, weight);
        self.count += 1;
    }

    /// Indices of working pixels, and their weights.
    pub fn iter(&self) -> impl Iterator<Item = (usize, f32)> + '_ {
        self.index.iter().copied().zip(self.weight.iter().copied()).take(self.count)
    }

    /// Value of a working-size plane.
    pub fn of(&self, plane: &Plane<Vec3>) -> Vec3 {
        (0..self.count).map(|i| plane.pixels()[self.index[i]] * self.weight[i]).sum()
    }
}

fn log(rgb: Vec3) -> Vec3 {
    log_above(TUNING.black, rgb)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shading_does_not_leak_across_a_depth_step() {
        let side = |x: usize, w: usize| x < w / 2;
        let photo = Picture(Plane::filled(40, 20, Vec3::splat(0.5)));
        let small = Picture(Plane::filled(10, 5, Vec3::splat(0.5)));
        let full_depth = Depth(Plane::from_fn(40, 20, |x, _| if side(x, 40) { 2.0 } else { 4.0 }));
        let depth = Depth(Plane::from_fn(10, 5, |x, _| if side(x, 10) { 2.0 } else { 4.0 }));
        let shading =
            Plane::from_fn(10, 5, |x, _| if side(x, 10) { Vec3::ONE } else { Vec3::ZERO });
        let up = Upsampler::new(&photo, &full_depth, &small, &depth);
        for y in 0..20 {
            for x in 0..40 {
                let want = if side(x, 40) { 1.0 } else { 0.0 };
                assert!((up.taps(x, y).of(&shading).x - want).abs() < 1e-4, "({x}, {y})");
            }
        }
    }

    #[test]
    fn a_constant_stays_and_equal_sizes_are_the_identity() {
        let photo = Picture(Plane::from_fn(7, 5, |x, y| Vec3::splat((x * y) as f32 * 0.03)));
        let full_depth = Depth(Plane::from_fn(7, 5, |x, _| 1.0 + x as f32));
        let small = Picture(Plane::filled(3, 2, Vec3::ONE));
        let depth = Depth(Plane::filled(3, 2, 2.0));
        let up = Upsampler::new(&photo, &full_depth, &small, &depth);
        let flat = Plane::filled(3, 2, Vec3::splat(0.25));
        assert!(
            (0..35).all(|i| (up.taps(i % 7, i / 7).of(&flat) - Vec3::splat(0.25)).length() < 1e-6)
        );
        let same = Upsampler::new(&photo, &full_depth, &photo, &full_depth);
        assert!((0..35).all(|i| same.taps(i % 7, i / 7).of(&photo.0) == photo.0.get(i % 7, i / 7)));
    }
}
