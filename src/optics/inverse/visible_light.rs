//! Shapes that a visible light may have.

use glam::Vec3;

use super::LampForms;
use super::mask_pixels::{pixels_of, surroundings};
use super::surfels::LampPixels;
use super::visible_lamp::VisibleLamp;
use super::visible_window::visible_windows;
use crate::geometry::{Camera, RoomLayout};
use crate::image::{Mask, Normal, Points};
use crate::optics::{LightKind, Shape};
use crate::tuning::tuning;

tuning! {
    /// Constants of the surroundings of a visible lamp.
    pub const TUNING: VisibleLightTuning {
        /// Width of the surroundings of a lamp: this part of the picture's longer side.
        surroundings: usize = 60,
            unit "1 over the fraction", source Taste, effect "a smaller value looks at more of the ceiling";
        /// Least width of the surroundings.
        min_surroundings: usize = 3,
            unit "pixels", source Taste, effect "a larger value looks at more of the ceiling of small pictures";
    }
}

/// Shapes that a visible light may have, the preferred one first; none when the mask is empty.
///
/// `mask`, `points` (meters, camera space) and `normal` are of the camera's size. `forms` selects
/// the form of a lamp. `room` determines what is upright, and adds the sides of the room as places
/// for a window; without it the camera is level.
pub fn visible_light(
    kind: LightKind,
    forms: LampForms,
    mask: &Mask,
    points: &Points,
    normal: &Normal,
    camera: &Camera,
    room: Option<&RoomLayout>,
) -> Vec<Shape> {
    match kind {
        LightKind::Lamp => {
            let pixels = pixels_of(mask);
            let around = surroundings(
                mask,
                (camera.width.max(camera.height) / TUNING.surroundings)
                    .max(TUNING.min_surroundings),
            );
            let pixels = LampPixels { pixels: &pixels, points, camera };
            let up = room.map_or(Vec3::Y, RoomLayout::up);
            let lamp = VisibleLamp::new(pixels, normal, &around, up);
            lamp.into_iter().flat_map(|lamp| lamp.shapes(forms)).map(Shape::Lamp).collect()
        }
        LightKind::Window => visible_windows(mask, points, normal, camera, room)
            .into_iter()
            .map(Shape::Window)
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use glam::Quat;

    use super::*;
    use crate::geometry::SideSource;
    use crate::image::Plane;
    use crate::optics::inverse::LampForm;
    use crate::optics::{BoxLamp, Lamp, SphereLamp, Surfel, Window};

    fn wall_with(hole: impl Fn(usize, usize) -> bool) -> (Camera, Mask, Points, Normal) {
        let camera = Camera::from_fov_x(160, 120, 60.0);
        // A wall at z = 3 whose left end is nearer.
        let n = Vec3::new(0.3, 0.0, 1.0).normalize();
        let points = Plane::from_fn(160, 120, |x, y| {
            let ray = camera.pixel_point(x, y, 1.0);
            let t = -3.0 * n.z / n.dot(ray);
            ray * if hole(x, y) { t * 20.0 } else { t }
        });
        let mask = Mask(Plane::from_fn(160, 120, |x, y| if hole(x, y) { 1.0 } else { 0.0 }));
        (camera, mask, Points(points), Normal(Plane::filled(160, 120, n)))
    }

    /// The preferred shape of a window.
    fn window(
        camera: &Camera,
        mask: &Mask,
        points: &Points,
        normal: &Normal,
        room: Option<&RoomLayout>,
    ) -> Window {
        let forms = LampForms::default();
        let shapes = visible_light(LightKind::Window, forms, mask, points, normal, camera, room);
        let Some(Shape::Window(window)) = shapes.into_iter().next() else { panic!("a window") };
        window
    }

    #[test]
    fn a_window_lies_in_its_wall_whatever_is_seen_through_it() {
        let (camera, mask, points, normal) =
            wall_with(|x, y| (50..90).contains(&x) && (30..70).contains(&y));
        let window = window(&camera, &mask, &points, &normal, None);
        let n = Vec3::new(0.3, 0.0, 1.0).normalize();
        assert!((n.dot(window.center) + 3.0 * n.z).abs() < 0.03, "on the wall");
        assert!(window.x.cross(window.y).normalize().dot(n) > 0.999, "faces the room");
        let width = points.0.get(90, 50).distance(points.0.get(49, 50));
        assert!(
            (2.0 * window.x.length() / width - 1.0).abs() < 0.08,
            "{} against {width}",
            2.0 * window.x.length()
        );
    }

    #[test]
    fn a_window_cut_by_the_picture_goes_on_beyond_it() {
        let (camera, mask, points, normal) = wall_with(|x, y| x < 30 && (30..70).contains(&y));
        let window = window(&camera, &mask, &points, &normal, None);
        let edge = camera.project(window.center).expect("before the camera");
        assert!(edge.x < 3.0, "its middle is at the picture's edge, got {edge}");
    }

    #[test]
    fn a_window_cut_by_the_top_of_the_picture_ends_at_the_ceiling() {
        let (camera, mask, points, normal) = wall_with(|x, y| (60..90).contains(&x) && y < 30);
        let unlimited = window(&camera, &mask, &points, &normal, None);
        let edge = camera.project(unlimited.center).expect("before the camera");
        assert!(edge.y < 3.0, "its middle is at the picture's edge, got {edge}");
        let ceiling = 1.5;
        let room = RoomLayout::new(
            (Quat::IDENTITY, Vec3::new(-3.0, -1.5, -4.0), Vec3::new(3.0, ceiling, 2.0)),
            [SideSource::Seen; 6],
            (&camera, &points),
            Plane::filled(160, 120, 0),
            1,
        );
        let limited = window(&camera, &mask, &points, &normal, Some(&room));
        let [low, limited_low] = [&unlimited, &limited].map(|window| (window.center - window.y).y);
        assert!((low - limited_low).abs() < 1e-3, "{low} {limited_low}");
        let high = (limited.center + limited.y).y;
        assert!((high - ceiling).abs() < 1e-3, "{high}");
    }

    #[test]
    fn a_window_is_upright_in_the_room_of_a_camera_that_looks_down() {
        let camera = Camera::from_fov_x(160, 120, 70.0);
        // In the room the wall is at z = -3, and the window 1.2 m wide and 0.8 m high.
        let rotation = Quat::from_rotation_x(0.35) * Quat::from_rotation_y(-0.6);
        let (center, half) = (Vec3::new(-1.0, -0.2, -3.0), Vec3::new(0.6, 0.4, 0.0));
        let points = Plane::from_fn(160, 120, |x, y| {
            let ray = camera.pixel_point(x, y, 1.0);
            ray * (-3.0 / (rotation.inverse() * ray).z)
        });
        let is_window = |point: &Vec3| {
            let from_center = (rotation.inverse() * *point - center).abs();
            f32::from(u8::from(from_center.cmple(half + 1e-3).all()))
        };
        let mask = Mask(Plane::from_fn(160, 120, |x, y| is_window(&points.get(x, y))));
        let normal = Normal(Plane::filled(160, 120, rotation * Vec3::Z));
        let points = Points(points);
        let room = RoomLayout::new(
            (rotation, Vec3::new(-3.0, -1.5, -3.0), Vec3::new(3.0, 1.5, 2.0)),
            [SideSource::Seen; 6],
            (&camera, &points),
            Plane::filled(160, 120, 0),
            1,
        );
        let window = window(&camera, &mask, &points, &normal, Some(&room));
        let [x, y] = [window.x, window.y].map(|edge| rotation.inverse() * edge);
        assert!((x - half.x * Vec3::X).length() < 0.05, "{x}");
        assert!((y - half.y * Vec3::Y).length() < 0.05, "{y}");
        assert!((rotation.inverse() * window.center - center).length() < 0.05);
        // The sky is above the horizon of the room, as the ground is below.
        let [_, sky, ground] = window.lobes.map(|lobe| rotation.inverse() * lobe.direction);
        assert!((sky.y + ground.y).abs() < 1e-5 && sky.y > 0.7, "{sky} and {ground}");
    }

    fn forms(form: LampForm) -> LampForms {
        LampForms { form, ..LampForms::default() }
    }

    fn shapes(
        form: LampForm,
        camera: &Camera,
        z: &Plane<f32>,
        mask: &Plane<bool>,
        normal: Vec3,
    ) -> Vec<Shape> {
        let points = Points(Plane::from_fn(z.width(), z.height(), |x, y| {
            camera.pixel_point(x, y, z.get(x, y))
        }));
        let mask = Mask(mask.map(|inside| if inside { 1.0 } else { 0.0 }));
        let normal = Normal(Plane::filled(z.width(), z.height(), normal));
        visible_light(LightKind::Lamp, forms(form), &mask, &points, &normal, camera, None)
    }

    #[test]
    fn a_ball_is_a_sphere_and_a_strip_is_a_box() {
        let camera = Camera::from_fov_x(160, 120, 60.0);
        let center = Vec3::new(0.4, 0.3, -2.5);
        let seen = Shape::Lamp(Lamp::Sphere(SphereLamp { center, radius: 0.25 }));
        let z = Plane::from_fn(160, 120, |x, y| {
            seen.intersect(Vec3::ZERO, camera.pixel_point(x, y, 1.0)).unwrap_or(5.0)
        });
        let made = |form: LampForm| shapes(form, &camera, &z, &z.map(|z| z < 5.0), Vec3::Z);
        let [Shape::Lamp(Lamp::Sphere(SphereLamp { center: got, radius }))] =
            made(LampForm::Solid)[..]
        else {
            panic!("a sphere")
        };
        assert!(
            got.distance(center) < 0.05 && (radius / 0.25 - 1.0).abs() < 0.05,
            "{got} {radius}"
        );
        let [Shape::Lamp(Lamp::Box(BoxLamp { center: got, .. }))] = made(LampForm::Box)[..] else {
            panic!("a box")
        };
        assert!(got.distance(center) < 0.05, "{got}");
        let [Shape::Lamp(Lamp::Surfels(surfels))] = &made(LampForm::Surfels)[..] else {
            panic!("surfels")
        };
        let area: f32 = surfels.iter().map(|p| p.area).sum();
        let want = 4.0 * std::f32::consts::PI * 0.0625;
        assert!(
            surfels.len() <= 128 && (area / want - 1.0).abs() < 0.05,
            "{} surfels, {area} {want}",
            surfels.len()
        );
        assert_eq!(made(LampForm::Best).len(), 2);

        let strip =
            Plane::from_fn(160, 120, |x, y| (40..120).contains(&x) && (50..60).contains(&y));
        let shape = shapes(
            LampForm::Solid,
            &camera,
            &strip.map(|s| if s { 2.0 } else { 5.0 }),
            &strip,
            Vec3::Z,
        );
        assert!(matches!(shape[..], [Shape::Lamp(Lamp::Box(_))]), "{shape:?}");
    }

    #[test]
    fn a_panel_in_the_ceiling_emits_from_one_side() {
        let camera = Camera::from_fov_x(160, 120, 60.0);
        // A ceiling 1 m above the camera, seen in the upper half; walls 5 m away.
        let height = |y: usize| camera.pixel_point(0, y, 1.0).y;
        let z =
            Plane::from_fn(160, 120, |_, y| if height(y) > 0.2 { 1.0 / height(y) } else { 5.0 });
        let mask = Plane::from_fn(160, 120, |x, y| (60..100).contains(&x) && (8..20).contains(&y));
        let made = |form: LampForm| shapes(form, &camera, &z, &mask, Vec3::NEG_Y);
        assert!(matches!(made(LampForm::Solid)[..], [Shape::Lamp(Lamp::Rect(_))]));
        let [Shape::Lamp(Lamp::Surfels(surfels))] = &made(LampForm::Surfels)[..] else {
            panic!("surfels")
        };
        assert!(surfels.iter().all(|p| p.normal == Vec3::NEG_Y && (p.point.y - 0.99).abs() < 1e-3));
        // 40 pixels wide from where row 8 begins to where row 20 does: the integral of (40 / f) z
        // dz.
        let [near, far] = [8.0, 20.0].map(|row| 0.99 * camera.fy / (camera.cy - row));
        let want = 20.0 / camera.fx * (far * far - near * near);
        let area = surfels.iter().map(|p| p.area).sum::<f32>();
        assert!((area / want - 1.0).abs() < 0.01, "{area} {want}");
    }

    /// A lamp whose depth is that of the wall behind it stands before the wall, as deep
    /// as its outline is narrow.
    #[test]
    fn a_lamp_that_the_depth_does_not_show_stands_before_its_wall() {
        let camera = Camera::from_fov_x(160, 120, 60.0);
        let mask = Plane::from_fn(160, 120, |x, y| (x as f32 - 79.5).hypot(y as f32 - 59.5) < 10.0);
        let made =
            shapes(LampForm::Surfels, &camera, &Plane::filled(160, 120, 3.0), &mask, Vec3::Z);
        let [Shape::Lamp(Lamp::Surfels(surfels))] = &made[..] else { panic!("surfels") };
        // At the depth of the wall, then at that of the lamp.
        let radius = 10.0 / camera.fx * 3.0;
        let radius = radius * (1.0 - radius / 3.0);
        let depth = |p: &Surfel| -p.point.z;
        let (near, far) =
            surfels.iter().fold((f32::MAX, 0f32), |(a, b), p| (a.min(depth(p)), b.max(depth(p))));
        assert!(
            (near - (3.0 - 2.0 * radius)).abs() < 0.1 * radius && (far - 3.0).abs() < 0.1 * radius,
            "{near} {far}"
        );
    }
}
