//! Layers of a picture as shiny objects reflect them.

use glam::{DVec3, Vec3};

use super::reflect::{ReflectedHit, Reflections};
use crate::image::Plane;

/// The room around reflecting surfaces.
#[derive(Clone, Debug)]
pub struct Around {
    /// Number of photo pixels.
    photo: usize,
    /// Radiance of the unseen part, by layer.
    unseen: Vec<Vec3>,
    /// Each layer's share of all light.
    share: Vec<Vec3>,
}

impl Around {
    /// `planes` hold the layers of the room without objects, `room` the pixels that do not show a
    /// light. The unseen part of the room shows `unseen` times their mean.
    pub fn new(planes: &[Vec<Vec3>], room: &[usize], unseen: f32) -> Around {
        let mean = |plane: &Vec<Vec3>| {
            let sum = room.iter().map(|&i| plane[i].as_dvec3()).sum::<DVec3>();
            (sum / room.len().max(1) as f64).as_vec3()
        };
        let means: Vec<Vec3> = planes.iter().map(mean).collect();
        let all = means.iter().sum::<Vec3>().max(Vec3::splat(1e-12));
        Around {
            photo: planes.first().map_or(0, Vec::len),
            share: means.iter().map(|&m| m / all).collect(),
            unseen: means.iter().map(|&m| m * unseen).collect(),
        }
    }
}

/// Reflections over the layers of a picture: one per light, then the residual.
pub struct Mirror<'a> {
    of: &'a Reflections,
    around: Around,
    /// The lights themselves: reflection of unit lobes, with their radiances; nothing for the last
    /// layer.
    lights: Vec<Vec<(&'a Plane<Vec3>, Vec3)>>,
}

impl<'a> Mirror<'a> {
    /// `None` when the reflection of one of these `lights`, given with their radiances, is missing.
    pub fn new(
        of: &'a Reflections,
        around: Around,
        lights: &[(&str, &[Vec3])],
    ) -> Option<Mirror<'a>> {
        let reflection = |(id, radiance): &(&str, &[Vec3])| {
            let (_, lobes) = of.lights.iter().find(|(name, _)| name == id)?;
            Some(lobes.iter().zip(radiance.iter().copied()).collect())
        };
        let mut lights: Vec<Vec<_>> = lights.iter().map(reflection).collect::<Option<_>>()?;
        lights.push(Vec::new());
        Some(Mirror { of, around, lights })
    }

    /// Reflected radiance at pixel `i` of the objects in a `layer`, whose room is `plane` and whose
    /// objects are `object`.
    pub fn shows(
        &self,
        i: usize,
        layer: usize,
        plane: &[Vec3],
        object: impl Fn(usize) -> Vec3,
    ) -> Vec3 {
        let Around { photo, unseen, share } = &self.around;
        let rays = self.of.hits.width();
        let range = i * rays..(i + 1) * rays;
        let far = self.of.far.pixels()[i];
        let hits = self.of.hits.pixels()[range.clone()].iter().zip(&self.of.weight.pixels()[range]);
        let shown = hits.map(|(&end, &weight)| match end.hit() {
            ReflectedHit::Nothing => Vec3::ZERO,
            // Radiance that a network estimates is in `far`.
            ReflectedHit::Unseen if far != Vec3::ZERO => Vec3::ZERO,
            ReflectedHit::Unseen => weight * unseen[layer],
            ReflectedHit::Pixel(i) if i < *photo => weight * plane[i],
            ReflectedHit::Pixel(i) => weight * object(i - photo),
        });
        let lights = self.lights[layer].iter().map(|(lobe, w)| lobe.pixels()[i] * *w);
        far * share[layer] + shown.chain(lights).sum::<Vec3>()
    }
}
