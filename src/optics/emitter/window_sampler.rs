//! Irradiance through a window: a spherical Gaussian over a rectangle, in closed form and by
//! sampling.
//!
//! E = (1/pi) integral over the visible rectangle of G(l) cos(theta) dl, for each lobe by itself.
//! [`Strategy::Best`] is the default of rendering; the other strategies exist to be compared with
//! it in `benches/windows.rs` and in the tests.

use std::f64::consts::PI;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::form::{FormSampler, PreparedForm};
use super::gradient::{Gradient, lobe_gradient};
use crate::optics::sampling::gaussian::Gaussian;
use crate::optics::sampling::product_sampler::ProductSampler;
use crate::optics::sampling::rectangle::{Rectangle, RectangleSampler};
use crate::optics::sampling::{Lobe, Points2};

/// The source of the directions to a window. All but the default, `Best`, exist only for
/// comparison.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Strategy {
    /// Uniform over the rectangle's solid angle: Ureña, Fajardo and King 2013.
    Area,
    /// The lobe's von Mises-Fisher distribution.
    Lobe,
    /// Area and lobe in turn, with the balance heuristic (Veach 1997): unbiased over an even number
    /// of samples.
    Balance,
    /// Area or lobe by chance, with the balance heuristic.
    BalanceOneSample,
    /// Area and lobe in turn, with the power heuristic (exponent 2): unbiased over an even number
    /// of samples.
    Power,
    /// Area or lobe by chance, with the power heuristic.
    PowerOneSample,
    /// The technique that suits lobe and receiver, as `ProductSampler` chooses it.
    #[default]
    Best,
}

impl Strategy {
    /// All strategies, the default last.
    pub const ALL: [Strategy; 7] = [
        Strategy::Area,
        Strategy::Lobe,
        Strategy::Balance,
        Strategy::BalanceOneSample,
        Strategy::Power,
        Strategy::PowerOneSample,
        Strategy::Best,
    ];
}

/// A window in double precision.
pub(super) struct PreparedWindow {
    rectangle: Rectangle,
    lobes: [Gaussian; 3],
    strategy: Strategy,
}

impl PreparedWindow {
    /// The rectangle with these lobes behind it.
    pub fn new(rectangle: Rectangle, lobes: &[Lobe; 3], strategy: Strategy) -> PreparedWindow {
        PreparedWindow { rectangle, lobes: lobes.each_ref().map(Gaussian::new), strategy }
    }
}

impl PreparedForm for PreparedWindow {
    fn irradiance(&self, lobe: usize, point: DVec3, normal: DVec3) -> Option<f64> {
        let outline = self.rectangle.outline(point, normal);
        Some(outline.map_or(0.0, |outline| self.lobes[lobe].irradiance(&outline, normal)))
    }

    fn sampler_at(
        &self,
        lobe: usize,
        point: DVec3,
        normal: DVec3,
    ) -> Option<Box<dyn FormSampler + '_>> {
        let gaussian = self.lobes[lobe];
        let technique = match self.strategy {
            Strategy::Best => {
                let outline = self.rectangle.outline(point, normal)?;
                Technique::Best(ProductSampler::new(
                    &self.rectangle,
                    &outline,
                    Some(gaussian),
                    (point, normal),
                )?)
            }
            Strategy::Lobe => Technique::Best(ProductSampler::Lobe(gaussian)),
            strategy => Technique::Mixed(self.rectangle.sampler_at(point)?, strategy),
        };
        Some(Box::new(WindowSampler {
            rectangle: &self.rectangle,
            gaussian,
            point,
            normal,
            technique,
        }))
    }

    fn gradient(&self, lobe: usize, point: DVec3, normal: DVec3, pivot: DVec3) -> Gradient {
        let outline = self.rectangle.outline(point, normal);
        outline.map_or_else(Gradient::default, |outline| {
            lobe_gradient(&self.lobes[lobe], &outline, normal, pivot)
        })
    }
}

/// A sampler of one lobe of a window for one receiver.
struct WindowSampler<'a> {
    rectangle: &'a Rectangle,
    gaussian: Gaussian,
    point: DVec3,
    normal: DVec3,
    technique: Technique,
}

enum Technique {
    Best(ProductSampler),
    /// The rectangle alone, or rectangle and lobe.
    Mixed(RectangleSampler, Strategy),
}

impl FormSampler for WindowSampler<'_> {
    /// `None` for a direction that misses the window or comes from below the horizon.
    fn sample(&self, points: &Points2, i: usize) -> Option<(DVec3, f64)> {
        let (position, contribution) = match &self.technique {
            Technique::Best(sampler) => {
                sampler.sample(self.rectangle, (self.point, self.normal), points.get(i))
            }
            Technique::Mixed(area, strategy) => self.mixed(area, *strategy, points, i),
        }?;
        Some((self.point + position, contribution))
    }
}

impl WindowSampler<'_> {
    /// The `i`th sample of a strategy with the rectangle: a position relative to the receiver, and
    /// its contribution.
    fn mixed(
        &self,
        rectangle: &RectangleSampler,
        strategy: Strategy,
        points: &Points2,
        i: usize,
    ) -> Option<(DVec3, f64)> {
        use Strategy::{Balance, BalanceOneSample, Power, PowerOneSample};
        let (through_lobe, uv) = match strategy {
            Balance | Power => (i % 2 == 1, points.in_turn(i)),
            BalanceOneSample | PowerOneSample => {
                // The half of the square that a point lies in, stretched, is evenly spread over the
                // square again.
                let [u, v] = points.get(i);
                (u >= 0.5, [(2.0 * u).fract(), v])
            }
            _ => (false, points.get(i)),
        };
        let (position, direction) = if through_lobe {
            let direction = self.gaussian.sample(uv);
            (self.rectangle.intersect(self.point, direction)?, direction)
        } else {
            let position = rectangle.sample(uv);
            (position, position.normalize_or_zero())
        };
        let value = self.gaussian.value(direction);
        let (area, lobe) = (rectangle.pdf(position), self.gaussian.pdf(value));
        let (chosen, other) = if through_lobe { (lobe, area) } else { (area, lobe) };
        // One over the density, weighted: w / (c p) with c = 1/2 where two techniques share the
        // samples.
        let inverse = match strategy {
            Balance | BalanceOneSample => 2.0 / (chosen + other),
            Power | PowerOneSample => 2.0 * chosen / (chosen * chosen + other * other),
            _ => 1.0 / chosen,
        };
        let cos = self.normal.dot(direction);
        (cos > 0.0).then(|| (position, value * cos * inverse / PI))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Window;
    use glam::Vec3;

    fn prepared(window: &Window, strategy: Strategy) -> PreparedWindow {
        window.prepared(strategy).unwrap()
    }

    fn opening(lobes: [(Vec3, f32); 3]) -> PreparedWindow {
        let lobes = lobes
            .map(|(direction, bandwidth)| Lobe { direction: direction.normalize(), bandwidth });
        let window = Window {
            center: Vec3::new(0.2, 0.5, 2.0),
            x: Vec3::NEG_X * 0.8,
            y: Vec3::Y * 0.6,
            lobes,
        };
        prepared(&window, Strategy::Best)
    }

    fn samples(o: &PreparedWindow, normal: DVec3, n: usize, pixel: u32) -> [f64; 3] {
        std::array::from_fn(|k| {
            let points = Points2::new(5, pixel, k as u32);
            let sampler = o.sampler_at(k, DVec3::ZERO, normal).unwrap();
            (0..n)
                .filter_map(|i| sampler.sample(&points, i))
                .map(|(_, contribution)| contribution / n as f64)
                .sum()
        })
    }

    /// The slow, obvious twin: a fine grid over the rectangle.
    fn quadrature(o: &PreparedWindow, normal: DVec3) -> [f64; 3] {
        let n = 1500;
        let mut sum = [0.0; 3];
        for i in 0..n * n {
            let (u, v) = (
                ((i % n) as f64 + 0.5) / n as f64 * 2.0 - 1.0,
                ((i / n) as f64 + 0.5) / n as f64 * 2.0 - 1.0,
            );
            let position = DVec3::new(0.2 - 0.8 * u, 0.5 + 0.6 * v, 2.0);
            let l = position.normalize();
            let weight = normal.dot(l).max(0.0) * l.z / position.length_squared() * (1.6 * 1.2)
                / (n * n) as f64
                / PI;
            sum.iter_mut().zip(&o.lobes).for_each(|(sum, lobe)| *sum += weight * lobe.value(l));
        }
        sum
    }

    /// The mean of `pixels` estimates lies within four standard errors of the quadrature, and the
    /// rounding of single-precision contributions.
    #[track_caller]
    fn agrees_with_quadrature(
        o: &PreparedWindow,
        normal: DVec3,
        pixels: u32,
        case: &dyn std::fmt::Debug,
    ) {
        let exact = quadrature(o, normal);
        let (mut mean, mut square) = ([0.0; 3], [0.0; 3]);
        for pixel in 0..pixels {
            let e = samples(o, normal, 32, pixel);
            for k in 0..3 {
                mean[k] += e[k] / f64::from(pixels);
                square[k] += e[k] * e[k] / f64::from(pixels);
            }
        }
        for k in 0..3 {
            let sd = ((square[k] - mean[k] * mean[k]).max(0.0) / f64::from(pixels)).sqrt();
            let bound = 4.0 * sd + 1e-5 * exact[k] + 1e-12;
            assert!(
                (mean[k] - exact[k]).abs() < bound,
                "{case:?} {k}: {} {} {sd}",
                mean[k],
                exact[k]
            );
        }
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
            agrees_with_quadrature(&o, normal, 4000, &lobes);
        }
    }

    #[test]
    fn every_strategy_has_the_same_mean() {
        let lobe = |bandwidth| (Vec3::new(0.2, 0.3, 1.0), bandwidth);
        let normal = DVec3::new(0.1, 0.5, 0.7).normalize();
        let mut o = opening([lobe(3.0), lobe(30.0), lobe(300.0)]);
        for strategy in Strategy::ALL {
            o.strategy = strategy;
            agrees_with_quadrature(&o, normal, 2000, &strategy);
        }
    }

    #[test]
    fn bandwidth_zero_is_a_lamp() {
        let o = opening([(Vec3::X, 0.0); 3]);
        let normal = DVec3::new(0.0, 0.3, 1.0).normalize();
        let exact = o.rectangle.irradiance(DVec3::ZERO, normal);
        let mean: f64 =
            (0..500).map(|pixel| samples(&o, normal, 32, pixel)[2]).sum::<f64>() / 500.0;
        assert!((mean / exact - 1.0).abs() < 1e-3, "{mean} {exact}");
    }

    #[test]
    fn a_narrow_sun_gives_its_solid_angle_times_the_cosine() {
        let sun = Vec3::new(0.1, 0.25, 1.0).normalize();
        for bandwidth in [1e5, 1e7] {
            let o = opening([(sun, bandwidth), (Vec3::Y, 1.0), (Vec3::NEG_Y, 1.0)]);
            let wanted = o.lobes[0].solid_angle() * f64::from(sun.z) / PI;
            for pixel in 0..20 {
                // The lobe receives 7 to 9 of 16 evenly spread points.
                let got = samples(&o, DVec3::Z, 16, pixel)[0];
                assert!((got / wanted - 1.0).abs() < 0.15, "{bandwidth}: {got} {wanted}");
            }
        }
    }

    /// Distance of the receiver, its normal, and the lobe's aim in half edges from the window's
    /// center.
    const RECEIVERS: [(&str, f32, Vec3, [f32; 2]); 8] = [
        ("centered", 1.5, Vec3::Z, [0.0, 0.0]),
        ("off center", 1.5, Vec3::new(0.0, 1.0, 0.3), [0.5, 0.4]),
        ("on the edge", 1.5, Vec3::new(0.5, 0.0, 1.0), [1.0, 0.3]),
        ("beyond the edge", 1.5, Vec3::Z, [1.2, 0.3]),
        ("near", 0.1, Vec3::new(0.0, 1.0, 0.5), [0.3, 0.2]),
        ("far", 30.0, Vec3::Z, [0.3, 0.2]),
        ("far, on the edge", 30.0, Vec3::Z, [1.0, 0.2]),
        ("grazing", 1.5, Vec3::new(0.0, 1.0, -0.1), [0.0, 0.5]),
    ];

    #[test]
    fn the_best_strategy_is_as_good_as_area_and_lobe() {
        let pixels = 600;
        for (name, distance, normal, [across, up]) in RECEIVERS {
            // Turned in its plane, so that no edge lies along the points' strata by chance.
            let turn = glam::Quat::from_rotation_z(0.4);
            let [x, y] = [turn * Vec3::NEG_X * 0.8, turn * Vec3::Y * 0.6];
            let direction = (Vec3::Z * distance + x * across + y * up).normalize();
            let normal = normal.normalize().as_dvec3();
            for bandwidth in [1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6] {
                let window = Window {
                    center: Vec3::Z * distance,
                    x,
                    y,
                    lobes: [Lobe { direction, bandwidth }; 3],
                };
                let variance = |strategy| {
                    let o = prepared(&window, strategy);
                    let exact = o.irradiance(0, DVec3::ZERO, normal).unwrap();
                    let Some(sampler) = o.sampler_at(0, DVec3::ZERO, normal) else { return 0.0 };
                    let square = |pixel| {
                        let sum: f64 = (0..16)
                            .filter_map(|i| sampler.sample(&Points2::new(7, pixel, 0), i))
                            .map(|(_, contribution)| contribution)
                            .sum();
                        (sum / 16.0 / exact.max(1e-30) - 1.0).powi(2)
                    };
                    (0..pixels).map(square).sum::<f64>() / f64::from(pixels)
                };
                let [best, area, lobe] =
                    [Strategy::Best, Strategy::Area, Strategy::Lobe].map(variance);
                // 5 %, and three standard errors of the quotient of two variances.
                let bound = 1.05 + 3.0 * (4.0 / f64::from(pixels)).sqrt();
                assert!(
                    best <= bound * area.min(lobe) + 1e-12,
                    "{name} {bandwidth}: {best} {area} {lobe}"
                );
            }
        }
    }
}
