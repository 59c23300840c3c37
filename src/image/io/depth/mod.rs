//! Depth files: one format a file. Each returns the numbers as they are stored, with the facts that
//! its format states about them.

mod captures;
mod dynamic_depth;
pub(in crate::image) mod gdepth;
mod npz;
mod pfm;
mod png;
mod tiff;

pub use captures::{polycam, record3d, stray_scanner};

use glam::Vec2;
use serde::{Deserialize, Serialize};

use super::source::{FileFormat, NamedBytes, ReadError, format, not_one_of};
use super::{exr_read, npy};
use crate::image::Plane;

/// The quantity that a depth file measures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Measure {
    /// Distance from the camera's plane.
    #[default]
    PlanarZ,
    /// Distance from the camera along the pixel's ray.
    RayLength,
    /// 1 / distance from the camera's plane.
    Disparity,
}

/// A pinhole camera as a depth file states it, pixels of a picture of `width` x `height`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct Intrinsics {
    /// Columns of the picture to which the other numbers belong.
    pub width: f32,
    /// Its rows.
    pub height: f32,
    /// Horizontal focal length, pixels.
    pub fx: f32,
    /// Vertical focal length, pixels.
    pub fy: f32,
    /// Column coordinate of the principal point, pixels.
    pub cx: f32,
    /// Row coordinate of the principal point, pixels.
    pub cy: f32,
}

impl Intrinsics {
    /// The camera of the picture turned clockwise by a quarter turn.
    fn turned(self) -> Intrinsics {
        let Intrinsics { width, height, fx, fy, cx, cy } = self;
        Intrinsics { width: height, height: width, fx: fy, fy: fx, cx: height - cy, cy: cx }
    }
}

/// Depth as a file stores it, and the facts that the file states. Scene files state the others.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthFile {
    /// Stored numbers; 0, negative and non-finite ones are passed on.
    pub values: Plane<f32>,
    /// Confidence of each number from 0 to 1, the size of `values`.
    pub confidence: Option<Plane<f32>>,
    /// The quantity that the numbers measure, if the file states it.
    pub measure: Option<Measure>,
    /// Meters per stored unit (for `Disparity`, of 1 / unit), if the file states it.
    pub scale: Option<f32>,
    /// The camera, if the file states it.
    pub camera: Option<Intrinsics>,
    /// Up in the picture as it is stored, x right and y up, if the file states it; short where the
    /// camera looks up or down.
    pub up: Option<Vec2>,
    /// Facts about the file for the person: damage that was passed over, precision.
    pub notes: Vec<String>,
}

impl DepthFile {
    /// Numbers of which the file states nothing.
    pub(in crate::image) fn plain(values: Plane<f32>) -> DepthFile {
        DepthFile {
            values,
            confidence: None,
            measure: None,
            scale: None,
            camera: None,
            up: None,
            notes: Vec::new(),
        }
    }

    /// Clockwise quarter turns, 0 to 3, that bring the picture upright; 0 where up is not stated or
    /// the camera looks too far up or down.
    pub fn quarters(&self) -> u8 {
        match self.up.filter(|up| up.length() > LEAST_UP) {
            Some(up) if up.x < -up.y.abs() => 1,
            Some(up) if up.y < -up.x.abs() => 2,
            Some(up) if up.x > up.y.abs() => 3,
            _ => 0,
        }
    }

    /// Depth, confidence and camera turned clockwise by a number of quarter turns.
    pub fn turned(mut self, quarters: u8) -> DepthFile {
        for _ in 0..quarters % 4 {
            self.values = turned(&self.values);
            self.confidence = self.confidence.as_ref().map(turned);
            self.camera = self.camera.map(Intrinsics::turned);
            self.up = self.up.map(|up| Vec2::new(up.y, -up.x));
        }
        self
    }
}

/// A plane turned clockwise by a quarter turn.
fn turned(plane: &Plane<f32>) -> Plane<f32> {
    let (width, height) = plane.size();
    Plane::from_fn(height, width, |x, y| plane.get(y, height - 1 - x))
}

/// Least part of up that lies in the picture, of which a turn is believed: a camera that looks 70
/// degrees up or down.
const LEAST_UP: f32 = 0.34;

/// The channel of an EXR file, and an array of an NPZ file, with the confidence of its depth.
pub const CONFIDENCE: &str = "confidence";

/// A stored confidence from 0 to 1.
fn share(stored: f32) -> f32 {
    if stored.is_finite() { stored.clamp(0.0, 1.0) } else { 0.0 }
}

/// Reads depth as stored: EXR (channel Z, else Y, else R, and `confidence`), PNG of 8 or 16 bits
/// (gray), NPY or NPZ of any number type and order, with axes of length 1 beside height and width,
/// PFM (gray), TIFF (gray, any number type), JPEG with depth beside its photo (GDepth or Dynamic
/// Depth). The first bytes determine the format, never the name.
///
/// # Errors
/// The file is not one of these, is damaged or too large, or holds something else than one plane.
pub fn read_depth_file(source: NamedBytes) -> Result<DepthFile, ReadError> {
    match format(source) {
        Some(FileFormat::Exr) => {
            let file = exr_read::read(source)?;
            let values = file.depth(source)?;
            let confidence = file.number(CONFIDENCE).filter(|c| c.size() == values.size());
            let confidence = confidence.map(|plane| plane.map(share));
            Ok(DepthFile { notes: file.warnings, confidence, ..DepthFile::plain(values) })
        }
        Some(FileFormat::Npy) => {
            let (data, available) = (source.bytes, source.bytes.len() as u64);
            Ok(DepthFile::plain(npy::read(source, data, available)?))
        }
        Some(FileFormat::Npz) => npz::read(source),
        Some(FileFormat::Pfm) => Ok(DepthFile::plain(pfm::read(source)?)),
        Some(FileFormat::Png) => png::read(source),
        Some(FileFormat::Jpeg) => gdepth::read(source),
        Some(FileFormat::Tiff) => Ok(DepthFile::plain(tiff::read(source)?)),
        _ => Err(not_one_of(source, "depth: EXR, PNG, NPY, NPZ, PFM, TIFF or JPEG")),
    }
}

/// Reads the numbers of a depth file, and the notes about them; see [`read_depth_file`].
///
/// # Errors
/// The errors of [`read_depth_file`].
pub fn read_depth(source: NamedBytes) -> Result<(Plane<f32>, Vec<String>), ReadError> {
    let file = read_depth_file(source)?;
    Ok((file.values, file.notes))
}
