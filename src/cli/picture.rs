//! `relight run` of an edit without `frames`: one picture.

use std::path::PathBuf;
use std::time::Instant;

use relight::graph::{Cancel, Diagnostic, ResolvedGraph, RunReport};

use super::args::{LONG_SIDE, RunArgs};
use super::engine::{engine, report_errors, stop_on_ctrl_c};
use super::exit::{CliError, Exit};
use super::messages::{error, message, shows_progress};
use super::progress::Progress;
use super::results::{backend_of, engine_options, output, results};
use super::write::Output;
use super::{page, report, write};

/// Runs or verifies `graph`, writes its files and shows the report.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn run(
    args: &RunArgs,
    graph: ResolvedGraph,
    verbose: u8,
    began: Instant,
) -> Result<Exit, CliError> {
    let wanted = graph.wanted(args.only.as_ref().map(std::slice::from_ref))?;
    let engine = engine(engine_options(args)?)?;
    let out = output(args, &graph)?; // fails before the work, not after it
    let cancel = Cancel::default();
    stop_on_ctrl_c(&cancel)?;
    let progress = Progress::new(verbose > 0, shows_progress());
    let (done, differences) = if args.verify {
        let verified = engine.verify(&graph, &wanted, &cancel, &progress);
        (verified.run, verified.differences)
    } else {
        (engine.run(&graph, &wanted, &cancel, &progress), Vec::new())
    };
    progress.end();

    let choice = backend_of(args, &done)?;
    let backend = choice.as_ref().map(|choice| choice.backend.to_string());
    let edit = args.edit.as_deref();
    let head = report::Head::new(&args.graph, edit, began, backend, engine.threads());
    let warnings = report::warnings(&done);
    let json = report::json(&head, &graph, &done, &warnings);
    let paths = match &out {
        Some(out) if done.is_complete() => write_all(args, out, &done, &json)?,
        _ => Vec::new(),
    };

    if verbose > 0 {
        message!("{}", report::table(&done).trim_end());
        if let Some(choice) = &choice {
            message!("networks by {}: {}", choice.backend, choice.why);
        }
    }
    warnings.iter().for_each(|warning| message!("warning: {warning}"));
    report::notes_of_outputs(&done).for_each(|note| message!("{note}"));
    report_errors(&done);
    for difference in &differences {
        error!("{}.{}: computed again, the result differs", difference.node, difference.port);
    }
    message!("{}", report::summary(&done, head.seconds));
    if !done.is_complete() && args.out.join("report.json").exists() {
        message!("nothing is written: the files in {} are of an earlier run", args.out.display());
    }
    if args.json {
        write::print(&json)?;
    } else {
        write::print_paths(&paths)?;
    }
    Ok(Exit::of(&done).and(differences.is_empty()))
}

/// Writes the files of a whole run; returns their paths. A part of a run that makes no file leaves
/// the report of an earlier run beside its pictures.
fn write_all(
    args: &RunArgs,
    out: &Output,
    done: &RunReport,
    json: &str,
) -> Result<Vec<PathBuf>, Diagnostic> {
    let results = results(done);
    let files = results.iter().flat_map(|files| &files.0).map(|(name, bytes)| (name, bytes));
    let mut paths = out.write(&files.collect::<Vec<_>>())?;
    if args.only.is_none() || !paths.is_empty() {
        paths.push(out.file("report.json", json.as_bytes())?);
    }
    if args.report {
        paths.push(page::page(&args.out, LONG_SIDE)?);
    }
    Ok(paths)
}
