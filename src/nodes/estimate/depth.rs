//! `Depth`: depth from a third-party network, in meters by known lengths.

use std::ops::Bound;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::geometry::{Camera, KnownLength, metric_depth, relative_depth};
use crate::graph::{Context, File, Node, NodeError};
use crate::image::{self, Picture, Transfer, fit, inpaint_depth, resize};
use crate::net::Backend;
use crate::net::third_party::{self, Normalization, PhotoInput};
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
    /// Estimates depth from the photo by any ONNX network for monocular depth, such as DPT or Depth
    /// Anything.
    ///
    /// The network takes one photo [1, 3, height, width] and returns one picture, [1, height,
    /// width] or [1, 1, height, width]. docs/networks.md lists the settings of published networks.
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
    const VERSION: u32 = 1;
    type In = DepthIn;
    type Out = DepthOut;

    fn check_consistency(&self) -> Result<(), String> {
        if self.model.path.is_empty() {
            return Err(
                "model: wanted the file of a network, got none; none for depth ships with relight"
                    .into(),
            );
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
        let output = third_party::output(&network, self.output.as_deref()).map_err(refused)?;
        let (input, seen) = self.photo_input().tensor(&network, &photo).map_err(refused)?;
        let [.., height, width] = *seen.shape() else {
            unreachable!("a photo has rows and columns")
        };
        ctx.check_cancelled()?;
        let [message] = network.run(vec![(input, seen)], [output]).map_err(refused)?;
        third_party::check_channels(output, &message, 1).map_err(refused)?;
        // The network may have seen the photo in another aspect.
        let message = message.gray(0);
        let (columns, rows) = photo.0.size();
        let (columns, rows) = fit(columns, rows, message.width().max(message.height()));
        let message = resize(&message, columns, rows);

        let meters = match self.kind {
            DepthOutput::Relative => {
                relative_depth(&message, &camera, &self.known_lengths, self.span)
            }
            DepthOutput::Metric => metric_depth(&message, &camera, &self.known_lengths),
        };
        let meters = meters.map_err(NodeError::BadParameter)?;
        let span = meters.span.map(|span| format!(", span {span:.2}")).unwrap_or_default();
        ctx.note(format!("seen at {width} x {height}, scale {:.4}{span}", meters.scale));
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
        /// Greatest relative error of a known length without a warning.
        max_misfit: f32 = 0.05, unit "fraction", source Taste, effect "a larger value warns less often; no depth changes";
        /// Greatest fraction of pixels without a positive depth without a warning.
        max_holes: f32 = 0.1, unit "fraction", source Taste, effect "a larger value warns less often; no depth changes";
    }
}

impl Depth {
    fn photo_input(&self) -> PhotoInput<'_> {
        let &Depth { ref input, side, multiple, normalization, .. } = self;
        PhotoInput {
            name: input.as_deref(),
            side,
            multiple,
            transfer: Transfer::Srgb,
            normalization,
        }
    }
}
