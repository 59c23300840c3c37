//! The contribution of one light to a picture, as `picture.exr` holds it.

use glam::Vec3;
use half::f16;
use half::slice::HalfFloatSliceExt;
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
