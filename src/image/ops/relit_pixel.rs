//! One pixel of a relit picture, from the photo and the shadings before and after an edit.
//!
//! Shadings are irradiance / pi, per channel, so that a diffuse surface shows reflectance x
//! shading. A `record` holds the shading of the pixel by each light after the edit, then the
//! residual, the shading that no light explains. The functions turn it in place into the
//! contribution of each light to the picture, then that of the residual. Colors are linear, in
//! units of the photo.

use glam::Vec3;
use half::f16;

use crate::image::{
    GlareMask, Mask, PaintedPixel, Picture, Plane, REFLECTANCE, distance, limited, luminance,
    ratio, smooth_step,
};
use crate::tuning::tuning;

tuning! {
    /// Constants of one pixel of a relit picture.
    pub const TUNING: RelitPixelTuning {
        /// Levels of a channel of a saturated pixel, over that at which the photo is clipped, from
        /// which on saturation hides its light and up to which it hides all of it: 231 and 250 of
        /// 255 in sRGB.
        shoulder: [f32; 2] = [0.8, 0.95],
            unit "1", source Derived("highlight shoulders of cameras"),
            effect "smaller values let more channels become brighter than the photo";
        /// Distance from a saturated region up to which channels in the shoulder may have been
        /// brighter than the photo.
        shoulder_reach: f32 = 8.0,
            unit "pixels", source Measured("lamps of real photos dimmed to 0.3; by eye"),
            effect "a smaller value makes an edge around white";
        /// Longer side of the photos for which the constants in pixels hold; in larger photos,
        /// light falls off over as many times more pixels.
        photo_side: f32 = 640.0,
            unit "pixels", source Derived("the photos by which these constants were chosen"),
            effect "a larger value treats large photos as if their edges were blurred less";
        /// Largest distance of a pixel of a saturated region from a saturated one: noise and
        /// compression leave pixels just below white.
        closing: f32 = 2.0,
            unit "pixels", source Measured("windows of scenes/demo dimmed; by eye"),
            effect "a larger value takes wider bars before a window for light";
        /// Largest channel of a window's pixel over white from which on it shows a view that is
        /// hardly darker than white, and not a bar or a frame.
        falloff: f32 = 0.8,
            unit "1", source Measured("windows of sunlit and nyu_0579 dimmed; by eye"),
            effect "a smaller value dims panes towards bright bars";
        /// Fraction of a square, twice as wide as `closing`, below which such pixels are noise.
        few: f32 = 0.1,
            unit "1", source Taste, effect "a larger value overlooks small parts of a view";
        /// Weight of the model's own level beside the channels of a surface that are not saturated.
        model_trust: f32 = 0.01,
            unit "1", source Taste,
            effect "a larger value follows the model more, and texture in unsaturated channels less";
        /// Largest value of a saturated channel of a window's own pixel over that of the photo: two
        /// stops.
        max_headroom: f32 = 4.0,
            unit "1", source Taste, effect "a larger value makes a dimmed window fade later";
        /// The same for a lamp that is white all over.
        lamp_headroom: f32 = 3.0,
            unit "1", source Measured("lamps of real photos dimmed to 0.3; by eye"),
            effect "a larger value makes a dimmed lamp fade later, with harder edges where it is just below white";
        /// Hue of the cloth of a shade, of luminance 1: cream.
        cloth: [f32; 3] = [1.06, 0.99, 0.93],
            unit "1", source Measured("five lamps of rendered rooms that are off: hue 1.04 to 1.24 times too blue without it"),
            effect "a larger red makes a shade that is off warmer than its wall";
        /// Least channel over white of a pixel within white that is noise.
        noise: f32 = 0.84,
            unit "1", source Measured("identity edit of real photos; lamps dimmed to 0.3; by eye"),
            effect "a smaller value makes single pixels of the photo whiter";
        /// Width of the blurred edge of a lamp, which does not show how bright the lamp is. The
        /// headroom rises over two such widths.
        lamp_edge: f32 = 4.0,
            unit "pixels", source Measured("lamps of real photos dimmed to 0.3; by eye"),
            effect "a smaller value gives dimmed lamps a rim, a larger one a broad dark edge";
        /// The same over the side of a square of the lamp's area, at most.
        lamp_rise: f32 = 0.125,
            unit "1", source Derived("the middle half of a lamp has all of its headroom"),
            effect "a larger value makes small lamps gray when dimmed";
        /// Distance up to which the pixels that tell it are counted, along each axis, over the side
        /// of a square of the lamp's area.
        lamp_reach: f32 = 0.5,
            unit "1", source Measured("lamps of real photos dimmed to 0.3; by eye"),
            effect "a smaller value makes an edge in a dimmed lamp where it is just below white";
        /// Fraction of the pixels there from which on they decide.
        lamp_told: f32 = 0.2,
            unit "1", source Measured("lamps of real photos dimmed to 0.3; by eye"),
            effect "a smaller value makes gray patches in a dimmed lamp";
        /// Least excess of the light of white surfaces over white.
        surface_excess: f32 = 0.3,
            unit "1", source Measured("13 rooms through a camera model, with 0, 0.3 and 0.6"),
            effect "a larger value keeps white when one of its lights is off";
        /// Growth of that with the distance from the edge of the saturated region.
        surface_growth: f32 = 0.03,
            unit "1 / pixel", source Measured("lamps of real photos dimmed to 0.3; by eye"),
            effect "a larger value makes a step at that edge";
        /// Growth of the headroom of a window with the distance from bright pixels of it of which a
        /// channel is not saturated: the view beside them is hardly brighter than white.
        falloff_growth: f32 = 0.03,
            unit "1 / pixel", source Measured("nyu_0579 and sunlit dimmed to 0.3; by eye"),
            effect "a larger value makes spots where a view is just below white";
        /// Weight of lights out of view beside those in view where windows share the residual.
        unseen_rival: f32 = 0.3,
            unit "1", source Measured("36 rooms made for tuning"),
            effect "a larger value leaves more of the residual when a window is off";
        /// Weight of windows in view beside other lights where lights share what their shading
        /// lacks: what is brighter than its model is mostly in a sun that was not found.
        missing_window: f32 = 10.0,
            unit "1", source Measured("four third-party scenes and 20 rooms made for tuning, with 1 to 200; docs/estimation.md"),
            effect "a smaller value leaves patches of sun when their window is off; a larger one gives halos of lamps to windows";
        /// Power of a light's strength by which lights share what they lack even before a surface
        /// that reflects all of their light.
        excess_power: i32 = 3,
            unit "1", source Measured("nyu_0958 with a lamp off, third-party scenes and 20 rooms made for tuning, with 1 to 4; docs/estimation.md"),
            effect "a smaller value leaves pale patches where a lamp that is off was white; a larger one makes edges between the patches of two lights";
        /// Largest reflectance for the light that an edit adds: of white paint. Where photo over
        /// shading is above it, the shading is mostly too low.
        white_paint: f32 = 0.8,
            unit "1", source Measured("lamps inserted into 20 rooms made for tuning, with 0.5 to 1; docs/estimation.md"),
            effect "a larger value makes the light of inserted lamps too strong; a smaller one too weak on white walls";
        /// Shading below which a gain is not defined and is taken for 1.
        dark: f32 = 1e-9,
            unit "irradiance / pi", source Derived("single precision"),
            effect "a larger value leaves dark pixels as they are";
    }
}

impl RelitPixelTuning {
    /// Pixels of a photo of `size` in one of these constants.
    pub(super) fn scale(&self, (width, height): (usize, usize)) -> f32 {
        (width.max(height) as f32 / self.photo_side).max(1.0)
    }
}

/// The surface at a photo pixel.
pub struct SurfacePixel<'a> {
    /// The photo, 0 or more.
    pub photo: Vec3,
    /// The photo without the noise of dark pixels, which lights that the edit adds do not see.
    pub denoised: Vec3,
    /// Residual shading before the edit.
    pub residual: Vec3,
    /// Estimated albedo, 0..=1.
    pub albedo: Vec3,
    /// Photo over shading, inpainted where a light hides the surface, 0..=`REFLECTANCE.excess`.
    pub reflectance: Vec3,
    /// The paint layers of the edit.
    pub painted: PaintedPixel<'a>,
    /// Weight of each light of the record where the lights share what their shading lacks; 1 for
    /// the residual.
    pub weights: &'a [f32],
    /// Level at which the photo is clipped.
    pub white: f32,
    /// Index of the lamp whose light before the edit is asked for.
    pub lamp: Option<usize>,
    /// The light of the pixel before saturation: of channels that are saturated, that of the photo
    /// or more; [`SaturatedRegions::raised`] gives it.
    pub unsaturated: Vec3,
}

impl SurfacePixel<'_> {
    fn shadings<'b>(&'b self, before: &'b [Vec3]) -> Shadings<'b> {
        Shadings { lights: before, residual: self.residual, weights: self.weights }
    }
}

/// A visible light at one of its own pixels.
pub struct OwnPixel {
    /// Index of the light in the record.
    pub light: usize,
    /// Albedo of its surface when it is off, 0..=1.
    pub albedo: Vec3,
    /// Radiance that the light shows before the edit, in the color of its pixels.
    pub radiance: Vec3,
    /// Factor by which a saturated channel may exceed the photo, 1..=`TUNING.max_headroom`.
    pub headroom: f32,
    /// Radiance after over before the edit.
    pub gain: Vec3,
    /// Radiance added to the product of gain and emitted radiance; a negative sum becomes 0.
    pub added: Vec3,
}

/// A visible light at a pixel of its glare.
#[derive(Clone, Copy)]
pub struct GlarePixel {
    /// Index of the light in the record.
    pub light: usize,
    /// Weight of the glare, 0..1.
    pub weight: f32,
    /// The residual shading is this light's, too: at the frame of a window, which its light grazes.
    pub owns_residual: bool,
    /// Radiance after over before the edit.
    pub gain: Vec3,
}

/// The light of a photo pixel before the edit.
#[derive(Clone, Copy, Debug, Default)]
pub struct PixelLight {
    /// From all lights and the residual.
    pub all: Vec3,
    /// From [`SurfacePixel::lamp`].
    pub of_lamp: Vec3,
}

impl PixelLight {
    /// The light of a pixel of which another surface with the light `other` covers the fraction
    /// `coverage`.
    pub fn covered(self, other: PixelLight, coverage: f32) -> PixelLight {
        PixelLight {
            all: self.all.lerp(other.all, coverage),
            of_lamp: self.of_lamp.lerp(other.of_lamp, coverage),
        }
    }
}

/// The saturated regions of a photo, and how much brighter than the photo a pixel of them may be.
///
/// Regions are closed (a dilation, then an erosion by `TUNING.closing`). The headroom grows from
/// their edges inwards. Distances are half floats, as their planes have the photo's size.
pub struct SaturatedRegions {
    /// Distance of each pixel from the edge of its region, pixels; outside, less 0 that from the
    /// nearest region.
    away: Plane<f16>,
    /// Distance from the nearest pixel of which a channel is left, but for dark ones and their
    /// edges; 0 outside of the regions, and without a value where no window is in view.
    away_from_falloff: Option<Plane<f16>>,
    /// Level at which the photo is clipped.
    white: f32,
    /// Pixels of this photo in one of `TUNING`.
    scale: f32,
}

impl SaturatedRegions {
    /// The regions of `photo`, which is clipped at `white` where `clipped` is 1. `windows`
    /// are those in view.
    pub fn new(
        photo: &Picture,
        clipped: &Mask,
        white: f32,
        windows: &[&GlareMask],
    ) -> SaturatedRegions {
        let (width, height) = photo.0.size();
        let scale = TUNING.scale((width, height));
        let closing = TUNING.closing * scale;
        if !clipped.0.pixels().iter().any(|&share| share >= 0.5) {
            let away = Plane::filled(width, height, f16::NEG_INFINITY);
            return SaturatedRegions { away, away_from_falloff: None, white, scale };
        }
        let away = || {
            let near = distance(&clipped.0.map(|share| share >= 0.5));
            let outside = near.map(|away| away > closing);
            let mut away = distance(&outside).map(|away| (away - closing).max(0.0));
            let both = away.pixels_mut().iter_mut().zip(near.pixels());
            both.filter(|(away, _)| **away <= 0.0).for_each(|(away, near)| *away = -near);
            away.map(f16::from_f32)
        };
        let away_from_falloff = || {
            let is_frame = |i: usize| {
                photo.0.pixels()[i].max_element() < TUNING.falloff * white
                    || !windows.iter().any(|window| window.is_own(i))
            };
            // The blurred edge of a frame is as narrow as what closes a region.
            let from_frame =
                distance(&Plane::new(width, height, (0..width * height).map(is_frame).collect()));
            let is_falloff = |i: usize| {
                photo.0.pixels()[i].min_element() < TUNING.shoulder[1] * white
                    && from_frame.pixels()[i] > closing
            };
            let mut falloff: Vec<bool> = (0..width * height).map(is_falloff).collect();
            drop_few(&mut falloff, width, (2.0 * closing) as usize + 1);
            distance(&Plane::new(width, height, falloff))
        };
        let (away, away_from_falloff) =
            rayon::join(away, || (!windows.is_empty()).then(away_from_falloff));
        // Outside of the regions nobody asks for it, and zeros take no memory.
        let inside = |from_falloff: Plane<f32>| {
            let value = |i: usize| match away.pixels()[i] > f16::ZERO {
                true => f16::from_f32(from_falloff.pixels()[i]),
                false => f16::ZERO,
            };
            Plane::sparse(width, height, value)
        };
        let away_from_falloff = away_from_falloff.map(inside);
        SaturatedRegions { away, away_from_falloff, white, scale }
    }

    /// The light before saturation at pixel `i` of a surface, for which `light` is an estimate: in
    /// white no less than `TUNING.surface_excess` above the `photo`, and the photo itself from
    /// `TUNING.shoulder_reach` away from a region on.
    pub fn raised(&self, i: usize, photo: Vec3, light: Vec3) -> Vec3 {
        let away = f32::from(self.away.pixels()[i]) / self.scale;
        if away <= 0.0 {
            let share = 1.0 + (away / TUNING.shoulder_reach).max(-1.0);
            return photo.lerp(light.max(photo), share);
        }
        let [from, to] = REFLECTANCE.saturation.map(|level| level * self.white);
        let excess = (TUNING.surface_growth * away).min(TUNING.surface_excess);
        let least = (1.0 + smooth_step(from, to, photo.min_element()) * excess) * photo;
        // In the hue of the light: white has none.
        let factor = ratio(least, light).max_element().clamp(1.0, 1.0 + excess);
        least.max(factor * light)
    }

    /// Factor by which a saturated channel of a window's own pixel may exceed the photo at pixel
    /// `i`, 1..=`TUNING.max_headroom`. A region ends at the frame, where the headroom is that of
    /// the middle; it grows from where a channel is left that says how bright the view is, so that
    /// no spots arise there.
    pub fn headroom_of_window(&self, i: usize) -> f32 {
        match &self.away_from_falloff {
            Some(away) if self.away.pixels()[i] > f16::ZERO => {
                let growth = TUNING.falloff_growth * f32::from(away.pixels()[i]) / self.scale;
                (1.0 + growth).min(TUNING.max_headroom)
            }
            _ => 1.0,
        }
    }
}

/// Clears the marks in each square of `side` pixels that has hardly any: they are noise.
fn drop_few(marks: &mut [bool], width: usize, side: usize) {
    for rows in marks.chunks_mut((width * side).max(1)) {
        for left in (0..width).step_by(side) {
            let columns = left..width.min(left + side);
            let count = |row: &[bool]| row[columns.clone()].iter().filter(|mark| **mark).count();
            let few = TUNING.few * (side * side) as f32;
            if (rows.chunks(width).map(count).sum::<usize>() as f32) < few {
                rows.chunks_mut(width).for_each(|row| row[columns.clone()].fill(false));
            }
        }
    }
}

/// Turns a record into contributions at a pixel that shows a light itself.
///
/// With the photo I, the shading E before the edit and E_k that of this light, the surface of
/// albedo A reflects `B (E - E_k)` with `B = min(A, I / (E - E_k))`; A is scaled by as much as the
/// surface around is brighter than its shading. The remainder R is emitted, and becomes
/// `gain R + added`.
///
/// Returns the light before the edit.
pub fn relight_own(
    surface: &SurfacePixel,
    own: &OwnPixel,
    before: &[Vec3],
    record: &mut [Vec3],
) -> PixelLight {
    let shown = unclip_own(surface.photo, surface.white, own.radiance, own.headroom);
    // The surface around tells by how much the shading is too low.
    let excess = surface.reflectance.max_element().max(1.0);
    let factors = Factors::new(Vec3::splat(excess), surface.shadings(before));
    let reflected = own.albedo * factors.reflected(|k| k == own.light);
    let (fraction, remainder) = split(shown, reflected);
    factors.apply(own.albedo * fraction, record);
    record[own.light] = (remainder * own.gain + own.added).max(Vec3::ZERO);
    let of_lamp = surface.lamp.map(|lamp| match lamp == own.light {
        true => remainder,
        false => own.albedo * fraction * factors.reflected_from(lamp),
    });
    PixelLight { all: shown, of_lamp: of_lamp.unwrap_or(Vec3::ZERO) }
}

/// Turns a record into contributions by the estimated albedo alone, with the paint of the edit.
pub fn relight_physical(surface: &SurfacePixel, record: &mut [Vec3]) {
    let albedo = surface.painted.reflectance(surface.albedo, surface.photo);
    record.iter_mut().for_each(|layer| *layer *= albedo);
}

/// Turns a record into contributions by the ratio of photo and shading.
///
/// The reflectance B is I / E, at most `REFLECTANCE.excess`; for lights that the edit adds, I is
/// without the noise of dark pixels, and B at most that of white paint. Each light contributes
/// `B E'_k`, but what B has above 1 is shared by their strength and weight, and a light that the
/// edit adds has none of it (`Factors`). The residual has the unexplained light `I - B E`, too.
/// Near saturation B has no limit, so that white follows its lights: there I / E does not determine
/// the surface.
///
/// In the glare of a light, the pixel is blended with its split into the surface under all other
/// light and a remainder that goes with the gain; the residual is part of the remainder where the
/// light owns it.
///
/// Returns the light before the edit.
pub fn relight_ratio(
    surface: &SurfacePixel,
    glare: Option<GlarePixel>,
    before: &[Vec3],
    record: &mut [Vec3],
) -> PixelLight {
    let SurfacePixel { photo, denoised, residual, painted, white, lamp, .. } = surface;
    let shadings = surface.shadings(before);
    let around = surface.reflectance;
    let shading = before.iter().sum::<Vec3>() + *residual;
    let shown = unclip(*photo, *white, surface.unsaturated);
    let [from, to] = REFLECTANCE.saturation.map(|level| level * white);
    let saturation = smooth_step(from, to, photo.max_element());
    let whole = ratio(shown, shading);
    let reflectance = limited(whole, REFLECTANCE.excess);
    let reflectance = reflectance + saturation * (whole - reflectance);
    // Rounding is not light: a layer without any takes no memory.
    let unexplained = match reflectance == whole {
        true => Vec3::ZERO,
        false => painted.tint(shown - (reflectance * shading).min(shown), shading),
    };
    let change = |bare: Vec3| match painted.is_bare() {
        true => Vec3::ONE,
        false => ratio(painted.reflectance(bare, shown), bare),
    };
    let in_glare = glare.map(|GlarePixel { light, weight, owns_residual, gain }| {
        let is_owned = |k: usize| k == light || owns_residual && k == before.len();
        let factors = Factors::new(surface.reflectance, shadings);
        let (fraction, remainder) = split(shown, factors.reflected(is_owned));
        let mut split = record.to_vec();
        factors.apply(fraction * change(fraction * surface.reflectance), &mut split);
        split[light] = painted.tint(remainder, before[light]) * gain;
        if owns_residual {
            split[before.len()] = Vec3::ZERO;
        }
        let of_lamp = lamp.map_or(Vec3::ZERO, |lamp| match lamp == light {
            true => remainder,
            false => fraction * factors.reflected_from(lamp),
        });
        (weight, split, of_lamp)
    });
    // What white has above the surface around is light of its strongest lights.
    let mut surface = limited(reflectance, 1.0);
    if saturation > 0.0 {
        surface = surface.lerp(surface.min(limited(around, 1.0)), saturation);
    }
    let mut factors = Factors::with(surface, reflectance, shadings);
    if denoised != photo {
        factors.of_added = limited(ratio(*denoised, shading), TUNING.white_paint);
    }
    factors.apply(change(reflectance), record);
    record[before.len()] += unexplained;
    let mut of_lamp = lamp.map_or(Vec3::ZERO, |lamp| factors.reflected_from(lamp));
    if let Some((weight, split, of_lamp_in_glare)) = in_glare {
        record.iter_mut().zip(split).for_each(|(layer, split)| *layer += weight * (split - *layer));
        of_lamp = of_lamp.lerp(of_lamp_in_glare, weight);
    }
    PixelLight { all: shown, of_lamp }
}

/// The shadings of a pixel before the edit.
#[derive(Clone, Copy)]
struct Shadings<'a> {
    /// By each light of the record.
    lights: &'a [Vec3],
    residual: Vec3,
    weights: &'a [f32],
}

impl Shadings<'_> {
    /// That of record `k`.
    fn at(&self, k: usize) -> Vec3 {
        self.lights.get(k).copied().unwrap_or(self.residual)
    }

    /// Its weighted luminance, 0 or more.
    fn strength(&self, k: usize) -> f32 {
        self.weights.get(k).copied().unwrap_or(1.0) * luminance(self.at(k)).max(0.0)
    }
}

/// The factors of a record's shadings at a pixel of which the photo shows `reflectance` times its
/// shading.
///
/// Up to 1, reflectance is the surface's, and alike for all lights. Above, the shading is too low,
/// and light is missing. With the shading E_k of light k and its strength s_k, the luminance of E_k
/// times its weight, light k has the share `s_k E_k / sum of s_j E_j` of it as long as its factor
/// is below 1: no surface reflects more. The remainder is shared by `s_k^p E_k` with
/// `p = TUNING.excess_power`, so that the strongest light has nearly all of it. A light that the
/// edit adds has none.
struct Factors<'a> {
    shadings: Shadings<'a>,
    surface: Vec3,
    /// Reflectance for lights that the edit adds: those without shading before it.
    of_added: Vec3,
    /// Missing light over the sum of all s_k E_k.
    missing: Vec3,
    /// The largest strength.
    strongest: f32,
    /// The remainder over the sum of all r_k^p E_k, where r_k is s_k over the largest strength.
    remainder: Vec3,
}

impl<'a> Factors<'a> {
    fn new(reflectance: Vec3, shadings: Shadings<'a>) -> Factors<'a> {
        Factors::with(limited(reflectance, 1.0), reflectance, shadings)
    }

    /// The same for a surface whose own reflectance is `surface`, 0..=1.
    fn with(surface: Vec3, reflectance: Vec3, shadings: Shadings<'a>) -> Factors<'a> {
        let zero = Vec3::ZERO;
        let none = Factors {
            shadings,
            surface,
            of_added: limited(surface, TUNING.white_paint),
            missing: zero,
            strongest: 0.0,
            remainder: zero,
        };
        if surface == reflectance {
            return none;
        }
        let all = || (0..=shadings.lights.len()).map(|k| (k, shadings.at(k)));
        let shading = all().map(|(_, e)| e).sum::<Vec3>();
        let over = |light: Vec3, strengths: Vec3| {
            light / strengths.max(Vec3::splat(TUNING.dark * TUNING.dark))
        };
        let strengths = all().map(|(k, e)| shadings.strength(k) * e).sum::<Vec3>();
        let missing = over((reflectance - surface) * shading, strengths);
        let strongest = all().map(|(k, _)| shadings.strength(k)).fold(0.0, f32::max);
        let limited = Factors { missing, strongest, ..none };
        let shown = all().map(|(k, e)| limited.at(k) * e).sum::<Vec3>();
        let remainder = (reflectance * shading - shown).max(Vec3::ZERO);
        let strengths = all().map(|(k, e)| limited.excess(k) * e).sum::<Vec3>();
        Factors { remainder: over(remainder, strengths), ..limited }
    }

    /// The strength of record `k` over the largest, to the power by which lights share the
    /// remainder.
    fn excess(&self, k: usize) -> f32 {
        (self.shadings.strength(k) / self.strongest.max(TUNING.dark)).powi(TUNING.excess_power)
    }

    /// The factor of record `k`.
    fn at(&self, k: usize) -> Vec3 {
        if self.shadings.at(k) == Vec3::ZERO {
            return self.of_added;
        }
        if self.missing == Vec3::ZERO {
            return self.surface;
        }
        let below_one = (self.surface + self.shadings.strength(k) * self.missing).min(Vec3::ONE);
        below_one + self.excess(k) * self.remainder
    }

    /// Light that the surface reflects before the edit, without the lights that are `left_out`.
    fn reflected(&self, left_out: impl Fn(usize) -> bool) -> Vec3 {
        (0..=self.shadings.lights.len())
            .filter(|k| !left_out(*k))
            .map(|k| self.reflected_from(k))
            .sum()
    }

    /// Light of record `k` that the surface reflects before the edit.
    fn reflected_from(&self, k: usize) -> Vec3 {
        self.at(k) * self.shadings.at(k)
    }

    /// Multiplies each shading of a record by its factor and `change`.
    fn apply(&self, change: Vec3, record: &mut [Vec3]) {
        record.iter_mut().enumerate().for_each(|(k, layer)| *layer *= self.at(k) * change);
    }
}

/// The split of a pixel that one light dominates: the fraction of the light `reflected` from others
/// that the pixel can hold, 0..=1, and the remainder of the pixel, 0 or more.
fn split(shown: Vec3, reflected: Vec3) -> (Vec3, Vec3) {
    let reflected = reflected.max(Vec3::ZERO);
    let fraction = ratio(shown, reflected).min(Vec3::ONE);
    (fraction, (shown - fraction * reflected).max(Vec3::ZERO))
}

/// `after` over `before` per channel; `otherwise` in channels that are dark before.
pub fn gain(before: Vec3, after: Vec3, otherwise: Vec3) -> Vec3 {
    let channel =
        |c: usize| if before[c] > TUNING.dark { after[c] / before[c] } else { otherwise[c] };
    Vec3::new(channel(0), channel(1), channel(2))
}

/// How much of each channel saturation hides, 0..=1, in a photo that is clipped at `white`.
///
/// Saturation is judged smoothly and the scale of a model is one for the pixel, so that a pixel
/// that is almost white in all channels has the model's hue when its light is dimmed.
fn hidden(photo: Vec3, white: f32) -> Vec3 {
    let [from, to] = TUNING.shoulder.map(|level| level * white);
    Vec3::from_array([0, 1, 2].map(|c| smooth_step(from, to, photo[c])))
}

/// The light that a surface reflected to a pixel of the photo: channels that saturation hides
/// follow `model`, scaled to the channels that it left; none gets darker than the photo. Where no
/// channel is left, the scale is 1, or the least that explains the photo.
fn unclip(photo: Vec3, white: f32, model: Vec3) -> Vec3 {
    let hidden = hidden(photo, white);
    if hidden == Vec3::ZERO || model.min_element() <= TUNING.dark {
        return photo;
    }
    let alone = (photo / model).max_element().max(1.0);
    let left = (Vec3::ONE - hidden) * model;
    let prior = TUNING.model_trust * model.dot(model);
    let scale = (left.dot(photo) + prior * alone) / (left.dot(model) + prior);
    photo + hidden * (photo.max(scale * model) - photo)
}

/// The light of a light's own pixel: channels that saturation hides follow the radiance of the
/// `model`, scaled to the channels that it left. Where none is left, the luminance is that of the
/// model, up to `headroom` times that of the photo, or the least that explains the photo. The last
/// channel to saturate tells the less of the level, the more of it is hidden.
fn unclip_own(photo: Vec3, white: f32, model: Vec3, headroom: f32) -> Vec3 {
    let hidden = hidden(photo, white);
    if hidden == Vec3::ZERO || model.min_element() <= TUNING.dark {
        return photo;
    }
    let most = headroom * luminance(photo) / luminance(model);
    let alone = (photo / model).max_element().max(most.min(1.0));
    let left = (Vec3::ONE - hidden) * model;
    let told = ratio(left * photo, Vec3::splat(left.dot(model))).element_sum();
    let scale = told + hidden.min_element() * (alone - told);
    // In a hue that is far from white, one channel has more than the luminance.
    let raised = (scale * model).min(headroom * headroom * photo);
    photo + hidden * (photo.max(raised) - photo)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{AlphaMatte, PaintChange, PaintLayer, PaintLayers};

    const WALL: Vec3 = Vec3::new(0.5, 0.4, 0.2);
    const LAMP: Vec3 = Vec3::new(0.8, 0.6, 0.4);
    const WINDOW: Vec3 = Vec3::new(0.2, 0.3, 0.4);
    const RESIDUAL: Vec3 = Vec3::splat(0.1);

    fn surface(photo: Vec3, coats: &PaintLayers) -> SurfacePixel<'_> {
        SurfacePixel {
            photo,
            denoised: photo,
            residual: RESIDUAL,
            albedo: Vec3::splat(0.3),
            reflectance: WALL,
            painted: coats.at(0, 0),
            weights: &[],
            white: 1.0,
            lamp: None,
            unsaturated: photo,
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
    fn a_light_that_the_edit_adds_does_not_amplify_the_noise_of_dark_pixels() {
        let bare = PaintLayers::default();
        let (before, noise) = ([LAMP, Vec3::ZERO], Vec3::new(0.03, -0.02, 0.01));
        let photo = WALL * (LAMP + RESIDUAL) + noise;
        let pixel = SurfacePixel { denoised: photo - noise, ..surface(photo, &bare) };
        let mut record = [LAMP, WINDOW, RESIDUAL];
        relight_ratio(&pixel, None, &before, &mut record);
        near(record[0] + record[2], photo);
        near(record[1], WALL * WINDOW);
    }

    #[test]
    fn without_an_edit_every_way_gives_the_photo_back() {
        let bare = PaintLayers::default();
        let before = [LAMP, WINDOW];
        let glare =
            Some(GlarePixel { light: 0, weight: 0.7, owns_residual: false, gain: Vec3::ONE });
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
                albedo: Vec3::splat(0.05),
                radiance: Vec3::splat(3.0),
                headroom: 1.0,
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
            let own = OwnPixel {
                light: 0,
                albedo: Vec3::splat(0.5),
                radiance: Vec3::ZERO,
                headroom: 1.0,
                gain: Vec3::ONE,
                added,
            };
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
        // Ten times the shading: four of it go with the lights, six are unexplained.
        let before = [0.02 * LAMP, 0.02 * WINDOW];
        let shading = before[0] + before[1];
        let mut record = [Vec3::ZERO, before[1], Vec3::ZERO];
        let bright = SurfacePixel { residual: Vec3::ZERO, ..surface(10.0 * shading, &bare) };
        relight_ratio(&bright, None, &before, &mut record);
        near(record[2], 6.0 * shading);
    }

    #[test]
    fn the_strongest_light_has_most_of_the_missing_light_and_an_added_one_none() {
        let bare = PaintLayers::default();
        let before = [Vec3::splat(0.06), Vec3::splat(0.03), Vec3::ZERO];
        let mut record = [before[0], before[1], WINDOW, Vec3::splat(0.01)];
        let (residual, shading) = (record[3], Vec3::splat(0.1));
        let surface = SurfacePixel { residual, ..surface(3.0 * shading, &bare) };
        relight_ratio(&surface, None, &before, &mut record);
        // Each has its own shading once, and of the missing 0.2 the share of its fourth power.
        for (k, (own, fourth)) in [(0.06, 1296.0), (0.03, 81.0)].into_iter().enumerate() {
            near(record[k], Vec3::splat(own + 0.2 * fourth / 1378.0));
        }
        near(record[2], TUNING.white_paint * WINDOW);
        near(record[3], Vec3::splat(0.01 + 0.2 / 1378.0));
        // The weight counts as its third power.
        let mut record = [before[0], before[1], Vec3::ZERO, residual];
        let weighted = SurfacePixel { weights: &[1.0, 4.0, 4.0], ..surface };
        relight_ratio(&weighted, None, &before, &mut record);
        near(record[0], Vec3::splat(0.06 + 0.2 * 1296.0 / 6481.0));
        near(record[1], Vec3::splat(0.03 + 0.2 * 5184.0 / 6481.0));
    }

    #[test]
    fn a_weak_light_is_reflected_once_at_most_and_the_strongest_shows_the_remainder() {
        let lights = [0.08, 0.02].map(Vec3::splat);
        let shadings = Shadings { lights: &lights, residual: Vec3::ZERO, weights: &[] };
        let factors = |reflectance: f32| {
            let factors = Factors::with(Vec3::splat(0.5), Vec3::splat(reflectance), shadings);
            let [a, b] = [0, 1].map(|k| factors.at(k).x);
            assert!((0.08 * a + 0.02 * b - 0.1 * reflectance).abs() < 1e-6, "{a} {b}");
            (a, b)
        };
        // By the square of their strengths, as long as both are below 1.
        let (a, b) = factors(0.6);
        assert!((a - 0.5 - 4.0 * (b - 0.5)).abs() < 1e-5 && a < 1.0, "{a} {b}");
        // Ten times too bright: the weak one would have 2.9 of it by the square.
        let (a, b) = factors(5.0);
        assert!(a > 5.0 && (1.0..1.1).contains(&b), "{a} {b}");
    }

    #[test]
    fn white_follows_its_lights_with_its_light_before_saturation() {
        let bare = PaintLayers::default();
        let strong = 4.0 * LAMP;
        let shading = strong + WINDOW + RESIDUAL;
        let light = Vec3::new(2.0, 2.0, 1.0);
        let before = [strong, WINDOW];
        let mut record = [strong, WINDOW, RESIDUAL];
        let white = SurfacePixel { unsaturated: light, ..surface(Vec3::ONE, &bare) };
        relight_ratio(&white, None, &before, &mut record);
        near(sum(&record), light);
        // Of what exceeds the surface around, the strongest light has nearly all.
        for (k, before) in [strong, WINDOW, RESIDUAL].into_iter().enumerate() {
            let (own, even) = (WALL * before, light / shading * before);
            let above = (record[k] - own) / (even - own);
            assert!(above.cmpge(Vec3::ZERO).all() && (above.cmpge(Vec3::ONE).all() == (k == 0)));
        }
        // Twice as white as the surface can be, the pixel still goes with its lights.
        let mut record = [0.1 * LAMP, 0.1 * WINDOW, Vec3::ZERO];
        let white = SurfacePixel { residual: Vec3::ZERO, ..surface(Vec3::ONE, &bare) };
        relight_ratio(&white, None, &[0.2 * LAMP, 0.2 * WINDOW], &mut record);
        near(sum(&record), Vec3::splat(0.5));
    }

    #[test]
    fn glare_goes_with_its_light() {
        let bare = PaintLayers::default();
        let before = [LAMP, WINDOW];
        let photo = WALL * (LAMP + WINDOW + RESIDUAL) + Vec3::new(0.1, 0.1, 0.05);
        let lit = |weight: f32, owns_residual: bool| {
            let mut record = [Vec3::ZERO, WINDOW, RESIDUAL];
            let glare = GlarePixel { light: 0, weight, owns_residual, gain: Vec3::ZERO };
            relight_ratio(&surface(photo, &bare), Some(glare), &before, &mut record);
            sum(&record)
        };
        near(lit(1.0, false), WALL * (WINDOW + RESIDUAL));
        near(lit(1.0, true), WALL * WINDOW);
        // Weights blend.
        let mut plain = [Vec3::ZERO, WINDOW, RESIDUAL];
        relight_ratio(&surface(photo, &bare), None, &before, &mut plain);
        near(lit(0.25, false), 0.75 * sum(&plain) + 0.25 * lit(1.0, false));
    }

    #[test]
    fn an_own_pixel_shows_its_shade_when_the_light_is_off() {
        let bare = PaintLayers::default();
        let own = OwnPixel {
            light: 0,
            albedo: Vec3::splat(0.5),
            radiance: Vec3::splat(9.0),
            headroom: TUNING.max_headroom,
            gain: Vec3::ZERO,
            added: Vec3::ZERO,
        };
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
            noise: Vec3::ZERO,
        };
        let matte = AlphaMatte { alpha: Plane::filled(1, 1, 1.0), boundary: vec![] };
        let blue = PaintLayers(vec![PaintLayer { paint, matte }]);
        let mut record = [LAMP, WINDOW, RESIDUAL];
        relight_physical(&surface(Vec3::splat(0.7), &blue), &mut record);
        near(record[0], Vec3::new(0.1, 0.2, 0.6) * LAMP);
    }

    #[test]
    fn saturated_channels_follow_those_that_are_not() {
        // The model at 0.6 of its level explains blue; red was 1.2.
        let model = Vec3::new(2.0, 1.0, 0.5);
        let (photo, want) = (Vec3::new(1.0, 0.6, 0.3), Vec3::new(1.2, 0.6, 0.3));
        for raised in [unclip(photo, 1.0, model), unclip_own(photo, 1.0, model, 2.0)] {
            assert!((raised - want).abs().max_element() < 0.04, "{raised}");
        }
        // Almost white channels get one scale, and so the model's hue: no channel is left behind.
        let raised = unclip_own(Vec3::new(1.0, 0.985, 0.99), 1.0, Vec3::ONE, 2.0);
        assert!((raised - Vec3::ONE).abs().max_element() < 0.02, "{raised}");
        let raised = unclip(Vec3::ONE, 1.0, Vec3::new(0.6, 0.5, 0.4));
        near(raised, Vec3::new(1.5, 1.25, 1.0));
        for never_darker in
            [unclip(Vec3::ONE, 1.0, Vec3::ZERO), unclip_own(Vec3::ONE, 1.0, Vec3::ZERO, 2.0)]
        {
            assert_eq!(never_darker, Vec3::ONE);
        }
    }

    #[test]
    fn a_light_of_its_own_is_raised_in_its_hue_and_without_a_step() {
        // White of a warm lamp: the least channel of twice its luminance is above white.
        let model = 9.0 * Vec3::new(1.4, 0.95, 0.6);
        let raised = unclip_own(Vec3::ONE, 1.0, model, 2.0);
        let want = 2.0 / luminance(model) * model;
        near(raised, want);
        // The level rises with that of the photo, by no more than its own rise times the headroom.
        let shown =
            |level: f32| luminance(unclip_own(Vec3::splat(level), 1.0, Vec3::splat(9.0), 2.0));
        for (level, want) in [(0.5, 0.5), (0.8, 0.8), (1.0, 2.0)] {
            assert!((shown(level) - want).abs() < 1e-5, "{}", shown(level));
        }
        let rising: Vec<f32> = (80..=100).map(|level| shown(level as f32 / 100.0)).collect();
        assert!(
            rising.windows(2).all(|pair| (0.0..0.2).contains(&(pair[1] - pair[0]))),
            "{rising:?}"
        );
    }

    #[test]
    fn the_light_of_a_saturated_region_rises_from_its_edge_and_in_its_hue() {
        // A square with a hole, which the closing fills.
        let hole = |x: usize, y: usize| (x, y) == (12, 12);
        let square = |x: usize, y: usize| x.max(y) < 20 && x.min(y) > 4;
        let is_clipped = |x, y| square(x, y) && !hole(x, y);
        let clipped = Mask(Plane::from_fn(45, 25, |x, y| f32::from(u8::from(is_clipped(x, y)))));
        let photo = Picture(clipped.0.map(Vec3::splat));
        let regions = SaturatedRegions::new(&photo, &clipped, 1.0, &[]);
        let raised = |x: usize, light: Vec3| regions.raised(45 * 12 + x, Vec3::ONE, light);
        near(raised(12, Vec3::splat(3.0)), Vec3::splat(3.0));
        for (x, away) in [(5, 1.0), (6, 2.0), (12, 8.0)] {
            near(raised(x, Vec3::ONE), Vec3::splat(1.0 + away * TUNING.surface_growth));
            let least = (1.0 + away * TUNING.surface_growth) * Vec3::new(2.0, 1.5, 1.0);
            near(raised(x, Vec3::new(2.0, 1.5, 1.0)), least);
        }
        // Outside, it fades into the photo, and is not darker.
        for away in 1..25 {
            let share = (1.0 - away as f32 / TUNING.shoulder_reach).max(0.0);
            near(raised(19 + away, Vec3::splat(3.0)), Vec3::splat(1.0 + 2.0 * share));
            near(raised(19 + away, Vec3::splat(0.5)), Vec3::ONE);
        }
        let none = Mask(Plane::filled(3, 2, 0.0));
        let photo = Picture(Plane::filled(3, 2, Vec3::ONE));
        let regions = SaturatedRegions::new(&photo, &none, 1.0, &[]);
        assert!((0..6).all(|i| regions.headroom_of_window(i) == 1.0));
        assert!((0..6).all(|i| regions.raised(i, Vec3::ONE, Vec3::splat(3.0)) == Vec3::ONE));
    }

    #[test]
    fn the_headroom_of_a_window_grows_from_falloffs_and_not_from_frames() {
        // A dark frame up to column 10, then white, which falls off from column 30 on.
        let level = |x: usize| match x {
            0..10 => 0.05,
            10..30 => 1.0,
            _ => 0.9 - 0.005 * (x - 30) as f32,
        };
        let photo = Picture(Plane::from_fn(60, 20, |x, _| Vec3::splat(level(x))));
        let clipped = Mask(Plane::from_fn(60, 20, |x, _| if level(x) < 1.0 { 0.0 } else { 1.0 }));
        let own = Plane::from_fn(60, 20, |x, _| if x < 5 { 0.0 } else { 1.0 });
        let pane = GlareMask::of_window(&own, &photo, &clipped, 1.0);
        let regions = SaturatedRegions::new(&photo, &clipped, 1.0, &[&pane]);
        let window = |x: usize| regions.headroom_of_window(60 * 10 + x);
        assert_eq!([9, 30, 45].map(window), [1.0; 3], "outside");
        assert_eq!(window(10), 1.0 + 20.0 * TUNING.falloff_growth);
        let falling = [26, 27, 28].map(window);
        assert!(falling[0] > falling[1] && falling[1] > falling[2], "{falling:?}");
        assert!(window(29) < 1.1, "{}", window(29));
        // With nothing but a frame around it, the whole pane has it.
        let photo = Picture(photo.0.map(|shown| if shown.x < 1.0 { Vec3::ZERO } else { shown }));
        let regions = SaturatedRegions::new(&photo, &clipped, 1.0, &[&pane]);
        assert_eq!(regions.headroom_of_window(60 * 10 + 29), TUNING.max_headroom);
    }

    #[test]
    fn few_marks_are_noise() {
        // Squares of 5 pixels, the last ones cut: three marks stay, two do not.
        let mut marks = vec![false; 12 * 7];
        let kept = [1, 2, 12 + 1];
        kept.into_iter().chain([6, 7, 6 * 12 + 11]).for_each(|i| marks[i] = true);
        drop_few(&mut marks, 12, 5);
        let left: Vec<usize> = (0..marks.len()).filter(|&i| marks[i]).collect();
        assert_eq!(left, kept);
        drop_few(&mut [], 0, 5);
    }

    #[test]
    fn white_rises_alike_in_a_large_photo_and_in_the_same_photo_at_a_smaller_size() {
        let raised = |side: usize| {
            let is_clipped = |x: usize, y: usize| x.min(y) >= side / 4 && x.max(y) < 3 * side / 4;
            let clipped =
                Mask(Plane::from_fn(side, side, |x, y| f32::from(u8::from(is_clipped(x, y)))));
            let photo = Picture(clipped.0.map(Vec3::splat));
            let regions = SaturatedRegions::new(&photo, &clipped, 1.0, &[]);
            regions.raised((side / 2) * side + side / 4 + side / 80, Vec3::ONE, Vec3::ONE).x
        };
        let (small, large) = (raised(640), raised(1280));
        assert!((small - large).abs() < 0.02 && small > 1.2, "{small} {large}");
    }

    #[test]
    fn the_gain_of_a_dark_channel_is_given() {
        assert_eq!(
            gain(Vec3::new(2.0, 0.0, 1.0), Vec3::new(1.0, 5.0, 0.0), Vec3::splat(7.0)),
            Vec3::new(0.5, 7.0, 0.0)
        );
    }
}
