//! Cells of a photo, the steps of its log luminance between them, and how well sunlight explains
//! these.

use glam::Vec3;

use crate::geometry::{Grid, SceneMesh};
use crate::image::{Normal, Picture, Plane, Points, log_above, luminance};
use crate::tuning::tuning;

tuning! {
    /// Constants of the cells and steps by which sunlight is found.
    pub const TUNING: SunCellsTuning {
        /// Largest step of log luminance that counts in the search for the direction.
        longest_step: f32 = 1.5,
            unit "1", source Taste, effect "a larger value gives highlights more weight";
        /// Least cosine between the normals of cells of one surface.
        smooth_normal: f32 = 0.95,
            unit "1", source Taste, effect "a larger value takes more neighbors for creases";
        /// Largest distance of a cell from the tangent plane of another of the same surface.
        off_plane: f32 = 0.015,
            unit "fraction of the distance", source Derived("noise of depth maps"),
            effect "a larger value joins steps of the room";
        /// Difference of log chromaticity at which a step counts 1 / e.
        same_chroma: f32 = 0.3,
            unit "1", source Taste, effect "a smaller value takes warm sunlight for paint";
    }
}

/// The photo and the surfaces that it shows; planes of one size.
#[derive(Clone, Copy)]
pub struct SunlitRoom<'a> {
    /// Linear RGB of any exposure.
    pub photo: &'a Picture,
    /// Camera space, meters.
    pub points: &'a Points,
    /// Unit normals.
    pub normal: &'a Normal,
    /// Casts shadows.
    pub mesh: &'a SceneMesh,
    /// Pixels of lights and pixels outside the room.
    pub outside: &'a Plane<bool>,
    /// Unit vector away from the floor.
    pub up: Vec3,
}

/// Square cells of the photo; `None` outside the room.
pub struct Cells(pub Plane<Option<Cell>>);

/// The surface at the center of a cell, and its mean color.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    pub point: Vec3,
    pub normal: Vec3,
    pub rgb: Vec3,
    log: f32,
    chroma: Vec3,
}

/// Two near cells of one surface.
#[derive(Clone, Copy)]
pub struct Pair {
    pub cells: [usize; 2],
    /// Log luminance of the first minus that of the second.
    pub step: f32,
    /// 1 for cells of one chromaticity.
    pub weight: f32,
}

impl Cells {
    /// Cells of `stride` x `stride` pixels. `black` is the luminance that counts as black.
    pub fn new(room: &SunlitRoom, stride: usize, black: f32) -> Cells {
        let grid = Grid::new(room.points.0.size(), stride);
        let blocks = room.photo.blocks(stride).0;
        let (width, height) = grid.size();
        let cell = |i: usize| {
            let pixel = grid.pixel(i);
            let (point, normal) = (room.points.0.pixels()[pixel], room.normal.0.pixels()[pixel]);
            let rgb = blocks.pixels()[i];
            let log = log_above(black, rgb);
            let chroma = log - Vec3::splat(log.element_sum() / 3.0);
            let log = luminance(rgb).max(black).ln();
            (!room.outside.pixels()[pixel]).then_some(Cell { point, normal, rgb, log, chroma })
        };
        Cells(Plane::new(width, height, (0..grid.len()).map(cell).collect()))
    }

    /// Pairs of cells of one surface, `reach` cells apart along an axis.
    pub fn pairs(&self, reach: usize) -> Vec<Pair> {
        let (w, h) = self.0.size();
        let neighbors = |i: usize| {
            let right = (i % w + reach < w).then_some([i, i + reach]);
            let below = (i / w + reach < h).then_some([i, i + reach * w]);
            right.into_iter().chain(below)
        };
        (0..w * h).flat_map(neighbors).filter_map(|cells| self.pair(cells)).collect()
    }

    fn pair(&self, cells: [usize; 2]) -> Option<Pair> {
        let [a, b] = cells.map(|i| self.0.pixels()[i]);
        let (a, b) = (a?, b?);
        let between = b.point - a.point;
        let off = a.normal.dot(between).abs().max(b.normal.dot(between).abs());
        let is_one = a.normal.dot(b.normal) > TUNING.smooth_normal
            && off < TUNING.off_plane * a.point.length();
        let chroma = (a.chroma - b.chroma).length() / TUNING.same_chroma;
        is_one.then(|| Pair { cells, step: a.log - b.log, weight: (-chroma * chroma).exp() })
    }
}

impl Pair {
    /// The step as it counts in the search for the direction.
    pub fn limited_step(&self) -> f64 {
        f64::from(self.step.clamp(-TUNING.longest_step, TUNING.longest_step))
    }
}

/// The steps of pairs of cells.
pub struct Steps {
    /// The other cells of each cell's pairs, the steps from these and their weights.
    near: Vec<Vec<(usize, f64, f64)>>,
    /// Weighted sum of the squares of the steps.
    squares: f64,
}

impl Steps {
    /// The steps of `pairs` of `count` cells.
    pub fn new<'a>(count: usize, pairs: impl IntoIterator<Item = &'a Pair>) -> Steps {
        let (mut near, mut squares) = (vec![Vec::new(); count], 0.0);
        for pair in pairs {
            let ([a, b], step, weight) = (pair.cells, pair.limited_step(), f64::from(pair.weight));
            near[a].push((b, step, weight));
            near[b].push((a, -step, weight));
            squares += weight * step * step;
        }
        Steps { near, squares }
    }

    /// The steps of each cell from darkness to these values.
    pub fn from_dark(values: impl IntoIterator<Item = f32>) -> Steps {
        let values: Vec<f64> = values.into_iter().map(f64::from).collect();
        let squares = values.iter().map(|value| value * value).sum();
        // Each cell is paired with itself, as it is dark before its light is added.
        let near = values.iter().enumerate().map(|(i, &value)| vec![(i, value, 1.0)]).collect();
        Steps { near, squares }
    }
}

/// Light of the sun on cells, and how well its steps explain those of the photo.
pub struct Sunlight<'a> {
    steps: &'a Steps,
    light: Vec<f32>,
    /// Weighted sums of the products of both steps, and of the squares of those of the sunlight.
    products: f64,
    squares: f64,
}

impl<'a> Sunlight<'a> {
    /// No light.
    pub fn none(steps: &'a Steps) -> Sunlight<'a> {
        Sunlight { steps, light: vec![0.0; steps.near.len()], products: 0.0, squares: 0.0 }
    }

    /// Light on each cell, in the unit in which it was added.
    pub fn light(&self) -> &[f32] {
        &self.light
    }

    /// Lights cell `i`, which is dark.
    pub fn add(&mut self, i: usize, light: f32) {
        for &(other, step, weight) in &self.steps.near[i] {
            let (light, other) = (f64::from(light), f64::from(self.light[other]));
            self.products += weight * step * light;
            self.squares += weight * ((light - other).powi(2) - other.powi(2));
        }
        self.light[i] = light;
    }

    /// r^2 = (sum w g h)^2 / (sum w g^2 sum w h^2) of the steps g of the photo and h of this light;
    /// 0 if they are opposed.
    pub fn explained(&self) -> f64 {
        match self.squares > 0.0 && self.products > 0.0 {
            true => self.products.powi(2) / (self.squares * self.steps.squares),
            false => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_that_has_the_steps_of_the_photo_explains_all_of_it() {
        // Five cells in a row, the middle three lit; each is joined with the next.
        let logs = [0.0, 0.7, 0.7, 0.7, 0.0f32];
        let pair = |i: usize| Pair { cells: [i, i + 1], step: logs[i] - logs[i + 1], weight: 0.5 };
        let pairs: Vec<Pair> = (0..4).map(pair).collect();
        let steps = Steps::new(5, &pairs);
        let mut light = Sunlight::none(&steps);
        assert_eq!(light.explained(), 0.0);
        let explained = [2, 1, 3, 4].map(|i| {
            light.add(i, 0.2);
            light.explained()
        });
        // One edge of two, and then both; a step that the photo has not, and an edge less.
        let want = [0.0, 0.25, 1.0, 0.5];
        for (got, want) in explained.into_iter().zip(want) {
            assert!((got - want).abs() < 1e-6, "{explained:?}");
        }
        assert_eq!(light.light(), [0.0, 0.2, 0.2, 0.2, 0.2]);
    }

    #[test]
    fn light_of_opposed_steps_explains_nothing() {
        let pairs = [Pair { cells: [0, 1], step: 0.7, weight: 1.0 }];
        let steps = Steps::new(2, &pairs);
        let mut light = Sunlight::none(&steps);
        light.add(1, 1.0);
        assert_eq!(light.explained(), 0.0);
    }
}
