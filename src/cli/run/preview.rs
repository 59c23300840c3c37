//! Pictures at working size, which come before those at the photo's size.

use std::time::Instant;

use relight::files::edit::changes_lights_alone;
use relight::graph::{Diagnostic, GraphFile, Source};

use crate::cli::args::RunArgs;
use crate::cli::engine::Host;
use crate::cli::load::load_text;
use crate::cli::messages::message;
use crate::cli::results::results;
use crate::cli::write::Output;

const FILE: &str = "preview.png";

/// Writes `preview.png`, the picture at working size. An edit of surfaces or objects has none, as
/// its pixels are those of the photo. What it computes besides layers serves the run at the photo's
/// size.
///
/// # Errors
/// Files that cannot be used. Failures of stages are left to the run itself.
pub fn preview(args: &RunArgs, host: &Host, began: Instant) -> Result<(), Vec<Diagnostic>> {
    let source = match &args.edit {
        Some(path) => Source::read(path, args.files.reach()).map_err(|fault| vec![fault])?,
        None => Source::new("", "Edit(version: 1)"),
    };
    if !changes_lights_alone(&source) {
        message!("no preview: the edit changes surfaces or objects");
        return Ok(());
    }
    let graph = load_text(&args.graph, &source, &args.files, shrink)?;
    let Some(writer) = graph.of_kind("WritePicture").next().map(str::to_owned) else {
        message!("no preview: the graph has no stage WritePicture");
        return Ok(());
    };
    let wanted = graph.wanted(Some(&[writer])).map_err(|fault| vec![fault])?;
    let out = Output::of_graph(&args.out, &graph, args.edit.as_deref(), args.force);
    let out = out.map_err(|fault| vec![fault])?;
    let run = host.engine.run(&graph, &wanted, &host.cancel, &());
    for (_, files) in results(&run).iter().filter(|_| run.is_complete()) {
        for (_, bytes) in &files.0 {
            let path = out.file(FILE, bytes).map_err(|fault| vec![fault])?;
            message!("{} in {:.2} s", path.display(), began.elapsed().as_secs_f64());
        }
    }
    Ok(())
}

/// Stages that work on the photo at its own size for lights.
const FULL_SIZE: [&str; 4] = ["Compose", "FillReflectance", "EmitterMask", "Write"];
/// Outputs of `ReadScene` at the photo's size, and those at working size.
const SIZES: [(&str, &str); 5] = [
    ("photo", "small"),
    ("clipped", "small_clipped"),
    ("camera", "small_camera"),
    ("full_depth", "depth"),
    ("full_mask", "mask"),
];

/// Wires a graph so that it makes its layers at working size: for a light that a person moves,
/// whose picture at the photo's size comes too late. Estimates stay as they are, and so do the
/// stages that read pixels of the photo from an edit.
pub fn shrink(graph: &mut GraphFile) {
    let of_kind = |kind: &str| -> Vec<String> {
        let nodes = graph.nodes().filter(|node| node.kind == kind);
        nodes.map(|node| node.name.to_owned()).collect()
    };
    let (readers, objects) = (of_kind("ReadScene"), of_kind("EditObjects"));
    let Some(reader) = readers.first() else { return };
    for (full, small) in SIZES {
        let [full, small] = [full, small].map(|port| format!("{reader}.{port}"));
        graph.redirect_in(Some(&FULL_SIZE), &full, &small);
    }
    for node in objects {
        graph.redirect_in(
            Some(&["EmitterMask"]),
            &format!("{node}.depth"),
            &format!("{reader}.depth"),
        );
    }
}
