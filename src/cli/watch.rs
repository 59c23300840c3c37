//! Waits for changes of files, by looking at their stamps five times a second: that works on every
//! system and for files on a network, and a run has a few dozen files.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// Interval between looks.
const INTERVAL: Duration = Duration::from_millis(200);
/// Files stay unchanged for this long before a change counts, as programs write in pieces.
const DEBOUNCE: Duration = Duration::from_millis(100);
/// Most files of a folder that are looked at.
const MOST_FILES: usize = 1000;
/// Depth of folders within a folder that is watched: scenes have `masks/` and `truth/`.
const DEPTH: usize = 2;

/// Time and length of a file; `None` where it is missing.
type Stamp = Option<(SystemTime, u64)>;

/// The watched files, with their stamps when they were last looked at.
#[derive(Default)]
pub struct Watch {
    files: BTreeSet<PathBuf>,
    /// A folder whose files are watched, and a folder in it whose files are not.
    folder: Option<(PathBuf, PathBuf)>,
    stamps: BTreeMap<PathBuf, Stamp>,
}

impl Watch {
    /// Watches these files and no others. A file that was watched keeps its stamp, so that a change
    /// since then is seen.
    pub fn set(&mut self, files: BTreeSet<PathBuf>) {
        self.files.clear();
        self.folder = None;
        self.add(files);
    }

    /// Watches these files, too.
    pub fn add(&mut self, files: impl IntoIterator<Item = PathBuf>) {
        for file in files {
            self.stamps.entry(file.clone()).or_insert_with(|| stamp(&file));
            self.files.insert(file);
        }
    }

    /// Watches all files of a folder, too, but those of the folder `except` in it.
    pub fn add_folder(&mut self, folder: Option<PathBuf>, except: &Path) {
        self.folder = folder.map(|folder| (folder, except.to_owned()));
        for (file, stamp) in self.look() {
            self.stamps.entry(file).or_insert(stamp);
        }
    }

    /// Waits until files change and then stay the same; returns them, or none once `stop` holds.
    pub fn wait(&mut self, stop: &dyn Fn() -> bool) -> Vec<PathBuf> {
        while !stop() {
            let mut now = self.look();
            let old = |file: &PathBuf| self.stamps.get(file).copied().flatten();
            if now.iter().all(|(file, stamp)| *stamp == old(file)) {
                std::thread::sleep(INTERVAL);
                continue;
            }
            loop {
                std::thread::sleep(DEBOUNCE);
                let again = self.look();
                if std::mem::replace(&mut now, again) == now || stop() {
                    break;
                }
            }
            let changed: Vec<PathBuf> = now
                .iter()
                .filter(|(file, stamp)| **stamp != old(file))
                .map(|(f, _)| f.clone())
                .collect();
            self.stamps = now;
            if !changed.is_empty() {
                return changed;
            }
        }
        Vec::new()
    }

    /// The stamp of each file. One that was there and is missing is listed, too.
    fn look(&self) -> BTreeMap<PathBuf, Stamp> {
        let mut files = self.files.clone();
        if let Some((folder, except)) = &self.folder {
            list(folder, except, DEPTH, &mut files);
            files.extend(self.stamps.keys().filter(|file| file.starts_with(folder)).cloned());
        }
        files.into_iter().map(|file| (file.clone(), stamp(&file))).collect()
    }
}

fn stamp(file: &Path) -> Stamp {
    let metadata = file.metadata().ok().filter(|metadata| metadata.is_file())?;
    Some((metadata.modified().ok()?, metadata.len()))
}

fn list(folder: &Path, except: &Path, depth: usize, files: &mut BTreeSet<PathBuf>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let (path, kind) = (entry.path(), entry.file_type());
        let is_folder = kind.is_ok_and(|kind| kind.is_dir());
        if files.len() >= MOST_FILES {
            return;
        } else if !is_folder {
            files.insert(path);
        } else if depth > 0 && !is_same(&path, except) {
            list(&path, except, depth - 1, files);
        }
    }
}

fn is_same(a: &Path, b: &Path) -> bool {
    a == b || a.canonicalize().ok().zip(b.canonicalize().ok()).is_some_and(|(a, b)| a == b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_is_seen_once_and_results_are_not_watched() {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let path = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(path("out")).expect("a folder can be made");
        std::fs::create_dir_all(path("masks")).expect("a folder can be made");
        std::fs::write(path("edit.ron"), "one").expect("it can be written");
        let mut watch = Watch::default();
        watch.set([path("edit.ron"), path("graph.ron")].into());
        watch.add_folder(Some(folder.path().to_owned()), &path("out"));
        let looks = std::cell::Cell::new(0);
        let soon = || looks.replace(looks.get() + 1) > 1;
        assert_eq!(watch.wait(&soon), Vec::<PathBuf>::new());
        for (name, text) in [("edit.ron", "three"), ("masks/lamp.png", "new"), ("graph.ron", "new")]
        {
            std::fs::write(path(name), text).expect("it can be written");
            looks.set(0);
            assert_eq!(watch.wait(&soon), [path(name)]);
        }
        std::fs::write(path("out/picture.png"), "a result").expect("it can be written");
        looks.set(0);
        assert_eq!(watch.wait(&soon), Vec::<PathBuf>::new());
        // A change between two waits, while the set of files is made anew.
        std::fs::remove_file(path("edit.ron")).expect("it can be removed");
        watch.set([path("edit.ron")].into());
        looks.set(0);
        assert_eq!(watch.wait(&soon), [path("edit.ron")]);
    }
}
