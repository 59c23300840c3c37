//! Replays the corpora of `fuzz/` through the bodies of the fuzz targets: inputs that once failed
//! stay fixed, on the stable compiler.

use std::path::{Path, PathBuf};

#[path = "../fuzz/src/targets.rs"]
mod targets;

/// Most memory of the whole replay, in bytes; it detects a target that allocates as much as a small
/// file claims.
const MOST: u64 = 1_500_000_000;

fn corpus(target: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target);
    let entries =
        std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut files: Vec<PathBuf> =
        entries.map(|entry| entry.expect("it can be listed").path()).collect();
    files.sort();
    files
}

fn replay(target: &str, run: fn(&[u8])) {
    let files = corpus(target);
    assert!(!files.is_empty(), "fuzz/corpus/{target} is empty");
    for path in files {
        println!("{}", path.display());
        run(&std::fs::read(&path).expect("it can be read"));
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let mark =
            status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB"));
        let peak =
            mark.map_or(0, |kilobytes| 1024 * kilobytes.parse::<u64>().expect("it is a number"));
        assert!(peak < MOST, "{}: {peak} bytes of memory", path.display());
    }
}

macro_rules! replays {
    ($($target:ident),* $(,)?) => {
        /// All targets, as fuzz/Cargo.toml must list them.
        const TARGETS: &[&str] = &[$(stringify!($target)),*];

        $(#[test]
        fn $target() {
            replay(stringify!($target), targets::$target);
        })*
    };
}

replays!(
    pictures, planes, ply, obj, gltf, ies, graph, scene, edit, values, entries, report, networks
);

#[test]
fn every_target_is_fuzzed_and_replayed() {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/Cargo.toml");
    let text = std::fs::read_to_string(manifest).expect("it can be read");
    let names =
        text.split("[[bin]]").skip(1).map(|bin| bin.split('"').nth(1).expect("it has a name"));
    assert_eq!(names.collect::<Vec<_>>(), TARGETS);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    let mut corpora: Vec<String> = std::fs::read_dir(folder)
        .expect("the corpora are there")
        .map(|entry| {
            entry.expect("it can be listed").file_name().into_string().expect("our names are ASCII")
        })
        .collect();
    corpora.sort();
    let mut targets = TARGETS.to_vec();
    targets.sort_unstable();
    assert_eq!(corpora, targets);
    let bytes: u64 = TARGETS
        .iter()
        .flat_map(|target| corpus(target))
        .map(|path| path.metadata().expect("it is there").len())
        .sum();
    assert!(bytes < 300_000, "{bytes} bytes of corpora");
}

/// Writes sound pictures and values, where fuzzing starts:
/// `cargo test --release --test fuzz_corpus -- --ignored write_seeds`.
#[test]
#[ignore = "writes into fuzz/corpus"]
fn write_seeds() {
    use glam::Vec3;
    use relight::image::{Compression, ExrLayers, Plane};
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    let write = |target: &str, name: &str, bytes: &[u8]| {
        std::fs::create_dir_all(folder.join(target)).expect("a folder can be made");
        std::fs::write(folder.join(target).join(name), bytes).expect("a file can be written");
    };
    let rgb =
        image::RgbImage::from_fn(9, 7, |x, y| image::Rgb([(20 * x) as u8, (30 * y) as u8, 90]));
    let kinds = [
        ("rgb8.png", image::DynamicImage::ImageRgb8(rgb.clone()), image::ImageFormat::Png),
        (
            "rgba8.png",
            image::DynamicImage::ImageRgb8(rgb.clone()).into_rgba8().into(),
            image::ImageFormat::Png,
        ),
        (
            "grey16.png",
            image::DynamicImage::ImageRgb8(rgb.clone()).into_luma16().into(),
            image::ImageFormat::Png,
        ),
        (
            "rgb16.png",
            image::DynamicImage::ImageRgb8(rgb.clone()).into_rgb16().into(),
            image::ImageFormat::Png,
        ),
        ("rgb.jpg", image::DynamicImage::ImageRgb8(rgb.clone()), image::ImageFormat::Jpeg),
        (
            "rgb.hdr",
            image::DynamicImage::ImageRgb8(rgb).into_rgb32f().into(),
            image::ImageFormat::Hdr,
        ),
    ];
    for (name, image, format) in kinds {
        let mut bytes = std::io::Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).expect("it can be written");
        ["pictures", "planes"].iter().for_each(|target| write(target, name, bytes.get_ref()));
    }
    let plane = Plane::from_fn(9, 7, |x, y| Vec3::new(x as f32, y as f32, 0.5));
    for (name, compression) in
        [("none", Compression::None), ("rle", Compression::Rle), ("zip", Compression::Zip)]
    {
        let mut file = ExrLayers::new(9, 7);
        file.float_rgb("", &plane);
        file.half("Z", &plane.map(|c| c.x));
        let bytes = file.write(compression).expect("it can be written");
        ["pictures", "planes"]
            .iter()
            .for_each(|target| write(target, &format!("{name}.exr"), &bytes));
    }
    let numbers: Vec<u8> = (0..63).flat_map(|i| (i as f32).to_le_bytes()).collect();
    let header =
        format!("{:<117}\n", "{'descr': '<f4', 'fortran_order': False, 'shape': (7, 9), }");
    write(
        "planes",
        "f4.npy",
        &[b"\x93NUMPY\x01\x00\x76\x00", header.as_bytes(), &numbers].concat(),
    );
    let albedo = postcard::to_stdvec(&relight::image::Albedo(plane)).expect("it can be encoded");
    write("values", "albedo", &[&[0], &albedo[..]].concat());
}
