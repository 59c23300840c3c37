//! `ResidualShading`: photo shading minus direct light.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Gather, Node, NodeError};
use crate::image::{Albedo, Mask, Picture, Plane};
use crate::nodes::artifacts::{Residual, UnitDirect, Visibility};
use crate::optics::{Radiance, Shape};
use crate::tuning::tuning;
use crate::{params, ports};

params! {
    /// Subtracts all direct light from the photo's shading. The residual is indirect light, which
    /// determines the brightness of the unseen part of the room.
    ///
    /// residual = photo / albedo - sum of w x direct x visibility, and zero where the photo is
    /// saturated or shows a light.
    pub struct ResidualShading {}
}

ports! {
    pub input ResidualShadingIn {
        /// The linear photo, working size.
        photo: Arc<Picture>,
        /// Fraction of saturated pixels.
        clipped: Arc<Mask>,
        /// Albedo.
        albedo: Arc<Albedo>,
        /// Pixels of each visible light.
        masks: Gather<Mask>,
        /// Every estimated light.
        shape: Gather<Shape>,
        /// Its radiance, as estimated before the fit.
        radiance: Gather<Radiance>,
        /// Its unshadowed unit shading.
        direct: Gather<UnitDirect>,
        /// Its visibility.
        visibility: Gather<Visibility>,
    }
}

ports! {
    pub output ResidualShadingOut {
        /// The residual shading, and the power of the lights.
        residual: Arc<Residual>,
    }
}

impl Node for ResidualShading {
    const KIND: &'static str = "ResidualShading";
    const VERSION: u32 = 1;
    type In = ResidualShadingIn;
    type Out = ResidualShadingOut;

    fn run(&self, inputs: ResidualShadingIn, _: &Context) -> Result<ResidualShadingOut, NodeError> {
        let (width, height) = inputs.photo.0.size();
        let mut lit = Plane::filled(width, height, Vec3::ZERO);
        let mut power = Vec3::ZERO;
        for (id, direct) in inputs.direct.iter() {
            let missing = |what: &str| NodeError::Failed(format!("light {id:?} has no {what}"));
            let visibility = inputs.visibility.get(id).ok_or_else(|| missing("visibility"))?;
            let radiance = inputs.radiance.get(id).ok_or_else(|| missing("radiance"))?;
            let shape = inputs.shape.get(id).ok_or_else(|| missing("shape"))?;
            for (lobe, &w) in radiance.0.iter().enumerate().filter(|(_, w)| **w != Vec3::ZERO) {
                power += w * shape.flux(lobe);
                let (direct, visible) =
                    (direct.lobes[lobe].pixels(), visibility.lit[lobe].pixels());
                lit.pixels_mut()
                    .iter_mut()
                    .enumerate()
                    .for_each(|(i, lit)| *lit += w * direct[i] * visible[i]);
            }
        }
        let mut hidden = inputs.clipped.0.map(|share| share > 0.0);
        for (_, mask) in inputs.masks.iter() {
            hidden
                .pixels_mut()
                .iter_mut()
                .zip(mask.0.pixels())
                .for_each(|(hidden, share)| *hidden |= *share > 0.0);
        }
        let left = Plane::from_fn(width, height, |x, y| {
            let albedo = inputs.albedo.0.get(x, y).max(Vec3::splat(TUNING.min_albedo));
            if hidden.get(x, y) {
                Vec3::ZERO
            } else {
                inputs.photo.0.get(x, y) / albedo - lit.get(x, y)
            }
        });
        let mean = lit.pixels().iter().sum::<Vec3>() / lit.len().max(1) as f32;
        Ok(ResidualShadingOut { residual: Arc::new(Residual { left, direct: mean, power }) })
    }
}

tuning! {
    /// Constants of `ResidualShading`.
    pub const TUNING: ResidualShadingTuning {
        /// Least albedo by which the photo is divided.
        min_albedo: f32 = 0.03, unit "albedo", source Taste, effect "a smaller value amplifies the noise of dark surfaces";
    }
}
