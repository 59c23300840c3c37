//! Results on disk and on standard output.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use relight::graph::{Diagnostic, ResolvedGraph, escape, escape_line, plain_error};
use relight::nodes::artifacts::check_file_name;

/// A folder for results, and the files that results must not replace.
pub struct Output {
    folder: PathBuf,
    /// Files that the run reads, each under the names that lead to it.
    inputs: BTreeSet<PathBuf>,
}

impl Output {
    /// Makes the folder. Files of `inputs` are not replaced, unless `force` is set.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub fn new(
        folder: &Path,
        inputs: impl IntoIterator<Item = PathBuf>,
        force: bool,
    ) -> Result<Output, Diagnostic> {
        std::fs::create_dir_all(folder).map_err(|e| {
            Diagnostic::file(folder, format!("the folder cannot be made: {}", plain_error(e)))
        })?;
        let inputs = if force {
            BTreeSet::new()
        } else {
            inputs.into_iter().flat_map(|path| names(&path)).collect()
        };
        Ok(Output { folder: folder.to_owned(), inputs })
    }

    /// Makes a folder for the results of a graph; they replace none of its input files.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub fn of_graph(
        folder: &Path,
        graph: &ResolvedGraph,
        edit: Option<&Path>,
        force: bool,
    ) -> Result<Output, Diagnostic> {
        Output::new(folder, graph.inputs().into_iter().chain(edit.map(Path::to_owned)), force)
    }

    /// Writes files, each whole or not at all, with the sub-folders in their names. A file with the
    /// same bytes stays untouched; where one name is refused, no file is written.
    ///
    /// # Errors
    /// A name that is not valid for a result, or of a file that the run reads; errors of the
    /// system.
    pub fn write(
        &self,
        files: &[(impl AsRef<str>, impl AsRef<[u8]>)],
    ) -> Result<Vec<PathBuf>, Diagnostic> {
        let one = |bytes| [Cow::Borrowed(bytes)];
        let files: Vec<_> =
            files.iter().map(|(name, bytes)| (name.as_ref(), one(bytes.as_ref()))).collect();
        self.write_pieces(&files)
    }

    /// [`Output::write`] of files that are given in pieces.
    ///
    /// # Errors
    /// Those of [`Output::write`].
    pub fn write_pieces<'a>(
        &self,
        files: &[(impl AsRef<str>, impl AsRef<[Cow<'a, [u8]>]>)],
    ) -> Result<Vec<PathBuf>, Diagnostic> {
        for (name, pieces) in files {
            self.check(name.as_ref(), pieces.as_ref())?;
        }
        files.iter().map(|(name, pieces)| self.replace(name.as_ref(), pieces.as_ref())).collect()
    }

    /// [`Output::write`] of one file.
    ///
    /// # Errors
    /// Those of [`Output::write`].
    pub fn file(&self, name: &str, bytes: &[u8]) -> Result<PathBuf, Diagnostic> {
        Ok(self.write(&[(name, bytes)])?.remove(0))
    }

    fn check(&self, name: &str, pieces: &[Cow<[u8]>]) -> Result<(), Diagnostic> {
        let path = self.folder.join(name);
        check_file_name(name).map_err(|message| {
            let help = "a damaged or foreign cache may be the cause: --no-cache works without it";
            Diagnostic::file(
                &self.folder,
                format!("a file of the results cannot be written: {message}"),
            )
            .help(help)
        })?;
        let parent = path.parent().unwrap_or(&self.folder);
        if parent != self.folder && parent.is_symlink() {
            let message =
                "wanted a folder for results, got a symbolic link, which may lead anywhere";
            return Err(Diagnostic::file(parent, message)
                .help("remove it, or name another folder with --out"));
        }
        if names(&path).iter().any(|name| self.inputs.contains(name)) && !holds(&path, pieces) {
            let message = "a result would replace this file, which the run reads";
            return Err(Diagnostic::file(&path, message)
                .help("name another folder with --out, or replace it with --force"));
        }
        Ok(())
    }

    fn replace(&self, name: &str, pieces: &[Cow<[u8]>]) -> Result<PathBuf, Diagnostic> {
        let path = self.folder.join(name);
        let cannot = |e: std::io::Error| Diagnostic::file(&path, format!("cannot be written: {e}"));
        if holds(&path, pieces) {
            return Ok(path);
        }
        let mut builder = tempfile::Builder::new();
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666)); // less the umask
        let mut temporary =
            builder.prefix(".relight-").tempfile_in(&self.folder).map_err(cannot)?;
        pieces.iter().try_for_each(|piece| temporary.write_all(piece)).map_err(cannot)?;
        path.parent().map_or(Ok(()), std::fs::create_dir_all).map_err(cannot)?;
        temporary.persist(&path).map_err(|e| cannot(e.error))?;
        Ok(path)
    }
}

/// The canonical names of a file: with the links to its folder resolved, and with all links
/// resolved.
fn names(path: &Path) -> Vec<PathBuf> {
    let folder =
        path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let own =
        folder.canonicalize().ok().zip(path.file_name()).map(|(folder, name)| folder.join(name));
    own.into_iter().chain(path.canonicalize()).collect()
}

/// Whether a file contains these bytes. The comparison goes piece by piece, as two pictures of one
/// size differ early.
fn holds(path: &Path, pieces: &[Cow<[u8]>]) -> bool {
    let Ok(mut file) = File::open(path) else { return false };
    let length: usize = pieces.iter().map(|piece| piece.len()).sum();
    if !file.metadata().is_ok_and(|m| m.is_file() && m.len() == length as u64) {
        return false;
    }
    let mut old = vec![0; COMPARED];
    pieces.iter().flat_map(|piece| piece.chunks(COMPARED)).all(|piece| {
        let old = &mut old[..piece.len()];
        file.read_exact(old).is_ok() && old == piece
    })
}

const COMPARED: usize = 64 << 10;

/// Prints a result on standard output, escaped like messages. A closed reader (`| head`) is not a
/// fault.
///
/// # Errors
/// Standard output cannot be written.
pub fn print(text: &str) -> Result<(), Diagnostic> {
    let mut out = std::io::stdout().lock();
    match out.write_all(escape(text).as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Diagnostic::file("standard output".as_ref(), format!("cannot be written: {e}")))
        }
        _ => Ok(()),
    }
}

/// Prints the paths of written files on standard output, one per line.
///
/// # Errors
/// Those of [`print`].
pub fn print_paths(paths: &[PathBuf]) -> Result<(), Diagnostic> {
    print(
        &paths
            .iter()
            .map(|path| format!("{}\n", escape_line(&path.display().to_string())))
            .collect::<String>(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn output(folder: &Path, inputs: &[&str], force: bool) -> Output {
        Output::new(folder, inputs.iter().map(|name| folder.join(name)), force)
            .expect("the folder is there")
    }

    #[test]
    fn the_same_bytes_leave_a_file_untouched_and_others_replace_it_whole() {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let out = output(folder.path(), &[], false);
        let path = out.file("a.txt", b"one").expect("it can be written");
        let stamp = || std::fs::metadata(&path).and_then(|m| m.modified()).expect("it is there");
        let old = std::time::SystemTime::UNIX_EPOCH;
        let open = std::fs::File::options().write(true).open(&path).expect("it can be opened");
        open.set_modified(old).expect("its time can be set");
        out.file("a.txt", b"one").expect("it can be written");
        assert_eq!(stamp(), old);
        out.file("a.txt", b"two").expect("it can be written");
        assert_ne!(stamp(), old);
        assert_eq!(std::fs::read(&path).expect("it is there"), b"two");
        assert_eq!(
            std::fs::read_dir(folder.path()).expect("it is there").count(),
            1,
            "nothing temporary is left"
        );
        let inner = out.file("masks/b.txt", b"three").expect("it can be written");
        assert_eq!(std::fs::read(inner).expect("it is there"), b"three");
    }

    #[test]
    fn a_name_of_a_result_leads_nowhere_else() {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let out = output(&folder.path().join("out"), &[], false);
        let victim = folder.path().join("victim");
        std::fs::write(&victim, "mine").expect("it can be written");
        for name in
            ["../victim", victim.to_str().expect("it is ASCII"), "masks/../../victim", "..\\victim"]
        {
            // One of several: nothing is written at all.
            let fault =
                out.write(&[("sound.png", "theirs"), (name, "theirs")]).expect_err("it is refused");
            assert!(fault.message.contains("wanted the plain name of a file"), "{fault}");
            assert!(!folder.path().join("out/sound.png").exists());
        }
        assert_eq!(std::fs::read(&victim).expect("it is there"), b"mine");
        #[cfg(unix)]
        {
            let elsewhere = folder.path().join("elsewhere");
            std::fs::create_dir(&elsewhere).expect("a folder can be made");
            std::os::unix::fs::symlink(&elsewhere, folder.path().join("out/masks"))
                .expect("a link can be made");
            let fault = out.file("masks/lamp_0.png", b"theirs").expect_err("it is refused");
            assert!(fault.message.contains("symbolic link"), "{fault}");
            assert_eq!(std::fs::read_dir(&elsewhere).expect("it is there").count(), 0);
        }
    }

    #[test]
    fn what_a_run_reads_is_not_replaced() {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let write = |name: &str| {
            std::fs::write(folder.path().join(name), "photo").expect("it can be written")
        };
        write("picture.png");
        write("real.png");
        let (out, forced) = (
            output(folder.path(), &["picture.png"], false),
            output(folder.path(), &["picture.png"], true),
        );
        let fault =
            out.write(&[("other.png", "new"), ("picture.png", "new")]).expect_err("it is refused");
        assert!(
            fault.message.contains("which the run reads") && fault.to_string().contains("--force"),
            "{fault}"
        );
        assert!(!folder.path().join("other.png").exists(), "nothing is written");
        out.file("picture.png", b"photo").expect("the same bytes replace nothing");
        #[cfg(unix)]
        {
            // The input is a link to a file of another name in the folder for results.
            std::os::unix::fs::symlink(
                folder.path().join("real.png"),
                folder.path().join("link.png"),
            )
            .expect("a link can be made");
            let out = output(folder.path(), &["link.png"], false);
            assert!(out.file("real.png", b"new").is_err() && out.file("link.png", b"new").is_err());
        }
        forced.file("picture.png", b"new").expect("it is forced");
        assert_eq!(std::fs::read(folder.path().join("picture.png")).expect("it is there"), b"new");
    }
}
