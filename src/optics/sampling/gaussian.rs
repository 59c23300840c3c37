//! Spherical Gaussians of unit weight, and directions distributed like them.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use crate::tuning::tuning;

/// A spherical Gaussian of unit weight: G(l) = exp(bandwidth (direction . l - 1)).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lobe {
    /// The direction of the peak: unit length, from the scene to the light.
    pub direction: Vec3,
    /// The sharpness, 0 or more: 0 is uniform, about 1e5 the sun's disc.
    pub bandwidth: f32,
}

impl Lobe {
    /// Irradiance / pi of the lobe, of radiance 1 at its peak, on a surface with this unit
    /// `normal`, all light taken to come from the peak: within 1 % for a sun 20 degrees above the
    /// surface.
    pub fn distant_irradiance(&self, normal: Vec3) -> f32 {
        let cosine = self.direction.dot(normal).max(0.0);
        cosine * (Gaussian::new(self).solid_angle() / std::f64::consts::PI) as f32
    }
}

/// A [`Lobe`] in 64 bits, since a bandwidth of 1e7 multiplies every rounding error.
#[derive(Clone, Copy)]
pub struct Gaussian {
    /// Unit length.
    pub(in crate::optics) direction: DVec3,
    /// 0..=`GAUSSIAN.max_bandwidth`.
    pub(in crate::optics) bandwidth: f64,
    /// 1 - exp(-2 bandwidth).
    span: f64,
}

tuning! {
    /// Constants of spherical Gaussians.
    pub const GAUSSIAN: GaussianTuning {
        /// Largest bandwidth: a lobe of it is a direction to all digits of 64 bits.
        max_bandwidth: f64 = 1e12,
            unit "1", source Taste, effect "a larger value loses digits";
        /// Bandwidth below which a lobe counts as uniform.
        uniform_bandwidth: f64 = 1e-9,
            unit "1", source Derived("half of it is the relative error, below the rounding of 64 bits"),
            effect "a larger value makes broad lobes less exact";
    }
}

impl Gaussian {
    /// The lobe in 64 bits. A direction without length counts as "up"; a bandwidth below zero or
    /// not a number as zero.
    pub fn new(lobe: &Lobe) -> Gaussian {
        let bandwidth = f64::from(lobe.bandwidth).clamp(0.0, GAUSSIAN.max_bandwidth);
        let bandwidth = if bandwidth.is_nan() { 0.0 } else { bandwidth };
        let direction = lobe.direction.as_dvec3().try_normalize().unwrap_or(DVec3::Y);
        Gaussian { direction, bandwidth, span: -(-2.0 * bandwidth).exp_m1() }
    }

    /// The value of G in the unit direction `l`, 0..=1. d . l - 1 = -|d - l|^2 / 2 loses nothing
    /// where the two are close.
    pub fn value(&self, l: DVec3) -> f64 {
        (-0.5 * self.bandwidth * (self.direction - l).length_squared()).exp()
    }

    /// The integral of G over all directions: 2 pi (1 - exp(-2 bandwidth)) / bandwidth, steradians.
    pub fn solid_angle(&self) -> f64 {
        if self.bandwidth < GAUSSIAN.uniform_bandwidth {
            2.0 * TAU
        } else {
            TAU * self.span / self.bandwidth
        }
    }

    /// The density, per steradian, of [`Gaussian::sample`] where G is `value` (von Mises and
    /// Fisher).
    pub fn pdf(&self, value: f64) -> f64 {
        value / self.solid_angle()
    }

    /// A unit direction with density proportional to G, from a point of the unit square.
    ///
    /// The cosine is inverted as 1 - cos = -log(1 - u (1 - exp(-2 bandwidth))) / bandwidth (Jakob,
    /// "Numerically stable sampling of the von Mises-Fisher distribution on S2", 2012).
    pub fn sample(&self, [u, v]: [f64; 2]) -> DVec3 {
        let t = if self.bandwidth < GAUSSIAN.uniform_bandwidth {
            2.0 * u
        } else {
            -(-u * self.span).ln_1p() / self.bandwidth
        };
        let t = t.clamp(0.0, 2.0);
        let (x, y) = self.direction.any_orthonormal_pair();
        let (sin_phi, cos_phi) = (TAU * v).sin_cos();
        (1.0 - t) * self.direction + (t * (2.0 - t)).sqrt() * (cos_phi * x + sin_phi * y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gaussian(bandwidth: f32) -> Gaussian {
        Gaussian::new(&Lobe { direction: Vec3::new(0.3, -0.5, 0.8).normalize(), bandwidth })
    }

    #[test]
    fn samples_follow_the_density() {
        for bandwidth in [0.0, 1e-12, 1e-3, 1.0, 30.0, 1e4, 1e7] {
            let g = gaussian(bandwidth);
            let n = 20_000;
            // The mean of 1 - cos has the closed form 1 - coth(b) + 1/b.
            let mean: f64 = (0..n)
                .map(|i| {
                    let l = g.sample([
                        (f64::from(i) + 0.5) / f64::from(n),
                        (f64::from(i) * 0.618).fract(),
                    ]);
                    assert!((l.length() - 1.0).abs() < 1e-9);
                    0.5 * (g.direction - l).length_squared()
                })
                .sum::<f64>()
                / f64::from(n);
            let b = f64::from(bandwidth);
            let exact = if b < 1e-2 { 1.0 - b / 3.0 } else { 1.0 - 1.0 / b.tanh() + 1.0 / b };
            assert!((mean / exact - 1.0).abs() < 1e-3, "{bandwidth}: {mean} {exact}");
        }
    }

    #[test]
    fn the_integral_is_the_closed_form() {
        for bandwidth in [0.0, 0.5, 8.0, 200.0] {
            let g = gaussian(bandwidth);
            let n = 200_000;
            let sum: f64 = (0..n)
                .map(|i| {
                    // Equal-area spiral points.
                    let (z, phi) = (
                        1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(n),
                        f64::from(i) * 2.399_963_229_728_653,
                    );
                    let r = (1.0 - z * z).sqrt();
                    g.value(DVec3::new(r * phi.cos(), r * phi.sin(), z))
                })
                .sum();
            assert!(
                (sum / f64::from(n) * 2.0 * TAU / g.solid_angle() - 1.0).abs() < 1e-3,
                "{bandwidth}"
            );
        }
    }

    #[test]
    fn no_bandwidth_loses_digits() {
        for bandwidth in [0.0f32, 1e-12, 1e-6, 1e-3, 1.0, 10.0, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7] {
            let (g, b) = (gaussian(bandwidth), f64::from(bandwidth));
            // 4 pi e^-b sinh(b) / b, by its series where that is 0 / 0.
            let series = 2.0 * TAU * (-b).exp() * (1.0 + b * b / 6.0);
            let exact = if b < 0.01 { series } else { TAU * (1.0 - (-2.0 * b).exp()) / b };
            assert!(
                (g.solid_angle() / exact - 1.0).abs() < 1e-9,
                "{bandwidth}: {}",
                g.solid_angle()
            );
            for u in [0.0, 1e-7, 0.1, 0.5, 0.9, 1.0 - 1e-7] {
                // The fraction of the distribution within the sampled angle is u again.
                let l = g.sample([u, 0.3]);
                let t = 0.5 * (g.direction - l).length_squared();
                let fraction =
                    if b < 1e-9 { 0.5 * t } else { (-b * t).exp_m1() / (-2.0 * b).exp_m1() };
                assert!((fraction - u).abs() < 1e-9, "{bandwidth} {u}: {fraction}");
                // Density times the whole is the value, in the single precision that callers have.
                assert!((g.pdf(g.value(l)) * g.solid_angle() / (-b * t).exp() - 1.0).abs() < 1e-7);
            }
        }
    }

    #[test]
    fn extremes_are_finite() {
        for bandwidth in [f32::NAN, -1.0, f32::INFINITY, f32::MAX] {
            let g = Gaussian::new(&Lobe { direction: Vec3::ZERO, bandwidth });
            assert!(
                g.sample([0.999_999_999, 0.5]).is_finite()
                    && g.value(DVec3::X).is_finite()
                    && g.solid_angle() > 0.0
            );
        }
    }
}
