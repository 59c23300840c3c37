//! What an edit changes.

pub mod edit_lights;
