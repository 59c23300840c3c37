//! The program without the files of the project: its binary in a folder of its own, in an empty
//! home. `RELIGHT_PROGRAM` names another binary, such as that of an archive.

use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::sync::Mutex;

/// Held while a program is copied or started: a process that starts during a copy inherits the
/// open file until it executes its own program, and a program that is open for writing cannot be
/// started.
static STARTING: Mutex<()> = Mutex::new(());

struct Alone {
    folder: tempfile::TempDir,
}

impl Alone {
    fn new() -> Alone {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let bin = folder.path().join("bin");
        std::fs::create_dir(&bin).expect("a folder can be made");
        let other = std::env::var_os("RELIGHT_PROGRAM");
        let program = other.unwrap_or_else(|| env!("CARGO_BIN_EXE_relight").into());
        // A link would lead back to the checkout.
        let _alone = STARTING.lock();
        std::fs::copy(program, bin.join("relight")).expect("the program can be copied");
        Alone { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(self.path("bin/relight"));
        command.args(args).current_dir(self.folder.path()).env_clear();
        command.env("HOME", self.folder.path());
        command
    }

    fn start(&self, args: &[&str]) -> Child {
        let mut command = self.command(args);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let _alone = STARTING.lock();
        command.spawn().expect("it starts")
    }

    fn relight(&self, args: &[&str]) -> Output {
        self.start(args).wait_with_output().expect("it ends")
    }

    #[track_caller]
    fn done(&self, args: &[&str]) -> String {
        let output = self.relight(args);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{args:?}: {errors}");
        String::from_utf8(output.stdout).expect("it is text")
    }
}

#[test]
#[cfg(unix)]
fn a_copied_program_runs_its_graphs_by_name() {
    let alone = Alone::new();
    let edit = r#"Edit(version: 1, lights: { "lamp_0": Off })"#;
    std::fs::write(alone.path("off.ron"), edit).expect("it can be written");
    // The demo with its network, a small one for the sake of time.
    let small = ["--set", "scene.long_side=96", "--set", "write.diagnostics=false"];
    alone
        .done(&[&["run", "demo", "off.ron", "--backend", "rten", "--report"], &small[..]].concat());
    for file in ["picture.png", "picture.exr", "report.json", "report.html"] {
        assert!(alone.path("out").join(file).is_file(), "{file}");
    }
    let run = ["run", "demo", "off.ron", "--backend", "rten", "--report", "--preview"];
    alone.done(&[&run[..], &small[..]].concat());
    for file in ["picture.png", "picture.exr", "report.json", "report.html", "preview.png"] {
        assert!(alone.path("out").join(file).is_file(), "{file}");
    }
    let size = |file: &str| {
        let picture = image::open(alone.path("out").join(file)).expect("it is a picture");
        (picture.width(), picture.height())
    };
    assert_eq!((size("preview.png"), size("picture.png")), ((96, 72), (1280, 960)));
    // Surfaces and objects have pixels of the photo, and no preview.
    let text = r#"Edit(version: 1, materials: [Paint(region: Grow(640, 180), roughness: 0.9)])"#;
    std::fs::write(alone.path("paint.ron"), text).expect("it can be written");
    let run = ["run", "demo", "paint.ron", "--backend", "rten", "--preview", "--out", "painted"];
    alone.done(&[&run[..], &small[..]].concat());
    assert!(!alone.path("painted/preview.png").exists());
    alone.done(&["mix", "out", "--set", "window_0=0.5", "--out", "mixed.png"]);
    assert!(alone.path("mixed.png").is_file());
    std::fs::remove_file(alone.path("out/report.html")).expect("it is there");
    alone.done(&["report", "out"]);
    assert!(alone.path("out/report.html").is_file());
    // A graph that ships is the start of one's own.
    let text = alone.done(&["graph", "indoor", "--source"]);
    assert!(text.contains(r#"extends: "physics.ron""#), "{text}");
    assert_eq!(text, std::fs::read_to_string("graphs/indoor.ron").expect("it is there"));
    // A file of the same name wins.
    std::fs::write(alone.path("indoor"), "Graph(version: 1, nodes: {})")
        .expect("it can be written");
    assert_eq!(alone.done(&["graph", "indoor", "--source"]), "Graph(version: 1, nodes: {})");
}

#[test]
#[cfg(all(unix, feature = "serve"))]
fn a_copied_program_serves_its_page() {
    use std::io::{BufRead, BufReader, Read, Write};

    let alone = Alone::new();
    alone.done(&["check", "demo"]);
    let data = std::fs::read_dir(alone.path(".local/share/relight")).expect("it is unpacked");
    let scenes = data.map(|entry| entry.expect("it can be listed").path().join("scenes/demo"));
    let scene = scenes.into_iter().find(|scene| scene.is_dir()).expect("the scene is unpacked");
    let scene = scene.to_str().expect("ASCII");
    let mut server = alone.start(&["serve", scene, "--set", "scene.long_side=96"]);
    let mut line = String::new();
    let out = server.stdout.take().expect("it is piped");
    BufReader::new(out).read_line(&mut line).expect("it prints its address");
    let (host, token) = line
        .trim()
        .strip_prefix("http://")
        .and_then(|rest| rest.split_once("/?token="))
        .expect("an address with a token");
    let get = |path: &str| {
        let mut stream = std::net::TcpStream::connect(host).expect("it listens");
        let head = format!("Host: {host}\r\nAuthorization: Bearer {token}\r\nConnection: close");
        write!(stream, "GET {path} HTTP/1.1\r\n{head}\r\n\r\n").expect("it reads");
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).expect("it answers");
        String::from_utf8_lossy(&answer).into_owned()
    };
    assert!(get("/").contains("<!doctype html>"), "{}", get("/"));
    let began = std::time::Instant::now();
    while !get("/api/state").contains(r#""status":"done""#) {
        assert!(began.elapsed().as_secs() < 120, "{}", get("/api/state"));
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    assert!(get("/api/picture.png").starts_with("HTTP/1.1 200"));
    server.kill().expect("it runs");
    server.wait().expect("it ends");
}

#[test]
#[cfg(unix)]
fn a_home_that_cannot_be_written_is_named() {
    let alone = Alone::new();
    std::fs::write(alone.path(".local"), "a file").expect("it can be written");
    let output = alone.relight(&["check", "demo"]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{errors}");
    assert!(errors.contains("cannot be unpacked") && errors.contains("--models DIR"), "{errors}");
}
