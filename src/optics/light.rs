//! Light sources: where they are and how they emit, apart from how strongly.

use glam::Vec3;
use serde::{Deserialize, Serialize};

/// The place, extent and angular form of a light; its strength is a [`Radiance`], one colour per lobe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Shape {
    /// There is no such light: no lobe, no layer.
    Absent,
    /// A surface of Lambertian radiance: one lobe.
    Lamp(Lamp),
    /// A rectangle that shows a distant surrounding of three spherical Gaussians: sun, sky, ground.
    Window(Window),
}

impl Shape {
    /// How many lobes, and so how many layers and radiances, this light has.
    pub fn lobes(&self) -> usize {
        match self {
            Shape::Absent => 0,
            Shape::Lamp(_) => 1,
            Shape::Window(_) => 3,
        }
    }
}

/// The emitting surface of a lamp, camera space, metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Lamp {
    Sphere {
        center: Vec3,
        radius: f32,
    },
    /// Emits from the side that `x cross y` points to; `x` and `y` are half edges.
    Rect {
        center: Vec3,
        x: Vec3,
        y: Vec3,
    },
    /// Emits outwards; `axes` are half edges, orthogonal to each other.
    Box {
        center: Vec3,
        axes: [Vec3; 3],
    },
    /// Small oriented pieces of surface, each emitting from its front: the paper's visible lamp.
    Plates(Vec<Plate>),
    /// Triangles, emitting from the side where their corners run counter-clockwise.
    Mesh {
        corners: Vec<Vec3>,
        triangles: Vec<[u32; 3]>,
    },
}

/// A small piece of emitting surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plate {
    pub point: Vec3,
    /// Unit length.
    pub normal: Vec3,
    /// Square metres.
    pub area: f32,
}

/// `x` and `y` are half edges; the room lies on the side that `x cross y` points to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Window {
    pub center: Vec3,
    pub x: Vec3,
    pub y: Vec3,
    /// Sun, sky, ground.
    pub lobes: [Lobe; 3],
}

/// A spherical Gaussian of unit weight: G(l) = exp(bandwidth (direction . l - 1)).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lobe {
    /// Unit length; from the scene to the light.
    pub direction: Vec3,
    /// 0 is uniform; the sun's disc is about 1e5.
    pub bandwidth: f32,
}

/// The radiance of each lobe, linear RGB in units of the photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Radiance(pub Vec<Vec3>);

/// What kind of light a mask marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LightKind {
    Lamp,
    Window,
}
