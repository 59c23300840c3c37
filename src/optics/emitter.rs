//! What a light of unit radiance sends to a point: in closed form, and as samples that rays can follow.
//!
//! E = (1/pi) integral of cos(theta) over the directions in which the light is seen, horizon included, shadows not. The
//! closed forms and the samples describe the same emitter; the sum of a point's samples estimates what the closed form gives.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::polygon::polygon_irradiance;
use super::random::Points2;
use super::rectangle::Rectangle;
use super::sphere::{Cone, sphere_irradiance};
use super::window::Opening;
use super::{Lamp, Plate, Shape};

/// A place on a light and its part of the irradiance (divided by pi) at the point it was sampled from, per lobe of unit
/// radiance; lamps use the first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    pub place: Vec3,
    pub parts: [f32; 3],
}

impl LightSample {
    pub(super) fn new(place: DVec3, parts: [f64; 3]) -> LightSample {
        let usable = |part: f64| if part.is_finite() { part.max(0.0) as f32 } else { 0.0 };
        LightSample { place: place.as_vec3(), parts: parts.map(usable) }
    }
}

/// A light made ready for closed forms and sampling.
pub struct Emitter {
    surface: Surface,
    lobes: usize,
}

enum Surface {
    Nothing,
    Sphere {
        center: DVec3,
        radius: f64,
    },
    /// Rectangles of which those seen from one point do not cover each other: one, or the six sides of a box.
    Sides(Vec<Rectangle>),
    Plates(Pieces<Plate>),
    /// Triangles, counter-clockwise from the front. One does not cover another: exact for convex shapes.
    Triangles(Pieces<[DVec3; 3]>),
    Window(Opening),
}

/// Pieces of surface and the running sum of their areas.
struct Pieces<T> {
    pieces: Vec<T>,
    sums: Vec<f64>,
}

/// Up to this many pieces are added one by one; of more, samples are taken.
const EXACT_PIECES: usize = 512;

impl<T> Pieces<T> {
    fn new(pieces: impl Iterator<Item = (T, f64)>) -> Pieces<T> {
        let mut total = 0.0;
        let (pieces, sums) = pieces
            .filter(|(_, area)| *area > 0.0 && area.is_finite())
            .map(|(piece, area)| {
                total += area;
                (piece, total)
            })
            .unzip();
        Pieces { pieces, sums }
    }

    fn area(&self) -> f64 {
        self.sums.last().copied().unwrap_or(0.0)
    }

    /// The piece in which the share `u` of the area ends, its area, and how far into it `u` goes (0..1).
    fn at(&self, u: f64) -> (&T, f64, f64) {
        let target = u * self.area();
        let i = self.sums.partition_point(|&sum| sum <= target).min(self.pieces.len() - 1);
        let before = if i == 0 { 0.0 } else { self.sums[i - 1] };
        let area = self.sums[i] - before;
        (&self.pieces[i], area, ((target - before) / area).clamp(0.0, 1.0))
    }
}

impl Emitter {
    /// Prepares a light. What has no size or is not finite emits nothing.
    pub fn new(shape: &Shape) -> Emitter {
        let rectangle = |center: Vec3, x: Vec3, y: Vec3| Rectangle::new(center, x, y);
        let surface = match shape {
            Shape::Absent => Surface::Nothing,
            Shape::Window(window) => Opening::new(window).map_or(Surface::Nothing, Surface::Window),
            Shape::Lamp(Lamp::Sphere { center, radius }) => {
                let sound = center.is_finite() && radius.is_finite() && *radius > 0.0;
                let sphere = Surface::Sphere { center: center.as_dvec3(), radius: f64::from(*radius) };
                if sound { sphere } else { Surface::Nothing }
            }
            Shape::Lamp(Lamp::Rect { center, x, y }) => {
                Surface::Sides(rectangle(*center, *x, *y).into_iter().collect())
            }
            Shape::Lamp(Lamp::Box { center, axes }) => {
                let [x, y, z] = *axes;
                // The other two axes of each side, ordered so that their cross product points outwards.
                let hand = if x.cross(y).dot(z) < 0.0 { -1.0 } else { 1.0 };
                let side = |out: Vec3, a: Vec3, b: Vec3| {
                    [rectangle(center + out, a * hand, b), rectangle(center - out, b, a * hand)]
                };
                Surface::Sides([side(x, y, z), side(y, z, x), side(z, x, y)].into_iter().flatten().flatten().collect())
            }
            Shape::Lamp(Lamp::Plates(plates)) => {
                let sound = plates.iter().filter(|p| p.point.is_finite() && p.normal.is_finite());
                Surface::Plates(Pieces::new(sound.map(|plate| (*plate, f64::from(plate.area)))))
            }
            Shape::Lamp(Lamp::Mesh { corners, triangles }) => {
                let corner = |i: u32| corners.get(i as usize).filter(|p| p.is_finite()).map(|p| p.as_dvec3());
                let whole = triangles.iter().filter_map(|&[a, b, c]| Some([corner(a)?, corner(b)?, corner(c)?]));
                Surface::Triangles(Pieces::new(whole.map(|t| (t, 0.5 * (t[1] - t[0]).cross(t[2] - t[0]).length()))))
            }
        };
        Emitter { surface, lobes: shape.lobes() }
    }

    /// How many lobes the light has: 0, 1 or 3.
    pub fn lobes(&self) -> usize {
        self.lobes
    }

    /// E / L in closed form, or `None` where there is none (windows) or it would be slower than sampling.
    pub fn irradiance(&self, point: Vec3, normal: Vec3) -> Option<f32> {
        let (point, normal) = (point.as_dvec3(), normal.as_dvec3());
        let e: f64 = match &self.surface {
            Surface::Nothing => 0.0,
            Surface::Sphere { center, radius } => sphere_irradiance(*center - point, *radius, normal),
            Surface::Sides(sides) => sides.iter().map(|side| side.irradiance(point, normal)).sum(),
            Surface::Plates(plates) if plates.pieces.len() <= EXACT_PIECES => {
                plates.pieces.iter().map(|plate| plate_irradiance(plate, point, normal)).sum()
            }
            Surface::Triangles(triangles) if triangles.pieces.len() <= EXACT_PIECES => {
                triangles.pieces.iter().map(|t| triangle_irradiance(t, point, normal)).sum()
            }
            _ => return None,
        };
        Some(if e.is_finite() { e as f32 } else { 0.0 })
    }

    /// Replaces `out` by about `n` samples towards the light; their parts add up to an unbiased estimate of E / L per lobe.
    /// Directions that cannot contribute are left out and count as zero.
    pub fn sample(&self, point: Vec3, normal: Vec3, n: usize, seed: u64, pixel: u32, out: &mut Vec<LightSample>) {
        out.clear();
        if !(point.is_finite() && normal.is_finite()) || n == 0 {
            return;
        }
        let (point, normal) = (point.as_dvec3(), normal.as_dvec3());
        let points = Points2::new(seed, pixel, 0);
        let share = 1.0 / n as f64;
        let mut add = |place: DVec3, part: f64| {
            if part > 0.0 {
                out.push(LightSample::new(place, [part, 0.0, 0.0]));
            }
        };
        match &self.surface {
            Surface::Nothing => {}
            Surface::Sphere { center, radius } => {
                let Some(cone) = Cone::new(*center - point, *radius) else { return };
                for i in 0..n {
                    let (direction, place) = cone.sample(points.get(i));
                    add(point + place, normal.dot(direction) * cone.solid_angle() * share / PI);
                }
            }
            Surface::Sides(sides) => {
                let seen = sides.iter().filter_map(|side| side.seen_from(point).map(|s| (s.solid_angle(), s)));
                let seen = Pieces::new(seen.map(|(solid_angle, s)| (s, solid_angle)));
                if seen.pieces.is_empty() {
                    return;
                }
                for i in 0..n {
                    let [u, v] = points.get(i);
                    let (side, solid_angle, u) = seen.at(u);
                    let place = side.sample([u, v]);
                    let cos = normal.dot(place.normalize_or_zero());
                    add(point + place, cos / side.pdf(place) * (seen.area() / solid_angle) * share / PI);
                }
            }
            Surface::Plates(plates) if !plates.pieces.is_empty() => {
                let [start, _] = points.get(0);
                for i in 0..n {
                    let (plate, area, _) = plates.at((i as f64 + start) * share);
                    add(
                        plate.point.as_dvec3(),
                        plate_irradiance(plate, point, normal) * (plates.area() / area) * share,
                    );
                }
            }
            Surface::Triangles(triangles) if !triangles.pieces.is_empty() => {
                for i in 0..n {
                    let [u, v] = points.get(i);
                    let (t, _, u) = triangles.at(u);
                    let root = u.sqrt();
                    let place = t[0] + (t[1] - t[0]) * (root * (1.0 - v)) + (t[2] - t[0]) * (root * v);
                    let (d, front) = (place - point, (t[1] - t[0]).cross(t[2] - t[0]).normalize_or_zero());
                    let cosines = normal.dot(d).max(0.0) * -front.dot(d);
                    add(place, cosines / (PI * d.length_squared().powi(2)) * triangles.area() * share);
                }
            }
            Surface::Plates(_) | Surface::Triangles(_) => {}
            Surface::Window(opening) => opening.sample(point, normal, n, seed, pixel, out),
        }
    }
}

/// A small disc: cos cos' A / (pi d^2 + A), which is exact on its axis and stays below one however near it is.
fn plate_irradiance(plate: &Plate, point: DVec3, normal: DVec3) -> f64 {
    let d = plate.point.as_dvec3() - point;
    let distance_squared = d.length_squared().max(1e-18);
    let cosines = normal.dot(d).max(0.0) * (-plate.normal.as_dvec3().dot(d)).max(0.0) / distance_squared;
    let area = f64::from(plate.area);
    cosines * area / (PI * distance_squared + area)
}

fn triangle_irradiance(t: &[DVec3; 3], point: DVec3, normal: DVec3) -> f64 {
    let front = (t[1] - t[0]).cross(t[2] - t[0]).dot(point - t[0]) > 0.0;
    if front { polygon_irradiance(&t.map(|corner| corner - point), normal) } else { 0.0 }
}

/// Sum and standard error of each lobe's parts, of `n` samples of which those missing are zero. The samples are stratified,
/// so the error is an upper bound.
pub fn estimate(samples: &[LightSample], n: usize) -> ([f32; 3], [f32; 3]) {
    let sum = |k: usize| samples.iter().map(|s| s.parts[k]).sum::<f32>();
    let squares = |k: usize| samples.iter().map(|s| s.parts[k] * s.parts[k]).sum::<f32>();
    let n = n as f32;
    let e = [sum(0), sum(1), sum(2)];
    let error = |k: usize| ((squares(k) - e[k] * e[k] / n).max(0.0) * n / (n - 1.0).max(1.0)).sqrt();
    (e, [error(0), error(1), error(2)])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lamps() -> Vec<(&'static str, Lamp)> {
        let plate = |i: usize| {
            let normal = Vec3::new((i as f32).sin(), -1.0, (i as f32 * 2.0).cos()).normalize();
            Plate { point: Vec3::new(0.1 * i as f32, 1.5, 0.05 * i as f32), normal, area: 0.01 + 0.002 * i as f32 }
        };
        let axes = [Vec3::X * 0.3, Vec3::new(0.0, 0.2, 0.1), Vec3::new(0.0, -0.1, 0.2)];
        let tetrahedron = vec![
            Vec3::new(0.0, 1.0, 0.0),
            Vec3::new(0.5, 1.2, 0.0),
            Vec3::new(0.0, 1.7, 0.1),
            Vec3::new(0.1, 1.2, 0.6),
        ];
        vec![
            ("sphere", Lamp::Sphere { center: Vec3::new(0.5, 0.8, 0.2), radius: 0.3 }),
            ("sphere on the horizon", Lamp::Sphere { center: Vec3::new(1.0, 0.1, 0.2), radius: 0.5 }),
            ("rectangle", Lamp::Rect { center: Vec3::new(0.3, 1.0, 0.2), x: Vec3::X * 0.6, y: Vec3::Z * 0.4 }),
            (
                "rectangle through the horizon",
                Lamp::Rect { center: Vec3::new(1.0, 0.1, 0.0), x: Vec3::Z * 0.6, y: Vec3::Y * 0.6 },
            ),
            ("box", Lamp::Box { center: Vec3::new(0.4, 0.9, 0.1), axes }),
            ("left-handed box", Lamp::Box { center: Vec3::new(0.4, 0.9, 0.1), axes: [axes[1], axes[0], axes[2]] }),
            ("plates", Lamp::Plates((0..20).map(plate).collect())),
            ("mesh", Lamp::Mesh { corners: tetrahedron, triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]] }),
        ]
    }

    #[test]
    fn samples_agree_with_the_closed_forms() {
        for (name, lamp) in lamps() {
            let emitter = Emitter::new(&Shape::Lamp(lamp));
            for normal in [Vec3::Y, Vec3::new(-0.4, 0.7, 0.2).normalize(), Vec3::X] {
                let exact = f64::from(emitter.irradiance(Vec3::ZERO, normal).unwrap());
                let (pixels, mut out) = (4000, Vec::new());
                let (mut mean, mut square, mut claimed) = (0.0, 0.0, 0.0);
                for pixel in 0..pixels {
                    emitter.sample(Vec3::ZERO, normal, 16, 3, pixel, &mut out);
                    let (e, error) = estimate(&out, 16);
                    mean += f64::from(e[0]) / f64::from(pixels);
                    square += f64::from(e[0]).powi(2) / f64::from(pixels);
                    claimed += f64::from(error[0]).powi(2) / f64::from(pixels);
                }
                let variance = (square - mean * mean).max(0.0);
                // 24 comparisons: four standard errors, and single-precision rounding.
                let bound = 4.0 * (variance / f64::from(pixels)).sqrt() + 2e-6;
                assert!((mean - exact).abs() < bound, "{name} {normal}: {mean} {exact} {bound}");
                assert!(variance <= 1.1 * claimed + 1e-12, "{name}: the claimed error is an upper bound");
            }
        }
    }

    #[test]
    fn both_hands_of_a_box_are_the_same_box() {
        let all = lamps();
        let e = |i: usize| Emitter::new(&Shape::Lamp(all[i].1.clone())).irradiance(Vec3::ZERO, Vec3::Y).unwrap();
        assert!((e(4) - e(5)).abs() < 1e-6 && e(4) > 0.01, "{} {}", e(4), e(5));
    }

    #[test]
    fn many_plates_are_sampled_to_the_same_sum() {
        let plate = |i: usize| Plate {
            point: Vec3::new((i as f32 * 0.618).fract(), 1.0, (i as f32 * 0.755).fract()),
            normal: Vec3::NEG_Y,
            area: 1e-3,
        };
        let emitter = Emitter::new(&Shape::Lamp(Lamp::Plates((0..1000).map(plate).collect())));
        assert!(emitter.irradiance(Vec3::ZERO, Vec3::Y).is_none());
        let exact: f64 = (0..1000).map(|i| plate_irradiance(&plate(i), DVec3::ZERO, DVec3::Y)).sum();
        let (mut out, mut mean) = (Vec::new(), 0.0);
        for pixel in 0..500 {
            emitter.sample(Vec3::ZERO, Vec3::Y, 32, 1, pixel, &mut out);
            mean += f64::from(estimate(&out, 32).0[0]) / 500.0;
        }
        // 32 of 1000 plates whose parts differ by a factor of 9: 5 % a pixel, 0.3 % over 500.
        assert!((mean / exact - 1.0).abs() < 0.01, "{mean} {exact}");
    }

    #[test]
    fn whatever_the_light_and_the_point_the_answer_is_finite_and_not_negative() {
        let strange = [Vec3::ZERO, Vec3::X, Vec3::splat(1e-30), Vec3::splat(1e20), Vec3::NAN, Vec3::INFINITY];
        let mut out = Vec::new();
        for a in strange {
            for b in strange {
                let shapes = [
                    Shape::Absent,
                    Shape::Lamp(Lamp::Sphere { center: a, radius: b.x }),
                    Shape::Lamp(Lamp::Rect { center: a, x: b, y: Vec3::Y }),
                    Shape::Lamp(Lamp::Box { center: a, axes: [b, Vec3::Y, Vec3::Z] }),
                    Shape::Lamp(Lamp::Plates(vec![Plate { point: a, normal: b, area: 1.0 }])),
                    Shape::Lamp(Lamp::Plates(Vec::new())),
                    Shape::Lamp(Lamp::Mesh { corners: vec![a, b, Vec3::Z], triangles: vec![[0, 1, 2], [0, 1, 9]] }),
                    Shape::Window(crate::optics::Window {
                        center: a,
                        x: b,
                        y: Vec3::Z,
                        lobes: [0.0, 1e7, f32::NAN].map(|bandwidth| crate::optics::Lobe { direction: b, bandwidth }),
                    }),
                ];
                for emitter in shapes.iter().map(Emitter::new) {
                    for point in strange {
                        let e = emitter.irradiance(point, Vec3::Y).unwrap_or(0.0);
                        assert!(e.is_finite() && e >= 0.0);
                        emitter.sample(point, Vec3::Y, 8, 0, 0, &mut out);
                        assert!(out.iter().all(|s| s.parts.iter().all(|p| p.is_finite() && *p >= 0.0)));
                    }
                }
            }
        }
    }
}
