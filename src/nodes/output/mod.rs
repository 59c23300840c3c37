//! From planes to files.

pub mod compose;
pub mod write;
pub mod write_depth;
pub mod write_estimates;
pub mod write_planes;

use crate::graph::NodeError;

/// A plane that is written must have the size of another.
fn same_size(name: &str, got: (usize, usize), other: &str, wanted: (usize, usize)) -> Result<(), NodeError> {
    if got == wanted {
        return Ok(());
    }
    Err(NodeError::Failed(format!("{name}: wanted the {other}'s {wanted:?} pixels, got {got:?}")))
}
