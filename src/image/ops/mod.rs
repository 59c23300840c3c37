//! Operations on planes: resampling, segmentation, filling, measures.

pub(in crate::image) mod alpha_matte;
pub(in crate::image) mod annotate;
mod cell_noise;
mod conjugate_gradients;
pub(in crate::image) mod connected_components;
pub(in crate::image) mod dark_noise;
pub(in crate::image) mod depth;
pub(in crate::image) mod dilate;
pub(in crate::image) mod distance;
pub(in crate::image) mod glare_mask;
pub(in crate::image) mod grain;
pub(in crate::image) mod graph_cut;
pub(in crate::image) mod guided_depth;
pub(in crate::image) mod inpaint;
mod lamp_light;
pub(in crate::image) mod measure;
pub(in crate::image) mod mix;
pub(in crate::image) mod pack;
pub(in crate::image) mod refine_mask;
pub(in crate::image) mod reflectance;
pub(in crate::image) mod relit_pixel;
pub(in crate::image) mod resample;
pub(in crate::image) mod segments;
pub(in crate::image) mod upsample;

pub use alpha_matte::alpha_matte;
pub use annotate::{annotate, clip_line, draw_line, text_size, write_text};
pub use connected_components::connected_components;
pub use dark_noise::DarkNoise;
pub use depth::{DEPTH_PLANE, inpaint_depth, is_hole, nearness, resize_depth};
pub use dilate::{dilate, geodesic_dilate};
pub use distance::distance;
pub use glare_mask::{GlareMask, LightMask, bright_level, weighted_hue};
pub use grain::Grain;
pub use graph_cut::graph_cut;
pub use guided_depth::guided_depth;
pub use inpaint::{inpaint, inpaint_surfaces};
pub use lamp_light::LampLight;
pub use measure::{
    PictureScore, SaturationScore, log_error, mean_error, normal_error, pairs,
    scale_invariant_error, score_picture, score_saturation, square_error,
};
pub use mix::weighted_sum;
pub use pack::{Packed, pack, pack_gray};
pub use refine_mask::refine_mask;
pub use reflectance::{REFLECTANCE, clip_level, glare_of, limited, ratio, reflected, smooth_step};
pub use relit_pixel::{
    GlarePixel, OwnPixel, PixelLight, SaturatedRegions, SurfacePixel, TUNING as RELIT_PIXEL, gain,
    relight_own, relight_physical, relight_ratio,
};
pub use resample::{Resized, fit, resize, same_aspect};
pub use segments::{Segments, Steps, retinex, segment};
pub use upsample::{PlaneBundle, Taps, Upsampler, neighbors};

use crate::tuning::Table;

/// The constants of operations on planes.
pub fn tuning() -> Vec<Table> {
    vec![
        alpha_matte::AlphaMatteTuning::table(),
        cell_noise::CellNoiseTuning::table(),
        dark_noise::DarkNoiseTuning::table(),
        depth::DepthPlaneTuning::table(),
        dilate::DilateTuning::table(),
        glare_mask::GlareMaskTuning::table(),
        grain::GrainTuning::table(),
        guided_depth::GuidedDepthTuning::table(),
        inpaint::InpaintTuning::table(),
        measure::SaturationScoreTuning::table(),
        refine_mask::RefineMaskTuning::table(),
        reflectance::ReflectanceTuning::table(),
        relit_pixel::RelitPixelTuning::table(),
        resample::ResampleTuning::table(),
        segments::SegmentsTuning::table(),
        upsample::UpsampleTuning::table(),
    ]
}
