//! Small hostile files take little memory: each runs through the whole command, whose greatest
//! memory is measured.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Duration;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use needs::needs;

/// Most bytes of memory of a run on small files.
const MOST: u64 = 1_000_000_000;

struct Run {
    success: bool,
    message: String,
    /// Greatest memory of the process, in bytes.
    peak: u64,
}

/// Runs `relight run --only objects` on a room of 32 x 24 pixels with these files in it and these
/// objects. A process
/// that ends before its memory was read once, on a busy machine, is run again.
fn run(files: &[(&str, &[u8])], objects: &str) -> Run {
    (0..10)
        .find_map(|_| measured(files, objects))
        .expect("the system counts the memory of a process")
}

fn measured(files: &[(&str, &[u8])], objects: &str) -> Option<Run> {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = |name: &str| folder.path().join(name);
    let photo = image::RgbImage::from_pixel(32, 24, image::Rgb([90, 100, 110]));
    photo.save(path("photo.png")).expect("a picture can be written");
    let depth = image::ImageBuffer::from_pixel(32, 24, image::Luma([3000u16]));
    depth.save(path("depth.png")).expect("a picture can be written");
    let scene = r#"Scene(version: 1, photo: "photo.png", camera: FovX(60), depth: (path: "depth.png", scale: 0.001))"#;
    let edit = format!("Edit(version: 1, objects: [{objects}])");
    for (name, bytes) in
        files.iter().chain(&[("scene.ron", scene.as_bytes()), ("edit.ron", edit.as_bytes())])
    {
        std::fs::write(path(name), bytes).expect("a file can be written");
    }
    let graph = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("graphs/physics.ron");
    let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
    command.current_dir(folder.path()).arg("run").arg(graph);
    command.args([
        "edit.ron",
        "--scene",
        ".",
        "--only",
        "objects",
        "--no-cache",
        "--threads",
        "1",
        "--out",
        "out",
    ]);
    let mut child =
        command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the program starts");
    // The mark only rises, so that frequent reads miss only the last moments.
    let status = format!("/proc/{}/status", child.id());
    let mut peak = None;
    let exit = loop {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let mark = text.lines().find_map(|line| {
            line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB")?.parse::<u64>().ok()
        });
        peak = peak.max(mark.map(|kilobytes| 1024 * kilobytes));
        if peak.is_some_and(|peak| peak > 2 * MOST) {
            child.kill().expect("it can be stopped");
        }
        match child.try_wait().expect("it can be waited for") {
            Some(exit) => break exit,
            None => std::thread::sleep(Duration::from_millis(2)),
        }
    };
    let mut message = String::new();
    std::io::Read::read_to_string(&mut child.stderr.take().expect("it was piped"), &mut message)
        .expect("it is text");
    let run = Run { success: exit.success(), message, peak: peak? };
    println!("{} MB, {exit}", run.peak / 1_000_000);
    assert!(run.peak < MOST, "{} bytes of memory; it reported:\n{}", run.peak, run.message);
    Some(run)
}

fn object(file: &str) -> String {
    format!(r#"Mesh(path: "{file}", at: Point(0, -0.5, -2), height: 0.5),"#)
}

/// A PNG of 8192 x 8192 texels of one color: 200 kB.
fn large_texture() -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let pixels = image::RgbImage::from_pixel(8192, 8192, image::Rgb([200, 100, 50]));
    let encoder =
        PngEncoder::new_with_quality(&mut bytes, CompressionType::Level(6), FilterType::NoFilter);
    pixels.write_with_encoder(encoder).expect("it can be written");
    let bytes = bytes.into_inner();
    assert!(bytes.len() < 500_000, "{} bytes", bytes.len());
    bytes
}

/// A glTF of materials that all have one image, and one triangle for each.
fn textured(image: &str, materials: usize) -> String {
    let material = r#"{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}"#;
    let primitive = |i: usize| format!(r#"{{"attributes": {{"POSITION": 0}}, "material": {i}}}"#);
    let primitives: Vec<String> = (0..materials).map(primitive).collect();
    format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
        "meshes": [{{"primitives": [{}]}}], "materials": [{}], "textures": [{{"source": 0}}], "images": [{{"uri": "{image}"}}],
        "accessors": [{{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 36}}],
        "buffers": [{{"byteLength": 36, "uri": "triangle.bin"}}]}}"#,
        primitives.join(", "),
        vec![material; materials].join(", "),
    )
}

fn triangle() -> Vec<u8> {
    [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// Reason: each primitive was held against the limit alone, and 4 of 60 million positions took 9.0
/// GB.
#[needs("/proc/self/status")]
#[test]
fn primitives_on_one_accessor_of_zeros() {
    let primitive = r#"{"attributes": {"POSITION": 0}}"#;
    let gltf = format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
        "meshes": [{{"primitives": [{}]}}],
        "accessors": [{{"componentType": 5126, "count": 60000000, "type": "VEC3", "min": [0, 0, 0], "max": [0, 0, 0], "sparse":
            {{"count": 1, "indices": {{"bufferView": 0, "componentType": 5125}}, "values": {{"bufferView": 0}}}}}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 12}}],
        "buffers": [{{"byteLength": 12, "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAA"}}]}}"#,
        [primitive; 4].join(", ")
    );
    assert!(gltf.len() < 1000, "{} bytes", gltf.len());
    let run = run(&[("a.gltf", gltf.as_bytes())], &object("a.gltf"));
    assert!(
        !run.success && run.message.contains("positions of") && run.message.contains("a.gltf"),
        "{}",
        run.message
    );
}

/// Reason: it was decoded once for each material, to 12 bytes a texel: 7.0 GB.
#[needs("/proc/self/status")]
#[test]
fn one_large_texture_in_many_materials_of_a_gltf() {
    let (gltf, texture) = (textured("t.png", 8), large_texture());
    let files = [("a.gltf", gltf.as_bytes()), ("t.png", &texture), ("triangle.bin", &triangle())];
    let run = run(&files, &object("a.gltf"));
    assert!(run.success, "{}", run.message);
}

/// Reason: the same by a material library took 10.1 GB.
#[needs("/proc/self/status")]
#[test]
fn one_large_texture_in_many_materials_of_an_obj() {
    let (mut obj, mut library) =
        (String::from("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n"), String::new());
    for i in 0..8 {
        let _ = writeln!(obj, "usemtl m{i}\nf 1/1 2/1 3/1");
        let _ = writeln!(library, "newmtl m{i}\nKd 1 1 1\nmap_Kd t.png");
    }
    let files =
        [("a.obj", obj.as_bytes()), ("a.mtl", library.as_bytes()), ("t.png", &large_texture())];
    let run = run(&files, &object("a.obj"));
    assert!(run.success, "{}", run.message);
}

/// Many objects of one file share its texture.
#[needs("/proc/self/status")]
#[test]
fn many_objects_of_one_file() {
    let (gltf, texture) = (textured("t.png", 1), large_texture());
    let files = [("a.gltf", gltf.as_bytes()), ("t.png", &texture), ("triangle.bin", &triangle())];
    let run = run(&files, &object("a.gltf").repeat(12));
    assert!(run.success, "{}", run.message);
}

/// As many triangles as a small file may have, by nodes that share a mesh.
#[needs("/proc/self/status")]
#[test]
fn a_mesh_in_many_nodes() {
    let strip = 4000;
    let positions: Vec<u8> = (0..strip)
        .flat_map(|i| [i as f32, (i % 2) as f32, 0.0])
        .flat_map(|v: f32| v.to_le_bytes())
        .collect();
    let nodes = |count: usize| {
        let list: Vec<String> = (0..count).map(|i| i.to_string()).collect();
        let node = r#"{"mesh": 0}"#;
        format!(
            r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [{}]}}], "nodes": [{}],
            "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "mode": 5}}]}}],
            "accessors": [{{"bufferView": 0, "componentType": 5126, "count": {strip}, "type": "VEC3", "min": [0, 0, 0],
                "max": [1, 1, 1]}}],
            "bufferViews": [{{"buffer": 0, "byteLength": {bytes}}}], "buffers": [{{"byteLength": {bytes}, "uri": "s.bin"}}]}}"#,
            list.join(", "),
            vec![node; count].join(", "),
            bytes = positions.len(),
        )
    };
    let refused = |nodes: String, times: usize, wanted: &str| {
        let ran = run(
            &[("a.gltf", nodes.as_bytes()), ("s.bin", &positions)],
            &object("a.gltf").repeat(times),
        );
        assert!(
            !ran.success && ran.message.contains(wanted),
            "wanted {wanted:?}, got:\n{}",
            ran.message
        );
    };
    refused(nodes(530), 1, "wanted up to 20");
    refused(nodes(500), 2, "triangles of models with");
    let ran = run(&[("a.gltf", nodes(500).as_bytes()), ("s.bin", &positions)], &object("a.gltf"));
    assert!(ran.success, "{}", ran.message);
}
