//! The exported room, read back as text: its surface is the mesh, and its lights have the positions
//! and radiances of the run.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec3;
use relight::image::Points;
use relight::optics::{BoxLamp, Lamp, Radiance, RectLamp, Shape, SphereLamp};

use crate::project::*;

const EDIT: &str = r#"Edit(version: 1, lights: {
    "desk": Lamp(shape: Sphere(radius: 0.07), at: Point(0.1, -0.5, -2.9), radiance: (72, 44, 20)),
    "panel": Lamp(shape: Rect(half: (0.3, 0.2), normal: (0, -1, 0)), at: Point(0.2, 1.1, -3.0), radiance: (5, 4, 3)),
    "tube": Lamp(shape: Box(half: (0.3, 0.02, 0.05), yaw: 20), at: Point(0.2, 1.0, -3.0), radiance: (9, 9, 9)),
    "window_0": Scale(0.5),
})"#;

/// A `def` of USD text: its type, and its own attributes as `name = value`.
#[derive(Default, Debug)]
struct Prim {
    kind: String,
    fields: BTreeMap<String, String>,
}

/// Every prim by its path. Reads the project's own files: one entry a line, a brace alone on its
/// line.
fn prims(text: &str) -> BTreeMap<String, Prim> {
    let (mut all, mut path): (BTreeMap<String, Prim>, Vec<String>) = (BTreeMap::new(), Vec::new());
    let mut next = None;
    for line in text.lines().map(str::trim) {
        if let Some(head) = line.strip_prefix("def ") {
            let mut words = head.split_whitespace();
            let kind = words.next().expect("a def has a type").to_owned();
            let name = words.next().expect("a def has a name").trim_matches('"').to_owned();
            next = Some((kind, name));
        } else if line == "{" {
            let (kind, name) = next.take().expect("a brace follows a def");
            path.push(name);
            let old = all.insert(path.join("/"), Prim { kind, ..Prim::default() });
            assert!(old.is_none(), "{} stands there twice", path.join("/"));
        } else if line == "}" {
            path.pop().expect("as many braces are closed as opened");
        } else if let Some((name, value)) =
            line.split_once(" = ").filter(|_| !path.is_empty() && next.is_none())
        {
            let name = name.split_whitespace().last().expect("an entry has a name").to_owned();
            all.get_mut(&path.join("/"))
                .expect("it was opened")
                .fields
                .insert(name, value.to_owned());
        }
    }
    assert!(path.is_empty(), "every brace is closed");
    all
}

impl Prim {
    fn numbers(&self, field: &str) -> Vec<f32> {
        let text = &self.fields.get(field).unwrap_or_else(|| panic!("no {field} in {self:?}"));
        let text = text.split(" (interpolation").next().expect("split gives one");
        text.split(|c: char| "()[], ".contains(c))
            .filter(|t| !t.is_empty())
            .map(|t| t.parse().expect(t))
            .collect()
    }

    fn vectors(&self, field: &str) -> Vec<Vec3> {
        self.numbers(field).chunks_exact(3).map(Vec3::from_slice).collect()
    }

    /// intensity x color
    fn radiance(&self) -> Vec3 {
        self.numbers("inputs:intensity")[0] * self.vectors("inputs:color")[0]
    }

    /// Its axes and place.
    fn frame(&self) -> [Vec3; 4] {
        let rows = self.numbers("xformOp:transform");
        [0, 1, 2, 3].map(|row| Vec3::from_slice(&rows[4 * row..4 * row + 3]))
    }
}

#[test]
fn an_exported_room_is_the_room() {
    let outputs = ["usd", "room.points", "edit.shape", "edit.radiance"];
    let report = run(shared_engine(), &physics(&demo(), EDIT), &outputs);
    let files: Arc<relight::nodes::artifacts::Files> = one(&report, "usd");
    let names: Vec<&str> = files.0.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["room.usda", "room_albedo.png"]);
    let text = std::str::from_utf8(&files.0[0].1).expect("it is text");
    assert!(text.starts_with("#usda 1.0\n") && text.contains("@./room_albedo.png@"));
    let prims = prims(text);
    assert_eq!(png(&files.0[1].1).dimensions(), (320, 240));

    the_surface_is_the_mesh(&prims, &one::<Points>(&report, "room.points"));
    let shapes = many::<Shape>(&report, "edit.shape");
    let radiances: BTreeMap<String, Arc<Radiance>> =
        many(&report, "edit.radiance").into_iter().collect();
    for (id, shape) in &shapes {
        let w = &radiances[id].0;
        let prim = |id: &str| &prims[&format!("Room/Lights/{id}")];
        match &**shape {
            Shape::Absent => assert!(!prims.contains_key(&format!("Room/Lights/{id}")), "{id}"),
            _ if w.iter().all(|&w| w == Vec3::ZERO) => {
                assert!(!prims.contains_key(&format!("Room/Lights/{id}")), "{id} is off");
            }
            Shape::Lamp(Lamp::Sphere(SphereLamp { center, radius })) => {
                let light = prim(id);
                assert_eq!(
                    (light.kind.as_str(), light.numbers("inputs:radius")[0]),
                    ("SphereLight", *radius)
                );
                assert!(
                    light.frame()[3].abs_diff_eq(*center, 1e-6)
                        && light.radiance().abs_diff_eq(w[0], 1e-4)
                );
            }
            Shape::Lamp(Lamp::Rect(RectLamp { center, x, y })) => {
                is_rectangle(prim(id), [*center, *x, *y], w[0])
            }
            Shape::Lamp(Lamp::Box(BoxLamp { center, axes })) => {
                for k in 0..6 {
                    let side = prim(&format!("{id}_{k}"));
                    let [_, _, z, place] = side.frame();
                    // Lights shine along -z: outwards.
                    let out = place - *center;
                    assert!(
                        (out.length() - axes[k / 2].length()).abs() < 1e-5 && (-z).dot(out) > 0.0,
                        "{id}_{k}"
                    );
                    assert!(side.radiance().abs_diff_eq(w[0], 1e-4));
                }
            }
            Shape::Window(window) => {
                let light = prim(id);
                assert_eq!(light.vectors("relight:radiance"), *w, "the lobes are kept beside it");
                let sent: Vec3 = (0..3).map(|k| w[k] * shape.flux(k)).sum();
                let area = 4.0 * window.x.cross(window.y).length();
                // A sun of a seen window is a light of its own.
                let sun = prims.get(&format!("Room/Lights/{id}_sun"));
                let cosine =
                    |sun: &Prim| sun.frame()[2].dot(-window.x.cross(window.y).normalize()).max(0.0);
                let by_sun = sun.map_or(Vec3::ZERO, |sun| sun.radiance() * area * cosine(sun));
                let by_pane = light.radiance() * std::f32::consts::PI * area;
                // A narrow lobe through a pane: power = irradiance x area x cosine, to its width.
                assert!(
                    (by_pane + by_sun - sent).abs().max_element() <= 5e-3 * sent.max_element(),
                    "{id}: {by_pane} and {by_sun} of {sent}"
                );
                is_rectangle(light, [window.center, window.x, window.y], light.radiance());
            }
            Shape::Lamp(_) => panic!("{id}: no such lamp is made here"),
        }
    }
    assert!(shapes.len() >= 7, "visible, invisible and inserted lights");
}

fn is_rectangle(prim: &Prim, [center, x, y]: [Vec3; 3], radiance: Vec3) {
    assert_eq!(prim.kind, "RectLight");
    let [ex, ey, ez, place] = prim.frame();
    let close =
        |a: Vec3, b: Vec3| assert!(a.abs_diff_eq(b, 1e-4 * b.length().max(1.0)), "{a} for {b}");
    close(place, center);
    // Right-handed, and shining along -z to the side of x cross y.
    close(ex.cross(ey), ez);
    close(-ez, x.cross(y).normalize());
    close(ex * prim.numbers("inputs:width")[0], 2.0 * x);
    close(ey * prim.numbers("inputs:height")[0], -2.0 * y);
    close(prim.radiance(), radiance);
}

fn the_surface_is_the_mesh(prims: &BTreeMap<String, Prim>, points: &Points) {
    let surface = &prims["Room/Surface"];
    let corners = surface.vectors("points");
    let faces = surface.numbers("faceVertexIndices");
    assert!(
        faces.len() > 3 * 100_000 && faces.iter().all(|&corner| (corner as usize) < corners.len())
    );
    assert_eq!(surface.numbers("faceVertexCounts").len() * 3, faces.len());
    assert_eq!(surface.vectors("normals").len(), corners.len());
    let places = surface.numbers("primvars:st");
    let (width, height) = points.0.size();
    for (corner, st) in corners.iter().zip(places.chunks_exact(2)) {
        // The texture's pixel is the pixel that the corner was made of.
        let (x, y) = ((st[0] * width as f32) as usize, ((1.0 - st[1]) * height as f32) as usize);
        assert!(corner.abs_diff_eq(points.0.get(x, y), 1e-4), "{corner} at ({x}, {y})");
    }
    // A triangle's front looks at the camera.
    let away = faces.chunks_exact(3).filter(|t| {
        let [a, b, c] = [0, 1, 2].map(|k| corners[t[k] as usize]);
        (b - a).cross(c - a).dot(-a) <= 0.0
    });
    assert!(away.count() * 1000 < faces.len(), "counter-clockwise from the camera");
    let lamp = &prims["Room/lamp_0_seen"];
    assert_eq!(
        lamp.fields["visibility"], "\"invisible\"",
        "a burning lamp's own surface does not block it"
    );
}

#[test]
fn export_as_a_command() {
    let place = Place::new();
    place.write(
        "bare.ron",
        r#"Graph(version: 1, nodes: { "scene": (op: ReadScene()) }, outputs: ["scene.photo"])"#,
    );
    for (line, wanted) in [
        ("export bare.ron --scene DEMO", "wanted a graph with a stage WriteUsd, got none"),
        ("export GRAPHS/physics.ron --scene DEMO --out room.glb", "wanted NAME.usda"),
        ("export GRAPHS/physics.ron no.ron --scene DEMO", "no.ron"),
    ] {
        let message = place.check(line, 2);
        assert!(message.contains(wanted), "`relight {line}`: wanted {wanted:?}, got:\n{message}");
    }
    place.check(
        "export GRAPHS/physics.ron EDITS/lamp_off.ron --scene DEMO --out made/living.usda",
        0,
    );
    let text = std::fs::read_to_string(place.path("made/living.usda")).expect("it was written");
    let prims = prims(&text);
    assert!(!prims.contains_key("Room/Lights/lamp_0"), "off as the edit has it");
    let body = &prims["Room/lamp_0_seen"].fields["visibility"];
    assert_eq!(body, "\"inherited\"", "and its body stands in the room");

    // A package has the same files, as they are, each at a multiple of 64 bytes.
    place.check(
        "export GRAPHS/physics.ron EDITS/lamp_off.ron --scene DEMO --out made/living.usdz",
        0,
    );
    let package = std::fs::read(place.path("made/living.usdz")).expect("it was written");
    let number = |at: usize, bytes: usize| {
        package[at..at + bytes].iter().rev().fold(0, |sum, &byte| sum << 8 | usize::from(byte))
    };
    let mut at = 0;
    for (inside, beside) in [("room.usda", "living.usda"), ("room_albedo.png", "living_albedo.png")]
    {
        assert_eq!((&package[at..at + 4], number(at + 8, 2)), (&b"PK\x03\x04"[..], 0), "stored");
        let name = at + 30;
        let content = name + number(at + 26, 2) + number(at + 28, 2);
        let end = content + number(at + 18, 4);
        assert_eq!(content % 64, 0, "{inside}");
        assert_eq!(&package[name..name + inside.len()], inside.as_bytes());
        let file = std::fs::read_to_string(place.path(&format!("made/{beside}")));
        if let Ok(text) = file {
            let text = text.replace("living_albedo.png", "room_albedo.png");
            assert_eq!(std::str::from_utf8(&package[content..end]), Ok(&*text));
        }
        at = end;
    }

    // A sequence is one file.
    place.write(
        "fade.ron",
        r#"Edit(version: 1, frames: 5, lights: { "lamp_0": Scale(Keys([(1, 1), (3, 0)])) })"#,
    );
    place.check("export GRAPHS/physics.ron fade.ron --scene DEMO --fps 12 --out fade/room.usda", 0);
    let text = std::fs::read_to_string(place.path("fade/room.usda")).expect("it was written");
    for wanted in ["startTimeCode = 0", "endTimeCode = 4", "timeCodesPerSecond = 12"] {
        assert!(text.contains(wanted), "{wanted}");
    }
    let samples = |key: &str| {
        let line = text.lines().find(|line| line.trim().starts_with(key));
        line.unwrap_or_else(|| panic!("no {key}")).split_once("{ ").expect("samples").1.to_owned()
    };
    assert_eq!(
        samples("token visibility.timeSamples"),
        "0: \"invisible\", 2: \"invisible\", 3: \"inherited\" }"
    );
    let intensity = samples("float inputs:intensity.timeSamples");
    assert!(intensity.ends_with(", 3: 0 }") && intensity.matches(": ").count() == 4, "{intensity}");
    assert_eq!(text.matches(".timeSamples").count(), 2, "nothing else changes");

    // Paint of the edit is in the texture.
    place.write(
        "red.ron",
        r##"Edit(version: 1, materials: [Paint(region: Grow(160, 45), albedo: Srgb("#c00000"))])"##,
    );
    place.check("export GRAPHS/physics.ron red.ron --scene DEMO --out red/room.usda", 0);
    let texture = |name: &str| png(&std::fs::read(place.path(name)).expect("it was written"));
    let [old, new] = ["made/living_albedo.png", "red/room_albedo.png"].map(texture);
    let redder = |x: u32, y: u32| {
        let ([r, _, b], [old_r, _, old_b]) = (new.get_pixel(x, y).0, old.get_pixel(x, y).0);
        i32::from(r) - i32::from(b) > i32::from(old_r) - i32::from(old_b) + 60
    };
    assert!(redder(160, 45) && !redder(160, 230), "the wall, and not the floor");
}
