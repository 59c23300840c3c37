//! Depth in TIFF: one sample a pixel of any number type.

use std::io::Cursor;

use ::tiff::decoder::{Decoder, DecodingResult, Limits};
use ::tiff::{ColorType, TiffError};

use crate::image::Plane;
use crate::image::io::source::{NamedBytes, ReadError};

/// Reads the first picture of a TIFF.
///
/// # Errors
/// The content is not a valid TIFF, has several samples a pixel, or exceeds the limits of `source`.
pub(in crate::image) fn read(source: NamedBytes) -> Result<Plane<f32>, ReadError> {
    let bad = |e: TiffError| source.error("content", "a valid TIFF file", e);
    let mut limits = Limits::default();
    let most = usize::try_from(source.most).unwrap_or(usize::MAX);
    (limits.decoding_buffer_size, limits.intermediate_buffer_size) = (most, most);
    let mut decoder = Decoder::new(Cursor::new(source.bytes)).map_err(bad)?.with_limits(limits);
    let (width, height) = decoder.dimensions().map_err(bad)?;
    let bits = match decoder.colortype().map_err(bad)? {
        ColorType::Gray(bits @ (8 | 16 | 32 | 64)) => bits,
        other => {
            let wanted = "one gray sample of 8, 16, 32 or 64 bits";
            return Err(source.error("pixels of a depth TIFF", wanted, format!("{other:?}")));
        }
    };
    // The decoded numbers and their copy as f32.
    source.check_size(width.into(), height.into(), 4 + u64::from(bits) / 8)?;
    let values: Vec<f32> = match decoder.read_image().map_err(bad)? {
        DecodingResult::F32(values) => values,
        DecodingResult::F16(values) => values.into_iter().map(f32::from).collect(),
        DecodingResult::F64(values) => values.into_iter().map(|v| v as f32).collect(),
        DecodingResult::U8(values) => values.into_iter().map(f32::from).collect(),
        DecodingResult::U16(values) => values.into_iter().map(f32::from).collect(),
        DecodingResult::U32(values) => values.into_iter().map(|v| v as f32).collect(),
        DecodingResult::U64(values) => values.into_iter().map(|v| v as f32).collect(),
        DecodingResult::I8(values) => values.into_iter().map(f32::from).collect(),
        DecodingResult::I16(values) => values.into_iter().map(f32::from).collect(),
        DecodingResult::I32(values) => values.into_iter().map(|v| v as f32).collect(),
        DecodingResult::I64(values) => values.into_iter().map(|v| v as f32).collect(),
    };
    let (width, height) = (width as usize, height as usize);
    if values.len() != width * height {
        let wanted = format!("{width} x {height} samples");
        return Err(source.error("TIFF data", wanted, values.len()));
    }
    Ok(Plane::new(width, height, values))
}
