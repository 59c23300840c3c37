//! Materials of pixels: paint layers, finishes and textures.

pub(in crate::image) mod coat;
pub(in crate::image) mod finish;
pub(in crate::image) mod texture;

pub use coat::{Coat, Coated, Coats, Matte, Repaint};
pub use finish::{DIELECTRIC, Finish};
pub use texture::Texture;
