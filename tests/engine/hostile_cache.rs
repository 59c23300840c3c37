//! A cache folder that somebody else prepared: nothing foreign is used, followed, waited for or
//! deleted.

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use relight::graph::{DiskCache, ResolvedGraph};

use crate::nodes::*;

const GRAPH: &str = r#"nodes: {
    "n": (op: Const(value: 42)), "x": (op: Add(plus: 1), in: { "number": "n" }), "t": (op: Show, in: { "number": "x" }),
}, outputs: ["x", "t"]"#;

fn filled() -> (tempfile::TempDir, ResolvedGraph) {
    let folder = tempfile::tempdir().unwrap();
    let graph = graph(GRAPH);
    run(&on_disk(folder.path()), &graph);
    (folder, graph)
}

/// The files of all entries.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let shelves =
        std::fs::read_dir(folder.join("entries")).unwrap().map(|shelf| shelf.unwrap().path());
    let mut files: Vec<PathBuf> = shelves
        .flat_map(|shelf| std::fs::read_dir(shelf).unwrap().map(|file| file.unwrap().path()))
        .collect();
    files.sort();
    files
}

/// An old file that a careless clean-up would delete.
fn old_file(path: &Path) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let file = std::fs::File::create(path).unwrap();
    file.set_modified(SystemTime::now() - Duration::from_secs(1000)).unwrap();
}

/// Names as the cache itself would give them.
const NAMES: [&str; 3] = [
    "tmp/new-abcdef",
    "entries/ab/cdefcdefcdefcdefcdefcdefcdefcdefcdefcdefcdefcdefcdefcdefcdefcd",
    "latest/abababababababababababababababababababababababababababababababab",
];

#[test]
fn nothing_is_done_in_a_folder_without_the_mark() {
    let folder = tempfile::tempdir().unwrap();
    NAMES.iter().chain(&["tmp/notes.txt"]).for_each(|name| old_file(&folder.path().join(name)));
    let report = run(&on_disk(folder.path()), &graph(GRAPH));
    assert!(report.is_complete());
    assert_eq!(report.warnings.len(), 1);
    assert!(
        report.warnings[0].contains("not a cache of relight")
            && report.warnings[0].contains("CACHEDIR.TAG")
    );
    let cache = disk_cache(folder.path());
    for done in [cache.stat(), cache.gc(0), cache.verify(), cache.clear()] {
        assert!(done.unwrap_err().to_string().contains("not a cache of relight"));
    }
    for name in NAMES.iter().chain(&["tmp/notes.txt"]) {
        assert!(folder.path().join(name).is_file(), "{name}");
    }
    assert_eq!(entries(folder.path()).len(), 1, "nothing was stored");
}

#[test]
fn only_names_of_the_cache_s_own_form_are_deleted() {
    let (folder, graph) = filled();
    let foreign = [
        "tmp/notes.txt",
        "tmp/new-abc",
        "entries/ab/notes.txt",
        "entries/notes/cdef",
        "entries/AB/cdef",
        "latest/notes.txt",
    ];
    foreign.iter().for_each(|name| old_file(&folder.path().join(name)));
    NAMES.iter().for_each(|name| old_file(&folder.path().join(name)));
    run(&on_disk(folder.path()), &graph_with(GRAPH, &settings(&["n.value=7"])));
    assert!(!folder.path().join(NAMES[0]).exists(), "a stale temporary file is swept");
    let cache = disk_cache(folder.path());
    assert_eq!(cache.verify().unwrap().removed, 1, "the empty entry");
    assert_eq!(cache.clear().unwrap().removed, 6);
    assert!(!folder.path().join(NAMES[2]).exists());
    for name in foreign {
        assert!(folder.path().join(name).is_file(), "{name}");
    }
    assert_eq!(ran(&run(&on_disk(folder.path()), &graph)).len(), 3, "and the cache works on");
}

#[cfg(unix)]
#[test]
fn no_symbolic_link_is_followed() {
    use std::os::unix::fs::symlink;
    let (folder, graph) = filled();
    let victim = tempfile::tempdir().unwrap();
    let kept = NAMES.map(|name| victim.path().join(name));
    kept.iter().for_each(|path| old_file(path));
    // A shelf of entries, the folder of temporary files, and that of last keys lead elsewhere.
    let inside = folder.path();
    symlink(victim.path().join("entries/ab"), inside.join("entries/zz")).unwrap();
    let _ = std::fs::remove_dir_all(inside.join("entries/ab"));
    symlink(victim.path().join("entries/ab"), inside.join("entries/ab")).unwrap();
    for name in ["tmp", "latest"] {
        std::fs::remove_dir_all(inside.join(name)).unwrap();
        symlink(victim.path().join(name), inside.join(name)).unwrap();
    }
    // An entry that is a link to a sound one elsewhere.
    let entry = entries(inside).into_iter().find(|path| path.is_file()).unwrap();
    let elsewhere = victim.path().join("entry");
    std::fs::rename(&entry, &elsewhere).unwrap();
    symlink(&elsewhere, &entry).unwrap();
    let before = std::fs::read(&elsewhere).unwrap();

    let report = run(&on_disk(inside), &graph);
    assert!(report.is_complete() && !ran(&report).is_empty(), "the link counts as missing");
    run(&on_disk(inside), &graph_with(GRAPH, &settings(&["n.value=7"])));
    let cache = disk_cache(inside);
    for done in [cache.gc(0), cache.verify(), cache.clear()] {
        done.unwrap();
    }
    assert!(kept.iter().all(|path| path.is_file()), "nothing behind a link is deleted");
    assert_eq!(std::fs::read(&elsewhere).unwrap(), before);
    let count = |name: &str| std::fs::read_dir(victim.path().join(name)).unwrap().count();
    assert_eq!(
        [count("tmp"), count("latest"), count("entries/ab")],
        [1; 3],
        "and nothing is written there"
    );
}

/// The attack that this is for: a folder with a cache of results that never came out of these
/// stages.
#[test]
fn entries_of_another_key_count_as_missing_and_stay() {
    let folder = tempfile::tempdir().unwrap();
    let graph = graph(GRAPH);
    let stranger = |secret: &[u8]| {
        engine(relight::graph::EngineOptions {
            cache: Some(cache(folder.path(), secret)),
            threads: Some(1),
            ..Default::default()
        })
    };
    run(&stranger(b"another"), &graph);
    let files: Vec<_> = entries(folder.path())
        .into_iter()
        .map(|path| (std::fs::read(&path).unwrap(), path))
        .collect();
    let report = disk_cache(folder.path()).verify().unwrap();
    assert_eq!((report.foreign, report.damaged, report.removed, report.entries), (3, 0, 0, 3));
    assert!(files.iter().all(|(bytes, path)| std::fs::read(path).unwrap() == *bytes));

    let report = run(&on_disk(folder.path()), &graph);
    assert_eq!(ran(&report), ["n", "x", "t"]);
    assert_eq!(report.warnings.len(), 1, "reported once: {:?}", report.warnings);
    assert!(report.warnings[0].contains("signed with another key"), "{}", report.warnings[0]);
    assert_eq!(
        disk_cache(folder.path()).verify().unwrap().foreign,
        0,
        "its own results took their place"
    );
    assert_eq!(ran(&run(&stranger(b"own"), &graph)), [] as [&str; 0]);
}

/// Consistent checksums are not a signature: each header byte, and each length, counts.
#[test]
fn an_entry_altered_with_a_checksum_to_match_counts_as_missing() {
    let (folder, graph) = filled();
    for path in entries(folder.path()) {
        let mut bytes = std::fs::read(&path).unwrap();
        let length = u64::from_le_bytes(bytes[8..16].try_into().unwrap()) as usize;
        let at = bytes.windows(5).position(|w| w == b"value").unwrap_or(80 + length / 2);
        bytes[at] ^= 1;
        let checksum = *blake3::hash(&bytes[80..80 + length]).as_bytes();
        bytes[16..48].copy_from_slice(&checksum);
        std::fs::write(&path, &bytes).unwrap();
    }
    let report = disk_cache(folder.path()).verify().unwrap();
    assert_eq!((report.foreign, report.damaged), (3, 0));
    assert_eq!(ran(&run(&on_disk(folder.path()), &graph)), ["n", "x", "t"]);
}

/// A header that claims a terabyte in a sparse file causes no allocation.
#[test]
fn claimed_lengths_are_held_against_the_file_and_a_limit() {
    let (folder, graph) = filled();
    for (path, claim) in entries(folder.path()).into_iter().zip([1u64 << 39, 1 << 32, u64::MAX]) {
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[8..16].copy_from_slice(&claim.to_le_bytes());
        std::fs::write(&path, &bytes).unwrap();
        std::fs::File::options().write(true).open(&path).unwrap().set_len(1 << 40).unwrap();
    }
    assert_eq!(disk_cache(folder.path()).verify().unwrap().damaged, 3);
    assert!(run(&on_disk(folder.path()), &graph).is_complete());
}

#[cfg(unix)]
#[test]
fn a_pipe_in_the_place_of_an_entry_or_of_the_mark_is_not_waited_for() {
    let (folder, graph) = filled();
    let pipe = |path: &Path| {
        std::fs::remove_file(path).unwrap();
        nix::unistd::mkfifo(path, nix::sys::stat::Mode::S_IRUSR).unwrap();
    };
    entries(folder.path()).iter().for_each(|path| pipe(path));
    assert_eq!(ran(&run(&on_disk(folder.path()), &graph)), ["n", "x", "t"]);
    pipe(&folder.path().join("CACHEDIR.TAG"));
    assert_eq!(ran(&run(&on_disk(folder.path()), &graph)), ["n", "x", "t"]);
}

#[cfg(unix)]
#[test]
fn entries_of_another_user_are_told_as_such() {
    let (folder, graph) = filled();
    for path in entries(folder.path()) {
        if std::os::unix::fs::chown(&path, Some(12345), None).is_err() {
            eprintln!("ignored: only the superuser can give files away");
            return;
        }
    }
    // The superuser may read them all the same, so they are signed with another key, too.
    let stranger = DiskCache::new(cache(folder.path(), b"another"));
    assert_eq!(stranger.verify().unwrap().foreign, 3);
    let engine = engine(relight::graph::EngineOptions {
        cache: Some(cache(folder.path(), b"another")),
        ..Default::default()
    });
    let report = run(&engine, &graph);
    assert!(report.is_complete());
    assert!(
        report.warnings[0].contains("belongs to another user of this machine (12345)"),
        "{:?}",
        report.warnings
    );
}

#[test]
fn a_value_that_breaks_the_rules_of_its_type_is_dropped_and_made_again() {
    let folder = tempfile::tempdir().unwrap();
    // The stage breaks the rule itself, so that the entry is sound but for its value.
    let graph = graph(
        r#"nodes: { "n": (op: Const(value: 50)), "d": (op: ToDigit, in: { "number": "n" }) }, outputs: ["d"]"#,
    );
    run(&on_disk(folder.path()), &graph);
    let report = run(&on_disk(folder.path()), &graph);
    let digit = report.nodes.iter().find(|node| node.name == "d").unwrap();
    assert_eq!(digit.why.as_deref(), Some("its stored result was damaged"));
    assert!(
        digit.warnings[0].contains("Digit: wanted a number below 10, got 50"),
        "{:?}",
        digit.warnings
    );
    assert!(report.is_complete() && ran(&report).contains(&"d"));
}

#[test]
fn projects_keep_their_last_keys_apart() {
    let folder = tempfile::tempdir().unwrap();
    let engine = |project: &str| {
        engine(relight::graph::EngineOptions {
            cache: Some(cache(folder.path(), b"own")),
            project: project.into(),
            ..Default::default()
        })
    };
    run(&engine("one"), &graph(GRAPH));
    run(&engine("two"), &graph_with(GRAPH, &settings(&["n.value=1"])));
    let changed = graph_with(GRAPH, &settings(&["n.value=2"]));
    assert_eq!(engine("one").explain(&changed, "n").unwrap().why, "parameter value: 42 -> 2");
    assert_eq!(engine("two").explain(&changed, "n").unwrap().why, "parameter value: 1 -> 2");
}
