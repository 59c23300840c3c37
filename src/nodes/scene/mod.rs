//! From files to planes.

pub mod read_scene;
