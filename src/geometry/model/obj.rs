//! Wavefront OBJ; its material libraries are not read.

use glam::{Vec2, Vec3};

use super::Model;

pub fn read(bytes: &[u8]) -> Result<Model, String> {
    let options = tobj::LoadOptions { triangulate: true, single_index: true, ..tobj::LoadOptions::default() };
    let no_materials = |_: &std::path::Path| Ok(Default::default());
    let (meshes, _) = tobj::load_obj_buf(&mut &*bytes, &options, no_materials)
        .map_err(|e| format!("wanted a sound OBJ file: {e}"))?;
    let mut model = Model::default();
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
    }
    Ok(model)
}
