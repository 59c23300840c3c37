//! `ScorePicture`: a relit picture against the truth.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, File, Gather, Node, NodeError};
use crate::image::{Mask, Picture, Plane, mean_error, pairs, score_picture};
use crate::nodes::artifacts::Scores;
use crate::{params, ports};

params! {
    /// Scores an edit, on pixels that show no light of the photo or of the edit: `PSNR` of the 8-bit picture in dB, that of the
    /// photo as it is (`unchanged`), and `change error`: sum |got - truth| / sum |truth - photo| in linear light clipped to 0..=1; 1 is
    /// doing nothing, 0 is perfect.
    ///
    /// The photo is the sum of the lights' true pictures where there are such. The truth is a file, or the photo without the
    /// pictures of some lights.
    pub struct ScorePicture {
        /// What the edit is called.
        subject: String = String::new(),
        /// The true picture: EXR or HDR (linear, in the photo's exposure), PNG or JPEG (sRGB).
        truth: Option<File> = None,
        /// The lights that are off in the truth.
        off: Vec<String> = Vec::new(),
    }
}

ports! {
    pub input ScorePictureIn {
        /// The relit picture, linear.
        picture: Arc<Picture>,
        /// The photo, linear.
        photo: Arc<Picture>,
        /// True pictures by each light alone; their sum is the photo.
        light: Gather<Picture>,
        /// Pixels of each visible light, photo size.
        mask: Gather<Mask>,
        /// Pixels covered by the bodies of inserted lights, photo size.
        cover: Gather<Mask>,
    }
}

ports! {
    pub output ScorePictureOut {
        /// `PSNR`, `unchanged` and `change error` of `subject`.
        scores: Arc<Scores>,
    }
}

/// Beyond this share of the photo, the pictures of its lights are not those of this photo.
const APART: f64 = 0.1;

impl Node for ScorePicture {
    const KIND: &'static str = "ScorePicture";
    const VERSION: u32 = 1;
    type In = ScorePictureIn;
    type Out = ScorePictureOut;

    fn files(&mut self) -> Vec<&mut File> {
        self.truth.iter_mut().collect()
    }

    fn run(&self, inputs: ScorePictureIn, ctx: &Context) -> Result<ScorePictureOut, NodeError> {
        let size = inputs.photo.0.size();
        super::same_size("picture", inputs.picture.0.size(), "the photo", size)?;
        let counted = super::no_light(size, inputs.mask.iter().chain(inputs.cover.iter()))?;
        let photo = self.photo(&inputs, &counted)?;
        let truth = match &self.truth {
            Some(file) => {
                let truth = super::read(ctx, file)?.0;
                super::same_size("size", truth.size(), "the photo", size).map_err(|e| NodeError::BadFile {
                    path: file.location().display().to_string(),
                    message: e.to_string(),
                })?;
                truth
            }
            None => {
                let mut truth = photo.clone();
                for id in &self.off {
                    let light = inputs.light.get(id).ok_or_else(|| {
                        NodeError::BadParameter(format!("off: wanted lights with a true picture, got `{id}`"))
                    })?;
                    truth.pixels_mut().iter_mut().zip(light.0.pixels()).for_each(|(truth, light)| *truth -= *light);
                }
                truth
            }
        };
        let score = score_picture(&inputs.picture.0, &truth, &photo, &counted);
        let figure = |measure: &str, value: Option<f64>| super::score(&self.subject, measure, value);
        Ok(ScorePictureOut {
            scores: super::scores([
                figure("PSNR", score.map(|s| s.psnr)),
                figure("unchanged", score.map(|s| s.unchanged)),
                figure("change error", score.and_then(|s| s.change)),
            ]),
        })
    }
}

impl ScorePicture {
    /// The linear photo: the sum of its lights, if they are known.
    fn photo(&self, inputs: &ScorePictureIn, counted: &Plane<bool>) -> Result<Plane<Vec3>, NodeError> {
        let Some(sum) = super::sum(&inputs.light)? else { return Ok(inputs.photo.0.clone()) };
        super::same_size("the true pictures of lights", sum.size(), "the photo", inputs.photo.0.size())?;
        let clip = |x: f64| x.clamp(0.0, 1.0);
        let apart = mean_error(pairs(&sum, &inputs.photo.0, counted), |a, b| (clip(a) - clip(b)).abs());
        let level = mean_error(pairs(&sum, &inputs.photo.0, counted), |_, b| clip(b));
        match apart.zip(level) {
            Some((apart, level)) if apart > APART * level => {
                let names: Vec<&str> = inputs.light.iter().map(|(id, _)| id).collect();
                Err(NodeError::Failed(format!(
                    "the true pictures of {} together are {:.0} % off the photo: wanted one of each light, in the photo's exposure",
                    names.join(", "),
                    100.0 * apart / level
                )))
            }
            _ => Ok(sum),
        }
    }
}
