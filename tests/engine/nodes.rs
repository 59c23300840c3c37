//! Tiny arithmetic stages, and shorthand to run graphs of them.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use relight::graph::{
    Artifact, CacheFolder, CacheKey, Cancel, Context, Diagnostic, Diagnostics, DiskCache, Engine,
    EngineOptions, File, Gather, GraphFile, Node, NodeError, Overlay, PortValue, Raw, Registry,
    ResolvedGraph, RunReport, Scatter, Setting, Source, Status, Target,
};
use relight::{params, ports};
use serde::{Deserialize, Serialize};

#[derive(Serialize, Deserialize)]
pub struct Number(pub i64);
impl Artifact for Number {
    const TYPE: &'static str = "Number";
    fn bytes(&self) -> usize {
        8
    }
}

#[derive(Serialize, Deserialize)]
pub struct Text(pub String);
impl Artifact for Text {
    const TYPE: &'static str = "Text";
    fn bytes(&self) -> usize {
        self.0.len()
    }
}

ports! { pub input NoIn {} }
ports! { pub input OneIn { number: Arc<Number> } }
ports! { pub input TwoIn { a: Arc<Number>, b: Arc<Number> } }
ports! { pub input MaybeIn { number: Arc<Number>, more: Option<Arc<Number>> } }
ports! { pub input ManyIn { numbers: Gather<Number> } }
ports! { pub output NumberOut { number: Arc<Number> } }
ports! { pub output PairOut { tens: Arc<Number>, ones: Arc<Number> } }
ports! { pub output SignOut { number: Arc<Number>, positive: bool } }
ports! { pub output SplitOut { parts: Scatter<Number> } }
ports! { pub output TextOut { text: Arc<Text> } }

fn number(n: i64) -> Result<NumberOut, NodeError> {
    Ok(NumberOut { number: Arc::new(Number(n)) })
}

macro_rules! node {
    ($name:ident, $input:ty, $output:ty, |$this:ident, $in:ident, $ctx:ident| $body:expr) => {
        impl Node for $name {
            const KIND: &'static str = stringify!($name);
            const VERSION: u32 = 1;
            type In = $input;
            type Out = $output;
            fn run(&self, $in: $input, $ctx: &Context) -> Result<$output, NodeError> {
                let $this = self;
                $body
            }
        }
    };
}

params! { /** A number. */ pub struct Const { /** The number. */ value: i64 = 0 } }
node!(Const, NoIn, NumberOut, |this, _i, _c| number(this.value));

params! { /** A number plus a number. */ pub struct Add { /** The summand. */ plus: i64 = 1 } }
node!(Add, OneIn, NumberOut, |this, i, _c| number(i.number.0.wrapping_add(this.plus)));

params! { /** A number, after a while. */ pub struct Slow { /** Time, milliseconds. */ wait: u64 = 80 } }
node!(Slow, OneIn, NumberOut, |this, i, _c| {
    std::thread::sleep(std::time::Duration::from_millis(this.wait));
    number(i.number.0)
});

params! { /** A number times a number. */ pub struct Times { /** The factor. */ by: i64 = 1 } }
node!(Times, OneIn, NumberOut, |this, i, _c| number(i.number.0.wrapping_mul(this.by)));

params! { /** Counts its rounds, as many as there is time for. */ pub struct Patient { /** Wanted rounds. */ rounds: i64 = 1 } }
node!(Patient, OneIn, NumberOut, |this, _i, ctx| {
    ctx.set_stderr(0.5);
    let done = (0..this.rounds).take_while(|_| !ctx.out_of_time()).count();
    number(done as i64)
});

params! { /** Two numbers, mixed so that their order counts. */ pub struct Mixed {
/** A factor. */ factor: f64 = 1.0,
/** A remark. */ note: Option<String> = None } }
node!(Mixed, TwoIn, NumberOut, |_t, i, _c| number(i.a.0.wrapping_mul(31).wrapping_add(i.b.0)));

params! { /** A number, and perhaps another. */ pub struct Maybe {} }
node!(Maybe, MaybeIn, NumberOut, |_t, i, _c| number(i.number.0 + i.more.map_or(1000, |m| m.0)));

params! { /** All members, mixed so that their order counts. */ pub struct Sum {} }
node!(Sum, ManyIn, NumberOut, |_t, i, _c| number(
    i.numbers.iter().fold(0, |all: i64, (_, n)| all.wrapping_mul(7) + n.0)
));

params! { /** Tens and ones. */ pub struct Pair {} }
node!(Pair, OneIn, PairOut, |_t, i, _c| Ok(PairOut {
    tens: Arc::new(Number(i.number.0 / 10)),
    ones: Arc::new(Number(i.number.0 % 10))
}));

params! { /** A number, and whether it is positive. */ pub struct Sign {} }
node!(Sign, OneIn, SignOut, |_t, i, _c| Ok(SignOut { positive: i.number.0 > 0, number: i.number }));

params! { /** One number per member. */ pub struct Split { /** Members and their numbers. */ parts: Vec<(String, i64)> = vec![] } }
node!(Split, NoIn, SplitOut, |this, _i, _c| Ok(SplitOut {
    parts: Scatter(this.parts.iter().map(|(m, n)| (m.clone(), Arc::new(Number(*n)))).collect())
}));

/// A number below ten.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct Digit(pub i64);
impl Artifact for Digit {
    const TYPE: &'static str = "Digit";
    fn bytes(&self) -> usize {
        8
    }
    fn check(&self) -> Result<(), String> {
        if self.0 < 10 { Ok(()) } else { Err(format!("wanted a number below 10, got {}", self.0)) }
    }
}

ports! { pub output DigitOut { digit: Arc<Digit> } }
params! { /** A number that should be a digit. */ pub struct ToDigit {} }
node!(ToDigit, OneIn, DigitOut, |_t, i, _c| Ok(DigitOut { digit: Arc::new(Digit(i.number.0)) }));

params! { /** A long text of one digit, quick to make. */ pub struct Repeat { /** Its length. */ length: usize = 8 } }
impl Node for Repeat {
    const KIND: &'static str = "Repeat";
    const VERSION: u32 = 1;
    const STORED_UP_TO: u64 = 1000;
    type In = OneIn;
    type Out = TextOut;
    fn run(&self, inputs: OneIn, _: &Context) -> Result<TextOut, NodeError> {
        let digit = inputs.number.0.rem_euclid(10).to_string();
        Ok(TextOut { text: Arc::new(Text(digit.repeat(self.length))) })
    }
}

/// Runs of `Texts`.
pub static TEXTS: AtomicI64 = AtomicI64::new(0);

ports! { pub output TextsOut { first: Arc<Text>, second: Arc<Text> } }
params! { /** Two long texts of one digit, quick to make. */ pub struct Texts {} }
impl Node for Texts {
    const KIND: &'static str = "Texts";
    const VERSION: u32 = 1;
    const STORED_UP_TO: u64 = 1000;
    type In = OneIn;
    type Out = TextsOut;
    fn run(&self, inputs: OneIn, _: &Context) -> Result<TextsOut, NodeError> {
        TEXTS.fetch_add(1, Ordering::Relaxed);
        let text = |plus: i64| Arc::new(Text((inputs.number.0 + plus).to_string().repeat(5000)));
        Ok(TextsOut { first: text(0), second: text(1) })
    }
}

ports! { pub input TextsIn { first: Arc<Text>, second: Arc<Text> } }
params! { /** One text after the other, quick to make. */ pub struct Join {} }
impl Node for Join {
    const KIND: &'static str = "Join";
    const VERSION: u32 = 1;
    const STORED_UP_TO: u64 = 1000;
    type In = TextsIn;
    type Out = TextOut;
    fn run(&self, inputs: TextsIn, _: &Context) -> Result<TextOut, NodeError> {
        Ok(TextOut { text: Arc::new(Text(inputs.first.0.clone() + &inputs.second.0)) })
    }
}

ports! { pub input TextIn { text: Arc<Text> } }
params! { /** The length of a text, and a number. */ pub struct Length { /** The number. */ plus: i64 = 0 } }
node!(Length, TextIn, NumberOut, |this, i, _c| number(i.text.0.len() as i64 + this.plus));

params! { /** A number as a text. */ pub struct Show {} }
node!(Show, OneIn, TextOut, |_t, i, _c| Ok(TextOut {
    text: Arc::new(Text(i.number.0.to_string()))
}));

params! { /** Fails. */ pub struct Fail { /** Of the failure. */ message: String = "on purpose".into() } }
node!(Fail, OneIn, NumberOut, |this, _i, _c| Err(NodeError::Failed(this.message.clone())));

params! { /** Panics. */ pub struct Panic {} }
node!(Panic, OneIn, NumberOut, |_t, _i, _c| panic!("on purpose"));

params! { /** Cancels its own run, then sees it. */ pub struct Stop {} }
node!(Stop, OneIn, NumberOut, |_t, i, ctx| {
    CANCEL.with(|c| c.borrow().cancel());
    ctx.check_cancelled()?;
    number(i.number.0)
});

params! { /** Gives another number every time, which no stage may. */ pub struct Impure {} }
node!(Impure, OneIn, NumberOut, |_t, i, _c| number(
    i.number.0 + CALLS.fetch_add(1, Ordering::Relaxed)
));

params! { /** Splits work over threads, counts rays, warns. */ pub struct Busy {
/** Numbers. */ work: u64 = 1000,
/** Whether it warns. */ note: bool = false,
/** Not used. */ scale: f32 = 1.0 } }
node!(Busy, OneIn, NumberOut, |this, i, ctx| {
    use rayon::prelude::*;
    let sum: u64 = (0..this.work)
        .into_par_iter()
        .map(|n| n.wrapping_mul(n.wrapping_add(i.number.0 as u64)))
        .reduce(|| 0, u64::wrapping_add);
    ctx.count_rays(this.work);
    ctx.set_stderr(0.25);
    if this.note {
        ctx.warn("this is only a test");
    }
    number(sum as i64)
});

params! { /** The length of a file, times its first byte. */ pub struct Read {
/** The file. */ file: File = File::default(),
/** Not used. */ limit: u32 = 10, in 0..=10 } }
impl Node for Read {
    const KIND: &'static str = "Read";
    const VERSION: u32 = 1;
    type In = NoIn;
    type Out = NumberOut;
    fn files(&mut self) -> Vec<&mut File> {
        vec![&mut self.file]
    }
    fn run(&self, _: NoIn, ctx: &Context) -> Result<NumberOut, NodeError> {
        let bytes = ctx.read(&self.file)?;
        number(bytes.len() as i64 * 1000 + i64::from(bytes.first().copied().unwrap_or(0)))
    }
}

static CALLS: AtomicI64 = AtomicI64::new(0);

thread_local! {
    static CANCEL: std::cell::RefCell<Cancel> = std::cell::RefCell::default();
}

pub fn registry() -> Registry {
    Registry::new()
        .with::<Const>()
        .with::<Add>()
        .with::<Slow>()
        .with::<Times>()
        .with::<Patient>()
        .with::<Mixed>()
        .with::<Maybe>()
        .with::<Sum>()
        .with::<Pair>()
        .with::<Sign>()
        .with::<Split>()
        .with::<Show>()
        .with::<Repeat>()
        .with::<Texts>()
        .with::<Join>()
        .with::<Length>()
        .with::<ToDigit>()
        .with::<Fail>()
        .with::<Panic>()
        .with::<Stop>()
        .with::<Impure>()
        .with::<Busy>()
        .with::<Read>()
}

/// A graph from the inside of `Graph(version: 1, ..)`.
pub fn graph(body: &str) -> ResolvedGraph {
    graph_with(body, &Overlay::default())
}

pub fn graph_with(body: &str, overlay: &Overlay) -> ResolvedGraph {
    try_graph(&format!("Graph(version: 1, {body})"), overlay)
        .unwrap_or_else(|faults| panic!("{}", list(&faults)))
}

pub fn try_graph(text: &str, overlay: &Overlay) -> Result<ResolvedGraph, Vec<Diagnostic>> {
    GraphFile::parse(Source::new("graphs/test.ron", text))?.resolve(&registry(), overlay)
}

pub fn list(faults: &[Diagnostic]) -> String {
    faults.iter().map(|fault| format!("{fault}\n")).collect()
}

/// `node.field=value`, or `Kind.field=value`, as if written in `path`.
pub fn setting(path: &str, text: &str) -> Setting {
    let (target, rest) = text.split_once('.').expect("a dot");
    let (field, value) = rest.split_once('=').expect("an equals sign");
    let is_kind = target.starts_with(char::is_uppercase);
    let target = if is_kind { Target::Kind(target.into()) } else { Target::Node(target.into()) };
    let value =
        Raw::document(&Source::new(path, value), &mut Diagnostics::default()).expect("a RON value");
    Setting { target, field: field.into(), value }
}

pub fn settings(texts: &[&str]) -> Overlay {
    Overlay { settings: texts.iter().map(|text| setting("--set", text)).collect(), members: vec![] }
}

pub fn in_memory() -> Engine {
    engine(EngineOptions { threads: Some(2), ..EngineOptions::default() })
}

pub fn on_disk(folder: &std::path::Path) -> Engine {
    engine(EngineOptions {
        cache: Some(cache(folder, b"own")),
        threads: Some(2),
        ..EngineOptions::default()
    })
}

/// A cache whose entries are signed with a secret.
pub fn cache(folder: &std::path::Path, secret: &[u8]) -> CacheFolder {
    CacheFolder::new(folder, CacheKey::new(secret))
}

/// The same for who looks after it.
pub fn disk_cache(folder: &std::path::Path) -> DiskCache {
    DiskCache::new(cache(folder, b"own"))
}

pub fn engine(options: EngineOptions) -> Engine {
    Engine::new(options).expect("threads")
}

pub fn run(engine: &Engine, graph: &ResolvedGraph) -> RunReport {
    run_for(engine, graph, None)
}

pub fn run_for(engine: &Engine, graph: &ResolvedGraph, wanted: Option<&[&str]>) -> RunReport {
    let names: Option<Vec<String>> =
        wanted.map(|names| names.iter().map(|n| n.to_string()).collect());
    let wanted = graph.wanted(names.as_deref()).unwrap_or_else(|fault| panic!("{fault}"));
    engine.run(graph, &wanted, &Cancel::default(), &())
}

/// Runs on one thread with a flag that the stage `Stop` raises.
pub fn run_cancelled(graph: &ResolvedGraph) -> RunReport {
    let cancel = Cancel::default();
    let shared = cancel.clone();
    let engine = engine(EngineOptions { threads: Some(1), ..EngineOptions::default() });
    struct Hand(Cancel);
    impl relight::graph::Observer for Hand {
        fn started(&self, _: &str) {
            CANCEL.with(|c| *c.borrow_mut() = self.0.clone());
        }
    }
    engine.run(graph, &graph.wanted(None).expect("outputs"), &cancel, &Hand(shared))
}

pub fn ran(report: &RunReport) -> Vec<&str> {
    report.with_status(Status::Ran)
}

pub fn value(report: &RunReport, name: &str) -> i64 {
    match report.output(name) {
        Some(PortValue::One(value)) => value.get::<Number>().expect("a number").0,
        _ => panic!("no single value `{name}`; {:?}", report.nodes),
    }
}

pub fn why<'a>(report: &'a RunReport, node: &str) -> &'a str {
    report.nodes.iter().find(|n| n.name == node).and_then(|n| n.why.as_deref()).unwrap_or("")
}
