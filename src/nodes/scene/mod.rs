//! From files to the seen room, and what is known of it.

pub mod mesh;
pub mod read_lights;
pub mod read_materials;
pub mod read_scene;

use crate::graph::{Context, File, NodeError};
use crate::image::{ReadError, Source};

/// A picture file through one of the readers of `image`.
fn open<T>(ctx: &Context, file: &File, read: impl FnOnce(Source) -> Result<T, ReadError>) -> Result<T, NodeError> {
    let bytes = ctx.read(file)?;
    let name = file.location().display().to_string();
    read(Source::new(&name, &bytes)).map_err(|e| bad(file, e.message()))
}

fn bad(file: &File, message: String) -> NodeError {
    NodeError::BadFile { path: file.location().display().to_string(), message }
}

fn warn(ctx: &Context, file: &File, warnings: &[String]) {
    warnings.iter().for_each(|warning| ctx.warn(format!("{}: {warning}", file.path)));
}

fn size((width, height): (usize, usize)) -> String {
    format!("{width} x {height}")
}
