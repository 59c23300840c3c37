//! Inserted and moved lamps.

use glam::{Mat3, Quat, Vec3};
use serde::{Deserialize, Serialize};

use super::{EditLightsIn, Place, check_model, level, read_model, tall, upright};
use crate::graph::{Context, File, NodeError, above, check_range};
use crate::optics::{
    BoxLamp, Lamp, MeshLamp, PhotometricLamp, PhotometricWeb, PhotometricWebTable, RectLamp, Shape,
    SphereLamp,
};

/// The form of an inserted lamp, meters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum LampShape {
    Sphere {
        radius: f32,
    },
    /// Emits to the side of `normal`; `half` edges.
    Rect {
        half: [f32; 2],
        normal: [f32; 3],
    },
    /// Upright; `half` edges along x, y, z, turned about y by `yaw` degrees.
    Box {
        half: [f32; 3],
        #[serde(default)]
        yaw: f32,
    },
    /// A model, its y upwards, that shines to the outside of its triangles.
    Mesh {
        /// PLY, OBJ, glTF or GLB.
        path: File,
        /// Meters from its lowest to its highest point.
        height: f32,
        /// Degrees to the left, seen from above; at 0 its z points to the camera.
        #[serde(default)]
        yaw: f32,
        /// The files that the model names; found by themselves.
        #[serde(default)]
        parts: Vec<File>,
    },
}

/// Most triangles of a lamp.
const MOST_TRIANGLES: usize = 1_000_000;

impl LampShape {
    /// Checks the numbers of the shape.
    ///
    /// # Errors
    /// The first number that is out of range.
    pub fn check(&self) -> Result<(), String> {
        match self {
            LampShape::Sphere { radius } => check_range("radius (meters)", radius, above(0.0)),
            LampShape::Rect { half, normal } => {
                check_range("half (meters)", half, above(0.0))?;
                direction("normal", *normal).map(drop)
            }
            LampShape::Box { half, .. } => check_range("half (meters)", half, above(0.0)),
            LampShape::Mesh { path, height, .. } => check_model(path, *height),
        }
    }

    /// The lamp at its place.
    ///
    /// # Errors
    /// The model of the lamp cannot be used, or the position is outside the photo.
    pub fn at(
        &self,
        at: &Place,
        inputs: &EditLightsIn,
        up: Vec3,
        failed: &dyn Fn(String) -> NodeError,
        ctx: &Context,
    ) -> Result<Lamp, NodeError> {
        let center = Vec3::ZERO;
        let lamp = match self {
            LampShape::Sphere { radius } => Lamp::Sphere(SphereLamp { center, radius: *radius }),
            LampShape::Rect { half, normal } => {
                let normal = Vec3::from_array(*normal).normalize();
                // `x` level, so that the first half edge runs along the floor.
                let x = up
                    .cross(normal)
                    .try_normalize()
                    .unwrap_or_else(|| normal.any_orthonormal_vector());
                Lamp::Rect(RectLamp { center, x: x * half[0], y: normal.cross(x) * half[1] })
            }
            LampShape::Box { half, yaw } => {
                let (right, ahead) = level(up);
                let (sin, cos) = yaw.to_radians().sin_cos();
                let (x, z) = (right * cos + ahead * sin, right * sin - ahead * cos);
                Lamp::Box(BoxLamp { center, axes: [x * half[0], up * half[1], z * half[2]] })
            }
            LampShape::Mesh { path, height, yaw, parts } => {
                model(path, parts, upright(up, *yaw), *height, ctx)?
            }
        };
        let reach = |normal: Vec3| match self {
            LampShape::Sphere { radius } => *radius,
            LampShape::Rect { .. } => 0.0,
            LampShape::Box { half, .. } => half[1],
            LampShape::Mesh { .. } => lamp.extent(-normal),
        };
        Ok(lamp.moved(self::center(at, inputs, up, reach).map_err(failed)?))
    }
}

/// A model as a lamp about the origin.
fn model(
    path: &File,
    parts: &[File],
    turn: Mat3,
    height: f32,
    ctx: &Context,
) -> Result<Lamp, NodeError> {
    let model = read_model(path, parts, ctx)?;
    let scale = height / tall(&model, path)?;
    let count = model.triangles.len();
    if count > MOST_TRIANGLES {
        let message = format!("wanted up to {MOST_TRIANGLES} triangles for a lamp, got {count}");
        return Err(NodeError::BadFile { path: path.location().display().to_string(), message });
    }
    let (low, high) = model.bounds();
    // Corners of no triangle would count as parts of its extent.
    let mut number = vec![u32::MAX; model.positions.len()];
    let mut corners = Vec::new();
    let mut of = |i: u32| {
        let slot = &mut number[i as usize];
        if *slot == u32::MAX {
            *slot = corners.len() as u32;
            corners.push(turn * (model.positions[i as usize] - 0.5 * (low + high)) * scale);
        }
        *slot
    };
    let triangles = model.triangles.iter().map(|t| t.map(&mut of)).collect();
    let lamp = Lamp::Mesh(MeshLamp::new(corners, triangles));
    let middle =
        Shape::Lamp(lamp.clone()).bounding_sphere().map_or(Vec3::ZERO, |(middle, _)| middle);
    Ok(lamp.moved(-middle))
}

/// The unit vector along `direction`.
///
/// # Errors
/// The vector, called `name`, is zero or not finite.
pub fn direction(name: &str, direction: [f32; 3]) -> Result<Vec3, String> {
    let unit = Vec3::from_array(direction).try_normalize();
    unit.ok_or_else(|| format!("{name}: wanted a direction, got {direction:?}"))
}

/// Center of a lamp; on a surface, at least the lamp's extent against its normal away from it.
fn center(
    at: &Place,
    inputs: &EditLightsIn,
    up: Vec3,
    reach: impl Fn(Vec3) -> f32,
) -> Result<Vec3, String> {
    match *at {
        Place::Point(x, y, z) => Ok(Vec3::new(x, y, z)),
        Place::Pixel { x, y, lift } => {
            let (point, normal) = inputs.ground(up).foot(x, y)?;
            Ok(point + normal * lift.max(reach(normal)))
        }
    }
}

/// A sphere that emits by the profile in `file`, and the lumens of the file. The profile's angle 0
/// points along `axis`, or down; its second angle begins at the right of the view and is turned by
/// `turn` degrees.
///
/// # Errors
/// The photometric file cannot be used.
///
/// # Panics
/// The lamp is not a sphere.
pub fn luminaire(
    lamp: Lamp,
    file: &File,
    axis: Option<[f32; 3]>,
    turn: f32,
    up: Vec3,
    ctx: &Context,
) -> Result<(Lamp, f32), NodeError> {
    let Lamp::Sphere(SphereLamp { center, radius }) = lamp else {
        unreachable!("profiles were checked to go with spheres")
    };
    let read = ctx.shared(file, "profile", |bytes| {
        let path = file.location().display().to_string();
        PhotometricWebTable::parse(&String::from_utf8_lossy(&bytes))
            .map_err(|message| NodeError::BadFile { path, message })
    })?;
    let (table, lumens) = &*read;
    let axis = axis.and_then(|axis| Vec3::from_array(axis).try_normalize()).unwrap_or(-up);
    let (right, ahead) = level(up);
    let across =
        |v: Vec3| (v - axis * v.dot(axis)).try_normalize().filter(|_| v.dot(axis).abs() < 0.999);
    let side =
        across(right).or_else(|| across(ahead)).unwrap_or_else(|| axis.any_orthonormal_vector());
    let side = Quat::from_axis_angle(axis, turn.to_radians()) * side;
    let profile = PhotometricWeb { axis, side, table: table.clone() };
    Ok((Lamp::Photometric(PhotometricLamp { center, radius, web: profile }), *lumens as f32))
}

/// An existing lamp at another position: `by` meters further, or with its middle at `to`.
///
/// # Errors
/// The light is not a lamp, or the position cannot be used.
pub fn moved(
    shape: &Shape,
    by: Option<[f32; 3]>,
    to: Option<&Place>,
    inputs: &EditLightsIn,
    up: Vec3,
) -> Result<Lamp, String> {
    let (lamp, middle) = match (shape, shape.bounding_sphere()) {
        (Shape::Lamp(lamp), Some((middle, _))) => (lamp, middle),
        (Shape::Window(_), _) => return Err("Move: wanted a lamp, got a window".into()),
        _ => {
            return Err(
                "Move: no such lamp was estimated: the photo is explained without it".into()
            );
        }
    };
    let by = match to {
        None => by.map(Vec3::from_array).unwrap_or_default(),
        // A sphere around it may reach farther down than it does; a lamp is put as low as its own
        // points allow.
        Some(place) => center(place, inputs, up, |normal| lamp.extent(-normal))? - middle,
    };
    Ok(lamp.moved(by))
}
