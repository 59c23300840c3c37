//! `relight run` of an edit with `frames`: one engine renders one frame after the other, so that
//! each computes only its changes.
//!
//! A cached frame costs almost no time, so a stopped sequence continues there.

pub mod film;

use std::collections::BTreeSet;
use std::ops::Range;
use std::time::Instant;

use relight::graph::{Observer, RunReport, Status};
use serde::Serialize;

use super::args::RunArgs;
use super::engine::{Host, report_errors};
use super::exit::{CliError, Exit};
use super::load::Pictures;
use super::messages::{error, message, shows_progress};
use super::progress::FrameProgress;
use super::provenance::Inputs;
use super::report::{self, Head, NodeJson};
use super::results::{backend_of, output, results};
use super::write::{self, Output};

/// report.json of a sequence.
#[derive(Serialize)]
struct SequenceReport<'a> {
    #[serde(flatten)]
    head: Head,
    frames: Vec<FrameRow<'a>>,
    film: Option<String>,
    warnings: &'a [String],
}

#[derive(Serialize)]
struct FrameRow<'a> {
    frame: u32,
    seconds: f64,
    files: &'a [String],
    /// The key of the node that wrote the frame.
    key: Option<&'a str>,
    hits: usize,
    /// All nodes that are not hits.
    nodes: Vec<NodeJson<'a>>,
}

/// A finished frame: its row in the table and in report.json.
pub struct Done {
    number: u32,
    /// Without outputs, and without nodes that are hits.
    pub report: RunReport,
    pub hits: usize,
    /// The key of the node that gave the first output.
    key: Option<String>,
    warnings: Vec<String>,
    seconds: f64,
    pub files: Vec<String>,
    differences: Vec<String>,
}

impl Done {
    /// Drops the outputs, which are pictures: a sequence keeps little of a frame.
    fn new(
        number: u32,
        mut report: RunReport,
        began: Instant,
        files: Vec<String>,
        differences: Vec<String>,
    ) -> Done {
        let key = key(&report);
        let hits = report.with_status(Status::Hit).len();
        let warnings = report::warnings(&report);
        report.outputs = Vec::new();
        report.nodes.retain(|node| node.status != Status::Hit);
        let seconds = began.elapsed().as_secs_f64();
        Done { number, report, hits, key, warnings, seconds, files, differences }
    }
}

/// The key of the node that gave the first output.
fn key(report: &RunReport) -> Option<String> {
    let (output, _) = report.outputs.first()?;
    let name = output.split_once('.').map_or(output.as_str(), |(node, _)| node);
    let node = report.nodes.iter().find(|node| node.name == name)?;
    node.key.map(|key| key.to_string())
}

/// Runs or verifies the frames `numbers`, writes their files and shows the report. A frame that
/// fails ends the sequence.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn run(
    args: &RunArgs,
    pictures: &mut Pictures,
    numbers: Range<u32>,
    host: &Host,
    verbose: u8,
    began: Instant,
) -> Result<Exit, CliError> {
    let out = output(args, &pictures.first)?;
    let progress = FrameProgress::new(numbers.len(), verbose > 0, shows_progress());
    let count = numbers.len();
    let (all, backend) = compute(args, pictures, numbers, (host, out.as_ref()), Some(&progress))?;
    progress.end();
    let edit = args.edit.as_deref();
    let head = Head::new(&args.graph, edit, began, backend, host.engine.threads());
    summarize(args, verbose > 0, count, &all, out.as_ref(), head)
}

/// Computes or verifies the frames `numbers` and writes their files; also returns the backend of
/// the networks. A frame that fails is the last.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn compute(
    args: &RunArgs,
    pictures: &mut Pictures,
    numbers: Range<u32>,
    (Host { engine, cancel }, out): (&Host, Option<&Output>),
    progress: Option<&FrameProgress>,
) -> Result<(Vec<Done>, Option<String>), CliError> {
    let wanted = match &args.only {
        Some(only) => Some(vec![only.clone()]),
        None if args.exr || pictures.writers.is_empty() => None,
        None => Some(pictures.writers.clone()),
    };
    pictures.first.wanted(wanted.as_deref())?;
    let observer: &dyn Observer = progress.map_or(&() as &dyn Observer, |progress| progress);
    let mut backend = None;
    let mut all: Vec<Done> = Vec::new();
    for number in numbers {
        let started = Instant::now();
        progress.iter().for_each(|progress| progress.frame(number));
        let graph = pictures.graph(number)?;
        let needed = graph.wanted(wanted.as_deref())?;
        let (report, differences) = if args.verify {
            let verified = engine.verify(&graph, &needed, cancel, observer);
            let differences =
                verified.differences.into_iter().map(|d| format!("{}.{}", d.node, d.port));
            (verified.run, differences.collect())
        } else {
            (engine.run(&graph, &needed, cancel, observer), Vec::new())
        };
        let mut files = Vec::new();
        if report.is_complete()
            && let Some(out) = out
        {
            let results = results(&report);
            let inputs = Inputs::new(args, Some(pictures.text()), Some(number));
            let stamped = inputs.stamp(&graph, &results)?.into_iter();
            let named: Vec<_> =
                stamped.map(|(name, pieces)| (numbered(&name, number), pieces)).collect();
            out.write_pieces(&named)?;
            files.extend(named.into_iter().map(|(name, _)| name));
        }
        if all.is_empty() {
            backend = backend_of(args, &report)?.map(|choice| choice.backend.to_string());
        }
        let done = Done::new(number, report, started, files, differences);
        if let Some(progress) = progress {
            progress.done(number, done.seconds, done.report.with_status(Status::Ran).len());
        }
        let whole = done.report.is_complete();
        all.push(done);
        if !whole {
            break;
        }
    }
    Ok((all, backend))
}

/// Makes the film, writes report.json and tells the outcome; with `rows`, also a row per frame.
fn summarize(
    args: &RunArgs,
    rows: bool,
    count: usize,
    all: &[Done],
    out: Option<&Output>,
    head: Head,
) -> Result<Exit, CliError> {
    let last = all.last().expect("a sequence has a frame");
    let whole = all.len() == count && last.report.is_complete();
    let mut warnings = warnings(all);
    let mut paths: Vec<_> =
        all.iter().flat_map(|done| &done.files).map(|name| args.out.join(name)).collect();
    let has_pictures =
        all.iter().all(|done| done.files.contains(&numbered("picture.png", done.number)));
    let mut film = None;
    if whole && has_pictures && all.len() > 1 {
        match film::make(&args.out, args.fps, all.len()) {
            Ok(path) => {
                film = Some(film::NAME.to_owned());
                paths.push(path);
            }
            Err(why) => warnings.push(format!("no {}: {why}", film::NAME)),
        }
    }
    let seconds = head.seconds;
    let json = json(head, all, film, &warnings);
    if let Some(out) = out {
        paths.push(out.file("report.json", json.as_bytes())?);
    }
    if rows {
        message!("{}", table(all).trim_end());
    }
    warnings.iter().for_each(|warning| message!("warning: {warning}"));
    report_errors(&last.report);
    for (done, what) in
        all.iter().flat_map(|done| done.differences.iter().map(move |what| (done, what)))
    {
        error!("{what}: computed again in frame {}, the result differs", done.number);
    }
    let made = all.iter().filter(|done| done.report.is_complete()).count();
    message!("{made} of {count} frames in {seconds:.2} s");
    if Exit::of(&last.report) == Exit::Interrupted {
        message!("stopped in frame {}; the same command resumes there", last.number);
    }
    if args.json {
        write::print(&json)?;
    } else {
        write::print_paths(&paths)?;
    }
    Ok(Exit::of(&last.report).and(all.iter().all(|done| done.differences.is_empty())))
}

/// The warnings of all frames, each once.
pub fn warnings(all: &[Done]) -> Vec<String> {
    let mut known = BTreeSet::new();
    let warnings = all.iter().flat_map(|done| &done.warnings);
    warnings.filter(|&warning| known.insert(warning)).cloned().collect()
}

/// report.json of a sequence.
pub fn json(head: Head, all: &[Done], film: Option<String>, warnings: &[String]) -> String {
    let frames = all.iter().map(|done| FrameRow {
        frame: done.number,
        seconds: done.seconds,
        files: &done.files,
        key: done.key.as_deref(),
        hits: done.hits,
        nodes: report::rows(&done.report).collect(),
    });
    report::text(&SequenceReport { head, frames: frames.collect(), film, warnings })
}

/// `picture.png` -> `picture_0012.png`
pub fn numbered(name: &str, number: u32) -> String {
    match name.rsplit_once('.') {
        Some((stem, extension)) => format!("{stem}_{number:04}.{extension}"),
        None => format!("{name}_{number:04}"),
    }
}

/// One line per frame: its time, and the nodes that ran.
fn table(all: &[Done]) -> String {
    let mut text =
        format!("{:>6} {:>9} {:>5} {:>5} {:>12}  ran\n", "frame", "seconds", "hits", "ran", "rays");
    for done in all {
        let ran = done.report.with_status(Status::Ran);
        let hits = done.hits;
        let rays: u64 = done.report.nodes.iter().map(|node| node.rays).sum();
        // The first frame may run everything: report.json lists its nodes.
        let names = if ran.len() > MOST_NAMES {
            format!("{} ..", ran[..MOST_NAMES].join(" "))
        } else {
            ran.join(" ")
        };
        let line = format!(
            "{:>6} {:>9.3} {hits:>5} {:>5} {rays:>12}  {names}",
            done.number,
            done.seconds,
            ran.len()
        );
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

const MOST_NAMES: usize = 12;

#[cfg(test)]
mod tests {
    use super::*;
    use relight::graph::{NodeReport, PortValue};

    #[test]
    fn a_frame_that_is_done_holds_no_picture_and_no_hit() {
        let node = |name: &str, status: Status| NodeReport {
            name: name.into(),
            kind: "Kind",
            status,
            seconds: 0.0,
            rays: 3,
            samples: None,
            stderr: None,
            bytes: 1,
            key: None,
            why: None,
            warnings: vec![format!("{name} is odd")],
            notes: vec![],
            error: None,
            bad_file: false,
        };
        let report = RunReport {
            nodes: vec![node("room", Status::Hit), node("picture", Status::Ran)],
            outputs: vec![("picture.files".into(), PortValue::Missing)],
            ..RunReport::default()
        };
        let done = Done::new(7, report, Instant::now(), vec![], vec![]);
        assert!(done.report.outputs.is_empty());
        assert_eq!(
            done.report.nodes.iter().map(|node| node.name.as_str()).collect::<Vec<_>>(),
            ["picture"]
        );
        assert_eq!((done.hits, done.warnings.len()), (1, 2));
    }
}
