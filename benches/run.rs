//! Run time of the whole command on tests/scenes/small (320 x 240): no change, one light's radiance
//! changed, and an empty cache; beside an empty process and a copy of the written files.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

const ROUNDS: usize = 15;
const COLD_ROUNDS: usize = 5;

/// Minimum and median of some rounds in milliseconds. Other work on the machine only ever adds, so
/// the minimum is the better estimate.
fn time(rounds: usize, mut work: impl FnMut(usize)) -> [f64; 2] {
    let mut times: Vec<f64> = (0..rounds)
        .map(|round| {
            let began = Instant::now();
            work(round);
            began.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    [times[0], times[rounds / 2]]
}

fn run(command: &mut Command) {
    let status = command.stdout(Stdio::null()).stderr(Stdio::null()).status().expect("it starts");
    assert!(status.success(), "{command:?}: {status}");
}

fn main() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().expect("a temporary folder");
    let edit = |scale: f64| {
        let path = folder.path().join(format!("edit_{scale}.ron"));
        let text = format!(r#"Edit(version: 1, lights: {{ "lamp_0": Scale({scale}) }})"#);
        std::fs::write(&path, text).expect("temporary folders take files");
        path
    };
    let relight = |edit: &Path, cache: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
        command.arg("run").arg(root.join("tests/scenes/small.ron")).arg(edit);
        run(command.current_dir(&folder).args(["--out", "out", "--cache", cache]));
    };
    let same = edit(0.5);
    let edits: Vec<_> = (0..ROUNDS).map(|round| edit(0.1 + 0.01 * round as f64)).collect();

    let nothing =
        time(ROUNDS, |_| run(Command::new(env!("CARGO_BIN_EXE_relight")).arg("--version")));
    let cold = time(COLD_ROUNDS, |round| relight(&same, &format!("cold_{round}")));
    relight(&same, "warm");
    let unchanged = time(ROUNDS, |_| relight(&same, "warm"));
    let radiance = time(ROUNDS, |round| relight(&edits[round], "warm"));
    let copy = time(ROUNDS, |round| {
        run(Command::new("cp")
            .arg("-r")
            .arg(folder.path().join("out"))
            .arg(folder.path().join(format!("copy_{round}"))));
    });

    println!(
        "milliseconds, least and median; x: least over the least of `relight --version` and of `cp -r` of the output"
    );
    let line = |what: &str, [least, median]: [f64; 2], aim: &str| {
        let (over_nothing, over_copy) = (least / nothing[0], least / copy[0]);
        println!(
            "{what:34} {least:8.1} {median:8.1}   x {over_nothing:7.1}   x {over_copy:7.1}   {aim}"
        );
    };
    line("relight --version", nothing, "");
    line("cp -r of the output", copy, "");
    line("run, nothing changed", unchanged, "aim 60");
    line("run, a light's radiance changed", radiance, "aim 100");
    line("run, empty cache", cold, "aim 3000");
}
