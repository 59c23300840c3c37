//! Progress of a batch: a line per job with the time left, and a bar on a terminal.

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::state::{State, Status};
use crate::cli::messages::{message, shows_progress};

/// Progress of all jobs.
pub struct Progress {
    began: Instant,
    state: Mutex<Work>,
    bar: Option<ProgressBar>,
}

/// Jobs and their times. The first job of a photo computes what its others share.
#[derive(Default)]
struct Work {
    count: usize,
    ended: usize,
    failed: usize,
    /// Jobs to come, jobs that ran and seconds of these: of first jobs, and of the others.
    kinds: [(usize, usize, f64); 2],
}

impl Progress {
    /// Jobs of photos, each with this number of them.
    pub fn new(photos: &[Vec<usize>]) -> Progress {
        let count: usize = photos.iter().map(Vec::len).sum();
        let kinds = [(photos.len(), 0, 0.0), (count - photos.len(), 0, 0.0)];
        let bar = shows_progress().then(|| {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
            let style = ProgressStyle::with_template("{bar:30} {pos}/{len} jobs  {wide_msg}");
            bar.set_style(style.expect("the template is sound"));
            bar.set_length(count as u64);
            bar
        });
        let state = Mutex::new(Work { count, kinds, ..Work::default() });
        Progress { began: Instant::now(), state, bar }
    }

    /// A job has ended; `is_first` of its photo.
    pub fn ended(&self, name: &str, state: &State, before: bool, is_first: bool) {
        let mut work = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        work.ended(state.status, (!before).then_some(state.seconds), is_first);
        let outcome = match state.status {
            Status::Done if before => "done before".to_owned(),
            Status::Done => format!("{:.2} s", state.seconds),
            Status::Interrupted => "stopped".to_owned(),
            Status::Failed => {
                let cause = state.cause.as_deref().unwrap_or_default();
                format!("failed: {}", cause.lines().next().unwrap_or_default())
            }
        };
        let left = work.left(self.began.elapsed().as_secs_f64());
        let left = left.map(std::time::Duration::from_secs_f64);
        let left = left.map_or(String::new(), |left| format!(", {} left", HumanDuration(left)));
        let failed = match work.failed {
            0 => String::new(),
            failed => format!(", {failed} failed"),
        };
        let line = format!("[{}/{}] {name}: {outcome}{left}{failed}", work.ended, work.count);
        match &self.bar {
            Some(bar) => {
                bar.set_position(work.ended as u64);
                bar.set_message(format!("{}{failed}", left.trim_start_matches(", ")));
                if state.status == Status::Failed {
                    bar.suspend(|| message!("{line}"));
                }
            }
            None => message!("{line}"),
        }
    }

    /// Removes the bar.
    pub fn end(&self) {
        self.bar.iter().for_each(ProgressBar::finish_and_clear);
    }
}

impl Work {
    fn ended(&mut self, status: Status, seconds: Option<f64>, is_first: bool) {
        self.ended += 1;
        self.failed += usize::from(status == Status::Failed);
        let (to_come, ran, sum) = &mut self.kinds[usize::from(!is_first)];
        *to_come -= 1;
        if let Some(seconds) = seconds {
            (*ran, *sum) = (*ran + 1, *sum + seconds);
        }
    }

    /// Seconds left after `elapsed`: the work to come, at the speed so far.
    fn left(&self, elapsed: f64) -> Option<f64> {
        let total: f64 = self.kinds.iter().map(|(_, _, sum)| sum).sum();
        let ran: usize = self.kinds.iter().map(|(_, ran, _)| ran).sum();
        if ran == 0 || total == 0.0 || self.ended == self.count {
            return None;
        }
        let mean = |(_, ran, sum): &(usize, usize, f64)| {
            if *ran > 0 { *sum / *ran as f64 } else { total / self.ended as f64 }
        };
        let to_come: f64 = self.kinds.iter().map(|kind| kind.0 as f64 * mean(kind)).sum();
        Some((to_come * elapsed / total).max(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_counts_first_jobs_and_others_apart() {
        // Two photos of three edits: 10 s for the first of each, 1 s for the others, two at a time.
        let mut work = Work { count: 6, kinds: [(2, 0, 0.0), (4, 0, 0.0)], ..Work::default() };
        assert_eq!(work.left(1.0), None);
        work.ended(Status::Done, Some(10.0), true);
        work.ended(Status::Done, Some(1.0), false);
        work.ended(Status::Failed, Some(1.0), false);
        let left = work.left(6.0).expect("three are done");
        assert!((left - (10.0 + 2.0) * 6.0 / 12.0).abs() < 1e-9, "{left}");
        assert_eq!(work.failed, 1);
    }
}
