//! From files to the seen room.

pub mod mesh;
