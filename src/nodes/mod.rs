//! Lists of the stages and of their constants, in the order of the paper.

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

/// All stages, and the old names that graph files may use for one more version.
pub fn registry() -> Registry {
    with_old_names(stages())
}

fn stages() -> Registry {
    Registry::new()
        .with::<scene::read_scene::ReadScene>()
        .with::<scene::read_photo::ReadPhoto>()
        .with::<estimate::depth::Depth>()
        .with::<scene::mesh::Mesh>()
        .with::<scene::room_box::RoomBox>()
        .with::<scene::read_lights::ReadLights>()
        .with::<scene::read_materials::ReadMaterials>()
        .with::<estimate::find_lights::FindLights>()
        .with::<estimate::find_sun::FindSun>()
        .with::<estimate::retinex_materials::RetinexMaterials>()
        .with::<estimate::mnet::MNet>()
        .with::<estimate::onnx_materials::OnnxMaterials>()
        .with::<estimate::combine_albedo::CombineAlbedo>()
        .with::<estimate::vis_lamp_net::VisLampNet>()
        .with::<estimate::vis_win_net::VisWinNet>()
        .with::<estimate::inv_lamp_net::InvLampNet>()
        .with::<estimate::inv_win_net::InvWinNet>()
        .with::<estimate::init_lights::InitLights>()
        .with::<estimate::residual_shading::ResidualShading>()
        .with::<estimate::refine_lights::RefineLights>()
        .with::<estimate::fit_lights::FitLights>()
        .with::<estimate::lens_glare::LensGlare>()
        .with::<estimate::correct_shading::CorrectShading>()
        .with::<estimate::fill_reflectance::FillReflectance>()
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
        .with::<render::light_room::LightRoom>()
        .with::<render::draw_rooms::DrawRooms>()
        .with::<render::light_draws::LightDraws>()
        .with::<render::room_error::RoomError>()
        .with::<render::light_objects::LightObjects>()
        .with::<render::shade_objects::ShadeObjects>()
        .with::<render::occlude_residual::OccludeResidual>()
        .with::<render::insert_specular::InsertSpecular>()
        .with::<render::shade_specular_edit::ShadeSpecularEdit>()
        .with::<render::emitter_mask::EmitterMask>()
        .with::<render::trace_pane::TracePane>()
        .with::<output::draw_room_box::DrawRoomBox>()
        .with::<output::draw_scene::DrawScene>()
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

/// Old names of stages, ports and parameters, which files may use for one more version. Old values
/// of parameters are aliases in their types.
fn with_old_names(stages: Registry) -> Registry {
    let kinds = [
        ("Remains", "ResidualShading"),
        ("Paint", "FillReflectance"),
        ("OccludeRest", "OccludeResidual"),
        ("PaintSpecular", "ShadeSpecularEdit"),
        ("Glow", "EmitterMask"),
    ];
    let fields = [
        ("Depth", "normalisation", "normalization"),
        ("OnnxMaterials", "normalisation", "normalization"),
        ("InitLights", "worth", "min_gain"),
        ("InitLights", "ambient_cost", "ambient_weight"),
        ("InitLights", "turns", "iterations"),
        ("InitLights", "plates", "surfels"),
        ("InitLights", "outlook", "window_emission"),
        ("ResidualShading", "remainder", "residual"),
        ("RefineLights", "worth", "min_gain"),
        ("RefineLights", "places", "receivers"),
        ("RefineLights", "rest_cost", "ambient_weight"),
        ("RefineLights", "invisible_cost", "out_of_view_weight"),
        ("RefineLights", "sun_cost", "sun_weight"),
        ("FitLights", "turns", "iterations"),
        ("FitLights", "prior", "tikhonov_weight"),
        ("FitLights", "rest_cost", "ambient_weight"),
        ("FitLights", "invisible_cost", "out_of_view_weight"),
        ("FitLights", "sun_cost", "sun_weight"),
        ("FitLights", "rest", "residual"),
        ("FillReflectance", "rest", "residual"),
        ("FillReflectance", "paint", "reflectance"),
        ("FillReflectance", "zone", "glare_mask"),
        ("EditMaterials", "paint", "reflectance"),
        ("EditMaterials", "coats", "paint_layers"),
        ("EditMaterials", "finish", "specular_edit"),
        ("EditMaterials", "polished", "has_specular_edit"),
        ("Indirect", "remainder", "residual"),
        ("LightNet", "rest", "residual"),
        ("OccludeResidual", "rest", "residual"),
        ("ShadeSpecularEdit", "finish", "specular_edit"),
        ("ShadeSpecularEdit", "polish", "specular_change"),
        ("EmitterMask", "cover", "coverage"),
        ("Compose", "paint", "reflectance"),
        ("Compose", "coats", "paint_layers"),
        ("Compose", "rest", "residual"),
        ("Compose", "edited_rest", "edited_residual"),
        ("Compose", "zone", "glare_mask"),
        ("Compose", "cover", "coverage"),
        ("Compose", "object_rest", "object_residual"),
        ("Compose", "polish", "specular_change"),
        ("Write", "rest", "residual"),
        ("ScoreShading", "rest", "residual"),
        ("ScorePicture", "cover", "coverage"),
    ];
    let registry =
        kinds.into_iter().fold(stages, |registry, (old, new)| registry.renamed(old, new));
    fields
        .into_iter()
        .fold(registry, |registry, (kind, old, new)| registry.renamed_field(kind, old, new))
}

/// All constants that decide an algorithm: of the stages, then of the rooms that they use.
pub fn tuning() -> Vec<Table> {
    [
        scene::tuning(),
        estimate::tuning(),
        edit::tuning(),
        render::tuning(),
        output::tuning(),
        measure::tuning(),
        net::tuning(),
        optics::tuning(),
        geometry::tuning(),
        image::tuning(),
    ]
    .concat()
}
