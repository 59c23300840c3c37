//! `EditObjects`: inserts models and spheres into the room.

use std::sync::Arc;

use glam::{Mat3, Vec3};
use serde::{Deserialize, Serialize};

use super::{Color, Ground, Place, SIZES, check_model, model_files, read_model, tall, upright};
use crate::geometry::{
    Bodies, Body, Camera, Drawing, Material, Model, Objects, SceneMesh, draw, most_triangles,
    world_up,
};
use crate::graph::{Context, File, Node, NodeError, check_range};
use crate::image::{Depth, Normal};
use crate::{params, ports};

params! {
    /// Inserts models and spheres into the room; without objects, the room passes through
    /// unchanged.
    pub struct EditObjects {
        /// `Mesh(path: "bunny.ply", at: Pixel(x: 150, y: 170), height: 0.3, yaw: 30, material:
        /// (..))` or `Sphere(radius: 0.15, at: Point(0, -1, -2), material: (..))`, with a material
        /// `(albedo: Srgb("#d0d0d0"), roughness: 1, specular: 0.5, metallic: 0)`.
        objects: Vec<ObjectEdit> = Vec::new(),
        /// Primary rays per pixel along each axis, for antialiased edges.
        supersampling: usize = 4, in 1..=16,
        /// Largest number of visible points at which light is computed, 1..=10000000; in a large
        /// photo one point represents several pixels.
        samples: usize = 60_000, in 1..=10_000_000,
        /// Light probes on each object, which gather the light that the object reflects onto the
        /// room.
        probes: usize = 400, in 16..=10_000,
    }
}

/// One entry of an edit's `objects`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum ObjectEdit {
    /// A model that stands with the middle of its bottom at a place, its y upwards.
    Mesh {
        /// PLY, OBJ, glTF or GLB.
        path: File,
        /// Position of the middle of its bottom.
        at: Place,
        /// Meters from its lowest to its highest point.
        height: f32,
        /// Degrees to the left, seen from above; at 0 its z points to the camera.
        #[serde(default)]
        yaw: f32,
        /// Replaces the material of the file.
        #[serde(default)]
        material: Option<ObjectMaterial>,
        /// The files that the model names; found by themselves.
        #[serde(default)]
        parts: Vec<File>,
    },
    /// A sphere.
    Sphere {
        /// Meters.
        radius: f32,
        /// Its center, or the pixel that it stands on.
        at: Place,
        /// Its material.
        #[serde(default)]
        material: ObjectMaterial,
    },
}

/// Material of an object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectMaterial {
    /// Base color.
    albedo: Color,
    /// 0 is a mirror, 1 is dull.
    roughness: f32,
    /// Specular level, 0..=1: reflectance of a dielectric at normal incidence, in units of 8 %.
    specular: f32,
    /// 0 is a dielectric, 1 a metal.
    metallic: f32,
}

impl Default for ObjectMaterial {
    fn default() -> ObjectMaterial {
        let Material { albedo, roughness, specular, metallic } = Material::PLAIN;
        ObjectMaterial {
            albedo: Color::Linear(albedo.x, albedo.y, albedo.z),
            roughness,
            specular,
            metallic,
        }
    }
}

impl ObjectMaterial {
    fn material(&self) -> Result<Material, String> {
        for (name, value) in [
            ("roughness", self.roughness),
            ("specular", self.specular),
            ("metallic", self.metallic),
        ] {
            check_range(name, &value, 0.0..=1.0)?;
        }
        let albedo = self.albedo.linear().map_err(|e| format!("albedo: {e}"))?;
        Ok(Material {
            albedo,
            roughness: self.roughness,
            specular: self.specular,
            metallic: self.metallic,
        })
    }
}

ports! {
    pub input EditObjectsIn {
        /// The camera of the photo.
        camera: Arc<Camera>,
        /// Planar depth at the photo's size.
        depth: Arc<Depth>,
        /// Normals, at any size.
        normal: Arc<Normal>,
        /// The seen room.
        mesh: Arc<SceneMesh>,
    }
}

ports! {
    pub output EditObjectsOut {
        /// The room with all objects in it.
        mesh: Arc<SceneMesh>,
        /// Planar depth of the room and the objects at the photo's size.
        depth: Arc<Depth>,
        /// The visible objects: samples, coverage, materials.
        objects: Arc<Objects>,
        /// Whether there are objects.
        present: bool,
        /// Whether an object has a roughness below 1 or metal in it.
        shiny: bool,
    }
}

impl Node for EditObjects {
    const KIND: &'static str = "EditObjects";
    const VERSION: u32 = 2;
    type In = EditObjectsIn;
    type Out = EditObjectsOut;

    fn check_consistency(&self) -> Result<(), String> {
        self.objects
            .iter()
            .enumerate()
            .try_for_each(|(i, o)| o.check().map_err(|e| format!("objects: {i}: {e}")))
    }

    fn files(&mut self) -> Vec<&mut File> {
        let mut files = Vec::new();
        for object in &mut self.objects {
            let ObjectEdit::Mesh { path, parts, .. } = object else { continue };
            files.extend(model_files(path, parts));
        }
        files
    }

    fn run(&self, inputs: EditObjectsIn, ctx: &Context) -> Result<EditObjectsOut, NodeError> {
        let EditObjectsIn { camera, depth, normal, mesh } = inputs;
        if self.objects.is_empty() {
            let objects = Arc::new(Objects::unseen(&[]));
            return Ok(EditObjectsOut { mesh, depth, objects, present: false, shiny: false });
        }
        let ground =
            Ground { camera: &camera, depth: &depth, normal: &normal, up: world_up(&normal) };
        let (mut bodies, mut models) = (Vec::new(), Models::default());
        for (i, object) in self.objects.iter().enumerate() {
            ctx.check_cancelled()?;
            let again = self.objects[i + 1..]
                .iter()
                .any(|other| other.file().is_some() && other.file() == object.file());
            bodies.push(object.body(i, again, &ground, &mut models, ctx)?);
        }
        let (solid, materials) = Bodies::new(&bodies, self.probes);
        let drawing = Drawing { supersampling: self.supersampling, most: self.samples };
        let error = |z: f32| mesh.depth_error(z);
        let objects = draw(&bodies, (&solid, &materials), &camera, &depth, error, drawing);
        ctx.check_cancelled()?;
        report_objects(&bodies, &objects, ctx);
        let mut z = depth.0.clone();
        let (w, h) = objects.coverage.size();
        for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
            if objects.coverage.get(x, y) > 0.5 {
                z.set(objects.left + x, objects.top + y, objects.depth.get(x, y));
            }
        }
        Ok(EditObjectsOut {
            mesh: Arc::new(mesh.with_bodies(solid)),
            depth: Arc::new(Depth(z)),
            objects: Arc::new(objects),
            present: true,
            shiny: bodies.iter().any(Body::is_shiny),
        })
    }
}

/// The models of an edit: each file is read once, and the number of triangles of all objects is in
/// proportion to the bytes of their files.
#[derive(Default)]
struct Models<'a> {
    kept: Vec<(&'a File, &'a [File], Model)>,
    triangles: usize,
    file_bytes: usize,
}

impl<'a> Models<'a> {
    /// The model of a file, which is kept where it is wanted `again`.
    fn read(
        &mut self,
        path: &'a File,
        parts: &'a [File],
        again: bool,
        ctx: &Context,
    ) -> Result<Model, NodeError> {
        let kept = self.kept.iter().position(|(p, named, _)| (*p, *named) == (path, parts));
        let model = match kept {
            Some(at) if again => self.kept[at].2.clone(),
            Some(at) => self.kept.swap_remove(at).2,
            None => read_model(path, parts, ctx)?,
        };
        if again && kept.is_none() {
            self.kept.push((path, parts, model.clone()));
        }
        self.triangles += model.triangles.len();
        self.file_bytes += model.file_bytes;
        let most = most_triangles(self.file_bytes);
        if self.triangles > most {
            let got =
                format!("wanted up to {most} triangles of models with {} bytes", self.file_bytes);
            return Err(NodeError::BadParameter(format!(
                "objects: {got}, got at least {}",
                self.triangles
            )));
        }
        Ok(model)
    }
}

/// Warns of objects that do not look as expected.
fn report_objects(bodies: &[Body], objects: &Objects, ctx: &Context) {
    for (i, body) in bodies.iter().enumerate() {
        let (low, high) = body.model.bounds();
        if low.cmplt(Vec3::ZERO).all() && high.cmpgt(Vec3::ZERO).all() {
            ctx.warn(format!("object {i} encloses the camera: the picture shows its inside"));
        } else if !objects.body.pixels().contains(&(i as u32)) {
            ctx.warn(format!("object {i} is not visible: it is out of view, behind a visible surface, or too small"));
        }
    }
}

impl ObjectEdit {
    fn check(&self) -> Result<(), String> {
        match self {
            ObjectEdit::Mesh { path, height, material, .. } => {
                check_model(path, *height)?;
                material.as_ref().map_or(Ok(()), |m| m.material().map(|_| ()))
            }
            ObjectEdit::Sphere { radius, material, .. } => {
                check_range("radius (meters)", radius, SIZES)?;
                material.material().map(|_| ())
            }
        }
    }

    /// The file of its model.
    fn file(&self) -> Option<(&File, &[File])> {
        match self {
            ObjectEdit::Mesh { path, parts, .. } => Some((path, parts)),
            ObjectEdit::Sphere { .. } => None,
        }
    }

    /// The object at its place; its model is wanted `again` by another one.
    fn body<'a>(
        &'a self,
        number: usize,
        again: bool,
        ground: &Ground,
        models: &mut Models<'a>,
        ctx: &Context,
    ) -> Result<Body, NodeError> {
        let failed =
            |message: String| NodeError::BadParameter(format!("objects: {number}: {message}"));
        match self {
            ObjectEdit::Sphere { radius, at, material } => {
                let material = material.material().map_err(failed)?;
                let center = match *at {
                    Place::Point(x, y, z) => Vec3::new(x, y, z),
                    Place::Pixel { x, y, lift } => {
                        let (foot, normal) = ground.foot(x, y).map_err(failed)?;
                        foot + normal * (radius + lift)
                    }
                };
                Ok(Body::placed(
                    Model::sphere(),
                    Some(material),
                    Mat3::IDENTITY,
                    *radius,
                    Vec3::ZERO,
                    center,
                ))
            }
            ObjectEdit::Mesh { path, at, height, yaw, material, parts } => {
                let material =
                    material.as_ref().map(ObjectMaterial::material).transpose().map_err(failed)?;
                let model = models.read(path, parts, again, ctx)?;
                let (low, high) = model.bounds();
                let tall = tall(&model, path)?;
                let bottom = Vec3::new(0.5 * (low.x + high.x), low.y, 0.5 * (low.z + high.z));
                let place = match *at {
                    Place::Point(x, y, z) => Vec3::new(x, y, z),
                    Place::Pixel { x, y, lift } => {
                        ground.foot(x, y).map_err(failed)?.0 + ground.up * lift
                    }
                };
                let turn = upright(ground.up, *yaw);
                Ok(Body::placed(model, material, turn, height / tall, bottom, place))
            }
        }
    }
}
