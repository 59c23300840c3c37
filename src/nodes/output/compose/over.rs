//! What an edit puts over the surfaces of the photo: inserted objects, and another finish.

use glam::Vec3;
use rayon::prelude::*;

use super::ComposeIn;
use crate::graph::NodeError;
use crate::image::{Mask, Picture, Upsampler};
use crate::optics::{Around, Mirror, Polish, Reflections};

/// All of it, for planes of the photo's size: of each light, then of the rest.
pub struct Over<'a> {
    pub inputs: &'a ComposeIn,
    /// The lights.
    pub names: &'a [&'a str],
    /// What objects show of each plane; nothing when none is seen.
    pub objects: &'a [&'a Picture],
    /// Pixels of the bodies of inserted lights, which stand before all.
    pub lamps: &'a [&'a Mask],
    /// What is reflected of the unseen part of the room, as a multiple of the mean of what is seen.
    pub unseen: f32,
}

impl Over<'_> {
    /// Puts what objects show and reflect over the planes.
    pub fn cover(&self, planes: &mut [Vec<Vec3>]) -> Result<(), NodeError> {
        let objects = &self.inputs.objects;
        let (w, h) = objects.cover.size();
        let width = self.inputs.photo.0.width();
        let photo = |i: usize| (objects.top + i / w) * width + objects.left + i % w;
        let mirror = self.reflected().map(|of| self.mirror(of, self.around(planes))).transpose()?;
        let after: Vec<Vec<Vec3>> = (0..planes.len())
            .map(|layer| {
                let pixel = |i: usize| {
                    let (share, behind) = (objects.cover.pixels()[i] * self.free(photo(i)), planes[layer][photo(i)]);
                    if share <= 0.0 {
                        return behind;
                    }
                    behind * (1.0 - share) + self.object(mirror.as_ref(), layer, &planes[layer], i) * share
                };
                (0..w * h).into_par_iter().with_min_len(1024).map(pixel).collect()
            })
            .collect();
        for (plane, after) in planes.iter_mut().zip(after) {
            after.into_iter().enumerate().for_each(|(i, value)| plane[photo(i)] = value);
        }
        Ok(())
    }

    /// Puts what surfaces of another finish reflect in the place of what they did. Lights of the photo are not polished.
    pub fn polish(&self, polish: &Polish, planes: &mut [Vec<Vec3>]) -> Result<(), NodeError> {
        let inputs = self.inputs;
        let around = self.around(planes);
        // Bodies with what they reflect themselves, of the room without polish.
        let mirror = self.reflected().map(|of| self.mirror(of, around.clone())).transpose()?;
        let bodies = self.objects.iter().zip(planes.iter()).enumerate().map(|(layer, (shown, plane))| {
            let object = |i| self.object(mirror.as_ref(), layer, plane, i);
            (0..shown.0.len()).into_par_iter().with_min_len(1024).map(object).collect()
        });
        let bodies: Vec<Vec<Vec3>> = bodies.collect();
        let mut changes: Vec<Vec<(u32, Vec3)>> = vec![Vec::new(); planes.len()];
        for part in &polish.0 {
            let mirror = self.mirror(&part.of, around.clone())?;
            let (small, depth) = part.reduced(&inputs.photo, &inputs.full_depth);
            let upsampler = Upsampler::new(&inputs.photo, &inputs.full_depth, &small, &depth);
            for (layer, plane) in planes.iter().enumerate() {
                let object = |i: usize| bodies[layer][i];
                changes[layer].extend(part.adds(&mirror, &upsampler, layer, plane, object));
            }
        }
        let is_light = |i: usize| inputs.zone.iter().any(|(_, zone)| zone.0.pixels()[i] >= 1.0);
        for (plane, changes) in planes.iter_mut().zip(changes) {
            let mut sums = vec![Vec3::ZERO; plane.len()];
            changes.into_iter().for_each(|(i, change)| sums[i as usize] += change);
            for (i, sum) in sums.into_iter().enumerate().filter(|(_, sum)| *sum != Vec3::ZERO) {
                let free = if is_light(i) { 0.0 } else { self.free(i) };
                plane[i] = (plane[i] + sum * free).max(plane[i].min(Vec3::ZERO));
            }
        }
        Ok(())
    }

    /// How much of a photo pixel no inserted light covers.
    fn free(&self, photo: usize) -> f32 {
        self.lamps.iter().map(|lamp| 1.0 - lamp.0.pixels()[photo]).product()
    }

    /// What pixel `i` of the objects shows of a layer, whose room is `plane`, with what it reflects.
    fn object(&self, mirror: Option<&Mirror>, layer: usize, plane: &[Vec3], i: usize) -> Vec3 {
        let shown = self.objects[layer].0.pixels();
        shown[i] + mirror.map_or(Vec3::ZERO, |mirror| mirror.shows(i, layer, plane, |i| shown[i]))
    }

    /// What the objects reflect, when they are seen and shiny.
    fn reflected(&self) -> Option<&Reflections> {
        self.inputs.reflected.as_deref().filter(|_| !self.objects.is_empty())
    }

    fn around(&self, planes: &[Vec<Vec3>]) -> Around {
        let inputs = self.inputs;
        let room: Vec<usize> = (0..inputs.photo.0.len())
            .filter(|&i| inputs.zone.iter().all(|(_, zone)| zone.0.pixels()[i] <= 0.0))
            .collect();
        Around::new(planes, &room, self.unseen)
    }

    /// What `of` shows of the lights and of the room.
    fn mirror<'a>(&'a self, of: &'a Reflections, around: Around) -> Result<Mirror<'a>, NodeError> {
        let lights: Option<Vec<(&str, &[Vec3])>> =
            self.names.iter().map(|id| Some((*id, &self.inputs.radiance.get(id)?.0[..]))).collect();
        let mirror = lights.and_then(|lights| Mirror::new(of, around, &lights));
        mirror.ok_or_else(|| NodeError::Failed("a light has no reflection or no radiance".into()))
    }
}
