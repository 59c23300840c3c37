//! The cuboid of a room from the surfaces that the camera sees.
//!
//! Orthogonal directions, and the sides in them, follow the layout estimation of Hedau et al. (ICCV
//! 2009) with depth in place of vanishing points, as Stekovic et al. (ECCV 2020) fit planes to it.

use glam::{Mat3, Quat, Vec3};

use super::room_layout::{
    CEILING, FLOOR, RoomLayout, SIDES, SideSource, corners, toward, weighted_quantile,
};
use super::world_up;
use crate::geometry::{Camera, SceneMesh};
use crate::image::{Normal, Plane, Points};
use crate::tuning::tuning;

tuning! {
    /// Constants of the search for the sides of a room.
    pub const TUNING: FindLayoutTuning {
        /// Least cosine between a normal and its ray: the area of a pixel is bounded.
        min_slant: f32 = 0.1,
            unit "1", source Taste, effect "a larger value gives slanted surfaces less area";
        /// Largest area of a pixel: views through doors and panes cover large areas.
        max_area: f32 = 4.0,
            unit "median areas", source Measured("docs/room.md"),
            effect "a larger value lets distant surfaces decide where the sides are";
        /// Angles from the vertical within which normals turn it, one after the other.
        up_angles: [f32; 4] = [20.0, 12.0, 8.0, 5.0],
            unit "degrees", source Measured("docs/room.md"),
            effect "larger values let slanted surfaces turn the room";
        /// Least fraction of the area within such an angle.
        min_level: f32 = 0.03,
            unit "1", source Measured("docs/room.md"),
            effect "a larger value keeps the direction of gravity of the camera";
        /// Upward component of a normal below which its surface is upright.
        upright: f32 = 0.3,
            unit "1", source Taste, effect "a larger value lets slanted surfaces turn the walls";
        /// Half of the width of the mode of the walls' angles.
        wall_angle: f32 = 5.0,
            unit "degrees", source Taste, effect "a larger value lets furniture turn the walls";
        /// Angle between a normal and the direction of a side up to which its surface may be this
        /// side.
        side_angle: f32 = 18.0,
            unit "degrees", source Measured("docs/room.md"), effect "a larger value admits slanted surfaces";
        /// Width of the bins in which the area of a side is summed.
        bin: f32 = 0.05,
            unit "meters", source Measured("docs/room.md"), effect "a larger value joins parallel surfaces";
        /// Least area of a side.
        min_area: f32 = 0.012,
            unit "fraction of all area", source Measured("docs/room.md"),
            effect "a smaller value takes furniture for a side";
        /// Least area of a side behind which nothing is seen.
        min_last_area: f32 = 0.004,
            unit "fraction of all area", source Measured("docs/room.md"),
            effect "a larger value guesses walls of which the photo shows a strip";
        /// Least area of a side over that of the largest parallel surface.
        min_peak: f32 = 0.25,
            unit "1", source Measured("docs/room.md"), effect "a smaller value takes furniture for a side";
        /// The same for the floor, which furniture hides.
        min_floor_peak: f32 = 0.08,
            unit "1", source Measured("docs/room.md"), effect "a larger value takes beds for floors";
        /// Distance below the camera from which a level surface is a floor in any case.
        min_floor: f32 = 1.05,
            unit "meters", source Measured("docs/room.md"),
            effect "a smaller value takes beds and tables for floors";
        /// Distance below a nearer one at which other surfaces show that it is none.
        below_floor: f32 = 0.12,
            unit "meters", source Measured("docs/room.md"),
            effect "a larger value takes beds and tables for floors";
        /// Area below which a side with much behind it is none.
        min_certain: f32 = 0.03,
            unit "fraction of all area", source Measured("docs/room.md"),
            effect "a larger value makes more sides guesses";
        /// Distance of what lies behind such a side.
        behind: f32 = 0.25,
            unit "meters", source Measured("docs/room.md"), effect "a larger value makes fewer sides guesses";
        /// Fraction of the area that lies within the farthest seen point.
        farthest: f32 = 0.995,
            unit "1", source Measured("docs/room.md"), effect "a smaller value makes rooms smaller";
        /// Largest distance of a side.
        max_distance: f32 = 15.0,
            unit "meters", source Measured("docs/room.md"), effect "a larger value follows views through doors";
        /// Least distance of a side.
        min_distance: f32 = 0.3,
            unit "meters", source Taste, effect "a larger value moves walls beside the camera away";
        /// Height of a room of which floor or ceiling is not seen.
        height: f32 = 2.6,
            unit "meters", source Paper("building codes"), effect "a larger value moves unseen ceilings upward";
        /// Height of the camera above a floor that is not seen.
        camera_height: f32 = 1.4,
            unit "meters", source Taste, effect "a larger value moves unseen floors downward";
        /// Distance of an unseen side beyond all seen points.
        margin: f32 = 0.1,
            unit "meters", source Measured("docs/room.md"), effect "a larger value makes rooms larger";
        /// Least distance of an unseen wall from the camera, in a room of common height.
        beyond_camera: f32 = 1.0,
            unit "meters", source Measured("docs/room.md"), effect "a larger value makes rooms larger";
        /// Factor on the least distance of an unseen wall.
        distance_factor: f32 = 1.4,
            unit "1", source Measured("docs/room.md"), effect "a larger value makes rooms larger";
        /// Distance from the plane of a side up to which a pixel shows it.
        on_side: f32 = 0.1,
            unit "meters", source Taste, effect "a larger value paints more cells with what hangs at a wall";
        /// Points along each edge of a side at which the seen depth is compared with it.
        open_points: f32 = 24.0,
            unit "1", source Derived("three points a cell"),
            effect "a larger value compares more finely, and takes longer";
        /// Distance behind a side, as a fraction of its depth, at which the camera sees past it.
        past: f32 = 0.1,
            unit "1", source Derived("noise of depth maps"),
            effect "a larger value leaves fewer sides open";
        /// Fraction of the visible part of a side past which the camera sees in an open side.
        open: f32 = 0.25,
            unit "1", source Measured("docs/room.md"), effect "a larger value leaves fewer sides open";
        /// Visible fraction of a side from which that is known.
        min_visible: f32 = 0.05,
            unit "1", source Taste, effect "a larger value leaves fewer sides open";
        /// Fraction of the area beyond a stated side from which the statement is doubted.
        beyond: f32 = 0.02,
            unit "fraction of all area", source Taste, effect "a larger value warns more rarely";
        /// Difference of a stated height from the seen one from which it is doubted.
        height_error: f32 = 0.15,
            unit "meters", source Taste, effect "a larger value warns more rarely";
        /// Fraction of the area of upright surfaces that is parallel to the walls, below which
        /// their angle is doubted.
        min_parallel: f32 = 0.35,
            unit "1", source Measured("docs/room.md"), effect "a larger value warns more often";
    }
}

/// Knowledge that a scene states of one side.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum KnownSide {
    /// Nothing.
    #[default]
    Unknown,
    /// The room is open there.
    Open,
    /// Its distance from the camera, meters.
    At(f32),
}

/// Guesses and knowledge about the sides that the camera does not see.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayoutGuess {
    /// The sides, as in [`RoomLayout::sides`].
    pub sides: [KnownSide; 6],
    /// From the floor to the ceiling, meters; `None` for a common height.
    pub height: Option<f32>,
    /// Factor on the distances of unseen walls.
    pub distance: f32,
    /// Cells along each edge of a side.
    pub cells: usize,
}

impl Default for LayoutGuess {
    fn default() -> Self {
        LayoutGuess {
            sides: Default::default(),
            height: None,
            distance: TUNING.distance_factor,
            cells: 8,
        }
    }
}

/// Points and normals of the room in the frame of its layout, with the area that each represents.
struct Surfaces {
    points: Vec<Vec3>,
    normals: Vec<Vec3>,
    area: Vec<f32>,
    total: f32,
    /// Distance toward each side within which almost all of the area lies.
    farthest: [f32; 6],
}

impl RoomLayout {
    /// The cuboid around the surfaces that a camera sees; `points` and `normal` have the size of
    /// `mesh`. Where the photo shows no surface of a room, all sides are open.
    pub fn find(
        mesh: &SceneMesh,
        points: &Points,
        normal: &Normal,
        camera: &Camera,
        guess: &LayoutGuess,
    ) -> RoomLayout {
        RoomLayout::find_with_doubts(mesh, points, normal, camera, guess).0
    }

    /// [`RoomLayout::find`], and the reasons for which the result may be wrong: one message each,
    /// with the numbers.
    pub fn find_with_doubts(
        mesh: &SceneMesh,
        points: &Points,
        normal: &Normal,
        camera: &Camera,
        guess: &LayoutGuess,
    ) -> (RoomLayout, Vec<String>) {
        let near = |p: &Vec3| p.length() < TUNING.max_distance;
        let mut area: Vec<f32> = (0..points.0.len())
            .map(|i| {
                let (p, n) = (points.0.pixels()[i], normal.0.pixels()[i]);
                let slant = (-n.dot(p) / p.length().max(1e-6)).max(TUNING.min_slant);
                if mesh.in_room(i) && near(&p) { p.z * p.z / slant } else { 0.0 }
            })
            .collect();
        limit_areas(&mut area, TUNING.max_area);
        let total: f32 = area.iter().sum();
        if total <= 0.0 {
            let corners = (Quat::IDENTITY, -Vec3::ONE, Vec3::ONE);
            let seen = Plane::filled(points.0.width(), points.0.height(), 0);
            let open = [SideSource::Open; 6];
            let layout = RoomLayout::new(corners, open, (camera, points), seen, guess.cells);
            let doubt = "the photo shows no surface of a room: all sides are left open";
            return (layout, vec![doubt.into()]);
        }
        let up = level(normal, &area, total);
        let (rotation, parallel) = walls(normal, &area, up);
        let inverse = rotation.inverse();
        let in_room: Vec<Vec3> = points.0.pixels().iter().map(|p| inverse * *p).collect();
        let surfaces = Surfaces {
            farthest: std::array::from_fn(|side| farthest(&in_room, (&area, total), side)),
            points: in_room,
            normals: normal.0.pixels().iter().map(|n| inverse * *n).collect(),
            area,
            total,
        };
        let (width, height) = points.0.size();
        let camera = camera.resized(width, height);
        let past = |side: usize, distances: &[f32; 6]| {
            seen_past(side, (rotation, distances), &camera, (mesh, points))
        };
        let SidePlaces { found, sides, distances } = surfaces.place(guess, past);
        let shown: [bool; 6] =
            std::array::from_fn(|side| surfaces.is_shown(side, sides[side], distances[side]));
        let seen = |pixel: usize| {
            let shows =
                |side: &usize| shown[*side] && surfaces.is_on(pixel, *side, distances[*side]);
            (0..6).find(shows).map_or(0, |side| side as u8 + 1)
        };
        let seen = Plane::new(width, height, (0..width * height).map(seen).collect());
        let (low, high) = corners(distances);
        let place = (rotation, low, high);
        let layout = RoomLayout::new(place, sides, (&camera, points), seen, guess.cells);
        let mut doubts = doubts(&layout, parallel);
        doubts.extend(surfaces.contradictions(&found, guess));
        (layout, doubts)
    }
}

/// Reasons to doubt a layout in which this fraction of the upright surfaces is parallel to walls.
fn doubts(layout: &RoomLayout, parallel: f32) -> Vec<String> {
    let mut doubts = Vec::new();
    if parallel < TUNING.min_parallel {
        doubts.push(format!(
            "the angle of the walls is uncertain: {:.0} % of the upright surfaces are parallel to them, wanted {:.0} %",
            100.0 * parallel,
            100.0 * TUNING.min_parallel
        ));
    }
    let is_known = |side: &SideSource| matches!(side, SideSource::Seen | SideSource::Given);
    let known = layout.sides.iter().filter(|side| is_known(side)).count();
    if known < 3 {
        doubts.push(format!(
            "{known} of 6 sides are seen or stated, the others are guesses: state them in scene.ron, `room: (..)`"
        ));
    }
    doubts
}

/// Fraction of the visible part of a side past which the camera sees: at points of the side in the
/// picture, the seen depth lies behind it rather than on it. Points behind seen surfaces do not
/// count, nor do panes and what the scene ignores. 0 where hardly any of the side is visible.
fn seen_past(
    side: usize,
    (rotation, distances): (Quat, &[f32; 6]),
    camera: &Camera,
    (mesh, points): (&SceneMesh, &Points),
) -> f32 {
    let axis = side / 2;
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let count = TUNING.open_points as usize;
    let (low, high) = corners(*distances);
    let (mut past, mut on) = (0, 0);
    for place in 0..count * count {
        let along = |axis: usize, step: usize| {
            low[axis] + (step as f32 + 0.5) / count as f32 * (high[axis] - low[axis])
        };
        let mut p = Vec3::ZERO;
        p[axis] = if side % 2 == 1 { high[axis] } else { low[axis] };
        (p[u], p[v]) = (along(u, place % count), along(v, place / count));
        let p = rotation * p;
        if let Some(at) = camera.project(p).filter(|at| camera.contains(*at)) {
            let pixel = at.y as usize * camera.width + at.x as usize;
            if !mesh.in_room(pixel) {
                continue;
            }
            let behind = p.z - points.0.pixels()[pixel].z;
            let margin = TUNING.on_side - TUNING.past * p.z;
            past += usize::from(behind > margin);
            on += usize::from(behind.abs() <= margin);
        }
    }
    let visible = past + on;
    if (visible as f32) < TUNING.min_visible * (count * count) as f32 {
        return 0.0;
    }
    past as f32 / visible as f32
}

/// Sources and distances of the sides.
struct SidePlaces {
    /// Distances that are seen or stated, meters.
    found: [Option<f32>; 6],
    sides: [SideSource; 6],
    /// Distances of all sides, meters.
    distances: [f32; 6],
}

/// Sources of all sides.
fn sources(found: &[Option<f32>; 6], guess: &LayoutGuess) -> [SideSource; 6] {
    std::array::from_fn(|side| match (guess.sides[side], found[side]) {
        (KnownSide::Open, _) => SideSource::Open,
        (KnownSide::At(_), _) => SideSource::Given,
        (_, Some(_)) => SideSource::Seen,
        // The other of floor and ceiling determines it.
        (_, None) if guess.height.is_some() && side / 2 == 1 && found[side ^ 1].is_some() => {
            SideSource::Given
        }
        (_, None) => SideSource::Guessed,
    })
}

/// Limits each area to this many medians of those above 0: views through doors and panes cover
/// large areas that do not belong to the room.
pub fn limit_areas(area: &mut [f32], medians: f32) {
    let mut sorted: Vec<f32> = area.iter().copied().filter(|&a| a > 0.0).collect();
    sorted.sort_by(f32::total_cmp);
    let most = medians * sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    area.iter_mut().for_each(|a| *a = a.min(most));
}

/// Distance toward a side within which almost all of the area of the `points` lies.
fn farthest(points: &[Vec3], (area, total): (&[f32], f32), side: usize) -> f32 {
    let mut order: Vec<(f32, f32)> = (points.iter().zip(area))
        .filter(|(_, area)| **area > 0.0)
        .map(|(point, area)| (toward(*point, side), *area))
        .collect();
    let within = weighted_quantile(&mut order, TUNING.farthest * total);
    let last = within.or(order.last().map(|(along, _)| *along));
    last.map_or(0.0, |along| along.min(TUNING.max_distance))
}

/// Distances of all sides from the camera: those found, else guesses.
fn distances(found: &[Option<f32>; 6], farthest: &[f32; 6], guess: &LayoutGuess) -> [f32; 6] {
    let beyond = |side: usize| (farthest[side] + TUNING.margin).max(TUNING.min_distance);
    let height = guess.height.unwrap_or(TUNING.height);
    let floor = found[FLOOR].unwrap_or_else(|| match found[CEILING] {
        Some(ceiling) => (height - ceiling).max(beyond(FLOOR)),
        None => (TUNING.camera_height * height / TUNING.height).max(beyond(FLOOR)),
    });
    let ceiling = match (found[CEILING], guess.height) {
        (Some(ceiling), _) => ceiling,
        (None, _) => (height - floor).max(beyond(CEILING)),
    };
    let wall = |side: usize| {
        let least = TUNING.beyond_camera * (floor + ceiling) / TUNING.height;
        found[side].unwrap_or_else(|| beyond(side).max(least) * guess.distance)
    };
    [wall(0), wall(1), floor, ceiling, wall(4), wall(5)]
}

/// Up in camera space: the direction of gravity, turned to the mean of the level surfaces.
fn level(normal: &Normal, area: &[f32], total: f32) -> Vec3 {
    let mut up = world_up(normal);
    for angle in TUNING.up_angles {
        let least = angle.to_radians().cos();
        let (mut sum, mut weight) = (Vec3::ZERO, 0.0);
        for (n, area) in normal.0.pixels().iter().zip(area) {
            let along = n.dot(up);
            if along.abs() > least {
                sum += *n * (area * along.signum());
                weight += area;
            }
        }
        if weight < TUNING.min_level * total {
            break;
        }
        up = sum.normalize_or(up);
    }
    up
}

/// Rotation from the layout's frame to camera space: y is `up`, and the walls are orthogonal to x
/// and z. Their angle is the mode of the upright normals' angles, modulo a right angle.
/// Also returns the fraction of the upright surfaces within that mode.
fn walls(normal: &Normal, area: &[f32], up: Vec3) -> (Quat, f32) {
    let z = (Vec3::Z - up * up.z).normalize_or(Vec3::Z);
    let x = up.cross(z);
    let quarter = std::f32::consts::FRAC_PI_2;
    let mut histogram = [0.0f32; 90];
    let upright: Vec<(f32, f32)> = (normal.0.pixels().iter().zip(area))
        .filter(|(n, area)| n.dot(up).abs() < TUNING.upright && **area > 0.0)
        .map(|(n, area)| (n.dot(x).atan2(n.dot(z)).rem_euclid(quarter), *area))
        .collect();
    for (angle, area) in &upright {
        histogram[(angle.to_degrees() as usize).min(89)] += area;
    }
    let half = TUNING.wall_angle as usize;
    let around = |middle: usize| {
        (0..2 * half + 1).map(|i| histogram[(middle + 90 + i - half) % 90]).sum::<f32>()
    };
    let mode = (0..90).map(|i| (around(i), i)).fold((0.0, 0), |a, b| if b.0 > a.0 { b } else { a });
    let mode = (mode.1 as f32 + 0.5).to_radians();
    // The mean of what is near the mode, as a deviation from it.
    let (mut sum, mut weight) = (0.0, 0.0);
    let all: f32 = upright.iter().map(|(_, area)| area).sum();
    for (angle, area) in upright {
        let off = (angle - mode + 0.5 * quarter).rem_euclid(quarter) - 0.5 * quarter;
        if off.abs() < TUNING.wall_angle.to_radians() {
            (sum, weight) = (sum + area * off, weight + area);
        }
    }
    let yaw = if weight > 0.0 { mode + sum / weight } else { 0.0 };
    // Of the four equal angles, the one by which the front side lies before the camera.
    let yaw = if yaw > 0.5 * quarter { yaw - quarter } else { yaw };
    let back = (z * yaw.cos() + x * yaw.sin()).normalize_or(z);
    let rotation = Quat::from_mat3(&Mat3::from_cols(up.cross(back), up, back));
    (rotation, weight / all.max(f32::MIN_POSITIVE))
}

impl Surfaces {
    /// Distance of a point from the camera towards a side.
    fn along(&self, pixel: usize, side: usize) -> f32 {
        toward(self.points[pixel], side)
    }

    /// Whether a surface faces away from a side, as the side itself does.
    fn faces(&self, pixel: usize, side: usize) -> bool {
        -toward(self.normals[pixel], side) > TUNING.side_angle.to_radians().cos()
    }

    fn is_on(&self, pixel: usize, side: usize, distance: f32) -> bool {
        self.area[pixel] > 0.0
            && self.faces(pixel, side)
            && (self.along(pixel, side) - distance).abs() < TUNING.on_side
    }

    /// Whether the pixels on a side determine its albedo. A narrow strip does not: it may be a
    /// shelf or a curtain in front of the wall.
    fn is_shown(&self, side: usize, source: SideSource, distance: f32) -> bool {
        let on_side = (0..self.area.len()).filter(|&i| self.is_on(i, side, distance));
        match source {
            SideSource::Open => false,
            SideSource::Seen => {
                on_side.map(|i| self.area[i]).sum::<f32>() > TUNING.min_area * self.total
            }
            _ => true,
        }
    }

    /// The sides that a scene states or that are seen, and guesses of the others. `past` is the
    /// fraction of a side past which the camera sees: a seen side with much of it becomes a guess,
    /// beyond all that is seen, and a guess with much of it is open.
    fn place(&self, guess: &LayoutGuess, past: impl Fn(usize, &[f32; 6]) -> f32) -> SidePlaces {
        let mut found: [Option<f32>; 6] = std::array::from_fn(|side| match guess.sides[side] {
            KnownSide::Unknown if side == FLOOR => self.floor(),
            KnownSide::Unknown => self.side(side, TUNING.min_peak),
            KnownSide::Open => None,
            KnownSide::At(distance) => Some(distance),
        });
        let mut placed = distances(&found, &self.farthest, guess);
        let is_past = |sides: &[SideSource; 6], source: SideSource, placed: &[f32; 6]| {
            let past = |side| sides[side] == source && past(side, placed) > TUNING.open;
            std::array::from_fn::<bool, 6, _>(past)
        };
        let rejected = is_past(&sources(&found, guess), SideSource::Seen, &placed);
        for side in (0..6).filter(|&side| rejected[side]) {
            found[side] = None;
        }
        placed = distances(&found, &self.farthest, guess);
        let mut sides = sources(&found, guess);
        let open = is_past(&sides, SideSource::Guessed, &placed);
        for side in (0..6).filter(|&side| open[side]) {
            sides[side] = SideSource::Open;
        }
        SidePlaces { found, sides, distances: placed }
    }

    /// Distance of the floor that the camera sees. Furniture hides most floors, and a bed is as
    /// level: a plane just below the camera that has surfaces below it is not the floor.
    fn floor(&self) -> Option<f32> {
        let is_floor = |floor: &f32| {
            *floor >= TUNING.min_floor || self.farthest[FLOOR] < floor + TUNING.below_floor
        };
        self.side(FLOOR, TUNING.min_floor_peak).filter(is_floor)
    }

    /// Statements of a scene that the seen surfaces contradict.
    fn contradictions(&self, found: &[Option<f32>; 6], guess: &LayoutGuess) -> Vec<String> {
        let mut messages = Vec::new();
        for (side, known) in guess.sides.iter().enumerate() {
            let KnownSide::At(distance) = *known else { continue };
            let limit = distance + TUNING.on_side + TUNING.past * distance;
            let beyond = |i: &usize| self.area[*i] > 0.0 && self.along(*i, side) > limit;
            let area: f32 = (0..self.area.len()).filter(beyond).map(|i| self.area[i]).sum();
            let fraction = area / self.total;
            if fraction > TUNING.beyond {
                messages.push(format!(
                    "room: {}: the scene states {distance:.2} m, {:.0} % of the seen area lie beyond, up to {:.2} m",
                    SIDES[side],
                    100.0 * fraction,
                    self.farthest[side]
                ));
            }
        }
        if let (Some(height), Some(floor), Some(ceiling)) =
            (guess.height, found[FLOOR], found[CEILING])
            && (floor + ceiling - height).abs() > TUNING.height_error
        {
            messages.push(format!(
                "room: height: the scene states {height:.2} m, floor and ceiling lie {:.2} m apart, which is used",
                floor + ceiling
            ));
        }
        messages
    }

    /// Distance of a side that the camera sees: the outermost surface of enough area across it.
    /// `min_peak` is its least area over that of the largest parallel surface.
    fn side(&self, side: usize, min_peak: f32) -> Option<f32> {
        let bins = (TUNING.max_distance / TUNING.bin) as usize;
        let mut histogram = vec![0.0f32; bins];
        let flat: Vec<(f32, f32)> = (0..self.points.len())
            .filter(|&i| self.area[i] > 0.0 && self.faces(i, side))
            .map(|i| (self.along(i, side), self.area[i]))
            .filter(|(along, _)| (0.0..TUNING.max_distance).contains(along))
            .collect();
        for (along, area) in &flat {
            histogram[((along / TUNING.bin) as usize).min(bins - 1)] += area;
        }
        let sum =
            |bin: usize| histogram[bin.saturating_sub(1)..(bin + 2).min(bins)].iter().sum::<f32>();
        let highest = (0..bins).map(sum).fold(0.0, f32::max);
        let least = (TUNING.min_area * self.total).max(min_peak * highest);
        let last = || {
            let first = ((self.farthest[side] - TUNING.behind) / TUNING.bin).max(0.0) as usize;
            (first..bins).rev().find(|&bin| sum(bin) > TUNING.min_last_area * self.total)
        };
        let mut peak = (0..bins).rev().find(|&bin| sum(bin) > least).or_else(last)?;
        while peak > 0 && sum(peak - 1) > sum(peak) {
            peak -= 1;
        }
        let middle = (peak as f32 + 0.5) * TUNING.bin;
        let near = |along: f32| (along - middle).abs() < 1.5 * TUNING.bin;
        let mut members: Vec<(f32, f32)> = flat.into_iter().filter(|m| near(m.0)).collect();
        let all: f32 = members.iter().map(|m| m.1).sum();
        let distance = weighted_quantile(&mut members, 0.5 * all)?;
        let doubtful =
            all < TUNING.min_certain * self.total && self.farthest[side] > distance + TUNING.behind;
        (!doubtful && distance > TUNING.min_distance).then_some(distance)
    }
}
