//! Synthetic rooms shared by the test suites: geometry in closed form, layers by the library's own
//! stages, files as bytes.

#![allow(dead_code, reason = "each suite uses its part")]

pub mod boxes;
pub mod files;
pub mod room;
pub mod scene;
