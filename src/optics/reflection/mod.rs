//! Specular reflection: the microfacet model, mirrors and edited finishes.

pub(in crate::optics) mod ggx;
pub(in crate::optics) mod mirror;
pub(in crate::optics) mod pane;
pub(in crate::optics) mod polish;
pub(in crate::optics) mod reflect;

pub use ggx::Ggx;
pub use mirror::{Around, Mirror, MirroredLight};
pub use pane::{PaneRay, PaneRays};
pub use polish::{NO_ROW, ReflectingPoints, SeenSurface, SpecularChange, SpecularPart, places};
pub use reflect::{
    RayEnd, ReflectedHit, ReflectionScene, Reflections, ShadingPoint, object_shading_point,
    reflections,
};

use crate::tuning::Table;

/// The constants of reflections.
pub fn tuning() -> Vec<Table> {
    vec![
        ggx::GgxTuning::table(),
        pane::PaneTuning::table(),
        polish::PolishTuning::table(),
        reflect::ReflectTuning::table(),
    ]
}
