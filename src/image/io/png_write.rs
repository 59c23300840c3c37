//! PNG files out.

use std::io::Cursor;

use ::image::codecs::png::{CompressionType, FilterType, PngEncoder};
use ::image::{ExtendedColorType, ImageEncoder};
use rayon::prelude::*;

use crate::image::{Picture, Transfer};

/// A picture as PNG, in 8 or 16 bits, through `transfer`; light outside 0..1 of the encoded range
/// is clipped. Every pixel must be finite.
pub fn write_png(picture: &Picture, transfer: Transfer, sixteen_bit: bool) -> Vec<u8> {
    PngSamples::new(picture, transfer, sixteen_bit).into_file()
}

/// A picture as the numbers that its PNG stores: a quarter or half of its memory.
pub struct PngSamples {
    width: usize,
    height: usize,
    /// Interleaved; of 16 bits in the order of the processor.
    bytes: Vec<u8>,
    sixteen_bit: bool,
}

impl PngSamples {
    /// As [`write_png`] takes them.
    pub fn new(picture: &Picture, transfer: Transfer, sixteen_bit: bool) -> PngSamples {
        let (width, height) = picture.0.size();
        let top = if sixteen_bit { 65535.0 } else { 255.0 };
        let stored = |linear: f32| (transfer.encode(linear).clamp(0.0, 1.0) * top).round();
        let size = if sixteen_bit { 6 } else { 3 };
        let mut bytes = vec![0; size * picture.0.len()];
        let pixels = bytes
            .par_chunks_mut(size * width.max(1))
            .zip(picture.0.pixels().par_chunks(width.max(1)));
        pixels.for_each(|(bytes, row)| {
            for (bytes, color) in bytes.chunks_exact_mut(size).zip(row) {
                let color = color.to_array().map(stored);
                if sixteen_bit {
                    bytes.copy_from_slice(bytemuck::bytes_of(&color.map(|v| v as u16)));
                } else {
                    bytes.copy_from_slice(&color.map(|v| v as u8));
                }
            }
        });
        PngSamples { width, height, bytes, sixteen_bit }
    }

    /// The bytes of the PNG file.
    #[expect(clippy::missing_panics_doc, reason = "the buffer has the size of the picture")]
    pub fn into_file(self) -> Vec<u8> {
        let color =
            if self.sixteen_bit { ExtendedColorType::Rgb16 } else { ExtendedColorType::Rgb8 };
        let mut file = Cursor::new(Vec::new());
        PngEncoder::new_with_quality(&mut file, CompressionType::Fast, FilterType::Adaptive)
            .write_image(&self.bytes, self.width as u32, self.height as u32, color)
            .expect("the buffer has the size of the picture, and writing to memory does not fail");
        file.into_inner()
    }
}
