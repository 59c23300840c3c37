//! Work in proportion: cost of many lights and of a large photo, counted and not timed.

use glam::Vec3;
use relight::graph::{NodeReport, RunReport};
use relight::optics::Radiance;

use crate::common::files::png_of;
use crate::project::*;

/// The demo's room under lights of this text, with a photo of its own where there is one.
fn scene(place: &Place, photo: Option<&str>, lights: &str) {
    let demo = demo();
    let photo = photo.map_or(demo.join("photo.png"), |photo| place.path(photo));
    let text = format!(
        r#"Scene(version: 1, photo: {photo:?}, camera: FovX(64), depth: (path: {:?}), lights: {{ {lights} }})"#,
        demo.join("depth.exr")
    );
    place.write("scene.ron", text);
}

fn lamps(count: usize, mask: impl Fn(usize) -> std::path::PathBuf) -> String {
    (0..count).map(|i| format!("\"l{i}\": Lamp(mask: {:?}), ", mask(i))).collect()
}

fn fit(place: &Place) -> RunReport {
    run(&engine(None), &physics(&place.path("."), IDENTITY), &["fit.radiance"])
}

fn node<'a>(report: &'a RunReport, name: &str) -> &'a NodeReport {
    report.nodes.iter().find(|node| node.name == name).expect("it ran")
}

/// The fits that placed the lights, and the columns of all of them.
fn fits(report: &RunReport) -> (usize, usize) {
    let note = node(report, "init").notes.first().expect("it says what it did");
    let mut numbers = note.split(' ').filter_map(|word| word.parse().ok());
    (numbers.next().expect("the fits"), numbers.next().expect("their columns"))
}

#[test]
fn a_hundred_names_for_one_lamp_cost_as_much_as_one() {
    let place = Place::new();
    let of = |count: usize| {
        scene(&place, None, &lamps(count, |_| demo().join("masks/lamp_0.png")));
        fit(&place)
    };
    let (one, hundred) = (of(1), of(100));
    assert_eq!(fits(&hundred), fits(&one));
    assert!(node(&one, "init").rays > 0);
    assert_eq!(rays(&hundred), rays(&one));
    let all = many::<Radiance>(&hundred, "fit.radiance");
    let lamps: Vec<Vec3> =
        all.iter().filter(|(id, _)| id.starts_with('l')).map(|(_, of)| of.0[0]).collect();
    assert!(
        lamps[0].min_element() > 0.0 && lamps == [lamps[0]; 100],
        "they share it evenly: {lamps:?}"
    );
}

/// Beside many lights a candidate is fitted to their sum.
#[test]
fn many_lights_do_not_widen_the_search() {
    let place = Place::new();
    for i in 0..32 {
        let (left, top) = (5 + i % 8 * 39, 5 + i / 8 * 50);
        let inside =
            |x: usize, y: usize| (left..left + 8).contains(&x) && (top..top + 6).contains(&y);
        place.write(
            &format!("m{i}.png"),
            png_of((320, 240), |x, y| if inside(x, y) { Vec3::ONE } else { Vec3::ZERO }),
        );
    }
    scene(&place, None, &lamps(32, |i| place.path(&format!("m{i}.png"))));
    let report = fit(&place);
    let (fits, columns) = fits(&report);
    assert!(fits < 150 && columns < 5 * fits, "{fits} fits, {columns} columns");
    scene(&place, None, &lamps(33, |i| place.path(&format!("m{i}.png"))));
    let edit = place.path("edit.ron");
    place.write("edit.ron", IDENTITY);
    let faults = load(&root().join("graphs/physics.ron"), &place.path("."), &edit)
        .err()
        .expect("it is refused");
    let message = faults[0].to_string();
    assert!(
        message.contains("wanted at most 32 lights with masks of their own, got 33"),
        "{message}"
    );
}

/// Bytes per pixel of the photo that the values of a run may take at one time: 12 each for photo
/// and picture, 4 for the depth, 6 for each of five layers, 1 for each of two masks, and the file's
/// 44 never all at once.
const HELD: u64 = 66;

#[test]
fn a_run_lets_go_of_planes_of_the_photos_size() {
    let place = Place::new();
    let size = (3000, 2250);
    let small = photo();
    let shown = |x: usize, y: usize| {
        let pixel = small.get_pixel((x * 320 / size.0) as u32, (y * 240 / size.1) as u32).0;
        Vec3::from_array(pixel.map(|v| f32::from(v) / 255.0))
    };
    place.write("photo.png", png_of(size, shown));
    let mask = |name: &str| demo().join(format!("masks/{name}.png"));
    let lights = format!(
        "\"lamp\": Lamp(mask: {:?}), \"window\": Window(mask: {:?})",
        mask("lamp_0"),
        mask("window_0")
    );
    scene(&place, Some("photo.png"), &lights);
    let report = run(&engine(None), &physics(&place.path("."), IDENTITY), &[]);
    let bound = HELD * (size.0 * size.1) as u64 + (100 << 20);
    assert!(report.peak_bytes < bound, "{} of {bound} bytes", report.peak_bytes);
}
