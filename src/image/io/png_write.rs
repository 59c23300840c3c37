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

/// The stored number of a linear value, of which `top` is the largest.
fn stored(transfer: Transfer, linear: f32, top: f32) -> f32 {
    (transfer.encode(linear).clamp(0.0, 1.0) * top).round()
}

/// Numbers of 8 bits by the least linear value of each, so that no pixel needs a power.
struct ByteSteps {
    least: [f32; 256],
    /// The number of the first value whose upper bits are the index.
    first: Vec<u8>,
}

impl ByteSteps {
    /// Lower bits of a value that the first look-up leaves out.
    const LOWER: u32 = 15;

    fn new(transfer: Transfer) -> ByteSteps {
        let one = 1f32.to_bits();
        let mut least = [0.0; 256];
        for (number, least) in least.iter_mut().enumerate().skip(1) {
            // Floats from 0 to 1 are in the order of their bits.
            let (mut below, mut from) = (0, one);
            while from - below > 1 {
                let middle = below + (from - below) / 2;
                match stored(transfer, f32::from_bits(middle), 255.0) < number as f32 {
                    true => below = middle,
                    false => from = middle,
                }
            }
            *least = f32::from_bits(from);
        }
        let mut number = 0;
        let first = (0..=one >> ByteSteps::LOWER).map(|upper| {
            let value = f32::from_bits(upper << ByteSteps::LOWER);
            while number < 255 && value >= least[number + 1] {
                number += 1;
            }
            number as u8
        });
        ByteSteps { first: first.collect(), least }
    }

    fn stored(&self, linear: f32) -> u8 {
        let value = if linear > 0.0 { linear.min(1.0) } else { 0.0 };
        let mut number = self.first[(value.to_bits() >> ByteSteps::LOWER) as usize];
        while number < 255 && value >= self.least[usize::from(number) + 1] {
            number += 1;
        }
        number
    }
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
        let eight = ByteSteps::new(transfer);
        let size = if sixteen_bit { 6 } else { 3 };
        let mut bytes = vec![0; size * picture.0.len()];
        let pixels = bytes
            .par_chunks_mut(size * width.max(1))
            .zip(picture.0.pixels().par_chunks(width.max(1)));
        pixels.for_each(|(bytes, row)| {
            for (bytes, color) in bytes.chunks_exact_mut(size).zip(row) {
                let color = color.to_array();
                if sixteen_bit {
                    let pairs = color.map(|v| (stored(transfer, v, 65535.0) as u16).to_be_bytes());
                    bytes.copy_from_slice(pairs.as_flattened());
                } else {
                    bytes.copy_from_slice(&color.map(|v| eight.stored(v)));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_give_the_number_of_each_value() {
        for transfer in
            [Transfer::Srgb, Transfer::Gamma(2.2), Transfer::Gamma(0.7), Transfer::Linear]
        {
            let steps = ByteSteps::new(transfer);
            let check = |value: f32| {
                let want = stored(transfer, value, 255.0) as u8;
                assert_eq!(steps.stored(value), want, "{transfer:?}: {value}");
            };
            [-3.0, -0.0, 0.0, 1e-30, 1.0, 1.5, 1e30, -1e30].into_iter().for_each(check);
            (0..200_000).for_each(|i| check(i as f32 / 190_000.0));
            // A step has a value just below and one just above.
            for least in &steps.least[1..] {
                [least.next_down(), *least, least.next_up()].into_iter().for_each(check);
            }
        }
    }
}
