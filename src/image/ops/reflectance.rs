//! The reflectance of a pixel, and the saturation of a photo.

use glam::Vec3;

use crate::image::{Mask, Picture};
use crate::tuning::tuning;

/// Per channel a / b, 1 where both vanish, large but finite where only b does.
pub fn ratio(a: Vec3, b: Vec3) -> Vec3 {
    (a + Vec3::splat(REFLECTANCE.dark)) / (b + Vec3::splat(REFLECTANCE.dark))
}

/// Reflectance of a pixel: `photo` over `shading`, at most 1 in the largest channel. The color is
/// kept, so that the remainder has the photo's color and not that of one channel.
pub fn reflected(photo: Vec3, shading: Vec3) -> Vec3 {
    let whole = ratio(photo, shading);
    whole / whole.max_element().max(1.0)
}

/// 0 up to `from`, 1 from `to` on, without a kink.
pub fn smooth_step(from: f32, to: f32, x: f32) -> f32 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

tuning! {
    /// Constants of the reflectance of a pixel.
    pub const REFLECTANCE: ReflectanceTuning {
        /// Value that is added to both sides of a ratio, so that it is 1 where both vanish.
        dark: f32 = 1e-9,
            unit "units of the photo", source Derived("single precision"),
            effect "a larger value moves ratios of dark pixels towards 1";
        /// Largest channel, over the level at which the photo is clipped, from which on the ratio
        /// of photo and shading may exceed 1, and at which it is not limited.
        saturation: [f32; 2] = [0.75, 0.98],
            unit "1", source Taste, effect "lower values let more bright surfaces follow all of their lights";
    }
}

/// The level at which a photo is clipped: 1 in most, any in a float file, the largest number where
/// it is clipped nowhere.
pub fn clip_level(photo: &Picture, clipped: &Mask) -> f32 {
    let all =
        photo.0.pixels().iter().zip(clipped.0.pixels()).filter(|(_, clipped)| **clipped > 0.5);
    all.map(|(pixel, _)| pixel.max_element()).reduce(f32::max).unwrap_or(f32::MAX)
}
