//! Closing of a grown region: grain, cords and other thin lines do not interrupt a surface.
//!
//! A line of the surface is crossed where the region lies on both sides of it; a part of the
//! surface that only a line cuts off joins the region where the photo shows one color on both
//! sides, unless the line encloses the part, as the frame of a picture does. Pixels off the
//! region's plane are never crossed: an edge of depth stays the border.

use glam::Vec3;

use crate::image::{Plane, connected_components, distance, intensity_and_chroma};
use crate::tuning::tuning;

tuning! {
    /// Constants of the closing of a grown region.
    pub const TUNING: CloseRegionTuning {
        /// Widest line that is crossed.
        line: usize = 3,
            unit "pixels", source Taste, effect "a larger value crosses wider frames";
        /// Largest log step of intensity between the two sides of a line on one surface.
        same_level: f32 = 0.12,
            unit "1", source Taste, effect "a larger value joins parts in other light, and other paints";
        /// Largest log step of chromaticity between them.
        same_chroma: f32 = 0.06,
            unit "1", source Taste, effect "a larger value joins other paints";
        /// Fewest pixels along the line at which both sides face each other.
        contacts: usize = 6,
            unit "pixels", source Taste, effect "a smaller value joins parts through gaps";
        /// Fraction of those pixels from which on they face a direction. A part that faces the
        /// region to three sides is enclosed by the line.
        faces: f32 = 0.1,
            unit "1", source Measured("the picture of bedroom, which the border of the photo cuts: 0.17, 0.26 and 0.57"),
            effect "a larger value joins the pictures in frames";
        /// Largest hole that is closed, as a fraction of the picture.
        hole: f32 = 0.001,
            unit "1", source Taste, effect "a larger value closes larger stains, and small things on a wall";
        /// Log steps of intensity and chromaticity between the mean of a hole and the region around
        /// it up to which the hole is grain.
        grain: [f32; 2] = [0.3, 0.12],
            unit "1", source Taste, effect "larger values close over things of other colors";
    }
}

/// Closes `found`, a part of `label`, over lines and grain of its plane. `seen` is the logarithm of
/// the photo, `on_plane` whether a pixel lies in the plane of the region. All planes have one size.
pub fn close_region(
    found: &mut Plane<bool>,
    label: &Plane<bool>,
    seen: &Plane<Vec3>,
    on_plane: impl Fn(usize) -> bool,
) {
    for part in parts_beyond(found, label, seen, &on_plane) {
        part.into_iter().for_each(|i| found.pixels_mut()[i] = true);
    }
    let (w, h) = found.size();
    let near = |i: usize, step: (isize, isize)| {
        (1..=TUNING.line as isize).find(|by| {
            let x = (i % w).checked_add_signed(by * step.0).filter(|x| *x < w);
            let y = (i / w).checked_add_signed(by * step.1).filter(|y| *y < h);
            x.zip(y).is_some_and(|(x, y)| found.get(x, y))
        })
    };
    let between = |i: usize, (dx, dy): (isize, isize)| {
        let [a, b] = [(dx, dy), (-dx, -dy)].map(|step| near(i, step));
        a.zip(b).is_some_and(|(a, b)| (a + b) as usize <= TUNING.line + 1)
    };
    let is_line =
        |i: usize| on_plane(i) && [(1, 0), (0, 1)].into_iter().any(|step| between(i, step));
    let lines: Vec<usize> = (0..w * h).filter(|&i| !found.pixels()[i] && is_line(i)).collect();
    lines.into_iter().for_each(|i| found.pixels_mut()[i] = true);

    let most = (TUNING.hole * (w * h) as f32) as usize;
    for hole in connected_components(&found.map(|inside| !inside)) {
        if hole.len() <= most && hole.iter().all(|&i| on_plane(i)) && is_grain(&hole, found, seen) {
            hole.into_iter().for_each(|i| found.pixels_mut()[i] = true);
        }
    }
}

/// The parts of `label` that a line cuts off from `found`.
fn parts_beyond(
    found: &Plane<bool>,
    label: &Plane<bool>,
    seen: &Plane<Vec3>,
    on_plane: &impl Fn(usize) -> bool,
) -> Vec<Vec<usize>> {
    let (w, h) = found.size();
    let rest =
        Plane::from_fn(w, h, |x, y| label.get(x, y) && !found.get(x, y) && on_plane(y * w + x));
    let away = distance(found);
    // The line itself belongs to neither side.
    let beyond = Plane::from_fn(w, h, |x, y| rest.get(x, y) && away.get(x, y) > 1.5);
    let joins = |part: &Vec<usize>| {
        let mut own = Plane::filled(w, h, false);
        part.iter().for_each(|&i| own.pixels_mut()[i] = true);
        let near = part.iter().filter(|&&i| away.pixels()[i] <= (TUNING.line + 1) as f32);
        let mut facing = [0; 4];
        let mut steps = Vec::new();
        for &i in near {
            let sides = across(i, found, on_plane);
            facing.iter_mut().zip(&sides).for_each(|(count, side)| *count += side.iter().count());
            if let Some(j) = sides.into_iter().flatten().next() {
                steps.push(side(seen, &own, i) - side(seen, found, j));
            }
        }
        let least = TUNING.faces * steps.len() as f32;
        let is_enclosed = facing.iter().filter(|&&count| count as f32 >= least).count() > 2;
        steps.len() >= TUNING.contacts
            && !is_enclosed
            && is_step_below(steps, [TUNING.same_level, TUNING.same_chroma])
    };
    connected_components(&beyond).into_iter().filter(joins).collect()
}

/// The pixels of `found` that face pixel `i` across a line of the plane: to its right, left, below
/// and above.
fn across(i: usize, found: &Plane<bool>, on_plane: &impl Fn(usize) -> bool) -> [Option<usize>; 4] {
    let (w, h) = found.size();
    let along = |(dx, dy): (isize, isize)| {
        let cells = (1..=(TUNING.line + 1) as isize).map_while(move |by| {
            let x = (i % w).checked_add_signed(by * dx).filter(|x| *x < w)?;
            let y = (i / w).checked_add_signed(by * dy).filter(|y| *y < h)?;
            Some(y * w + x)
        });
        cells.take_while(|&j| on_plane(j)).find(|&j| found.pixels()[j])
    };
    [(1, 0), (-1, 0), (0, 1), (0, -1)].map(along)
}

/// Mean color of the pixels of `set` among the 5 x 5 around pixel `i`.
fn side(seen: &Plane<Vec3>, set: &Plane<bool>, i: usize) -> Vec3 {
    let (w, h) = seen.size();
    let span = |at: usize, n: usize| at.saturating_sub(2)..(at + 3).min(n);
    let all = span(i / w, h).flat_map(|y| span(i % w, w).map(move |x| y * w + x));
    let (sum, count) = all
        .filter(|&j| set.pixels()[j])
        .fold((Vec3::ZERO, 0.0), |(sum, n), j| (sum + seen.pixels()[j], n + 1.0));
    sum / f32::max(count, 1.0)
}

/// A hole has the color of the region around it but for grain.
fn is_grain(hole: &[usize], found: &Plane<bool>, seen: &Plane<Vec3>) -> bool {
    let own = hole.iter().map(|&i| seen.pixels()[i]).sum::<Vec3>() / hole.len() as f32;
    let around: Vec<Vec3> = hole
        .iter()
        .flat_map(|&i| sides(found.size(), i))
        .filter(|&j| found.pixels()[j])
        .map(|j| own - seen.pixels()[j])
        .collect();
    !around.is_empty() && is_step_below(around, TUNING.grain)
}

/// The mean of `steps` has at most this intensity and chromaticity.
fn is_step_below(steps: Vec<Vec3>, [level, chroma]: [f32; 2]) -> bool {
    let mean = steps.iter().sum::<Vec3>() / steps.len() as f32;
    let (of_mean, chroma_of_mean) = intensity_and_chroma(mean);
    of_mean.abs() <= level && chroma_of_mean.length() <= chroma
}

/// The 4-neighbors of pixel `i`.
pub fn sides((w, h): (usize, usize), i: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (i % w, i / w);
    let all = [
        (x > 0).then(|| i - 1),
        (x + 1 < w).then(|| i + 1),
        (y > 0).then(|| i - w),
        (y + 1 < h).then(|| i + w),
    ];
    all.into_iter().flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (60, 40);

    /// The region of a wall with dark `lines`, grown from the left of column 30 alone, closed.
    fn closed(dark: impl Fn(usize, usize) -> bool, paint: f32, deep: bool) -> Plane<bool> {
        let (w, h) = SIZE;
        let seen = Plane::from_fn(w, h, |x, y| {
            Vec3::splat(if dark(x, y) {
                -3.0
            } else if x > 30 {
                paint
            } else {
                0.0
            })
        });
        let label = Plane::from_fn(w, h, |x, y| !dark(x, y));
        let mut found = Plane::from_fn(w, h, |x, y| x < 30 && !dark(x, y));
        close_region(&mut found, &label, &seen, |i| !deep || !dark(i % w, i / w));
        found
    }

    #[test]
    fn a_cord_does_not_part_a_wall_and_an_edge_does() {
        let cord = |x: usize, _: usize| (30..32).contains(&x);
        assert!(closed(cord, 0.0, false).pixels().iter().all(|inside| *inside));
        let other_paint = closed(cord, 0.4, false);
        let behind_a_post = closed(cord, 0.0, true);
        for found in [other_paint, behind_a_post] {
            assert!(found.pixels().iter().enumerate().all(|(i, inside)| *inside == (i % 60 < 30)));
        }
    }

    #[test]
    fn a_frame_that_the_border_of_the_photo_cuts_keeps_its_picture() {
        let (w, h) = SIZE;
        let within =
            |x: usize, y: usize, by: usize| x >= w - 12 + by && (4 + by..18 - by).contains(&y);
        let frame = |x: usize, y: usize| within(x, y, 0) && !within(x, y, 2);
        let seen = Plane::from_fn(w, h, |x, y| Vec3::splat(if frame(x, y) { -3.0 } else { 0.0 }));
        let label = Plane::from_fn(w, h, |x, y| !frame(x, y));
        let mut found = Plane::from_fn(w, h, |x, y| !within(x, y, 0));
        close_region(&mut found, &label, &seen, |_| true);
        assert!(!found.get(w - 3, 11) && found.get(w - 3, 20));
    }

    #[test]
    fn a_frame_keeps_its_picture_and_a_speck_is_closed() {
        let frame = |x: usize, y: usize| {
            let ring = |from: usize, to: usize| (from..to).contains(&x) && (from..to).contains(&y);
            ring(6, 20) && !ring(8, 18)
        };
        let (w, h) = SIZE;
        let seen = Plane::from_fn(w, h, |x, y| Vec3::splat(if frame(x, y) { -3.0 } else { 0.0 }));
        let label = Plane::from_fn(w, h, |x, y| !frame(x, y));
        let picture = |x: usize, y: usize| (8..18).contains(&x) && (8..18).contains(&y);
        let speck = |x: usize, y: usize| (40..41).contains(&x) && (20..22).contains(&y);
        let mut found = Plane::from_fn(w, h, |x, y| !frame(x, y) && !picture(x, y) && !speck(x, y));
        close_region(&mut found, &label, &seen, |_| true);
        assert!(!found.get(12, 12) && found.get(40, 21) && found.get(2, 2));
    }
}
