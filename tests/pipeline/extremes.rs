//! Extreme scenes and edits through the whole command: every channel that is written is finite and,
//! normals apart, not negative; or the edit is refused by name.

use std::fmt::Write as _;

use glam::Vec3;
use serde_json::Value;

use crate::common::files::{npy, png_of};
use crate::layers::channels;
use crate::project::*;

const SCENE: &str = r#"Scene(version: 1, photo: "photo.png", transfer: Linear, camera: FovX(60), depth: (path: "depth.npy"))"#;
const LIT: &str = r#"Scene(version: 1, photo: "photo.png", transfer: Linear, camera: FovX(60), depth: (path: "depth.npy"),
    lights: { "lamp": Lamp(mask: "lamp.png") })"#;
const GLOBE: &str =
    r#""globe": Lamp(shape: Sphere(radius: 0.1), at: Point(0, 0, -1), radiance: (9, 8, 7))"#;

fn paper(x: usize, y: usize) -> Vec3 {
    Vec3::new(
        0.2 + 0.3 * (x as f32 / 40.0).sin().abs(),
        0.4,
        0.2 + 0.3 * (y as f32 / 30.0).cos().abs(),
    )
}

fn slope(x: usize, y: usize) -> f32 {
    2.0 + 0.02 * x as f32 + 0.01 * y as f32
}

fn room(
    size: (usize, usize),
    photo: impl FnMut(usize, usize) -> Vec3,
    depth: impl Fn(usize, usize) -> f32,
) -> Place {
    let place = Place::new();
    place.write("scene.ron", SCENE);
    place.write("photo.png", png_of(size, photo));
    place.write("depth.npy", npy(size, depth));
    place
}

struct Ran {
    message: String,
    report: Value,
}

impl Ran {
    fn seconds(&self, node: &str) -> f64 {
        let nodes = self.report["nodes"].as_array().expect("a report lists nodes");
        let of = |kind: &&Value| {
            kind["name"].as_str().is_some_and(|name| name.split('[').next() == Some(node))
        };
        nodes.iter().filter(of).map(|node| node["seconds"].as_f64().expect("a number")).sum()
    }

    fn peak(&self) -> Option<f64> {
        self.report["peak_bytes"].as_f64()
    }
}

/// Runs with these lights; checks that the picture is finite and of this size.
fn check(place: &Place, what: &str, size: (usize, usize), lights: &str) -> Ran {
    place.write("edit.ron", format!("Edit(version: 1, lights: {{ {lights} }})"));
    let message =
        place.check("run GRAPHS/physics.ron edit.ron --scene . --cache cache --out out", 0);
    let [picture, layers] = place.pictures("out");
    let (width, height) = size;
    assert_eq!(png(&picture).dimensions(), (width as u32, height as u32), "{what}");
    for (name, samples) in channels(&layers) {
        let sound = |v: &f32| v.is_finite() && (*v >= 0.0 || name.starts_with("normal"));
        let bad = samples.iter().find(|v| !sound(v));
        assert!(bad.is_none(), "{what}: {name} holds {bad:?}; message:\n{message}");
    }
    let report =
        std::fs::read_to_string(place.path("out/report.json")).expect("the run wrote its report");
    Ran { message, report: serde_json::from_str(&report).expect("it is JSON") }
}

/// Reason: neighbors a factor of 1.5 apart in depth, and cubes of distances from 1e-9 to 1e12,
/// lose all digits of 32 bits when points are subtracted carelessly.
#[test]
fn depth_from_a_millimetre_to_ten_kilometers() {
    let place = room((40, 30), paper, |x, _| 10f32.powf(-3.0 + 7.0 * x as f32 / 39.0));
    check(&place, "seven decades of depth", (40, 30), GLOBE);
    for meters in [1e-3, 1e4] {
        let place = room((40, 30), paper, |_, _| meters);
        check(&place, "a flat wall", (40, 30), GLOBE);
    }
}

/// Reason: no neighbor to make a triangle, a normal or a gradient from, and fewer pixels than
/// unknowns.
#[test]
fn one_pixel_one_row_one_column() {
    for size in [(1, 1), (40, 1), (1, 40)] {
        let ran = check(&room(size, paper, slope), "a thin photo", size, GLOBE);
        assert!(
            size != (1, 1) || ran.message.contains("the radiances are not determined"),
            "{size:?} reported:\n{}",
            ran.message
        );
    }
}

/// Reason: ratios of the photo to itself are 0 / 0, and a fit to nothing, or to lower bounds alone,
/// does not have a solution.
#[test]
fn black_white_and_one_lit_pixel() {
    for (what, value, words) in [
        ("black", &(|_, _| Vec3::ZERO) as &dyn Fn(usize, usize) -> Vec3, "the photo is black"),
        ("white", &|_, _| Vec3::ONE, "the photo is saturated"),
        ("one lit pixel", &|x, y| Vec3::splat(f32::from(u8::from((x, y) == (24, 20)))), ""),
    ] {
        let place = room((40, 30), value, slope);
        place.write("scene.ron", LIT);
        place.write(
            "lamp.png",
            png_of((40, 30), |x, y| Vec3::splat(f32::from(u8::from(x < 6 && y < 6)))),
        );
        for lights in [GLOBE, r#""lamp": Off"#] {
            let ran = check(&place, what, (40, 30), lights);
            assert!(ran.message.contains(words), "{what} reported:\n{}", ran.message);
        }
    }
}

/// Reason: in a float file 1 is not an end, and its scale is anybody's choice. Unchanged it comes
/// back, and a lamp switched off leaves the same room at any scale.
#[test]
fn a_float_photo_of_any_scale() {
    let (width, height) = (40, 30);
    let lit = |x: usize, y: usize| {
        let away = (x as f32 - 3.0).hypot(y as f32 - 3.0);
        let lamp = if x < 6 && y < 6 { 20.0 - away } else { 0.0 };
        (0.3 + 6.0 / (1.0 + away * away / 60.0)) * paper(x, y) + lamp * Vec3::new(1.0, 0.8, 0.5)
    };
    let mut dark = Vec::new();
    for scale in [0.01, 1.0, 100.0] {
        let place = room((width, height), paper, slope);
        place.write("scene.ron", LIT.replace("photo.png", "photo.exr"));
        place.write(
            "lamp.png",
            png_of((width, height), |x, y| Vec3::splat(f32::from(u8::from(x < 6 && y < 6)))),
        );
        let pixel = |x, y| <(f32, f32, f32)>::from(scale * lit(x, y));
        exr::prelude::write_rgb_file(place.path("photo.exr"), width, height, pixel)
            .expect("it can be written");
        let shown = |lights: &str| {
            check(&place, "a float photo", (width, height), lights);
            let channels =
                channels(&std::fs::read(place.path("out/picture.exr")).expect("the run wrote it"));
            ["R", "G", "B"].map(|c| channels[c].iter().map(|v| v / scale).collect::<Vec<f32>>())
        };
        let same = shown("");
        for (i, (x, y)) in (0..width * height).map(|i| (i, (i % width, i / width))) {
            let (got, wanted) = (Vec3::from_array([0, 1, 2].map(|c| same[c][i])), lit(x, y));
            assert!(
                ((got - wanted) / wanted).abs().max_element() < 2e-3,
                "{scale}: {got} at ({x}, {y}), wanted {wanted}"
            );
        }
        dark.push(shown(r#""lamp": Off"#));
    }
    let sum =
        |picture: &[Vec<f32>; 3]| picture.iter().flatten().map(|&v| f64::from(v)).sum::<f64>();
    let sums: Vec<f64> = dark.iter().map(sum).collect();
    assert!(sums.iter().all(|s| (s / sums[1] - 1.0).abs() < 0.02), "{sums:?}");
}

/// Reason: 1e12 is beyond a half float and 1e-12 below it; a person may set both.
#[test]
fn radiances_of_twenty_four_decades() {
    let place = room((40, 30), paper, slope);
    for radiance in [1e-12f32, 1e-6, 1e6, 1e12] {
        let sphere = "shape: Sphere(radius: 0.1), at: Point(0, 0, -1)";
        let ran = check(
            &place,
            "radiance",
            (40, 30),
            &format!(r#""x": Lamp({sphere}, radiance: ({radiance:e}, 1, 0))"#),
        );
        assert_eq!(
            ran.message.contains("light_x reaches"),
            radiance > 65504.0,
            "{radiance:e} reported:\n{}",
            ran.message
        );
        let layers = channels(&place.pictures("out")[1]);
        let shown = layers["light_x.R"].iter().copied().fold(0.0, f32::max);
        // The body itself shows its radiance, beside green light of 1 in the same layer, where
        // halves round to 6e-8.
        let most = if radiance > 65504.0 { 1e-6 * radiance } else { 1e-3 * radiance + 6e-8 };
        assert!((shown - radiance).abs() <= most, "{radiance:e} shows {shown:e}");
    }
    let sphere = "shape: Sphere(radius: 0.1), at: Point(0, 0, -1)";
    check(
        &place,
        "faint",
        (40, 30),
        &format!(r#""x": Lamp({sphere}, radiance: (1e-12, 1e-12, 1e-12))"#),
    );
    let shown =
        channels(&place.pictures("out")[1])["light_x.R"].iter().copied().fold(0.0, f32::max);
    assert!((shown / 1e-12 - 1.0).abs() < 1e-6, "{shown:e}");
}

/// Reason: a distance of 0 divides by 0, 1e-6 m is below the rounding of a point at 2 m, 1e4 m
/// leaves nothing of the solid angle.
#[test]
fn lamps_at_every_distance_from_a_surface() {
    let place = room((40, 30), paper, slope);
    let shapes = [
        ("Sphere(radius: 0.1)", 0.1),
        ("Rect(half: (0.2, 0.2), normal: (0, 0, 1))", 0.0),
        ("Rect(half: (0.2, 0.2), normal: (0, 0, -1))", 0.0),
        ("Box(half: (0.1, 0.1, 0.1), yaw: 20)", 0.1),
    ];
    let mut lights = String::new();
    for (i, (shape, touching)) in shapes.into_iter().enumerate() {
        // Touching, 1 micrometer and 10 km before the surface; sunk in it; around the camera.
        let lifts = [touching, touching + 1e-6, 1e4]
            .map(|lift| format!("Pixel(x: 20, y: 15, lift: {lift:e})"));
        let places =
            lifts.into_iter().chain(["Point(0, 0, -2.35)".into(), "Point(0, 0, 0)".into()]);
        for (j, at) in places.enumerate() {
            write!(lights, r#""l{i}_{j}": Lamp(shape: {shape}, at: {at}, radiance: (5, 4, 3)), "#)
                .expect("text can grow");
        }
    }
    check(&place, "twenty lamps", (40, 30), &lights);
}

/// Reason: normals and areas of degenerate shapes are 0 / 0. An extent of 0 is a mistake; a tiny
/// one is a lamp of no power.
#[test]
fn bodies_without_extent() {
    let place = room((40, 30), paper, slope);
    let at = "at: Point(0, 0, -1)";
    for (shape, name) in [
        ("Sphere(radius: 0)", "radius"),
        ("Rect(half: (0, 0.2), normal: (0, 0, 1))", "half"),
        ("Box(half: (0.1, 0, 0.1))", "half"),
        ("Rect(half: (0.1, 0.1), normal: (0, 0, 0))", "normal"),
    ] {
        place.write(
            "edit.ron",
            format!(r#"Edit(version: 1, lights: {{ "x": Lamp(shape: {shape}, {at}, radiance: (1, 1, 1)) }})"#),
        );
        let message = place.check("run GRAPHS/physics.ron edit.ron --scene . --cache cache", 2);
        assert!(message.contains("\"x\"") && message.contains(name), "{shape} message:\n{message}");
    }
    place.write(
        "edit.ron",
        format!(r#"Edit(version: 1, lights: {{ "x": Lamp(shape: Sphere(radius: 1e-30), {at}, flux: 800) }})"#),
    );
    let message = place.check("run GRAPHS/physics.ron edit.ron --scene . --cache cache", 2);
    assert!(message.contains("\"x\"") && message.contains("radiance"), "message:\n{message}");
    let needles = [
        "Sphere(radius: 1e-30)",
        "Rect(half: (1e-9, 1), normal: (0, 0, 1))",
        "Rect(half: (1e-30, 1e-30), normal: (0, 1, 0))",
        "Box(half: (1e-9, 1, 1e-9))",
        "Box(half: (1e-30, 1e-30, 1e-30), yaw: 45)",
    ];
    let lights = needles.iter().enumerate();
    let lights = lights
        .map(|(i, shape)| format!(r#""l{i}": Lamp(shape: {shape}, {at}, radiance: (5, 4, 3)), "#));
    check(&place, "needles", (40, 30), &lights.collect::<String>());
}

/// Reason: NaN passes every comparison that tests for an error. It is refused before any work, with
/// its location.
#[test]
fn what_is_no_number_is_refused() {
    let place = room((40, 30), paper, slope);
    for light in [
        "Lamp(shape: Sphere(radius: 0.1), at: Point(NaN, 0, -1), radiance: (5, 5, 5))",
        "Lamp(shape: Sphere(radius: NaN), at: Point(0, 0, -1), radiance: (5, 5, 5))",
        "Lamp(shape: Sphere(radius: 0.1), at: Point(0, 0, -1), radiance: (inf, 5, 5))",
        "Lamp(shape: Sphere(radius: 0.1), at: Point(1e39, 0, -1), radiance: (5, 5, 5))",
        "Scale(NaN)",
    ] {
        place.write("edit.ron", format!(r#"Edit(version: 1, lights: {{ "x": {light} }})"#));
        let message = place.check("run GRAPHS/physics.ron edit.ron --scene . --cache cache", 2);
        assert!(message.contains("finite number"), "{light} message:\n{message}");
    }
}

/// Reason: the sum of a few lights must not overflow; the message names the light that is too
/// bright, and nothing else.
#[test]
fn a_light_too_bright_for_sums_is_named() {
    let place = room((40, 30), paper, slope);
    place.write(
        "edit.ron",
        format!(r#"Edit(version: 1, lights: {{ {} }})"#, GLOBE.replace("9,", "1e31,")),
    );
    let message = place.check("run GRAPHS/physics.ron edit.ron --scene . --cache cache", 2);
    let errors: Vec<&str> = message.lines().filter(|line| line.starts_with("error: ")).collect();
    assert_eq!(errors, [r#"error: edit: lights: "globe": wanted a radiance up to 1e30, got 1e31"#]);
}

fn many_lamps(count: usize) -> String {
    let mut lights = String::new();
    for i in 0..count {
        // A low-discrepancy cloud before the wall.
        let [x, y, z] =
            [0.819_172_5, 0.671_043_6, 0.549_700_5].map(|step| (i as f64 * step).fract());
        let at =
            format!("Point({:.4}, {:.4}, {:.4})", 2.0 * x - 1.0, 1.4 * y - 0.7, -0.5 - 1.5 * z);
        write!(
            lights,
            r#""l{i}": Lamp(shape: Sphere(radius: 0.02), at: {at}, radiance: (5, 4, 3)), "#
        )
        .expect("text can grow");
    }
    lights
}

/// Reason: a loop over pairs of lights, or over the whole room for each light, shows as more than
/// ten times the time and memory of a tenth of the lights.
#[test]
fn two_thousand_lamps() {
    let [few, many] = [200, 2000].map(|count| {
        let place = room((40, 30), paper, slope);
        check(&place, "many lamps", (40, 30), &many_lamps(count))
    });
    for node in [
        "edit",
        "after",
        "compose",
        "write",
        "edited_direct",
        "edited_shadow",
        "edited_indirect",
        "glow",
    ] {
        let (few, many) = (few.seconds(node), many.seconds(node));
        // Other work may run beside: three times the proportion, and a second of grace.
        assert!(many < 30.0 * few + 1.0, "{node}: {few} s for 200 lamps, {many} s for 2000");
    }
    // About 0.2 MB each: four planes of 1200 pixels, EXR channels, keys and texts.
    if let Some(peak) = many.peak() {
        assert!(peak < 1e9, "{peak} bytes");
    }
}

/// The same at the usual working size. Measured: 50 s on two slow cores, 1.7 GB.
#[test]
#[ignore = "takes a minute"]
fn two_hundred_lamps_at_working_size() {
    let place = room((320, 240), paper, slope);
    let ran = check(&place, "200 lamps", (320, 240), &many_lamps(200));
    if let Some(peak) = ran.peak() {
        assert!(peak < 2.5e9, "{peak} bytes");
    }
}

/// Bytes that a run may take beyond 200 MB, per pixel of the photo and with four layers: per layer
/// 6 in memory or in the file; 12 for the picture and as much for the photo, 4 for the depth; and
/// of small results, as here, as much again, which the memory cache keeps.
const BYTES_PER_PIXEL: f64 = 90.0;

fn large(size: (usize, usize)) {
    let place = room(size, paper, slope);
    place.write("depth.npy", npy((64, 48), slope));
    place.write("edit.ron", format!("Edit(version: 1, lights: {{ {GLOBE} }})"));
    let message =
        place.check("run GRAPHS/physics.ron edit.ron --scene . --no-cache --out out --set write.diagnostics=false", 0);
    let report =
        std::fs::read_to_string(place.path("out/report.json")).expect("the run wrote its report");
    let report: Value = serde_json::from_str(&report).expect("it is JSON");
    let pixels = (size.0 * size.1) as f64;
    if let Some(peak) = report["peak_bytes"].as_f64() {
        println!("{size:?}: {:.0} MB, {:.0} bytes a pixel", peak / 1e6, peak / pixels);
        assert!(peak < 2e8 + BYTES_PER_PIXEL * pixels, "{peak} bytes; message:\n{message}");
    }
}

/// Reason: memory must grow with the photo's size as the few planes that are written, not as every
/// intermediate at full size.
#[test]
fn a_large_photo_takes_bounded_memory() {
    large((1600, 1200));
}

/// The largest that cameras give. 50 megapixels; the same bound, 4.7 GB.
#[test]
#[ignore = "takes a minute and 4 GB"]
fn the_largest_photo_takes_bounded_memory() {
    large((8192, 6144));
}
