//! Bodies in the room: models that were given a place, as triangles that rays meet, and probes on
//! their surfaces.
//!
//! A bounce that meets a body needs the body's radiance there, seen by the camera or not. That is
//! computed at its **probes**: places spread evenly over its whole surface.

use std::sync::OnceLock;

use glam::{Mat3, Vec2, Vec3};
use serde::{Deserialize, Serialize};

use super::model::{Material, Model, Skin};
use crate::geometry::bounds;
use crate::geometry::bvh::rays::{FAR, RayMesh, RayMeshHit, apart};
use crate::image::{Plane, rule};
use crate::tuning::tuning;

/// A model with its place in camera space.
pub struct Body {
    /// The triangles and their materials, in camera space, meters.
    pub model: Model,
    /// Replaces the material of the file.
    pub material: Option<Material>,
}

impl Body {
    /// Turns the model by `turn`, makes it `scale` times as large and moves it: p -> turn
    /// (p - from) scale + to.
    pub fn placed(
        mut model: Model,
        material: Option<Material>,
        turn: Mat3,
        scale: f32,
        from: Vec3,
        to: Vec3,
    ) -> Body {
        model.positions.iter_mut().for_each(|p| *p = turn * (*p - from) * scale + to);
        model.normals.iter_mut().for_each(|n| *n = turn * *n);
        Body { model, material }
    }

    /// Whether part of the body reflects: it has a roughness below 1, or metal in it.
    pub fn is_shiny(&self) -> bool {
        let shiny = |material: &Material| material.roughness < 1.0 || material.metallic > 0.0;
        match &self.material {
            Some(material) => shiny(material),
            None => {
                self.model.skins.iter().any(|skin| skin.gloss.is_some() || shiny(&skin.material))
            }
        }
    }

    /// Returns the three corners of a triangle of the model, camera space, meters.
    ///
    /// # Panics
    /// The model has no such triangle.
    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.model.triangles[triangle].map(|i| self.model.positions[i as usize])
    }

    /// The place of a triangle with these weights of its corners.
    pub fn at(&self, triangle: usize, weights: Vec3) -> BodyPoint {
        let corners = self.corners(triangle);
        let flat = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or(Vec3::Y);
        let index = self.model.triangles[triangle].map(|i| i as usize);
        let mix = |of: &dyn Fn(usize) -> Vec3| (0..3).map(|k| of(k) * weights[k]).sum::<Vec3>();
        let normals = index.map(|i| self.model.normals[i]);
        let smooth = normals.iter().all(|n| *n != Vec3::ZERO);
        let normal = if smooth { mix(&|k| normals[k]).normalize_or(flat) } else { flat };
        let on = mix(&|k| corners[k]);
        // Points on the flat triangles of a smooth surface lie below it, and rays that start there
        // would meet their neighbors (Hanika, "Hacking the Shadow Terminator", Ray Tracing Gems II,
        // 2021).
        let lift = if smooth {
            mix(&|k| normals[k] * (on - corners[k]).dot(normals[k]).min(0.0))
        } else {
            Vec3::ZERO
        };
        let uvs = index.map(|i| self.model.uvs[i]);
        let uv: Vec2 = (0..3).map(|k| uvs[k] * weights[k]).sum();
        let mut material = self.material(triangle, uv);
        if self.material.is_none() && !self.model.colors.is_empty() {
            material.albedo = mix(&|k| self.model.colors[index[k]]);
        }
        BodyPoint { point: on - lift, normal, flat, material }
    }

    fn material(&self, triangle: usize, uv: Vec2) -> Material {
        let skin = self.model.skin.get(triangle).and_then(|&s| self.model.skins.get(s as usize));
        self.material.or_else(|| skin.map(|skin: &Skin| skin.at(uv))).unwrap_or(Material::PLAIN)
    }
}

impl Material {
    /// Light gray without highlights: the default material.
    pub const PLAIN: Material =
        Material { albedo: Vec3::splat(0.7), roughness: 1.0, specular: 0.5, metallic: 0.0 };
}

/// A place on a body.
pub struct BodyPoint {
    pub point: Vec3,
    /// The shading normal: of the smooth surface that the triangles approximate, towards the
    /// outside.
    pub normal: Vec3,
    /// The geometric normal of the triangle.
    pub flat: Vec3,
    pub material: Material,
}

/// The distance above a body at which rays start, meters: far more than rounding, far less than any
/// body that can be seen.
pub fn clearance(point: Vec3) -> f32 {
    BODIES.clearance * point.length().max(BODIES.min_distance)
}

/// Places spread evenly over the surfaces of all bodies, slightly above them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Probes {
    /// One row.
    pub points: Plane<Vec3>,
    /// Unit normals of the surface at `points`.
    pub normals: Plane<Vec3>,
    /// The body of each probe.
    pub body: Plane<u32>,
}

impl Probes {
    /// Returns the number of probes.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether the set of probes is empty.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

/// The triangles and probes of all bodies.
#[derive(Serialize, Deserialize)]
pub struct Bodies {
    /// Three corners a row.
    corners: Plane<Vec3>,
    /// The body of each triangle.
    body: Plane<u32>,
    probes: Probes,
    #[serde(skip)]
    rays: OnceLock<RayMesh>,
}

impl Default for Bodies {
    fn default() -> Bodies {
        Bodies::new(&[], 0).0
    }
}

impl Bodies {
    /// The bodies with `each` probes, and the material of each probe.
    pub fn new(bodies: &[Body], each: usize) -> (Bodies, Vec<Material>) {
        let (mut corners, mut body) = (Vec::new(), Vec::new());
        let (mut points, mut normals, mut on, mut materials) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (number, b) in bodies.iter().enumerate() {
            let count = b.model.triangles.len();
            corners.extend((0..count).flat_map(|t| b.corners(t)));
            body.resize(body.len() + count, number as u32);
            for (triangle, weights) in spread(b, each) {
                let place = b.at(triangle, weights);
                points.push(place.point + place.flat * clearance(place.point));
                normals.push(place.normal);
                on.push(number as u32);
                materials.push(place.material);
            }
        }
        let (triangles, count) = (body.len(), points.len());
        let probes = Probes {
            points: Plane::new(count, 1, points),
            normals: Plane::new(count, 1, normals),
            body: Plane::new(count, 1, on),
        };
        let corners = Plane::new(3, triangles, corners);
        (
            Bodies { corners, body: Plane::new(1, triangles, body), probes, rays: OnceLock::new() },
            materials,
        )
    }

    /// Whether all rows have their number of entries.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub(in crate::geometry) fn check(&self) -> Result<(), String> {
        let Probes { points, normals, body } = &self.probes;
        rule(self.corners.len() == 3 * self.body.len(), "three corners for each triangle")?;
        rule(self.corners.is_empty() || self.corners.width() == 3, "three corners a row")?;
        rule(self.body.pixels().is_sorted(), "the triangles of one body after those of another")?;
        rule(
            points.len() == normals.len() && points.len() == body.len(),
            "a normal and a body for each probe",
        )
    }

    /// Whether the set of bodies is empty.
    pub fn is_empty(&self) -> bool {
        self.body.is_empty()
    }

    /// Returns the probes on the surfaces of all bodies.
    pub fn probes(&self) -> &Probes {
        &self.probes
    }

    /// Memory held, in bytes, with the hierarchy counted as if it were built.
    pub fn bytes(&self) -> usize {
        let probes =
            self.probes.points.bytes() + self.probes.normals.bytes() + self.probes.body.bytes();
        self.corners.bytes() + self.body.bytes() + probes + 80 * self.body.len()
    }

    /// The triangle as a ray meets it.
    pub fn triangle(&self, id: u32) -> [Vec3; 3] {
        [0, 1, 2].map(|k| self.corners.get(k, id as usize))
    }

    /// The body that a triangle belongs to, and its number among the triangles of that body.
    pub fn owner(&self, id: u32) -> (usize, usize) {
        let body = self.body.pixels()[id as usize];
        let first = self.body.pixels().partition_point(|&b| b < body);
        (body as usize, id as usize - first)
    }

    fn rays(&self) -> &RayMesh {
        let build = || RayMesh::new((0..self.body.len() as u32).map(|id| (self.triangle(id), id)));
        self.rays.get_or_init(|| apart(build))
    }

    /// The nearest triangle that a ray of unit `direction` meets, from either side.
    pub fn closest(&self, origin: Vec3, direction: Vec3) -> Option<RayMeshHit> {
        if self.is_empty() { None } else { self.rays().closest(origin, direction) }
    }

    /// Whether a body stands between two places; the last thousandth of the way does not count.
    pub fn between(&self, from: Vec3, to: Vec3) -> bool {
        !self.is_empty() && self.rays().any(from, to - from, BODIES.shadow_end, |_| true)
    }

    /// The probe that represents triangle `id` best at `place` for a ray along `direction`.
    pub fn nearest_probe(&self, id: u32, place: Vec3, direction: Vec3) -> usize {
        let [a, b, c] = self.triangle(id);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let facing = if normal.dot(direction) > 0.0 { -normal } else { normal };
        let (range, size) = self.probes_of(self.body.pixels()[id as usize]);
        let far = |i: usize| {
            let apart = self.probes.points.pixels()[i].distance_squared(place) / size.max(1e-12);
            apart + BODIES.normal_distance * (1.0 - self.probes.normals.pixels()[i].dot(facing))
        };
        let nearer =
            |best: (f32, usize), i: usize| if far(i) < best.0 { (far(i), i) } else { best };
        range.fold((f32::INFINITY, 0), nearer).1
    }

    /// Around each body that has a surface a ball: which body, its middle and its radius.
    pub fn balls(&self) -> Vec<(usize, Vec3, f32)> {
        let mut balls = Vec::new();
        let mut first = 0;
        for of in self.body.pixels().chunk_by(|a, b| a == b) {
            let corners = &self.corners.pixels()[3 * first..3 * (first + of.len())];
            first += of.len();
            let (low, high) = bounds(corners.iter().copied());
            let middle = 0.5 * (low + high);
            let radius = corners.iter().map(|p| p.distance(middle)).fold(0.0, f32::max);
            if middle.is_finite() && radius > 0.0 && radius.is_finite() {
                balls.push((of[0] as usize, middle, radius));
            }
        }
        balls
    }

    /// The probes of one body, and the square of its half diagonal.
    pub fn probes_of(&self, body: u32) -> (std::ops::Range<usize>, f32) {
        let all = self.probes.body.pixels();
        let range = all.partition_point(|&b| b < body)..all.partition_point(|&b| b <= body);
        let points = &self.probes.points.pixels()[range.clone()];
        let (low, high) = bounds(points.iter().copied());
        (range, 0.25 * (high - low).max(Vec3::ZERO).length_squared())
    }
}

tuning! {
    /// Constants of bodies put into the room.
    pub const BODIES: BodiesTuning {
        /// Squared distance that a right angle between two normals counts for, where the nearest
        /// probe is sought.
        normal_distance: f32 = 2.0,
            unit "squares of half the body's diagonal", source Taste,
            effect "a larger value prefers probes of the same orientation";
        /// Distance above a body at which rays start: far more than rounding, far less than any
        /// visible body.
        clearance: f32 = 2e-5,
            unit "fraction of the distance from the camera", source Derived("single precision"),
            effect "a larger value lets light through at contacts";
        /// Least distance from the camera of which `clearance` is a fraction.
        min_distance: f32 = 1e-3,
            unit "meters", source Derived("single precision"), effect "a larger value raises rays near the camera";
        /// End of a shadow ray before its light.
        shadow_end: f32 = 0.999,
            unit "the ray's length", source Derived("single precision"),
            effect "a larger value may let a light on a surface be blocked by it";
    }
}

/// `count` places on a body, evenly by area: a triangle and the weights of its corners.
fn spread(body: &Body, count: usize) -> Vec<(usize, Vec3)> {
    let area = |t: usize| {
        let [a, b, c] = body.corners(t);
        let sound = [a, b, c].iter().all(|p| p.abs().max_element() <= FAR);
        if sound { f64::from((b - a).cross(c - a).length()) } else { 0.0 }
    };
    let sums: Vec<f64> = (0..body.model.triangles.len())
        .scan(0.0, |sum, t| {
            *sum += area(t);
            Some(*sum)
        })
        .collect();
    let whole = sums.last().copied().unwrap_or(0.0);
    if whole.is_nan() || whole <= 0.0 {
        return Vec::new();
    }
    let place = |i: usize| {
        let target = (i as f64 + 0.5) / count as f64 * whole;
        let triangle = sums.partition_point(|&sum| sum <= target).min(sums.len() - 1);
        // The plastic sequence: Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences",
        // 2018.
        let (u, v) =
            ((0.5 + 0.754_877_67 * i as f64).fract(), (0.5 + 0.569_840_29 * i as f64).fract());
        let (root, v) = (u.sqrt() as f32, v as f32);
        (triangle, Vec3::new(1.0 - root, root * (1.0 - v), root * v))
    };
    (0..count).map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ball(center: Vec3, radius: f32) -> Body {
        Body::placed(Model::sphere(), None, Mat3::IDENTITY, radius, Vec3::ZERO, center)
    }

    #[test]
    fn probes_lie_evenly_on_the_surface() {
        let (bodies, materials) = Bodies::new(&[ball(Vec3::new(0.0, 0.0, -3.0), 0.5)], 400);
        let probes = bodies.probes();
        assert_eq!((probes.len(), materials.len()), (400, 400));
        let center = Vec3::new(0.0, 0.0, -3.0);
        for (p, n) in probes.points.pixels().iter().zip(probes.normals.pixels()) {
            assert!(
                (p.distance(center) - 0.5).abs() < 1e-3 && n.dot((p - center).normalize()) > 0.999
            );
        }
        let mean = probes.normals.pixels().iter().sum::<Vec3>() / 400.0;
        assert!(mean.length() < 0.03, "{mean}");
    }

    #[test]
    fn rays_meet_bodies_and_find_the_near_probe() {
        let (bodies, _) = Bodies::new(
            &[ball(Vec3::new(-1.0, 0.0, -3.0), 0.5), ball(Vec3::new(1.0, 0.0, -3.0), 0.5)],
            300,
        );
        let to = Vec3::new(1.0, 0.0, -3.0).normalize();
        let hit = bodies.closest(Vec3::ZERO, to).expect("it is met");
        assert!((hit.distance - (10.0f32.sqrt() - 0.5)).abs() < 1e-3);
        assert_eq!(bodies.owner(hit.id).0, 1);
        let probe = bodies.nearest_probe(hit.id, to * hit.distance, to);
        assert!(bodies.probes().points.pixels()[probe].distance(to * hit.distance) < 0.12);
        let balls = bodies.balls();
        assert_eq!(balls.len(), 2);
        assert!(
            balls[1].0 == 1
                && balls[1].1.distance(Vec3::new(1.0, 0.0, -3.0)) < 1e-3
                && (balls[1].2 - 0.5).abs() < 1e-3
        );
        assert!(bodies.between(Vec3::ZERO, to * 4.0) && !bodies.between(Vec3::ZERO, to * 2.6));
        assert!(!Bodies::default().between(Vec3::ZERO, to));
    }

    #[test]
    fn places_of_a_coarse_ball_lie_on_or_above_the_ball() {
        let body = ball(Vec3::ZERO, 2.0);
        for triangle in (0..body.model.triangles.len()).step_by(97) {
            let radius = body.at(triangle, Vec3::splat(1.0 / 3.0)).point.length();
            assert!((1.9999..2.002).contains(&radius), "{radius}");
        }
    }
}
