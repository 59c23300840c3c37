//! From planes to files.

pub mod compose;
pub mod write;
