//! `LensGlare`: light of visible lights that the lens scatters over the photo.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{Mask, Picture, Plane, Segments, Shading, dilate, luminance};
use crate::nodes::artifacts::ScatteredLight;
use crate::optics::inverse::{GlareSource, fit_glare};
use crate::tuning::tuning;
use crate::{params, ports};

params! {
    /// Estimates the glare of each visible light: the light that the lens scatters over the photo,
    /// on surfaces that the light does not reach, too.
    ///
    /// A kernel that falls with a power of the distance is fitted to the photo beside the shading
    /// of all lights (see `optics::inverse::fit_glare`). Dark pixels limit the glare.
    pub struct LensGlare {}
}

ports! {
    pub input LensGlareIn {
        /// The linear photo, working size.
        photo: Arc<Picture>,
        /// Fraction of saturated pixels.
        clipped: Arc<Mask>,
        /// Segments of one material each.
        segments: Arc<Segments>,
        /// Pixels of each visible light, working size.
        mask: Gather<Mask>,
        /// Shading by each estimated light, working size.
        light: Gather<Shading>,
        /// Residual shading, which no light explains, working size.
        residual: Arc<Shading>,
    }
}

ports! {
    pub output LensGlareOut {
        /// The glare of each visible light, working size.
        glare: Scatter<ScatteredLight>,
    }
}

impl Node for LensGlare {
    const KIND: &'static str = "LensGlare";
    const VERSION: u32 = 1;
    type In = LensGlareIn;
    type Out = LensGlareOut;

    fn run(&self, inputs: LensGlareIn, ctx: &Context) -> Result<LensGlareOut, NodeError> {
        let LensGlareIn { photo, clipped, segments, .. } = &inputs;
        let (w, h) = photo.0.size();
        let mut shading = inputs.residual.0.clone();
        for (_, light) in inputs.light.iter() {
            let sum = shading.pixels_mut().iter_mut().zip(light.0.pixels());
            sum.for_each(|(sum, light)| *sum += *light);
        }
        let sources: Vec<GlareSource> =
            inputs.mask.iter().map(|(_, mask)| source(mask, photo)).collect();
        let masks = inputs.mask.iter().map(|(_, mask)| &**mask);
        let margin = (w.max(h) / TUNING.margin).max(1);
        let is_used = dilate(masks, (w, h), margin).map(|is_near| !is_near);
        let fit = fit_glare((photo, clipped), &Shading(shading), segments, &is_used, &sources);
        let lights = inputs.mask.iter().zip(fit.glare).zip(&fit.amplitude);
        let glare = lights.map(|(((id, _), glare), &amplitude)| {
            if amplitude > 0.0 {
                ctx.note(format!(
                    "{id}: the lens scatters {amplitude:.3} of the photo's white, falling with the distance r as \
                    r^-{:.1}",
                    2.0 + fit.kernel.slope
                ));
            }
            (id.to_owned(), Arc::new(ScatteredLight { glare, amplitude, kernel: fit.kernel }))
        });
        Ok(LensGlareOut { glare: Scatter(glare.collect()) })
    }
}

/// The pixels of a light by their brightness, up to that of its bright parts, and its color.
fn source(mask: &Mask, photo: &Picture) -> GlareSource {
    let shown = || mask.0.pixels().iter().zip(photo.0.pixels());
    let mut levels: Vec<f32> =
        shown().filter(|(share, _)| **share > 0.5).map(|(_, &shown)| luminance(shown)).collect();
    levels.sort_by(f32::total_cmp);
    let bright = levels.get(levels.len() * TUNING.bright_tenths / 10).copied().unwrap_or(0.0);
    let brightness = |share: f32, shown: Vec3| match bright > 0.0 {
        true => share * (luminance(shown) / bright).clamp(0.0, 1.0),
        false => 0.0,
    };
    let (w, h) = mask.0.size();
    let brightness: Vec<f32> = shown().map(|(&share, &shown)| brightness(share, shown)).collect();
    let sum: Vec3 =
        brightness.iter().zip(photo.0.pixels()).map(|(b, shown)| *b * shown.max(Vec3::ZERO)).sum();
    let level = luminance(sum);
    let hue = if level > 0.0 && level.is_finite() { sum / level } else { Vec3::ONE };
    GlareSource { brightness: Plane::new(w, h, brightness), hue }
}

tuning! {
    /// Constants of `LensGlare`.
    pub const TUNING: LensGlareStageTuning {
        /// Quantile of the luminances in a light's mask that counts as the light's brightness.
        bright_tenths: usize = 9,
            unit "tenths", source Taste, effect "a larger value follows highlights of the shade";
        /// Width of the band around lights that takes no part: this part of the picture's longer
        /// side.
        margin: usize = 64,
            unit "1 over the fraction", source Taste, effect "a smaller value hides more bloom";
    }
}
