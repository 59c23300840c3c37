//! Events for the pages, and the progress of a run as a source of them.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use relight::graph::{
    Diagnostic, NodeReport, Observer, Origin, Status, escape, escape_json, escape_line,
};
use serde::Serialize;
use serde_json::json;

use super::state::Live;
use crate::cli::progress::Work;

/// One event, as pages receive it.
#[derive(Clone)]
pub struct Event {
    pub name: &'static str,
    pub data: String,
}

impl Event {
    pub fn new(name: &'static str, data: &impl Serialize) -> Event {
        Event { name, data: text(data) }
    }
}

/// JSON in which no control character is left.
pub fn text(data: &impl Serialize) -> String {
    escape_json(&serde_json::to_string(data).expect("texts and numbers are JSON"))
}

/// A fault, for a page.
#[derive(Clone, Debug, Serialize)]
pub struct Fault {
    pub message: String,
    pub path: String,
    pub line: Option<usize>,
    pub column: Option<usize>,
    /// The first column after the place, on the same line.
    pub end_column: Option<usize>,
    pub help: Option<String>,
}

impl Fault {
    pub fn of(fault: &Diagnostic) -> Fault {
        let place = fault.origin.as_ref().map(Origin::line_column);
        let width = fault.origin.as_ref().map_or(0, |origin| {
            let text = origin.source.text.get(origin.span.clone()).unwrap_or_default();
            text.lines().next().unwrap_or_default().chars().count()
        });
        Fault {
            message: escape(&fault.message).into_owned(),
            path: escape_line(&fault.path.display().to_string()),
            line: place.map(|(line, _)| line),
            column: place.map(|(_, column)| column),
            end_column: place.map(|(_, column)| column + width),
            help: fault.help.as_ref().map(|help| escape(help).into_owned()),
        }
    }

    pub fn all(faults: &[Diagnostic]) -> Vec<Fault> {
        faults.iter().map(Fault::of).collect()
    }
}

/// A node that a run computed.
#[derive(Clone, Serialize)]
pub struct Row {
    name: String,
    status: Status,
    seconds: f64,
    rays: u64,
    why: Option<String>,
}

/// The nodes of a run that are not hits.
pub fn rows(nodes: &[NodeReport]) -> impl Iterator<Item = Row> {
    nodes.iter().filter(|node| node.status != Status::Hit).map(|node| Row {
        name: node.name.clone(),
        status: node.status,
        seconds: node.seconds,
        rays: node.rays,
        why: node.error.as_ref().or(node.why.as_ref()).map(|why| escape(why).into_owned()),
    })
}

/// Sends the progress of a run to the pages.
pub struct Progress<'a> {
    live: &'a Live,
    revision: u64,
    began: Instant,
    state: Mutex<ProgressState>,
}

#[derive(Default)]
struct ProgressState {
    work: Work,
    needed: usize,
    done: usize,
    working: Vec<String>,
}

impl Progress<'_> {
    pub fn new(live: &Live, revision: u64) -> Progress<'_> {
        Progress { live, revision, began: Instant::now(), state: Mutex::default() }
    }

    fn state(&self) -> MutexGuard<'_, ProgressState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn send(&self, state: &ProgressState) {
        let left = state.work.left(self.began.elapsed());
        let data = json!({
            "revision": self.revision, "done": state.done,
            "left": state.needed.saturating_sub(state.done),
            "node": state.working.join(" "), "seconds_left": left.map(|left| left.as_secs_f64()),
        });
        self.live.send(Event::new("progress", &data));
    }
}

impl Observer for Progress<'_> {
    fn needs(&self, kinds: &[&str]) {
        let mut state = self.state();
        state.work.needs(kinds);
        state.needed += kinds.len();
    }

    fn started(&self, node: &str) {
        let mut state = self.state();
        state.working.push(node.to_owned());
        self.send(&state);
    }

    fn finished(&self, report: &NodeReport) {
        let mut state = self.state();
        state.work.finished(report.kind, report.status);
        state.done += 1;
        state.working.retain(|name| *name != report.name);
        if report.status != Status::Hit {
            self.send(&state);
        }
    }
}
