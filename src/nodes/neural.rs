//! The shared parts of stages with a network: its file, its backend, and the room as its inputs.

use std::sync::Arc;

use crate::geometry::Camera;
use crate::graph::{Context, File, Gather, NodeError};
use crate::image::{Albedo, Depth, Mask, Normal, Picture, resize};
use crate::net::view::{FULL, Geometry, HALF, View, own_half};
use crate::net::{
    Backend, InputLayer, NetError, Network, Tensor, Untrusted, planes_of, precheck, ships,
};
use crate::nodes::artifacts::Guess;
use crate::optics::{BoxLamp, Lamp, Lobe, Radiance, Shape, Window};

/// One plane at full size: (batch, channels, height, width), as of all shapes here.
pub const FULL_1: &[usize] = &[1, 1, FULL.1, FULL.0];
/// Three planes at full size.
pub const FULL_3: &[usize] = &[1, 3, FULL.1, FULL.0];
/// Six planes at full size.
pub const FULL_6: &[usize] = &[1, 6, FULL.1, FULL.0];
/// One plane at half size.
pub const HALF_1: &[usize] = &[1, 1, HALF.1, HALF.0];
/// Two planes at half size.
pub const HALF_2: &[usize] = &[1, 2, HALF.1, HALF.0];
/// Three planes at half size.
pub const HALF_3: &[usize] = &[1, 3, HALF.1, HALF.0];
/// Five planes at half size.
pub const HALF_5: &[usize] = &[1, 5, HALF.1, HALF.0];
/// Six planes at half size.
pub const HALF_6: &[usize] = &[1, 6, HALF.1, HALF.0];

/// The network of `file`, checked against the inputs and outputs that a stage expects.
///
/// # Errors
/// The file cannot be read, or its network cannot be loaded or does not fit.
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

/// Returns the network of `file`. A network that ships with relight is loaded once for all stages
/// that use it; any other may be hostile, and is loaded for this stage by the service of the
/// program ([`Untrusted`]).
///
/// # Errors
/// The file cannot be read, or its network cannot be loaded.
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
            Arc::new(
                Network::load_sandboxed(&bytes, backend, threads, sandbox, cancelled)
                    .map_err(refused)?,
            )
        }
        (None, _) => {
            return Err(NodeError::Failed(format!(
                "{}: wanted a network that ships with relight, as this program has no process for others \
                 (relight::net::Untrusted, a service of the engine)",
                file.location().display()
            )));
        }
    };
    if let Some(caution) = network.caution() {
        ctx.warn(format!("{}: {caution}", file.path));
    }
    ctx.note(format!("{} by {backend}", file.path));
    Ok(network)
}

/// The error of a stage whose network, from `file`, failed with `error`.
pub fn refused(file: &File, backend: &Backend, error: NetError) -> NodeError {
    match error {
        NetError::NoBackend(message) => NodeError::BadParameter(format!("backend: {message}")),
        NetError::Damaged(message) => {
            bad(file, format!("wanted a network in ONNX that {backend} computes: {message}"))
        }
        NetError::Mismatch(message) | NetError::Run(message) | NetError::Limit(message) => {
            bad(file, message)
        }
        NetError::Ended(message) => {
            NodeError::Failed(format!("{}: {message}", file.location().display()))
        }
        NetError::Cancelled => NodeError::Cancelled,
    }
}

fn bad(file: &File, message: String) -> NodeError {
    NodeError::BadFile { path: file.location().display().to_string(), message }
}

/// The outputs of a network.
///
/// # Errors
/// The network fails, or the run is cancelled.
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
const LIGHT_INPUTS: [(&str, &[usize]); 5] = [
    ("photo", HALF_3),
    ("geometry", HALF_6),
    ("albedo", HALF_3),
    ("lights", HALF_2),
    ("start", &[1, 5, 1, 1]),
];

/// The room of a stage that estimates a light.
pub struct NetworkScene<'a> {
    /// The linear photo.
    pub photo: &'a Picture,
    /// Planar z.
    pub depth: &'a Depth,
    /// The camera of the photo.
    pub camera: &'a Camera,
    /// Normals of the seen surface.
    pub normal: &'a Normal,
    /// Albedo.
    pub albedo: &'a Albedo,
    /// Pixels of each visible light.
    pub masks: &'a Gather<Mask>,
}

impl NetworkScene<'_> {
    /// Estimates a lamp: a box of one radiance. `own` marks its pixels; `None` for the lamp out of
    /// view.
    ///
    /// # Errors
    /// The network cannot be loaded, or does not fit, or fails.
    pub fn lamp(
        &self,
        ctx: &Context,
        model: &File,
        backend: &Backend,
        own: Option<&Mask>,
    ) -> Result<Guess, NodeError> {
        let network = network(ctx, model, backend, &LIGHT_INPUTS, &LAMP_OUTPUTS)?;
        Ok(LitRoom::new(self).lamp(&network, own)?.unwrap_or_else(nothing))
    }

    /// Estimates a window: a rectangle with three lobes. `own` marks its pixels; `None` for the
    /// window out of view.
    ///
    /// # Errors
    /// As [`SeenRoom::lamp`].
    pub fn window(
        &self,
        ctx: &Context,
        model: &File,
        backend: &Backend,
        own: Option<&Mask>,
    ) -> Result<Guess, NodeError> {
        let network = network(ctx, model, backend, &LIGHT_INPUTS, &WINDOW_OUTPUTS)?;
        Ok(LitRoom::new(self).window(&network, own)?.unwrap_or_else(nothing))
    }
}

/// The room at the size of the networks that estimate lights.
struct LitRoom {
    view: View,
    geometry: Geometry,
    albedo: Tensor,
}

impl LitRoom {
    fn new(room: &NetworkScene) -> LitRoom {
        let NetworkScene { photo, depth, camera, normal, albedo, masks } = room;
        LitRoom {
            view: View::new(photo, masks.iter().map(|(_, mask)| &**mask)),
            geometry: Geometry::half(depth, camera, normal),
            albedo: planes_of(&[InputLayer::Color(&resize(&albedo.0, HALF.0, HALF.1))]),
        }
    }

    /// The inputs for the light whose pixels are `own`; `None` for a light without a pixel at this
    /// size. Without a mask, the inputs are those for the light out of view.
    fn inputs(self, own: Option<&Mask>, is_window: bool) -> Option<Vec<(&'static str, Tensor)>> {
        let light = self.view.half_light();
        let (own, start) = match own {
            Some(mask) => {
                let own = own_half(mask);
                let start =
                    crate::net::view::start(&self.geometry.points, &own, &light, is_window)?;
                (own, start)
            }
            None => (light.map(|_| 0.0), [0.0; 5]),
        };
        Some(vec![
            ("photo", planes_of(&[InputLayer::Color(&self.view.half_photo())])),
            ("geometry", self.geometry.tensor()),
            ("albedo", self.albedo),
            ("lights", planes_of(&[InputLayer::Gray(&light), InputLayer::Gray(&own)])),
            ("start", Tensor::new(&[1, 5, 1, 1], start.to_vec())),
        ])
    }

    /// The output of a network for lamps: a box. Radiances are in units of the photo.
    fn lamp(self, network: &Network, own: Option<&Mask>) -> Result<Option<Guess>, NodeError> {
        let gain = self.view.gain;
        let Some(inputs) = self.inputs(own, false) else { return Ok(None) };
        let [center, axes, radiance, confidence] = computed(network, inputs, LAMP_OUTPUTS)?;
        let (center, axes, radiance) = (center.vectors(), axes.vectors(), radiance.vectors());
        let lamp = Lamp::Box(BoxLamp { center: center[0], axes: [axes[0], axes[1], axes[2]] });
        Ok(Some(guess(Shape::Lamp(lamp), radiance, gain, &confidence)))
    }

    /// The output of a network for windows: a rectangle with three lobes. Radiances are in units of
    /// the photo.
    fn window(self, network: &Network, own: Option<&Mask>) -> Result<Option<Guess>, NodeError> {
        let gain = self.view.gain;
        let Some(inputs) = self.inputs(own, true) else { return Ok(None) };
        let [center, x, y, directions, bandwidths, radiance, confidence] =
            computed(network, inputs, WINDOW_OUTPUTS)?;
        let directions = directions.vectors();
        let lobe = |i: usize| Lobe {
            direction: directions[i].normalize_or_zero(),
            bandwidth: bandwidths.data()[i],
        };
        let window = Window {
            center: center.vectors()[0],
            x: x.vectors()[0],
            y: y.vectors()[0],
            lobes: [lobe(0), lobe(1), lobe(2)],
        };
        Ok(Some(guess(Shape::Window(window), radiance.vectors(), gain, &confidence)))
    }
}

const LAMP_OUTPUTS: [&str; 4] = ["centre", "axes", "radiance", "confidence"];
const WINDOW_OUTPUTS: [&str; 7] =
    ["centre", "half_x", "half_y", "directions", "bandwidths", "radiance", "confidence"];

fn guess(shape: Shape, radiance: Vec<glam::Vec3>, gain: f32, confidence: &Tensor) -> Guess {
    let radiance = Radiance(radiance.into_iter().map(|w| w / gain).collect());
    Guess { shape, radiance, burns: confidence.data()[0], error: confidence.data()[1] }
}

/// The estimate of a light without a pixel at the size of networks.
fn nothing() -> Guess {
    Guess { shape: Shape::Absent, radiance: Radiance(vec![]), burns: 0.0, error: 0.0 }
}
