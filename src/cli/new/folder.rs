//! The folder that `relight new` fills, and the record by which it knows its own files again.
//!
//! A file whose bytes are not those that were written last belongs to the person and stays.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use relight::graph::{Diagnostic, MAX_FILE_BYTES, plain_error, read};
use serde::{Deserialize, Serialize};

use crate::cli::write::Output;

/// The name of the record.
const RECORD: &str = "new.json";
/// The largest record that is read, bytes.
const MAX_RECORD: u64 = 1 << 20;

/// The digests of the files as they were written, BLAKE3 in hexadecimal digits.
#[derive(Default, Serialize, Deserialize)]
struct Record {
    /// The reason for the file, for a person who opens it.
    about: String,
    files: BTreeMap<String, String>,
    /// The origins of files in words, where the next call cannot know them.
    #[serde(default)]
    origins: BTreeMap<String, String>,
}

/// A folder in which files of the program and of a person lie side by side.
pub struct SceneFolder {
    path: PathBuf,
    out: Output,
    record: Record,
    /// Names of files that are left as a person made them.
    kept: Vec<String>,
    written: Vec<PathBuf>,
}

impl SceneFolder {
    /// Opens the folder, which is made where it is missing. A damaged record counts as missing:
    /// then every file that is there stays.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub fn open(path: &Path) -> Result<SceneFolder, Diagnostic> {
        let out = Output::new(path, [], false)?;
        let record = read(&path.join(RECORD), MAX_RECORD).ok();
        let record = record.and_then(|bytes| serde_json::from_slice(&bytes).ok());
        let (path, kept, written) = (path.to_owned(), Vec::new(), Vec::new());
        Ok(SceneFolder { path, out, record: record.unwrap_or_default(), kept, written })
    }

    /// The place of a file in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Whether a person made or changed the file of this name.
    pub fn is_of_person(&self, name: &str) -> bool {
        let path = self.path(name);
        // A link, a folder or a file too large to be read is none of ours.
        path.symlink_metadata().is_ok()
            && match read(&path, MAX_FILE_BYTES) {
                Ok(bytes) => self.record.files.get(name) != Some(&digest(&bytes)),
                Err(_) => true,
            }
    }

    /// Writes a file unless a person made or changed it; returns whether it has these bytes now.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn put(&mut self, name: &str, bytes: &[u8]) -> Result<bool, Diagnostic> {
        let is_same = read(&self.path(name), MAX_FILE_BYTES).is_ok_and(|old| old == bytes);
        if !is_same && self.is_of_person(name) {
            self.kept.push(name.to_owned());
            return Ok(false);
        }
        let path = self.out.file(name, bytes)?;
        if !self.written.contains(&path) {
            self.written.push(path);
        }
        self.record.files.insert(name.to_owned(), digest(bytes));
        Ok(true)
    }

    /// Notes the origin of a file for later calls.
    pub fn set_origin(&mut self, name: &str, origin: &str) {
        self.record.origins.insert(name.to_owned(), origin.to_owned());
    }

    /// The origin of a file as an earlier call noted it.
    pub fn origin(&self, name: &str) -> Option<&str> {
        self.record.origins.get(name).map(String::as_str)
    }

    /// Whether the sub-folder `masks` has a file that a person gave, made or changed.
    ///
    /// # Errors
    /// The folder cannot be listed.
    pub fn has_masks_of_person(&self) -> Result<bool, Diagnostic> {
        let folder = self.path("masks");
        if !folder.is_dir() {
            return Ok(false);
        }
        if self.origin("masks").is_some() {
            return Ok(true);
        }
        Ok(listed(&folder)?.any(|entry| {
            let name = entry.ok().and_then(|entry| entry.file_name().into_string().ok());
            name.is_none_or(|name| self.is_of_person(&format!("masks/{name}")))
        }))
    }

    /// Writes the record; returns the paths of the written files and the names of those kept.
    ///
    /// # Errors
    /// The record cannot be written.
    pub fn close(mut self) -> Result<(Vec<PathBuf>, Vec<String>), Diagnostic> {
        self.record.about = "relight new wrote these files; it replaces none whose digest \
                             differs, as a person has changed it"
            .into();
        let text = serde_json::to_string_pretty(&self.record).expect("plain data has a JSON form");
        self.out.file(RECORD, (text + "\n").as_bytes())?;
        Ok((self.written, self.kept))
    }
}

/// The entries of a folder.
///
/// # Errors
/// It cannot be listed.
pub fn listed(folder: &Path) -> Result<std::fs::ReadDir, Diagnostic> {
    std::fs::read_dir(folder)
        .map_err(|e| Diagnostic::file(folder, format!("cannot be listed: {}", plain_error(e))))
}

fn digest(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_a_person_changed_or_made_stays() {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let at = |name: &str| folder.path().join(name);
        let text = |name: &str| std::fs::read_to_string(at(name)).expect("it is there");
        std::fs::write(at("b"), "theirs").expect("it can be written");
        let mut first = SceneFolder::open(folder.path()).expect("it can be opened");
        assert!(first.put("a", b"one").expect("it can be written"));
        assert!(!first.put("b", b"one").expect("it is kept"));
        let (_, kept) = first.close().expect("the record can be written");
        assert_eq!((text("a"), text("b"), kept), ("one".into(), "theirs".into(), vec!["b".into()]));

        let mut second = SceneFolder::open(folder.path()).expect("it can be opened");
        assert!(second.put("a", b"two").expect("it is our own"));
        std::fs::write(at("a"), "edited").expect("it can be written");
        assert!(!second.put("a", b"three").expect("it is kept"));
        assert!(second.put("a", b"edited").expect("the same bytes"), "equal bytes are taken over");
        second.close().expect("the record can be written");
        std::fs::write(at(RECORD), "damaged").expect("it can be written");
        let mut third = SceneFolder::open(folder.path()).expect("it can be opened");
        assert!(!third.put("a", b"four").expect("it is kept"));
        assert_eq!(text("a"), "edited");
    }
}
