//! Alpha mattes: the fraction of each pixel that belongs to a masked surface.
//!
//! A pixel at the edge of a surface shows `I = a W + (1 - a) O`, with W the color of the surface
//! beside it and O that of its surroundings. At a hard edge of a mask, a is found from the three by
//! least squares, `a = (I - O).(W - O) / |W - O|^2` (the two-color case of matting, Smith and
//! Blinn, SIGGRAPH 1996); if W and O are similar, or the mask itself is soft, a is the value of the
//! mask.

use glam::Vec3;
use rayon::prelude::*;

use crate::image::{AlphaMatte, Picture, Plane};
use crate::tuning::tuning;

tuning! {
    /// Constants of alpha mattes.
    pub const TUNING: AlphaMatteTuning {
        /// Longer side of a photo whose masks are drawn to one pixel.
        long_side: usize = 1000,
            unit "pixels", source Taste, effect "a smaller value widens the band of estimated alpha";
        /// Radius around a pixel of the band within which the colors of surface and surroundings
        /// are averaged.
        reach: usize = 2,
            unit "widths of the band", source Taste, effect "a larger value averages more of the texture";
        /// Distance from 0 and 1 within which an alpha is rounded.
        whole: f32 = 0.02,
            unit "1", source Taste, effect "a larger value leaves fewer mixed pixels";
        /// Least |W - O| over |W + O| that determines alpha.
        different: f32 = 0.1,
            unit "1", source Taste, effect "a smaller value trusts noise, a larger one the mask";
    }
}

/// The part of each pixel of `photo` that belongs to the surface that `mask` marks. Both have one
/// size.
///
/// # Panics
/// The sizes differ.
pub fn alpha_matte(mask: &Plane<f32>, photo: &Picture) -> AlphaMatte {
    assert_eq!(mask.size(), photo.0.size(), "a mask has its photo's size");
    let (w, h) = mask.size();
    let band = w.max(h).div_ceil(TUNING.long_side).max(1);
    let reach = TUNING.reach * band;
    let around = |x: usize, y: usize, by: usize| {
        let xs = x.saturating_sub(by)..(x + by + 1).min(w);
        (y.saturating_sub(by)..(y + by + 1).min(h))
            .flat_map(move |y| xs.clone().map(move |x| (x, y)))
    };
    let whole = |share: f32| !(TUNING.whole..=1.0 - TUNING.whole).contains(&share);
    let at_edge = |x: usize, y: usize| {
        let own = mask.get(x, y);
        !whole(own) || around(x, y, band).any(|(x, y)| (mask.get(x, y) > 0.5) != (own > 0.5))
    };
    let rows: Vec<Vec<bool>> =
        (0..h).into_par_iter().map(|y| (0..w).map(|x| at_edge(x, y)).collect()).collect();
    let edge = Plane::new(w, h, rows.concat());

    let mut alpha = mask.map(|share| if whole(share) { share.round() } else { share });
    let mut boundary = Vec::new();
    for i in (0..w * h).filter(|&i| edge.pixels()[i]) {
        let (x, y) = (i % w, i / w);
        let mean = |inside: bool| -> Option<Vec3> {
            let sure = around(x, y, reach)
                .filter(|&(x, y)| !edge.get(x, y) && (mask.get(x, y) > 0.5) == inside);
            let (sum, count) =
                sure.fold((Vec3::ZERO, 0.0), |(sum, n), (x, y)| (sum + photo.0.get(x, y), n + 1.0));
            (count > 0.0).then(|| sum / count)
        };
        // A surface too thin to be seen alone is believed to fill its pixels.
        let Some(own) = mean(true) else { continue };
        let given = mask.get(x, y);
        let found = mean(false).filter(|other| {
            whole(given) && { (own - other).length() > TUNING.different * (own + other).length() }
        });
        let part = found.map_or(given, |other| {
            let way = own - other;
            ((photo.0.get(x, y) - other).dot(way) / way.length_squared()).clamp(0.0, 1.0)
        });
        let part = if whole(part) { part.round() } else { part };
        alpha.set(x, y, part);
        if part > 0.0 && part < 1.0 {
            boundary.push((i as u32, own.to_array()));
        }
    }
    AlphaMatte { alpha, boundary }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WALL: Vec3 = Vec3::new(0.1, 0.2, 0.3);
    const THING: Vec3 = Vec3::new(0.9, 0.8, 0.2);

    /// A wall up to column 8.3 of 16.
    fn photo() -> Picture {
        Picture(Plane::from_fn(16, 9, |x, _| THING.lerp(WALL, (8.3 - x as f32).clamp(0.0, 1.0))))
    }

    #[test]
    fn the_share_of_a_mixed_pixel_is_found_wherever_the_hard_mask_ends() {
        for end in [8, 9] {
            let found = alpha_matte(
                &Plane::from_fn(16, 9, |x, _| if x < end { 1.0 } else { 0.0 }),
                &photo(),
            );
            for x in 0..16 {
                let want = (8.3 - x as f32).clamp(0.0, 1.0);
                assert!(
                    (found.alpha.get(x, 4) - want).abs() < 1e-3,
                    "{x}: {}",
                    found.alpha.get(x, 4)
                );
            }
            assert_eq!(found.boundary.len(), 9, "one pixel of each row");
            assert!(
                found
                    .boundary
                    .iter()
                    .all(|(i, own)| i % 16 == 8 && Vec3::from_array(*own).distance(WALL) < 1e-5)
            );
        }
    }

    #[test]
    fn what_the_photo_does_not_tell_the_mask_does() {
        let even = Picture(Plane::filled(16, 9, WALL));
        let mask = Plane::from_fn(16, 9, |x, y| if x > 4 && y > 2 { 1.0 } else { 0.0 });
        assert_eq!(alpha_matte(&mask, &even).alpha, mask);
        let soft = Plane::from_fn(16, 9, |x, _| x as f32 / 15.0);
        assert_eq!(alpha_matte(&soft, &photo()).alpha, soft);
        let empty = Plane::filled(16, 9, 0.0);
        assert_eq!(alpha_matte(&empty, &photo()), AlphaMatte { alpha: empty, boundary: vec![] });
    }
}
