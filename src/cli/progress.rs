//! Progress of a run: a bar with the time left on a terminal, plain lines elsewhere.

use std::sync::Mutex;
use std::time::Duration;

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use relight::graph::{NodeReport, Observer, Status};

use super::messages::message;

/// Interval between updates of the time left while no node ends.
const TICK: Duration = Duration::from_millis(200);

pub struct Progress {
    /// Whether each finished node gets a line.
    lines: bool,
    terminal: bool,
    state: Mutex<ProgressState>,
}

#[derive(Default)]
struct ProgressState {
    bar: Option<ProgressBar>,
    /// Number of nodes that are not hits, as far as known.
    to_run: usize,
    done: usize,
    working: Vec<String>,
}

impl Progress {
    /// Creates the progress of one run. `lines` prints a line per node; `terminal` draws a bar.
    pub fn new(lines: bool, terminal: bool) -> Progress {
        Progress { lines, terminal, state: Mutex::default() }
    }

    /// Removes the bar.
    pub fn end(&self) {
        if let Some(bar) = self.state().bar.take() {
            bar.finish_and_clear();
        }
    }

    fn state(&self) -> std::sync::MutexGuard<'_, ProgressState> {
        self.state.lock().expect("drawing does not panic")
    }
}

impl ProgressState {
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
    bar.set_style(style("nodes", ""));
    bar.enable_steady_tick(TICK);
    bar
}

fn style(what: &str, left: &str) -> ProgressStyle {
    ProgressStyle::with_template(&format!("{{bar:30}} {{pos}}/{{len}} {what}{left}  {{wide_msg}}"))
        .expect("the template is sound")
}

/// Progress of a sequence: a bar over its frames on a terminal, a line per frame elsewhere.
pub struct FrameProgress {
    /// Whether each node that ran gets a line.
    lines: bool,
    terminal: bool,
    count: usize,
    state: Mutex<FrameState>,
}

#[derive(Default)]
struct FrameState {
    bar: Option<ProgressBar>,
    done: usize,
    /// Seconds of each frame for which a node ran.
    made: Vec<f64>,
    frame: u32,
    working: Vec<String>,
}

impl FrameProgress {
    /// Creates the progress of `count` frames. `lines` prints a line per node; `terminal` draws a
    /// bar.
    pub fn new(count: usize, lines: bool, terminal: bool) -> FrameProgress {
        let bar = terminal.then(|| {
            let bar = bar();
            bar.set_style(style("frames", ""));
            bar.set_length(count as u64);
            bar
        });
        FrameProgress {
            lines,
            terminal,
            count,
            state: Mutex::new(FrameState { bar, ..FrameState::default() }),
        }
    }

    /// Starts a frame.
    pub fn frame(&self, number: u32) {
        let mut state = self.state();
        state.frame = number;
        state.working.clear();
        state.draw();
    }

    /// Frame `number` is done, after `ran` nodes ran for it.
    pub fn done(&self, number: u32, seconds: f64, ran: usize) {
        let mut state = self.state();
        state.done += 1;
        if ran > 0 {
            state.made.push(seconds);
        }
        let left = state
            .left(self.count)
            .map(|left| format!(", {} left", HumanDuration(left)))
            .unwrap_or_default();
        if let Some(bar) = &state.bar {
            bar.set_position(state.done as u64);
            bar.set_style(style("frames", &left));
        }
        if !self.terminal {
            let what = if ran > 0 {
                format!("{ran} nodes ran in {seconds:.2} s")
            } else {
                "cached".to_owned()
            };
            message!("frame {number} ({} of {}): {what}{left}", state.done, self.count);
        }
    }

    /// Removes the bar.
    pub fn end(&self) {
        if let Some(bar) = self.state().bar.take() {
            bar.finish_and_clear();
        }
    }

    fn state(&self) -> std::sync::MutexGuard<'_, FrameState> {
        self.state.lock().expect("drawing does not panic")
    }
}

impl FrameState {
    fn draw(&self) {
        if let Some(bar) = &self.bar {
            bar.set_message(format!("frame {}: {}", self.frame, self.working.join(" ")));
        }
    }

    /// Time left, from the mean time of computed frames. The first of them is left out: it computes
    /// the shared results.
    fn left(&self, count: usize) -> Option<Duration> {
        let usual = if self.made.len() > 1 { &self.made[1..] } else { &self.made[..] };
        let to_come = count - self.done;
        if usual.is_empty() || to_come == 0 {
            return None;
        }
        let mean = usual.iter().sum::<f64>() / usual.len() as f64;
        Some(Duration::from_secs_f64((mean * to_come as f64).max(1.0)))
    }
}

impl Observer for FrameProgress {
    fn started(&self, node: &str) {
        let mut state = self.state();
        state.working.push(node.to_owned());
        state.draw();
    }

    fn finished(&self, report: &NodeReport) {
        let mut state = self.state();
        state.working.retain(|name| *name != report.name);
        state.draw();
        if self.lines && report.status != Status::Hit {
            let line = line(report);
            match &state.bar {
                Some(bar) => bar.suspend(|| message!("{line}")),
                None => message!("{line}"),
            }
        }
    }
}

/// The line of a finished node.
fn line(report: &NodeReport) -> String {
    match &report.error {
        Some(error) => format!("{:9} {}: {error}", report.status, report.name),
        None => format!("{:9} {} ({:.3} s)", report.status, report.name, report.seconds),
    }
}

impl Observer for Progress {
    fn needs(&self, more: usize) {
        self.state().to_run += more;
    }

    fn started(&self, node: &str) {
        let mut state = self.state();
        state.working.push(node.to_owned());
        // Created late, so that a run of hits alone draws no bar.
        if self.terminal && state.bar.is_none() {
            state.bar = Some(bar());
        }
        state.draw();
    }

    fn finished(&self, report: &NodeReport) {
        let mut state = self.state();
        // A hit takes no time and does not count. A node that is computed again after a hit is done
        // twice.
        if report.status == Status::Hit {
            state.to_run = state.to_run.saturating_sub(1);
        } else {
            state.done += 1;
        }
        state.working.retain(|name| *name != report.name);
        if let Some(bar) = &state.bar
            && state.done == 1
        {
            bar.set_style(style("nodes", ", {eta} left"));
        }
        state.draw();
        if self.lines {
            let line = line(report);
            match &state.bar {
                Some(bar) => bar.suspend(|| message!("{line}")),
                None => message!("{line}"),
            }
        }
    }
}
