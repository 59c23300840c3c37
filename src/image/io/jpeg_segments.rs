//! The segments of a JPEG file before its pixels, where metadata lies.

/// The name of the standard XMP packet, at the start of its segment (marker 0xe1).
pub(in crate::image) const XMP: &[u8] = b"http://ns.adobe.com/xap/1.0/\0";

/// The name of an EXIF block, at the start of its segment (marker 0xe1).
pub(in crate::image) const EXIF: &[u8] = b"Exif\0\0";

/// The segments before the pixels: position of the payload in the file, marker, payload. A damaged
/// segment ends them.
pub(in crate::image) fn segments(jpeg: &[u8]) -> impl Iterator<Item = (usize, u8, &[u8])> {
    let mut at = if jpeg.starts_with(b"\xff\xd8") { 2 } else { jpeg.len() };
    std::iter::from_fn(move || {
        let &[0xff, marker, high, low] = jpeg.get(at..at + 4)? else { return None };
        let length = usize::from(u16::from_be_bytes([high, low]));
        // 0xda begins the pixels.
        let payload = jpeg.get(at + 4..at + 2 + length).filter(|_| marker != 0xda)?;
        let start = at + 4;
        at += 2 + length;
        Some((start, marker, payload))
    })
}
