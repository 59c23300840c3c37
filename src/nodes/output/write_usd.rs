//! WriteUsd: the room as other programs read it.

use std::sync::Arc;

pub use crate::formats::UsdFrames;
use crate::formats::{UsdLight, UsdRoom};
use crate::geometry::{Camera, SceneMesh};
use crate::graph::{Context, Gather, Node, NodeError, above};
use crate::image::{Albedo, Mask, Normal, Picture, Points, Transfer, write_png};
use crate::nodes::artifacts::Files;
use crate::optics::{Radiance, Shape};
use crate::{params, ports};

params! {
    /// Writes the seen room, its lights and the camera as USD, for Blender and others;
    /// docs/export.md lists the losses. `relight export` runs it.
    pub struct WriteUsd {
        /// A lobe of a seen window of at least this bandwidth is written as a distant light, so
        /// that the sun falls where it falls; more than 0.
        sun: f32 = 100.0, in above(0.0),
    }
}

ports! {
    pub input WriteUsdIn {
        /// The camera of the photo.
        camera: Arc<Camera>,
        /// Pixel centers on the surface.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// The triangles between them.
        mesh: Arc<SceneMesh>,
        /// Albedo, working size.
        albedo: Arc<Albedo>,
        /// The pixels of each visible light, working size.
        mask: Gather<Mask>,
        /// The lights.
        shape: Gather<Shape>,
        /// Their radiances.
        radiance: Gather<Radiance>,
    }
}
ports! {
    pub output WriteUsdOut {
        /// `room.usda` and its texture `room_albedo.png`.
        files: Arc<Files>,
    }
}

impl Node for WriteUsd {
    const KIND: &'static str = "WriteUsd";
    const VERSION: u32 = 4;
    type In = WriteUsdIn;
    type Out = WriteUsdOut;

    fn run(&self, inputs: WriteUsdIn, _: &Context) -> Result<WriteUsdOut, NodeError> {
        let size = inputs.points.0.size();
        super::same_size("normal", inputs.normal.0.size(), "points", size)?;
        super::same_size("albedo", inputs.albedo.0.size(), "points", size)?;
        super::same_size("mesh", inputs.mesh.size(), "points", size)?;
        for (id, mask) in inputs.mask.iter() {
            super::same_size(&format!("mask `{id}`"), mask.0.size(), "points", size)?;
        }
        let mut lights = Vec::new();
        for (id, shape) in inputs.shape.iter() {
            let radiance = inputs.radiance.get(id).map_or(&[][..], |radiance| &radiance.0);
            if radiance.len() != shape.lobes() {
                let (wanted, got) = (shape.lobes(), radiance.len());
                return Err(NodeError::Failed(format!(
                    "light {id}: wanted {wanted} radiances, one per lobe, got {got}"
                )));
            }
            lights.push(UsdLight { id, shape, radiance });
        }
        let room = UsdRoom {
            camera: &inputs.camera,
            points: &inputs.points,
            normal: &inputs.normal,
            mesh: &inputs.mesh,
            masks: inputs.mask.iter().map(|(id, mask)| (id, &**mask)).collect(),
            lights,
            sun: self.sun,
        };
        let text = room.text(TEXTURE);
        let png = write_png(&Picture(inputs.albedo.0.clone()), Transfer::Srgb, false);
        Ok(WriteUsdOut {
            files: Arc::new(Files(vec![(TEXT.into(), text.into_bytes()), (TEXTURE.into(), png)])),
        })
    }
}

/// The file of USD text.
pub const TEXT: &str = "room.usda";
/// Its texture, as the text names it.
pub const TEXTURE: &str = "room_albedo.png";
