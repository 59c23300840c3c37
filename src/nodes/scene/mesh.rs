//! `Mesh`: the seen surface, from depth.

use std::sync::Arc;

use crate::geometry::{Camera, SceneMesh, flatten_planes, surface};
use crate::graph::{Context, Gather, Node, NodeError};
use crate::image::{Depth, Mask, Normal, Picture, Plane, Points, dilate};
use crate::nodes::artifacts::same_size;
use crate::optics::LightKind;
use crate::{params, ports};

params! {
    /// Converts depth to points, normals and triangles.
    ///
    /// Normals are robust plane fits to the inverse depth, wider where the depth is noisy; points
    /// are smoothed by no more than the noise. No triangle spans a depth step: abs(z1 - z2) /
    /// min(z) > 0.12, diagonals 0.12 sqrt(2). Window panes and ignored pixels get no triangles.
    pub struct Mesh {
        /// Walls and other large planes of noisy depth become flat, except at visible lights, and
        /// go on over a border that has holes, or repeats the depth beside it.
        flatten: bool = true,
    }
}

ports! {
    pub input MeshIn {
        /// Planar depth in meters.
        depth: Arc<Depth>,
        /// 1 where the depth is filled in; without it, no pixel is.
        holes: Option<Arc<Mask>>,
        /// The linear photo, the size of `depth`: without it, planes go by depth alone.
        photo: Option<Arc<Picture>>,
        /// Fraction of saturated pixels, the size of `depth`; without it, no pixel is.
        clipped: Option<Arc<Mask>>,
        /// The camera; resized to `depth`.
        camera: Arc<Camera>,
        /// Pixels that are not part of the room.
        ignore: Option<Arc<Mask>>,
        /// The pixels of each visible light.
        masks: Gather<Mask>,
        /// Kind of each visible light, under the same names.
        kinds: Gather<LightKind>,
    }
}

ports! {
    pub output MeshOut {
        /// Surface points at pixel centers, camera space.
        points: Arc<Points>,
        /// Unit normals facing the camera.
        normal: Arc<Normal>,
        /// The triangles, for rays.
        mesh: Arc<SceneMesh>,
    }
}

impl Node for Mesh {
    const KIND: &'static str = "Mesh";
    const VERSION: u32 = 5;
    type In = MeshIn;
    type Out = MeshOut;

    fn run(&self, inputs: MeshIn, ctx: &Context) -> Result<MeshOut, NodeError> {
        let (width, height) = inputs.depth.0.size();
        let mut outside = Plane::filled(width, height, false);
        let panes = inputs
            .masks
            .iter()
            .filter(|(name, _)| inputs.kinds.get(name).is_some_and(|k| **k == LightKind::Window));
        for (name, mask) in panes.chain(inputs.ignore.iter().map(|mask| ("ignore", mask))) {
            if mask.0.size() != (width, height) {
                let (w, h) = mask.0.size();
                return Err(NodeError::Failed(format!(
                    "mask `{name}` is {w} x {h}, wanted {width} x {height} as the depth"
                )));
            }
            outside
                .pixels_mut()
                .iter_mut()
                .zip(mask.0.pixels())
                .for_each(|(out, share)| *out |= *share > 0.5);
        }
        let sizes = [
            ("holes", inputs.holes.as_ref().map(|holes| holes.0.size())),
            ("photo", inputs.photo.as_ref().map(|photo| photo.0.size())),
            ("clipped", inputs.clipped.as_ref().map(|clipped| clipped.0.size())),
        ];
        for (name, size) in sizes.into_iter().filter_map(|(name, size)| Some((name, size?))) {
            same_size(name, size, "depth", (width, height))?;
        }
        let camera = inputs.camera.resized(width, height);
        let mut seen = surface(&inputs.depth, &camera);
        if self.flatten {
            let masks = inputs.masks.iter().map(|(_, mask)| &**mask);
            let left_out = dilate(masks, (width, height), 1);
            let depth = (&*inputs.depth, inputs.holes.as_deref());
            let photo = inputs.photo.as_deref().map(|photo| (photo, inputs.clipped.as_deref()));
            flatten_planes(&mut seen, depth, photo, &camera, &left_out);
        }
        ctx.check_cancelled()?;
        let mesh = SceneMesh::new(&seen.points, camera.fx, seen.noise, &outside);
        Ok(MeshOut {
            points: Arc::new(seen.points),
            normal: Arc::new(seen.normal),
            mesh: Arc::new(mesh),
        })
    }
}
