//! `Transport`: visibility between all parts of the room; traced once, independent of the light.

use std::sync::Arc;

use crate::geometry::{RoomLayout, SceneMesh, SideSource};
use crate::graph::{Context, Node, NodeError};
use crate::image::{Normal, Points};
use crate::optics;
use crate::{params, ports};

params! {
    /// Cosine-distributed rays from a coarse grid of receivers, and the pixels they meet, for
    /// `TraceIndirect`. Near inserted bodies every pixel traces rays to them.
    pub struct Transport {
        /// Distance of the receivers along each axis, pixels.
        stride: u32 = 4, in 1..=64,
        /// Rays per receiver, 1..4096, rounded up to four equal batches, whose spread is the error.
        rays: u32 = 128, in 1..=4096,
        /// Seed of the random numbers.
        seed: u64 = 0,
    }
}

ports! {
    pub input TransportIn {
        /// The seen room.
        mesh: Arc<SceneMesh>,
        /// The surface points, of the size of `mesh`.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// The cuboid of the room, whose hidden sides then receive and reflect light.
        layout: Option<Arc<RoomLayout>>,
    }
}

ports! {
    pub output TransportOut {
        /// The hits of the gathering rays of each receiver.
        transport: Arc<optics::LightTransport>,
    }
}

impl Node for Transport {
    const KIND: &'static str = "Transport";
    const VERSION: u32 = 6;
    type In = TransportIn;
    type Out = TransportOut;

    fn run(&self, inputs: TransportIn, ctx: &Context) -> Result<TransportOut, NodeError> {
        super::same_size("points", inputs.points.0.size(), "mesh", inputs.mesh.size())?;
        super::same_size("normal", inputs.normal.0.size(), "mesh", inputs.mesh.size())?;
        ctx.check_cancelled()?;
        let (stride, rays) = (self.stride as usize, self.rays as usize);
        let transport = optics::trace_bounces(
            &inputs.mesh,
            &inputs.points,
            &inputs.normal,
            inputs.layout.as_deref(),
            (stride, rays),
            self.seed,
        );
        ctx.count_rays(transport.rays());
        let sides = inputs.layout.map_or([SideSource::Open; 6], |layout| layout.sides);
        ctx.note(transport.ray_fractions(&sides).to_string());
        Ok(TransportOut { transport: Arc::new(transport) })
    }
}
