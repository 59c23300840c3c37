//! Rectangles that the pane of a visible window may cover.

use glam::Vec3;

use super::RoomBox;
use super::mask_pixels::{extent, median, pixels_of, surroundings};
use crate::geometry::{Camera, PlaneFit};
use crate::image::{Mask, Normal, Points};
use crate::optics::Window;

/// Width of the surroundings of a window: this fraction of the picture's longer side, and at least
/// 3 pixels.
/// Unit: 1 over the fraction; source: taste; effect: smaller values look at more of the wall.
const SURROUNDINGS: usize = 40;

/// Distance of points from the plane of the wall up to which they support it.
/// Unit: fraction of the distance; source: noise of depth maps; effect: larger values accept
/// rougher walls.
const ON_WALL: f32 = 0.03;

/// Least fraction of the surroundings on the plane of the wall.
/// Unit: 1; source: taste; effect: larger values use the sides of the room more often.
const LEAST_SUPPORT: f32 = 0.15;

/// Least cosine between a plane's normal and the ray through the window's middle, 5 degrees.
/// Unit: 1; source: taste; effect: larger values reject walls seen at an angle.
const LEAST_COSINE: f32 = 0.09;

/// Depth of a window without surroundings. Unit: meters; source: taste; effect: none but there.
const DEFAULT_DEPTH: f32 = 3.0;

/// Distance of a window from its wall. Unit: meters; source: taste; effect: shadow rays do not end
/// in the wall.
const BEFORE_WALL: f32 = 0.01;

/// Rectangles that the pane's pixels cover: on the plane of the wall around the mask, and on the
/// sides of the room. That wall may be hidden, seen edge-on, or lost in the view through the glass.
pub(super) fn visible_windows(
    mask: &Mask,
    points: &Points,
    normal: &Normal,
    camera: &Camera,
    room: Option<&RoomBox>,
) -> Vec<Window> {
    let pixels = pixels_of(mask);
    let rays: Vec<Vec3> = pixels.iter().map(|&(x, y)| camera.pixel_point(x, y, 1.0)).collect();
    let Some(middle) = rays.iter().sum::<Vec3>().try_normalize() else { return Vec::new() };
    let radius = (camera.width.max(camera.height) / SURROUNDINGS).max(3);
    let (positions, normals): (Vec<Vec3>, Vec<Vec3>) =
        surroundings(mask, radius).iter().map(|&(x, y)| (points.0.get(x, y), normal.0.get(x, y))).unzip();
    let wall = PlaneFit::through(&positions, &normals, ON_WALL);
    let side = |normal: Vec3, offset: f32| PlaneFit { normal, offset, support: 0.0, spread: 0.0 };
    let sides = room
        .into_iter()
        .flat_map(|room| [side(Vec3::X, room.low.x), side(Vec3::NEG_X, -room.high.x), side(Vec3::Z, room.low.z)]);
    // A plane at the depth of the surroundings that faces the camera always exists.
    let z = if positions.is_empty() { DEFAULT_DEPTH } else { median(positions.iter().map(|p| -p.z).collect()) };
    let facing = Vec3::new(-middle.x, 0.0, -middle.z).try_normalize().unwrap_or(Vec3::Z);
    let facing = side(facing, facing.dot(middle * (z / -middle.z)));
    // A wall seen at less than 5 degrees does not determine the position of its window.
    let usable = |plane: &PlaneFit| -plane.normal.dot(middle) > LEAST_COSINE;
    let planes =
        wall.filter(|plane| plane.support > LEAST_SUPPORT).into_iter().chain(sides).filter(usable).chain([facing]);
    planes.filter_map(|plane| window_on(&plane, &pixels, &rays, camera)).collect()
}

/// The window on `plane`. A mask that the picture's edge cuts continues beyond it by as much as is
/// seen.
fn window_on(plane: &PlaneFit, pixels: &[(usize, usize)], rays: &[Vec3], camera: &Camera) -> Option<Window> {
    let (mut center, mut x, y) = extent(rays, plane)?;
    let (left, right) = (pixels.iter().any(|p| p.0 <= 1), pixels.iter().any(|p| p.0 + 2 >= camera.width));
    if left != right {
        // Along `x` to the side on which the picture ends, seen from the camera.
        let right_is_x = camera.project(center + x * 0.01)?.x > camera.project(center)?.x;
        center += if right == right_is_x { x } else { -x };
        x *= 2.0;
    }
    Some(Window {
        center: center + plane.normal * (BEFORE_WALL + plane.spread),
        x,
        y,
        lobes: Window::daylight(plane.normal),
    })
}
