//! Photos, normals and masks from picture files.

use glam::Vec3;

use super::color_profile::ToRec709;
use super::exif_block::carried_exif;
use super::gain_map::Gains;
#[cfg(feature = "heic")]
use super::heif;
use super::raster::{Bits, Raster, decode_raster, image_format, is_turned};
use super::source::{FileFormat, NamedBytes, ReadError, format, not_one_of};
use super::{exr_read, gain_map};
use crate::image::{Mask, Picture, Plane, Transfer};

/// A photo as it was read.
#[derive(Clone, Debug)]
pub struct Photo {
    /// Linear Rec.709, the photo's own size.
    pub picture: Picture,
    /// 1 where a channel is saturated, else 0.
    pub clipped: Mask,
    /// Precision of the file's samples.
    pub bits: Bits,
    /// The EXIF block of pictures that are made of the photo ([`carried_exif`]), empty for none.
    pub exif: Vec<u8>,
    /// Messages for the person that are not errors.
    pub warnings: Vec<String>,
}

/// The formats of photos.
pub(in crate::image) const PHOTO: &str = if cfg!(feature = "heic") {
    "a photo: PNG, JPEG, WebP, HEIC, AVIF, HDR or EXR"
} else {
    "a photo: PNG, JPEG, WebP, HDR or EXR"
};

/// Reads a photo: PNG (8 or 16 bits, gray, RGB, palette; alpha is left out with a warning), JPEG,
/// WebP, HDR, EXR (R, G, B, or Y, or R alone), and by the feature `heic` HEIC and AVIF. A photo
/// that carries an EXIF orientation is turned upright. HDR and EXR are linear by their format;
/// `transfer` applies to the others. Where it is
/// sRGB, an ICC profile of curves and a matrix (Display P3, Adobe RGB, ProPhoto) takes its place,
/// and a gain map of a JPEG (Ultra HDR, ISO 21496-1, Apple) brightens it to the light of the scene,
/// beyond 1: a pixel counts as saturated only where its map is.
///
/// A pixel is saturated when one of its channels is: 254 or 255 of 255, or from 245 on where many
/// more pixels begin than below it, as in photos whose white is less than 255; 65535 of 65535; in a
/// float file, within 0.1 % of the file's maximum, if that maximum is a plateau: at least 16
/// pixels, at least 0.01 % and at most half of all. Non-finite numbers are an error.
///
/// ```
/// use glam::Vec3;
/// use relight::image::{NamedBytes, Picture, Plane, Transfer, read_photo, write_png};
///
/// let gray = Picture(Plane::filled(4, 3, Vec3::splat(0.5)));
/// let bytes = write_png(&gray, Transfer::Srgb, false);
/// let photo = read_photo(NamedBytes::new("gray.png", &bytes), Transfer::Srgb)?;
/// assert_eq!(photo.picture.0.size(), (4, 3));
/// assert!((photo.picture.0.get(0, 0).x - 0.5).abs() < 0.005);
/// assert_eq!(photo.clipped.0.get(0, 0), 0.0);
/// # Ok::<(), relight::image::ReadError>(())
/// ```
///
/// # Errors
/// The file is not one of these, is damaged or too large, or holds numbers that are not finite.
pub fn read_photo(source: NamedBytes, transfer: Transfer) -> Result<Photo, ReadError> {
    let mut warnings = Vec::new();
    let mut exif = Vec::new();
    let (picture, clipped, bits) = match format(source) {
        Some(FileFormat::Exr) => {
            let file = exr_read::read(source)?;
            warnings.extend(file.warnings.iter().cloned());
            let picture = file.colors(source)?;
            let clipped = plateau(&picture);
            (picture, clipped, Bits::Float)
        }
        Some(kind @ (FileFormat::Png | FileFormat::Jpeg | FileFormat::Webp | FileFormat::Hdr)) => {
            let mut raster = decode_raster(source, image_format(kind))?;
            if let Some(block) = raster.exif.take() {
                exif = carried_exif(block, is_turned(raster.orientation));
            }
            let map = match kind {
                FileFormat::Jpeg => gain_map::read(source, raster.orientation),
                _ => Ok(None),
            };
            linear_light(&raster, map, transfer, &mut warnings)
        }
        #[cfg(feature = "heic")]
        Some(FileFormat::Heif) => {
            let mut photo = heif::decode(source)?;
            if let Some(block) = photo.raster.exif.take() {
                exif = carried_exif(block, false);
            }
            linear_light(&photo.raster, photo.gain_map, transfer, &mut warnings)
        }
        _ => return Err(not_one_of(source, PHOTO)),
    };
    if let Some(at) = picture.pixels().iter().position(|c| !c.is_finite()) {
        let (x, y) = (at % picture.width(), at / picture.width());
        return Err(source.error(
            "pixels",
            "finite numbers",
            format!("{} at ({x}, {y})", picture.get(x, y)),
        ));
    }
    Ok(Photo { picture: Picture(picture), clipped: Mask(clipped), bits, exif, warnings })
}

/// Linear Rec. 709, saturation and precision of a photo with a gain map, if that can be read.
fn linear_light(
    raster: &Raster,
    gain_map: Result<Option<(Raster, Gains)>, String>,
    transfer: Transfer,
    warnings: &mut Vec<String>,
) -> (Plane<Vec3>, Plane<f32>, Bits) {
    if raster.is_transparent() {
        warnings.push("the photo is transparent in places: its alpha channel is left out".into());
    }
    let bits = raster.bits();
    let top = match bits {
        Bits::Eight => saturated_from(raster),
        Bits::Sixteen => 65534.5 / 65535.0,
        Bits::Float => {
            let picture = raster.colors(|v| v);
            let clipped = plateau(&picture);
            return (picture, clipped, bits);
        }
    };
    let mut clipped = raster.numbers(|c, _| if c.max_element() > top { 1.0 } else { 0.0 });
    let profile = profile(raster, transfer).unwrap_or_else(|why| {
        warnings.push(format!("{why}: it is read as sRGB"));
        None
    });
    let mut picture = match &profile {
        Some(profile) => raster.linear(profile),
        None => raster.colors(|v| transfer.decode(v)),
    };
    if transfer == Transfer::Srgb {
        let brightened = gain_map.and_then(|map| match map {
            Some((map, gains)) => gains.apply(&map, profile.as_ref(), &mut picture, &mut clipped),
            None => Ok(()),
        });
        if let Err(why) = brightened {
            warnings.push(format!("its gain map is left out: {why}"));
        }
    }
    if let Some(profile) = profile {
        picture.pixels_mut().iter_mut().for_each(|color| *color = profile.convert(*color));
    }
    (picture, clipped, bits)
}

/// The stored level, a share of the maximum, above which a channel of a photo of 8 bits is
/// saturated.
///
/// Cameras and resampling leave a white below 255: a level from which on two levels have `STEP`
/// times the pixels of each below it. Of several, the lowest; without one, 254.
fn saturated_from(raster: &Raster) -> f32 {
    /// Lowest level of a white.
    const LOWEST: usize = 245;
    /// Levels below it that are compared with it.
    const BELOW: usize = 10;
    /// Pixels of a level of white over those of one below.
    const STEP: f32 = 4.0;
    /// Least and largest share of all pixels from there on.
    const SHARE: [f32; 2] = [0.002, 0.5];
    let mut count = [0.0f32; 256];
    raster.each(
        |level| level,
        |color, _| count[(255.0 * color.max_element()).round() as usize] += 1.0,
    );
    let all: f32 = count.iter().sum();
    let is_white = |level: &usize| {
        let below = count[level - BELOW..*level].iter().sum::<f32>() / BELOW as f32;
        let from = count[*level..].iter().sum::<f32>() / all;
        count[*level].min(count[level + 1]) > STEP * below && (SHARE[0]..=SHARE[1]).contains(&from)
    };
    ((LOWEST..254).find(is_white).unwrap_or(254) as f32 - 0.5) / 255.0
}

/// The conversion of a photo with an ICC profile. A transfer function other than sRGB is a
/// statement about the stored numbers, and wins over the profile.
///
/// # Errors
/// The profile cannot be used.
fn profile(raster: &Raster, transfer: Transfer) -> Result<Option<ToRec709>, String> {
    match &raster.profile {
        Some(icc) if raster.channels >= 3 && transfer == Transfer::Srgb => ToRec709::new(icc),
        _ => Ok(None),
    }
}

/// Reads directions: EXR with channels X, Y, Z, else R, G, B, of any length. Non-finite numbers
/// become zero.
///
/// # Errors
/// The file is not one of these, is damaged or too large, or has other channels.
pub fn read_normal(source: NamedBytes) -> Result<Plane<Vec3>, ReadError> {
    match format(source) {
        Some(FileFormat::Exr) => {
            let vectors = exr_read::read(source)?.vectors(source)?;
            Ok(vectors.map(|v| if v.is_finite() { v } else { Vec3::ZERO }))
        }
        _ => Err(not_one_of(source, "normals: EXR")),
    }
}

/// Reads a mask: PNG, JPEG or EXR of any bit depth. The value is the share of the pixel that is
/// covered: the Rec.709 luminance of the stored numbers times alpha, in 0..1; below 1/16 it is 0
/// and above 15/16 it is 1, so that the ringing of a JPEG does not leak.
///
/// # Errors
/// The file is not one of these, is damaged or too large.
pub fn read_mask(source: NamedBytes) -> Result<Mask, ReadError> {
    let share = |c: Vec3, alpha: f32| match c.dot(crate::image::LUMINANCE) * alpha {
        m if m > 15.0 / 16.0 => 1.0,
        m if m >= 1.0 / 16.0 => m,
        _ => 0.0,
    };
    match format(source) {
        Some(FileFormat::Exr) => {
            Ok(Mask(exr_read::read(source)?.colors(source)?.map(|c| share(c, 1.0))))
        }
        Some(kind @ (FileFormat::Png | FileFormat::Jpeg)) => {
            Ok(Mask(decode_raster(source, image_format(kind))?.numbers(share)))
        }
        _ => Err(not_one_of(source, "a mask: PNG, JPEG or EXR")),
    }
}

/// Saturation of a float file; see [`read_photo`].
fn plateau(picture: &Plane<Vec3>) -> Plane<f32> {
    let top = picture.pixels().iter().map(|c| c.max_element()).fold(0.0, f32::max);
    let clipped =
        picture.map(|c| if top > 0.0 && c.max_element() >= 0.999 * top { 1.0 } else { 0.0 });
    let count = clipped.pixels().iter().filter(|&&m| m > 0.0).count();
    if count >= 16.max(picture.len() / 10_000) && count <= picture.len() / 2 {
        clipped
    } else {
        clipped.map(|_| 0.0)
    }
}
