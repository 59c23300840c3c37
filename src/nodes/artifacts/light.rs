//! Unit layers of lights, and estimates of lights.

use std::sync::Arc;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::same_size;
use crate::graph::{Gather, NodeError};
use crate::image::{Plane, Shading, rule};
use crate::optics::inverse::GlareKernel;
use crate::optics::{Lobe, Radiance, Shape};

/// Unshadowed direct shading of one light, per lobe of unit radiance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnitDirect {
    /// Irradiance / pi, per lobe.
    pub lobes: Vec<Plane<f32>>,
    /// Standard error of each, same units; zero where a closed form was used.
    pub stderr: Vec<Plane<f32>>,
}

/// Visibility of one light, per lobe: fractions of the unshadowed direct shading, 0..=1.
/// Blocked = 1 - lit - unknown.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Visibility {
    /// Lit fraction, per lobe.
    pub lit: Vec<Plane<f32>>,
    /// Standard error of `lit`.
    pub stderr: Vec<Plane<f32>>,
    /// Rays that pass behind a depth edge or leave the seen volume.
    pub unknown: Vec<Plane<f32>>,
}

/// The sun whose light the photo shows.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sun {
    /// Unit vector to the sun, camera space; 0 without windows.
    pub direction: Vec3,
    /// The windows through which it shines; none where the photo shows no sun.
    pub windows: Vec<String>,
}

impl Sun {
    /// Direction of the sun through this light, if it shines through it.
    pub fn through(&self, light: &str) -> Option<Vec3> {
        self.windows.iter().any(|window| window == light).then_some(self.direction)
    }
}

/// Sunlight that the photo shows, through one window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sunlight {
    /// Unit vector to the sun, camera space.
    pub direction: Vec3,
    /// Lit fraction of each pixel, 0..=1; empty where the photo shows no sun through this window.
    pub lit: Plane<f32>,
}

impl Sunlight {
    /// No sun.
    pub fn none() -> Sunlight {
        Sunlight { direction: Vec3::ZERO, lit: Plane::filled(0, 0, 0.0) }
    }

    /// Direction and bandwidth of the sun in `shape`, if the photo shows its light: the shape is
    /// that which was `estimated`, and its sun the one that was found.
    pub fn shown(&self, shape: &Shape, estimated: Option<&Shape>) -> Option<Lobe> {
        let Shape::Window(window) = shape else { return None };
        let sun = window.lobes[0];
        let is_shown =
            !self.lit.is_empty() && estimated == Some(shape) && sun.direction == self.direction;
        is_shown.then_some(sun)
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// The rule that does not hold.
    pub fn check(&self) -> Result<(), String> {
        rule(self.lit.is_empty() || self.direction.is_normalized(), "a unit vector to the sun")?;
        rule(
            self.lit.pixels().iter().all(|lit| (0.0..=1.0).contains(lit)),
            "lit fractions in 0..=1",
        )
    }
}

/// Change of a light's emission by an edit, for the photo pixels that show the light itself.
///
/// The emitted radiance R of such a pixel becomes `gain R + added`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EmitterChange {
    /// Radiance after over radiance before, per lobe and channel, 0 or more.
    pub gain: Vec<Vec3>,
    /// Radiance of a lamp that is dark in the photo and that the edit switches on, linear RGB in
    /// units of the photo: a factor on its dark pixels cannot make it shine. 0 for all others.
    pub added: Vec3,
    /// The degree to which a lamp that the edit switches on is dark in the photo, 0..=1; 0 for all
    /// others. The photo around a dark lamp has none of its glare.
    pub dark: f32,
}

/// Indirect shading (irradiance / pi) of one light, per lobe of unit radiance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnitIndirect {
    /// Irradiance / pi, per lobe.
    pub lobes: Vec<Shading>,
    /// Standard error of each lobe's luminance. All lobes and lights share their rays, so their
    /// errors go together.
    pub stderr: Vec<Plane<f32>>,
    /// The same at the probes of inserted bodies, per lobe, one row; empty without bodies.
    pub probes: Vec<Plane<Vec3>>,
    /// Radiosity / pi of the cells of the room's hidden sides, per lobe, one row; empty without
    /// them.
    pub cells: Vec<Plane<Vec3>>,
}

/// Direct light, shadows included, of one light on the cells of the room's hidden sides, per lobe
/// of unit radiance: irradiance / pi, one row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellLight {
    /// At the cells of a layout.
    pub lobes: Vec<Plane<f32>>,
}

/// Standard error of the layer of one light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LayerError {
    /// Standard error of the luminance of the shading, irradiance / pi.
    pub stderr: Plane<f32>,
}

/// Light of one light in view that the lens scatters over the picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScatteredLight {
    /// The glare, linear, in units of the photo.
    pub glare: Plane<Vec3>,
    /// Brightness that is scattered, in units of the photo: the fraction that the lens scatters
    /// times the brightness of the light.
    pub amplitude: f32,
    /// The kernel, alike for all lights of a photo.
    pub kernel: GlareKernel,
}

impl ScatteredLight {
    /// Checks that the glare is light.
    ///
    /// # Errors
    /// The rule that does not hold.
    pub fn check(&self) -> Result<(), String> {
        let is_light = |glare: &Vec3| glare.is_finite() && glare.min_element() >= 0.0;
        rule(self.glare.pixels().iter().all(is_light), "glare of 0 or more")?;
        rule(self.amplitude >= 0.0 && self.kernel.slope > 0.0, "a kernel that falls")
    }
}

/// Factor of the shading by one light in view; empty where it is 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ShadingGain(pub Plane<Vec3>);

impl ShadingGain {
    /// The factor 1.
    pub fn none() -> ShadingGain {
        ShadingGain(Plane::filled(0, 0, Vec3::ONE))
    }

    /// The lights times their gains, of those for which `stays` holds.
    ///
    /// # Errors
    /// A gain has another size than its light.
    pub fn scaled(
        lights: &Gather<Shading>,
        gains: &Gather<ShadingGain>,
        stays: impl Fn(&str) -> bool,
    ) -> Result<Gather<Shading>, NodeError> {
        let scaled = |(id, light): (&str, &Arc<Shading>)| {
            let gain = gains.get(id).filter(|gain| !gain.0.is_empty() && stays(id));
            let Some(gain) = gain else { return Ok((id.to_owned(), Arc::clone(light))) };
            let (w, h) = light.0.size();
            same_size(id, gain.0.size(), "its shading", (w, h))?;
            let both = light.0.pixels().iter().zip(gain.0.pixels());
            let pixels = both.map(|(light, gain)| *light * *gain).collect();
            Ok((id.to_owned(), Arc::new(Shading(Plane::new(w, h, pixels)))))
        };
        Ok(Gather(lights.iter().map(scaled).collect::<Result<_, NodeError>>()?))
    }

    /// Checks that the factors are positive.
    ///
    /// # Errors
    /// The rule that does not hold.
    pub fn check(&self) -> Result<(), String> {
        let is_factor = |gain: &Vec3| gain.is_finite() && gain.min_element() > 0.0;
        rule(self.0.pixels().iter().all(is_factor), "factors above 0")
    }
}

/// Direct light, shadows included, of one light on inserted bodies, per lobe of unit radiance:
/// irradiance / pi.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObjectLight {
    /// At the samples of `Objects`.
    pub lobes: Vec<Plane<f32>>,
    /// At the probes, one row.
    pub probes: Vec<Plane<f32>>,
    /// Albedo at the probes.
    pub albedo: Plane<Vec3>,
}

/// The estimate of one light by a network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Guess {
    /// Its shape; [`Shape::Absent`] without an estimate.
    pub shape: Shape,
    /// Its radiance, one color per lobe, in units of the photo.
    pub radiance: Radiance,
    /// Probability that it emits, 0..=1.
    pub burns: f32,
    /// Expected error of its direct shading, as a fraction of that shading.
    pub error: f32,
}

/// Photo shading minus direct light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Residual {
    /// Zero where the photo is saturated or shows a light.
    pub left: Plane<Vec3>,
    /// Mean direct shading.
    pub direct: Vec3,
    /// Power of all lights, square meters times radiance.
    pub power: Vec3,
}

/// Checks that each list has one plane per lobe, all of one size; lists without planes are left
/// out.
///
/// # Errors
/// The rule that the lists break.
pub(super) fn lobes(lists: &[&[Plane<f32>]]) -> Result<(), String> {
    let mut planes = lists.iter().copied().flatten();
    let size = planes.next().map(Plane::size);
    rule(planes.all(|plane| Some(plane.size()) == size), "planes of one size")?;
    let mut counts = lists.iter().map(|list| list.len()).filter(|&count| count > 0);
    let count = counts.next();
    rule(counts.all(|other| Some(other) == count), "planes for each lobe")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gain_scales_the_light_that_stays() {
        let light = |id: &str| {
            (id.to_owned(), Arc::new(Shading(Plane::filled(2, 1, Vec3::new(1.0, 2.0, 3.0)))))
        };
        let gain = |id: &str, gain| (id.to_owned(), Arc::new(gain));
        let lights = Gather(vec![light("a"), light("b"), light("c"), light("d")]);
        let half = || ShadingGain(Plane::filled(2, 1, Vec3::splat(0.5)));
        let gains =
            Gather(vec![gain("a", half()), gain("b", half()), gain("c", ShadingGain::none())]);
        let scaled = ShadingGain::scaled(&lights, &gains, |id| id != "b").expect("one size");
        let got: Vec<f32> = scaled.iter().map(|(_, light)| light.0.get(1, 0).y).collect();
        assert_eq!(got, [1.0, 2.0, 2.0, 2.0]);
        let gains = Gather(vec![gain("a", ShadingGain(Plane::filled(1, 1, Vec3::ONE)))]);
        assert!(ShadingGain::scaled(&lights, &gains, |_| true).is_err());
        assert!(ShadingGain(Plane::filled(1, 1, Vec3::ZERO)).check().is_err());
    }
}
