//! `relight run` of an edit without `frames`: one picture.

use std::time::Instant;

use relight::graph::{Cancel, ResolvedGraph};

use super::args::{LONG_SIDE, RunArgs};
use super::engine::{engine, report_errors, stop_on_ctrl_c};
use super::exit::{CliError, Exit};
use super::messages::{message, terminal};
use super::progress::Progress;
use super::results::{backend_of, engine_options, output, results};
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
    let progress = Progress::new(verbose > 0, terminal());
    let (done, differences) = if args.verify {
        let verified = engine.verify(&graph, &wanted, &cancel, &progress);
        (verified.run, verified.differences)
    } else {
        (engine.run(&graph, &wanted, &cancel, &progress), Vec::new())
    };
    progress.end();

    let mut paths = Vec::new();
    let warnings = report::warnings(&done);
    if let Some(out) = &out {
        let results = results(&done);
        let files = results.iter().flat_map(|files| &files.0).map(|(name, bytes)| (name, bytes));
        paths.extend(out.write(&files.collect::<Vec<_>>())?);
    }
    let choice = backend_of(args, &done)?;
    let backend = choice.as_ref().map(|choice| choice.backend.to_string());

    let head = report::Head::new(&args.graph, &args.edit, began, backend, engine.threads());
    let json = report::json(&head, &graph, &done, &warnings);
    if let Some(out) = &out {
        paths.push(out.file("report.json", json.as_bytes())?);
    }
    if args.report && done.is_complete() {
        paths.push(page::page(&args.out, LONG_SIDE)?);
    }

    message!("{}", report::table(&done).trim_end());
    if let Some(choice) = &choice {
        message!("networks by {}: {}", choice.backend, choice.why);
    }
    warnings.iter().for_each(|warning| message!("warning: {warning}"));
    report::notes_of_outputs(&done).for_each(|note| message!("{note}"));
    report_errors(&done);
    for difference in &differences {
        message!(
            "error: {}.{}: computed again, the result differs",
            difference.node,
            difference.port
        );
    }
    message!("{}", report::summary(&done, head.seconds));
    if args.json {
        write::print(&json)?;
    } else {
        write::print_paths(&paths)?;
    }
    Ok(Exit::of(&done).and(differences.is_empty()))
}
