//! Other cuboids of the same room: the guessed sides of a layout at other distances.

use serde::{Deserialize, Serialize};

use super::find_layout;
use super::room_layout::{
    CEILING, FLOOR, RoomLayout, SideSource, corners, toward, weighted_quantile,
};
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
        let distances = self.distances();
        std::array::from_fn(|side| {
            let mut order: Vec<_> = seen.iter().map(|&(p, area)| (toward(p, side), area)).collect();
            let last = weighted_quantile(&mut order, find_layout::TUNING.farthest * total);
            let least = find_layout::TUNING.min_distance;
            last.unwrap_or(0.0).max(least).min(distances[side])
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
        let mut distances = self.distances();
        let is_guessed = |side: usize| self.sides[side] == SideSource::Guessed;
        for side in (0..6).filter(|side| is_guessed(*side) && ![FLOOR, CEILING].contains(side)) {
            distances[side] = (distances[side] * draw.distance).max(reach[side]);
        }
        let below = distances[FLOOR] / (distances[FLOOR] + distances[CEILING]);
        if is_guessed(FLOOR) {
            let wanted = if is_guessed(CEILING) {
                draw.height * below
            } else {
                draw.height - distances[CEILING]
            };
            distances[FLOOR] = wanted.max(reach[FLOOR]);
        }
        if is_guessed(CEILING) {
            distances[CEILING] = (draw.height - distances[FLOOR]).max(reach[CEILING]);
        }
        let (low, high) = corners(distances);
        let (width, height) = points.0.size();
        let view = (&camera.resized(width, height), points);
        RoomLayout::new((self.rotation, low, high), self.sides, view, self.seen.clone(), cells)
    }
}
