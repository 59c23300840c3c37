//! The state that a job leaves beside its results, and that of a whole command.

use std::path::Path;

use relight::graph::{self, Diagnostic};
use serde::{Deserialize, Serialize};

use super::list::Job;
use crate::cli::report;
use crate::cli::store::Traffic;
use crate::cli::write::Output;

/// The folder of states of commands, in that of the results.
pub const FOLDER: &str = "batch";
const MOST: u64 = 16 << 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    Done,
    Failed,
    Interrupted,
}

/// `job.json`: the outcome of a job.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct State {
    pub status: Status,
    /// Digest of all that the job reads. A job whose digest is the same is not run again.
    pub inputs: String,
    /// The reason of a failure, with its place.
    pub cause: Option<String>,
    pub seconds: f64,
    pub rays: u64,
    /// Nodes that ran, and nodes that were hits.
    pub ran: usize,
    pub hits: usize,
    pub warnings: Vec<String>,
    /// The result files.
    pub files: Vec<String>,
    /// A small picture of the result.
    pub thumbnail: Option<String>,
}

impl State {
    /// A job that failed before it ran.
    pub fn failed(inputs: String, cause: String, seconds: f64) -> State {
        State {
            status: Status::Failed,
            inputs,
            cause: Some(cause),
            seconds,
            rays: 0,
            ran: 0,
            hits: 0,
            warnings: Vec::new(),
            files: Vec::new(),
            thumbnail: None,
        }
    }

    /// The state of a job, if it has run.
    pub fn read(out: &Path, job: &Job) -> Option<State> {
        let bytes = graph::read(&out.join(&job.out).join(name(job)), MOST).ok()?;
        serde_json::from_slice(&bytes).ok()
    }

    /// Whether the job is done, with these inputs, and its files are there.
    pub fn is_done(&self, out: &Path, job: &Job, inputs: &str) -> bool {
        let folder = out.join(&job.out);
        self.status == Status::Done
            && self.inputs == inputs
            && self.files.iter().all(|file| folder.join(file).is_file())
    }

    /// # Errors
    /// The folder cannot be written.
    pub fn write(&self, out: &Path, job: &Job) -> Result<(), Diagnostic> {
        let folder = Output::new(&out.join(&job.out), [], false)?;
        folder.file(&name(job), report::text(self).as_bytes()).map(drop)
    }
}

fn name(job: &Job) -> String {
    format!("job{}.json", job.suffix())
}

/// `batch/run.json`, `batch/task_00012.json`: what a command cost.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Run {
    pub jobs: usize,
    /// Jobs that were done before.
    pub done_before: usize,
    pub failed: usize,
    /// Wall time and processor time.
    pub seconds: f64,
    pub cpu_seconds: f64,
    pub peak_bytes: Option<u64>,
    /// Most photos at a time.
    pub at_once: usize,
    /// Requests and bytes of the shared store.
    pub traffic: Option<Traffic>,
}

/// # Errors
/// The folder cannot be written.
pub fn write_run(out: &Path, name: &str, run: &Run) -> Result<(), Diagnostic> {
    let folder = Output::new(&out.join(FOLDER), [], false)?;
    folder.file(name, report::text(run).as_bytes()).map(drop)
}
