//! The state of the server: the text of the edit, its revision, and the run that it asks for.
//!
//! Each accepted text and each run has a number of its own, the revision, from one counter. A
//! handler that panics leaves the state sound, as it changes it in whole steps: so a poisoned lock
//! is taken as it is.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use axum::body::Bytes;
use relight::graph::{Cancel, Diagnostic, ResolvedGraph, Source};
use serde::Serialize;
use tokio::sync::broadcast;

use super::events::{Event, Fault};
use super::layers::{Base, Packs};
use super::scene::Scene;
use crate::cli::args::RunArgs;

/// Events that a slow page may lag behind.
const EVENTS: usize = 1024;

/// All that handlers, worker and watcher share.
pub struct Live {
    /// The run that gives the same pictures.
    pub job: RunArgs,
    pub packs: Mutex<Packs>,
    state: Mutex<State>,
    wake: Condvar,
    events: broadcast::Sender<Event>,
    /// The end of the server.
    ending: Cancel,
}

pub struct State {
    pub scene: Arc<Scene>,
    /// The newest accepted text, as it is in the edit file.
    pub text: String,
    /// The revision of `text`.
    pub revision: u64,
    /// The content of the edit file when it was last read or written; `None` without a file.
    pub on_disk: Option<String>,
    /// A text with faults that a page sent; it is in `draft.ron`, too.
    pub draft: Option<Draft>,
    pub run: Run,
    pub base: Option<Arc<Base>>,
    /// The graph of the newest finished run, drawn.
    pub drawing: String,
    /// The files that the run reads.
    pub inputs: BTreeSet<PathBuf>,
    /// The files could not be read at the last attempt.
    pub broken: bool,
    /// Grows when `inputs` or `broken` change.
    pub watched: u64,
    last: u64,
    task: Option<Task>,
    cancel: Cancel,
}

#[derive(Clone, Serialize)]
pub struct Draft {
    pub text: String,
    pub diagnostics: Vec<Fault>,
}

/// The newest run.
#[derive(Clone, Serialize)]
pub struct Run {
    pub revision: u64,
    pub status: RunStatus,
    pub seconds: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub message: Option<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub diagnostics: Vec<Fault>,
    #[serde(skip)]
    began: Option<Instant>,
}

#[derive(Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum RunStatus {
    Idle,
    Running,
    Done,
    Failed,
    Superseded,
}

/// A run to be computed.
pub struct Task {
    pub revision: u64,
    pub source: Arc<Source>,
    pub graph: ResolvedGraph,
    /// Layers at a smaller working size, and nothing else.
    pub preview: bool,
    /// Files of the scene have changed.
    pub reread: bool,
    pub began: Instant,
    pub cancel: Cancel,
}

impl Live {
    pub fn new(job: RunArgs, scene: Scene, ending: Cancel) -> Live {
        let run = Run {
            revision: 0,
            status: RunStatus::Idle,
            seconds: 0.0,
            message: None,
            diagnostics: Vec::new(),
            began: None,
        };
        let state = State {
            scene: Arc::new(scene),
            text: String::new(),
            revision: 0,
            on_disk: None,
            draft: None,
            run,
            base: None,
            drawing: String::new(),
            inputs: BTreeSet::new(),
            broken: false,
            watched: 0,
            last: 0,
            task: None,
            cancel: Cancel::default(),
        };
        let events = broadcast::Sender::new(EVENTS);
        let (state, wake) = (Mutex::new(state), Condvar::new());
        Live { job, packs: Mutex::default(), state, wake, events, ending }
    }

    pub fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The packed layer under a digest.
    pub fn blob(&self, digest: &str) -> Option<Bytes> {
        self.packs.lock().unwrap_or_else(PoisonError::into_inner).blob(digest)
    }

    /// The size of the layers that a page asked for last.
    pub fn long_side(&self) -> Option<u32> {
        self.packs.lock().unwrap_or_else(PoisonError::into_inner).long_side()
    }

    /// The edit file.
    pub fn edit(&self) -> &Path {
        self.job.edit.as_deref().unwrap_or("edit.ron".as_ref())
    }

    /// Sends an event to all pages.
    pub fn send(&self, event: Event) {
        // Without a page nobody receives it.
        let _ = self.events.send(event);
    }

    pub fn events(&self) -> broadcast::Receiver<Event> {
        self.events.subscribe()
    }

    /// Asks the worker for a run of this revision, in the place of any other.
    pub fn ask(
        &self,
        state: &mut State,
        revision: u64,
        (source, graph): (Arc<Source>, ResolvedGraph),
        (preview, reread, began): (bool, bool, Instant),
    ) {
        state.cancel.cancel();
        state.cancel = Cancel::default();
        let cancel = state.cancel.clone();
        let reread = reread || state.task.as_ref().is_some_and(|task| task.reread);
        state.task = Some(Task { revision, source, graph, preview, reread, began, cancel });
        state.run = Run { revision, began: Some(began), ..state.run.changed(RunStatus::Running) };
        self.send(Event::new("state", &state.run));
        self.wake.notify_all();
    }

    /// Ends the newest run with faults; nothing is computed.
    pub fn refuse(&self, state: &mut State, revision: u64, faults: &[Diagnostic]) {
        state.cancel.cancel();
        state.task = None;
        let diagnostics = Fault::all(faults);
        let message = diagnostics.first().map(|fault| fault.message.clone());
        state.run = Run { revision, message, diagnostics, ..state.run.changed(RunStatus::Failed) };
        self.send(Event::new("state", &state.run));
        self.send(Event::new("problem", &Problem::of(&state.run)));
    }

    /// Waits for the next run; `None` at the end of the server.
    pub fn next(&self) -> Option<Task> {
        let mut state = self.state();
        loop {
            if self.is_ending() {
                return None;
            }
            if let Some(task) = state.task.take() {
                return Some(task);
            }
            state = self.wake.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Changes the run that a task began, unless a newer one has taken its place.
    pub fn end_run(&self, revision: u64, status: RunStatus, faults: &[Diagnostic]) {
        let mut state = self.state();
        if state.run.revision != revision {
            return;
        }
        let diagnostics = Fault::all(faults);
        let message = diagnostics.first().map(|fault| fault.message.clone());
        state.run = Run { message, diagnostics, ..state.run.changed(status) };
        self.send(Event::new("state", &state.run));
        if status == RunStatus::Failed {
            self.send(Event::new("problem", &Problem::of(&state.run)));
        }
    }

    pub fn is_ending(&self) -> bool {
        self.ending.is_cancelled()
    }

    /// Ends worker and watcher.
    pub fn end(&self) {
        self.ending.cancel();
        self.state().cancel.cancel();
        self.wake.notify_all();
    }
}

impl State {
    /// The next revision.
    pub fn number(&mut self) -> u64 {
        self.last += 1;
        self.last
    }

    /// Takes over the files that a graph reads.
    pub fn watch(&mut self, inputs: Option<BTreeSet<PathBuf>>) {
        let broken = inputs.is_none();
        let inputs = inputs.unwrap_or_else(|| self.inputs.clone());
        if (broken, &inputs) != (self.broken, &self.inputs) {
            (self.broken, self.inputs) = (broken, inputs);
            self.watched += 1;
        }
    }
}

impl Run {
    /// The run at another status, without messages.
    fn changed(&self, status: RunStatus) -> Run {
        Run { status, message: None, diagnostics: Vec::new(), ..self.now() }
    }

    /// The run with its seconds so far.
    pub fn now(&self) -> Run {
        let seconds = match (self.status, self.began) {
            (RunStatus::Running, Some(began)) => began.elapsed().as_secs_f64(),
            _ => self.seconds,
        };
        Run { seconds, ..self.clone() }
    }
}

#[derive(Serialize)]
struct Problem<'a> {
    revision: u64,
    diagnostics: &'a [Fault],
}

impl Problem<'_> {
    fn of(run: &Run) -> Problem<'_> {
        Problem { revision: run.revision, diagnostics: &run.diagnostics }
    }
}
