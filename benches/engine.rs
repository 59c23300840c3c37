//! Overhead of the engine: a graph of 1,000 nodes that are all hits, beside a plain topological
//! walk over a graph of the same size.

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use petgraph::graph::DiGraph;
use petgraph::visit::{Topo, Walker};
use relight::graph::{
    Artifact, CacheFolder, CacheKey, Cancel, Context, Engine, EngineOptions, Gather, GraphFile,
    Node, NodeError, Overlay, Registry, ResolvedGraph, Source, Status,
};
use relight::{params, ports};

#[derive(serde::Serialize, serde::Deserialize)]
struct Number(i64);
impl Artifact for Number {
    const TYPE: &'static str = "Number";
    fn bytes(&self) -> usize {
        8
    }
}

ports! { pub input None0 {} }
ports! { pub input Two { /** One term. */ a: Arc<Number>, /** The other term. */ b: Arc<Number> } }
ports! { pub input Many { /** All terms. */ all: Gather<Number> } }
ports! { pub output One { /** The result. */ number: Arc<Number> } }
params! { /** A number. */ pub struct Const { /** The number. */ value: i64 = 0 } }
params! { /** A sum. */ pub struct Add {
/** Not used. */ scale: f64 = 1.0,
/** Not used. */ samples: u32 = 16,
/** Not used. */ seed: u64 = 0 } }
params! { /** A sum of all. */ pub struct Sum {} }

fn number(n: i64) -> Result<One, NodeError> {
    Ok(One { number: Arc::new(Number(n)) })
}

impl Node for Const {
    const KIND: &'static str = "Const";
    const VERSION: u32 = 1;
    type In = None0;
    type Out = One;
    fn run(&self, _: None0, _: &Context) -> Result<One, NodeError> {
        number(self.value)
    }
}

impl Node for Add {
    const KIND: &'static str = "Add";
    const VERSION: u32 = 1;
    type In = Two;
    type Out = One;
    fn run(&self, i: Two, _: &Context) -> Result<One, NodeError> {
        number(i.a.0.wrapping_mul(3).wrapping_add(i.b.0))
    }
}

impl Node for Sum {
    const KIND: &'static str = "Sum";
    const VERSION: u32 = 1;
    type In = Many;
    type Out = One;
    fn run(&self, i: Many, _: &Context) -> Result<One, NodeError> {
        number(i.all.iter().fold(0, |sum: i64, (_, n)| sum.wrapping_add(n.0)))
    }
}

const NODES: usize = 1000;
const ROUNDS: usize = 50;

/// `NODES` nodes, each taking from two before it.
fn graph() -> ResolvedGraph {
    let links = (1..NODES).map(|i| {
        let (a, b) = (i - 1 - i.min(i * 7 % 13 + 1).min(i - 1), i - 1);
        format!("\"n{i}\": (op: Add(seed: {i}), in: {{ \"a\": \"n{a}\", \"b\": \"n{b}\" }}), ")
    });
    let nodes: String = links.collect();
    let text = format!(
        "Graph(version: 1, nodes: {{ \"n0\": (op: Const), {nodes} }}, outputs: [\"n{}\"])",
        NODES - 1
    );
    let file =
        GraphFile::parse(Source::new("bench.ron", text)).unwrap_or_else(|f| panic!("{}", f[0]));
    let registry = Registry::new().with::<Const>().with::<Add>().with::<Sum>();
    file.resolve(&registry, &Overlay::default()).unwrap_or_else(|f| panic!("{}", f[0]))
}

/// Microseconds per node, the best of some rounds (other work only ever adds).
fn time(rounds: usize, mut work: impl FnMut()) -> f64 {
    let one = |_| {
        let began = Instant::now();
        work();
        began.elapsed().as_secs_f64()
    };
    (0..rounds).map(one).fold(f64::INFINITY, f64::min) * 1e6 / NODES as f64
}

fn main() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let options = |cache: bool| {
        let cache = cache.then(|| CacheFolder::new(folder.path(), CacheKey::new(b"a secret")));
        EngineOptions { cache, ..EngineOptions::default() }
    };
    let loading = time(5, || drop(black_box(graph())));
    let graph = graph();
    let wanted = graph.wanted(None).expect("the graph has outputs");
    let run = |engine: &Engine| engine.run(&graph, &wanted, &Cancel::default(), &());
    let engine = |cache| Engine::new(options(cache)).expect("threads");

    let mut walk = DiGraph::<usize, ()>::new();
    let indices: Vec<_> = (0..NODES).map(|i| walk.add_node(i)).collect();
    for i in 1..NODES {
        walk.add_edge(indices[i - 1], indices[i], ());
        walk.add_edge(indices[i - 1 - i.min(i * 7 % 13 + 1).min(i - 1)], indices[i], ());
    }
    assert_eq!(Topo::new(&walk).iter(&walk).count(), NODES);
    let nothing = time(ROUNDS, || {
        black_box(Topo::new(&walk).iter(&walk).map(|node| walk[node]).sum::<usize>());
    });

    let cold = time(3, || drop(run(&engine(false))));
    let warm = engine(false);
    run(&warm);
    let memory = time(ROUNDS, || drop(black_box(run(&warm))));
    assert_eq!(run(&warm).with_status(Status::Hit).len(), NODES);

    let storing = time(1, || drop(run(&engine(true))));
    let disk = time(10, || drop(black_box(run(&engine(true)))));
    assert_eq!(run(&engine(true)).with_status(Status::Hit).len(), NODES);

    println!("{NODES} nodes, microseconds per node");
    println!("plain topological walk   {nothing:9.3}");
    let line = |what: &str, cost: f64| {
        println!("{what:24} {cost:9.3}   {:8.0} x the walk", cost / nothing)
    };
    line("hit in memory", memory);
    line("hit on disk", disk);
    line("run, kept in memory", cold);
    line("run, stored and synced", storing);
    line("graph file to graph", loading);
}
