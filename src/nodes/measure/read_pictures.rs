//! `ReadPictures`: known pictures by name.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::graph::{Context, File, Node, NodeError, Scatter};
use crate::image::Picture;
use crate::{params, ports};

params! {
    /// Reads pictures of one size: renderings or photographs under single lights, as the truth of
    /// measurements.
    pub struct ReadPictures {
        /// The files by name: EXR or HDR (linear Rec.709), or PNG or JPEG (sRGB).
        files: BTreeMap<String, File> = BTreeMap::new(),
    }
}

ports! { pub input ReadPicturesIn {} }
ports! {
    pub output ReadPicturesOut {
        /// The linear pictures by name.
        picture: Scatter<Picture>,
    }
}

impl Node for ReadPictures {
    const KIND: &'static str = "ReadPictures";
    const VERSION: u32 = 1;
    type In = ReadPicturesIn;
    type Out = ReadPicturesOut;

    fn files(&mut self) -> Vec<&mut File> {
        self.files.values_mut().collect()
    }

    fn run(&self, _: ReadPicturesIn, ctx: &Context) -> Result<ReadPicturesOut, NodeError> {
        let mut pictures: Vec<(String, Arc<Picture>)> = Vec::new();
        for (name, file) in &self.files {
            ctx.check_cancelled()?;
            let picture = super::read(ctx, file)?;
            if let Some((first, other)) = pictures.first()
                && other.0.size() != picture.0.size()
            {
                let [(w, h), (width, height)] = [picture.0.size(), other.0.size()];
                let message =
                    format!("size: wanted {width} x {height} as `{first}`, got {w} x {h}");
                return Err(NodeError::BadFile {
                    path: file.location().display().to_string(),
                    message,
                });
            }
            pictures.push((name.clone(), Arc::new(picture)));
        }
        Ok(ReadPicturesOut { picture: Scatter(pictures) })
    }
}
