//! `ScoreDirect`: direct light and shadows against the truth.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Gather, Node, NodeError};
use crate::image::{Mask, Picture, Plane, log_error, luminance, pairs, scale_invariant_error};
use crate::nodes::artifacts::{Scores, UnitDirect, Visibility};
use crate::optics::Radiance;
use crate::{params, ports};

params! {
    /// Measures `E_d` and `shadow` as IndoorLightEditing (Li et al., ECCV 2022) defines them, on
    /// pixels that show no light.
    ///
    /// `E_d` is the mean squared difference of log(1 + direct shading), shadows included, of all
    /// lights together. `shadow`, per light, is the mean squared error of the visibility of
    /// luminance after least-squares scaling. The true visibility is the ratio of the true direct
    /// shading to the unshadowed shading of the true light, where that exceeds `faint` of its mean.
    pub struct ScoreDirect {
        /// Least unshadowed shading at which a light's shadow is measured, as a fraction of its
        /// mean.
        faint: f32 = 0.01, in 0.0..1.0,
    }
}

ports! {
    pub input ScoreDirectIn {
        /// Unit direct shading of each estimated light.
        direct: Gather<UnitDirect>,
        /// Visibility of each estimated light.
        visibility: Gather<Visibility>,
        /// Radiance of each estimated light.
        radiance: Gather<Radiance>,
        /// True direct shading (irradiance / pi) of each light, shadows included.
        truth: Gather<Picture>,
        /// Unit direct shading of the true lights.
        true_direct: Gather<UnitDirect>,
        /// Radiances of the true lights.
        true_radiance: Gather<Radiance>,
        /// Pixels of each visible light.
        mask: Gather<Mask>,
    }
}

ports! {
    pub output ScoreDirectOut {
        /// `E_d` of `all lights`, `shadow` of each.
        scores: Arc<Scores>,
    }
}

impl Node for ScoreDirect {
    const KIND: &'static str = "ScoreDirect";
    const VERSION: u32 = 1;
    type In = ScoreDirectIn;
    type Out = ScoreDirectOut;

    fn run(&self, inputs: ScoreDirectIn, _: &Context) -> Result<ScoreDirectOut, NodeError> {
        let size = |direct: &UnitDirect| direct.lobes.first().map(|lobe| lobe.size());
        let all = inputs.direct.iter().chain(inputs.true_direct.iter());
        let Some(size) = all.map(|(_, direct)| size(direct)).find_map(|size| size) else {
            return Ok(ScoreDirectOut { scores: super::scores([]) });
        };
        let counted = super::no_light(size, inputs.mask.iter())?;
        let mut list = Vec::new();
        let mut got = Plane::filled(size.0, size.1, Vec3::ZERO);
        for (id, direct) in inputs.direct.iter() {
            let missing =
                |what: &str| NodeError::Failed(format!("light {id}: wanted its {what}, got none"));
            let lit = &inputs.visibility.get(id).ok_or_else(|| missing("visibility"))?.lit;
            let radiance = inputs.radiance.get(id).ok_or_else(|| missing("radiance"))?;
            let shadowed = super::shaded(direct, Some(lit), radiance, size);
            got.pixels_mut().iter_mut().zip(shadowed.pixels()).for_each(|(sum, e)| *sum += *e);
            let known =
                (inputs.truth.get(id), inputs.true_direct.get(id), inputs.true_radiance.get(id));
            if let (Some(truth), Some(true_direct), Some(true_radiance)) = known {
                let truth = super::fitted(id, &truth.0, size)?;
                let open = super::shaded(direct, None, radiance, size);
                let true_open = super::shaded(true_direct, None, true_radiance, size);
                list.push(super::score(
                    id,
                    "shadow",
                    self.shadow([&shadowed, &open, &truth, &true_open], &counted),
                ));
            }
        }
        let truth = super::sum(&inputs.truth)?
            .map(|sum| super::fitted("true direct shading", &sum, size))
            .transpose()?;
        let error = truth.and_then(|truth| log_error(pairs(&got, &truth, &counted)));
        list.push(super::score("all lights", "E_d", error));
        Ok(ScoreDirectOut { scores: super::scores(list) })
    }
}

impl ScoreDirect {
    /// Error of the visible fraction, from the shadowed and the unshadowed shading: estimated,
    /// true.
    fn shadow(
        &self,
        [got, got_open, truth, true_open]: [&Plane<Vec3>; 4],
        counted: &Plane<bool>,
    ) -> Option<f64> {
        let level = |plane: &Plane<Vec3>| {
            plane.pixels().iter().map(|e| f64::from(luminance(*e))).sum::<f64>()
                / plane.len() as f64
        };
        let faint = (f64::from(self.faint) * level(true_open)) as f32;
        let places = (0..got.len()).filter(|&i| {
            let [open, true_open] = [got_open, true_open].map(|plane| luminance(plane.pixels()[i]));
            counted.pixels()[i] && open > 0.0 && true_open > faint
        });
        let share = |part: &Plane<Vec3>, whole: &Plane<Vec3>, i: usize| {
            f64::from((luminance(part.pixels()[i]) / luminance(whole.pixels()[i])).clamp(0.0, 1.0))
        };
        scale_invariant_error(places.map(|i| (share(got, got_open, i), share(truth, true_open, i))))
    }
}
