//! One-sided rectangles: irradiance in closed form, and uniform sampling of their solid angle.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};

use super::polygon::{Outline, triangle_solid_angle};
use crate::tuning::tuning;

/// A rectangle that emits to the side of its normal.
#[derive(Clone, Copy)]
pub struct Rectangle {
    center: DVec3,
    /// Half edges, orthogonal.
    x: DVec3,
    y: DVec3,
    normal: DVec3,
}

impl Rectangle {
    /// The rectangle of half edges `x` and `y`, meters, `y` made orthogonal to `x`; `None` without
    /// area or with a number that is not finite.
    pub fn new(center: Vec3, x: Vec3, y: Vec3) -> Option<Rectangle> {
        let (center, x, y) = (center.as_dvec3(), x.as_dvec3(), y.as_dvec3());
        let y = y - x * (x.dot(y) / x.length_squared());
        let normal = x.cross(y).try_normalize()?;
        (center.is_finite() && x.is_finite() && y.is_finite()).then_some(Rectangle {
            center,
            x,
            y,
            normal,
        })
    }

    /// The height of `point` over the emitting side, meters; positive in front.
    pub fn height(&self, point: DVec3) -> f64 {
        self.normal.dot(point - self.center)
    }

    fn area(&self) -> f64 {
        4.0 * self.x.length() * self.y.length()
    }

    /// The outline, seen from `point`, of the part above the horizon of `normal`; `None` on or
    /// behind the rectangle's plane.
    pub fn outline(&self, point: DVec3, normal: DVec3) -> Option<Outline> {
        if self.height(point) <= 0.0 {
            return None;
        }
        let d = self.center - point;
        Outline::above(
            &[d - self.x - self.y, d + self.x - self.y, d + self.x + self.y, d - self.x + self.y],
            normal,
        )
    }

    /// The irradiance over pi, E / L in 0..=1, at `point` with the unit `normal`; zero on or behind
    /// the rectangle's plane.
    pub fn irradiance(&self, point: DVec3, normal: DVec3) -> f64 {
        self.outline(point, normal).map_or(0.0, |outline| outline.irradiance(normal))
    }

    /// The intersection of the ray from `point` along `direction` with the rectangle's plane from
    /// its front, relative to `point`.
    pub fn intersect_plane(&self, point: DVec3, direction: DVec3) -> Option<DVec3> {
        let (height, fall) = (self.height(point), -self.normal.dot(direction));
        let position = direction * (height / fall);
        (height > 0.0 && fall > 0.0 && position.is_finite()).then_some(position)
    }

    /// The intersection of the ray from `point` along `direction` with the emitting side, relative
    /// to `point`.
    pub fn intersect(&self, point: DVec3, direction: DVec3) -> Option<DVec3> {
        let position = self.intersect_plane(point, direction)?;
        let at = point + position - self.center;
        let inside = |edge: DVec3| at.dot(edge).abs() <= edge.length_squared();
        (inside(self.x) && inside(self.y)).then_some(position)
    }

    /// The sampler of the solid angle at `point`; `None` on or behind the plane.
    pub fn sampler_at(&self, point: DVec3) -> Option<RectangleSampler> {
        let height = self.height(point);
        (height > 0.0).then(|| RectangleSampler::new(self, point, height))
    }
}

/// A uniform sampler of the solid angle of a rectangle at a point: Ureña, Fajardo and King, "An
/// Area-Preserving Parametrization for Spherical Rectangles", EGSR 2013.
///
/// It is uniform over the area instead where that solid angle is too small to be computed as the
/// difference of four angles.
pub struct RectangleSampler {
    axes: [DVec3; 3],
    /// The rectangle in those axes, seen from the origin: x in x0..x1, y in y0..y1, at z0 < 0.
    x: [f64; 2],
    y: [f64; 2],
    z: f64,
    b: [f64; 2],
    k: f64,
    solid_angle: f64,
    /// Zero unless sampling is by area.
    area: f64,
}

tuning! {
    /// Constants of the sampling of rectangles.
    pub const TUNING: RectangleTuning {
        /// Solid angle below which sampling is by area.
        min_solid_angle: f64 = 1e-8,
            unit "steradians", source Derived("there the four angles have lost half of their 15 digits"),
            effect "a larger value samples distant rectangles with more noise";
    }
}

impl RectangleSampler {
    fn new(rectangle: &Rectangle, point: DVec3, height: f64) -> RectangleSampler {
        let (half_x, half_y) = (rectangle.x.length(), rectangle.y.length());
        let axes = [rectangle.x / half_x, rectangle.y / half_y, rectangle.normal];
        let d = rectangle.center - point;
        let (cx, cy) = (d.dot(axes[0]), d.dot(axes[1]));
        let (x, y, z) = ([cx - half_x, cx + half_x], [cy - half_y, cy + half_y], -height);
        // Normals of the four planes through the origin and an edge.
        let corner = |i: usize, j: usize| DVec3::new(x[i], y[j], z);
        let edge = |a: DVec3, b: DVec3| a.cross(b).normalize_or_zero();
        let n = [
            edge(corner(0, 0), corner(1, 0)),
            edge(corner(1, 0), corner(1, 1)),
            edge(corner(1, 1), corner(0, 1)),
            edge(corner(0, 1), corner(0, 0)),
        ];
        let angle = |i: usize| (-n[i].dot(n[(i + 1) % 4])).clamp(-1.0, 1.0).acos();
        let k = TAU - angle(2) - angle(3);
        let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
        let solid_angle = triangle_solid_angle(a, b, c) + triangle_solid_angle(a, c, d);
        let area = if solid_angle > TUNING.min_solid_angle { 0.0 } else { rectangle.area() };
        RectangleSampler { axes, x, y, z, b: [n[0].z, n[2].z], k, solid_angle, area }
    }

    /// A position on the rectangle, relative to the receiver, from a point of the unit square.
    pub fn sample(&self, [u, v]: [f64; 2]) -> DVec3 {
        let ([x0, x1], [y0, y1]) = (self.x, self.y);
        let (x, y) = if self.area > 0.0 {
            (x0 + u * (x1 - x0), y0 + v * (y1 - y0))
        } else {
            let (sin, cos) = (u * self.solid_angle + self.k).sin_cos();
            let f = (cos * self.b[0] - self.b[1]) / sin;
            let c = (f.signum() / (f * f + self.b[0] * self.b[0]).sqrt()).clamp(-1.0, 1.0);
            let x = (-c * self.z / (1.0 - c * c).max(1e-300).sqrt()).clamp(x0, x1);
            let d2 = x * x + self.z * self.z;
            let (h0, h1) = (y0 / (d2 + y0 * y0).sqrt(), y1 / (d2 + y1 * y1).sqrt());
            let h = h0 + v * (h1 - h0);
            let y = if h * h < 1.0 - 1e-12 { h * (d2 / (1.0 - h * h)).sqrt() } else { y1 };
            (x, y.clamp(y0, y1))
        };
        x * self.axes[0] + y * self.axes[1] + self.z * self.axes[2]
    }

    /// The position at fractions `u`, `v` of the edges; the corners of the unit square go where
    /// [`RectangleSampler::sample`] puts them.
    pub fn position(&self, u: f64, v: f64) -> DVec3 {
        let at = |[a, b]: [f64; 2], fraction: f64| a + fraction * (b - a);
        at(self.x, u) * self.axes[0] + at(self.y, v) * self.axes[1] + self.z * self.axes[2]
    }

    /// The density, per steradian, of [`RectangleSampler::sample`] at a position on the rectangle,
    /// relative to the receiver.
    pub fn pdf(&self, position: DVec3) -> f64 {
        if self.area > 0.0 {
            position.length().powi(3) / (self.area * -self.z)
        } else {
            1.0 / self.solid_angle
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn samples_average_to_the_closed_form() {
        let n = 200;
        let shapes = [(1.0, 0.5), (3.0, 3.0), (0.01, 2.0), (1e-3, 1e-3), (1e-5, 1e-5)];
        for (half_x, half_y) in shapes {
            let r = Rectangle::new(Vec3::new(0.4, 1.0, 0.6), Vec3::X * half_x, Vec3::Z * half_y)
                .unwrap();
            assert!(r.height(DVec3::ZERO) > 0.0, "x cross z looks down");
            let normal = DVec3::new(0.1, 0.6, 0.4).normalize();
            let sampler = r.sampler_at(DVec3::ZERO).unwrap();
            let mut sum = 0.0;
            for i in 0..n * n {
                let uv = [((i % n) as f64 + 0.5) / n as f64, ((i / n) as f64 + 0.5) / n as f64];
                let position = sampler.sample(uv);
                assert!(
                    r.intersect(DVec3::ZERO, position.normalize() * 1.000_000_1).is_some()
                        || uv.iter().any(|u| (u - 0.5).abs() > 0.49)
                );
                sum += normal.dot(position.normalize()).max(0.0) / sampler.pdf(position);
            }
            let (sampled, exact) = (sum / (n * n) as f64 / PI, r.irradiance(DVec3::ZERO, normal));
            assert!((sampled / exact - 1.0).abs() < 1e-3, "{half_x} {half_y}: {sampled} {exact}");
        }
    }

    #[test]
    fn nothing_behind_and_nothing_without_area() {
        let r = Rectangle::new(Vec3::ZERO, Vec3::X, Vec3::Y).unwrap();
        assert!(r.irradiance(DVec3::new(0.0, 0.0, 1.0), -DVec3::Z) > 0.4);
        assert_eq!(r.irradiance(DVec3::new(0.0, 0.0, -1.0), DVec3::Z), 0.0, "behind");
        assert_eq!(r.irradiance(DVec3::new(0.3, 0.3, 0.0), DVec3::Z), 0.0, "on it");
        assert!(r.sampler_at(DVec3::ZERO).is_none());
        assert!(Rectangle::new(Vec3::ZERO, Vec3::X, Vec3::X).is_none());
        assert!(Rectangle::new(Vec3::ZERO, Vec3::ZERO, Vec3::Y).is_none());
        assert!(Rectangle::new(Vec3::NAN, Vec3::X, Vec3::Y).is_none());
    }
}
