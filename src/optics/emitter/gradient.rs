//! The gradient of the irradiance by a light's position, size, direction and bandwidth, in closed
//! form.
//!
//! E = (1/pi) integral over the visible outline of G(l) (n . l). By Reynolds' transport theorem a
//! moving outline changes it by the integral over the area that its boundary sweeps: with v the
//! velocity of a boundary point x, nu the outward normal of the arc and phi its length,
//!
//!   dE = (1/pi) contour integral of G (n . l) (v . nu) / |x|.
//!
//! On an edge x lies in the plane through the receiver, so that v = shift + growth (x - pivot)
//! leaves v . nu = shift . nu - growth pivot . nu, the same all along it. The horizon adds nothing:
//! there n . l = 0.
//!
//! A turned lobe is the same as outline and normal turned the other way, and with F = integral of G
//! l (see `lobe_irradiance`)
//!
//!   dE / d turn = -(1/pi) (contour integral of G (n . l) (l x nu) + n x F).
//!
//! The bandwidth stands in the integrands only: E = n . F / pi is differentiated under the contour
//! integrals, with p1' = -p2 and p2'(x) = (e^-x - 2 p2) / x.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::optics::sampling::gaussian::Gaussian;
use crate::optics::sampling::lobe_irradiance::{
    Arc, LOBE_IRRADIANCE, Overlap, p1_p2, p1_p2_of, p2_series,
};
use crate::optics::sampling::polygon::{ArcEdge, Outline};

/// The irradiance over pi of one lobe of unit radiance at a receiver, and its derivatives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gradient {
    /// Irradiance over pi, 0..=1.
    pub value: f64,
    /// Derivative by the position of the light, per meter.
    pub position: DVec3,
    /// Derivative by the logarithm of the light's lengths, which grow about the pivot.
    pub size: f64,
    /// Derivative by the rotation of the lobe's direction about each axis, per radian.
    pub turn: DVec3,
    /// Derivative by the bandwidth.
    pub bandwidth: f64,
}

impl Gradient {
    /// The gradient of a sum.
    pub(super) fn plus(self, other: Gradient) -> Gradient {
        Gradient {
            value: self.value + other.value,
            position: self.position + other.position,
            size: self.size + other.size,
            turn: self.turn + other.turn,
            bandwidth: self.bandwidth + other.bandwidth,
        }
    }

    /// This gradient, or zero if any number is not finite.
    pub(super) fn or_zero(self) -> Gradient {
        let Gradient { value, position, size, turn, bandwidth } = self;
        let finite =
            position.is_finite() && turn.is_finite() && (value + size + bandwidth).is_finite();
        if finite { self } else { Gradient::default() }
    }
}

/// The vector whose dot product with the direction of a point x on an edge is 1 / |x|.
fn inverse_distance(edge: &ArcEdge, first: DVec3, forward: DVec3) -> DVec3 {
    let (start, end) = (1.0 / edge.start.length(), 1.0 / edge.end.length());
    let (sin, cos) = edge.angle.sin_cos();
    first * start + forward * ((end - cos * start) / sin)
}

/// The gradient of a moving outline of unit radiance, for a receiver of unit `normal`, by contour
/// integrals in closed form.
pub(super) fn outline_gradient(outline: &Outline, normal: DVec3, pivot: DVec3) -> Gradient {
    let mut gradient = Gradient { value: outline.irradiance(normal), ..Gradient::default() };
    for edge in outline.edges() {
        let first = edge.start.normalize();
        let forward = first.cross(edge.inward);
        let (sin, cos) = edge.angle.sin_cos();
        let moments =
            [0.5 * (edge.angle + sin * cos), 0.5 * sin * sin, 0.5 * (edge.angle - sin * cos)];
        sweep(&mut gradient, edge, [first, forward], [first, forward], normal, pivot, moments);
    }
    gradient
}

/// Adds the contribution of the area that an edge sweeps. `moments` are the integrals of G cos^2, G
/// sin cos and G sin^2 over the arc in the frame of `axes`.
fn sweep(
    gradient: &mut Gradient,
    edge: &ArcEdge,
    [first, forward]: [DVec3; 2],
    axes: [DVec3; 2],
    normal: DVec3,
    pivot: DVec3,
    [cc, sc, ss]: [f64; 3],
) {
    let inverse = inverse_distance(edge, first, forward);
    let [n0, n1] = axes.map(|axis| axis.dot(normal));
    let [k0, k1] = axes.map(|axis| axis.dot(inverse));
    let swept = (n0 * k0 * cc + (n0 * k1 + n1 * k0) * sc + n1 * k1 * ss) / PI;
    gradient.position -= swept * edge.inward;
    gradient.size += swept * pivot.dot(edge.inward);
}

/// The gradient of [`Gaussian::irradiance`] of `lobe`, the outline moving with the rectangle of
/// which it is a part.
pub(super) fn lobe_gradient(
    lobe: &Gaussian,
    outline: &Outline,
    normal: DVec3,
    pivot: DVec3,
) -> Gradient {
    let mut gradient = Gradient::default();
    let overlap = lobe.overlap(outline);
    if overlap == Overlap::Disjoint {
        return gradient;
    }
    let (mean, mean_slope) = mean_and_slope(lobe.bandwidth);
    // F and its derivative with respect to the bandwidth.
    let solid_angle = if overlap == Overlap::Within { 2.0 * TAU } else { outline.solid_angle() };
    let [mut whole, mut slope] =
        [mean, mean_slope].map(|mean| lobe.direction * (mean * solid_angle));
    // Contour integral of G (n . l) (l x nu).
    let mut turned = DVec3::ZERO;
    for edge in outline.edges().iter().filter(|_| overlap == Overlap::Partial) {
        let first = edge.start.normalize();
        let forward = first.cross(edge.inward);
        let arc = Arc::new(lobe, edge);
        let [r, h, r_slope, h_slope, cc, sc, ss] = arc.near(lobe, |sin_half, cos_half| {
            let [r, h, r_slope, h_slope, g] =
                integrands(lobe.bandwidth, arc.rise(sin_half), mean, mean_slope);
            let (sin, cos) = (2.0 * sin_half * cos_half, 1.0 - 2.0 * sin_half * sin_half);
            [r, h, r_slope, h_slope, g * cos * cos, g * sin * cos, g * sin * sin]
        });
        let through = edge.inward.dot(lobe.direction);
        let across = edge.inward - through * lobe.direction;
        let far = 2.0 * arc.beyond();
        whole += lobe.direction * (r * through + mean * far) + across * h;
        slope += lobe.direction * (r_slope * through + mean_slope * far) + across * h_slope;

        let (sin, cos) = arc.nearest.sin_cos();
        let axes = [first * cos + forward * sin, forward * cos - first * sin];
        sweep(&mut gradient, edge, [first, forward], axes, normal, pivot, [cc, sc, ss]);
        let [n0, n1] = axes.map(|axis| axis.dot(normal));
        turned += axes[0] * (n0 * sc + n1 * ss) - axes[1] * (n0 * cc + n1 * sc);
    }
    gradient.value = normal.dot(whole).max(0.0) / PI;
    gradient.turn = -(turned + normal.cross(whole)) / PI;
    gradient.bandwidth = normal.dot(slope) / PI;
    gradient
}

/// The functions R, H, their derivatives with respect to the bandwidth b, and G, at 1 - d . l = t.
fn integrands(b: f64, t: f64, mean: f64, mean_slope: f64) -> [f64; 5] {
    let (x, y) = (b * t, b * (1.0 - t));
    let e = (-x).exp();
    let [p1, p2] = p1_p2_of(x, e);
    let (r, r_slope) = if t < LOBE_IRRADIANCE.pole {
        (
            (p1 - t * p2 - mean) / (2.0 - t),
            -(t * p2 + t * t * p2_slope(x, e, p2) + mean_slope) / (2.0 - t),
        )
    } else {
        (0.5 * (mean + e), 0.5 * mean_slope - e)
    };
    let (h, h_slope) = if y.abs() > LOBE_IRRADIANCE.series {
        let h = ((y - 1.0) * e + (-b).exp()) / (y * y);
        (h, (e - 2.0 * h) / b - h)
    } else {
        let [value, slope] = p2_series(-y).map(|v| v * (-b).exp());
        (value, -value - (1.0 - t) * slope)
    };
    [r, h, r_slope, h_slope, e]
}

/// The mean D and its derivative with respect to the bandwidth.
fn mean_and_slope(b: f64) -> (f64, f64) {
    let [p1, p2] = p1_p2(2.0 * b);
    (p1 - 2.0 * p2, -2.0 * p2 - 4.0 * p2_slope(2.0 * b, (-2.0 * b).exp(), p2))
}

/// The derivative p2'(x), `e` being e^-x.
fn p2_slope(x: f64, e: f64, p2: f64) -> f64 {
    if x > LOBE_IRRADIANCE.series { (e - 2.0 * p2) / x } else { p2_series(x)[1] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{
        BoxLamp, Emitter, Lamp, Lobe, Points2, RectLamp, Shape, SphereLamp, Surfel, Window,
    };
    use glam::Vec3;

    /// The light shifted, grown about `pivot`, its lobes turned by a vector and their bandwidth
    /// raised.
    fn moved(
        shape: &Shape,
        shift: DVec3,
        growth: f64,
        pivot: Vec3,
        turn: DVec3,
        bandwidth: f64,
    ) -> Shape {
        let position =
            |p: Vec3| (shift + pivot.as_dvec3() + (p - pivot).as_dvec3() * growth.exp()).as_vec3();
        let edge = |e: Vec3| (e.as_dvec3() * growth.exp()).as_vec3();
        match shape {
            Shape::Lamp(Lamp::Sphere(SphereLamp { center, radius })) => {
                let radius = radius * growth.exp() as f32;
                Shape::Lamp(Lamp::Sphere(SphereLamp { center: position(*center), radius }))
            }
            Shape::Lamp(Lamp::Rect(RectLamp { center, x, y })) => {
                Shape::Lamp(Lamp::Rect(RectLamp {
                    center: position(*center),
                    x: edge(*x),
                    y: edge(*y),
                }))
            }
            Shape::Lamp(Lamp::Box(BoxLamp { center, axes })) => {
                Shape::Lamp(Lamp::Box(BoxLamp { center: position(*center), axes: axes.map(edge) }))
            }
            Shape::Lamp(Lamp::Surfels(surfels)) => {
                let surfel = |p: &Surfel| Surfel {
                    point: position(p.point),
                    normal: p.normal,
                    area: p.area * (2.0 * growth).exp() as f32,
                };
                Shape::Lamp(Lamp::Surfels(surfels.iter().map(surfel).collect()))
            }
            Shape::Window(Window { center, x, y, lobes }) => {
                let lobe = |l: &Lobe| {
                    let d = l.direction.as_dvec3();
                    let direction = (d + turn.cross(d)).normalize().as_vec3();
                    Lobe { direction, bandwidth: (f64::from(l.bandwidth) + bandwidth) as f32 }
                };
                Shape::Window(Window {
                    center: position(*center),
                    x: edge(*x),
                    y: edge(*y),
                    lobes: lobes.each_ref().map(lobe),
                })
            }
            other => other.clone(),
        }
    }

    /// Central differences. Steps of 1e-3 of a length lose 1e-6 to curvature and 1e-4 to the single
    /// precision of shapes.
    #[track_caller]
    fn check(shape: &Shape, lobe: usize, point: Vec3, normal: Vec3, scale: f64) {
        let (pivot, _) = shape.bounding_sphere().expect("a light");
        let got = Emitter::new(shape).gradient(lobe, point, normal, pivot);
        let value = |s: &Shape| {
            f64::from(Emitter::new(s).irradiance(lobe, point, normal).expect("a closed form"))
        };
        assert!(
            (got.value - value(shape)).abs() <= 1e-6 * value(shape),
            "{} {}",
            got.value,
            value(shape)
        );
        let difference = |step: f64, of: &dyn Fn(f64) -> Shape| {
            (value(&of(step)) - value(&of(-step))) / (2.0 * step)
        };
        let width = match shape {
            Shape::Window(w) => 1.0 / f64::from(w.lobes[lobe].bandwidth).max(1.0).sqrt(),
            _ => 1.0,
        };
        let (zero, h) = (DVec3::ZERO, 3e-3 * width.min(0.3) * scale);
        for axis in DVec3::AXES {
            let by = difference(h, &|t| moved(shape, axis * t, 0.0, pivot, zero, 0.0));
            let tolerance = 2e-2 * (got.position.length() + got.value / scale / width) + 1e-7 / h;
            assert!(
                (by - got.position.dot(axis)).abs() < tolerance,
                "position {axis}: {by} {got:?} {shape:?}"
            );
        }
        let by = difference(h / scale, &|t| moved(shape, zero, t, pivot, zero, 0.0));
        let tolerance = 2e-2 * (got.size.abs() + got.value / width) + 1e-7 / h;
        assert!((by - got.size).abs() < tolerance, "size: {by} {got:?} {shape:?}");
        if let Shape::Window(window) = shape {
            for axis in DVec3::AXES {
                let by =
                    difference(3e-3 * width, &|t| moved(shape, zero, 0.0, pivot, axis * t, 0.0));
                let tolerance = 1e-2 * (got.turn.length() + got.value / width) + 1e-7 / width;
                assert!(
                    (by - got.turn.dot(axis)).abs() < tolerance,
                    "turn {axis}: {by} {got:?} {shape:?}"
                );
            }
            let h = 1e-2 * (f64::from(window.lobes[lobe].bandwidth) + 0.1);
            // A bandwidth is never below zero.
            let from = if window.lobes[lobe].bandwidth > 0.0 { 0.0 } else { h };
            let by = difference(h, &|t| moved(shape, zero, 0.0, pivot, zero, from + t));
            let tolerance = 1e-2 * (got.bandwidth.abs() + 1e-3 * got.value / h) + 1e-8 / h;
            assert!((by - got.bandwidth).abs() < tolerance, "bandwidth: {by} {got:?} {shape:?}");
        }
    }

    #[test]
    fn lamps_agree_with_finite_differences() {
        let points = [0, 1, 2].map(|stream| Points2::new(9, 0, stream));
        for i in 0..60 {
            let [[a, b], [c, d], [e, f]] = points.map(|p| p.get(i).map(|u| u as f32));
            let normal = Vec3::new(a - 0.5, 1.0, b - 0.5).normalize();
            let point = Vec3::new(0.3 * c, 0.0, -0.2 * d);
            // Some of them on the horizon; surfels as discs and as squares, none between.
            let center = Vec3::new(2.0 * (e - 0.5), if i % 3 == 0 { 0.1 } else { 1.0 + f }, 1.0);
            let axes = [Vec3::X * 0.3, Vec3::new(0.0, 0.2, 0.1), Vec3::new(0.0, -0.1, 0.2)];
            let surfel = |k: usize| {
                let normal =
                    Vec3::new((k as f32).sin(), -1.0, -(k as f32 * 2.0).cos().abs()).normalize();
                let point = center + Vec3::new(0.05 * k as f32, 0.3, 0.02 * k as f32);
                Surfel { point, normal, area: if k.is_multiple_of(2) { 0.001 } else { 0.3 } }
            };
            for lamp in [
                Lamp::Sphere(SphereLamp { center, radius: 0.1 + 0.3 * a }),
                Lamp::Rect(RectLamp { center, x: Vec3::X * 0.4, y: Vec3::Z * 0.3 }),
                Lamp::Rect(RectLamp { center, x: Vec3::X * 0.4, y: Vec3::Y * 0.3 }),
                Lamp::Box(BoxLamp { center, axes }),
                Lamp::Surfels((0..6).map(surfel).collect()),
            ] {
                check(&Shape::Lamp(lamp), 0, point, normal, 1.0);
            }
        }
    }

    #[test]
    fn windows_agree_with_finite_differences() {
        let points = [0, 1, 2, 3].map(|stream| Points2::new(10, 0, stream));
        for i in 0..200 {
            let [[a, b], [c, d], [e, f], [g, h]] = points.map(|p| p.get(i).map(|u| u as f32));
            let normal = Vec3::new(a - 0.5, if i % 2 == 0 { 1.0 } else { 0.2 }, b).normalize();
            let center = Vec3::new(c - 0.5, d - 0.2, 1.5);
            // Bandwidths from none to 1e4, aimed in and about the window.
            let bandwidth = if i % 8 == 0 { 0.0 } else { 10f32.powf(-2.0 + 6.0 * e) };
            let (x, y) = (Vec3::NEG_X * 0.5, Vec3::Y * 0.4);
            let aim = center + x * (2.5 * (f - 0.5)) + y * (2.5 * (g - 0.5)) + Vec3::Z * h;
            let lobe = Lobe { direction: aim.normalize(), bandwidth };
            check(
                &Shape::Window(Window { center, x, y, lobes: [lobe; 3] }),
                i % 3,
                Vec3::ZERO,
                normal,
                1.0,
            );
        }
    }

    #[test]
    fn extremes_are_finite() {
        let lobe = |bandwidth| Lobe { direction: Vec3::Z, bandwidth };
        let window = Window {
            center: Vec3::Z,
            x: Vec3::NEG_X,
            y: Vec3::Y,
            lobes: [0.0, 1e5, 1e7].map(lobe),
        };
        let lamps = [0.0, 1e-20, 1.0, 1e20]
            .map(|radius| Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::Z, radius })));
        for shape in lamps.into_iter().chain([Shape::Window(window), Shape::Absent]) {
            let emitter = Emitter::new(&shape);
            for point in [Vec3::ZERO, Vec3::Z, Vec3::Z * (1.0 - 1e-6), Vec3::splat(1e10), Vec3::NAN]
            {
                for lobe in 0..shape.lobes() {
                    let got = emitter.gradient(lobe, point, Vec3::Z, Vec3::Z);
                    assert!(got.position.is_finite() && got.turn.is_finite(), "{got:?}");
                    assert!((got.value + got.size + got.bandwidth).is_finite(), "{got:?}");
                }
            }
        }
    }
}
