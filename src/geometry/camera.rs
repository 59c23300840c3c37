//! The pinhole camera: at the origin, x right, y up, looking along -z.

use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};

/// A pinhole camera for a plane of `width` x `height` pixels. Pixel (j, i) has its center at
/// (j + 0.5, i + 0.5).
///
/// ```
/// use glam::Vec2;
/// use relight::geometry::Camera;
///
/// let camera = Camera::from_fov_x(320, 240, 60.0);
/// let point = camera.unproject(100.0, 50.0, 2.0);
/// assert_eq!(point.z, -2.0);
/// let pixel = camera.project(point).expect("the point is before the camera");
/// assert!(pixel.distance(Vec2::new(100.0, 50.0)) < 1e-3);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Columns of the plane.
    pub width: usize,
    /// Rows of the plane.
    pub height: usize,
    /// Horizontal focal length, pixels of this plane.
    pub fx: f32,
    /// Vertical focal length, pixels.
    pub fy: f32,
    /// Column coordinate of the principal point, pixels.
    pub cx: f32,
    /// Row coordinate of the principal point, pixels.
    pub cy: f32,
}

impl Camera {
    /// A camera from its horizontal field of view in degrees, square pixels, centered.
    pub fn from_fov_x(width: usize, height: usize, degrees: f32) -> Camera {
        let f = 0.5 * width as f32 / (0.5 * degrees.to_radians()).tan();
        Camera { width, height, fx: f, fy: f, cx: 0.5 * width as f32, cy: 0.5 * height as f32 }
    }

    /// The same view on a plane of another size.
    pub fn resized(&self, width: usize, height: usize) -> Camera {
        let (sx, sy) = (width as f32 / self.width as f32, height as f32 / self.height as f32);
        Camera {
            width,
            height,
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: self.cx * sx,
            cy: self.cy * sy,
        }
    }

    /// The point at planar depth `z` seen at plane position (`x`, `y`) (pixel centers at + 0.5).
    pub fn unproject(&self, x: f32, y: f32, z: f32) -> Vec3 {
        Vec3::new((x - self.cx) / self.fx * z, (self.cy - y) / self.fy * z, -z)
    }

    /// The point of pixel (column, row) at planar depth `z`.
    pub fn pixel_point(&self, column: usize, row: usize, z: f32) -> Vec3 {
        self.unproject(column as f32 + 0.5, row as f32 + 0.5, z)
    }

    /// Plane position of a point, or `None` when it lies at or behind the camera plane.
    pub fn project(&self, point: Vec3) -> Option<Vec2> {
        let z = -point.z;
        (z > 1e-6)
            .then(|| Vec2::new(self.cx + point.x / z * self.fx, self.cy - point.y / z * self.fy))
    }

    /// Whether a plane position falls on the plane.
    pub fn contains(&self, at: Vec2) -> bool {
        at.x >= 0.0 && at.y >= 0.0 && at.x < self.width as f32 && at.y < self.height as f32
    }
}
