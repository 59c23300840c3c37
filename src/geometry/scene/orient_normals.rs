//! Given normals, brought to unit length and turned towards the camera.

use glam::Vec3;

use crate::geometry::Camera;
use crate::image::{Normal, Plane};

/// The normals `given` at unit length, turned towards the camera; a normal of zero length becomes
/// the direction back along the pixel's ray.
pub fn orient_normals(mut given: Plane<Vec3>, camera: &Camera) -> Normal {
    let (width, height) = given.size();
    let camera = camera.resized(width, height);
    for (i, n) in given.pixels_mut().iter_mut().enumerate() {
        let ray = camera.pixel_point(i % width, i / width, 1.0);
        let unit = n.try_normalize().unwrap_or_else(|| -ray.normalize());
        *n = if unit.dot(ray) > 0.0 { -unit } else { unit };
    }
    Normal(given)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_face_the_camera_at_unit_length() {
        let camera = Camera::from_fov_x(8, 6, 60.0);
        let given =
            Plane::from_fn(4, 3, |x, y| Vec3::new(x as f32 - 2.0, 0.5, 0.3) * (y as f32 - 1.0));
        let normal = orient_normals(given.clone(), &camera).0;
        for y in 0..3 {
            for x in 0..4 {
                let (n, ray) = (normal.get(x, y), camera.resized(4, 3).pixel_point(x, y, 1.0));
                assert!((n.length() - 1.0).abs() < 1e-6 && n.dot(ray) <= 0.0, "{n}");
                // Row 1 has zero length.
                assert!(y == 1 || n.cross(given.get(x, y).normalize()).length() < 1e-6);
            }
        }
    }
}
