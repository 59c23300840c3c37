//! Depth of few pixels at the size of its photo.

use glam::Vec3;
use relight::image::{Depth, Picture, Plane, guided_depth, resize_depth};

const FULL: (usize, usize) = (128, 96);

/// A person at 2 m, up to column 51 + y / 8, before a wall that runs from 4 m to 5 m.
fn room() -> (Depth, Picture) {
    let person = |x: usize, y: usize| x < 51 + y / 8;
    let wall = |x: usize| 1.0 / (0.25 - 0.05 * x as f32 / 127.0);
    let depth = Plane::from_fn(FULL.0, FULL.1, |x, y| if person(x, y) { 2.0 } else { wall(x) });
    let photo = Plane::from_fn(FULL.0, FULL.1, |x, y| {
        if person(x, y) { Vec3::new(0.1, 0.15, 0.3) } else { Vec3::new(0.6, 0.5, 0.4) }
    });
    (Depth(depth), Picture(photo))
}

fn wrong(got: &Depth, true_depth: &Depth) -> usize {
    let pairs = got.0.pixels().iter().zip(true_depth.0.pixels());
    pairs.filter(|(a, b)| (*a / *b - 1.0).abs() > 0.02).count()
}

#[test]
fn steps_follow_the_edges_of_the_photo() {
    let (truth, photo) = room();
    let low = resize_depth(&truth, 16, 12);
    let plain = wrong(&resize_depth(&low, FULL.0, FULL.1), &truth);
    let guided = wrong(&guided_depth(&low, None, &photo), &truth);
    assert!(plain > 150 && guided < plain / 8, "{plain} pixels, guided {guided}");
}

#[test]
fn numbers_without_confidence_give_way() {
    let (truth, photo) = room();
    let mut low = resize_depth(&truth, 16, 12);
    let mut confidence = Plane::filled(16, 12, 1.0);
    for (x, y) in (0..9).map(|i| (11 + i % 3, 5 + i / 3)) {
        low.0.set(x, y, 3.1);
        confidence.set(x, y, 0.0);
    }
    let trusting = wrong(&guided_depth(&low, None, &photo), &truth);
    let knowing = wrong(&guided_depth(&low, Some(&confidence), &photo), &truth);
    assert!(trusting > 300 && knowing < 30, "{trusting} pixels, with confidence {knowing}");
}

/// A band at the step that is wider than the usual window, as sensors that mix two surfaces have.
#[test]
fn a_wide_band_without_confidence_gives_way() {
    let (truth, photo) = room();
    let mut low = resize_depth(&truth, 16, 12);
    let mut confidence = Plane::filled(16, 12, 1.0);
    for (x, y) in (4..11).flat_map(|x| (0..12).map(move |y| (x, y))) {
        low.0.set(x, y, 3.0);
        confidence.set(x, y, 0.0);
    }
    let trusting = wrong(&guided_depth(&low, None, &photo), &truth);
    let knowing = wrong(&guided_depth(&low, Some(&confidence), &photo), &truth);
    assert!(trusting > 4000 && knowing < trusting / 2, "{trusting}, with confidence {knowing}");
}

#[test]
fn a_slanted_wall_stays_a_plane() {
    let wall =
        |w: usize| Plane::from_fn(w, 12, |x, _| 1.0 / (0.5 - 0.3 * (x as f32 + 0.5) / w as f32));
    let photo = Picture(Plane::filled(64, 48, Vec3::splat(0.4)));
    let got = guided_depth(&Depth(wall(16)), None, &photo).0;
    let worst = (4..60).map(|x| (got.get(x, 20) / wall(64).get(x, 0) - 1.0).abs());
    assert!(worst.clone().fold(0.0, f32::max) < 0.01, "{:?}", worst.collect::<Vec<_>>());
}
