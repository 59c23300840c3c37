//! `Compose`: from shading to a picture, and to one picture per light.
//!
//! Away from lights, a pixel I of the photo under the shading E = sum E_k + R, with the residual R
//! that no light explains, becomes `sum B E'_k + B R' + U` after an edit. In the mode `Ratio`, the
//! reflectance B is I / E, at most 4, and U = I - B E is unexplained light (a highlight, an unseen
//! sun), which stays and is part of the residual layer. Where B exceeds 1, the shading is too low:
//! the light above it is shared among the lights, of which the strongest has most; windows in view
//! have more weight than others, as it is mostly that of a sun that was not found. So the identity
//! edit gives the photo back outside saturated regions, texture and resolution survive, and each
//! term is linear in its light's radiance. In the mode `Physical`, B is the estimated albedo and
//! U = 0.
//!
//! Some pixels belong to one light: those that show it and those of its glare, where I / E does not
//! determine the surface. There the photo is the surface under all other lights, and a remainder
//! that goes with the light: I = B (E - E_k) + G with B = min(A, I / (E - E_k)). In the light's own
//! pixels A is the albedo of a shade or a pane, elsewhere I / E of the surface around. Both ways
//! are blended where glare begins, so that no boundary shows. A pane reflects the room, too: that
//! light is part of B (E - E_k), so that it appears when the window is off.
//!
//! The residual is light that no estimate holds, in rooms with windows mostly light of the sky. So
//! windows in view own the part of it that their light has among that of all lights, with lights
//! out of view at 0.3: it changes as the light of its window.
//!
//! The light of each visible light that the lens scatters is additive: it is subtracted from I
//! first, and goes with the gain of its light.
//!
//! In saturated regions I is a lower bound: its hidden channels are raised to the light before
//! saturation, or to the light's radiance in its own pixels, and B has no limit.
//!
//! A surface that a lamp in view lights is bright, and has less noise than without the lamp. It
//! gets the difference, see `Pixels::add_grain`.
//!
//! Inserted objects and the bodies of inserted lights are drawn over this, and have the photo's
//! noise. An edit of light multiplies a photo pixel with its noise, so the noise of a drawn pixel
//! is a factor, too: that of a photo of the object under the light before the edit. All layers
//! share it and no radiance changes it, so that layers stay linear in their radiances.
//!
//! `src/image/ops/relit_pixel.rs` has these equations for one pixel. `LightLayers` and
//! `ObjectLayers` are the inputs as one pixel needs them, `Pixels` visits all pixels.

mod lamp_surface;
mod light_layers;
mod object_layers;
mod pixels;

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::geometry::{Camera, Objects};
use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{
    Albedo, Depth, GlareMask, Grain, Layer, LightMask, Mask, PaintLayers, Picture, Plane,
    SaturatedRegions, Shading, clip_level,
};
use crate::nodes::artifacts::{EmitterChange, ScatteredLight, ShadingGain, UnitIndirect};
use crate::optics::{LightKind, PaneRays, Radiance, Reflections, Shape, SpecularChange};
use crate::{params, ports};

pub use lamp_surface::LampSurfaceTuning;
pub use light_layers::DrawnGlareTuning;
use light_layers::LightLayers;
use object_layers::ObjectLayers;
use pixels::Pixels;

/// Model of the reflectance of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// Photo over shading: keeps all texture.
    Ratio,
    /// The estimated albedo.
    Physical,
}

params! {
    /// Puts the edited shading onto the photo, at the photo's own size.
    ///
    /// Shading is brought to the photo's size by joint bilateral upsampling against depth and
    /// color; the photo's pixels are never resampled.
    pub struct Compose {
        /// `Ratio`, which multiplies the photo by new over old shading, or `Physical`, which
        /// multiplies the albedo by the new shading.
        mode: Mode = Mode::Ratio,
        /// Albedo of the surface of a lamp that is switched off, of white cloth: reflected and
        /// transmitted light.
        lamp_albedo: f32 = 0.7, in 0.0..=1.0,
        /// Diffuse albedo of the pane of a window that is switched off; it reflects the room, too.
        pane_albedo: f32 = 0.05, in 0.0..=1.0,
        /// Radiance of the unseen part of the room in reflections, as a multiple of the mean of the
        /// seen part, 0..=1. The light on the room's cuboid, or the lighting of a network, takes
        /// its place where there is one; the residual has it there, too.
        unseen: f32 = 0.5, in 0.0..=1.0,
        /// Noise of inserted objects, of the bodies of inserted lights, and of surfaces whose lamp
        /// in view is off, as a multiple of the photo's noise; 0 for none. A photo without noise
        /// gives none.
        grain: f32 = 1.0, in 0.0..=10.0,
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
        reflectance: Arc<Albedo>,
        /// The light of saturated pixels before saturation, working size.
        unsaturated: Arc<Picture>,
        /// Paint that the edit applies, photo size.
        paint_layers: Arc<PaintLayers>,
        /// Shading by each light as estimated, working size.
        before: Gather<Shading>,
        /// Shading by each light after the edit, working size.
        after: Gather<Shading>,
        /// Factor of the shading by each visible light, before the edit and after it where the
        /// shape of the light stays; empty where it is 1.
        shading_gain: Gather<ShadingGain>,
        /// Residual shading, which no light explains, working size.
        residual: Arc<Shading>,
        /// Residual shading after the edit.
        edited_residual: Arc<Shading>,
        /// The own pixels of each visible light and its glare, photo size.
        glare_mask: Gather<GlareMask>,
        /// Light of each visible light that the lens scatters over the photo, working size.
        glare: Gather<ScatteredLight>,
        /// The kind of each visible light.
        kind: Gather<LightKind>,
        /// The estimated lights.
        estimated: Gather<Shape>,
        /// Their radiances.
        estimated_radiance: Gather<Radiance>,
        /// The lights after the edit.
        shape: Gather<Shape>,
        /// Their radiances.
        radiance: Gather<Radiance>,
        /// The change of each light for the photo pixels that show the light itself.
        gain: Gather<EmitterChange>,
        /// Coverage by the bodies of inserted lights, photo size.
        coverage: Gather<Mask>,
        /// The visible inserted objects.
        objects: Arc<Objects>,
        /// Their diffuse reflection of each light.
        object: Gather<Picture>,
        /// Their diffuse reflection of the residual.
        object_residual: Arc<Picture>,
        /// Indirect light of the lights after the edit, with the cells of the room's hidden sides,
        /// which reflections show.
        indirect: Gather<UnitIndirect>,
        /// The rays that the pane of each window in view reflects; a pane without them reflects
        /// nothing.
        panes: Gather<PaneRays>,
        /// The specular reflection of shiny objects; empty without them.
        reflected: Option<Arc<Reflections>>,
        /// The change of specular reflection of surfaces with an edited roughness or specular
        /// level; empty without them.
        specular_change: Option<Arc<SpecularChange>>,
    }
}

ports! {
    pub output ComposeOut {
        /// The linear picture at the photo's size, not clamped: the sum of all layers.
        picture: Arc<Picture>,
        /// The contribution of each light.
        layer: Scatter<Layer>,
        /// The residual, which no light explains.
        residual: Arc<Layer>,
        /// The part of the contribution of each visible light that the lens scatters, working size.
        /// Pixels of lights have none, and a pixel has no more than the photo shows.
        glare: Scatter<Picture>,
        /// The pixels of each light that is in view, in the photo or drawn over it.
        mask: Scatter<LightMask>,
    }
}

impl Node for Compose {
    const KIND: &'static str = "Compose";
    const VERSION: u32 = 38;
    // The files that are made of it are what another run needs.
    const STORED_UP_TO: u64 = 0;
    type In = ComposeIn;
    type Out = ComposeOut;

    fn run(&self, mut inputs: ComposeIn, ctx: &Context) -> Result<ComposeOut, NodeError> {
        let size = inputs.photo.0.size();
        let stays = |id: &str| inputs.shape.get(id) == inputs.estimated.get(id);
        let scaled = [
            ShadingGain::scaled(&inputs.before, &inputs.shading_gain, |_| true)?,
            ShadingGain::scaled(&inputs.after, &inputs.shading_gain, stays)?,
        ];
        [inputs.before, inputs.after] = scaled;
        // It has the photo's size, and is let go of before the layers need memory.
        let none = Arc::new(Mask(Plane::new(0, 0, Vec::new())));
        let clipped = std::mem::replace(&mut inputs.clipped, none);
        let white = clip_level(&inputs.photo, &clipped);
        let albedo = [self.lamp_albedo, self.pane_albedo];
        let (lights, saturated) = rayon::join(
            || LightLayers::new(&inputs, white, albedo, self.unseen),
            || SaturatedRegions::new(&inputs.photo, &clipped, white, &windows(&inputs)),
        );
        drop(clipped);
        let lights = lights?;
        let objects = ObjectLayers::new(&inputs, &lights, self.unseen)?;
        let noise = Grain::measure(&inputs.photo);
        let grain = noise.clone().filter(|_| self.grain > 0.0);
        let grain = grain.map(|noise| noise.scaled(self.grain));
        let noises = [noise.as_ref(), grain.as_ref()];
        let pixels = Pixels::new(self.mode, &inputs, &lights, saturated, noises);
        ctx.check_cancelled()?;
        if inputs.specular_change.is_none() && objects.is_empty() {
            // No pixel depends on another: halves at once, so that no layer is ever in memory as
            // floats.
            if let Some((picture, layers)) = pixels.half_layers(ctx)? {
                return Ok(output((&inputs, &lights), size, picture, layers));
            }
        }
        let mut planes = pixels.planes(ctx)?;
        if let Some(change) = &inputs.specular_change {
            ctx.check_cancelled()?;
            objects.change_specular(change, &mut planes)?;
        }
        if !objects.is_empty() {
            objects.cover(grain.as_ref(), &mut planes)?;
        }
        let sum = |i: usize| planes.iter().map(|plane| plane[i]).sum::<Vec3>();
        let picture =
            (0..size.0 * size.1).into_par_iter().with_min_len(size.0.max(1)).map(sum).collect();
        let layers =
            planes.into_iter().map(|plane| Layer::new(Plane::new(size.0, size.1, plane))).collect();
        Ok(output((&inputs, &lights), size, picture, layers))
    }
}

/// The pixels of the windows that the photo shows.
fn windows(inputs: &ComposeIn) -> Vec<&GlareMask> {
    let is_window = |id: &str| inputs.kind.get(id).is_some_and(|kind| **kind == LightKind::Window);
    inputs.glare_mask.iter().filter(|(id, _)| is_window(id)).map(|(_, mask)| &**mask).collect()
}

/// The picture and its layers, of each light in its order and then of the residual.
fn output(
    (inputs, lights): (&ComposeIn, &LightLayers),
    (width, height): (usize, usize),
    picture: Vec<Vec3>,
    mut layers: Vec<Layer>,
) -> ComposeOut {
    let residual = layers.pop().expect("the residual follows the lights");
    let glare = lights.edited_glare();
    let masks = lights.names.par_iter().filter_map(|id| {
        let (own, drawn) = (inputs.glare_mask.get(id), inputs.coverage.get(id));
        let mask = LightMask::new(own.map(|own| &**own), drawn.map(|drawn| &**drawn))?;
        Some((id.to_string(), Arc::new(mask)))
    });
    let masks = masks.collect();
    let names = lights.names.iter().map(|id| id.to_string());
    ComposeOut {
        picture: Arc::new(Picture(Plane::new(width, height, picture))),
        layer: Scatter(names.zip(layers.into_iter().map(Arc::new)).collect()),
        residual: Arc::new(residual),
        glare: Scatter(
            glare
                .into_iter()
                .map(|(id, glare)| (id.to_owned(), Arc::new(Picture(glare))))
                .collect(),
        ),
        mask: Scatter(masks),
    }
}

#[cfg(test)]
mod tests {
    use glam::Quat;

    use super::*;
    use crate::geometry::{RoomLayout, SideSource};
    use crate::image::{Points, REFLECTANCE, RELIT_PIXEL, luminance};
    use crate::optics::inverse::GlareKernel;
    use crate::optics::{RayEnd, SpecularPart, SphereLamp};

    const SIZE: (usize, usize) = (12, 4);
    const WALL: Vec3 = Vec3::new(0.5, 0.4, 0.2);
    const ALBEDO: Vec3 = Vec3::new(0.3, 0.6, 0.1);
    const LAMP: Vec3 = Vec3::new(0.6, 0.5, 0.4);
    const RESIDUAL: Vec3 = Vec3::splat(0.1);

    /// A wall under one lamp, in the photo at x < 3, that the edit multiplies by `factor`.
    fn inputs(factor: f32) -> ComposeIn {
        let plane = |value: Vec3| Plane::filled(SIZE.0, SIZE.1, value);
        let number = |value: f32| Plane::filled(SIZE.0, SIZE.1, value);
        fn lamp<T>(value: T) -> Gather<T> {
            Gather(vec![("lamp".to_owned(), Arc::new(value))])
        }
        let photo = Picture(plane(WALL * (LAMP + RESIDUAL)));
        let mask = Plane::from_fn(SIZE.0, SIZE.1, |x, _| if x < 3 { 1.0 } else { 0.0 });
        let glare_mask = GlareMask::of_window(&mask, &photo, &Mask(number(0.0)), 4.0);
        let (photo, depth) = (Arc::new(photo), Arc::new(Depth(number(2.0))));
        let shape = || {
            lamp(Shape::Lamp(crate::optics::Lamp::Sphere(SphereLamp {
                center: Vec3::NEG_Z,
                radius: 0.1,
            })))
        };
        let radiance = |value: f32| lamp(Radiance(vec![Vec3::splat(value)]));
        ComposeIn {
            photo: photo.clone(),
            clipped: Arc::new(Mask(number(0.0))),
            camera: Arc::new(Camera::from_fov_x(SIZE.0, SIZE.1, 60.0)),
            full_depth: depth.clone(),
            small: photo.clone(),
            depth,
            albedo: Arc::new(Albedo(plane(ALBEDO))),
            reflectance: Arc::new(Albedo(plane(WALL))),
            unsaturated: photo.clone(),
            paint_layers: Arc::default(),
            before: lamp(Shading(plane(LAMP))),
            after: lamp(Shading(plane(factor * LAMP))),
            shading_gain: Gather(vec![]),
            residual: Arc::new(Shading(plane(RESIDUAL))),
            edited_residual: Arc::new(Shading(plane(RESIDUAL))),
            glare_mask: lamp(glare_mask),
            glare: Gather(vec![]),
            kind: lamp(LightKind::Lamp),
            estimated: shape(),
            estimated_radiance: radiance(1.0),
            shape: shape(),
            radiance: radiance(factor),
            gain: lamp(EmitterChange {
                gain: vec![Vec3::splat(factor)],
                added: Vec3::ZERO,
                dark: 0.0,
            }),
            coverage: lamp(Mask(number(0.0))),
            objects: Arc::new(Objects::unseen(&[])),
            object: Gather(vec![]),
            object_residual: Arc::new(Picture(Plane::new(0, 0, vec![]))),
            indirect: Gather(vec![]),
            panes: Gather(vec![]),
            reflected: None,
            specular_change: None,
        }
    }

    #[track_caller]
    fn check(stage: &Compose, factor: f32, want: impl Fn(usize) -> Vec3) {
        let out = stage.run(inputs(factor), &Context::default()).expect("everything is there");
        for i in 0..SIZE.0 * SIZE.1 {
            let (got, want) = (out.picture.0.pixels()[i], want(i % SIZE.0));
            assert!(
                (got - want).abs().max_element() < 1e-5,
                "column {}: {got} against {want}",
                i % SIZE.0
            );
            // Layers are half floats.
            let sum = out.layer.0[0].1.get(i) + out.residual.get(i);
            assert!(
                (sum - got).abs().max_element() < 1e-3,
                "column {}: {sum} of {got}",
                i % SIZE.0
            );
        }
    }

    #[test]
    fn the_identity_gives_the_photo_back_and_off_leaves_the_lamps_surface() {
        let stage = Compose { lamp_albedo: 0.25, ..Compose::default() };
        check(&stage, 1.0, |_| WALL * (LAMP + RESIDUAL));
        // In own pixels, the photo over all other light is above the lamp's albedo.
        check(&stage, 0.0, |x| if x < 3 { 0.25 * form(x) * RESIDUAL } else { WALL * RESIDUAL });
    }

    /// The light on the lamp, three columns wide, round and of cream cloth, over that on a flat
    /// white one.
    fn form(x: usize) -> Vec3 {
        let side = (x as f32 - 1.0) / 1.5;
        let facing = (1.0 - side * side).sqrt();
        let light = 0.5 * (1.0 + facing + (1.0 - facing) * lamp_surface::TUNING.behind);
        light * Vec3::from(RELIT_PIXEL.cloth)
    }

    #[test]
    fn a_window_has_its_share_of_the_residual() {
        let unseen = Vec3::new(0.2, 0.3, 0.4);
        let of = |id: &str, value: Vec3| {
            (id.to_owned(), Arc::new(Shading(Plane::filled(SIZE.0, SIZE.1, value))))
        };
        for factor in [1.0, 0.4, 0.0] {
            let mut inputs = inputs(factor);
            inputs.kind = Gather(vec![("lamp".to_owned(), Arc::new(LightKind::Window))]);
            let photo = Picture(inputs.photo.0.map(|shown| shown + WALL * unseen));
            inputs.photo = Arc::new(photo);
            inputs.before.0.push(of("inv_lamp", unseen));
            inputs.after.0.push(of("inv_lamp", unseen));
            let absent = || ("inv_lamp".to_owned(), Arc::new(Shape::Absent));
            let radiance = || ("inv_lamp".to_owned(), Arc::new(Radiance(vec![Vec3::ONE])));
            inputs.estimated.0.push(absent());
            inputs.estimated_radiance.0.push(radiance());
            inputs.shape.0.push(absent());
            inputs.radiance.0.push(radiance());
            let none = Mask(Plane::filled(SIZE.0, SIZE.1, 0.0));
            inputs.coverage.0.push(("inv_lamp".to_owned(), Arc::new(none)));
            let out = Compose::default().run(inputs, &Context::default()).expect("all is there");
            // Of the window, with the light out of view as a rival.
            let strengths = [luminance(LAMP), RELIT_PIXEL.unseen_rival * luminance(unseen)];
            let share = strengths[0] / (strengths[0] + strengths[1]);
            let window = WALL * (LAMP + share * RESIDUAL);
            let want = WALL * (unseen + (1.0 - share) * RESIDUAL) + factor * window;
            // Beside the window's own pixels, and out of its bloom.
            for i in (0..SIZE.0 * SIZE.1).filter(|i| i % SIZE.0 >= 8) {
                let got = out.picture.0.pixels()[i];
                assert!((got - want).abs().max_element() < 1e-5, "{factor}: {got} for {want}");
                let layer = out.layer.0[0].1.get(i);
                assert!((layer - factor * window).abs().max_element() < 1e-3, "{layer}");
            }
        }
    }

    #[test]
    fn physical_shows_the_estimated_albedo_and_own_pixels_stay() {
        let stage = Compose { mode: Mode::Physical, ..Compose::default() };
        for factor in [1.0, 0.5] {
            let own = |factor: f32, x: usize| {
                let surface = stage.lamp_albedo * form(x) * RESIDUAL;
                surface + factor * (WALL * (LAMP + RESIDUAL) - surface)
            };
            check(&stage, factor, |x| {
                if x < 3 { own(factor, x) } else { ALBEDO * (factor * LAMP + RESIDUAL) }
            });
        }
    }

    #[test]
    fn scattered_light_is_added_to_the_surface_and_goes_with_its_light() {
        let scattered = Vec3::new(0.2, 0.1, 0.05);
        let light = || ScatteredLight {
            glare: Plane::filled(SIZE.0, SIZE.1, scattered),
            amplitude: 1.0,
            kernel: GlareKernel { slope: 0.7 },
        };
        for factor in [1.0, 0.3, 0.0] {
            let mut inputs = inputs(factor);
            let photo = inputs.photo.0.map(|shown| shown + scattered);
            inputs.photo = Arc::new(Picture(photo));
            inputs.glare = Gather(vec![("lamp".to_owned(), Arc::new(light()))]);
            let out = Compose::default().run(inputs, &Context::default()).expect("all is there");
            let want = WALL * (factor * LAMP + RESIDUAL) + factor * scattered;
            // Beside the lamp's own pixels, and out of its bloom.
            for i in (0..SIZE.0 * SIZE.1).filter(|i| i % SIZE.0 >= 8) {
                let got = out.picture.0.pixels()[i];
                assert!((got - want).abs().max_element() < 1e-5, "{factor}: {got} for {want}");
            }
            let (id, shown) = &out.glare.0[0];
            assert_eq!(id, "lamp");
            assert!((shown.0.get(9, 1) - factor * scattered).abs().max_element() < 1e-6);
        }
        // A photo that shows less than its glare has a surface all the same.
        let mut dark = inputs(0.0);
        dark.photo = Arc::new(Picture(dark.photo.0.map(|_| 0.5 * scattered)));
        dark.glare = Gather(vec![("lamp".to_owned(), Arc::new(light()))]);
        let out = Compose::default().run(dark, &Context::default()).expect("all is there");
        let rest = (1.0 - REFLECTANCE.most_glare) * 0.5 * scattered;
        let want = rest * RESIDUAL / (LAMP + RESIDUAL);
        let got = out.picture.0.get(9, 1);
        assert!((got - want).abs().max_element() < 1e-5, "{got} for {want}");
    }

    #[test]
    fn a_drawn_light_has_the_glare_of_the_photo() {
        let mut inputs = inputs(1.0);
        let light = ScatteredLight {
            glare: Plane::filled(SIZE.0, SIZE.1, Vec3::ZERO),
            amplitude: 0.01,
            kernel: GlareKernel { slope: 0.7 },
        };
        inputs.glare = Gather(vec![("lamp".to_owned(), Arc::new(light))]);
        let covered = Plane::from_fn(SIZE.0, SIZE.1, |x, _| if x >= 10 { 1.0 } else { 0.0 });
        inputs.coverage = Gather(vec![("lamp".to_owned(), Arc::new(Mask(covered.clone())))]);
        let plain = Compose::default().run(inputs_without_glare(&covered), &Context::default());
        let plain = plain.expect("all is there");
        let out = Compose::default().run(inputs, &Context::default()).expect("all is there");
        // The lamp in view scatters 0.01 of its radiance of 1.
        let spread = GlareKernel { slope: 0.7 }.spread(&covered);
        for i in 0..SIZE.0 * SIZE.1 {
            let got = out.picture.0.pixels()[i] - plain.picture.0.pixels()[i];
            let want = 0.01 * spread.pixels()[i];
            assert!((got - Vec3::splat(want)).abs().max_element() < 1e-5, "{got} for {want}");
        }
    }

    /// The inputs with a drawn lamp, and no glare.
    fn inputs_without_glare(covered: &Plane<f32>) -> ComposeIn {
        let coverage = Gather(vec![("lamp".to_owned(), Arc::new(Mask(covered.clone())))]);
        ComposeIn { coverage, ..inputs(1.0) }
    }

    /// The inputs with a second light, and a surface that reflects half of the middle of one cell
    /// of a room of six; `cells` are those on which the second light shines.
    fn reflecting(cells: usize) -> ComposeIn {
        let mut inputs = inputs(2.0);
        let (w, h) = SIZE;
        let points = Points(Plane::from_fn(w, h, |x, y| inputs.camera.pixel_point(x, y, 2.0)));
        let layout = RoomLayout::new(
            (Quat::IDENTITY, Vec3::splat(-3.0), Vec3::splat(3.0)),
            [SideSource::Guessed; 6],
            (&inputs.camera, &points),
            Plane::filled(w, h, 0),
            1,
        );
        let lights =
            ["lamp", "spot"].map(|id| (id.to_owned(), vec![Plane::new(1, 1, vec![Vec3::ZERO])]));
        let of = Reflections {
            hits: Plane::new(1, 1, vec![RayEnd::cell(4, [128; 2])]),
            weight: Plane::new(1, 1, vec![Vec3::splat(0.5)]),
            far: Plane::new(1, 1, vec![Vec3::ZERO]),
            cells: layout.grid(),
            lights: lights.to_vec(),
        };
        let share = Plane::filled(w, h, 1.0);
        let part = SpecularPart { old: false, share, rows: Plane::filled(w, h, 0), of };
        inputs.specular_change = Some(Arc::new(SpecularChange(vec![part])));
        let under = |level: f32, count: usize| {
            let cell = |i: usize, _| Vec3::splat(level * (i + 1) as f32);
            let cells = vec![Plane::from_fn(count, 1, cell)];
            Arc::new(UnitIndirect { lobes: vec![], stderr: vec![], probes: vec![], cells })
        };
        let spot = || "spot".to_owned();
        inputs.indirect =
            Gather(vec![("lamp".into(), under(0.1, 6)), (spot(), under(0.01, cells))]);
        inputs.after.0.push((spot(), Arc::new(Shading(Plane::filled(w, h, Vec3::ZERO)))));
        inputs.shape.0.push((spot(), Arc::new(Shape::Absent)));
        inputs.radiance.0.push((spot(), Arc::new(Radiance(vec![Vec3::splat(3.0)]))));
        inputs.coverage.0.push((spot(), Arc::new(Mask(Plane::filled(w, h, 0.0)))));
        inputs
    }

    #[test]
    fn a_mirror_adds_to_each_layer_the_light_of_its_own_on_the_cell() {
        let stage = Compose::default();
        let plain = stage.run(inputs(2.0), &Context::default()).expect("everything is there");
        let out = stage.run(reflecting(6), &Context::default()).expect("everything is there");
        // Half of: radiance 2 x 0.5, radiance 3 x 0.05, and half of the mean residual.
        let mean = WALL * RESIDUAL;
        let wanted = [Vec3::splat(0.5), Vec3::splat(0.075), 0.5 * 0.5 * mean];
        for i in (0..SIZE.0 * SIZE.1).filter(|i| i % SIZE.0 >= 6) {
            let got = [
                out.layer.0[0].1.get(i) - plain.layer.0[0].1.get(i),
                out.layer.0[1].1.get(i),
                out.residual.get(i) - plain.residual.get(i),
            ];
            for (got, wanted) in got.iter().zip(wanted) {
                let off = (*got - wanted).abs().max_element();
                assert!(off < 2e-3, "pixel {i}: {got} for {wanted}");
            }
        }
    }

    #[test]
    fn another_number_of_cells_is_an_error() {
        let fails = |inputs: ComposeIn| {
            let out = Compose::default().run(inputs, &Context::default());
            out.err().expect("the cells do not fit").to_string()
        };
        let message = fails(reflecting(5));
        assert!(
            message.contains("light \"spot\" has 5 cells in `indirect`, wanted 6 as reflections"),
            "{message}"
        );
        let mut without = reflecting(6);
        without.indirect.0.pop();
        let message = fails(without);
        assert!(message.contains("light \"spot\" has no `indirect`"), "{message}");
    }
}
