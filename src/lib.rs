//! `relight`: one indoor photograph in, the same room under other light out.

pub mod files;
pub mod geometry;
pub mod graph;
pub mod image;
pub mod nodes;
pub mod optics;
