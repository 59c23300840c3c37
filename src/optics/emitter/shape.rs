//! Light sources: their position and their form, apart from their strength.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::form::{Form, Intersector};
use super::{Lamp, Window};

/// The position, extent and angular form of a light; its strength is a [`Radiance`], one color per
/// lobe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Shape {
    /// The absence of a light: no lobe, no layer.
    Absent,
    /// A surface: one lobe.
    Lamp(Lamp),
    /// A rectangle that shows a distant surrounding of three spherical Gaussians: sun, sky, ground.
    Window(Window),
}

/// The kind of light in a mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum LightKind {
    /// A lamp.
    Lamp,
    /// A window.
    Window,
}

/// The radiance of each lobe, linear RGB in units of the photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Radiance(pub Vec<Vec3>);

impl Shape {
    /// The form of this light; `None` for [`Shape::Absent`].
    pub(super) fn form(&self) -> Option<&dyn Form> {
        match self {
            Shape::Absent => None,
            Shape::Lamp(lamp) => Some(lamp.form()),
            Shape::Window(window) => Some(window),
        }
    }

    /// The consistency of a light that was read from disk: of its triangles and tables.
    ///
    /// # Errors
    /// The rule that is broken.
    pub fn check(&self) -> Result<(), String> {
        self.form().map_or(Ok(()), Form::check)
    }

    /// The number of lobes, and so of layers and radiances: 0, 1 or 3.
    pub fn lobes(&self) -> usize {
        self.form().map_or(0, Form::lobes)
    }

    /// The memory held, bytes.
    pub fn bytes(&self) -> usize {
        size_of::<Shape>() + self.form().map_or(0, Form::heap_bytes)
    }

    /// The light with its positions mapped by `position` and its lengths multiplied by `scale`.
    ///
    /// The two must agree: `position` is a similarity that scales by `scale` and does not rotate.
    pub fn transformed(&self, position: &dyn Fn(Vec3) -> Vec3, scale: f32) -> Shape {
        match self {
            Shape::Absent => Shape::Absent,
            Shape::Lamp(lamp) => Shape::Lamp(lamp.transformed(position, scale)),
            Shape::Window(window) => Shape::Window(window.transformed(position, scale)),
        }
    }

    /// The distance from `origin` along `ray`, in lengths of `ray`, to the emitting side; `None`
    /// where the ray misses it.
    ///
    /// Rays miss [`Lamp::Surfels`], which have gaps.
    pub fn intersect(&self, origin: Vec3, ray: Vec3) -> Option<f32> {
        self.form()?.intersect(origin, ray)
    }

    /// The radiance of one lobe of unit radiance along unit `direction`, from the scene to the
    /// light, 0 or more.
    ///
    /// # Panics
    /// A `lobe` that a window does not have.
    pub fn emission(&self, lobe: usize, direction: Vec3) -> f32 {
        self.form().map_or(1.0, |form| form.emission(lobe, direction))
    }

    /// The center and radius, meters, of a sphere that holds the light; `None` for
    /// [`Shape::Absent`] and an empty one.
    pub fn bounding_sphere(&self) -> Option<(Vec3, f32)> {
        self.form()?.bounding_sphere()
    }

    /// The power that the light sends into the room per unit radiance of one lobe, square meters;
    /// zero without such a lobe.
    pub fn flux(&self, lobe: usize) -> f32 {
        self.form().map_or(0.0, |form| form.flux(lobe))
    }

    /// `count` points spread evenly over the emitting surface, the same for the same light; none
    /// for an absent light.
    pub fn surface_points(&self, count: usize) -> Vec<Vec3> {
        self.form().map_or_else(Vec::new, |form| form.surface_points(count))
    }
}

/// A light prepared for the intersection with many rays.
pub struct Silhouette<'a>(Option<Intersector<'a>>);

impl Silhouette<'_> {
    /// The silhouette of `shape`.
    pub fn new(shape: &Shape) -> Silhouette<'_> {
        Silhouette(shape.form().map(Form::intersector))
    }

    /// [`Shape::intersect`]; of a mesh that hides parts of itself, `None` where the back of a
    /// triangle is nearest.
    pub fn intersect(&self, origin: Vec3, ray: Vec3) -> Option<f32> {
        self.0.as_ref()?(origin, ray)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::SphereLamp;
    use std::f32::consts::PI;

    #[test]
    fn flux_of_a_sphere_is_pi_times_its_area() {
        let sphere = Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::ZERO, radius: 0.5 }));
        assert!((sphere.flux(0) / (PI * PI) - 1.0).abs() < 1e-6, "pi times 4 pi r^2");
        assert_eq!(Shape::Absent.flux(0), 0.0);
    }
}
