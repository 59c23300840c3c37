//! Directions through a rectangle, by the sampling technique that suits the lobe behind it and the
//! receiver's horizon.

use std::f64::consts::PI;

use glam::DVec3;

use super::gaussian::Gaussian;
use super::linear::invert_linear;
use super::lobe_irradiance::Overlap;
use super::polar_sampler::{PolarSampler, Product};
use super::polygon::Outline;
use super::rectangle::{Rectangle, RectangleSampler};
use crate::tuning::tuning;

/// A sampler of G(l) cos(theta), or of cos(theta) alone, through a rectangle.
pub enum ProductSampler {
    /// The lobe alone, which lies wholly within the rectangle.
    Lobe(Gaussian),
    /// The product as a bilinear function on the rectangle, which it nearly is, by Ureña's map.
    /// Hart et al., "Practical Product Sampling by Fitting and Composing Warps", EGSR 2020.
    Warped(RectangleSampler, [[f64; 2]; 2], Option<Gaussian>),
    /// The product in polar coordinates, where the lobe or the horizon cuts through the rectangle.
    Polar(Box<PolarSampler>),
}

tuning! {
    /// Constants that choose a sampling technique. Each changes the noise and the time, and no
    /// mean.
    pub const TUNING: ProductSamplerTuning {
        /// Largest difference between the mean of the corners' values and the middle's that counts
        /// as bilinear.
        bilinear: f64 = 0.5,
            unit "the middle's value", source Measured("benches/windows.rs"),
            effect "a larger value uses the polar sampler less";
        /// Least value of a corner that counts as bilinear.
        min_corner: f64 = 0.01,
            unit "the largest corner's value", source Measured("benches/windows.rs"),
            effect "a larger value uses the polar sampler more";
        /// Width over perimeter below which an outline is a slit.
        slit: f64 = 2e-3,
            unit "1", source Measured("benches/windows.rs"), effect "a larger value uses the polar sampler less";
    }
}

impl ProductSampler {
    /// The sampler for a receiver at `point` with the unit `normal`; `None` where nothing arrives.
    ///
    /// `outline` is the rectangle's part above the receiver's horizon. Without a lobe, the radiance
    /// is uniform.
    pub fn new(
        rectangle: &Rectangle,
        outline: &Outline,
        gaussian: Option<Gaussian>,
        (point, normal): (DVec3, DVec3),
    ) -> Option<ProductSampler> {
        let product = match gaussian {
            None => Product::AboutNormal(None, normal),
            Some(gaussian) => match gaussian.overlap(outline) {
                Overlap::Disjoint => return None,
                Overlap::Within => return Some(ProductSampler::Lobe(gaussian)),
                Overlap::Partial => Product::about_sharper(gaussian, normal),
            },
        };
        // In a slit narrower than the lobe nearly all azimuths about the lobe hold next to nothing.
        let around: f64 = outline.edges().iter().map(|edge| edge.angle).sum();
        let width = 2.0 * outline.solid_angle() / around;
        let spread = gaussian.map_or(1.0, |gaussian| 1.0 / gaussian.bandwidth.max(1.0).sqrt());
        if width < TUNING.slit * around && width < spread {
            return Some(ProductSampler::Warped(
                rectangle.sampler_at(point)?,
                [[1.0; 2]; 2],
                gaussian,
            ));
        }
        if outline.edges().len() == 4 {
            let uniform = rectangle.sampler_at(point)?;
            let value = |position: DVec3| {
                value(gaussian, normal, position.normalize_or_zero()) / uniform.pdf(position)
            };
            let corners = [0.0, 1.0].map(|v| [0.0, 1.0].map(|u| value(uniform.position(u, v))));
            let all = corners.as_flattened();
            let (low, high) =
                all.iter().fold((f64::INFINITY, 0.0), |(low, high), &c| (c.min(low), c.max(high)));
            let (mean, middle) =
                (0.25 * all.iter().sum::<f64>(), value(uniform.sample([0.5, 0.5])));
            if low > TUNING.min_corner * high && (mean - middle).abs() < TUNING.bilinear * middle {
                return Some(ProductSampler::Warped(uniform, corners, gaussian));
            }
        }
        PolarSampler::new(outline, product).map(|polar| ProductSampler::Polar(Box::new(polar)))
    }

    /// A position on the rectangle, relative to `point`, and its contribution to E / L, from a
    /// point of the unit square.
    ///
    /// The contribution alone is an unbiased estimate; `None` counts as zero.
    pub fn sample(
        &self,
        rectangle: &Rectangle,
        (point, normal): (DVec3, DVec3),
        uv: [f64; 2],
    ) -> Option<(DVec3, f64)> {
        match self {
            ProductSampler::Lobe(gaussian) => {
                let direction = gaussian.sample(uv);
                let position = rectangle.intersect(point, direction)?;
                let cos = normal.dot(direction);
                (cos > 0.0).then(|| (position, cos * gaussian.solid_angle() / PI))
            }
            ProductSampler::Warped(uniform, [[a, b], [c, d]], gaussian) => {
                let v = invert_linear(uv[1], a + b, c + d);
                let (left, right) = (a + v * (c - a), b + v * (d - b));
                let u = invert_linear(uv[0], left, right);
                let warp = 4.0 * (left + u * (right - left)) / (a + b + c + d);
                let position = uniform.sample([u, v]);
                let value = value(*gaussian, normal, position.normalize_or_zero());
                Some((position, value / (PI * warp * uniform.pdf(position))))
            }
            ProductSampler::Polar(polar) => {
                let (direction, integral) = polar.sample(uv)?;
                Some((rectangle.intersect_plane(point, direction)?, integral / PI))
            }
        }
    }
}

/// The integrand G(l) cos(theta), 0..=1.
fn value(gaussian: Option<Gaussian>, normal: DVec3, direction: DVec3) -> f64 {
    normal.dot(direction).max(0.0) * gaussian.map_or(1.0, |gaussian| gaussian.value(direction))
}
