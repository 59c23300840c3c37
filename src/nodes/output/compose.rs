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

mod over;

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::geometry::{Camera, Objects};
use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{
    Albedo, Coated, Coats, Depth, HalfLayer, Layer, Mask, Picture, Plane, SATURATION, Shading, Upsampler, clip_level,
    distance, luminance, ratio, reflected, smooth_step,
};
use crate::optics::{LightKind, Polish, Radiance, Reflections, Shape};
use crate::tuning::tuning;
use crate::{params, ports};

use over::Over;

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
    /// Shading is upsampled to the photo's size by a joint bilateral filter on depth and color; the
    /// photo's pixels are never resampled.
    pub struct Compose {
        /// `Ratio`, which multiplies the photo by new over old shading, or `Physical`, which
        /// multiplies the albedo by the new shading.
        mode: Mode = Mode::Ratio,
        /// Albedo of the surface of a lamp that is switched off.
        lamp_albedo: f32 = 0.5, in 0.0..=1.0,
        /// Albedo of the pane of a window that is switched off.
        pane_albedo: f32 = 0.05, in 0.0..=1.0,
        /// Reflected radiance of the unseen part of the room, as a multiple of the mean of the seen
        /// part. A network's lighting takes precedence.
        unseen: f32 = 0.5, in 0.0..=1.0,
    }
}

ports! {
    pub input ComposeIn {
        /// The linear photo.
        photo: Arc<Picture>,
        /// Mask of saturated pixels, 1 where the photo is saturated.
        clipped: Arc<Mask>,
        /// The camera of the photo.
        camera: Arc<Camera>,
        /// Planar depth at the photo's size.
        full_depth: Arc<Depth>,
        /// The photo at working size.
        small: Arc<Picture>,
        /// Planar depth at working size.
        depth: Arc<Depth>,
        /// Estimated albedo, working size.
        albedo: Arc<Albedo>,
        /// Reflectance at working size: photo over shading, filled in under lights.
        paint: Arc<Albedo>,
        /// Paint layers of the edit, photo size.
        coats: Arc<Coats>,
        /// Shading by each light as estimated, working size.
        before: Gather<Shading>,
        /// Shading by each light after the edit, working size.
        after: Gather<Shading>,
        /// Residual shading, which no light explains, working size.
        rest: Arc<Shading>,
        /// The residual shading after the edit.
        edited_rest: Arc<Shading>,
        /// Weight with which each photo pixel belongs to a visible light: 1 in its own pixels, less
        /// in its glare and bloom.
        zone: Gather<Mask>,
        /// Kind of each visible light.
        kind: Gather<LightKind>,
        /// The estimated lights.
        estimated: Gather<Shape>,
        /// Their radiances.
        estimated_radiance: Gather<Radiance>,
        /// The lights after the edit.
        shape: Gather<Shape>,
        /// Their radiances.
        radiance: Gather<Radiance>,
        /// Ratio of the radiance after the edit to that before.
        gain: Gather<Radiance>,
        /// Coverage by the bodies of inserted lights, photo size.
        cover: Gather<Mask>,
        /// The visible inserted objects.
        objects: Arc<Objects>,
        /// Pictures of the objects under each light.
        object: Gather<Picture>,
        /// Picture of the objects under residual light.
        object_rest: Arc<Picture>,
        /// Reflections on shiny objects; empty without such objects.
        reflected: Gather<Reflections>,
        /// Reflections on surfaces of new roughness or specular level; empty without such surfaces.
        polish: Gather<Polish>,
    }
}

ports! {
    pub output ComposeOut {
        /// The linear picture at the photo's size, not clamped: the sum of all layers.
        picture: Arc<Picture>,
        /// The contribution of each light.
        layer: Scatter<Layer>,
        /// The contribution of the residual, which no light explains.
        rest: Arc<Layer>,
    }
}

tuning! {
    /// Constants of `Compose`.
    pub const TUNING: ComposeTuning {
        /// Rows that are composed at a time.
        band: usize = 64, unit "pixels", source Taste, effect "a larger value takes more memory; no pixel changes";
        /// Level at which a channel counts as saturated: 254 of 255 in sRGB.
        saturated: f32 = 0.991,
            unit "fraction of the clip level", source Derived("sRGB"), effect "a smaller value brightens pixels that are not clipped";
        /// Greatest value of a saturated channel: two stops.
        max_headroom: f32 = 4.0,
            unit "ratio to the photo", source Taste, effect "a larger value lets saturated pixels get brighter";
        /// Growth of the greatest value of a saturated pixel with its distance from the edge of the
        /// saturated region, so that there is no step at the edge.
        headroom_slope: f32 = 0.15,
            unit "1/pixel", source Taste, effect "a larger value shows an edge around saturated regions";
        /// Least contribution of a light that owns a part of a saturated pixel.
        min_contribution: f32 = 0.5,
            unit "fraction of the strongest light's", source Taste, effect "a smaller value divides pixels among more lights";
    }
}

/// A visible light whose pixels are in the photo.
struct Emitter {
    /// Index among the lights after the edit.
    light: usize,
    zone: Arc<Mask>,
    fill: f32,
    shape: Arc<Shape>,
    radiance: Arc<Radiance>,
    gain: Arc<Radiance>,
}

impl Node for Compose {
    const KIND: &'static str = "Compose";
    const VERSION: u32 = 7;
    type In = ComposeIn;
    type Out = ComposeOut;

    fn run(&self, inputs: ComposeIn, ctx: &Context) -> Result<ComposeOut, NodeError> {
        let (width, height) = inputs.photo.0.size();
        let names: Vec<&str> = inputs.after.iter().map(|(id, _)| id).collect();
        let count = names.len();
        let emitters = self.emitters(&inputs, &names)?;
        let inserted = inserted(&inputs, &names)?;
        let objects = objects(&inputs, &names)?;
        let upsampler = Upsampler::new(&inputs.photo, &inputs.full_depth, &inputs.small, &inputs.depth);
        let white = clip_level(&inputs.photo, &inputs.clipped);
        let depth_of_white = distance(&inputs.clipped.0.map(|share| share < 0.5));
        ctx.check_cancelled()?;

        // One record per pixel: each light's contribution, then the rest. Band by band, since the records of a large photo would
        // take as much memory as all its layers.
        let stride = count + 1;
        let row = |y: usize, row: &mut [Vec3]| {
            let mut before = Vec::with_capacity(count);
            for (x, record) in row.chunks_exact_mut(stride).enumerate() {
                let taps = upsampler.taps(x, y);
                let at = |plane: &Plane<Vec3>| taps.of(plane);
                for (k, (_, light)) in inputs.after.iter().enumerate() {
                    record[k] = at(&light.0);
                }
                record[count] = at(&inputs.edited_rest.0);
                before.clear();
                before.extend(names.iter().map(|id| inputs.before.get(id).map_or(Vec3::ZERO, |light| at(&light.0))));
                let surface = Surface {
                    rest: at(&inputs.rest.0),
                    albedo: at(&inputs.albedo.0),
                    paint: at(&inputs.paint.0),
                    coated: inputs.coats.at(x, y),
                    white,
                    headroom: (1.0 + TUNING.headroom_slope * depth_of_white.get(x, y)).min(TUNING.max_headroom),
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
        };
        let mut records = vec![Vec3::ZERO; width * TUNING.band.min(height) * stride];
        let mut each_band = |take: &mut dyn FnMut(usize, &[Vec3])| -> Result<(), NodeError> {
            for top in (0..height).step_by(TUNING.band) {
                ctx.check_cancelled()?;
                let records = &mut records[..width * TUNING.band.min(height - top) * stride];
                let rows = records.par_chunks_mut((width * stride).max(1)).enumerate();
                rows.for_each(|(y, records)| row(top + y, records));
                take(top * width, records);
            }
            Ok(())
        };
        let finish = |picture: Vec<Vec3>, layers: Vec<Layer>| {
            let mut layers = layers.into_iter().map(Arc::new);
            ComposeOut {
                picture: Arc::new(Picture(Plane::new(width, height, picture))),
                layer: Scatter(names.iter().map(|id| id.to_string()).zip(layers.by_ref()).collect()),
                rest: layers.next().expect("the rest follows the lights"),
            }
        };
        if inputs.polish.iter().next().is_none() && objects.is_empty() {
            // No pixel looks at another: halves at once, so that no layer is ever in memory as floats.
            let mut picture = Vec::with_capacity(width * height);
            let mut layers: Vec<HalfLayer> = (0..stride).map(|_| HalfLayer::new(width, height)).collect();
            each_band(&mut |at, records| {
                picture.extend(records.chunks_exact(stride).map(|record| record.iter().sum::<Vec3>()));
                let layers = layers.par_iter_mut().enumerate();
                layers.for_each(|(k, layer)| layer.put(at, records.iter().skip(k).step_by(stride).copied()));
            })?;
            if let Some(layers) = layers.into_iter().map(HalfLayer::finish).collect() {
                return Ok(finish(picture, layers));
            }
        }
        let mut planes: Vec<Vec<Vec3>> = (0..stride).map(|_| Vec::with_capacity(width * height)).collect();
        each_band(&mut |_, records| {
            for (k, plane) in planes.iter_mut().enumerate() {
                plane.extend(records.iter().skip(k).step_by(stride));
            }
        })?;
        let lamps: Vec<&Mask> = inserted.iter().map(|(_, cover, _)| *cover).collect();
        let over = Over { inputs: &inputs, names: &names, objects: &objects, lamps: &lamps, unseen: self.unseen };
        for (_, polish) in inputs.polish.iter() {
            ctx.check_cancelled()?;
            over.polish(polish, &mut planes)?;
        }
        if !objects.is_empty() {
            over.cover(&mut planes)?;
        }
        let sum = |i: usize| planes.iter().map(|plane| plane[i]).sum::<Vec3>();
        let picture: Vec<Vec3> = (0..width * height).into_par_iter().with_min_len(width.max(1)).map(sum).collect();
        let layers = planes.into_iter().map(|plane| Layer::new(Plane::new(width, height, plane)));
        Ok(finish(picture, layers.collect()))
    }
}

impl Compose {
    fn emitters(&self, inputs: &ComposeIn, names: &[&str]) -> Result<Vec<Emitter>, NodeError> {
        let missing = |id: &str, what: &str| NodeError::Failed(format!("visible light {id:?} has no {what}"));
        let mut emitters = Vec::new();
        for (id, zone) in inputs.zone.iter() {
            let light = names.iter().position(|name| *name == id).ok_or_else(|| missing(id, "layer"))?;
            let kind = inputs.kind.get(id).ok_or_else(|| missing(id, "kind"))?;
            emitters.push(Emitter {
                light,
                zone: zone.clone(),
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
        let Surface { rest, albedo, paint, coated, white, headroom } = surface;
        let shading = before.iter().sum::<Vec3>() + rest;
        let photo = inputs.photo.0.get(x, y).max(Vec3::ZERO);
        let ray = || inputs.camera.unproject(x as f32 + 0.5, y as f32 + 0.5, 1.0).normalize();
        let nearest = emitters.iter().map(|e| (e.zone.0.get(x, y), e)).reduce(|a, b| if b.0 > a.0 { b } else { a });
        if let Some((1.0, emitter)) = nearest {
            let (seen, gain) = emitter.seen(ray());
            let shown = unclipped(photo, white, seen, TUNING.max_headroom);
            let others = shading - before[emitter.light];
            let (reflectance, remainder) = owned(shown, others, Vec3::splat(emitter.fill));
            record.iter_mut().for_each(|layer| *layer *= reflectance);
            record[emitter.light] = remainder * gain;
            return;
        }
        let shown = unclipped(photo, white, paint * shading, headroom);
        if self.mode == Mode::Physical {
            let albedo = coated.reflectance(albedo, photo);
            record.iter_mut().for_each(|layer| *layer *= albedo);
            return;
        }
        let saturation = smooth_step(SATURATION[0] * white, SATURATION[1] * white, photo.max_element());
        let (share, owners) = match nearest {
            Some((zone, emitter)) if zone > 0.0 => {
                (saturation.max(zone), vec![(1.0, emitter.light, emitter.seen(ray()).1)])
            }
            _ if saturation > 0.0 => (saturation, strongest(before, record)),
            _ => (0.0, Vec::new()),
        };
        let reflectance = reflected(shown, shading);
        let unexplained = coated.tint(shown - (reflectance * shading).min(shown), shading);
        let reflectance = coated.reflectance(reflectance, shown);
        let shaded = if owners.is_empty() { Vec::new() } else { record.to_vec() };
        record.iter_mut().for_each(|layer| *layer *= reflectance);
        record[before.len()] += unexplained;
        if owners.is_empty() {
            return;
        }
        record.iter_mut().for_each(|layer| *layer *= 1.0 - share);
        for (part, light, gain) in owners {
            let (reflectance, remainder) = owned(shown, shading - before[light], paint);
            let remainder = coated.tint(remainder, before[light]);
            let reflectance = coated.reflectance(reflectance, shown);
            let mut other: Vec<Vec3> = shaded.iter().map(|layer| *layer * reflectance).collect();
            other[light] = remainder * gain;
            record.iter_mut().zip(other).for_each(|(layer, other)| *layer += share * part * other);
        }
    }
}

/// A pixel that is mostly one light's: what the surface, of at most this albedo, reflects of the `others`, and the remainder
/// of what is shown.
fn owned(shown: Vec3, others: Vec3, albedo: Vec3) -> (Vec3, Vec3) {
    let reflectance = ratio(shown, others.max(Vec3::ZERO)).min(albedo);
    (reflectance, (shown - reflectance * others.max(Vec3::ZERO)).max(Vec3::ZERO))
}

/// The lights that give most, with parts that sum to 1, and their gains. One that gives half of what the strongest does has no
/// part, and the parts go up from there: a little noise must not give a pixel from one light to another.
fn strongest(before: &[Vec3], after: &[Vec3]) -> Vec<(f32, usize, Vec3)> {
    let most = before.iter().map(|light| luminance(*light)).fold(0.0, f32::max);
    let parts: Vec<f32> =
        before.iter().map(|light| smooth_step(TUNING.min_contribution * most, most, luminance(*light))).collect();
    let sum = parts.iter().sum::<f32>();
    let all = parts.into_iter().enumerate().filter(|(_, part)| *part > 0.0);
    all.map(|(k, part)| (part / sum, k, gain_of(before[k], after[k]))).collect()
}

/// What a light's shading changes by, per channel.
fn gain_of(before: Vec3, after: Vec3) -> Vec3 {
    Vec3::from_array([0, 1, 2].map(|c| if before[c] > 1e-9 { after[c] / before[c] } else { 1.0 }))
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
struct Surface<'a> {
    /// Shading that no light explains, before the edit.
    rest: Vec3,
    /// As estimated.
    albedo: Vec3,
    /// Photo over shading, filled in where a light hides it.
    paint: Vec3,
    /// What the edit puts over it.
    coated: Coated<'a>,
    /// Where the photo is clipped.
    white: f32,
    /// How many times brighter than white a saturated channel may be.
    headroom: f32,
}

/// What a pixel shows when saturated channels are as bright as the model says, within `headroom`; others are as they are.
fn unclipped(photo: Vec3, white: f32, model: Vec3, headroom: f32) -> Vec3 {
    Vec3::select(photo.cmpge(Vec3::splat(TUNING.saturated * white)), photo.max(model.min(headroom * photo)), photo)
}

/// What objects show of each light, in the order of `names`, then of the rest; nothing when none is seen.
fn objects<'a>(inputs: &'a ComposeIn, names: &[&str]) -> Result<Vec<&'a Picture>, NodeError> {
    if inputs.objects.is_empty() {
        return Ok(Vec::new());
    }
    let of = |id: &&str| {
        let shown = inputs.object.get(id);
        shown.ok_or_else(|| NodeError::Failed(format!("light {id:?} has no picture of the objects")))
    };
    let lights: Result<Vec<_>, NodeError> = names.iter().map(of).collect();
    let all: Vec<&Picture> = lights?.into_iter().chain([&inputs.object_rest]).map(|shown| &**shown).collect();
    let size = inputs.objects.cover.size();
    match all.iter().find(|shown| shown.0.size() != size) {
        Some(shown) => {
            let ((w, h), got) = (size, shown.0.size());
            Err(NodeError::Failed(format!("a picture of the objects is {} x {}, wanted {w} x {h}", got.0, got.1)))
        }
        None => Ok(all),
    }
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
            lamp => {
                let towards = lamp.ball().map_or(Vec3::NEG_Z, |(center, _)| center.normalize_or_zero());
                let shown = lamp.shown(0, towards) * radiance.0.iter().sum::<Vec3>();
                Box::new(move |_, _| shown)
            }
        };
        drawn.push((light, cover, glow));
    }
    Ok(drawn)
}
