//! Materials of pixels: paint layers, finishes and textures.

pub(in crate::image) mod gloss;
pub(in crate::image) mod paint_layer;
pub(in crate::image) mod specular_edit;
pub(in crate::image) mod texture;

pub use gloss::Gloss;
pub use paint_layer::{AlphaMatte, PaintChange, PaintLayer, PaintLayers, PaintedPixel};
pub use specular_edit::{SPECULAR_EDIT, SpecularEdit};
pub use texture::Texture;

use crate::tuning::Table;

/// The constants of materials of pixels.
pub fn tuning() -> Vec<Table> {
    vec![paint_layer::PaintLayerTuning::table(), specular_edit::SpecularEditTuning::table()]
}
