//! The room as a box around the seen points.

use glam::{Quat, Vec3};

use super::mask_pixels::median;
use crate::tuning::tuning;

tuning! {
    /// Constants of the box of a room around its seen points.
    pub const TUNING: RoomBoxTuning {
        /// Least height of a room: a camera that looks down sees no ceiling.
        min_height: f32 = 2.4,
            unit "meters", source Paper("building codes"), effect "a larger value moves unseen ceilings upward";
        /// Least distance from the camera to the far wall.
        min_depth: f32 = 0.1,
            unit "meters", source Taste, effect "a larger value moves candidates for lights in very shallow rooms";
        /// Depth beyond which points do not belong to the room: the view through a window may be
        /// far away and huge.
        far: f32 = 2.5,
            unit "median depths", source Taste, effect "a smaller value cuts long rooms";
        /// Least cosine between a normal and its ray: the area of a pixel is bounded.
        min_slant: f32 = 0.1,
            unit "1", source Taste, effect "a larger value gives slanted surfaces less area";
        /// Upward component of a normal below which its surface is upright.
        upright: f32 = 0.3,
            unit "1", source Taste, effect "a larger value lets slanted surfaces turn the walls";
        /// Least component of a normal along an axis of a surface that may be a side of the room
        /// across this axis.
        flat: f32 = 0.85,
            unit "1", source Taste, effect "a smaller value admits slanted surfaces";
        /// Part of all points, counted from outside, in which a side is sought: one over this
        /// number.
        outer_part: usize = 3,
            unit "1 over the fraction", source Taste, effect "a smaller value takes furniture for a side";
        /// Part of all points that lies outside of a side without a flat surface: one over this
        /// number.
        outermost_part: usize = 50,
            unit "1 over the fraction", source Taste, effect "a smaller value makes rooms smaller";
        /// Width of the interval in which the area of a side is summed.
        side_width: f32 = 0.02,
            unit "fraction of the far depth", source Taste, effect "a larger value joins parallel surfaces";
        /// Least area of a side.
        min_side: f32 = 0.01,
            unit "fraction of all area", source Taste, effect "a smaller value takes furniture for a side";
    }
}

/// Box of the room as far as the seen points determine it; at least `TUNING.min_height` high.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoomBox {
    /// Corners in meters, in the room's own frame: camera space rotated about the vertical so that
    /// the walls are level with the axes.
    pub low: Vec3,
    /// Corner of the largest coordinates; see `low`.
    pub high: Vec3,
    /// Rotation from the room's frame to camera space.
    pub(super) rotation: Quat,
}

impl RoomBox {
    /// A box with the corners `low` and `high` in its own frame, rotated about the vertical by
    /// `yaw` (radians).
    pub fn new(low: Vec3, high: Vec3, yaw: f32) -> RoomBox {
        RoomBox { low, high, rotation: Quat::from_rotation_y(yaw) }
    }

    /// Box around seen points (meters, camera space) with unit normals, one for each point. `None`
    /// without points.
    ///
    /// The walls' direction is the area-weighted mean of the upright normals, modulo a right angle.
    /// A side lies where most area faces away from it: the largest flat surface in the outer third
    /// that faces left is the right wall. Where less than 1 % of the area faces that way, the side
    /// is the 2nd percentile of all points.
    pub fn around(points: &[Vec3], normals: &[Vec3]) -> Option<RoomBox> {
        if points.is_empty() {
            return None;
        }
        // The view through a window may be far away and huge: it does not bound the room.
        let far = TUNING.far * median(points.iter().map(|p| -p.z).collect());
        // Each point stands for a pixel, which covers z^2 of its surface over the slant.
        let area: Vec<f32> = points
            .iter()
            .zip(normals)
            .map(|(p, n)| {
                let slant = (-n.dot(*p) / p.length().max(1e-6)).max(TUNING.min_slant);
                if -p.z < far { p.z * p.z / slant } else { 0.0 }
            })
            .collect();
        // Four times the angle makes all four walls point the same way: their mean is that of the
        // room.
        let (mut cos, mut sin) = (0.0, 0.0);
        for (n, area) in normals.iter().zip(&area).filter(|(n, _)| n.y.abs() < TUNING.upright) {
            let angle = 4.0 * n.x.atan2(n.z);
            (cos, sin) = (cos + area * angle.cos(), sin + area * angle.sin());
        }
        let yaw = if cos == 0.0 && sin == 0.0 { 0.0 } else { 0.25 * f32::atan2(sin, cos) };
        let back = Quat::from_rotation_y(-yaw);
        let points: Vec<Vec3> = points.iter().map(|p| back * *p).collect();
        let normals: Vec<Vec3> = normals.iter().map(|n| back * *n).collect();

        let all: f32 = area.iter().sum();
        let side = |axis: usize, sign: f32| -> f32 {
            let mut order: Vec<usize> = (0..points.len()).collect();
            order.sort_by(|&a, &b| (sign * points[a][axis]).total_cmp(&(sign * points[b][axis])));
            let outer = points[order[(order.len() - 1) / TUNING.outermost_part]][axis];
            order.truncate(order.len().div_ceil(TUNING.outer_part));
            let flat: Vec<usize> =
                order.into_iter().filter(|&i| normals[i][axis] * sign > TUNING.flat).collect();
            // The interval of 2 % of the far distance that contains most area.
            let (mut from, mut sum, mut best) = (0, 0.0, (0.0, outer));
            for to in 0..flat.len() {
                sum += area[flat[to]];
                while (points[flat[to]][axis] - points[flat[from]][axis]).abs()
                    > TUNING.side_width * far
                {
                    sum -= area[flat[from]];
                    from += 1;
                }
                if sum > best.0 {
                    best = (sum, 0.5 * (points[flat[to]][axis] + points[flat[from]][axis]));
                }
            }
            if best.0 > TUNING.min_side * all { best.1 } else { outer }
        };
        let [x, y, z] = [0, 1, 2].map(|axis| (side(axis, 1.0), side(axis, -1.0)));
        // A camera that looks down sees no ceiling.
        let high = Vec3::new(x.1, y.1.max(y.0 + TUNING.min_height), z.1);
        Some(RoomBox::new(Vec3::new(x.0, y.0, z.0), high, yaw))
    }

    /// Distance of a point (meters, camera space) outside of the box, along the axis along which it
    /// is largest, as a fraction of the box; 0 inside.
    pub fn outside(&self, point: Vec3) -> f32 {
        let at = self.rotation.inverse() * point;
        let out =
            (self.low - at).max(at - self.high) / (self.high - self.low).max(Vec3::splat(1e-6));
        out.max_element().max(0.0)
    }

    /// Distance from the camera to the far wall, meters, at least 0.1.
    pub(super) fn depth(&self) -> f32 {
        (-self.low.z).max(TUNING.min_depth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outside_is_a_share_of_the_box() {
        let room = RoomBox::new(Vec3::new(-1.0, -1.0, -4.0), Vec3::new(1.0, 1.0, 0.0), 0.5);
        assert_eq!(room.outside(room.rotation * Vec3::new(0.5, 0.5, -1.0)), 0.0);
        assert!((room.outside(room.rotation * Vec3::new(1.5, 0.5, 1.5)) - 0.375).abs() < 1e-6);
    }
}
