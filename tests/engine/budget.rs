//! Stages that stop when their time is over: their results are used, and not kept.

use std::time::Duration;

use relight::graph::{Cancel, Engine, EngineOptions, RunReport, Status};

use crate::nodes::*;

/// Two equal runs, the second without consumers of the first output.
const GRAPH: &str = r#"nodes: {
    "begin": (op: Const(value: 7)),
    "asked": (op: Patient(rounds: 5), in: { "number": "begin" }),
    "taken": (op: Add, in: { "number": "asked" }),
    "zero": (op: Times(by: 0), in: { "number": "taken" }),
    "seven": (op: Add(plus: 7), in: { "number": "zero" }),
    "asked_again": (op: Patient(rounds: 5), in: { "number": "seven" }),
    "result": (op: Add(plus: 2), in: { "number": "asked_again" }),
}, outputs: ["result"]"#;

fn hurried(folder: &std::path::Path, budget: Duration) -> Engine {
    let cache = Some(cache(folder, b"own"));
    engine(EngineOptions {
        cache,
        threads: Some(2),
        budget: Some(budget),
        ..EngineOptions::default()
    })
}

fn warnings(report: &RunReport) -> Vec<&str> {
    report.nodes.iter().flat_map(|node| node.warnings.iter().map(String::as_str)).collect()
}

#[test]
fn a_result_cut_short_serves_its_run_and_is_not_kept() {
    let folder = tempfile::tempdir().unwrap();
    let graph = graph(GRAPH);
    let hurry = hurried(folder.path(), Duration::ZERO);
    let first = run(&hurry, &graph);
    assert_eq!(value(&first, "result"), 2, "no round, plus two");
    assert_eq!(first.with_status(Status::Hit), ["asked_again"], "within a run it is one result");
    let message = "stopped by the budget at a standard error of 50.00 %; this result is not kept";
    assert_eq!(warnings(&first), [message; 2]);

    // Neither memory nor disk has it; results computed from it are valid, as their keys contain its
    // digest.
    let again = run(&hurry, &graph);
    assert_eq!((value(&again, "result"), ran(&again)), (2, vec!["asked"]));
    assert_eq!(
        hurry.explain(&graph, "asked").unwrap().why,
        "new",
        "nothing remembers the short result"
    );
    let patient = on_disk(folder.path());
    let whole = run(&patient, &graph);
    assert_eq!((value(&whole, "result"), warnings(&whole).len()), (7, 0));
    assert_eq!(ran(&whole), ["asked", "taken", "zero", "result"]);

    // After a complete result no stage reads its time.
    let hit = run(&hurried(folder.path(), Duration::ZERO), &graph);
    assert_eq!((value(&hit, "result"), ran(&hit), warnings(&hit)), (7, vec![], vec![]));
}

#[test]
fn time_enough_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let graph = graph(GRAPH);
    let calm = hurried(folder.path(), Duration::from_secs(3600));
    let first = run(&calm, &graph);
    assert_eq!((value(&first, "result"), warnings(&first).len()), (7, 0));
    assert_eq!(ran(&run(&on_disk(folder.path()), &graph)), [""; 0]);
}

#[test]
fn what_is_compared_or_made_again_takes_its_time() {
    let folder = tempfile::tempdir().unwrap();
    let graph = graph(GRAPH);
    run(&on_disk(folder.path()), &graph);
    let hurry = hurried(folder.path(), Duration::ZERO);
    let verified = hurry.verify(&graph, &graph.wanted(None).unwrap(), &Cancel::default(), &());
    assert_eq!(verified.differences.len(), 0);
    assert_eq!(value(&verified.run, "result"), 7);
}
