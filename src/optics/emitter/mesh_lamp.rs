//! The mesh: a lamp of any form, from a model or a file of lights.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::form::{Form, FormSampler, Intersector, PreparedForm};
use super::gradient::{Gradient, outline_gradient};
use super::mesh_clusters::{ClusteredMesh, escaping, intersector};
use super::pieces::{
    PIECES, PieceChoice, PieceSet, bounding_sphere, doubled_area, extent, point_in_triangle,
};
use crate::image::rule;
use crate::optics::sampling::Points2;
use crate::optics::sampling::polygon::{Outline, polygon_irradiance};
use crate::tuning::tuning;

/// Triangles that emit from the side where their corners run counter-clockwise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeshLamp {
    /// Camera space, meters.
    pub corners: Vec<Vec3>,
    /// Indices into `corners`.
    pub triangles: Vec<[u32; 3]>,
    /// True where triangles may hide each other from a receiver. False where they count as if none
    /// did, which is exact for convex bodies.
    pub self_occluding: bool,
}

impl MeshLamp {
    /// The mesh of a body of any form, whose triangles hide each other.
    pub fn new(corners: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> MeshLamp {
        MeshLamp { corners, triangles, self_occluding: true }
    }

    /// The mesh whose triangles all count as visible: exact for convex bodies, and without noise.
    pub fn without_occlusion(corners: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> MeshLamp {
        MeshLamp { corners, triangles, self_occluding: false }
    }

    /// The mesh with its corners mapped by `position`.
    pub(super) fn transformed(&self, position: &dyn Fn(Vec3) -> Vec3) -> MeshLamp {
        MeshLamp { corners: self.corners.iter().map(|p| position(*p)).collect(), ..self.clone() }
    }

    /// The triangles in double precision, without those that have a corner that is missing or not
    /// finite.
    fn finite_triangles(&self) -> impl Iterator<Item = [DVec3; 3]> {
        let corner =
            |i: u32| self.corners.get(i as usize).filter(|p| p.is_finite()).map(|p| p.as_dvec3());
        self.triangles
            .iter()
            .filter_map(move |&[a, b, c]| Some([corner(a)?, corner(b)?, corner(c)?]))
    }

    /// [`MeshLamp::finite_triangles`] without degenerate triangles.
    fn valid_triangles(&self) -> Vec<[DVec3; 3]> {
        self.finite_triangles().filter(|t| doubled_area(t).length() > 0.0).collect()
    }

    /// True if no triangle lies before the plane of another, to `TUNING.convex`; the time is
    /// quadratic in the triangles.
    fn is_convex(&self) -> bool {
        let triangles = self.valid_triangles();
        let points = || triangles.iter().flatten();
        let outer = |(low, high): (DVec3, DVec3), &p: &DVec3| (low.min(p), high.max(p));
        let (low, high) = points().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), outer);
        let slack = TUNING.convex * (high - low).length();
        let behind = |t: &[DVec3; 3]| {
            let normal = doubled_area(t).normalize();
            points().all(|&p| normal.dot(p - t[0]) <= slack)
        };
        triangles.iter().all(behind)
    }
}

tuning! {
    /// Constants of lamps that are meshes.
    pub const TUNING: MeshLampTuning {
        /// Largest height over the plane of a triangle in a convex body.
        convex: f64 = 1e-3,
            unit "the diagonal of the body", source Taste,
            effect "a larger value lets more bodies have a closed form, with a larger error";
    }
}

impl Form for MeshLamp {
    fn check(&self) -> Result<(), String> {
        let known =
            self.triangles.iter().flatten().all(|&corner| (corner as usize) < self.corners.len());
        rule(known && !self.triangles.is_empty(), "triangles of corners that are there")
    }

    fn heap_bytes(&self) -> usize {
        size_of_val(self.corners.as_slice()) + size_of_val(self.triangles.as_slice())
    }

    fn area(&self) -> f32 {
        let triangles = self.triangles.iter().map(|t| t.map(|i| self.corners[i as usize]));
        triangles.map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length()).sum()
    }

    fn bounding_sphere(&self) -> Option<(Vec3, f32)> {
        bounding_sphere(self.corners.iter().copied())
    }

    fn extent(&self, direction: Vec3) -> f32 {
        extent(self.corners.iter().copied(), direction)
    }

    fn intersect(&self, origin: Vec3, ray: Vec3) -> Option<f32> {
        let hits = self.triangles.iter().filter_map(|t| {
            let [a, b, c] = t.map(|i| self.corners[i as usize] - origin);
            let normal = (b - a).cross(c - a);
            let facing = normal.dot(ray);
            let t = normal.dot(a) / facing;
            let at = ray * t;
            let inside = [(a, b), (b, c), (c, a)]
                .iter()
                .all(|(p, q)| (q - p).cross(at - p).dot(normal) >= 0.0);
            (facing < 0.0 && t > 0.0 && inside).then_some(t)
        });
        hits.reduce(f32::min)
    }

    fn intersector(&self) -> Intersector<'_> {
        if self.self_occluding {
            intersector(self.valid_triangles())
        } else {
            Box::new(|origin, ray| self.intersect(origin, ray))
        }
    }

    fn escaping(&self) -> f32 {
        if self.self_occluding { escaping(&self.valid_triangles()) } else { 1.0 }
    }

    fn triangles(&self) -> Vec<[Vec3; 3]> {
        self.triangles.iter().map(|t| t.map(|i| self.corners[i as usize])).collect()
    }

    fn prepare(&self) -> Option<Box<dyn PreparedForm>> {
        if self.self_occluding && (self.triangles.len() > PIECES.max_exact || !self.is_convex()) {
            return Some(Box::new(ClusteredMesh::new(&self.valid_triangles())?));
        }
        let areas = self.finite_triangles().map(|t| (t, 0.5 * doubled_area(&t).length()));
        Some(Box::new(PreparedTriangles(PieceSet::new(areas))))
    }
}

/// Triangles of which none covers another.
struct PreparedTriangles(PieceSet<[DVec3; 3]>);

impl PreparedForm for PreparedTriangles {
    fn irradiance(&self, _: usize, point: DVec3, normal: DVec3) -> Option<f64> {
        Some(self.0.few()?.iter().map(|t| irradiance(t, point, normal)).sum())
    }

    fn sampler_at(
        &self,
        _: usize,
        point: DVec3,
        normal: DVec3,
    ) -> Option<Box<dyn FormSampler + '_>> {
        let choice = self.0.choice(|t| irradiance(t, point, normal))?;
        Some(Box::new(TriangleSampler { point, normal, choice }))
    }

    fn gradient(&self, _: usize, point: DVec3, normal: DVec3, pivot: DVec3) -> Gradient {
        let facing = self.0.pieces.iter().filter(|t| faces(t, point));
        let outlines =
            facing.filter_map(|t| Outline::above(&t.map(|corner| corner - point), normal));
        outlines
            .map(|outline| outline_gradient(&outline, normal, pivot))
            .fold(Gradient::default(), Gradient::plus)
    }
}

/// True if the emitting side of a triangle faces `point`.
fn faces(t: &[DVec3; 3], point: DVec3) -> bool {
    doubled_area(t).dot(point - t[0]) > 0.0
}

fn irradiance(t: &[DVec3; 3], point: DVec3, normal: DVec3) -> f64 {
    if faces(t, point) { polygon_irradiance(&t.map(|corner| corner - point), normal) } else { 0.0 }
}

struct TriangleSampler<'a> {
    point: DVec3,
    normal: DVec3,
    choice: PieceChoice<'a, [DVec3; 3]>,
}

impl FormSampler for TriangleSampler<'_> {
    fn sample(&self, points: &Points2, i: usize) -> Option<(DVec3, f64)> {
        let [x, y] = points.get(i);
        let (t, inverse, u) = self.choice.at(x);
        let position = point_in_triangle(t, u.sqrt(), y);
        // `front` is as long as twice the area of the triangle.
        let (d, front) = (position - self.point, doubled_area(t));
        let cosines = self.normal.dot(d).max(0.0) * -front.dot(d);
        Some((position, 0.5 * cosines / (PI * d.length_squared().powi(2)) * inverse))
    }
}
