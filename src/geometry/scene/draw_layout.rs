//! Other cuboids of the same room: the guessed sides of a layout at other distances.

use serde::{Deserialize, Serialize};

use super::find_layout;
use super::room_layout::{RoomLayout, SideSource};
use crate::geometry::{Camera, SceneMesh};
use crate::image::Points;
use crate::tuning::tuning;

tuning! {
    /// Constants of the cuboids that are drawn in place of a layout.
    pub const TUNING: DrawLayoutTuning {
        /// Distance between the pixels that bound how near a guessed side may come.
        stride: usize = 8,
            unit "pixels", source Taste, effect "a larger value takes less time and misses small surfaces";
    }
}

/// Indices of the floor and the ceiling in [`RoomLayout::sides`].
const LEVEL: [usize; 2] = [2, 3];

/// One draw of the guesses about the sides that the camera does not see.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LayoutDraw {
    /// Distances of guessed walls from the camera, as multiples of those in the layout.
    pub distance: f32,
    /// From the floor to the ceiling, meters, where one of them is a guess.
    pub height: f32,
}

impl RoomLayout {
    /// Whether the place of any side is a guess.
    pub fn is_guessed(&self) -> bool {
        self.sides.contains(&SideSource::Guessed)
    }

    /// Distance from the camera, per side, within which almost all seen surfaces lie, meters: no
    /// guessed side is nearer. It is at most the distance of the side.
    pub fn reach(&self, mesh: &SceneMesh, points: &Points) -> [f32; 6] {
        let inverse = self.rotation.inverse();
        let (width, height) = points.0.size();
        let coarse = |size: usize| (TUNING.stride / 2..size).step_by(TUNING.stride);
        let seen: Vec<_> = coarse(height)
            .flat_map(|y| coarse(width).map(move |x| y * width + x))
            .filter(|&pixel| mesh.in_room(pixel))
            .map(|pixel| points.0.pixels()[pixel])
            .map(|p| (inverse * p, p.z * p.z))
            .collect();
        let total: f32 = seen.iter().map(|(_, area)| area).sum();
        let distances = of_sides(self);
        std::array::from_fn(|side| {
            let along = |p: glam::Vec3| if side % 2 == 1 { p[side / 2] } else { -p[side / 2] };
            let mut order: Vec<_> = seen.iter().map(|&(p, area)| (along(p), area)).collect();
            order.sort_by(|a, b| a.0.total_cmp(&b.0));
            let mut sum = 0.0;
            let last = order.iter().find(|(_, area)| {
                sum += area;
                sum >= find_layout::TUNING.farthest * total
            });
            let least = find_layout::TUNING.min_distance;
            last.map_or(0.0, |(along, _)| *along).max(least).min(distances[side])
        })
    }

    /// The same room with its guessed sides elsewhere, none nearer than `reach`, with `cells` cells
    /// along each edge. `points` are those of the layout.
    pub fn redrawn(
        &self,
        draw: LayoutDraw,
        reach: &[f32; 6],
        (camera, points): (&Camera, &Points),
        cells: usize,
    ) -> RoomLayout {
        let mut distances = of_sides(self);
        let is_guessed = |side: usize| self.sides[side] == SideSource::Guessed;
        for side in (0..6).filter(|side| is_guessed(*side) && !LEVEL.contains(side)) {
            distances[side] = (distances[side] * draw.distance).max(reach[side]);
        }
        let [floor, ceiling] = LEVEL;
        let below = distances[floor] / (distances[floor] + distances[ceiling]);
        if is_guessed(floor) {
            let wanted = if is_guessed(ceiling) {
                draw.height * below
            } else {
                draw.height - distances[ceiling]
            };
            distances[floor] = wanted.max(reach[floor]);
        }
        if is_guessed(ceiling) {
            distances[ceiling] = (draw.height - distances[floor]).max(reach[ceiling]);
        }
        let [left, right, floor, ceiling, front, back] = distances;
        let low = -glam::Vec3::new(left, floor, front);
        let corners = (self.rotation, low, glam::Vec3::new(right, ceiling, back));
        let (width, height) = points.0.size();
        let view = (&camera.resized(width, height), points);
        RoomLayout::new(corners, self.sides, view, self.seen.clone(), cells)
    }
}

/// Distances of the sides from the camera, meters; negative where the camera is outside.
fn of_sides(layout: &RoomLayout) -> [f32; 6] {
    std::array::from_fn(|side| {
        let axis = side / 2;
        if side % 2 == 1 { layout.high[axis] } else { -layout.low[axis] }
    })
}
