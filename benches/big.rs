//! Run time, memory and bytes of the whole command on a photo of 4000 x 3000 pixels with a lamp, a
//! window and a light out of view: `scenes/demo`, enlarged, with noise of its own. Times are also
//! given as ratios to the decoding and encoding of the same photo as PNG: by the default of the
//! crate `image`, which writes for speed, and by its `CompressionType::Default` with adaptive
//! filters, which is level 6 of zlib, the default of libpng.

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ImageFormat, RgbImage, imageops};

const SIZE: (u32, u32) = (4000, 3000);
const ROUNDS: usize = 5;

/// Seconds of the quickest of some rounds: other work on the machine only ever adds.
fn time(rounds: usize, mut work: impl FnMut(usize)) -> f64 {
    let mut least = f64::MAX;
    for round in 0..rounds {
        let began = Instant::now();
        work(round);
        least = least.min(began.elapsed().as_secs_f64());
    }
    least
}

/// The scene in `folder`.
fn make_scene(folder: &Path) {
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/demo");
    std::fs::create_dir_all(folder.join("masks")).expect("temporary folders take files");
    let enlarge = |path: &str| {
        let picture = image::open(demo.join(path)).expect("the demo has its pictures").to_rgb8();
        imageops::resize(&picture, SIZE.0, SIZE.1, imageops::FilterType::CatmullRom)
    };
    let mut photo = enlarge("photo.jpg");
    // A sensor's noise: two steps of 255, a number of its own for each channel of each pixel.
    let noise =
        |i: usize| (0..4).map(|k| hash(4 * i + k) as f32 / u32::MAX as f32 - 0.5).sum::<f32>();
    for (i, value) in photo.iter_mut().enumerate() {
        *value = (f32::from(*value) + 2.0 * 1.7 * noise(i)).round().clamp(0.0, 255.0) as u8;
    }
    let save = |picture: &RgbImage, path: &str| {
        picture.save(folder.join(path)).expect("temporary folders take files")
    };
    // JPEG, as cameras write it.
    let mut jpeg = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 92);
    encoder.encode_image(&photo).expect("memory takes all bytes");
    std::fs::write(folder.join("photo.jpg"), jpeg).expect("temporary folders take files");
    for mask in ["masks/lamp_0.png", "masks/window_0.png"] {
        save(&enlarge(mask), mask);
    }
    std::fs::copy(demo.join("depth.exr"), folder.join("depth.exr")).expect("the demo has depth");
    let scene = r#"Scene(
        version: 1, photo: "photo.jpg", transfer: Srgb, camera: FovX(64.0),
        depth: (path: "depth.exr", kind: PlanarZ, scale: 1.0),
        lights: { "lamp_0": Lamp(mask: "masks/lamp_0.png"), "window_0": Window(mask: "masks/window_0.png") },
    )"#;
    std::fs::write(folder.join("scene.ron"), scene).expect("temporary folders take files");
}

/// A well-mixed number (Wellons' lowbias32).
fn hash(i: usize) -> u32 {
    let mut x = i as u32;
    x = (x ^ x >> 16).wrapping_mul(0x7feb_352d);
    x = (x ^ x >> 15).wrapping_mul(0x846c_a68b);
    x ^ x >> 16
}

struct Bench {
    folder: PathBuf,
}

impl Bench {
    fn edit(&self, name: &str, change: &str) -> PathBuf {
        let path = self.folder.join(format!("{name}.ron"));
        let text = format!(r#"Edit(version: 1, lights: {{ "lamp_0": {change} }})"#);
        std::fs::write(&path, text).expect("temporary folders take files");
        path
    }

    fn relight(&self, args: &[&str]) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
        command.args(args).current_dir(&self.folder).stdout(Stdio::null()).stderr(Stdio::null());
        let status = command.status().expect("it starts");
        assert!(status.success(), "{command:?}: {status}");
    }

    fn run(&self, edit: &Path, cache: &str, more: &[&str]) {
        let graph = Path::new(env!("CARGO_MANIFEST_DIR")).join("graphs/indoor.ron");
        let (graph, edit) = (graph.to_string_lossy(), edit.to_string_lossy());
        let args = ["run", &graph, &edit, "--scene", "scene", "--out", "out", "--cache", cache];
        self.relight(&[&args, more].concat());
    }

    fn megabytes(&self, path: &str) -> f64 {
        let path = self.folder.join(path);
        let of = |path: &Path| std::fs::metadata(path).map_or(0, |data| data.len());
        let mut folders = vec![path.clone()];
        let mut bytes = if path.is_file() { of(&path) } else { 0 };
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
                match entry.path() {
                    path if path.is_dir() => folders.push(path),
                    path => bytes += of(&path),
                }
            }
        }
        bytes as f64 / 1e6
    }

    /// Largest memory of the last run.
    fn peak(&self) -> f64 {
        let report = std::fs::read(self.folder.join("out/report.json")).expect("the run wrote it");
        let report: serde_json::Value = serde_json::from_slice(&report).expect("it is JSON");
        report["peak_bytes"].as_f64().unwrap_or(f64::NAN) / 1e6
    }
}

fn main() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let bench = Bench { folder: folder.path().to_owned() };
    make_scene(&bench.folder.join("scene"));
    let photo = image::open(bench.folder.join("scene/photo.jpg")).expect("it was made").to_rgb8();
    let mut png = Vec::new();
    photo.write_to(&mut Cursor::new(&mut png), ImageFormat::Png).expect("memory takes all bytes");

    let reference = time(ROUNDS, |_| {
        let photo = image::load_from_memory(&png).expect("it is a PNG");
        let mut file = Cursor::new(Vec::with_capacity(png.len()));
        photo.write_to(&mut file, ImageFormat::Png).expect("memory takes all bytes");
    });
    let zlib = time(ROUNDS, |_| {
        let photo = image::load_from_memory(&png).expect("it is a PNG");
        let file = Cursor::new(Vec::with_capacity(png.len()));
        let (level, filter) = (CompressionType::Default, FilterType::Adaptive);
        photo
            .write_with_encoder(PngEncoder::new_with_quality(file, level, filter))
            .expect("memory takes all bytes");
    });
    println!("decoding and encoding the photo as PNG: {reference:.2} s, by zlib {zlib:.2} s\n");
    println!("{:34} {:>8} {:>8} {:>8} {:>10}", "", "seconds", "ratio", "to zlib", "peak MB");
    let line = |what: &str, seconds: f64, peak: Option<f64>| {
        let peak = peak.map_or(String::new(), |peak| format!("{peak:.0}"));
        let ratios = [reference, zlib].map(|reference| seconds / reference);
        println!("{what:34} {seconds:8.2} {:8.1} {:8.2} {peak:>10}", ratios[0], ratios[1]);
    };
    let none = bench.edit("none", "Scale(1)");
    let cold = time(2, |round| bench.run(&none, &format!("cold_{round}"), &[]));
    line("first run, empty cache", cold, Some(bench.peak()));
    let (cache, layers) = (bench.megabytes("cold_0"), bench.megabytes("out/picture.exr"));
    let mix =
        time(ROUNDS, |_| bench.relight(&["mix", "out", "--set", "lamp_0=0.4", "--out", "mixed"]));
    line("mix to PNG and EXR", mix, None);
    let mix = time(ROUNDS, |_| {
        bench.relight(&["mix", "out", "--set", "lamp_0=0.4", "--out", "mixed.png"]);
    });
    line("mix to PNG", mix, None);
    let edits: Vec<_> = (0..ROUNDS)
        .map(|i| bench.edit(&format!("dim_{i}"), &format!("Scale(0.{})", i + 1)))
        .collect();
    let off = time(ROUNDS, |round| bench.run(&edits[round], "cold_0", &[]));
    line("a light's radiance changed", off, Some(bench.peak()));
    let same = time(ROUNDS, |_| bench.run(&edits[0], "cold_0", &[]));
    line("nothing changed", same, Some(bench.peak()));
    println!("\nMB: picture.exr {layers:.0}, cache after the first run {cache:.0}\n");

    println!("{:34} {:>8} {:>8} {:>10}", "compression of picture.exr", "seconds", "ratio", "MB");
    for compression in ["None", "Rle", "Zips", "Zip", "Piz"] {
        let set = format!("write.compression={compression}");
        let seconds = time(2, |round| bench.run(&edits[round], "cold_0", &["--set", &set]));
        let size = bench.megabytes("out/picture.exr");
        println!("{compression:34} {seconds:8.2} {:8.1} {size:10.0}", seconds / reference);
    }
}
