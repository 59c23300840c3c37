//! Names of an older version: taken with a warning.

use relight::graph::{GraphFile, Overlay, Registry, ResolvedGraph, Source};

use crate::nodes::*;

fn registry_with_old_names() -> Registry {
    registry()
        .renamed("Plus", "Add")
        .renamed_field("Add", "summand", "plus")
        .renamed_field("Add", "of", "number")
        .renamed_field("Pair", "digits", "ones")
}

/// The graph and its warnings.
fn resolve(
    file: Result<GraphFile, Vec<relight::graph::Diagnostic>>,
    overlay: &Overlay,
) -> (ResolvedGraph, String) {
    let mut file = file.unwrap_or_else(|faults| panic!("{}", list(&faults)));
    file.accept_old_names(&registry_with_old_names());
    let graph = file
        .resolve(&registry_with_old_names(), overlay)
        .unwrap_or_else(|faults| panic!("{}", list(&faults)));
    let warnings = list(graph.warnings());
    (graph, warnings)
}

const OLD: &str = r#"Graph(version: 1, nodes: {
    "n": (op: Const(value: 42)), "p": (op: Pair, in: { "number": "n" }),
    "x": (op: Plus(summand: 5), in: { "of": "p.digits" }),
}, outputs: ["x", "p.digits"])"#;

#[test]
fn old_names_mean_the_new_ones_and_are_told_with_their_places() {
    let (graph, warnings) =
        resolve(GraphFile::parse(Source::new("g.ron", OLD)), &Overlay::default());
    let message = |place: &str, old: &str, new: &str| {
        format!(
            "g.ron:{place}: `{old}` is an old name, which the next version does not accept (write `{new}`)\n"
        )
    };
    let wanted = message("3:15", "Plus", "Add")
        + &message("3:39", "of", "number")
        + &message("3:45", "p.digits", "p.ones")
        + &message("4:19", "p.digits", "p.ones")
        + &message("3:20", "summand", "plus");
    assert_eq!(warnings, wanted);
    let report = run(&in_memory(), &graph);
    assert_eq!((value(&report, "x"), value(&report, "p.ones")), (7, 2));
    // The key is that of the new names.
    let new = OLD
        .replace("Plus", "Add")
        .replace("summand", "plus")
        .replace("\"of\"", "\"number\"")
        .replace("digits", "ones");
    let (same, warnings) =
        resolve(GraphFile::parse(Source::new("g.ron", new)), &Overlay::default());
    assert_eq!(warnings, "");
    let manifest = |graph: &ResolvedGraph| in_memory().explain(graph, "n").unwrap().key_manifest;
    assert_eq!(manifest(&graph), manifest(&same));
    assert_eq!(value(&run(&in_memory(), &same), "x"), 7);
}

#[test]
fn settings_take_old_names_too() {
    let text = r#"Graph(version: 1, nodes: {
        "n": (op: Const(value: 1)), "x": (op: Add, in: { "number": "n" }) }, outputs: ["x"])"#;
    for (set, warnings) in
        [("Plus.summand=10", 2), ("Add.summand=10", 1), ("x.summand=10", 1), ("x.plus=10", 0)]
    {
        let (graph, message) =
            resolve(GraphFile::parse(Source::new("g.ron", text)), &settings(&[set]));
        assert_eq!(
            (value(&run(&in_memory(), &graph), "x"), message.lines().count()),
            (11, warnings),
            "{set}: {message}"
        );
    }
}

#[test]
fn a_child_that_uses_an_old_kind_changes_the_node_and_does_not_replace_it() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write(
        "parent.ron",
        r#"Graph(version: 1, nodes: {
        "n": (op: Const(value: 1)), "x": (op: Add(plus: 3), in: { "number": "n" }), "y": (op: Add, in: { "number": "x" }),
    }, outputs: ["y"])"#,
    );
    for (op, wanted, warnings) in [
        ("Plus(summand: 10)", 12, 2),
        ("Plus()", 5, 1),
        ("Times(by: 9)", 10, 0), // another kind: nothing of the old node stays
    ] {
        let wires = if op.starts_with("Times") { r#", in: { "number": "n" }"# } else { "" };
        let child = format!(
            r#"Graph(version: 1, extends: "parent.ron", nodes: {{ "x": (op: {op}{wires}) }})"#
        );
        write("child.ron", &child);
        let (graph, message) =
            resolve(GraphFile::read(&folder.path().join("child.ron")), &Overlay::default());
        assert_eq!(
            (value(&run(&in_memory(), &graph), "y"), message.lines().count()),
            (wanted, warnings),
            "{op}: {message}"
        );
    }
}

#[test]
#[should_panic(expected = "cannot be an old name")]
fn an_old_name_is_nothing_else() {
    registry().renamed("Add", "Times");
}
