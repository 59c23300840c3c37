//! The stages, in the order of the paper: the list, and nothing else.

pub mod artifacts;
pub mod output;
pub mod scene;
