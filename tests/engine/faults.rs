//! The corpus of bad graph files: each must give exactly the faults that stand at its end, after a
//! line `// WANT`.

use std::path::{Path, PathBuf};

use relight::graph::{Diagnostic, Diagnostics, GraphFile, Overlay, Raw, Source};

use crate::nodes::*;

fn corpus() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bad/graphs")
}

/// `line:column `text under the caret`: message (help)`, with the folder of the corpus left out.
fn show(fault: &Diagnostic) -> String {
    let text = match &fault.origin {
        Some(origin) => {
            let (line, column) = origin.line_column();
            let under = origin.text().lines().next().unwrap_or_default();
            let help = fault.help.as_ref().map_or(String::new(), |help| format!(" ({help})"));
            format!("{line}:{column} `{under}`: {}{help}", fault.message)
        }
        None => fault.to_string(),
    };
    text.replace(&format!("{}/", corpus().display()), "")
}

fn faults(source: std::sync::Arc<Source>) -> Vec<Diagnostic> {
    let found =
        GraphFile::parse(source).and_then(|file| file.resolve(&registry(), &Overlay::default()));
    found.err().unwrap_or_default()
}

#[test]
fn every_bad_graph_gives_all_its_faults_at_their_places() {
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(corpus()).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    let mut wrong = String::new();
    for path in &files {
        let text = std::fs::read_to_string(path).unwrap();
        let (body, wanted) = text.split_once("// WANT\n").unwrap_or((&text, ""));
        let got: String = faults(Source::new(path, body))
            .iter()
            .map(|fault| format!("// {}\n", show(fault)))
            .collect();
        assert!(!got.is_empty(), "{}: no fault was found", path.display());
        if got != wanted {
            wrong += &format!("{}: got\n{got}", path.display());
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
    assert!(files.len() >= 24);
}

#[test]
fn a_hundred_thousand_brackets_are_one_fault() {
    for bracket in ["(", "[", "{", "{\"a\":", "Graph(nodes:{"] {
        let found = faults(Source::new("deep.ron", bracket.repeat(100_000)));
        assert_eq!(found.len(), 1, "{bracket}");
        assert!(
            found[0].message.starts_with("wanted at most 64 levels of brackets"),
            "{}",
            found[0]
        );
    }
}

#[test]
fn a_file_that_is_broken_everywhere_is_told_some_of_it_soon() {
    let entry = "\"a\": (op: Const(value: NaN)), ";
    let found = faults(Source::new(
        "broken.ron",
        format!("Graph(version: 1, nodes: {{ {} }})", entry.repeat(100_000)),
    ));
    assert!((20..=60).contains(&found.len()), "{}", found.len());
    let many: String = (0..200_000).map(|i| format!("\"n{i}\": (op: Konst), ")).collect();
    let found = faults(Source::new(
        "many.ron",
        format!("Graph(version: 1, nodes: {{ {many} }}, outputs: [])"),
    ));
    assert_eq!(found[0].message, "wanted at most 10000 nodes, got 200000");
}

/// Each text has some 200,000 mistakes. Work that grows as their square takes minutes here, and is
/// seen by that.
#[test]
fn two_hundred_thousand_mistakes_are_counted() {
    const MANY: usize = 200_000;
    let all = |one: &dyn Fn(usize) -> String| (0..MANY).map(|i| one(i) + ", ").collect::<String>();
    let nodes = "nodes: { \"c\": (op: Const), \"d\": (op: Const)";
    let sum = |ends: &str| {
        format!("{nodes}, \"s\": (op: Sum, in: {{ \"numbers\": [{ends}] }}) }}, outputs: [\"s\"]")
    };
    for (body, first) in [
        (all(&|i| format!("field_{i}: 1")) + nodes + " }", "unknown field `field_0`"),
        (
            format!("{nodes}, \"a\": (op: Const, {}) }}", all(&|i| format!("f_{i}: 1"))),
            "unknown field `f_0`",
        ),
        (
            format!("{nodes}, \"a\": (op: Const({})) }}", all(&|i| format!("p_{i}: 1"))),
            "Const has no parameter `p_0`",
        ),
        (
            format!("{nodes}, \"a\": (op: Const({})) }}", all(&|_| "value: 1".into())),
            "`value` is given twice",
        ),
        (sum(&all(&|i| format!("\"node_{i}\""))), "unknown node `node_0`"),
        (sum(&all(&|i| format!("\"c.p_{i}\""))), "node `c` (Const) has no output `p_0`"),
        (sum(&all(&|_| "7".into())), "wanted a name in quotes, got `7`"),
        (sum(&",".repeat(MANY)), "wanted a value, got a comma"),
        (
            format!("{nodes} }}, outputs: [{}]", all(&|i| format!("\"o_{i}\""))),
            "unknown node `o_0`",
        ),
        (
            format!("{nodes} }}, sets: {{ {} }}", all(&|i| format!("\"{i}\": []"))),
            "wanted a set name of",
        ),
        (
            format!("{nodes} }}, sets: {{ \"s\": [{}] }}", all(&|i| format!("\"{i}\""))),
            "wanted a member name of",
        ),
    ] {
        let found = faults(Source::new("many.ron", format!("Graph(version: 1, {body})")));
        assert!(found[0].message.starts_with(first), "wanted {first}, got {}", found[0]);
        assert_eq!(found.len(), 51, "{first}");
        let last = found[50]
            .message
            .strip_prefix("and up to ")
            .and_then(|text| text.strip_suffix(" more errors"));
        let more: usize =
            last.and_then(|count| count.parse().ok()).unwrap_or_else(|| panic!("{}", found[50]));
        assert!((MANY - 51..=MANY).contains(&more), "{first}: {more}");
    }
    let found = faults(Source::new("deep.ron", "(".repeat(10 * MANY)));
    assert_eq!(found.len(), 1);
    // One key of two million colons, not two million keys that are longer and longer.
    let found = faults(Source::new(
        "many.ron",
        format!("Graph(version: 1, nodes: {{ {} }})", ":a".repeat(10 * MANY)),
    ));
    assert_eq!(found.len(), 1);
    assert!(found[0].message.starts_with("wanted `{ \"name\": value, .. }`"), "{}", found[0]);
}

#[test]
fn files_that_are_no_text_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let read =
        |name: &str| GraphFile::read(&folder.path().join(name)).err().unwrap()[0].message.clone();
    std::fs::write(folder.path().join("latin1.ron"), b"Graph(\n// caf\xe9\n)").unwrap();
    assert_eq!(read("latin1.ron"), "wanted UTF-8 text, got another byte in line 2");
    assert!(read("missing.ron").starts_with("cannot be read"));
    assert_eq!(read("."), "cannot be read: wanted a regular file, got a folder");
    let huge = std::fs::File::create(folder.path().join("huge.ron")).unwrap();
    huge.set_len(1 << 40).unwrap();
    assert_eq!(
        read("huge.ron"),
        format!("cannot be read: wanted at most 16777216 bytes, got {}", 1u64 << 40)
    );
}

#[test]
fn settings_from_outside_have_faults_at_their_own_place() {
    let text = r#"Graph(version: 1, nodes: { "a": (op: Const), "m": (op: Mixed, in: { "a": "a", "b": "a" }) }, outputs: ["m"])"#;
    let overlay = settings(&[
        "a.valeu=1",
        "Konst.value=1",
        "aa.value=1",
        "a.value=true",
        "m.factor=1",
        "Busy.work=7",
    ]);
    let found = try_graph(text, &overlay).err().unwrap();
    let messages: Vec<String> = found.iter().map(|f| f.to_string()).collect();
    assert_eq!(
        messages,
        [
            "--set:1:1: unknown kind of node `Konst` (did you mean `Const`?)",
            "--set:1:1: the graph has no node `aa` (did you mean `a`?)",
            "--set:1:1: Const has no parameter `valeu` (did you mean `value`?)",
            "--set:1:1: `value` wanted a whole number, such as `12`, got `true`",
        ]
    );
}

#[test]
fn a_number_too_large_for_its_type_is_not_finite() {
    let text = r#"Graph(version: 1, nodes: { "a": (op: Const), "b": (op: Busy(scale: 1e39), in: { "number": "a" }) }, outputs: ["b"])"#;
    let found = try_graph(text, &Overlay::default()).err().unwrap();
    assert_eq!(found[0].message, "`scale` wanted finite numbers, got `1e39`");
}

#[derive(serde::Deserialize, Debug, PartialEq)]
enum Light {
    Off,
    Lamp { at: (f32, f32), name: String },
}

#[test]
fn raw_texts_are_split_with_their_places() {
    let text = "Edit(\n  lights: { \"a\": Off, \"b\": Lamp(at: (1, /* , */ 2), name: \"x, y)\"), r#\"c\"#: Lamp(at: (1, true)) },\n  // done,\n  list: [1, (2, 3), [4],], tuple: Keys(1, (2)),\n)";
    let mut faults = Diagnostics::default();
    let document = Raw::document(&Source::new("e.ron", text), &mut faults).unwrap();
    assert_eq!(document.variant(), Some("Edit"));
    let fields = document.as_struct(Some("Edit"), &["lights", "list", "tuple"], &mut faults);
    let names: Vec<&str> = fields.iter().map(|(key, _)| key.name.as_str()).collect();
    assert_eq!(names, ["lights", "list", "tuple"]);
    let lights = fields[0].1.as_map(&mut faults);
    assert_eq!(
        lights.iter().map(|(key, _)| key.name.as_str()).collect::<Vec<_>>(),
        ["a", "b", "c"]
    );
    assert_eq!(lights[0].1.parse::<Light>().unwrap(), Light::Off);
    assert_eq!(
        lights[1].1.parse::<Light>().unwrap(),
        Light::Lamp { at: (1.0, 2.0), name: "x, y)".into() }
    );
    assert_eq!(lights[2].1.parse::<Light>(), None);
    let texts = |raws: Vec<Raw>| raws.iter().map(|raw| raw.text().to_owned()).collect::<Vec<_>>();
    assert_eq!(texts(fields[1].1.as_list(&mut faults)), ["1", "(2, 3)", "[4]"]);
    assert_eq!(texts(fields[2].1.as_tuple(&mut faults)), ["1", "(2)"]);
    assert!(faults.is_empty(), "{}", list(&faults.into_vec()));
}
