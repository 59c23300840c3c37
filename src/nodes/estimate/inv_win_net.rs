//! `InvWinNet`: a network's estimate of the window that the photo does not show.

use std::sync::Arc;

use crate::geometry::Camera;
use crate::graph::{Context, File, Gather, Node, NodeError};
use crate::image::{Albedo, Depth, Mask, Normal, Picture};
use crate::net::Backend;
use crate::nodes::artifacts::Guess;
use crate::nodes::neural::NetworkScene;
use crate::{params, ports};

params! {
    /// Estimates the window out of view: a rectangle before sun, sky and ground, of radiance close
    /// to zero where there is not such a window.
    ///
    /// An initial value for a fit; it is as accurate as the room is similar to the training rooms
    /// (see the card beside the network).
    pub struct InvWinNet {
        /// The network, ONNX with the inputs and outputs that its card in models/ names.
        model: File = File::new("invwinnet.onnx"),
        /// Inference backend: `Rten`, or `OnnxRuntime(build)` when its library is loaded; the
        /// command sets it (`--backend`).
        backend: Backend = Backend::Rten,
    }
}

ports! {
    pub input InvWinNetIn {
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
    }
}

ports! {
    pub output InvWinNetOut {
        /// The light; without a value if it has no pixel at the network's size.
        guess: Arc<Guess>,
    }
}

impl Node for InvWinNet {
    const KIND: &'static str = "InvWinNet";
    const VERSION: u32 = 1;
    type In = InvWinNetIn;
    type Out = InvWinNetOut;

    fn files(&mut self) -> Vec<&mut File> {
        vec![&mut self.model]
    }

    fn run(&self, inputs: InvWinNetIn, ctx: &Context) -> Result<InvWinNetOut, NodeError> {
        let InvWinNetIn { photo, depth, camera, normal, albedo, masks } = &inputs;
        let room = NetworkScene { photo, depth, camera, normal, albedo, masks };
        let guess = room.window(ctx, &self.model, &self.backend, None)?;
        Ok(InvWinNetOut { guess: Arc::new(guess) })
    }
}
