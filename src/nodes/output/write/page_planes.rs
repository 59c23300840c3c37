//! The planes of a picture that a page in a browser shows over it: those of `Write`'s diagnostics
//! that a person looks at, packed at working size.

use super::{Diagnostic, NodeError, Plane, SavedRoom, WriteIn, diagnostics, saved_room};
use crate::image::{Packed, pack, pack_gray};

/// Diagnostics that no overlay of a page shows.
const HIDDEN: [&str; 4] = ["direct_", "indirect_", "glare_", "spec"];

/// A plane for an overlay.
pub struct PagePlane {
    /// Name of the plane in `picture.exr`, without its channel: `shadow_lamp_0`.
    pub name: String,
    /// Columns and rows.
    pub size: (usize, usize),
    /// 3 for colors and directions, else 1.
    pub channels: usize,
    /// The numbers.
    pub packed: Packed,
    /// The number that an overlay shows as white.
    pub white: f32,
}

/// The planes of a picture.
pub struct PagePlanes {
    /// In the order of `picture.exr`.
    pub planes: Vec<PagePlane>,
    /// The room's cuboid; `None` where the graph estimates none.
    pub room: Option<SavedRoom>,
}

impl PagePlanes {
    /// Packs the planes of the inputs of a `Write` stage at a level of zlib.
    ///
    /// # Errors
    /// The layers of a light do not fit each other.
    pub fn new(inputs: &WriteIn, level: u32) -> Result<PagePlanes, NodeError> {
        let mut planes = Vec::new();
        diagnostics(inputs, |name, plane| {
            if HIDDEN.iter().any(|hidden| name.starts_with(hidden)) {
                return;
            }
            let (size, channels, packed, white) = match plane {
                Diagnostic::Color(plane) | Diagnostic::Direction(plane) => {
                    (plane.size(), 3, pack(plane, level), 1.0)
                }
                Diagnostic::Share(plane) => (plane.size(), 1, pack_gray(plane, level), 1.0),
                Diagnostic::Number(plane) => {
                    (plane.size(), 1, pack_gray(plane, level), white(plane))
                }
                Diagnostic::Depth(depth) => {
                    (depth.0.size(), 1, pack_gray(&depth.0, level), white(&depth.0))
                }
            };
            planes.push(PagePlane { name: name.to_owned(), size, channels, packed, white });
        })?;
        let room = inputs.layout.as_ref().zip(inputs.camera.as_ref());
        let room = room.map(|(layout, camera)| saved_room(layout, camera));
        Ok(PagePlanes { planes, room })
    }
}

fn white(plane: &Plane<f32>) -> f32 {
    let mut sorted = plane.pixels().to_vec();
    sorted.sort_by(f32::total_cmp);
    // A few pixels at edges err far more than all others.
    let at = sorted.len().saturating_sub(1) * 199 / 200;
    sorted.get(at).copied().unwrap_or(1.0).max(f32::MIN_POSITIVE)
}
