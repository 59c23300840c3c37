//! The interface between a running stage and the engine, and the errors of a stage.

use std::any::{Any, TypeId};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Instant;

use super::Digest;
use super::reading::File;

/// Why a stage gave no result.
#[derive(Debug, Clone, thiserror::Error)]
pub enum NodeError {
    /// A file that a person named cannot be used: the message states the wanted and the actual
    /// content, and the place.
    #[error("{path}: {message}")]
    BadFile {
        /// Path as the message shows it.
        path: String,
        /// The wanted and the actual content.
        message: String,
    },
    /// Several files cannot be used: a message for each, with its path.
    #[error("{}", .0.join("; "))]
    BadFiles(Vec<String>),
    /// A parameter cannot be used with these inputs: the message states its name, the wanted and
    /// the actual value.
    #[error("{0}")]
    BadParameter(String),
    /// The inputs are sound one by one, but this stage cannot work with them.
    #[error("{0}")]
    Failed(String),
    /// The run was cancelled.
    #[error("cancelled")]
    Cancelled,
}

/// A flag that cancels a run; stages read it between pieces of work.
#[derive(Clone, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// Requests the end of the run; stages notice it at their next check.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether [`Cancel::cancel`] was called.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// A running stage's link to the engine: its files, its meters, its warnings.
#[derive(Default)]
pub struct Context {
    pub(super) cancel: Cancel,
    /// Digests of the files of this node, as its key contains them.
    pub(super) digests: Vec<(File, Digest)>,
    pub(super) shared: Shared,
    /// When the budget ends, where there is one.
    deadline: Option<Instant>,
    /// Whether the stage has been stopped by its budget.
    late: AtomicBool,
    rays: AtomicU64,
    meters: Mutex<Meters>,
}

/// Values that a program lends its stages, one of each type. Keys do not contain them, so results
/// must not depend on them.
#[derive(Clone, Default)]
pub struct Services(BTreeMap<TypeId, Arc<dyn Any + Send + Sync>>);

impl Services {
    /// Adds a service; stages find it by its type. A second one of a type replaces the first.
    pub fn with<T: Any + Send + Sync>(mut self, service: T) -> Services {
        self.0.insert(TypeId::of::<T>(), Arc::new(service));
        self
    }
}

impl std::fmt::Debug for Services {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{} services", self.0.len())
    }
}

/// State that the nodes of an engine share.
#[derive(Clone, Default)]
pub(super) struct Shared {
    services: Services,
    /// Values made from files, each once.
    made: Arc<Mutex<BTreeMap<MadeOf, Arc<OnceLock<Made>>>>>,
}

impl Shared {
    /// Creates the shared part of the contexts of one engine.
    pub fn new(services: Services) -> Shared {
        Shared { services, ..Shared::default() }
    }
}

/// The digest of the file, and the name of the derived value.
type MadeOf = ([u8; 32], String);
type Made = Result<Arc<dyn Any + Send + Sync>, NodeError>;

#[derive(Default)]
struct Meters {
    stderr: Option<f64>,
    samples: Option<f64>,
    warnings: Vec<String>,
    notes: Vec<String>,
}

impl Context {
    /// Creates the context of one node. `digests` lists the declared files that the node may read.
    pub(super) fn new(
        cancel: Cancel,
        digests: Vec<(File, Digest)>,
        shared: Shared,
        deadline: Option<Instant>,
    ) -> Context {
        Context { cancel, digests, shared, deadline, ..Context::default() }
    }

    /// The bytes of a file that the node declared in [`super::Node::files`].
    ///
    /// # Errors
    /// The file cannot be read, or has changed since its digest was made.
    pub fn read(&self, file: &File) -> Result<Vec<u8>, NodeError> {
        let bad = |message: String| NodeError::BadFile {
            path: file.location().display().to_string(),
            message,
        };
        let bytes = file.read().map_err(|e| bad(format!("cannot be read: {e}")))?;
        if let Some((_, wanted)) = self.digests.iter().find(|(f, _)| f == file)
            && *blake3::hash(&bytes).as_bytes() != wanted.0
        {
            return Err(bad("changed while the run was reading it; run again".into()));
        }
        Ok(bytes)
    }

    /// Returns the value that `make` derives from the bytes of a declared file. It is made once for
    /// all nodes of the engine that request it under the same `name`, and kept as long as the
    /// engine.
    ///
    /// # Errors
    /// The errors of reading the file and of `make`; two types under one name.
    ///
    /// # Panics
    /// Another thread panicked while it looked up a shared value.
    pub fn shared<T: Send + Sync + 'static>(
        &self,
        file: &File,
        name: &str,
        make: impl FnOnce(Vec<u8>) -> Result<T, NodeError>,
    ) -> Result<Arc<T>, NodeError> {
        let digest = self.digests.iter().find(|(f, _)| f == file).map(|(_, digest)| digest.0);
        let open = || -> Made { Ok(Arc::new(make(self.read(file)?)?)) };
        let made = match digest {
            Some(digest) => {
                let mut all =
                    self.shared.made.lock().expect("nothing panics while it holds this lock");
                let cell = all.entry((digest, name.to_owned())).or_default().clone();
                drop(all);
                cell.get_or_init(open).clone()
            }
            // Outside of an engine nothing is known of the file yet.
            None => open(),
        };
        made?
            .downcast()
            .map_err(|_| NodeError::Failed(format!("{name}: made twice, as two different types")))
    }

    /// Returns the value of this type that the program lends ([`super::EngineOptions::services`]).
    pub fn service<T: Any>(&self) -> Option<&T> {
        self.shared.services.0.get(&TypeId::of::<T>())?.downcast_ref()
    }

    /// Returns the flag that cancels the run, for work that outlives a borrow of the context.
    pub fn cancel(&self) -> Cancel {
        self.cancel.clone()
    }

    /// Stops the stage when the run was cancelled. Call it between rows or passes.
    ///
    /// # Errors
    /// [`NodeError::Cancelled`] once the run was cancelled.
    pub fn check_cancelled(&self) -> Result<(), NodeError> {
        if self.cancel.is_cancelled() { Err(NodeError::Cancelled) } else { Ok(()) }
    }

    /// Whether the run has a budget, so that it is worth to begin with little.
    pub fn has_budget(&self) -> bool {
        self.deadline.is_some()
    }

    /// Whether to stop with the samples so far: the time of the budget is over, or the run was
    /// cancelled. Once this has returned true, its result is used in this run and not kept, as it
    /// depends on more than its key.
    pub fn out_of_time(&self) -> bool {
        #[expect(
            clippy::disallowed_methods,
            reason = "holds the node to its budget; a result cut short is not kept"
        )]
        let late = self.deadline.is_some_and(|deadline| Instant::now() >= deadline);
        if late {
            self.late.store(true, Ordering::Relaxed);
        }
        late || self.cancel.is_cancelled()
    }

    /// Whether the budget cut the result short.
    pub(super) fn was_late(&self) -> bool {
        self.late.load(Ordering::Relaxed)
    }

    /// Counts rays traced, for the run table.
    pub fn count_rays(&self, rays: u64) {
        self.rays.fetch_add(rays, Ordering::Relaxed);
    }

    /// Records the stage's mean relative standard error, for the run table.
    pub fn set_stderr(&self, relative: f64) {
        self.lock().stderr = Some(relative);
    }

    /// Records how many samples an estimate took, on the mean, for the run table.
    pub fn set_samples(&self, mean: f64) {
        self.lock().samples = Some(mean);
    }

    /// Adds a warning, which is not an error: it is shown after the run and kept with the cached
    /// result.
    pub fn warn(&self, message: impl Into<String>) {
        self.lock().warnings.push(message.into());
    }

    /// Adds a note about the result that needs no action: it is written to report.json and kept
    /// with the cached result.
    pub fn note(&self, message: impl Into<String>) {
        self.lock().notes.push(message.into());
    }

    /// Returns the number of rays that the stage has counted.
    pub fn rays(&self) -> u64 {
        self.rays.load(Ordering::Relaxed)
    }

    /// Returns the recorded mean relative standard error, if there is one.
    pub fn stderr(&self) -> Option<f64> {
        self.lock().stderr
    }

    /// Returns the recorded mean number of samples, if there is one.
    pub fn samples(&self) -> Option<f64> {
        self.lock().samples
    }

    /// Returns the warnings so far, in the order of their calls.
    pub fn warnings(&self) -> Vec<String> {
        self.lock().warnings.clone()
    }

    /// Returns the notes so far, in the order of their calls.
    pub fn notes(&self) -> Vec<String> {
        self.lock().notes.clone()
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Meters> {
        self.meters.lock().expect("no stage panics while it holds its own meters")
    }
}
