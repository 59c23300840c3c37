//! All pixels of the photo, band by band.

use glam::Vec3;
use rayon::prelude::*;

use super::light_layers::{VisibleEmitter, WorkingPixel};
use super::{ComposeIn, LightLayers, Mode};
use crate::graph::{Context, NodeError};
use crate::image::{
    DarkNoise, Grain, HalfBand, HalfLayer, Layer, PixelLight, SaturatedRegions, SurfacePixel, Taps,
    Upsampler, glare_of, ratio, relight_own, relight_physical, relight_ratio,
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

    /// Fills the record of one pixel. `scratch` is memory for it.
    fn fill(&self, (x, y): (usize, usize), scratch: &mut [WorkingPixel; 2], record: &mut [Vec3]) {
        let lights = self.lights;
        let [pixel, own_pixel] = scratch;
        let taps = self.upsampler.taps(x, y);
        lights.shade(&taps, pixel, record);
        let at = self.photo_pixel((x, y), &taps, pixel, record);
        let own = at.emitter.filter(|_| at.coverage > 0.0).map(|emitter| {
            let mut own = record.to_vec();
            match lights.shade_own(emitter, ((x, y), &taps), own_pixel, &mut own) {
                true => (&*own_pixel, own),
                false => (at.pixel, own),
            }
        });
        let light = self.relight(&at, record, own);
        self.add_grain(&at, light, record);
        for drawn in &lights.drawn {
            let coverage = drawn.coverage.0.get(x, y);
            if coverage > 0.0 {
                record.iter_mut().for_each(|layer| *layer *= 1.0 - coverage);
                // A light has the noise of white, whatever its radiance.
                let grain = self.grain.map_or(Vec3::ONE, |grain| grain.factor((x, y), Vec3::ONE));
                record[drawn.light] += coverage * grain * drawn.emission.towards(|| self.ray(x, y));
            }
        }
        lights.add_drawn_glare(&taps, record);
    }

    /// The ray of a pixel.
    fn ray(&self, x: usize, y: usize) -> Vec3 {
        self.inputs.camera.unproject(x as f32 + 0.5, y as f32 + 0.5, 1.0).normalize()
    }

    /// Pixel (x, y) of the photo, with the working planes at it. `after` are its shadings after the
    /// edit.
    fn photo_pixel<'p>(
        &'p self,
        (x, y): (usize, usize),
        taps: &'p Taps,
        pixel: &'p WorkingPixel,
        after: &[Vec3],
    ) -> PhotoPixel<'p, 'a> {
        let photo = &self.inputs.photo.0;
        let index = y * photo.width() + x;
        let emitter = self.lights.emitter(index);
        let coverage = emitter.map_or(0.0, |emitter| emitter.mask.coverage(index));
        let lacking = emitter.map_or(Vec3::ZERO, |emitter| emitter.lacking(index));
        let shown = photo.get(x, y).max(Vec3::ZERO) + lacking;
        let is_by_ratio = coverage < 1.0 && self.mode == Mode::Ratio;
        let scattered = if is_by_ratio { self.lights.glare(pixel) } else { Vec3::ZERO };
        let glare = (1.0 - coverage) * glare_of(shown, scattered);
        let mut denoised = shown - glare;
        // It takes time, and only lights that the edit adds are without it.
        let is_new = |(e, b): (&Vec3, &Vec3)| *b == Vec3::ZERO && *e != Vec3::ZERO;
        if is_by_ratio && after.iter().zip(&pixel.before).any(is_new) {
            denoised = (denoised - self.dark_noise.at(x, y)).max(Vec3::ZERO);
        }
        let at = PhotoPixel {
            at: (x, y),
            taps,
            index,
            emitter,
            lamp: None,
            coverage,
            pixel,
            shown: shown - glare,
            denoised,
            glare,
            glare_share: ratio(glare, scattered),
        };
        PhotoPixel { lamp: self.lamp_at(&at), ..at }
    }

    /// Turns the shadings of a record into the contributions of the lights to a pixel. `own` are
    /// the working planes and the shadings at the surface of its emitter.
    ///
    /// Returns the light before the edit.
    fn relight(
        &self,
        at: &PhotoPixel,
        record: &mut [Vec3],
        own: Option<(&WorkingPixel, Vec<Vec3>)>,
    ) -> PixelLight {
        let (inputs, lights, (x, y)) = (self.inputs, self.lights, at.at);
        let surface = |pixel: &WorkingPixel| SurfacePixel {
            photo: at.shown,
            denoised: at.denoised,
            residual: pixel.residual,
            albedo: match self.mode {
                Mode::Physical => at.taps.of(&inputs.albedo.0),
                Mode::Ratio => Vec3::ZERO,
            },
            reflectance: pixel.reflectance,
            painted: inputs.paint_layers.at(x, y),
            weights: &lights.missing_weights,
            white: lights.white - at.glare.max_element(),
            lamp: at.lamp,
            unsaturated: self.saturated.raised(at.index, at.shown, pixel.unsaturated - at.glare),
        };
        let mut light = PixelLight::default();
        if at.coverage < 1.0 {
            let surface = surface(at.pixel);
            match self.mode {
                Mode::Physical => relight_physical(&surface, record),
                Mode::Ratio => {
                    let glare = at.emitter.map(|emitter| emitter.glare(at.index, self.ray(x, y)));
                    light = relight_ratio(&surface, glare, &at.pixel.before, record);
                }
            }
        }
        if let (Some(emitter), Some((pixel, mut layers))) = (at.emitter, own) {
            let own = emitter.own(at.index, self.ray(x, y), &self.saturated);
            let of_own = relight_own(&surface(pixel), &own, &pixel.before, &mut layers);
            let blend = |(layer, own): (&mut Vec3, Vec3)| *layer = layer.lerp(own, at.coverage);
            record.iter_mut().zip(layers).for_each(blend);
            light = light.covered(of_own, at.coverage);
        }
        if at.glare != Vec3::ZERO {
            lights.add_glare(at.pixel, at.glare_share, record);
            light.all += at.glare;
            let of_lamp = at.lamp.map_or(Vec3::ZERO, |lamp| lights.glare_from(lamp, at.pixel));
            light.of_lamp += at.glare_share * of_lamp;
        }
        light
    }

    /// The lamp without which a pixel may lack noise.
    fn lamp_at(&self, at: &PhotoPixel) -> Option<usize> {
        let (x, y) = at.at;
        let grain = self.grain.filter(|_| self.mode == Mode::Ratio)?;
        let own = at.emitter.filter(|_| at.coverage > 0.0);
        let lamp = self.lights.lamp_at(own, at.pixel)?;
        // Far from lamps nothing is lacking.
        let shading = at.pixel.before.iter().sum::<Vec3>() + at.pixel.residual;
        let is_far = at.emitter.is_none()
            && at.pixel.before[lamp].cmple(grain.few() * shading).all()
            && at.glare.cmple(grain.few() * at.shown).all();
        (!is_far && self.inputs.paint_layers.at(x, y).is_bare()).then_some(lamp)
    }

    /// Gives a pixel that a lamp in view lights the noise that it lacks without the lamp: with it
    /// the pixel is bright, or saturated. `light` is its light before the edit.
    ///
    /// With the noise n, the light L of the lamp and O that of all others, the layers of the others
    /// become 1 + n times, and that of the lamp 1 - n O / L times as bright. So the photo's lights
    /// together show the photo, and layers stay linear. Lights that the edit adds stay as they are.
    fn add_grain(&self, at: &PhotoPixel, light: PixelLight, record: &mut [Vec3]) {
        let (Some(grain), Some(lamp)) = (self.grain, at.lamp) else { return };
        let others = (light.all - light.of_lamp).max(Vec3::ZERO);
        let noise = grain.lacking(at.at, light.all, others);
        if noise == Vec3::ZERO {
            return;
        }
        let of_lamp = Vec3::ONE - noise * ratio(others, light.of_lamp);
        for (k, layer) in record.iter_mut().enumerate() {
            match k == lamp {
                true => *layer *= of_lamp,
                false if self.lights.is_added(k) => {}
                false => *layer *= 1.0 + noise,
            }
        }
    }
}

/// A pixel of the photo.
struct PhotoPixel<'p, 'a> {
    at: (usize, usize),
    taps: &'p Taps,
    /// Its place in the order of the rows.
    index: usize,
    emitter: Option<&'p VisibleEmitter<'a>>,
    /// Index of the lamp without which it may lack noise.
    lamp: Option<usize>,
    /// Fraction that the emitter covers.
    coverage: f32,
    /// The working planes at it.
    pixel: &'p WorkingPixel,
    /// The photo without the light that the lens scatters, 0 or more.
    shown: Vec3,
    /// The same without the noise of dark pixels, where the edit adds a light.
    denoised: Vec3,
    /// The light that the lens scatters.
    glare: Vec3,
    /// That light over what the lens glare has here.
    glare_share: Vec3,
}
