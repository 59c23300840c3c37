//! Neighborhood of the cells of a room's sides.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::image::rule;

/// Largest number of cells along each edge of a side.
pub const MAX_CELLS: usize = 64;

/// Steps of a position within a cell, along each edge.
const STEPS: u32 = 256;

/// The neighbors of each cell of a [`RoomLayout`](super::RoomLayout), for values between the
/// middles of cells.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CellGrid {
    /// Cells along each edge of a side; 0 without cells.
    count: u32,
    /// By side, row and column: the index of the cell plus one, or zero where there is none.
    index: Vec<u32>,
    /// By cell: its index in `index`.
    places: Vec<u32>,
}

impl CellGrid {
    /// The cells of a layout, given by side, row and column as its `RoomLayout` keeps them.
    pub(super) fn new(count: usize, index: &[u32], cells: usize) -> CellGrid {
        let mut places = vec![0; cells];
        for (place, &cell) in index.iter().enumerate().filter(|(_, cell)| **cell > 0) {
            places[cell as usize - 1] = place as u32;
        }
        CellGrid { count: count as u32, index: index.to_vec(), places }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Whether the grid has no cells.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Memory held, in bytes.
    pub fn bytes(&self) -> usize {
        4 * (self.index.len() + self.places.len())
    }

    /// Whether each cell has a place of its own.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub fn check(&self) -> Result<(), String> {
        let count = self.count as usize;
        rule(count <= MAX_CELLS, "at most 64 cells along each edge of a side")?;
        rule(self.index.len() == 6 * count * count, "as many cells on each side")?;
        let is_there = |(cell, place): (usize, &u32)| {
            self.index.get(*place as usize).is_some_and(|&index| index as usize == cell + 1)
        };
        rule(self.places.iter().enumerate().all(is_there), "a place for each cell")?;
        let taken = self.index.iter().filter(|&&index| index > 0).count();
        rule(taken == self.places.len(), "one place for each cell")
    }

    /// The position within a cell, 0..=1 along rows and columns, in 1/256 of its edges.
    pub fn steps(within: [f32; 2]) -> [u8; 2] {
        within.map(|within| (within * STEPS as f32) as u8)
    }

    /// `values`, one per cell, at the position `at` within a cell: from
    /// [`CellGrid::steps`]. It is bilinear between the middles of the cells of one side, and at the
    /// middle of a cell exactly this cell's value. Neighbors that are not there have no weight.
    pub fn interpolate(&self, values: &[Vec3], cell: usize, at: [u8; 2]) -> Vec3 {
        let count = self.count as usize;
        let place = self.places[cell] as usize;
        let (column, row) = (place % count, place / count % count);
        let [u, v] = at.map(|at| f32::from(at) / STEPS as f32 - 0.5);
        let neighbor = |is_beside: bool, is_below: bool| {
            let step = |from: usize, moves: bool, way: f32| {
                let to = if moves {
                    from.checked_add_signed(if way < 0.0 { -1 } else { 1 })?
                } else {
                    from
                };
                (to < count).then_some(to)
            };
            let (x, y) = (step(column, is_beside, u)?, step(row, is_below, v)?);
            let place = place - row * count - column + y * count + x;
            (self.index[place] as usize).checked_sub(1)
        };
        let (mut sum, mut all) = (Vec3::ZERO, 0.0);
        for (is_beside, is_below) in [(false, false), (true, false), (false, true), (true, true)] {
            let along = |moves: bool, way: f32| if moves { way.abs() } else { 1.0 - way.abs() };
            let weight = along(is_beside, u) * along(is_below, v);
            if weight > 0.0
                && let Some(neighbor) = neighbor(is_beside, is_below)
            {
                sum += weight * values[neighbor];
                all += weight;
            }
        }
        sum / all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cells of 3 x 3 a side, without the one at `gap` of the first side.
    fn grid(gap: Option<usize>) -> CellGrid {
        let mut cells = 0;
        let index: Vec<u32> = (0..6 * 9)
            .map(|place| {
                cells += u32::from(Some(place) != gap);
                if Some(place) == gap { 0 } else { cells }
            })
            .collect();
        CellGrid::new(3, &index, cells as usize)
    }

    #[test]
    fn a_middle_has_the_value_of_its_cell_and_a_line_stays_a_line() {
        let grid = grid(None);
        assert_eq!((grid.len(), grid.check()), (54, Ok(())));
        // Linear along rows and columns, and another level on each side.
        let values: Vec<Vec3> = (0..54)
            .map(|i| Vec3::new((i % 3) as f32, (i / 3 % 3) as f32, (i / 9) as f32))
            .collect();
        for (cell, value) in values.iter().enumerate() {
            assert_eq!(grid.interpolate(&values, cell, CellGrid::steps([0.5, 0.5])), *value);
            for (x, y) in [(0.0, 0.0), (0.25, 0.75), (1.0, 0.5)] {
                let got = grid.interpolate(&values, cell, CellGrid::steps([x, y]));
                // Beyond the outermost middles it stays level.
                let wanted = Vec3::new(value.x + x - 0.5, value.y + y - 0.5, value.z);
                let wanted = wanted.min(Vec3::new(2.0, 2.0, 5.0)).max(Vec3::ZERO);
                assert!((got - wanted).abs().max_element() < 0.005, "{cell}: {got} for {wanted}");
            }
        }
    }

    #[test]
    fn a_missing_neighbor_has_no_weight_and_leaves_no_step() {
        // The middle cell of the first side is missing.
        let grid = grid(Some(4));
        assert_eq!((grid.len(), grid.check()), (53, Ok(())));
        let values: Vec<Vec3> = (0..53).map(|i| Vec3::splat(((i * 7) % 5) as f32)).collect();
        assert_eq!(grid.interpolate(&vec![Vec3::ONE; 53], 0, [255, 255]), Vec3::ONE);
        // Cells 0 and 1 of the first row meet at the side that both share.
        for y in (0..=255).step_by(15) {
            let (left, right) =
                (grid.interpolate(&values, 0, [255, y]), grid.interpolate(&values, 1, [0, y]));
            assert!((left - right).abs().max_element() < 0.05, "{y}: {left} beside {right}");
        }
    }

    #[test]
    fn cells_without_a_place_of_their_own_are_found() {
        let whole = grid(None);
        let refused = |change: &dyn Fn(&mut CellGrid)| {
            let mut grid = whole.clone();
            change(&mut grid);
            grid.check().is_err()
        };
        assert!(refused(&|grid| grid.count = 65));
        assert!(refused(&|grid| grid.count = 2));
        assert!(refused(&|grid| grid.places[3] = 54));
        assert!(refused(&|grid| grid.places[3] = 4));
        assert!(refused(&|grid| grid.index[3] = 99));
        assert!(refused(&|grid| grid.places.truncate(53)));
        assert_eq!(CellGrid::default().check(), Ok(()));
    }
}
