//! The engine as the command starts it, the runs that a command needs whole, and Ctrl-C.

use std::path::Path;
use std::time::Duration;

use relight::graph::{Cancel, Diagnostic, Engine, EngineOptions, RunReport, Services, Status};

use super::args::CacheUse;
use super::exit::{Exit, Stop};
use super::messages::{error, message};
use super::{cache, networks};

/// Time from Ctrl-C to the end of the program.
const PATIENCE: Duration = Duration::from_millis(1500);

/// Options of an engine for a graph, with the cache that the arguments name.
///
/// # Errors
/// A named key file cannot be used.
pub fn options(
    cache: &CacheUse,
    graph: &Path,
    scene: Option<&Path>,
) -> Result<EngineOptions, Diagnostic> {
    let project = cache::project(graph, scene);
    Ok(EngineOptions { cache: cache::chosen(cache)?, project, ..EngineOptions::default() })
}

/// Starts an engine that computes networks of others in child processes.
///
/// # Errors
/// The worker threads cannot be started.
pub fn engine(options: EngineOptions) -> Result<Engine, Diagnostic> {
    let services = Services::default().with(networks::untrusted());
    Engine::new(EngineOptions { services, ..options }).map_err(|e| {
        Diagnostic::file("".as_ref(), format!("the worker threads cannot be started: {e}"))
    })
}

/// The engine of a command, and the end of its runs by Ctrl-C.
pub struct Host {
    pub engine: Engine,
    pub cancel: Cancel,
}

impl Host {
    /// Starts an engine whose runs Ctrl-C cancels.
    ///
    /// # Errors
    /// The worker threads cannot be started, or the system refuses a handler.
    pub fn new(options: EngineOptions) -> Result<Host, Diagnostic> {
        let cancel = Cancel::default();
        stop_on_ctrl_c(&cancel)?;
        Ok(Host { engine: engine(options)?, cancel })
    }
}

/// Passes a run whose nodes all gave their results; shows the errors of another one.
///
/// # Errors
/// The run is not complete.
pub fn finished(run: RunReport) -> Result<RunReport, Stop> {
    if run.is_complete() {
        return Ok(run);
    }
    let exit = Exit::of(&run);
    if exit != Exit::Interrupted {
        report_errors(&run);
    }
    Err(Stop::Ended(exit))
}

/// Shows the error of each failed node. A blocked node has its cause among the others.
pub fn report_errors(run: &RunReport) {
    let failed = run.nodes.iter().filter(|node| node.status != Status::Blocked);
    let errors = failed.filter_map(|node| Some((node, node.error.as_ref()?)));
    errors.for_each(|(node, error)| error!("{}: {error}", node.name));
}

/// Makes the first Ctrl-C cancel the run; the second one, or [`PATIENCE`], ends the program.
///
/// # Errors
/// The system refuses a handler.
pub fn stop_on_ctrl_c(cancel: &Cancel) -> Result<(), Diagnostic> {
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
        // This comes last, as standard error may be a pipe that nobody reads.
        message!("stopping; press Ctrl-C again to stop at once");
    };
    ctrlc::set_handler(handler)
        .map_err(|e| Diagnostic::file("".as_ref(), format!("Ctrl-C cannot be handled: {e}")))
}
