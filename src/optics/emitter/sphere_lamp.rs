//! The sphere: a globe or a bulb.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::form::{Form, FormSampler, PreparedForm};
use super::gradient::Gradient;
use crate::optics::sampling::Points2;
use crate::optics::sampling::sphere::{Cone, sphere_irradiance};

/// A sphere that emits outwards.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SphereLamp {
    /// Camera space, meters.
    pub center: Vec3,
    /// Meters.
    pub radius: f32,
}

impl SphereLamp {
    /// The sphere in double precision; `None` without a positive, finite size.
    pub(super) fn prepared(&self) -> Option<PreparedSphere> {
        let SphereLamp { center, radius } = self;
        let valid = center.is_finite() && radius.is_finite() && *radius > 0.0;
        valid.then(|| PreparedSphere { center: center.as_dvec3(), radius: f64::from(*radius) })
    }

    /// The sphere with its center mapped by `position` and its lengths multiplied by `scale`.
    pub(super) fn transformed(&self, position: &dyn Fn(Vec3) -> Vec3, scale: f32) -> SphereLamp {
        SphereLamp { center: position(self.center), radius: self.radius * scale }
    }
}

impl Form for SphereLamp {
    fn area(&self) -> f32 {
        let radius = self.radius;
        4.0 * std::f32::consts::PI * radius * radius
    }

    fn bounding_sphere(&self) -> Option<(Vec3, f32)> {
        Some((self.center, self.radius))
    }

    fn extent(&self, _: Vec3) -> f32 {
        self.radius
    }

    fn intersect(&self, origin: Vec3, ray: Vec3) -> Option<f32> {
        let radius = self.radius;
        let center = self.center - origin;
        let (a, b, c) =
            (ray.length_squared(), ray.dot(center), center.length_squared() - radius * radius);
        let root = b * b - a * c;
        let t = (b - root.max(0.0).sqrt()) / a;
        (root >= 0.0 && t > 0.0).then_some(t)
    }

    /// None: a sphere is not made of triangles.
    fn triangles(&self) -> Vec<[Vec3; 3]> {
        Vec::new()
    }

    fn surface_points(&self, count: usize) -> Vec<Vec3> {
        (0..count).map(|k| self.center + self.radius * spiral(k, count)).collect()
    }

    fn prepare(&self) -> Option<Box<dyn PreparedForm>> {
        Some(Box::new(self.prepared()?))
    }
}

/// The k-th of `count` points on the unit sphere, along the spiral of the golden angle, 2.4
/// radians.
fn spiral(k: usize, count: usize) -> Vec3 {
    let z = 1.0 - (k as f32 + 0.5) / count as f32 * 2.0;
    let (sin, cos) = (k as f32 * 2.399_963).sin_cos();
    let r = (1.0 - z * z).sqrt();
    Vec3::new(r * cos, r * sin, z)
}

/// A sphere of positive, finite size in double precision.
pub(super) struct PreparedSphere {
    pub center: DVec3,
    pub radius: f64,
}

impl PreparedSphere {
    /// The sampler for one receiver; `None` where nothing arrives.
    pub fn sampler(&self, point: DVec3, normal: DVec3) -> Option<SphereSampler> {
        Some(SphereSampler {
            point,
            normal,
            cone: Cone::new(self.center - point, self.radius, normal)?,
        })
    }
}

impl PreparedForm for PreparedSphere {
    fn irradiance(&self, _: usize, point: DVec3, normal: DVec3) -> Option<f64> {
        Some(sphere_irradiance(self.center - point, self.radius, normal))
    }

    fn sampler_at(
        &self,
        _: usize,
        point: DVec3,
        normal: DVec3,
    ) -> Option<Box<dyn FormSampler + '_>> {
        Some(Box::new(self.sampler(point, normal)?))
    }

    fn gradient(&self, _: usize, point: DVec3, normal: DVec3, pivot: DVec3) -> Gradient {
        gradient(self.center - point, self.radius, normal, pivot)
    }
}

/// A sampler of the cone that a sphere fills.
pub(super) struct SphereSampler {
    point: DVec3,
    normal: DVec3,
    cone: Cone,
}

impl FormSampler for SphereSampler {
    fn sample(&self, points: &Points2, i: usize) -> Option<(DVec3, f64)> {
        let (direction, position, inverse) = self.cone.sample(points.get(i));
        Some((self.point + position, self.normal.dot(direction) * inverse / PI))
    }
}

/// The gradient of a sphere with its center relative to the receiver, sigma its half angle, theta
/// the angle of its center from the normal.
///
/// With the boundary above the horizon for azimuths within phi, cos(phi) = -cot(sigma) cot(theta),
/// its integral of cos gives dE / d sigma = 2 sin(sigma) (cos(sigma) cos(theta) phi + sin(sigma)
/// sin(theta) sin(phi)) / pi, and the vector irradiance, half the contour integral of the inward
/// normal, gives dE / d theta = -sin(sigma) (sin(sigma) sin(theta) phi + cos(sigma) cos(theta)
/// sin(phi)) / pi.
fn gradient(center: DVec3, radius: f64, normal: DVec3, pivot: DVec3) -> Gradient {
    let value = sphere_irradiance(center, radius, normal);
    if value == 0.0 {
        return Gradient::default();
    }
    let distance = center.length();
    let axis = center / distance;
    let sin_sigma = radius / distance;
    let cos_sigma = (1.0 - sin_sigma * sin_sigma).sqrt();
    let cos = normal.dot(axis).clamp(-1.0, 1.0);
    let across = normal - cos * axis;
    let sin = across.length();
    let phi = if cos >= sin_sigma {
        PI
    } else {
        (-cos_sigma / sin_sigma * cos / sin).clamp(-1.0, 1.0).acos()
    };
    let by_sigma = 2.0 * sin_sigma / PI * (cos_sigma * cos * phi + sin_sigma * sin * phi.sin());
    let by_theta = -sin_sigma / PI * (sin_sigma * sin * phi + cos_sigma * cos * phi.sin());
    let towards = across.try_normalize().unwrap_or(DVec3::ZERO);
    // sin(sigma) = radius / distance; a center that moves towards the normal lowers theta.
    let by_distance = -by_sigma * sin_sigma / (distance * cos_sigma);
    let position = axis * by_distance - towards * (by_theta / distance);
    let size = by_sigma * sin_sigma / cos_sigma + position.dot(center - pivot);
    Gradient { value, position, size, ..Gradient::default() }
}
