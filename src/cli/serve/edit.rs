//! Texts of the edit: from pages, and from the editor that a person has beside them.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use relight::files::{EditFile, edit};
use relight::graph::{Diagnostic, GraphFile, ResolvedGraph, Source, read};
use serde_json::json;

use super::events::{Event, Fault};
use super::scene::Scene;
use super::state::{Draft, Live, State};
use crate::cli::check::outside;
use crate::cli::load::load_text;
use crate::cli::run::preview::shrink;
use crate::cli::watch::Watch;
use crate::cli::write::Output;

/// Most bytes of the text of an edit.
pub const MOST_TEXT: usize = 1 << 20;
/// The edit of a folder without one.
const EMPTY: &str = "Edit(\n    version: 1,\n)\n";
/// The text of a page that has faults.
const DRAFT: &str = "draft.ron";

/// The answer to a text that a page sent.
pub enum Answer {
    Accepted {
        revision: u64,
    },
    /// Another page or an editor was faster.
    Stale {
        revision: u64,
        text: String,
    },
    Faulty {
        diagnostics: Vec<Fault>,
        text: String,
    },
    /// The file cannot be written.
    Lost(Diagnostic),
}

/// Reads the edit file and asks for the first run.
pub fn begin(live: &Live) {
    let text = from_disk(live.edit());
    let draft = from_disk(&live.job.out.join(DRAFT)).ok().flatten();
    let (text, fault) = match text {
        Ok(text) => (text, None),
        Err(fault) => (None, Some(fault)),
    };
    let mut state = live.state();
    let scene = state.scene.clone();
    let loaded = load(live, Some(&scene), text.as_deref().unwrap_or(EMPTY), false);
    let draft = draft.map(|text| {
        let faults = load(live, Some(&scene), &text, false).err().unwrap_or_default();
        Draft { text, diagnostics: Fault::all(&faults) }
    });
    state.on_disk.clone_from(&text);
    state.text = text.unwrap_or_else(|| EMPTY.to_owned());
    state.draft = draft;
    state.revision = state.number();
    let revision = state.revision;
    match fault {
        Some(fault) => live.refuse(&mut state, revision, &[fault]),
        None => run(live, &mut state, revision, loaded, false),
    }
}

/// Takes a text that a page made of the revision `base`.
pub fn put(live: &Live, text: String, base: u64, preview: bool) -> Answer {
    let began = Instant::now();
    let scene = {
        let mut state = live.state();
        if let Some(stale) = stale(live, &mut state, base) {
            return stale;
        }
        state.scene.clone()
    };
    let loaded = load(live, Some(&scene), &text, preview);
    let mut guard = live.state();
    let state = &mut *guard;
    // Others may have changed it in the meantime.
    if let Some(stale) = stale(live, state, base) {
        return stale;
    }
    let loaded = match loaded {
        Ok(loaded) => loaded,
        Err(faults) => {
            let diagnostics = Fault::all(&faults);
            if !preview {
                if let Err(fault) = write(live, &live.job.out.join(DRAFT), &text) {
                    return Answer::Lost(fault);
                }
                let diagnostics = diagnostics.clone();
                state.draft = Some(Draft { text: text.clone(), diagnostics });
            }
            return Answer::Faulty { diagnostics, text };
        }
    };
    if preview {
        let revision = state.number();
        live.ask(state, revision, loaded, (true, false, began));
        return Answer::Accepted { revision };
    }
    if let Err(fault) = write(live, live.edit(), &text) {
        return Answer::Lost(fault);
    }
    if state.draft.take().is_some() {
        let _ = std::fs::remove_file(live.job.out.join(DRAFT));
    }
    let revision = accept(live, state, text);
    state.watch(Some(loaded.1.inputs()));
    live.ask(state, revision, loaded, (false, false, began));
    Answer::Accepted { revision }
}

/// The answer to a page whose text is not made of the newest one, which may be on disk alone.
fn stale(live: &Live, state: &mut State, base: u64) -> Option<Answer> {
    if base == state.revision {
        match from_disk(live.edit()) {
            Ok(Some(text)) if Some(&text) != state.on_disk.as_ref() => {
                external(live, state, text);
            }
            _ => return None,
        }
    }
    Some(Answer::Stale { revision: state.revision, text: state.text.clone() })
}

/// Takes over a text that is in the file already.
fn accept(live: &Live, state: &mut State, text: String) -> u64 {
    let revision = state.number();
    state.revision = revision;
    state.on_disk = Some(text.clone());
    live.send(Event::new("edit", &json!({ "revision": revision, "text": text })));
    state.text = text;
    revision
}

/// Takes over a text that another program wrote.
fn external(live: &Live, state: &mut State, text: String) {
    let loaded = load(live, Some(&state.scene), &text, false);
    let revision = accept(live, state, text);
    run(live, state, revision, loaded, false);
}

fn run(
    live: &Live,
    state: &mut State,
    revision: u64,
    loaded: Result<(Arc<Source>, ResolvedGraph), Vec<Diagnostic>>,
    reread: bool,
) {
    match loaded {
        Ok(loaded) => {
            state.watch(Some(loaded.1.inputs()));
            live.ask(state, revision, loaded, (false, reread, Instant::now()));
        }
        Err(faults) => {
            state.watch(None);
            live.refuse(state, revision, &faults);
        }
    }
}

/// Resolves the graph with a text as its edit; for a preview of lights at working size. Pixels of
/// the edit are held against the photo of `scene`; without it, the stages do that.
fn load(
    live: &Live,
    scene: Option<&Scene>,
    text: &str,
    preview: bool,
) -> Result<(Arc<Source>, ResolvedGraph), Vec<Diagnostic>> {
    let job = &live.job;
    let source = Source::within(live.edit(), text, job.files.reach());
    let file = EditFile::parse(source.clone())?;
    if let Some(frames) = file.frames() {
        let message = format!("wanted an edit of one picture, got one of {frames} frames");
        let fault = Diagnostic::file(live.edit(), message);
        return Err(vec![fault.help("`relight run` makes the pictures of a sequence")]);
    }
    let coarse = preview && edit::changes_lights_alone(&source);
    let change = |graph: &mut GraphFile| {
        if coarse {
            shrink(graph)
        }
    };
    let graph = load_text(&job.graph, &source, &job.files, change)?;
    let settings = edit::frame(&file, 0, None, None)?.settings;
    match scene.map_or_else(Vec::new, |scene| outside(&settings, scene.full)) {
        faults if faults.is_empty() => Ok((source, graph)),
        faults => Err(faults),
    }
}

/// Follows the files of the run until the server ends.
pub fn watch(live: &Live) {
    let mut watch = Watch::default();
    let scene = live.job.files.scene.clone();
    while !live.is_ending() {
        let seen = {
            let state = live.state();
            watch.set(state.inputs.iter().cloned().chain([live.edit().to_owned()]).collect());
            if state.broken {
                watch.add_folder(scene.clone(), &live.job.out);
            }
            state.watched
        };
        let changed = watch.wait(&|| live.is_ending() || live.state().watched != seen);
        if changed.is_empty() {
            continue;
        }
        let others = changed.iter().any(|path| path != live.edit());
        let text = from_disk(live.edit());
        let mut state = live.state();
        match text {
            Ok(Some(text)) if Some(&text) != state.on_disk.as_ref() => {
                external(live, &mut state, text);
            }
            Err(fault) => {
                let revision = state.number();
                live.refuse(&mut state, revision, &[fault]);
                continue;
            }
            // Without its file, the edit stays as the pages have it.
            Ok(_) => {}
        }
        if others {
            // The photo may have another size now.
            let loaded = load(live, None, &state.text, false);
            let revision = state.number();
            run(live, &mut state, revision, loaded, true);
        }
    }
}

/// The text of a file; `None` where it is missing.
fn from_disk(path: &Path) -> Result<Option<String>, Diagnostic> {
    let bytes = match read(path, MOST_TEXT as u64) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(Diagnostic::file(path, format!("cannot be read: {e}"))),
    };
    let text = String::from_utf8(bytes)
        .map_err(|_| Diagnostic::file(path, "wanted UTF-8 text, got other bytes"))?;
    Ok(Some(text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text)))
}

/// Writes a text whole or not at all. A symbolic link that a person named stays one; in the folder
/// of results, which a stranger may have prepared, the text takes its place.
fn write(live: &Live, path: &Path, text: &str) -> Result<(), Diagnostic> {
    let is_own = path.parent() == Some(&live.job.out);
    let real = if is_own { None } else { path.canonicalize().ok() };
    let real = real.unwrap_or_else(|| path.to_owned());
    let folder = real.parent().unwrap_or("".as_ref());
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let name = real.file_name().unwrap_or_default().to_string_lossy();
    Output::new(folder, [], false)?.file(&name, text.as_bytes()).map(drop)
}
