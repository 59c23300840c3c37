//! `relight export`: the room for other programs.

use std::io::{Cursor, Write};
use std::path::Path;

use relight::graph::{Cancel, Diagnostic, Node};
use relight::nodes::output::write_usd::{TEXT, TEXTURE, WriteUsd};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use super::args::Export;
use super::engine::{engine, finished, options, stop_on_ctrl_c};
use super::exit::{CliError, Exit, Stop, ended};
use super::load::load;
use super::messages::{message, shows_progress};
use super::progress::Progress;
use super::report;
use super::results::results;
use super::write::{self, Output};

/// Runs `relight export`.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn export(args: &Export, verbose: u8) -> Result<Exit, CliError> {
    ended(written(args, verbose))
}

fn written(args: &Export, verbose: u8) -> Result<(), Stop> {
    let graph = load(&args.job.graph, args.job.edit.as_deref(), &args.job.files)?;
    let Some(node) = graph.of_kind(WriteUsd::KIND).next() else {
        let fault = Diagnostic::file(
            &args.job.graph,
            format!("wanted a graph with a stage {}, got none", WriteUsd::KIND),
        );
        return Err(fault.help("graphs/physics.ron and all that extend it have one").into());
    };
    let wanted = graph.wanted(Some(&[node.to_owned()]))?;
    let folder =
        args.out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // This check comes before the work.
    let out = Output::of_graph(folder, &graph, args.job.edit.as_deref(), args.force)?;
    let options = options(&args.cache, &args.job.graph, args.job.files.scene.as_deref())?;
    let cancel = Cancel::default();
    stop_on_ctrl_c(&cancel)?;
    let progress = Progress::new(verbose > 0, shows_progress());
    let done = engine(options)?.run(&graph, &wanted, &cancel, &progress);
    progress.end();
    let done = finished(done)?;
    report::warnings(&done).iter().for_each(|warning| message!("warning: {warning}"));
    let files: Vec<_> = results(&done).iter().flat_map(|(_, files)| files.0.clone()).collect();
    let files = match args.out.extension().is_some_and(|ending| ending == "usdz") {
        true => vec![(file_name(&args.out), package(&files))],
        false => renamed(files, &args.out),
    };
    write::print_paths(&out.write(&files)?)?;
    Ok(())
}

fn file_name(out: &Path) -> String {
    out.file_name().map_or(TEXT.into(), |name| name.to_string_lossy().into_owned())
}

/// The files as a USDZ package: a ZIP archive without compression, the text first, the content of
/// each file at a multiple of 64 bytes (<https://openusd.org/release/spec_usdz.html>).
fn package(files: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .with_alignment(64)
        .last_modified_time(DateTime::default());
    let text = files.iter().filter(|(name, _)| name == TEXT);
    let others = files.iter().filter(|(name, _)| name != TEXT);
    for (name, bytes) in text.chain(others) {
        let written = archive.start_file(name, stored).map(|()| archive.write_all(bytes));
        written.expect("names are plain").expect("memory takes all bytes");
    }
    archive.finish().expect("memory takes all bytes").into_inner()
}

/// Renames the files after `out`: NAME.usda and NAME_albedo.png, so that several scenes fit into
/// one folder.
fn renamed(files: Vec<(String, Vec<u8>)>, out: &Path) -> Vec<(String, Vec<u8>)> {
    let text = file_name(out);
    let texture = format!("{}_albedo.png", text.strip_suffix(".usda").unwrap_or(&text));
    let rename = |(name, bytes): (String, Vec<u8>)| match &*name {
        TEXT => {
            let reference = |texture: &str| format!("@./{texture}@");
            let usda = String::from_utf8(bytes).expect("USD text is UTF-8");
            (text.clone(), usda.replace(&reference(TEXTURE), &reference(&texture)).into_bytes())
        }
        TEXTURE => (texture.clone(), bytes),
        _ => (name, bytes),
    };
    files.into_iter().map(rename).collect()
}
