//! `relight run` of an edit without `frames`: one picture.

use std::path::PathBuf;
use std::time::Instant;

use relight::graph::{Diagnostic, Engine, ResolvedGraph, RunReport};

use super::args::{LONG_SIDE, RunArgs};
use super::engine::{Host, report_errors};
use super::exit::{CliError, Exit};
use super::messages::{error, message, shows_progress};
use super::networks::Choice;
use super::progress::Progress;
use super::provenance::Inputs;
use super::results::{backend_of, output, results};
use super::write::Output;
use super::{page, report, write};

/// Runs or verifies `graph` with the edit of the text `edit`, writes its files and shows the
/// report.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn run(
    args: &RunArgs,
    (graph, edit): (&ResolvedGraph, Option<&str>),
    host: &Host,
    verbose: u8,
    began: Instant,
) -> Result<Exit, CliError> {
    let Host { engine, cancel } = host;
    let wanted = graph.wanted(args.only.as_ref().map(std::slice::from_ref))?;
    let out = output(args, graph)?; // fails before the work, not after it
    let progress = Progress::new(verbose > 0, shows_progress());
    let (done, differences) = if args.verify {
        let verified = engine.verify(graph, &wanted, cancel, &progress);
        (verified.run, verified.differences)
    } else {
        (engine.run(graph, &wanted, cancel, &progress), Vec::new())
    };
    progress.end();

    let told = Told::new(args, graph, engine, &done, began)?;
    let paths = match &out {
        Some(out) if done.is_complete() => write_all(args, out, (graph, edit, &done), &told.json)?,
        _ => Vec::new(),
    };

    if verbose > 0 {
        message!("{}", report::table(&done).trim_end());
        if let Some(choice) = &told.choice {
            message!("networks by {}: {}", choice.backend, choice.why);
        }
    }
    told.warnings.iter().for_each(|warning| message!("warning: {warning}"));
    report::notes_of_outputs(&done).for_each(|note| message!("{note}"));
    report_errors(&done);
    for difference in &differences {
        error!("{}.{}: computed again, the result differs", difference.node, difference.port);
    }
    message!("{}", report::summary(&done, told.seconds));
    if !done.is_complete() && args.out.join("report.json").exists() {
        message!("nothing is written: the files in {} are of an earlier run", args.out.display());
    }
    if args.json {
        write::print(&told.json)?;
    } else {
        write::print_paths(&paths)?;
    }
    Ok(Exit::of(&done).and(differences.is_empty()))
}

/// The report of a run, as report.json has it.
pub struct Told {
    /// report.json.
    pub json: String,
    pub warnings: Vec<String>,
    pub seconds: f64,
    choice: Option<Choice>,
}

impl Told {
    /// Reports a run that began at `began`.
    ///
    /// # Errors
    /// A library that the arguments name or require cannot be used.
    pub fn new(
        args: &RunArgs,
        graph: &ResolvedGraph,
        engine: &Engine,
        done: &RunReport,
        began: Instant,
    ) -> Result<Told, Diagnostic> {
        let choice = backend_of(args, done)?;
        let backend = choice.as_ref().map(|choice| choice.backend.to_string());
        let edit = args.edit.as_deref();
        let head = report::Head::new(&args.graph, edit, began, backend, engine.threads());
        let warnings = report::warnings(done);
        let json = report::json(&head, graph, done, &warnings);
        Ok(Told { json, warnings, seconds: head.seconds, choice })
    }
}

/// Writes the files of a whole run of a graph with the edit of this text; returns their paths. A
/// part of a run that makes no file leaves the report of an earlier run beside its pictures.
///
/// # Errors
/// Those of [`Output::write`].
pub fn write_all(
    args: &RunArgs,
    out: &Output,
    (graph, edit, done): (&ResolvedGraph, Option<&str>, &RunReport),
    json: &str,
) -> Result<Vec<PathBuf>, Diagnostic> {
    let results = results(done);
    let files = Inputs::new(args, edit, None).stamp(graph, &results)?;
    let mut paths = out.write_pieces(&files)?;
    if args.only.is_none() || !paths.is_empty() {
        paths.push(out.file("report.json", json.as_bytes())?);
    }
    if args.report {
        paths.push(page::page(&args.out, LONG_SIDE)?);
    }
    Ok(paths)
}
