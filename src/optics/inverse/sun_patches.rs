//! Sunlight that a photo shows: patches on floors, walls and furniture, whose edges are those of
//! windows and of things before them.
//!
//! 1. Direction: of all directions of the sky that the windows see, the one whose light through
//!    their rectangles best explains the steps of log luminance within surfaces: the largest
//!    r^2 = (sum w g h)^2 / (sum w g^2 sum w h^2) over pairs of near cells of one surface, with g
//!    the photo's step and h that of the predicted sunlight. Where a side of a rectangle lies out
//!    of view, the window may go on there, as far as explains most.
//! 2. Patches: a window's rectangle is rarely exact, and much glass is out of view, so that the
//!    photo decides which pixels are lit. With x_p in {0, 1}, c_p the cosine to the sun and kappa
//!    the ratio of the sun's irradiance to all other light, the log luminance without the sun is
//!    `L_p - x_p log(1 + kappa c_p)`. The labels x are those that leave the least total variation
//!    within surfaces, plus a cost for each lit cell: a minimum cut. A step of chromaticity is
//!    paint, and weighs little.
//! 3. Test: light of the sky or of a lamp has soft edges, so that it explains the steps between
//!    neighbors less than those between cells further apart.
//!
//! A drawing of the lit pixels by a person replaces the test. The light from the chosen direction
//! through the windows overlaps most with the drawing, kappa leaves the least variation under it,
//! and the cut moves its edges to those of the photo.
//!
//! Sunlight and its shadow differ by nearly the same ratio on all materials (Finlayson, Drew and
//! Lu, IJCV 2009, "Entropy minimization for shadow removal", remove shadows by the same thought).

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::mask_pixels::median;
use super::observations::white_level;
use super::sun_cells::{Cell, Cells, Pair, Steps, Sunlight, SunlitRoom};
use crate::geometry::{Own, SceneMesh, Sight};
use crate::image::{Mask, Picture, Plane, alpha_matte, connected_components, graph_cut};
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
        /// Sum added to the r^2 of a direction and a drawing, before it is multiplied by the share
        /// of the drawing that the sun can reach: openings out of view are not known.
        by_chance: f64 = 0.05,
            unit "1", source Taste, effect "a smaller value trusts the rectangles of windows more";
        /// Least weight of a pair from which the sun's strength is measured.
        one_paint: f32 = 0.5,
            unit "1", source Taste, effect "a smaller value takes paint for sunlight";
        /// Integers per unit of the energy in the minimum cut.
        scale: f32 = 4096.0,
            unit "1", source Derived("gains of known cells stay below 2^19"), effect "a smaller value rounds more";
        /// Least cosine between a surface and the sun.
        least_cosine: f32 = 0.05,
            unit "1", source Taste, effect "a larger value ignores grazing sunlight";
        /// Growth of a window's rectangle within which sunlight may pass.
        growth: f32 = 1.15,
            unit "1", source Taste, effect "a larger value admits light beside a window";
        /// Distance from the side of a window's rectangle to places that the photo does not show,
        /// at which the window goes on out of view.
        out_of_view: f32 = 0.2,
            unit "m", source Derived("errors of the rectangles"),
            effect "a larger value takes whole windows near the edge of the photo for parts";
        /// Largest length of a window out of view.
        beyond: f32 = 4.5,
            unit "m", source Taste, effect "a larger value admits light of windows that are larger";
        /// Rounds in which the sides of openings are chosen.
        rounds: usize = 2,
            unit "1", source Taste, effect "a larger value is slower";
        /// Least step of log luminance between neighbors over the edges of all patches, over that
        /// of the faintest sun of `ratios`: 0.98 to 1.46 for 10 suns, 0.81 to 0.90 for soft light.
        least_step: f64 = 0.95,
            unit "1", source Measured("60 generated rooms, docs/estimation.md"),
            effect "a smaller value takes gradients of other light for the sun's";
        /// Least r^2 of the patches over that of the openings: 0.38 for a lamp's light.
        least_agreement: f64 = 0.7,
            unit "1", source Measured("60 generated rooms, docs/estimation.md"),
            effect "a larger value drops suns behind plants and muntins";
        /// Largest lit fraction of the photo.
        most_lit: f32 = 0.35,
            unit "1", source Measured("0.24 at most in 12 rooms and photos"),
            effect "a larger value takes bright floors for sunlit ones";
        /// Least area of a patch that no opening predicts, as through another window.
        least_area: usize = 25,
            unit "cells", source Taste, effect "a larger value drops small patches";
        /// Least step over the edge of such a patch over that of the patches that an opening
        /// predicts, both as fractions of the expected ones: one sun is as bright everywhere.
        alike: f32 = 0.7,
            unit "1", source Measured("0.77 for a sunlit floor of a photo, at most 0.56 for paint in generated rooms"),
            effect "a larger value drops faint patches";
        /// Least number of pairs of cells over the edge of a patch.
        least_edge: usize = 4,
            unit "pairs", source Taste, effect "a larger value drops small patches";
        /// Least mean step over the edge of a patch, as a fraction of the expected one.
        least_contrast: f32 = 0.5,
            unit "1", source Taste, effect "a larger value drops faint patches";
    }
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

/// The sun whose patches the photo shows, if it shows any: a direction of an r^2 of at least
/// `min_explained`, from enough pairs, with patches.
pub fn find_sun(room: &SunlitRoom, windows: &[SunWindow], min_explained: f64) -> Option<FoundSun> {
    let search = Search::new(room, windows);
    let is_plain = |r2: f64| {
        r2 >= min_explained
            && r2 * search.pairs.iter().map(Vec::len).sum::<usize>() as f64 >= TUNING.least_evidence
    };
    let explained = |d: Vec3| search.sunlight(d).explained();
    let (explained, direction) = search.direction(explained).filter(|(r2, _)| is_plain(*r2))?;
    let possible = search.possible(direction);
    let (coarse, kappa) = search.patches(direction, &possible);
    if !search.is_sunlight(direction, &coarse, explained) {
        return None;
    }
    let pairs = (&search.pairs[1][..], TUNING.reach, TUNING.one_paint);
    let ratio = edge_ratio(&search.cells, pairs, &coarse, (direction, search.black, kappa));
    let lit = search.refined(direction, &coarse, kappa);
    Some(search.found((explained, direction), ratio, lit))
}

/// The sun that lights the pixels of `drawn`, a mask of the photo's size; `None` where no direction
/// through a window reaches them. `explained` is the r^2 with the drawing.
pub fn drawn_sun(room: &SunlitRoom, windows: &[SunWindow], drawn: &Mask) -> Option<FoundSun> {
    let mut search = Search::new(room, windows);
    let means = Picture(drawn.0.map(Vec3::splat)).blocks(TUNING.stride).0;
    let drawn = means.map(|mean| mean.x >= 0.5);
    let cells = search.cells.0.pixels().iter().zip(drawn.pixels());
    let lit: Vec<Option<Cell>> = cells.map(|(cell, drawn)| cell.filter(|_| *drawn)).collect();
    search.steps = Steps::from_dark(lit.iter().map(|lit| f32::from(u8::from(lit.is_some()))));
    let lit: Vec<Cell> = lit.into_iter().flatten().collect();
    let score = |d: Vec3| {
        let reached = lit.iter().filter(|cell| search.can_reach(cell, d)).count();
        let reached = reached as f64 / lit.len().max(1) as f64;
        (TUNING.by_chance + search.sunlight(d).explained()) * reached * reached
    };
    let (_, direction) = search.direction(score)?;
    let explained = search.sunlight(direction).explained();
    let left =
        |kappa: f32| variation(&search.pairs[0], &steps(&search.cells, direction, kappa), &drawn);
    let kappa = TUNING.ratios.into_iter().min_by(|a, b| left(*a).total_cmp(&left(*b)))?;
    let lit = search.refined(direction, &drawn, kappa);
    // The drawing determines which edges are the sun's: all of their pixels count.
    let (pixels, reach) = (Cells::new(room, 1, search.black), 2 * TUNING.stride);
    let is_lit = lit.map(|lit| lit >= 0.5);
    let strength = (direction, search.black, kappa);
    let ratio = edge_ratio(&pixels, (&pixels.pairs(reach), reach, 0.0), &is_lit, strength);
    Some(search.found((explained, direction), ratio, lit))
}

struct Search<'a> {
    room: &'a SunlitRoom<'a>,
    windows: Vec<(&'a SunWindow<'a>, Own, Vec3)>,
    /// Luminance that counts as black.
    black: f32,
    cells: Cells,
    /// Pairs of neighbors, and pairs `TUNING.reach` cells apart.
    pairs: [Vec<Pair>; 2],
    /// The steps of all pairs.
    steps: Steps,
    /// The largest opening that each window may have.
    openings: Vec<[f32; 4]>,
}

/// The largest opening that a window may have: its rectangle, and more where a whole side of it
/// lies out of view. Distances of the sides at -x, x, -y and y from its center, in half edges.
fn largest_opening(window: &Window, mesh: &SceneMesh) -> [f32; 4] {
    let Window { center, x, y, .. } = window;
    [(-x, y), (*x, y), (-y, x), (*y, x)].map(|(outward, along)| {
        let beyond = |meters: f32| 1.0 + meters / outward.length();
        let side = *center + outward * beyond(TUNING.out_of_view);
        match [-1.0, 0.0, 1.0].iter().any(|&at| mesh.in_view(side + along * at)) {
            true => 1.0,
            false => beyond(TUNING.beyond),
        }
    })
}

/// A place lies within an opening; both in half edges from the center of a window.
fn is_inside(place: Vec2, [left, right, below, above]: [f32; 4]) -> bool {
    (-left..=right).contains(&place.x) && (-below..=above).contains(&place.y)
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
        let steps = Steps::new(cells.0.len(), pairs.iter().flatten());
        let openings = windows.iter().map(|w| largest_opening(&w.window, room.mesh)).collect();
        let windows = windows.iter().map(window).collect();
        Search { room, windows, black, cells, pairs, steps, openings }
    }

    /// Point at which the line from `from` towards the sun meets the plane of window `k`, with its
    /// place in half edges from the center: -1..=1 within the rectangle.
    fn crossing(&self, k: usize, from: Vec3, direction: Vec3) -> Option<(Vec3, Vec2)> {
        let (SunWindow { window, .. }, _, normal) = &self.windows[k];
        let along = normal.dot(direction);
        let distance = normal.dot(window.center - from) / along;
        if along > -1e-3 || distance <= 0.0 {
            return None;
        }
        let at = from + direction * distance;
        let place = |edge: Vec3| (at - window.center).dot(edge) / edge.length_squared();
        Some((at, Vec2::new(place(window.x), place(window.y))))
    }

    fn lifted(&self, cell: &Cell) -> Vec3 {
        cell.point + cell.normal * self.room.mesh.offset(cell.point)
    }

    /// Places in half edges at which the light of the sun in this direction passes the plane of
    /// window `k`, for the cells that it reaches through the largest opening.
    fn places(&self, k: usize, direction: Vec3) -> Vec<Option<Vec2>> {
        let place = |cell: &Option<Cell>| {
            let cell = cell.as_ref().filter(|cell| cell.normal.dot(direction) > 0.0)?;
            let from = self.lifted(cell);
            let (at, place) = self.crossing(k, from, direction)?;
            if !is_inside(place, self.openings[k]) {
                return None;
            }
            let sight = || self.room.mesh.visibility(from, at, Some(&self.windows[k].1));
            let is_lit = match is_inside(place, [1.0; 4]) {
                true => sight() == Sight::Lit,
                false => !self.room.mesh.in_view(at) && sight() != Sight::Blocked,
            };
            is_lit.then_some(place)
        };
        self.cells.0.pixels().iter().map(place).collect()
    }

    /// The sunlight from this direction through the windows' openings, of which those that explain
    /// most.
    fn sunlight(&self, direction: Vec3) -> Sunlight<'_> {
        let places: Vec<Vec<Option<Vec2>>> =
            (0..self.windows.len()).map(|k| self.places(k, direction)).collect();
        let cosine = |i: usize| self.cells.0.pixels()[i].map_or(0.0, |c| c.normal.dot(direction));
        let passes = |k: usize, i: usize, opening| {
            places[k][i].is_some_and(|place| is_inside(place, opening))
        };
        let through = |openings: &[[f32; 4]]| {
            let mut light = Sunlight::none(&self.steps);
            for i in 0..light.light().len() {
                if openings.iter().enumerate().any(|(k, &opening)| passes(k, i, opening)) {
                    light.add(i, cosine(i));
                }
            }
            light
        };
        let rectangles = vec![[1.0; 4]; self.windows.len()];
        let light = through(&rectangles);
        // Windows through which light may pass beside the rectangle; the others stay as they are.
        let goes_on = |places: &Vec<Option<Vec2>>| {
            places.iter().flatten().any(|&place| !is_inside(place, [1.0; 4]))
        };
        let goes_on: Vec<usize> = (0..places.len()).filter(|&k| goes_on(&places[k])).collect();
        if goes_on.is_empty() {
            return light;
        }
        let mut openings = match through(&self.openings).explained() > light.explained() {
            true => self.openings.clone(),
            false => rectangles,
        };
        for side in [0, 1, 2, 3].repeat(TUNING.rounds) {
            for &k in goes_on.iter().filter(|&&k| self.openings[k][side] > 1.0) {
                openings[k][side] = 1.0;
                let mut light = through(&openings);
                let mut best = (light.explained(), 1.0);
                openings[k][side] = self.openings[k][side];
                let outward = |place: Vec2| [-place.x, place.x, -place.y, place.y][side];
                let mut further: Vec<(f32, usize)> = (0..light.light().len())
                    .filter(|&i| light.light()[i] == 0.0 && passes(k, i, openings[k]))
                    .filter_map(|i| Some((outward(places[k][i]?), i)))
                    .collect();
                further.sort_by(|a, b| a.0.total_cmp(&b.0));
                for (size, i) in further {
                    light.add(i, cosine(i));
                    if light.explained() > best.0 {
                        best = (light.explained(), size);
                    }
                }
                openings[k][side] = best.1;
            }
        }
        through(&openings)
    }

    /// The direction of the highest score above 0, with the score.
    fn direction(&self, score: impl Fn(Vec3) -> f64 + Sync) -> Option<(f64, Vec3)> {
        let seen = |d: &Vec3| {
            self.windows.iter().any(|(_, _, normal)| -normal.dot(*d) > TUNING.grazing)
                && d.dot(self.room.up) > TUNING.lowest
        };
        let score = |directions: Vec<Vec3>| -> Vec<(f64, Vec3)> {
            directions.into_par_iter().map(|d| (score(d), d)).collect()
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
        best.first().copied().filter(|(score, _)| *score > 0.0)
    }

    /// Whether the sun can reach a cell: nothing in view is between, and the light passes a window
    /// or what the photo does not show of its wall.
    fn can_reach(&self, cell: &Cell, direction: Vec3) -> bool {
        let from = self.lifted(cell);
        cell.normal.dot(direction) > TUNING.least_cosine
            && (0..self.windows.len()).any(|k| {
                self.crossing(k, from, direction).is_some_and(|(at, place)| {
                    let own = Some(&self.windows[k].1);
                    (is_inside(place, [TUNING.growth; 4]) || !self.room.mesh.in_view(at))
                        && self.room.mesh.visibility(from, at, own) != Sight::Blocked
                })
            })
    }

    /// Cells that the sun can reach.
    fn possible(&self, direction: Vec3) -> Vec<bool> {
        let can_reach = |cell: &Cell| self.can_reach(cell, direction);
        self.cells.0.pixels().iter().map(|cell| cell.as_ref().is_some_and(can_reach)).collect()
    }

    /// Lit cells, and the ratio of the sun to the other light.
    fn patches(&self, direction: Vec3, possible: &[bool]) -> (Plane<bool>, f32) {
        let [pairs, _] = &self.pairs;
        let predicted = self.sunlight(direction);
        let predicted = predicted.light();
        let gain = |(&possible, &predicted): (&bool, &f32)| match possible {
            true if predicted > 0.0 => TUNING.predicted,
            true => -TUNING.cost,
            false => -TUNING.certain,
        };
        let gain: Vec<f32> = possible.iter().zip(predicted).map(gain).collect();
        let try_ratio = |kappa: f32| {
            let step = steps(&self.cells, direction, kappa);
            let lit = cut(&self.cells, pairs, &step, gain.clone());
            let lit = kept(&self.cells, pairs, &step, predicted, &lit);
            let cost = TUNING.cost * lit.pixels().iter().filter(|&&lit| lit).count() as f32;
            (variation(pairs, &step, &lit) + f64::from(cost), lit, kappa)
        };
        let all: Vec<_> = TUNING.ratios.into_par_iter().map(try_ratio).collect();
        let least = all.into_iter().reduce(|a, b| if b.0 < a.0 { b } else { a });
        least.map(|(_, lit, kappa)| (lit, kappa)).expect("ratios are tried")
    }

    /// The patches explain the photo nearly as well as the openings do, `explained`, and the steps
    /// between neighbors are as high over their edges as those of the faintest sun: light of the
    /// sky or of a lamp has soft edges.
    fn is_sunlight(&self, direction: Vec3, patches: &Plane<bool>, explained: f64) -> bool {
        let step = steps(&self.cells, direction, TUNING.ratios[0]);
        let lit: Vec<usize> = (0..step.len()).filter(|&i| patches.pixels()[i]).collect();
        let mut light = Sunlight::none(&self.steps);
        lit.iter().for_each(|&i| light.add(i, step[i]));
        let (mut got, mut expected) = (0.0, 0.0);
        for pair in &self.pairs[0] {
            let [a, b] = pair.cells.map(|i| f64::from(light.light()[i]));
            got += f64::from(pair.weight) * pair.limited_step() * (a - b);
            expected += f64::from(pair.weight) * (a - b).powi(2);
        }
        lit.len() as f32 <= TUNING.most_lit * step.len() as f32
            && expected > 0.0
            && light.explained() >= TUNING.least_agreement * explained
            && got >= TUNING.least_step * expected
    }

    /// Lit fractions of the pixels: near the edges of the patches the cut again for each pixel,
    /// with mixed pixels at its edge.
    fn refined(&self, direction: Vec3, patches: &Plane<bool>, kappa: f32) -> Plane<f32> {
        let pixels = Cells::new(self.room, 1, self.black);
        let (w, h) = pixels.0.size();
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
        let faces = |i: usize| pixels.0.pixels()[i].is_some_and(|c| c.normal.dot(direction) > 0.0);
        let lit = |i: usize| if lit.pixels()[i] && faces(i) { 1.0 } else { 0.0 };
        let mask = Plane::new(w, h, (0..w * h).map(lit).collect());
        alpha_matte(&mask, self.room.photo).alpha
    }

    /// The sun of this r^2 and direction, which lights these fractions of the pixels.
    fn found(&self, (explained, direction): (f64, Vec3), ratio: Vec3, lit: Plane<f32>) -> FoundSun {
        let mut through = vec![lit.map(|_| 0.0); self.windows.len()];
        for (i, &lit) in lit.pixels().iter().enumerate().filter(|(_, lit)| **lit > 0.0) {
            let window = self.window_of(self.room.points.0.pixels()[i], direction);
            through[window].pixels_mut()[i] = lit;
        }
        FoundSun { direction, ratio, lit: through, explained }
    }

    /// Index of the window whose rectangle the sunlight at `point` passes, or passes nearest.
    fn window_of(&self, point: Vec3, direction: Vec3) -> usize {
        let outside = |k: &usize| {
            let crossing = self.crossing(*k, point, direction);
            crossing.map_or(f32::MAX, |(_, place)| place.abs().max_element())
        };
        let windows = 0..self.windows.len();
        windows.min_by(|a, b| outside(a).total_cmp(&outside(b))).unwrap_or(0)
    }
}

/// Step of log luminance between sun and shade at each cell.
fn steps(cells: &Cells, direction: Vec3, kappa: f32) -> Vec<f32> {
    let step = |cell: &Option<Cell>| {
        cell.map_or(0.0, |cell| (kappa * cell.normal.dot(direction).max(0.0)).ln_1p())
    };
    cells.0.pixels().iter().map(step).collect()
}

/// Median ratio of the sun to the other light over the edges of the patches, per channel; `kappa`
/// without an edge. The `pairs` are `reach` cells apart, of one paint by `least_weight`, and a cell
/// away from the edge, where cells are mixed.
fn edge_ratio(
    cells: &Cells,
    (pairs, reach, least_weight): (&[Pair], usize, f32),
    lit: &Plane<bool>,
    (direction, black, kappa): (Vec3, f32, f32),
) -> Vec3 {
    let lit = lit.pixels();
    let mut ratios: [Vec<f32>; 3] = Default::default();
    for &Pair { cells: [a, b], weight, .. } in pairs {
        let next = (b - a) / reach;
        if weight < least_weight
            || lit[a] == lit[b]
            || lit[a] != lit[a + next]
            || lit[b] != lit[b - next]
        {
            continue;
        }
        let (sun, shade) = if lit[a] { (a, b) } else { (b, a) };
        let (Some(sun), Some(shade)) = (&cells.0.pixels()[sun], &cells.0.pixels()[shade]) else {
            continue;
        };
        let cosine = sun.normal.dot(direction).max(TUNING.least_cosine);
        let ratio = (sun.rgb / shade.rgb.max(Vec3::splat(black)) - 1.0) / cosine;
        (0..3).for_each(|k| ratios[k].push(ratio[k]));
    }
    let of_channel = |ratios: Vec<f32>| match ratios.is_empty() {
        true => kappa,
        false => median(ratios).max(0.0),
    };
    Vec3::from_array(ratios.map(of_channel))
}

/// Variation of the log luminance without the sun.
fn variation(pairs: &[Pair], step: &[f32], lit: &Plane<bool>) -> f64 {
    let sun = |i: usize| if lit.pixels()[i] { step[i] } else { 0.0 };
    let left = |p: &Pair| f64::from(p.weight * (p.step - sun(p.cells[0]) + sun(p.cells[1])).abs());
    pairs.iter().map(left).sum()
}

/// The labels of least variation. `gain` is that of a lit cell.
fn cut(cells: &Cells, pairs: &[Pair], step: &[f32], mut gain: Vec<f32>) -> Plane<bool> {
    let (w, h) = cells.0.size();
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

/// The patches that a window's opening predicts and whose edges have enough contrast, and large
/// ones of like contrast.
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
    let is_predicted = |k: &usize| patches[*k].iter().any(|&i| predicted[i] > 0.0);
    let is_plain = |k: &usize, least: f32| {
        let (count, got, expected) = edges[*k];
        count >= TUNING.least_edge && got >= least * expected
    };
    let (known, others): (Vec<usize>, Vec<usize>) = (0..patches.len()).partition(is_predicted);
    let contrast = TUNING.least_contrast;
    let mut kept: Vec<usize> = known.into_iter().filter(|k| is_plain(k, contrast)).collect();
    let (got, expected) =
        kept.iter().fold((0.0, 0.0), |sum, &k| (sum.0 + edges[k].1, sum.1 + edges[k].2));
    if expected > 0.0 {
        let contrast = contrast.max(TUNING.alike * got / expected);
        let is_large = |k: &usize| patches[*k].len() >= TUNING.least_area;
        kept.extend(others.into_iter().filter(|k| is_large(k) && is_plain(k, contrast)));
    }
    let lit = patch_of.into_iter().map(|patch| patch.is_some_and(|k| kept.contains(&k))).collect();
    Plane::new(cells.0.width(), cells.0.height(), lit)
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
    use crate::image::{Normal, Points};

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
        let window = Window { center, x, y, lobes: Window::daylight(Vec3::X, Vec3::Y) };
        let mask = Mask(points.0.map(|p| {
            let inside = (p.z - center.z).abs() < 0.8 && (p.y - center.y).abs() < 0.6;
            if p.x < -1.98 && inside { 1.0 } else { 0.0 }
        }));
        let outside = mask.0.map(|m| m > 0.5);
        let mesh = SceneMesh::new(&points, camera.fx, 1e-4, &Plane::filled(SIZE.0, SIZE.1, false));
        Room { points, normal, mesh, window, mask, outside }
    }

    impl Room {
        /// Whether light from `direction` reaches the pixel through a window of this center and
        /// half edges in the left wall.
        fn is_lit(&self, [center, x, y]: [Vec3; 3], pixel: usize, direction: Vec3) -> bool {
            let (point, normal) = (self.points.0.pixels()[pixel], self.normal.0.pixels()[pixel]);
            let distance = (center.x - point.x) / direction.x;
            let at = point + direction * distance - center;
            normal.dot(direction) > 0.0
                && distance > 0.01
                && at.dot(x).abs() < x.length_squared()
                && at.dot(y).abs() < y.length_squared()
        }

        /// Its rectangle: center and half edges.
        fn rectangle(&self) -> [Vec3; 3] {
            [self.window.center, self.window.x, self.window.y]
        }

        /// The photo of the room under even light and a sun that is `kappa` times as bright, with
        /// stripes of brown paint on the floor.
        fn photo(&self, direction: Vec3, kappa: f32) -> Picture {
            self.photo_of(|i| match self.is_lit(self.rectangle(), i, direction) {
                true => kappa * self.normal.0.pixels()[i].dot(direction),
                false => 0.0,
            })
        }

        /// The same under other light, over the even light at each pixel.
        fn photo_of(&self, other: impl Fn(usize) -> f32) -> Picture {
            let pixel = |i: usize| {
                let (point, normal) = (self.points.0.pixels()[i], self.normal.0.pixels()[i]);
                let striped = normal == Vec3::Y && (point.x * 2.0).rem_euclid(1.0) < 0.3;
                let albedo = if striped { Vec3::new(0.5, 0.3, 0.15) } else { Vec3::splat(0.6) };
                albedo * (0.3 + 0.3 * other(i))
            };
            Picture(Plane::new(SIZE.0, SIZE.1, (0..SIZE.0 * SIZE.1).map(pixel).collect()))
        }

        /// Intersection over union of the pixels that were found and those for which `is_lit`
        /// holds.
        fn overlap(&self, lit: &Plane<f32>, is_lit: impl Fn(usize) -> bool) -> f32 {
            let (mut both, mut either) = (0.0, 0.0);
            for (i, &lit) in lit.pixels().iter().enumerate() {
                let wanted = f32::from(u8::from(is_lit(i) && !self.outside.pixels()[i]));
                both += lit.min(wanted);
                either += lit.max(wanted);
            }
            both / either
        }

        fn find(&self, photo: &Picture) -> Option<FoundSun> {
            self.with(photo, |room, windows| find_sun(room, windows, 0.0))
        }

        fn with<T>(&self, photo: &Picture, find: impl Fn(&SunlitRoom, &[SunWindow]) -> T) -> T {
            let Room { points, normal, mesh, outside, .. } = self;
            let windows = [SunWindow { window: self.window.clone(), mask: &self.mask }];
            let room = SunlitRoom { photo, points, normal, mesh, outside, up: Vec3::Y };
            find(&room, &windows)
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
            let overlap =
                room.overlap(&found.lit[0], |i| room.is_lit(room.rectangle(), i, direction));
            assert!(overlap > 0.9, "intersection over union {overlap}");
        }
    }

    /// A faint sun, which no search would find, drawn two pixels beside its place.
    #[test]
    fn a_drawn_sun_has_its_direction_its_strength_and_the_edges_of_the_photo() {
        let room = room();
        let direction = Vec3::new(-0.7, 0.6, -0.1).normalize();
        let photo = room.photo(direction, 0.5);
        assert!(room.find(&photo).is_none(), "it is as faint as that");
        let is_lit = |i: usize| room.is_lit(room.rectangle(), i, direction);
        let beside = |x: usize, y: usize| is_lit((y.max(2) - 2) * SIZE.0 + x.max(2) - 2);
        let drawn = Mask(Plane::from_fn(SIZE.0, SIZE.1, |x, y| f32::from(u8::from(beside(x, y)))));
        let found = room.with(&photo, |seen, windows| drawn_sun(seen, windows, &drawn));
        let found = found.expect("it is drawn");
        let angle = found.direction.angle_between(direction).to_degrees();
        assert!(angle < 4.0, "{angle} degrees off");
        let off = (found.ratio - 0.5).abs().max_element();
        assert!(off < 0.05, "ratio {}", found.ratio);
        let [before, after] = [&drawn.0, &found.lit[0]].map(|lit| room.overlap(lit, is_lit));
        assert!(before < 0.85 && after > 0.95, "intersection over union {before} -> {after}");
    }

    #[test]
    fn what_no_window_can_light_has_no_drawn_sun() {
        let room = room();
        let wall = Mask(room.points.0.map(|p| f32::from(u8::from(p.x < -1.98 && p.z > -2.0))));
        let photo = room.photo(Vec3::NEG_X, 0.0);
        assert!(room.with(&photo, |seen, windows| drawn_sun(seen, windows, &wall)).is_none());
    }

    #[test]
    fn a_sun_is_found_that_shines_through_a_part_of_the_window_out_of_view() {
        let room = room();
        // The window goes on to the camera.
        let [center, x, y] = room.rectangle();
        let whole = [center - x.normalize() * 1.2, x + x.normalize() * 1.2, y];
        let direction = Vec3::new(-0.7, 0.5, 0.35).normalize();
        let is_lit = |i: usize| room.is_lit(whole, i, direction);
        let seen = |i: &usize| room.is_lit(room.rectangle(), *i, direction);
        let lit: Vec<usize> = (0..SIZE.0 * SIZE.1).filter(|&i| is_lit(i)).collect();
        assert!(2 * lit.iter().filter(|i| seen(i)).count() < lit.len(), "most is out of view");
        let photo = room.photo_of(|i| match is_lit(i) {
            true => 2.0 * room.normal.0.pixels()[i].dot(direction),
            false => 0.0,
        });
        let found = room.find(&photo).expect("there is a sun");
        let angle = found.direction.angle_between(direction).to_degrees();
        assert!(angle < 3.0, "{angle} degrees off");
        let overlap = room.overlap(&found.lit[0], is_lit);
        assert!(overlap > 0.9, "intersection over union {overlap}");
    }

    #[test]
    fn light_with_soft_edges_is_no_sun() {
        let room = room();
        let direction = Vec3::new(-0.7, 0.6, -0.1).normalize();
        // The mean of windows around the true one: an edge of 1 m.
        let [center, x, y] = room.rectangle();
        let shifts: Vec<Vec3> = (-5..=5)
            .flat_map(|a| (-5..=5).map(move |b| 0.1 * (a as f32 * Vec3::Z + b as f32 * Vec3::Y)))
            .collect();
        let soft = |i: usize| {
            let through = |shift: &&Vec3| room.is_lit([center + **shift, x, y], i, direction);
            let lit = shifts.iter().filter(through).count() as f32 / shifts.len() as f32;
            2.0 * lit * room.normal.0.pixels()[i].dot(direction).max(0.0)
        };
        assert!(room.find(&room.photo_of(soft)).is_none());
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
