//! Networks in a run: the networks that run for each scene and edit, and results that do not depend
//! on threads.

use std::path::PathBuf;

use relight::graph::{Engine, EngineOptions, RunReport, Status};
use relight::image::Plane;

use crate::project::*;

/// The nodes whose network was computed, with its file.
fn networks(report: &RunReport) -> Vec<String> {
    let used = report.nodes.iter().filter(|node| node.status == Status::Ran).flat_map(|node| {
        let notes = node.notes.iter().filter_map(|note| note.strip_suffix(" by rten"));
        notes.map(move |file| format!("{}: {file}", node.name))
    });
    used.collect()
}

/// The demo with some of its lights left out.
fn demo_with(lights: &[&str]) -> (Place, PathBuf) {
    let place = Place::new();
    let spec = |name: &&str| {
        let kind = if name.starts_with("lamp") { "Lamp" } else { "Window" };
        format!(r#""{name}": {kind}(mask: "{}/masks/{name}.png")"#, demo().display())
    };
    place.write(
        "scene.ron",
        format!(
            r#"Scene(version: 1, photo: "{0}/photo.png", camera: FovX(64.0), depth: (path: "{0}/depth.exr"), lights: {{ {1} }})"#,
            demo().display(),
            lights.iter().map(spec).collect::<Vec<_>>().join(", ")
        ),
    );
    let folder = place.folder.path().to_owned();
    (place, folder)
}

#[test]
fn only_networks_that_a_scene_needs_are_run() {
    let used = |lights: &[&str]| {
        let (_place, scene) = demo_with(lights);
        networks(&run(&engine(None), &with("networks.ron", &scene, IDENTITY), &[]))
    };
    let of =
        |names: &[String], what: &str| names.iter().filter(|name| name.ends_with(what)).count();

    let all = used(&["lamp_0", "window_0"]);
    let once = [
        "mnet: mnet.onnx",
        "inv_lamp[inv_lamp]: invlampnet.onnx",
        "inv_win[inv_window]: invwinnet.onnx",
    ];
    let seen = ["vis_lamp[lamp_0]: vislampnet.onnx", "vis_win[window_0]: viswinnet.onnx"];
    assert_eq!(all[..5], [&once[..1], &seen, &once[1..]].concat(), "{all:?}");
    // Lights that explain nothing are left out: neither their shadow nor their indirect light is
    // computed. The room has no window out of view.
    let rest = |all: &[String]| -> Vec<String> {
        let names = all[5..].iter().map(|name| name.split(':').next().unwrap_or_default());
        names.map(str::to_owned).collect()
    };
    assert_eq!(
        rest(&all),
        [
            "filled[inv_lamp]",
            "filled[lamp_0]",
            "filled[window_0]",
            "indirect[inv_lamp]",
            "indirect[lamp_0]",
            "indirect[window_0]",
        ]
    );
    // So it is by the estimates of the networks alone.
    let (place, scene) = demo_with(&["lamp_0", "window_0"]);
    let networks_ron = root().join("graphs/networks.ron");
    place.write(
        "alone.ron",
        format!(
            r#"Graph(version: 1, extends: "{}", nodes: {{ "init": (op: InitLights(dictionary: false)) }})"#,
            networks_ron.display()
        ),
    );
    let alone = place.folder.path().join("alone.ron").display().to_string();
    let alone = networks(&run(&engine(None), &with(&alone, &scene, IDENTITY), &[]));
    assert_eq!(rest(&alone), rest(&all));
    assert_eq!(of(&all, "lightnet.onnx"), 0, "nothing shines by gloss");

    let lamp = used(&["lamp_0"]);
    assert_eq!(
        (of(&lamp, "viswinnet.onnx"), of(&lamp, "vislampnet.onnx")),
        (0, 1),
        "no window, no window network"
    );
    let window = used(&["window_0"]);
    assert_eq!(
        (of(&window, "viswinnet.onnx"), of(&window, "vislampnet.onnx")),
        (1, 0),
        "no lamp, no lamp network"
    );
    let none = used(&[]);
    assert_eq!(none[..3], once);
    assert_eq!((of(&none, "viswinnet.onnx"), of(&none, "vislampnet.onnx")), (0, 0));
}

#[test]
fn an_edit_of_a_radiance_runs_no_network() {
    let cache = tempfile::tempdir().expect("a temporary folder can be made");
    run(&engine(Some(cache.path())), &with("indoor.ron", &demo(), IDENTITY), &[]);
    let again = |text: &str, outputs: &[&str]| {
        let report = run(&engine(Some(cache.path())), &with("indoor.ron", &demo(), text), outputs);
        let names: Vec<String> = ran(&report).into_iter().map(str::to_owned).collect();
        (names, networks(&report).len())
    };
    let off = r#"Edit(version: 1, lights: { "lamp_0": Off, "window_0": Scale(0.4) })"#;
    let (names, _) = again(off, &[]);
    let errors = ["room_error[lamp_0]", "room_error[window_0]"];
    assert_eq!(names, [&["edit", "after"][..], &errors, &["compose", "write"]].concat());
    // A new light: its own layers.
    let desk = r#"Edit(version: 1, lights: { "desk": Lamp(shape: Sphere(radius: 0.07), at: Point(0.1, -0.56, -2.9), radiance: (72, 44, 20)) })"#;
    let own = [
        "edited_direct[desk]",
        "edited_shadow[desk]",
        "edited_room_light[desk]",
        "edited_indirect[desk]",
        "after",
        "light_draws[desk]",
        "room_error[desk]",
        "glow[desk]",
    ];
    assert_eq!(again(desk, &[]).0, [&["edit"][..], &own, &["compose", "write"]].concat());
}

/// Stages that need the light at each position get it, and no other node runs for it.
#[test]
fn the_light_at_each_position_follows_a_radiance_without_other_nodes() {
    let cache = tempfile::tempdir().expect("a temporary folder can be made");
    let off = r#"Edit(version: 1, lights: { "lamp_0": Off, "window_0": Scale(0.4) })"#;
    let ran_for = |outputs: &[&str]| {
        let report = run(&engine(Some(cache.path())), &with("networks.ron", &demo(), off), outputs);
        ran(&report).into_iter().map(str::to_owned).collect::<Vec<String>>()
    };
    ran_for(&[]);
    assert_eq!(ran_for(&["lighting.lighting"]), ["lighting"]);
}

#[test]
fn a_light_without_unknown_shadow_needs_no_network_for_it() {
    use relight::graph::{Context, Node};
    use relight::nodes::artifacts::{UnitDirect, Visibility};
    use relight::nodes::render::shadow_net::{ShadowNet, ShadowNetIn};
    use std::sync::Arc;
    let plane = |v: f32| vec![Plane::filled(8, 6, v)];
    let visibility =
        Arc::new(Visibility { lit: plane(0.7), stderr: plane(0.0), unknown: plane(0.0) });
    let inputs = ShadowNetIn {
        depth: Arc::new(relight::image::Depth(Plane::filled(8, 6, 2.0))),
        camera: Arc::new(relight::geometry::Camera::from_fov_x(8, 6, 60.0)),
        normal: Arc::new(relight::image::Normal(Plane::filled(8, 6, glam::Vec3::Z))),
        shape: Arc::new(relight::optics::Shape::Absent),
        direct: Arc::new(UnitDirect { lobes: plane(1.0), stderr: plane(0.0) }),
        visibility: visibility.clone(),
    };
    // Its network is not even there.
    let stage = ShadowNet {
        model: relight::graph::File::new("/nowhere/shadownet.onnx"),
        ..ShadowNet::default()
    };
    let filled = stage.run(inputs, &Context::default()).expect("no network is asked").visibility;
    assert_eq!(filled, visibility);
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let picture = |threads: usize| {
        let engine =
            Engine::new(EngineOptions { threads: Some(threads), ..EngineOptions::default() });
        let report = run(
            &engine.expect("threads can be started"),
            &with("networks.ron", &demo(), IDENTITY),
            &[],
        );
        written(&report, "picture.exr")
    };
    assert!(picture(1) == picture(3), "one thread and three give other pictures");
}
