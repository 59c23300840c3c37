//! The header of a photo: its size, and the lens by its EXIF block ([`super::exif_block`]).

use std::io::Cursor;

use ::image::{ImageDecoder, ImageFormat, ImageReader};
use exif::{Exif, In, Tag, Value};

use super::color_profile::ToRec709;
use super::depth::gdepth;
use super::raster::{image_format, is_turned};
use super::source::{FileFormat, NamedBytes, ReadError, format, not_one_of};
use super::{exif_block, exr_read, gain_map, read};

/// Most characters of a camera's name.
const MAX_NAME: usize = 64;

/// Facts of a photo that its pixels need not be decoded for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PhotoHeader {
    /// Columns and rows as the photo is shown, after its EXIF orientation.
    pub size: (usize, usize),
    /// Whether the orientation exchanges columns and rows as they are stored.
    pub is_turned: bool,
    /// The usual ending of a name of its format: `png`, `jpg`, `webp`, `hdr`, `exr`, `heic`
    /// or `avif`.
    pub extension: &'static str,
    /// The name of its ICC profile, where its colors are not those of sRGB.
    pub profile: Option<String>,
    /// Whether it has a gain map that can be used, as Ultra HDR photos and those of iPhones do.
    pub has_gain_map: bool,
    /// Whether it states that it carries depth, which [`super::read_depth_file`] reads.
    pub has_depth: bool,
    /// The lens, as far as EXIF describes it.
    pub lens: Lens,
}

/// The lens of a photo by its EXIF block; each field is `None` where the block lacks it or where it
/// is not a sensible number.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lens {
    /// `Make` and `Model`.
    pub camera: Option<String>,
    /// `FocalLengthIn35mmFilm`, millimeters: the focal length that has the same diagonal field of
    /// view on a frame of 36 x 24 mm.
    pub equivalent_mm: Option<f32>,
    /// `FocalLength`, millimeters.
    pub focal_mm: Option<f32>,
    /// `FocalPlaneXResolution`, pixels of `recorded` per millimeter on the sensor.
    pub pixels_per_mm: Option<f32>,
    /// `PixelXDimension` and `PixelYDimension`: columns and rows as the camera stored them.
    pub recorded: Option<(usize, usize)>,
}

/// Reads the header of a photo: PNG, JPEG, WebP, HDR or EXR. A damaged EXIF block counts as
/// missing.
///
/// # Errors
/// The file is not one of these, or its header is damaged or exceeds the limits.
pub fn read_photo_header(source: NamedBytes) -> Result<PhotoHeader, ReadError> {
    let (format, extension) = match format(source) {
        Some(FileFormat::Exr) => {
            let size = exr_read::read(source)?.colors(source)?.size();
            return Ok(PhotoHeader { size, extension: "exr", ..PhotoHeader::default() });
        }
        #[cfg(feature = "heic")]
        Some(FileFormat::Heif) => return heif_header(source),
        Some(format @ FileFormat::Png) => (format, "png"),
        Some(format @ FileFormat::Jpeg) => (format, "jpg"),
        Some(format @ FileFormat::Webp) => (format, "webp"),
        Some(format @ FileFormat::Hdr) => (format, "hdr"),
        _ => return Err(not_one_of(source, read::PHOTO)),
    };
    let format = image_format(format);
    let bad = |e: ::image::ImageError| {
        let name = format!("{format:?}").to_uppercase();
        source.error("content", format!("a whole {name} file"), e)
    };
    let mut decoder =
        ImageReader::with_format(Cursor::new(source.bytes), format).into_decoder().map_err(bad)?;
    let (width, height) = decoder.dimensions();
    source.check_size(
        width.into(),
        height.into(),
        decoder.color_type().bytes_per_pixel().into(),
    )?;
    let is_turned = decoder.orientation().is_ok_and(is_turned);
    let exif = decoder.exif_metadata().ok().flatten();
    let profile = decoder.icc_profile().ok().flatten();
    let (width, height) = (width as usize, height as usize);
    Ok(PhotoHeader {
        size: if is_turned { (height, width) } else { (width, height) },
        is_turned,
        extension,
        profile: profile_name(profile),
        has_gain_map: format == ImageFormat::Jpeg
            && matches!(gain_map::find(source.bytes), Ok(Some(_))),
        has_depth: format == ImageFormat::Jpeg && gdepth::is_in(source.bytes),
        lens: lens_of(exif),
    })
}

#[cfg(feature = "heic")]
fn heif_header(source: NamedBytes) -> Result<PhotoHeader, ReadError> {
    let header = super::heif::header(source)?;
    let extension = if source.bytes.get(8..11) == Some(b"avi") { "avif" } else { "heic" };
    Ok(PhotoHeader {
        size: header.size,
        is_turned: header.is_turned,
        extension,
        profile: profile_name(header.profile),
        has_gain_map: header.has_gain_map,
        has_depth: false,
        lens: lens_of(header.exif),
    })
}

/// The name of an ICC profile whose colors are not those of sRGB.
fn profile_name(icc: Option<Vec<u8>>) -> Option<String> {
    Some(ToRec709::new(&icc?).ok().flatten()?.name)
}

/// The lens by an EXIF block.
fn lens_of(exif: Option<Vec<u8>>) -> Lens {
    exif.and_then(exif_block::parse).map_or_else(Lens::default, |exif| lens(&exif))
}

fn lens(exif: &Exif) -> Lens {
    let number = |tag| {
        let value = match &exif.get_field(tag, In::PRIMARY)?.value {
            Value::Rational(values) => values.first()?.to_f32(),
            value => value.get_uint(0)? as f32,
        };
        (value.is_finite() && value > 0.0).then_some(value)
    };
    let text = |tag| match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Ascii(lines) => {
            let text = String::from_utf8_lossy(lines.first()?);
            let text = text.trim().chars().take(MAX_NAME).collect::<String>();
            (!text.is_empty()).then_some(text)
        }
        _ => None,
    };
    // 2 is an inch, 3 a centimeter; some cameras write 4 for a millimeter, 5 for a micrometer.
    let unit_mm = match exif.get_field(Tag::FocalPlaneResolutionUnit, In::PRIMARY) {
        None => 25.4,
        Some(field) => match field.value.get_uint(0) {
            Some(3) => 10.0,
            Some(4) => 1.0,
            Some(5) => 1e-3,
            _ => 25.4,
        },
    };
    let camera = match (text(Tag::Make), text(Tag::Model)) {
        (Some(make), Some(model)) if !model.starts_with(&make) => Some(format!("{make} {model}")),
        (make, model) => model.or(make),
    };
    Lens {
        camera,
        equivalent_mm: number(Tag::FocalLengthIn35mmFilm),
        focal_mm: number(Tag::FocalLength),
        pixels_per_mm: number(Tag::FocalPlaneXResolution).map(|n| n / unit_mm),
        recorded: number(Tag::PixelXDimension)
            .zip(number(Tag::PixelYDimension))
            .map(|(width, height)| (width as usize, height as usize)),
    }
}
