//! `ScoreShading`: the shading by all lights against the truth.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Gather, Node, NodeError};
use crate::image::{Albedo, Mask, Picture, Plane, Shading, log_error, pairs};
use crate::nodes::artifacts::Scores;
use crate::{params, ports};

params! {
    /// `E`: mean squared difference of log(1 + shading), as IndoorLightEditing (Li et al., ECCV 2022) has it, of all lights
    /// together with all their indirect light.
    ///
    /// The true shading is the sum of the lights' true pictures over the true albedo, at pixels that show no light and whose albedo
    /// exceeds `least_albedo` in every channel; what shines there by gloss is in it too.
    pub struct ScoreShading {
        /// Darker surfaces say little of what falls on them; 0..1.
        least_albedo: f32 = 0.05,
    }
}

ports! {
    pub input ScoreShadingIn {
        /// Shading by each light as estimated.
        light: Gather<Shading>,
        /// Shading that no light explains.
        rest: Arc<Shading>,
        /// True pictures by each light alone; their sum is the photo.
        truth: Gather<Picture>,
        /// True albedo.
        albedo: Arc<Albedo>,
        /// Pixels of each visible light.
        mask: Gather<Mask>,
    }
}

ports! {
    pub output ScoreShadingOut {
        /// `E` of `all lights`.
        scores: Arc<Scores>,
    }
}

impl Node for ScoreShading {
    const KIND: &'static str = "ScoreShading";
    const VERSION: u32 = 1;
    type In = ScoreShadingIn;
    type Out = ScoreShadingOut;

    fn check(&self) -> Result<(), String> {
        if (0.0..1.0).contains(&self.least_albedo) {
            Ok(())
        } else {
            Err(format!("least_albedo: wanted 0..1, got {}", self.least_albedo))
        }
    }

    fn run(&self, inputs: ScoreShadingIn, _: &Context) -> Result<ScoreShadingOut, NodeError> {
        let size = inputs.rest.0.size();
        let albedo = &inputs.albedo.0;
        super::same_size("albedo", albedo.size(), "the shading", size)?;
        let mut got = inputs.rest.0.clone();
        for (id, light) in inputs.light.iter() {
            super::same_size(id, light.0.size(), "the rest", size)?;
            got.pixels_mut().iter_mut().zip(light.0.pixels()).for_each(|(sum, e)| *sum += *e);
        }
        let Some(photo) = super::sum(&inputs.truth)? else {
            return Err(NodeError::Failed("truth: wanted a picture of each light, got none".into()));
        };
        let photo = super::fitted("the true pictures", &photo, size)?;
        let mut counted = super::no_light(size, inputs.mask.iter())?;
        counted
            .pixels_mut()
            .iter_mut()
            .zip(albedo.pixels())
            .for_each(|(counted, a)| *counted &= a.min_element() > self.least_albedo);
        let truth: Vec<Vec3> =
            photo.pixels().iter().zip(albedo.pixels()).map(|(i, a)| *i / a.max(Vec3::splat(1e-3))).collect();
        let truth = Plane::new(size.0, size.1, truth);
        let error = log_error(pairs(&got, &truth, &counted));
        Ok(ScoreShadingOut { scores: super::scores([super::score("all lights", "E", error)]) })
    }
}
