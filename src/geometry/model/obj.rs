//! Wavefront OBJ with its material libraries.

use std::cell::RefCell;
use std::path::Path;
use std::sync::Arc;

use glam::{Vec2, Vec3};

use super::{Material, Model, Part, Skin};
use crate::image::{Plane, Source, Transfer, read_photo};

/// The material libraries that an OBJ names.
pub fn libraries(bytes: &[u8]) -> Vec<String> {
    let text = String::from_utf8_lossy(bytes);
    let names = text.lines().filter_map(|line| line.trim_start().strip_prefix("mtllib"));
    names.filter(|rest| rest.starts_with(char::is_whitespace)).map(|name| name.trim().to_owned()).collect()
}

/// The pictures that a material library names and that are read.
pub fn pictures(bytes: &[u8]) -> Vec<String> {
    let Ok((materials, _)) = tobj::load_mtl_buf(&mut &*bytes) else { return Vec::new() };
    materials.iter().filter_map(|material| Some(picture(material.diffuse_texture.as_ref()?))).collect()
}

/// The name at the end of a texture's options; on some systems folders are set apart by other signs.
fn picture(texture: &str) -> String {
    let name = if texture.starts_with('-') { texture.rsplit(char::is_whitespace).next() } else { Some(texture) };
    name.unwrap_or_default().replace('\\', "/")
}

pub fn read(bytes: &[u8], part: Part) -> Result<Model, String> {
    let options = tobj::LoadOptions { triangulate: true, single_index: true, ..tobj::LoadOptions::default() };
    let mut model = Model::default();
    let (part, warnings) = (RefCell::new(part), RefCell::new(Vec::new()));
    let library = |name: &Path| {
        let name = name.to_string_lossy();
        let found = part.borrow_mut()(&name).and_then(|bytes| {
            let bad = |e| format!("wanted a sound material library, {name}: {e}");
            tobj::load_mtl_buf(&mut &*bytes).map_err(bad)
        });
        Ok(found.unwrap_or_else(|told| {
            warnings.borrow_mut().push(format!("{told}; what it is made of is not known"));
            Default::default()
        }))
    };
    let (meshes, materials) =
        tobj::load_obj_buf(&mut &*bytes, &options, library).map_err(|e| format!("wanted a sound OBJ file: {e}"))?;
    let (part, mut warnings) = (part.into_inner(), warnings.into_inner());
    for material in &materials.unwrap_or_default() {
        model.skins.push(skin(material, part, &mut warnings)?);
    }
    model.warnings = warnings;
    let plain = model.skins.len() as u32;
    for tobj::Model { mesh, .. } in meshes {
        let first = model.positions.len() as u32;
        let vectors = |values: &[f32]| values.chunks_exact(3).map(Vec3::from_slice).collect::<Vec<_>>();
        model.positions.extend(vectors(&mesh.positions));
        model.normals.extend(vectors(&mesh.normals));
        model.normals.resize(model.positions.len(), Vec3::ZERO);
        // Rows of textures run from the top here, from the bottom there.
        model.uvs.extend(mesh.texcoords.chunks_exact(2).map(|uv| Vec2::new(uv[0], 1.0 - uv[1])));
        model.uvs.resize(model.positions.len(), Vec2::ZERO);
        model.triangles.extend(mesh.indices.chunks_exact(3).map(|t| [t[0] + first, t[1] + first, t[2] + first]));
        if plain > 0 {
            model.skin.resize(model.triangles.len(), mesh.material_id.map_or(plain, |id| id as u32));
        }
    }
    Ok(model)
}

/// What no part of a material says.
const SAYS_NOTHING: f32 = 0.5;

/// Kd is taken as linear, as Blender writes it, and multiplies map_Kd. The roughness is Pr; else, where there is a highlight, the exponent
/// Ns of its lobe tells it: alpha = roughness^2 = sqrt(2 / (Ns + 2)) (Walter et al., "Microfacet Models for Refraction", EGSR 2007).
fn skin(material: &tobj::Material, part: Part, warnings: &mut Vec<String>) -> Result<Skin, String> {
    let number = |name: &str| material.unknown_param.get(name).and_then(|text| text.trim().parse::<f32>().ok());
    let share = |value: f32| if value.is_finite() { value.clamp(0.0, 1.0) } else { SAYS_NOTHING };
    let colour = |rgb: [f32; 3]| Vec3::from_array(rgb.map(share));
    let highlight = material.specular.is_some_and(|ks| ks.iter().any(|&k| k > 0.0))
        && material.illumination_model.is_none_or(|model| model >= 2);
    let by_exponent = material.shininess.filter(|ns| highlight && *ns >= 0.0).map(|ns| (2.0 / (ns + 2.0)).powf(0.25));
    let roughness = number("Pr").or(by_exponent).map_or(1.0, share);
    let mut albedo = material.diffuse.map_or(Material::PLAIN.albedo, colour);
    let mut texture = None;
    if let Some(of) = &material.diffuse_texture {
        let name = picture(of);
        match part(&name) {
            Ok(bytes) => {
                let read = read_photo(Source::new(&name, &bytes), Transfer::Srgb);
                let read = read.map_err(|e| format!("{name}: {}", e.message()))?;
                warnings.extend(read.warnings.iter().map(|w| format!("{name}: {w}")));
                texture = Some(Arc::<Plane<Vec3>>::new(read.picture.0));
                // Some programs leave the colour black where there is a picture of it.
                if albedo == Vec3::ZERO || material.diffuse.is_none() {
                    albedo = Vec3::ONE;
                }
            }
            Err(told) => warnings.push(format!("material {:?}: {told}; its map_Kd is not used", material.name)),
        }
        if of.starts_with('-') {
            warnings.push(format!("material {:?}: options of map_Kd are not used", material.name));
        }
    }
    let unused = [
        ("Ke", material.emissive.is_some_and(|e| e.iter().any(|&e| e > 0.0))),
        ("d", material.dissolve.is_some_and(|d| d < 1.0)),
        ("Tr", number("Tr").is_some_and(|t| t > 0.0)),
        ("map_Ks", material.specular_texture.is_some()),
        ("map_Ns", material.shininess_texture.is_some()),
        ("map_d", material.dissolve_texture.is_some()),
        ("map_Bump", material.normal_texture.is_some()),
        ("norm", material.unknown_param.contains_key("norm")),
        ("map_Pr", material.unknown_param.contains_key("map_Pr")),
        ("map_Pm", material.unknown_param.contains_key("map_Pm")),
    ];
    let unused: Vec<&str> = unused.into_iter().filter(|(_, there)| *there).map(|(name, _)| name).collect();
    if !unused.is_empty() {
        warnings.push(format!("material {:?}: not used: {}", material.name, unused.join(", ")));
    }
    let metallic = number("Pm").map_or(0.0, share);
    Ok(Skin { material: Material { albedo, roughness, specular: 0.5, metallic }, colour: texture, gloss: None })
}
