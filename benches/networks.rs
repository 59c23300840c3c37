//! Milliseconds to load and to run each network of models/ on a room of tests/parity: rten, and
//! beside it ONNX Runtime where `ORT_DYLIB_PATH` names its library, and PyTorch where
//! `RELIGHT_TORCH` names a Python that has it (benches/peers/torch_networks.py). They take turns.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Instant;

use npyz::NpyFile;
use relight::net::{Backend, CARDS, Network, Tensor, find_onnxruntime};

const LOADS: usize = 3;
const ROUNDS: usize = 15;
const THREADS: [usize; 2] = [1, 2];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// An input of a network, written by its training; the name of a shared input contains no network.
fn input(network: &str, name: &str) -> Tensor {
    let own = root().join(format!("tests/parity/{network}.{name}.npy"));
    let path = if own.exists() { own } else { root().join(format!("tests/parity/{name}.npy")) };
    let bytes = fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let npy = NpyFile::new(&bytes[..]).expect("an NPY file");
    let shape: Vec<usize> = npy.shape().iter().map(|&n| n as usize).collect();
    let values = npy.into_vec::<half::f16>().expect("numbers of 16 bits");
    Tensor::new(&shape, values.into_iter().map(f32::from).collect())
}

fn milliseconds<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let began = Instant::now();
    let made = work();
    (began.elapsed().as_secs_f64() * 1e3, made)
}

/// A network on one of our backends.
struct Ours {
    network: Network,
    load: f64,
}

impl Ours {
    fn new(bytes: &[u8], backend: &Backend, threads: usize) -> Ours {
        let load =
            || Network::load(bytes.to_vec(), backend, threads).expect("a network that ships");
        let loads: Vec<(f64, Network)> = (0..LOADS).map(|_| milliseconds(load)).collect();
        let least = loads.iter().fold(f64::INFINITY, |least, (ms, _)| least.min(*ms));
        let (_, network) = loads.into_iter().next_back().expect("at least one");
        Ours { network, load: least }
    }

    fn run(&self, name: &str) -> f64 {
        let inputs = self
            .network
            .inputs()
            .iter()
            .map(|port| (port.name.as_str(), input(name, &port.name)))
            .collect();
        let outputs: Vec<&str> =
            self.network.outputs().iter().map(|port| port.name.as_str()).collect();
        milliseconds(|| self.network.run_to(inputs, &outputs).expect("it runs")).0
    }
}

/// PyTorch, which answers each request with milliseconds.
struct Torch {
    child: Child,
    answers: BufReader<ChildStdout>,
}

impl Torch {
    fn new(python: PathBuf) -> Torch {
        let script = root().join("benches/peers/torch_networks.py");
        let mut command = Command::new(&python);
        let command = command.arg(script).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap_or_else(|e| panic!("{}: {e}", python.display()));
        let answers = BufReader::new(child.stdout.take().expect("it is piped"));
        Torch { child, answers }
    }

    fn run(&mut self, name: &str, threads: usize) -> f64 {
        writeln!(self.child.stdin.as_mut().expect("it is piped"), "{name} {threads}")
            .expect("it listens");
        let mut line = String::new();
        self.answers.read_line(&mut line).expect("it answers");
        line.trim().parse().unwrap_or_else(|_| panic!("wanted milliseconds, got {line:?}"))
    }
}

fn main() {
    let named = |variable| std::env::var_os(variable).filter(|v| !v.is_empty()).map(PathBuf::from);
    let runtime = named("ORT_DYLIB_PATH")
        .map(|path| find_onnxruntime(&path).expect("a library of ONNX Runtime"));
    let mut torch = named("RELIGHT_TORCH").map(Torch::new);

    println!("milliseconds, least of {LOADS} loads and of {ROUNDS} runs; -: not there");
    println!(
        "{:14} {:>7} {:>10} {:>9} {:>10} {:>9} {:>9} {:>9} {:>10}",
        "network",
        "threads",
        "rten load",
        "run",
        "ort load",
        "run",
        "torch run",
        "rten/ort",
        "torch/ort"
    );
    let shown = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.2}"));
    for threads in THREADS {
        let mut sums = [Some(0.0); 5];
        let line = |name: &str, times: [Option<f64>; 5]| {
            let [rten_load, rten, ort_load, ort, torch] = times;
            let over = |a: Option<f64>| Some(a? / ort?);
            println!(
                "{name:14} {threads:>7} {:>10} {:>9} {:>10} {:>9} {:>9} {:>9} {:>10}",
                shown(rten_load),
                shown(rten),
                shown(ort_load),
                shown(ort),
                shown(torch),
                shown(over(rten)),
                shown(over(torch))
            );
        };
        for (file, _) in CARDS {
            let name = file.trim_end_matches(".onnx");
            let bytes = fs::read(root().join("models").join(file)).expect("it ships");
            let rten = Ours::new(&bytes, &Backend::Rten, threads);
            let ort = runtime.as_ref().map(|backend| Ours::new(&bytes, backend, threads));
            let mut least = [f64::INFINITY; 3];
            for _ in 0..ROUNDS {
                least[0] = least[0].min(rten.run(name));
                least[1] = ort.as_ref().map_or(least[1], |ort| least[1].min(ort.run(name)));
                least[2] =
                    torch.as_mut().map_or(least[2], |torch| least[2].min(torch.run(name, threads)));
            }
            let there = |ms: f64| ms.is_finite().then_some(ms);
            let times = [
                Some(rten.load),
                there(least[0]),
                ort.map(|ort| ort.load),
                there(least[1]),
                there(least[2]),
            ];
            sums.iter_mut()
                .zip(times)
                .for_each(|(sum, ms)| *sum = sum.zip(ms).map(|(sum, ms)| sum + ms));
            line(name, times);
        }
        line("all", sums);
    }
    if let Some(mut torch) = torch {
        drop(torch.child.stdin.take());
        torch.child.wait().expect("it ends");
    }
}
