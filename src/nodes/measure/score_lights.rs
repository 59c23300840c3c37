//! `ScoreLights`: errors of the lights' positions and power against the truth.

use std::sync::Arc;

use crate::graph::{Context, Gather, Node, NodeError, above};
use crate::image::{Mask, mean_error, pairs};
use crate::nodes::artifacts::{Scores, UnitDirect};
use crate::optics::inverse::{chamfer, surface_points};
use crate::optics::{Radiance, Shape};
use crate::{params, ports};

params! {
    /// Measures each light against the true light of the same name, as IndoorLightEditing (Li et
    /// al., ECCV 2022) does.
    ///
    /// `Chamfer` is the distance in meters between 64 points on each surface, both ways, if both
    /// lights exist. `E_j` is the mean absolute difference of the unshadowed direct shading,
    /// clamped at `bright`, over channels and over pixels that show no light, if one of the two
    /// exists.
    pub struct ScoreLights {
        /// Clamp of the shading, above all that a photo shows.
        bright: f32 = 10.0, in above(0.0),
    }
}

ports! {
    pub input ScoreLightsIn {
        /// The estimated lights.
        shape: Gather<Shape>,
        /// Their radiances.
        radiance: Gather<Radiance>,
        /// Their unit shading of the true surface.
        direct: Gather<UnitDirect>,
        /// The true lights.
        true_shape: Gather<Shape>,
        /// Their radiances.
        true_radiance: Gather<Radiance>,
        /// Their unit shading of the true surface.
        true_direct: Gather<UnitDirect>,
        /// Pixels of each visible light.
        mask: Gather<Mask>,
    }
}

ports! {
    pub output ScoreLightsOut {
        /// The scores `Chamfer` and `E_j` of each light.
        scores: Arc<Scores>,
    }
}

impl Node for ScoreLights {
    const KIND: &'static str = "ScoreLights";
    const VERSION: u32 = 1;
    type In = ScoreLightsIn;
    type Out = ScoreLightsOut;

    fn run(&self, inputs: ScoreLightsIn, _: &Context) -> Result<ScoreLightsOut, NodeError> {
        let mut list = Vec::new();
        let size = |direct: &UnitDirect| direct.lobes.first().map(|lobe| lobe.size());
        let all = inputs.direct.iter().chain(inputs.true_direct.iter());
        let Some(size) = all.map(|(_, direct)| size(direct)).find_map(|size| size) else {
            return Ok(ScoreLightsOut { scores: super::scores(list) });
        };
        let counted = super::no_light(size, inputs.mask.iter())?;
        for (id, truth) in inputs.true_shape.iter() {
            let missing =
                |what: &str| NodeError::Failed(format!("light {id}: wanted its {what}, got none"));
            let shape = inputs.shape.get(id).ok_or_else(|| missing("estimated shape"))?;
            if matches!((&**shape, &**truth), (Shape::Absent, Shape::Absent)) {
                continue;
            }
            let shading = |direct: &Gather<UnitDirect>, radiance: &Gather<Radiance>| {
                let direct = direct.get(id).ok_or_else(|| missing("unit shading"))?;
                let radiance = radiance.get(id).ok_or_else(|| missing("radiance"))?;
                Ok(super::shaded(direct, None, radiance, size))
            };
            let got = shading(&inputs.direct, &inputs.radiance)?;
            let wanted = shading(&inputs.true_direct, &inputs.true_radiance)?;
            let bright = f64::from(self.bright);
            let error = mean_error(pairs(&got, &wanted, &counted), |a, b| {
                (a.min(bright) - b.min(bright)).abs()
            });
            list.push(super::score(
                id,
                "Chamfer",
                chamfer(&surface_points(shape), &surface_points(truth)),
            ));
            list.push(super::score(id, "E_j", error));
        }
        Ok(ScoreLightsOut { scores: super::scores(list) })
    }
}
