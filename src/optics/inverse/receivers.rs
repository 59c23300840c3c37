//! The visible room at the receivers of a [`Transport`], where shapes of lights are compared with
//! the photo.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3;

use super::{Observations, observed_pixels};
use crate::geometry::{Grid, Own, RoomLayout, SceneMesh};
use crate::image::{Albedo, Mask, Normal, Picture, Plane, Points, Segments};
use crate::optics::transport::{direct, shadow};
use crate::optics::{
    Bounces, LightTransport, Sampling, ShadowQuality, Shape, arriving_at_cells,
    indirect_at_receivers,
};
use crate::tuning::tuning;

tuning! {
    /// Constants of the receivers at which lights are compared with a photo.
    pub const TUNING: ReceiversTuning {
        /// Radius around a receiver within which the pixels of its segment are averaged.
        mean_radius: usize = 2,
            unit "pixels", source Taste, effect "a larger value lowers noise and blurs the edges of shadows";
    }
}

/// A photo and the reconstruction of its room; all planes are of one size.
#[derive(Clone, Copy)]
pub struct SeenRoom<'a> {
    /// The photo, linear RGB, >= 0.
    pub photo: &'a Picture,
    /// Fraction of saturated pixels, 0..=1.
    pub clipped: &'a Mask,
    /// Points of the seen surface, camera space, meters.
    pub points: &'a Points,
    /// Unit normals of the seen surface.
    pub normal: &'a Normal,
    /// The seen surface as a mesh.
    pub mesh: &'a SceneMesh,
    /// Light transport between the pixels, for indirect light.
    pub transport: &'a LightTransport,
    /// The cuboid of the room whose cells are in `transport`.
    pub layout: Option<&'a RoomLayout>,
    /// Diffuse albedo, 0..=1.
    pub albedo: &'a Albedo,
    /// Segments of uniform albedo.
    pub segments: &'a Segments,
}

/// Quality of a light's layer.
#[derive(Clone, Copy, Debug)]
pub struct LayerQuality {
    /// Shadow rays per receiver and lobe.
    pub samples: usize,
    /// Settings of the indirect light.
    pub bounces: Bounces,
}

/// Unit layer of one lobe on the receivers in use: irradiance / pi per unit radiance.
#[derive(Clone, Debug)]
pub struct UnitLayer {
    /// Unshadowed direct shading.
    pub direct: Vec<f32>,
    /// Visible fraction of it, 0..=1.
    pub lit: Vec<f32>,
    /// Indirect shading, per color channel.
    pub indirect: Vec<Vec3>,
}

impl UnitLayer {
    /// Shading per receiver: shadowed direct plus indirect.
    pub fn sum(&self) -> Vec<Vec3> {
        let parts = self.direct.iter().zip(&self.lit).zip(&self.indirect);
        parts.map(|((direct, lit), indirect)| *indirect + Vec3::splat(direct * lit)).collect()
    }
}

/// Receivers of the room, and those of them that constrain the lights ("in use").
pub struct Receivers<'a> {
    room: SeenRoom<'a>,
    /// Points of all receivers, one row.
    points: Points,
    normal: Normal,
    used: Vec<usize>,
    /// Albedo of the cells of the layout.
    cell_albedo: Vec<Vec3>,
    /// The photo at the receivers in use.
    pub observations: Observations,
    /// Shading of the receivers in use by a constant ambient of radiance 1.
    pub ambient: Vec<Vec3>,
    rays: AtomicU64,
}

impl<'a> Receivers<'a> {
    /// Receivers away from `masks`, which mark lights and pixels outside the room. If there are
    /// more than `most`, every nth is used.
    pub fn new<'m>(
        room: SeenRoom<'a>,
        masks: impl Iterator<Item = &'m Mask>,
        most: usize,
    ) -> Receivers<'a> {
        let grid = room.transport.grid();
        let mut pixels = observed_pixels(
            (0..grid.len()).map(|i| grid.pixel(i)),
            room.photo,
            room.clipped,
            masks,
        );
        pixels =
            pixels.iter().copied().step_by(pixels.len().div_ceil(most.max(1)).max(1)).collect();
        let used: Vec<usize> = {
            let mut next = pixels.iter().peekable();
            (0..grid.len()).filter(|&i| next.next_if(|&&p| p == grid.pixel(i)).is_some()).collect()
        };
        let ambient = room.transport.ambient();
        Receivers {
            room,
            points: Points(at_receivers(grid, &room.points.0)),
            normal: Normal(at_receivers(grid, &room.normal.0)),
            observations: Observations::at(
                room.photo,
                room.clipped,
                room.segments,
                &pixels,
                TUNING.mean_radius,
            ),
            ambient: used.iter().map(|&i| ambient[i]).collect(),
            used,
            cell_albedo: room.transport.cell_albedos(room.albedo, room.albedo),
            rays: AtomicU64::new(0),
        }
    }

    /// Point (meters, camera space) and unit normal of each receiver in use.
    pub fn positions(&self) -> Vec<(Vec3, Vec3)> {
        self.used.iter().map(|&i| (self.points.0.pixels()[i], self.normal.0.pixels()[i])).collect()
    }

    /// Number of shadow rays traced so far for layers.
    pub fn rays(&self) -> u64 {
        self.rays.load(Ordering::Relaxed)
    }

    /// Unit layers of a light, one per lobe. `light` marks its pixels, through which its rays pass.
    pub fn layers(
        &self,
        shape: &Shape,
        light: Option<&Mask>,
        quality: LayerQuality,
    ) -> Vec<UnitLayer> {
        let SeenRoom { mesh, transport, albedo, .. } = self.room;
        let sampling = Sampling::fixed(quality.samples, 0);
        let shadows = ShadowQuality {
            sampling,
            stride: 1,
            assume_lit: 1.0,
            outside_unknown: false,
            lifted: false,
        };
        let direct = direct(&self.points, &self.normal, shape, &sampling, &|| false);
        let light =
            light.map(|mask| (Own::new(mask), Mask(at_receivers(transport.grid(), &mask.0))));
        let light = light.as_ref().map(|(passes, pixels)| (passes, pixels));
        let own = light.map(|(passes, _)| passes);
        let cells = self
            .room
            .layout
            .map(|layout| arriving_at_cells(mesh, layout, shape, own, sampling, &|| false));
        let (cells, rays) = cells.unwrap_or_default();
        self.rays.fetch_add(rays, Ordering::Relaxed);
        let shadow = shadow(mesh, &self.points, &self.normal, shape, light, shadows, &|| false);
        self.rays.fetch_add(shadow.rays, Ordering::Relaxed);
        let pixels = self.room.points.0.len() + transport.probes();
        let layer = |(lobe, (direct, lit)): (usize, (&Plane<f32>, &Plane<f32>))| {
            let (direct, lit) = (direct.pixels(), lit.pixels());
            let arrives: Vec<f32> =
                direct.iter().zip(lit).map(|(direct, lit)| direct * lit).collect();
            let at = |pixel: usize| match pixel.checked_sub(pixels) {
                Some(cell) => cells[lobe].pixels()[cell],
                None => arrives[transport.nearest(pixel)],
            };
            let indirect =
                indirect_at_receivers(transport, albedo, &self.cell_albedo, at, quality.bounces);
            UnitLayer {
                direct: self.used.iter().map(|&i| direct[i]).collect(),
                lit: self.used.iter().map(|&i| lit[i]).collect(),
                indirect: self.used.iter().map(|&i| indirect[i]).collect(),
            }
        };
        direct.lobes.iter().zip(&shadow.lit).enumerate().map(layer).collect()
    }
}

/// Values of a plane at the receivers, one row.
fn at_receivers<T: Copy>(grid: &Grid, plane: &Plane<T>) -> Plane<T> {
    Plane::new(grid.len(), 1, (0..grid.len()).map(|i| plane.pixels()[grid.pixel(i)]).collect())
}
