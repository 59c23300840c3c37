//! Candidates for the lamp and the window out of view.

use glam::Vec3;

use super::RoomBox;
use crate::geometry::Camera;
use crate::optics::{Lamp, RectLamp, Shape, SphereLamp, Window};
use crate::tuning::tuning;

tuning! {
    /// Constants of the candidates for a lamp and a window out of view.
    pub const TUNING: CandidatesTuning {
        /// Margin around the picture in which a light still counts as in view, since a light has
        /// extent.
        margin: f32 = 0.02,
            unit "fraction of the picture's side", source Taste, effect "a larger value moves candidates outward";
        /// Depths of the grid of lamps along the view from the camera; negative ones are before it.
        lamp_depths: [f32; 5] = [-0.45, -0.3, -0.15, 0.0, 0.15],
            unit "fractions of the room's depth", source Taste,
            effect "more values find lamps more exactly and take longer";
        /// Positions of the grid of lamps across the room.
        lamp_across: [f32; 4] = [0.1, 0.37, 0.63, 0.9],
            unit "fractions of the room's width", source Taste,
            effect "more values find lamps more exactly and take longer";
        /// Height of panels above the floor.
        panel_height: f32 = 0.95,
            unit "fraction of the room's height", source Derived("proportions of common rooms"),
            effect "a larger value moves panels towards the ceiling";
        /// Height of globes above the floor.
        globe_height: f32 = 0.85,
            unit "fraction of the room's height", source Derived("proportions of common rooms"),
            effect "a larger value moves globes towards the ceiling";
        /// Half of the edge of a panel.
        panel_half_edge: f32 = 0.1,
            unit "fraction of the room's height", source Derived("proportions of common rooms"),
            effect "a larger value makes softer shadows";
        /// Radius of a globe.
        globe_radius: f32 = 0.06,
            unit "fraction of the room's height", source Derived("proportions of common rooms"),
            effect "a larger value makes softer shadows";
        /// Height of a window's middle above the floor.
        window_middle: f32 = 0.55,
            unit "fraction of the room's height", source Derived("proportions of common rooms"),
            effect "a larger value moves windows upward";
        /// Half of the height of a window.
        window_half_height: f32 = 0.27,
            unit "fraction of the room's height", source Derived("proportions of common rooms"),
            effect "a larger value makes windows higher";
        /// Distances of a side wall outside of the seen room.
        side_offsets: [f32; 2] = [0.0, 0.35],
            unit "fractions of the room's width", source Taste,
            effect "more values find windows more exactly and take longer";
        /// Depths of windows in a side wall; negative ones are before the camera.
        side_depths: [f32; 4] = [-0.6, -0.35, -0.1, 0.15],
            unit "fractions of the room's depth", source Taste,
            effect "more values find windows more exactly and take longer";
        /// Half of the width of a window in a side wall.
        side_half_width: f32 = 0.12,
            unit "fraction of the room's depth", source Taste, effect "a larger value makes windows wider";
        /// Positions of windows behind the camera across the room.
        back_across: [f32; 3] = [0.25, 0.5, 0.75],
            unit "fractions of the room's width", source Taste,
            effect "more values find windows more exactly and take longer";
        /// Distance of the back wall behind the camera.
        back_depth: f32 = 0.3,
            unit "fraction of the room's depth", source Taste,
            effect "a larger value moves windows behind the camera away from it";
        /// Half of the width of a window behind the camera.
        back_half_width: f32 = 0.2,
            unit "fraction of the room's width", source Taste, effect "a larger value makes windows wider";
    }
}

/// Whether a point in camera space projects into the picture, extended by `MARGIN` of its size.
pub(in crate::optics) fn in_view(camera: &Camera, point: Vec3) -> bool {
    // A margin, since a light has extent.
    camera.project(point).is_some_and(|at| {
        let (w, h) = (camera.width as f32, camera.height as f32);
        at.x > -TUNING.margin * w
            && at.x < (1.0 + TUNING.margin) * w
            && at.y > -TUNING.margin * h
            && at.y < (1.0 + TUNING.margin) * h
    })
}

/// Candidates for a lamp out of view: panels under the ceiling that face down, and globes below it,
/// on a grid over, beside and behind the camera. Those whose center is in view are left out.
pub fn lamp_candidates(room: &RoomBox, camera: &Camera) -> Vec<Shape> {
    let (depth, height) = (room.depth(), room.high.y - room.low.y);
    let mut lamps = Vec::new();
    for z in TUNING.lamp_depths {
        for x in TUNING.lamp_across {
            let across = room.low.x + x * (room.high.x - room.low.x);
            let at = |level: f32| {
                room.rotation * Vec3::new(across, room.low.y + level * height, z * depth)
            };
            let half = TUNING.panel_half_edge * height;
            let panel = Lamp::Rect(RectLamp {
                center: at(TUNING.panel_height),
                x: room.rotation * Vec3::X * half,
                y: room.rotation * Vec3::Z * half,
            });
            let globe = Lamp::Sphere(SphereLamp {
                center: at(TUNING.globe_height),
                radius: TUNING.globe_radius * height,
            });
            lamps.extend((!in_view(camera, at(TUNING.panel_height))).then_some(Shape::Lamp(panel)));
            lamps.extend((!in_view(camera, at(TUNING.globe_height))).then_some(Shape::Lamp(globe)));
        }
    }
    lamps
}

/// Candidates for a window out of view, in either side wall and in the wall behind the camera, with
/// lobes of daylight. Those whose center is in view are left out.
pub fn window_candidates(room: &RoomBox, camera: &Camera) -> Vec<Window> {
    let (depth, height) = (room.depth(), room.high.y - room.low.y);
    let middle = room.low.y + TUNING.window_middle * height;
    let mut windows = Vec::new();
    let mut push = |center: Vec3, normal: Vec3, half_width: f32| {
        let (center, normal) = (room.rotation * center, room.rotation * normal);
        let y = Vec3::Y * (TUNING.window_half_height * height);
        let x = Vec3::Y.cross(normal) * half_width;
        if !in_view(camera, center) {
            windows.push(Window { center, x, y, lobes: Window::daylight(normal) });
        }
    };
    // A side wall that is not seen may be further out than the seen points.
    for out in TUNING.side_offsets.map(|offset| offset * (room.high.x - room.low.x)) {
        for z in TUNING.side_depths {
            push(
                Vec3::new(room.low.x - out, middle, z * depth),
                Vec3::X,
                TUNING.side_half_width * depth,
            );
            push(
                Vec3::new(room.high.x + out, middle, z * depth),
                Vec3::NEG_X,
                TUNING.side_half_width * depth,
            );
        }
    }
    for x in TUNING.back_across {
        let across = room.low.x + x * (room.high.x - room.low.x);
        push(
            Vec3::new(across, middle, TUNING.back_depth * depth),
            Vec3::NEG_Z,
            TUNING.back_half_width * (room.high.x - room.low.x),
        );
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
        assert!(
            lamps.len() > 10 && windows.len() > 5,
            "{} lamps, {} windows",
            lamps.len(),
            windows.len()
        );
        for center in lamps
            .iter()
            .filter_map(|l| Some(l.bounding_sphere()?.0))
            .chain(windows.iter().map(|w| w.center))
        {
            assert!(!in_view(&camera, center), "{center}");
        }
        for window in windows {
            let inside = Vec3::new(0.0, 0.0, -2.5) - window.center;
            assert!(window.x.cross(window.y).dot(inside) > 0.0, "faces the room: {window:?}");
        }
    }
}
