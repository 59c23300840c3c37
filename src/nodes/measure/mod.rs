//! Stages that compare estimates with the truth and give scores.

pub mod read_pictures;
pub mod score_direct;
pub mod score_lighting;
pub mod score_lights;
pub mod score_materials;
pub mod score_picture;
pub mod score_shading;

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, File, Gather, NodeError};
use crate::image::{self, Mask, NamedBytes, Picture, Plane, Transfer, read_photo};
use crate::nodes::artifacts::{Score, Scores, UnitDirect, same_size};
use crate::optics::Radiance;
use crate::tuning::Table;

/// A linear picture.
fn read(ctx: &Context, file: &File) -> Result<Picture, NodeError> {
    let bytes = ctx.read(file)?;
    let path = file.location().display().to_string();
    let photo = read_photo(NamedBytes::new(&path, &bytes), Transfer::Srgb);
    let photo =
        photo.map_err(|e| NodeError::BadFile { path: path.clone(), message: e.message() })?;
    photo.warnings.iter().for_each(|warning| ctx.warn(format!("{}: {warning}", file.path)));
    Ok(photo.picture)
}

/// The pixels of a picture that do not show a light.
fn no_light<'a>(
    size: (usize, usize),
    masks: impl Iterator<Item = (&'a str, &'a Arc<Mask>)>,
) -> Result<Plane<bool>, NodeError> {
    let mut counted = Plane::filled(size.0, size.1, true);
    for (id, mask) in masks {
        same_size(id, mask.0.size(), "what is measured", size)?;
        counted
            .pixels_mut()
            .iter_mut()
            .zip(mask.0.pixels())
            .for_each(|(counted, share)| *counted &= *share == 0.0);
    }
    Ok(counted)
}

/// The sum of pictures of one size; `None` without pictures.
fn sum(pictures: &Gather<Picture>) -> Result<Option<Plane<Vec3>>, NodeError> {
    let mut all = pictures.iter();
    let Some((first, picture)) = all.next() else { return Ok(None) };
    let mut sum = picture.0.clone();
    for (name, picture) in all {
        same_size(name, picture.0.size(), first, sum.size())?;
        sum.pixels_mut().iter_mut().zip(picture.0.pixels()).for_each(|(sum, light)| *sum += *light);
    }
    Ok(Some(sum))
}

/// A picture of the truth at working size.
fn fitted(
    name: &str,
    picture: &Plane<Vec3>,
    size: (usize, usize),
) -> Result<Plane<Vec3>, NodeError> {
    if !image::same_aspect(picture.size(), size) {
        return same_size(name, picture.size(), "the photo", size).map(|()| picture.clone());
    }
    Ok(image::resize(picture, size.0, size.1))
}

/// Unshadowed shading of a light of these radiances, and its visible part by `lit`.
fn shaded(
    direct: &UnitDirect,
    lit: Option<&[Plane<f32>]>,
    radiance: &Radiance,
    size: (usize, usize),
) -> Plane<Vec3> {
    let mut sum = Plane::filled(size.0, size.1, Vec3::ZERO);
    for (lobe, (e, radiance)) in direct.lobes.iter().zip(&radiance.0).enumerate() {
        for (i, (sum, e)) in sum.pixels_mut().iter_mut().zip(e.pixels()).enumerate() {
            *sum += *radiance * *e * lit.map_or(1.0, |lit| lit[lobe].pixels()[i]);
        }
    }
    sum
}

fn score(subject: &str, measure: &str, value: Option<f64>) -> Option<Score> {
    Some(Score { subject: subject.to_owned(), measure: measure.to_owned(), value: value? })
}

fn scores(list: impl IntoIterator<Item = Option<Score>>) -> Arc<Scores> {
    Arc::new(Scores(list.into_iter().flatten().collect()))
}

/// The constants of scores.
pub fn tuning() -> Vec<Table> {
    vec![score_picture::ScorePictureTuning::table()]
}
