//! Light: its sources, its sampling, its closed forms. Pure functions with their equations.

mod direct;
mod emitter;
mod gaussian;
mod indirect;
mod light;
mod polygon;
mod random;
mod rectangle;
mod shadow;
mod sphere;
mod window;

pub use direct::{Direct, direct};
pub use emitter::{Emitter, LightSample, estimate};
pub use gaussian::Gaussian;
pub use indirect::{Bounces, Transport, indirect, trace_bounces};
pub use light::{Lamp, LightKind, Lobe, Plate, Radiance, Shape, Window};
pub use polygon::polygon_irradiance;
pub use random::Points2;
pub use shadow::{Shadow, ShadowQuality, shadow};
pub use sphere::sphere_irradiance;
