//! The report of a run: one entry per node, warnings, outputs.

use std::sync::Arc;

use super::{Artifact, Digest, PortValue};

/// The final state of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// Its result was there already.
    Hit,
    /// Its stage ran and gave its outputs.
    Ran,
    /// Its stage ran and gave an error.
    Failed,
    /// Not run, because something it depends on failed.
    Blocked,
    /// Not run, or not to its end, because the run was cancelled.
    Cancelled,
}

impl std::fmt::Display for Status {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Status::Hit => "hit",
            Status::Ran => "ran",
            Status::Failed => "failed",
            Status::Blocked => "blocked",
            Status::Cancelled => "cancelled",
        })
    }
}

/// One node instance of a run.
#[derive(Clone, Debug, serde::Serialize)]
pub struct NodeReport {
    /// `direct[lamp_0]`
    pub name: String,
    /// Kind of the node's stage.
    pub kind: &'static str,
    /// Final state.
    pub status: Status,
    /// Wall time of the stage itself; 0 unless it ran.
    pub seconds: f64,
    /// Rays that were traced in this run; 0 unless it ran.
    pub rays: u64,
    /// Mean number of samples of the estimates made in this run, where the stage records one; none
    /// unless it ran.
    pub samples: Option<f64>,
    /// Mean relative standard error of the result, where the stage records one (also of a result
    /// that was there already).
    pub stderr: Option<f64>,
    /// Memory that the outputs take.
    pub bytes: u64,
    /// Key of the result; `None` when an input never came.
    pub key: Option<Digest>,
    /// Why a node ran: `new`, or the first line of its key that changed.
    pub why: Option<String>,
    /// Warnings of the stage.
    pub warnings: Vec<String>,
    /// Notes of the stage about its result that need no action.
    pub notes: Vec<String>,
    /// The error of a failed node, or the node that blocked it.
    pub error: Option<String>,
    /// It failed because of a file that a person named, or a parameter that a person set.
    pub bad_file: bool,
}

/// The way in which a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// Every node gave its result.
    Complete,
    /// A stage failed.
    Failed,
    /// Stages failed, all because of a file that a person named or a parameter that a person set.
    BadInput,
    /// The run was cancelled.
    Cancelled,
}

/// The report and the outputs of a run.
#[derive(Default)]
pub struct RunReport {
    /// In topological, then declaration order.
    pub nodes: Vec<NodeReport>,
    /// The wanted outputs that were made, by the name they were wanted under.
    pub outputs: Vec<(String, PortValue)>,
    /// Warnings of the cache, that belong to no node.
    pub warnings: Vec<String>,
    /// Most memory that values took at one time.
    pub peak_bytes: u64,
    /// Wall time of the run.
    pub seconds: f64,
}

impl RunReport {
    /// Whether every node gave its result.
    pub fn is_complete(&self) -> bool {
        self.nodes.iter().all(|n| matches!(n.status, Status::Hit | Status::Ran))
    }

    /// The nodes that gave no result by an error of their own.
    pub fn failed(&self) -> impl Iterator<Item = &NodeReport> {
        self.nodes.iter().filter(|node| node.status == Status::Failed)
    }

    /// The way in which the run ended; a cancelled run counts as cancelled even if a node failed.
    pub fn ending(&self) -> Ending {
        if self.nodes.iter().any(|n| n.status == Status::Cancelled) {
            Ending::Cancelled
        } else if self.failed().next().is_none() {
            Ending::Complete
        } else if self.failed().all(|n| n.bad_file) {
            Ending::BadInput
        } else {
            Ending::Failed
        }
    }

    /// The value that was wanted as `name`.
    pub fn output(&self, name: &str) -> Option<&PortValue> {
        self.outputs.iter().find(|(n, _)| n == name).map(|(_, value)| value)
    }

    /// The value of output `name`; `None` where it was not made, has another type, or has a value
    /// per member.
    pub fn value<T: Artifact>(&self, name: &str) -> Option<Arc<T>> {
        match self.output(name)? {
            PortValue::One(value) => value.get(),
            _ => None,
        }
    }

    /// The first failed node and its error.
    pub fn error(&self) -> Option<(&str, &str)> {
        self.nodes.iter().find_map(|node| Some((node.name.as_str(), node.error.as_deref()?)))
    }

    /// The names of the nodes with this status.
    pub fn with_status(&self, status: Status) -> Vec<&str> {
        self.nodes.iter().filter(|n| n.status == status).map(|n| n.name.as_str()).collect()
    }
}

/// Watches a run. Calls come from any thread.
pub trait Observer: Sync {
    /// The run needs nodes of these kinds more: once before any work, and again when a condition
    /// turns out to hold.
    fn needs(&self, _kinds: &[&str]) {}
    /// A node's stage begins to work; not called for hits.
    fn started(&self, _node: &str) {}
    /// A node is done. Called again for a hit whose stored values turn out to be damaged when they
    /// are needed.
    fn finished(&self, _report: &NodeReport) {}
}

impl Observer for () {}

/// The expected state of a node in a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Planned {
    /// Its result is in the cache.
    Hit,
    /// It has to run.
    Run,
    /// Depends on the result of an upstream node that has to run first.
    Unknown,
    /// Its condition does not hold.
    Skip,
}

impl std::fmt::Display for Planned {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Planned::Hit => "hit",
            Planned::Run => "run",
            Planned::Unknown => "unknown",
            Planned::Skip => "skip",
        })
    }
}

/// One line of [`super::Engine::plan`].
#[derive(Clone, Debug, serde::Serialize)]
pub struct PlanLine {
    /// Node instance: `direct[lamp_0]`.
    pub node: String,
    /// Kind of the node's stage.
    pub kind: &'static str,
    /// Expected state.
    pub status: Planned,
    /// The reason why it has to run, or the node that it waits for.
    pub why: Option<String>,
}

/// Answer of [`super::Engine::explain`].
#[derive(Clone, Debug, serde::Serialize)]
pub struct Explanation {
    /// Node instance: `direct[lamp_0]`.
    pub node: String,
    /// Expected state.
    pub status: Planned,
    /// One sentence: `parameter samples: 16 -> 32`.
    pub why: String,
    /// The first line of the key manifest that differs from the last stored one, as it was and as
    /// it is.
    pub old: Option<String>,
    /// The line of the current key manifest in the place of `old`.
    pub new: Option<String>,
    /// The whole key manifest, where it is known.
    pub key_manifest: Option<String>,
}

/// A result that came out differently when [`super::Engine::verify`] made it again.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Difference {
    /// Node instance: `direct[lamp_0]`.
    pub node: String,
    /// Output port, with the member where there is one: `mask[lamp_0]`.
    pub port: String,
    /// Digest of the stored value; `None` where nothing was stored.
    pub stored: Option<Digest>,
    /// Digest of the recomputed value; `None` without a value.
    pub computed: Option<Digest>,
}

/// Answer of [`super::Engine::verify`].
pub struct VerifyReport {
    /// Report of the run that recomputed the results.
    pub run: RunReport,
    /// The results that differ.
    pub differences: Vec<Difference>,
}
