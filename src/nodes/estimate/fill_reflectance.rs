//! `FillReflectance`: reflectance of the surface, also where a light hides it.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{
    Albedo, GlareMask, Mask, Normal, Picture, Plane, Points, REFLECTANCE, Shading, clip_level,
    inpaint_surfaces, reflected, resize, smooth_step,
};
use crate::optics::LightKind;
use crate::{params, ports};

params! {
    /// Marks the pixels of each visible light and its glare, and estimates the reflectance of the
    /// surface, also under lights and saturation.
    ///
    /// Reflectance is photo over shading. Pixels that a light or saturation hides are filled in
    /// from the surroundings without a visible edge. No edit of a light changes the result.
    pub struct FillReflectance {
        /// Least width of the bloom around a visible light, as a fraction of the photo's longer
        /// side. Within it, residual light belongs to the light. A lamp's bloom is at least half as
        /// wide as the lamp.
        bloom: f32 = 0.01, in 0.0..=0.1,
    }
}

ports! {
    pub input FillReflectanceIn {
        /// The linear photo.
        photo: Arc<Picture>,
        /// 1 where the photo is saturated.
        clipped: Arc<Mask>,
        /// The photo at working size.
        small: Arc<Picture>,
        /// Points of the seen surface, working size.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// Shading by each estimated light, working size.
        light: Gather<Shading>,
        /// Residual shading, which no light explains, working size.
        residual: Arc<Shading>,
        /// Pixels of each visible light, photo size.
        mask: Gather<Mask>,
        /// Kind of each visible light.
        kind: Gather<LightKind>,
    }
}

ports! {
    pub output FillReflectanceOut {
        /// Reflectance in 0..=1, working size.
        reflectance: Arc<Albedo>,
        /// The own pixels of each visible light and its glare, photo size.
        glare_mask: Scatter<GlareMask>,
        /// Fraction of each pixel whose surface a light, its glare or saturation hides, 0..=1,
        /// working size: there the reflectance is filled in.
        filled: Arc<Mask>,
    }
}

impl Node for FillReflectance {
    const KIND: &'static str = "FillReflectance";
    const VERSION: u32 = 5;
    type In = FillReflectanceIn;
    type Out = FillReflectanceOut;

    fn run(&self, inputs: FillReflectanceIn, _: &Context) -> Result<FillReflectanceOut, NodeError> {
        let (full_w, full_h) = inputs.photo.0.size();
        let bloom = self.bloom * full_w.max(full_h) as f32;
        let mut glare_masks = Vec::new();
        for (id, mask) in inputs.mask.iter() {
            let kind = inputs.kind.get(id).ok_or_else(|| {
                NodeError::Failed(format!("visible light {id:?} is neither lamp nor window"))
            })?;
            let glare_mask = match **kind {
                LightKind::Lamp => {
                    GlareMask::of_lamp(&mask.0, &inputs.photo, &inputs.clipped, bloom)
                }
                LightKind::Window => {
                    GlareMask::of_window(&mask.0, &inputs.photo, &inputs.clipped, bloom)
                }
            };
            glare_masks.push((id.to_string(), Arc::new(glare_mask)));
        }
        let (w, h) = inputs.small.0.size();
        let white = clip_level(&inputs.photo, &inputs.clipped);
        let filled = filled(&inputs.photo, white, &glare_masks);
        let bright = REFLECTANCE.saturation[0] * white;
        let mut hidden = inputs.small.0.map(|shown| shown.max_element() > bright);
        for (_, glare_mask) in &glare_masks {
            for i in (0..full_w * full_h).filter(|&i| glare_mask.weight(i) > 0.0) {
                hidden.set(i % full_w * w / full_w, i / full_w * h / full_h, true);
            }
        }
        let reflectance = |i: usize| {
            let lights = inputs.light.iter().map(|(_, light)| light.0.pixels()[i]);
            reflected(
                inputs.small.0.pixels()[i],
                lights.sum::<Vec3>() + inputs.residual.0.pixels()[i],
            )
        };
        let mut paint = Plane::new(w, h, (0..w * h).map(reflectance).collect());
        inpaint_surfaces(&mut paint, hidden, &inputs.points, &inputs.normal);
        Ok(FillReflectanceOut {
            reflectance: Arc::new(Albedo(paint)),
            glare_mask: Scatter(glare_masks),
            filled: Arc::new(Mask(resize(&filled, w, h))),
        })
    }
}

/// Fraction of each pixel of the photo that does not show its surface: a light's own, in its glare,
/// or saturated in all channels.
fn filled(photo: &Picture, white: f32, lights: &[(String, Arc<GlareMask>)]) -> Plane<f32> {
    let [from, to] = REFLECTANCE.saturation.map(|level| level * white);
    let (width, height) = photo.0.size();
    Plane::from_fn(width, height, |x, y| {
        let i = y * width + x;
        let lights = lights.iter().map(|(_, light)| light.weight(i));
        lights.fold(smooth_step(from, to, photo.0.get(x, y).min_element()), f32::max)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_light_or_saturation_hides_is_filled() {
        let colors = [Vec3::ONE, Vec3::X, Vec3::splat(0.5), Vec3::splat(0.5)];
        let photo = Picture(Plane::from_fn(4, 1, |x, _| colors[x]));
        let own = Plane::from_fn(4, 1, |x, _| if x == 3 { 1.0 } else { 0.0 });
        let none = Mask(own.map(|_| 0.0));
        let mask = GlareMask::of_window(&own, &photo, &none, 1e-3);
        let light = ("lamp".to_owned(), Arc::new(mask));
        assert_eq!(filled(&photo, 1.0, &[light]).pixels(), [1.0, 0.0, 0.0, 1.0]);
    }
}
