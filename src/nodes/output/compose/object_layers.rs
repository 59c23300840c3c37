//! The layers of an edit over the surfaces of the photo: inserted objects, and changed specular
//! reflection.

use glam::Vec3;
use rayon::prelude::*;

use super::{ComposeIn, LightLayers};
use crate::graph::NodeError;
use crate::image::{Grain, Picture, Shading, Upsampler};
use crate::nodes::artifacts::UnitIndirect;
use crate::optics::{Around, Mirror, MirroredLight, Reflections, SpecularChange};

/// Pixels that one task composes at least: fewer cost more to hand out than to compute.
const TASK: usize = 1024;

/// The objects in front of the room, for planes of the photo's size: of each light, then of the
/// residual.
pub struct ObjectLayers<'a> {
    inputs: &'a ComposeIn,
    lights: &'a LightLayers<'a>,
    /// Diffuse light of the objects in each plane; empty when the camera sees none.
    shown: Vec<&'a Picture>,
    /// Radiance of the cells of the room's hidden sides under each light; empty where nothing
    /// reflects them.
    cells: Vec<Vec<Vec3>>,
    /// Radiance of the unseen part of the room over the mean radiance of the seen part.
    unseen: f32,
}

impl<'a> ObjectLayers<'a> {
    /// The bundle of all inputs about objects.
    ///
    /// # Errors
    /// A light lacks its picture of the objects, or has one of another size; or it lacks the light
    /// on the cells that are reflected.
    pub fn new(
        inputs: &'a ComposeIn,
        lights: &'a LightLayers<'a>,
        unseen: f32,
    ) -> Result<ObjectLayers<'a>, NodeError> {
        let cells = cells(inputs, lights)?;
        let mut layers = ObjectLayers { inputs, lights, shown: Vec::new(), cells, unseen };
        if inputs.objects.is_empty() {
            return Ok(layers);
        }
        for id in &lights.names {
            let shown = inputs.object.get(id);
            let missing =
                || NodeError::Failed(format!("light {id:?} has no picture of the objects"));
            layers.shown.push(shown.ok_or_else(missing)?);
        }
        layers.shown.push(&inputs.object_residual);
        let (w, h) = inputs.objects.coverage.size();
        if let Some(shown) = layers.shown.iter().find(|shown| shown.0.size() != (w, h)) {
            let got = shown.0.size();
            let message =
                format!("a picture of the objects is {} x {}, wanted {w} x {h}", got.0, got.1);
            return Err(NodeError::Failed(message));
        }
        Ok(layers)
    }

    /// The camera sees no object.
    pub fn is_empty(&self) -> bool {
        self.shown.is_empty()
    }

    /// Composites diffuse light and reflections of the objects, with the noise `grain`, over the
    /// planes.
    ///
    /// # Errors
    /// A light lacks its reflection or its radiance.
    pub fn cover(&self, grain: Option<&Grain>, planes: &mut [Vec<Vec3>]) -> Result<(), NodeError> {
        let objects = &self.inputs.objects;
        let (w, h) = objects.coverage.size();
        let width = self.inputs.photo.0.width();
        let photo = |i: usize| (objects.top + i / w) * width + objects.left + i % w;
        let mirror = self.reflected().map(|of| self.mirror(of, self.around(planes))).transpose()?;
        let factors = grain.map(|grain| self.factors(grain));
        let after: Vec<Vec<Vec3>> = (0..planes.len())
            .map(|layer| {
                let pixel = |i: usize| {
                    let alpha = objects.coverage.pixels()[i] * self.lights.uncovered(photo(i));
                    let behind = planes[layer][photo(i)];
                    if alpha <= 0.0 {
                        return behind;
                    }
                    let object = self.object(mirror.as_ref(), layer, &planes[layer], i);
                    let factor = factors.as_ref().map_or(Vec3::ONE, |factors| factors[i]);
                    behind * (1.0 - alpha) + factor * object * alpha
                };
                (0..w * h).into_par_iter().with_min_len(TASK).map(pixel).collect()
            })
            .collect();
        for (plane, after) in planes.iter_mut().zip(after) {
            after.into_iter().enumerate().for_each(|(i, value)| plane[photo(i)] = value);
        }
        Ok(())
    }

    /// Noise of each object pixel, as a factor: that of a surface with the object's albedo under
    /// the shading that the photo has there.
    fn factors(&self, grain: &Grain) -> Vec<Vec3> {
        let (inputs, objects) = (self.inputs, &self.inputs.objects);
        let ((width, height), (columns, rows)) = (inputs.photo.0.size(), inputs.residual.0.size());
        let factor = |i: usize| {
            if objects.coverage.pixels()[i] <= 0.0 {
                return Vec3::ONE;
            }
            let w = objects.coverage.width();
            let (x, y) = (objects.left + i % w, objects.top + i / w);
            let small = |shading: &Shading| shading.0.get(x * columns / width, y * rows / height);
            let lights: Vec3 = inputs.before.iter().map(|(_, shading)| small(shading)).sum();
            let shading = lights + small(&inputs.residual);
            grain.factor((x, y), objects.albedo.pixels()[i] * shading)
        };
        (0..objects.coverage.len()).into_par_iter().with_min_len(TASK).map(factor).collect()
    }

    /// Replaces the reflection of surfaces with an edited roughness or specular level. Own pixels
    /// of lights stay.
    ///
    /// # Errors
    /// A light lacks its reflection or its radiance.
    pub fn change_specular(
        &self,
        change: &SpecularChange,
        planes: &mut [Vec<Vec3>],
    ) -> Result<(), NodeError> {
        let inputs = self.inputs;
        let around = self.around(planes);
        // Objects with their own reflection, of the room before this change.
        let mirror = self.reflected().map(|of| self.mirror(of, around.clone())).transpose()?;
        let bodies =
            self.shown.iter().zip(planes.iter()).enumerate().map(|(layer, (shown, plane))| {
                let object = |i| self.object(mirror.as_ref(), layer, plane, i);
                (0..shown.0.len()).into_par_iter().with_min_len(TASK).map(object).collect()
            });
        let bodies: Vec<Vec<Vec3>> = bodies.collect();
        let mut changes: Vec<Vec<(u32, Vec3)>> = vec![Vec::new(); planes.len()];
        for part in &change.0 {
            let mirror = self.mirror(&part.of, around.clone())?;
            let (small, depth) = part.reduced(&inputs.photo, &inputs.full_depth);
            let upsampler = Upsampler::new(&inputs.photo, &inputs.full_depth, &small, &depth);
            for (layer, plane) in planes.iter().enumerate() {
                let object = |i: usize| bodies[layer][i];
                changes[layer].extend(part.adds(&mirror, &upsampler, layer, plane, object));
            }
        }
        for (plane, changes) in planes.iter_mut().zip(changes) {
            let mut sums = vec![Vec3::ZERO; plane.len()];
            changes.into_iter().for_each(|(i, change)| sums[i as usize] += change);
            for (i, sum) in sums.into_iter().enumerate().filter(|(_, sum)| *sum != Vec3::ZERO) {
                let free = if self.lights.is_own(i) { 0.0 } else { self.lights.uncovered(i) };
                plane[i] = (plane[i] + sum * free).max(plane[i].min(Vec3::ZERO));
            }
        }
        Ok(())
    }

    /// Diffuse light and reflection of object pixel `i` in a layer, whose room is `plane`.
    fn object(&self, mirror: Option<&Mirror>, layer: usize, plane: &[Vec3], i: usize) -> Vec3 {
        let shown = self.shown[layer].0.pixels();
        shown[i] + mirror.map_or(Vec3::ZERO, |mirror| mirror.shows(i, layer, plane, |i| shown[i]))
    }

    /// The reflections of the objects, when the camera sees a shiny one.
    fn reflected(&self) -> Option<&Reflections> {
        self.inputs.reflected.as_deref().filter(|_| !self.is_empty())
    }

    fn around(&self, planes: &[Vec<Vec3>]) -> Around {
        let room: Vec<usize> =
            (0..self.inputs.photo.0.len()).filter(|&i| self.lights.is_surface(i)).collect();
        Around::new(planes, &room, self.unseen)
    }

    /// The lights and the room as the places of `of` reflect them.
    fn mirror<'b>(&'b self, of: &'b Reflections, around: Around) -> Result<Mirror<'b>, NodeError> {
        let light = |(light, &id): (usize, &&'b str)| {
            let missing = || NodeError::Failed(format!("light {id:?} has no radiance"));
            let radiance = &self.inputs.radiance.get(id).ok_or_else(missing)?.0[..];
            let cells = self.cells.get(light).map_or(&[][..], |cells| cells);
            Ok(MirroredLight { id, radiance, cells })
        };
        let lights: Result<Vec<MirroredLight>, NodeError> =
            self.lights.names.iter().enumerate().map(light).collect();
        Mirror::new(of, around, &lights?).map_err(NodeError::Failed)
    }
}

/// Radiance of the cells of the room's hidden sides under each light; nothing where no surface
/// reflects them.
fn cells(inputs: &ComposeIn, lights: &LightLayers) -> Result<Vec<Vec<Vec3>>, NodeError> {
    let changed = inputs.specular_change.iter().flat_map(|change| &change.0).map(|part| &part.of);
    let reflected = inputs.reflected.as_deref().into_iter().chain(changed);
    let count = reflected.map(|of| of.cells.len()).max().unwrap_or(0);
    if count == 0 {
        return Ok(Vec::new());
    }
    let of_light = |id: &&str| {
        let fail = |message: String| NodeError::Failed(format!("light {id:?} {message}"));
        let indirect = inputs.indirect.get(id).map(|indirect| &**indirect);
        let indirect = indirect.ok_or_else(|| {
            fail("has no `indirect`, wanted it for the cells of the room in reflections".into())
        })?;
        let radiance = inputs.radiance.get(id).ok_or_else(|| fail("has no radiance".into()))?;
        cells_under(indirect, &radiance.0, count).map_err(fail)
    };
    lights.names.iter().map(of_light).collect()
}

/// Radiance of `count` cells under a light whose lobes have these radiances.
fn cells_under(
    indirect: &UnitIndirect,
    radiance: &[Vec3],
    count: usize,
) -> Result<Vec<Vec3>, String> {
    let lobes = &indirect.cells;
    if lobes.len() != radiance.len() {
        let (got, wanted) = (lobes.len(), radiance.len());
        return Err(format!(
            "has {got} lobes of cells in `indirect`, wanted {wanted} as `radiance`"
        ));
    }
    let mut sum = vec![Vec3::ZERO; count];
    for (lobe, radiance) in lobes.iter().zip(radiance) {
        if lobe.len() != count {
            let got = lobe.len();
            return Err(format!("has {got} cells in `indirect`, wanted {count} as reflections"));
        }
        sum.iter_mut().zip(lobe.pixels()).for_each(|(sum, cell)| *sum += *cell * *radiance);
    }
    Ok(sum)
}
