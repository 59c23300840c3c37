//! One job: a picture, or frames, on the engine of its photo.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::Instant;

use image::ImageFormat;
use relight::graph::{Diagnostic, ResolvedGraph, RunReport};

use super::args::BatchArgs;
use super::list::{Job, List};
use super::state::{State, Status};
use crate::cli::args::{RunArgs, SceneFiles};
use crate::cli::engine::Host;
use crate::cli::exit::{CliError, Exit};
use crate::cli::frames;
use crate::cli::load::{Loaded, Pictures, load_run};
use crate::cli::picture::{Told, write_all};
use crate::cli::report::Head;
use crate::cli::results::results;
use crate::cli::write::Output;

/// Longer side of the small picture of a result, pixels.
const THUMBNAIL: u32 = 320;

/// The files of the last job of a photo, if it was a film: its chunks follow each other.
#[derive(Default)]
pub struct Last {
    frames: Option<(RunArgs, Box<Pictures>)>,
}

/// Files of a job, read.
enum Files<'a> {
    /// One picture, and the text of its edit.
    Picture(Box<ResolvedGraph>, Option<String>),
    Frames(&'a mut Pictures),
}

/// Runs a job unless it is done; returns its state, and whether it was done before.
pub fn run(
    (args, list, job): (&BatchArgs, &List, &Job),
    host: &Host,
    last: &mut Last,
) -> (State, bool) {
    let began = Instant::now();
    let work = || attempt((args, list, job), host, last, began);
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(ended)) => ended,
        Ok(Err((inputs, error))) => {
            let cause = error.text().trim_start_matches("error: ").trim_end().to_owned();
            (State::failed(inputs, cause, began.elapsed().as_secs_f64()), false)
        }
        Err(_) => {
            *last = Last::default();
            let cause = "a bug in relight: the job panicked".to_owned();
            (State::failed(String::new(), cause, began.elapsed().as_secs_f64()), false)
        }
    }
}

fn attempt(
    (args, list, job): (&BatchArgs, &List, &Job),
    host: &Host,
    last: &mut Last,
    began: Instant,
) -> Result<(State, bool), (String, CliError)> {
    let run_args = run_args(args, list, job);
    let bare = |error: CliError| (String::new(), error);
    let mut files = last.of(&run_args, job).map_err(bare)?;
    let (graph, edit) = match &files {
        Files::Picture(graph, edit) => (&**graph, edit.as_deref()),
        Files::Frames(pictures) => (&pictures.first, Some(pictures.text())),
    };
    let inputs = inputs(graph, edit).map_err(|fault| bare(fault.into()))?;
    if !args.again
        && let Some(state) = State::read(&list.out, job)
        && state.is_done(&list.out, job, &inputs)
    {
        return Ok((state, true));
    }
    let with = |error: CliError| (inputs.clone(), error);
    let folder = Output::of_graph(&run_args.out, graph, job.edit.as_deref(), false);
    let folder = folder.map_err(|fault| with(fault.into()))?;
    let state = match &mut files {
        Files::Picture(graph, edit) => {
            picture(&run_args, (graph, edit.as_deref()), host, &folder, began)
        }
        Files::Frames(pictures) => film(&run_args, job, pictures, host, &folder, began),
    };
    let state = state.map_err(with)?;
    Ok((State { inputs, ..state }, false))
}

/// Digest of all that decides the results of a job: of a sequence, the graph of its first frame and
/// the text of the edit.
fn inputs(graph: &ResolvedGraph, edit: Option<&str>) -> Result<String, Diagnostic> {
    let mut hasher = blake3::Hasher::new();
    hasher.update(env!("CARGO_PKG_VERSION").as_bytes());
    hasher.update(graph.digest(&graph.wanted(None)?).to_string().as_bytes());
    hasher.update(edit.unwrap_or_default().as_bytes());
    Ok(hasher.finalize().to_string())
}

/// The run of one picture that gives the same files.
fn run_args(args: &BatchArgs, list: &List, job: &Job) -> RunArgs {
    let files = SceneFiles {
        scene: Some(job.scene.clone()),
        set: job.set.clone(),
        confined: args.confined,
        networks: args.networks.clone(),
        ..SceneFiles::default()
    };
    RunArgs {
        graph: list.graph.clone(),
        edit: job.edit.clone(),
        files,
        out: list.out.join(&job.out),
        ..RunArgs::default()
    }
}

impl Last {
    fn of(&mut self, args: &RunArgs, job: &Job) -> Result<Files<'_>, CliError> {
        let is_same = |(before, _): &(RunArgs, Box<Pictures>)| {
            (&before.edit, &before.files.scene, &before.files.set)
                == (&args.edit, &args.files.scene, &args.files.set)
        };
        if !self.frames.as_ref().is_some_and(is_same) {
            self.frames = None;
            match load_run(&args.graph, args.edit.as_deref(), &args.files)? {
                Loaded::Picture(graph, edit) => return Ok(Files::Picture(graph, edit)),
                Loaded::Frames(pictures, _) => self.frames = Some((args.clone(), pictures)),
            }
        }
        let (_, pictures) = self.frames.as_mut().expect("it was just set");
        let length = pictures.frames.as_ref().map_or(0, |frames| frames.end);
        match &job.frames {
            Some(frames) if frames.end > length => {
                let message = format!(
                    "wanted frames from 0 to {}, got {} to {}",
                    length - 1,
                    frames.start,
                    frames.end - 1
                );
                let edit = args.edit.as_deref().unwrap_or(Path::new(""));
                Err(Diagnostic::file(edit, message).into())
            }
            _ => Ok(Files::Frames(pictures)),
        }
    }
}

fn picture(
    args: &RunArgs,
    (graph, edit): (&ResolvedGraph, Option<&str>),
    host: &Host,
    out: &Output,
    began: Instant,
) -> Result<State, CliError> {
    let wanted = graph.wanted(None)?;
    let done = host.engine.run(graph, &wanted, &host.cancel, &());
    let told = Told::new(args, graph, &host.engine, &done, began)?;
    let mut files = Vec::new();
    let mut small = None;
    if done.is_complete() {
        write_all(args, out, (graph, edit, &done), &told.json)?;
        let results = results(&done);
        let named = || results.iter().flat_map(|(_, files)| &files.0);
        files.extend(named().map(|(name, _)| name.clone()).chain(["report.json".to_owned()]));
        small =
            named().find(|(name, _)| name.ends_with(".png")).and_then(|(_, png)| thumbnail(png));
    }
    let thumbnail = write_thumbnail(out, "thumbnail.jpg", small);
    let rays = done.nodes.iter().map(|node| node.rays).sum();
    let hits = done.with_status(relight::graph::Status::Hit).len();
    let ran = done.with_status(relight::graph::Status::Ran).len();
    let seconds = began.elapsed().as_secs_f64();
    let (status, cause) = ending(&done);
    let warnings = told.warnings;
    let inputs = String::new();
    Ok(State { status, inputs, cause, seconds, rays, ran, hits, warnings, files, thumbnail })
}

fn film(
    args: &RunArgs,
    job: &Job,
    pictures: &mut Pictures,
    host: &Host,
    out: &Output,
    began: Instant,
) -> Result<State, CliError> {
    let all = pictures.frames.clone().unwrap_or(0..1);
    let numbers = job.frames.clone().unwrap_or(all);
    let (done, backend) =
        frames::compute(args, pictures, numbers.clone(), (host, Some(out)), None)?;
    let warnings = frames::warnings(&done);
    let threads = host.engine.threads();
    let head = Head::new(&args.graph, args.edit.as_deref(), began, backend, threads);
    let json = frames::json(head, &done, None, &warnings);
    let report = format!("report{}.json", job.suffix());
    out.file(&report, json.as_bytes())?;
    let mut files: Vec<String> = done.iter().flat_map(|done| done.files.clone()).collect();
    let first = files.iter().find(|name| name.ends_with(".png"));
    let small = first.and_then(|name| std::fs::read(args.out.join(name)).ok());
    let small = small.and_then(|png| thumbnail(&png));
    let thumbnail = write_thumbnail(out, &format!("thumbnail{}.jpg", job.suffix()), small);
    files.push(report);
    let nodes = || done.iter().flat_map(|done| &done.report.nodes);
    let ran = nodes().filter(|node| node.status == relight::graph::Status::Ran).count();
    let (status, cause) = match done.last() {
        Some(last) => ending(&last.report),
        None => (Status::Done, None),
    };
    Ok(State {
        status,
        inputs: String::new(),
        cause,
        seconds: began.elapsed().as_secs_f64(),
        rays: nodes().map(|node| node.rays).sum(),
        ran,
        hits: done.iter().map(|done| done.hits).sum(),
        warnings,
        files,
        thumbnail,
    })
}

fn ending(done: &RunReport) -> (Status, Option<String>) {
    match Exit::of(done) {
        Exit::Done => (Status::Done, None),
        Exit::Interrupted => (Status::Interrupted, None),
        Exit::Failed | Exit::Bad => {
            let error = done.error().map(|(node, error)| format!("{node}: {error}"));
            (Status::Failed, error)
        }
    }
}

/// A small JPEG of a picture of the program's own; `None` where it cannot be made, which costs the
/// page a picture and nothing else.
fn thumbnail(png: &[u8]) -> Option<Vec<u8>> {
    let picture = image::load_from_memory_with_format(png, ImageFormat::Png).ok()?;
    let small = picture.thumbnail(THUMBNAIL, THUMBNAIL).into_rgb8();
    let mut jpeg = std::io::Cursor::new(Vec::new());
    small.write_to(&mut jpeg, ImageFormat::Jpeg).ok()?;
    Some(jpeg.into_inner())
}

fn write_thumbnail(out: &Output, name: &str, small: Option<Vec<u8>>) -> Option<String> {
    let written = out.file(name, &small?).ok()?;
    Path::new(&written).file_name().map(|name| name.to_string_lossy().into_owned())
}
