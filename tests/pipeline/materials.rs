//! Surfaces painted: closed forms on one wall, and the demo.

use std::sync::Arc;

use glam::Vec3;
use relight::geometry::{Camera, Objects};
use relight::graph::{Context, Gather, Node, Status};
use relight::image::{
    Albedo, AlphaMatte, Depth, Mask, PaintChange, PaintLayer, PaintLayers, Picture, Plane, Shading,
};
use relight::nodes::artifacts::EmitterChange;
use relight::nodes::output::compose::{Compose, ComposeIn, ComposeOut};
use relight::optics::{Radiance, Shape};

use crate::project::*;

const SIZE: (usize, usize) = (12, 8);
const OLD: Vec3 = Vec3::new(0.5, 0.4, 0.2);
const NEW: Vec3 = Vec3::new(0.2, 0.3, 0.45);

/// Light that fades from left to right, a tenth of it unexplained.
fn shading(x: usize) -> Vec3 {
    Vec3::new(1.0, 0.9, 0.8) * (1.2 - 0.08 * x as f32)
}

/// Stripes one shade lighter and darker than the paint, which are its mean.
fn wall(x: usize, y: usize) -> Vec3 {
    OLD * if (x + y).is_multiple_of(2) { 1.2 } else { 0.8 }
}

fn lamp<T>(value: T) -> Gather<T> {
    Gather(vec![("lamp".to_string(), Arc::new(value))])
}

/// A wall under one light that the edit multiplies by `factor`, `share` of it painted.
fn composed(share: f32, keep_texture: bool, factor: f32, excess: f32) -> ComposeOut {
    let (w, h) = SIZE;
    let plane = |value: &dyn Fn(usize, usize) -> Vec3| Plane::from_fn(w, h, value);
    let light = |factor: f32| lamp(Shading(plane(&|x, _| 0.9 * factor * shading(x))));
    let photo = Arc::new(Picture(plane(&|x, y| excess * wall(x, y) * shading(x))));
    let none = || Mask(Plane::filled(w, h, 0.0));
    let depth = Arc::new(Depth(Plane::filled(w, h, 2.0)));
    let paint = PaintChange { old: OLD, new: NEW, keep_texture, noise: Vec3::ZERO };
    let matte = AlphaMatte { alpha: Plane::filled(w, h, share), boundary: vec![] };
    let radiance = |v: f32| lamp(Radiance(vec![Vec3::splat(v)]));
    let shape = || lamp(Shape::Absent);
    let residual = Arc::new(Shading(plane(&|x, _| 0.1 * shading(x))));
    let inputs = ComposeIn {
        glare: Gather(vec![]),
        shading_gain: Gather(vec![]),
        photo: photo.clone(),
        clipped: Arc::new(none()),
        camera: Arc::new(Camera::from_fov_x(w, h, 60.0)),
        full_depth: depth.clone(),
        small: photo.clone(),
        depth,
        albedo: Arc::new(Albedo(plane(&wall))),
        reflectance: Arc::new(Albedo(plane(&wall))),
        unsaturated: photo,
        paint_layers: Arc::new(PaintLayers(vec![PaintLayer { paint, matte }])),
        before: light(1.0),
        after: light(factor),
        residual: residual.clone(),
        edited_residual: residual,
        glare_mask: Gather(vec![]),
        kind: Gather(vec![]),
        estimated: shape(),
        estimated_radiance: radiance(1.0),
        shape: shape(),
        radiance: radiance(factor),
        gain: lamp(EmitterChange { gain: vec![Vec3::splat(factor)], added: Vec3::ZERO, dark: 0.0 }),
        coverage: lamp(none()),
        objects: Arc::new(Objects::unseen(&[])),
        object: Gather(vec![]),
        object_residual: Arc::new(Picture(Plane::new(0, 0, vec![]))),
        indirect: Gather(vec![]),
        panes: Gather(vec![]),
        reflected: None,
        specular_change: None,
    };
    Compose::default().run(inputs, &Context::default()).expect("everything is sound")
}

#[track_caller]
fn check(out: &ComposeOut, want: impl Fn(usize, usize) -> Vec3) {
    for (x, y) in (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y))) {
        let (got, want) = (out.picture.0.get(x, y), want(x, y));
        assert!((got - want).abs().max_element() < 1e-5, "({x}, {y}): {got} against {want}");
        let sum = out.layer.0[0].1.get(y * SIZE.0 + x) + out.residual.get(y * SIZE.0 + x);
        assert!(
            (got - sum).abs().max_element() < 1e-3 * got.max_element().max(1.0),
            "({x}, {y}): the layers give {sum}"
        );
    }
}

#[test]
fn a_painted_wall_is_the_photo_times_the_ratio_of_albedos() {
    check(&composed(1.0, true, 1.0, 1.0), |x, y| wall(x, y) / OLD * NEW * shading(x));
    check(&composed(0.25, true, 1.0, 1.0), |x, y| {
        wall(x, y) * shading(x) * (0.75 + 0.25 * NEW / OLD)
    });
    // Under other light as well, and nothing but that light's layer changes.
    check(&composed(1.0, true, 0.5, 1.0), |x, y| wall(x, y) / OLD * NEW * 0.55 * shading(x));
    check(&composed(0.0, true, 1.0, 1.0), |x, y| wall(x, y) * shading(x));
}

#[test]
fn without_its_texture_a_wall_is_even() {
    check(&composed(1.0, false, 1.0, 1.0), |x, _| NEW * shading(x));
}

/// Twice as bright as white paint could be: light that the model misses falls on the new paint too.
#[test]
fn unexplained_light_takes_the_new_paint() {
    check(&composed(1.0, true, 1.0, 4.0), |x, y| 4.0 * wall(x, y) / OLD * NEW * shading(x));
}

const PAINT: &str = r##"Paint(region: Grow(160, 45), albedo: Srgb("#b5563c"))"##;

fn edit(materials: &str, lights: &str) -> String {
    format!("Edit(version: 1, materials: [{materials}], lights: {{ {lights} }})")
}

#[test]
fn paint_runs_bounces_and_what_follows() {
    let cache = tempfile::tempdir().expect("a temporary folder can be made");
    let again = |edit: &str| {
        let report = run(&engine(Some(cache.path())), &physics(&demo(), edit), &[]);
        let pictures = ["picture.png", "picture.exr"].map(|name| written(&report, name));
        (ran(&report).into_iter().map(str::to_owned).collect::<Vec<_>>(), rays(&report), pictures)
    };
    let (_, _, bare) = again(IDENTITY);
    let (ran, rays, painted) = again(&edit(PAINT, ""));
    let bounces =
        ["lamp_0", "window_0", "inv_lamp", "inv_window"].map(|id| format!("edited_indirect[{id}]"));
    let mut want: Vec<String> =
        ["repaint", "after", "compose", "write"].map(str::to_owned).to_vec();
    want.extend(bounces);
    want.extend(["lamp_0", "window_0", "inv_lamp"].map(|id| format!("room_error[{id}]")));
    let sorted = |mut names: Vec<String>| {
        names.sort();
        names
    };
    assert_eq!((sorted(ran), rays), (sorted(want), 0));
    assert!(painted != bare);
    // Another finish computes its own reflection, and no light or bounces.
    let (ran, rays, polished) = again(&edit("Paint(region: Grow(160, 45), roughness: 0.2)", ""));
    assert_eq!(ran, ["repaint", "polish", "compose", "write"]);
    assert!(rays > 10_000 && polished[0] != bare[0]);
    // A dimmed lamp on a painted wall is a new sum, and without paint the photo comes from the
    // cache.
    let (dimmed, rays, _) = again(&edit(PAINT, r#""lamp_0": Scale(0.5)"#));
    assert_eq!(
        (dimmed, rays),
        (
            ["edit", "after", "room_error[lamp_0]", "compose", "write"].map(str::to_owned).to_vec(),
            0
        )
    );
    assert_eq!(again(&edit("", "")), (vec![], 0, bare));
}

/// Half the radiance of a light is half of its layer on paint as well, and nobody else's.
#[test]
fn painted_layers_are_linear() {
    let layers = |lights: &str| {
        let report =
            run(shared_engine(), &physics(&demo(), &edit(PAINT, lights)), &["compose.layer"]);
        assert!(report.nodes.iter().all(|node| node.status != Status::Failed));
        layers(&report)
    };
    let (whole, half) = (layers(""), layers(r#""lamp_0": Scale(0.5)"#));
    for ((id, whole), (_, half)) in whole.iter().zip(&half) {
        let factor = if id == "lamp_0" { 0.5 } else { 1.0 };
        let pairs = whole.0.pixels().iter().zip(half.0.pixels());
        let off =
            pairs.map(|(w, h)| (factor * *w - *h).abs().max_element() / w.max_element().max(1.0));
        let off = off.fold(0.0, f32::max);
        assert!(off < 1e-3, "{id}: off by {off}");
    }
}

#[test]
fn paint_bleeds_on_what_is_not_painted() {
    let picture = |materials: &str| -> Arc<Picture> {
        one(
            &run(shared_engine(), &physics(&demo(), &edit(materials, "")), &["compose.picture"]),
            "compose.picture",
        )
    };
    let (bare, painted) = (picture(""), picture(PAINT));
    // Ceiling, near the wall: less green than it was.
    let (before, after) = (bare.0.get(160, 20), painted.0.get(160, 20));
    assert!(after.x / after.y > 1.05 * before.x / before.y, "{before} became {after}");
    let (before, after) = (bare.0.get(130, 50), painted.0.get(130, 50));
    assert!(after.x / after.z > 2.0 * before.x / before.z, "{before} became {after}");
}
