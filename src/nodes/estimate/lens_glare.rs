//! `LensGlare`: light of visible lights that the lens scatters over the photo.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{
    Mask, Picture, Plane, Segments, Shading, bright_level, dilate, luminance, weighted_hue,
};
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
    const VERSION: u32 = 2;
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
    let bright = bright_level(&mask.0, photo);
    let brightness = |(&share, &shown): (&f32, &Vec3)| match bright > 0.0 {
        true => share * (luminance(shown) / bright).clamp(0.0, 1.0),
        false => 0.0,
    };
    let (w, h) = mask.0.size();
    let brightness: Vec<f32> =
        mask.0.pixels().iter().zip(photo.0.pixels()).map(brightness).collect();
    let hue = weighted_hue(photo, |i| brightness[i]);
    GlareSource { brightness: Plane::new(w, h, brightness), hue }
}

tuning! {
    /// Constants of `LensGlare`.
    pub const TUNING: LensGlareStageTuning {
        /// Width of the band around lights that takes no part: this part of the picture's longer
        /// side.
        margin: usize = 64,
            unit "1 over the fraction", source Taste, effect "a smaller value hides more bloom";
    }
}
