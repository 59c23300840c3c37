//! Variance and cost of each sampling strategy for windows: `cargo bench --bench windows`.
//!
//! Per place and bandwidth: the relative standard deviation of 16 samples for each strategy, the
//! variance of `Best` over that of the better of `Area` and `Lobe`, and the nanoseconds for a
//! receiver and for each sample, last for the closed form. The closed form of a lamp of 128 surfels
//! comes at the end.

use std::time::Instant;

use glam::{Quat, Vec3};
use relight::optics::{Emitter, Lamp, Lobe, Shape, Strategy, Surfel, Window, estimate};

/// Distance of the receiver, its normal, and the target of the lobe in half edges from the window's
/// center.
const PLACES: [(&str, f32, Vec3, [f32; 2]); 8] = [
    ("centred", 1.5, Vec3::Z, [0.0, 0.0]),
    ("off centre", 1.5, Vec3::new(0.0, 1.0, 0.3), [0.5, 0.4]),
    ("on the edge", 1.5, Vec3::new(0.5, 0.0, 1.0), [1.0, 0.3]),
    ("beyond the edge", 1.5, Vec3::Z, [1.2, 0.3]),
    ("near", 0.1, Vec3::new(0.0, 1.0, 0.5), [0.3, 0.2]),
    ("far", 30.0, Vec3::Z, [0.3, 0.2]),
    ("far, on the edge", 30.0, Vec3::Z, [1.0, 0.2]),
    ("grazing", 1.5, Vec3::new(0.0, 1.0, -0.1), [0.0, 0.5]),
];

fn main() {
    println!(
        "{:17}{:>9}{}   Best/min",
        "",
        "",
        Strategy::ALL.map(|s| format!("{:>17}", format!("{s:?}"))).join("")
    );
    for (name, distance, normal, [across, up]) in PLACES {
        let turn = Quat::from_rotation_z(0.4);
        let [x, y] = [turn * Vec3::NEG_X * 0.8, turn * Vec3::Y * 0.6];
        let direction = (Vec3::Z * distance + x * across + y * up).normalize();
        let receiver = (Vec3::ZERO, normal.normalize());
        for bandwidth in [0.0, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6] {
            let lobes = [Lobe { direction, bandwidth }; 3];
            let shape = Shape::Window(Window { center: Vec3::Z * distance, x, y, lobes });
            let emitters = Strategy::ALL.map(|strategy| Emitter::with_strategy(&shape, strategy));
            let exact = f64::from(emitters[0].irradiance(0, receiver.0, receiver.1).unwrap_or(0.0));
            if exact <= 0.0 {
                continue;
            }
            let run = |emitter: &Emitter, each: usize, pixels: u32| {
                let one = |pixel| {
                    (estimate(emitter, 0, receiver, each, 7, pixel).0 / exact - 1.0).powi(2)
                };
                (0..pixels).map(one).sum::<f64>() / f64::from(pixels)
            };
            let variance = emitters.each_ref().map(|emitter| run(emitter, 4, 4000));
            let row = variance.map(|v| format!("{:17.2e}", v.sqrt())).join("");
            println!(
                "{name:17}{bandwidth:9}{row}   {:8.4}",
                variance[6] / variance[0].min(variance[1])
            );
            // The minimum of many short runs, which other work disturbs least.
            let least = |emitter: &Emitter, each: usize, pixels: u32| {
                let time = |_| {
                    let start = Instant::now();
                    std::hint::black_box(run(emitter, each, pixels));
                    start.elapsed().as_nanos() as f64 / f64::from(pixels)
                };
                (0..30).map(time).fold(f64::INFINITY, f64::min)
            };
            let cost = emitters.each_ref().map(|emitter| {
                let (few, many) = (least(emitter, 1, 400), least(emitter, 51, 20));
                let sample = (many - few) / 200.0;
                format!("{:>17}", format!("{:.0} + {sample:.0}", few - 4.0 * sample))
            });
            let closed = closed_form(&emitters[0], receiver);
            println!("{:17}{:>9}{}   {closed:8.0}", "", "ns", cost.join(""));
        }
    }
    let plate = |i: u8| {
        let (sin, cos) = f32::from(i).sin_cos();
        Surfel {
            point: Vec3::new(0.2 * cos, 0.2 * sin, 1.0),
            normal: Vec3::new(-cos, -sin, -1.0).normalize(),
            area: 2e-3,
        }
    };
    let lamp = Emitter::new(&Shape::Lamp(Lamp::Surfels((0..128).map(plate).collect())));
    for height in [0.0, 0.7, 0.95] {
        let ns = closed_form(&lamp, (Vec3::Z * height, Vec3::Z));
        println!("128 surfels at {:.2} m: {ns:.0} ns", 1.0 - height);
    }
}

/// Time in nanoseconds: the minimum of many short runs.
fn closed_form(emitter: &Emitter, (point, normal): (Vec3, Vec3)) -> f64 {
    let time = |_| {
        let start = Instant::now();
        for i in 0..100u8 {
            let nudged = point + Vec3::splat(1e-6 * f32::from(i));
            std::hint::black_box(emitter.irradiance(0, nudged, normal));
        }
        start.elapsed().as_nanos() as f64 / 100.0
    };
    (0..50).map(time).fold(f64::INFINITY, f64::min)
}
