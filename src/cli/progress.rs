//! Progress of a run: a bar with the time left on a terminal, plain lines elsewhere.

use std::sync::Mutex;
use std::time::Duration;

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use relight::graph::{NodeReport, Observer, Status};

use super::messages::message;

/// Interval between updates of the time left while no node ends.
const TICK: Duration = Duration::from_millis(200);

/// Seconds of a cold run of graphs/indoor.ron, in percent, that one node of a kind takes: the means
/// of scenes/demo and eight photographs. A kind that is not listed takes [`SHORT`].
const COSTS: [(&str, f64); 20] = [
    ("InitLights", 19.2),
    ("ReadScene", 10.8),
    ("MNet", 10.4),
    ("Transport", 8.4),
    ("Mesh", 7.9),
    ("Compose", 3.8),
    ("LensGlare", 3.5),
    ("Write", 3.0),
    ("Shadow", 2.4),
    ("FindSun", 2.0),
    ("FillReflectance", 1.7),
    ("FitLights", 1.5),
    ("DrawRooms", 1.5),
    ("TraceIndirect", 1.0),
    ("CorrectShading", 1.0),
    ("RoomBox", 0.8),
    ("RoomError", 0.5),
    ("Direct", 0.5),
    ("RetinexMaterials", 0.4),
    ("LightDraws", 0.2),
];
/// Cost of a node of any other kind.
const SHORT: f64 = 0.05;

fn cost(kind: &str) -> f64 {
    COSTS.iter().find(|(listed, _)| *listed == kind).map_or(SHORT, |(_, cost)| *cost)
}

pub struct Progress {
    /// Whether each finished node gets a line.
    lines: bool,
    shown: bool,
    state: Mutex<ProgressState>,
}

#[derive(Default)]
struct ProgressState {
    bar: Option<ProgressBar>,
    work: Work,
    working: Vec<String>,
}

/// Costs of the nodes of a run.
#[derive(Default)]
pub struct Work {
    /// Cost of all nodes that are not hits, as far as known.
    total: f64,
    /// Cost of those that are done.
    done: f64,
}

impl Work {
    /// The run needs nodes of these kinds more.
    pub fn needs(&mut self, kinds: &[&str]) {
        self.total += kinds.iter().map(|kind| cost(kind)).sum::<f64>();
    }

    /// A hit takes no time and does not count. A node that is computed again after a hit is done
    /// twice.
    pub fn finished(&mut self, kind: &str, status: Status) {
        if status == Status::Hit {
            self.total = (self.total - cost(kind)).max(self.done);
        } else {
            self.done += cost(kind);
            self.total = self.total.max(self.done);
        }
    }

    /// Time left after `elapsed`; `None` before a tenth of the work is done.
    pub fn left(&self, elapsed: Duration) -> Option<Duration> {
        let done = self.done / self.total;
        (done >= 0.1).then(|| elapsed.mul_f64((1.0 - done) / done))
    }
}

impl Progress {
    /// Creates the progress of one run. `lines` prints a line per node; `shown` draws a bar.
    pub fn new(lines: bool, shown: bool) -> Progress {
        Progress { lines, shown, state: Mutex::default() }
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
            bar.set_position((STEPS * self.work.done / self.work.total.max(SHORT)) as u64);
            let left = self.work.left(bar.elapsed());
            let left = left.map(|left| format!("{} left  ", HumanDuration(left)));
            bar.set_message(format!("{}{}", left.unwrap_or_default(), self.working.join(" ")));
        }
    }
}

/// Steps of the bar of one run.
const STEPS: f64 = 1000.0;

fn bar(template: &str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
    bar.set_style(ProgressStyle::with_template(template).expect("the template is sound"));
    bar.enable_steady_tick(TICK);
    bar
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
    left: Option<Duration>,
    frame: u32,
    working: Vec<String>,
}

impl FrameProgress {
    /// Creates the progress of `count` frames. `lines` prints a line per node; `terminal` draws a
    /// bar.
    pub fn new(count: usize, lines: bool, terminal: bool) -> FrameProgress {
        let bar = terminal.then(|| {
            let bar = bar("{bar:30} {pos}/{len} frames  {wide_msg}");
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
        state.left = state.time_left(self.count);
        if let Some(bar) = &state.bar {
            bar.set_position(state.done as u64);
        }
        if !self.terminal {
            let what = if ran > 0 {
                format!("{ran} nodes ran in {seconds:.2} s")
            } else {
                "cached".to_owned()
            };
            let left = state.left.map(|left| format!(", {} left", HumanDuration(left)));
            let left = left.unwrap_or_default();
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
            let left = self.left.map(|left| format!("{} left  ", HumanDuration(left)));
            let left = left.unwrap_or_default();
            bar.set_message(format!("{left}frame {}: {}", self.frame, self.working.join(" ")));
        }
    }

    /// Time left, from the mean time of computed frames. The first of them is left out: it computes
    /// the shared results.
    fn time_left(&self, count: usize) -> Option<Duration> {
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
    fn needs(&self, kinds: &[&str]) {
        self.state().work.needs(kinds);
    }

    fn started(&self, node: &str) {
        let mut state = self.state();
        state.working.push(node.to_owned());
        // Created late, so that a run of hits alone draws no bar.
        if self.shown && state.bar.is_none() {
            let bar = bar("{bar:30} {percent}%  {wide_msg}");
            bar.set_length(STEPS as u64);
            state.bar = Some(bar);
        }
        state.draw();
    }

    fn finished(&self, report: &NodeReport) {
        let mut state = self.state();
        state.work.finished(report.kind, report.status);
        state.working.retain(|name| *name != report.name);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_left_follows_the_work_and_not_the_count() {
        let all = ["InitLights", "Mesh", "MNet"].map(cost);
        let mut work = Work { total: all.iter().sum::<f64>() + 20.0 * SHORT, done: 0.0 };
        let elapsed = Duration::from_secs(8);
        assert_eq!(work.left(elapsed), None);
        for _ in 0..20 {
            work.finished("Mix", Status::Ran);
        }
        assert_eq!(work.left(elapsed), None, "twenty short nodes are hardly any work");
        work.finished("Mesh", Status::Hit);
        work.finished("InitLights", Status::Ran);
        let left = work.left(elapsed).expect("much is done").as_secs_f64();
        assert!((left - 8.0 * cost("MNet") / (cost("InitLights") + 20.0 * SHORT)).abs() < 1e-6);
        work.finished("MNet", Status::Ran);
        assert_eq!(work.left(elapsed), Some(Duration::ZERO));
    }
}
