//! From planes to files.

pub mod compose;
pub mod mix_layers;
pub mod write;
pub mod write_depth;
pub mod write_estimates;
pub mod write_picture;
pub mod write_planes;
pub mod write_report;
pub mod write_usd;

use glam::Vec3;

use crate::graph::{Context, File, NodeError};
use crate::image::{ExrFile, NamedBytes, Plane, Transfer, read_layers};
use crate::nodes::artifacts::{Encoding, REST, same_size};

/// The line of the comments of `picture.exr` with the encoding of `picture.png`.
fn encoding_line(encoding: &Encoding) -> String {
    let bits = if encoding.sixteen_bit { 16 } else { 8 };
    format!("{ENCODING}{:?}, {bits} bits", encoding.transfer)
}

const ENCODING: &str = "encoding: ";

/// The layers of a `picture.exr`.
struct SavedRun {
    encoding: Encoding,
    /// By name.
    lights: Vec<(String, Plane<Vec3>)>,
    /// The residual, which no light explains.
    rest: Plane<Vec3>,
    file: ExrFile,
}

/// Reads the `picture.exr` that `Write` wrote.
fn read_run(file: &File, ctx: &Context) -> Result<SavedRun, NodeError> {
    let path = file.location().display().to_string();
    let bad = |message: String| NodeError::BadFile { path: path.clone(), message };
    let bytes = ctx.read(file)?;
    let exr = read_layers(NamedBytes::new(&path, &bytes)).map_err(|e| bad(e.message()))?;
    let encoding = exr.comments().find_map(|line| {
        let (transfer, bits) = line.strip_prefix(ENCODING)?.rsplit_once(", ")?;
        let transfer: Transfer = ron::from_str(transfer).ok()?;
        let sixteen_bit = match bits {
            "8 bits" => false,
            "16 bits" => true,
            _ => return None,
        };
        Some(Encoding { transfer, lux: None, sixteen_bit })
    });
    let encoding = encoding.ok_or_else(|| {
        bad(format!(
            "comments: wanted a line `{ENCODING}Srgb, 8 bits`, as `relight run` writes it, got none"
        ))
    })?;
    let names = exr.channels().filter_map(|name| name.strip_prefix("light_")?.strip_suffix(".R"));
    let mut lights = Vec::new();
    for id in names {
        let layer = exr.rgb(&format!("light_{id}"));
        let layer = layer.ok_or_else(|| {
            bad(format!("light_{id}: wanted channels R, G and B, got some of them"))
        })?;
        lights.push((id.to_owned(), layer));
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
