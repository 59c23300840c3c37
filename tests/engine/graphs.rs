//! Meaning of a graph: wires, sets, sources of parameters, and the nodes that a change runs again.

use relight::graph::{
    Cancel, Diagnostics, Ending, EngineOptions, GraphFile, Member, Observer, Overlay, Planned,
    PortValue, Raw, Resolved, ResolvedGraph, Source, Status,
};

use crate::nodes::*;

fn members(set: &str, names: &[&str]) -> Overlay {
    let member = |name: &&str| {
        let source = Source::new("scene.ron", format!("\"{name}\""));
        let origin = Raw::document(&source, &mut Diagnostics::default()).expect("a value").origin;
        Member { set: set.into(), name: name.to_string(), origin }
    };
    Overlay { settings: vec![], members: names.iter().map(member).collect() }
}

#[test]
fn values_travel_along_wires() {
    let graph = graph(
        r#"nodes: {
            "a": (op: Const(value: 4)), "b": (op: Const(value: 5)),
            "m": (op: Mixed, in: { "a": "a", "b": "b.number" }),
            "t": (op: Show, in: { "number": "m" }),
        }, outputs: ["m", "t.text"]"#,
    );
    let report = run(&in_memory(), &graph);
    assert_eq!(value(&report, "m"), 4 * 31 + 5);
    let Some(PortValue::One(text)) = report.output("t.text") else { panic!("no text") };
    assert_eq!(text.get::<Text>().unwrap().0, "129");
    assert!(text.get::<Number>().is_none());
}

const SETS: &str = r#"sets: { "lights": ["lamp", "sun"], "rooms": ["sun", "hall"] }, nodes: {
    "base": (op: Const(value: 100)),
    "split": (op: Split(parts: [("sun", 2), ("lamp", 1), ("hall", 3)])),
    "own": (op: Mixed, each: "lights", in: { "a": "base", "b": "split" }),
    "next": (op: Add, each: "lights", in: { "number": "own" }),
    "other": (op: Maybe, each: "rooms", in: { "number": "base", "more": "next" }),
    "sum": (op: Sum, in: { "numbers": "next" }),
    "parts": (op: Sum, in: { "numbers": "split" }),
    "both": (op: Sum, in: { "numbers": ["own", "other_hall"] }),
    "hall": (op: Split(parts: [("hall", 9)])),
    "other_hall": (op: Split(parts: [("hall", 9)])),
}, outputs: ["next", "other", "sum", "parts", "both"]"#;

#[test]
fn sets_broadcast_gather_and_scatter() {
    let report = run(&in_memory(), &graph(SETS));
    let many = |name: &str| match report.output(name) {
        Some(PortValue::Many(all)) => all
            .iter()
            .map(|(member, v)| (member.clone(), v.get::<Number>().unwrap().0))
            .collect::<Vec<_>>(),
        _ => panic!("{name}"),
    };
    assert_eq!(many("next"), [("lamp".into(), 3102), ("sun".into(), 3103)]);
    // The room `sun` finds its own light; the hall has none.
    assert_eq!(many("other"), [("sun".into(), 100 + 3103), ("hall".into(), 1100)]);
    assert_eq!(value(&report, "sum"), 3102 * 7 + 3103, "in member order");
    assert_eq!(value(&report, "parts"), (2 * 7 + 1) * 7 + 3, "in the order of the scatter");
    assert_eq!(value(&report, "both"), (3101 * 7 + 3102) * 7 + 9);
    let names: Vec<&str> = report.nodes.iter().map(|n| n.name.as_str()).collect();
    assert_eq!(
        names,
        [
            "base",
            "split",
            "own[lamp]",
            "own[sun]",
            "next[lamp]",
            "next[sun]",
            "other[sun]",
            "other[hall]",
            "sum",
            "parts",
            "other_hall",
            "both"
        ]
    );
}

#[test]
fn members_come_from_outside_too() {
    let body = r#"sets: { "s": ["a"] }, nodes: { "c": (op: Const(value: 3)),
        "e": (op: Add, each: "s", in: { "number": "c" }), "sum": (op: Sum, in: { "numbers": "e" }) }, outputs: ["sum"]"#;
    let mut overlay = members("s", &["b", "c"]);
    overlay.members.extend(members("set_of_another_graph", &["x"]).members);
    let report = run(&in_memory(), &graph_with(body, &overlay));
    assert_eq!(value(&report, "sum"), (4 * 7 + 4) * 7 + 4);
    // e[a], e[b] and e[c] are the same work.
    assert_eq!(ran(&report).len(), 3);
}

/// This takes minutes if work grows as the square of the members.
#[test]
fn a_set_may_have_a_hundred_thousand_members() {
    const MANY: usize = 100_000;
    let names: Vec<String> = (0..MANY).map(|i| format!("m{i}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let body = r#"sets: { "s": [], "t": [] }, nodes: { "c": (op: Const(value: 3)),
        "e": (op: Add, each: "s", in: { "number": "c" }), "f": (op: Add, each: "s", in: { "number": "e" }),
        "sum": (op: Sum, in: { "numbers": "f" }) }, outputs: ["sum"]"#;
    let mut overlay = members("s", &names);
    let resolved = graph_with(body, &overlay);
    assert_eq!(resolved.instances().count(), 2 * MANY + 2);
    assert_eq!(resolved.takes_from("f[m99999]"), ["e[m99999]"]);

    overlay.members.extend(members("s", &names).members);
    let twice = try_graph(&format!("Graph(version: 1, {body})"), &overlay)
        .err()
        .expect("each member is there twice");
    assert_eq!(twice[0].message, "set `s` already has a member `m0`");
    assert_eq!(twice[50].message, format!("and up to {} more errors", MANY - 50));

    let mut overlay = members("s", &names);
    overlay.members.extend(members("t", &names[..MANY / 2]).members);
    let unlike = body.replace(r#""e": (op: Add, each: "s""#, r#""e": (op: Add, each: "t""#);
    let lacking = try_graph(&format!("Graph(version: 1, {unlike})"), &overlay)
        .err()
        .expect("`t` has half of them");
    assert_eq!(
        lacking[0].message,
        "input `number` of node `f` (Add) wanted one for member `m50000`, `e` has none"
    );
    assert_eq!(lacking.len(), 51);
}

#[test]
fn a_graph_that_its_sets_make_too_large_is_refused() {
    let names: Vec<String> = (0..2000).map(|i| format!("m{i}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let body = r#"Graph(version: 1, sets: { "s": [] }, nodes: { "c": (op: Const(value: 3)),
        "e": (op: Add, each: "s", in: { "number": "c" }), "all": (op: Sum, each: "s", in: { "numbers": "e" }) })"#;
    let message = |members: Overlay| try_graph(body, &members).err().map(|faults| list(&faults));
    assert_eq!(message(members("s", &names[..900])), None);
    let wanted = "graphs/test.ron: wanted at most 1000000 instances of nodes and wires between them, got 4006001 \
        (set `s` has 2000 members)\n";
    assert_eq!(message(members("s", &names)).as_deref(), Some(wanted));
}

/// As the frames of a sequence are resolved.
#[test]
fn one_overlay_after_the_other_gives_what_each_gives_alone() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.bin"), b"abc").unwrap();
    let text = r#"Graph(version: 1, sets: { "s": ["x"] }, nodes: { "c": (op: Const(value: 1)), "r": (op: Read(file: "a.bin")),
        "e": (op: Mixed, each: "s", in: { "a": "c", "b": "r" }), "sum": (op: Sum, in: { "numbers": "e" }) },
        outputs: ["sum"])"#;
    let source = Source::new(folder.path().join("graph.ron"), text);
    let file = GraphFile::parse(source).unwrap_or_else(|faults| panic!("{}", list(&faults)));
    let keys = |graph: &ResolvedGraph| {
        let report = run(&in_memory(), graph);
        report.nodes.iter().map(|node| (node.name.clone(), node.key)).collect::<Vec<_>>()
    };
    let sound = [
        settings(&["c.value=1"]),
        settings(&["c.value=2"]),
        settings(&["c.value=2", "r.limit=5"]),
        settings(&["r.limit=5", "c.value=2"]),
        members("s", &["y"]),
        Overlay::default(),
        settings(&["Mixed.factor=3.0"]),
        settings(&["c.value=1"]),
    ];
    let mut before = Resolved::default();
    for (i, overlay) in sound.iter().enumerate() {
        let next = file
            .resolve_next(&registry(), overlay, &mut before)
            .unwrap_or_else(|faults| panic!("{}", list(&faults)));
        let alone =
            file.resolve(&registry(), overlay).unwrap_or_else(|faults| panic!("{}", list(&faults)));
        assert_eq!(keys(&next), keys(&alone), "overlay {i}");
        assert!(file.check(&registry(), overlay, &mut before).is_ok());
        // Diagnostics are those of the overlay by itself too, and leave no trace.
        for wrong in [settings(&["r.limit=11"]), settings(&["c.value=x"]), members("s", &["x"])] {
            let got = file.check(&registry(), &wrong, &mut before).expect_err("it is not sound");
            assert_eq!(Some(got), file.resolve(&registry(), &wrong).err(), "overlay {i}");
        }
    }
    // No file is read a second time.
    std::fs::remove_file(folder.path().join("a.bin")).unwrap();
    let last = settings(&["r.limit=7"]);
    assert!(file.check(&registry(), &last, &mut before).is_ok());
    assert!(file.resolve(&registry(), &last).is_err());
}

#[test]
fn an_empty_set_gathers_nothing() {
    let body = r#"sets: { "s": [] }, nodes: { "c": (op: Const), "e": (op: Add, each: "s", in: { "number": "c" }),
        "sum": (op: Sum, in: { "numbers": "e" }), "none": (op: Sum, in: { "numbers": [] }) }, outputs: ["sum", "none", "e"]"#;
    let report = run(&in_memory(), &graph(body));
    assert_eq!((value(&report, "sum"), value(&report, "none")), (0, 0));
    assert_eq!(ran(&report), ["sum"], "`none` is the same work, and nobody needs `c`");
}

#[test]
fn an_optional_wire_may_be_missing() {
    let nodes = r#"nodes: { "c": (op: Const(value: 2)), "m": (op: Maybe, in: { "number": "c" }),
        "n": (op: Maybe, in: { "number": "c", "more": "c" }) }, outputs: ["m", "n"]"#;
    let report = run(&in_memory(), &graph(nodes));
    assert_eq!((value(&report, "m"), value(&report, "n")), (1002, 4));
}

#[test]
fn a_member_that_a_scatter_does_not_give_is_told_when_it_is_known() {
    let body = r#"sets: { "s": ["a", "b"] }, nodes: { "p": (op: Split(parts: [("a", 1)])),
        "e": (op: Add, each: "s", in: { "number": "p" }) }, outputs: ["e"]"#;
    let report = run(&in_memory(), &graph(body));
    assert_eq!(report.with_status(Status::Failed), ["e[b]"]);
    let error = report.nodes.iter().find_map(|n| n.error.clone()).unwrap();
    assert_eq!(error, "input `number` wanted the member `b` of `p.parts`, which gives: a");
    assert_eq!(ran(&report), ["p", "e[a]"]);
}

#[test]
fn a_child_lies_over_its_parents() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write(
        "root.ron",
        r#"Graph(version: 1, scene: "../scenes/a", sets: { "s": ["x"] }, nodes: {
        "c": (op: Const(value: 1)), "d": (op: Const(value: 2)),
        "m": (op: Mixed(factor: 2.0, note: "n"), in: { "a": "c", "b": "d" }) }, outputs: ["m"])"#,
    );
    write(
        "middle.ron",
        r#"Graph(version: 1, extends: "root.ron", sets: { "s": ["y", "z"] },
        nodes: { "m": (in: { "b": "c" }), "c": (op: Const(value: 5)) })"#,
    );
    write(
        "leaf.ron",
        r#"Graph(version: 1, extends: "middle.ron", scene: "b",
        nodes: { "m": (op: Mixed(factor: 3.0)), "d": (op: Add, in: { "number": "m" }) }, outputs: ["d"])"#,
    );
    let file =
        GraphFile::read(&folder.path().join("leaf.ron")).unwrap_or_else(|f| panic!("{}", list(&f)));
    assert_eq!(file.scene().unwrap().unwrap(), folder.path().join("b"));
    assert_eq!(file.sets().next().unwrap().members, ["y", "z"]);
    let graph =
        file.resolve(&registry(), &Overlay::default()).unwrap_or_else(|f| panic!("{}", list(&f)));
    assert_eq!(graph.outputs(), ["m", "d"]);
    let engine = in_memory();
    let report = run(&engine, &graph);
    assert_eq!((value(&report, "m"), value(&report, "d")), (5 * 31 + 5, 5 * 31 + 6));
    let key = engine.explain(&graph, "m").unwrap().key_manifest.unwrap();
    assert!(key.contains("parameter factor: 3.0\nparameter note: Some(\"n\")\n"), "{key}");
}

#[test]
fn wires_are_redirected_by_whatever_name_they_have() {
    let text = r#"Graph(version: 1, nodes: {
        "a": (op: Const(value: 4)), "b": (op: Const(value: 5)),
        "m": (op: Mixed, in: { "a": "a", "b": "a.number" }), "t": (op: Mixed, in: { "a": "m", "b": "b" }),
    }, outputs: ["t"])"#;
    let mut file = GraphFile::parse(Source::new("graph.ron", text)).expect("it is sound");
    let wired =
        |file: &GraphFile, port: &str| file.wired("m", port).map(str::to_owned).collect::<Vec<_>>();
    assert_eq!(
        [wired(&file, "a"), wired(&file, "b"), wired(&file, "c")],
        [vec!["a"], vec!["a.number"], vec![]]
    );
    file.copy("m", "twin");
    file.redirect("a.number", "b.number");
    file.redirect("m", "twin");
    assert_eq!([wired(&file, "a"), wired(&file, "b")], [["b.number"], ["b.number"]]);
    let graph = file
        .resolve(&registry(), &Overlay::default())
        .unwrap_or_else(|faults| panic!("{}", faults[0]));
    assert_eq!(value(&run(&in_memory(), &graph), "t"), (5 * 31 + 5) * 31 + 5);
}

#[test]
fn parameters_come_from_several_sources_and_files_from_the_folder_that_names_them() {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [("graphs", "gg"), ("scene", "sss"), ("edit", "eeee")] {
        std::fs::create_dir(folder.path().join(name)).unwrap();
        std::fs::write(folder.path().join(name).join("f.txt"), text).unwrap();
    }
    let text = r#"Graph(version: 1, nodes: { "a": (op: Read(file: "f.txt")), "b": (op: Read(file: "f.txt", limit: 2)) }, outputs: ["a", "b"])"#;
    let file = GraphFile::parse(Source::new(folder.path().join("graphs/g.ron"), text))
        .unwrap_or_else(|f| panic!("{}", list(&f)));
    let lengths = |overlay: &Overlay| {
        let graph = file.resolve(&registry(), overlay).unwrap_or_else(|f| panic!("{}", list(&f)));
        let report = run(&in_memory(), &graph);
        (value(&report, "a") / 1000, value(&report, "b") / 1000)
    };
    let from = |name: &str, text: &str| setting(folder.path().join(name).to_str().unwrap(), text);
    assert_eq!(lengths(&Overlay::default()), (2, 2));
    let mut overlay =
        Overlay { settings: vec![from("scene/scene.ron", "Read.file=\"f.txt\"")], members: vec![] };
    assert_eq!(lengths(&overlay), (3, 3));
    overlay.settings.push(from("edit/edit.ron", "b.file=\"f.txt\""));
    overlay.settings.push(from("edit/edit.ron", "a.limit=3"));
    assert_eq!(lengths(&overlay), (3, 4));
}

#[test]
fn only_what_is_wanted_runs() {
    let graph = graph(
        r#"nodes: { "a": (op: Const(value: 1)), "b": (op: Add, in: { "number": "a" }), "bad": (op: Fail, in: { "number": "a" }),
        "p": (op: Pair, in: { "number": "b" }) }, outputs: ["bad"]"#,
    );
    let engine = in_memory();
    let report = run_for(&engine, &graph, Some(&["b"]));
    assert_eq!((ran(&report), value(&report, "b")), (vec!["a", "b"], 2));
    let report = run_for(&engine, &graph, Some(&["p", "p.ones"]));
    assert_eq!(ran(&report), ["p"]);
    assert_eq!((value(&report, "p.tens"), value(&report, "p.ones")), (0, 2));
    let fault = graph.wanted(Some(&["p.one".into()])).err().unwrap();
    assert_eq!(fault.to_string(), "node `p` (Pair) has no output `one` (did you mean `ones`?)");
    let fault = graph.wanted(Some(&["bat".into()])).err().unwrap();
    assert_eq!(fault.to_string(), "the graph has no node `bat` (did you mean `bad`?)");
}

#[test]
fn the_same_work_is_done_once() {
    let graph = graph(
        r#"nodes: { "a": (op: Const(value: 1)), "b": (op: Const(value: 1)), "x": (op: Add, in: { "number": "a" }),
        "y": (op: Add, in: { "number": "b" }) }, outputs: ["x", "y"]"#,
    );
    for memory_bytes in [0, 1 << 20] {
        let engine = engine(EngineOptions { memory_bytes, ..EngineOptions::default() });
        let report = run(&engine, &graph);
        assert_eq!((value(&report, "x"), value(&report, "y")), (2, 2));
        assert!(
            memory_bytes == 0
                || (ran(&report).len(), report.with_status(Status::Hit).len()) == (2, 2)
        );
    }
}

#[test]
fn the_same_work_at_the_same_time_is_done_once_and_nobody_waits_for_ever() {
    // Each of these uses all threads inside, so that a thread that waits in one takes up another of
    // the same key.
    let busy =
        |i: usize| format!("\"n{i}\": (op: Busy(work: 300000), in: {{ \"number\": \"c\" }}), ");
    let fail = |i: usize| format!("\"f{i}\": (op: Fail, in: {{ \"number\": \"c\" }}), ");
    let nodes: String = (0..16).map(busy).chain((0..4).map(fail)).collect();
    let names: Vec<String> =
        (0..16).map(|i| format!("\"n{i}\"")).chain((0..4).map(|i| format!("\"f{i}\""))).collect();
    let graph = graph(&format!(
        "nodes: {{ \"c\": (op: Const), {nodes} }}, outputs: [{}]",
        names.join(", ")
    ));
    for _ in 0..20 {
        let report =
            run(&engine(EngineOptions { threads: Some(4), ..EngineOptions::default() }), &graph);
        assert_eq!(ran(&report).len(), 2, "{:?}", ran(&report));
        assert_eq!(report.with_status(Status::Hit).len(), 15);
        assert_eq!(report.with_status(Status::Failed), ["f0", "f1", "f2", "f3"]);
        assert!(
            report
                .nodes
                .iter()
                .filter(|n| n.status == Status::Failed)
                .all(|n| n.error.as_deref() == Some("on purpose"))
        );
    }
}

const TWO_PORTS: &str = r#"nodes: { "n": (op: Const(value: 42)), "p": (op: Pair, in: { "number": "n" }),
    "tens": (op: Add, in: { "number": "p.tens" }), "ones": (op: Add, in: { "number": "p.ones" }),
    "end": (op: Mixed, in: { "a": "tens", "b": "ones" }) }, outputs: ["end"]"#;

#[test]
fn a_port_that_stays_the_same_stops_the_wave() {
    let engine = in_memory();
    assert_eq!(ran(&run(&engine, &graph(TWO_PORTS))).len(), 5);
    let report = run(&engine, &graph_with(TWO_PORTS, &settings(&["n.value=47"])));
    assert_eq!(ran(&report), ["n", "p", "ones", "end"]);
    assert_eq!(why(&report, "n"), "parameter value: 42 -> 47");
    assert_eq!(why(&report, "end"), "input b changed");
    assert_eq!(value(&report, "end"), 5 * 31 + 8);
    assert_eq!(ran(&run(&engine, &graph(TWO_PORTS))), [] as [&str; 0]);
}

#[test]
fn a_member_that_stays_the_same_stops_the_wave() {
    let body = r#"sets: { "s": ["a", "b"] }, nodes: { "p": (op: Split(parts: [("a", 1), ("b", 2)])),
        "e": (op: Add, each: "s", in: { "number": "p" }), "sum": (op: Sum, in: { "numbers": "e" }) }, outputs: ["sum"]"#;
    let engine = in_memory();
    assert_eq!(ran(&run(&engine, &graph(body))).len(), 4);
    let report = run(&engine, &graph_with(body, &settings(&["p.parts=[(\"a\", 1), (\"b\", 9)]"])));
    assert_eq!(ran(&report), ["p", "e[b]", "sum"]);
    assert_eq!(why(&report, "sum"), "input numbers[b] changed");
    let more = members("s", &["c"]);
    let overlay = Overlay {
        members: more.members,
        ..settings(&["p.parts=[(\"a\", 1), (\"b\", 9), (\"c\", 3)]"])
    };
    let report = run(&engine, &graph_with(body, &overlay));
    assert_eq!(ran(&report), ["p", "e[c]", "sum"]);
    assert_eq!(why(&report, "sum"), "input numbers[c] is new");
}

#[test]
fn a_failure_blocks_only_what_needs_it() {
    let graph = graph(
        r#"nodes: { "a": (op: Const), "bad": (op: Fail, in: { "number": "a" }), "after": (op: Add, in: { "number": "bad" }),
        "last": (op: Show, in: { "number": "after" }), "good": (op: Add, in: { "number": "a" }) }, outputs: ["last", "good"]"#,
    );
    let engine = in_memory();
    for _ in 0..2 {
        let report = run(&engine, &graph);
        assert_eq!(report.with_status(Status::Failed), ["bad"], "a failure is not kept");
        assert_eq!(report.with_status(Status::Blocked), ["after", "last"]);
        assert_eq!(
            report.nodes[3].error.as_deref().or(report.nodes[4].error.as_deref()),
            Some("needs bad, which failed")
        );
        assert_eq!(value(&report, "good"), 1);
        assert!(
            report.output("last").is_none()
                && report.ending() == Ending::Failed
                && !report.is_complete()
        );
    }
}

#[test]
fn a_panic_is_a_failure_that_says_it_is_a_bug() {
    let graph = graph(
        r#"nodes: { "a": (op: Const), "p": (op: Panic, in: { "number": "a" }) }, outputs: ["p", "a"]"#,
    );
    let engine = in_memory();
    let report = run(&engine, &graph);
    assert_eq!(report.nodes[1].error.as_deref(), Some("a bug in Panic: it panicked: on purpose"));
    assert_eq!(value(&report, "a"), 0);
    assert_eq!(run(&engine, &graph).with_status(Status::Failed), ["p"]);
}

#[test]
fn a_cancelled_run_stops_and_keeps_nothing_unfinished() {
    let graph = graph(
        r#"nodes: { "a": (op: Const), "stop": (op: Stop, in: { "number": "a" }), "b": (op: Add, in: { "number": "stop" }) },
        outputs: ["b"]"#,
    );
    let report = run_cancelled(&graph);
    assert_eq!(ran(&report), ["a"]);
    assert_eq!(report.with_status(Status::Cancelled), ["stop", "b"]);
    let before = Cancel::default();
    before.cancel();
    let report = in_memory().run(&graph, &graph.wanted(None).unwrap(), &before, &());
    assert_eq!(report.with_status(Status::Cancelled).len(), 3);
}

#[test]
fn a_key_holds_everything_that_counts_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("secret_name.txt"), "hello").unwrap();
    let text = r#"Graph(version: 1, nodes: { "reader_name": (op: Read(file: "secret_name.txt")) }, outputs: ["reader_name"])"#;
    let file = GraphFile::parse(Source::new(folder.path().join("g.ron"), text))
        .unwrap_or_else(|f| panic!("{}", list(&f)));
    let graph =
        file.resolve(&registry(), &Overlay::default()).unwrap_or_else(|f| panic!("{}", list(&f)));
    let engine = engine(EngineOptions { threads: Some(3), ..EngineOptions::default() });
    let text = engine.explain(&graph, "reader_name").unwrap().key_manifest.unwrap();
    let digest = blake3::hash(b"hello").to_hex();
    let wanted = format!(
        "engine 5\nkind Read\nversion 1\nparameter file: \"blake3:{digest}\"\nparameter limit: 10\n"
    );
    assert_eq!(text, wanted);
}

#[test]
fn explain_names_the_first_line_that_differs() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("f.txt");
    std::fs::write(&file, "one").unwrap();
    let body = format!(
        r#"nodes: {{ "r": (op: Read(file: {file:?})), "p": (op: Pair, in: {{ "number": "r" }}), "x": (op: Add, in: {{ "number": "p.ones" }}) }}, outputs: ["x"]"#
    );
    let engine = in_memory();
    let explain = |graph: &_, node: &str| engine.explain(graph, node).unwrap();
    assert_eq!(explain(&graph(&body), "r").why, "new");
    run(&engine, &graph(&body));
    assert_eq!(explain(&graph(&body), "r").why, "nothing changed");
    std::fs::write(&file, "three").unwrap();
    let (changed, before) = (graph(&body), explain(&graph(&body), "r"));
    assert_eq!(
        (before.status, before.why.as_str()),
        (Planned::Run, "parameter file: file changed")
    );
    assert!(before.old.unwrap().contains(&*blake3::hash(b"one").to_hex()));
    assert!(before.new.unwrap().contains(&*blake3::hash(b"three").to_hex()));
    assert_eq!(explain(&changed, "x").why, "depends on the result of p");
    let plan: Vec<_> = engine
        .plan(&changed, &changed.wanted(None).unwrap())
        .into_iter()
        .map(|l| (l.node, l.status))
        .collect();
    assert_eq!(
        plan,
        [
            ("r".into(), Planned::Run),
            ("p".into(), Planned::Unknown),
            ("x".into(), Planned::Unknown)
        ]
    );
    run(&engine, &changed);
    assert!(
        engine
            .plan(&changed, &changed.wanted(None).unwrap())
            .iter()
            .all(|l| l.status == Planned::Hit)
    );
    let fault = engine.explain(&changed, "rr").err().unwrap();
    assert!(fault.to_string().contains("the graph has no node `rr`"), "{fault}");
}

#[test]
fn verify_makes_hits_again_and_finds_what_differs() {
    let body = r#"nodes: { "a": (op: Const), "i": (op: Impure, in: { "number": "a" }), "p": (op: Pair, in: { "number": "i" }) }, outputs: ["p.ones"]"#;
    let (engine, graph) = (in_memory(), graph(body));
    let wanted = graph.wanted(None).unwrap();
    run(&engine, &graph);
    let report = engine.verify(&graph, &wanted, &Cancel::default(), &());
    let found: Vec<_> =
        report.differences.iter().map(|d| (d.node.as_str(), d.port.as_str())).collect();
    assert_eq!(found, [("i", "number")]);
    assert_eq!(report.run.with_status(Status::Hit), ["a", "i", "p"]);
}

#[test]
fn reports_tell_rays_errors_warnings_also_of_hits() {
    #[derive(Default)]
    struct Log(std::sync::Mutex<Vec<String>>);
    impl Observer for Log {
        fn needs(&self, kinds: &[&str]) {
            self.0.lock().unwrap().push(kinds.join(" and "));
        }
        fn started(&self, node: &str) {
            self.0.lock().unwrap().push(format!("{node} started"));
        }
        fn finished(&self, report: &relight::graph::NodeReport) {
            self.0.lock().unwrap().push(format!("{} {:?}", report.name, report.status));
        }
    }
    let graph = graph(
        r#"nodes: { "a": (op: Const), "b": (op: Busy(note: true), in: { "number": "a" }) }, outputs: ["b"]"#,
    );
    let engine = in_memory();
    let log = Log::default();
    let report = engine.run(&graph, &graph.wanted(None).unwrap(), &Cancel::default(), &log);
    let busy = &report.nodes[1];
    assert_eq!((busy.rays, busy.stderr, busy.bytes, busy.warnings.len()), (1000, Some(0.25), 8, 1));
    assert_eq!(
        *log.0.lock().unwrap(),
        ["Busy and Const", "a started", "a Ran", "b started", "b Ran"]
    );
    let again = run(&engine, &graph);
    let hit = &again.nodes[1];
    assert_eq!(
        (hit.rays, hit.stderr, hit.bytes, &hit.warnings),
        (0, Some(0.25), 8, &busy.warnings)
    );
    assert_eq!((hit.key, hit.status), (busy.key, Status::Hit));
}

#[test]
fn drawings_show_instances_wires_and_what_became_of_them() {
    let graph = graph(SETS);
    let report = run(&in_memory(), &graph);
    let dot = graph.to_dot(Some(&report));
    assert!(dot.contains("label=\"own[lamp]\\nMixed\", fillcolor=lightgreen"), "{dot}");
    assert!(graph.to_mermaid(None).contains("[\"own[sun]<br>Mixed\"]"));
    let json: serde_json::Value = serde_json::from_str(&graph.to_json(Some(&report))).unwrap();
    assert_eq!(json["nodes"].as_array().unwrap().len(), graph.instances().count());
    assert!(
        json["edges"]
            .as_array()
            .unwrap()
            .iter()
            .any(|e| e["from_port"] == "parts[lamp]" && e["to"] == "own[lamp]")
    );
}

#[test]
fn a_chain_of_ten_thousand_nodes_needs_no_deep_stack() {
    let link = |i: usize| format!("\"n{i}\": (op: Add, in: {{ \"number\": \"n{}\" }}), ", i - 1);
    let nodes: String = (1..10_000).map(link).collect();
    let graph = graph(&format!("nodes: {{ \"n0\": (op: Const), {nodes} }}, outputs: [\"n9999\"]"));
    assert_eq!(value(&run(&in_memory(), &graph), "n9999"), 9999);
}
