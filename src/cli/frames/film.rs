//! The pictures of a sequence as a film, by ffmpeg where it is on PATH.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

pub const NAME: &str = "film.mp4";
/// Players require 4:2:0, which has no odd sizes; most assume Rec. 709 for large pictures,
/// regardless of the file's declaration.
const FILTER: &str = "crop=trunc(iw/2)*2:trunc(ih/2)*2,scale=out_color_matrix=bt709:out_range=tv,\
                      setparams=colorspace=bt709:color_primaries=bt709:color_trc=iec61966-2-1";

/// Makes `folder/film.mp4` of `picture_0000.png` and the following.
///
/// # Errors
/// The reason why the film cannot be made.
pub fn make(folder: &Path, fps: u16, frames: usize) -> Result<PathBuf, String> {
    let path = folder.join(NAME);
    // ffmpeg writes in a folder of its own, so that it never overwrites an existing file or a link.
    let scratch = tempfile::Builder::new()
        .prefix(".relight-")
        .tempdir_in(folder)
        .map_err(|e| e.to_string())?;
    let part = scratch.path().join(NAME);
    let mut command = Command::new("ffmpeg");
    command.args([
        "-nostdin",
        "-loglevel",
        "error",
        "-y",
        "-framerate",
        &fps.to_string(),
        "-start_number",
        "0",
        "-i",
    ]);
    command.arg(folder.join("picture_%04d.png"));
    command.args(["-frames:v", &frames.to_string(), "-vf", FILTER, "-pix_fmt", "yuv420p"]);
    let done = command.arg(&part).stdin(Stdio::null()).output().map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => "ffmpeg is not on PATH".to_owned(),
        _ => format!("ffmpeg cannot be started: {e}"),
    })?;
    if !done.status.success() {
        let errors = String::from_utf8_lossy(&done.stderr);
        return Err(format!(
            "ffmpeg failed: {}",
            errors.lines().last().unwrap_or("without a message")
        ));
    }
    std::fs::rename(&part, &path)
        .map_err(|e| format!("{} cannot be written: {e}", path.display()))?;
    Ok(path)
}
