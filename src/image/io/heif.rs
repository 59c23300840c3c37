//! HEIC and AVIF photos by libheif: the feature `heic`.
//!
//! libheif turns the picture upright by the file's own transformations, so that the orientation in
//! EXIF, which repeats them, does not apply. The form of the file is ISO/IEC 23008-12.

use ::image::metadata::Orientation;
use libheif_rs::{
    ColorSpace, HeifContext, HeifError, ImageHandle, ItemId, LibHeif, RgbChroma, SecurityLimits,
    TransferCharacteristics,
};
use moxcms::{CicpProfile, ColorProfile, MatrixCoefficients};

use super::gain_map::{Gains, apple};
use super::raster::{Raster, Samples};
use super::source::{MAX_PIXELS, NamedBytes, ReadError};

/// Bytes of an EXIF item before its block: the offset of the block behind them.
const EXIF_OFFSET: usize = 4;
/// The largest item of metadata that is read, bytes.
const MAX_METADATA: usize = 1 << 20;
/// The auxiliary picture that is Apple's gain map.
const GAIN_MAP: &str = "urn:com:apple:photo:2020:aux:hdrgainmap";

/// Facts of a photo that its pixels need not be decoded for.
pub(super) struct HeifHeader {
    /// Columns and rows, upright.
    pub(super) size: (usize, usize),
    /// Whether the file's transformations exchange columns and rows as they are stored.
    pub(super) is_turned: bool,
    /// The ICC profile of the file, or one that its code points for color stand for.
    pub(super) profile: Option<Vec<u8>>,
    /// The EXIF block.
    pub(super) exif: Option<Vec<u8>>,
    /// Whether it has a gain map that can be used.
    pub(super) has_gain_map: bool,
}

/// A decoded photo.
pub(super) struct HeifPhoto {
    pub(super) raster: Raster,
    /// The gain map, or the reason for which it cannot be used.
    pub(super) gain_map: Result<Option<(Raster, Gains)>, String>,
}

/// Reads the header of the primary picture.
///
/// # Errors
/// The content is damaged or exceeds the limits of `source`.
pub(super) fn header(source: NamedBytes) -> Result<HeifHeader, ReadError> {
    let _library = LibHeif::new();
    let context = open(source)?;
    let picture = primary(source, &context)?;
    let exif = exif(&picture);
    let has_gain_map = matches!(gain_map(&picture, exif.as_deref()), Some((_, Ok(_))));
    let size = (picture.width() as usize, picture.height() as usize);
    let stored = (picture.ispe_width(), picture.ispe_height());
    let is_turned = (stored.0 > stored.1) != (size.0 > size.1) && stored.0 != stored.1;
    Ok(HeifHeader { size, is_turned, profile: profile(source, &picture)?, exif, has_gain_map })
}

/// Decodes the primary picture, to 8 bits or more as it is stored, and its gain map.
///
/// # Errors
/// The content is damaged or exceeds the limits of `source`.
pub(super) fn decode(source: NamedBytes) -> Result<HeifPhoto, ReadError> {
    let library = LibHeif::new();
    let context = open(source)?;
    let picture = primary(source, &context)?;
    let profile = profile(source, &picture)?;
    let mut raster = raster(source, &library, &picture, profile)?;
    let exif = exif(&picture);
    let gain_map = match gain_map(&picture, exif.as_deref()) {
        None => Ok(None),
        Some((map, gains)) => gains.map_err(String::from).and_then(|gains| {
            let map = raster_of_map(source, &library, &map).map_err(|e| e.message())?;
            Ok(Some((map, gains)))
        }),
    };
    raster.exif = exif;
    Ok(HeifPhoto { raster, gain_map })
}

/// Parses the boxes of the file. libheif keeps to its limits, which are set before.
fn open<'a>(source: NamedBytes<'a>) -> Result<HeifContext<'a>, ReadError> {
    let mut limits = SecurityLimits::new();
    limits.set_max_image_size_pixels(MAX_PIXELS);
    limits.set_max_memory_block_size(source.most);
    let mut context: HeifContext<'a> = HeifContext::new().map_err(|e| bad(source, &e))?;
    context.set_security_limits(&limits).map_err(|e| bad(source, &e))?;
    context.read_bytes(source.bytes).map_err(|e| bad(source, &e))?;
    Ok(context)
}

/// The primary picture, whose size keeps to the limits.
fn primary(source: NamedBytes, context: &HeifContext) -> Result<ImageHandle, ReadError> {
    let picture = context.primary_image_handle().map_err(|e| bad(source, &e))?;
    // Beside the samples lie those of libheif's own copy.
    source.check_size(picture.width().into(), picture.height().into(), 6)?;
    Ok(picture)
}

/// Apple's gain map of a picture and its numbers.
fn gain_map(
    picture: &ImageHandle,
    exif: Option<&[u8]>,
) -> Option<(ImageHandle, Result<Gains, &'static str>)> {
    let mut others = picture.auxiliary_images(None).into_iter();
    let map = others.find(|other| other.auxiliary_type().is_ok_and(|kind| kind == GAIN_MAP))?;
    let packet = metadata(&map, b"mime")?;
    let gains = apple::gains(std::str::from_utf8(&packet).ok()?, || exif)?;
    Some((map, gains))
}

/// The first item of metadata of a type.
fn metadata(picture: &ImageHandle, kind: &[u8; 4]) -> Option<Vec<u8>> {
    let mut ids: [ItemId; 1] = [0];
    let found = picture.metadata_block_ids(&mut ids, kind);
    let id = ids.first().filter(|&&id| found > 0 && picture.metadata_size(id) <= MAX_METADATA)?;
    picture.metadata(*id).ok()
}

/// The EXIF block, which begins behind the offset that its item begins with.
fn exif(picture: &ImageHandle) -> Option<Vec<u8>> {
    let item = metadata(picture, b"Exif")?;
    let (offset, rest) = item.split_first_chunk::<EXIF_OFFSET>()?;
    let offset = usize::try_from(u32::from_be_bytes(*offset)).ok()?;
    Some(rest.get(offset..)?.to_vec())
}

/// The ICC profile of a picture; code points for color (ITU-T H.273) become one.
///
/// # Errors
/// The code points are those of HDR video, whose numbers are not relative to white.
fn profile(source: NamedBytes, picture: &ImageHandle) -> Result<Option<Vec<u8>>, ReadError> {
    if let Some(icc) = picture.color_profile_raw() {
        return Ok(Some(icc.data));
    }
    let Some(points) = picture.color_profile_nclx() else { return Ok(None) };
    let curve = points.transfer_characteristics();
    if matches!(
        curve,
        TransferCharacteristics::ITU_R_BT_2100_0_PQ | TransferCharacteristics::ITU_R_BT_2100_0_HLG
    ) {
        let wanted = "a photo of standard range, with or without a gain map";
        return Err(source.error("transfer function", wanted, "HDR video (PQ or HLG)"));
    }
    let (Ok(color_primaries), Ok(transfer_characteristics)) =
        ((points.color_primaries() as u8).try_into(), (curve as u8).try_into())
    else {
        return Ok(None);
    };
    let profile = ColorProfile::new_from_cicp(CicpProfile {
        color_primaries,
        transfer_characteristics,
        matrix_coefficients: MatrixCoefficients::Identity,
        full_range: true,
    });
    Ok(profile.red_trc.as_ref().and_then(|_| profile.encode().ok()))
}

/// Decodes a picture in color: 8 bits, or 16 where more than 8 are stored.
fn raster(
    source: NamedBytes,
    library: &LibHeif,
    picture: &ImageHandle,
    profile: Option<Vec<u8>>,
) -> Result<Raster, ReadError> {
    let is_deep = picture.luma_bits_per_pixel() > 8;
    let chroma = if is_deep { RgbChroma::HdrRgbLe } else { RgbChroma::Rgb };
    let image =
        library.decode(picture, ColorSpace::Rgb(chroma), None).map_err(|e| bad(source, &e))?;
    let size = (image.width() as usize, image.height() as usize);
    let plane = image.planes().interleaved;
    let bits = plane.as_ref().map_or(8, |plane| plane.bits_per_pixel.clamp(8, 16));
    let plane = plane.map(|plane| (plane.data, plane.stride));
    let bytes = packed(source, plane, size, if is_deep { 6 } else { 3 })?;
    let samples = if is_deep {
        let top = (1u32 << bits) - 1;
        let sixteen = |pair: &[u8]| {
            let stored = u32::from(u16::from_le_bytes([pair[0], pair[1]])).min(top);
            ((stored * 65535 + top / 2) / top) as u16
        };
        Samples::Sixteen(bytes.chunks_exact(2).map(sixteen).collect())
    } else {
        Samples::Eight(bytes)
    };
    let orientation = Orientation::NoTransforms;
    Ok(Raster {
        width: size.0,
        height: size.1,
        channels: 3,
        samples,
        profile,
        exif: None,
        orientation,
    })
}

/// Decodes a gain map, gray of 8 bits.
fn raster_of_map(
    source: NamedBytes,
    library: &LibHeif,
    map: &ImageHandle,
) -> Result<Raster, ReadError> {
    source.check_size(map.width().into(), map.height().into(), 1)?;
    let image = library.decode(map, ColorSpace::Monochrome, None).map_err(|e| bad(source, &e))?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let plane = image.planes().y.filter(|plane| plane.bits_per_pixel == 8);
    let bytes = packed(source, plane.map(|p| (p.data, p.stride)), (width, height), 1)?;
    let samples = Samples::Eight(bytes);
    let orientation = Orientation::NoTransforms;
    Ok(Raster { width, height, channels: 1, samples, profile: None, exif: None, orientation })
}

/// The rows of a plane, given by its bytes and their number a row, without the bytes behind each.
fn packed(
    source: NamedBytes,
    plane: Option<(&[u8], usize)>,
    (width, height): (usize, usize),
    bytes_per_pixel: usize,
) -> Result<Vec<u8>, ReadError> {
    source.check_size(width as u64, height as u64, bytes_per_pixel as u64)?;
    let row = width * bytes_per_pixel;
    let rows = plane.into_iter().flat_map(|(data, stride)| data.chunks(stride.max(1))).take(height);
    let packed: Vec<u8> =
        rows.flat_map(|line| line.get(..row).unwrap_or_default()).copied().collect();
    if packed.len() != row * height {
        return Err(source.error("content", format!("{width} x {height} pixels"), "fewer"));
    }
    Ok(packed)
}

fn bad(source: NamedBytes, error: &HeifError) -> ReadError {
    source.error("content", "a valid HEIC or AVIF file that libheif reads", &error.message)
}
