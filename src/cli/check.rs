//! `relight check`: the files of a run, and the content of the pictures that its scene names.

use relight::files::scene;
use relight::geometry::Camera;
use relight::graph::{
    Cancel, Diagnostic, EngineOptions, PortValue, Raw, ResolvedGraph, RunReport, Setting, Value,
};

use super::args::JobArgs;
use super::engine::{engine, report_errors};
use super::exit::{CliError, Exit};
use super::load::{load, load_all};
use super::messages::message;
use super::progress::Progress;
use super::{report, write};

/// Runs `relight check`.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn check(args: &JobArgs) -> Result<Exit, CliError> {
    let (graph, settings, count) = match &args.edit {
        Some(edit) => {
            let pictures = load_all(&args.graph, edit, &args.files)?;
            let settings = pictures.settings()?;
            (pictures.first, settings, pictures.frames.map_or(1, |frames| frames.len()))
        }
        None => (load(&args.graph, None, &args.files)?, Vec::new(), 1),
    };
    let read = read_scene(&graph)?;
    report::warnings(&read).iter().for_each(|warning| message!("warning: {warning}"));
    report_errors(&read);
    let camera = read.outputs.iter().find_map(|(_, value)| match value {
        PortValue::One(value) => Value::get::<Camera>(value),
        _ => None,
    });
    if let Some(camera) = camera {
        let faults = outside(&settings, (camera.width, camera.height));
        if !faults.is_empty() {
            return Err(faults.into());
        }
    }
    if !read.is_complete() {
        return Ok(Exit::of(&read));
    }
    let frames = if count > 1 { format!("{count} frames, ") } else { String::new() };
    let nodes = graph.instances().count();
    write::print(&format!(
        "valid: {frames}{nodes} nodes, outputs {}\n",
        graph.outputs().join(" ")
    ))?;
    Ok(Exit::Done)
}

/// Runs the stages that read photo, depth and masks, as a run would, without a cache.
fn read_scene(graph: &ResolvedGraph) -> Result<RunReport, CliError> {
    let readers = scene::STAGES.iter().flat_map(|kind| graph.of_kind(kind));
    let cameras: Vec<String> = readers.map(|node| format!("{node}.camera")).collect();
    if cameras.is_empty() {
        return Ok(RunReport::default());
    }
    let wanted = graph.wanted(Some(&cameras))?;
    let engine = engine(EngineOptions::default())?;
    Ok(engine.run(graph, &wanted, &Cancel::default(), &Progress::new(false, false)))
}

/// The pixels outside of a photo of this size that the settings of an edit name.
pub fn outside(settings: &[Setting], size: (usize, usize)) -> Vec<Diagnostic> {
    settings.iter().flat_map(|setting| outside_of(&setting.value, size)).collect()
}

/// The faults of `Pixel(x: .., y: ..)` and `Grow(.., ..)` in a value.
fn outside_of(value: &Raw, (width, height): (usize, usize)) -> Vec<Diagnostic> {
    let words = value.words();
    let mut faults = Vec::new();
    for (at, (name, _)) in words.iter().enumerate() {
        let word = name.text();
        if word != "Pixel" && word != "Grow" {
            continue;
        }
        let inner = words[at + 1..].iter().take_while(|(word, _)| word.text() != ")");
        let (mut before, mut place) = ("", [None; 2]);
        for (word, is_number) in inner {
            let number = is_number.then(|| word.text().parse::<f32>().ok()).flatten();
            let axis = match (word_axis(before), place[0]) {
                (Some(axis), _) => Some(axis),
                // The numbers of Grow have no names.
                (None, first) if name.text() == "Grow" => Some(usize::from(first.is_some())),
                _ => None,
            };
            match (number, axis) {
                (Some(number), Some(axis)) => {
                    place[axis].get_or_insert(number);
                }
                (Some(_), None) => {}
                (None, _) if word.text().starts_with(char::is_alphabetic) => before = word.text(),
                (None, _) => {}
            }
        }
        if let [Some(x), Some(y)] = place
            && !((0.0..width as f32).contains(&x) && (0.0..height as f32).contains(&y))
        {
            let message =
                format!("wanted a pixel of the photo, 0..{width} and 0..{height}, got ({x}, {y})");
            faults.push(name.fault(message));
        }
    }
    faults
}

fn word_axis(word: &str) -> Option<usize> {
    ["x", "y"].iter().position(|axis| *axis == word)
}
