//! Portable float maps, as the Middlebury stereo data and MiDaS write them.

use crate::image::Plane;
use crate::image::io::source::{NamedBytes, ReadError};

/// Longest header that is searched, bytes.
const MAX_HEADER: usize = 128;

/// Reads a gray PFM: `Pf`, width, height and scale as text, then 32-bit numbers, the lowest row
/// first. A negative scale means little-endian numbers; its magnitude is a unit that nobody agrees
/// on and is left out.
///
/// # Errors
/// The content is not a gray PFM, or exceeds the limits of `source`.
pub(in crate::image) fn read(source: NamedBytes) -> Result<Plane<f32>, ReadError> {
    if source.bytes.starts_with(b"PF") {
        return Err(source.error("PFM", "one gray channel, `Pf`", "three channels, `PF`"));
    }
    let (words, data) = header(source.bytes).ok_or_else(|| {
        let wanted = format!("`Pf`, width, height and scale within {MAX_HEADER} bytes");
        source.error("PFM header", wanted, "another text")
    })?;
    let number = |at: usize| {
        let wrong = |_| source.error("PFM header", "width and height", words[at]);
        words[at].parse::<u32>().map_err(wrong)
    };
    let (width, height) = (number(1)?, number(2)?);
    let scale = words[3].parse::<f32>().ok().filter(|scale| scale.is_finite() && *scale != 0.0);
    let scale =
        scale.ok_or_else(|| source.error("PFM scale", "a number other than 0", words[3]))?;
    source.check_size(width.into(), height.into(), 4)?;
    let (width, height) = (width as usize, height as usize);
    if data.len() < 4 * width * height {
        let wanted = format!("{width} x {height} numbers of 4 bytes");
        return Err(source.error("PFM data", wanted, format!("{} bytes", data.len())));
    }
    Ok(Plane::from_fn(width, height, |x, y| {
        let at = 4 * ((height - 1 - y) * width + x);
        let bytes = [data[at], data[at + 1], data[at + 2], data[at + 3]];
        if scale < 0.0 { f32::from_le_bytes(bytes) } else { f32::from_be_bytes(bytes) }
    }))
}

/// The four words of a header, and the bytes behind the single white space that ends it.
fn header(bytes: &[u8]) -> Option<([&str; 4], &[u8])> {
    let mut words = [""; 4];
    let mut at = 0;
    for word in &mut words {
        let head = &bytes[..bytes.len().min(MAX_HEADER)];
        let start = at + head.get(at..)?.iter().position(|byte| !byte.is_ascii_whitespace())?;
        let end = start + head[start..].iter().position(u8::is_ascii_whitespace)?;
        *word = std::str::from_utf8(&head[start..end]).ok()?;
        at = end;
    }
    Some((words, &bytes[at + 1..]))
}
