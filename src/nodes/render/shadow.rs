//! `Shadow`: which share of a light's direct shading arrives, per lobe.

use std::sync::Arc;

use crate::geometry::SceneMesh;
use crate::graph::{Context, Node, NodeError};
use crate::image::{Mask, Normal, Points};
use crate::nodes::artifacts::Visibility;
use crate::optics::{self, ShadowQuality, Shape};
use crate::{params, ports};

params! {
    /// Visibility of one light, per lobe, by rays to the samples that direct shading is made of.
    ///
    /// A ray is blocked by the seen surface, unknown where it passes behind a depth edge, lit otherwise; what lies outside
    /// the view is taken to be empty. `lit` holds the share seen to be lit plus `assume_lit` times the unknown share;
    /// `unknown` holds the unknown share itself.
    pub struct Shadow {
        /// Rays per traced pixel, 1..4096.
        samples: u32 = 8,
        /// Another seed gives other noise.
        seed: u64 = 0,
        /// Trace every second pixel along each axis and bring the result to all of them along the surfaces.
        half: bool = true,
        /// The share of unknown rays that counts as lit, 0..1.
        assume_lit: f32 = 1.0,
    }
}

ports! {
    pub input ShadowIn {
        /// The surface points.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// What casts the shadows.
        mesh: Arc<SceneMesh>,
        /// The light.
        shape: Arc<Shape>,
        /// The light's own pixels, which do not block it.
        mask: Option<Arc<Mask>>,
    }
}

ports! {
    pub output ShadowOut {
        /// Lit and unknown share per lobe.
        visibility: Arc<Visibility>,
    }
}

impl Node for Shadow {
    const KIND: &'static str = "Shadow";
    const VERSION: u32 = 2;
    type In = ShadowIn;
    type Out = ShadowOut;

    fn check(&self) -> Result<(), String> {
        if !(1..=4096).contains(&self.samples) {
            return Err(format!("samples: wanted 1..4096, got {}", self.samples));
        }
        if !(0.0..=1.0).contains(&self.assume_lit) {
            return Err(format!("assume_lit: wanted 0..1, got {}", self.assume_lit));
        }
        Ok(())
    }

    fn run(&self, inputs: ShadowIn, ctx: &Context) -> Result<ShadowOut, NodeError> {
        super::same_size("points", inputs.points.0.size(), "normal", inputs.normal.0.size())?;
        if let Some(mask) = &inputs.mask {
            super::same_size("mesh", inputs.mesh.size(), "mask", mask.0.size())?;
        }
        let quality = ShadowQuality {
            samples: self.samples as usize,
            seed: self.seed,
            stride: if self.half { 2 } else { 1 },
            assume_lit: self.assume_lit,
        };
        ctx.check_cancelled()?;
        let own = inputs.mask.as_deref();
        let shadow = optics::shadow(&inputs.mesh, &inputs.points, &inputs.normal, &inputs.shape, own, quality);
        ctx.count_rays(shadow.rays);
        Ok(ShadowOut { visibility: Arc::new(Visibility { lit: shadow.lit, unknown: shadow.unknown }) })
    }
}
