//! Depth in the gray levels of a PNG.

use ::image::ImageFormat;

use super::DepthFile;
use crate::image::Plane;
use crate::image::io::raster::{Raster, Samples, decode_raster};
use crate::image::io::source::{NamedBytes, ReadError};

/// Reads a PNG of 8 or 16 bits as integers. Three equal channels count as gray; alpha is left out.
///
/// # Errors
/// The content is not a valid PNG, its channels differ (a color map), or it exceeds the limits of
/// `source`.
pub(in crate::image) fn read(source: NamedBytes) -> Result<DepthFile, ReadError> {
    let raster = decode_raster(source, ImageFormat::Png)?;
    let values = gray(&raster).ok_or_else(|| {
        source.error(
            "pixels of a depth PNG",
            "gray levels",
            "colors: a picture of depth, not depth",
        )
    })?;
    let mut file = DepthFile::plain(values);
    if matches!(raster.samples, Samples::Eight(_)) {
        file.notes.push("its depth has 8 bits, 256 steps: surfaces become stairs".into());
    }
    Ok(file)
}

/// Samples of a picture whose color channels are equal, as integers.
pub(in crate::image) fn gray(raster: &Raster) -> Option<Plane<f32>> {
    fn levels<S: Copy + PartialEq + Into<f32>>(values: &[S], channels: usize) -> Option<Vec<f32>> {
        let is_gray = |p: &[S]| channels < 3 || (p[0] == p[1] && p[0] == p[2]);
        values.chunks_exact(channels).map(|p| is_gray(p).then(|| p[0].into())).collect()
    }
    let values = match &raster.samples {
        Samples::Eight(values) => levels(values, raster.channels),
        Samples::Sixteen(values) => levels(values, raster.channels),
        Samples::Float(_) => None,
    };
    Some(Plane::new(raster.width, raster.height, values?))
}
