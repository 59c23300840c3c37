//! Stiff and extreme inputs: every answer is finite, not negative, and agrees with a closed form or
//! a limit.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use crate::optics::transport::estimate;
use crate::optics::{
    BoxLamp, Emitter, Lamp, Lobe, MeshLamp, RectLamp, Shape, SphereLamp, Surfel, Window,
};

/// The closed form of E, after a comparison with samples: their mean over 200 pixels, within five
/// standard errors and single-precision rounding.
fn check(shape: &Shape, lobe: usize, point: Vec3, normal: Vec3) -> f64 {
    let emitter = Emitter::new(shape);
    let exact = f64::from(emitter.irradiance(lobe, point, normal).expect("it has a closed form"));
    assert!(exact.is_finite() && exact >= 0.0, "{shape:?} {exact}");
    let pixels = 200;
    let means: Vec<f64> =
        (0..pixels).map(|pixel| estimate(&emitter, lobe, (point, normal), 4, 1, pixel).0).collect();
    let mean = means.iter().sum::<f64>() / f64::from(pixels);
    let variance = means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / f64::from(pixels);
    let bound = 5.0 * (variance / f64::from(pixels)).sqrt() + 1e-6 * exact + 2e-8;
    assert!(
        (mean - exact).abs() <= bound,
        "{shape:?} {point} {normal}: samples {mean}, closed form {exact}"
    );
    exact
}

fn near(got: f64, wanted: f64, relative: f64) {
    assert!((got - wanted).abs() <= relative * wanted.abs(), "{got} instead of {wanted}");
}

fn rect(center: Vec3, x: Vec3, y: Vec3) -> Shape {
    Shape::Lamp(Lamp::Rect(RectLamp { center, x, y }))
}

fn window(center: Vec3, half: f32, direction: Vec3, bandwidth: f32) -> Shape {
    let lobes = [Lobe { direction: direction.normalize(), bandwidth }; 3];
    Shape::Window(Window { center, x: Vec3::NEG_X * half, y: Vec3::Y * half, lobes })
}

fn sphere(center: Vec3, radius: f32) -> Shape {
    Shape::Lamp(Lamp::Sphere(SphereLamp { center, radius }))
}

#[test]
fn a_flat_lobe_is_a_lamp_and_a_steep_one_a_direction() {
    let center = Vec3::new(0.1, 0.2, 2.0);
    let normal = Vec3::new(0.2, 0.5, 0.6).normalize();
    let lamp = check(&rect(center, Vec3::NEG_X, Vec3::Y), 0, Vec3::ZERO, normal);
    near(check(&window(center, 1.0, Vec3::Z, 0.0), 0, Vec3::ZERO, normal), lamp, 1e-6);
    // G lies between 1 and 1 - 2e-6.
    near(check(&window(center, 1.0, Vec3::Z, 1e-6), 0, Vec3::ZERO, normal), lamp, 2e-6);
    let towards = Vec3::new(0.1, 0.2, 1.0).normalize();
    for bandwidth in [1e5, 1e6, 1e7] {
        // 2 pi / b steradians; the mean cosine falls short of 1 by 1 / b.
        let exact = 2.0 / f64::from(bandwidth) * f64::from(normal.dot(towards));
        near(check(&window(center, 1.0, towards, bandwidth), 0, Vec3::ZERO, normal), exact, 2e-5);
    }
    // Half of a steep lobe, aimed at an edge to single precision, which is 2e-4 of its width.
    let whole = 2e-7 * 2.0 / 5f64.sqrt();
    near(
        check(&window(Vec3::Z * 2.0, 1.0, Vec3::new(1.0, 0.0, 2.0), 1e7), 0, Vec3::ZERO, Vec3::Z),
        0.5 * whole,
        4e-4,
    );
}

#[test]
fn a_micrometer_and_ten_kilometers() {
    let lamp = |height: f32| rect(Vec3::Z * height, Vec3::NEG_X * 0.5, Vec3::Y * 0.5);
    // It fills the sky but for a ring of elevation 2e-6 and less.
    near(check(&lamp(1e-6), 0, Vec3::ZERO, Vec3::Z), 1.0, 1e-6);
    near(check(&window(Vec3::Z * 1e-6, 0.5, Vec3::Z, 0.0), 0, Vec3::ZERO, Vec3::Z), 1.0, 1e-6);
    // The integral of exp(cos - 1) cos over the hemisphere is 2 pi / e.
    near(
        check(&window(Vec3::Z * 1e-6, 0.5, Vec3::Z, 1.0), 0, Vec3::ZERO, Vec3::Z),
        2.0 / 1f64.exp(),
        1e-5,
    );
    let far = 1.0 / (PI * 1e8);
    let tilted = Vec3::new(0.0, 0.8, 0.6);
    near(check(&lamp(1e4), 0, Vec3::ZERO, tilted), 0.6 * far, 1e-6);
    for bandwidth in [0.0, 1.0, 100.0, 1e4] {
        near(
            check(&window(Vec3::Z * 1e4, 0.5, Vec3::Z, bandwidth), 0, Vec3::ZERO, tilted),
            0.6 * far,
            1e-4,
        );
    }
    for bandwidth in [1.0f32, 10.0] {
        let wanted = 0.6 * far * (-0.2 * f64::from(bandwidth)).exp();
        near(
            check(
                &window(Vec3::Z * 1e4, 0.5, Vec3::new(0.6, 0.0, 0.8), bandwidth),
                0,
                Vec3::ZERO,
                tilted,
            ),
            wanted,
            1e-5,
        );
    }
    near(check(&sphere(Vec3::Z * 1e4, 0.5), 0, Vec3::ZERO, tilted), 0.6 * 0.25e-8, 1e-6);
    near(check(&sphere(Vec3::Z * 0.500_001, 0.5), 0, Vec3::ZERO, Vec3::Z), 1.0, 1e-5);
    // Half of all directions above a vertical surface.
    near(check(&sphere(Vec3::Z * 0.500_001, 0.5), 0, Vec3::ZERO, Vec3::X), 0.5, 1e-2);
    let plate = |height: f32| {
        Shape::Lamp(Lamp::Surfels(vec![Surfel {
            point: Vec3::Z * height,
            normal: Vec3::NEG_Z,
            area: 1.0,
        }]))
    };
    near(check(&plate(1e4), 0, Vec3::ZERO, tilted), 0.6 * far, 1e-6);
    near(check(&plate(1e-6), 0, Vec3::ZERO, Vec3::Z), 1.0, 1e-5);
}

#[test]
fn a_tiny_lamp_loses_no_digits_at_any_distance() {
    // A millimeter at 10 km: 1e-14 steradians.
    let lamp = rect(Vec3::Z * 1e4, Vec3::NEG_X * 5e-4, Vec3::Y * 5e-4);
    near(check(&lamp, 0, Vec3::ZERO, Vec3::Z), 1e-14 / PI, 1e-5);
    let e =
        Emitter::new(&window(Vec3::Z * 1e4, 5e-4, Vec3::Z, 1.0)).irradiance(0, Vec3::ZERO, Vec3::Z);
    near(f64::from(e.expect("closed")), 1e-14 / PI, 1e-5);
}

#[test]
fn a_needle_is_a_line() {
    // A strip of 1 m by 1 um at 1 m: width / pi times the integral of (1 + x^2)^-2, which is x / 2
    // (1 + x^2) + atan(x) / 2.
    let line = 0.4 + 0.5f64.atan();
    let wanted = 1e-6 / PI * line;
    near(
        check(&rect(Vec3::Z, Vec3::NEG_X * 0.5, Vec3::Y * 5e-7), 0, Vec3::ZERO, Vec3::Z),
        wanted,
        1e-6,
    );
    let corners = vec![
        Vec3::new(0.5, -5e-7, 1.0),
        Vec3::new(-0.5, -5e-7, 1.0),
        Vec3::new(-0.5, 5e-7, 1.0),
        Vec3::new(0.5, 5e-7, 1.0),
    ];
    let mesh =
        Shape::Lamp(Lamp::Mesh(MeshLamp::without_occlusion(corners, vec![[0, 1, 2], [0, 2, 3]])));
    near(check(&mesh, 0, Vec3::ZERO, Vec3::Z), wanted, 1e-6);
    for bandwidth in [1.0f32, 30.0, 1e3] {
        let lobes = [Lobe { direction: Vec3::new(0.2, 0.0, 1.0).normalize(), bandwidth }; 3];
        let needle = Window { center: Vec3::Z, x: Vec3::NEG_X * 0.5, y: Vec3::Y * 5e-7, lobes };
        let n = 20_000;
        let wanted: f64 = (0..n)
            .map(|i| {
                let place = DVec3::new((f64::from(i) + 0.5) / f64::from(n) - 0.5, 0.0, 1.0);
                let d = lobes[0].direction.as_dvec3();
                let g =
                    (-0.5 * f64::from(bandwidth) * (d - place.normalize()).length_squared()).exp();
                g / place.length_squared().powi(2) * 1e-6 / (PI * f64::from(n))
            })
            .sum();
        near(check(&Shape::Window(needle), 0, Vec3::ZERO, Vec3::Z), wanted, 1e-5);
    }
}

#[test]
fn nothing_from_behind_from_the_edge_or_without_area() {
    let all = |center: Vec3, x: Vec3, y: Vec3| {
        let lobes = [0.0, 30.0, 1e6].map(|bandwidth| Lobe {
            direction: center.try_normalize().unwrap_or(Vec3::Z),
            bandwidth,
        });
        let corners = vec![center - x - y, center + x - y, center + x + y];
        let plate = Surfel {
            point: center,
            normal: x.cross(y).try_normalize().unwrap_or(Vec3::Y),
            area: x.cross(y).length(),
        };
        vec![
            rect(center, x, y),
            Shape::Window(Window { center, x, y, lobes }),
            Shape::Lamp(Lamp::Mesh(MeshLamp::without_occlusion(corners, vec![[0, 1, 2]]))),
            Shape::Lamp(Lamp::Surfels(vec![plate])),
        ]
    };
    for (why, center, x, y) in [
        ("it faces away", Vec3::Z, Vec3::X, Vec3::Y),
        ("it is below the horizon", Vec3::NEG_Z, Vec3::X, Vec3::Y),
        ("the receiver lies on its plane, beside it", Vec3::X * 3.0, Vec3::X, Vec3::Z),
        ("the receiver lies on it", Vec3::ZERO, Vec3::NEG_X, Vec3::Y),
        ("its plane is seen edge on", Vec3::Z, Vec3::X, Vec3::Z * 0.5),
        ("it has no width", Vec3::Z, Vec3::ZERO, Vec3::Y),
        ("it has no area", Vec3::Z, Vec3::X, Vec3::X * 2.0),
        ("it reaches up to the horizon", Vec3::new(2.0, 0.0, -1.0), Vec3::Y, Vec3::NEG_Z),
    ] {
        for shape in all(center, x, y) {
            for lobe in 0..shape.lobes() {
                let e = check(&shape, lobe, Vec3::ZERO, Vec3::Z);
                assert!(e < 1e-15, "{why}: {shape:?} {e}");
            }
        }
    }
    assert_eq!(check(&sphere(Vec3::Z, 0.0), 0, Vec3::ZERO, Vec3::Z), 0.0);
    assert_eq!(check(&sphere(Vec3::NEG_Z * 2.0, 1.0), 0, Vec3::ZERO, Vec3::Z), 0.0);
}

#[test]
fn around_the_receiver() {
    let axes = [Vec3::X, Vec3::Y * 2.0, Vec3::Z * 3.0];
    let from_within = [
        Shape::Lamp(Lamp::Box(BoxLamp { center: Vec3::splat(0.1), axes })),
        sphere(Vec3::splat(0.1), 1.0),
    ];
    for shape in from_within {
        assert_eq!(check(&shape, 0, Vec3::ZERO, Vec3::Y), 0.0, "they shine outwards");
    }
    // A cube that shines inwards is a furnace: 1 in every direction.
    let corners: Vec<Vec3> = (0..8)
        .map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) * 2.0 - 0.9)
        .collect();
    let quads =
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let furnace = Shape::Lamp(Lamp::Mesh(MeshLamp::without_occlusion(corners, triangles)));
    for normal in [Vec3::Y, Vec3::NEG_X, Vec3::new(0.3, -0.8, 0.2).normalize()] {
        near(check(&furnace, 0, Vec3::ZERO, normal), 1.0, 1e-6);
    }
}

#[test]
fn the_part_above_the_horizon_counts() {
    // Through the horizon and across the receiver's plane: the part above alone, exactly.
    let wall = |bottom: f32| {
        rect(Vec3::new(0.0, 2.0, 0.5 * (1.0 + bottom)), Vec3::X, Vec3::Z * 0.5 * (1.0 - bottom))
    };
    let half = check(&wall(0.0), 0, Vec3::ZERO, Vec3::Z);
    for bottom in [-1e-3, -1.0, -100.0] {
        near(check(&wall(bottom), 0, Vec3::ZERO, Vec3::Z), half, 1e-6);
    }
    // Near surfels: the upper half of one whose middle lies on the horizon is not lost.
    let plate =
        |z: f32, area: f32| Surfel { point: Vec3::new(0.0, 0.2, z), normal: Vec3::NEG_Y, area };
    let one = check(&Shape::Lamp(Lamp::Surfels(vec![plate(0.0, 0.04)])), 0, Vec3::ZERO, Vec3::Z);
    let strip = rect(Vec3::new(0.0, 0.2, 0.05), Vec3::X * 0.1, Vec3::Z * 0.05);
    near(one, check(&strip, 0, Vec3::ZERO, Vec3::Z), 0.1);
    let below =
        check(&Shape::Lamp(Lamp::Surfels(vec![plate(-0.11, 0.04)])), 0, Vec3::ZERO, Vec3::Z);
    assert!(below < 0.1 * one, "{below} {one}");
    // A sphere at the horizon, through the receiver's plane, and touching it from below.
    for height in [0.5, 0.2, 1e-6, 0.0, -1e-6, -0.2, -0.499] {
        check(&sphere(Vec3::new(1.0, 0.0, height), 0.5), 0, Vec3::ZERO, Vec3::Z);
    }
    // A window that the receiver's plane cuts, for lobes above, on and below that plane.
    for bandwidth in [0.0, 1.0, 30.0, 1e3, 1e6] {
        for lift in [-0.3, -0.01, 0.0, 0.01, 0.3] {
            check(
                &window(Vec3::Z, 1.0, Vec3::new(0.0, lift, 1.0), bandwidth),
                0,
                Vec3::ZERO,
                Vec3::Y,
            );
        }
    }
}

#[test]
fn scale_does_not_matter() {
    let normal = Vec3::new(0.3, 0.2, 0.9).normalize();
    let shapes = |s: f32| {
        let lobes = [0.5, 40.0, 3e4]
            .map(|bandwidth| Lobe { direction: Vec3::new(0.1, 0.05, 1.0).normalize(), bandwidth });
        vec![
            rect(Vec3::Z * s, Vec3::NEG_X * s, Vec3::Y * 0.5 * s),
            sphere(Vec3::new(0.4, 0.0, 1.0) * s, 0.7 * s),
            Shape::Lamp(Lamp::Box(BoxLamp {
                center: Vec3::new(2.0, 0.5, 1.0) * s,
                axes: [Vec3::X * s, Vec3::Y * s, Vec3::Z * s],
            })),
            Shape::Window(Window {
                center: Vec3::Z * s,
                x: Vec3::NEG_X * s,
                y: Vec3::Y * 0.5 * s,
                lobes,
            }),
        ]
    };
    for (meter, scaled) in [2f32.powi(-40), 2f32.powi(40)]
        .into_iter()
        .flat_map(|s| shapes(1.0).into_iter().zip(shapes(s)))
    {
        for lobe in 0..meter.lobes() {
            near(
                check(&scaled, lobe, Vec3::ZERO, normal),
                check(&meter, lobe, Vec3::ZERO, normal),
                1e-6,
            );
        }
    }
}
