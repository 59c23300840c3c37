//! `relight batch`: photos x edits x frames of a list, on this machine or as tasks of a scheduler.
//!
//! `list.rs` expands the list into jobs, `pool.rs` runs them photo by photo, each photo on one
//! engine that stays warm over its edits. Each job leaves its state beside its results
//! (`state.rs`), so that a batch that was stopped goes on there, and tasks on several machines need
//! no other channel. `summary.rs` makes page and table of the states, `plan.rs` the scripts of a
//! scheduler.

mod args;
mod job;
mod list;
mod memory;
mod plan;
mod pool;
mod progress;
mod state;
mod summary;

use std::time::Instant;

pub use args::BatchArgs;

use super::exit::{CliError, Exit};
use super::messages::message;
use super::write;
use list::List;

/// Runs `relight batch`.
///
/// # Errors
/// Arguments, list or table that cannot be used; jobs with faults are told in the summary.
pub fn batch(args: &BatchArgs, began: Instant) -> Result<Exit, CliError> {
    let list = List::read(args)?;
    if let Some(target) = &args.plan {
        return plan::write(args, &list, target);
    }
    if args.finish {
        return finish(&list);
    }
    let jobs: Vec<usize> = match args.task {
        None => (0..list.jobs.len()).collect(),
        Some(task) => {
            let jobs: Vec<usize> =
                (0..list.jobs.len()).filter(|&at| list.jobs[at].task == Some(task)).collect();
            if jobs.is_empty() {
                return Err(list.no_task(task).into());
            }
            jobs
        }
    };
    let ended = pool::run(args, &list, &jobs)?;
    ended.warnings.iter().for_each(|warning| message!("warning: {warning}"));
    message!("{}", ended.summary(began.elapsed()));
    if let Some(traffic) = &ended.run.traffic {
        message!("cache store: {traffic}");
    }
    let name = args.task.map_or("run.json".to_owned(), |task| format!("task_{task:05}.json"));
    state::write_run(&list.out, &name, &ended.run)?;
    if ended.interrupted {
        message!("stopped; the same command goes on there");
        return Ok(Exit::Interrupted);
    }
    if args.task.is_some() {
        // A job that failed is told by `--finish`, and stops no task that waits for this one.
        return Ok(Exit::Done);
    }
    finish(&list)
}

/// Makes films, page and table of what all jobs have left so far.
fn finish(list: &List) -> Result<Exit, CliError> {
    let summary = summary::Summary::read(list);
    let paths = summary.write(list)?;
    summary.tell();
    write::print_paths(&paths)?;
    Ok(if summary.is_whole() { Exit::Done } else { Exit::Failed })
}
