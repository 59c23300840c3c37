//! ReadPhoto: the photo of a scene and its camera, for scenes of which nothing else is known yet.

use std::sync::Arc;

use super::{CameraSpec, Exposure, Photograph, Shot};
use crate::geometry::Camera;
use crate::graph::{Context, File, Node, NodeError};
use crate::image::{Mask, Picture, Transfer, resize};
use crate::nodes::artifacts::Encoding;
use crate::{params, ports};

params! {
    /// Reads the photo of a scene; the scene needs no depth.
    pub struct ReadPhoto {
        /// PNG (8 or 16 bits), JPEG, HDR or EXR.
        photo: File = File::default(),
        /// How the numbers of a PNG or JPEG photo encode light; HDR and EXR are linear whatever stands here.
        transfer: Transfer = Transfer::Srgb,
        /// The photo's camera: FovX(degrees) or Pinhole(fx, fy, cx, cy in photo pixels).
        camera: CameraSpec = CameraSpec::FovX(60.0),
        /// The illuminance at which white shows 1: Lux(value).
        exposure: Option<Exposure> = None,
        /// The longer side of the working size in pixels, at least 1; a smaller photo is not enlarged.
        long_side: u32 = 320, in 1..,
    }
}

ports! { pub input ReadPhotoIn {} }
ports! {
    pub output ReadPhotoOut {
        /// Linear, the photo's size.
        photo: Arc<Picture>,
        /// Linear, working size.
        small: Arc<Picture>,
        /// Share of saturated pixels, working size.
        small_clipped: Arc<Mask>,
        /// At the photo's size.
        camera: Arc<Camera>,
        /// How the photo is stored.
        encoding: Arc<Encoding>,
    }
}

impl Node for ReadPhoto {
    const KIND: &'static str = "ReadPhoto";
    const VERSION: u32 = 1;
    type In = ReadPhotoIn;
    type Out = ReadPhotoOut;

    fn check_consistency(&self) -> Result<(), String> {
        self.shot().check()
    }

    fn files(&mut self) -> Vec<&mut File> {
        vec![&mut self.photo]
    }

    fn run(&self, _: ReadPhotoIn, ctx: &Context) -> Result<ReadPhotoOut, NodeError> {
        let Photograph { photo, clipped, small: (width, height), camera, encoding } = self.shot().read(ctx)?;
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
