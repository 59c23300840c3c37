//! `OnnxMaterials`: materials by a third-party network.

use std::sync::Arc;

use glam::Vec3;

use crate::geometry::{Camera, orient_normals};
use crate::graph::{Context, File, Node, NodeError, check_range};
use crate::image::{Albedo, Normal, Picture, Plane, Roughness, Transfer, resize};
use crate::net::third_party::{self, Channels, Normalization, PhotoInput};
use crate::net::{Backend, Tensor};
use crate::nodes::neural;
use crate::{params, ports};

params! {
    /// Estimates albedo, normals or roughness by a third-party ONNX network, in the place of MNet.
    ///
    /// The network takes one photo [1, 3, height, width]; docs/networks.md has a worked example.
    /// Planes that it does not estimate come from the ports `albedo`, `normal` and `roughness`.
    pub struct OnnxMaterials {
        /// The network, an ONNX file. None ships with the program.
        model: File = File::default(),
        /// Inference backend: `Rten`, or `OnnxRuntime(build)` when its library is loaded. The
        /// command sets it (`--backend`).
        backend: Backend = Backend::Rten,
        /// Name of the network's input; optional, as the network has one input.
        input: Option<String> = None,
        /// Shorter side of the photo as the network takes it, pixels. A size that the file fixes
        /// takes precedence.
        side: u32 = 240, in 8..=4096,
        /// Divisor of each side, pixels.
        multiple: u32 = 32, in 1..=256,
        /// Transfer function of the network's input: Srgb, Gamma(2.2) or Linear.
        transfer: Transfer = Transfer::Srgb,
        /// Normalization of the encoded values 0..=1: ImageNet, Half, None, or Custom(mean,
        /// deviation).
        normalization: Normalization = Normalization::None,
        /// Three channels of albedo: (output: "name", first: channel, range: (value of 0, value of
        /// 1)).
        albedo: Option<Channels> = None,
        /// Transfer function of the albedo channels.
        albedo_transfer: Transfer = Transfer::Linear,
        /// Three channels of the normal's x, y and z, of any length. `range` has the values of -1
        /// and 1: (0, 1) for colors, (-1, 1) for numbers.
        normal: Option<Channels> = None,
        /// Signs, each 1 or -1, that make the axes x right, y up, z towards the camera.
        normal_signs: (f32, f32, f32) = (1.0, 1.0, 1.0),
        /// One channel of roughness.
        roughness: Option<Channels> = None,
    }
}

ports! {
    pub input OnnxMaterialsIn {
        /// The linear photo, working size.
        photo: Arc<Picture>,
        /// The camera, which the normals face.
        camera: Arc<Camera>,
        /// Albedo, if the network estimates none.
        albedo: Option<Arc<Albedo>>,
        /// Normals, if the network estimates none.
        normal: Option<Arc<Normal>>,
        /// Roughness, if the network estimates none.
        roughness: Option<Arc<Roughness>>,
    }
}

ports! {
    pub output OnnxMaterialsOut {
        /// Albedo in 0.02..=0.95, the photo's size.
        albedo: Arc<Albedo>,
        /// Unit length, facing the camera, the photo's size.
        normal: Arc<Normal>,
        /// Roughness in 0..=1, the photo's size.
        roughness: Arc<Roughness>,
    }
}

impl Node for OnnxMaterials {
    const KIND: &'static str = "OnnxMaterials";
    const VERSION: u32 = 1;
    type In = OnnxMaterialsIn;
    type Out = OnnxMaterialsOut;

    fn check_consistency(&self) -> Result<(), String> {
        if self.model.path.is_empty() {
            return Err("model: wanted the file of a network, got none".into());
        }
        self.normalization.check()?;
        let parts = self.parts();
        if parts.iter().all(|(_, part)| part.is_none()) {
            return Err(
                "wanted the name of an output for `albedo`, `normal` or `roughness`, got none"
                    .into(),
            );
        }
        for (name, part) in parts {
            part.iter()
                .try_for_each(|part| part.check())
                .map_err(|message| format!("{name}: {message}"))?;
        }
        let (x, y, z) = self.normal_signs;
        if [x, y, z].iter().any(|sign| sign.abs() != 1.0) {
            return Err(format!("normal_signs: wanted 1 or -1 each, got ({x}, {y}, {z})"));
        }
        match self.albedo_transfer {
            Transfer::Gamma(gamma) => {
                check_range("albedo_transfer: Gamma", &gamma, Transfer::GAMMA)
            }
            _ => Ok(()),
        }
    }

    fn files(&mut self) -> Vec<&mut File> {
        vec![&mut self.model]
    }

    fn run(&self, inputs: OnnxMaterialsIn, ctx: &Context) -> Result<OnnxMaterialsOut, NodeError> {
        let refused = |e| neural::refused(&self.model, &self.backend, e);
        let network = neural::loaded(ctx, &self.model, &self.backend)?;
        let mut outputs: Vec<&str> =
            self.parts().into_iter().filter_map(|(_, part)| Some(part?.output.as_str())).collect();
        outputs.sort_unstable();
        outputs.dedup();
        for name in &outputs {
            third_party::output(&network, Some(name)).map_err(refused)?;
        }
        let (input, seen) = self.photo_input().tensor(&network, &inputs.photo).map_err(refused)?;
        ctx.check_cancelled()?;
        let tensors = network.run_to(vec![(input, seen)], &outputs).map_err(refused)?;
        let of = |part: &Channels| -> &Tensor {
            let at = outputs
                .binary_search(&part.output.as_str())
                .expect("every part's output was asked for");
            &tensors[at]
        };

        let size = inputs.photo.0.size();
        let albedo = match &self.albedo {
            Some(part) => {
                Arc::new(self.read_albedo(&part.colors(of(part)).map_err(refused)?, size))
            }
            None => given("albedo", inputs.albedo, |albedo| albedo.0.size(), size)?,
        };
        let normal = match &self.normal {
            Some(part) => Arc::new(self.read_normal(
                &part.colors(of(part)).map_err(refused)?,
                &inputs.camera,
                size,
            )),
            None => given("normal", inputs.normal, |normal| normal.0.size(), size)?,
        };
        let roughness = match &self.roughness {
            Some(part) => {
                let rough = resize(&part.numbers(of(part)).map_err(refused)?, size.0, size.1);
                Arc::new(Roughness(rough.map(|r| r.clamp(0.0, 1.0))))
            }
            None => given("roughness", inputs.roughness, |roughness| roughness.0.size(), size)?,
        };
        Ok(OnnxMaterialsOut { albedo, normal, roughness })
    }
}

impl OnnxMaterials {
    fn photo_input(&self) -> PhotoInput<'_> {
        let &OnnxMaterials { ref input, side, multiple, transfer, normalization, .. } = self;
        PhotoInput { name: input.as_deref(), side, multiple, transfer, normalization }
    }

    fn parts(&self) -> [(&str, Option<&Channels>); 3] {
        [
            ("albedo", self.albedo.as_ref()),
            ("normal", self.normal.as_ref()),
            ("roughness", self.roughness.as_ref()),
        ]
    }

    fn read_albedo(&self, shares: &Plane<Vec3>, size: (usize, usize)) -> Albedo {
        let linear =
            |c: Vec3| Vec3::from_array(c.to_array().map(|c| self.albedo_transfer.decode(c)));
        let (least, most) =
            (Vec3::splat(super::TUNING.min_albedo), Vec3::splat(super::TUNING.max_albedo));
        Albedo(resize(&shares.map(linear), size.0, size.1).map(|a| a.clamp(least, most)))
    }

    /// Normals from numbers in 0..=1, which represent -1..=1.
    fn read_normal(
        &self,
        shares: &Plane<Vec3>,
        camera: &Camera,
        (width, height): (usize, usize),
    ) -> Normal {
        let signs = Vec3::from(self.normal_signs);
        let axes = shares.map(|share| (share * 2.0 - Vec3::ONE) * signs);
        orient_normals(resize(&axes, width, height), camera)
    }
}

/// The value of a port that replaces an output; it must have the photo's size.
fn given<T>(
    name: &str,
    value: Option<Arc<T>>,
    size: impl Fn(&T) -> (usize, usize),
    wanted: (usize, usize),
) -> Result<Arc<T>, NodeError> {
    let value = value.ok_or_else(|| {
        let message = format!(
            "{name}: wanted the name of an output of the network, or a wire to the input `{name}`, got neither"
        );
        NodeError::BadParameter(message)
    })?;
    match size(&value) {
        got if got == wanted => Ok(value),
        got => Err(NodeError::Failed(format!(
            "{name}: wanted the photo's {wanted:?} pixels, got {got:?}"
        ))),
    }
}
