//! From planes to files.

pub mod compose;
pub mod draw_room_box;
pub mod draw_scene;
pub mod mix_layers;
pub mod write;
pub mod write_depth;
pub mod write_estimates;
pub mod write_picture;
pub mod write_planes;
pub mod write_report;
pub mod write_usd;

use std::sync::Arc;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};

use crate::geometry::{Camera, LayoutLine, MAX_CELLS, RoomLayout, SideSource};
use crate::graph::{Context, File, NodeError};
use crate::image::{
    ExrFile, Layer, NamedBytes, Plane, Transfer, carried_exif, clip_line, draw_line, read_channels,
};
use crate::nodes::artifacts::{Encoding, REST, same_size};
use crate::tuning::Table;

/// The constants of pictures for people.
pub fn tuning() -> Vec<Table> {
    vec![
        compose::DrawnGlareTuning::table(),
        compose::LampSurfaceTuning::table(),
        draw_room_box::DrawRoomBoxTuning::table(),
        draw_scene::DrawSceneTuning::table(),
    ]
}

/// Draws the edges of the cuboid in the colors of their sources, and those of its cells where
/// `cells` is set. `camera` has the picture's size.
fn draw_edges(picture: &mut Plane<Vec3>, layout: &RoomLayout, camera: &Camera, cells: bool) {
    for line in layout.lines(camera).iter().filter(|line| cells || line.is_edge) {
        let width = if line.is_edge {
            draw_room_box::TUNING.edge_width
        } else {
            draw_room_box::TUNING.cell_width
        };
        draw_line(picture, line.from, line.to, side_color(line.source), width);
    }
}

/// The color of a side by its source, linear.
fn side_color(source: SideSource) -> Vec3 {
    match source {
        SideSource::Seen => Vec3::new(0.05, 0.9, 0.15),
        SideSource::Given => Vec3::new(0.1, 0.5, 1.0),
        SideSource::Guessed => Vec3::new(1.0, 0.3, 0.0),
        SideSource::Open => Vec3::splat(0.5),
    }
}

/// The lines of the comments of `picture.exr` with the encoding of `picture.png` and its EXIF
/// block.
fn encoding_lines(encoding: &Encoding) -> Vec<String> {
    let bits = if encoding.sixteen_bit { 16 } else { 8 };
    let mut lines = vec![format!("{ENCODING}{:?}, {bits} bits", encoding.transfer)];
    if !encoding.exif.is_empty() {
        lines.push(format!("{EXIF}{}", STANDARD.encode(&encoding.exif)));
    }
    lines
}

const ENCODING: &str = "encoding: ";
const EXIF: &str = "exif: ";

/// The lines of a room's cuboid in the photo, a line of JSON in the comments of `picture.exr`.
#[derive(Clone, Serialize, Deserialize)]
pub struct SavedRoom {
    /// The sides with distance and source.
    summary: String,
    /// Source of the side, whether it is an edge of the cuboid, and both ends as fractions of the
    /// picture's width and height, from its upper left corner: x, y, x, y.
    lines: Vec<(SideSource, bool, [f32; 4])>,
}

const ROOM: &str = "room: ";
/// Lines of more cells than any cuboid has are not read.
const MAX_LINES: usize = 2 * 6 * (MAX_CELLS + 1) * (MAX_CELLS + 1);

/// The lines of the cuboid within the picture.
fn saved_room(layout: &RoomLayout, camera: &Camera) -> SavedRoom {
    let size = Vec2::new(camera.width as f32, camera.height as f32);
    let rounded = |v: f32| (v.clamp(-10.0, 10.0) * 1e4).round() / 1e4;
    let line = |line: LayoutLine| {
        let (from, to) = clip_line(line.from, line.to, size, 0.0)?;
        let (from, to) = (from / size, to / size);
        let ends = [from.x, from.y, to.x, to.y].map(rounded);
        Some((line.source, line.is_edge, ends))
    };
    let lines = layout.lines(camera).into_iter().filter_map(line).collect();
    SavedRoom { summary: layout.summary(), lines }
}

/// The line of the comments of `picture.exr` with the room's cuboid.
fn room_line(layout: &RoomLayout, camera: &Camera) -> String {
    let room = saved_room(layout, camera);
    format!("{ROOM}{}", serde_json::to_string(&room).expect("finite numbers and text are JSON"))
}

/// The room's cuboid in the comments of a `picture.exr`, if a run of this version wrote it there.
fn read_room(exr: &ExrFile) -> Option<SavedRoom> {
    let room: SavedRoom =
        exr.comments().find_map(|line| serde_json::from_str(line.strip_prefix(ROOM)?).ok())?;
    let is_sound = room.lines.len() <= MAX_LINES
        && room.lines.iter().all(|(_, _, ends)| ends.iter().all(|v| v.abs() <= 10.0));
    is_sound.then_some(room)
}

/// The layers of a `picture.exr`.
struct SavedRun {
    encoding: Encoding,
    /// By name.
    lights: Vec<(String, Arc<Layer>)>,
    /// The residual, which no light explains.
    rest: Arc<Layer>,
    /// The other channels that were read.
    file: ExrFile,
}

/// Reads the `picture.exr` that `Write` wrote: the layers of its lights, and the other channels
/// that are `wanted`.
fn read_run(
    file: &File,
    ctx: &Context,
    wanted: impl Fn(&str) -> bool,
) -> Result<SavedRun, NodeError> {
    let path = file.location().display().to_string();
    let bad = |message: String| NodeError::BadFile { path: path.clone(), message };
    let bytes = ctx.read(file)?;
    let is_wanted = |name: &str| name.starts_with("light_") || wanted(name);
    let source = NamedBytes::new(&path, &bytes);
    let mut exr = read_channels(source, is_wanted).map_err(|e| bad(e.message()))?;
    let encoding = exr.comments().find_map(|line| {
        let (transfer, bits) = line.strip_prefix(ENCODING)?.rsplit_once(", ")?;
        let transfer: Transfer = ron::from_str(transfer).ok()?;
        let sixteen_bit = match bits {
            "8 bits" => false,
            "16 bits" => true,
            _ => return None,
        };
        Some(Encoding { transfer, lux: None, sixteen_bit, exif: Vec::new() })
    });
    let mut encoding = encoding.ok_or_else(|| {
        bad(format!(
            "comments: wanted a line `{ENCODING}Srgb, 8 bits`, as `relight run` writes it, got none"
        ))
    })?;
    // The file may be of a stranger: its block passes the same filter as a photo's.
    let block = exr.comments().find_map(|line| STANDARD.decode(line.strip_prefix(EXIF)?).ok());
    encoding.exif = block.map_or_else(Vec::new, |block| carried_exif(block, false));
    let names = exr.channels().filter_map(|name| name.strip_prefix("light_")?.strip_suffix(".R"));
    let names: Vec<String> = names.map(str::to_owned).collect();
    let mut lights = Vec::new();
    for id in names {
        let layer = exr.take_layer(&format!("light_{id}"));
        let layer = layer.ok_or_else(|| {
            bad(format!("light_{id}: wanted channels R, G and B, got some of them"))
        })?;
        lights.push((id, Arc::new(layer)));
    }
    let at = lights.iter().position(|(id, _)| id == REST);
    let at = at.ok_or_else(|| {
        bad(format!("layers: wanted light_{REST} and one layer per light, got none of that name"))
    })?;
    let (_, rest) = lights.remove(at);
    if let Some((id, layer)) = lights.iter().find(|(_, layer)| layer.size() != rest.size()) {
        return Err(bad(format!(
            "light_{id}: wanted {:?} pixels, got {:?}",
            rest.size(),
            layer.size()
        )));
    }
    Ok(SavedRun { encoding, lights, rest, file: exr })
}
