//! Distances in a picture.

use crate::image::Plane;

/// Distance of each pixel from `core`, in pixels, to a few per cent: Borgefors' chamfer (1986) with
/// steps 1 and sqrt 2.
pub fn distance(core: &Plane<bool>) -> Plane<f32> {
    let (w, h) = core.size();
    let mut away = Plane::sparse(w, h, |i| if core.pixels()[i] { 0.0 } else { f32::MAX });
    let diagonal = std::f32::consts::SQRT_2;
    let mut relax = |x: usize, y: usize, steps: [(isize, isize, f32); 4]| {
        if core.get(x, y) {
            return;
        }
        let near = steps.into_iter().filter_map(|(dx, dy, step)| {
            let (x, y) = (x.checked_add_signed(dx)?, y.checked_add_signed(dy)?);
            (x < w && y < h).then(|| away.get(x, y) + step)
        });
        let least = near.fold(away.get(x, y), f32::min);
        away.set(x, y, least);
    };
    for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
        relax(x, y, [(-1, 0, 1.0), (0, -1, 1.0), (-1, -1, diagonal), (1, -1, diagonal)]);
    }
    for (x, y) in (0..h).rev().flat_map(|y| (0..w).rev().map(move |x| (x, y))) {
        relax(x, y, [(1, 0, 1.0), (0, 1, 1.0), (1, 1, diagonal), (-1, 1, diagonal)]);
    }
    away
}

#[cfg(test)]
mod tests {
    use super::*;

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
