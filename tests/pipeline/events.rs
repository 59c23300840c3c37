//! Nodes that run again after each kind of edit: exactly these.

use std::path::Path;

use crate::project::*;

/// A cache in which the demo has been run unchanged.
fn warm() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    run(&engine(Some(folder.path())), &physics(&demo(), IDENTITY), &[]);
    folder
}

/// Runs an edit in a new engine over this cache; returns the nodes that ran and the number of rays.
fn again(cache: &Path, scene: &Path, edit: &str) -> (Vec<String>, u64) {
    let report = run(&engine(Some(cache)), &physics(scene, edit), &[]);
    (ran(&report).into_iter().map(str::to_owned).collect(), rays(&report))
}

#[test]
fn each_kind_of_edit_runs_what_it_must_and_nothing_else() {
    let cache = warm();
    let again = |edit: &str| {
        again(cache.path(), &demo(), &format!("Edit(version: 1, lights: {{ {edit} }})"))
    };
    assert_eq!(again(""), (vec![], 0), "nothing changed");

    // Radiance only: the layers are weighted anew.
    for edit in [
        r#""lamp_0": Off"#,
        r#""window_0": Scale(0.4)"#,
        r#""lamp_0": Temperature(6500)"#,
        r#""window_0": Color(1, 0.8, 0.6)"#,
        r#""lamp_0": Scale(2), "window_0": Off"#,
    ] {
        let (ran, rays) = again(edit);
        let changed: Vec<String> = ["lamp_0", "window_0"]
            .into_iter()
            .filter(|light| edit.contains(light))
            .map(|light| format!("room_error[{light}]"))
            .collect();
        let [first, last] =
            [["edit", "after"], ["compose", "write"]].map(|names| names.map(str::to_owned));
        assert_eq!((&ran[..], rays), (&[&first[..], &changed, &last].concat()[..], 0), "{edit}");
        assert_eq!(again(edit), (vec![], 0), "{edit}, again");
    }
    // A factor of one changes a parameter and no light: the wave stops behind EditLights.
    assert_eq!(again(r#""lamp_0": Scale(1)"#), (vec!["edit".to_owned()], 0));

    // A new light: its own layers, and the sums.
    let desk = |x: f32, radiance: u32| {
        let shape = "Sphere(radius: 0.07)";
        format!(
            r#""desk": Lamp(shape: {shape}, at: Point({x}, -0.56, -2.94), radiance: ({radiance}, 44, 20))"#
        )
    };
    let own = [
        "edit",
        "edited_direct[desk]",
        "edited_shadow[desk]",
        "edited_room_light[desk]",
        "edited_indirect[desk]",
        "after",
        "light_draws[desk]",
        "room_error[desk]",
        "glow[desk]",
    ];
    let of_new_light: Vec<String> =
        own.iter().chain(&["compose", "write"]).map(|name| name.to_string()).collect();
    let (ran, rays) = again(&desk(0.12, 72));
    assert_eq!(ran, of_new_light, "inserted");
    assert!(rays > 0);
    // Its place: the same.
    assert_eq!(again(&desk(0.22, 72)).0, of_new_light, "moved");
    // Its radiance: no ray.
    assert_eq!(
        again(&desk(0.22, 60)),
        (["edit", "after", "room_error[desk]", "compose", "write"].map(str::to_owned).to_vec(), 0)
    );
    // Back to where it was: all is known.
    assert_eq!(again(&desk(0.12, 72)), (vec![], 0));

    // A visible light replaced: its own layers.
    let (ran, rays) = again(
        r#""lamp_0": Lamp(shape: Sphere(radius: 0.1), at: Point(1.2, 0.1, -4), radiance: (20, 20, 20))"#,
    );
    let own = [
        "edit",
        "edited_direct[lamp_0]",
        "edited_shadow[lamp_0]",
        "edited_room_light[lamp_0]",
        "edited_indirect[lamp_0]",
        "after",
        "light_draws[lamp_0]",
        "room_error[lamp_0]",
        "glow[lamp_0]",
    ];
    assert_eq!(
        ran,
        own.iter().chain(&["compose", "write"]).map(|name| name.to_string()).collect::<Vec<_>>()
    );
    assert!(rays > 0);
}

/// Which of all nodes about objects ran, beside the sums; sorted.
#[test]
fn objects_run_what_they_touch() {
    let cache = warm();
    let ball = |gray: &str, lights: &str| {
        let ball = format!(
            "Sphere(radius: 0.09, at: Pixel(x: 178, y: 176), material: (albedo: Linear({gray})))"
        );
        let mut ran = again(
            cache.path(),
            &demo(),
            &format!("Edit(version: 1, objects: [{ball}], lights: {{ {lights} }})"),
        );
        ran.0.sort();
        ran
    };
    let names = |kinds: &[&str], errors: &[&str], others: &[&str]| {
        let each = ["inv_lamp", "inv_window", "lamp_0", "window_0"];
        // The window out of view is absent: its error stays the same.
        let lit = ["inv_lamp", "lamp_0", "window_0"];
        let of = |kinds: &[&str], lights: &[&str]| -> Vec<String> {
            let mut names = Vec::new();
            for kind in kinds {
                names.extend(lights.iter().map(|light| format!("{kind}[{light}]")));
            }
            names
        };
        let others = others.iter().map(|name| name.to_string()).collect();
        let mut names = [of(kinds, &each), of(errors, &lit), others].concat();
        names.sort();
        names
    };
    // Lights do not move, so direct light on the room is not recomputed; all shadows are.
    let per_light = [
        "edited_shadow",
        "edited_room_light",
        "edited_indirect",
        "glow",
        "object_light",
        "object_shown",
    ];
    let (ran, rays) = ball("0.8, 0.8, 0.8", "");
    assert_eq!(
        ran,
        names(
            &per_light,
            &["light_draws", "room_error"],
            &["objects", "edited_transport", "edited_rest", "after", "compose", "write"]
        )
    );
    assert!(rays > 0);
    // Dimmed, a light traces nothing, with objects as without.
    let (ran, rays) = ball("0.8, 0.8, 0.8", r#""lamp_0": Scale(0.5)"#);
    assert_eq!(
        (ran, rays),
        (
            names(
                &[],
                &[],
                &[
                    "edit",
                    "after",
                    "object_shown[lamp_0]",
                    "room_error[lamp_0]",
                    "compose",
                    "write"
                ]
            ),
            0
        )
    );
    // Another color changes the bounces, but no shadow in the room and no path between its parts.
    let (ran, _) = ball("0.8, 0.2, 0.1", "");
    let per_light = ["edited_indirect", "object_light", "object_shown"];
    assert_eq!(
        ran,
        names(
            &per_light,
            &["room_error"],
            &["objects", "edited_rest", "after", "compose", "write"]
        )
    );
    assert_eq!(
        again(cache.path(), &demo(), IDENTITY),
        (vec![], 0),
        "the room without objects is as it was"
    );
}

#[test]
fn a_scene_without_windows_runs_nothing_for_windows() {
    let place = Place::new();
    let scene = format!(
        r#"Scene(version: 1, photo: "{0}/photo.png", camera: FovX(64.0), depth: (path: "{0}/depth.exr"),
            lights: {{ "lamp_0": Lamp(mask: "{0}/masks/lamp_0.png") }})"#,
        demo().display()
    );
    place.write("scene.ron", scene);
    let report = run(&engine(None), &physics(place.folder.path(), IDENTITY), &[]);
    let stray: Vec<&str> = report
        .nodes
        .iter()
        .map(|node| &*node.name)
        .filter(|name| name.contains("window_0"))
        .collect();
    assert!(stray.is_empty(), "{stray:?} are about a window that is not there");
    let ran: Vec<&str> = ran(&report).into_iter().filter(|name| !name.contains("[inv_")).collect();
    let once = [
        "scene",
        "room",
        "box",
        "transport",
        "search_transport",
        "sun",
        "materials",
        "init",
        "direct[lamp_0]",
        "shadow[lamp_0]",
        "room_light[lamp_0]",
        "indirect[lamp_0]",
    ];
    let then = [
        "fit",
        "before",
        "glare",
        "correction",
        "paint",
        "edit",
        "repaint",
        "objects",
        "after",
        "rooms",
        "light_draws[lamp_0]",
        "room_error[lamp_0]",
        "glow[lamp_0]",
        "edited_rest",
    ];
    let then = [&then[..], &["compose", "write"]].concat();
    assert_eq!(ran, [&once[..], &then[..]].concat());
}
