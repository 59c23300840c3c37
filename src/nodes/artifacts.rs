//! Which types may travel on wires, and the members that every scene has.

use std::ops::Range;

use glam::Vec3;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::geometry::{Camera, Objects, SceneMesh};
use crate::graph::{Artifact, NodeError};
use crate::image::{
    Albedo, Bytes, Coats, Depth, Finish, Layer, Normal, Plane, Points, Roughness, Segments, Shading, Specular,
    Transfer, rule,
};
pub use crate::image::{Mask, Picture};
pub use crate::optics::LOBES;
use crate::optics::{LightKind, Lighting, LocalLobe, Polish, Radiance, Reflections, Shape, Transport};

/// The member that stands for lamps out of view.
pub const INV_LAMP: &str = "inv_lamp";
/// The member that stands for windows out of view.
pub const INV_WINDOW: &str = "inv_window";
/// What no light explains; no light may have this name.
pub const REST: &str = "rest";

/// Checks that the plane `name` has the size of the plane `reference`, columns and rows.
///
/// # Errors
/// [`NodeError::Failed`] with both sizes.
pub fn same_size(name: &str, got: (usize, usize), reference: &str, wanted: (usize, usize)) -> Result<(), NodeError> {
    if got == wanted {
        return Ok(());
    }
    let [got, wanted] = [got, wanted].map(|(width, height)| format!("{width} x {height}"));
    Err(NodeError::Failed(format!("{name}: wanted {wanted} pixels as {reference}, got {got}")))
}

/// The memory that a value of each type holds, and the rules that one must keep which was read from disk.
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
    Layer: Layer::bytes;
    Camera: |_| size_of::<Camera>(), if |c| rule(c.width > 0 && c.height > 0 && c.fx > 0.0 && c.fy > 0.0, "a view");
    SceneMesh: SceneMesh::bytes, if SceneMesh::check;
    Shape: Shape::bytes, if Shape::check;
    Radiance: |r| r.0.len() * 12;
    Transport: Transport::bytes, if Transport::check;
    UnitDirect: |d| d.lobes.iter().chain(&d.stderr).map(Plane::bytes).sum(), if |d| lobes(&[&d.lobes, &d.stderr]);
    Visibility: |v| v.lit.iter().chain(&v.stderr).chain(&v.unknown).map(Plane::bytes).sum(),
        if |v| lobes(&[&v.lit, &v.stderr, &v.unknown]);
    UnitIndirect: |i| i.lobes.iter().map(|l| &l.0).chain(&i.probes).map(Plane::bytes).chain(i.stderr.iter().map(Plane::bytes)).sum();
    Objects: Objects::bytes, if Objects::check;
    Reflections: Reflections::bytes, if Reflections::check;
    Polish: Polish::bytes, if Polish::check;
    ObjectLight: |o| o.albedo.bytes() + o.lobes.iter().chain(&o.probes).map(Plane::bytes).sum::<usize>(),
        if |o| rule(o.lobes.len() == o.probes.len(), "probes for each lobe");
    Guess: |g| g.shape.bytes() + g.radiance.0.len() * 12, if |g| g.shape.check();
    Remainder: |r| r.left.bytes();
    Coats: Coats::bytes, if Coats::check;
    Finish: Finish::bytes, if Finish::check;
    Lighting: |l| l.lobes.len() * size_of::<LocalLobe>(), if Lighting::check;
    LightKind: |_| size_of::<LightKind>();
    Encoding: |_| size_of::<Encoding>();
    Scores: |s| s.0.len() * size_of::<Score>();
    Files: |f| f.0.iter().map(|(name, bytes)| name.len() + bytes.len()).sum(),
        if |f| f.0.iter().try_for_each(|(name, _)| check_file_name(name)),
        from Files::from_canonical;
}

/// Whether there is a plane of one size for each lobe in each list; lists without planes are left out.
fn lobes(lists: &[&[Plane<f32>]]) -> Result<(), String> {
    let mut planes = lists.iter().copied().flatten();
    let size = planes.next().map(Plane::size);
    rule(planes.all(|plane| Some(plane.size()) == size), "planes of one size")?;
    let mut counts = lists.iter().map(|list| list.len()).filter(|&count| count > 0);
    let count = counts.next();
    rule(counts.all(|other| Some(other) == count), "planes for each lobe")
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
    /// Standard error of `lit`.
    pub stderr: Vec<Plane<f32>>,
    /// Rays that pass behind a depth edge or leave the seen volume.
    pub unknown: Vec<Plane<f32>>,
}

/// Indirect shading (irradiance / pi) of one light, per lobe of unit radiance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnitIndirect {
    pub lobes: Vec<Shading>,
    /// Standard error of each lobe's luminance. All lobes and lights share their rays, so their errors go together.
    pub stderr: Vec<Plane<f32>>,
    /// Of the probes of inserted bodies, per lobe, one row; nothing in a room without them.
    pub probes: Vec<Plane<Vec3>>,
}

/// Direct light, shadows included, of one light on inserted bodies, per lobe of unit radiance: irradiance / pi.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObjectLight {
    /// At the samples of [`Objects`].
    pub lobes: Vec<Plane<f32>>,
    /// At the probes, one row.
    pub probes: Vec<Plane<f32>>,
    /// What the probes reflect.
    pub albedo: Plane<Vec3>,
}

/// What a network says of one light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Guess {
    pub shape: Shape,
    pub radiance: Radiance,
    /// Probability that it burns at all, 0..=1.
    pub burns: f32,
    /// Expected error of its direct shading, as a share of that.
    pub error: f32,
}

/// What the photo's shading leaves when all direct light is taken away.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Remainder {
    /// Zero where the photo is white or shows a light.
    pub left: Plane<Vec3>,
    /// Mean direct shading.
    pub direct: Vec3,
    /// What all lights send, square metres times radiance.
    pub power: Vec3,
}

/// How the photo was stored, so that the result can be stored alike.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Encoding {
    pub transfer: Transfer,
    /// Illuminance in lux at which a white surface shows 1; unknown when the scene does not say.
    pub lux: Option<f32>,
    pub sixteen_bit: bool,
}

/// One figure of how good something is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// A light, an edit, `all lights`, `materials`.
    pub subject: String,
    /// As the stage that measured calls it; docs/eval.md tells each.
    pub measure: String,
    pub value: f64,
}

/// Figures of how good something is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scores(pub Vec<Score>);

/// The sub-folders that files of results may lie in.
const RESULT_FOLDERS: [&str; 1] = ["masks"];
/// Names that stand for devices on Windows, whatever ending they have.
const DEVICES: [&str; 6] = ["con", "prn", "aux", "nul", "com", "lpt"];

/// Whether a file of the results may have this name: one plain name that every system takes, in no folder or in one of
/// those that stages declare (`masks`).
///
/// # Errors
/// What was wanted and what was got.
pub fn check_file_name(name: &str) -> Result<(), String> {
    let (folder, file) = name.split_once('/').map_or((None, name), |(folder, file)| (Some(folder), file));
    let stem = file.split('.').next().unwrap_or_default().trim_end().to_ascii_lowercase();
    let is_device = DEVICES.iter().any(|device| match stem.strip_prefix(device) {
        Some("") => !matches!(*device, "com" | "lpt"),
        Some(number) => matches!(*device, "com" | "lpt") && number.len() == 1 && number != "0",
        None => false,
    });
    let is_plain = !file.is_empty()
        && file.len() <= 255
        && !file.ends_with(['.', ' '])
        && !file.contains(|c: char| c.is_control() || r#"/\:*?"<>|"#.contains(c))
        && !is_device;
    if is_plain && folder.is_none_or(|folder| RESULT_FOLDERS.contains(&folder)) {
        return Ok(());
    }
    let folders = RESULT_FOLDERS.join(", ");
    Err(format!("wanted the plain name of a file, in no folder or in one of these: {folders}; got {name:?}"))
}

/// Files to be written, by name; [`check_file_name`] holds for each.
#[derive(Clone, Debug, PartialEq)]
pub struct Files(pub Vec<(String, Vec<u8>)>);

impl Files {
    /// Files from their canonical bytes. The largest keeps their buffer: the layers of a large photo take gigabytes.
    fn from_canonical(mut bytes: Vec<u8>) -> Result<Files, String> {
        let bad = |e: postcard::Error| e.to_string();
        let (count, mut rest) = postcard::take_from_bytes::<usize>(&bytes).map_err(bad)?;
        let mut places = Vec::new();
        for _ in 0..count {
            let ((name, Bytes(file)), after) = postcard::take_from_bytes::<(String, Bytes)>(rest).map_err(bad)?;
            let end = bytes.len() - after.len();
            places.push((name, end - file.len()..end));
            rest = after;
        }
        rule(rest.is_empty(), "nothing after the files")?;
        let largest = (0..places.len()).max_by_key(|&i| places[i].1.len());
        let copy = |(i, (name, place)): (usize, &(String, Range<usize>))| {
            (name.clone(), if Some(i) == largest { Vec::new() } else { bytes[place.clone()].to_vec() })
        };
        let mut files: Vec<(String, Vec<u8>)> = places.iter().enumerate().map(copy).collect();
        if let Some(i) = largest {
            bytes.truncate(places[i].1.end);
            bytes.drain(..places[i].1.start);
            files[i].1 = bytes;
        }
        Ok(Files(files))
    }
}

impl Serialize for Files {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().map(|(name, bytes)| (name, Bytes(bytes))))
    }
}

impl<'de> Deserialize<'de> for Files {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Files, D::Error> {
        let files: Vec<(String, Bytes<'de>)> = Deserialize::deserialize(deserializer)?;
        Ok(Files(files.into_iter().map(|(name, bytes)| (name, bytes.0.to_vec())).collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_come_back_whichever_is_the_largest() {
        let lists: [&[(&str, &[u8])]; 4] = [
            &[],
            &[("a.png", b"")],
            &[("a.png", b"short"), ("b.exr", b"much longer"), ("c.ron", b"")],
            &[("a.png", b"the longest of all"), ("b.exr", b"short")],
        ];
        for list in lists {
            let files = Files(list.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.to_vec())).collect());
            let bytes = postcard::to_stdvec(&files).expect("it can be encoded");
            assert_eq!(Files::decode(bytes.clone()).as_ref(), Ok(&files));
            for cut in 0..bytes.len() {
                assert!(Files::decode(bytes[..cut].to_vec()).is_err(), "{cut} of {} bytes", bytes.len());
            }
            assert!(Files::decode([&bytes[..], b"x"].concat()).is_err());
        }
    }

    #[test]
    fn names_of_results_are_plain() {
        for name in
            ["picture.png", "picture_0001.png", "masks/lamp_0.png", "Gr\u{f6}\u{df}e 1.usda", "console.png", "com.png"]
        {
            assert_eq!(check_file_name(name), Ok(()), "{name}");
        }
        let long = "a".repeat(256);
        for name in [
            "",
            ".",
            "..",
            "/",
            "/etc/passwd",
            "../x",
            "masks/../x",
            "masks/",
            "other/x",
            "a/b/c",
            "a\\b",
            "C:x",
            "a\0b",
            "x\n",
            "con",
            "NUL.txt",
            "com1",
            "LPT9.png",
            "masks/aux.png",
            "x.",
            "x ",
            "x?",
            long.as_str(),
        ] {
            assert!(check_file_name(name).is_err(), "{name:?}");
        }
    }
}
