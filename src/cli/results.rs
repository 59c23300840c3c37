//! The results of `relight run`: where they go, and who computed them.

use std::sync::Arc;

use relight::graph::{Diagnostic, EngineOptions, PortValue, ResolvedGraph, RunReport};
use relight::nodes::artifacts::Files;

use super::args::RunArgs;
use super::write::Output;
use super::{engine, networks};

/// Options of the engine for a run.
///
/// # Errors
/// A named key file cannot be used.
pub fn engine_options(args: &RunArgs) -> Result<EngineOptions, Diagnostic> {
    let threads = args.threads.map(usize::from);
    let options = engine::options(&args.cache, &args.graph, args.files.scene.as_deref())?;
    Ok(EngineOptions { threads, budget: args.budget, ..options })
}

/// The folder for the results of a run; none with `--verify`, which only compares.
///
/// # Errors
/// The folder cannot be made.
pub fn output(args: &RunArgs, graph: &ResolvedGraph) -> Result<Option<Output>, Diagnostic> {
    let output = || Output::of_graph(&args.out, graph, args.edit.as_deref(), args.force);
    (!args.verify).then(output).transpose()
}

/// The backend of the networks of a run; none where no node has a network.
///
/// # Errors
/// A named library cannot be used.
pub fn backend_of(args: &RunArgs, run: &RunReport) -> Result<Option<networks::Choice>, Diagnostic> {
    let registry = networks::registry(&args.files.networks);
    let has_network = run.nodes.iter().any(|node| networks::has_network(&registry, node.kind));
    has_network.then(|| networks::choose(&args.files.networks)).transpose()
}

/// The files of a run, by name.
pub fn files(run: &RunReport) -> Vec<(String, Vec<u8>)> {
    results(run).iter().flat_map(|(_, files)| files.0.clone()).collect()
}

/// The files among the outputs of a run, by output.
pub fn results(run: &RunReport) -> Vec<(String, Arc<Files>)> {
    let values = run.outputs.iter().flat_map(|(output, value)| {
        let values = match value {
            PortValue::One(value) => vec![value],
            PortValue::Many(values) => values.iter().map(|(_, value)| value).collect(),
            PortValue::Missing => Vec::new(),
        };
        values.into_iter().map(move |value| (output, value))
    });
    values.filter_map(|(output, value)| Some((output.clone(), value.get()?))).collect()
}
