//! Faint edges: steps of the photo that do not stand out between two pixels, such as that between a
//! white wall and a white ceiling, and that a mean over several pixels shows.
//!
//! With m(d) the mean of the log intensity at d pixels from a side between two pixels, and over
//! some pixels along that side, the step is m(+near) - m(-near) less what the slopes between near
//! and far on its two sides predict: light that changes evenly is not an edge, nor is the shoulder
//! of one. The step is the smaller of two, one to each direction along the side; an edge is where
//! it is largest across the side.

use glam::Vec3;

use crate::image::{Plane, intensity_and_chroma};
use crate::tuning::tuning;

tuning! {
    /// Constants of faint edges.
    pub const TUNING: FaintEdgesTuning {
        /// Least log step of intensity.
        step: f32 = 0.12,
            unit "1", source Measured("the ceilings of eight photographs, 0.2; no difference from 0.08 to 0.12"),
            effect "a smaller value finds edges of soft shadows";
        /// Pixels to each side along an edge, and the one between, in a mean.
        along: usize = 3,
            unit "pixels", source Measured("walls of eight photographs: no difference to 5"),
            effect "a larger value finds fainter edges, and fewer that are slanted";
        /// Distances of the means on each side.
        near_and_far: [usize; 2] = [2, 6],
            unit "pixels", source Taste, effect "larger values find more blurred edges, and miss narrow surfaces";
        /// Fraction of the change between near and far, on both sides, that is predicted for the
        /// step; and largest ratio of that change to the step.
        slope: f32 = 0.5,
            unit "1", source Measured("walls of eight photographs"),
            effect "a larger value takes the light of a lamp for an edge";
        /// Distance within which the step of an edge is the largest.
        apart: usize = 3,
            unit "pixels", source Taste, effect "a larger value finds one of two edges side by side";
    }
}

/// The sides between pixels at which a photo has a faint edge.
pub struct FaintEdges {
    /// Between a pixel and the next one in its row.
    beside: Plane<bool>,
    /// Between a pixel and the next one in its column.
    below: Plane<bool>,
}

impl FaintEdges {
    /// Finds those of `seen`, the logarithm of the photo, whose relative noise is `noise`.
    pub fn find(seen: &Plane<Vec3>, noise: &Plane<Vec3>) -> FaintEdges {
        let level = seen.map(|color| intensity_and_chroma(color).0);
        let least = noise.map(|noise| {
            let count = 2 * (TUNING.along + 1);
            TUNING.step.max(noise.max_element() * (2.0 / count as f32).sqrt())
        });
        let below = in_rows(&transposed(&level), &transposed(&least));
        FaintEdges { beside: in_rows(&level, &least), below: transposed(&below) }
    }

    /// Whether a faint edge is between two neighbors.
    pub fn between(&self, a: usize, b: usize) -> bool {
        let width = self.beside.width();
        let edges = if a / width == b / width { &self.beside } else { &self.below };
        edges.pixels()[a.min(b)]
    }
}

/// Whether a faint edge is between each pixel and the next one in its row, of which at least the
/// log step `least` is asked.
fn in_rows(level: &Plane<f32>, least: &Plane<f32>) -> Plane<bool> {
    let (w, h) = level.size();
    // Mean over a row and those above it.
    let above = Plane::from_fn(w, h, |x, y| {
        let rows = y.saturating_sub(TUNING.along)..y + 1;
        let count = rows.len() as f32;
        rows.map(|y| level.get(x, y)).sum::<f32>() / count
    });
    // An edge is there above a row and below it, so that it ends at corners.
    let halves = |y: usize| [y, (y + TUNING.along).min(h - 1)];
    let [near, far] = TUNING.near_and_far;
    let predicted = 2.0 * near as f32 / (far - near) as f32;
    let step = |x: usize, y: usize| {
        if x + 1 < near || x + 1 + near > w {
            return 0.0;
        }
        let at = |x: usize| 0.5 * (above.get(x.min(w - 1), y) + above.get((x - 1).min(w - 1), y));
        let left = [near, far].map(|away| at((x + 1).saturating_sub(away).max(1)));
        let right = [near, far].map(|away| at(x + 1 + away));
        let step = right[0] - left[0];
        let slopes = [left[0] - left[1], right[1] - right[0]].map(|slope| predicted * slope);
        let steepest = slopes[0].abs().max(slopes[1].abs());
        let is_edge = steepest < TUNING.slope * step.abs();
        if is_edge { step - TUNING.slope * (slopes[0] + slopes[1]) } else { 0.0 }
    };
    let steps = Plane::from_fn(w, h, |x, y| {
        let [a, b] = halves(y).map(|y| step(x, y));
        if a * b > 0.0 { a.abs().min(b.abs()) } else { 0.0 }
    });
    // Steps over three sides of a sharp edge are equal.
    let peak = |x: usize, y: usize| {
        let next = (x + 1).min(w - 1);
        let [a, b] = halves(y).map(|y| (above.get(next, y) - above.get(x, y)).abs());
        steps.get(x, y) + 0.5 * (a + b)
    };
    Plane::from_fn(w, h, |x, y| {
        let mut around = x.saturating_sub(TUNING.apart)..(x + TUNING.apart + 1).min(w);
        steps.get(x, y) > least.get(x, y) && around.all(|other| peak(other, y) <= peak(x, y))
    })
}

fn transposed<T: Copy>(plane: &Plane<T>) -> Plane<T> {
    Plane::from_fn(plane.height(), plane.width(), |x, y| plane.get(y, x))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (40, 30);
    const NONE: [Vec<usize>; 2] = [vec![], vec![]];

    fn edges(level: impl Fn(usize, usize) -> f32, noise: f32) -> FaintEdges {
        let seen = Plane::from_fn(SIZE.0, SIZE.1, |x, y| Vec3::splat(level(x, y)));
        FaintEdges::find(&seen, &Plane::filled(SIZE.0, SIZE.1, Vec3::splat(noise)))
    }

    /// The sides in row 15, and in column 20, that are edges.
    fn sides(edges: &FaintEdges) -> [Vec<usize>; 2] {
        let at = |x: usize, y: usize| y * SIZE.0 + x;
        [
            (0..SIZE.0 - 1).filter(|&x| edges.between(at(x, 15), at(x + 1, 15))).collect(),
            (0..SIZE.1 - 1).filter(|&y| edges.between(at(20, y), at(20, y + 1))).collect(),
        ]
    }

    #[test]
    fn a_faint_step_is_an_edge_and_light_that_changes_evenly_is_not() {
        // A step of 0.2 over three pixels, up or down.
        let ramp = |d: isize| 0.2 / 3.0 * d.clamp(0, 3) as f32;
        assert_eq!(sides(&edges(|x, _| ramp(x as isize - 10), 0.0)), [vec![11], vec![]]);
        assert_eq!(sides(&edges(|_, y| -ramp(y as isize - 10), 0.0)), [vec![], vec![11]]);
        for slope in [0.01, 0.05, 0.2] {
            assert_eq!(sides(&edges(|x, y| slope * (x + y) as f32, 0.0)), NONE);
        }
        assert_eq!(sides(&edges(|x, _| ramp(x as isize - 10) / 2.0, 0.0)), NONE);
    }

    #[test]
    fn an_edge_ends_at_a_corner() {
        let inside = |x: usize, y: usize| x < 20 && y < 15;
        let edges = edges(|x, y| if inside(x, y) { 0.2 } else { 0.0 }, 0.0);
        let upright: Vec<usize> =
            (0..SIZE.1).filter(|y| edges.between(y * SIZE.0 + 19, y * SIZE.0 + 20)).collect();
        // Of the last four rows, less than three fifths are beside the step.
        assert_eq!(upright, Vec::from_iter(0..13));
    }

    #[test]
    fn a_step_within_the_noise_of_its_mean_is_not_an_edge() {
        let step = |x: usize, _: usize| if x < 20 { 0.0 } else { 0.2 };
        assert_eq!(sides(&edges(step, 0.35))[0], [19]);
        assert_eq!(sides(&edges(step, 0.45))[0], NONE[0]);
    }

    #[test]
    fn planes_of_a_few_pixels_have_no_edge() {
        for (w, h) in [(1, 1), (1, 9), (2, 3), (9, 1)] {
            let seen = Plane::from_fn(w, h, |x, y| Vec3::splat((x + y) as f32));
            let edges = FaintEdges::find(&seen, &Plane::filled(w, h, Vec3::ZERO));
            assert!((1..h).all(|y| !edges.between((y - 1) * w, y * w)), "{w} x {h}");
        }
    }
}
