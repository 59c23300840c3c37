//! `relight`: one indoor photograph in, the same room under other light out.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::print_stderr, clippy::print_stdout)]
#![warn(clippy::unwrap_used)]

pub mod files;
mod formats;
pub mod geometry;
pub mod graph;
pub mod image;
pub mod net;
pub mod nodes;
pub mod optics;
pub mod tuning;
