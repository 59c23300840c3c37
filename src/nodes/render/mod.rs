//! From geometry and lights to unit layers.

pub mod direct;
pub mod glow;
pub mod mix;
pub mod shadow;
pub mod trace_indirect;
pub mod transport;

use crate::graph::NodeError;

/// Two planes of one stage must be of one size.
fn same_size(a: &str, size_a: (usize, usize), b: &str, size_b: (usize, usize)) -> Result<(), NodeError> {
    if size_a == size_b {
        return Ok(());
    }
    let (wanted, got) = (size_a, size_b);
    Err(NodeError::Failed(format!("`{b}` is {} x {}, wanted {} x {} as `{a}`", got.0, got.1, wanted.0, wanted.1)))
}
