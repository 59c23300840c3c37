//! Contact shadows and interreflections: the occlusion of a surface by bodies close to it.
//!
//! The receivers of a [`Transport`](crate::optics::Transport) stand some pixels apart, too far to
//! resolve the contact of a body and the surface under it. So every pixel near a body computes the
//! fraction h of its cosine-weighted hemisphere that bodies fill, by rays into the cones around
//! them. With a the irradiance / pi of the receivers around it past all bodies, and k their
//! occluded fraction, a / (1 - k) would arrive without bodies, and the pixel gets (1 - h)
//! a / (1 - k) and the radiosity that its own rays meet.

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::geometry::{Grid, SceneMesh, clearance, cosine_direction};
use crate::image::{Normal, Plane, Points, rule};
use crate::optics::sampling::random::Points2;
use crate::optics::sampling::sphere::{Cone, sphere_irradiance};
use crate::tuning::tuning;

/// Pixels near bodies, and which probes of these they see.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Contact {
    /// The pixels, one row.
    pixels: Plane<u32>,
    /// Weight of this value against that of the receivers, 0..1.
    weight: Plane<f32>,
    /// The probe that each ray meets, or [`OPEN`]; a row per pixel.
    probes: Plane<u32>,
    /// Its share of the hemisphere.
    shares: Plane<f32>,
}

/// A ray that meets no body.
const OPEN: u32 = u32::MAX;
tuning! {
    /// Constants of the light around the foot of a body.
    pub const TUNING: ContactTuning {
        /// Largest number of rays into the cone of a body.
        max_rays_per_body: usize = 32,
            unit "rays", source Taste, effect "a larger value lowers the noise and takes longer";
        /// Largest number of rays of one pixel.
        max_rays: usize = 256,
            unit "rays", source Taste, effect "a larger value lowers the noise around many bodies and takes longer";
        /// Distances from the middle of a body up to which its rays count fully, and from which on
        /// they do not count.
        reach: [f32; 2] = [2.0, 3.5],
            unit "radii of the ball around it", source Taste,
            effect "a larger value finds shadows farther away and takes longer";
        /// Least open fraction of a receiver's hemisphere by which arriving light is divided.
        min_open: f32 = 0.05,
            unit "1", source Taste, effect "a smaller value amplifies noise beside large bodies";
        /// Length at the end of a ray that may lie within the uneven surface on which a body
        /// stands.
        free_lifts: f32 = 4.0,
            unit "lifts of a ray off its surface", source Taste,
            effect "a larger value lets light through below bodies";
    }
}

/// Irradiance / pi that reaches a receiver past all bodies, and the fraction of its hemisphere that
/// they hide.
#[derive(Clone, Copy, Default)]
pub struct Past {
    pub light: Vec3,
    pub hidden: f32,
}

impl Contact {
    /// Looks for bodies from all pixels near them; `points` and `normal` have the size of `mesh`.
    /// Empty without bodies.
    pub fn new(mesh: &SceneMesh, points: &Points, normal: &Normal, seed: u64) -> Contact {
        let balls = mesh.bodies().balls();
        let near = |pixel: usize| {
            let far = |&(_, middle, radius): &(usize, Vec3, f32)| {
                points.0.pixels()[pixel].distance(middle) / radius
            };
            let far = balls.iter().map(far).fold(f32::INFINITY, f32::min);
            let t = ((TUNING.reach[1] - far) / (TUNING.reach[1] - TUNING.reach[0])).clamp(0.0, 1.0);
            t * t * (3.0 - 2.0 * t)
        };
        let pixels: Vec<(usize, f32)> = (0..points.0.len())
            .into_par_iter()
            .with_min_len(1024)
            .map(|pixel| (pixel, near(pixel)))
            .filter(|&(pixel, weight)| weight > 0.0 && mesh.in_room(pixel))
            .collect();
        let each = (TUNING.max_rays / balls.len().max(1)).clamp(1, TUNING.max_rays_per_body);
        let count = pixels.len();
        let rows: Vec<Vec<(u32, f32)>> = pixels
            .par_iter()
            .with_min_len(64)
            .map(|&(pixel, _)| {
                let (point, n) = (points.0.pixels()[pixel], normal.0.pixels()[pixel]);
                let cones = balls.iter().flat_map(|&ball| {
                    let random = Points2::new(seed, pixel as u32, ball.0 as u32);
                    trace_cone(mesh, (point, n), ball, random, each)
                });
                cones.collect()
            })
            .collect();
        let width = each * balls.len();
        Contact {
            pixels: Plane::new(count, 1, pixels.iter().map(|&(pixel, _)| pixel as u32).collect()),
            weight: Plane::new(count, 1, pixels.iter().map(|&(_, weight)| weight).collect()),
            probes: Plane::new(width, count, rows.iter().flatten().map(|ray| ray.0).collect()),
            shares: Plane::new(width, count, rows.iter().flatten().map(|ray| ray.1).collect()),
        }
    }

    /// Whether every pixel and every probe is one of so many.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub(in crate::optics) fn check(&self, pixels: usize, probes: usize) -> Result<(), String> {
        let count = self.pixels.len();
        rule(
            self.weight.len() == count && self.probes.height() == count,
            "a weight and a row of rays for each pixel",
        )?;
        rule(self.probes.size() == self.shares.size(), "a share for each ray")?;
        rule(
            self.pixels.pixels().iter().all(|&pixel| (pixel as usize) < pixels),
            "pixels that are there",
        )?;
        let met = self.probes.pixels().iter().filter(|&&probe| probe != OPEN);
        rule({ met }.all(|&probe| (probe as usize) < probes), "probes that are there")
    }

    /// Whether no pixel is near a body.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    /// Memory held, in bytes.
    pub fn bytes(&self) -> usize {
        self.pixels.bytes() + self.weight.bytes() + self.probes.bytes() + self.shares.bytes()
    }

    /// Number of rays traced.
    pub fn rays(&self) -> u64 {
        self.probes.len() as u64
    }

    /// Replaces the values of the receivers of `grid`, `all`, at the pixels near bodies; `past` is
    /// known at those pixels, `shown` at each probe.
    pub fn refine(
        &self,
        (grid, points, normal): (&Grid, &Points, &Normal),
        all: &mut Plane<Vec3>,
        past: &[Past],
        shown: impl Fn(usize) -> Vec3 + Sync,
    ) {
        let width = self.probes.width();
        let found = |k: usize| {
            let pixel = self.pixels.pixels()[k] as usize;
            let (light, hidden) = grid.neighbors(points, normal, pixel).iter().fold(
                (Vec3::ZERO, 0.0),
                |(light, hidden), &(i, weight)| {
                    (light + weight * past[i].light, hidden + weight * past[i].hidden)
                },
            );
            let rays = k * width..(k + 1) * width;
            let rays = self.probes.pixels()[rays.clone()].iter().zip(&self.shares.pixels()[rays]);
            let (seen, filled) = rays.filter(|(probe, _)| **probe != OPEN).fold(
                (Vec3::ZERO, 0.0),
                |(seen, filled), (&probe, &share)| {
                    (seen + share * shown(probe as usize), filled + share)
                },
            );
            light * ((1.0 - filled).max(0.0) / (1.0 - hidden).max(TUNING.min_open)) + seen
        };
        let values: Vec<Vec3> =
            (0..self.pixels.len()).into_par_iter().with_min_len(256).map(found).collect();
        for ((&pixel, &weight), value) in
            self.pixels.pixels().iter().zip(self.weight.pixels()).zip(values)
        {
            let slot = &mut all.pixels_mut()[pixel as usize];
            *slot = slot.lerp(value, weight);
        }
    }
}

/// Rays from a place into the cone of a body: the probe that each meets, if it meets this body
/// first, and the fraction of the hemisphere that it represents. Together the rays represent the
/// solid angle of the ball around the body.
fn trace_cone(
    mesh: &SceneMesh,
    (point, normal): (Vec3, Vec3),
    (body, middle, radius): (usize, Vec3, f32),
    random: Points2,
    rays: usize,
) -> Vec<(u32, f32)> {
    let (way, up, size) = ((middle - point).as_dvec3(), normal.as_dvec3(), f64::from(radius));
    let cone = Cone::new(way, size, up);
    let (directions, whole): (Vec<(Vec3, f64)>, f64) = match cone {
        _ if way.length() <= size => {
            ((0..rays).map(|i| (cosine_direction(normal, random.get(i)), 1.0)).collect(), 1.0)
        }
        None => return vec![(OPEN, 0.0); rays],
        Some(cone) => {
            let ray = |i| {
                let (direction, ..) = cone.sample(random.get(i));
                (direction.as_vec3(), up.dot(direction).max(0.0))
            };
            ((0..rays).map(ray).collect(), sphere_irradiance(way, size, up))
        }
    };
    let sum: f64 = directions.iter().map(|(_, cosine)| cosine).sum();
    let each = whole / sum.max(1e-9);
    let found =
        |(direction, cosine): (Vec3, f64)| match meets(mesh, (point, normal), body, direction) {
            Some(probe) => (probe as u32, (cosine * each) as f32),
            None => (OPEN, 0.0),
        };
    directions.into_iter().map(found).collect()
}

/// The probe of a body that is the first thing that a ray from the surface meets.
fn meets(
    mesh: &SceneMesh,
    (point, normal): (Vec3, Vec3),
    body: usize,
    direction: Vec3,
) -> Option<usize> {
    let bodies = mesh.bodies();
    // Rays start at the surface itself: the usual offset against uneven depth would lift them past
    // the foot of a body.
    let from = point + normal * clearance(point);
    let hit = bodies.closest(from, direction).filter(|hit| bodies.owner(hit.id).0 == body)?;
    let lift = mesh.offset(point);
    let (from_above, place) = (point + normal * lift, from + direction * hit.distance);
    // The last part of the ray lies within the unevenness of the surface under the body.
    let free = 1.0 - TUNING.free_lifts * lift / hit.distance;
    let hidden = free > 0.0 && mesh.surfaces().any(from_above, place - from_above, free, |_| true);
    (!hidden).then(|| bodies.nearest_probe(hit.id, place, direction))
}
