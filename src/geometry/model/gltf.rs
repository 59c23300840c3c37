//! glTF 2.0: `.gltf` with its files beside it or within, and `.glb`.

use std::sync::Arc;

use base64::Engine;
use glam::{Mat3, Mat4, Vec2, Vec3};
use gltf::mesh::Mode;

use super::{Material, Model, Part, Skin};
use crate::image::{Plane, Source, Transfer, read_photo};

/// The files that a `.gltf` names, as it names them, percent-decoded; none when it cannot be read.
pub fn parts(bytes: &[u8]) -> Vec<String> {
    let Ok(document) = gltf::Gltf::from_slice(bytes) else { return Vec::new() };
    let buffers = document.buffers().filter_map(|buffer| match buffer.source() {
        gltf::buffer::Source::Uri(uri) => Some(uri),
        gltf::buffer::Source::Bin => None,
    });
    let images = document.images().filter_map(|image| match image.source() {
        gltf::image::Source::Uri { uri, .. } => Some(uri),
        gltf::image::Source::View { .. } => None,
    });
    let mut names: Vec<String> = buffers.chain(images).filter(|uri| !uri.starts_with("data:")).map(decoded).collect();
    names.sort();
    names.dedup();
    names
}

fn decoded(uri: &str) -> String {
    percent_encoding::percent_decode_str(uri).decode_utf8_lossy().into_owned()
}

/// The bytes of a `data:` address or of a file.
fn content(uri: &str, part: Part) -> Result<Vec<u8>, String> {
    match uri.strip_prefix("data:").and_then(|data| data.split_once(',')) {
        Some((kind, text)) if kind.ends_with(";base64") => base64::engine::general_purpose::STANDARD
            .decode(text)
            .map_err(|e| format!("wanted a sound glTF file: data address: {e}")),
        _ => part(&decoded(uri)),
    }
}

pub fn read(bytes: &[u8], part: Part) -> Result<Model, String> {
    let bad = |e: &dyn std::fmt::Display| format!("wanted a sound glTF file: {e}");
    let gltf::Gltf { document, blob } = gltf::Gltf::from_slice(bytes).map_err(|e| bad(&e))?;
    let mut buffers = Vec::new();
    for buffer in document.buffers() {
        let data = match buffer.source() {
            gltf::buffer::Source::Bin => blob.clone().ok_or_else(|| bad(&"it has no binary chunk"))?,
            gltf::buffer::Source::Uri(uri) => content(uri, part)?,
        };
        if data.len() < buffer.length() {
            let (wanted, got) = (buffer.length(), data.len());
            return Err(bad(&format!("buffer {}: wanted {wanted} bytes, got {got}", buffer.index())));
        }
        buffers.push(data);
    }
    let mut model = Model::default();
    let mut images: Vec<Option<Vec<u8>>> = vec![None; document.images().len()];
    let mut texture = |texture: gltf::Texture, transfer: Transfer, warnings: &mut Vec<String>| {
        let image = texture.source();
        let slot = &mut images[image.index()];
        if slot.is_none() {
            *slot = Some(match image.source() {
                gltf::image::Source::Uri { uri, .. } => content(uri, part)?,
                gltf::image::Source::View { view, .. } => {
                    let within = buffers.get(view.buffer().index());
                    let range = view.offset()..view.offset().saturating_add(view.length());
                    within.and_then(|b| b.get(range)).ok_or_else(|| bad(&"an image beyond its buffer"))?.to_vec()
                }
            });
        }
        let name = format!("texture {}", image.index());
        let read = read_photo(Source::new(&name, slot.as_deref().unwrap_or_default()), transfer);
        let read = read.map_err(|e| format!("{name}: {}", e.message()))?;
        warnings.extend(read.warnings.iter().map(|w| format!("{name}: {w}")));
        Ok::<Arc<Plane<Vec3>>, String>(Arc::new(read.picture.0))
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
            return Err(bad(&format!("node {} is within itself or within two others", node.index())));
        }
        let place = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        for primitive in node.mesh().iter().flat_map(|mesh| mesh.primitives()) {
            if !add(&mut model, &primitive, place, &buffers).map_err(|e| bad(&e))? {
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

/// The pixels of a texture, and on the list what a person should know of it.
type ReadTexture<'a> = &'a mut dyn FnMut(gltf::Texture, Transfer, &mut Vec<String>) -> Result<Arc<Plane<Vec3>>, String>;

/// What a primitive without material is made of.
const PLAIN: Material = Material { albedo: Vec3::splat(0.8), roughness: 1.0, specular: 0.5, metallic: 0.0 };

fn skin(material: &gltf::Material, texture: ReadTexture, warnings: &mut Vec<String>) -> Result<Skin, String> {
    let pbr = material.pbr_metallic_roughness();
    let [r, g, b, _] = pbr.base_color_factor();
    let plain = Material {
        albedo: Vec3::new(r, g, b).clamp(Vec3::ZERO, Vec3::ONE),
        roughness: pbr.roughness_factor().clamp(0.0, 1.0),
        specular: 0.5,
        metallic: pbr.metallic_factor().clamp(0.0, 1.0),
    };
    let mut read = |info: Option<gltf::texture::Info>, transfer| {
        info.map(|info| texture(info.texture(), transfer, warnings)).transpose()
    };
    let colour = read(pbr.base_color_texture(), Transfer::Srgb)?;
    let gloss = read(pbr.metallic_roughness_texture(), Transfer::Linear)?;
    Ok(Skin { material: plain, colour, gloss })
}

/// Adds a primitive's triangles; false where it has none by nature.
fn add(model: &mut Model, primitive: &gltf::Primitive, place: Mat4, buffers: &[Vec<u8>]) -> Result<bool, String> {
    let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(Vec::as_slice));
    let first = model.positions.len() as u32;
    // An accessor may claim any number of zeros without a byte behind them.
    let claimed = primitive.get(&gltf::Semantic::Positions).map_or(0, |accessor| accessor.count());
    if claimed > 3 * super::MOST_TRIANGLES {
        return Err(format!("wanted up to {} positions, got {claimed}", 3 * super::MOST_TRIANGLES));
    }
    let positions = reader.read_positions().ok_or("a part without positions, or beyond its buffer")?;
    model.positions.extend(positions.map(|p| place.transform_point3(Vec3::from_array(p))));
    let count = model.positions.len() as u32 - first;
    // Normals are turned by the inverse transpose, so that they stay upright on what is stretched.
    let linear = Mat3::from_mat4(place);
    let turn = if linear.determinant().abs() > 1e-30 { linear.inverse().transpose() } else { linear };
    if let Some(normals) = reader.read_normals() {
        model.normals.extend(normals.map(|n| (turn * Vec3::from_array(n)).normalize_or_zero()));
    }
    model.normals.resize(model.positions.len(), Vec3::ZERO);
    let set = primitive.material().pbr_metallic_roughness().base_color_texture().map_or(0, |info| info.tex_coord());
    if let Some(uvs) = reader.read_tex_coords(set) {
        model.uvs.extend(uvs.into_f32().map(Vec2::from_array));
    }
    model.uvs.resize(model.positions.len(), Vec2::ZERO);
    let indices: Vec<u32> = match primitive.indices() {
        Some(_) => reader.read_indices().ok_or("indices beyond their buffer")?.into_u32().collect(),
        None => (0..count).collect(),
    };
    if let Some(bad) = indices.iter().find(|&&i| i >= count) {
        return Err(format!("wanted indices below {count}, got {bad}"));
    }
    let strip = |i: usize| if i.is_multiple_of(2) { [i, i + 1, i + 2] } else { [i + 1, i, i + 2] };
    let corners: Vec<[u32; 3]> = match primitive.mode() {
        Mode::Triangles => indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
        Mode::TriangleStrip => (0..indices.len().saturating_sub(2)).map(|i| strip(i).map(|k| indices[k])).collect(),
        Mode::TriangleFan => super::fan(&indices).collect(),
        _ => return Ok(false),
    };
    let skin = primitive.material().index().unwrap_or(model.skins.len() - 1) as u32;
    model.skin.extend(std::iter::repeat_n(skin, corners.len()));
    model.triangles.extend(corners.into_iter().map(|t| t.map(|i| i + first)));
    Ok(true)
}
