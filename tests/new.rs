//! Tests of `relight new`: a scene from a photo, by the compiled program.

#[allow(dead_code, reason = "the builder has more operators than these networks")]
#[path = "pipeline/onnx.rs"]
mod onnx;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{PngDecoder, PngEncoder};
use image::{ExtendedColorType, ImageDecoder, ImageEncoder, RgbImage};
use needs::needs;

/// A temporary folder with the demo's photo and depth.
struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    fn new() -> Place {
        Place { folder: tempfile::tempdir().expect("a temporary folder can be made") }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        std::fs::write(self.path(name), bytes).expect("a file can be written");
    }

    /// Runs the program in this folder with a cache of its own.
    fn relight(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
        command.current_dir(self.folder.path()).args(arguments).env_remove("RELIGHT_LOG");
        command.env("HOME", self.path("home"));
        command.env_remove("XDG_CACHE_HOME").env_remove("XDG_CONFIG_HOME");
        command.output().expect("the program starts")
    }

    /// Runs `relight new`, which must end with `status`; returns standard error.
    fn new_scene(&self, arguments: &[&str], status: i32) -> String {
        let output = self.relight(&[&["new"], arguments].concat());
        let message = String::from_utf8(output.stderr).expect("the program writes UTF-8");
        assert_eq!(output.status.code(), Some(status), "{arguments:?}:\n{message}");
        assert!(!message.contains("panicked"), "{message}");
        message
    }
}

fn demo(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/demo").join(name);
    path.to_str().expect("the path is UTF-8").to_owned()
}

fn demo_photo() -> RgbImage {
    image::open(demo("photo.jpg")).expect("it is there").thumbnail_exact(320, 240).into_rgb8()
}

/// An EXIF block: little-endian TIFF of 16-bit numbers by tag, those from 0x8000 in the EXIF
/// directory.
fn exif(fields: &[(u16, u16)]) -> Vec<u8> {
    let directory = |fields: &[(u16, u16, u32)]| {
        let mut bytes = (fields.len() as u16).to_le_bytes().to_vec();
        for (tag, kind, value) in fields {
            bytes.extend(tag.to_le_bytes());
            bytes.extend(kind.to_le_bytes());
            bytes.extend(1u32.to_le_bytes());
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend([0; 4]);
        bytes
    };
    let of = |is_exif: bool| {
        fields
            .iter()
            .filter(move |(tag, _)| (*tag >= 0x8000) == is_exif)
            .map(|&(tag, value)| (tag, 3, u32::from(value)))
    };
    let mut main: Vec<_> = of(false).collect();
    let at = 8 + 2 + 12 * (main.len() + 1) + 4;
    main.push((0x8769, 4, at as u32));
    let inner: Vec<_> = of(true).collect();
    [b"II*\0\x08\0\0\0".to_vec(), directory(&main), directory(&inner)].concat()
}

fn jpeg(photo: &RgbImage, exif: Option<Vec<u8>>, icc: Option<Vec<u8>>) -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut file, 95);
    if let Some(exif) = exif {
        encoder.set_exif_metadata(exif).expect("JPEG has EXIF");
    }
    if let Some(icc) = icc {
        encoder.set_icc_profile(icc).expect("JPEG has profiles");
    }
    let (width, height) = photo.dimensions();
    encoder
        .write_image(photo, width, height, ExtendedColorType::Rgb8)
        .expect("memory can be written to");
    file
}

const EQUIVALENT: u16 = 0xa405;
const ORIENTATION: u16 = 0x0112;

#[test]
fn a_photo_with_depth_becomes_a_scene_that_runs() {
    let place = Place::new();
    place.write("phone.jpg", jpeg(&demo_photo(), Some(exif(&[(EQUIVALENT, 26)])), None));
    let message =
        place.new_scene(&["phone.jpg", "--depth", &demo("depth.exr"), "--out", "room"], 0);
    assert!(message.contains("26 mm on 35 mm film by the diagonal"), "{message}");
    assert!(!message.contains("guessed: "), "{message}");
    let photo = std::fs::read(place.path("room/photo.jpg")).expect("it is copied");
    assert_eq!(photo, std::fs::read(place.path("phone.jpg")).expect("it is there"));
    let scene = place.text("room/scene.ron");
    // 4:3 and 26 mm by the diagonal: 67.3 degrees.
    assert!(scene.contains("camera: FovX(67.3"), "{scene}");
    assert!(scene.contains("\"lamp_0\": Lamp(mask: \"masks/lamp_0.png\")"), "{scene}");
    assert!(place.text("room/edit.ron").contains("Scale(0.3)"));
    let look = image::open(place.path("room/look.png")).expect("it is a picture");
    assert_eq!((look.width(), look.height()), (640, 240), "photo and depth side by side");
    let graph = Path::new(env!("CARGO_MANIFEST_DIR")).join("graphs/physics.ron");
    let graph = graph.to_str().expect("the path is UTF-8");
    let output = place.relight(&["run", graph, "room/edit.ron", "--scene", "room", "--out", "out"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let output = place.relight(&["mix", "out", "--set", "lamp_0=2", "--out", "mixed.png"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    for name in ["out/picture.png", "mixed.png"] {
        let picture = std::fs::read(place.path(name)).expect("it is written");
        assert!(picture.windows(4).any(|chunk| chunk == b"sRGB"), "{name}");
        let mut decoder = PngDecoder::new(std::io::Cursor::new(picture)).expect("it is a picture");
        let block = decoder.exif_metadata().expect("it is sound").expect("it has an EXIF block");
        let block = exif::Reader::new().read_raw(block).expect("it is sound");
        let number = |tag| block.get_field(tag, exif::In::PRIMARY)?.value.get_uint(0);
        assert_eq!(number(exif::Tag::FocalLengthIn35mmFilm), Some(26), "{name}");
        assert_eq!(number(exif::Tag::Orientation), Some(1), "{name}");
    }
}

#[test]
fn a_second_call_keeps_what_a_person_has_edited() {
    let place = Place::new();
    let depth = demo("depth.exr");
    let call = [&demo("photo.jpg"), "--depth", &depth, "--out", "room"].map(str::to_owned);
    let call: Vec<&str> = call.iter().map(String::as_str).collect();
    place.new_scene(&call, 0);
    let (scene, mask) = (place.text("room/scene.ron"), "room/masks/lamp_0.png");
    let proposed = std::fs::read(place.path(mask)).expect("it is there");

    let message = place.new_scene(&call, 0);
    assert!(!message.contains("kept"), "{message}");
    assert_eq!(place.text("room/scene.ron"), scene, "the same call, the same files");

    // A mask is painted over: the lights are then those of the folder.
    let mut painted = image::open(place.path(mask)).expect("it is a picture").into_luma8();
    painted.put_pixel(0, 0, image::Luma([255]));
    painted.save(place.path(mask)).expect("it can be written");
    let bytes = std::fs::read(place.path(mask)).expect("it is there");
    assert_ne!(bytes, proposed);
    place.new_scene(&call, 0);
    assert_eq!(std::fs::read(place.path(mask)).expect("it is there"), bytes);

    let edited =
        place.text("room/scene.ron").replace("// room: (height: 2.6)", "room: (height: 2.5)");
    place.write("room/scene.ron", &edited);
    place.write("room/edit.ron", "Edit(version: 1)");
    let message = place.new_scene(&call, 0);
    assert!(message.contains("scene.ron, which you changed: it is kept"), "{message}");
    assert_eq!(place.text("room/scene.ron"), edited);
    assert_eq!(place.text("room/edit.ron"), "Edit(version: 1)");
}

#[test]
fn missing_depth_is_told_with_the_remedy_and_can_be_given_later() {
    let place = Place::new();
    let photo = demo("photo.jpg");
    let message = place.new_scene(&[&photo, "--out", "room"], 2);
    for part in
        ["missing: depth; give it with --depth FILE", "this scene has no `depth`", "guessed: "]
    {
        assert!(message.contains(part), "wanted {part:?}, got:\n{message}");
    }
    assert!(place.path("room/look.png").is_file(), "lights are proposed from the photo");
    let message = place.new_scene(&[&photo, "--depth", &demo("depth.exr"), "--out", "room"], 0);
    assert!(!message.contains("kept"), "{message}");
    assert!(place.text("room/scene.ron").contains("    depth: (path: \"depth.exr\""));
}

#[test]
fn a_photo_that_lies_is_turned_upright() {
    let place = Place::new();
    let lying = demo_photo();
    // 6: the first row is the right side of the upright photo.
    let block = exif(&[(ORIENTATION, 6), (EQUIVALENT, 26)]);
    place.write("phone.jpg", jpeg(&lying, Some(block), None));
    let turned = demo("depth.exr");
    let message = place.new_scene(&["phone.jpg", "--depth", &turned, "--out", "room"], 2);
    assert!(message.contains("wanted the aspect ratio of the photo (240 x 320)"), "{message}");
    let depth = image::ImageBuffer::from_fn(240, 320, |x, y| image::Luma([2000 + (x + y) as u16]));
    depth.save(place.path("depth.png")).expect("it can be written");
    let message = place.new_scene(&["phone.jpg", "--depth", "depth.png", "--out", "room"], 0);
    assert!(message.contains("read as millimeters"), "{message}");
    assert!(place.text("room/scene.ron").contains("camera: FovX(53.06"), "{message}");
    let look = image::open(place.path("room/look.png")).expect("it is a picture");
    assert_eq!((look.width(), look.height()), (480, 320));
}

#[test]
fn masks_that_are_given_are_taken() {
    let place = Place::new();
    let masks = place.path("mine");
    std::fs::create_dir(&masks).expect("a folder can be made");
    let mask =
        image::GrayImage::from_fn(320, 240, |x, _| image::Luma([if x < 20 { 255 } else { 0 }]));
    for name in
        ["lamp_desk.png", "window_left.png", "maybe_lamp_3.png", "ignore.png", "sunlight.png"]
    {
        mask.save(masks.join(name)).expect("it can be written");
    }
    place.write("mine/notes.txt", "mine");
    let arguments =
        [&demo("photo.jpg"), "--depth", &demo("depth.exr"), "--masks", "mine", "--out", "room"];
    let message = place.new_scene(&arguments, 0);
    assert!(message.contains("notes.txt is not used"), "{message}");
    let scene = place.text("room/scene.ron");
    for part in [
        "\"lamp_desk\": Lamp(mask: \"masks/lamp_desk.png\")",
        "\"window_left\": Window(mask: \"masks/window_left.png\")",
        "ignore: \"masks/ignore.png\"",
        "sunlight: \"masks/sunlight.png\"",
    ] {
        assert!(scene.contains(part), "wanted {part}, got:\n{scene}");
    }
    assert!(!place.path("room/masks/maybe_lamp_3.png").exists());
}

#[test]
fn a_photo_in_a_format_that_is_not_read_is_named_with_the_remedy() {
    let place = Place::new();
    for (bytes, wanted) in [
        (&b"\0\0\0\x18ftypheic\0\0\0\0"[..], "HEIC: convert it with `heif-convert"),
        (b"\0\0\0\x1cftypavif\0\0\0\0", "AVIF: convert it with `avifdec"),
        (b"II*\0\x08\0\0\0", "TIFF or a raw photo: develop or convert it"),
    ] {
        place.write("photo.heic", bytes);
        let message = place.new_scene(&["photo.heic", "--out", "room"], 2);
        assert!(message.contains(wanted), "{message}");
        assert!(!place.path("room").exists(), "nothing is written");
    }
}

/// A damaged EXIF block, an EXIF block of other things, and names that would leave a comment.
#[test]
fn hostile_metadata_changes_nothing_else() {
    let place = Place::new();
    let photo = demo_photo();
    for (i, block) in [
        vec![0; 3],
        b"II*\0\xff\xff\xff\xff".to_vec(),
        exif(&[(EQUIVALENT, 0)]),
        [b"II*\0\x08\0\0\0\xff\xff".to_vec(), vec![0xff; 600]].concat(),
    ]
    .into_iter()
    .enumerate()
    {
        place.write("phone.jpg", jpeg(&photo, Some(block), None));
        let out = format!("room{i}");
        let message =
            place.new_scene(&["phone.jpg", "--depth", &demo("depth.exr"), "--out", &out], 0);
        assert!(message.contains("guessed: the field of view"), "{message}");
    }
    let name = "depth\n), lights: {}, x: (.exr";
    std::fs::copy(demo("depth.exr"), place.path(name)).expect("it can be copied");
    place.new_scene(&["phone.jpg", "--depth", name, "--out", "odd"], 0);
}

/// WebP without loss gives the scene that a PNG of the same pixels, profile and EXIF block gives.
#[test]
fn a_webp_is_read_with_its_profile_and_lens() {
    let photo = demo_photo();
    let icc = moxcms::ColorProfile::new_display_p3().encode().expect("it has a form");
    fn write(mut encoder: impl ImageEncoder, icc: &[u8], photo: &RgbImage) {
        encoder.set_icc_profile(icc.to_vec()).expect("the format has profiles");
        encoder.set_exif_metadata(exif(&[(EQUIVALENT, 26)])).expect("the format has EXIF");
        let (width, height) = photo.dimensions();
        let written = encoder.write_image(photo, width, height, ExtendedColorType::Rgb8);
        written.expect("memory takes it");
    }
    let (mut webp, mut png) = (Vec::new(), Vec::new());
    write(image::codecs::webp::WebPEncoder::new_lossless(&mut webp), &icc, &photo);
    write(PngEncoder::new(&mut png), &icc, &photo);
    let place = Place::new();
    let [webp_room, png_room] = [("photo.webp", webp), ("photo.png", png)].map(|(name, file)| {
        place.write(name, &file);
        let out = format!("{name}_room");
        let message = place.new_scene(&[name, "--depth", &demo("depth.exr"), "--out", &out], 0);
        assert!(message.contains("Display P3\", converted to linear Rec. 709"), "{message}");
        assert!(message.contains("(320 x 240)"), "{message}");
        let camera = message.lines().find(|line| line.starts_with("camera"));
        let camera = camera.expect("it says the camera").to_owned();
        let look = std::fs::read(place.path(&out).join("look.png")).expect("it is drawn");
        (camera, look)
    });
    assert!(webp_room.0.contains("26"), "{}", webp_room.0);
    assert!(webp_room == png_room, "{} and {}, or their pictures", webp_room.0, png_room.0);
    let graph = Path::new(env!("CARGO_MANIFEST_DIR")).join("graphs/look.ron");
    let graph = graph.to_str().expect("the path is UTF-8");
    let output = place.relight(&["run", graph, "--scene", "photo.webp_room", "--out", "out"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(place.path("out/look.png").exists());
}

#[test]
fn a_wide_gamut_is_told() {
    let place = Place::new();
    let icc = moxcms::ColorProfile::new_display_p3().encode().expect("it has a form");
    place.write("phone.jpg", jpeg(&demo_photo(), None, Some(icc)));
    let message =
        place.new_scene(&["phone.jpg", "--depth", &demo("depth.exr"), "--out", "room"], 0);
    assert!(message.contains("Display P3\", converted to linear Rec. 709"), "{message}");
}

/// All faults of a scene's files at once, as a run would find them one by one.
#[test]
fn check_finds_the_faults_of_pictures() {
    let place = Place::new();
    std::fs::create_dir(place.path("room")).expect("a folder can be made");
    demo_photo().save(place.path("room/photo.png")).expect("it can be written");
    let depth = image::ImageBuffer::from_fn(100, 240, |_, _| image::Luma([2000u16]));
    depth.save(place.path("room/depth.png")).expect("it can be written");
    image::GrayImage::new(320, 240).save(place.path("room/a.png")).expect("it can be written");
    place.write("room/b.png", b"\0\0\0\x18ftypheic\0\0\0\0");
    place.write(
        "room/scene.ron",
        r#"Scene(version: 1, photo: "photo.png", camera: FovX(60), depth: (path: "depth.png", scale: 0.001),
            lights: { "a": Lamp(mask: "a.png"), "b": Lamp(mask: "b.png") })"#,
    );
    place.write(
        "room/edit.ron",
        r#"Edit(version: 1, lights: { "new": Lamp(shape: Sphere(radius: 0.1), at: Pixel(x: 900, y: 20), flux: 1) })"#,
    );
    let graph = Path::new(env!("CARGO_MANIFEST_DIR")).join("graphs/physics.ron");
    let graph = graph.to_str().expect("the path is UTF-8");
    let output = place.relight(&["check", graph, "room/edit.ron", "--scene", "room"]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{message}");
    for part in [
        "a.png: mask: wanted white pixels",
        "b.png: file format: wanted a mask: PNG, JPEG or EXR, got HEIC: convert it",
        "depth.png: depth size: wanted the aspect ratio",
    ] {
        assert!(message.contains(part), "wanted {part:?}, got:\n{message}");
    }
    depth_of_the_photo(&place);
    std::fs::copy(demo("masks/lamp_0.png"), place.path("room/a.png")).expect("it can be copied");
    std::fs::copy(demo("masks/lamp_0.png"), place.path("room/b.png")).expect("it can be copied");
    let output = place.relight(&["check", graph, "room/edit.ron", "--scene", "room"]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("wanted a pixel of the photo, 0..320 and 0..240, got (900, 20)"));
}

fn depth_of_the_photo(place: &Place) {
    let depth = image::ImageBuffer::from_fn(320, 240, |_, _| image::Luma([2000u16]));
    depth.save(place.path("room/depth.png")).expect("it can be written");
}

/// The field of view that a person states beats EXIF, and can follow in a second call.
#[test]
fn a_stated_field_of_view_is_taken() {
    let place = Place::new();
    place.write("phone.jpg", jpeg(&demo_photo(), Some(exif(&[(EQUIVALENT, 26)])), None));
    let depth = demo("depth.exr");
    let scene = |fov: &[&str], status| {
        place.new_scene(&[&["phone.jpg", "--depth", &depth, "--out", "room"], fov].concat(), status)
    };
    scene(&[], 0);
    let message = scene(&["--fov", "48.5"], 0);
    assert!(message.contains("camera  FovX(48.50): stated by --fov"), "{message}");
    assert!(place.text("room/scene.ron").contains("camera: FovX(48.50),"));
    for wrong in ["0.5", "176", "NaN", "67mm"] {
        let message = scene(&["--fov", wrong], 2);
        assert!(message.contains("wanted degrees from 1 to 175, as `67.4`"), "{message}");
    }
    assert!(place.text("room/scene.ron").contains("camera: FovX(48.50),"));
}

#[needs("../shared/data/photos")]
#[test]
fn each_photo_becomes_a_scene() {
    let photos = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/photos");
    for name in [
        "bedroom", "nyu_0189", "nyu_0579", "nyu_0958", "nyu_0987", "nyu_0996", "nyu_1070", "sunlit",
    ] {
        let place = Place::new();
        let file = |file: &str| photos.join(name).join(file).display().to_string();
        let message = place
            .new_scene(&[&file("photo.png"), "--depth", &file("depth.exr"), "--out", "room"], 0);
        assert!(message.contains("guessed: the field of view"), "{name}: {message}");
        assert!(place.path("room/look.png").is_file(), "{name}");
    }
}

/// A PNG keeps its EXIF in a chunk of its own.
#[test]
fn exif_of_a_png_counts_too() {
    let place = Place::new();
    let (photo, mut file) = (demo_photo(), Vec::new());
    let mut encoder = PngEncoder::new(&mut file);
    encoder.set_exif_metadata(exif(&[(EQUIVALENT, 50)])).expect("PNG has EXIF");
    let (width, height) = photo.dimensions();
    encoder.write_image(&photo, width, height, ExtendedColorType::Rgb8).expect("it can be written");
    place.write("camera.png", file);
    let message =
        place.new_scene(&["camera.png", "--depth", &demo("depth.exr"), "--out", "room"], 0);
    assert!(message.contains("50 mm on 35 mm film"), "{message}");
}

/// A PFM file: rows from the bottom, little-endian.
fn pfm(width: usize, height: usize, at: impl Fn(usize, usize) -> f32) -> Vec<u8> {
    let mut bytes = format!("Pf\n{width} {height}\n-1.0\n").into_bytes();
    for y in (0..height).rev() {
        (0..width).for_each(|x| bytes.extend(at(x, y).to_le_bytes()));
    }
    bytes
}

fn depth_of(path: &Path) -> relight::image::Plane<f32> {
    let bytes = std::fs::read(path).expect("it is there");
    let file = relight::image::NamedBytes::new("depth", &bytes);
    relight::image::read_depth_file(file).expect("it is depth").values
}

#[test]
fn depth_of_every_kind_becomes_meters() {
    let place = Place::new();
    place.write("photo.jpg", jpeg(&demo_photo(), Some(exif(&[(EQUIVALENT, 26)])), None));
    let z = depth_of(demo("depth.exr").as_ref());
    let (w, h) = z.size();
    let rays = relight::geometry::Camera::from_fov_x(w, h, 67.38);
    let millimeters =
        image::ImageBuffer::<image::Luma<u16>, _>::from_fn(w as u32, h as u32, |x, y| {
            image::Luma([(1000.0 * z.get(x as usize, y as usize)).round() as u16])
        });
    millimeters.save(place.path("mm.png")).expect("it can be written");
    place.write("feet.pfm", pfm(w, h, |x, y| z.get(x, y) / 0.3048));
    place.write("ray.pfm", pfm(w, h, |x, y| z.get(x, y) * rays.pixel_point(x, y, 1.0).length()));
    place.write("inverse.pfm", pfm(w, h, |x, y| 1.0 / z.get(x, y)));
    place.write("relative.pfm", pfm(w, h, |x, y| 7.0 / z.get(x, y) + 2.0));
    place.write("units.pfm", pfm(w, h, |x, y| 250.3 * z.get(x, y)));
    // The largest relative error of the middle row, and words that tell the origin.
    for (file, options, error, words) in [
        ("mm.png", "", 1e-3, "read as millimeters"),
        ("feet.pfm", "--depth-scale 0.3048", 1e-5, "at 0.3048 m a unit"),
        ("ray.pfm", "--depth-kind ray", 2e-3, "distance along the rays"),
        ("inverse.pfm", "--depth-kind disparity", 1e-5, "inverse distance"),
        ("relative.pfm", "--depth-kind relative --camera-height 1.35", 0.25, "by a camera 1.35 m"),
        ("units.pfm", "--camera-height 1.35", 0.15, "by a camera 1.35 m above the seen floor"),
    ] {
        let folder = format!("room_{}", file.replace('.', "_"));
        let mut arguments = vec!["photo.jpg", "--depth", file, "--out", &folder];
        arguments.extend(options.split_whitespace());
        let message = place.new_scene(&arguments, 0);
        assert!(message.contains(words), "{file}: {message}");
        let got = depth_of(&place.path(&folder).join("depth.exr"));
        let off = (0..w)
            .filter(|&x| z.get(x, h / 2) > 0.0)
            .map(|x| (got.get(x, h / 2) / z.get(x, h / 2) - 1.0).abs());
        let off = off.fold(0.0, f32::max);
        assert!(off < error, "{file}: {off}");
        assert!(place.text(&format!("{folder}/scene.ron")).contains(words), "{file}");
    }
    let message =
        place.new_scene(&["photo.jpg", "--depth", "mm.png", "--out", "x", "--camera-height=-1"], 2);
    assert!(message.contains("wanted a number above 0"), "{message}");
}

/// A network that returns `depth` for any photo of its size, [1, height, width].
fn network_of(depth: &relight::image::Plane<f32>) -> Vec<u8> {
    let (width, height) = (depth.width() as i64, depth.height() as i64);
    onnx::Onnx::default()
        .input("pixel_values", &[1, 3, height, width])
        .output("predicted_depth", &[1, height, width])
        .mix("pixel_values", "nothing", &[[0.0; 3]], &[0.0])
        .floats("depth", &[1, 1, height, width], depth.pixels())
        .node("Add", &["nothing", "depth"], &["four"])
        .numbers("one", &[1])
        .node("Squeeze", &["four", "one"], &["predicted_depth"])
        .file()
}

/// A photo without depth, and a network: in meters, and relative with the height of the camera,
/// which is 1.35 m in the demo.
#[test]
fn a_network_gives_the_depth() {
    let place = Place::new();
    place.write("phone.jpg", jpeg(&demo_photo(), Some(exif(&[(EQUIVALENT, 26)])), None));
    let stored = depth_of(Path::new(&demo("depth.exr")));
    let truth = relight::image::resize(&stored, 320, 240);
    place.write("metric.onnx", network_of(&truth));
    place.write("far.onnx", network_of(&truth.map(|z| 5.0 / z + 2.0)));
    place.write("even.onnx", network_of(&truth.map(|_| 2.5)));
    let metric = ["phone.jpg", "--depth-network", "metric.onnx", "--fov", "64", "--out", "metric"];
    let metric = [&metric[..], &["--set", "depth.convention=DepthAnythingMetric"]].concat();
    let message = place.new_scene(&metric, 0);
    assert!(
        message.contains("depth   the network metric.onnx (Depth Anything, metric"),
        "{message}"
    );
    let error = |depth: &relight::image::Plane<f32>| {
        let ratios = depth.pixels().iter().zip(truth.pixels()).map(|(z, t)| z / t);
        let mut ratios: Vec<f32> = ratios.collect();
        ratios.sort_by(f32::total_cmp);
        [ratios[0], ratios[ratios.len() / 2], ratios[ratios.len() - 1]]
    };
    let got = depth_of(&place.path("metric/depth.exr"));
    assert!(error(&got).iter().all(|ratio| (ratio - 1.0).abs() < 1e-3), "{:?}", error(&got));
    let text = place.text("metric/scene.ron");
    place.new_scene(&metric, 0);
    assert_eq!(place.text("metric/scene.ron"), text, "a cached network has its notes");

    let far = ["phone.jpg", "--depth-network", "far.onnx", "--fov", "64", "--out"];
    for (out, height, options, said) in [
        ("stated", 1.35, &["--camera-height", "1.35"][..], "a camera 1.35 m above the seen floor"),
        ("usual", 1.5, &[], "a camera 1.5 m above the seen floor, a guess"),
    ] {
        let message = place.new_scene(&[&far[..], &[out], options].concat(), 0);
        assert!(message.contains(said), "{message}");
        let [_, middle, _] = error(&depth_of(&place.path(out).join("depth.exr")));
        assert!((middle * 1.35 / height - 1.0).abs() < 0.1, "{out}: {middle}");
    }

    let even = ["phone.jpg", "--depth-network", "even.onnx", "--out", "even"];
    let message = place.new_scene(&even, 2);
    assert!(message.contains("even.onnx: the network returned no depth"), "{message}");
    assert!(!place.path("even/scene.ron").exists() && !place.path("even/depth.exr").exists());
}

/// Gray levels of 16 bits, a number for each pixel.
fn gray(path: &Path, (width, height): (usize, usize), at: impl Fn(usize, usize) -> u16) {
    let picture = image::ImageBuffer::from_fn(width as u32, height as u32, |x, y| {
        image::Luma([at(x as usize, y as usize)])
    });
    picture.save(path).expect("it can be written");
}

/// The demo's depth of 64 x 48 pixels, meters.
fn small_depth() -> relight::image::Plane<f32> {
    relight::image::resize_depth(
        &relight::image::Depth(depth_of(Path::new(&demo("depth.exr")))),
        64,
        48,
    )
    .0
}

/// A scene whose depth must be `wanted` to a millimeter and whose confidence is 1 but in the
/// upper left pixel.
fn check_capture(place: &Place, folder: &str, wanted: &relight::image::Plane<f32>) {
    let bytes = std::fs::read(place.path(folder).join("depth.exr")).expect("it is there");
    let file = relight::image::NamedBytes::new("depth", &bytes);
    let file = relight::image::read_depth_file(file).expect("it is depth");
    assert_eq!(file.values.size(), wanted.size(), "{folder}");
    let off = file.values.pixels().iter().zip(wanted.pixels()).map(|(z, w)| (z - w).abs());
    assert!(off.fold(0.0, f32::max) < 1e-3, "{folder}");
    let confidence = file.confidence.expect("it is kept");
    assert_eq!((confidence.get(0, 0), confidence.get(1, 0)), (0.0, 1.0), "{folder}");
}

/// A phone that is held upright stores pictures that lie: the folder has them turned back.
#[test]
fn a_capture_of_polycam_becomes_an_upright_scene() {
    let place = Place::new();
    for part in ["images", "depth", "confidence", "cameras"] {
        std::fs::create_dir_all(place.path("scan/keyframes").join(part)).expect("it can be made");
    }
    let truth = small_depth();
    for name in ["1442008525605", "1442009042558"] {
        // A clockwise quarter turn of the stored picture makes it upright.
        let lying = image::imageops::rotate270(&demo_photo());
        place.write(&format!("scan/keyframes/images/{name}.jpg"), jpeg(&lying, None, None));
        let part = |part: &str| place.path(&format!("scan/keyframes/{part}/{name}.png"));
        let stored = |x: usize, y: usize| (1000.0 * truth.get(63 - y, x)).round() as u16;
        gray(&part("depth"), (48, 64), stored);
        let sure = |x, y| image::Luma([if (x, y) == (0, 63) { 0u8 } else { 255 }]);
        image::GrayImage::from_fn(48, 64, sure).save(part("confidence")).expect("it is written");
        // The pictures have a fifth of the size that the camera states.
        place.write(
            &format!("scan/keyframes/cameras/{name}.json"),
            r#"{"fx": 1310.0, "fy": 1300.0, "cx": 610.0, "cy": 790.0, "width": 1200, "height": 1600,
                "t_00": 0, "t_10": -0.97, "t_11": 0.02, "t_12": 0.2, "blur_score": 61.2}"#,
        );
    }
    let message = place.new_scene(&["scan", "--frame", "1", "--out", "room"], 0);
    for part in [
        "1442009042558.jpg (Polycam, frame 1 of 0 to 1; turned clockwise by 90 degrees) (320 x 240)",
        "camera  Pinhole(fx: 260.00, fy: 262.00, cx: 162.00, cy: 122.00): the capture's own",
        "distance along the camera's axis, at 0.001 m a unit, as it states, with its confidence",
    ] {
        assert!(message.contains(part), "wanted {part:?}, got:\n{message}");
    }
    assert!(!message.contains("guessed: "), "{message}");
    check_capture(&place, "room", &truth);
    let look = image::open(place.path("room/look.png")).expect("it is a picture");
    assert_eq!((look.width(), look.height()), (640, 240));
    let message = place.new_scene(&["scan", "--fov", "64", "--out", "stated"], 0);
    assert!(message.contains("frame 0 of 0 to 1"), "{message}");
    assert!(message.contains("camera  FovX(64.00): stated by --fov"), "{message}");
    let message = place.new_scene(&["scan", "--frame", "2", "--out", "none"], 2);
    assert!(message.contains("--frame: wanted a frame of scan, 0 to 1, got 2"), "{message}");
    place.write("scan/keyframes/cameras/1442008525605.json", "{");
    let message = place.new_scene(&["scan", "--out", "none"], 2);
    assert!(message.contains("1442008525605.json: camera: wanted JSON with fx"), "{message}");
    assert!(!place.path("none").exists(), "nothing is written");
}

#[test]
fn a_capture_of_stray_scanner_needs_one_picture_of_its_video() {
    let place = Place::new();
    for part in ["depth", "confidence"] {
        std::fs::create_dir_all(place.path("scan").join(part)).expect("it can be made");
    }
    let truth = small_depth();
    for name in ["000000.png", "000012.png"] {
        let stored = |x: usize, y: usize| (1000.0 * truth.get(x, y)).round() as u16;
        gray(&place.path("scan/depth").join(name), (64, 48), stored);
        let sure = |x, y| image::Luma([if (x, y) == (0, 0) { 0u8 } else { 2 }]);
        let sure = image::GrayImage::from_fn(64, 48, sure);
        sure.save(place.path("scan/confidence").join(name)).expect("it can be written");
    }
    place.write("scan/camera_matrix.csv", "1560.0, 0.0, 966.0\n0.0, 1572.0, 732.0\n0.0, 0.0, 1.0");
    place.write(
        "scan/odometry.csv",
        "timestamp, frame, x, y, z, qx, qy, qz, qw\n0.1, 000000, 0, 0, 0, 1, 0, 0, 0\n\
         0.5, 000012, 0, 0, 0, 1, 0, 0, 0\n",
    );
    place.write("scan/rgb.mp4", b"\0\0\0\x18ftypmp42");
    let message = place.new_scene(&["scan", "--frame", "12", "--out", "room"], 2);
    let line = "ffmpeg -noautorotate -i \"scan/rgb.mp4\" -vf \"select=eq(n\\,12)\" -frames:v 1 \"scan/000012.png\"";
    assert!(message.contains(line), "wanted {line}, got:\n{message}");
    assert!(!place.path("room").exists(), "nothing is written");
    demo_photo().save(place.path("scan/000012.png")).expect("it can be written");
    let message = place.new_scene(&["scan", "--out", "room"], 0);
    for part in [
        "000012.png (Stray Scanner, frame 12 of 0 to 12) (320 x 240)",
        "camera  Pinhole(fx: 260.00, fy: 262.00, cx: 161.00, cy: 122.00): the capture's own",
    ] {
        assert!(message.contains(part), "wanted {part:?}, got:\n{message}");
    }
    check_capture(&place, "room", &truth);
}

#[test]
fn a_capture_of_record3d_is_its_export_of_exr_and_jpg() {
    let place = Place::new();
    for part in ["rgb", "depth"] {
        std::fs::create_dir_all(place.path("scan/EXR_RGBD").join(part)).expect("it can be made");
    }
    place.write("scan/EXR_RGBD/rgb/0.jpg", jpeg(&demo_photo(), None, None));
    let truth = small_depth();
    let mut layers = relight::image::ExrLayers::new(64, 48);
    layers.float("R", &truth);
    let exr = layers.write(relight::image::Compression::Zip).expect("it can be written");
    place.write("scan/EXR_RGBD/depth/0.exr", exr);
    place.write(
        "scan/EXR_RGBD/metadata.json",
        r#"{"w": 640, "h": 480, "dw": 64, "dh": 48, "K": [520, 0, 0, 0, 524, 0, 322, 244, 1],
            "poses": [[0, 0, 0, 1, 0, 0, 0]], "fps": 60}"#,
    );
    let message = place.new_scene(&["scan", "--out", "room"], 0);
    for part in [
        "0.jpg (Record3D, frame 0 of 0 to 0) (320 x 240)",
        "camera  Pinhole(fx: 260.00, fy: 262.00, cx: 161.00, cy: 122.00): the capture's own",
    ] {
        assert!(message.contains(part), "wanted {part:?}, got:\n{message}");
    }
    assert_eq!(depth_of(&place.path("room/depth.exr")), truth);

    std::fs::create_dir_all(place.path("r3d/rgbd")).expect("it can be made");
    let message = place.new_scene(&["r3d", "--out", "none"], 2);
    assert!(message.contains("help: export the recording as `EXR + JPG`"), "{message}");
    std::fs::create_dir_all(place.path("other")).expect("it can be made");
    let message = place.new_scene(&["other", "--out", "none"], 2);
    assert!(message.contains("wanted a photo, or the folder of a capture by Polycam"), "{message}");
    let photo = demo("photo.jpg");
    let message = place.new_scene(&[&photo, "--frame", "3", "--out", "none"], 2);
    assert!(message.contains("wanted the folder of a capture as PHOTO"), "{message}");
    let message = place.new_scene(&[&photo, "--depth-scale", "2", "--out", "none"], 2);
    assert!(message.contains("--depth-scale: wanted a depth that it describes"), "{message}");
}

/// An upright photo of a phone that lies in its file, with depth and confidence behind it, as
/// Android's cameras write them (Dynamic Depth 1.0).
#[test]
fn depth_behind_a_photo_is_found_by_itself() {
    let place = Place::new();
    let truth = small_depth();
    let lying = image::imageops::rotate270(&demo_photo());
    let (near, far) = (1.0f32, 8.0f32);
    let share = |x: u32, y: u32| {
        let z = truth.get(63 - y as usize, x as usize);
        image::Luma([(far * (z - near) / (z * (far - near)) * 255.0).round() as u8])
    };
    let depth = image::GrayImage::from_fn(48, 64, share);
    let sure = |x, y| image::Luma([if (x, y) == (0, 63) { 0u8 } else { 255 }]);
    let sure = image::GrayImage::from_fn(48, 64, sure);
    let png = |picture: &image::GrayImage| {
        let mut file = Vec::new();
        let encoder = PngEncoder::new(&mut file);
        encoder.write_image(picture, 48, 64, ExtendedColorType::L8).expect("memory takes it");
        file
    };
    let (depth, sure) = (png(&depth), png(&sure));
    let item = |uri: &str, mime: &str, length: usize| {
        format!(
            r#"<rdf:li><Container:Item Item:Mime="{mime}" Item:Length="{length}" Item:DataURI="{uri}"/></rdf:li>"#
        )
    };
    let items = [
        item("primary_image", "image/jpeg", 0),
        item("android/depthmap", "image/png", depth.len()),
        item("android/confidencemap", "image/png", sure.len()),
    ];
    let packet = format!(
        r#"<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF><rdf:Description>
        <Device:Container><Container:Directory><rdf:Seq>{}</rdf:Seq></Container:Directory></Device:Container>
        <Device:Cameras><rdf:Seq><rdf:li><Device:Camera><Camera:DepthMap DepthMap:Format="RangeInverse"
        DepthMap:ItemSemantic="Depth" DepthMap:Near="{near}" DepthMap:Far="{far}" DepthMap:Units="Meters"
        DepthMap:DepthURI="android/depthmap" DepthMap:ConfidenceURI="android/confidencemap"/></Device:Camera>
        </rdf:li></rdf:Seq></Device:Cameras></rdf:Description></rdf:RDF></x:xmpmeta>"#,
        items.concat()
    );
    let photo = jpeg(&lying, Some(exif(&[(ORIENTATION, 6), (EQUIVALENT, 26)])), None);
    let with = |packet: &str, behind: &[&[u8]]| {
        let segment = [b"http://ns.adobe.com/xap/1.0/\0", packet.as_bytes()].concat();
        let length = (2 + segment.len() as u16).to_be_bytes();
        [&photo[..2], &[0xff, 0xe1], &length, &segment, &photo[2..], &behind.concat()].concat()
    };
    place.write("phone.jpg", with(&packet, &[&depth, &sure]));
    let message = place.new_scene(&["phone.jpg", "--out", "room"], 0);
    let line = "depth   phone.jpg, distance along the camera's axis, at 1 m a unit, as it states, with its confidence";
    assert!(message.contains(line), "{message}");
    let bytes = std::fs::read(place.path("room/depth.exr")).expect("it is there");
    let file = relight::image::NamedBytes::new("depth", &bytes);
    let file = relight::image::read_depth_file(file).expect("it is depth");
    assert_eq!(file.confidence.expect("it is kept").get(0, 0), 0.0);
    // A step of 1/255 in inverse depth.
    let step = (1.0 / near - 1.0 / far) / 255.0;
    for (z, wanted) in file.values.pixels().iter().zip(truth.pixels()) {
        assert!((1.0 / z - 1.0 / wanted).abs() < 0.51 * step, "{z}, wanted {wanted}");
    }
    for (from, to, wanted) in [
        ("\"Meters\"", "\"Diopters\"", "DepthMap:Units: wanted Meters, got Diopters"),
        (
            "=\"android/depthmap\"/>",
            "=\"other\"/>",
            "wanted an item with Item:DataURI android/depthmap",
        ),
        ("Item:Length=\"0\"", "Item:Length=\"99999999\"", ""),
        (
            &format!("Item:Length=\"{}\"", sure.len()),
            "Item:Length=\"99999999\"",
            "Item:Length: wanted at most",
        ),
        ("DepthMap:Near=\"1\"", "DepthMap:Near=\"0\"", "DepthMap:Near: wanted a number above 0"),
    ] {
        assert!(packet.contains(from), "{from}");
        place.write("phone.jpg", with(&packet.replace(from, to), &[&depth, &sure]));
        let status = if wanted.is_empty() { 0 } else { 2 };
        let message = place.new_scene(&["phone.jpg", "--out", "other"], status);
        assert!(message.contains(wanted), "wanted {wanted}, got:\n{message}");
    }
}
