//! The numbers of a gain map in the binary form of ISO 21496-1, as they lie in a segment of the
//! map's JPEG.
//!
//! All numbers are big-endian. Behind two versions of 16 bits and a byte of flags lie the headrooms
//! of the photo and of its HDR rendition, then for each channel, or once for all, min, max, gamma
//! and the two offsets. Each is a fraction of 32 bits over 32 bits; libultrahdr may write one
//! denominator for all before them. Min, max and offsets are signed. Min, max and headrooms are
//! logarithms of base 2.

use glam::Vec3;

use super::gains::{BASE_IS_HDR, Gains, GainsOrReason, OUT_OF_RANGE};

/// The name of the numbers, at the start of their segment (marker 0xe2).
pub(super) const NAME: &[u8] = b"urn:iso:std:iso:ts:21496:-1\0";

/// Flag: numbers for each of three channels.
const THREE_CHANNELS: u8 = 1 << 7;
/// Flag: the channels are those of the photo, and not those of the HDR rendition.
const CHANNELS_OF_PHOTO: u8 = 1 << 6;
/// Flag of libultrahdr: one denominator for all fractions.
const ONE_DENOMINATOR: u8 = 1 << 3;

/// Reads the numbers; `None` where there are only the versions, as in the photo's own segment.
pub(super) fn gains(block: &[u8]) -> Option<GainsOrReason> {
    match block {
        [_, _, _, _] => None,
        [0, 0, _, _, flags, rest @ ..] => {
            Some(logarithmic(*flags, rest).unwrap_or(Err("its numbers are cut off")))
        }
        [_, _, _, _, ..] => Some(Err("its form is a later one than the first of ISO 21496-1")),
        _ => Some(Err("its numbers are cut off")),
    }
}

/// The gains of the numbers behind the flags; `None` where they are cut off.
fn logarithmic(flags: u8, mut rest: &[u8]) -> Option<GainsOrReason> {
    let mut bytes = || {
        let (bytes, behind) = rest.split_first_chunk::<4>()?;
        rest = behind;
        Some(*bytes)
    };
    let common = if flags & ONE_DENOMINATOR != 0 { Some(bytes()?) } else { None };
    // A denominator of 0 gives a number that is not finite, which the check of all numbers refuses.
    let mut fraction = |is_signed: bool| {
        let numerator = bytes()?;
        let denominator = match common {
            Some(common) => common,
            None => bytes()?,
        };
        let numerator = match is_signed {
            true => f64::from(i32::from_be_bytes(numerator)),
            false => f64::from(u32::from_be_bytes(numerator)),
        };
        Some((numerator / f64::from(u32::from_be_bytes(denominator))) as f32)
    };
    let (base, alternate) = (fraction(false)?, fraction(false)?);
    let channels = if flags & THREE_CHANNELS != 0 { 3 } else { 1 };
    let mut table = [[0.0; 5]; 3];
    for channel in table.iter_mut().take(channels) {
        for (number, is_signed) in channel.iter_mut().zip([true, true, false, true, true]) {
            *number = fraction(is_signed)?;
        }
    }
    let [min, max, gamma, offset_base, offset_alternate] =
        [0, 1, 2, 3, 4].map(|i| Vec3::from_array([0, 1, 2].map(|c| table[c.min(channels - 1)][i])));
    if !base.is_finite() || !alternate.is_finite() {
        return Some(Err(OUT_OF_RANGE));
    }
    if base >= alternate {
        return Some(Err(BASE_IS_HDR));
    }
    let by_map_profile = flags & CHANNELS_OF_PHOTO == 0;
    let gains =
        Gains::Logarithmic { min, max, gamma, offset_base, offset_alternate, by_map_profile };
    Some(gains.checked())
}
