//! `relight report`: the page of a finished run.

use std::path::{Path, PathBuf};
use std::time::Instant;

use relight::graph::{Context, Diagnostic, File, Node};
use relight::nodes::output::write_report::{WriteReport, WriteReportIn};

use super::args::ReportArgs;
use super::exit::{CliError, Exit};
use super::messages::message;
use super::mix::{fault, layers};
use super::write::{self, Output};

/// Runs `relight report`.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn report(args: &ReportArgs, began: Instant) -> Result<Exit, CliError> {
    if !args.run.is_dir() {
        return Err(Diagnostic::file(
            &args.run,
            "wanted the folder that `relight run` wrote to, got none",
        )
        .into());
    }
    let path = page(&args.run, args.long_side)?;
    message!("written in {:.1} ms", 1e3 * began.elapsed().as_secs_f64());
    write::print_paths(&[path])?;
    Ok(Exit::Done)
}

/// Writes report.html into `folder`, which contains the files of a run.
///
/// # Errors
/// A file of the run cannot be read, or the page cannot be written.
pub(super) fn page(folder: &Path, long_side: u32) -> Result<PathBuf, Diagnostic> {
    let report = File::new(folder.join("report.json").to_string_lossy());
    let layers = layers(folder)?;
    let out = Output::new(folder, [report.location(), layers.location()], false)?;
    let stage = WriteReport { layers, report, long_side };
    stage.check().map_err(|message| Diagnostic::file("".as_ref(), message))?;
    let files = stage.run(WriteReportIn {}, &Context::default()).map_err(fault)?.files;
    Ok(out.write(&files.0)?.remove(0))
}
