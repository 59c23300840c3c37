//! Pixels of a photo that belong to a visible light.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::image::{
    Mask, Picture, Plane, distance, geodesic_dilate, luminance, refine_mask, rule, smooth_step,
};
use crate::tuning::tuning;

tuning! {
    /// Constants of the pixels of a visible light and of its glare.
    pub const TUNING: GlareMaskTuning {
        /// Fraction of a lamp's brightness below which a pixel of its mask shows no emitter.
        stand: f32 = 0.3,
            unit "1", source Measured("lamps whose masks include feet and stands; no page records it"),
            effect "a larger value takes more of a shade for a lit surface";
        /// Quantile of the luminances in a lamp's mask that counts as the lamp's brightness.
        bright_tenths: usize = 9,
            unit "tenths", source Taste, effect "a larger value follows highlights of the shade";
        /// Width of the rim of a mask, which does not count there, over the photo's longer side:
        /// masks are ragged.
        rim: f32 = 0.005,
            unit "1", source Measured("masks of photos are off by 2 to 4 pixels of 608"),
            effect "a smaller value takes the bright wall around a dark foot for light of the foot";
        /// The same over the distance of the mask's innermost pixel from its edge, at most.
        rim_share: f32 = 0.5,
            unit "1", source Derived("a narrow tube keeps its middle"),
            effect "a larger value leaves fewer pixels of narrow lamps";
        /// Largest weight of glare; only a light's own pixels have 1.
        max_glare: f32 = 0.999,
            unit "1", source Taste, effect "a smaller value leaves more of a saturated pixel to the surface";
        /// Largest channel of a pixel over the lamp's brightness, below which it shows a surface
        /// and no glare, and from which on it may show nothing but glare.
        lit: [f32; 2] = [0.4, 0.8],
            unit "1", source Measured("objects beside lamps of real photos that are off; by eye"),
            effect "larger values keep more of the photo beside a lamp, with its bloom";
        /// Luminance of a pixel over the lamp's brightness, up to which it may show glare of the
        /// lamp, and from which on its light is of another cause.
        brighter: [f32; 2] = [1.25, 1.75],
            unit "1", source Measured("masks of dark feet beside saturated walls in nyu_0958: 2.2 and 1.8; lamps that are on: 1.04 at most"),
            effect "larger values give a dark part of a lamp the light of the wall behind it";
        /// Width of the frame of a window, where saturated, over that of its bloom.
        frame: f32 = 2.0,
            unit "1", source Taste,
            effect "a larger value takes the light on saturated walls for glare of the window";
        /// Least width of a lamp's bloom over the side of a square of the lamp's area.
        lamp_bloom: f32 = 0.5,
            unit "1", source Measured("photos of lamps; no page records it"),
            effect "a larger value gives more light around a lamp to that lamp";
    }
}

/// The pixels of a visible light in a photo: its own pixels, and its glare around them.
///
/// An own pixel shows the light itself. A pixel of glare shows a surface, and in a fraction of its
/// unexplained light the scattering of the lens and the sensor. At the edge of the light, which is
/// that of its mask refined against the photo ([`refine_mask`]), a pixel shows both.
///
/// ```
/// use glam::Vec3;
/// use relight::image::{GlareMask, Mask, Picture, Plane};
///
/// let photo = Picture(Plane::filled(9, 9, Vec3::ONE));
/// let window = Plane::from_fn(9, 9, |x, _| if x < 3 { 1.0 } else { 0.0 });
/// let clipped = Mask(Plane::filled(9, 9, 0.0));
/// let mask = GlareMask::of_window(&window, &photo, &clipped, 4.0);
/// assert!(mask.is_own(2) && !mask.is_own(3));
/// assert!(mask.weight(3) > mask.weight(5) && mask.weight(8) == 0.0);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GlareMask {
    /// Part of each pixel that shows the light itself, in steps of 1/255.
    own: Plane<u8>,
    /// Weight of the glare in the rest of the pixel, 0..=`TUNING.max_glare`; 0 without a rest.
    glare: Plane<f32>,
}

impl GlareMask {
    /// The pixels of a lamp. All planes have one size.
    ///
    /// Glare reaches from the lamp, with the saturated pixels that touch it, over `bloom` pixels or
    /// half the lamp's width, whichever is more. Pixels that are dark against the lamp and not
    /// within `bloom` of it show a surface, and so do pixels around it, and at the rim of its mask,
    /// that are brighter than the lamp.
    ///
    /// # Panics
    /// `mask`, `photo` and `clipped` differ in size.
    pub fn of_lamp(mask: &Plane<f32>, photo: &Picture, clipped: &Mask, bloom: f32) -> GlareMask {
        let is_rim = rim(mask);
        let bright = level_within(mask, &is_rim, photo);
        let brighter = TUNING.brighter.map(|level| level * bright);
        let level = |i: usize| luminance(photo.0.pixels()[i]);
        let (w, h) = mask.size();
        let mask = &Plane::sparse(w, h, |i| match is_rim.pixels()[i] && level(i) >= brighter[1] {
            true => 0.0,
            false => mask.pixels()[i],
        });
        let its_own = Plane::sparse(w, h, |i| match level(i) < brighter[1] {
            true => clipped.0.pixels()[i],
            false => 0.0,
        });
        let core = geodesic_dilate(mask, &its_own);
        let area = core.pixels().iter().filter(|inside| **inside).count();
        let falloff_radius = bloom.max(TUNING.lamp_bloom * (area as f32).sqrt());
        let mut found = GlareMask::new(mask, (photo, clipped), &core, falloff_radius, bright);
        if bright > 0.0 {
            let away = distance(&found.own.map(|own| own > 0));
            let [dark, lit] = TUNING.lit.map(|level| level * bright);
            for (i, glare) in found.glare.pixels_mut().iter_mut().enumerate() {
                let rim = 1.0 - smooth_step(0.0, bloom.max(1.0), away.pixels()[i]);
                *glare *= smooth_step(dark, lit, photo.0.pixels()[i].max_element()).max(rim);
                *glare *= 1.0 - smooth_step(brighter[0], brighter[1], level(i));
            }
        }
        found
    }

    /// The pixels of a window. All planes have one size.
    ///
    /// Glare reaches over `bloom` pixels from the window and from the saturated pixels that touch
    /// it, up to `TUNING.frame` of these widths away: its frame and its curtains.
    ///
    /// # Panics
    /// `mask`, `photo` and `clipped` differ in size.
    pub fn of_window(mask: &Plane<f32>, photo: &Picture, clipped: &Mask, bloom: f32) -> GlareMask {
        let away = distance(&mask.map(|share| share > 0.5));
        let touching = geodesic_dilate(mask, &clipped.0);
        let core = Plane::from_fn(mask.width(), mask.height(), |x, y| {
            touching.get(x, y) && away.get(x, y) <= TUNING.frame * bloom
        });
        GlareMask::new(mask, (photo, clipped), &core, bloom, 0.0)
    }

    /// Own pixels are those of `mask` whose luminance is not small against `bright`, refined
    /// against the photo where it is not saturated. Glare falls from `core` to zero within
    /// `falloff_radius` pixels.
    fn new(
        mask: &Plane<f32>,
        (photo, clipped): (&Picture, &Mask),
        core: &Plane<bool>,
        falloff_radius: f32,
        bright: f32,
    ) -> GlareMask {
        assert_eq!(mask.size(), photo.0.size(), "a mask has its photo's size");
        let (w, h) = mask.size();
        let dark = TUNING.stand * bright;
        let lit = Plane::sparse(w, h, |i| match luminance(photo.0.pixels()[i]) >= dark {
            true => mask.pixels()[i],
            false => 0.0,
        });
        // White beside white shows no edge: there the mask decides.
        let refined = refine_mask(&lit, photo, None, 0.0);
        let own = Plane::sparse(w, h, |i| match clipped.0.pixels()[i] > 0.5 {
            true => u8::MAX * u8::from(lit.pixels()[i] > 0.5),
            false => (255.0 * refined.pixels()[i]).round() as u8,
        });
        drop((lit, refined));
        let away = distance(core);
        let falloff = |i: usize| {
            TUNING.max_glare * (1.0 - smooth_step(0.0, falloff_radius.max(1.0), away.pixels()[i]))
        };
        let glare = |i: usize| if own.pixels()[i] == u8::MAX { 0.0 } else { falloff(i) };
        GlareMask { glare: Plane::sparse(w, h, glare), own }
    }

    /// The pixel of the mask, row by row, at the center of pixel (x, y) of a picture of w x h that
    /// shows the same.
    pub fn pixel_at(&self, (x, y): (usize, usize), (w, h): (usize, usize)) -> usize {
        let (width, height) = self.size();
        (2 * y + 1) * height / (2 * h) * width + (2 * x + 1) * width / (2 * w)
    }

    /// At least half of pixel `i`, row by row, shows the light itself.
    pub fn is_own(&self, i: usize) -> bool {
        self.own.pixels()[i] > u8::MAX / 2
    }

    /// Part of pixel `i` that shows the light itself, 0..=1.
    pub fn coverage(&self, i: usize) -> f32 {
        f32::from(self.own.pixels()[i]) / f32::from(u8::MAX)
    }

    /// Weight of the glare in the part of pixel `i` that shows a surface, 0..1.
    pub fn glare(&self, i: usize) -> f32 {
        self.glare.pixels()[i]
    }

    /// Fraction of pixel `i` that is the light's, 0..=1: 1 where all of it shows the light itself
    /// and nowhere else.
    pub fn weight(&self, i: usize) -> f32 {
        let own = self.coverage(i);
        own + (1.0 - own) * self.glare(i)
    }

    /// The pixels, row by row, of which a part shows the light itself.
    fn own_pixels(&self) -> impl Iterator<Item = usize> {
        self.own.pixels().iter().enumerate().filter(|(_, own)| **own > 0).map(|(i, _)| i)
    }

    /// The pixels, row by row, of which a part is the light's.
    pub fn pixels(&self) -> impl Iterator<Item = usize> {
        let both = self.own.pixels().iter().zip(self.glare.pixels()).enumerate();
        both.filter(|(_, (own, glare))| **own > 0 || **glare > 0.0).map(|(i, _)| i)
    }

    /// Mean color of the light's own pixels in a photo of this mask's size, as a color of luminance
    /// 1; white where they are black or none.
    pub fn hue(&self, photo: &Picture) -> Vec3 {
        weighted_hue(photo, |i| self.coverage(i))
    }

    /// Fraction of the light's own pixels for which `test` holds; 0 without any.
    pub fn share(&self, test: impl Fn(usize) -> bool) -> f32 {
        let (all, some) = self.own_pixels().fold((0.0, 0.0), |(all, some), i| {
            let own = self.coverage(i);
            (all + own, some + if test(i) { own } else { 0.0 })
        });
        if all > 0.0 { some / all } else { 0.0 }
    }

    /// (width, height)
    pub fn size(&self) -> (usize, usize) {
        self.own.size()
    }

    /// Memory held by the pixels, in bytes.
    pub fn bytes(&self) -> usize {
        self.own.bytes() + self.glare.bytes()
    }

    /// Checks that both planes have one size and that glare is a weight.
    ///
    /// # Errors
    /// The rule that does not hold.
    pub fn check(&self) -> Result<(), String> {
        rule(self.own.size() == self.glare.size(), "own pixels and glare of one size")?;
        rule(self.glare.pixels().iter().all(|weight| (0.0..1.0).contains(weight)), "glare in 0..1")
    }
}

/// Part of each pixel of a picture that shows one light itself, in steps of 1/255.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightMask(pub Plane<u8>);

impl LightMask {
    /// A light that the photo shows with the pixels `own`, or that is drawn over it with the
    /// coverage `drawn`, or both; `None` where no pixel shows it.
    ///
    /// # Panics
    /// The planes differ in size.
    pub fn new(own: Option<&GlareMask>, drawn: Option<&Mask>) -> Option<LightMask> {
        let mut mask = own.map(|own| own.own.clone());
        let is_drawn = |mask: &&Mask| mask.0.pixels().iter().any(|&share| share > 0.0);
        if let Some(drawn) = drawn.filter(is_drawn) {
            let (width, height) = drawn.0.size();
            let mask = mask.get_or_insert_with(|| Plane::filled(width, height, 0));
            assert_eq!(mask.size(), drawn.0.size(), "planes of one size");
            for (own, share) in mask.pixels_mut().iter_mut().zip(drawn.0.pixels()) {
                *own = (*own).max((255.0 * share).round() as u8);
            }
        }
        mask.map(LightMask)
    }

    /// The parts, 0..=1.
    pub fn shares(&self) -> Plane<f32> {
        self.0.map(|own| f32::from(own) / f32::from(u8::MAX))
    }
}

/// Luminance of the bright parts of a light in a photo of its mask's size, without the rim of the
/// mask; 0 for an empty mask.
pub fn bright_level(mask: &Plane<f32>, photo: &Picture) -> f32 {
    level_within(mask, &rim(mask), photo)
}

fn level_within(mask: &Plane<f32>, is_rim: &Plane<bool>, photo: &Picture) -> f32 {
    let inside = |i: &usize| mask.pixels()[*i] > 0.5 && !is_rim.pixels()[*i];
    let inside = (0..mask.len()).filter(inside);
    let mut levels: Vec<f32> = inside.map(|i| luminance(photo.0.pixels()[i])).collect();
    levels.sort_by(f32::total_cmp);
    levels.get(levels.len() * TUNING.bright_tenths / 10).copied().unwrap_or(0.0)
}

/// The pixels of a mask that are near its edge, where it may show the surface behind the light.
fn rim(mask: &Plane<f32>) -> Plane<bool> {
    let inward = distance(&mask.map(|share| share <= 0.5));
    let inmost = inward.pixels().iter().copied().fold(0.0, f32::max);
    let longer = mask.width().max(mask.height()) as f32;
    let width = (TUNING.rim * longer).min(TUNING.rim_share * inmost);
    inward.map(|away| 0.0 < away && away <= width)
}

/// Mean color of a photo with the weight of each pixel, as a color of luminance 1; white where it
/// is black.
pub fn weighted_hue(photo: &Picture, weight: impl Fn(usize) -> f32) -> Vec3 {
    let weights = (0..photo.0.len()).map(|i| (i, weight(i))).filter(|(_, weight)| *weight != 0.0);
    let sum = weights.map(|(i, weight)| weight * photo.0.pixels()[i].max(Vec3::ZERO)).sum::<Vec3>();
    let level = luminance(sum);
    if level > 0.0 && level.is_finite() { sum / level } else { Vec3::ONE }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lamp_owns_its_bright_pixels_and_its_stand_is_a_surface() {
        // A lamp of 4 x 4 pixels on a stand of 2 x 4 that shows a tenth of its light.
        let in_lamp = |x: usize, y: usize| (8..12).contains(&x) && (4..8).contains(&y);
        let in_stand = |x: usize, y: usize| (9..11).contains(&x) && (8..12).contains(&y);
        let mask =
            Plane::from_fn(20, 16, |x, y| if in_lamp(x, y) || in_stand(x, y) { 1.0 } else { 0.0 });
        let photo = Picture(Plane::from_fn(20, 16, |x, y| {
            Vec3::splat(if in_stand(x, y) { 0.1 } else { 1.0 })
        }));
        let clear = Mask(mask.map(|_| 0.0));
        let found = GlareMask::of_lamp(&mask, &photo, &clear, 1.0);
        for (x, y) in (0..16).flat_map(|y| (0..20).map(move |x| (x, y))) {
            let i = y * 20 + x;
            assert_eq!(found.is_own(i), in_lamp(x, y), "({x}, {y})");
            assert_eq!(found.weight(i) == 1.0, in_lamp(x, y), "({x}, {y})");
        }
        assert_eq!(found.weight(10 * 20 + 9), 0.0, "within the mask, but dark");
        // The area is 24 pixels: half the side of its square is 2.45 pixels.
        assert!(found.weight(5 * 20 + 6) > 0.0 && found.weight(5 * 20 + 5) == 0.0);
        assert_eq!(found.check(), Ok(()));
    }

    #[test]
    fn a_dark_object_beside_a_lamp_is_no_glare_but_at_its_rim() {
        // Saturation from the lamp up to column 15, with a dark object, and one half as bright.
        let levels = |x: usize| match x {
            2 | 8 => 0.1,
            10 => 0.6,
            _ => 1.0,
        };
        let mask = Plane::from_fn(30, 5, |x, _| if x < 2 { 1.0 } else { 0.0 });
        let photo = Picture(Plane::from_fn(30, 5, |x, _| Vec3::splat(levels(x))));
        let clipped = Mask(Plane::from_fn(30, 5, |x, _| if x < 15 { 1.0 } else { 0.0 }));
        let found = GlareMask::of_lamp(&mask, &photo, &clipped, 3.0);
        let glare = |x: usize| found.glare(2 * 30 + x);
        assert_eq!([glare(8), glare(7)], [0.0, TUNING.max_glare]);
        assert!((glare(10) - 0.5 * TUNING.max_glare).abs() < 1e-3, "{}", glare(10));
        assert!(glare(2) > 0.5, "{}", glare(2));
    }

    #[test]
    fn saturation_beside_a_dark_part_of_a_lamp_is_no_glare_of_it() {
        let mask = Plane::from_fn(30, 5, |x, _| if x < 4 { 1.0 } else { 0.0 });
        let clipped = Mask(Plane::from_fn(30, 5, |x, _| f32::from(u8::from((4..15).contains(&x)))));
        let found = |lamp: f32| {
            let level = |x: usize| match x {
                0..4 => lamp,
                4..15 => 1.0,
                _ => 0.3,
            };
            let photo = Picture(Plane::from_fn(30, 5, |x, _| Vec3::splat(level(x))));
            let found = GlareMask::of_lamp(&mask, &photo, &clipped, 2.0);
            (4..30).map(|x| found.glare(2 * 30 + x)).collect::<Vec<f32>>()
        };
        assert_eq!(found(0.4), [0.0; 26]);
        assert_eq!(found(1.0)[..8], [TUNING.max_glare; 8]);
    }

    #[test]
    fn the_ragged_rim_of_a_dark_mask_is_the_bright_wall_behind_it() {
        // A foot of 14 columns before a white wall; its mask has two columns more on either side.
        let found = |foot: std::ops::Range<usize>, margin: usize| {
            let is_masked = |x: usize| (foot.start - margin..foot.end + margin).contains(&x);
            let mask = Plane::from_fn(600, 20, |x, _| f32::from(u8::from(is_masked(x))));
            let photo = Picture(Plane::from_fn(600, 20, |x, _| {
                Vec3::splat(if foot.contains(&x) { 0.05 } else { 1.0 })
            }));
            let clipped = Mask(photo.0.map(|shown| f32::from(u8::from(shown.x >= 1.0))));
            let level = bright_level(&mask, &photo);
            (level, GlareMask::of_lamp(&mask, &photo, &clipped, 2.0))
        };
        let (level, mask) = found(10..24, 2);
        assert_eq!(level, 0.05);
        let row: Vec<f32> = (0..40).map(|x| mask.weight(15 * 600 + x)).collect();
        assert!(row[..10].iter().chain(&row[24..]).all(|&weight| weight == 0.0), "{row:?}");
        assert!(row[11..23].iter().all(|&weight| weight == 1.0), "{row:?}");
        // A tube of three columns keeps its middle.
        assert_eq!(found(10..13, 0).0, 0.05);
    }

    #[test]
    fn saturation_that_touches_a_lamp_is_glare() {
        let mask = Plane::from_fn(30, 5, |x, _| if x < 4 { 1.0 } else { 0.0 });
        let clipped = Mask(Plane::from_fn(30, 5, |x, _| if x < 9 { 1.0 } else { 0.0 }));
        let photo = Picture(Plane::filled(30, 5, Vec3::ONE));
        let found = GlareMask::of_lamp(&mask, &photo, &clipped, 0.0);
        let row: Vec<f32> = (0..30).map(|x| found.weight(2 * 30 + x)).collect();
        assert!(
            row[..4].iter().all(|&w| w == 1.0) && row[4..9].iter().all(|&w| w == TUNING.max_glare),
            "{row:?}"
        );
        assert!(row[8..].windows(2).all(|pair| pair[1] <= pair[0]) && row[29] == 0.0, "{row:?}");
    }

    #[test]
    fn a_dark_window_owns_its_pixels() {
        let mask = Plane::from_fn(12, 3, |x, _| if x < 6 { 1.0 } else { 0.0 });
        let photo = Picture(Plane::filled(12, 3, Vec3::ZERO));
        let none = Mask(mask.map(|_| 0.0));
        let found = GlareMask::of_window(&mask, &photo, &none, 3.0);
        let row: Vec<f32> = (0..12).map(|x| found.weight(x)).collect();
        assert_eq!(row[..6], [1.0; 6]);
        // Halfway through the falloff of 3 pixels lies no pixel; a third in, 1 - (3 - 2 / 3) / 9 of
        // the weight is left.
        assert!((row[6] - TUNING.max_glare * (1.0 - 7.0 / 27.0)).abs() < 1e-6, "{row:?}");
        assert_eq!(row[8..], [0.0; 4]);
    }

    #[test]
    fn a_saturated_frame_is_in_the_glare_of_its_window() {
        let mask = Plane::from_fn(30, 3, |x, _| if x < 6 { 1.0 } else { 0.0 });
        let clipped = Mask(Plane::from_fn(30, 3, |x, _| if x < 25 { 1.0 } else { 0.0 }));
        let photo = Picture(Plane::filled(30, 3, Vec3::ONE));
        let found = GlareMask::of_window(&mask, &photo, &clipped, 3.0);
        // Saturated pixels up to twice the bloom away, and the bloom from there.
        let row: Vec<f32> = (0..30).map(|x| found.weight(30 + x)).collect();
        assert_eq!(row[6..12], [TUNING.max_glare; 6]);
        assert!(row[12] > row[13] && row[13] > 0.0 && row[14..] == [0.0; 16], "{row:?}");
    }

    #[test]
    fn planes_that_do_not_fit_are_refused() {
        let mask = |own, glare| GlareMask {
            own: Plane::filled(2, 1, own),
            glare: Plane::filled(2, 1, glare),
        };
        assert_eq!(mask(1, 0.0).check(), Ok(()));
        assert!(mask(0, 1.0).check().is_err() && mask(0, -0.1).check().is_err());
        let sizes = GlareMask { own: Plane::filled(1, 1, 0), glare: Plane::filled(2, 1, 0.0) };
        assert!(sizes.check().is_err());
    }

    #[test]
    fn the_hue_is_the_mean_color_of_own_pixels() {
        let colors = [Vec3::ONE, Vec3::new(1.0, 0.5, 0.0), Vec3::Z];
        let photo = Picture(Plane::from_fn(30, 9, |x, _| colors[x / 10]));
        let mask = |own: usize| {
            let pixels = Plane::from_fn(30, 9, |x, _| if x < 10 * own { 1.0 } else { 0.0 });
            GlareMask::of_window(&pixels, &photo, &Mask(Plane::filled(30, 9, 0.0)), 1e-3)
        };
        assert!((mask(1).hue(&photo) - Vec3::ONE).abs().max_element() < 1e-6);
        let want = Vec3::new(2.0, 1.5, 1.0);
        assert!((mask(2).hue(&photo) - want / luminance(want)).abs().max_element() < 1e-6);
        assert_eq!(mask(0).hue(&photo), Vec3::ONE, "without own pixels");
    }
}
