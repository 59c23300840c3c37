//! Directions and points: random numbers, and densities with their closed-form integrals.
//!
//! The lowest room of `optics`: it uses none of the others.

pub(in crate::optics) mod gaussian;
pub(in crate::optics) mod linear;
pub(in crate::optics) mod lobe_irradiance;
pub(in crate::optics) mod polar_sampler;
pub(in crate::optics) mod polygon;
pub(in crate::optics) mod product_sampler;
pub(in crate::optics) mod random;
pub(in crate::optics) mod rectangle;
pub(in crate::optics) mod sphere;

pub use gaussian::{Gaussian, Lobe};
pub use polygon::polygon_irradiance;
pub use random::Points2;
pub use sphere::sphere_irradiance;

use crate::tuning::Table;

/// The constants of sampling.
pub fn tuning() -> Vec<Table> {
    vec![
        gaussian::GaussianTuning::table(),
        lobe_irradiance::LobeIrradianceTuning::table(),
        polar_sampler::PolarSamplerTuning::table(),
        product_sampler::ProductSamplerTuning::table(),
        rectangle::RectangleTuning::table(),
    ]
}
