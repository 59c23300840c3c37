//! Bad input through the whole command: exit status 2 and a name, or a picture; never a panic, an
//! abort or a hang.

use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use glam::Vec3;
use needs::needs;
use rayon::prelude::*;
use relight::image::{NamedBytes, Transfer, read_photo};

use crate::common::files::{npy, png_of};
use crate::project::*;

const SIZE: (usize, usize) = (40, 30);
const SCENE: &str = r#"Scene(version: 1, photo: "photo.png", camera: FovX(60), depth: (path: "depth.npy"),
    lights: { "lamp": Lamp(mask: "lamp.png"), "window": Window(mask: "window.png") })"#;
const EDIT: &str = r#"Edit(version: 1, lights: { "lamp": Off, "window": Scale(0.5),
    "globe": Lamp(shape: Sphere(radius: 0.1), at: Point(0, 0, -1), radiance: (9, 8, 7)) })"#;

/// A mask of the columns `from..from + 6`, rows 4..10.
fn mask(from: usize) -> Vec<u8> {
    png_of(SIZE, |x, y| {
        Vec3::splat(f32::from(u8::from((from..from + 6).contains(&x) && (4..10).contains(&y))))
    })
}

/// A folder with a sound scene and an edit.
pub fn room() -> Place {
    let place = Place::new();
    place.write("scene.ron", SCENE);
    place.write("edit.ron", EDIT);
    place.write(
        "photo.png",
        png_of(SIZE, |x, y| Vec3::new(0.2 + x as f32 / 80.0, 0.4, 0.2 + y as f32 / 60.0)),
    );
    place.write("depth.npy", npy(SIZE, |x, y| 2.0 + 0.02 * x as f32 + 0.01 * y as f32));
    place.write("lamp.png", mask(4));
    place.write("window.png", mask(25));
    place
}

const LINE: &str = "run GRAPHS/physics.ron edit.ron --scene . --no-cache";

/// Waits for the end of a program; one that runs for more than a minute is a fault.
pub fn ended(child: &mut Child, what: &str) -> ExitStatus {
    let began = Instant::now();
    loop {
        if let Some(status) = child.try_wait().expect("it can be waited for") {
            return status;
        }
        if began.elapsed() > Duration::from_secs(60) {
            child.kill().expect("it can be killed");
            panic!("{what}: still running after a minute");
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Runs to an end within time and memory; status and standard error.
fn run(place: &Place, what: &str) -> (i32, String) {
    let command = place.command(LINE);
    // 4 GB are plenty for these runs; more is an unintended allocation.
    let mut shell = std::process::Command::new("sh");
    shell.current_dir(place.folder.path()).args(["-c", "ulimit -v 4000000; exec \"$@\"", "sh"]);
    shell.arg(command.get_program()).args(command.get_args());
    let message = std::fs::File::create(place.path("message")).expect("a file can be written");
    let mut child = shell.stdout(Stdio::null()).stderr(message).spawn().expect("there is a shell");
    let status = ended(&mut child, what);
    let message = std::fs::read(place.path("message")).expect("it is there");
    let message = String::from_utf8_lossy(&message).into_owned();
    assert!(!message.contains("panicked"), "{what} reported:\n{message}");
    let status = status.code().unwrap_or_else(|| panic!("{what}: {status}; message:\n{message}"));
    (status, message)
}

/// Wants this status and all these words.
pub fn check(place: &Place, what: &str, status: i32, words: &[&str]) {
    let (got, message) = run(place, what);
    assert_eq!(got, status, "{what} reported:\n{message}");
    for word in words {
        assert!(message.contains(word), "{what}: wanted {word:?}, got:\n{message}");
    }
}

#[test]
fn depth_of_every_kind() {
    let check =
        |what: &str, value: &(dyn Fn(usize, usize) -> f32 + Sync), status: i32, words: &[&str]| {
            let place = room();
            place.write("depth.npy", npy(SIZE, value));
            check(&place, what, status, words);
        };
    let holes = |hole: f32, every: usize| {
        move |x: usize, y: usize| if (x + 7 * y).is_multiple_of(every) { hole } else { 2.5 }
    };
    check("constant", &|_, _| 2.0, 0, &[]);
    for hole in [0.0, -1.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-30, 1e30] {
        check("some holes", &holes(hole, 3), 0, &[]);
        check("holes everywhere", &|_, _| hole, 2, &["depth.npy", "holes everywhere"]);
        let one = |x: usize, y: usize| if (x, y) == (20, 15) { 2.0 } else { hole };
        check("one reading", &one, 0, &["warning", "depth.npy", "of the depth are holes"]);
    }
    check("steps everywhere", &|x, y| if (x + y).is_multiple_of(2) { 1.0 } else { 9.0 }, 0, &[]);
    check("the smallest and the largest", &|x, _| if x < 20 { 2e-4 } else { 9e4 }, 0, &[]);
}

#[test]
fn photos_of_every_kind() {
    // A lamp of one pixel, where there is room for one.
    for size in [(1, 1), (40, 1), (1, 40), (2, 2), (3, 200)] {
        let place = room();
        place.write("scene.ron", SCENE.replace(r#""window": Window(mask: "window.png")"#, ""));
        place.write("photo.png", png_of(size, |x, y| Vec3::splat(((x + y) % 3) as f32 / 4.0)));
        place.write("depth.npy", npy(size, |_, _| 2.0));
        place.write(
            "lamp.png",
            png_of(size, |x, y| Vec3::splat(f32::from(u8::from((x, y) == (0, 0))))),
        );
        let (status, words): (i32, &[&str]) =
            if size == (1, 1) { (2, &["lamp.png", "covers everything"]) } else { (0, &[]) };
        place.write("edit.ron", EDIT.replace(r#""window": Scale(0.5),"#, ""));
        check(&place, &format!("{size:?}"), status, words);
        place.write(
            "scene.ron",
            r#"Scene(version: 1, photo: "photo.png", camera: FovX(60), depth: (path: "depth.npy"))"#,
        );
        place.write("edit.ron", EDIT.replace(r#""lamp": Off, "window": Scale(0.5),"#, ""));
        check(&place, &format!("{size:?} without lights"), 0, &[]);
    }
    for gray in [0.0, 1.0] {
        let place = room();
        place.write("photo.png", png_of(SIZE, |_, _| Vec3::splat(gray)));
        check(&place, &format!("all {gray}"), 0, &[]);
    }
}

#[test]
fn masks_of_every_kind() {
    for light in ["lamp", "window"] {
        let name = format!("{light}.png");
        let check = |what: &str, bytes: Vec<u8>, status: i32, words: &[&str]| {
            let place = room();
            place.write(&name, bytes);
            check(&place, &format!("{light}: {what}"), status, words);
        };
        let left = |x: usize| Vec3::splat(f32::from(u8::from(x < 5)));
        check(
            "twice the size",
            png_of((80, 60), |x, _| left(x)),
            0,
            &["warning", &name, "resampled"],
        );
        check("another shape", png_of((40, 40), |x, _| left(x)), 2, &[&name, "aspect ratio"]);
        check("empty", png_of(SIZE, |_, _| Vec3::ZERO), 2, &[&name, "a black picture"]);
        check("everything", png_of(SIZE, |_, _| Vec3::ONE), 2, &[&name, "covers everything"]);
        let but_one = |x, y| if (x, y) == (0, 0) { Vec3::ZERO } else { Vec3::ONE };
        check("all but a pixel", png_of(SIZE, but_one), 0, &[]);
        let one = |x, y| if (x, y) == (20, 15) { Vec3::ONE } else { Vec3::ZERO };
        check("one pixel", png_of(SIZE, one), 0, &[]);
        check("gray", png_of(SIZE, |x, y| 0.5 * one(x, y)), 0, &[]);
    }
    let place = room();
    place.write("window.png", mask(4));
    check(&place, "two masks on the same pixels", 0, &[]);
    place.write("ignore.png", png_of(SIZE, |x, _| Vec3::splat(f32::from(u8::from(x > 0)))));
    place.write("scene.ron", SCENE.replace("Scene(", "Scene(ignore: \"ignore.png\","));
    check(&place, "all but a column ignored", 0, &[]);
}

/// Masks of the sunlight; a black mask is valid.
#[test]
fn masks_of_sunlight_of_every_kind() {
    let place = room();
    place.write("scene.ron", SCENE.replace("Scene(", "Scene(sunlight: \"sun.png\","));
    let lit = |inside: fn(usize, usize) -> bool| {
        move |x, y| Vec3::splat(f32::from(u8::from(inside(x, y))))
    };
    check(&place, "no such file", 2, &["sun.png"]);
    for (what, bytes, status, words) in [
        ("no sun", png_of(SIZE, |_, _| Vec3::ZERO), 0, &[][..]),
        ("a patch", png_of(SIZE, lit(|x, y| (15..25).contains(&x) && y > 20)), 0, &[]),
        ("one pixel", png_of(SIZE, lit(|x, y| (x, y) == (20, 15))), 0, &[]),
        ("all but a pixel", png_of(SIZE, lit(|x, y| (x, y) != (0, 0))), 0, &[]),
        ("everything", png_of(SIZE, |_, _| Vec3::ONE), 2, &["sun.png", "covers everything"]),
        ("another shape", png_of((40, 40), lit(|x, _| x < 9)), 2, &["sun.png", "aspect ratio"]),
    ] {
        place.write("sun.png", bytes);
        check(&place, what, status, words);
    }
}

/// Edits that are well formed, but odd or impossible.
#[test]
fn edits_of_every_kind() {
    let lamp = |rest: &str| format!(r#""x": Lamp(shape: Sphere(radius: 0.1), {rest})"#);
    let window = |corners: &str| format!(r#""x": Window(corners: [{corners}])"#);
    for (edit, status, words) in [
        (lamp("at: Point(0, 0, -9), radiance: (5, 5, 5)"), 0, &[][..]), // within the wall
        (lamp("at: Point(0, 0, 0), radiance: (5, 5, 5)"), 0, &[]),      // around the camera
        (lamp("at: Point(0, 0, 3), radiance: (5, 5, 5)"), 0, &[]),      // behind the camera
        (lamp("at: Point(1e6, 0, -1e6), radiance: (5, 5, 5)"), 0, &[]),
        (lamp("at: Pixel(x: 20, y: 15), radiance: (0, 0, 0)"), 0, &[]),
        (lamp("at: Pixel(x: 20, y: 15, lift: -5), radiance: (1, 1, 1)"), 0, &[]),
        (lamp("at: Pixel(x: 7, y: 7), flux: 800"), 0, &["exposure"]), // on the lamp's own pixels
        (lamp("at: Pixel(x: 27, y: 7), radiance: (5, 5, 5)"), 0, &[]), // on the pane
        (lamp("at: Pixel(x: 40, y: 15), radiance: (5, 5, 5)"), 2, &["edit", "\"x\"", "outside the photo"]),
        (lamp("at: Pixel(x: -1, y: 15), radiance: (5, 5, 5)"), 2, &["edit", "\"x\"", "outside the photo"]),
        (
            r#""x": Lamp(shape: Rect(half: (1, 1), normal: (0, 1, 0)), at: Point(0, -0.5, -2), radiance: (1, 1, 1))"#
                .into(),
            0,
            &[],
        ),
        (r#""x": Lamp(shape: Sphere(radius: 1e9), at: Point(0, 0, -1), radiance: (1, 1, 1))"#.into(), 0, &[]),
        (r#""x": Lamp(shape: Sphere(radius: 1e-9), at: Point(0, 0, -1), radiance: (1, 1, 1))"#.into(), 0, &[]),
        (window("(5, 14), (20, 14), (20, 25), (5, 25)"), 0, &[]),
        (window("(5, 25), (20, 25), (20, 14), (5, 14)"), 0, &[]), // the other way round
        (window("(-30, -30), (80, -30), (80, 70), (-30, 70)"), 0, &[]), // more than the picture
        (window("(26, 5), (30, 5), (30, 9), (26, 9)"), 0, &[]),   // in the pane
        (window("(100, 100), (120, 100), (120, 120), (100, 120)"), 2, &["edit", "\"x\"", "no wall"]),
        (r#""lamp": Lamp(shape: Sphere(radius: 0.1), at: Point(0, 0, -1), radiance: (5, 5, 5))"#.into(), 0, &[]),
        (r#""lamp": Window(corners: [(5, 14), (20, 14), (20, 25), (5, 25)])"#.into(), 0, &[]),
        (r#""window": Lamp(shape: Sphere(radius: 0.1), at: Point(0, 0, -1), radiance: (5, 5, 5))"#.into(), 0, &[]),
        (r#""inv_lamp": Lamp(shape: Sphere(radius: 0.1), at: Point(0, 0, 1), radiance: (5, 5, 5))"#.into(), 0, &[]),
        (r#""inv_window": Off, "inv_lamp": Temperature(2700)"#.into(), 0, &[]),
        (r#""lamp": Scale(1e6)"#.into(), 0, &[]),
        (r#""lamp": Color(0, 0, 1)"#.into(), 0, &[]),
    ] {
        let place = room();
        place.write("edit.ron", format!("Edit(version: 1, lights: {{ {edit} }})"));
        check(&place, &edit, status, words);
    }
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder)
        .expect("a folder")
        .map(|entry| entry.expect("it can be listed").path());
    let below = |path: PathBuf| if path.is_dir() { files_below(&path) } else { vec![path] };
    let mut files: Vec<PathBuf> = entries.flat_map(below).collect();
    files.sort();
    files
}

#[test]
fn bad_pictures_in_every_role() {
    play_each(&files_below(&root().join("tests/bad/pictures")));
}

/// A sample of the corpora; the readers alone take all of them in tests/images.rs.
#[needs("../shared/data/corpora")]
#[test]
fn files_of_the_corpora_in_every_role() {
    let corpora = root().join("../shared/data/corpora");
    let mut files = Vec::new();
    let unpacked = tempfile::tempdir().expect("a temporary folder can be made");
    for archive in ["openexr_damaged", "pngsuite", "zune_fuzz", "valid_odd"] {
        let packed = corpora.join(format!("{archive}.tar.xz"));
        let folder = unpacked.path().join(archive);
        std::fs::create_dir(&folder).expect("a folder can be made");
        let tar = std::process::Command::new("tar")
            .arg("xf")
            .arg(&packed)
            .arg("-C")
            .arg(&folder)
            .status();
        assert!(tar.expect("tar runs").success());
        files.extend(files_below(&folder).into_iter().step_by(20));
    }
    play_each(&files);
}

fn play_each(files: &[PathBuf]) {
    let statuses: Vec<i32> = files
        .par_iter()
        .flat_map(|path| ["photo", "depth", "mask"].map(|role| play(path, role)))
        .collect();
    let done = statuses.iter().filter(|&&status| status == 0).count();
    println!("{} files in 3 roles: {done} pictures, the rest refused", files.len());
}

fn play(path: &Path, role: &str) -> i32 {
    let place = room();
    let bytes = std::fs::read(path).expect("it can be read");
    let name = match role {
        "photo" => "photo.png",
        "depth" => "depth.npy",
        _ => "lamp.png",
    };
    // Depth and mask that go with a readable photo, so that every stage meets it.
    if role == "photo"
        && let Ok(photo) = read_photo(NamedBytes::new("photo", &bytes), Transfer::Srgb)
    {
        let size = photo.picture.0.size();
        place.write("depth.npy", npy(size, |x, _| 2.0 + x as f32 / size.0 as f32));
        place.write(
            "lamp.png",
            png_of(size, |x, y| Vec3::splat(f32::from(u8::from(x < 1 && y < 1)))),
        );
        place.write(
            "window.png",
            png_of(size, |x, y| Vec3::splat(f32::from(u8::from(x > 0 && y < 1)))),
        );
    }
    place.write(name, bytes);
    let what = format!("{} as {role}", path.display());
    let (status, message) = run(&place, &what);
    assert!(status == 0 || status == 2, "{what}: status {status}; message:\n{message}");
    assert!(status == 0 || message.contains(name), "{what} reported:\n{message}");
    status
}
