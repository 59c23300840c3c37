//! Networks that do not ship with relight may be hostile: their bytes are checked before a loader
//! reads them, and a child process with limits computes them. In this process, each of these files
//! aborts, hangs or outlasts Ctrl-C.

use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use relight::geometry::Camera;
use relight::graph::{Context, Engine, EngineOptions, File, Node, NodeError, Services};
use relight::image::{Picture, Plane};
use relight::net::{
    Backend, Limits, NetError, Network, Sandbox, Tensor, Untrusted, find_onnxruntime, precheck,
    ships,
};
use relight::nodes::estimate::depth::{Depth, DepthIn, DepthOutput};

use crate::adapters::{LINE, metric, photo};
use crate::onnx::{OPEN, Onnx, bytes, number, varint};
use crate::project::*;

/// Far longer than anything here takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// Metric depth of a photo, which never ends.
fn endless() -> Vec<u8> {
    let network =
        Onnx::default().input("rgb", &[1, 3, OPEN, OPEN]).output("z", &[1, 1, OPEN, OPEN]);
    network.mix("rgb", "once", &[[4.0, 2.0, 0.0]], &[1.0]).endless("once", "z").file()
}

/// Metric depth, for which a constant of 4 TiB is made.
fn greedy() -> Vec<u8> {
    let network =
        Onnx::default().input("rgb", &[1, 3, OPEN, OPEN]).output("z", &[1, 1, OPEN, OPEN]);
    let network = network
        .mix("rgb", "once", &[[4.0, 2.0, 0.0]], &[1.0])
        .numbers("shape", &[1 << 30, 1 << 10]);
    network
        .node("ConstantOfShape", &["shape"], &["all"])
        .node("ReduceMax", &["all"], &["most"])
        .node("Add", &["once", "most"], &["z"])
        .file()
}

/// A message whose length is `length`, with any content.
fn opened(field: u64, length: u64) -> Vec<u8> {
    let mut out = Vec::new();
    varint(&mut out, field << 3 | 2);
    varint(&mut out, length);
    out
}

/// A graph, a node and a name, each longer than the one around it: rten allocates the name.
fn aborting() -> Vec<u8> {
    let length = 5_188_146_770_730_811_392;
    let mut file = vec![8, 8];
    file.extend([opened(7, length + 2000), opened(1, length + 1000), opened(4, length)].concat());
    file.resize(57, b'x');
    file
}

/// A field of -12 bytes: rten goes back and reads it again, for ever.
fn hanging() -> Vec<u8> {
    [vec![8, 8], opened(7, 1 << 40), opened(99, 12_u64.wrapping_neg())].concat()
}

/// Graphs in nodes of graphs, `depth` of them.
fn nested(depth: usize) -> Vec<u8> {
    let mut graph = Vec::new();
    for _ in 0..depth {
        let (mut attribute, mut node) = (Vec::new(), Vec::new());
        bytes(&mut attribute, 6, &graph);
        bytes(&mut node, 5, &attribute);
        graph.clear();
        bytes(&mut graph, 1, &node);
    }
    let mut file = vec![8, 8];
    bytes(&mut file, 7, &graph);
    bytes(&mut file, 8, &[16, 17]);
    file
}

/// A process that does not outlive its test.
struct Started(Child);

impl Drop for Started {
    fn drop(&mut self) {
        self.0.kill().expect("it is our child");
        self.0.wait().expect("it is our child");
    }
}

impl Started {
    fn new(command: &mut Command) -> Started {
        Started(command.spawn().expect("the program starts"))
    }

    /// Waits for the process to end; returns `None` if it does not.
    fn end(&mut self) -> Option<ExitStatus> {
        let began = Instant::now();
        while began.elapsed() < PATIENCE {
            if let Some(status) = self.0.try_wait().expect("it is our child") {
                return Some(status);
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        None
    }
}

/// Runs depth by a network; returns exit status and standard error.
fn message(network: &[u8], set: &str) -> (Option<i32>, String) {
    let place = photo(network);
    let errors = std::fs::File::create(place.path("message")).expect("a file can be written");
    let mut command = place.command(&format!("{LINE} --set depth.kind=Metric {set}"));
    let end = Started::new(command.stdout(Stdio::null()).stderr(errors)).end();
    let text = std::fs::read_to_string(place.path("message")).expect("it was written");
    (end.unwrap_or_else(|| panic!("it does not end:\n{text}")).code(), text)
}

#[test]
fn files_that_abort_or_hang_a_loader_are_refused() {
    for (name, network, wanted) in [
        ("aborts", aborting(), "wanted 5188146770730813392 more bytes, the file has 45 there"),
        ("hangs", hanging(), "wanted 1099511627776 more bytes, the file has 12 there"),
        ("nests", nested(5000), "wanted at most 40 nested messages, got more"),
    ] {
        let (status, message) = message(&network, "--backend rten");
        let wanted = format!(
            "error: depth: net.onnx: wanted a network in ONNX that rten computes: {wanted}\n"
        );
        assert!(status == Some(2) && message.contains(&wanted), "{name}: {status:?}: {message}");
    }
}

#[test]
fn more_memory_than_the_limit_is_an_error_with_a_cause() {
    let (status, message) = message(&greedy(), "--backend rten");
    let wanted = "error: depth: net.onnx: it wanted more memory than the 4 GiB that are allowed\n";
    assert!(status == Some(2) && message.contains(wanted), "{status:?}: {message}");
}

/// The child process of the command, with these limits.
fn sandbox(limits: Limits) -> Sandbox {
    let program = PathBuf::from(env!("CARGO_BIN_EXE_relight"));
    Sandbox { program, arguments: vec!["run-network".into()], environment: Vec::new(), limits }
}

/// A program of the shell in the place of the child.
fn shell(script: &str, limits: Limits) -> Sandbox {
    let arguments = vec!["-c".into(), script.into()];
    Sandbox { program: "/bin/sh".into(), arguments, environment: Vec::new(), limits }
}

fn load(network: &[u8], sandbox: &Sandbox) -> Result<Network, NetError> {
    Network::load_sandboxed(network, &Backend::Rten, 2, sandbox, || false)
}

fn rgb() -> Vec<(&'static str, Tensor)> {
    vec![("rgb", Tensor::new(&[1, 3, 5, 7], (0..105).map(|i| i as f32 / 105.0).collect()))]
}

#[test]
fn more_time_than_the_limit_is_an_error_with_a_cause() {
    let second = Limits { run: Duration::from_secs(1), ..Limits::default() };
    let network = load(&endless(), &sandbox(second)).expect("it can be loaded");
    assert_eq!(network.inputs()[0].name, "rgb");
    let error = network.run(rgb(), ["z"]).expect_err("it never ends");
    assert_eq!(
        error,
        NetError::Limit("computing it took longer than the 1 s that are allowed".into())
    );
    let error = network.run(rgb(), ["z"]).expect_err("its process is gone").to_string();
    assert!(error.starts_with("its process ended before it answered: "), "{error}");

    let half = Limits { load: Duration::from_millis(500), ..Limits::default() };
    let error = load(&metric(), &shell("exec sleep 60", half)).err().expect("it does not answer");
    assert_eq!(
        error,
        NetError::Limit("loading it took longer than the 0.5 s that are allowed".into())
    );
}

#[test]
fn a_run_that_is_cancelled_ends_the_child() {
    let stop = Arc::new(AtomicBool::new(false));
    let cancelled = stop.clone();
    let asked = move || cancelled.load(Ordering::Relaxed);
    let network =
        Network::load_sandboxed(&endless(), &Backend::Rten, 2, &sandbox(Limits::default()), asked);
    let network = network.expect("it can be loaded");
    std::thread::scope(|scope| {
        let run = scope.spawn(|| network.run(rgb(), ["z"]));
        std::thread::sleep(Duration::from_millis(100));
        stop.store(true, Ordering::Relaxed);
        assert_eq!(run.join().expect("no panic").expect_err("it never ends"), NetError::Cancelled);
    });
}

/// No answer of a child makes the program allocate or accept invalid data.
#[test]
fn a_child_that_lies_is_an_error() {
    let ports = |hex: &str| format!("printf '{hex}'; exec sleep 60");
    for (name, script, wanted) in [
        (
            "a huge head",
            ports(r"\377\377\377\377\377\377\377\377"),
            "its process returned an answer that cannot be read: ",
        ),
        (
            "no head",
            ports(r"\003\000\000\000\000\000\000\000\377\377\377"),
            "its process returned an answer that cannot be read: ",
        ),
        ("silence", "exit 7".into(), "its process ended before it answered: exit status: 7"),
        (
            "a signal",
            "kill -SEGV $$".into(),
            "its process ended before it answered: signal: 11 (SIGSEGV)",
        ),
    ] {
        let error = load(&metric(), &shell(&script, Limits::default())).err().expect("it lies");
        assert!(
            matches!(&error, NetError::Ended(text) if text.starts_with(wanted)),
            "{name}: {error:?}"
        );
    }
    // It loads nothing, has no ports, and then gives one output of 2^40 numbers.
    let script = r"printf '\003\000\000\000\000\000\000\000\000\000\000'; printf '\011\000\000\000\000\000\000\000\000\001\001\200\200\200\200\200\040'; exec sleep 60";
    let network = load(&metric(), &shell(script, Limits::default())).expect("it says so");
    let error = network.run(rgb(), ["z"]).expect_err("it is too large").to_string();
    assert!(error.contains("wanted at most 268435456 numbers, got [1099511627776]"), "{error}");

    let nowhere = Sandbox { program: "/nowhere/relight".into(), ..sandbox(Limits::default()) };
    let error = load(&metric(), &nowhere).err().expect("there is no such program").to_string();
    assert!(error.starts_with("its process, /nowhere/relight, cannot be started: "), "{error}");
}

#[test]
fn a_child_gives_the_bits_that_this_process_gives() {
    let bytes = std::fs::read(root().join("models/mnet.onnx")).expect("it ships");
    let mut backends = vec![Backend::Rten];
    match std::env::var_os("ORT_DYLIB_PATH") {
        Some(path) => {
            backends.push(find_onnxruntime(path.as_ref()).expect("it is a library of ONNX Runtime"))
        }
        None => eprintln!("ort skipped: ORT_DYLIB_PATH names no library of ONNX Runtime"),
    }
    for backend in &backends {
        let here = Network::load(bytes.clone(), backend, 2).expect("it ships");
        let inputs = || {
            let ports =
                here.inputs().iter().map(|port| (port.name.as_str(), port.shape.iter().flatten()));
            let tensor = |shape: Vec<usize>| {
                let numbers = (0..shape.iter().product())
                    .map(|i: usize| (i * 2_654_435_761 % 1000) as f32 / 1000.0);
                Tensor::new(&shape, numbers.collect())
            };
            ports
                .map(|(name, shape)| (name, tensor(shape.map(|n| n.unwrap_or(1)).collect())))
                .collect::<Vec<_>>()
        };
        let outputs: Vec<&str> = here.outputs().iter().map(|port| port.name.as_str()).collect();
        let wanted = here.run_to(inputs(), &outputs).expect("it runs");
        for threads in [1, 3] {
            let there = Network::load_sandboxed(
                &bytes,
                backend,
                threads,
                &sandbox(Limits::default()),
                || false,
            );
            let there = there.expect("it ships");
            assert_eq!((there.inputs(), there.outputs()), (here.inputs(), here.outputs()));
            let got = there.run_to(inputs(), &outputs).expect("it runs");
            let bits = |all: &[Tensor]| -> Vec<Vec<u32>> {
                all.iter()
                    .map(|tensor| tensor.data().iter().map(|v| v.to_bits()).collect())
                    .collect()
            };
            assert_eq!(got, wanted, "{backend}, {threads} threads");
            assert!(bits(&got) == bits(&wanted), "{backend}, {threads} threads");
        }
    }
}

/// A library that is used without the command chooses for itself.
#[test]
fn without_a_choice_a_stage_refuses() {
    let place = photo(metric());
    let model = File::new(place.path("net.onnx").display().to_string());
    let stage =
        Depth { model, kind: DepthOutput::Metric, side: 8, multiple: 1, ..Depth::default() };
    let inputs = || DepthIn {
        photo: Arc::new(Picture(Plane::filled(8, 8, glam::Vec3::splat(0.5)))),
        camera: Arc::new(Camera::from_fov_x(8, 8, 60.0)),
    };
    let Err(NodeError::Failed(message)) = stage.run(inputs(), &Context::default()) else {
        panic!("it ran")
    };
    assert!(message.contains("net.onnx: wanted a network that ships with relight"), "{message}");

    // The choice, made for an engine: in this process.
    let graph = || {
        let line = r#"Graph(version: 1, nodes: { "photo": (op: ReadPhoto(photo: "photo.png")),
            "depth": (op: Depth(model: "net.onnx", kind: Metric), in: { "photo": "photo.photo", "camera": "photo.camera" }) }, outputs: ["depth.depth"])"#;
        place.write("here.ron", line);
        let file = relight::graph::GraphFile::read(&place.path("here.ron")).expect("it is sound");
        file.resolve(&relight::nodes::registry(), &Default::default())
            .unwrap_or_else(|faults| panic!("{}", faults[0]))
    };
    for (services, runs) in
        [(Services::default(), false), (Services::default().with(Untrusted::InProcess), true)]
    {
        let engine =
            Engine::new(EngineOptions { services, ..EngineOptions::default() }).expect("threads");
        let graph = graph();
        let wanted = graph.wanted(None).expect("it has an output");
        let report = engine.run(&graph, &wanted, &relight::graph::Cancel::default(), &());
        assert_eq!(
            report.is_complete(),
            runs,
            "{:?}",
            report.nodes.iter().map(|node| &node.error).collect::<Vec<_>>()
        );
    }
}

#[test]
fn the_check_before_takes_sound_files_and_no_others() {
    for file in std::fs::read_dir(root().join("models")).expect("the project has models") {
        let path = file.expect("it can be listed").path();
        if path.extension().is_some_and(|e| e == "onnx") {
            let bytes = std::fs::read(&path).expect("it can be read");
            assert_eq!(precheck(&bytes), Ok(()), "{}", path.display());
            assert_eq!(
                ships("own.onnx", &bytes),
                Ok(true),
                "{}: it is trusted by its digest",
                path.display()
            );
        }
    }
    for sound in [metric(), endless(), greedy(), nested(12)] {
        assert_eq!(precheck(&sound), Ok(()));
        // Cut or changed anywhere, it is looked through to an end.
        for at in 0..sound.len() {
            assert!(precheck(&sound[..at]).is_err() || at > 2, "cut at {at}");
            for bit in 0..8 {
                let mut changed = sound.clone();
                changed[at] ^= 1 << bit;
                let _ = precheck(&changed);
            }
        }
    }
    let with = |message: &dyn Fn(&mut Vec<u8>)| {
        let mut tensor = Vec::new();
        message(&mut tensor);
        Onnx::default().node("Relu", &["x"], &["y"]).message(5, tensor).file()
    };
    let numbers = |dims: &'static [u64]| {
        move |tensor: &mut Vec<u8>| dims.iter().for_each(|n| number(tensor, 1, *n))
    };
    for (network, wanted) in [
        (Vec::new(), "wanted a graph with nodes, got none"),
        (b"this is no network".to_vec(), "wanted "),
        (with(&numbers(&[1 << 62])), "wanted constants with all their numbers"),
        (with(&numbers(&[1 << 40, 1 << 40])), "wanted constants with all their numbers"),
        (with(&numbers(&[u64::MAX])), "wanted constants with all their numbers"),
        (
            with(&|tensor| bytes(tensor, 1, &[0xff, 0xff, 0xff, 0xff, 0x0f])),
            "wanted constants with all their numbers",
        ),
        (
            with(&|tensor| number(tensor, 14, 1)),
            "wanted constants inside the file, got one in another file",
        ),
        (Onnx::default().message(15, vec![]).file(), "wanted dense constants, got a sparse one"),
        (nested(14), "wanted at most 40 nested messages"),
        (
            (0..100_001).fold(Onnx::default(), |all, _| all.message(1, vec![])).file(),
            "wanted at most 100000 nodes",
        ),
    ] {
        let error = precheck(&network).expect_err(wanted);
        assert!(error.starts_with(wanted), "wanted {wanted:?}, got {error:?}");
    }
}

/// Tests that look at processes through /proc.
#[cfg(target_os = "linux")]
mod processes {
    use super::*;

    /// The first process whose parent is `parent`.
    fn child_of(parent: u32) -> Option<u32> {
        let wanted = format!("PPid:\t{parent}");
        let processes = std::fs::read_dir("/proc")
            .expect("it is Linux")
            .filter_map(|entry| entry.ok()?.file_name().to_str()?.parse::<u32>().ok());
        let is_child = |process: &u32| {
            let status =
                std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
            status.lines().any(|line| line == wanted)
        };
        processes.filter(|process| *process != parent).find(is_child)
    }

    /// The files that a process holds open.
    fn open_files(process: u32) -> Vec<String> {
        let entries = std::fs::read_dir(format!("/proc/{process}/fd")).into_iter().flatten();
        let mut names: Vec<String> =
            entries.filter_map(|e| e.ok()?.file_name().into_string().ok()).collect();
        names.sort();
        names
    }

    fn is_alive(process: u32) -> bool {
        // A process that has ended stays as a zombie until its parent, or init, reads its status.
        let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
        !status.is_empty() && !status.contains("State:\tZ")
    }

    #[track_caller]
    fn wait_for<T>(what: &str, found: impl Fn() -> Option<T>) -> T {
        let began = Instant::now();
        loop {
            if let Some(found) = found() {
                return found;
            }
            assert!(began.elapsed() < PATIENCE, "{what}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    fn signal(name: &str, process: u32) {
        let status =
            Command::new("/bin/sh").args(["-c", &format!("kill -{name} {process}")]).status();
        assert!(status.expect("there is a shell").success());
    }

    /// A run whose network never ends, with a file that every child inherits; the process that
    /// holds the network, once it holds nothing else.
    fn endless_run() -> (Place, Started, u32) {
        let place = photo(endless());
        let relight = place.command(&format!("{LINE} --set depth.kind=Metric --backend rten"));
        let mut command = Command::new("/bin/sh");
        command
            .current_dir(place.folder.path())
            .args(["-c", r#"exec 7<photo.png 9<net.onnx; exec "$0" "$@""#]);
        command.arg(relight.get_program()).args(relight.get_args());
        let errors = std::fs::File::create(place.path("message")).expect("a file can be written");
        let run = Started::new(command.stdout(Stdio::null()).stderr(errors));
        let network = wait_for("no child process holds the network", || child_of(run.0.id()));
        wait_for("it holds more than its pipes", || {
            (open_files(network) == ["0", "1", "2"]).then_some(())
        });
        assert!(
            open_files(run.0.id()).contains(&"7".to_owned()),
            "the run itself has inherited a file"
        );
        // 0.2 s of processor time: it has loaded the network and computes.
        let busy = || {
            std::fs::read_to_string(format!("/proc/{network}/stat"))
                .ok()?
                .split(' ')
                .nth(13)?
                .parse()
                .ok()
        };
        wait_for("it computes nothing", || busy().filter(|ticks: &u64| *ticks > 20));
        (place, run, network)
    }

    #[test]
    fn a_child_that_is_killed_is_an_error_with_a_cause() {
        let (place, mut run, network) = endless_run();
        signal("KILL", network);
        assert_eq!(run.end().and_then(|status| status.code()), Some(1));
        let message = std::fs::read_to_string(place.path("message")).expect("it was written");
        let wanted =
            "error: depth: net.onnx: its process ended before it answered: signal: 9 (SIGKILL)\n";
        assert!(message.contains(wanted), "{message}");
    }

    #[test]
    fn ctrl_c_ends_a_run_whose_network_never_ends() {
        let (_place, mut run, network) = endless_run();
        let pressed = Instant::now();
        signal("INT", run.0.id());
        assert_eq!(run.end().and_then(|status| status.code()), Some(130));
        assert!(pressed.elapsed() < Duration::from_secs(6), "it took {:?}", pressed.elapsed());
        assert!(!is_alive(network));
    }

    #[test]
    fn a_child_does_not_outlive_the_program() {
        let (_place, run, network) = endless_run();
        drop(run); // by SIGKILL
        wait_for("the process of the network lives on", || (!is_alive(network)).then_some(()));
    }

    /// A run that is stuck outside of any stage, here at a pipe that nobody reads.
    #[test]
    fn ctrl_c_ends_a_run_that_cannot_stop() {
        let place = photo(metric());
        let (reader, writer) = std::io::pipe().expect("there are pipes");
        let mut filler = writer.try_clone().expect("a pipe can be shared");
        std::thread::spawn(
            move || while std::io::Write::write_all(&mut filler, &[0; 4096]).is_ok() {},
        );
        let mut command =
            place.command(&format!("{LINE} --set depth.kind=Metric --backend rten --json"));
        let mut run = Started::new(command.stdout(writer).stderr(Stdio::null()));
        wait_for("the run writes no report", || {
            place.path("found/report.json").is_file().then_some(())
        });
        let pressed = Instant::now();
        signal("INT", run.0.id());
        assert_eq!(run.end().and_then(|status| status.code()), Some(130));
        assert!(pressed.elapsed() < Duration::from_secs(6), "it took {:?}", pressed.elapsed());
        drop(reader);
    }
}
