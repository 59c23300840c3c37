//! `relight batch`: its pictures are those of single runs, a failing job stops no other, a batch
//! goes on where it stopped, tasks of a plan together make what one command makes, and a shared
//! store saves work and changes no picture.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const OFF: &str = "Edit(version: 1, lights: { \"lamp_0\": Off })";
const DIM: &str = "Edit(version: 1, lights: { \"window_0\": Scale(0.4) })";
const DAY: &str =
    "Edit(version: 1, frames: 4, lights: { \"window_0\": Scale(Keys([(0, 1.0), (3, 0.1)])) })";
/// A working size at which the room takes a second.
const SIZE: &str = "scene.long_side=96";

/// A folder with copies of the small room, edits, and a list.
struct Place(tempfile::TempDir);

impl Place {
    fn new(rooms: &[&str]) -> Place {
        let place = Place(tempfile::tempdir().expect("a temporary folder can be made"));
        let small = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/scenes/small");
        for room in rooms {
            std::fs::create_dir_all(place.path(room).join("masks")).expect("a folder can be made");
            for name in
                ["scene.ron", "photo.png", "depth.exr", "masks/lamp_0.png", "masks/window_0.png"]
            {
                std::fs::copy(small.join(name), place.path(room).join(name))
                    .expect("it can be copied");
            }
        }
        for (name, text) in [("off.ron", OFF), ("dim.ron", DIM), ("day.ron", DAY)] {
            place.write(&format!("edits/{name}"), text);
        }
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: impl AsRef<[u8]>) {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().expect("it has a folder")).expect("it can be made");
        std::fs::write(path, text).expect("a file can be written");
    }

    fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    fn list(&self, fields: &str) {
        let text = format!("Batch(version: 1, graph: \"physics\", set: [\"{SIZE}\"], {fields})");
        self.write("jobs.ron", text);
    }

    fn relight(&self, line: &str, variables: &[(&str, &str)]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
        command.current_dir(self.0.path()).args(line.split_whitespace());
        command.env("HOME", self.path("home")).env_remove("RELIGHT_LOG");
        for name in ["XDG_CACHE_HOME", "XDG_CONFIG_HOME", "AWS_PROFILE", "AWS_ACCESS_KEY_ID"] {
            command.env_remove(name);
        }
        command.envs(variables.iter().copied()).output().expect("the program starts")
    }

    /// Runs a line that must end with `status`; returns standard error.
    fn check(&self, line: &str, status: i32) -> String {
        let output = self.relight(line, &[]);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(status), "`relight {line}` reported:\n{message}");
        message
    }

    /// Runs `plan/submit.sh` with an `sbatch` that runs each task at once. tests/farm/check.sh has
    /// the one of Slurm.
    #[cfg(unix)]
    fn submit(&self) {
        self.write(
            "bin/sbatch",
            r#"#!/bin/bash
for word; do
    case $word in
        --array=*) tasks=${word#--array=} ;;
        --export=ALL,*) export "${word#--export=ALL,}" ;;
        *.sbatch) script=$word ;;
    esac
done
for task in ${tasks:+$(seq "${tasks%-*}" "${tasks#*-}")}; do
    SLURM_ARRAY_TASK_ID=$task bash "$script" >&2 || exit 1
done
[ "$tasks" ] || bash "$script" >&2 || exit 1
echo $RANDOM
"#,
        );
        let mut command = Command::new("bash");
        let bin = self.path("bin");
        command
            .arg("-c")
            .arg("chmod +x bin/sbatch && PATH=\"$0:$PATH\" bash plan/submit.sh")
            .arg(bin);
        let output = command.current_dir(self.0.path()).env("HOME", self.path("home")).output();
        let output = output.expect("bash starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }

    /// Rows of results.csv by folder: column -> cell.
    fn results(&self, out: &str) -> Vec<BTreeMap<String, String>> {
        let mut table =
            csv::Reader::from_path(self.path(out).join("results.csv")).expect("a table");
        table.deserialize().map(|row| row.expect("a row")).collect()
    }

    /// Pictures below a folder, by name.
    fn pictures(&self, out: &str) -> BTreeMap<PathBuf, Vec<u8>> {
        let pattern = format!("{}/**/picture*.png", self.path(out).display());
        let paths = glob::glob(&pattern).expect("a pattern").flatten();
        let base = self.path(out);
        paths
            .map(|path| {
                let name = path.strip_prefix(&base).expect("it is below").to_owned();
                (name, std::fs::read(&path).expect("it can be read"))
            })
            .collect()
    }
}

#[test]
fn a_batch_makes_the_files_of_single_runs_and_goes_on_where_it_stopped() {
    let place = Place::new(&["rooms/hall", "rooms/study"]);
    place.write("rooms/cellar/scene.ron", "Scene(version: 1, camera: FovX(60), photo: \"no.png\")");
    place.write("edits/wrong.ron", "Edit(version: 1, lights: { \"lamp_9\": Off })");
    place.list("scenes: [\"rooms/*\"], edits: [\"edits/off.ron\", \"edits/wrong.ron\"]");
    let message = place.check("batch jobs.ron", 1);
    assert!(message.contains("2 of 6 jobs done, 4 failed"), "{message}");
    assert!(message.contains("unknown light `lamp_9`"), "{message}");
    let rows = place.results("out");
    let row = |out: &str| rows.iter().find(|row| row["out"] == out).expect(out);
    assert_eq!(row("hall/off")["status"], "done");
    assert!(row("hall/wrong")["cause"].contains("lamp_9"));
    assert!(row("cellar/off")["cause"].contains("depth"), "{}", row("cellar/off")["cause"]);
    let page = String::from_utf8(place.read("out/index.html")).expect("text");
    assert!(page.contains("hall/off/thumbnail.jpg") && page.contains("cellar/wrong"), "{page}");

    place.check(
        &format!(
            "run physics edits/off.ron --scene rooms/hall --set {SIZE} --out single --no-cache"
        ),
        0,
    );
    for name in ["picture.png", "picture.exr"] {
        let batch = place.read(&format!("out/hall/off/{name}"));
        assert!(batch == place.read(&format!("single/{name}")), "{name} differs");
    }

    // The failures are tried again, and what is done is not.
    place.write("edits/wrong.ron", DIM);
    std::fs::remove_dir_all(place.path("rooms/cellar")).expect("it can be removed");
    let message = place.check("batch jobs.ron", 0);
    assert!(message.contains("4 jobs, 2 done before, 0 failed"), "{message}");
    // A job whose edit or picture changed runs again.
    place.write("edits/off.ron", format!("{OFF} // and a remark"));
    std::fs::remove_file(place.path("out/hall/wrong/picture.png")).expect("it can be removed");
    let message = place.check("batch jobs.ron", 0);
    assert!(message.contains("4 jobs, 1 done before, 0 failed"), "{message}");
    // A light that is dimmed traces nothing: the engine stays warm over the edits of a photo.
    let rays = |out: &str| {
        let rows = place.results("out");
        let row = rows.iter().find(|row| row["out"] == out).expect("a row").clone();
        row["rays"].parse::<u64>().expect("a number")
    };
    assert_eq!(rays("hall/wrong"), 0);
}

#[cfg(unix)]
#[test]
fn tasks_of_a_plan_make_what_one_command_makes() {
    let place = Place::new(&["hall"]);
    place.list("scenes: [\"hall\"], edits: [\"edits/day.ron\", \"edits/off.ron\"], chunk: 1");
    place.check("batch jobs.ron --out whole --no-cache", 0);
    place.check("batch jobs.ron --out parts --plan slurm plan --jobs-per-task 2 --cache c", 0);
    let table = String::from_utf8(place.read("plan/jobs.csv")).expect("text");
    let tasks: Vec<&str> =
        table.lines().skip(1).map(|line| line.split(',').next().expect("a cell")).collect();
    assert_eq!(tasks, ["0", "1", "1", "2", "2"], "a shared part, then chunks: {table}");
    let submit = String::from_utf8(place.read("plan/submit.sh")).expect("text");
    assert!(submit.contains("--array=0-0") && submit.contains("afterany$shared"), "{submit}");
    place.submit();
    let whole = place.pictures("whole");
    assert_eq!(whole.len(), 5);
    assert!(whole == place.pictures("parts"), "a picture differs");
    // No key was computed in two tasks.
    let mut keys = BTreeMap::new();
    for report in glob::glob(&format!("{}/parts/**/report*.json", place.0.path().display()))
        .expect("a pattern")
        .flatten()
    {
        let text = std::fs::read_to_string(&report).expect("it can be read");
        let report: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let frames = report["frames"].as_array().cloned().unwrap_or(vec![report.clone()]);
        for node in frames.iter().flat_map(|frame| frame["nodes"].as_array().expect("nodes")) {
            if node["status"] == "ran" {
                *keys.entry(node["key"].to_string()).or_insert(0) += 1;
            }
        }
    }
    let twice = keys.values().filter(|&&count| count > 1).count();
    // Layers of `Compose` are not stored, and are made again where a later job needs them.
    assert!(keys.len() > 40 && twice <= 2, "{twice} of {} keys were computed twice", keys.len());
    let message = place.check("batch plan/jobs.ron --task 9", 2);
    assert!(message.contains("wanted a task from 0 to 2"), "{message}");

    place.check("batch jobs.ron --plan openjd farm --jobs-per-task 2 --cache c", 0);
    let template: serde_json::Value =
        serde_json::from_slice(&place.read("farm/template.json")).expect("JSON");
    assert_eq!(template["specificationVersion"], "jobtemplate-2023-09");
    let names: Vec<&serde_json::Value> =
        template["steps"].as_array().expect("steps").iter().map(|step| &step["name"]).collect();
    assert_eq!(names, ["Shared", "Edits", "Finish"]);
}

#[test]
fn mistakes_of_a_list_are_shown_with_their_places() {
    let place = Place::new(&["hall"]);
    for (fields, table, wanted) in [
        ("scenes: [\"rooms/*\"]", "", &["jobs.ron:1:", "wanted a folder with a scene.ron"][..]),
        ("table: \"t.csv\"", "scene,edti\nhall,edits/off.ron\n", &["t.csv:1:7", "`edit`"]),
        ("table: \"t.csv\"", "scene,out\nhall,../../x\n", &["t.csv:2:6", "below that"]),
        ("table: \"t.csv\"", "scene\nhall\nhall\n", &["two jobs have the folder `hall/unedited`"]),
        ("table: \"none.csv\"", "", &["jobs.ron:1:", "cannot be read"]),
    ] {
        place.list(fields);
        place.write("t.csv", table);
        let message = place.check("batch jobs.ron", 2);
        for part in wanted {
            assert!(message.contains(part), "wanted {part:?}, got:\n{message}");
        }
    }
    place.list("scenes: [\"hall\"]");
    let message = place.check("batch jobs.ron --plan kubernetes d", 2);
    assert!(message.contains("wanted `slurm` or `openjd`, got `kubernetes`"), "{message}");
}

#[cfg(feature = "store")]
#[test]
fn a_second_machine_takes_from_the_store_what_the_first_has_computed() {
    let place = Place::new(&["hall"]);
    let store = format!("file://{}", place.path("store").display());
    place.list("scenes: [\"hall\"], edits: [\"edits/off.ron\"]");
    place.check(&format!("batch jobs.ron --out first --cache one --cache-store {store}"), 0);
    place.list("scenes: [\"hall\"], edits: [\"edits/dim.ron\"]");
    place.check("batch jobs.ron --out alone --no-cache", 0);
    let rays = |out: &str| place.results(out)[0]["rays"].parse::<u64>().expect("a number");
    let on_second = |cache: &str, out: &str| {
        place.check(&format!("batch jobs.ron --out {out} --cache {cache} --cache-store {store}"), 0)
    };
    let message = on_second("two", "second");
    assert!(message.contains("blobs found"), "{message}");
    // The quicker the machine, the fewer results are worth a place in the store.
    assert!(rays("second") < rays("alone"), "{} of {}", rays("second"), rays("alone"));
    assert!(place.pictures("alone") == place.pictures("second"), "a picture differs");
    let output = place.relight(&format!("cache stat --store {store}"), &[]);
    let stat = String::from_utf8_lossy(&output.stdout);
    assert!(stat.contains("records") && stat.contains("values"), "{stat}");

    // A value with a flipped bit, another lost, a record cut short: the picture is the same.
    let blobs = |folder: &str| -> Vec<PathBuf> {
        let pattern = format!("{}/store/{folder}/*/*", place.0.path().display());
        glob::glob(&pattern).expect("a pattern").flatten().collect()
    };
    let (values, records) = (blobs("cas"), blobs("ac"));
    assert!(!values.is_empty() && records.len() > 40, "{} {}", values.len(), records.len());
    for (number, path) in values.iter().enumerate() {
        let mut bytes = std::fs::read(path).expect("it can be read");
        bytes[0] ^= 1;
        if number % 2 == 0 {
            std::fs::write(path, bytes).expect("it can be written");
        } else {
            std::fs::remove_file(path).expect("it can be removed");
        }
    }
    std::fs::write(&records[7], b"NODE").expect("it can be written");
    on_second("three", "third");
    assert!(place.pictures("alone") == place.pictures("third"), "a picture differs");
}

#[cfg(feature = "store")]
#[test]
fn a_store_that_does_not_answer_costs_a_warning_and_shows_no_secret() {
    let place = Place::new(&["hall"]);
    place.list("scenes: [\"hall\"], edits: [\"edits/off.ron\"]");
    place.check("batch jobs.ron --out alone --no-cache", 0);
    // A port that nobody listens on.
    let port = std::net::TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr());
    let endpoint = format!("http://127.0.0.1:{}", port.expect("a port").port());
    let secret = "wJalrXUtnFEMI-geheim";
    let variables = [
        ("AWS_ACCESS_KEY_ID", "AKIAIOSFODNN7"),
        ("AWS_SECRET_ACCESS_KEY", secret),
        ("AWS_ENDPOINT_URL", endpoint.as_str()),
        ("AWS_REGION", "us-east-1"),
    ];
    let line = "batch jobs.ron --out second --cache two --cache-store s3://bucket/prefix -vvv";
    let output = place.relight(line, &variables);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{message}");
    assert!(message.contains("left alone for 30 s"), "{message}");
    assert!(message.contains("requests failed"), "{message}");
    let report = String::from_utf8(place.read("second/hall/off/report.json")).expect("text");
    assert!(report.contains("cache store s3://bucket/prefix"), "{report}");
    for text in [&*message, &report] {
        assert!(!text.contains(secret) && !text.contains("AKIAIOSFODNN7"), "{text}");
    }
    assert!(place.pictures("alone") == place.pictures("second"), "a picture differs");
}
