//! Artifacts: the types of the wires, and the members of every scene.

mod files;
mod light;
mod scores;

use crate::geometry::{Camera, Objects, RoomLayout, SceneMesh};
use crate::graph::{Artifact, NodeError};
use crate::image::{
    Albedo, Depth, GlareMask, Layer, LightMask, Normal, PaintLayers, Plane, Points, Roughness,
    Segments, Shading, Specular, SpecularEdit, rule,
};
pub use crate::image::{Mask, Picture};
use crate::optics::{
    DrawDifferences, LightKind, LightTransport, Lighting, LocalLobe, PaneRays, Reflections,
    RoomDraws, Shape, SpecularChange,
};
pub use crate::optics::{LOBES, Radiance};

pub use files::{Encoding, Files, check_file_name};
pub use light::{
    CellLight, EmitterChange, Guess, LayerError, ObjectLight, Residual, ScatteredLight,
    ShadingGain, Sun, Sunlight, UnitDirect, UnitIndirect, Visibility,
};
pub use scores::{Score, Scores};

/// The member that stands for lamps out of view.
pub const INV_LAMP: &str = "inv_lamp";
/// The member that stands for windows out of view.
pub const INV_WINDOW: &str = "inv_window";
/// Name of the residual layer, which no light explains; reserved among lights.
pub const REST: &str = "rest";

/// Checks that the plane `name` has the size of the plane `reference`, columns and rows.
///
/// # Errors
/// [`NodeError::Failed`] with both sizes.
pub fn same_size(
    name: &str,
    got: (usize, usize),
    reference: &str,
    wanted: (usize, usize),
) -> Result<(), NodeError> {
    if got == wanted {
        return Ok(());
    }
    let [got, wanted] = [got, wanted].map(|(width, height)| format!("{width} x {height}"));
    Err(NodeError::Failed(format!("{name}: wanted {wanted} pixels as {reference}, got {got}")))
}

/// The memory of a value of each type, and the rules for values that were read from disk.
macro_rules! artifacts {
    ($( $ty:ident: $bytes:expr $(, if $check:expr)? $(, from $decode:expr)? );* $(;)?) => {$(
        impl Artifact for $ty {
            const TYPE: &'static str = stringify!($ty);
            fn bytes(&self) -> usize {
                let size: fn(&$ty) -> usize = $bytes;
                size(self)
            }
            $(fn check(&self) -> Result<(), String> {
                let check: fn(&$ty) -> Result<(), String> = $check;
                check(self)
            })?
            $(fn decode(bytes: Vec<u8>) -> Result<$ty, String> {
                $decode(bytes)
            })?
        }
    )*};
}

artifacts! {
    Albedo: |a| a.0.bytes();
    Normal: |a| a.0.bytes();
    Points: |a| a.0.bytes();
    Depth: |a| a.0.bytes(), if |a| rule(a.0.pixels().iter().all(|&z| z > 0.0 && z.is_finite()), "depth above 0");
    Roughness: |a| a.0.bytes();
    Specular: |a| a.0.bytes();
    Shading: |a| a.0.bytes();
    Segments: |s| s.label.bytes(), if Segments::check;
    Mask: |a| a.0.bytes();
    Picture: |a| a.0.bytes();
    GlareMask: GlareMask::bytes, if GlareMask::check;
    LightMask: |m| m.0.bytes();
    Layer: Layer::bytes;
    Camera: |_| size_of::<Camera>(), if |c| rule(c.width > 0 && c.height > 0 && c.fx > 0.0 && c.fy > 0.0, "a view");
    RoomLayout: RoomLayout::bytes, if RoomLayout::check;
    CellLight: |c| c.lobes.iter().map(Plane::bytes).sum();
    RoomDraws: RoomDraws::bytes, if RoomDraws::check;
    DrawDifferences: |d| d.lobes.iter().map(Plane::bytes).sum(), if DrawDifferences::check;
    ScatteredLight: |s| s.glare.bytes(), if ScatteredLight::check;
    ShadingGain: |g| g.0.bytes(), if ShadingGain::check;
    Sun: |s| 12 + s.windows.iter().map(String::len).sum::<usize>();
    Sunlight: |s| s.lit.bytes(), if Sunlight::check;
    LayerError: |e| e.stderr.bytes();
    SceneMesh: SceneMesh::bytes, if SceneMesh::check;
    Shape: Shape::bytes, if Shape::check;
    Radiance: |r| r.0.len() * 12;
    EmitterChange: |c| (c.gain.len() + 1) * 12 + 4;
    LightTransport: LightTransport::bytes, if LightTransport::check;
    UnitDirect: |d| d.lobes.iter().chain(&d.stderr).map(Plane::bytes).sum(), if |d| light::lobes(&[&d.lobes, &d.stderr]);
    Visibility: |v| v.lit.iter().chain(&v.stderr).chain(&v.unknown).map(Plane::bytes).sum(),
        if |v| light::lobes(&[&v.lit, &v.stderr, &v.unknown]);
    UnitIndirect: |i| i.lobes.iter().map(|l| &l.0).chain(&i.probes).chain(&i.cells).map(Plane::bytes).chain(i.stderr.iter().map(Plane::bytes)).sum();
    Objects: Objects::bytes, if Objects::check;
    Reflections: Reflections::bytes, if Reflections::check;
    PaneRays: PaneRays::bytes, if PaneRays::check;
    SpecularChange: SpecularChange::bytes, if SpecularChange::check;
    ObjectLight: |o| o.albedo.bytes() + o.lobes.iter().chain(&o.probes).map(Plane::bytes).sum::<usize>(),
        if |o| rule(o.lobes.len() == o.probes.len(), "probes for each lobe");
    Guess: |g| g.shape.bytes() + g.radiance.0.len() * 12, if |g| g.shape.check();
    Residual: |r| r.left.bytes();
    PaintLayers: PaintLayers::bytes, if PaintLayers::check;
    SpecularEdit: SpecularEdit::bytes, if SpecularEdit::check;
    Lighting: |l| l.lobes.len() * size_of::<LocalLobe>(), if Lighting::check;
    LightKind: |_| size_of::<LightKind>();
    Encoding: |e| size_of::<Encoding>() + e.exif.len();
    Scores: |s| s.0.len() * size_of::<Score>();
    Files: |f| f.0.iter().map(|(name, bytes)| name.len() + bytes.len()).sum(),
        if |f| f.0.iter().try_for_each(|(name, _)| check_file_name(name)),
        from Files::from_canonical;
}
