//! `relight run`: once, or with `--watch` after each change of its files.

pub mod preview;

use std::path::PathBuf;
use std::time::Instant;

use relight::graph::{Diagnostic, GraphFile};

use super::args::RunArgs;
use super::engine::Host;
use super::exit::{CliError, Exit};
use super::load::{Loaded, load_run};
use super::messages::message;
use super::results::engine_options;
use super::watch::Watch;
use super::{frames, picture};

use preview::preview;

/// Memory for results that no running node needs, bytes, in a run that no other follows: results of
/// the working size are used more than once, and those of a large photo come back from the disk.
const MEMORY_OF_ONE: u64 = 64 << 20;

/// Runs `relight run`.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn run(args: &RunArgs, verbose: u8, began: Instant) -> Result<Exit, CliError> {
    if args.watch {
        return watch(args, verbose, began);
    }
    let loaded = read(args)?;
    let mut options = engine_options(args)?;
    if matches!(loaded, Loaded::Picture(..)) && options.cache.is_some() {
        options.memory_bytes = MEMORY_OF_ONE;
    }
    run_once(loaded, args, &Host::new(options)?, verbose, began)
}

/// Reads the files of a run.
fn read(args: &RunArgs) -> Result<Loaded, Vec<Diagnostic>> {
    let loaded = load_run(&args.graph, args.edit.as_deref(), &args.files)?;
    if let (Loaded::Frames(..), Some(edit), true) = (&loaded, &args.edit, args.report) {
        let fault = "--report: wanted an edit of one picture, got one of frames";
        let help = "with --exr, `relight mix` weights the lights of each frame";
        return Err(vec![Diagnostic::file(edit, fault).help(help)]);
    }
    Ok(loaded)
}

fn run_once(
    loaded: Loaded,
    args: &RunArgs,
    host: &Host,
    verbose: u8,
    began: Instant,
) -> Result<Exit, CliError> {
    match loaded {
        Loaded::Picture(graph, edit) => {
            if args.preview {
                preview(args, host, began)?;
            }
            picture::run(args, (&graph, edit.as_deref()), host, verbose, began)
        }
        Loaded::Frames(mut pictures, numbers) => {
            frames::run(args, &mut pictures, numbers, host, verbose, began)
        }
    }
}

/// Runs again after each change, on one engine, until Ctrl-C; shows errors and waits.
fn watch(args: &RunArgs, verbose: u8, mut began: Instant) -> Result<Exit, CliError> {
    let host = Host::new(engine_options(args)?)?;
    let mut watch = Watch::default();
    loop {
        watch.set(args.edit.iter().chain([&args.graph]).cloned().collect());
        match read(args) {
            Ok(loaded) => {
                watch.add(loaded.graph().inputs());
                if let Err(error) = run_once(loaded, args, &host, verbose, began) {
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
