//! From files to the seen room.

pub mod mesh;

pub mod read_scene;
