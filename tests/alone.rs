//! The program without the files of the project: its binary in a folder of its own, in an empty
//! home.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

struct Alone {
    folder: tempfile::TempDir,
}

impl Alone {
    fn new() -> Alone {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let bin = folder.path().join("bin");
        std::fs::create_dir(&bin).expect("a folder can be made");
        let program = Path::new(env!("CARGO_BIN_EXE_relight"));
        // A link would lead back to the checkout.
        std::fs::copy(program, bin.join("relight")).expect("the program can be copied");
        Alone { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn relight(&self, args: &[&str]) -> Output {
        let mut command = Command::new(self.path("bin/relight"));
        command.args(args).current_dir(self.folder.path()).env_clear();
        command.env("HOME", self.folder.path()).output().expect("it starts")
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
#[cfg(unix)]
fn a_home_that_cannot_be_written_is_named() {
    let alone = Alone::new();
    std::fs::write(alone.path(".local"), "a file").expect("it can be written");
    let output = alone.relight(&["check", "demo"]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{errors}");
    assert!(errors.contains("cannot be unpacked") && errors.contains("--models DIR"), "{errors}");
}
