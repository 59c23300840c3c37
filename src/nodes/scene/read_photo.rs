//! `ReadPhoto`: the photo of a scene and its camera, for scenes without depth.

use std::sync::Arc;

use super::{CameraSpec, Exposure, Photograph, Shot};
use crate::geometry::Camera;
use crate::graph::{Context, File, Node, NodeError};
use crate::image::{Mask, Picture, Transfer, resize};
use crate::nodes::artifacts::Encoding;
use crate::{params, ports};

params! {
    /// Reads the photo of a scene, which needs no depth.
    pub struct ReadPhoto {
        /// The photo: PNG (8 or 16 bits), JPEG, WebP, HDR or EXR.
        photo: File = File::default(),
        /// Transfer function of a PNG or JPEG photo. HDR and EXR are always linear.
        transfer: Transfer = Transfer::Srgb,
        /// The photo's camera: FovX(degrees) or Pinhole(fx, fy, cx, cy in photo pixels).
        camera: CameraSpec = CameraSpec::FovX(60.0),
        /// Illuminance of a white surface of value 1: Lux(value).
        exposure: Option<Exposure> = None,
        /// Longer side of the working size, pixels. A smaller photo is not enlarged.
        long_side: u32 = 320, in 1..,
    }
}

ports! { pub input ReadPhotoIn {} }
ports! {
    pub output ReadPhotoOut {
        /// The linear photo at its own size.
        photo: Arc<Picture>,
        /// The linear photo at working size.
        small: Arc<Picture>,
        /// Fraction of saturated pixels, working size.
        small_clipped: Arc<Mask>,
        /// The camera at the photo's size.
        camera: Arc<Camera>,
        /// Encoding of the photo.
        encoding: Arc<Encoding>,
    }
}

impl Node for ReadPhoto {
    const KIND: &'static str = "ReadPhoto";
    const VERSION: u32 = 4;
    type In = ReadPhotoIn;
    type Out = ReadPhotoOut;

    fn check_consistency(&self) -> Result<(), String> {
        self.shot().check()
    }

    fn files(&mut self) -> Vec<&mut File> {
        vec![&mut self.photo]
    }

    fn run(&self, _: ReadPhotoIn, ctx: &Context) -> Result<ReadPhotoOut, NodeError> {
        let Photograph { photo, clipped, small: (width, height), camera, encoding } =
            self.shot().read(ctx)?;
        Ok(ReadPhotoOut {
            small: Arc::new(Picture(resize(&photo.0, width, height))),
            small_clipped: Arc::new(Mask(resize(&clipped.0, width, height))),
            photo: Arc::new(photo),
            camera: Arc::new(camera),
            encoding: Arc::new(encoding),
        })
    }
}

impl ReadPhoto {
    fn shot(&self) -> Shot<'_> {
        let &ReadPhoto { ref photo, transfer, camera, exposure, long_side } = self;
        Shot { photo, transfer, camera, exposure, long_side }
    }
}
