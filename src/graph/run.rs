//! One run: each node starts when its last input is known, the one before the longest chain of
//! others first.
//!
//! A stage may use the same threads inside (`par_iter`), and a thread that waits there may take up
//! another node. So no lock is held while a stage works, and no node ever waits on a thread for
//! another: an instance that cannot continue is put aside, and resumed by the worker that completes
//! its missing input.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use super::cache::{Entry, Header};
use super::context::{Cancel, Context, NodeError, Shared};
use super::disk::Loss;
use super::inputs::{Before, ResolvedInput, Slot, holds, key_manifest, resolve_inputs};
use super::report::{Difference, NodeReport, Observer, RunReport, Status};
use super::resolved_graph::{GraphNode, ResolvedGraph, Wanted};
use super::source::is_name;
use super::store::{NOT_STORED, STORED_NO_MORE, Store};
use super::{Digest, PortValue, Value, key};

/// The parts of a run.
#[derive(Clone, Copy)]
pub(super) struct RunOptions<'a> {
    pub store: &'a Store,
    pub shared: &'a Shared,
    /// Time for each node that observes it.
    pub budget: Option<Duration>,
    pub graph: &'a ResolvedGraph,
    pub wanted: &'a Wanted,
    pub cancel: &'a Cancel,
    pub observer: &'a dyn Observer,
    /// Make every hit again and compare.
    pub verify: bool,
}

pub(super) struct RunInProgress<'a> {
    options: RunOptions<'a>,
    state: Mutex<RunState<'a>>,
}

struct RunState<'a> {
    graph: &'a ResolvedGraph,
    /// Per instance, the length of the longest chain of instances that begins there.
    chain: Vec<u32>,
    /// Demand and progress of the inputs, per instance.
    asked: Vec<Asked>,
    /// Number of other instances that may still request its result, per instance; the request of
    /// the run counts as one.
    hopes: Vec<usize>,
    /// Per instance, those that wait for it.
    waiting: Vec<Vec<usize>>,
    /// Per instance, how many results it still waits for.
    waits: Vec<usize>,
    /// By length of chain, then the earlier instance first.
    ready: BinaryHeap<(u32, Reverse<usize>)>,
    /// The instances that run or ran under each key in this run.
    #[expect(clippy::disallowed_types, reason = "found by key only, never walked")]
    in_flight: std::collections::HashMap<Digest, InFlight>,
    outcomes: Vec<Option<Outcome>>,
    reports: Vec<Option<NodeReport>>,
    differences: Vec<(usize, Difference)>,
    /// Per instance and output port, how many may still take its values; at 0 the run lets go of
    /// them.
    uses: Vec<Vec<usize>>,
    /// Whether the instance has taken its inputs, per instance.
    served: Vec<bool>,
    held: Vec<u64>,
    held_now: u64,
    peak: u64,
}

/// The progress of an instance towards its run.
#[derive(Clone, Copy, PartialEq)]
enum Asked {
    /// Nothing needs its result so far.
    No,
    /// It waits for its conditions.
    Conditions,
    /// It waits for all that it takes.
    Inputs,
}

/// An event of an instance.
enum Event {
    Asked,
    /// All that it waited for is complete.
    Ready,
    Completed,
}

enum InFlight {
    /// These wait for it.
    Running(Vec<usize>),
    /// The outcome of this instance holds for all.
    Done(usize),
}

#[derive(Clone)]
enum Outcome {
    Done(Arc<Entry>),
    Failed,
    /// By this instance, that failed.
    Blocked(usize),
    Cancelled,
    /// Not run and not reported, as a condition does not hold.
    Skipped,
}

/// Why a node gave no result.
enum NodeFailure {
    Failed(String),
    /// A file that a person named, or a parameter that a person set, cannot be used.
    BadFile(String),
    Blocked(usize),
    Cancelled,
}

/// A node whose inputs are all known.
struct NodeJob {
    at: usize,
    key: Digest,
    text: String,
    resolved: Vec<ResolvedInput>,
}

/// The result of a stage, with its measurements for the run table.
struct StageResult {
    entry: Arc<Entry>,
    values: Vec<Value>,
    seconds: f64,
    rays: u64,
    samples: Option<f64>,
}

impl<'a> RunInProgress<'a> {
    /// Creates a run in which no node has started.
    pub fn new(options: RunOptions<'a>) -> RunInProgress<'a> {
        RunInProgress { options, state: Mutex::new(RunState::new(options.graph, options.wanted)) }
    }

    /// Runs to the end, on the threads of the pool that this is called on.
    pub fn go(self) -> (RunReport, Vec<Difference>) {
        #[expect(clippy::disallowed_methods, reason = "times the run for its report")]
        let began = Instant::now();
        let RunInProgress { options: RunOptions { store, graph, wanted, .. }, .. } = self;
        store.refresh_latest();
        let wanted_itself = wanted.is_root(graph.instances.len());
        let first =
            (0..wanted_itself.len()).filter(|&at| wanted_itself[at]).map(|at| (at, Event::Asked));
        rayon::scope(|scope| self.follow(scope, first.collect()));
        let outputs = self.outputs();
        let state = self.state.into_inner().expect(UNPOISONED);
        let done = graph.instances.iter().zip(&state.outcomes).filter_map(|(instance, outcome)| {
            match outcome {
                Some(Outcome::Done(entry)) if !entry.cut_short => {
                    Some((instance.name.clone(), entry.header.clone(), entry.key))
                }
                _ => None,
            }
        });
        store.set_latest(done);
        let mut differences = state.differences;
        differences.sort_by_key(|(at, _)| *at);
        let report = RunReport {
            nodes: state.reports.into_iter().flatten().collect(),
            outputs,
            warnings: store.take_warnings(),
            peak_bytes: state.peak,
            seconds: began.elapsed().as_secs_f64(),
        };
        (report, differences.into_iter().map(|(_, difference)| difference).collect())
    }

    /// Acts on events, and starts a worker for each instance that they make ready.
    fn follow<'s>(&'s self, scope: &rayon::Scope<'s>, events: Vec<(usize, Event)>) {
        let (ready, more) = self.lock().follow(events);
        if !more.is_empty() {
            self.options.observer.needs(&more);
        }
        (0..ready).for_each(|_| scope.spawn(|scope| self.work(scope)));
    }

    /// Takes up the most urgent of the nodes that are ready. There is a worker for each of them.
    fn work<'s>(&'s self, scope: &rayon::Scope<'s>) {
        let Some((_, Reverse(at))) = self.lock().ready.pop() else { return };
        let job = match self.job(at) {
            Ok(job) => job,
            Err(stop) => {
                let (outcome, report) = self.stopped(at, None, stop);
                return self.complete(scope, at, None, outcome, report);
            }
        };
        let done_by = {
            let mut state = self.lock();
            match state.in_flight.get_mut(&job.key) {
                Some(InFlight::Running(waiting)) => return waiting.push(at),
                Some(&mut InFlight::Done(first)) => Some(first),
                None => {
                    state.in_flight.insert(job.key, InFlight::Running(Vec::new()));
                    None
                }
            }
        };
        if let Some(first) = done_by {
            let (outcome, report) = self.like(at, first, job.key);
            return self.complete(scope, at, None, outcome, report);
        }

        let node = self.node(at);
        let found = self.options.store.find(&job.key, node);
        if let (Some(entry), false) = (&found.entry, self.options.verify) {
            let report = self.report(at, Status::Hit, Some(entry));
            return self.complete(scope, at, Some(job.key), Outcome::Done(entry.clone()), report);
        }
        // A result to compare with a stored one must be as whole as that.
        let budget = if found.entry.is_none() { self.options.budget } else { None };
        let inputs = self.inputs(&job);
        if !self.options.verify {
            // The last taker of a value has it to itself, and may let go of it before it ends.
            self.lock().serve(at);
        }
        match (inputs.and_then(|inputs| self.make(&job, inputs, budget)), found.entry) {
            (Err(stop), _) => {
                let (outcome, report) = self.stopped(at, Some(job.key), stop);
                self.complete(scope, at, Some(job.key), outcome, report);
            }
            (Ok(made), Some(stored)) => {
                self.compare(at, &stored.header, &made.entry.header);
                let report = NodeReport {
                    seconds: made.seconds,
                    rays: made.rays,
                    samples: made.samples,
                    ..self.report(at, Status::Hit, Some(&stored))
                };
                self.complete(scope, at, Some(job.key), Outcome::Done(stored), report);
            }
            (Ok(made), None) => {
                let keep = !made.entry.cut_short;
                if keep {
                    self.options.store.keep_in_memory(&made.entry);
                }
                let report = self.ran(&job, &made, found.damage.map(Loss::Damaged));
                // Takers of the values need not wait for the disk, unless the values are too large
                // to be held for both.
                let large = self.options.store.is_large(&made.entry);
                if keep && large {
                    self.options.store.keep(&made.entry, &made.values, made.seconds);
                }
                let StageResult { entry, values, seconds, .. } = made;
                let values = if large { Vec::new() } else { values };
                self.complete(scope, at, Some(job.key), Outcome::Done(entry.clone()), report);
                if keep && !large {
                    self.options.store.keep(&entry, &values, seconds);
                }
            }
        }
    }

    /// Resolves the inputs and the key of a node.
    fn job(&self, at: usize) -> Result<NodeJob, NodeFailure> {
        if self.options.cancel.is_cancelled() {
            return Err(NodeFailure::Cancelled);
        }
        let before = self.before(at)?;
        let resolved = resolve_inputs(self.graph(), at, &before).map_err(NodeFailure::Failed)?;
        let text = key_manifest(self.graph(), at, &resolved, &before);
        Ok(NodeJob { at, key: key::digest(&text), text, resolved })
    }

    fn before(&self, at: usize) -> Result<Before, NodeFailure> {
        let state = self.lock();
        let mut before = Vec::new();
        let mut cancelled = false;
        // Only where a condition came to nothing is not all settled that it takes from.
        let settled = self.graph().instances[at]
            .from
            .iter()
            .filter_map(|&from| Some((from, state.outcomes[from].as_ref()?)));
        for (from, outcome) in settled {
            match outcome {
                Outcome::Done(entry) => before.push((from, Some(entry.clone()))),
                Outcome::Skipped => before.push((from, None)),
                Outcome::Failed => return Err(NodeFailure::Blocked(from)),
                Outcome::Blocked(cause) => return Err(NodeFailure::Blocked(*cause)),
                Outcome::Cancelled => cancelled = true,
            }
        }
        if cancelled { Err(NodeFailure::Cancelled) } else { Ok(Before(before)) }
    }

    /// The values that a job takes.
    fn inputs(&self, job: &NodeJob) -> Result<Vec<PortValue>, NodeFailure> {
        let inputs = job.resolved.iter().map(|input| {
            Ok(match input {
                ResolvedInput::Missing => PortValue::Missing,
                ResolvedInput::One(slot) => PortValue::One(self.value(*slot)?),
                ResolvedInput::Many(all) => {
                    let value =
                        |(member, slot): &(String, Slot)| Ok((member.clone(), self.value(*slot)?));
                    PortValue::Many(all.iter().map(value).collect::<Result<_, NodeFailure>>()?)
                }
            })
        });
        inputs.collect()
    }

    /// Runs the stage, within a budget of time where there is one.
    fn make(
        &self,
        job: &NodeJob,
        inputs: Vec<PortValue>,
        budget: Option<Duration>,
    ) -> Result<StageResult, NodeFailure> {
        let node = self.node(job.at);
        if self.options.cancel.is_cancelled() {
            return Err(NodeFailure::Cancelled);
        }
        self.options.observer.started(&self.graph().instances[job.at].name);
        #[expect(
            clippy::disallowed_methods,
            reason = "times the node for its report and its budget"
        )]
        let began = Instant::now();
        let deadline = budget.and_then(|budget| began.checked_add(budget));
        let ctx = Context::new(
            self.options.cancel.clone(),
            node.files.clone(),
            self.options.shared.clone(),
            deadline,
        );
        let outputs = match catch_unwind(AssertUnwindSafe(|| node.op.run(inputs, &ctx))) {
            Ok(Ok(outputs)) => outputs,
            Ok(Err(NodeError::Cancelled)) => return Err(NodeFailure::Cancelled),
            Ok(Err(
                error @ (NodeError::BadFile { .. }
                | NodeError::BadFiles(_)
                | NodeError::BadParameter(_)),
            )) => {
                return Err(NodeFailure::BadFile(error.to_string()));
            }
            Ok(Err(error)) => return Err(NodeFailure::Failed(error.to_string())),
            Err(panic) => {
                return Err(NodeFailure::Failed(format!(
                    "a bug in {}: it panicked: {}",
                    node.kind,
                    said(&*panic)
                )));
            }
        };
        check_members(node, &outputs).map_err(NodeFailure::Failed)?;
        let seconds = began.elapsed().as_secs_f64();
        let mut warnings = ctx.warnings();
        if ctx.was_late() {
            let error = ctx
                .stderr()
                .map_or(String::new(), |e| format!(" at a standard error of {:.2} %", 100.0 * e));
            warnings.push(format!("stopped by the budget{error}; this result is not kept"));
        }
        let header = Header {
            key_manifest: job.text.clone(),
            values: vec![],
            has_values: true,
            stderr: ctx.stderr(),
            warnings,
            notes: ctx.notes(),
        };
        let kept = (ctx.was_late(), node.op.stored_up_to());
        let entry = Arc::new(Entry::made(job.key, header, &outputs, kept));
        let values = entry.all().expect("a result just made has all its values");
        self.hold(job.at, &entry);
        Ok(StageResult { entry, values, seconds, rays: ctx.rays(), samples: ctx.samples() })
    }

    /// A value for a stage that really runs: from memory, from disk, or recomputed when the stored
    /// one is damaged.
    fn value(&self, slot: Slot) -> Result<Value, NodeFailure> {
        let Some(Outcome::Done(entry)) = self.lock().outcomes[slot.instance].clone() else {
            return Err(NodeFailure::Blocked(slot.instance));
        };
        let loss = match self.options.store.value(&entry, slot.index, self.node(slot.instance)) {
            Ok(value) => {
                self.hold(slot.instance, &entry);
                return Ok(value);
            }
            Err(loss) => loss,
        };
        let wanted = &entry.header.values[slot.index];
        let made = self.make_again(slot.instance, loss)?;
        let index = made
            .header
            .port(wanted.port as usize)
            .find(|&i| made.header.values[i].member == wanted.member);
        index.and_then(|i| made.value(i)).ok_or_else(|| {
            NodeFailure::Failed(format!(
                "{} returned other members than before",
                self.graph().instances[slot.instance].name
            ))
        })
    }

    /// Runs a hit after all, because its values cannot be read.
    fn make_again(&self, at: usize, loss: Loss) -> Result<Arc<Entry>, NodeFailure> {
        let stored = match self.lock().outcomes[at].clone() {
            Some(Outcome::Done(entry)) => entry,
            _ => return Err(NodeFailure::Blocked(at)),
        };
        // A key may contain the digest of the stored result; without a budget, the rerun must give
        // that result.
        let make = |job: NodeJob| {
            self.lock().claim(at);
            let inputs = self.inputs(&job);
            self.lock().serve(at);
            self.make(&job, inputs?, None).map(|made| (job, made))
        };
        let made = self.job(at).and_then(make);
        let (outcome, report, result) = match made {
            Ok((job, made)) => {
                let mut report = self.ran(&job, &made, Some(loss));
                let digests =
                    |header: &Header| header.values.iter().map(|v| v.digest).collect::<Vec<_>>();
                if digests(&stored.header) != digests(&made.entry.header) {
                    report.warnings.push(format!(
                        "a bug in {}: the same key gave another result",
                        report.kind
                    ));
                }
                self.options.store.keep_in_memory(&made.entry);
                if stored.header.has_values {
                    self.options.store.keep(&made.entry, &made.values, made.seconds);
                } else if made.entry.header.has_values {
                    // The shared store has the header alone, as values are quick to make.
                    self.options.store.keep_on_disk(&made.entry, &made.values);
                }
                (Outcome::Done(made.entry.clone()), report, Ok(made.entry))
            }
            Err(stop) => {
                let (outcome, report) = self.stopped(at, Some(stored.key), stop);
                let stop = if matches!(outcome, Outcome::Cancelled) {
                    NodeFailure::Cancelled
                } else {
                    NodeFailure::Blocked(at)
                };
                (outcome, report, Err(stop))
            }
        };
        self.options.observer.finished(&report);
        let mut state = self.lock();
        state.outcomes[at] = Some(outcome);
        state.reports[at] = Some(report);
        (0..state.uses[at].len()).for_each(|port| state.let_go(at, port));
        result
    }

    /// Records the outcome of a node, and wakes the nodes that waited for it.
    fn complete<'s>(
        &'s self,
        scope: &rayon::Scope<'s>,
        at: usize,
        key: Option<Digest>,
        outcome: Outcome,
        report: NodeReport,
    ) {
        let NodeReport { name, status, why, error, .. } = &report;
        tracing::debug!(node = %name, ?status, why = why.as_deref(), error = error.as_deref(), "completed");
        self.options.observer.finished(&report);
        let alike = {
            let state = &mut *self.lock();
            state.outcomes[at] = Some(outcome);
            state.reports[at] = Some(report);
            let flight = key.and_then(|key| state.in_flight.insert(key, InFlight::Done(at)));
            if let Some(InFlight::Running(waiting)) = flight { waiting } else { Vec::new() }
        };
        self.follow(scope, vec![(at, Event::Completed)]);
        for other in alike {
            let (outcome, report) =
                self.like(other, at, key.expect("only what has a key has others waiting for it"));
            self.complete(scope, other, None, outcome, report);
        }
    }

    /// The outcome of `at`, whose key is that of `first`.
    fn like(&self, at: usize, first: usize, key: Digest) -> (Outcome, NodeReport) {
        let (outcome, report) = {
            let state = self.lock();
            (state.outcomes[first].clone(), state.reports[first].clone())
        };
        match outcome.expect("a key is done once its outcome is known") {
            Outcome::Done(entry) => {
                // The run may have let go of the first one's values already.
                let entry = self.options.store.in_memory(&key).unwrap_or(entry);
                let report = self.report(at, Status::Hit, Some(&entry));
                (Outcome::Done(entry), report)
            }
            Outcome::Failed => {
                let first = report.expect("an outcome comes with its report");
                let error = first.error.unwrap_or_default();
                let stop = if first.bad_file {
                    NodeFailure::BadFile(error)
                } else {
                    NodeFailure::Failed(error)
                };
                self.stopped(at, Some(key), stop)
            }
            Outcome::Blocked(cause) => self.stopped(at, Some(key), NodeFailure::Blocked(cause)),
            Outcome::Cancelled => self.stopped(at, Some(key), NodeFailure::Cancelled),
            Outcome::Skipped => unreachable!("what is skipped has no key"),
        }
    }

    fn stopped(&self, at: usize, key: Option<Digest>, stop: NodeFailure) -> (Outcome, NodeReport) {
        let bad_file = matches!(stop, NodeFailure::BadFile(_));
        let (outcome, status, error) = match stop {
            NodeFailure::Failed(message) | NodeFailure::BadFile(message) => {
                (Outcome::Failed, Status::Failed, Some(message))
            }
            NodeFailure::Blocked(cause) => {
                let message = format!("needs {}, which failed", self.graph().instances[cause].name);
                (Outcome::Blocked(cause), Status::Blocked, Some(message))
            }
            NodeFailure::Cancelled => (Outcome::Cancelled, Status::Cancelled, None),
        };
        (outcome, NodeReport { key, error, bad_file, ..self.report(at, status, None) })
    }

    fn ran(&self, job: &NodeJob, made: &StageResult, loss: Option<Loss>) -> NodeReport {
        let mut report = self.report(job.at, Status::Ran, Some(&made.entry));
        report.seconds = made.seconds;
        report.rays = made.rays;
        report.samples = made.samples;
        let why = match loss {
            Some(Loss::Damaged(damage)) => {
                report.warnings.push(format!(
                    "the stored result was damaged ({damage}) and was computed again"
                ));
                "its stored result was damaged".to_owned()
            }
            Some(Loss::Gone) if !made.entry.header.has_values => NOT_STORED.to_owned(),
            Some(Loss::Gone) => STORED_NO_MORE.to_owned(),
            None => self.options.store.why(&report.name, &job.key, &job.text).why,
        };
        NodeReport { why: Some(why), ..report }
    }

    fn report(&self, at: usize, status: Status, entry: Option<&Arc<Entry>>) -> NodeReport {
        NodeReport {
            name: self.graph().instances[at].name.to_string(),
            kind: self.node(at).kind,
            status,
            seconds: 0.0,
            rays: 0,
            samples: None,
            stderr: entry.and_then(|e| e.header.stderr),
            bytes: entry.map_or(0, |e| e.header.memory()),
            key: entry.map(|e| e.key),
            why: None,
            warnings: entry.map(|e| e.header.warnings.clone()).unwrap_or_default(),
            notes: entry.map(|e| e.header.notes.clone()).unwrap_or_default(),
            error: None,
            bad_file: false,
        }
    }

    fn compare(&self, at: usize, stored: &Header, computed: &Header) {
        let node = self.node(at);
        let digest = |header: &Header, port: u32, member: &Option<String>| {
            header
                .values
                .iter()
                .find(|v| v.port == port && v.member == *member)
                .map(|v| Digest(v.digest))
        };
        let only_computed =
            computed.values.iter().filter(|v| digest(stored, v.port, &v.member).is_none());
        for value in stored.values.iter().chain(only_computed) {
            let (was, is) = (
                digest(stored, value.port, &value.member),
                digest(computed, value.port, &value.member),
            );
            if was != is {
                let port = node.outputs[value.port as usize].name;
                let port = value
                    .member
                    .as_ref()
                    .map_or(port.to_owned(), |member| format!("{port}[{member}]"));
                let name = self.graph().instances[at].name.to_string();
                self.lock()
                    .differences
                    .push((at, Difference { node: name, port, stored: was, computed: is }));
            }
        }
    }

    /// The wanted outputs of which everything was made.
    fn outputs(&self) -> Vec<(String, PortValue)> {
        let output = |output: &super::resolved_graph::WantedOutput| {
            let mut all = Vec::new();
            let node = self.node(*output.instances.first()?);
            let mut any = false;
            for &at in &output.instances {
                let entry = match self.lock().outcomes[at].clone()? {
                    Outcome::Done(entry) => entry,
                    Outcome::Skipped => continue,
                    Outcome::Failed | Outcome::Blocked(_) | Outcome::Cancelled => return None,
                };
                any = true;
                for index in entry.header.port(output.port) {
                    let own = self.graph().instances[at].member.clone();
                    let member = if output.by_member {
                        own
                    } else {
                        entry.header.values[index].member.clone()
                    };
                    all.push((
                        member.unwrap_or_default(),
                        self.value(Slot { instance: at, index }).ok()?,
                    ));
                }
            }
            let many = output.by_member || node.outputs[output.port].arity == super::Arity::Many;
            let value = if many {
                any.then_some(PortValue::Many(all))?
            } else {
                PortValue::One(all.pop()?.1)
            };
            Some((output.name.clone(), value))
        };
        self.options.wanted.outputs.iter().filter_map(output).collect()
    }

    /// Counts the memory that the run holds of a result.
    fn hold(&self, at: usize, entry: &Entry) {
        let bytes = entry.resident();
        let state = &mut *self.lock();
        state.held_now = state.held_now - state.held[at] + bytes;
        state.held[at] = bytes;
        state.peak = state.peak.max(state.held_now);
    }

    fn graph(&self) -> &'a ResolvedGraph {
        self.options.graph
    }

    fn node(&self, at: usize) -> &'a GraphNode {
        &self.graph().nodes[self.graph().instances[at].node]
    }

    fn lock(&self) -> MutexGuard<'_, RunState<'a>> {
        self.state.lock().expect(UNPOISONED)
    }
}

const UNPOISONED: &str = "nothing panics while it holds the state of a run";

impl<'a> RunState<'a> {
    fn new(graph: &'a ResolvedGraph, wanted: &Wanted) -> RunState<'a> {
        let count = graph.instances.len();
        let needed = || (0..count).filter(|&at| wanted.needed[at]);
        let mut hopes: Vec<usize> = wanted.is_root(count).into_iter().map(usize::from).collect();
        let ports = |at: usize| graph.nodes[graph.instances[at].node].outputs.len();
        let mut uses: Vec<Vec<usize>> = (0..count).map(|at| vec![0; ports(at)]).collect();
        let mut chain = vec![1; count];
        for at in needed().rev() {
            let instance = &graph.instances[at];
            for &from in &instance.from {
                hopes[from] += 1;
                chain[from] = chain[from].max(1 + chain[at]);
            }
            instance.ports().for_each(|(_, edge)| uses[edge.instance][edge.port] += 1);
        }
        for output in &wanted.outputs {
            output.instances.iter().for_each(|&at| uses[at][output.port] += 1);
        }
        RunState {
            graph,
            chain,
            asked: vec![Asked::No; count],
            hopes,
            waiting: vec![Vec::new(); count],
            waits: vec![0; count],
            ready: BinaryHeap::new(),
            in_flight: Default::default(),
            outcomes: vec![None; count],
            reports: vec![None; count],
            differences: Vec::new(),
            uses,
            served: vec![false; count],
            held: vec![0; count],
            held_now: 0,
            peak: 0,
        }
    }

    /// Acts on events; the number of instances that are ready for work now, and the kinds of those
    /// that are known now to be needed.
    fn follow(&mut self, mut events: Vec<(usize, Event)>) -> (usize, Vec<&'static str>) {
        let (mut ready, mut needed) = (0, Vec::new());
        while let Some((at, event)) = events.pop() {
            let instance = &self.graph.instances[at];
            match (event, self.asked[at]) {
                (Event::Asked, Asked::No) => {
                    self.asked[at] = Asked::Conditions;
                    self.wait(at, &instance.conditions, &mut events);
                }
                (Event::Asked, Asked::Conditions | Asked::Inputs) => {}
                (Event::Ready, Asked::Conditions) => {
                    let (skip, fail) = self.conditions(at);
                    if skip && !fail {
                        self.outcomes[at] = Some(Outcome::Skipped);
                        events.push((at, Event::Completed));
                        continue;
                    }
                    needed.push(self.graph.nodes[instance.node].kind);
                    self.asked[at] = Asked::Inputs;
                    // After a failure nothing more is requested: the worker finds it and reports.
                    self.wait(at, if fail { &[] } else { &instance.from }, &mut events);
                }
                (Event::Ready, _) => {
                    self.ready.push((self.chain[at], Reverse(at)));
                    ready += 1;
                }
                (Event::Completed, _) => {
                    for waiting in std::mem::take(&mut self.waiting[at]) {
                        self.waits[waiting] -= 1;
                        if self.waits[waiting] == 0 {
                            events.push((waiting, Event::Ready));
                        }
                    }
                    self.leave(at);
                }
            }
        }
        (ready, needed)
    }

    /// Lets `at` wait for those of `others` that are not settled, and requests them.
    fn wait(&mut self, at: usize, others: &[usize], events: &mut Vec<(usize, Event)>) {
        for &other in others.iter().filter(|&&other| self.outcomes[other].is_none()) {
            self.waiting[other].push(at);
            self.waits[at] += 1;
            events.push((other, Event::Asked));
        }
        if self.waits[at] == 0 {
            events.push((at, Event::Ready));
        }
    }

    /// Whether a condition of `at` does not hold, and whether one has failed. All of them are
    /// settled.
    fn conditions(&self, at: usize) -> (bool, bool) {
        let instance = &self.graph.instances[at];
        let (mut skip, mut fail) = (false, false);
        for &condition in &instance.conditions {
            match self.outcomes[condition]
                .as_ref()
                .expect("conditions are settled before they are looked at")
            {
                Outcome::Done(entry) => {
                    let when = instance.when.as_ref().filter(|when| when.instance == condition);
                    skip |= when.is_some_and(|when| !holds(when, &entry.header));
                }
                Outcome::Skipped => skip = true,
                Outcome::Failed | Outcome::Blocked(_) | Outcome::Cancelled => fail = true,
            }
        }
        (skip, fail)
    }

    /// Instance `at` will take nothing more. An instance whose result nobody else may request takes
    /// nothing either.
    fn leave(&mut self, at: usize) {
        let mut leaving = vec![at];
        while let Some(at) = leaving.pop() {
            self.serve(at);
            for &from in &self.graph.instances[at].from {
                self.hopes[from] -= 1;
                if self.hopes[from] == 0 && self.asked[from] == Asked::No {
                    leaving.push(from);
                }
            }
        }
    }

    /// Instance `at`, a hit, takes its inputs after all: those that are made again stay until it
    /// has all of them.
    fn claim(&mut self, at: usize) {
        if std::mem::replace(&mut self.served[at], false) {
            let ports = self.graph.instances[at].ports();
            ports.for_each(|(_, edge)| self.uses[edge.instance][edge.port] += 1);
        }
    }

    /// Instance `at` has taken its inputs. Ports without another consumer keep only their header,
    /// unless nobody else holds the values.
    fn serve(&mut self, at: usize) {
        if std::mem::replace(&mut self.served[at], true) {
            return;
        }
        for (_, edge) in self.graph.instances[at].ports() {
            let (from, port) = (edge.instance, edge.port);
            self.uses[from][port] -= 1;
            self.let_go(from, port);
        }
    }

    fn let_go(&mut self, at: usize, port: usize) {
        if self.uses[at][port] == 0
            && let Some(Outcome::Done(entry)) = &mut self.outcomes[at]
            && !entry.cut_short
        {
            *entry = Arc::new(entry.without(port));
            let bytes = entry.resident();
            self.held_now = self.held_now - self.held[at] + bytes;
            self.held[at] = bytes;
        }
    }
}

/// Members are names, each once.
fn check_members(node: &GraphNode, outputs: &[PortValue]) -> Result<(), String> {
    for (port, output) in node.outputs.iter().zip(outputs) {
        let PortValue::Many(all) = output else { continue };
        for (i, (member, _)) in all.iter().enumerate() {
            let twice = all[..i].iter().any(|(other, _)| other == member);
            if twice || !is_name(member) {
                let wrong = if twice { "given twice" } else { "no name" };
                return Err(format!(
                    "a bug in {}: member `{member}` of output `{}` is {wrong}",
                    node.kind, port.name
                ));
            }
        }
    }
    Ok(())
}

/// The message of a panic.
fn said(panic: &(dyn std::any::Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("no message")
}
