//! The engine: options, cache, thread pool; runs, plans and explanations.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use super::cache::{EarlierResults, Entry};
use super::context::{Cancel, Services, Shared};
use super::disk::{CacheFolder, DiskCache};
use super::inputs::{Before, holds, key_manifest, resolve_inputs};
use super::key;
use super::key::Why;
use super::report::{
    Difference, Explanation, Observer, PlanLine, Planned, RunReport, VerifyReport,
};
use super::resolved_graph::{ResolvedGraph, Wanted};
use super::run::{RunInProgress, RunOptions};
use super::source::Diagnostic;
use super::store::{Blobs, Store};

/// Options of an engine. Only `budget` changes results.
#[derive(Clone, Debug)]
pub struct EngineOptions {
    /// The folder that keeps results between runs; `None` keeps them in memory only.
    pub cache: Option<CacheFolder>,
    /// A name of the project, such as the scene's folder: a cache keeps the last keys of each,
    /// which determine why a node has to run again.
    pub project: String,
    /// Most memory for results that no running node needs.
    pub memory_bytes: u64,
    /// Most disk space for results.
    pub disk_bytes: u64,
    /// Threads; `None` takes all that the machine has.
    pub threads: Option<usize>,
    /// Time for each node that observes it ([`super::Context::out_of_time`]), from its start. A
    /// result that it cuts short is used in the run and not kept; complete results from the cache
    /// are used as usual.
    pub budget: Option<Duration>,
    /// Values of an earlier run that the cache does not store.
    pub earlier: Option<Arc<dyn EarlierResults>>,
    /// Values that stages may request ([`super::Context::service`]).
    pub services: Services,
}

impl Default for EngineOptions {
    fn default() -> EngineOptions {
        EngineOptions {
            cache: None,
            project: String::new(),
            memory_bytes: 1 << 30,
            disk_bytes: 10 << 30,
            threads: None,
            budget: None,
            earlier: None,
            services: Services::default(),
        }
    }
}

/// No machine that this runs on has more.
const MAX_THREADS: usize = 1024;

/// Stages run on stacks of this size: a thread that waits inside one stage may take up another on
/// the same stack.
const STACK_BYTES: usize = 32 << 20;

/// Runs graphs, and caches their results.
///
/// The example reads the photo of a scene. [`RunReport::value`] returns a plane of the run.
///
/// ```
/// use relight::files::scene;
/// use relight::graph::{Cancel, Engine, EngineOptions, GraphFile, Source};
/// use relight::{image::Picture, nodes};
///
/// let text = r#"Graph(version: 1, nodes: {"photo": (op: ReadPhoto(long_side: 64))}, outputs: ["photo.small"])"#;
/// let file = GraphFile::parse(Source::new("photo.ron", text)).expect("the text is a graph");
/// let settings = scene::read("tests/scenes/small".as_ref(), Some(&["ReadPhoto"])).expect("the scene is sound");
/// let graph = file.resolve(&nodes::registry(), &settings).expect("kinds, ports and files are there");
/// let wanted = graph.wanted(None).expect("the graph names an output");
/// let engine = Engine::new(EngineOptions::default()).expect("threads can be started");
/// let report = engine.run(&graph, &wanted, &Cancel::default(), &());
/// let small = report.value::<Picture>("photo.small").expect("the run is complete");
/// assert_eq!(small.0.width(), 64);
/// ```
pub struct Engine {
    budget: Option<Duration>,
    pool: rayon::ThreadPool,
    store: Store,
    shared: Shared,
}

/// The state of an instance before a run, as far as it is known.
enum PlanState {
    Hit(Arc<Entry>, String),
    Run(String),
    /// An input of it is impossible: it would fail.
    Fail(String),
    /// Waits for this instance.
    Unknown(usize),
    /// The condition of this instance does not hold: it or one that needs it.
    Skip(usize),
}

/// Whether a run needs an instance.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Need {
    /// If a condition holds that this instance decides.
    If(usize),
    Certain,
}

impl Engine {
    /// Starts the threads. The cache folder is made when the first result is stored.
    ///
    /// # Errors
    /// The threads cannot be started.
    pub fn new(options: EngineOptions) -> std::io::Result<Engine> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(options.threads.unwrap_or(0).min(MAX_THREADS))
            .stack_size(STACK_BYTES)
            .thread_name(|i| format!("stage {i}"))
            .build()
            .map_err(std::io::Error::other)?;
        let blobs = options
            .cache
            .as_ref()
            .and_then(|cache| Some(Blobs::new(cache.store.clone()?, cache.key.clone())));
        let disk = options.cache.map(DiskCache::new);
        let limits = (options.memory_bytes, options.disk_bytes);
        let store = Store::new(limits, disk, blobs, options.earlier, options.project);
        let shared = Shared::new(options.services);
        Ok(Engine { budget: options.budget, pool, store, shared })
    }

    /// Returns the number of worker threads.
    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// Computes the wanted outputs, running only nodes whose key is new.
    pub fn run(
        &self,
        graph: &ResolvedGraph,
        wanted: &Wanted,
        cancel: &Cancel,
        observer: &dyn Observer,
    ) -> RunReport {
        self.go(graph, wanted, cancel, observer, false).0
    }

    /// Runs, makes every hit again, and compares.
    pub fn verify(
        &self,
        graph: &ResolvedGraph,
        wanted: &Wanted,
        cancel: &Cancel,
        observer: &dyn Observer,
    ) -> VerifyReport {
        let (run, differences) = self.go(graph, wanted, cancel, observer, true);
        VerifyReport { run, differences }
    }

    fn go(
        &self,
        graph: &ResolvedGraph,
        wanted: &Wanted,
        cancel: &Cancel,
        observer: &dyn Observer,
        verify: bool,
    ) -> (RunReport, Vec<Difference>) {
        let (store, shared, budget) = (&self.store, &self.shared, self.budget);
        let options = RunOptions { store, shared, budget, graph, wanted, cancel, observer, verify };
        self.pool.install(|| RunInProgress::new(options).go())
    }

    /// Lists the nodes of a run with their expected status, without running them; a node whose
    /// condition does not hold is left out.
    pub fn plan(&self, graph: &ResolvedGraph, wanted: &Wanted) -> Vec<PlanLine> {
        let state = self.plan_states(graph, wanted);
        let lines = graph.instances.iter().zip(&state).filter_map(|(instance, state)| {
            let (status, why) = self.classify(graph, &instance.name, state.as_ref()?);
            if status == Planned::Skip {
                return None;
            }
            let kind = graph.nodes[instance.node].kind;
            Some(PlanLine {
                node: instance.name.to_string(),
                kind,
                status,
                why: why.map(|why| why.why),
            })
        });
        lines.collect()
    }

    /// Why `node` (an instance: `direct[lamp_0]`) would run again: its key manifest against the
    /// last one of that name.
    ///
    /// # Errors
    /// The graph does not have such a node, or the name means several instances.
    #[expect(clippy::missing_panics_doc, reason = "the plan contains every wanted node")]
    pub fn explain(&self, graph: &ResolvedGraph, node: &str) -> Result<Explanation, Diagnostic> {
        let (_, instances) = graph.find(node)?;
        if instances.len() != 1 {
            let names: Vec<&str> = graph.instances[instances].iter().map(|i| &*i.name).collect();
            let message = format!("wanted one node, `{node}` has {}", names.len());
            return Err(Diagnostic::file(Path::new(""), message)
                .help(format!("name one: {}", names.join(", "))));
        }
        let at = instances.start;
        let name = graph.instances[at].name.to_string();
        let wanted = graph.wanted(Some(std::slice::from_ref(&name)))?;
        let state = self
            .plan_states(graph, &wanted)
            .swap_remove(at)
            .expect("the plan has a state for each wanted node");
        let (status, why) = self.classify(graph, &name, &state);
        let why = why.unwrap_or_else(|| Why::plain("nothing changed"));
        let key_manifest = match state {
            PlanState::Hit(_, text) | PlanState::Run(text) => Some(text),
            PlanState::Fail(_) | PlanState::Unknown(_) | PlanState::Skip(_) => None,
        };
        Ok(Explanation {
            node: name,
            status,
            why: why.why,
            old: why.old,
            new: why.new,
            key_manifest,
        })
    }

    /// The state of each instance that a run would look at, or may.
    fn plan_states(&self, graph: &ResolvedGraph, wanted: &Wanted) -> Vec<Option<PlanState>> {
        self.store.refresh_latest();
        let mut all: Vec<Option<PlanState>> = Vec::new();
        for at in 0..graph.instances.len() {
            let state = wanted.needed[at].then(|| self.plan_state(graph, at, &all));
            all.push(state);
        }
        // Whether each is needed in the end: for certain, or only if this condition holds.
        let roots = wanted.is_root(all.len());
        let mut needs: Vec<Option<Need>> =
            roots.iter().map(|is_root| is_root.then_some(Need::Certain)).collect();
        for (at, instance) in graph.instances.iter().enumerate().rev() {
            let Some(need) = needs[at] else {
                all[at] = None;
                continue;
            };
            let of_conditions = need;
            let of_inputs = match &all[at] {
                Some(PlanState::Skip(_)) => None,
                Some(PlanState::Unknown(from)) if instance.conditions.contains(from) => {
                    Some(Need::If(*from))
                }
                _ => Some(need),
            };
            for &from in &instance.from {
                let asked = if instance.conditions.contains(&from) {
                    Some(of_conditions)
                } else {
                    of_inputs
                };
                needs[from] = needs[from].max(asked);
            }
            if let Need::If(condition) = need {
                all[at] = Some(PlanState::Unknown(condition));
            }
        }
        all
    }

    fn plan_state(&self, graph: &ResolvedGraph, at: usize, all: &[Option<PlanState>]) -> PlanState {
        let instance = &graph.instances[at];
        let mut unknown = None;
        for &condition in &instance.conditions {
            match &all[condition] {
                Some(PlanState::Skip(cause)) => return PlanState::Skip(*cause),
                Some(PlanState::Hit(entry, _)) => match &instance.when {
                    Some(when) if when.instance == condition && !holds(when, &entry.header) => {
                        return PlanState::Skip(at);
                    }
                    _ => {}
                },
                _ => unknown = unknown.or(Some(condition)),
            }
        }
        let known = |&from: &usize| match &all[from] {
            Some(PlanState::Hit(entry, _)) => Ok((from, Some(entry.clone()))),
            Some(PlanState::Skip(_)) => Ok((from, None)),
            _ => Err(from),
        };
        match (unknown, instance.from.iter().map(known).collect::<Result<Vec<_>, _>>()) {
            (Some(from), _) | (None, Err(from)) => PlanState::Unknown(from),
            (None, Ok(before)) => self.probe(graph, at, &Before(before)),
        }
    }

    fn probe(&self, graph: &ResolvedGraph, at: usize, before: &Before) -> PlanState {
        let resolved = match resolve_inputs(graph, at, before) {
            Ok(resolved) => resolved,
            Err(message) => return PlanState::Fail(message),
        };
        let text = key_manifest(graph, at, &resolved, before);
        let node = &graph.nodes[graph.instances[at].node];
        match self.store.find(&key::digest(&text), node).entry {
            Some(entry) => PlanState::Hit(entry, text),
            None => PlanState::Run(text),
        }
    }

    fn classify(
        &self,
        graph: &ResolvedGraph,
        name: &str,
        state: &PlanState,
    ) -> (Planned, Option<Why>) {
        match state {
            PlanState::Hit(..) => (Planned::Hit, None),
            PlanState::Run(text) => {
                (Planned::Run, Some(self.store.why(name, &key::digest(text), text)))
            }
            PlanState::Fail(message) => (Planned::Run, Some(Why::plain(message))),
            PlanState::Unknown(from) => {
                let why = format!("depends on the result of {}", graph.instances[*from].name);
                (Planned::Unknown, Some(Why::plain(&why)))
            }
            PlanState::Skip(at) => {
                let why = graph
                    .condition(*at)
                    .map_or(String::new(), |output| format!("{output} is false"));
                (Planned::Skip, Some(Why::plain(&why)))
            }
        }
    }
}
