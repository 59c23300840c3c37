//! `LightObjects`: the direct light on inserted bodies.

use std::sync::Arc;

use super::SAMPLES;
use crate::geometry::{Objects, SceneMesh};
use crate::graph::{Context, Node, NodeError};
use crate::nodes::artifacts::ObjectLight;
use crate::optics::{Sampling, Shape, arriving};
use crate::{params, ports};

params! {
    /// Direct light of one light on inserted bodies, per lobe of unit radiance, with the shadows
    /// that room and bodies cast on them.
    ///
    /// Light is computed at the samples that the camera sees, and for bounces at probes all over
    /// the bodies.
    pub struct LightObjects {
        /// Shadow rays per receiver and lobe; samples of lights without a closed form.
        samples: u32 = 16, in SAMPLES,
        /// Seed of the random numbers.
        seed: u64 = 0,
    }
}

ports! {
    pub input LightObjectsIn {
        /// The visible objects.
        objects: Arc<Objects>,
        /// The room with the objects in it.
        mesh: Arc<SceneMesh>,
        /// The light.
        shape: Arc<Shape>,
    }
}

ports! {
    pub output LightObjectsOut {
        /// Direct light at samples and probes.
        light: Arc<ObjectLight>,
    }
}

impl Node for LightObjects {
    const KIND: &'static str = "LightObjects";
    const VERSION: u32 = 1;
    type In = LightObjectsIn;
    type Out = LightObjectsOut;

    fn run(&self, inputs: LightObjectsIn, ctx: &Context) -> Result<LightObjectsOut, NodeError> {
        let LightObjectsIn { objects, mesh, shape } = inputs;
        let stop = || ctx.out_of_time();
        let sampling = Sampling::fixed(self.samples as usize, self.seed);
        // The camera sees smooth surfaces: every second sample along each axis, and the rest from
        // around.
        let (lobes, rays) =
            arriving(&mesh, &objects.points, &objects.normals, &shape, None, (sampling, 2), &stop);
        ctx.check_cancelled()?;
        let probes = mesh.bodies().probes();
        let (probes, more) =
            arriving(&mesh, &probes.points, &probes.normals, &shape, None, (sampling, 1), &stop);
        ctx.check_cancelled()?;
        ctx.count_rays(rays + more);
        Ok(LightObjectsOut {
            light: Arc::new(ObjectLight { lobes, probes, albedo: objects.probe_albedo.clone() }),
        })
    }
}
