//! Run time of shadowed direct light of three lights in tests/scenes/small (320 x 240) at an error
//! of 1 %.
//!
//! benches/peers/mitsuba_direct.py runs this beside Mitsuba's `direct` integrator on the same
//! triangles and lights:
//!
//! - `direct FOLDER prepare` writes the surface and the lights for both;
//! - `direct run SAMPLES` prints the time and the error as a line of JSON;
//! - without arguments, a table of this renderer alone is printed.
//!
//! The error is the mean absolute error of the sum of the lights as a share of the mean, from two
//! runs with different random numbers, whose difference is sqrt(2) times it. tests/agreement.rs
//! tests for bias.

use std::path::Path;
use std::time::Instant;

use glam::Vec3;
use relight::geometry::{Camera, SceneMesh, surface};
use relight::image::{self, Depth, NamedBytes, Normal, Plane, Points};
use relight::optics::{
    self, Lamp, Lobe, RectLamp, Sampling, ShadowQuality, Shape, SphereLamp, Strategy, Window,
};

/// Two lamps with closed forms out of the picture, and the demo's window two centimeters in front
/// of its pane. Its first lobe, the only one measured, is uniform: Mitsuba does not have other area
/// lights.
fn lights() -> [Shape; 3] {
    let lobe = |bandwidth| Lobe { direction: Vec3::NEG_X, bandwidth };
    let (x, y) = (Vec3::new(0.19208, 0.07372, -0.70041), Vec3::new(0.0, 0.66632, 0.07013));
    let normal = x.cross(y).normalize();
    [
        Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::new(0.7, 0.9, -1.0), radius: 0.12 })),
        Shape::Lamp(Lamp::Rect(RectLamp {
            center: Vec3::new(-0.6, 1.1, -1.6),
            x: Vec3::X * 0.4,
            y: Vec3::Z * 0.3,
        })),
        Shape::Window(Window {
            center: Vec3::new(-2.14265, 0.63961, -4.26194) + 0.02 * normal,
            x,
            y,
            lobes: [lobe(0.0), lobe(0.0), lobe(0.0)],
        }),
    ]
}

struct Room {
    points: Points,
    normal: Normal,
    mesh: SceneMesh,
    outside: Plane<bool>,
}

impl Room {
    fn read() -> Room {
        let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/scenes/small");
        let bytes = |name: &str| {
            std::fs::read(demo.join(name)).expect("tests/scenes/small is part of the project")
        };
        let (depth, _) = image::read_depth(NamedBytes::new("depth", &bytes("depth.exr")))
            .expect("its depth is sound");
        let mask = image::read_mask(NamedBytes::new("mask", &bytes("masks/window_0.png")))
            .expect("its mask is sound");
        let outside = mask.0.map(|share| share > 0.5);
        let (width, height) = depth.size();
        let camera = Camera::from_fov_x(width, height, 64.0);
        let seen = surface(&Depth(depth), &camera);
        let mesh = SceneMesh::new(&seen.points, camera.fx, seen.noise, &outside);
        Room { points: seen.points, normal: seen.normal, mesh, outside }
    }

    /// Shadowed direct shading by one light's first lobe of unit radiance: the measured code.
    fn shade(&self, shape: &Shape, sampling: Sampling) -> Plane<f32> {
        let direct = optics::direct(&self.points, &self.normal, shape, &sampling, &|| false);
        // Mitsuba does not have unknown rays: a ray that passes behind a depth edge is lit.
        let quality = ShadowQuality {
            sampling,
            stride: 1,
            assume_lit: 1.0,
            outside_unknown: false,
            lifted: false,
        };
        let shadow =
            optics::shadow(&self.mesh, &self.points, &self.normal, shape, None, quality, &|| false);
        let products =
            direct.lobes[0].pixels().iter().zip(shadow.lit[0].pixels()).map(|(e, lit)| e * lit);
        Plane::new(self.points.0.width(), self.points.0.height(), products.collect())
    }

    /// Whether each pixel counts.
    fn inside(&self) -> impl Iterator<Item = usize> {
        (0..self.outside.len()).filter(|&i| self.mesh.in_room(i))
    }

    fn mean(&self, plane: &[f32]) -> f64 {
        self.inside().map(|i| f64::from(plane[i])).sum::<f64>() / self.inside().count() as f64
    }
}

/// The lights, and radiances with which each gives a third of a mean of 1.
fn scaled(room: &Room) -> Vec<(Shape, f32)> {
    let radiance = |shape: &Shape| {
        1.0 / (3.0 * room.mean(room.shade(shape, Sampling::fixed(64, 0)).pixels())) as f32
    };
    lights().map(|shape| (shape.clone(), radiance(&shape))).to_vec()
}

/// Writes the surface and the lights for the other renderer.
fn prepare(room: &Room, folder: &Path) {
    let (width, height) = room.points.0.size();
    let vectors = |plane: &Plane<Vec3>| {
        plane.pixels().iter().flat_map(|v| v.to_array()).collect::<Vec<f32>>()
    };
    let write = |name: &str, values: Vec<f32>| {
        std::fs::write(folder.join(name), bytemuck::cast_slice(&values))
            .expect("the folder takes files");
    };
    write("points.f32", vectors(&room.points.0));
    write("normals.f32", vectors(&room.normal.0));
    write("inside.f32", (0..width * height).map(|i| f32::from(room.mesh.in_room(i))).collect());
    write("outside.f32", room.outside.pixels().iter().map(|&out| f32::from(out)).collect());
    let lights: Vec<_> = scaled(room)
        .iter()
        .map(|(shape, radiance)| serde_json::json!({ "shape": shape, "radiance": radiance }))
        .collect();
    let triangles = room.mesh.counts().0;
    let text = serde_json::json!({ "width": width, "height": height, "triangles": triangles, "lights": lights });
    std::fs::write(folder.join("lights.json"), text.to_string()).expect("the folder takes files");
}

/// Processor time of this process in seconds, on systems with /proc: on a busy machine it scatters
/// less than wall time.
fn processor() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> =
        stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    // utime and stime, in hundredths.
    fields
        .get(11..13)
        .map_or(f64::NAN, |times| times.iter().map(|t| t.parse::<f64>().unwrap_or(f64::NAN)).sum())
        / 100.0
}

/// Sampling from an argument: `64` is a fixed number of samples per light, `1%` a target error.
fn sampling(effort: &str, seed: u64) -> Sampling {
    match effort.strip_suffix('%') {
        None => Sampling::fixed(effort.parse().expect("a number of samples"), seed),
        Some(share) => {
            let target = share.parse::<f64>().expect("a number before %") / 100.0;
            Sampling { strategy: Strategy::Best, samples: 8, most: 4096, target, first: 8, seed }
        }
    }
}

/// Wall time and processor time of one run in seconds, and its error.
fn run(room: &Room, lights: &[(Shape, f32)], effort: &str) -> [f64; 3] {
    let (began, before) = (Instant::now(), processor());
    let runs = [1, 2].map(|seed| {
        let mut sum = vec![0.0; room.outside.len()];
        for (shape, radiance) in lights {
            let layer = room.shade(shape, sampling(effort, seed));
            sum.iter_mut().zip(layer.pixels()).for_each(|(sum, v)| *sum += radiance * v);
        }
        sum
    });
    let (seconds, cpu) = (began.elapsed().as_secs_f64() / 2.0, (processor() - before) / 2.0);
    let off: Vec<f32> = runs[0].iter().zip(&runs[1]).map(|(a, b)| (a - b).abs()).collect();
    [seconds, cpu, room.mean(&off) / 2f64.sqrt() / room.mean(&runs[0])]
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let room = Room::read();
    let began = Instant::now();
    room.mesh.surfaces();
    let build = began.elapsed().as_secs_f64();
    match &arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] => {
            println!("hierarchy {build:.3} s");
            let lights = scaled(&room);
            for effort in ["4", "8", "16", "32", "64", "128", "4%", "2%", "1%"] {
                let [seconds, cpu, error] = run(&room, &lights, effort);
                println!(
                    "{effort:>3} a light: {seconds:.3} s, processor {cpu:.2} s, error {:.3} %",
                    100.0 * error
                );
            }
        }
        [folder, "prepare"] => prepare(&room, Path::new(folder)),
        ["run", effort] => {
            let [seconds, cpu, error] = run(&room, &scaled(&room), effort);
            println!(
                "{}",
                serde_json::json!({ "seconds": seconds, "cpu": cpu, "error": error, "build": build })
            );
        }
        _ => panic!("wanted nothing, FOLDER prepare, or run SAMPLES|TARGET%; got {arguments:?}"),
    }
}
