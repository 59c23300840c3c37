//! `EditLights`: switches, dims, colors and moves lights, and adds new ones.

mod change;
mod lamp;
mod sky;
mod window;

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::sync::Arc;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::{Ground, Place, check_model, level, model_files, read_model, tall, upright};
use crate::geometry::{Camera, world_up};
use crate::graph::{Context, File, Gather, Node, NodeError, Scatter, above, check_range};
use crate::image::{Depth, Normal};
use crate::nodes::artifacts::{EmitterChange, Encoding};
pub use crate::optics::black_body;
use crate::optics::{Radiance, Shape};
use crate::tuning::{Table, tuning};
use crate::{params, ports};

use change::{check_list, emitter_change, lamp_level};
use lamp::LampShape;
use sky::{Environment, Half, Sky, Sun};

params! {
    /// Changes the lights that the edit names and adds new ones; all other lights pass through
    /// unchanged.
    pub struct EditLights {
        /// Edit of each named light: `Off`, `On(flux: 800)`, `Scale(0.4)`, `Temperature(2700)`,
        /// `Color(1, 0.8, 0.6)`, `Move(..)`, `Lamp(..)`, `Window(..)`, or `Changes([..])` for
        /// several changes in order; an edit file writes the list alone.
        lights: BTreeMap<String, LightEdit> = BTreeMap::new(),
        /// Illuminance in lux at which a white surface shows 1.0, for fluxes in lumens, when the
        /// scene does not give it.
        assumed_lux: f32 = 300.0, in above(0.0),
    }
}

/// One entry of an edit's `lights`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum LightEdit {
    /// No light.
    Off,
    /// An estimated lamp that shines, with its estimated form.
    On {
        /// Lumens; needs the scene's exposure. Without them, the flux of the estimate, or for a
        /// lamp that is off in the photo the mean of the estimated lamps that shine.
        #[serde(default)]
        flux: Option<f32>,
        /// Kelvin. Without them, the color of the estimate, or white for a lamp that is off.
        #[serde(default)]
        temperature: Option<f32>,
    },
    /// Radiance times a factor >= 0.
    Scale(f32),
    /// The color of a black body, 1000..=40000 K, at unchanged luminance.
    Temperature(f32),
    /// This linear RGB color, at unchanged luminance.
    Color(f32, f32, f32),
    /// An existing lamp at another position, with its form and its radiance; the surface that it
    /// hid is filled in.
    Move {
        /// Meters, camera space. Either this or `to`.
        #[serde(default)]
        by: Option<[f32; 3]>,
        /// New position of its middle.
        #[serde(default)]
        to: Option<Place>,
    },
    /// Several changes of one existing light, in this order.
    Changes(Vec<LightEdit>),
    /// A lamp of known shape, new or in the place of another light.
    Lamp {
        /// Form and size.
        shape: LampShape,
        /// Position.
        at: Place,
        /// Lumens; needs the scene's exposure. Either this or `radiance`.
        #[serde(default)]
        flux: Option<f32>,
        /// Linear RGB in units of the photo: the value of a pixel of the lamp itself.
        #[serde(default)]
        radiance: Option<[f32; 3]>,
        /// Kelvin; the color of `flux`, 2700 when not given.
        #[serde(default)]
        temperature: Option<f32>,
        /// A photometric file of IES LM-63: the directional emission of a small sphere, and without
        /// `flux` its power.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        ies: Option<File>,
        /// Direction of the profile's angle 0, camera space; down when not given.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        axis: Option<[f32; 3]>,
        /// Degrees that the profile is turned about its axis.
        #[serde(default, skip_serializing_if = "is_zero")]
        turn: f32,
    },
    /// A window on a seen wall.
    Window {
        /// Its four corners in photo pixels, in order around it.
        corners: Vec<[f32; 2]>,
        /// Radiance of the window: everywhere without `ground`, else above the horizon.
        #[serde(default)]
        sky: Sky,
        /// The lower part of the view outside.
        #[serde(default)]
        ground: Option<Half>,
        /// Directional light of the sun, if it shines in.
        #[serde(default)]
        sun: Option<Sun>,
        /// Degrees to the right by which the middle of a picture of the sky lies from the view.
        #[serde(default, skip_serializing_if = "is_zero")]
        yaw: f32,
        /// Factor of the radiance of a picture or of a clear sky.
        #[serde(default = "one", skip_serializing_if = "is_one")]
        scale: f32,
    },
}

fn is_zero(value: &f32) -> bool {
    *value == 0.0
}

fn one() -> f32 {
    1.0
}

fn is_one(value: &f32) -> bool {
    *value == 1.0
}

ports! {
    pub input EditLightsIn {
        /// The estimated lights.
        shapes: Gather<Shape>,
        /// The radiances of the estimated lights.
        radiances: Gather<Radiance>,
        /// The camera of the photo.
        camera: Arc<Camera>,
        /// Planar depth at the photo's size, for positions that are given as pixels.
        depth: Arc<Depth>,
        /// Normals, at any size.
        normal: Arc<Normal>,
        /// The scene's exposure.
        encoding: Arc<Encoding>,
    }
}

ports! {
    pub output EditLightsOut {
        /// The position, extent and emission of every light after the edit.
        shape: Scatter<Shape>,
        /// The radiance of every light after the edit.
        radiance: Scatter<Radiance>,
        /// The change of a visible light's own pixels: radiance after over radiance before, per
        /// lobe and channel, and the radiance of a dark lamp that is switched on.
        gain: Scatter<EmitterChange>,
    }
}

impl Node for EditLights {
    const KIND: &'static str = "EditLights";
    const VERSION: u32 = 7;
    type In = EditLightsIn;
    type Out = EditLightsOut;

    fn check_consistency(&self) -> Result<(), String> {
        self.lights
            .iter()
            .try_for_each(|(id, edit)| edit.check().map_err(|e| format!("lights: {id:?}: {e}")))
    }

    fn files(&mut self) -> Vec<&mut File> {
        self.lights.values_mut().flat_map(LightEdit::files).collect()
    }

    fn run(&self, inputs: EditLightsIn, ctx: &Context) -> Result<EditLightsOut, NodeError> {
        let up = world_up(&inputs.normal);
        let mut out = EditLightsOut {
            shape: Scatter(vec![]),
            radiance: Scatter(vec![]),
            gain: Scatter(vec![]),
        };
        let mut push = |id: &str, shape: Arc<Shape>, radiance: &Radiance, change: EmitterChange| {
            let within = |lobe: &&Vec3| lobe.cmple(Vec3::splat(TUNING.max_radiance)).all();
            if let Some(lobe) = radiance.0.iter().find(|lobe| !within(lobe)) {
                let message = format!(
                    "lights: {id:?}: wanted a radiance up to {:e}, got {:e}",
                    TUNING.max_radiance,
                    lobe.max_element()
                );
                return Err(NodeError::BadParameter(message));
            }
            out.shape.0.push((id.into(), shape));
            out.radiance.0.push((id.into(), Arc::new(radiance.clone())));
            out.gain.0.push((id.into(), Arc::new(change)));
            Ok(())
        };
        for (id, shape) in inputs.shapes.iter() {
            let old = inputs
                .radiances
                .get(id)
                .map(|r| r.0.clone())
                .unwrap_or_else(|| vec![Vec3::ZERO; shape.lobes()]);
            let edit = self.lights.get(id);
            let changes = edit.map_or(&[][..], LightEdit::changes);
            let new = self.changed(id, changes, (shape, &old), &inputs, ctx)?;
            if let Some((shape, radiance)) = edit
                .and_then(|e| self.made(id, e, Some((shape, &new)), &inputs, up, ctx))
                .transpose()?
            {
                // The old light is removed, and the new one is drawn in its place.
                push(id, Arc::new(shape), &radiance, replaced(&radiance))?;
                continue;
            }
            let change = emitter_change(changes, &old, &new);
            push(id, shape.clone(), &Radiance(new), change)?;
        }
        for (id, edit) in &self.lights {
            if inputs.shapes.get(id).is_some() {
                continue;
            }
            let Some(made) = self.made(id, edit, None, &inputs, up, ctx) else {
                return Err(NodeError::BadParameter(format!(
                    "lights: {id:?}: the light to change does not exist"
                )));
            };
            let (shape, radiance) = made?;
            push(id, Arc::new(shape), &radiance, replaced(&radiance))?;
        }
        Ok(out)
    }
}

/// The change of the own pixels of a light that is removed for one of this radiance.
fn replaced(radiance: &Radiance) -> EmitterChange {
    EmitterChange { gain: vec![Vec3::ZERO; radiance.0.len()], added: Vec3::ZERO, dark: 0.0 }
}

tuning! {
    /// Constants of `EditLights`.
    pub const TUNING: EditLightsTuning {
        /// Largest radiance of a light.
        max_radiance: f32 = 1e30,
            unit "units of the photo", source Derived("it leaves range in single precision for sums of many"),
            effect "a larger value may overflow";
        /// Color temperature of an inserted lamp whose edit names none.
        kelvin: f32 = 2700.0,
            unit "kelvin", source Derived("an incandescent bulb"), effect "a larger value makes such lamps bluer";
        /// Luminance of an estimated lamp below which it counts as off in the photo.
        off_radiance: f32 = 0.05,
            unit "units of the photo", source Taste,
            effect "a larger value lets On take flux and color of more lamps from elsewhere";
        /// Luminance of an estimated lamp from which On multiplies its photo pixels, and adds
        /// nothing to them; between this and `off_radiance` it does both in part.
        on_radiance: f32 = 0.25,
            unit "units of the photo", source Taste,
            effect "a larger value keeps less of the texture of a dim lamp that is switched on";
        /// Flux of a lamp that is switched on without one where no estimated lamp shines.
        bulb_flux: f32 = 800.0,
            unit "lumens", source Derived("an incandescent bulb of 60 W"),
            effect "a larger value makes such lamps brighter";
    }
}

/// Temperatures of a black body, kelvin.
const KELVIN: RangeInclusive<f32> = 1000.0..=40_000.0;

/// The constants of inserted and edited lights.
pub fn tuning() -> Vec<Table> {
    vec![EditLightsTuning::table(), sky::SkyTuning::table(), window::WallTuning::table()]
}

impl LightEdit {
    /// The files that it names.
    fn files(&mut self) -> Vec<&mut File> {
        match self {
            LightEdit::Lamp { shape: LampShape::Mesh { path, parts, .. }, .. } => {
                model_files(path, parts).collect()
            }
            LightEdit::Lamp { ies, .. } => ies.iter_mut().collect(),
            LightEdit::Window { sky: Sky::Env(file), .. } => vec![file],
            _ => Vec::new(),
        }
    }

    fn check(&self) -> Result<(), String> {
        match self {
            LightEdit::Off => Ok(()),
            LightEdit::On { flux, temperature } => {
                check_range("On: flux (lumens)", flux, 0.0..)?;
                check_range("On: temperature (K)", temperature, KELVIN)
            }
            LightEdit::Changes(list) => check_list(list),
            LightEdit::Scale(s) => check_range("Scale", s, 0.0..),
            LightEdit::Temperature(t) => check_range("temperature (K)", t, KELVIN),
            LightEdit::Color(r, g, b) => {
                check_range("Color", &[*r, *g, *b], 0.0..)?;
                if r + g + b > 0.0 {
                    Ok(())
                } else {
                    Err("Color: wanted a color, got black; use Off".into())
                }
            }
            LightEdit::Move { by, to } => match (by, to) {
                (Some(_), None) | (None, Some(_)) => Ok(()),
                (None, None) => Err("Move: wanted by: (x, y, z) or to: a place".into()),
                (Some(_), Some(_)) => Err("Move: by and to exclude each other".into()),
            },
            LightEdit::Lamp { shape, at: _, flux, radiance, temperature, ies, axis, turn } => {
                shape.check()?;
                check_range("temperature (K)", temperature, KELVIN)?;
                axis.map_or(Ok(()), |axis| lamp::direction("axis", axis).map(drop))?;
                match (ies, shape) {
                    (Some(_), LampShape::Sphere { .. }) => {}
                    (Some(_), _) => {
                        return Err("ies: a profile requires shape: Sphere(..)".into());
                    }
                    (None, _) if axis.is_some() || *turn != 0.0 => {
                        return Err("axis and turn orient a profile: they require ies".into());
                    }
                    (None, _) => {}
                }
                match (flux, radiance) {
                    (Some(flux), None) => check_range("flux (lumens)", flux, 0.0..),
                    (None, Some(radiance)) if temperature.is_none() => {
                        check_range("radiance", radiance, 0.0..)
                    }
                    (None, Some(_)) => {
                        Err("temperature requires flux; radiance has its own color".into())
                    }
                    (None, None) if ies.is_some() => Ok(()),
                    (None, None) => Err("wanted flux (lumens) or radiance (r, g, b)".into()),
                    (Some(_), Some(_)) => Err("flux and radiance exclude each other".into()),
                }
            }
            LightEdit::Window { corners, sky, ground, sun, yaw, scale } => {
                window::convex(corners)?;
                Environment {
                    sky,
                    ground: ground.as_ref(),
                    sun: sun.as_ref(),
                    yaw: *yaw,
                    scale: *scale,
                }
                .check()
            }
        }
    }
}

impl EditLights {
    /// The light that an edit inserts or puts in the place of another one, or `None` when it only
    /// changes one.
    fn made(
        &self,
        id: &str,
        edit: &LightEdit,
        old: Option<(&Shape, &[Vec3])>,
        inputs: &EditLightsIn,
        up: Vec3,
        ctx: &Context,
    ) -> Option<Result<(Shape, Radiance), NodeError>> {
        let failed =
            |message: String| NodeError::BadParameter(format!("lights: {id:?}: {message}"));
        let is_move = |change: &&LightEdit| matches!(change, LightEdit::Move { .. });
        let edit = edit.changes().iter().find(is_move).unwrap_or(edit);
        match (edit, old) {
            (LightEdit::Lamp { .. }, _) => Some(self.lamp(id, edit, inputs, up, ctx)),
            (LightEdit::Move { by, to }, Some((shape, radiance))) => {
                let lamp = lamp::moved(shape, *by, to.as_ref(), inputs, up).map_err(failed);
                Some(lamp.map(|lamp| (Shape::Lamp(lamp), Radiance(radiance.to_vec()))))
            }
            (LightEdit::Window { corners, sky, ground, sun, yaw, scale }, _) => {
                let environment = Environment {
                    sky,
                    ground: ground.as_ref(),
                    sun: sun.as_ref(),
                    yaw: *yaw,
                    scale: *scale,
                };
                let window = window::window(corners, inputs, up).map_err(failed);
                Some(window.and_then(|window| {
                    environment.through(id, window, up, &|| self.lux(id, inputs, ctx), ctx)
                }))
            }
            _ => None,
        }
    }

    /// An inserted lamp.
    fn lamp(
        &self,
        id: &str,
        edit: &LightEdit,
        inputs: &EditLightsIn,
        up: Vec3,
        ctx: &Context,
    ) -> Result<(Shape, Radiance), NodeError> {
        let LightEdit::Lamp { shape, at, flux, radiance, temperature, ies, axis, turn } = edit
        else {
            unreachable!("only lamps are made here")
        };
        let failed =
            |message: String| NodeError::BadParameter(format!("lights: {id:?}: {message}"));
        let lamp = shape.at(at, inputs, up, &failed, ctx)?;
        let (lamp, lumens) = match ies {
            Some(file) => lamp::luminaire(lamp, file, *axis, *turn, up, ctx)?,
            None => (lamp, 0.0),
        };
        let radiance = match radiance {
            Some(rgb) => Vec3::from_array(*rgb),
            None => {
                let lux = self.lux(id, inputs, ctx);
                let level = lamp_level(flux.unwrap_or(lumens), &lamp, lux);
                black_body(temperature.unwrap_or(TUNING.kelvin)) * level
            }
        };
        if !radiance.is_finite() {
            return Err(failed(format!(
                "wanted a larger body for this flux, got a radiance of {radiance}"
            )));
        }
        Ok((Shape::Lamp(lamp), Radiance(vec![radiance])))
    }

    /// The illuminance at which white shows 1.
    fn lux(&self, id: &str, inputs: &EditLightsIn, ctx: &Context) -> f32 {
        inputs.encoding.lux.unwrap_or_else(|| {
            let lux = self.assumed_lux;
            ctx.warn(format!(
                "light {id:?}: the scene has no exposure; white is assumed to show 1.0 at {lux} lux"
            ));
            lux
        })
    }
}

impl EditLightsIn {
    fn ground(&self, up: Vec3) -> Ground<'_> {
        Ground { camera: &self.camera, depth: &self.depth, normal: &self.normal, up }
    }
}
