//! The luminaire: a sphere whose radiance depends on the direction, as measured.

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::form::{Form, FormSampler, PreparedForm};
use super::gradient::Gradient;
use super::photometric_web::PhotometricWeb;
use super::sphere_lamp::{PreparedSphere, SphereLamp, SphereSampler};
use crate::optics::sampling::Points2;

/// A sphere that emits by a photometric web: the radiance of an even sphere times the web's
/// relative intensity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhotometricLamp {
    /// Camera space, meters.
    pub center: Vec3,
    /// Meters.
    pub radius: f32,
    /// The relative intensity by direction.
    pub web: PhotometricWeb,
}

impl PhotometricLamp {
    /// The sphere without its web.
    fn sphere(&self) -> SphereLamp {
        SphereLamp { center: self.center, radius: self.radius }
    }

    /// The lamp with its center mapped by `position` and its lengths multiplied by `scale`.
    pub(super) fn transformed(
        &self,
        position: &dyn Fn(Vec3) -> Vec3,
        scale: f32,
    ) -> PhotometricLamp {
        PhotometricLamp {
            center: position(self.center),
            radius: self.radius * scale,
            web: self.web.clone(),
        }
    }
}

impl Form for PhotometricLamp {
    fn check(&self) -> Result<(), String> {
        self.web.table.check()
    }

    fn heap_bytes(&self) -> usize {
        self.web.table.bytes()
    }

    fn area(&self) -> f32 {
        self.sphere().area()
    }

    fn bounding_sphere(&self) -> Option<(Vec3, f32)> {
        self.sphere().bounding_sphere()
    }

    fn extent(&self, direction: Vec3) -> f32 {
        self.sphere().extent(direction)
    }

    fn intersect(&self, origin: Vec3, ray: Vec3) -> Option<f32> {
        self.sphere().intersect(origin, ray)
    }

    fn emission(&self, _: usize, direction: Vec3) -> f32 {
        self.web.relative_intensity(-direction.as_dvec3()) as f32
    }

    fn triangles(&self) -> Vec<[Vec3; 3]> {
        self.sphere().triangles()
    }

    fn surface_points(&self, count: usize) -> Vec<Vec3> {
        self.sphere().surface_points(count)
    }

    fn prepare(&self) -> Option<Box<dyn PreparedForm>> {
        let (center, web) = (self.center.as_dvec3(), self.web.clone());
        Some(Box::new(PreparedPhotometric { sphere: self.sphere().prepared()?, center, web }))
    }
}

struct PreparedPhotometric {
    sphere: PreparedSphere,
    center: DVec3,
    web: PhotometricWeb,
}

impl PreparedPhotometric {
    fn relative_intensity(&self, point: DVec3) -> f64 {
        self.web.relative_intensity((point - self.center).normalize_or_zero())
    }
}

impl PreparedForm for PreparedPhotometric {
    fn irradiance(&self, lobe: usize, point: DVec3, normal: DVec3) -> Option<f64> {
        Some(self.sphere.irradiance(lobe, point, normal)? * self.relative_intensity(point))
    }

    fn sampler_at(
        &self,
        _: usize,
        point: DVec3,
        normal: DVec3,
    ) -> Option<Box<dyn FormSampler + '_>> {
        let sphere = self.sphere.sampler(point, normal)?;
        let intensity = self.relative_intensity(point);
        (intensity > 0.0)
            .then(|| Box::new(PhotometricSampler { sphere, intensity }) as Box<dyn FormSampler>)
    }

    /// The gradient of the even sphere: luminaires come from edits, and no fit moves them.
    fn gradient(&self, lobe: usize, point: DVec3, normal: DVec3, pivot: DVec3) -> Gradient {
        self.sphere.gradient(lobe, point, normal, pivot)
    }
}

struct PhotometricSampler {
    sphere: SphereSampler,
    /// Relative intensity towards the receiver.
    intensity: f64,
}

impl FormSampler for PhotometricSampler {
    fn sample(&self, points: &Points2, i: usize) -> Option<(DVec3, f64)> {
        let (position, contribution) = self.sphere.sample(points, i)?;
        Some((position, contribution * self.intensity))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Emitter, Lamp, PhotometricWebTable, Shape, estimate};

    /// I cos / d^2 of the candela of a web, at angles of its table and between, and samples that
    /// agree.
    #[test]
    fn a_luminaire_lights_a_wall_as_its_candela_do() {
        // 100 cd straight down, 40 at 30 degrees, 10 at 60, none from 90.
        let file = "IESNA91\nTILT=NONE\n1 -1 1 4 1 1 2 0 0 0\n1 1 1\n0 30 60 90\n0\n100 40 10 0\n";
        let (table, lumens) = PhotometricWebTable::parse(file).expect("it is sound");
        let radius = 1e-3f32;
        let web = PhotometricWeb { axis: Vec3::NEG_Y, side: Vec3::X, table };
        let lamp = Lamp::Photometric(PhotometricLamp { center: Vec3::Y * 2.0, radius, web });
        // Radiance per lumen of the body, in units where a white surface under pi lux shows 1: flux
        // / (area lux).
        let lux = 500.0;
        let radiance = lumens / (f64::from(lamp.area()) * lux);
        let emitter = Emitter::new(&Shape::Lamp(lamp));
        for (degrees, candela) in [(0.0f64, 100.0), (30.0, 40.0), (60.0, 10.0), (15.0, 70.0)] {
            let point = Vec3::X * (2.0 * degrees.to_radians().tan()) as f32;
            let distance = 2.0 / degrees.to_radians().cos();
            let wanted = candela * degrees.to_radians().cos() / distance.powi(2) / lux;
            let exact = emitter.irradiance(0, point, Vec3::Y).unwrap();
            let got = f64::from(exact) * radiance;
            assert!((got / wanted - 1.0).abs() < 1e-4, "{degrees}: {got} for {wanted}");
            let (sampled, _) = estimate(&emitter, 0, (point, Vec3::Y), 4, 3, 1);
            assert!(
                (sampled / f64::from(exact) - 1.0).abs() < 1e-3,
                "{degrees}: {sampled} {exact}"
            );
        }
        assert!(emitter.sampler_at(0, Vec3::Y * 3.0, Vec3::NEG_Y).is_none(), "nothing goes up");
    }
}
