//! Stages that estimate materials and lights from the photo and the seen room.

pub mod combine_albedo;
pub mod correct_shading;
pub mod depth;
pub mod fill_reflectance;
pub mod find_lights;
pub mod find_sun;
pub mod fit_lights;
pub mod init_lights;
pub mod inv_lamp_net;
pub mod inv_win_net;
pub mod lens_glare;
pub mod mnet;
pub mod onnx_materials;
pub mod refine_lights;
pub mod residual_shading;
pub mod retinex_materials;
pub mod vis_lamp_net;
pub mod vis_win_net;

use crate::tuning::{Table, tuning};

tuning! {
    /// Constants that several estimating stages share.
    pub const TUNING: EstimateTuning {
        /// Condition number of a fit above which its two most correlated unknowns are reported.
        confused_condition: f64 = 1e4,
            unit "1", source Derived("the two then differ by less than 2 % of the photo, the accuracy of a room's model"),
            effect "a larger value reports fewer pairs; no estimate changes";
        /// Least estimated albedo.
        min_albedo: f32 = 0.02,
            unit "albedo", source Taste, effect "a smaller value lets dark surfaces take very bright shading";
        /// Greatest estimated albedo.
        max_albedo: f32 = 0.95,
            unit "albedo", source Taste, effect "a larger value lets indirect light converge more slowly";
    }
}

/// The constants of the estimating stages.
pub fn tuning() -> Vec<Table> {
    vec![
        EstimateTuning::table(),
        correct_shading::CorrectShadingTuning::table(),
        depth::DepthTuning::table(),
        fill_reflectance::FillReflectanceTuning::table(),
        fill_reflectance::ExemplarTuning::table(),
        init_lights::InitLightsTuning::table(),
        lens_glare::LensGlareStageTuning::table(),
        residual_shading::ResidualShadingTuning::table(),
        refine_lights::RefineLightsTuning::table(),
        fit_lights::FitLightsTuning::table(),
    ]
}
