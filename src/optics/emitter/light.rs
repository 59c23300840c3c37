//! Light sources: where they are and how they emit, apart from how strongly.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::geometry::bounds;
use crate::image::rule;
use crate::optics::Profile;

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
    /// Whether the triangles and tables of a light that was read from disk are whole.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub fn check(&self) -> Result<(), String> {
        match self {
            Shape::Lamp(Lamp::Mesh { corners, triangles } | Lamp::Model { corners, triangles }) => {
                let known = triangles.iter().flatten().all(|&corner| (corner as usize) < corners.len());
                rule(known && !triangles.is_empty(), "triangles of corners that are there")
            }
            Shape::Lamp(Lamp::Luminaire { profile, .. }) => profile.table.check(),
            _ => Ok(()),
        }
    }

    /// How many lobes, and so how many layers and radiances, this light has.
    pub fn lobes(&self) -> usize {
        match self {
            Shape::Absent => 0,
            Shape::Lamp(_) => 1,
            Shape::Window(_) => 3,
        }
    }

    /// Memory held, in bytes.
    pub fn bytes(&self) -> usize {
        let held = match self {
            Shape::Lamp(Lamp::Plates(plates)) => size_of_val(plates.as_slice()),
            Shape::Lamp(Lamp::Mesh { corners, triangles } | Lamp::Model { corners, triangles }) => {
                size_of_val(corners.as_slice()) + size_of_val(triangles.as_slice())
            }
            Shape::Lamp(Lamp::Luminaire { profile, .. }) => profile.table.bytes(),
            _ => 0,
        };
        size_of::<Shape>() + held
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
    /// A sphere that shines by a profile: into each direction its share of what a sphere of even radiance sends there.
    Luminaire {
        center: Vec3,
        radius: f32,
        profile: Profile,
    },
    /// As [`Lamp::Mesh`], of any form and any number of triangles: what lies before another hides it.
    Model {
        corners: Vec<Vec3>,
        triangles: Vec<[u32; 3]>,
    },
}

impl Lamp {
    /// The same lamp `by` further. Plates become squares, as the photo has no pixels of theirs at the new place.
    pub fn moved(&self, by: Vec3) -> Lamp {
        match self.clone() {
            Lamp::Sphere { center, radius } => Lamp::Sphere { center: center + by, radius },
            Lamp::Rect { center, x, y } => Lamp::Rect { center: center + by, x, y },
            Lamp::Box { center, axes } => Lamp::Box { center: center + by, axes },
            Lamp::Plates(plates) => {
                let corners: Vec<Vec3> = plates.iter().flat_map(Plate::square).flatten().map(|p| p + by).collect();
                let triangles = (0..corners.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
                Lamp::Mesh { corners, triangles }
            }
            Lamp::Mesh { corners, triangles } => {
                Lamp::Mesh { corners: corners.into_iter().map(|p| p + by).collect(), triangles }
            }
            Lamp::Luminaire { center, radius, profile } => Lamp::Luminaire { center: center + by, radius, profile },
            Lamp::Model { corners, triangles } => {
                Lamp::Model { corners: corners.into_iter().map(|p| p + by).collect(), triangles }
            }
        }
    }

    /// How far the lamp reaches from the middle of [`Shape::ball`] in a direction of unit length.
    pub fn reach(&self, direction: Vec3) -> f32 {
        let beyond = |points: &mut dyn Iterator<Item = Vec3>| {
            let points: Vec<Vec3> = points.collect();
            let (low, high) = bounds(points.iter().copied());
            let middle = 0.5 * (low + high);
            points.iter().map(|p| (*p - middle).dot(direction)).fold(0.0, f32::max)
        };
        match self {
            Lamp::Sphere { radius, .. } | Lamp::Luminaire { radius, .. } => *radius,
            Lamp::Rect { x, y, .. } => x.dot(direction).abs() + y.dot(direction).abs(),
            Lamp::Box { axes, .. } => axes.iter().map(|axis| axis.dot(direction).abs()).sum(),
            Lamp::Plates(plates) => beyond(&mut plates.iter().map(|plate| plate.point)),
            Lamp::Mesh { corners, .. } | Lamp::Model { corners, .. } => beyond(&mut corners.iter().copied()),
        }
    }

    /// Emitting area, square metres.
    pub fn area(&self) -> f32 {
        match self {
            Lamp::Sphere { radius, .. } | Lamp::Luminaire { radius, .. } => {
                4.0 * std::f32::consts::PI * radius * radius
            }
            Lamp::Rect { x, y, .. } => 4.0 * x.cross(*y).length(),
            Lamp::Box { axes: [a, b, c], .. } => {
                8.0 * (a.cross(*b).length() + b.cross(*c).length() + c.cross(*a).length())
            }
            Lamp::Plates(plates) => plates.iter().map(|p| p.area).sum(),
            Lamp::Mesh { corners, triangles } | Lamp::Model { corners, triangles } => triangles
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

impl Plate {
    /// A square of this area and normal, as two triangles, counter-clockwise as seen from where it shines to.
    pub fn square(&self) -> [[Vec3; 3]; 2] {
        let x = self.normal.any_orthonormal_vector() * (0.5 * self.area.sqrt());
        rectangle(self.point, x, self.normal.cross(x))
    }
}

/// The two triangles of a rectangle with half edges `x` and `y`, counter-clockwise as seen from where x cross y points to.
pub(in crate::optics) fn rectangle(center: Vec3, x: Vec3, y: Vec3) -> [[Vec3; 3]; 2] {
    let corner = |u: f32, v: f32| center + u * x + v * y;
    [
        [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0)],
        [corner(-1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
    ]
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

/// What the lobes of a window are called, in their order.
pub const LOBES: [&str; 3] = ["sun", "sky", "ground"];

/// What a mask of a visible light shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum LightKind {
    Lamp,
    Window,
}

/// The radiance of each lobe, linear RGB in units of the photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Radiance(pub Vec<Vec3>);

/// Where the camera sees a light itself.
impl Shape {
    /// Distance from `origin` along `ray`, in lengths of `ray`, to the emitting side of this light; `None` when the ray does not
    /// meet it. [`Lamp::Plates`] are never met: thinned, they have gaps, and the pixels they come from are the lamp's own in the
    /// photo.
    pub fn meet_from(&self, origin: Vec3, ray: Vec3) -> Option<f32> {
        let rect = |center: Vec3, x: Vec3, y: Vec3| {
            let center = center - origin;
            let normal = x.cross(y);
            let facing = normal.dot(ray);
            let t = normal.dot(center) / facing;
            let at = ray * t - center;
            let within = at.dot(x).abs() <= x.length_squared() && at.dot(y).abs() <= y.length_squared();
            (facing < 0.0 && t > 0.0 && within).then_some(t)
        };
        match self {
            Shape::Absent | Shape::Lamp(Lamp::Plates(_)) => None,
            Shape::Lamp(Lamp::Sphere { center, radius } | Lamp::Luminaire { center, radius, .. }) => {
                let center = *center - origin;
                let (a, b, c) = (ray.length_squared(), ray.dot(center), center.length_squared() - radius * radius);
                let root = b * b - a * c;
                let t = (b - root.max(0.0).sqrt()) / a;
                (root >= 0.0 && t > 0.0).then_some(t)
            }
            Shape::Lamp(Lamp::Rect { center, x, y }) => rect(*center, *x, *y),
            Shape::Window(window) => rect(window.center, window.x, window.y),
            Shape::Lamp(Lamp::Box { center, axes }) => (0..6)
                .filter_map(|face| {
                    let [a, b, c] = [0, 1, 2].map(|i| axes[(face / 2 + i) % 3]);
                    let (a, side) = if face % 2 == 0 { (a, 1.0) } else { (-a, -1.0) };
                    let handed = if b.cross(c).dot(a) * side > 0.0 { side } else { -side };
                    rect(*center + a, b, c * handed)
                })
                .reduce(f32::min),
            Shape::Lamp(Lamp::Mesh { corners, triangles } | Lamp::Model { corners, triangles }) => triangles
                .iter()
                .filter_map(|t| {
                    let [a, b, c] = t.map(|i| corners[i as usize] - origin);
                    let normal = (b - a).cross(c - a);
                    let facing = normal.dot(ray);
                    let t = normal.dot(a) / facing;
                    let at = ray * t;
                    let inside = [(a, b), (b, c), (c, a)].iter().all(|(p, q)| (q - p).cross(at - p).dot(normal) >= 0.0);
                    (facing < 0.0 && t > 0.0 && inside).then_some(t)
                })
                .reduce(f32::min),
        }
    }

    /// What one lobe of unit radiance shows along unit `direction`, from the scene to the light.
    pub fn shown(&self, lobe: usize, direction: Vec3) -> f32 {
        match self {
            Shape::Window(window) => {
                let Lobe { direction: peak, bandwidth } = window.lobes[lobe];
                (bandwidth * (peak.dot(direction) - 1.0)).exp()
            }
            Shape::Lamp(Lamp::Luminaire { profile, .. }) => profile.share(-direction.as_dvec3()) as f32,
            _ => 1.0,
        }
    }

    /// A ball (centre, radius) that holds the light; `None` for [`Shape::Absent`] and an empty one.
    pub fn ball(&self) -> Option<(Vec3, f32)> {
        let around = |points: &mut dyn Iterator<Item = Vec3>| {
            let (low, high) = bounds(points);
            low.is_finite().then(|| (0.5 * (low + high), 0.5 * (high - low).length()))
        };
        match self {
            Shape::Absent => None,
            Shape::Lamp(Lamp::Sphere { center, radius } | Lamp::Luminaire { center, radius, .. }) => {
                Some((*center, *radius))
            }
            Shape::Lamp(Lamp::Rect { center, x, y }) => Some((*center, (*x + *y).length().max((*x - *y).length()))),
            Shape::Window(w) => Some((w.center, (w.x + w.y).length().max((w.x - w.y).length()))),
            Shape::Lamp(Lamp::Box { center, axes: [a, b, c] }) => {
                Some((*center, (a.length_squared() + b.length_squared() + c.length_squared()).sqrt()))
            }
            Shape::Lamp(Lamp::Plates(plates)) => around(&mut plates.iter().map(|p| p.point)),
            Shape::Lamp(Lamp::Mesh { corners, .. } | Lamp::Model { corners, .. }) => {
                around(&mut corners.iter().copied())
            }
        }
    }
}
