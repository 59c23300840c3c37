//! Camera, depth to mesh, and rays.

mod bodies;
mod bvh8;
mod camera;
mod facing;
mod grid;
mod known_length;
mod like_surface;
mod mesh;
mod model;
mod objects;
mod plane_fit;
mod rays;
mod surface;
mod up;
mod woop;

pub use bodies::{Bodies, Body, Probes, clearance};
pub use camera::Camera;
pub use facing::facing;
pub use grid::{Grid, cosine_direction};
pub use known_length::{KnownLength, Metres, metric_depth, relative_depth};
pub use like_surface::like_surface;
pub use mesh::{Hit, Own, SceneMesh, Sight};
pub use model::{Material, Model, Skin, most_triangles, parts};
pub use objects::{Drawing, Objects, draw};
pub use plane_fit::PlaneFit;
pub use rays::{RayMesh, RayMeshHit};
pub use surface::{Surface, surface};
pub use up::world_up;

use glam::Vec3;

/// Lowest and highest corner of the box around points; from infinity to minus infinity without any.
pub fn bounds(points: impl IntoIterator<Item = Vec3>) -> (Vec3, Vec3) {
    points.into_iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)))
}
