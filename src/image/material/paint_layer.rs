//! Paint layers over a photo.
//!
//! The color of a surface of paint `old` is split by the dichromatic model (Shafer, Using Color to
//! Separate Reflection Components, 1985): its reflectance is `b = d old + s 1 + r`, with d the body
//! (shading that the model misses, and texture without color), s the gloss, which has the color of
//! the light and not of the paint, and r what remains: texture of another color. d and s minimize
//! `|r|^2 + gloss s^2`, s >= 0: on gray paint, where gloss and body look the same, all is body, and
//! so it is on pale paint, whose color the light of another lamp changes as much as gloss does.
//! Gloss only adds light, so s is at most what the reflectance has above the luminance of `old`: a
//! wall that a cooler light shades is not glossy. Of s some deviations of its noise are taken,
//! since gray specks on a dark yellow wall are the noise of its blue. The new paint then gives
//! `d new + s 1 + g r` with `g = new old / (old^2 + noise^2)`, Wiener's filter for new / old: the
//! faint reflection of a dark paint is noise. Except for the bounds of s the map is linear, and
//! takes `old` to `new` exactly: where `old` is the mean of a region, `new` becomes its mean.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::image::{Plane, luminance, smooth_step};
use crate::tuning::tuning;

tuning! {
    /// Constants of paint layers.
    pub const TUNING: PaintLayerTuning {
        /// Cost of gloss. Gloss is separable from a body color some ten degrees off gray.
        gloss: f32 = 0.1,
            unit "1", source Taste, effect "a larger value leaves gloss in the body";
        /// Deviations of the noise of gloss that are not gloss.
        deviations: f32 = 3.0,
            unit "deviations", source Derived("one pixel of 740 is brighter in normal noise"),
            effect "a larger value leaves faint gloss in the body";
        /// Angles between the color of a paint and gray below which all is body, and above which
        /// gloss is separated.
        pale: [f32; 2] = [0.2, 0.4],
            unit "rad", source Taste,
            effect "larger values let less of a paint be gloss";
        /// Standard deviation of the noise of an estimated reflectance.
        noise: f32 = 0.02,
            unit "reflectance", source Taste, effect "a larger value removes texture of dark paint";
        /// Least value by which the photo and the reflectance of a mixed pixel are divided.
        dark: f32 = 1e-6,
            unit "units of the photo; reflectance", source Derived("single precision"),
            effect "a larger value leaves more of the old paint in dark mixed pixels";
        /// Least channel of the color of the light by which unexplained light is divided.
        min_source: f32 = 0.05,
            unit "its luminance", source Taste, effect "a smaller value amplifies noise under saturated light";
    }
}

/// One paint in place of another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PaintChange {
    /// Mean reflectance of the surface as it is, above 0.
    pub old: Vec3,
    /// Mean reflectance as it shall be.
    pub new: Vec3,
    /// Keeps the texture of the surface; else the new paint is even.
    pub keep_texture: bool,
    /// Standard deviation of the noise of a pixel's reflectance, 0 or more.
    pub noise: Vec3,
}

impl PaintChange {
    /// The reflectance after the change, with its color kept: at most 1, or the largest channel of
    /// `new` or of `reflectance`.
    pub fn over(&self, reflectance: Vec3) -> Vec3 {
        if !self.keep_texture {
            return self.new;
        }
        let brighter = (luminance(reflectance) - luminance(self.old)).max(0.0);
        let painted = self.textured(reflectance, brighter);
        let most = self.new.max_element().max(reflectance.max_element()).max(1.0);
        painted / (painted.max_element() / most).max(1.0)
    }

    /// Unexplained light of the old paint, as the new paint reflects it: 0 or more, without an
    /// upper limit.
    pub fn tint(&self, light: Vec3) -> Vec3 {
        self.textured(light, f32::MAX)
    }

    /// The fraction of gloss that can be told from light of another color, 0 on pale paint.
    fn separable(&self) -> f32 {
        let angle = self.old.angle_between(Vec3::ONE);
        let [none, all] = TUNING.pale;
        smooth_step(none, all, angle)
    }

    /// The new color of `b`, of which at most `most` is gloss.
    fn textured(&self, b: Vec3, most: f32) -> Vec3 {
        let (a_a, a_1, one_1) =
            (self.old.length_squared(), self.old.element_sum(), 3.0 + TUNING.gloss);
        let (a_b, one_b) = (self.old.dot(b), b.element_sum());
        let divisor = a_a * one_1 - a_1 * a_1;
        let noise = ((Vec3::splat(a_a) - a_1 * self.old) * self.noise).length() / divisor;
        let gloss = (a_a * one_b - a_1 * a_b) / divisor - TUNING.deviations * noise;
        let gloss = self.separable() * gloss.clamp(0.0, b.min_element().clamp(0.0, most));
        let body = (a_b - gloss * a_1) / a_a;
        let remains = b - body * self.old - Vec3::splat(gloss);
        let kept = self.new * self.old / (self.old * self.old + TUNING.noise * TUNING.noise);
        (body * self.new + Vec3::splat(gloss) + kept * remains).max(Vec3::ZERO)
    }
}

/// One paint change on a region of a photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PaintLayer {
    /// The change of paint.
    pub paint: PaintChange,
    /// The region.
    pub matte: AlphaMatte,
}

/// The fraction of each pixel that belongs to a surface, and the color of that surface in mixed
/// pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AlphaMatte {
    /// Fraction of each pixel, 0..=1.
    pub alpha: Plane<f32>,
    /// Color of the surface alone in each mixed pixel: pixel index, row by row, in rising order,
    /// and linear color.
    pub boundary: Vec<(u32, [f32; 3])>,
}

impl AlphaMatte {
    /// Color of the surface alone at pixel (x, y), where the pixel is mixed.
    fn own(&self, x: usize, y: usize) -> Option<Vec3> {
        let at = (y * self.alpha.width() + x) as u32;
        self.boundary
            .binary_search_by_key(&at, |(pixel, _)| *pixel)
            .ok()
            .map(|i| Vec3::from_array(self.boundary[i].1))
    }
}

/// PaintLayers one over the other, the first at the bottom. All have the photo's size.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PaintLayers(pub Vec<PaintLayer>);

impl PaintLayers {
    /// Checks that all layers have one size.
    ///
    /// # Errors
    /// The rule that does not hold.
    pub fn check(&self) -> Result<(), String> {
        let sizes = || self.0.iter().map(|layer| layer.matte.alpha.size());
        crate::image::rule(sizes().zip(sizes().skip(1)).all(|(a, b)| a == b), "layers of one size")
    }

    /// Memory held, in bytes.
    pub fn bytes(&self) -> usize {
        self.0.iter().map(|layer| layer.matte.alpha.bytes() + 16 * layer.matte.boundary.len()).sum()
    }

    /// The layers on pixel (x, y).
    pub fn at(&self, x: usize, y: usize) -> PaintedPixel<'_> {
        let on = self
            .0
            .iter()
            .map(|layer| (layer.matte.alpha.get(x, y), layer))
            .filter(|(share, _)| *share > 0.0);
        PaintedPixel(
            on.map(|(share, layer)| (share, &layer.paint, layer.matte.own(x, y))).collect(),
        )
    }
}

/// The paint layers on one pixel: fraction of the pixel, paint, and color of the painted surface
/// alone.
pub struct PaintedPixel<'a>(Vec<(f32, &'a PaintChange, Option<Vec3>)>);

impl PaintedPixel<'_> {
    /// Whether no paint lies on the pixel.
    pub fn is_bare(&self) -> bool {
        self.0.is_empty()
    }

    /// The reflectance of the pixel, which is `bare` without paint and shows `photo`.
    ///
    /// In a pixel of two surfaces the painted one removes its fraction of the shown radiance and
    /// adds that fraction in its new paint.
    pub fn reflectance(&self, bare: Vec3, photo: Vec3) -> Vec3 {
        self.0.iter().fold(bare, |below, &(share, paint, own)| {
            let per_light = bare / photo.max(Vec3::splat(TUNING.dark));
            let own = own.map_or(bare, |own| own * per_light);
            let left = Vec3::ONE - share * own / bare.max(Vec3::splat(TUNING.dark));
            below * left.max(Vec3::ZERO) + share * paint.over(own)
        })
    }

    /// Reflected light of unknown cause; `light` is the same without paint. `source` is the color
    /// of the incident light.
    pub fn tint(&self, light: Vec3, source: Vec3) -> Vec3 {
        if self.is_bare() {
            return light;
        }
        let source = source / luminance(source).max(1e-9);
        let white = source.max(Vec3::splat(TUNING.min_source));
        self.0.iter().fold(light, |below, &(share, paint, _)| {
            below.lerp(paint.tint(light / white) * white, share)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WALL: Vec3 = Vec3::new(0.5, 0.2, 0.1);
    const NEW: Vec3 = Vec3::new(0.1, 0.3, 0.6);

    fn paint(old: Vec3, keep_texture: bool) -> PaintChange {
        PaintChange { old, new: NEW, keep_texture, noise: Vec3::ZERO }
    }

    #[track_caller]
    fn check(got: Vec3, want: Vec3, tolerance: f32) {
        assert!((got - want).abs().max_element() < tolerance, "{got} against {want}");
    }

    #[test]
    fn old_becomes_new_and_shading_stays() {
        for old in [WALL, Vec3::splat(0.4), Vec3::new(0.3, 0.31, 0.33)] {
            for level in [0.1, 0.5, 1.0, 1.3] {
                check(paint(old, true).over(level * old), level * NEW, 1e-5);
                check(paint(old, false).over(level * old), NEW, 1e-6);
            }
        }
    }

    #[test]
    fn the_mean_of_a_texture_is_the_new_paint() {
        let spots = [
            Vec3::new(0.05, 0.02, -0.01),
            Vec3::new(-0.08, -0.03, 0.0),
            Vec3::new(0.03, 0.01, 0.01),
        ];
        let old = Vec3::splat(0.4);
        let mean = spots.iter().map(|&spot| paint(old, true).over(old + spot)).sum::<Vec3>() / 3.0;
        // Wiener's filter takes 0.02^2 / 0.4^2 of the color of the texture, whose mean is 0.
        check(mean, NEW, 1e-4);
    }

    #[test]
    fn gloss_on_a_color_keeps_the_color_of_the_light() {
        // GLOSS holds back a ninth of it (0.1 of 0.1 + |1|^2 sin^2 = 0.9), which the ratio of blue,
        // 6, makes 0.1; all of it would be 1.
        let got = paint(WALL, true).over(WALL + Vec3::splat(0.2));
        check(got, NEW + Vec3::splat(0.2), 0.11);
    }

    #[test]
    fn specks_of_noise_are_no_gloss() {
        let yellow = paint(Vec3::new(0.4, 0.3, 0.05), true);
        let noisy = PaintChange { noise: Vec3::new(0.01, 0.01, 0.05), ..yellow };
        let speck = yellow.old + Vec3::new(0.01, 0.01, 0.08);
        assert!(yellow.tint(speck).x > 1.4 * NEW.x && noisy.tint(speck).x < 1.05 * NEW.x);
        // Gloss beyond the noise is gloss.
        assert!(noisy.tint(yellow.old + Vec3::splat(0.3)).x > NEW.x + 0.1);
    }

    #[test]
    fn a_cooler_light_is_no_gloss() {
        // Blocks of a compressed photo, as bright as the paint or darker, and grayer than it.
        let cool = Vec3::new(0.4, 0.24, 0.18);
        let got = paint(WALL, true).over(cool * luminance(WALL) / luminance(cool));
        let dark = paint(WALL, true).over(0.5 * cool);
        // Without gloss each is a sum of its body and of what the filter leaves of its color.
        assert!(got.z > got.y && got.y > 2.5 * got.x, "{got}");
        assert!(dark.z > dark.y && dark.y > 2.5 * dark.x, "{dark}");
    }

    #[test]
    fn light_of_another_color_is_no_gloss_on_a_pale_wall() {
        // A cream wall, brighter where the light is bluer.
        let cream = Vec3::new(0.6, 0.53, 0.45);
        let light = Vec3::new(1.2, 1.35, 1.6);
        let got = paint(cream, true).over(cream * light);
        // The new paint in that light, but for 0.02^2 / 0.45^2 that the filter takes.
        check(got, NEW * light, 0.01);
    }

    #[test]
    fn white_spots_do_not_glow() {
        let got = paint(Vec3::new(0.5, 0.05, 0.02), true).over(Vec3::splat(0.9));
        assert!(got.max_element() <= 1.0, "{got}");
    }

    #[test]
    fn a_shared_pixel_changes_by_its_share() {
        let (share, other) = (0.3, Vec3::splat(0.8));
        let photo = share * WALL + (1.0 - share) * other;
        let plane = Plane::filled(2, 1, share);
        let matte = AlphaMatte { alpha: plane, boundary: vec![(1, WALL.to_array())] };
        let layers = PaintLayers(vec![PaintLayer { paint: paint(WALL, true), matte }]);
        // Under even light of 2, reflectance is half of the shown radiance.
        let got = layers.at(1, 0).reflectance(photo / 2.0, photo);
        let want = share * paint(WALL, true).over(WALL / 2.0) + (1.0 - share) * other / 2.0;
        check(got, want, 1e-5);
        check(PaintLayers::default().at(0, 0).reflectance(photo, photo), photo, 0.0001);
    }
}
