//! Irradiance through a window: spherical Gaussians over a rectangle, by multiple importance sampling.
//!
//! E_k = (1/pi) integral over the seen rectangle of G_k(l) cos(theta) dl, for each lobe k. Directions come from several
//! strategies at once: uniform over the rectangle's solid angle, and from each lobe that is narrower than the rectangle. A
//! sample of any strategy counts for every lobe with the balance heuristic (Veach, 1997): G_k cos / (pi sum_j n_j p_j).

use std::f64::consts::PI;

use glam::DVec3;

use super::emitter::LightSample;
use super::gaussian::Gaussian;
use super::random::Points2;
use super::rectangle::Rectangle;
use super::{Lobe, Window};

/// A window made ready for sampling.
pub struct Opening {
    rectangle: Rectangle,
    lobes: [Gaussian; 3],
}

impl Opening {
    /// `None` when the window has no area.
    pub fn new(window: &Window) -> Option<Opening> {
        let lobes = window.lobes.each_ref().map(|lobe: &Lobe| Gaussian::new(lobe));
        Some(Opening { rectangle: Rectangle::new(window.center, window.x, window.y)?, lobes })
    }

    /// About `n` samples towards the window; those that miss it or come from below the horizon are left out.
    pub fn sample(&self, point: DVec3, normal: DVec3, n: usize, seed: u64, pixel: u32, out: &mut Vec<LightSample>) {
        let Some(seen) = self.rectangle.seen_from(point) else { return };
        // A lobe wider than the rectangle is better sampled through the rectangle.
        let narrow = self.lobes.each_ref().map(|g| g.solid_angle() < seen.solid_angle());
        let each = n / (2 * narrow.iter().filter(|&&yes| yes).count().max(1));
        let counts = narrow.map(|yes| if yes { each } else { 0 });
        let uniform = n - counts.iter().sum::<usize>();
        let mut add = |place: DVec3, direction: DVec3| {
            let cos = normal.dot(direction);
            if cos <= 0.0 {
                return;
            }
            let values = self.lobes.each_ref().map(|g| g.value(direction));
            let mut density = uniform as f64 * seen.pdf(place);
            for k in 0..3 {
                density += counts[k] as f64 * self.lobes[k].pdf(values[k]);
            }
            let parts = values.map(|g| g * cos / (PI * density));
            out.push(LightSample::new(point + place, parts));
        };
        let points = Points2::new(seed, pixel, 0);
        for i in 0..uniform {
            let place = seen.sample(points.get(i));
            add(place, place.normalize_or_zero());
        }
        for (k, lobe) in self.lobes.iter().enumerate() {
            let points = Points2::new(seed, pixel, 1 + k as u32);
            for i in 0..counts[k] {
                let direction = lobe.sample(points.get(i));
                if let Some(place) = self.rectangle.meet(point, direction) {
                    add(place, direction);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn opening(lobes: [(Vec3, f32); 3]) -> Opening {
        let lobes = lobes.map(|(direction, bandwidth)| Lobe { direction: direction.normalize(), bandwidth });
        let window = Window { center: Vec3::new(0.2, 0.5, 2.0), x: Vec3::NEG_X * 0.8, y: Vec3::Y * 0.6, lobes };
        Opening::new(&window).unwrap()
    }

    fn samples(o: &Opening, normal: DVec3, n: usize, pixel: u32) -> [f64; 3] {
        let mut out = Vec::new();
        o.sample(DVec3::ZERO, normal, n, 5, pixel, &mut out);
        std::array::from_fn(|k| out.iter().map(|s| f64::from(s.parts[k])).sum())
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
                let got = samples(&o, DVec3::Z, 16, pixel)[0];
                assert!((got / wanted - 1.0).abs() < 0.02, "{bandwidth}: {got} {wanted}");
            }
        }
    }
}
