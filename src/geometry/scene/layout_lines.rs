//! The edges and cells of a room's cuboid as lines in a picture.

use glam::{Vec2, Vec3};

use super::room_layout::{RoomLayout, SideSource};
use crate::geometry::Camera;
use crate::tuning::tuning;

tuning! {
    /// Constants of the lines of a room.
    pub const TUNING: LayoutLinesTuning {
        /// Distance of the plane before the camera at which lines are cut off.
        near: f32 = 0.05,
            unit "meters", source Taste, effect "a larger value cuts off more beside the camera";
    }
}

/// A line of the cuboid in the plane of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayoutLine {
    /// One end, pixels; it may lie outside of the picture.
    pub from: Vec2,
    /// The other end.
    pub to: Vec2,
    /// The source of the side; an edge between two sides has the more certain one.
    pub source: SideSource,
    /// Whether it is an edge of the cuboid, not of a cell.
    pub is_edge: bool,
}

impl RoomLayout {
    /// The edges of the cells, each once, then the edges of the cuboid that border on a side that
    /// is not open; cut off before the camera.
    pub fn lines(&self, camera: &Camera) -> Vec<LayoutLine> {
        let mut lines = Vec::new();
        let mut add = |a: Vec3, b: Vec3, source: SideSource, is_edge: bool| {
            if let Some((a, b)) = before_camera(a, b)
                && let (Some(from), Some(to)) = (camera.project(a), camera.project(b))
            {
                lines.push(LayoutLine { from, to, source, is_edge });
            }
        };
        let count = self.count();
        for side in 0..6 {
            let has = |column: usize, row: usize| {
                column < count && row < count && self.cell_index(side, column, row).is_some()
            };
            for place in 0..count * count {
                let (column, row) = (place % count, place / count);
                let Some(cell) = self.cell_index(side, column, row) else { continue };
                let cell = &self.cells()[cell];
                let [u, v] = cell.half;
                let corner = |du: f32, dv: f32| cell.center + u * du + v * dv;
                let source = self.sides[side];
                add(corner(-1.0, -1.0), corner(1.0, -1.0), source, false);
                add(corner(-1.0, -1.0), corner(-1.0, 1.0), source, false);
                if !has(column + 1, row) {
                    add(corner(1.0, -1.0), corner(1.0, 1.0), source, false);
                }
                if !has(column, row + 1) {
                    add(corner(-1.0, 1.0), corner(1.0, 1.0), source, false);
                }
            }
        }
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            for corner in 0..4 {
                let (is_high_u, is_high_v) = (corner % 2, corner / 2);
                let mut ends = [Vec3::ZERO, Vec3::ZERO];
                ends[1][axis] = 1.0;
                for end in &mut ends {
                    (end[u], end[v]) = (is_high_u as f32, is_high_v as f32);
                }
                let sources = [self.sides[2 * u + is_high_u], self.sides[2 * v + is_high_v]];
                let certain = [SideSource::Seen, SideSource::Given, SideSource::Guessed];
                if let Some(source) = certain.into_iter().find(|s| sources.contains(s)) {
                    add(self.place(ends[0]), self.place(ends[1]), source, true);
                }
            }
        }
        lines
    }
}

/// The part of a line that lies before the camera.
fn before_camera(a: Vec3, b: Vec3) -> Option<(Vec3, Vec3)> {
    let (depth_a, depth_b) = (-a.z - TUNING.near, -b.z - TUNING.near);
    let cut = || a.lerp(b, depth_a / (depth_a - depth_b));
    match (depth_a > 0.0, depth_b > 0.0) {
        (true, true) => Some((a, b)),
        (true, false) => Some((a, cut())),
        (false, true) => Some((cut(), b)),
        (false, false) => None,
    }
}
