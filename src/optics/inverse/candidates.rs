//! Candidates for the lamp and the window out of view.

use glam::Vec3;

use crate::geometry::{Camera, RoomLayout, SideSource};
use crate::optics::{Lamp, RectLamp, Shape, SphereLamp, Window};
use crate::tuning::tuning;

tuning! {
    /// Constants of the candidates for a lamp and a window out of view.
    pub const TUNING: CandidatesTuning {
        /// Margin around the picture in which a light still counts as in view, since a light has
        /// extent.
        margin: f32 = 0.02,
            unit "fraction of the picture's side", source Taste, effect "a larger value moves candidates outward";
        /// Distance of the lamps of the grid under the ceiling.
        lamp_spacing: f32 = 0.7,
            unit "meters", source Measured("docs/room.md"),
            effect "a smaller value finds lamps more exactly and takes longer";
        /// Largest number of lamps along an edge of the ceiling.
        max_lamps: usize = 8,
            unit "lamps", source Measured("docs/room.md"),
            effect "a larger value finds lamps in large rooms more exactly and takes longer";
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
        /// Distance of the windows along a wall.
        window_spacing: f32 = 1.0,
            unit "meters", source Measured("docs/room.md"),
            effect "a smaller value finds windows more exactly and takes longer";
        /// Largest number of windows along a wall.
        max_windows: usize = 6,
            unit "windows", source Measured("docs/room.md"),
            effect "a larger value finds windows in long walls more exactly and takes longer";
        /// Half of the width of a window.
        window_half_width: f32 = 0.4,
            unit "fraction of their distance", source Measured("docs/room.md"),
            effect "a larger value makes windows wider";
        /// Least cosine between the normals of two windows of one wall, 25 degrees.
        same_wall_cosine: f32 = 0.9,
            unit "1", source Taste, effect "a smaller value leaves out more candidates beside windows in view";
        /// Largest distance of a window from the plane of another in the same wall.
        same_wall: f32 = 0.3,
            unit "meters", source Taste, effect "a larger value leaves out more candidates beside windows in view";
        /// Distance of a window from its wall: shadow rays do not end in the wall.
        before_wall: f32 = 0.01,
            unit "meters", source Taste, effect "a larger value moves windows into the room";
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

/// Even places along an edge of this length, in fractions of it.
fn places(length: f32, spacing: f32, most: usize) -> Vec<f32> {
    let count = ((length / spacing).round() as usize).clamp(1, most);
    (0..count).map(|i| (i as f32 + 0.5) / count as f32).collect()
}

/// Candidates for a lamp out of view: panels under the ceiling that face down, and globes below it,
/// on a grid over the whole room. Those whose center is in view are left out.
pub fn lamp_candidates(room: &RoomLayout, camera: &Camera) -> Vec<Shape> {
    let size = room.high - room.low;
    let half = TUNING.panel_half_edge * size.y;
    let [x, y] = [Vec3::X, Vec3::Z].map(|axis| room.rotation * axis * half);
    let radius = TUNING.globe_radius * size.y;
    let along = |length: f32| places(length, TUNING.lamp_spacing, TUNING.max_lamps);
    let mut lamps = Vec::new();
    for z in along(size.z) {
        for across in along(size.x) {
            let at = |level: f32| room.place(Vec3::new(across, level, z));
            let panel = Lamp::Rect(RectLamp { center: at(TUNING.panel_height), x, y });
            let globe = Lamp::Sphere(SphereLamp { center: at(TUNING.globe_height), radius });
            lamps.extend((!in_view(camera, at(TUNING.panel_height))).then_some(Shape::Lamp(panel)));
            lamps.extend((!in_view(camera, at(TUNING.globe_height))).then_some(Shape::Lamp(globe)));
        }
    }
    lamps
}

/// Candidates for a window out of view, in all walls but open ones, with lobes of daylight. Those
/// whose center is in view, and those that overlap a window of `visible`, are left out.
pub fn window_candidates(room: &RoomLayout, camera: &Camera, visible: &[&Window]) -> Vec<Window> {
    let size = room.high - room.low;
    let y = room.up() * (TUNING.window_half_height * size.y);
    let mut windows = Vec::new();
    for (side, along) in [(0, 2), (1, 2), (4, 0), (5, 0)] {
        if room.sides[side] == SideSource::Open {
            continue;
        }
        let (normal, _) = room.plane(side);
        let places = places(size[along], TUNING.window_spacing, TUNING.max_windows);
        let half = TUNING.window_half_width * size[along] / places.len() as f32;
        let x = room.up().cross(normal) * half;
        for at in places {
            let mut place = Vec3::new(0.0, TUNING.window_middle, 0.0);
            (place[side / 2], place[along]) = ((side % 2) as f32, at);
            let center = room.place(place) + normal * TUNING.before_wall;
            let window = Window { center, x, y, lobes: Window::daylight(normal, room.up()) };
            if !in_view(camera, center) && !visible.iter().any(|seen| overlaps(&window, seen)) {
                windows.push(window);
            }
        }
    }
    windows
}

/// Whether two upright windows of the same wall overlap, whatever their heights.
fn overlaps(a: &Window, b: &Window) -> bool {
    let [normal_a, normal_b] = [a, b].map(|window| window.x.cross(window.y).normalize());
    let between = a.center - b.center;
    normal_a.dot(normal_b) > TUNING.same_wall_cosine
        && between.dot(normal_b).abs() < TUNING.same_wall
        && between.dot(b.x.normalize()).abs() < a.x.length() + b.x.length()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Quat;

    use crate::image::{Plane, Points};

    #[test]
    fn candidates_are_out_of_view() {
        let camera = Camera::from_fov_x(320, 240, 60.0);
        let corners = (Vec3::new(-2.0, -1.3, -5.0), Vec3::new(2.0, 1.2, 1.5));
        let far = Points(Plane::filled(320, 240, Vec3::NEG_Z * 9.0));
        let room = RoomLayout::new(
            (Quat::from_rotation_y(0.2), corners.0, corners.1),
            [SideSource::Guessed; 6],
            (&camera, &far),
            Plane::filled(320, 240, 0),
            8,
        );
        let lamps = lamp_candidates(&room, &camera);
        let windows = window_candidates(&room, &camera, &[]);
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
        let seen = windows[0].clone();
        let others = window_candidates(&room, &camera, &[&seen]);
        assert!(others.len() < windows.len(), "the candidate that overlaps is left out");
        assert!(others.iter().all(|window| !overlaps(window, &seen)));
        for window in windows {
            let inside = Vec3::new(0.0, 0.0, -2.5) - window.center;
            assert!(window.x.cross(window.y).dot(inside) > 0.0, "faces the room: {window:?}");
        }
    }
}
