//! Indirect shading by bounces on the seen surface.
//!
//! With D the shadowed direct shading of a lobe (irradiance / pi), A the albedo and B = A (D + I)
//! the radiosity / pi of a surface, the indirect shading is the mean of B over the
//! cosine-distributed rays of a point: I = T A (D + I). The rays do not depend on the light, so
//! they are traced once ([`trace_bounces`]), and every lobe only sums over their hits
//! ([`indirect`]). Rays that hit nothing, or a surface from behind, look into the unseen part of
//! the room; it shows the mean B of the seen part, by area. All of it is linear in D, with
//! coefficients that are not negative.
//!
//! In a room with a [layout](crate::geometry::RoomLayout), rays that leave the seen surface meet
//! the cells of its hidden sides, which are receivers of their own; only the rays that leave
//! through an open side or hit a surface from behind look into the unseen part.
//!
//! Bodies in the room take part at their [probes](crate::geometry::Probes): each is a receiver of
//! its own, and a ray that meets a body sees the radiosity of its nearest probe.

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::contact::{Contact, Past};
use super::estimate::{BATCHES, mean, pooled, stream, tiles};
use crate::geometry::{Grid, RoomLayout, SceneMesh, SideSource, cosine_direction, limit_areas};
use crate::image::{Albedo, Normal, Plane, Points, Shading, luminance, rule};
use crate::optics::sampling::random::Points2;
use crate::tuning::tuning;

tuning! {
    /// Constants of bounced and of ambient light.
    pub const TUNING: IndirectTuning {
        /// Fraction of the even ambient light that reaches every receiver; the remainder comes
        /// through the unseen part of the room.
        everywhere: f32 = 0.2,
            unit "1", source Taste, effect "a larger value makes the ambient light more even";
        /// Least cosine between a normal and its ray by which the area of a pixel is divided.
        min_slant: f32 = 0.1,
            unit "1", source Taste, effect "a larger value gives slanted surfaces less area";
        /// Largest area of a receiver: views through a doorway cover large areas and do not light
        /// the room.
        max_area: f32 = 4.0,
            unit "median areas", source Taste, effect "a larger value lets distant surfaces light the room more";
        /// Largest albedo of a bounce.
        max_albedo: f32 = 0.95,
            unit "albedo", source Derived("with an albedo of 1 bounces do not converge"),
            effect "a larger value lets indirect light converge more slowly";
    }
}

/// Hits of the gathering rays of each receiver, a point of a coarse grid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightTransport {
    grid: Grid,
    /// One row per receiver, one column per ray, batch after batch: the pixel met, or [`MISS`].
    hits: Plane<u32>,
    /// Each pixel's nearest receiver on its own surface.
    nearest: Plane<u32>,
    /// Area that each receiver stands for, square meters over focal length squared; zero outside
    /// the room, and for probes.
    areas: Plane<f32>,
    /// Probes of bodies: as many receivers after those of the grid, and as many pixels after those
    /// of the picture.
    probes: usize,
    /// Side of each cell of the room's hidden sides. Cells are receivers and pixels after the
    /// probes.
    cells: Vec<u8>,
    /// By receiver of the grid, the side of the room that it lies on plus one, or zero.
    sides: Vec<u8>,
    /// Occlusion of pixels by bodies near them.
    contact: Contact,
}

const MISS: u32 = u32::MAX;

/// Fractions of gathering rays by what they meet; they sum to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayFractions {
    /// Seen surfaces and bodies.
    pub surface: f32,
    /// Hidden parts of sides that are seen elsewhere or stated.
    pub seen: f32,
    /// Guessed sides.
    pub guessed: f32,
    /// Nothing: an open side, a part of a side past which the camera sees, or a back of a surface.
    pub nothing: f32,
}

impl std::fmt::Display for RayFractions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [surface, seen, guessed, nothing] =
            [self.surface, self.seen, self.guessed, self.nothing].map(|fraction| 100.0 * fraction);
        write!(
            f,
            "of the gathering rays {surface:.1} % meet the mesh, {seen:.1} % hidden parts of seen sides, {guessed:.1} % guessed sides, {nothing:.1} % nothing"
        )
    }
}

impl LightTransport {
    /// Memory held, in bytes.
    pub fn bytes(&self) -> usize {
        self.hits.bytes() + self.nearest.bytes() + self.areas.bytes() + self.contact.bytes()
    }

    /// Whether every pixel and receiver that is named is there.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub fn check(&self) -> Result<(), String> {
        self.grid.check(self.nearest.size())?;
        let receivers = self
            .grid
            .len()
            .checked_add(self.probes)
            .and_then(|receivers| receivers.checked_add(self.cells.len()))
            .ok_or("wanted a number of probes that fits")?;
        let pixels = self.nearest.len() + self.probes + self.cells.len();
        rule(self.sides.len() == self.grid.len(), "a side for each receiver")?;
        rule(self.cells.iter().all(|&side| side < 6), "six sides")?;
        rule(
            self.hits.height() == receivers && self.areas.len() == receivers,
            "a row and an area for each receiver",
        )?;
        rule(
            self.hits.width() > 0 && self.hits.width().is_multiple_of(BATCHES),
            "as many rays in each batch",
        )?;
        let known = |&hit: &u32| hit == MISS || (hit as usize) < pixels;
        rule(self.hits.pixels().iter().all(known), "rays that meet pixels")?;
        let known = |&nearest: &u32| (nearest as usize) < self.grid.len();
        rule(self.nearest.pixels().iter().all(known), "receivers that are there")?;
        self.contact.check(self.nearest.len(), self.probes)
    }

    /// Number of rays traced.
    pub fn rays(&self) -> u64 {
        self.hits.len() as u64 + self.contact.rays()
    }

    /// Fractions of the gathering rays of the picture's receivers by what they meet; `sides` are
    /// those of the layout whose cells the rays met.
    pub fn ray_fractions(&self, sides: &[SideSource; 6]) -> RayFractions {
        let first_cell = self.nearest.len() + self.probes;
        let hits = &self.hits.pixels()[..self.grid.len() * self.hits.width()];
        let mut counts = [0u64; 4];
        for &hit in hits {
            let cell = (hit as usize).checked_sub(first_cell);
            let kind = match cell.and_then(|cell| self.cells.get(cell)) {
                _ if hit == MISS => 3,
                None => 0,
                Some(&side) => match sides[side as usize] {
                    SideSource::Seen | SideSource::Given => 1,
                    SideSource::Guessed | SideSource::Open => 2,
                },
            };
            counts[kind] += 1;
        }
        let [surface, seen, guessed, nothing] =
            counts.map(|count| count as f32 / hits.len().max(1) as f32);
        RayFractions { surface, seen, guessed, nothing }
    }

    /// With at most `rays` of the rays of each receiver, spread over all batches: for estimates
    /// over many receivers, which need fewer.
    pub fn thinned(&self, rays: usize) -> LightTransport {
        let each = self.hits.width() / BATCHES;
        let step = each.div_ceil((rays / BATCHES).max(1)).max(1);
        let kept: Vec<usize> = (0..BATCHES)
            .flat_map(|b| (0..each).step_by(step).map(move |ray| b * each + ray))
            .collect();
        let hits = Plane::from_fn(kept.len(), self.hits.height(), |ray, receiver| {
            self.hits.get(kept[ray], receiver)
        });
        LightTransport {
            hits,
            grid: self.grid,
            nearest: self.nearest.clone(),
            areas: self.areas.clone(),
            probes: self.probes,
            cells: self.cells.clone(),
            sides: self.sides.clone(),
            contact: self.contact.clone(),
        }
    }

    /// Size of the planes it belongs to.
    pub fn size(&self) -> (usize, usize) {
        self.nearest.size()
    }

    /// The receivers.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The receiver that is nearest to a pixel on its own surface; a probe is its own.
    pub fn nearest(&self, pixel: usize) -> usize {
        match pixel.checked_sub(self.nearest.len()) {
            Some(probe) => self.grid.len() + probe,
            None => self.nearest.pixels()[pixel] as usize,
        }
    }

    /// Mean of a value of the receivers, by area.
    fn mean(&self, value: &dyn Fn(usize) -> Vec3) -> Vec3 {
        let areas = self.areas.pixels();
        let area: f64 = areas.iter().map(|&a| f64::from(a)).sum();
        let sum: glam::DVec3 =
            (0..areas.len()).map(|i| value(i).as_dvec3() * f64::from(areas[i])).sum();
        if area > 0.0 { (sum / area).as_vec3() } else { Vec3::ZERO }
    }

    /// Probes of bodies in the room.
    pub fn probes(&self) -> usize {
        self.probes
    }

    /// Cells of the room's hidden sides.
    pub fn cells(&self) -> usize {
        self.cells.len()
    }

    /// Albedo of each cell: the mean of `albedo` on the seen part of its side, by area, and for a
    /// side that is not seen at all the mean of `unedited` on all that is seen.
    pub fn cell_albedos(&self, albedo: &Albedo, unedited: &Albedo) -> Vec<Vec3> {
        let mean = |albedo: &Albedo, is_part: &dyn Fn(u8) -> bool| {
            let (mut sum, mut area) = (glam::DVec3::ZERO, 0.0);
            for (i, _) in self.sides.iter().enumerate().filter(|(_, side)| is_part(**side)) {
                let of_receiver = f64::from(self.areas.pixels()[i]);
                sum += albedo.0.pixels()[self.grid.pixel(i)].as_dvec3() * of_receiver;
                area += of_receiver;
            }
            (area > 0.0).then(|| (sum / area).as_vec3())
        };
        let all = mean(unedited, &|_| true).unwrap_or(Vec3::ZERO);
        let of_side: [Vec3; 6] =
            std::array::from_fn(|i| mean(albedo, &|side| side == i as u8 + 1).unwrap_or(all));
        self.cells.iter().map(|&side| of_side[side as usize]).collect()
    }

    /// Whether each cell lies on a side of which no receiver is seen.
    pub fn unseen_cells(&self) -> Vec<bool> {
        let areas = self.areas.pixels();
        let is_seen: [bool; 6] = std::array::from_fn(|side| {
            self.sides.iter().zip(areas).any(|(&of, &area)| of == side as u8 + 1 && area > 0.0)
        });
        self.cells.iter().map(|&side| !is_seen[side as usize]).collect()
    }

    /// The same receivers in another cuboid, whose sides show in the same pixels, traced anew.
    /// `mesh`, `points`, `normal` and `seed` are those of this transport.
    pub fn with_layout(
        &self,
        mesh: &SceneMesh,
        points: &Points,
        normal: &Normal,
        layout: &RoomLayout,
        seed: u64,
    ) -> LightTransport {
        let each = (self.hits.width() / BATCHES).max(1);
        let hits = trace_hits(mesh, points, normal, Some(layout), (&self.grid, each), seed);
        let mut areas = self.areas.pixels()[..self.grid.len()].to_vec();
        areas.resize(hits.height(), 0.0);
        LightTransport {
            areas: Plane::new(areas.len(), 1, areas),
            hits,
            nearest: self.nearest.clone(),
            cells: layout.cells().iter().map(|cell| cell.side).collect(),
            sides: self.sides.clone(),
            contact: self.contact.clone(),
            ..*self
        }
    }

    /// The pixel, or after all pixels the probe, that a receiver is.
    fn pixel(&self, receiver: usize) -> usize {
        match receiver.checked_sub(self.grid.len()) {
            Some(probe) => self.nearest.len() + probe,
            None => self.grid.pixel(receiver),
        }
    }

    /// Shading of each receiver by an even ambient of radiance 1 from the unseen part of the room,
    /// a fraction of which, `TUNING.everywhere`, reaches all receivers.
    pub fn ambient(&self) -> Vec<Vec3> {
        let open =
            |row: &[u32]| row.iter().filter(|&&hit| hit == MISS).count() as f32 / row.len() as f32;
        let shading =
            |row: &[u32]| Vec3::splat(TUNING.everywhere + (1.0 - TUNING.everywhere) * open(row));
        self.hits.pixels().chunks(self.hits.width().max(1)).map(shading).collect()
    }

    /// [`LightTransport::ambient`] where bodies, whose probes have this albedo, stand in the way:
    /// in place of what they hide they show what they reflect of it. On all pixels, and on the
    /// probes.
    pub fn ambient_around(
        &self,
        points: &Points,
        normal: &Normal,
        albedo: &[Vec3],
    ) -> (Plane<Vec3>, Vec<Vec3>) {
        let all = self.ambient();
        let on_probes = &all[self.grid.len()..self.grid.len() + self.probes];
        let past = self.past(|_| Vec3::splat(TUNING.everywhere), Vec3::ONE);
        let shown = |probe: usize| albedo[probe] * on_probes[probe];
        let around: Vec<Vec3> = (0..self.grid.len() + self.probes)
            .map(|i| past[i].light + self.of_bodies(i, shown))
            .collect();
        let mut on_pixels = self.grid.upsample(points, normal, &around[..self.grid.len()]);
        self.contact.refine((&self.grid, points, normal), &mut on_pixels, &past, shown);
        (on_pixels, around[self.grid.len()..].to_vec())
    }

    /// Irradiance / pi that reaches each receiver past all bodies, where a pixel has the radiance
    /// `shown` and the unseen part `ambient`.
    fn past(&self, shown: impl Fn(usize) -> Vec3 + Sync, ambient: Vec3) -> Vec<Past> {
        let pixels = self.nearest.len();
        let body = pixels..pixels + self.probes;
        let row = |row: &[u32]| {
            let open = row.iter().map(|&hit| if hit == MISS { None } else { Some(hit as usize) });
            let (light, hidden) = open.fold((Vec3::ZERO, 0.0), |(light, hidden), hit| match hit {
                None => (light + ambient, hidden),
                Some(pixel) if body.contains(&pixel) => (light, hidden + 1.0),
                Some(pixel) => (light + shown(pixel), hidden),
            });
            Past { light: light / row.len() as f32, hidden: hidden / row.len() as f32 }
        };
        self.hits.pixels().par_chunks(self.hits.width().max(1)).with_min_len(64).map(row).collect()
    }

    /// Irradiance / pi at a receiver from bodies whose probes have the radiance `shown`.
    fn of_bodies(&self, receiver: usize, shown: impl Fn(usize) -> Vec3) -> Vec3 {
        let width = self.hits.width();
        let row = &self.hits.pixels()[receiver * width..(receiver + 1) * width];
        let probe = |&hit: &u32| {
            let probe = (hit as usize).checked_sub(self.nearest.len());
            probe.filter(|&probe| probe < self.probes)
        };
        row.iter().filter_map(probe).map(shown).sum::<Vec3>() / width as f32
    }
}

/// Traces `rays` cosine-distributed rays, rounded up to whole batches, from every `stride`th pixel.
/// `points` and `normal` have the size of `mesh`.
pub fn trace_bounces(
    mesh: &SceneMesh,
    points: &Points,
    normal: &Normal,
    layout: Option<&RoomLayout>,
    (stride, rays): (usize, usize),
    seed: u64,
) -> LightTransport {
    let (width, height) = points.0.size();
    let grid = Grid::new((width, height), stride);
    let probes = mesh.bodies().probes();
    let cells = layout.map_or(&[][..], RoomLayout::cells);
    let each = rays.div_ceil(BATCHES).max(1);
    let hits = trace_hits(mesh, points, normal, layout, (&grid, each), seed);
    let nearest = |pixel: usize| {
        let best = grid
            .neighbors(points, normal, pixel)
            .into_iter()
            .reduce(|a, b| if b.1 > a.1 { b } else { a });
        best.map_or(0, |(i, _)| i as u32)
    };
    let nearest =
        (0..width * height).into_par_iter().with_min_len(width.max(1)).map(nearest).collect();
    let area = |i: usize| {
        let pixel = grid.pixel(i);
        let (point, n) = (points.0.pixels()[pixel], normal.0.pixels()[pixel]);
        // A pixel covers z^2 / f^2 of a plane parallel to the picture; slanted ones are held back,
        // their slant is uncertain.
        let slant = -n.dot(point) / point.z.abs().max(1e-6);
        if mesh.in_room(pixel) { point.z * point.z / slant.max(TUNING.min_slant) } else { 0.0 }
    };
    // Surfaces far behind the room (through a doorway, or at a pane that no mask marks) cover large
    // areas and do not light the room: no receiver represents more than a few typical ones.
    let mut areas: Vec<f32> = (0..grid.len()).map(area).collect();
    limit_areas(&mut areas, TUNING.max_area);
    areas.resize(hits.height(), 0.0);
    LightTransport {
        nearest: Plane::new(width, height, nearest),
        areas: Plane::new(hits.height(), 1, areas),
        hits,
        probes: probes.len(),
        cells: cells.iter().map(|cell| cell.side).collect(),
        sides: (0..grid.len())
            .map(|i| layout.and_then(|l| l.seen_side(grid.pixel(i))).map_or(0, |s| s as u8 + 1))
            .collect(),
        contact: Contact::new(mesh, points, normal, seed),
        grid,
    }
}

/// The hits of each receiver, `each` rays a batch, one row per receiver: pixels, probes and cells,
/// or [`MISS`].
fn trace_hits(
    mesh: &SceneMesh,
    points: &Points,
    normal: &Normal,
    layout: Option<&RoomLayout>,
    (grid, each): (&Grid, usize),
    seed: u64,
) -> Plane<u32> {
    let (width, height) = points.0.size();
    let probes = mesh.bodies().probes();
    let cells = layout.map_or(&[][..], RoomLayout::cells);
    let first_cell = width * height + probes.len();
    let trace = |i: usize| -> Vec<u32> {
        let (pixel, from, n) = match i.checked_sub(grid.len()) {
            Some(cell) if cell >= probes.len() => {
                let cell = &cells[cell - probes.len()];
                (width * height + i - grid.len(), cell.center, cell.normal)
            }
            Some(probe) => (
                width * height + probe,
                probes.points.pixels()[probe],
                probes.normals.pixels()[probe],
            ),
            None => {
                let pixel = grid.pixel(i);
                let (point, n) = (points.0.pixels()[pixel], normal.0.pixels()[pixel]);
                (pixel, point + n * mesh.offset(point), n)
            }
        };
        let look = |random: Points2, ray: usize| {
            let direction = cosine_direction(n, random.get(ray));
            let hit = mesh.closest(from, direction);
            let exit = layout.and_then(|layout| layout.exit(from, direction));
            if let Some((distance, cell)) = exit
                && hit.is_none_or(|hit| distance < hit.distance)
                && (cell.is_some() || hit.is_none())
            {
                return cell.map(|cell| (first_cell + cell) as u32);
            }
            let hit = hit?;
            // The seen room has one side; a body is met from either.
            let faces =
                normal.0.pixels().get(hit.pixel as usize).is_none_or(|n| n.dot(direction) < 0.0);
            faces.then_some(hit.pixel)
        };
        let batch =
            |batch: usize| (0..each).map(move |ray| (stream(seed, pixel as u32, 0, batch), ray));
        (0..BATCHES)
            .flat_map(batch)
            .map(|(random, ray)| look(random, ray).unwrap_or(MISS))
            .collect()
    };
    let rows: Vec<Vec<u32>> =
        (0..grid.len() + probes.len() + cells.len()).into_par_iter().map(trace).collect();
    Plane::new(each * BATCHES, rows.len(), rows.concat())
}

/// Settings of the sum over bounces.
#[derive(Clone, Copy, Debug)]
pub struct Bounces {
    /// Bounces followed one by one; the rest is a geometric series in the mean albedo. With 0,
    /// indirect light is zero.
    pub count: usize,
    /// Radiosity of the unseen part of the room, as a multiple of the mean of the seen part.
    pub unseen: f32,
}

/// Albedo and direct irradiance / pi of the probes of bodies under one lobe.
#[derive(Clone, Copy)]
pub struct Probed<'a> {
    /// Diffuse albedo, 0..=1, one per probe.
    pub albedo: &'a [Vec3],
    /// Shadowed direct shading.
    pub direct: &'a [f32],
}

impl Probed<'_> {
    /// No bodies.
    pub const NONE: Probed<'static> = Probed { albedo: &[], direct: &[] };
}

/// Indirect shading of one lobe on all pixels, the standard error of its luminance, and indirect
/// shading of the probes of bodies; `direct` is its shadowed direct shading.
///
/// The error of a receiver is the spread of the batches after the receivers around it were brought
/// together, as part of it is common to all of them (the radiosity of the unseen part); a pixel has
/// that of its nearest receiver.
pub fn indirect(
    transport: &LightTransport,
    points: &Points,
    normal: &Normal,
    albedo: &Albedo,
    direct: &Plane<f32>,
    probed: Probed,
    bounces: Bounces,
) -> (Shading, Plane<f32>, Vec<Vec3>) {
    let LightTransport { grid, nearest, .. } = transport;
    let pixels = direct.len();
    let arrives =
        |p: usize| if p < pixels { direct.pixels()[p] } else { probed.direct[p - pixels] };
    let receivers = gather(transport, albedo, probed.albedo, arrives, bounces);
    let up = grid.spread(points, normal, |neighbors| {
        neighbors.iter().fold([Vec3::ZERO; BATCHES], |sum, &(i, weight)| {
            std::array::from_fn(|b| sum[b] + receivers[i][b] * weight)
        })
    });
    let variance =
        |i: usize| mean(&up.pixels()[grid.pixel(i)].map(|b| f64::from(luminance(b)))).1.powi(2);
    let mut errors = vec![0.0; grid.len()];
    for tile in tiles::<()>(0, grid.size(), |_| true) {
        let variances: Vec<Option<f64>> = tile.pixels.iter().map(|&i| Some(variance(i))).collect();
        tile.pixels
            .iter()
            .zip(pooled(&tile, &variances))
            .for_each(|(&i, error)| errors[i] = error as f32);
    }
    let mut shading = up.map(|batches| whole(&batches));
    if !transport.contact.is_empty() && bounces.count > 0 {
        let total: Vec<Vec3> = receivers.iter().map(whole).collect();
        let reflects = reflectances(albedo, probed.albedo);
        let shows =
            |p: usize| reflects[p] * (Vec3::splat(arrives(p)) + total[transport.nearest(p)]);
        let past =
            transport.past(shows, bounces.unseen * transport.mean(&|i| shows(transport.pixel(i))));
        transport
            .contact
            .refine((grid, points, normal), &mut shading, &past, |probe| shows(pixels + probe));
    }
    let probes = receivers[grid.len()..].iter().map(whole).collect();
    (Shading(shading), nearest.map(|i| errors[i as usize]), probes)
}

/// Albedos of pixels and probes; one of one would never come to rest.
fn reflectances(albedo: &Albedo, probes: &[Vec3]) -> Vec<Vec3> {
    albedo
        .0
        .pixels()
        .iter()
        .chain(probes)
        .map(|a| a.clamp(Vec3::ZERO, Vec3::splat(TUNING.max_albedo)))
        .collect()
}

/// Indirect shading of one lobe on the receivers alone, in a room without bodies; `direct` is its
/// shadowed direct shading at a pixel.
pub fn indirect_at_receivers(
    transport: &LightTransport,
    albedo: &Albedo,
    cells: &[Vec3],
    direct: impl Fn(usize) -> f32 + Sync,
    bounces: Bounces,
) -> Vec<Vec3> {
    gather(transport, albedo, cells, direct, bounces).iter().map(whole).collect()
}

fn whole(batches: &[Vec3; BATCHES]) -> Vec3 {
    batches.iter().sum::<Vec3>() / BATCHES as f32
}

/// Indirect shading of each receiver by each batch of its rays. The batches go their own ways
/// through all bounces, so that their spread contains the errors of the surfaces' radiosity as well
/// as those of the last gather.
fn gather(
    transport: &LightTransport,
    albedo: &Albedo,
    probes: &[Vec3],
    direct: impl Fn(usize) -> f32 + Sync,
    bounces: Bounces,
) -> Vec<[Vec3; BATCHES]> {
    let receivers = transport.areas.len();
    if bounces.count == 0 {
        return vec![[Vec3::ZERO; BATCHES]; receivers];
    }
    let reflects = reflectances(albedo, probes);
    let mean_of = |value: &dyn Fn(usize) -> Vec3| transport.mean(value);
    let mean_albedo = mean_of(&|i| reflects[transport.pixel(i)]);
    // There are several rays to a pixel: the part common to all batches is computed once.
    let first: Vec<Vec3> =
        reflects.iter().enumerate().map(|(p, reflect)| reflect * Vec3::splat(direct(p))).collect();
    let ambient = |shown: &dyn Fn(usize, usize) -> Vec3| -> [Vec3; BATCHES] {
        std::array::from_fn(|b| bounces.unseen * mean_of(&|i| shown(transport.pixel(i), b)))
    };
    let shown = |pixel: usize, _: usize| first[pixel];
    let mut last = bounce(transport, shown, ambient(&shown));
    let mut total = last.clone();
    let add = |total: &mut [[Vec3; BATCHES]], last: &[[Vec3; BATCHES]], times: Vec3| {
        let pairs = total.iter_mut().flatten().zip(last.iter().flatten());
        pairs.for_each(|(sum, add)| *sum += *add * times);
    };
    for _ in 1..bounces.count {
        let shown = |pixel: usize, b: usize| reflects[pixel] * last[transport.nearest(pixel)][b];
        last = bounce(transport, shown, ambient(&shown));
        add(&mut total, &last, Vec3::ONE);
    }
    // Each further bounce is taken to be the one before times the mean albedo: exact where the
    // albedo is constant.
    add(&mut total, &last, mean_albedo / (Vec3::ONE - mean_albedo));
    total
}

/// One bounce: per receiver and batch, the mean of the radiosity that its rays meet. A pixel shows
/// `shown` to a batch, the unseen part `ambient`.
fn bounce(
    transport: &LightTransport,
    shown: impl Fn(usize, usize) -> Vec3 + Sync,
    ambient: [Vec3; BATCHES],
) -> Vec<[Vec3; BATCHES]> {
    let hits = &transport.hits;
    let each = (hits.width() / BATCHES).max(1);
    let met = |hit: u32, b: usize| if hit == MISS { ambient[b] } else { shown(hit as usize, b) };
    let gather = |row: &[u32]| {
        let batch =
            |b: usize| row[b * each..(b + 1) * each].iter().map(|&hit| met(hit, b)).sum::<Vec3>();
        std::array::from_fn(|b| batch(b) / each as f32)
    };
    hits.pixels().par_chunks(hits.width().max(1)).with_min_len(64).map(gather).collect()
}
