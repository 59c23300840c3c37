//! The layers sum to the picture, and each is linear in its light.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec3;
use relight::image::Picture;

use crate::project::*;

const COMPOSED: [&str; 3] = ["compose.picture", "compose.layer", "compose.residual"];

struct Composed {
    picture: Arc<Picture>,
    layers: Vec<(String, Arc<Picture>)>,
}

/// The layers with `rest` at the end.
fn composed(edit: &str) -> Composed {
    let report = run(shared_engine(), &physics(&demo(), edit), &COMPOSED);
    let mut layers = layers(&report);
    layers.push(("rest".into(), rest(&report)));
    Composed { picture: one(&report, COMPOSED[0]), layers }
}

/// Largest distance over pixels and channels, relative to the second; below 1e-3 absolute, where
/// layers, being halves, lose digits.
fn worst(pairs: impl Iterator<Item = (Vec3, Vec3)>) -> f32 {
    pairs
        .map(|(got, want)| ((got - want).abs() / want.abs().max(Vec3::splat(1e-3))).max_element())
        .fold(0.0, f32::max)
}

fn edits() -> impl Iterator<Item = (String, String)> {
    let read = |path: std::path::PathBuf| {
        let text = std::fs::read_to_string(&path).expect("it is there");
        // Tests put edits into folders of their own.
        (stem(&path).to_owned(), text.replace("\"../", &format!("\"{}/", root().display())))
    };
    ron_files(crate::project::edits()).into_iter().map(read)
}

#[test]
fn in_memory_the_layers_sum_to_the_picture() {
    for (name, edit) in edits() {
        let Composed { picture, layers } = composed(&edit);
        let sum = |i: usize| layers.iter().map(|(_, layer)| layer.0.pixels()[i]).sum::<Vec3>();
        let worst = worst(picture.0.pixels().iter().enumerate().map(|(i, &p)| (sum(i), p)));
        assert!(worst < 1e-3, "{name}: the layers sum to the picture to {worst}");
        let negative =
            layers.iter().find(|(_, layer)| layer.0.pixels().iter().any(|c| c.min_element() < 0.0));
        assert!(
            negative.is_none(),
            "{name}: the layer of {} is negative somewhere",
            negative.unwrap().0
        );
    }
}

pub fn channels(bytes: &[u8]) -> BTreeMap<String, Vec<f32>> {
    use exr::prelude::*;
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes();
    let image = image.from_buffered(std::io::Cursor::new(bytes)).expect("it is a sound EXR file");
    let all = image.layer_data.iter().flat_map(|layer| &layer.channel_data.list);
    all.map(|channel| (channel.name.to_string(), channel.sample_data.values_as_f32().collect()))
        .collect()
}

/// Each half is off by 2^-11 of itself, the picture's as well: with layers that are not negative,
/// 2^-10 of the picture in all.
#[test]
fn in_the_file_the_layers_sum_to_the_picture() {
    for (name, edit) in edits() {
        let report = run(shared_engine(), &physics(&demo(), &edit), &[]);
        let channels = channels(&written(&report, "picture.exr"));
        for c in ["R", "G", "B"] {
            let layers: Vec<&Vec<f32>> = channels
                .iter()
                .filter(|(name, _)| name.starts_with("light_") && name.ends_with(&format!(".{c}")))
                .map(|(_, samples)| samples)
                .collect();
            assert!(layers.len() >= 5, "{name}: lamp, window, two invisible lights and the rest");
            let worst = channels[c].iter().enumerate().map(|(i, picture)| {
                let sum: f32 = layers.iter().map(|layer| layer[i]).sum();
                (sum - picture).abs() / picture.abs().max(1e-3)
            });
            let worst = worst.fold(0.0, f32::max);
            assert!(worst < 1e-3, "{name}.{c}: the layers sum to the picture to {worst}");
        }
    }
}

/// Half the radiance is half the layer, and nobody else's.
#[test]
fn each_layer_is_linear_in_its_light() {
    let whole = composed(IDENTITY);
    for id in ["lamp_0", "window_0", "inv_lamp", "inv_window"] {
        let half = composed(&format!(r#"Edit(version: 1, lights: {{ "{id}": Scale(0.5) }})"#));
        for ((name, half), (_, whole)) in half.layers.iter().zip(&whole.layers) {
            if name == id {
                let pairs =
                    half.0.pixels().iter().zip(whole.0.pixels()).map(|(&h, &w)| (h, 0.5 * w));
                let worst = worst(pairs);
                assert!(worst < 1e-3, "{id}: half the light gives half the layer to {worst}");
            } else {
                assert!(half == whole, "{id} changed the layer of {name}");
            }
        }
    }
}
