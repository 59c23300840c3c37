//! The stages and their constants, in the order of the paper: the lists, and nothing else.

pub mod artifacts;
pub mod edit;
pub mod estimate;
pub mod measure;
mod neural;
pub mod output;
pub mod render;
pub mod scene;

use crate::graph::Registry;
use crate::tuning::Table;
use crate::{geometry, image, net, optics};

/// All stages.
pub fn registry() -> Registry {
    Registry::new()
        .with::<scene::read_scene::ReadScene>()
        .with::<scene::read_photo::ReadPhoto>()
        .with::<estimate::depth::Depth>()
        .with::<scene::mesh::Mesh>()
        .with::<scene::read_lights::ReadLights>()
        .with::<scene::read_materials::ReadMaterials>()
        .with::<estimate::find_lights::FindLights>()
        .with::<estimate::retinex_materials::RetinexMaterials>()
        .with::<estimate::mnet::MNet>()
        .with::<estimate::onnx_materials::OnnxMaterials>()
        .with::<estimate::vis_lamp_net::VisLampNet>()
        .with::<estimate::vis_win_net::VisWinNet>()
        .with::<estimate::inv_lamp_net::InvLampNet>()
        .with::<estimate::inv_win_net::InvWinNet>()
        .with::<estimate::init_lights::InitLights>()
        .with::<estimate::remains::Remains>()
        .with::<estimate::refine_lights::RefineLights>()
        .with::<estimate::fit_lights::FitLights>()
        .with::<estimate::paint::Paint>()
        .with::<edit::edit_lights::EditLights>()
        .with::<edit::edit_materials::EditMaterials>()
        .with::<edit::edit_objects::EditObjects>()
        .with::<render::direct::Direct>()
        .with::<render::shadow::Shadow>()
        .with::<render::shadow_net::ShadowNet>()
        .with::<render::transport::Transport>()
        .with::<render::trace_indirect::TraceIndirect>()
        .with::<render::indirect::Indirect>()
        .with::<render::light_net::LightNet>()
        .with::<render::mix::Mix>()
        .with::<render::light_objects::LightObjects>()
        .with::<render::shade_objects::ShadeObjects>()
        .with::<render::occlude_residual::OccludeResidual>()
        .with::<render::insert_specular::InsertSpecular>()
        .with::<render::shade_specular_edit::ShadeSpecularEdit>()
        .with::<render::emitter_mask::EmitterMask>()
        .with::<output::compose::Compose>()
        .with::<output::write::Write>()
        .with::<output::mix_layers::MixLayers>()
        .with::<output::write_picture::WritePicture>()
        .with::<output::write_depth::WriteDepth>()
        .with::<output::write_planes::WritePlanes>()
        .with::<output::write_estimates::WriteEstimates>()
        .with::<output::write_report::WriteReport>()
        .with::<output::write_usd::WriteUsd>()
        .with::<measure::read_pictures::ReadPictures>()
        .with::<measure::score_lights::ScoreLights>()
        .with::<measure::score_direct::ScoreDirect>()
        .with::<measure::score_shading::ScoreShading>()
        .with::<measure::score_lighting::ScoreLighting>()
        .with::<measure::score_materials::ScoreMaterials>()
        .with::<measure::score_picture::ScorePicture>()
}

/// All constants that decide an algorithm: of the stages, then of the rooms that they use.
pub fn tuning() -> Vec<Table> {
    [
        scene::tuning(),
        estimate::tuning(),
        edit::tuning(),
        render::tuning(),
        measure::tuning(),
        net::tuning(),
        optics::tuning(),
        geometry::tuning(),
        image::tuning(),
    ]
    .concat()
}
