//! `Depth`: depth from a third-party network, in meters by known lengths.

mod convention;

use std::ops::Bound;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

pub use convention::Convention;
use convention::{Form, Quantity};

use crate::geometry::{
    Camera, KnownHeight, KnownLength, MetricDepth, metric_depth, relative_depth,
    relative_from_height,
};
use crate::graph::{Context, File, Node, NodeError};
use crate::image::{self, Picture, Plane, Transfer, fit, inpaint_depth, resize};
use crate::net::third_party::{self, Normalization, PhotoInput};
use crate::net::{Backend, NetError, Network};
use crate::nodes::neural;
use crate::tuning::tuning;
use crate::{params, ports};

/// The quantity that a depth network returns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum DepthOutput {
    /// a / z + b with unknown a and b, larger is nearer: MiDaS, DPT, Depth Anything V1 and V2.
    #[default]
    Relative,
    /// Planar z in meters, or in another unit that a known length mends: Depth Anything's metric
    /// ones, ZoeDepth.
    Metric,
}

params! {
    /// Estimates depth from the photo by any ONNX network for monocular depth, such as Depth
    /// Anything, DPT, Metric3D or MoGe.
    ///
    /// The network takes one photo [1, 3, height, width] and returns one picture, [1, height,
    /// width] or [1, 1, height, width]; that of MoGe returns points. docs/networks.md lists the
    /// conventions of published networks.
    /// Known lengths in the photo scale relative depth to meters.
    pub struct Depth {
        /// The network, an ONNX file. None ships with the program.
        model: File = File::default(),
        /// Inference backend: `Rten`, or `OnnxRuntime(build)` when its library is loaded. The
        /// command sets it (`--backend`).
        backend: Backend = Backend::Rten,
        /// Name of the network's input; optional, as the network has one input.
        input: Option<String> = None,
        /// Name of the network's output; required if the network has several.
        output: Option<String> = None,
        /// Convention of a published network: Auto, DepthAnything, DepthAnythingMetric, Dpt, Midas,
        /// Metric3d or Moge. Auto recognizes Metric3d and Moge by the names of their outputs, and
        /// reads others by `side`, `multiple`, `normalization` and `kind`, which the other
        /// conventions state.
        convention: Convention = Convention::Auto,
        /// Shorter side of the photo as the network takes it, pixels. A size that the file fixes
        /// takes precedence.
        side: u32 = 518, in 8..=4096,
        /// Divisor of each side, pixels: 14 for Depth Anything, 32 for DPT and MiDaS.
        multiple: u32 = 14, in 1..=256,
        /// Normalization of the sRGB values 0..=1: ImageNet (MiDaS 2, Depth Anything), Half (DPT),
        /// None, or Custom(mean, deviation).
        normalization: Normalization = Normalization::ImageNet,
        /// Meaning of the network's values: Relative (a / z + b) or Metric (z in meters).
        kind: DepthOutput = DepthOutput::Relative,
        /// Known lengths in the photo: [(from: (x, y), to: (x, y), meters: 2.03), ..], in pixels of
        /// the photo. The command sets them (`--known-length`). Relative depth requires one; two at
        /// different depths determine the span too. Metric depth is scaled to them.
        known_lengths: Vec<KnownLength> = vec![],
        /// Height of the camera above the seen floor, meters: scales relative depth that has no
        /// known length.
        camera_height: Option<f32> = None,
        /// Ratio of the farthest to the nearest depth for relative depth with one known length,
        /// without 5 % of the pixels at each end. In twelve rooms it was 1.7 to 4.5; their median
        /// is the default.
        span: f32 = 2.5, in (Bound::Excluded(1.0), Bound::Included(1000.0)),
    }
}

ports! {
    pub input DepthIn {
        /// The linear photo at its own size.
        photo: Arc<Picture>,
        /// Its camera.
        camera: Arc<Camera>,
    }
}

ports! {
    pub output DepthOut {
        /// Planar depth in meters, holes filled. It has the photo's aspect ratio; its longer side
        /// has as many pixels as the network's output, at most the photo's.
        depth: Arc<image::Depth>,
    }
}

impl Node for Depth {
    const KIND: &'static str = "Depth";
    const VERSION: u32 = 2;
    type In = DepthIn;
    type Out = DepthOut;

    fn check_consistency(&self) -> Result<(), String> {
        if self.model.path.is_empty() {
            return Err(
                "model: wanted the file of a network, got none; none for depth ships with relight"
                    .into(),
            );
        }
        let own = Depth::default();
        let is_read = (self.side, self.multiple, self.normalization, self.kind)
            == (own.side, own.multiple, own.normalization, own.kind);
        if self.convention != Convention::Auto && !is_read {
            return Err(format!(
                "convention: {:?} states `side`, `multiple`, `normalization` and `kind`; wanted none of \
                these beside it, or `convention: Auto`",
                self.convention
            ));
        }
        if let Some(height) = self.camera_height
            && !(0.1..=50.0).contains(&height)
        {
            return Err(format!("camera_height: wanted 0.1 to 50 m, got {height}"));
        }
        self.normalization.check()
    }

    fn files(&mut self) -> Vec<&mut File> {
        vec![&mut self.model]
    }

    fn run(&self, inputs: DepthIn, ctx: &Context) -> Result<DepthOut, NodeError> {
        let DepthIn { photo, camera } = inputs;
        let refused = |e| neural::refused(&self.model, &self.backend, e);
        let network = neural::loaded(ctx, &self.model, &self.backend)?;
        let form = self.convention.form(&network, self);
        let seen = self.seen(&form, &network, &photo, &camera, ctx).map_err(refused)?;
        check_variation(&seen.values).map_err(|e| refused(NetError::Mismatch(e)))?;
        // The network may have seen the photo in another aspect.
        let (columns, rows) = photo.0.size();
        let longer = seen.values.width().max(seen.values.height());
        let (columns, rows) = fit(columns, rows, longer);
        let values = resize(&seen.values, columns, rows);

        let meters = match (form.quantity, self.camera_height) {
            (Quantity::Relative, Some(height)) if self.known_lengths.is_empty() => {
                by_height(&values, &camera, height)
            }
            (Quantity::Relative, _) => {
                relative_depth(&values, &camera, &self.known_lengths, self.span)
            }
            _ => metric_depth(&values, &camera, &self.known_lengths),
        };
        let meters = meters.map_err(NodeError::BadParameter)?;
        let span = meters.span.map(|span| format!(", span {span:.2}")).unwrap_or_default();
        let [width, height] = seen.size;
        let quantity = if form.quantity == Quantity::Relative { "relative" } else { "in meters" };
        ctx.note(format!(
            "{}, {quantity}, seen at {width} x {height}, scale {:.4}{span}",
            form.name, meters.scale
        ));
        if meters.misfit > TUNING.max_misfit {
            ctx.warn(format!(
                "the known lengths contradict each other: one is off by {:.0} %",
                100.0 * meters.misfit
            ));
        }
        let (depth, holes) =
            inpaint_depth(&meters.depth, &meters.depth.map(|_| 0.0)).ok_or_else(|| {
                let file = self.model.location().display().to_string();
                NodeError::BadFile {
                    path: file,
                    message: "wanted meters, got no positive number; is its depth Relative?".into(),
                }
            })?;
        let share = holes.0.pixels().iter().sum::<f32>() / holes.0.len() as f32;
        if share > TUNING.max_holes {
            ctx.warn(format!(
                "{:.0} % of the pixels have no positive depth; they are filled from the others",
                100.0 * share
            ));
        }
        Ok(DepthOut { depth: Arc::new(depth) })
    }
}

tuning! {
    /// Constants of `Depth`.
    pub const TUNING: DepthTuning {
        /// Relative variation of a network's output up to which it is rounding.
        min_variation: f32 = 1e-5, unit "1", source Derived("single precision"), effect "a larger value refuses more outputs";
        /// Greatest relative error of a known length without a warning.
        max_misfit: f32 = 0.05, unit "fraction", source Taste, effect "a larger value warns less often; no depth changes";
        /// Greatest fraction of pixels without a positive depth without a warning.
        max_holes: f32 = 0.1, unit "fraction", source Taste, effect "a larger value warns less often; no depth changes";
    }
}

/// The network's numbers, over the photo alone.
struct Seen {
    /// Relative depth, or meters.
    values: Plane<f32>,
    /// Columns and rows of the picture that the network was shown.
    size: [usize; 2],
}

impl Depth {
    /// Runs the network as its convention wants it.
    fn seen(
        &self,
        form: &Form,
        network: &Network,
        photo: &Picture,
        camera: &Camera,
        ctx: &Context,
    ) -> Result<Seen, NetError> {
        let input = PhotoInput {
            name: self.input.as_deref(),
            side: form.side,
            multiple: form.multiple,
            transfer: Transfer::Srgb,
            normalization: form.normalization,
        };
        let cancelled = |_| NetError::Cancelled;
        let name = self.output.as_deref().or(form.output);
        if !form.padded {
            let output = third_party::output(network, name)?;
            let (input, tensor) = input.tensor(network, photo)?;
            let size = frame(tensor.shape());
            ctx.check_cancelled().map_err(cancelled)?;
            let [message] = network.run(vec![(input, tensor)], [output])?;
            third_party::check_channels(output, &message, 1)?;
            return Ok(Seen { values: message.gray(0), size });
        }
        let (input, tensor, rect) = input.padded(network, photo)?;
        let size = frame(tensor.shape());
        let small = camera.resized(rect.size[0], rect.size[1]);
        ctx.check_cancelled().map_err(cancelled)?;
        if form.quantity == Quantity::Points {
            let outputs = ["points", "mask", "metric_scale"];
            for name in outputs {
                third_party::output(network, Some(name))?;
            }
            let tensors = network.run(vec![(input, tensor)], outputs)?;
            return Ok(Seen { values: convention::from_points(&tensors, rect, &small)?, size });
        }
        let output = third_party::output(network, name)?;
        let [message] = network.run(vec![(input, tensor)], [output])?;
        third_party::check_channels(output, &message, 1)?;
        let message = message.gray(0);
        if [message.width(), message.height()] != size {
            return Err(NetError::Mismatch(format!(
                "output `{output}`: wanted the size of the input, {} x {}, got {} x {}",
                size[0],
                size[1],
                message.width(),
                message.height()
            )));
        }
        let photo = rect.cells().map(|(cell, ..)| message.pixels()[cell]).collect();
        let photo = Plane::new(rect.size[0], rect.size[1], photo);
        Ok(Seen { values: convention::from_canonical(&photo, &small), size })
    }
}

/// Columns and rows of a photo's tensor.
fn frame(shape: &[usize]) -> [usize; 2] {
    let [.., height, width] = *shape else { unreachable!("a photo has rows and columns") };
    [width, height]
}

/// A network that failed returns one number everywhere: a wrong normalization, or a conversion
/// that lost its weights.
fn check_variation(values: &Plane<f32>) -> Result<(), String> {
    let (low, high) = values
        .pixels()
        .iter()
        .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &v| (low.min(v), high.max(v)));
    if high - low > TUNING.min_variation * high.abs().max(low.abs()) {
        return Ok(());
    }
    Err(format!(
        "the network returned no depth: wanted numbers that vary, got {high} everywhere; is its \
        `convention` or `normalization` another one?"
    ))
}

/// Meters of relative depth by the height of the camera above the seen floor; 0 beyond the range
/// of the network.
fn by_height(values: &Plane<f32>, camera: &Camera, height: f32) -> Result<MetricDepth, String> {
    let small = camera.resized(values.width(), values.height());
    let known = KnownHeight::Camera(height);
    let found = relative_from_height(values, &small, &values.map(|_| 0.0), known)
        .map_err(|e| format!("camera_height: {e}"))?;
    let depth =
        values.map(|q| if q > -found.shift { found.scale / (q + found.shift) } else { 0.0 });
    Ok(MetricDepth { depth, scale: found.scale, span: None, misfit: 0.0 })
}
