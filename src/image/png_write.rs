//! PNG files out.

use std::io::Cursor;

use ::image::codecs::png::{CompressionType, FilterType, PngEncoder};
use ::image::{ExtendedColorType, ImageEncoder};
use rayon::prelude::*;

use super::{Picture, Transfer};

/// A picture as PNG, in 8 or 16 bits, through `transfer`; light outside 0..1 of the encoded range is clipped.
/// Every pixel must be finite.
pub fn write_png(picture: &Picture, transfer: Transfer, sixteen_bit: bool) -> Vec<u8> {
    let plane = &picture.0;
    let top = if sixteen_bit { 65535.0 } else { 255.0 };
    let stored = |linear: f32| (transfer.encode(linear).clamp(0.0, 1.0) * top).round();
    let pixels = plane.pixels().par_iter();
    let (bytes, colour): (Vec<u8>, _) = if sixteen_bit {
        let wide = pixels.flat_map_iter(|c| c.to_array()).map(|v| stored(v) as u16);
        // The encoder takes native-endian 16-bit samples.
        (bytemuck::cast_slice(&wide.collect::<Vec<u16>>()).to_vec(), ExtendedColorType::Rgb16)
    } else {
        (pixels.flat_map_iter(|c| c.to_array()).map(|v| stored(v) as u8).collect(), ExtendedColorType::Rgb8)
    };
    let mut file = Cursor::new(Vec::new());
    PngEncoder::new_with_quality(&mut file, CompressionType::Fast, FilterType::Adaptive)
        .write_image(&bytes, plane.width() as u32, plane.height() as u32, colour)
        .expect("the buffer has the size of the picture, and writing to memory does not fail");
    file.into_inner()
}
