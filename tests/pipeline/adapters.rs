//! Networks by other people in the place of ours: tiny ones whose result is a closed form, through
//! the command, in each backend that is there.

use glam::Vec3;
use relight::geometry::Camera;
use relight::image::{NamedBytes, Plane, Transfer, read_depth, read_normal};

use crate::common::files::png_of;
use crate::onnx::{OPEN, Onnx};
use crate::project::*;

pub const SIZE: (usize, usize) = (40, 30);
const PHOTO: [i64; 4] = [1, 3, OPEN, OPEN];
const PICTURE: [i64; 4] = [1, 1, OPEN, OPEN];

/// Stored numbers, 0..=1: red grows to the right, green downwards.
pub fn stored(x: usize, y: usize) -> Vec3 {
    Vec3::new((60 + 4 * x) as f32, (80 + 4 * y) as f32, 51.0) / 255.0
}

/// A scene that names no depth, and a network.
pub fn photo(network: impl AsRef<[u8]>) -> Place {
    let place = Place::new();
    place.write("scene.ron", r#"Scene(version: 1, photo: "photo.png", camera: FovX(60))"#);
    place.write("photo.png", png_of(SIZE, stored));
    place.write("net.onnx", network);
    place
}

/// `Depth` at the photo's own size, so that nothing is resampled.
pub const LINE: &str = r#"run GRAPHS/depth.ron EDITS/none.ron --scene . --no-cache --out found --set depth.model="net.onnx" --set depth.side=30
    --set depth.multiple=1 --set depth.normalization=None"#;

/// The backends that are there; ONNX Runtime where ORT_DYLIB_PATH names its library.
fn backends() -> Vec<&'static str> {
    if std::env::var_os("ORT_DYLIB_PATH").is_some() {
        return vec!["rten", "ort"];
    }
    eprintln!("ort skipped: ORT_DYLIB_PATH names no library of ONNX Runtime");
    vec!["rten"]
}

fn depth(place: &Place) -> Plane<f32> {
    let bytes = std::fs::read(place.path("found/depth.exr")).expect("it is written");
    read_depth(NamedBytes::new("depth.exr", &bytes)).expect("a scene can name it").0
}

/// The largest error of `got`, as a fraction of the expected value.
fn worst(got: &Plane<f32>, wanted: impl Fn(usize, usize) -> f32) -> f32 {
    let errors = (0..got.len()).map(|i| (i % got.width(), i / got.width(), got.pixels()[i]));
    errors.map(|(x, y, z)| (z / wanted(x, y) - 1.0).abs()).fold(0.0, f32::max)
}

/// Distance between two pixels of the photo.
fn distance(depth: &Plane<f32>, [x0, y0, x1, y1]: [f32; 4]) -> f32 {
    let camera = Camera::from_fov_x(SIZE.0, SIZE.1, 60.0);
    let point = |x: f32, y: f32| camera.unproject(x, y, depth.get(x as usize, y as usize));
    point(x0, y0).distance(point(x1, y1))
}

/// Meters: 1 + 4 red + 2 green, [1, 1, height, width].
pub fn metric() -> Vec<u8> {
    Onnx::default()
        .input("rgb", &PHOTO)
        .output("z", &PICTURE)
        .mix("rgb", "z", &[[4.0, 2.0, 0.0]], &[1.0])
        .file()
}

/// Disparity: 3 red + 1, [1, height, width].
fn relative() -> Vec<u8> {
    let mixed = Onnx::default().input("pixel_values", &PHOTO).output("q", &[1, OPEN, OPEN]);
    let mixed = mixed.mix("pixel_values", "four", &[[3.0, 0.0, 0.0]], &[1.0]);
    mixed.numbers("one", &[1]).node("Squeeze", &["four", "one"], &["q"]).file()
}

#[test]
fn metric_depth_is_what_the_network_says() {
    let wanted = |x: usize, y: usize| 1.0 + stored(x, y).dot(Vec3::new(4.0, 2.0, 0.0));
    for backend in backends() {
        let place = photo(metric());
        let message =
            place.check(&format!("{LINE} -v --backend {backend} --set depth.kind=Metric"), 0);
        assert!(
            message.contains(if backend == "ort" {
                "networks by ONNX Runtime"
            } else {
                "networks by rten"
            }),
            "{message}"
        );
        let got = depth(&place);
        // The photo's curve is undone and applied again, in single precision.
        assert_eq!(got.size(), SIZE);
        assert!(worst(&got, wanted) < 1e-5, "{backend}: {}", worst(&got, wanted));
        let png = png(&std::fs::read(place.path("found/depth.png")).expect("it is written"));
        assert_eq!(
            [png.get_pixel(0, 0).0, png.get_pixel(39, 29).0],
            [[255; 3], [0; 3]],
            "near is white, far is black"
        );

        place.check(
            &format!(
                "{LINE} --backend {backend} --set depth.kind=Metric --known-length 2,3,30,20=1.75"
            ),
            0,
        );
        let length = distance(&depth(&place), [2.0, 3.0, 30.0, 20.0]);
        assert!((length / 1.75 - 1.0).abs() < 1e-4, "{backend}: {length}");
    }
}

#[test]
fn relative_depth_gets_its_scale_from_a_known_length() {
    for backend in backends() {
        let place = photo(relative());
        place.check(
            &format!(
                "{LINE} --backend {backend} --known-length 5,3,34.5,28=2.03m --set depth.span=3"
            ),
            0,
        );
        let got = depth(&place);
        let length = distance(&got, [5.0, 3.0, 34.5, 28.0]);
        assert!((length / 2.03 - 1.0).abs() < 1e-4, "{backend}: {length}");
        // 1 / z is linear in red; 5 % of 1200 pixels are one and a half columns: the third and the
        // third last are 3 : 1.
        let row: Vec<f32> = (0..40).map(|x| 1.0 / got.get(x, 7)).collect();
        assert!(row.windows(3).all(|w| (w[0] - 2.0 * w[1] + w[2]).abs() < 1e-4 * w[1]), "{row:?}");
        assert!(
            (row[38] / row[1] - 3.0).abs() < 0.02 || (row[37] / row[2] - 3.0).abs() < 0.02,
            "{row:?}"
        );

        // A room in which 1 / z = (q - 1) / 2: two lengths determine it.
        let z = |x: usize| 2.0 / (3.0 * stored(x, 0).x);
        let room = Plane::from_fn(SIZE.0, SIZE.1, |x, _| z(x));
        let known =
            [[3.0, 2.0, 3.0, 27.0], [36.0, 2.0, 36.0, 27.0]].map(|at| (at, distance(&room, at)));
        let known = known
            .map(|([a, b, c, d], meters)| format!("--known-length {a},{b},{c},{d}={meters}"))
            .join(" ");
        place.check(&format!("{LINE} --backend {backend} {known}"), 0);
        assert!(
            worst(&depth(&place), |x, _| z(x)) < 1e-4,
            "{backend}: {}",
            worst(&depth(&place), |x, _| z(x))
        );
    }
}

/// Sizes: one that the file fixes, and one of 14 patches that it leaves open; normalizations.
#[test]
fn the_photo_comes_as_the_network_wants_it() {
    let fixed = |w: i64, h: i64| {
        Onnx::default()
            .input("x", &[1, 3, h, w])
            .output("z", &[1, 1, h, w])
            .mix("x", "z", &[[1e-4, 0.0, 1.0]], &[2.0])
            .file()
    };
    let place = photo(fixed(20, 8));
    let line = LINE.replace("--set depth.normalization=None", "--set depth.kind=Metric");
    // Blue is 0.2 everywhere; a trace of red keeps the numbers from being one.
    for (set, wanted) in [
        ("None", 0.2),
        ("Half", (0.2 - 0.5) / 0.5),
        ("ImageNet", (0.2 - 0.406) / 0.225),
        ("Custom(mean:(9,9,0.1),deviation:(0.9,9,0.5))", 0.2),
    ] {
        place.check(&format!("{line} --set depth.normalization={set}"), 0);
        let got = depth(&place);
        assert_eq!(got.size(), (20, 15), "the photo's aspect, the network's longer side");
        assert!(worst(&got, |_, _| 2.0 + wanted) < 1e-3, "{set}: {}", got.get(3, 3));
    }
    let open = photo(metric());
    open.check(&format!("{line} --set depth.side=100 --set depth.multiple=14"), 0);
    let report = std::fs::read_to_string(open.path("found/report.json")).expect("it is written");
    assert!(
        report.contains("seen at 140 x 98, scale 1.0000"),
        "133.3 x 100 in patches of 14: {report}"
    );
    assert_eq!(depth(&open).size(), SIZE, "no larger than the photo");
}

#[test]
fn a_scene_without_depth_is_for_graphs_that_need_none() {
    let place = photo(metric());
    place.check(
        "run GRAPHS/find_lights_photo.ron EDITS/none.ron --scene . --no-cache --out lights",
        0,
    );
    assert!(place.path("lights/scene_lights.ron").is_file());
    for graph in ["physics", "find_lights"] {
        let message = place.check(&format!("check GRAPHS/{graph}.ron EDITS/none.ron --scene ."), 2);
        assert!(message.contains("./scene.ron: this scene has no `depth`"), "{message}");
        assert!(message.contains("graphs/depth.ron"), "{message}");
        assert!(!message.contains("ReadScene"), "once is enough: {message}");
    }
    // The found masks are usable in a scene.
    place.check(&format!("{LINE} --set depth.kind=Metric"), 0);
    place.write(
        "scene.ron",
        r#"Scene(version: 1, photo: "photo.png", camera: FovX(60), depth: (path: "found/depth.exr"))"#,
    );
    place.check("run GRAPHS/find_lights.ron EDITS/none.ron --scene . --no-cache --out lights", 0);
}

/// rten runs a cubic Resize as a linear one; the run warns, as third-party networks often have one.
#[test]
fn what_a_backend_computes_wrongly_is_told() {
    let network = Onnx::default().input("x", &PHOTO).output("z", &PICTURE).mix(
        "x",
        "a",
        &[[4.0, 2.0, 0.0]],
        &[1.0],
    );
    let place = photo(network.cubic("a", "z", [1.0, 1.0, 0.7, 0.7]).file());
    for backend in backends() {
        let message =
            place.check(&format!("{LINE} -v --backend {backend} --set depth.kind=Metric"), 0);
        let warning = "warning: depth: net.onnx: it resizes by cubic interpolation, which rten replaces by linear: use --backend ort";
        assert_eq!(message.contains(warning), backend == "rten", "{message}");
    }
}

/// Name of a case, its network, settings, and parts of the expected message.
type Refused<'a> = (&'a str, Vec<u8>, &'a str, &'a [&'a str]);

/// Runs `Depth` with each network in each backend, and expects the message.
fn check_refused(corpus: &[Refused]) {
    for backend in backends() {
        for (name, network, set, wanted) in corpus {
            let message = photo(network).check(&format!("{LINE} --backend {backend} {set}"), 2);
            for part in *wanted {
                assert!(
                    message.contains(part),
                    "{backend}, {name}: wanted {part:?}, got:\n{message}"
                );
            }
        }
    }
}

/// A network without nodes, whose input is the photo.
fn plain() -> Onnx {
    Onnx::default().input("x", &PHOTO)
}

#[test]
fn networks_of_another_form_are_named() {
    let two = Onnx::default()
        .input("rgb", &PHOTO)
        .input("camera", &[1, 3, OPEN, OPEN])
        .output("z", &PHOTO);
    let flat = plain()
        .output("z", &[OPEN])
        .numbers("all", &[-1])
        .node("Reshape", &["x", "all"], &["z"])
        .file();
    let gray = Onnx::default()
        .input("x", &[1, 1, OPEN, OPEN])
        .output("z", &PICTURE)
        .node("Relu", &["x"], &["z"])
        .file();
    let pair = plain().output("z", &PICTURE).output("sure", &PICTURE);
    let pair = pair.mix("x", "z", &[[1.0; 3]], &[0.0]).mix("x", "sure", &[[1.0; 3]], &[0.0]).file();
    let sound = metric();
    check_refused(&[
        (
            "a text",
            b"this is no network".to_vec(),
            "",
            &["net.onnx: wanted a network in ONNX that"],
        ),
        ("nothing", Vec::new(), "", &["net.onnx: wanted a network in ONNX that"]),
        (
            "cut",
            sound[..sound.len() / 2].to_vec(),
            "",
            &["net.onnx: wanted a network in ONNX that"],
        ),
        (
            "two inputs",
            two.node("Add", &["rgb", "camera"], &["z"]).file(),
            "",
            &[
                "net.onnx: wanted a network with one input, the photo, got 2 of them: `rgb`, `camera`; export it without the others",
            ],
        ),
        (
            "input name",
            sound.clone(),
            r#"--set depth.input="image""#,
            &["net.onnx: wanted an input `image`, named by the parameter `input`, got `rgb`"],
        ),
        (
            "output name",
            sound.clone(),
            r#"--set depth.output="depth""#,
            &["net.onnx: wanted an output `depth`, got `z`"],
        ),
        (
            "two outputs",
            pair,
            "",
            &[
                "net.onnx: wanted one output, got 2 of them: `z`, `sure`; name one with the parameter `output`",
            ],
        ),
        (
            "grey input",
            gray,
            "",
            &[
                "net.onnx: input `x`: wanted [1, 3, height, width], a photo with red first, got [1, 1, ?, ?]",
            ],
        ),
        (
            "flat output",
            flat,
            "",
            &["net.onnx: output `z`: wanted [height, width] or [1, 1, height, width], got [3600]"],
        ),
    ]);
}

#[test]
fn depths_and_lengths_that_cannot_be_used_are_named() {
    let nan = plain()
        .output("z", &PICTURE)
        .mix("x", "a", &[[0.0; 3]], &[0.0])
        .node("Div", &["a", "a"], &["z"])
        .file();
    let below = plain().output("z", &PICTURE).mix("x", "z", &[[-1.0; 3]], &[0.0]).file();
    let even = plain().output("z", &PICTURE).mix("x", "z", &[[0.0; 3]], &[0.5]).file();
    let sound = metric();
    check_refused(&[
        ("not finite", nan, "", &["net.onnx: output `z`: wanted finite numbers, got NaN"]),
        (
            "below zero",
            below,
            "--set depth.kind=Metric",
            &["net.onnx: wanted meters, got no positive number; is its depth Relative?"],
        ),
        (
            "even",
            even,
            "--known-length 1,1,9,9=1",
            &[
                "net.onnx: the network returned no depth: wanted numbers that vary, got 0.5 everywhere",
            ],
        ),
        (
            "no length",
            sound.clone(),
            "",
            &["depth: known_lengths: relative depth has no scale", "--known-length X,Y,X,Y=METERS"],
        ),
        (
            "one place",
            sound.clone(),
            "--known-length 4,4,4,4=1",
            &["known_lengths: number 1: wanted two places, got (4, 4) twice"],
        ),
        (
            "outside",
            sound.clone(),
            "--known-length 4,4,5,9=1 --known-length 4,4,40,9=1",
            &["known_lengths: number 2: (40, 9) is outside the photo, wanted 0..40 and 0..30"],
        ),
        (
            "no metres",
            sound.clone(),
            "--known-length 4,4,9,9=0",
            &["known_lengths: number 1: wanted 0.001 to 1000 m, got 0"],
        ),
        (
            "no length at all",
            sound.clone(),
            "--known-length 4,4,9,9",
            &["wanted two pixels and the meters between them, as `212,80,212,395=2.03`"],
        ),
        (
            "span",
            sound.clone(),
            "--set depth.span=1",
            &["--set depth.span", "span: wanted > 1 and <= 1000, got 1"],
        ),
        ("side", sound.clone(), "--set depth.side=7", &["side: wanted 8..=4096, got 7"]),
        (
            "deviation",
            sound,
            "--set depth.normalization=Custom(mean:(0,0,0),deviation:(1,0,1))",
            &["normalization: wanted a positive deviation"],
        ),
    ]);
}

#[test]
fn a_missing_network_or_stage_is_named() {
    let message = photo([]).check("run GRAPHS/depth.ron EDITS/none.ron --scene .", 2);
    assert!(message.contains("model: wanted the file of a network"), "{message}");
    let message = photo([]).check(
        "check GRAPHS/find_lights_photo.ron EDITS/none.ron --scene . --known-length 1,1,9,9=1",
        2,
    );
    assert!(
        message.contains(
            "--known-length: this graph has no stage that takes known lengths: wanted Depth"
        ),
        "{message}"
    );
}

/// Seven channels: albedo, which is the photo's colors, in 0..=255; a normal, x to the left;
/// roughness, which is red, in -1..=1.
fn materials(width: i64, height: i64) -> Vec<u8> {
    let color = |c: usize, weight: f32| [0, 1, 2].map(|at| if at == c { weight } else { 0.0 });
    let (colors, none) = ([0, 1, 2].map(|c| color(c, 255.0)), [[0.0; 3]; 3]);
    let rows = [&colors[..], &none, &[color(0, 2.0)]].concat();
    let bias = [0.0, 0.0, 0.0, -0.6, 0.0, 0.8, -1.0];
    let network =
        Onnx::default().input("x", &[1, 3, height, width]).output("maps", &[1, 7, height, width]);
    network.mix("x", "maps", &rows, &bias).file()
}

/// A graph with a network in the place of MNet, whose materials are written as files.
const MATERIALS: &str = r#"Graph(version: 1, nodes: {
    "photo": (op: ReadPhoto()),
    "mnet": (op: OnnxMaterials(model: "net.onnx", normal_signs: (-1, 1, 1),
        albedo: (output: "maps", range: (0, 255)), normal: (output: "maps", first: 3, range: (-1, 1)),
        roughness: (output: "maps", first: 6, range: (-1, 1))),
        in: { "photo": "photo.small", "camera": "photo.camera" }),
    "write": (op: WriteEstimates(), in: { "shape": [], "radiance": [], "albedo": "mnet.albedo", "normal": "mnet.normal", "roughness": "mnet.roughness" }),
}, outputs: ["write.files"])"#;

/// A written picture at linear values.
fn estimate(place: &Place, name: &str) -> Plane<Vec3> {
    exr(&place.path(&format!("out/{name}.exr")))
}

#[test]
fn materials_by_other_networks_are_brought_to_ours() {
    let line = "run materials.ron EDITS/none.ron --scene . --no-cache --out out";
    for backend in backends() {
        let place = photo(materials(40, 30));
        place.write("materials.ron", MATERIALS);
        place.check(&format!("{line} --backend {backend}"), 0);
        let near = |got: &Plane<Vec3>, wanted: &dyn Fn(usize, usize) -> Vec3| {
            let pixels = (0..got.len())
                .map(|i| (got.pixels()[i] - wanted(i % 40, i / 40)).abs().max_element());
            pixels.fold(0.0, f32::max)
        };
        let albedo = estimate(&place, "albedo");
        let normal = std::fs::read(place.path("out/normal.exr")).expect("it is written");
        let normal = read_normal(NamedBytes::new("normal.exr", &normal)).expect("it is sound");
        // Single precision, and halves where files hold them.
        assert!(near(&albedo, &stored) < 1e-3, "{}", near(&albedo, &stored));
        let message = Vec3::new(0.6, 0.0, 0.8);
        assert!(near(&normal, &|_, _| message) < 1e-3, "{}", near(&normal, &|_, _| message));
        let roughness = read_depth(NamedBytes::new(
            "r",
            &std::fs::read(place.path("out/roughness.exr")).expect("it is written"),
        ));
        let roughness = roughness.expect("it is a plane").0;
        assert!(worst(&roughness, |x, y| stored(x, y).x) < 1e-3);

        // The same numbers as sRGB.
        let encoded = MATERIALS.replace("normal_signs", "albedo_transfer: Srgb, normal_signs");
        place.write("materials.ron", encoded);
        place.check(&format!("{line} --backend {backend}"), 0);
        let linear = |x: usize, y: usize| {
            Vec3::from_array(stored(x, y).to_array().map(|c| Transfer::Srgb.decode(c)))
        };
        assert!(
            near(&estimate(&place, "albedo"), &|x, y| linear(x, y)
                .clamp(Vec3::splat(0.02), Vec3::splat(0.95)))
                < 1e-3
        );
    }
}

#[test]
fn materials_that_do_not_fit_are_named() {
    let place = photo(materials(40, 30));
    for (from, to, wanted) in [
        (
            "first: 6",
            "first: 7",
            "net.onnx: output `maps`: wanted [1, 8 or more, height, width], got [1, 7, 30, 40]",
        ),
        (
            "first: 3",
            "first: 5",
            "net.onnx: output `maps`: wanted [1, 8 or more, height, width], got [1, 7, 30, 40]",
        ),
        (
            r#"albedo: (output: "maps""#,
            r#"albedo: (output: "colour""#,
            "net.onnx: wanted an output `colour`, got `maps`",
        ),
        (
            "range: (0, 255)",
            "range: (1, 1)",
            "albedo: range: wanted the lower number first, got (1, 1)",
        ),
        ("(-1, 1, 1),", "(-1, 0.5, 1),", "normal_signs: wanted 1 or -1 each, got (-1, 0.5, 1)"),
        (r#"model: "net.onnx","#, "", "model: wanted the file of a network, got none"),
        (
            r#"albedo: (output: "maps", range: (0, 255)), "#,
            "",
            "albedo: wanted the name of an output of the network, or a wire to the input `albedo`, got neither",
        ),
    ] {
        assert!(MATERIALS.contains(from), "{from}");
        place.write("materials.ron", MATERIALS.replace(from, to));
        let message =
            place.check("run materials.ron EDITS/none.ron --scene . --no-cache --out out", 2);
        assert!(message.contains(wanted), "wanted {wanted:?}, got:\n{message}");
    }
}

/// The adapter in the whole pipeline: albedo and roughness by a network, normals from depth, as
/// docs/networks.md shows.
#[test]
fn a_network_stands_in_for_mnet() {
    let place = photo(materials(40, 30));
    place.write("theirs.ron", format!(
        r#"Graph(version: 1, extends: "{}", nodes: {{ "mnet": (
            op: OnnxMaterials(model: "net.onnx", albedo: (output: "maps", range: (0, 255)), roughness: (output: "maps", first: 6, range: (-1, 1))),
            in: {{ "photo": "scene.small", "camera": "scene.small_camera", "normal": "room.normal" }}) }})"#,
        root().join("graphs/indoor.ron").display()
    ));
    let line = "run theirs.ron --scene DEMO --no-cache --out out --only fit --json";
    let output = place.command(line).output().expect("the program starts");
    let message = check_output(line, &output, 0);
    assert!(!message.contains("warning: mnet"), "{message}");
    let report = String::from_utf8(output.stdout).expect("it is text");
    assert!(report.contains("OnnxMaterials") && !report.contains(r#""kind": "MNet""#), "{report}");
}
