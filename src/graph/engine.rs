//! The engine: options, cache, thread pool, and the questions one may ask it.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use super::cache::Entry;
use super::context::{Cancel, Services, Shared};
use super::disk::{CacheFolder, DiskCache};
use super::key;
use super::key::Why;
use super::network::{Graph, Wanted};
use super::report::{Difference, Explanation, Observer, PlanLine, Planned, RunReport, VerifyReport};
use super::run::{Run, RunOptions};
use super::source::Fault;
use super::store::Store;
use super::take::{Before, holds, key_text, taken};

/// How an engine works. None of it but `budget` changes what comes out.
#[derive(Clone, Debug)]
pub struct EngineOptions {
    /// Where results are kept between runs; `None` keeps them in memory only.
    pub cache: Option<CacheFolder>,
    /// A name for what is worked on, such as the scene's folder: a cache keeps the last keys of each, which tell why a node
    /// has to run again.
    pub project: String,
    /// Most memory for results that no running node needs.
    pub memory_bytes: u64,
    /// Most disk space for results.
    pub disk_bytes: u64,
    /// Threads; `None` takes all that the machine has.
    pub threads: Option<usize>,
    /// Time for each node that asks for it ([`super::Context::out_of_time`]), from its start. What is cut short by it is used in
    /// the run and not kept; what was kept before, whole, is used as ever.
    pub budget: Option<Duration>,
    /// Values that stages may ask for ([`super::Context::service`]).
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
            services: Services::default(),
        }
    }
}

/// No machine that this runs on has more.
const MAX_THREADS: usize = 1024;

/// Stages run on stacks of this size: a thread that waits inside one stage may take up another on the same stack.
const STACK_BYTES: usize = 32 << 20;

/// Runs graphs, and keeps what they gave.
pub struct Engine {
    budget: Option<Duration>,
    pool: rayon::ThreadPool,
    store: Store,
    shared: Shared,
}

/// What is known of an instance before anything runs.
enum Foreseen {
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
    pub fn new(options: EngineOptions) -> std::io::Result<Engine> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(options.threads.unwrap_or(0).min(MAX_THREADS))
            .stack_size(STACK_BYTES)
            .thread_name(|i| format!("stage {i}"))
            .build()
            .map_err(std::io::Error::other)?;
        let disk = options.cache.map(DiskCache::new);
        let store = Store::new(options.memory_bytes, disk, options.disk_bytes, options.project);
        let shared = Shared::new(options.services);
        Ok(Engine { budget: options.budget, pool, store, shared })
    }

    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// Makes what is wanted, running only nodes whose key is new.
    pub fn run(&self, graph: &Graph, wanted: &Wanted, cancel: &Cancel, observer: &dyn Observer) -> RunReport {
        self.go(graph, wanted, cancel, observer, false).0
    }

    /// Runs, makes every hit again, and compares.
    pub fn verify(&self, graph: &Graph, wanted: &Wanted, cancel: &Cancel, observer: &dyn Observer) -> VerifyReport {
        let (run, differences) = self.go(graph, wanted, cancel, observer, true);
        VerifyReport { run, differences }
    }

    fn go(
        &self,
        graph: &Graph,
        wanted: &Wanted,
        cancel: &Cancel,
        observer: &dyn Observer,
        verify: bool,
    ) -> (RunReport, Vec<Difference>) {
        let (store, shared, budget) = (&self.store, &self.shared, self.budget);
        let options = RunOptions { store, shared, budget, graph, wanted, cancel, observer, verify };
        self.pool.install(|| Run::new(options).go())
    }

    /// What [`Engine::run`] would do, node by node, without doing it; a node whose condition does not hold is left out.
    pub fn plan(&self, graph: &Graph, wanted: &Wanted) -> Vec<PlanLine> {
        let foreseen = self.foresee(graph, wanted);
        let lines = graph.instances.iter().zip(&foreseen).filter_map(|(instance, foreseen)| {
            let (status, why) = self.judge(graph, &instance.name, foreseen.as_ref()?);
            if status == Planned::Skip {
                return None;
            }
            let kind = graph.nodes[instance.node].kind;
            Some(PlanLine { node: instance.name.to_string(), kind, status, why: why.map(|why| why.why) })
        });
        lines.collect()
    }

    /// Why `node` (an instance: `direct[lamp_0]`) would run again: its key text against the last one of that name.
    pub fn explain(&self, graph: &Graph, node: &str) -> Result<Explanation, Fault> {
        let (_, instances) = graph.find(node)?;
        if instances.len() != 1 {
            let names: Vec<&str> = graph.instances[instances].iter().map(|i| &*i.name).collect();
            let message = format!("wanted one node, `{node}` has {}", names.len());
            return Err(Fault::file(Path::new(""), message).help(format!("name one: {}", names.join(", "))));
        }
        let at = instances.start;
        let name = graph.instances[at].name.to_string();
        let wanted = graph.wanted(Some(std::slice::from_ref(&name)))?;
        let foreseen = self.foresee(graph, &wanted).swap_remove(at).expect("what is wanted is foreseen");
        let (status, why) = self.judge(graph, &name, &foreseen);
        let why = why.unwrap_or_else(|| Why::plain("nothing changed"));
        let key_text = match foreseen {
            Foreseen::Hit(_, text) | Foreseen::Run(text) => Some(text),
            Foreseen::Fail(_) | Foreseen::Unknown(_) | Foreseen::Skip(_) => None,
        };
        Ok(Explanation { node: name, status, why: why.why, old: why.old, new: why.new, key_text })
    }

    /// What is known of each instance that a run would look at, or may.
    fn foresee(&self, graph: &Graph, wanted: &Wanted) -> Vec<Option<Foreseen>> {
        self.store.refresh_latest();
        let mut all: Vec<Option<Foreseen>> = Vec::new();
        for at in 0..graph.instances.len() {
            let foreseen = wanted.needed[at].then(|| self.foresee_one(graph, at, &all));
            all.push(foreseen);
        }
        // Whether each is needed in the end: for certain, or only if this condition holds.
        let roots = wanted.is_root(all.len());
        let mut needs: Vec<Option<Need>> = roots.iter().map(|is_root| is_root.then_some(Need::Certain)).collect();
        for (at, instance) in graph.instances.iter().enumerate().rev() {
            let Some(need) = needs[at] else {
                all[at] = None;
                continue;
            };
            let of_conditions = need;
            let of_inputs = match &all[at] {
                Some(Foreseen::Skip(_)) => None,
                Some(Foreseen::Unknown(from)) if instance.conditions.contains(from) => Some(Need::If(*from)),
                _ => Some(need),
            };
            for &from in &instance.from {
                let asked = if instance.conditions.contains(&from) { Some(of_conditions) } else { of_inputs };
                needs[from] = needs[from].max(asked);
            }
            if let Need::If(condition) = need {
                all[at] = Some(Foreseen::Unknown(condition));
            }
        }
        all
    }

    fn foresee_one(&self, graph: &Graph, at: usize, all: &[Option<Foreseen>]) -> Foreseen {
        let instance = &graph.instances[at];
        let mut unknown = None;
        for &condition in &instance.conditions {
            match &all[condition] {
                Some(Foreseen::Skip(cause)) => return Foreseen::Skip(*cause),
                Some(Foreseen::Hit(entry, _)) => match &instance.when {
                    Some(when) if when.instance == condition && !holds(when, &entry.header) => {
                        return Foreseen::Skip(at);
                    }
                    _ => {}
                },
                _ => unknown = unknown.or(Some(condition)),
            }
        }
        let known = |&from: &usize| match &all[from] {
            Some(Foreseen::Hit(entry, _)) => Ok((from, Some(entry.clone()))),
            Some(Foreseen::Skip(_)) => Ok((from, None)),
            _ => Err(from),
        };
        match (unknown, instance.from.iter().map(known).collect::<Result<Vec<_>, _>>()) {
            (Some(from), _) | (None, Err(from)) => Foreseen::Unknown(from),
            (None, Ok(before)) => self.look(graph, at, &Before(before)),
        }
    }

    fn look(&self, graph: &Graph, at: usize, before: &Before) -> Foreseen {
        let taken = match taken(graph, at, before) {
            Ok(taken) => taken,
            Err(message) => return Foreseen::Fail(message),
        };
        let text = key_text(graph, at, &taken, before);
        let node = &graph.nodes[graph.instances[at].node];
        match self.store.find(&key::digest(&text), node).entry {
            Some(entry) => Foreseen::Hit(entry, text),
            None => Foreseen::Run(text),
        }
    }

    fn judge(&self, graph: &Graph, name: &str, foreseen: &Foreseen) -> (Planned, Option<Why>) {
        match foreseen {
            Foreseen::Hit(..) => (Planned::Hit, None),
            Foreseen::Run(text) => (Planned::Run, Some(self.store.why(name, &key::digest(text), text))),
            Foreseen::Fail(message) => (Planned::Run, Some(Why::plain(message))),
            Foreseen::Unknown(from) => {
                let why = format!("depends on what {} gives", graph.instances[*from].name);
                (Planned::Unknown, Some(Why::plain(&why)))
            }
            Foreseen::Skip(at) => {
                let why = graph.condition(*at).map_or(String::new(), |output| format!("{output} does not hold"));
                (Planned::Skip, Some(Why::plain(&why)))
            }
        }
    }
}
