//! Light through the seen room.

pub mod glow;
pub mod mix;
