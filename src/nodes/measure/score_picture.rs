//! `ScorePicture`: a relit picture against the truth.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, File, Gather, Node, NodeError};
use crate::image::{
    self, Mask, Picture, Plane, mean_error, pairs, score_picture, score_saturation,
};
use crate::nodes::artifacts::Scores;
use crate::tuning::tuning;
use crate::{params, ports};

params! {
    /// Measures an edited picture against the truth, on pixels that show no light of the photo or
    /// of the edit.
    ///
    /// `PSNR` is that of the 8-bit picture in dB; `unchanged` is the `PSNR` of the photo itself.
    /// `change error` is sum |got - truth| / sum |truth - photo| in linear light clipped to 0..=1:
    /// 1 for the unchanged photo, 0 for a perfect edit.
    ///
    /// `saturated`, `band` and `elsewhere` are mean absolute differences in 8-bit steps: where the
    /// photo is saturated, up to 20 pixels from there, and elsewhere. `step` is the mean difference
    /// of neighbors at the edge of saturated regions over that of the truth.
    ///
    /// The photo is the sum of the lights' true pictures, if they are given. The truth is a file,
    /// or the photo minus the pictures of some lights. All pictures are compared at the size of the
    /// truth, which may be smaller than the photo. Where a camera recorded another value than the
    /// sum of the lights, by noise, sharpening or JPEG, the truth is multiplied by the same ratio.
    /// The same holds for clipped and dark pixels (below 0.02) whose light the edit keeps to 2 %.
    pub struct ScorePicture {
        /// Name of the edit in the scores.
        subject: String = String::new(),
        /// The true picture: EXR or HDR (linear, in the photo's exposure), PNG or JPEG (sRGB).
        truth: Option<File> = None,
        /// Lights that are switched off in the truth.
        off: Vec<String> = Vec::new(),
    }
}

ports! {
    pub input ScorePictureIn {
        /// The edited picture, linear.
        picture: Arc<Picture>,
        /// The photo, linear.
        photo: Arc<Picture>,
        /// True pictures by each light alone, which sum to the photo.
        light: Gather<Picture>,
        /// Pixels of each visible light, photo size.
        mask: Gather<Mask>,
        /// Pixels covered by the bodies of inserted lights, photo size.
        coverage: Gather<Mask>,
    }
}

ports! {
    pub output ScorePictureOut {
        /// The scores of `subject`. A measure without pixels is left out.
        scores: Arc<Scores>,
    }
}

tuning! {
    /// Constants of the score of a relit picture.
    pub const TUNING: ScorePictureTuning {
        /// Range of light in which a photo shows the response of its camera: not lost in noise and
        /// below the shoulder of the tone curve.
        measured: [f32; 2] = [0.02, 0.8],
            unit "fraction of white", source Taste, effect "a wider range scores noise and the tone curve";
        /// Least and largest response of a camera there.
        response: [f32; 2] = [0.5, 2.0],
            unit "photo over the true light", source Taste,
            effect "a wider range forgives more differences between photo and truth";
        /// Relative difference up to which two pictures show the same light.
        same: f32 = 0.02,
            unit "1", source Derived("path-traced pictures are denoised to about 1 %"),
            effect "a larger value takes more of an edit for unchanged";
        /// Mean difference above which the pictures of the lights do not belong to the photo.
        apart: f64 = 0.1,
            unit "fraction of the mean of the photo", source Taste,
            effect "a larger value accepts pictures of other exposures";
    }
}

impl Node for ScorePicture {
    const KIND: &'static str = "ScorePicture";
    const VERSION: u32 = 3;
    type In = ScorePictureIn;
    type Out = ScorePictureOut;

    fn files(&mut self) -> Vec<&mut File> {
        self.truth.iter_mut().collect()
    }

    fn run(&self, inputs: ScorePictureIn, ctx: &Context) -> Result<ScorePictureOut, NodeError> {
        let full = inputs.photo.0.size();
        super::same_size("picture", inputs.picture.0.size(), "the photo", full)?;
        let file = self
            .truth
            .as_ref()
            .map(|file| super::read(ctx, file).map(|truth| (file, truth.0)))
            .transpose()?;
        let sum = super::sum(&inputs.light)?;
        if let Some(sum) = &sum {
            not_larger("the true pictures of lights", sum.size(), full)?;
        }
        if let Some((file, truth)) = &file {
            let other = sum.as_ref().map_or(Ok(()), |sum| {
                super::same_size("size", truth.size(), "`pictures`", sum.size())
            });
            not_larger("size", truth.size(), full).and(other).map_err(|e| NodeError::BadFile {
                path: file.location().display().to_string(),
                message: e.to_string(),
            })?;
        }
        let size = sum.as_ref().or(file.as_ref().map(|(_, truth)| truth)).map_or(full, Plane::size);
        let counted = uncovered(&inputs, full, size)?;
        let fitted = |picture: &Picture| image::resize(&picture.0, size.0, size.1);
        let picture = fitted(&inputs.picture);
        let taken = fitted(&inputs.photo);
        let is_known = sum.is_some();
        let mut photo = whole_photo(&inputs.light, sum, &taken, &counted)?;
        let mut truth = match file {
            Some((_, truth)) => truth,
            None => {
                let mut truth = photo.clone();
                for id in &self.off {
                    let light = inputs.light.get(id).ok_or_else(|| {
                        NodeError::BadParameter(format!(
                            "off: wanted lights with a true picture, got `{id}`"
                        ))
                    })?;
                    truth
                        .pixels_mut()
                        .iter_mut()
                        .zip(light.0.pixels())
                        .for_each(|(truth, light)| *truth -= *light);
                }
                truth
            }
        };
        if is_known {
            let response = response(&taken, &photo, &truth);
            for plane in [&mut photo, &mut truth] {
                plane
                    .pixels_mut()
                    .iter_mut()
                    .zip(response.pixels())
                    .for_each(|(light, factor)| *light *= *factor);
            }
        }
        let score = score_picture(&picture, &truth, &photo, &counted);
        let saturation = score_saturation(&picture, &truth, &taken, &counted);
        let figure =
            |measure: &str, value: Option<f64>| super::score(&self.subject, measure, value);
        Ok(ScorePictureOut {
            scores: super::scores([
                figure("PSNR", score.map(|s| s.psnr)),
                figure("unchanged", score.map(|s| s.unchanged)),
                figure("change error", score.and_then(|s| s.change)),
                figure("saturated", saturation.saturated),
                figure("band", saturation.band),
                figure("elsewhere", saturation.elsewhere),
                figure("step", saturation.step),
            ]),
        })
    }
}

/// A picture of the truth has the photo's aspect ratio, and at most its size.
fn not_larger(name: &str, got: (usize, usize), photo: (usize, usize)) -> Result<(), NodeError> {
    if got.0 <= photo.0 && image::same_aspect(got, photo) {
        return Ok(());
    }
    super::same_size(name, got, "the photo", photo)
}

/// The pixels of the truth's size whose part of the photo shows no light of the photo or of the
/// edit.
fn uncovered(
    inputs: &ScorePictureIn,
    full: (usize, usize),
    size: (usize, usize),
) -> Result<Plane<bool>, NodeError> {
    let lit = super::no_light(full, inputs.mask.iter().chain(inputs.coverage.iter()))?
        .map(|none| f32::from(!none));
    Ok(image::resize(&lit, size.0, size.1).map(|share| share == 0.0))
}

/// The factor that the camera gives to each pixel's light: the photo as `taken` over the `sum` of
/// the lights where that is in `TUNING.measured`, or where the edit leaves the light as it is to
/// `TUNING.same`; 1 elsewhere.
fn response(taken: &Plane<Vec3>, sum: &Plane<Vec3>, truth: &Plane<Vec3>) -> Plane<Vec3> {
    Plane::from_fn(sum.width(), sum.height(), |x, y| {
        let [taken, sum, truth] = [taken, sum, truth].map(|plane| plane.get(x, y).to_array());
        Vec3::from_array([0, 1, 2].map(|c| {
            if sum[c] > 0.0 && (truth[c] - sum[c]).abs() <= TUNING.same * sum[c] {
                taken[c] / sum[c]
            } else if (TUNING.measured[0]..=TUNING.measured[1]).contains(&sum[c]) {
                (taken[c] / sum[c]).clamp(TUNING.response[0], TUNING.response[1])
            } else {
                1.0
            }
        }))
    })
}

/// The linear photo: the `sum` of the pictures of its lights, if they are known, else the photo as
/// it was `taken`.
fn whole_photo(
    light: &Gather<Picture>,
    sum: Option<Plane<Vec3>>,
    taken: &Plane<Vec3>,
    counted: &Plane<bool>,
) -> Result<Plane<Vec3>, NodeError> {
    let Some(sum) = sum else { return Ok(taken.clone()) };
    let clip = |x: f64| x.clamp(0.0, 1.0);
    let apart = mean_error(pairs(&sum, taken, counted), |a, b| (clip(a) - clip(b)).abs());
    let level = mean_error(pairs(&sum, taken, counted), |_, b| clip(b));
    match apart.zip(level) {
        Some((apart, level)) if apart > TUNING.apart * level => {
            let names: Vec<&str> = light.iter().map(|(id, _)| id).collect();
            Err(NodeError::Failed(format!(
                "the true pictures of {} together are {:.0} % off the photo: wanted one of each light, in the photo's exposure",
                names.join(", "),
                100.0 * apart / level
            )))
        }
        _ => Ok(sum),
    }
}
