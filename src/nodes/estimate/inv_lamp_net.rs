//! `InvLampNet`: a network's estimate of the lamp that the photo does not show.

use std::sync::Arc;

use crate::geometry::Camera;
use crate::graph::{Context, File, Gather, Node, NodeError};
use crate::image::{Albedo, Depth, Mask, Normal, Picture};
use crate::net::Backend;
use crate::nodes::artifacts::Guess;
use crate::nodes::neural::NetworkScene;
use crate::{params, ports};

params! {
    /// Estimates the lamp out of view: a box of one radiance, close to zero where there is not such
    /// a lamp.
    ///
    /// An initial value for a fit; it is as accurate as the room is similar to the training rooms
    /// (see the card beside the network).
    pub struct InvLampNet {
        /// The network, ONNX with the inputs and outputs that its card in models/ names.
        model: File = File::new("invlampnet.onnx"),
        /// Inference backend: `Rten`, or `OnnxRuntime(build)` when its library is loaded; the
        /// command sets it (`--backend`).
        backend: Backend = Backend::Rten,
    }
}

ports! {
    pub input InvLampNetIn {
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
    pub output InvLampNetOut {
        /// The light; without a value if it has no pixel at the network's size.
        guess: Arc<Guess>,
    }
}

impl Node for InvLampNet {
    const KIND: &'static str = "InvLampNet";
    const VERSION: u32 = 1;
    type In = InvLampNetIn;
    type Out = InvLampNetOut;

    fn files(&mut self) -> Vec<&mut File> {
        vec![&mut self.model]
    }

    fn run(&self, inputs: InvLampNetIn, ctx: &Context) -> Result<InvLampNetOut, NodeError> {
        let InvLampNetIn { photo, depth, camera, normal, albedo, masks } = &inputs;
        let room = NetworkScene { photo, depth, camera, normal, albedo, masks };
        let guess = room.lamp(ctx, &self.model, &self.backend, None)?;
        Ok(InvLampNetOut { guess: Arc::new(guess) })
    }
}
