//! Wavefront OBJ with its material libraries.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;

use glam::{Vec2, Vec3};

use super::{Budget, Material, Model, ReadPart, Skin, Textures};

/// Most materials of all libraries of a model.
const MOST_MATERIALS: usize = 10_000;

/// The material libraries that an OBJ names.
pub fn libraries(bytes: &[u8]) -> Vec<String> {
    let text = String::from_utf8_lossy(bytes);
    let names = text.lines().filter_map(|line| line.trim_start().strip_prefix("mtllib"));
    names
        .filter(|rest| rest.starts_with(char::is_whitespace))
        .map(|name| name.trim().to_owned())
        .collect()
}

/// The pictures that a material library names and that are read.
pub fn pictures(bytes: &[u8]) -> Vec<String> {
    let Ok(text) = sound_library(bytes, MOST_MATERIALS) else { return Vec::new() };
    let Ok((materials, _)) = tobj::load_mtl_buf(&mut text.as_bytes()) else { return Vec::new() };
    materials
        .iter()
        .filter_map(|material| Some(picture(material.diffuse_texture.as_ref()?)))
        .collect()
}

/// The name at the end of a texture's options; on some systems folders are set apart by other
/// signs.
fn picture(texture: &str) -> String {
    let name = if texture.starts_with('-') {
        texture.rsplit(char::is_whitespace).next()
    } else {
        Some(texture)
    };
    name.unwrap_or_default().replace('\\', "/")
}

/// The text of a library of at most `most` materials, in which each color has the three numbers
/// that the crate takes for granted: one stands for all three.
fn sound_library(bytes: &[u8], most: usize) -> Result<String, String> {
    let text = std::str::from_utf8(bytes).map_err(|e| e.to_string())?;
    let (mut whole, mut materials) = (String::with_capacity(text.len()), 0);
    for (index, line) in text.lines().enumerate() {
        let words: Vec<&str> = line.split_whitespace().take(4).collect();
        match words[..] {
            ["newmtl", ..] => materials += 1,
            [key @ ("Ka" | "Kd" | "Ks" | "Ke"), gray] => {
                let _ = writeln!(whole, "{key} {gray} {gray} {gray}");
                continue;
            }
            [key @ ("Ka" | "Kd" | "Ks" | "Ke")] | [key @ ("Ka" | "Kd" | "Ks" | "Ke"), _, _] => {
                return Err(format!("line {}: wanted one or three numbers after {key}", index + 1));
            }
            _ => {}
        }
        whole.push_str(line);
        whole.push('\n');
    }
    if materials > most {
        return Err(format!(
            "wanted up to {MOST_MATERIALS} materials in a model, got at least {materials}"
        ));
    }
    Ok(whole)
}

/// Counts groups and faces before they are read, and checks that indices fit the crate's integers.
fn check(bytes: &[u8]) -> Result<(), String> {
    let mut budget = Budget::new(bytes.len());
    let text = String::from_utf8_lossy(bytes);
    let (mut material, mut open) = ("", false);
    for (index, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("f" | "l") => {
                let mut corners = 0;
                for corner in words {
                    corners += 1;
                    let far = |i: &str| {
                        i.parse::<i64>().is_ok_and(|i| i.unsigned_abs() > u32::MAX.into())
                    };
                    if corner.len() > 10 && corner.split('/').any(far) {
                        return Err(format!(
                            "line {}: wanted indices up to {}, got {corner}",
                            index + 1,
                            u32::MAX
                        ));
                    }
                }
                // A point and a line are triangles without area.
                budget.take(corners, corners.saturating_sub(2).max(1))?;
                open = true;
            }
            Some("o" | "g") if std::mem::take(&mut open) => budget.part()?,
            Some("usemtl") if std::mem::replace(&mut material, line) != line => budget.part()?,
            _ => {}
        }
    }
    Ok(())
}

/// Reads a model from OBJ; `part` returns the content of its material files and textures.
///
/// # Errors
/// The file or one of its parts cannot be used; the message states the wanted and the actual
/// content.
pub fn read(bytes: &[u8], part: ReadPart) -> Result<Model, String> {
    let bad = |e: &dyn std::fmt::Display| format!("wanted a valid OBJ file: {e}");
    check(bytes).map_err(|e| bad(&e))?;
    let options =
        tobj::LoadOptions { triangulate: true, single_index: true, ..tobj::LoadOptions::default() };
    let mut model = Model::default();
    let (part, warnings) = (RefCell::new(part), RefCell::new(Vec::new()));
    let (named, materials) = (RefCell::new(BTreeSet::new()), RefCell::new(0));
    let library = |name: &Path| {
        let name = name.to_string_lossy();
        // A library that is named again is known.
        if !named.borrow_mut().insert(name.to_string()) {
            return Ok(Default::default());
        }
        let found = part.borrow_mut()(&name).and_then(|bytes| {
            let text = sound_library(&bytes, MOST_MATERIALS - *materials.borrow());
            let read = text.and_then(|text| {
                tobj::load_mtl_buf(&mut text.as_bytes()).map_err(|e| e.to_string())
            });
            read.map_err(|e| format!("wanted a valid material library, {name}: {e}"))
        });
        let found = found.unwrap_or_else(|message| {
            warnings.borrow_mut().push(format!("{message}; its materials are not known"));
            Default::default()
        });
        *materials.borrow_mut() += found.0.len();
        Ok(found)
    };
    let (meshes, materials) =
        tobj::load_obj_buf(&mut &*bytes, &options, library).map_err(|e| bad(&e))?;
    let (part, mut warnings) = (part.into_inner(), warnings.into_inner());
    let mut textures = Textures::default();
    for material in &materials.unwrap_or_default() {
        model.skins.push(skin(material, part, &mut textures, &mut warnings)?);
    }
    model.warnings = warnings;
    let plain = model.skins.len() as u32;
    for tobj::Model { mesh, .. } in meshes {
        let first = model.positions.len() as u32;
        let vectors =
            |values: &[f32]| values.chunks_exact(3).map(Vec3::from_slice).collect::<Vec<_>>();
        model.positions.extend(vectors(&mesh.positions));
        model.normals.extend(vectors(&mesh.normals));
        model.normals.resize(model.positions.len(), Vec3::ZERO);
        // Rows of textures run from the top here, from the bottom there.
        model.uvs.extend(mesh.texcoords.chunks_exact(2).map(|uv| Vec2::new(uv[0], 1.0 - uv[1])));
        model.uvs.resize(model.positions.len(), Vec2::ZERO);
        model.triangles.extend(
            mesh.indices.chunks_exact(3).map(|t| [t[0] + first, t[1] + first, t[2] + first]),
        );
        if plain > 0 {
            model
                .skin
                .resize(model.triangles.len(), mesh.material_id.map_or(plain, |id| id as u32));
        }
    }
    Ok(model)
}

/// The default of a material's missing properties.
const SAYS_NOTHING: f32 = 0.5;

/// Kd is taken as linear, as Blender writes it, and multiplies map_Kd. The roughness is Pr; else,
/// where there is a highlight, the exponent The exponent Ns of its lobe gives the roughness:
/// alpha = roughness^2 = sqrt(2 / (Ns + 2)) (Walter et al., "Microfacet Models for Refraction",
/// EGSR 2007).
fn skin(
    material: &tobj::Material,
    part: ReadPart,
    textures: &mut Textures,
    warnings: &mut Vec<String>,
) -> Result<Skin, String> {
    let number = |name: &str| {
        material.unknown_param.get(name).and_then(|text| text.trim().parse::<f32>().ok())
    };
    let share = |value: f32| if value.is_finite() { value.clamp(0.0, 1.0) } else { SAYS_NOTHING };
    let color = |rgb: [f32; 3]| Vec3::from_array(rgb.map(share));
    let highlight = material.specular.is_some_and(|ks| ks.iter().any(|&k| k > 0.0))
        && material.illumination_model.is_none_or(|model| model >= 2);
    let by_exponent = material
        .shininess
        .filter(|ns| highlight && *ns >= 0.0)
        .map(|ns| (2.0 / (ns + 2.0)).powf(0.25));
    let roughness = number("Pr").or(by_exponent).map_or(1.0, share);
    let mut albedo = material.diffuse.map_or(Material::PLAIN.albedo, color);
    let mut texture = None;
    if let Some(of) = &material.diffuse_texture {
        let name = picture(of);
        texture = textures.find(&name);
        if texture.is_none() {
            match part(&name) {
                Ok(bytes) => texture = Some(textures.read(&name, &bytes, warnings)?),
                Err(message) => warnings.push(format!(
                    "material {:?}: {message}; its map_Kd is not used",
                    material.name
                )),
            }
        }
        // Some programs leave the color black where there is a picture of it.
        if texture.is_some() && (albedo == Vec3::ZERO || material.diffuse.is_none()) {
            albedo = Vec3::ONE;
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
    let unused: Vec<&str> =
        unused.into_iter().filter(|(_, there)| *there).map(|(name, _)| name).collect();
    if !unused.is_empty() {
        warnings.push(format!("material {:?}: not used: {}", material.name, unused.join(", ")));
    }
    let metallic = number("Pm").map_or(0.0, share);
    Ok(Skin {
        material: Material { albedo, roughness, specular: 0.5, metallic },
        color: texture,
        gloss: None,
    })
}
