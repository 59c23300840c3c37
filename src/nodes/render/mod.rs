//! From geometry and lights to unit layers.

pub mod direct;
pub mod emitter_mask;
pub mod indirect;
pub mod insert_specular;
pub mod light_net;
pub mod light_objects;
pub mod mix;
pub mod occlude_residual;
pub mod shade_objects;
pub mod shade_specular_edit;
pub mod shadow;
pub mod shadow_net;
pub mod trace_indirect;
pub mod transport;

use crate::graph::{Context, NodeError};
use crate::optics::{Sampling, Strategy};

/// Two planes of one stage must be of one size.
fn same_size(a: &str, size_a: (usize, usize), b: &str, size_b: (usize, usize)) -> Result<(), NodeError> {
    if size_a == size_b {
        return Ok(());
    }
    let (wanted, got) = (size_a, size_b);
    Err(NodeError::Failed(format!("`{b}` is {} x {}, wanted {} x {} as `{a}`", got.0, got.1, wanted.0, wanted.1)))
}

/// Ranges of the parameters that say how many samples are taken.
fn check_sampling(samples: u32, target_error: f32, max_samples: u32) -> Result<(), String> {
    for (name, value) in [("samples", samples), ("max_samples", max_samples)] {
        if !(1..=65536).contains(&value) {
            return Err(format!("{name}: wanted 1..65536, got {value}"));
        }
    }
    if (0.0..1.0).contains(&target_error) {
        Ok(())
    } else {
        Err(format!("target_error: wanted 0 or a share below 1, got {target_error}"))
    }
}

/// How samples are taken, the first round of a run with a budget being the smallest that there is.
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
