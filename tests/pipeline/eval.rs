//! `relight eval`: figures against hand-made truth, the demo against its own, and truth that does
//! not fit.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec3;
use relight::graph::{Context, File, Gather, Node, NodeError};
use relight::image::{Albedo, Mask, Picture, Plane, Shading};
use relight::nodes::artifacts::{Scores, UnitDirect, Visibility};
use relight::nodes::measure::score_direct::{ScoreDirect, ScoreDirectIn};
use relight::nodes::measure::score_lighting::{ScoreLighting, ScoreLightingIn};
use relight::nodes::measure::score_lights::{ScoreLights, ScoreLightsIn};
use relight::nodes::measure::score_picture::{ScorePicture, ScorePictureIn};
use relight::nodes::measure::score_shading::{ScoreShading, ScoreShadingIn};
use relight::optics::{Lamp, Lighting, LocalLobe, Radiance, Shape, SphereLamp, TEXELS};
use serde_json::Value;

use crate::project::*;

const SIZE: (usize, usize) = (4, 2);

fn gray(value: impl Fn(usize) -> f32) -> Plane<Vec3> {
    numbers(value).map(Vec3::splat)
}

fn numbers(value: impl Fn(usize) -> f32) -> Plane<f32> {
    Plane::from_fn(SIZE.0, SIZE.1, |x, y| value(y * SIZE.0 + x))
}

fn gather<T>(values: impl IntoIterator<Item = (&'static str, T)>) -> Gather<T> {
    Gather(values.into_iter().map(|(id, value)| (id.to_owned(), Arc::new(value))).collect())
}

fn unit(value: impl Fn(usize) -> f32) -> UnitDirect {
    UnitDirect { lobes: vec![numbers(value)], stderr: vec![numbers(|_| 0.0)] }
}

fn radiance(value: f32) -> Radiance {
    Radiance(vec![Vec3::splat(value)])
}

/// The first row of pixels shows the lamp.
fn mask() -> Gather<Mask> {
    gather([("lamp", Mask(numbers(|i| if i < SIZE.0 { 1.0 } else { 0.0 })))])
}

#[track_caller]
fn check(scores: &Scores, wanted: &[(&str, &str, f64)]) {
    let names: Vec<_> = scores.0.iter().map(|s| (s.subject.as_str(), s.measure.as_str())).collect();
    assert_eq!(
        names,
        wanted.iter().map(|(subject, measure, _)| (*subject, *measure)).collect::<Vec<_>>()
    );
    for (score, (.., wanted)) in scores.0.iter().zip(wanted) {
        assert!(
            (score.value - wanted).abs() < 1e-5 * wanted.abs().max(1.0),
            "{score:?}, wanted {wanted}"
        );
    }
}

#[test]
fn lights_are_scored_by_place_and_by_what_they_give() {
    let ball = |x: f32| Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::X * x, radius: 1.0 }));
    let inputs = ScoreLightsIn {
        shape: gather([
            ("lamp", ball(0.0)),
            ("inv_lamp", ball(0.0)),
            ("inv_window", Shape::Absent),
        ]),
        radiance: gather([
            ("lamp", radiance(2.0)),
            ("inv_lamp", radiance(1.0)),
            ("inv_window", Radiance(vec![])),
        ]),
        direct: gather([
            ("lamp", unit(|_| 0.5)),
            ("inv_lamp", unit(|i| i as f32)),
            ("inv_window", UnitDirect { lobes: vec![], stderr: vec![] }),
        ]),
        true_shape: gather([
            ("lamp", ball(0.0)),
            ("inv_lamp", Shape::Absent),
            ("inv_window", Shape::Absent),
        ]),
        true_radiance: gather([
            ("lamp", radiance(4.0)),
            ("inv_lamp", Radiance(vec![])),
            ("inv_window", Radiance(vec![])),
        ]),
        true_direct: gather(["lamp", "inv_lamp", "inv_window"].map(|id| {
            let lobes = if id == "lamp" {
                vec![numbers(|i| if i == 4 { 9.0 } else { 0.5 })]
            } else {
                vec![]
            };
            (id, UnitDirect { lobes, stderr: vec![] })
        })),
        mask: mask(),
    };
    let out =
        ScoreLights::default().run(inputs, &Context::default()).expect("the inputs are sound");
    // The lamp, at four pixels: 1 beside 36, which counts as 10, and three times 1 beside 2. A
    // missing lamp gives 4, 5, 6 and 7; a window that is missing on both sides is left out.
    check(
        &out.scores,
        &[("lamp", "Chamfer", 2e-3), ("lamp", "E_j", 3.0), ("inv_lamp", "E_j", 5.5)],
    );
}

#[test]
fn shadows_are_shares_of_what_would_arrive() {
    let visible =
        |lit: f32| Visibility { lit: vec![numbers(|_| lit)], stderr: vec![], unknown: vec![] };
    let inputs = |lit: f32| ScoreDirectIn {
        direct: gather([("lamp", unit(|_| 1.0))]),
        visibility: gather([("lamp", visible(lit))]),
        radiance: gather([("lamp", radiance(2.0))]),
        // Half of the pixels that count are in the shadow.
        truth: gather([("lamp", Picture(gray(|i| if i < 6 { 0.0 } else { 3.0 })))]),
        true_direct: gather([("lamp", unit(|_| 1.0))]),
        true_radiance: gather([("lamp", radiance(3.0))]),
        mask: mask(),
    };
    for lit in [1.0, 0.5] {
        let out = ScoreDirect::default()
            .run(inputs(lit), &Context::default())
            .expect("the inputs are sound");
        let (got, truth) = ((1.0 + 2.0 * f64::from(lit)).ln(), 4.0f64.ln());
        let error = (got * got + (got - truth).powi(2)) / 2.0;
        // An even shadow is as good as any other even one: its best level is a half.
        check(&out.scores, &[("lamp", "shadow", 0.25), ("all lights", "E_d", error)]);
    }
}

fn shading(truth: Gather<Picture>) -> ScoreShadingIn {
    ScoreShadingIn {
        light: gather([("lamp", Shading(gray(|_| 0.5))), ("inv_lamp", Shading(gray(|_| 0.25)))]),
        residual: Arc::new(Shading(gray(|_| 0.25))),
        photo: Arc::new(Picture(gray(|i| if i == 7 { 9.0 } else { 0.5 }))),
        clipped: Arc::new(Mask(numbers(|i| if i == 7 { 1.0 } else { 0.0 }))),
        truth,
        albedo: Arc::new(Albedo(gray(|i| if i == 5 { 0.01 } else { 0.5 }))),
        mask: mask(),
    }
}

/// Two pixels of truth for a photo of 4 x 2: the camera stored the left one a tenth too bright, the
/// right one clipped.
#[test]
fn pictures_are_scored_at_the_size_of_the_truth_and_as_the_camera_shows_them() {
    let truth =
        |left: f32, right: f32| Picture(Plane::from_fn(2, 1, |x, _| Vec3::splat([left, right][x])));
    let stored = |left: f32| Arc::new(Picture(gray(|i| if i % SIZE.0 < 2 { left } else { 1.0 })));
    let score = |left: f32| {
        let inputs = ScorePictureIn {
            picture: stored(left),
            photo: stored(0.66),
            light: gather([("lamp_0", truth(0.4, 3.0)), ("lamp_1", truth(0.2, 0.0))]),
            mask: gather([]),
            coverage: gather([]),
        };
        let stage = ScorePicture {
            subject: "lamp_1 off".into(),
            off: vec!["lamp_1".into()],
            ..ScorePicture::default()
        };
        let scores = stage.run(inputs, &Context::default()).expect("the inputs are sound").scores;
        scores
            .0
            .iter()
            .find(|score| score.measure == "change error")
            .expect("there is a change")
            .value
    };
    assert!(score(0.44) < 0.01, "the truth has an error of {}", score(0.44));
    assert!((score(0.66) - 1.0).abs() < 0.01, "the photo has an error of {}", score(0.66));
}

#[test]
fn all_shading_is_scored_on_what_tells_it() {
    let run = |inputs| ScoreShading::default().run(inputs, &Context::default());
    // 1 from the photo over its albedo, as estimated, where that is neither dark nor saturated.
    let out = run(shading(gather([]))).expect("the inputs are sound");
    check(&out.scores, &[("all lights", "E", 0.0)]);
    let alone = |value: f32| Picture(gray(move |i| if i == 5 { 100.0 } else { value }));
    let out = run(shading(gather([("lamp", alone(0.5)), ("inv_lamp", alone(1.0))])))
        .expect("the inputs are sound");
    check(&out.scores, &[("all lights", "E", (2.0f64.ln() - 4.0f64.ln()).powi(2))]);
    let wide = Picture(Plane::filled(9, 2, Vec3::ONE));
    let error = run(shading(gather([("lamp", wide)]))).err().expect("it does not fit");
    assert_eq!(error.to_string(), "the true pictures: wanted 4 x 2 pixels as the photo, got 9 x 2");
}

fn picture(photo: f32) -> ScorePictureIn {
    ScorePictureIn {
        picture: Arc::new(Picture(gray(|_| 0.25))),
        photo: Arc::new(Picture(gray(move |_| photo))),
        light: gather([("lamp", Picture(gray(|_| 0.25))), ("inv_lamp", Picture(gray(|_| 0.5)))]),
        mask: mask(),
        coverage: gather([]),
    }
}

#[test]
fn pictures_of_lights_that_are_not_of_this_photo_are_told() {
    let stage =
        ScorePicture { subject: "inv_lamp off".into(), off: vec!["inv_lamp".into()], truth: None };
    let run = |stage: &ScorePicture, inputs| stage.run(inputs, &Context::default());
    let out = run(&stage, picture(0.75)).expect("the pictures sum to the photo");
    let changed =
        out.scores.0.iter().find(|s| s.measure == "change error").expect("the truth differs").value;
    assert!(changed < 0.01, "{changed}: only storing in 8 bits takes something away");
    let error = run(&stage, picture(0.375)).err().expect("they do not");
    let wanted = "the true pictures of lamp, inv_lamp together are 100 % off the photo: wanted one of each light, in the photo's exposure";
    assert_eq!(error.to_string(), wanted);
    let stage = ScorePicture { off: vec!["window".into()], ..stage };
    let error = run(&stage, picture(0.75)).err().expect("there is no window");
    assert!(
        matches!(&error, NodeError::BadParameter(message) if message.contains("`window`")),
        "{error}"
    );
}

fn maps(shape: &str, values: &[f32]) -> Vec<u8> {
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    let padded = format!("{header:<117}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((padded.len() as u16).to_le_bytes());
    bytes.extend(padded.as_bytes());
    bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    bytes
}

#[test]
fn lighting_is_scored_on_the_cells_that_are_known() {
    let place = Place::new();
    let run = |bytes: &[u8]| {
        place.write("maps.npy", bytes);
        let truth = File::new(place.path("maps.npy").display().to_string());
        // The same radiance from everywhere.
        let lobes = vec![LocalLobe { axis: Vec3::Z, sharpness: 0.0, weight: Vec3::ONE }; 2];
        let inputs =
            ScoreLightingIn { lighting: Arc::new(Lighting { columns: 2, rows: 1, lobes }) };
        ScoreLighting { truth }.run(inputs, &Context::default()).map(|out| out.scores)
    };
    let cells = [vec![3.0; 3 * TEXELS], vec![f32::NAN; 3 * TEXELS]].concat();
    let scores = run(&maps("(1, 2, 8, 16, 3)", &cells)).expect("the maps are sound");
    check(&scores, &[("all lights", "lighting", 2.0f64.ln().powi(2))]);
    for (bytes, wanted) in [
        (
            maps("(2, 1, 8, 16, 3)", &cells),
            "grid: wanted 1 rows of 2 cells as estimated, got 2 of 1",
        ),
        (
            maps("(1, 2, 16, 8, 3)", &cells),
            "NPY shape: wanted (rows, columns, 8, 16, 3), got [1, 2, 16, 8, 3]",
        ),
        (maps("(768,)", &cells), "NPY shape: wanted (rows, columns, 8, 16, 3), got [768]"),
        (maps("(1, 2, 8, 16, 3)", &cells[1..]), "NPY data: wanted 1 x 2 maps, got "),
        (maps("(99999999, 99999999, 8, 16, 3)", &cells), "size in the header: wanted at most"),
        (b"PK".to_vec(), "file format: wanted maps of directions: NPY"),
    ] {
        let error = run(&bytes).expect_err("it is not sound").to_string();
        assert!(error.contains(wanted), "{error}");
    }
}

/// The demo under a depth with a scale error of 1.3.
fn bent() -> String {
    let text = std::fs::read_to_string(demo().join("scene.ron")).expect("the demo has one");
    let at = |part: &str| format!("\"{}", demo().join(part).display());
    ["photo.png", "depth.exr", "masks/", "truth/", "edits/"]
        .iter()
        .fold(text, |text, part| text.replace(&format!("\"{part}"), &at(part)))
        .replace("scale: 1.0", "scale: 1.3")
        .replace("truth: (", &format!("truth: (depth: {}\",", at("depth.exr")))
}

/// rung as `depth lights materials`, 1 where true -> subject, measure -> value.
pub fn figures(json: &[u8]) -> BTreeMap<String, BTreeMap<(String, String), f64>> {
    let report: Value = serde_json::from_slice(json).expect("it is JSON");
    let mut all: BTreeMap<String, BTreeMap<(String, String), f64>> = BTreeMap::new();
    for figure in report["figures"].as_array().expect("a list") {
        let rung = ["depth", "lights", "materials"]
            .map(|part| if figure[part] == true { '1' } else { '0' });
        let text = |key: &str| figure[key].as_str().expect("a text").to_owned();
        let value = figure["value"].as_f64().expect("a finite number");
        all.entry(rung.iter().collect())
            .or_default()
            .insert((text("subject"), text("measure")), value);
    }
    all
}

#[test]
fn the_demo_climbs_the_ladder() {
    let place = Place::new();
    place.write("scene.ron", bent());
    let output = place
        .command("eval . --graph GRAPHS/physics.ron --no-cache --json --set scene.long_side=240")
        .output()
        .expect("the program starts");
    check_output("eval", &output, 0);
    let written = std::fs::read(place.path("out/eval/eval.json")).expect("it is written");
    assert_eq!(written, output.stdout);
    let all = figures(&written);
    assert_eq!(
        all.keys().collect::<Vec<_>>(),
        ["000", "001", "010", "011", "100", "101", "110", "111"]
    );
    let of = |rung: &str, subject: &str, measure: &str| {
        all[rung][&(subject.to_owned(), measure.to_owned())]
    };

    let edits =
        ["lamp_0 off", "window_0 off", "invisible lights off", "insert_lamp", "open_window"];
    for edit in edits {
        assert!(of("100", edit, "PSNR") > of("100", edit, "unchanged"), "{edit}");
        let change = of("100", edit, "change error");
        assert!((0.02..0.8).contains(&change), "{edit}: {change}");
    }
    let mean = |rung: &str| {
        edits.iter().map(|edit| of(rung, edit, "change error")).sum::<f64>() / edits.len() as f64
    };
    assert!(mean("111") < 0.9 * mean("000"), "{} true, {} estimated", mean("111"), mean("000"));
    assert!(of("111", "all lights", "E") < 0.7 * of("000", "all lights", "E"));
    // With all depths 1.3 times too large, the lamp at 4.4 m is off by the same factor; the shading
    // of seen surfaces is unchanged.
    let away = of("000", "lamp_0", "Chamfer") - of("100", "lamp_0", "Chamfer");
    assert!((away - 2.0 * 0.3 * 4.4).abs() < 0.8, "{away}");
    assert!((of("000", "all lights", "E") - of("100", "all lights", "E")).abs() < 1e-3);
    // True lights cannot stand in wrong depth.
    assert!(of("010", "all lights", "E") > 2.0 * of("110", "all lights", "E"));
    for light in ["lamp_0", "window_0", "inv_lamp"] {
        assert!((0.01..0.3).contains(&of("100", light, "E_j")), "{light}");
    }
    assert!((2.0..15.0).contains(&of("100", "materials", "normal")));
    assert!(of("100", "materials", "albedo") < of("100", "materials", "albedo before the fit"));
}

#[test]
fn networks_are_evaluated_where_they_lie() {
    let place = Place::new();
    let (before, _) =
        bent().split_once("truth:").map(|(a, b)| (a.to_owned(), b.to_owned())).expect("it has one");
    place.write(
        "scene.ron",
        format!("{before} truth: (albedo: \"{}/truth/albedo.exr\"))", demo().display()),
    );
    let eval = "eval . --graph GRAPHS/indoor.ron --no-ladder --no-cache --json --backend rten --set scene.long_side=160";
    let output = place.command(eval).output().expect("the program starts");
    check_output("eval", &output, 0);
    let all = figures(&output.stdout);
    assert_eq!(all.keys().collect::<Vec<_>>(), ["000"]);
    let of = |measure: &str| all["000"][&("materials".to_owned(), measure.to_owned())];
    assert!(
        (1e-4..0.1).contains(&of("albedo before the fit")),
        "what MNet says: {}",
        of("albedo before the fit")
    );
    let message = place.check(&eval.replace("--json", "--models nowhere"), 2);
    assert!(message.contains("mnet.onnx cannot be read"), "{message}");
}

#[test]
fn truth_that_does_not_fit_is_told() {
    let place = Place::new();
    place.write("small.exr", small());
    let sound = bent();
    let lamp = format!("{}/truth/light_lamp_0.exr", demo().display());
    for (from, to, status, wanted) in [
        ("\"lamp_0\": \"", "\"lamp_1\": \"", 2, "the scene has no light `lamp_1`"),
        ("\"lamp_0\": \"", "\"lamp_1\": \"", 2, "`pictures` has none of the light `lamp_0`"),
        ("insert_lamp.ron", "insert_lmap.ron", 2, "insert_lmap.ron"),
        ("truth/light_lamp_0", "truth/light_lamp_9", 2, "light_lamp_9.exr cannot be read"),
        ("truth: (", "truth: (pictrues: {}, ", 2, "did you mean `pictures`?"),
        (&lamp, "small.exr", 2, "size: wanted 320 x 240 as `inv_lamp`, got 8 x 6"),
        (
            &lamp,
            &format!("{}/truth/open_window.exr", demo().display()),
            1,
            "off the photo: wanted one of each light",
        ),
    ] {
        let text = sound.replacen(from, to, 1);
        assert_ne!(text, sound, "{from}");
        place.write("scene.ron", text);
        let message = place.check("eval . --graph GRAPHS/physics.ron --no-cache", status);
        assert!(message.contains(wanted), "{to}: {message}");
    }
    let (before, _) = sound.split_once("truth:").expect("it has one");
    place.write("scene.ron", format!("{before})"));
    let message = place.check("eval . --graph GRAPHS/physics.ron --no-cache", 2);
    assert!(message.contains("wanted a scene with a `truth`, got none"), "{message}");
    place.write("scene.ron", &sound);
    let message = place.check("eval . --graph GRAPHS/planes.ron --no-cache", 2);
    assert!(message.contains("wanted a graph with a stage EditLights, got none"), "{message}");
}

/// A linear picture of 8 x 6 pixels.
fn small() -> Vec<u8> {
    let mut layers = relight::image::ExrLayers::new(8, 6);
    layers.float_rgb("", &Plane::filled(8, 6, Vec3::ONE));
    layers.write(relight::image::Compression::Zip).expect("it can be written")
}
