//! The bounding volume hierarchy and its watertight rays.

pub(in crate::geometry) mod bvh8;
pub(in crate::geometry) mod rays;
pub(in crate::geometry) mod watertight_triangle;

pub use rays::{RayMesh, RayMeshHit};
