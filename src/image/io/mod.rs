//! Picture files: EXR, PNG, JPEG, HDR and NPY.

pub(in crate::image) mod exr_read;
pub(in crate::image) mod exr_write;
pub(in crate::image) mod npy;
pub(in crate::image) mod png_write;
pub(in crate::image) mod read;

pub use exr_read::{ExrFile, read_layers};
pub use exr_write::{Compression, ExrLayers};
pub use npy::read_maps;
pub use png_write::{PngSamples, write_png};
pub use read::{Bits, MAX_BYTES, MAX_PIXELS, Photo, ReadError, Source, read_depth, read_mask, read_normal, read_photo};
