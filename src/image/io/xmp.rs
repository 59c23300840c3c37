//! The XMP metadata of a JPEG as text, and single properties of it.
//!
//! It lies in the standard packet (an APP1 segment) and in the extended one, which is spread over
//! several (XMP specification part 3, 1.1.3.1).

use super::jpeg_segments::{XMP, segments};

const EXTENDED_XMP: &[u8] = b"http://ns.adobe.com/xmp/extension/\0";
/// Bytes of an extended segment behind its name: digest, length of all and offset of this part.
const EXTENDED_HEADER: usize = 40;

/// The XMP of a JPEG: the standard packet, and behind it the parts of the extended one in the order
/// of the file, in which they are written.
pub(in crate::image) fn packet(bytes: &[u8]) -> String {
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

/// The value of `prefix:name`, an attribute or an element.
pub(in crate::image) fn property<'a>(packet: &'a str, prefix: &str, name: &str) -> Option<&'a str> {
    let tag = format!("{prefix}:{name}");
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
