//! The seen room as triangles, and the visibility along rays through it.
//!
//! Vertices are the pixel centers on the surface. Between four neighboring pixels lie two
//! triangles, split along the diagonal that keeps more of them; no triangle spans a depth step. A
//! triangle that does is kept as a **curtain**: not a surface, but a ray that crosses it goes
//! behind a depth edge, where the camera saw nothing. Pixels outside the room (panes, pixels in
//! `ignore`) have neither.
//!
//! Bodies that an edit puts into the room are solid triangles of their own, without curtains.
//!
//! A ray has three outcomes:
//! - **blocked**: it meets a triangle;
//! - **unknown**: it meets no triangle but a curtain;
//! - **lit**: it meets neither. The view frustum is convex, so such a ray runs through seen, empty
//!   space until it reaches its end, leaves through a pane, or leaves the frustum; space outside
//!   the frustum counts as empty. (A caller for whom it is unseen checks whether the end is
//!   [in view](SceneMesh::in_view).)

use std::sync::OnceLock;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::geometry::bvh::rays::{FAR, RayMesh, apart};
use crate::geometry::objects::bodies::Bodies;
use crate::image::{DEPTH_PLANE, Mask, Plane, Points, rule};
use crate::tuning::tuning;

tuning! {
    /// Constants of rays in the mesh of the seen room.
    pub const TUNING: MeshTuning {
        /// Depth error by which rays start above the surface.
        deviations: f32 = 3.0,
            unit "standard deviations of the depth", source Derived("smoothing leaves at most this"),
            effect "a larger value lets light through at contacts";
        /// Height at which rays start above the surface, in addition: the mesh is flat between
        /// pixel centers, the surface need not be.
        footprint: f32 = 0.5,
            unit "footprints of a pixel", source Taste, effect "a larger value lets light through at contacts";
        /// End of a shadow ray before its light: a light that lies on a seen surface is not blocked
        /// by it.
        shadow_end: f32 = 0.999,
            unit "the ray's length", source Derived("single precision"),
            effect "a larger value may let a light on a surface be blocked by it";
    }
}

/// The seen room.
#[derive(Serialize, Deserialize)]
pub struct SceneMesh {
    points: Plane<Vec3>,
    /// The split of the quad right of and below each pixel: see [`Cell`].
    cells: Plane<u8>,
    /// Standard deviation of the inverse depth, 1/m.
    noise: f32,
    /// Pixels per unit of tan(angle) of the camera.
    focal: f32,
    /// Bodies that an edit puts into the room.
    bodies: Bodies,
    /// Surfaces and curtains apart: a blocked ray need not look at the long, overlapping curtains
    /// at all.
    #[serde(skip)]
    rays: OnceLock<[RayMesh; 2]>,
}

/// Bits of a quad: its diagonal, and the kinds of its two triangles.
struct Cell;

impl Cell {
    /// Set: split from top right to bottom left; clear: from top left to bottom right.
    const RISING: u8 = 1;
    const SURFACE: [u8; 2] = [2, 4];
    const CURTAIN: [u8; 2] = [8, 16];
}

/// The visibility between two points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sight {
    /// The points see each other.
    Lit,
    /// A surface lies between the points.
    Blocked,
    /// The segment passes through a region that the photo does not show.
    Unknown,
}

/// The nearest surface that a ray meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index (row by row) of the pixel nearest to the place met; after all pixels come the probes
    /// of the bodies.
    pub pixel: u32,
    /// Meters.
    pub distance: f32,
}

/// Pixels whose triangles and curtains let rays pass: a light does not shadow itself.
pub struct Own(Vec<bool>);

impl Own {
    /// The pixels where `mask` exceeds one half and those beside them: a triangle at the rim of a
    /// lamp is lamp, and masks tend to be too small rather than too large. The mask has the size of
    /// the mesh.
    pub fn new(mask: &Mask) -> Own {
        let (width, height) = mask.0.size();
        let inside = |x: usize, y: usize| {
            (y.saturating_sub(1)..(y + 2).min(height))
                .any(|y| (x.saturating_sub(1)..(x + 2).min(width)).any(|x| mask.0.get(x, y) > 0.5))
        };
        Own(Plane::from_fn(width, height, inside).into_pixels())
    }
}

impl SceneMesh {
    /// Builds the mesh over `points` as seen by a camera of focal length `focal` pixels; pixels
    /// where `outside` is true are not part of the room. `noise` is the standard deviation of the
    /// inverse depth (1/m), from which ray offsets follow.
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
        SceneMesh { points, cells, noise, focal, bodies: Bodies::default(), rays: OnceLock::new() }
    }

    /// Whether a mesh that was read from disk has a cell for each point, and sound bodies.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub fn check(&self) -> Result<(), String> {
        let (width, height) = self.points.size();
        // The last row and the last column do not have quads.
        let inside = |i: usize| i % width + 1 < width && i / width + 1 < height;
        rule(self.cells.size() == (width, height), "a cell for each point")?;
        let sound = self.cells.pixels().iter().enumerate().all(|(i, &cell)| cell == 0 || inside(i));
        rule(sound, "no cell beyond the last row or column")?;
        self.bodies.check()
    }

    /// The same room with these bodies in it, in place of any that it had.
    pub fn with_bodies(&self, bodies: Bodies) -> SceneMesh {
        let (points, cells) = (self.points.clone(), self.cells.clone());
        SceneMesh {
            points,
            cells,
            noise: self.noise,
            focal: self.focal,
            bodies,
            rays: OnceLock::new(),
        }
    }

    /// Bodies that an edit put into the room.
    pub fn bodies(&self) -> &Bodies {
        &self.bodies
    }

    /// (width, height) of the pixel grid.
    pub fn size(&self) -> (usize, usize) {
        self.points.size()
    }

    /// Whether the camera sees in the direction of `place`; occluders do not matter.
    pub fn in_view(&self, place: Vec3) -> bool {
        let slope = |p: Vec3| p.truncate() / -p.z;
        let (first, last) = (self.points.pixels()[0], self.points.pixels()[self.points.len() - 1]);
        let (low, high) = (slope(first).min(slope(last)), slope(first).max(slope(last)));
        let half = 0.5 / self.focal;
        place.z < 0.0
            && slope(place).cmpge(low - half).all()
            && slope(place).cmple(high + half).all()
    }

    /// Corners and number (2 x pixel + half) of each triangle that has one of these bits.
    fn triangles(&self, bits: [u8; 2]) -> impl Iterator<Item = ([Vec3; 3], u32)> {
        let width = self.points.width();
        (0..self.cells.len()).flat_map(move |pixel| {
            let cell = self.cells.pixels()[pixel];
            (0..2).filter(move |&half| cell & bits[half] != 0).map(move |half| {
                let corners = corners(cell, half)
                    .map(|i| self.points.pixels()[pixel + i % 2 + i / 2 * width]);
                (corners, (2 * pixel + half) as u32)
            })
        })
    }

    /// Pixels at the corners of each surface triangle, counter-clockwise as the camera sees it, and
    /// its number.
    pub fn faces(&self) -> impl Iterator<Item = ([u32; 3], u32)> {
        self.triangles(Cell::SURFACE)
            .map(|(_, id)| (self.corner_pixels(id).map(|pixel| pixel as u32), id))
    }

    fn rays(&self) -> &[RayMesh; 2] {
        let build =
            || [Cell::SURFACE, Cell::CURTAIN].map(|bits| RayMesh::new(self.triangles(bits)));
        self.rays.get_or_init(|| apart(build))
    }

    /// Whether the pixel is a corner of any surface triangle; panes and ignored pixels are not.
    pub fn in_room(&self, pixel: usize) -> bool {
        let (x, y) = (pixel % self.points.width(), pixel / self.points.width());
        let quads = [
            (x, y),
            (x.wrapping_sub(1), y),
            (x, y.wrapping_sub(1)),
            (x.wrapping_sub(1), y.wrapping_sub(1)),
        ];
        let (width, height) = self.cells.size();
        // The quads around the pixel, and which of their corners it is.
        quads.iter().enumerate().any(|(corner, &(x, y))| {
            let cell = if x < width && y < height { self.cells.get(x, y) } else { 0 };
            (0..2).any(|half| {
                cell & Cell::SURFACE[half] != 0 && corners(cell, half).contains(&corner)
            })
        })
    }

    /// The surface, for rays of one's own; the first caller builds the hierarchy. Numbers are 2 x
    /// pixel + half.
    pub fn surfaces(&self) -> &RayMesh {
        &self.rays()[0]
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
        let triangles: usize = {
            let (a, b) = self.counts();
            a + b
        };
        self.points.bytes() + self.cells.bytes() + triangles * 80 + self.bodies.bytes()
    }

    /// Three standard deviations of the depth `z`, meters.
    pub fn depth_error(&self, z: f32) -> f32 {
        TUNING.deviations * self.noise * z * z
    }

    /// Offset of a ray's origin above the surface that avoids self-intersection, meters: half a
    /// pixel's footprint (the mesh is flat between pixel centers, the surface need not be) plus
    /// three standard deviations of the depth, which bounds the noise after smoothing.
    pub fn offset(&self, point: Vec3) -> f32 {
        let z = (-point.z).max(0.0);
        TUNING.footprint * z / self.focal + self.depth_error(z)
    }

    /// The visibility between `from` and `to`; triangles of `own` pixels let the ray pass.
    pub fn visibility(&self, from: Vec3, to: Vec3, own: Option<&Own>) -> Sight {
        let stops = |id: u32| own.is_none_or(|own| !self.touches(id, own));
        let meets = |mesh: &RayMesh| mesh.any(from, to - from, TUNING.shadow_end, stops);
        let [surfaces, curtains] = self.rays();
        if meets(surfaces) || self.bodies.between(from, to) {
            Sight::Blocked
        } else if meets(curtains) {
            Sight::Unknown
        } else {
            Sight::Lit
        }
    }

    /// The nearest surface along a ray of unit `direction`, or none; curtains let it pass.
    pub fn closest(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        let seen = self.surfaces().closest(origin, direction);
        let hit = self
            .bodies
            .closest(origin, direction)
            .filter(|b| seen.is_none_or(|s| b.distance < s.distance));
        if let Some(hit) = hit {
            let probe =
                self.bodies.nearest_probe(hit.id, origin + direction * hit.distance, direction);
            return Some(Hit { pixel: (self.points.len() + probe) as u32, distance: hit.distance });
        }
        let hit = seen?;
        Some(Hit {
            pixel: self.nearest_corner(hit.id, origin + direction * hit.distance),
            distance: hit.distance,
        })
    }

    fn corner_pixels(&self, id: u32) -> [usize; 3] {
        let (pixel, half) = (id as usize / 2, id as usize % 2);
        corners(self.cells.pixels()[pixel], half)
            .map(|i| pixel + i % 2 + i / 2 * self.points.width())
    }

    fn nearest_corner(&self, id: u32, at: Vec3) -> u32 {
        let [a, b, c] = self
            .corner_pixels(id)
            .map(|i| (self.points.pixels()[i].distance_squared(at), i as u32));
        [b, c].into_iter().fold(a, |best, next| if next.0 < best.0 { next } else { best }).1
    }

    /// Whether a corner of triangle `id` is one of these pixels.
    pub fn touches(&self, id: u32, own: &Own) -> bool {
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
        (a - b).abs()
            > DEPTH_PLANE.step * if diagonal { std::f32::consts::SQRT_2 } else { 1.0 } * a.min(b)
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
    // Among equally good diagonals, the one with the smaller depth difference follows the surface
    // better.
    let flatter = (depth(1) - depth(2)).abs() < (depth(0) - depth(3)).abs();
    if surfaces(rising) > surfaces(falling) || (surfaces(rising) == surfaces(falling) && flatter) {
        rising
    } else {
        falling
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;

    fn mesh(
        camera: &Camera,
        outside: impl Fn(usize, usize) -> bool,
        depth: impl Fn(usize, usize) -> f32,
    ) -> SceneMesh {
        let points = Plane::from_fn(camera.width, camera.height, |x, y| {
            camera.pixel_point(x, y, depth(x, y))
        });
        let outside = Plane::from_fn(camera.width, camera.height, outside);
        SceneMesh::new(&Points(points), camera.fx, 0.0, &outside)
    }

    /// A square at 2 m before a wall at 4 m.
    fn square_before_wall() -> (Camera, SceneMesh) {
        let camera = Camera::from_fov_x(80, 60, 60.0);
        let square = |x: usize, y: usize| (30..50).contains(&x) && (20..40).contains(&y);
        let depth = |x, y| if square(x, y) { 2.0 } else { 4.0 };
        (camera, mesh(&camera, |_, _| false, depth))
    }

    #[test]
    fn three_outcomes_before_and_behind_a_square() {
        let (camera, mesh) = square_before_wall();
        let on_wall = camera.unproject(10.0, 30.0, 3.99);
        assert_eq!(
            mesh.visibility(on_wall, Vec3::new(0.3, 0.2, -1.0), None),
            Sight::Lit,
            "in front of both"
        );
        assert_eq!(
            mesh.visibility(on_wall, Vec3::new(-5.0, 0.0, 1.0), None),
            Sight::Lit,
            "out of the frustum"
        );
        // From the wall left of the square to the right of it, passing behind.
        let (from, to) = (camera.unproject(20.0, 30.0, 3.9), camera.unproject(60.0, 30.0, 3.9));
        assert_eq!(mesh.visibility(from, to, None), Sight::Unknown);
        let (front, back) = (camera.unproject(40.0, 30.0, 1.0), camera.unproject(40.0, 30.0, 3.0));
        assert_eq!(mesh.visibility(front, back, None), Sight::Blocked);
        let square = Own::new(&Mask(Plane::from_fn(80, 60, |x, y| {
            f32::from((30..50).contains(&x) && (20..40).contains(&y))
        })));
        assert_eq!(mesh.visibility(front, back, Some(&square)), Sight::Lit, "its own light");
        assert_eq!(mesh.visibility(from, to, Some(&square)), Sight::Lit, "its own curtain");
    }

    #[test]
    fn the_view_ends_half_a_pixel_beyond_the_outer_centers() {
        let (camera, mesh) = square_before_wall();
        for (x, y, inside) in [
            (0.01, 0.01, true),
            (79.99, 59.99, true),
            (-0.01, 30.0, false),
            (80.01, 30.0, false),
            (40.0, -0.01, false),
        ] {
            assert_eq!(mesh.in_view(camera.unproject(x, y, 9.0)), inside, "{x}, {y}");
            assert!(!mesh.in_view(-camera.unproject(x, y, 9.0)), "behind the camera");
        }
        assert!(!mesh.in_view(Vec3::ZERO));
    }

    #[test]
    fn steps_tear_slopes_hold_and_panes_are_holes() {
        let (_, torn) = square_before_wall();
        // 20 x 20 pixels: a ring of 21^2 - 19^2 quads, four of which keep the corner triangle on
        // the wall.
        assert_eq!(torn.counts(), (2 * 79 * 59 - 2 * 80 + 4, 2 * 80 - 4));
        let camera = Camera::from_fov_x(8, 6, 60.0);
        let steep = mesh(&camera, |_, _| false, |x, y| 1.11f32.powi((x + y) as i32));
        assert_eq!(
            steep.counts(),
            (2 * 7 * 5, 0),
            "11 % a pixel along both axes; only the rising diagonals hold"
        );
        let pane = mesh(
            &camera,
            |x, y| x == 3 && y == 3,
            |x, y| if (x, y) == (3, 3) { 100.0 } else { 2.0 },
        );
        assert_eq!(
            pane.counts(),
            (2 * 7 * 5 - 4, 0),
            "one triangle less in each quad around the pane, no curtain"
        );
        let through = camera.pixel_point(3, 3, 50.0);
        assert_eq!(pane.visibility(camera.pixel_point(3, 3, 0.5), through, None), Sight::Lit);
    }

    #[test]
    fn hits_agree_with_the_plane_seen_and_are_watertight() {
        let camera = Camera::from_fov_x(64, 48, 60.0);
        let wall = mesh(&camera, |_, _| false, |_, _| 3.0);
        // Through vertices and along shared edges, the directions most likely to slip through.
        for row in 2..46 {
            for half_column in 4..120 {
                let to = camera.unproject(0.5 * half_column as f32, row as f32 + 0.5, 3.0);
                let hit = wall.closest(Vec3::ZERO, to.normalize()).expect("the wall is closed");
                assert!((hit.distance - to.length()).abs() < 1e-5 * to.length());
                let (x, y) = (hit.pixel as usize % 64, hit.pixel as usize / 64);
                assert!(camera.pixel_point(x, y, 3.0).distance(to) < 0.8 * 3.0 / camera.fx);
            }
        }
    }

    #[test]
    fn odd_meshes_are_harmless() {
        for (width, height) in [(0, 0), (1, 1), (1, 9), (9, 1), (2, 2)] {
            for z in [1.0, 0.0, -1.0, f32::NAN, f32::INFINITY, f32::MAX, f32::MIN_POSITIVE] {
                let camera = Camera { width, height, fx: 10.0, fy: 10.0, cx: 0.5, cy: 0.5 };
                let mesh = mesh(&camera, |_, _| false, |_, _| z);
                for to in [Vec3::NEG_Z, Vec3::ZERO, Vec3::NAN, Vec3::INFINITY, Vec3::splat(1e30)] {
                    mesh.visibility(Vec3::ZERO, to, None);
                    mesh.visibility(to, Vec3::ONE, None);
                    mesh.closest(to, Vec3::NEG_Z);
                    mesh.closest(Vec3::ZERO, to);
                }
            }
        }
    }

    #[test]
    fn survives_a_round_trip() {
        let (camera, mesh) = square_before_wall();
        let back: SceneMesh = postcard::from_bytes(&postcard::to_stdvec(&mesh).unwrap()).unwrap();
        let (front, behind) =
            (camera.unproject(40.0, 30.0, 1.0), camera.unproject(40.0, 30.0, 3.0));
        assert_eq!(back.visibility(front, behind, None), Sight::Blocked);
        assert_eq!(back.counts(), mesh.counts());
    }
}
