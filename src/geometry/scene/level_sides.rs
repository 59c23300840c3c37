//! Floor and ceiling in depth of unknown scale.
//!
//! Nothing here depends on the unit of the depth: heights are compared by their ratios. The found
//! heights are distances from the camera along gravity ([`world_up`](super::world_up)).

use glam::Vec3;

use super::find_layout::limit_areas;
use super::surface::surface;
use super::world_up;
use crate::geometry::Camera;
use crate::image::{Depth, Normal, Plane};
use crate::tuning::tuning;

tuning! {
    /// Constants of the search for floor and ceiling in depth of unknown scale.
    pub const TUNING: LevelSidesTuning {
        /// Median depth to which a depth of unknown scale is brought before its surface is fitted.
        median: f32 = 3.0,
            unit "meters", source Taste, effect "none within the range of rooms";
        /// Angle between gravity and the normal of a level surface.
        level: f32 = 12.0,
            unit "degrees", source Taste, effect "a larger value admits slanted surfaces";
        /// Ratio of neighboring bins of heights.
        bin: f32 = 1.03,
            unit "1", source Taste, effect "a larger value joins surfaces of different heights";
        /// Least height of a bin, as a fraction of the median depth.
        least: f32 = 0.05,
            unit "1", source Taste, effect "a smaller value admits surfaces at the height of the camera";
        /// Least area of a floor or ceiling.
        area: f32 = 0.015,
            unit "fraction of all area", source Taste, effect "a smaller value takes noise for a floor";
        /// Least area of it over that of the largest level surface on its side.
        peak: f32 = 0.1,
            unit "1", source Taste, effect "a smaller value takes noise for a floor";
        /// Largest area that lies beyond it by `margin`.
        beyond: f32 = 0.02,
            unit "fraction of all area", source Taste, effect "a smaller value sees fewer floors";
        /// Ratio of heights from which a point lies beyond a side.
        margin: f32 = 1.12,
            unit "1", source Taste, effect "a smaller value sees fewer floors";
        /// Largest area of a pixel: views through doors and panes cover large areas.
        max_area: f32 = 4.0,
            unit "median areas", source Measured("docs/room.md"), effect "a larger value lets distant surfaces decide";
    }
}

/// Heights of floor and ceiling, in units of the depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelSides {
    /// Distance from the camera down to the floor, if it is seen.
    pub floor: Option<f32>,
    /// Distance from the camera up to the ceiling, if it is seen.
    pub ceiling: Option<f32>,
}

/// A weighted sample of the seen surface.
pub(super) struct Patches {
    /// Points, in units of the depth over `unit`.
    pub points: Vec<Vec3>,
    /// Unit normals, facing the camera.
    pub normals: Vec<Vec3>,
    /// Areas, limited; their unit does not matter.
    pub areas: Vec<f32>,
    /// Units of the depth per unit of the points.
    pub unit: f32,
}

/// The seen surface without the pixels of `outside`, brought to a common median depth. Both planes
/// and the camera have one size.
pub(super) fn patches(depth: &Depth, camera: &Camera, outside: &Plane<f32>) -> Patches {
    let unit = median(depth) / TUNING.median;
    let seen = surface(&Depth(depth.0.map(|z| z / unit)), camera);
    let inside = |i: &usize| outside.pixels()[*i] <= 0.0;
    let kept: Vec<usize> = (0..depth.0.len()).filter(inside).collect();
    let points: Vec<Vec3> = kept.iter().map(|&i| seen.points.0.pixels()[i]).collect();
    let normals: Vec<Vec3> = kept.iter().map(|&i| seen.normal.0.pixels()[i]).collect();
    let areas = areas(&points, &normals);
    Patches { points, normals, areas, unit }
}

/// Areas of pixels on their surfaces, limited to a multiple of their median.
pub(super) fn areas(points: &[Vec3], normals: &[Vec3]) -> Vec<f32> {
    let area = |(p, n): (&Vec3, &Vec3)| p.z * p.z / (-n.dot(*p) / p.length().max(1e-6)).max(0.1);
    let mut areas: Vec<f32> = points.iter().zip(normals).map(area).collect();
    limit_areas(&mut areas, TUNING.max_area);
    areas
}

/// Median of a depth.
pub(super) fn median(depth: &Depth) -> f32 {
    let mut values = depth.0.pixels().to_vec();
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

impl Patches {
    /// Unit vector against gravity.
    pub fn up(&self) -> Vec3 {
        world_up(&Normal(Plane::new(self.normals.len(), 1, self.normals.clone())))
    }

    /// Floor and ceiling.
    pub fn sides(&self) -> LevelSides {
        let up = self.up();
        LevelSides { floor: self.level_side(-up), ceiling: self.level_side(up) }
    }

    /// Height of the outermost level surface towards `down`, in units of the depth: enough area
    /// faces the other way there, and hardly any lies beyond.
    fn level_side(&self, down: Vec3) -> Option<f32> {
        let cosine = TUNING.level.to_radians().cos();
        let least = TUNING.least * TUNING.median;
        let bin = |height: f32| ((height / least).ln() / TUNING.bin.ln()) as usize;
        let total: f32 = self.areas.iter().sum();
        let heights: Vec<f32> = self.points.iter().map(|p| p.dot(down)).collect();
        let mut histogram = vec![0.0f32; 256];
        let level = |&i: &usize| -self.normals[i].dot(down) > cosine && heights[i] > least;
        for i in (0..heights.len()).filter(level) {
            histogram[bin(heights[i]).min(255)] += self.areas[i];
        }
        let sum =
            |at: usize| histogram[at.saturating_sub(1)..(at + 2).min(256)].iter().sum::<f32>();
        let highest = (0..256).map(sum).fold(0.0, f32::max);
        let enough = (TUNING.area * total).max(TUNING.peak * highest);
        let mut at = (0..256).rev().find(|&at| sum(at) > enough)?;
        while at > 0 && sum(at - 1) > sum(at) {
            at -= 1;
        }
        let mut members: Vec<f32> = (0..heights.len())
            .filter(level)
            .filter(|&i| bin(heights[i]).abs_diff(at) <= 1)
            .map(|i| heights[i])
            .collect();
        let middle = members.len() / 2;
        let height = *members.select_nth_unstable_by(middle, f32::total_cmp).1;
        let beyond = (0..heights.len()).filter(|&i| heights[i] > TUNING.margin * height);
        let beyond: f32 = beyond.map(|i| self.areas[i]).sum();
        (beyond <= TUNING.beyond * total).then_some(self.unit * height)
    }
}

/// Floor and ceiling of a planar depth in any unit; pixels where `outside` is above 0 (panes, what
/// is not part of the room) do not count. All have one size.
pub fn level_sides(depth: &Depth, camera: &Camera, outside: &Plane<f32>) -> LevelSides {
    patches(depth, camera, outside).sides()
}
