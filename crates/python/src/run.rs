//! A scene with a warm engine, and the runs of graphs on it.

use std::path::PathBuf;
use std::sync::{Mutex, mpsc};
use std::time::Duration;

use pyo3::exceptions::{PyKeyError, PyKeyboardInterrupt, PyOSError};
use pyo3::prelude::*;
use relight::files::{EditFile, edit, scene};
use relight::graph::{
    Cancel, Diagnostic, Diagnostics, Ending, Engine, EngineOptions, GraphFile, NodeReport,
    Observer, Overlay, Raw, Registry, ResolvedGraph, RunReport, Setting, Source, Target, is_name,
};
use relight::nodes;

use super::errors::{failed, refused};
use super::values::of_port;

/// Time between two looks at Ctrl-C.
const SIGNALS: Duration = Duration::from_millis(50);

/// A scene folder, and an engine that keeps results of its runs in memory.
#[pyclass(frozen, module = "relight")]
pub struct Scene {
    folder: PathBuf,
    registry: Registry,
    engine: Engine,
}

/// The edit of a run.
#[derive(FromPyObject)]
enum Edit {
    /// The text of an edit file.
    #[pyo3(transparent)]
    Text(String),
    /// An edit file.
    #[pyo3(transparent)]
    File(PathBuf),
}

#[pymethods]
impl Scene {
    #[new]
    #[pyo3(signature = (folder, models, threads=None, memory_bytes=None))]
    fn new(
        py: Python,
        folder: PathBuf,
        models: PathBuf,
        threads: Option<usize>,
        memory_bytes: Option<u64>,
    ) -> PyResult<Scene> {
        scene::read(&folder, None).map_err(|faults| refused(py, &faults))?;
        let default = EngineOptions::default();
        let memory_bytes = memory_bytes.unwrap_or(default.memory_bytes);
        let engine = Engine::new(EngineOptions { threads, memory_bytes, ..default })
            .map_err(|e| PyOSError::new_err(format!("worker threads cannot be started: {e}")))?;
        let registry = nodes::registry().with_library(models, "the networks are part of the wheel");
        Ok(Scene { folder, registry, engine })
    }

    /// Runs `graph` with `edit` for the outputs named, or for those of the graph.
    #[expect(clippy::too_many_arguments, reason = "Python passes them by name")]
    #[pyo3(signature = (graph, edit, settings, outputs=None, frame=0, progress=None))]
    fn run(
        &self,
        py: Python,
        graph: PathBuf,
        edit: Edit,
        settings: Vec<(String, String)>,
        outputs: Option<Vec<String>>,
        frame: u32,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Run> {
        let resolved = py
            .detach(|| self.resolve(graph, edit, &settings, frame))
            .map_err(|faults| refused(py, &faults))?;
        let names = outputs.unwrap_or_else(|| self.default_outputs(&resolved));
        let wanted = resolved.wanted(Some(&names)).map_err(|fault| refused(py, &[fault]))?;
        let total = self.engine.plan(&resolved, &wanted).len();
        let watcher =
            Watcher { progress, total, state: Mutex::default(), cancel: Cancel::default() };
        let report = py.detach(|| {
            let (running, ended) = mpsc::channel::<()>();
            std::thread::scope(|threads| {
                let run = threads.spawn(|| {
                    // Dropped at the end, which the receiver notices.
                    let _running = running;
                    self.engine.run(&resolved, &wanted, &watcher.cancel, &watcher)
                });
                while ended.recv_timeout(SIGNALS) == Err(mpsc::RecvTimeoutError::Timeout) {
                    if let Err(error) = Python::attach(|py| py.check_signals()) {
                        watcher.stop(error);
                    }
                }
                run.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            })
        });
        if let Some(error) = watcher.state.lock().ok().and_then(|mut state| state.error.take()) {
            return Err(error);
        }
        match report.ending() {
            Ending::Complete => Ok(Run { report }),
            Ending::Cancelled => Err(PyKeyboardInterrupt::new_err("the run was cancelled")),
            Ending::Failed | Ending::BadInput => Err(failed(py, &report)),
        }
    }

    fn __repr__(&self) -> String {
        format!("Scene({:?})", self.folder.display().to_string())
    }
}

impl Scene {
    /// The graph with scene, edit and settings applied.
    fn resolve(
        &self,
        graph: PathBuf,
        edit: Edit,
        settings: &[(String, String)],
        frame: u32,
    ) -> Result<ResolvedGraph, Vec<Diagnostic>> {
        let mut file = GraphFile::read(&graph)?;
        file.accept_old_names(&self.registry);
        let kinds: Vec<&str> = file.nodes().map(|node| node.kind).collect();
        let room = scene::read(&self.folder, Some(&kinds))?;
        let edit = match edit {
            Edit::Text(text) => EditFile::parse(Source::new("<edit>", text))?,
            Edit::File(path) => EditFile::read(&path)?,
        };
        match (edit.frames(), frame) {
            (Some(frames), frame) if frame >= frames => {
                let message = format!("wanted 0..={}, got {frame}", frames - 1);
                return Err(vec![Diagnostic::file("frame".as_ref(), message)]);
            }
            (None, 1..) => {
                let message = format!("the edit is not a sequence: wanted frame 0, got {frame}");
                return Err(vec![Diagnostic::file("frame".as_ref(), message)]);
            }
            _ => {}
        }
        let change = edit::frame(&edit, frame, Some(&room), Some(&kinds))?;
        let own = settings.iter().map(|(name, value)| setting(name, value));
        let own = own.collect::<Result<Vec<Setting>, _>>()?;
        let settings = room.settings.into_iter().chain(change.settings).chain(own).collect();
        let members = room.members.into_iter().chain(change.members).collect();
        file.resolve(&self.registry, &Overlay { settings, members })
    }

    /// The picture and its layers where the graph composes one, else the outputs of the graph.
    fn default_outputs(&self, graph: &ResolvedGraph) -> Vec<String> {
        if graph.instances().any(|name| name == "compose") {
            ["picture", "layer", "residual"].map(|port| format!("compose.{port}")).to_vec()
        } else {
            graph.outputs().to_vec()
        }
    }
}

/// One `node.parameter` and its value in RON.
fn setting(name: &str, value: &str) -> Result<Setting, Vec<Diagnostic>> {
    let parts = name.split_once('.').filter(|(node, field)| is_name(node) && is_name(field));
    let Some((node, field)) = parts else {
        let message = format!("wanted NODE.PARAMETER, got `{name}`");
        return Err(vec![Diagnostic::file("settings".as_ref(), message)]);
    };
    let mut faults = Diagnostics::default();
    let value = Raw::document(&Source::new(format!("<settings {name}>"), value), &mut faults);
    let value = value.ok_or_else(|| faults.into_vec())?;
    Ok(Setting { target: Target::Node(node.to_owned()), field: field.to_owned(), value })
}

/// Calls a function of Python for each node that is done.
struct Watcher {
    progress: Option<Py<PyAny>>,
    total: usize,
    state: Mutex<WatchState>,
    cancel: Cancel,
}

#[derive(Default)]
struct WatchState {
    done: usize,
    /// The first exception: of the function, or Ctrl-C.
    error: Option<PyErr>,
}

impl Watcher {
    fn stop(&self, error: PyErr) {
        self.cancel.cancel();
        if let Ok(mut state) = self.state.lock() {
            state.error.get_or_insert(error);
        }
    }
}

impl Observer for Watcher {
    fn finished(&self, report: &NodeReport) {
        let Some(progress) = &self.progress else { return };
        let done = match self.state.lock() {
            Ok(mut state) => {
                state.done = self.total.min(state.done + 1);
                state.done
            }
            Err(_) => return,
        };
        let called = Python::attach(|py| {
            let status = report.status.to_string();
            progress.call1(py, (done, self.total, report.name.as_str(), status)).map(drop)
        });
        if let Err(error) = called {
            self.stop(error);
        }
    }
}

/// The outputs and the report of a run.
#[pyclass(frozen, module = "relight")]
pub struct Run {
    report: RunReport,
}

#[pymethods]
impl Run {
    /// Names of the outputs.
    #[getter]
    fn outputs(&self) -> Vec<String> {
        self.report.outputs.iter().map(|(name, _)| name.clone()).collect()
    }

    fn __getitem__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        match self.report.output(name) {
            Some(port) => of_port(py, port),
            None => Err(PyKeyError::new_err(format!(
                "{name}: wanted one of {}; `outputs=[..]` of the run requests others",
                self.outputs().join(", ")
            ))),
        }
    }

    /// Wall time of the run.
    #[getter]
    fn seconds(&self) -> f64 {
        self.report.seconds
    }

    /// The nodes as JSON.
    #[getter]
    fn nodes_json(&self) -> PyResult<String> {
        serde_json::to_string(&self.report.nodes).map_err(|e| PyOSError::new_err(e.to_string()))
    }
}
