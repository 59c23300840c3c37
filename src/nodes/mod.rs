//! The stages, in the order of the paper: the list, and nothing else.

pub mod artifacts;
pub mod output;
pub mod scene;

use crate::graph::Registry;

/// All stages.
pub fn registry() -> Registry {
    Registry::new().with::<scene::read_scene::ReadScene>().with::<output::write::Write>()
}
