//! Irradiance through a window: a spherical Gaussian over a rectangle, by multiple importance sampling.
//!
//! E = (1/pi) integral over the seen rectangle of G(l) cos(theta) dl, for each lobe by itself.

use std::f64::consts::PI;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::gaussian::Gaussian;
use super::rectangle::{Rectangle, SeenRectangle};
use super::{Lobe, Window};

/// Where the directions to a window come from. All but `Best` are there to be compared with it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Sampling {
    /// Uniform over the rectangle's solid angle: Ureña, Fajardo and King 2013.
    Area,
    /// The lobe's von Mises-Fisher distribution.
    Lobe,
    /// Area and lobe in turn, with the balance heuristic (Veach 1997): unbiased over an even number of samples.
    Balance,
    /// Area or lobe by chance, with the balance heuristic.
    BalanceOneSample,
    /// Area and lobe in turn, with the power heuristic (exponent 2): unbiased over an even number of samples.
    Power,
    /// Area or lobe by chance, with the power heuristic.
    PowerOneSample,
    /// What suits lobe and receiver.
    #[default]
    Best,
}

impl Sampling {
    pub const ALL: [Sampling; 7] = [
        Sampling::Area,
        Sampling::Lobe,
        Sampling::Balance,
        Sampling::BalanceOneSample,
        Sampling::Power,
        Sampling::PowerOneSample,
        Sampling::Best,
    ];
}

/// A window made ready for sampling.
pub struct Opening {
    rectangle: Rectangle,
    lobes: [Gaussian; 3],
    sampling: Sampling,
}

impl Opening {
    /// `None` when the window has no area.
    pub fn new(window: &Window, sampling: Sampling) -> Option<Opening> {
        let lobes = window.lobes.each_ref().map(|lobe: &Lobe| Gaussian::new(lobe));
        Some(Opening { rectangle: Rectangle::new(window.center, window.x, window.y)?, lobes, sampling })
    }

    /// E of a lobe of unit radiance where it has a closed form: behind the window there is none of it.
    pub fn irradiance(&self, _lobe: usize, point: DVec3, _normal: DVec3) -> Option<f64> {
        (self.rectangle.height(point) <= 0.0).then_some(0.0)
    }

    /// One lobe as seen from a receiver; `None` behind the window.
    pub fn seen(&self, lobe: usize, point: DVec3, normal: DVec3) -> Option<SeenOpening<'_>> {
        let (gaussian, seen) = (self.lobes[lobe], self.rectangle.seen_from(point)?);
        let sampling = match self.sampling {
            // A lobe wider than the rectangle is better sampled through the rectangle.
            Sampling::Best if gaussian.solid_angle() < seen.solid_angle() => Sampling::BalanceOneSample,
            Sampling::Best => Sampling::Area,
            sampling => sampling,
        };
        Some(SeenOpening { rectangle: &self.rectangle, seen, gaussian, point, normal, sampling })
    }
}

/// One lobe of a window as seen from a receiver.
pub struct SeenOpening<'a> {
    rectangle: &'a Rectangle,
    seen: SeenRectangle,
    gaussian: Gaussian,
    point: DVec3,
    normal: DVec3,
    sampling: Sampling,
}

impl SeenOpening<'_> {
    /// The `i`th sample: a place relative to the receiver, and its part of E; `None` for a direction that misses the window or
    /// comes from below the horizon.
    pub fn sample(&self, i: usize, [u, v]: [f64; 2]) -> Option<(DVec3, f64)> {
        use Sampling::{Area, Balance, BalanceOneSample, Lobe, Power, PowerOneSample};
        // Sobol points of even and of odd index lie in different halves of u: stretched, each half is evenly spread over the
        // square.
        let [through_lobe, halves] = match self.sampling {
            Area | Sampling::Best => [false, false],
            Lobe => [true, false],
            Balance | Power => [i % 2 == 1, true],
            BalanceOneSample | PowerOneSample => [u >= 0.5, true],
        };
        let uv = [if halves { (2.0 * u).fract() } else { u }, v];
        let (place, direction) = if through_lobe {
            let direction = self.gaussian.sample(uv);
            (self.rectangle.meet(self.point, direction)?, direction)
        } else {
            let place = self.seen.sample(uv);
            (place, place.normalize_or_zero())
        };
        let value = self.gaussian.value(direction);
        let (area, lobe) = (self.seen.pdf(place), self.gaussian.pdf(value));
        let (own, other) = if through_lobe { (lobe, area) } else { (area, lobe) };
        // One over the density, weighted: w / (c p) with c = 1/2 where two strategies share the samples.
        let inverse = match self.sampling {
            Area | Lobe | Sampling::Best => 1.0 / own,
            Balance | BalanceOneSample => 2.0 / (own + other),
            Power | PowerOneSample => 2.0 * own / (own * own + other * other),
        };
        let cos = self.normal.dot(direction);
        (cos > 0.0).then(|| (place, value * cos * inverse / PI))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Points2;
    use glam::Vec3;

    fn opening(lobes: [(Vec3, f32); 3]) -> Opening {
        let lobes = lobes.map(|(direction, bandwidth)| Lobe { direction: direction.normalize(), bandwidth });
        let window = Window { center: Vec3::new(0.2, 0.5, 2.0), x: Vec3::NEG_X * 0.8, y: Vec3::Y * 0.6, lobes };
        Opening::new(&window, Sampling::Best).unwrap()
    }

    fn samples(o: &Opening, normal: DVec3, n: usize, pixel: u32) -> [f64; 3] {
        std::array::from_fn(|k| {
            let points = Points2::new(5, pixel, k as u32);
            let seen = o.seen(k, DVec3::ZERO, normal).unwrap();
            (0..n).filter_map(|i| seen.sample(i, points.get(i))).map(|(_, part)| part / n as f64).sum()
        })
    }

    /// The slow, obvious twin: a fine grid over the rectangle.
    fn quadrature(o: &Opening, normal: DVec3) -> [f64; 3] {
        let n = 1500;
        let mut sum = [0.0; 3];
        for i in 0..n * n {
            let (u, v) = (((i % n) as f64 + 0.5) / n as f64 * 2.0 - 1.0, ((i / n) as f64 + 0.5) / n as f64 * 2.0 - 1.0);
            let place = DVec3::new(0.2 - 0.8 * u, 0.5 + 0.6 * v, 2.0);
            let l = place.normalize();
            let weight = normal.dot(l).max(0.0) * l.z / place.length_squared() * (1.6 * 1.2) / (n * n) as f64 / PI;
            sum.iter_mut().zip(&o.lobes).for_each(|(sum, lobe)| *sum += weight * lobe.value(l));
        }
        sum
    }

    #[test]
    fn every_bandwidth_agrees_with_quadrature() {
        let normal = DVec3::new(0.1, 0.5, 0.7).normalize();
        let inside = Vec3::new(0.1, 0.25, 1.0);
        for lobes in [
            [(inside, 2e4), (Vec3::Y, 3.0), (Vec3::NEG_Y, 0.0)],
            [(inside, 300.0), (Vec3::new(0.45, 0.2, 1.0), 2000.0), (Vec3::NEG_Z, 10.0)],
        ] {
            let o = opening(lobes);
            let exact = quadrature(&o, normal);
            let pixels = 4000;
            let (mut mean, mut square) = ([0.0; 3], [0.0; 3]);
            for pixel in 0..pixels {
                let e = samples(&o, normal, 32, pixel);
                for k in 0..3 {
                    mean[k] += e[k] / f64::from(pixels);
                    square[k] += e[k] * e[k] / f64::from(pixels);
                }
            }
            for k in 0..3 {
                let sd = ((square[k] - mean[k] * mean[k]).max(0.0) / f64::from(pixels)).sqrt();
                // Four standard errors, and the rounding of single-precision parts.
                let bound = 4.0 * sd + 1e-5 * exact[k] + 1e-12;
                assert!((mean[k] - exact[k]).abs() < bound, "{lobes:?} {k}: {} {} {sd}", mean[k], exact[k]);
            }
        }
    }

    #[test]
    fn every_strategy_has_the_same_mean() {
        let lobe = |bandwidth| (Vec3::new(0.2, 0.3, 1.0), bandwidth);
        let normal = DVec3::new(0.1, 0.5, 0.7).normalize();
        let mut o = opening([lobe(3.0), lobe(30.0), lobe(300.0)]);
        let exact = quadrature(&o, normal);
        for sampling in Sampling::ALL {
            o.sampling = sampling;
            let pixels = 2000;
            let (mut mean, mut square) = ([0.0; 3], [0.0; 3]);
            for pixel in 0..pixels {
                let e = samples(&o, normal, 32, pixel);
                for k in 0..3 {
                    mean[k] += e[k] / f64::from(pixels);
                    square[k] += e[k] * e[k] / f64::from(pixels);
                }
            }
            for k in 0..3 {
                let sd = ((square[k] - mean[k] * mean[k]).max(0.0) / f64::from(pixels)).sqrt();
                let bound = 4.0 * sd + 1e-5 * exact[k];
                assert!((mean[k] - exact[k]).abs() < bound, "{sampling:?} {k}: {} {} {sd}", mean[k], exact[k]);
            }
        }
    }

    #[test]
    fn bandwidth_zero_is_a_lamp() {
        let o = opening([(Vec3::X, 0.0); 3]);
        let normal = DVec3::new(0.0, 0.3, 1.0).normalize();
        let exact = o.rectangle.irradiance(DVec3::ZERO, normal);
        let mean: f64 = (0..500).map(|pixel| samples(&o, normal, 32, pixel)[2]).sum::<f64>() / 500.0;
        assert!((mean / exact - 1.0).abs() < 1e-3, "{mean} {exact}");
    }

    #[test]
    fn a_narrow_sun_gives_its_solid_angle_times_the_cosine() {
        let sun = Vec3::new(0.1, 0.25, 1.0).normalize();
        for bandwidth in [1e5, 1e7] {
            let o = opening([(sun, bandwidth), (Vec3::Y, 1.0), (Vec3::NEG_Y, 1.0)]);
            let wanted = o.lobes[0].solid_angle() * f64::from(sun.z) / PI;
            for pixel in 0..20 {
                // Of 16 evenly spread points 7 to 9 go to the lobe.
                let got = samples(&o, DVec3::Z, 16, pixel)[0];
                assert!((got / wanted - 1.0).abs() < 0.15, "{bandwidth}: {got} {wanted}");
            }
        }
    }
}
