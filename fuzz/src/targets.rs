//! The bodies of the fuzz targets: bytes of a stranger into each reader. An error is a fine answer;
//! a panic, more memory than the fuzzer allows, or no end is not. `tests/fuzz_corpus.rs` replays
//! the corpora through the same bodies.

#![allow(dead_code, reason = "each fuzz target uses one of them")]

use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex};

use relight::files::{EditFile, draw, edit, scene};
use relight::geometry::{Model, named_files};
use relight::graph::{
    CacheFolder, CacheKey, Context, Diagnostic, DiskCache, File, GraphFile, Node, Overlay, Registry,
};
use relight::image::{self, Transfer};
use relight::nodes::output::mix_layers::{MixLayers, MixLayersIn};
use relight::nodes::output::write_report::{WriteReport, WriteReportIn};
use relight::optics::PhotometricWebTable;

static REGISTRY: LazyLock<Registry> = LazyLock::new(relight::nodes::registry);
/// The folder of the files for readers that need paths.
static FOLDER: LazyLock<tempfile::TempDir> =
    LazyLock::new(|| tempfile::tempdir().expect("a folder can be made"));
/// Tests run at once, and share the folder.
static ONE: Mutex<()> = Mutex::new(());

/// A file of these bytes.
fn file(name: &str, bytes: &[u8]) -> PathBuf {
    let path = FOLDER.path().join(name);
    std::fs::create_dir_all(path.parent().expect("it lies in a folder"))
        .expect("a folder can be made");
    std::fs::write(&path, bytes).expect("a file can be written");
    path
}

fn check_faults(faults: &[Diagnostic]) {
    draw(faults, false);
}

pub fn pictures(bytes: &[u8]) {
    let source = image::NamedBytes::new("photo", bytes);
    let _ = image::read_photo(source, Transfer::Srgb);
    let _ = image::Texture::read(source, 64 << 20);
}

/// Depth, masks, normals and maps of a sky.
pub fn planes(bytes: &[u8]) {
    let source = image::NamedBytes::new("plane", bytes);
    let _ = image::read_depth(source);
    let _ = image::read_mask(source);
    let _ = image::read_normal(source);
    let _ = image::read_maps(source, [16, 32]);
}

/// A model and the files that it names: pieces of the input between bytes of zero, used in order.
fn model(name: &str, pieces: &[&[u8]]) {
    let (main, others) = pieces.split_first().expect("a split gives at least one piece");
    let other = |at: usize| others.get(at % others.len().max(1)).map(|bytes| bytes.to_vec());
    named_files(name, || Some(main.to_vec()), &|name| other(name.len()));
    let mut asked = 0;
    let read = Model::read(name, main, &mut |name| {
        asked += 1;
        other(asked - 1).ok_or_else(|| format!("no {name}"))
    });
    if let Ok(model) = read {
        let (low, high) = model.bounds();
        assert!(low.is_finite() && high.is_finite(), "{low} {high}");
        for skin in &model.skins {
            skin.at(glam::Vec2::new(0.3, 1.7));
        }
    }
}

pub fn ply(bytes: &[u8]) {
    model("a.ply", &[bytes]);
}

pub fn obj(bytes: &[u8]) {
    model("a.obj", &bytes.split(|&byte| byte == 0).collect::<Vec<_>>());
}

/// A GLB is one piece.
pub fn gltf(bytes: &[u8]) {
    if bytes.starts_with(b"glTF") {
        model("a.glb", &[bytes]);
    } else {
        // The files are binary: the first zero ends the JSON, and all others get the rest.
        model("a.gltf", &bytes.splitn(2, |&byte| byte == 0).collect::<Vec<_>>());
    }
}

pub fn ies(bytes: &[u8]) {
    if let Ok((table, lumens)) = PhotometricWebTable::parse(&String::from_utf8_lossy(bytes)) {
        assert!(lumens.is_finite() && table.bytes() < 1 << 26);
    }
}

pub fn graph(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let source = relight::graph::Source::new("/nowhere/graph.ron", text);
    match GraphFile::parse(source).and_then(|graph| graph.resolve(&REGISTRY, &Overlay::default())) {
        Ok(_) => {}
        Err(faults) => check_faults(&faults),
    }
}

pub fn scene(bytes: &[u8]) {
    let _one = ONE.lock();
    let path = file("scene/scene.ron", bytes);
    let folder = path.parent().unwrap_or(Path::new(""));
    if let Err(faults) = scene::read(folder, Some(&["ReadScene"])) {
        check_faults(&faults);
    }
    let _ = scene::truth(folder);
}

pub fn edit(bytes: &[u8]) {
    let _one = ONE.lock();
    let path = file("edit/edit.ron", bytes);
    match EditFile::read(&path) {
        Ok(text) => {
            for frame in [0, text.frames().unwrap_or(1) - 1] {
                if let Err(faults) = edit::frame(&text, frame, None, None) {
                    check_faults(&faults);
                }
            }
        }
        Err(faults) => check_faults(&faults),
    }
}

/// Stored values of all types that travel on wires: the first byte chooses the type.
pub fn values(bytes: &[u8]) {
    static TYPES: LazyLock<Vec<&str>> = LazyLock::new(|| REGISTRY.types().into_iter().collect());
    let Some((&first, rest)) = bytes.split_first() else { return };
    let name = TYPES[usize::from(first) % TYPES.len()];
    let _ = REGISTRY.decode(name, rest).expect("a stage gives this type");
}

/// An entry of the cache as it stands; after a first byte that is odd, the header of one, with a
/// sound checksum and signature.
pub fn entries(bytes: &[u8]) {
    let _one = ONE.lock();
    let key = CacheKey::new(b"fuzz");
    let cache = DiskCache::new(CacheFolder::new(FOLDER.path().join("cache"), key.clone()));
    cache.make().expect("a folder can be made");
    let name = format!("cache/entries/ab/{:062}", 0);
    match bytes.split_first() {
        Some((first, header)) if first % 2 == 1 => {
            let length = (header.len() as u64).to_le_bytes();
            let (checksum, signature) = (blake3::hash(header), key.sign(header));
            let parts = [
                &b"NODE\0\0\0\x02"[..],
                &length,
                checksum.as_bytes(),
                signature.as_bytes(),
                header,
            ];
            file(&name, &parts.concat())
        }
        _ => file(&name, bytes),
    };
    let _ = cache.stat();
    let _ = cache.verify();
}

/// The check of a network before a loader reads it.
pub fn networks(bytes: &[u8]) {
    let _ = relight::net::precheck(bytes);
}

/// `picture.exr` and, after the last zero, `report.json`, as `relight report` and `relight mix`
/// read them.
pub fn report(bytes: &[u8]) {
    let _one = ONE.lock();
    let (layers, report) = match bytes.iter().rposition(|&byte| byte == 0) {
        Some(at) => (&bytes[..at], &bytes[at + 1..]),
        None => (bytes, &b"{}"[..]),
    };
    let layers = File::new(file("run/picture.exr", layers).to_string_lossy());
    let report = File::new(file("run/report.json", report).to_string_lossy());
    let _ = MixLayers { layers: layers.clone(), ..MixLayers::default() }
        .run(MixLayersIn {}, &Context::default());
    let _ = WriteReport { layers, report, ..WriteReport::default() }
        .run(WriteReportIn {}, &Context::default());
}
