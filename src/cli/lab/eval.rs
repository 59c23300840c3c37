//! `relight eval`: estimates and pictures against the truth.

use std::time::Instant;

use relight::graph::{Cancel, EngineOptions, PortValue, Value};
use relight::nodes::artifacts::Scores;
use relight_lab::eval::{EvalReport, Figure, Substitution};

use super::args::Eval;
use super::target::EvalTarget;
use crate::cli::engine::{engine, finished, options, stop_on_ctrl_c};
use crate::cli::exit::{CliError, Exit, Stop, ended};
use crate::cli::messages::message;
use crate::cli::report;
use crate::cli::write::{self, Output};

/// Runs `relight eval`.
///
/// # Errors
/// Files or arguments that cannot be used.
pub fn eval(args: &Eval, began: Instant) -> Result<Exit, CliError> {
    ended(measure(args, began))
}

fn measure(args: &Eval, began: Instant) -> Result<(), Stop> {
    if args.no_ladder {
        message!(
            "warning: --no-ladder is now --no-ablation; the next version will not read the old name"
        );
    }
    let target = EvalTarget::new(&args.graph, &args.scene, &args.set, &args.networks)?;
    let options = options(&args.cache, &args.graph, Some(&args.scene))?;
    let options = EngineOptions { threads: args.threads.map(usize::from), ..options };
    let engine = engine(options)?;
    let out = Output::new(&args.out, [args.graph.clone()], false)?; // fails before the work, not after it
    let cancel = Cancel::default();
    stop_on_ctrl_c(&cancel)?;

    let mut figures = Vec::new();
    let as_it_is = Substitution::default();
    let ablation = !(args.no_ablation || args.no_ladder);
    let substitutions = if ablation { Substitution::all(target.known()) } else { vec![as_it_is] };
    for substitution in substitutions {
        let edits =
            target.edits.iter().map(|edit| (Some(edit), vec!["score_picture.scores".to_owned()]));
        for (edit, outputs) in [(None, target.measures(substitution))].into_iter().chain(edits) {
            if outputs.is_empty() {
                continue;
            }
            let graph = target.graph(substitution, edit)?;
            let done = finished(engine.run(&graph, &graph.wanted(Some(&outputs))?, &cancel, &()))?;
            if substitution == as_it_is {
                report::warnings(&done).iter().for_each(|warning| message!("warning: {warning}"));
            }
            for output in &outputs {
                let Some(PortValue::One(value)) = done.output(output) else { continue };
                let scores = Value::get::<Scores>(value).expect("score stages give scores");
                figures.extend(scores.0.iter().map(|score| Figure {
                    substitution,
                    subject: score.subject.clone(),
                    measure: score.measure.clone(),
                    value: score.value,
                }));
            }
        }
        message!(
            "{:6.1} s  {}",
            began.elapsed().as_secs_f64(),
            substitution.title(target.known().depth)
        );
    }
    let report = EvalReport {
        relight: env!("CARGO_PKG_VERSION"),
        graph: args.graph.display().to_string(),
        scene: args.scene.display().to_string(),
        threads: engine.threads(),
        seconds: began.elapsed().as_secs_f64(),
        figures,
        left_out: target.left_out,
    };
    let json = report::text(&report);
    let path = out.file("eval.json", json.as_bytes())?;
    message!("{}", path.display());
    write::print(&if args.json { json } else { report.markdown() })?;
    Ok(())
}
