//! Damage to the cache never changes the result of the next run.

use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::Duration;

use crate::project::*;

/// The demo at a third of its working size: the same stages and files, in a fraction of the time.
const RUN: &str = "run DEMO.ron EDITS/insert_lamp.ron --set scene.long_side=96";

/// The pictures of a run without any cache.
fn wanted(place: &Place) -> [Vec<u8>; 2] {
    place.check(&format!("{RUN} --no-cache --out wanted"), 0);
    place.pictures("wanted")
}

/// Runs with the cache of that name, and checks the pictures; returns standard error.
fn check_right(place: &Place, cache: &str, wanted: &[Vec<u8>; 2]) -> String {
    let message = place.check(&format!("{RUN} --cache {cache} --out out"), 0);
    assert!(
        place.pictures("out") == *wanted,
        "another picture than without a cache; message:\n{message}"
    );
    message
}

fn entries(cache: &Path) -> Vec<PathBuf> {
    let list = |folder: &Path| -> Vec<PathBuf> {
        let entries = std::fs::read_dir(folder).expect("the cache has this folder");
        entries.map(|entry| entry.expect("it can be listed").path()).collect()
    };
    let mut files: Vec<PathBuf> =
        list(&cache.join("entries")).iter().flat_map(|folder| list(folder)).collect();
    files.sort();
    files
}

fn start(place: &Place, line: &str) -> Child {
    let mut command = place.command(line);
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts")
}

/// Numbers without pattern, the same in every run of the test: splitmix64.
fn random(seed: u64) -> u64 {
    let mut z = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Number of results in a cache that a run may be writing to.
fn kept(cache: &Path) -> usize {
    let list = |folder: &Path| {
        std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path())
    };
    list(&cache.join("entries")).map(|folder| list(&folder).count()).sum()
}

#[test]
fn after_a_kill_at_any_moment_the_next_run_is_right() {
    let place = Place::new();
    let wanted = wanted(&place);
    check_right(&place, "whole", &wanted);
    let whole = kept(&place.path("whole")) as u64;
    let cache = place.path("cache");
    let (mut kills, mut chance) = (0, (0..).map(random));
    let mut chance = || chance.next().expect("there is no end of numbers");
    while kills < 24 {
        // Two kills on one cache, then a run to the end; then all of it again. A kill falls when a
        // random part of the results is kept, and up to 20 ms later.
        let (first, second) = (chance() % (whole / 2), whole / 2 + chance() % (whole / 2));
        for part in [first, second] {
            let mut child = start(&place, &format!("{RUN} --cache cache --out torn"));
            while (kept(&cache) as u64) < part
                && child.try_wait().expect("it can be looked at").is_none()
            {
                std::thread::sleep(Duration::from_millis(1));
            }
            std::thread::sleep(Duration::from_millis(chance() % 20));
            child.kill().expect("it can be killed");
            // One that came to its end before is tried again.
            kills += u32::from(!child.wait().expect("it ends").success());
            // Results of a killed run are whole or missing.
            for (name, wanted) in ["picture.png", "picture.exr"].iter().zip(&wanted) {
                let torn = std::fs::read(place.path("torn").join(name));
                assert!(
                    torn.is_err() || torn.is_ok_and(|bytes| bytes == *wanted),
                    "{name} is torn"
                );
            }
        }
        check_right(&place, "cache", &wanted);
        place.check("cache verify --cache cache", 0);
        place.check("cache clear --cache cache", 0);
    }
}

#[test]
fn damaged_results_are_made_again() {
    let place = Place::new();
    let wanted = wanted(&place);
    check_right(&place, "cache", &wanted);
    let cache = place.path("cache");
    let damage = |seed: u64, files: &[PathBuf]| {
        for (i, file) in files.iter().enumerate() {
            let mut bytes = std::fs::read(file).expect("it can be read");
            let at = random(seed + i as u64) as usize % bytes.len();
            if (seed + i as u64).is_multiple_of(3) {
                bytes.truncate(at)
            } else {
                bytes[at] ^= 1 << (at % 8)
            }
            std::fs::write(file, bytes).expect("it can be written to");
        }
    };
    // All at once, and then so that only some of the damaged results are needed.
    let files = entries(&cache);
    damage(1, &files);
    let message = check_right(&place, "cache", &wanted);
    assert!(message.contains("damaged"), "{message}");
    for seed in 2..8 {
        let some: Vec<PathBuf> = files.iter().skip(seed % 3).step_by(3).cloned().collect();
        damage(100 * seed as u64, &some);
        check_right(&place, "cache", &wanted);
    }
    // Damage to results that no run needs stays until `cache verify`.
    damage(7, &entries(&cache)[..4]);
    place.check("cache verify --cache cache", 1);
    place.check("cache verify --cache cache", 0);
    check_right(&place, "cache", &wanted);
    let message = check_right(&place, "cache", &wanted);
    assert!(!message.contains(" ran "), "{message}");
}

#[test]
fn a_cache_that_cannot_be_written_is_one_warning() {
    let place = Place::new();
    let wanted = wanted(&place);
    place.write("file", "not a folder");
    for cache in ["file", "file/deeper", "/proc/nowhere"] {
        let message = check_right(&place, cache, &wanted);
        let warnings: Vec<&str> =
            message.lines().filter(|line| line.contains("without storing results")).collect();
        assert_eq!(warnings.len(), 1, "{cache}: {warnings:?}");
        assert!(warnings[0].starts_with("warning: cache "), "{warnings:?}");
    }
    assert_eq!(std::fs::read(place.path("file")).expect("it is there"), b"not a folder");

    // A read-only cache returns its results.
    check_right(&place, "cache", &wanted);
    std::fs::remove_dir_all(place.path("cache/tmp")).expect("it is there");
    place.write("cache/tmp", "in the way of every new result");
    let message = check_right(&place, "cache", &wanted);
    assert!(!message.contains(" ran ") && !message.contains("without storing"), "{message}");
    let message =
        place.check(&format!("{RUN} --cache cache --set compose.lamp_albedo=0.4 --out other"), 0);
    assert_eq!(message.matches("without storing results").count(), 1, "{message}");
}

/// A limit on the size of files stands for a full disk: a write stops in the middle.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_the_cache_sound() {
    let place = Place::new();
    let wanted = wanted(&place);
    let limited = |line: &str| {
        let command = place.command(line);
        let mut shell = std::process::Command::new("sh");
        shell.current_dir(place.folder.path()).args([
            "-c",
            "trap '' XFSZ; ulimit -f 100; exec \"$@\"",
            "sh",
        ]);
        shell.arg(command.get_program()).args(command.get_args());
        shell.output().expect("there is a shell")
    };
    let line = format!("{RUN} --cache cache --only compose --out out");
    let message = check_output(&line, &limited(&line), 0);
    assert_eq!(message.matches("without storing results").count(), 1, "{message}");
    place.check("cache verify --cache cache", 0);
    // The pictures themselves do not fit: a message reports it, and no partial one stays.
    let line = format!("{RUN} --cache cache --out full");
    let message = check_output(&line, &limited(&line), 2);
    assert!(message.contains("cannot be written"), "{message}");
    let left: Vec<_> = std::fs::read_dir(place.path("full")).expect("it is there").collect();
    assert!(left.len() <= 1, "{left:?}");
    check_right(&place, "cache", &wanted);
    place.check("cache verify --cache cache", 0);
}

#[test]
fn several_processes_at_once_are_all_right() {
    let place = Place::new();
    let wanted = wanted(&place);
    for round in 0..4 {
        let cache = format!("cache_{}", round / 2);
        let mut children =
            ["a", "b", "c"].map(|out| start(&place, &format!("{RUN} --cache {cache} --out {out}")));
        for child in &mut children {
            assert!(child.wait().expect("it ends").success());
        }
        for out in ["a", "b", "c"] {
            assert!(place.pictures(out) == wanted, "{out} differs");
        }
        place.check(&format!("cache verify --cache {cache}"), 0);
    }
}

#[test]
fn what_a_budget_cut_short_is_not_kept() {
    let place = Place::new();
    let line = "DEMO.ron EDITS/none.ron --set scene.long_side=96 --only shadow[window_0] -v";
    let run = |more: &str| place.check(&format!("run {line} --cache cache --out out {more}"), 0);
    let row = |message: &str| {
        let row = message
            .lines()
            .find(|line| line.starts_with("shadow[window_0]"))
            .expect("the table names it");
        row.split_whitespace().nth(1).expect("its status").to_owned()
    };
    let cut = "warning: shadow[window_0]: stopped by the budget at a standard error of ";
    let short = run("--budget 0.001ms");
    assert!(short.contains(cut) && row(&short) == "ran", "{short}");
    let whole = run("");
    assert!(!whole.contains(cut) && row(&whole) == "ran", "{whole}");
    let hit = run("--budget 0.001ms");
    assert!(!hit.contains(cut) && row(&hit) == "hit", "{hit}");

    // A target is a parameter like any other.
    let plan = place
        .command(&format!("plan {line} --cache cache --target-error 5%"))
        .output()
        .expect("it starts");
    let plan = String::from_utf8(plan.stdout).expect("a plan is text");
    let row = plan.lines().map(|line| line.split_whitespace().collect::<Vec<_>>().join(" "));
    let wanted = "run shadow[window_0] parameter target_error: 0.0 -> 0.05";
    assert!(row.into_iter().any(|row| row == wanted), "{plan}");
}
