//! graphs/planes.ron: layers of known lights on the demo, by the stages and by the path tracer.

use std::collections::BTreeMap;

use glam::Vec3;
use relight::graph::ResolvedGraph;
use relight::nodes::artifacts::{Files, UnitDirect, UnitIndirect, Visibility};
use relight::optics::{Lobe, Radiance, Shape};

use crate::layers::channels;
use crate::project::*;

fn planes() -> ResolvedGraph {
    let graph = load(&root().join("graphs/planes.ron"), &demo(), &edits().join("none.ron"));
    graph.unwrap_or_else(|faults| panic!("{}", faults[0]))
}

/// Written planes as pixels of colors.
fn colors(channels: &BTreeMap<String, Vec<f32>>, layer: &str) -> Vec<Vec3> {
    let [r, g, b] = ["R", "G", "B"].map(|c| &channels[&format!("{layer}.{c}")]);
    r.iter().zip(g).zip(b).map(|((&r, &g), &b)| Vec3::new(r, g, b)).collect()
}

#[test]
fn the_file_holds_what_the_stages_give_bit_for_bit() {
    let report = run(shared_engine(), &planes(), &["write.files", "direct", "shadow", "indirect"]);
    let channels = channels(&written(&report, "planes.exr"));
    let mut names: Vec<String> =
        ["normal.X", "normal.Y", "normal.Z", "depth.Z"].map(str::to_owned).into();
    let mut same = |name: String, wanted: &[f32]| {
        assert!(
            channels[&name].iter().zip(wanted).all(|(a, b)| a.to_bits() == b.to_bits()),
            "{name}"
        );
        assert_eq!((channels[&name].len(), wanted.len()), (320 * 240, 320 * 240), "{name}");
        names.push(name);
    };
    for (id, direct) in many::<UnitDirect>(&report, "direct") {
        let lobes = match id.as_str() {
            "inv_window" => 0, // it is not in the file
            "window_0" => 3,
            _ => 1,
        };
        assert_eq!(direct.lobes.len(), lobes, "{id}");
        direct
            .lobes
            .iter()
            .enumerate()
            .for_each(|(k, plane)| same(format!("direct_{id}_{k}.Y"), plane.pixels()));
    }
    for (id, visibility) in many::<Visibility>(&report, "shadow") {
        for (k, (lit, unknown)) in visibility.lit.iter().zip(&visibility.unknown).enumerate() {
            same(format!("lit_{id}_{k}.Y"), lit.pixels());
            same(format!("unknown_{id}_{k}.Y"), unknown.pixels());
            let seen =
                lit.pixels().iter().zip(unknown.pixels()).map(|(lit, unknown)| lit - unknown);
            // Sums of eight weights, spread over pixels: rounding.
            assert!(
                seen.clone().fold(1.0, f32::min) > -1e-5,
                "{id}: what is unknown counts as lit"
            );
            // The lamp above the camera is out of view: its unblocked rays have left the view. Only
            // pixels that no light could reach have no unknown rays.
            let known = seen
                .zip(unknown.pixels())
                .filter(|&(seen, &unknown)| seen > 1e-5 && unknown > 0.0)
                .count();
            assert!((known == 0) == (id == "inv_lamp"), "{id}: {known} pixels see part of it");
        }
    }
    for (id, indirect) in many::<UnitIndirect>(&report, "indirect") {
        for (k, shading) in indirect.lobes.iter().enumerate() {
            for (c, channel) in ["R", "G", "B"].into_iter().enumerate() {
                let plane = shading.0.map(|v| v.to_array()[c]);
                same(format!("indirect_{id}_{k}.{channel}"), plane.pixels());
            }
        }
    }
    names.sort();
    assert_eq!(channels.keys().collect::<Vec<_>>(), names.iter().collect::<Vec<_>>());
}

/// Albedo x sum of radiance x (direct x lit + indirect) is each light's own picture, in its units:
/// the median pixel of the lamp is 11 % too dark and that of the window 15 % too bright, as the
/// unseen part is a guess.
#[test]
fn known_lights_give_the_true_picture_of_each() {
    let report = run(shared_engine(), &planes(), &["write.files", "known.radiance"]);
    let channels = channels(&written(&report, "planes.exr"));
    let albedo = exr(&demo().join("truth/albedo.exr"));
    for (id, radiance) in many::<Radiance>(&report, "known.radiance") {
        if id.starts_with("inv_") {
            continue; // most of what they light is not seen
        }
        let mut shading = vec![Vec3::ZERO; albedo.len()];
        for (k, &w) in radiance.0.iter().enumerate() {
            let (direct, lit) =
                (&channels[&format!("direct_{id}_{k}.Y")], &channels[&format!("lit_{id}_{k}.Y")]);
            let indirect = colors(&channels, &format!("indirect_{id}_{k}"));
            for (p, sum) in shading.iter_mut().enumerate() {
                *sum += w * (Vec3::splat(direct[p] * lit[p]) + indirect[p]);
            }
        }
        let truth = exr(&demo().join(format!("truth/light_{id}.exr")));
        let model = shading.iter().zip(albedo.pixels()).map(|(e, a)| (e * a).element_sum());
        let mut ratios: Vec<f32> =
            model.zip(truth.pixels()).map(|(m, t)| m / t.element_sum().max(1e-6)).collect();
        ratios.sort_by(f32::total_cmp);
        let median = ratios[ratios.len() / 2];
        println!("{id}: {median:.3} of the true light");
        assert!((0.8..1.25).contains(&median), "{id}: {median}");
    }
}

#[test]
fn the_graph_on_the_page_takes_known_lights() {
    let page = std::fs::read_to_string(root().join("docs/planes.md")).expect("the page is there");
    let graph =
        page.split("```").find(|part| part.contains("Graph(")).expect("the page shows a graph");
    let place = Place::new();
    let physics = root().join("graphs/physics.ron").display().to_string();
    place.write("known.ron", graph.trim_start_matches("ron\n").replace("physics.ron", &physics));
    let graph = load(&place.path("known.ron"), &demo(), &edits().join("lamp_off.ron"));
    let graph = graph.unwrap_or_else(|faults| panic!("{}", faults[0]));
    let report = run(shared_engine(), &graph, &["edit.radiance"]);
    let radiances = many::<Radiance>(&report, "edit.radiance");
    let of = |id: &str| {
        radiances.iter().find(|(name, _)| name == id).map(|(_, radiance)| radiance.0.clone())
    };
    assert_eq!(of("lamp_0"), Some(vec![Vec3::ZERO]));
    assert_eq!(of("inv_lamp"), Some(vec![Vec3::new(36.0, 33.5, 29.5)]));
}

/// The demo's files in a folder of their own, whose lights can be spoilt.
fn room() -> (Place, String) {
    let place = Place::new();
    let scene = std::fs::read_to_string(demo().join("scene.ron")).expect("the demo has one");
    let away = |name: &str| format!("\"{}\"", demo().join(name).display());
    let names = [
        "photo.png",
        "depth.exr",
        "masks/lamp_0.png",
        "masks/window_0.png",
        "truth/albedo.exr",
        "truth/normal.exr",
    ];
    let scene =
        names.iter().fold(scene, |scene, name| scene.replace(&format!("\"{name}\""), &away(name)));
    place.write("scene.ron", scene.replace("truth/lights.json", "lights.json"));
    let lights =
        std::fs::read_to_string(demo().join("truth/lights.json")).expect("the demo has them");
    (place, lights)
}

/// Estimates that are written are the same when they are read: windows to rounding, as their
/// directions are normalized again.
#[test]
fn estimates_can_be_read_back() {
    let graph = load(&root().join("graphs/estimate.ron"), &demo(), &edits().join("none.ron"));
    let graph = graph.unwrap_or_else(|faults| panic!("{}", faults[0]));
    let report = run(shared_engine(), &graph, &["estimates.files", "init.shape", "fit.radiance"]);
    let (place, _) = room();
    for (name, bytes) in &one::<Files>(&report, "estimates.files").0 {
        place.write(name, bytes);
    }
    let scene = std::fs::read_to_string(place.path("scene.ron")).expect("it is there");
    let albedo = format!("\"{}\"", demo().join("truth/albedo.exr").display());
    place.write("scene.ron", scene.replace(&albedo, "\"albedo.exr\""));
    let again = load(&root().join("graphs/planes.ron"), &place.path(""), &edits().join("none.ron"));
    let again = again.unwrap_or_else(|faults| panic!("{}", faults[0]));
    let again = run(shared_engine(), &again, &["known.shape", "known.radiance"]);
    let read: BTreeMap<_, _> = many::<Radiance>(&again, "known.radiance").into_iter().collect();
    assert_eq!(read, many::<Radiance>(&report, "fit.radiance").into_iter().collect());
    let [got, wanted] =
        [many::<Shape>(&again, "known.shape"), many::<Shape>(&report, "init.shape")]
            .map(|shapes| shapes.into_iter().collect::<BTreeMap<_, _>>());
    assert!(wanted.values().any(|shape| matches!(**shape, Shape::Window(_))));
    for ((id, got), (name, wanted)) in got.iter().zip(&wanted) {
        let same = match (&**got, &**wanted) {
            (Shape::Window(a), Shape::Window(b)) => {
                let near = |(a, b): (&Lobe, &Lobe)| {
                    a.direction.distance(b.direction) < 1e-6 && a.bandwidth == b.bandwidth
                };
                (a.center, a.x, a.y) == (b.center, b.x, b.y)
                    && a.lobes.iter().zip(&b.lobes).all(near)
            }
            (a, b) => a == b,
        };
        assert!(id == name && same, "{id}: {got:?}, wanted {wanted:?}");
    }
}

#[test]
fn bad_lights_are_named_by_the_command() {
    let (place, lights) = room();
    let line = "run GRAPHS/planes.ron EDITS/none.ron --scene . --no-cache";
    let check = |lights: &str, words: &[&str]| {
        place.write("lights.json", lights);
        let message = place.check(line, 2);
        for word in words {
            assert!(message.contains(word), "wanted {word:?}, got:\n{message}");
        }
    };
    let bad = lights.replace("\"bandwidth\": 1.5", "\"bandwidth\": -1.5");
    check(
        &bad,
        &[
            "lights.json: line 3, column",
            "`window_0`: bandwidth: wanted a number 0..=1e7, got -1.5",
        ],
    );
    check(
        &lights.replace("\"window_0\"", "\"window_1\""),
        &["did you mean `window_0`?", "`window_0` is not in this file"],
    );
    check(&lights[..lights.len() / 2], &["lights.json", "is never closed"]);
    check("", &["lights.json", "got an empty file"]);
    check("\u{0}\u{1}", &["lights.json"]);
    place.write("lights.json", [0xff, 0xfe, 0]);
    assert!(place.check(line, 2).contains("wanted UTF-8 text"));
    std::fs::remove_file(place.path("lights.json")).expect("it is there");
    assert!(place.check(line, 2).contains("lights.json cannot be read"));
    let scene = std::fs::read_to_string(place.path("scene.ron")).expect("it is there");
    place.write("scene.ron", scene.replace("lights: \"lights.json\",", ""));
    assert!(
        place
            .check(line, 2)
            .contains("path: wanted a file, got none; a scene names it as `truth: (lights:")
    );
    place.write("scene.ron", scene.replace("lights: \"lights.json\"", "ligths: \"lights.json\""));
    let message = place.check(line, 2);
    assert!(
        message.contains("unknown field `ligths`") && message.contains("did you mean `lights`?"),
        "{message}"
    );
}
