//! Nodes that run only if the output of another node holds.

use relight::graph::{Cancel, Observer, Overlay, Planned, PortValue, Status};

use crate::nodes::*;

/// `c`, and `costly` for it alone, run when `n` is positive.
fn conditional(n: i64) -> relight::graph::ResolvedGraph {
    graph(&format!(
        r#"nodes: {{
            "n": (op: Const(value: {n})),
            "sign": (op: Sign, in: {{ "number": "n" }}),
            "costly": (op: Add(plus: 10), in: {{ "number": "n" }}),
            "c": (op: Times(by: 2), when: "sign.positive", in: {{ "number": "costly" }}),
            "next": (op: Add(plus: 1), in: {{ "number": "c" }}),
            "end": (op: Maybe, in: {{ "number": "n", "more": "next" }}),
        }}, outputs: ["end"]"#
    ))
}

#[test]
fn without_its_condition_a_node_and_all_that_only_it_needs_stay_out() {
    let engine = in_memory();
    let report = run(&engine, &conditional(-5));
    assert_eq!((ran(&report), value(&report, "end")), (vec!["n", "sign", "end"], 995));
    assert!(report.is_complete() && report.nodes.len() == 3, "what is skipped is not reported");
    let report = run(&engine, &conditional(5));
    assert_eq!(
        (ran(&report), value(&report, "end")),
        (vec!["n", "sign", "costly", "c", "next", "end"], 5 + 31)
    );
    // Both are known now, each with its own nodes.
    for (n, hits) in [(-5, 3), (5, 6)] {
        let report = run(&engine, &conditional(n));
        assert_eq!((ran(&report).len(), report.with_status(Status::Hit).len()), (0, hits));
    }
    // A wanted node that is skipped gives nothing.
    let report = run_for(&engine, &conditional(-5), Some(&["next", "costly"]));
    assert!(report.is_complete() && report.output("next").is_none());
    assert_eq!((value(&report, "costly"), ran(&report)), (5, vec!["costly"]));
}

#[test]
fn a_condition_stands_in_no_key_and_comes_from_the_cache_too() {
    let folder = tempfile::tempdir().unwrap();
    run(&on_disk(folder.path()), &conditional(5));
    let engine = on_disk(folder.path());
    let report = run(&engine, &conditional(5));
    assert_eq!((ran(&report), value(&report, "end")), (vec![], 36));
    let key = engine.explain(&conditional(5), "c").unwrap().key_manifest.unwrap();
    assert!(!key.contains("sign") && !key.contains("Flag"), "{key}");
    // 5 and 6 are both positive: no node behind the condition runs again because of it.
    let report = run(&engine, &conditional(6));
    assert_eq!(ran(&report), ["n", "sign", "costly", "c", "next", "end"]);
}

#[test]
fn members_have_conditions_of_their_own_and_a_gather_takes_those_that_are_there() {
    let body = r#"sets: { "all": ["a", "b", "c"] }, nodes: {
        "split": (op: Split(parts: [("a", 1), ("b", -2), ("c", 3)])),
        "sign": (op: Sign, each: "all", in: { "number": "split" }),
        "own": (op: Add(plus: 0), each: "all", when: "sign.positive", in: { "number": "split" }),
        "after": (op: Add(plus: 1), each: "all", in: { "number": "own" }),
        "sum": (op: Sum, in: { "numbers": "after" }),
        "n": (op: Const(value: 0)),
        "zero": (op: Sign, in: { "number": "n" }),
        "none": (op: Add, each: "all", when: "zero.positive", in: { "number": "split" }),
        "empty": (op: Sum, in: { "numbers": "none" }),
    }, outputs: ["sum", "after", "empty", "none"]"#;
    let report = run(&in_memory(), &graph(body));
    assert_eq!((value(&report, "sum"), value(&report, "empty")), (2 * 7 + 4, 0));
    let Some(PortValue::Many(all)) = report.output("after") else { panic!("no members") };
    assert_eq!(all.iter().map(|(member, _)| member.as_str()).collect::<Vec<_>>(), ["a", "c"]);
    assert!(report.output("none").is_none());
    let names: Vec<_> = report
        .nodes
        .iter()
        .map(|node| node.name.as_str())
        .filter(|name| name.contains("[b]"))
        .collect();
    assert_eq!(names, ["sign[b]"]);
}

#[test]
fn a_condition_that_fails_blocks_and_nothing_is_computed_for_its_node() {
    let body = r#"nodes: {
        "n": (op: Const(value: 1)),
        "bad": (op: Fail, in: { "number": "n" }),
        "sign": (op: Sign, in: { "number": "bad" }),
        "costly": (op: Add, in: { "number": "n" }),
        "c": (op: Add, when: "sign.positive", in: { "number": "costly" }),
        "fine": (op: Add(plus: 7), in: { "number": "n" }),
    }, outputs: ["c", "fine"]"#;
    let report = run(&in_memory(), &graph(body));
    assert_eq!(ran(&report), ["n", "fine"]);
    assert_eq!(
        (report.with_status(Status::Failed), report.with_status(Status::Blocked)),
        (vec!["bad"], vec!["sign", "c"])
    );
}

#[test]
fn plan_and_explain_tell_what_a_condition_decides() {
    let engine = in_memory();
    let plan = |n: i64| {
        let graph = conditional(n);
        let lines = engine.plan(&graph, &graph.wanted(None).unwrap()).into_iter();
        lines.map(|line| (line.node, line.status, line.why.unwrap_or_default())).collect::<Vec<_>>()
    };
    let explain = |n: i64, node: &str| {
        let answer = engine.explain(&conditional(n), node).unwrap();
        (answer.status, answer.why)
    };
    let unknown = |node: &str, on: &str| {
        (node.to_owned(), Planned::Unknown, format!("depends on the result of {on}"))
    };
    let run_of = |node: &str, why: &str| (node.to_owned(), Planned::Run, why.to_owned());
    let new = [
        run_of("n", "new"),
        unknown("sign", "n"),
        unknown("costly", "sign"),
        unknown("c", "sign"),
        unknown("next", "c"),
        unknown("end", "n"),
    ];
    assert_eq!(plan(-5), new);
    run(&engine, &conditional(-5));
    let hits = plan(-5);
    assert_eq!(hits.iter().map(|line| line.0.as_str()).collect::<Vec<_>>(), ["n", "sign", "end"]);
    assert!(hits.iter().all(|line| line.1 == Planned::Hit));
    assert_eq!(explain(-5, "c"), (Planned::Skip, "sign.positive is false".to_owned()));
    assert_eq!(explain(-5, "next"), (Planned::Skip, "sign.positive is false".to_owned()));
    assert_eq!(explain(-5, "costly"), (Planned::Run, "new".to_owned()));
    run(&engine, &conditional(5));
    assert_eq!(plan(5).len(), 6);
    assert_eq!(explain(-5, "c").0, Planned::Skip);
}

#[test]
fn a_watcher_is_told_of_nodes_as_they_turn_out_to_be_needed() {
    #[derive(Default)]
    struct Counts(std::sync::Mutex<Vec<usize>>);
    impl Observer for Counts {
        fn needs(&self, kinds: &[&str]) {
            self.0.lock().unwrap().push(kinds.len());
        }
    }
    for (n, wanted) in [(-5, &[3][..]), (5, &[3, 2, 1])] {
        let (graph, counts) = (conditional(n), Counts::default());
        let report =
            in_memory().run(&graph, &graph.wanted(None).unwrap(), &Cancel::default(), &counts);
        let counts = counts.0.into_inner().unwrap();
        assert_eq!((counts.as_slice(), counts.iter().sum::<usize>()), (wanted, report.nodes.len()));
    }
}

#[test]
fn conditions_are_checked_before_any_work() {
    let check = |when: &str, more: &str, wanted: &str| {
        let text = format!(
            r#"Graph(version: 1, sets: {{ "all": ["a"], "few": [] }}, nodes: {{
                "n": (op: Const), "sign": (op: Sign, in: {{ "number": "n" }}),
                "split": (op: Split(parts: [("a", 1)])),
                "each": (op: Sign, each: "few", in: {{ "number": "split" }}),
                "c": (op: Add, {more} when: "{when}", in: {{ "number": "n" }}),
            }}, outputs: ["c"])"#
        );
        let faults = try_graph(&text, &Overlay::default()).err().unwrap_or_default();
        assert!(list(&faults).contains(wanted), "{when}: wanted {wanted}, got {}", list(&faults));
    };
    check("sing.positive", "", "unknown node `sing`");
    check("sign.negative", "", "node `sign` (Sign) has no output `negative`");
    check("sign", "", "node `sign` (Sign) has 2 outputs");
    check(
        "sign.number",
        "",
        "input `when` of node `c` (Add) wanted Flag, got Number from `sign.number`",
    );
    check("each.positive", "", "wanted one Flag, got one per member of `few`");
    check("each.positive", "each: \"all\",", "wanted one for member `a`, `each` has none");
    let looped = r#"Graph(version: 1, nodes: {
        "sign": (op: Sign, in: { "number": "c" }), "n": (op: Const),
        "c": (op: Add, when: "sign.positive", in: { "number": "n" }),
    }, outputs: ["c"])"#;
    let faults = try_graph(looped, &Overlay::default()).err().unwrap_or_default();
    assert!(
        list(&faults).contains("these nodes form a cycle: sign -> c -> sign"),
        "{}",
        list(&faults)
    );
}
