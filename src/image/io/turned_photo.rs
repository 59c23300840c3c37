//! A photo turned by the EXIF orientation in its file: the pixels stay as they are stored.

use std::io::Cursor;

use ::image::metadata::Orientation;
use ::image::{ImageDecoder, ImageReader};

use super::exif_block::oriented;
use super::jpeg_segments::{EXIF, segments};
use super::raster::image_format;
use super::source::{FileFormat, NamedBytes, ReadError, format, not_one_of};

/// The PNG signature and its first chunk, which is the header.
const PNG_HEADER: usize = 33;

/// The file of a photo, PNG or JPEG, whose stored pixels are shown turned clockwise by this many
/// quarter turns, whatever its own orientation says. A file that has to be changed keeps of its
/// EXIF block the fields that [`super::carried_exif`] keeps.
///
/// # Errors
/// The file is neither, or its header is damaged.
pub fn turned_photo(source: NamedBytes, quarters: u8) -> Result<Vec<u8>, ReadError> {
    let (orientation, number) = match quarters % 4 {
        0 => (Orientation::NoTransforms, 1),
        1 => (Orientation::Rotate90, 6),
        2 => (Orientation::Rotate180, 3),
        _ => (Orientation::Rotate270, 8),
    };
    let kind = match format(source) {
        Some(kind @ (FileFormat::Png | FileFormat::Jpeg)) => kind,
        _ => return Err(not_one_of(source, "a photo of a capture: PNG or JPEG")),
    };
    let file = ImageReader::with_format(Cursor::new(source.bytes), image_format(kind));
    let mut decoder = file.into_decoder().map_err(|e| source.error("content", "a photo", e))?;
    if decoder.orientation().is_ok_and(|own| own == orientation) {
        return Ok(source.bytes.to_vec());
    }
    let block = oriented(decoder.exif_metadata().ok().flatten().unwrap_or_default(), number);
    Ok(if kind == FileFormat::Png { png(source.bytes, &block) } else { jpeg(source.bytes, &block) })
}

/// A JPEG with this EXIF block in place of its own.
fn jpeg(bytes: &[u8], block: &[u8]) -> Vec<u8> {
    let length = 2 + EXIF.len() + block.len();
    let length =
        u16::try_from(length).expect("the fields that are carried have at most 1 KiB each");
    let mut file = [b"\xff\xd8\xff\xe1", &length.to_be_bytes()[..], EXIF, block].concat();
    let mut rest = 2;
    for (at, marker, payload) in segments(bytes) {
        if marker == 0xe1 && payload.starts_with(EXIF) {
            file.extend(&bytes[rest..at - 4]);
            rest = at + payload.len();
        }
    }
    file.extend(&bytes[rest..]);
    file
}

/// A PNG with this EXIF block in place of its own.
fn png(bytes: &[u8], block: &[u8]) -> Vec<u8> {
    let content = [b"eXIf", block].concat();
    let mut sum = flate2::Crc::new();
    sum.update(&content);
    let mut file = bytes[..PNG_HEADER.min(bytes.len())].to_vec();
    file.extend((block.len() as u32).to_be_bytes());
    file.extend(content);
    file.extend(sum.sum().to_be_bytes());
    let mut at = PNG_HEADER;
    while let Some(&[a, b, c, d, ref name @ ..]) = bytes.get(at..at + 8) {
        let end = (at + 12).saturating_add(u32::from_be_bytes([a, b, c, d]) as usize);
        let end = end.min(bytes.len());
        if name != b"eXIf" {
            file.extend(&bytes[at..end]);
        }
        at = end;
    }
    file
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Transfer, read_photo};
    use ::image::codecs::jpeg::JpegEncoder;
    use ::image::codecs::png::PngEncoder;
    use ::image::{ExtendedColorType, ImageEncoder};

    /// 16 x 8 pixels, bright in the first eight columns and rows.
    fn stored(mut encoder: impl ImageEncoder, exif: Option<Vec<u8>>) {
        if let Some(exif) = exif {
            encoder.set_exif_metadata(exif).expect("the format has EXIF");
        }
        let pixels: Vec<u8> = (0..128).map(|i| if i % 16 < 8 { 240 } else { 10 }).collect();
        encoder.write_image(&pixels, 16, 8, ExtendedColorType::L8).expect("memory takes it");
    }

    #[test]
    fn photos_are_shown_turned_whatever_they_said_before() {
        let (mut plain, mut said, mut png) = (Vec::new(), Vec::new(), Vec::new());
        let own = || Some(oriented(Vec::new(), 3));
        stored(JpegEncoder::new_with_quality(&mut plain, 95), None);
        stored(JpegEncoder::new_with_quality(&mut said, 95), own());
        stored(PngEncoder::new(&mut png), own());
        for file in [plain, said, png] {
            // The bright half is at the left, the top, the right, the bottom.
            for (quarters, bright) in [(0, (2, 4)), (1, (4, 2)), (2, (13, 4)), (3, (4, 13))] {
                let named = |bytes| NamedBytes::new("photo", bytes);
                let turned = turned_photo(named(&file), quarters).expect("it is sound");
                let photo = read_photo(named(&turned), Transfer::Srgb).expect("it is sound");
                let size = if quarters % 2 == 0 { (16, 8) } else { (8, 16) };
                assert_eq!(photo.picture.0.size(), size, "{quarters}");
                let (x, y) = bright;
                assert!(photo.picture.0.get(x, y).x > 0.5, "{quarters}");
                let opposite = photo.picture.0.get(size.0 - 1 - x, size.1 - 1 - y);
                assert!(opposite.x < 0.5, "{quarters}");
                let again = turned_photo(named(&turned), quarters).expect("it is sound");
                assert!(again == turned, "a file that is right stays");
                for end in 0..turned.len() {
                    let _ = turned_photo(named(&turned[..end]), quarters + 1);
                }
            }
        }
    }
}
