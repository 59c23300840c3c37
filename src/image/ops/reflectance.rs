//! The reflectance of a pixel, and the saturation of a photo.

use glam::Vec3;

use crate::image::{Mask, Picture};
use crate::tuning::tuning;

/// Per channel a / b, 1 where both vanish, large but finite where only b does.
pub fn ratio(a: Vec3, b: Vec3) -> Vec3 {
    (a + Vec3::splat(REFLECTANCE.dark)) / (b + Vec3::splat(REFLECTANCE.dark))
}

/// Reflectance of a pixel: `photo` over `shading`, at most `REFLECTANCE.excess` in the largest
/// channel. The color is kept, so that the remainder has the photo's color and not that of one
/// channel. Above 1, the shading is too low and not the surface too bright.
pub fn reflected(photo: Vec3, shading: Vec3) -> Vec3 {
    limited(ratio(photo, shading), REFLECTANCE.excess)
}

/// `reflectance` scaled to at most `limit` in its largest channel.
pub fn limited(reflectance: Vec3, limit: f32) -> Vec3 {
    let over = reflectance.max_element() / limit;
    // Few pixels are above the limit, and three divisions take long.
    if over > 1.0 { reflectance / over } else { reflectance }
}

/// The part of the light `scattered` by the lens that a pixel of the photo can have: at most
/// `REFLECTANCE.most_glare` of each of its channels, by one factor for all, so that the rest keeps
/// a color that surfaces have.
pub fn glare_of(photo: Vec3, scattered: Vec3) -> Vec3 {
    let most = REFLECTANCE.most_glare * ratio(photo, scattered).min_element();
    scattered * most.clamp(0.0, 1.0)
}

/// 0 up to `from`, 1 from `to` on, without a kink.
pub fn smooth_step(from: f32, to: f32, x: f32) -> f32 {
    if x <= from {
        return 0.0;
    }
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
        /// Largest ratio of photo and shading by which the lights of the photo are reflected: two
        /// stops. What the photo has above it stays as it is.
        excess: f32 = 4.0,
            unit "1", source Measured("38 generated rooms with 1, 1.5 and 4; no page records it"),
            effect "a larger value lets more light that no estimate explains go with the lights";
        /// Largest part of a channel of the photo that is glare.
        most_glare: f32 = 0.7,
            unit "1", source Measured("bars and curtains of the window of scenes/demo"),
            effect "a larger value leaves less, in colors that are too saturated, beside bright windows";
        /// Largest channel, over the level at which the photo is clipped, from which on the ratio
        /// of photo and shading may exceed `excess`, and at which it is not limited.
        saturation: [f32; 2] = [0.75, 0.98],
            unit "1", source Taste, effect "lower values let more bright surfaces follow all of their lights";
    }
}

/// The level at which a photo is clipped: the median of the largest channels of clipped pixels. It
/// is 1 in most, any in a float file, the largest number where it is clipped nowhere.
pub fn clip_level(photo: &Picture, clipped: &Mask) -> f32 {
    let all = photo.0.pixels().iter().zip(clipped.0.pixels());
    let all = all.filter(|(_, clipped)| **clipped > 0.5);
    let mut levels: Vec<f32> = all.map(|(pixel, _)| pixel.max_element()).collect();
    let middle = levels.len() / 2;
    match levels.is_empty() {
        true => f32::MAX,
        false => *levels.select_nth_unstable_by(middle, f32::total_cmp).1,
    }
}
