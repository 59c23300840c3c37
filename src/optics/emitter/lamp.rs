//! The forms of lamps behind one enum, which only dispatches.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::box_lamp::BoxLamp;
use super::form::Form;
use super::mesh_lamp::MeshLamp;
use super::photometric_lamp::PhotometricLamp;
use super::rect_lamp::RectLamp;
use super::sphere_lamp::SphereLamp;
use super::surfel_lamp::{self, Surfel};

/// The emitting surface of a lamp, camera space, meters: Lambertian but for [`Lamp::Photometric`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Lamp {
    /// A globe or a bulb.
    Sphere(SphereLamp),
    /// A ceiling panel.
    Rect(RectLamp),
    /// A tube or a lantern.
    Box(BoxLamp),
    /// The visible surface of a lamp, a surfel a pixel.
    Surfels(Vec<Surfel>),
    /// A body of any form.
    Mesh(MeshLamp),
    /// A luminaire with measured intensity by direction.
    Photometric(PhotometricLamp),
}

impl Lamp {
    /// The form of this lamp.
    pub(super) fn form(&self) -> &dyn Form {
        match self {
            Lamp::Sphere(form) => form,
            Lamp::Rect(form) => form,
            Lamp::Box(form) => form,
            Lamp::Surfels(form) => form,
            Lamp::Mesh(form) => form,
            Lamp::Photometric(form) => form,
        }
    }

    /// The lamp with its positions mapped by `position` and its lengths multiplied by `scale`.
    ///
    /// The two must agree: `position` is a similarity that scales by `scale` and does not rotate.
    pub fn transformed(&self, position: &dyn Fn(Vec3) -> Vec3, scale: f32) -> Lamp {
        match self {
            Lamp::Sphere(form) => Lamp::Sphere(form.transformed(position, scale)),
            Lamp::Rect(form) => Lamp::Rect(form.transformed(position, scale)),
            Lamp::Box(form) => Lamp::Box(form.transformed(position, scale)),
            Lamp::Surfels(form) => Lamp::Surfels(surfel_lamp::transformed(form, position, scale)),
            Lamp::Mesh(form) => Lamp::Mesh(form.transformed(position)),
            Lamp::Photometric(form) => Lamp::Photometric(form.transformed(position, scale)),
        }
    }

    /// The lamp shifted `by` meters.
    ///
    /// Surfels become a mesh of squares, as the photo does not show pixels of them at the new
    /// position.
    pub fn moved(&self, by: Vec3) -> Lamp {
        match self {
            Lamp::Surfels(surfels) => {
                let corners: Vec<Vec3> =
                    surfels.triangles().into_iter().flatten().map(|p| p + by).collect();
                let triangles =
                    (0..corners.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
                Lamp::Mesh(MeshLamp::without_occlusion(corners, triangles))
            }
            lamp => lamp.transformed(&|p| p + by, 1.0),
        }
    }

    /// The largest distance from the center of
    /// [`Shape::bounding_sphere`](super::Shape::bounding_sphere) along a unit `direction`, meters.
    pub fn extent(&self, direction: Vec3) -> f32 {
        self.form().extent(direction)
    }

    /// The emitting area, square meters.
    ///
    /// # Panics
    /// A mesh with an index outside of its corners, which [`Shape::check`](super::Shape::check)
    /// refuses.
    pub fn area(&self) -> f32 {
        self.form().area()
    }

    /// The fraction of the emitted power that leaves the lamp, 0..=1: less than 1 where parts of a
    /// mesh face each other.
    pub fn escaping(&self) -> f32 {
        self.form().escaping()
    }
}
