//! The same bits for any number of threads, from a cold and from a warm cache.

use crate::project::*;

/// Every kind of light at work: closed forms, samples, shadows, a sun.
const EDIT: &str = r#"Edit(version: 1, lights: {
    "lamp_0": Scale(0.3),
    "desk": Lamp(shape: Sphere(radius: 0.07), at: Pixel(x: 175, y: 165, lift: 0.2), radiance: (72, 44, 20)),
    "tube": Lamp(shape: Box(half: (0.3, 0.02, 0.02), yaw: 20), at: Point(0.2, 1.2, -3.0), radiance: (9, 9, 9)),
    "east": Window(corners: [(104, 58), (142, 57), (142, 107), (105, 107)], sun: Direction(azimuth: 170, elevation: 30)),
})"#;

#[test]
fn pictures_are_the_same_bits_for_any_threads_and_any_cache() {
    let place = Place::new();
    place.write("edit.ron", EDIT);
    let run = |out: &str, options: &str, status: &str| {
        let message = place.check(&format!("run DEMO.ron edit.ron --out {out} {options}"), 0);
        assert!(message.contains(status), "{message}");
        place.pictures(out)
    };
    let first = run("one", "--threads 1 --cache cache_1", " ran ");
    for (out, options, status) in [
        ("two", "--threads 2 --cache cache_2", " ran "),
        ("four", "--threads 4 --cache cache_4", " ran "),
        ("warm", "--threads 2 --cache cache_1", "hit in"),
        ("none", "--threads 2 --no-cache", " ran "),
        // Made by four threads, taken up by one.
        ("mixed", "--threads 1 --cache cache_4 --set compose.lamp_albedo=0.7", "hit in"),
    ] {
        let pictures = run(out, options, status);
        for (name, (got, want)) in
            ["picture.png", "picture.exr"].iter().zip(pictures.iter().zip(&first))
        {
            let at = got.iter().zip(want).position(|(a, b)| a != b);
            assert!(
                got == want,
                "{out}: {name} differs from that of one thread, first at byte {at:?}"
            );
        }
    }
    // Each stage again from the stored results of another number of threads.
    place.check("run DEMO.ron edit.ron --verify --threads 2 --cache cache_1", 0);
}
