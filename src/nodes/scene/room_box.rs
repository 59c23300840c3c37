//! `RoomBox`: the room as a cuboid, also where the camera does not see it.

use std::sync::Arc;

use crate::geometry::{Camera, LayoutGuess, RoomLayout, SceneMesh};
use crate::graph::{Context, Node, NodeError};
use crate::image::{Normal, Points};
use crate::{params, ports};

params! {
    /// Finds the cuboid of the room: the direction of gravity, the angle of the walls, the sides
    /// that the camera sees, and guesses of the others. Its hidden sides are divided into cells,
    /// which receive and reflect light.
    pub struct RoomBox {
        /// Cells along each edge of a side.
        cells: usize = 8, in 1..=64,
        /// Factor on the least distance of unseen walls.
        distance: f32 = 1.4, in 0.1..=10.0,
    }
}

ports! {
    pub input RoomBoxIn {
        /// The seen room.
        mesh: Arc<SceneMesh>,
        /// The surface points, of the size of `mesh`.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// The camera.
        camera: Arc<Camera>,
    }
}

ports! {
    pub output RoomBoxOut {
        /// The cuboid and its cells.
        layout: Arc<RoomLayout>,
    }
}

impl Node for RoomBox {
    const KIND: &'static str = "RoomBox";
    const VERSION: u32 = 1;
    type In = RoomBoxIn;
    type Out = RoomBoxOut;

    fn run(&self, inputs: RoomBoxIn, _: &Context) -> Result<RoomBoxOut, NodeError> {
        let RoomBoxIn { mesh, points, normal, camera } = inputs;
        crate::nodes::artifacts::same_size("points", points.0.size(), "mesh", mesh.size())?;
        crate::nodes::artifacts::same_size("normal", normal.0.size(), "mesh", mesh.size())?;
        let guess =
            LayoutGuess { cells: self.cells, distance: self.distance, ..LayoutGuess::default() };
        let layout = RoomLayout::find(&mesh, &points, &normal, &camera, &guess);
        Ok(RoomBoxOut { layout: Arc::new(layout) })
    }
}
