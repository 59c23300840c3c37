//! The noise of the photo on inserted objects and on the bodies of inserted lights.

use std::collections::BTreeMap;

use glam::Vec3;

use crate::common::files::png_of;
use crate::layers::channels;
use crate::mix::farthest;
use crate::project::*;

/// Deviation of the noise in stored numbers, and in square roots of linear values: sRGB is close to
/// them.
const DEVIATION: f32 = 3.0 / 255.0;
const WIDTH: usize = 320;

/// A ball and a lamp on the rug, the lamp no brighter than a surface; `lamp_0` and the lamp have
/// these factors.
fn edit([lamp, desk]: [f32; 2]) -> String {
    let radiance = Vec3::new(0.5, 0.4, 0.3) * desk;
    format!(
        r#"Edit(version: 1, lights: {{ "lamp_0": Scale({lamp}),
            "desk": Lamp(shape: Sphere(radius: 0.15), at: Pixel(x: 190, y: 225), radiance: ({}, {}, {})) }},
            objects: [Sphere(radius: 0.2, at: Pixel(x: 90, y: 205), material: (albedo: Linear(0.6, 0.5, 0.4)))])"#,
        radiance.x, radiance.y, radiance.z,
    )
}

/// The small room, whose photo has no noise, with this noise: the sum of twelve uniform numbers
/// less six has unit variance.
fn noisy(deviation: f32) -> Place {
    let place = Place::new();
    let scene = std::fs::read_to_string(demo().join("scene.ron")).expect("the room has a scene");
    let (lights, _) = scene.split_once("truth:").expect("the room has its truth");
    let (lights, room) = (lights.replace("masks/", "ROOM/masks/"), demo());
    let scene = lights.replace("depth.exr", "ROOM/depth.exr");
    place.write("scene.ron", scene.replace("ROOM", &room.display().to_string()) + ")");
    let photo = photo();
    let mut state = 7u32;
    let mut uniform = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    let mut noise = || (0..12).map(|_| uniform()).sum::<f32>() - 6.0;
    let pixel = |x: usize, y: usize| {
        let stored = photo.get_pixel(x as u32, y as u32).0.map(|v| f32::from(v) / 255.0);
        Vec3::from_array(stored.map(|v| (v + deviation * noise()).clamp(0.0, 1.0)))
    };
    place.write("photo.png", png_of((WIDTH, 240), pixel));
    place
}

/// The run of these factors into `out`, with more arguments.
fn run(place: &Place, factors: [f32; 2], out: &str, more: &str) {
    place.write("edit.ron", edit(factors));
    let line = format!("run GRAPHS/physics.ron edit.ron --scene . --cache kept --out {out}{more}");
    place.check(&line, 0);
}

/// The green channel of the picture that was written.
fn green(place: &Place, out: &str) -> Vec<f32> {
    let mut all: BTreeMap<String, Vec<f32>> = channels(&place.pictures(out)[1]);
    all.remove("G").expect("the picture has a green channel")
}

/// Pixels of a disc.
fn disc([x, y]: [usize; 2], radius: usize) -> impl Fn(usize) -> bool {
    move |i| {
        let away = [(i % WIDTH).abs_diff(x), (i / WIDTH).abs_diff(y)];
        away[0] * away[0] + away[1] * away[1] < radius * radius
    }
}

#[test]
fn what_is_inserted_has_the_noise_of_the_photo_and_nothing_else_changes() {
    let place = noisy(DEVIATION);
    run(&place, [1.0, 1.0], "with", "");
    run(&place, [1.0, 1.0], "without", " --set compose.grain=0");
    let (with, without) = (green(&place, "with"), green(&place, "without"));
    let root = |i: usize| with[i].sqrt() - without[i].sqrt();
    let changed: Vec<usize> = (0..with.len()).filter(|&i| with[i] != without[i]).collect();
    let around = [disc([89, 189], 20), disc([190, 211], 20)];
    assert!(changed.iter().all(|&i| around.iter().any(|disc| disc(i))), "only what is inserted");
    for (name, pixels) in [("object", disc([89, 189], 13)), ("lamp", disc([190, 211], 10))] {
        let pixels: Vec<usize> = (0..with.len()).filter(|&i| pixels(i)).collect();
        let square: f32 = pixels.iter().map(|&i| root(i).powi(2)).sum();
        let got = (square / pixels.len() as f32).sqrt() / DEVIATION;
        // A lamp has the noise of white, relative to its level: less in its square root.
        let range = if name == "lamp" { 0.5..0.9 } else { 0.8..1.25 };
        assert!(range.contains(&got), "{name}: {got} times the noise of the photo");
    }

    let clean = noisy(0.0);
    run(&clean, [1.0, 1.0], "with", "");
    run(&clean, [1.0, 1.0], "without", " --set compose.grain=0");
    // The files differ in the record of their making.
    let [with, without] = ["with", "without"].map(|out| clean.pictures(out));
    let same = png(&with[0]) == png(&without[0]) && channels(&with[1]) == channels(&without[1]);
    assert!(same, "a photo without noise adds none");
}

#[test]
fn a_mix_has_the_noise_of_a_fresh_run() {
    let place = noisy(DEVIATION);
    run(&place, [1.0, 1.0], "run", "");
    run(&place, [0.5, 1.75], "fresh", "");
    place.check("mix run --set lamp_0=0.5,0.5,0.5 --set desk=1.75,1.75,1.75 --out mixed", 0);
    let [mixed, fresh] = ["mixed", "fresh"].map(|out| place.pictures(out));
    let steps = farthest(&png(&mixed[0]), &png(&fresh[0]));
    assert!(steps <= 1, "{steps} of 255");
    let (mixed, fresh) = (channels(&mixed[1]), channels(&fresh[1]));
    for (name, mixed) in &mixed {
        let off = mixed.iter().zip(&fresh[name]).map(|(a, b)| (a - b).abs() / b.abs().max(1e-2));
        let off = off.fold(0.0, f32::max);
        assert!(off < 2e-3, "{name} is off by {off}");
    }
}
