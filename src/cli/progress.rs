//! What a person sees while a run works: a bar with the time left on a terminal, plain lines elsewhere.

use std::sync::Mutex;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use relight::graph::{NodeReport, Observer, Status};

use super::report::word;

/// How often the time left is drawn anew while nothing happens.
const TICK: Duration = Duration::from_millis(200);

pub struct Progress {
    /// A line per node as it is done.
    lines: bool,
    terminal: bool,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    bar: Option<ProgressBar>,
    /// Nodes that are no hits, as far as is known.
    to_run: usize,
    done: usize,
    working: Vec<String>,
}

impl Progress {
    pub fn new(lines: bool, terminal: bool) -> Progress {
        Progress { lines, terminal, state: Mutex::default() }
    }

    /// Takes the bar away.
    pub fn end(&self) {
        if let Some(bar) = self.state().bar.take() {
            bar.finish_and_clear();
        }
    }

    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().expect("drawing does not panic")
    }
}

impl State {
    fn draw(&self) {
        if let Some(bar) = &self.bar {
            bar.set_length(self.to_run as u64);
            bar.set_position(self.done as u64);
            bar.set_message(self.working.join(" "));
        }
    }
}

fn bar() -> ProgressBar {
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
    bar.set_style(style(""));
    bar.enable_steady_tick(TICK);
    bar
}

fn style(left: &str) -> ProgressStyle {
    ProgressStyle::with_template(&format!("{{bar:30}} {{pos}}/{{len}} nodes{left}  {{wide_msg}}"))
        .expect("the template is sound")
}

impl Observer for Progress {
    fn begin(&self, total: usize) {
        self.state().to_run = total;
    }

    fn started(&self, node: &str) {
        let mut state = self.state();
        state.working.push(node.to_owned());
        // Made only now: a run that finds everything in its cache draws no bar.
        if self.terminal && state.bar.is_none() {
            state.bar = Some(bar());
        }
        state.draw();
    }

    fn finished(&self, report: &NodeReport) {
        let mut state = self.state();
        // A hit takes no time and tells nothing of the time left. One that is made again after all is done a second time.
        if report.status == Status::Hit {
            state.to_run = state.to_run.saturating_sub(1);
        } else {
            state.done += 1;
        }
        state.working.retain(|name| *name != report.name);
        if let Some(bar) = &state.bar
            && state.done == 1
        {
            bar.set_style(style(", {eta} left"));
        }
        state.draw();
        if self.lines {
            let line = match &report.error {
                Some(error) => format!("{:9} {}: {error}", word(report.status), report.name),
                None => format!("{:9} {} ({:.3} s)", word(report.status), report.name, report.seconds),
            };
            match &state.bar {
                Some(bar) => bar.suspend(|| eprintln!("{line}")),
                None => eprintln!("{line}"),
            }
        }
    }
}
