//! `InsertSpecular`: the specular reflection of shiny objects.

use std::sync::Arc;

use crate::geometry::{Camera, Objects, RoomLayout, SceneMesh};
use crate::graph::{Context, Gather, Node, NodeError};
use crate::image::{Mask, Normal, Points};
use crate::optics::{
    Lighting, ReflectionScene, Reflections, Shape, object_shading_point, reflections,
};
use crate::{params, ports};

params! {
    /// Finds the specular reflection of shiny objects, by GGX in Karis' form: from pixels of the
    /// picture, from lights, and from parts of the room that the photo does not show.
    ///
    /// A reflected ray that meets the seen room shows the edited picture there, so each light's
    /// reflection is in that light's layer. A ray that leaves the seen room shows the cell of the
    /// room's cuboid there, light by light, or, where a network estimates the lighting, that
    /// lighting, split by the contribution of each light to the room; with neither, a uniform
    /// radiance.
    pub struct InsertSpecular {
        /// Rays per pixel, and samples of each light per pixel, 1..=4096; a mirror takes up to 16,
        /// and in all there are up to 4 million.
        rays: u32 = 32, in 1..=4096,
        /// Seed of the random numbers.
        seed: u64 = 0,
    }
}

ports! {
    pub input InsertSpecularIn {
        /// The visible objects.
        objects: Arc<Objects>,
        /// The room with the objects in it.
        mesh: Arc<SceneMesh>,
        /// The camera of the photo.
        camera: Arc<Camera>,
        /// Points of the seen surface.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// Pixels of each visible light, working size.
        mask: Gather<Mask>,
        /// Every light.
        shape: Gather<Shape>,
        /// The cuboid of the room, whose hidden cells reflected rays then show.
        layout: Option<Arc<RoomLayout>>,
        /// Incident radiance at each position of a grid, in place of `layout`.
        lighting: Option<Arc<Lighting>>,
    }
}

ports! {
    pub output InsertSpecularOut {
        /// The specular reflection of each pixel of the objects.
        reflected: Arc<Reflections>,
    }
}

impl Node for InsertSpecular {
    const KIND: &'static str = "InsertSpecular";
    const VERSION: u32 = 5;
    type In = InsertSpecularIn;
    type Out = InsertSpecularOut;

    fn run(&self, inputs: InsertSpecularIn, ctx: &Context) -> Result<InsertSpecularOut, NodeError> {
        for (id, mask) in inputs.mask.iter() {
            super::same_size(id, mask.0.size(), "points", inputs.points.0.size())?;
        }
        super::same_size("points", inputs.points.0.size(), "mesh", inputs.mesh.size())?;
        let masks: Vec<&Mask> = inputs.mask.iter().map(|(_, mask)| &**mask).collect();
        let lights: Vec<(&str, &Shape)> =
            inputs.shape.iter().map(|(id, shape)| (id, &**shape)).collect();
        let objects = &inputs.objects;
        let scene = ReflectionScene {
            objects,
            mesh: &inputs.mesh,
            camera: &inputs.camera,
            points: &inputs.points,
            normal: &inputs.normal,
            masks: &masks,
            lighting: inputs.lighting.as_deref(),
            layout: inputs.layout.as_deref(),
            planes: &[],
        };
        ctx.check_cancelled()?;
        let shading = |i: usize| object_shading_point(objects, &inputs.camera, i);
        let size = objects.coverage.size();
        let (reflected, rays) =
            reflections(size, shading, &scene, &lights, self.rays as usize, self.seed);
        ctx.count_rays(rays);
        Ok(InsertSpecularOut { reflected: Arc::new(reflected) })
    }
}
