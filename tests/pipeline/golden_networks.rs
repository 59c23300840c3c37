//! One small picture per stage with a network, in both backends against the same picture: they
//! differ by rounding, far less than a step of
//! 255. The room is that of `goldens`; ONNX Runtime takes part where ORT_DYLIB_PATH names its
//!      library.

use std::path::Path;
use std::sync::Arc;

use glam::Vec3;
use relight::graph::{Context, File, Gather, Node, NodeError};
use relight::image::{Mask, Picture, Plane, Roughness, Shading};
use relight::net::{Backend, find_onnxruntime};
use relight::nodes::artifacts::{Guess, UnitIndirect};
use relight::nodes::estimate::inv_lamp_net::{InvLampNet, InvLampNetIn};
use relight::nodes::estimate::inv_win_net::{InvWinNet, InvWinNetIn};
use relight::nodes::estimate::mnet::{MNet, MNetIn};
use relight::nodes::estimate::vis_lamp_net::{VisLampNet, VisLampNetIn};
use relight::nodes::estimate::vis_win_net::{VisWinNet, VisWinNetIn};
use relight::nodes::render::direct::{Direct, DirectIn};
use relight::nodes::render::indirect::{Indirect, IndirectIn};
use relight::nodes::render::light_net::{LightNet, LightNetIn};
use relight::nodes::render::shadow::{Shadow, ShadowIn};
use relight::nodes::render::shadow_net::{ShadowNet, ShadowNetIn};

use crate::goldens::{self, SIZE, check, cover, room, zip3};
use crate::project::root;

/// A network that ships.
fn model(name: &str) -> File {
    File::new(root().join("models").join(name).display().to_string())
}

/// In each backend that there is, the picture that a stage gives against the golden of this name.
fn check_each(name: &str, picture: impl Fn(Backend) -> Plane<Vec3>) {
    check(name, picture(Backend::Rten));
    match std::env::var_os("ORT_DYLIB_PATH") {
        Some(path) => check(
            name,
            picture(find_onnxruntime(Path::new(&path)).expect("it is a library of ONNX Runtime")),
        ),
        None => eprintln!("skipped: ORT_DYLIB_PATH names no library of ONNX Runtime"),
    }
}

fn masks() -> Gather<Mask> {
    let seen = |i: usize| (room().lights[i].id.to_string(), cover(&room().lights[i].shape, None));
    Gather(vec![seen(0), seen(1)])
}

fn photo() -> Arc<Picture> {
    Arc::new(goldens::photo())
}

/// Shading of the room by a guessed light at its guessed strength.
fn lit_by(guess: &Guess) -> Plane<Vec3> {
    let (points, normal) = (room().points.clone(), room().normal.clone());
    let shape = Arc::new(guess.shape.clone());
    let inputs = DirectIn { points, normal, shape, estimated: None, sunlight: None };
    let direct =
        Direct::default().run(inputs, &Context::default()).expect("the guess is sound").direct;
    let at = |x, y| {
        direct
            .lobes
            .iter()
            .zip(&guess.radiance.0)
            .map(|(lobe, w)| *w * lobe.get(x, y))
            .sum::<Vec3>()
    };
    Plane::from_fn(SIZE.0, SIZE.1, at)
}

#[test]
fn mnet() {
    check_each("mnet", |backend| {
        let inputs = MNetIn {
            photo: photo(),
            depth: room().depth.clone(),
            camera: room().camera.clone(),
            masks: masks(),
        };
        let out = MNet { model: model("mnet.onnx"), backend }
            .run(inputs, &Context::default())
            .expect("it runs");
        for (x, y) in (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y))) {
            let n = out.normal.0.get(x, y);
            assert!(
                (n.length() - 1.0).abs() < 1e-5,
                "({x}, {y}): a normal has unit length, got {n}"
            );
            let away = n.dot(room().camera.pixel_point(x, y, 1.0));
            assert!(away <= 0.0, "({x}, {y}): a normal faces the camera, got {n}");
        }
        Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            let (a, r) = (out.albedo.0.get(x, y), out.roughness.0.get(x, y));
            Vec3::new(a.x, a.y, r)
        })
    });
}

macro_rules! light_network {
    ($test:ident, $stage:ident, $inputs:ident, $file:literal, $gain:literal $(, $mask:literal)?) => {
        #[test]
        fn $test() {
            check_each(stringify!($test), |backend| {
                let inputs = $inputs {
                    photo: photo(),
                    depth: room().depth.clone(),
                    camera: room().camera.clone(),
                    normal: room().normal.clone(),
                    albedo: room().albedo.clone(),
                    masks: masks(),
                    $( mask: masks().0[$mask].1.clone(), )?
                };
                let stage = $stage { model: model($file), backend };
                let guess = stage.run(inputs, &Context::default()).expect("it runs").guess;
                assert!((0.0..=1.0).contains(&guess.burns) && guess.error > 0.0, "{guess:?}");
                lit_by(&guess).map(|e| e * $gain)
            });
        }
    };
}

light_network!(vis_lamp_net, VisLampNet, VisLampNetIn, "vislampnet.onnx", 1.0, 0);
light_network!(vis_win_net, VisWinNet, VisWinNetIn, "viswinnet.onnx", 1.0, 1);
light_network!(inv_lamp_net, InvLampNet, InvLampNetIn, "invlampnet.onnx", 20.0);
light_network!(inv_win_net, InvWinNet, InvWinNetIn, "invwinnet.onnx", 20.0);

/// Visibility of the lamp and of the sky, by the network where rays are unknown.
#[test]
fn shadow_net() {
    check_each("shadow_net", |backend| {
        let filled = [0, 1].map(|i| {
            let light = &room().lights[i];
            let mesh = room().mesh.clone();
            let (points, normal) = (room().points.clone(), room().normal.clone());
            let (shape, mask) = (light.shape.clone(), None);
            let inputs =
                ShadowIn { points, normal, mesh, shape, mask, estimated: None, sunlight: None };
            let traced = Shadow { outside_unknown: true, ..Shadow::default() };
            let visibility = traced.run(inputs, &Context::default()).expect("it runs").visibility;
            let inputs = ShadowNetIn {
                depth: room().depth.clone(),
                camera: room().camera.clone(),
                normal: room().normal.clone(),
                shape: light.shape.clone(),
                direct: light.direct.clone(),
                visibility: visibility.clone(),
            };
            let stage = ShadowNet {
                model: model("shadownet.onnx"),
                backend: backend.clone(),
                everywhere: false,
            };
            let filled = stage.run(inputs, &Context::default()).expect("it runs").visibility;
            for lobe in 0..filled.lit.len() {
                let known = |p: usize| visibility.unknown[lobe].pixels()[p] == 0.0;
                let same =
                    |p: usize| filled.lit[lobe].pixels()[p] == visibility.lit[lobe].pixels()[p];
                assert!((0..SIZE.0 * SIZE.1).all(|p| !known(p) || same(p)), "what is known stays");
            }
            filled
        });
        zip3(&filled[0].lit[0], &filled[1].lit[1], &filled[1].lit[2], [1.0; 3])
    });
}

fn indirect_of(backend: Backend, light: usize, factor: f32) -> Plane<Vec3> {
    let indirect = shared_indirect(backend, light, factor, (1.0, None)).expect("it runs");
    indirect.lobes[0].0.clone()
}

/// The network's share of the result, and traced light.
fn shared_indirect(
    backend: Backend,
    light: usize,
    factor: f32,
    (share, traced): (f32, Option<Arc<UnitIndirect>>),
) -> Result<Arc<UnitIndirect>, NodeError> {
    let light = &room().lights[light];
    let mut direct = (*light.direct).clone();
    direct.lobes.iter_mut().flat_map(|lobe| lobe.pixels_mut()).for_each(|e| *e *= factor);
    let inputs = IndirectIn {
        depth: room().depth.clone(),
        camera: room().camera.clone(),
        points: room().points.clone(),
        normal: room().normal.clone(),
        albedo: room().albedo.clone(),
        masks: Gather(vec![]),
        // Light beside the view is outside this test.
        shape: Arc::new(relight::optics::Shape::Absent),
        direct: Arc::new(direct),
        visibility: light.visibility.clone(),
        residual: None,
        traced,
    };
    let stage = Indirect { model: model("indirectnet.onnx"), backend, share };
    Ok(stage.run(inputs, &Context::default())?.indirect)
}

/// A quarter of the network's estimate and three quarters of what is traced.
#[test]
fn indirect_light_is_shared_between_network_and_rays() {
    let alone = indirect_of(Backend::Rten, 0, 1.0);
    let traced = Arc::new(UnitIndirect {
        lobes: vec![Shading(Plane::filled(SIZE.0, SIZE.1, Vec3::new(0.1, 0.2, 0.4)))],
        stderr: vec![Plane::filled(SIZE.0, SIZE.1, 0.01)],
        probes: vec![],
        cells: vec![],
    });
    let of = |share, traced| shared_indirect(Backend::Rten, 0, 1.0, (share, traced));
    let mixed = of(0.25, Some(traced.clone())).expect("it runs");
    for (mixed, alone) in mixed.lobes[0].0.pixels().iter().zip(alone.pixels()) {
        let wanted = 0.25 * *alone + 0.75 * Vec3::new(0.1, 0.2, 0.4);
        assert!((*mixed - wanted).abs().max_element() < 1e-6, "{mixed} {wanted}");
    }
    assert!(mixed.stderr[0].pixels().iter().all(|error| (error - 0.0075).abs() < 1e-7));
    let error = of(0.25, None).expect_err("nothing is traced");
    assert!(error.to_string().contains("wanted a wire to `traced`"), "{error}");
}

#[test]
fn indirect_net() {
    check_each("indirect_net", |backend| indirect_of(backend, 0, 1.0).map(|e| e * 30.0));
}

/// Twice the light is twice the indirect light, and none of it is negative.
#[test]
fn indirect_light_is_linear_in_the_light() {
    let (one, many) = (indirect_of(Backend::Rten, 0, 1.0), indirect_of(Backend::Rten, 0, 7.3));
    let largest = many.pixels().iter().fold(0.0f32, |top, e| top.max(e.max_element()));
    assert!(largest > 0.0);
    for (one, many) in one.pixels().iter().zip(many.pixels()) {
        assert!(one.min_element() >= 0.0);
        // Single precision through some tens of sums.
        assert!((*many - *one * 7.3).abs().max_element() < 1e-5 * largest, "{one} {many}");
    }
}

/// The mean radiance that arrives at each cell.
#[test]
fn light_net() {
    check_each("light_net", |backend| {
        let inputs = LightNetIn {
            depth: room().depth.clone(),
            camera: room().camera.clone(),
            normal: room().normal.clone(),
            albedo: room().albedo.clone(),
            roughness: Arc::new(Roughness(Plane::filled(SIZE.0, SIZE.1, 0.8))),
            masks: masks(),
            shape: room().each(|light| light.shape.clone()),
            radiance: room().each(|light| light.radiance.clone()),
            light: Gather::<Shading>(goldens::shading([1.0, 1.0])),
            residual: None,
        };
        let stage = LightNet { model: model("lightnet.onnx"), backend };
        let lighting = stage.run(inputs, &Context::default()).expect("it runs").lighting;
        let maps = lighting.maps();
        let texels = maps.radiance.len() / (maps.columns * maps.rows);
        Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            let cell = y * maps.rows / SIZE.1 * maps.columns + x * maps.columns / SIZE.0;
            maps.radiance[cell * texels..][..texels].iter().sum::<Vec3>() / texels as f32
        })
    });
}
