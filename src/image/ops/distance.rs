//! Distances in a picture.

use crate::image::Plane;

/// Distance of each pixel from `core`, in pixels, to a few per cent: Borgefors' chamfer (1986) with
/// steps 1 and sqrt 2.
pub fn distance(core: &Plane<bool>) -> Plane<f32> {
    let (w, h) = core.size();
    let mut away = core.map(|inside| if inside { 0.0 } else { f32::MAX });
    if core.is_empty() {
        return away;
    }
    let mut rows: Vec<&mut [f32]> = away.pixels_mut().chunks_exact_mut(w).collect();
    for y in 0..h {
        let (above, below) = rows.split_at_mut(y);
        let row = &mut *below[0];
        if let Some(near) = above.last() {
            relax(row, near);
        }
        (1..w).for_each(|x| shorten(row, x, row[x - 1] + 1.0));
    }
    for y in (0..h).rev() {
        let (above, below) = rows.split_at_mut(y + 1);
        let row = &mut *above[y];
        if let Some(near) = below.first() {
            relax(row, near);
        }
        (1..w).rev().for_each(|x| shorten(row, x - 1, row[x] + 1.0));
    }
    away
}

/// Shortens one distance. A branch: pixels that keep theirs do not wait for the one before them.
fn shorten(row: &mut [f32], x: usize, away: f32) {
    if away < row[x] {
        row[x] = away;
    }
}

/// Shortens the distances of a row by steps from the row beside it.
fn relax(row: &mut [f32], near: &[f32]) {
    const DIAGONAL: f32 = std::f32::consts::SQRT_2;
    let behind = |row: &mut [f32], near: &[f32], step: f32| {
        row.iter_mut().zip(near).for_each(|(away, near)| *away = away.min(near + step));
    };
    behind(row, near, 1.0);
    behind(&mut row[1..], near, DIAGONAL);
    behind(row, &near[1..], DIAGONAL);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every pixel by its four neighbors that were visited before it.
    fn slow(core: &Plane<bool>) -> Plane<f32> {
        let (w, h) = core.size();
        let mut away = core.map(|inside| if inside { 0.0 } else { f32::MAX });
        let mut relax = |x: usize, y: usize, sign: isize| {
            for (dx, dy, step) in [
                (-1, 0, 1.0),
                (0, -1, 1.0),
                (-1, -1, std::f32::consts::SQRT_2),
                (1, -1, std::f32::consts::SQRT_2),
            ] {
                let near = (x.checked_add_signed(sign * dx), y.checked_add_signed(sign * dy));
                if let (Some(nx), Some(ny)) = near
                    && nx < w
                    && ny < h
                {
                    away.set(x, y, away.get(x, y).min(away.get(nx, ny) + step));
                }
            }
        };
        (0..w * h).for_each(|i| relax(i % w, i / w, 1));
        (0..w * h).rev().for_each(|i| relax(i % w, i / w, -1));
        away
    }

    #[test]
    fn rows_give_what_single_pixels_give() {
        for (w, h) in [(1, 1), (1, 9), (9, 1), (2, 2), (37, 23)] {
            for step in [2, 7, 31, 1000] {
                let core = Plane::from_fn(w, h, |x, y| (x * 5 + y * 11) % step == 1);
                assert_eq!(distance(&core), slow(&core), "{w} x {h}, every {step}");
            }
        }
    }

    #[test]
    fn distances_are_euclidean_to_eight_per_cent() {
        let mut core = Plane::filled(40, 30, false);
        core.set(12, 9, true);
        let away = distance(&core);
        for (x, y) in (0..40).flat_map(|x| (0..30).map(move |y| (x, y))) {
            let exact = (x as f32 - 12.0).hypot(y as f32 - 9.0);
            // The octagon of the chamfer lies at most 1 / cos(22.5 degrees) = 1.082 outside the
            // circle.
            assert!(
                away.get(x, y) >= exact - 1e-3 && away.get(x, y) <= 1.083 * exact + 1e-3,
                "({x}, {y})"
            );
        }
        assert!(distance(&Plane::filled(3, 3, false)).pixels().iter().all(|d| *d > 1e30));
    }
}
