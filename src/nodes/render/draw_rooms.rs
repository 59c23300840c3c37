//! `DrawRooms`: the room under other guesses about its unseen part.

use std::sync::Arc;

use crate::geometry::{Camera, RoomLayout, SceneMesh};
use crate::graph::{Context, Node, NodeError};
use crate::image::{Normal, Points};
use crate::optics::{self, DrawSettings};
use crate::{params, ports};

params! {
    /// Draws of the guesses about the unseen room: the distances of guessed walls, the height of an
    /// unseen floor or ceiling, the albedo of sides that are not seen at all. For each, the cuboid
    /// and coarse gathering rays. All lights share the draws. Without a guess no draw is made.
    pub struct DrawRooms {
        /// Draws, a power of two.
        draws: u32 = 4, in 2..=64,
        /// Cells along each edge of a side.
        cells: usize = 4, in 1..=64,
        /// Distance of the receivers along each axis, pixels.
        stride: u32 = 16, in 1..=64,
        /// Rays per receiver, rounded up to four equal batches.
        rays: u32 = 32, in 1..=4096,
        /// Seed of the random numbers.
        seed: u64 = 0,
    }
}

ports! {
    pub input DrawRoomsIn {
        /// The cuboid of the room, whose guessed sides are moved.
        layout: Arc<RoomLayout>,
        /// The seen room, without inserted objects.
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
    pub output DrawRoomsOut {
        /// The drawn rooms.
        draws: Arc<optics::RoomDraws>,
    }
}

impl Node for DrawRooms {
    const KIND: &'static str = "DrawRooms";
    const VERSION: u32 = 1;
    type In = DrawRoomsIn;
    type Out = DrawRoomsOut;

    fn check_consistency(&self) -> Result<(), String> {
        match self.draws.is_power_of_two() {
            true => Ok(()),
            false => Err(format!(
                "draws: wanted a power of two, which covers the ranges evenly, got {}",
                self.draws
            )),
        }
    }

    fn run(&self, inputs: DrawRoomsIn, ctx: &Context) -> Result<DrawRoomsOut, NodeError> {
        let DrawRoomsIn { layout, mesh, points, normal, camera } = inputs;
        super::same_size("points", points.0.size(), "mesh", mesh.size())?;
        super::same_size("normal", normal.0.size(), "mesh", mesh.size())?;
        super::same_size("layout", layout.size(), "mesh", mesh.size())?;
        if !mesh.bodies().probes().is_empty() {
            return Err(NodeError::Failed(
                "mesh: wanted the room without inserted objects, got one with objects; wire the \
                 mesh of stage Mesh"
                    .into(),
            ));
        }
        ctx.check_cancelled()?;
        let settings = DrawSettings {
            count: self.draws as usize,
            cells: self.cells,
            stride: self.stride as usize,
            rays: self.rays as usize,
            seed: self.seed,
        };
        let draws = optics::RoomDraws::new(&layout, &mesh, &camera, (&points, &normal), settings);
        ctx.count_rays(draws.rays());
        Ok(DrawRoomsOut { draws: Arc::new(draws) })
    }
}
