//! Windows opened in a seen wall.

use glam::{Vec2, Vec3};

use super::EditLightsIn;
use crate::geometry::PlaneFit;
use crate::optics::Window;

/// The four corners of a window in the picture.
///
/// # Errors
/// There are not four corners, or they do not form a convex quadrilateral.
pub fn convex(corners: &[[f32; 2]]) -> Result<[Vec2; 4], String> {
    let four: [[f32; 2]; 4] =
        corners.try_into().map_err(|_| format!("corners: wanted 4 pixels, got {}", corners.len()))?;
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
    // About 1,000 places are plenty for a plane.
    let step = (((high - low).max_element() / 32.0) as usize).max(1);
    for y in (clamp(low.y, camera.height)..clamp(high.y + 1.0, camera.height)).step_by(step) {
        for x in (clamp(low.x, camera.width)..clamp(high.x + 1.0, camera.width)).step_by(step) {
            let at = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
            if inside(at) {
                let (point, normal) = ground.seen(at.x, at.y)?;
                points.push(point);
                normals.push(normal);
            }
        }
    }
    let plane = PlaneFit::through(&points, &normals, 0.03)
        .ok_or_else(|| format!("corners: there is no wall to see between {corners:?}"))?;
    // In front of the unevenness of the wall, so that the wall itself does not shade its window.
    let plane = PlaneFit { offset: plane.offset + 2.0 * plane.spread + 0.01, ..plane };
    let middle = corner.iter().sum::<Vec2>() / 4.0;
    let plane = upright(plane, up, camera.unproject(middle.x, middle.y, 1.0));
    let met = corner.map(|c| plane.meet(camera.unproject(c.x, c.y, 1.0)));
    let [Some(a), Some(b), Some(c), Some(d)] = met else {
        return Err(format!("corners: the wall's plane is not seen at each of {corners:?}"));
    };
    let center = (a + b + c + d) / 4.0;
    let x = ((b - a) + (c - d)) / 4.0;
    let y = ((d - a) + (c - b)) / 4.0;
    let y = y - x * (x.dot(y) / x.length_squared().max(1e-12));
    let (x, y) = if x.cross(y).dot(plane.normal) < 0.0 { (-x, y) } else { (x, y) };
    let area = x.cross(y).length();
    if area.is_nan() || area <= 1e-6 {
        return Err(format!("corners: wanted a window with area, got {corners:?}"));
    }
    let turned = (up - plane.normal * plane.normal.dot(up)).try_normalize().and_then(|upright| {
        let sides = [upright, -upright, upright.cross(plane.normal), plane.normal.cross(upright)];
        sides.into_iter().find(|side| side.dot(y.normalize()) > 0.94)
    });
    let (x, y) = match turned {
        Some(side) => (side.cross(plane.normal) * x.length(), side * y.length()),
        None => (x, y),
    };
    Ok(Window { center, x, y, lobes: Window::daylight(plane.normal) })
}

/// The plane turned upright about its point along `ray`, if it nearly is.
fn upright(plane: PlaneFit, up: Vec3, ray: Vec3) -> PlaneFit {
    let normal = (plane.normal - up * plane.normal.dot(up)).normalize_or_zero();
    match plane.meet(ray) {
        Some(point) if normal.dot(plane.normal) > 0.98 => PlaneFit { normal, offset: normal.dot(point), ..plane },
        _ => plane,
    }
}
