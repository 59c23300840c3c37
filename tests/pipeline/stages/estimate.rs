//! `InitLights`, `RefineLights`, `FitLights` and `FillReflectance`.

use std::sync::Arc;

use glam::Vec3;
use relight::graph::{Context, Gather, Node};
use relight::image::{Mask, Picture, Plane, Shading, distance, luminance};
use relight::nodes::estimate::fill_reflectance::{
    FillReflectance, FillReflectanceIn, FillReflectanceOut,
};
use relight::nodes::estimate::fit_lights::{FitLights, FitLightsIn, FitLightsOut};
use relight::nodes::estimate::init_lights::{InitLights, InitLightsIn};
use relight::nodes::estimate::refine_lights::{RefineLights, RefineLightsIn};
use relight::optics::{Lamp, RectLamp, Shape, Window};

use super::*;
use crate::common::scene::{Light, Scene, stored};

type Shapes = Vec<(String, Arc<Shape>)>;

fn shape<'a>(shapes: &'a Shapes, id: &str) -> &'a Shape {
    &shapes.iter().find(|(name, _)| name == id).expect("it is a member").1
}

/// The lights that `InitLights` places, with unseen lights left to its dictionary.
fn init(scene: &Scene) -> Shapes {
    let (photo, clipped) = stored(&scene.photo());
    let inputs = InitLightsIn {
        photo,
        clipped,
        camera: scene.camera.clone(),
        points: scene.points.clone(),
        normal: scene.normal.clone(),
        mesh: scene.mesh.clone(),
        transport: scene.transport.clone(),
        layout: None,
        albedo: scene.albedo.clone(),
        segments: scene.segments.clone(),
        ignore: scene.none(),
        mask: scene.masks(),
        kind: scene.kinds(),
        guess: Gather(vec![]),
        sun: None,
    };
    InitLights::default().run(inputs, &Context::default()).expect("the room is sound").shape.0
}

/// A pixel is 3.6 cm wide at the lamp: its outline is right to half of one, 1.8 cm, and so is its
/// middle along the ray.
#[test]
fn init_lights_puts_visible_lights_where_mask_and_depth_have_them() {
    let lights =
        vec![("lamp", sphere(LAMP), vec![WARM]), ("window", Shape::Window(window()), DAY.to_vec())];
    let found = init(&Scene::new(SIZE, lights));
    let lamp = shape(&found, "lamp");
    let (at, radius) = lamp.bounding_sphere().expect("a lamp");
    assert!(at.distance(LAMP.0) < 0.018 && (radius - LAMP.1).abs() < 0.018, "{lamp:?}");
    let Shape::Window(Window { center, x, y, .. }) = shape(&found, "window") else {
        panic!("a window: {found:?}")
    };
    let truth = window();
    assert!(center.distance(truth.center) < 0.018, "{center}");
    // Its wall is seen at 31 degrees, so that the width of a pixel is twice that along the wall.
    assert!((x.length() - 0.6).abs() < 0.036 && (y.length() - 0.6).abs() < 0.018, "{x} {y}");
    assert!(x.cross(*y).normalize().distance(Vec3::X) < 0.01, "it faces the room");
}

#[test]
fn init_lights_adds_no_light_to_a_photo_that_is_explained() {
    let found = init(&Scene::new(SIZE, vec![("lamp", sphere(LAMP), vec![WARM])]));
    assert_eq!(shape(&found, "inv_lamp"), &Shape::Absent);
    assert_eq!(shape(&found, "inv_window"), &Shape::Absent);
}

/// The dictionary has a lamp every 1.08 m across and every 0.6 m along the room, in two heights:
/// from no place between is it farther than 0.62 m to the nearest.
#[test]
fn init_lights_finds_the_lamp_that_is_out_of_view() {
    let lights = vec![
        ("lamp", sphere(LAMP), vec![0.5 * WARM]),
        ("hidden", sphere(UNSEEN), vec![2.0 * WHITE]),
    ];
    let found = init(&Scene::new(SIZE, lights));
    let distance = center(shape(&found, "inv_lamp")).distance(UNSEEN.0);
    assert!(distance < 0.62, "{distance} m: {found:?}");
    assert_eq!(shape(&found, "inv_window"), &Shape::Absent);
}

/// The lights after refinement from `start`, which takes the place of those that made the photo.
fn refine(scene: &Scene, start: impl Fn(&Light) -> Shape) -> Shapes {
    let (photo, clipped) = stored(&scene.photo());
    let inputs = RefineLightsIn {
        photo,
        clipped,
        camera: scene.camera.clone(),
        points: scene.points.clone(),
        normal: scene.normal.clone(),
        mesh: scene.mesh.clone(),
        transport: scene.transport.clone(),
        layout: None,
        albedo: scene.albedo.clone(),
        segments: scene.segments.clone(),
        ignore: scene.none(),
        mask: scene.masks(),
        shape: scene.each(|light| Arc::new(start(light))),
    };
    // A cost of lights out of view makes them dimmer than they are, and so moves them.
    let free = RefineLights { out_of_view_weight: 0.0, ..RefineLights::default() };
    let stage = RefineLights { samples: 16, rounds: 4, steps: 10, ..free };
    stage.run(inputs, &Context::default()).expect("the room is sound").shape.0
}

/// A prior of the size of these shifts pulls to the start, so that a third of the way may remain.
#[test]
fn refine_lights_moves_a_displaced_lamp_back_and_keeps_one_that_is_right() {
    let lights =
        vec![("lamp", sphere(LAMP), vec![WARM]), ("inv_lamp", sphere(UNSEEN), vec![4.0 * WHITE])];
    let scene = Scene::new(SIZE, lights);
    let moved = |id: &str, (center, radius): (Vec3, f32)| {
        let id = id.to_owned();
        move |light: &Light| {
            if light.id == id { sphere((center, radius)) } else { Shape::clone(&light.shape) }
        }
    };
    let shift = Vec3::new(-0.3, 0.1, 0.25);
    let found = refine(&scene, moved("inv_lamp", (UNSEEN.0 + shift, UNSEEN.1)));
    let distance = center(shape(&found, "inv_lamp")).distance(UNSEEN.0);
    assert!(distance < 0.4 * shift.length(), "{distance} m off, it began {} m off", shift.length());

    // A lamp in view slides along its ray alone; 6 % of 3 m are 18 cm.
    let found = refine(&scene, moved("lamp", (0.94 * LAMP.0, 0.94 * LAMP.1)));
    let at = center(shape(&found, "lamp"));
    assert!(at.distance(LAMP.0) < 0.4 * 0.06 * LAMP.0.length(), "{at}");
    assert!(at.normalize().distance(LAMP.0.normalize()) < 1e-5, "it stays on its ray: {at}");

    let right = refine(&scene, moved("none", LAMP));
    for light in &scene.lights {
        assert_eq!(
            shape(&right, light.id),
            &*light.shape,
            "{} is right and stays to the bit",
            light.id
        );
    }
}

/// The fit of `photo` by the layers of all lights, and its warnings.
fn fit(stage: &FitLights, scene: &Scene, photo: &Picture) -> (FitLightsOut, Vec<String>) {
    let (photo, clipped) = stored(photo);
    let inputs = FitLightsIn {
        photo,
        clipped,
        points: scene.points.clone(),
        normal: scene.normal.clone(),
        albedo: scene.albedo.clone(),
        segments: scene.segments.clone(),
        transport: scene.transport.clone(),
        ignore: scene.none(),
        mask: scene.masks(),
        shape: scene.each(|light| light.shape.clone()),
        direct: scene.each(|light| light.direct.clone()),
        visibility: scene.each(|light| light.visibility.clone()),
        indirect: scene.each(|light| light.indirect.clone()),
        sun: None,
    };
    let ctx = Context::default();
    (stage.run(inputs, &ctx).expect("the room is sound"), ctx.warnings())
}

/// The largest error of a lobe that is lit, as a share of its largest channel.
fn worst(scene: &Scene, out: &FitLightsOut) -> f32 {
    let pairs = scene.lights.iter().zip(&out.radiance.0);
    let lobes = pairs.flat_map(|(light, (_, got))| light.radiance.0.iter().zip(&got.0));
    lobes
        .filter(|(wanted, _)| **wanted != Vec3::ZERO)
        .map(|(wanted, got)| off(*got, *wanted))
        .fold(0.0, f32::max)
}

/// The photo is the model's own, so that the remaining error is by design. Evidence is the mean of
/// 5 x 5 pixels and layers are those of the middle one, and the prior favors usual colors: 8 %.
/// With the default parameters, the prior favors equal contributions, which moves light between
/// them, 15 % for the lamp in view, and not all of it together.
#[test]
fn fit_lights_recovers_the_radiances_of_the_photo() {
    let scene = scene();
    let photo = scene.photo();
    let free = FitLights {
        tikhonov_weight: 0.0,
        ambient_weight: 1.0,
        out_of_view_weight: 0.0,
        ..FitLights::default()
    };
    let known = FitLights { keep_albedo: true, ..free.clone() };
    for stage in [known, free] {
        let (out, _) = fit(&stage, scene, &photo);
        assert!(worst(scene, &out) < 0.08, "{stage:?}: {:?}", out.radiance.0);
    }
    let (out, _) = fit(&FitLights::default(), scene, &photo);
    let lamp = out.radiance.0[0].1.0[0];
    assert!(off(lamp, WARM) < 0.15, "{lamp} of {WARM}");
    let pixels = || 0..SIZE.0 * SIZE.1;
    let lit = |i: usize| scene.lights.iter().map(|light| light.shading(i)).sum::<Vec3>();
    let by_fit = |i: usize| {
        let lights = scene.lights.iter().zip(&out.radiance.0);
        lights.map(|(light, (_, radiance))| light.shading_by(&radiance.0, i)).sum::<Vec3>()
            + out.residual.0.pixels()[i]
    };
    let off = off(pixels().map(by_fit).sum(), pixels().map(lit).sum());
    assert!(off < 0.03, "all light together is {off} off");
}

/// Nothing is clipped here, so that every number of the fit is in units of the photo: a factor of
/// two is exact but for divisions.
#[test]
fn a_photo_twice_as_bright_has_lights_twice_as_bright() {
    let scene = scene();
    let dim = Picture(scene.photo().0.map(|shown| (0.25 * shown).min(Vec3::splat(0.4))));
    let bright = Picture(dim.0.map(|shown| 2.0 * shown));
    let [(dim, _), (bright, _)] =
        [dim, bright].map(|photo| fit(&FitLights::default(), scene, &photo));
    for ((id, dim), (_, bright)) in dim.radiance.0.iter().zip(&bright.radiance.0) {
        for (dim, bright) in dim.0.iter().zip(&bright.0) {
            assert!(
                (*bright - 2.0 * *dim).abs().max_element() <= 1e-5 * bright.max_element(),
                "{id}: {dim} {bright}"
            );
        }
    }
    assert!(luminance(bright.radiance.0[0].1.0[0]) > 0.0, "the lamp shines");
    assert_eq!(dim.albedo, bright.albedo);
}

/// Errors of the model are some percent of it, and a lamp that is off takes up to one of them.
#[test]
fn a_light_that_is_not_there_gets_nothing() {
    let none = || vec![Vec3::ZERO];
    let away =
        Shape::Lamp(Lamp::Rect(RectLamp { center: Vec3::Z, x: Vec3::X * 0.1, y: Vec3::Y * 0.1 }));
    let lights = vec![
        ("lamp", sphere(LAMP), vec![WARM]),
        ("dark", sphere(UNSEEN), none()),
        ("absent", Shape::Absent, vec![]),
        ("away", away, none()),
    ];
    let scene = Scene::new(SIZE, lights);
    let (out, warnings) =
        fit(&FitLights { tikhonov_weight: 0.0, ..FitLights::default() }, &scene, &scene.photo());
    let radiance =
        |id: &str| &out.radiance.0.iter().find(|(name, _)| name == id).expect("it is a member").1.0;
    assert_eq!(radiance("absent"), &vec![], "it has no lobe");
    assert_eq!(radiance("away"), &[Vec3::ZERO], "it lights nothing that is seen");
    assert!(warnings.iter().any(|warning| warning.contains("away: radiance 0")), "{warnings:?}");
    let light = |light: &Light| -> f32 {
        (0..SIZE.0 * SIZE.1).map(|i| luminance(light.shading_by(radiance(light.id), i))).sum()
    };
    let share = light(&scene.lights[1]) / light(&scene.lights[0]);
    assert!(share < 0.01, "a lamp that is off gives {share} of what the other gives");
}

fn paint(
    scene: &Scene,
    photo: &Arc<Picture>,
    clipped: &Arc<Mask>,
    residual: &Arc<Shading>,
) -> FillReflectanceOut {
    let inputs = FillReflectanceIn {
        glare: Gather(vec![]),
        shading_gain: Gather(vec![]),
        photo: photo.clone(),
        clipped: clipped.clone(),
        small: photo.clone(),
        points: scene.points.clone(),
        normal: scene.normal.clone(),
        light: scene.shading(),
        residual: residual.clone(),
        mask: scene.masks(),
        kind: scene.kinds(),
    };
    FillReflectance::default().run(inputs, &Context::default()).expect("the room is sound")
}

/// Reflectance is a quotient and a product of single precision: 1e-6. What a light or its saturated
/// glare hides takes that of its wall, which is even.
#[test]
fn paint_times_shading_is_the_photo_where_nothing_is_clipped() {
    let scene = scene();
    let level = Vec3::new(0.05, 0.06, 0.08);
    let residual = Arc::new(Shading(scene.albedo.0.map(|_| level)));
    let (lit, masks) = (scene.photo(), scene.masks());
    let is_own = |i: usize| masks.iter().any(|(_, mask)| mask.0.pixels()[i] > 0.0);
    let rests = |i: usize| if is_own(i) { Vec3::ZERO } else { scene.albedo.0.pixels()[i] * level };
    // Glare that saturates two pixels around the lamp.
    let lamp = distance(&masks.0[0].1.0.map(|share| share > 0.0));
    let is_glare = |i: usize| !is_own(i) && lamp.pixels()[i] < 2.5;
    let shown = |i: usize| if is_glare(i) { Vec3::ONE } else { lit.0.pixels()[i] + rests(i) };
    let (photo, clipped) =
        stored(&Picture(Plane::new(SIZE.0, SIZE.1, (0..SIZE.0 * SIZE.1).map(shown).collect())));
    let out = paint(scene, &photo, &clipped, &residual);
    let shading = scene.shading();
    let (mut plain, mut hidden) = (0, 0);
    for i in 0..SIZE.0 * SIZE.1 {
        let (got, albedo) = (out.reflectance.0.pixels()[i], scene.albedo.0.pixels()[i]);
        assert!(off(got, albedo) < 1e-5, "{got} of {albedo} at {i}");
        if out.glare_mask.0.iter().any(|(_, glare_mask)| glare_mask.weight(i) > 0.0) {
            hidden += 1;
            continue;
        }
        plain += 1;
        let all = shading.iter().map(|(_, light)| light.0.pixels()[i]).sum::<Vec3>() + level;
        let back = (got * all - photo.0.pixels()[i]).abs().max_element();
        assert!(back <= 1e-6, "{back} at {i}");
    }
    assert!(plain > 10_000 && hidden > 600, "{plain} pixels of the room, {hidden} of lights");
    let glare = (0..SIZE.0 * SIZE.1).filter(|&i| is_glare(i));
    assert!(
        glare
            .clone()
            .all(|i| out.glare_mask.0[0].1.weight(i) > 0.99 && !out.glare_mask.0[0].1.is_own(i)),
        "glare is not the lamp itself"
    );
    assert!(glare.count() > 50, "there is glare");
    for (id, glare_mask) in &out.glare_mask.0 {
        let mask = masks.get(id).expect("it is visible");
        let pixels = 0..SIZE.0 * SIZE.1;
        let own: Vec<f32> =
            pixels.clone().map(|i| f32::from(u8::from(glare_mask.is_own(i)))).collect();
        assert_eq!(own, mask.0.pixels(), "{id}: its own pixels are those of its mask");
        assert!(
            pixels.clone().any(|i| (0.01..0.99).contains(&glare_mask.weight(i))),
            "{id}: its bloom fades"
        );
    }
}
