//! Typed planes, their files, and colour.

mod plane;
mod segments;

pub use plane::Plane;
pub use segments::{Segments, Steps, retinex, segment};

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
    /// Irradiance / pi per colour channel, so that a diffuse surface shows albedo x shading.
    Shading(Vec3),
    /// A share of each pixel, in 0..1.
    Mask(f32),
    /// A picture in linear Rec.709, scene-referred, in units of the photo.
    Picture(Vec3),
}

/// How a photo's numbers encode linear light.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Transfer {
    /// IEC 61966-2-1.
    Srgb,
    /// value = linear^(1/gamma).
    Gamma(f32),
    /// The numbers are linear already (EXR, HDR).
    Linear,
}

/// Relative luminance of linear Rec.709.
pub fn luminance(rgb: Vec3) -> f32 {
    rgb.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}
