//! Rectangles that the pane of a visible window may cover.

use glam::{Vec2, Vec3};

use super::mask_pixels::{extent, median, pixels_of, surroundings};
use crate::geometry::{Camera, PlaneFit, RoomLayout};
use crate::image::{Mask, Normal, Points};
use crate::optics::Window;
use crate::tuning::tuning;

tuning! {
    /// Constants of the shape of a visible window.
    pub const TUNING: VisibleWindowTuning {
        /// Width of the surroundings of a window: this part of the picture's longer side.
        surroundings: usize = 40,
            unit "1 over the fraction", source Taste, effect "a smaller value looks at more of the wall";
        /// Least width of the surroundings.
        min_surroundings: usize = 3,
            unit "pixels", source Taste, effect "a larger value looks at more of the wall of small pictures";
        /// Distance of points from the plane of the wall up to which they support it.
        on_wall: f32 = 0.03,
            unit "fraction of the distance", source Derived("noise of depth maps"),
            effect "a larger value accepts rougher walls";
        /// Least fraction of the surroundings on the plane of the wall.
        min_support: f32 = 0.15,
            unit "1", source Taste, effect "a larger value uses the sides of the room more often";
        /// Least cosine between a plane's normal and the ray through the window's middle, 5
        /// degrees.
        min_cosine: f32 = 0.09,
            unit "1", source Taste, effect "a larger value rejects walls seen at an angle";
        /// Largest distance of a window outside of the room.
        max_outside: f32 = 0.1,
            unit "fraction of the room", source Taste,
            effect "a larger value admits windows on walls that continue behind the room";
        /// Depth of a window without surroundings.
        default_depth: f32 = 3.0,
            unit "meters", source Taste, effect "a larger value makes such windows larger and farther away";
        /// Extent of a window that the picture's edge cuts, over the extent that is seen.
        cut_growth: f32 = 2.0,
            unit "1", source Taste, effect "a larger value makes such windows wider or higher";
        /// Least cosine between the direction in which a window continues and the outward normal of
        /// the side that ends it.
        ending_cosine: f32 = 0.5,
            unit "1", source Taste, effect "a larger value lets windows continue through sides at an angle";
        /// Distance of a window from its wall: shadow rays do not end in the wall.
        before_wall: f32 = 0.01,
            unit "meters", source Taste, effect "a larger value moves windows into the room";
    }
}

/// Rectangles that the pane's pixels cover: on the plane of the wall around the mask, and on the
/// sides of the room. That wall may be hidden, seen edge-on, or lost in the view through the glass.
/// One edge of each is level in the room. A window that the picture's edge cuts continues beyond it
/// by as much as is seen, up to the next side of the room.
pub(super) fn visible_windows(
    mask: &Mask,
    points: &Points,
    normal: &Normal,
    camera: &Camera,
    room: Option<&RoomLayout>,
) -> Vec<Window> {
    let up = room.map_or(Vec3::Y, RoomLayout::up);
    let pixels = pixels_of(mask);
    let rays: Vec<Vec3> = pixels.iter().map(|&(x, y)| camera.pixel_point(x, y, 1.0)).collect();
    let Some(middle) = rays.iter().sum::<Vec3>().try_normalize() else { return Vec::new() };
    let radius =
        (camera.width.max(camera.height) / TUNING.surroundings).max(TUNING.min_surroundings);
    let (positions, normals): (Vec<Vec3>, Vec<Vec3>) = surroundings(mask, radius)
        .iter()
        .map(|&(x, y)| (points.0.get(x, y), normal.0.get(x, y)))
        .unzip();
    let wall = PlaneFit::through(&positions, &normals, TUNING.on_wall);
    let side = |normal: Vec3, offset: f32| PlaneFit { normal, offset, support: 0.0, spread: 0.0 };
    let sides = room.into_iter().flat_map(|room| {
        [0, 1, 4].map(|wall| {
            let (normal, offset) = room.plane(wall);
            side(normal, offset)
        })
    });
    // A wall seen at less than 5 degrees does not determine the position of its window.
    let usable = |plane: &PlaneFit| -plane.normal.dot(middle) > TUNING.min_cosine;
    let planes = wall
        .filter(|plane| plane.support > TUNING.min_support)
        .into_iter()
        .chain(sides)
        .filter(usable);
    // A wall seen edge-on continues far behind the room.
    let inside =
        |window: &Window| room.is_none_or(|room| room.outside(window.center) <= TUNING.max_outside);
    let on = |plane: PlaneFit| window_on(&plane, (&pixels, &rays), camera, (up, room));
    let mut windows: Vec<Window> = planes.filter_map(on).collect();
    if !windows.iter().any(inside) {
        // The last resort: an upright plane at the depth of the surroundings that faces the camera.
        let z = if positions.is_empty() {
            TUNING.default_depth
        } else {
            median(positions.iter().map(|p| -p.z).collect())
        };
        let facing = (up * middle.dot(up) - middle).try_normalize().unwrap_or(Vec3::Z);
        windows.extend(on(side(facing, facing.dot(middle * (z / -middle.z)))));
    }
    let (within, beyond): (Vec<Window>, Vec<Window>) = windows.into_iter().partition(inside);
    if within.is_empty() { beyond } else { within }
}

/// The window on `plane`, with what the picture's edge cuts.
fn window_on(
    plane: &PlaneFit,
    (pixels, rays): (&[(usize, usize)], &[Vec3]),
    camera: &Camera,
    (up, room): (Vec3, Option<&RoomLayout>),
) -> Option<Window> {
    let (mut center, mut x, mut y) = extent(rays, plane, up)?;
    // A window that a corner of the picture cuts continues sideways.
    let cut = (0..2).find_map(|axis| Some((axis, cut_edge(pixels, axis, camera)?)));
    if let Some((axis, outward)) = cut {
        let half = if axis == 0 { &mut x } else { &mut y };
        let ahead = camera.project(center + *half * 0.01)? - camera.project(center)?;
        let onward = if ahead.dot(outward) > 0.0 { *half } else { -*half };
        let free = room.map_or(f32::MAX, |room| distance_to_side(room, center + onward, onward));
        let added = (onward * (TUNING.cut_growth - 1.0)).clamp_length_max(0.5 * free);
        center += added;
        *half *= 1.0 + added.length() / half.length();
    }
    Some(Window {
        center: center + plane.normal * (TUNING.before_wall + plane.spread),
        x,
        y,
        lobes: Window::daylight(plane.normal, up),
    })
}

/// The direction, out of the picture along `axis` (0 or 1), in which the pixels reach its edge;
/// `None` if they reach neither edge or both.
fn cut_edge(pixels: &[(usize, usize)], axis: usize, camera: &Camera) -> Option<Vec2> {
    let size = [camera.width, camera.height][axis];
    let place = |&(x, y): &(usize, usize)| [x, y][axis];
    let low = pixels.iter().any(|pixel| place(pixel) <= 1);
    let high = pixels.iter().any(|pixel| place(pixel) + 2 >= size);
    (low != high).then_some(if high { Vec2::AXES[axis] } else { -Vec2::AXES[axis] })
}

/// Distance from `point` along `direction` to the nearest side of the room that ends a window, at
/// least 0.
fn distance_to_side(room: &RoomLayout, point: Vec3, direction: Vec3) -> f32 {
    let direction = direction.normalize();
    let distance = |side: usize| {
        let (normal, offset) = room.plane(side);
        let cosine = -normal.dot(direction);
        (cosine > TUNING.ending_cosine).then(|| (normal.dot(point) - offset) / cosine)
    };
    (0..6).filter_map(distance).fold(f32::MAX, f32::min).max(0.0)
}
