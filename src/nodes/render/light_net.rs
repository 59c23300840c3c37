//! `LightNet`: the light that arrives at each place, by a network.

use std::sync::Arc;

use glam::Vec3;

use crate::geometry::Camera;
use crate::graph::{Context, File, Gather, Node, NodeError};
use crate::image::{Albedo, Depth, Mask, Normal, Plane, Roughness, Shading, resize};
use crate::net::view::{Geometry, HALF, own_half};
use crate::net::{Backend, InputLayer, planes_of};
use crate::nodes::neural::{self, HALF_1, HALF_3, HALF_6};
use crate::optics::{Lighting, LocalLobe, Radiance, Shape};
use crate::{params, ports};

params! {
    /// Estimates the incoming radiance at each place of the picture as 12 spherical Gaussians, on a
    /// grid of 40 x 30 cells.
    ///
    /// Only shiny objects, and stages that request it, need it. The result is proportional to the
    /// light's radiance.
    pub struct LightNet {
        /// The network, ONNX with the inputs and outputs of models/lightnet.md.
        model: File = File::new("lightnet.onnx"),
        /// Who computes it: `Rten`, or `OnnxRuntime(build)` when its library is loaded; the command
        /// sets it (`--backend`).
        backend: Backend = Backend::Rten,
    }
}

ports! {
    pub input LightNetIn {
        /// Planar depth.
        depth: Arc<Depth>,
        /// The camera.
        camera: Arc<Camera>,
        /// Normals of the seen surface.
        normal: Arc<Normal>,
        /// Diffuse albedo.
        albedo: Arc<Albedo>,
        /// Roughness.
        roughness: Arc<Roughness>,
        /// Pixels of each visible light.
        masks: Gather<Mask>,
        /// Every light.
        shape: Gather<Shape>,
        /// Its radiance.
        radiance: Gather<Radiance>,
        /// Shading by each light.
        light: Gather<Shading>,
        /// Residual shading, which no light explains.
        residual: Option<Arc<Shading>>,
    }
}

ports! {
    pub output LightNetOut {
        /// Incoming radiance, in units of the photo.
        lighting: Arc<Lighting>,
    }
}

const PORTS: [(&str, &[usize]); 5] = [
    ("geometry", HALF_6),
    ("albedo", HALF_3),
    ("rough", HALF_1),
    ("light", HALF_1),
    ("shading", HALF_3),
];
const OUTPUTS: [&str; 3] = ["axis", "sharpness", "weight"];

impl Node for LightNet {
    const KIND: &'static str = "LightNet";
    const VERSION: u32 = 1;
    type In = LightNetIn;
    type Out = LightNetOut;

    fn files(&mut self) -> Vec<&mut File> {
        vec![&mut self.model]
    }

    fn run(&self, inputs: LightNetIn, ctx: &Context) -> Result<LightNetOut, NodeError> {
        let network = neural::network(ctx, &self.model, &self.backend, &PORTS, &OUTPUTS)?;
        let geometry = Geometry::half(&inputs.depth, &inputs.camera, &inputs.normal);
        let half = |plane: &Plane<Vec3>| resize(plane, HALF.0, HALF.1);
        let mut shading = Plane::filled(HALF.0, HALF.1, Vec3::ZERO);
        for light in inputs.light.iter().map(|(_, light)| light).chain(&inputs.residual) {
            shading
                .pixels_mut()
                .iter_mut()
                .zip(half(&light.0).pixels())
                .for_each(|(sum, e)| *sum += *e);
        }
        // A light's own pixels show its radiance.
        let mut lights = Plane::filled(HALF.0, HALF.1, 0.0f32);
        for (id, mask) in inputs.masks.iter() {
            let own = own_half(mask);
            let (shape, radiance) = (inputs.shape.get(id), inputs.radiance.get(id));
            for i in (0..own.len()).filter(|&i| own.pixels()[i] > 0.0) {
                lights.pixels_mut()[i] = 1.0;
                shading.pixels_mut()[i] = match (shape.map(|s| &**s), radiance) {
                    (Some(Shape::Window(window)), Some(w)) => {
                        window.emitted(&w.0, geometry.points.pixels()[i].normalize())
                    }
                    (_, Some(w)) => w.0.iter().sum(),
                    _ => Vec3::ZERO,
                };
            }
        }
        let tensors = vec![
            ("geometry", geometry.tensor()),
            ("albedo", planes_of(&[InputLayer::Color(&half(&inputs.albedo.0))])),
            ("rough", planes_of(&[InputLayer::Gray(&resize(&inputs.roughness.0, HALF.0, HALF.1))])),
            ("light", planes_of(&[InputLayer::Gray(&lights)])),
            ("shading", planes_of(&[InputLayer::Color(&shading)])),
        ];
        let [axis, sharpness, weight] = neural::computed(&network, tensors, OUTPUTS)?;
        let &[_, count, rows, columns] = sharpness.shape() else {
            return Err(NodeError::Failed(format!(
                "sharpness: wanted four dimensions, got {:?}",
                sharpness.shape()
            )));
        };
        let cells = rows * columns;
        let vector = |tensor: &crate::net::Tensor, lobe: usize, cell: usize| {
            Vec3::from_array([0, 1, 2].map(|c| tensor.data()[(3 * lobe + c) * cells + cell]))
        };
        let lobe = |cell: usize, lobe: usize| LocalLobe {
            axis: vector(&axis, lobe, cell),
            sharpness: sharpness.data()[lobe * cells + cell],
            weight: vector(&weight, lobe, cell),
        };
        let lobe = &lobe;
        let lobes = (0..cells).flat_map(|cell| (0..count).map(move |l| lobe(cell, l))).collect();
        Ok(LightNetOut { lighting: Arc::new(Lighting { columns, rows, lobes }) })
    }
}
