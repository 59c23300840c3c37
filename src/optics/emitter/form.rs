//! The interface of a form of light: its geometry, its power, and its preparation for rendering.
//!
//! Each form has a file of its own, which implements [`Form`], and [`PreparedForm`] with
//! [`FormSampler`] if no other form does already. [`Lamp`](super::Lamp), [`Shape`](super::Shape)
//! and [`Emitter`](super::Emitter) only dispatch.

use std::f32::consts::PI;

use glam::{DVec3, Vec3};

use super::gradient::Gradient;
use super::surface_points::spread;
use crate::optics::sampling::Points2;

/// A function from the origin and the direction of a ray to the distance of its first intersection;
/// see [`Form::intersect`].
pub type Intersector<'a> = Box<dyn Fn(Vec3, Vec3) -> Option<f32> + Send + Sync + 'a>;

/// A form of light: camera space, meters, unit radiance.
pub trait Form: Send + Sync {
    /// The consistency of a form that was read from disk.
    ///
    /// # Errors
    /// The rule that is broken.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }

    /// The memory held outside of the form itself, bytes.
    fn heap_bytes(&self) -> usize {
        0
    }

    /// The number of lobes, and so of layers and radiances.
    fn lobes(&self) -> usize {
        1
    }

    /// The emitting area, square meters.
    fn area(&self) -> f32;

    /// The center and radius of a sphere that holds the form; `None` for an empty one.
    fn bounding_sphere(&self) -> Option<(Vec3, f32)>;

    /// The largest distance from the center of the bounding sphere along a unit `direction`,
    /// meters.
    fn extent(&self, direction: Vec3) -> f32;

    /// The distance from `origin` along `ray`, in lengths of `ray`, to the emitting side; `None`
    /// where the ray misses it.
    fn intersect(&self, origin: Vec3, ray: Vec3) -> Option<f32>;

    /// [`Form::intersect`] prepared for many rays.
    fn intersector(&self) -> Intersector<'_> {
        Box::new(|origin, ray| self.intersect(origin, ray))
    }

    /// The radiance of one lobe of unit radiance along unit `direction`, from the scene to the
    /// light.
    fn emission(&self, _lobe: usize, _direction: Vec3) -> f32 {
        1.0
    }

    /// The fraction of the emitted power that leaves the form, 0..=1: less than 1 where its faces
    /// see each other.
    fn escaping(&self) -> f32 {
        1.0
    }

    /// The power per unit radiance of one lobe, square meters: pi times the area for a Lambertian
    /// surface.
    fn flux(&self, _lobe: usize) -> f32 {
        PI * self.area() * self.escaping()
    }

    /// The emitting surface as triangles.
    fn triangles(&self) -> Vec<[Vec3; 3]>;

    /// `count` points spread evenly over the emitting surface, the same for the same form; none
    /// without a surface.
    fn surface_points(&self, count: usize) -> Vec<Vec3> {
        spread(&self.triangles(), count)
    }

    /// The form prepared for rendering; `None` if its size is zero or not finite, so that it emits
    /// nothing.
    fn prepare(&self) -> Option<Box<dyn PreparedForm>>;
}

/// A form prepared for closed forms and sampling. `lobe` is less than [`Form::lobes`]; normals have
/// unit length.
pub trait PreparedForm: Send + Sync {
    /// The irradiance over pi of one lobe of unit radiance; `None` without a closed form, or if it
    /// were slower than sampling.
    fn irradiance(&self, lobe: usize, point: DVec3, normal: DVec3) -> Option<f64>;

    /// A sampler of one lobe for one receiver; `None` where nothing arrives.
    fn sampler_at(
        &self,
        lobe: usize,
        point: DVec3,
        normal: DVec3,
    ) -> Option<Box<dyn FormSampler + '_>>;

    /// The irradiance over pi and its derivatives, the form growing about `pivot`, which is
    /// relative to `point`.
    ///
    /// Zero for forms that no fit moves.
    fn gradient(&self, _lobe: usize, _point: DVec3, _normal: DVec3, _pivot: DVec3) -> Gradient {
        Gradient::default()
    }
}

/// A sampler of one lobe of a form for one receiver.
pub trait FormSampler {
    /// The position of the `i`th sample and its contribution to the irradiance over pi, an unbiased
    /// estimate by itself.
    ///
    /// `None` counts as zero; the caller drops contributions that are not positive and finite.
    fn sample(&self, points: &Points2, i: usize) -> Option<(DVec3, f64)>;
}
