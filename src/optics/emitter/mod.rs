//! Light sources of unit radiance: one form a file, behind enums that only dispatch.
//!
//! A form of lamp is a type with [`Form`](form::Form) (geometry, power) and a prepared type with
//! [`PreparedForm`](form::PreparedForm) (closed form, samples, gradient). To add one: write its
//! file, name it below, and give it a variant of [`Lamp`] with a line in `Lamp::form` and
//! `Lamp::transformed`. Files that users read, such as USD, need an arm each. Forms do not use the
//! enums.
//!
//! The irradiance over pi of unit radiance is E = (1/pi) integral of cos(theta) over the directions
//! in which the light is visible, horizon included, shadows not. The closed forms and the samples
//! describe the same light: each sample's contribution is an unbiased estimate of the closed form.

pub(in crate::optics) mod box_lamp;
pub(in crate::optics) mod form;
pub(in crate::optics) mod gradient;
pub(in crate::optics) mod lamp;
mod mesh_clusters;
pub(in crate::optics) mod mesh_lamp;
pub(in crate::optics) mod photometric_lamp;
pub(in crate::optics) mod photometric_web;
mod pieces;
pub(in crate::optics) mod prepared;
pub(in crate::optics) mod rect_lamp;
pub(in crate::optics) mod shape;
mod sides;
pub(in crate::optics) mod sphere_lamp;
mod surface_points;
pub(in crate::optics) mod surfel_lamp;
pub(in crate::optics) mod window;
pub(in crate::optics) mod window_sampler;

pub use box_lamp::BoxLamp;
pub use gradient::Gradient;
pub use lamp::Lamp;
pub use mesh_lamp::MeshLamp;
pub use photometric_lamp::PhotometricLamp;
pub use photometric_web::{PhotometricWeb, PhotometricWebTable};
pub use prepared::{Emitter, EmitterSampler, LightSample};
pub use rect_lamp::RectLamp;
pub use shape::{LightKind, Radiance, Shape, Silhouette};
pub use sphere_lamp::SphereLamp;
pub use surfel_lamp::Surfel;
pub use window::{LOBES, Window};
pub use window_sampler::Strategy;

use crate::tuning::Table;

/// The constants of light sources.
pub fn tuning() -> Vec<Table> {
    vec![
        mesh_clusters::MeshClustersTuning::table(),
        mesh_lamp::MeshLampTuning::table(),
        photometric_web::PhotometricWebTuning::table(),
        pieces::PiecesTuning::table(),
        surfel_lamp::SurfelLampTuning::table(),
        window::WindowTuning::table(),
    ]
}
