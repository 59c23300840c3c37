//! Light: its sources, its sampling, its closed forms. Pure functions with their equations.

mod light;

pub use light::{Lamp, LightKind, Lobe, Plate, Radiance, Shape, Window};
