//! Light: its sources, its sampling, its closed forms. Pure functions with their equations.

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

pub use daylight::{Daylight, Heading, Outlook, black_body, fit_outlook};
pub use emitter::{
    Emitter, Gradient, LOBES, Lamp, LightKind, LightSample, Lobe, Plate, Profile, ProfileTable, Radiance, Seen, Shape,
    Silhouette, Strategy, Window, escaping, flux, sphere_irradiance,
};
pub use nnls::nnls;
pub use reflection::{
    Around, Face, Ggx, Mirror, NO_ROW, NOTHING, Part, Places, Reflections, SeenPlaces, SpecularChange, Surround,
    UNSEEN, object_face, places, reflections,
};
pub use sampling::{Gaussian, Points2, polygon_irradiance};
pub use transport::{
    BATCHES, Bounces, Direct, INTERVAL, LightMaps, Lighting, LocalLobe, PHIS, Probed, Sampling, Shadow, ShadowQuality,
    TEXELS, THETAS, Transport, arriving, direct, estimate, indirect, indirect_at_receivers, local_frame, shadow,
    stream, trace_bounces,
};
