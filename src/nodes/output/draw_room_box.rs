//! `DrawRoomBox`: the cuboid of the room, drawn over the photo.

use std::sync::Arc;

use glam::Vec3;

use super::{draw_edges, side_color};
use crate::geometry::{Camera, RoomLayout, SIDES, SideSource};
use crate::graph::{Context, Node, NodeError};
use crate::image::{Picture, Plane, fit, resize, text_size, write_png, write_text};
use crate::nodes::artifacts::{Encoding, Files};
use crate::tuning::tuning;
use crate::{params, ports};

tuning! {
    /// Constants of the picture of a room's cuboid.
    pub const TUNING: DrawRoomBoxTuning {
        /// Factor on the radiance of the photo under the lines.
        dim: f32 = 0.6,
            unit "1", source Taste, effect "a larger value hides lines on bright surfaces";
        /// Width of the cuboid's edges.
        edge_width: f32 = 2.2,
            unit "pixels", source Taste, effect "a larger value hides more of the photo";
        /// Width of the cells' edges.
        cell_width: f32 = 1.0,
            unit "pixels", source Taste, effect "a larger value hides more of the photo";
    }
}

params! {
    /// Draws the edges of the room's cuboid and the cells of its hidden sides over the photo: seen
    /// sides are green, stated ones blue, guessed ones orange; a list has the distances.
    pub struct DrawRoomBox {
        /// Longer side of the picture, pixels; a smaller photo is not enlarged.
        long_side: u32 = 640, in 16..=4096,
    }
}

ports! {
    pub input DrawRoomBoxIn {
        /// The linear photo.
        photo: Arc<Picture>,
        /// Its camera.
        camera: Arc<Camera>,
        /// Its encoding, which the picture has as well.
        encoding: Arc<Encoding>,
        /// The cuboid of the room.
        layout: Arc<RoomLayout>,
    }
}

ports! {
    pub output DrawRoomBoxOut {
        /// `room.png`.
        files: Arc<Files>,
    }
}

impl Node for DrawRoomBox {
    const KIND: &'static str = "DrawRoomBox";
    const VERSION: u32 = 2;
    type In = DrawRoomBoxIn;
    type Out = DrawRoomBoxOut;

    fn run(&self, inputs: DrawRoomBoxIn, ctx: &Context) -> Result<DrawRoomBoxOut, NodeError> {
        let DrawRoomBoxIn { photo, camera, encoding, layout } = inputs;
        let (width, height) = photo.0.size();
        let (width, height) = fit(width, height, self.long_side as usize);
        // Lines stay visible on bright surfaces.
        let mut picture = resize(&photo.0, width, height).map(|c| TUNING.dim * c.min(Vec3::ONE));
        draw_edges(&mut picture, &layout, &camera.resized(width, height), true);
        legend(&mut picture, &layout);
        ctx.note(layout.summary());
        let bytes = write_png(&Picture(picture), encoding.transfer, false);
        Ok(DrawRoomBoxOut { files: Arc::new(Files(vec![("room.png".into(), bytes)])) })
    }
}

/// A line for each side in the lower left corner, in the color of its source; none in a picture of
/// which it would cover more than half of an edge.
fn legend(picture: &mut Plane<Vec3>, layout: &RoomLayout) {
    let (width, height) = picture.size();
    let scale = (width.max(height) / 640).max(1);
    let lines: Vec<(String, Vec3)> = (SIDES.iter().zip(layout.distances()).zip(layout.sides))
        .map(|((name, distance), source)| {
            let text = match source {
                SideSource::Open => format!("{name:7}       open   "),
                source => format!("{name:7} {distance:5.2} {:7}", source.name()),
            };
            (text, side_color(source))
        })
        .collect();
    let widest = lines.iter().map(|(text, _)| text_size(text, scale).0).max().unwrap_or(0);
    let (_, line_height) = text_size("", scale);
    if 2 * widest > width || 2 * lines.len() * line_height > height {
        return;
    }
    let top = height.saturating_sub(lines.len() * line_height);
    for (i, (text, color)) in lines.iter().enumerate() {
        write_text(picture, (0, top + i * line_height), text, *color, scale);
    }
}
