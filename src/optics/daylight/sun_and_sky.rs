//! The clear sky and the sun as functions of the sun's elevation and the air's turbidity, in
//! luminance and illuminance.
//!
//! Sky: Preetham, Shirley and Smits, "A Practical Analytic Model for Daylight", SIGGRAPH 1999. With
//! theta the angle from the zenith, gamma from the sun, F(theta, gamma) = (1 + A exp(B / cos
//! theta)) (1 + C exp(D gamma) + E cos^2 gamma), luminance Y = Y_z F(theta, gamma) / F(0, theta_s),
//! the chromaticities x and y likewise; A to E are linear in the turbidity T. Sun: its illuminance
//! above the air, through the Rayleigh and the aerosol extinction of the same paper's appendix, at
//! one wavelength per channel.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::window_model::Heading;
use crate::image::Plane;
use crate::optics::black_body;
use crate::tuning::tuning;

/// A clear sky with the sun in it.
#[derive(Clone, Copy, Debug)]
pub struct Daylight {
    /// Ratio of the optical thickness of air with haze to that of air alone: 2 is very clear, 3
    /// clear, 6 haze; the model was fitted from 2 to 10.
    pub turbidity: f64,
    /// The direction of the sun: unit length, above the horizon.
    pub sun: DVec3,
}

tuning! {
    /// Constants of the sun and the clear sky.
    pub const TUNING: DaylightTuning {
        /// Rows of the picture of a surrounding, 1.4 degrees each.
        rows: usize = 128,
            unit "pixels", source Taste, effect "a larger value fits the surrounding more exactly and takes longer";
        /// Albedo of the earth, gray: grass, soil and pavement.
        earth: f64 = 0.2,
            unit "albedo", source Taste, effect "a larger value brightens the radiance below the horizon";
        /// Least cosine between the zenith and a direction of the sky.
        min_cosine: f64 = 1e-3,
            unit "1", source Taste, effect "a larger value flattens the sky at the horizon";
        /// Illuminance of the sun above the air.
        sun_lux: f64 = 133_000.0,
            unit "lux", source Paper("the solar constant"), effect "a larger value brightens the sun";
        /// Color temperature of the sun above the air.
        sun_kelvin: f32 = 5800.0,
            unit "kelvin", source Paper("effective temperature of the sun"),
            effect "a larger value makes the sun bluer";
        /// Wavelengths of the channels.
        channels: [f64; 3] = [0.610, 0.550, 0.465],
            unit "micrometers", source Derived("peaks of the Rec.709 primaries"),
            effect "other values change the color of the sun through the air";
    }
}

impl Daylight {
    /// The illuminance by the sun alone of a surface that faces it, lux, per channel; `up` has unit
    /// length.
    pub fn sun_lux(&self, up: DVec3) -> DVec3 {
        let zenith = self.sun.dot(up).clamp(-1.0, 1.0).acos();
        let degrees = zenith.to_degrees();
        // Relative optical mass by Kasten; its denominator is zero a little below the horizon.
        let mass = 1.0 / (zenith.cos().max(0.0) + 0.15 * (93.885 - degrees.min(90.0)).powf(-1.253));
        let beta = 0.046_08 * self.turbidity - 0.045_86;
        let through = TUNING
            .channels
            .map(|um| (-mass * (0.008_735 * um.powf(-4.08) + beta.max(0.0) * um.powf(-1.3))).exp());
        black_body(TUNING.sun_kelvin).as_dvec3() * TUNING.sun_lux * DVec3::from_array(through)
    }

    /// Luminance of the sky per channel, cd per square meter, towards unit `l` above the horizon;
    /// without the sun's disc.
    fn sky(&self, l: DVec3, up: DVec3) -> DVec3 {
        let t = self.turbidity;
        let theta_s = self.sun.dot(up).clamp(0.0, 1.0).acos();
        let cos = l.dot(up).max(TUNING.min_cosine);
        let gamma = l.dot(self.sun).clamp(-1.0, 1.0).acos();
        let spread = |row: [[f64; 2]; 5]| {
            let [a, b, c, d, e] = row.map(|[slope, base]| slope * t + base);
            let f = move |cos: f64, gamma: f64| {
                (1.0 + a * (b / cos).exp())
                    * (1.0 + c * (d * gamma).exp() + e * gamma.cos().powi(2))
            };
            f(cos, gamma) / f(1.0, theta_s)
        };
        let chi = (4.0 / 9.0 - t / 120.0) * (PI - 2.0 * theta_s);
        let zenith = 1000.0 * ((4.0453 * t - 4.9710) * chi.tan() - 0.2155 * t + 2.4192).max(0.0);
        let luminance = zenith * spread(LUMINANCE).max(0.0);
        let (x, y) = (
            at_zenith(ZENITH_X, t, theta_s) * spread(X),
            at_zenith(ZENITH_Y, t, theta_s) * spread(Y),
        );
        rgb(x, y, luminance)
    }

    /// The equirectangular picture of all directions in units of the photo, without the sun's disc;
    /// below the horizon the earth, which sun and sky light. A white surface under `lux` shows 1,
    /// so that a luminance of lux / pi does.
    pub fn surrounding(&self, heading: Heading, lux: f64) -> Plane<Vec3> {
        let (up, width) = (heading.up.as_dvec3(), 2 * TUNING.rows);
        let direction = |i: usize| {
            let (u, v) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            heading.direction(u / width as f64, v / TUNING.rows as f64)
        };
        let sky: Vec<DVec3> =
            (0..width * TUNING.rows / 2).map(|i| self.sky(direction(i), up)).collect();
        let band = |row: usize| {
            (PI * row as f64 / TUNING.rows as f64).cos()
                - (PI * (row + 1) as f64 / TUNING.rows as f64).cos()
        };
        let arrives = |(i, l): (usize, &DVec3)| {
            *l * (direction(i).dot(up) * band(i / width) * 2.0 * PI / width as f64)
        };
        let sky_lux: DVec3 = sky.iter().enumerate().map(arrives).sum();
        let earth = TUNING.earth / PI * (sky_lux + self.sun_lux(up) * self.sun.dot(up).max(0.0));
        let pixel = |i: usize| (*sky.get(i).unwrap_or(&earth) * (PI / lux)).as_vec3();
        Plane::new(width, TUNING.rows, (0..width * TUNING.rows).map(pixel).collect())
    }
}

// Slope in the turbidity, and value at 0, of A to E. Source: the paper, appendix A.2.

/// Coefficients of the luminance.
const LUMINANCE: [[f64; 2]; 5] =
    [[0.1787, -1.4630], [-0.3554, 0.4275], [-0.0227, 5.3251], [0.1206, -2.5771], [-0.0670, 0.3703]];
/// Coefficients of the chromaticity x.
const X: [[f64; 2]; 5] = [
    [-0.0193, -0.2592],
    [-0.0665, 0.0008],
    [-0.0004, 0.2125],
    [-0.0641, -0.8989],
    [-0.0033, 0.0452],
];
/// Coefficients of the chromaticity y.
const Y: [[f64; 2]; 5] = [
    [-0.0167, -0.2608],
    [-0.0950, 0.0092],
    [-0.0079, 0.2102],
    [-0.0441, -1.6537],
    [-0.0109, 0.0529],
];

// Chromaticity at the zenith. Source: the paper, appendix A.2.

/// Coefficients of x: rows for T^2, T, 1, columns for theta_s^3, theta_s^2, theta_s, 1.
const ZENITH_X: [[f64; 4]; 3] = [
    [0.001_66, -0.003_75, 0.002_09, 0.0],
    [-0.029_03, 0.063_77, -0.032_02, 0.003_94],
    [0.116_93, -0.211_96, 0.060_52, 0.258_86],
];
/// Coefficients of y, as [`ZENITH_X`].
const ZENITH_Y: [[f64; 4]; 3] = [
    [0.002_75, -0.006_10, 0.003_17, 0.0],
    [-0.042_14, 0.089_70, -0.041_53, 0.005_16],
    [0.153_46, -0.267_56, 0.066_70, 0.266_88],
];

fn at_zenith(rows: [[f64; 4]; 3], t: f64, theta: f64) -> f64 {
    let [a, b, c] = rows.map(|[k3, k2, k1, k0]| ((k3 * theta + k2) * theta + k1) * theta + k0);
    (a * t + b) * t + c
}

/// The linear Rec.709 color of a chromaticity and a luminance, clipped to 0 outside of the gamut.
fn rgb(x: f64, y: f64, luminance: f64) -> DVec3 {
    let (x_, z_) = (x / y * luminance, (1.0 - x - y) / y * luminance);
    let rgb = DVec3::new(
        3.240_97 * x_ - 1.537_38 * luminance - 0.498_61 * z_,
        -0.969_24 * x_ + 1.875_97 * luminance + 0.041_56 * z_,
        0.055_63 * x_ - 0.203_98 * luminance + 1.056_97 * z_,
    );
    if rgb.is_finite() { rgb.max(DVec3::ZERO) } else { DVec3::ZERO }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::luminance;

    const UP: DVec3 = DVec3::Y;

    fn day(turbidity: f64, elevation: f64) -> Daylight {
        let (sin, cos) = elevation.to_radians().sin_cos();
        Daylight { turbidity, sun: DVec3::new(0.0, sin, -cos) }
    }

    #[test]
    fn the_zenith_is_as_the_paper_has_it() {
        // Y_z of T = 3 and the sun 60 degrees from the zenith: chi = (4/9 - 1/40) (pi - 2 pi / 3) =
        // 0.43924, tan 0.46995; (12.1359 - 4.9710) 0.46995 - 0.6465 + 2.4192 = 5.1398 kcd per
        // square meter.
        let y = luminance(day(3.0, 30.0).sky(UP, UP).as_vec3());
        assert!((y / 5139.8 - 1.0).abs() < 2e-3, "{y}");
    }

    #[test]
    fn a_clear_day_is_as_bright_as_clear_days_are() {
        let y = |rgb: DVec3| f64::from(luminance(rgb.as_vec3()));
        // Direct normal illuminance of clear days: about 80 klx at 35 degrees, over 90 at 60,
        // little at the horizon.
        let sun = |elevation: f64| y(day(3.0, elevation).sun_lux(UP));
        assert!((60e3..95e3).contains(&sun(35.0)), "{}", sun(35.0));
        assert!(
            sun(60.0) > sun(35.0) && sun(35.0) > sun(10.0) && sun(10.0) > sun(1.0),
            "it falls towards the horizon"
        );
        // Haze takes from the sun; a low sun is red.
        assert!(y(day(8.0, 35.0).sun_lux(UP)) < 0.6 * sun(35.0));
        let low = day(3.0, 4.0).sun_lux(UP);
        assert!(low.x > 1.5 * low.z, "{low}");
        // Horizontal illuminance by a clear sky alone: 10 to 20 klx as measured; the model's sky is
        // brighter around the sun.
        let picture = day(3.0, 40.0).surrounding(Heading { up: Vec3::Y, ahead: Vec3::NEG_Z }, PI);
        let rows = picture.height();
        let lux: f64 = (0..picture.len() / 2)
            .map(|i| {
                let row = (i / picture.width()) as f64;
                let [from, to] = [row, row + 1.0].map(|row| (PI * row / rows as f64).cos());
                y(picture.pixels()[i].as_dvec3()) * 0.5 * (from * from - to * to) * 2.0 * PI
                    / picture.width() as f64
            })
            .sum();
        assert!((10e3..30e3).contains(&lux), "{lux}");
        // Blue away from the sun, and the earth darker than the sky.
        let up = picture.get(0, 10);
        assert!(up.z > up.x, "{up}");
    }

    #[test]
    fn extremes_are_finite() {
        for turbidity in [1.7, 10.0] {
            for elevation in [0.01, 1.0, 89.99, 90.0] {
                let picture = day(turbidity, elevation)
                    .surrounding(Heading { up: Vec3::Y, ahead: Vec3::NEG_Z }, 1000.0);
                assert!(
                    picture.pixels().iter().all(|p| p.is_finite() && p.min_element() >= 0.0),
                    "{turbidity} {elevation}"
                );
            }
        }
    }
}
