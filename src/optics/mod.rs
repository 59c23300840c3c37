//! Light: its sources, its sampling, its closed forms. Pure functions with their equations.

mod candidates;
mod conditioning;
mod direct;
mod emitter;
mod estimate;
mod evidence;
#[cfg(test)]
mod extremes;
mod find_lights;
mod gaussian;
mod indirect;
mod light;
mod lobe_irradiance;
mod nnls;
mod plates;
mod polar;
mod polygon;
mod radiance_fit;
mod random;
mod rectangle;
#[cfg(test)]
mod rows;
mod shadow;
mod sphere;
mod temperature;
mod through;
mod visible_lamp;
mod window;

pub use candidates::{RoomBox, lamp_candidates, visible_light, window_candidates};
pub use conditioning::Conditioning;
pub use direct::{Direct, direct};
pub use emitter::{Emitter, LightSample, Seen};
pub use estimate::{BATCHES, INTERVAL, Sampling, estimate, stream};
pub use evidence::{Evidence, evidence_pixels};
pub use find_lights::{FoundLight, LightSearch, find_lights};
pub use gaussian::Gaussian;
pub use indirect::{Bounces, Transport, indirect, indirect_at_receivers, trace_bounces};
pub use light::{Lamp, LightKind, Lobe, Plate, Radiance, Shape, Window};
pub use nnls::nnls;
pub use polygon::polygon_irradiance;
pub use radiance_fit::{Column, RadianceFit, fit_radiances};
pub use random::Points2;
pub use shadow::{Shadow, ShadowQuality, shadow};
pub use sphere::sphere_irradiance;
pub use temperature::black_body;
pub use visible_lamp::{LampForm, LampForms};
pub use window::Strategy;
