//! Changes of an existing light: their combinations, and the radiance after them.

use glam::Vec3;

use super::{EditLights, EditLightsIn, LightEdit, TUNING};
use crate::graph::{Context, NodeError};
use crate::image::{luminance, smooth_step};
use crate::nodes::artifacts::EmitterChange;
use crate::optics::{Lamp, Shape, black_body};

/// Checks that the changes of one light, in this order, go together.
///
/// # Errors
/// The first change that contradicts an earlier one, by its number from 1.
pub fn check_list(list: &[LightEdit]) -> Result<(), String> {
    if list.is_empty() {
        return Err("wanted at least one change, got none".into());
    }
    for (at, change) in list.iter().enumerate() {
        let failed = |message: String| format!("item {}: {message}", at + 1);
        change.check().map_err(failed)?;
        let conflict = list[..at].iter().find_map(|earlier| conflict(earlier, change));
        conflict.or_else(|| alone(change)).map_or(Ok(()), |message| Err(failed(message)))?;
    }
    Ok(())
}

/// The reason for which a change cannot be in any list.
fn alone(change: &LightEdit) -> Option<String> {
    let name = change.name();
    match change {
        LightEdit::Lamp { .. } | LightEdit::Window { .. } => Some(format!(
            "{name} makes a light and cannot be changed: give it its final values, without `[..]`"
        )),
        LightEdit::Changes(_) => Some("a list of changes contains no other list".into()),
        _ => None,
    }
}

/// The reason for which `later` cannot follow `earlier` in a list.
fn conflict(earlier: &LightEdit, later: &LightEdit) -> Option<String> {
    use LightEdit::{Color, Off, On, Temperature};
    let names = (earlier.name(), later.name());
    match (earlier, later) {
        _ if names.0 == names.1 => Some(format!("{} is given twice; keep one", names.0)),
        (Off, _) | (_, Off) => Some(format!(
            "{} contradicts {}: a light that is off has no other change",
            names.1, names.0
        )),
        (Temperature(_), Color(..)) | (Color(..), Temperature(_)) => {
            Some(format!("{} contradicts {}: both set the color; keep one", names.1, names.0))
        }
        (On { temperature: Some(_), .. }, Temperature(_) | Color(..)) => {
            Some(format!("{} contradicts the temperature of On: keep one", names.1))
        }
        (LightEdit::Scale(_) | Temperature(_) | Color(..), On { .. }) => {
            Some(format!("On replaces the radiance that {} changed: write On first", names.0))
        }
        _ => None,
    }
}

impl LightEdit {
    /// The changes in their order: those of a list, or the one that this is.
    pub fn changes(&self) -> &[LightEdit] {
        match self {
            LightEdit::Changes(list) => list,
            one => std::slice::from_ref(one),
        }
    }

    fn name(&self) -> &'static str {
        match self {
            LightEdit::Off => "Off",
            LightEdit::On { .. } => "On",
            LightEdit::Scale(_) => "Scale",
            LightEdit::Temperature(_) => "Temperature",
            LightEdit::Color(..) => "Color",
            LightEdit::Move { .. } => "Move",
            LightEdit::Changes(_) => "Changes",
            LightEdit::Lamp { .. } => "Lamp",
            LightEdit::Window { .. } => "Window",
        }
    }

    /// The radiance of an existing light after this change; `On`, which needs the light's form, is
    /// left out.
    fn applied(&self, radiance: Vec3) -> Vec3 {
        match *self {
            LightEdit::Off => Vec3::ZERO,
            LightEdit::Scale(factor) => radiance * factor,
            LightEdit::Temperature(kelvin) => black_body(kelvin) * luminance(radiance),
            LightEdit::Color(r, g, b) => {
                let color = Vec3::new(r, g, b);
                color / luminance(color) * luminance(radiance)
            }
            _ => radiance,
        }
    }
}

/// The change of a light's own pixels from the radiance `old` to `new`, per lobe, by `changes`.
pub fn emitter_change(changes: &[LightEdit], old: &[Vec3], new: &[Vec3]) -> EmitterChange {
    let is_on = changes.iter().any(|change| matches!(change, LightEdit::On { .. }));
    let dark = if is_on { darkness(old) } else { 0.0 };
    let gray = || changes.iter().fold(Vec3::ONE, |w, change| change.applied(w));
    let gain = old.iter().zip(new).map(|(&old, &new)| {
        // A light of zero fitted radiance still shows in its own pixels: there its color is
        // taken as gray.
        let (old, new) = if old.max_element() > 0.0 { (old, new) } else { (Vec3::ONE, gray()) };
        let gain = Vec3::from_array([0, 1, 2].map(|c| {
            if new[c] == old[c] {
                1.0
            } else if old[c] > 0.0 {
                new[c] / old[c]
            } else {
                0.0
            }
        }));
        gain.lerp(Vec3::ONE, dark)
    });
    let difference = new.iter().sum::<Vec3>() - old.iter().sum::<Vec3>();
    EmitterChange { gain: gain.collect(), added: dark * difference, dark }
}

/// The degree to which a lamp of this radiance is dark in the photo: 0 for one that shines, 1 for
/// one that is off.
fn darkness(radiance: &[Vec3]) -> f32 {
    1.0 - smooth_step(TUNING.off_radiance, TUNING.on_radiance, level(radiance))
}

fn level(radiance: &[Vec3]) -> f32 {
    luminance(radiance.iter().sum())
}

/// The area of a Lambertian surface with the flux and the radiance of the lamp, square meters.
fn emitting_area(lamp: &Lamp) -> f32 {
    lamp.area() * lamp.escaping()
}

impl EditLights {
    /// The radiance of an estimated light after `changes`.
    ///
    /// # Errors
    /// `On` for a light that is not a lamp.
    pub(super) fn changed(
        &self,
        id: &str,
        changes: &[LightEdit],
        (shape, old): (&Shape, &[Vec3]),
        inputs: &EditLightsIn,
        ctx: &Context,
    ) -> Result<Vec<Vec3>, NodeError> {
        changes.iter().try_fold(old.to_vec(), |w, change| match (change, shape) {
            (LightEdit::On { flux, temperature }, Shape::Lamp(lamp)) => {
                let on = self.switched_on(id, (lamp, &w), (*flux, *temperature), inputs, ctx)?;
                Ok(vec![on])
            }
            (LightEdit::On { .. }, _) => {
                let message = match shape {
                    Shape::Window(_) => "On: wanted a lamp, got a window: use Scale, or Window(..)",
                    _ => "On: no such lamp was estimated: the photo is explained without it",
                };
                Err(NodeError::BadParameter(format!("lights: {id:?}: {message}")))
            }
            _ => Ok(w.iter().map(|&w| change.applied(w)).collect()),
        })
    }

    /// The radiance of an estimated lamp that emits `lumens` at a color temperature.
    ///
    /// Without lumens, a lamp that shines keeps its flux, and one that is off takes the mean of
    /// the estimated lamps that shine, or that of a bulb.
    fn switched_on(
        &self,
        id: &str,
        (lamp, old): (&Lamp, &[Vec3]),
        (lumens, temperature): (Option<f32>, Option<f32>),
        inputs: &EditLightsIn,
        ctx: &Context,
    ) -> Result<Vec3, NodeError> {
        let is_on = |radiance: &[Vec3]| level(radiance) >= TUNING.off_radiance;
        let of_lumens = |lumens: f32| lamp_level(lumens, lamp, self.lux(id, inputs, ctx));
        let shown = match lumens {
            Some(lumens) => of_lumens(lumens),
            None if is_on(old) => level(old),
            None => {
                let others: Vec<f32> = inputs
                    .shapes
                    .iter()
                    .filter_map(|(other, shape)| match (&**shape, inputs.radiances.get(other)) {
                        (Shape::Lamp(lamp), Some(w)) if other != id && is_on(&w.0) => {
                            Some(level(&w.0) * emitting_area(lamp))
                        }
                        _ => None,
                    })
                    .collect();
                if others.is_empty() {
                    let bulb = TUNING.bulb_flux;
                    ctx.warn(format!(
                        "light {id:?}: no estimated lamp shines; it is switched on with {bulb} lumens: give On a flux for another"
                    ));
                    of_lumens(bulb)
                } else {
                    others.iter().sum::<f32>() / others.len() as f32 / emitting_area(lamp)
                }
            }
        };
        let color = match temperature {
            Some(kelvin) => black_body(kelvin),
            None if is_on(old) => old.iter().sum::<Vec3>() / level(old),
            None => Vec3::ONE,
        };
        let radiance = color * shown;
        if radiance.is_finite() {
            return Ok(radiance);
        }
        Err(NodeError::BadParameter(format!(
            "lights: {id:?}: On: wanted a smaller flux for the size of this lamp, got a radiance of {radiance}"
        )))
    }
}

/// The radiance, as luminance in units of the photo, of a lamp that emits `lumens` where white
/// shows 1 under `lux`.
///
/// Flux = pi x area x luminance for a Lambertian surface, and a white surface under `lux` has the
/// luminance lux / pi.
pub fn lamp_level(lumens: f32, lamp: &Lamp, lux: f32) -> f32 {
    lumens / (emitting_area(lamp) * lux)
}
