//! `relight export`: the room for other programs.

use std::path::Path;

use relight::graph::{Cancel, Fault, Node};
use relight::nodes::output::write_usd::{TEXT, WriteUsd};

use super::args::Export;
use super::progress::Progress;
use super::run::{results, stop_on_ctrl_c};
use super::{Exit, Stop, Trouble, ended, engine, finished, load::load, options, report, terminal, write};

pub fn export(args: &Export, verbose: u8) -> Result<Exit, Trouble> {
    ended(written(args, verbose))
}

fn written(args: &Export, verbose: u8) -> Result<(), Stop> {
    let graph = load(&args.job.graph, args.job.edit.as_deref(), &args.job.files)?;
    let Some(node) = graph.of_kind(WriteUsd::KIND).next() else {
        let fault = Fault::file(&args.job.graph, format!("wanted a graph with a stage {}, got none", WriteUsd::KIND));
        return Err(fault.help("graphs/physics.ron and all that extend it have one").into());
    };
    let wanted = graph.wanted(Some(&[node.to_owned()]))?;
    let folder = args.out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    write::folder(folder)?; // told before the work, not after it
    let cancel = Cancel::default();
    stop_on_ctrl_c(&cancel)?;
    let progress = Progress::new(verbose > 0, terminal());
    let done = engine(options(&args.cache))?.run(&graph, &wanted, &cancel, &progress);
    progress.end();
    let done = finished(done)?;
    report::warnings(&done).iter().for_each(|warning| eprintln!("warning: {warning}"));
    for (name, bytes) in results(&done).iter().flat_map(|files| &files.0) {
        let name =
            if name == TEXT { args.out.file_name().map_or(name.into(), |n| n.to_string_lossy()) } else { name.into() };
        write::print(&format!("{}\n", write::file(folder, &name, bytes)?.display()))?;
    }
    Ok(())
}
