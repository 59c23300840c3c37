//! The store that machines share: what one has computed no other computes, and a store that loses,
//! changes or invents blobs changes no result.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};

use relight::graph::{BlobStore, CacheFolder, EngineOptions, ResolvedGraph, RunReport};

use crate::nodes::*;

/// `slow` is worth a place in the store, all others are quicker to compute than to get.
const GRAPH: &str = r#"nodes: {
    "n": (op: Const(value: 42)), "slow": (op: Slow(), in: { "number": "n" }),
    "add": (op: Add(plus: 1), in: { "number": "slow" }), "text": (op: Show, in: { "number": "add" }),
}, outputs: ["add", "text"]"#;

#[derive(Debug, Default)]
struct Blobs(Mutex<BTreeMap<String, Vec<u8>>>);

impl BlobStore for Blobs {
    fn get(&self, blobs: &[(String, u64)]) -> Vec<Option<Vec<u8>>> {
        let all = self.0.lock().unwrap();
        let found = |(name, most): &(String, u64)| {
            all.get(name).filter(|bytes| bytes.len() as u64 <= *most).cloned()
        };
        blobs.iter().map(found).collect()
    }

    fn put(&self, blobs: Vec<(String, Vec<u8>)>, record: (String, Vec<u8>)) {
        self.0.lock().unwrap().extend(blobs.into_iter().chain([record]));
    }

    fn take_warnings(&self) -> Vec<String> {
        Vec::new()
    }
}

impl Blobs {
    fn names(&self, folder: &str) -> Vec<String> {
        let all = self.0.lock().unwrap();
        all.keys().filter(|name| name.starts_with(folder)).cloned().collect()
    }

    fn change(&self, folder: &str, change: impl Fn(&mut Vec<u8>)) {
        let mut all = self.0.lock().unwrap();
        all.iter_mut().filter(|(name, _)| name.starts_with(folder)).for_each(|(_, b)| change(b));
    }
}

/// A run on a machine whose own cache is `folder`.
fn run_on(folder: &Path, store: &Arc<Blobs>, secret: &[u8], graph: &ResolvedGraph) -> RunReport {
    let store: Arc<dyn BlobStore> = store.clone();
    let cache = CacheFolder { store: Some(store), ..cache(folder, secret) };
    run(&engine(EngineOptions { cache: Some(cache), ..EngineOptions::default() }), graph)
}

/// A store that one machine has filled, and the graph with another end.
fn filled() -> (Arc<Blobs>, ResolvedGraph, ResolvedGraph) {
    let store = Arc::<Blobs>::default();
    let graph = graph(GRAPH);
    let first = tempfile::tempdir().unwrap();
    assert_eq!(ran(&run_on(first.path(), &store, b"own", &graph)).len(), 4);
    (store, graph, graph_with(GRAPH, &settings(&["add.plus=2"])))
}

#[test]
fn a_second_machine_computes_nothing_again() {
    let (store, graph, changed) = filled();
    assert_eq!((store.names("ac/").len(), store.names("cas/").len()), (4, 1));
    let second = tempfile::tempdir().unwrap();
    // All are hits; the values that are wanted are quicker to make than to get.
    let report = run_on(second.path(), &store, b"own", &graph);
    assert_eq!(ran(&report), ["add", "text"]);
    assert_eq!(value(&report, "add"), 43);
    let report = run_on(second.path(), &store, b"own", &changed);
    assert_eq!((ran(&report), value(&report, "add")), (vec!["add", "text"], 44));
    // Its own disk has the fetched value now.
    store.0.lock().unwrap().retain(|name, _| name.starts_with("ac/"));
    let report =
        run_on(second.path(), &store, b"own", &graph_with(GRAPH, &settings(&["add.plus=3"])));
    assert_eq!((ran(&report), value(&report, "add")), (vec!["add", "text"], 45));
}

#[test]
fn a_lost_or_changed_value_is_computed_again_and_replaced() {
    for lose in [true, false] {
        let (store, _, changed) = filled();
        let whole = store.0.lock().unwrap().clone();
        if lose {
            store.0.lock().unwrap().retain(|name, _| name.starts_with("ac/"));
        } else {
            store.change("cas/", |bytes| bytes[0] ^= 1);
        }
        let folder = tempfile::tempdir().unwrap();
        let report = run_on(folder.path(), &store, b"own", &changed);
        assert_eq!((ran(&report), value(&report, "add")), (vec!["n", "slow", "add", "text"], 44));
        let warnings: String = report.nodes.iter().flat_map(|node| node.warnings.clone()).collect();
        assert_eq!(warnings.contains("other bytes than its digest"), !lose, "{warnings}");
        let healed = store.0.lock().unwrap().clone();
        assert!(whole.iter().all(|(name, bytes)| healed.get(name) == Some(bytes)));
    }
}

#[test]
fn a_record_that_lies_is_a_miss() {
    type Lie = fn(&mut BTreeMap<String, Vec<u8>>);
    let lies: [(&str, Lie); 4] = [
        ("under another key", |all| {
            let names: Vec<String> = all.keys().filter(|n| n.starts_with("ac/")).cloned().collect();
            let first = all[&names[0]].clone();
            names.iter().for_each(|name| drop(all.insert(name.clone(), first.clone())));
        }),
        ("cut short", |all| all.values_mut().for_each(|bytes| bytes.truncate(50))),
        ("changed", |all| all.values_mut().for_each(|bytes| *bytes.last_mut().unwrap() ^= 1)),
        ("endless", |all| all.values_mut().for_each(|bytes| bytes.resize(9 << 20, 7))),
    ];
    for (name, lie) in lies {
        let (store, _, changed) = filled();
        lie(&mut store.0.lock().unwrap());
        let folder = tempfile::tempdir().unwrap();
        let report = run_on(folder.path(), &store, b"own", &changed);
        assert_eq!(value(&report, "add"), 44, "{name}");
        assert!(ran(&report).contains(&"slow"), "{name}: {:?}", ran(&report));
    }
}

#[test]
fn records_of_another_key_are_not_used() {
    let (store, graph, _) = filled();
    let folder = tempfile::tempdir().unwrap();
    let report = run_on(folder.path(), &store, b"other", &graph);
    assert_eq!((ran(&report).len(), value(&report, "add")), (4, 43));
    assert!(report.warnings.concat().contains("another key"), "{:?}", report.warnings);
}

#[test]
fn a_damaged_entry_on_disk_comes_from_the_store() {
    let (store, graph, changed) = filled();
    let folder = tempfile::tempdir().unwrap();
    run_on(folder.path(), &store, b"own", &changed);
    for shelf in std::fs::read_dir(folder.path().join("entries")).unwrap() {
        for file in std::fs::read_dir(shelf.unwrap().path()).unwrap() {
            let path = file.unwrap().path();
            let mut bytes = std::fs::read(&path).unwrap();
            *bytes.last_mut().unwrap() ^= 1;
            std::fs::write(&path, bytes).unwrap();
        }
    }
    let report = run_on(folder.path(), &store, b"own", &graph);
    assert_eq!((ran(&report), value(&report, "add")), (vec!["add", "text"], 43));
}
