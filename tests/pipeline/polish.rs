//! Surfaces of another finish: the demo's table and boards.

use std::sync::Arc;

use glam::Vec3;
use relight::image::Picture;

use crate::project::*;

/// The edit that ships, with more in it.
fn edit(materials: &str, more: &str) -> String {
    format!("Edit(version: 1, materials: [{materials}], {more})")
}

const TABLE: &str = "Paint(region: Grow(170, 172), roughness: 0.1, specular: 1)";
const BOARDS: &str = "Paint(region: Grow(70, 170), roughness: 0.1)";

fn picture(edit: &str) -> Arc<Picture> {
    one(&run(shared_engine(), &physics(&demo(), edit), &["compose.picture"]), "compose.picture")
}

fn mean(of: &Picture, (left, top): (usize, usize), (w, h): (usize, usize)) -> Vec3 {
    let all = (top..top + h).flat_map(|y| (left..left + w).map(move |x| of.0.get(x, y)));
    all.sum::<Vec3>() / (w * h) as f32
}

/// The table shows sofa and cushion in their colors, the boards the wall below the window;
/// unpolished pixels stay to the last bit.
#[test]
fn polish_shows_on_what_is_polished() {
    let graph = load(&root().join("graphs/physics.ron"), &demo(), &edits().join("polish.ron"));
    let graph = graph.unwrap_or_else(|faults| panic!("{}", faults[0]));
    let polished: Arc<Picture> =
        one(&run(shared_engine(), &graph, &["compose.picture"]), "compose.picture");
    let bare = picture(IDENTITY);
    let gain = |at, size| mean(&polished, at, size) - mean(&bare, at, size);
    let (sofa, cushion, boards) =
        (gain((156, 162), (10, 3)), gain((176, 166), (6, 4)), gain((60, 165), (10, 6)));
    assert!(sofa.x > 2.0 * sofa.z && sofa.x > 0.005, "orange: {sofa}");
    assert!(cushion.z > 2.0 * cushion.x && cushion.z > 0.005, "teal: {cushion}");
    assert!(boards.min_element() > 0.004, "{boards}");
    for (x, y) in [(160, 15), (160, 45), (120, 220), (290, 215)] {
        assert_eq!(polished.0.get(x, y), bare.0.get(x, y), "({x}, {y})");
    }
}

/// 0.8 is the roughness of the stage's output everywhere; 0.5 the usual specular level.
#[test]
fn what_it_had_changes_nothing() {
    let bare = picture(IDENTITY);
    for same in ["roughness: 0.8", "specular: 0.5", "roughness: 0.8, specular: 0.5"] {
        assert!(
            *picture(&edit(&format!("Paint(region: Grow(70, 170), {same})"), "")) == *bare,
            "{same}"
        );
    }
}

/// A surface that reflects less is darker; nothing goes below zero.
#[test]
fn dull_surfaces_lose_their_gloss() {
    let bare = picture(IDENTITY);
    for dull in ["roughness: 1", "specular: 0", "roughness: 0, specular: 0"] {
        let dulled = picture(&edit(&format!("Paint(region: Grow(70, 170), {dull})"), ""));
        assert!(dulled.0.pixels().iter().all(|c| c.min_element() >= 0.0), "{dull}");
        let loss = mean(&bare, (20, 185), (20, 10)) - mean(&dulled, (20, 185), (20, 10));
        assert!(loss.min_element() > 1e-3 && loss.max_element() < 0.1, "{dull}: {loss}");
    }
}

#[test]
fn polished_layers_sum_and_are_linear() {
    let of = |lights: &str| {
        let text = edit(&[TABLE, BOARDS].join(","), &format!("lights: {{ {lights} }}"));
        let report = run(
            shared_engine(),
            &physics(&demo(), &text),
            &["compose.layer", "compose.residual", "compose.picture"],
        );
        let picture: Arc<Picture> = one(&report, "compose.picture");
        (layers(&report), rest(&report), picture)
    };
    let (whole, rest, picture) = of("");
    for i in 0..picture.0.len() {
        let sum =
            whole.iter().map(|(_, layer)| layer.0.pixels()[i]).sum::<Vec3>() + rest.0.pixels()[i];
        let want = picture.0.pixels()[i];
        assert!(
            (sum - want).abs().max_element() <= 1e-3 * want.max_element().max(1.0),
            "{i}: {sum} against {want}"
        );
    }
    for (dimmed, factor) in [("window_0", 0.5), ("lamp_0", 0.0)] {
        let (layers, ..) = of(&format!(r#""{dimmed}": Scale({factor})"#));
        for ((id, whole), (_, layer)) in whole.iter().zip(&layers) {
            let factor = if id == dimmed { factor } else { 1.0 };
            let pairs = whole.0.pixels().iter().zip(layer.0.pixels());
            let off = pairs
                .map(|(w, l)| (factor * *w - *l).abs().max_element() / w.max_element().max(1.0));
            let off = off.fold(0.0, f32::max);
            assert!(off < 1e-3, "{dimmed} dimmed, {id}: off by {off}");
        }
    }
}

/// A ball over the boards is seen in them, and in the ball the table.
#[test]
fn polished_surfaces_and_objects_show_each_other() {
    let white = "Sphere(radius: 0.12, at: Pixel(x: 30, y: 188, lift: 0.1), material: (albedo: Srgb(\"#ff2010\")))";
    let objects = format!("objects: [{white}]");
    let mirror = "Paint(region: Grow(70, 170), roughness: 0, specular: 1)";
    let (bare, polished) = (picture(&edit("", &objects)), picture(&edit(mirror, &objects)));
    let (alone, shiny) = (picture(IDENTITY), picture(&edit(mirror, "")));
    // Below the ball: red against the reflection of the same boards without it, and more than its
    // bounce alone gives.
    let redness = |of: &Picture| {
        let c = mean(of, (26, 200), (8, 4));
        c.x / c.y
    };
    let (with, without) = (redness(&polished) / redness(&bare), redness(&shiny) / redness(&alone));
    assert!(with > 1.02 * without, "{with} against {without}");

    let chrome = r#"objects: [ Sphere(radius: 0.1, at: Pixel(x: 160, y: 172, lift: 0.03), material: (roughness: 0, metallic: 1)) ]"#;
    let (over, under) = (
        picture(&edit("", chrome)),
        picture(&edit("Paint(region: Grow(170, 172), roughness: 0, specular: 1)", chrome)),
    );
    let differ = (140..180)
        .flat_map(|x| (140..172).map(move |y| (x, y)))
        .filter(|&(x, y)| over.0.get(x, y) != under.0.get(x, y));
    assert!(differ.count() > 20, "the lower half of the ball shows the table");
}

/// The photo does not contain a reflection of an inserted lamp.
#[test]
fn a_new_lamp_shines_on_dull_paint_as_on_none() {
    let lamp = r#"lights: { "desk": Lamp(shape: Sphere(radius: 0.07), at: Pixel(x: 60, y: 185, lift: 0.3), radiance: (72, 44, 20)) }"#;
    let layer = |materials: &str| -> Arc<Picture> {
        let report =
            run(shared_engine(), &physics(&demo(), &edit(materials, lamp)), &["compose.layer"]);
        layers(&report).into_iter().find(|(id, _)| id == "desk").expect("the lamp has a layer").1
    };
    let bare = layer("");
    assert!(*layer("Paint(region: Grow(70, 170), roughness: 1)") == *bare);
    let glossy = layer("Paint(region: Grow(70, 170), roughness: 0.3)");
    let gains = glossy.0.pixels().iter().zip(bare.0.pixels()).map(|(g, b)| (*g - *b).min_element());
    assert!(
        gains.clone().fold(0.0, f32::min) >= 0.0 && gains.fold(0.0, f32::max) > 0.05,
        "it shines in the boards"
    );
}

/// A surface that is polished more from frame to frame runs its reflection and the picture in each,
/// and nothing else.
#[test]
fn roughness_may_have_keys() {
    let cache = tempfile::tempdir().expect("a temporary folder can be made");
    let engine = engine(Some(cache.path()));
    let text =
        edit("Paint(region: Grow(170, 172), roughness: Keys([(0, 0.8), (2, 0.1)]))", "frames: 3");
    let frames: Vec<_> = (0..3)
        .map(|frame| {
            let report = run(&engine, &physics_frame(&demo(), &text, frame), &["compose.picture"]);
            if frame > 0 {
                assert_eq!(ran(&report), ["repaint", "polish", "compose"]);
            }
            one::<Picture>(&report, "compose.picture")
        })
        .collect();
    assert!(frames[0] != frames[1] && frames[1] != frames[2]);
}
