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

impl Lamp {
    /// Emitting area, square metres.
    pub fn area(&self) -> f32 {
        match self {
            Lamp::Sphere { radius, .. } => 4.0 * std::f32::consts::PI * radius * radius,
            Lamp::Rect { x, y, .. } => 4.0 * x.cross(*y).length(),
            Lamp::Box { axes: [a, b, c], .. } => {
                8.0 * (a.cross(*b).length() + b.cross(*c).length() + c.cross(*a).length())
            }
            Lamp::Plates(plates) => plates.iter().map(|p| p.area).sum(),
            Lamp::Mesh { corners, triangles } => triangles
                .iter()
                .map(|t| t.map(|i| corners[i as usize]))
                .map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length())
                .sum(),
        }
    }
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

impl Window {
    /// Lobes of a surrounding without a seen sun, for a window whose room side is `normal`: the sun's own lobe stands ready at
    /// half height, sky and ground are broad, above and below what lies straight outside.
    pub fn daylight(normal: Vec3) -> [Lobe; 3] {
        let towards = |up: f32| (Vec3::Y * up - normal).try_normalize().unwrap_or(-normal);
        [
            Lobe { direction: towards(1.0), bandwidth: 1e4 },
            Lobe { direction: towards(1.0), bandwidth: 1.5 },
            Lobe { direction: towards(-1.0), bandwidth: 1.5 },
        ]
    }

    /// Radiance seen along unit `direction`, from the scene outwards, for lobe weights `radiance`.
    pub fn seen(&self, radiance: &[Vec3], direction: Vec3) -> Vec3 {
        self.lobes
            .iter()
            .zip(radiance)
            .map(|(lobe, &w)| w * (lobe.bandwidth * (lobe.direction.dot(direction) - 1.0)).exp())
            .sum()
    }
}

/// A spherical Gaussian of unit weight: G(l) = exp(bandwidth (direction . l - 1)).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lobe {
    /// Unit length; from the scene to the light.
    pub direction: Vec3,
    /// 0 is uniform; the sun's disc is about 1e5.
    pub bandwidth: f32,
}

/// What a mask of a visible light shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LightKind {
    Lamp,
    Window,
}

/// The radiance of each lobe, linear RGB in units of the photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Radiance(pub Vec<Vec3>);
