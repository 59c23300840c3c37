//! WriteDepth: depth as the file that a scene names, and as a picture to look at.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Node, NodeError};
use crate::image::{Compression, Depth, ExrLayers, Picture, Transfer, nearness, write_png};
use crate::nodes::artifacts::Files;
use crate::{params, ports};

params! {
    /// Writes depth in the form that a scene reads, and a picture of it: white is near, black is
    /// far.
    pub struct WriteDepth {}
}

ports! {
    pub input WriteDepthIn {
        /// Planar z in meters.
        depth: Arc<Depth>,
    }
}
ports! {
    pub output WriteDepthOut {
        /// `depth.exr`, 32-bit floats in channel Z; `depth.png`, 1 / z from the farthest to the
        /// nearest.
        files: Arc<Files>,
    }
}

impl Node for WriteDepth {
    const KIND: &'static str = "WriteDepth";
    const VERSION: u32 = 1;
    type In = WriteDepthIn;
    type Out = WriteDepthOut;

    fn run(&self, inputs: WriteDepthIn, ctx: &Context) -> Result<WriteDepthOut, NodeError> {
        let depth = &inputs.depth.0;
        let (near, far) = depth
            .pixels()
            .iter()
            .fold((f32::MAX, 0.0f32), |(near, far), &z| (near.min(z), far.max(z)));
        ctx.note(format!("from {near:.2} m to {far:.2} m"));
        let mut layers = ExrLayers::new(depth.width(), depth.height());
        layers.float("Z", depth);
        layers.comment("units: planar z in metres");
        let bytes = layers.write(Compression::Zip).map_err(NodeError::Failed)?;
        let picture =
            write_png(&Picture(nearness(&inputs.depth).map(Vec3::splat)), Transfer::Linear, false);
        Ok(WriteDepthOut {
            files: Arc::new(Files(vec![
                ("depth.exr".into(), bytes),
                ("depth.png".into(), picture),
            ])),
        })
    }
}
