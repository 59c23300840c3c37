//! The engine: options, cache, thread pool, and the questions one may ask it.

use std::path::PathBuf;

use super::context::Cancel;
use super::network::{Graph, Wanted};
use super::report::{Explanation, Observer, PlanLine, RunReport, VerifyReport};
use super::source::Fault;

/// How an engine works. None of it but `backend` changes what comes out.
#[derive(Clone, Debug)]
pub struct EngineOptions {
    /// Where results are kept between runs; `None` keeps them in memory only.
    pub cache_dir: Option<PathBuf>,
    /// Most memory for results that no running node needs.
    pub memory_bytes: u64,
    /// Most disk space for results.
    pub disk_bytes: u64,
    /// Threads; `None` takes all that the machine has.
    pub threads: Option<usize>,
    /// Whatever else numbers depend on (numeric backend, global seed): one line of every key.
    pub backend: String,
}

impl Default for EngineOptions {
    fn default() -> EngineOptions {
        EngineOptions {
            cache_dir: None,
            memory_bytes: 1 << 30,
            disk_bytes: 10 << 30,
            threads: None,
            backend: "cpu".to_owned(),
        }
    }
}

/// Runs graphs, and keeps what they gave.
pub struct Engine {}

impl Engine {
    /// Starts the threads. The cache folder is made when the first result is stored.
    pub fn new(options: EngineOptions) -> std::io::Result<Engine> {
        let _ = options;
        todo!()
    }

    /// Makes what is wanted, running only nodes whose key is new.
    pub fn run(&self, graph: &Graph, wanted: &Wanted, cancel: &Cancel, observer: &dyn Observer) -> RunReport {
        let _ = (graph, wanted, cancel, observer);
        todo!()
    }

    /// What [`Engine::run`] would do, node by node, without doing it.
    pub fn plan(&self, graph: &Graph, wanted: &Wanted) -> Vec<PlanLine> {
        let _ = (graph, wanted);
        todo!()
    }

    /// Why `node` (an instance: `direct[lamp_0]`) would run again: its key text against the last one of that name.
    pub fn explain(&self, graph: &Graph, node: &str) -> Result<Explanation, Fault> {
        let _ = (graph, node);
        todo!()
    }

    /// Runs, makes every hit again, and compares.
    pub fn verify(&self, graph: &Graph, wanted: &Wanted, cancel: &Cancel, observer: &dyn Observer) -> VerifyReport {
        let _ = (graph, wanted, cancel, observer);
        todo!()
    }
}
