//! Results on disk and on standard output.

use std::io::Write;
use std::path::{Path, PathBuf};

use relight::graph::Fault;

/// Writes `folder/name`, whole or not at all; leaves a file that holds these bytes already untouched.
pub fn file(folder: &Path, name: &str, bytes: &[u8]) -> Result<PathBuf, Fault> {
    let path = folder.join(name);
    let cannot = |e: std::io::Error| Fault::file(&path, format!("cannot be written: {e}"));
    if holds(&path, bytes) {
        return Ok(path);
    }
    std::fs::create_dir_all(folder).map_err(cannot)?;
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666)); // the umask takes away what it should
    let mut temporary = builder.prefix(".relight-").tempfile_in(folder).map_err(cannot)?;
    temporary.write_all(bytes).map_err(cannot)?;
    temporary.persist(&path).map_err(|e| cannot(e.error))?;
    Ok(path)
}

fn holds(path: &Path, bytes: &[u8]) -> bool {
    let same_length = std::fs::metadata(path).is_ok_and(|m| m.is_file() && m.len() == bytes.len() as u64);
    same_length && std::fs::read(path).is_ok_and(|old| old == bytes)
}

/// Puts a result on standard output. A reader that has gone away (`| head`) is no fault.
pub fn print(text: &str) {
    let mut out = std::io::stdout().lock();
    if let Err(e) = out.write_all(text.as_bytes()).and_then(|()| out.flush())
        && e.kind() != std::io::ErrorKind::BrokenPipe
    {
        eprintln!("error: standard output: {e}");
    }
}
