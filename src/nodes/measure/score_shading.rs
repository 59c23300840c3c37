//! `ScoreShading`: the shading by all lights against the truth.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Gather, Node, NodeError};
use crate::image::{Albedo, Mask, Picture, Plane, Shading, log_error, pairs};
use crate::nodes::artifacts::Scores;
use crate::{params, ports};

params! {
    /// Measures `E`: the mean squared difference of log(1 + shading) of all lights with all
    /// indirect light, as IndoorLightEditing (Li et al., ECCV 2022) defines it.
    ///
    /// The true shading is the sum of the lights' true pictures, or else the photo where it is not
    /// saturated, over the true albedo. It is measured on pixels that show no light and whose
    /// albedo exceeds `least_albedo` in every channel; it includes specular reflection.
    pub struct ScoreShading {
        /// Least albedo of the measured pixels, as darker surfaces hardly determine their shading.
        least_albedo: f32 = 0.05, in 0.0..1.0,
    }
}

ports! {
    pub input ScoreShadingIn {
        /// Shading by each estimated light.
        light: Gather<Shading>,
        /// Residual shading, which no light explains.
        residual: Arc<Shading>,
        /// The linear photo, working size.
        photo: Arc<Picture>,
        /// Fraction of saturated pixels.
        clipped: Arc<Mask>,
        /// True pictures by each light alone, if there are any; they sum to the photo.
        truth: Gather<Picture>,
        /// True albedo.
        albedo: Arc<Albedo>,
        /// Pixels of each visible light.
        mask: Gather<Mask>,
    }
}

ports! {
    pub output ScoreShadingOut {
        /// The score `E` of `all lights`.
        scores: Arc<Scores>,
    }
}

impl Node for ScoreShading {
    const KIND: &'static str = "ScoreShading";
    const VERSION: u32 = 1;
    type In = ScoreShadingIn;
    type Out = ScoreShadingOut;

    fn run(&self, inputs: ScoreShadingIn, _: &Context) -> Result<ScoreShadingOut, NodeError> {
        let size = inputs.residual.0.size();
        let albedo = &inputs.albedo.0;
        super::same_size("albedo", albedo.size(), "the shading", size)?;
        let mut got = inputs.residual.0.clone();
        for (id, light) in inputs.light.iter() {
            super::same_size(id, light.0.size(), "the residual", size)?;
            got.pixels_mut().iter_mut().zip(light.0.pixels()).for_each(|(sum, e)| *sum += *e);
        }
        let clipped = ("clipped", &inputs.clipped);
        let (photo, counted) = match super::sum(&inputs.truth)? {
            Some(sum) => (
                super::fitted("the true pictures", &sum, size)?,
                super::no_light(size, inputs.mask.iter())?,
            ),
            None => (
                inputs.photo.0.clone(),
                super::no_light(size, inputs.mask.iter().chain([clipped]))?,
            ),
        };
        super::same_size("photo", photo.size(), "the shading", size)?;
        let bright =
            |(i, a): (usize, &Vec3)| counted.pixels()[i] && a.min_element() > self.least_albedo;
        let counted =
            Plane::new(size.0, size.1, albedo.pixels().iter().enumerate().map(bright).collect());
        let truth: Vec<Vec3> = photo
            .pixels()
            .iter()
            .zip(albedo.pixels())
            .map(|(i, a)| *i / a.max(Vec3::splat(1e-3)))
            .collect();
        let truth = Plane::new(size.0, size.1, truth);
        let error = log_error(pairs(&got, &truth, &counted));
        Ok(ScoreShadingOut { scores: super::scores([super::score("all lights", "E", error)]) })
    }
}
