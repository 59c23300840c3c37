//! Observations of a photo: the pixels that take part in a fit.

use glam::Vec3;

use crate::image::{Mask, Picture, Segments, dilate, luminance};
use crate::tuning::tuning;

/// Photo on the pixels that take part in a fit: `photo`, `segment` and `saturated` have one entry
/// per pixel.
pub struct Observations {
    /// Linear RGB, >= 0.
    pub photo: Vec<Vec3>,
    /// Segment of each pixel, below `segments`.
    pub segment: Vec<u32>,
    /// Number of segments.
    pub segments: usize,
    /// Pixels at which the photo is clipped: there the model may be brighter at no cost, but not
    /// darker.
    pub saturated: Vec<bool>,
    /// Level of white, see `white_level`.
    pub white: f32,
}

impl Observations {
    /// Observations at `pixels` (indices into the planes, all of one size): the mean over the
    /// pixels of the same segment within `radius` pixels of each.
    ///
    /// # Panics
    ///
    /// When a pixel is outside of the planes.
    pub fn at(
        photo: &Picture,
        clipped: &Mask,
        segments: &Segments,
        pixels: &[usize],
        radius: usize,
    ) -> Observations {
        let (w, h) = photo.0.size();
        let mean = |&pixel: &usize| {
            let (x, y, label) = (pixel % w, pixel / w, segments.label.pixels()[pixel]);
            let (mut sum, mut clip, mut count) = (Vec3::ZERO, 0.0, 0.0);
            for y in y.saturating_sub(radius)..(y + radius + 1).min(h) {
                for x in x.saturating_sub(radius)..(x + radius + 1).min(w) {
                    if segments.label.get(x, y) == label {
                        sum += photo.0.get(x, y);
                        clip += clipped.0.get(x, y);
                        count += 1.0;
                    }
                }
            }
            (sum / count, clip / count > TUNING.max_clipped)
        };
        let white = white_of(photo, clipped);
        let (photo, saturated) = pixels.iter().map(mean).unzip();
        Observations {
            photo,
            segment: pixels.iter().map(|&p| segments.label.pixels()[p]).collect(),
            segments: segments.count as usize,
            saturated,
            white,
        }
    }

    /// Shading on the same pixels where their albedo is known: I / A, as one segment of albedo 1.
    /// `albedo` has one entry per pixel.
    pub fn over(self, albedo: &[Vec3]) -> Observations {
        let shading = self
            .photo
            .iter()
            .zip(albedo)
            .map(|(photo, albedo)| *photo / albedo.max(Vec3::splat(TUNING.darkest)));
        Observations {
            photo: shading.collect(),
            segment: vec![0; self.segment.len()],
            segments: 1,
            ..self
        }
    }
}

tuning! {
    /// Constants of the pixels of a photo that take part in a fit.
    pub const TUNING: ObservationsTuning {
        /// Clipped fraction of the mean of a pixel above which the observation is saturated.
        max_clipped: f32 = 0.02,
            unit "1", source Taste, effect "a larger value trusts more pixels beside highlights";
        /// Albedo below which a surface reflects more noise than signal.
        darkest: f32 = 0.02,
            unit "albedo", source Taste, effect "a larger value darkens the shading of dark surfaces";
        /// Quantile of the levels of a photo that is clipped nowhere, from which its white is
        /// found.
        white_tenths: usize = 9,
            unit "tenths", source Taste, effect "a larger value lets a sun or a lamp move white";
        /// White over that quantile.
        white_factor: f32 = 2.0,
            unit "1", source Taste, effect "a larger value makes all levels darker relative to white";
        /// Luminance below which a pixel is black: one 8-bit step.
        black: f32 = 0.004,
            unit "fraction of white", source Derived("quantization of 8-bit photos"),
            effect "a larger value drops dark pixels";
        /// Least distance of an observation from the masks of lights.
        margin: usize = 2,
            unit "pixels", source Taste, effect "a larger value drops more pixels around lights";
    }
}

/// Level of white in a photo of any exposure, from its pixels and whether each is clipped; 0 for a
/// black photo.
///
/// A photo that is clipped somewhere ends at its white. Elsewhere white is twice the 90th
/// percentile of the larger channels that are not 0. That is about 1 in an ordinary photo, and a
/// sun or a lamp does not move it.
pub fn white_level(pixels: impl Iterator<Item = (Vec3, bool)>) -> f32 {
    let (mut levels, mut end) = (Vec::new(), 0.0f32);
    for (pixel, clipped) in pixels.filter(|(pixel, _)| pixel.max_element() > 0.0) {
        levels.push(pixel.max_element());
        end = end.max(if clipped { pixel.max_element() } else { 0.0 });
    }
    if end > 0.0 || levels.is_empty() {
        return end;
    }
    let at = (levels.len() - 1) * TUNING.white_tenths / 10;
    TUNING.white_factor * *levels.select_nth_unstable_by(at, f32::total_cmp).1
}

pub(super) fn white_of(photo: &Picture, clipped: &Mask) -> f32 {
    white_level(
        photo
            .0
            .pixels()
            .iter()
            .zip(clipped.0.pixels())
            .map(|(&pixel, &clipped)| (pixel, clipped > 0.5)),
    )
}

/// Pixels of `candidates` that constrain the lights: brighter than black, and at least two pixels
/// away from each of `masks`, which mark lights and pixels outside the room. All are indices into
/// `photo`, in the order of `candidates`.
pub fn observed_pixels<'a>(
    candidates: impl Iterator<Item = usize>,
    photo: &Picture,
    clipped: &Mask,
    masks: impl Iterator<Item = &'a Mask>,
) -> Vec<usize> {
    let taken = dilate(masks, photo.0.size(), TUNING.margin);
    let mut pixels: Vec<usize> = candidates.filter(|&i| !taken.pixels()[i]).collect();
    let black = TUNING.black * white_of(photo, clipped);
    pixels.retain(|&i| luminance(photo.0.pixels()[i]) > black);
    pixels
}
