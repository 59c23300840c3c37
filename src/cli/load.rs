//! ResolvedGraph, scene, edit and settings into one graph that is ready to run.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use relight::files::{EditFile, edit, scene};
use relight::graph::{
    Diagnostic, Diagnostics, GraphFile, Node, Overlay, Raw, Registry, Resolved, ResolvedGraph,
    Setting, Source, Target, is_name, to_ron,
};
use relight::nodes::output::write_picture::WritePicture;

use super::args::{Networks, SceneFiles};
use super::networks;

/// The pictures of an edit. Their graphs are resolved one at a time, so that memory does not grow
/// with their number.
pub struct Pictures {
    /// The graph of the first picture, the only one of an edit without `frames`.
    pub first: ResolvedGraph,
    /// The frames of a sequence, at least one; all are sound.
    pub frames: Option<Range<u32>>,
    /// The nodes of the graph that write a picture and nothing else.
    pub writers: Vec<String>,
    parts: Parts,
    edit: EditFile,
    resolved: Resolved,
}

impl Pictures {
    /// The graph of one frame.
    ///
    /// # Errors
    /// The frame is not among `frames`.
    pub fn graph(&mut self, frame: u32) -> Result<ResolvedGraph, Vec<Diagnostic>> {
        let Pictures { parts, edit, resolved, .. } = self;
        parts.frame(edit, Some(frame), |file, overlay| {
            file.resolve_next(&parts.registry, overlay, resolved)
        })
    }

    /// The text of the edit.
    pub fn text(&self) -> &str {
        self.edit.text()
    }

    /// The settings of the edit in the first picture.
    ///
    /// # Errors
    /// Those of [`edit::frame`].
    pub fn settings(&self) -> Result<Vec<Setting>, Vec<Diagnostic>> {
        let first = self.frames.as_ref().map_or(0, |frames| frames.start);
        Ok(edit::frame(&self.edit, first, None, None)?.settings)
    }

    /// Checks the frames after the first. A frame that equals the one before it needs no check.
    fn check_others(&mut self) -> Result<(), Vec<Diagnostic>> {
        let Pictures { frames, parts, edit, resolved, .. } = self;
        let mut others = frames
            .iter()
            .flat_map(|frames| frames.clone().skip(1))
            .filter(|frame| !edit.stands_still(*frame));
        others.try_for_each(|frame| {
            parts.frame(edit, Some(frame), |file, overlay| {
                file.check(&parts.registry, overlay, resolved)
            })
        })
    }
}

/// The files of a run.
pub enum Loaded {
    /// One picture, and the text of its edit.
    Picture(Box<ResolvedGraph>, Option<String>),
    /// The frames of a sequence that the run makes.
    Frames(Box<Pictures>, Range<u32>),
}

impl Loaded {
    /// The graph of the first picture.
    pub fn graph(&self) -> &ResolvedGraph {
        match self {
            Loaded::Picture(graph, _) => graph,
            Loaded::Frames(pictures, _) => &pictures.first,
        }
    }
}

/// Reads all files of a run with an edit, or without one.
///
/// # Errors
/// Those of [`load`] and [`load_all`].
pub fn load_run(
    graph: &Path,
    edit: Option<&Path>,
    files: &SceneFiles,
) -> Result<Loaded, Vec<Diagnostic>> {
    let Some(edit) = edit else {
        return Ok(Loaded::Picture(Box::new(load(graph, None, files)?), None));
    };
    let pictures = load_all(graph, edit, files)?;
    match pictures.frames.clone() {
        Some(numbers) => Ok(Loaded::Frames(Box::new(pictures), numbers)),
        None => {
            let text = pictures.text().to_owned();
            Ok(Loaded::Picture(Box::new(pictures.first), Some(text)))
        }
    }
}

/// Reads all files of one picture: of a sequence, the frame that `files` names, or the first.
///
/// # Errors
/// All faults of all files.
pub fn load(
    graph: &Path,
    edit: Option<&Path>,
    files: &SceneFiles,
) -> Result<ResolvedGraph, Vec<Diagnostic>> {
    let parts = Parts::read(graph, files);
    let Some(path) = edit else {
        return match files.frame {
            None => parts
                .with(Default::default(), |file, overlay| file.resolve(&parts.registry, overlay)),
            Some(_) => parts.refused(no_frames()),
        };
    };
    parts.one(EditFile::read_within(path, files.reach()), files.frame)
}

/// Reads all files of one picture whose edit is the text `edit`, which need not be saved, and
/// whose graph file is changed by `change`.
///
/// # Errors
/// All faults of all files.
pub fn load_text(
    graph: &Path,
    edit: &Arc<Source>,
    files: &SceneFiles,
    change: impl FnOnce(&mut GraphFile),
) -> Result<ResolvedGraph, Vec<Diagnostic>> {
    let mut parts = Parts::read(graph, files);
    parts.file.as_mut().map(change);
    parts.one(EditFile::parse(edit.clone()), files.frame)
}

/// Reads all files of each picture of an edit: every frame of a sequence unless `files` names one.
///
/// # Errors
/// All faults of all files; of a sequence, those of the first frame that has any.
pub fn load_all(
    graph: &Path,
    edit: &Path,
    files: &SceneFiles,
) -> Result<Pictures, Vec<Diagnostic>> {
    let parts = Parts::read(graph, files);
    let all = EditFile::read_within(edit, files.reach())
        .and_then(|edit| Ok((frames(&edit, files.frame)?, edit)));
    let (frames, edit) = all.or_else(|faults| parts.refused(faults))?;
    let mut resolved = Resolved::default();
    let first =
        parts.frame(&edit, frames.as_ref().map(|frames| frames.start), |file, overlay| {
            file.resolve_next(&parts.registry, overlay, &mut resolved)
        })?;
    let nodes = parts.file.iter().flat_map(GraphFile::nodes);
    let writers = nodes
        .filter(|node| node.kind == WritePicture::KIND)
        .map(|node| node.name.to_owned())
        .collect();
    let mut pictures = Pictures { first, frames, writers, parts, edit, resolved };
    pictures.check_others()?;
    Ok(pictures)
}

fn no_frames() -> Vec<Diagnostic> {
    vec![Diagnostic::file("--frame".as_ref(), "wanted an edit with `frames`, got one picture")]
}

/// The requested frames, at least one; none where the edit is one picture.
fn frames(edit: &EditFile, chosen: Option<u32>) -> Result<Option<Range<u32>>, Vec<Diagnostic>> {
    let refused = |message: String| vec![Diagnostic::file("--frame".as_ref(), message)];
    match (edit.frames(), chosen) {
        (None, None) => Ok(None),
        (None, Some(_)) => Err(no_frames()),
        (Some(frames), None) => Ok(Some(0..frames)),
        (Some(frames), Some(number)) if number < frames => Ok(Some(number..number + 1)),
        (Some(frames), Some(number)) => {
            Err(refused(format!("wanted 0..={}, got {number}", frames - 1)))
        }
    }
}

/// All inputs of a graph except the edit.
struct Parts {
    file: Option<GraphFile>,
    room: Option<Overlay>,
    registry: Registry,
    /// Settings of the command line, which win over the edit's.
    settings: Vec<Setting>,
    faults: Vec<Diagnostic>,
}

impl Parts {
    fn read(graph: &Path, files: &SceneFiles) -> Parts {
        let mut faults = Vec::new();
        let registry = networks::registry(&files.networks);
        let mut file = keep(GraphFile::read_within(graph, files.reach()), &mut faults);
        file.iter_mut().for_each(|file| file.accept_old_names(&registry));
        let folder = match &files.scene {
            Some(folder) => Ok(Some(folder.clone())),
            None => file.as_ref().map_or(Ok(None), GraphFile::scene),
        };
        // An unreadable file must not make the others look wrong: checks that need it are skipped.
        let kinds = kinds(file.as_ref());
        let room = match (folder, &kinds) {
            (Err(fault), _) => {
                faults.push(fault);
                None
            }
            (Ok(Some(folder)), _) => {
                keep(scene::read_within(&folder, kinds.as_deref(), files.reach()), &mut faults)
            }
            (Ok(None), Some(kinds)) if scene::STAGES.iter().any(|stage| kinds.contains(stage)) => {
                let fault = Diagnostic::file(graph, "this graph reads a scene, and none is named");
                faults.push(fault.help("name its folder with --scene DIR"));
                None
            }
            (Ok(None), Some(_)) => Some(Overlay::default()),
            (Ok(None), None) => None,
        };
        let mut settings = Vec::new();
        match backend(&registry, &files.networks, kinds.as_deref().unwrap_or_default()) {
            Ok(choice) => settings.extend(choice),
            Err(fault) => faults.push(fault),
        }
        if let Some(error) = files.target_error {
            settings.extend(everywhere(
                &registry,
                "--target-error",
                "target_error",
                error.to_string(),
            ));
        }
        if !files.lengths.known_length.is_empty() {
            match known_lengths(&registry, &files.lengths.known_length, kinds.as_deref()) {
                Ok(lengths) => settings.extend(lengths),
                Err(fault) => faults.push(fault),
            }
        }
        for text in &files.set {
            settings.extend(setting(text, &mut faults));
        }
        Parts { file, room, registry, settings, faults }
    }

    /// Resolves the frame `number` of an edit, or the first.
    fn one(
        &self,
        edit: Result<EditFile, Vec<Diagnostic>>,
        number: Option<u32>,
    ) -> Result<ResolvedGraph, Vec<Diagnostic>> {
        let first = edit.and_then(|edit| Ok((frames(&edit, number)?, edit)));
        let (frames, edit) = first.or_else(|faults| self.refused(faults))?;
        self.frame(&edit, frames.map(|frames| frames.start), |file, overlay| {
            file.resolve(&self.registry, overlay)
        })
    }

    /// Resolves one frame of an edit.
    fn frame<T>(
        &self,
        edit: &EditFile,
        number: Option<u32>,
        resolve: impl FnOnce(&GraphFile, &Overlay) -> Result<T, Vec<Diagnostic>>,
    ) -> Result<T, Vec<Diagnostic>> {
        let change = edit::frame_and_faults(
            edit,
            number.unwrap_or(0),
            self.room.as_ref(),
            kinds(self.file.as_ref()).as_deref(),
        );
        let numbered = |fault: Diagnostic| match number {
            Some(number) if number > 0 && fault.help.is_none() => {
                fault.help(format!("in frame {number}"))
            }
            _ => fault,
        };
        self.with(change, resolve).map_err(|faults| faults.into_iter().map(numbered).collect())
    }

    /// Resolves the graph with an edit, or returns the faults of both.
    fn with<T>(
        &self,
        (change, of_edit): (Overlay, Vec<Diagnostic>),
        resolve: impl FnOnce(&GraphFile, &Overlay) -> Result<T, Vec<Diagnostic>>,
    ) -> Result<T, Vec<Diagnostic>> {
        let faults: Vec<Diagnostic> = self.faults.iter().cloned().chain(of_edit).collect();
        let Some(file) = &self.file else { return Err(faults) };
        // Without its scene, a graph would only report that it has none.
        let resolved = match &self.room {
            Some(room) => {
                let mut overlay = room.clone();
                overlay.settings.extend(change.settings);
                overlay.members.extend(change.members);
                overlay.settings.extend(self.settings.iter().cloned());
                resolve(file, &overlay)
            }
            None => Err(file.faults()),
        };
        match resolved {
            Ok(graph) if faults.is_empty() => Ok(graph),
            Ok(_) => Err(faults),
            Err(of_graph) => Err(of_graph.into_iter().chain(faults).collect()),
        }
    }

    /// The faults of an edit that cannot be read, and all others.
    fn refused<T>(&self, faults: Vec<Diagnostic>) -> Result<T, Vec<Diagnostic>> {
        let refused = self.with((Overlay::default(), faults), |file, overlay| {
            file.resolve(&self.registry, overlay)
        });
        Err(refused.err().expect("a graph with faults is refused"))
    }
}

/// The kinds of nodes that a graph file names.
fn kinds(file: Option<&GraphFile>) -> Option<Vec<&str>> {
    Some(file?.nodes().map(|node| node.kind).collect())
}

fn keep<T>(result: Result<T, Vec<Diagnostic>>, faults: &mut Vec<Diagnostic>) -> Option<T> {
    result.map_err(|new| faults.extend(new)).ok()
}

/// Settings of the backend, where nodes of `kinds` have networks.
///
/// # Errors
/// A library that the arguments name or require cannot be used.
pub fn backend(
    registry: &Registry,
    args: &Networks,
    kinds: &[&str],
) -> Result<Vec<Setting>, Diagnostic> {
    if !kinds.iter().any(|kind| networks::has_network(registry, kind)) {
        return Ok(Vec::new());
    }
    let backend = to_ron(&networks::choose(args)?.backend);
    Ok(everywhere(registry, "--backend", networks::FIELD, backend))
}

/// The value of `option` for every kind of node with the parameter `field`, in the graph or not.
fn everywhere(registry: &Registry, option: &str, field: &str, text: String) -> Vec<Setting> {
    let value = Raw::document(&Source::new(option, text), &mut Diagnostics::default());
    let value = value.expect("the arguments were made RON when they were read");
    let kinds = registry.kinds().filter(|spec| spec.params.iter().any(|param| param.name == field));
    let setting = |kind: &str| Setting {
        target: Target::Kind(kind.into()),
        field: field.into(),
        value: value.clone(),
    };
    kinds.map(|spec| setting(spec.kind)).collect()
}

/// Settings of `--known-length`, for every kind of node with such a parameter.
///
/// # Errors
/// The graph has nodes of `kinds` only, and none of these.
fn known_lengths(
    registry: &Registry,
    lengths: &[String],
    kinds: Option<&[&str]>,
) -> Result<Vec<Setting>, Diagnostic> {
    let (option, field) = ("--known-length", "known_lengths");
    let takes = registry.kinds().filter(|spec| spec.params.iter().any(|param| param.name == field));
    let takes: Vec<&str> = takes.map(|spec| spec.kind).collect();
    if kinds.is_some_and(|kinds| kinds.iter().all(|kind| !takes.contains(kind))) {
        let message = format!(
            "this graph has no stage that takes known lengths: wanted {}",
            takes.join(", ")
        );
        return Err(Diagnostic::file(option.as_ref(), message).help("graphs/depth.ron has"));
    }
    Ok(everywhere(registry, option, field, format!("[{}]", lengths.join(", "))))
}

/// One `--set NODE.PARAM=VALUE`; relative paths in it start from the working directory.
pub fn setting(text: &str, faults: &mut Vec<Diagnostic>) -> Option<Setting> {
    let parts = text
        .split_once('=')
        .and_then(|(place, value)| Some((place.trim().split_once('.')?, value)));
    let Some(((node, field), value)) =
        parts.filter(|((node, field), _)| is_name(node) && is_name(field))
    else {
        let fault =
            Diagnostic::file("--set".as_ref(), format!("wanted NODE.PARAM=VALUE, got `{text}`"));
        faults.push(fault.help("for example --set direct.samples=64"));
        return None;
    };
    let mut of_value = Diagnostics::default();
    let value = Raw::document(&Source::new(format!("--set {node}.{field}"), value), &mut of_value);
    faults.extend(of_value.into_vec());
    Some(Setting { target: Target::Node(node.to_owned()), field: field.to_owned(), value: value? })
}
