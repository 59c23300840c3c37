//! The project's own graphs, edits and demo scene, run in this process or as the command.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Arc, OnceLock};

use relight::files;
use relight::graph::{
    Artifact, CacheFolder, CacheKey, Cancel, Diagnostic, Engine, EngineOptions, PortValue,
    ResolvedGraph, RunReport, Status,
};
use relight::image::{Layer, NamedBytes, Picture, Plane, Transfer, read_photo};
use relight::nodes::{self, artifacts::Files};

pub const IDENTITY: &str = "Edit(version: 1)";

pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The room of scenes/demo at a quarter of its size, with less in it: 320 x 240 pixels, which the
/// sum of its lights gives exactly.
pub fn demo() -> PathBuf {
    root().join("tests/scenes/small")
}

/// A folder with the edits of the project, whose pixels are those of the small room's photo.
pub fn edits() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("small_edits");
        std::fs::create_dir_all(&folder).expect("a folder can be made");
        for path in ron_files("edits") {
            let name = path.file_name().expect("a file has a name");
            std::fs::write(folder.join(name), shipped(stem(&path))).expect("a file can be written");
        }
        folder
    })
}

/// The text of an edit of the project, whose pixels are those of the small room's photo.
pub fn shipped(name: &str) -> String {
    let path = root().join("edits").join(name).with_extension("ron");
    let mut text = std::fs::read_to_string(path).expect("the edit ships");
    for (marker, numbers) in [("Pixel(", 2), ("Grow(", 2), ("corners: [", 8)] {
        text = quartered(&text, marker, numbers);
    }
    text.replace("../scenes/demo/", &format!("{}/", root().join("scenes/demo").display()))
}

/// The text with the first numbers after each `marker` divided by four.
fn quartered(text: &str, marker: &str, numbers: usize) -> String {
    let mut parts = text.split(marker);
    let mut out = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        out += marker;
        let mut rest = part;
        for _ in 0..numbers {
            let start = rest.find(|c: char| c.is_ascii_digit()).expect("the marker has numbers");
            let len = rest[start..]
                .find(|c: char| !c.is_ascii_digit() && c != '.')
                .unwrap_or(rest.len() - start);
            let number: f64 = rest[start..start + len].parse().expect("it is a number");
            out += &format!("{}{}", &rest[..start], number / 4.0);
            rest = &rest[start + len..];
        }
        out += rest;
    }
    out
}

/// The RON files of a folder of the project, in the order of their names.
pub fn ron_files(folder: impl AsRef<Path>) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(root().join(folder)).expect("the project has this folder");
    let paths = entries.map(|entry| entry.expect("it can be listed").path());
    let mut paths: Vec<PathBuf> =
        paths.filter(|path| path.extension().is_some_and(|e| e == "ron")).collect();
    paths.sort();
    paths
}

pub fn stem(path: &Path) -> &str {
    path.file_stem().and_then(|stem| stem.to_str()).expect("the project has plain names")
}

/// ResolvedGraph, scene and edit put together, as the command does it.
pub fn load(graph: &Path, scene: &Path, edit: &Path) -> Result<ResolvedGraph, Vec<Diagnostic>> {
    load_frame(graph, scene, edit, 0)
}

fn load_frame(
    graph: &Path,
    scene: &Path,
    edit: &Path,
    frame: u32,
) -> Result<ResolvedGraph, Vec<Diagnostic>> {
    let registry = nodes::registry().with_library(root().join("models"), "");
    files::load_frame(graph, scene, edit, frame, &registry)
}

/// A graph of the project with a scene and the text of an edit.
pub fn with(graph: &str, scene: &Path, edit: &str) -> ResolvedGraph {
    with_frame(graph, scene, edit, 0)
}

/// The same for one frame of the edit.
fn with_frame(graph: &str, scene: &Path, edit: &str, frame: u32) -> ResolvedGraph {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("edit.ron");
    std::fs::write(&path, edit).expect("it can be written to");
    let graph = load_frame(&root().join("graphs").join(graph), scene, &path, frame);
    graph.unwrap_or_else(|faults| panic!("{edit}: {}", faults[0]))
}

/// graphs/physics.ron with a scene and the text of an edit.
pub fn physics(scene: &Path, edit: &str) -> ResolvedGraph {
    with("physics.ron", scene, edit)
}

/// The same for one frame of the edit.
pub fn physics_frame(scene: &Path, edit: &str, frame: u32) -> ResolvedGraph {
    with_frame("physics.ron", scene, edit, frame)
}

pub fn engine(cache: Option<&Path>) -> Engine {
    let cache = cache.map(|folder| CacheFolder::new(folder, CacheKey::new(b"own")));
    let options = EngineOptions { cache, ..EngineOptions::default() };
    Engine::new(options).expect("threads can be started")
}

/// One engine for all tests that only look at results, so that the demo's lights are estimated
/// once.
pub fn shared_engine() -> &'static Engine {
    static ENGINE: OnceLock<Engine> = OnceLock::new();
    ENGINE.get_or_init(|| engine(None))
}

/// Runs a graph to its outputs, or to these.
pub fn run(engine: &Engine, graph: &ResolvedGraph, outputs: &[&str]) -> RunReport {
    let names: Vec<String> = outputs.iter().map(|name| name.to_string()).collect();
    let wanted = graph
        .wanted((!names.is_empty()).then_some(&names[..]))
        .expect("the graph has these outputs");
    let report = engine.run(graph, &wanted, &Cancel::default(), &());
    let error = report
        .nodes
        .iter()
        .find_map(|node| Some(format!("{}: {}", node.name, node.error.as_ref()?)));
    assert!(report.is_complete(), "{error:?}");
    report
}

/// The one value of an output.
pub fn one<T: Artifact>(report: &RunReport, name: &str) -> Arc<T> {
    match report.output(name) {
        Some(PortValue::One(value)) => value.get().expect("the output has this type"),
        _ => panic!("{name} gives one value"),
    }
}

/// The values of an output, by member.
pub fn many<T: Artifact>(report: &RunReport, name: &str) -> Vec<(String, Arc<T>)> {
    let Some(PortValue::Many(values)) = report.output(name) else {
        panic!("{name} gives a value per member")
    };
    values
        .iter()
        .map(|(id, value)| (id.clone(), value.get().expect("the output has this type")))
        .collect()
}

/// The layers of the lights, in single precision.
pub fn layers(report: &RunReport) -> Vec<(String, Arc<Picture>)> {
    many::<Layer>(report, "compose.layer")
        .into_iter()
        .map(|(id, layer)| (id, Arc::new(layer.picture())))
        .collect()
}

/// The residual layer.
pub fn rest(report: &RunReport) -> Arc<Picture> {
    Arc::new(one::<Layer>(report, "compose.residual").picture())
}

pub fn ran(report: &RunReport) -> Vec<&str> {
    report.with_status(Status::Ran)
}

pub fn rays(report: &RunReport) -> u64 {
    report.nodes.iter().map(|node| node.rays).sum()
}

/// The bytes of a written file.
pub fn written(report: &RunReport, name: &str) -> Vec<u8> {
    let files: Arc<Files> = one(report, "write.files");
    files.0.iter().find(|(n, _)| n == name).expect("it was written").1.clone()
}

/// A PNG of 8 bits as rows of stored numbers.
pub fn png(bytes: &[u8]) -> image::RgbImage {
    image::load_from_memory(bytes).expect("it is a PNG").to_rgb8()
}

pub fn photo() -> image::RgbImage {
    png(&std::fs::read(demo().join("photo.png")).expect("the demo has a photo"))
}

/// A linear picture from an EXR file.
pub fn exr(path: &Path) -> Plane<glam::Vec3> {
    let bytes = std::fs::read(path).expect("the truth is there");
    let name = path.display().to_string();
    let Picture(plane) =
        read_photo(NamedBytes::new(&name, &bytes), Transfer::Linear).expect("it is sound").picture;
    plane
}

/// A run of the command with its own output folder and cache.
pub struct Place {
    pub folder: tempfile::TempDir,
}

impl Place {
    pub fn new() -> Place {
        Place { folder: tempfile::tempdir().expect("a temporary folder can be made") }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        std::fs::write(self.path(name), bytes).expect("a file can be written");
    }

    /// The command with the words of `line` as arguments, in this folder; `GRAPHS` and `EDITS`
    /// stand for the project's, `DEMO` and `DEMO.ron` for the small room and the graph that names
    /// it.
    pub fn command(&self, line: &str) -> Command {
        let known = [
            ("GRAPHS", root().join("graphs")),
            ("EDITS", edits().to_owned()),
            ("DEMO.ron", root().join("tests/scenes/small.ron")),
            ("DEMO", demo()),
        ];
        let words = line.split_whitespace().map(|word| {
            let stands = |word: String, (name, path): &(&str, PathBuf)| {
                word.replace(name, &path.display().to_string())
            };
            known.iter().fold(word.to_owned(), stands)
        });
        let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
        command.current_dir(self.folder.path()).args(words).env_remove("RELIGHT_LOG");
        // The cache of whoever runs the tests stays as it is.
        command
            .env("HOME", self.path("home"))
            .env_remove("XDG_CACHE_HOME")
            .env_remove("XDG_CONFIG_HOME");
        command
    }

    /// Runs to the end and checks this exit status; returns standard error.
    pub fn check(&self, line: &str, status: i32) -> String {
        let output = self.command(line).output().expect("the program starts");
        check_output(line, &output, status)
    }

    /// The written pictures.
    pub fn pictures(&self, out: &str) -> [Vec<u8>; 2] {
        ["picture.png", "picture.exr"].map(|name| {
            std::fs::read(self.path(out).join(name)).expect("the run wrote its pictures")
        })
    }
}

pub fn check_output(line: &str, output: &Output, status: i32) -> String {
    let message = String::from_utf8(output.stderr.clone()).expect("the program writes UTF-8");
    assert_eq!(output.status.code(), Some(status), "`relight {line}` reported:\n{message}");
    assert!(!message.contains("panicked"), "`relight {line}` reported:\n{message}");
    message
}
