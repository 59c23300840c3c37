//! `relight export`: the room for other programs.

use std::collections::BTreeSet;
use std::io::{Cursor, Write};
use std::path::Path;

use relight::graph::{Cancel, Diagnostic, Node, ResolvedGraph};
use relight::nodes::output::write_usd::{TEXT, TEXTURE, UsdFrames, WriteUsd};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use super::args::Export;
use super::engine::{engine, finished, options, stop_on_ctrl_c};
use super::exit::{CliError, Exit, Stop, ended};
use super::load::{Loaded, load_run};
use super::messages::{message, shows_progress};
use super::progress::Progress;
use super::report;
use super::results;
use super::write::{self, Output};

/// Runs `relight export`.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn export(args: &Export, verbose: u8) -> Result<Exit, CliError> {
    ended(written(args, verbose))
}

fn written(args: &Export, verbose: u8) -> Result<(), Stop> {
    let job = &args.job;
    let mut loaded = load_run(&job.graph, job.edit.as_deref(), &job.files)?;
    let graph = loaded.graph();
    let Some(node) = graph.of_kind(WriteUsd::KIND).next().map(str::to_owned) else {
        let fault = Diagnostic::file(
            &job.graph,
            format!("wanted a graph with a stage {}, got none", WriteUsd::KIND),
        );
        return Err(fault.help("graphs/physics.ron and all that extend it have one").into());
    };
    let folder =
        args.out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // This check comes before the work.
    let out = Output::of_graph(folder, graph, job.edit.as_deref(), args.force)?;
    let options = options(&args.cache, &job.graph, job.files.scene.as_deref())?;
    let cancel = Cancel::default();
    stop_on_ctrl_c(&cancel)?;
    let engine = engine(options)?;
    let room = |graph: &ResolvedGraph| {
        let wanted = graph.wanted(Some(std::slice::from_ref(&node)))?;
        let progress = Progress::new(verbose > 0, shows_progress());
        let done = engine.run(graph, &wanted, &cancel, &progress);
        progress.end();
        finished(done)
    };
    let done = room(graph)?;
    let mut warnings = report::warnings(&done);
    let mut files = results::files(&done);
    if let Loaded::Frames(pictures, numbers) = &mut loaded {
        let mut frames = UsdFrames::new(numbers.start, text_of(&files));
        let mut texture = (TEXTURE.to_owned(), albedo_of(&files));
        for number in numbers.skip(1) {
            let done = room(&pictures.graph(number)?)?;
            warnings.extend(report::warnings(&done));
            let frame = results::files(&done);
            // Paint that changes over time: a texture for each frame.
            let albedo = albedo_of(&frame);
            if albedo != texture.1 {
                texture = (TEXTURE.replace(".png", &format!("_{number:04}.png")), albedo);
                files.push(texture.clone());
            }
            frames.add(&text_of(&frame).replace(TEXTURE, &texture.0));
        }
        let text = files.iter_mut().find(|(name, _)| name == TEXT);
        text.expect("WriteUsd writes its text").1 = frames.text(args.fps).into_bytes();
    }
    let mut told = BTreeSet::new();
    warnings.retain(|warning| told.insert(warning.clone()));
    warnings.iter().for_each(|warning| message!("warning: {warning}"));
    let files = match args.out.extension().is_some_and(|ending| ending == "usdz") {
        true => vec![(file_name(&args.out), package(&files))],
        false => renamed(files, &args.out),
    };
    write::print_paths(&out.write(&files)?)?;
    Ok(())
}

fn text_of(files: &[(String, Vec<u8>)]) -> &str {
    let text = files.iter().find(|(name, _)| name == TEXT);
    text.and_then(|(_, bytes)| std::str::from_utf8(bytes).ok()).expect("WriteUsd writes its text")
}

fn albedo_of(files: &[(String, Vec<u8>)]) -> Vec<u8> {
    let albedo = files.iter().find(|(name, _)| name == TEXTURE);
    albedo.map(|(_, bytes)| bytes.clone()).unwrap_or_default()
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
    let stem = text.strip_suffix(".usda").unwrap_or(&text).to_owned();
    let own = TEXT.strip_suffix(".usda").unwrap_or(TEXT);
    let rename = |(name, bytes): (String, Vec<u8>)| match name.strip_prefix(own) {
        _ if name == TEXT => {
            let usda = String::from_utf8(bytes).expect("USD text is UTF-8");
            let usda = usda.replace(&format!("@./{own}_"), &format!("@./{stem}_"));
            (text.clone(), usda.into_bytes())
        }
        Some(rest) => (format!("{stem}{rest}"), bytes),
        None => (name, bytes),
    };
    files.into_iter().map(rename).collect()
}
