//! Stages that apply an edit: lights, materials, objects.

pub mod edit_lights;
pub mod edit_materials;
pub mod edit_objects;

use std::ops::RangeInclusive;

use glam::{Mat3, Vec2, Vec3};
use serde::{Deserialize, Serialize};

use crate::geometry::{self, Camera, Model, PlaneFit};
use crate::graph::{Context, File, NodeError, check_range};
use crate::image::{Depth, Normal, Transfer};
use crate::tuning::{Table, tuning};

/// An albedo in the form that an edit gives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Color {
    /// sRGB, as pictures show it: `"#c8642a"`.
    Srgb(String),
    /// Linear Rec.709, 0..=1.
    Linear(f32, f32, f32),
}

impl Color {
    /// Linear Rec.709.
    fn linear(&self) -> Result<Vec3, String> {
        match self {
            Color::Srgb(text) => {
                let digits = text
                    .strip_prefix('#')
                    .filter(|d| d.len() == 6 && d.chars().all(|c| c.is_ascii_hexdigit()));
                let number = digits.and_then(|digits| u32::from_str_radix(digits, 16).ok());
                let number = number.ok_or_else(|| {
                    format!("Srgb: wanted a color like \"#c8642a\", got {text:?}")
                })?;
                let [_, rgb @ ..] = number.to_be_bytes();
                Ok(Vec3::from_array(rgb.map(|c| Transfer::Srgb.decode(f32::from(c) / 255.0))))
            }
            &Color::Linear(r, g, b) => {
                check_range("Linear", &[r, g, b], 0.0..=1.0)?;
                Ok(Vec3::new(r, g, b))
            }
        }
    }
}

/// Position of an inserted light or object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Place {
    /// On the surface seen at a photo pixel. The center of a lamp is `lift` meters above it along
    /// its normal, at least so far that the lamp does not sink in; an object stands `lift` meters
    /// above it.
    Pixel {
        /// Photo pixels from the left.
        x: f32,
        /// Photo pixels from the top.
        y: f32,
        /// Meters above the surface.
        #[serde(default)]
        lift: f32,
    },
    /// Camera space, meters.
    Point(f32, f32, f32),
}

/// The seen surface, on which lights and objects are placed.
pub struct Ground<'a> {
    /// The camera of the photo.
    pub camera: &'a Camera,
    /// Planar z at the photo's size.
    pub depth: &'a Depth,
    /// Normals at any size.
    pub normal: &'a Normal,
    /// The world's up.
    pub up: Vec3,
}

tuning! {
    /// Constants of the place on a surface where a thing stands.
    pub const TUNING: GroundTuning {
        /// Radius within which a surface is examined.
        foot: f32 = 0.012,
            unit "fraction of the photo's longer side", source Taste,
            effect "a larger value averages more of an uneven surface";
        /// Steps of the examined pixels on either side of the middle.
        steps: i32 = 3,
            unit "steps", source Taste, effect "a larger value is slower and more exact";
        /// Largest distance of points from their plane.
        on_plane: f32 = 0.02,
            unit "fraction of the distance from the camera", source Derived("noise of depth maps"),
            effect "a larger value accepts rougher surfaces";
        /// Cosine between the normals of the plane and of the pixel that must be exceeded; else the
        /// pixel alone counts.
        same_normal: f32 = 0.8,
            unit "1", source Taste, effect "a larger value trusts single pixels more";
        /// Cosine between the normal and the upward direction above which a surface counts as
        /// level, 20 degrees.
        level: f32 = 0.94,
            unit "1", source Taste, effect "a smaller value sets things upright on steeper surfaces";
        /// Largest height of a model that counts as none.
        min_height: f32 = 1e-6,
            unit "largest side of its bounding box", source Derived("single precision"),
            effect "a larger value refuses flat models";
    }
}

impl Ground<'_> {
    /// The surface seen at a photo pixel: its point and normal.
    ///
    /// # Errors
    /// The pixel is outside the photo.
    pub fn surface_at(&self, x: f32, y: f32) -> Result<(Vec3, Vec3), String> {
        let camera = self.camera;
        if !camera.contains(Vec2::new(x, y)) {
            return Err(format!(
                "Pixel(x: {x}, y: {y}) is outside the photo, wanted 0..{} and 0..{}",
                camera.width, camera.height
            ));
        }
        let (w, h) = self.normal.0.size();
        let normal = self.normal.0.get(
            ((x / camera.width as f32 * w as f32) as usize).min(w - 1),
            ((y / camera.height as f32 * h as f32) as usize).min(h - 1),
        );
        Ok((camera.unproject(x, y, self.depth.0.get(x as usize, y as usize)), normal))
    }

    /// The place on the surface seen at a photo pixel, and the surface's normal: on the plane
    /// through the points around it, since depth may come in steps. A surface that is level to 20
    /// degrees counts as level.
    ///
    /// # Errors
    /// The pixel is outside the photo.
    pub fn foot(&self, x: f32, y: f32) -> Result<(Vec3, Vec3), String> {
        let (own, own_normal) = self.surface_at(x, y)?;
        let camera = self.camera;
        let reach = (TUNING.foot * camera.width.max(camera.height) as f32).ceil();
        let steps =
            || (-TUNING.steps..=TUNING.steps).map(|i| i as f32 / TUNING.steps as f32 * reach);
        let places = steps().flat_map(|dy| steps().map(move |dx| (x + dx, y + dy)));
        let (points, normals): (Vec<Vec3>, Vec<Vec3>) =
            places.filter_map(|(x, y)| self.surface_at(x, y).ok()).unzip();
        let plane = PlaneFit::through(&points, &normals, TUNING.on_plane);
        let plane = plane.filter(|plane| plane.normal.dot(own_normal) > TUNING.same_normal);
        let (point, normal) = plane
            .and_then(|plane| Some((plane.intersect(camera.unproject(x, y, 1.0))?, plane.normal)))
            .unwrap_or((own, own_normal));
        Ok((point, if normal.dot(self.up) > TUNING.level { self.up } else { normal }))
    }
}

/// The constants of edits.
pub fn tuning() -> Vec<Table> {
    [
        vec![GroundTuning::table(), edit_materials::EditMaterialsTuning::table()],
        edit_lights::tuning(),
    ]
    .concat()
}

/// The level directions to the right of the view and ahead.
pub fn level(up: Vec3) -> (Vec3, Vec3) {
    let right = Vec3::NEG_Z.cross(up).try_normalize().unwrap_or(Vec3::X);
    (right, up.cross(right))
}

/// Sizes of an object or a lamp in a room, meters.
const SIZES: RangeInclusive<f32> = 1e-4..=1e3;

fn check_model(path: &File, height: f32) -> Result<(), String> {
    if path.path.is_empty() {
        return Err("path: wanted a file, got none".into());
    }
    check_range("height (meters)", &height, SIZES)
}

/// The file of a model and those that it names, which are looked for here.
fn model_files<'a>(
    path: &'a mut File,
    parts: &'a mut Vec<File>,
) -> impl Iterator<Item = &'a mut File> {
    if parts.is_empty() {
        *parts = named_by(path);
    }
    std::iter::once(path).chain(parts)
}

/// The files that a model names, beside it.
fn named_by(file: &File) -> Vec<File> {
    let read = |file: File| file.read_unchecked();
    let names =
        geometry::named_files(&file.path, || read(file.clone()), &|name| read(file.sibling(name)));
    // Without a folder: the engine gives them theirs, and notes where they were named.
    names.iter().map(|name| File::new(file.sibling(name).path)).collect()
}

/// A model; its warnings become warnings of the stage.
fn read_model(path: &File, parts: &[File], ctx: &Context) -> Result<Model, NodeError> {
    let bytes = ctx.read(path)?;
    let bad = |message: String| NodeError::BadFile {
        path: path.location().display().to_string(),
        message,
    };
    let mut unread = None;
    let mut part = |name: &str| {
        let wanted = path.sibling(name);
        let file = parts.iter().find(|file| file.path == wanted.path);
        let read = file
            .ok_or_else(|| format!("it names {name}, which is missing"))
            .map(|file| ctx.read(file))?;
        read.map_err(|e| {
            let message = e.to_string();
            unread = Some(e);
            message
        })
    };
    let model = Model::read(&path.path, &bytes, &mut part);
    let model = match (model, unread) {
        (_, Some(error)) => return Err(error),
        (model, None) => model.map_err(bad)?,
    };
    model.warnings.iter().for_each(|warning| ctx.warn(format!("{}: {warning}", path.path)));
    Ok(model)
}

/// Height of a model in its own units.
fn tall(model: &Model, path: &File) -> Result<f32, NodeError> {
    let (low, high) = model.bounds();
    let tall = high.y - low.y;
    if tall.is_nan() || tall <= TUNING.min_height * (high - low).max_element() {
        let message = format!(
            "wanted a model with a height (along its y), got one from y = {} to {}",
            low.y, high.y
        );
        return Err(NodeError::BadFile { path: path.location().display().to_string(), message });
    }
    Ok(tall)
}

/// Sets a model upright, its z to the camera, and turns it by `yaw` degrees to the left, seen from
/// above.
fn upright(up: Vec3, yaw: f32) -> Mat3 {
    let (right, ahead) = level(up);
    Mat3::from_cols(right, up, -ahead) * Mat3::from_rotation_y(yaw.to_radians())
}
