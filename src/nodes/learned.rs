//! What stages with a network have in common: the file, the backend, the room as networks take it.

use std::sync::Arc;

use crate::geometry::Camera;
use crate::graph::{Context, File, Gather, NodeError};
use crate::image::{Albedo, Depth, Mask, Normal, Picture, resize};
use crate::net::view::{FULL, Geometry, HALF, View, own_half};
use crate::net::{Backend, Layer, NetError, Network, Tensor, Untrusted, planes_of, precheck, ships};
use crate::nodes::artifacts::Guess;
use crate::optics::{Lamp, Lobe, Radiance, Shape, Window};

/// Shapes of inputs.
pub const FULL_1: &[usize] = &[1, 1, FULL.1, FULL.0];
pub const FULL_3: &[usize] = &[1, 3, FULL.1, FULL.0];
pub const FULL_6: &[usize] = &[1, 6, FULL.1, FULL.0];
pub const HALF_1: &[usize] = &[1, 1, HALF.1, HALF.0];
pub const HALF_2: &[usize] = &[1, 2, HALF.1, HALF.0];
pub const HALF_3: &[usize] = &[1, 3, HALF.1, HALF.0];
pub const HALF_5: &[usize] = &[1, 5, HALF.1, HALF.0];
pub const HALF_6: &[usize] = &[1, 6, HALF.1, HALF.0];

/// The network of `file`, checked against the inputs and outputs that the stage knows.
pub fn network(
    ctx: &Context,
    file: &File,
    backend: &Backend,
    inputs: &[(&str, &[usize])],
    outputs: &[&str],
) -> Result<Arc<Network>, NodeError> {
    let network = loaded(ctx, file, backend)?;
    network.expect(inputs, outputs).map_err(|e| refused(file, backend, e))?;
    Ok(network)
}

/// Returns the network of `file`. One that ships with relight is loaded once for all stages that use it; any other may be
/// hostile, and is loaded for this stage as the program says ([`Untrusted`]).
pub fn loaded(ctx: &Context, file: &File, backend: &Backend) -> Result<Arc<Network>, NodeError> {
    let threads = rayon::current_num_threads();
    let untrusted = ctx.service::<Untrusted>();
    let refused = |e| refused(file, backend, e);
    let here = ctx.shared(file, &format!("network by {backend:?}"), |bytes| {
        let name = file.location().file_name().unwrap_or_default().to_string_lossy().into_owned();
        if !ships(&name, &bytes).map_err(|message| bad(file, message))? {
            let Some(Untrusted::InProcess) = untrusted else { return Ok(None) };
            precheck(&bytes).map_err(|message| refused(NetError::Damaged(message)))?;
        }
        let network = Network::load(bytes, backend, threads).map_err(refused)?;
        Ok(Some(Arc::new(network)))
    })?;
    let network = match (&*here, untrusted) {
        (Some(network), _) => network.clone(),
        (None, Some(Untrusted::Sandboxed(sandbox))) => {
            let cancel = ctx.cancel();
            let cancelled = move || cancel.is_cancelled();
            let bytes = ctx.read(file)?;
            Arc::new(Network::load_sandboxed(&bytes, backend, threads, sandbox, cancelled).map_err(refused)?)
        }
        (None, _) => {
            return Err(NodeError::Failed(format!(
                "{}: wanted a network that ships with relight, as this program does not say where others are computed \
                 (relight::net::Untrusted, a service of the engine)",
                file.location().display()
            )));
        }
    };
    if let Some(doubt) = network.doubt() {
        ctx.warn(format!("{}: {doubt}", file.path));
    }
    ctx.note(format!("{} by {backend}", file.path));
    Ok(network)
}

/// What is wrong with the network of `file`.
pub fn refused(file: &File, backend: &Backend, error: NetError) -> NodeError {
    match error {
        NetError::NoBackend(message) => NodeError::BadParameter(format!("backend: {message}")),
        NetError::Damaged(message) => bad(file, format!("wanted a network in ONNX that {backend} computes: {message}")),
        NetError::Mismatch(message) | NetError::Run(message) | NetError::Limit(message) => bad(file, message),
        NetError::Ended(message) => NodeError::Failed(format!("{}: {message}", file.location().display())),
        NetError::Cancelled => NodeError::Cancelled,
    }
}

fn bad(file: &File, message: String) -> NodeError {
    NodeError::BadFile { path: file.location().display().to_string(), message }
}

/// What a network made of its inputs.
pub fn computed<const N: usize>(
    network: &Network,
    inputs: Vec<(&str, Tensor)>,
    outputs: [&str; N],
) -> Result<[Tensor; N], NodeError> {
    network.run(inputs, outputs).map_err(|e| match e {
        NetError::Cancelled => NodeError::Cancelled,
        e => NodeError::Failed(format!("its network: {e}")),
    })
}

/// The inputs that the networks which estimate lights share.
pub const LIGHT_INPUTS: [(&str, &[usize]); 5] =
    [("photo", HALF_3), ("geometry", HALF_6), ("albedo", HALF_3), ("lights", HALF_2), ("start", &[1, 5, 1, 1])];

/// The room before the networks that estimate lights.
pub struct LitRoom {
    view: View,
    geometry: Geometry,
    albedo: Tensor,
}

impl LitRoom {
    pub fn new(
        photo: &Picture,
        depth: &Depth,
        camera: &Camera,
        normal: &Normal,
        albedo: &Albedo,
        masks: &Gather<Mask>,
    ) -> LitRoom {
        LitRoom {
            view: View::new(photo, masks.iter().map(|(_, mask)| &**mask)),
            geometry: Geometry::half(depth, camera, normal),
            albedo: planes_of(&[Layer::Colour(&resize(&albedo.0, HALF.0, HALF.1))]),
        }
    }

    /// The inputs for the light whose pixels are `own`; `None` for one that has none at this size. Without a mask, for the light that is not seen.
    fn inputs(self, own: Option<&Mask>, is_window: bool) -> Option<Vec<(&'static str, Tensor)>> {
        let light = self.view.half_light();
        let (own, start) = match own {
            Some(mask) => {
                let own = own_half(mask);
                let start = crate::net::view::start(&self.geometry.points, &own, &light, is_window)?;
                (own, start)
            }
            None => (light.map(|_| 0.0), [0.0; 5]),
        };
        Some(vec![
            ("photo", planes_of(&[Layer::Colour(&self.view.half_photo())])),
            ("geometry", self.geometry.tensor()),
            ("albedo", self.albedo),
            ("lights", planes_of(&[Layer::Grey(&light), Layer::Grey(&own)])),
            ("start", Tensor::new(&[1, 5, 1, 1], start.to_vec())),
        ])
    }

    /// What a network for lamps says: a box. Radiances are in units of the photo.
    pub fn lamp(self, network: &Network, own: Option<&Mask>) -> Result<Option<Guess>, NodeError> {
        let gain = self.view.gain;
        let Some(inputs) = self.inputs(own, false) else { return Ok(None) };
        let [centre, axes, radiance, confidence] = computed(network, inputs, LAMP_OUTPUTS)?;
        let (centre, axes, radiance) = (centre.vectors(), axes.vectors(), radiance.vectors());
        let lamp = Lamp::Box { center: centre[0], axes: [axes[0], axes[1], axes[2]] };
        Ok(Some(guess(Shape::Lamp(lamp), radiance, gain, &confidence)))
    }

    /// What a network for windows says: a rectangle before three lobes. Radiances are in units of the photo.
    pub fn window(self, network: &Network, own: Option<&Mask>) -> Result<Option<Guess>, NodeError> {
        let gain = self.view.gain;
        let Some(inputs) = self.inputs(own, true) else { return Ok(None) };
        let [centre, x, y, directions, bandwidths, radiance, confidence] = computed(network, inputs, WINDOW_OUTPUTS)?;
        let directions = directions.vectors();
        let lobe = |i: usize| Lobe { direction: directions[i].normalize_or_zero(), bandwidth: bandwidths.data()[i] };
        let window = Window {
            center: centre.vectors()[0],
            x: x.vectors()[0],
            y: y.vectors()[0],
            lobes: [lobe(0), lobe(1), lobe(2)],
        };
        Ok(Some(guess(Shape::Window(window), radiance.vectors(), gain, &confidence)))
    }
}

pub const LAMP_OUTPUTS: [&str; 4] = ["centre", "axes", "radiance", "confidence"];
pub const WINDOW_OUTPUTS: [&str; 7] =
    ["centre", "half_x", "half_y", "directions", "bandwidths", "radiance", "confidence"];

fn guess(shape: Shape, radiance: Vec<glam::Vec3>, gain: f32, confidence: &Tensor) -> Guess {
    let radiance = Radiance(radiance.into_iter().map(|w| w / gain).collect());
    Guess { shape, radiance, burns: confidence.data()[0], error: confidence.data()[1] }
}

/// What is guessed of a light that has no pixel at the size of networks: nothing.
pub fn nothing() -> Guess {
    Guess { shape: Shape::Absent, radiance: Radiance(vec![]), burns: 0.0, error: 0.0 }
}

/// Declares a stage that estimates one light by a network: parameters, ports, run. `mask` is there for a light that the photo shows.
macro_rules! light_stage {
    (
        $(#[doc = $doc:literal])*
        $stage:ident, $input:ident, $output:ident: $call:ident of $model:literal, $ports:expr $(, $mask:ident)?
    ) => {
        use std::sync::Arc;

        use $crate::geometry::Camera;
        use $crate::graph::{Context, File, Gather, Node, NodeError};
        use $crate::image::{Albedo, Depth, Mask, Normal, Picture};
        use $crate::net::Backend;
        use $crate::nodes::artifacts::Guess;
        use $crate::nodes::learned;

        $crate::params! {
            $(#[doc = $doc])*
            ///
            /// The estimate is a start for a fit. Its error is lowest in rooms like those of the training data,
            /// which the card beside the network describes.
            pub struct $stage {
                /// The network, ONNX with the inputs and outputs of its card in models/.
                model: File = File::new($model),
                /// Inference backend: `Rten`, or `OnnxRuntime(build)` when its library is loaded. The
                /// command sets it (`--backend`).
                backend: Backend = Backend::Rten,
            }
        }

        $crate::ports! {
            pub input $input {
                /// The linear photo.
                photo: Arc<Picture>,
                /// Planar depth.
                depth: Arc<Depth>,
                /// The camera; resized to the network's input.
                camera: Arc<Camera>,
                /// Normals of the seen surface.
                normal: Arc<Normal>,
                /// Albedo.
                albedo: Arc<Albedo>,
                /// Pixels of each visible light.
                masks: Gather<Mask>,
                $(
                    /// The pixels of this light.
                    $mask: Arc<Mask>,
                )?
            }
        }

        $crate::ports! {
            pub output $output {
                /// The estimated light; absent if it has no pixel at the network's size.
                guess: Arc<Guess>,
            }
        }

        impl Node for $stage {
            const KIND: &'static str = stringify!($stage);
            const VERSION: u32 = 1;
            type In = $input;
            type Out = $output;

            fn files(&mut self) -> Vec<&mut File> {
                vec![&mut self.model]
            }

            fn run(&self, inputs: $input, ctx: &Context) -> Result<$output, NodeError> {
                let $input { photo, depth, camera, normal, albedo, masks $(, $mask)? } = inputs;
                let network = learned::network(ctx, &self.model, &self.backend, &learned::LIGHT_INPUTS, &$ports)?;
                let room = learned::LitRoom::new(&photo, &depth, &camera, &normal, &albedo, &masks);
                let own = None $( .or(Some(&*$mask)) )?;
                let guess = room.$call(&network, own)?.unwrap_or_else(learned::nothing);
                Ok($output { guess: Arc::new(guess) })
            }
        }
    };
}
pub(super) use light_stage;
