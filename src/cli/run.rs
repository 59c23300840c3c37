//! `relight run`.

use std::time::{Duration, Instant};

use relight::graph::{Cancel, Diagnostic, EngineOptions, PortValue, ResolvedGraph, RunReport, Status, Value};
use relight::nodes::artifacts::Files;

use super::args::{LONG_SIDE, Run};
use super::messages::message;
use super::progress::Progress;
use super::write::{self, Output};
use super::{CliError, Exit, engine, frames, load::load_all, networks, options, page, report, terminal};

pub fn run(args: &Run, verbose: u8, began: Instant) -> Result<Exit, CliError> {
    let mut pictures = load_all(&args.graph, &args.edit, &args.files)?;
    if let Some(numbers) = pictures.frames.clone() {
        if args.report {
            let fault = Diagnostic::file(&args.edit, "--report: wanted an edit of one picture, got one of frames");
            return Err(fault.help("with --exr, `relight mix` weights the lights of each frame").into());
        }
        return frames::run(args, &mut pictures, numbers, verbose, began);
    }
    let graph = pictures.first;
    let wanted = graph.wanted(args.only.as_ref().map(std::slice::from_ref))?;
    let engine = engine(engine_options(args)?)?;
    let out = output(args, &graph)?; // told before the work, not after it
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
    tell_errors(&done);
    for difference in &differences {
        message!("error: {}.{}: made again, it came out differently", difference.node, difference.port);
    }
    message!("{}", report::summary(&done, head.seconds));
    if args.json {
        write::print(&json)?;
    } else {
        write::print_paths(&paths)?;
    }
    Ok(exit(&done, differences.is_empty()))
}

pub(super) fn engine_options(args: &Run) -> Result<EngineOptions, Diagnostic> {
    let threads = args.threads.map(usize::from);
    let options = options(&args.cache, &args.graph, args.files.scene.as_deref())?;
    Ok(EngineOptions { threads, budget: args.budget, ..options })
}

/// The folder for the results of a run; none when it only compares.
pub(super) fn output(args: &Run, graph: &ResolvedGraph) -> Result<Option<Output>, Diagnostic> {
    let output = || Output::of_graph(&args.out, graph, Some(&args.edit), args.force);
    (!args.verify).then(output).transpose()
}

/// Who computed the networks of a run; nobody where it needed none.
pub(super) fn backend_of(args: &Run, done: &RunReport) -> Result<Option<networks::Choice>, Diagnostic> {
    let registry = networks::registry(&args.files.networks);
    let has_network = done.nodes.iter().any(|node| networks::has_network(&registry, node.kind));
    has_network.then(|| networks::choose(&args.files.networks)).transpose()
}

/// The first Ctrl-C asks the stages to stop; the second, or [`PATIENCE`], ends the program at once.
pub(super) fn stop_on_ctrl_c(cancel: &Cancel) -> Result<(), Diagnostic> {
    let cancel = cancel.clone();
    let handler = move || {
        let end = || std::process::exit(Exit::Interrupted.code().into());
        if cancel.is_cancelled() {
            end();
        }
        cancel.cancel();
        std::thread::spawn(move || {
            std::thread::sleep(PATIENCE);
            end()
        });
        // Only now: standard error may be a pipe that nobody reads.
        message!("stopping; once more to stop at once");
    };
    ctrlc::set_handler(handler).map_err(|e| Diagnostic::file("".as_ref(), format!("Ctrl-C cannot be watched: {e}")))
}

/// The time that a run has to stop.
const PATIENCE: Duration = Duration::from_millis(1500);

pub(super) fn tell_errors(done: &RunReport) {
    // What is blocked has its cause among the others.
    let failed = done.nodes.iter().filter(|node| node.status != Status::Blocked);
    let errors = failed.filter_map(|node| Some((node, node.error.as_ref()?)));
    errors.for_each(|(node, error)| message!("error: {}: {error}", node.name));
}

/// The written files among the outputs.
pub(super) fn results(run: &RunReport) -> Vec<std::sync::Arc<Files>> {
    let values = run.outputs.iter().flat_map(|(_, value)| match value {
        PortValue::One(value) => vec![value],
        PortValue::Many(values) => values.iter().map(|(_, value)| value).collect(),
        PortValue::Missing => Vec::new(),
    });
    values.filter_map(Value::get).collect()
}

/// The exit status of a run; `same` is whether `--verify` found no difference.
pub(super) fn exit(run: &RunReport, same: bool) -> Exit {
    match run.ending().into() {
        Exit::Done if !same => Exit::Failed,
        exit => exit,
    }
}
