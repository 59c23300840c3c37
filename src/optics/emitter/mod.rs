//! What a light of unit radiance sends to a point: in closed form, and as samples that rays can follow.
//!
//! E = (1/pi) integral of cos(theta) over the directions in which the light is seen, horizon included, shadows not. The
//! closed forms and the samples describe the same emitter; each sample's part estimates what the closed form gives.

pub(in crate::optics) mod flux;
pub(in crate::optics) mod gradient;
pub(in crate::optics) mod light;
pub(in crate::optics) mod model;
pub(in crate::optics) mod photometric_web;
pub(in crate::optics) mod sphere;
pub(in crate::optics) mod window;

pub use flux::flux;
pub use gradient::Gradient;
pub use light::{LOBES, Lamp, LightKind, Lobe, Plate, Radiance, Shape, Window};
pub use model::{Silhouette, escaping};
pub use photometric_web::{Profile, ProfileTable};
pub use sphere::sphere_irradiance;
pub use window::Strategy;

use std::borrow::Cow;
use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use crate::optics::sampling::Points2;
use crate::optics::sampling::polygon::{Outline, polygon_irradiance};
use crate::optics::sampling::product_sampler::Through;
use crate::optics::sampling::rectangle::Rectangle;
use model::{ModelLamp, SeenModel, is_convex};
use sphere::Cone;
use window::{Opening, SeenOpening};

/// A place on a light and its part of the irradiance (divided by pi) of one lobe of unit radiance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    pub place: Vec3,
    /// Positive and finite.
    pub part: f32,
}

/// A light made ready for closed forms and sampling.
pub struct Emitter {
    pub(in crate::optics) surface: Surface,
    lobes: usize,
    /// Of a luminaire: where its far field begins, and how it goes.
    profile: Option<(DVec3, Profile)>,
}

pub(in crate::optics) enum Surface {
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
    Model(ModelLamp),
    Window(Opening),
}

/// Pieces of surface and the running sum of their areas.
pub(in crate::optics) struct Pieces<T> {
    pub(in crate::optics) pieces: Vec<T>,
    areas: Vec<f64>,
}

/// Up to this many pieces are added one by one; of more, samples are taken.
const EXACT_PIECES: usize = 512;

impl<T> Pieces<T> {
    fn new(pieces: impl Iterator<Item = (T, f64)>) -> Pieces<T> {
        let (pieces, areas): (_, Vec<f64>) = pieces.filter(|(_, area)| *area > 0.0 && area.is_finite()).unzip();
        Pieces { pieces, areas: running(areas) }
    }

    /// Pieces to be chosen by what arrives from each, or of many by their areas; `None` where nothing arrives.
    fn seen(&self, part: impl Fn(&T) -> f64) -> Option<SeenPieces<'_, T>> {
        let sums = if self.pieces.len() > EXACT_PIECES {
            Cow::Borrowed(&self.areas[..])
        } else {
            Cow::Owned(running(self.pieces.iter().map(part)))
        };
        let total = *sums.last()?;
        (total > 0.0 && total.is_finite()).then_some(SeenPieces { pieces: &self.pieces, sums, total })
    }
}

fn running(weights: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let add = |sum: &mut f64, weight: f64| {
        *sum += weight;
        Some(*sum)
    };
    weights.into_iter().scan(0.0, add).collect()
}

/// Pieces of surface and the running sum of their weights.
struct SeenPieces<'a, T> {
    pieces: &'a [T],
    sums: Cow<'a, [f64]>,
    total: f64,
}

impl<T> SeenPieces<'_, T> {
    /// The piece in which the share `u` of the weights ends, one over its own share, and how far into it `u` goes (0..1).
    fn at(&self, u: f64) -> (&T, f64, f64) {
        let target = u * self.total;
        let i = self.sums.partition_point(|&sum| sum <= target).min(self.pieces.len() - 1);
        let before = if i == 0 { 0.0 } else { self.sums[i - 1] };
        let weight = self.sums[i] - before;
        (&self.pieces[i], self.total / weight, ((target - before) / weight).clamp(0.0, 1.0))
    }
}

impl Emitter {
    /// Prepares a light. What has no size or is not finite emits nothing.
    pub fn new(shape: &Shape) -> Emitter {
        Emitter::with_strategy(shape, Strategy::Best)
    }

    /// As [`Emitter::new`], the directions to a window coming from `strategy`.
    pub fn with_strategy(shape: &Shape, strategy: Strategy) -> Emitter {
        let rectangle = |center: Vec3, x: Vec3, y: Vec3| Rectangle::new(center, x, y);
        let surface = match shape {
            Shape::Absent => Surface::Nothing,
            Shape::Window(window) => Opening::new(window, strategy).map_or(Surface::Nothing, Surface::Window),
            Shape::Lamp(Lamp::Sphere { center, radius } | Lamp::Luminaire { center, radius, .. }) => {
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
            Shape::Lamp(Lamp::Model { corners, triangles })
                if triangles.len() > EXACT_PIECES || !is_convex(corners, triangles) =>
            {
                ModelLamp::new(corners, triangles).map_or(Surface::Nothing, Surface::Model)
            }
            Shape::Lamp(Lamp::Mesh { corners, triangles } | Lamp::Model { corners, triangles }) => {
                let corner = |i: u32| corners.get(i as usize).filter(|p| p.is_finite()).map(|p| p.as_dvec3());
                let whole = triangles.iter().filter_map(|&[a, b, c]| Some([corner(a)?, corner(b)?, corner(c)?]));
                Surface::Triangles(Pieces::new(whole.map(|t| (t, 0.5 * (t[1] - t[0]).cross(t[2] - t[0]).length()))))
            }
        };
        let profile = match shape {
            Shape::Lamp(Lamp::Luminaire { center, profile, .. }) => Some((center.as_dvec3(), profile.clone())),
            _ => None,
        };
        Emitter { surface, lobes: shape.lobes(), profile }
    }

    /// How many lobes the light has: 0, 1 or 3.
    pub fn lobes(&self) -> usize {
        self.lobes
    }

    /// E / L of one lobe in closed form, or `None` where there is none or it would be slower than sampling.
    pub fn irradiance(&self, lobe: usize, point: Vec3, normal: Vec3) -> Option<f32> {
        let (point, normal) = (point.as_dvec3(), normal.as_dvec3());
        let e: f64 = match &self.surface {
            Surface::Nothing => 0.0,
            Surface::Sphere { center, radius } => sphere_irradiance(*center - point, *radius, normal),
            Surface::Sides(sides) => sides.iter().map(|side| side.irradiance(point, normal)).sum(),
            Surface::Plates(plates) if plates.pieces.len() <= EXACT_PIECES => {
                plates.pieces.iter().map(|plate| plate_part(plate, point, normal).1).sum()
            }
            Surface::Triangles(triangles) if triangles.pieces.len() <= EXACT_PIECES => {
                triangles.pieces.iter().map(|t| triangle_irradiance(t, point, normal)).sum()
            }
            Surface::Window(opening) => opening.irradiance(lobe, point, normal),
            _ => return None,
        };
        let e = e * self.share(point);
        Some(if e.is_finite() { e as f32 } else { 0.0 })
    }

    /// What a profile sends towards a point, over what a sphere of even radiance would.
    fn share(&self, point: DVec3) -> f64 {
        self.profile.as_ref().map_or(1.0, |(center, profile)| profile.share((point - *center).normalize_or_zero()))
    }

    /// One lobe of the light as a receiver sees it, ready for sampling; `None` when none of it can be seen from there.
    pub fn seen(&self, lobe: usize, point: Vec3, normal: Vec3) -> Option<Seen<'_>> {
        if !(point.is_finite() && normal.is_finite()) {
            return None;
        }
        let (point, normal) = (point.as_dvec3(), normal.as_dvec3());
        let surface = match &self.surface {
            Surface::Nothing => return None,
            Surface::Sphere { center, radius } => SeenSurface::Sphere(Cone::new(*center - point, *radius, normal)?),
            Surface::Sides(sides) => SeenSurface::Sides(SeenSides::new(sides, (point, normal))?),
            Surface::Plates(plates) => SeenSurface::Plates(plates.seen(|plate| plate_part(plate, point, normal).1)?),
            Surface::Triangles(triangles) => {
                SeenSurface::Triangles(triangles.seen(|t| triangle_irradiance(t, point, normal))?)
            }
            Surface::Model(model) => SeenSurface::Model(model.seen(point, normal)?),
            Surface::Window(opening) => SeenSurface::Window(opening.seen(lobe, point, normal)?),
        };
        let share = self.share(point);
        (share > 0.0).then_some(Seen { point, normal, share, surface })
    }
}

/// One lobe of a light as one receiver sees it.
pub struct Seen<'a> {
    point: DVec3,
    normal: DVec3,
    /// By which its parts are multiplied.
    share: f64,
    surface: SeenSurface<'a>,
}

#[expect(clippy::large_enum_variant, reason = "one at a time, on the stack; a heap cell per receiver would cost more")]
enum SeenSurface<'a> {
    Sphere(Cone),
    Sides(SeenSides<'a>),
    Plates(SeenPieces<'a, Plate>),
    Triangles(SeenPieces<'a, [DVec3; 3]>),
    Model(SeenModel<'a>),
    Window(SeenOpening<'a>),
}

impl Seen<'_> {
    /// The `i`th sample of these `points`; its part is by itself an unbiased estimate of E / L. A direction that cannot contribute
    /// gives `None` and counts as zero.
    pub fn sample(&self, points: &Points2, i: usize) -> Option<LightSample> {
        let Seen { point, normal, .. } = *self;
        let uv = || points.get(i);
        let (place, part) = match &self.surface {
            SeenSurface::Sphere(cone) => {
                let (direction, place, inverse) = cone.sample(uv());
                (point + place, normal.dot(direction) * inverse / PI)
            }
            SeenSurface::Sides(sides) => {
                let (place, part) = sides.sample((point, normal), uv())?;
                (point + place, part)
            }
            SeenSurface::Plates(plates) => {
                let (plate, inverse, _) = plates.at(uv()[0]);
                let (place, part) = plate_part(plate, point, normal);
                (place, part * inverse)
            }
            SeenSurface::Triangles(triangles) => {
                let [x, y] = uv();
                let (t, inverse, u) = triangles.at(x);
                let root = u.sqrt();
                let place = t[0] + (t[1] - t[0]) * (root * (1.0 - y)) + (t[2] - t[0]) * (root * y);
                // As long as twice the triangle is large.
                let (d, front) = (place - point, (t[1] - t[0]).cross(t[2] - t[0]));
                let cosines = normal.dot(d).max(0.0) * -front.dot(d);
                (place, 0.5 * cosines / (PI * d.length_squared().powi(2)) * inverse)
            }
            SeenSurface::Model(model) => model.sample(uv())?,
            SeenSurface::Window(seen) => {
                let (place, part) = seen.sample(points, i)?;
                (point + place, part)
            }
        };
        let part = (part * self.share) as f32;
        (part > 0.0 && part.is_finite()).then(|| LightSample { place: place.as_vec3(), part })
    }
}

/// The sides of a box that face a receiver: at most three.
struct SeenSides<'a> {
    sides: [Option<(&'a Rectangle, Through, f64)>; 3],
    /// E / L of all of them.
    whole: f64,
}

impl<'a> SeenSides<'a> {
    fn new(sides: &'a [Rectangle], (point, normal): (DVec3, DVec3)) -> Option<SeenSides<'a>> {
        let mut seen = sides.iter().filter_map(|side| {
            let outline = side.outline(point, normal)?;
            let part = outline.irradiance(normal);
            let through = Through::new(side, &outline, None, (point, normal))?;
            (part > 0.0).then_some((side, through, part))
        });
        let sides = [seen.next(), seen.next(), seen.next()];
        let whole = sides.iter().flatten().map(|side| side.2).sum();
        (whole > 0.0).then_some(SeenSides { sides, whole })
    }

    /// A place, relative to the receiver, on a side chosen by what arrives from it; and its part.
    fn sample(&self, receiver: (DVec3, DVec3), [u, v]: [f64; 2]) -> Option<(DVec3, f64)> {
        let mut left = u * self.whole;
        let mut sides = self.sides.iter().flatten().peekable();
        while let Some((side, through, part)) = sides.next() {
            if left < *part || sides.peek().is_none() {
                let (place, sampled) = through.sample(side, receiver, [(left / part).min(1.0), v])?;
                return Some((place, sampled * (self.whole / part)));
            }
            left -= part;
        }
        None
    }
}

/// A plate nearer than this many times its edge is a square, of which only what lies above the horizon counts.
pub(in crate::optics) const NEAR: f64 = 8.0;

/// Where a plate shines from, and its E / L. A distant one is a small disc, cos cos' A / (pi d^2 + A), at its centre; it differs
/// from the square by less than 1 %.
fn plate_part(plate: &Plate, point: DVec3, normal: DVec3) -> (DVec3, f64) {
    let (center, front, area) = (plate.point.as_dvec3(), plate.normal.as_dvec3(), f64::from(plate.area));
    let d = center - point;
    let distance_squared = d.length_squared();
    let facing = -front.dot(d);
    if facing <= 0.0 {
        return (center, 0.0);
    }
    if distance_squared > NEAR * NEAR * area {
        let cosines = normal.dot(d).max(0.0) * facing / distance_squared;
        return (center, cosines * area / (PI * distance_squared + area));
    }
    let Some(outline) = Outline::above(&plate_square(front, area).map(|corner| d + corner), normal) else {
        return (center, 0.0);
    };
    let edges = outline.edges();
    let middle = edges.iter().map(|edge| edge.start).sum::<DVec3>() / edges.len() as f64;
    (point + middle, outline.irradiance(normal))
}

/// Corners of a plate's square about its centre, counter-clockwise from its front.
pub(in crate::optics) fn plate_square(front: DVec3, area: f64) -> [DVec3; 4] {
    let front = front.normalize();
    let x = front.any_orthonormal_vector();
    let (x, y) = (x * (0.5 * area.sqrt()), front.cross(x) * (0.5 * area.sqrt()));
    [-x - y, x - y, x + y, y - x]
}

fn triangle_irradiance(t: &[DVec3; 3], point: DVec3, normal: DVec3) -> f64 {
    let front = (t[1] - t[0]).cross(t[2] - t[0]).dot(point - t[0]) > 0.0;
    if front { polygon_irradiance(&t.map(|corner| corner - point), normal) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{estimate, stream};

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
                let exact = f64::from(emitter.irradiance(0, Vec3::ZERO, normal).unwrap());
                let pixels = 4000;
                let (mut mean, mut square, mut claimed) = (0.0, 0.0, 0.0);
                for pixel in 0..pixels {
                    let (e, error) = estimate(&emitter, 0, (Vec3::ZERO, normal), 4, 3, pixel);
                    mean += e / f64::from(pixels);
                    square += e.powi(2) / f64::from(pixels);
                    claimed += error.powi(2) / f64::from(pixels);
                }
                let variance = (square - mean * mean).max(0.0);
                // 24 comparisons: four standard errors, and single-precision rounding.
                let bound = 4.0 * (variance / f64::from(pixels)).sqrt() + 2e-6;
                assert!((mean - exact).abs() < bound, "{name} {normal}: {mean} {exact} {bound}");
                // Of 4000 variances of three degrees of freedom the mean is known to about 2 %.
                let told = (claimed + 1e-12) / (variance + 1e-12);
                assert!((0.85..1.15).contains(&told), "{name} {normal}: claimed over true variance {told}");
            }
        }
    }

    /// I cos / d^2 of the candela of a profile, at angles where the table has them, and samples that agree.
    #[test]
    fn a_luminaire_lights_a_wall_as_its_candela_do() {
        // 100 cd straight down, 40 at 30 degrees, 10 at 60, none from 90.
        let file = "IESNA91\nTILT=NONE\n1 -1 1 4 1 1 2 0 0 0\n1 1 1\n0 30 60 90\n0\n100 40 10 0\n";
        let (table, lumens) = crate::optics::ProfileTable::parse(file).expect("it is sound");
        let radius = 1e-3f32;
        let profile = Profile { axis: Vec3::NEG_Y, side: Vec3::X, table };
        let lamp = Lamp::Luminaire { center: Vec3::Y * 2.0, radius, profile };
        // Radiance per lumen of the body, in units where a white surface under pi lux shows 1: flux / (area lux).
        let lux = 500.0;
        let radiance = lumens / (f64::from(lamp.area()) * lux);
        let emitter = Emitter::new(&Shape::Lamp(lamp));
        for (degrees, candela) in [(0.0f64, 100.0), (30.0, 40.0), (60.0, 10.0), (15.0, 70.0)] {
            let place = Vec3::X * (2.0 * degrees.to_radians().tan()) as f32;
            let distance = 2.0 / degrees.to_radians().cos();
            let wanted = candela * degrees.to_radians().cos() / distance.powi(2) / lux;
            let exact = emitter.irradiance(0, place, Vec3::Y).unwrap();
            let got = f64::from(exact) * radiance;
            assert!((got / wanted - 1.0).abs() < 1e-4, "{degrees}: {got} for {wanted}");
            let (sampled, _) = estimate(&emitter, 0, (place, Vec3::Y), 4, 3, 1);
            assert!((sampled / f64::from(exact) - 1.0).abs() < 1e-3, "{degrees}: {sampled} {exact}");
        }
        assert!(emitter.seen(0, Vec3::Y * 3.0, Vec3::NEG_Y).is_none(), "nothing goes up");
    }

    #[test]
    fn both_hands_of_a_box_are_the_same_box() {
        let all = lamps();
        let e = |i: usize| Emitter::new(&Shape::Lamp(all[i].1.clone())).irradiance(0, Vec3::ZERO, Vec3::Y).unwrap();
        assert!((e(4) - e(5)).abs() < 1e-6 && e(4) > 0.01, "{} {}", e(4), e(5));
    }

    #[test]
    fn pieces_are_chosen_by_what_arrives() {
        for (name, bound) in [("plates", 1e-6), ("mesh", 0.5)] {
            let lamp = lamps().into_iter().find(|(other, _)| *other == name).unwrap().1;
            let emitter = Emitter::new(&Shape::Lamp(lamp));
            for normal in [Vec3::Y, Vec3::new(-0.4, 0.7, 0.2).normalize(), Vec3::X] {
                let exact = emitter.irradiance(0, Vec3::ZERO, normal).unwrap();
                let seen = emitter.seen(0, Vec3::ZERO, normal).unwrap();
                // No sample is lost on a piece that faces away. The parts of plates are all alike.
                let parts = (0..64).map(|i| seen.sample(&stream(3, 7, 0, 0), i).unwrap().part);
                let spread = parts.map(|part| (part / exact - 1.0).powi(2)).sum::<f32>() / 64.0;
                assert!(spread.sqrt() < bound, "{name} {normal}: {}", spread.sqrt());
            }
        }
    }

    #[test]
    fn many_plates_are_sampled_to_the_same_sum() {
        let plate = |i: usize| Plate {
            point: Vec3::new((i as f32 * 0.618).fract(), 1.0, (i as f32 * 0.755).fract()),
            normal: Vec3::NEG_Y,
            area: 1e-3,
        };
        let emitter = Emitter::new(&Shape::Lamp(Lamp::Plates((0..1000).map(plate).collect())));
        assert!(emitter.irradiance(0, Vec3::ZERO, Vec3::Y).is_none());
        let exact: f64 = (0..1000).map(|i| plate_part(&plate(i), DVec3::ZERO, DVec3::Y).1).sum();
        let mean =
            (0..500).map(|pixel| estimate(&emitter, 0, (Vec3::ZERO, Vec3::Y), 8, 1, pixel).0).sum::<f64>() / 500.0;
        // 32 of 1000 plates whose parts differ by a factor of 9: 5 % a pixel, 0.3 % over 500.
        assert!((mean / exact - 1.0).abs() < 0.01, "{mean} {exact}");
    }

    #[test]
    fn whatever_the_light_and_the_point_the_answer_is_finite_and_not_negative() {
        let strange = [Vec3::ZERO, Vec3::X, Vec3::splat(1e-30), Vec3::splat(1e20), Vec3::NAN, Vec3::INFINITY];
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
                        for lobe in 0..emitter.lobes() {
                            let e = emitter.irradiance(lobe, point, Vec3::Y).unwrap_or(0.0);
                            assert!(e.is_finite() && e >= 0.0);
                            let seen = emitter.seen(lobe, point, Vec3::Y);
                            let samples = (0..8).filter_map(|i| seen.as_ref()?.sample(&stream(0, 0, 0, 0), i));
                            samples.for_each(|sample| assert!(sample.part.is_finite() && sample.part > 0.0));
                        }
                    }
                }
            }
        }
    }
}
