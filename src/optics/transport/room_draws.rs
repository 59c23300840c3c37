//! Dependence of indirect light on guesses about the unseen room, by Monte Carlo propagation of
//! uncertainty (JCGM 101:2008): a few draws of the guesses, the indirect light of each, and its
//! standard deviation over the draws.
//!
//! All draws trace the same directions from the same receivers, and all lights share the draws. So
//! the difference of a light's layer from its mean over the draws is linear in the radiances of its
//! lobes: lobes are summed first, draw by draw, and the standard deviation is taken of the sum.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::indirect::{Bounces, LightTransport, indirect_at_receivers, trace_bounces};
use super::{Sampling, arriving_at_cells};
use crate::geometry::{Camera, Grid, LayoutDraw, LayoutGuess, Own, RoomLayout, SceneMesh};
use crate::image::{Albedo, LUMINANCE, Normal, Plane, Points, rule};
use crate::optics::sampling::random::Points2;
use crate::optics::{Radiance, Shape};
use crate::tuning::tuning;

tuning! {
    /// Ranges of the guesses about the unseen room.
    pub const TUNING: RoomDrawsTuning {
        /// Range of the factor on the least distance of an unseen wall, evenly distributed on a
        /// logarithmic scale; the layout has 1.4.
        distance: [f32; 2] = [0.7, 2.0],
            unit "1", source Measured("docs/room.md"), effect "a wider range makes errors larger";
        /// Range of the height of a room of which floor or ceiling is not seen, evenly distributed.
        height: [f32; 2] = [2.3, 3.5],
            unit "meters", source Paper("building codes"), effect "a wider range makes errors larger";
        /// Range of the factor on the albedo of sides that are not seen at all, evenly distributed
        /// on a logarithmic scale.
        albedo: [f32; 2] = [0.5, 1.6],
            unit "1", source Measured("docs/room.md"), effect "a wider range makes errors larger";
        /// Largest albedo of such a side.
        max_albedo: f32 = 0.9,
            unit "albedo", source Paper("white paint reflects 0.8 to 0.9"),
            effect "a larger value makes errors in bright rooms larger";
        /// Distance of the middle of a light outside of a drawn cuboid from which on the draw is
        /// left out for this light, as it cannot be the room of the light.
        outside: f32 = 0.02,
            unit "fraction of the cuboid", source Taste, effect "a larger value keeps more draws";
    }
}

/// Number and quality of the draws.
#[derive(Clone, Copy, Debug)]
pub struct DrawSettings {
    /// Draws; a power of two covers the ranges evenly.
    pub count: usize,
    /// Cells along each edge of a side.
    pub cells: usize,
    /// Distance of the receivers along each axis, pixels.
    pub stride: usize,
    /// Rays per receiver.
    pub rays: usize,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// One draw of the guesses about the unseen room.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GuessDraw {
    /// Places of the guessed sides.
    pub layout: LayoutDraw,
    /// Factor on the albedo of sides that are not seen at all.
    pub albedo: f32,
}

impl GuessDraw {
    /// The `i`th of `count` draws: a Latin hypercube for a `count` that is a power of two, since
    /// the first points of the Sobol sequence have one point in each of `count` equal intervals of
    /// every axis. Draws lie in the middle of these intervals.
    pub fn new(i: usize, count: usize, seed: u64) -> GuessDraw {
        let points = Points2::new(seed, 0, 0);
        let count = count.max(1) as f64;
        let middle = |x: f64| ((x * count).floor() + 0.5) / count;
        let [distance, albedo] = points.in_turn(2 * i).map(middle);
        let [height, _] = points.in_turn(2 * i + 1).map(middle);
        let log = |[low, high]: [f32; 2], at: f64| low * (high / low).powf(at as f32);
        let [low, high] = TUNING.height;
        GuessDraw {
            layout: LayoutDraw {
                distance: log(TUNING.distance, distance) / LayoutGuess::default().distance,
                height: low + (high - low) * height as f32,
            },
            albedo: log(TUNING.albedo, albedo),
        }
    }
}

/// The room under one draw: its cuboid, and the rays between the receivers and its sides.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DrawnRoom {
    /// The draw.
    pub guess: GuessDraw,
    layout: RoomLayout,
    transport: LightTransport,
}

/// The room under a few draws of the guesses about its unseen part; no draws where nothing is
/// guessed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RoomDraws {
    /// Receivers of all draws.
    pub grid: Grid,
    /// The draws.
    pub rooms: Vec<DrawnRoom>,
}

impl RoomDraws {
    /// Draws of `layout`, which was found on `points` and `normal`, planes of the size of `mesh`.
    pub fn new(
        layout: &RoomLayout,
        mesh: &SceneMesh,
        camera: &Camera,
        (points, normal): (&Points, &Normal),
        settings: DrawSettings,
    ) -> RoomDraws {
        let reach = layout.reach(mesh, points);
        let drawn = |i: usize| {
            let guess = GuessDraw::new(i, settings.count, settings.seed);
            let place = layout.redrawn(guess.layout, &reach, (camera, points), settings.cells);
            (guess, place)
        };
        let layouts: Vec<(GuessDraw, RoomLayout)> = (0..settings.count).map(drawn).collect();
        let first = layouts.first().map(|(_, layout)| {
            let quality = (settings.stride, settings.rays);
            trace_bounces(mesh, points, normal, Some(layout), quality, settings.seed)
        });
        let grid = Grid::new(points.0.size(), settings.stride);
        // Without a guessed side all draws have one cuboid.
        let is_certain = |first: &LightTransport| !first.unseen_cells().contains(&true);
        if !layout.is_guessed() && first.as_ref().is_none_or(is_certain) {
            return RoomDraws { grid, rooms: Vec::new() };
        }
        let room = |(i, (guess, layout)): (usize, (GuessDraw, RoomLayout))| {
            let first = first.as_ref()?;
            let transport = match i {
                0 => first.clone(),
                _ => first.with_layout(mesh, points, normal, &layout, settings.seed),
            };
            Some(DrawnRoom { guess, layout, transport })
        };
        let rooms = layouts.into_par_iter().enumerate().filter_map(room).collect();
        RoomDraws { grid, rooms }
    }

    /// Memory held, in bytes.
    pub fn bytes(&self) -> usize {
        self.rooms.iter().map(|room| room.layout.bytes() + room.transport.bytes()).sum()
    }

    /// Rays traced.
    pub fn rays(&self) -> u64 {
        self.rooms.iter().map(|room| room.transport.rays()).sum()
    }

    /// Whether all draws are of one room.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub fn check(&self) -> Result<(), String> {
        for DrawnRoom { guess, layout, transport } in &self.rooms {
            layout.check()?;
            transport.check()?;
            self.grid.check(transport.size())?;
            rule(transport.grid() == &self.grid, "the same receivers in each draw")?;
            rule(transport.cells() == layout.cells().len(), "as many cells as in the layout")?;
            rule(transport.probes() == 0, "a room without objects")?;
            let LayoutDraw { distance, height } = guess.layout;
            let finite = [distance, height, guess.albedo].into_iter().all(|x| x.is_finite());
            rule(finite, "finite guesses")?;
        }
        Ok(())
    }
}

/// One light in the seen room.
#[derive(Clone, Copy)]
pub struct DrawnLight<'a> {
    /// The light.
    pub shape: &'a Shape,
    /// Its own pixels, which do not block it.
    pub own: Option<&'a Own>,
    /// Direct irradiance / pi per lobe of unit radiance, shadows included.
    pub direct: &'a [Plane<f32>],
    /// Diffuse albedo.
    pub albedo: &'a Albedo,
}

/// Indirect light of one light under each draw, minus its mean over the draws, per lobe of unit
/// radiance: irradiance / pi.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DrawDifferences {
    /// The receivers.
    pub grid: Grid,
    /// Per lobe, one row for each draw that the light is part of, one column for each receiver.
    pub lobes: Vec<Plane<Vec3>>,
}

impl DrawDifferences {
    /// The differences of a light, and the number of rays traced. Draws that the light is outside
    /// of are left out, unless fewer than two would be left.
    pub fn new(
        draws: &RoomDraws,
        mesh: &SceneMesh,
        light: DrawnLight,
        (sampling, bounces): (Sampling, Bounces),
        stop: &(dyn Fn() -> bool + Sync),
    ) -> (DrawDifferences, u64) {
        let center = light.shape.bounding_sphere().map(|(center, _)| center);
        let holds = |room: &&DrawnRoom| {
            center.is_none_or(|center| room.layout.outside(center) < TUNING.outside)
        };
        let mut rooms: Vec<&DrawnRoom> = draws.rooms.iter().filter(holds).collect();
        if rooms.len() < 2 {
            rooms = draws.rooms.iter().collect();
        }
        let lit: Vec<(Vec<Vec<Vec3>>, u64)> = rooms
            .par_iter()
            .map(|room| room.indirect(mesh, light, (sampling, bounces), stop))
            .collect();
        let count = lit.len();
        let lobe = |lobe: usize| {
            let mean = |receiver: usize| {
                let sum: DVec3 = lit.iter().map(|(of, _)| of[lobe][receiver].as_dvec3()).sum();
                sum / count as f64
            };
            let means: Vec<DVec3> = match count {
                0 => vec![DVec3::ZERO; draws.grid.len()],
                _ => (0..draws.grid.len()).map(mean).collect(),
            };
            Plane::from_fn(draws.grid.len(), count, |receiver, draw| {
                (lit[draw].0[lobe][receiver].as_dvec3() - means[receiver]).as_vec3()
            })
        };
        let lobes = (0..light.direct.len()).map(lobe).collect();
        (DrawDifferences { grid: draws.grid, lobes }, lit.iter().map(|(_, rays)| rays).sum())
    }

    /// Standard error of the light's luminance on all pixels, irradiance / pi: the standard
    /// deviation over the draws at the receivers, interpolated along surfaces. Zero where nothing
    /// is guessed.
    pub fn standard_error(
        &self,
        points: &Points,
        normal: &Normal,
        radiance: &Radiance,
    ) -> Plane<f32> {
        let draws = self.lobes.first().map_or(0, Plane::height);
        if draws < 2 {
            let (width, height) = points.0.size();
            return Plane::filled(width, height, 0.0);
        }
        // In 64 bits: the square of a radiance of 1e20 overflows 32 bits.
        let weights: Vec<DVec3> =
            radiance.0.iter().map(|w| w.as_dvec3() * LUMINANCE.as_dvec3()).collect();
        let deviation = |receiver: usize| {
            let mixed = |draw: usize| -> f64 {
                let lobes = self.lobes.iter().zip(&weights);
                lobes.map(|(lobe, w)| w.dot(lobe.get(receiver, draw).as_dvec3())).sum()
            };
            let squares: f64 = (0..draws).map(|draw| mixed(draw).powi(2)).sum();
            (squares / (draws - 1) as f64).sqrt() as f32
        };
        let errors: Vec<f32> = (0..self.grid.len()).map(deviation).collect();
        self.grid.upsample(points, normal, &errors)
    }

    /// Whether all lobes have the same draws at the receivers.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub fn check(&self) -> Result<(), String> {
        let draws = self.lobes.first().map_or(0, Plane::height);
        let fits = |lobe: &Plane<Vec3>| lobe.size() == (self.grid.len(), draws);
        rule(self.lobes.iter().all(fits), "the same draws for each lobe, at each receiver")
    }
}

impl DrawnRoom {
    /// Albedo of each cell.
    fn cell_albedos(&self, light: DrawnLight) -> Vec<Vec3> {
        let most = Vec3::splat(TUNING.max_albedo);
        let drawn = |(albedo, is_unseen): (Vec3, bool)| match is_unseen {
            true => (albedo * self.guess.albedo).min(most),
            false => albedo,
        };
        let albedos = self.transport.cell_albedos(light.albedo, light.albedo);
        albedos.into_iter().zip(self.transport.unseen_cells()).map(drawn).collect()
    }

    /// Indirect irradiance / pi of a light at each receiver, per lobe of unit radiance, and the
    /// number of rays traced.
    fn indirect(
        &self,
        mesh: &SceneMesh,
        light: DrawnLight,
        (sampling, bounces): (Sampling, Bounces),
        stop: &(dyn Fn() -> bool + Sync),
    ) -> (Vec<Vec<Vec3>>, u64) {
        let DrawnRoom { layout, transport, .. } = self;
        let (cells, rays) = arriving_at_cells(mesh, layout, light.shape, light.own, sampling, stop);
        let albedos = self.cell_albedos(light);
        let lobe = |(direct, cells): (&Plane<f32>, &Plane<f32>)| {
            let (direct, cells) = (direct.pixels(), cells.pixels());
            let arrives = |pixel: usize| match pixel.checked_sub(direct.len()) {
                Some(cell) => cells[cell],
                None => direct[pixel],
            };
            let mut all =
                indirect_at_receivers(transport, light.albedo, &albedos, arrives, bounces);
            all.truncate(transport.grid().len());
            all
        };
        (light.direct.iter().zip(&cells).map(lobe).collect(), rays)
    }
}
