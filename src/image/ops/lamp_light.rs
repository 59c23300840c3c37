//! The light of a lamp in view before saturation.

use glam::Vec3;
use rayon::prelude::*;

use super::refine_mask::over_windows;
use crate::image::{GlareMask, Picture, Plane, RELIT_PIXEL, distance, smooth_step};

/// How bright the pixels of a lamp were before saturation, against the photo.
///
/// Noise and compression leave pixels just below white within white: they are white, too (a closing
/// of each channel, where none is far below white). The headroom of a channel is that of the lamp,
/// which is the larger, the more of it is white. It rises from the edges of the white, so that a
/// dimmed lamp has no rim, and from pixels that tell how bright the lamp is there, where it is
/// bright and a channel is left.
pub struct LampLight {
    /// Column and row of the first pixel of the planes in the photo.
    first: (usize, usize),
    /// The difference of such pixels to the white around them.
    lacking: Plane<Vec3>,
    /// Factor by which a saturated channel may exceed the photo.
    headroom: Plane<f32>,
    width: usize,
}

impl LampLight {
    /// The lamp with the pixels `mask` in `photo`, which is clipped at `white`; `white_share` of
    /// them are white.
    pub fn new(mask: &GlareMask, photo: &Picture, white: f32, white_share: f32) -> LampLight {
        let (width, height) = mask.size();
        let scale = RELIT_PIXEL.scale((width, height));
        let radius = (RELIT_PIXEL.closing * scale).round() as usize;
        let (mut first, mut last) = ((width, height), (0, 0));
        let mut area = 0usize;
        for i in mask.pixels() {
            let (x, y) = (i % width, i / width);
            first = (first.0.min(x), first.1.min(y));
            last = (last.0.max(x + 1), last.1.max(y + 1));
            area += usize::from(mask.is_own(i));
        }
        let side = (area as f32).sqrt();
        let edge = (RELIT_PIXEL.lamp_edge * scale).min(RELIT_PIXEL.lamp_rise * side) as usize;
        let margin = 2 * radius.max(edge);
        let (left, top) = (first.0.saturating_sub(margin), first.1.saturating_sub(margin));
        let (right, bottom) = ((last.0 + margin).min(width), (last.1 + margin).min(height));
        let (w, h) = (right.saturating_sub(left), bottom.saturating_sub(top));
        let at = |x: usize, y: usize| (top + y) * width + left + x;
        let shown = |x: usize, y: usize| photo.0.pixels()[at(x, y)];
        let mut closed = Plane::filled(w, h, Vec3::ZERO);
        // Channel by channel: beside the planes of a photo of 12 megapixels, memory is short.
        for channel in 0..3 {
            let cut = Plane::from_fn(w, h, |x, y| shown(x, y)[channel]);
            let dilated = over_windows(&cut, radius, f32::max);
            drop(cut);
            let both = over_windows(&dilated, radius, f32::min);
            let pixels = closed.pixels_mut().iter_mut().zip(both.pixels());
            pixels.for_each(|(pixel, &value)| pixel[channel] = value);
        }
        let [from, to] = RELIT_PIXEL.shoulder.map(|level| level * white);
        for (i, pixel) in closed.pixels_mut().iter_mut().enumerate() {
            let (x, y) = (i % w, i / w);
            let (shown, closed) = (shown(x, y), *pixel);
            let is_lamp = mask.weight(at(x, y)) > 0.0;
            *pixel = match is_lamp && shown.min_element() >= RELIT_PIXEL.noise * white {
                true => shown.lerp(closed, smooth_step(from, to, closed.min_element())),
                false => shown,
            };
        }
        let is_edge = |x, y| {
            !mask.is_own(at(x, y)) || closed.get(x, y).max_element() < RELIT_PIXEL.falloff * white
        };
        let from_edge = distance(&Plane::from_fn(w, h, is_edge));
        let tells = |x, y| {
            from_edge.get(x, y) > RELIT_PIXEL.lamp_edge * scale
                && closed.get(x, y).min_element() < to
        };
        // Two means have no edges.
        let reach = (0.5 * RELIT_PIXEL.lamp_reach * side).ceil() as usize;
        let told = Plane::from_fn(w, h, |x, y| f32::from(u8::from(tells(x, y))));
        let told = means(&means(&told, reach), reach);
        let most = (RELIT_PIXEL.lamp_headroom - 1.0) * white_share.sqrt();
        let is_left = |x, y| f32::from(u8::from(closed.get(x, y).min_element() < to));
        let unsaturated = means(&means(&Plane::from_fn(w, h, is_left), edge), edge);
        let headroom = Plane::from_fn(w, h, |x, y| {
            let saturated = smooth_step(from, to, closed.get(x, y).min_element());
            let rise = (1.0 - 2.0 * unsaturated.get(x, y)).max(0.0);
            1.0 + most * saturated * rise * (1.0 - told.get(x, y) / RELIT_PIXEL.lamp_told).max(0.0)
        });
        let mut lacking = closed;
        let pixels = lacking.pixels_mut().iter_mut().enumerate();
        pixels.for_each(|(i, pixel)| *pixel -= shown(i % w, i / w));
        LampLight { first: (left, top), lacking, headroom, width }
    }

    /// The difference of pixel `i` of the photo to the white around it, where it is noise.
    pub fn lacking(&self, i: usize) -> Vec3 {
        self.place(i).map_or(Vec3::ZERO, |(x, y)| self.lacking.get(x, y))
    }

    /// Factor by which a saturated channel of the lamp's own pixel `i` may exceed the photo,
    /// 1..=`RELIT_PIXEL.lamp_headroom`.
    pub fn headroom(&self, i: usize) -> f32 {
        self.place(i).map_or(1.0, |(x, y)| self.headroom.get(x, y))
    }

    fn place(&self, i: usize) -> Option<(usize, usize)> {
        let x = (i % self.width).checked_sub(self.first.0)?;
        let y = (i / self.width).checked_sub(self.first.1)?;
        let (w, h) = self.headroom.size();
        (x < w && y < h).then_some((x, y))
    }
}

/// The mean within `radius` rows and columns; what is outside counts as 0.
fn means(plane: &Plane<f32>, radius: usize) -> Plane<f32> {
    transposed_means(&transposed_means(plane, radius), radius)
}

/// The same within `radius` columns, transposed.
fn transposed_means(plane: &Plane<f32>, radius: usize) -> Plane<f32> {
    let (w, h) = plane.size();
    let mut rows = vec![0.0f32; w * h];
    rows.par_chunks_mut(w.max(1)).enumerate().for_each(|(y, means)| {
        let mut sums = vec![0.0f64];
        (0..w).for_each(|x| sums.push(sums[x] + f64::from(plane.get(x, y))));
        let sum = |x: usize| sums[(x + radius + 1).min(w)] - sums[x.saturating_sub(radius)];
        let mean = |x: usize| (sum(x) / (2 * radius + 1) as f64) as f32;
        means.iter_mut().enumerate().for_each(|(x, value)| *value = mean(x));
    });
    Plane::from_fn(h, w, |y, x| rows[y * w + x])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Mask;

    const SIDE: usize = 48;

    /// A lamp of 32 x 32 pixels before a gray wall that shows `level` at its own (x, y).
    fn lamp(level: impl Fn(usize, usize) -> Vec3) -> (GlareMask, Picture) {
        let is_own = |x: usize, y: usize| x.min(y) >= 8 && x.max(y) < 40;
        let mask = Plane::from_fn(SIDE, SIDE, |x, y| f32::from(u8::from(is_own(x, y))));
        let photo = Picture(Plane::from_fn(SIDE, SIDE, |x, y| match is_own(x, y) {
            true => level(x - 8, y - 8),
            false => Vec3::splat(0.3),
        }));
        let clipped = Mask(photo.0.map(|shown| f32::from(u8::from(shown.min_element() >= 1.0))));
        (GlareMask::of_lamp(&mask, &photo, &clipped, 1.0), photo)
    }

    fn at(x: usize, y: usize) -> usize {
        (y + 8) * SIDE + x + 8
    }

    #[test]
    fn a_lamp_was_the_brighter_the_more_of_it_is_white() {
        let (mask, photo) = lamp(|_, _| Vec3::ONE);
        for (share, most) in [(1.0, RELIT_PIXEL.lamp_headroom), (0.25, 2.0), (0.0, 1.0)] {
            let light = LampLight::new(&mask, &photo, 1.0, share);
            assert_eq!(light.headroom(at(16, 16)), most);
            assert_eq!(light.headroom(0), 1.0, "outside");
            assert!((0..SIDE * SIDE).all(|i| light.lacking(i) == Vec3::ZERO));
        }
    }

    #[test]
    fn a_lamp_rises_from_its_edges_and_not_from_specks() {
        let row = |speck: bool| -> Vec<f32> {
            let (mask, photo) = lamp(|x, y| match speck && (x, y) == (16, 17) {
                true => Vec3::splat(0.6),
                false => Vec3::ONE,
            });
            let light = LampLight::new(&mask, &photo, 1.0, 1.0);
            (0..=16).map(|x| light.headroom(at(x, 16))).collect()
        };
        let (clean, specked) = (row(false), row(true));
        let most = RELIT_PIXEL.lamp_headroom;
        // Half of what is around a pixel of the edge is the dark wall.
        assert!(clean[0] < 1.0 + 0.15 * most && clean[10] == most, "{clean:?}");
        assert!(clean.windows(2).all(|pair| pair[0] <= pair[1] && pair[1] - pair[0] < 0.4));
        assert!(specked.iter().zip(&clean).all(|(a, b)| b - a < 0.1), "{specked:?}");
    }

    #[test]
    fn noise_just_below_white_is_white_and_a_seam_is_not() {
        let noise = Vec3::new(1.0, 0.99, 0.85);
        let with = |speck: Vec3| {
            let (mask, photo) = lamp(|x, y| match (x, y) {
                (20, 9..11) => speck,
                (10, _) => Vec3::splat(0.5),
                (20, 20) => Vec3::new(1.0, 1.0, 0.82),
                _ => Vec3::ONE,
            });
            LampLight::new(&mask, &photo, 1.0, 1.0)
        };
        let light = with(noise);
        assert_eq!(light.lacking(at(20, 10)), Vec3::ONE - noise);
        let clean = with(Vec3::ONE);
        assert!((0..SIDE * SIDE).all(|i| light.headroom(i) == clean.headroom(i)));
        // A channel too far below white, and a seam.
        assert_eq!([at(20, 20), at(10, 10)].map(|i| light.lacking(i)), [Vec3::ZERO; 2]);
        assert_eq!(light.headroom(at(10, 10)), 1.0);
    }

    #[test]
    fn a_lamp_rises_without_a_step_from_pixels_that_tell_its_level() {
        // Blue is left in the first third.
        let (mask, photo) = lamp(|x, _| Vec3::new(1.0, 1.0, if x < 12 { 0.7 } else { 1.0 }));
        let light = LampLight::new(&mask, &photo, 1.0, 1.0);
        let row: Vec<f32> = (0..32).map(|x| light.headroom(at(x, 16))).collect();
        assert_eq!(row[..12], [1.0; 12]);
        assert!(row[23] > 2.0, "{row:?}");
        assert!(
            row[..24].windows(2).all(|pair| (0.0..0.7).contains(&(pair[1] - pair[0]))),
            "{row:?}"
        );
    }

    #[test]
    fn means_by_hand() {
        let plane = Plane::from_fn(3, 2, |x, y| (x + 10 * y) as f32);
        let found = means(&plane, 1);
        assert_eq!(found.get(0, 0), 22.0 / 9.0);
        assert_eq!(found.get(2, 1), 26.0 / 9.0);
        assert!(means(&Plane::filled(0, 0, 1.0), 2).is_empty());
    }
}
