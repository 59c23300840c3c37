//! Windows opened in a seen wall.

use glam::{Vec2, Vec3};

use super::EditLightsIn;
use crate::geometry::PlaneFit;
use crate::optics::Window;
use crate::tuning::tuning;

tuning! {
    /// Constants of windows opened in a wall that is seen.
    pub const TUNING: WallTuning {
        /// Pixels along the longer side of the corners' rectangle through which the plane is
        /// fitted; about 1,000 in all.
        samples: f32 = 32.0,
            unit "pixels", source Taste, effect "a larger value is slower and more exact";
        /// Largest distance of points from the plane of the wall.
        on_plane: f32 = 0.03,
            unit "fraction of the distance from the camera", source Derived("noise of depth maps"),
            effect "a larger value accepts rougher walls";
        /// Distance of the window before its wall by the unevenness of the wall, which must not
        /// shade the window.
        spreads: f32 = 2.0,
            unit "spreads of the plane", source Taste, effect "a larger value moves windows into the room";
        /// Distance of the window before its wall in addition.
        before_wall: f32 = 0.01,
            unit "meters", source Taste, effect "a larger value moves windows into the room";
        /// Largest area that counts as none.
        min_area: f32 = 1e-6,
            unit "a quarter of a square meter", source Derived("single precision"),
            effect "a larger value refuses small windows";
        /// Cosine between a side and the upright direction above which the window stands upright,
        /// 20 degrees.
        upright_side: f32 = 0.94,
            unit "1", source Taste, effect "a smaller value straightens more windows";
        /// Cosine between the normal of a wall and the horizontal above which the wall is upright,
        /// 12 degrees.
        upright_wall: f32 = 0.98,
            unit "1", source Taste, effect "a smaller value straightens more walls";
    }
}

/// The four corners of a window in the picture.
///
/// # Errors
/// There are not four corners, or they do not form a convex quadrilateral.
pub fn convex(corners: &[[f32; 2]]) -> Result<[Vec2; 4], String> {
    let four: [[f32; 2]; 4] = corners
        .try_into()
        .map_err(|_| format!("corners: wanted 4 pixels, got {}", corners.len()))?;
    let corner = four.map(Vec2::from_array);
    let side = |i: usize| corner[(i + 1) % 4] - corner[i % 4];
    let turns = [0, 1, 2, 3].map(|i| side(i).perp_dot(side(i + 1)));
    let around = turns.iter().all(|&t| t >= 0.0) || turns.iter().all(|&t| t <= 0.0);
    let area = (corner[2] - corner[0]).perp_dot(corner[3] - corner[1]).abs() / 2.0;
    // A window of less than a pixel shows nothing of its wall.
    if around && area >= 1.0 && area.is_finite() {
        Ok(corner)
    } else {
        Err(format!(
            "corners: wanted the four corners in order around a convex window of at least a pixel, got {four:?}"
        ))
    }
}

/// The rectangle on the wall seen between four pixel corners. A wall within 12 degrees of upright
/// is upright, and a window in it whose sides are drawn within 20 degrees of upright stands
/// upright.
///
/// # Errors
/// The corners cannot be used, or no wall is seen between them.
pub fn window(corners: &[[f32; 2]], inputs: &EditLightsIn, up: Vec3) -> Result<Window, String> {
    let camera = &inputs.camera;
    let corner = convex(corners)?;
    let ground = inputs.ground(up);
    let (low, high) = corner.iter().fold((corner[0], corner[0]), |(l, h), &c| (l.min(c), h.max(c)));
    let inside = |p: Vec2| {
        let sides = [0, 1, 2, 3].map(|i| (corner[(i + 1) % 4] - corner[i]).perp_dot(p - corner[i]));
        sides.iter().all(|&s| s >= 0.0) || sides.iter().all(|&s| s <= 0.0)
    };
    let (mut points, mut normals) = (Vec::new(), Vec::new());
    let clamp = |v: f32, end: usize| (v.max(0.0) as usize).min(end);
    let step = (((high - low).max_element() / TUNING.samples) as usize).max(1);
    for y in (clamp(low.y, camera.height)..clamp(high.y + 1.0, camera.height)).step_by(step) {
        for x in (clamp(low.x, camera.width)..clamp(high.x + 1.0, camera.width)).step_by(step) {
            let at = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
            if inside(at) {
                let (point, normal) = ground.surface_at(at.x, at.y)?;
                points.push(point);
                normals.push(normal);
            }
        }
    }
    let plane = PlaneFit::through(&points, &normals, TUNING.on_plane)
        .ok_or_else(|| format!("corners: no wall is visible between {corners:?}"))?;
    // In front of the unevenness of the wall, so that the wall itself does not shade its window.
    let plane = PlaneFit {
        offset: plane.offset + TUNING.spreads * plane.spread + TUNING.before_wall,
        ..plane
    };
    let middle = corner.iter().sum::<Vec2>() / 4.0;
    let plane = upright(plane, up, camera.unproject(middle.x, middle.y, 1.0));
    let met = corner.map(|c| plane.intersect(camera.unproject(c.x, c.y, 1.0)));
    let [Some(a), Some(b), Some(c), Some(d)] = met else {
        return Err(format!("corners: the wall's plane is not visible at each of {corners:?}"));
    };
    let center = (a + b + c + d) / 4.0;
    let x = ((b - a) + (c - d)) / 4.0;
    let y = ((d - a) + (c - b)) / 4.0;
    let y = y - x * (x.dot(y) / x.length_squared().max(1e-12));
    let (x, y) = if x.cross(y).dot(plane.normal) < 0.0 { (-x, y) } else { (x, y) };
    let area = x.cross(y).length();
    if area.is_nan() || area <= TUNING.min_area {
        return Err(format!("corners: wanted a window with area, got {corners:?}"));
    }
    let turned = (up - plane.normal * plane.normal.dot(up)).try_normalize().and_then(|upright| {
        let sides = [upright, -upright, upright.cross(plane.normal), plane.normal.cross(upright)];
        sides.into_iter().find(|side| side.dot(y.normalize()) > TUNING.upright_side)
    });
    let (x, y) = match turned {
        Some(side) => (side.cross(plane.normal) * x.length(), side * y.length()),
        None => (x, y),
    };
    Ok(Window { center, x, y, lobes: Window::daylight(plane.normal, up) })
}

/// The plane turned upright about its point along `ray`, if it nearly is.
fn upright(plane: PlaneFit, up: Vec3, ray: Vec3) -> PlaneFit {
    let normal = (plane.normal - up * plane.normal.dot(up)).normalize_or_zero();
    match plane.intersect(ray) {
        Some(point) if normal.dot(plane.normal) > TUNING.upright_wall => {
            PlaneFit { normal, offset: normal.dot(point), ..plane }
        }
        _ => plane,
    }
}
