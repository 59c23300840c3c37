//! Sequences: the nodes that each frame runs, absence of flicker, and the files that the command
//! writes.

use std::collections::BTreeMap;
use std::path::Path;

use relight::image::Mask;

use crate::layers::channels;
use crate::project::*;

/// Runs these frames of an edit one after the other by one engine, as the command does; returns the
/// nodes that ran in each.
fn frames(edit: &str, numbers: &[u32]) -> Vec<Vec<String>> {
    let engine = engine(None);
    run(&engine, &physics(&demo(), IDENTITY), &["picture"]);
    let frame = |number: &u32| {
        let report = run(&engine, &physics_frame(&demo(), edit, *number), &["picture"]);
        ran(&report).into_iter().map(str::to_owned).collect()
    };
    numbers.iter().map(frame).collect()
}

const MOVING: &str = r#"Edit(version: 1, frames: 8, lights: {
    "desk": Lamp(shape: Sphere(radius: 0.07), at: Keys([(0, Point(-0.2, -0.55, -2.94)), (3, Point(0.4, -0.55, -2.94))]), radiance: (72, 44, 20)),
})"#;

#[test]
fn a_moving_lamp_runs_its_own_layers_and_the_sums() {
    let own = [
        "edit",
        "edited_direct[desk]",
        "edited_shadow[desk]",
        "edited_room_light[desk]",
        "edited_indirect[desk]",
        "after",
        "glow[desk]",
        "compose",
        "picture",
    ];
    let sorted = |mut names: Vec<String>| {
        names.sort();
        names
    };
    let wanted = sorted(own.map(str::to_owned).to_vec());
    let got = frames(MOVING, &[0, 1, 2, 3, 4, 7, 1]);
    for (at, ran) in got.iter().take(4).enumerate() {
        assert_eq!(sorted(ran.clone()), wanted, "frame {at}");
    }
    // Past the last key nothing moves, and nothing runs; nor where the lamp has been.
    assert_eq!(got[4..], [const { Vec::<String>::new() }; 3]);
}

#[test]
fn colors_run_no_layer() {
    let edit = r#"Edit(version: 1, frames: 8, lights: {
        "lamp_0": Temperature(Keys([(0, 2000), (7, 9000)])), "window_0": Scale(Keys([(2, 1), (7, 0)])) })"#;
    let wanted = ["edit", "after", "compose", "picture"].map(str::to_owned).to_vec();
    assert_eq!(frames(edit, &[0, 3, 7]), [wanted.clone(), wanted.clone(), wanted]);
}

/// Other paint sends other light around, so that each light's bounces are summed anew; the rays
/// that gather them are known.
#[test]
fn paint_traces_no_ray() {
    let edit = std::fs::read_to_string(edits().join("wall_colour.ron")).expect("it ships");
    let engine = engine(None);
    run(&engine, &physics_frame(&demo(), &edit, 0), &["picture"]);
    let report = run(&engine, &physics_frame(&demo(), &edit, 24), &["picture"]);
    let bounces =
        ["inv_lamp", "lamp_0", "window_0"].map(|light| format!("edited_indirect[{light}]"));
    let ran = ran(&report);
    assert!(bounces.iter().all(|node| ran.contains(&node.as_str())), "{ran:?}");
    assert!(
        !ran.iter().any(|node| node.contains("direct[") && !node.contains("indirect")),
        "{ran:?}"
    );
    assert!(ran.len() <= 8 && rays(&report) == 0, "{ran:?}");
}

/// Layers that a frame does not change keep their bits: every layer but the moving lamp's, wherever
/// the lamp itself does not stand before it.
#[test]
fn nothing_flickers() {
    let frame = |number: u32| {
        let outputs = ["compose.layer", "compose.residual", "glow"];
        let report = run(shared_engine(), &physics_frame(&demo(), MOVING, number), &outputs);
        let mut layers = layers(&report);
        layers.push(("rest".into(), rest(&report)));
        let cover = many::<Mask>(&report, "glow")
            .into_iter()
            .find(|(id, _)| id == "desk")
            .expect("it is drawn")
            .1;
        (layers, cover)
    };
    let (first, first_cover) = frame(0);
    for number in 1..4 {
        let (layers, cover) = frame(number);
        let hidden: Vec<bool> = cover
            .0
            .pixels()
            .iter()
            .zip(first_cover.0.pixels())
            .map(|(a, b)| *a > 0.0 || *b > 0.0)
            .collect();
        assert!(hidden.iter().any(|h| *h), "the lamp is in the picture");
        for ((id, layer), (_, before)) in layers.iter().zip(&first) {
            let change =
                |i: usize| (layer.0.pixels()[i] - before.0.pixels()[i]).abs().max_element();
            let seen = (0..hidden.len()).filter(|&i| !hidden[i]);
            let most = seen.map(change).fold(0.0, f32::max);
            if id == "desk" {
                assert!(most > 0.01, "the lamp's own light moves");
            } else {
                assert_eq!(most, 0.0, "{id} in frame {number}");
            }
        }
    }
}

fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).expect("the folder is there");
    let paths = entries.map(|entry| entry.expect("it can be listed").path());
    let name =
        |path: &Path| path.file_name().expect("a file has a name").to_string_lossy().into_owned();
    paths.map(|path| (name(&path), std::fs::read(&path).expect("it can be read"))).collect()
}

const SMALL: &str = "--set scene.long_side=96";

#[test]
fn the_command_writes_a_picture_per_frame_and_goes_on_where_it_was_stopped() {
    let place = Place::new();
    place.write("edit.ron", MOVING);
    let line = |out: &str| format!("run DEMO.ron edit.ron {SMALL} --cache cache_{out} --out {out}");
    let message = place.check(&line("out"), 0);
    let out = files(&place.path("out"));
    let names: Vec<String> = (0..8).map(|number| format!("picture_{number:04}.png")).collect();
    let wanted = names.iter().chain([&"report.json".to_owned()]).cloned().collect::<Vec<_>>();
    assert_eq!(out.keys().filter(|name| *name != "film.mp4").cloned().collect::<Vec<_>>(), wanted);
    assert!(
        message.contains("frame 7 (8 of 8): cached") && message.contains("8 of 8 frames"),
        "{message}"
    );
    // The files differ in the record of their making.
    assert!(png(&out[&names[3]]) == png(&out[&names[7]]));
    assert!(png(&out[&names[0]]) != png(&out[&names[1]]));

    let report: serde_json::Value =
        serde_json::from_slice(&out["report.json"]).expect("it is JSON");
    let frames = report["frames"].as_array().expect("a list");
    assert_eq!(frames.len(), 8);
    let ran = |frame: usize| -> Vec<&str> {
        let nodes = frames[frame]["nodes"].as_array().expect("a list");
        nodes.iter().map(|node| node["name"].as_str().expect("a name")).collect()
    };
    assert!(
        ran(1).contains(&"edited_direct[desk]") && !ran(1).contains(&"edited_direct[lamp_0]"),
        "{:?}",
        ran(1)
    );
    assert_eq!((ran(1), ran(5)), (ran(2), Vec::new()));
    assert_eq!(frames[3]["key"], frames[6]["key"]);
    assert_ne!(frames[0]["key"], frames[1]["key"]);
    assert_eq!(frames[2]["files"][0], "picture_0002.png");

    // One frame, and the same edit written out, give the same picture.
    place.check(&format!("run DEMO.ron edit.ron {SMALL} --no-cache --frame 1 --out single"), 0);
    assert_eq!(files(&place.path("single"))[&names[1]], out[&names[1]]);
    let at = "Keys([(0, Point(-0.2, -0.55, -2.94)), (3, Point(0.4, -0.55, -2.94))])";
    place.write(
        "plain.ron",
        MOVING.replace(at, "Point(0, -0.55, -2.94)").replace("frames: 8, ", ""),
    );
    place.check(&format!("run DEMO.ron plain.ron {SMALL} --no-cache --out plain"), 0);
    assert!(png(&files(&place.path("plain"))["picture.png"]) == png(&out[&names[1]]));

    // After a kill at any moment, the next run computes the missing frames, and no frame twice.
    let mut child = place.command(&line("torn"));
    let quiet = child.stdout(std::process::Stdio::null()).stderr(std::process::Stdio::null());
    let mut child = quiet.spawn().expect("the program starts");
    while !place.path("torn/picture_0001.png").exists() {
        assert!(
            child.try_wait().expect("it can be looked at").is_none(),
            "it ended without its pictures"
        );
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    child.kill().expect("it can be killed");
    child.wait().expect("it ends");
    let message = place.check(&line("torn"), 0);
    for known in ["frame 0 (1 of 8): cached", "frame 1 (2 of 8): cached"] {
        assert!(message.contains(known), "{message}");
    }
    let torn = files(&place.path("torn"));
    assert!(names.iter().all(|name| torn[name] == out[name]));
}

#[test]
fn layers_of_frames_are_written_when_asked_for() {
    let place = Place::new();
    place.write(
        "edit.ron",
        r#"Edit(version: 1, frames: 2, lights: { "lamp_0": Scale(Keys([(0, 1), (1, 0.5)])) })"#,
    );
    place.check(&format!("run DEMO.ron edit.ron {SMALL} --no-cache --exr --out out"), 0);
    let out = files(&place.path("out"));
    let light = |name: &str| channels(&out[name])["light_lamp_0.R"].clone();
    let (whole, half) = (light("picture_0000.exr"), light("picture_0001.exr"));
    let worst =
        whole.iter().zip(&half).map(|(w, h)| (0.5 * w - h).abs() / w.max(1e-3)).fold(0.0, f32::max);
    assert!(worst < 1e-3, "half the light is half the layer, to {worst}");
    assert!(whole.iter().any(|w| *w > 0.1));
}

/// A stand-in for ffmpeg notes its arguments and makes a film of the first picture's size.
#[cfg(unix)]
#[test]
fn a_sequence_becomes_a_film_where_ffmpeg_is() {
    use std::os::unix::fs::PermissionsExt;
    let place = Place::new();
    place.write(
        "edit.ron",
        r#"Edit(version: 1, frames: 2, lights: { "lamp_0": Scale(Keys([(0, 1), (1, 0.5)])) })"#,
    );
    let line = format!("run DEMO.ron edit.ron {SMALL} --cache cache --out out --fps 12");
    let with = |script: &str| {
        std::fs::create_dir_all(place.path("bin")).expect("a folder can be made");
        place.write("bin/ffmpeg", script);
        let mode = std::fs::Permissions::from_mode(0o755);
        std::fs::set_permissions(place.path("bin/ffmpeg"), mode).expect("it can be made a program");
        let path = format!("{}:/usr/bin:/bin", place.path("bin").display());
        let output = place.command(&line).env("PATH", path).output().expect("the program starts");
        check_output(&line, &output, 0)
    };
    let message = with("#!/bin/sh\necho \"$@\" > args\nfor last; do :; done\necho film > $last\n");
    assert!(!message.contains("film.mp4"), "{message}");
    assert_eq!(files(&place.path("out"))["film.mp4"], b"film\n");
    let args = std::fs::read_to_string(place.path("args")).expect("it was called");
    assert!(args.contains("-framerate 12 ") && args.contains("-frames:v 2 "), "{args}");
    let message = with("#!/bin/sh\necho no such encoder >&2; exit 1\n");
    assert!(message.contains("warning: no film.mp4: ffmpeg failed: no such encoder"), "{message}");
    let output =
        place.command(&line).env("PATH", place.path("out")).output().expect("the program starts");
    let message = check_output(&line, &output, 0);
    assert!(message.contains("warning: no film.mp4: ffmpeg is not on PATH"), "{message}");
}

#[test]
fn a_frame_can_be_asked_for() {
    let place = Place::new();
    place.write("edit.ron", MOVING);
    let line = |more: &str| format!("{more} DEMO.ron edit.ron");
    let printed = |line: &str| {
        let output = place.command(line).output().expect("the program starts");
        check_output(line, &output, 0);
        String::from_utf8(output.stdout).expect("it is text")
    };
    assert!(printed(&line("check")).starts_with("valid: 8 frames, "));
    assert!(!printed(&line("check --frame 2")).contains(" frames, "));
    assert!(printed(&line("plan --no-cache --frame 2")).contains("run      scene"));
    for (more, wanted) in
        [("check --frame 8", "--frame: wanted 0..=7, got 8"), ("check --frame -1", "-1")]
    {
        let message = place.check(&line(more), 2);
        assert!(message.contains(wanted), "{message}");
    }
    let message = place.check("plan DEMO.ron EDITS/none.ron --frame 1", 2);
    assert!(
        message.contains("--frame: wanted an edit with `frames`, got one picture"),
        "{message}"
    );

    // The one that ships.
    assert!(printed("check DEMO.ron EDITS/moving_lamp.ron").starts_with("valid: 48 frames, "));
    place.check(
        &format!("run DEMO.ron EDITS/moving_lamp.ron {SMALL} --frame 24 --no-cache --out ships"),
        0,
    );
    assert!(place.path("ships/picture_0024.png").is_file());

    // Consecutive frames differ in one parameter.
    place.check(&format!("run DEMO.ron edit.ron {SMALL} --frame 0 --cache cache --out out"), 0);
    let message =
        printed(&format!("explain DEMO.ron edit.ron edit --frame 1 {SMALL} --cache cache"));
    assert!(message.starts_with("edit: run: parameter lights: "), "{message}");
}
