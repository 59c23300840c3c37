//! Daylight: sun, sky and ground, and the color of a black body.

pub(in crate::optics) mod black_body;
pub(in crate::optics) mod sun_and_sky;
pub(in crate::optics) mod window_model;

pub use black_body::black_body;
pub use sun_and_sky::Daylight;
pub use window_model::{Heading, WindowModel, fit_window_model};

use crate::tuning::Table;

/// The constants of daylight.
pub fn tuning() -> Vec<Table> {
    vec![sun_and_sky::DaylightTuning::table(), window_model::WindowModelTuning::table()]
}
