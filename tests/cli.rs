//! Tests of the command: exit status, standard output and standard error, and the regression corpus
//! of bad files in tests/bad.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const SOUND_SCENE: &str = r#"Scene(
    version: 1,
    photo: "photo.png",
    camera: FovX(60),
    depth: (path: "depth.png", scale: 0.001),
    lights: { "lamp_0": Lamp(mask: "lamp.png") },
)"#;

/// A folder with a graph, a scene and an edit.
struct Room {
    folder: tempfile::TempDir,
}

impl Room {
    fn new() -> Room {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let room = Room { folder };
        std::fs::copy(bad("room.ron"), room.path("graph.ron")).expect("the graph can be copied");
        std::fs::create_dir(room.path("scene")).expect("a folder can be made");
        room.write("scene/scene.ron", SOUND_SCENE);
        room.write("edit.ron", "Edit(version: 1)");
        let photo =
            image::RgbImage::from_fn(16, 12, |x, y| image::Rgb([10 * x as u8, 10 * y as u8, 90]));
        photo.save(room.path("scene/photo.png")).expect("a picture can be written");
        let depth = image::ImageBuffer::from_fn(16, 12, |x, _| image::Luma([2000 + 10 * x as u16]));
        depth.save(room.path("scene/depth.png")).expect("a picture can be written");
        let lamp = image::GrayImage::from_fn(16, 12, |x, y| {
            image::Luma([if x < 4 && y < 4 { 255 } else { 0 }])
        });
        lamp.save(room.path("scene/lamp.png")).expect("a picture can be written");
        room
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: impl AsRef<[u8]>) {
        std::fs::write(self.path(name), text).expect("a file can be written");
    }

    /// Runs the program in this folder; the words of `line` are its arguments.
    fn relight(&self, line: &str) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
        command
            .current_dir(self.folder.path())
            .args(line.split_whitespace())
            .env_remove("RELIGHT_LOG");
        // The cache of whoever runs the tests stays as it is.
        command
            .env("HOME", self.path("home"))
            .env_remove("XDG_CACHE_HOME")
            .env_remove("XDG_CONFIG_HOME");
        command.output().expect("the program starts")
    }

    /// Exit status 2, every line of `wanted` on standard error, nothing on standard output, no
    /// panic.
    fn check_refused(&self, line: &str, wanted: &str) {
        let output = self.relight(line);
        let message = text(&output.stderr);
        let shown: String = message.lines().take(60).map(|line| format!("{line}\n")).collect();
        assert_eq!(output.status.code(), Some(2), "`relight {line}` reported:\n{shown}");
        assert!(!message.contains("panicked"), "`relight {line}` reported:\n{shown}");
        assert!(output.stdout.is_empty(), "`relight {line}` printed {}", text(&output.stdout));
        assert!(message.len() < 40_000, "`relight {line}` reported {} bytes", message.len());
        for part in wanted.lines() {
            assert!(message.contains(part), "`relight {line}`: wanted {part:?}, got:\n{shown}");
        }
    }
}

fn bad(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bad").join(name)
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("the program writes UTF-8")
}

/// Every NAME.ron of a folder of the corpus with the expected message in NAME.txt.
fn corpus(folder: &str) -> Vec<(PathBuf, String)> {
    let entries = std::fs::read_dir(bad(folder)).expect("the corpus is there");
    let mut paths: Vec<PathBuf> =
        entries.map(|entry| entry.expect("it can be listed").path()).collect();
    paths.sort();
    let (files, golden): (Vec<PathBuf>, Vec<PathBuf>) =
        paths.into_iter().partition(|path| path.extension().is_some_and(|e| e == "ron"));
    let wanted: Vec<PathBuf> = files.iter().map(|path| path.with_extension("txt")).collect();
    assert_eq!(golden, wanted, "every bad file has a .txt beside it, and there are no others");
    let read = |path: &PathBuf| std::fs::read_to_string(path).expect("it can be read");
    files.into_iter().zip(golden.iter().map(read)).collect()
}

#[test]
fn bad_scenes_are_refused() {
    let room = Room::new();
    for (path, wanted) in corpus("scenes") {
        std::fs::copy(&path, room.path("scene/scene.ron")).expect("a scene can be copied");
        room.check_refused("check graph.ron edit.ron --scene scene", &wanted);
    }
}

#[test]
fn bad_edits_are_refused() {
    let room = Room::new();
    for (path, wanted) in corpus("edits") {
        let name = path.file_name().expect("it is a file").to_string_lossy().into_owned();
        std::fs::copy(&path, room.path(&name)).expect("an edit can be copied");
        let graph = Path::new(env!("CARGO_MANIFEST_DIR")).join("graphs/physics.ron");
        room.check_refused(&format!("check {} {name} --scene scene", graph.display()), &wanted);
    }
}

/// The corpus of graphs belongs to the tests of the engine; here, that its faults reach a person.
#[test]
fn bad_graphs_are_refused() {
    let room = Room::new();
    let graph = r#"Graph(
        version: 1,
        nodes: {
            "scene": (op: ReadScnee()),
            "a": (op: Write(compresion: Zip), in: { "albedo": "b" }),
            "b": (op: Write(), in: { "albedo": "a", "depth": "scen.depth" }),
        },
        outputs: ["scene"],
    )"#;
    room.write("graph.ron", graph);
    let wanted = "graph.ron:4:27\ndid you mean `ReadScene`?\ngraph.ron:5:29\ndid you mean `compression`?\n\
        graph.ron:6:62\ndid you mean `scene`?\na -> b -> a\ngraph.ron:5:63\nwanted Albedo, got Files";
    room.check_refused("check graph.ron --scene scene", wanted);
}

#[test]
fn deep_nesting_and_huge_lines_are_refused() {
    let room = Room::new();
    let deep = "[".repeat(100_000);
    room.write("edit.ron", format!("Edit(version: 1, lights: {deep}"));
    room.check_refused("check graph.ron edit.ron --scene scene", "edit.ron:1:");
    room.write("edit.ron", format!("Edit(version: 1, lights: {deep}{})", "]".repeat(100_000)));
    room.check_refused("check graph.ron edit.ron --scene scene", "edit.ron:1:");
    room.write("edit.ron", format!("Edit(version: 1, {}: 1)", "x".repeat(1_000_000)));
    room.check_refused("check graph.ron edit.ron --scene scene", "edit.ron:1:18");
    room.write("graph.ron", format!("Graph(version: 1, nodes: {deep}"));
    room.check_refused("check graph.ron --scene scene", "graph.ron:1:");
}

/// The graphs of all frames together take some 6 GB.
#[test]
fn a_hundred_thousand_frames_are_checked_in_little_memory() {
    let room = Room::new();
    let check = |keys: &str| {
        let edit = format!(
            "Edit(version: 1, frames: 100000, lights: {{ \"lamp_0\": Scale(Keys([{keys}])) }})"
        );
        room.write("edit.ron", edit);
        let graph = Path::new(env!("CARGO_MANIFEST_DIR")).join("graphs/physics.ron");
        let line =
            format!("ulimit -v {}; exec \"$0\" check \"$1\" edit.ron --scene scene", 1 << 20);
        let mut command = Command::new("sh");
        command
            .current_dir(room.folder.path())
            .args(["-c", &line, env!("CARGO_BIN_EXE_relight")])
            .arg(graph);
        let output = command.output().expect("a shell starts");
        (output.status.code(), text(&output.stdout), text(&output.stderr))
    };
    let (status, message, errors) = check("(0, 1), (99999, 2)");
    assert_eq!(status, Some(0), "{errors}");
    assert!(message.starts_with("valid: 100000 frames, "), "{message}");
    let (status, _, errors) = check("(0, 1), (99998, 1), (99999, -1)");
    assert_eq!(status, Some(2), "{errors}");
    assert!(
        errors.contains("wanted >= 0, got -1") && errors.contains("in frame 99999"),
        "{errors}"
    );
}

#[test]
fn missing_files_and_folders_are_named() {
    let room = Room::new();
    room.check_refused("check no.ron", "no.ron");
    room.check_refused(
        "check graph.ron",
        "graph.ron: this graph reads a scene, and none is named\n--scene",
    );
    room.check_refused("check scene", "scene: cannot be read: wanted a regular file, got a folder");
    room.check_refused("check graph.ron no.ron --scene scene", "no.ron");
    room.check_refused(
        "check graph.ron scene --scene scene",
        "scene: cannot be read: wanted a regular file, got a folder",
    );
    room.check_refused("check graph.ron edit.ron --scene nowhere", "nowhere/scene.ron");
    room.check_refused(
        "check graph.ron edit.ron --scene scene/scene.ron",
        "wanted a scene folder, got a file",
    );
}

#[test]
fn faults_of_all_files_come_at_once() {
    let room = Room::new();
    room.write("graph.ron", "Graph(version: 1, nodse: {})");
    room.write("scene/scene.ron", "Scene(version: 1, foto: 3)");
    room.write("edit.ron", "Edit(version: 1, ligths: {})");
    let wanted = "graph.ron:1:19\nscene.ron:1:19\nedit.ron:1:18\n--set: wanted NODE.PARAM=VALUE, got `no_dot=1`";
    room.check_refused("check graph.ron edit.ron --scene scene --set no_dot=1", wanted);
    room.write("scene/scene.ron", SOUND_SCENE);
    room.write(
        "graph.ron",
        r#"Graph(version: 1, nodes: { "scene": (op: ReadScnee()) }, outputs: [])"#,
    );
    room.check_refused("check graph.ron edit.ron --scene scene", "graph.ron:1:42\nedit.ron:1:18");
}

#[test]
fn bad_arguments_are_refused() {
    let room = Room::new();
    room.check_refused("", "Usage");
    room.check_refused("rnu graph.ron edit.ron", "unrecognized subcommand 'rnu'");
    room.check_refused("run", "<GRAPH>");
    room.check_refused("run graph.ron edit.ron --threads 0", "--threads");
    room.check_refused("run graph.ron edit.ron --threads many", "--threads");
    room.check_refused("run graph.ron edit.ron --no-cache --cache there", "--no-cache");
    room.check_refused(
        "check graph.ron --scene scene --set scene",
        "wanted NODE.PARAM=VALUE, got `scene`",
    );
    room.check_refused(
        "check graph.ron --scene scene --set scene.long_side=NaN",
        "--set scene.long_side",
    );
    room.check_refused("graph graph.ron --format bmp", "mermaid");
    room.check_refused("nodes ReadScnee", "did you mean `ReadScene`?");
}

#[test]
fn help_and_version_are_results() {
    let room = Room::new();
    for line in ["--help", "run --help", "cache --help", "--version", "nodes", "nodes ReadScene"] {
        let output = room.relight(line);
        assert_eq!(output.status.code(), Some(0), "{line}");
        assert!(!output.stdout.is_empty() && output.stderr.is_empty(), "{line}");
    }
}

/// docs/nodes.md is made from the code.
#[test]
fn the_node_reference_is_up_to_date() {
    let output = Room::new().relight("nodes --markdown");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/nodes.md");
    let page = std::fs::read_to_string(path).unwrap_or_default();
    assert!(page == text(&output.stdout), "run: relight nodes --markdown > docs/nodes.md");
}

/// docs/tuning.md is made from the code; tests/architecture.rs checks that every table is in it.
#[test]
fn the_tuning_reference_is_up_to_date() {
    let output = Room::new().relight("nodes --tuning");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/tuning.md");
    let page = std::fs::read_to_string(path).unwrap_or_default();
    assert!(page == text(&output.stdout), "run: relight nodes --tuning > docs/tuning.md");
}

/// Runs the command and checks the exit status; returns standard output and standard error.
fn check_runs(room: &Room, line: &str, status: i32) -> (String, String) {
    let output = room.relight(line);
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(
        output.status.code(),
        Some(status),
        "`relight {line}` printed:\n{out}and reported:\n{err}"
    );
    assert!(!err.contains("panicked"), "`relight {line}` reported:\n{err}");
    (out, err)
}

fn report(room: &Room) -> serde_json::Value {
    let text =
        std::fs::read_to_string(room.path("out/report.json")).expect("the run wrote a report");
    serde_json::from_str(&text).expect("the report is JSON")
}

fn fields(value: &serde_json::Value) -> Vec<&str> {
    value.as_object().expect("it is an object").keys().map(String::as_str).collect()
}

const RUN: &str = "run graph.ron edit.ron --scene scene";

#[test]
fn a_run_tells_what_it_did() {
    let room = Room::new();
    let (out, err) = check_runs(&room, RUN, 0);
    assert_eq!(out, "out/report.json\n", "paths are the result");
    assert!(err.starts_with("1 ran in") && err.lines().count() == 1, "{err}");

    let first = report(&room);
    let wanted = [
        "backend",
        "edit",
        "graph",
        "nodes",
        "peak_bytes",
        "relight",
        "seconds",
        "threads",
        "warnings",
    ];
    assert_eq!(fields(&first), wanted);
    let wanted = [
        "bytes", "from", "key", "kind", "name", "notes", "rays", "samples", "seconds", "status",
        "stderr", "why",
    ];
    assert_eq!(fields(&first["nodes"][0]), wanted);
    assert_eq!(first["nodes"][0]["status"], "ran");

    let (out, err) = check_runs(&room, &format!("{RUN} --json"), 0);
    let again: serde_json::Value =
        serde_json::from_str(&out).expect("standard output is the report");
    assert_eq!(again["nodes"][0]["status"], "hit");
    assert_eq!(again["nodes"][0]["key"], first["nodes"][0]["key"]);
    assert!(err.starts_with("1 hit in"), "{err}");

    let (_, err) = check_runs(&room, &format!("{RUN} --no-cache -v"), 0);
    assert!(err.starts_with("ran       scene ("), "-v gives a line per node: {err}");
    assert!(err.contains("\nscene  ran "), "-v gives a row per node: {err}");
    let (out, err) = check_runs(&room, &format!("{RUN} --quiet"), 0);
    assert_eq!((out.as_str(), err.as_str()), ("out/report.json\n", ""));
    room.check_refused(&format!("{RUN} --quiet -v"), "cannot be used with");
}

#[test]
fn a_run_without_an_edit_changes_nothing() {
    let room = Room::new();
    check_runs(&room, "run graph.ron --scene scene", 0);
    assert!(report(&room)["edit"].is_null());
    room.check_refused("run graph.ron --scene scene --frame 0", "wanted an edit with `frames`");
}

#[test]
fn a_failed_run_leaves_the_files_of_the_last_one() {
    let room = Room::new();
    check_runs(&room, RUN, 0);
    let before = std::fs::read(room.path("out/report.json")).expect("it is there");
    room.write("scene/photo.png", "this is no picture");
    let (out, err) = check_runs(&room, RUN, 2);
    assert!(out.is_empty() && err.contains("are of an earlier run"), "{out}{err}");
    assert_eq!(std::fs::read(room.path("out/report.json")).expect("it is there"), before);
    let (out, err) = check_runs(&room, &format!("{RUN} --quiet --json"), 2);
    assert!(out.contains("\"failed\"") && err.starts_with("error: scene: "), "{out}{err}");
}

#[test]
fn a_setting_wins_and_is_explained() {
    let room = Room::new();
    check_runs(&room, RUN, 0);
    let (out, _) = check_runs(&room, "plan graph.ron edit.ron --scene scene", 0);
    assert!(out.starts_with("hit      scene"), "{out}");
    let (out, _) = check_runs(&room, "plan graph.ron --scene scene --set scene.long_side=8", 0);
    assert!(out.starts_with("run      scene"), "{out}");
    let (out, _) = check_runs(
        &room,
        "explain graph.ron edit.ron scene --scene scene --set scene.long_side=8",
        0,
    );
    assert!(out.contains("long_side") && out.contains("320") && out.contains('8'), "{out}");
    room.check_refused("explain graph.ron edit.ron scnee --scene scene", "scene");
    room.check_refused(&format!("{RUN} --only scnee"), "scene");
    // A target for stages that this graph does not have is not a fault.
    check_runs(&room, "plan graph.ron --scene scene --target-error 1%", 0);
    room.check_refused(&format!("{RUN} --target-error 150%"), "wanted a share above 0 and below 1");
    room.check_refused(&format!("{RUN} --budget 3"), "wanted a number and a unit");
    room.check_refused(
        &format!("{RUN} --set scene.long_syde=8"),
        "--set scene.long_syde:1:1\nlong_side",
    );
    room.check_refused(
        &format!("{RUN} --set scnee.long_side=8"),
        "--set scnee.long_side:1:1\nscene",
    );
    room.check_refused(
        &format!("{RUN} --set scene.long_side=0"),
        "--set scene.long_side:1:1\nwanted >= 1, got 0",
    );
}

#[test]
fn files_that_a_stage_cannot_use_are_bad_files() {
    let room = Room::new();
    room.write("scene/photo.png", "this is no picture");
    let (_, err) = check_runs(&room, RUN, 2);
    assert!(err.contains("error: scene: ") && err.contains("photo.png"), "{err}");
    assert!(!room.path("out/report.json").exists());
    std::fs::remove_file(room.path("scene/lamp.png")).expect("it is there");
    room.check_refused(RUN, "scene.ron:6:\nlamp.png");
}

#[test]
fn an_out_that_is_no_folder_is_refused_before_any_work() {
    let room = Room::new();
    room.check_refused(&format!("{RUN} --out edit.ron"), "edit.ron: the folder cannot be made");
    assert!(!room.path("home/.cache").exists());
}

#[test]
fn a_graph_is_printed_in_each_format() {
    let room = Room::new();
    let print = |format: &str| {
        check_runs(&room, &format!("graph graph.ron --scene scene --format {format}"), 0).0
    };
    assert!(print("dot").starts_with("digraph"));
    assert!(print("mermaid").starts_with("flowchart") || print("mermaid").starts_with("graph"));
    assert!(print("svg").starts_with("<svg"));
    let graph: serde_json::Value = serde_json::from_str(&print("json")).expect("it is JSON");
    assert_eq!(graph["nodes"][0]["name"], "scene");
}

#[test]
fn the_cache_is_looked_after() {
    let room = Room::new();
    check_runs(&room, RUN, 0);
    #[cfg(target_os = "linux")]
    {
        assert!(
            room.path("home/.cache/relight/CACHEDIR.TAG").is_file(),
            "in the user's own cache folder by default"
        );
        let key =
            std::fs::metadata(room.path("home/.config/relight/cache.key")).expect("a key was made");
        let mode = std::os::unix::fs::PermissionsExt::mode(&key.permissions());
        assert_eq!(mode & 0o777, 0o600);
    }
    let (out, _) = check_runs(&room, "cache stat", 0);
    assert!(!out.starts_with("0 entries") && out.contains("runs keep to 10 GiB"), "{out}");
    check_runs(&room, "cache verify", 0);
    check_runs(&room, &format!("{RUN} --verify"), 0);
    check_runs(&room, "cache gc --bytes 0", 0);
    let (_, err) = check_runs(&room, RUN, 0);
    assert!(err.contains("1 ran"), "{err}");
    check_runs(&room, "cache clear", 0);
    let (out, _) = check_runs(&room, "cache stat", 0);
    assert!(out.starts_with("0 entries"), "{out}");
}

#[test]
fn bench_measures_and_draws() {
    let room = Room::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let graph = root.join("tests/scenes/small.ron");
    let line = format!("bench {} --quick --side 40 --out b --json", graph.display());
    let (json, _) = check_runs(&room, &line, 0);
    let json: serde_json::Value = serde_json::from_str(&json).expect("it is JSON");
    let points = json["points"].as_array().expect("there are points");
    for plot in ["strategies", "bandwidths", "shadows", "pipeline", "noise"] {
        let of_plot: Vec<_> = points.iter().filter(|p| p["plot"] == plot).collect();
        assert!(!of_plot.is_empty(), "{plot}");
        assert!(
            of_plot.iter().all(|p| p["seconds"].as_f64() > Some(0.0)),
            "{plot}: everything takes time"
        );
        let svg =
            std::fs::read_to_string(room.path(&format!("b/{plot}.svg"))).expect("it is written");
        assert!(
            svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>") && !svg.contains("NaN"),
            "{plot}"
        );
    }
    let error = |series: &str, samples: u64| {
        let found = points.iter().find(|p| {
            p["subject"] == "window_0, sky" && p["series"] == series && p["samples"] == samples
        });
        found
            .and_then(|p| p["error"].as_f64())
            .unwrap_or_else(|| panic!("{series} at {samples} was measured"))
    };
    // Four times the samples: half the error at least, with room for the scatter of a small
    // picture.
    assert!(error("area only", 16) < 0.7 * error("area only", 4));
    assert!(
        error("ours", 16) < 1.05 * error("lobe only", 16),
        "a broad lobe through a window is sampled by area"
    );
    let csv = std::fs::read_to_string(room.path("b/bench.csv")).expect("it is written");
    assert_eq!(csv.lines().count(), 1 + points.len());
}

#[test]
fn bench_refuses_what_it_cannot_measure() {
    let room = Room::new();
    room.check_refused(
        "bench graph.ron --scene scene",
        "graph.ron: wanted a graph with a stage Direct of each light, got none",
    );
    room.check_refused("bench no.ron", "no.ron");
    room.check_refused("bench graph.ron --samples 0", "--samples");
    room.check_refused("bench graph.ron --samples", "--samples");
}

#[test]
fn completions_and_manual_pages_have_all_commands_but_hidden_ones() {
    let room = Room::new();
    let text = |line: &str| {
        let output = room.relight(line);
        assert_eq!(output.status.code(), Some(0), "{line}");
        String::from_utf8(output.stdout).expect("it is text")
    };
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = text(&format!("completions {shell}"));
        for word in ["new", "run", "onnxruntime", "completions"] {
            assert!(script.contains(word), "{shell}: {word}");
        }
        assert!(!script.contains("run-network"), "{shell}");
    }
    if let Ok(bash) = Command::new("bash").arg("-n").arg(room.path("script")).output() {
        assert!(!bash.status.success(), "bash refuses a missing script");
        room.write("script", text("completions bash"));
        let bash = Command::new("bash").arg("-n").arg(room.path("script")).output();
        let bash = bash.expect("it starts again");
        assert!(bash.status.success(), "{}", String::from_utf8_lossy(&bash.stderr));
    }
    let page = text("man");
    assert!(page.contains(".TH relight 1") && page.contains("RELIGHT_LOG"), "{page}");
    assert_eq!(text("man --out pages").trim(), "pages");
    let run = std::fs::read_to_string(room.path("pages/relight-run.1")).expect("it is written");
    assert!(run.contains("preview.png"), "{run}");
    assert!(!room.path("pages/relight-run-network.1").exists());
    room.check_refused("completions tcsh", "tcsh");
    room.check_refused("man --out graph.ron", "graph.ron: the pages cannot be written");
}
