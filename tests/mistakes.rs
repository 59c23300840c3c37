//! A hundred and more typical mistakes in files and arguments, and the message that each gives.
//!
//! docs/mistakes.md shows them all. `RELIGHT_BLESS=mistakes cargo test --release --test mistakes`
//! writes it; without the variable the page must equal the messages.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use rayon::prelude::*;

const GRAPH: &str = r#"Graph(
    version: 1,
    extends: "physics.ron",
    nodes: {
        "transport": (op: Transport(rays: 64)),
    },
)
"#;
const SCENE: &str = r#"Scene(
    version: 1,
    photo: "photo.png", transfer: Srgb,
    camera: FovX(60),
    depth: (path: "depth.png", kind: PlanarZ, scale: 0.001),
    lights: {
        "lamp_0": Lamp(mask: "lamp_0.png"),
        "window_0": Window(mask: "window_0.png"),
    },
)
"#;
const CHECK: &str = "check graph.ron edit.ron --scene scene";

/// One mistake.
struct Mistake {
    section: &'static str,
    /// The mistake in plain words.
    what: &'static str,
    /// The file that differs from the sound one, and its content; empty for arguments.
    file: (&'static str, Vec<u8>),
    line: String,
    /// Each is part of the message.
    wanted: Vec<&'static str>,
    /// Whether the message names line and column.
    placed: bool,
}

impl Mistake {
    fn new(section: &'static str, what: &'static str, wanted: &[&'static str]) -> Mistake {
        Mistake {
            section,
            what,
            file: ("", Vec::new()),
            line: CHECK.to_owned(),
            wanted: wanted.to_vec(),
            placed: false,
        }
    }

    fn file(self, name: &'static str, content: impl Into<Vec<u8>>) -> Mistake {
        Mistake { file: (name, content.into()), ..self }
    }

    fn placed(self) -> Mistake {
        Mistake { placed: true, ..self }
    }
}

/// A mistake in an entry of `lights` of an edit.
fn light(what: &'static str, entry: &str, wanted: &[&'static str]) -> Mistake {
    let text = format!("Edit(\n    version: 1,\n    lights: {{\n        {entry},\n    }},\n)\n");
    Mistake::new("Lights in an edit", what, wanted).file("edit.ron", text).placed()
}

/// A mistake in a field of an edit.
fn field(what: &'static str, entry: &str, wanted: &[&'static str]) -> Mistake {
    let text = format!("Edit(\n    version: 1,\n    {entry},\n)\n");
    Mistake::new("Surfaces, objects and sequences in an edit", what, wanted)
        .file("edit.ron", text)
        .placed()
}

/// A mistake in a whole edit.
fn edit(what: &'static str, text: &str, wanted: &[&'static str]) -> Mistake {
    Mistake::new("The edit file", what, wanted).file("edit.ron", text).placed()
}

/// A text that differs from `sound` once.
fn changed(sound: &str, from: &str, to: &str) -> String {
    assert_eq!(sound.matches(from).count(), 1, "{from:?} is there once");
    sound.replace(from, to)
}

fn scene(what: &'static str, from: &str, to: &str, wanted: &[&'static str]) -> Mistake {
    let text = changed(SCENE, from, to);
    Mistake::new("The scene", what, wanted).file("scene/scene.ron", text).placed()
}

fn graph(what: &'static str, from: &str, to: &str, wanted: &[&'static str]) -> Mistake {
    let text = changed(GRAPH, from, to);
    Mistake::new("The graph", what, wanted).file("graph.ron", text).placed()
}

/// A picture of the scene that is another file.
fn picture(
    what: &'static str,
    name: &'static str,
    bytes: Vec<u8>,
    wanted: &[&'static str],
) -> Mistake {
    Mistake::new("Pictures", what, wanted).file(name, bytes)
}

/// A mistake in the arguments.
fn line(what: &'static str, line: &str, wanted: &[&'static str]) -> Mistake {
    Mistake { line: line.to_owned(), ..Mistake::new("The command line", what, wanted) }
}

fn lights() -> Vec<Mistake> {
    vec![
        light("A decimal comma", r#""lamp_0": Scale(1,5)"#, &["a decimal comma? Write `1.5`"]),
        light(
            "A decimal comma in a color",
            r#""lamp_0": Color(1, 0,8, 0.6)"#,
            &["3 values", "0.8"],
        ),
        light(
            "A decimal comma in a field",
            r#""desk": Lamp(shape: Sphere(radius: 0,06), at: Point(0, 0, -1), flux: 800)"#,
            &["Sphere(radius: number)", "a decimal comma? Write `0.06`"],
        ),
        light("A number in quotes", r#""lamp_0": Scale("0.5")"#, &["without quotes: `0.5`"]),
        light("A decimal comma in quotes", r#""lamp_0": Scale("0,5")"#, &["Write `0.5`"]),
        light("A word for a number", r#""lamp_0": Scale(half)"#, &["a number, such as `0.5`"]),
        light("A factor below 0", r#""lamp_0": Scale(-1)"#, &["wanted >= 0, got -1"]),
        light("Percent", r#""lamp_0": Scale(50%)"#, &["`0.5` for 50 %"]),
        light("A number alone", r#""lamp_0": 0.5"#, &["did you mean `Scale(0.5)`?"]),
        light("A fraction", r#""lamp_0": Scale(1/3)"#, &["not a calculation"]),
        light("A unit behind a number", r#""lamp_0": Temperature(2700K)"#, &["`2700`"]),
        light("Degrees of temperature", r#""lamp_0": Temperature(20)"#, &["1000..=40000", "20"]),
        light("A number with a space", r#""lamp_0": Temperature(2 700)"#, &["wanted `,` before"]),
        light("Not a number", r#""lamp_0": Scale(NaN)"#, &["wanted a finite number, got NaN"]),
        light("A huge number", r#""lamp_0": Scale(1e99)"#, &["finite", "3.4e38"]),
        light("Small letters", r#""lamp_0": off"#, &["did you mean `Off`?"]),
        light("Capital letters", r#""lamp_0": OFF"#, &["did you mean `Off`?"]),
        light("A misspelt change", r#""lamp_0": Scael(2)"#, &["did you mean `Scale`?"]),
        light("A change that does not exist", r#""lamp_0": Blink(2)"#, &["`Scale(number)`"]),
        light("A change in quotes", r#""lamp_0": "Off""#, &["without quotes: `Off`"]),
        light("Parentheses behind Off", r#""lamp_0": Off()"#, &["write `Off`"]),
        light("On without parentheses", r#""lamp_0": On"#, &["write `On()`"]),
        light("true for on", r#""lamp_0": true"#, &["wanted `Off`, `On(..)`", "got `true`"]),
        light("A change without its number", r#""lamp_0": Scale"#, &["`Scale(number)`", "alone"]),
        light("An empty change", r#""lamp_0": Scale()"#, &["one value `Scale(number)`, got 0"]),
        light(
            "Lumens without their name",
            r#""lamp_0": On(800)"#,
            &["On(flux: number", "`On(flux: 800)`"],
        ),
        light("Watts", r#""lamp_0": On(watt: 60)"#, &["no field `watt`", "flux"]),
        light("A web color", r##""lamp_0": Color(#ff8800)"##, &["a color in quotes"]),
        light("A web color in quotes", r##""lamp_0": Color("#ff8800")"##, &["3 values", "number"]),
        light("A color in a list", r#""lamp_0": Color([1, 0.8, 0.6])"#, &["Color(number, number"]),
        light("Two numbers for a color", r#""lamp_0": Color(1, 0.8)"#, &["3 values", "got 2"]),
        light("A light that does not exist", r#""lamp_1": Off"#, &["did you mean `lamp_0`?"]),
        light("A misspelt light", r#""windw_0": Off"#, &["did you mean `window_0`?"]),
        light("A light without quotes", "lamp_0: Off", &["write \"lamp_0\""]),
        light("Single quotes", "'lamp_0': Off", &["wanted double quotes", "\"lamp_0\""]),
        light("Curved quotes", "“lamp_0”: Off", &["straight quotes"]),
        light("A missing quote", r#""lamp_0: Off"#, &["never closed"]),
        light("A missing colon", r#""lamp_0" Off"#, &["wanted `:` before `Off`"]),
        light("An equals sign", r#""lamp_0" = Off"#, &["wanted `:`", "name: value"]),
        light("A light twice", r#""lamp_0": Off, "lamp_0": Scale(2)"#, &["given twice"]),
        light("A name with a space", r#""my lamp": Lamp()"#, &["wanted a light name", "my lamp"]),
        light("A window switched on", r#""window_0": On()"#, &["wanted a lamp", "Scale(..)"]),
        light(
            "A lamp without a place",
            r#""desk": Lamp(shape: Sphere(radius: 0.1), flux: 800)"#,
            &["a field `at`", "Pixel(x: number"],
        ),
        light(
            "A lamp without its strength",
            r#""desk": Lamp(shape: Sphere(radius: 0.1), at: Point(0, 0, -1))"#,
            &["wanted flux (lumens) or radiance"],
        ),
        light(
            "A radius without its name",
            r#""desk": Lamp(shape: Sphere(0.1), at: Point(0, 0, -1), flux: 800)"#,
            &["Sphere(radius: number)"],
        ),
        light(
            "Pixels without names",
            r#""desk": Lamp(shape: Sphere(radius: 0.1), at: (8, 6), flux: 800)"#,
            &["`at` wanted `Pixel(x: number"],
        ),
        light(
            "A pixel outside of the photo",
            r#""desk": Lamp(shape: Sphere(radius: 0.1), at: Pixel(x: 99, y: 6), radiance: (1, 1, 1))"#,
            &["0..16 and 0..12", "(99, 6)"],
        ),
        light(
            "A missing comma between fields",
            r#""desk": Lamp(shape: Sphere(radius: 0.1), at: Pixel(x: 8 y: 6), flux: 800)"#,
            &["wanted `,` before `y`"],
        ),
        light(
            "A missing colon between name and value",
            r#""desk": Lamp(shape Sphere(radius: 0.1), at: Pixel(x: 8, y: 6), flux: 800)"#,
            &["wanted `:` before `Sphere`"],
        ),
        light(
            "Several mistakes in one light",
            r#""desk": Lamp(shape: Sphere(r: 0.1), at: Pixel(x: "8", y: 6), flux: yes, temp: 1)"#,
            &[
                "no field `r`",
                "without quotes: `8`",
                "`flux` wanted",
                "did you mean `temperature`?",
            ],
        ),
        light(
            "Mistakes in several lights",
            r#""lamp_0": Scale("2"), "window_0": Of, "inv_lmap": Off"#,
            &["without quotes: `2`", "did you mean `Off`?", "did you mean `inv_lamp`?"],
        ),
    ]
}

fn fields() -> Vec<Mistake> {
    vec![
        field("A misspelt field", "ligths: {}", &["did you mean `lights`?"]),
        field("A field of another program", "brightness: 2", &["unknown field `brightness`"]),
        field("A list for the lights", r#"lights: ["lamp_0"]"#, &["{ \"name\": value, .. }"]),
        field("Parentheses for the lights", r#"lights: (lamp_0: Off)"#, &["{ \"name\": value"]),
        field("A field twice", "lights: {}, lights: {}", &["given twice"]),
        field(
            "A surface that is not in a list",
            r##"materials: Paint(region: Grow(8, 6), albedo: Srgb("#c8642a"))"##,
            &["a list `[..]`"],
        ),
        field(
            "Positions with names",
            r##"materials: [Paint(region: Grow(x: 8, y: 6), albedo: Srgb("#c8642a"))]"##,
            &["write it without a name: `8`", "write it without a name: `6`"],
        ),
        field(
            "A position without names",
            r#"lights: {"desk": Lamp(shape: Sphere(radius: 0.06), at: Pixel(60, 40), flux: 800)}"#,
            &["write the names, too: `Pixel(x: 60, y: 40)`"],
        ),
        field(
            "A color by its name",
            r#"materials: [Paint(region: Grow(8, 6), albedo: Srgb("orange"))]"#,
            &["wanted a color like \"#c8642a\""],
        ),
        field(
            "A web color alone",
            r##"materials: [Paint(region: Grow(8, 6), albedo: "#c8642a")]"##,
            &["did you mean `Srgb(\"#c8642a\")`?"],
        ),
        field(
            "A color from 0 to 255",
            "materials: [Paint(region: Grow(8, 6), albedo: Linear(255, 128, 0))]",
            &["0..=1, got 255"],
        ),
        field(
            "A surface without a region",
            r##"materials: [Paint(albedo: Srgb("#c8642a"))]"##,
            &["a field `region`"],
        ),
        field(
            "A region outside of the photo",
            r##"materials: [Paint(region: Grow(80, 6), albedo: Srgb("#c8642a"))]"##,
            &["0..16 and 0..12"],
        ),
        field(
            "A mask that does not exist",
            r##"materials: [Paint(region: Mask("wall.png"), albedo: Srgb("#c8642a"))]"##,
            &["wall.png cannot be read: No such file"],
        ),
        field(
            "A region by its name",
            r##"materials: [Paint(region: Wall, albedo: Srgb("#c8642a"))]"##,
            &["`region` wanted `Mask(\"text\")` or `Grow(number, number)`"],
        ),
        field(
            "An object that does not exist",
            "objects: [Cube(at: Point(0, 0, -1))]",
            &["Sphere(", "got `Cube`"],
        ),
        field(
            "A model that does not exist",
            r#"objects: [Mesh(path: "chair.obj", at: Pixel(x: 8, y: 6), height: 1)]"#,
            &["chair.obj cannot be read"],
        ),
        field(
            "Keyframes in a single picture",
            r#"lights: { "lamp_0": Scale(Keys([(0, 1), (9, 0)])) }"#,
            &["frames: 48"],
        ),
        field(
            "A keyframe behind the end",
            r#"frames: 9, lights: { "lamp_0": Scale(Keys([(0, 1), (9, 0)])) }"#,
            &["up to 8, the last of 9, got 9"],
        ),
        field(
            "Keyframes without parentheses",
            r#"frames: 9, lights: { "lamp_0": Scale(Keys([0, 1])) }"#,
            &["wanted `(frame, value)`, got `0`"],
        ),
        field("No frames", "frames: 0", &["1 to 100000 frames, got `0`"]),
        field("Frames in quotes", "frames: \"48\"", &["frames, got `\"48\"`"]),
    ]
}

fn edits() -> Vec<Mistake> {
    vec![
        edit("JSON", r#"{"version": 1, "lights": {"lamp_0": "Off"}}"#, &["JSON?"]),
        edit("YAML", "version: 1\nlights:\n  lamp_0: Off\n", &["JSON, YAML and TOML are not read"]),
        edit("TOML", "version = 1\n[lights]\nlamp_0 = \"Off\"\n", &["are not read"]),
        edit("A list", "[Off]", &["wanted `Edit(..)`"]),
        edit("A scene in the place of the edit", SCENE, &["this is a scene", "--scene DIR"]),
        edit("A graph in the place of the edit", GRAPH, &["GRAPH and EDIT swapped?"]),
        edit("A misspelt first word", "Edits(version: 1)", &["did you mean `Edit`?"]),
        edit("No version", "Edit(lights: {})", &["write `version: 1,` first"]),
        edit("The version in quotes", r#"Edit(version: "1")"#, &["wanted version 1"]),
        edit("A missing parenthesis", "Edit(version: 1, lights: {}", &["`(` is never closed"]),
        edit("A missing brace", "Edit(version: 1, lights: { )", &["wanted `}`", "got `)`"]),
        edit("A bracket too many", "Edit(version: 1))", &["`)` closes nothing"]),
        edit("A comment with #", "Edit(\n    version: 1, # all\n)\n", &["begins with `//`"]),
        edit("A semicolon", "Edit(version: 1; lights: {})", &["wanted `,`"]),
        edit(
            "A missing comma",
            "Edit(\n    version: 1\n    lights: {},\n)\n",
            &["before `lights`"],
        ),
        edit("Two commas", "Edit(version: 1,, lights: {})", &["got a comma"]),
        edit("Text behind the end", "Edit(version: 1)\nthat is all\n", &["nothing more after"]),
        Mistake { placed: false, ..edit("An empty file", "", &["empty file"]) },
        Mistake { placed: false, ..edit("A photo in the place of the edit", "", &["a picture"]) }
            .file("edit.ron", photo(16, 12)),
        Mistake { placed: false, ..edit("A text in another encoding", "", &["UTF-8"]) }
            .file("edit.ron", b"Edit(version: 1) // gr\xfcn\n".to_vec()),
    ]
}

fn scenes() -> Vec<Mistake> {
    let depth = r#"(path: "depth.png", kind: PlanarZ, scale: 0.001)"#;
    vec![
        scene("A misspelt field", "photo:", "foto:", &["known: version, photo"]),
        scene("A photo without quotes", "\"photo.png\"", "photo.png", &["have quotes"]),
        scene("A photo that does not exist", "photo.png", "room.png", &["room.png cannot be read"]),
        scene(
            "Folders of Windows",
            "\"lamp_0.png\"",
            r#""masks\\lamp_0.png""#,
            &["masks/lamp_0.png"],
        ),
        scene(
            "A folder for a picture",
            "\"lamp_0.png\"",
            "\".\"",
            &["a regular file, got a folder"],
        ),
        scene("A field of view alone", "FovX(60)", "60", &["did you mean `FovX(60)`?"]),
        scene("A misspelt field of view", "FovX(60)", "Fov(60)", &["did you mean `FovX`?"]),
        scene("A field of view of 650", "FovX(60)", "FovX(650)", &["1..=175", "650"]),
        scene("Degrees with their sign", "FovX(60)", "FovX(60°)", &["angles are in degrees"]),
        scene(
            "A camera without its center",
            "FovX(60)",
            "Pinhole(fx: 14, fy: 14)",
            &["a field `cx`", "a field `cy`"],
        ),
        scene("A misspelt kind of depth", "PlanarZ", "Planar", &["did you mean `PlanarZ`?"]),
        scene("A kind of depth in quotes", "PlanarZ", "\"PlanarZ\"", &["without quotes"]),
        scene("Depth scaled by 0", "scale: 0.001", "scale: 0", &["depth: scale", "got 0"]),
        scene("A decimal comma", "scale: 0.001", "scale: 0,001", &["a decimal comma?"]),
        scene("Millimeters", "scale: 0.001", "scale: 1mm", &["write the number alone"]),
        scene(
            "A file of depth alone",
            depth,
            "\"depth.png\"",
            &["`depth` wanted `(path: \"text\""],
        ),
        scene("Depth without a file", r#"path: "depth.png", "#, "", &["a field `path`"]),
        scene("A misspelt encoding", "Srgb", "sRGB", &["did you mean `Srgb`?"]),
        scene("A gamma alone", "Srgb", "2.2", &["did you mean `Gamma(2.2)`?"]),
        scene("A kind of light in small letters", "Lamp(", "lamp(", &["did you mean `Lamp`?"]),
        scene("A mask alone", "Lamp(mask: \"lamp_0.png\")", "\"lamp_0.png\"", &["Lamp(mask: "]),
        scene(
            "A mask without its name",
            "mask: \"lamp_0.png\"",
            "\"lamp_0.png\"",
            &["Lamp(mask: "],
        ),
        scene("A light twice", "\"window_0\"", "\"lamp_0\"", &["given twice"]),
        scene("A reserved name", "\"lamp_0\"", "\"inv_lamp\"", &["reserved"]),
        scene("An exposure alone", "camera:", "exposure: 800, camera:", &["`Lux(800)`?"]),
        scene("A room of 270 cm", "camera:", "room: (height: 270), camera:", &["1.5..=20", "270"]),
        scene("A misspelt side", "camera:", "room: (lefft: 2), camera:", &["did you mean `left`?"]),
        Mistake { placed: false, ..scene("No camera", "camera: FovX(60),", "", &["no `camera`"]) },
    ]
}

fn graphs() -> Vec<Mistake> {
    let rays = "Transport(rays: 64)";
    vec![
        graph("A misspelt stage", "Transport(", "Transprot(", &["did you mean `Transport`?"]),
        graph("A misspelt parameter", "rays:", "ray:", &["did you mean `rays`?"]),
        graph("A fraction for a count", "64", "64.5", &["a whole number"]),
        graph("A count in quotes", "64", "\"64\"", &["without quotes: `64`"]),
        graph("A count of 0", "64", "0", &["rays", "got 0"]),
        graph("A stage without op", &format!("op: {rays}"), rays, &["op"]),
        graph(
            "A misspelt node of a wire",
            ")),",
            "), in: { \"mesh\": \"rom.mesh\" }),",
            &["`room`"],
        ),
        graph("A parent that does not exist", "physics", "fysics", &["fysics.ron"]),
        graph("An edit in the place of the graph", GRAPH, "Edit(version: 1)", &["swapped?"]),
        graph("Another version", "version: 1", "version: 2", &["wanted version 1, got 2"]),
    ]
}

fn pictures() -> Vec<Mistake> {
    let mut cut = photo(16, 12);
    cut.truncate(cut.len() / 2);
    let heic = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic".to_vec();
    let black = gray(16, 12, |_, _| 0);
    vec![
        picture("A text for a photo", "scene/photo.png", b"a photo".to_vec(), &["photo.png"]),
        picture("An empty photo", "scene/photo.png", vec![], &["photo.png"]),
        picture("A photo that is cut off", "scene/photo.png", cut, &["photo.png"]),
        picture("A HEIC under another name", "scene/photo.png", heic, &["HEIC", "heif-convert"]),
        picture("An empty mask", "scene/lamp_0.png", black.clone(), &["lamp_0.png"]),
        picture("Depth that is 0", "scene/depth.png", black, &["depth.png", "holes everywhere"]),
        picture(
            "A mask of another aspect ratio",
            "scene/lamp_0.png",
            gray(30, 12, |x, _| if x < 4 { 255 } else { 0 }),
            &["lamp_0.png", "30 x 12"],
        ),
        picture("A color photo for depth", "scene/depth.png", photo(16, 12), &["depth.png"]),
        picture("A text for depth", "scene/depth.png", b"1.0 2.0".to_vec(), &["depth.png"]),
        picture(
            "A mask that covers everything",
            "scene/window_0.png",
            gray(16, 12, |_, _| 255),
            &["window_0.png", "everything"],
        ),
    ]
}

fn lines() -> Vec<Mistake> {
    let run = |more: &str| format!("{CHECK} {more}");
    vec![
        line("GRAPH and EDIT swapped", "check edit.ron graph.ron --scene scene", &["swapped?"]),
        line("No graph", "run", &["<GRAPH>"]),
        line(
            "A graph that does not exist",
            "check grph.ron edit.ron",
            &["grph.ron: cannot be read"],
        ),
        line("A folder for the edit", "check graph.ron scene --scene scene", &["got a folder"]),
        line("No scene", "check graph.ron edit.ron", &["--scene DIR"]),
        line(
            "scene.ron for its folder",
            "check graph.ron edit.ron --scene scene/scene.ron",
            &["name the folder"],
        ),
        line(
            "A photo for the scene",
            "check graph.ron edit.ron --scene scene/photo.png",
            &["wanted a scene folder"],
        ),
        line(
            "A folder without a scene",
            "check graph.ron edit.ron --scene .",
            &["scene.ron", "relight new"],
        ),
        line("A misspelt command", "chek graph.ron", &["'check'"]),
        line("A misspelt option", &run("--sett scene.long_side=8"), &["'--set'"]),
        line("A setting without its node", &run("--set long_side=8"), &["NODE.PARAM=VALUE"]),
        line("A setting of another node", &run("--set sceen.long_side=8"), &["`scene`"]),
        line("A misspelt parameter", &run("--set scene.long_syde=8"), &["`long_side`"]),
        line("A setting with a unit", &run("--set scene.long_side=8px"), &["number alone"]),
        line("A setting with a decimal comma", &run("--set fit.sun_weight=0,5"), &["Write `0.5`"]),
        line(
            "A length of too few numbers",
            &run("--known-length 1,2,3=2"),
            &["212,80,212,395=2.03"],
        ),
        line("A frame of a single picture", &run("--frame 3"), &["wanted an edit with `frames`"]),
        line("A frame that is not a number", &run("--frame last"), &["a whole number from 0"]),
        line("An error of 150 %", &run("--target-error 150%"), &["above 0 and below 1"]),
        line("A budget without a unit", "run graph.ron edit.ron --budget 3", &["500ms"]),
        line("No threads", "run graph.ron edit.ron --threads 0", &["from 1 to 1024"]),
        line("A backend that does not exist", &run("--backend cuda"), &["rten"]),
        line("A folder of a run that is none", "mix scene --set lamp_0=0.5", &["picture.exr"]),
        line("A weight below 0", "mix scene --set lamp_0=-1", &["0 or more"]),
        line("A weight without its light", "mix scene --set 0.5", &["lamp_0=0.5"]),
        line("A report of a folder without a run", "report scene", &["scene"]),
        line("A report of no folder", "report nowhere", &["nowhere"]),
        line("USD by another name", "export graph.ron --scene scene --out room.usd", &[".usda"]),
        line(
            "A plan of a misspelt node",
            "plan graph.ron --scene scene --only wirte",
            &["`write`"],
        ),
        line("A stage that does not exist", "nodes Dirrect", &["Direct"]),
        line("A new scene without a folder", "new scene/photo.png", &["--out <DIR>"]),
        line("A new scene without a photo", "new nowhere.jpg --out room", &["nowhere.jpg"]),
        line("A new scene of a text", "new edit.ron --out room", &["edit.ron"]),
        line(
            "A camera at 150 cm",
            "new scene/photo.png --depth scene/depth.png --camera-height 150 --out room",
            &["centimeters", "`1.5`"],
        ),
        line(
            "A misspelt kind of depth",
            "new scene/photo.png --depth scene/depth.png --depth-kind disparty --out room",
            &["disparity"],
        ),
        line(
            "A decimal comma of a height",
            "new scene/photo.png --depth scene/depth.png --camera-height 1,5 --out room",
            &["as `1.5`"],
        ),
        line(
            "Depth that does not exist",
            "new scene/photo.png --depth scene/dpth.png --out room",
            &["dpth.png"],
        ),
        line(
            "A frame of a single photo",
            "new scene/photo.png --depth scene/depth.png --frame 3 --out room",
            &["the folder of a capture"],
        ),
        line("A capture of another kind", "new scene --out room", &["Polycam", "docs/new.md"]),
        line(
            "The unit of a depth that is missing",
            "new scene/photo.png --depth-scale 0.001 --out room",
            &["--depth FILE"],
        ),
        line(
            "A network that does not exist",
            "new scene/photo.png --depth-network nowhere.onnx --out room",
            &["nowhere.onnx"],
        ),
        line(
            "A folder of masks that does not exist",
            "new scene/photo.png --depth scene/depth.png --masks nowhere --out room",
            &["nowhere"],
        ),
        line(
            "A file where a folder is to be made",
            "new scene/photo.png --depth scene/depth.png --out edit.ron",
            &["edit.ron", "folder"],
        ),
        line(
            "An explanation of a misspelt node",
            "explain graph.ron edit.ron wirte --scene scene --no-cache",
            &["`write`"],
        ),
        line(
            "An explanation without a node",
            "explain graph.ron edit.ron --scene scene",
            &["GRAPH EDIT NODE"],
        ),
        line("A size with a unit", "cache gc --bytes 10GB", &["whole number"]),
        line("A misspelt action of the cache", "cache clean", &["clear"]),
        line("A benchmark of no graph", "bench nowhere.ron", &["nowhere.ron"]),
        line("A benchmark of an edit", "bench edit.ron", &["edit.ron", "wanted a graph"]),
        line("A measurement of no scene", "eval nowhere --graph graph.ron", &["nowhere"]),
        line(
            "A format that does not exist",
            &format!("graph{} --format pdf", &CHECK[5..]),
            &["svg"],
        ),
    ]
}

/// Mistakes in the places and the encoding of files.
fn places() -> Vec<Mistake> {
    let utf_16 = "\u{feff}Edit(version: 1)".encode_utf16().flat_map(u16::to_le_bytes);
    let confined = scene(
        "A file above the scene, confined",
        "\"photo.png\"",
        "\"../graph.ron\"",
        &["../graph.ron", "below"],
    );
    vec![
        Mistake::new("The edit file", "A text of another encoding", &["another encoding"])
            .file("edit.ron", utf_16.collect::<Vec<u8>>()),
        Mistake { line: format!("{CHECK} --confined"), ..confined },
        scene("A folder in place of a file", "\"photo.png\"", "\".\"", &["got a folder"]),
        scene("A field of view in radians", "FovX(60)", "FovX(0.9)", &["radians? Write `52`"]),
    ]
}

/// A byte order mark, which some editors write, is passed over.
#[test]
fn a_byte_order_mark_is_not_a_mistake() {
    let place = sound();
    for name in ["edit.ron", "graph.ron", "scene/scene.ron"] {
        let path = place.path().join(name);
        let text = std::fs::read_to_string(&path).expect("it is there");
        std::fs::write(&path, format!("\u{feff}{text}")).expect("it can be written");
    }
    let (status, out, message) = relight(place.path(), CHECK);
    assert_eq!((status, out.starts_with("valid")), (Some(0), true), "{message}");
}

fn photo(width: u32, height: u32) -> Vec<u8> {
    let pixel = |x, y| image::Rgb([10 * x as u8, 10 * y as u8, 90]);
    png(image::DynamicImage::from(image::RgbImage::from_fn(width, height, pixel)))
}

fn gray(width: u32, height: u32, value: impl Fn(u32, u32) -> u8) -> Vec<u8> {
    let pixel = |x, y| image::Luma([value(x, y)]);
    png(image::DynamicImage::from(image::GrayImage::from_fn(width, height, pixel)))
}

fn png(picture: image::DynamicImage) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, image::ImageFormat::Png).expect("a picture can be encoded");
    bytes.into_inner()
}

/// A folder with a sound graph, scene and edit.
fn sound() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let physics = std::fs::read(root.join("graphs/physics.ron")).expect("it is there");
    let depth = image::ImageBuffer::from_fn(16, 12, |x, _| image::Luma([2000 + 10 * x as u16]));
    std::fs::create_dir(folder.path().join("scene")).expect("a folder can be made");
    for (name, content) in [
        ("physics.ron", physics),
        ("graph.ron", GRAPH.into()),
        ("edit.ron", "Edit(version: 1)".into()),
        ("scene/scene.ron", SCENE.into()),
        ("scene/photo.png", photo(16, 12)),
        ("scene/depth.png", png(image::DynamicImage::from(depth))),
        ("scene/lamp_0.png", gray(16, 12, |x, y| if x < 4 && y < 4 { 255 } else { 0 })),
        ("scene/window_0.png", gray(16, 12, |x, y| if x > 11 && y < 6 { 255 } else { 0 })),
    ] {
        std::fs::write(folder.path().join(name), content).expect("a file can be written");
    }
    folder
}

/// Every file below a folder with its content.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).expect("it is a folder") {
        let path = entry.expect("it can be read").path();
        match path.is_dir() {
            true => found.extend(files(&path)),
            false => drop(found.insert(path.clone(), std::fs::read(&path).expect("it is there"))),
        }
    }
    found
}

/// Exit status, standard output and standard error of a command line in a folder.
fn relight(folder: &Path, line: &str) -> (Option<i32>, String, String) {
    let home = folder.join("home");
    let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
    command.current_dir(folder).args(line.split_whitespace()).env_remove("RELIGHT_LOG");
    command.env("HOME", &home).env_remove("XDG_CACHE_HOME").env_remove("XDG_CONFIG_HOME");
    let output = command.output().expect("the program starts");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("all messages are UTF-8");
    (output.status.code(), text(output.stdout), text(output.stderr))
}

/// Words of Rust and of its libraries.
const FORBIDDEN: [&str; 34] = [
    "f32",
    "f64",
    "u8",
    "u16",
    "u32",
    "u64",
    "i32",
    "i64",
    "usize",
    "Vec",
    "Vec2",
    "Vec3",
    "Option",
    "BTreeMap",
    "HashMap",
    "String",
    "str",
    "struct",
    "enum",
    "variant",
    "newtype",
    "tuple",
    "serde",
    "ron::",
    "deserialize",
    "panicked",
    "unwrap",
    "Err(",
    "Some(",
    "os error",
    "Expected",
    "Unexpected",
    "invalid type",
    "invalid digit",
];

/// The faults of a message.
fn faults(mistake: &Mistake, message: &str, stages: &str) -> Vec<String> {
    let mut faults = Vec::new();
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let words: Vec<&str> = message.split(|c| !is_word(c)).collect();
    for word in FORBIDDEN {
        let plain = word.chars().all(is_word);
        if if plain { words.contains(&word) } else { message.contains(word) } {
            faults.push(format!("the message contains `{word}`"));
        }
    }
    // A name such as `SettingValue` must be one that a person may write.
    let given = format!("{}{}", mistake.line, String::from_utf8_lossy(&mistake.file.1));
    for word in words {
        let mut capitals = word.char_indices().filter(|(_, c)| c.is_uppercase());
        let is_camel = word.starts_with(char::is_uppercase)
            && word.contains(char::is_lowercase)
            && capitals.nth(1).is_some()
            // The name of an application.
            && word != "Record3D";
        if is_camel && !stages.contains(word) && !given.contains(word) {
            faults.push(format!("`{word}` is not a word of files"));
        }
    }
    for wanted in &mistake.wanted {
        if !message.contains(wanted) {
            faults.push(format!("wanted {wanted:?}"));
        }
    }
    let file = mistake.file.0;
    let place = message.split(&format!("--> {file}:")).nth(1);
    let line_and_column = place.is_some_and(|place| {
        let mut numbers = place.lines().next().unwrap_or_default().split(':');
        let mut number = || numbers.next().is_some_and(|n| n.parse::<u32>().is_ok());
        number() && number()
    });
    if mistake.placed && !line_and_column {
        faults.push("wanted file, line and column".to_owned());
    }
    let name = file.rsplit('/').next().unwrap_or_default();
    if !message.contains(name) || !message.contains("error") {
        faults.push("wanted the name of the file".to_owned());
    }
    faults
}

#[test]
fn every_parameter_has_a_form() {
    let registry = relight::nodes::registry();
    let params =
        registry.kinds().flat_map(|kind| kind.params.iter().map(|param| (kind.kind, param)));
    let unknown = params.filter(|(_, param)| !param.form.is_known());
    let unknown: Vec<_> = unknown.map(|(kind, param)| format!("{kind}.{}", param.name)).collect();
    assert!(unknown.is_empty(), "{unknown:?}");
    let form = |kind: &str, name: &str| {
        let kind = registry.get(kind).expect("there is such a stage");
        kind.params.iter().find(|param| param.name == name).expect("it has it").form.to_string()
    };
    assert_eq!(
        form("ReadScene", "camera"),
        "`FovX(number) or Pinhole(fx: number, fy: number, cx: number, cy: number)`"
    );
    assert_eq!(form("ReadScene", "ignore"), "`\"text\"` or `None`");
    assert_eq!(form("ReadScene", "depth"), "`(path: \"text\", ..)`");
    assert_eq!(form("Transport", "rays"), "`whole number`");
}

fn all() -> Vec<Mistake> {
    [edits(), lights(), fields(), scenes(), places(), graphs(), pictures(), lines()]
        .into_iter()
        .flatten()
        .collect()
}

/// docs/mistakes.md of mistakes and their messages.
fn page(messages: &[(Mistake, String)]) -> String {
    let mut page = format!(
        "# Messages\n\n{} typical mistakes in files and arguments, and the message of each. Made by\n\
         `RELIGHT_BLESS=mistakes cargo test --release --test mistakes` from the program; do not edit.\n\
         Every file but the one with the mistake is sound, and nothing is computed or written.\n",
        messages.len()
    );
    let mut section = "";
    for (mistake, message) in messages {
        if section != mistake.section {
            section = mistake.section;
            page.push_str(&format!("\n## {section}\n"));
        }
        let command = if mistake.file.0.is_empty() {
            format!("$ relight {}\n", mistake.line)
        } else {
            String::new()
        };
        let lines = message.lines().filter(|line| !matches!(line.trim(), "" | "|"));
        let lines: String = lines.map(|line| format!("{}\n", line.trim_end())).collect();
        page.push_str(&format!("\n**{}**\n\n```text\n{command}{lines}```\n", mistake.what));
    }
    page
}

#[test]
fn each_typical_mistake_gets_a_message_to_act_on() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let place = sound();
    let (status, out, message) = relight(place.path(), CHECK);
    assert_eq!(status, Some(0), "the files are sound: {message}");
    assert!(out.starts_with("valid"), "{out}");

    // The names of stages, of their ports and of the parts of their parameters.
    let (_, stages, _) = relight(place.path(), "nodes --markdown");
    let form = std::fs::read_to_string(root.join("docs/files.md")).expect("it is there");
    let stages = stages + &form;
    let tried: Vec<(Mistake, String, Vec<String>)> = all()
        .into_par_iter()
        .map(|mistake| {
            let place = sound();
            let (name, content) = &mistake.file;
            if !name.is_empty() {
                std::fs::write(place.path().join(name), content).expect("it can be written");
            }
            let before = files(place.path());
            let (status, out, message) = relight(place.path(), &mistake.line);
            let mut faults = faults(&mistake, &message, &stages);
            if status != Some(2) {
                faults.push(format!("wanted status 2, got {status:?}"));
            }
            if !out.is_empty() {
                faults.push(format!("printed {out}"));
            }
            if files(place.path()) != before {
                faults.push("something was written".to_owned());
            }
            // The temporary folder has another name each time.
            let root = place.path().canonicalize().expect("it is there");
            let message = message.replace(&root.display().to_string(), "/home/me");
            (mistake, message, faults)
        })
        .collect();
    let bad: Vec<String> = tried
        .iter()
        .filter(|(.., faults)| !faults.is_empty())
        .map(|(mistake, message, faults)| {
            format!("## {}: {}\n{}\n{message}", mistake.section, mistake.what, faults.join("\n"))
        })
        .collect();
    assert!(bad.is_empty(), "{} of {}:\n{}", bad.len(), tried.len(), bad.join("\n"));
    assert!(tried.len() >= 100, "{} mistakes", tried.len());

    let messages: Vec<(Mistake, String)> =
        tried.into_iter().map(|(m, text, _)| (m, text)).collect();
    let (path, got) = (root.join("docs/mistakes.md"), page(&messages));
    if std::env::var("RELIGHT_BLESS").is_ok_and(|names| names.split(',').any(|n| n == "mistakes")) {
        std::fs::write(&path, &got).expect("the page can be written");
    }
    let page = std::fs::read_to_string(&path).unwrap_or_default();
    let differs = got.lines().zip(page.lines()).find(|(got, page)| got != page);
    assert!(
        got == page,
        "docs/mistakes.md differs, first in {differs:?}; look at it, then bless it (tests/mistakes.rs)"
    );
}
