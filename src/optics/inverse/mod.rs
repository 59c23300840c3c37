//! Inverse rendering: lights and albedos estimated from a photo. Nothing else in `optics` uses it.

pub(in crate::optics) mod candidate_search;
pub(in crate::optics) mod candidates;
pub(in crate::optics) mod chamfer;
pub(in crate::optics) mod conditioning;
pub(in crate::optics) mod find_lights;
pub(in crate::optics) mod fit_problem;
pub(in crate::optics) mod lens_glare;
pub(in crate::optics) mod light_prior;
pub(in crate::optics) mod mask_pixels;
pub(in crate::optics) mod observations;
pub(in crate::optics) mod parameters;
pub(in crate::optics) mod radiance_fit;
pub(in crate::optics) mod receivers;
pub(in crate::optics) mod shape_fit;
pub(in crate::optics) mod sun_cells;
pub(in crate::optics) mod sun_patches;
pub(in crate::optics) mod surfels;
pub(in crate::optics) mod visible_lamp;
pub(in crate::optics) mod visible_light;
pub(in crate::optics) mod visible_window;

pub use candidate_search::{Accepted, Candidate, CandidateSearch, CandidateSettings};
pub use candidates::{lamp_candidates, window_candidates};
pub use chamfer::{chamfer, surface_points};
pub use conditioning::Conditioning;
pub use find_lights::{FoundLight, LightSearch, find_lights, quantile};
pub use lens_glare::{GlareFit, GlareKernel, GlareSource, fit_glare};
pub use light_prior::{Column, LightPrior, Role};
pub use observations::{Observations, TUNING as OBSERVATIONS, observed_pixels};
pub use parameters::DegreesOfFreedom;
pub use radiance_fit::{RADIANCE_FIT, RadianceFit, fit_radiances};
pub use receivers::{LayerQuality, Receivers, SeenRoom, UnitLayer};
pub use shape_fit::{Bounds, LightVariable, ShapeFit, ShapeSearch, fit_shapes};
pub use sun_cells::SunlitRoom;
pub use sun_patches::{FoundSun, SunWindow, drawn_sun, find_sun};
pub use visible_lamp::{LampForm, LampForms};
pub use visible_light::visible_light;

use crate::tuning::Table;

/// The constants of inverse rendering.
pub fn tuning() -> Vec<Table> {
    vec![
        candidate_search::CandidateSearchTuning::table(),
        candidates::CandidatesTuning::table(),
        chamfer::ChamferTuning::table(),
        conditioning::ConditioningTuning::table(),
        find_lights::FindLightsTuning::table(),
        fit_problem::FitProblemTuning::table(),
        lens_glare::LensGlareTuning::table(),
        mask_pixels::MaskPixelsTuning::table(),
        observations::ObservationsTuning::table(),
        parameters::ParametersTuning::table(),
        radiance_fit::RadianceFitTuning::table(),
        receivers::ReceiversTuning::table(),
        shape_fit::ShapeFitTuning::table(),
        sun_cells::SunCellsTuning::table(),
        sun_patches::SunPatchesTuning::table(),
        surfels::SurfelsTuning::table(),
        visible_lamp::VisibleLampTuning::table(),
        visible_light::VisibleLightTuning::table(),
        visible_window::VisibleWindowTuning::table(),
    ]
}
