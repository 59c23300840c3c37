//! Pixels that belong to a plane by the photo: depth errs most in the corners and at the border of
//! a photo, where a wall that looks even bulges.

use glam::Vec3;

use super::close_region::sides;
use super::faint_edges::FaintEdges;
use super::grow_region::mean_around;
use super::photo_edges::{PhotoEdges, log_photo};
use crate::image::{Picture, Plane, connected_components, intensity_and_chroma};
use crate::tuning::tuning;

tuning! {
    /// Constants of pixels that join a plane by the photo.
    pub const TUNING: JoinByPhotoTuning {
        /// Largest log steps of intensity and chromaticity between the mean of 3 x 3 pixels and the
        /// mean of the plane around them for which both have one color.
        same: [f32; 2] = [0.3, 0.12],
            unit "1", source Measured("walls of six photographs with depth by a sensor: 0.2 and 0.1 leave holes in the noise"),
            effect "larger values join things before a wall";
        /// Fraction of edges along the border between a plane and a part beside it from which on
        /// the part is another surface.
        edges: f32 = 0.1,
            unit "1", source Measured("six photographs: walls have 0 to 0.02, strips of a ceiling 0.19 and 0.51"),
            effect "a larger value joins strips of a ceiling to a wall";
        /// Largest hole of another color in a plane that is closed.
        hole: f32 = 0.0003,
            unit "fraction of all pixels", source Taste,
            effect "a larger value flattens small things on a wall";
        /// Passes, each with the mean color of the plane and the pixels that have joined it.
        rounds: usize = 4,
            unit "rounds", source Taste, effect "a larger value joins wider bulges";
    }
}

/// Adds pixels to planes: `on` is the plane of each pixel that lies on one of `count`. A pixel that
/// lies on none and `may_join` a plane, both by index, joins it where `photo` shows the color of
/// the plane around it, and no edge between. Planes with a smaller index come first.
pub fn join_by_photo(
    on: &mut Plane<Option<usize>>,
    count: usize,
    photo: &Picture,
    may_join: impl Fn(usize, usize) -> bool,
) {
    let (w, h) = on.size();
    let seen = log_photo(photo);
    let mean = Picture(Plane::from_fn(w, h, |x, y| {
        let columns = x.saturating_sub(1)..(x + 2).min(w);
        let rows = y.saturating_sub(1)..(y + 2).min(h);
        let count = (columns.len() * rows.len()) as f32;
        let around = rows.flat_map(|y| columns.clone().map(move |x| photo.0.get(x, y)));
        around.sum::<Vec3>() / count
    }));
    let even = log_photo(&mean);
    let noise = Plane::filled(w, h, Vec3::ZERO);
    let faint = FaintEdges::find(&seen, &noise);
    for plane in 0..count {
        for _ in 0..TUNING.rounds {
            let set = on.map(|own| own == Some(plane));
            let look = mean_around(&set, &even);
            let edges = PhotoEdges::new(&seen, &noise, &faint, &set);
            let joins = |i: usize| {
                let (level, chroma) = intensity_and_chroma(even.pixels()[i] - look.pixels()[i]);
                on.pixels()[i].is_none()
                    && may_join(i, plane)
                    && level.abs() < TUNING.same[0]
                    && chroma.length() < TUNING.same[1]
            };
            let wide = (0..w * h).map(|i| set.pixels()[i] || joins(i)).collect();
            let starts: Vec<usize> =
                (0..w * h).filter(|&i| set.pixels()[i] && !edges.ends_at(i)).collect();
            let mut new = edges.reached(&Plane::new(w, h, wide), &starts);
            new.pixels_mut().iter_mut().zip(set.pixels()).for_each(|(new, old)| *new &= !old);
            let borders = |i: usize| {
                let of_plane = sides((w, h), i).filter(|&side| set.pixels()[side]);
                of_plane.map(move |side| (i, side))
            };
            let mut has_grown = false;
            for part in connected_components(&new) {
                let border: Vec<_> = part.iter().flat_map(|&i| borders(i)).collect();
                let parted = border.iter().filter(|(i, side)| edges.between(*i, *side)).count();
                if (parted as f32) < TUNING.edges * border.len() as f32 {
                    part.into_iter().for_each(|i| on.pixels_mut()[i] = Some(plane));
                    has_grown = true;
                }
            }
            if !has_grown {
                break;
            }
        }
        for hole in connected_components(&on.map(|own| own != Some(plane))) {
            let is_grain = |&i: &usize| on.pixels()[i].is_none() && may_join(i, plane);
            if hole.len() <= (TUNING.hole * (w * h) as f32) as usize && hole.iter().all(is_grain) {
                hole.into_iter().for_each(|i| on.pixels_mut()[i] = Some(plane));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (80, 60);

    /// The plane of a wall whose depth is wrong where `errs`, and whose photo has the log intensity
    /// `level`.
    fn joined(
        errs: impl Fn(usize, usize) -> bool,
        level: impl Fn(usize, usize) -> f32,
    ) -> Plane<Option<usize>> {
        let noise = |x: usize, y: usize| ((x * 7919 + y * 104_729) % 1000) as f32 / 1000.0 - 0.5;
        let photo = Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            Vec3::splat(0.2 * (level(x, y) + 0.05 * noise(x, y)).exp())
        });
        let mut on = Plane::from_fn(SIZE.0, SIZE.1, |x, y| (!errs(x, y)).then_some(0));
        join_by_photo(&mut on, 1, &Picture(photo), |_, _| true);
        on
    }

    fn in_corner(x: usize, y: usize) -> bool {
        x < 20 && y < 15
    }

    /// The pixels of the corner that have joined the wall.
    fn corner(level: impl Fn(usize, usize) -> f32) -> usize {
        let on = joined(in_corner, level);
        let pixels = (0..20).flat_map(|x| (0..15).map(move |y| (x, y)));
        pixels.filter(|&(x, y)| on.get(x, y) == Some(0)).count()
    }

    #[test]
    fn a_corner_of_the_wall_joins_it_where_the_photo_is_even() {
        assert_eq!(corner(|_, _| 0.0), 300);
        // A lamp lights the wall from the right.
        assert_eq!(corner(|x, _| 0.02 * x as f32), 300);
    }

    #[test]
    fn a_thing_of_another_color_or_behind_an_edge_stays() {
        assert_eq!(corner(|x, y| if in_corner(x, y) { -0.5 } else { 0.0 }), 0);
        // Of the wall's color in the middle, with a dark outline.
        let outline = |x: usize, y: usize| in_corner(x, y) && (x > 17 || y > 12);
        assert_eq!(corner(|x, y| if outline(x, y) { -0.5 } else { 0.0 }), 0);
    }

    #[test]
    fn a_strip_behind_an_edge_that_ends_stays() {
        // A ceiling is brighter by 0.2, a step that fades to the right.
        let is_ceiling = |x: usize, y: usize| x < 30 && y < 8;
        let step = |x: usize| 0.2 * (1.0 - (x as f32 - 15.0) / 10.0).clamp(0.0, 1.0);
        let on = joined(is_ceiling, |x, y| if is_ceiling(x, y) { step(x) } else { 0.0 });
        assert!((0..15).all(|x| (0..6).all(|y| on.get(x, y).is_none())));
        let on = joined(is_ceiling, |_, _| 0.0);
        assert!(on.pixels().iter().all(|plane| *plane == Some(0)));
    }

    #[test]
    fn what_may_not_join_stays() {
        let photo = Picture(Plane::filled(9, 9, Vec3::ONE));
        let mut on = Plane::from_fn(9, 9, |x, _| (x < 5).then_some(0));
        join_by_photo(&mut on, 1, &photo, |i, _| i % 9 != 6);
        for x in 0..9 {
            assert_eq!(on.get(x, 4), (x < 6).then_some(0), "column {x}");
        }
    }
}
