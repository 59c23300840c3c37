//! Real photographs of ../shared/data/photos under edits: properties that hold for all of them, and
//! visible changes.
//!
//! `cargo test --release --test photos -- --ignored sheets` writes contact sheets, before and
//! after, to target/photos/ to look at.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use exr::prelude::read_all_flat_layers_from_file;
use image::{GrayImage, RgbImage, imageops};
use needs::needs;

/// A photograph, and where in it things stand; pixels of the photo.
struct Photo {
    name: &'static str,
    /// Visible lights.
    lit: &'static [&'static str],
    /// Foot of an inserted globe.
    globe: [u32; 2],
    /// Corners of an inserted window.
    window: [[u32; 2]; 4],
    /// Regions that must become visibly darker: (edit, x, y, half size, largest fraction of their
    /// light that they may keep).
    near: &'static [(&'static str, u32, u32, u32, f64)],
}

const PHOTOS: &[Photo] = &[
    Photo {
        name: "bedroom",
        lit: &["lamp_0"],
        globe: [92, 192],
        window: [[222, 30], [260, 30], [260, 95], [222, 95]],
        near: &[("lamp_0_off", 232, 112, 8, 0.75), ("invisible_off", 60, 200, 15, 0.4)],
    },
    Photo {
        name: "nyu_0996",
        lit: &["lamp_0", "lamp_1"],
        globe: [130, 340],
        window: [[170, 60], [330, 60], [330, 180], [170, 180]],
        near: &[("lamp_0_off", 530, 130, 15, 0.95), ("lamp_0_off", 440, 165, 10, 0.6)],
    },
    Photo {
        name: "nyu_0579",
        lit: &["lamp_0", "lamp_1", "window_0"],
        globe: [280, 385],
        window: [[80, 40], [130, 45], [130, 152], [80, 152]],
        // The fit gives most of the wall beside the lamp to a lamp out of view: a viewer would
        // expect less.
        near: &[("window_0_off", 370, 310, 20, 0.9), ("lamp_0_off", 80, 200, 10, 0.95)],
    },
    Photo {
        name: "nyu_0189",
        lit: &["lamp_0"],
        globe: [180, 370],
        window: [[270, 50], [340, 55], [340, 140], [270, 140]],
        near: &[("lamp_0_off", 410, 200, 12, 0.6)],
    },
    Photo {
        name: "nyu_0958",
        lit: &["lamp_0", "lamp_1", "lamp_2", "lamp_3"],
        globe: [120, 340],
        window: [[170, 50], [225, 45], [225, 110], [170, 110]],
        near: &[("visible_off", 530, 130, 15, 0.5), ("visible_off", 400, 290, 10, 0.5)],
    },
    Photo {
        name: "nyu_0987",
        lit: &["lamp_0"],
        globe: [325, 275],
        window: [[80, 40], [230, 40], [230, 130], [80, 130]],
        near: &[("lamp_0_off", 570, 300, 10, 0.8)],
    },
    Photo {
        name: "nyu_1070",
        lit: &["lamp_0", "lamp_1", "lamp_2"],
        globe: [210, 385],
        window: [[395, 55], [500, 65], [500, 160], [395, 150]],
        near: &[("lamp_0_off", 30, 90, 12, 0.5)],
    },
    Photo {
        name: "sunlit",
        lit: &[],
        globe: [560, 425],
        window: [[330, 30], [430, 30], [430, 95], [330, 95]],
        near: &[],
    },
];

fn data() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/photos")
}

/// A scene folder in a temporary folder, with a cache of its own.
struct Room {
    folder: tempfile::TempDir,
    photo: &'static Photo,
    before: RgbImage,
    masks: BTreeMap<String, GrayImage>,
}

impl Room {
    /// Writes scene.ron from about.json and the masks that lie there.
    fn new(data: &Path, photo: &'static Photo) -> Room {
        let source = data.join(photo.name).canonicalize().expect("the photo's folder is there");
        let about =
            std::fs::read_to_string(source.join("about.json")).expect("about.json can be read");
        let about: serde_json::Value = serde_json::from_str(&about).expect("about.json is sound");
        let number =
            |key: &str| about[key].as_f64().unwrap_or_else(|| panic!("about.json gives {key}"));
        let camera = match about["fov_x_deg"].as_f64() {
            Some(degrees) => format!("FovX({degrees})"),
            None => {
                let [fx, fy, cx, cy] = ["fx", "fy", "cx", "cy"].map(number);
                format!("Pinhole(fx: {fx}, fy: {fy}, cx: {cx}, cy: {cy})")
            }
        };
        let transfer = if about["transfer"] == "gamma 2.2" { "Gamma(2.2)" } else { "Srgb" };
        let path = |name: &str| format!("{:?}", source.join(name));
        let mut lights = String::new();
        let mut masks = BTreeMap::new();
        for id in photo.lit {
            let kind = if id.starts_with("lamp") { "Lamp" } else { "Window" };
            let mask = format!("masks/{id}.png");
            write!(lights, "{id:?}: {kind}(mask: {}), ", path(&mask)).expect("text can grow");
            masks.insert(
                id.to_string(),
                image::open(source.join(&mask)).expect("a mask can be read").into_luma8(),
            );
        }
        let ignore = source.join("masks/outside.png");
        let ignore = if ignore.is_file() { format!("ignore: {ignore:?},") } else { String::new() };
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let scene = format!(
            "Scene(version: 1, photo: {}, transfer: {transfer}, camera: {camera}, depth: (path: {}), \
             lights: {{{lights}}}, {ignore})",
            path("photo.png"),
            path("depth.exr"),
        );
        std::fs::write(folder.path().join("scene.ron"), scene).expect("a file can be written");
        let before =
            image::open(source.join("photo.png")).expect("the photo can be read").into_rgb8();
        Room { folder, photo, before, masks }
    }

    /// Runs the program with these `lights`; exit status 0, a picture of the photo's size.
    fn relight(&self, edit: &str, lights: &str) -> Relit {
        let at = |name: &str| self.folder.path().join(name);
        let (file, out) = (at(&format!("{edit}.ron")), at(edit));
        std::fs::write(&file, format!("Edit(version: 1, lights: {{{lights}}})"))
            .expect("a file can be written");
        let graph = Path::new(env!("CARGO_MANIFEST_DIR")).join("graphs/physics.ron");
        let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
        command.arg("run").arg(graph).arg(file).arg("--scene").arg(self.folder.path());
        command
            .arg("--cache")
            .arg(at("cache"))
            .arg("--out")
            .arg(&out)
            .env_remove("RELIGHT_LOG")
            .env("HOME", at("home"));
        let output = command.output().expect("the program starts");
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{} {edit}: {message}", self.photo.name);
        let picture =
            image::open(out.join("picture.png")).expect("the picture can be read").into_rgb8();
        assert_eq!(picture.dimensions(), self.before.dimensions(), "{} {edit}", self.photo.name);
        Relit { picture, layers: out.join("picture.exr"), message }
    }

    /// The edits of this photo: name, `lights`, and the part of the picture to look at closely.
    fn edits(&self) -> Vec<(String, String, [u32; 4])> {
        let Photo { lit, globe: [gx, gy], window, .. } = self.photo;
        let mut edits = Vec::new();
        let all: String = lit.iter().map(|id| format!("{id:?}: Off, ")).collect();
        for id in *lit {
            let around = around(
                self.masks[*id].enumerate_pixels().filter(|p| p.2.0[0] > 127).map(|p| [p.0, p.1]),
            );
            edits.push((format!("{id}_off"), format!("{id:?}: Off"), around));
            if *id == lit[0] {
                edits.push((format!("{id}_cold"), format!("{id:?}: Temperature(9000)"), around));
            }
        }
        let whole = [0, 0, self.before.width(), self.before.height()];
        if lit.len() > 1 {
            edits.push(("visible_off".into(), all, whole));
        }
        edits.push(("invisible_off".into(), r#""inv_lamp": Off, "inv_window": Off"#.into(), whole));
        let foot = around([[*gx, *gy]; 1].into_iter());
        edits.push((
            "globe".into(),
            format!(
                r#""globe": Lamp(shape: Sphere(radius: 0.08), at: Pixel(x: {gx}, y: {gy}), flux: 800, temperature: 2700)"#
            ),
            foot,
        ));
        edits.push((
            "tube".into(),
            format!(
                r#""tube": Lamp(shape: Box(half: (0.05, 0.2, 0.05), yaw: 30), at: Pixel(x: {gx}, y: {gy}), radiance: (2, 6, 4))"#
            ),
            foot,
        ));
        let corners: Vec<String> = window.iter().map(|[x, y]| format!("({x}, {y})")).collect();
        let corners = corners.join(", ");
        edits.push((
            "window".into(),
            format!(r#""east": Window(corners: [{corners}], sky: Radiance(4, 4.5, 5))"#),
            around(window.iter().copied()),
        ));
        edits
    }
}

/// A rectangle twice as large as the bounding box of `pixels`, at least 120 wide: x0, y0, x1, y1.
fn around(pixels: impl Iterator<Item = [u32; 2]>) -> [u32; 4] {
    let empty = [u32::MAX, u32::MAX, 0, 0];
    let [x0, y0, x1, y1] =
        pixels.fold(empty, |[a, b, c, d], [x, y]| [a.min(x), b.min(y), c.max(x), d.max(y)]);
    let half = (x1 - x0).max((y1 - y0) * 4 / 3).max(60);
    let (x, y) = ((x0 + x1) / 2, (y0 + y1) / 2);
    [x.saturating_sub(half), y.saturating_sub(half * 3 / 4), x + half, y + half * 3 / 4]
}

struct Relit {
    picture: RgbImage,
    layers: PathBuf,
    message: String,
}

/// Mean linear luminance of the picture within `half` of (x, y).
fn shown(picture: &RgbImage, [x, y]: [u32; 2], half: u32) -> f64 {
    let place = (y - half..y + half).flat_map(|y| (x - half..x + half).map(move |x| (x, y)));
    let linear = |v: u8| (f64::from(v) / 255.0).powf(2.2);
    let luminance =
        |[r, g, b]: [u8; 3]| 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
    place.map(|(x, y)| luminance(picture.get_pixel(x, y).0)).sum::<f64>()
        / f64::from(4 * half * half)
}

/// Lowest level of 255 of the shoulder of saturation, 0.8 in linear light: the camera compressed
/// the light of such channels, and the picture may show more of it, up to white.
const SHOULDER: u8 = 230;

/// Number of pixels, among those that `counts`, that `differ` in a channel (before, after).
/// Saturated channels may have any value above that of the photo.
fn count(
    room: &Room,
    relit: &Relit,
    counts: impl Fn(u32, u32) -> bool,
    differ: impl Fn(i32, i32) -> bool,
) -> usize {
    let pairs = room
        .before
        .enumerate_pixels()
        .zip(relit.picture.pixels())
        .filter(|((x, y, _), _)| counts(*x, *y));
    pairs
        .filter(|((_, _, a), b)| {
            a.0.iter().zip(b.0).any(|(&a, b)| {
                let saturated = a >= SHOULDER && b >= a || a.min(b) >= 250;
                !saturated && differ(i32::from(a), i32::from(b))
            })
        })
        .count()
}

/// Every channel is finite, and the light layers and the rest sum to the picture within the
/// rounding of halves: one half-step (4.9e-4) for the picture and one for each layer of a sum of
/// non-negative terms.
fn check_layers(name: &str, relit: &Relit) {
    let file = read_all_flat_layers_from_file(&relit.layers).expect("the layers can be read");
    let channels: BTreeMap<String, Vec<f32>> = file.layer_data[0]
        .channel_data
        .list
        .iter()
        .map(|channel| (channel.name.to_string(), channel.sample_data.values_as_f32().collect()))
        .collect();
    for (channel, values) in &channels {
        assert!(values.iter().all(|v| v.is_finite()), "{name}: {channel} is not finite");
    }
    for c in ["R", "G", "B"] {
        let mut sum = vec![0.0; channels[c].len()];
        for (_, layer) in channels
            .iter()
            .filter(|(n, _)| n.starts_with("light_") && n.ends_with(&format!(".{c}")))
        {
            sum.iter_mut().zip(layer).for_each(|(sum, v)| *sum += v);
        }
        let off = sum
            .iter()
            .zip(&channels[c])
            .map(|(sum, v)| (sum - v).abs() / (v.abs() + 1e-3))
            .fold(0.0, f32::max);
        assert!(off < 1e-3, "{name}: the layers' {c} differs from the picture by {off}");
    }
}

#[needs("../shared/data/photos")]
#[test]
fn photos_are_relit_soundly() {
    let mut faults = Vec::new();
    for (i, photo) in PHOTOS.iter().enumerate() {
        let room = Room::new(&data(), photo);
        let same = room.relight("none", "");
        let changed = count(&room, &same, |_, _| true, |a, b| (a - b).abs() > 1);
        assert_eq!(changed, 0, "{}: an edit that says nothing changes pixels", photo.name);
        check_layers(photo.name, &same);
        // All kinds of edit on half of the photos; on the others the edits with expected regions,
        // and a lamp.
        let tried = |edit: &str| match i < PHOTOS.len() / 2 {
            true => edit != "tube" && edit != "lamp_1_off",
            false => edit == "globe" || photo.near.iter().any(|near| near.0 == edit),
        };
        for (edit, lights, _) in room.edits().into_iter().filter(|edit| tried(&edit.0)) {
            let name = format!("{} {edit}", photo.name);
            let relit = room.relight(&edit, &lights);
            check_layers(&name, &relit);
            if let Some(id) = edit.strip_suffix("_off") {
                let mask = |id: &str, x, y| {
                    room.masks.get(id).is_some_and(|mask| mask.get_pixel(x, y).0[0] > 0)
                };
                let off = |x, y| {
                    mask(id, x, y) || id == "visible" && photo.lit.iter().any(|id| mask(id, x, y))
                };
                let brighter = count(&room, &relit, |x, y| !off(x, y), |a, b| b > a + 1);
                assert_eq!(brighter, 0, "{name}: pixels are brighter with a light off");
            }
            if edit == "globe" {
                let darker = count(&room, &relit, |_, _| true, |a, b| b < a - 1);
                assert_eq!(darker, 0, "{name}: pixels are darker with a lamp more");
            }
            if ["globe", "window"].contains(&edit.as_str()) {
                let brighter = count(&room, &relit, |_, _| true, |a, b| b > a + 3);
                assert!(brighter > 500, "{name}: {brighter} pixels are brighter with a light more");
            }
            for &(_, x, y, half, most) in photo.near.iter().filter(|near| near.0 == edit) {
                let keeps = shown(&relit.picture, [x, y], half) / shown(&room.before, [x, y], half);
                println!("{name}: ({x}, {y}) keeps {keeps:.3}");
                if keeps >= most {
                    faults.push(format!(
                        "{name}: ({x}, {y}) keeps {keeps:.3} of its light, wanted at most {most}"
                    ));
                }
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// Writes, per photo, one sheet of whole pictures and one sheet of close-ups (before, after).
#[test]
#[ignore = "writes pictures to look at"]
fn sheets() {
    let target = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/photos");
    std::fs::create_dir_all(&target).expect("a folder can be made");
    let wanted = std::env::var("PHOTO").unwrap_or_default();
    for photo in PHOTOS.iter().filter(|photo| photo.name.contains(&wanted)) {
        let room = Room::new(&data(), photo);
        let tile = |picture: &RgbImage| {
            imageops::resize(picture, 480, 360, imageops::FilterType::CatmullRom)
        };
        let cut = |picture: &RgbImage, [x0, y0, x1, y1]: [u32; 4]| {
            let (x1, y1) = (x1.min(picture.width()), y1.min(picture.height()));
            let part = imageops::crop_imm(picture, x0, y0, x1 - x0, y1 - y0).to_image();
            imageops::resize(&part, 480, 360, imageops::FilterType::Nearest)
        };
        let (mut whole, mut close) = (vec![tile(&room.before)], Vec::new());
        for (edit, lights, part) in room.edits() {
            let relit = room.relight(&edit, &lights);
            println!("{} {edit}: {lights}", photo.name);
            relit
                .message
                .lines()
                .filter(|l| l.contains("warn"))
                .for_each(|line| println!("    {line}"));
            whole.push(tile(&relit.picture));
            if edit != "invisible_off" && edit != "visible_off" {
                close.extend([cut(&room.before, part), cut(&relit.picture, part)]);
            }
            let layers = target.join(format!("{}_{edit}.exr", photo.name));
            std::fs::copy(&relit.layers, layers).expect("a file can be copied");
        }
        sheet(&whole, 3)
            .save(target.join(format!("{}.png", photo.name)))
            .expect("a picture can be written");
        sheet(&close, 4)
            .save(target.join(format!("{}_close.png", photo.name)))
            .expect("a picture can be written");
    }
}

fn sheet(tiles: &[RgbImage], columns: usize) -> RgbImage {
    let (w, h) = tiles[0].dimensions();
    let mut sheet = RgbImage::new(w * columns as u32, h * tiles.len().div_ceil(columns) as u32);
    for (i, tile) in tiles.iter().enumerate() {
        imageops::replace(
            &mut sheet,
            tile,
            i64::from(w) * (i % columns) as i64,
            i64::from(h) * (i / columns) as i64,
        );
    }
    sheet
}
