//! Depth in the XMP metadata of a JPEG: Google's Depthmap Metadata (GDepth), which phones and
//! 3D-photo tools write.
//!
//! The properties lie in the standard packet (an APP1 segment) or in the extended one, which is
//! spread over several (XMP specification part 3, 1.1.3.1). A stored sample n from 0 to 1 is the
//! distance d = near + n (far - near) for `RangeLinear`, and d = far near / (far - n (far - near))
//! for `RangeInverse`.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::png::gray;
use super::{DepthFile, Measure};
use crate::image::Plane;
use crate::image::io::jpeg_segments::{XMP, segments};
use crate::image::io::raster::{Bits, decode_raster, image_format};
use crate::image::io::source::{FileFormat, NamedBytes, ReadError, format};

const EXTENDED_XMP: &[u8] = b"http://ns.adobe.com/xmp/extension/\0";
/// Bytes of an extended segment behind its name: digest, length of all and offset of this part.
const EXTENDED_HEADER: usize = 40;

/// Reads the depth that a JPEG carries, in meters.
///
/// # Errors
/// The JPEG carries none, its properties contradict the specification, or the picture in it is
/// damaged or exceeds the limits of `source`.
pub(in crate::image) fn read(source: NamedBytes) -> Result<DepthFile, ReadError> {
    let packet = packet(source.bytes);
    let missing = |name: &str| {
        source.error("depth in a JPEG", format!("metadata with GDepth:{name}"), "none")
    };
    let text = |name: &str| property(&packet, name).ok_or_else(|| missing(name));
    let number = |name: &str| {
        let text = text(name)?.trim();
        let number = text.parse::<f32>().ok().filter(|n| n.is_finite() && *n > 0.0);
        let what = format!("GDepth:{name}");
        number.ok_or_else(|| source.error(&what, "a number above 0", text))
    };
    let stored = picture(source, "depth", text("Data")?)?;
    let (near, far) = (number("Near")?, number("Far")?);
    if near >= far {
        return Err(source.error("GDepth:Far", format!("more than Near, {near}"), far));
    }
    let values = match text("Format")?.trim() {
        "RangeLinear" => stored.map(|n| near + n * (far - near)),
        "RangeInverse" => stored.map(|n| far * near / (far - n * (far - near))),
        other => return Err(source.error("GDepth:Format", "RangeLinear or RangeInverse", other)),
    };
    let mut file = DepthFile::plain(values);
    file.measure = Some(match property(&packet, "MeasureType").map(str::trim) {
        Some("OpticRay") => Measure::RayLength,
        _ => Measure::PlanarZ,
    });
    match property(&packet, "Units").map(str::trim) {
        Some("m") => file.scale = Some(1.0),
        Some("mm") => file.scale = Some(1e-3),
        _ => file.notes.push("its GDepth states no unit: the scale is unknown".into()),
    }
    if let Some(data) = property(&packet, "Confidence") {
        let confidence = picture(source, "confidence", data)?;
        if confidence.size() == file.values.size() {
            file.confidence = Some(confidence);
        } else {
            file.notes.push("its GDepth:Confidence has another size than its depth".into());
        }
    }
    Ok(file)
}

/// The XMP of a JPEG: the standard packet, and behind it the parts of the extended one in the order
/// of the file, in which they are written.
fn packet(bytes: &[u8]) -> String {
    let (mut standard, mut extended) = (Vec::new(), Vec::new());
    for (_, _, payload) in segments(bytes).filter(|(_, marker, _)| *marker == 0xe1) {
        if let Some(part) = payload.strip_prefix(XMP) {
            standard.extend_from_slice(part);
        } else if let Some(part) = payload.strip_prefix(EXTENDED_XMP) {
            extended.extend_from_slice(part.get(EXTENDED_HEADER..).unwrap_or_default());
        }
    }
    standard.extend(extended);
    String::from_utf8_lossy(&standard).into_owned()
}

/// The value of `GDepth:name`, an attribute or an element.
fn property<'a>(packet: &'a str, name: &str) -> Option<&'a str> {
    let tag = format!("GDepth:{name}");
    packet.match_indices(&tag).find_map(|(at, _)| {
        let rest = &packet[at + tag.len()..];
        if let Some(content) = rest.strip_prefix('>') {
            return content.split('<').next();
        }
        let value = rest.trim_start().strip_prefix('=')?.trim_start();
        let quote = value.chars().next().filter(|c| ['"', '\''].contains(c))?;
        value[1..].split(quote).next()
    })
}

/// A gray picture in base64, as fractions of its largest number.
fn picture(source: NamedBytes, what: &str, data: &str) -> Result<Plane<f32>, ReadError> {
    let what = format!("{what} in a JPEG");
    let clean: Vec<u8> = data.bytes().filter(|byte| !byte.is_ascii_whitespace()).collect();
    let bytes = STANDARD.decode(clean).map_err(|e| source.error(&what, "base64", e))?;
    let inner = NamedBytes { name: source.name, bytes: &bytes, most: source.most };
    let kind = format(inner)
        .filter(|kind| [FileFormat::Png, FileFormat::Jpeg].contains(kind))
        .ok_or_else(|| source.error(&what, "PNG or JPEG", "another format"))?;
    let raster = decode_raster(inner, image_format(kind))?;
    let top = if raster.bits() == Bits::Sixteen { 65535.0 } else { 255.0 };
    let values = gray(&raster).ok_or_else(|| source.error(&what, "gray levels", "colors"))?;
    Ok(values.map(|v| v / top))
}
