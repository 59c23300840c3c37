//! Graph, scene, edit and settings into one graph that is ready to run.

use std::path::Path;

use relight::files::{edit, scene};
use relight::graph::{Fault, Graph, GraphFile, Overlay, Raw, Registry, Setting, Source, Target, is_name};

use super::args::Files;
use super::networks;

/// Reads everything; all faults of all files come at once.
pub fn load(graph: &Path, edit: Option<&Path>, files: &Files) -> Result<Graph, Vec<Fault>> {
    let mut faults = Vec::new();
    let file = keep(GraphFile::read(graph), &mut faults);
    let folder = files.scene.clone().or_else(|| file.as_ref().and_then(GraphFile::scene));
    // A file that cannot be read must not make the others look wrong: what it would have told stays unchecked.
    let kinds: Option<Vec<&str>> = file.as_ref().map(|file| file.nodes().map(|node| node.kind).collect());
    let room = match (&folder, &kinds) {
        (Some(folder), _) => keep(scene::read(folder, kinds.as_deref()), &mut faults),
        (None, Some(kinds)) if scene::STAGES.iter().any(|stage| kinds.contains(stage)) => {
            let fault = Fault::file(graph, "this graph reads a scene, and none is named");
            faults.push(fault.help("name its folder with --scene DIR"));
            None
        }
        (None, Some(_)) => Some(Overlay::default()),
        (None, None) => None,
    };
    let change = match edit {
        Some(path) => keep(edit::read(path, room.as_ref(), kinds.as_deref()), &mut faults),
        None => Some(Overlay::default()),
    };
    let has_room = room.is_some();
    let mut overlay = Overlay::default();
    for layer in [room, change].into_iter().flatten() {
        overlay.settings.extend(layer.settings);
        overlay.members.extend(layer.members);
    }
    let registry = networks::registry(&files.networks);
    let with_network: Vec<&str> = kinds.iter().flat_map(|kinds| networks::with_network(&registry, kinds)).collect();
    if !with_network.is_empty() {
        match networks::choose(&files.networks) {
            Ok(choice) => overlay.settings.extend(networks::settings(&with_network, &choice.backend)),
            Err(fault) => faults.push(fault),
        }
    }
    if let Some(error) = files.target_error {
        overlay.settings.extend(target_error(&registry, error));
    }
    if !files.known_length.is_empty() {
        match known_lengths(&registry, &files.known_length, kinds.as_deref()) {
            Ok(settings) => overlay.settings.extend(settings),
            Err(fault) => faults.push(fault),
        }
    }
    for text in &files.set {
        overlay.settings.extend(setting(text, &mut faults));
    }
    let Some(file) = file else { return Err(faults) };
    // Without its scene, a graph would only show that it lacks one.
    let resolved = if has_room { file.resolve(&registry, &overlay) } else { Err(file.faults().to_vec()) };
    match resolved {
        Ok(graph) if faults.is_empty() => Ok(graph),
        Ok(_) => Err(faults),
        Err(of_graph) => Err(of_graph.into_iter().chain(faults).collect()),
    }
}

fn keep<T>(result: Result<T, Vec<Fault>>, faults: &mut Vec<Fault>) -> Option<T> {
    result.map_err(|new| faults.extend(new)).ok()
}

/// `--target-error`: for every kind of node that has such a parameter, whether the graph has nodes of it or not.
fn target_error(registry: &Registry, error: f32) -> Vec<Setting> {
    let field = "target_error";
    let value = Raw::document(&Source::new("--target-error", error.to_string()), &mut Vec::new());
    let value = value.expect("a number is a RON value");
    let kinds = registry.kinds().filter(|spec| spec.params.iter().any(|param| param.name == field));
    let setting = |kind: &str| Setting { target: Target::Kind(kind.into()), field: field.into(), value: value.clone() };
    kinds.map(|spec| setting(spec.kind)).collect()
}

/// `--known-length`: for every kind of node that has such a parameter.
///
/// # Errors
/// The graph has nodes of `kinds` only, and none of these.
fn known_lengths(registry: &Registry, lengths: &[String], kinds: Option<&[&str]>) -> Result<Vec<Setting>, Fault> {
    let (option, field) = ("--known-length", "known_lengths");
    let takes = registry.kinds().filter(|spec| spec.params.iter().any(|param| param.name == field));
    let takes: Vec<&str> = takes.map(|spec| spec.kind).collect();
    if kinds.is_some_and(|kinds| kinds.iter().all(|kind| !takes.contains(kind))) {
        let message = format!("this graph has no stage that takes known lengths: wanted {}", takes.join(", "));
        return Err(Fault::file(option.as_ref(), message).help("graphs/depth.ron has"));
    }
    let value = Raw::document(&Source::new(option, format!("[{}]", lengths.join(", "))), &mut Vec::new());
    let value = value.expect("the arguments were made RON when they were read");
    let setting =
        |kind: &&str| Setting { target: Target::Kind((*kind).into()), field: field.into(), value: value.clone() };
    Ok(takes.iter().map(setting).collect())
}

/// One `--set NODE.PARAM=VALUE`; relative paths in it start from the working directory.
pub fn setting(text: &str, faults: &mut Vec<Fault>) -> Option<Setting> {
    let parts = text.split_once('=').and_then(|(place, value)| Some((place.trim().split_once('.')?, value)));
    let Some(((node, field), value)) = parts.filter(|((node, field), _)| is_name(node) && is_name(field)) else {
        let fault = Fault::file("--set".as_ref(), format!("wanted NODE.PARAM=VALUE, got `{text}`"));
        faults.push(fault.help("for example --set direct.samples=64"));
        return None;
    };
    let value = Raw::document(&Source::new(format!("--set {node}.{field}"), value), faults)?;
    Some(Setting { target: Target::Node(node.to_owned()), field: field.to_owned(), value })
}
