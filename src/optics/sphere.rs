//! Irradiance from a sphere of uniform radiance, and directions into the cone it fills.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

/// E / L = (1/pi) integral of cos(theta) over the sphere's part above the horizon of `normal`.
///
/// `center` is relative to the shaded point. Wholly above the horizon this is sin^2(sigma) cos(theta), with sigma the
/// half angle under which the sphere is seen; where the horizon cuts it: Snyder, "Area Light Sources for Real-Time
/// Graphics", MSR-TR-96-11 (1996), as written by Lagarde and de Rousiers, "Moving Frostbite to PBR" (2014). Zero inside.
pub fn sphere_irradiance(center: DVec3, radius: f64, normal: DVec3) -> f64 {
    let distance_squared = center.length_squared();
    let sin2 = radius * radius / distance_squared;
    if !(sin2 > 0.0 && sin2 < 1.0) {
        return 0.0;
    }
    let cos = (normal.dot(center) / distance_squared.sqrt()).clamp(-1.0, 1.0);
    if cos * cos >= sin2 {
        return sin2 * cos.max(0.0);
    }
    let sin = (1.0 - cos * cos).sqrt();
    let cot_sigma = (1.0 / sin2 - 1.0).sqrt();
    let y = (-cot_sigma * cos / sin).clamp(-1.0, 1.0);
    let z = sin * (1.0 - y * y).sqrt();
    (((cos * y.acos() - cot_sigma * z) * sin2 + (z / cot_sigma).atan()) / PI).max(0.0)
}

/// The cone of directions that a sphere fills.
#[derive(Clone, Copy)]
pub struct Cone {
    center: DVec3,
    radius: f64,
    axis: DVec3,
    /// 1 - cos of the half angle, exact for small cones.
    height: f64,
}

impl Cone {
    /// `None` when the point (the origin) is inside the sphere or the sphere has no size.
    pub fn new(center: DVec3, radius: f64) -> Option<Cone> {
        let distance_squared = center.length_squared();
        let sin2 = radius * radius / distance_squared;
        (sin2 > 0.0 && sin2 < 1.0).then(|| Cone {
            center,
            radius,
            axis: center / distance_squared.sqrt(),
            height: sin2 / (1.0 + (1.0 - sin2).sqrt()),
        })
    }

    /// Steradians.
    pub fn solid_angle(&self) -> f64 {
        TAU * self.height
    }

    /// A direction, uniform over the cone, and the place on the sphere that is seen there.
    pub fn sample(&self, [u, v]: [f64; 2]) -> (DVec3, DVec3) {
        let t = u * self.height;
        let sin = (t * (2.0 - t)).sqrt();
        let (x, y) = self.axis.any_orthonormal_pair();
        let (sin_phi, cos_phi) = (TAU * v).sin_cos();
        let direction = (1.0 - t) * self.axis + sin * (cos_phi * x + sin_phi * y);
        let along = direction.dot(self.center);
        let inside = self.radius * self.radius - (self.center - along * direction).length_squared();
        (direction, direction * (along - inside.max(0.0).sqrt()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cutting_the_horizon_is_continuous_and_halves_at_it() {
        let at = |height: f64| sphere_irradiance(DVec3::new(1.0, 0.0, height), 0.4, DVec3::Z);
        // The horizon touches where cos(theta) = sin(sigma).
        let touching = 0.4 / (1.0f64 - 0.16).sqrt();
        assert!((at(touching + 1e-6) - at(touching - 1e-6)).abs() < 1e-5);
        assert!(at(-touching - 1e-6) == 0.0 && at(-touching + 1e-6) < 1e-6);
        // Centre on the horizon, small sphere: a half disc of area pi sigma^2 / 2 whose mean sine is 4 sigma / (3 pi).
        let sigma = 1e-3;
        let half = sphere_irradiance(DVec3::X, sigma, DVec3::Z);
        assert!((half / (2.0 * sigma.powi(3) / (3.0 * PI)) - 1.0).abs() < 1e-3, "{half}");
    }

    #[test]
    fn cone_samples_average_to_the_closed_form() {
        let n = 400;
        for height in [1.0, 0.5, 0.2, 0.0, -0.2] {
            let center = DVec3::new(0.8, 0.3, height);
            let cone = Cone::new(center, 0.5).unwrap();
            let mut sum = 0.0;
            for i in 0..n * n {
                let uv = [((i % n) as f64 + 0.5) / n as f64, ((i / n) as f64 + 0.5) / n as f64];
                let (direction, place) = cone.sample(uv);
                assert!(((place - center).length() - 0.5).abs() < 1e-9 && (direction.length() - 1.0).abs() < 1e-12);
                sum += direction.z.max(0.0);
            }
            let sampled = sum / (n * n) as f64 * cone.solid_angle() / PI;
            let exact = sphere_irradiance(center, 0.5, DVec3::Z);
            // The midpoint rule's error on a kinked integrand is O(1/n^2).
            assert!((sampled - exact).abs() < 1e-4 * exact.max(0.01), "{height}: {sampled} {exact}");
        }
    }

    #[test]
    fn extremes_are_finite() {
        for center in [DVec3::ZERO, DVec3::splat(1e-30), DVec3::splat(1e30), DVec3::Z] {
            for radius in [0.0, 1e-30, 1.0, 1e30, f64::NAN] {
                let e = sphere_irradiance(center, radius, DVec3::Z);
                assert!((0.0..=1.0).contains(&e), "{center} {radius} {e}");
            }
        }
    }
}
