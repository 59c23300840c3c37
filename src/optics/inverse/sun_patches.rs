//! Sunlight that a photo shows: patches on floors, walls and furniture, whose edges are those of
//! windows and of things before them.
//!
//! 1. Direction: of all directions of the sky that the windows see, the one whose light through
//!    their rectangles best explains the steps of log luminance within surfaces: the largest
//!    r^2 = (sum w g h)^2 / (sum w g^2 sum w h^2) over pairs of near cells of one surface, with g
//!    the photo's step and h that of the predicted sunlight.
//! 2. Patches: a window's rectangle is rarely exact, and much glass is out of view, so that the
//!    photo decides which pixels are lit. With x_p in {0, 1}, c_p the cosine to the sun and kappa
//!    the ratio of the sun's irradiance to all other light, the log luminance without the sun is
//!    `L_p - x_p log(1 + kappa c_p)`. The labels x are those that leave the least total variation
//!    within surfaces, plus a cost for each lit cell: a minimum cut. A step of chromaticity is
//!    paint, and weighs little.
//!
//! Sunlight and its shadow differ by nearly the same ratio on all materials (Finlayson, Drew and
//! Lu, IJCV 2009, "Entropy minimization for shadow removal", remove shadows by the same thought).

use glam::Vec3;
use rayon::prelude::*;

use super::mask_pixels::median;
use super::observations::white_level;
use crate::geometry::{Grid, Own, SceneMesh, Sight};
use crate::image::{
    Mask, Normal, Picture, Plane, Points, alpha_matte, connected_components, graph_cut, log_above,
    luminance,
};
use crate::optics::Window;
use crate::tuning::tuning;

tuning! {
    /// Constants of the search for sunlight in a photo.
    pub const TUNING: SunPatchesTuning {
        /// Side of the cells at which directions and patches are first sought.
        stride: usize = 4,
            unit "working pixels", source Taste, effect "a larger value is faster and misses narrow patches";
        /// Luminance that counts as black.
        black: f32 = 0.004,
            unit "fraction of white", source Derived("quantization of 8-bit photos"),
            effect "a larger value sees no patches in dark rooms";
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
        /// Longer distance of the pairs that find the direction.
        reach: usize = 3,
            unit "cells", source Taste, effect "a larger value forgives errors of a window's rectangle";
        /// Spacing of the first directions, and number of times that it is halved.
        spacing: f32 = 5.0,
            unit "degrees", source Taste, effect "a smaller value is slower and misses fewer suns";
        /// Number of times that the spacing is halved around the best directions.
        refinements: usize = 4,
            unit "1", source Derived("a third of a degree, the width of the sun's penumbra"),
            effect "a larger value is slower";
        /// Directions that are refined.
        refined: usize = 4,
            unit "directions", source Taste, effect "a larger value is slower and misses fewer suns";
        /// Least cosine between the sun and the outward normal of a window.
        grazing: f32 = 0.1,
            unit "1", source Taste, effect "a larger value ignores suns beside a wall";
        /// Least sine of the sun's elevation.
        lowest: f32 = 0.15,
            unit "1", source Taste, effect "a larger value ignores suns near the horizon";
        /// Least r^2 times the number of pairs: of few pairs, a direction of many explains some by
        /// chance.
        least_evidence: f64 = 250.0,
            unit "pairs", source Derived("less than half of what r^2 = 0.05 is at 320 x 240 pixels"),
            effect "a larger value finds no sun in small pictures";
        /// Ratios of the sun's irradiance to the other light that are tried.
        ratios: [f32; 4] = [0.8, 1.2, 1.8, 2.7],
            unit "1", source Taste, effect "other values find weaker or stronger suns";
        /// Cost of a lit cell of `stride` pixels, in steps of log luminance.
        cost: f32 = 0.02,
            unit "1", source Taste, effect "a larger value finds fewer patches";
        /// Gain of a lit cell whose light passes the rectangle of a window.
        predicted: f32 = 0.05,
            unit "1", source Taste, effect "a larger value trusts the rectangles of windows more";
        /// Cost of the edge of a patch, per pair of cells.
        edge: f32 = 0.05,
            unit "1", source Taste, effect "a larger value drops small patches and smooths outlines";
        /// Gain or cost of a cell whose label is known.
        certain: f32 = 100.0,
            unit "1", source Derived("above the steps of all neighbors"), effect "a smaller value lets known cells change";
        /// Integers per unit of the energy in the minimum cut.
        scale: f32 = 4096.0,
            unit "1", source Derived("gains of known cells stay below 2^19"), effect "a smaller value rounds more";
        /// Least cosine between a surface and the sun.
        least_cosine: f32 = 0.05,
            unit "1", source Taste, effect "a larger value ignores grazing sunlight";
        /// Growth of a window's rectangle within which sunlight may pass.
        growth: f32 = 1.15,
            unit "1", source Taste, effect "a larger value admits light beside a window";
        /// Least area of a patch that no window's rectangle predicts.
        least_area: usize = 25,
            unit "cells", source Taste, effect "a larger value drops small patches";
        /// Least number of pairs of cells over the edge of a patch.
        least_edge: usize = 4,
            unit "pairs", source Taste, effect "a larger value drops small patches";
        /// Least mean step over the edge of a patch, as a fraction of the expected one.
        least_contrast: f32 = 0.5,
            unit "1", source Taste, effect "a larger value drops faint patches";
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

/// A window through which the sun may shine.
pub struct SunWindow<'a> {
    /// Its rectangle.
    pub window: Window,
    /// Its pixels.
    pub mask: &'a Mask,
}

/// The sun, and the pixels that it lights.
pub struct FoundSun {
    /// Unit vector to the sun, camera space.
    pub direction: Vec3,
    /// The sun's irradiance on a surface that faces it over all other irradiance, per channel.
    pub ratio: Vec3,
    /// Lit fraction of each pixel through each window, 0..=1.
    pub lit: Vec<Plane<f32>>,
    /// r^2 of the direction.
    pub explained: f64,
}

/// Cells of the photo, those of the room with their values.
struct Cells {
    width: usize,
    height: usize,
    cells: Vec<Option<Cell>>,
}

#[derive(Clone, Copy)]
struct Cell {
    point: Vec3,
    normal: Vec3,
    log: f32,
    chroma: Vec3,
    rgb: Vec3,
}

/// Two near cells of one surface.
#[derive(Clone, Copy)]
struct Pair {
    cells: [usize; 2],
    /// Log luminance of the first minus that of the second.
    step: f32,
    weight: f32,
}

impl Cells {
    /// `black` is the luminance that counts as black.
    fn new(room: &SunlitRoom, stride: usize, black: f32) -> Cells {
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
            (!room.outside.pixels()[pixel]).then_some(Cell { point, normal, log, chroma, rgb })
        };
        Cells { width, height, cells: (0..grid.len()).map(cell).collect() }
    }

    /// Pairs of cells of one surface, `reach` cells apart along an axis.
    fn pairs(&self, reach: usize) -> Vec<Pair> {
        let (w, h) = (self.width, self.height);
        let neighbors = |i: usize| {
            let right = (i % w + reach < w).then_some([i, i + reach]);
            let below = (i / w + reach < h).then_some([i, i + reach * w]);
            right.into_iter().chain(below)
        };
        (0..w * h).flat_map(neighbors).filter_map(|cells| self.pair(cells)).collect()
    }

    fn pair(&self, cells: [usize; 2]) -> Option<Pair> {
        let (a, b) = (self.cells[cells[0]]?, self.cells[cells[1]]?);
        let between = b.point - a.point;
        let off = a.normal.dot(between).abs().max(b.normal.dot(between).abs());
        let is_one = a.normal.dot(b.normal) > TUNING.smooth_normal
            && off < TUNING.off_plane * a.point.length();
        let chroma = (a.chroma - b.chroma).length() / TUNING.same_chroma;
        is_one.then(|| Pair { cells, step: a.log - b.log, weight: (-chroma * chroma).exp() })
    }
}

/// The sun whose patches the photo shows, if it shows any: a direction of an r^2 of at least
/// `min_explained`, from enough pairs, with patches.
pub fn find_sun(room: &SunlitRoom, windows: &[SunWindow], min_explained: f64) -> Option<FoundSun> {
    let search = Search::new(room, windows);
    let is_plain = |r2: f64| {
        r2 >= min_explained
            && r2 * search.pairs.iter().map(Vec::len).sum::<usize>() as f64 >= TUNING.least_evidence
    };
    let (explained, direction) = search.direction().filter(|(r2, _)| is_plain(*r2))?;
    let possible = search.possible(direction);
    let (coarse, kappa) = search.patches(direction, &possible);
    if !coarse.pixels().contains(&true) {
        return None;
    }
    let ratio = search.ratio(direction, &coarse, kappa);
    let lit = search.refined(direction, &coarse, kappa);
    let mut through = vec![lit.map(|_| 0.0); windows.len()];
    for (i, &lit) in lit.pixels().iter().enumerate().filter(|(_, lit)| **lit > 0.0) {
        let window = search.window_of(room.points.0.pixels()[i], direction);
        through[window].pixels_mut()[i] = lit;
    }
    Some(FoundSun { direction, ratio, lit: through, explained })
}

struct Search<'a> {
    room: &'a SunlitRoom<'a>,
    windows: Vec<(&'a SunWindow<'a>, Own, Vec3)>,
    /// Luminance that counts as black.
    black: f32,
    cells: Cells,
    /// Pairs of neighbors, and pairs `TUNING.reach` cells apart.
    pairs: [Vec<Pair>; 2],
}

impl<'a> Search<'a> {
    fn new(room: &'a SunlitRoom<'a>, windows: &'a [SunWindow<'a>]) -> Search<'a> {
        let levels = room.photo.0.pixels().iter().map(|&pixel| (pixel, false));
        let black = (TUNING.black * white_level(levels)).max(f32::MIN_POSITIVE);
        let cells = Cells::new(room, TUNING.stride, black);
        let pairs = [1, TUNING.reach].map(|reach| cells.pairs(reach));
        let window = |w: &'a SunWindow<'a>| {
            (w, Own::new(w.mask), w.window.x.cross(w.window.y).normalize_or_zero())
        };
        Search { room, windows: windows.iter().map(window).collect(), black, cells, pairs }
    }

    /// Point at which the line from `from` towards the sun meets the plane of window `k`, and how
    /// far it is outside of the rectangle there, in half edges: at most 1 within it.
    fn crossing(&self, k: usize, from: Vec3, direction: Vec3) -> Option<(Vec3, f32)> {
        let (SunWindow { window, .. }, _, normal) = &self.windows[k];
        let along = normal.dot(direction);
        let distance = normal.dot(window.center - from) / along;
        if along > -1e-3 || distance <= 0.0 {
            return None;
        }
        let at = from + direction * distance;
        let side = |edge: Vec3| ((at - window.center).dot(edge) / edge.length_squared()).abs();
        Some((at, side(window.x).max(side(window.y))))
    }

    fn lifted(&self, cell: &Cell) -> Vec3 {
        cell.point + cell.normal * self.room.mesh.offset(cell.point)
    }

    /// Cosine to the sun of each cell that it reaches through a window's rectangle, else 0.
    fn sunlight(&self, direction: Vec3) -> Vec<f32> {
        let lit = |cell: &Option<Cell>| {
            let Some(cell) = cell else { return 0.0 };
            let (cosine, from) = (cell.normal.dot(direction), self.lifted(cell));
            let through = |k: usize| {
                self.crossing(k, from, direction).is_some_and(|(at, outside)| {
                    let own = Some(&self.windows[k].1);
                    outside <= 1.0 && self.room.mesh.visibility(from, at, own) == Sight::Lit
                })
            };
            if cosine > 0.0 && (0..self.windows.len()).any(through) { cosine } else { 0.0 }
        };
        self.cells.cells.iter().map(lit).collect()
    }

    /// r^2 of the sunlight from `direction`.
    fn explained(&self, direction: Vec3) -> f64 {
        let sunlight = self.sunlight(direction);
        let (mut gh, mut hh, mut gg) = (0.0, 0.0, 0.0);
        for Pair { cells: [a, b], step, weight } in self.pairs.iter().flatten() {
            let h = f64::from(sunlight[*a] - sunlight[*b]);
            let g = f64::from(step.clamp(-TUNING.longest_step, TUNING.longest_step));
            let weight = f64::from(*weight);
            gh += weight * g * h;
            hh += weight * h * h;
            gg += weight * g * g;
        }
        if hh > 0.0 && gg > 0.0 { gh.max(0.0).powi(2) / (hh * gg) } else { 0.0 }
    }

    /// The direction that explains most, with its r^2.
    fn direction(&self) -> Option<(f64, Vec3)> {
        let seen = |d: &Vec3| {
            self.windows.iter().any(|(_, _, normal)| -normal.dot(*d) > TUNING.grazing)
                && d.dot(self.room.up) > TUNING.lowest
        };
        let score = |directions: Vec<Vec3>| -> Vec<(f64, Vec3)> {
            directions.into_par_iter().map(|d| (self.explained(d), d)).collect()
        };
        let mut best = score(sky(self.room.up).into_iter().filter(seen).collect());
        let keep = |best: &mut Vec<(f64, Vec3)>| {
            best.sort_by(|a, b| b.0.total_cmp(&a.0));
            best.truncate(TUNING.refined);
        };
        keep(&mut best);
        let mut spacing = TUNING.spacing.to_radians();
        for _ in 0..TUNING.refinements {
            spacing /= 2.0;
            best.extend(score(
                best.iter().flat_map(|(_, d)| around(*d, spacing)).filter(seen).collect(),
            ));
            keep(&mut best);
        }
        best.first().copied().filter(|(explained, _)| *explained > 0.0)
    }

    /// Cells that the sun can reach: nothing in view is between, and the light passes a window or
    /// what the photo does not show of its wall.
    fn possible(&self, direction: Vec3) -> Vec<bool> {
        let possible = |cell: &Option<Cell>| {
            let Some(cell) = cell else { return false };
            let from = self.lifted(cell);
            cell.normal.dot(direction) > TUNING.least_cosine
                && (0..self.windows.len()).any(|k| {
                    self.crossing(k, from, direction).is_some_and(|(at, outside)| {
                        let own = Some(&self.windows[k].1);
                        (outside <= TUNING.growth || !self.room.mesh.in_view(at))
                            && self.room.mesh.visibility(from, at, own) != Sight::Blocked
                    })
                })
        };
        self.cells.cells.iter().map(possible).collect()
    }

    /// Lit cells, and the ratio of the sun to the other light.
    fn patches(&self, direction: Vec3, possible: &[bool]) -> (Plane<bool>, f32) {
        let [pairs, _] = &self.pairs;
        let predicted = self.sunlight(direction);
        let gain = |(&possible, &predicted): (&bool, &f32)| match possible {
            true if predicted > 0.0 => TUNING.predicted,
            true => -TUNING.cost,
            false => -TUNING.certain,
        };
        let gain: Vec<f32> = possible.iter().zip(&predicted).map(gain).collect();
        let try_ratio = |kappa: f32| {
            let step = steps(&self.cells, direction, kappa);
            let lit = cut(&self.cells, pairs, &step, gain.clone());
            let lit = kept(&self.cells, pairs, &step, &predicted, &lit);
            let cost = TUNING.cost * lit.pixels().iter().filter(|&&lit| lit).count() as f32;
            (variation(pairs, &step, &lit) + f64::from(cost), lit, kappa)
        };
        let all: Vec<_> = TUNING.ratios.into_par_iter().map(try_ratio).collect();
        let least = all.into_iter().reduce(|a, b| if b.0 < a.0 { b } else { a });
        least.map(|(_, lit, kappa)| (lit, kappa)).expect("ratios are tried")
    }

    /// Median ratio of the sun to the other light over the edges of the patches, per channel;
    /// `kappa` without an edge. The pairs are of one paint, and a cell away from the edge, where
    /// cells are mixed.
    fn ratio(&self, direction: Vec3, lit: &Plane<bool>, kappa: f32) -> Vec3 {
        let lit = lit.pixels();
        let mut ratios: [Vec<f32>; 3] = Default::default();
        for &Pair { cells: [a, b], weight, .. } in &self.pairs[1] {
            let next = (b - a) / TUNING.reach;
            if weight < 0.5
                || lit[a] == lit[b]
                || lit[a] != lit[a + next]
                || lit[b] != lit[b - next]
            {
                continue;
            }
            let (sun, shade) = if lit[a] { (a, b) } else { (b, a) };
            let (Some(sun), Some(shade)) = (&self.cells.cells[sun], &self.cells.cells[shade])
            else {
                continue;
            };
            let cosine = sun.normal.dot(direction).max(TUNING.least_cosine);
            let ratio = (sun.rgb / shade.rgb.max(Vec3::splat(self.black)) - 1.0) / cosine;
            (0..3).for_each(|k| ratios[k].push(ratio[k]));
        }
        let of_channel = |ratios: Vec<f32>| match ratios.is_empty() {
            true => kappa,
            false => median(ratios).max(0.0),
        };
        Vec3::from_array(ratios.map(of_channel))
    }

    /// Lit fractions of the pixels: near the edges of the patches the cut again for each pixel,
    /// with mixed pixels at its edge.
    fn refined(&self, direction: Vec3, patches: &Plane<bool>, kappa: f32) -> Plane<f32> {
        let pixels = Cells::new(self.room, 1, self.black);
        let (w, h) = (pixels.width, pixels.height);
        let (columns, rows) = patches.size();
        let cost = TUNING.cost / (TUNING.stride * TUNING.stride) as f32;
        let gain = |i: usize| {
            let (x, y) = (i % w / TUNING.stride, i / w / TUNING.stride);
            let lit = patches.get(x, y);
            let mut around = (y.saturating_sub(1)..(y + 2).min(rows))
                .flat_map(|y| (x.saturating_sub(1)..(x + 2).min(columns)).map(move |x| (x, y)));
            match around.any(|(x, y)| patches.get(x, y) != lit) {
                true => -cost,
                false if lit => TUNING.certain,
                false => -TUNING.certain,
            }
        };
        let step = steps(&pixels, direction, kappa);
        let lit = cut(&pixels, &pixels.pairs(1), &step, (0..w * h).map(gain).collect());
        let faces = |i: usize| pixels.cells[i].is_some_and(|c| c.normal.dot(direction) > 0.0);
        let lit = |i: usize| if lit.pixels()[i] && faces(i) { 1.0 } else { 0.0 };
        let mask = Plane::new(w, h, (0..w * h).map(lit).collect());
        alpha_matte(&mask, self.room.photo).alpha
    }

    /// Index of the window whose rectangle the sunlight at `point` passes, or passes nearest.
    fn window_of(&self, point: Vec3, direction: Vec3) -> usize {
        let outside = |k: &usize| self.crossing(*k, point, direction).map_or(f32::MAX, |c| c.1);
        let windows = 0..self.windows.len();
        windows.min_by(|a, b| outside(a).total_cmp(&outside(b))).unwrap_or(0)
    }
}

/// Step of log luminance between sun and shade at each cell.
fn steps(cells: &Cells, direction: Vec3, kappa: f32) -> Vec<f32> {
    let step = |cell: &Option<Cell>| {
        cell.map_or(0.0, |cell| (kappa * cell.normal.dot(direction).max(0.0)).ln_1p())
    };
    cells.cells.iter().map(step).collect()
}

/// Variation of the log luminance without the sun.
fn variation(pairs: &[Pair], step: &[f32], lit: &Plane<bool>) -> f64 {
    let sun = |i: usize| if lit.pixels()[i] { step[i] } else { 0.0 };
    let left = |p: &Pair| f64::from(p.weight * (p.step - sun(p.cells[0]) + sun(p.cells[1])).abs());
    pairs.iter().map(left).sum()
}

/// The labels of least variation. `gain` is that of a lit cell.
fn cut(cells: &Cells, pairs: &[Pair], step: &[f32], mut gain: Vec<f32>) -> Plane<bool> {
    let (w, h) = (cells.width, cells.height);
    // Of each cell, the weights to the right and below.
    let mut weights = vec![[0i32; 2]; w * h];
    for Pair { cells: [a, b], step: g, weight } in pairs {
        let expected = 0.5 * (step[*a] + step[*b]);
        let [first, second] = [(g - expected).abs(), (g + expected).abs()];
        // E(1, 0), E(0, 1) and E(0, 0) = E(1, 1) as two gains and a weight of unequal labels.
        gain[*a] += weight * 0.5 * (second - first);
        gain[*b] += weight * 0.5 * (first - second);
        let unequal = 0.5 * (first + second) - g.abs() + TUNING.edge;
        let unequal = (weight * unequal * TUNING.scale) as i32;
        weights[*a][usize::from(*b != *a + 1)] = unequal.max(0);
    }
    let gain = Plane::new(w, h, gain.iter().map(|gain| (gain * TUNING.scale) as i32).collect());
    graph_cut(&gain, |x, y, nx, ny| match (nx as isize - x as isize, ny as isize - y as isize) {
        (1, 0) => weights[y * w + x][0],
        (-1, 0) => weights[ny * w + nx][0],
        (0, 1) => weights[y * w + x][1],
        (0, -1) => weights[ny * w + nx][1],
        _ => 0,
    })
}

/// The patches that are large, or predicted by a window's rectangle, and whose edges have enough
/// contrast.
fn kept(
    cells: &Cells,
    pairs: &[Pair],
    step: &[f32],
    predicted: &[f32],
    lit: &Plane<bool>,
) -> Plane<bool> {
    let patches = connected_components(lit);
    let mut patch_of = vec![None; lit.len()];
    for (k, patch) in patches.iter().enumerate() {
        patch.iter().for_each(|&i| patch_of[i] = Some(k));
    }
    // Of each patch, the pairs over its edge, their steps and the expected ones.
    let mut edges = vec![(0, 0.0, 0.0); patches.len()];
    for Pair { cells: [a, b], step: g, weight } in pairs {
        for (sun, shade, g) in [(*a, *b, *g), (*b, *a, -*g)] {
            if let (Some(k), None) = (patch_of[sun], patch_of[shade]) {
                let (count, got, expected) = edges[k];
                edges[k] = (count + 1, got + weight * g, expected + step[sun]);
            }
        }
    }
    let is_kept = |k: usize| {
        let (count, got, expected) = edges[k];
        let is_predicted = patches[k].iter().any(|&i| predicted[i] > 0.0);
        (is_predicted || patches[k].len() >= TUNING.least_area)
            && count >= TUNING.least_edge
            && got >= TUNING.least_contrast * expected
    };
    let kept: Vec<bool> = (0..patches.len()).map(is_kept).collect();
    let lit = patch_of.into_iter().map(|patch| patch.is_some_and(|k| kept[k])).collect();
    Plane::new(cells.width, cells.height, lit)
}

/// Directions of the sky, `TUNING.spacing` apart.
fn sky(up: Vec3) -> Vec<Vec3> {
    let (a, b) = up.any_orthonormal_pair();
    let circles = (90.0 / TUNING.spacing) as usize;
    let circle = |k: usize| {
        let (sine, cosine) = (k as f32 * TUNING.spacing).to_radians().sin_cos();
        let count = (cosine * 360.0 / TUNING.spacing).ceil().max(1.0) as usize;
        (0..count).map(move |i| {
            let (y, x) = (i as f32 / count as f32 * std::f32::consts::TAU).sin_cos();
            up * sine + (a * x + b * y) * cosine
        })
    };
    (1..circles).flat_map(circle).collect()
}

/// Eight directions at this angle from `direction`.
fn around(direction: Vec3, angle: f32) -> [Vec3; 8] {
    let (a, b) = direction.any_orthonormal_pair();
    std::array::from_fn(|k| {
        let (y, x) = (k as f32 / 8.0 * std::f32::consts::TAU).sin_cos();
        (direction + (a * x + b * y) * angle).normalize()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;

    const SIZE: (usize, usize) = (160, 120);

    /// A room 4 m wide, 3 m high and 5 m deep with the camera at z = 0, 1.5 m above the floor, and
    /// a window in its left wall.
    struct Room {
        points: Points,
        normal: Normal,
        mesh: SceneMesh,
        window: Window,
        mask: Mask,
        outside: Plane<bool>,
    }

    fn room() -> Room {
        let camera = Camera::from_fov_x(SIZE.0, SIZE.1, 75.0);
        let sides = [
            (Vec3::X, 2.0),
            (Vec3::NEG_X, 2.0),
            (Vec3::Y, 1.5),
            (Vec3::NEG_Y, 1.5),
            (Vec3::Z, 5.0),
        ];
        let hit = |x: usize, y: usize| {
            let ray = camera.pixel_point(x, y, 1.0);
            let distance = |&(n, d): &(Vec3, f32)| match n.dot(ray) < 0.0 {
                true => -d / n.dot(ray),
                false => f32::MAX,
            };
            let side = sides.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
            let side = side.expect("there are five");
            (ray * distance(side), side.0)
        };
        let points = Points(Plane::from_fn(SIZE.0, SIZE.1, |x, y| hit(x, y).0));
        let normal = Normal(Plane::from_fn(SIZE.0, SIZE.1, |x, y| hit(x, y).1));
        let (center, x, y) = (Vec3::new(-1.99, 0.2, -3.2), Vec3::NEG_Z * 0.8, Vec3::Y * 0.6);
        let window = Window { center, x, y, lobes: Window::daylight(Vec3::X) };
        let mask = Mask(points.0.map(|p| {
            let inside = (p.z - center.z).abs() < 0.8 && (p.y - center.y).abs() < 0.6;
            if p.x < -1.98 && inside { 1.0 } else { 0.0 }
        }));
        let outside = mask.0.map(|m| m > 0.5);
        let mesh = SceneMesh::new(&points, camera.fx, 1e-4, &Plane::filled(SIZE.0, SIZE.1, false));
        Room { points, normal, mesh, window, mask, outside }
    }

    impl Room {
        /// Whether light from `direction` reaches the pixel through the window.
        fn is_lit(&self, pixel: usize, direction: Vec3) -> bool {
            let Window { center, x, y, .. } = self.window;
            let (point, normal) = (self.points.0.pixels()[pixel], self.normal.0.pixels()[pixel]);
            let distance = (center.x - point.x) / direction.x;
            let at = point + direction * distance - center;
            normal.dot(direction) > 0.0
                && distance > 0.01
                && at.dot(x).abs() < x.length_squared()
                && at.dot(y).abs() < y.length_squared()
        }

        /// The photo of the room under even light and a sun that is `kappa` times as bright, with
        /// stripes of brown paint on the floor.
        fn photo(&self, direction: Vec3, kappa: f32) -> Picture {
            let pixel = |i: usize| {
                let (point, normal) = (self.points.0.pixels()[i], self.normal.0.pixels()[i]);
                let striped = normal == Vec3::Y && (point.x * 2.0).rem_euclid(1.0) < 0.3;
                let albedo = if striped { Vec3::new(0.5, 0.3, 0.15) } else { Vec3::splat(0.6) };
                let sun = if self.is_lit(i, direction) { normal.dot(direction) } else { 0.0 };
                albedo * (0.3 + 0.3 * kappa * sun)
            };
            Picture(Plane::new(SIZE.0, SIZE.1, (0..SIZE.0 * SIZE.1).map(pixel).collect()))
        }

        fn find(&self, photo: &Picture) -> Option<FoundSun> {
            let Room { points, normal, mesh, outside, .. } = self;
            let windows = [SunWindow { window: self.window.clone(), mask: &self.mask }];
            find_sun(
                &SunlitRoom { photo, points, normal, mesh, outside, up: Vec3::Y },
                &windows,
                0.0,
            )
        }
    }

    #[test]
    fn a_sun_is_found_with_its_direction_its_strength_and_its_pixels() {
        let room = room();
        for direction in [Vec3::new(-0.7, 0.6, -0.1), Vec3::new(-0.8, 0.4, 0.3)] {
            let direction = direction.normalize();
            let found = room.find(&room.photo(direction, 2.0)).expect("there is a sun");
            let angle = found.direction.angle_between(direction).to_degrees();
            assert!(angle < 3.0, "{angle} degrees off");
            assert!(found.explained > 0.3, "r^2 {}", found.explained);
            // Cells at the edge are mixed.
            let ratio = found.ratio.element_sum() / 3.0;
            assert!((1.6..2.2).contains(&ratio), "{ratio} times the other light");
            let (mut both, mut either) = (0.0, 0.0);
            for (i, &lit) in found.lit[0].pixels().iter().enumerate() {
                let wanted =
                    f32::from(u8::from(room.is_lit(i, direction) && !room.outside.pixels()[i]));
                both += lit.min(wanted);
                either += lit.max(wanted);
            }
            assert!(both > 0.9 * either, "intersection over union {}", both / either);
        }
    }

    #[test]
    fn paint_is_no_sun() {
        let room = room();
        let found = room.find(&room.photo(Vec3::NEG_X, 0.0));
        assert!(found.is_none_or(|found| found.explained < 0.02));
        let black = Picture(Plane::filled(SIZE.0, SIZE.1, Vec3::ZERO));
        assert!(room.find(&black).is_none());
    }
}
