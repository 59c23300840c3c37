//! Directions and points: random numbers, and densities with their closed-form integrals.

pub(in crate::optics) mod gaussian;
pub(in crate::optics) mod lobe_irradiance;
pub(in crate::optics) mod polar_sampler;
pub(in crate::optics) mod polygon;
pub(in crate::optics) mod product_sampler;
pub(in crate::optics) mod random;
pub(in crate::optics) mod rectangle;

pub use gaussian::Gaussian;
pub use polygon::polygon_irradiance;
pub use random::Points2;
