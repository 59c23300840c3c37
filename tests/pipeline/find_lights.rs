//! graphs/find_lights.ron: masks proposed for the demo and for photographs that may not be given
//! away, against given ones.

use std::path::{Path, PathBuf};

use glam::Vec3;
use needs::needs;
use relight::graph::ResolvedGraph;
use relight::nodes::artifacts::Files;

use crate::common::files::{npy, png_of};
use crate::project::*;

fn graph(scene: &Path) -> ResolvedGraph {
    let graph = load(&root().join("graphs/find_lights.ron"), scene, &edits().join("none.ron"));
    graph.unwrap_or_else(|faults| panic!("{}", faults[0]))
}

/// White pixels of a mask.
fn white(mask: &image::RgbImage) -> Vec<bool> {
    mask.pixels().map(|pixel| pixel.0[0] > 127).collect()
}

/// Intersection over union.
fn overlap(a: &[bool], b: &[bool]) -> f64 {
    let count =
        |both: fn(bool, bool) -> bool| a.iter().zip(b).filter(|(a, b)| both(**a, **b)).count();
    count(|a, b| a && b) as f64 / count(|a, b| a || b).max(1) as f64
}

/// Name and pixels of each proposed mask.
fn masks(files: &Files) -> Vec<(String, Vec<bool>)> {
    let named =
        files.0.iter().filter_map(|(name, bytes)| Some((name.strip_prefix("masks/")?, bytes)));
    named
        .map(|(name, bytes)| (name.trim_end_matches(".png").to_owned(), white(&png(bytes))))
        .collect()
}

#[test]
fn the_lights_of_the_demo_are_found_and_named() {
    let report = run(shared_engine(), &graph(&demo()), &[]);
    let files = one::<Files>(&report, "find.files");
    let found = masks(&files);
    for (light, least) in [("lamp_0", 0.95), ("window_0", 0.8)] {
        let given =
            std::fs::read(demo().join(format!("masks/{light}.png"))).expect("the demo has it");
        let (_, mask) = found.iter().find(|(name, _)| name == light).expect("it is found");
        let overlap = overlap(&white(&png(&given)), mask);
        assert!(overlap > least, "{light}: intersection over union {overlap:.2}");
    }
    let text = |name: &str| &files.0.iter().find(|(n, _)| n == name).expect("it is written").1;
    let lights = String::from_utf8(text("scene_lights.ron").clone()).expect("it is text");
    assert!(lights.contains(r#""window_0": Window(mask: "masks/window_0.png"),"#), "{lights}");
    assert_eq!(png(text("found.png")).dimensions(), photo().dimensions());
}

/// A folder with a scene that names no lights, of this photo.
fn unlit(photo: impl AsRef<[u8]>, size: (usize, usize)) -> Place {
    let place = Place::new();
    place.write(
        "scene.ron",
        r#"Scene(version: 1, photo: "photo.png", camera: FovX(60), depth: (path: "depth.npy"))"#,
    );
    place.write("photo.png", photo);
    place.write("depth.npy", npy(size, |_, _| 2.5));
    place
}

const LINE: &str = "run GRAPHS/find_lights.ron EDITS/none.ron --scene . --no-cache --out found";

#[test]
fn photos_without_lights_give_no_mask_and_say_so() {
    for (size, level) in [((40, 30), 1.0), ((40, 30), 0.0), ((1, 1), 1.0), ((1, 1), 0.0)] {
        let place = unlit(png_of(size, |_, _| Vec3::splat(level)), size);
        let message = place.check(LINE, 0);
        assert!(message.contains("warning: find: no light found"), "{message}");
        assert!(!place.path("found/masks").exists());
        let lights =
            std::fs::read_to_string(place.path("found/scene_lights.ron")).expect("it is written");
        assert!(lights.ends_with("lights: {\n},\n"), "{lights}");
    }
}

/// The proposal can be pasted and used; any number of threads proposes the same.
#[test]
fn the_proposal_is_a_scene() {
    let size = (80, 60);
    let bright = |x: usize, y: usize| (50..62).contains(&x) && (10..20).contains(&y);
    let photo =
        png_of(size, |x, y| Vec3::splat(if bright(x, y) { 1.0 } else { 0.2 + 0.001 * x as f32 }));
    let place = unlit(photo, size);
    place.check(&format!("{LINE} --threads 1"), 0);
    place.check(
        &format!(
            "{} --threads 4",
            LINE.replace("found", "again").replace("again_lights", "find_lights")
        ),
        0,
    );
    let read =
        |name: &str| std::fs::read(place.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    for name in ["masks/window_0.png", "found.png", "scene_lights.ron"] {
        assert!(read(&format!("found/{name}")) == read(&format!("again/{name}")), "{name}");
    }
    let lights = String::from_utf8(read("found/scene_lights.ron")).expect("it is text");
    let scene = String::from_utf8(read("scene.ron")).expect("it is text");
    place.write(
        "found/scene.ron",
        scene
            .replace(")))", &format!("),\n{lights})"))
            .replace("\"photo", "\"../photo")
            .replace("\"depth", "\"../depth"),
    );
    place.check("check GRAPHS/physics.ron EDITS/none.ron --scene found", 0);
    place.check(
        "run GRAPHS/find_lights.ron EDITS/none.ron --scene found --no-cache --out third --set find.threshold=0.5",
        0,
    );
}

#[test]
fn bad_parameters_are_named() {
    let place = unlit(png_of((8, 6), |_, _| Vec3::ONE), (8, 6));
    for (set, message) in [
        ("threshold=1", "threshold: wanted 0.1..=0.95, got 1"),
        ("smoothness=-1", "smoothness: wanted 0..=100, got -1"),
        ("smallest=2", "smallest: wanted 0..=1, got 2"),
        ("most=0", "most: wanted 1..=32, got 0"),
    ] {
        let all = place.check(&format!("{LINE} --set find.{set}"), 2);
        assert!(all.contains(message), "{all}");
    }
}

/// A photograph of ../shared with its masks: (folder, photo, camera, mask files by light).
struct Given {
    name: String,
    scene: String,
    masks: Vec<(String, PathBuf)>,
}

fn given() -> Vec<Given> {
    let shared = root().join("../shared");
    let folders = ["data/photos", "truth"]
        .into_iter()
        .flat_map(|part| std::fs::read_dir(shared.join(part)).expect("the folder can be listed"));
    let mut folders: Vec<PathBuf> = folders
        .map(|entry| entry.expect("it can be listed").path())
        .filter(|p| p.is_dir())
        .collect();
    folders.sort();
    let of_folder = |folder: &PathBuf| {
        let real = folder.join("photo.png").is_file();
        let about = std::fs::read(folder.join(if real { "about.json" } else { "meta.json" }))
            .expect("it is there");
        let about: serde_json::Value = serde_json::from_slice(&about).expect("it is JSON");
        let number = |key: &str| about[key].as_f64();
        let camera = match number("fov_x_deg").or(number("fov_x")) {
            Some(degrees) => format!("FovX({degrees})"),
            None => {
                let [fx, fy, cx, cy] =
                    ["fx", "fy", "cx", "cy"].map(|key| number(key).expect("it has a camera"));
                format!("Pinhole(fx: {fx}, fy: {fy}, cx: {cx}, cy: {cy})")
            }
        };
        let gamma = about["transfer"].as_str().is_some_and(|transfer| transfer.contains("2.2"));
        let transfer = if gamma { "Gamma(2.2)" } else { "Srgb" };
        let photo = folder.join(if real { "photo.png" } else { "input.png" });
        let (photo, depth) = (photo.display(), folder.join("depth.exr"));
        let depth = depth.display();
        let scene = format!(
            r#"Scene(version: 1, photo: "{photo}", transfer: {transfer}, camera: {camera}, depth: (path: "{depth}"))"#
        );
        let files = std::fs::read_dir(if real { folder.join("masks") } else { folder.clone() })
            .into_iter()
            .flatten();
        let mut masks: Vec<(String, PathBuf)> = files
            .map(|entry| entry.expect("it can be listed").path())
            .filter_map(|path| {
                let name = stem(&path).trim_start_matches("mask_").to_owned();
                let light = path.extension()? == "png"
                    && (name.starts_with("lamp") || name.starts_with("window"));
                (light && (real || stem(&path).starts_with("mask_"))).then_some((name, path))
            })
            .collect();
        masks.sort();
        let name = folder.file_name().expect("it has a name").to_string_lossy().into_owned();
        Given { name, scene, masks }
    };
    folders.iter().map(of_folder).collect()
}

/// The table of docs/find-lights.md.
#[needs("../shared/data/photos")]
#[needs("../shared/truth")]
#[test]
fn photographs_against_masks_by_people() {
    let photos = given();
    let (mut lights, mut hits, mut wrong) = (0, 0, 0);
    for Given { name, scene, masks: given } in &photos {
        let place = Place::new();
        place.write("scene.ron", scene);
        let report = run(shared_engine(), &graph(&place.path("")), &[]);
        let found = masks(&one::<Files>(&report, "find.files"));
        let given: Vec<_> = given
            .iter()
            .map(|(id, path)| (id, white(&png(&std::fs::read(path).expect("it is there")))))
            .collect();
        let mut line = Vec::new();
        for (id, mask) in &given {
            let best = found
                .iter()
                .map(|(name, pixels)| (overlap(mask, pixels), name))
                .max_by(|a, b| a.0.total_cmp(&b.0));
            let (best, name) = best.map_or((0.0, "none"), |(overlap, name)| (overlap, name));
            let hit = best > 0.5;
            let kind = id.split('_').next() == name.split('_').next();
            (lights, hits, wrong) =
                (lights + 1, hits + u32::from(hit), wrong + u32::from(hit && !kind));
            line.push(format!("{id} {best:.2}{}", if hit && !kind { " (wrong kind)" } else { "" }));
        }
        let share = |pixels: &[bool], mask: &[bool]| {
            let inside = pixels.iter().zip(mask).filter(|(a, b)| **a && **b).count() as f64;
            inside / pixels.iter().filter(|p| **p).count().max(1) as f64
        };
        // Neither in a given light nor around one.
        let strange = |pixels: &[bool]| {
            given.iter().all(|(_, mask)| share(pixels, mask) < 0.1 && share(mask, pixels) < 0.5)
        };
        let strange = found.iter().filter(|(_, pixels)| strange(pixels)).count();
        println!("| {name} | {} | {} | {strange} |", line.join(", "), found.len());
    }
    println!("{hits} of {lights} with IoU > 0.5, {wrong} of them of the wrong kind");
    assert!(hits >= 13 && wrong <= 2, "{hits} of {lights} lights found, {wrong} of the wrong kind");
}
