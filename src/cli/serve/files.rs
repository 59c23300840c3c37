//! Files that a page reads and writes beside the edit: snapshots, and masks of the scene.

use std::path::{Path, PathBuf};

use axum::http::StatusCode;
use relight::graph::read;
use relight::image::{NamedBytes, read_mask};
use relight::nodes::artifacts::check_file_name;

use super::edit::MOST_TEXT;
use super::state::Live;
use crate::cli::write::Output;

/// The folder of snapshots in the folder of results.
const SNAPSHOTS: &str = "snapshots";
/// Most snapshots that are listed.
const MOST_LISTED: usize = 10_000;
/// Most bytes of a mask.
pub const MOST_MASK: usize = 64 << 20;
/// The bytes that a PNG begins with.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";

/// A status and the reason for it.
pub type Refusal = (StatusCode, String);

/// The names of all snapshots, sorted.
pub fn snapshots(out: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(out.join(SNAPSHOTS)).into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| {
        let name = entry.file_name().into_string().ok()?;
        let name = name.strip_suffix(".ron")?.to_owned();
        snapshot(out, &name).is_ok().then_some(name)
    });
    let mut names: Vec<String> = names.take(MOST_LISTED).collect();
    names.sort();
    names
}

/// The text of a snapshot.
///
/// # Errors
/// The name is not plain, or the snapshot does not exist.
pub fn read_snapshot(out: &Path, name: &str) -> Result<Vec<u8>, Refusal> {
    let path = snapshot(out, name)?;
    read(&path, MOST_TEXT as u64).map_err(|e| (StatusCode::NOT_FOUND, format!("{name}: {e}")))
}

/// Writes a snapshot.
///
/// # Errors
/// The name is not plain, or the file cannot be written.
pub fn write_snapshot(out: &Path, name: &str, text: &str) -> Result<(), Refusal> {
    let path = snapshot(out, name)?;
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    let folder = Output::new(&out.join(SNAPSHOTS), [], false);
    folder.and_then(|folder| folder.file(&file, text.as_bytes())).map(drop).map_err(failed)
}

/// Removes a snapshot.
///
/// # Errors
/// The name is not plain, or the snapshot does not exist.
pub fn remove_snapshot(out: &Path, name: &str) -> Result<(), Refusal> {
    let path = snapshot(out, name)?;
    std::fs::remove_file(&path).map_err(|e| (StatusCode::NOT_FOUND, format!("{name}: {e}")))
}

/// The file of a snapshot: a plain name in a real folder.
fn snapshot(out: &Path, name: &str) -> Result<PathBuf, Refusal> {
    let refused = |message: String| Err((StatusCode::BAD_REQUEST, message));
    let file = format!("{name}.ron");
    if name.trim() != name || name.is_empty() || name.starts_with('.') || name.contains('/') {
        return refused(format!("wanted the plain name of a snapshot, got {name:?}"));
    }
    if let Err(message) = check_file_name(&file) {
        return refused(message);
    }
    let folder = out.join(SNAPSHOTS);
    if folder.is_symlink() {
        return refused(
            "the folder of snapshots is a symbolic link, which may lead anywhere".into(),
        );
    }
    Ok(folder.join(file))
}

/// The file of the mask of a light, or of `sunlight`. It lies in the scene's folder, as a scene may
/// come from a stranger and this file is written to.
fn mask(live: &Live, light: &str) -> Result<PathBuf, Refusal> {
    let scene = live.state().scene.clone();
    let path = scene.masks().find(|(id, _)| *id == light).map(|(_, path)| path.to_owned());
    let path =
        path.ok_or((StatusCode::NOT_FOUND, format!("`{light}` has no mask in this scene")))?;
    let folder = live.job.files.scene.as_deref().unwrap_or("".as_ref());
    let real = path.canonicalize().ok().zip(folder.canonicalize().ok());
    match real {
        Some((path, folder)) if path.starts_with(&folder) && path.is_file() => Ok(path),
        _ => {
            let message = format!("the mask of `{light}` is not a file in the folder of the scene");
            Err((StatusCode::FORBIDDEN, message))
        }
    }
}

/// The bytes of a light's mask.
///
/// # Errors
/// The light has none, or it cannot be read.
pub fn read_light_mask(live: &Live, light: &str) -> Result<Vec<u8>, Refusal> {
    let path = mask(live, light)?;
    read(&path, MOST_MASK as u64).map_err(|e| (StatusCode::NOT_FOUND, format!("{light}: {e}")))
}

/// Replaces a light's mask; the first one stays beside it as `NAME.before.png`. The watcher then
/// sees the change and asks for a run.
///
/// # Errors
/// The light has no mask in the scene's folder, or the picture is not a PNG of the photo's size.
pub fn write_light_mask(live: &Live, light: &str, bytes: &[u8]) -> Result<(), Refusal> {
    let path = mask(live, light)?;
    let refused = |message: String| Err((StatusCode::UNPROCESSABLE_ENTITY, message));
    if path.extension().is_none_or(|ending| !ending.eq_ignore_ascii_case("png")) {
        return refused(format!("the mask of `{light}` is not a PNG, so that no PNG replaces it"));
    }
    if !bytes.starts_with(PNG) {
        return refused("wanted a PNG, got another format".into());
    }
    let mask = match read_mask(NamedBytes::new("the mask", bytes)) {
        Ok(mask) => mask,
        Err(e) => return refused(e.message()),
    };
    let ((width, height), (w, h)) = (live.state().scene.full, mask.0.size());
    if (width, height) != (w, h) {
        return refused(format!("wanted a mask of {width} x {height} pixels, got {w} x {h}"));
    }
    let folder = path.parent().unwrap_or("".as_ref());
    let [old, new] = [path.with_extension("before.png"), path.clone()]
        .map(|path| path.file_name().unwrap_or_default().to_string_lossy().into_owned());
    let before =
        read(&path, MOST_MASK as u64).map_err(|e| (StatusCode::CONFLICT, e.to_string()))?;
    let out = Output::new(folder, [], false).map_err(failed)?;
    if !folder.join(&old).exists() {
        out.file(&old, &before).map_err(failed)?;
    }
    out.file(&new, bytes).map(drop).map_err(failed)
}

fn failed(fault: relight::graph::Diagnostic) -> Refusal {
    (StatusCode::INTERNAL_SERVER_ERROR, fault.to_string())
}
