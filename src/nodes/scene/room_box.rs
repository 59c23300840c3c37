//! `RoomBox`: the room as a cuboid, also where the camera does not see it.

use std::sync::Arc;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::geometry::{Camera, KnownSide, LayoutGuess, RoomLayout, SIDES, SceneMesh};
use crate::graph::{Context, Node, NodeError, above, check_range};
use crate::image::{Normal, Points};
use crate::nodes::artifacts::same_size;
use crate::tuning::tuning;
use crate::{params, ports};

/// Facts about the room: all fields are optional. A side is a distance in meters from the camera
/// along the room's axes, or `None` where the room is open.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RoomSpec {
    /// From the floor to the ceiling, meters.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height: Option<f32>,
    /// The side to the left of the camera.
    #[serde(with = "side", skip_serializing_if = "is_unknown")]
    pub left: KnownSide,
    /// The side to its right.
    #[serde(with = "side", skip_serializing_if = "is_unknown")]
    pub right: KnownSide,
    /// The floor.
    #[serde(with = "side", skip_serializing_if = "is_unknown")]
    pub floor: KnownSide,
    /// The ceiling.
    #[serde(with = "side", skip_serializing_if = "is_unknown")]
    pub ceiling: KnownSide,
    /// The side before the camera.
    #[serde(with = "side", skip_serializing_if = "is_unknown")]
    pub front: KnownSide,
    /// The side behind it.
    #[serde(with = "side", skip_serializing_if = "is_unknown")]
    pub back: KnownSide,
}

/// A field that is there contains a distance or `None`.
mod side {
    use super::*;

    pub fn serialize<S: Serializer>(side: &KnownSide, to: S) -> Result<S::Ok, S::Error> {
        match side {
            KnownSide::At(distance) => Some(*distance).serialize(to),
            KnownSide::Open | KnownSide::Unknown => None::<f32>.serialize(to),
        }
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<KnownSide, D::Error> {
        Ok(Option::<f32>::deserialize(from)?.map_or(KnownSide::Open, KnownSide::At))
    }
}

fn is_unknown(side: &KnownSide) -> bool {
    *side == KnownSide::Unknown
}

tuning! {
    /// Limits of the facts that a scene states about its room.
    pub const TUNING: RoomBoxTuning {
        /// Largest distance of a side.
        max_distance: f32 = 50.0,
            unit "meters", source Taste, effect "a larger value admits halls";
        /// Least height.
        min_height: f32 = 1.5,
            unit "meters", source Taste, effect "a smaller value admits heights in other units";
        /// Largest height.
        max_height: f32 = 20.0,
            unit "meters", source Taste, effect "a larger value admits halls";
        /// Difference up to which floor, ceiling and height agree: people round them.
        rounding: f32 = 0.05,
            unit "meters", source Taste, effect "a larger value admits contradictions";
    }
}

impl RoomSpec {
    fn sides(&self) -> [KnownSide; 6] {
        [self.left, self.right, self.floor, self.ceiling, self.front, self.back]
    }

    fn check(&self) -> Result<(), String> {
        for (name, side) in SIDES.iter().zip(self.sides()) {
            if let KnownSide::At(distance) = side {
                check_range(&format!("room: {name}"), &distance, above(0.0))?;
                check_range(&format!("room: {name}"), &distance, ..=TUNING.max_distance)?;
            }
        }
        let Some(height) = self.height else { return Ok(()) };
        check_range("room: height", &height, TUNING.min_height..=TUNING.max_height)?;
        match (self.floor, self.ceiling) {
            (KnownSide::At(floor), KnownSide::At(ceiling))
                if (floor + ceiling - height).abs() > TUNING.rounding =>
            {
                Err(format!(
                    "room: height: wanted floor + ceiling = {:.2} m, got {height:.2} m: leave one of the three out",
                    floor + ceiling
                ))
            }
            (KnownSide::At(side), _) | (_, KnownSide::At(side)) if side >= height => Err(format!(
                "room: height: wanted more than the camera's distance of {side:.2} m from floor or ceiling, got {height:.2} m"
            )),
            _ => Ok(()),
        }
    }
}

params! {
    /// Finds the cuboid of the room: the direction of gravity, the angle of the walls, the sides
    /// that the camera sees, and guesses of the others. Its hidden sides are divided into cells,
    /// which receive and reflect light.
    pub struct RoomBox {
        /// Cells along each edge of a side.
        cells: usize = 8, in 1..=64,
        /// Factor on the least distance of unseen walls.
        distance: f32 = 1.4, in 0.1..=10.0,
        /// Facts about the room, which take the place of guesses: `(height: 2.7, left: 1.2,
        /// ceiling: None)`, with `left`, `right`, `floor`, `ceiling`, `front` and `back` as
        /// distances from the camera in meters along the room's axes, above 0 and up to 50, or
        /// `None` for an open side, and `height` from 1.5 to 20.
        room: RoomSpec = RoomSpec::default(),
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
    const VERSION: u32 = 3;
    type In = RoomBoxIn;
    type Out = RoomBoxOut;

    fn check_consistency(&self) -> Result<(), String> {
        self.room.check()
    }

    fn run(&self, inputs: RoomBoxIn, ctx: &Context) -> Result<RoomBoxOut, NodeError> {
        let RoomBoxIn { mesh, points, normal, camera } = inputs;
        same_size("points", points.0.size(), "mesh", mesh.size())?;
        same_size("normal", normal.0.size(), "mesh", mesh.size())?;
        let guess = LayoutGuess {
            cells: self.cells,
            distance: self.distance,
            sides: self.room.sides(),
            height: self.room.height,
        };
        let (layout, doubts) =
            RoomLayout::find_with_doubts(&mesh, &points, &normal, &camera, &guess);
        doubts.into_iter().for_each(|doubt| ctx.warn(doubt));
        ctx.note(layout.summary());
        // No minus before a zero.
        let [yaw, pitch, roll] =
            layout.camera_angles().map(|angle| (10.0 * angle).round() / 10.0 + 0.0);
        ctx.note(format!(
            "the camera in the room: yaw {yaw:.1}, pitch {pitch:.1}, roll {roll:.1} degrees"
        ));
        Ok(RoomBoxOut { layout: Arc::new(layout) })
    }
}
