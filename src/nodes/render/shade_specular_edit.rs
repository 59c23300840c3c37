//! `ShadeSpecularEdit`: the specular reflection of surfaces with an edited roughness or specular
//! level.

use std::sync::Arc;

use crate::geometry::{Camera, Objects, RoomLayout, SceneMesh};
use crate::graph::{Context, Gather, Node, NodeError};
use crate::image::{Depth, Mask, Normal, Points, SpecularEdit};
use crate::optics::{
    Lighting, ReflectionScene, SeenSurface, Shape, SpecularChange, SpecularPart, places,
    reflections,
};
use crate::{params, ports};

params! {
    /// Finds the specular reflection of regions of new roughness or specular level, as
    /// `InsertSpecular` does for objects, and that before the edit.
    ///
    /// The photo holds the old reflection; `Compose` puts the new one in its place. Lobes wider
    /// than a working pixel are known at working size, narrower ones at the photo's.
    pub struct ShadeSpecularEdit {
        /// Rays per place, and samples of each light per place, 1..=4096; a mirror takes one, and
        /// in all there are up to 4 million.
        rays: u32 = 32, in 1..=4096,
        /// Seed of the random numbers.
        seed: u64 = 0,
    }
}

ports! {
    pub input ShadeSpecularEditIn {
        /// New roughness and specular level.
        specular_edit: Arc<SpecularEdit>,
        /// The objects as they are seen.
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
        /// The cuboid of the room, whose hidden cells reflected rays then show.
        layout: Option<Arc<RoomLayout>>,
        /// Incident radiance at each position of a grid, in place of `layout`.
        lighting: Option<Arc<Lighting>>,
    }
}

ports! {
    pub output ShadeSpecularEditOut {
        /// Specular reflection of each pixel, after and before the edit.
        specular_change: Arc<SpecularChange>,
    }
}

impl Node for ShadeSpecularEdit {
    const KIND: &'static str = "ShadeSpecularEdit";
    const VERSION: u32 = 3;
    type In = ShadeSpecularEditIn;
    type Out = ShadeSpecularEditOut;

    fn run(
        &self,
        inputs: ShadeSpecularEditIn,
        ctx: &Context,
    ) -> Result<ShadeSpecularEditOut, NodeError> {
        let size = inputs.points.0.size();
        for (id, mask) in inputs.mask.iter() {
            super::same_size(id, mask.0.size(), "points", size)?;
        }
        super::same_size("points", size, "mesh", inputs.mesh.size())?;
        super::same_size("points", size, "room", inputs.room.size())?;
        let photo = (inputs.camera.width, inputs.camera.height);
        super::same_size("camera", photo, "full_depth", inputs.full_depth.0.size())?;
        let seen = SeenSurface {
            camera: &inputs.camera,
            full_depth: &inputs.full_depth,
            points: &inputs.points,
            normal: &inputs.normal,
            mesh: &inputs.room,
        };
        let (kinds, planes) = places(&inputs.specular_edit, &seen);
        let masks: Vec<&Mask> = inputs.mask.iter().map(|(_, mask)| &**mask).collect();
        let nobody = Objects::unseen(&[]);
        let mut parts = Vec::new();
        for kind in kinds {
            ctx.check_cancelled()?;
            let scene = ReflectionScene {
                mesh: if kind.old { &inputs.room } else { &inputs.mesh },
                objects: if kind.old { &nobody } else { &inputs.objects },
                camera: &inputs.camera,
                points: &inputs.points,
                normal: &inputs.normal,
                masks: &masks,
                lighting: inputs.lighting.as_deref(),
                layout: inputs.layout.as_deref(),
                planes: &planes,
            };
            // The photo does not show a reflection of an inserted or moved light.
            let lights = inputs.shape.iter().map(|(id, shape)| {
                let shown = !kind.old || inputs.estimated.get(id).is_some_and(|was| was == shape);
                (id, if shown { &**shape } else { &Shape::Absent })
            });
            let lights: Vec<(&str, &Shape)> = lights.collect();
            let shading = |i: usize| Some(kind.points[i]);
            let (of, rays) = reflections(
                (kind.points.len(), 1),
                shading,
                &scene,
                &lights,
                self.rays as usize,
                self.seed,
            );
            ctx.count_rays(rays);
            parts.push(SpecularPart { old: kind.old, share: kind.share, rows: kind.rows, of });
        }
        Ok(ShadeSpecularEditOut { specular_change: Arc::new(SpecularChange(parts)) })
    }
}
