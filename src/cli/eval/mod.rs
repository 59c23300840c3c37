//! `relight eval`: estimates and pictures against the truth.

mod graph;
mod tables;

use std::time::Instant;

use relight::graph::{Cancel, EngineOptions, PortValue, Value};
use relight::nodes::artifacts::Scores;
use serde::Serialize;

use super::args::Eval;
use super::messages::message;
use super::run::stop_on_ctrl_c;
use super::write::{self, Output};
use super::{CliError, Exit, Stop, ended, engine, finished, options, report};
use graph::{Rung, Subject};

/// One number, and what was true when it was measured.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    #[serde(flatten)]
    rung: Rung,
    subject: String,
    measure: String,
    value: f64,
}

#[derive(Serialize)]
struct Report<'a> {
    relight: &'static str,
    graph: String,
    scene: String,
    threads: usize,
    seconds: f64,
    /// Which parts of each figure's run were `true`: replaced by the truth.
    figures: &'a [Figure],
    left_out: &'a [String],
}

pub fn eval(args: &Eval, began: Instant) -> Result<Exit, CliError> {
    ended(measured(args, began))
}

fn measured(args: &Eval, began: Instant) -> Result<(), Stop> {
    let subject = Subject::new(&args.graph, &args.scene, &args.set, &args.networks)?;
    let options = options(&args.cache, &args.graph, Some(&args.scene))?;
    let options = EngineOptions { threads: args.threads.map(usize::from), ..options };
    let engine = engine(options)?;
    let out = Output::new(&args.out, [args.graph.clone()], false)?; // told before the work, not after it
    let cancel = Cancel::default();
    stop_on_ctrl_c(&cancel)?;

    let mut figures = Vec::new();
    let rungs = if args.no_ladder { vec![Rung::default()] } else { subject.rungs() };
    for &rung in &rungs {
        let edits = subject.edits.iter().map(|edit| (Some(edit), vec!["score_picture.scores".to_owned()]));
        for (edit, outputs) in [(None, subject.measures(rung))].into_iter().chain(edits) {
            if outputs.is_empty() {
                continue;
            }
            let graph = subject.graph(rung, edit)?;
            let done = finished(engine.run(&graph, &graph.wanted(Some(&outputs))?, &cancel, &()))?;
            if rung == Rung::default() {
                report::warnings(&done).iter().for_each(|warning| message!("warning: {warning}"));
            }
            for output in &outputs {
                let Some(PortValue::One(value)) = done.output(output) else { continue };
                let scores = Value::get::<Scores>(value).expect("score stages give scores");
                figures.extend(scores.0.iter().map(|score| Figure {
                    rung,
                    subject: score.subject.clone(),
                    measure: score.measure.clone(),
                    value: score.value,
                }));
            }
        }
        message!("{:6.1} s  {}", began.elapsed().as_secs_f64(), tables::title(rung, subject.has_depth()));
    }
    let report = Report {
        relight: env!("CARGO_PKG_VERSION"),
        graph: args.graph.display().to_string(),
        scene: args.scene.display().to_string(),
        threads: engine.threads(),
        seconds: began.elapsed().as_secs_f64(),
        figures: &figures,
        left_out: &subject.left_out,
    };
    let json = report::text(&report);
    let path = out.file("eval.json", json.as_bytes())?;
    message!("{}", path.display());
    write::print(&if args.json { json } else { tables::markdown(&figures, &subject) })?;
    Ok(())
}
