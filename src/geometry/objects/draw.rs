//! Bodies as the camera sees them: their pixels in the photo, and the samples at which light is
//! computed.
//!
//! Within the rectangle around all visible bodies, each photo pixel has the fraction that bodies
//! cover, and their depth, normal and material there. Light is computed at **samples**: one for
//! each pixel, or in large photos for each block of `step` x `step` pixels. A sample is a visible
//! surface point; an empty block repeats the nearest sample, so that samples can be filtered like a
//! picture.

use std::ops::Range;

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::bodies::{BODIES, Body, clearance};
use super::model::Material;
use crate::geometry::{Bodies, Camera};
use crate::image::{Depth, Gloss, Plane, rule};
use crate::tuning::tuning;

/// The seen pixels of all bodies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Objects {
    /// The photo pixel that is the first of the rectangle.
    pub left: usize,
    /// First row of the rectangle, photo pixels from the top.
    pub top: usize,
    /// The share of each pixel that bodies cover.
    pub coverage: Plane<f32>,
    /// Planar z, where covered.
    pub depth: Plane<f32>,
    /// Unit normals facing the camera, where covered.
    pub normal: Plane<Vec3>,
    /// Base color.
    pub albedo: Plane<Vec3>,
    /// Roughness, specular, metallic.
    pub gloss: Plane<Gloss>,
    /// Pixels per sample along each axis.
    pub step: usize,
    /// The samples, slightly above the surface.
    pub points: Plane<Vec3>,
    /// Unit normals of the samples.
    pub normals: Plane<Vec3>,
    /// The body of each sample.
    pub body: Plane<u32>,
    /// The probes that each sample draws from, eight of each, one row for a sample, and their
    /// weights, which sum to 1.
    pub near: Plane<u32>,
    /// Weights of the probes in `near`, of its size.
    pub weight: Plane<f32>,
    /// Materials of the probes: base color; roughness, specular, metallic.
    pub probe_albedo: Plane<Vec3>,
    /// Gloss of the probes: roughness, specular, metallic, each 0..=1.
    pub probe_gloss: Plane<Gloss>,
}

/// Probes that a sample draws from.
pub const NEAR: usize = TUNING.probes;

/// Settings of the drawing of bodies.
#[derive(Clone, Copy, Debug)]
pub struct Drawing {
    /// Rays per pixel side for smooth edges.
    pub supersampling: usize,
    /// Most samples; from there on one stands for several pixels.
    pub most: usize,
}

/// Numbers of one body at a pixel.
#[derive(Clone, Copy)]
struct Shown {
    coverage: f32,
    /// The hit of the ray nearest to the pixel's center.
    point: Vec3,
    normal: Vec3,
    flat: Vec3,
    body: u32,
    /// Means over all rays that meet one.
    albedo: Vec3,
    gloss: Gloss,
}

fn gloss(material: &Material) -> Gloss {
    Gloss {
        roughness: material.roughness,
        specular: material.specular,
        metallic: material.metallic,
    }
}

impl Objects {
    /// Nothing to be seen; `materials` of the probes.
    pub fn unseen(materials: &[Material]) -> Objects {
        let none = || Plane::new(0, 0, Vec::new());
        let flat = || Plane::new(0, 0, Vec::new());
        Objects {
            left: 0,
            top: 0,
            coverage: flat(),
            depth: flat(),
            normal: none(),
            albedo: none(),
            gloss: Plane::new(0, 0, Vec::new()),
            step: 1,
            points: none(),
            normals: none(),
            body: Plane::new(0, 0, Vec::new()),
            near: Plane::new(0, 0, Vec::new()),
            weight: flat(),
            probe_albedo: Plane::new(
                materials.len(),
                1,
                materials.iter().map(|m| m.albedo).collect(),
            ),
            probe_gloss: Plane::new(materials.len(), 1, materials.iter().map(gloss).collect()),
        }
    }

    /// Whether the planes of an object that was read from disk belong together, and samples draw
    /// from probes that are there.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub fn check(&self) -> Result<(), String> {
        let (pixels, samples, probes) =
            (self.coverage.size(), self.points.size(), self.probe_albedo.len());
        let of_pixels =
            [self.depth.size(), self.normal.size(), self.albedo.size(), self.gloss.size()];
        rule(of_pixels.iter().all(|&size| size == pixels), "planes of one size")?;
        rule(self.step > 0, "at least one pixel per sample")?;
        let blocks = (pixels.0.div_ceil(self.step), pixels.1.div_ceil(self.step));
        rule(samples == blocks, "a sample for each block of pixels")?;
        rule(
            [self.normals.size(), self.body.size()] == [samples; 2],
            "a normal and a body for each sample",
        )?;
        let rows = NEAR * self.points.len();
        rule(self.near.len() == rows && self.weight.len() == rows, "eight probes for each sample")?;
        rule(
            self.near.pixels().iter().all(|&probe| (probe as usize) < probes),
            "probes that are there",
        )?;
        rule(self.probe_gloss.len() == probes, "a material for each probe")
    }

    /// Whether nothing is seen.
    pub fn is_empty(&self) -> bool {
        self.coverage.is_empty()
    }

    /// Memory held, in bytes.
    pub fn bytes(&self) -> usize {
        let pixels =
            self.coverage.bytes() + self.depth.bytes() + self.normal.bytes() + self.albedo.bytes();
        let samples = self.points.bytes() + self.normals.bytes() + self.body.bytes();
        let probes = self.near.bytes()
            + self.weight.bytes()
            + self.probe_albedo.bytes()
            + self.probe_gloss.bytes();
        pixels + self.gloss.bytes() + samples + probes
    }

    /// The samples that pixel (x, y) of the rectangle draws from, and their weights, which sum to
    /// 1: near in the picture, of the same surface.
    pub fn taps(&self, x: usize, y: usize) -> ([(usize, f32); 9], usize) {
        let mut taps = [(0, 0.0); 9];
        let (w, h) = self.points.size();
        let (sx, sy) = ((x / self.step).min(w - 1), (y / self.step).min(h - 1));
        if self.step == 1 {
            taps[0] = (sy * w + sx, 1.0);
            return (taps, 1);
        }
        let place = |v: usize| (v as f32 + 0.5) / self.step as f32 - 0.5;
        let (fx, fy) = (place(x), place(y));
        let (normal, z) = (self.normal.get(x, y), self.depth.get(x, y));
        let (mut count, mut sum) = (0, 0.0);
        for v in sy.saturating_sub(1)..(sy + 2).min(h) {
            for u in sx.saturating_sub(1)..(sx + 2).min(w) {
                let near = (TUNING.tent - (u as f32 - fx).abs()).max(0.0)
                    * (TUNING.tent - (v as f32 - fy).abs()).max(0.0);
                let i = v * w + u;
                let alike = self.normals.pixels()[i].dot(normal).max(0.0).powi(TUNING.normal_power);
                let apart = (-self.points.pixels()[i].z / z - 1.0) / TUNING.apart;
                // The floor leaves something to draw from where no sample is alike.
                let weight = near * (alike * (-apart * apart).exp() + TUNING.floor);
                taps[count] = (i, weight);
                (count, sum) = (count + 1, sum + weight);
            }
        }
        taps[..count].iter_mut().for_each(|tap| tap.1 /= sum);
        (taps, count)
    }

    /// Diffuse radiance of the bodies, from the irradiance / pi at their samples:
    /// base color x (1 - metallic) x irradiance / pi.
    pub fn diffuse(&self, samples: &[Vec3]) -> Plane<Vec3> {
        let (w, h) = self.coverage.size();
        let pixel = |i: usize| {
            if self.coverage.pixels()[i] <= 0.0 {
                return Vec3::ZERO;
            }
            let (taps, count) = self.taps(i % w, i / w);
            let shading: Vec3 =
                taps[..count].iter().map(|&(sample, weight)| samples[sample] * weight).sum();
            self.albedo.pixels()[i] * (1.0 - self.gloss.pixels()[i].metallic) * shading
        };
        Plane::new(w, h, (0..w * h).into_par_iter().with_min_len(1024).map(pixel).collect())
    }

    /// The weighted mean of probe values at a sample.
    pub fn from_probes(&self, sample: usize, values: &[Vec3]) -> Vec3 {
        let range = sample * NEAR..(sample + 1) * NEAR;
        let taps = self.near.pixels()[range.clone()].iter().zip(&self.weight.pixels()[range]);
        taps.map(|(&probe, &weight)| values[probe as usize] * weight).sum()
    }
}

/// Draws `bodies` (and their triangles, `solid`) as `camera` sees them, in front of and behind the
/// surface of `depth`; `error` is the possible error of a depth, meters.
pub fn draw(
    bodies: &[Body],
    (solid, materials): (&Bodies, &[Material]),
    camera: &Camera,
    depth: &Depth,
    error: impl Fn(f32) -> f32 + Sync,
    drawing: Drawing,
) -> Objects {
    let nothing = Objects::unseen(materials);
    let Some((columns, rows)) = rectangle(bodies, camera) else { return nothing };
    let look = |i: usize| {
        let (x, y) = (columns.start + i % columns.len(), rows.start + i / columns.len());
        let z = depth.0.get(x, y);
        // A body stands on a surface whose depth is uneven: a point slightly behind it still shows.
        pixel(bodies, solid, camera, (x, y), z + TUNING.slack * z + error(z), drawing.supersampling)
    };
    let seen: Vec<Option<Shown>> =
        (0..columns.len() * rows.len()).into_par_iter().with_min_len(64).map(look).collect();
    let Some((columns, rows, seen)) = trimmed(columns, rows, seen) else { return nothing };
    let (w, h) = (columns.len(), rows.len());

    let step = (1..)
        .find(|step| w.div_ceil(*step) * h.div_ceil(*step) <= drawing.most.max(1))
        .unwrap_or(1);
    let (sw, sh) = (w.div_ceil(step), h.div_ceil(step));
    let block = |i: usize| {
        let (x, y) = (i % sw * step, i / sw * step);
        let within =
            (y..(y + step).min(h)).flat_map(|y| (x..(x + step).min(w)).map(move |x| (x, y)));
        let middle = |(u, v): &(usize, usize)| {
            let far = |at: usize, start: usize| (2 * at).abs_diff(2 * start + step - 1);
            far(*u, x).pow(2) + far(*v, y).pow(2)
        };
        let covered = within.filter(|&(u, v)| seen[v * w + u].is_some());
        covered.min_by_key(middle).and_then(|(u, v)| seen[v * w + u])
    };
    let samples = filled((0..sw * sh).map(block).collect(), sw);
    let (points, normals): (Vec<Vec3>, Vec<Vec3>) =
        samples.iter().map(|s| (s.point + s.flat * clearance(s.point), s.normal)).unzip();
    let body: Vec<u32> = samples.iter().map(|s| s.body).collect();
    let near: Vec<[(u32, f32); NEAR]> = samples
        .par_iter()
        .zip(&points)
        .with_min_len(64)
        .map(|(s, p)| nearest(solid, s.body, *p, s.normal))
        .collect();

    let plane = |of: &dyn Fn(&Shown) -> Vec3| {
        Plane::new(w, h, seen.iter().map(|s| s.as_ref().map_or(Vec3::ZERO, of)).collect())
    };
    let number = |of: &dyn Fn(&Shown) -> f32| {
        Plane::new(w, h, seen.iter().map(|s| s.as_ref().map_or(0.0, of)).collect())
    };
    Objects {
        left: columns.start,
        top: rows.start,
        coverage: number(&|s| s.coverage),
        depth: number(&|s| -s.point.z),
        normal: plane(&|s| s.normal),
        albedo: plane(&|s| s.albedo),
        gloss: Plane::new(
            w,
            h,
            seen.iter().map(|s| s.as_ref().map_or(Gloss::default(), |s| s.gloss)).collect(),
        ),
        step,
        points: Plane::new(sw, sh, points),
        normals: Plane::new(sw, sh, normals),
        body: Plane::new(sw, sh, body),
        near: Plane::new(NEAR, near.len(), near.iter().flatten().map(|n| n.0).collect()),
        weight: Plane::new(NEAR, near.len(), near.iter().flatten().map(|n| n.1).collect()),
        ..nothing
    }
}

/// Columns and rows of the photo within which bodies may be seen; `None` when all are out of view.
fn rectangle(bodies: &[Body], camera: &Camera) -> Option<(Range<usize>, Range<usize>)> {
    let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
    for body in bodies {
        let (near, far) = body.model.bounds();
        for i in 0..8 {
            let corner =
                Vec3::from_array([0, 1, 2].map(|k| if i >> k & 1 == 0 { near[k] } else { far[k] }));
            match camera.project(corner) {
                Some(at) => (low, high) = (low.min(at), high.max(at)),
                // A triangle wholly behind the camera is not seen; the projection of one that
                // reaches there is unbounded.
                None if near.z >= 0.0 => {}
                None => {
                    (low, high) = (Vec2::ZERO, Vec2::new(camera.width as f32, camera.height as f32))
                }
            }
        }
    }
    let range = |low: f32, high: f32, end: usize| {
        let limit = |v: f32| v.clamp(0.0, end as f32) as usize;
        limit(low.floor())..limit(high.ceil())
    };
    let (columns, rows) = (range(low.x, high.x, camera.width), range(low.y, high.y, camera.height));
    (!columns.is_empty() && !rows.is_empty()).then_some((columns, rows))
}

/// Columns, rows and pixels of a rectangle.
type Trimmed = (Range<usize>, Range<usize>, Vec<Option<Shown>>);

/// The smallest rectangle that holds all that is seen.
fn trimmed(columns: Range<usize>, rows: Range<usize>, seen: Vec<Option<Shown>>) -> Option<Trimmed> {
    let w = columns.len();
    let at = seen.iter().enumerate().filter(|(_, s)| s.is_some()).map(|(i, _)| (i % w, i / w));
    let (mut low, mut high) = ((usize::MAX, usize::MAX), (0, 0));
    at.for_each(|(x, y)| {
        (low, high) = ((low.0.min(x), low.1.min(y)), (high.0.max(x + 1), high.1.max(y + 1)))
    });
    if low.0 == usize::MAX {
        return None;
    }
    let kept =
        (low.1..high.1).flat_map(|y| seen[y * w + low.0..y * w + high.0].iter().copied()).collect();
    Some((
        columns.start + low.0..columns.start + high.0,
        rows.start + low.1..rows.start + high.1,
        kept,
    ))
}

/// The bodies in one pixel, up to the depth `limit`. Four rays first; all of them where those
/// disagree.
fn pixel(
    bodies: &[Body],
    solid: &Bodies,
    camera: &Camera,
    (x, y): (usize, usize),
    limit: f32,
    side: usize,
) -> Option<Shown> {
    let ray = |u: f32, v: f32| -> Option<(u32, Vec3, f32)> {
        let along = camera.unproject(x as f32 + u, y as f32 + v, 1.0);
        let length = along.length();
        let hit = solid.closest(Vec3::ZERO, along / length)?;
        (hit.distance / length <= limit).then_some((hit.id, along * (hit.distance / length), u))
    };
    let regular = |side: usize| {
        let at = move |i: usize| (i as f32 + 0.5) / side as f32;
        (0..side * side).map(move |i| (at(i % side), at(i / side)))
    };
    let few: Vec<_> = regular(side.min(2)).map(|(u, v)| ((u, v), ray(u, v))).collect();
    let owner = |hit: &Option<(u32, Vec3, f32)>| hit.map(|hit| solid.owner(hit.0).0);
    let alike = few.windows(2).all(|pair| owner(&pair[0].1) == owner(&pair[1].1));
    let rays: Vec<_> = if alike || side <= 2 {
        few
    } else {
        regular(side).map(|(u, v)| ((u, v), ray(u, v))).collect()
    };
    let middle = |(u, v): (f32, f32)| (u - 0.5).powi(2) + (v - 0.5).powi(2);
    let hits = || rays.iter().filter_map(|(at, hit)| Some((*at, (*hit)?)));
    let nearest = hits().reduce(|a, b| if middle(b.0) < middle(a.0) { b } else { a })?;
    let place = |(id, point, _): (u32, Vec3, f32)| {
        let (body, triangle) = solid.owner(id);
        (body, bodies[body].at(triangle, weights(solid.triangle(id), point)))
    };
    let count = hits().count() as f32;
    let (mut albedo, mut shine) = (Vec3::ZERO, Gloss::default());
    for (_, hit) in hits() {
        let material = place(hit).1.material;
        albedo += material.albedo / count;
        shine += gloss(&material) / count;
    }
    let (body, at) = place(nearest.1);
    let view = -at.point.normalize_or(Vec3::NEG_Z);
    let turn = |n: Vec3, by: Vec3| if by.dot(view) < 0.0 { -n } else { n };
    let (flat, normal) = (turn(at.flat, at.flat), turn(at.normal, at.flat));
    // Smooth normals may face away from the camera at an outline, where the surface itself does
    // not.
    let away = (TUNING.min_facing - normal.dot(view)).max(0.0);
    Some(Shown {
        coverage: count / rays.len() as f32,
        // A lift goes to the outside; seen from within it would go through the surface.
        point: if at.flat.dot(view) < 0.0 { nearest.1.1 } else { at.point },
        normal: (normal + view * away).normalize_or(flat),
        flat,
        body: body as u32,
        albedo,
        gloss: shine,
    })
}

tuning! {
    /// Constants of the drawing of inserted bodies.
    pub const TUNING: DrawTuning {
        /// Probes from which a sample interpolates.
        probes: usize = 8,
            unit "probes", source Taste, effect "a larger value blurs bounced light on bodies";
        /// Least cosine between a normal and the direction to the camera.
        min_facing: f32 = 0.02,
            unit "1", source Taste, effect "a larger value turns normals at outlines toward the camera";
        /// Distance of a body behind the depth of a pixel up to which the body is visible: it
        /// stands on a surface whose depth is uneven.
        slack: f32 = 0.005,
            unit "fraction of the depth", source Derived("noise of depth maps"),
            effect "a larger value shows bodies through surfaces";
        /// Half width of the tent by which samples are weighted in the picture.
        tent: f32 = 1.5,
            unit "distances between samples", source Paper("Kopf et al., Joint Bilateral Upsampling, SIGGRAPH 2007"),
            effect "a larger value blurs shading";
        /// Power of the cosine between normals in the weight of a sample.
        normal_power: i32 = 8,
            unit "1", source Taste, effect "a larger value blurs less over curved bodies";
        /// Relative difference of depth at which a sample's weight is 1 / e.
        apart: f32 = 0.05,
            unit "1", source Taste, effect "a larger value blurs shading over steps";
        /// Floor of the weights, for pixels that are like no sample.
        floor: f32 = 1e-6,
            unit "1", source Taste, effect "a larger value blurs over edges";
    }
}

/// The weights of a triangle's corners that give `point`, which lies on it.
fn weights([a, b, c]: [Vec3; 3], point: Vec3) -> Vec3 {
    let (ab, ac, ap) = (b - a, c - a, point - a);
    let normal = ab.cross(ac);
    let whole = normal.length_squared();
    let v = ap.cross(ac).dot(normal) / whole;
    let w = ab.cross(ap).dot(normal) / whole;
    if !(v.is_finite() && w.is_finite()) {
        return Vec3::splat(1.0 / 3.0);
    }
    let (v, w) = (v.clamp(0.0, 1.0), w.clamp(0.0, 1.0));
    let over = (v + w).max(1.0);
    Vec3::new(1.0 - (v + w) / over, v / over, w / over)
}

/// Gives every sample that is missing that of the nearest one that is there, step by step.
fn filled(mut samples: Vec<Option<Shown>>, width: usize) -> Vec<Shown> {
    let height = samples.len() / width.max(1);
    let mut front: Vec<usize> = (0..samples.len()).filter(|&i| samples[i].is_some()).collect();
    while !front.is_empty() {
        let mut next = Vec::new();
        for i in front {
            let (x, y) = (i % width, i / width);
            let around = [(x > 0, i.wrapping_sub(1)), (x + 1 < width, i + 1)];
            let above = [(y > 0, i.wrapping_sub(width)), (y + 1 < height, i + width)];
            for (_, j) in around.into_iter().chain(above).filter(|(inside, _)| *inside) {
                if samples[j].is_none() {
                    samples[j] = samples[i];
                    next.push(j);
                }
            }
        }
        front = next;
    }
    samples.into_iter().flatten().collect()
}

/// The probes that a place on a body draws from: its nearest, by distance and normal, with weights
/// that fall to zero at the first that is left out, so that none comes or goes with a step.
fn nearest(solid: &Bodies, body: u32, point: Vec3, normal: Vec3) -> [(u32, f32); NEAR] {
    let (range, size) = solid.probes_of(body);
    let probes = solid.probes();
    let far = |i: usize| {
        probes.points.pixels()[i].distance_squared(point) / size.max(1e-12)
            + BODIES.normal_distance * (1.0 - probes.normals.pixels()[i].dot(normal))
    };
    let mut found = [(f32::INFINITY, range.start as u32); NEAR + 1];
    for i in range {
        let entry = (far(i), i as u32);
        if entry.0 < found[NEAR].0 {
            let at = found.partition_point(|f| f.0 <= entry.0);
            found[at..].rotate_right(1);
            found[at] = entry;
        }
    }
    let reach = if found[NEAR].0.is_finite() { found[NEAR].0 } else { f32::MAX };
    let weight =
        |(far, _): &(f32, u32)| (1.0 - (far / reach).max(0.0).sqrt()).max(0.0) + TUNING.floor;
    let used = found.iter().take(NEAR).filter(|f| f.0.is_finite());
    let sum: f32 = used.map(weight).sum::<f32>().max(1e-30);
    std::array::from_fn(|k| {
        let entry = &found[k];
        (entry.1, if entry.0.is_finite() { weight(entry) / sum } else { 0.0 })
    })
}

#[cfg(test)]
mod tests {
    use glam::Mat3;

    use super::*;
    use crate::geometry::Model;

    const DRAWING: Drawing = Drawing { supersampling: 4, most: 100_000 };

    fn sphere(center: Vec3, radius: f32) -> Body {
        Body::placed(Model::sphere(), None, Mat3::IDENTITY, radius, Vec3::ZERO, center)
    }

    fn drawn(bodies: &[Body], wall: f32, drawing: Drawing) -> Objects {
        let camera = Camera::from_fov_x(80, 60, 60.0);
        let (solid, materials) = Bodies::new(bodies, 200);
        draw(
            bodies,
            (&solid, &materials),
            &camera,
            &Depth(Plane::filled(80, 60, wall)),
            |_| 0.0,
            drawing,
        )
    }

    #[test]
    fn a_sphere_covers_its_disc_and_has_its_normals() {
        let center = Vec3::new(0.0, 0.0, -2.0);
        let objects = drawn(&[sphere(center, 0.2)], 5.0, DRAWING);
        let got: f32 = objects.coverage.pixels().iter().sum();
        // The outline of a sphere on the axis is a circle of radius f tan(asin(r / d)).
        let f = Camera::from_fov_x(80, 60, 60.0).fx;
        let want = std::f32::consts::PI * (f * 0.1f32.asin().tan()).powi(2);
        assert!((got / want - 1.0).abs() < 0.01, "{got} against {want} pixels");
        assert_eq!(objects.step, 1);
        for (p, n) in objects.points.pixels().iter().zip(objects.normals.pixels()) {
            assert!((p.distance(center) - 0.2).abs() < 1e-3);
            assert!(n.dot((*p - center).normalize()) > 0.99 && n.dot(*p) < 0.0, "{n} at {p}");
        }
        let sums = objects.weight.pixels().chunks(NEAR).map(|w| w.iter().sum::<f32>());
        assert!(sums.into_iter().all(|sum| (sum - 1.0).abs() < 1e-4));
    }

    #[test]
    fn what_stands_before_hides_and_what_is_out_of_view_is_nothing() {
        let at = |z: f32| [sphere(Vec3::new(0.0, 0.0, z), 0.2)];
        assert!(drawn(&at(-2.0), 1.0, DRAWING).is_empty(), "behind a wall");
        assert!(drawn(&at(2.0), 5.0, DRAWING).is_empty(), "behind the camera");
        let around = drawn(&at(0.0), 5.0, DRAWING);
        assert_eq!(around.coverage.size(), (80, 60), "the camera is inside");
        assert!(
            around
                .normals
                .pixels()
                .iter()
                .zip(around.points.pixels())
                .all(|(n, p)| n.dot(*p) < 0.0)
        );
    }

    #[test]
    fn few_samples_stand_for_many_pixels() {
        let fine = drawn(&[sphere(Vec3::new(0.0, 0.0, -1.0), 0.2)], 5.0, DRAWING);
        let coarse =
            drawn(&[sphere(Vec3::new(0.0, 0.0, -1.0), 0.2)], 5.0, Drawing { most: 60, ..DRAWING });
        assert_eq!(fine.coverage, coarse.coverage);
        assert!(coarse.step > 1 && coarse.points.len() <= 60);
        let (w, h) = coarse.coverage.size();
        for (x, y) in (0..h)
            .flat_map(|y| (0..w).map(move |x| (x, y)))
            .filter(|&(x, y)| coarse.coverage.get(x, y) > 0.5)
        {
            let (taps, count) = coarse.taps(x, y);
            let normal: Vec3 =
                taps[..count].iter().map(|(i, w)| coarse.normals.pixels()[*i] * *w).sum();
            assert!((taps[..count].iter().map(|t| t.1).sum::<f32>() - 1.0).abs() < 1e-5);
            assert!(normal.normalize().dot(coarse.normal.get(x, y)) > 0.8, "({x}, {y})");
        }
    }
}
