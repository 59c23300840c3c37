//! Joint bilateral upsampling: shading at working size brought to the photo's size without crossing
//! edges.

use std::ops::Range;

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
    /// Columns and rows of the photo.
    axes: [Vec<Nearby>; 2],
    /// Width of the working size.
    width: usize,
    /// Both sizes are one.
    is_identity: bool,
    /// Logarithm of color, and depth, of each working pixel.
    guide: Vec<(Vec3, f32)>,
}

/// The working pixels that a column or row of the photo takes, along its axis.
struct Nearby {
    first: usize,
    count: usize,
    /// Weights in the plane of as many pixels.
    tent: [f32; 3],
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
        let ((full_w, full_h), (w, h)) = (photo.0.size(), small.0.size());
        let axis =
            |full: usize, small: usize| (0..full).map(|at| Nearby::new(at, full, small)).collect();
        let logs = small.0.pixels().iter().map(|&color| log(color));
        let guide = logs.zip(depth.0.pixels().iter().copied()).collect();
        let axes = [axis(full_w, w), axis(full_h, h)];
        Upsampler {
            photo,
            full_depth,
            axes,
            width: w,
            is_identity: (w, h) == (full_w, full_h),
            guide,
        }
    }

    /// The working pixels that photo pixel (x, y) takes, for use on any number of planes.
    pub fn taps(&self, x: usize, y: usize) -> Taps {
        let mut taps = Taps { index: [0; 9], weight: [0.0; 9], count: 0 };
        if self.is_identity {
            taps.push(y * self.width + x, 1.0);
            return taps;
        }
        let z = self.full_depth.0.get(x, y);
        let color = log(self.photo.0.get(x, y));
        let [column, row] = [&self.axes[0][x], &self.axes[1][y]];
        for (sy, beside) in row.pixels() {
            for (sx, near) in column.pixels() {
                let i = sy * self.width + sx;
                let (own, depth) = self.guide[i];
                let depth = (depth - z) / (TUNING.depth * z);
                let color = (own - color).length_squared() / (TUNING.color * TUNING.color);
                // The floor keeps a pixel that is like none of its neighbors on their plain mean.
                taps.push(i, near * beside * ((-depth * depth - color).exp() + TUNING.floor));
            }
        }
        let sum: f32 = taps.weight.iter().sum();
        taps.weight.iter_mut().for_each(|weight| *weight /= sum);
        taps
    }
}

impl Nearby {
    fn new(at: usize, full: usize, small: usize) -> Nearby {
        let (center, taken) = (place(at, full, small), near(at, full, small));
        let mut nearby = Nearby { first: taken.start, count: taken.len(), tent: [0.0; 3] };
        for (weight, pixel) in nearby.tent.iter_mut().zip(taken) {
            *weight = (TUNING.tent - (pixel as f32 - center).abs()).max(0.0);
        }
        nearby
    }

    /// The working pixels along the axis, and their weights.
    fn pixels(&self) -> impl Iterator<Item = (usize, f32)> + '_ {
        (self.first..).zip(self.tent[..self.count].iter().copied())
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
    let (xs, ys) = if full == small {
        (at.0..at.0 + 1, at.1..at.1 + 1)
    } else {
        (near(at.0, full.0, small.0), near(at.1, full.1, small.1))
    };
    ys.flat_map(move |y| xs.clone().map(move |x| (x, y)))
}

/// The pixels of `small` around pixel `at` of `full`, along one axis.
fn near(at: usize, full: usize, small: usize) -> Range<usize> {
    let nearest = place(at, full, small).max(0.0).round() as usize;
    nearest.saturating_sub(1)..(nearest + 2).min(small)
}

/// Planes whose values are summed at a time: twelve numbers fill whole registers.
const GROUP: usize = 4;

/// Planes of one size with the values of a pixel side by side, so that taps read them at once.
pub struct PlaneBundle {
    /// The planes of each pixel, and black ones that fill the last group.
    values: Vec<[Vec3; GROUP]>,
    groups: usize,
}

impl PlaneBundle {
    /// The bundle of `planes`, in this order.
    ///
    /// # Panics
    /// The planes differ in size.
    pub fn new(planes: &[&Plane<Vec3>]) -> PlaneBundle {
        let pixels = planes.first().map_or(0, |plane| plane.len());
        assert!(planes.iter().all(|plane| plane.len() == pixels), "planes of one size");
        let value = |plane: usize, i: usize| {
            planes.get(plane).map_or(Vec3::ZERO, |plane| plane.pixels()[i])
        };
        let groups = planes.len().div_ceil(GROUP);
        let of_pixel = |i: usize| {
            (0..groups).map(move |group| std::array::from_fn(|k| value(group * GROUP + k, i)))
        };
        let mut values = Vec::with_capacity(pixels * groups);
        (0..pixels).for_each(|i| values.extend(of_pixel(i)));
        PlaneBundle { values, groups }
    }

    /// Number of values of a pixel: those of the planes come first, the others are black.
    pub fn values(&self) -> usize {
        self.groups * GROUP
    }
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

    /// Values of all planes of a bundle, in its order; [`Taps::of`] gives each to the bit.
    ///
    /// # Panics
    /// `values` has not as many colors as a pixel of the bundle.
    pub fn all(&self, bundle: &PlaneBundle, values: &mut [Vec3]) {
        assert_eq!(values.len(), bundle.values(), "a color for each value");
        let (index, weight) = (&self.index[..self.count], &self.weight[..self.count]);
        for (group, values) in values.as_chunks_mut::<GROUP>().0.iter_mut().enumerate() {
            // Flat numbers, of which the processor takes several at once.
            let mut sums = [0.0; 3 * GROUP];
            for (index, weight) in index.iter().zip(weight) {
                let pixel: &[f32; 3 * GROUP] =
                    bytemuck::cast_ref(&bundle.values[index * bundle.groups + group]);
                sums.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += value * weight);
            }
            *values = bytemuck::cast(sums);
        }
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
    fn a_bundle_gives_the_values_of_its_planes_to_the_bit() {
        let photo =
            Picture(Plane::from_fn(23, 17, |x, y| Vec3::new(x as f32, y as f32, 9.0) / 23.0));
        let full_depth = Depth(Plane::from_fn(23, 17, |x, _| 1.0 + x as f32 / 9.0));
        let small = Picture(Plane::from_fn(7, 5, |x, y| Vec3::splat((x + y) as f32 / 11.0)));
        let depth = Depth(Plane::from_fn(7, 5, |x, _| 1.1 + x as f32 / 3.0));
        let up = Upsampler::new(&photo, &full_depth, &small, &depth);
        let plane = |k: f32| {
            Plane::from_fn(7, 5, |x, y| (x as f32 + k) / Vec3::new(3.0, 7.0, k + y as f32))
        };
        let planes =
            [plane(1.0), plane(2.0), plane(3.3), Plane::filled(7, 5, Vec3::ZERO), plane(0.7)];
        let bundle = PlaneBundle::new(&planes.each_ref());
        let mut values = vec![Vec3::NAN; bundle.values()];
        for i in 0..photo.0.len() {
            let taps = up.taps(i % 23, i / 23);
            taps.all(&bundle, &mut values);
            assert_eq!(values[..5], planes.each_ref().map(|plane| taps.of(plane)));
            assert_eq!(values[5..], [Vec3::ZERO; 3]);
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
