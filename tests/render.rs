//! From depth and lights to unit layers: the stages `Mesh`, `Direct`, `Shadow`, `Transport` and
//! `TraceIndirect` together.

mod common;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DVec3, Vec3};
use needs::needs;
use relight::geometry::{Camera, SceneMesh};
use relight::graph::{Context, Node};
use relight::image::{Albedo, Depth, Mask, Normal, Plane};
use relight::nodes::artifacts::{Sunlight, UnitDirect, UnitIndirect, Visibility};
use relight::nodes::render::direct::{Direct, DirectIn};
use relight::nodes::render::shadow::{Shadow, ShadowIn};
use relight::nodes::render::trace_indirect::TraceIndirect;
use relight::nodes::render::transport::Transport;
use relight::optics::{
    self, Lamp, LightKind, Lobe, RectLamp, Shape, SphereLamp, Window, polygon_irradiance,
};

use common::room::Room;

fn direct(room: &Room, shape: &Shape) -> Arc<UnitDirect> {
    Direct::default().run(room.direct_in(shape), &Context::default()).unwrap().direct
}

fn shadow(room: &Room, stage: &Shadow, shape: &Shape, mask: Option<Mask>) -> Arc<Visibility> {
    stage.run(room.shadow_in(shape, mask.map(Arc::new)), &Context::default()).unwrap().visibility
}

fn indirect(
    room: &Room,
    stage: &TraceIndirect,
    albedo: &Albedo,
    direct: Arc<UnitDirect>,
    lit: Arc<Visibility>,
) -> Arc<UnitIndirect> {
    let inputs = room.indirect_in(&Arc::new(albedo.clone()), &direct, &lit);
    stage.run(inputs, &Context::default()).unwrap().indirect
}

/// Shading of the whole room by a light whose unshadowed direct shading is `e`, with no shadows.
fn bounced(room: &Room, stage: &TraceIndirect, albedo: &Albedo, e: Plane<f32>) -> Plane<Vec3> {
    let one = e.map(|_| 1.0);
    let direct = UnitDirect { stderr: vec![e.map(|_| 0.0)], lobes: vec![e] };
    let zero = vec![one.map(|_| 0.0)];
    let lit = Visibility { unknown: zero.clone(), stderr: zero, lit: vec![one] };
    indirect(room, stage, albedo, Arc::new(direct), Arc::new(lit)).lobes[0].0.clone()
}

fn floor_and_wall() -> Room {
    Room::floor_and_wall(Camera::from_fov_x(120, 90, 70.0))
}

/// A square of half width 0.5 at 2 m before a wall at 4 m.
fn square_before_wall() -> Room {
    Room::square_before_wall(Camera {
        width: 200,
        height: 150,
        fx: 200.0,
        fy: 200.0,
        cx: 100.0,
        cy: 75.0,
    })
}

fn constant(room: &Room, albedo: Vec3) -> Albedo {
    Albedo(Plane::filled(room.camera.width, room.camera.height, albedo))
}

#[test]
fn a_small_lamp_casts_a_shadow_where_geometry_says() {
    let room = square_before_wall();
    let lamp =
        Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::new(0.3, 0.0, 0.0), radius: 1e-3 }));
    let visibility = shadow(&room, &Shadow { half: false, ..Shadow::default() }, &lamp, None);
    // The square's left edge at x = -0.5 throws its shadow to x = 0.3 + 2 (-0.5 - 0.3) = -1.3 on
    // the wall: column 35. What the camera sees of it reaches to the square, column 50.
    let row: Vec<f32> = (0..50).map(|x| visibility.lit[0].get(x, 75)).collect();
    assert!(
        row[..34].iter().all(|v| *v == 1.0) && row[36..49].iter().all(|v| *v == 0.0),
        "{row:?}"
    );
    assert!((151..200).all(|x| visibility.lit[0].get(x, 75) == 1.0), "the right side is lit");
    assert!(
        (52..148).all(|x| visibility.lit[0].get(x, 75) == 1.0),
        "no shadow of the square on itself"
    );
    assert!((0..200).all(|x| visibility.unknown[0].get(x, 75) == 0.0), "all of it is seen");
}

#[test]
fn a_lamp_behind_the_square_is_unknown_and_counts_as_assumed() {
    let room = square_before_wall();
    let lamp =
        Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::new(0.0, 0.0, -3.5), radius: 1e-3 }));
    for assume_lit in [0.0, 0.25, 1.0] {
        let visibility =
            shadow(&room, &Shadow { half: false, assume_lit, ..Shadow::default() }, &lamp, None);
        assert_eq!(
            (visibility.unknown[0].get(20, 75), visibility.lit[0].get(20, 75)),
            (1.0, assume_lit)
        );
    }
}

#[test]
fn each_lobe_of_a_window_has_its_own_shadow() {
    let room = square_before_wall();
    // A window behind the camera. The sun stands to the right and throws the square's left edge
    // from -0.5 to -1.3 as above (0.4 per meter); the sky comes from everywhere and casts only soft
    // shadows.
    let lobe = |direction: Vec3, bandwidth| Lobe { direction: direction.normalize(), bandwidth };
    let lobes = [lobe(Vec3::new(0.4, 0.0, 1.0), 1e5), lobe(Vec3::Y, 0.5), lobe(Vec3::NEG_Y, 0.0)];
    let window =
        Window { center: Vec3::new(0.5, 0.0, 1.0), x: Vec3::NEG_X * 6.0, y: Vec3::Y * 6.0, lobes };
    let visibility = shadow(
        &room,
        &Shadow { half: false, samples: 64, ..Shadow::default() },
        &Shape::Window(window),
        None,
    );
    let at = |k: usize, x: usize| visibility.lit[k].get(x, 75);
    assert!(at(0, 40) < 0.02 && at(0, 30) > 0.98, "sun: {} {}", at(0, 40), at(0, 30));
    assert!(
        (at(1, 40) - at(1, 30)).abs() < 0.15 && at(2, 40) > 0.5,
        "sky: {} {}",
        at(1, 40),
        at(1, 30)
    );
}

#[test]
fn no_light_has_no_lobes_and_a_light_does_not_light_itself() {
    let room = square_before_wall();
    assert!(direct(&room, &Shape::Absent).lobes.is_empty());
    assert!(shadow(&room, &Shadow::default(), &Shape::Absent, None).lit.is_empty());
    let lamp =
        Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::new(0.0, 0.0, -2.0), radius: 0.5 }));
    let own = Mask(Plane::from_fn(200, 150, |x, y| {
        f32::from((50..150).contains(&x) && (25..125).contains(&y))
    }));
    let visibility = shadow(&room, &Shadow::default(), &lamp, Some(own));
    assert_eq!(visibility.lit[0].get(100, 75), 0.0);
    assert_eq!(visibility.lit[0].get(20, 75), 1.0, "nor does it shade itself from others");
}

#[test]
fn a_furnace_comes_to_rest_at_its_closed_form() {
    // Every surface, seen or not, has albedo a and direct shading 1: I = a (1 + I) = a / (1 - a),
    // for any geometry.
    for room in [floor_and_wall(), square_before_wall()] {
        let a = Vec3::new(0.2, 0.5, 0.8);
        let one = Plane::filled(room.camera.width, room.camera.height, 1.0);
        for bounces in [1, 4] {
            let got = bounced(
                &room,
                &TraceIndirect { bounces, unseen: 1.0 },
                &constant(&room, a),
                one.clone(),
            );
            let wanted = a / (Vec3::ONE - a);
            assert!(
                got.pixels().iter().all(|i| ((i - wanted) / wanted).abs().max_element() < 1e-4)
            );
        }
        let none =
            bounced(&room, &TraceIndirect { bounces: 0, unseen: 1.0 }, &constant(&room, a), one);
        assert!(none.pixels().iter().all(|i| *i == Vec3::ZERO), "no bounce, no indirect light");
    }
}

#[test]
fn fewer_rays_of_a_transport_tell_the_same_within_their_noise() {
    let room = floor_and_wall();
    let (all, few) = (&*room.transport, room.transport.thinned(32));
    assert_eq!(
        (all.rays() / few.rays(), few.thinned(32) == few, all.thinned(128) == *all),
        (4, true, true)
    );
    let albedo = constant(&room, Vec3::splat(0.5));
    let at = |pixel: usize| if room.points.0.pixels()[pixel].z < -2.99 { 1.0 } else { 0.0 };
    let bounces = optics::Bounces { count: 1, unseen: 0.0 };
    let [all, few] =
        [all, &few].map(|t| optics::indirect_at_receivers(t, &albedo, &[], at, bounces));
    // A share p of the rays meets the wall: the difference of 128 and 32 of them has a variance of
    // at most p (1 - p) (1/32 - 1/128), p <= 1/2, times the square of albedo and of further bounces
    // (2).
    let off: Vec<f64> = all.iter().zip(&few).map(|(a, b)| f64::from(a.x - b.x)).collect();
    let rms = (off.iter().map(|d| d * d).sum::<f64>() / off.len() as f64).sqrt();
    assert!((1e-4..0.08).contains(&rms), "{rms}");
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    assert!(mean.abs() < 0.01, "{mean}");
}

#[test]
fn one_bounce_from_wall_to_floor_is_the_form_factor() {
    let room = floor_and_wall();
    let (width, height) = room.points.0.size();
    let on_wall = |p: Vec3| p.z < -2.99 && p.y > -0.999;
    let albedo =
        Albedo(room.points.0.map(|p| if on_wall(p) { Vec3::splat(0.5) } else { Vec3::ZERO }));
    let lit = room.points.0.map(|p| f32::from(on_wall(p)));
    // The dark floor returns nothing, so that there is exactly one bounce.
    let got = bounced(&room, &TraceIndirect { bounces: 3, unseen: 0.0 }, &albedo, lit);
    let (left, right) = (
        room.camera.unproject(0.5, 0.0, 3.0).x,
        room.camera.unproject(width as f32 - 0.5, 0.0, 3.0).x,
    );
    let top = room.camera.unproject(0.0, 0.5, 3.0).y;
    let mut worst = 0.0f32;
    for y in 78..height {
        for x in 10..width - 10 {
            let p = room.points.0.get(x, y);
            let corner = |x: f32, y: f32| (Vec3::new(x, y, -3.0) - p).as_dvec3();
            let wall =
                [corner(left, -1.0), corner(right, -1.0), corner(right, top), corner(left, top)];
            let wanted = 0.5 * polygon_irradiance(&wall, DVec3::Y) as f32;
            worst = worst.max((got.get(x, y).x / wanted - 1.0).abs());
        }
    }
    // 64 evenly spread rays, about a third of which hit the wall: one ray is 5 %, and neighboring
    // receivers are averaged.
    assert!(worst < 0.12, "{worst}");
}

#[test]
fn indirect_light_is_linear_and_never_negative() {
    let room = floor_and_wall();
    let (width, height) = room.points.0.size();
    let albedo = Albedo(Plane::from_fn(width, height, |x, y| {
        Vec3::new(0.9, (x % 7) as f32 / 7.0, (y % 5) as f32 / 5.0)
    }));
    let a = Plane::from_fn(width, height, |x, y| ((x * 31 + y * 17) % 13) as f32);
    let b = Plane::from_fn(width, height, |x, y| if x == y { 100.0 } else { 0.0 });
    let both = Plane::from_fn(width, height, |x, y| 2.0 * a.get(x, y) + 0.5 * b.get(x, y));
    let stage = TraceIndirect::default();
    let [a, b, both] = [a, b, both].map(|e| bounced(&room, &stage, &albedo, e));
    for ((a, b), both) in a.pixels().iter().zip(b.pixels()).zip(both.pixels()) {
        assert!(a.min_element() >= 0.0 && b.min_element() >= 0.0);
        // Each of five bounces adds up to 37 terms one by one, and each sum rounds by 6e-8.
        assert!((2.0 * a + 0.5 * b - both).abs().max_element() <= 1e-5 * both.max_element());
    }
}

#[test]
fn thread_counts_change_no_bit() {
    let window = Window {
        center: Vec3::new(0.5, 0.0, 1.0),
        x: Vec3::NEG_X,
        y: Vec3::Y,
        lobes: [1e4, 3.0, 0.0].map(|bandwidth| Lobe { direction: Vec3::Z, bandwidth }),
    };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let room = square_before_wall();
            let shape = Shape::Window(window.clone());
            let (direct, lit) =
                (direct(&room, &shape), shadow(&room, &Shadow::default(), &shape, None));
            let indirect = indirect(
                &room,
                &TraceIndirect::default(),
                &constant(&room, Vec3::splat(0.4)),
                direct.clone(),
                lit.clone(),
            );
            (room.points, room.normal, room.transport, direct, lit, indirect)
        })
    };
    let (one, four) = (run(1), run(4));
    assert!(one.0 == four.0 && one.1 == four.1, "surface");
    assert!(one.2 == four.2, "bounces");
    assert!(one.3 == four.3, "direct");
    assert!(one.4 == four.4, "shadow");
    assert!(one.5 == four.5, "indirect");
}

#[test]
fn many_stages_may_want_the_rays_at_once() {
    // Two threads, four stages, one mesh that has no hierarchy yet: no thread may wait for itself.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let room = square_before_wall();
    let fresh: SceneMesh =
        postcard::from_bytes(&postcard::to_stdvec(&*room.mesh).unwrap()).unwrap();
    let room = Room { mesh: Arc::new(fresh), ..room };
    let lamp = Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::ZERO, radius: 0.1 }));
    pool.scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|_| {
                shadow(&room, &Shadow::default(), &lamp, None);
            });
        }
    });
}

/// The sun lights the pixels that the photo shows lit, until an edit changes its window.
#[test]
fn sunlight_of_the_photo_is_kept_while_its_window_is_as_estimated() {
    let room = square_before_wall();
    let mut lobes = Window::daylight(Vec3::NEG_Z, Vec3::Y);
    lobes[0].direction = Vec3::new(0.3, 0.5, 0.8).normalize();
    let window = Window { center: Vec3::Z, x: Vec3::NEG_X, y: Vec3::Y, lobes };
    let moved = Shape::Window(Window { center: Vec3::Z * 1.5, ..window.clone() });
    let shape = Shape::Window(window);
    let (w, h) = room.size();
    let lit = Plane::from_fn(w, h, |x, _| if x < w / 2 { 0.75 } else { 0.0 });
    let sunlight = Arc::new(Sunlight { direction: lobes[0].direction, lit: lit.clone() });
    let run = |shape: &Shape, estimated: &Shape| {
        let estimated = Some(Arc::new(estimated.clone()));
        let sunlight = Some(sunlight.clone());
        let inputs = DirectIn {
            estimated: estimated.clone(),
            sunlight: sunlight.clone(),
            ..room.direct_in(shape)
        };
        let direct = Direct::default().run(inputs, &Context::default()).unwrap().direct;
        let inputs = ShadowIn { estimated, sunlight, ..room.shadow_in(shape, None) };
        (direct, Shadow::default().run(inputs, &Context::default()).unwrap().visibility)
    };
    let (kept, shown) = run(&shape, &shape);
    assert_eq!(shown.lit[0], lit);
    let facing = room.normal.0.map(|normal| lobes[0].distant_irradiance(normal));
    assert_eq!(kept.lobes[0], facing, "also where the rectangle would not let it in");
    // Sky and ground are traced as ever, and so is the sun of a window that has moved.
    let traced = (direct(&room, &shape), shadow(&room, &Shadow::default(), &shape, None));
    assert_eq!((&kept.lobes[1..], &shown.lit[1..]), (&traced.0.lobes[1..], &traced.1.lit[1..]));
    let (edited, visibility) = run(&moved, &shape);
    assert_eq!(edited, direct(&room, &moved));
    assert_eq!(visibility, shadow(&room, &Shadow::default(), &moved, None));
}

#[test]
fn planes_of_different_size_are_refused_by_name() {
    let room = square_before_wall();
    let inputs = DirectIn {
        points: room.points.clone(),
        normal: Arc::new(Normal(Plane::filled(3, 2, Vec3::Z))),
        shape: Arc::new(Shape::Absent),
        estimated: None,
        sunlight: None,
    };
    let error = Direct::default().run(inputs, &Context::default()).err().unwrap().to_string();
    assert_eq!(error, "normal: wanted 200 x 150 pixels as points, got 3 x 2");
    assert!(Shadow { assume_lit: f32::NAN, ..Shadow::default() }.check().is_err());
    assert!(Transport { stride: 0, ..Transport::default() }.check().is_err());
}

// Path-traced rooms, where they are at hand.

fn read_exr(path: PathBuf) -> Plane<Vec3> {
    let image = exr::prelude::read_first_flat_layer_from_file(&path)
        .unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let channels = &image.layer_data.channel_data.list;
    let channel =
        |name: &str| channels.iter().find(|c| c.name.to_string() == name).expect("R, G and B");
    let rgb = ["R", "G", "B"].map(channel);
    let (width, height) = (image.layer_data.size.0, image.layer_data.size.1);
    let value = |i: usize| Vec3::from(rgb.map(|c| c.sample_data.value_by_flat_index(i).to_f32()));
    Plane::new(width, height, (0..width * height).map(value).collect())
}

fn read_mask(path: PathBuf) -> Option<Mask> {
    let picture = image::open(path).ok()?.to_luma8();
    let pixels = picture.pixels().map(|p| f32::from(p.0[0]) / 255.0).collect();
    Some(Mask(Plane::new(picture.width() as usize, picture.height() as usize, pixels)))
}

fn vector(json: &serde_json::Value) -> Vec3 {
    Vec3::from_array(std::array::from_fn(|i| json[i].as_f64().expect("three numbers") as f32))
}

fn lamp_of(json: &serde_json::Value) -> Option<Shape> {
    let center = vector(&json["center"]);
    match json["kind"].as_str()? {
        "sphere" => Some(Shape::Lamp(Lamp::Sphere(SphereLamp {
            center,
            radius: json["radius"].as_f64()? as f32,
        }))),
        "rect" => {
            let normal = vector(&json["normal"]);
            let x = Vec3::Y.cross(normal).try_normalize()?;
            let half = |i: usize| Some(json["half"][i].as_f64()? as f32);
            Some(Shape::Lamp(Lamp::Rect(RectLamp {
                center,
                x: x * half(0)?,
                y: normal.cross(x) * half(1)?,
            })))
        }
        _ => None,
    }
}

#[needs("../shared/truth")]
#[test]
fn path_traced_rooms_are_met_within_their_unseen_part() {
    let truth = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/truth");
    let mut errors = Vec::new();
    for name in ["dev-classroom", "dev-dining", "dev-parlour", "dev-sunlit"] {
        let folder = truth.join(name);
        let meta: serde_json::Value =
            serde_json::from_slice(&std::fs::read(folder.join("meta.json")).unwrap()).unwrap();
        let camera = Camera::from_fov_x(320, 240, meta["fov_x"].as_f64().unwrap() as f32);
        let visible =
            meta["visible"].as_array().unwrap().iter().map(|id| id.as_str().unwrap().to_owned());
        let masks: Vec<(String, LightKind, Mask)> = visible
            .map(|id| {
                let kind =
                    if id.starts_with("window") { LightKind::Window } else { LightKind::Lamp };
                let mask = read_mask(folder.join(format!("mask_{id}.png"))).unwrap();
                (id, kind, mask)
            })
            .collect();
        let glowing = Plane::from_fn(320, 240, |x, y| {
            masks.iter().any(|(_, _, mask)| mask.0.get(x, y) > 0.0)
        });
        let depth = Depth(read_exr(folder.join("depth.exr")).map(|c| c.x));
        let room = Room::with_lights(camera, depth, masks);
        let albedo = Albedo(read_exr(folder.join("albedo.exr")));
        for id in ["inv_lamp", "lamp_0"] {
            let json = &meta["lamps"][id];
            let (shape, radiance) = (lamp_of(json).unwrap(), vector(&json["radiance"]));
            let direct = direct(&room, &shape);
            let lit = shadow(
                &room,
                &Shadow::default(),
                &shape,
                read_mask(folder.join(format!("mask_{id}.png"))),
            );
            let indirect =
                indirect(&room, &TraceIndirect::default(), &albedo, direct.clone(), lit.clone());
            let wanted = read_exr(folder.join(format!("olat_{id}.exr")));
            let (mut sum, mut off, mut off_direct) = (0.0, 0.0, 0.0);
            for i in (0..320 * 240).filter(|&i| !glowing.pixels()[i]) {
                let arrives = Vec3::splat(direct.lobes[0].pixels()[i] * lit.lit[0].pixels()[i]);
                let shown = radiance * albedo.0.pixels()[i];
                let wanted = wanted.pixels()[i];
                sum += wanted.element_sum();
                off += (shown * (arrives + indirect.lobes[0].0.pixels()[i]) - wanted)
                    .abs()
                    .element_sum();
                off_direct += (shown * arrives - wanted).abs().element_sum();
            }
            println!(
                "{name} {id}: relative L1 {:.3}, direct light alone {:.3}",
                off / sum,
                off_direct / sum
            );
            assert!(off < off_direct, "{name} {id}: indirect light must help");
            errors.push(off / sum);
        }
    }
    // Two thirds of the rays of a receiver leave the seen part of these rooms, and the lamps light
    // that part more or less than the seen one; direct light alone is off by 0.5 on average, and
    // nothing that is blind there can be much below a third.
    let mean = errors.iter().sum::<f32>() / errors.len() as f32;
    assert!(mean < 0.42, "{mean}: {errors:?}");
}
