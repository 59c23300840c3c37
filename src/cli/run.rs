//! `relight run`.

use std::time::Instant;

use relight::graph::Diagnostic;

use super::args::RunArgs;
use super::exit::{CliError, Exit};
use super::load::{load, load_all};
use super::{frames, picture};

/// Runs `relight run`.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn run(args: &RunArgs, verbose: u8, began: Instant) -> Result<Exit, CliError> {
    let Some(edit) = &args.edit else {
        return picture::run(args, load(&args.graph, None, &args.files)?, verbose, began);
    };
    let mut pictures = load_all(&args.graph, edit, &args.files)?;
    let Some(numbers) = pictures.frames.clone() else {
        return picture::run(args, pictures.first, verbose, began);
    };
    if args.report {
        let fault =
            Diagnostic::file(edit, "--report: wanted an edit of one picture, got one of frames");
        return Err(fault
            .help("with --exr, `relight mix` weights the lights of each frame")
            .into());
    }
    frames::run(args, &mut pictures, numbers, verbose, began)
}
