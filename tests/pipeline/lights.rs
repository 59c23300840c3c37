//! Lamps with profiles, moved lamps, and skies behind windows, through the whole pipeline.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::Vec3;
use needs::needs;
use relight::geometry::Model;
use relight::graph::RunReport;
use relight::image::{Mask, Picture, luminance};
use relight::nodes::artifacts::{UnitDirect, Visibility};
use relight::optics::{Lamp, MeshLamp, PhotometricLamp, Radiance, Shape};

use crate::project::*;

/// A folder with an edit and the files that it names, put together with the demo.
fn run_files(files: &[(&str, &[u8])], edit: &str, outputs: &[&str]) -> RunReport {
    let place = Place::new();
    files.iter().for_each(|(name, bytes)| place.write(name, bytes));
    place.write("edit.ron", edit);
    let graph = load(&root().join("graphs/physics.ron"), &demo(), &place.path("edit.ron"));
    run(shared_engine(), &graph.unwrap_or_else(|faults| panic!("{edit}: {}", faults[0])), outputs)
}

fn run_edit(edit: &str, outputs: &[&str]) -> RunReport {
    run(shared_engine(), &physics(&demo(), edit), outputs)
}

fn of<T>(all: Vec<(String, Arc<T>)>, id: &str) -> Arc<T> {
    all.into_iter().find(|(name, _)| name == id).expect("the light is there").1
}

#[test]
fn a_profile_shines_where_its_candela_are() {
    let file = std::fs::read(root().join("scenes/demo/models/spot.ies")).expect("it ships");
    let outputs = ["edited_direct", "edit.shape", "edit.radiance"];
    let spot = |more: &str| {
        let lamp = format!(
            r#""spot": Lamp(shape: Sphere(radius: 0.03), at: Point(0.1, 0.7, -2.9), ies: "spot.ies", temperature: 6500{more})"#
        );
        let report = run_files(
            &[("spot.ies", &file)],
            &format!("Edit(version: 1, lights: {{ {lamp} }})"),
            &outputs,
        );
        let radiance: Arc<Radiance> = of(many(&report, "edit.radiance"), "spot");
        (of::<UnitDirect>(many(&report, "edited_direct"), "spot"), radiance.0[0])
    };
    // The demo is 320 x 240: the coffee table below the lamp, the wall behind it, the sofa to the
    // left.
    let (direct, radiance) = spot("");
    let at = |x: usize, y: usize| direct.lobes[0].get(x, y);
    assert!(
        at(160, 172) > 20.0 * at(60, 100) && at(160, 172) > 10.0 * at(250, 180),
        "the beam goes down"
    );
    let (ahead, _) = spot(", axis: (0, 0, -1)");
    assert!(
        ahead.lobes[0].get(165, 81) > 20.0 * ahead.lobes[0].get(160, 172),
        "turned, it goes to the painting"
    );

    // Without a flux the file's own: 2 pi times the integral of its candela, here by the rule of
    // midpoints.
    let angles =
        [0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0f64];
    let candela =
        [1512.0, 1332.3, 912.4, 487.5, 206.2, 72.7, 25.6, 12.7, 9.6, 7.7, 6.0, 4.1, 2.1, 0.0f64];
    let mut lumens = 0.0;
    for (v, i) in angles.windows(2).zip(candela.windows(2)) {
        for step in 0..1000 {
            let t = (f64::from(step) + 0.5) / 1000.0;
            let angle = (v[0] + (v[1] - v[0]) * t).to_radians();
            let width = (v[1] - v[0]).to_radians() / 1000.0;
            lumens += std::f64::consts::TAU * (i[0] + (i[1] - i[0]) * t) * angle.sin() * width;
        }
    }
    let (_, doubled) = spot(&format!(", flux: {}", 2.0 * lumens));
    let ratio = luminance(doubled) / luminance(radiance);
    assert!(
        (ratio - 2.0).abs() < 1e-3,
        "the file holds {lumens} lumens, and twice that is {ratio} times the light"
    );
    let graph = load(&root().join("graphs/physics.ron"), &demo(), &edits().join("spot.ron"));
    let report = run(
        shared_engine(),
        &graph.unwrap_or_else(|faults| panic!("{}", faults[0])),
        &["edit.shape"],
    );
    let Shape::Lamp(Lamp::Photometric(PhotometricLamp { center, .. })) =
        *of::<Shape>(many(&report, "edit.shape"), "spot")
    else {
        panic!("a profile makes a luminaire")
    };
    assert!((center - Vec3::new(0.1, 0.7, -2.9)).length() < 1e-6);
}

/// A ball and a box of triangles beside the sphere and the box: their direct light and its visible
/// part. The difference is the noise of samples: 20480 triangles have no closed form, the 12 of the
/// box have.
#[test]
fn a_model_lights_the_room_as_the_same_form_does() {
    let Model { positions, triangles, .. } = Model::sphere();
    let vertices: String =
        positions.iter().map(|p| format!("v {} {} {}\n", p.x, p.y, p.z)).collect();
    let faces: String =
        triangles.iter().map(|t| format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1)).collect();
    let ball = vertices + &faces;
    let cuboid = "v -3 -1 -2\nv 3 -1 -2\nv 3 1 -2\nv -3 1 -2\nv -3 -1 2\nv 3 -1 2\nv 3 1 2\nv -3 1 2\n\
        f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 3 4 8 7\nf 2 3 7 6\nf 4 1 5 8\n";
    let outputs = ["edited_direct", "edited_shadow", "glow", "edit.radiance"];
    let run = |shape: &str| {
        let lamp = format!(
            r#""globe": Lamp(shape: {shape}, at: Pixel(x: 178, y: 176, lift: 0.3), flux: 900)"#
        );
        let files = [("ball.obj", ball.as_bytes()), ("cuboid.obj", cuboid.as_bytes())];
        run_files(&files, &format!("Edit(version: 1, lights: {{ {lamp} }})"), &outputs)
    };
    for (model, form, mean_bound, bound) in [
        (r#"Mesh(path: "ball.obj", height: 0.2)"#, "Sphere(radius: 0.1)", 0.01, 0.05),
        (
            r#"Mesh(path: "cuboid.obj", height: 0.1, yaw: 30)"#,
            "Box(half: (0.15, 0.05, 0.1), yaw: 30)",
            1e-3,
            0.02,
        ),
    ] {
        let [model, form] = [model, form].map(run);
        let arrives = |report: &RunReport| {
            let direct = of::<UnitDirect>(many(report, "edited_direct"), "globe");
            let visibility = of::<Visibility>(many(report, "edited_shadow"), "globe");
            let radiance = luminance(of::<Radiance>(many(report, "edit.radiance"), "globe").0[0]);
            let pixels = direct.lobes[0].pixels().iter().zip(visibility.lit[0].pixels());
            pixels.map(|(e, v)| f64::from(e * v * radiance)).collect::<Vec<f64>>()
        };
        let (got, wanted) = (arrives(&model), arrives(&form));
        let sum = |values: &[f64]| values.iter().sum::<f64>();
        let apart: f64 = got.iter().zip(&wanted).map(|(a, b)| (a - b).abs()).sum();
        let (mean, apart) = (sum(&got) / sum(&wanted) - 1.0, apart / sum(&wanted));
        assert!(mean.abs() < mean_bound && apart < bound, "mean {mean:.4}, pixels {apart:.4}");
        let cover = |report: &RunReport| {
            of::<Mask>(many(report, "glow"), "globe").0.pixels().iter().sum::<f32>()
        };
        assert!(
            (cover(&model) / cover(&form) - 1.0).abs() < 0.01,
            "{} {}",
            cover(&model),
            cover(&form)
        );
    }
}

#[test]
fn the_lantern_shines_and_can_be_moved() {
    let shipped = shipped("mesh_lamp")
        .replace(&format!("{}/models/", root().join("scenes/demo").display()), "");
    let file = std::fs::read(root().join("scenes/demo/models/lantern.obj")).expect("it ships");
    let report =
        run_files(&[("lantern.obj", &file)], &shipped, &["edit.shape", "compose.picture", "glow"]);
    let shape = of::<Shape>(many(&report, "edit.shape"), "lantern");
    let (middle, radius) = shape.bounding_sphere().expect("a lamp");
    assert!(
        (middle - Vec3::new(0.1, 0.45, -2.9)).length() < 1e-5 && radius < 0.3,
        "{middle} {radius}"
    );
    let Shape::Lamp(Lamp::Mesh(MeshLamp { corners, .. })) = &*shape else { panic!("a model") };
    let height = |sign: f32| corners.iter().map(|p| sign * p.y).fold(f32::NEG_INFINITY, f32::max);
    assert!((height(1.0) + height(-1.0) - 0.32).abs() < 0.01, "the demo's camera is nearly level");
    let cover: Arc<Mask> = of(many(&report, "glow"), "lantern");
    let middle = cover.0.get(169, 80);
    assert_eq!((middle, cover.0.get(100, 80)), (1.0, 0.0));
}

#[test]
fn a_moved_lamp_leaves_its_shade_and_takes_its_light_along() {
    let outputs =
        ["compose.layer", "glow", "edit.shape", "edit.radiance", "fit.radiance", "init.shape"];
    let moved = run_edit(&shipped("move_lamp"), &outputs);
    let off = run_edit(r#"Edit(version: 1, lights: { "lamp_0": Off })"#, &outputs);
    let layer = |report: &RunReport, id: &str| of::<Picture>(layers(report), id);
    let cover: Arc<Mask> = of(many(&moved, "glow"), "lamp_0");
    let mask = relight::image::read_mask(relight::image::NamedBytes::new(
        "lamp_0.png",
        &std::fs::read(demo().join("masks/lamp_0.png")).expect("the demo has its mask"),
    ))
    .unwrap_or_else(|e| panic!("{}", e.message()));
    let (mut own, mut glowing) = (0, 0);
    for i in 0..mask.0.len() {
        if cover.0.pixels()[i] > 0.0 {
            glowing += 1;
            continue;
        }
        if mask.0.pixels()[i] == 1.0 {
            // The old glow is gone: the shade shows other lights as if the lamp were off, and none
            // of its own light but what the lens scatters from its new place.
            own += 1;
            assert_eq!(
                layer(&moved, "window_0").0.pixels()[i],
                layer(&off, "window_0").0.pixels()[i]
            );
            assert!(layer(&moved, "lamp_0").0.pixels()[i].max_element() < 1e-3);
        }
    }
    assert!(own > 100 && glowing > 100, "{own} old pixels, {glowing} of the body at its new place");
    let radiance = |name: &str| of::<Radiance>(many(&moved, name), "lamp_0");
    assert_eq!(radiance("edit.radiance").0, radiance("fit.radiance").0);
    let middle =
        |name: &str| of::<Shape>(many(&moved, name), "lamp_0").bounding_sphere().expect("a lamp").0;
    assert!(
        (middle("edit.shape") - middle("init.shape") - Vec3::new(-1.75, 0.0, 0.0)).length() < 1e-5
    );

    // Onto the seat of the pouffe, the surface that is seen there; it stands on it and does not
    // sink in.
    let on = run_edit(
        r#"Edit(version: 1, lights: { "lamp_0": Move(to: Pixel(x: 278, y: 180)) })"#,
        &["edit.shape"],
    );
    let shape = of::<Shape>(many(&on, "edit.shape"), "lamp_0");
    let (middle, _) = shape.bounding_sphere().expect("a lamp");
    assert!(middle.z < -1.0 && middle.x > 0.5, "{middle}");
}

#[test]
fn what_cannot_be_moved_is_told() {
    let place = Place::new();
    for (light, wanted) in [
        ("window_0", "Move: wanted a lamp, got a window"),
        ("inv_window", "Move: no such lamp was estimated"),
        ("lamp_0", "outside the photo"),
    ] {
        place.write(
            "edit.ron",
            format!(
                r#"Edit(version: 1, lights: {{ "{light}": Move(to: Pixel(x: 900, y: 180)) }})"#
            ),
        );
        let message = place.check("run DEMO.ron edit.ron --cache cache --out out", 2);
        assert!(message.contains(wanted), "{message}");
    }
}

/// The middle of the sun's light on the floor, in columns.
fn sun_column(report: &RunReport) -> f64 {
    let direct: Arc<UnitDirect> = of(many(report, "edited_direct"), "east");
    let (mut sum, mut weights) = (0.0, 0.0);
    for y in 150..direct.lobes[0].height() {
        for x in 0..direct.lobes[0].width() {
            let e = f64::from(direct.lobes[0].get(x, y));
            sum += e * x as f64;
            weights += e;
        }
    }
    assert!(weights > 0.0, "the sun shines on the floor");
    sum / weights
}

#[test]
fn the_sun_of_a_day_crosses_the_room() {
    let edit = shipped("sun_day");
    let outputs = ["edited_direct", "edit.radiance", "edit.shape"];
    let frame =
        |number: u32| run(shared_engine(), &physics_frame(&demo(), &edit, number), &outputs);
    let first = frame(1);
    let mut columns = vec![sun_column(&first)];
    let own = ["edit", "edited_direct[east]"];
    for number in 2..7 {
        let report = frame(number);
        assert_eq!(ran(&report), own, "frame {number}");
        columns.push(sun_column(&report));
    }
    // It comes from the left in the morning, so its light falls to the right.
    assert!(columns.windows(2).all(|pair| pair[0] > pair[1]), "{columns:?}");
    // Low suns are dim and red.
    let sun = |report: &RunReport| {
        let (shape, radiance): (Arc<Shape>, Arc<Radiance>) =
            (of(many(report, "edit.shape"), "east"), of(many(report, "edit.radiance"), "east"));
        let Shape::Window(window) = &*shape else { panic!("a window") };
        radiance.0[0] / window.lobes[0].bandwidth
    };
    let (low, high) = (sun(&frame(0)), sun(&frame(3)));
    assert!(luminance(low) < 0.7 * luminance(high), "{low} {high}");
    assert!(low.x / low.z > 1.3 * high.x / high.z, "{low} {high}");
}

/// A picture of a sky with a sun in the north, ahead of the demo's camera, as Radiance HDR.
fn sky_file() -> Vec<u8> {
    let (width, height) = (256u32, 128u32);
    let pixel = |x: u32, y: u32| {
        let (azimuth, polar) = (
            (f64::from(x) + 0.5) / f64::from(width) * 360.0 - 180.0,
            (f64::from(y) + 0.5) / f64::from(height) * 180.0,
        );
        let near = ((azimuth - 20.0).powi(2) + (polar - 60.0).powi(2)).sqrt();
        if near < 3.0 {
            image::Rgb([2000.0, 1800.0, 1500.0f32])
        } else if polar < 90.0 {
            image::Rgb([2.0, 3.0, 5.0])
        } else {
            image::Rgb([0.6, 0.5, 0.4])
        }
    };
    let picture = image::Rgb32FImage::from_fn(width, height, pixel);
    let mut bytes = Vec::new();
    let pixels: Vec<image::Rgb<f32>> = picture.pixels().copied().collect();
    image::codecs::hdr::HdrEncoder::new(&mut bytes)
        .encode(&pixels, width as usize, height as usize)
        .expect("it encodes");
    bytes
}

const CORNERS: &str =
    "corners: [(104.01, 58.52), (142.25, 57.03), (142.61, 107.58), (105.09, 106.99)]";

#[test]
fn a_picture_of_a_sky_becomes_sun_sky_and_ground() {
    let file = sky_file();
    let window = |more: &str| {
        let edit = format!(
            r#"Edit(version: 1, lights: {{ "east": Window({CORNERS}, sky: Env("sky.hdr"){more}) }})"#
        );
        let report = run_files(&[("sky.hdr", &file)], &edit, &["edit.shape", "edit.radiance"]);
        let note =
            report.nodes.iter().find(|node| node.name == "edit").expect("it ran").notes.concat();
        assert!(note.contains("three lobes move"), "{note:?}");
        let Shape::Window(window) = (*of::<Shape>(many(&report, "edit.shape"), "east")).clone()
        else {
            panic!("a window")
        };
        let radiance = of::<Radiance>(many(&report, "edit.radiance"), "east").0.clone();
        if more.is_empty() {
            // Well to the left of the sun, above and below the horizon.
            let shown = [0.7, -0.5]
                .map(|y: f32| window.emitted(&radiance, Vec3::new(-0.5, y, -0.7).normalize()));
            assert!(shown[0].z > 1.5 * shown[0].x, "the sky is blue: {}", shown[0]);
            assert!(
                luminance(shown[0]) > 2.0 * luminance(shown[1]),
                "the ground is darker: {shown:?}"
            );
        }
        (window.lobes, radiance)
    };
    let azimuth = |direction: Vec3| direction.x.atan2(-direction.z).to_degrees();
    let (lobes, radiance) = window("");
    assert!((azimuth(lobes[0].direction) - 20.0).abs() < 2.0, "{}", azimuth(lobes[0].direction));
    // 30 degrees over a horizon that the camera looks up to or down from a little.
    let height = lobes[0].direction.y.asin().to_degrees();
    assert!((height - 30.0).abs() < 8.0, "{height}");
    assert!(lobes[0].bandwidth > 300.0 && luminance(radiance[0]) > 300.0, "{lobes:?} {radiance:?}");
    // Turned to the right, the sun stands farther right; twice as bright, all is.
    let (turned, _) = window(", yaw: 15");
    assert!((azimuth(turned[0].direction) - 35.0).abs() < 2.0, "{}", azimuth(turned[0].direction));
    let (_, bright) = window(", scale: 2");
    assert!(
        bright
            .iter()
            .zip(&radiance)
            .all(|(b, r)| (*b - 2.0 * *r).abs().max_element() < 1e-3 * r.max_element())
    );
    // A sun of one's own has the light of the picture's.
    let (own, moved) = window(", sun: Direction(azimuth: -30, elevation: 40, bandwidth: 1000)");
    assert!((azimuth(own[0].direction) + 30.0).abs() < 4.0);
    let irradiance = |lobe: f32, w: Vec3| luminance(w) / lobe;
    let ratio = irradiance(1000.0, moved[0]) / irradiance(lobes[0].bandwidth, radiance[0]);
    assert!((ratio - 1.0).abs() < 1e-3, "{ratio}");
}

#[test]
fn pictures_that_are_no_sky_are_refused() {
    let place = Place::new();
    let photo = std::fs::read(demo().join("photo.png")).expect("the demo has a photo");
    place.write("square.png", photo);
    place.write("text.hdr", "no picture");
    place.write("text.ies", "no profile");
    let lamp = r#""desk": Lamp(shape: Sphere(radius: 0.05), at: Point(0, 0, -2), ies: "text.ies")"#;
    for (light, wanted) in [
        (
            format!(r#""east": Window({CORNERS}, sky: Env("square.png"))"#),
            "wanted an equirectangular picture, twice as wide as high, got 320 x 240",
        ),
        (format!(r#""east": Window({CORNERS}, sky: Env("text.hdr"))"#), "text.hdr"),
        (lamp.to_owned(), "wanted a photometric file of IES LM-63, got none"),
    ] {
        place.write("edit.ron", format!("Edit(version: 1, lights: {{ {light} }})"));
        let message = place.check("run DEMO.ron edit.ron --cache cache --out out --only edit", 2);
        assert!(message.contains(wanted), "{message}");
    }
}

/// Photographed skies, which may not be given away.
#[needs("../shared/data/hdri")]
#[test]
fn photographed_skies_keep_their_light() {
    let entries =
        std::fs::read_dir(root().join("../shared/data/hdri")).expect("the folder can be listed");
    let mut paths: Vec<PathBuf> =
        entries.map(|entry| entry.expect("it can be listed").path()).collect();
    paths.retain(|path: &PathBuf| path.extension().is_some_and(|e| e == "hdr"));
    paths.sort();
    let name = |path: &Path| path.file_name().expect("a file").to_string_lossy().into_owned();
    for path in &paths {
        let bytes = std::fs::read(path).expect("it can be read");
        for yaw in [0, 90, 180, 270] {
            let edit = format!(
                r#"Edit(version: 1, lights: {{ "east": Window({CORNERS}, sky: Env("sky.hdr"), yaw: {yaw}) }})"#
            );
            let report = run_files(&[("sky.hdr", &bytes)], &edit, &["edit.shape", "edit.radiance"]);
            let node = report.nodes.iter().find(|node| node.name == "edit").expect("it ran");
            let message = node
                .notes
                .iter()
                .chain(&node.warnings)
                .find(|note| note.contains("three lobes move"))
                .expect("it tells");
            println!("{} {yaw}: {message}", name(path));
            let share =
                message.split("three lobes move").nth(1).and_then(|rest| rest.split('%').next());
            let share: f64 = share.expect("it is reported").trim().parse().expect("a number");
            assert!(share < 50.0, "{}: {message}", name(path));
        }
    }
}

/// Nothing, and more than any lamp gives, and windows that no wall can hold.
#[test]
fn extreme_lights_end_in_a_picture_or_a_clear_error() {
    let place = Place::new();
    let sphere = "shape: Sphere(radius: 0.06), at: Point(0.1, 0.4, -2.9)";
    for (light, status, wanted) in [
        (format!(r#""a": Lamp({sphere}, flux: 0)"#), 0, "in "),
        (format!(r#""a": Lamp({sphere}, flux: 1e9)"#), 0, "in "),
        (format!(r#""a": Lamp({sphere}, flux: 1e38)"#), 2, "wanted a radiance up to 1e30"),
        (r#""lamp_0": Move(by: (0, 0, 1000))"#.to_owned(), 0, "in "),
        (r#""lamp_0": Move(to: Point(0, 0, 0))"#.to_owned(), 0, "in "),
        // Mostly outside of the photo; half on the wall and half on the ceiling; all of the photo.
        (
            r#""a": Window(corners: [(-200, 40), (140, 58), (141, 130), (-200, 133)])"#.to_owned(),
            0,
            "in ",
        ),
        (
            r#""a": Window(corners: [(100, 5), (140, 5), (140, 90), (100, 90)])"#.to_owned(),
            0,
            "in ",
        ),
        (r#""a": Window(corners: [(0, 0), (320, 0), (320, 240), (0, 240)])"#.to_owned(), 0, "in "),
        (
            r#""a": Window(corners: [(900, 900), (990, 900), (990, 990), (900, 990)])"#.to_owned(),
            2,
            "no wall is visible",
        ),
        (
            r#""a": Window(corners: [(104, 58), (142, 107), (142, 57), (105, 107)])"#.to_owned(),
            2,
            "in order around a convex window",
        ),
    ] {
        place.write("edit.ron", format!("Edit(version: 1, lights: {{ {light} }})"));
        let message = place.check(
            "run DEMO.ron edit.ron --set scene.long_side=96 --cache cache --out out",
            status,
        );
        assert!(message.contains(wanted), "{light}: {message}");
    }
}
