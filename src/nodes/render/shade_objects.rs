//! `ShadeObjects`: the diffuse reflection of one light by inserted bodies.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::Objects;
use crate::graph::{Context, Node, NodeError};
use crate::image::Picture;
use crate::nodes::artifacts::{ObjectLight, UnitIndirect};
use crate::optics::Radiance;
use crate::{params, ports};

params! {
    /// The diffuse light of one light on inserted bodies: base color x (1 - metallic) x (direct +
    /// indirect), per channel.
    ///
    /// The result is linear in the light's radiance, and no ray is traced.
    pub struct ShadeObjects {}
}

ports! {
    pub input ShadeObjectsIn {
        /// The visible objects.
        objects: Arc<Objects>,
        /// Direct light of the light on them.
        light: Arc<ObjectLight>,
        /// Unit indirect shading of the light, including that of their probes.
        indirect: Arc<UnitIndirect>,
        /// The light's radiance.
        radiance: Arc<Radiance>,
    }
}

ports! {
    pub output ShadeObjectsOut {
        /// Diffuse reflection of the bodies, in the rectangle of `objects`.
        shown: Arc<Picture>,
    }
}

impl Node for ShadeObjects {
    const KIND: &'static str = "ShadeObjects";
    const VERSION: u32 = 1;
    type In = ShadeObjectsIn;
    type Out = ShadeObjectsOut;

    fn run(&self, inputs: ShadeObjectsIn, _: &Context) -> Result<ShadeObjectsOut, NodeError> {
        let ShadeObjectsIn { objects, light, indirect, radiance } = inputs;
        let lobes = radiance.0.len();
        for (name, got) in [("light", light.lobes.len()), ("indirect", indirect.probes.len())] {
            if got != lobes {
                let message =
                    format!("`{name}` has {got} lobes of bodies, wanted {lobes} as `radiance`");
                return Err(NodeError::Failed(message));
            }
        }
        // Radiosity of each probe under all lobes.
        let mut probes = vec![Vec3::ZERO; objects.probe_albedo.len()];
        for (plane, w) in indirect.probes.iter().zip(&radiance.0) {
            probes.iter_mut().zip(plane.pixels()).for_each(|(sum, e)| *sum += *w * *e);
        }
        let at_sample = |sample: usize| {
            let direct =
                light.lobes.iter().zip(&radiance.0).map(|(plane, w)| *w * plane.pixels()[sample]);
            direct.sum::<Vec3>() + objects.from_probes(sample, &probes)
        };
        let samples: Vec<Vec3> =
            (0..objects.points.len()).into_par_iter().with_min_len(1024).map(at_sample).collect();
        Ok(ShadeObjectsOut { shown: Arc::new(Picture(objects.diffuse(&samples))) })
    }
}
