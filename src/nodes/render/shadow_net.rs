//! `ShadowNet`: visibility through the unseen part of the room, by a network.

use std::sync::Arc;

use glam::Vec3;

use crate::geometry::Camera;
use crate::graph::{Context, File, Node, NodeError};
use crate::image::{Depth, Normal, Plane, resize};
use crate::net::view::{Geometry, HALF};
use crate::net::{Backend, InputLayer, Tensor, planes_of};
use crate::nodes::artifacts::{UnitDirect, Visibility};
use crate::nodes::neural::{self, HALF_5, HALF_6};
use crate::optics::{Shape, Window};
use crate::tuning::tuning;
use crate::{params, ports};

params! {
    /// Estimates the lit fraction of unknown rays: V = traced - unknown + unknown x network, per
    /// lobe.
    ///
    /// Takes the visibility of `Shadow` with `outside_unknown`, in which unknown rays count as lit.
    /// The traced value stays where no ray is unknown, and a light without unknown rays needs no
    /// network.
    pub struct ShadowNet {
        /// The network, ONNX with the inputs and outputs of models/shadownet.md.
        model: File = File::new("shadownet.onnx"),
        /// Who computes it: `Rten`, or `OnnxRuntime(build)` when its library is loaded; the command
        /// sets it (`--backend`).
        backend: Backend = Backend::Rten,
        /// Lets the network also correct rays that the depth mesh takes for known (thin things,
        /// edges).
        everywhere: bool = false,
    }
}

ports! {
    pub input ShadowNetIn {
        /// Planar depth.
        depth: Arc<Depth>,
        /// The camera.
        camera: Arc<Camera>,
        /// Normals of the seen surface.
        normal: Arc<Normal>,
        /// The light.
        shape: Arc<Shape>,
        /// Its unshadowed unit shading.
        direct: Arc<UnitDirect>,
        /// Its traced visibility, in which unknown rays count as lit.
        visibility: Arc<Visibility>,
    }
}

ports! {
    pub output ShadowNetOut {
        /// The visibility with the network's estimate for unknown rays; `unknown` stays as it was.
        visibility: Arc<Visibility>,
    }
}

tuning! {
    /// Constants of `ShadowNet`.
    pub const TUNING: ShadowNetTuning {
        /// Mean unknown fraction of a lobe's direct shading above which the network is asked: rays
        /// that graze edges are not worth it.
        min_unknown: f64 = 1e-3,
            unit "1", source Taste, effect "a larger value asks the network less often";
    }
}

impl Node for ShadowNet {
    const KIND: &'static str = "ShadowNet";
    const VERSION: u32 = 1;
    type In = ShadowNetIn;
    type Out = ShadowNetOut;

    fn files(&mut self) -> Vec<&mut File> {
        vec![&mut self.model]
    }

    fn run(&self, inputs: ShadowNetIn, ctx: &Context) -> Result<ShadowNetOut, NodeError> {
        let ShadowNetIn { depth, camera, normal, shape, direct, visibility } = inputs;
        let doubtful = |lobe: &usize| {
            let (unknown, direct) =
                (visibility.unknown[*lobe].pixels(), direct.lobes[*lobe].pixels());
            let sum = |of: &dyn Fn(usize) -> f32| {
                (0..direct.len()).map(|i| f64::from(of(i))).sum::<f64>()
            };
            sum(&|i| unknown[i] * direct[i]) > TUNING.min_unknown * sum(&|i| direct[i])
        };
        let asked: Vec<usize> = (0..direct.lobes.len()).filter(doubtful).collect();
        if asked.is_empty() {
            return Ok(ShadowNetOut { visibility });
        }
        let ports = [("visibility", HALF_5), ("geometry", HALF_6), ("place", &[1, 12, 1, 1][..])];
        let network = neural::network(ctx, &self.model, &self.backend, &ports, &["shares"])?;
        let geometry = Geometry::half(&depth, &camera, &normal).tensor();
        let small = |plane: &Plane<f32>| resize(plane, HALF.0, HALF.1);
        let mut filled = Visibility::clone(&visibility);
        for lobe in asked {
            ctx.check_cancelled()?;
            let (traced, unknown) = (&visibility.lit[lobe], &visibility.unknown[lobe]);
            // The photo minus the other lights' layers depends on all estimates; the network was
            // also trained without this input.
            let unseen = Plane::filled(HALF.0, HALF.1, 0.0);
            let planes =
                [small(traced), small(unknown), small(&direct.lobes[lobe]), unseen.clone(), unseen];
            let tensors = vec![
                ("visibility", planes_of(&planes.each_ref().map(InputLayer::Gray))),
                ("geometry", geometry.clone()),
                ("place", Tensor::new(&[1, 12, 1, 1], place(&shape, lobe))),
            ];
            let [shares] = neural::computed(&network, tensors, ["shares"])?;
            let (width, height) = traced.size();
            let [lit, instead, doubt] = [0, 1, 2].map(|c| resize(&shares.gray(c), width, height));
            filled.lit[lobe] = Plane::from_fn(width, height, |x, y| {
                let unknown = unknown.get(x, y);
                let known = traced.get(x, y) - unknown + unknown * lit.get(x, y);
                let doubt = if self.everywhere { doubt.get(x, y) } else { 0.0 };
                ((1.0 - doubt) * known + doubt * instead.get(x, y)).clamp(0.0, 1.0)
            });
        }
        Ok(ShadowNetOut { visibility: Arc::new(filled) })
    }
}

/// Center, half edges of a window, direction to its sun where the lobe is one: 12 numbers, zeros
/// for missing ones.
fn place(shape: &Shape, lobe: usize) -> Vec<f32> {
    let center = shape.bounding_sphere().map_or(Vec3::ZERO, |(center, _)| center);
    let (x, y, sun) = match shape {
        Shape::Window(Window { x, y, lobes, .. }) => {
            (*x, *y, if lobe == 0 { lobes[0].direction } else { Vec3::ZERO })
        }
        _ => (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO),
    };
    [center, x, y, sun].iter().flat_map(|v| v.to_array()).collect()
}
