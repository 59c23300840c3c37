//! `relight run` of an edit with `frames`: one picture after the other by one engine, so that each runs only what it changes.
//!
//! A frame that the cache knows is taken from there and costs next to nothing: so a sequence that was stopped goes on where it was.

use std::time::Instant;

use relight::graph::{Cancel, RunReport, Status};
use serde::Serialize;

use super::args::Run;
use super::load::Pictures;
use super::messages::message;
use super::progress::FrameProgress;
use super::report::{self, Head, Row};
use super::run::{backend_of, engine_options, exit, output, results, stop_on_ctrl_c, tell_errors};
use super::write::{self, Output};
use super::{Exit, Trouble, engine, film, terminal};

/// report.json of a sequence.
#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    head: Head,
    frames: Vec<FrameRow<'a>>,
    film: Option<String>,
    warnings: Vec<String>,
}

#[derive(Serialize)]
struct FrameRow<'a> {
    frame: u32,
    seconds: f64,
    files: &'a [String],
    /// That of the node that wrote it.
    key: Option<String>,
    hits: usize,
    /// All that are no hits.
    nodes: Vec<Row<'a>>,
}

/// What became of one frame.
struct Done {
    number: u32,
    report: RunReport,
    seconds: f64,
    files: Vec<String>,
    differences: Vec<String>,
}

impl Done {
    /// The key of the node that gave the first output.
    fn key(&self) -> Option<String> {
        let (output, _) = self.report.outputs.first()?;
        let name = output.split_once('.').map_or(output.as_str(), |(node, _)| node);
        let node = self.report.nodes.iter().find(|node| node.name == name)?;
        node.key.map(|key| key.to_string())
    }
}

pub fn run(args: &Run, pictures: &Pictures, verbose: u8, began: Instant) -> Result<Exit, Trouble> {
    let engine = engine(engine_options(args)?)?;
    let wanted = match &args.only {
        Some(only) => Some(vec![only.clone()]),
        None if args.exr || pictures.writers.is_empty() => None,
        None => Some(pictures.writers.clone()),
    };
    pictures.frames[0].graph.wanted(wanted.as_deref())?;
    let out = output(args, &pictures.frames[0].graph)?;
    let cancel = Cancel::default();
    stop_on_ctrl_c(&cancel)?;
    let progress = FrameProgress::new(pictures.frames.len(), verbose > 0, terminal());
    let mut all: Vec<Done> = Vec::new();
    for frame in &pictures.frames {
        let started = Instant::now();
        let number = frame.number.expect("a sequence has numbered frames");
        progress.frame(number);
        let needed = frame.graph.wanted(wanted.as_deref())?;
        let (report, differences) = if args.verify {
            let verified = engine.verify(&frame.graph, &needed, &cancel, &progress);
            let told = verified.differences.into_iter().map(|d| format!("{}.{}", d.node, d.port));
            (verified.run, told.collect())
        } else {
            (engine.run(&frame.graph, &needed, &cancel, &progress), Vec::new())
        };
        let mut files = Vec::new();
        if report.is_complete()
            && let Some(out) = &out
        {
            let results = results(&report);
            let named = results.iter().flat_map(|files| &files.0).map(|(name, bytes)| (numbered(name, number), bytes));
            let named: Vec<_> = named.collect();
            out.write(&named)?;
            files.extend(named.into_iter().map(|(name, _)| name));
        }
        let done = Done { number, report, seconds: started.elapsed().as_secs_f64(), files, differences };
        progress.done(number, done.seconds, done.report.with_status(Status::Ran).len());
        let whole = done.report.is_complete();
        all.push(done);
        if !whole {
            break;
        }
    }
    progress.end();
    tell(args, pictures, &all, out.as_ref(), engine.threads(), began)
}

/// Film, report and what is said at the end.
fn tell(
    args: &Run,
    pictures: &Pictures,
    all: &[Done],
    out: Option<&Output>,
    threads: usize,
    began: Instant,
) -> Result<Exit, Trouble> {
    let last = all.last().expect("a sequence has a frame");
    let whole = all.len() == pictures.frames.len() && last.report.is_complete();
    let mut warnings: Vec<String> = Vec::new();
    for warning in all.iter().flat_map(|done| report::warnings(&done.report)) {
        if !warnings.contains(&warning) {
            warnings.push(warning);
        }
    }
    let mut paths: Vec<_> = all.iter().flat_map(|done| &done.files).map(|name| args.out.join(name)).collect();
    let has_pictures = all.iter().all(|done| done.files.contains(&numbered("picture.png", done.number)));
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
    let choice = backend_of(args, &all[0].report)?;
    let backend = choice.as_ref().map(|choice| choice.backend.to_string());
    let frames = all.iter().map(|done| FrameRow {
        frame: done.number,
        seconds: done.seconds,
        files: &done.files,
        key: done.key(),
        hits: done.report.with_status(Status::Hit).len(),
        nodes: report::rows(&done.report).filter(|row| row.status != Status::Hit).collect(),
    });
    let report = Report {
        head: Head::new(&args.graph, &args.edit, began, backend, threads),
        frames: frames.collect(),
        film,
        warnings,
    };
    let json = report::text(&report);
    if let Some(out) = out {
        paths.push(out.file("report.json", json.as_bytes())?);
    }
    message!("{}", table(all).trim_end());
    report.warnings.iter().for_each(|warning| message!("warning: {warning}"));
    tell_errors(&last.report);
    for (done, what) in all.iter().flat_map(|done| done.differences.iter().map(move |what| (done, what))) {
        message!("error: {what}: made again in frame {}, it came out differently", done.number);
    }
    let made = all.iter().filter(|done| done.report.is_complete()).count();
    message!("{made} of {} frames in {:.2} s", pictures.frames.len(), report.head.seconds);
    if last.report.cancelled() {
        message!("stopped in frame {}; the same command goes on there", last.number);
    }
    if args.json {
        write::print(&json)?;
    } else {
        write::print_paths(&paths)?;
    }
    Ok(exit(&last.report, all.iter().all(|done| done.differences.is_empty())))
}

/// `picture.png` -> `picture_0012.png`
fn numbered(name: &str, number: u32) -> String {
    match name.rsplit_once('.') {
        Some((stem, extension)) => format!("{stem}_{number:04}.{extension}"),
        None => format!("{name}_{number:04}"),
    }
}

/// One line per frame: how long it took, and what ran.
fn table(all: &[Done]) -> String {
    let mut text = format!("{:>6} {:>9} {:>5} {:>5} {:>12}  ran\n", "frame", "seconds", "hits", "ran", "rays");
    for done in all {
        let ran = done.report.with_status(Status::Ran);
        let hits = done.report.with_status(Status::Hit).len();
        let rays: u64 = done.report.nodes.iter().map(|node| node.rays).sum();
        // The first frame may run everything: its nodes stand in report.json.
        let names = if ran.len() > MOST_NAMES { format!("{} ..", ran[..MOST_NAMES].join(" ")) } else { ran.join(" ") };
        let line = format!("{:>6} {:>9.3} {hits:>5} {:>5} {rays:>12}  {names}", done.number, done.seconds, ran.len());
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

const MOST_NAMES: usize = 12;
