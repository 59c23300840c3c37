//! `PaintSpecular`: what surfaces with a new finish reflect.

use std::sync::Arc;

use crate::geometry::{Camera, Objects, SceneMesh};
use crate::graph::{Context, Gather, Node, NodeError};
use crate::image::{Depth, Finish, Mask, Normal, Points};
use crate::optics::{Lighting, Part, Polish, SeenPlaces, Shape, Surround, places, reflections};
use crate::{params, ports};

params! {
    /// Computes the reflections on regions of new roughness or specular level, as `InsertSpecular`
    /// does for objects, and the reflections before the edit.
    ///
    /// The photo contains the old reflection; `Compose` replaces it by the new one. Lobes wider
    /// than a working pixel are computed at working size, narrower ones at the photo's.
    pub struct PaintSpecular {
        /// Rays per surface point, and samples of each light per point. A mirror takes one, and the
        /// total is at most 4 million.
        rays: u32 = 32, in 1..=4096,
        /// Seed of the random numbers.
        seed: u64 = 0,
    }
}

ports! {
    pub input PaintSpecularIn {
        /// New roughness and specular level.
        finish: Arc<Finish>,
        /// The visible objects.
        objects: Arc<Objects>,
        /// The room with the objects in it.
        mesh: Arc<SceneMesh>,
        /// The room without them.
        room: Arc<SceneMesh>,
        /// The camera of the photo.
        camera: Arc<Camera>,
        /// Planar depth at the photo's size.
        full_depth: Arc<Depth>,
        /// Points of the seen surface.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// Pixels of each visible light, working size.
        mask: Gather<Mask>,
        /// The estimated lights, whose reflections the photo shows.
        estimated: Gather<Shape>,
        /// Every light.
        shape: Gather<Shape>,
        /// Incoming radiance at each surface point.
        lighting: Option<Arc<Lighting>>,
    }
}

ports! {
    pub output PaintSpecularOut {
        /// The reflection at each pixel, after the edit and before.
        polish: Arc<Polish>,
    }
}

impl Node for PaintSpecular {
    const KIND: &'static str = "PaintSpecular";
    const VERSION: u32 = 2;
    type In = PaintSpecularIn;
    type Out = PaintSpecularOut;

    fn run(&self, inputs: PaintSpecularIn, ctx: &Context) -> Result<PaintSpecularOut, NodeError> {
        let size = inputs.points.0.size();
        for (id, mask) in inputs.mask.iter() {
            super::same_size(id, mask.0.size(), "points", size)?;
        }
        super::same_size("points", size, "mesh", inputs.mesh.size())?;
        super::same_size("points", size, "room", inputs.room.size())?;
        let photo = (inputs.camera.width, inputs.camera.height);
        super::same_size("camera", photo, "full_depth", inputs.full_depth.0.size())?;
        let seen = SeenPlaces {
            camera: &inputs.camera,
            full_depth: &inputs.full_depth,
            points: &inputs.points,
            normal: &inputs.normal,
            mesh: &inputs.room,
        };
        let (kinds, planes) = places(&inputs.finish, &seen);
        let masks: Vec<&Mask> = inputs.mask.iter().map(|(_, mask)| &**mask).collect();
        let nobody = Objects::unseen(&[]);
        let mut parts = Vec::new();
        for kind in kinds {
            ctx.check_cancelled()?;
            let surround = Surround {
                mesh: if kind.old { &inputs.room } else { &inputs.mesh },
                objects: if kind.old { &nobody } else { &inputs.objects },
                camera: &inputs.camera,
                points: &inputs.points,
                normal: &inputs.normal,
                masks: &masks,
                lighting: inputs.lighting.as_deref(),
                planes: &planes,
            };
            // Of a light that is put in or moved, the photo shows no reflection.
            let lights = inputs.shape.iter().map(|(id, shape)| {
                let shown = !kind.old || inputs.estimated.get(id).is_some_and(|was| was == shape);
                (id, if shown { &**shape } else { &Shape::Absent })
            });
            let lights: Vec<(&str, &Shape)> = lights.collect();
            let face = |i: usize| Some(kind.faces[i]);
            let (of, rays) =
                reflections((kind.faces.len(), 1), face, &surround, &lights, self.rays as usize, self.seed);
            ctx.count_rays(rays);
            parts.push(Part { old: kind.old, share: kind.share, rows: kind.rows, of });
        }
        Ok(PaintSpecularOut { polish: Arc::new(Polish(parts)) })
    }
}
