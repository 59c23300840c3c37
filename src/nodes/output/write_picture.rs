//! `WritePicture`: the relit picture alone, as `picture.png`: one frame of a sequence.

use std::sync::Arc;

use crate::graph::{Context, Node, NodeError};
use crate::image::{Picture, PngSamples};
use crate::nodes::artifacts::{Encoding, Files};
use crate::{params, ports};

params! {
    /// Writes the picture as PNG and nothing else: the same `picture.png` as `Write` gives, without
    /// its layers.
    pub struct WritePicture {}
}

ports! {
    pub input WritePictureIn {
        /// The linear picture at the photo's size, not clamped.
        picture: Arc<Picture>,
        /// Encoding of the photo.
        encoding: Arc<Encoding>,
    }
}

ports! {
    pub output WritePictureOut {
        /// `picture.png`.
        files: Arc<Files>,
    }
}

impl Node for WritePicture {
    const KIND: &'static str = "WritePicture";
    const VERSION: u32 = 2;
    type In = WritePictureIn;
    type Out = WritePictureOut;

    fn run(&self, inputs: WritePictureIn, _: &Context) -> Result<WritePictureOut, NodeError> {
        let plane = &inputs.picture.0;
        if let Some(at) = plane.pixels().iter().position(|c| !c.is_finite()) {
            let (x, y, got) = (at % plane.width(), at / plane.width(), plane.pixels()[at]);
            return Err(NodeError::Failed(format!(
                "picture: wanted finite numbers, got {got} at pixel ({x}, {y})"
            )));
        }
        let Encoding { transfer, sixteen_bit, ref exif, .. } = *inputs.encoding;
        let png = PngSamples::new(&inputs.picture, transfer, sixteen_bit).into_file(exif);
        Ok(WritePictureOut { files: Arc::new(Files(vec![("picture.png".into(), png)])) })
    }
}
