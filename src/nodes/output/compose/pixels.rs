//! All pixels of the photo, band by band.

use glam::Vec3;
use rayon::prelude::*;

use super::{ComposeIn, LightLayers, Mode};
use crate::graph::{Context, NodeError};
use crate::image::{
    Grain, HalfLayer, Layer, Plane, SurfacePixel, Upsampler, clip_level, headroom, relight_own,
    relight_physical, relight_ratio, saturated_depth,
};

/// Rows that are composed at a time.
///
/// The records of all pixels of a large photo take as much memory as all its layers.
const BAND: usize = 64;

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
    upsampler: Upsampler<'a>,
    /// Level at which the photo is clipped.
    white: f32,
    /// Distance of each clipped pixel from the edge of its region, in pixels.
    clipped_depth: Plane<f32>,
}

impl<'a> Pixels<'a> {
    /// The pixels of `inputs`, whose bundle of lights is `lights`; drawn lights have the noise
    /// `grain`.
    pub fn new(
        mode: Mode,
        inputs: &'a ComposeIn,
        lights: &'a LightLayers<'a>,
        grain: Option<&'a Grain>,
    ) -> Pixels<'a> {
        Pixels {
            mode,
            inputs,
            lights,
            grain,
            upsampler: Upsampler::new(
                &inputs.photo,
                &inputs.full_depth,
                &inputs.small,
                &inputs.depth,
            ),
            white: clip_level(&inputs.photo, &inputs.clipped),
            clipped_depth: saturated_depth(&inputs.clipped),
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
        let mut picture = Vec::with_capacity(width * height);
        let mut layers: Vec<HalfLayer> =
            (0..stride).map(|_| HalfLayer::new(width, height)).collect();
        self.each_band(ctx, |at, records| {
            picture.extend(records.chunks_exact(stride).map(|record| record.iter().sum::<Vec3>()));
            let layers = layers.par_iter_mut().enumerate();
            layers.for_each(|(k, layer)| {
                layer.put(at, records.iter().skip(k).step_by(stride).copied())
            });
        })?;
        let layers: Option<Vec<Layer>> = layers.into_iter().map(HalfLayer::finish).collect();
        Ok(layers.map(|layers| (picture, layers)))
    }

    /// The layers in single precision, row by row.
    ///
    /// # Errors
    /// The run was cancelled.
    pub fn planes(&self, ctx: &Context) -> Result<Vec<Vec<Vec3>>, NodeError> {
        let ((width, height), stride) = (self.inputs.photo.0.size(), self.stride());
        let mut planes: Vec<Vec<Vec3>> =
            (0..stride).map(|_| Vec::with_capacity(width * height)).collect();
        self.each_band(ctx, |_, records| {
            for (k, plane) in planes.iter_mut().enumerate() {
                plane.extend(records.iter().skip(k).step_by(stride));
            }
        })?;
        Ok(planes)
    }

    /// Hands the records of each band to `take`, with the index of their first pixel.
    fn each_band(
        &self,
        ctx: &Context,
        mut take: impl FnMut(usize, &[Vec3]),
    ) -> Result<(), NodeError> {
        let ((width, height), stride) = (self.inputs.photo.0.size(), self.stride());
        let mut records = vec![Vec3::ZERO; width * BAND.min(height) * stride];
        for top in (0..height).step_by(BAND) {
            ctx.check_cancelled()?;
            let records = &mut records[..width * BAND.min(height - top) * stride];
            let rows = records.par_chunks_mut((width * stride).max(1)).enumerate();
            rows.for_each(|(y, row)| {
                let mut before = Vec::with_capacity(stride - 1);
                for (x, record) in row.chunks_exact_mut(stride).enumerate() {
                    self.fill((x, top + y), &mut before, record);
                }
            });
            take(top * width, records);
        }
        Ok(())
    }

    /// Fills the record of one pixel. `before` is scratch memory.
    fn fill(&self, (x, y): (usize, usize), before: &mut Vec<Vec3>, record: &mut [Vec3]) {
        let (inputs, lights) = (self.inputs, self.lights);
        let taps = self.upsampler.taps(x, y);
        lights.shade(&taps, before, record);
        let away = self.clipped_depth.get(x, y);
        let surface = SurfacePixel {
            photo: inputs.photo.0.get(x, y).max(Vec3::ZERO),
            residual: taps.of(&inputs.residual.0),
            albedo: taps.of(&inputs.albedo.0),
            reflectance: taps.of(&inputs.reflectance.0),
            painted: inputs.paint_layers.at(x, y),
            white: self.white,
            headroom: headroom(away),
        };
        let i = y * inputs.photo.0.width() + x;
        let ray = || inputs.camera.unproject(x as f32 + 0.5, y as f32 + 0.5, 1.0).normalize();
        let emitter = lights.emitter(i);
        let coverage = emitter.map_or(0.0, |emitter| emitter.mask.coverage(i));
        let own = emitter.filter(|_| coverage > 0.0).map(|emitter| {
            let mut own = record.to_vec();
            relight_own(&surface, &emitter.own(ray(), away), before, &mut own);
            own
        });
        if coverage < 1.0 {
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
        for drawn in &lights.drawn {
            let coverage = drawn.coverage.0.get(x, y);
            if coverage > 0.0 {
                record.iter_mut().for_each(|layer| *layer *= 1.0 - coverage);
                // A light has the noise of white, whatever its radiance.
                let grain = self.grain.map_or(Vec3::ONE, |grain| grain.factor((x, y), Vec3::ONE));
                record[drawn.light] += coverage * grain * drawn.emission.towards(ray);
            }
        }
    }
}
