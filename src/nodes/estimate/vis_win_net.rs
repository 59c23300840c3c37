//! `VisWinNet`: a network's estimate of a window that the photo shows.

use std::sync::Arc;

use crate::geometry::Camera;
use crate::graph::{Context, File, Gather, Node, NodeError};
use crate::image::{Albedo, Depth, Mask, Normal, Picture};
use crate::net::Backend;
use crate::nodes::artifacts::Guess;
use crate::nodes::neural::NetworkScene;
use crate::{params, ports};

params! {
    /// Estimates a visible window: a rectangle before sun, sky and ground.
    ///
    /// An initial value for a fit; it is as accurate as the room is similar to the training rooms
    /// (see the card beside the network).
    pub struct VisWinNet {
        /// The network, ONNX with the inputs and outputs that its card in models/ names.
        model: File = File::new("viswinnet.onnx"),
        /// Inference backend: `Rten`, or `OnnxRuntime(build)` when its library is loaded; the
        /// command sets it (`--backend`).
        backend: Backend = Backend::Rten,
    }
}

ports! {
    pub input VisWinNetIn {
        /// The linear photo.
        photo: Arc<Picture>,
        /// Planar z.
        depth: Arc<Depth>,
        /// The camera; brought to the network's size.
        camera: Arc<Camera>,
        /// Normals of the seen surface.
        normal: Arc<Normal>,
        /// Albedo.
        albedo: Arc<Albedo>,
        /// Pixels of each visible light.
        masks: Gather<Mask>,
        /// The pixels of this light.
        mask: Arc<Mask>,
    }
}

ports! {
    pub output VisWinNetOut {
        /// The light; without a value if it has no pixel at the network's size.
        guess: Arc<Guess>,
    }
}

impl Node for VisWinNet {
    const KIND: &'static str = "VisWinNet";
    const VERSION: u32 = 1;
    type In = VisWinNetIn;
    type Out = VisWinNetOut;

    fn files(&mut self) -> Vec<&mut File> {
        vec![&mut self.model]
    }

    fn run(&self, inputs: VisWinNetIn, ctx: &Context) -> Result<VisWinNetOut, NodeError> {
        let VisWinNetIn { photo, depth, camera, normal, albedo, masks, mask } = &inputs;
        let room = NetworkScene { photo, depth, camera, normal, albedo, masks };
        let guess = room.window(ctx, &self.model, &self.backend, Some(mask))?;
        Ok(VisWinNetOut { guess: Arc::new(guess) })
    }
}
