//! One server per folder of results.

use std::fs::{File, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};

use relight::graph::Diagnostic;

/// The lock on a folder of results; the system lets go of it when the program ends, however it
/// ends.
pub struct Lock(File);

impl Lock {
    /// Takes the lock.
    ///
    /// # Errors
    /// Another server has it, or the file cannot be made.
    pub fn take(folder: &Path) -> Result<Lock, Diagnostic> {
        let path = folder.join("serve.lock");
        let cannot = |e: std::io::Error| Diagnostic::file(&path, format!("cannot be used: {e}"));
        if path.is_symlink() {
            let message = "wanted a regular file, got a symbolic link, which may lead anywhere";
            return Err(Diagnostic::file(&path, message).help("remove it"));
        }
        let mut options = File::options();
        let mut file = options
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(cannot)?;
        match file.try_lock() {
            Ok(()) => Ok(Lock(file)),
            Err(TryLockError::WouldBlock) => {
                let mut place = String::new();
                let _ = (&mut file).take(100).read_to_string(&mut place);
                Err(taken(folder, place.trim()))
            }
            Err(TryLockError::Error(e)) => Err(cannot(e)),
        }
    }

    /// Notes the address of this server, for the message of a second one.
    pub fn note(&self, port: u16) {
        let mut file = &self.0;
        let noted = file
            .set_len(0)
            .and_then(|()| file.rewind())
            .and_then(|()| writeln!(file, "http://127.0.0.1:{port}/"));
        // The note is a convenience; without it, the lock holds as well.
        let _ = noted;
    }
}

fn taken(folder: &Path, place: &str) -> Diagnostic {
    let at = if place.is_empty() { String::new() } else { format!(" at {place}") };
    let folder: PathBuf = folder.to_owned();
    Diagnostic::file(&folder, format!("another `relight serve` uses this folder{at}"))
        .help("end it with Ctrl-C, or name another folder with --out")
}
