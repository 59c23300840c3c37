//! PNG, JPEG, WebP and Radiance HDR files as interleaved samples.

use std::io::Cursor;

use ::image::metadata::Orientation;
use ::image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use glam::Vec3;

use super::color_profile::ToRec709;
use super::source::{FileFormat, MAX_BYTES, NamedBytes, ReadError};
use crate::image::Plane;

/// The precision of a file's samples; it decides the rule of saturation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bits {
    /// Integers 0..=255.
    Eight,
    /// Integers 0..=65535.
    Sixteen,
    /// Floating-point numbers.
    Float,
}

/// Stored samples of PNG, JPEG, WebP and HDR, interleaved.
pub(in crate::image) enum Samples {
    Eight(Vec<u8>),
    Sixteen(Vec<u16>),
    Float(Vec<f32>),
}

pub(in crate::image) struct Raster {
    pub(in crate::image) width: usize,
    pub(in crate::image) height: usize,
    /// 1 gray, 2 gray and alpha, 3 color, 4 color and alpha.
    pub(in crate::image) channels: usize,
    pub(in crate::image) samples: Samples,
    /// The ICC profile as it lies in the file.
    pub(in crate::image) profile: Option<Vec<u8>>,
    /// The EXIF block as it lies in the file.
    pub(in crate::image) exif: Option<Vec<u8>>,
    /// The EXIF orientation, which is applied.
    pub(in crate::image) orientation: Orientation,
}

/// Whether an orientation exchanges columns and rows.
pub(in crate::image) fn is_turned(orientation: Orientation) -> bool {
    matches!(
        orientation,
        Orientation::Rotate90
            | Orientation::Rotate270
            | Orientation::Rotate90FlipH
            | Orientation::Rotate270FlipH
    )
}

impl Raster {
    /// Returns the precision of the samples.
    pub(in crate::image) fn bits(&self) -> Bits {
        match self.samples {
            Samples::Eight(_) => Bits::Eight,
            Samples::Sixteen(_) => Bits::Sixteen,
            Samples::Float(_) => Bits::Float,
        }
    }

    /// Hands each pixel's color and alpha to `take`, row by row: the color with each sample
    /// through `f`, which sees integers as shares of their maximum; alpha as it is stored, 1 where
    /// there is none. Gray becomes a color.
    pub(in crate::image) fn each(&self, f: impl Fn(f32) -> f32, take: impl FnMut(Vec3, f32)) {
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
        color: impl Fn(S) -> f32,
        alpha: impl Fn(S) -> f32,
        mut take: impl FnMut(Vec3, f32),
    ) {
        for p in values.chunks_exact(self.channels) {
            let rgb = if self.channels < 3 { [p[0]; 3] } else { [p[0], p[1], p[2]] };
            let alpha =
                if self.channels.is_multiple_of(2) { alpha(p[self.channels - 1]) } else { 1.0 };
            take(Vec3::from_array(rgb.map(&color)), alpha);
        }
    }

    /// A pixel has an alpha below the largest.
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

    /// The colors with each sample through `f`.
    pub(in crate::image) fn colors(&self, f: impl Fn(f32) -> f32) -> Plane<Vec3> {
        let mut colors = Vec::with_capacity(self.width * self.height);
        self.each(f, |color, _| colors.push(color));
        Plane::new(self.width, self.height, colors)
    }

    /// The colors in linear light of the photo's own channels by the curves of its profile; the
    /// samples are whole numbers.
    pub(in crate::image) fn linear(&self, profile: &ToRec709) -> Plane<Vec3> {
        let top = if self.bits() == Bits::Eight { 255 } else { 65535 };
        let tables = profile.tables(top);
        let mut colors = Vec::with_capacity(self.width * self.height);
        self.each(
            |v| v,
            |color, _| {
                let at = |channel: usize| {
                    tables[channel][((color[channel] * top as f32).round() as usize).min(top)]
                };
                colors.push(Vec3::new(at(0), at(1), at(2)));
            },
        );
        Plane::new(self.width, self.height, colors)
    }

    /// A number per pixel of its stored color and alpha.
    pub(in crate::image) fn numbers(&self, f: impl Fn(Vec3, f32) -> f32) -> Plane<f32> {
        let mut numbers = Plane::filled(self.width, self.height, 0.0);
        let mut pixels = numbers.pixels_mut().iter_mut();
        self.each(
            |v| v,
            |color, alpha| {
                let (number, pixel) = (f(color, alpha), pixels.next());
                // Memory is taken where something is written only.
                if let (true, Some(pixel)) = (number != 0.0, pixel) {
                    *pixel = number;
                }
            },
        );
        numbers
    }
}

/// Decodes a PNG, JPEG, WebP or HDR file.
///
/// # Errors
/// The content is not a valid file of `format`, or exceeds the limits of `source`.
pub(in crate::image) fn decode_raster(
    source: NamedBytes,
    format: ImageFormat,
) -> Result<Raster, ReadError> {
    decode_turned(source, format, None)
}

/// Decodes a file like [`decode_raster`], with this orientation in place of its own.
///
/// # Errors
/// Those of [`decode_raster`].
pub(in crate::image) fn decode_turned(
    source: NamedBytes,
    format: ImageFormat,
    orientation: Option<Orientation>,
) -> Result<Raster, ReadError> {
    let bad = |e: ::image::ImageError| {
        let name = format!("{format:?}").to_uppercase();
        source.error("content", format!("a whole {name} file"), e)
    };
    let mut limits = Limits::default();
    // Beside the pixels, room for tables and metadata.
    limits.max_alloc = Some(source.most.saturating_add(16 << 20).min(MAX_BYTES));
    let mut reader = ImageReader::with_format(Cursor::new(source.bytes), format);
    reader.limits(limits);
    let mut decoder = reader.into_decoder().map_err(bad)?;
    // Sound pixels are kept beside damaged metadata.
    let own = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    let orientation = orientation.unwrap_or(own);
    let profile = decoder.icc_profile().ok().flatten();
    let exif = decoder.exif_metadata().ok().flatten();
    let (width, height) = decoder.dimensions();
    let color = decoder.color_type();
    source.check_size(width.into(), height.into(), color.bytes_per_pixel().into())?;
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
        _ => {
            return Err(source.error(
                "pixels",
                "gray or RGB, 8 or 16 bits or float",
                format!("{color:?}"),
            ));
        }
    };
    let channels = usize::from(color.channel_count());
    Ok(Raster { width, height, channels, samples, profile, exif, orientation })
}

/// Returns the decoder's name of a format.
///
/// # Panics
/// The `image` crate does not decode the format.
pub(in crate::image) fn image_format(format: FileFormat) -> ImageFormat {
    match format {
        FileFormat::Png => ImageFormat::Png,
        FileFormat::Jpeg => ImageFormat::Jpeg,
        FileFormat::Webp => ImageFormat::WebP,
        FileFormat::Hdr => ImageFormat::Hdr,
        _ => unreachable!("read by its own module"),
    }
}
