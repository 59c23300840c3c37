//! `Compose`: from shading to a picture, and to one picture per light.
//!
//! Away from lights, a pixel of the photo I under shading E = sum E_k + R (R the rest, what no light explains) becomes, after
//! an edit, `sum B E'_k + B R + U`. Under `Ratio`, B = min(I / E, 1), the largest share of the pixel that can be a reflectance,
//! and U = I - B E is unexplained light (a highlight, an unseen sun) that stays as it is and is told as part of `light_rest`.
//! So the identity gives the photo back, texture and resolution survive, and each term is linear in its light's radiance.
//! Under `Physical`, B is the estimated albedo and U = 0.
//!
//! The pixels of a visible light show what it emits over the little that its surface (shade, pane) reflects of the others:
//! I = S + G with S = min(A_fill E_others, I). G belongs to the light and goes with its gain; S to the other lights.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::geometry::Camera;
use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{Albedo, Depth, Mask, Picture, Plane, Shading, Upsampler};
use crate::optics::{LightKind, Radiance, Shape};
use crate::{params, ports};

/// How a picture is made from shading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// The photo times the ratio of shadings: keeps all texture.
    Ratio,
    /// Estimated albedo times shading.
    Physical,
}

params! {
    /// Puts the edited shading onto the photo, at the photo's own size.
    ///
    /// Shading is brought to the photo's size by joint bilateral upsampling against depth and colour; the photo's pixels are
    /// never resampled.
    pub struct Compose {
        /// `Ratio` or `Physical`.
        mode: Mode = Mode::Ratio,
        /// Albedo shown by the surface of a lamp that is switched off; 0..=1.
        lamp_albedo: f32 = 0.5,
        /// Albedo shown by the pane of a window that is switched off; 0..=1.
        pane_albedo: f32 = 0.05,
        /// Width of the bloom around a visible light, as a share of the photo's longer side, within which unexplained light is
        /// the light's own; 0..=0.1.
        bloom: f32 = 0.01,
    }
}

ports! {
    pub input ComposeIn {
        /// The linear photo.
        photo: Arc<Picture>,
        /// 1 where the photo is saturated.
        clipped: Arc<Mask>,
        /// The camera of the photo.
        camera: Arc<Camera>,
        /// Planar z at the photo's size.
        full_depth: Arc<Depth>,
        /// The photo at working size.
        small: Arc<Picture>,
        /// Planar z at working size.
        depth: Arc<Depth>,
        /// Albedo at working size.
        albedo: Arc<Albedo>,
        /// Shading by each light as estimated, working size.
        before: Gather<Shading>,
        /// Shading by each light after the edit, working size.
        after: Gather<Shading>,
        /// Shading that no light explains, working size.
        rest: Arc<Shading>,
        /// Pixels of each visible light, photo size.
        mask: Gather<Mask>,
        /// What each visible light is.
        kind: Gather<LightKind>,
        /// The lights as estimated.
        estimated: Gather<Shape>,
        /// Their radiances.
        estimated_radiance: Gather<Radiance>,
        /// The lights after the edit.
        shape: Gather<Shape>,
        /// Their radiances.
        radiance: Gather<Radiance>,
        /// Radiance after over before.
        gain: Gather<Radiance>,
        /// Pixels covered by the bodies of inserted lights, photo size.
        cover: Gather<Mask>,
    }
}

ports! {
    pub output ComposeOut {
        /// Linear, photo size, not clamped: the sum of all layers.
        picture: Arc<Picture>,
        /// What each light contributes.
        layer: Scatter<Picture>,
        /// What no light explains.
        rest: Arc<Picture>,
    }
}

/// A visible light whose pixels are in the photo.
struct Emitter {
    /// Index among the lights after the edit.
    light: usize,
    /// Distance class of each photo pixel: 2 inside, 1 in the bloom, 0 elsewhere.
    zone: Plane<u8>,
    fill: f32,
    shape: Arc<Shape>,
    radiance: Arc<Radiance>,
    gain: Arc<Radiance>,
}

impl Node for Compose {
    const KIND: &'static str = "Compose";
    const VERSION: u32 = 1;
    type In = ComposeIn;
    type Out = ComposeOut;

    fn check(&self) -> Result<(), String> {
        for (name, value, end) in
            [("lamp_albedo", self.lamp_albedo, 1.0), ("pane_albedo", self.pane_albedo, 1.0), ("bloom", self.bloom, 0.1)]
        {
            if !(0.0..=end).contains(&value) {
                return Err(format!("{name}: wanted 0..={end}, got {value}"));
            }
        }
        Ok(())
    }

    fn run(&self, inputs: ComposeIn, ctx: &Context) -> Result<ComposeOut, NodeError> {
        let (width, height) = inputs.photo.0.size();
        let names: Vec<&str> = inputs.after.iter().map(|(id, _)| id).collect();
        let count = names.len();
        let emitters = self.emitters(&inputs, &names)?;
        let inserted = inserted(&inputs, &names)?;
        let upsampler = Upsampler::new(&inputs.photo, &inputs.full_depth, &inputs.small, &inputs.depth);
        ctx.check_cancelled()?;

        // One record per pixel: each light's contribution, then the rest.
        let stride = count + 1;
        let mut records = vec![Vec3::ZERO; width * height * stride];
        records.par_chunks_mut((width * stride).max(1)).enumerate().for_each(|(y, row)| {
            for (x, record) in row.chunks_exact_mut(stride).enumerate() {
                let taps = upsampler.taps(x, y);
                let at = |plane: &Plane<Vec3>| taps.of(plane);
                for (k, (_, light)) in inputs.after.iter().enumerate() {
                    record[k] = at(&light.0);
                }
                record[count] = at(&inputs.rest.0);
                let before: Vec3 = inputs.before.iter().map(|(_, light)| at(&light.0)).sum();
                self.pixel(&inputs, &names, &emitters, (x, y), before, at, record);
                for (light, cover, glow) in &inserted {
                    let share = cover.0.get(x, y);
                    if share > 0.0 {
                        record.iter_mut().for_each(|layer| *layer *= 1.0 - share);
                        record[*light] += share * glow(x, y);
                    }
                }
            }
        });
        let plane = |k: usize| Plane::new(width, height, records.iter().skip(k).step_by(stride).copied().collect());
        let picture = Plane::new(width, height, records.chunks_exact(stride).map(|r| r.iter().sum()).collect());
        let layers = names.iter().enumerate().map(|(k, id)| (id.to_string(), Arc::new(Picture(plane(k))))).collect();
        Ok(ComposeOut {
            picture: Arc::new(Picture(picture)),
            layer: Scatter(layers),
            rest: Arc::new(Picture(plane(count))),
        })
    }
}

impl Compose {
    fn emitters(&self, inputs: &ComposeIn, names: &[&str]) -> Result<Vec<Emitter>, NodeError> {
        let missing = |id: &str, what: &str| NodeError::Failed(format!("visible light {id:?} has no {what}"));
        let mut emitters = Vec::new();
        for (id, mask) in inputs.mask.iter() {
            let light = names.iter().position(|name| *name == id).ok_or_else(|| missing(id, "layer"))?;
            let kind = inputs.kind.get(id).ok_or_else(|| missing(id, "kind"))?;
            let (w, h) = mask.0.size();
            let reach = (self.bloom * w.max(h) as f32).ceil() as usize;
            emitters.push(Emitter {
                light,
                zone: zones(&mask.0, reach),
                fill: if **kind == LightKind::Lamp { self.lamp_albedo } else { self.pane_albedo },
                shape: inputs.estimated.get(id).ok_or_else(|| missing(id, "estimate"))?.clone(),
                radiance: inputs.estimated_radiance.get(id).ok_or_else(|| missing(id, "estimated radiance"))?.clone(),
                gain: inputs.gain.get(id).ok_or_else(|| missing(id, "gain"))?.clone(),
            });
        }
        Ok(emitters)
    }

    /// Turns the shadings after the edit in `record` (each light's, then the rest) into contributions to the picture.
    #[expect(clippy::too_many_arguments, reason = "one pixel's whole state, used in one place")]
    fn pixel(
        &self,
        inputs: &ComposeIn,
        names: &[&str],
        emitters: &[Emitter],
        (x, y): (usize, usize),
        before: Vec3,
        at: impl Fn(&Plane<Vec3>) -> Vec3,
        record: &mut [Vec3],
    ) {
        let count = names.len();
        let rest = record[count];
        let photo = inputs.photo.0.get(x, y).max(Vec3::ZERO);
        let clipped = inputs.clipped.0.get(x, y) > 0.5;
        let inside = emitters.iter().find(|e| e.zone.get(x, y) == 2);
        if let Some(emitter) = inside {
            let own = inputs.before.get(names[emitter.light]).map_or(Vec3::ZERO, |light| at(&light.0));
            let others = (before - own).max(Vec3::ZERO) + rest;
            let ray = inputs.camera.unproject(x as f32 + 0.5, y as f32 + 0.5, 1.0).normalize();
            let (seen, gain) = emitter.seen(ray);
            let shown = if clipped { unclipped(photo, seen) } else { photo };
            let reflectance = ratio(photo, others).min(Vec3::splat(emitter.fill));
            let emitted = shown - (reflectance * others).min(shown);
            record.iter_mut().for_each(|layer| *layer *= reflectance);
            record[emitter.light] = emitted * gain;
            return;
        }
        let shading = before + rest;
        let albedo = at(&inputs.albedo.0);
        let shown = if clipped { unclipped(photo, albedo * shading) } else { photo };
        let bloom = emitters.iter().find(|e| e.zone.get(x, y) == 1);
        let reflectance = match (self.mode, bloom) {
            (Mode::Physical, _) => albedo,
            // Light that spills from the lamp's own pixels is no texture: the surface is as its surroundings.
            (Mode::Ratio, Some(_)) => ratio(shown, shading).min(albedo),
            (Mode::Ratio, None) => ratio(shown, shading).min(Vec3::ONE),
        };
        record.iter_mut().for_each(|layer| *layer *= reflectance);
        if self.mode == Mode::Ratio {
            let unexplained = shown - (reflectance * shading).min(shown);
            match bloom {
                Some(emitter) => {
                    let ray = inputs.camera.unproject(x as f32 + 0.5, y as f32 + 0.5, 1.0).normalize();
                    record[emitter.light] += unexplained * emitter.seen(ray).1;
                }
                None => record[count] += unexplained,
            }
        }
    }
}

impl Emitter {
    /// The radiance that the light shows along `ray`, as estimated, and the gain of what it shows.
    fn seen(&self, ray: Vec3) -> (Vec3, Vec3) {
        let (w, gain) = (&self.radiance.0, &self.gain.0);
        // A replaced light may have another number of lobes; it is gone from these pixels.
        let after: Vec<Vec3> =
            w.iter().enumerate().map(|(i, &w)| w * gain.get(i).copied().unwrap_or(Vec3::ZERO)).collect();
        let (seen, new) = match &*self.shape {
            Shape::Absent => return (Vec3::ZERO, Vec3::ONE),
            Shape::Lamp(_) => (w.iter().sum(), after.iter().sum()),
            Shape::Window(window) => (window.seen(w, ray), window.seen(&after, ray)),
        };
        let plain = gain.first().copied().unwrap_or(Vec3::ZERO);
        let gain = Vec3::from_array([0, 1, 2].map(|c| {
            let (seen, new): (Vec3, Vec3) = (seen, new);
            if seen[c] > 1e-9 { new[c] / seen[c] } else { plain[c] }
        }));
        (seen, gain)
    }
}

/// What a saturated pixel would show, by the model's word, within two stops; channels below white are as they are.
fn unclipped(photo: Vec3, model: Vec3) -> Vec3 {
    Vec3::select(photo.cmpge(Vec3::splat(0.98)), photo.max(model.min(4.0 * photo)), photo)
}

/// Per channel a / b, 1 where both vanish, large but finite where only b does.
fn ratio(a: Vec3, b: Vec3) -> Vec3 {
    (a + Vec3::splat(1e-9)) / (b + Vec3::splat(1e-9))
}

/// Lights that are drawn: index, cover, and what they show at a pixel.
#[expect(clippy::type_complexity, reason = "a list made and used in this file only")]
fn inserted<'a>(
    inputs: &'a ComposeIn,
    names: &[&str],
) -> Result<Vec<(usize, &'a Mask, Box<dyn Fn(usize, usize) -> Vec3 + Sync + 'a>)>, NodeError> {
    let mut drawn: Vec<(usize, &Mask, Box<dyn Fn(usize, usize) -> Vec3 + Sync>)> = Vec::new();
    for (light, id) in names.iter().enumerate() {
        let (Some(cover), Some(shape), Some(radiance)) =
            (inputs.cover.get(id), inputs.shape.get(id), inputs.radiance.get(id))
        else {
            return Err(NodeError::Failed(format!("light {id:?} has no cover, shape or radiance")));
        };
        if cover.0.pixels().iter().all(|&share| share == 0.0) {
            continue;
        }
        let glow: Box<dyn Fn(usize, usize) -> Vec3 + Sync> = match &**shape {
            Shape::Window(window) => Box::new(move |x, y| {
                let ray = inputs.camera.unproject(x as f32 + 0.5, y as f32 + 0.5, 1.0).normalize();
                window.seen(&radiance.0, ray)
            }),
            _ => {
                let shown = radiance.0.iter().sum();
                Box::new(move |_, _| shown)
            }
        };
        drawn.push((light, cover, glow));
    }
    Ok(drawn)
}

/// 2 inside the mask, 1 within `reach` pixels of it (in either direction of rows and columns), 0 elsewhere.
fn zones(mask: &Plane<f32>, reach: usize) -> Plane<u8> {
    let (w, h) = mask.size();
    let inside = |x: usize, y: usize| mask.get(x, y) > 0.5;
    let mut wide = Plane::filled(w, h, false);
    for y in 0..h {
        for x in (0..w).filter(|&x| inside(x, y)) {
            let (from, to) = (x.saturating_sub(reach), (x + reach + 1).min(w));
            // Inner pixels of a run have been covered by its first.
            let from = if x > 0 && inside(x - 1, y) { (x + reach).min(w - 1) } else { from };
            (from..to).for_each(|x| wide.set(x, y, true));
        }
    }
    Plane::from_fn(w, h, |x, y| {
        if inside(x, y) {
            2
        } else {
            u8::from((y.saturating_sub(reach)..(y + reach + 1).min(h)).any(|y| wide.get(x, y)))
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_zone_of_a_point_is_a_square() {
        let mut mask = Plane::filled(9, 7, 0.0);
        mask.set(4, 3, 1.0);
        mask.set(5, 3, 1.0);
        let zone = zones(&mask, 2);
        for y in 0..7 {
            for x in 0..9 {
                let inside = y == 3 && (x == 4 || x == 5);
                let near = (2..8).contains(&x) && (1..6).contains(&y);
                assert_eq!(zone.get(x, y), if inside { 2 } else { u8::from(near) }, "({x}, {y})");
            }
        }
    }
}
