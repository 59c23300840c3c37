//! The laboratory of `relight`: experiments, their errors, tables and plots.
//!
//! This crate contains everything of `relight bench` and `relight eval` that needs neither the
//! engine nor a stage. The command runs graphs for it, through [`bench::Renderer`] or by handing
//! over [`eval::Figure`]s; so the dependency points from the command to the laboratory, and a build
//! without the feature `lab` contains nothing of it.

#![forbid(unsafe_code)]
#![warn(clippy::print_stderr, clippy::print_stdout, clippy::unwrap_used)]

pub mod bench;
pub mod eval;
mod table;
