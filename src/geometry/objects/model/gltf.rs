//! glTF 2.0: `.gltf` with its files beside it or within, and `.glb`.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::rc::Rc;
use std::sync::Arc;

use base64::Engine;
use glam::{Mat3, Mat4, Vec2, Vec3};
use gltf::accessor::{Accessor, DataType, Dimensions};
use gltf::json::validation::Checked;
use gltf::mesh::{Mode, Semantic};

use super::{Budget, Material, Model, ReadPart, SHOWN, Skin, Textures};
use crate::image::Texture;

/// Most objects in the JSON of a glTF; each takes some 500 bytes in memory, also where it is two in
/// the file.
const MOST_OBJECTS: usize = 500_000;
fn bad(e: impl std::fmt::Display) -> String {
    let message: String = e.to_string().chars().take(SHOWN).collect();
    format!("wanted a valid glTF file: {message}")
}

/// The JSON and the binary chunk of a file: checked, so that the crate's accessors do not panic on
/// it.
fn document(bytes: &[u8]) -> Result<(gltf::Document, Option<Vec<u8>>), String> {
    let glb = if bytes.starts_with(b"glTF") {
        Some(gltf::Glb::from_slice(bytes).map_err(bad)?)
    } else {
        None
    };
    let json = glb.as_ref().map_or(bytes, |glb| &glb.json);
    let objects = json.iter().filter(|&&byte| byte == b'{').count();
    if objects > MOST_OBJECTS {
        return Err(bad(format!("wanted up to {MOST_OBJECTS} JSON objects, got {objects}")));
    }
    let mut json: gltf::json::Root = gltf::json::deserialize::from_slice(json).map_err(bad)?;
    // The crate looks these up before it has checked them.
    for (index, primitive) in json.meshes.iter().flat_map(|mesh| &mesh.primitives).enumerate() {
        let positions = primitive.attributes.get(&Checked::Valid(Semantic::Positions));
        if positions.is_some_and(|accessor| accessor.value() >= json.accessors.len()) {
            return Err(bad(format!("primitive {index}: its POSITION is not an accessor")));
        }
    }
    for (index, image) in json.images.iter_mut().enumerate() {
        if image.buffer_view.is_none() && image.uri.is_none() {
            return Err(bad(format!("image {index}: wanted a uri or a bufferView, got neither")));
        }
        // The content determines the format.
        image.mime_type.get_or_insert_with(|| gltf::json::image::MimeType(String::new()));
    }
    let document = gltf::Document::from_json(json).map_err(bad)?;
    Ok((document, glb.and_then(|glb| glb.bin).map(Cow::into_owned)))
}

/// The files that a `.gltf` names, as it names them, percent-decoded; none when it cannot be read.
pub fn named_files(bytes: &[u8]) -> Vec<String> {
    let Ok((document, _)) = document(bytes) else { return Vec::new() };
    let buffers = document.buffers().filter_map(|buffer| match buffer.source() {
        gltf::buffer::Source::Uri(uri) => Some(uri),
        gltf::buffer::Source::Bin => None,
    });
    let images = document.images().filter_map(|image| match image.source() {
        gltf::image::Source::Uri { uri, .. } => Some(uri),
        gltf::image::Source::View { .. } => None,
    });
    super::distinct(
        buffers.chain(images).filter(|uri| !uri.starts_with("data:")).map(decoded).collect(),
    )
}

fn decoded(uri: &str) -> String {
    percent_encoding::percent_decode_str(uri).decode_utf8_lossy().into_owned()
}

/// The bytes of a `data:` address or of a file.
fn content(uri: &str, part: ReadPart) -> Result<Vec<u8>, String> {
    match uri.strip_prefix("data:").and_then(|data| data.split_once(',')) {
        Some((kind, text)) if kind.ends_with(";base64") => {
            base64::engine::general_purpose::STANDARD
                .decode(text)
                .map_err(|e| format!("wanted a valid glTF file: data address: {e}"))
        }
        _ => part(&decoded(uri)),
    }
}

/// Reads a model from glTF or GLB; `part` returns the content of the files that it names.
///
/// # Errors
/// The file or one of its parts cannot be used; the message states the wanted and the actual
/// content.
pub fn read(bytes: &[u8], part: ReadPart) -> Result<Model, String> {
    let (document, blob) = document(bytes)?;
    let mut files = BTreeMap::new();
    let buffers = read_buffers(&document, blob, part, &mut files)?;
    let mut budget =
        Budget::new(bytes.len() + files.values().map(|data| data.len()).sum::<usize>());
    let mut model = Model::default();
    let mut textures = Textures::default();
    let mut texture = |texture: gltf::Texture, warnings: &mut Vec<String>| {
        let image = texture.source();
        let source = image.source();
        // Two images may name one file.
        let name = match &source {
            gltf::image::Source::Uri { uri, .. } if !uri.starts_with("data:") => {
                format!("texture {}", decoded(uri))
            }
            gltf::image::Source::Uri { .. } => format!("texture {}", image.index()),
            gltf::image::Source::View { view, .. } => {
                format!("texture in buffer view {}", view.index())
            }
        };
        if let Some(texture) = textures.find(&name) {
            return Ok(texture);
        }
        match source {
            gltf::image::Source::Uri { uri, .. } => {
                textures.read(&name, &content(uri, part)?, warnings)
            }
            gltf::image::Source::View { view, .. } => {
                let range = view.offset()..view.offset().saturating_add(view.length());
                let within =
                    buffers.get(view.buffer().index()).and_then(|buffer| buffer.get(range));
                textures.read(
                    &name,
                    within.ok_or_else(|| bad("an image beyond its buffer"))?,
                    warnings,
                )
            }
        }
    };
    for material in document.materials() {
        model.skins.push(skin(&material, &mut texture, &mut model.warnings)?);
    }
    model.skins.push(Skin::plain(PLAIN));
    let scene = document.default_scene().or_else(|| document.scenes().next());
    let mut open: Vec<(gltf::Node, Mat4)> =
        scene.iter().flat_map(|s| s.nodes()).map(|node| (node, Mat4::IDENTITY)).collect();
    open.reverse();
    let (mut left_out, mut visited) = (0, 0);
    while let Some((node, parent)) = open.pop() {
        visited += 1;
        if visited > document.nodes().len() {
            return Err(bad(format!(
                "node {} is within itself or within two others",
                node.index()
            )));
        }
        let place = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        for primitive in node.mesh().iter().flat_map(|mesh| mesh.primitives()) {
            if !add(&mut model, &primitive, place, &buffers, &mut budget).map_err(bad)? {
                left_out += 1;
            }
        }
        open.extend(node.children().map(|child| (child, place)));
    }
    if left_out > 0 {
        model.warnings.push(format!("{left_out} parts are points or lines and are left out"));
    }
    Ok(model)
}

/// The bytes of each buffer; those of a file that several buffers name are read once, into `files`.
fn read_buffers(
    document: &gltf::Document,
    blob: Option<Vec<u8>>,
    part: ReadPart,
    files: &mut BTreeMap<String, Rc<Vec<u8>>>,
) -> Result<Vec<Rc<Vec<u8>>>, String> {
    let blob = blob.map(Rc::new);
    let mut buffers = Vec::new();
    for buffer in document.buffers() {
        let data = match buffer.source() {
            gltf::buffer::Source::Bin => {
                blob.clone().ok_or_else(|| bad("it has no binary chunk"))?
            }
            gltf::buffer::Source::Uri(uri) => match files.get(uri) {
                Some(data) => data.clone(),
                None => files.entry(uri.to_owned()).or_insert(Rc::new(content(uri, part)?)).clone(),
            },
        };
        if data.len() < buffer.length() {
            let (wanted, got) = (buffer.length(), data.len());
            return Err(bad(format!(
                "buffer {}: wanted {wanted} bytes, got {got}",
                buffer.index()
            )));
        }
        buffers.push(data);
    }
    Ok(buffers)
}

/// Reads the texels of a texture; the list receives the reader's warnings.
type ReadTexture<'a> =
    &'a mut dyn FnMut(gltf::Texture, &mut Vec<String>) -> Result<Arc<Texture>, String>;

/// The material of a primitive without one.
const PLAIN: Material =
    Material { albedo: Vec3::splat(0.8), roughness: 1.0, specular: 0.5, metallic: 0.0 };

fn skin(
    material: &gltf::Material,
    texture: ReadTexture,
    warnings: &mut Vec<String>,
) -> Result<Skin, String> {
    let pbr = material.pbr_metallic_roughness();
    let [r, g, b, _] = pbr.base_color_factor();
    let plain = Material {
        albedo: Vec3::new(r, g, b).clamp(Vec3::ZERO, Vec3::ONE),
        roughness: pbr.roughness_factor().clamp(0.0, 1.0),
        specular: 0.5,
        metallic: pbr.metallic_factor().clamp(0.0, 1.0),
    };
    let mut read = |info: Option<gltf::texture::Info>| {
        info.map(|info| texture(info.texture(), warnings)).transpose()
    };
    let color = read(pbr.base_color_texture())?;
    let gloss = read(pbr.metallic_roughness_texture())?;
    Ok(Skin { material: plain, color, gloss })
}

/// Holds an accessor against the types that it may have, and the steps between its items against
/// their size: the crate takes both as sound.
fn check(
    name: &str,
    accessor: &Accessor,
    dimensions: Dimensions,
    types: &[DataType],
) -> Result<(), String> {
    let got = (accessor.dimensions(), accessor.data_type());
    if got.0 != dimensions || !types.contains(&got.1) {
        return Err(format!(
            "{name}: wanted {dimensions:?} of {types:?}, got {:?} of {:?}",
            got.0, got.1
        ));
    }
    let values = accessor.sparse().map(|sparse| sparse.values().view());
    for stride in accessor.view().into_iter().chain(values).filter_map(|view| view.stride()) {
        if stride < accessor.size() {
            return Err(format!(
                "{name}: wanted a byteStride of at least {}, got {stride}",
                accessor.size()
            ));
        }
    }
    Ok(())
}

/// Adds a primitive's triangles; false where it has none by nature.
fn add(
    model: &mut Model,
    primitive: &gltf::Primitive,
    place: Mat4,
    buffers: &[Rc<Vec<u8>>],
    budget: &mut Budget,
) -> Result<bool, String> {
    use DataType::{F32, U8, U16, U32};
    use Dimensions::{Scalar, Vec2 as Pair, Vec3 as Triple};
    let positions = primitive.get(&Semantic::Positions).ok_or("a part without positions")?;
    check("POSITION", &positions, Triple, &[F32])?;
    let corners = primitive.indices().map_or(positions.count(), |indices| indices.count());
    let triangles = match primitive.mode() {
        Mode::Triangles => corners / 3,
        Mode::TriangleStrip | Mode::TriangleFan => corners.saturating_sub(2),
        _ => 0,
    };
    budget.part()?;
    budget.take(if triangles == 0 { 0 } else { positions.count() }, triangles)?;
    if triangles == 0 {
        return Ok(matches!(
            primitive.mode(),
            Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan
        ));
    }
    let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(|data| data.as_slice()));
    let first = model.positions.len() as u32;
    let positions = reader.read_positions().ok_or("a part's positions are beyond their buffer")?;
    model.positions.extend(positions.map(|p| place.transform_point3(Vec3::from_array(p))));
    let count = model.positions.len() as u32 - first;
    // Normals are turned by the inverse transpose, so that they stay orthogonal to a stretched
    // surface.
    let linear = Mat3::from_mat4(place);
    let turn =
        if linear.determinant().abs() > 1e-30 { linear.inverse().transpose() } else { linear };
    if let Some(accessor) = primitive.get(&Semantic::Normals) {
        check("NORMAL", &accessor, Triple, &[F32])?;
        let normals = reader.read_normals().into_iter().flatten().take(count as usize);
        model.normals.extend(normals.map(|n| (turn * Vec3::from_array(n)).normalize_or_zero()));
    }
    model.normals.resize(model.positions.len(), Vec3::ZERO);
    let set = primitive
        .material()
        .pbr_metallic_roughness()
        .base_color_texture()
        .map_or(0, |info| info.tex_coord());
    if let Some(accessor) = primitive.get(&Semantic::TexCoords(set)) {
        check("TEXCOORD", &accessor, Pair, &[F32, U8, U16])?;
        let uvs = reader
            .read_tex_coords(set)
            .into_iter()
            .flat_map(|uvs| uvs.into_f32())
            .take(count as usize);
        model.uvs.extend(uvs.map(Vec2::from_array));
    }
    model.uvs.resize(model.positions.len(), Vec2::ZERO);
    let indices: Vec<u32> = match primitive.indices() {
        Some(accessor) => {
            check("indices", &accessor, Scalar, &[U8, U16, U32])?;
            reader.read_indices().ok_or("indices beyond their buffer")?.into_u32().collect()
        }
        None => (0..count).collect(),
    };
    if let Some(bad) = indices.iter().find(|&&i| i >= count) {
        return Err(format!("wanted indices below {count}, got {bad}"));
    }
    let strip = |i: usize| if i.is_multiple_of(2) { [i, i + 1, i + 2] } else { [i + 1, i, i + 2] };
    let corners: Vec<[u32; 3]> = match primitive.mode() {
        Mode::TriangleStrip => {
            (0..indices.len().saturating_sub(2)).map(|i| strip(i).map(|k| indices[k])).collect()
        }
        Mode::TriangleFan => super::fan(&indices).collect(),
        _ => indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    };
    let skin = primitive.material().index().unwrap_or(model.skins.len() - 1) as u32;
    model.skin.extend(std::iter::repeat_n(skin, corners.len()));
    model.triangles.extend(corners.into_iter().map(|t| t.map(|i| i + first)));
    Ok(true)
}
