//! A graph file, a scene and an edit, resolved into one graph.

use std::path::Path;

use super::{EditFile, edit, scene};
use crate::graph::{Diagnostic, GraphFile, Overlay, Registry, ResolvedGraph};

/// Reads a graph file, the scene folder and the edit file, and resolves them against the stages of
/// `registry`. Of a sequence, the first frame.
///
/// ```
/// use relight::{files, nodes};
///
/// let paths = ["graphs/find_lights_photo.ron", "tests/scenes/small", "edits/none.ron"];
/// let [graph, scene, edit] = paths.map(AsRef::as_ref);
/// let graph = files::load(graph, scene, edit, &nodes::registry()).expect("the files are sound");
/// assert_eq!(graph.outputs(), ["find.files"]);
/// ```
///
/// # Errors
/// All diagnostics of the first file that has any, each with file, line and column.
pub fn load(
    graph: &Path,
    scene: &Path,
    edit: &Path,
    registry: &Registry,
) -> Result<ResolvedGraph, Vec<Diagnostic>> {
    load_frame(graph, scene, edit, 0, registry)
}

/// Reads the same for frame `frame`, from 0, of an edit that is a sequence.
///
/// # Errors
/// Those of [`load`].
pub fn load_frame(
    graph: &Path,
    scene: &Path,
    edit: &Path,
    frame: u32,
    registry: &Registry,
) -> Result<ResolvedGraph, Vec<Diagnostic>> {
    let mut file = GraphFile::read(graph)?;
    file.accept_old_names(registry);
    let kinds: Vec<&str> = file.nodes().map(|node| node.kind).collect();
    let room = scene::read(scene, Some(&kinds))?;
    let change = edit::frame(&EditFile::read(edit)?, frame, Some(&room), Some(&kinds))?;
    let settings = room.settings.into_iter().chain(change.settings).collect();
    let members = room.members.into_iter().chain(change.members).collect();
    file.resolve(registry, &Overlay { settings, members })
}
