//! `relight run`: once, or with `--watch` after each change of its files.

pub mod preview;

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::PathBuf;
use std::time::Instant;

use relight::graph::{Diagnostic, GraphFile, ResolvedGraph};

use super::args::RunArgs;
use super::engine::Host;
use super::exit::{CliError, Exit};
use super::load::{Pictures, load, load_all};
use super::messages::message;
use super::results::engine_options;
use super::watch::Watch;
use super::{frames, picture};

use preview::preview;

/// Runs `relight run`.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn run(args: &RunArgs, verbose: u8, began: Instant) -> Result<Exit, CliError> {
    if args.watch {
        return watch(args, verbose, began);
    }
    let job = Job::load(args)?;
    job.run(args, &Host::new(engine_options(args)?)?, verbose, began)
}

/// The files of a run, read.
enum Job {
    /// One picture, and the text of its edit.
    Picture(ResolvedGraph, Option<String>),
    Frames(Box<Pictures>, Range<u32>),
}

impl Job {
    fn load(args: &RunArgs) -> Result<Job, Vec<Diagnostic>> {
        let Some(edit) = &args.edit else {
            return Ok(Job::Picture(load(&args.graph, None, &args.files)?, None));
        };
        let pictures = load_all(&args.graph, edit, &args.files)?;
        let Some(numbers) = pictures.frames.clone() else {
            let edit = pictures.text().to_owned();
            return Ok(Job::Picture(pictures.first, Some(edit)));
        };
        if args.report {
            let fault = "--report: wanted an edit of one picture, got one of frames";
            let help = "with --exr, `relight mix` weights the lights of each frame";
            return Err(vec![Diagnostic::file(edit, fault).help(help)]);
        }
        Ok(Job::Frames(Box::new(pictures), numbers))
    }

    fn run(
        self,
        args: &RunArgs,
        host: &Host,
        verbose: u8,
        began: Instant,
    ) -> Result<Exit, CliError> {
        match self {
            Job::Picture(graph, edit) => {
                if args.preview {
                    preview(args, host, began)?;
                }
                picture::run(args, (&graph, edit.as_deref()), host, verbose, began)
            }
            Job::Frames(mut pictures, numbers) => {
                frames::run(args, &mut pictures, numbers, host, verbose, began)
            }
        }
    }

    /// The files whose change makes another run.
    fn inputs(&self) -> BTreeSet<PathBuf> {
        match self {
            Job::Picture(graph, _) => graph.inputs(),
            Job::Frames(pictures, _) => pictures.first.inputs(),
        }
    }
}

/// Runs again after each change, on one engine, until Ctrl-C; shows errors and waits.
fn watch(args: &RunArgs, verbose: u8, mut began: Instant) -> Result<Exit, CliError> {
    let host = Host::new(engine_options(args)?)?;
    let mut watch = Watch::default();
    loop {
        watch.set(args.edit.iter().chain([&args.graph]).cloned().collect());
        match Job::load(args) {
            Ok(job) => {
                watch.add(job.inputs());
                if let Err(error) = job.run(args, &host, verbose, began) {
                    error.report();
                }
            }
            Err(faults) => {
                CliError::from(faults).report();
                // The cause may be a file of the scene that is missing so far.
                watch.add(scene_of(args).map(|scene| scene.join("scene.ron")));
                watch.add_folder(scene_of(args), &args.out);
            }
        }
        if !host.cancel.is_cancelled() {
            message!("waiting for a change of the files; Ctrl-C ends");
        }
        let changed = watch.wait(&|| host.cancel.is_cancelled());
        if changed.is_empty() {
            return Ok(Exit::Interrupted);
        }
        let names: Vec<String> = changed.iter().map(|path| path.display().to_string()).collect();
        message!("changed: {}", names.join(", "));
        began = Instant::now();
    }
}

/// The folder of the scene, where arguments or graph name one.
fn scene_of(args: &RunArgs) -> Option<PathBuf> {
    args.files.scene.clone().or_else(|| {
        GraphFile::read_within(&args.graph, args.files.reach()).ok()?.scene().ok().flatten()
    })
}
