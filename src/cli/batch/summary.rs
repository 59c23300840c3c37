//! The summary of a batch: `results.csv`, `index.html`, films of sequences, and a few lines.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use relight::graph::{Diagnostic, escape, escape_markup};

use super::list::{Job, List};
use super::state::{FOLDER, Run, State, Status};
use crate::cli::frames::{film, numbered};
use crate::cli::messages::{error, message};
use crate::cli::write::Output;

/// Failures that are told at the end; the table has all.
const MOST_TOLD: usize = 20;
const FPS: u16 = 24;
/// Characters of a path that stay as they are in an address.
const PATH: &AsciiSet =
    &NON_ALPHANUMERIC.remove(b'/').remove(b'-').remove(b'_').remove(b'.').remove(b'~');

/// States of all jobs of a list; `None` for a job that has not run.
pub struct Summary<'a> {
    jobs: Vec<(&'a Job, Option<State>)>,
    films: Vec<PathBuf>,
    warnings: Vec<String>,
}

impl Summary<'_> {
    /// Reads the states of all jobs, and makes the films that are whole.
    pub fn read(list: &List) -> Summary<'_> {
        let jobs = list.jobs.iter().map(|job| (job, State::read(&list.out, job))).collect();
        let mut summary = Summary { jobs, films: Vec::new(), warnings: Vec::new() };
        summary.make_films(list);
        summary
    }

    /// Whether every job is done.
    pub fn is_whole(&self) -> bool {
        self.count(|state| state.is_some_and(|s| s.status == Status::Done)) == self.jobs.len()
    }

    fn count(&self, is: impl Fn(Option<&State>) -> bool) -> usize {
        self.jobs.iter().filter(|(_, state)| is(state.as_ref())).count()
    }

    /// A film for each folder whose chunks are all done and begin with frame 0, unless it is newer
    /// than its pictures.
    fn make_films(&mut self, list: &List) {
        let mut folders: BTreeMap<&Path, Vec<&(&Job, Option<State>)>> = BTreeMap::new();
        for entry in self.jobs.iter().filter(|(job, _)| job.frames.is_some()) {
            folders.entry(&entry.0.out).or_default().push(entry);
        }
        let mut films = Vec::new();
        let mut warnings = Vec::new();
        for (out, chunks) in folders {
            let is_done = |(_, state): &&(&Job, Option<State>)| {
                state.as_ref().is_some_and(|state| state.status == Status::Done)
            };
            let frames: u32 =
                chunks.iter().flat_map(|(job, _)| &job.frames).map(|f| f.end - f.start).sum();
            let last = chunks.iter().flat_map(|(job, _)| &job.frames).map(|f| f.end).max();
            let folder = list.out.join(out);
            let pictures = (0..frames).map(|n| folder.join(numbered("picture.png", n)));
            let stamp = |path: &Path| path.metadata().and_then(|data| data.modified()).ok();
            let mut newest = None;
            let mut are_there = true;
            for picture in pictures {
                let stamp = stamp(&picture);
                are_there &= stamp.is_some();
                newest = newest.max(stamp);
            }
            if frames < 2 || last != Some(frames) || !are_there || !chunks.iter().all(is_done) {
                continue;
            }
            let path = folder.join(film::NAME);
            if stamp(&path) > newest {
                films.push(path);
                continue;
            }
            match film::make(&folder, FPS, frames as usize) {
                Ok(path) => films.push(path),
                Err(why) => {
                    warnings.push(format!("no {} in {}: {why}", film::NAME, folder.display()))
                }
            }
        }
        (self.films, self.warnings) = (films, warnings);
    }

    /// Writes `results.csv` and `index.html`; returns their paths, and those of the films.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn write(&self, list: &List) -> Result<Vec<PathBuf>, Diagnostic> {
        let out = Output::new(&list.out, [], false)?;
        let mut paths =
            out.write(&[("results.csv", self.csv()), ("index.html", self.page(list))])?;
        paths.extend(self.films.iter().cloned());
        Ok(paths)
    }

    /// Writes the failures and their number to standard error.
    pub fn tell(&self) {
        self.warnings.iter().for_each(|warning| message!("warning: {warning}"));
        let failed = self.failures().count();
        for (job, cause) in self.failures().take(MOST_TOLD) {
            error!("{}: {}", job.name(), cause.trim());
        }
        if failed > MOST_TOLD {
            error!("and {} more failures: results.csv has all", failed - MOST_TOLD);
        }
        let done = self.count(|state| state.is_some_and(|s| s.status == Status::Done));
        let missing = self.count(|state| state.is_none());
        let missing = match missing {
            0 => String::new(),
            missing => format!(", {missing} have not run"),
        };
        message!("{done} of {} jobs done, {failed} failed{missing}", self.jobs.len());
    }

    fn failures(&self) -> impl Iterator<Item = (&Job, &str)> {
        self.jobs.iter().filter_map(|(job, state)| {
            let state = state.as_ref().filter(|state| state.status == Status::Failed)?;
            Some((*job, state.cause.as_deref().unwrap_or("without a message")))
        })
    }

    fn csv(&self) -> Vec<u8> {
        let mut table = csv::Writer::from_writer(Vec::new());
        let columns = [
            "scene", "edit", "first", "last", "status", "seconds", "rays", "ran", "hits",
            "warnings", "cause", "out",
        ];
        let mut write = |row: &[String]| {
            table.write_record(row).expect("rows have equal lengths, and a vector takes all");
        };
        write(&columns.map(str::to_owned));
        for (job, state) in &self.jobs {
            let frames = job.frames.as_ref();
            let number = |n: Option<u32>| n.map_or(String::new(), |n| n.to_string());
            let of = |text: &dyn Fn(&State) -> String| state.as_ref().map_or(String::new(), text);
            let status = state.as_ref().map_or("missing", |state| status(state.status));
            write(&[
                job.scene.display().to_string(),
                job.edit.as_ref().map_or(String::new(), |edit| edit.display().to_string()),
                number(frames.map(|frames| frames.start)),
                number(frames.map(|frames| frames.end - 1)),
                status.to_owned(),
                of(&|state| format!("{:.3}", state.seconds)),
                of(&|state| state.rays.to_string()),
                of(&|state| state.ran.to_string()),
                of(&|state| state.hits.to_string()),
                of(&|state| state.warnings.len().to_string()),
                of(&|state| {
                    let cause = state.cause.as_deref().unwrap_or_default();
                    cause.split_whitespace().collect::<Vec<_>>().join(" ")
                }),
                job.out.display().to_string(),
            ]);
        }
        table.into_inner().expect("a vector takes all")
    }

    fn page(&self, list: &List) -> Vec<u8> {
        let done = self.count(|state| state.is_some_and(|s| s.status == Status::Done));
        let seconds: f64 = self.jobs.iter().flat_map(|(_, state)| state).map(|s| s.seconds).sum();
        let rays: u64 = self.jobs.iter().flat_map(|(_, state)| state).map(|s| s.rays).sum();
        let mut page = format!(
            "<!doctype html>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width\">\n\
             <title>{0} of {1} jobs</title>\n<style>{STYLE}</style>\n<h1>{0} of {1} jobs done</h1>\n\
             <p>{2:.0} s of work, {3} rays{4}. <a href=\"results.csv\">results.csv</a></p>\n",
            done,
            self.jobs.len(),
            seconds,
            rays,
            cost(&list.out),
        );
        if self.failures().next().is_some() {
            page.push_str("<h2>Failures</h2>\n<dl>\n");
            for (job, cause) in self.failures() {
                let (name, cause) = (html(&job.name()), html(cause.trim()));
                page.push_str(&format!("<dt>{name}</dt><dd><pre>{cause}</pre></dd>\n"));
            }
            page.push_str("</dl>\n");
        }
        page.push_str("<h2>Results</h2>\n<main>\n");
        for (job, state) in &self.jobs {
            let folder = address(&job.out);
            let name = html(&job.name());
            let Some(state) = state else {
                page.push_str(&format!("<figure class=\"missing\">{name}<br>not run</figure>\n"));
                continue;
            };
            let first = state.files.iter().find(|file| file.ends_with(".png"));
            let target = first
                .map_or(folder.clone(), |file| format!("{folder}/{}", address(Path::new(file))));
            let picture = state.thumbnail.as_ref().map_or(String::new(), |thumbnail| {
                let source = address(Path::new(thumbnail));
                format!("<img loading=\"lazy\" alt=\"\" src=\"{folder}/{source}\">")
            });
            let warnings = match state.warnings.len() {
                0 => String::new(),
                count => format!(", {count} warnings"),
            };
            page.push_str(&format!(
                "<figure class=\"{}\"><a href=\"{target}\">{picture}<figcaption>{name}</figcaption></a>{:.1} s{warnings}</figure>\n",
                status(state.status),
                state.seconds,
            ));
        }
        page.push_str("</main>\n");
        page.into_bytes()
    }
}

const STYLE: &str = "body{font:14px system-ui,sans-serif;margin:2em;color-scheme:light dark}\
main{display:grid;grid-template-columns:repeat(auto-fill,minmax(220px,1fr));gap:1em}\
figure{margin:0}figure img{width:100%;display:block}.failed{outline:2px solid #c33}\
.missing{opacity:.6}pre{white-space:pre-wrap}";

fn status(status: Status) -> &'static str {
    match status {
        Status::Done => "done",
        Status::Failed => "failed",
        Status::Interrupted => "interrupted",
    }
}

/// Processor time and traffic of all commands that have worked on a batch.
fn cost(out: &Path) -> String {
    let files = std::fs::read_dir(out.join(FOLDER)).into_iter().flatten().flatten();
    let runs = files.filter_map(|file| {
        let bytes = relight::graph::read(&file.path(), 1 << 20).ok()?;
        serde_json::from_slice::<Run>(&bytes).ok()
    });
    let (mut cpu, mut traffic) = (0.0, None);
    for run in runs {
        cpu += run.cpu_seconds;
        traffic = match (traffic, run.traffic) {
            (Some(all), Some(one)) => Some(all + one),
            (all, one) => all.or(one),
        };
    }
    let traffic = traffic.map_or(String::new(), |traffic| format!("; cache store: {traffic}"));
    format!(", {cpu:.0} s of processor time in the last commands{traffic}")
}

fn html(text: &str) -> String {
    escape_markup(&escape(text))
}

fn address(path: &Path) -> String {
    utf8_percent_encode(&path.to_string_lossy().replace('\\', "/"), PATH).to_string()
}
