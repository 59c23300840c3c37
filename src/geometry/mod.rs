//! Camera, depth to mesh, and rays.

mod bvh;
mod camera;
mod field_of_view;
mod grid;
mod objects;
mod scene;

pub use bvh::{RayMesh, RayMeshHit};
pub use camera::Camera;
pub use field_of_view::{FieldOfView, FieldOfViewSource, field_of_view};
pub use grid::{Grid, cosine_direction};
pub use objects::{
    Bodies, Body, Drawing, Material, Model, Objects, Probes, Skin, clearance, draw, most_triangles,
    named_files,
};
pub use scene::{
    CellGrid, Creases, Doubt, Hit, KnownHeight, KnownLength, KnownSide, LayoutDraw, LayoutGuess,
    LayoutLine, LevelSides, MAX_CELLS, MetricDepth, Own, PlaneFit, RelativeScale, RoomCell,
    RoomLayout, SIDES, SceneMesh, SeenRoom, SideSource, Sight, Surface, doubts, flatten_planes,
    grow_region, level_sides, limit_areas, metric_depth, orient_normals, relative_depth,
    relative_from_height, scale_from_height, surface, world_up,
};

use glam::Vec3;

use crate::tuning::Table;

/// Lowest and highest corner of the box around points; from infinity to minus infinity without any.
pub fn bounds(points: impl IntoIterator<Item = Vec3>) -> (Vec3, Vec3) {
    points
        .into_iter()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)))
}

/// The constants of geometry.
pub fn tuning() -> Vec<Table> {
    [scene::tuning(), objects::tuning(), vec![grid::GridTuning::table()]].concat()
}
