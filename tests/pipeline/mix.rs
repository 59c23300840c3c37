//! A finished run's layers, weighted anew: the picture is that of a fresh run with these radiances.

use glam::Vec3;
use relight::graph::Gather;
use relight::nodes::artifacts::EmitterChange;

use crate::layers::channels;
use crate::project::*;

/// Factors of each light's own shading in a run of this edit: (light, factor per channel).
fn gains(edit: &str) -> Vec<(String, Vec3)> {
    let report = run(shared_engine(), &physics(&demo(), edit), &["edit.gain"]);
    let gains: Gather<EmitterChange> = Gather(many(&report, "edit.gain"));
    let one = |(id, gain): (&str, &std::sync::Arc<EmitterChange>)| {
        (id.to_owned(), *gain.gain.first().unwrap_or(&Vec3::ONE))
    };
    gains.iter().map(one).collect()
}

/// The picture.png and picture.exr of a fresh run of this edit.
fn fresh(edit: &str) -> [Vec<u8>; 2] {
    let report = run(shared_engine(), &physics(&demo(), edit), &[]);
    ["picture.png", "picture.exr"].map(|name| written(&report, name))
}

/// A folder with the run that changes nothing.
fn finished() -> Place {
    let place = Place::new();
    let [png, exr] = fresh(IDENTITY);
    std::fs::create_dir(place.path("run")).expect("a folder can be made");
    place.write("run/picture.png", png);
    place.write("run/picture.exr", exr);
    place
}

/// Largest difference of stored numbers, of 255.
pub fn farthest(a: &image::RgbImage, b: &image::RgbImage) -> u8 {
    assert_eq!(a.dimensions(), b.dimensions());
    a.as_raw()
        .iter()
        .zip(b.as_raw())
        .map(|(a, b)| a.abs_diff(*b))
        .max()
        .expect("a picture has pixels")
}

#[test]
fn a_mix_is_what_a_fresh_run_with_these_weights_gives() {
    let place = finished();
    for lights in [
        r#""lamp_0": Scale(0.5), "window_0": Scale(1.7)"#,
        r#""lamp_0": Off, "inv_lamp": Scale(3)"#,
        // A color is not the same factor in every channel; the lamp has one lobe, so that one
        // factor determines all.
        r#""lamp_0": Color(1, 0.25, 0.1), "window_0": Scale(0.3)"#,
    ] {
        let edit = format!("Edit(version: 1, lights: {{ {lights} }})");
        let set =
            gains(&edit).into_iter().map(|(id, w)| format!(" --set {id}={},{},{}", w.x, w.y, w.z));
        let message = place.check(&format!("mix run --out mixed{}", set.collect::<String>()), 0);
        assert!(message.contains("mixed in"), "{message}");
        let ([png_mixed, exr_mixed], [png_fresh, exr_fresh]) =
            (place.pictures("mixed"), fresh(&edit));
        // Halves have a relative error of 2^-11, in the layer that is read and in the result: a
        // fifth of a step of 8 bits.
        let steps = farthest(&png(&png_mixed), &png(&png_fresh));
        assert!(steps <= 1, "{lights}: {steps} of 255");
        let (mixed, wanted) = (channels(&exr_mixed), channels(&exr_fresh));
        for (name, got) in &mixed {
            let off = got.iter().zip(&wanted[name]).map(|(a, b)| (a - b).abs() / b.abs().max(1e-2));
            let off = off.fold(0.0, f32::max);
            assert!(off < 2e-3, "{lights}: {name} is off by {off}");
        }
        assert!(
            mixed.keys().filter(|name| name.starts_with("light_")).count() >= 15,
            "{:?}",
            mixed.keys()
        );
    }
}

#[test]
fn a_mix_can_be_mixed_on_and_one_file_be_wanted() {
    let place = finished();
    place.check("mix run --set lamp_0=0.5*#ffffff --out half", 0);
    place.check("mix half --set lamp_0=2 --out whole.png", 0);
    place.check("mix run/picture.exr --out same.png", 0);
    let read = |name: &str| png(&std::fs::read(place.path(name)).expect("it was written"));
    assert!(farthest(&read("whole.png"), &read("run/picture.png")) <= 1);
    assert!(farthest(&read("same.png"), &read("run/picture.png")) <= 1);
    assert!(
        farthest(&read("half/picture.png"), &read("run/picture.png")) > 20,
        "the weight does something"
    );
    assert!(!place.path("picture.exr").exists(), "only the file that is wanted");
}

#[test]
fn what_cannot_be_mixed_is_told() {
    let place = finished();
    place.write("notes.exr", "no picture");
    place.write(
        "flat.exr",
        std::fs::read(demo().join("truth/albedo.exr")).expect("the demo has it"),
    );
    for (line, wanted) in [
        ("mix run --set lamp0=0.5", "the run has no light `lamp0`: did you mean `lamp_0`?"),
        (
            "mix run --set rest=0.5",
            "the run has no light `rest`: it has inv_lamp, inv_window, lamp_0, window_0",
        ),
        ("mix run --set lamp_0=-1", "wanted a light and a weight of 0 or more"),
        ("mix run --set lamp_0=nan", "wanted a light and a weight of 0 or more"),
        ("mix run --set lamp_0=1 --set lamp_0=2", "`lamp_0` is set twice"),
        ("mix run --set lamp_0=3e38", "weights: wanted a picture of finite numbers, got"),
        ("mix nowhere", "nowhere: wanted the folder that `relight run` wrote to"),
        ("mix notes.exr", "notes.exr: file format: wanted OpenEXR"),
        ("mix flat.exr", "flat.exr: comments: wanted a line `encoding: Srgb, 8 bits`"),
    ] {
        let message = place.check(line, 2);
        assert!(message.contains(wanted), "`relight {line}`: wanted {wanted:?}, got:\n{message}");
    }
    let message = place.check("mix run --set inv_window=2", 0);
    assert!(message.contains("warning: inv_window is off in this run"), "{message}");
}
