//! Picture files: EXR, PNG, JPEG, WebP, HDR and, by the feature `heic`, HEIC; depth in these, in
//! NPY, NPZ, PFM and TIFF.

pub(in crate::image) mod color_profile;
pub(in crate::image) mod depth;
pub(in crate::image) mod exif_block;
pub(in crate::image) mod exr_read;
pub(in crate::image) mod exr_write;
pub(in crate::image) mod fast_zlib;
pub(in crate::image) mod gain_map;
#[cfg(feature = "heic")]
pub(in crate::image) mod heif;
pub(in crate::image) mod jpeg_segments;
pub(in crate::image) mod npy;
pub(in crate::image) mod photo_header;
pub(in crate::image) mod png_write;
pub(in crate::image) mod provenance;
pub(in crate::image) mod raster;
pub(in crate::image) mod read;
pub(in crate::image) mod source;
pub(in crate::image) mod turned_photo;
pub(in crate::image) mod xmp;

pub use depth::{
    CONFIDENCE, DepthFile, Intrinsics, Measure, polycam, read_depth, read_depth_file, record3d,
    stray_scanner,
};
pub use exif_block::carried_exif;
pub use exr_read::{ExrFile, read_channels, read_layers};
pub use exr_write::{Compression, ExrLayers};
pub use npy::read_maps;
pub use photo_header::{Lens, PhotoHeader, read_photo_header};
pub use png_write::{PngSamples, write_png};
pub use provenance::{MAX_PROVENANCE, read_provenance, with_provenance, without_provenance};
pub use raster::Bits;
pub use read::{Photo, read_mask, read_normal, read_photo};
pub use source::{MAX_BYTES, MAX_PIXELS, NamedBytes, ReadError};
pub use turned_photo::turned_photo;
