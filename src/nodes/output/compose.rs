//! `Compose`: from shading to a picture, and to one picture per light.
//!
//! Away from lights, a pixel of the photo I under shading E = sum E_k + R (R the rest, what no light explains) becomes, after
//! an edit, `sum B E'_k + B R + U`. Under `Ratio`, B = I / E, at most 2 in the largest channel (see `reflected`),
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
use crate::image::{Albedo, Depth, Mask, Picture, Plane, Shading, Upsampler, grow_through, luminance};
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
        lamp_albedo: f32 = 0.7,
        /// Albedo shown by the pane of a window that is switched off; 0..=1.
        pane_albedo: f32 = 0.05,
        /// Least width of the bloom around a visible light, as a share of the photo's longer side, within which unexplained
        /// light is the light's own; a lamp's bloom is at least half as wide as the lamp. 0..=0.1.
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
    /// How far each photo pixel is the light's own: 2 where it is the light, 1 in its glare, falling to 0 in its bloom.
    zone: Plane<f32>,
    fill: f32,
    shape: Arc<Shape>,
    radiance: Arc<Radiance>,
    gain: Arc<Radiance>,
}

impl Node for Compose {
    const KIND: &'static str = "Compose";
    const VERSION: u32 = 2;
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
        let paints: Vec<Paint> =
            emitters.iter().map(|e| Paint::around(&e.zone, &emitters, &inputs, &upsampler)).collect();
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
                self.pixel(&inputs, &names, &emitters, &paints, (x, y), before, at, record);
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
            emitters.push(Emitter {
                light,
                zone: self.zone(&mask.0, **kind, inputs),
                fill: if **kind == LightKind::Lamp { self.lamp_albedo } else { self.pane_albedo },
                shape: inputs.estimated.get(id).ok_or_else(|| missing(id, "estimate"))?.clone(),
                radiance: inputs.estimated_radiance.get(id).ok_or_else(|| missing(id, "estimated radiance"))?.clone(),
                gain: inputs.gain.get(id).ok_or_else(|| missing(id, "gain"))?.clone(),
            });
        }
        Ok(emitters)
    }

    /// How far each pixel is the light's own.
    fn zone(&self, mask: &Plane<f32>, kind: LightKind, inputs: &ComposeIn) -> Plane<f32> {
        let (w, h) = mask.size();
        let mut reach = (self.bloom * w.max(h) as f32).max(1.0);
        let mut own: Vec<f32> = mask
            .pixels()
            .iter()
            .zip(inputs.photo.0.pixels())
            .filter(|(m, _)| **m > 0.5)
            .map(|(_, &v)| luminance(v))
            .collect();
        own.sort_by(f32::total_cmp);
        let shown = |share: f32| own.get((share * own.len() as f32) as usize).copied().unwrap_or(0.0);
        // Foot and stand of a lamp are often in its mask.
        let dark = if kind == LightKind::Lamp { STAND * shown(0.9) } else { 0.0 };
        let core = match kind {
            LightKind::Lamp => {
                let core = grow_through(mask, &inputs.clipped.0);
                let area = core.pixels().iter().filter(|inside| **inside).count();
                reach = reach.max(0.5 * (area as f32).sqrt());
                core
            }
            LightKind::Window => mask.map(|share| share > 0.5),
        };
        let away = distance(&core);
        Plane::from_fn(w, h, |x, y| {
            if mask.get(x, y) > 0.5 && luminance(inputs.photo.0.get(x, y)) >= dark {
                2.0
            } else {
                let far = (away.get(x, y) / reach).min(1.0);
                1.0 - far * far * (3.0 - 2.0 * far)
            }
        })
    }

    /// Turns the shadings after the edit in `record` (each light's, then the rest) into contributions to the picture.
    #[expect(clippy::too_many_arguments, reason = "one pixel's whole state, used in one place")]
    fn pixel(
        &self,
        inputs: &ComposeIn,
        names: &[&str],
        emitters: &[Emitter],
        paints: &[Paint],
        (x, y): (usize, usize),
        before: Vec3,
        at: impl Fn(&Plane<Vec3>) -> Vec3,
        record: &mut [Vec3],
    ) {
        let count = names.len();
        let rest = record[count];
        let photo = inputs.photo.0.get(x, y).max(Vec3::ZERO);
        let clipped = inputs.clipped.0.get(x, y) > 0.5;
        let inside = emitters.iter().find(|e| e.zone.get(x, y) == 2.0);
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
        let bloom = emitters.iter().zip(paints).map(|e| (e, e.0.zone.get(x, y))).filter(|(_, near)| *near > 0.0);
        let bloom = bloom.reduce(|a, b| if b.1 > a.1 { b } else { a });
        let whole = reflected(shown, shading);
        let reflectance = match (self.mode, bloom) {
            (Mode::Physical, _) => albedo,
            // Light that spills from the lamp's own pixels is no texture: the surface is as its surroundings.
            (Mode::Ratio, Some(((_, paint), near))) => whole.lerp(whole.min(paint.at(x, y).unwrap_or(albedo)), near),
            (Mode::Ratio, None) => whole,
        };
        record.iter_mut().for_each(|layer| *layer *= reflectance);
        if self.mode == Mode::Ratio {
            let unexplained = shown - (reflectance * shading).min(shown);
            match bloom {
                Some(((emitter, _), near)) => {
                    let ray = inputs.camera.unproject(x as f32 + 0.5, y as f32 + 0.5, 1.0).normalize();
                    record[emitter.light] += unexplained * near * emitter.seen(ray).1;
                    record[count] += unexplained * (1.0 - near);
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

/// What the surface around a light's glare reflects: photo over shading on its rim, for the glare to be filled with.
struct Paint(Vec<(glam::Vec2, Vec3)>);

/// Places on the rim that are enough for a smooth filling.
const RIM: usize = 400;

impl Paint {
    fn around(zone: &Plane<f32>, emitters: &[Emitter], inputs: &ComposeIn, upsampler: &Upsampler) -> Paint {
        let (w, h) = zone.size();
        let free =
            |x: usize, y: usize| emitters.iter().all(|e| e.zone.get(x, y) == 0.0) && inputs.clipped.0.get(x, y) < 0.5;
        let beside = |x: usize, y: usize| {
            (y.saturating_sub(1)..(y + 2).min(h))
                .any(|y| (x.saturating_sub(1)..(x + 2).min(w)).any(|x| zone.get(x, y) > 0.0))
        };
        let rim = (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).filter(|&(x, y)| beside(x, y) && free(x, y));
        let rim: Vec<(usize, usize)> = rim.collect();
        let places = rim.iter().step_by(rim.len().div_ceil(RIM).max(1)).map(|&(x, y)| {
            let taps = upsampler.taps(x, y);
            let lights = inputs.before.iter().map(|(_, light)| taps.of(&light.0));
            let shading = lights.sum::<Vec3>() + taps.of(&inputs.rest.0);
            (glam::Vec2::new(x as f32, y as f32), reflected(inputs.photo.0.get(x, y).max(Vec3::ZERO), shading))
        });
        Paint(places.collect())
    }

    /// Mean of the rim, weighted by distance^-3 (Shepard, 1968); `None` without a rim.
    fn at(&self, x: usize, y: usize) -> Option<Vec3> {
        let here = glam::Vec2::new(x as f32, y as f32);
        let (sum, total) = self.0.iter().fold((Vec3::ZERO, 0.0), |(sum, total), (place, value)| {
            let square = place.distance_squared(here).max(1.0);
            let weight = 1.0 / (square * square.sqrt());
            (sum + *value * weight, total + weight)
        });
        (total > 0.0).then(|| sum / total)
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

/// The part of `photo` over `shading` that is taken for a reflectance: at most [`MOST`] in the largest channel, the colour kept, so
/// that what stays unexplained has the photo's colour and not that of one channel.
fn reflected(photo: Vec3, shading: Vec3) -> Vec3 {
    let whole = ratio(photo, shading);
    whole * (MOST / whole.max_element()).min(1.0)
}

/// Above 1, since a wall under somewhat too weak estimated light is still a wall.
const MOST: f32 = 2.0;

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

/// Share of a lamp's brightness below which a pixel of its mask is no part of what shines.
const STAND: f32 = 0.3;

/// Distance of each pixel from `core`, in pixels, to a few per cent: Borgefors' chamfer (1986) with steps 1 and sqrt 2.
fn distance(core: &Plane<bool>) -> Plane<f32> {
    let (w, h) = core.size();
    let mut away = core.map(|inside| if inside { 0.0 } else { f32::MAX });
    let diagonal = std::f32::consts::SQRT_2;
    let mut relax = |x: usize, y: usize, steps: [(isize, isize, f32); 4]| {
        let near = steps.into_iter().filter_map(|(dx, dy, step)| {
            let (x, y) = (x.checked_add_signed(dx)?, y.checked_add_signed(dy)?);
            (x < w && y < h).then(|| away.get(x, y) + step)
        });
        let least = near.fold(away.get(x, y), f32::min);
        away.set(x, y, least);
    };
    for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
        relax(x, y, [(-1, 0, 1.0), (0, -1, 1.0), (-1, -1, diagonal), (1, -1, diagonal)]);
    }
    for (x, y) in (0..h).rev().flat_map(|y| (0..w).rev().map(move |x| (x, y))) {
        relax(x, y, [(1, 0, 1.0), (0, 1, 1.0), (1, 1, diagonal), (-1, 1, diagonal)]);
    }
    away
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_euclidean_to_eight_per_cent() {
        let mut core = Plane::filled(40, 30, false);
        core.set(12, 9, true);
        let away = distance(&core);
        for (x, y) in (0..40).flat_map(|x| (0..30).map(move |y| (x, y))) {
            let exact = (x as f32 - 12.0).hypot(y as f32 - 9.0);
            // The octagon of the chamfer lies at most 1 / cos(22.5 degrees) = 1.082 outside the circle.
            assert!(away.get(x, y) >= exact - 1e-3 && away.get(x, y) <= 1.083 * exact + 1e-3, "({x}, {y})");
        }
        assert!(distance(&Plane::filled(3, 3, false)).pixels().iter().all(|d| *d > 1e30));
    }
}
