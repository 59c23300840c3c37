//! The border of a depth map that its sensor does not see.
//!
//! A depth camera beside the color camera sees less than the photo on one side. Its map has holes
//! there, or is completed with the last depth of each row: a strip that faces the camera, whatever
//! wall is there.

use crate::image::{Mask, Plane};
use crate::tuning::tuning;

tuning! {
    /// Constants of the padding of a depth map.
    pub const TUNING: PaddingTuning {
        /// Least length of a run of one depth, over the side of the map along it.
        least: f32 = 0.02,
            unit "1", source Measured("depth of six photos of a structured-light camera: 3 to 4 % at the right"),
            effect "a smaller value takes the steps of 8-bit depth for padding";
        /// Least length, whatever the size of the map.
        least_pixels: usize = 4,
            unit "pixels", source Derived("steps of 8-bit depth on a slope"),
            effect "a smaller value takes such steps for padding in small maps";
        /// Largest length, over the side of the map along it.
        most: f32 = 0.06,
            unit "1", source Measured("the same"), effect "a larger value extends walls over things beside them";
        /// Largest length of holes, over the same: planes of the room end somewhere.
        most_holes: f32 = 0.1,
            unit "1", source Derived("the shadow of structured light at 1 m"),
            effect "a larger value extends walls over things beside them";
        /// Least fraction of the rows, or columns, of the map that end in a run.
        lines: f32 = 0.5,
            unit "1", source Measured("the same: 0.55 to 0.93 at the right of five"),
            effect "a smaller value takes flat surfaces at the border for padding";
        /// Least ratio of this fraction to that of runs of the least length farther inwards:
        /// surfaces that face the camera have them everywhere.
        excess: f32 = 2.0,
            unit "1", source Measured("the same: 2.6 to 6.2 at the right, 1.2 to 1.7 at the top, where walls stand upright"),
            effect "a smaller value takes walls for padding";
        /// Least lengths farther inwards that are looked at.
        inside: usize = 5,
            unit "1", source Taste, effect "a larger value compares with surfaces farther away";
    }
}

/// Holes, or pixels of one depth, from the border inwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    /// Its place along the border.
    pub line: usize,
    border: usize,
    inwards: isize,
    /// Number of its pixels.
    pub length: usize,
    /// Number of pixels from this border to the other one.
    pub across: usize,
}

impl Run {
    /// The pixel `k` pixels from the border, row by row.
    pub fn pixel(&self, k: usize) -> usize {
        self.border.wrapping_add_signed(k as isize * self.inwards)
    }
}

/// The padding of a depth map, for each side that has some, in the order of its pixels. `holes` is
/// 1 where the map has no reading and is filled.
///
/// # Panics
/// The sizes differ.
pub fn padding(depth: &Plane<f32>, holes: Option<&Mask>) -> Vec<Vec<Run>> {
    let is_hole = |i: usize| holes.is_some_and(|holes| holes.0.pixels()[i] > 0.5);
    assert!(holes.is_none_or(|holes| holes.0.size() == depth.size()), "one map");
    let (width, height) = depth.size();
    let row = width as isize;
    // The first pixel of the border, the steps along it and inwards, and the numbers of both.
    let sides = [
        (0, row, 1, height, width),
        (width.saturating_sub(1), row, -1, height, width),
        (0, 1, row, width, height),
        ((height.saturating_sub(1)) * width, 1, -row, width, height),
    ];
    let mut found = Vec::new();
    for (first, along, inwards, lines, side) in sides {
        let parts = [TUNING.least, TUNING.most, TUNING.most_holes];
        let [least, most, most_holes] = parts.map(|part| (part * side as f32) as usize);
        let least = least.max(TUNING.least_pixels);
        if side < (TUNING.inside + 1) * least {
            continue;
        }
        let run = |line: usize| Run {
            line,
            border: first.wrapping_add_signed(line as isize * along),
            inwards,
            length: least,
            across: side,
        };
        let constant = |run: &Run, from: usize, end: usize| {
            let depth = |k: usize| depth.pixels()[run.pixel(k)];
            (from..end).take_while(|&k| depth(k) == depth(from)).count()
        };
        let ends =
            |run: &Run, block: usize| constant(run, block * least, (block + 1) * least) == least;
        let all: Vec<Run> = (0..lines).map(run).collect();
        let share =
            |block: usize| all.iter().filter(|run| ends(run, block)).count() as f32 / lines as f32;
        let inside = (1..=TUNING.inside).map(share).sum::<f32>() / TUNING.inside as f32;
        let is_padded = share(0) >= TUNING.lines.max(TUNING.excess * inside);
        let padded = |run: &Run| {
            let holes = (0..side).take_while(|&k| is_hole(run.pixel(k))).count();
            let length = match holes {
                0 if is_padded && ends(run, 0) => constant(run, 0, most),
                0 => return None,
                holes => Some(holes).filter(|holes| *holes <= most_holes)?,
            };
            Some(Run { length, ..*run })
        };
        let runs: Vec<Run> = all.iter().filter_map(padded).collect();
        if !runs.is_empty() {
            found.push(runs);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_one_depth_at_a_side_are_padding() {
        // A slope in steps of two pixels, whose last 7 columns repeat one depth in most rows.
        let slope = |x: usize| 2.0 + 0.01 * (x / 2) as f32;
        let depth = |padded: usize| {
            Plane::from_fn(200, 50, |x, y| {
                slope(if y < padded { x.min(193) } else { x }) + y as f32
            })
        };
        let [runs] = &padding(&depth(40), None)[..] else { panic!("one side has padding") };
        assert_eq!(runs.len(), 40);
        for (y, run) in runs.iter().enumerate() {
            assert_eq!((run.line, run.pixel(0), run.pixel(3)), (y, 200 * y + 199, 200 * y + 196));
            assert!((7..=8).contains(&run.length), "{run:?}");
        }
        assert!(padding(&depth(0), None).is_empty());
        assert!(padding(&depth(20), None).is_empty(), "too few rows");
        // A wall that faces the camera has runs everywhere.
        assert!(padding(&Plane::filled(200, 300, 3.0), None).is_empty());
        for (width, height) in [(0, 0), (1, 1), (3, 2)] {
            assert!(padding(&Plane::filled(width, height, 1.0), None).is_empty());
        }
    }

    #[test]
    fn holes_at_a_side_are_padding_up_to_a_tenth_of_the_map() {
        let depth = Plane::from_fn(100, 80, |x, y| 2.0 + 0.01 * (x + y) as f32);
        let hole = |x: usize, y: usize| match y {
            10..20 => x < 8,
            40..50 => x < 30,
            60 => (50..60).contains(&x),
            _ => false,
        };
        let holes = Mask(Plane::from_fn(100, 80, |x, y| f32::from(u8::from(hole(x, y)))));
        let [runs] = &padding(&depth, Some(&holes))[..] else { panic!("one side has holes") };
        let lines: Vec<(usize, usize)> = runs.iter().map(|run| (run.line, run.length)).collect();
        assert_eq!(lines, (10..20).map(|y| (y, 8)).collect::<Vec<_>>());
    }
}
