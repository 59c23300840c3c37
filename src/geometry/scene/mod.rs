//! The seen room: depth to points, normals and mesh.

pub(in crate::geometry) mod cell_grid;
pub(in crate::geometry) mod close_region;
pub(in crate::geometry) mod crease;
pub(in crate::geometry) mod draw_layout;
pub(in crate::geometry) mod faint_edges;
pub(in crate::geometry) mod find_layout;
pub(in crate::geometry) mod gravity;
pub(in crate::geometry) mod grow_region;
pub(in crate::geometry) mod height_scale;
pub(in crate::geometry) mod join_by_photo;
pub(in crate::geometry) mod large_planes;
pub(in crate::geometry) mod layout_lines;
pub(in crate::geometry) mod level_sides;
pub(in crate::geometry) mod mesh;
pub(in crate::geometry) mod metric_scale;
pub(in crate::geometry) mod orient_normals;
pub(in crate::geometry) mod padding;
pub(in crate::geometry) mod photo_edges;
pub(in crate::geometry) mod plane_fit;
pub(in crate::geometry) mod plausibility;
pub(in crate::geometry) mod right_angles;
pub(in crate::geometry) mod room_layout;
pub(in crate::geometry) mod surface;
pub(in crate::geometry) mod upright_edges;

pub use cell_grid::{CellGrid, MAX_CELLS};
pub use crease::Creases;
pub use draw_layout::LayoutDraw;
pub use find_layout::{KnownSide, LayoutGuess, limit_areas};
pub use gravity::world_up;
pub use grow_region::grow_region;
pub use height_scale::{KnownHeight, RelativeScale, relative_from_height, scale_from_height};
pub use large_planes::flatten_planes;
pub use layout_lines::LayoutLine;
pub use level_sides::{LevelSides, level_sides};
pub use mesh::{Hit, Own, SceneMesh, Sight};
pub use metric_scale::{KnownLength, MetricDepth, metric_depth, relative_depth};
pub use orient_normals::orient_normals;
pub use plane_fit::PlaneFit;
pub use plausibility::{Doubt, SeenRoom, doubts};
pub use room_layout::{RoomCell, RoomLayout, SIDES, SideSource};
pub use surface::{Surface, surface};

use crate::tuning::Table;

/// The constants of the seen surface.
pub fn tuning() -> Vec<Table> {
    vec![
        close_region::CloseRegionTuning::table(),
        crease::CreaseTuning::table(),
        draw_layout::DrawLayoutTuning::table(),
        faint_edges::FaintEdgesTuning::table(),
        find_layout::FindLayoutTuning::table(),
        gravity::GravityTuning::table(),
        grow_region::GrowRegionTuning::table(),
        height_scale::HeightScaleTuning::table(),
        join_by_photo::JoinByPhotoTuning::table(),
        large_planes::LargePlanesTuning::table(),
        layout_lines::LayoutLinesTuning::table(),
        level_sides::LevelSidesTuning::table(),
        mesh::MeshTuning::table(),
        metric_scale::MetricScaleTuning::table(),
        padding::PaddingTuning::table(),
        photo_edges::PhotoEdgesTuning::table(),
        plane_fit::PlaneFitTuning::table(),
        plausibility::PlausibilityTuning::table(),
        right_angles::RightAnglesTuning::table(),
        room_layout::RoomLayoutTuning::table(),
        surface::SurfaceTuning::table(),
        upright_edges::UprightEdgesTuning::table(),
    ]
}
