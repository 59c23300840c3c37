//! Random graphs under random edits: the cache never changes a result, nor does the number of
//! threads.

use proptest::prelude::*;
use relight::graph::{EngineOptions, PortValue};

use crate::nodes::*;

/// A node of a random graph: which kind, a parameter, and two earlier nodes.
type Link = (u8, i64, usize, usize);

fn text(links: &[Link]) -> String {
    let mut nodes = String::from(r#""n0": (op: Const(value: 7)), "#);
    for (i, &(kind, value, a, b)) in links.iter().enumerate() {
        let (name, a, b) = (i + 1, a % (i + 1), b % (i + 1));
        let from = |n: usize| {
            if n > 0 && links[n - 1].0 % 6 == 5 { format!("n{n}.ones") } else { format!("n{n}") }
        };
        let (a, b) = (from(a), from(b));
        nodes += &match kind % 6 {
            0 => format!(r#""n{name}": (op: Const(value: {value})), "#),
            1 => format!(r#""n{name}": (op: Add(plus: {value}), in: {{ "number": "{a}" }}), "#),
            2 => format!(r#""n{name}": (op: Mixed, in: {{ "a": "{a}", "b": "{b}" }}), "#),
            3 => format!(r#""n{name}": (op: Maybe, in: {{ "number": "{a}", "more": "{b}" }}), "#),
            4 => format!(
                r#""e{name}": (op: Mixed, each: "s", in: {{ "a": "{a}", "b": "p" }}), "n{name}": (op: Sum, in: {{ "numbers": "e{name}" }}), "#
            ),
            _ => format!(r#""n{name}": (op: Pair, in: {{ "number": "{a}" }}), "#),
        };
    }
    let last = if links.last().is_some_and(|l| l.0 % 6 == 5) { ".tens" } else { "" };
    format!(
        r#"sets: {{ "s": ["a", "b"] }}, nodes: {{ "p": (op: Split(parts: [("b", 5), ("a", {})])), {nodes} }}, outputs: ["n{}{last}"]"#,
        links.len() % 3,
        links.len()
    )
}

fn end(report: &relight::graph::RunReport) -> i64 {
    let Some((_, PortValue::One(value))) = report.outputs.first() else {
        panic!("no output: {:?}", report.nodes)
    };
    value.get::<Number>().unwrap().0
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_cached_run_after_random_edits_equals_a_fresh_one(
        links in prop::collection::vec((0u8..6, 0i64..4, 0usize..20, 0usize..20), 1..20),
        edits in prop::collection::vec((0usize..20, 0u8..6, 0i64..4), 1..6),
        memory_bytes in prop::sample::select(vec![0u64, 1500, 1 << 20]),
        to_disk in any::<bool>(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let cached = engine(EngineOptions {
            cache: to_disk.then(|| cache(folder.path(), b"own")),
            memory_bytes,
            disk_bytes: 20_000,
            threads: Some(2),
            ..EngineOptions::default()
        });
        let mut links = links;
        for (at, kind, value) in edits {
            let graph = graph(&text(&links));
            let fresh = engine(EngineOptions { memory_bytes: 0, threads: Some(1), ..EngineOptions::default() });
            prop_assert_eq!(end(&run(&cached, &graph)), end(&run(&fresh, &graph)));
            let again = run(&cached, &graph);
            if memory_bytes == 1 << 20 {
                prop_assert_eq!(ran(&again).len(), 0);
            }
            let count = links.len();
            links[at % count].0 = kind;
            links[at % count].1 = value;
        }
    }
}

#[test]
fn one_two_and_four_threads_give_the_same_keys_and_values() {
    let links: Vec<Link> =
        (0..60).map(|i| ((i * 7 % 6) as u8, i as i64, i * 5, i * 3 + 1)).collect();
    let mut body = text(&links);
    body = body.replace(
        "nodes: {",
        r#"nodes: { "busy": (op: Busy(work: 200000), in: { "number": "n3" }), "#,
    );
    body = body.replace("outputs: [", r#"outputs: ["busy", "#);
    let digests = |threads| {
        let engine = engine(EngineOptions { threads: Some(threads), ..EngineOptions::default() });
        let report = run(&engine, &graph(&body));
        assert!(report.is_complete());
        let keys: Vec<_> = report.nodes.iter().map(|n| (n.name.clone(), n.key)).collect();
        (keys, value(&report, "busy"))
    };
    let one = digests(1);
    assert_eq!(one, digests(2));
    assert_eq!(one, digests(4));
}
