//! Typed planes, their files, and colour.

mod annotate;
mod coat;
mod depth;
mod distance;
mod exr_read;
mod exr_write;
mod fill;
mod finish;
mod grid_cut;
mod grow;
mod layer;
mod matte;
mod measure;
mod mix;
mod npy;
mod pack;
mod parts;
mod plane;
mod png_write;
mod read;
mod reflectance;
mod resample;
mod segments;
mod texture;
mod transfer;
mod upsample;

pub use annotate::annotate;
pub use coat::{Coat, Coated, Coats, Matte, Repaint};
pub use depth::{FAR, NEAR, STEP, fill_holes, is_hole, nearness, resize_depth};
pub use distance::distance;
pub use exr_read::{ExrFile, read_layers};
pub use exr_write::{Compression, ExrLayers};
pub use fill::fill_along_surfaces;
pub use finish::{DIELECTRIC, Finish};
pub use grid_cut::grid_cut;
pub use grow::{around, grow_through};
pub use layer::{HalfLayer, Layer};
pub use matte::matte;
pub use measure::{
    PictureScore, log_error, mean_error, normal_error, pairs, scale_invariant_error, score_picture, square_error,
};
pub use mix::weighted_sum;
pub use npy::read_maps;
pub use pack::{Packed, pack};
pub use parts::parts;
pub use plane::{Bytes, Plane};
pub use png_write::{PngSamples, write_png};
pub use read::{Bits, MAX_BYTES, MAX_PIXELS, Photo, ReadError, Source, read_depth, read_mask, read_normal, read_photo};
pub use reflectance::{SATURATION, clip_level, ratio, reflected, smooth_step};
pub use resample::{fit, resize, same_aspect};
pub use segments::{Segments, Steps, retinex, segment};
pub use texture::Texture;
pub use transfer::Transfer;
pub use upsample::{Taps, Upsampler, neighbours};

use glam::Vec3;
use serde::{Deserialize, Serialize};

macro_rules! typed_plane {
    ($( $(#[$doc:meta])* $name:ident($pixel:ty) ),* $(,)?) => {$(
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        pub struct $name(pub Plane<$pixel>);
    )*};
}

typed_plane! {
    /// Diffuse albedo, linear Rec.709, in 0..1.
    Albedo(Vec3),
    /// Unit normals in camera space, facing the camera.
    Normal(Vec3),
    /// Points in camera space, metres; x right, y up, looking along -z.
    Points(Vec3),
    /// Planar z in metres, positive and finite: holes are filled before a plane becomes a `Depth`.
    Depth(f32),
    /// GGX roughness in 0..1.
    Roughness(f32),
    /// Specular level in 0..1, of which 0.08 is reflected straight back: 0.5 is a usual dielectric.
    Specular(f32),
    /// Irradiance / pi per colour channel, so that a diffuse surface shows albedo x shading.
    Shading(Vec3),
    /// A share of each pixel, in 0..1.
    Mask(f32),
    /// A picture in linear Rec.709, scene-referred, in units of the photo.
    Picture(Vec3),
}

/// One rule of a value that was read from disk: kept, or told as what was wanted.
pub fn rule(kept: bool, wanted: &str) -> Result<(), String> {
    if kept { Ok(()) } else { Err(format!("wanted {wanted}")) }
}

/// Relative luminance of linear Rec.709.
pub fn luminance(rgb: Vec3) -> f32 {
    rgb.dot(LUMINANCE)
}
/// Rec.709 luminance weights of linear red, green, blue.
pub const LUMINANCE: Vec3 = Vec3::new(0.2126, 0.7152, 0.0722);

/// Natural logarithm per channel, nothing below `least`.
pub fn log_above(least: f32, rgb: Vec3) -> Vec3 {
    let c = rgb.max(Vec3::splat(least));
    Vec3::new(c.x.ln(), c.y.ln(), c.z.ln())
}
