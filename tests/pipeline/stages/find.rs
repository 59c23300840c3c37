//! `FindLights`: lamps and windows are proposed, lit walls are not.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec3;
use relight::graph::{Context, Node};
use relight::image::{NamedBytes, Picture, Plane, Transfer, read_mask};
use relight::nodes::artifacts::Encoding;
use relight::nodes::estimate::find_lights::{FindLights, FindLightsIn};

use super::*;
use crate::common::scene::{Scene, stored};

/// The proposed masks by name, and the warnings.
fn find(scene: &Scene, photo: &Picture) -> (BTreeMap<String, Plane<f32>>, Vec<String>) {
    let (photo, clipped) = stored(photo);
    let inputs = FindLightsIn {
        photo: photo.clone(),
        encoding: Arc::new(Encoding {
            transfer: Transfer::Srgb,
            lux: None,
            sixteen_bit: false,
            exif: Vec::new(),
        }),
        small: photo,
        clipped,
        points: Some(scene.points.clone()),
        normal: Some(scene.normal.clone()),
    };
    let ctx = Context::default();
    let files = FindLights::default().run(inputs, &ctx).expect("the room is sound").files;
    let masks = files.0.iter().filter_map(|(name, bytes)| {
        let id = name.strip_prefix("masks/")?.strip_suffix(".png")?;
        let mask =
            read_mask(NamedBytes::new(name, bytes)).unwrap_or_else(|e| panic!("{}", e.message()));
        Some((id.to_owned(), mask.0))
    });
    (masks.collect(), ctx.warnings())
}

/// Intersection over union.
fn overlap(a: &Plane<f32>, b: &Plane<f32>) -> f32 {
    let pairs = || a.pixels().iter().zip(b.pixels());
    let count = |both: fn(f32, f32) -> f32| pairs().map(|(a, b)| both(*a, *b)).sum::<f32>();
    count(f32::min) / count(f32::max)
}

#[test]
fn find_lights_proposes_what_shines_and_no_white_wall() {
    let scene = scene();
    let lights = [0, 1].map(|i| scene.lights[i].mask.clone().expect("it is in view"));
    let is_light = |i: usize| lights.iter().any(|mask| mask.0.pixels()[i] > 0.0);
    // The brightest wall at nine tenths of white, above the threshold, 0.75, from which lights are
    // looked for.
    let photo = scene.photo().0;
    let walls = (0..photo.len()).filter(|&i| !is_light(i)).map(|i| photo.pixels()[i].max_element());
    let gain = 0.9 / walls.fold(0.0, f32::max);
    let exposed = Picture(photo.map(|shown| shown * gain));
    let bright = (0..photo.len())
        .filter(|&i| !is_light(i) && exposed.0.pixels()[i].max_element() > 0.75)
        .count();
    assert!(bright > 100, "{bright} pixels of walls are candidates");

    let (found, _) = find(scene, &exposed);
    assert_eq!(found.keys().collect::<Vec<_>>(), ["lamp_0", "window_0"]);
    // About 26 of the lamp's 58 pixels are its outline, each of which may fall on either side by
    // half: 0.8.
    for (found, mask) in found.values().zip(&lights) {
        let overlap = overlap(found, &mask.0);
        assert!(overlap > 0.8, "intersection over union {overlap}");
    }

    // The wall in the place of the lamp: it is as bright as before beside a window that still shows
    // white, and is not a light.
    let lamp = |i: usize| lights[0].0.pixels()[i] > 0.0;
    let wall = |i: usize| if lamp(i) { Vec3::splat(0.9) } else { exposed.0.pixels()[i] };
    let walls = Picture(Plane::new(SIZE.0, SIZE.1, (0..photo.len()).map(wall).collect()));
    let (found, _) = find(scene, &walls);
    assert_eq!(found.keys().collect::<Vec<_>>(), ["window_0"]);

    let even = Picture(photo.map(|_| Vec3::splat(0.5)));
    let (found, warnings) = find(scene, &even);
    assert!(
        found.is_empty() && warnings.iter().any(|message| message.starts_with("no light found")),
        "{warnings:?}"
    );
}
