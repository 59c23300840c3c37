//! Camera, depth to mesh, and rays.

mod camera;

pub use camera::Camera;
