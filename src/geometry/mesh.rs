//! The seen room as triangles, and what rays through it can say.
//!
//! Vertices are the pixel centres on the surface. Between four neighbouring pixels lie two triangles, split along the
//! diagonal that keeps more of them; no triangle spans a depth step. A triangle that does is kept as a **curtain**: it is no
//! surface, but whoever passes it goes behind a depth edge, where the camera saw nothing. Pixels that are no part of the
//! room (panes, whatever `ignore` covers) have neither.
//!
//! A ray has three outcomes:
//! - **blocked**: it meets a triangle;
//! - **unknown**: it meets no triangle but a curtain;
//! - **lit**: it meets neither. The view frustum is convex, so such a ray runs through seen, empty space until it reaches its
//!   end, leaves through a pane, or leaves the frustum; what it crosses outside the frustum is taken to be empty. (Calling it
//!   unknown would make every ray to a light beside or behind the camera unknown, and most rooms are empty there.)

use std::sync::OnceLock;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::rays::{FAR, RayMesh};
use crate::image::{Mask, Plane, Points};

/// Relative depth difference beyond which two neighbouring pixels are not the same surface; diagonals take sqrt(2) of it.
pub const DEPTH_STEP: f32 = 0.12;

/// The seen room.
#[derive(Serialize, Deserialize)]
pub struct SceneMesh {
    points: Plane<Vec3>,
    /// How the quad right of and below each pixel is split: see [`Cell`].
    cells: Plane<u8>,
    /// Standard deviation of the inverse depth, 1/m.
    noise: f32,
    /// Pixels per unit of tan(angle) of the camera.
    focal: f32,
    #[serde(skip)]
    rays: OnceLock<RayMesh>,
}

/// Bits of a quad: which diagonal, and what its two triangles are.
struct Cell;

impl Cell {
    /// Set: split from top right to bottom left; clear: from top left to bottom right.
    const RISING: u8 = 1;
    const SURFACE: [u8; 2] = [2, 4];
    const CURTAIN: [u8; 2] = [8, 16];
}

/// What a ray between two points meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sight {
    Lit,
    Blocked,
    Unknown,
}

/// The nearest surface that a ray meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index (row by row) of the pixel nearest to the place met.
    pub pixel: u32,
    /// Metres.
    pub distance: f32,
}

/// Pixels whose triangles and curtains let rays pass: a light is no obstacle to its own light.
pub struct Own(Vec<bool>);

impl Own {
    /// The pixels where `mask` exceeds one half and those beside them: a triangle at the rim of a lamp is lamp, and masks
    /// tend to be too small rather than too large. The mask has the size of the mesh.
    pub fn new(mask: &Mask) -> Own {
        let (width, height) = mask.0.size();
        let inside = |x: usize, y: usize| {
            (y.saturating_sub(1)..(y + 2).min(height))
                .any(|y| (x.saturating_sub(1)..(x + 2).min(width)).any(|x| mask.0.get(x, y) > 0.5))
        };
        Own(Plane::from_fn(width, height, inside).into_pixels())
    }
}

/// Set in the number of a triangle of the ray mesh when it is a curtain; the rest is 2 x pixel + which half.
const CURTAIN: u32 = 1 << 31;

impl SceneMesh {
    /// Builds the mesh over `points` as seen by a camera of focal length `focal` pixels; pixels where `outside` is true are
    /// no part of the room. `noise` is the standard deviation of the inverse depth (1/m), from which ray offsets follow.
    pub fn new(points: &Points, focal: f32, noise: f32, outside: &Plane<bool>) -> SceneMesh {
        let points = points.0.clone();
        let (width, height) = points.size();
        let room = |x: usize, y: usize| {
            let z = -points.get(x, y).z;
            !outside.get(x, y) && z > 0.0 && z <= FAR
        };
        let cells = Plane::from_fn(width, height, |x, y| {
            if x + 1 >= width || y + 1 >= height {
                return 0;
            }
            let depth = |i: usize| -points.get(x + i % 2, y + i / 2).z;
            let inside = |i: &usize| room(x + i % 2, y + i / 2);
            split(depth, inside)
        });
        SceneMesh { points, cells, noise, focal, rays: OnceLock::new() }
    }

    /// (width, height) of the pixel grid.
    pub fn size(&self) -> (usize, usize) {
        self.points.size()
    }

    /// Corners of each triangle and whether it is a curtain, with its number.
    fn triangles(&self) -> impl Iterator<Item = ([Vec3; 3], u32)> {
        let width = self.points.width();
        (0..self.cells.len()).flat_map(move |pixel| {
            let cell = self.cells.pixels()[pixel];
            (0..2).filter_map(move |half| {
                let curtain = match cell {
                    c if c & Cell::SURFACE[half] != 0 => 0,
                    c if c & Cell::CURTAIN[half] != 0 => CURTAIN,
                    _ => return None,
                };
                let corners = corners(cell, half).map(|i| self.points.pixels()[pixel + i % 2 + i / 2 * width]);
                Some((corners, (2 * pixel + half) as u32 | curtain))
            })
        })
    }

    /// The hierarchy; the first caller builds it.
    pub fn rays(&self) -> &RayMesh {
        self.rays.get_or_init(|| RayMesh::new(self.triangles()))
    }

    /// Number of surface triangles and of curtains.
    pub fn counts(&self) -> (usize, usize) {
        let count = |bits: [u8; 2]| {
            self.cells.pixels().iter().map(|c| bits.iter().filter(|&&b| c & b != 0).count()).sum()
        };
        (count(Cell::SURFACE), count(Cell::CURTAIN))
    }

    /// Memory held, in bytes, with the hierarchy counted as if it were built.
    pub fn bytes(&self) -> usize {
        let triangles: usize = { let (a, b) = self.counts(); a + b };
        self.points.bytes() + self.cells.bytes() + triangles * 160
    }

    /// How far above the surface a ray must start so that it does not meet its own surface, metres: half a pixel's footprint
    /// (the mesh is flat between pixel centres, the surface need not be) plus three standard deviations of the depth, which
    /// is what smoothing leaves at most.
    pub fn offset(&self, point: Vec3) -> f32 {
        let z = (-point.z).max(0.0);
        0.5 * z / self.focal + 3.0 * self.noise * z * z
    }

    /// What lies between `from` and `to`; triangles of `own` pixels let the ray pass.
    pub fn visibility(&self, from: Vec3, to: Vec3, own: Option<&Own>) -> Sight {
        let mut behind = false;
        let stops = |id: u32| {
            if own.is_some_and(|own| self.touches(id, own)) {
                return false;
            }
            behind |= id & CURTAIN != 0;
            id & CURTAIN == 0
        };
        // The last thousandth is left out: a light that lies on a seen surface is not blocked by it.
        let blocked = self.rays().any(from, to - from, 0.999, stops);
        match (blocked, behind) {
            (true, _) => Sight::Blocked,
            (false, true) => Sight::Unknown,
            (false, false) => Sight::Lit,
        }
    }

    /// The nearest surface along a ray of unit `direction`, or none; curtains let it pass.
    pub fn closest(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        let hit = self.rays().closest(origin, direction, |id| id & CURTAIN == 0)?;
        Some(Hit { pixel: self.nearest_corner(hit.id, origin + direction * hit.distance), distance: hit.distance })
    }

    fn corner_pixels(&self, id: u32) -> [usize; 3] {
        let id = (id & !CURTAIN) as usize;
        let (pixel, half) = (id / 2, id % 2);
        corners(self.cells.pixels()[pixel], half).map(|i| pixel + i % 2 + i / 2 * self.points.width())
    }

    fn nearest_corner(&self, id: u32, at: Vec3) -> u32 {
        let [a, b, c] = self.corner_pixels(id).map(|i| (self.points.pixels()[i].distance_squared(at), i as u32));
        [b, c].into_iter().fold(a, |best, next| if next.0 < best.0 { next } else { best }).1
    }

    fn touches(&self, id: u32, own: &Own) -> bool {
        self.corner_pixels(id).into_iter().any(|pixel| own.0[pixel])
    }
}

/// The corners (0 top left, 1 top right, 2 bottom left, 3 bottom right) of one half of a quad.
fn corners(cell: u8, half: usize) -> [usize; 3] {
    match (cell & Cell::RISING != 0, half) {
        (true, 0) => [0, 2, 1],
        (true, _) => [1, 2, 3],
        (false, 0) => [0, 2, 3],
        (false, _) => [0, 3, 1],
    }
}

/// Splits a quad whose corners have these depths along the better diagonal.
fn split(depth: impl Fn(usize) -> f32, inside: impl Fn(&usize) -> bool) -> u8 {
    let steep = |a: usize, b: usize| {
        let (a, b, diagonal) = (depth(a), depth(b), a + b == 3);
        (a - b).abs() > DEPTH_STEP * if diagonal { std::f32::consts::SQRT_2 } else { 1.0 } * a.min(b)
    };
    let along = |rising: u8| {
        let mut cell = rising;
        for half in 0..2 {
            let [a, b, c] = corners(rising, half);
            if [a, b, c].iter().all(&inside) {
                let torn = steep(a, b) || steep(b, c) || steep(c, a);
                cell |= if torn { Cell::CURTAIN[half] } else { Cell::SURFACE[half] };
            }
        }
        cell
    };
    let surfaces = |cell: u8| (cell & (Cell::SURFACE[0] | Cell::SURFACE[1])).count_ones();
    let (falling, rising) = (along(0), along(Cell::RISING));
    // Of equally good diagonals the one with the smaller depth difference follows the surface better.
    let flatter = (depth(1) - depth(2)).abs() < (depth(0) - depth(3)).abs();
    if surfaces(rising) > surfaces(falling) || (surfaces(rising) == surfaces(falling) && flatter) { rising } else { falling }
}
