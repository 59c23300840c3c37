//! The contribution of one light to a picture, as `picture.exr` holds it.

use glam::Vec3;
use half::f16;
use half::slice::{HalfBitsSliceExt, HalfFloatSliceExt};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::image::{Picture, Plane};

/// The contribution of one light to a picture, linear, at the photo's size: in half floats, which
/// take half of the memory and are written as they are; in single precision if halves cannot hold
/// it.
///
/// ```
/// use glam::Vec3;
/// use relight::image::{Layer, Plane};
///
/// let layer = Layer::new(Plane::filled(4, 3, Vec3::new(0.5, 0.25, 0.0)));
/// assert!(matches!(layer, Layer::Half(_)));
/// assert_eq!(layer.picture().0.get(3, 2), Vec3::new(0.5, 0.25, 0.0));
/// assert!(matches!(Layer::new(Plane::filled(1, 1, Vec3::splat(1e6))), Layer::Float(_)));
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Layer {
    /// The bits of half floats: red, green, blue.
    Half(Plane<[u16; 3]>),
    /// Linear colors.
    Float(Plane<Vec3>),
}

/// Half floats hold a layer of this largest magnitude: above 65504 one is infinite, and where all
/// is below 6.1e-5 they lose digits, and below 6e-8 everything.
pub(in crate::image) fn halves_hold(largest: f32) -> bool {
    largest <= f16::MAX.to_f32() && !(largest > 0.0 && largest < f16::MIN_POSITIVE.to_f32())
}

/// The exponent of a half float, of which all bits are set in what is not finite.
const HALF_EXPONENT: u16 = 0x7c00;
/// Colors that are converted at a time.
const PIECE: usize = 1024;
/// Rows that one task converts.
const ROWS: usize = 32;

impl Layer {
    /// The layer of linear colors: in half floats where they hold it.
    pub fn new(plane: Plane<Vec3>) -> Layer {
        Layer::halves(&plane).unwrap_or(Layer::Float(plane))
    }

    /// The layer in half floats; `None` when they cannot hold it.
    pub(in crate::image) fn halves(plane: &Plane<Vec3>) -> Option<Layer> {
        let mut halves = HalfLayer::new(plane.width(), plane.height());
        let band = ROWS * plane.width();
        let bands: Vec<_> = halves.bands(band).zip(plane.pixels().chunks(band.max(1))).collect();
        let largest = bands.into_par_iter().map(|(mut half, pixels)| {
            half.put(0, pixels.iter().copied());
            half.largest()
        });
        let largest = largest.reduce(|| 0.0, f32::max);
        halves.finish(largest)
    }

    /// (width, height)
    pub fn size(&self) -> (usize, usize) {
        match self {
            Layer::Half(plane) => plane.size(),
            Layer::Float(plane) => plane.size(),
        }
    }

    /// The color of pixel `i`, row by row.
    pub fn get(&self, i: usize) -> Vec3 {
        match self {
            Layer::Half(plane) => {
                Vec3::from_array(plane.pixels()[i].map(|bits| f16::from_bits(bits).to_f32()))
            }
            Layer::Float(plane) => plane.pixels()[i],
        }
    }

    /// Adds the colors of the pixels from `at` on, times `weight`, to `sums`.
    pub(in crate::image) fn add(&self, weight: Vec3, at: usize, sums: &mut [Vec3]) {
        match self {
            Layer::Half(plane) => {
                let mut wide = [0.0; 3 * PIECE];
                let pixels = plane.pixels()[at..].chunks(PIECE);
                for (sums, pixels) in sums.chunks_mut(PIECE).zip(pixels) {
                    let halves = pixels[..sums.len()].as_flattened().reinterpret_cast::<f16>();
                    let wide = &mut wide[..halves.len()];
                    halves.convert_to_f32_slice(wide);
                    let colors = wide.as_chunks().0.iter().map(|&color| Vec3::from_array(color));
                    sums.iter_mut().zip(colors).for_each(|(sum, color)| *sum += color * weight);
                }
            }
            Layer::Float(plane) => {
                let both = sums.iter_mut().zip(&plane.pixels()[at..]);
                both.for_each(|(sum, &color)| *sum += color * weight);
            }
        }
    }

    /// The first pixel of which a channel is not finite.
    pub fn first_not_finite(&self) -> Option<usize> {
        match self {
            Layer::Half(plane) => {
                let is_finite = |bits: u16| bits & HALF_EXPONENT != HALF_EXPONENT;
                // All channels of a piece, as that takes no branch.
                let is_whole = |piece: &[[u16; 3]]| {
                    piece.as_flattened().iter().fold(true, |all, &bits| all & is_finite(bits))
                };
                let pieces = plane.pixels().par_chunks(PIECE).enumerate();
                let (i, piece) = pieces.find_first(|(_, piece)| !is_whole(piece))?;
                let at = piece.iter().position(|pixel| !pixel.iter().all(|&bits| is_finite(bits)));
                at.map(|at| i * PIECE + at)
            }
            Layer::Float(plane) => first_not_finite(plane),
        }
    }

    /// The layer in single precision.
    pub fn picture(&self) -> Picture {
        let (width, height) = self.size();
        Picture(Plane::new(width, height, (0..width * height).map(|i| self.get(i)).collect()))
    }

    /// Whether every pixel is black.
    pub fn is_black(&self) -> bool {
        match self {
            Layer::Half(plane) => plane.is_zero(),
            Layer::Float(plane) => plane.pixels().iter().all(|&color| color == Vec3::ZERO),
        }
    }

    /// Memory held by the pixels, in bytes.
    pub fn bytes(&self) -> usize {
        match self {
            Layer::Half(plane) => plane.bytes(),
            Layer::Float(plane) => plane.bytes(),
        }
    }
}

/// The first pixel of which a channel is not finite.
pub fn first_not_finite(plane: &Plane<Vec3>) -> Option<usize> {
    let pieces = plane.pixels().par_chunks(PIECE).enumerate();
    let in_piece = |(i, piece): (usize, &[Vec3])| {
        piece.iter().position(|color| !color.is_finite()).map(|at| i * PIECE + at)
    };
    pieces.find_map_first(in_piece)
}

/// A layer in the making, black where nothing was put.
pub struct HalfLayer {
    plane: Plane<[u16; 3]>,
}

/// A part of a [`HalfLayer`], which may be made beside the others.
pub struct HalfBand<'a> {
    pixels: &'a mut [[u16; 3]],
    largest: f32,
}

impl HalfLayer {
    /// A black layer.
    pub fn new(width: usize, height: usize) -> HalfLayer {
        HalfLayer { plane: Plane::filled(width, height, [0; 3]) }
    }

    /// The parts of `pixels` pixels each, row by row; the last may have fewer.
    pub fn bands(&mut self, pixels: usize) -> impl Iterator<Item = HalfBand<'_>> {
        let bands = self.plane.pixels_mut().chunks_mut(pixels.max(1));
        bands.map(|pixels| HalfBand { pixels, largest: 0.0 })
    }

    /// The layer, of which `largest` is the largest magnitude; `None` when halves cannot hold it.
    pub fn finish(self, largest: f32) -> Option<Layer> {
        halves_hold(largest).then_some(Layer::Half(self.plane))
    }
}

impl HalfBand<'_> {
    /// Puts colors at the pixels from `at` on. Black is not written, so that a light that gives
    /// nothing takes no memory.
    pub fn put(&mut self, at: usize, mut colors: impl Iterator<Item = Vec3>) {
        let (mut wide, mut halves) = ([0.0; 3 * PIECE], [f16::ZERO; 3 * PIECE]);
        for pixels in self.pixels[at..].chunks_mut(PIECE) {
            let mut count = 0;
            for color in colors.by_ref().take(pixels.len()) {
                self.largest = self.largest.max(color.abs().max_element());
                wide[3 * count..][..3].copy_from_slice(&color.to_array());
                count += 1;
            }
            if count == 0 {
                return;
            }
            halves[..3 * count].convert_from_f32_slice(&wide[..3 * count]);
            for (pixel, half) in pixels.iter_mut().zip(halves[..3 * count].chunks_exact(3)) {
                let bits = [half[0], half[1], half[2]].map(f16::to_bits);
                if bits != [0; 3] {
                    *pixel = bits;
                }
            }
        }
    }

    /// The largest magnitude that was put.
    pub fn largest(&self) -> f32 {
        self.largest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_layer_keeps_eleven_bits_or_all() {
        let plane =
            |scale: f32| Plane::from_fn(50, 41, |x, y| scale * Vec3::new(x as f32, y as f32, 0.1));
        let half = Layer::new(plane(0.01));
        assert!(matches!(half, Layer::Half(_)) && half.bytes() == 50 * 41 * 6);
        for (i, want) in plane(0.01).pixels().iter().enumerate() {
            assert!(
                (half.get(i) - *want).abs().max_element() <= want.max_element() / 2048.0,
                "{i}"
            );
        }
        for scale in [1e4, 1e-7, f32::INFINITY] {
            assert!(matches!(Layer::new(plane(scale)), Layer::Float(_)), "{scale}");
        }
        assert_eq!(Layer::new(plane(0.0)).picture(), Picture(plane(0.0)));
    }

    #[test]
    fn the_first_pixel_that_is_not_finite_is_found() {
        let plane = Plane::filled(70, 40, Vec3::splat(-3.0));
        assert_eq!(Layer::new(plane.clone()).first_not_finite(), None);
        for (value, is_half) in [(f32::NAN, true), (f32::NEG_INFINITY, false)] {
            let mut bad = plane.clone();
            [1500, 2799].into_iter().for_each(|i| bad.pixels_mut()[i].y = value);
            let layer = Layer::new(bad);
            assert_eq!(matches!(layer, Layer::Half(_)), is_half);
            assert_eq!(layer.first_not_finite(), Some(1500));
        }
    }

    #[test]
    fn a_weighted_layer_adds_its_own_colors() {
        for scale in [0.01, 1e4] {
            let layer = Layer::new(Plane::from_fn(60, 50, |x, y| {
                scale * Vec3::new(x as f32, y as f32, 7.0)
            }));
            let weight = Vec3::new(2.0, 0.5, 0.25);
            for (from, count) in [(0, 3000), (60, 120), (1, 1100)] {
                let mut sums = vec![Vec3::ONE; count];
                layer.add(weight, from, &mut sums);
                for (i, sum) in sums.into_iter().enumerate() {
                    assert_eq!(sum, Vec3::ONE + layer.get(from + i) * weight);
                }
            }
        }
    }

    #[test]
    fn a_layer_made_in_pieces_is_the_same() {
        let plane = Plane::from_fn(70, 40, |x, y| Vec3::new(x as f32, -(y as f32), 0.5));
        let mut pieces = HalfLayer::new(70, 40);
        let mut largest = 0.0f32;
        for (mut band, pixels) in pieces.bands(70 * 7).zip(plane.pixels().chunks(70 * 7)) {
            for (row, colors) in pixels.chunks(70).enumerate() {
                band.put(row * 70, colors.iter().copied());
            }
            largest = largest.max(band.largest());
        }
        assert_eq!(pieces.finish(largest), Some(Layer::new(plane)));
    }
}
