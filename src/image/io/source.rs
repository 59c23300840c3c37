//! Bytes of picture files, their formats and their limits. Content determines a format, never a
//! name.
//!
//! Nothing here trusts a file: sizes are read and held against [`MAX_PIXELS`], [`MAX_BYTES`] and
//! the length of the file before anything is allocated for them.

/// The largest picture that is read: 64 megapixels.
pub const MAX_PIXELS: u64 = 64 << 20;
/// The largest decoded size, all channels of the file together: 1 GiB.
pub const MAX_BYTES: u64 = 1 << 30;
/// No format here can hold more pixels in a byte: deflate packs 1032 bytes into one, PNG eight
/// pixels into a byte.
const MAX_PIXELS_PER_BYTE: u64 = 8 * 1032;

/// Why a picture file cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {what}: wanted {wanted}, got {got}")]
pub struct ReadError {
    /// The file, as its caller named it.
    pub file: String,
    /// The part or property at fault.
    pub what: String,
    /// The rule.
    pub wanted: String,
    /// The content of the file.
    pub got: String,
}

impl ReadError {
    /// The error without the file's name.
    pub fn message(&self) -> String {
        format!("{}: wanted {}, got {}", self.what, self.wanted, self.got)
    }
}

/// The bytes of a file and the name it has in messages.
#[derive(Clone, Copy)]
pub struct NamedBytes<'a> {
    /// The name in messages.
    pub name: &'a str,
    /// The whole file.
    pub bytes: &'a [u8],
    /// Most bytes of all channels together, decoded.
    pub(in crate::image) most: u64,
}

impl<'a> NamedBytes<'a> {
    /// A file, of which at most [`MAX_BYTES`] decoded bytes are read.
    pub fn new(name: &'a str, bytes: &'a [u8]) -> NamedBytes<'a> {
        NamedBytes { name, bytes, most: MAX_BYTES }
    }

    /// The same file, of which at most `most` decoded bytes are read.
    pub(in crate::image) fn within(self, most: u64) -> NamedBytes<'a> {
        NamedBytes { most: most.min(self.most), ..self }
    }

    /// Creates an error about the part `what` of this file.
    pub(in crate::image) fn error(
        &self,
        what: &str,
        wanted: impl ToString,
        got: impl ToString,
    ) -> ReadError {
        ReadError {
            file: self.name.into(),
            what: what.into(),
            wanted: wanted.to_string(),
            got: got.to_string(),
        }
    }

    /// Holds a size from a header against the caps, before anything is allocated for it.
    ///
    /// # Errors
    /// The size is zero or exceeds a limit.
    pub(in crate::image) fn check_size(
        &self,
        width: u64,
        height: u64,
        bytes_per_pixel: u64,
    ) -> Result<(), ReadError> {
        let pixels = width.saturating_mul(height);
        let got = format!("{width} x {height} at {bytes_per_pixel} bytes a pixel");
        if pixels == 0 {
            return Err(self.error("size in the header", "at least one pixel", got));
        }
        if pixels > MAX_PIXELS || pixels.saturating_mul(bytes_per_pixel) > self.most {
            let wanted =
                format!("at most {} megapixels and {} MiB", MAX_PIXELS >> 20, self.most >> 20);
            return Err(self.error("size in the header", wanted, got));
        }
        if pixels > MAX_PIXELS_PER_BYTE * self.bytes.len() as u64 {
            let wanted =
                format!("no more pixels than a file of {} bytes can hold", self.bytes.len());
            return Err(self.error("size in the header", wanted, got));
        }
        Ok(())
    }
}

/// A file format; the first bytes determine it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::image) enum FileFormat {
    Png,
    Jpeg,
    Webp,
    Hdr,
    Exr,
    Npy,
    Npz,
    Pfm,
    Tiff,
    /// HEIC, HEIF or AVIF, where the program reads them.
    #[cfg(feature = "heic")]
    Heif,
}

/// Returns the format that the first bytes determine, if it is known.
pub(in crate::image) fn format(source: NamedBytes) -> Option<FileFormat> {
    const SIGNATURES: [(&[u8], FileFormat); 12] = [
        (b"\x89PNG\r\n\x1a\n", FileFormat::Png),
        (b"\xff\xd8\xff", FileFormat::Jpeg),
        (b"#?", FileFormat::Hdr),
        (b"\x76\x2f\x31\x01", FileFormat::Exr),
        (b"\x93NUMPY", FileFormat::Npy),
        (b"PK\x03\x04", FileFormat::Npz),
        (b"Pf\n", FileFormat::Pfm),
        (b"PF\n", FileFormat::Pfm),
        (b"Pf\r", FileFormat::Pfm),
        (b"Pf ", FileFormat::Pfm),
        (b"II*\0", FileFormat::Tiff),
        (b"MM\0*", FileFormat::Tiff),
    ];
    if source.bytes.starts_with(b"RIFF") && source.bytes.get(8..12) == Some(b"WEBP") {
        return Some(FileFormat::Webp);
    }
    #[cfg(feature = "heic")]
    if OTHERS.iter().any(|(name, .., at, signature)| {
        matches!(*name, "HEIC" | "HEIF" | "AVIF")
            && source.bytes.get(*at..).is_some_and(|bytes| bytes.starts_with(signature))
    }) {
        return Some(FileFormat::Heif);
    }
    SIGNATURES.iter().find(|(start, _)| source.bytes.starts_with(start)).map(|&(_, format)| format)
}

/// Formats that are known and not read: name, remedy, offset and bytes of the signature.
const OTHERS: [(&str, &str, usize, &[u8]); 16] = [
    ("HEIC", HEIC, 4, b"ftypheic"),
    ("HEIC", HEIC, 4, b"ftypheix"),
    ("HEIC", HEIC, 4, b"ftyphevc"),
    ("HEIC", HEIC, 4, b"ftypheim"),
    ("HEIC", HEIC, 4, b"ftypheis"),
    ("HEIF", HEIC, 4, b"ftypmif1"),
    ("AVIF", "convert it with `avifdec photo.avif photo.png`", 4, b"ftypavif"),
    ("AVIF", "convert it with `avifdec photo.avif photo.png`", 4, b"ftypavis"),
    ("JPEG XL", "convert it with `djxl photo.jxl photo.png`", 0, b"\xff\x0a"),
    ("JPEG XL", "convert it with `djxl photo.jxl photo.png`", 0, b"\x00\x00\x00\x0cJXL "),
    ("TIFF or a raw photo", RAW, 0, b"II*\0"),
    ("TIFF or a raw photo", RAW, 0, b"MM\0*"),
    ("GIF", "save it as PNG", 0, b"GIF8"),
    ("BMP", "save it as PNG", 0, b"BM"),
    ("a ZIP archive, such as NPZ", "unpack it first", 0, b"PK\x03\x04"),
    ("PDF", "save the picture in it as PNG", 0, b"%PDF"),
];
const HEIC: &str = "convert it with `heif-convert -q 95 photo.heic photo.jpg` (libheif), or on macOS \
    `sips -s format jpeg photo.heic --out photo.jpg`; a program built with `--features heic` reads it";
const RAW: &str =
    "develop or convert it to a PNG of 16 bits, as with `magick photo.tif -depth 16 photo.png`";

/// Creates the error of a file in another format than `wanted`.
pub(in crate::image) fn not_one_of(source: NamedBytes, wanted: &str) -> ReadError {
    let is_at = |at: usize, signature: &[u8]| {
        source.bytes.get(at..).is_some_and(|bytes| bytes.starts_with(signature))
    };
    let other = OTHERS.iter().find(|(.., at, signature)| is_at(*at, signature));
    let got = match (format(source), other) {
        #[cfg(feature = "heic")]
        (Some(FileFormat::Heif), Some((name, remedy, ..))) => format!("{name}: {remedy}"),
        (None | Some(FileFormat::Tiff), Some((name, remedy, ..))) => format!("{name}: {remedy}"),
        (Some(format), _) => format!("{format:?}"),
        (None, None) if source.bytes.is_empty() => "an empty file".into(),
        (None, None) => {
            let first = &source.bytes[..source.bytes.len().min(8)];
            match std::str::from_utf8(first) {
                Ok(text) if !text.contains(char::is_control) => {
                    format!("a text that begins with {text:?}")
                }
                _ => format!("an unknown format that begins with the bytes {first:02x?}"),
            }
        }
    };
    source.error("file format", wanted, got)
}
