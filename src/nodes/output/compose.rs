//! `Compose`: from shading to a picture, and to one picture per light.
//!
//! Away from lights, a pixel of the photo I under shading E = sum E_k + R (R the rest, what no light explains) becomes, after
//! an edit, `sum B E'_k + B R + U`. Under `Ratio`, B = I / E as far as it can be a reflectance (at most 1, colour kept),
//! and U = I - B E is unexplained light (a highlight, an unseen sun) that stays as it is and is told as part of `light_rest`.
//! So the identity gives the photo back, texture and resolution survive, and each term is linear in its light's radiance.
//! Under `Physical`, B is the estimated albedo and U = 0.
//!
//! Some pixels are one light's more than any other's: those that it is seen in, those it spills into around its outline, and
//! those it saturates, where I / E says nothing of the surface. There the photo is what the surface, of known albedo, shows of
//! the others, and all else is that light's: I = B (E - E_k) + G with B = min(A, I / (E - E_k)). G goes with the light's own
//! change. In the light's own pixels A is that of a shade or a pane; elsewhere I / E of the surface around, and the two ways are
//! blended where saturation and spill begin, so that no rim shows.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::geometry::Camera;
use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{
    Albedo, Depth, Mask, Normal, Picture, Plane, Points, Shading, Upsampler, fill_along_surfaces, grow_through,
    luminance,
};
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
        /// Points of the seen surface, working size.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
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
    /// How far each photo pixel is the light's own: see [`zone`].
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
        let paint = paint(&inputs, &emitters);
        let depth_of_white = distance(&inputs.clipped.0.map(|share| share < 0.5));
        ctx.check_cancelled()?;

        // One record per pixel: each light's contribution, then the rest.
        let stride = count + 1;
        let mut records = vec![Vec3::ZERO; width * height * stride];
        records.par_chunks_mut((width * stride).max(1)).enumerate().for_each(|(y, row)| {
            let mut before = Vec::with_capacity(count);
            for (x, record) in row.chunks_exact_mut(stride).enumerate() {
                let taps = upsampler.taps(x, y);
                let at = |plane: &Plane<Vec3>| taps.of(plane);
                for (k, (_, light)) in inputs.after.iter().enumerate() {
                    record[k] = at(&light.0);
                }
                record[count] = at(&inputs.rest.0);
                before.clear();
                before.extend(names.iter().map(|id| inputs.before.get(id).map_or(Vec3::ZERO, |light| at(&light.0))));
                let surface = Surface {
                    albedo: at(&inputs.albedo.0),
                    paint: at(&paint),
                    headroom: (1.0 + HEADROOM * depth_of_white.get(x, y)).min(4.0),
                };
                self.pixel(&inputs, &emitters, (x, y), &before, surface, record);
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
            let bloom = self.bloom * w.max(h) as f32;
            emitters.push(Emitter {
                light,
                zone: zone(&mask.0, **kind, bloom, &inputs.photo, &inputs.clipped),
                fill: if **kind == LightKind::Lamp { self.lamp_albedo } else { self.pane_albedo },
                shape: inputs.estimated.get(id).ok_or_else(|| missing(id, "estimate"))?.clone(),
                radiance: inputs.estimated_radiance.get(id).ok_or_else(|| missing(id, "estimated radiance"))?.clone(),
                gain: inputs.gain.get(id).ok_or_else(|| missing(id, "gain"))?.clone(),
            });
        }
        Ok(emitters)
    }

    /// Turns the shadings after the edit in `record` (each light's, then the rest) into contributions to the picture.
    fn pixel(
        &self,
        inputs: &ComposeIn,
        emitters: &[Emitter],
        (x, y): (usize, usize),
        before: &[Vec3],
        surface: Surface,
        record: &mut [Vec3],
    ) {
        let Surface { albedo, paint, headroom } = surface;
        let rest = record[before.len()];
        let shading = before.iter().sum::<Vec3>() + rest;
        let photo = inputs.photo.0.get(x, y).max(Vec3::ZERO);
        let ray = || inputs.camera.unproject(x as f32 + 0.5, y as f32 + 0.5, 1.0).normalize();
        let nearest = emitters.iter().map(|e| (e.zone.get(x, y), e)).reduce(|a, b| if b.0 > a.0 { b } else { a });
        if let Some((1.0, emitter)) = nearest {
            let (seen, gain) = emitter.seen(ray());
            let shown = unclipped(photo, seen, headroom);
            let others = shading - before[emitter.light];
            owned(record, shown, others, Vec3::splat(emitter.fill), emitter.light, gain);
            return;
        }
        let shown = unclipped(photo, paint * shading, headroom);
        if self.mode == Mode::Physical {
            record.iter_mut().for_each(|layer| *layer *= albedo);
            return;
        }
        let saturation = smooth_step(SATURATION[0], SATURATION[1], photo.max_element());
        let (spill, owner) = match nearest {
            Some((zone, emitter)) if zone > 0.0 => (zone, Some((emitter.light, emitter.seen(ray()).1))),
            _ => (0.0, strongest(before).map(|k| (k, gain_of(before[k], record[k])))),
        };
        let share = saturation.max(spill);
        let reflectance = reflected(shown, shading);
        let unexplained = shown - (reflectance * shading).min(shown);
        let Some((light, gain)) = owner.filter(|_| share > 0.0) else {
            record.iter_mut().for_each(|layer| *layer *= reflectance);
            record[before.len()] += unexplained;
            return;
        };
        let mut other = record.to_vec();
        owned(&mut other, shown, shading - before[light], paint, light, gain);
        record.iter_mut().for_each(|layer| *layer *= reflectance);
        record[before.len()] += unexplained;
        record.iter_mut().zip(other).for_each(|(layer, other)| *layer += share * (other - *layer));
    }
}

/// A pixel that is mostly `light`'s: the surface reflects what it can of the `others`, the remainder of what is shown goes
/// with `gain`.
fn owned(record: &mut [Vec3], shown: Vec3, others: Vec3, albedo: Vec3, light: usize, gain: Vec3) {
    let reflectance = ratio(shown, others.max(Vec3::ZERO)).min(albedo);
    let remainder = (shown - reflectance * others.max(Vec3::ZERO)).max(Vec3::ZERO);
    record.iter_mut().for_each(|layer| *layer *= reflectance);
    record[light] = remainder * gain;
}

/// The light that gives most.
fn strongest(before: &[Vec3]) -> Option<usize> {
    let lights = before.iter().map(|light| luminance(*light)).enumerate();
    lights.filter(|l| l.1 > 0.0).reduce(|a, b| if b.1 > a.1 { b } else { a }).map(|(k, _)| k)
}

/// What a light's shading changes by, per channel.
fn gain_of(before: Vec3, after: Vec3) -> Vec3 {
    Vec3::from_array([0, 1, 2].map(|c| if before[c] > 1e-9 { after[c] / before[c] } else { 1.0 }))
}

/// 0 up to `from`, 1 from `to` on, without a kink.
fn smooth_step(from: f32, to: f32, x: f32) -> f32 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
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

/// What is known of the surface at a photo pixel.
struct Surface {
    /// As estimated.
    albedo: Vec3,
    /// Photo over shading, filled in where a light hides it: see [`paint`].
    paint: Vec3,
    /// How many times brighter than white a saturated channel may be.
    headroom: f32,
}

/// Growth of what a saturated pixel may show per pixel of distance from the edge of the white: no step at that edge.
const HEADROOM: f32 = 0.15;

/// What a pixel shows when saturated channels are as bright as the model says, within `headroom`; others are as they are.
fn unclipped(photo: Vec3, model: Vec3, headroom: f32) -> Vec3 {
    Vec3::select(photo.cmpge(Vec3::splat(0.98)), photo.max(model.min(headroom * photo)), photo)
}

/// Reflectance at working size: photo over shading, and, where lights and saturation hide the surface, that of the
/// surface around, so that nothing changes at their edge.
fn paint(inputs: &ComposeIn, emitters: &[Emitter]) -> Plane<Vec3> {
    let (w, h) = inputs.small.0.size();
    let (full_w, full_h) = inputs.photo.0.size();
    // The zones are at the photo's size; the largest of a working pixel's is its own.
    let mut hidden = Plane::filled(w, h, false);
    for zone in emitters.iter().map(|e| &e.zone) {
        for i in (0..zone.len()).filter(|&i| zone.pixels()[i] > 0.0) {
            hidden.set(i % full_w * w / full_w, i / full_w * h / full_h, true);
        }
    }
    let reflectance = |i: usize| {
        let lights = inputs.before.iter().map(|(_, light)| light.0.pixels()[i]);
        reflected(inputs.small.0.pixels()[i], lights.sum::<Vec3>() + inputs.rest.0.pixels()[i])
    };
    let mut paint = Plane::new(w, h, (0..w * h).map(reflectance).collect());
    for (hidden, shown) in hidden.pixels_mut().iter_mut().zip(inputs.small.0.pixels()) {
        *hidden |= shown.max_element() > SATURATION[0];
    }
    fill_along_surfaces(&mut paint, hidden, &inputs.points, &inputs.normal);
    paint
}

/// Largest channel from which, and at which wholly, a pixel is the strongest light's.
const SATURATION: [f32; 2] = [0.75, 0.98];

/// Per channel a / b, 1 where both vanish, large but finite where only b does.
fn ratio(a: Vec3, b: Vec3) -> Vec3 {
    (a + Vec3::splat(1e-9)) / (b + Vec3::splat(1e-9))
}

/// The part of `photo` over `shading` that is taken for a reflectance: at most 1 in the largest channel, the colour kept, so that
/// what stays unexplained has the photo's colour and not that of one channel.
fn reflected(photo: Vec3, shading: Vec3) -> Vec3 {
    let whole = ratio(photo, shading);
    whole / whole.max_element().max(1.0)
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

/// Share of a lamp's brightness below which a pixel of its mask is no part of what shines: feet and stands are often in it.
const STAND: f32 = 0.3;
/// A light's own glare: all but its own pixels.
const GLARE: f32 = 0.999;

/// How far each pixel is the light's own: 1 where it is the light, [`GLARE`] in the saturated pixels around it, falling to 0
/// in its bloom, whose width is at least `bloom` pixels and, for a lamp, half its own.
fn zone(mask: &Plane<f32>, kind: LightKind, bloom: f32, photo: &Picture, clipped: &Mask) -> Plane<f32> {
    let (w, h) = mask.size();
    let inside = mask.pixels().iter().zip(photo.0.pixels()).filter(|(share, _)| **share > 0.5);
    let mut levels: Vec<f32> = inside.map(|(_, &shown)| luminance(shown)).collect();
    levels.sort_by(f32::total_cmp);
    let bright = levels.get(levels.len() * 9 / 10).copied().unwrap_or(0.0);
    let (core, reach, dark) = match kind {
        LightKind::Lamp => {
            let core = grow_through(mask, &clipped.0);
            let area = core.pixels().iter().filter(|inside| **inside).count();
            (core, bloom.max(0.5 * (area as f32).sqrt()), STAND * bright)
        }
        LightKind::Window => (mask.map(|share| share > 0.5), bloom, 0.0),
    };
    let away = distance(&core);
    Plane::from_fn(w, h, |x, y| {
        if mask.get(x, y) > 0.5 && luminance(photo.0.get(x, y)) >= dark {
            1.0
        } else {
            GLARE * (1.0 - smooth_step(0.0, reach.max(1.0), away.get(x, y)))
        }
    })
}

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
