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
    place.write("edit.ron", "Edit(version: 1)");
    let line = "run GRAPHS/physics.ron edit.ron --scene . --cache kept --set compose.grain=0";
    place.check(&format!("{line} --out photo"), 0);
    // In the shadow of the object a surface lacks light, and a part of its noise.
    let [bare, inserted] = ["photo", "without"].map(|out| channels(&place.pictures(out)[1]));
    let differs = |a: &[f32], b: &[f32], i: usize| (a[i] - b[i]).abs() > 3e-3 * b[i];
    let is_layer = |name: &&String| name.starts_with("light_") && name.ends_with(".G");
    let layers: Vec<[&[f32]; 2]> =
        bare.keys().filter(is_layer).map(|name| [&inserted[name][..], &bare[name]]).collect();
    let is_relit = |i: usize| layers.iter().any(|[a, b]| differs(a, b, i));
    let around = [disc([89, 189], 20), disc([190, 211], 20)];
    let changed = (0..with.len()).filter(|&i| differs(&with, &without, i));
    let strange: Vec<usize> =
        changed.filter(|&i| !is_relit(i) && !around.iter().any(|disc| disc(i))).collect();
    assert!(strange.is_empty(), "{} pixels beside what is inserted", strange.len());
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

/// The wall under the lamp of the small room is bright, and the noise of the photo is the same at
/// all levels of its square root: relative to the wall without the lamp, it is several times less.
#[test]
fn a_wall_without_its_lamp_has_the_noise_of_a_dark_wall_and_the_identity_that_of_the_photo() {
    let place = noisy(DEVIATION);
    let run = |factor: f32, grain: f32, out: &str| {
        let lights = format!("lights: {{ \"lamp_0\": Scale({factor}) }}");
        place.write("edit.ron", format!("Edit(version: 1, {lights})"));
        let line = "run GRAPHS/physics.ron edit.ron --scene . --cache kept";
        place.check(&format!("{line} --set compose.grain={grain} --out {out}"), 0);
        green(&place, out)
    };
    let same = [run(1.0, 0.0, "photo"), run(1.0, 1.0, "same")];
    // The files have half floats.
    let off = same[0].iter().zip(&same[1]).map(|(a, b)| (a - b).abs() / a.max(1e-3));
    let off = off.fold(0.0, f32::max);
    assert!(off < 1e-3, "the identity is off by {off}");
    let (without, with) = (run(0.0, 0.0, "without"), run(0.0, 1.0, "with"));
    let ratio = |a: &[f32], b: &[f32], i: usize| a[i] / b[i].max(1e-6);
    let lit: Vec<usize> = (0..with.len()).filter(|&i| ratio(&same[0], &without, i) > 4.0).collect();
    assert!(lit.len() > 200, "{} pixels are mostly lit by the lamp", lit.len());
    let square: f32 = lit.iter().map(|&i| (ratio(&with, &without, i) - 1.0).powi(2)).sum();
    let of_dark_wall = |i: usize| 2.0 * DEVIATION / without[i].sqrt().max(0.125);
    let want: f32 = lit.iter().map(|&i| of_dark_wall(i).powi(2)).sum();
    let got = (square / want).sqrt();
    // Less what the pixels have already.
    assert!((0.5..1.25).contains(&got), "{got} times the noise of a dark wall");

    place.check("mix same --set lamp_0=0,0,0 --out mixed", 0);
    let mixed = green(&place, "mixed");
    let off = mixed.iter().zip(&with).map(|(a, b)| (a - b).abs() / b.max(1e-2));
    let off = off.fold(0.0, f32::max);
    assert!(off < 2e-3, "a mix is off by {off}");
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
