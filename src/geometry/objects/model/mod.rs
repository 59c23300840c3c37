//! Models from files: triangles with their materials.

mod budget;
mod gltf;
mod obj;
mod ply;

use std::path::Path;
use std::sync::Arc;

use glam::{Vec2, Vec3};

use crate::geometry::bounds;
use crate::image::Texture;

pub use budget::most_triangles;
use budget::{Budget, MOST_FILES, Textures};

/// Most characters of an error that a message shows: it may quote a line or list every fault.
const SHOWN: usize = 400;

/// Gives the bytes of a file that a model names.
type ReadPart<'a> = &'a mut dyn FnMut(&str) -> Result<Vec<u8>, String>;

/// The files that a model of this name and content names, as it names them. Of an OBJ, whose
/// libraries and pictures often stay behind, those that `beside` has.
pub fn named_files(
    name: &str,
    content: impl FnOnce() -> Option<Vec<u8>>,
    beside: &dyn Fn(&str) -> Option<Vec<u8>>,
) -> Vec<String> {
    let ending = ending(name);
    if !matches!(&*ending, "gltf" | "obj") {
        return Vec::new();
    }
    let Some(bytes) = content() else { return Vec::new() };
    if ending == "gltf" {
        return gltf::named_files(&bytes);
    }
    let mut names = distinct(obj::libraries(&bytes));
    for library in names.clone() {
        names.extend(beside(&library).map_or(Vec::new(), |bytes| obj::pictures(&bytes)));
        names = distinct(names);
    }
    names.retain(|name| beside(name).is_some());
    names
}

/// Sorted, without duplicates, and no more than one too many: reading a model that names so many
/// files is an error.
fn distinct(mut names: Vec<String>) -> Vec<String> {
    names.sort();
    names.dedup();
    names.truncate(MOST_FILES + 1);
    names
}

fn ending(name: &str) -> String {
    Path::new(name).extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase()
}

/// Parameters of a surface's BRDF: a diffuse and a GGX lobe, as in Karis, "Real Shading in Unreal
/// Engine 4" (2013).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Base color, linear Rec.709, 0..=1: the diffuse albedo, or of a metal the color of its
    /// reflection.
    pub albedo: Vec3,
    /// GGX roughness, 0..=1: 0 is a mirror, 1 has almost no highlight.
    pub roughness: f32,
    /// Reflectance of a dielectric at normal incidence, in units of 8 %.
    pub specular: f32,
    /// 0 or 1; between them, a mixture.
    pub metallic: f32,
}

/// A material that may change over the surface.
#[derive(Clone, Debug)]
pub struct Skin {
    /// The material, where no texture replaces it.
    pub material: Material,
    /// Factor of the albedo over the texture's unit square, rows from the top.
    pub color: Option<Arc<Texture>>,
    /// Factors of roughness (y) and metallic (z), stored as linear numbers.
    pub gloss: Option<Arc<Texture>>,
}

impl Skin {
    /// Creates a skin with one material everywhere, without textures.
    pub fn plain(material: Material) -> Skin {
        Skin { material, color: None, gloss: None }
    }

    /// The material at a place of the texture.
    pub fn at(&self, uv: Vec2) -> Material {
        let mut material = self.material;
        if let Some(color) = &self.color {
            material.albedo *= texel(color, uv, true);
        }
        if let Some(gloss) = &self.gloss {
            let factor = texel(gloss, uv, false);
            material.roughness *= factor.y;
            material.metallic *= factor.z;
        }
        material.albedo = material.albedo.clamp(Vec3::ZERO, Vec3::ONE);
        material
    }
}

/// Bilinear, repeated beyond the unit square.
fn texel(texture: &Texture, uv: Vec2, srgb: bool) -> Vec3 {
    let (w, h) = texture.size();
    if w == 0 || h == 0 || !uv.is_finite() {
        return Vec3::ONE;
    }
    let at = (uv - uv.floor()) * Vec2::new(w as f32, h as f32) - 0.5;
    let (x, y) = (at.x.floor(), at.y.floor());
    let pixel = |dx: f32, dy: f32| {
        let wrap = |v: f32, size: usize| (v as isize).rem_euclid(size as isize) as usize;
        texture.get(wrap(x + dx, w), wrap(y + dy, h), srgb)
    };
    let (fx, fy) = (at.x - x, at.y - y);
    pixel(0.0, 0.0).lerp(pixel(1.0, 0.0), fx).lerp(pixel(0.0, 1.0).lerp(pixel(1.0, 1.0), fx), fy)
}

/// Triangles in the file's own units, y up.
#[derive(Clone, Debug, Default)]
pub struct Model {
    /// Vertex positions.
    pub positions: Vec<Vec3>,
    /// Normals by position, towards the outside; zero where the file has none.
    pub normals: Vec<Vec3>,
    /// Texture coordinates by position; zero where the file has none.
    pub uvs: Vec<Vec2>,
    /// Albedo of each position, linear Rec.709; empty where the file has none.
    pub colors: Vec<Vec3>,
    /// Indices into `positions`, three per triangle.
    pub triangles: Vec<[u32; 3]>,
    /// The skin of each triangle; empty where the file has none.
    pub skin: Vec<u32>,
    /// The skins that `skin` refers to.
    pub skins: Vec<Skin>,
    /// Warnings about the file, for a person.
    pub warnings: Vec<String>,
    /// Bytes of all files that it was read from.
    pub file_bytes: usize,
}

impl Model {
    /// Reads PLY, OBJ, glTF or GLB, by the extension of `name`; `part` returns the bytes of a file
    /// that a glTF or OBJ names, and is called once for each.
    ///
    /// # Errors
    /// The file is damaged, holds no triangle, or claims more memory than its bytes justify; the
    /// message states the wanted and the actual content.
    pub fn read(
        name: &str,
        bytes: &[u8],
        part: &mut dyn FnMut(&str) -> Result<Vec<u8>, String>,
    ) -> Result<Model, String> {
        let ending = ending(name);
        let (mut file_bytes, mut files) = (bytes.len(), 0);
        let mut part = |name: &str| {
            if files == MOST_FILES {
                return Err(format!(
                    "wanted a model that names up to {MOST_FILES} other files, got more"
                ));
            }
            let bytes = part(name)?;
            files += 1;
            file_bytes += bytes.len();
            Ok(bytes)
        };
        let mut model = match ending.as_str() {
            "ply" => ply::read(bytes)?,
            "obj" => obj::read(bytes, &mut part)?,
            "gltf" | "glb" => gltf::read(bytes, &mut part)?,
            _ => {
                return Err(format!(
                    "wanted a model that ends in .ply, .obj, .gltf or .glb, got {ending:?}"
                ));
            }
        };
        model.file_bytes = file_bytes;
        model.check()?;
        Ok(model)
    }

    /// A sphere of radius 1, of 20 x 4^5 triangles whose corners lie on it.
    pub fn sphere() -> Model {
        let phi = 0.5 * (1.0 + 5.0f32.sqrt());
        let mut corners: Vec<Vec3> = Vec::new();
        for (a, b) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            corners.extend([
                Vec3::new(0.0, a, b * phi),
                Vec3::new(a, b * phi, 0.0),
                Vec3::new(b * phi, 0.0, a),
            ]);
        }
        corners.iter_mut().for_each(|c| *c = c.normalize());
        // The faces of the hull: triples of neighbors, which are 63.4 degrees apart.
        let near = |a: usize, b: usize| corners[a].dot(corners[b]) > 0.4;
        let mut triangles: Vec<[u32; 3]> = Vec::new();
        for a in 0..12 {
            for b in a + 1..12 {
                for c in (b + 1..12).filter(|&c| near(a, b) && near(b, c) && near(a, c)) {
                    let out =
                        (corners[b] - corners[a]).cross(corners[c] - corners[a]).dot(corners[a])
                            > 0.0;
                    triangles.push(if out { [a, b, c] } else { [a, c, b] }.map(|i| i as u32));
                }
            }
        }
        for _ in 0..5 {
            let mut middles = std::collections::BTreeMap::new();
            let mut finer = Vec::with_capacity(4 * triangles.len());
            for [a, b, c] in triangles {
                let mut middle = |a: u32, b: u32| {
                    *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                        corners.push((corners[a as usize] + corners[b as usize]).normalize());
                        corners.len() as u32 - 1
                    })
                };
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
            }
            triangles = finer;
        }
        let uvs = vec![Vec2::ZERO; corners.len()];
        Model { normals: corners.clone(), positions: corners, uvs, triangles, ..Model::default() }
    }

    /// Lowest and highest corner of the box around all triangles.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        bounds(self.triangles.iter().flatten().map(|&i| self.positions[i as usize]))
    }

    fn check(&mut self) -> Result<(), String> {
        let (count, all) = (self.positions.len(), self.triangles.len());
        if let Some(at) =
            self.positions.iter().position(|p| !(p.is_finite() && p.abs().max_element() < 1e15))
        {
            return Err(format!(
                "wanted finite numbers, got {} at vertex {at}",
                self.positions[at]
            ));
        }
        if let Some((at, corners)) =
            self.triangles.iter().enumerate().find(|(_, t)| t.iter().any(|&i| i as usize >= count))
        {
            return Err(format!("wanted vertices below {count}, got {corners:?} in triangle {at}"));
        }
        self.normals.resize(count, Vec3::ZERO);
        self.normals
            .iter_mut()
            .for_each(|n| *n = if n.is_finite() { n.normalize_or_zero() } else { Vec3::ZERO });
        self.uvs.resize(count, Vec2::ZERO);
        if !self.colors.is_empty() {
            self.colors.resize(count, Material::PLAIN.albedo);
        }
        // Relative to the whole: a triangle without area cannot be seen and does not have a normal.
        let (low, high) = self.bounds();
        let least = 1e-14 * (high - low).length_squared();
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| self.positions[i as usize].as_dvec3());
            (b - a).cross(c - a).length()
        };
        let sound: Vec<bool> = self.triangles.iter().map(|t| area(t) > f64::from(least)).collect();
        let keep = |i: usize| sound[i];
        if !self.skin.is_empty() {
            self.skin =
                self.skin.iter().enumerate().filter(|(i, _)| keep(*i)).map(|(_, s)| *s).collect();
        }
        self.triangles =
            self.triangles.iter().enumerate().filter(|(i, _)| keep(*i)).map(|(_, t)| *t).collect();
        match all - self.triangles.len() {
            _ if self.triangles.is_empty() => {
                return Err(format!("wanted triangles with area, got none (of {all})"));
            }
            0 => {}
            flat => self
                .warnings
                .push(format!("{flat} of {all} triangles have no area and are left out")),
        }
        self.turn_outwards();
        Ok(())
    }

    /// Triangles of which the outside is not known by normals get it from the whole: a closed body
    /// turned inside out has a negative volume.
    fn turn_outwards(&mut self) {
        let (low, high) = self.bounds();
        let middle = (0.5 * (low + high)).as_dvec3();
        let volume: f64 = self
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| self.positions[i as usize].as_dvec3() - middle);
                a.dot(b.cross(c))
            })
            .sum();
        if volume < 0.0 {
            self.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        // The file's normals, where it has any, decide for each triangle.
        for t in &mut self.triangles {
            let [a, b, c] = t.map(|i| self.positions[i as usize]);
            let message: Vec3 = t.iter().map(|&i| self.normals[i as usize]).sum();
            if (b - a).cross(c - a).dot(message) < 0.0 {
                t.swap(1, 2);
            }
        }
    }
}

/// Triangles of a polygon: a fan, as files are taken to hold convex ones.
fn fan(corners: &[u32]) -> impl Iterator<Item = [u32; 3]> + '_ {
    (2..corners.len()).map(|i| [corners[0], corners[i - 1], corners[i]])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn no_parts(name: &str) -> Result<Vec<u8>, String> {
        Err(format!("no {name}"))
    }

    fn read(name: &str, bytes: &[u8]) -> Result<Model, String> {
        Model::read(name, bytes, &mut no_parts)
    }

    const QUAD: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
        element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n";

    #[test]
    fn the_sphere_is_round_closed_and_turned_outwards() {
        let sphere = Model::sphere();
        assert_eq!(sphere.triangles.len(), 20 * 1024);
        assert_eq!(sphere.positions.len(), 10 * 1024 + 2, "Euler: a closed surface without holes");
        let corner = |t: &[u32; 3]| t.map(|i| sphere.positions[i as usize].as_dvec3());
        let volume: f64 =
            sphere.triangles.iter().map(corner).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum();
        let ball = 4.0 / 3.0 * std::f64::consts::PI;
        assert!((volume / ball - 1.0).abs() < 2e-3, "{volume} against {ball}");
    }

    #[test]
    fn polygons_become_triangles_in_each_format() {
        let ply = read("a.PLY", QUAD.as_bytes()).expect("it is sound");
        assert_eq!((ply.positions.len(), ply.triangles.len()), (4, 2));
        let obj = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1 4//1\n";
        let obj = read("a.obj", obj).expect("it is sound");
        assert_eq!(obj.triangles.len(), 2);
        assert!(obj.normals.iter().all(|n| *n == Vec3::Z));
        assert_eq!(obj.bounds(), (Vec3::ZERO, Vec3::new(1.0, 1.0, 0.0)));
    }

    #[test]
    fn what_is_inside_out_is_turned() {
        let tetrahedron = |faces: &str| {
            let text = format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n{faces}");
            let model = read("a.obj", text.as_bytes()).expect("it is sound");
            let area = |t: &[u32; 3]| {
                let [a, b, c] = t.map(|i| model.positions[i as usize] - Vec3::splat(0.25));
                a.dot((b - a).cross(c - a))
            };
            assert!(model.triangles.iter().all(|t| area(t) > 0.0), "{faces}");
        };
        tetrahedron("f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n");
        tetrahedron("f 1 2 3\nf 1 4 2\nf 1 3 4\nf 2 4 3\n");
    }

    /// Each material of a library on its own triangle; unused properties give a warning.
    #[test]
    fn an_obj_takes_its_library() {
        let obj = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\nusemtl red\nf 1/1 2/2 3/3\n\
            usemtl gold\nf 1/1 2/2 3/3\nusemtl cloth\nf 1/1 2/2 3/3\nusemtl dull\nf 1/1 2/2 3/3\n";
        let library = "newmtl red\nKd 0.5 0.1 0.02\nKs 0.5 0.5 0.5\nNs 30\nmap_Bump b.png\nd 0.4\n\
            newmtl gold\nKd 1 0.8 0.3\nPr 0.25\nPm 1\nNs 900\nnewmtl cloth\nKd 0 0 0\nmap_Kd -s 1 1 1 tex/c.png\n\
            newmtl dull\nKd 0.2 2 nan\nKs 1 1 1\nNs 500\nillum 1\n";
        let cloth =
            crate::image::Picture(crate::image::Plane::filled(2, 2, Vec3::new(0.5, 0.25, 1.0)));
        let cloth = crate::image::write_png(&cloth, crate::image::Transfer::Srgb, false);
        let beside = |name: &str| match name {
            "a.mtl" => Some(library.as_bytes().to_vec()),
            "tex/c.png" => Some(cloth.clone()),
            _ => None,
        };
        assert_eq!(named_files("a.obj", || Some(obj.into()), &beside), ["a.mtl", "tex/c.png"]);
        assert!(
            named_files("a.obj", || Some(obj.into()), &|_| None).is_empty(),
            "what is not there is not asked for"
        );
        let mut part = |name: &str| beside(name).ok_or_else(|| format!("no {name}"));
        let model = Model::read("a.obj", obj.as_bytes(), &mut part).expect("it is sound");
        let body = crate::geometry::Body { model, material: None };
        let made = |triangle: usize| body.at(triangle, Vec3::splat(1.0 / 3.0)).material;
        assert_eq!(made(0), Material::PLAIN);
        assert_eq!((made(1).albedo, made(1).metallic), (Vec3::new(0.5, 0.1, 0.02), 0.0));
        // alpha^2 = 2 / 32.
        assert!((made(1).roughness - 0.5).abs() < 1e-6, "{}", made(1).roughness);
        assert_eq!((made(2).roughness, made(2).metallic), (0.25, 1.0));
        assert!(
            (made(3).albedo - Vec3::new(0.5, 0.25, 1.0)).abs().max_element() < 0.005,
            "{}",
            made(3).albedo
        );
        assert_eq!((made(4).albedo, made(4).roughness), (Vec3::new(0.2, 1.0, 0.5), 1.0));
        let message = body.model.warnings.join("\n");
        assert!(
            message.contains("\"red\": not used: d, map_Bump")
                && message.contains("options of map_Kd"),
            "{message}"
        );

        let alone = read("a.obj", obj.as_bytes()).expect("a library that is not there is no fault");
        assert!(alone.skins.is_empty() && alone.warnings.len() == 1, "{:?}", alone.warnings);
    }

    #[test]
    fn vertices_of_a_ply_have_colors() {
        let properties =
            "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n";
        let quad = QUAD.replace("property float z\n", properties);
        let (corners, faces) = quad.split_once("end_header\n").expect("it has a header");
        let colored: Vec<String> = faces
            .lines()
            .enumerate()
            .map(|(i, line)| match i {
                0..4 => format!("{line} 255 188 0\n"),
                _ => format!("{line}\n"),
            })
            .collect();
        let model = read("a.ply", format!("{corners}end_header\n{}", colored.concat()).as_bytes())
            .expect("it is sound");
        let body = crate::geometry::Body { model, material: None };
        let albedo = body.at(1, Vec3::new(0.2, 0.3, 0.5)).material.albedo;
        assert!(
            (albedo - Vec3::new(1.0, 0.503, 0.0)).abs().max_element() < 0.002,
            "sRGB 188 is half: {albedo}"
        );
        assert!(read("a.ply", QUAD.as_bytes()).expect("it is sound").colors.is_empty());
    }

    #[test]
    fn bad_models_are_told() {
        let nan = QUAD.replace("1 1 0", "nan 1 0");
        let out = QUAD.replace("4 0 1 2 3", "4 0 1 2 9");
        let flat = QUAD.replace("1 1 0", "2 0 0").replace("0 1 0", "3 0 0");
        let huge = QUAD.replace("vertex 4", "vertex 4000000000");
        let no_faces = QUAD.replace("face 1", "face 0").replace("4 0 1 2 3\n", "");
        for (name, bytes, wanted) in [
            ("a.ply", nan.as_bytes(), "Line 12"),
            ("a.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "wanted finite numbers"),
            ("a.ply", out.as_bytes(), "wanted vertices below 4"),
            ("a.ply", flat.as_bytes(), "triangles with area"),
            ("a.ply", huge.as_bytes(), "4000000000"),
            ("a.ply", no_faces.as_bytes(), "got none"),
            ("a.ply", &QUAD.as_bytes()[..150], "PLY"),
            ("a.ply", b"", "PLY"),
            ("a.obj", b"", "got none"),
            ("a.obj", b"v 1 2\nf 1 2 3\n", "OBJ"),
            ("a.obj", b"v 0 0 0\nf 1 2 3\n", "OBJ"),
            ("a.glb", b"glTF", "glTF"),
            ("a.gltf", b"{", "glTF"),
            ("a.gltf", br#"{"asset": {"version": "2.0"}}"#, "got none"),
            ("a.stl", b"solid", "wanted a model that ends in"),
        ] {
            let message = read(name, bytes)
                .err()
                .unwrap_or_else(|| panic!("{name} {wanted}: a fault is wanted"));
            assert!(message.contains(wanted), "{name}: wanted {wanted:?}, got {message:?}");
        }
    }
}
