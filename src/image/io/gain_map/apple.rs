//! The headroom of an iPhone's gain map before ISO 21496-1, by Apple's page "Applying Apple HDR
//! effect to your photos".
//!
//! The map's XMP packet has the headroom from version 2 on; before, it follows from two numbers of
//! the photo's maker note.

use exif::{In, Tag, Value};

use super::gains::{Gains, GainsOrReason};
use super::ultra_hdr::numbers;

/// The start of Apple's maker note, before its version and byte order.
const MAKER_NOTE: &[u8] = b"Apple iOS\0";
/// Bytes of the maker note before its directory.
const DIRECTORY: usize = 14;
/// Tag of the maker note: `HDRHeadroom`.
const HDR_HEADROOM: u16 = 0x21;
/// Tag of the maker note: `HDRGain`.
const HDR_GAIN: u16 = 0x30;
/// Type of a number of the maker note: two signed integers of 32 bits.
const SIGNED_FRACTION: u16 = 10;

/// The gains of a map by its XMP packet, and by the EXIF block of the photo where the packet lacks
/// the headroom; `None` where the packet is not that of a gain map.
pub(in crate::image) fn gains<'a>(
    xmp: &str,
    exif: impl FnOnce() -> Option<&'a [u8]>,
) -> Option<GainsOrReason> {
    if !xmp.contains("HDRGainMap:HDRGainMapVersion") {
        return None;
    }
    let stated = numbers(xmp, "HDRGainMap:HDRGainMapHeadroom").flatten();
    let headroom = stated.map(|all| all.x).or_else(|| headroom(exif()?));
    Some(
        headroom
            .ok_or("the photo lacks its headroom, as edited photos do")
            .and_then(|headroom| Gains::Headroom(headroom).checked()),
    )
}

/// The headroom by the maker note of an EXIF block.
fn headroom(exif: &[u8]) -> Option<f32> {
    let exif = exif::Reader::new().read_raw(exif.to_vec()).ok()?;
    let Value::Undefined(note, _) = &exif.get_field(Tag::MakerNote, In::PRIMARY)?.value else {
        return None;
    };
    let (a, b) = (maker_number(note, HDR_HEADROOM)?, maker_number(note, HDR_GAIN)?);
    let stops = match (a < 1.0, b <= 0.01) {
        (true, true) => -20.0 * b + 1.8,
        (true, false) => -0.101 * b + 1.601,
        (false, true) => -70.0 * b + 3.0,
        (false, false) => -0.303 * b + 2.303,
    };
    Some(stops.max(0.0).exp2())
}

/// The fraction of a tag of Apple's maker note, whose offsets count from its first byte.
fn maker_number(note: &[u8], tag: u16) -> Option<f32> {
    let is_little = match note.strip_prefix(MAKER_NOTE)?.get(2..4)? {
        b"II" => true,
        b"MM" => false,
        _ => return None,
    };
    let short = |at: usize| {
        let bytes = note.get(at..at.checked_add(2)?)?.try_into().ok()?;
        Some(if is_little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) })
    };
    let long = |at: usize| {
        let bytes = note.get(at..at.checked_add(4)?)?.try_into().ok()?;
        Some(if is_little { i32::from_le_bytes(bytes) } else { i32::from_be_bytes(bytes) })
    };
    let count = usize::from(short(DIRECTORY)?);
    let mut entries = (0..count).map(|i| DIRECTORY + 2 + 12 * i);
    let entry = entries.find(|&at| short(at) == Some(tag))?;
    if short(entry + 2)? != SIGNED_FRACTION || long(entry + 4)? != 1 {
        return None;
    }
    let at = usize::try_from(long(entry + 8)?).ok()?;
    let number = (f64::from(long(at)?) / f64::from(long(at.checked_add(4)?)?)) as f32;
    number.is_finite().then_some(number)
}
