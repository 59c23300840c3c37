//! `Indirect`: indirect shading by a network that is linear in the light.

use std::sync::Arc;

use glam::Vec3;

use crate::geometry::{Camera, Grid};
use crate::graph::{Context, File, Gather, Node, NodeError};
use crate::image::{Albedo, Depth, Mask, Normal, Plane, Points, Shading, resize};
use crate::net::view::{Geometry, HALF, seen_half};
use crate::net::{Backend, InputLayer, Tensor, planes_of};
use crate::nodes::artifacts::{Residual, UnitDirect, UnitIndirect, Visibility};
use crate::nodes::neural::{self, HALF_1, HALF_3, HALF_6};
use crate::optics::Shape;
use crate::{params, ports};

params! {
    /// Indirect shading of one light, per lobe of unit radiance, by a network that is linear and
    /// non-negative in the light.
    ///
    /// I(a E1 + b E2) = a I(E1) + b I(E2) to rounding: gates from geometry and albedo, no bias and
    /// no activation on the light's own path (models/indirectnet.md). So one light's indirect
    /// picture is its own, and relighting is a sum.
    pub struct Indirect {
        /// The network, ONNX with the inputs and outputs of models/indirectnet.md.
        model: File = File::new("indirectnet.onnx"),
        /// Who computes it: `Rten`, or `OnnxRuntime(build)` when its library is loaded; the command
        /// sets it (`--backend`).
        backend: Backend = Backend::Rten,
        /// Share of the network's estimate in the result, 0..=1; the remainder is `traced`.
        share: f32 = 1.0, in 0.0..=1.0,
    }
}

ports! {
    pub input IndirectIn {
        /// Planar depth.
        depth: Arc<Depth>,
        /// The camera.
        camera: Arc<Camera>,
        /// Points of the seen surface.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// Diffuse albedo.
        albedo: Arc<Albedo>,
        /// Pixels of each visible light.
        masks: Gather<Mask>,
        /// The light.
        shape: Arc<Shape>,
        /// Its unshadowed unit shading.
        direct: Arc<UnitDirect>,
        /// The lit fraction of it.
        visibility: Arc<Visibility>,
        /// Photo shading minus direct light; without it, the unseen part is as bright as in most
        /// rooms.
        residual: Option<Arc<Residual>>,
        /// Traced indirect shading of the light; needed where `share` is below 1.
        traced: Option<Arc<UnitIndirect>>,
    }
}

ports! {
    pub output IndirectOut {
        /// Indirect shading per lobe, and the standard error of its traced share; that of the
        /// network's share is unknown.
        indirect: Arc<UnitIndirect>,
    }
}

const PORTS: [(&str, &[usize]); 7] = [
    ("geometry", HALF_6),
    ("albedo", HALF_3),
    ("light", HALF_1),
    ("direct", HALF_3),
    ("flux", &[1, 3, 1, 1]),
    ("left", HALF_3),
    ("burning", &[1, 6, 1, 1]),
];

impl Node for Indirect {
    const KIND: &'static str = "Indirect";
    const VERSION: u32 = 3;
    type In = IndirectIn;
    type Out = IndirectOut;

    fn files(&mut self) -> Vec<&mut File> {
        vec![&mut self.model]
    }

    fn run(&self, inputs: IndirectIn, ctx: &Context) -> Result<IndirectOut, NodeError> {
        let IndirectIn {
            depth,
            camera,
            points,
            normal,
            albedo,
            masks,
            shape,
            direct,
            visibility,
            residual,
            traced,
        } = inputs;
        if direct.lobes.is_empty() {
            return Ok(IndirectOut {
                indirect: Arc::new(UnitIndirect {
                    lobes: vec![],
                    stderr: vec![],
                    probes: vec![],
                    cells: vec![],
                }),
            });
        }
        if self.share < 1.0 && traced.is_none() {
            return Err(NodeError::Failed(format!(
                "share {}: wanted a wire to `traced`, got none",
                self.share
            )));
        }
        let size = points.0.size();
        let network = neural::network(ctx, &self.model, &self.backend, &PORTS, &["indirect"])?;
        let geometry = Geometry::half(&depth, &camera, &normal).tensor();
        let albedo = planes_of(&[InputLayer::Color(&resize(&albedo.0, HALF.0, HALF.1))]);
        let light = seen_half(masks.iter().map(|(_, mask)| &**mask));
        let (left, burning) = match &residual {
            Some(r) => (resize(&r.left, HALF.0, HALF.1), [r.direct, r.power]),
            None => (Plane::filled(HALF.0, HALF.1, Vec3::ZERO), [Vec3::ZERO; 2]),
        };
        let burning: Vec<f32> = burning.iter().flat_map(|v| v.to_array()).collect();
        let (light, left) =
            (planes_of(&[InputLayer::Gray(&light)]), planes_of(&[InputLayer::Color(&left)]));
        // Cell centers are between the pixels of a grid of stride two; half a pixel is small beside
        // their size.
        let grid = Grid::new(size, (size.0.div_ceil(HALF.0)).max(1));
        let mut lobes = Vec::new();
        for (lobe, (direct, lit)) in direct.lobes.iter().zip(&visibility.lit).enumerate() {
            ctx.check_cancelled()?;
            let arrives = resize(&super::shadowed(direct, lit), HALF.0, HALF.1);
            let tensors = vec![
                ("geometry", geometry.clone()),
                ("albedo", albedo.clone()),
                ("light", light.clone()),
                (
                    "direct",
                    planes_of(&[
                        InputLayer::Gray(&arrives),
                        InputLayer::Gray(&arrives),
                        InputLayer::Gray(&arrives),
                    ]),
                ),
                ("flux", Tensor::new(&[1, 3, 1, 1], vec![shape.flux(lobe); 3])),
                ("left", left.clone()),
                ("burning", Tensor::new(&[1, 6, 1, 1], burning.clone())),
            ];
            let [indirect] = neural::computed(&network, tensors, ["indirect"])?;
            let cells = resize(&indirect.color(0), grid.size().0, grid.size().1);
            lobes.push(Shading(grid.upsample(&points, &normal, cells.pixels())));
        }
        let mut stderr: Vec<Plane<f32>> = lobes.iter().map(|lobe| lobe.0.map(|_| 0.0)).collect();
        if let Some(traced) = traced.filter(|_| self.share < 1.0) {
            for ((own, error), (other, of_other)) in
                lobes.iter_mut().zip(&mut stderr).zip(traced.lobes.iter().zip(&traced.stderr))
            {
                for (own, other) in own.0.pixels_mut().iter_mut().zip(other.0.pixels()) {
                    *own = other.lerp(*own, self.share);
                }
                *error = of_other.map(|error| (1.0 - self.share) * error);
            }
        }
        Ok(IndirectOut {
            indirect: Arc::new(UnitIndirect { lobes, stderr, probes: vec![], cells: vec![] }),
        })
    }
}
