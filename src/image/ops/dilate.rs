//! Dilation of masks.

use crate::image::{Mask, Plane};
use crate::tuning::tuning;

tuning! {
    /// Constants of the geodesic dilation.
    pub const TUNING: DilateTuning {
        /// Farthest distance from the bounding box of the seed that the dilation reaches.
        reach: usize = 2,
            unit "longer sides of that box", source Taste,
            effect "a larger value joins more saturated pixels to a light";
    }
}

/// The geodesic dilation of `seed` (above 0.5) within `through` (above 0.5): all pixels that are
/// 8-connected with the seed, up to `TUNING.reach` times its longer side beyond its bounding box.
/// It finds the saturated pixels around a light whose mask is too small.
///
/// # Panics
/// The planes differ in size.
pub fn geodesic_dilate(seed: &Plane<f32>, through: &Plane<f32>) -> Plane<bool> {
    assert_eq!(seed.size(), through.size(), "both have one size");
    let (w, h) = seed.size();
    let mut grown = seed.map(|share| share > 0.5);
    let mut front: Vec<usize> = (0..w * h).filter(|&i| grown.pixels()[i]).collect();
    let range = |value: &dyn Fn(usize) -> usize| {
        let (low, high) = front
            .iter()
            .fold((usize::MAX, 0), |(low, high), &i| (low.min(value(i)), high.max(value(i))));
        (low.min(high), high)
    };
    let (x, y) = (range(&|i| i % w), range(&|i| i / w));
    let reach = TUNING.reach * ((x.1 - x.0).max(y.1 - y.0) + 1);
    let within =
        |value: usize, (low, high): (usize, usize)| value + reach >= low && value <= high + reach;
    while let Some(i) = front.pop() {
        let (cx, cy) = (i % w, i / w);
        for ny in cy.saturating_sub(1)..(cy + 2).min(h) {
            for nx in cx.saturating_sub(1)..(cx + 2).min(w) {
                if !grown.get(nx, ny) && through.get(nx, ny) > 0.5 && within(nx, x) && within(ny, y)
                {
                    grown.set(nx, ny, true);
                    front.push(ny * w + nx);
                }
            }
        }
    }
    grown
}

/// The dilation of the union of `masks` (above 0) by a square: the pixels within `reach` rows and
/// columns of it. All masks have the size that is given.
pub fn dilate<'a>(
    masks: impl Iterator<Item = &'a Mask>,
    (w, h): (usize, usize),
    reach: usize,
) -> Plane<bool> {
    let mut near = Plane::filled(w, h, false);
    for mask in masks {
        for i in (0..w * h).filter(|&i| mask.0.pixels()[i] > 0.0) {
            let (x, y) = (i % w, i / w);
            for y in y.saturating_sub(reach)..(y + reach + 1).min(h) {
                near.pixels_mut()[y * w + x.saturating_sub(reach)..y * w + (x + reach + 1).min(w)]
                    .fill(true);
            }
        }
    }
    near
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_follows_what_hangs_together_as_far_as_twice_its_size() {
        let mut seed = Plane::filled(20, 5, 0.0);
        (4..7).for_each(|x| seed.set(x, 2, 1.0));
        let mut through = Plane::from_fn(20, 5, |_, y| if y == 2 { 1.0 } else { 0.0 });
        through.set(18, 4, 1.0);
        let grown = geodesic_dilate(&seed, &through);
        for (x, y) in (0..20).flat_map(|x| (0..5).map(move |y| (x, y))) {
            assert_eq!(grown.get(x, y), y == 2 && (0..13).contains(&x), "({x}, {y})");
        }
        assert!(
            geodesic_dilate(&Plane::filled(3, 3, 0.0), &Plane::filled(3, 3, 1.0))
                .pixels()
                .iter()
                .all(|g| !g)
        );
    }
}
