//! Unshadowed direct shading of a whole picture by one light.

use rayon::prelude::*;

use super::estimate::{BATCHES, estimate};
use super::{Emitter, Shape};
use crate::image::{Normal, Plane, Points};

/// Per lobe of unit radiance: irradiance / pi, and its standard error (zero where a closed form was used).
pub struct Direct {
    pub lobes: Vec<Plane<f32>>,
    pub stderr: Vec<Plane<f32>>,
}

impl Direct {
    /// Mean standard error over mean value, of all lobes together.
    pub fn relative_error(&self) -> f64 {
        // The sum of nothing is -0.0, which would be shown with its sign.
        let sum =
            |planes: &[Plane<f32>]| planes.iter().flat_map(|p| p.pixels()).fold(0.0, |sum, &v| sum + f64::from(v));
        sum(&self.stderr) / sum(&self.lobes).max(f64::MIN_POSITIVE)
    }
}

/// Closed forms where there are any, else `samples` samples per pixel, rounded up to whole batches. The planes are of one size.
pub fn direct(points: &Points, normal: &Normal, shape: &Shape, samples: usize, seed: u64) -> Direct {
    let emitter = Emitter::new(shape);
    let (width, height) = points.0.size();
    let (mut lobes, mut stderr) = (Vec::new(), Vec::new());
    for lobe in 0..shape.lobes() {
        let shade = |i: usize| {
            let (point, n) = (points.0.pixels()[i], normal.0.pixels()[i]);
            match emitter.irradiance(lobe, point, n) {
                Some(e) => (e, 0.0),
                None => {
                    let each = samples.div_ceil(BATCHES);
                    let (e, error) = estimate(&emitter, lobe, (point, n), each, seed, i as u32);
                    (e as f32, error as f32)
                }
            }
        };
        let pixels = (0..width * height).into_par_iter().with_min_len(width.max(1));
        let (values, errors): (Vec<f32>, Vec<f32>) = pixels.map(shade).unzip();
        lobes.push(Plane::new(width, height, values));
        stderr.push(Plane::new(width, height, errors));
    }
    Direct { lobes, stderr }
}
