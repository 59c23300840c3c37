//! Chamfer distance between the surfaces of two lights.

use glam::Vec3;

use crate::optics::Shape;
use crate::tuning::tuning;

tuning! {
    /// Constants of the distance between lights.
    pub const CHAMFER: ChamferTuning {
        /// Points that represent a light.
        surface_points: usize = 64,
            unit "points", source Taste, effect "a larger value is slower and more exact";
        /// Offset under the root of a distance.
        offset: f64 = 1e-6,
            unit "square meters",
            source Paper("Li et al., Physically-Based Editing of Indoor Scene Lighting from a Single Image, ECCV 2022"),
            effect "a larger value adds to the distance of equal lights";
    }
}

/// Points spread evenly over the emitting surface, in the unit of the shape:
/// `CHAMFER.surface_points` of them, the same for the same light; none for an absent light.
///
/// On a sphere they follow the spiral of the golden angle; elsewhere the additive recurrence of
/// Roberts (2018, "R2") in the triangles of the surface, in proportion to area.
pub fn surface_points(shape: &Shape) -> Vec<Vec3> {
    shape.surface_points(CHAMFER.surface_points)
}

/// Chamfer distance in meters, as defined by IndoorLightEditing (Li et al., ECCV 2022): the mean
/// over a of the distance to the nearest of b, plus that over b, a distance being sqrt(d^2 + 1e-6).
/// `None` when one side is empty.
pub fn chamfer(a: &[Vec3], b: &[Vec3]) -> Option<f64> {
    let one_way = |a: &[Vec3], b: &[Vec3]| {
        let nearest = |p: &Vec3| {
            b.iter().map(|q| f64::from(p.distance_squared(*q))).fold(f64::INFINITY, f64::min)
        };
        a.iter().map(|p| (nearest(p) + CHAMFER.offset).sqrt()).sum::<f64>() / a.len() as f64
    };
    (!a.is_empty() && !b.is_empty()).then(|| one_way(a, b) + one_way(b, a))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{BoxLamp, Lamp, MeshLamp, RectLamp, SphereLamp, Surfel, Window};

    fn sphere(x: f32, radius: f32) -> Shape {
        Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::X * x, radius }))
    }

    fn between(a: &Shape, b: &Shape) -> f64 {
        chamfer(&surface_points(a), &surface_points(b)).expect("both are there")
    }

    #[test]
    fn points_lie_on_the_surface_evenly() {
        let points = surface_points(&sphere(2.0, 0.5));
        assert!(points.iter().all(|p| ((*p - 2.0 * Vec3::X).length() - 0.5).abs() < 1e-6));
        let axes = [Vec3::X, 2.0 * Vec3::Y, 3.0 * Vec3::Z];
        let cuboid = Lamp::Box(BoxLamp { center: Vec3::ONE, axes });
        let points = surface_points(&Shape::Lamp(cuboid));
        assert_eq!(points.len(), CHAMFER.surface_points);
        for p in &points {
            let on = ((*p - Vec3::ONE) / Vec3::new(1.0, 2.0, 3.0)).abs();
            assert!((on.max_element() - 1.0).abs() < 1e-6, "{p}");
        }
        // The two sides across x have 48 of 88 square meters.
        let across =
            points.iter().filter(|p| ((p.x - 1.0).abs() - 1.0).abs() < 1e-6).count() as f32;
        assert!((across / points.len() as f32 - 48.0 / 88.0).abs() < 0.05, "{across}");
        let middle = points.iter().sum::<Vec3>() / points.len() as f32 - Vec3::ONE;
        assert!(middle.length() < 0.3, "{middle}");
    }

    #[test]
    fn distances_by_hand() {
        // The same light: both ways the root of 1e-6.
        assert!((between(&sphere(0.0, 0.1), &sphere(0.0, 0.1)) - 2e-3).abs() < 1e-6);
        // Concentric spheres: each way the difference of the radii, as their points lie on the same
        // rays.
        assert!((between(&sphere(0.0, 1.0), &sphere(0.0, 3.0)) - 4.0).abs() < 1e-3);
        // Far apart: from the nearest points of the other, so the distance of the centers, less
        // about a radius each way.
        let far = between(&sphere(0.0, 0.1), &sphere(10.0, 0.1));
        assert!((far - 2.0 * 9.9).abs() < 0.05, "{far}");
        // Parallel rectangles, the one behind the other.
        let pane = |z: f32| {
            Shape::Lamp(Lamp::Rect(RectLamp { center: Vec3::Z * z, x: Vec3::X, y: Vec3::Y }))
        };
        assert!((between(&pane(0.0), &pane(0.5)) - 1.0).abs() < 1e-4);
        assert_eq!(chamfer(&surface_points(&Shape::Absent), &surface_points(&pane(0.0))), None);
    }

    #[test]
    fn a_rectangle_is_the_same_in_every_form() {
        let (center, x, y) = (Vec3::new(0.0, 1.0, -3.0), Vec3::X * 0.4, Vec3::Y * 0.4);
        let rect = Shape::Lamp(Lamp::Rect(RectLamp { center, x, y }));
        let window =
            Shape::Window(Window { center, x, y, lobes: Window::daylight(Vec3::Z, Vec3::Y) });
        assert_eq!(surface_points(&rect), surface_points(&window));
        let triangles = RectLamp { center, x, y }.halves();
        let mesh =
            Lamp::Mesh(MeshLamp::without_occlusion(triangles.concat(), vec![[0, 1, 2], [3, 4, 5]]));
        assert_eq!(surface_points(&rect), surface_points(&Shape::Lamp(mesh)));
        let plate = Surfel { point: center, normal: Vec3::Z, area: 0.64 };
        // Sides of the same length, turned about the normal as it happens.
        assert!(between(&rect, &Shape::Lamp(Lamp::Surfels(vec![plate]))) < 0.3);
    }
}
