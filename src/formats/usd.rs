//! USD text: the seen surface, the camera and UsdLux lights.
//!
//! A light of radiance L is a UsdLux light of `intensity` x `color` = L with `normalize` off. No
//! light of UsdLux has the three lobes of a window: a window becomes a rectangle of the same power
//! into the room, L = sum_k w_k F_k / (pi S), where F_k is the power of lobe k per unit radiance
//! and S the area. A narrow lobe of a window whose pane is a hole in the surface becomes a distant
//! light of the irradiance w (2 pi / lambda) (1 - exp(-2 lambda)), and of the disc whose second
//! moment is the lobe's, half angle 2 / sqrt(lambda).

use std::f32::consts::{PI, TAU};
use std::fmt::Write as _;

use glam::{Vec2, Vec3};

use crate::geometry::{Camera, Own, SceneMesh};
use crate::image::{Mask, Normal, Points};
use crate::optics::{
    BoxLamp, Lamp, Lobe, MeshLamp, PhotometricLamp, RectLamp, Shape, SphereLamp, Surfel, Window,
};

/// A light for [`UsdRoom`].
pub struct UsdLight<'a> {
    /// A name of letters, digits and `_`.
    pub id: &'a str,
    /// Its shape, camera space, meters.
    pub shape: &'a Shape,
    /// Linear Rec.709, one color per lobe of the shape.
    pub radiance: &'a [Vec3],
}

impl UsdLight<'_> {
    /// Whether it gives any light: one that is off is left out.
    fn shines(&self) -> bool {
        self.radiance.iter().any(|&w| w != Vec3::ZERO)
    }
}

/// A room for USD; all planes have one size.
pub struct UsdRoom<'a> {
    /// The camera of the photo.
    pub camera: &'a Camera,
    /// Pixel centers on the surface, camera space, meters.
    pub points: &'a Points,
    /// Their normals.
    pub normal: &'a Normal,
    /// The triangles between them.
    pub mesh: &'a SceneMesh,
    /// Pixels of the visible lights, by name.
    pub masks: Vec<(&'a str, &'a Mask)>,
    /// All lights.
    pub lights: Vec<UsdLight<'a>>,
    /// Least bandwidth of a lobe that becomes a distant light.
    pub sun: f32,
}

const HEAD: &str = r#"#usda 1.0
(
    defaultPrim = "Room"
    doc = "made by relight: camera space, x right, y up, looking along -z; radiance in units of the photo, linear Rec.709"
    metersPerUnit = 1
    upAxis = "Y"
)

def Xform "Room"
{
"#;

const MATERIALS: &str = r#"
    def Scope "Materials"
    {
        def Material "Surface"
        {
            token outputs:surface.connect = </Room/Materials/Surface/Preview.outputs:surface>

            def Shader "Preview"
            {
                uniform token info:id = "UsdPreviewSurface"
                color3f inputs:diffuseColor.connect = </Room/Materials/Surface/Albedo.outputs:rgb>
                float inputs:ior = 1
                float inputs:roughness = 1
                color3f inputs:specularColor = (0, 0, 0)
                int inputs:useSpecularWorkflow = 1
                token outputs:surface
            }

            def Shader "Albedo"
            {
                uniform token info:id = "UsdUVTexture"
                asset inputs:file = @./$TEXTURE@
                token inputs:sourceColorSpace = "sRGB"
                float2 inputs:st.connect = </Room/Materials/Surface/Place.outputs:result>
                token inputs:wrapS = "clamp"
                token inputs:wrapT = "clamp"
                float3 outputs:rgb
            }

            def Shader "Place"
            {
                uniform token info:id = "UsdPrimvarReader_float2"
                string inputs:varname = "st"
                float2 outputs:result
            }
        }
"#;

const EMISSIVE: &str = r#"
        def Material "$ID"
        {
            token outputs:surface.connect = </Room/Materials/$ID/Preview.outputs:surface>

            def Shader "Preview"
            {
                uniform token info:id = "UsdPreviewSurface"
                color3f inputs:diffuseColor = (0, 0, 0)
                color3f inputs:emissiveColor = $COLOR
                float inputs:ior = 1
                float inputs:roughness = 1
                token outputs:surface
            }
        }
"#;

impl UsdRoom<'_> {
    /// The room as USD text, whose surface has the picture `texture` as its albedo.
    ///
    /// # Panics
    /// A light has another number of radiances than its shape has lobes.
    pub fn text(&self, texture: &str) -> String {
        let mut text = String::from(HEAD);
        camera(&mut text, self.camera);
        self.surfaces(&mut text);
        text.push_str("\n    def Scope \"Lights\"\n    {\n");
        for light in &self.lights {
            assert_eq!(light.radiance.len(), light.shape.lobes(), "one radiance per lobe");
        }
        let shining = || self.lights.iter().filter(|light| light.shines());
        for light in shining() {
            match light.shape {
                Shape::Absent => {}
                Shape::Lamp(shape) => lamp(&mut text, light.id, shape, light.radiance[0]),
                Shape::Window(window) => self.window(&mut text, light, window),
            }
        }
        text.push_str("    }\n");
        text.push_str(&MATERIALS.replace("$TEXTURE", texture));
        for light in shining() {
            if let Shape::Lamp(Lamp::Surfels(_) | Lamp::Mesh(_)) = light.shape {
                let [r, g, b] = light.radiance[0].to_array();
                let color = format!("({r}, {g}, {b})");
                text.push_str(&EMISSIVE.replace("$ID", light.id).replace("$COLOR", &color));
            }
        }
        text.push_str("    }\n}\n");
        text
    }

    /// The seen surface; and apart from it that of each lamp, hidden while the lamp emits, as it
    /// would block the light.
    fn surfaces(&self, text: &mut String) {
        let light = |id: &str| self.lights.iter().find(|light| light.id == id);
        let is_window = |id: &str| light(id).is_some_and(|l| matches!(l.shape, Shape::Window(_)));
        let burns = |id: &str| {
            light(id).is_some_and(|light| matches!(light.shape, Shape::Lamp(_)) && light.shines())
        };
        let masks = self.masks.iter().filter(|(id, _)| !is_window(id));
        let own: Vec<(&str, Own)> = masks.map(|(id, mask)| (*id, Own::new(mask))).collect();
        let mut parts: Vec<Vec<[u32; 3]>> = vec![Vec::new(); own.len() + 1];
        for (corners, number) in self.mesh.faces() {
            let part = own.iter().position(|(_, own)| self.mesh.touches(number, own));
            parts[part.map_or(0, |part| part + 1)].push(corners);
        }
        surface(text, "Surface", self, &parts[0], None);
        for ((id, _), faces) in own.iter().zip(&parts[1..]) {
            let visibility = if burns(id) { "invisible" } else { "inherited" };
            surface(text, &format!("{id}_seen"), self, faces, Some(visibility));
        }
    }

    /// A window as a rectangle, and its suns.
    fn window(&self, text: &mut String, light: &UsdLight, window: &Window) {
        let UsdLight { id, shape, radiance } = *light;
        let pane = self.masks.iter().any(|(masked, _)| *masked == id);
        let is_sun = |lobe: &Lobe, w: Vec3| pane && lobe.bandwidth >= self.sun && w != Vec3::ZERO;
        let area = 4.0 * window.x.cross(window.y).length();
        let lobes = || window.lobes.iter().zip(radiance).enumerate();
        let wide = lobes().filter(|(_, (lobe, w))| !is_sun(lobe, **w));
        let power: Vec3 = wide.map(|(k, (_, w))| *w * shape.flux(k)).sum();
        let mean = if area > 0.0 { power / (PI * area) } else { Vec3::ZERO };
        let vector = |v: Vec3| format!("({}, {}, {})", v.x, v.y, v.z);
        let list = |items: Vec<String>| format!("[{}]", items.join(", "));
        let kept = [
            format!(
                "custom float3[] relight:direction = {}",
                list(lobes().map(|(_, (l, _))| vector(l.direction)).collect())
            ),
            format!(
                "custom float[] relight:bandwidth = {}",
                list(lobes().map(|(_, (l, _))| l.bandwidth.to_string()).collect())
            ),
            format!(
                "custom float3[] relight:radiance = {}",
                list(lobes().map(|(_, (_, w))| vector(*w)).collect())
            ),
        ];
        rectangle(text, (id, ""), [window.center, window.x, window.y], mean, &kept);
        for (_, (lobe, &w)) in lobes().filter(|(_, (lobe, w))| is_sun(lobe, **w)) {
            let irradiance = w * (TAU / lobe.bandwidth * -(-2.0 * lobe.bandwidth).exp_m1());
            let angle = (4.0 / lobe.bandwidth.sqrt()).to_degrees();
            let more = [format!("float inputs:angle = {angle}")];
            let (x, y) = lobe.direction.any_orthonormal_pair();
            distant_or_area(
                text,
                "DistantLight",
                (id, "_sun"),
                [x, y, lobe.direction, Vec3::ZERO],
                irradiance,
                true,
                &more,
            );
        }
    }
}

/// Only the ratios of lengths and apertures count; 36 is the width of a photographer's film in
/// millimeters.
fn camera(text: &mut String, camera: &Camera) {
    let (width, height) = (camera.width as f32, camera.height as f32);
    let focal = 36.0 * camera.fx / width;
    let across = |pixels: f32| focal * pixels / camera.fx;
    let upright = |pixels: f32| focal * pixels / camera.fy;
    text.push_str("    def Camera \"Camera\"\n    {\n");
    line(text, "float2 clippingRange = (0.01, 1000)");
    line(text, &format!("float focalLength = {focal}"));
    line(text, &format!("float horizontalAperture = {}", across(width)));
    line(text, &format!("float horizontalApertureOffset = {}", across(0.5 * width - camera.cx)));
    line(text, &format!("float verticalAperture = {}", upright(height)));
    line(text, &format!("float verticalApertureOffset = {}", upright(camera.cy - 0.5 * height)));
    line(text, "token projection = \"perspective\"");
    text.push_str("    }\n");
}

fn line(text: &mut String, line: &str) {
    writeln!(text, "        {line}").expect("writing to a string");
}

/// The faces as a mesh of the photo's texture; only the corners that they use, in their order.
fn surface(
    text: &mut String,
    name: &str,
    room: &UsdRoom,
    faces: &[[u32; 3]],
    visibility: Option<&str>,
) {
    let (width, height) = room.points.0.size();
    let mut number = vec![None; width * height];
    let mut corners: Vec<usize> = faces.iter().flatten().map(|&corner| corner as usize).collect();
    corners.sort_unstable();
    corners.dedup();
    corners.iter().enumerate().for_each(|(at, &corner)| number[corner] = Some(at));
    let at = |corner: u32| number[corner as usize].expect("every corner of a face is numbered");
    let place = |corner: usize| {
        let (x, y) = ((corner % width) as f32 + 0.5, (corner / width) as f32 + 0.5);
        Vec2::new(x / width as f32, 1.0 - y / height as f32)
    };
    write!(text, "\n    def Mesh \"{name}\" (\n        prepend apiSchemas = [\"MaterialBindingAPI\"]\n    )\n    {{\n")
        .expect("writing to a string");
    if let Some(visibility) = visibility {
        line(text, &format!("token visibility = \"{visibility}\""));
    }
    line(text, "uniform bool doubleSided = 1");
    line(text, "uniform token subdivisionScheme = \"none\"");
    line(text, "rel material:binding = </Room/Materials/Surface>");
    let mut list = |head: &str, items: &mut dyn Iterator<Item = String>, foot: &str| {
        text.push_str("        ");
        text.push_str(head);
        text.push('[');
        for (k, item) in items.enumerate() {
            if k > 0 {
                text.push_str(", ");
            }
            text.push_str(&item);
        }
        text.push(']');
        text.push_str(foot);
        text.push('\n');
    };
    list("int[] faceVertexCounts = ", &mut faces.iter().map(|_| "3".into()), "");
    list(
        "int[] faceVertexIndices = ",
        &mut faces.iter().flatten().map(|&corner| at(corner).to_string()),
        "",
    );
    let vector =
        |v: Vec3, digits: usize| format!("({:.digits$}, {:.digits$}, {:.digits$})", v.x, v.y, v.z);
    // A tenth of a millimeter, a twentieth of a degree, a hundredth of a pixel.
    let points = room.points.0.pixels();
    list("point3f[] points = ", &mut corners.iter().map(|&corner| vector(points[corner], 4)), "");
    let normals = room.normal.0.pixels();
    list(
        "normal3f[] normals = ",
        &mut corners.iter().map(|&corner| vector(normals[corner], 3)),
        " (interpolation = \"vertex\")",
    );
    let places = &mut corners
        .iter()
        .map(|&corner| place(corner))
        .map(|v| format!("({:.5}, {:.5})", v.x, v.y));
    list("texCoord2f[] primvars:st = ", places, " (interpolation = \"vertex\")");
    text.push_str("    }\n");
}

/// A lamp as lights of UsdLux, or as a mesh of an emissive material.
fn lamp(text: &mut String, id: &str, lamp: &Lamp, radiance: Vec3) {
    match lamp {
        // A profile would be a file of its own beside this one: a luminaire is the sphere of the
        // same flux.
        Lamp::Sphere(SphereLamp { center, radius })
        | Lamp::Photometric(PhotometricLamp { center, radius, .. }) => {
            let more = [format!("float inputs:radius = {radius}")];
            distant_or_area(
                text,
                "SphereLight",
                (id, ""),
                [Vec3::X, Vec3::Y, Vec3::Z, *center],
                radiance,
                false,
                &more,
            );
        }
        Lamp::Rect(RectLamp { center, x, y }) => {
            rectangle(text, (id, ""), [*center, *x, *y], radiance, &[])
        }
        Lamp::Box(BoxLamp { center, axes: [x, y, z] }) => {
            // The other two axes of each side, ordered so that their cross product points outwards.
            let hand = if x.cross(*y).dot(*z) < 0.0 { -1.0 } else { 1.0 };
            let pairs = [(*x, *y * hand, *z), (*y, *z * hand, *x), (*z, *x * hand, *y)];
            for (k, (out, a, b)) in pairs.into_iter().enumerate() {
                let [front, back] = [2 * k, 2 * k + 1].map(|side| format!("_{side}"));
                rectangle(text, (id, &front), [*center + out, a, b], radiance, &[]);
                rectangle(text, (id, &back), [*center - out, b, a], radiance, &[]);
            }
        }
        Lamp::Surfels(surfels) => emissive(text, id, surfels.iter().flat_map(Surfel::square)),
        Lamp::Mesh(MeshLamp { corners, triangles, .. }) => {
            emissive(text, id, triangles.iter().map(|t| t.map(|corner| corners[corner as usize])));
        }
    }
}

/// A rectangle of half edges `x` and `y` that emits to the side of their cross product. UsdLux
/// lights emit along their own -z.
fn rectangle(
    text: &mut String,
    id: (&str, &str),
    [center, x, y]: [Vec3; 3],
    radiance: Vec3,
    more: &[String],
) {
    let sides = [
        format!("float inputs:width = {}", 2.0 * x.length()),
        format!("float inputs:height = {}", 2.0 * y.length()),
    ];
    let (ex, ey) = (x.normalize_or_zero(), -y.normalize_or_zero());
    distant_or_area(
        text,
        "RectLight",
        id,
        [ex, ey, ex.cross(ey), center],
        radiance,
        false,
        &[&sides, more].concat(),
    );
}

/// The light that a prim is a part of.
fn of_light(id: &str) -> String {
    format!("custom string relight:light = \"{id}\"")
}

/// A light of UsdLux, or the part of that name of one, with its axes x, y, z and its position;
/// `normalize` is that of UsdLux.
fn distant_or_area(
    text: &mut String,
    kind: &str,
    (id, part): (&str, &str),
    frame: [Vec3; 4],
    radiance: Vec3,
    normalize: bool,
    more: &[String],
) {
    let intensity = radiance.max_element();
    let color = if intensity > 0.0 { radiance / intensity } else { Vec3::ONE };
    let row = |v: Vec3, last: u32| format!("({}, {}, {}, {last})", v.x, v.y, v.z);
    let [x, y, z, place] = frame;
    write!(text, "        def {kind} \"{id}{part}\"\n        {{\n").expect("writing to a string");
    let mut put = |entry: &str| line(text, &format!("    {entry}"));
    put(&of_light(id));
    put(&format!("color3f inputs:color = ({}, {}, {})", color.x, color.y, color.z));
    put(&format!("float inputs:intensity = {intensity}"));
    put(&format!("bool inputs:normalize = {}", u32::from(normalize)));
    more.iter().for_each(|entry| put(entry));
    let rows = [row(x, 0), row(y, 0), row(z, 0), row(place, 1)].join(", ");
    put(&format!("matrix4d xformOp:transform = ( {rows} )"));
    put("uniform token[] xformOpOrder = [\"xformOp:transform\"]");
    text.push_str("        }\n");
}

/// Triangles that emit from their front, as a mesh of an emissive material.
fn emissive(text: &mut String, id: &str, triangles: impl Iterator<Item = [Vec3; 3]>) {
    let points: Vec<String> =
        triangles.flatten().map(|p| format!("({}, {}, {})", p.x, p.y, p.z)).collect();
    let list = |items: &mut dyn Iterator<Item = String>| items.collect::<Vec<_>>().join(", ");
    write!(text, "        def Mesh \"{id}\" (\n            prepend apiSchemas = [\"MaterialBindingAPI\"]\n        )\n        {{\n")
        .expect("writing to a string");
    let mut put = |entry: &str| line(text, &format!("    {entry}"));
    put(&of_light(id));
    put("uniform token subdivisionScheme = \"none\"");
    put(&format!("rel material:binding = </Room/Materials/{id}>"));
    put(&format!(
        "int[] faceVertexCounts = [{}]",
        list(&mut (0..points.len() / 3).map(|_| "3".into()))
    ));
    put(&format!(
        "int[] faceVertexIndices = [{}]",
        list(&mut (0..points.len()).map(|i| i.to_string()))
    ));
    put(&format!("point3f[] points = [{}]", points.join(", ")));
    text.push_str("        }\n");
}
