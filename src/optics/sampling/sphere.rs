//! Irradiance from a sphere of uniform radiance, and directions into the cone that it fills.

use std::f64::consts::PI;

use glam::DVec3;

/// The irradiance over pi, E / L = (1/pi) integral of cos(theta) over the sphere's part above the
/// horizon of `normal`, 0..=1.
///
/// `center` is relative to the shaded point, meters. Wholly above the horizon this is sin^2(sigma)
/// cos(theta), with sigma the half angle that the sphere subtends; where the horizon cuts it:
/// Snyder, "Area Light Sources for Real-Time Graphics", MSR-TR-96-11 (1996), as written by Lagarde
/// and de Rousiers, "Moving Frostbite to PBR" (2014). Zero inside.
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

/// The cone of directions that a sphere fills, above the horizon.
#[derive(Clone, Copy)]
pub struct Cone {
    center: DVec3,
    radius: f64,
    /// Axis, the direction across it that points up most, and the third.
    axes: [DVec3; 3],
    /// Cosine and sine of the angle between normal and axis.
    incline: [f64; 2],
    /// Least and largest 1 - cos of the angle from the axis: the horizon and the boundary of the
    /// cone; exact for small cones.
    heights: [f64; 2],
}

impl Cone {
    /// The cone of a sphere relative to the receiver, lengths in meters; `None` inside the sphere,
    /// for one without size, or below the horizon of `normal`.
    pub fn new(center: DVec3, radius: f64, normal: DVec3) -> Option<Cone> {
        let distance_squared = center.length_squared();
        let sin2 = radius * radius / distance_squared;
        if !(sin2 > 0.0 && sin2 < 1.0) {
            return None;
        }
        let axis = center / distance_squared.sqrt();
        let boundary = sin2 / (1.0 + (1.0 - sin2).sqrt());
        let cos = normal.dot(axis);
        let across = normal - cos * axis;
        let sin = across.length();
        let up = across.try_normalize().unwrap_or_else(|| axis.any_orthonormal_vector());
        // With the axis below the horizon, only directions that are at least as far from it as the
        // horizon.
        let begin = if cos < 0.0 { cos * cos / (1.0 + sin) } else { 0.0 };
        let axes = [axis, up, axis.cross(up)];
        (begin < boundary).then_some(Cone {
            center,
            radius,
            axes,
            incline: [cos, sin],
            heights: [begin, boundary],
        })
    }

    /// A direction above the horizon, the position on the sphere in that direction, and one over
    /// the density per steradian, from a point of the unit square.
    pub fn sample(&self, [u, v]: [f64; 2]) -> (DVec3, DVec3, f64) {
        let ([begin, boundary], [c, s]) = (self.heights, self.incline);
        let t = begin + u * (boundary - begin);
        let sin = (t * (2.0 - t)).max(0.0).sqrt();
        // The azimuths with (1 - t) c + sin s cos(phi) > 0.
        let (level, swing) = ((1.0 - t) * c, sin * s);
        let most = if level >= swing { PI } else { (-level / swing).clamp(-1.0, 1.0).acos() };
        let (sin_phi, cos_phi) = ((2.0 * v - 1.0) * most).sin_cos();
        let [axis, up, third] = self.axes;
        let direction = (1.0 - t) * axis + sin * (cos_phi * up + sin_phi * third);
        let along = direction.dot(self.center);
        let inside = self.radius * self.radius - (self.center - along * direction).length_squared();
        (direction, direction * (along - inside.max(0.0).sqrt()), 2.0 * most * (boundary - begin))
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
        // Center on the horizon, small sphere: a half disc of area pi sigma^2 / 2 whose mean sine
        // is 4 sigma / (3 pi).
        let sigma = 1e-3;
        let half = sphere_irradiance(DVec3::X, sigma, DVec3::Z);
        assert!((half / (2.0 * sigma.powi(3) / (3.0 * PI)) - 1.0).abs() < 1e-3, "{half}");
    }

    #[test]
    fn cone_samples_average_to_the_closed_form() {
        let n = 400;
        for height in [1.0, 0.5, 0.2, 0.0, -0.2] {
            let center = DVec3::new(0.8, 0.3, height);
            let cone = Cone::new(center, 0.5, DVec3::Z).unwrap();
            let mut sum = 0.0;
            for i in 0..n * n {
                let uv = [((i % n) as f64 + 0.5) / n as f64, ((i / n) as f64 + 0.5) / n as f64];
                let (direction, position, inverse) = cone.sample(uv);
                assert!(
                    ((position - center).length() - 0.5).abs() < 1e-9
                        && (direction.length() - 1.0).abs() < 1e-12
                );
                assert!(direction.z > -1e-12, "below the horizon");
                sum += direction.z * inverse;
            }
            let sampled = sum / (n * n) as f64 / PI;
            let exact = sphere_irradiance(center, 0.5, DVec3::Z);
            // The midpoint rule's error on a kinked integrand is O(1/n^2).
            assert!(
                (sampled - exact).abs() < 1e-4 * exact.max(0.01),
                "{height}: {sampled} {exact}"
            );
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
