//! What a photo says of its lights: the pixels that take part in a fit.

use glam::Vec3;

use crate::image::{Mask, Picture, Segments, dilate, luminance};

/// A photo on the pixels that take part in a fit.
pub struct Evidence {
    /// Linear photo.
    pub photo: Vec<Vec3>,
    /// Segment of each pixel, below `segments`.
    pub segment: Vec<u32>,
    pub segments: usize,
    /// Where the photo is clipped: there the model may be brighter at no cost, but not darker.
    pub saturated: Vec<bool>,
    /// The level that counts as white, see `white_level`.
    pub white: f32,
}

impl Evidence {
    /// The photo at `pixels`: the mean over the pixels of the same segment within `radius` of each.
    pub fn at(photo: &Picture, clipped: &Mask, segments: &Segments, pixels: &[usize], radius: usize) -> Evidence {
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
            (sum / count, clip / count > 0.02)
        };
        let white = white_of(photo, clipped);
        let (photo, saturated) = pixels.iter().map(mean).unzip();
        Evidence {
            photo,
            segment: pixels.iter().map(|&p| segments.label.pixels()[p]).collect(),
            segments: segments.count as usize,
            saturated,
            white,
        }
    }

    /// The shading on the same pixels where their albedo is known: I / A, as if all were one segment of albedo 1.
    pub fn over(self, albedo: &[Vec3]) -> Evidence {
        let shading = self.photo.iter().zip(albedo).map(|(photo, albedo)| *photo / albedo.max(Vec3::splat(DARKEST)));
        Evidence { photo: shading.collect(), segment: vec![0; self.segment.len()], segments: 1, ..self }
    }
}

/// Albedo below which a surface tells nothing of what falls on it but noise.
const DARKEST: f32 = 0.02;

/// The level that counts as white in a photo of any exposure, from its pixels and whether each is clipped; 0 for a black photo.
///
/// A photo that is clipped somewhere ends at its white. Elsewhere it is twice the 90th percentile of the larger channels that
/// are not 0, about 1 in an ordinary photo, which a sun or a lamp does not move.
pub fn white_level(pixels: impl Iterator<Item = (Vec3, bool)>) -> f32 {
    let (mut levels, mut end) = (Vec::new(), 0.0f32);
    for (pixel, clipped) in pixels.filter(|(pixel, _)| pixel.max_element() > 0.0) {
        levels.push(pixel.max_element());
        end = end.max(if clipped { pixel.max_element() } else { 0.0 });
    }
    if end > 0.0 || levels.is_empty() {
        return end;
    }
    let at = (levels.len() - 1) * 9 / 10;
    2.0 * *levels.select_nth_unstable_by(at, f32::total_cmp).1
}

fn white_of(photo: &Picture, clipped: &Mask) -> f32 {
    white_level(photo.0.pixels().iter().zip(clipped.0.pixels()).map(|(&pixel, &clipped)| (pixel, clipped > 0.5)))
}

/// Luminance below which a pixel is black, as a share of white: one 8-bit step.
const BLACK: f32 = 0.004;

/// The pixels of `candidates` that say something about the lights: bright enough to be told from black, and away (by two
/// pixels) from every one of `masks`, which mark lights and what is no part of the room.
pub fn evidence_pixels<'a>(
    candidates: impl Iterator<Item = usize>,
    photo: &Picture,
    clipped: &Mask,
    masks: impl Iterator<Item = &'a Mask>,
) -> Vec<usize> {
    let taken = dilate(masks, photo.0.size(), 2);
    let mut pixels: Vec<usize> = candidates.filter(|&i| !taken.pixels()[i]).collect();
    let black = BLACK * white_of(photo, clipped);
    pixels.retain(|&i| luminance(photo.0.pixels()[i]) > black);
    pixels
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Plane;
    use crate::optics::inverse::{Column, fit_radiances};

    #[test]
    fn where_albedo_is_known_radiances_need_no_smooth_surface() {
        // A paint of its own at every pixel, which a segment of one albedo would take for light.
        let (w, h) = (24, 16);
        let plane =
            |f: &dyn Fn(f32, f32) -> f32| Plane::from_fn(w, h, |x, y| f(x as f32 / w as f32, y as f32 / h as f32));
        let (left, right) = (plane(&|x, y| 0.1 + (1.0 - x).powi(2) * (0.5 + y)), plane(&|x, y| 0.05 + x * (1.2 - y)));
        let wanted = [Vec3::new(1.0, 0.8, 0.5), Vec3::new(0.6, 0.8, 1.0)];
        let paint = Plane::from_fn(w, h, |x, y| Vec3::splat(0.2 + 0.6 * ((x * 7 + y * 3) % 5) as f32 / 5.0));
        let shading = |p: usize| left.pixels()[p] * wanted[0] + right.pixels()[p] * wanted[1];
        let photo = Picture(Plane::from_fn(w, h, |x, y| paint.get(x, y) * shading(y * w + x)));
        let segments = Segments { label: Plane::filled(w, h, 0), count: 1 };
        let pixels: Vec<usize> = (0..w * h).collect();
        let clipped = Mask(Plane::filled(w, h, 0.0));
        let evidence = Evidence::at(&photo, &clipped, &segments, &pixels, 0).over(paint.pixels());
        let layers = [&left, &right].map(|layer| layer.map(Vec3::splat).into_pixels());
        let columns: Vec<Column> = layers.iter().map(|layer| Column { layer, penalty: 0.0, pull: 0.0 }).collect();
        let ones = vec![Vec3::ONE; pixels.len()];
        let fit = fit_radiances(&evidence, &columns, 200).with_albedo_of(&evidence.segment, &ones);
        for (got, wanted) in fit.radiance.iter().zip(wanted) {
            // The pull to likely colours moves radiances that are not of a bulb or of daylight.
            assert!(((*got - wanted) / wanted).abs().max_element() < 0.03, "{got} against {wanted}");
        }
    }
}
