//! Direct light against Mitsuba 3 and Blender's Cycles, whose results are in tests/reference
//! (README.md there describes their computation).

use std::path::{Path, PathBuf};

use glam::Vec3;
use npyz::NpyFile;
use relight::geometry::SceneMesh;
use relight::image::{Normal, Plane, Points};
use relight::optics::{self, Sampling, ShadowQuality, Shape};
use serde::Deserialize;

#[derive(Deserialize)]
struct Configurations {
    /// Meters from the mesh to the receivers, along their normals.
    lift: f32,
    lights: Vec<Light>,
}

#[derive(Deserialize)]
struct Light {
    name: String,
    shape: Shape,
}

/// Results of a renderer, as stored by `write` of tests/reference/common.py.
struct Renderer {
    name: &'static str,
    results: Vec<Estimate>,
}

#[derive(Deserialize)]
struct Note {
    stderr_of_mean: Vec<f64>,
}

/// Irradiance / pi at the receivers, and how far chance may have moved it.
#[derive(Clone)]
struct Estimate {
    mean: Vec<f64>,
    stderr: Vec<f64>,
    stderr_of_mean: f64,
}

/// The systematic difference allowed beside chance, as a share of the mean. The renderers reckon in
/// single precision and are nearly noiseless: Mitsuba starts shadow rays a third of a millimeter
/// above the receiver, both represent a narrow lobe by tables, and Cycles spreads a receiver over a
/// fifth of a millimeter.
const FLOOR: f64 = 5e-4;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reference").join(name)
}

fn json<T: for<'a> Deserialize<'a>>(name: &str) -> T {
    let text = std::fs::read_to_string(file(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// Shape and numbers of a single-precision array.
fn array(name: &str) -> (Vec<usize>, Vec<f32>) {
    let bytes = std::fs::read(file(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    let npy = NpyFile::new(&bytes[..]).expect("a sound header");
    (npy.shape().iter().map(|&n| n as usize).collect(), npy.into_vec().expect("32-bit numbers"))
}

fn renderer(name: &'static str) -> Renderer {
    let (shape, values) = array(&format!("{name}.npy"));
    let &[_, 2, receivers] = &shape[..] else {
        panic!("{name}: (results, 2, receivers), got {shape:?}")
    };
    let numbers = |part: &[f32]| part.iter().map(|&v| f64::from(v)).collect();
    let note: Note = json(&format!("{name}.json"));
    let results =
        values.chunks(2 * receivers).zip(&note.stderr_of_mean).map(|(part, &stderr_of_mean)| {
            Estimate {
                mean: numbers(&part[..receivers]),
                stderr: numbers(&part[receivers..]),
                stderr_of_mean,
            }
        });
    Renderer { name, results: results.collect() }
}

/// Receivers and the mesh below them.
struct Room {
    mesh: SceneMesh,
    receivers: Points,
    normal: Normal,
}

fn room(lift: f32) -> Room {
    let (shape, values) = array("surface.npy");
    let &[2, height, width, 3] = &shape[..] else { panic!("(2, height, width, 3), got {shape:?}") };
    let vectors: Vec<Vec3> = values.chunks(3).map(Vec3::from_slice).collect();
    let (points, normals) = vectors.split_at(width * height);
    let receivers = points.iter().zip(normals).map(|(&p, &n)| p + n * lift).collect();
    let points = Points(Plane::new(width, height, points.to_vec()));
    // The offset of shadow rays is a choice about surfaces that are known as depth. Here the
    // triangles are the surface, so a focal length is given that makes it 15 micrometers.
    let mesh = SceneMesh::new(&points, 1e5, 0.0, &Plane::filled(width, height, false));
    assert_eq!(
        mesh.counts(),
        (2 * (width - 1) * (height - 1), 0),
        "no curtain: all renderers see the same triangles"
    );
    Room {
        mesh,
        receivers: Points(Plane::new(width, height, receivers)),
        normal: Normal(Plane::new(width, height, normals.to_vec())),
    }
}

/// Direct shading of each lobe, open and blocked by the mesh. Only this function calls the tested
/// code.
fn shade(room: &Room, shape: &Shape, samples: usize, seed: u64) -> Vec<[Vec<f64>; 2]> {
    let sampling = Sampling::fixed(samples, seed);
    let direct = optics::direct(&room.receivers, &room.normal, shape, &sampling, &|| false);
    let quality = ShadowQuality {
        sampling,
        stride: 1,
        assume_lit: 0.0,
        outside_unknown: false,
        lifted: false,
    };
    let shadow =
        optics::shadow(&room.mesh, &room.receivers, &room.normal, shape, None, quality, &|| false);
    let both = direct.lobes.iter().zip(&shadow.lit).map(|(e, lit)| {
        let open: Vec<f64> = e.pixels().iter().map(|&e| f64::from(e)).collect();
        let blocked = open.iter().zip(lit.pixels()).map(|(e, &lit)| e * f64::from(lit)).collect();
        [open, blocked]
    });
    both.collect()
}

/// As `shade`, with the standard errors that several seeds show; results in the order of the stored
/// ones.
fn ours(room: &Room, shape: &Shape) -> Vec<Estimate> {
    const SEEDS: usize = 4;
    let runs: Vec<_> = (0..SEEDS as u64).map(|seed| shade(room, shape, 256, seed)).collect();
    let estimate = |lobe: usize, blocked: usize| {
        let receivers = runs[0][lobe][blocked].len();
        let value = |run: usize, i: usize| runs[run][lobe][blocked][i];
        let mean: Vec<f64> = (0..receivers)
            .map(|i| (0..SEEDS).map(|r| value(r, i)).sum::<f64>() / SEEDS as f64)
            .collect();
        let spread = |i: usize| (0..SEEDS).map(|r| (value(r, i) - mean[i]).powi(2)).sum::<f64>();
        let stderr: Vec<f64> =
            (0..receivers).map(|i| (spread(i) / (SEEDS * (SEEDS - 1)) as f64).sqrt()).collect();
        // Receivers draw independent random numbers.
        let stderr_of_mean = stderr.iter().map(|e| e * e).sum::<f64>().sqrt() / receivers as f64;
        Estimate { mean, stderr, stderr_of_mean }
    };
    (0..shape.lobes()).flat_map(|lobe| [0, 1].map(|blocked| estimate(lobe, blocked))).collect()
}

/// The difference between two estimates of the same light.
struct Difference {
    /// Mean absolute difference as a share of the mean, less the noise.
    relative: f64,
    /// Difference of the means as a share of the mean.
    bias: f64,
    /// The same in standard errors, `FLOOR` included.
    z: f64,
}

fn difference(ours: &Estimate, theirs: &Estimate) -> Difference {
    assert_eq!(ours.mean.len(), theirs.mean.len());
    let count = ours.mean.len() as f64;
    let mean = theirs.mean.iter().sum::<f64>() / count;
    let off = ours.mean.iter().zip(&theirs.mean).map(|(a, b)| (a - b).abs()).sum::<f64>() / count;
    // The mean absolute value of a normal variable is sqrt(2 / pi) standard deviations.
    let chance = ours.stderr.iter().zip(&theirs.stderr).map(|(a, b)| a.hypot(*b)).sum::<f64>()
        / count
        * std::f64::consts::FRAC_2_PI.sqrt();
    let bias = ours.mean.iter().sum::<f64>() / count - mean;
    let error = ours.stderr_of_mean.hypot(theirs.stderr_of_mean).hypot(FLOOR * mean);
    Difference { relative: (off - chance) / mean, bias: bias / mean, z: bias / error }
}

#[test]
fn two_other_renderers_see_the_same_direct_light() {
    let configurations: Configurations = json("configurations.json");
    let renderers = ["mitsuba", "cycles"].map(renderer);
    let room = room(configurations.lift);
    let (mut next, mut faults, mut shadows) = (0, Vec::new(), 0);
    println!(
        "{:45} {:>9}  | {:^27} | {:^27}",
        "", "mean", "Mitsuba: off, bias, z", "Cycles: off, bias, z"
    );
    for light in &configurations.lights {
        let ours = ours(&room, &light.shape);
        for (i, ours) in ours.iter().enumerate() {
            let lobe = match &light.shape {
                Shape::Window(window) => format!(" {:.0e}", window.lobes[i / 2].bandwidth),
                _ => String::new(),
            };
            let name = format!("{}{lobe}{}", light.name, if i % 2 == 0 { "" } else { ", blocked" });
            let mut line = format!(
                "{name:45} {:9.3e} ",
                ours.mean.iter().sum::<f64>() / ours.mean.len() as f64
            );
            for renderer in &renderers {
                let Difference { relative, bias, z } = difference(ours, &renderer.results[next]);
                line += &format!(" | {:7.3} % {:+7.3} % {z:+5.1}", 100.0 * relative, 100.0 * bias);
                // 4 standard errors: 1 % chance of one false alarm in all of the about 120
                // comparisons.
                if relative > 5e-3 || z.abs() > 4.0 {
                    faults.push(format!("{name}, {}: {relative:.2e} off, z {z:.1}", renderer.name));
                }
            }
            println!("{line}");
            next += 1;
        }
        let sum = |e: &Estimate| e.mean.iter().sum::<f64>();
        shadows += usize::from(ours.chunks(2).any(|both| sum(&both[1]) < 0.97 * sum(&both[0])));
    }
    assert!(
        renderers.iter().all(|r| r.results.len() == next),
        "as many results as the configurations have"
    );
    assert!(shadows >= 8, "only {shadows} lights lose 3 % or more to shadows");
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
}

#[test]
fn a_planted_error_is_seen() {
    let theirs = &renderer("mitsuba").results[1];
    let scaled =
        |by: f64| Estimate { mean: theirs.mean.iter().map(|v| v * by).collect(), ..theirs.clone() };
    let small = difference(&scaled(1.003), theirs);
    assert!(small.z > 4.0 && small.relative < 5e-3, "0.3 % is a bias: {}", small.z);
    // Half of the receivers up, half down: no bias, and yet wrong.
    let mut crossed = theirs.clone();
    crossed
        .mean
        .iter_mut()
        .enumerate()
        .for_each(|(i, v)| *v *= if i % 2 == 0 { 1.01 } else { 0.99 });
    assert!(difference(&crossed, theirs).relative > 5e-3);
}
