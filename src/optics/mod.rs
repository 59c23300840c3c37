//! Light: its sources, its sampling, its closed forms. Pure functions with their equations.

mod candidates;
mod light;
mod nnls;
mod radiance_fit;
mod temperature;

pub use candidates::{RoomBox, lamp_candidates, visible_light, window_candidates};
pub use light::{Lamp, LightKind, Lobe, Plate, Radiance, Shape, Window};
pub use nnls::nnls;
pub use radiance_fit::{Column, Evidence, RadianceFit, fit_radiances};
pub use temperature::black_body;
