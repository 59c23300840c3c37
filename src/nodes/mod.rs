//! The stages, in the order of the paper: the list, and nothing else.

pub mod artifacts;
pub mod edit;
pub mod estimate;
pub mod output;
pub mod render;
pub mod scene;

use crate::graph::Registry;

/// All stages.
pub fn registry() -> Registry {
    Registry::new()
        .with::<scene::read_scene::ReadScene>()
        .with::<scene::mesh::Mesh>()
        .with::<scene::read_lights::ReadLights>()
        .with::<scene::read_materials::ReadMaterials>()
        .with::<estimate::find_lights::FindLights>()
        .with::<estimate::retinex_materials::RetinexMaterials>()
        .with::<estimate::init_lights::InitLights>()
        .with::<estimate::fit_lights::FitLights>()
        .with::<estimate::paint::Paint>()
        .with::<edit::edit_lights::EditLights>()
        .with::<render::direct::Direct>()
        .with::<render::shadow::Shadow>()
        .with::<render::transport::Transport>()
        .with::<render::trace_indirect::TraceIndirect>()
        .with::<render::mix::Mix>()
        .with::<render::glow::Glow>()
        .with::<output::compose::Compose>()
        .with::<output::write::Write>()
        .with::<output::write_planes::WritePlanes>()
        .with::<output::write_estimates::WriteEstimates>()
}
