//! The progress of a run, as events.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use relight::graph::{NodeReport, Observer, Status};
use serde_json::json;

use super::events::Event;
use super::state::Live;
use crate::cli::progress::Work;

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
