//! All pixels of the photo, band by band.

use glam::Vec3;
use rayon::prelude::*;

use super::light_layers::WorkingPixel;
use super::{ComposeIn, LightLayers, Mode};
use crate::graph::{Context, NodeError};
use crate::image::{
    DarkNoise, Grain, HalfBand, HalfLayer, Layer, SaturatedRegions, SurfacePixel, Upsampler,
    glare_of, ratio, relight_own, relight_physical, relight_ratio,
};

/// Rows that one task composes, one after the other: the records of all pixels of a large photo
/// take as much memory as all its layers.
const BAND: usize = 8;

/// A picture, row by row, and its layers.
pub type Layered = (Vec<Vec3>, Vec<Layer>);

/// The pixels of the photo, each with one record: the contribution of each light, then that of the
/// residual.
pub struct Pixels<'a> {
    mode: Mode,
    inputs: &'a ComposeIn,
    lights: &'a LightLayers<'a>,
    /// Noise of drawn lights.
    grain: Option<&'a Grain>,
    dark_noise: DarkNoise<'a>,
    upsampler: Upsampler<'a>,
    saturated: SaturatedRegions,
}

impl<'a> Pixels<'a> {
    /// The pixels of `inputs`, whose bundle of lights is `lights` and whose saturated regions are
    /// `saturated`; the photo has the noise `noise`, and drawn lights have the noise `grain`.
    pub fn new(
        mode: Mode,
        inputs: &'a ComposeIn,
        lights: &'a LightLayers<'a>,
        saturated: SaturatedRegions,
        [noise, grain]: [Option<&'a Grain>; 2],
    ) -> Pixels<'a> {
        Pixels {
            mode,
            inputs,
            lights,
            grain,
            dark_noise: DarkNoise::new(&inputs.photo, noise),
            upsampler: Upsampler::new(
                &inputs.photo,
                &inputs.full_depth,
                &inputs.small,
                &inputs.depth,
            ),
            saturated,
        }
    }

    /// Numbers of a record.
    fn stride(&self) -> usize {
        self.lights.names.len() + 1
    }

    /// The picture and its layers in half floats; `None` when they cannot hold one of them.
    ///
    /// # Errors
    /// The run was cancelled.
    pub fn half_layers(&self, ctx: &Context) -> Result<Option<Layered>, NodeError> {
        let ((width, height), stride) = (self.inputs.photo.0.size(), self.stride());
        let pixels = width * BAND;
        let mut picture: Vec<Vec3> = bytemuck::zeroed_vec(width * height);
        let mut layers: Vec<HalfLayer> =
            (0..stride).map(|_| HalfLayer::new(width, height)).collect();
        let mut halves: Vec<_> = layers.iter_mut().map(|layer| layer.bands(pixels)).collect();
        let bands = picture.chunks_mut(pixels.max(1)).map(|picture| {
            let halves: Vec<HalfBand> = halves.iter_mut().filter_map(Iterator::next).collect();
            (picture, halves)
        });
        let bands = self.each_row(ctx, bands.collect(), |(picture, halves), at, records| {
            let sums = records.chunks_exact(stride).map(|record| record.iter().sum::<Vec3>());
            picture[at..].iter_mut().zip(sums).for_each(|(pixel, sum)| *pixel = sum);
            for (k, half) in halves.iter_mut().enumerate() {
                half.put(at, records.iter().skip(k).step_by(stride).copied());
            }
        })?;
        let mut largest = vec![0.0f32; stride];
        for (_, halves) in &bands {
            let each = largest.iter_mut().zip(halves);
            each.for_each(|(largest, half)| *largest = largest.max(half.largest()));
        }
        drop((bands, halves));
        let layers = layers.into_iter().zip(largest).map(|(layer, most)| layer.finish(most));
        Ok(layers.collect::<Option<Vec<Layer>>>().map(|layers| (picture, layers)))
    }

    /// The layers in single precision, row by row.
    ///
    /// # Errors
    /// The run was cancelled.
    pub fn planes(&self, ctx: &Context) -> Result<Vec<Vec<Vec3>>, NodeError> {
        let ((width, height), stride) = (self.inputs.photo.0.size(), self.stride());
        let mut planes: Vec<Vec<Vec3>> =
            (0..stride).map(|_| bytemuck::zeroed_vec(width * height)).collect();
        let mut parts: Vec<_> =
            planes.iter_mut().map(|plane| plane.chunks_mut((width * BAND).max(1))).collect();
        let bands = (0..height.div_ceil(BAND))
            .map(|_| parts.iter_mut().filter_map(Iterator::next).collect::<Vec<&mut [Vec3]>>());
        self.each_row(ctx, bands.collect(), |planes, at, records| {
            for (k, plane) in planes.iter_mut().enumerate() {
                let values = records.iter().skip(k).step_by(stride);
                plane[at..].iter_mut().zip(values).for_each(|(pixel, value)| *pixel = *value);
            }
        })?;
        Ok(planes)
    }

    /// Hands the records of each row to `take`, with the band of `BAND` rows that it is in and the
    /// index of its first pixel there. Returns the bands.
    fn each_row<B: Send>(
        &self,
        ctx: &Context,
        bands: Vec<B>,
        take: impl Fn(&mut B, usize, &[Vec3]) + Sync,
    ) -> Result<Vec<B>, NodeError> {
        let ((width, height), stride) = (self.inputs.photo.0.size(), self.stride());
        let filled = bands.into_par_iter().with_max_len(1).enumerate().map(|(band, mut rows)| {
            ctx.check_cancelled()?;
            let mut records = vec![Vec3::ZERO; width * stride];
            let mut pixels = [self.lights.working_pixel(), self.lights.working_pixel()];
            for (row, y) in (band * BAND..height.min((band + 1) * BAND)).enumerate() {
                for (x, record) in records.chunks_exact_mut(stride).enumerate() {
                    self.fill((x, y), &mut pixels, record);
                }
                take(&mut rows, row * width, &records);
            }
            Ok(rows)
        });
        filled.collect()
    }

    /// Fills the record of one pixel. `pixels` are scratch memory.
    fn fill(&self, (x, y): (usize, usize), pixels: &mut [WorkingPixel; 2], record: &mut [Vec3]) {
        let (inputs, lights) = (self.inputs, self.lights);
        let [pixel, own_pixel] = pixels;
        let taps = self.upsampler.taps(x, y);
        lights.shade(&taps, pixel, record);
        let before = &pixel.before;
        let i = y * inputs.photo.0.width() + x;
        let emitter = lights.emitter(i);
        let coverage = emitter.map_or(0.0, |emitter| emitter.mask.coverage(i));
        let lacking = emitter.map_or(Vec3::ZERO, |emitter| emitter.lacking(i));
        let photo = inputs.photo.0.get(x, y).max(Vec3::ZERO) + lacking;
        let has_glare = coverage < 1.0 && self.mode == Mode::Ratio;
        let scattered = if has_glare { lights.glare(pixel) } else { Vec3::ZERO };
        let glare = (1.0 - coverage) * glare_of(photo, scattered);
        let mut denoised = photo - glare;
        // It takes time, and only lights that the edit adds are without it.
        if record.iter().zip(before).any(|(e, b)| *b == Vec3::ZERO && *e != Vec3::ZERO) {
            let noise = self.dark_noise.at(x, y);
            denoised = (denoised - noise).max(Vec3::ZERO);
        }
        let surface = |shown: &WorkingPixel| SurfacePixel {
            photo: photo - glare,
            denoised,
            residual: shown.residual,
            albedo: match self.mode {
                Mode::Physical => taps.of(&inputs.albedo.0),
                Mode::Ratio => Vec3::ZERO,
            },
            reflectance: shown.reflectance,
            painted: inputs.paint_layers.at(x, y),
            white: self.lights.white - glare.max_element(),
            unsaturated: self.saturated.raised(i, photo - glare, shown.unsaturated - glare),
        };
        let ray = || inputs.camera.unproject(x as f32 + 0.5, y as f32 + 0.5, 1.0).normalize();
        let own = emitter.filter(|_| coverage > 0.0).map(|emitter| {
            let mut own = record.to_vec();
            let shown = match lights.shade_own(emitter, ((x, y), &taps), own_pixel, &mut own) {
                true => &*own_pixel,
                false => &*pixel,
            };
            let surface = surface(shown);
            relight_own(&surface, &emitter.own(i, ray(), &self.saturated), &shown.before, &mut own);
            own
        });
        if coverage < 1.0 {
            let surface = surface(pixel);
            match self.mode {
                Mode::Physical => relight_physical(&surface, record),
                Mode::Ratio => {
                    let glare = emitter.map(|emitter| emitter.glare(i, ray()));
                    relight_ratio(&surface, glare, before, record);
                }
            }
        }
        if let Some(own) = own {
            let blend = |(layer, own): (&mut Vec3, Vec3)| *layer = layer.lerp(own, coverage);
            record.iter_mut().zip(own).for_each(blend);
        }
        if glare != Vec3::ZERO {
            lights.add_glare(pixel, ratio(glare, scattered), record);
        }
        for drawn in &lights.drawn {
            let coverage = drawn.coverage.0.get(x, y);
            if coverage > 0.0 {
                record.iter_mut().for_each(|layer| *layer *= 1.0 - coverage);
                // A light has the noise of white, whatever its radiance.
                let grain = self.grain.map_or(Vec3::ONE, |grain| grain.factor((x, y), Vec3::ONE));
                record[drawn.light] += coverage * grain * drawn.emission.towards(ray);
            }
        }
        lights.add_drawn_glare(&taps, record);
    }
}
