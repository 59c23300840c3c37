//! Depth that a JPEG carries beside its photo, as its XMP metadata describes it: Google's Depthmap
//! Metadata (GDepth), which phones and 3D-photo tools write, with the picture of the depth in the
//! metadata; and its successor Dynamic Depth 1.0, with that picture behind the photo
//! (`dynamic_depth.rs`).
//!
//! A stored sample n from 0 to 1 is the
//! distance d = near + n (far - near) for `RangeLinear`, and d = far near / (far - n (far - near))
//! for `RangeInverse`.

use std::borrow::Cow;
use std::io::Cursor;

use ::image::metadata::Orientation;
use ::image::{ImageDecoder, ImageFormat, ImageReader};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::png::gray;
use super::{DepthFile, Measure, dynamic_depth};
use crate::image::Plane;
use crate::image::io::raster::{Bits, decode_raster, decode_turned, image_format, is_turned};
use crate::image::io::source::{FileFormat, NamedBytes, ReadError, format};
use crate::image::io::xmp::{packet, property};
use crate::image::same_aspect;

/// Whether a JPEG states that it carries depth.
pub(in crate::image) fn is_in(jpeg: &[u8]) -> bool {
    names(&packet(jpeg)).is_some()
}

/// The prefix of the properties of depth, and the names of those with its picture and that of its
/// confidence.
fn names(packet: &str) -> Option<(&'static str, &'static str, &'static str)> {
    let forms = [("GDepth", "Data", "Confidence"), ("DepthMap", "DepthURI", "ConfidenceURI")];
    forms.into_iter().find(|(prefix, data, _)| property(packet, prefix, data).is_some())
}

/// Reads the depth that a JPEG carries, in meters, turned as the photo is shown.
///
/// # Errors
/// The JPEG carries none, its properties contradict the specification, or the picture in it is
/// damaged or exceeds the limits of `source`.
pub(in crate::image) fn read(source: NamedBytes) -> Result<DepthFile, ReadError> {
    let packet = packet(source.bytes);
    let what = "depth in a JPEG";
    let Some((prefix, data, confidence)) = names(&packet) else {
        let wanted = "metadata with GDepth:Data or DepthMap:DepthURI";
        return Err(source.error(what, wanted, "none"));
    };
    let get = |name: &str| property(&packet, prefix, name);
    let text = |name: &str| {
        let wanted = || format!("metadata with {prefix}:{name}");
        get(name).ok_or_else(|| source.error(what, wanted(), "none"))
    };
    let number = |name: &str| {
        let text = text(name)?.trim();
        let number = text.parse::<f32>().ok().filter(|n| n.is_finite() && *n > 0.0);
        let what = format!("{prefix}:{name}");
        number.ok_or_else(|| source.error(&what, "a number above 0", text))
    };
    let photo = Shown::of(source);
    let stored = |what: &str, stated: &str| {
        let what = format!("{what} in a JPEG");
        let bytes = match prefix {
            "GDepth" => {
                let clean: Vec<u8> =
                    stated.bytes().filter(|byte| !byte.is_ascii_whitespace()).collect();
                let decoded = STANDARD.decode(clean);
                Cow::Owned(decoded.map_err(|e| source.error(&what, "base64", e))?)
            }
            _ => Cow::Borrowed(dynamic_depth::item(source, &packet, stated)?),
        };
        picture(NamedBytes { bytes: &bytes, ..source }, &what, &photo)
    };
    let shares = stored("depth", text(data)?)?;
    let (near, far) = (number("Near")?, number("Far")?);
    if near >= far {
        let what = format!("{prefix}:Far");
        return Err(source.error(&what, format!("more than Near, {near}"), far));
    }
    let values = match text("Format")?.trim() {
        "RangeLinear" => shares.map(|n| near + n * (far - near)),
        "RangeInverse" => shares.map(|n| far * near / (far - n * (far - near))),
        other => {
            let what = format!("{prefix}:Format");
            return Err(source.error(&what, "RangeLinear or RangeInverse", other));
        }
    };
    let mut file = DepthFile::plain(values);
    file.measure = Some(match get("MeasureType").map(str::trim) {
        Some("OpticRay") => Measure::RayLength,
        _ => Measure::PlanarZ,
    });
    match get("Units").map(str::trim) {
        Some("m" | "Meters") => file.scale = Some(1.0),
        Some("mm") => file.scale = Some(1e-3),
        Some(unit @ "Diopters") => {
            return Err(source.error("DepthMap:Units", "Meters", unit));
        }
        _ => file.notes.push(format!("its {prefix} states no unit: the scale is unknown")),
    }
    if let Some(stated) = get(confidence) {
        let sure = stored("confidence", stated)?;
        if sure.size() == file.values.size() {
            file.confidence = Some(sure);
        } else {
            file.notes.push(format!("its {prefix}:{confidence} has another size than its depth"));
        }
    }
    Ok(file)
}

/// The size of a JPEG as it is stored, and the orientation that it is shown by.
struct Shown {
    size: (usize, usize),
    orientation: Orientation,
}

impl Shown {
    fn of(source: NamedBytes) -> Shown {
        let file = ImageReader::with_format(Cursor::new(source.bytes), ImageFormat::Jpeg);
        let found = file.into_decoder().ok().map(|mut decoder| {
            let (width, height) = decoder.dimensions();
            let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
            Shown { size: (width as usize, height as usize), orientation }
        });
        found.unwrap_or(Shown { size: (1, 1), orientation: Orientation::NoTransforms })
    }
}

/// A gray picture as fractions of its largest number. One without an orientation of its own is
/// turned as the photo is, unless it already has the shape of the turned photo.
fn picture(source: NamedBytes, what: &str, photo: &Shown) -> Result<Plane<f32>, ReadError> {
    let kind = format(source)
        .filter(|kind| [FileFormat::Png, FileFormat::Jpeg].contains(kind))
        .ok_or_else(|| source.error(what, "PNG or JPEG", "another format"))?;
    let mut raster = decode_raster(source, image_format(kind))?;
    let is_plain = raster.orientation == Orientation::NoTransforms;
    let fits =
        !is_turned(photo.orientation) || same_aspect((raster.width, raster.height), photo.size);
    if is_plain && fits && photo.orientation != Orientation::NoTransforms {
        raster = decode_turned(source, image_format(kind), Some(photo.orientation))?;
    }
    let top = if raster.bits() == Bits::Sixteen { 65535.0 } else { 255.0 };
    let values = gray(&raster).ok_or_else(|| source.error(what, "gray levels", "colors"))?;
    Ok(values.map(|v| v / top))
}
