//! Files by strangers through the whole command: nothing foreign is replaced, waited for or
//! followed, and no message reaches the terminal with characters that it acts on.

use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};

use glam::Vec3;

use crate::bad_input::{self, room};
use crate::common::files::png_of;
use crate::project::*;

const LINE: &str = "run GRAPHS/physics.ron edit.ron --scene . --no-cache";
const NO_CHANGE: &str = "run GRAPHS/physics.ron EDITS/none.ron --scene . --no-cache";

/// Runs to an end within a minute; a run that hangs fails the test.
fn ended(place: &Place, line: &str) -> Output {
    let mut child = place
        .command(line)
        .stdin(Stdio::null())
        .stdout(std::fs::File::create(place.path("said")).expect("a file can be written"))
        .stderr(std::fs::File::create(place.path("message")).expect("a file can be written"))
        .spawn()
        .expect("the program starts");
    let status = bad_input::ended(&mut child, line);
    let read = |name: &str| std::fs::read(place.path(name)).expect("it is there");
    Output { status, stdout: read("said"), stderr: read("message") }
}

#[cfg(unix)]
fn pipe(path: &Path) {
    let _ = std::fs::remove_file(path);
    nix::unistd::mkfifo(path, nix::sys::stat::Mode::S_IRUSR).expect("a pipe can be made");
}

/// Pipes without a writer and links to devices without an end, wherever a file may be named.
#[cfg(unix)]
#[test]
fn only_regular_files_are_read() {
    let endless = |path: &Path| {
        let _ = std::fs::remove_file(path);
        std::os::unix::fs::symlink("/dev/zero", path).expect("a link can be made");
    };
    let object =
        r#"Edit(version: 1, objects: [Mesh(path: "a.obj", at: Pixel(x: 20, y: 15), height: 0.5)])"#;
    let library =
        r#"Edit(version: 1, objects: [Mesh(path: "b.obj", at: Pixel(x: 20, y: 15), height: 0.5)])"#;
    let cases: [(&str, Option<&str>); 9] = [
        ("scene.ron", None),
        ("edit.ron", None),
        ("graph.ron", None),
        ("parent.ron", None),
        ("photo.png", None),
        ("depth.npy", None),
        ("lamp.png", None),
        ("a.obj", Some(object)),
        ("b.mtl", Some(library)),
    ];
    for (name, edit) in cases {
        for make in [pipe as fn(&Path), endless] {
            let place = room();
            let physics = root().join("graphs/physics.ron");
            std::fs::copy(physics, place.path("parent.ron")).expect("a file can be copied");
            place.write("graph.ron", r#"Graph(version: 1, extends: "parent.ron")"#);
            place.write("b.obj", "mtllib b.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
            if let Some(edit) = edit {
                place.write("edit.ron", edit);
            }
            make(&place.path(name));
            let output = ended(&place, "check graph.ron edit.ron --scene .");
            let message = String::from_utf8_lossy(&output.stderr);
            // A library of materials may be missing; then the object is plain.
            let wanted = if name == "b.mtl" { Some(0) } else { Some(2) };
            assert_eq!(output.status.code(), wanted, "{name}: {message}");
            assert!(
                wanted == Some(0)
                    || message.contains("wanted a regular file, got a pipe, a socket or a device"),
                "{message}"
            );
        }
    }
}

#[test]
fn a_file_above_the_limit_is_refused_before_it_is_read() {
    let place = room();
    for (name, bytes) in [("photo.png", 1u64 << 40), ("scene.ron", 1 << 40)] {
        std::fs::File::create(place.path(name))
            .and_then(|file| file.set_len(bytes))
            .expect("it may be sparse");
        let message = String::from_utf8_lossy(
            &ended(&place, "check GRAPHS/physics.ron edit.ron --scene .").stderr,
        )
        .into_owned();
        assert!(message.contains(name) && message.contains("wanted at most"), "{message}");
    }
}

/// A log that cannot be written loses messages and nothing else.
#[cfg(target_os = "linux")]
#[test]
fn a_standard_error_that_is_full_or_closed_loses_no_result() {
    let full = || std::fs::File::options().write(true).open("/dev/full").expect("Linux has it");
    let closed = || {
        let (reader, writer) = std::io::pipe().expect("a pipe can be made");
        drop(reader);
        writer
    };
    let wanted = {
        let place = room();
        place.check(&format!("{LINE} --out out"), 0);
        place.pictures("out")
    };
    for verbosity in ["", "-v", "-vvv"] {
        for stderr in [Stdio::from(full()), Stdio::from(closed())] {
            let place = room();
            let mut command = place.command(&format!("{LINE} --out out {verbosity}"));
            let status =
                command.stdout(Stdio::null()).stderr(stderr).status().expect("the program starts");
            assert_eq!(status.code(), Some(0), "{verbosity}");
            assert_eq!(place.pictures("out"), wanted);
        }
    }
    for (stdout, code) in [(Stdio::from(full()), 2), (Stdio::from(closed()), 0)] {
        let place = room();
        let mut command = place.command(&format!("{LINE} --out out"));
        let output =
            command.stdout(stdout).stderr(Stdio::piped()).output().expect("the program starts");
        assert_eq!(output.status.code(), Some(code), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(place.pictures("out"), wanted);
    }
}

/// Text by which a terminal or a reader could be deceived.
const ESCAPES: &str = "\u{1b}[2J\u{9b}31m\u{202e}gnp\u{2066}";

#[track_caller]
fn check_clean(what: &str, output: &Output, wanted: &str) {
    let text = [output.stdout.clone(), output.stderr.clone()].concat();
    let text = String::from_utf8(text).expect("the program writes UTF-8");
    let hostile = text.chars().find(|c| {
        (c.is_control() && !"\n\t".contains(*c))
            || ('\u{202a}'..='\u{202e}').contains(c)
            || ('\u{2066}'..='\u{2069}').contains(c)
    });
    assert_eq!(hostile, None, "{what}:\n{}", text.escape_debug());
    assert!(text.contains(wanted), "{what}: wanted {wanted:?}, got:\n{text}");
    assert!(!text.contains("panicked"), "{what}:\n{text}");
}

/// Every way on which text of a file, a file's name or a name in a file reaches a message.
#[test]
fn no_message_holds_characters_that_a_terminal_acts_on() {
    let object = |path: &str| {
        format!(
            "Edit(version: 1, objects: [Mesh(path: {path:?}, at: Pixel(x: 20, y: 15), height: 0.5)])"
        )
    };
    let triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    let escaped = "\\u{1b}[2J";
    type Case<'a> = (&'a str, Vec<(&'a str, Vec<u8>)>, String, &'a str);
    let cases: Vec<Case> = vec![
        ("library of an OBJ", vec![("a.obj", format!("mtllib {ESCAPES}.mtl\n{triangle}").into())], object("a.obj"), escaped),
        (
            "picture of a library",
            vec![
                ("a.obj", format!("mtllib a.mtl\nusemtl x\n{triangle}").into()),
                ("a.mtl", format!("newmtl x{ESCAPES}\nKd 1 1 1\nmap_Kd {ESCAPES}.png\n").into()),
            ],
            object("a.obj"),
            escaped,
        ),
        ("header of a PLY", vec![("a.ply", format!("ply\nformat {ESCAPES} 1.0\nend_header\n").into())], object("a.ply"), "PLY"),
        ("header of a glTF", vec![("a.gltf", format!("{{\"asset\": {{\"version\": \"{ESCAPES}\"}}").into())], object("a.gltf"), "glTF"),
        (
            "text of an IES file",
            vec![("a.ies", format!("IESNA:LM-63-2002\nTILT={ESCAPES}\n1 2 3 {ESCAPES}\n").into())],
            r#"Edit(version: 1, lights: { "x": Lamp(shape: Sphere(radius: 0.1), ies: "a.ies", at: Point(0, 0, -1), flux: 10) })"#.into(),
            "a.ies",
        ),
        ("name of a file", vec![], object(&format!("{ESCAPES}.obj")), escaped),
        ("name of a light", vec![], format!("Edit(version: 1, lights: {{ \"{ESCAPES}\": Off }})"), escaped),
        ("name of a field", vec![], format!("Edit(version: 1, {}: 1)", "größe\u{202e}"), "größe"),
        ("text that cannot be split", vec![], format!("Edit(version: 1, lights: {{ {ESCAPES} }}"), escaped),
    ];
    for (what, files, edit, wanted) in cases {
        let place = room();
        files.iter().for_each(|(name, bytes)| place.write(name, bytes));
        place.write("edit.ron", edit);
        // The second run takes its warnings from the cache.
        for line in [
            LINE,
            &LINE.replace("--no-cache", "--cache c"),
            &LINE.replace("--no-cache", "--cache c -vv"),
        ] {
            check_clean(what, &ended(&place, line), wanted);
        }
        let plan = ended(&place, "plan GRAPHS/physics.ron edit.ron --scene . --cache c --json");
        check_clean(what, &plan, "");
        check_clean(what, &ended(&place, &format!("{LINE} --json")), "");
    }
    let place = room();
    check_clean("an argument", &ended(&place, &format!("check {ESCAPES}.ron")), escaped);
    check_clean("an argument", &ended(&place, &format!("{LINE} --set {ESCAPES}=1")), escaped);
    check_clean(
        "a path that is printed",
        &ended(&place, &format!("{LINE} --out out{ESCAPES}")),
        escaped,
    );
}

/// A result under the name of a file that is read: refused before anything is written, with the way
/// out, and done with --force.
fn check_kept(place: &Place, line: &str, kept: &str) {
    let path = place.path(kept);
    let before = std::fs::read(&path).expect("it is there");
    let message = place.check(line, 2);
    assert!(
        message.contains("which the run reads")
            && message.contains("--force")
            && message.contains(kept),
        "{message}"
    );
    assert_eq!(std::fs::read(&path).expect("it is there"), before);
    place.check(&format!("{line} --force"), 0);
    assert_ne!(std::fs::read(&path).expect("it is there"), before);
}

#[test]
fn a_photo_named_as_the_result_is_kept() {
    let place = room();
    std::fs::rename(place.path("photo.png"), place.path("picture.png")).expect("it can be renamed");
    let scene = std::fs::read_to_string(place.path("scene.ron")).expect("it is there");
    place.write("scene.ron", scene.replace("photo.png", "picture.png"));
    place.check(&format!("{LINE} --out out"), 0);
    check_kept(&place, &format!("{LINE} --out ."), "picture.png");
    assert!(
        !place.path("report.json").exists() || place.path("picture.exr").exists(),
        "all or nothing"
    );
}

#[test]
fn masks_of_a_scene_are_kept_by_who_proposes_masks() {
    let place = Place::new();
    for entry in std::fs::read_dir(demo())
        .expect("the demo is there")
        .chain(std::fs::read_dir(demo().join("masks")).expect("it has masks"))
    {
        let path = entry.expect("it can be listed").path();
        if path.is_file() {
            let name = path.strip_prefix(demo()).expect("it lies there");
            std::fs::create_dir_all(place.path("masks")).expect("a folder can be made");
            std::fs::copy(&path, place.folder.path().join(name)).expect("it can be copied");
        }
    }
    for graph in ["find_lights.ron", "find_lights_photo.ron"] {
        let line = format!("run GRAPHS/{graph} EDITS/none.ron --scene . --no-cache --out .");
        let before = std::fs::read(place.path("masks/lamp_0.png")).expect("it is there");
        let message = place.check(&line, 2);
        assert!(message.contains("masks/") && message.contains("which the run reads"), "{message}");
        assert_eq!(std::fs::read(place.path("masks/lamp_0.png")).expect("it is there"), before);
        assert!(!place.path("found.png").exists(), "nothing is written");
    }
}

#[test]
fn a_mix_does_not_replace_the_run_that_it_reads() {
    let place = room();
    place.check(&format!("{NO_CHANGE} --out out"), 0);
    check_kept(&place, "mix out --set lamp=0.5 --out out", "out/picture.exr");
}

#[test]
fn two_exports_into_one_folder_have_textures_of_their_own() {
    let place = room();
    let export = "export GRAPHS/physics.ron --scene . --no-cache --out";
    place.check(&format!("{export} usd/day.usda"), 0);
    let day = std::fs::read(place.path("usd/day_albedo.png")).expect("it was written");
    place.write("photo.png", png_of((40, 30), |x, _| Vec3::new(0.9, 0.1 + x as f32 / 80.0, 0.1)));
    place.check(&format!("{export} usd/night.usda"), 0);
    assert_eq!(std::fs::read(place.path("usd/day_albedo.png")).expect("it is there"), day);
    assert_ne!(std::fs::read(place.path("usd/night_albedo.png")).expect("it was written"), day);
    let text = std::fs::read_to_string(place.path("usd/night.usda")).expect("it was written");
    assert!(text.contains("@./night_albedo.png@") && !text.contains("room_albedo.png"));
}

/// A cloned project brings a cache, with which a run would find everything there already.
#[test]
fn a_cache_by_a_stranger_is_not_used() {
    let stranger = room();
    std::fs::write(stranger.path("key"), "the secret of a stranger").expect("it can be written");
    let line = LINE.replace("--no-cache", "--cache c");
    let counts = |message: &str| {
        let last = message.lines().last().expect("a run ends with a summary");
        last.split(" in ").next().expect("it has a first part").to_owned()
    };
    let first = stranger.check(&format!("{line} --cache-key key --out out"), 0);
    let victim = room();
    let copied = std::process::Command::new("cp")
        .arg("-r")
        .arg(stranger.path("c"))
        .arg(victim.path("c"))
        .status();
    assert!(copied.expect("there is cp").success());
    let message = victim.check(&format!("{line} --out out"), 0);
    assert!(message.contains("signed with another key"), "{message}");
    // Some nodes share a key within a run.
    assert_eq!(counts(&message), counts(&first), "as from nothing");
    assert_eq!(victim.pictures("out"), stranger.pictures("out"));
    let message = victim.check(&format!("{line} --out out"), 0);
    assert!(!counts(&message).contains("ran"), "its own results took their place: {message}");
    // A common key makes it one cache.
    std::fs::copy(stranger.path("key"), victim.path("key")).expect("it can be copied");
    let message = stranger.check(&format!("{line} --cache-key key --out out"), 0);
    assert!(!counts(&message).contains("ran"), "{message}");
    victim.write("short", "1234");
    assert!(
        victim
            .check(&format!("{line} --cache-key short"), 2)
            .contains("wanted a secret of at least 16 bytes, got 4")
    );
}

#[cfg(unix)]
#[test]
fn a_run_without_a_key_works_without_a_cache() {
    use std::os::unix::fs::PermissionsExt;
    let place = room();
    place.write("home", "not a folder");
    let message = place.check(&LINE.replace("--no-cache", "--cache c"), 0);
    assert!(
        message.contains("warning: no cache is used: ") && message.contains("--no-cache"),
        "{message}"
    );
    let place = room();
    place.check(&LINE.replace("--no-cache", "--cache c"), 0);
    if let Ok(key) = std::fs::canonicalize(place.path("home/.config/relight/cache.key")) {
        std::fs::set_permissions(&key, std::fs::Permissions::from_mode(0o644))
            .expect("they can be set");
        let message = place.check(&LINE.replace("--no-cache", "--cache c"), 0);
        assert!(
            message.contains("wanted a key that only its owner may read, got mode 644"),
            "{message}"
        );
    }
}

/// A folder with graph, edit and scene, in the folder `scene`.
fn confined_place() -> Place {
    let (place, sound) = (Place::new(), room());
    std::fs::create_dir(place.path("scene")).expect("a folder can be made");
    for name in ["scene.ron", "photo.png", "depth.npy", "lamp.png", "window.png"] {
        std::fs::copy(sound.path(name), place.path("scene").join(name)).expect("it can be copied");
    }
    std::fs::copy(root().join("graphs/physics.ron"), place.path("graph.ron"))
        .expect("it can be copied");
    place.write("edit.ron", IDENTITY);
    place
}

/// The files of `place` are sound, and refused with `--confined` if `wanted` names a file.
#[track_caller]
fn check_confined(place: &Place, wanted: Option<&str>) {
    let line = "check graph.ron edit.ron --scene scene";
    place.check(line, 0);
    match wanted {
        None => drop(place.check(&format!("{line} --confined"), 0)),
        Some(wanted) => {
            let message = place.check(&format!("{line} --confined"), 2);
            let names = message.contains("confined: wanted a file below");
            assert!(names && message.contains(wanted), "{wanted}: {message}");
        }
    }
}

/// `--confined`: a scene, an edit, a graph and a model name only files beside or below them.
#[test]
fn scenes_of_strangers_can_be_confined() {
    check_confined(&confined_place(), None);

    let secret = confined_place();
    std::fs::rename(secret.path("scene/photo.png"), secret.path("photo.png"))
        .expect("it can be renamed");
    let scene = std::fs::read_to_string(secret.path("scene/scene.ron")).expect("it is there");
    secret.write("scene/scene.ron", scene.replace("photo.png", "../photo.png"));
    check_confined(&secret, Some("photo.png"));
    secret.write(
        "scene/scene.ron",
        scene.replace("photo.png", &secret.path("photo.png").display().to_string()),
    );
    check_confined(&secret, Some("photo.png"));
    #[cfg(unix)]
    {
        secret.write("scene/scene.ron", &scene);
        std::os::unix::fs::symlink(secret.path("photo.png"), secret.path("scene/photo.png"))
            .expect("a link can be made");
        check_confined(&secret, Some("photo.png"));
    }
}

#[test]
fn graphs_of_strangers_can_be_confined() {
    // The scene that a graph names counts as one of its files, unless the person names another.
    let naming = confined_place();
    std::fs::create_dir(naming.path("graphs")).expect("a folder can be made");
    naming.write("graphs/g.ron", r#"Graph(version: 1, extends: "physics.ron", scene: "../scene")"#);
    std::fs::copy(root().join("graphs/physics.ron"), naming.path("graphs/physics.ron"))
        .expect("it can be copied");
    naming.check("check graphs/g.ron edit.ron", 0);
    let message = naming.check("check graphs/g.ron edit.ron --confined", 2);
    assert!(
        message.contains("confined: wanted a file below") && message.contains("--scene DIR"),
        "{message}"
    );
    naming.check("check graphs/g.ron edit.ron --confined --scene scene", 0);

    let extending = confined_place();
    std::fs::create_dir(extending.path("graphs")).expect("a folder can be made");
    std::fs::rename(extending.path("graph.ron"), extending.path("graphs/physics.ron"))
        .expect("it can be renamed");
    extending.write("graph.ron", r#"Graph(version: 1, extends: "graphs/physics.ron")"#);
    check_confined(&extending, None);
    let outside = tempfile::tempdir().expect("a temporary folder can be made");
    let parent: PathBuf = outside.path().join("parent.ron");
    std::fs::copy(root().join("graphs/physics.ron"), &parent).expect("it can be copied");
    extending.write(
        "graph.ron",
        format!("Graph(version: 1, extends: {:?})", parent.display().to_string()),
    );
    check_confined(&extending, Some("parent.ron"));
}

#[test]
fn models_of_strangers_can_be_confined() {
    // A library of materials beside the model is taken, one elsewhere counts as missing: it is left
    // out, and nothing of it is read.
    let object = confined_place();
    std::fs::create_dir(object.path("models")).expect("a folder can be made");
    object.write(
        "edit.ron",
        r#"Edit(version: 1, objects: [Mesh(path: "models/a.obj", at: Pixel(x: 20, y: 15), height: 0.5)])"#,
    );
    object
        .write("models/a.obj", "mtllib ../a.mtl\nusemtl red\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    object.write("a.mtl", "newmtl red\nKd 1 0 0\n");
    let line = "run graph.ron edit.ron --scene scene --no-cache --only objects";
    assert!(!object.check(line, 0).contains("a.mtl"));
    assert!(object.check(&format!("{line} --confined"), 0).contains("a.mtl"));
    object.write(
        "edit.ron",
        r#"Edit(version: 1, objects: [Mesh(path: "../b.obj", at: Pixel(x: 20, y: 15), height: 0.5)])"#,
    );
    assert!(object.check(&format!("{line} --confined"), 2).contains("b.obj"));
}

/// Every type that is stored passes its own rules when it is read again.
#[test]
fn every_stored_value_is_read_again() {
    let place = room();
    place.write(
        "ball.obj",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n",
    );
    place.write(
        "edit.ron",
        r#"Edit(version: 1,
        lights: { "lamp": Scale(0.5), "ball": Lamp(shape: Mesh(path: "ball.obj", height: 0.2), at: Point(0, 0, -1), radiance: (5, 5, 5)) },
        materials: [Paint(region: Grow(20, 20), albedo: Linear(0.5, 0.2, 0.2), roughness: 0.2)],
        objects: [Sphere(radius: 0.2, at: Pixel(x: 20, y: 25), material: (roughness: 0.1, metallic: 1.0))])"#,
    );
    let graph =
        load(&root().join("graphs/indoor.ron"), place.folder.path(), &place.path("edit.ron"));
    let graph = graph.unwrap_or_else(|faults| panic!("{}", faults[0]));
    let cache = place.path("cache");
    run(&engine(Some(&cache)), &graph, &[]);
    let names: Vec<String> = graph.instances().map(str::to_owned).collect();
    let wanted: Vec<&str> = names.iter().map(String::as_str).collect();
    run(&engine(Some(&cache)), &graph, &wanted);
    let again = run(&engine(Some(&cache)), &graph, &wanted);
    // Its layers are quicker to make than to read, and are not stored.
    assert_eq!(ran(&again), ["compose"]);
    assert!(again.nodes.iter().all(|node| node.why.is_none() || node.name == "compose"));
}
