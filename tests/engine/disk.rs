//! The disk cache: damaged results are recomputed, failed writes do not stop a run, several runs
//! may share a cache.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use relight::graph::{
    Artifact, Cancel, EarlierResults, EngineOptions, ResolvedGraph, Status, Value,
};

use crate::nodes::*;

const GRAPH: &str = r#"nodes: {
    "n": (op: Const(value: 42)), "p": (op: Pair, in: { "number": "n" }), "s": (op: Split(parts: [("a", 1), ("b", 2)])),
    "x": (op: Busy(note: true), in: { "number": "p.ones" }), "sum": (op: Sum, in: { "numbers": "s" }),
    "end": (op: Mixed, in: { "a": "x", "b": "sum" }), "text": (op: Show, in: { "number": "end" }),
}, outputs: ["end", "text"]"#;

fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for shelf in std::fs::read_dir(folder.join("entries")).into_iter().flatten() {
        files.extend(
            std::fs::read_dir(shelf.unwrap().path()).unwrap().map(|file| file.unwrap().path()),
        );
    }
    files.sort();
    files
}

fn filled(body: &str) -> (tempfile::TempDir, ResolvedGraph, i64) {
    let folder = tempfile::tempdir().unwrap();
    let graph = graph(body);
    let end = value(&run(&on_disk(folder.path()), &graph), "end");
    (folder, graph, end)
}

#[test]
fn a_new_process_finds_everything() {
    let (folder, graph, end) = filled(GRAPH);
    let report = run(&on_disk(folder.path()), &graph);
    assert_eq!((ran(&report), value(&report, "end")), (vec![], end));
    assert_eq!(
        report.nodes.iter().find(|n| n.name == "x").unwrap().warnings,
        ["this is only a test"]
    );
    // The last keys are known too: a change is explained.
    let changed = graph_with(GRAPH, &settings(&["n.value=43"]));
    let report = run(&on_disk(folder.path()), &changed);
    assert_eq!(
        (ran(&report), why(&report, "n")),
        (vec!["n", "p", "x", "end", "text"], "parameter value: 42 -> 43")
    );
    assert_eq!(why(&report, "x"), "input number changed");
    let stat = disk_cache(folder.path()).stat().unwrap();
    assert_eq!((stat.entries, stat.damaged), (7 + 5, 0));
}

#[test]
fn a_large_result_that_is_quick_to_make_is_not_stored() {
    let body = |length: usize| {
        format!(
            r#"nodes: {{ "n": (op: Const(value: 4)), "r": (op: Repeat(length: {length}), in: {{ "number": "n" }}),
            "l": (op: Length, in: {{ "text": "r" }}) }}, outputs: ["l"]"#
        )
    };
    for (length, is_stored) in [(900, true), (5000, false)] {
        let folder = tempfile::tempdir().unwrap();
        let on = |settings_of: &[&str]| {
            let graph = graph_with(&body(length), &settings(settings_of));
            run(&on_disk(folder.path()), &graph)
        };
        assert_eq!(value(&on(&[]), "l"), length as i64);
        let bytes: u64 =
            entries(folder.path()).iter().map(|file| file.metadata().unwrap().len()).sum();
        // Headers take a few hundred bytes each.
        assert!(bytes < 3000 && (!is_stored || bytes > length as u64), "{bytes} bytes");
        // Its header is there, so that nothing runs while nobody needs the text.
        assert_eq!(ran(&on(&[])), [] as [&str; 0]);
        let changed = on(&["l.plus=1"]);
        assert_eq!(value(&changed, "l"), length as i64 + 1);
        if is_stored {
            assert_eq!(ran(&changed), ["l"]);
        } else {
            assert_eq!(ran(&changed), ["r", "l"]);
            assert_eq!(why(&changed, "r"), "a result of this size is quicker to make than to read");
        }
        assert_eq!(disk_cache(folder.path()).verify().unwrap().damaged, 0);
        let graph = graph_with(&body(length), &settings(&[]));
        let engine = on_disk(folder.path());
        let report = engine.verify(&graph, &graph.wanted(None).unwrap(), &Cancel::default(), &());
        assert!(report.differences.is_empty());
    }
}

#[test]
fn what_is_made_again_is_made_once_for_all_its_values() {
    let body = r#"nodes: {
        "n": (op: Const(value: 4)), "t": (op: Texts, in: { "number": "n" }),
        "j": (op: Join, in: { "first": "t.first", "second": "t.second" }),
    }, outputs: ["j"]"#;
    let folder = tempfile::tempdir().unwrap();
    let graph = graph(body);
    // Neither memory nor disk keeps the texts.
    let on = || {
        let cache = Some(cache(folder.path(), b"own"));
        let engine = engine(EngineOptions { cache, memory_bytes: 0, ..EngineOptions::default() });
        let report = run(&engine, &graph);
        assert_eq!(report.value::<Text>("j").unwrap().0, "4".repeat(5000) + &"5".repeat(5000));
        TEXTS.swap(0, std::sync::atomic::Ordering::Relaxed)
    };
    assert_eq!((on(), on()), (1, 1));
}

/// A text that an earlier run left somewhere.
#[derive(Debug)]
struct Left(&'static str);

impl EarlierResults for Left {
    fn value(&self, type_name: &str) -> Option<Value> {
        (type_name == Text::TYPE).then(|| Value::new(Arc::new(Text(self.0.repeat(5000)))))
    }
}

#[test]
fn a_result_that_is_not_stored_is_taken_from_an_earlier_run_if_it_is_the_same() {
    let body = r#"nodes: { "n": (op: Const(value: 4)), "r": (op: Repeat(length: 5000), in: { "number": "n" }) }, outputs: ["r"]"#;
    let folder = tempfile::tempdir().unwrap();
    let on = |left: Option<&'static str>, number: &str| {
        let earlier = left.map(|text| Arc::new(Left(text)) as Arc<dyn EarlierResults>);
        let engine = engine(EngineOptions {
            cache: Some(cache(folder.path(), b"own")),
            earlier,
            ..EngineOptions::default()
        });
        let report = run(&engine, &graph_with(body, &settings(&[number])));
        assert_eq!(report.value::<Text>("r").unwrap().0, number[8..].repeat(5000));
        ran(&report).len()
    };
    assert_eq!(on(Some("4"), "n.value=4"), 2, "no header tells that it is the same");
    assert_eq!(on(None, "n.value=4"), 1);
    assert_eq!(on(Some("4"), "n.value=4"), 0);
    assert_eq!(on(Some("5"), "n.value=4"), 1);
    assert_eq!(on(Some("4"), "n.value=5"), 2);
}

#[test]
fn every_flipped_byte_and_every_cut_is_found_and_made_good() {
    // Every value is read: `tens` by nobody else.
    let (folder, graph, end) = filled(&GRAPH.replace("\"text\"]", "\"text\", \"p.tens\"]"));
    let mut damaged = 0;
    for file in entries(folder.path()) {
        let good = std::fs::read(&file).unwrap();
        for at in (0..good.len()).step_by(7) {
            let mut bad = good.clone();
            bad[at] ^= 1 << (at % 8);
            // One time in seven cut instead.
            if at % 49 == 0 {
                bad = good[..at].to_vec();
            }
            std::fs::write(&file, &bad).unwrap();
            let engine = on_disk(folder.path());
            // Nothing of the inner nodes is needed as long as the ends are there, so make all of
            // them be read.
            let report =
                engine.verify(&graph, &graph.wanted(None).unwrap(), &Cancel::default(), &());
            assert_eq!(value(&report.run, "end"), end, "{} byte {at}", file.display());
            assert!(report.differences.is_empty());
            let warned = report
                .run
                .nodes
                .iter()
                .any(|n| n.warnings.iter().any(|w| w.contains("was damaged")));
            let reason = report
                .run
                .nodes
                .iter()
                .any(|n| n.why.as_deref() == Some("its stored result was damaged"));
            damaged += usize::from(warned && reason);
            assert_eq!(std::fs::read(&file).unwrap(), good, "the entry is whole again");
        }
    }
    assert!(damaged > 200, "{damaged} damaged entries were noticed");
    assert_eq!(disk_cache(folder.path()).verify().unwrap().damaged, 0);
}

#[test]
fn verify_of_the_cache_finds_and_deletes_what_is_damaged() {
    let (folder, graph, end) = filled(GRAPH);
    let files = entries(folder.path());
    let mut bytes = std::fs::read(&files[3]).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&files[3], &bytes).unwrap();
    // A result under a key that is not its own.
    std::fs::copy(&files[0], &files[1]).unwrap();
    let report = disk_cache(folder.path()).verify().unwrap();
    assert_eq!((report.damaged, report.removed, report.entries), (2, 2, files.len() as u64 - 2));
    assert_eq!(value(&run(&on_disk(folder.path()), &graph), "end"), end);
}

#[test]
fn clear_deletes_what_the_cache_made_and_nothing_else() {
    let (folder, graph, _) = filled(GRAPH);
    std::fs::write(folder.path().join("mine.txt"), "keep").unwrap();
    let cache = disk_cache(folder.path());
    assert_eq!(cache.clear().unwrap().removed, 7);
    assert_eq!(cache.stat().unwrap().entries, 0);
    assert!(folder.path().join("mine.txt").is_file());
    assert_eq!(std::fs::read_dir(folder.path().join("latest")).unwrap().count(), 0);
    assert_eq!(ran(&run(&on_disk(folder.path()), &graph)).len(), 7);
}

#[test]
fn a_folder_that_cannot_be_written_is_one_warning() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "not a folder").unwrap();
    let graph = graph(GRAPH);
    for place in [file.clone(), file.join("deeper")] {
        let engine = on_disk(&place);
        let first = run(&engine, &graph);
        assert!(first.is_complete());
        assert_eq!(first.warnings.len(), 1, "{:?}", first.warnings);
        assert!(first.warnings[0].contains("the run goes on without storing results"));
        assert!(run(&engine, &graph_with(GRAPH, &settings(&["n.value=1"]))).warnings.is_empty());
    }
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "not a folder");
}

#[test]
fn a_full_disk_is_one_warning_and_what_is_there_is_still_read() {
    let (folder, graph, end) = filled(GRAPH);
    // A full or read-only disk: the writer cannot create a temporary file.
    std::fs::remove_dir_all(folder.path().join("tmp")).unwrap();
    std::fs::write(folder.path().join("tmp"), "in the way").unwrap();
    let report = run(&on_disk(folder.path()), &graph);
    assert_eq!((ran(&report), value(&report, "end"), report.warnings.len()), (vec![], end, 0));
    let report = run(&on_disk(folder.path()), &graph_with(GRAPH, &settings(&["n.value=7"])));
    assert_eq!((report.is_complete(), report.warnings.len()), (true, 1));
}

#[test]
fn the_bound_on_the_disk_holds_and_the_longest_unused_go_first() {
    let folder = tempfile::tempdir().unwrap();
    let limit = 6000;
    let options = || EngineOptions {
        cache: Some(cache(folder.path(), b"own")),
        disk_bytes: limit,
        memory_bytes: 0,
        threads: Some(1),
        ..EngineOptions::default()
    };
    let one =
        |n: i64| graph(&format!(r#"nodes: {{ "c": (op: Const(value: {n})) }}, outputs: ["c"]"#));
    let engine = engine(options());
    for n in 0..60 {
        assert_eq!(value(&run(&engine, &one(n)), "c"), n);
        // The first is used again and again.
        assert_eq!(ran(&run(&engine, &one(0))).len(), 0, "{n}");
        let stat = disk_cache(folder.path()).stat().unwrap();
        assert!(stat.bytes <= limit && stat.entries > 0, "{stat:?}");
    }
    assert_eq!(ran(&run(&engine, &one(59))), [] as [&str; 0]);
    assert_eq!(ran(&run(&engine, &one(1))), ["c"]);
    let cache = disk_cache(folder.path());
    let report = cache.gc(1000).unwrap();
    assert!(
        report.removed > 0 && report.bytes <= 1000 && report.bytes == cache.stat().unwrap().bytes
    );
}

#[test]
fn what_a_dead_writer_left_is_swept_and_what_a_live_one_writes_is_not() {
    let (folder, _, _) = filled(GRAPH);
    let left = |name: &str, age: u64| {
        let path = folder.path().join("tmp").join(name);
        let file = std::fs::File::create(&path).unwrap();
        file.set_modified(std::time::SystemTime::now() - Duration::from_secs(age)).unwrap();
        (path, file)
    };
    let (dead, live, young) =
        (left("new-dead00", 100), left("new-live00", 100), left("new-young0", 0));
    live.1.lock().unwrap();
    run(&on_disk(folder.path()), &graph_with(GRAPH, &settings(&["n.value=7"])));
    assert!(!dead.0.exists() && live.0.exists() && young.0.exists());
}

#[test]
fn two_engines_share_one_folder() {
    let folder = tempfile::tempdir().unwrap();
    let end = value(&run(&in_memory(), &graph(GRAPH)), "end");
    for round in 0..5 {
        std::thread::scope(|scope| {
            for _ in 0..3 {
                scope.spawn(|| {
                    // A tight bound, so that each run deletes entries that the others read.
                    let options = EngineOptions {
                        cache: Some(cache(folder.path(), b"own")),
                        disk_bytes: if round % 2 == 0 { 1500 } else { 1 << 20 },
                        memory_bytes: 0,
                        threads: Some(2),
                        ..EngineOptions::default()
                    };
                    let engine = engine(options);
                    for _ in 0..10 {
                        let report = run(&engine, &graph(GRAPH));
                        assert_eq!((value(&report, "end"), &report.warnings), (end, &vec![]));
                    }
                });
            }
        });
    }
}

/// A graph whose results are large enough that a kill falls into the middle of writing.
fn chain(length: usize) -> String {
    let links = (1..=length).map(|i| {
        let from = if i == 1 { "c".to_owned() } else { format!("n{}", i - 1) };
        format!("\"n{i}\": (op: Busy(work: {}), in: {{ \"number\": \"{from}\" }}), ", 1000 + i)
    });
    let nodes: String = links.collect();
    format!("nodes: {{ \"c\": (op: Const(value: 3)), {nodes} }}, outputs: [\"n{length}\"]")
}

const KILLED: &str = "ENGINE_TEST_CACHE";
/// The file, in the folder of the cache, by which the process shows that it works.
const BEGUN: &str = "begun";

#[test]
#[ignore = "the process that a_killed_run_leaves_the_cache_sound kills"]
fn child() {
    let folder = std::env::var(KILLED).expect("the test that kills it names the folder");
    std::fs::write(Path::new(&folder).join(BEGUN), []).unwrap();
    loop {
        run(&on_disk(Path::new(&folder)), &graph(&chain(40)));
        let _ = disk_cache(Path::new(&folder)).gc(4000);
    }
}

#[test]
fn a_killed_run_leaves_the_cache_sound() {
    let folder = tempfile::tempdir().unwrap();
    let graph = graph(&chain(40));
    let end = value(&run(&in_memory(), &graph), "n40");
    let begun = folder.path().join(BEGUN);
    for kill in 0..60 {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "disk::child", "--ignored", "--quiet"])
            .env(KILLED, folder.path())
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        while !begun.exists() {
            assert!(child.try_wait().unwrap().is_none(), "the child works until it is killed");
            std::thread::sleep(Duration::from_millis(1));
        }
        // Half-random moments: the multiples of an irrational part of 30 ms.
        std::thread::sleep(Duration::from_micros(
            ((f64::from(kill) * 0.618_034).fract() * 30_000.0) as u64,
        ));
        if kill % 4 == 0 {
            // Two processes at once: the child writes and deletes entries that this one reads.
            assert_eq!(value(&run(&on_disk(folder.path()), &graph), "n40"), end);
        }
        child.kill().unwrap();
        assert!(!child.wait().unwrap().success(), "the child worked until it was killed");
        std::fs::remove_file(&begun).unwrap();
        let report = run(&on_disk(folder.path()), &graph);
        assert_eq!(value(&report, "n40"), end, "after kill {kill}");
        let damaged: Vec<_> = report.nodes.iter().filter(|n| !n.warnings.is_empty()).collect();
        assert!(
            damaged.is_empty() && report.warnings.is_empty(),
            "a kill never leaves half an entry: {damaged:?}"
        );
        let _ = disk_cache(folder.path()).gc(3000);
    }
    assert_eq!(disk_cache(folder.path()).verify().unwrap().damaged, 0);
}

#[test]
fn a_hit_whose_values_are_damaged_is_made_again_when_they_are_needed() {
    let (folder, graph, _) = filled(GRAPH);
    // Damage the last byte, a value, of every entry: headers stay sound, so all are hits until a
    // value is read.
    for file in entries(folder.path()) {
        let mut bytes = std::fs::read(&file).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::write(&file, &bytes).unwrap();
    }
    let report = run_for(&on_disk(folder.path()), &graph, Some(&["end"]));
    // `end` is read, so it is recomputed, and so are its inputs, back to the first node.
    assert_eq!(ran(&report), ["n", "p", "s", "x", "sum", "end"]);
    let again = run_for(&on_disk(folder.path()), &graph, Some(&["end"]));
    assert_eq!(again.with_status(Status::Hit).len(), 6);
    assert_eq!(value(&again, "end"), value(&report, "end"));
}
