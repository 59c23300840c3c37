//! Rays against triangles.

use fearless_simd::{Level, Simd, dispatch};
use glam::Vec3;
use rayon::prelude::*;

use super::bvh8::Bvh8;
use super::watertight_triangle::Turned;

/// Beyond this many meters nothing is part of a room; it also keeps products of coordinates finite.
pub const FAR: f32 = 1e4;

/// Triangles that rays can be traced against. Neighbors leave no gap, and results are the same on
/// every processor.
pub struct RayMesh {
    bvh: Bvh8,
    /// The processor's instruction set.
    level: Level,
}

/// The intersection of a ray with a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayMeshHit {
    /// The caller's number of the triangle.
    pub id: u32,
    /// In units of the ray direction's length.
    pub distance: f32,
}

impl RayMesh {
    /// Builds the hierarchy. Triangles without area or with a corner beyond `FAR` (or not a number)
    /// are left out, and so are repetitions: many equal boxes would slow the build down beyond
    /// measure.
    pub fn new(triangles: impl IntoIterator<Item = ([Vec3; 3], u32)>) -> RayMesh {
        let mut kept: Vec<([Vec3; 3], u32)> = triangles
            .into_iter()
            .filter(|(c, _)| {
                c.iter().all(|p| p.abs().max_element() <= FAR)
                    && (c[1] - c[0]).cross(c[2] - c[0]).length_squared() > f32::MIN_POSITIVE
            })
            .collect();
        let bits = |c: &[Vec3; 3]| c.map(|p| p.to_array().map(f32::to_bits));
        kept.par_sort_unstable_by_key(|(c, id)| (bits(c), *id));
        kept.dedup_by(|a, b| bits(&a.0) == bits(&b.0));
        RayMesh { bvh: Bvh8::new(&kept), level: Level::new() }
    }

    /// Memory held, in bytes.
    pub fn bytes(&self) -> usize {
        self.bvh.bytes()
    }

    /// The nearest triangle hit; of equally near ones the lowest number.
    pub fn closest(&self, origin: Vec3, direction: Vec3) -> Option<RayMeshHit> {
        if !usable(origin, direction) {
            return None;
        }
        dispatch!(self.level, simd => closest_hit(simd, &self.bvh, origin, direction))
    }

    /// Whether `stops` returns true for any triangle hit within (0, `limit`); called in arbitrary
    /// order, and not again once it has returned true.
    pub fn any(
        &self,
        origin: Vec3,
        direction: Vec3,
        limit: f32,
        stops: impl Fn(u32) -> bool,
    ) -> bool {
        if !usable(origin, direction) || limit.is_nan() || limit <= 0.0 {
            return false;
        }
        dispatch!(self.level, simd => any_hit(simd, &self.bvh, origin, direction, limit.next_down(), &stops))
    }
}

fn usable(origin: Vec3, direction: Vec3) -> bool {
    origin.is_finite() && direction.is_finite() && direction != Vec3::ZERO
}

#[inline(always)]
fn closest_hit<S: Simd>(simd: S, bvh: &Bvh8, origin: Vec3, direction: Vec3) -> Option<RayMeshHit> {
    let ray = Turned::new(simd, origin, direction);
    let mut best: Option<RayMeshHit> = None;
    bvh.walk::<S, true>(
        simd,
        [origin, direction],
        f32::MAX,
        #[inline(always)]
        |packet, mut limit| {
            let (mut hits, distances) = ray.hits(packet, limit);
            while hits != 0 {
                let lane = hits.trailing_zeros() as usize & 7;
                hits &= hits - 1;
                let hit = RayMeshHit { id: packet.ids[lane], distance: distances[lane] };
                if best.is_none_or(|b| {
                    hit.distance < b.distance || (hit.distance == b.distance && hit.id < b.id)
                }) {
                    best = Some(hit);
                    limit = hit.distance;
                }
            }
            limit
        },
    );
    best
}

#[inline(always)]
fn any_hit<S: Simd>(
    simd: S,
    bvh: &Bvh8,
    origin: Vec3,
    direction: Vec3,
    limit: f32,
    stops: &impl Fn(u32) -> bool,
) -> bool {
    let ray = Turned::new(simd, origin, direction);
    let mut stopped = false;
    bvh.walk::<S, false>(
        simd,
        [origin, direction],
        limit,
        #[inline(always)]
        |packet, limit| {
            let mut hits = ray.hits(packet, limit).0;
            while hits != 0 && !stopped {
                stopped = stops(packet.ids[hits.trailing_zeros() as usize & 7]);
                hits &= hits - 1;
            }
            if stopped { -1.0 } else { limit }
        },
    );
    stopped
}

/// Runs `work`, which uses rayon, on one thread of its own. A caller that waits for it inside a
/// lock must not help out with other jobs of its own pool meanwhile, as rayon does: one of them
/// could come for the same lock. One thread, because the hierarchy that obvhs builds depends on how
/// many there are.
pub(in crate::geometry) fn apart<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    let run = || match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
        Ok(pool) => pool.install(work),
        Err(_) => work(),
    };
    std::thread::scope(|scope| scope.spawn(run).join())
        .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;

    use super::*;
    use crate::geometry::Camera;

    type Triangles = Vec<([Vec3; 3], u32)>;

    /// The same triangle test one by one, in plain arithmetic: infinite when missed.
    fn slow_distance(corners: &[Vec3; 3], origin: Vec3, direction: Vec3) -> f32 {
        let z = direction.abs().max_position();
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        if direction[z] < 0.0 {
            (x, y) = (y, x);
        }
        let inverse = 1.0 / direction[z];
        let shear = [direction[x] * inverse, direction[y] * inverse, inverse];
        let [a, b, c] = corners.map(|corner| {
            let p = corner - origin;
            [p[x] - shear[0] * p[z], p[y] - shear[1] * p[z], shear[2] * p[z]]
        });
        let u = c[0] * b[1] - c[1] * b[0];
        let v = a[0] * c[1] - a[1] * c[0];
        let w = b[0] * a[1] - b[1] * a[0];
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return f32::INFINITY;
        }
        let t = (u * a[2] + v * b[2] + w * c[2]) / (u + v + w);
        if t > 0.0 { t } else { f32::INFINITY }
    }

    /// A reference that tests every triangle.
    fn slow_closest(triangles: &Triangles, origin: Vec3, direction: Vec3) -> Option<RayMeshHit> {
        let hit = |(corners, id): &([Vec3; 3], u32)| RayMeshHit {
            id: *id,
            distance: slow_distance(corners, origin, direction),
        };
        let hits = triangles.iter().map(hit).filter(|hit| hit.distance.is_finite());
        hits.min_by(|a, b| a.distance.total_cmp(&b.distance).then(a.id.cmp(&b.id)))
    }

    /// The instruction sets of this processor, the smallest first.
    fn levels() -> Vec<Level> {
        let best = Level::new();
        #[cfg(target_arch = "x86_64")]
        let between = [best.as_sse4_2().map(Level::Sse4_2), best.as_avx2().map(Level::Avx2)];
        #[cfg(not(target_arch = "x86_64"))]
        let between = [None];
        [Level::baseline()].into_iter().chain(between.into_iter().flatten()).chain([best]).collect()
    }

    /// Whether the ray runs in the plane of the triangle, to rounding, and still seems to hit it:
    /// such a hit can lie far away from the triangle, where no box is entered.
    fn in_doubt(corners: &[Vec3; 3], origin: Vec3, direction: Vec3) -> bool {
        let [a, b, c] = corners.map(|corner| (corner - origin).as_dvec3());
        let normal = (b - a).cross(c - a);
        let along = |v: DVec3| normal.dot(v).abs() < 1e-5 * normal.length() * v.length();
        along(direction.as_dvec3())
            && along(a)
            && slow_distance(corners, origin, direction).is_finite()
    }

    /// Holds one ray against the twin, bit for bit, with every instruction set there is. Ambiguous
    /// rays are skipped.
    fn check(mesh: &mut RayMesh, triangles: &Triangles, origin: Vec3, direction: Vec3) {
        if triangles.iter().any(|(corners, _)| in_doubt(corners, origin, direction)) {
            return;
        }
        let slow = slow_closest(triangles, origin, direction);
        for level in levels() {
            mesh.level = level;
            let what = || format!("from {origin} along {direction}, {level:?}");
            assert_eq!(mesh.closest(origin, direction), slow, "{}", what());
            let Some(hit) = slow else {
                assert!(!mesh.any(origin, direction, f32::INFINITY, |_| true), "{}", what());
                continue;
            };
            assert!(mesh.any(origin, direction, hit.distance.next_up(), |_| true), "{}", what());
            assert!(
                !mesh.any(origin, direction, hit.distance, |_| true),
                "nothing before it, {}",
                what()
            );
            let ids = std::cell::RefCell::new(std::collections::BTreeSet::new());
            let none = mesh.any(origin, direction, f32::INFINITY, |id| {
                ids.borrow_mut().insert(id);
                false
            });
            let slow_ids =
                triangles.iter().filter(|(c, _)| slow_distance(c, origin, direction).is_finite());
            assert!(
                !none && ids.into_inner().into_iter().eq(slow_ids.map(|t| t.1)),
                "asked about every hit, {}",
                what()
            );
        }
    }

    fn point() -> impl Strategy<Value = Vec3> {
        // Whole numbers make equal distances, axis-parallel edges and rays through corners common.
        let whole = (-3i8..4, -3i8..4, -3i8..4)
            .prop_map(|(x, y, z)| Vec3::new(x.into(), y.into(), z.into()));
        let any = (-3.0f32..3.0, -3.0f32..3.0, -3.0f32..3.0).prop_map(Vec3::from);
        prop_oneof![whole, any]
    }

    /// Triangles that `RayMesh` keeps, each once.
    fn soup(most: usize) -> impl Strategy<Value = Triangles> {
        let kept = |corners: Vec<[Vec3; 3]>| {
            let area = |c: &[Vec3; 3]| (c[1] - c[0]).cross(c[2] - c[0]).length_squared();
            let mut kept: Vec<_> =
                corners.into_iter().filter(|c| area(c) > f32::MIN_POSITIVE).collect();
            kept.dedup();
            kept.into_iter().zip(0..).collect::<Triangles>()
        };
        prop::collection::vec([point(), point(), point()], 0..most).prop_map(kept)
    }

    /// All triangles of a depth map, slivers across its steps as well.
    fn depth_mesh(camera: &Camera, depth: impl Fn(usize, usize) -> f32) -> Triangles {
        let (width, height) = (camera.width, camera.height);
        let at = |x: usize, y: usize| camera.pixel_point(x, y, depth(x, y));
        let quads = (0..width * height)
            .map(|i| (i % width, i / width))
            .filter(|&(x, y)| x + 1 < width && y + 1 < height);
        let halves = quads.flat_map(|(x, y)| {
            let (a, b, c, d) = (at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1));
            [[a, c, d], [a, d, b]]
        });
        halves.zip(0..).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        #[test]
        fn random_triangles_are_hit_as_one_by_one(triangles in soup(60), rays in prop::collection::vec((point(), point()), 20)) {
            let mut mesh = RayMesh::new(triangles.iter().copied());
            for (origin, direction) in rays.into_iter().filter(|ray| ray.1 != Vec3::ZERO) {
                check(&mut mesh, &triangles, origin, direction);
            }
        }

        #[test]
        fn depth_meshes_are_hit_as_one_by_one(
            depths in prop::collection::vec(prop_oneof![Just(2.0f32), Just(5.0), 1.0f32..6.0], 12 * 9),
            rays in prop::collection::vec((0..12 * 9usize, point()), 20),
        ) {
            let camera = Camera::from_fov_x(12, 9, 60.0);
            let triangles = depth_mesh(&camera, |x, y| depths[x + 12 * y]);
            let mut mesh = RayMesh::new(triangles.iter().copied());
            for (pixel, from) in rays {
                let vertex = camera.pixel_point(pixel % 12, pixel / 12, depths[pixel]);
                // Through a vertex from the camera and from elsewhere, away from it, through the
                // middle of an edge, along an axis.
                let next = camera.pixel_point((pixel + 1) % 12, pixel / 12, depths[pixel / 12 * 12 + (pixel + 1) % 12]);
                let middle = 0.5 * (vertex + next);
                for (origin, direction) in [(Vec3::ZERO, vertex), (from, vertex - from), (vertex, from), (from, middle - from)] {
                    if direction != Vec3::ZERO {
                        check(&mut mesh, &triangles, origin, direction);
                    }
                }
                for axis in [Vec3::X, Vec3::NEG_Y, Vec3::NEG_Z] {
                    check(&mut mesh, &triangles, vertex - 3.0 * axis, axis);
                }
            }
        }

        #[test]
        fn clear_hits_and_misses_are_those_of_double_precision(
            triangles in soup(12),
            rays in prop::collection::vec((point(), point()), 20),
        ) {
            let mesh = RayMesh::new(triangles.iter().copied());
            'rays: for (origin, direction) in rays.into_iter().filter(|ray| ray.1 != Vec3::ZERO) {
                let mut nearest = f64::INFINITY;
                for (corners, _) in &triangles {
                    // Moeller and Trumbore 1997.
                    let [a, b, c] = corners.map(Vec3::as_dvec3);
                    let (o, d): (DVec3, DVec3) = (origin.as_dvec3(), direction.as_dvec3());
                    let (ab, ac, ao) = (b - a, c - a, o - a);
                    let determinant = d.cross(ac).dot(ab);
                    let (p, q) = (d.cross(ac), ao.cross(ab));
                    let [v, w, t] = [ao.dot(p), d.dot(q), ac.dot(q)].map(|value| value / determinant);
                    // Triangles that are edge-on, and hits at an edge or at the origin, are
                    // ambiguous.
                    let edge = v.min(w).min(1.0 - v - w);
                    if determinant.abs() < 1e-3 * ab.length() * ac.length() * d.length() || edge.abs() < 1e-4 || t.abs() < 1e-4 {
                        continue 'rays;
                    }
                    if edge > 0.0 && t > 0.0 {
                        nearest = nearest.min(t);
                    }
                }
                match mesh.closest(origin, direction) {
                    Some(hit) => prop_assert!((f64::from(hit.distance) - nearest).abs() < 1e-3 * nearest),
                    None => prop_assert_eq!(nearest, f64::INFINITY),
                }
            }
        }
    }

    /// A sensor's view of steps and slants. Rays through pixel centers are rays through vertices,
    /// where six triangles meet.
    #[test]
    fn a_closed_mesh_lets_no_ray_through() {
        let camera = Camera::from_fov_x(320, 240, 60.0);
        let depth = |x: usize, y: usize| {
            let noise = ((x * 7919 + y * 104_729) % 1009) as f32 / 1009.0;
            let base =
                if (x / 40 + y / 30).is_multiple_of(3) { 2.0 } else { 3.0 + 0.01 * x as f32 };
            base + 0.01 * base * noise
        };
        let mesh = RayMesh::new(depth_mesh(&camera, depth));
        let (mut rays, mut missed) = (0, 0);
        // Twice the columns and rows: vertices, middles of edges and of diagonals.
        for row in 2..2 * 239 {
            for column in 2..2 * 319 {
                let to = camera.unproject(0.5 + 0.5 * column as f32, 0.5 + 0.5 * row as f32, 1.0);
                rays += 1;
                missed += usize::from(
                    mesh.closest(Vec3::ZERO, to).is_none()
                        || !mesh.any(Vec3::ZERO, to, 10.0, |_| true),
                );
            }
        }
        assert!(missed * 100_000 <= rays, "{missed} of {rays} rays slip through");
    }

    #[test]
    fn triangles_within_triangles_make_a_deep_hierarchy_and_no_fault() {
        let nested = |id: u32| {
            let size = 1.01f32.powi(id as i32) * 1e-8;
            (
                [
                    Vec3::new(-size, -size, 0.0),
                    Vec3::new(size, -size, 0.0),
                    Vec3::new(0.0, size, size),
                ],
                id,
            )
        };
        let triangles: Triangles = (0..2700).map(nested).collect();
        let mut mesh = RayMesh::new(triangles.iter().copied());
        for direction in
            [Vec3::new(1e-3, 1e-3, -1.0), Vec3::new(-1e-3, 0.0, -1.0), Vec3::new(0.3, 0.2, -1.0)]
        {
            check(&mut mesh, &triangles, Vec3::new(0.0, 0.0, 1.0), direction);
        }
    }

    #[test]
    fn a_ray_that_is_hardly_one_is_harmless() {
        let triangles: Triangles =
            vec![([Vec3::ZERO, Vec3::X, Vec3::Y], 0), ([Vec3::Z, Vec3::X, Vec3::splat(FAR)], 1)];
        let mut mesh = RayMesh::new(triangles.iter().copied());
        for size in [f32::from_bits(1), f32::MIN_POSITIVE, 1e-30, 1e30, f32::MAX] {
            for direction in [Vec3::NEG_Z, Vec3::new(-0.5, 1.0, -1.0), Vec3::ONE] {
                check(&mut mesh, &triangles, Vec3::new(0.2, 0.2, 1.0), direction * size);
                check(&mut mesh, &triangles, direction * -size, direction);
            }
        }
    }

    #[test]
    fn minus_zero_is_zero() {
        let triangles: Triangles =
            vec![([Vec3::ZERO, Vec3::X, Vec3::Y], 0), ([Vec3::Z, Vec3::X, Vec3::splat(9.0)], 1)];
        let mesh = RayMesh::new(triangles.iter().copied());
        let from = Vec3::new(0.2, 0.2, 1.5);
        let plain = mesh.closest(from, Vec3::NEG_Z);
        assert!(plain.is_some());
        for direction in [-Vec3::Z, Vec3::new(-0.0, 0.0, -1.0), Vec3::new(0.0, -0.0, -1.0)] {
            assert_eq!(mesh.closest(from, direction), plain, "{direction:?}");
            assert!(mesh.any(from, direction, 2.0, |_| true), "{direction:?}");
        }
    }

    #[test]
    fn ten_thousand_equal_triangles_do_not_hang() {
        let triangle = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let mesh = RayMesh::new((0..10_000).rev().map(|id| (triangle, id)));
        let hit = mesh.closest(Vec3::new(0.2, 0.2, 1.0), Vec3::NEG_Z).unwrap();
        assert_eq!((hit.id, hit.distance), (0, 1.0));
        assert!(mesh.bytes() < 1000, "one is kept");
    }

    #[test]
    fn unusable_triangles_are_left_out() {
        let bad = [Vec3::NAN, Vec3::INFINITY, Vec3::splat(2.0 * FAR), Vec3::X];
        let mesh = RayMesh::new(bad.iter().map(|&p| ([Vec3::ZERO, Vec3::X, p], 0)));
        assert_eq!(mesh.bytes(), 0);
        assert_eq!(mesh.closest(Vec3::ZERO, Vec3::X), None);
        assert!(!mesh.any(Vec3::ZERO, Vec3::X, 1.0, |_| true));
    }

    #[test]
    fn any_respects_its_limit_and_its_question() {
        let mesh = RayMesh::new([(
            [Vec3::new(-1.0, -1.0, -2.0), Vec3::new(1.0, -1.0, -2.0), Vec3::new(0.0, 2.0, -2.0)],
            7,
        )]);
        let any =
            |limit, stops: bool| mesh.any(Vec3::ZERO, Vec3::NEG_Z, limit, |id| id == 7 && stops);
        assert!(any(2.1, true));
        assert!(!any(1.9, true));
        assert!(!any(2.1, false));
        assert!(!mesh.any(Vec3::ZERO, Vec3::Z, 9.0, |_| true), "behind");
    }
}
