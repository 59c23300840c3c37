//! `ScoreMaterials`: materials against the truth.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Gather, Node, NodeError};
use crate::image::{
    Albedo, Mask, Normal, Roughness, normal_error, pairs, scale_invariant_error, square_error,
};
use crate::nodes::artifacts::Scores;
use crate::{params, ports};

params! {
    /// Measures materials on pixels that show no light.
    ///
    /// `albedo` is the mean squared error after one least-squares scale for the whole picture;
    /// `albedo before the fit` is the same before radiances were fitted; `normal` is the mean angle
    /// in degrees; `roughness` is the mean squared error.
    pub struct ScoreMaterials {}
}

ports! {
    pub input ScoreMaterialsIn {
        /// Estimated albedo, as `Compose` takes it.
        albedo: Arc<Albedo>,
        /// Estimated albedo, as the fit of the lights takes it.
        first: Option<Arc<Albedo>>,
        /// Estimated normals.
        normal: Option<Arc<Normal>>,
        /// Estimated roughness.
        roughness: Option<Arc<Roughness>>,
        /// True albedo.
        true_albedo: Arc<Albedo>,
        /// True normals.
        true_normal: Option<Arc<Normal>>,
        /// True roughness.
        true_roughness: Option<Arc<Roughness>>,
        /// Pixels of each visible light.
        mask: Gather<Mask>,
    }
}

ports! {
    pub output ScoreMaterialsOut {
        /// The scores of `materials`.
        scores: Arc<Scores>,
    }
}

impl Node for ScoreMaterials {
    const KIND: &'static str = "ScoreMaterials";
    const VERSION: u32 = 1;
    type In = ScoreMaterialsIn;
    type Out = ScoreMaterialsOut;

    fn run(&self, inputs: ScoreMaterialsIn, _: &Context) -> Result<ScoreMaterialsOut, NodeError> {
        let truth = &inputs.true_albedo.0;
        let size = truth.size();
        let counted = super::no_light(size, inputs.mask.iter())?;
        let same =
            |name: &str, got: (usize, usize)| super::same_size(name, got, "the true albedo", size);
        let albedo = |name: &str, albedo: &Albedo| {
            same("albedo", albedo.0.size())?;
            Ok(super::score(
                "materials",
                name,
                scale_invariant_error(pairs(&albedo.0, truth, &counted)),
            ))
        };
        let mut list = vec![albedo("albedo", &inputs.albedo)?];
        if let Some(first) = &inputs.first {
            list.push(albedo("albedo before the fit", first)?);
        }
        if let (Some(normal), Some(true_normal)) = (&inputs.normal, &inputs.true_normal) {
            same("normal", normal.0.size())?;
            same("true normal", true_normal.0.size())?;
            list.push(super::score(
                "materials",
                "normal",
                normal_error(normal, true_normal, &counted),
            ));
        }
        if let (Some(rough), Some(true_rough)) = (&inputs.roughness, &inputs.true_roughness) {
            same("roughness", rough.0.size())?;
            same("true roughness", true_rough.0.size())?;
            let [rough, true_rough] = [rough, true_rough].map(|plane| plane.0.map(Vec3::splat));
            list.push(super::score(
                "materials",
                "roughness",
                square_error(pairs(&rough, &true_rough, &counted)),
            ));
        }
        Ok(ScoreMaterialsOut { scores: super::scores(list) })
    }
}
