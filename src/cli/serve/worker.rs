//! The worker: one thread that owns the engine and computes the newest text, layers first.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use relight::files::edit::{changes_lights_alone, without_radiance};
use relight::graph::{Diagnostic, Ending, Engine, GraphFile, ResolvedGraph, RunReport};
use serde_json::json;

use super::events::{Event, rows};
use super::layers::{Base, manifest, wanted};
use super::progress::Progress;
use super::scene::{LONG_SIDE, Scene, WRITER, failures, node};
use super::state::{Live, RunStatus, Task};
use crate::cli::load::load_text;
use crate::cli::picture::{Told, write_all};
use crate::cli::results::output;
use crate::cli::run::preview::shrink;

/// Why a task gave no result.
enum Stop {
    Faults(Vec<Diagnostic>),
    /// A newer task has taken its place.
    Superseded,
}

impl From<Vec<Diagnostic>> for Stop {
    fn from(faults: Vec<Diagnostic>) -> Stop {
        Stop::Faults(faults)
    }
}

impl From<Diagnostic> for Stop {
    fn from(fault: Diagnostic) -> Stop {
        Stop::Faults(vec![fault])
    }
}

/// Computes one task after the other until the server ends.
pub fn work(live: &Live, engine: &Engine) {
    while let Some(task) = live.next() {
        let revision = task.revision;
        let done = catch_unwind(AssertUnwindSafe(|| compute(live, engine, &task)));
        match done {
            Ok(Ok(())) => {}
            Ok(Err(Stop::Superseded)) => live.end_run(revision, RunStatus::Superseded, &[]),
            Ok(Err(Stop::Faults(faults))) => live.end_run(revision, RunStatus::Failed, &faults),
            Err(_) => {
                let bug = Diagnostic::file("".as_ref(), "a bug in relight: the run panicked");
                live.end_run(revision, RunStatus::Failed, &[bug]);
            }
        }
    }
}

fn compute(live: &Live, engine: &Engine, task: &Task) -> Result<(), Stop> {
    let scene = if task.reread {
        let scene = Arc::new(Scene::read(&live.job, engine)?);
        live.state().scene = scene.clone();
        scene
    } else {
        live.state().scene.clone()
    };
    let mut ran = base(live, engine, task, &scene)?;
    if !task.preview {
        let graph = &task.graph;
        let done = run(live, engine, task, graph, &graph.wanted(None)?)?;
        let told = Told::new(&live.job, graph, engine, &done, task.began)?;
        if let Some(out) = output(&live.job, graph)? {
            write_all(&live.job, &out, (graph, Some(&task.source.text), &done), &told.json)?;
        }
        ran.extend(rows(&done.nodes).map(|row| json!(row)));
        live.state().drawing = graph.to_svg(Some(&done));
    }
    let seconds = task.began.elapsed().as_secs_f64();
    live.end_run(task.revision, RunStatus::Done, &[]);
    live.send(Event::new(
        "finished",
        &json!({
            "revision": task.revision, "preview": task.preview, "seconds": seconds, "ran": ran,
        }),
    ));
    Ok(())
}

/// Makes the layers of a task; returns the nodes that ran for them.
fn base(
    live: &Live,
    engine: &Engine,
    task: &Task,
    scene: &Scene,
) -> Result<Vec<serde_json::Value>, Stop> {
    let source = without_radiance(&task.source);
    let coarse = task.preview && changes_lights_alone(&source);
    let change = |graph: &mut GraphFile| {
        if coarse {
            shrink(graph)
        }
    };
    let loaded = if source.text == task.source.text {
        None
    } else {
        Some(load_text(&live.job.graph, &source, &live.job.files, change)?)
    };
    let graph = loaded.as_ref().unwrap_or(&task.graph);
    let writer = node(graph, WRITER, &live.job.graph)?;
    let wanted = graph.wanted(Some(&wanted(graph, &writer, task.preview)))?;
    let done = run(live, engine, task, graph, &wanted)?;
    let made = (task.revision, task.preview);
    let base = Base::new(made, (graph, &writer), &done, (&source, scene))
        .map_err(|e| Diagnostic::file("".as_ref(), format!("{writer}: {e}")))?;
    let base = Arc::new(base);
    let long_side = live.long_side().unwrap_or(LONG_SIDE);
    manifest(&live.packs, &base, long_side);
    live.state().base = Some(base);
    live.send(Event::new("layers", &json!({ "revision": task.revision, "preview": task.preview })));
    Ok(rows(&done.nodes).map(|row| json!(row)).collect())
}

/// Runs a graph to its end.
fn run(
    live: &Live,
    engine: &Engine,
    task: &Task,
    graph: &ResolvedGraph,
    wanted: &relight::graph::Wanted,
) -> Result<RunReport, Stop> {
    let done = engine.run(graph, wanted, &task.cancel, &Progress::new(live, task.revision));
    match done.ending() {
        Ending::Complete => Ok(done),
        Ending::Cancelled => Err(Stop::Superseded),
        Ending::Failed | Ending::BadInput => Err(failures(&done).into()),
    }
}
