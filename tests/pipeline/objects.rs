//! Objects that are odd: a picture or a clear error, and soon.

use std::sync::Arc;

use glam::Vec3;
use relight::geometry::Objects;
use relight::image::Gloss;

use crate::bad_input::{check, room};
use crate::project::*;

/// A box, one unit high, ASCII PLY without normals.
const BOX: &str = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n\
    element face 6\nproperty list uchar int vertex_indices\nend_header\n\
    0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n1 0 1\n1 1 1\n0 1 1\n\
    4 3 2 1 0\n4 4 5 6 7\n4 0 1 5 4\n4 2 3 7 6\n4 1 2 6 5\n4 3 0 4 7\n";

/// A triangle that a glTF holds within itself, with this mesh, red and half a mirror.
fn gltf(accessor_count: usize, uri: &str) -> String {
    format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "material": 0}}]}}],
        "materials": [{{"pbrMetallicRoughness": {{"baseColorFactor": [1, 0, 0, 1], "metallicFactor": 0, "roughnessFactor": 1}}}}],
        "accessors": [{{"bufferView": 0, "componentType": 5126, "count": {accessor_count}, "type": "VEC3",
            "min": [0, 0, 0], "max": [1, 1, 0]}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 36}}], "buffers": [{{"byteLength": 36, "uri": "{uri}"}}]}}"#
    )
}

/// Corners (0 0 0), (1 0 0), (0 1 0).
const TRIANGLE: &str =
    "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";

fn place(edit: &str) -> Place {
    let place = room();
    place.write("edit.ron", format!("Edit(version: 1, objects: [ {edit} ])"));
    place.write("box.ply", BOX);
    place
}

#[test]
fn objects_of_every_kind() {
    let mesh = |path: &str, rest: &str| format!(r#"Mesh(path: "{path}", height: 0.3, {rest})"#);
    let stands = "at: Pixel(x: 20, y: 15)";
    for (edit, status, words) in [
        (mesh("box.ply", stands), 0, &[][..]),
        (
            mesh(
                "box.ply",
                "at: Pixel(x: 20, y: 15, lift: 0.1), yaw: 400, material: (metallic: 1)",
            ),
            0,
            &[],
        ),
        ("Sphere(radius: 0.2, at: Pixel(x: 20, y: 15))".into(), 0, &[]),
        (
            "Sphere(radius: 0.2, at: Point(0, 0, 0))".into(),
            0,
            &["warning", "object 0 encloses the camera"],
        ),
        (
            "Sphere(radius: 0.2, at: Point(0, 0, -9))".into(),
            0,
            &["warning", "object 0 is not visible"],
        ), // in the wall
        ("Sphere(radius: 0.2, at: Point(0, 0, 2))".into(), 0, &["object 0 is not visible"]), // behind the camera
        ("Sphere(radius: 0.2, at: Point(9, 0, -1))".into(), 0, &["object 0 is not visible"]), // beside the view
        ("Sphere(radius: 0.2, at: Point(1e6, 0, -1e7))".into(), 0, &["object 0 is not visible"]),
        ("Sphere(radius: 0.0005, at: Pixel(x: 20, y: 15))".into(), 0, &[]),
        ("Sphere(radius: 50, at: Point(0, 0, -51))".into(), 0, &[]),
        ("Sphere(radius: 50, at: Point(0, 0, 0))".into(), 0, &["encloses the camera"]),
        (mesh("box.ply", "at: Pixel(x: 7, y: 7)"), 0, &[]), // on the lamp's own pixels
        (
            "Sphere(radius: 0.2, at: Point(0, 0, -1)), Sphere(radius: 0.2, at: Point(0.1, 0, -1))"
                .into(),
            0,
            &[],
        ),
        (mesh("box.ply", "at: Pixel(x: 40, y: 15)"), 2, &["objects", "outside the photo"]),
        ("Sphere(radius: -1, at: Point(0, 0, -1))".into(), 2, &["edit.ron", "radius", "got -1"]),
        ("Sphere(radius: 1e9, at: Point(0, 0, -1))".into(), 2, &["edit.ron", "radius"]),
        (
            "Sphere(radius: 1, at: Point(0, 0, -1), material: (roughness: 2))".into(),
            2,
            &["roughness", "got 2"],
        ),
        (
            r#"Sphere(radius: 1, at: Point(0, 0, -1), material: (albedo: Srgb("red")))"#.into(),
            2,
            &["red"],
        ),
        (mesh("bix.ply", stands), 2, &["edit.ron", "bix.ply", "cannot be read"]),
        (mesh("photo.png", stands), 2, &["photo.png", "wanted a model that ends in"]),
    ] {
        check(&place(&edit), &edit, status, words);
    }
}

#[test]
fn models_of_every_kind() {
    let model = |name: &str, bytes: &[u8], status: i32, words: &[&str]| {
        let place =
            place(&format!(r#"Mesh(path: "{name}", at: Pixel(x: 20, y: 15), height: 0.3)"#));
        place.write(name, bytes);
        check(&place, &format!("{name}, {words:?}"), status, words);
    };
    let sound = gltf(3, TRIANGLE);
    model("a.gltf", sound.as_bytes(), 0, &[]);
    model("a.gltf", gltf(4, TRIANGLE).as_bytes(), 2, &["a.gltf", "wanted a valid glTF file"]);
    model("a.gltf", gltf(4_000_000_000, TRIANGLE).as_bytes(), 2, &["a.gltf", "4000000000"]);
    model(
        "a.gltf",
        gltf(3, &TRIANGLE[..60]).as_bytes(),
        2,
        &["a.gltf", "wanted a valid glTF file"],
    );
    model("a.gltf", gltf(3, "gone.bin").as_bytes(), 2, &["edit.ron", "gone.bin", "cannot be read"]);
    model("a.gltf", gltf(3, "box.ply").as_bytes(), 2, &["a.gltf"]); // a file, of other bytes
    model(
        "a.gltf",
        &sound.as_bytes()[..sound.len() / 2],
        2,
        &["a.gltf", "wanted a valid glTF file"],
    );
    model(
        "a.glb",
        b"glTF\x02\0\0\0\x14\0\0\0\xff\xff\xff\xffJSON",
        2,
        &["a.glb", "wanted a valid glTF file"],
    );
    model("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", 0, &[]);
    model(
        "a.obj",
        b"v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n",
        2,
        &["a.obj", "wanted a model with a height"],
    );
    model("a.obj", b"", 2, &["a.obj", "wanted triangles", "got none"]);
    model("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n", 2, &["a.obj"]);
    model("a.ply", &BOX.as_bytes()[..BOX.len() - 20], 2, &["a.ply", "wanted a valid PLY file"]);
    model(
        "a.ply",
        BOX.replace("1 1 1", "nan 1 1").as_bytes(),
        2,
        &["a.ply", "wanted a valid PLY file"],
    );
    model("a.obj", b"v 0 nan 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", 2, &["a.obj", "finite", "vertex 0"]);
    let flat = BOX.replace("4 3 2 1 0", "4 3 3 3 3");
    model("a.ply", flat.as_bytes(), 0, &["warning", "2 of 12 triangles have no area"]);
}

/// A material decides whether an object reflects: neither names of files nor comments of the edit
/// do.
#[test]
fn only_shiny_objects_run_insert_specular() {
    let stands = "at: Pixel(x: 20, y: 15), height: 0.3";
    let mesh =
        |material: &str| format!(r#"Mesh(path: "materials/chair.gltf", {stands}{material})"#);
    let ball = |material: &str| format!("Sphere(radius: 0.1, at: Pixel(x: 20, y: 15){material})");
    let dull = gltf(3, TRIANGLE);
    let shiny = dull.replace(r#""roughnessFactor": 1"#, r#""roughnessFactor": 0.3"#);
    for (edit, model, wanted) in [
        (mesh(""), &dull, false),
        (mesh(""), &shiny, true),
        (mesh(", material: (roughness: 1)"), &shiny, false),
        (mesh(", material: (metallic: 1)"), &dull, true),
        (ball(" /* roughness: 0.1, metallic: 1 */"), &dull, false),
        (ball(", material: (roughness: 1.0, metallic: 0.0)"), &dull, false),
        (ball(", material: (roughness: 0.9)"), &dull, true),
        (format!("{}, {}", ball(""), ball(", material: (metallic: 0.5)")), &dull, true),
    ] {
        let place = place(&edit);
        std::fs::create_dir(place.path("materials")).expect("a folder can be made");
        place.write("materials/chair.gltf", model);
        let graph =
            load(&root().join("graphs/physics.ron"), &place.path(""), &place.path("edit.ron"));
        let graph = graph.unwrap_or_else(|faults| panic!("{}", faults[0]));
        let report = run(shared_engine(), &graph, &["reflected"]);
        assert!(report.is_complete());
        assert_eq!(report.nodes.iter().any(|node| node.kind == "InsertSpecular"), wanted, "{edit}");
    }
}

/// A library of materials is part of its model: another one is another object; without one, or a
/// picture, there is a warning.
#[test]
fn an_obj_comes_with_its_library() {
    let triangle = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n";
    let folder = place(r#"Mesh(path: "a.obj", at: Pixel(x: 20, y: 15), height: 0.6)"#);
    folder.write("a.obj", triangle);
    let albedo = || {
        let graph =
            load(&root().join("graphs/physics.ron"), &folder.path(""), &folder.path("edit.ron"));
        let graph = graph.unwrap_or_else(|faults| panic!("{}", faults[0]));
        let report = run(shared_engine(), &graph, &["objects.objects"]);
        let objects: Arc<Objects> = one(&report, "objects.objects");
        let middle = (0..objects.coverage.len())
            .find(|&i| objects.coverage.pixels()[i] == 1.0)
            .expect("it is seen");
        (objects.albedo.pixels()[middle], objects.gloss.pixels()[middle])
    };
    check(&folder, "no library", 0, &["warning", "a.mtl", "are not known"]);
    assert_eq!(
        albedo(),
        (Vec3::splat(0.7), Gloss { roughness: 1.0, specular: 0.5, metallic: 0.0 })
    );
    for (kd, rough) in [(Vec3::new(0.5, 0.25, 0.125), 0.5), (Vec3::new(0.125, 0.25, 0.5), 1.0)] {
        let ks = if rough < 1.0 { 0.5 } else { 0.0 };
        folder.write(
            "a.mtl",
            format!("newmtl m\nKd {} {} {}\nKs {ks} {ks} {ks}\nNs 30\n", kd.x, kd.y, kd.z),
        );
        let (color, gloss) = albedo();
        assert!(
            (color - kd).abs().max_element() < 1e-5 && (gloss.roughness - rough).abs() < 1e-5,
            "{color} {gloss:?}"
        );
    }
    folder.write("a.mtl", "newmtl m\nKd 0.5 0.5 0.5\nmap_Kd gone.png\nd 0.5\n");
    check(&folder, "no picture", 0, &["warning", "gone.png", "map_Kd is not used", "not used: d"]);
    folder.write("gone.png", "this is no picture");
    check(&folder, "a bad picture", 2, &["a.obj", "gone.png"]);
    folder.write("a.mtl", "newmtl m\nKd one two three\n");
    check(&folder, "a bad library", 0, &["warning", "wanted a valid material library, a.mtl"]);
}

/// The same files as lamps.
#[test]
fn lamps_of_every_model() {
    let model = |name: &str, bytes: &[u8], more: &str, status: i32, words: &[&str]| {
        let place = room();
        place.write(name, bytes);
        let lamp = format!(
            r#"Lamp(shape: Mesh(path: "{name}", height: 0.2{more}), at: Pixel(x: 20, y: 15), flux: 500)"#
        );
        place.write("edit.ron", format!(r#"Edit(version: 1, lights: {{ "desk": {lamp} }})"#));
        check(&place, &format!("{name}, {words:?}"), status, words);
    };
    model("a.ply", BOX.as_bytes(), "", 0, &[]);
    model("a.ply", BOX.as_bytes(), ", yaw: 400", 0, &[]);
    model("a.gltf", gltf(3, TRIANGLE).as_bytes(), "", 0, &[]); // an open sheet
    model(
        "a.gltf",
        gltf(3, "gone.bin").as_bytes(),
        "",
        2,
        &["edit.ron", "gone.bin", "cannot be read"],
    );
    model(
        "a.obj",
        b"v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n",
        "",
        2,
        &["a.obj", "wanted a model with a height"],
    );
    model("a.obj", b"", "", 2, &["a.obj", "wanted triangles", "got none"]);
    model(
        "a.obj",
        b"v 0 nan 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "",
        2,
        &["a.obj", "finite", "vertex 0"],
    );
    let flat = BOX.replace("4 3 2 1 0", "4 3 3 3 3");
    model("a.ply", flat.as_bytes(), "", 0, &["warning", "2 of 12 triangles have no area"]);
    // A flat grid of a million and more.
    let (rows, columns) = (501, 1001);
    let mut grid = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        (rows + 1) * (columns + 1),
        rows * columns
    )
    .into_bytes();
    for (y, x) in (0..=rows).flat_map(|y| (0..=columns).map(move |x| (y, x))) {
        [x as f32, y as f32, 0.0].iter().for_each(|v| grid.extend(v.to_le_bytes()));
    }
    for (y, x) in (0..rows).flat_map(|y| (0..columns).map(move |x| (y, x))) {
        let corner = |dx: i32, dy: i32| (y + dy) * (columns + 1) + x + dx;
        grid.push(4);
        [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)]
            .iter()
            .for_each(|i| grid.extend(i.to_le_bytes()));
    }
    model(
        "a.ply",
        &grid,
        "",
        2,
        &["a.ply", "wanted up to 1000000 triangles for a lamp, got 1003002"],
    );
}

/// The edit that ships: pixels far from the objects stay, objects are at their positions, and the
/// table loses light beside them.
#[test]
fn insert_object_changes_the_table_and_leaves_the_ceiling() {
    let graph =
        load(&root().join("graphs/physics.ron"), &demo(), &edits().join("insert_object.ron"));
    let graph = graph.unwrap_or_else(|faults| panic!("{}", faults[0]));
    let picture = png(&written(&run(shared_engine(), &graph, &[]), "picture.png"));
    let before = photo();
    let mean = |of: &image::RgbImage, x: u32, y: u32| {
        let around = (y - 2..y + 3).flat_map(|y| (x - 2..x + 3).map(move |x| (x, y)));
        around
            .map(|(x, y)| of.get_pixel(x, y).0.iter().map(|&c| f64::from(c)).sum::<f64>() / 75.0)
            .sum::<f64>()
    };
    let change = |x, y| mean(&picture, x, y) - mean(&before, x, y);
    assert!(change(160, 15).abs() < 2.0, "the ceiling changes by {}", change(160, 15));
    assert!(change(178, 166) > 40.0, "the ball is light, the table dark: {}", change(178, 166));
    assert!(
        change(186, 177) < -1.5,
        "beside the ball the table gets less light: {}",
        change(186, 177)
    );
}

/// A ball before a wall that is painted in the same edit: the wall is as without the ball up to its
/// edge, and its red comes to the ball.
#[test]
fn a_painted_wall_colors_the_ball_before_it() {
    let paint = r##"materials: [ Paint(region: Grow(125, 70), albedo: Srgb("#b02020")) ]"##;
    let ball = "objects: [ Sphere(radius: 0.25, at: Point(-0.75, 0.1, -4.2)) ]";
    let picture = |edit: &str| {
        let graph = physics(&demo(), &format!("Edit(version: 1, {edit})"));
        png(&written(&run(shared_engine(), &graph, &[]), "picture.png"))
    };
    let [painted, object, both] =
        [paint.to_owned(), ball.to_owned(), format!("{paint}, {ball}")].map(|e| picture(&e));
    let mean = |of: &image::RgbImage, x: u32, y: u32| {
        let around = || (y - 1..y + 2).flat_map(|y| (x - 1..x + 2).map(move |x| (x, y)));
        [0, 1, 2]
            .map(|c| around().map(|(x, y)| f64::from(of.get_pixel(x, y).0[c])).sum::<f64>() / 9.0)
    };
    let (wall, shown) = (mean(&painted, 135, 113), mean(&both, 135, 113));
    let apart = |a: [f64; 3], b: [f64; 3]| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f64::max);
    assert!(
        apart(wall, shown) < 3.0 && apart(shown, mean(&object, 135, 113)) > 50.0,
        "{wall:?} {shown:?}"
    );
    // The rim of the ball faces the wall; its front faces the room behind the camera.
    let reddish = |of: &image::RgbImage| mean(of, 123, 113)[0] / mean(of, 123, 113)[1];
    assert!(reddish(&both) > 1.01 * reddish(&object), "{} {}", reddish(&both), reddish(&object));
}

/// The balls that ship: one shows bright window and dark furniture side by side, the other a light
/// on its red; pixels far from them stay.
#[test]
fn mirror_shows_the_room() {
    let graph = load(&root().join("graphs/demo.ron"), &demo(), &edits().join("mirror.ron"));
    let graph = graph.unwrap_or_else(|faults| panic!("{}", faults[0]));
    let picture = png(&written(&run(shared_engine(), &graph, &[]), "picture.png"));
    let part = |x: std::ops::Range<u32>, y: std::ops::Range<u32>| -> Vec<[u8; 3]> {
        y.flat_map(|y| x.clone().map(move |x| (x, y)))
            .map(|(x, y)| picture.get_pixel(x, y).0)
            .collect()
    };
    let green = part(80..105, 175..200).into_iter().map(|c| c[1]);
    let (dark, bright) = green.fold((255, 0), |(dark, bright), g| (g.min(dark), g.max(bright)));
    assert!(dark < 60 && bright > 240, "{dark} to {bright}");
    let ball = part(205..225, 182..206);
    let red = ball.iter().filter(|c| u16::from(c[0]) > 2 * u16::from(c[1])).count();
    assert!(2 * red > ball.len(), "{red} of {} pixels are red", ball.len());
    assert!(ball.iter().any(|c| c[1] > 150), "the lamp shines in it");
    assert!(picture.get_pixel(160, 15).0[0].abs_diff(photo().get_pixel(160, 15).0[0]) <= 3);
}

/// A glTF's files stand in the key: a change of one is seen.
#[test]
fn files_that_a_model_names_are_watched() {
    let place = place(r#"Mesh(path: "models/a.gltf", at: Pixel(x: 20, y: 15), height: 0.3)"#);
    std::fs::create_dir(place.path("models")).expect("a folder can be made");
    place.write("models/a.gltf", gltf(3, "a%20b.bin"));
    let corners = |x: f32| {
        [[0.0, 0.0, 0.0], [x, 0.0, 0.0], [0.0, 1.0, 0.0]]
            .concat()
            .into_iter()
            .flat_map(f32::to_le_bytes)
    };
    place.write("models/a b.bin", corners(1.0).collect::<Vec<u8>>());
    let line = "run GRAPHS/physics.ron edit.ron --scene . --cache cache --out out -v";
    place.check(line, 0);
    assert!(!place.check(line, 0).contains(" ran "), "nothing changed");
    place.write("models/a b.bin", corners(2.0).collect::<Vec<u8>>());
    assert!(place.check(line, 0).contains("objects"), "the file changed");
}

/// A quarter of a million quads: a bumpy ball, binary.
#[test]
fn a_million_triangles_take_seconds() {
    let (rows, columns) = (500usize, 1000usize);
    let head = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
        element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        (rows + 1) * columns,
        rows * columns
    );
    let mut bytes = head.into_bytes();
    for i in 0..(rows + 1) * columns {
        let (theta, phi) = (
            (i / columns) as f32 / rows as f32 * std::f32::consts::PI,
            (i % columns) as f32 / columns as f32 * std::f32::consts::TAU,
        );
        let r = 1.0 + 0.02 * (20.0 * theta).sin() * (20.0 * phi).sin();
        for v in [r * theta.sin() * phi.cos(), r * theta.cos(), r * theta.sin() * phi.sin()] {
            bytes.extend(v.to_le_bytes());
        }
    }
    for i in 0..rows * columns {
        let (row, column) = (i / columns, i % columns);
        let next = (column + 1) % columns;
        let quad = [
            row * columns + column,
            row * columns + next,
            (row + 1) * columns + next,
            (row + 1) * columns + column,
        ];
        bytes.push(4);
        quad.iter().for_each(|&v| bytes.extend((v as i32).to_le_bytes()));
    }
    let place = place(r#"Mesh(path: "ball.ply", at: Pixel(x: 20, y: 20), height: 0.5)"#);
    place.write("ball.ply", bytes);
    check(&place, "a million triangles", 0, &[]);
    let report = std::fs::read(place.path("out/report.json")).expect("the run wrote its report");
    let report: serde_json::Value = serde_json::from_slice(&report).expect("it is JSON");
    let nodes = report["nodes"].as_array().expect("the report lists nodes");
    let objects = nodes.iter().find(|node| node["name"] == "objects").expect("objects were read");
    let seconds = objects["seconds"].as_f64().expect("a number");
    // On two idle cores it takes about one; a step that is not linear in the triangles would take
    // many minutes.
    assert!(seconds < 20.0, "{seconds} s to read and place the triangles");
}
