//! Bodies put into the room, and the models they are read from.

pub(in crate::geometry) mod bodies;
pub(in crate::geometry) mod draw;
pub(in crate::geometry) mod model;

pub use bodies::{Bodies, Body, Probes, clearance};
pub use draw::{Drawing, Objects, draw};
pub use model::{Material, Model, Skin, most_triangles, named_files};

use crate::tuning::Table;

/// The constants of inserted bodies.
pub fn tuning() -> Vec<Table> {
    vec![bodies::BodiesTuning::table(), draw::DrawTuning::table()]
}
