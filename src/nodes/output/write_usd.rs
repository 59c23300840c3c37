//! WriteUsd: the room as other programs read it: USD text with the seen surface, the camera and UsdLux lights.
//!
//! A light of radiance L is a UsdLux light of `intensity` x `color` = L with `normalize` off. A window shows three lobes, and no light of UsdLux does:
//! it becomes a rectangle that sends the same power into the room,
//! L = sum_k w_k F_k / (pi S), F_k being the power of lobe k per unit radiance and S the area, and a narrow lobe of a window
//! whose pane is a hole in the surface becomes a distant light of the irradiance w (2 pi / lambda) (1 - exp(-2 lambda)) and of the disc whose second
//! moment is the lobe's, half angle 2 / sqrt(lambda).

use std::f32::consts::{PI, TAU};
use std::fmt::Write as _;
use std::sync::Arc;

use glam::{Vec2, Vec3};

use crate::geometry::{Camera, Own, SceneMesh};
use crate::graph::{Context, Gather, Node, NodeError, above};
use crate::image::{Albedo, Mask, Normal, Picture, Points, Transfer, write_png};
use crate::nodes::artifacts::Files;
use crate::optics::{Lamp, Lobe, Plate, Radiance, Shape, Window, flux};
use crate::{params, ports};

params! {
    /// Writes the seen room, its lights and the camera as USD, for Blender and other programs.
    /// docs/export.md lists the losses. `relight export` runs it.
    pub struct WriteUsd {
        /// Least bandwidth at which a lobe of a visible window is written as a distant light, which
        /// keeps its sunlit areas in place.
        sun: f32 = 100.0, in above(0.0),
    }
}

ports! {
    pub input WriteUsdIn {
        /// The camera of the photo.
        camera: Arc<Camera>,
        /// Surface points at pixel centers.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// The triangles between them.
        mesh: Arc<SceneMesh>,
        /// Albedo, working size.
        albedo: Arc<Albedo>,
        /// The pixels of each visible light, working size.
        mask: Gather<Mask>,
        /// The lights.
        shape: Gather<Shape>,
        /// Their radiances.
        radiance: Gather<Radiance>,
    }
}
ports! {
    pub output WriteUsdOut {
        /// `room.usda` and its texture `room_albedo.png`.
        files: Arc<Files>,
    }
}

impl Node for WriteUsd {
    const KIND: &'static str = "WriteUsd";
    const VERSION: u32 = 1;
    type In = WriteUsdIn;
    type Out = WriteUsdOut;

    fn run(&self, inputs: WriteUsdIn, _: &Context) -> Result<WriteUsdOut, NodeError> {
        let size = inputs.points.0.size();
        super::same_size("normal", inputs.normal.0.size(), "points", size)?;
        super::same_size("albedo", inputs.albedo.0.size(), "points", size)?;
        super::same_size("mesh", inputs.mesh.size(), "points", size)?;
        for (id, mask) in inputs.mask.iter() {
            super::same_size(&format!("mask `{id}`"), mask.0.size(), "points", size)?;
        }
        let mut lights = Vec::new();
        for (id, shape) in inputs.shape.iter() {
            let radiance = inputs.radiance.get(id).map_or(&[][..], |radiance| &radiance.0);
            if radiance.len() != shape.lobes() {
                let (wanted, got) = (shape.lobes(), radiance.len());
                return Err(NodeError::Failed(format!(
                    "light {id}: wanted {wanted} radiances, one per lobe, got {got}"
                )));
            }
            lights.push((id, &**shape, radiance));
        }
        let mut text = String::from(HEAD);
        camera(&mut text, &inputs.camera);
        self.surfaces(&mut text, &inputs, &lights);
        text.push_str("\n    def Scope \"Lights\"\n    {\n");
        for (id, shape, radiance) in &lights {
            match shape {
                Shape::Absent => {}
                Shape::Lamp(lamp) => self::lamp(&mut text, id, lamp, radiance[0]),
                Shape::Window(window) => {
                    self.window(&mut text, id, window, shape, radiance, inputs.mask.get(id).is_some());
                }
            }
        }
        text.push_str("    }\n");
        text.push_str(MATERIALS);
        for (id, shape, radiance) in &lights {
            if let Shape::Lamp(Lamp::Plates(_) | Lamp::Mesh { .. } | Lamp::Model { .. }) = shape {
                let [r, g, b] = radiance[0].to_array();
                text.push_str(&GLOW.replace("$ID", id).replace("$COLOUR", &format!("({r}, {g}, {b})")));
            }
        }
        text.push_str("    }\n}\n");
        let albedo = Picture(inputs.albedo.0.clone());
        let png = write_png(&albedo, Transfer::Srgb, false);
        Ok(WriteUsdOut { files: Arc::new(Files(vec![(TEXT.into(), text.into_bytes()), (TEXTURE.into(), png)])) })
    }
}

/// The file of USD text.
pub const TEXT: &str = "room.usda";
/// Its texture, as the text names it.
pub const TEXTURE: &str = "room_albedo.png";

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
                asset inputs:file = @./room_albedo.png@
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

const GLOW: &str = r#"
        def Material "$ID"
        {
            token outputs:surface.connect = </Room/Materials/$ID/Preview.outputs:surface>

            def Shader "Preview"
            {
                uniform token info:id = "UsdPreviewSurface"
                color3f inputs:diffuseColor = (0, 0, 0)
                color3f inputs:emissiveColor = $COLOUR
                float inputs:ior = 1
                float inputs:roughness = 1
                token outputs:surface
            }
        }
"#;

/// Only the ratios of lengths and apertures count; 36 is the width of a photographer's film in millimetres.
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

impl WriteUsd {
    /// The seen surface, and by itself and hidden the surface of each lamp that burns, which would stand in the way of its light.
    fn surfaces(&self, text: &mut String, inputs: &WriteUsdIn, lights: &[(&str, &Shape, &[Vec3])]) {
        let burns = |id: &str| {
            let light = lights.iter().find(|(light, ..)| *light == id);
            light.is_some_and(|(_, shape, radiance)| {
                matches!(shape, Shape::Lamp(_)) && radiance.iter().any(|&w| w != Vec3::ZERO)
            })
        };
        let own: Vec<(&str, Own)> =
            inputs.mask.iter().filter(|(id, _)| burns(id)).map(|(id, mask)| (id, Own::new(mask))).collect();
        let mut parts: Vec<Vec<[u32; 3]>> = vec![Vec::new(); own.len() + 1];
        for (corners, number) in inputs.mesh.faces() {
            let part = own.iter().position(|(_, own)| inputs.mesh.touches(number, own));
            parts[part.map_or(0, |part| part + 1)].push(corners);
        }
        surface(text, "Surface", inputs, &parts[0], true);
        for ((id, _), faces) in own.iter().zip(&parts[1..]) {
            surface(text, &format!("{id}_seen"), inputs, faces, false);
        }
    }

    fn window(&self, text: &mut String, id: &str, window: &Window, shape: &Shape, radiance: &[Vec3], pane: bool) {
        let is_sun = |lobe: &Lobe, w: Vec3| pane && lobe.bandwidth >= self.sun && w != Vec3::ZERO;
        let area = 4.0 * window.x.cross(window.y).length();
        let lobes = || window.lobes.iter().zip(radiance).enumerate();
        let wide = lobes().filter(|(_, (lobe, w))| !is_sun(lobe, **w));
        let power: Vec3 = wide.map(|(k, (_, w))| *w * flux(shape, k)).sum();
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
            format!("custom float3[] relight:radiance = {}", list(lobes().map(|(_, (_, w))| vector(*w)).collect())),
        ];
        rectangle(text, id, [window.center, window.x, window.y], mean, &kept);
        for (_, (lobe, &w)) in lobes().filter(|(_, (lobe, w))| is_sun(lobe, **w)) {
            let irradiance = w * (TAU / lobe.bandwidth * -(-2.0 * lobe.bandwidth).exp_m1());
            let angle = (4.0 / lobe.bandwidth.sqrt()).to_degrees();
            let more = [format!("float inputs:angle = {angle}")];
            let (x, y) = lobe.direction.any_orthonormal_pair();
            light(
                text,
                "DistantLight",
                &format!("{id}_sun"),
                [x, y, lobe.direction, Vec3::ZERO],
                irradiance,
                true,
                &more,
            );
        }
    }
}

fn surface(text: &mut String, name: &str, inputs: &WriteUsdIn, faces: &[[u32; 3]], visible: bool) {
    let (width, height) = inputs.points.0.size();
    // Only the corners that are used, in their order.
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
    if !visible {
        line(text, "token visibility = \"invisible\"");
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
    list("int[] faceVertexIndices = ", &mut faces.iter().flatten().map(|&corner| at(corner).to_string()), "");
    let vector = |v: Vec3, digits: usize| format!("({:.digits$}, {:.digits$}, {:.digits$})", v.x, v.y, v.z);
    // A tenth of a millimetre, a twentieth of a degree, a hundredth of a pixel.
    let points = inputs.points.0.pixels();
    list("point3f[] points = ", &mut corners.iter().map(|&corner| vector(points[corner], 4)), "");
    let normals = inputs.normal.0.pixels();
    list(
        "normal3f[] normals = ",
        &mut corners.iter().map(|&corner| vector(normals[corner], 3)),
        " (interpolation = \"vertex\")",
    );
    let places = &mut corners.iter().map(|&corner| place(corner)).map(|v| format!("({:.5}, {:.5})", v.x, v.y));
    list("texCoord2f[] primvars:st = ", places, " (interpolation = \"vertex\")");
    text.push_str("    }\n");
}

fn lamp(text: &mut String, id: &str, lamp: &Lamp, radiance: Vec3) {
    match lamp {
        // A profile would be a file of its own beside this one: a luminaire is the sphere of the same flux.
        Lamp::Sphere { center, radius } | Lamp::Luminaire { center, radius, .. } => {
            let more = [format!("float inputs:radius = {radius}")];
            light(text, "SphereLight", id, [Vec3::X, Vec3::Y, Vec3::Z, *center], radiance, false, &more);
        }
        Lamp::Rect { center, x, y } => rectangle(text, id, [*center, *x, *y], radiance, &[]),
        Lamp::Box { center, axes: [x, y, z] } => {
            // The other two axes of each side, ordered so that their cross product points outwards.
            let hand = if x.cross(*y).dot(*z) < 0.0 { -1.0 } else { 1.0 };
            let pairs = [(*x, *y * hand, *z), (*y, *z * hand, *x), (*z, *x * hand, *y)];
            for (k, (out, a, b)) in pairs.into_iter().enumerate() {
                rectangle(text, &format!("{id}_{}", 2 * k), [*center + out, a, b], radiance, &[]);
                rectangle(text, &format!("{id}_{}", 2 * k + 1), [*center - out, b, a], radiance, &[]);
            }
        }
        Lamp::Plates(plates) => glowing(text, id, plates.iter().flat_map(Plate::square)),
        Lamp::Mesh { corners, triangles } | Lamp::Model { corners, triangles } => {
            glowing(text, id, triangles.iter().map(|t| t.map(|corner| corners[corner as usize])));
        }
    }
}

/// A rectangle of half edges that shines to the side of their cross product; UsdLux lights shine along their own -z.
fn rectangle(text: &mut String, id: &str, [center, x, y]: [Vec3; 3], radiance: Vec3, more: &[String]) {
    let sides =
        [format!("float inputs:width = {}", 2.0 * x.length()), format!("float inputs:height = {}", 2.0 * y.length())];
    let (ex, ey) = (x.normalize_or_zero(), -y.normalize_or_zero());
    light(text, "RectLight", id, [ex, ey, ex.cross(ey), center], radiance, false, &[&sides, more].concat());
}

/// A UsdLux light with its axes and place.
fn light(text: &mut String, kind: &str, id: &str, frame: [Vec3; 4], radiance: Vec3, normalize: bool, more: &[String]) {
    let intensity = radiance.max_element();
    let colour = if intensity > 0.0 { radiance / intensity } else { Vec3::ONE };
    let row = |v: Vec3, last: u32| format!("({}, {}, {}, {last})", v.x, v.y, v.z);
    let [x, y, z, place] = frame;
    write!(text, "        def {kind} \"{id}\"\n        {{\n").expect("writing to a string");
    let mut put = |entry: &str| line(text, &format!("    {entry}"));
    put(&format!("color3f inputs:color = ({}, {}, {})", colour.x, colour.y, colour.z));
    put(&format!("float inputs:intensity = {intensity}"));
    put(&format!("bool inputs:normalize = {}", u32::from(normalize)));
    more.iter().for_each(|entry| put(entry));
    let rows = [row(x, 0), row(y, 0), row(z, 0), row(place, 1)].join(", ");
    put(&format!("matrix4d xformOp:transform = ( {rows} )"));
    put("uniform token[] xformOpOrder = [\"xformOp:transform\"]");
    text.push_str("        }\n");
}

/// Triangles that shine from their front, as a surface of a glowing material.
fn glowing(text: &mut String, id: &str, triangles: impl Iterator<Item = [Vec3; 3]>) {
    let points: Vec<String> = triangles.flatten().map(|p| format!("({}, {}, {})", p.x, p.y, p.z)).collect();
    let list = |items: &mut dyn Iterator<Item = String>| items.collect::<Vec<_>>().join(", ");
    write!(text, "        def Mesh \"{id}\" (\n            prepend apiSchemas = [\"MaterialBindingAPI\"]\n        )\n        {{\n")
        .expect("writing to a string");
    let mut put = |entry: &str| line(text, &format!("    {entry}"));
    put("uniform token subdivisionScheme = \"none\"");
    put(&format!("rel material:binding = </Room/Materials/{id}>"));
    put(&format!("int[] faceVertexCounts = [{}]", list(&mut (0..points.len() / 3).map(|_| "3".into()))));
    put(&format!("int[] faceVertexIndices = [{}]", list(&mut (0..points.len()).map(|i| i.to_string()))));
    put(&format!("point3f[] points = [{}]", points.join(", ")));
    text.push_str("        }\n");
}
