//! Candidates for the lamp and the window out of view.

use glam::Vec3;

use super::RoomBox;
use crate::geometry::Camera;
use crate::optics::{Lamp, RectLamp, Shape, SphereLamp, Window};

/// Margin around the picture in which a light still counts as in view.
/// Unit: fraction of the picture's side; source: extent of lights; effect: larger values move
/// candidates outward.
const MARGIN: f32 = 0.02;

/// Grid of lamps: depths along the view from the camera (negative is before it), and positions
/// across the room.
/// Unit: fractions of the room's depth and width; source: taste; effect: more are found more
/// exactly and take longer.
const LAMP_DEPTHS: [f32; 5] = [-0.45, -0.3, -0.15, 0.0, 0.15];
const LAMP_ACROSS: [f32; 4] = [0.1, 0.37, 0.63, 0.9];

/// Heights of panels and of globes, half edge of a panel, and radius of a globe.
/// Unit: fractions of the room's height; source: common rooms; effect: position and size of
/// candidates.
const PANEL_HEIGHT: f32 = 0.95;
const GLOBE_HEIGHT: f32 = 0.85;
const PANEL_HALF_EDGE: f32 = 0.1;
const GLOBE_RADIUS: f32 = 0.06;

/// Height of a window's middle, and half of its height.
/// Unit: fractions of the room's height; source: common rooms; effect: position and size of
/// candidates.
const WINDOW_MIDDLE: f32 = 0.55;
const WINDOW_HALF_HEIGHT: f32 = 0.27;

/// Windows in side walls: distances of the wall outside of the seen room, depths, and half width.
/// Unit: fractions of the room's width, depth and depth; source: taste; effect: as for lamps.
const SIDE_OFFSETS: [f32; 2] = [0.0, 0.35];
const SIDE_DEPTHS: [f32; 4] = [-0.6, -0.35, -0.1, 0.15];
const SIDE_HALF_WIDTH: f32 = 0.12;

/// Windows behind the camera: positions across, distance behind it, and half width.
/// Unit: fractions of the room's width, depth and width; source: taste; effect: as for lamps.
const BACK_ACROSS: [f32; 3] = [0.25, 0.5, 0.75];
const BACK_DEPTH: f32 = 0.3;
const BACK_HALF_WIDTH: f32 = 0.2;

/// Whether a point in camera space projects into the picture, extended by `MARGIN` of its size.
pub(in crate::optics) fn in_view(camera: &Camera, point: Vec3) -> bool {
    // A margin, since a light has extent.
    camera.project(point).is_some_and(|at| {
        let (w, h) = (camera.width as f32, camera.height as f32);
        at.x > -MARGIN * w && at.x < (1.0 + MARGIN) * w && at.y > -MARGIN * h && at.y < (1.0 + MARGIN) * h
    })
}

/// Candidates for a lamp out of view: panels under the ceiling that face down, and globes below it,
/// on a grid over, beside and behind the camera. Those whose center is in view are left out.
pub fn lamp_candidates(room: &RoomBox, camera: &Camera) -> Vec<Shape> {
    let (depth, height) = (room.depth(), room.high.y - room.low.y);
    let mut lamps = Vec::new();
    for z in LAMP_DEPTHS {
        for x in LAMP_ACROSS {
            let across = room.low.x + x * (room.high.x - room.low.x);
            let at = |level: f32| room.rotation * Vec3::new(across, room.low.y + level * height, z * depth);
            let half = PANEL_HALF_EDGE * height;
            let panel = Lamp::Rect(RectLamp {
                center: at(PANEL_HEIGHT),
                x: room.rotation * Vec3::X * half,
                y: room.rotation * Vec3::Z * half,
            });
            let globe = Lamp::Sphere(SphereLamp { center: at(GLOBE_HEIGHT), radius: GLOBE_RADIUS * height });
            lamps.extend((!in_view(camera, at(PANEL_HEIGHT))).then_some(Shape::Lamp(panel)));
            lamps.extend((!in_view(camera, at(GLOBE_HEIGHT))).then_some(Shape::Lamp(globe)));
        }
    }
    lamps
}

/// Candidates for a window out of view, in either side wall and in the wall behind the camera, with
/// lobes of daylight. Those whose center is in view are left out.
pub fn window_candidates(room: &RoomBox, camera: &Camera) -> Vec<Window> {
    let (depth, height) = (room.depth(), room.high.y - room.low.y);
    let middle = room.low.y + WINDOW_MIDDLE * height;
    let mut windows = Vec::new();
    let mut push = |center: Vec3, normal: Vec3, half_width: f32| {
        let (center, normal) = (room.rotation * center, room.rotation * normal);
        let y = Vec3::Y * (WINDOW_HALF_HEIGHT * height);
        let x = Vec3::Y.cross(normal) * half_width;
        if !in_view(camera, center) {
            windows.push(Window { center, x, y, lobes: Window::daylight(normal) });
        }
    };
    // A side wall that is not seen may be further out than the seen points.
    for out in SIDE_OFFSETS.map(|offset| offset * (room.high.x - room.low.x)) {
        for z in SIDE_DEPTHS {
            push(Vec3::new(room.low.x - out, middle, z * depth), Vec3::X, SIDE_HALF_WIDTH * depth);
            push(Vec3::new(room.high.x + out, middle, z * depth), Vec3::NEG_X, SIDE_HALF_WIDTH * depth);
        }
    }
    for x in BACK_ACROSS {
        let across = room.low.x + x * (room.high.x - room.low.x);
        push(Vec3::new(across, middle, BACK_DEPTH * depth), Vec3::NEG_Z, BACK_HALF_WIDTH * (room.high.x - room.low.x));
    }
    windows
}

#[cfg(test)]
mod tests {
    use super::*;

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
