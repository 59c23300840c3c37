//! Every graph with every edit, and the scores of pictures against path-traced truth.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Mutex;

use needs::needs;
use relight::image::{Mask, Picture, Plane, SaturatedRegions};
use serde::Deserialize;

use crate::eval::figures;
use crate::goldens;
use crate::project::*;
use crate::rooms::{self, Scores, TruthRoom};

#[test]
fn each_graph_runs_with_each_fitting_edit() {
    let edits = ron_files(edits());
    let mut fitted = vec![0; edits.len()];
    let mut idle = Vec::new();
    for graph in ron_files("graphs") {
        let file = relight::graph::GraphFile::read(&graph)
            .unwrap_or_else(|faults| panic!("{}", faults[0]));
        let before: i32 = fitted.iter().sum();
        for (edit, fitted) in edits.iter().zip(&mut fitted) {
            // An edit fits when graph and scene have all that it names; the regression corpus
            // covers those that do not.
            let Ok(network) = load(&graph, &demo(), edit) else { continue };
            *fitted += 1;
            let report = run(shared_engine(), &network, &[]);
            if file.nodes().all(|node| node.kind != "Write") {
                continue; // a graph that makes no picture has a test of its own
            }
            let picture = png(&written(&report, "picture.png"));
            assert_eq!(picture.dimensions(), photo().dimensions(), "{}", stem(edit));
        }
        if fitted.iter().sum::<i32>() == before {
            idle.push(stem(&graph).to_owned());
        }
    }
    // It is for scenes without depth; adapters.rs runs it.
    assert_eq!(idle, ["depth"], "graphs that fit no edit");
    let unfit: Vec<_> =
        edits.iter().zip(&fitted).filter(|(_, n)| **n == 0).map(|(path, _)| stem(path)).collect();
    assert!(unfit.is_empty(), "edits that fit no graph: {unfit:?}");
}

/// Pixels in the edits are those of the photo of scenes/demo.
#[test]
fn each_edit_fits_the_scene_that_ships() {
    let place = Place::new();
    for edit in ron_files(root().join("edits")) {
        place.check(&format!("check GRAPHS/demo.ron {}", edit.display()), 0);
    }
}

#[test]
fn the_identity_gives_the_photo_back() {
    let report = run(shared_engine(), &physics(&demo(), IDENTITY), &[]);
    let (got, want) = (png(&written(&report, "picture.png")), photo());
    let is_white = |pixel: &image::Rgb<u8>| pixel.0.iter().any(|&c| c >= 254);
    let shares = want.pixels().map(|pixel| f32::from(u8::from(is_white(pixel)))).collect();
    let (w, h) = want.dimensions();
    let white = Mask(Plane::new(w as usize, h as usize, shares));
    let shown = Picture(Plane::filled(w as usize, h as usize, glam::Vec3::ONE));
    let saturated = SaturatedRegions::new(&shown, &white, 1.0, &[]);
    let (mut worst, mut compared) = (0, 0);
    let (one, brighter) = (glam::Vec3::ONE, glam::Vec3::splat(9.0));
    for (i, (got, want)) in got.pixels().zip(want.pixels()).enumerate() {
        if saturated.raised(i, one, brighter) == one {
            worst = (0..3).map(|c| got.0[c].abs_diff(want.0[c])).fold(worst, u8::max);
            compared += 1;
        }
    }
    assert!(worst <= 1, "a pixel that is not saturated changed by {worst}/255");
    assert!(compared > w * h * 3 / 4, "{compared} of {} pixels are not saturated", w * h);
}

/// The table of scores, with a tolerance per measure.
///
/// `RELIGHT_BLESS=scores cargo test --release --test pipeline scores` writes the current scores;
/// never in CI.
#[derive(Deserialize)]
#[serde(rename = "Scores")]
struct Expected {
    /// Measure -> the largest relative difference.
    tolerance: BTreeMap<String, f64>,
    /// Scene and graph -> subject -> measure -> value.
    tables: Tables,
}

type Tables = BTreeMap<String, BTreeMap<String, Scores>>;

fn file() -> PathBuf {
    root().join("tests/scores.ron")
}

fn expected() -> Expected {
    let text = std::fs::read_to_string(file()).expect("the table of scores is there");
    ron::from_str(&text).unwrap_or_else(|e| panic!("tests/scores.ron: {e}"))
}

/// Compares scores, subject by subject, with those of the table of this name.
fn check(table: &str, got: &BTreeMap<String, Scores>) {
    // One test at a time reads or writes the file.
    static FILE: Mutex<()> = Mutex::new(());
    let _alone = FILE.lock();
    let mut expected = expected();
    if goldens::blessed().iter().any(|name| name == "scores") {
        expected.tables.insert(table.to_owned(), got.clone());
        return std::fs::write(file(), expected.text()).expect("the project can be written to");
    }
    let faults = expected.faults(table, got);
    assert!(faults.is_empty(), "{table}:\n{}", faults.join("\n"));
}

impl Expected {
    /// The scores that differ from the table, and those that only one side has.
    fn faults(&self, table: &str, got: &BTreeMap<String, Scores>) -> Vec<String> {
        let empty = BTreeMap::new();
        let wanted = self.tables.get(table).unwrap_or(&empty);
        let pairs = |scores: &BTreeMap<String, Scores>| -> BTreeSet<(String, String)> {
            let each = |(subject, scores): (&String, &Scores)| -> Vec<(String, String)> {
                scores.keys().map(|measure| (subject.clone(), measure.clone())).collect()
            };
            scores.iter().flat_map(each).collect()
        };
        let value = |scores: &BTreeMap<String, Scores>, (subject, measure): &(String, String)| {
            scores.get(subject).and_then(|scores| scores.get(measure)).copied()
        };
        let fault = |pair: &(String, String)| {
            let (wanted, got) = (value(wanted, pair), value(got, pair));
            let tolerance = self.tolerance.get(&pair.1).copied().unwrap_or(0.0);
            let close = wanted
                .zip(got)
                .is_some_and(|(wanted, got)| (got - wanted).abs() <= tolerance * wanted.abs());
            let shown = |value: Option<f64>| value.map_or("none".to_owned(), digits);
            (!close).then(|| {
                format!("{}, {}: wanted {}, got {}", pair.0, pair.1, shown(wanted), shown(got))
            })
        };
        pairs(wanted).union(&pairs(got)).filter_map(fault).collect()
    }

    /// The file, one subject a line.
    fn text(&self) -> String {
        let list = |values: &Scores| {
            let values: Vec<String> = values
                .iter()
                .map(|(name, value)| format!("{name:?}: {}", digits(*value)))
                .collect();
            values.join(", ")
        };
        let mut text = format!(
            "{HEAD}Scores(\n    tolerance: {{ {} }},\n    tables: {{\n",
            list(&self.tolerance)
        );
        for (table, subjects) in &self.tables {
            text += &format!("        {table:?}: {{\n");
            for (subject, scores) in subjects {
                text += &format!("            {subject:?}: {{ {} }},\n", list(scores));
            }
            text += "        },\n";
        }
        text + "    },\n)\n"
    }
}

const HEAD: &str = "\
// Scores of relit pictures, of estimated lights and of estimated materials against path-traced
// truth, by scene and graph. PSNR is in dB; docs/eval.md defines the measures. Tolerances are
// relative. tests/pipeline/scores.rs compares, and tells how to bless this file.
";

/// Five significant digits.
fn digits(value: f64) -> String {
    let after = (4.0 - value.abs().max(1e-9).log10().floor()).max(1.0) as usize;
    let text = format!("{value:.after$}");
    let short = text.trim_end_matches('0');
    if short.ends_with('.') { format!("{short}0") } else { short.to_owned() }
}

#[test]
fn a_score_that_moved_is_seen() {
    let scores =
        |psnr: f64| Scores::from([("PSNR".to_owned(), psnr), ("change error".to_owned(), 0.2)]);
    let table = |psnr: f64| BTreeMap::from([("lamp off".to_owned(), scores(psnr))]);
    let tolerance = BTreeMap::from([("PSNR".to_owned(), 0.01), ("change error".to_owned(), 0.03)]);
    let expected =
        Expected { tolerance, tables: BTreeMap::from([("a room".to_owned(), table(30.0))]) };
    let none: [&str; 0] = [];
    assert_eq!(expected.faults("a room", &table(30.2)), none);
    assert_eq!(expected.faults("a room", &table(29.6)), ["lamp off, PSNR: wanted 30.0, got 29.6"]);
    assert_eq!(expected.faults("a room", &table(30.4)), ["lamp off, PSNR: wanted 30.0, got 30.4"]);
    assert_eq!(expected.faults("a room", &BTreeMap::new()).len(), 2, "a score is missing");
    assert_eq!(expected.faults("another room", &table(30.0)).len(), 2, "a score is new");
    let again: Expected = ron::from_str(&expected.text()).expect("what is blessed can be read");
    assert_eq!((again.tolerance, again.tables), (expected.tolerance, expected.tables));
}

#[test]
fn the_small_room_scores_as_expected() {
    let scores = rooms::small()
        .iter()
        .map(|case| (case.subject.clone(), case.score("physics.ron")))
        .collect();
    check("tests/scenes/small, physics.ron", &scores);
}

fn check_demo(graph: &str) {
    let scene = root().join("scenes/demo");
    let line = format!(
        "eval {} --graph GRAPHS/{graph} --no-ladder --no-cache --json --backend rten",
        scene.display()
    );
    let output = Place::new().command(&line).output().expect("the program starts");
    check_output("eval", &output, 0);
    let mut scores: BTreeMap<String, Scores> = BTreeMap::new();
    for ((subject, measure), value) in &figures(&output.stdout)["000"] {
        scores.entry(subject.clone()).or_default().insert(measure.clone(), *value);
    }
    check(&format!("scenes/demo, {graph}"), &scores);
}

#[test]
fn the_room_that_ships_scores_as_expected_by_indoor() {
    check_demo("indoor.ron");
}

#[test]
fn the_room_that_ships_scores_as_expected_by_physics() {
    check_demo("physics.ron");
}

fn check_truth(graph: &str) {
    let mut scores = BTreeMap::new();
    for view in ["dev-classroom", "dev-dining", "dev-parlour", "dev-sunlit"] {
        for case in &TruthRoom::new(view).cases {
            scores.insert(format!("{view}, {}", case.subject), case.score(graph));
        }
    }
    check(&format!("../shared/truth, {graph}"), &scores);
}

#[needs("../shared/truth")]
#[test]
fn rooms_by_others_score_as_expected_by_indoor() {
    check_truth("indoor.ron");
}

#[needs("../shared/truth")]
#[test]
fn rooms_by_others_score_as_expected_by_physics() {
    check_truth("physics.ron");
}

/// The tables of README.md and docs/eval.md are those of the room that ships.
#[test]
fn pages_show_the_scores() {
    let expected = expected();
    let table = &expected.tables["scenes/demo, indoor.ron"];
    let [readme, page] = ["README.md", "docs/eval.md"]
        .map(|name| std::fs::read_to_string(root().join(name)).expect("the page is there"));
    let readable = |subject: &str| match subject {
        "lamp_0 off" => "the table lamp off".to_owned(),
        "window_0 off" => "the window off".to_owned(),
        "invisible lights off" => "the lamp behind the camera off".to_owned(),
        edit => format!("`{edit}`"),
    };
    let row = |name: &str, scores: &Scores, measures: &[&str]| {
        let cells: Vec<String> =
            measures.iter().map(|measure| three_digits(scores[*measure])).collect();
        format!("| {name} | {} |\n", cells.join(" | "))
    };
    let mut rows = 0;
    for (subject, scores) in table {
        let tables: [&[&str]; 4] = [
            &["PSNR", "unchanged", "change error"],
            &["Chamfer", "E_j"],
            &["E"],
            &["albedo", "albedo before the fit", "normal"],
        ];
        for measures in tables.into_iter().filter(|measures| scores.contains_key(measures[0])) {
            let wanted = row(subject, scores, measures);
            assert!(page.contains(&wanted), "docs/eval.md has no row {wanted}");
            rows += 1;
        }
        if scores.contains_key("PSNR") {
            let wanted = row(&readable(subject), scores, &["PSNR", "unchanged", "change error"]);
            assert!(readme.contains(&wanted), "README.md has no row {wanted}");
        }
    }
    assert_eq!(rows, 12, "seven edits, three lights, shading and materials");
}

/// As `relight eval` prints a figure.
fn three_digits(value: f64) -> String {
    let after = (2.0 - value.abs().max(1e-4).log10().floor()).clamp(0.0, 5.0) as usize;
    format!("{value:.after$}")
}
