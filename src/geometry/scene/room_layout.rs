//! The room as a cuboid, also where the camera does not see it.

use glam::{Quat, Vec3};
use serde::{Deserialize, Serialize};

use super::cell_grid::{CellGrid, MAX_CELLS};
use crate::geometry::Camera;
use crate::image::{Plane, Points, rule};
use crate::tuning::tuning;

tuning! {
    /// Constants of the cells of a room's sides.
    pub const TUNING: RoomLayoutTuning {
        /// Fraction of the seen depth before which a cell would hide what the camera sees.
        cut_depth: f32 = 1.02,
            unit "1", source Measured("docs/room.md"),
            effect "a larger value keeps fewer cells on seen sides";
        /// Added to that depth.
        cut_margin: f32 = 0.03,
            unit "meters", source Measured("docs/room.md"),
            effect "a larger value keeps fewer cells on seen sides";
        /// Distance outside of the room up to which a ray still starts within it: seen surfaces are
        /// uneven.
        outside: f32 = 0.1,
            unit "meters", source Derived("noise of depth maps"),
            effect "a larger value gives rays from a doorway the light of the room";
    }
}

/// Source of a side's place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SideSource {
    /// The camera sees part of it.
    Seen,
    /// The scene gives its place.
    Given,
    /// Its place is a guess.
    Guessed,
    /// The room is open there.
    Open,
}

impl SideSource {
    /// The word for it in messages.
    pub fn name(self) -> &'static str {
        match self {
            SideSource::Seen => "seen",
            SideSource::Given => "stated",
            SideSource::Guessed => "guessed",
            SideSource::Open => "open",
        }
    }
}

/// One piece of a side that the camera does not see: a rectangle that receives and reflects light.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RoomCell {
    /// The middle, camera space, meters.
    pub center: Vec3,
    /// From the middle to the middles of two edges, meters.
    pub half: [Vec3; 2],
    /// Unit normal, into the room.
    pub normal: Vec3,
    /// Index of its side; see [`RoomLayout::sides`].
    pub side: u8,
}

/// Index of a cell, and the position in it, 0..=1 along rows and columns.
type CellPlace = (usize, [f32; 2]);

/// A cuboid around the room (Hedau et al., ICCV 2009), whose hidden sides are divided into cells.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RoomLayout {
    /// Rotation from the layout's frame to camera space. In its frame y is up, and the walls are
    /// orthogonal to x and z; the origin is the camera.
    pub rotation: Quat,
    /// Corner of the least coordinates, layout frame, meters.
    pub low: Vec3,
    /// Corner of the largest coordinates.
    pub high: Vec3,
    /// The sides at the least and the largest x, y and z: left, right, floor, ceiling, front, back.
    pub sides: [SideSource; 6],
    /// Cells that the camera does not see, side by side.
    cells: Vec<RoomCell>,
    /// By side, row and column: the index of the cell plus one, or zero where there is none.
    index: Vec<u32>,
    /// By pixel of the working size: the index of the seen side plus one, or zero.
    pub(super) seen: Plane<u8>,
}

/// Names of the sides, in the order of [`RoomLayout::sides`].
pub const SIDES: [&str; 6] = ["left", "right", "floor", "ceiling", "front", "back"];
/// Index of the floor.
pub(super) const FLOOR: usize = 2;
/// Index of the ceiling.
pub(super) const CEILING: usize = 3;

/// Component of a vector in the layout's frame towards a side.
pub(super) fn toward(vector: Vec3, side: usize) -> f32 {
    if side % 2 == 1 { vector[side / 2] } else { -vector[side / 2] }
}

/// Corners of the cuboid whose sides have these distances from the camera: the lowest and the
/// highest coordinates.
pub(super) fn corners([left, right, floor, ceiling, front, back]: [f32; 6]) -> (Vec3, Vec3) {
    (-Vec3::new(left, floor, front), Vec3::new(right, ceiling, back))
}

/// First value, in ascending order, up to which the weights sum to `amount`. Sorts the pairs of
/// value and weight.
pub(super) fn weighted_quantile(values: &mut [(f32, f32)], amount: f32) -> Option<f32> {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut sum = 0.0;
    let found = values.iter().find(|(_, weight)| {
        sum += weight;
        sum >= amount
    });
    found.map(|(value, _)| *value)
}

impl RoomLayout {
    /// A cuboid with `count` x `count` cells a side. Cells of open sides, and those before
    /// `points`, which the camera would see, are left out. `seen` is by pixel the index of the side
    /// that it shows plus one, or zero.
    pub fn new(
        (rotation, low, high): (Quat, Vec3, Vec3),
        sides: [SideSource; 6],
        (camera, points): (&Camera, &Points),
        seen: Plane<u8>,
        count: usize,
    ) -> RoomLayout {
        let count = count.clamp(1, MAX_CELLS);
        let mut layout = RoomLayout {
            rotation,
            low,
            high,
            sides,
            cells: Vec::new(),
            index: vec![0; 6 * count * count],
            seen,
        };
        let hides = |p: Vec3| {
            let place = camera.project(p).filter(|p| camera.contains(*p));
            place.is_some_and(|at| {
                let depth = -points.0.get(at.x as usize, at.y as usize).z;
                -p.z < TUNING.cut_depth * depth + TUNING.cut_margin
            })
        };
        for side in (0..6).filter(|&side| sides[side] != SideSource::Open) {
            for place in 0..count * count {
                let cell = layout.cell_at(side, place % count, place / count, count);
                if !hides(cell.center) {
                    layout.cells.push(cell);
                    layout.index[side * count * count + place] = layout.cells.len() as u32;
                }
            }
        }
        layout
    }

    fn cell_at(&self, side: usize, column: usize, row: usize, count: usize) -> RoomCell {
        let (axis, is_high) = (side / 2, side % 2 == 1);
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let size = (self.high - self.low) / count as f32;
        let mut center = self.low;
        center[axis] = if is_high { self.high[axis] } else { self.low[axis] };
        center[u] += (column as f32 + 0.5) * size[u];
        center[v] += (row as f32 + 0.5) * size[v];
        let unit = |axis: usize| self.rotation * Vec3::AXES[axis];
        RoomCell {
            center: self.rotation * center,
            half: [unit(u) * (0.5 * size[u]), unit(v) * (0.5 * size[v])],
            normal: unit(axis) * if is_high { -1.0 } else { 1.0 },
            side: side as u8,
        }
    }

    /// The cells.
    pub fn cells(&self) -> &[RoomCell] {
        &self.cells
    }

    /// Cells along each edge of a side.
    pub fn count(&self) -> usize {
        (self.index.len() / 6).isqrt()
    }

    /// The cell at a column and a row, each less than [`RoomLayout::count`], of a side; `None`
    /// where it is left out.
    pub fn cell_index(&self, side: usize, column: usize, row: usize) -> Option<usize> {
        let count = self.count();
        (self.index[side * count * count + row * count + column] as usize).checked_sub(1)
    }

    /// The side that a pixel of the working size shows.
    pub fn seen_side(&self, pixel: usize) -> Option<usize> {
        self.seen.pixels().get(pixel).and_then(|side| (*side as usize).checked_sub(1))
    }

    /// Distance of each side from the camera along the room's axes, meters.
    pub fn distances(&self) -> [f32; 6] {
        let corner = |side: usize| if side % 2 == 1 { self.high } else { self.low };
        std::array::from_fn(|side| toward(corner(side), side))
    }

    /// Unit vector upward, camera space.
    pub fn up(&self) -> Vec3 {
        self.rotation * Vec3::Y
    }

    /// Angles of the camera in the room, degrees: yaw to the right of the front side's direction,
    /// pitch upward, roll clockwise.
    pub fn camera_angles(&self) -> [f32; 3] {
        let forward = self.rotation.inverse() * Vec3::NEG_Z;
        let up = self.up();
        let yaw = forward.x.atan2(-forward.z);
        [yaw, forward.y.clamp(-1.0, 1.0).asin(), (-up.x).atan2(up.y)].map(f32::to_degrees)
    }

    /// One line with each side's distance and source, and the number of cells:
    /// `left 3.09 m seen, right open, .. 301 cells`.
    pub fn summary(&self) -> String {
        let distances = self.distances();
        let side = |side: usize| match self.sides[side] {
            SideSource::Open => format!("{} open, ", SIDES[side]),
            source => format!("{} {:.2} m {}, ", SIDES[side], distances[side], source.name()),
        };
        (0..6).map(side).collect::<String>() + &format!("{} cells", self.cells.len())
    }

    /// Size of the planes it was found on.
    pub fn size(&self) -> (usize, usize) {
        self.seen.size()
    }

    /// Memory held, in bytes.
    pub fn bytes(&self) -> usize {
        self.cells.len() * size_of::<RoomCell>() + 4 * self.index.len() + self.seen.bytes()
    }

    /// Whether all values are finite and every index is in range.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub fn check(&self) -> Result<(), String> {
        let finite = self.rotation.is_finite() && self.low.is_finite() && self.high.is_finite();
        rule(finite && self.low.cmplt(self.high).all(), "a cuboid of finite size")?;
        let count = self.count();
        rule(
            count > 0 && count <= MAX_CELLS && self.index.len() == 6 * count * count,
            "as many cells on each side",
        )?;
        rule(self.index.iter().all(|&i| i as usize <= self.cells.len()), "cells that exist")?;
        rule(self.cells.iter().all(|cell| cell.side < 6), "six sides")?;
        let cells = |cell: &RoomCell| cell.center.is_finite() && cell.normal.is_normalized();
        rule(self.cells.iter().all(cells), "cells in finite places")?;
        rule(self.seen.pixels().iter().all(|&side| side <= 6), "six seen sides")
    }

    /// The neighborhood of the cells.
    pub fn grid(&self) -> CellGrid {
        CellGrid::new(self.count(), &self.index, self.cells.len())
    }

    /// Place at which a ray leaves the cuboid: the distance, and the cell there. `None` for a ray
    /// that starts outside; no cell where the side is open or the camera sees past it.
    pub fn exit(&self, origin: Vec3, direction: Vec3) -> Option<(f32, Option<usize>)> {
        let (distance, place) = self.exit_place(origin, direction)?;
        Some((distance, place.map(|(cell, _)| cell)))
    }

    /// The same with the position within the cell, 0..=1 along rows and columns.
    pub fn exit_place(&self, origin: Vec3, direction: Vec3) -> Option<(f32, Option<CellPlace>)> {
        let inverse = self.rotation.inverse();
        let (origin, direction) = (inverse * origin, inverse * direction);
        let inside = origin.clamp(self.low, self.high);
        if inside.distance(origin) > TUNING.outside {
            return None;
        }
        let (mut distance, mut side) = (f32::INFINITY, 0);
        for axis in 0..3 {
            let is_high = direction[axis] > 0.0;
            let end = if is_high { self.high[axis] } else { self.low[axis] };
            let way = (end - inside[axis]) / direction[axis];
            if way < distance {
                (distance, side) = (way, 2 * axis + usize::from(is_high));
            }
        }
        if !distance.is_finite() {
            return None;
        }
        let count = self.count();
        let at = (inside + direction * distance - self.low) / (self.high - self.low);
        let axis = side / 2;
        let along = |axis: usize| {
            let at = (at[axis % 3] * count as f32).max(0.0);
            let cell = (at as usize).min(count - 1);
            (cell, (at - cell as f32).clamp(0.0, 1.0))
        };
        let ((row, down), (column, beside)) = (along(axis + 2), along(axis + 1));
        let place = side * count * count + row * count + column;
        let cell = (self.index[place] as usize).checked_sub(1);
        Some((distance, cell.map(|cell| (cell, [beside, down]))))
    }

    /// Distance of a point (meters, camera space) outside of the cuboid, along the axis along which
    /// it is largest, as a fraction of the cuboid; 0 inside.
    pub fn outside(&self, point: Vec3) -> f32 {
        let at = self.rotation.inverse() * point;
        let out = (self.low - at).max(at - self.high) / (self.high - self.low);
        out.max_element().max(0.0)
    }

    /// Plane of a side: its unit normal into the room, camera space, and its offset along it from
    /// the camera, meters.
    pub fn plane(&self, side: usize) -> (Vec3, f32) {
        let (axis, is_high) = (side / 2, side % 2 == 1);
        let normal = self.rotation * Vec3::AXES[axis];
        if is_high { (-normal, -self.high[axis]) } else { (normal, self.low[axis]) }
    }

    /// A place of the layout's frame in camera space, given in fractions of the cuboid.
    pub fn place(&self, fraction: Vec3) -> Vec3 {
        self.rotation * (self.low + fraction * (self.high - self.low))
    }
}
