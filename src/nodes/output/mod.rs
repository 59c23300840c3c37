//! From planes to files.

pub mod compose;
pub mod write;
pub mod write_planes;
