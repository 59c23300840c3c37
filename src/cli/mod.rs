//! The command line: arguments, exit status, and what a person sees.

mod args;
mod bench;
mod cache;
mod eval;
mod export;
mod film;
mod frames;
mod load;
mod messages;
mod mix;
mod networks;
mod page;
mod progress;
mod reference;
mod report;
mod run;
mod tables;
mod write;

use std::io::IsTerminal;
use std::path::Path;
use std::process::ExitCode;

use relight::files;
use relight::graph::{Diagnostic, Ending, EngineOptions, RunReport, Services};
use relight::nodes;

use args::{CacheUse, Explain, Format, Graph, Job, Nodes, Plan};
pub use args::{Cli, Command};
pub use bench::bench;
pub use cache::cache;
pub use eval::eval;
pub use export::export;
use load::{load, load_all};
pub use mix::mix;
pub use networks::run_network;
pub use page::report;
pub use run::run;

/// How the program ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    Done,
    /// A stage failed, or `--verify` or `cache verify` found something wrong.
    Failed,
    /// Bad arguments or files.
    Bad,
    Interrupted,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> ExitCode {
        ExitCode::from(exit.code())
    }
}

impl From<Ending> for Exit {
    fn from(ending: Ending) -> Exit {
        match ending {
            Ending::Complete => Exit::Done,
            Ending::Failed => Exit::Failed,
            Ending::BadInput => Exit::Bad,
            Ending::Cancelled => Exit::Interrupted,
        }
    }
}

impl Exit {
    pub fn code(self) -> u8 {
        match self {
            Exit::Done => 0,
            Exit::Failed => 1,
            Exit::Bad => 2,
            Exit::Interrupted => 130,
        }
    }
}

/// What keeps a command from its work; always [`Exit::Bad`].
pub struct CliError(Vec<Diagnostic>);

impl CliError {
    /// Shows the faults on standard error.
    pub fn tell(&self) -> Exit {
        messages::raw(&files::draw(&self.0, terminal()));
        Exit::Bad
    }
}

impl From<Vec<Diagnostic>> for CliError {
    fn from(faults: Vec<Diagnostic>) -> CliError {
        CliError(faults)
    }
}

impl From<Diagnostic> for CliError {
    fn from(fault: Diagnostic) -> CliError {
        CliError(vec![fault])
    }
}

/// Why a measurement ends early.
pub enum Stop {
    CliError(CliError),
    /// A stage failed, or a person has interrupted.
    Ended(Exit),
}

impl<T: Into<CliError>> From<T> for Stop {
    fn from(trouble: T) -> Stop {
        Stop::CliError(trouble.into())
    }
}

/// How a measurement ended.
fn ended(measured: Result<(), Stop>) -> Result<Exit, CliError> {
    match measured {
        Ok(()) => Ok(Exit::Done),
        Err(Stop::Ended(exit)) => Ok(exit),
        Err(Stop::CliError(trouble)) => Err(trouble),
    }
}

/// A run that a measurement needs whole: tells what failed.
fn finished(report: RunReport) -> Result<RunReport, Stop> {
    let ending = report.ending();
    if ending != Ending::Cancelled {
        run::tell_errors(&report);
    }
    match ending.into() {
        Exit::Done => Ok(report),
        exit => Err(Stop::Ended(exit)),
    }
}

/// Whether a person watches standard error, who likes colours there.
fn terminal() -> bool {
    std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Sends the log to standard error.
pub fn log(verbose: u8) {
    use tracing_subscriber::{EnvFilter, fmt};
    // The engine's warnings stand in the run's report, and are shown from there.
    let level = match verbose {
        0 | 1 => "relight=error",
        2 => "relight=debug",
        _ => "relight=trace",
    };
    let filter = EnvFilter::try_from_env("RELIGHT_LOG").unwrap_or_else(|_| EnvFilter::new(level));
    // Without colors, whose escape sequences could not be told from those of strangers.
    let log = fmt().with_env_filter(filter).with_writer(|| messages::Escaped).with_ansi(false).without_time();
    log.log_internal_errors(false).init();
}

pub fn plan(args: &Plan) -> Result<Exit, CliError> {
    let graph = load(&args.job.graph, args.job.edit.as_deref(), &args.job.files)?;
    let wanted = graph.wanted(args.only.as_ref().map(std::slice::from_ref))?;
    let options = options(&args.cache, &args.job.graph, args.job.files.scene.as_deref())?;
    let lines = engine(options)?.plan(&graph, &wanted);
    if args.json {
        write::print(&report::text(&lines))?;
        return Ok(Exit::Done);
    }
    let width = lines.iter().map(|line| line.node.chars().count()).max().unwrap_or(0);
    let line = |line: &relight::graph::PlanLine| {
        let text = format!("{:7}  {:width$}  {}", line.status, line.node, line.why.as_deref().unwrap_or(""));
        text.trim_end().to_owned() + "\n"
    };
    write::print(&lines.iter().map(line).collect::<String>())?;
    Ok(Exit::Done)
}

pub fn explain(args: &Explain) -> Result<Exit, CliError> {
    let graph = load(&args.graph, Some(&args.edit), &args.files)?;
    let options = options(&args.cache, &args.graph, args.files.scene.as_deref())?;
    let answer = engine(options)?.explain(&graph, &args.node)?;
    let mut text = format!("{}: {}: {}\n", answer.node, answer.status, answer.why);
    for (sign, line) in [('-', &answer.old), ('+', &answer.new)] {
        if let Some(line) = line {
            text.push_str(&format!("{sign} {line}\n"));
        }
    }
    write::print(&text)?;
    Ok(Exit::Done)
}

pub fn check(args: &Job) -> Result<Exit, CliError> {
    let (graph, frames) = match &args.edit {
        Some(edit) => {
            let pictures = load_all(&args.graph, edit, &args.files)?;
            let count = pictures.frames.map_or(1, |frames| frames.len());
            (pictures.first, if count > 1 { format!("{count} frames, ") } else { String::new() })
        }
        None => (load(&args.graph, None, &args.files)?, String::new()),
    };
    let nodes = graph.instances().count();
    write::print(&format!("sound: {frames}{nodes} nodes, outputs {}\n", graph.outputs().join(" ")))?;
    Ok(Exit::Done)
}

pub fn graph(args: &Graph) -> Result<Exit, CliError> {
    let graph = load(&args.job.graph, args.job.edit.as_deref(), &args.job.files)?;
    write::print(&match args.format {
        Format::Dot => graph.to_dot(None),
        Format::Mermaid => graph.to_mermaid(None),
        Format::Svg => graph.to_svg(None),
        Format::Json => graph.to_json(None),
    })?;
    Ok(Exit::Done)
}

pub fn nodes(args: &Nodes) -> Result<Exit, CliError> {
    let registry = nodes::registry();
    let text = match &args.kind {
        _ if args.markdown => reference::page(&registry),
        None => reference::list(&registry),
        Some(kind) => {
            let spec = registry.get(kind).ok_or_else(|| {
                let fault = Diagnostic::file("".as_ref(), format!("there is no stage `{kind}`"));
                fault.suggest(kind, registry.kinds().map(|spec| spec.kind))
            })?;
            reference::section(spec)
        }
    };
    write::print(&text)?;
    Ok(Exit::Done)
}

/// How an engine works on a graph, with the cache that the arguments name.
fn options(cache: &CacheUse, graph: &Path, scene: Option<&Path>) -> Result<EngineOptions, Diagnostic> {
    let project = cache::project(graph, scene);
    Ok(EngineOptions { cache: cache::chosen(cache)?, project, ..EngineOptions::default() })
}

fn engine(options: EngineOptions) -> Result<relight::graph::Engine, Diagnostic> {
    let services = Services::default().with(networks::untrusted());
    relight::graph::Engine::new(EngineOptions { services, ..options })
        .map_err(|e| Diagnostic::file("".as_ref(), format!("the worker threads cannot be started: {e}")))
}
