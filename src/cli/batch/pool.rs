//! The jobs of a batch on the cores of this machine: as many photos at a time as there are threads
//! and as memory allows, each on an engine of its own that stays warm over its jobs.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use relight::graph::{BlobStore, CacheFolder, Cancel, Diagnostic, Engine, EngineOptions};

use super::args::BatchArgs;
use super::job::{self, Last};
use super::list::List;
use super::memory;
use super::progress::Progress;
use super::state::{Run, State, Status};
use crate::cli::cache;
use crate::cli::engine::{Host, engine, stop_on_ctrl_c};
use crate::cli::exit::CliError;
use crate::cli::report::peak_bytes;

/// Most memory for results of a photo that no running node needs, bytes.
const RESULTS: u64 = 1 << 30;

/// The end of a command.
pub struct Ended {
    pub run: Run,
    pub warnings: Vec<String>,
    pub interrupted: bool,
}

impl Ended {
    /// One line.
    pub fn summary(&self, elapsed: Duration) -> String {
        let Run { jobs, done_before, failed, at_once, cpu_seconds, peak_bytes, .. } = &self.run;
        let peak = peak_bytes
            .map_or(String::new(), |peak| format!(", {:.2} GB at most", peak as f64 * 1e-9));
        format!(
            "{jobs} jobs, {done_before} done before, {failed} failed, in {:.1} s ({cpu_seconds:.1} s of processor time, {at_once} photos at a time{peak})",
            elapsed.as_secs_f64()
        )
    }
}

/// Photos in flight and the memory that they may take.
struct Flight {
    limit: u64,
    /// Most memory for results that no running node needs, per photo, bytes.
    results: u64,
    threads: usize,
    at_once: usize,
    state: Mutex<InFlight>,
    landed: Condvar,
}

#[derive(Default)]
struct InFlight {
    next: usize,
    flying: usize,
    most: usize,
    expected: u64,
    /// Peak memory of one photo, as measured so far.
    measured: u64,
}

/// Runs `jobs` of a list; the outcome of each is written beside its results.
///
/// # Errors
/// The engine cannot be started, or states cannot be written.
pub fn run(args: &BatchArgs, list: &List, jobs: &[usize]) -> Result<Ended, CliError> {
    let began = Instant::now();
    let store = cache::store(&args.cache)?;
    let folder = cache::folder_of(&args.cache, store.clone())?;
    let cancel = Cancel::default();
    stop_on_ctrl_c(&cancel)?;
    let photos = list.photos(jobs);
    let cores = || std::thread::available_parallelism().map_or(1, usize::from);
    let threads = args.threads.map_or_else(cores, usize::from);
    let at_once = args.photos.map_or(threads, usize::from).min(photos.len()).max(1);
    let limit = memory::limit(args.memory);
    let results = (limit / at_once as u64 / 2).min(RESULTS);
    let flight = Flight {
        limit,
        results,
        threads,
        at_once,
        state: Mutex::default(),
        landed: Condvar::new(),
    };
    let progress = Progress::new(&photos);
    let [done_before, failed, stopped] = [const { AtomicUsize::new(0) }; 3];
    let faults = Mutex::new(Vec::new());
    let work = || {
        while let Some((at, threads, expected)) = flight.take_off(&photos, list) {
            let photo = &photos[at];
            let outcome = host(list, photo[0], folder.as_ref(), (threads, results));
            match outcome.map(|engine| Host { engine, cancel: cancel.clone() }) {
                Err(fault) => faults.lock().unwrap_or_else(PoisonError::into_inner).push(fault),
                Ok(host) => {
                    let mut last = Last::default();
                    for (number, &at) in photo.iter().enumerate() {
                        if cancel.is_cancelled() {
                            stopped.fetch_add(1, Ordering::Relaxed);
                            continue;
                        }
                        let job = &list.jobs[at];
                        let (state, before) = job::run((args, list, job), &host, &mut last);
                        if let Some(fault) = record(list, at, &state, before) {
                            faults.lock().unwrap_or_else(PoisonError::into_inner).push(fault);
                        }
                        let count = |counter: &AtomicUsize, counts: bool| {
                            counter.fetch_add(usize::from(counts), Ordering::Relaxed);
                        };
                        count(&done_before, before);
                        count(&failed, state.status == Status::Failed);
                        count(&stopped, state.status == Status::Interrupted);
                        progress.ended(&job.name(), &state, before, number == 0);
                    }
                }
            }
            flight.land(expected);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..at_once {
            scope.spawn(work);
        }
    });
    progress.end();
    let left = store.as_ref().map_or(0, |store| store.flush());
    let mut warnings = store.as_ref().map_or(Vec::new(), |store| store.take_warnings());
    if left > 0 {
        warnings.push(format!("{left} results were not uploaded to the cache store in time"));
    }
    if let Some(fault) = faults.into_inner().unwrap_or_else(PoisonError::into_inner).pop() {
        return Err(fault.into());
    }
    let most = flight.state.into_inner().unwrap_or_else(PoisonError::into_inner).most;
    let run = Run {
        jobs: jobs.len(),
        done_before: done_before.into_inner(),
        failed: failed.into_inner(),
        seconds: began.elapsed().as_secs_f64(),
        cpu_seconds: memory::cpu_seconds(),
        peak_bytes: peak_bytes(),
        at_once: most,
        traffic: store.map(|store| store.traffic()),
    };
    Ok(Ended { run, warnings, interrupted: stopped.into_inner() > 0 })
}

/// Writes the outcome of a job, unless it was stopped or is as it was.
fn record(list: &List, at: usize, state: &State, before: bool) -> Option<Diagnostic> {
    if before || state.status == Status::Interrupted {
        return None;
    }
    state.write(&list.out, &list.jobs[at]).err()
}

/// The engine of one photo.
fn host(
    list: &List,
    job: usize,
    folder: Option<&CacheFolder>,
    (threads, memory_bytes): (usize, u64),
) -> Result<Engine, Diagnostic> {
    engine(EngineOptions {
        cache: folder.cloned(),
        project: cache::project(&list.graph, Some(&list.jobs[job].scene)),
        threads: Some(threads),
        memory_bytes,
        ..EngineOptions::default()
    })
}

impl Flight {
    /// The next photo, its threads and its expected memory, once there is room for that.
    fn take_off(&self, photos: &[Vec<usize>], list: &List) -> Option<(usize, usize, u64)> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            let at = state.next;
            let photo = photos.get(at)?;
            let expected =
                memory::expected(&list.jobs[photo[0]].scene, self.results).max(state.measured);
            if state.flying == 0 || state.expected + expected <= self.limit {
                state.next += 1;
                state.flying += 1;
                state.most = state.most.max(state.flying);
                state.expected += expected;
                // Threads of photos that will not come go to those that are left.
                let left = (photos.len() - at + state.flying - 1).min(self.at_once);
                return Some((at, (self.threads / left).max(1), expected));
            }
            state = self.landed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// A photo that was expected to take so much memory has landed.
    fn land(&self, expected: u64) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let of_one = peak_bytes().map_or(0, |peak| peak / state.most as u64);
        state.expected -= expected;
        state.flying -= 1;
        state.measured = state.measured.max(of_one);
        self.landed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::batch::list::Job;

    #[test]
    fn a_photo_waits_until_there_is_memory_for_it() {
        let job = |name: &str| Job {
            scene: name.into(),
            edit: None,
            frames: None,
            set: Vec::new(),
            out: name.into(),
            task: None,
        };
        let list = List::of_jobs(["no/a", "no/b", "no/c"].map(job).into());
        let photos = vec![vec![0], vec![1], vec![2]];
        let one = memory::expected("no/a".as_ref(), 0);
        let flight = Flight {
            limit: 2 * one,
            results: 0,
            threads: 8,
            at_once: 4,
            state: Mutex::default(),
            landed: Condvar::new(),
        };
        // Three photos share the threads; memory has room for two.
        assert_eq!(flight.take_off(&photos, &list), Some((0, 2, one)));
        assert_eq!(flight.take_off(&photos, &list), Some((1, 2, one)));
        let third = std::thread::scope(|scope| {
            let third = scope.spawn(|| flight.take_off(&photos, &list));
            std::thread::sleep(Duration::from_millis(50));
            assert!(!third.is_finished(), "it waits");
            flight.land(one);
            third.join().expect("it does not panic")
        });
        assert!(matches!(third, Some((2, 4, _))), "{third:?}");
        let state = flight.state.lock().expect("nobody panicked");
        assert_eq!((state.flying, state.most), (2, 2));
        drop(state);
        assert_eq!(flight.take_off(&photos, &list), None);
    }

    #[test]
    fn a_photo_larger_than_the_limit_flies_alone() {
        let list = List::of_jobs(vec![Job {
            scene: "no".into(),
            edit: None,
            frames: None,
            set: Vec::new(),
            out: "no".into(),
            task: None,
        }]);
        let state = Mutex::default();
        let flight =
            Flight { limit: 1, results: 0, threads: 2, at_once: 1, state, landed: Condvar::new() };
        assert!(flight.take_off(&[vec![0]], &list).is_some());
    }
}
