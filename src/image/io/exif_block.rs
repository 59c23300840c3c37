//! The EXIF block of a photo, and the part of it that pictures made of the photo carry.
//!
//! EXIF is that of the Exchangeable image file format, CIPA DC-008-2023; tags are named as there.

use std::io::Cursor;

use exif::experimental::Writer;
use exif::{Exif, Field, In, Tag, Value};

/// The largest EXIF block that is parsed, bytes: one segment of a JPEG holds at most 64 KiB.
const MAX_BLOCK: usize = 1 << 20;
/// Most bytes of a text that is carried on.
const MAX_TEXT: usize = 1024;
/// Most numbers of a field that is carried on; `LensSpecification` has four.
const MAX_NUMBERS: usize = 8;

/// The fields that are carried on: camera, lens, exposure, time and author. The place (GPS), serial
/// numbers, names of owners, maker notes, comments of programs and the thumbnail, which shows the
/// photo as it was, are left out; so are fields about the storage of the photo's own samples.
const CARRIED: [Tag; 43] = [
    Tag::Make,
    Tag::Model,
    Tag::LensMake,
    Tag::LensModel,
    Tag::LensSpecification,
    Tag::ImageDescription,
    Tag::Artist,
    Tag::Copyright,
    Tag::DateTime,
    Tag::DateTimeOriginal,
    Tag::DateTimeDigitized,
    Tag::OffsetTime,
    Tag::OffsetTimeOriginal,
    Tag::OffsetTimeDigitized,
    Tag::SubSecTime,
    Tag::SubSecTimeOriginal,
    Tag::SubSecTimeDigitized,
    Tag::ExposureTime,
    Tag::FNumber,
    Tag::ExposureProgram,
    Tag::PhotographicSensitivity,
    Tag::SensitivityType,
    Tag::ShutterSpeedValue,
    Tag::ApertureValue,
    Tag::BrightnessValue,
    Tag::ExposureBiasValue,
    Tag::MaxApertureValue,
    Tag::MeteringMode,
    Tag::LightSource,
    Tag::Flash,
    Tag::FocalLength,
    Tag::FocalLengthIn35mmFilm,
    Tag::FocalPlaneXResolution,
    Tag::FocalPlaneYResolution,
    Tag::FocalPlaneResolutionUnit,
    Tag::PixelXDimension,
    Tag::PixelYDimension,
    Tag::ExposureMode,
    Tag::WhiteBalance,
    Tag::DigitalZoomRatio,
    Tag::SceneCaptureType,
    Tag::SubjectDistance,
    Tag::ExifVersion,
];

/// Parses an EXIF block; `None` where it is damaged or too large.
pub(in crate::image) fn parse(block: Vec<u8>) -> Option<Exif> {
    (block.len() <= MAX_BLOCK).then(|| exif::Reader::new().read_raw(block).ok()).flatten()
}

/// The EXIF block of pictures that are made of a photo with the block `exif` and shown upright:
/// camera, lens, exposure, time and author, without place, serial numbers, maker notes and
/// thumbnail. `is_turned` exchanges the fields of columns and rows. Empty where the block is
/// damaged or has none of these fields.
pub fn carried_exif(exif: Vec<u8>, is_turned: bool) -> Vec<u8> {
    let fields = carried(exif, is_turned);
    if fields.is_empty() { Vec::new() } else { block(fields, 1) }
}

/// The block of a photo that is shown by this orientation: of the block `exif` the fields that
/// pictures carry on.
pub(in crate::image) fn oriented(exif: Vec<u8>, orientation: u16) -> Vec<u8> {
    block(carried(exif, false), orientation)
}

/// The fields of a block that pictures carry on.
fn carried(exif: Vec<u8>, is_turned: bool) -> Vec<Field> {
    let Some(exif) = parse(exif) else { return Vec::new() };
    let fields = CARRIED.iter().filter_map(|&tag| {
        let field = exif.get_field(tag, In::PRIMARY).filter(|field| is_small(&field.value))?;
        let tag = if is_turned { exchanged(tag) } else { tag };
        Some(Field { tag, ifd_num: In::PRIMARY, value: field.value.clone() })
    });
    fields.collect()
}

fn block(mut fields: Vec<Field>, orientation: u16) -> Vec<u8> {
    let value = Value::Short(vec![orientation]);
    fields.push(Field { tag: Tag::Orientation, ifd_num: In::PRIMARY, value });
    let (mut writer, mut block) = (Writer::new(), Cursor::new(Vec::new()));
    fields.iter().for_each(|field| writer.push_field(field));
    match writer.write(&mut block, false) {
        Ok(()) => block.into_inner(),
        Err(_) => Vec::new(),
    }
}

fn is_small(value: &Value) -> bool {
    match value {
        Value::Ascii(lines) => lines.iter().map(|line| line.len() + 1).sum::<usize>() <= MAX_TEXT,
        Value::Short(numbers) => (1..=MAX_NUMBERS).contains(&numbers.len()),
        Value::Long(numbers) => (1..=MAX_NUMBERS).contains(&numbers.len()),
        Value::Rational(numbers) => (1..=MAX_NUMBERS).contains(&numbers.len()),
        Value::SRational(numbers) => (1..=MAX_NUMBERS).contains(&numbers.len()),
        Value::Byte(bytes) | Value::Undefined(bytes, _) => (1..=MAX_NUMBERS).contains(&bytes.len()),
        _ => false,
    }
}

/// The tag of the other axis.
fn exchanged(tag: Tag) -> Tag {
    match tag {
        Tag::PixelXDimension => Tag::PixelYDimension,
        Tag::PixelYDimension => Tag::PixelXDimension,
        Tag::FocalPlaneXResolution => Tag::FocalPlaneYResolution,
        Tag::FocalPlaneYResolution => Tag::FocalPlaneXResolution,
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(tag: Tag, value: Value) -> Field {
        Field { tag, ifd_num: In::PRIMARY, value }
    }

    fn block(fields: &[Field]) -> Vec<u8> {
        let (mut writer, mut block) = (Writer::new(), Cursor::new(Vec::new()));
        writer.set_jpeg(b"\xff\xd8 a thumbnail", In::THUMBNAIL);
        fields.iter().for_each(|field| writer.push_field(field));
        writer.write(&mut block, true).expect("memory can be written to");
        block.into_inner()
    }

    fn phone() -> Vec<u8> {
        let text = |text: &str| Value::Ascii(vec![text.into()]);
        block(&[
            field(Tag::Make, text("Maker")),
            field(Tag::Artist, text(&"a".repeat(MAX_TEXT))),
            field(Tag::Orientation, Value::Short(vec![6])),
            field(Tag::FocalLengthIn35mmFilm, Value::Short(vec![26])),
            field(Tag::PixelXDimension, Value::Long(vec![4000])),
            field(Tag::PixelYDimension, Value::Long(vec![3000])),
            field(Tag::BodySerialNumber, text("secret")),
            field(Tag::UserComment, Value::Undefined(b"secret".to_vec(), 0)),
            field(Tag::MakerNote, Value::Undefined(b"secret".to_vec(), 0)),
            field(Tag::GPSLatitudeRef, text("N")),
        ])
    }

    #[test]
    fn camera_and_exposure_stay_and_what_a_person_may_not_want_to_share_goes() {
        let carried = carried_exif(phone(), false);
        let exif = parse(carried.clone()).expect("it is sound");
        let number =
            |tag| exif.get_field(tag, In::PRIMARY).and_then(|field| field.value.get_uint(0));
        assert_eq!(number(Tag::FocalLengthIn35mmFilm), Some(26));
        assert_eq!(number(Tag::Orientation), Some(1));
        assert_eq!(
            [Tag::PixelXDimension, Tag::PixelYDimension].map(number),
            [4000, 3000].map(Some)
        );
        assert_eq!(exif.fields().count(), 5, "a text that is too long is left out as well");
        assert!(!carried.windows(6).any(|bytes| bytes == b"secret"));
        assert!(!carried.windows(5).any(|bytes| bytes == b"thumb"));
        assert_eq!(carried_exif(carried.clone(), false), carried);
        let turned = parse(carried_exif(phone(), true)).expect("it is sound");
        let width = turned.get_field(Tag::PixelXDimension, In::PRIMARY).expect("it is there");
        assert_eq!(width.value.get_uint(0), Some(3000));
    }

    #[test]
    fn a_damaged_block_or_one_without_such_fields_gives_none() {
        let whole = phone();
        for end in 0..whole.len() {
            carried_exif(whole[..end].to_vec(), false);
        }
        for at in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] = 0xff;
            carried_exif(damaged, true);
        }
        assert!(carried_exif(b"no block".to_vec(), false).is_empty());
        let place = block(&[field(Tag::GPSLatitudeRef, Value::Ascii(vec![b"N".to_vec()]))]);
        assert!(carried_exif(place, false).is_empty());
    }
}
