//! Depth in meters from the file that a person gives.

use std::path::Path;

use relight::geometry::{Camera, KnownLength, metric_depth};
use relight::graph::{Diagnostic, MAX_FILE_BYTES, read};
use relight::image::{
    Compression, ExrLayers, NamedBytes, Plane, ReadError, read_depth, same_aspect,
};

/// Depth as a scene reads it, and its origin in words.
pub struct SceneDepth {
    /// The bytes of `depth.exr`: planar z in meters.
    pub exr: Vec<u8>,
    /// The origin of the numbers and of their unit.
    pub origin: String,
    /// Facts that a person should know.
    pub notes: Vec<String>,
}

/// Reads a depth file for a photo with this camera. Whole numbers of 16 bits are millimeters,
/// others meters, unless known lengths scale them.
///
/// # Errors
/// The file has another content than depth, or another aspect ratio than the photo; a known length
/// that cannot be used.
pub fn depth_for(
    path: &Path,
    camera: &Camera,
    lengths: &[KnownLength],
) -> Result<SceneDepth, Diagnostic> {
    let fault = |message: String| Diagnostic::file(path, message);
    let bytes = read(path, MAX_FILE_BYTES).map_err(|e| fault(format!("cannot be read: {e}")))?;
    let name = path.display().to_string();
    let (stored, notes) =
        read_depth(NamedBytes::new(&name, &bytes)).map_err(|e: ReadError| fault(e.message()))?;
    let photo = (camera.width, camera.height);
    if !same_aspect(stored.size(), photo) {
        let ((w, h), (pw, ph)) = (stored.size(), photo);
        let message = format!(
            "size: wanted the aspect ratio of the photo ({pw} x {ph}) to 2 %, got {w} x {h}"
        );
        let help = "cut the depth like the photo; a photo that is turned by its EXIF orientation \
                    needs its depth turned as well";
        return Err(fault(message).help(help));
    }
    let is_whole = stored.pixels().iter().all(|z| z.fract() == 0.0)
        && stored.pixels().iter().any(|z| *z > 100.0);
    let (scale, unit) =
        if is_whole { (1e-3, "millimeters, as whole numbers") } else { (1.0, "meters") };
    let meters = stored.map(|z| scale * z);
    let scaled = metric_depth(&meters, camera, lengths).map_err(fault)?;
    let origin = match lengths {
        [] => format!("{name}, read as {unit} along the camera's axis"),
        _ => format!(
            "{name}, scaled by {:.4} to the known lengths (largest error {:.1} %)",
            scaled.scale * scale,
            100.0 * scaled.misfit
        ),
    };
    Ok(SceneDepth { exr: exr(&scaled.depth).map_err(fault)?, origin, notes })
}

fn exr(depth: &Plane<f32>) -> Result<Vec<u8>, String> {
    let mut layers = ExrLayers::new(depth.width(), depth.height());
    layers.float("Z", depth);
    layers.comment("units: planar z in metres");
    layers.write(Compression::Zip)
}
