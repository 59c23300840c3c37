//! One small picture per stage, of a room that is known in closed form: floor, three walls, a ceiling and a box.
//!
//! `RELIGHT_BLESS=mesh,shadow cargo test --release --test pipeline goldens` takes what these stages give now as right; look at
//! it first: a failure leaves expected, got and difference (times 8) side by side in target/golden. Never blessed in CI.

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use glam::Vec3;
use relight::geometry::{Camera, Model, Objects, SceneMesh};
use relight::graph::{Context, Gather, Node, Params};
use relight::image::{
    Albedo, Depth, Mask, Normal, PaintLayers, Picture, Plane, Points, Roughness, Shading, SpecularEdit, Transfer,
    write_png,
};
use relight::nodes::artifacts::{Encoding, UnitDirect, UnitIndirect, Visibility};
use relight::nodes::edit::Color;
use relight::nodes::edit::edit_materials::{EditMaterials, EditMaterialsIn, MaterialEdit, Region};
use relight::nodes::edit::edit_objects::{EditObjects, EditObjectsIn};
use relight::nodes::estimate::find_lights::{FindLights, FindLightsIn};
use relight::nodes::estimate::paint::{Paint, PaintIn};
use relight::nodes::estimate::retinex_materials::{RetinexMaterials, RetinexMaterialsIn};
use relight::nodes::output::compose::{Compose, ComposeIn};
use relight::nodes::render::{
    direct::{Direct, DirectIn},
    emitter_mask::{EmitterMask, EmitterMaskIn},
    light_objects::{LightObjects, LightObjectsIn},
    mix::{Mix, MixIn},
    shade_specular_edit::{ShadeSpecularEdit, ShadeSpecularEditIn},
    shadow::{Shadow, ShadowIn},
    trace_indirect::{TraceIndirect, TraceIndirectIn},
    transport::{Transport, TransportIn},
};
use relight::nodes::scene::mesh::{Mesh, MeshIn};
use relight::optics::{Lamp, LightKind, MeshLamp, Radiance, Shape, SpecularChange, SphereLamp, Window};

use crate::project::{png, root};

const NAMES: [&str; 21] = [
    "mesh",
    "find",
    "retinex",
    "direct",
    "shadow",
    "indirect",
    "mix",
    "glow",
    "mesh_lamp",
    "compose",
    "edit_materials",
    "polish",
    "objects", // and with networks:
    "mnet",
    "vis_lamp_net",
    "vis_win_net",
    "inv_lamp_net",
    "inv_win_net",
    "shadow_net",
    "indirect_net",
    "light_net",
];
pub const SIZE: (usize, usize) = (64, 48);
/// Two steps of 255: another compiler or processor may round differently, and a step of rounding may fall either way.
const TOLERANCE: u8 = 2;
/// Pixels that may differ by more: at the edge of a shadow one ray of eight may fall on the other side. At most 15 of 3072.
const STRAYS: f64 = 0.005;

fn folder() -> PathBuf {
    root().join("tests/golden")
}

/// Names in RELIGHT_BLESS: goldens, and `scores`.
pub fn blessed() -> Vec<String> {
    let Ok(names) = std::env::var("RELIGHT_BLESS") else { return Vec::new() };
    assert!(std::env::var_os("CI").is_none(), "goldens are blessed by a person who looked at them, not in CI");
    let names: Vec<String> = names.split(',').map(|name| name.trim().to_owned()).collect();
    let unknown: Vec<_> = names.iter().filter(|name| !NAMES.contains(&name.as_str()) && *name != "scores").collect();
    assert!(unknown.is_empty(), "there is no golden {unknown:?}, only {NAMES:?}");
    names
}

/// `picture` (0..1, linear) against the golden of this name.
pub fn check(name: &str, picture: Plane<Vec3>) {
    assert!(NAMES.contains(&name), "{name} is on the list of goldens");
    let bytes = write_png(&Picture(picture), Transfer::Srgb, false);
    let path = folder().join(format!("{name}.png"));
    if blessed().iter().any(|blessed| blessed == name) {
        return std::fs::write(path, bytes).expect("the project can be written to");
    }
    let got = png(&bytes);
    let expected = std::fs::read(&path).map(|bytes| png(&bytes)).unwrap_or_default();
    let same_size = got.dimensions() == expected.dimensions();
    let far = |a: &image::Rgb<u8>, b: &image::Rgb<u8>| (0..3).any(|c| a.0[c].abs_diff(b.0[c]) > TOLERANCE);
    let strays = got.pixels().zip(expected.pixels()).filter(|(a, b)| far(a, b)).count();
    if !same_size || strays as f64 > STRAYS * (SIZE.0 * SIZE.1) as f64 {
        let shown = root().join(format!("target/golden/{name}.png"));
        std::fs::create_dir_all(shown.parent().expect("it lies in a folder")).expect("target can be written to");
        side_by_side(&expected, &got).save(&shown).expect("target can be written to");
        panic!("{name}: {strays} pixels differ by more than {TOLERANCE}/255; see {}", shown.display());
    }
}

fn side_by_side(expected: &image::RgbImage, got: &image::RgbImage) -> image::RgbImage {
    let (width, height) = got.dimensions();
    image::RgbImage::from_fn(3 * width, height, |x, y| {
        let (part, x) = (x / width, x % width);
        let was = expected.get_pixel_checked(x, y).copied().unwrap_or(image::Rgb([255, 0, 255]));
        let is = *got.get_pixel(x, y);
        match part {
            0 => was,
            1 => is,
            _ => image::Rgb([0, 1, 2].map(|c| was.0[c].abs_diff(is.0[c]).saturating_mul(8))),
        }
    })
}

#[test]
fn every_golden_is_used() {
    if !blessed().is_empty() {
        return; // some are being written
    }
    let entries = std::fs::read_dir(folder()).expect("the goldens are there");
    let mut there: Vec<String> =
        entries.map(|entry| entry.expect("it can be listed").file_name().to_string_lossy().into_owned()).collect();
    there.sort();
    let mut wanted = NAMES.map(|name| format!("{name}.png"));
    wanted.sort();
    assert_eq!(there, wanted);
}

/// The room, and what the stages make of it, each from those before.
pub struct Room {
    pub camera: Arc<Camera>,
    pub depth: Arc<Depth>,
    /// Of the walls and the box themselves.
    pub true_normal: Plane<Vec3>,
    pub points: Arc<Points>,
    pub normal: Arc<Normal>,
    pub albedo: Arc<Albedo>,
    pub lights: Vec<Light>,
}

pub struct Light {
    pub id: &'static str,
    pub shape: Arc<Shape>,
    pub radiance: Arc<Radiance>,
    pub direct: Arc<UnitDirect>,
    pub visibility: Arc<Visibility>,
    pub indirect: Arc<UnitIndirect>,
}

/// Distance along `ray` to the nearest surface, and its normal.
fn cast(ray: Vec3) -> (f32, Vec3) {
    let walls = [
        (Vec3::Y, Vec3::new(0.0, -1.0, 0.0)),
        (Vec3::NEG_Y, Vec3::new(0.0, 1.5, 0.0)),
        (Vec3::X, Vec3::new(-1.6, 0.0, 0.0)),
        (Vec3::NEG_X, Vec3::new(2.0, 0.0, 0.0)),
        (Vec3::Z, Vec3::new(0.0, 0.0, -4.0)),
    ];
    let wall = walls.into_iter().filter(|(n, _)| n.dot(ray) < 0.0).map(|(n, p)| (n.dot(p) / n.dot(ray), n));
    let (low, high) = (Vec3::new(0.2, -1.0, -3.3), Vec3::new(0.9, -0.3, -2.6));
    let (a, b) = (low / ray, high / ray);
    let (enter, leave) = (a.min(b), a.max(b));
    let t = enter.max_element();
    let axis = (0..3).find(|&i| enter[i] == t).unwrap_or(0);
    let face = (t > 0.0 && t < leave.min_element()).then(|| (t, -Vec3::AXES[axis] * ray[axis].signum()));
    wall.chain(face).min_by(|a, b| a.0.total_cmp(&b.0)).expect("every ray of the camera meets the room")
}

pub fn room() -> &'static Room {
    static ROOM: OnceLock<Room> = OnceLock::new();
    ROOM.get_or_init(|| {
        let ctx = Context::default();
        let (w, h) = SIZE;
        let camera = Arc::new(Camera::from_fov_x(w, h, 62.0));
        let ray = |x, y| camera.pixel_point(x, y, 1.0);
        let depth = Arc::new(Depth(Plane::from_fn(w, h, |x, y| cast(ray(x, y)).0)));
        let true_normal = Plane::from_fn(w, h, |x, y| cast(ray(x, y)).1);
        let (masks, kinds) = (Gather(vec![]), Gather(vec![]));
        let inputs = MeshIn { depth: depth.clone(), camera: camera.clone(), ignore: None, masks, kinds };
        let seen = Mesh {}.run(inputs, &ctx).expect("the room is sound");
        // A floor of tiles, white walls, a red box.
        let albedo = Plane::from_fn(w, h, |x, y| {
            let (t, n) = cast(ray(x, y));
            let p = ray(x, y) * t;
            let tile = ((p.x / 0.5).floor() + (p.z / 0.5).floor()).rem_euclid(2.0);
            match n {
                Vec3::Y if p.y < -0.9 => Vec3::new(0.25, 0.2, 0.15) + 0.3 * tile,
                _ if p.z > -3.4 && p.x > 0.1 && p.x < 1.0 && p.y < -0.2 => Vec3::new(0.5, 0.1, 0.08),
                _ => Vec3::new(0.75, 0.74, 0.7),
            }
        });
        let albedo = Arc::new(Albedo(albedo));
        let inputs = TransportIn { mesh: seen.mesh.clone(), points: seen.points.clone(), normal: seen.normal.clone() };
        let transport = Transport::default().run(inputs, &ctx).expect("the room is sound").transport;
        let lamp = Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::new(-0.5, 0.6, -3.0), radius: 0.12 }));
        let x = Vec3::new(0.0, 0.0, -0.5);
        let window = Window {
            center: Vec3::new(-1.59, 0.4, -2.9),
            x,
            y: Vec3::new(0.0, 0.45, 0.0),
            lobes: Window::daylight(Vec3::X),
        };
        let window = if x.cross(window.y).x > 0.0 { window } else { Window { x: -x, ..window } };
        let light = |id, shape: Shape, radiance: Vec<Vec3>| {
            let shape = Arc::new(shape);
            let (points, normal) = (seen.points.clone(), seen.normal.clone());
            let inputs = DirectIn { points: points.clone(), normal: normal.clone(), shape: shape.clone() };
            let direct = Direct::default().run(inputs, &ctx).expect("the light is sound").direct;
            let (mesh, mask) = (seen.mesh.clone(), None);
            let inputs = ShadowIn { points: points.clone(), normal: normal.clone(), mesh, shape: shape.clone(), mask };
            let visibility = Shadow::default().run(inputs, &ctx).expect("the light is sound").visibility;
            let inputs = TraceIndirectIn {
                transport: transport.clone(),
                points,
                normal,
                albedo: albedo.clone(),
                direct: direct.clone(),
                visibility: visibility.clone(),
                objects: None,
            };
            let indirect = TraceIndirect::default().run(inputs, &ctx).expect("the light is sound").indirect;
            Light { id, shape, radiance: Arc::new(Radiance(radiance)), direct, visibility, indirect }
        };
        let sky = vec![Vec3::ZERO, Vec3::new(4.0, 5.0, 6.0), Vec3::new(1.5, 1.4, 1.0)];
        let lights =
            vec![light("lamp", lamp, vec![Vec3::new(14.0, 9.0, 5.0)]), light("window", Shape::Window(window), sky)];
        Room { camera, depth, true_normal, points: seen.points, normal: seen.normal, albedo, lights }
    })
}

/// What casts shadows in it.
pub fn mesh_of_room() -> Arc<SceneMesh> {
    let (depth, camera) = (room().depth.clone(), room().camera.clone());
    let inputs = MeshIn { depth, camera, ignore: None, masks: Gather(vec![]), kinds: Gather(vec![]) };
    Mesh {}.run(inputs, &Context::default()).expect("the room is sound").mesh
}

impl Room {
    /// Shading by each light, its radiance times a factor.
    pub fn shading(&self, factors: [f32; 2]) -> Vec<(String, Arc<Shading>)> {
        let (mut direct, mut visibility, mut indirect) = (vec![], vec![], vec![]);
        for light in &self.lights {
            direct.push((light.id.into(), light.direct.clone()));
            visibility.push((light.id.into(), light.visibility.clone()));
            indirect.push((light.id.into(), light.indirect.clone()));
        }
        let scaled = |(light, f): (&Light, f32)| {
            let radiance = Radiance(light.radiance.0.iter().map(|&w| w * f).collect());
            (light.id.to_string(), Arc::new(radiance))
        };
        let radiance = Gather(self.lights.iter().zip(factors).map(scaled).collect());
        let inputs = MixIn {
            camera: self.camera.clone(),
            direct: Gather(direct),
            visibility: Gather(visibility),
            indirect: Gather(indirect),
            radiance,
        };
        Mix {}.run(inputs, &Context::default()).expect("the lights are sound").light.0
    }

    /// The room as a camera sees it.
    pub fn photo(&self) -> Picture {
        let shading = self.shading([1.0, 1.0]);
        let pixel = |i: usize, a: &Vec3| *a * shading.iter().map(|(_, e)| e.0.pixels()[i]).sum::<Vec3>();
        let pixels = self.albedo.0.pixels().iter().enumerate().map(|(i, a)| pixel(i, a)).collect();
        Picture(Plane::new(SIZE.0, SIZE.1, pixels))
    }
}

pub fn zip3(a: &Plane<f32>, b: &Plane<f32>, c: &Plane<f32>, by: [f32; 3]) -> Plane<Vec3> {
    Plane::from_fn(a.width(), a.height(), |x, y| {
        Vec3::new(by[0] * a.get(x, y), by[1] * b.get(x, y), by[2] * c.get(x, y))
    })
}

#[test]
fn mesh() {
    let room = room();
    // Away from creases a plane's normal is exact; a pixel in twenty lies at one.
    let pairs = room.normal.0.pixels().iter().zip(room.true_normal.pixels());
    let off = pairs.filter(|(got, want)| got.dot(**want) < 0.999).count();
    assert!(off * 20 < SIZE.0 * SIZE.1, "{off} normals are off by more than 2.6 degrees");
    let far = room.points.0.pixels().iter().zip(room.depth.0.pixels()).filter(|(p, z)| (p.z + **z).abs() > 1e-3 * **z);
    assert_eq!(far.count(), 0, "points of exact depth stay where they are");
    check("mesh", room.normal.0.map(|n| 0.5 * n + 0.5));
}

/// A glowing ball, half hidden by the box, outlined and named.
#[test]
fn find() {
    let room = room();
    let clipped = cover(&ball(), None);
    let lit = room.photo().0;
    let photo = Plane::from_fn(SIZE.0, SIZE.1, |x, y| lit.get(x, y).lerp(Vec3::ONE, clipped.0.get(x, y)));
    let photo = Arc::new(Picture(photo));
    let before_the_wall = |x, y| match clipped.0.get(x, y) > 0.5 {
        true => room.camera.pixel_point(x, y, 3.2),
        false => room.points.0.get(x, y),
    };
    let points = Points(Plane::from_fn(SIZE.0, SIZE.1, before_the_wall));
    let inputs = FindLightsIn {
        photo: photo.clone(),
        encoding: Arc::new(Encoding { transfer: Transfer::Srgb, lux: None, sixteen_bit: false }),
        small: photo,
        clipped,
        points: Some(Arc::new(points)),
        normal: Some(room.normal.clone()),
    };
    let files = FindLights::default().run(inputs, &Context::default()).expect("the room is sound").files;
    let names: Vec<&str> = files.0.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["masks/lamp_0.png", "found.png", "scene_lights.ron"]);
    let overview = png(&files.0[1].1);
    let linear = |x: usize, y: usize| {
        overview.get_pixel(x as u32, y as u32).0.map(|v| Transfer::Srgb.decode(f32::from(v) / 255.0))
    };
    check("find", Plane::from_fn(SIZE.0, SIZE.1, |x, y| Vec3::from_array(linear(x, y))));
}

#[test]
fn retinex() {
    let room = room();
    let inputs = RetinexMaterialsIn { photo: Arc::new(room.photo()), normal: room.normal.clone() };
    let out = RetinexMaterials::default().run(inputs, &Context::default()).expect("the photo is sound");
    check("retinex", out.albedo.0.clone());
}

/// Lamp, sky and ground in red, green and blue.
#[test]
fn direct() {
    let [lamp, window] = &room().lights[..] else { panic!("a lamp and a window") };
    check("direct", zip3(&lamp.direct.lobes[0], &window.direct.lobes[1], &window.direct.lobes[2], [30.0, 8.0, 8.0]));
}

/// What is lit by the lamp and by the sky, and what is unknown of the lamp.
#[test]
fn shadow() {
    let [lamp, window] = &room().lights[..] else { panic!("a lamp and a window") };
    let (lit, sky, unknown) = (&lamp.visibility.lit[0], &window.visibility.lit[1], &lamp.visibility.unknown[0]);
    check("shadow", zip3(lit, sky, unknown, [1.0; 3]));
}

#[test]
fn indirect() {
    check("indirect", room().lights[0].indirect.lobes[0].0.map(|e| e * 30.0));
}

#[test]
fn mix() {
    let shading = room().shading([1.0, 0.5]);
    let pixels = |i: usize| shading.iter().map(|(_, e)| e.0.pixels()[i]).sum::<Vec3>();
    check("mix", Plane::new(SIZE.0, SIZE.1, (0..SIZE.0 * SIZE.1).map(pixels).collect()));
}

/// Half hidden by the box.
fn ball() -> Arc<Shape> {
    Arc::new(Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::new(0.2, -0.35, -3.4), radius: 0.3 })))
}

pub fn cover(shape: &Arc<Shape>, estimated: Option<&Arc<Shape>>) -> Arc<Mask> {
    let (camera, depth) = (room().camera.clone(), room().depth.clone());
    let inputs = EmitterMaskIn { shape: shape.clone(), estimated: estimated.cloned(), camera, depth };
    EmitterMask::default().run(inputs, &Context::default()).expect("the light is sound").cover
}

#[test]
fn glow() {
    check("glow", cover(&ball(), None).0.map(Vec3::splat));
}

/// The lantern that ships, as it is seen, and its light on the room, shadows apart and in them.
#[test]
fn mesh_lamp() {
    let file = std::fs::read(root().join("scenes/demo/models/lantern.obj")).expect("it ships");
    let model = Model::read("lantern.obj", &file, &mut |_| unreachable!("it names no other")).expect("it is sound");
    let corners = model.positions.into_iter().map(|p| Vec3::new(-0.3, 0.1, -3.1) + 0.7 * p).collect();
    let shape = Arc::new(Shape::Lamp(Lamp::Mesh(MeshLamp::new(corners, model.triangles))));
    let (points, normal) = (room().points.clone(), room().normal.clone());
    let inputs = DirectIn { points: points.clone(), normal: normal.clone(), shape: shape.clone() };
    let direct =
        Direct { samples: 64, ..Direct::default() }.run(inputs, &Context::default()).expect("it is sound").direct;
    let inputs = ShadowIn { points, normal, mesh: mesh_of_room(), shape: shape.clone(), mask: None };
    let visibility = Shadow::default().run(inputs, &Context::default()).expect("it is sound").visibility;
    let cover = cover(&shape, None);
    let (direct, lit) = (&direct.lobes[0], &visibility.lit[0]);
    check(
        "mesh_lamp",
        Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            Vec3::new(cover.0.get(x, y), direct.get(x, y), direct.get(x, y) * lit.get(x, y)) * Vec3::new(1.0, 2.0, 2.0)
        }),
    );
}

/// The lamp doubled, the window dimmed, a ball of light that lights nothing put in.
#[test]
fn compose() {
    check("compose", composed(Arc::default(), None));
}

/// The same with a blue back wall.
#[test]
fn edit_materials() {
    let room = room();
    let photo = Arc::new(room.photo());
    let wall = MaterialEdit::Paint {
        region: Region::Grow(32.0, 20.0),
        albedo: Some(Color::Srgb("#3c6ec8".into())),
        roughness: None,
        specular: None,
        keep_texture: true,
    };
    let inputs = EditMaterialsIn {
        photo: photo.clone(),
        full_depth: room.depth.clone(),
        small: photo,
        depth: room.depth.clone(),
        points: room.points.clone(),
        normal: room.normal.clone(),
        paint: room.albedo.clone(),
        known: room.albedo.clone(),
        albedo: room.albedo.clone(),
        fitted: room.albedo.clone(),
        roughness: Arc::new(Roughness(Plane::filled(SIZE.0, SIZE.1, 0.8))),
    };
    let out = EditMaterials { materials: vec![wall] }.run(inputs, &Context::default()).expect("everything is sound");
    check("edit_materials", composed(out.coats, None));
}

/// The same with a polished floor.
#[test]
fn polish() {
    let room = room();
    let is_floor = |x, y| room.true_normal.get(x, y).y > 0.9 && room.points.0.get(x, y).y < -0.9;
    let floor = Plane::from_fn(SIZE.0, SIZE.1, |x, y| f32::from(u8::from(is_floor(x, y))));
    let mut finish = SpecularEdit::default();
    finish.lay(&floor, [Some(0.15), Some(1.0)], &Roughness(Plane::filled(SIZE.0, SIZE.1, 0.8)));
    let shapes: Vec<_> = room.lights.iter().map(|light| (light.id.to_string(), light.shape.clone())).collect();
    let inputs = ShadeSpecularEditIn {
        finish: Arc::new(finish),
        objects: Arc::new(Objects::unseen(&[])),
        mesh: mesh_of_room(),
        room: mesh_of_room(),
        camera: room.camera.clone(),
        full_depth: room.depth.clone(),
        points: room.points.clone(),
        normal: room.normal.clone(),
        mask: Gather(vec![]),
        estimated: Gather(shapes.clone()),
        shape: Gather(shapes.into_iter().chain([("ball".to_string(), ball())]).collect()),
        lighting: None,
    };
    let out = ShadeSpecularEdit::default().run(inputs, &Context::default()).expect("everything is sound");
    check("polish", composed(Arc::default(), Some(out.polish)));
}

fn composed(coats: Arc<PaintLayers>, polish: Option<Arc<SpecularChange>>) -> Plane<Vec3> {
    let room = room();
    let (photo, dark) = (Arc::new(room.photo()), Arc::new(Shading(Plane::filled(SIZE.0, SIZE.1, Vec3::ZERO))));
    let ball = ball();
    let one = |v: Vec3| Arc::new(Radiance(vec![v]));
    let of = |value: &dyn Fn(&Light) -> Arc<Radiance>| -> Vec<(String, Arc<Radiance>)> {
        room.lights.iter().map(|light| (light.id.to_string(), value(light))).collect()
    };
    let shapes = || room.lights.iter().map(|light| (light.id.to_string(), light.shape.clone())).collect::<Vec<_>>();
    let mut covers: Vec<_> = shapes().iter().map(|(id, shape)| (id.clone(), cover(shape, Some(shape)))).collect();
    covers.push(("ball".into(), cover(&ball, None)));
    // The lamp is seen in the photo: its own pixels are a mask.
    let mask = cover(&room.lights[0].shape, None);
    let (mut after, mut shape, mut radiance, mut gain) =
        (room.shading([2.0, 0.3]), shapes(), of(&|light| light.radiance.clone()), of(&|light| light.radiance.clone()));
    for ((_, gain), factor) in gain.iter_mut().zip([2.0, 0.3]) {
        *gain = Arc::new(Radiance(vec![Vec3::splat(factor); gain.0.len()]));
    }
    after.push(("ball".into(), dark.clone()));
    shape.push(("ball".into(), ball));
    radiance.push(("ball".into(), one(Vec3::new(0.2, 0.6, 1.0))));
    gain.push(("ball".into(), one(Vec3::ZERO)));
    let clear = Arc::new(Mask(Plane::filled(SIZE.0, SIZE.1, 0.0)));
    let kinds = || Gather(vec![("lamp".to_string(), Arc::new(LightKind::Lamp))]);
    let paint = PaintIn {
        photo: photo.clone(),
        clipped: clear.clone(),
        small: photo.clone(),
        points: room.points.clone(),
        normal: room.normal.clone(),
        light: Gather(room.shading([1.0, 1.0])),
        rest: dark.clone(),
        mask: Gather(vec![("lamp".into(), mask)]),
        kind: kinds(),
    };
    let paint = Paint::default().run(paint, &Context::default()).expect("everything is sound");
    let inputs = ComposeIn {
        photo: photo.clone(),
        clipped: clear,
        camera: room.camera.clone(),
        full_depth: room.depth.clone(),
        small: photo,
        depth: room.depth.clone(),
        albedo: room.albedo.clone(),
        paint: paint.paint,
        coats,
        before: Gather(room.shading([1.0, 1.0])),
        after: Gather(after),
        rest: dark.clone(),
        edited_rest: dark,
        zone: Gather(paint.zone.0),
        kind: kinds(),
        estimated: Gather(shapes()),
        estimated_radiance: Gather(of(&|light| light.radiance.clone())),
        shape: Gather(shape),
        radiance: Gather(radiance),
        gain: Gather(gain),
        cover: Gather(covers),
        objects: Arc::new(Objects::unseen(&[])),
        object: Gather(vec![]),
        object_rest: Arc::new(Picture(Plane::new(0, 0, vec![]))),
        reflected: None,
        polish,
    };
    let out = Compose::default().run(inputs, &Context::default()).expect("everything is sound");
    out.picture.0.clone()
}

/// A ball before the box, under the lamp: what it shows of direct light, and the shadow that it casts.
#[test]
fn objects() {
    let room = room();
    let ball = r#"[Sphere(radius: 0.25, at: Point(-0.35, -0.7, -2.6), material: (albedo: Linear(0.2, 0.6, 0.9)))]"#;
    let mut edit = EditObjects::default();
    edit.set("objects", ball).expect("there is such a parameter").expect("it is sound");
    let (camera, depth, normal) = (room.camera.clone(), room.depth.clone(), room.normal.clone());
    let inputs = EditObjectsIn { camera, depth, normal, mesh: mesh_of_room() };
    let ctx = Context::default();
    let edited = edit.run(inputs, &ctx).expect("the edit is sound");
    let (objects, lamp) = (edited.objects.clone(), &room.lights[0]);
    let inputs = LightObjectsIn { objects, mesh: edited.mesh.clone(), shape: lamp.shape.clone() };
    let lit = LightObjects::default().run(inputs, &ctx).expect("the light is sound").light;
    let samples: Vec<Vec3> = lit.lobes[0].pixels().iter().map(|&e| lamp.radiance.0[0] * e).collect();
    let shown = edited.objects.diffuse(&samples);
    let (points, normal) = (room.points.clone(), room.normal.clone());
    let inputs = ShadowIn { points, normal, mesh: edited.mesh, shape: lamp.shape.clone(), mask: None };
    let shadow = Shadow::default().run(inputs, &ctx).expect("the light is sound").visibility;
    let pixel = |x: usize, y: usize| {
        let arrives = lamp.direct.lobes[0].get(x, y) * shadow.lit[0].get(x, y);
        let behind = room.albedo.0.get(x, y) * lamp.radiance.0[0] * arrives;
        let within = |at: usize, start: usize, size: usize| at.checked_sub(start).filter(|&at| at < size);
        let (w, h) = shown.size();
        match (within(x, edited.objects.left, w), within(y, edited.objects.top, h)) {
            (Some(x), Some(y)) => behind.lerp(shown.get(x, y), edited.objects.cover.get(x, y)),
            _ => behind,
        }
    };
    check("objects", Plane::from_fn(SIZE.0, SIZE.1, |x, y| 3.0 * pixel(x, y)));
}
