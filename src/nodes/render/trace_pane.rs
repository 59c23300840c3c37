//! `TracePane`: the rays that the pane of a window reflects into the room.

use std::sync::Arc;

use crate::geometry::{Camera, SceneMesh};
use crate::graph::{Context, Node, NodeError};
use crate::image::GlareMask;
use crate::optics::{PaneRays, Shape};
use crate::{params, ports};

params! {
    /// Traces the rays that the pane of a window in view reflects into the room.
    ///
    /// A pane is a mirror in the rectangle of its window, of which each working pixel shows one
    /// ray. No edit of a light changes them.
    pub struct TracePane {}
}

ports! {
    pub input TracePaneIn {
        /// The own pixels of the window, photo size.
        mask: Arc<GlareMask>,
        /// Its shape as estimated.
        shape: Arc<Shape>,
        /// The surfaces that the camera sees, working size.
        mesh: Arc<SceneMesh>,
        /// The camera of the photo.
        camera: Arc<Camera>,
    }
}

ports! {
    pub output TracePaneOut {
        /// The reflected rays.
        rays: Arc<PaneRays>,
    }
}

impl Node for TracePane {
    const KIND: &'static str = "TracePane";
    const VERSION: u32 = 1;
    type In = TracePaneIn;
    type Out = TracePaneOut;

    fn run(&self, inputs: TracePaneIn, ctx: &Context) -> Result<TracePaneOut, NodeError> {
        let rays = PaneRays::new(&inputs.mask, &inputs.shape, &inputs.mesh, &inputs.camera);
        ctx.count_rays(rays.len() as u64);
        Ok(TracePaneOut { rays: Arc::new(rays) })
    }
}
