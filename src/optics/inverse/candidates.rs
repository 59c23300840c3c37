//! Places where a light that the photo does not show may be, and the shape of one that it does.

use glam::{Quat, Vec3};

use super::surfels::LampPixels;
use super::visible_lamp::SeenLamp;
use crate::geometry::{Camera, PlaneFit};
use crate::image::{Mask, Normal, Points};
use {
    super::LampForms, crate::optics::Lamp, crate::optics::LightKind, crate::optics::RectLamp, crate::optics::Shape,
    crate::optics::SphereLamp, crate::optics::Window,
};

/// The room as a box, as far as it can be told from what is seen; at least 2.4 m high.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoomBox {
    /// Corners in the room's own frame: camera space turned about the vertical so that the walls are level with the axes.
    pub low: Vec3,
    pub high: Vec3,
    /// From the room's frame to camera space.
    turn: Quat,
}

impl RoomBox {
    /// The box of given corners, turned about the vertical by `yaw` (radians).
    pub fn new(low: Vec3, high: Vec3, yaw: f32) -> RoomBox {
        RoomBox { low, high, turn: Quat::from_rotation_y(yaw) }
    }

    /// The walls' directions are where most upright area looks, modulo a right angle. A side lies where most area faces away
    /// from it: the largest flat thing in the outer third that looks left is the right wall. Where less than 1 % of the area
    /// looks that way, the side is the 2nd percentile of all points. `None` when there is no point.
    pub fn around(points: &[Vec3], normals: &[Vec3]) -> Option<RoomBox> {
        if points.is_empty() {
            return None;
        }
        // What is seen through a window may be far away and huge: it is no side of the room.
        let far = 2.5 * median(points.iter().map(|p| -p.z).collect());
        // Each point stands for a pixel, which covers z^2 of its surface over the slant.
        let area: Vec<f32> = points
            .iter()
            .zip(normals)
            .map(|(p, n)| {
                let slant = (-n.dot(*p) / p.length().max(1e-6)).max(0.1);
                if -p.z < far { p.z * p.z / slant } else { 0.0 }
            })
            .collect();
        // Four times the angle makes all four walls point the same way: their mean is that of the room.
        let (mut cos, mut sin) = (0.0, 0.0);
        for (n, area) in normals.iter().zip(&area).filter(|(n, _)| n.y.abs() < 0.3) {
            let angle = 4.0 * n.x.atan2(n.z);
            (cos, sin) = (cos + area * angle.cos(), sin + area * angle.sin());
        }
        let yaw = if cos == 0.0 && sin == 0.0 { 0.0 } else { 0.25 * f32::atan2(sin, cos) };
        let back = Quat::from_rotation_y(-yaw);
        let points: Vec<Vec3> = points.iter().map(|p| back * *p).collect();
        let normals: Vec<Vec3> = normals.iter().map(|n| back * *n).collect();

        let all: f32 = area.iter().sum();
        let side = |axis: usize, sign: f32| -> f32 {
            let mut order: Vec<usize> = (0..points.len()).collect();
            order.sort_by(|&a, &b| (sign * points[a][axis]).total_cmp(&(sign * points[b][axis])));
            let outer = points[order[(order.len() - 1) / 50]][axis];
            order.truncate(order.len().div_ceil(3));
            let flat: Vec<usize> = order.into_iter().filter(|&i| normals[i][axis] * sign > 0.85).collect();
            // The stretch of 5 % of the room's depth that holds most area.
            let (mut from, mut sum, mut best) = (0, 0.0, (0.0, outer));
            for to in 0..flat.len() {
                sum += area[flat[to]];
                while (points[flat[to]][axis] - points[flat[from]][axis]).abs() > 0.02 * far {
                    sum -= area[flat[from]];
                    from += 1;
                }
                if sum > best.0 {
                    best = (sum, 0.5 * (points[flat[to]][axis] + points[flat[from]][axis]));
                }
            }
            if best.0 > 0.01 * all { best.1 } else { outer }
        };
        let [x, y, z] = [0, 1, 2].map(|axis| (side(axis, 1.0), side(axis, -1.0)));
        // A camera that looks down sees no ceiling.
        let high = Vec3::new(x.1, y.1.max(y.0 + 2.4), z.1);
        Some(RoomBox::new(Vec3::new(x.0, y.0, z.0), high, yaw))
    }

    /// How far out of the box a point lies, along the axis along which that is farthest, as a share of the box; 0 inside.
    pub fn outside(&self, point: Vec3) -> f32 {
        let at = self.turn.inverse() * point;
        let out = (self.low - at).max(at - self.high) / (self.high - self.low).max(Vec3::splat(1e-6));
        out.max_element().max(0.0)
    }

    /// How far the room is seen to reach.
    fn depth(&self) -> f32 {
        (-self.low.z).max(0.1)
    }
}

pub(in crate::optics) fn in_view(camera: &Camera, point: Vec3) -> bool {
    // A margin, since a light has extent.
    camera.project(point).is_some_and(|at| {
        let (w, h) = (camera.width as f32, camera.height as f32);
        at.x > -0.02 * w && at.x < 1.02 * w && at.y > -0.02 * h && at.y < 1.02 * h
    })
}

/// Lamps out of view: under the ceiling, facing down, and free-standing at half height; over, beside and behind the camera.
pub fn lamp_candidates(room: &RoomBox, camera: &Camera) -> Vec<Shape> {
    let (depth, height) = (room.depth(), room.high.y - room.low.y);
    let mut lamps = Vec::new();
    for z in [-0.45, -0.3, -0.15, 0.0, 0.15] {
        for x in [0.1, 0.37, 0.63, 0.9] {
            let across = room.low.x + x * (room.high.x - room.low.x);
            let at = |share: f32| room.turn * Vec3::new(across, room.low.y + share * height, z * depth);
            let half = 0.1 * height;
            let panel =
                Lamp::Rect(RectLamp { center: at(0.95), x: room.turn * Vec3::X * half, y: room.turn * Vec3::Z * half });
            let globe = Lamp::Sphere(SphereLamp { center: at(0.85), radius: 0.06 * height });
            lamps.extend((!in_view(camera, at(0.95))).then_some(Shape::Lamp(panel)));
            lamps.extend((!in_view(camera, at(0.85))).then_some(Shape::Lamp(globe)));
        }
    }
    lamps
}

/// Windows out of view: in either side wall, and in the wall behind the camera.
pub fn window_candidates(room: &RoomBox, camera: &Camera) -> Vec<Window> {
    let (depth, height) = (room.depth(), room.high.y - room.low.y);
    let middle = room.low.y + 0.55 * height;
    let mut windows = Vec::new();
    let mut push = |center: Vec3, normal: Vec3, half_width: f32| {
        let (center, normal) = (room.turn * center, room.turn * normal);
        let y = Vec3::Y * (0.27 * height);
        let x = Vec3::Y.cross(normal) * half_width;
        if !in_view(camera, center) {
            windows.push(Window { center, x, y, lobes: Window::daylight(normal) });
        }
    };
    // A side wall that is not seen may be further out than what is.
    for out in [0.0, 0.35 * (room.high.x - room.low.x)] {
        for z in [-0.6, -0.35, -0.1, 0.15] {
            push(Vec3::new(room.low.x - out, middle, z * depth), Vec3::X, 0.12 * depth);
            push(Vec3::new(room.high.x + out, middle, z * depth), Vec3::NEG_X, 0.12 * depth);
        }
    }
    for x in [0.25, 0.5, 0.75] {
        let across = room.low.x + x * (room.high.x - room.low.x);
        push(Vec3::new(across, middle, 0.3 * depth), Vec3::NEG_Z, 0.2 * (room.high.x - room.low.x));
    }
    windows
}

/// Shapes that a light may have whose pixels are seen, the likeliest first; none when the mask has no pixel. `mask`, `points` and
/// `normal` are of the camera's size. A lamp takes the shapes that `forms` names.
pub fn visible_light(
    kind: LightKind,
    forms: LampForms,
    mask: &Mask,
    points: &Points,
    normal: &Normal,
    camera: &Camera,
    room: Option<&RoomBox>,
) -> Vec<Shape> {
    match kind {
        LightKind::Lamp => {
            let pixels = pixels_of(mask);
            let around = surroundings(mask, (camera.width.max(camera.height) / 60).max(3));
            let lamp = SeenLamp::new(LampPixels { pixels: &pixels, points, camera }, normal, &around);
            lamp.into_iter().flat_map(|lamp| lamp.shapes(forms)).map(Shape::Lamp).collect()
        }
        LightKind::Window => {
            visible_windows(mask, points, normal, camera, room).into_iter().map(Shape::Window).collect()
        }
    }
}

/// Pixels (column, row) of the mask.
fn pixels_of(mask: &Mask) -> Vec<(usize, usize)> {
    let (w, h) = mask.0.size();
    // A thin light may cover no pixel by more than half at working size.
    let most = mask.0.pixels().iter().copied().fold(0.0, f32::max);
    let threshold = 0.5f32.min(0.999 * most);
    (0..w * h).map(|i| (i % w, i / w)).filter(|&(x, y)| most > 0.0 && mask.0.get(x, y) > threshold).collect()
}

/// Pixels within `reach` of the mask's bounding box and outside of the mask.
fn surroundings(mask: &Mask, reach: usize) -> Vec<(usize, usize)> {
    let pixels = pixels_of(mask);
    let (w, h) = mask.0.size();
    let range = |value: fn(&(usize, usize)) -> usize, end: usize| {
        let low = pixels.iter().map(value).min().unwrap_or(0);
        let high = pixels.iter().map(value).max().unwrap_or(0);
        low.saturating_sub(reach)..(high + reach + 1).min(end)
    };
    let (xs, ys) = (range(|p| p.0, w), range(|p| p.1, h));
    ys.flat_map(|y| xs.clone().map(move |x| (x, y))).filter(|&(x, y)| mask.0.get(x, y) == 0.0).collect()
}

pub(in crate::optics) fn median(mut values: Vec<f32>) -> f32 {
    values.sort_by(f32::total_cmp);
    values[values.len() / 2]
}

/// Rectangles that the pane's pixels cover: on the plane of the wall around the mask, and, since that wall may be hidden, seen
/// edge-on or lost in what is seen through the glass, on the sides of the room.
fn visible_windows(
    mask: &Mask,
    points: &Points,
    normal: &Normal,
    camera: &Camera,
    room: Option<&RoomBox>,
) -> Vec<Window> {
    let pixels = pixels_of(mask);
    let rays: Vec<Vec3> = pixels.iter().map(|&(x, y)| camera.pixel_point(x, y, 1.0)).collect();
    let Some(middle) = rays.iter().sum::<Vec3>().try_normalize() else { return Vec::new() };
    let reach = (camera.width.max(camera.height) / 40).max(3);
    let (places, normals): (Vec<Vec3>, Vec<Vec3>) =
        surroundings(mask, reach).iter().map(|&(x, y)| (points.0.get(x, y), normal.0.get(x, y))).unzip();
    let wall = PlaneFit::through(&places, &normals, 0.03);
    let side = |normal: Vec3, offset: f32| PlaneFit { normal, offset, support: 0.0, spread: 0.0 };
    let sides = room
        .into_iter()
        .flat_map(|room| [side(Vec3::X, room.low.x), side(Vec3::NEG_X, -room.high.x), side(Vec3::Z, room.low.z)]);
    // At the depth of what is around it, facing the camera: always there.
    let z = if places.is_empty() { 3.0 } else { median(places.iter().map(|p| -p.z).collect()) };
    let facing = Vec3::new(-middle.x, 0.0, -middle.z).try_normalize().unwrap_or(Vec3::Z);
    let facing = side(facing, facing.dot(middle * (z / -middle.z)));
    // A wall seen at less than 5 degrees says little of where its window is.
    let usable = |plane: &PlaneFit| -plane.normal.dot(middle) > 0.09;
    let planes = wall.filter(|plane| plane.support > 0.15).into_iter().chain(sides).filter(usable).chain([facing]);
    planes.filter_map(|plane| window_on(&plane, &pixels, &rays, camera)).collect()
}

/// The window on `plane`. A mask that the picture's edge cuts continues beyond it by as much as is seen.
fn window_on(plane: &PlaneFit, pixels: &[(usize, usize)], rays: &[Vec3], camera: &Camera) -> Option<Window> {
    let (mut center, mut x, y) = extent(rays, plane)?;
    let (left, right) = (pixels.iter().any(|p| p.0 <= 1), pixels.iter().any(|p| p.0 + 2 >= camera.width));
    if left != right {
        // Along `x` to the side on which the picture ends, seen from the camera.
        let right_is_x = camera.project(center + x * 0.01)?.x > camera.project(center)?.x;
        center += if right == right_is_x { x } else { -x };
        x *= 2.0;
    }
    Some(Window { center: center + plane.normal * (0.01 + plane.spread), x, y, lobes: Window::daylight(plane.normal) })
}

/// The rectangle on `plane`, with a level edge where the plane is not level itself, that holds where `rays` meet it, the
/// outermost 3 % left out; `x cross y` is along the normal. `None` when the plane is not met.
pub(in crate::optics) fn extent(rays: &[Vec3], plane: &PlaneFit) -> Option<(Vec3, Vec3, Vec3)> {
    let met: Vec<Vec3> = rays.iter().filter_map(|ray| plane.meet(*ray)).collect();
    if met.is_empty() {
        return None;
    }
    let n = plane.normal;
    let (x, y) = if n.y.abs() < 0.8 {
        let x = Vec3::Y.cross(n).normalize();
        (x, n.cross(x))
    } else {
        let y = Vec3::Z.cross(n).cross(n).try_normalize().unwrap_or(Vec3::Z);
        (y.cross(n), y)
    };
    let range = |axis: Vec3| {
        let mut values: Vec<f32> = met.iter().map(|p| p.dot(axis)).collect();
        values.sort_by(f32::total_cmp);
        let at = |share: f32| values[((values.len() - 1) as f32 * share) as usize];
        (at(0.03), at(0.97))
    };
    let ((x0, x1), (y0, y1)) = (range(x), range(y));
    // One pixel, seen from afar, still has a size; what was left out is given back.
    let least = 0.002 * met[0].length();
    let half = |low: f32, high: f32| (0.5 * (high - low) / 0.94).max(least);
    let center = x * (0.5 * (x0 + x1)) + y * (0.5 * (y0 + y1)) + n * plane.offset;
    Some((center, x * half(x0, x1), y * half(y0, y1)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Plane;

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

    #[test]
    fn a_window_lies_in_its_wall_whatever_is_seen_through_it() {
        let (camera, mask, points, normal) = wall_with(|x, y| (50..90).contains(&x) && (30..70).contains(&y));
        let lights = visible_light(LightKind::Window, LampForms::default(), &mask, &points, &normal, &camera, None);
        let Some(Shape::Window(window)) = lights.first() else { panic!("a window") };
        let n = Vec3::new(0.3, 0.0, 1.0).normalize();
        assert!((n.dot(window.center) + 3.0 * n.z).abs() < 0.03, "on the wall");
        assert!(window.x.cross(window.y).normalize().dot(n) > 0.999, "faces the room");
        let width = points.0.get(90, 50).distance(points.0.get(49, 50));
        assert!((2.0 * window.x.length() / width - 1.0).abs() < 0.08, "{} against {width}", 2.0 * window.x.length());
    }

    #[test]
    fn a_window_cut_by_the_picture_goes_on_beyond_it() {
        let (camera, mask, points, normal) = wall_with(|x, y| x < 30 && (30..70).contains(&y));
        let lights = visible_light(LightKind::Window, LampForms::default(), &mask, &points, &normal, &camera, None);
        let Some(Shape::Window(window)) = lights.first() else { panic!("a window") };
        let edge = camera.project(window.center).expect("before the camera");
        assert!(edge.x < 3.0, "its middle is at the picture's edge, got {edge}");
    }

    #[test]
    fn outside_is_a_share_of_the_box() {
        let room = RoomBox::new(Vec3::new(-1.0, -1.0, -4.0), Vec3::new(1.0, 1.0, 0.0), 0.5);
        assert_eq!(room.outside(room.turn * Vec3::new(0.5, 0.5, -1.0)), 0.0);
        assert!((room.outside(room.turn * Vec3::new(1.5, 0.5, 1.5)) - 0.375).abs() < 1e-6);
    }

    #[test]
    fn candidates_are_out_of_view() {
        let camera = Camera::from_fov_x(320, 240, 60.0);
        let room = RoomBox::new(Vec3::new(-2.0, -1.3, -5.0), Vec3::new(2.0, 1.2, -1.0), 0.2);
        let lamps = lamp_candidates(&room, &camera);
        let windows = window_candidates(&room, &camera);
        assert!(lamps.len() > 10 && windows.len() > 5, "{} lamps, {} windows", lamps.len(), windows.len());
        for center in lamps.iter().filter_map(|l| Some(l.bounding_sphere()?.0)).chain(windows.iter().map(|w| w.center))
        {
            assert!(!in_view(&camera, center), "{center}");
        }
        for window in windows {
            let inside = Vec3::new(0.0, 0.0, -2.5) - window.center;
            assert!(window.x.cross(window.y).dot(inside) > 0.0, "faces the room: {window:?}");
        }
    }
}
