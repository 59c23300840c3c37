//! The noise of dark pixels, which a new light would amplify.
//!
//! A pixel at the 3rd of 255 steps may be a third too dark or too bright, in each channel by
//! itself, and JPEG stores such pixels as one color for each block. Under a light that makes them
//! ten times brighter, they are colored blocks. There the photo determines only the mean color of a
//! surface: the mean of the pixels around that differ by no more than their noise (bilateral
//! filter: Tomasi and Manduchi, "Bilateral filtering for gray and color images", ICCV 1998).

use glam::Vec3;

use super::grain::Grain;
use super::reflectance::smooth_step;
use crate::image::Picture;
use crate::tuning::tuning;

tuning! {
    /// Constants of the noise of dark pixels.
    pub const TUNING: DarkNoiseTuning {
        /// Least standard deviation of the noise.
        least: f32 = 2.0 / 255.0,
            unit "square root of linear", source Derived("two steps of 8 bits: dark blocks of JPEG"),
            effect "a larger value smooths brighter pixels";
        /// Level below which the deviation of a linear value stays the same.
        darkest: f32 = 0.04,
            unit "square root of linear", source Derived("the linear part of sRGB"),
            effect "a larger value smooths over larger differences of dark pixels";
        /// Deviations over the level below which a pixel stays as it is, and above which the mean
        /// takes its place.
        relative: [f32; 2] = [0.15, 0.5],
            unit "1", source Taste, effect "smaller values smooth brighter pixels";
        /// Scale of the difference of two pixels of one surface.
        range: f32 = 2.0,
            unit "deviations", source Taste, effect "a larger value smooths over edges in the dark";
        /// Distance up to which pixels count, and the distance between two of them.
        window: [usize; 2] = [16, 4],
            unit "pixels", source Derived("blocks of JPEG: 16 pixels with halved chroma"),
            effect "a wider window smooths more; a smaller step is slower";
    }
}

/// A photo and the noise of its dark pixels.
pub struct DarkNoise<'a> {
    photo: &'a Picture,
    grain: Option<&'a Grain>,
}

impl<'a> DarkNoise<'a> {
    /// The noise of a linear photo whose white is 1; `grain` is that of all its pixels.
    pub fn new(photo: &'a Picture, grain: Option<&'a Grain>) -> DarkNoise<'a> {
        DarkNoise { photo, grain }
    }

    /// Standard deviation of the noise of a linear value, per channel.
    fn deviation(&self, level: Vec3) -> Vec3 {
        let root = Vec3::from_array(level.to_array().map(|level| level.max(0.0).sqrt()));
        let grain = self.grain.map_or(Vec3::ZERO, |grain| grain.deviation(root));
        2.0 * root.max(Vec3::splat(TUNING.darkest)) * grain.max(Vec3::splat(TUNING.least))
    }

    /// The noise of pixel (x, y), if it is dark: what it has over the mean of its surface.
    pub fn at(&self, x: usize, y: usize) -> Vec3 {
        let shown = self.photo.0.get(x, y).max(Vec3::ZERO);
        let deviation = self.deviation(shown);
        let [none, all] = TUNING.relative;
        let share = (deviation / shown.max(Vec3::splat(f32::MIN_POSITIVE))).to_array();
        let share = Vec3::from_array(share.map(|relative| smooth_step(none, all, relative)));
        if share == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let (width, height) = self.photo.0.size();
        let [reach, step] = TUNING.window;
        let places = |center: usize, end: usize| {
            let first = center - center.min(reach) / step * step;
            (first..end.min(center + reach + 1)).step_by(step)
        };
        let (mut sum, mut total) = (Vec3::ZERO, 0.0);
        for (x, y) in places(y, height).flat_map(|y| places(x, width).map(move |x| (x, y))) {
            let value = self.photo.0.get(x, y).max(Vec3::ZERO);
            let away = (value - shown) / (TUNING.range * deviation);
            let weight = (-0.5 * away.length_squared()).exp();
            sum += weight * value;
            total += weight;
        }
        share * (shown - sum / total)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Plane;

    const SIZE: (usize, usize) = (64, 48);

    fn picture(value: impl Fn(usize, usize) -> Vec3) -> Picture {
        Picture(Plane::from_fn(SIZE.0, SIZE.1, value))
    }

    fn removed(picture: &Picture) -> Vec<Vec3> {
        let noise = DarkNoise::new(picture, None);
        let shown = picture.0.pixels().iter().enumerate();
        shown.map(|(i, shown)| shown - noise.at(i % SIZE.0, i / SIZE.0)).collect()
    }

    /// One step of 8 bits near black.
    const STEP: f32 = 1.0 / (255.0 * 12.92);

    #[test]
    fn bright_pixels_stay_to_the_bit() {
        let photo = picture(|x, y| Vec3::new(0.02, 0.1, 0.5) + 0.01 * ((x + 3 * y) % 5) as f32);
        assert_eq!(removed(&photo), photo.0.pixels());
    }

    #[test]
    fn blocks_of_rounded_color_become_their_mean() {
        // Blocks of 8 pixels with 0 to 2 steps in each channel.
        let block = |x: usize, y: usize, c: usize| ((x / 8) * (5 + c) + (y / 8) * (3 + c)) % 3;
        let photo =
            picture(|x, y| Vec3::from_array([0, 1, 2].map(|c| STEP * block(x, y, c) as f32)));
        let spread = |values: &[Vec3]| {
            let mean = values.iter().sum::<Vec3>() / values.len() as f32;
            let square = values.iter().map(|v| (*v - mean).length_squared()).sum::<f32>();
            (mean, (square / (3 * values.len()) as f32).sqrt())
        };
        let (before, after) = (spread(photo.0.pixels()), spread(&removed(&photo)));
        assert!(after.1 < before.1 / 3.0, "{before:?} {after:?}");
        assert!((after.0 - before.0).abs().max_element() < 0.1 * STEP, "{before:?} {after:?}");
    }

    #[test]
    fn an_edge_in_the_dark_stays() {
        // A dark chest before a wall at the 40th step.
        let wall = Vec3::splat(0.021);
        let photo = picture(|x, _| if x < 32 { Vec3::splat(STEP) } else { wall });
        for (i, value) in removed(&photo).into_iter().enumerate() {
            let want = if i % SIZE.0 < 32 { Vec3::splat(STEP) } else { wall };
            assert!((value - want).abs().max_element() < 0.01 * STEP, "{i}: {value}");
        }
    }
}
