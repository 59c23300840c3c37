//! Results on disk and on standard output.

use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use relight::graph::Fault;

/// Makes the folder for the results.
pub fn folder(path: &Path) -> Result<(), Fault> {
    std::fs::create_dir_all(path).map_err(|e| Fault::file(path, format!("the folder cannot be made: {e}")))
}

/// Writes `folder/name`, whole or not at all, with the folders in `name`; leaves a file that holds these bytes already untouched.
pub fn file(folder: &Path, name: &str, bytes: &[u8]) -> Result<PathBuf, Fault> {
    let path = folder.join(name);
    let cannot = |e: std::io::Error| Fault::file(&path, format!("cannot be written: {e}"));
    if holds(&path, bytes) {
        return Ok(path);
    }
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666)); // the umask takes away what it should
    let mut temporary = builder.prefix(".relight-").tempfile_in(folder).map_err(cannot)?;
    temporary.write_all(bytes).map_err(cannot)?;
    path.parent().map_or(Ok(()), std::fs::create_dir_all).map_err(cannot)?;
    temporary.persist(&path).map_err(|e| cannot(e.error))?;
    Ok(path)
}

/// Compared piece by piece: two pictures of one size differ early.
fn holds(path: &Path, bytes: &[u8]) -> bool {
    let Ok(mut file) = File::open(path) else { return false };
    if !file.metadata().is_ok_and(|m| m.is_file() && m.len() == bytes.len() as u64) {
        return false;
    }
    let mut old = vec![0; COMPARED];
    bytes.chunks(COMPARED).all(|piece| {
        let old = &mut old[..piece.len()];
        file.read_exact(old).is_ok() && old == piece
    })
}

const COMPARED: usize = 64 << 10;

/// Puts a result on standard output. A reader that has gone away (`| head`) is no fault.
pub fn print(text: &str) -> Result<(), Fault> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Fault::file("standard output".as_ref(), format!("cannot be written: {e}")))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_bytes_leave_a_file_untouched_and_others_replace_it_whole() {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let path = file(folder.path(), "a.txt", b"one").expect("it can be written");
        let stamp = || std::fs::metadata(&path).and_then(|m| m.modified()).expect("it is there");
        let old = std::time::SystemTime::UNIX_EPOCH;
        let open = std::fs::File::options().write(true).open(&path).expect("it can be opened");
        open.set_modified(old).expect("its time can be set");
        file(folder.path(), "a.txt", b"one").expect("it can be written");
        assert_eq!(stamp(), old);
        file(folder.path(), "a.txt", b"two").expect("it can be written");
        assert_ne!(stamp(), old);
        assert_eq!(std::fs::read(&path).expect("it is there"), b"two");
        assert_eq!(std::fs::read_dir(folder.path()).expect("it is there").count(), 1, "nothing temporary is left");
        let inner = file(folder.path(), "masks/b.txt", b"three").expect("it can be written");
        assert_eq!(std::fs::read(inner).expect("it is there"), b"three");
    }
}
