//! A text inside a picture file that tells how the picture was made: `iTXt` of a PNG, an attribute
//! of an EXR file, both under the name `relight`.

use std::borrow::Cow;

use flate2::Crc;

const NAME: &str = "relight";
/// Longest text, in bytes.
pub const MAX_PROVENANCE: usize = 1 << 20;

const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
/// End of the chunk `IHDR`, which is the first.
const AFTER_IHDR: usize = 33;
/// After the name: no compression, no language, no translated keyword.
const PNG_FLAGS: [u8; 5] = [0; 5];
/// Bytes of the chunk besides the text: length, kind, name, flags and checksum.
const PNG_FRAME: usize = 8 + NAME.len() + PNG_FLAGS.len() + 4;
const EXR: &[u8] = b"\x76\x2f\x31\x01";
/// End of the name of an attribute, and its type.
const EXR_TYPE: &[u8] = b"\0string\0";
/// Flags of deep data and of several parts in the version field.
const UNUSUAL: u32 = 0x1800;

/// The pieces that, one after the other, are the PNG or EXR file `file` with `text` in it, which
/// has at most [`MAX_PROVENANCE`] bytes. `None` for another format and for an EXR file of several
/// parts.
///
/// ```
/// use relight::image::{Picture, Plane, Transfer, read_provenance, with_provenance, write_png};
///
/// let picture = Picture(Plane::filled(2, 1, glam::Vec3::ONE));
/// let png = write_png(&picture, Transfer::Srgb, false);
/// let pieces = with_provenance(&png, "made by hand").expect("it is a PNG");
/// assert_eq!(read_provenance(&pieces.concat()), Some("made by hand"));
/// ```
pub fn with_provenance<'a>(file: &'a [u8], text: &str) -> Option<Vec<Cow<'a, [u8]>>> {
    if text.len() > MAX_PROVENANCE {
        return None;
    }
    if file.starts_with(PNG) {
        let (head, rest) = file.split_at_checked(AFTER_IHDR)?;
        let content = [b"iTXt", NAME.as_bytes(), &PNG_FLAGS, text.as_bytes()].concat();
        let mut crc = Crc::new();
        crc.update(&content);
        let length = content.len() as u32 - 4;
        let chunk = [&length.to_be_bytes()[..], &content, &crc.sum().to_be_bytes()].concat();
        return Some(vec![head.into(), chunk.into(), rest.into()]);
    }
    let (_, end) = exr_attributes(file)?;
    let (head, rest) = file.split_at(end);
    let length = (text.len() as u32).to_le_bytes();
    let attribute = [NAME.as_bytes(), EXR_TYPE, &length[..], text.as_bytes(), b"\0"].concat();
    // The offsets of the blocks follow the end of the header; the first block follows them.
    let rest = &rest[1..];
    let first = u64::from_le_bytes(*rest.first_chunk()?);
    let table = usize::try_from(first).ok()?.checked_sub(end + 1)?;
    let (offsets, blocks) = rest.split_at_checked(table)?;
    let (offsets, []) = offsets.as_chunks() else { return None };
    let moved = (attribute.len() - 1) as u64;
    let offsets: Vec<u8> = offsets.iter().flat_map(|&offset| shifted(offset, moved)).collect();
    Some(vec![head.into(), attribute.into(), offsets.into(), blocks.into()])
}

/// The file that [`with_provenance`] put a text into; as it is where it has none. `None` for a file
/// that it does not write.
///
/// ```
/// use relight::image::{Picture, Plane, Transfer, with_provenance, without_provenance, write_png};
///
/// let picture = Picture(Plane::filled(2, 1, glam::Vec3::ONE));
/// let png = write_png(&picture, Transfer::Srgb, false);
/// let pieces = with_provenance(&png, "made by hand").expect("it is a PNG");
/// assert_eq!(without_provenance(pieces.concat()), Some(png));
/// ```
pub fn without_provenance(mut file: Vec<u8>) -> Option<Vec<u8>> {
    let length = read_provenance(&file).map(str::len);
    if file.starts_with(PNG) {
        if let Some(length) = length {
            let end = AFTER_IHDR + PNG_FRAME + length;
            let name = [b"iTXt", NAME.as_bytes()].concat();
            if !file.get(AFTER_IHDR + 4..end)?.starts_with(&name) {
                return None;
            }
            file.drain(AFTER_IHDR..end);
        }
        return Some(file);
    }
    let (_, end) = exr_attributes(&file)?;
    if let Some(length) = length {
        let attribute = [NAME.as_bytes(), EXR_TYPE].concat();
        let start = end.checked_sub(attribute.len() + 4 + length)?;
        if !file[start..].starts_with(&attribute) {
            return None;
        }
        file.drain(start..end);
        let rest = &mut file[start + 1..];
        let first = u64::from_le_bytes(*rest.first_chunk()?);
        let moved = (end - start) as u64;
        let table = usize::try_from(first).ok()?.checked_sub(end + 1)?;
        let (offsets, []) = rest.get_mut(..table)?.as_chunks_mut() else { return None };
        offsets.iter_mut().for_each(|offset| *offset = shifted(*offset, moved.wrapping_neg()));
    }
    Some(file)
}

/// An offset `by` bytes farther.
fn shifted(offset: [u8; 8], by: u64) -> [u8; 8] {
    u64::from_le_bytes(offset).wrapping_add(by).to_le_bytes()
}

/// The text that [`with_provenance`] put into a file, of which `file` is the beginning; `None`
/// where there is none.
pub fn read_provenance(file: &[u8]) -> Option<&str> {
    let bytes = if let Some(mut chunks) = file.strip_prefix(PNG) {
        loop {
            let (length, rest) = chunks.split_first_chunk()?;
            let (content, rest) =
                rest.split_at_checked(4 + u32::from_be_bytes(*length) as usize)?;
            let text = content.strip_prefix(b"iTXt").and_then(|c| c.strip_prefix(NAME.as_bytes()));
            match text.and_then(|text| text.strip_prefix(&PNG_FLAGS)) {
                Some(text) => break text,
                None => chunks = rest.get(4..)?,
            }
        }
    } else {
        exr_attributes(file)?.0?
    };
    std::str::from_utf8(bytes).ok().filter(|text| text.len() <= MAX_PROVENANCE)
}

/// The attribute `relight` of an EXR file of one part, and the end of its attributes.
fn exr_attributes(file: &[u8]) -> Option<(Option<&[u8]>, usize)> {
    let (version, mut rest) = file.strip_prefix(EXR)?.split_first_chunk()?;
    if u32::from_le_bytes(*version) & UNUSUAL != 0 {
        return None;
    }
    let mut found = None;
    loop {
        let at = file.len() - rest.len();
        let name = until_zero(&mut rest)?;
        if name.is_empty() {
            return Some((found, at));
        }
        let kind = until_zero(&mut rest)?;
        let (length, value) = rest.split_first_chunk()?;
        let (value, after) = value.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        if name == NAME.as_bytes() && kind == b"string" {
            found = Some(value);
        }
        rest = after;
    }
}

fn until_zero<'a>(bytes: &mut &'a [u8]) -> Option<&'a [u8]> {
    let end = bytes.iter().position(|&byte| byte == 0)?;
    let (text, rest) = (&bytes[..end], &bytes[end + 1..]);
    *bytes = rest;
    Some(text)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::image::{
        Compression, ExrLayers, NamedBytes, Picture, Plane, Transfer, read_layers, read_photo,
        write_png,
    };

    const TEXT: &str = "{\"edit\": \"Edit(version: 1)\", \"caf\u{e9}\": 1}";

    fn plane() -> Plane<Vec3> {
        Plane::from_fn(37, 41, |x, y| Vec3::new(x as f32, y as f32, 3.0) / 50.0)
    }

    #[test]
    fn pixels_stay_and_the_text_comes_back() {
        for compression in [
            Compression::None,
            Compression::Rle,
            Compression::Zips,
            Compression::Zip,
            Compression::Piz,
        ] {
            let mut layers = ExrLayers::new(37, 41);
            layers.rgb("light_a", &plane());
            layers.comment("a comment");
            let plain = layers.write(compression).expect("it can be written");
            let file = with_provenance(&plain, TEXT).expect("it is an EXR file").concat();
            assert_eq!(read_provenance(&plain), None);
            assert_eq!(read_provenance(&file), Some(TEXT));
            assert_eq!(without_provenance(file.clone()).as_ref(), Some(&plain));
            assert_eq!(without_provenance(plain.clone()).as_ref(), Some(&plain));
            let read = |bytes: &[u8]| {
                let file = read_layers(NamedBytes::new("a.exr", bytes)).expect("it is sound");
                assert_eq!(file.comments().next(), Some("a comment"));
                file.rgb("light_a")
            };
            assert_eq!(read(&file), read(&plain), "{compression:?}");
        }
        let plain = write_png(&Picture(plane()), Transfer::Srgb, false);
        let file = with_provenance(&plain, TEXT).expect("it is a PNG").concat();
        assert_eq!((read_provenance(&plain), read_provenance(&file)), (None, Some(TEXT)));
        assert_eq!(without_provenance(file.clone()).as_ref(), Some(&plain));
        assert_eq!(without_provenance(plain.clone()).as_ref(), Some(&plain));
        let read = |bytes: &[u8]| {
            read_photo(NamedBytes::new("a.png", bytes), Transfer::Srgb)
                .expect("it is sound")
                .picture
        };
        assert_eq!(read(&file).0, read(&plain).0);
    }

    #[test]
    fn files_that_are_cut_or_something_else_have_none() {
        let mut layers = ExrLayers::new(37, 41);
        layers.rgb("", &plane());
        let exr = layers.write(Compression::Zip).expect("it can be written");
        let png = write_png(&Picture(plane()), Transfer::Srgb, false);
        for plain in [exr, png] {
            let file = with_provenance(&plain, TEXT).expect("it is a picture").concat();
            for cut in 0..plain.len().min(400) {
                let _ = (read_provenance(&file[..cut]), with_provenance(&file[..cut], TEXT));
                let _ = with_provenance(&plain[..cut], TEXT);
                let _ = without_provenance(file[..cut].to_vec());
            }
        }
        for other in [&b""[..], b"\xff\xd8\xff", b"relight"] {
            assert!(with_provenance(other, TEXT).is_none() && read_provenance(other).is_none());
            assert!(without_provenance(other.to_vec()).is_none());
        }
    }
}
