//! Depth in meters from the file that a person gives.

use std::path::Path;

use clap::ValueEnum;
use relight::geometry::{
    Camera, KnownHeight, KnownLength, metric_depth, relative_depth, relative_from_height,
    scale_from_height,
};
use relight::graph::{Diagnostic, MAX_FILE_BYTES, read};
use relight::image::{
    CONFIDENCE, Compression, DepthFile, ExrLayers, Measure, NamedBytes, Plane, ReadError,
    inpaint_depth, read_depth_file, same_aspect,
};
use relight::nodes::estimate::depth::Depth;
use relight::nodes::scene::read_scene::{DepthSpec, planar};

/// Depth as a scene reads it, and its origin in words.
pub struct SceneDepth {
    /// The bytes of `depth.exr`: planar z in meters.
    pub exr: Vec<u8>,
    /// The origin of the numbers and of their unit.
    pub origin: String,
    /// Facts that a person should know.
    pub notes: Vec<String>,
}

/// The quantity in a depth file, as a person states it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum GivenKind {
    /// Distance along the camera's axis.
    Planar,
    /// Distance along the pixel's ray.
    Ray,
    /// 1 / distance along the camera's axis.
    Disparity,
    /// 1 / distance with an unknown scale and offset, as networks return it.
    Relative,
}

/// Facts about a depth file that a person states.
pub struct DepthFacts {
    /// The quantity; by default that which the file states, else planar z.
    pub kind: Option<GivenKind>,
    /// Meters per unit; by default that which the file states, else a guess.
    pub scale: Option<f32>,
    /// Lengths in the photo.
    pub lengths: Vec<KnownLength>,
    /// Height of the camera or of the room.
    pub height: Option<KnownHeight>,
}

/// Reads a depth file.
///
/// # Errors
/// The file has another content than depth.
pub fn read_depth(path: &Path) -> Result<DepthFile, Diagnostic> {
    let bytes = read(path, MAX_FILE_BYTES)
        .map_err(|e| Diagnostic::file(path, format!("cannot be read: {e}")))?;
    depth_in(path, &bytes)
}

/// Reads depth from the bytes of the file `path`.
///
/// # Errors
/// The file has another content than depth.
pub fn depth_in(path: &Path, bytes: &[u8]) -> Result<DepthFile, Diagnostic> {
    let name = path.display().to_string();
    read_depth_file(NamedBytes::new(&name, bytes))
        .map_err(|e: ReadError| Diagnostic::file(path, e.message()))
}

/// The depth of the file `path` for a photo with this camera. Whole numbers of 16 bits are
/// millimeters, others meters, unless the file or a person states another scale.
///
/// # Errors
/// The depth has another aspect ratio than the photo; a known length or height that cannot be used.
pub fn depth_for(
    path: &Path,
    file: DepthFile,
    camera: &Camera,
    facts: &DepthFacts,
) -> Result<SceneDepth, Diagnostic> {
    let fault = |message: String| Diagnostic::file(path, message);
    let photo = (camera.width, camera.height);
    if !same_aspect(file.values.size(), photo) {
        let ((w, h), (pw, ph)) = (file.values.size(), photo);
        let message = format!(
            "size: wanted the aspect ratio of the photo ({pw} x {ph}) to 2 %, got {w} x {h}"
        );
        let help = "cut the depth like the photo; a photo that is turned by its EXIF orientation \
                    needs its depth turned as well";
        return Err(fault(message).help(help));
    }
    let (meters, how) = meters(&file, camera, facts).map_err(fault)?;
    let exr = exr(&meters, file.confidence.as_ref()).map_err(fault)?;
    let sure = if file.confidence.is_some() { ", with its confidence" } else { "" };
    Ok(SceneDepth { exr, origin: format!("{}, {how}{sure}", path.display()), notes: file.notes })
}

/// Planar z in meters, and its unit's origin in words.
///
/// # Errors
/// A length or height that cannot be used.
fn meters(
    file: &DepthFile,
    camera: &Camera,
    facts: &DepthFacts,
) -> Result<(Plane<f32>, String), String> {
    let (width, height) = file.values.size();
    let small = camera.resized(width, height);
    let outside = file.values.map(|_| 0.0);
    let known = facts.height.unwrap_or_default();
    let by_height = match known {
        KnownHeight::Camera(m) if facts.height.is_none() => {
            format!("by a camera {m} m above the seen floor, a guess")
        }
        KnownHeight::Camera(m) => format!("by a camera {m} m above the seen floor"),
        KnownHeight::Ceiling(m) => format!("by a room {m} m high"),
    };
    if facts.kind == Some(GivenKind::Relative) {
        if !facts.lengths.is_empty() {
            let scaled =
                relative_depth(&file.values, camera, &facts.lengths, Depth::default().span)?;
            let how =
                format!("relative depth, scaled to the known lengths{}", misfit(scaled.misfit));
            return Ok((scaled.depth, how));
        }
        let scaled = relative_from_height(&file.values, &small, &outside, known)?;
        let spec = spec(Measure::Disparity, scaled.scale, scaled.shift);
        let how = format!("relative depth, scaled {by_height}");
        return Ok((planar(&file.values, &spec, &small), how));
    }
    let kind = match facts.kind {
        Some(GivenKind::Ray) => Measure::RayLength,
        Some(GivenKind::Disparity) => Measure::Disparity,
        Some(_) => Measure::PlanarZ,
        None => file.measure.unwrap_or_default(),
    };
    let is_whole = file.values.pixels().iter().all(|z| z.fract() == 0.0)
        && file.values.pixels().iter().any(|z| *z > 100.0);
    let (scale, unit) = match (facts.scale, file.scale) {
        (Some(scale), _) => (scale, format!("at {scale} m a unit")),
        (None, Some(scale)) => (scale, format!("at {scale} m a unit, as it states")),
        (None, None) if is_whole && kind != Measure::Disparity => {
            (1e-3, "read as millimeters, as its numbers are whole".into())
        }
        (None, None) => (1.0, "read as meters".into()),
    };
    let quantity = match kind {
        Measure::PlanarZ => "distance along the camera's axis",
        Measure::RayLength => "distance along the rays",
        Measure::Disparity => "inverse distance",
    };
    let meters = planar(&file.values, &spec(kind, scale, 0.0), &small);
    if !facts.lengths.is_empty() {
        let scaled = metric_depth(&meters, camera, &facts.lengths)?;
        let factor = scaled.scale * scale;
        let how = format!(
            "{quantity}, scaled by {factor:.4} to the known lengths{}",
            misfit(scaled.misfit)
        );
        return Ok((scaled.depth, how));
    }
    if facts.height.is_some() {
        let (filled, _) =
            inpaint_depth(&meters, &outside).ok_or("wanted readings, got holes only")?;
        let factor = scale_from_height(&filled, &small, &outside, known)?;
        let how = format!("{quantity}, scaled by {:.4} {by_height}", factor * scale);
        return Ok((meters.map(|z| factor * z), how));
    }
    Ok((meters, format!("{quantity}, {unit}")))
}

fn misfit(share: f32) -> String {
    format!(" (largest error {:.1} %)", 100.0 * share)
}

/// The reading of numbers that are in memory.
fn spec(kind: Measure, scale: f32, shift: f32) -> DepthSpec {
    DepthSpec { path: Default::default(), kind, scale, shift }
}

fn exr(depth: &Plane<f32>, confidence: Option<&Plane<f32>>) -> Result<Vec<u8>, String> {
    let mut layers = ExrLayers::new(depth.width(), depth.height());
    layers.float("Z", depth);
    if let Some(confidence) = confidence {
        layers.float(CONFIDENCE, confidence);
    }
    layers.comment("units: planar z in metres");
    layers.write(Compression::Zip)
}
