//! From planes to files.

pub mod write;
