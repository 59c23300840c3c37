//! PNG files out.

use std::borrow::Cow;

use png::{BitDepth, ColorType, Compression, Encoder, Filter, Info, ScaledFloat};
use png::{SourceChromaticities, SrgbRenderingIntent};
use rayon::prelude::*;

use crate::image::{Picture, Transfer};

/// A picture as PNG, in 8 or 16 bits, through `transfer`; light outside 0..1 of the encoded range
/// is clipped. Every pixel must be finite. The file states `Srgb` (sRGB chunk) and `Gamma` (gAMA
/// and cHRM chunks); of numbers that are `Linear`, such as masks, it states nothing.
pub fn write_png(picture: &Picture, transfer: Transfer, sixteen_bit: bool) -> Vec<u8> {
    PngSamples::new(picture, transfer, sixteen_bit).into_file(&[])
}

/// A picture as the numbers that its PNG stores: a quarter or half of its memory.
pub struct PngSamples {
    width: usize,
    height: usize,
    /// Interleaved; of 16 bits with the upper byte first.
    bytes: Vec<u8>,
    transfer: Transfer,
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
                    let pairs = color.map(|v| (v as u16).to_be_bytes());
                    bytes.copy_from_slice(pairs.as_flattened());
                } else {
                    bytes.copy_from_slice(&color.map(|v| v as u8));
                }
            }
        });
        PngSamples { width, height, bytes, transfer, sixteen_bit }
    }

    /// The bytes of the PNG file, with the EXIF block `exif` unless it is empty.
    #[expect(clippy::missing_panics_doc, reason = "the buffer has the size of the picture")]
    pub fn into_file(self, exif: &[u8]) -> Vec<u8> {
        let mut info = Info::with_size(self.width as u32, self.height as u32);
        (info.color_type, info.bit_depth) =
            (ColorType::Rgb, if self.sixteen_bit { BitDepth::Sixteen } else { BitDepth::Eight });
        match self.transfer {
            Transfer::Srgb => info.srgb = Some(SrgbRenderingIntent::Perceptual),
            Transfer::Gamma(gamma) => {
                info.source_gamma = Some(ScaledFloat::new(1.0 / gamma));
                // White and primaries of Rec. 709.
                let [white, red] = [(0.3127, 0.329), (0.64, 0.33)];
                let [green, blue] = [(0.3, 0.6), (0.15, 0.06)];
                info.source_chromaticities =
                    Some(SourceChromaticities::new(white, red, green, blue));
            }
            Transfer::Linear => {}
        }
        info.exif_metadata = (!exif.is_empty()).then_some(Cow::Borrowed(exif));
        let mut file = Vec::new();
        let mut encoder = Encoder::with_info(&mut file, info).expect("it is not animated");
        encoder.set_compression(Compression::Fast);
        encoder.set_filter(Filter::Adaptive);
        encoder
            .write_header()
            .and_then(|mut writer| writer.write_image_data(&self.bytes))
            .expect("the buffer has the size of the picture, and writing to memory does not fail");
        file
    }
}
