//! Inverse rendering: lights and albedos estimated from a photo. Nothing else in `optics` uses it.

pub(in crate::optics) mod candidates;
pub(in crate::optics) mod chamfer;
pub(in crate::optics) mod conditioning;
pub(in crate::optics) mod find_lights;
pub(in crate::optics) mod observations;
pub(in crate::optics) mod parameters;
pub(in crate::optics) mod radiance_fit;
pub(in crate::optics) mod receivers;
pub(in crate::optics) mod shape_fit;
pub(in crate::optics) mod surfels;
pub(in crate::optics) mod visible_lamp;

pub use candidates::{RoomBox, lamp_candidates, visible_light, window_candidates};
pub use chamfer::{SURFACE_POINTS, chamfer, surface_points};
pub use conditioning::Conditioning;
pub use find_lights::{FoundLight, LightSearch, find_lights};
pub use observations::{Evidence, evidence_pixels};
pub use parameters::Freedom;
pub use radiance_fit::{Column, MOST_LIGHTS, RadianceFit, fit_radiances};
pub use receivers::{LayerQuality, Receivers, SeenRoom, UnitLayer};
pub use shape_fit::{Bounds, Movable, ShapeFit, ShapeSearch, fit_shapes};
pub use visible_lamp::{LampForm, LampForms};
