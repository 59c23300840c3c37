//! The graphs, networks and the demo scene that are part of the program, for a program without its
//! folders beside it.
//!
//! Graphs name other graphs, and scenes name pictures, by paths. So the files are unpacked, once
//! for each version of them, into the user's own data folder, and are ordinary files from then on.

use std::io::Write;
use std::path::{Path, PathBuf};

use etcetera::BaseStrategy;
use relight::graph::Diagnostic;

macro_rules! files {
    ($($path:literal),* $(,)?) => {
        [$( ($path, include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/", $path)) as &[u8]) ),*]
    };
}

/// Paths and contents.
type Files = [(&'static str, &'static [u8])];

/// Graphs, and the scene of `demo` without its truth.
const GRAPHS: &[&Files] = &[&files![
    "graphs/demo.ron",
    "graphs/depth.ron",
    "graphs/estimate.ron",
    "graphs/find_lights.ron",
    "graphs/find_lights_photo.ron",
    "graphs/indoor.ron",
    "graphs/look.ron",
    "graphs/networks.ron",
    "graphs/physics.ron",
    "graphs/planes.ron",
    "graphs/refined.ron",
    "graphs/room.ron",
    "scenes/demo/scene.ron",
    "scenes/demo/photo.jpg",
    "scenes/demo/depth.exr",
    "scenes/demo/masks/lamp_0.png",
    "scenes/demo/masks/window_0.png",
]];

#[cfg(feature = "bundled-networks")]
const NETWORKS: &[&Files] = &[
    &files!["models/NOTICE.md"],
    relight_networks_materials::FILES,
    relight_networks_lights::FILES,
    relight_networks_layers::FILES,
];
#[cfg(not(feature = "bundled-networks"))]
const NETWORKS: &[&Files] = &[];

/// The graph that a bare name such as `indoor` stands for; a path, and a name of a file in the
/// working directory, stand for themselves.
pub fn graph_path(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let is_bare = path.extension().is_none() && path.components().count() == 1 && !path.exists();
    Ok(if is_bare { graph(text).unwrap_or(path) } else { path })
}

/// The file of the graph `name`: beside the program or above it, as in a checkout, else unpacked;
/// `None` where no graph of this name ships, or it cannot be unpacked.
pub fn graph(name: &str) -> Option<PathBuf> {
    let file = format!("graphs/{name}.ron");
    let known = GRAPHS.iter().copied().flatten().any(|(path, _)| *path == file);
    let beside = || beside_the_program(&file).or_else(|| Some(unpacked(GRAPHS).ok()?.join(&file)));
    known.then(beside).flatten()
}

/// The folder of the networks: beside the program or above it, else unpacked; `models` in the
/// working directory where the program has none.
///
/// # Errors
/// They cannot be unpacked.
pub fn networks() -> Result<PathBuf, Diagnostic> {
    let folder = |file: PathBuf| file.parent().unwrap_or(Path::new("")).to_owned();
    match beside_the_program("models/mnet.onnx") {
        Some(file) => Ok(folder(file)),
        None if NETWORKS.is_empty() => Ok("models".into()),
        None => Ok(unpacked(NETWORKS)?.join("models")),
    }
}

/// The file beside the program, or in a folder above it.
fn beside_the_program(file: &str) -> Option<PathBuf> {
    let program = std::env::current_exe().and_then(|path| path.canonicalize()).ok()?;
    let above = program.ancestors().skip(1).take(4).map(|above| above.join(file));
    above.into_iter().find(|file| file.is_file())
}

/// The folder in which `files` lie, in the user's data folder. Its name holds the digest of the
/// files, so that another version of the program has another folder.
///
/// # Errors
/// The user's folders are unknown, or the files cannot be written.
fn unpacked(files: &[&Files]) -> Result<PathBuf, Diagnostic> {
    let user = etcetera::base_strategy::choose_native_strategy().map_err(|e| {
        Diagnostic::file("".as_ref(), format!("the user's own folders cannot be determined: {e}"))
    })?;
    unpacked_in(&user.data_dir().join("relight"), files)
}

fn unpacked_in(data: &Path, files: &[&Files]) -> Result<PathBuf, Diagnostic> {
    let files = || files.iter().copied().flatten();
    let mut hasher = blake3::Hasher::new();
    for (path, bytes) in files() {
        hasher.update(path.as_bytes()).update(&(bytes.len() as u64).to_le_bytes()).update(bytes);
    }
    let folder = data.join(&hasher.finalize().to_hex()[..16]);
    let length = |path: &str| folder.join(path).metadata().map(|data| data.len()).ok();
    if files().all(|(path, bytes)| length(path) == Some(bytes.len() as u64)) {
        return Ok(folder);
    }
    let write = || -> std::io::Result<()> {
        for (path, bytes) in files() {
            let file = folder.join(path);
            let parent = file.parent().unwrap_or(&folder);
            std::fs::create_dir_all(parent)?;
            // Each file is whole or not there, also when two programs unpack at once.
            let mut temporary = tempfile::NamedTempFile::new_in(parent)?;
            temporary.write_all(bytes)?;
            temporary.persist(&file).map_err(|e| e.error)?;
        }
        Ok(())
    };
    write().map_err(|e| {
        let message = format!("the files of the program cannot be unpacked here: {e}");
        Diagnostic::file(&folder, message)
            .help("keep the folders graphs and models beside the program, or name --models DIR")
    })?;
    Ok(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_graph_and_network_is_part_of_the_program() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        for (folder, ending, files) in [("graphs", "ron", GRAPHS), ("models", "onnx", NETWORKS)] {
            let listed = std::fs::read_dir(root.join(folder)).expect("the folder is there");
            for entry in listed.map(|entry| entry.expect("it can be listed").path()) {
                let name = entry.file_name().expect("it has a name").to_string_lossy().into_owned();
                let path = format!("{folder}/{name}");
                let is_shipped = files.iter().copied().flatten().any(|(file, _)| *file == path);
                let is_wanted = name.ends_with(ending) && !files.is_empty();
                assert!(is_shipped || !is_wanted, "{path} is not part of the program");
            }
        }
    }

    #[test]
    fn files_are_unpacked_once_and_mended() {
        let data = tempfile::tempdir().expect("a temporary folder");
        let folder = unpacked_in(data.path(), GRAPHS).expect("it can be written");
        let file = folder.join("graphs/indoor.ron");
        let text = std::fs::read(&file).expect("it is there");
        assert_eq!(text, std::fs::read("graphs/indoor.ron").expect("the source is there"));
        let old = std::time::SystemTime::UNIX_EPOCH;
        let stamp = std::fs::File::options().write(true).open(&file).expect("it can be opened");
        stamp.set_modified(old).expect("its time can be set");
        assert_eq!(unpacked_in(data.path(), GRAPHS).as_ref(), Ok(&folder));
        let modified = || file.metadata().and_then(|data| data.modified()).expect("it is there");
        assert_eq!(modified(), old);
        std::fs::write(&file, "cut").expect("it can be written");
        unpacked_in(data.path(), GRAPHS).expect("it can be written");
        assert_eq!(std::fs::read(&file).expect("it is there"), text);
    }
}
