//! Reading of files that anybody may have made.
//!
//! A scene may name a pipe that nobody writes to, a device without end, or a file larger than the
//! memory. Every file that a person, a scene, a model or the cache names is therefore opened here:
//! regular files only, and no byte is read of a file that is larger than its reader takes.

use std::fs::{self, Metadata, OpenOptions};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

/// The largest file that a stage reads, in bytes (2 GiB): the largest networks of ONNX are little
/// smaller.
pub const MAX_FILE_BYTES: u64 = 2 << 30;

/// A file that a stage reads: a path relative to the folder of the file that names it, or absolute.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct File {
    /// The path as it is written.
    pub path: String,
    /// The folder that a relative path starts from; set by the engine when it reads the parameter,
    /// never part of a key.
    #[serde(skip)]
    pub(super) base: Option<PathBuf>,
    /// The folder that the file must lie in, where its text is confined; set with `base`.
    #[serde(skip)]
    pub(super) within: Option<PathBuf>,
}

impl File {
    /// Names a file by its path; loading the graph determines the folder that a relative path
    /// starts from.
    pub fn new(path: impl Into<String>) -> File {
        File { path: path.into(), base: None, within: None }
    }

    /// Returns the bytes before the digest is known, for a stage that must find the files that this
    /// one names; `None` when it has no folder yet or cannot be read, which is an error when its
    /// digest is computed.
    pub fn read_unchecked(&self) -> Option<Vec<u8>> {
        self.base.as_ref().and_then(|_| self.read().ok())
    }

    /// The bytes of the file: a regular one of at most [`MAX_FILE_BYTES`], in its folder where it
    /// is confined to one.
    ///
    /// # Errors
    /// The errors of the system, and a place outside of the folder.
    pub fn read(&self) -> io::Result<Vec<u8>> {
        read_all(self.open()?, MAX_FILE_BYTES)
    }

    /// The open file, with the checks of [`File::read`].
    ///
    /// # Errors
    /// The errors of [`File::read`].
    pub(super) fn open(&self) -> io::Result<fs::File> {
        let place = self.location();
        match &self.within {
            None => open(&place, MAX_FILE_BYTES),
            Some(folder) => open(&below(folder, &place)?, MAX_FILE_BYTES),
        }
    }

    /// The file of this name in the same folder; of a confined file, in that folder or below it.
    pub fn sibling(&self, name: &str) -> File {
        let path = Path::new(&self.path).with_file_name(name).to_string_lossy().into_owned();
        let own_folder = || self.location().parent().unwrap_or(Path::new("")).to_owned();
        File { path, base: self.base.clone(), within: self.within.as_ref().map(|_| own_folder()) }
    }

    /// The path of the file.
    pub fn location(&self) -> PathBuf {
        self.base.as_deref().unwrap_or(Path::new("")).join(&self.path)
    }
}

/// Opens a regular file of at most `limit` bytes; a symbolic link is followed.
///
/// # Errors
/// The errors of the system; `InvalidInput` for anything but a regular file, `FileTooLarge` above
/// the limit.
pub fn open(path: &Path, limit: u64) -> io::Result<fs::File> {
    // Before opening, as the opening of a device may do something.
    check(&path.metadata().map_err(plain_error)?, limit)?;
    Ok(opened(path, limit, true).map_err(plain_error)?.0)
}

/// The file and its metadata, for a path within the cache, whose last component must not be a
/// symbolic link.
///
/// # Errors
/// The path does not name a regular file of at most `limit` bytes, or cannot be opened.
pub(super) fn open_no_follow(path: &Path, limit: u64) -> io::Result<(fs::File, Metadata)> {
    #[cfg(not(unix))]
    check(&path.symlink_metadata()?, limit)?;
    let opened = opened(path, limit, false);
    #[cfg(unix)]
    if opened.as_ref().is_err_and(|e| e.raw_os_error() == Some(nix::errno::Errno::ELOOP as i32)) {
        return Err(not_regular("a symbolic link"));
    }
    opened
}

/// The bytes of a regular file of at most `limit` bytes, also where it grows while it is read.
///
/// # Errors
/// The errors of [`open`].
pub fn read(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    read_all(open(path, limit)?, limit)
}

/// The rest of an open file, at most `limit` bytes.
///
/// # Errors
/// The file is longer than `limit`, or cannot be read.
pub(super) fn read_all(file: fs::File, limit: u64) -> io::Result<Vec<u8>> {
    let size = file.metadata()?.len();
    let mut bytes = Vec::with_capacity(size.min(limit) as usize);
    file.take(limit.saturating_add(1)).read_to_end(&mut bytes).map_err(plain_error)?;
    if bytes.len() as u64 > limit { Err(too_large(bytes.len() as u64, limit)) } else { Ok(bytes) }
}

/// The real place of `path`, which must lie in `folder` or below it once symbolic links are
/// followed.
///
/// # Errors
/// The errors of the system; `PermissionDenied` for a place elsewhere.
pub(super) fn below(folder: &Path, path: &Path) -> io::Result<PathBuf> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let real = |path: &Path| path.canonicalize().map_err(plain_error);
    let (folder, place) = (real(folder)?, real(path)?);
    if place.starts_with(&folder) {
        return Ok(place);
    }
    let message =
        format!("confined: wanted a file below {}, got one outside of it", folder.display());
    Err(io::Error::new(io::ErrorKind::PermissionDenied, message))
}

#[cfg_attr(not(unix), expect(unused_variables, reason = "links were seen before"))]
fn opened(path: &Path, limit: u64, follow: bool) -> io::Result<(fs::File, Metadata)> {
    let mut options = OpenOptions::new();
    options.read(true);
    #[cfg(unix)]
    {
        use nix::fcntl::OFlag;
        use std::os::unix::fs::OpenOptionsExt;
        // A pipe without a writer would otherwise wait for one.
        let flags = if follow { OFlag::O_NONBLOCK } else { OFlag::O_NONBLOCK | OFlag::O_NOFOLLOW };
        options.custom_flags(flags.bits());
    }
    let file = options.open(path)?;
    let data = file.metadata()?;
    check(&data, limit)?;
    Ok((file, data))
}

fn check(data: &Metadata, limit: u64) -> io::Result<()> {
    if !data.is_file() {
        let got = if data.is_dir() {
            "a folder"
        } else if data.is_symlink() {
            "a symbolic link"
        } else {
            "a pipe, a socket or a device"
        };
        return Err(not_regular(got));
    }
    if data.len() > limit { Err(too_large(data.len(), limit)) } else { Ok(()) }
}

/// An error of the system without its number, which means nothing to a person.
pub fn plain_error(error: io::Error) -> io::Error {
    let text = error.to_string();
    match text.rfind(" (os error ") {
        Some(end) => io::Error::new(error.kind(), &text[..end]),
        None => error,
    }
}

fn not_regular(got: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, format!("wanted a regular file, got {got}"))
}

fn too_large(got: u64, limit: u64) -> io::Error {
    io::Error::new(io::ErrorKind::FileTooLarge, format!("wanted at most {limit} bytes, got {got}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(result: io::Result<Vec<u8>>) -> String {
        result.expect_err("it must be refused").to_string()
    }

    #[test]
    fn a_file_above_the_limit_is_refused_by_its_size() {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let path = folder.path().join("a");
        std::fs::write(&path, [7; 10]).expect("it can be written");
        assert_eq!(read(&path, 10).expect("it has ten bytes"), [7; 10]);
        assert_eq!(message(read(&path, 9)), "wanted at most 9 bytes, got 10");
        // A sparse file of 2^40 bytes: nothing of it is read.
        std::fs::File::create(&path)
            .and_then(|file| file.set_len(1 << 40))
            .expect("the file system has sparse files");
        assert_eq!(
            message(read(&path, MAX_FILE_BYTES)),
            format!("wanted at most {} bytes, got {}", MAX_FILE_BYTES, 1u64 << 40)
        );
    }

    #[test]
    fn only_regular_files_are_opened() {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        assert_eq!(message(read(folder.path(), 100)), "wanted a regular file, got a folder");
        #[cfg(unix)]
        {
            let pipe = folder.path().join("pipe");
            nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRUSR).expect("a pipe can be made");
            assert_eq!(
                message(read(&pipe, 100)),
                "wanted a regular file, got a pipe, a socket or a device"
            );
            let link = folder.path().join("link");
            std::os::unix::fs::symlink("/dev/zero", &link).expect("a link can be made");
            assert_eq!(
                message(read(&link, 100)),
                "wanted a regular file, got a pipe, a socket or a device"
            );
            let error = open_no_follow(&link, 100).expect_err("it is a link");
            assert_eq!(error.to_string(), "wanted a regular file, got a symbolic link");
            let error = open_no_follow(&pipe, 100).expect_err("it is a pipe");
            assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
        }
    }
}
