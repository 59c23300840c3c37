//! One pixel of a relit picture, from the photo and the shadings before and after an edit.
//!
//! Shadings are irradiance / pi, per channel, so that a diffuse surface shows reflectance x
//! shading. A `record` holds the shading of the pixel by each light after the edit, then the
//! residual, the shading that no light explains. The functions turn it in place into the
//! contribution of each light to the picture, then that of the residual. Colors are linear, in
//! units of the photo.

use glam::Vec3;

use crate::image::{PaintedPixel, REFLECTANCE, luminance, ratio, reflected, smooth_step};
use crate::tuning::tuning;

tuning! {
    /// Constants of one pixel of a relit picture.
    pub const TUNING: RelitPixelTuning {
        /// Level from which a channel counts as saturated, over the level at which the photo is
        /// clipped.
        white: f32 = 0.991,
            unit "1", source Derived("254 of 255 in sRGB"),
            effect "a smaller value lets more channels become brighter than the photo";
        /// Largest value of a saturated channel over that of the photo: two stops.
        max_headroom: f32 = 4.0,
            unit "1", source Taste, effect "a larger value makes a dimmed lamp fade later";
        /// Growth of the headroom with the distance from the edge of the saturated region.
        headroom_growth: f32 = 0.15,
            unit "1 / pixel", source Taste,
            effect "a larger value makes a step at that edge, a smaller one leaves small highlights white";
        /// Luminance, over that of the strongest light, at which a light begins to own a saturated
        /// pixel.
        rival: f32 = 0.5,
            unit "1", source Taste,
            effect "a larger value gives a pixel to fewer lights, and noise moves it between them";
        /// Shading below which a gain is not defined and is taken for 1.
        dark: f32 = 1e-9,
            unit "irradiance / pi", source Derived("single precision"),
            effect "a larger value leaves dark pixels as they are";
    }
}

/// The surface at a photo pixel.
pub struct SurfacePixel<'a> {
    /// The photo, 0 or more.
    pub photo: Vec3,
    /// Residual shading before the edit.
    pub residual: Vec3,
    /// Estimated albedo, 0..=1.
    pub albedo: Vec3,
    /// Photo over shading, inpainted where a light hides the surface, 0..=1.
    pub reflectance: Vec3,
    /// The paint layers of the edit.
    pub painted: PaintedPixel<'a>,
    /// Level at which the photo is clipped.
    pub white: f32,
    /// Factor by which a saturated channel may exceed the photo, 1..=`TUNING.max_headroom`;
    /// [`headroom`] gives it.
    pub headroom: f32,
}

/// A visible light at one of its own pixels.
pub struct OwnPixel {
    /// Index of the light in the record.
    pub light: usize,
    /// Albedo of its surface when it is off, 0..=1.
    pub albedo: f32,
    /// Radiance that the light shows before the edit.
    pub radiance: Vec3,
    /// Radiance after over before the edit.
    pub gain: Vec3,
    /// Radiance that the pixel shows beside that; below 0 it is taken away, down to black.
    pub added: Vec3,
}

/// A visible light at a pixel of its glare.
#[derive(Clone, Copy)]
pub struct GlarePixel {
    /// Index of the light in the record.
    pub light: usize,
    /// Weight of the glare, 0..1.
    pub weight: f32,
    /// Radiance after over before the edit.
    pub gain: Vec3,
}

/// A light that a pixel is split for.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Dominant {
    light: usize,
    /// Fraction of the pixel; those of all dominant lights sum to 1.
    fraction: f32,
    gain: Vec3,
}

/// Factor by which a saturated channel may exceed the photo, `away` pixels inside the edge of the
/// saturated region.
pub fn headroom(away: f32) -> f32 {
    (1.0 + TUNING.headroom_growth * away).min(TUNING.max_headroom)
}

/// Turns a record into contributions at a pixel that shows a light itself.
///
/// With the photo I, the shading E before the edit and E_k that of this light, the surface of
/// albedo A reflects `B (E - E_k)` with `B = min(A, I / (E - E_k))`. The remainder is emitted, and
/// goes with the gain; the added radiance is that of a lamp which the photo shows dark.
pub fn relight_own(surface: &SurfacePixel, own: &OwnPixel, before: &[Vec3], record: &mut [Vec3]) {
    let shading = before.iter().sum::<Vec3>() + surface.residual;
    let shown = unclip(surface.photo, surface.white, own.radiance, TUNING.max_headroom);
    let others = shading - before[own.light];
    let (reflectance, remainder) = split(shown, others, Vec3::splat(own.albedo));
    record.iter_mut().for_each(|layer| *layer *= reflectance);
    record[own.light] = (remainder * own.gain + own.added).max(Vec3::ZERO);
}

/// Turns a record into contributions by the estimated albedo alone, with the paint of the edit.
pub fn relight_physical(surface: &SurfacePixel, record: &mut [Vec3]) {
    let albedo = surface.painted.reflectance(surface.albedo, surface.photo);
    record.iter_mut().for_each(|layer| *layer *= albedo);
}

/// Turns a record into contributions by the ratio of photo and shading.
///
/// With the reflectance B = I / E, at most 1, each light contributes `B E'_k`, and the residual
/// also the unexplained light `I - B E`. Near saturation, and in the glare of a light, the pixel is
/// blended with its split for the lights that dominate it: there I / E does not determine the
/// surface.
pub fn relight_ratio(
    surface: &SurfacePixel,
    glare: Option<GlarePixel>,
    before: &[Vec3],
    record: &mut [Vec3],
) {
    let SurfacePixel { photo, residual, painted, white, .. } = surface;
    let shading = before.iter().sum::<Vec3>() + *residual;
    let shown = unclip(*photo, *white, surface.reflectance * shading, surface.headroom);
    let saturation = smooth_step(
        REFLECTANCE.saturation[0] * white,
        REFLECTANCE.saturation[1] * white,
        photo.max_element(),
    );
    let (weight, lights) = match glare {
        Some(GlarePixel { light, weight, gain }) => {
            (saturation.max(weight), vec![Dominant { light, fraction: 1.0, gain }])
        }
        None if saturation > 0.0 => (saturation, dominant(before, record)),
        None => (0.0, Vec::new()),
    };
    let reflectance = reflected(shown, shading);
    let unexplained = painted.tint(shown - (reflectance * shading).min(shown), shading);
    let reflectance = painted.reflectance(reflectance, shown);
    let shaded = if lights.is_empty() { Vec::new() } else { record.to_vec() };
    record.iter_mut().for_each(|layer| *layer *= reflectance);
    record[before.len()] += unexplained;
    if lights.is_empty() {
        return;
    }
    record.iter_mut().for_each(|layer| *layer *= 1.0 - weight);
    for Dominant { light, fraction, gain } in lights {
        let (reflectance, remainder) = split(shown, shading - before[light], surface.reflectance);
        let remainder = painted.tint(remainder, before[light]);
        let reflectance = painted.reflectance(reflectance, shown);
        let mut other: Vec<Vec3> = shaded.iter().map(|layer| *layer * reflectance).collect();
        other[light] = remainder * gain;
        record.iter_mut().zip(other).for_each(|(layer, other)| *layer += weight * fraction * other);
    }
}

/// The split of a pixel that one light dominates: the reflectance of the surface, at most `albedo`,
/// under the shading by all `others`, and the remainder of the pixel, 0 or more.
fn split(shown: Vec3, others: Vec3, albedo: Vec3) -> (Vec3, Vec3) {
    let others = others.max(Vec3::ZERO);
    let reflectance = ratio(shown, others).min(albedo);
    (reflectance, (shown - reflectance * others).max(Vec3::ZERO))
}

/// The lights that dominate a pixel. A light with `TUNING.rival` of the strongest light's luminance
/// has the fraction 0, and fractions rise smoothly from there: a little noise must not move a pixel
/// from one light to another.
fn dominant(before: &[Vec3], after: &[Vec3]) -> Vec<Dominant> {
    let most = before.iter().map(|light| luminance(*light)).fold(0.0, f32::max);
    let parts: Vec<f32> = before
        .iter()
        .map(|light| smooth_step(TUNING.rival * most, most, luminance(*light)))
        .collect();
    let sum = parts.iter().sum::<f32>();
    let all = parts.into_iter().enumerate().filter(|(_, part)| *part > 0.0);
    all.map(|(light, part)| Dominant {
        light,
        fraction: part / sum,
        gain: gain(before[light], after[light], Vec3::ONE),
    })
    .collect()
}

/// `after` over `before` per channel; `otherwise` in channels that are dark before.
pub fn gain(before: Vec3, after: Vec3, otherwise: Vec3) -> Vec3 {
    let channel =
        |c: usize| if before[c] > TUNING.dark { after[c] / before[c] } else { otherwise[c] };
    Vec3::new(channel(0), channel(1), channel(2))
}

/// The photo with saturated channels raised to those of `model`, by at most the factor `headroom`;
/// others stay.
fn unclip(photo: Vec3, white: f32, model: Vec3, headroom: f32) -> Vec3 {
    Vec3::select(
        photo.cmpge(Vec3::splat(TUNING.white * white)),
        photo.max(model.min(headroom * photo)),
        photo,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{AlphaMatte, PaintChange, PaintLayer, PaintLayers, Plane};

    const WALL: Vec3 = Vec3::new(0.5, 0.4, 0.2);
    const LAMP: Vec3 = Vec3::new(0.8, 0.6, 0.4);
    const WINDOW: Vec3 = Vec3::new(0.2, 0.3, 0.4);
    const RESIDUAL: Vec3 = Vec3::splat(0.1);

    fn surface(photo: Vec3, coats: &PaintLayers) -> SurfacePixel<'_> {
        SurfacePixel {
            photo,
            residual: RESIDUAL,
            albedo: Vec3::splat(0.3),
            reflectance: WALL,
            painted: coats.at(0, 0),
            white: 1.0,
            headroom: 2.0,
        }
    }

    #[track_caller]
    fn near(got: Vec3, want: Vec3) {
        assert!((got - want).abs().max_element() < 1e-5, "{got} against {want}");
    }

    fn sum(record: &[Vec3]) -> Vec3 {
        record.iter().sum()
    }

    #[test]
    fn without_an_edit_every_way_gives_the_photo_back() {
        let bare = PaintLayers::default();
        let before = [LAMP, WINDOW];
        let glare = Some(GlarePixel { light: 0, weight: 0.7, gain: Vec3::ONE });
        for photo in [
            WALL * 0.9,
            Vec3::new(0.6, 0.01, 0.0),
            Vec3::new(0.9, 0.8, 0.7),
            Vec3::splat(0.97),
            Vec3::ZERO,
        ] {
            for glare in [None, glare] {
                let mut record = [LAMP, WINDOW, RESIDUAL];
                relight_ratio(&surface(photo, &bare), glare, &before, &mut record);
                near(sum(&record), photo);
            }
            let own = OwnPixel {
                light: 1,
                albedo: 0.05,
                radiance: Vec3::splat(3.0),
                gain: Vec3::ONE,
                added: Vec3::ZERO,
            };
            let mut record = [LAMP, WINDOW, RESIDUAL];
            relight_own(&surface(photo, &bare), &own, &before, &mut record);
            near(sum(&record), photo);
        }
    }

    #[test]
    fn a_dark_lamp_that_is_switched_on_shines_over_its_surface() {
        let bare = PaintLayers::default();
        let (before, photo) = ([Vec3::ZERO, WINDOW], Vec3::new(0.05, 0.06, 0.07));
        let shown = |added: Vec3| {
            let own =
                OwnPixel { light: 0, albedo: 0.5, radiance: Vec3::ZERO, gain: Vec3::ONE, added };
            let mut record = [Vec3::ONE, WINDOW, RESIDUAL];
            relight_own(&surface(photo, &bare), &own, &before, &mut record);
            record
        };
        near(sum(&shown(Vec3::ZERO)), photo);
        near(sum(&shown(LAMP)), photo + LAMP);
        near(shown(LAMP)[0], LAMP);
        near(shown(-LAMP)[0], Vec3::ZERO);
    }

    #[test]
    fn a_surface_follows_its_lights_and_unexplained_light_stays() {
        let bare = PaintLayers::default();
        let (shading, extra) = (LAMP + WINDOW + RESIDUAL, Vec3::splat(0.0));
        let mut record = [0.5 * LAMP, WINDOW, RESIDUAL];
        relight_ratio(
            &surface(0.6 * WALL * shading + extra, &bare),
            None,
            &[LAMP, WINDOW],
            &mut record,
        );
        near(record[0], 0.6 * WALL * 0.5 * LAMP);
        near(record[1], 0.6 * WALL * WINDOW);
        near(record[2], 0.6 * WALL * RESIDUAL);
        // A reflectance above 1 is not one: twice the shading is a white surface and as much
        // unexplained light.
        let dim = 0.2 * shading;
        let mut record = [Vec3::ZERO, 0.2 * WINDOW, Vec3::ZERO];
        let dark =
            SurfacePixel { residual: Vec3::ZERO, ..surface(2.0 * (dim - 0.2 * RESIDUAL), &bare) };
        relight_ratio(&dark, None, &[0.2 * LAMP, 0.2 * WINDOW], &mut record);
        near(record[1], 0.2 * WINDOW);
        near(record[2], dim - 0.2 * RESIDUAL);
    }

    #[test]
    fn a_saturated_pixel_is_split_for_its_strongest_light() {
        let bare = PaintLayers::default();
        let strong = 4.0 * LAMP;
        let mut record = [Vec3::ZERO, WINDOW, RESIDUAL];
        relight_ratio(&surface(Vec3::ONE, &bare), None, &[strong, WINDOW], &mut record);
        // The lamp is off: the surface of reflectance WALL under all else is left, and no white.
        near(record[0], Vec3::ZERO);
        near(record[1], WALL * WINDOW);
        near(record[2], WALL * RESIDUAL);
    }

    #[test]
    fn two_rivals_share_a_pixel_and_a_weak_light_has_no_part() {
        let lights = [Vec3::ONE, Vec3::ONE, Vec3::splat(0.49)];
        let found = dominant(&lights, &[Vec3::ONE, Vec3::ZERO, Vec3::ONE]);
        let want = |light, gain| Dominant { light, fraction: 0.5, gain };
        assert_eq!(found, [want(0, Vec3::ONE), want(1, Vec3::ZERO)]);
        // Three quarters of the strongest: halfway up the step.
        let found = dominant(&[Vec3::ONE, Vec3::splat(0.75)], &[Vec3::ONE; 2]);
        assert!((found[1].fraction - 0.5 / 1.5).abs() < 1e-6);
    }

    #[test]
    fn glare_goes_with_its_light() {
        let bare = PaintLayers::default();
        let before = [LAMP, WINDOW];
        let photo = WALL * (LAMP + WINDOW + RESIDUAL) + Vec3::new(0.1, 0.1, 0.05);
        let lit = |weight: f32| {
            let mut record = [Vec3::ZERO, WINDOW, RESIDUAL];
            let glare = GlarePixel { light: 0, weight, gain: Vec3::ZERO };
            relight_ratio(&surface(photo, &bare), Some(glare), &before, &mut record);
            sum(&record)
        };
        near(lit(1.0), WALL * (WINDOW + RESIDUAL));
        // Weights blend.
        let mut plain = [Vec3::ZERO, WINDOW, RESIDUAL];
        relight_ratio(&surface(photo, &bare), None, &before, &mut plain);
        near(lit(0.25), 0.75 * sum(&plain) + 0.25 * lit(1.0));
    }

    #[test]
    fn an_own_pixel_shows_its_shade_when_the_light_is_off() {
        let bare = PaintLayers::default();
        let own = OwnPixel { light: 0, albedo: 0.5, radiance: Vec3::splat(9.0), gain: Vec3::ZERO };
        let mut record = [Vec3::ZERO, WINDOW, RESIDUAL];
        relight_own(&surface(Vec3::ONE, &bare), &own, &[LAMP, WINDOW], &mut record);
        near(sum(&record), 0.5 * (WINDOW + RESIDUAL));
        // Burning on, saturated channels show the model's radiance, but two stops above white at
        // most.
        let on = OwnPixel { gain: Vec3::ONE, ..own };
        for (radiance, want) in [(0.5, 1.0), (3.0, 3.0), (9.0, TUNING.max_headroom)] {
            let mut record = [LAMP, WINDOW, RESIDUAL];
            let on = OwnPixel { radiance: Vec3::splat(radiance), ..on };
            relight_own(&surface(Vec3::ONE, &bare), &on, &[LAMP, WINDOW], &mut record);
            near(sum(&record), Vec3::splat(want));
        }
    }

    #[test]
    fn physical_is_albedo_times_shading_with_paint() {
        let bare = PaintLayers::default();
        let mut record = [0.5 * LAMP, WINDOW, RESIDUAL];
        relight_physical(&surface(Vec3::splat(0.7), &bare), &mut record);
        near(sum(&record), 0.3 * (0.5 * LAMP + WINDOW + RESIDUAL));
        let paint = PaintChange {
            old: Vec3::splat(0.3),
            new: Vec3::new(0.1, 0.2, 0.6),
            keep_texture: true,
        };
        let matte = AlphaMatte { alpha: Plane::filled(1, 1, 1.0), boundary: vec![] };
        let blue = PaintLayers(vec![PaintLayer { paint, matte }]);
        let mut record = [LAMP, WINDOW, RESIDUAL];
        relight_physical(&surface(Vec3::splat(0.7), &blue), &mut record);
        near(record[0], Vec3::new(0.1, 0.2, 0.6) * LAMP);
    }

    #[test]
    fn only_saturated_channels_are_raised() {
        let raised = unclip(Vec3::new(1.0, 0.995, 0.9), 1.0, Vec3::new(1.5, 8.0, 8.0), 2.0);
        near(raised, Vec3::new(1.5, 1.99, 0.9));
        assert_eq!(unclip(Vec3::ONE, 1.0, Vec3::ZERO, 2.0), Vec3::ONE, "never darker");
        assert_eq!((headroom(0.0), headroom(1e9)), (1.0, TUNING.max_headroom));
    }

    #[test]
    fn the_gain_of_a_dark_channel_is_given() {
        assert_eq!(
            gain(Vec3::new(2.0, 0.0, 1.0), Vec3::new(1.0, 5.0, 0.0), Vec3::splat(7.0)),
            Vec3::new(0.5, 7.0, 0.0)
        );
    }
}
