//! Frames of phone captures with a depth camera, as the applications document their exports:
//! Stray Scanner in `docs/format.md` of github.com/strayrobots/scanner, Polycam in `README.md` of
//! github.com/PolyCam/polyform, Record3D in issues 53, 83 and 121 of
//! github.com/marek-simonik/record3d.
//!
//! Phones store the picture as their sensor lies, whichever way they are held. The pose of the
//! camera states which side is up.

use glam::{Quat, Vec2, Vec3};
use serde::Deserialize;

use super::{DepthFile, Intrinsics, Measure, png, read_depth_file};
use crate::image::Plane;
use crate::image::io::source::{NamedBytes, ReadError};

/// Meters per unit of the depth of both applications, millimeters.
const MILLIMETERS: f32 = 1e-3;
/// Columns and rows of the video of Stray Scanner, to which its camera matrix belongs.
const STRAY_VIDEO: [f32; 2] = [1920.0, 1440.0];

/// Reads a frame of Stray Scanner: `depth/000000.png` (16 bits, millimeters), of the same name in
/// `confidence/` the confidence (0, 1 or 2), `camera_matrix.csv`, three rows of three numbers for
/// the video of 1920 x 1440 pixels, and `odometry.csv`, a line of the camera's pose for each frame.
/// A damaged line of it counts as missing.
///
/// # Errors
/// A file is damaged or of another form.
pub fn stray_scanner(
    depth: NamedBytes,
    confidence: Option<NamedBytes>,
    matrix: Option<NamedBytes>,
    odometry: Option<NamedBytes>,
    number: u32,
) -> Result<DepthFile, ReadError> {
    let mut file = frame(depth, confidence, 2.0)?;
    file.up = odometry.and_then(|source| stray_up(source, number));
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

/// Up in the picture by the line of `odometry.csv` for this frame. The quaternion turns a camera
/// whose y points down into a world whose y points up.
fn stray_up(source: NamedBytes, number: u32) -> Option<Vec2> {
    let text = std::str::from_utf8(source.bytes).ok()?;
    let mut lines = text.lines().map(|line| line.split(',').map(str::trim).collect::<Vec<_>>());
    let names = lines.next()?;
    let column = |name: &str| names.iter().position(|other| *other == name);
    let (frame, columns) = (column("frame")?, ["qx", "qy", "qz", "qw"].map(column));
    let line = lines.find(|line| line.get(frame).and_then(|n| n.parse().ok()) == Some(number))?;
    let parts = columns.map(|at| line.get(at?)?.parse::<f32>().ok());
    let [Some(x), Some(y), Some(z), Some(w)] = parts else { return None };
    let up = Quat::from_xyzw(x, y, z, w).normalize().inverse() * Vec3::Y;
    up.is_finite().then_some(Vec2::new(up.x, -up.y))
}

/// A camera of Polycam: the matrix turns a camera whose y points up into a world whose y does, too.
#[derive(Deserialize)]
struct PolycamCamera {
    #[serde(flatten)]
    intrinsics: Intrinsics,
    t_10: Option<f32>,
    t_11: Option<f32>,
}

/// Reads a frame of a raw export of Polycam: `keyframes/depth/NAME.png` (16 bits, millimeters), of
/// the same name in `keyframes/confidence/` the confidence (0, 127 or 255), and in
/// `keyframes/cameras/` the camera (`fx`, `fy`, `cx`, `cy`, `width`, `height` and the rows `t_00`
/// to `t_23` of its pose, in JSON).
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
        let stated: PolycamCamera =
            serde_json::from_slice(source.bytes).map_err(|e| source.error("camera", wanted, e))?;
        file.camera = Some(checked(source, stated.intrinsics)?);
        file.up = stated.t_10.zip(stated.t_11).map(|(x, y)| Vec2::new(x, y));
    }
    Ok(file)
}

/// `metadata.json` of Record3D: the matrix column by column, and of newer versions the four numbers
/// `fx`, `fy`, `cx`, `cy` of each frame, for pictures of `w` x `h`.
#[derive(Deserialize)]
struct Record3dMetadata {
    w: f32,
    h: f32,
    #[serde(rename = "K")]
    matrix: [f32; 9],
    #[serde(rename = "perFrameIntrinsicCoeffs", default)]
    frames: Vec<[f32; 4]>,
}

/// Reads a frame of Record3D's export "EXR + JPG": `depth/0.exr` (meters) and `metadata.json`. Its
/// poses start from the first frame, so they do not state which side is up.
///
/// # Errors
/// A file is damaged or of another form.
pub fn record3d(
    depth: NamedBytes,
    metadata: Option<NamedBytes>,
    number: u32,
) -> Result<DepthFile, ReadError> {
    let mut file = read_depth_file(depth)?;
    (file.measure, file.scale) = (Some(Measure::PlanarZ), Some(1.0));
    if let Some(source) = metadata {
        let wanted = "JSON with w, h and K";
        let stated: Record3dMetadata =
            serde_json::from_slice(source.bytes).map_err(|e| source.error("camera", wanted, e))?;
        let [fx, _, _, _, fy, _, cx, cy, _] = stated.matrix;
        let own = stated.frames.get(number as usize);
        let [fx, fy, cx, cy] = own.copied().unwrap_or([fx, fy, cx, cy]);
        let (width, height) = (stated.w, stated.h);
        file.camera = Some(checked(source, Intrinsics { width, height, fx, fy, cx, cy })?);
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
