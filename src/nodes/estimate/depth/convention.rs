//! The forms in which published depth networks take a photo and return its depth.
//!
//! | convention | photo | returns | source |
//! | --- | --- | --- | --- |
//! | `DepthAnything`, `DepthAnythingMetric` | shorter side 518, sides multiples of 14, ImageNet | a / z + b; meters | `image2tensor` in DepthAnything/Depth-Anything-V2, depth_anything_v2/dpt.py; `DepthAnythingV2` in its metric_depth folder |
//! | `Dpt` | 384, 32, Half | a / z + b | `dpt_transform` in isl-org/MiDaS, hubconf.py |
//! | `Midas` | 384, 32, ImageNet | a / z + b | `default_transform`, the same file |
//! | `Metric3d` | 0..=255, aspect kept, padded with the mean color to 1064 x 616 | `pred_depth`: z times 1000 pixels over the focal length | onnx/metric3d_onnx_export.py and onnx/test.onnx.py in YvanYin/Metric3D |
//! | `Moge` | 0..=1, aspect kept, padded | `points` up to a shift along z, `mask`, `metric_scale` | docs/onnx.md and `recover_focal_shift` in microsoft/MoGe, moge/utils/geometry_torch.py |

use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};

use super::{Depth, DepthOutput};
use crate::geometry::Camera;
use crate::image::Plane;
use crate::net::third_party::{Normalization, PadRect};
use crate::net::{NetError, Network, Tensor};

/// A published form of depth network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Convention {
    /// `Moge` and `Metric3d` by the names of their outputs; all others by the parameters `side`,
    /// `multiple`, `normalization` and `kind`, which by default are those of `DepthAnything`.
    #[default]
    Auto,
    /// Depth Anything V1 and V2: relative depth.
    DepthAnything,
    /// Depth Anything V2, trained for meters.
    DepthAnythingMetric,
    /// DPT (MiDaS 3): relative depth.
    Dpt,
    /// MiDaS 2.1: relative depth.
    Midas,
    /// Metric3D V1 and V2: meters for a camera of 1000 pixels focal length.
    Metric3d,
    /// MoGe-2: points up to a shift, and their scale in meters.
    Moge,
}

/// The quantity that a network returns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quantity {
    /// a / z + b.
    Relative,
    /// z in meters.
    Metric,
    /// z in meters times [`CANONICAL_FOCAL`] over the focal length in pixels.
    Canonical,
    /// Points up to a shift along z, and their scale.
    Points,
}

/// A convention in numbers.
pub(super) struct Form {
    pub name: &'static str,
    pub side: u32,
    pub multiple: u32,
    pub normalization: Normalization,
    /// Whether the photo keeps its aspect ratio in a frame of another one.
    pub padded: bool,
    pub quantity: Quantity,
    /// The name of the output; `None` for the only one.
    pub output: Option<&'static str>,
}

/// The focal length to which Metric3D brings all cameras, pixels: `canonical_space` in the
/// README of YvanYin/Metric3D.
const CANONICAL_FOCAL: u16 = 1000;

impl Convention {
    /// The convention in numbers; `Auto` by the names of the network's outputs, else by the
    /// parameters of `depth`.
    pub(super) fn form(self, network: &Network, depth: &Depth) -> Form {
        let has = |name: &str| network.outputs().iter().any(|port| port.name == name);
        let named = match self {
            Convention::Auto if has("points") && has("metric_scale") => Convention::Moge,
            Convention::Auto if has("pred_depth") => Convention::Metric3d,
            named => named,
        };
        let form = |name, side, multiple, normalization, quantity| Form {
            name,
            side,
            multiple,
            normalization,
            padded: matches!(quantity, Quantity::Canonical | Quantity::Points),
            quantity,
            output: (quantity == Quantity::Canonical && has("pred_depth")).then_some("pred_depth"),
        };
        let bytes = Normalization::Custom { mean: [0.0; 3], deviation: [1.0 / 255.0; 3] };
        let image_net = Normalization::ImageNet;
        match named {
            Convention::Auto => {
                let quantity = match depth.kind {
                    DepthOutput::Relative => Quantity::Relative,
                    DepthOutput::Metric => Quantity::Metric,
                };
                form("by its parameters", depth.side, depth.multiple, depth.normalization, quantity)
            }
            Convention::DepthAnything => {
                form("Depth Anything", 518, 14, image_net, Quantity::Relative)
            }
            Convention::DepthAnythingMetric => {
                form("Depth Anything, metric", 518, 14, image_net, Quantity::Metric)
            }
            Convention::Dpt => form("DPT", 384, 32, Normalization::Half, Quantity::Relative),
            Convention::Midas => form("MiDaS", 384, 32, image_net, Quantity::Relative),
            Convention::Metric3d => form("Metric3D", 616, 28, bytes, Quantity::Canonical),
            Convention::Moge => form("MoGe", 518, 14, Normalization::None, Quantity::Points),
        }
    }
}

/// Planar z in meters from Metric3D's numbers: `photo` is the camera of the photo as the network
/// sees it.
pub(super) fn from_canonical(network: &Plane<f32>, photo: &Camera) -> Plane<f32> {
    let factor = photo.fx / f32::from(CANONICAL_FOCAL);
    network.map(|z| z * factor)
}

/// Planar z in meters from MoGe's `points` [.., height, width, 3] (x right, y down, z forward),
/// `mask` and `metric_scale`; 0 where the mask says that there is no depth. `rect` is the photo in
/// them, `photo` its camera at the size of `rect`.
///
/// The points are exact up to a shift s along z. With (a, b) the tangents of a pixel's ray, a
/// point (x, y, z) is seen there if (x, y) = (z + s) (a, b): s is the least-squares solution of the
/// errors in the picture, (x, y) / (z + s) - (a, b), by three steps of reweighting from the
/// solution without the division.
///
/// # Errors
/// `Mismatch`: shapes that do not fit each other.
pub(super) fn from_points(
    [points, mask, scale]: &[Tensor; 3],
    rect: PadRect,
    photo: &Camera,
) -> Result<Plane<f32>, NetError> {
    let wrong = |name: &str, wanted: String, got: &Tensor| {
        NetError::Mismatch(format!("output `{name}`: wanted {wanted}, got {:?}", got.shape()))
    };
    let [width, height] = rect.frame;
    let size = width * height;
    if points.shape().last() != Some(&3) || points.data().len() != 3 * size {
        return Err(wrong("points", format!("[1, {height}, {width}, 3]"), points));
    }
    if mask.data().len() != size {
        return Err(wrong("mask", format!("[1, {height}, {width}]"), mask));
    }
    let &[scale] = scale.data() else {
        return Err(wrong("metric_scale", "one number".into(), scale));
    };
    let cells: Vec<Option<(Vec3, Vec2)>> = rect
        .cells()
        .map(|(cell, x, y)| {
            let ray = photo.pixel_point(x, y, 1.0);
            let point = Vec3::from_slice(&points.data()[3 * cell..]);
            (mask.data()[cell] > 0.5).then_some((point, Vec2::new(ray.x, -ray.y)))
        })
        .collect();
    let solved = |weight: &dyn Fn(f32) -> f64| {
        let (mut sum, mut squares) = (0.0, 0.0);
        for (point, tangents) in cells.iter().flatten() {
            let error = point.truncate() - point.z * *tangents;
            sum += weight(point.z) * f64::from(tangents.dot(error));
            squares += weight(point.z) * f64::from(tangents.length_squared());
        }
        (sum / f64::max(squares, f64::MIN_POSITIVE)) as f32
    };
    let mut shift = solved(&|_| 1.0);
    for _ in 0..3 {
        shift = solved(&|z| f64::from((z + shift).max(1e-3)).powi(-2));
    }
    let depth = cells.iter().map(|cell| cell.map_or(0.0, |(point, _)| scale * (point.z + shift)));
    Ok(Plane::new(rect.size[0], rect.size[1], depth.collect()))
}
