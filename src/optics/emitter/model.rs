//! Lamps of any form, from models: what a point sees of them.
//!
//! Parts of such a body hide each other, and there may be a million of them, so there is no sum over all: samples go to places on it,
//! and those that the body itself hides from the receiver count as zero. For little noise a place is chosen in two steps: triangles of
//! like place and like normal stand in one of up to 512 clusters; a cluster is chosen by about what arrives from it, by its area, distance,
//! and the cosines at both ends (after Conty and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting", HPG 2018), a
//! triangle in it by area.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use crate::geometry::{RayMesh, cosine_direction};
use crate::optics::{Lamp, Shape};

/// Clusters that every receiver looks at.
const CLUSTERS: usize = 512;
/// How much a right angle between normals sets two triangles apart, in diagonals of the whole.
const NORMAL: f64 = 0.5;

/// The triangles of a lamp, ready for sampling.
pub(in crate::optics) struct ModelLamp {
    /// In the order of their clusters, with their numbers in `rays`.
    triangles: Vec<([DVec3; 3], u32)>,
    /// Running sum of their areas.
    areas: Vec<f64>,
    clusters: Vec<Cluster>,
    rays: RayMesh,
}

struct Cluster {
    /// One past its last triangle.
    end: usize,
    center: DVec3,
    radius: f64,
    normal: DVec3,
    /// Cosine of the largest angle between `normal` and that of a triangle.
    cone: f64,
    area: f64,
}

/// Twice the area of a triangle, along its normal.
fn front([a, b, c]: &[DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// The triangles of a lamp, none with a corner that is not there, not finite, or without area.
fn sound(corners: &[Vec3], triangles: &[[u32; 3]]) -> Vec<[DVec3; 3]> {
    let corner = |i: u32| corners.get(i as usize).filter(|p| p.is_finite()).map(|p| p.as_dvec3());
    let whole = triangles.iter().filter_map(|&[a, b, c]| Some([corner(a)?, corner(b)?, corner(c)?]));
    whole.filter(|t| front(t).length() > 0.0).collect()
}

fn rays(triangles: impl Iterator<Item = [DVec3; 3]>) -> RayMesh {
    RayMesh::new(triangles.enumerate().map(|(i, t)| (t.map(|p| p.as_vec3()), i as u32)))
}

/// Lowest and highest corner of the box around points.
fn bounds<'a>(points: impl Iterator<Item = &'a DVec3>) -> (DVec3, DVec3) {
    points.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)))
}

/// Whether no triangle lies before another, to a thousandth of the size: asked of few triangles only.
pub(in crate::optics) fn is_convex(corners: &[Vec3], triangles: &[[u32; 3]]) -> bool {
    let triangles = sound(corners, triangles);
    let points = || triangles.iter().flatten();
    let (low, high) = bounds(points());
    let slack = 1e-3 * (high - low).length();
    let behind = |t: &[DVec3; 3]| {
        let normal = front(t).normalize();
        points().all(|&p| normal.dot(p - t[0]) <= slack)
    };
    triangles.iter().all(behind)
}

impl ModelLamp {
    pub(in crate::optics) fn new(corners: &[Vec3], triangles: &[[u32; 3]]) -> Option<ModelLamp> {
        let all = sound(corners, triangles);
        if all.is_empty() {
            return None;
        }
        let mut order: Vec<Key> = Vec::with_capacity(all.len());
        let (low, high) = bounds(all.iter().flatten());
        let unit = NORMAL * (high - low).length();
        for (i, t) in all.iter().enumerate() {
            let (middle, normal) = ((t[0] + t[1] + t[2]) / 3.0, front(t).normalize() * unit);
            order.push(([middle.x, middle.y, middle.z, normal.x, normal.y, normal.z], i as u32));
        }
        let mut ends = Vec::new();
        split(&mut order, 0, CLUSTERS.min(all.len()), &mut ends);
        let triangles: Vec<([DVec3; 3], u32)> = order.iter().map(|&(_, i)| (all[i as usize], i)).collect();
        let mut sum = 0.0;
        let areas = triangles.iter().map(|(t, _)| {
            sum += 0.5 * front(t).length();
            sum
        });
        let areas: Vec<f64> = areas.collect();
        let mut first = 0;
        let clusters =
            ends.into_iter().map(|end| Cluster::new(&triangles[std::mem::replace(&mut first, end)..end], end));
        let clusters = clusters.collect();
        Some(ModelLamp { triangles, areas, clusters, rays: rays(all.into_iter()) })
    }

    /// What a receiver sees of it; `None` where that is nothing.
    pub(in crate::optics) fn seen(&self, point: DVec3, normal: DVec3) -> Option<SeenModel<'_>> {
        let sums: Vec<f64> = self
            .clusters
            .iter()
            .scan(0.0, |sum, cluster| {
                *sum += cluster.weight(point, normal);
                Some(*sum)
            })
            .collect();
        let total = *sums.last()?;
        (total > 0.0 && total.is_finite()).then_some(SeenModel { model: self, point, normal, sums })
    }
}

type Key = ([f64; 6], u32);

/// Halves `keys` along the widest of their axes until there are `parts` groups, and notes where each ends.
fn split(keys: &mut [Key], first: usize, parts: usize, ends: &mut Vec<usize>) {
    if parts <= 1 || keys.len() <= 1 {
        ends.push(first + keys.len());
        return;
    }
    let width = |axis: usize| {
        let (low, high) =
            keys.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), k| (l.min(k.0[axis]), h.max(k.0[axis])));
        high - low
    };
    let widths = [0, 1, 2, 3, 4, 5].map(width);
    let axis = (0..6).fold(0, |best, axis| if widths[axis] > widths[best] { axis } else { best });
    let (left, middle) = (parts / 2, keys.len() * (parts / 2) / parts);
    keys.select_nth_unstable_by(middle, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
    let (low, high) = keys.split_at_mut(middle);
    split(low, first, left, ends);
    split(high, first + middle, parts - left, ends);
}

impl Cluster {
    fn new(triangles: &[([DVec3; 3], u32)], end: usize) -> Cluster {
        let corners = || triangles.iter().flat_map(|(t, _)| t);
        let (low, high) = bounds(corners());
        let center = 0.5 * (low + high);
        let normal = triangles.iter().map(|(t, _)| front(t)).sum::<DVec3>().normalize_or(DVec3::Y);
        Cluster {
            end,
            center,
            radius: corners().map(|p| p.distance(center)).fold(0.0, f64::max),
            normal,
            cone: triangles.iter().map(|(t, _)| front(t).normalize().dot(normal)).fold(1.0, f64::min),
            area: triangles.iter().map(|(t, _)| 0.5 * front(t).length()).sum(),
        }
    }

    /// About what arrives from it; zero only where nothing can.
    fn weight(&self, point: DVec3, normal: DVec3) -> f64 {
        let way = self.center - point;
        let distance = way.length();
        if distance <= 1.001 * self.radius {
            return self.area / self.radius.powi(2);
        }
        let way = way / distance;
        // The ball around it, as an angle, and that together with the cone of its normals; beyond a right angle all may face the receiver.
        let sine = self.radius / distance;
        let ball = (1.0 - sine * sine).sqrt();
        let both = self.cone * ball - (1.0 - self.cone * self.cone).max(0.0).sqrt() * sine;
        let both = if self.cone > 0.0 { both } else { -1.0 };
        let (up, out) = (mean_cosine(normal.dot(way), ball), mean_cosine(-self.normal.dot(way), both));
        self.area * up * out / (distance * distance)
    }
}

/// About the mean, over directions within a cone of half angle a around one of this `cosine`, of their cosines where they are positive:
/// a parabola between -sin a, where it is zero, and sin a, where it meets the cosine itself. `cone` is cos a.
fn mean_cosine(cosine: f64, cone: f64) -> f64 {
    let sine = (1.0 - cone * cone).max(0.0).sqrt();
    if cone <= 0.0 {
        1.0
    } else if cosine >= sine {
        cosine
    } else {
        (cosine + sine).max(0.0).powi(2) / (4.0 * sine)
    }
}

/// A lamp as one receiver sees it.
pub(in crate::optics) struct SeenModel<'a> {
    model: &'a ModelLamp,
    point: DVec3,
    normal: DVec3,
    /// Running sum of the weights of the clusters.
    sums: Vec<f64>,
}

impl SeenModel<'_> {
    /// A place, and what its part of E / L is; `None` where it is turned away or hidden by the lamp itself.
    pub(in crate::optics) fn sample(&self, [u, v]: [f64; 2]) -> Option<(DVec3, f64)> {
        let ModelLamp { triangles, areas, clusters, rays } = self.model;
        let total = *self.sums.last()?;
        let target = u * total;
        let k = self.sums.partition_point(|&sum| sum <= target).min(clusters.len() - 1);
        let before = if k == 0 { 0.0 } else { self.sums[k - 1] };
        let weight = self.sums[k] - before;
        let first = if k == 0 { 0 } else { clusters[k - 1].end };
        let below = if first == 0 { 0.0 } else { areas[first - 1] };
        let whole = areas[clusters[k].end - 1] - below;
        let target = below + ((target - before) / weight).clamp(0.0, 1.0) * whole;
        let i = (first + areas[first..clusters[k].end].partition_point(|&sum| sum <= target)).min(clusters[k].end - 1);
        let start = if i == 0 { 0.0 } else { areas[i - 1] };
        let (t, id) = &triangles[i];
        let root = ((target - start) / (areas[i] - start)).clamp(0.0, 1.0).sqrt();
        let place = t[0] + (t[1] - t[0]) * (root * (1.0 - v)) + (t[2] - t[0]) * (root * v);
        let (d, front) = (place - self.point, front(t));
        let cosines = self.normal.dot(d).max(0.0) * -front.dot(d) / front.length();
        let part = cosines / (PI * d.length_squared().powi(2)) * whole * total / weight;
        let way = d.as_vec3();
        // The end of the way is on the lamp.
        let hidden = || rays.any(self.point.as_vec3(), way, 1.0 - 1e-4, |other| other != *id);
        (part > 0.0 && !hidden()).then_some((place, part))
    }
}

/// The share of what the surface of a lamp sends that leaves the lamp: less than one where its parts face each other.
pub fn escaping(lamp: &Lamp) -> f32 {
    const RAYS: usize = 1 << 14;
    let Lamp::Model { corners, triangles } = lamp else { return 1.0 };
    let all = sound(corners, triangles);
    let mut sum = 0.0;
    let areas = all.iter().map(|t| {
        sum += front(t).length();
        sum
    });
    let areas: Vec<f64> = areas.collect();
    let Some(&whole) = areas.last() else { return 1.0 };
    let rays = rays(all.iter().copied());
    let leaves = |i: &usize| {
        // Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018: four dimensions beside the index.
        let number = |alpha: f64| (0.5 + alpha * *i as f64).fract();
        let (s, t) = (number(0.856_674_883_854_502_9), number(0.733_891_856_627_126_1));
        let (u, v) = (number(0.628_706_721_037_810_6), number(0.538_597_255_722_361_6));
        let target = (*i as f64 + 0.5) / RAYS as f64 * whole;
        let k = areas.partition_point(|&sum| sum <= target).min(all.len() - 1);
        let ([a, b, c], root) = (all[k], s.sqrt());
        let place = (a + (b - a) * (root * (1.0 - t)) + (c - a) * (root * t)).as_vec3();
        let normal = front(&all[k]).normalize().as_vec3();
        let direction = cosine_direction(normal, [u, v]);
        !rays.any(place, direction, f32::INFINITY, |other| other != k as u32)
    };
    (0..RAYS).filter(leaves).count() as f32 / RAYS as f32
}

/// A light that many rays are asked to meet.
pub struct Silhouette<'a> {
    shape: &'a Shape,
    /// Of a model, with its triangles.
    model: Option<(RayMesh, Vec<[DVec3; 3]>)>,
}

impl Silhouette<'_> {
    pub fn new(shape: &Shape) -> Silhouette<'_> {
        let model = match shape {
            Shape::Lamp(Lamp::Model { corners, triangles }) => {
                let all = sound(corners, triangles);
                Some((rays(all.iter().copied()), all))
            }
            _ => None,
        };
        Silhouette { shape, model }
    }

    /// As [`Shape::meet_from`]; a model shows what of it is nearest, and is not met where that is the back of a triangle.
    pub fn meet_from(&self, origin: Vec3, ray: Vec3) -> Option<f32> {
        let Some((rays, triangles)) = &self.model else { return self.shape.meet_from(origin, ray) };
        let hit = rays.closest(origin, ray)?;
        let facing = |id: u32| front(&triangles[id as usize]).dot(ray.as_dvec3()) < 0.0;
        // A sheet of two sides has two triangles in one place.
        let shown = facing(hit.id) || rays.any(origin, ray, hit.distance * (1.0 + 1e-5), facing);
        shown.then_some(hit.distance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Model;
    use crate::optics::{Emitter, estimate, stream};

    const CENTER: Vec3 = Vec3::new(0.2, 1.1, -0.3);

    fn ball() -> Lamp {
        let Model { positions, triangles, .. } = Model::sphere();
        Lamp::Model { corners: positions.into_iter().map(|p| CENTER + 0.3 * p).collect(), triangles }
    }

    /// Corners and triangles of rectangles, given by centre and half edges.
    fn sides(all: &[[Vec3; 3]]) -> Lamp {
        let corners: Vec<Vec3> =
            all.iter().flat_map(|&[c, x, y]| [c - x - y, c + x - y, c + x + y, c - x + y]).collect();
        let triangles =
            (0..all.len() as u32).flat_map(|i| [[4 * i, 4 * i + 1, 4 * i + 2], [4 * i, 4 * i + 2, 4 * i + 3]]);
        Lamp::Model { corners, triangles: triangles.collect() }
    }

    fn places() -> Vec<(Vec3, Vec3)> {
        let slanted = Vec3::new(-0.4, 0.7, 0.2).normalize();
        let places = [Vec3::ZERO, Vec3::new(1.5, 0.0, 0.4), Vec3::new(0.2, 0.7, -0.3), Vec3::new(-3.0, 1.0, 2.0)];
        places.into_iter().flat_map(|p| [Vec3::Y, slanted, Vec3::X, Vec3::Z].map(|n| (p, n))).collect()
    }

    /// The mean of 500 pixels against the closed form; and one pixel of 32 samples, as `Direct` takes them, by its spread.
    #[test]
    fn a_ball_of_triangles_shines_like_a_sphere() {
        let exact = Emitter::new(&Shape::Lamp(Lamp::Sphere { center: CENTER, radius: 0.3 }));
        let model = Emitter::new(&Shape::Lamp(ball()));
        for (point, normal) in places() {
            let wanted = f64::from(exact.irradiance(0, point, normal).expect("a closed form"));
            // A third of a radius away triangles differ more.
            let bound = if point.distance(CENTER) < 0.5 { 0.12 } else { 0.06 };
            let pixels: Vec<f64> = (0..500).map(|pixel| estimate(&model, 0, (point, normal), 8, 3, pixel).0).collect();
            let mean = pixels.iter().sum::<f64>() / 500.0;
            let spread = (pixels.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / 500.0).sqrt();
            assert!((mean - wanted).abs() < 0.01 * wanted + 1e-6, "{point} {normal}: {mean} for {wanted}");
            assert!(spread < bound * wanted + 1e-4, "{point} {normal}: {spread} of {wanted}");
        }
    }

    #[test]
    fn a_box_of_triangles_is_a_box_to_rounding() {
        let (x, y, z) = (Vec3::X * 0.3, Vec3::Y * 0.1, Vec3::Z * 0.2);
        let model = sides(&[
            [CENTER + x, y, z],
            [CENTER - x, z, y],
            [CENTER + y, z, x],
            [CENTER - y, x, z],
            [CENTER + z, x, y],
            [CENTER - z, y, x],
        ]);
        let exact = Lamp::Box { center: CENTER, axes: [x, y, z] };
        assert!((model.area() / exact.area() - 1.0).abs() < 1e-6 && escaping(&model) == 1.0);
        let [model, exact] = [model, exact].map(|lamp| Emitter::new(&Shape::Lamp(lamp)));
        for (point, normal) in places() {
            let [got, wanted] = [&model, &exact].map(|e| e.irradiance(0, point, normal).expect("convex, and few"));
            assert!((got - wanted).abs() < 1e-5 * wanted + 1e-7, "{point} {normal}: {got} for {wanted}");
        }
    }

    /// A panel before a smaller one: what is seen from the front is the first, from the side parts of both.
    #[test]
    fn what_lies_before_hides_what_lies_behind() {
        let (x, z) = (Vec3::X, Vec3::Z);
        let front = [Vec3::Y, x * 0.5, z * 0.5];
        let both = Emitter::new(&Shape::Lamp(sides(&[front, [Vec3::Y * 1.2, x * 0.2, z * 0.2]])));
        assert!(both.irradiance(0, Vec3::ZERO, Vec3::Y).is_none(), "no sum of what hides each other");
        let one = Emitter::new(&Shape::Lamp(Lamp::Rect { center: front[0], x: front[1], y: front[2] }));
        let mean = |point: Vec3| (0..500).map(|p| estimate(&both, 0, (point, Vec3::Y), 8, 3, p).0).sum::<f64>() / 500.0;
        let wanted = f64::from(one.irradiance(0, Vec3::ZERO, Vec3::Y).expect("a closed form"));
        assert!((mean(Vec3::ZERO) / wanted - 1.0).abs() < 0.01, "{} for {wanted}", mean(Vec3::ZERO));
        // From above the first, whose back is dark, all of the second.
        let seen = both.seen(0, Vec3::new(6.0, 1.1, 0.0), Vec3::NEG_X).expect("the second is seen");
        let places = (0..256).filter_map(|i| seen.sample(&stream(0, 0, 0, 0), i)).map(|s| s.place.y);
        assert!(places.clone().count() > 0 && places.clone().all(|y| y > 1.1), "{:?}", places.collect::<Vec<_>>());
    }

    /// Two unit squares that face each other one metre apart send 0.19982 of their light to each other (Howell, "A Catalog of
    /// Radiation Heat Transfer Configuration Factors", C-11).
    #[test]
    fn what_faces_itself_keeps_some_light() {
        let facing = sides(&[[Vec3::ZERO, Vec3::Z * 0.5, Vec3::X * 0.5], [Vec3::Y, Vec3::X * 0.5, Vec3::Z * 0.5]]);
        assert!((escaping(&facing) - 0.80018).abs() < 0.01, "{}", escaping(&facing));
        assert_eq!(escaping(&Lamp::Sphere { center: CENTER, radius: 1.0 }), 1.0);
        assert!(escaping(&ball()) > 0.999);
    }

    #[test]
    fn rays_meet_a_model_where_the_slow_way_does() {
        let shape = Shape::Lamp(ball());
        let body = Silhouette::new(&shape);
        for i in 0..300 {
            let to = CENTER + 0.45 * Vec3::new((i as f32).sin(), (2.3 * i as f32).cos(), (0.7 * i as f32).sin());
            let (fast, slow) = (body.meet_from(Vec3::Z, to - Vec3::Z), shape.meet_from(Vec3::Z, to - Vec3::Z));
            assert_eq!(fast.is_some(), slow.is_some(), "{i}");
            assert!(fast.zip(slow).is_none_or(|(a, b)| (a / b - 1.0).abs() < 1e-4), "{i}: {fast:?} {slow:?}");
        }
        let sheet = Shape::Lamp(sides(&[[Vec3::ZERO, Vec3::X, Vec3::Y]]));
        let sheet = Silhouette::new(&sheet);
        assert!(sheet.meet_from(Vec3::Z, Vec3::NEG_Z).is_some() && sheet.meet_from(Vec3::NEG_Z, Vec3::Z).is_none());
        let two = Shape::Lamp(sides(&[[Vec3::ZERO, Vec3::X, Vec3::Y], [Vec3::ZERO, Vec3::Y, Vec3::X]]));
        let two = Silhouette::new(&two);
        let sides = [Vec3::Z, Vec3::NEG_Z];
        assert!(sides.iter().all(|&from| two.meet_from(from, Vec3::ZERO - from).is_some()), "from both sides");
    }

    #[test]
    fn strange_models_are_sound() {
        let strange = [Vec3::ZERO, Vec3::X, Vec3::splat(1e-30), Vec3::splat(1e20), Vec3::NAN, Vec3::INFINITY];
        for a in strange {
            for b in strange {
                let corners = vec![a, b, Vec3::Y, Vec3::Z, Vec3::new(0.2, 0.2, 0.2), Vec3::new(0.1, 0.7, 0.5)];
                let triangles = vec![[0, 1, 2], [0, 1, 9], [2, 3, 4], [5, 4, 3], [1, 1, 1]];
                let lamp = Lamp::Model { corners, triangles };
                assert!((0.0..=1.0).contains(&escaping(&lamp)));
                let shape = Shape::Lamp(lamp);
                let (emitter, body) = (Emitter::new(&shape), Silhouette::new(&shape));
                for point in strange {
                    let seen = emitter.seen(0, point, Vec3::Y);
                    let samples = (0..8).filter_map(|i| seen.as_ref()?.sample(&stream(0, 0, 0, 0), i));
                    samples.for_each(|sample| assert!(sample.part.is_finite() && sample.part > 0.0));
                    assert!(body.meet_from(point, b).is_none_or(|t| t > 0.0));
                }
            }
        }
    }
}
