//! The pictures behind the photo in a file of Dynamic Depth 1.0.
//!
//! The photo's XMP lists all pictures of the file in their order (`Container:Item`), each with its
//! length in bytes and a name (`Item:DataURI`) by which the depth is found. The first is the photo
//! itself, whose length is stated as 0; the others fill the end of the file.

use crate::image::io::source::{NamedBytes, ReadError};
use crate::image::io::xmp::property;

/// The bytes of the picture `uri` behind the photo.
///
/// # Errors
/// The list lacks it, or states lengths that exceed the file.
pub(super) fn item<'a>(
    source: NamedBytes<'a>,
    packet: &str,
    uri: &str,
) -> Result<&'a [u8], ReadError> {
    let items = packet.split("<Container:Item").skip(1);
    // From the last picture forward, as the length of the photo is not stated.
    let mut end = source.bytes.len();
    for item in items.collect::<Vec<_>>().into_iter().rev() {
        let text = property(item, "Item", "Length").unwrap_or_default();
        let length: usize = text.trim().parse().unwrap_or(0);
        let start = end.checked_sub(length).ok_or_else(|| {
            let wanted = format!("at most the {} bytes of the file", source.bytes.len());
            source.error("Item:Length", wanted, text)
        })?;
        let is_wanted =
            property(item, "Item", "DataURI").is_some_and(|own| own.trim() == uri.trim());
        if is_wanted && length > 0 {
            return Ok(&source.bytes[start..end]);
        }
        end = start;
    }
    Err(source.error("Container:Directory", format!("an item with Item:DataURI {uri}"), "none"))
}
