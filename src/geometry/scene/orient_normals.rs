//! Normals that somebody tells, made what a normal here is: of unit length and facing the camera.

use glam::Vec3;

use crate::geometry::Camera;
use crate::image::{Normal, Plane};

/// `told` at unit length, turned to the camera where it points away; where it has no length, straight back along the pixel's ray.
pub fn facing(mut told: Plane<Vec3>, camera: &Camera) -> Normal {
    let (width, height) = told.size();
    let camera = camera.resized(width, height);
    for (i, n) in told.pixels_mut().iter_mut().enumerate() {
        let ray = camera.pixel_point(i % width, i / width, 1.0);
        let unit = n.try_normalize().unwrap_or_else(|| -ray.normalize());
        *n = if unit.dot(ray) > 0.0 { -unit } else { unit };
    }
    Normal(told)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_face_the_camera_at_unit_length() {
        let camera = Camera::from_fov_x(8, 6, 60.0);
        let told = Plane::from_fn(4, 3, |x, y| Vec3::new(x as f32 - 2.0, 0.5, 0.3) * (y as f32 - 1.0));
        let normal = facing(told.clone(), &camera).0;
        for y in 0..3 {
            for x in 0..4 {
                let (n, ray) = (normal.get(x, y), camera.resized(4, 3).pixel_point(x, y, 1.0));
                assert!((n.length() - 1.0).abs() < 1e-6 && n.dot(ray) <= 0.0, "{n}");
                // Of row 1 nothing is told.
                assert!(y == 1 || n.cross(told.get(x, y).normalize()).length() < 1e-6);
            }
        }
    }
}
