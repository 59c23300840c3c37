//! Which types may travel on wires.

use serde::{Deserialize, Serialize};

use crate::geometry::{Camera, SceneMesh};
use crate::graph::Artifact;
use crate::image::{Albedo, Depth, Mask, Normal, Picture, Plane, Points, Roughness, Shading};
use crate::optics::{LightKind, Radiance, Shape, Transport};

macro_rules! artifacts {
    ($( $ty:ident: $bytes:expr ),* $(,)?) => {$(
        impl Artifact for $ty {
            const TYPE: &'static str = stringify!($ty);
            fn bytes(&self) -> usize {
                let size: fn(&$ty) -> usize = $bytes;
                size(self)
            }
        }
    )*};
}

artifacts! {
    Albedo: |a| a.0.bytes(),
    Normal: |a| a.0.bytes(),
    Points: |a| a.0.bytes(),
    Depth: |a| a.0.bytes(),
    Roughness: |a| a.0.bytes(),
    Shading: |a| a.0.bytes(),
    Mask: |a| a.0.bytes(),
    Picture: |a| a.0.bytes(),
    Camera: |_| size_of::<Camera>(),
    SceneMesh: SceneMesh::bytes,
    LightKind: |_| size_of::<LightKind>(),
    Shape: |_| size_of::<Shape>(),
    Radiance: |r| r.0.len() * 12,
    Transport: Transport::bytes,
    UnitDirect: |d| d.lobes.iter().chain(&d.stderr).map(Plane::bytes).sum(),
    Visibility: |v| v.lit.iter().chain(&v.unknown).map(Plane::bytes).sum(),
    UnitIndirect: |i| i.lobes.iter().map(|l| l.0.bytes()).sum(),
}

/// Unshadowed direct shading of one light, per lobe of unit radiance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnitDirect {
    /// Irradiance / pi, per lobe.
    pub lobes: Vec<Plane<f32>>,
    /// Standard error of each, same units; zero where a closed form was used.
    pub stderr: Vec<Plane<f32>>,
}

/// Visibility of one light, per lobe: shares of the unshadowed direct shading. Blocked = 1 - lit - unknown.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Visibility {
    pub lit: Vec<Plane<f32>>,
    /// Rays that pass behind a depth edge or leave the seen volume.
    pub unknown: Vec<Plane<f32>>,
}

/// Indirect shading (irradiance / pi) of one light, per lobe of unit radiance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnitIndirect {
    pub lobes: Vec<Shading>,
}
