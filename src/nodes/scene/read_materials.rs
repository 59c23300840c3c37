//! `ReadMaterials`: known materials, in the place of estimated ones.

use std::sync::Arc;

use glam::Vec3;

use crate::geometry::Camera;
use crate::graph::{Context, File, Node, NodeError};
use crate::image::{self, Albedo, Normal, Plane, Roughness, Transfer};
use crate::tuning::tuning;
use crate::{params, ports};

params! {
    /// Reads true materials from files, in the place of `RetinexMaterials`.
    ///
    /// Files of any size with the photo's aspect ratio are resized to the working size by area
    /// averages.
    pub struct ReadMaterials {
        /// Diffuse albedo in 0..=1: EXR (R, G, B, linear Rec.709), or PNG or JPEG (sRGB); `truth:
        /// (albedo: ..)` of a scene.
        albedo: File = File::default(),
        /// Normals in camera space: EXR with X, Y, Z, else R, G, B. The normals of the depth
        /// replace a missing file and pixels without a normal that faces the camera.
        normal: Option<File> = None,
        /// GGX roughness in 0..=1: EXR (Y), or PNG or JPEG with linear values; the green channel of
        /// colors.
        roughness: Option<File> = None,
        /// Roughness of every pixel without a file, 0..=1.
        rough: f32 = 0.8, in 0.0..=1.0,
    }
}

ports! {
    pub input ReadMaterialsIn {
        /// The normals of the depth, at working size.
        normal: Arc<Normal>,
        /// The camera; resized to `normal`.
        camera: Arc<Camera>,
    }
}

ports! {
    pub output ReadMaterialsOut {
        /// Albedo at working size.
        albedo: Arc<Albedo>,
        /// Normals at working size.
        normal: Arc<Normal>,
        /// Roughness at working size.
        roughness: Arc<Roughness>,
    }
}

impl Node for ReadMaterials {
    const KIND: &'static str = "ReadMaterials";
    const VERSION: u32 = 1;
    type In = ReadMaterialsIn;
    type Out = ReadMaterialsOut;

    fn check_consistency(&self) -> Result<(), String> {
        if self.albedo.path.is_empty() {
            return Err("albedo: wanted a file, got none; a scene names it as `truth: (albedo: \"albedo.exr\")`".into());
        }
        Ok(())
    }

    fn files(&mut self) -> Vec<&mut File> {
        let albedo = Some(&mut self.albedo).filter(|file| !file.path.is_empty());
        albedo.into_iter().chain(&mut self.normal).chain(&mut self.roughness).collect()
    }

    fn run(&self, inputs: ReadMaterialsIn, ctx: &Context) -> Result<ReadMaterialsOut, NodeError> {
        let size = inputs.normal.0.size();
        let shares = |name: &str, file: &File, transfer: Transfer| {
            let read = super::open(ctx, file, |source| image::read_photo(source, transfer))?;
            super::warn(ctx, file, &read.warnings);
            let plane = fitted(name, file, &read.picture.0, size)?;
            if let Some(at) = plane
                .pixels()
                .iter()
                .position(|c| c.min_element() < 0.0 || c.max_element() > 1.0 + TUNING.slack)
            {
                let (x, y, got) = (at % size.0, at / size.0, plane.pixels()[at]);
                return Err(super::bad(
                    file,
                    format!("{name}: wanted 0..=1, got {got} at working pixel ({x}, {y})"),
                ));
            }
            Ok(plane.map(|c| c.min(Vec3::ONE)))
        };
        let albedo = shares("albedo", &self.albedo, Transfer::Srgb)?;
        ctx.check_cancelled()?;
        let roughness = match &self.roughness {
            Some(file) => shares("roughness", file, Transfer::Linear)?.map(|c| c.y),
            None => Plane::filled(size.0, size.1, self.rough),
        };
        ctx.check_cancelled()?;
        let normal = match &self.normal {
            Some(file) => {
                let read = super::open(ctx, file, image::read_normal)?;
                let read = fitted("normal", file, &read, size)?;
                Arc::new(valid_normals(
                    &read,
                    &inputs.normal,
                    &inputs.camera.resized(size.0, size.1),
                ))
            }
            None => inputs.normal,
        };
        Ok(ReadMaterialsOut {
            albedo: Arc::new(Albedo(albedo)),
            normal,
            roughness: Arc::new(Roughness(roughness)),
        })
    }
}

tuning! {
    /// Constants of the check of material files.
    pub const TUNING: ReadMaterialsTuning {
        /// Rounding error by which a value may exceed one.
        slack: f32 = 1e-3,
            unit "albedo", source Derived("resampling and half floats"), effect "a larger value accepts wrong units";
    }
}

/// A plane of a file at working size.
fn fitted(
    name: &str,
    file: &File,
    plane: &Plane<Vec3>,
    size: (usize, usize),
) -> Result<Plane<Vec3>, NodeError> {
    if !image::same_aspect(plane.size(), size) {
        let (wanted, got) = (super::size(size), super::size(plane.size()));
        return Err(super::bad(
            file,
            format!("{name} size: wanted the aspect ratio of {wanted} to 2 %, got {got}"),
        ));
    }
    Ok(image::resize(plane, size.0, size.1))
}

/// Unit normals of the file, and `else_normal` where it has none that faces the camera.
fn valid_normals(read: &Plane<Vec3>, else_normal: &Normal, camera: &Camera) -> Normal {
    let (width, height) = read.size();
    Normal(Plane::from_fn(width, height, |x, y| {
        let normal = read.get(x, y).normalize_or_zero();
        let ray = camera.pixel_point(x, y, 1.0);
        if normal.dot(ray) < 0.0 { normal } else { else_normal.0.get(x, y) }
    }))
}
