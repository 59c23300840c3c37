//! The seen room: depth to points, normals and mesh.

pub(in crate::geometry) mod cell_grid;
pub(in crate::geometry) mod close_region;
pub(in crate::geometry) mod draw_layout;
pub(in crate::geometry) mod find_layout;
pub(in crate::geometry) mod gravity;
pub(in crate::geometry) mod grow_region;
pub(in crate::geometry) mod layout_lines;
pub(in crate::geometry) mod mesh;
pub(in crate::geometry) mod metric_scale;
pub(in crate::geometry) mod orient_normals;
pub(in crate::geometry) mod plane_fit;
pub(in crate::geometry) mod room_layout;
pub(in crate::geometry) mod surface;

pub use cell_grid::{CellGrid, MAX_CELLS};
pub use draw_layout::LayoutDraw;
pub use find_layout::{KnownSide, LayoutGuess, limit_areas};
pub use gravity::world_up;
pub use grow_region::grow_region;
pub use layout_lines::LayoutLine;
pub use mesh::{Hit, Own, SceneMesh, Sight};
pub use metric_scale::{KnownLength, MetricDepth, metric_depth, relative_depth};
pub use orient_normals::orient_normals;
pub use plane_fit::PlaneFit;
pub use room_layout::{RoomCell, RoomLayout, SIDES, SideSource};
pub use surface::{Surface, surface};

use crate::tuning::Table;

/// The constants of the seen surface.
pub fn tuning() -> Vec<Table> {
    vec![
        close_region::CloseRegionTuning::table(),
        draw_layout::DrawLayoutTuning::table(),
        find_layout::FindLayoutTuning::table(),
        gravity::GravityTuning::table(),
        grow_region::GrowRegionTuning::table(),
        layout_lines::LayoutLinesTuning::table(),
        mesh::MeshTuning::table(),
        metric_scale::MetricScaleTuning::table(),
        plane_fit::PlaneFitTuning::table(),
        room_layout::RoomLayoutTuning::table(),
        surface::SurfaceTuning::table(),
    ]
}
