//! `LightDraws`: the indirect light of one light under other guesses about the unseen room.

use std::sync::Arc;

use super::SAMPLES;
use crate::geometry::{Own, SceneMesh};
use crate::graph::{Context, Node, NodeError};
use crate::image::{Albedo, Mask};
use crate::nodes::artifacts::{UnitDirect, Visibility};
use crate::optics::{Bounces, DrawDifferences, DrawnLight, RoomDraws, Sampling, Shape};
use crate::{params, ports};

params! {
    /// Indirect light of one light in each of the rooms of `DrawRooms`, per lobe of unit radiance,
    /// as differences from the mean over the draws, at coarse receivers. A draw in whose room the
    /// light would be outside is left out.
    pub struct LightDraws {
        /// Shadow rays per place and lobe, at four places of each cell; samples of lights without a
        /// closed form.
        samples: u32 = 1, in SAMPLES,
        /// Bounces followed one by one, as in `TraceIndirect`.
        bounces: u32 = 4, in 0..=64,
        /// Radiosity of rays that meet neither a surface nor a cell, as in `TraceIndirect`.
        unseen: f32 = 0.5, in 0.0..=1.0,
        /// Seed of the random numbers.
        seed: u64 = 0,
    }
}

ports! {
    pub input LightDrawsIn {
        /// The drawn rooms.
        draws: Arc<RoomDraws>,
        /// The seen room, without inserted objects.
        mesh: Arc<SceneMesh>,
        /// The light.
        shape: Arc<Shape>,
        /// The light's own pixels, which do not block it.
        mask: Option<Arc<Mask>>,
        /// Diffuse albedo before an edit.
        albedo: Arc<Albedo>,
        /// Unshadowed direct shading per lobe.
        direct: Arc<UnitDirect>,
        /// The lit fraction of it.
        visibility: Arc<Visibility>,
    }
}

ports! {
    pub output LightDrawsOut {
        /// Differences of the draws from their mean.
        differences: Arc<DrawDifferences>,
    }
}

impl Node for LightDraws {
    const KIND: &'static str = "LightDraws";
    const VERSION: u32 = 1;
    type In = LightDrawsIn;
    type Out = LightDrawsOut;

    fn run(&self, inputs: LightDrawsIn, ctx: &Context) -> Result<LightDrawsOut, NodeError> {
        let LightDrawsIn { draws, mesh, shape, mask, albedo, direct, visibility, .. } = &inputs;
        let size = mesh.size();
        draws.grid.check(size).map_err(|rule| {
            NodeError::Failed(format!("draws: wanted {rule}, as `mesh` has, got another size"))
        })?;
        if let Some(mask) = mask {
            super::same_size("mask", mask.0.size(), "mesh", size)?;
        }
        super::same_size("albedo", albedo.0.size(), "mesh", size)?;
        let wanted = shape.lobes();
        for (name, got) in [("direct", direct.lobes.len()), ("visibility", visibility.lit.len())] {
            if got != wanted {
                return Err(NodeError::Failed(format!(
                    "`{name}` has {got} lobes, wanted {wanted} as `shape`"
                )));
            }
        }
        let mut arrives = Vec::new();
        for (direct, lit) in direct.lobes.iter().zip(&visibility.lit) {
            super::same_size("direct", direct.size(), "mesh", size)?;
            super::same_size("visibility", lit.size(), "mesh", size)?;
            arrives.push(super::shadowed(direct, lit));
        }
        let own = mask.as_deref().map(Own::new);
        let light = DrawnLight { shape, own: own.as_ref(), direct: &arrives, albedo };
        let bounces = Bounces { count: self.bounces as usize, unseen: self.unseen };
        let sampling = Sampling::fixed(self.samples as usize, self.seed);
        let (differences, rays) =
            DrawDifferences::new(draws, mesh, light, (sampling, bounces), &|| ctx.out_of_time());
        ctx.check_cancelled()?;
        ctx.count_rays(rays);
        Ok(LightDrawsOut { differences: Arc::new(differences) })
    }
}
