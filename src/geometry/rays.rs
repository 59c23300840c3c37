//! Rays against triangles: a bounding volume hierarchy and a watertight triangle test.
//!
//! The test is that of Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013: neighbouring
//! triangles share edges, and no ray may slip between them.

use std::time::Duration;

use glam::{Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::bvh2::{Bvh2, builder::build_bvh2_from_tris};
use obvhs::ray::{Ray, RayHit};
use obvhs::triangle::Triangle;
use rayon::prelude::*;

/// Beyond this many metres nothing is part of a room; it also keeps products of coordinates finite.
pub const FAR: f32 = 1e4;

/// Triangles that rays can be traced against.
pub struct RayMesh {
    bvh: Bvh2,
    /// Corners and the caller's number of each triangle, in the order of the hierarchy.
    triangles: Vec<([Vec3A; 3], u32)>,
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayMeshHit {
    /// The caller's number of the triangle.
    pub id: u32,
    /// In units of the ray direction's length.
    pub distance: f32,
}

impl RayMesh {
    /// Builds the hierarchy. Triangles without area or with a corner beyond `FAR` (or not a number) are left out, and so
    /// are repetitions: many equal boxes would slow the build down beyond measure.
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
        if kept.is_empty() {
            return RayMesh { bvh: Bvh2::default(), triangles: Vec::new() };
        }
        let shapes: Vec<Triangle> =
            kept.iter().map(|(c, _)| Triangle { v0: c[0].into(), v1: c[1].into(), v2: c[2].into() }).collect();
        let mut bvh = build_bvh2_from_tris(&shapes, BvhBuildParams::medium_build(), &mut Duration::default());
        // The slab test rounds; a box that is a little larger never loses a triangle of its own.
        for node in &mut bvh.nodes {
            let pad = Vec3A::splat(1e-6) * (1.0 + node.aabb.min.abs().max(node.aabb.max.abs()));
            node.aabb.min -= pad;
            node.aabb.max += pad;
        }
        let ordered = bvh.primitive_indices.iter().map(|&i| kept[i as usize]);
        let triangles = ordered.map(|(c, id)| (c.map(Vec3A::from), id)).collect();
        RayMesh { bvh, triangles }
    }

    /// Memory held, in bytes.
    pub fn bytes(&self) -> usize {
        self.triangles.len() * size_of::<([Vec3A; 3], u32)>() + self.bvh.nodes.len() * size_of_val(&self.bvh.nodes[..1])
    }

    /// The nearest triangle hit; of equally near ones the lowest number.
    pub fn closest(&self, origin: Vec3, direction: Vec3) -> Option<RayMeshHit> {
        let ray = usable_ray(origin, direction, f32::INFINITY)?;
        let woop = Woop::new(origin, direction);
        let mut best: Option<RayMeshHit> = None;
        self.bvh.ray_traverse(ray, &mut RayHit::none(), |_, i| {
            let (corners, id) = &self.triangles[i];
            let distance = woop.hit(corners);
            let nearer = best.is_none_or(|b| distance < b.distance || (distance == b.distance && *id < b.id));
            if distance.is_finite() && nearer {
                best = Some(RayMeshHit { id: *id, distance });
            }
            distance
        });
        best
    }

    /// Whether `stops` says yes to any triangle hit within (0, `limit`); asked in no particular order, never again after
    /// its first yes.
    pub fn any(&self, origin: Vec3, direction: Vec3, limit: f32, stops: impl Fn(u32) -> bool) -> bool {
        let Some(ray) = usable_ray(origin, direction, limit) else { return false };
        let woop = Woop::new(origin, direction);
        !self.bvh.ray_traverse_miss(ray, |_, i| {
            let (corners, id) = &self.triangles[i];
            let distance = woop.hit(corners);
            if distance < limit && stops(*id) { distance } else { f32::INFINITY }
        })
    }
}

fn usable_ray(origin: Vec3, direction: Vec3, limit: f32) -> Option<Ray> {
    let usable = origin.is_finite() && direction.is_finite() && direction != Vec3::ZERO && limit > 0.0;
    usable.then(|| Ray::new(origin.into(), direction.into(), 0.0, limit))
}

/// A ray turned so that it runs along the axis of its largest component.
struct Woop {
    origin: Vec3A,
    axes: [usize; 3],
    shear: [f32; 3],
}

impl Woop {
    fn new(origin: Vec3, direction: Vec3) -> Woop {
        let z = direction.abs().max_position();
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        if direction[z] < 0.0 {
            (x, y) = (y, x);
        }
        let inverse = 1.0 / direction[z];
        Woop {
            origin: origin.into(),
            axes: [x, y, z],
            shear: [direction[x] * inverse, direction[y] * inverse, inverse],
        }
    }

    /// Distance to the triangle in units of the direction's length; infinite when it is missed, touched edge on, or behind.
    #[inline]
    fn hit(&self, corners: &[Vec3A; 3]) -> f32 {
        let [x, y, z] = self.axes;
        let [a, b, c] = corners.map(|corner| {
            let p = corner - self.origin;
            let depth = p[z];
            [p[x] - self.shear[0] * depth, p[y] - self.shear[1] * depth, self.shear[2] * depth]
        });
        let u = c[0] * b[1] - c[1] * b[0];
        let v = a[0] * c[1] - a[1] * c[0];
        let w = b[0] * a[1] - b[1] * a[0];
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return f32::INFINITY;
        }
        let determinant = u + v + w;
        let t = (u * a[2] + v * b[2] + w * c[2]) / determinant;
        if t > 0.0 { t } else { f32::INFINITY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_thousand_equal_triangles_do_not_hang() {
        let triangle = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let mesh = RayMesh::new((0..10_000).rev().map(|id| (triangle, id)));
        let hit = mesh.closest(Vec3::new(0.2, 0.2, 1.0), Vec3::NEG_Z).unwrap();
        assert_eq!((hit.id, hit.distance), (0, 1.0));
        assert_eq!(mesh.triangles.len(), 1);
    }

    #[test]
    fn unusable_triangles_are_left_out() {
        let bad = [Vec3::NAN, Vec3::INFINITY, Vec3::splat(2.0 * FAR), Vec3::X];
        let mesh = RayMesh::new(bad.iter().map(|&p| ([Vec3::ZERO, Vec3::X, p], 0)));
        assert!(mesh.triangles.is_empty());
        assert_eq!(mesh.closest(Vec3::ZERO, Vec3::X), None);
        assert!(!mesh.any(Vec3::ZERO, Vec3::X, 1.0, |_| true));
    }

    #[test]
    fn any_respects_its_limit_and_its_question() {
        let mesh =
            RayMesh::new([([Vec3::new(-1.0, -1.0, -2.0), Vec3::new(1.0, -1.0, -2.0), Vec3::new(0.0, 2.0, -2.0)], 7)]);
        let any = |limit, stops: bool| mesh.any(Vec3::ZERO, Vec3::NEG_Z, limit, |id| id == 7 && stops);
        assert!(any(2.1, true));
        assert!(!any(1.9, true));
        assert!(!any(2.1, false));
        assert!(!mesh.any(Vec3::ZERO, Vec3::Z, 9.0, |_| true), "behind");
    }
}
