//! The jobs of a list: patterns looked up, photos times edits, chunks of frames, a folder for the
//! results of each.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

use relight::files::EditFile;
use relight::files::batch::{self, Row};
use relight::graph::{Diagnostic, Key, Reach};

use super::args::BatchArgs;
use crate::cli::shipped::graph_path;

/// The graph of a list without one.
const GRAPH: &str = "indoor";
/// The results of a photo without an edit.
const UNEDITED: &str = "unedited";

/// All jobs of a batch, those of one photo one after the other.
pub struct List {
    pub graph: PathBuf,
    /// The folder for the results.
    pub out: PathBuf,
    pub jobs: Vec<Job>,
    /// The file of the list.
    path: PathBuf,
}

/// One photo with one edit: a picture, or frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Job {
    pub scene: PathBuf,
    pub edit: Option<PathBuf>,
    /// Frames of an edit that is a sequence.
    pub frames: Option<Range<u32>>,
    /// Settings of parameters, as `NODE.PARAM=VALUE`.
    pub set: Vec<String>,
    /// The folder for its results, within that of the batch; its name in messages.
    pub out: PathBuf,
    /// The task of a plan that it belongs to.
    pub task: Option<u32>,
}

impl Job {
    /// `hall/lamp_off`, `hall/day 0-23`.
    pub fn name(&self) -> String {
        let out = self.out.display();
        match &self.frames {
            Some(frames) => format!("{out} {}-{}", frames.start, frames.end - 1),
            None => out.to_string(),
        }
    }

    /// A part of file names: empty for a picture, `_0000-0023` for frames.
    pub fn suffix(&self) -> String {
        let frames = self.frames.as_ref();
        frames.map_or(String::new(), |f| format!("_{:04}-{:04}", f.start, f.end - 1))
    }
}

impl List {
    /// Reads a list and looks up its patterns. Scenes and edits that cannot be used are left to
    /// their jobs.
    ///
    /// # Errors
    /// Faults of the list and of its table.
    pub fn read(args: &BatchArgs) -> Result<List, Vec<Diagnostic>> {
        let batch = batch::read(&args.jobs)?;
        let folder = args.jobs.parent().unwrap_or(Path::new(""));
        let reach = args.confined.reach();
        let mut faults = Vec::new();
        let mut lengths = Lengths { reach, known: BTreeMap::new() };
        let mut names = Names::default();

        let found = |patterns: &[Key], kind: Kind, faults: &mut Vec<Diagnostic>| {
            let mut all = Vec::new();
            for pattern in patterns {
                match look_up(folder, pattern, kind) {
                    Ok(paths) => all.extend(paths),
                    Err(fault) => faults.push(fault),
                }
            }
            let mut known = BTreeSet::new();
            all.retain(|path| known.insert(path.clone()));
            all
        };
        let scenes = found(&batch.scenes, Kind::Scene, &mut faults);
        let edits: Vec<Option<PathBuf>> = if batch.edits.is_empty() {
            vec![None]
        } else {
            found(&batch.edits, Kind::Edit, &mut faults).into_iter().map(Some).collect()
        };

        let mut jobs = Vec::new();
        for scene in &scenes {
            for edit in &edits {
                let out = names.of(scene, edit.as_deref());
                let (set, task) = (batch.set.clone(), None);
                let (scene, edit) = (scene.clone(), edit.clone());
                let whole = Job { scene, edit, frames: None, set, out, task };
                jobs.extend(lengths.chunks(whole, batch.frames, batch.chunk));
            }
        }
        for row in batch.rows {
            let Row { scene, edit, frames, out, task, set } = row;
            let scene = folder.join(&scene.name);
            let edit = edit.map(|edit| folder.join(&edit.name));
            let out = match out {
                None => names.of(&scene, edit.as_deref()),
                Some(out) => match inner(&out) {
                    Ok(path) => path,
                    Err(fault) => {
                        faults.push(fault);
                        continue;
                    }
                },
            };
            let set = batch.set.iter().cloned().chain(set).collect();
            let whole = Job { scene, edit, frames: None, set, out, task };
            let chunk = batch.chunk.filter(|_| task.is_none());
            jobs.extend(lengths.chunks(whole, frames.or(batch.frames), chunk));
        }
        faults.extend(clashes(&args.jobs, &jobs));
        if !faults.is_empty() {
            return Err(faults);
        }
        // Jobs of one photo stand together, in the order in which the photos first appear.
        let mut order = BTreeMap::new();
        for job in &jobs {
            let next = order.len();
            order.entry(job.scene.clone()).or_insert(next);
        }
        jobs.sort_by_key(|job| order[&job.scene]);
        let out =
            args.out.clone().unwrap_or_else(|| folder.join(batch.out.as_deref().unwrap_or("out")));
        let graph = graph(folder, batch.graph.as_ref().map(|key| key.name.as_str()));
        Ok(List { graph, out, jobs, path: args.jobs.clone() })
    }

    #[cfg(test)]
    pub fn of_jobs(jobs: Vec<Job>) -> List {
        List { graph: GRAPH.into(), out: "out".into(), jobs, path: "jobs.ron".into() }
    }

    /// The jobs of each photo among `jobs`.
    pub fn photos(&self, jobs: &[usize]) -> Vec<Vec<usize>> {
        let same = |a: &usize, b: &usize| self.jobs[*a].scene == self.jobs[*b].scene;
        jobs.chunk_by(same).map(<[usize]>::to_vec).collect()
    }

    /// The fault of a task that the list does not have.
    pub fn no_task(&self, task: u32) -> Diagnostic {
        let last = self.jobs.iter().filter_map(|job| job.task).max();
        let message = match last {
            Some(last) => {
                format!("--task: wanted a task from 0 to {last} of this list, got {task}")
            }
            None => "--task: wanted a list whose table has a column `task`".to_owned(),
        };
        Diagnostic::file(&self.path, message)
            .help("`relight batch JOBS.ron --plan slurm DIR` makes one")
    }
}

/// A name that ships, or a file, whose path starts from the folder of the list.
fn graph(folder: &Path, name: Option<&str>) -> PathBuf {
    let name = name.unwrap_or(GRAPH);
    let file = folder.join(name);
    if file.is_file() { file } else { graph_path(name).unwrap_or(file) }
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Scene,
    Edit,
}

/// The paths that a pattern matches, sorted; a path without wildcards is itself.
fn look_up(folder: &Path, pattern: &Key, kind: Kind) -> Result<Vec<PathBuf>, Diagnostic> {
    if !pattern.name.contains(['*', '?', '[']) {
        return Ok(vec![folder.join(&pattern.name)]);
    }
    let folder = glob::Pattern::escape(&folder.to_string_lossy());
    let text = Path::new(&folder).join(&pattern.name);
    let matched = glob::glob(&text.to_string_lossy()).map_err(|e| {
        Diagnostic::at(&pattern.origin, format!("wanted a pattern of paths: {}", e.msg))
    })?;
    let matched: Vec<PathBuf> = matched.flatten().collect();
    let is_wanted = |path: &PathBuf| match kind {
        Kind::Scene => path.join("scene.ron").is_file(),
        Kind::Edit => path.is_file(),
    };
    let wanted: Vec<PathBuf> = matched.iter().filter(|path| is_wanted(path)).cloned().collect();
    if wanted.is_empty() {
        let what = match kind {
            Kind::Scene => "a folder with a scene.ron",
            Kind::Edit => "an edit file",
        };
        let message = format!(
            "wanted {what}, got none among {} paths that `{}` matches",
            matched.len(),
            pattern.name
        );
        return Err(Diagnostic::at(&pattern.origin, message)
            .help("patterns start from the folder of this list; * matches within one folder, ** any depth"));
    }
    Ok(wanted)
}

/// A folder below that of the results.
fn inner(out: &Key) -> Result<PathBuf, Diagnostic> {
    use std::path::Component;
    let path = PathBuf::from(&out.name);
    let is_inner = path.components().all(|part| matches!(part, Component::Normal(_)));
    if is_inner && !out.name.contains('\\') {
        return Ok(path);
    }
    let message = format!("wanted a folder below that of the results, got `{}`", out.name);
    Err(Diagnostic::at(&out.origin, message).help("for example `hall/dusk`"))
}

/// Names of result folders: those of the scene's folder and of the edit's file, with the folder
/// before it where two have the same name.
#[derive(Default)]
struct Names {
    known: BTreeMap<String, PathBuf>,
}

impl Names {
    fn of(&mut self, scene: &Path, edit: Option<&Path>) -> PathBuf {
        let real = scene.canonicalize().unwrap_or_else(|_| scene.to_owned());
        let scene = self.name("scene", &real, false);
        let edit = edit.map_or(UNEDITED.to_owned(), |edit| self.name("edit", edit, true));
        Path::new(&scene).join(edit)
    }

    fn name(&mut self, kind: &str, path: &Path, is_file: bool) -> String {
        let parts: Vec<String> =
            path.components().map(|c| plain(&c.as_os_str().to_string_lossy())).collect();
        let mut name = if is_file {
            path.file_stem().map(|stem| plain(&stem.to_string_lossy())).unwrap_or_default()
        } else {
            parts.last().cloned().unwrap_or_default()
        };
        for before in parts.iter().rev().skip(1).map(Some).chain([None]) {
            let owner =
                self.known.entry(format!("{kind}/{name}")).or_insert_with(|| path.to_owned());
            if *owner == path {
                break;
            }
            if let Some(before) = before {
                name = format!("{before}_{name}");
            }
        }
        name
    }
}

/// A name that is valid on every system.
fn plain(name: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_' | '.');
    let name: String = name.chars().map(|c| if is_plain(c) { c } else { '_' }).collect();
    if name.starts_with('.') { format!("_{name}") } else { name }
}

/// Numbers of frames of edits that were read.
struct Lengths {
    reach: Reach,
    known: BTreeMap<PathBuf, Option<u32>>,
}

impl Lengths {
    /// A job, or one per chunk of its frames. An edit that cannot be read is one job, which fails.
    fn chunks(&mut self, whole: Job, frames: Option<(u32, u32)>, chunk: Option<u32>) -> Vec<Job> {
        let reach = self.reach;
        let length = whole.edit.as_ref().and_then(|edit| {
            let read = || EditFile::read_within(edit, reach).ok()?.frames();
            *self.known.entry(edit.clone()).or_insert_with(read)
        });
        let Some(length) = length else { return vec![whole] };
        let (first, last) = frames.unwrap_or((0, length - 1));
        // Frames that the edit lacks are left out; a range without any stays, and fails.
        let end = if first < length { (last + 1).min(length) } else { last + 1 };
        let step = chunk.unwrap_or(u32::MAX);
        let mut jobs = Vec::new();
        let mut start = first;
        while start < end {
            let stop = start.saturating_add(step).min(end);
            jobs.push(Job { frames: Some(start..stop), ..whole.clone() });
            start = stop;
        }
        jobs
    }
}

/// Jobs that would write the same files.
fn clashes(list: &Path, jobs: &[Job]) -> Option<Diagnostic> {
    let mut all: Vec<(&Path, u32, u32)> = Vec::new();
    for job in jobs {
        let frames = job.frames.clone().unwrap_or(0..u32::MAX);
        all.push((&job.out, frames.start, frames.end));
    }
    all.sort();
    let clash = all.windows(2).find(|pair| pair[0].0 == pair[1].0 && pair[1].1 < pair[0].2)?;
    let message = format!("two jobs have the folder `{}` for their results", clash[0].0.display());
    let help = "give rows of one photo and one edit a column `out` with a folder each, or list each photo and edit once";
    Some(Diagnostic::file(list, message).help(help))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(out: &str, frames: Option<Range<u32>>) -> Job {
        let (scene, edit, set) = (PathBuf::from("hall"), None, Vec::new());
        Job { scene, edit, frames, set, out: out.into(), task: None }
    }

    #[test]
    fn names_of_results_differ_where_paths_do() {
        let mut names = Names::default();
        let of = |names: &mut Names, scene: &str, edit: &str| {
            names.of(scene.as_ref(), Some(edit.as_ref())).display().to_string()
        };
        assert_eq!(of(&mut names, "/a/hall", "e/off.ron"), "hall/off");
        assert_eq!(of(&mut names, "/b/hall", "e/off.ron"), "b_hall/off");
        assert_eq!(of(&mut names, "/a/hall", "f/off.ron"), "hall/f_off");
        assert_eq!(of(&mut names, "/a/hall", "e/off.ron"), "hall/off");
        assert_eq!(plain("..a b/ü"), "_..a_b_ü");
    }

    #[test]
    fn frames_of_one_folder_may_not_overlap() {
        let clash = |jobs: &[Job]| clashes("jobs.ron".as_ref(), jobs).is_some();
        assert!(!clash(&[job("a", Some(0..24)), job("a", Some(24..48)), job("b", None)]));
        assert!(clash(&[job("a", Some(0..24)), job("a", Some(23..48))]));
        assert!(clash(&[job("a", None), job("a", None)]));
    }
}
