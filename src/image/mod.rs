//! Typed planes, their files, and color.

mod io;
mod layer;
mod material;
mod ops;
mod plane;
mod transfer;

pub use io::{
    Bits, CONFIDENCE, Compression, DepthFile, ExrFile, ExrLayers, Intrinsics, Lens, MAX_BYTES,
    MAX_PIXELS, MAX_PROVENANCE, Measure, NamedBytes, Photo, PhotoHeader, PngSamples, ReadError,
    carried_exif, polycam, read_channels, read_depth, read_depth_file, read_layers, read_maps,
    read_mask, read_normal, read_photo, read_photo_header, read_provenance, record3d,
    stray_scanner, turned_photo, with_provenance, without_provenance, write_png,
};
pub use layer::{HalfBand, HalfLayer, Layer, first_not_finite};
pub use material::{
    AlphaMatte, Gloss, PaintChange, PaintLayer, PaintLayers, PaintedPixel, SPECULAR_EDIT,
    SpecularEdit, Texture,
};
pub use ops::{
    DEPTH_PLANE, DarkNoise, GlareMask, GlarePixel, Grain, LampLight, LightMask, OwnPixel, Packed,
    PictureScore, PixelLight, PlaneBundle, REFLECTANCE, RELIT_PIXEL, Resized, SaturatedRegions,
    SaturationScore, Segments, Steps, SurfacePixel, Taps, Upsampler, alpha_matte, annotate,
    bright_level, clip_level, clip_line, connected_components, dilate, distance, draw_line, fit,
    gain, geodesic_dilate, glare_of, graph_cut, guided_depth, inpaint, inpaint_depth,
    inpaint_surfaces, is_hole, limited, log_error, mean_error, nearness, neighbors, normal_error,
    pack, pack_gray, pairs, ratio, refine_mask, reflected, relight_own, relight_physical,
    relight_ratio, resize, resize_depth, retinex, same_aspect, scale_invariant_error,
    score_picture, score_saturation, segment, smooth_step, square_error, text_size, weighted_hue,
    weighted_sum, write_text,
};
pub use plane::{Bytes, Plane};
pub use transfer::Transfer;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::tuning::Table;

macro_rules! typed_plane {
    ($( $(#[$doc:meta])* $name:ident($pixel:ty) ),* $(,)?) => {$(
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        pub struct $name(
            /// The pixels.
            pub Plane<$pixel>,
        );
    )*};
}

typed_plane! {
    /// Diffuse albedo, linear Rec.709, in 0..1.
    Albedo(Vec3),
    /// Unit normals in camera space, facing the camera.
    Normal(Vec3),
    /// Points in camera space, meters; x right, y up, looking along -z.
    Points(Vec3),
    /// Planar z in meters, positive and finite: holes are filled before a plane becomes a `Depth`.
    Depth(f32),
    /// GGX roughness in 0..1.
    Roughness(f32),
    /// Specular level in 0..1, of which 0.08 is reflected straight back: 0.5 is a usual dielectric.
    Specular(f32),
    /// Irradiance / pi per color channel, so that a diffuse surface shows albedo x shading.
    Shading(Vec3),
    /// A share of each pixel, in 0..1.
    Mask(f32),
    /// A picture in linear Rec.709, scene-referred, in units of the photo.
    Picture(Vec3),
}

/// One rule of a value that was read from disk.
///
/// # Errors
/// The rule does not hold; the message names it.
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

/// Log intensity of a log color, the mean of its channels, and its log chromaticity, the rest.
pub fn intensity_and_chroma(log: Vec3) -> (f32, Vec3) {
    let intensity = log.element_sum() / 3.0;
    (intensity, log - Vec3::splat(intensity))
}

/// The constants that decide operations on planes and materials of pixels.
pub fn tuning() -> Vec<Table> {
    [ops::tuning(), material::tuning()].concat()
}
