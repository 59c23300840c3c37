//! The commands that compute no picture: `plan`, `explain`, `graph` and `nodes`.

use std::path::Path;

use relight::graph::{Diagnostic, PlanLine, Source};
use relight::nodes as stages;

use super::args::{Explain, Graph, GraphFormat, Nodes, Plan};
use super::engine::{engine, options};
use super::exit::{CliError, Exit};
use super::load::load;
use super::{provenance, reference, report, write};

/// Runs `relight plan`.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn plan(args: &Plan) -> Result<Exit, CliError> {
    let graph = load(&args.job.graph, args.job.edit.as_deref(), &args.job.files)?;
    let wanted = graph.wanted(args.only.as_ref().map(std::slice::from_ref))?;
    let options = options(&args.cache, &args.job.graph, args.job.files.scene.as_deref())?;
    let lines = engine(options)?.plan(&graph, &wanted);
    if args.json {
        write::print(&report::text(&lines))?;
        return Ok(Exit::Done);
    }
    let width = lines.iter().map(|line| line.node.chars().count()).max().unwrap_or(0);
    let line = |line: &PlanLine| {
        let text = format!(
            "{:7}  {:width$}  {}",
            line.status,
            line.node,
            line.why.as_deref().unwrap_or("")
        );
        text.trim_end().to_owned() + "\n"
    };
    write::print(&lines.iter().map(line).collect::<String>())?;
    Ok(Exit::Done)
}

/// Runs `relight explain`.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn explain(args: &Explain) -> Result<Exit, CliError> {
    let Explain { first, second, third, .. } = args;
    if is_picture(first) {
        let inputs = second.as_deref().map(|graph| (graph, third.as_deref().map(Path::new)));
        write::print(&provenance::explain(first, inputs, &args.files)?)?;
        return Ok(Exit::Done);
    }
    let (Some(edit), Some(node)) = (second, third) else {
        let fault = Diagnostic::file(first, "wanted GRAPH EDIT NODE, or a PNG or EXR picture");
        return Err(fault.help("relight explain graphs/demo.ron edits/lamp_off.ron mix").into());
    };
    let graph = load(first, Some(edit), &args.files)?;
    let options = options(&args.cache, first, args.files.scene.as_deref())?;
    let answer = engine(options)?.explain(&graph, node)?;
    let mut text = format!("{}: {}: {}\n", answer.node, answer.status, answer.why);
    for (sign, line) in [('-', &answer.old), ('+', &answer.new)] {
        if let Some(line) = line {
            text.push_str(&format!("{sign} {line}\n"));
        }
    }
    write::print(&text)?;
    Ok(Exit::Done)
}

fn is_picture(path: &Path) -> bool {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    ending.is_some_and(|ending| ending == "png" || ending == "exr")
}

/// Runs `relight graph`.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn graph(args: &Graph) -> Result<Exit, CliError> {
    if args.source {
        let source = Source::read(&args.job.graph, args.job.files.reach())?;
        write::print(&source.text)?;
        return Ok(Exit::Done);
    }
    let graph = load(&args.job.graph, args.job.edit.as_deref(), &args.job.files)?;
    write::print(&match args.format {
        GraphFormat::Dot => graph.to_dot(None),
        GraphFormat::Mermaid => graph.to_mermaid(None),
        GraphFormat::Svg => graph.to_svg(None),
        GraphFormat::Json => graph.to_json(None),
    })?;
    Ok(Exit::Done)
}

/// Runs `relight nodes`.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn nodes(args: &Nodes) -> Result<Exit, CliError> {
    let registry = stages::registry();
    let text = match &args.kind {
        _ if args.markdown => reference::page(&registry),
        _ if args.tuning => reference::tuning(&relight::nodes::tuning()),
        None => reference::list(&registry),
        Some(kind) => {
            let spec = registry.get(kind).ok_or_else(|| {
                let fault = Diagnostic::file("".as_ref(), format!("unknown stage `{kind}`"));
                fault.suggest(kind, registry.kinds().map(|spec| spec.kind))
            })?;
            reference::section(spec)
        }
    };
    write::print(&text)?;
    Ok(Exit::Done)
}
