//! Light: its sources, its sampling, its closed forms. Pure functions with their equations.
//!
//! The rooms are layered: sampling < emitter < daylight < transport < reflection < inverse. A room
//! uses only those below it; `tests/architecture.rs` checks that.

mod daylight;
mod emitter;
#[cfg(test)]
mod extremes;
pub mod inverse;
mod nnls;
mod reflection;
#[cfg(test)]
mod rows;
mod sampling;
mod transport;

pub use daylight::{Daylight, Heading, WindowModel, black_body, fit_window_model};
pub use emitter::{
    BoxLamp, Emitter, EmitterSampler, Gradient, LOBES, Lamp, LightKind, LightSample, MeshLamp,
    PhotometricLamp, PhotometricWeb, PhotometricWebTable, Radiance, RectLamp, Shape, Silhouette,
    SphereLamp, Strategy, Surfel, Window,
};
pub use nnls::nnls;
pub use reflection::{
    Around, Ggx, Mirror, MirroredLight, NO_ROW, PaneRay, PaneRays, RayEnd, ReflectedHit,
    ReflectingPoints, ReflectionScene, Reflections, SeenSurface, ShadingPoint, SpecularChange,
    SpecularPart, object_shading_point, places, reflections,
};
pub use sampling::{Gaussian, Lobe, Points2, polygon_irradiance, sphere_irradiance};
pub use transport::{
    BATCHES, Bounces, DirectEstimate, DrawDifferences, DrawSettings, DrawnLight, DrawnRoom,
    GuessDraw, INTERVAL, LightMaps, LightTransport, Lighting, LocalLobe, PHIS, Probed,
    RayFractions, RoomDraws, Sampling, ShadowEstimate, ShadowQuality, TEXELS, THETAS, arriving,
    arriving_at_cells, direct, estimate, indirect, indirect_at_receivers, local_frame, shadow,
    stream, trace_bounces,
};

use crate::tuning::Table;

/// The constants that decide how light is sampled, transported and estimated.
pub fn tuning() -> Vec<Table> {
    [
        sampling::tuning(),
        emitter::tuning(),
        daylight::tuning(),
        transport::tuning(),
        reflection::tuning(),
        inverse::tuning(),
        vec![nnls::NnlsTuning::table()],
    ]
    .concat()
}
