//! Limits of a model: its memory stands in proportion to the bytes of its files.
//!
//! A glTF may repeat a mesh in many nodes, and an accessor of zeros or a texture of one color takes
//! hardly a byte, so that a small file could claim any amount of memory. Every count is checked
//! against these limits before an allocation.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::image::{NamedBytes, Texture};

/// Most triangles of a model.
const MOST_TRIANGLES: usize = 20_000_000;
/// Triangles that a model of any size may have, and the bytes that each further one takes: a strip
/// of 16-bit indices has two.
const FREE_TRIANGLES: usize = 2_000_000;
const BYTES_PER_TRIANGLE: usize = 2;
/// Most instances of parts of meshes in a glTF, and most groups of faces in an OBJ.
const MOST_PARTS: usize = 1_000_000;
/// Most other files that a model names.
pub const MOST_FILES: usize = 1000;
/// Decoded bytes that the textures of any model may take, two of 8192 x 8192 texels, and further
/// ones for each byte of their files: a JPEG of good quality decodes to about 20.
const FREE_TEXELS: u64 = 448 << 20;
const TEXELS_PER_BYTE: u64 = 32;

/// Most triangles of a model whose files have so many bytes.
pub fn most_triangles(bytes: usize) -> usize {
    (FREE_TRIANGLES + bytes / BYTES_PER_TRIANGLE).min(MOST_TRIANGLES)
}

/// Counts the parts of a model while it is read.
pub struct Budget {
    bytes: usize,
    parts: usize,
    positions: usize,
    triangles: usize,
}

impl Budget {
    /// For a model whose files have so many bytes.
    pub fn new(bytes: usize) -> Budget {
        Budget { bytes, parts: 0, positions: 0, triangles: 0 }
    }

    /// Counts one more part.
    ///
    /// # Errors
    /// When there are too many.
    pub fn part(&mut self) -> Result<(), String> {
        self.parts += 1;
        if self.parts <= MOST_PARTS {
            Ok(())
        } else {
            Err(format!("wanted up to {MOST_PARTS} parts, got more"))
        }
    }

    /// Counts triangles and positions, before memory is allocated for them.
    ///
    /// # Errors
    /// When all together are more than the files stand for.
    pub fn take(&mut self, positions: usize, triangles: usize) -> Result<(), String> {
        self.positions = self.positions.saturating_add(positions);
        self.triangles = self.triangles.saturating_add(triangles);
        let most = most_triangles(self.bytes);
        for (name, most, got) in
            [("positions", 3 * most, self.positions), ("triangles", most, self.triangles)]
        {
            if got > most {
                return Err(format!(
                    "wanted up to {most} {name} of {} bytes, got at least {got}",
                    self.bytes
                ));
            }
        }
        Ok(())
    }
}

/// The textures of a model by the names of their files: each is decoded once.
#[derive(Default)]
pub struct Textures {
    held: BTreeMap<String, Arc<Texture>>,
    held_bytes: u64,
    file_bytes: u64,
}

impl Textures {
    /// Returns the decoded texture of this file name, if it was read before.
    pub fn find(&self, name: &str) -> Option<Arc<Texture>> {
        self.held.get(name).cloned()
    }

    /// Decodes a texture and keeps it under its name; `warnings` receives the reader's warnings.
    ///
    /// # Errors
    /// The bytes are not a picture, or exceed the memory that textures may take.
    pub fn read(
        &mut self,
        name: &str,
        bytes: &[u8],
        warnings: &mut Vec<String>,
    ) -> Result<Arc<Texture>, String> {
        self.file_bytes += bytes.len() as u64;
        let room =
            (FREE_TEXELS + TEXELS_PER_BYTE * self.file_bytes).saturating_sub(self.held_bytes);
        let read = Texture::read(NamedBytes::new(name, bytes), room);
        let (texture, notes) = read.map_err(|e| {
            let others = match self.held.len() {
                0 => String::new(),
                count => format!(
                    " (beside {count} others of {} MiB; use smaller ones)",
                    self.held_bytes >> 20
                ),
            };
            format!("{name}: {}{others}", e.message())
        })?;
        warnings.extend(notes.iter().map(|w| format!("{name}: {w}")));
        self.held_bytes += texture.bytes() as u64;
        let texture = Arc::new(texture);
        self.held.insert(name.to_owned(), texture.clone());
        Ok(texture)
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::geometry::{Model, Skin, named_files};
    use crate::image::{Picture, Plane, Transfer, write_png};

    /// A glTF with a triangle in `triangle.bin`, and additional content.
    fn gltf(primitives: &str, accessors: &str, rest: &str) -> String {
        format!(
            r#"{{"asset": {{"version": "2.0"}}, "scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
            "meshes": [{{"primitives": [{primitives}]}}], "accessors": [{{"bufferView": 0, "componentType": 5126, "count": 3,
            "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}}{accessors}], "bufferViews": [{{"buffer": 0, "byteLength": 36}},
            {{"buffer": 0, "byteLength": 36, "byteStride": 4}}], "buffers": [{{"byteLength": 36, "uri": "triangle.bin"}}]{rest}}}"#
        )
    }

    const TRIANGLE: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    const PLAIN: &str = r#"{"attributes": {"POSITION": 0}}"#;

    /// Reads a model beside whose file lie a triangle and a texture; returns the requested names,
    /// too.
    fn read(name: &str, text: &str, library: &str) -> (Result<Model, String>, Vec<String>) {
        let mut asked = Vec::new();
        let model = Model::read(name, text.as_bytes(), &mut |name| {
            asked.push(name.to_owned());
            match name {
                "triangle.bin" => Ok(bytemuck::cast_slice(&TRIANGLE).to_vec()),
                "t.png" => Ok(write_png(
                    &Picture(Plane::filled(8, 4, Vec3::splat(0.5))),
                    Transfer::Srgb,
                    false,
                )),
                "a.mtl" => Ok(library.as_bytes().to_vec()),
                _ => Err(format!("there is no {name}")),
            }
        });
        (model, asked)
    }

    fn message(name: &str, text: &str) -> String {
        read(name, text, "")
            .0
            .err()
            .unwrap_or_else(|| panic!("{name}: a fault is wanted:\n{text:.200}"))
    }

    #[test]
    fn all_primitives_together_are_held_against_the_limit() {
        let accessor = r#", {"componentType": 5126, "count": 2000000, "type": "VEC3", "min": [0, 0, 0], "max": [0, 0, 0],
            "sparse": {"count": 1, "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 0}}}"#;
        let primitive = r#"{"attributes": {"POSITION": 1}}"#;
        let message = message("a.gltf", &gltf(&[primitive; 4].join(","), accessor, ""));
        assert!(
            message.contains("wanted up to 600")
                && message.contains("positions of")
                && message.contains("got at least"),
            "{message}"
        );
    }

    /// Reason: normals and texture coordinates were read to the end of their accessors, however
    /// many positions there are.
    #[test]
    fn normals_of_no_position_are_not_read() {
        let accessor = r#", {"componentType": 5126, "count": 4000000000, "type": "VEC3",
            "sparse": {"count": 1, "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 0}}}"#;
        let primitive = r#"{"attributes": {"POSITION": 0, "NORMAL": 1}}"#;
        let model = read("a.gltf", &gltf(primitive, accessor, ""), "").0.expect("it is sound");
        assert_eq!((model.positions.len(), model.normals.len()), (3, 3));
        let primitive = r#"{"attributes": {"POSITION": 0}, "indices": 1}"#;
        let message = message(
            "a.gltf",
            &gltf(primitive, &accessor.replace("VEC3", "SCALAR").replace("5126", "5125"), ""),
        );
        assert!(message.contains("triangles of"), "{message}");
    }

    /// Reason: each of these ended in a panic of the crate.
    #[test]
    fn accessors_that_are_not_what_they_should_be_are_told() {
        let accessor = |view: usize, kind: usize, shape: &str| {
            format!(
                r#", {{"bufferView": {view}, "componentType": {kind}, "count": 3, "type": "{shape}", "min": [0, 0, 0], "max": [0, 0, 0]}}"#
            )
        };
        let images = r#", "images": [{}]"#;
        for (primitive, accessors, rest, wanted) in [
            (r#"{"attributes": {"POSITION": 9}}"#, String::new(), "", "is not an accessor"),
            (
                r#"{"attributes": {"POSITION": 1}}"#,
                accessor(1, 5126, "VEC3"),
                "",
                "byteStride of at least 12, got 4",
            ),
            (
                r#"{"attributes": {"POSITION": 1}}"#,
                accessor(0, 5121, "VEC3"),
                "",
                "POSITION: wanted Vec3",
            ),
            (
                r#"{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}}"#,
                accessor(0, 5120, "VEC2"),
                "",
                "TEXCOORD: wanted Vec2",
            ),
            (
                r#"{"attributes": {"POSITION": 0}, "indices": 1}"#,
                accessor(0, 5126, "SCALAR"),
                "",
                "indices: wanted Scalar",
            ),
            (PLAIN, String::new(), images, "image 0: wanted a uri or a bufferView"),
        ] {
            let text = gltf(primitive, &accessors, rest);
            let message = message("a.gltf", &text);
            assert!(message.contains(wanted), "wanted {wanted:?}, got {message:?}");
            named_files("a.gltf", || Some(text.clone().into()), &|_| None);
        }
        assert!(message("a.gltf", &"{".repeat(600_000)).contains("JSON objects"));
    }

    /// Skins of a model share a texture that several of its materials name.
    fn check_shared(skins: &[Skin], count: usize, asked: &[String]) {
        let held: Vec<_> = skins.iter().filter_map(|skin| skin.color.as_ref()).collect();
        assert_eq!(held.len(), count);
        assert!(held.iter().all(|texture| Arc::ptr_eq(texture, held[0])));
        assert_eq!(asked.iter().filter(|name| *name == "t.png").count(), 1, "{asked:?}");
    }

    #[test]
    fn a_texture_of_many_materials_is_read_once() {
        let material = |i: usize| {
            format!(r#"{{"pbrMetallicRoughness": {{"baseColorTexture": {{"index": {i}}}}}}}"#)
        };
        let materials: Vec<String> = (0..8).map(|i| material(i % 2)).collect();
        let rest = format!(
            r#", "materials": [{}], "textures": [{{"source": 0}}, {{"source": 1}}],
            "images": [{{"uri": "t.png"}}, {{"uri": "t.png"}}]"#,
            materials.join(",")
        );
        let (model, asked) = read("a.gltf", &gltf(PLAIN, "", &rest), "");
        check_shared(&model.expect("it is sound").skins, 8, &asked);

        let library: String = (0..8).map(|i| format!("newmtl m{i}\nmap_Kd t.png\n")).collect();
        let (model, asked) =
            read("a.obj", "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", &library);
        check_shared(&model.expect("it is sound").skins, 8, &asked);
    }

    /// Reason: a library that is named ten thousand times was read as often, and its materials were
    /// kept as often.
    #[test]
    fn a_file_that_is_named_often_is_read_once() {
        let obj = format!(
            "{}v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n",
            "mtllib a.mtl\n".repeat(10_000)
        );
        let (model, asked) = read("a.obj", &obj, "newmtl a\nKd 0.5\n");
        let model = model.expect("it is sound");
        assert_eq!((asked.len(), model.skins.len()), (1, 1));
        // Reason: one number for all three ended in a panic of the crate.
        assert_eq!(model.skins[0].material.albedo, Vec3::splat(0.5));
        let beside = |_: &str| Some(b"newmtl a\nKd\n".to_vec());
        named_files("a.obj", || Some(obj.clone().into()), &|name| {
            beside(name).inspect(|_| assert!(name == "a.mtl"))
        });
        let buffers = [r#"{"byteLength": 36, "uri": "triangle.bin"}"#; 500].join(",");
        let one = r#"{"byteLength": 36, "uri": "triangle.bin"}"#;
        let (model, asked) = read("a.gltf", &gltf(PLAIN, "", "").replace(one, &buffers), "");
        assert!(model.is_ok() && asked.len() == 1, "{asked:?}");
    }

    #[test]
    fn materials_and_files_have_limits() {
        let library: String = (0..10_001).map(|i| format!("newmtl m{i}\n")).collect();
        let (model, _) =
            read("a.obj", "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", &library);
        let model = model.expect("it is drawn without its library");
        assert!(
            model.skins.is_empty() && model.warnings[0].contains("up to 10000 materials"),
            "{:?}",
            model.warnings
        );
        let buffers: Vec<String> =
            (0..1001).map(|i| format!(r#"{{"byteLength": 36, "uri": "{i}"}}"#)).collect();
        let text = gltf(PLAIN, "", "")
            .replace(r#"{"byteLength": 36, "uri": "triangle.bin"}"#, &buffers.join(","));
        let read = Model::read("a.gltf", text.as_bytes(), &mut |_| {
            Ok(bytemuck::cast_slice(&TRIANGLE).to_vec())
        });
        assert!(read.is_err_and(|message| message.contains("up to 1000 other files")));
        assert_eq!(
            named_files("a.gltf", || Some(text.into()), &|_| None).len(),
            1001,
            "the one too many is reported"
        );
    }

    #[test]
    fn textures_have_a_budget() {
        let bytes = write_png(&Picture(Plane::filled(64, 64, Vec3::ONE)), Transfer::Srgb, false);
        let mut textures = Textures { held_bytes: FREE_TEXELS - 1000, ..Textures::default() };
        // The file's own bytes stand for some of it.
        let room = 1000 + TEXELS_PER_BYTE * bytes.len() as u64;
        assert!(room < 64 * 64 * 3);
        let message = textures.read("t", &bytes, &mut Vec::new()).unwrap_err();
        assert!(
            message.contains("t: size in the header") && message.contains("64 x 64"),
            "{message}"
        );
        textures.held_bytes = FREE_TEXELS - 64 * 64 * 3;
        textures.read("t", &bytes, &mut Vec::new()).expect("there is room");
        assert_eq!(textures.held_bytes, FREE_TEXELS);
    }

    /// Reason: this index, times three and two more, is 1 in 64 bits; the crate then looked up a
    /// missing element.
    #[test]
    fn obj_indices_beyond_all_reason_are_told() {
        let message = message("a.obj", "v 0 0 0\nvn 0 0 1\nf 1//6148914691236517206 1//1 1//1\n");
        assert!(message.contains("line 3: wanted indices up to"), "{message}");
    }

    #[test]
    fn a_face_of_a_million_corners_is_read() {
        let face = format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nf {}\n", "1 2 3 ".repeat(333_333));
        let model = read("a.obj", &face, "").0.expect("it is sound");
        // Two of three have a corner twice.
        assert_eq!(model.triangles.len(), 333_333);
    }

    /// Reason: the elements of a PLY were held against the size of the file one kind at a time.
    #[test]
    fn elements_of_a_ply_are_held_against_the_file_together() {
        let ply = |encoding: &str, elements: &str, rest: &str| {
            format!("ply\nformat {encoding} 1.0\n{elements}end_header\n{rest}")
        };
        let many: String = (0..100).map(|i| format!("element e{i} 1000\n")).collect();
        assert!(message("a.ply", &ply("binary_little_endian", &many, "")).contains("elements `e"));
        let list = "element face 1\nproperty list uint uint vertex_indices\n";
        assert!(message("a.ply", &ply("binary_little_endian", list, "zzzz")).contains("PLY"));
        let wide: String = (0..50).map(|i| format!("property double p{i}\n")).collect();
        let message = message(
            "a.ply",
            &ply("binary_little_endian", &format!("element vertex 100\n{wide}"), "0"),
        );
        assert!(message.contains("100 elements `vertex`"), "{message}");
    }
}
