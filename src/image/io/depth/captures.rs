//! Frames of phone captures with a depth camera, as the applications document their exports.

use super::{DepthFile, Intrinsics, Measure, png};
use crate::image::Plane;
use crate::image::io::source::{NamedBytes, ReadError};

/// Meters per unit of the depth of both applications, millimeters.
const MILLIMETERS: f32 = 1e-3;
/// Columns and rows of the video of Stray Scanner, to which its camera matrix belongs.
const STRAY_VIDEO: [f32; 2] = [1920.0, 1440.0];

/// Reads a frame of Stray Scanner: `depth/000000.png` (16 bits, millimeters), of the same name in
/// `confidence/` the confidence (0, 1 or 2), and `camera_matrix.csv`, three rows of three numbers
/// for the video of 1920 x 1440 pixels.
///
/// # Errors
/// A file is damaged or of another form.
pub fn stray_scanner(
    depth: NamedBytes,
    confidence: Option<NamedBytes>,
    matrix: Option<NamedBytes>,
) -> Result<DepthFile, ReadError> {
    let mut file = frame(depth, confidence, 2.0)?;
    if let Some(source) = matrix {
        let text = String::from_utf8_lossy(&source.bytes[..source.bytes.len().min(4096)]);
        let cells = text.split([',', '\n']).map(str::trim).filter(|cell| !cell.is_empty());
        let numbers: Vec<f32> = cells.take(9).map_while(|cell| cell.parse().ok()).collect();
        let &[fx, _, cx, _, fy, cy, ..] = &numbers[..] else {
            let got = format!("{} numbers", numbers.len());
            return Err(source.error("camera matrix", "three rows of three numbers", got));
        };
        let [width, height] = STRAY_VIDEO;
        file.camera = Some(checked(source, Intrinsics { width, height, fx, fy, cx, cy })?);
    }
    Ok(file)
}

/// Reads a frame of a raw export of Polycam: `keyframes/depth/NAME.png` (16 bits, millimeters), of
/// the same name in `keyframes/confidence/` the confidence (0 to 255), and in `keyframes/cameras/`
/// the camera (`fx`, `fy`, `cx`, `cy`, `width`, `height` in JSON).
///
/// # Errors
/// A file is damaged or of another form.
pub fn polycam(
    depth: NamedBytes,
    confidence: Option<NamedBytes>,
    camera: Option<NamedBytes>,
) -> Result<DepthFile, ReadError> {
    let mut file = frame(depth, confidence, 255.0)?;
    if let Some(source) = camera {
        let wanted = "JSON with fx, fy, cx, cy, width and height";
        let stated: Intrinsics =
            serde_json::from_slice(source.bytes).map_err(|e| source.error("camera", wanted, e))?;
        file.camera = Some(checked(source, stated)?);
    }
    Ok(file)
}

/// Depth in millimeters and its confidence as a fraction of `sure`.
fn frame(
    depth: NamedBytes,
    confidence: Option<NamedBytes>,
    sure: f32,
) -> Result<DepthFile, ReadError> {
    let mut file = png::read(depth)?;
    (file.measure, file.scale) = (Some(Measure::PlanarZ), Some(MILLIMETERS));
    if let Some(source) = confidence {
        let stated: Plane<f32> = png::read(source)?.values;
        if stated.size() != file.values.size() {
            let text = |(width, height): (usize, usize)| format!("{width} x {height}");
            let wanted = format!("that of the depth, {}", text(file.values.size()));
            return Err(source.error("size of the confidence", wanted, text(stated.size())));
        }
        file.confidence = Some(stated.map(|c| (c / sure).min(1.0)));
    }
    Ok(file)
}

/// The camera, if its numbers can be those of one.
fn checked(source: NamedBytes, camera: Intrinsics) -> Result<Intrinsics, ReadError> {
    let Intrinsics { width, height, fx, fy, cx, cy } = camera;
    let sound = [width, height, fx, fy].iter().all(|n| (1.0..=1e6).contains(n));
    let sound = sound && [cx, cy].iter().all(|n| (-1e6..=1e6).contains(n));
    let got = || format!("{width} x {height}, fx {fx}, fy {fy}, cx {cx}, cy {cy}");
    if sound {
        Ok(camera)
    } else {
        Err(source.error("camera", "sizes of 1 to 1000000 pixels", got()))
    }
}
