//! `Shadow`: which share of a light's direct shading arrives, per lobe.

use std::sync::Arc;

use super::SAMPLES;
use crate::geometry::{Own, SceneMesh};
use crate::graph::{Context, Node, NodeError};
use crate::image::{Mask, Normal, Plane, Points};
use crate::nodes::artifacts::{Sunlight, Visibility};
use crate::optics::{self, ShadowQuality, Shape, Strategy};
use crate::tuning::tuning;
use crate::{params, ports};

params! {
    /// Computes the visibility of one light, per lobe, by rays to the samples of its direct
    /// shading.
    ///
    /// A ray is blocked by the seen surface, unknown where it passes behind a depth edge, lit
    /// otherwise; space outside the view counts as empty, or with `outside_unknown` as unknown.
    /// `lit` holds the lit fraction plus `assume_lit` times the unknown fraction; `unknown` holds
    /// the unknown fraction itself.
    pub struct Shadow {
        /// Rays per traced pixel and lobe; with a target, the least number.
        samples: u32 = 8, in SAMPLES,
        /// Mean standard error over mean, of the shadowed shading of the lobe, that is good enough,
        /// 0..1; each tile of 16 x 16 traced pixels casts more rays until it gets there. 0 casts
        /// `samples` everywhere.
        target_error: f32 = 0.0, in 0.0..1.0,
        /// Upper bound of the rays per traced pixel and lobe, with a target.
        max_samples: u32 = 4096, in SAMPLES,
        /// Seed of the random numbers.
        seed: u64 = 0,
        /// Strategy of the samples of a window: `Best`, or, to compare, `Area`, `Lobe`, `Balance`,
        /// `BalanceOneSample`, `Power`, `PowerOneSample`.
        sampling: Strategy = Strategy::Best,
        /// Trace every second pixel along each axis and bring the result to all of them along the
        /// surfaces.
        half: bool = true,
        /// Fraction of the unknown rays that counts as lit.
        assume_lit: f32 = 1.0, in 0.0..=1.0,
        /// Rays that leave the view unblocked are unknown, as the photo does not show occluders
        /// there; else they are lit.
        outside_unknown: bool = false,
        /// One visibility for all lobes of a window, to compare: the mean over its lobes, weighted
        /// by the direct shading of each at unit radiance. Sun and sky then cast the same shadow.
        average: bool = false,
    }
}

ports! {
    pub input ShadowIn {
        /// The surface points.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// The surfaces that cast the shadows.
        mesh: Arc<SceneMesh>,
        /// The light.
        shape: Arc<Shape>,
        /// The light's own pixels, which do not block it.
        mask: Option<Arc<Mask>>,
        /// The light as it was estimated from the photo.
        estimated: Option<Arc<Shape>>,
        /// Sunlight that the photo shows through this window.
        sunlight: Option<Arc<Sunlight>>,
    }
}

ports! {
    pub output ShadowOut {
        /// Lit fraction, its standard error and unknown fraction per lobe.
        visibility: Arc<Visibility>,
    }
}

impl Node for Shadow {
    const KIND: &'static str = "Shadow";
    const VERSION: u32 = 6;
    type In = ShadowIn;
    type Out = ShadowOut;

    fn run(&self, inputs: ShadowIn, ctx: &Context) -> Result<ShadowOut, NodeError> {
        super::same_size("normal", inputs.normal.0.size(), "points", inputs.points.0.size())?;
        if let Some(mask) = &inputs.mask {
            super::same_size("mask", mask.0.size(), "mesh", inputs.mesh.size())?;
        }
        let quality = ShadowQuality {
            sampling: super::sampling(
                ctx,
                self.sampling,
                self.samples,
                self.target_error,
                self.max_samples,
                self.seed,
            ),
            stride: if self.half { 2 } else { 1 },
            assume_lit: self.assume_lit,
            outside_unknown: self.outside_unknown,
            lifted: false,
        };
        ctx.check_cancelled()?;
        let own = inputs.mask.as_deref().map(|mask| (Own::new(mask), mask));
        let own = own.as_ref().map(|(passes, mask)| (passes, *mask));
        let stop = || ctx.out_of_time();
        let mut shadow = optics::shadow(
            &inputs.mesh,
            &inputs.points,
            &inputs.normal,
            &inputs.shape,
            own,
            quality,
            &stop,
        );
        if self.average && shadow.lit.len() > 1 {
            let direct = optics::direct(
                &inputs.points,
                &inputs.normal,
                &inputs.shape,
                &quality.sampling,
                &stop,
            );
            shadow.average(&direct.lobes);
        }
        let sunlight = inputs.sunlight.as_ref();
        let sunlight =
            sunlight.filter(|sun| sun.shown(&inputs.shape, inputs.estimated.as_deref()).is_some());
        if let Some(sunlight) = sunlight {
            shadow.lit[0] = shown_sunlight(&inputs, sunlight);
            let (w, h) = sunlight.lit.size();
            shadow.stderr[0] = Plane::filled(w, h, 0.0);
            shadow.unknown[0] = Plane::filled(w, h, 0.0);
        }
        ctx.check_cancelled()?;
        ctx.count_rays(shadow.rays);
        ctx.set_stderr(shadow.relative_error);
        ctx.set_samples(shadow.samples as f64 / shadow.pixels.max(1) as f64);
        let (lit, stderr, unknown) = (shadow.lit, shadow.stderr, shadow.unknown);
        Ok(ShadowOut { visibility: Arc::new(Visibility { lit, stderr, unknown }) })
    }
}

/// The sunlight of the photo, without that which bodies of the edit block.
fn shown_sunlight(inputs: &ShadowIn, sunlight: &Sunlight) -> Plane<f32> {
    let mesh = &inputs.mesh;
    let lit = |i: usize| {
        let lit = sunlight.lit.pixels()[i];
        if lit == 0.0 || mesh.bodies().is_empty() {
            return lit;
        }
        let (point, normal) = (inputs.points.0.pixels()[i], inputs.normal.0.pixels()[i]);
        let from = point + normal * mesh.offset(point);
        let is_blocked =
            mesh.bodies().between(from, from + sunlight.direction * TUNING.sun_distance);
        if is_blocked { 0.0 } else { lit }
    };
    let (w, h) = sunlight.lit.size();
    Plane::new(w, h, (0..w * h).map(lit).collect())
}

tuning! {
    /// Constants of `Shadow`.
    pub const TUNING: ShadowStageTuning {
        /// Length of a ray to the sun, beyond any object of a room.
        sun_distance: f32 = 100.0,
            unit "meters", source Derived("rooms are smaller"), effect "a smaller value misses far objects";
    }
}
