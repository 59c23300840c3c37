//! From geometry and lights to unit layers.

pub mod direct;
pub mod draw_rooms;
pub mod emitter_mask;
pub mod indirect;
pub mod insert_specular;
pub mod light_draws;
pub mod light_net;
pub mod light_objects;
pub mod light_room;
pub mod mix;
pub mod occlude_residual;
pub mod room_error;
pub mod shade_objects;
pub mod shade_specular_edit;
pub mod shadow;
pub mod shadow_net;
pub mod trace_indirect;
pub mod trace_pane;
pub mod transport;

use std::ops::RangeInclusive;

use crate::graph::Context;
use crate::image::Plane;
use crate::nodes::artifacts::same_size;
use crate::optics::{Sampling, Strategy};
use crate::tuning::Table;

/// Samples per pixel and lobe.
const SAMPLES: RangeInclusive<u32> = 1..=65_536;

/// Sampling of a stage. The first round of a run with a budget is the smallest possible.
fn sampling(
    ctx: &Context,
    strategy: Strategy,
    samples: u32,
    target_error: f32,
    max_samples: u32,
    seed: u64,
) -> Sampling {
    Sampling {
        strategy,
        samples: samples as usize,
        most: max_samples as usize,
        target: f64::from(target_error),
        first: if ctx.has_budget() { 1 } else { samples as usize },
        seed,
    }
}

/// Shadowed direct shading, from the unshadowed shading and its lit fraction, of the same size.
fn shadowed(direct: &Plane<f32>, lit: &Plane<f32>) -> Plane<f32> {
    let arrives = direct.pixels().iter().zip(lit.pixels()).map(|(e, v)| e * v).collect();
    Plane::new(direct.width(), direct.height(), arrives)
}

/// The constants of rendering.
pub fn tuning() -> Vec<Table> {
    vec![
        shadow::ShadowStageTuning::table(),
        shadow_net::ShadowNetTuning::table(),
        emitter_mask::EmitterMaskTuning::table(),
    ]
}
