//! `Paint`: what the surface reflects, also where a light hides it.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{
    Albedo, Mask, Normal, Picture, Plane, Points, SATURATION, Shading, clip_level, distance, fill_along_surfaces,
    grow_through, luminance, reflected, smooth_step,
};
use crate::optics::LightKind;
use crate::tuning::tuning;
use crate::{params, ports};

params! {
    /// Marks the pixels of each visible light and its glare, and estimates the reflectance of the
    /// surface, also under lights and saturation.
    ///
    /// Reflectance is photo over shading. Where a light or saturation hides the surface, it is
    /// filled in from the surroundings, so that there is no edge. No edit of a light changes the
    /// result.
    pub struct Paint {
        /// Least width of the bloom around a visible light, as a fraction of the photo's longer
        /// side. Within it, residual light belongs to the light. A lamp's bloom is at least half as
        /// wide as the lamp.
        bloom: f32 = 0.01, in 0.0..=0.1,
    }
}

ports! {
    pub input PaintIn {
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
        rest: Arc<Shading>,
        /// Pixels of each visible light, photo size.
        mask: Gather<Mask>,
        /// Kind of each visible light.
        kind: Gather<LightKind>,
    }
}

ports! {
    pub output PaintOut {
        /// Reflectance in 0..=1, working size.
        paint: Arc<Albedo>,
        /// Weight with which each photo pixel belongs to the light: 1 in its own pixels, less in
        /// its glare and bloom.
        zone: Scatter<Mask>,
    }
}

impl Node for Paint {
    const KIND: &'static str = "Paint";
    const VERSION: u32 = 2;
    type In = PaintIn;
    type Out = PaintOut;

    fn run(&self, inputs: PaintIn, _: &Context) -> Result<PaintOut, NodeError> {
        let (full_w, full_h) = inputs.photo.0.size();
        let bloom = self.bloom * full_w.max(full_h) as f32;
        let mut zones = Vec::new();
        for (id, mask) in inputs.mask.iter() {
            let kind = inputs
                .kind
                .get(id)
                .ok_or_else(|| NodeError::Failed(format!("visible light {id:?} is neither lamp nor window")))?;
            zones.push((id.to_string(), Arc::new(Mask(zone(&mask.0, **kind, bloom, &inputs.photo, &inputs.clipped)))));
        }
        let (w, h) = inputs.small.0.size();
        let bright = SATURATION[0] * clip_level(&inputs.photo, &inputs.clipped);
        let mut hidden = inputs.small.0.map(|shown| shown.max_element() > bright);
        for (_, zone) in &zones {
            for i in (0..zone.0.len()).filter(|&i| zone.0.pixels()[i] > 0.0) {
                hidden.set(i % full_w * w / full_w, i / full_w * h / full_h, true);
            }
        }
        let reflectance = |i: usize| {
            let lights = inputs.light.iter().map(|(_, light)| light.0.pixels()[i]);
            reflected(inputs.small.0.pixels()[i], lights.sum::<Vec3>() + inputs.rest.0.pixels()[i])
        };
        let mut paint = Plane::new(w, h, (0..w * h).map(reflectance).collect());
        fill_along_surfaces(&mut paint, hidden, &inputs.points, &inputs.normal);
        Ok(PaintOut { paint: Arc::new(Albedo(paint)), zone: Scatter(zones) })
    }
}

tuning! {
    /// Constants of `Paint`.
    pub const TUNING: PaintTuning {
        /// Least luminance of a lamp's own pixels. A mask often includes the lamp's foot or stand.
        min_emission: f32 = 0.3,
            unit "fraction of the lamp's luminance", source Taste, effect "a smaller value counts feet and stands as emitters";
        /// Least width of a lamp's bloom.
        bloom_width: f32 = 0.5,
            unit "fraction of the lamp's width", source Taste, effect "a larger value gives more residual light to the lamp";
    }
}

/// A light's own glare: all but its own pixels.
const GLARE: f32 = 0.999;

/// How far each pixel is the light's own: 1 where it is the light, [`GLARE`] in the saturated pixels around it, falling to 0
/// in its bloom, whose width is at least `bloom` pixels and, for a lamp, half its own.
fn zone(mask: &Plane<f32>, kind: LightKind, bloom: f32, photo: &Picture, clipped: &Mask) -> Plane<f32> {
    let (w, h) = mask.size();
    let inside = mask.pixels().iter().zip(photo.0.pixels()).filter(|(share, _)| **share > 0.5);
    let mut levels: Vec<f32> = inside.map(|(_, &shown)| luminance(shown)).collect();
    levels.sort_by(f32::total_cmp);
    let bright = levels.get(levels.len() * 9 / 10).copied().unwrap_or(0.0);
    let (core, reach, dark) = match kind {
        LightKind::Lamp => {
            let core = grow_through(mask, &clipped.0);
            let area = core.pixels().iter().filter(|inside| **inside).count();
            (core, bloom.max(TUNING.bloom_width * (area as f32).sqrt()), TUNING.min_emission * bright)
        }
        LightKind::Window => (mask.map(|share| share > 0.5), bloom, 0.0),
    };
    let away = distance(&core);
    Plane::sparse(w, h, |i| {
        let (x, y) = (i % w, i / w);
        if mask.get(x, y) > 0.5 && luminance(photo.0.get(x, y)) >= dark {
            1.0
        } else {
            GLARE * (1.0 - smooth_step(0.0, reach.max(1.0), away.get(x, y)))
        }
    })
}
