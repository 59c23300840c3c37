//! `ReadLights`: known lights, in the place of estimated ones.
//!
//! The file is JSON: an object with one object per light, in camera space and meters, radiances
//! linear Rec.709 in units of the photo.
//!
//! ```json
//! {
//!   "lamp_0": {"kind": "Sphere", "center": [1.2, 0.3, -3.1], "radius": 0.15, "radiance": [23, 14, 6]},
//!   "window_0": {"kind": "Window", "center": [-2.1, 0.6, -4.2], "half_x": [0.2, 0.1, -0.7], "half_y": [0, 0.7, 0.1], "lobes": [
//!     {"name": "sky", "direction": [-0.63, 0.77, -0.1], "bandwidth": 1.5, "radiance": [9, 11, 13]}]}
//! }
//! ```

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{
    Context, Diagnostic, Diagnostics, File, Gather, Key, Node, NodeError, Raw, Scatter, Source,
};
use crate::nodes::artifacts::{INV_LAMP, INV_WINDOW, LOBES};
use crate::optics::{
    BoxLamp, Lamp, LightKind, Lobe, MeshLamp, Radiance, RectLamp, Shape, SphereLamp, Window,
};
use crate::tuning::tuning;
use crate::{params, ports};

params! {
    /// Reads true lights from a file, in the place of `InitLights` and `FitLights`.
    ///
    /// The file contains one object per visible light of the scene, and `inv_lamp` and `inv_window`
    /// if there are such lights; docs/planes.md lists its fields. An invisible light that is not in
    /// the file is `Absent`. Lobes of a window are sun, sky and ground, always in this order; a
    /// lobe that is not in the file has the radiance 0.
    pub struct ReadLights {
        /// The JSON file: `truth: (lights: ..)` of a scene.
        path: File = File::default(),
    }
}

ports! {
    pub input ReadLightsIn {
        /// Kind of each visible light. The file must contain them all.
        kind: Gather<LightKind>,
    }
}

ports! {
    pub output ReadLightsOut {
        /// The shape of every visible light, of `inv_lamp` and of `inv_window`.
        shape: Scatter<Shape>,
        /// Their radiances, one per lobe.
        radiance: Scatter<Radiance>,
    }
}

impl Node for ReadLights {
    const KIND: &'static str = "ReadLights";
    const VERSION: u32 = 2;
    type In = ReadLightsIn;
    type Out = ReadLightsOut;

    fn check_consistency(&self) -> Result<(), String> {
        if self.path.path.is_empty() {
            return Err("path: wanted a file, got none; a scene names it as `truth: (lights: \"lights.json\")`".into());
        }
        Ok(())
    }

    fn files(&mut self) -> Vec<&mut File> {
        if self.path.path.is_empty() { Vec::new() } else { vec![&mut self.path] }
    }

    fn run(&self, inputs: ReadLightsIn, ctx: &Context) -> Result<ReadLightsOut, NodeError> {
        let location = self.path.location();
        let text = String::from_utf8(ctx.read(&self.path)?).map_err(|e| {
            super::bad(&self.path, format!("wanted UTF-8 text, got another byte: {e}"))
        })?;
        let seen = inputs.kind.iter().map(|(id, kind)| (id, **kind));
        let wanted: Vec<(&str, LightKind)> =
            seen.chain([(INV_LAMP, LightKind::Lamp), (INV_WINDOW, LightKind::Window)]).collect();
        let lights = read(&Source::new(location, text), &wanted)
            .map_err(|faults| refused(&self.path, &faults))?;
        let mut out = ReadLightsOut { shape: Scatter(vec![]), radiance: Scatter(vec![]) };
        for ((id, _), (shape, radiance)) in wanted.into_iter().zip(lights) {
            out.shape.0.push((id.into(), Arc::new(shape)));
            out.radiance.0.push((id.into(), Arc::new(radiance)));
        }
        Ok(out)
    }
}

/// All faults of the file in one error, each with its line and column.
fn refused(file: &File, faults: &[Diagnostic]) -> NodeError {
    let line = |fault: &Diagnostic| {
        let place = fault.origin.as_ref().map(|origin| origin.line_column());
        let place =
            place.map_or(String::new(), |(line, column)| format!("line {line}, column {column}: "));
        let help = fault.help.as_ref().map_or(String::new(), |help| format!(" ({help})"));
        format!("{place}{}{help}", fault.message)
    };
    super::bad(file, faults.iter().map(line).collect::<Vec<_>>().join("\n  "))
}

type KnownLight = (Shape, Radiance);

/// The lights `wanted`, in their order. JSON is read as the RON that it is, so that every fault has
/// its place.
fn read(
    source: &Arc<Source>,
    wanted: &[(&str, LightKind)],
) -> Result<Vec<KnownLight>, Vec<Diagnostic>> {
    let mut faults = Diagnostics::default();
    let document = Raw::document(source, &mut faults);
    let entries = document.map(|document| document.as_map(&mut faults)).unwrap_or_default();
    if !faults.is_empty() {
        return Err(faults.into_vec());
    }
    let mut lights = vec![None; wanted.len()];
    for (key, value) in &entries {
        let Some(place) = wanted.iter().position(|(id, _)| *id == key.name) else {
            faults.push(|| {
                let fault =
                    Diagnostic::at(&key.origin, format!("the scene has no light `{}`", key.name));
                fault.suggest(&key.name, wanted.iter().map(|(id, _)| *id))
            });
            continue;
        };
        let (id, kind) = wanted[place];
        let before = faults.found();
        let fields = value.as_map(&mut faults);
        if faults.found() == before {
            lights[place] = LightEntry { id, whole: value, fields }.light(kind, &mut faults);
        }
    }
    for (id, _) in wanted.iter().filter(|(id, _)| ![INV_LAMP, INV_WINDOW].contains(id)) {
        if entries.iter().all(|(key, _)| key.name != *id) {
            faults.push(|| {
                Diagnostic::file(
                    &source.path,
                    format!("the scene's light `{id}` is not in this file"),
                )
            });
        }
    }
    if !faults.is_empty() {
        return Err(faults.into_vec());
    }
    Ok(lights.into_iter().map(|light| light.unwrap_or((Shape::Absent, Radiance(vec![])))).collect())
}

/// An object of the file, and its name in messages.
struct LightEntry<'a> {
    id: &'a str,
    whole: &'a Raw,
    fields: Vec<(Key, Raw)>,
}

tuning! {
    /// Constants of the check of a file of lights.
    pub const TUNING: ReadLightsTuning {
        /// Largest radiance of a light.
        max_radiance: f32 = 1e30,
            unit "units of the photo", source Derived("it leaves range in single precision for sums of many"),
            effect "a larger value may overflow";
        /// Largest bandwidth: a lobe beyond it is a direction.
        max_bandwidth: f32 = 1e7,
            unit "1", source Derived("single precision"), effect "a larger value loses digits";
        /// Largest cosine between edges that must be at right angles.
        skew: f32 = 0.01,
            unit "1", source Derived("rounding of decimal numbers"), effect "a larger value accepts parallelograms";
    }
}

impl LightEntry<'_> {
    fn light(&self, wanted: LightKind, faults: &mut Diagnostics) -> Option<KnownLight> {
        const LAMPS: [&str; 4] = ["Sphere", "Box", "Rect", "Mesh"];
        let kinds = if wanted == LightKind::Window { &["Window"][..] } else { &LAMPS };
        let kind = self.get("kind", &format!("one of {}", kinds.join(", ")), faults, |raw| {
            raw.parse::<String>().filter(|kind| kinds.contains(&kind.as_str()))
        })?;
        let before = faults.found();
        let known: &[&str] = match kind.as_str() {
            "Sphere" => &["kind", "center", "radius", "radiance"],
            "Box" => &["kind", "center", "half_axes", "radiance"],
            "Rect" => &["kind", "center", "half_x", "half_y", "radiance"],
            "Mesh" => &["kind", "triangles", "radiance"],
            _ => &["kind", "center", "half_x", "half_y", "lobes"],
        };
        self.only(known, faults);
        if kind == "Window" {
            return self.window(faults).filter(|_| faults.found() == before);
        }
        let radiance = self.radiance(faults);
        let lamp = match kind.as_str() {
            "Sphere" => self.sphere(faults),
            "Box" => self.cuboid(faults),
            "Rect" => self.rect(faults).map(|[center, x, y]| Lamp::Rect(RectLamp { center, x, y })),
            _ => self.mesh(faults),
        };
        let light = (Shape::Lamp(lamp?), Radiance(vec![radiance?]));
        (faults.found() == before).then_some(light)
    }

    fn sphere(&self, faults: &mut Diagnostics) -> Option<Lamp> {
        let center = self.vector("center", faults);
        let radius =
            self.get("radius", "a number > 0", faults, |raw| number(raw).filter(|&r| r > 0.0));
        Some(Lamp::Sphere(SphereLamp { center: center?, radius: radius? }))
    }

    fn cuboid(&self, faults: &mut Diagnostics) -> Option<Lamp> {
        let center = self.vector("center", faults);
        let axes =
            self.get("half_axes", "three half edges [x, y, z] at right angles", faults, |raw| {
                let axes: [Vec3; 3] = vectors(&raw.parse::<Vec<Vec<f32>>>()?)?.try_into().ok()?;
                let pairs = [(axes[0], axes[1]), (axes[1], axes[2]), (axes[2], axes[0])];
                pairs.into_iter().all(|(a, b)| at_right_angles(a, b)).then_some(axes)
            });
        Some(Lamp::Box(BoxLamp { center: center?, axes: axes? }))
    }

    /// Center and half edges.
    fn rect(&self, faults: &mut Diagnostics) -> Option<[Vec3; 3]> {
        let center = self.vector("center", faults);
        let x = self.vector("half_x", faults);
        let wanted = "a half edge [x, y, z] at a right angle to `half_x`";
        let y = self.get("half_y", wanted, faults, |raw| {
            vector(raw).filter(|&y| x.is_none_or(|x| at_right_angles(x, y)))
        });
        Some([center?, x?, y?])
    }

    fn mesh(&self, faults: &mut Diagnostics) -> Option<Lamp> {
        let triangles: Vec<Vec<Vec<f32>>> = self.get(
            "triangles",
            "a list of triangles [[x, y, z], [x, y, z], [x, y, z]]",
            faults,
            |raw| raw.parse(),
        )?;
        let mut corners = Vec::with_capacity(3 * triangles.len());
        for (i, triangle) in triangles.iter().enumerate() {
            let sound = vectors(triangle).filter(|corners| corners.len() == 3);
            let Some(triangle) = sound else {
                self.wrong(
                    "triangles",
                    &format!("three points of three finite numbers in triangle {i}"),
                    faults,
                );
                return None;
            };
            corners.extend(triangle);
        }
        // Six times the volume, exact for a closed body, for any choice of its middle.
        let middle = corners.iter().sum::<Vec3>() / corners.len().max(1) as f32;
        let volume = corners
            .chunks_exact(3)
            .map(|t| (t[1] - t[0]).cross(t[2] - t[0]).dot(t[0] - middle))
            .sum::<f32>();
        let triangles =
            (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let lamp = Lamp::Mesh(MeshLamp::without_occlusion(corners, triangles));
        if !(lamp.area() > 0.0 && lamp.area().is_finite()) {
            self.wrong("triangles", "triangles with an area", faults);
        } else if volume < 0.0 {
            self.wrong("triangles", "corners counter-clockwise as seen from outside", faults);
        }
        Some(lamp)
    }

    fn window(&self, faults: &mut Diagnostics) -> Option<KnownLight> {
        let edges = self.rect(faults);
        let list = self.raw("lobes", "a list of lobes", faults)?;
        let mut lobes: [Option<(Lobe, Vec3)>; 3] = [None; 3];
        let items = list.as_list(faults);
        if items.is_empty() {
            self.wrong("lobes", "one to three lobes", faults);
        }
        for item in &items {
            let lobe = LightEntry { id: self.id, whole: item, fields: item.as_map(faults) };
            lobe.only(&["name", "direction", "bandwidth", "radiance"], faults);
            let free: Vec<&str> = LOBES
                .iter()
                .zip(&lobes)
                .filter(|(_, l)| l.is_none())
                .map(|(name, _)| *name)
                .collect();
            let place = lobe.get("name", &format!("one of {}", free.join(", ")), faults, |raw| {
                let name: String = raw.parse()?;
                LOBES.iter().position(|known| *known == name && free.contains(known))
            });
            let direction = lobe.get("direction", "a direction [x, y, z]", faults, |raw| {
                vector(raw).and_then(Vec3::try_normalize)
            });
            let wanted = format!("a number 0..={:e}", TUNING.max_bandwidth);
            let bandwidth = lobe.get("bandwidth", &wanted, faults, |raw| {
                number(raw).filter(|b| (0.0..=TUNING.max_bandwidth).contains(b))
            });
            let radiance = lobe.radiance(faults);
            if let (Some(place), Some(direction), Some(bandwidth), Some(radiance)) =
                (place, direction, bandwidth, radiance)
            {
                lobes[place] = Some((Lobe { direction, bandwidth }, radiance));
            }
        }
        let [center, x, y] = edges?;
        let normal = x.cross(y).normalize_or_zero();
        if ![INV_LAMP, INV_WINDOW].contains(&self.id) && normal.dot(center) >= 0.0 {
            self.wrong(
                "half_y",
                "half_x cross half_y into the room, from where the camera sees it",
                faults,
            );
        }
        let mut window = Window { center, x, y, lobes: Window::daylight(normal, Vec3::Y) };
        let radiance = window.lobes.iter_mut().zip(lobes).map(|(dark, lobe)| match lobe {
            Some((lobe, radiance)) => {
                *dark = lobe;
                radiance
            }
            None => Vec3::ZERO,
        });
        let radiance = Radiance(radiance.collect());
        Some((Shape::Window(window), radiance))
    }

    fn radiance(&self, faults: &mut Diagnostics) -> Option<Vec3> {
        let within =
            |rgb: &Vec3| rgb.min_element() >= 0.0 && rgb.max_element() <= TUNING.max_radiance;
        let wanted = format!("three numbers 0..={:e}", TUNING.max_radiance);
        self.get("radiance", &wanted, faults, |raw| vector(raw).filter(within))
    }

    fn vector(&self, name: &str, faults: &mut Diagnostics) -> Option<Vec3> {
        self.get(name, "three finite numbers [x, y, z]", faults, vector)
    }

    /// A field read by `read`; a `None` of it is a fault.
    fn get<T>(
        &self,
        name: &str,
        wanted: &str,
        faults: &mut Diagnostics,
        read: impl FnOnce(&Raw) -> Option<T>,
    ) -> Option<T> {
        let value = read(self.raw(name, wanted, faults)?);
        if value.is_none() {
            self.wrong(name, wanted, faults);
        }
        value
    }

    fn raw(&self, name: &str, wanted: &str, faults: &mut Diagnostics) -> Option<&Raw> {
        let found = self.fields.iter().find(|(key, _)| key.name == name).map(|(_, value)| value);
        if found.is_none() {
            let id = self.id;
            faults.push(|| {
                Diagnostic::at(
                    &self.whole.origin,
                    format!("`{id}`: {name}: wanted {wanted}, got none"),
                )
            });
        }
        found
    }

    /// The fault of a field that is present.
    fn wrong(&self, name: &str, wanted: &str, faults: &mut Diagnostics) {
        let value = self
            .fields
            .iter()
            .find(|(key, _)| key.name == name)
            .map_or(self.whole, |(_, value)| value);
        let mut got: String =
            value.text().chars().take(60).map(|c| if c.is_control() { ' ' } else { c }).collect();
        if got.len() < value.text().len() {
            got.push_str("..");
        }
        faults.push(|| value.fault(format!("`{}`: {name}: wanted {wanted}, got {got}", self.id)));
    }

    /// Checks that there are only these fields.
    fn only(&self, known: &[&str], faults: &mut Diagnostics) {
        for (key, _) in self.fields.iter().filter(|(key, _)| !known.contains(&key.name.as_str())) {
            faults.push(|| {
                let fault = Diagnostic::at(
                    &key.origin,
                    format!("`{}`: unknown field `{}`", self.id, key.name),
                );
                fault.suggest(&key.name, known.iter().copied())
            });
        }
    }
}

fn number(raw: &Raw) -> Option<f32> {
    raw.parse::<f32>().filter(|n| n.is_finite())
}

fn vector(raw: &Raw) -> Option<Vec3> {
    point(&raw.parse::<Vec<f32>>()?)
}

fn point(numbers: &Vec<f32>) -> Option<Vec3> {
    let point = Vec3::from_array(numbers.as_slice().try_into().ok()?);
    point.is_finite().then_some(point)
}

fn vectors(points: &[Vec<f32>]) -> Option<Vec<Vec3>> {
    points.iter().map(point).collect()
}

/// Whether two edges have lengths and are orthogonal to each other.
fn at_right_angles(a: Vec3, b: Vec3) -> bool {
    let (Some(a), Some(b)) = (a.try_normalize(), b.try_normalize()) else { return false };
    a.dot(b).abs() <= TUNING.skew
}

#[cfg(test)]
mod tests {
    use super::*;

    const WANTED: [(&str, LightKind); 4] = [
        ("lamp", LightKind::Lamp),
        ("pane", LightKind::Window),
        (INV_LAMP, LightKind::Lamp),
        (INV_WINDOW, LightKind::Window),
    ];
    const LAMP: &str =
        r#"{"kind": "Sphere", "center": [1, 0.5, -3], "radius": 0.1, "radiance": [9, 8, 7]}"#;
    const EDGES: &str =
        r#""kind": "Window", "center": [0, 0, -4], "half_x": [1, 0, 0], "half_y": [0, 0.5, 0]"#;
    const SKY: &str =
        r#"{"name": "sky", "direction": [0, 3, -4], "bandwidth": 1.5, "radiance": [1, 2, 3]}"#;

    fn lights(lamp: &str, pane: &str, more: &str) -> Result<Vec<KnownLight>, Vec<Diagnostic>> {
        read(
            &Source::new("lights.json", format!("{{\"lamp\": {lamp},\n\"pane\": {pane}{more}}}")),
            &WANTED,
        )
    }

    /// The file with this lamp and this window is refused with exactly these messages; locations
    /// are left out.
    fn check(lamp: &str, pane: &str, more: &str, wanted: &[&str]) {
        let faults = lights(lamp, pane, more).expect_err("it is not sound");
        assert!(faults.iter().all(|fault| fault.origin.is_some()), "{faults:?}");
        let message = refused(&File::new("lights.json"), &faults).to_string();
        let line = |line: &str| {
            line.split_once("column ")
                .and_then(|(_, message)| message.split_once(": "))
                .map(|(_, message)| message.to_owned())
        };
        assert_eq!(message.lines().filter_map(line).collect::<Vec<_>>(), wanted, "{message}");
    }

    fn pane(lobes: &str) -> String {
        format!("{{{EDGES}, \"lobes\": [{lobes}]}}")
    }

    #[test]
    fn every_kind_is_read() {
        let more = r#", "inv_window": {"kind": "Window", "center": [0, 0, 2], "half_x": [1, 0, 0], "half_y": [0, 1, 0],
            "lobes": [{"name": "ground", "direction": [0, -1, 0], "bandwidth": 0, "radiance": [0, 1e-5, 2E+1]}]}"#;
        let got = lights(LAMP, &pane(SKY), more).expect("it is sound");
        let sphere = Lamp::Sphere(SphereLamp { center: Vec3::new(1.0, 0.5, -3.0), radius: 0.1 });
        assert_eq!(got[0], (Shape::Lamp(sphere), Radiance(vec![Vec3::new(9.0, 8.0, 7.0)])));
        let (Shape::Window(window), radiance) = &got[1] else { panic!("a window") };
        assert_eq!(radiance.0, [Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0), Vec3::ZERO]);
        assert_eq!(window.lobes[1], Lobe { direction: Vec3::new(0.0, 0.6, -0.8), bandwidth: 1.5 });
        assert_eq!(got[2], (Shape::Absent, Radiance(vec![])));
        assert_eq!(got[3].1.0[2], Vec3::new(0.0, 1e-5, 20.0));

        let axes = r#"{"kind": "Box", "center": [0, 0, -2], "half_axes": [[1, 0, 0], [0, 2, 0], [0, 0, 3]], "radiance": [1, 1, 1]}"#;
        let got = lights(axes, &pane(SKY), "").expect("it is sound");
        let axes = [Vec3::X, Vec3::Y * 2.0, Vec3::Z * 3.0];
        assert_eq!(
            got[0].0,
            Shape::Lamp(Lamp::Box(BoxLamp { center: Vec3::new(0.0, 0.0, -2.0), axes }))
        );
        let rect = r#"{"kind": "Rect", "center": [0, 1, -2], "half_x": [1, 0, 0], "half_y": [0, 0, 1], "radiance": [1, 1, 1]}"#;
        let got = lights(rect, &pane(SKY), "").expect("it is sound");
        assert_eq!(
            got[0].0,
            Shape::Lamp(Lamp::Rect(RectLamp {
                center: Vec3::new(0.0, 1.0, -2.0),
                x: Vec3::X,
                y: Vec3::Z
            }))
        );
        let got = lights(&tetrahedron(false), &pane(SKY), "").expect("it is sound");
        let Shape::Lamp(lamp) = &got[0].0 else { panic!("a lamp") };
        // Three sides of 1/2 and one of sqrt(3)/2, exact but for rounding.
        assert!((lamp.area() - (1.5 + 0.75f32.sqrt())).abs() < 1e-6);
    }

    /// The corner of a unit cube, with its sides as they are or turned inwards.
    fn tetrahedron(inwards: bool) -> String {
        let [o, x, y, z] = ["[0, 0, 0]", "[1, 0, 0]", "[0, 1, 0]", "[0, 0, 1]"];
        let sides = [[o, y, x], [o, z, y], [o, x, z], [x, y, z]];
        let side = |[a, b, c]: [&str; 3]| {
            if inwards { format!("[{a}, {c}, {b}]") } else { format!("[{a}, {b}, {c}]") }
        };
        let sides = sides.map(side).join(", ");
        format!(r#"{{"kind": "Mesh", "triangles": [{sides}], "radiance": [1, 1, 1]}}"#)
    }

    #[test]
    fn the_place_is_that_of_the_value() {
        let faults = lights(&LAMP.replace("0.1", "-1"), &pane(SKY), "")
            .expect_err("a sphere has no such radius");
        let wanted = "lights.json: line 1, column 63: `lamp`: radius: wanted a number > 0, got -1";
        assert_eq!(refused(&File::new("lights.json"), &faults).to_string(), wanted);
    }

    #[test]
    fn every_fault_names_light_and_field() {
        let pane = &pane(SKY);
        let lamp = |from: &str, to: &str| LAMP.replace(from, to);
        let check = |lamp: &str, wanted: &[&str]| check(lamp, pane, "", wanted);
        check(&lamp("0.1", "0"), &["`lamp`: radius: wanted a number > 0, got 0"]);
        check(&lamp("0.1", "\"a\""), &["`lamp`: radius: wanted a number > 0, got \"a\""]);
        check(&lamp("-3]", "NaN]"), &["wanted a finite number, got NaN"]);
        check(
            &lamp("-3]", "1e39]"),
            &["`lamp`: center: wanted three finite numbers [x, y, z], got [1, 0.5, 1e39]"],
        );
        check(
            &lamp(", -3]", "]"),
            &["`lamp`: center: wanted three finite numbers [x, y, z], got [1, 0.5]"],
        );
        check(
            &lamp("[9,", "[-9,"),
            &["`lamp`: radiance: wanted three numbers 0..=1e30, got [-9, 8, 7]"],
        );
        check(
            &lamp("\"radius\"", "\"radios\""),
            &[
                "`lamp`: unknown field `radios` (did you mean `radius`?)",
                "`lamp`: radius: wanted a number > 0, got none",
            ],
        );
        check(
            &lamp("Sphere", "Ball"),
            &["`lamp`: kind: wanted one of Sphere, Box, Rect, Mesh, got \"Ball\""],
        );
        check(pane, &["`lamp`: kind: wanted one of Sphere, Box, Rect, Mesh, got \"Window\""]);
        check(&lamp("\"center\"", "\"radius\""), &["`radius` is given twice"]);
        let skew = r#"{"kind": "Box", "center": [0, 0, 0], "half_axes": [[1, 0, 0], [1, 1, 0], [0, 0, 1]], "radiance": [1, 1, 1]}"#;
        check(
            skew,
            &[
                "`lamp`: half_axes: wanted three half edges [x, y, z] at right angles, got [[1, 0, 0], [1, 1, 0], [0, 0, 1]]",
            ],
        );
        let flat = r#"{"kind": "Rect", "center": [0, 0, 0], "half_x": [1, 0, 0], "half_y": [0, 0, 0], "radiance": [1, 1, 1]}"#;
        check(
            flat,
            &[
                "`lamp`: half_y: wanted a half edge [x, y, z] at a right angle to `half_x`, got [0, 0, 0]",
            ],
        );
        let inwards = tetrahedron(true);
        let message =
            refused(&File::new("l"), &lights(&inwards, pane, "").expect_err("inside out"))
                .to_string();
        assert!(
            message.contains(
                "`lamp`: triangles: wanted corners counter-clockwise as seen from outside"
            ),
            "{message}"
        );
        check("[1]", &["wanted `{ \"name\": value, .. }`, got `[1]`"]);
    }

    #[test]
    fn what_is_no_object_of_lights_is_told_once() {
        for text in ["", "[1, 2]", "{\"lamp\": ", "{lamp: 1}"] {
            let faults =
                read(&Source::new("lights.json", text), &WANTED).expect_err("it is not sound");
            assert_eq!(faults.len(), 1, "{text}: {faults:?}");
        }
    }

    #[test]
    fn windows_and_names_are_held_against_the_scene() {
        let window = |lobes: &str, wanted: &[&str]| check(LAMP, &pane(lobes), "", wanted);
        window("", &["`pane`: lobes: wanted one to three lobes, got []"]);
        window(&format!("{SKY}, {SKY}"), &["`pane`: name: wanted one of sun, ground, got \"sky\""]);
        window(
            &SKY.replace("1.5", "1e8"),
            &["`pane`: bandwidth: wanted a number 0..=1e7, got 1e8"],
        );
        window(
            &SKY.replace("[0, 3, -4]", "[0, 0, 0]"),
            &["`pane`: direction: wanted a direction [x, y, z], got [0, 0, 0]"],
        );
        let outwards = pane(SKY).replace("[1, 0, 0]", "[-1, 0, 0]");
        check(
            LAMP,
            &outwards,
            "",
            &[
                "`pane`: half_y: wanted half_x cross half_y into the room, from where the camera sees it, got [0, 0.5, 0]",
            ],
        );
        check(
            LAMP,
            &pane(SKY),
            ", \"lmap\": {}",
            &["the scene has no light `lmap` (did you mean `lamp`?)"],
        );
        let missing =
            read(&Source::new("lights.json", "{}"), &WANTED).expect_err("two lights are missing");
        assert_eq!(missing.len(), 2);
        assert_eq!(missing[1].message, "the scene's light `pane` is not in this file");
    }
}
