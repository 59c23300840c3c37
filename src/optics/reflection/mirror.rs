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

/// A light as mirrors show it.
#[derive(Clone, Copy, Debug)]
pub struct MirroredLight<'a> {
    /// Its name.
    pub id: &'a str,
    /// Radiance of each lobe.
    pub radiance: &'a [Vec3],
    /// Radiance of each cell of the room's hidden sides under this light alone.
    pub cells: &'a [Vec3],
}

/// Reflections over the layers of a picture: one per light, then the residual.
pub struct Mirror<'a> {
    of: &'a Reflections,
    around: Around,
    /// Radiance of the cells by layer; none in the last, which shows the unseen part there.
    cells: Vec<&'a [Vec3]>,
    /// The lights themselves: reflection of unit lobes, with their radiances; nothing for the last
    /// layer.
    lights: Vec<Vec<(&'a Plane<Vec3>, Vec3)>>,
}

impl<'a> Mirror<'a> {
    /// The reflections `of` the room `around` and of these `lights`, in the order of the layers.
    ///
    /// # Errors
    /// `of` lacks the reflection of a light, or it has another number of cells than the light.
    pub fn new(
        of: &'a Reflections,
        around: Around,
        lights: &[MirroredLight<'a>],
    ) -> Result<Mirror<'a>, String> {
        let reflection = |light: &MirroredLight<'a>| {
            let MirroredLight { id, radiance, cells } = light;
            let found = of.lights.iter().find(|(name, _)| name == id);
            let (_, lobes) = found.ok_or_else(|| format!("light {id:?} has no reflection"))?;
            let (wanted, got) = (of.cells.len(), cells.len());
            if wanted > 0 && wanted != got {
                return Err(format!(
                    "light {id:?} lights {got} cells of the room, wanted {wanted} as reflected"
                ));
            }
            Ok(lobes.iter().zip(radiance.iter().copied()).collect())
        };
        let cells = lights.iter().map(|light| light.cells).collect();
        let mut lights: Vec<Vec<_>> = lights.iter().map(reflection).collect::<Result<_, _>>()?;
        lights.push(Vec::new());
        Ok(Mirror { of, around, cells, lights })
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
            ReflectedHit::Cell(cell, at) => match self.cells.get(layer) {
                Some(cells) => weight * self.of.cells.interpolate(cells, cell, at),
                None => weight * unseen[layer],
            },
        });
        let lights = self.lights[layer].iter().map(|(lobe, w)| lobe.pixels()[i] * *w);
        far * share[layer] + shown.chain(lights).sum::<Vec3>()
    }
}
