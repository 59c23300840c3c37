//! `LightRoom`: the direct light on the hidden sides of the room.

use std::sync::Arc;

use super::SAMPLES;
use crate::geometry::{Own, RoomLayout, SceneMesh};
use crate::graph::{Context, Node, NodeError};
use crate::image::Mask;
use crate::nodes::artifacts::CellLight;
use crate::optics::{Sampling, Shape, arriving_at_cells};
use crate::{params, ports};

params! {
    /// Direct light of one light on the cells of the room's hidden sides, per lobe of unit
    /// radiance, with the shadows that the seen room and bodies cast on them.
    pub struct LightRoom {
        /// Shadow rays per place and lobe, at four places of each cell; samples of lights without a
        /// closed form.
        samples: u32 = 4, in SAMPLES,
        /// Seed of the random numbers.
        seed: u64 = 0,
    }
}

ports! {
    pub input LightRoomIn {
        /// The cuboid of the room.
        layout: Arc<RoomLayout>,
        /// The seen room, with the objects in it.
        mesh: Arc<SceneMesh>,
        /// The light.
        shape: Arc<Shape>,
        /// The light's own pixels, which do not block it.
        mask: Option<Arc<Mask>>,
    }
}

ports! {
    pub output LightRoomOut {
        /// Direct light at the cells.
        light: Arc<CellLight>,
    }
}

impl Node for LightRoom {
    const KIND: &'static str = "LightRoom";
    const VERSION: u32 = 1;
    type In = LightRoomIn;
    type Out = LightRoomOut;

    fn run(&self, inputs: LightRoomIn, ctx: &Context) -> Result<LightRoomOut, NodeError> {
        let LightRoomIn { layout, mesh, shape, mask } = inputs;
        if let Some(mask) = &mask {
            super::same_size("mask", mask.0.size(), "mesh", mesh.size())?;
        }
        let own = mask.as_deref().map(Own::new);
        let sampling = Sampling::fixed(self.samples as usize, self.seed);
        let stop = || ctx.out_of_time();
        let (lobes, rays) =
            arriving_at_cells(&mesh, &layout, &shape, own.as_ref(), sampling, &stop);
        ctx.check_cancelled()?;
        ctx.count_rays(rays);
        Ok(LightRoomOut { light: Arc::new(CellLight { lobes }) })
    }
}
