//! Meshes whose triangles hide each other: sampling by clusters, occlusion, and the power that
//! escapes.
//!
//! There may be a million triangles, so that a sum over all is too slow: samples go to positions on
//! the mesh, and those that the mesh itself hides from the receiver count as zero. For little noise
//! a position is chosen in two steps. Triangles of similar position and normal form up to 512
//! clusters; a cluster is chosen by about its irradiance, from its area, distance, and the cosines
//! at both ends (after Conty and Kulla, "Importance Sampling of Many Lights with Adaptive Tree
//! Splitting", HPG 2018). A triangle in it is chosen by area.

use std::f64::consts::PI;

use glam::DVec3;

use super::form::{FormSampler, Intersector, PreparedForm};
use super::pieces::{doubled_area, find, point_in_triangle, running_sum};
use crate::geometry::{RayMesh, cosine_direction};
use crate::optics::sampling::Points2;
use crate::tuning::tuning;

tuning! {
    /// Constants of the sampling of meshes in clusters.
    pub const TUNING: MeshClustersTuning {
        /// Largest number of clusters, all of which every receiver weighs.
        max_clusters: usize = 512,
            unit "clusters", source Measured("noise on a ball, a box and panels; no page records it"),
            effect "a larger value lowers the noise and takes longer; no mean changes";
        /// Distance between two triangles whose normals are at a right angle.
        normal_distance: f64 = 0.5,
            unit "diagonals of the mesh", source Measured("noise on a ball, a box and panels; no page records it"),
            effect "a larger value makes flatter clusters; no mean changes";
        /// Distance from a cluster below which its weight depends on its area alone.
        inside: f64 = 1.001,
            unit "radii of its bounding sphere",
            source Measured("noise on a ball, a box and panels; no page records it"),
            effect "another value changes the noise and the time, and no mean";
        /// End of a shadow ray, just before the surface that it samples.
        shadow_end: f32 = 1.0 - 1e-4,
            unit "the ray's length", source Derived("single precision"),
            effect "a larger value may let a surface shadow itself";
        /// Largest relative distance between the two sides of a sheet.
        sheet: f32 = 1.0 + 1e-5,
            unit "1", source Derived("single precision"),
            effect "a larger value makes the two sides of thin bodies one sheet";
        /// Rays that estimate the fraction of the power that leaves a mesh.
        escape_rays: usize = 1 << 14,
            unit "rays", source Derived("a standard error of at most 0.4 %"),
            effect "a smaller value makes the flux of such lamps less exact";
    }
}

/// Steps of the additive recurrence in four dimensions: Roberts, "The Unreasonable Effectiveness of
/// Quasirandom Sequences", 2018.
const R4: [f64; 4] = [
    0.856_674_883_854_502_9,
    0.733_891_856_627_126_1,
    0.628_706_721_037_810_6,
    0.538_597_255_722_361_6,
];

/// The triangles of a mesh in clusters.
pub(super) struct ClusteredMesh {
    /// In the order of their clusters, with their indices in `rays`.
    triangles: Vec<([DVec3; 3], u32)>,
    /// Running sum of their areas, square meters.
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

fn ray_mesh(triangles: impl Iterator<Item = [DVec3; 3]>) -> RayMesh {
    RayMesh::new(triangles.enumerate().map(|(i, t)| (t.map(|p| p.as_vec3()), i as u32)))
}

/// The lowest and highest corner of the axis-aligned bounding box of points.
fn bounds<'a>(points: impl Iterator<Item = &'a DVec3>) -> (DVec3, DVec3) {
    points.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)))
}

impl ClusteredMesh {
    /// The clusters of triangles that are finite and have an area; `None` without triangles.
    pub fn new(all: &[[DVec3; 3]]) -> Option<ClusteredMesh> {
        if all.is_empty() {
            return None;
        }
        let mut order: Vec<TriangleKey> = Vec::with_capacity(all.len());
        let (low, high) = bounds(all.iter().flatten());
        let unit = TUNING.normal_distance * (high - low).length();
        for (i, t) in all.iter().enumerate() {
            let (middle, normal) = ((t[0] + t[1] + t[2]) / 3.0, doubled_area(t).normalize() * unit);
            order.push(([middle.x, middle.y, middle.z, normal.x, normal.y, normal.z], i as u32));
        }
        let mut ends = Vec::new();
        split(&mut order, 0, TUNING.max_clusters.min(all.len()), &mut ends);
        let triangles: Vec<([DVec3; 3], u32)> =
            order.iter().map(|&(_, i)| (all[i as usize], i)).collect();
        let areas = running_sum(triangles.iter().map(|(t, _)| 0.5 * doubled_area(t).length()));
        let mut first = 0;
        let clusters = ends
            .into_iter()
            .map(|end| Cluster::new(&triangles[std::mem::replace(&mut first, end)..end], end));
        let clusters = clusters.collect();
        Some(ClusteredMesh { triangles, areas, clusters, rays: ray_mesh(all.iter().copied()) })
    }
}

impl PreparedForm for ClusteredMesh {
    /// No closed form.
    fn irradiance(&self, _: usize, _: DVec3, _: DVec3) -> Option<f64> {
        None
    }

    fn sampler_at(
        &self,
        _: usize,
        point: DVec3,
        normal: DVec3,
    ) -> Option<Box<dyn FormSampler + '_>> {
        let sums = running_sum(self.clusters.iter().map(|cluster| cluster.weight(point, normal)));
        let total = *sums.last()?;
        let valid = total > 0.0 && total.is_finite();
        valid.then(|| {
            Box::new(ClusterSampler { mesh: self, point, normal, sums, total })
                as Box<dyn FormSampler>
        })
    }
}

/// The middle and the scaled normal of a triangle, and its index.
type TriangleKey = ([f64; 6], u32);

/// Halves `keys` along the widest of their axes until there are `count` groups, and pushes the end
/// of each.
fn split(keys: &mut [TriangleKey], first: usize, count: usize, ends: &mut Vec<usize>) {
    if count <= 1 || keys.len() <= 1 {
        ends.push(first + keys.len());
        return;
    }
    let width = |axis: usize| {
        let (low, high) = keys.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), k| {
            (l.min(k.0[axis]), h.max(k.0[axis]))
        });
        high - low
    };
    let widths = [0, 1, 2, 3, 4, 5].map(width);
    let axis = (0..6).fold(0, |best, axis| if widths[axis] > widths[best] { axis } else { best });
    let (left, middle) = (count / 2, keys.len() * (count / 2) / count);
    keys.select_nth_unstable_by(middle, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
    let (low, high) = keys.split_at_mut(middle);
    split(low, first, left, ends);
    split(high, first + middle, count - left, ends);
}

impl Cluster {
    fn new(triangles: &[([DVec3; 3], u32)], end: usize) -> Cluster {
        let corners = || triangles.iter().flat_map(|(t, _)| t);
        let (low, high) = bounds(corners());
        let center = 0.5 * (low + high);
        let normal =
            triangles.iter().map(|(t, _)| doubled_area(t)).sum::<DVec3>().normalize_or(DVec3::Y);
        Cluster {
            end,
            center,
            radius: corners().map(|p| p.distance(center)).fold(0.0, f64::max),
            normal,
            cone: triangles
                .iter()
                .map(|(t, _)| doubled_area(t).normalize().dot(normal))
                .fold(1.0, f64::min),
            area: triangles.iter().map(|(t, _)| 0.5 * doubled_area(t).length()).sum(),
        }
    }

    /// About the irradiance from the cluster; zero only where nothing can arrive.
    fn weight(&self, point: DVec3, normal: DVec3) -> f64 {
        let offset = self.center - point;
        let distance = offset.length();
        if distance <= TUNING.inside * self.radius {
            return self.area / self.radius.powi(2);
        }
        let direction = offset / distance;
        // The half angle of the bounding sphere, and its sum with that of the cone of normals;
        // beyond a right angle all triangles may face the receiver.
        let sine = self.radius / distance;
        let sphere = (1.0 - sine * sine).sqrt();
        let both = self.cone * sphere - (1.0 - self.cone * self.cone).max(0.0).sqrt() * sine;
        let both = if self.cone > 0.0 { both } else { -1.0 };
        let (up, out) = (
            mean_cosine(normal.dot(direction), sphere),
            mean_cosine(-self.normal.dot(direction), both),
        );
        self.area * up * out / (distance * distance)
    }
}

/// About the mean of the positive cosines over the directions within a half angle a of one of this
/// `cosine`; `cone` is cos a.
///
/// A parabola between -sin a, where it is zero, and sin a, where it touches the cosine itself.
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

/// A sampler of a clustered mesh for one receiver.
struct ClusterSampler<'a> {
    mesh: &'a ClusteredMesh,
    point: DVec3,
    normal: DVec3,
    /// Running sum of the weights of the clusters.
    sums: Vec<f64>,
    total: f64,
}

impl FormSampler for ClusterSampler<'_> {
    /// `None` where the triangle faces away or the mesh itself hides it.
    fn sample(&self, points: &Points2, i: usize) -> Option<(DVec3, f64)> {
        let ClusteredMesh { triangles, areas, clusters, rays } = self.mesh;
        let [u, v] = points.get(i);
        let target = u * self.total;
        let k = find(&self.sums, target);
        let before = if k == 0 { 0.0 } else { self.sums[k - 1] };
        let weight = self.sums[k] - before;
        let first = if k == 0 { 0 } else { clusters[k - 1].end };
        let below = if first == 0 { 0.0 } else { areas[first - 1] };
        let area = areas[clusters[k].end - 1] - below;
        let target = below + ((target - before) / weight).clamp(0.0, 1.0) * area;
        let i = first + find(&areas[first..clusters[k].end], target);
        let start = if i == 0 { 0.0 } else { areas[i - 1] };
        let (t, id) = &triangles[i];
        let root = ((target - start) / (areas[i] - start)).clamp(0.0, 1.0).sqrt();
        let position = point_in_triangle(t, root, v);
        let (d, front) = (position - self.point, doubled_area(t));
        let cosines = self.normal.dot(d).max(0.0) * -front.dot(d) / front.length();
        let contribution = cosines / (PI * d.length_squared().powi(2)) * area * self.total / weight;
        let hidden =
            || rays.any(self.point.as_vec3(), d.as_vec3(), TUNING.shadow_end, |other| other != *id);
        (contribution > 0.0 && !hidden()).then_some((position, contribution))
    }
}

/// The fraction of the power of these triangles that leaves them, 0..=1, estimated by
/// `TUNING.escape_rays` rays; 1 without triangles.
pub(super) fn escaping(all: &[[DVec3; 3]]) -> f32 {
    let areas = running_sum(all.iter().map(|t| doubled_area(t).length()));
    let Some(&whole) = areas.last() else { return 1.0 };
    let rays = ray_mesh(all.iter().copied());
    let leaves = |i: &usize| {
        let [s, t, u, v] = R4.map(|alpha| (0.5 + alpha * *i as f64).fract());
        let target = (*i as f64 + 0.5) / TUNING.escape_rays as f64 * whole;
        let k = find(&areas, target);
        let position = point_in_triangle(&all[k], s.sqrt(), t).as_vec3();
        let normal = doubled_area(&all[k]).normalize().as_vec3();
        let direction = cosine_direction(normal, [u, v]);
        !rays.any(position, direction, f32::INFINITY, |other| other != k as u32)
    };
    (0..TUNING.escape_rays).filter(leaves).count() as f32 / TUNING.escape_rays as f32
}

/// The intersection of rays with these triangles, `None` where the back of the nearest one faces
/// the ray.
pub(super) fn intersector(triangles: Vec<[DVec3; 3]>) -> Intersector<'static> {
    let rays = ray_mesh(triangles.iter().copied());
    Box::new(move |origin, ray| {
        let hit = rays.closest(origin, ray)?;
        let facing = |id: u32| doubled_area(&triangles[id as usize]).dot(ray.as_dvec3()) < 0.0;
        // A sheet of two sides has two triangles in one place.
        let visible = facing(hit.id) || rays.any(origin, ray, hit.distance * TUNING.sheet, facing);
        visible.then_some(hit.distance)
    })
}

#[cfg(test)]
mod tests {
    use crate::geometry::Model;
    use crate::optics::{
        BoxLamp, Emitter, Lamp, MeshLamp, RectLamp, Shape, Silhouette, SphereLamp, estimate, stream,
    };
    use glam::Vec3;

    const CENTER: Vec3 = Vec3::new(0.2, 1.1, -0.3);

    fn ball() -> Lamp {
        let Model { positions, triangles, .. } = Model::sphere();
        Lamp::Mesh(MeshLamp::new(
            positions.into_iter().map(|p| CENTER + 0.3 * p).collect(),
            triangles,
        ))
    }

    /// Corners and triangles of rectangles, given by center and half edges.
    fn sides(all: &[[Vec3; 3]]) -> Lamp {
        let corners: Vec<Vec3> = all
            .iter()
            .flat_map(|&[c, x, y]| [c - x - y, c + x - y, c + x + y, c - x + y])
            .collect();
        let triangles = (0..all.len() as u32)
            .flat_map(|i| [[4 * i, 4 * i + 1, 4 * i + 2], [4 * i, 4 * i + 2, 4 * i + 3]]);
        Lamp::Mesh(MeshLamp::new(corners, triangles.collect()))
    }

    fn receivers() -> Vec<(Vec3, Vec3)> {
        let slanted = Vec3::new(-0.4, 0.7, 0.2).normalize();
        let points = [
            Vec3::ZERO,
            Vec3::new(1.5, 0.0, 0.4),
            Vec3::new(0.2, 0.7, -0.3),
            Vec3::new(-3.0, 1.0, 2.0),
        ];
        points
            .into_iter()
            .flat_map(|p| [Vec3::Y, slanted, Vec3::X, Vec3::Z].map(|n| (p, n)))
            .collect()
    }

    /// The mean of 500 pixels against the closed form; and one pixel of 32 samples, as `Direct`
    /// takes them, by its spread.
    #[test]
    fn a_ball_of_triangles_shines_like_a_sphere() {
        let exact =
            Emitter::new(&Shape::Lamp(Lamp::Sphere(SphereLamp { center: CENTER, radius: 0.3 })));
        let model = Emitter::new(&Shape::Lamp(ball()));
        for (point, normal) in receivers() {
            let wanted = f64::from(exact.irradiance(0, point, normal).expect("a closed form"));
            // A third of a radius away triangles differ more.
            let bound = if point.distance(CENTER) < 0.5 { 0.12 } else { 0.06 };
            let pixels: Vec<f64> =
                (0..500).map(|pixel| estimate(&model, 0, (point, normal), 8, 3, pixel).0).collect();
            let mean = pixels.iter().sum::<f64>() / 500.0;
            let spread = (pixels.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / 500.0).sqrt();
            assert!(
                (mean - wanted).abs() < 0.01 * wanted + 1e-6,
                "{point} {normal}: {mean} for {wanted}"
            );
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
        let exact = Lamp::Box(BoxLamp { center: CENTER, axes: [x, y, z] });
        assert!((model.area() / exact.area() - 1.0).abs() < 1e-6 && model.escaping() == 1.0);
        let [model, exact] = [model, exact].map(|lamp| Emitter::new(&Shape::Lamp(lamp)));
        for (point, normal) in receivers() {
            let [got, wanted] =
                [&model, &exact].map(|e| e.irradiance(0, point, normal).expect("convex, and few"));
            assert!(
                (got - wanted).abs() < 1e-5 * wanted + 1e-7,
                "{point} {normal}: {got} for {wanted}"
            );
        }
    }

    /// A panel before a smaller one: from the front the first is visible, from the side the second.
    #[test]
    fn a_panel_hides_the_one_behind_it() {
        let (x, z) = (Vec3::X, Vec3::Z);
        let front = [Vec3::Y, x * 0.5, z * 0.5];
        let both = Emitter::new(&Shape::Lamp(sides(&[front, [Vec3::Y * 1.2, x * 0.2, z * 0.2]])));
        assert!(
            both.irradiance(0, Vec3::ZERO, Vec3::Y).is_none(),
            "no sum of panels that hide each other"
        );
        let one = Emitter::new(&Shape::Lamp(Lamp::Rect(RectLamp {
            center: front[0],
            x: front[1],
            y: front[2],
        })));
        let mean = |point: Vec3| {
            (0..500).map(|p| estimate(&both, 0, (point, Vec3::Y), 8, 3, p).0).sum::<f64>() / 500.0
        };
        let wanted = f64::from(one.irradiance(0, Vec3::ZERO, Vec3::Y).expect("a closed form"));
        assert!(
            (mean(Vec3::ZERO) / wanted - 1.0).abs() < 0.01,
            "{} for {wanted}",
            mean(Vec3::ZERO)
        );
        // From above the first, whose back is dark, all of the second.
        let sampler = both
            .sampler_at(0, Vec3::new(6.0, 1.1, 0.0), Vec3::NEG_X)
            .expect("the second is visible");
        let heights =
            (0..256).filter_map(|i| sampler.sample(&stream(0, 0, 0, 0), i)).map(|s| s.position.y);
        assert!(
            heights.clone().count() > 0 && heights.clone().all(|y| y > 1.1),
            "{:?}",
            heights.collect::<Vec<_>>()
        );
    }

    /// Two unit squares that face each other one meter apart send 0.19982 of their light to each
    /// other (Howell, "A Catalog of Radiation Heat Transfer Configuration Factors", C-11).
    #[test]
    fn a_lamp_that_faces_itself_keeps_some_light() {
        let facing = sides(&[
            [Vec3::ZERO, Vec3::Z * 0.5, Vec3::X * 0.5],
            [Vec3::Y, Vec3::X * 0.5, Vec3::Z * 0.5],
        ]);
        assert!((facing.escaping() - 0.80018).abs() < 0.01, "{}", facing.escaping());
        assert_eq!(Lamp::Sphere(SphereLamp { center: CENTER, radius: 1.0 }).escaping(), 1.0);
        assert!(ball().escaping() > 0.999);
    }

    #[test]
    fn fast_and_slow_intersections_agree() {
        let shape = Shape::Lamp(ball());
        let body = Silhouette::new(&shape);
        for i in 0..300 {
            let to = CENTER
                + 0.45
                    * Vec3::new((i as f32).sin(), (2.3 * i as f32).cos(), (0.7 * i as f32).sin());
            let (fast, slow) =
                (body.intersect(Vec3::Z, to - Vec3::Z), shape.intersect(Vec3::Z, to - Vec3::Z));
            assert_eq!(fast.is_some(), slow.is_some(), "{i}");
            assert!(
                fast.zip(slow).is_none_or(|(a, b)| (a / b - 1.0).abs() < 1e-4),
                "{i}: {fast:?} {slow:?}"
            );
        }
        let sheet = Shape::Lamp(sides(&[[Vec3::ZERO, Vec3::X, Vec3::Y]]));
        let sheet = Silhouette::new(&sheet);
        assert!(
            sheet.intersect(Vec3::Z, Vec3::NEG_Z).is_some()
                && sheet.intersect(Vec3::NEG_Z, Vec3::Z).is_none()
        );
        let two =
            Shape::Lamp(sides(&[[Vec3::ZERO, Vec3::X, Vec3::Y], [Vec3::ZERO, Vec3::Y, Vec3::X]]));
        let two = Silhouette::new(&two);
        let sides = [Vec3::Z, Vec3::NEG_Z];
        assert!(
            sides.iter().all(|&from| two.intersect(from, Vec3::ZERO - from).is_some()),
            "from both sides"
        );
    }

    #[test]
    fn extreme_meshes_are_finite() {
        let strange =
            [Vec3::ZERO, Vec3::X, Vec3::splat(1e-30), Vec3::splat(1e20), Vec3::NAN, Vec3::INFINITY];
        for a in strange {
            for b in strange {
                let corners = vec![
                    a,
                    b,
                    Vec3::Y,
                    Vec3::Z,
                    Vec3::new(0.2, 0.2, 0.2),
                    Vec3::new(0.1, 0.7, 0.5),
                ];
                let triangles = vec![[0, 1, 2], [0, 1, 9], [2, 3, 4], [5, 4, 3], [1, 1, 1]];
                let lamp = Lamp::Mesh(MeshLamp::new(corners, triangles));
                assert!((0.0..=1.0).contains(&lamp.escaping()));
                let shape = Shape::Lamp(lamp);
                let (emitter, body) = (Emitter::new(&shape), Silhouette::new(&shape));
                for point in strange {
                    let sampler = emitter.sampler_at(0, point, Vec3::Y);
                    let samples =
                        (0..8).filter_map(|i| sampler.as_ref()?.sample(&stream(0, 0, 0, 0), i));
                    samples.for_each(|sample| {
                        assert!(sample.contribution.is_finite() && sample.contribution > 0.0)
                    });
                    assert!(body.intersect(point, b).is_none_or(|t| t > 0.0));
                }
            }
        }
    }
}
