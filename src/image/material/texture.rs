//! Textures: pictures of which single texels are looked up, held in memory as their files store
//! them.

use ::image::metadata::Orientation;
use glam::Vec3;

use crate::image::Transfer;
use crate::image::io::exr_read;
use crate::image::io::raster::{Raster, Samples, decode_raster, image_format};
use crate::image::io::source::{FileFormat, NamedBytes, ReadError, format, not_one_of};

/// A texture in the samples of its file: one to four bytes a texel where the file has 8 bits,
/// decoded at look-up.
pub struct Texture {
    raster: Raster,
    /// Linear light of each 8-bit sRGB sample; empty for other samples.
    srgb: Vec<f32>,
}

impl std::fmt::Debug for Texture {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "Texture({} x {})", self.raster.width, self.raster.height)
    }
}

impl Texture {
    /// Reads PNG, JPEG, HDR or EXR, and returns messages for the person that are not errors.
    ///
    /// # Errors
    /// As [`crate::image::read_photo`], and when the header announces more than `most` decoded
    /// bytes.
    pub fn read(source: NamedBytes, most: u64) -> Result<(Texture, Vec<String>), ReadError> {
        let source = source.within(most);
        let mut warnings = Vec::new();
        let raster = match format(source) {
            Some(FileFormat::Exr) => {
                // The file's own channels are in memory beside the three that are kept.
                let file = exr_read::read(source.within(most / 3))?;
                warnings.extend(file.warnings.iter().cloned());
                let picture = file.colors(source)?;
                let (width, height) = picture.size();
                let samples = picture.pixels().iter().flat_map(|c| c.to_array()).collect();
                Raster {
                    width,
                    height,
                    channels: 3,
                    samples: Samples::Float(samples),
                    profile: None,
                    exif: None,
                    orientation: Orientation::NoTransforms,
                }
            }
            Some(kind @ (FileFormat::Png | FileFormat::Jpeg | FileFormat::Hdr)) => {
                decode_raster(source, image_format(kind))?
            }
            _ => return Err(not_one_of(source, "a texture: PNG, JPEG, HDR or EXR")),
        };
        if raster.is_transparent() {
            warnings
                .push("the photo is transparent in places: its alpha channel is left out".into());
        }
        if let Samples::Float(values) = &raster.samples
            && let Some(at) = values.iter().position(|v| !v.is_finite())
        {
            let pixel = at / raster.channels;
            let (x, y) = (pixel % raster.width, pixel / raster.width);
            return Err(source.error(
                "pixels",
                "finite numbers",
                format!("{} at ({x}, {y})", values[at]),
            ));
        }
        let decoded = |v: u8| Transfer::Srgb.decode(f32::from(v) / 255.0);
        let eight = matches!(raster.samples, Samples::Eight(_));
        let srgb = if eight { (0..=255).map(decoded).collect() } else { Vec::new() };
        Ok((Texture { raster, srgb }, warnings))
    }

    /// (width, height)
    pub fn size(&self) -> (usize, usize) {
        (self.raster.width, self.raster.height)
    }

    /// Memory of its samples, in bytes.
    pub fn bytes(&self) -> usize {
        match &self.raster.samples {
            Samples::Eight(values) => values.len(),
            Samples::Sixteen(values) => 2 * values.len(),
            Samples::Float(values) => 4 * values.len(),
        }
    }

    /// The texel at (x, y): as sRGB decoded to linear light, or as the file stores it. Samples of
    /// float files are linear either way.
    pub fn get(&self, x: usize, y: usize, srgb: bool) -> Vec3 {
        let channels = self.raster.channels;
        let first = (y * self.raster.width + x) * channels;
        let decode = |share: f32| if srgb { Transfer::Srgb.decode(share) } else { share };
        let sample = |i: usize| match &self.raster.samples {
            Samples::Eight(values) if srgb => self.srgb[usize::from(values[i])],
            Samples::Eight(values) => f32::from(values[i]) / 255.0,
            Samples::Sixteen(values) => decode(f32::from(values[i]) / 65535.0),
            Samples::Float(values) => values[i],
        };
        if channels < 3 {
            Vec3::splat(sample(first))
        } else {
            Vec3::from_array([0, 1, 2].map(|k| sample(first + k)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Compression, ExrLayers, Picture, Plane, read_photo, write_png};

    /// Each texel is bit for bit the pixel that a photo of the same file has.
    #[test]
    fn texels_are_the_pixels_of_a_photo() {
        let plane = Plane::from_fn(9, 7, |x, y| {
            Vec3::new(0.1 * x as f32, 0.13 * y as f32, 0.011 * (x * y) as f32)
        });
        let mut files = vec![
            write_png(&Picture(plane.clone()), Transfer::Srgb, false),
            write_png(&Picture(plane.clone()), Transfer::Srgb, true),
        ];
        for image in [
            image::DynamicImage::ImageLuma8(image::GrayImage::from_fn(5, 4, |x, y| {
                image::Luma([(40 * x + y) as u8])
            })),
            image::DynamicImage::ImageRgba8(image::RgbaImage::from_fn(5, 4, |x, y| {
                image::Rgba([(40 * x) as u8, (50 * y) as u8, 200, (x * y) as u8])
            })),
        ] {
            let mut bytes = std::io::Cursor::new(Vec::new());
            image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
            files.push(bytes.into_inner());
        }
        for bytes in &files {
            let source = NamedBytes::new("a.png", bytes);
            let (texture, warnings) = Texture::read(source, 1 << 20).unwrap();
            for (srgb, transfer) in [(true, Transfer::Srgb), (false, Transfer::Linear)] {
                let photo = read_photo(source, transfer).unwrap();
                assert_eq!(warnings, photo.warnings);
                let (w, h) = photo.picture.0.size();
                assert_eq!(texture.size(), (w, h));
                for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
                    assert_eq!(
                        texture.get(x, y, srgb),
                        photo.picture.0.get(x, y),
                        "{srgb} ({x}, {y})"
                    );
                }
            }
        }
    }

    #[test]
    fn float_files_are_linear_either_way() {
        let plane = Plane::from_fn(6, 5, |x, y| Vec3::new(x as f32, 0.5 * y as f32, 3.0));
        let mut file = ExrLayers::new(6, 5);
        file.float_rgb("", &plane);
        let bytes = file.write(Compression::Zip).unwrap();
        let (texture, _) = Texture::read(NamedBytes::new("a.exr", &bytes), 1 << 20).unwrap();
        assert_eq!(texture.get(4, 2, true), plane.get(4, 2));
        assert_eq!(texture.get(4, 2, false), plane.get(4, 2));
    }

    #[test]
    fn a_texture_beyond_its_room_is_refused_by_its_header() {
        let bytes = write_png(&Picture(Plane::filled(64, 32, Vec3::ONE)), Transfer::Srgb, false);
        let (texture, _) = Texture::read(NamedBytes::new("a.png", &bytes), 64 * 32 * 3).unwrap();
        assert_eq!(texture.bytes(), 64 * 32 * 3);
        let message = Texture::read(NamedBytes::new("a.png", &bytes[..60]), 64 * 32 * 3 - 1)
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("size in the header") && message.contains("64 x 32 at 3 bytes"),
            "{message}"
        );
    }
}
