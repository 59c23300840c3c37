//! The lights, arranged for the pixels of the photo.

use std::sync::Arc;

use glam::{BVec3, Vec3};

use super::ComposeIn;
use super::lamp_surface::LampSurface;
use crate::graph::NodeError;
use crate::image::{
    GlareMask, GlarePixel, LampLight, Mask, OwnPixel, Plane, PlaneBundle, RELIT_PIXEL,
    SaturatedRegions, Taps, dilate, gain, inpaint, luminance, resize,
};
use crate::nodes::artifacts::{EmitterChange, ScatteredLight, same_size};
use crate::optics::{LightKind, PaneRay, PaneRays, Radiance, Shape, Silhouette, Window};
use crate::tuning::tuning;

/// The lights after the edit, with their layers in the photo and in the estimates.
pub struct LightLayers<'a> {
    /// Names, in the order of the layers.
    pub names: Vec<&'a str>,
    planes: WorkingPlanes,
    /// Lights that the photo shows.
    emitters: Vec<VisibleEmitter<'a>>,
    /// Lights that are drawn over the photo.
    pub drawn: Vec<DrawnLight<'a>>,
    /// Weight of each light where windows in view share the residual.
    residual_weights: Vec<f32>,
    /// Weight of each light where all lights share what their shading lacks.
    pub missing_weights: Vec<f32>,
    /// Lights that the photo does not have.
    is_added: Vec<bool>,
    /// Level at which the photo is clipped.
    pub white: f32,
}

/// Planes of working size, each different one once: an edit leaves most shadings as they are.
struct WorkingPlanes {
    bundle: PlaneBundle,
    reflectance: Option<usize>,
    /// Light before saturation; `None` where no pixel is saturated.
    unsaturated: Option<usize>,
    /// Plane of each light before the edit; `None` where it is black.
    before: Vec<Option<usize>>,
    /// Plane of the residual before the edit.
    residual: Option<usize>,
    /// Plane of each light after the edit, then that of the residual.
    after: Vec<Option<usize>>,
    /// Plane of the light of each emitter that the lens scatters.
    glare: Vec<Option<usize>>,
}

/// The values of planes of working size at one pixel of the photo.
pub struct WorkingPixel {
    values: Vec<Vec3>,
    /// Shading by each light before the edit.
    pub before: Vec<Vec3>,
    /// Residual shading before the edit.
    pub residual: Vec3,
    /// Reflectance, filled in under lights.
    pub reflectance: Vec3,
    /// Light before saturation; black where no pixel is saturated.
    pub unsaturated: Vec3,
}

impl WorkingPlanes {
    /// The planes of the lights `names`, of which those that the edit inserts have no shading
    /// before it.
    fn new(
        inputs: &ComposeIn,
        names: &[&str],
        emitters: &mut [VisibleEmitter],
        drawn: &[DrawnLight],
        unseen: f32,
    ) -> WorkingPlanes {
        let filled: Vec<(usize, Plane<Vec3>)> =
            emitters.iter().filter_map(|emitter| emitter.shading_around(inputs)).collect();
        let mut planes: Vec<&Plane<Vec3>> = Vec::new();
        let mut place = |plane| -> Option<usize> {
            let plane: &Plane<Vec3> = plane;
            if plane.pixels().iter().all(|&e| e == Vec3::ZERO) {
                return None;
            }
            let known = planes.iter().position(|known| *known == plane);
            Some(known.unwrap_or_else(|| {
                planes.push(plane);
                planes.len() - 1
            }))
        };
        let reflectance = place(&inputs.reflectance.0);
        let is_saturated = inputs.unsaturated.0 != inputs.small.0;
        let unsaturated = is_saturated.then(|| place(&inputs.unsaturated.0)).flatten();
        let before: Vec<_> = names.iter().map(|id| place(&inputs.before.get(id)?.0)).collect();
        let residual = place(&inputs.residual.0);
        let lights = inputs.after.iter().enumerate().map(|(light, (_, shading))| {
            let filled = filled.iter().find(|(filled, _)| *filled == light);
            filled.map_or(&shading.0, |(_, plane)| plane)
        });
        let after: Vec<_> = lights.chain([&inputs.edited_residual.0]).map(&mut place).collect();
        let glare = emitters.iter().map(|emitter| place(&emitter.scattered?.glare)).collect();
        let mut shadings: Vec<usize> =
            before.iter().chain([&residual]).chain(&after).flatten().copied().collect();
        shadings.sort_unstable();
        shadings.dedup();
        let lights = (&before[..], &after[..]);
        let surfaces: Vec<Option<Surface>> = emitters
            .iter()
            .map(|emitter| match (emitter.kind, emitter.pane) {
                (LightKind::Lamp, _) => LampSurface::new(emitter.mask, &planes).map(Surface::Lamp),
                (LightKind::Window, None) => None,
                (LightKind::Window, Some(rays)) => {
                    let shown = rays.reflect(
                        &planes,
                        (&shadings, &inputs.reflectance.0),
                        (emitter.albedo, unseen),
                        |ray| emitted_towards(ray, inputs, emitters, drawn, lights),
                    );
                    Some(Surface::Pane(PlaneBundle::new(&shown.iter().collect::<Vec<_>>())))
                }
            })
            .collect();
        emitters.iter_mut().zip(surfaces).for_each(|(emitter, surface)| emitter.surface = surface);
        let bundle = PlaneBundle::new(&planes);
        WorkingPlanes { bundle, reflectance, unsaturated, before, residual, after, glare }
    }
}

/// A light that the photo shows.
pub struct VisibleEmitter<'a> {
    /// Index among the lights.
    light: usize,
    /// Its kind: a window may have the shape of a panel.
    kind: LightKind,
    /// The rays that its pane reflects; `None` for none.
    pane: Option<&'a PaneRays>,
    /// Its surface; `None` where the working planes show it.
    surface: Option<Surface>,
    /// Its pixels in the photo.
    pub mask: &'a GlareMask,
    /// Albedo of its surface when it is off.
    albedo: f32,
    /// Color of luminance 1 in which it appears.
    hue: Vec3,
    /// The light of a lamp before saturation; `None` for a window.
    lamp: Option<LampLight>,
    shape: &'a Shape,
    radiance: &'a Radiance,
    change: &'a EmitterChange,
    /// Light that the lens scatters; `None` where there is none.
    scattered: Option<&'a ScatteredLight>,
    /// Gain of that light.
    glare_gain: Vec3,
}

/// The surface of a light that the photo shows, which reflects other light.
enum Surface {
    /// A shade or a globe.
    Lamp(LampSurface),
    /// The working planes as the pane of a window shows them.
    Pane(PlaneBundle),
}

/// A light whose body covers pixels of the photo.
pub struct DrawnLight<'a> {
    /// Index among the lights.
    pub light: usize,
    /// Coverage of each photo pixel.
    pub coverage: &'a Mask,
    /// Its radiance.
    pub emission: Emission<'a>,
    /// Its light that the lens scatters, working size; `None` where the photo shows no glare.
    glare: Option<Plane<Vec3>>,
}

/// The radiance that a drawn light shows.
pub enum Emission<'a> {
    /// By direction.
    Window(&'a Window, &'a Radiance),
    /// In all directions.
    Even(Vec3),
}

impl<'a> LightLayers<'a> {
    /// The bundle of all inputs about lights of a photo that is clipped at `white`. `lamp_albedo`
    /// and `pane_albedo`, 0..=1, belong to lights that are off; the unseen part of the room has
    /// `unseen` times the mean radiance of the seen part.
    ///
    /// # Errors
    /// An input that a light needs is not there.
    pub fn new(
        inputs: &'a ComposeIn,
        white: f32,
        [lamp_albedo, pane_albedo]: [f32; 2],
        unseen: f32,
    ) -> Result<LightLayers<'a>, NodeError> {
        let names: Vec<&str> = inputs.after.iter().map(|(id, _)| id).collect();
        let mut emitters = emitters(inputs, &names, white, |kind| match kind {
            LightKind::Lamp => lamp_albedo,
            LightKind::Window => pane_albedo,
        })?;
        let mut drawn = drawn(inputs, &names)?;
        scatter(&mut drawn, &emitters, inputs);
        let planes = WorkingPlanes::new(inputs, &names, &mut emitters, &drawn, unseen);
        let weight = |id: &&str| inputs.kind.get(id).map_or(RELIT_PIXEL.unseen_rival, |_| 1.0);
        let residual_weights = names.iter().map(weight).collect();
        let missing_weight = |id: &&str| match inputs.kind.get(id).map(|kind| **kind) {
            Some(LightKind::Window) => RELIT_PIXEL.missing_window,
            Some(LightKind::Lamp) | None => 1.0,
        };
        let missing_weights = names.iter().map(missing_weight).collect();
        let is_added = names.iter().map(|id| inputs.before.get(id).is_none()).collect();
        Ok(LightLayers {
            names,
            planes,
            emitters,
            drawn,
            residual_weights,
            missing_weights,
            is_added,
            white,
        })
    }

    /// Memory for the pixels that [`LightLayers::shade`] visits.
    pub fn working_pixel(&self) -> WorkingPixel {
        WorkingPixel {
            values: vec![Vec3::ZERO; self.planes.bundle.values()],
            before: vec![Vec3::ZERO; self.names.len()],
            residual: Vec3::ZERO,
            reflectance: Vec3::ZERO,
            unsaturated: Vec3::ZERO,
        }
    }

    /// Takes the values of one pixel of the photo, and fills its record with the shadings after the
    /// edit.
    pub fn shade(&self, taps: &Taps, pixel: &mut WorkingPixel, record: &mut [Vec3]) {
        taps.all(&self.planes.bundle, &mut pixel.values);
        self.arrange(pixel, record);
    }

    /// The same for the surface of an emitter, which pixel `at` of the photo shows, with its
    /// `taps`; false, and nothing is done, where the working planes show it.
    pub fn shade_own(
        &self,
        emitter: &VisibleEmitter,
        (at, taps): ((usize, usize), &Taps),
        pixel: &mut WorkingPixel,
        record: &mut [Vec3],
    ) -> bool {
        let form = match &emitter.surface {
            None => return false,
            Some(Surface::Pane(planes)) => {
                taps.all(planes, &mut pixel.values);
                1.0
            }
            Some(Surface::Lamp(surface)) => {
                surface.values(at, &mut pixel.values);
                surface.form(at)
            }
        };
        self.arrange(pixel, record);
        record.iter_mut().for_each(|layer| *layer *= form);
        pixel.before.iter_mut().for_each(|e| *e *= form);
        pixel.residual *= form;
        true
    }

    fn arrange(&self, pixel: &mut WorkingPixel, record: &mut [Vec3]) {
        let WorkingPlanes { reflectance, unsaturated, before, residual, after, .. } = &self.planes;
        let value = |plane: Option<usize>| plane.map_or(Vec3::ZERO, |plane| pixel.values[plane]);
        record.iter_mut().zip(after).for_each(|(layer, &plane)| *layer = value(plane));
        pixel.before.iter_mut().zip(before).for_each(|(e, &plane)| *e = value(plane));
        (pixel.residual, pixel.reflectance) = (value(*residual), value(*reflectance));
        pixel.unsaturated = value(*unsaturated);
        self.share_residual(pixel, record);
    }

    /// Gives windows in view their share of the residual, by the strength of their light among that
    /// of all lights; it changes as the light of its window. The residual is mostly light of the
    /// sky, which the shape of a window lacks.
    fn share_residual(&self, pixel: &mut WorkingPixel, record: &mut [Vec3]) {
        if self.window_emitters().next().is_none() {
            return;
        }
        let strength = |e: Vec3| luminance(e).max(0.0);
        let weighted = self.residual_weights.iter().zip(&pixel.before);
        let all: f32 = weighted.map(|(weight, &e)| weight * strength(e)).sum();
        if all <= RELIT_PIXEL.dark {
            return;
        }
        let rest = record.len() - 1;
        let (before, after) = (pixel.residual, record[rest]);
        for VisibleEmitter { light: window, .. } in self.window_emitters() {
            let light = pixel.before[*window];
            let share = strength(light) / all;
            record[*window] += share * after * gain(light, record[*window], Vec3::ONE);
            pixel.before[*window] += share * before;
            record[rest] -= share * after;
            pixel.residual -= share * before;
        }
    }

    /// The emitter with the largest weight at photo pixel `i`; `None` where no emitter has one.
    pub fn emitter(&self, i: usize) -> Option<&VisibleEmitter<'a>> {
        let weights = self.emitters.iter().map(|emitter| (emitter.mask.weight(i), emitter));
        let largest = weights.reduce(|a, b| if b.0 > a.0 { b } else { a });
        largest.filter(|(weight, _)| *weight > 0.0).map(|(_, emitter)| emitter)
    }

    /// Light that the lens scatters onto a pixel before the edit, from all lights.
    pub fn glare(&self, pixel: &WorkingPixel) -> Vec3 {
        self.planes.glare.iter().flatten().map(|&plane| pixel.values[plane]).sum()
    }

    /// The part of that from light `light`.
    pub fn glare_from(&self, light: usize, pixel: &WorkingPixel) -> Vec3 {
        let planes = self.emitters.iter().zip(&self.planes.glare);
        let planes = planes.filter(|(emitter, _)| emitter.light == light);
        planes.filter_map(|(_, &plane)| plane).map(|plane| pixel.values[plane]).sum()
    }

    /// Adds the fraction `share` of the light that the lens scatters after the edit to a record.
    pub fn add_glare(&self, pixel: &WorkingPixel, share: Vec3, record: &mut [Vec3]) {
        for (emitter, &plane) in self.emitters.iter().zip(&self.planes.glare) {
            if let Some(plane) = plane {
                record[emitter.light] += share * pixel.values[plane] * emitter.glare_gain;
            }
        }
    }

    /// The lamp without which a pixel may lack noise: the one that it shows, `own`, or else the one
    /// in view that lights it most. `None` where it shows a window, whose pixels show what is
    /// behind it, or a lamp that is off.
    pub fn lamp_at(&self, own: Option<&VisibleEmitter>, pixel: &WorkingPixel) -> Option<usize> {
        let is_lamp = |emitter: &&VisibleEmitter| {
            emitter.kind == LightKind::Lamp && emitter.change.dark <= 0.0
        };
        if let Some(own) = own {
            return Some(own).filter(is_lamp).map(|own| own.light);
        }
        let strength = |lamp: &&VisibleEmitter| luminance(pixel.before[lamp.light]);
        let lamps = self.emitters.iter().filter(is_lamp);
        lamps.max_by(|a, b| strength(a).total_cmp(&strength(b))).map(|lamp| lamp.light)
    }

    /// Adds the light of drawn lights that the lens scatters to a record.
    pub fn add_drawn_glare(&self, taps: &Taps, record: &mut [Vec3]) {
        for drawn in &self.drawn {
            if let Some(glare) = &drawn.glare {
                record[drawn.light] += taps.of(glare);
            }
        }
    }

    /// Light that the lens scatters after the edit, by the name of its light, working size. A lamp
    /// that moved scatters from its old place and its new one.
    pub fn edited_glare(&self) -> Vec<(&'a str, Plane<Vec3>)> {
        let emitters = self.emitters.iter().filter_map(|emitter| {
            let gain = emitter.glare_gain;
            Some((emitter.light, emitter.scattered?.glare.map(|glare| glare * gain)))
        });
        let drawn = self.drawn.iter().filter_map(|drawn| Some((drawn.light, drawn.glare.clone()?)));
        let mut glare: Vec<(&'a str, Plane<Vec3>)> = Vec::new();
        for (light, plane) in emitters.chain(drawn) {
            let name = self.names[light];
            match glare.iter_mut().find(|(other, _)| *other == name) {
                Some((_, sum)) => {
                    let both = sum.pixels_mut().iter_mut().zip(plane.pixels());
                    both.for_each(|(sum, more)| *sum += *more);
                }
                None => glare.push((name, plane)),
            }
        }
        glare
    }

    /// The edit adds light `k`; the residual is not added.
    pub fn is_added(&self, k: usize) -> bool {
        self.is_added.get(k).is_some_and(|is_added| *is_added)
    }

    fn window_emitters(&self) -> impl Iterator<Item = &VisibleEmitter<'a>> {
        self.emitters.iter().filter(|emitter| emitter.kind == LightKind::Window)
    }

    /// Photo pixel `i` shows a light itself.
    pub fn is_own(&self, i: usize) -> bool {
        self.emitters.iter().any(|emitter| emitter.mask.is_own(i))
    }

    /// Photo pixel `i` is neither a light's own nor in its glare.
    pub fn is_surface(&self, i: usize) -> bool {
        self.emitters.iter().all(|emitter| emitter.mask.weight(i) <= 0.0)
    }

    /// Fraction of photo pixel `i` that no drawn light covers.
    pub fn uncovered(&self, i: usize) -> f32 {
        self.drawn.iter().map(|drawn| 1.0 - drawn.coverage.0.pixels()[i]).product()
    }
}

impl VisibleEmitter<'_> {
    /// The index and the shading after the edit of a lamp that is dark in the photo and switched
    /// on, with its pixels and those around filled from their surroundings: the estimated body may
    /// reach over the lamp's outline, what is within or behind it has no light, and a wall that it
    /// almost touches has far too much. `None` for other lights.
    fn shading_around(&self, inputs: &ComposeIn) -> Option<(usize, Plane<Vec3>)> {
        if self.change.dark <= 0.0 {
            return None;
        }
        let shading = &inputs.after.0[self.light].1.0;
        let (w, h) = shading.size();
        let camera = inputs.camera.resized(w, h);
        let body = Silhouette::new(self.shape);
        let near = Plane::from_fn(w, h, |x, y| {
            let ray = camera.unproject(x as f32 + 0.5, y as f32 + 0.5, 1.0);
            let weight = self.mask.weight(self.mask.pixel_at((x, y), (w, h)));
            let is_near = weight > 0.0 || body.intersect(Vec3::ZERO, ray).is_some();
            f32::from(u8::from(is_near))
        });
        let near = dilate([&Mask(near)].into_iter(), (w, h), TUNING.body_margin);
        let mut filled = shading.clone();
        inpaint(&mut filled, near.map(BVec3::splat), |_, _| (Vec3::ZERO, 1.0));
        let both = filled.pixels().iter().zip(shading.pixels());
        let after = both.map(|(filled, shading)| shading.lerp(*filled, self.change.dark));
        Some((self.light, Plane::new(w, h, after.collect())))
    }

    /// The difference of photo pixel `i` to the white around it, where it is noise.
    pub fn lacking(&self, i: usize) -> Vec3 {
        self.lamp.as_ref().map_or(Vec3::ZERO, |lamp| lamp.lacking(i))
    }

    /// The light at photo pixel `i`, one of its own, along `ray`.
    pub fn own(&self, i: usize, ray: Vec3, saturated: &SaturatedRegions) -> OwnPixel {
        let (radiance, gain) = self.emission_towards(ray);
        // A cloth or a view has its own color, and not that of the light in the room.
        let radiance = luminance(radiance) * self.hue;
        let width = self.mask.size().0;
        let glow = match &self.surface {
            Some(Surface::Lamp(surface)) => surface.glow((i % width, i / width)),
            Some(Surface::Pane(_)) | None => 1.0,
        };
        let (cloth, headroom) = match &self.lamp {
            Some(lamp) => (Vec3::from(RELIT_PIXEL.cloth), lamp.headroom(i)),
            None => (Vec3::ONE, saturated.headroom_of_window(i)),
        };
        OwnPixel {
            light: self.light,
            albedo: self.albedo * cloth,
            radiance,
            headroom,
            gain,
            added: self.change.added * glow,
        }
    }

    /// The light at photo pixel `i` of its glare.
    pub fn glare(&self, i: usize, ray: Vec3) -> GlarePixel {
        GlarePixel {
            light: self.light,
            weight: (1.0 - self.change.dark) * self.mask.glare(i),
            owns_residual: matches!(self.shape, Shape::Window(_)),
            gain: self.emission_towards(ray).1,
        }
    }

    /// The radiance that the light shows along `ray` as estimated, and its gain.
    fn emission_towards(&self, ray: Vec3) -> (Vec3, Vec3) {
        let (w, gains) = (&self.radiance.0, &self.change.gain);
        // A replaced light may have another number of lobes; it is removed from these pixels.
        let after: Vec<Vec3> = w
            .iter()
            .enumerate()
            .map(|(i, &w)| w * gains.get(i).copied().unwrap_or(Vec3::ZERO))
            .collect();
        let (old, new): (Vec3, Vec3) = match self.shape {
            Shape::Absent => return (Vec3::ZERO, Vec3::ONE),
            Shape::Lamp(_) => (w.iter().sum(), after.iter().sum()),
            Shape::Window(window) => (window.emitted(w, ray), window.emitted(&after, ray)),
        };
        (old, gain(old, new, gains.first().copied().unwrap_or(Vec3::ZERO)))
    }
}

impl Emission<'_> {
    /// The radiance towards the camera along the ray that `ray` gives.
    pub fn towards(&self, ray: impl Fn() -> Vec3) -> Vec3 {
        match self {
            Emission::Window(window, radiance) => window.emitted(&radiance.0, ray()),
            Emission::Even(shown) => *shown,
        }
    }
}

/// The light of lamps along a ray that a pane reflects, each with the working plane that it is in:
/// of those in view as the photo shows it, before the edit and after it, and of drawn ones.
/// `before` and `after` are the planes of each light.
fn emitted_towards(
    ray: &PaneRay,
    inputs: &ComposeIn,
    emitters: &[VisibleEmitter],
    drawn: &[DrawnLight],
    (before, after): (&[Option<usize>], &[Option<usize>]),
) -> Vec<(usize, Vec3)> {
    let size = inputs.small.0.size();
    let mut found = Vec::new();
    if let Some((hit, _)) = ray.hit {
        let hit = hit as usize;
        let at = (hit % size.0, hit / size.0);
        let lamps = emitters.iter().filter(|emitter| emitter.kind == LightKind::Lamp);
        for lamp in lamps.filter(|lamp| lamp.mask.is_own(lamp.mask.pixel_at(at, size))) {
            let (shown, gain) = (inputs.small.0.pixels()[hit], lamp.glare_gain);
            let planes = [(before[lamp.light], Vec3::ONE), (after[lamp.light], gain)];
            // One plane is for both where the edit leaves the light as it is.
            let one = planes[0].0 == planes[1].0;
            let planes = planes.into_iter().skip(usize::from(one));
            found.extend(planes.filter_map(|(plane, gain)| Some((plane?, gain * shown))));
        }
    }
    for light in drawn {
        let Some(shape) = inputs.shape.get(&inputs.after.0[light.light].0) else { continue };
        let away = Silhouette::new(shape).intersect(ray.origin, ray.direction);
        let is_seen =
            away.is_some_and(|away| away > 0.0 && ray.hit.is_none_or(|(_, hit)| away < hit));
        if let Some(plane) = after[light.light].filter(|_| is_seen) {
            found.push((plane, light.emission.towards(|| ray.direction)));
        }
    }
    found
}

/// The ray through the center of a light.
fn center_ray(shape: &Shape) -> Vec3 {
    let center = shape.bounding_sphere().map_or(Vec3::NEG_Z, |(center, _)| center);
    center.normalize_or(Vec3::NEG_Z)
}

fn emitters<'a>(
    inputs: &'a ComposeIn,
    names: &[&str],
    white: f32,
    albedo: impl Fn(LightKind) -> f32,
) -> Result<Vec<VisibleEmitter<'a>>, NodeError> {
    let emitter = |(id, mask): (&str, &'a Arc<GlareMask>)| {
        let missing = |what: &str| NodeError::Failed(format!("visible light {id:?} has no {what}"));
        let light = names.iter().position(|name| *name == id).ok_or_else(|| missing("layer"))?;
        let kind = **inputs.kind.get(id).ok_or_else(|| missing("kind"))?;
        let pane = inputs.panes.get(id).map(|pane| &**pane).filter(|pane| !pane.is_empty());
        if let Some(pane) = pane {
            same_size("panes", pane.size, "small", inputs.small.0.size())?;
        }
        let mut emitter = VisibleEmitter {
            light,
            kind,
            pane,
            surface: None,
            mask,
            hue: mask.hue(&inputs.photo),
            lamp: None,
            albedo: albedo(kind),
            shape: inputs.estimated.get(id).ok_or_else(|| missing("estimate"))?,
            radiance: inputs
                .estimated_radiance
                .get(id)
                .ok_or_else(|| missing("estimated radiance"))?,
            scattered: inputs
                .glare
                .get(id)
                .map(|light| &**light)
                .filter(|light| light.amplitude > 0.0),
            change: inputs.gain.get(id).ok_or_else(|| missing("gain"))?,
            glare_gain: Vec3::ONE,
        };
        let (shown, gain) = emitter.emission_towards(center_ray(emitter.shape));
        emitter.glare_gain = gain;
        if kind == LightKind::Lamp {
            // White has no hue: there the lamp takes half of that of its light in the room.
            let photo = inputs.photo.0.pixels();
            let white_share =
                mask.share(|i| photo[i].min_element() >= RELIT_PIXEL.shoulder[1] * white);
            emitter.lamp = Some(LampLight::new(mask, &inputs.photo, white, white_share));
            // Lamps are not bluer than the photo's white.
            let level = luminance(shown);
            if level > 0.0 && shown.x >= shown.z {
                emitter.hue = emitter.hue.lerp(shown / level, 0.5 * white_share);
            }
        }
        Ok(emitter)
    };
    inputs.glare_mask.iter().map(emitter).collect()
}

/// Gives the drawn lights their glare: by the kernel of the photo's own, and the fraction of its
/// light that the lens scatters.
fn scatter(drawn: &mut [DrawnLight], emitters: &[VisibleEmitter], inputs: &ComposeIn) {
    let of_photo = || emitters.iter().filter_map(|emitter| Some((emitter, emitter.scattered?)));
    let Some((_, ScatteredLight { kernel, .. })) = of_photo().next() else { return };
    let scattered: f32 = of_photo().map(|(_, light)| light.amplitude).sum();
    let at_center =
        |emitter: &VisibleEmitter| emitter.emission_towards(center_ray(emitter.shape)).0;
    let emitted: f32 = of_photo().map(|(emitter, _)| luminance(at_center(emitter))).sum();
    let share = (scattered / emitted.max(scattered)).min(TUNING.max_scattered);
    let (w, h) = inputs.small.0.size();
    for light in drawn {
        let coverage = kernel.spread(&resize(&light.coverage.0, w, h));
        let shape = inputs.shape.get(&inputs.after.0[light.light].0);
        let ray = || shape.map_or(Vec3::NEG_Z, |shape| center_ray(shape));
        let emission = share * light.emission.towards(ray);
        light.glare = Some(coverage.map(|covered| covered * emission));
    }
}

fn drawn<'a>(inputs: &'a ComposeIn, names: &[&str]) -> Result<Vec<DrawnLight<'a>>, NodeError> {
    let mut drawn = Vec::new();
    for (light, id) in names.iter().enumerate() {
        let (Some(coverage), Some(shape), Some(radiance)) =
            (inputs.coverage.get(id), inputs.shape.get(id), inputs.radiance.get(id))
        else {
            return Err(NodeError::Failed(format!(
                "light {id:?} has no coverage, shape or radiance"
            )));
        };
        if coverage.0.is_zero() {
            continue;
        }
        let emission = match &**shape {
            Shape::Window(window) => Emission::Window(window, radiance),
            lamp => {
                let towards = lamp
                    .bounding_sphere()
                    .map_or(Vec3::NEG_Z, |(center, _)| center.normalize_or_zero());
                Emission::Even(lamp.emission(0, towards) * radiance.0.iter().sum::<Vec3>())
            }
        };
        drawn.push(DrawnLight { light, coverage, emission, glare: None });
    }
    Ok(drawn)
}

tuning! {
    /// Constants of the glare of drawn lights.
    pub const TUNING: DrawnGlareTuning {
        /// Largest fraction of the light of a drawn light that the lens scatters.
        max_scattered: f32 = 0.05,
            unit "1", source Derived("veiling glare of camera lenses"),
            effect "a larger value draws wider halos where the radiance of lights in view is too low";
        /// Distance from the pixels of a lamp that is switched on, up to which its light is filled
        /// in from farther away.
        body_margin: usize = 4,
            unit "working pixels", source Measured("lamps of real photos switched on; by eye"),
            effect "a larger value flattens the light beside such lamps";
    }
}
