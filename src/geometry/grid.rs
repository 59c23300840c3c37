//! Working at every nth pixel and bringing the result back to all of them without crossing edges.

use std::ops::{Add, Mul};

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::image::{Normal, Plane, Points, rule};
use crate::tuning::tuning;

/// Every `stride`th pixel of a plane, those in the middle of each `stride` x `stride` block.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Grid {
    stride: usize,
    /// Size of the whole plane, pixels.
    width: usize,
    height: usize,
}

tuning! {
    /// Constants of the interpolation between receivers.
    pub const TUNING: GridTuning {
        /// Neighbors between which a pixel interpolates, along each axis.
        reach: usize = 4,
            unit "receivers", source Taste, effect "a larger value blurs more and takes longer";
        /// Distance from the tangent plane at which the weight of a neighbor falls to a quarter.
        off_plane: f32 = 0.01,
            unit "fraction of the depth", source Derived("about three pixels at working size"),
            effect "a larger value blurs over steps";
        /// Power of the cosine between normals in the weight of a neighbor.
        normal_power: i32 = 8,
            unit "1", source Taste, effect "a larger value blurs less over curved surfaces";
        /// Square of the distance at which the weight of a neighbor falls to 1 / e.
        spread: f32 = 1.28,
            unit "squares of the distance between receivers", source Taste, effect "a larger value blurs more";
        /// Floor of the weight of a neighbor, for pixels that are like none.
        floor: f32 = 1e-4,
            unit "1", source Taste, effect "a larger value blurs over edges";
    }
}

impl Grid {
    /// The grid over a plane of this size; a `stride` of zero counts as one.
    pub fn new((width, height): (usize, usize), stride: usize) -> Grid {
        Grid { stride: stride.max(1), width, height }
    }

    /// Whether a grid that was read from disk belongs to a plane of this size.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub fn check(&self, size: (usize, usize)) -> Result<(), String> {
        rule(
            self.stride > 0 && (self.width, self.height) == size,
            "a grid over the plane, with a stride of at least 1",
        )
    }

    /// Columns and rows of the grid.
    pub fn size(&self) -> (usize, usize) {
        (self.width.div_ceil(self.stride), self.height.div_ceil(self.stride))
    }

    /// Returns the number of grid points.
    pub fn len(&self) -> usize {
        self.size().0 * self.size().1
    }

    /// Whether the grid has no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The pixel (row by row) that is grid point `i` (row by row).
    pub fn pixel(&self, i: usize) -> usize {
        let columns = self.size().0;
        let at = |i: usize, size: usize| (i * self.stride + self.stride / 2).min(size - 1);
        at(i / columns, self.height) * self.width + at(i % columns, self.width)
    }

    /// Grid points around `pixel` with weights that sum to one: near in the picture, on the same
    /// plane in space (a joint bilateral filter, Kopf et al. 2007, whose range is the distance from
    /// the tangent plane, and the normal).
    pub fn neighbors(
        &self,
        points: &Points,
        normal: &Normal,
        pixel: usize,
    ) -> [(usize, f32); TUNING.reach * TUNING.reach] {
        let (columns, rows) = self.size();
        let (point, n) = (points.0.pixels()[pixel], normal.0.pixels()[pixel]);
        let half = (self.stride / 2) as f32;
        let place = |i: usize| (i as f32 - half) / self.stride as f32;
        let (x, y) = (place(pixel % self.width), place(pixel / self.width));
        let first = |at: f32, size: usize| {
            (at.floor() as isize - 1).clamp(0, size.saturating_sub(TUNING.reach) as isize) as usize
        };
        let (x0, y0) = (first(x, columns), first(y, rows));
        // One hundredth of the depth is about three pixels at working size.
        let tolerance = TUNING.off_plane * point.z.abs().max(1e-6);
        let mut found = [(0, 0.0); TUNING.reach * TUNING.reach];
        let mut total = 0.0;
        for (slot, out) in found.iter_mut().enumerate() {
            let (column, row) = (x0 + slot % TUNING.reach, y0 + slot / TUNING.reach);
            if column >= columns || row >= rows {
                continue;
            }
            let i = row * columns + column;
            let other = self.pixel(i);
            let (dx, dy) = (column as f32 - x, row as f32 - y);
            let off = n.dot(points.0.pixels()[other] - point) / tolerance;
            let alike = n.dot(normal.0.pixels()[other]).max(0.0).powi(TUNING.normal_power);
            let near = (-(dx * dx + dy * dy) / TUNING.spread).exp();
            // The small constant leaves something to draw from where no neighbor is alike.
            let weight = near * (alike / (1.0 + off * off).powi(2) + TUNING.floor);
            *out = (i, weight);
            total += weight;
        }
        found.map(|(i, weight)| (i, weight / total))
    }

    /// A plane of `value` of each pixel's grid neighbors and their weights, which sum to one.
    pub fn spread<T: Copy + Send>(
        &self,
        points: &Points,
        normal: &Normal,
        value: impl Fn(&[(usize, f32)]) -> T + Sync,
    ) -> Plane<T> {
        let pixel = |pixel: usize| match self.stride {
            1 => value(&[(pixel, 1.0)]),
            _ => value(&self.neighbors(points, normal, pixel)),
        };
        let pixels = (0..self.width * self.height)
            .into_par_iter()
            .with_min_len(self.width.max(1))
            .map(pixel);
        Plane::new(self.width, self.height, pixels.collect())
    }

    /// Brings values on the grid to all pixels.
    pub fn upsample<T>(&self, points: &Points, normal: &Normal, values: &[T]) -> Plane<T>
    where
        T: Copy + Default + Add<Output = T> + Mul<f32, Output = T> + Send + Sync,
    {
        self.spread(points, normal, |neighbors| {
            neighbors.iter().fold(T::default(), |sum, &(i, weight)| sum + values[i] * weight)
        })
    }
}

/// A direction around `normal` with density cos / pi (Malley's method).
pub fn cosine_direction(normal: Vec3, [u, v]: [f64; 2]) -> Vec3 {
    let (x, y) = normal.any_orthonormal_pair();
    let (sin, cos) = (std::f32::consts::TAU * v as f32).sin_cos();
    let (radius, height) = ((u as f32).sqrt(), (1.0 - u as f32).max(0.0).sqrt());
    radius * (cos * x + sin * y) + height * normal
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;

    #[test]
    fn a_constant_stays_and_an_edge_is_not_crossed() {
        let camera = Camera::from_fov_x(33, 21, 60.0);
        let depth = |x: usize| if x < 17 { 2.0 } else { 4.0 };
        let points = Points(Plane::from_fn(33, 21, |x, y| camera.pixel_point(x, y, depth(x))));
        let normal = Normal(Plane::filled(33, 21, Vec3::Z));
        for stride in [1, 2, 3, 4, 50] {
            let grid = Grid::new((33, 21), stride);
            let near = |i: usize| if grid.pixel(i) % 33 < 17 { 1.0 } else { 5.0 };
            let up = [vec![3.0f32; grid.len()], (0..grid.len()).map(near).collect()]
                .map(|values| grid.upsample(&points, &normal, &values));
            assert!(up[0].pixels().iter().all(|v| (v - 3.0).abs() < 1e-5));
            if stride <= 4 {
                let wanted = |i: usize| if i % 33 < 17 { 1.0 } else { 5.0 };
                // The edge lies 2 m away in depth, a hundred tolerances: one in a hundred million,
                // and the constant 1e-4.
                assert!(
                    up[1].pixels().iter().enumerate().all(|(i, v)| (v - wanted(i)).abs() < 0.02),
                    "{stride}"
                );
            }
        }
    }

    #[test]
    fn tiny_planes_work() {
        for size in [(0, 0), (1, 1), (1, 5), (5, 1)] {
            let points = Points(Plane::filled(size.0, size.1, Vec3::NEG_Z));
            let normal = Normal(Plane::filled(size.0, size.1, Vec3::Z));
            let grid = Grid::new(size, 4);
            let up = grid.upsample(&points, &normal, &vec![1.0f32; grid.len()]);
            assert!(up.size() == size && up.pixels().iter().all(|v| (v - 1.0).abs() < 1e-6));
        }
    }
}
