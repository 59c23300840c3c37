//! `MNet`: materials by a network.

use std::sync::Arc;

use glam::Vec3;

use crate::geometry::{Camera, orient_normals};
use crate::graph::{Context, File, Gather, Node, NodeError};
use crate::image::{Albedo, Depth, Mask, Normal, Picture, Roughness, resize};
use crate::net::view::{Geometry, View};
use crate::net::{Backend, InputLayer, planes_of};
use crate::nodes::neural::{self, FULL_1, FULL_3, FULL_6};
use crate::{params, ports};

params! {
    /// Estimates albedo, normal and roughness of every pixel from a photo and its depth by a
    /// network.
    ///
    /// The network works at 320 x 240, to which the photo is resized. An aspect ratio far from 4:3
    /// lies outside its training data.
    pub struct MNet {
        /// The network, ONNX with the inputs and outputs of models/mnet.md.
        model: File = File::new("mnet.onnx"),
        /// Inference backend: `Rten`, or `OnnxRuntime(build)` when its library is loaded. The
        /// command sets it (`--backend`).
        backend: Backend = Backend::Rten,
    }
}

ports! {
    pub input MNetIn {
        /// The linear photo, working size.
        photo: Arc<Picture>,
        /// Planar depth.
        depth: Arc<Depth>,
        /// The camera; resized to the network's input.
        camera: Arc<Camera>,
        /// Pixels of each visible light.
        masks: Gather<Mask>,
    }
}

ports! {
    pub output MNetOut {
        /// Albedo in 0.02..=0.95, the photo's size.
        albedo: Arc<Albedo>,
        /// Unit length, facing the camera, the photo's size.
        normal: Arc<Normal>,
        /// Roughness in 0..=1, the photo's size.
        roughness: Arc<Roughness>,
    }
}

impl Node for MNet {
    const KIND: &'static str = "MNet";
    const VERSION: u32 = 1;
    type In = MNetIn;
    type Out = MNetOut;

    fn files(&mut self) -> Vec<&mut File> {
        vec![&mut self.model]
    }

    fn run(&self, inputs: MNetIn, ctx: &Context) -> Result<MNetOut, NodeError> {
        let MNetIn { photo, depth, camera, masks } = inputs;
        let (ports, outputs) = (
            [("photo", FULL_3), ("geometry", FULL_6), ("light", FULL_1)],
            ["albedo", "normal", "rough"],
        );
        let network = neural::network(ctx, &self.model, &self.backend, &ports, &outputs)?;
        let view = View::new(&photo, masks.iter().map(|(_, mask)| &**mask));
        let tensors = vec![
            ("photo", planes_of(&[InputLayer::Color(&view.photo)])),
            ("geometry", Geometry::raw(&depth, &camera).tensor()),
            ("light", planes_of(&[InputLayer::Gray(&view.light)])),
        ];
        let [albedo, normal, rough] = neural::computed(&network, tensors, outputs)?;
        let (width, height) = photo.0.size();
        let normal = orient_normals(resize(&normal.color(0), width, height), &camera);
        let (least, most) =
            (Vec3::splat(super::TUNING.min_albedo), Vec3::splat(super::TUNING.max_albedo));
        Ok(MNetOut {
            albedo: Arc::new(Albedo(
                resize(&albedo.color(0), width, height).map(|a| a.clamp(least, most)),
            )),
            normal: Arc::new(normal),
            roughness: Arc::new(Roughness(
                resize(&rough.gray(0), width, height).map(|r| r.clamp(0.0, 1.0)),
            )),
        })
    }
}
