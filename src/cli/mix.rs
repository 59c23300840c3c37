//! `relight mix`: the layers of a finished run, weighted anew.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use relight::graph::{Context, Diagnostic, File, Node, NodeError};
use relight::nodes::output::mix_layers::{MixLayers, MixLayersIn};

use super::args::MixArgs;
use super::exit::{CliError, Exit};
use super::messages::message;
use super::provenance::{Provenance, stamped};
use super::write::{self, Output};

/// Runs `relight mix`.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn mix(args: &MixArgs, began: Instant) -> Result<Exit, CliError> {
    let mut weights = BTreeMap::new();
    for (id, weight) in &args.set {
        if weights.insert(id.clone(), *weight).is_some() {
            return Err(Diagnostic::file("--set".as_ref(), format!("`{id}` is set twice")).into());
        }
    }
    let layers = layers(&args.run)?;
    let (folder, only) = place(&args.out);
    let out = Output::new(&folder, [layers.location()], args.force)?;
    let is_png =
        only.as_ref().is_some_and(|name| Path::new(name).extension() == Some("png".as_ref()));
    let record = Provenance::read(&layers.location()).ok().map(|record| record.mixed(&weights));
    let stage = MixLayers { layers, weights, layered: !is_png, ..MixLayers::default() };
    stage.check().map_err(|message| Diagnostic::file("--set".as_ref(), message))?;
    // One stage that reads a file: there is nothing to schedule, and nothing worth keeping.
    let context = Context::default();
    let files = stage.run(MixLayersIn {}, &context).map_err(fault)?.files;
    // A picture.exr of an earlier version has no record.
    let named =
        stamped(record.as_ref(), &files.0).into_iter().filter_map(|(name, pieces)| match &only {
            None => Some((name, pieces)),
            Some(file) => (Path::new(&name).extension() == Path::new(file).extension())
                .then(|| (file.clone(), pieces)),
        });
    let paths = out.write_pieces(&named.collect::<Vec<_>>())?;
    context.warnings().iter().for_each(|warning| message!("warning: {warning}"));
    message!("mixed in {:.1} ms", 1e3 * began.elapsed().as_secs_f64());
    write::print_paths(&paths)?;
    Ok(Exit::Done)
}

/// The layers of a run: those of its folder, or a file, as for a frame of a sequence.
///
/// # Errors
/// The folder or file does not contain layers.
pub(super) fn layers(run: &Path) -> Result<File, Diagnostic> {
    let path = if run.is_dir() { run.join("picture.exr") } else { run.to_owned() };
    if !path.is_file() {
        let fault = Diagnostic::file(
            run,
            "wanted the folder that `relight run` wrote to, or an EXR file of it; the file does not exist",
        );
        return Err(fault.help(format!("{} is not there", path.display())));
    }
    Ok(File::new(path.to_string_lossy()))
}

/// The folder, and the name of the file where `--out` names one.
fn place(out: &Path) -> (PathBuf, Option<String>) {
    match out.extension().and_then(|e| e.to_str()) {
        Some("png" | "exr") if !out.is_dir() => {
            let folder = out
                .parent()
                .filter(|folder| !folder.as_os_str().is_empty())
                .unwrap_or(".".as_ref());
            let name = out.file_name().map(|name| name.to_string_lossy().into_owned());
            (folder.to_owned(), name)
        }
        _ => (out.to_owned(), None),
    }
}

/// The fault of a stage that ran without an engine.
pub(super) fn fault(error: NodeError) -> Diagnostic {
    match error {
        NodeError::BadFile { path, message } => Diagnostic::file(path.as_ref(), message),
        error => Diagnostic::file("".as_ref(), error.to_string()),
    }
}
