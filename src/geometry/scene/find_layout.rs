//! The cuboid of a room from the surfaces that the camera sees.
//!
//! Orthogonal directions, and the sides in them, follow the layout estimation of Hedau et al. (ICCV
//! 2009) with depth in place of vanishing points, as Stekovic et al. (ECCV 2020) fit planes to it.

use glam::{Mat3, Quat, Vec3};

use super::room_layout::{RoomLayout, SideSource};
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
        /// Least area of a side over that of the largest parallel surface.
        min_peak: f32 = 0.25,
            unit "1", source Measured("docs/room.md"), effect "a smaller value takes furniture for a side";
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
    }
}

/// What a scene states of one side.
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
        let near = |p: &Vec3| p.length() < TUNING.max_distance;
        let mut area: Vec<f32> = (0..points.0.len())
            .map(|i| {
                let (p, n) = (points.0.pixels()[i], normal.0.pixels()[i]);
                let slant = (-n.dot(p) / p.length().max(1e-6)).max(TUNING.min_slant);
                if mesh.in_room(i) && near(&p) { p.z * p.z / slant } else { 0.0 }
            })
            .collect();
        limit(&mut area, TUNING.max_area);
        let total: f32 = area.iter().sum();
        if total <= 0.0 {
            let corners = (Quat::IDENTITY, -Vec3::ONE, Vec3::ONE);
            let seen = Plane::filled(points.0.width(), points.0.height(), 0);
            return RoomLayout::new(
                corners,
                [SideSource::Open; 6],
                (camera, points),
                seen,
                guess.cells,
            );
        }
        let up = level(normal, &area, total);
        let rotation = walls(normal, &area, up);
        let inverse = rotation.inverse();
        let surfaces = Surfaces {
            points: points.0.pixels().iter().map(|p| inverse * *p).collect(),
            normals: normal.0.pixels().iter().map(|n| inverse * *n).collect(),
            area,
            total,
        };
        let found: [Option<f32>; 6] = std::array::from_fn(|side| match guess.sides[side] {
            KnownSide::Unknown => surfaces.side(side),
            KnownSide::Open => None,
            KnownSide::At(distance) => Some(distance),
        });
        let farthest = std::array::from_fn(|side| surfaces.farthest(side));
        let distances = distances(&found, &farthest, guess);
        let sides = std::array::from_fn(|side| match (guess.sides[side], found[side]) {
            (KnownSide::Open, _) => SideSource::Open,
            (KnownSide::At(_), _) => SideSource::Given,
            (_, Some(_)) => SideSource::Seen,
            (_, None) => SideSource::Guessed,
        });
        let [left, right, floor, ceiling, front, back] = distances;
        let seen = |pixel: usize| {
            let shows = |side: &usize| {
                sides[*side] != SideSource::Open && surfaces.is_on(pixel, *side, distances[*side])
            };
            (0..6).find(shows).map_or(0, |side| side as u8 + 1)
        };
        let (width, height) = points.0.size();
        let seen = Plane::new(width, height, (0..width * height).map(seen).collect());
        let corners = (rotation, -Vec3::new(left, floor, front), Vec3::new(right, ceiling, back));
        RoomLayout::new(corners, sides, (&camera.resized(width, height), points), seen, guess.cells)
    }
}

/// Limits each area to this many medians: views through doors and panes cover large areas that do
/// not belong to the room.
fn limit(area: &mut [f32], medians: f32) {
    let mut sorted: Vec<f32> = area.iter().copied().filter(|&a| a > 0.0).collect();
    sorted.sort_by(f32::total_cmp);
    let most = medians * sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    area.iter_mut().for_each(|a| *a = a.min(most));
}

/// Distances of all sides from the camera: those found, else guesses.
fn distances(found: &[Option<f32>; 6], farthest: &[f32; 6], guess: &LayoutGuess) -> [f32; 6] {
    let [floor_side, ceiling_side] = [2, 3];
    let beyond = |side: usize| (farthest[side] + TUNING.margin).max(TUNING.min_distance);
    let height = guess.height.unwrap_or(TUNING.height);
    let floor = found[floor_side].unwrap_or_else(|| match found[ceiling_side] {
        Some(ceiling) => (height - ceiling).max(beyond(floor_side)),
        None => (TUNING.camera_height * height / TUNING.height).max(beyond(floor_side)),
    });
    let ceiling = match (found[ceiling_side], guess.height) {
        (Some(ceiling), _) => ceiling,
        (None, _) => (height - floor).max(beyond(ceiling_side)),
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
fn walls(normal: &Normal, area: &[f32], up: Vec3) -> Quat {
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
    Quat::from_mat3(&Mat3::from_cols(up.cross(back), up, back))
}

impl Surfaces {
    /// Distance of a point from the camera towards a side.
    fn along(&self, pixel: usize, side: usize) -> f32 {
        let p = self.points[pixel][side / 2];
        if side % 2 == 1 { p } else { -p }
    }

    /// Whether a surface faces away from a side, as the side itself does.
    fn faces(&self, pixel: usize, side: usize) -> bool {
        let n = self.normals[pixel][side / 2];
        (if side % 2 == 1 { -n } else { n }) > TUNING.side_angle.to_radians().cos()
    }

    fn is_on(&self, pixel: usize, side: usize, distance: f32) -> bool {
        self.area[pixel] > 0.0
            && self.faces(pixel, side)
            && (self.along(pixel, side) - distance).abs() < TUNING.on_side
    }

    /// Distance within which almost all of the area lies towards a side.
    fn farthest(&self, side: usize) -> f32 {
        let mut order: Vec<(f32, f32)> = (0..self.points.len())
            .filter(|&i| self.area[i] > 0.0)
            .map(|i| (self.along(i, side), self.area[i]))
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut sum = 0.0;
        let last = order.iter().find(|(_, area)| {
            sum += area;
            sum >= TUNING.farthest * self.total
        });
        last.or(order.last()).map_or(0.0, |(along, _)| along.min(TUNING.max_distance))
    }

    /// Distance of a side that the camera sees: the outermost surface of enough area across it.
    fn side(&self, side: usize) -> Option<f32> {
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
        let least = (TUNING.min_area * self.total).max(TUNING.min_peak * highest);
        let mut peak = (0..bins).rev().find(|&bin| sum(bin) > least)?;
        while peak > 0 && sum(peak - 1) > sum(peak) {
            peak -= 1;
        }
        let middle = (peak as f32 + 0.5) * TUNING.bin;
        let near = |along: f32| (along - middle).abs() < 1.5 * TUNING.bin;
        let mut members: Vec<(f32, f32)> = flat.into_iter().filter(|m| near(m.0)).collect();
        members.sort_by(|a, b| a.0.total_cmp(&b.0));
        let all: f32 = members.iter().map(|m| m.1).sum();
        let mut half = 0.0;
        let distance = members.iter().find(|m| {
            half += m.1;
            half >= 0.5 * all
        })?;
        let distance = distance.0;
        let doubtful =
            all < TUNING.min_certain * self.total && self.farthest(side) > distance + TUNING.behind;
        (!doubtful && distance > TUNING.min_distance).then_some(distance)
    }
}
