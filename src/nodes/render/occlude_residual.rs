//! `OccludeResidual`: the residual light around inserted bodies and on them.

use std::sync::Arc;

use glam::{DVec3, Vec3};

use crate::geometry::Objects;
use crate::graph::{Context, Node, NodeError};
use crate::image::{Normal, Picture, Plane, Points, Shading};
use crate::optics::LightTransport;
use crate::{params, ports};

params! {
    /// The residual light that bodies leave of the room's, and their reflection of it.
    ///
    /// The residual is a uniform ambient from the unseen part of the room, as in `FitLights`. A
    /// body occludes its fraction of the hemisphere, and its reflected ambient replaces it. Without
    /// bodies the residual passes through.
    pub struct OccludeResidual {}
}

ports! {
    pub input OccludeResidualIn {
        /// Shading that no light explains.
        residual: Arc<Shading>,
        /// LightTransport of the room without bodies.
        before: Arc<LightTransport>,
        /// LightTransport of the room with bodies.
        after: Arc<LightTransport>,
        /// The surface points.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// The visible objects.
        objects: Arc<Objects>,
    }
}

ports! {
    pub output OccludeResidualOut {
        /// Shading of the room that no light explains.
        residual: Arc<Shading>,
        /// Diffuse reflection of the residual by the bodies, in the rectangle of `objects`.
        shown: Arc<Picture>,
    }
}

impl Node for OccludeResidual {
    const KIND: &'static str = "OccludeResidual";
    const VERSION: u32 = 2;
    type In = OccludeResidualIn;
    type Out = OccludeResidualOut;

    fn run(&self, inputs: OccludeResidualIn, _: &Context) -> Result<OccludeResidualOut, NodeError> {
        let OccludeResidualIn { residual, before, after, points, normal, objects } = inputs;
        if after.probes() == 0 {
            return Ok(OccludeResidualOut {
                residual,
                shown: Arc::new(Picture(Plane::new(0, 0, Vec::new()))),
            });
        }
        super::same_size("residual", residual.0.size(), "points", points.0.size())?;
        let grid = before.grid();
        let was = grid.upsample(&points, &normal, &before.ambient());
        let (is, on_probes) = after.ambient_around(&points, &normal, objects.probe_albedo.pixels());
        let sum = |plane: &Plane<Vec3>| plane.pixels().iter().map(|v| v.as_dvec3()).sum::<DVec3>();
        // The residual is one radiance times the ambient.
        let radiance = (sum(&residual.0) / sum(&was).max(DVec3::splat(1e-30))).as_vec3();
        let left = |p: usize| {
            residual.0.pixels()[p] * is.pixels()[p] / was.pixels()[p].max(Vec3::splat(1e-6))
        };
        let (w, h) = residual.0.size();
        let left = Shading(Plane::new(w, h, (0..w * h).map(left).collect()));
        let samples =
            (0..objects.points.len()).map(|s| radiance * objects.from_probes(s, &on_probes));
        let shown = Picture(objects.diffuse(&samples.collect::<Vec<_>>()));
        Ok(OccludeResidualOut { residual: Arc::new(left), shown: Arc::new(shown) })
    }
}
