//! Pictures from bytes: PNG, JPEG, Radiance HDR, OpenEXR, NPY. Formats are told by content, never by name.
//!
//! Nothing here trusts a file: sizes are read and held against [`MAX_PIXELS`], [`MAX_BYTES`] and the length of the file
//! before anything is allocated for them.

use std::io::Cursor;

use ::image::metadata::Orientation;
use ::image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use glam::Vec3;

use {
    super::exr_read, super::npy, crate::image::Mask, crate::image::Picture, crate::image::Plane, crate::image::Transfer,
};

/// The largest picture that is read: 64 megapixels.
pub const MAX_PIXELS: u64 = 64 << 20;
/// The largest decoded size, all channels of the file together: 1 GiB.
pub const MAX_BYTES: u64 = 1 << 30;
/// No format here can hold more pixels in a byte: deflate packs 1032 bytes into one, PNG eight pixels into a byte.
const MAX_PIXELS_PER_BYTE: u64 = 8 * 1032;

/// Why a picture file cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {what}: wanted {wanted}, got {got}")]
pub struct ReadError {
    /// The file, as its caller named it.
    pub file: String,
    /// The part or property at fault.
    pub what: String,
    pub wanted: String,
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
pub struct Source<'a> {
    pub name: &'a str,
    pub bytes: &'a [u8],
    /// Most bytes of all channels together, decoded.
    pub(in crate::image) most: u64,
}

impl<'a> Source<'a> {
    pub fn new(name: &'a str, bytes: &'a [u8]) -> Source<'a> {
        Source { name, bytes, most: MAX_BYTES }
    }

    /// The same file, of which at most `most` decoded bytes are read.
    pub(in crate::image) fn within(self, most: u64) -> Source<'a> {
        Source { most: most.min(self.most), ..self }
    }

    pub(in crate::image) fn error(&self, what: &str, wanted: impl ToString, got: impl ToString) -> ReadError {
        ReadError { file: self.name.into(), what: what.into(), wanted: wanted.to_string(), got: got.to_string() }
    }

    /// Holds a size from a header against the caps, before anything is allocated for it.
    pub(in crate::image) fn check_size(&self, width: u64, height: u64, bytes_per_pixel: u64) -> Result<(), ReadError> {
        let pixels = width.saturating_mul(height);
        let got = format!("{width} x {height} at {bytes_per_pixel} bytes a pixel");
        if pixels == 0 {
            return Err(self.error("size in the header", "at least one pixel", got));
        }
        if pixels > MAX_PIXELS || pixels.saturating_mul(bytes_per_pixel) > self.most {
            let wanted = format!("at most {} megapixels and {} MiB", MAX_PIXELS >> 20, self.most >> 20);
            return Err(self.error("size in the header", wanted, got));
        }
        if pixels > MAX_PIXELS_PER_BYTE * self.bytes.len() as u64 {
            let wanted = format!("no more pixels than a file of {} bytes can hold", self.bytes.len());
            return Err(self.error("size in the header", wanted, got));
        }
        Ok(())
    }
}

/// A file format, told by its first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::image) enum Format {
    Png,
    Jpeg,
    Hdr,
    Exr,
    Npy,
}

pub(in crate::image) fn format(source: Source) -> Option<Format> {
    const SIGNATURES: [(&[u8], Format); 5] = [
        (b"\x89PNG\r\n\x1a\n", Format::Png),
        (b"\xff\xd8\xff", Format::Jpeg),
        (b"#?", Format::Hdr),
        (b"\x76\x2f\x31\x01", Format::Exr),
        (b"\x93NUMPY", Format::Npy),
    ];
    SIGNATURES.iter().find(|(start, _)| source.bytes.starts_with(start)).map(|&(_, format)| format)
}

pub(in crate::image) fn not_one_of(source: Source, wanted: &str) -> ReadError {
    let got = match format(source) {
        Some(format) => format!("{format:?}"),
        None if source.bytes.is_empty() => "an empty file".into(),
        None => format!("an unknown format (first bytes {:02x?})", &source.bytes[..source.bytes.len().min(8)]),
    };
    source.error("file format", wanted, got)
}

/// How finely a file stores a sample; decides the rule of saturation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bits {
    Eight,
    Sixteen,
    Float,
}

/// A photo as it was read.
#[derive(Clone, Debug)]
pub struct Photo {
    /// Linear Rec.709, the photo's own size.
    pub picture: Picture,
    /// 1 where a channel is saturated, else 0.
    pub clipped: Mask,
    pub bits: Bits,
    /// What the person should know although it is no error.
    pub warnings: Vec<String>,
}

/// Stored samples of PNG, JPEG and HDR, interleaved.
pub(in crate::image) enum Samples {
    Eight(Vec<u8>),
    Sixteen(Vec<u16>),
    Float(Vec<f32>),
}

pub(in crate::image) struct Raster {
    pub(in crate::image) width: usize,
    pub(in crate::image) height: usize,
    /// 1 grey, 2 grey and alpha, 3 colour, 4 colour and alpha.
    pub(in crate::image) channels: usize,
    pub(in crate::image) samples: Samples,
}

impl Raster {
    fn bits(&self) -> Bits {
        match self.samples {
            Samples::Eight(_) => Bits::Eight,
            Samples::Sixteen(_) => Bits::Sixteen,
            Samples::Float(_) => Bits::Float,
        }
    }

    /// Hands each pixel's colour and alpha to `take`, row by row: the colour with each sample through `f`, which sees integers as
    /// shares of their maximum; alpha as it is stored, 1 where there is none. Grey becomes a colour.
    fn each(&self, f: impl Fn(f32) -> f32, take: impl FnMut(Vec3, f32)) {
        let table = |top: u32| (0..=top).map(|v| f(v as f32 / top as f32)).collect::<Vec<f32>>();
        match &self.samples {
            Samples::Eight(values) => {
                let table = table(255);
                self.pixels(values, |v| table[usize::from(v)], |v| f32::from(v) / 255.0, take);
            }
            Samples::Sixteen(values) => {
                let table = table(65535);
                self.pixels(values, |v| table[usize::from(v)], |v| f32::from(v) / 65535.0, take);
            }
            Samples::Float(values) => self.pixels(values, f, |v| v, take),
        }
    }

    fn pixels<S: Copy>(
        &self,
        values: &[S],
        colour: impl Fn(S) -> f32,
        alpha: impl Fn(S) -> f32,
        mut take: impl FnMut(Vec3, f32),
    ) {
        for p in values.chunks_exact(self.channels) {
            let rgb = if self.channels < 3 { [p[0]; 3] } else { [p[0], p[1], p[2]] };
            let alpha = if self.channels.is_multiple_of(2) { alpha(p[self.channels - 1]) } else { 1.0 };
            take(Vec3::from_array(rgb.map(&colour)), alpha);
        }
    }

    /// Whether a pixel has an alpha below the greatest.
    pub(in crate::image) fn is_transparent(&self) -> bool {
        let channels = self.channels;
        let any = |below: &dyn Fn(usize) -> bool| {
            channels.is_multiple_of(2)
                && (channels - 1..self.width * self.height * channels).step_by(channels).any(below)
        };
        match &self.samples {
            Samples::Eight(values) => any(&|i| values[i] < u8::MAX),
            Samples::Sixteen(values) => any(&|i| values[i] < u16::MAX),
            Samples::Float(values) => any(&|i| values[i] < 1.0),
        }
    }

    /// The colours with each sample through `f`.
    fn colours(&self, f: impl Fn(f32) -> f32) -> Plane<Vec3> {
        let mut colours = Vec::with_capacity(self.width * self.height);
        self.each(f, |colour, _| colours.push(colour));
        Plane::new(self.width, self.height, colours)
    }

    /// A number per pixel of its stored colour and alpha.
    fn numbers(&self, f: impl Fn(Vec3, f32) -> f32) -> Plane<f32> {
        let mut numbers = Plane::filled(self.width, self.height, 0.0);
        let mut pixels = numbers.pixels_mut().iter_mut();
        self.each(
            |v| v,
            |colour, alpha| {
                let (number, pixel) = (f(colour, alpha), pixels.next());
                // Memory is taken where something is written only.
                if let (true, Some(pixel)) = (number != 0.0, pixel) {
                    *pixel = number;
                }
            },
        );
        numbers
    }
}

pub(in crate::image) fn decode_raster(source: Source, format: ImageFormat) -> Result<Raster, ReadError> {
    let bad = |e: ::image::ImageError| source.error("content", format!("a sound {format:?} file"), e);
    let mut limits = Limits::default();
    // Beside the pixels, room for tables and metadata.
    limits.max_alloc = Some(source.most.saturating_add(16 << 20).min(MAX_BYTES));
    let mut reader = ImageReader::with_format(Cursor::new(source.bytes), format);
    reader.limits(limits);
    let mut decoder = reader.into_decoder().map_err(bad)?;
    // Damaged metadata is no reason to refuse sound pixels.
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    let (width, height) = decoder.dimensions();
    let colour = decoder.color_type();
    source.check_size(width.into(), height.into(), colour.bytes_per_pixel().into())?;
    let mut image = DynamicImage::from_decoder(decoder).map_err(bad)?;
    image.apply_orientation(orientation);
    let (width, height) = (image.width() as usize, image.height() as usize);
    let samples = match image {
        DynamicImage::ImageLuma8(_)
        | DynamicImage::ImageLumaA8(_)
        | DynamicImage::ImageRgb8(_)
        | DynamicImage::ImageRgba8(_) => Samples::Eight(image.into_bytes()),
        DynamicImage::ImageLuma16(image) => Samples::Sixteen(image.into_raw()),
        DynamicImage::ImageLumaA16(image) => Samples::Sixteen(image.into_raw()),
        DynamicImage::ImageRgb16(image) => Samples::Sixteen(image.into_raw()),
        DynamicImage::ImageRgba16(image) => Samples::Sixteen(image.into_raw()),
        DynamicImage::ImageRgb32F(image) => Samples::Float(image.into_raw()),
        DynamicImage::ImageRgba32F(image) => Samples::Float(image.into_raw()),
        _ => return Err(source.error("pixels", "grey or RGB, 8 or 16 bits or float", format!("{colour:?}"))),
    };
    let channels = usize::from(colour.channel_count());
    Ok(Raster { width, height, channels, samples })
}

/// Reads a photo: PNG (8 or 16 bits, grey, RGB, palette; alpha is left out with a warning), JPEG, HDR, EXR (R, G, B, or
/// Y, or R alone). A photo that carries an EXIF orientation is turned upright. HDR and EXR are linear by their format; `transfer` applies to the others.
///
/// A pixel is saturated when one of its channels is: 254 or 255 of 255; 65535 of 65535; in a float file, within 0.1 % of
/// the file's maximum, if that maximum is a plateau: at least 16 pixels, at least 0.01 % and at most half of all.
/// Non-finite numbers are an error.
pub fn read_photo(source: Source, transfer: Transfer) -> Result<Photo, ReadError> {
    let mut warnings = Vec::new();
    let (picture, clipped, bits) = match format(source) {
        Some(Format::Exr) => {
            let file = exr_read::read(source)?;
            warnings.extend(file.warnings.iter().cloned());
            let picture = file.colours(source)?;
            let clipped = plateau(&picture);
            (picture, clipped, Bits::Float)
        }
        Some(kind @ (Format::Png | Format::Jpeg | Format::Hdr)) => {
            let raster = decode_raster(source, image_format(kind))?;
            let bits = raster.bits();
            if raster.is_transparent() {
                warnings.push("the photo is transparent in places: its alpha channel is left out".into());
            }
            match bits {
                Bits::Float => {
                    let picture = raster.colours(|v| v);
                    let clipped = plateau(&picture);
                    (picture, clipped, bits)
                }
                Bits::Eight | Bits::Sixteen => {
                    let top = if bits == Bits::Eight { 253.5 / 255.0 } else { 65534.5 / 65535.0 };
                    let clipped = raster.numbers(|c, _| if c.max_element() > top { 1.0 } else { 0.0 });
                    (raster.colours(|v| transfer.decode(v)), clipped, bits)
                }
            }
        }
        _ => return Err(not_one_of(source, "a photo: PNG, JPEG, HDR or EXR")),
    };
    if let Some(at) = picture.pixels().iter().position(|c| !c.is_finite()) {
        let (x, y) = (at % picture.width(), at / picture.width());
        return Err(source.error("pixels", "finite numbers", format!("{} at ({x}, {y})", picture.get(x, y))));
    }
    Ok(Photo { picture: Picture(picture), clipped: Mask(clipped), bits, warnings })
}

/// Reads depth as stored, without scale: EXR (channel Z, else Y, else R), 16-bit grey PNG, NPY. 0, negative and
/// non-finite numbers are passed on.
pub fn read_depth(source: Source) -> Result<(Plane<f32>, Vec<String>), ReadError> {
    const WANTED: &str = "depth: EXR, 16-bit grey PNG or NPY";
    match format(source) {
        Some(Format::Exr) => {
            let file = exr_read::read(source)?;
            Ok((file.depth(source)?, file.warnings))
        }
        Some(Format::Npy) => Ok((npy::read(source)?, Vec::new())),
        Some(Format::Png) => {
            let raster = decode_raster(source, ImageFormat::Png)?;
            match &raster.samples {
                Samples::Sixteen(values) if raster.channels == 1 => {
                    let data = values.iter().map(|&v| f32::from(v)).collect();
                    Ok((Plane::new(raster.width, raster.height, data), Vec::new()))
                }
                _ => {
                    let got = format!("{:?} bits, {} channels", raster.bits(), raster.channels);
                    Err(source.error("pixels of a depth PNG", "16 bits, one grey channel", got))
                }
            }
        }
        _ => Err(not_one_of(source, WANTED)),
    }
}

/// Reads directions: EXR with channels X, Y, Z, else R, G, B, of any length. Non-finite numbers become zero.
pub fn read_normal(source: Source) -> Result<Plane<Vec3>, ReadError> {
    match format(source) {
        Some(Format::Exr) => {
            let vectors = exr_read::read(source)?.vectors(source)?;
            Ok(vectors.map(|v| if v.is_finite() { v } else { Vec3::ZERO }))
        }
        _ => Err(not_one_of(source, "normals: EXR")),
    }
}

/// Reads a mask: PNG, JPEG or EXR of any bit depth. The value is the share of the pixel that is covered: the Rec.709
/// luminance of the stored numbers times alpha, in 0..1; below 1/16 it is 0 and above 15/16 it is 1, so that the ringing of a
/// JPEG does not leak.
pub fn read_mask(source: Source) -> Result<Mask, ReadError> {
    let share = |c: Vec3, alpha: f32| match c.dot(crate::image::LUMINANCE) * alpha {
        m if m > 15.0 / 16.0 => 1.0,
        m if m >= 1.0 / 16.0 => m,
        _ => 0.0,
    };
    match format(source) {
        Some(Format::Exr) => Ok(Mask(exr_read::read(source)?.colours(source)?.map(|c| share(c, 1.0)))),
        Some(kind @ (Format::Png | Format::Jpeg)) => {
            Ok(Mask(decode_raster(source, image_format(kind))?.numbers(share)))
        }
        _ => Err(not_one_of(source, "a mask: PNG, JPEG or EXR")),
    }
}

pub(in crate::image) fn image_format(format: Format) -> ImageFormat {
    match format {
        Format::Png => ImageFormat::Png,
        Format::Jpeg => ImageFormat::Jpeg,
        Format::Hdr => ImageFormat::Hdr,
        Format::Exr | Format::Npy => unreachable!("read by its own module"),
    }
}

/// Saturation of a float file; see [`read_photo`].
fn plateau(picture: &Plane<Vec3>) -> Plane<f32> {
    let top = picture.pixels().iter().map(|c| c.max_element()).fold(0.0, f32::max);
    let clipped = picture.map(|c| if top > 0.0 && c.max_element() >= 0.999 * top { 1.0 } else { 0.0 });
    let count = clipped.pixels().iter().filter(|&&m| m > 0.0).count();
    if count >= 16.max(picture.len() / 10_000) && count <= picture.len() / 2 { clipped } else { clipped.map(|_| 0.0) }
}
