//! Pictures in other sizes.

use std::ops::{Add, Mul};

use bytemuck::Pod;

use crate::image::Plane;
use crate::tuning::tuning;

tuning! {
    /// Constants of the comparison of sizes.
    pub const TUNING: ResampleTuning {
        /// Relative difference up to which two aspect ratios are the same.
        aspect: f64 = 0.02,
            unit "1", source Taste, effect "a larger value accepts masks and depths of other pictures";
    }
}

/// The size that fits a longer side of at most `long_side` pixels; never larger than the picture,
/// never below one pixel.
pub fn fit(width: usize, height: usize, long_side: usize) -> (usize, usize) {
    let long = width.max(height);
    if long <= long_side {
        return (width, height);
    }
    let scale = |n: usize| ((n * long_side + long / 2) / long).max(1);
    (scale(width), scale(height))
}

/// Two sizes have the same aspect ratio to 2 %; a side may also differ by the rounding of half a
/// pixel.
pub fn same_aspect((aw, ah): (usize, usize), (bw, bh): (usize, usize)) -> bool {
    let (cross_a, cross_b) = (aw as f64 * bh as f64, bw as f64 * ah as f64);
    let rounding = 0.5 * (aw.max(ah).max(bw).max(bh)) as f64;
    (cross_a - cross_b).abs() <= (TUNING.aspect * cross_a.max(cross_b)).max(rounding)
}

/// The picture in another size, each axis by itself: the area average where it shrinks (the mean is
/// conserved), linear interpolation between pixel centers where it grows.
pub fn resize<T>(plane: &Plane<T>, width: usize, height: usize) -> Plane<T>
where
    T: Pod + Default + Add<Output = T> + Mul<f32, Output = T>,
{
    if plane.size() == (width, height) {
        return plane.clone();
    }
    let resized = Resized::new(plane, width, height);
    Plane::sparse(width, height, |i| resized.at(i % width, i / width))
}

/// A picture in another size, with the same numbers as [`resize`], of which rows are made when they
/// are needed: its memory grows with its width, and not with its height.
pub struct Resized<T> {
    /// The picture in its new width, and in its old height.
    wide: Plane<T>,
    /// For each row, the rows of `wide` that it is made of.
    rows: Vec<Vec<(usize, f32)>>,
}

impl<T> Resized<T>
where
    T: Pod + Default + Add<Output = T> + Mul<f32, Output = T>,
{
    /// The picture `plane` in the size `width` x `height`.
    pub fn new(plane: &Plane<T>, width: usize, height: usize) -> Resized<T> {
        let columns = taps(plane.width(), width);
        let wide = Plane::from_fn(width, plane.height(), |x, y| {
            sum_of(&columns[x], |at| plane.get(at, y))
        });
        Resized { wide, rows: taps(plane.height(), height) }
    }

    /// Columns and rows.
    pub fn size(&self) -> (usize, usize) {
        (self.wide.width(), self.rows.len())
    }

    /// Whether all bits of all pixels are zero.
    pub fn is_zero(&self) -> bool {
        self.wide.is_zero()
    }

    /// The pixels of row `y`.
    pub fn row(&self, y: usize) -> Vec<T> {
        let width = self.wide.width();
        let mut row = vec![T::default(); width];
        for &(at, weight) in &self.rows[y] {
            let pixels = &self.wide.pixels()[at * width..][..width];
            row.iter_mut().zip(pixels).for_each(|(sum, &value)| *sum = *sum + value * weight);
        }
        row
    }

    fn at(&self, x: usize, y: usize) -> T {
        sum_of(&self.rows[y], |at| self.wide.get(x, at))
    }
}

fn sum_of<T>(terms: &[(usize, f32)], value: impl Fn(usize) -> T) -> T
where
    T: Default + Add<Output = T> + Mul<f32, Output = T>,
{
    terms.iter().fold(T::default(), |sum, &(at, weight)| sum + value(at) * weight)
}

/// For each of `to` output pixels along an axis: the input pixels it is made of, and their weights,
/// which sum to 1.
fn taps(from: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let ratio = from as f64 / to as f64;
    if to <= from {
        (0..to)
            .map(|i| {
                let (start, end) = (i as f64 * ratio, (i + 1) as f64 * ratio);
                let last = (end.ceil() as usize).min(from);
                (start as usize..last)
                    .map(|at| {
                        (at, ((end.min((at + 1) as f64) - start.max(at as f64)) / ratio) as f32)
                    })
                    .filter(|&(_, weight)| weight > 0.0)
                    .collect()
            })
            .collect()
    } else {
        (0..to)
            .map(|i| {
                let at = ((i as f64 + 0.5) * ratio - 0.5).clamp(0.0, (from - 1) as f64);
                let (low, share) = (at as usize, at.fract() as f32);
                if share > 0.0 {
                    vec![(low, 1.0 - share), (low + 1, share)]
                } else {
                    vec![(low, 1.0)]
                }
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_area_average_conserves_the_mean() {
        let plane = Plane::from_fn(97, 61, |x, y| ((x * 31 + y * 17) % 101) as f32 / 100.0);
        let mean =
            |p: &Plane<f32>| p.pixels().iter().map(|&v| f64::from(v)).sum::<f64>() / p.len() as f64;
        for (w, h) in [(97, 61), (48, 30), (13, 7), (96, 60), (1, 1), (97, 1)] {
            let small = resize(&plane, w, h);
            assert_eq!(small.size(), (w, h));
            // Single-precision weights, at most 97 + 61 terms.
            assert!((mean(&small) - mean(&plane)).abs() < 1e-6, "{w} x {h}");
        }
    }

    #[test]
    fn halving_is_the_mean_of_four() {
        let plane = Plane::new(4, 2, vec![0.0f32, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        assert_eq!(resize(&plane, 2, 1).pixels(), [2.5, 4.5]);
    }

    #[test]
    fn growing_keeps_a_ramp_between_the_outer_centers() {
        let plane = Plane::from_fn(8, 1, |x, _| x as f32 + 0.5);
        let wide = resize(&plane, 32, 1);
        for x in 2..30 {
            assert!((wide.get(x, 0) - (x as f32 + 0.5) / 4.0).abs() < 1e-6);
        }
        assert_eq!((wide.get(0, 0), wide.get(31, 0)), (0.5, 7.5));
    }

    #[test]
    fn rows_are_those_of_the_resized_plane() {
        let plane = Plane::from_fn(9, 7, |x, y| ((x * 31 + y * 17) % 101) as f32 / 100.0);
        for (w, h) in [(9, 7), (40, 33), (4, 3), (20, 3)] {
            let (whole, resized) = (resize(&plane, w, h), Resized::new(&plane, w, h));
            assert_eq!(resized.size(), (w, h));
            let rows: Vec<f32> = (0..h).flat_map(|y| resized.row(y)).collect();
            assert_eq!(rows, whole.pixels(), "{w} x {h}");
        }
        assert!(Resized::new(&Plane::filled(3, 2, 0.0f32), 8, 8).is_zero());
    }

    #[test]
    fn sizes() {
        assert_eq!(fit(320, 240, 320), (320, 240));
        assert_eq!(fit(640, 480, 320), (320, 240));
        assert_eq!(fit(480, 641, 320), (240, 320));
        assert_eq!(fit(100, 50, 320), (100, 50));
        assert_eq!(fit(10_000, 1, 320), (320, 1));
        assert!(same_aspect((640, 480), (320, 240)) && same_aspect((641, 480), (320, 240)));
        assert!(same_aspect((3, 2), (640, 427)));
        assert!(!same_aspect((640, 480), (480, 640)) && !same_aspect((100, 100), (100, 97)));
    }
}
