//! Picture files through the stages that read and write them.

mod common;

use std::collections::BTreeMap;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;
use needs::needs;
use rayon::prelude::*;
use relight::geometry::Camera;
use relight::graph::{Context, File, Gather, Node, NodeError, from_ron};
use relight::image::*;
use relight::nodes::artifacts::{Encoding, LayerError, UnitDirect, UnitIndirect, Visibility};
use relight::nodes::output::write::{Write, WriteIn};
use relight::nodes::scene::read_materials::{ReadMaterials, ReadMaterialsIn, ReadMaterialsOut};
use relight::nodes::scene::{CameraSpec, Exposure, read_scene::*};
use relight::optics::{LightKind, Radiance};

use common::files::{npy, npy_of};

fn file(path: &Path) -> File {
    File::new(path.to_str().expect("test folders have plain names"))
}

fn run(scene: &ReadScene) -> Result<(ReadSceneOut, Vec<String>), NodeError> {
    let ctx = Context::default();
    scene.check().map_err(NodeError::Failed)?;
    let out = scene.run(ReadSceneIn {}, &ctx)?;
    Ok((out, ctx.warnings()))
}

/// A PNG whose stored numbers are `value(x, y)`, shares of full.
fn png(
    width: usize,
    height: usize,
    sixteen: bool,
    value: impl FnMut(usize, usize) -> Vec3,
) -> Vec<u8> {
    write_png(&Picture(Plane::from_fn(width, height, value)), Transfer::Linear, sixteen)
}

fn gray(v: f32) -> Vec3 {
    Vec3::splat(v)
}

/// A folder with a sound scene of 64 x 48 pixels: photo, depth, one lamp, one window.
fn folder() -> (tempfile::TempDir, ReadScene) {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, bytes: Vec<u8>| {
        let path = dir.path().join(name);
        fs::write(&path, bytes).expect("temporary folders take files");
        file(&path)
    };
    let mask = |from: usize| {
        png(64, 48, false, move |x, y| {
            gray(f32::from(u8::from((from..from + 8).contains(&x) && y < 8)))
        })
    };
    let photo = png(64, 48, false, |x, y| Vec3::new(x as f32 / 63.0, y as f32 / 47.0, 0.25));
    let lights = [
        ("lamp_0".to_string(), LightSpec::Lamp { mask: write("lamp_0.png", mask(4)) }),
        ("window_0".to_string(), LightSpec::Window { mask: write("window_0.png", mask(40)) }),
    ];
    let scene = ReadScene {
        photo: write("photo.png", photo),
        depth: DepthSpec {
            path: write("depth.npy", npy((64, 48), |_, _| 2.0)),
            kind: DepthKind::PlanarZ,
            scale: 1.0,
            shift: 0.0,
        },
        lights: BTreeMap::from(lights),
        long_side: 32,
        ..ReadScene::default()
    };
    (dir, scene)
}

/// The folder's scene after `change`, which may write files into the folder.
fn check(
    change: impl FnOnce(&Path, &mut ReadScene),
) -> Result<(ReadSceneOut, Vec<String>), NodeError> {
    let (dir, mut scene) = folder();
    change(dir.path(), &mut scene);
    run(&scene)
}

fn message(change: impl FnOnce(&Path, &mut ReadScene)) -> String {
    match check(change) {
        Ok(_) => panic!("wanted an error"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn a_scene_is_read() {
    let (out, warnings) = check(|_, _| ()).expect("a sound scene");
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!((out.photo.0.size(), out.small.0.size()), ((64, 48), (32, 24)));
    assert_eq!((out.full_depth.0.size(), out.depth.0.size()), ((64, 48), (32, 24)));
    assert!(
        out.depth.0.pixels().iter().all(|&z| z == 2.0)
            && out.holes.0.pixels().iter().all(|&h| h == 0.0)
    );
    assert_eq!(
        (out.camera.width, out.small_camera.width, out.small_camera.fx),
        (64, 32, out.camera.fx / 2.0)
    );
    // 0.25 of 255 is stored as 64.
    assert!((out.photo.0.get(10, 10).z - Transfer::Srgb.decode(64.0 / 255.0)).abs() < 1e-7);
    // The right column is 255 in red, the lowest row 255 in green.
    let clipped = |x, y| out.clipped.0.get(x, y);
    assert_eq!((clipped(63, 3), clipped(3, 47), clipped(62, 46)), (1.0, 1.0, 0.0));
    let ids: Vec<&str> = out.mask.0.iter().map(|(id, _)| id.as_str()).collect();
    assert_eq!(ids, ["lamp_0", "window_0"]);
    assert_eq!((*out.kind.0[0].1, *out.kind.0[1].1), (LightKind::Lamp, LightKind::Window));
    assert_eq!(out.full_mask.0[0].1.0.pixels().iter().sum::<f32>(), 64.0);
    assert_eq!(out.mask.0[0].1.0.pixels().iter().sum::<f32>(), 16.0);
    assert_eq!(
        *out.encoding,
        Encoding { transfer: Transfer::Srgb, lux: None, sixteen_bit: false, exif: Vec::new() }
    );
    assert!(out.ignore.0.pixels().iter().all(|&m| m == 0.0) && out.ignore.0.size() == (32, 24));
    assert!(out.sunlight.0.is_empty(), "the scene names none");
}

#[test]
fn the_parameters_read_as_the_scene_file_writes_them() {
    let scene: ReadScene = from_ron(
        r#"(photo: "photo.png", transfer: Gamma(2.2), camera: Pinhole(fx: 500, fy: 501, cx: 319.5, cy: 239.5),
            depth: (path: "depth.png", kind: Disparity, scale: 0.001, shift: 0.25), ignore: "masks/outside.png", sunlight: "masks/sun.png", exposure: Lux(1200.0),
            lights: { "lamp_0": Lamp(mask: "masks/lamp_0.png"), "window_0": Window(mask: "masks/window_0.png") })"#,
    )
    .expect("the documented syntax");
    assert_eq!(scene.transfer, Transfer::Gamma(2.2));
    assert_eq!(scene.camera, CameraSpec::Pinhole { fx: 500.0, fy: 501.0, cx: 319.5, cy: 239.5 });
    assert_eq!(
        scene.depth,
        DepthSpec {
            path: File::new("depth.png"),
            kind: DepthKind::Disparity,
            scale: 0.001,
            shift: 0.25
        }
    );
    assert_eq!(
        scene.lights["window_0"],
        LightSpec::Window { mask: File::new("masks/window_0.png") }
    );
    assert_eq!(scene.ignore, Some(File::new("masks/outside.png")));
    assert_eq!(scene.sunlight, Some(File::new("masks/sun.png")));
    assert_eq!(scene.exposure, Some(Exposure::Lux(1200.0)));
    assert_eq!(scene.clone().files().len(), 6);
    let short: ReadScene =
        from_ron(r#"(photo: "p", camera: FovX(57.95), depth: (path: "d"))"#).expect("defaults");
    assert_eq!(
        (short.camera, [short.depth.scale, short.depth.shift], short.long_side),
        (CameraSpec::FovX(57.95), [1.0, 0.0], 320)
    );
    let again: ReadScene =
        from_ron(&relight::graph::to_ron(&scene)).expect("what is written is read");
    assert_eq!(
        (again.lights, again.depth, again.camera),
        (scene.lights, scene.depth, scene.camera)
    );
}

#[test]
fn depth_kinds_have_their_closed_forms() {
    let shifted = |kind, [scale, shift]: [f32; 2], value: fn(usize, usize) -> f32| {
        let (out, _) = check(|dir, scene| {
            fs::write(dir.join("depth.npy"), npy((64, 48), value)).expect("writable");
            scene.depth = DepthSpec { kind, scale, shift, ..scene.depth.clone() };
        })
        .expect("a sound scene");
        out
    };
    let kind = |kind, scale, value| shifted(kind, [scale, 0.0], value);
    // A wall facing the camera at 3 m, as ray lengths of the default camera (60 degrees,
    // f = 32 / tan 30).
    fn ray(x: usize, y: usize) -> f32 {
        let f = 32.0 / 30f32.to_radians().tan();
        let (dx, dy) = ((x as f32 + 0.5 - 32.0) / f, (y as f32 + 0.5 - 24.0) / f);
        3000.0 * (1.0 + dx * dx + dy * dy).sqrt()
    }
    let near = |out: &ReadSceneOut, z: f32| {
        out.full_depth.0.pixels().iter().all(|&got| (got - z).abs() < 1e-5 * z)
    };
    assert!(near(&kind(DepthKind::RayLength, 0.001, ray), 3.0));
    assert!(near(&kind(DepthKind::PlanarZ, 0.001, |_, _| 2500.0), 2.5));
    assert!(near(&kind(DepthKind::Disparity, 8.0, |_, _| 4.0), 2.0));
    // Relative depth: 0 is a number where a shift stands beside it.
    assert!(near(&shifted(DepthKind::Disparity, [6.0, 1.5], |_, _| 0.0), 4.0));
    assert!(near(&shifted(DepthKind::PlanarZ, [2.0, 0.5], |_, _| 1.0), 3.0));
    assert!(near(&shifted(DepthKind::RayLength, [0.001, 500.0], |x, y| ray(x, y) - 500.0), 3.0));
    // No disparity and negative disparity are holes.
    let out = kind(DepthKind::Disparity, 8.0, |x, _| [0.0, -1.0, 4.0, 4.0][x % 4]);
    assert!(near(&out, 2.0));
    assert_eq!(out.holes.0.pixels().iter().sum::<f32>() / out.holes.0.len() as f32, 0.5);
}

#[test]
fn relative_depth_that_is_declared_metric_is_told() {
    let warnings = |spec: [f32; 2], kind, most: f32| {
        let depth = move |x: usize, y: usize| most * (x * y) as f32 / (63.0 * 47.0);
        let (_, warnings) = check(|dir, scene| {
            fs::write(dir.join("depth.npy"), npy((64, 48), depth)).expect("writable");
            scene.depth = DepthSpec { kind, scale: spec[0], shift: spec[1], ..scene.depth.clone() };
        })
        .expect("it is read");
        warnings.iter().filter(|warning| warning.contains("as relative depth does")).count()
    };
    for most in [1.0, 255.0] {
        assert_eq!(warnings([0.02, 0.0], DepthKind::PlanarZ, most), 1);
        assert_eq!(warnings([0.02, 0.0], DepthKind::RayLength, most), 1);
        assert_eq!(warnings([2.0, 0.3], DepthKind::Disparity, most), 0);
        assert_eq!(warnings([0.02, 40.0], DepthKind::PlanarZ, most), 0);
    }
    assert_eq!(warnings([1.0, 0.0], DepthKind::PlanarZ, 4.2), 0);
}

#[test]
fn depth_formats_hold_the_same_numbers() {
    let number = |x: usize, y: usize| (1000 + 7 * x + 100 * y) as u16;
    let wide: Vec<u16> = (0..12).map(|at| number(at % 4, at / 4)).collect();
    let mut gray = std::io::Cursor::new(Vec::new());
    image::ImageEncoder::write_image(
        image::codecs::png::PngEncoder::new(&mut gray),
        bytemuck::cast_slice(&wide),
        4,
        3,
        image::ExtendedColorType::L16,
    )
    .expect("a sound picture");
    let mut layers = ExrLayers::new(4, 3);
    layers.float("Y", &Plane::from_fn(4, 3, |x, y| number(x, y).into()));
    let files = [
        gray.into_inner(),
        layers.write(Compression::Zip).expect("sound layers"),
        npy_of("<u2", (4, 3), |x, y| number(x, y).to_le_bytes().to_vec()),
        npy_of("<f4", (4, 3), |x, y| f32::from(number(x, y)).to_le_bytes().to_vec()),
        npy_of(">f8", (4, 3), |x, y| f64::from(number(x, y)).to_be_bytes().to_vec()),
    ];
    for bytes in files {
        let (depth, warnings) = read_depth(NamedBytes::new("depth", &bytes)).expect("a sound file");
        assert_eq!((depth, warnings.len()), (Plane::from_fn(4, 3, |x, y| number(x, y).into()), 0));
    }
    let hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n\x80\x80\x80\x80";
    let error =
        read_depth(NamedBytes::new("d.hdr", hdr)).expect_err("HDR holds colours").to_string();
    assert_eq!(
        error,
        "d.hdr: file format: wanted depth: EXR, PNG, NPY, NPZ, PFM, TIFF or JPEG, got Hdr"
    );
}

#[test]
fn depth_with_holes_or_of_other_sizes() {
    let depth = |width, height, value: fn(usize, usize) -> f32| {
        move |dir: &Path, _: &mut ReadScene| {
            fs::write(dir.join("depth.npy"), npy((width, height), value)).expect("writable");
        }
    };
    for bad in [f32::NAN, f32::INFINITY, 0.0, -3.0, 2e5] {
        let (out, warnings) = check(|dir, _| {
            let depth = npy((64, 48), |x, y| if (x + y) % 3 == 0 { bad } else { 2.0 });
            fs::write(dir.join("depth.npy"), depth).expect("writable");
        })
        .expect("a third is holes");
        assert!(
            warnings.is_empty()
                && out.full_depth.0.pixels().iter().all(|&z| (z - 2.0).abs() < 1e-5)
        );
    }
    let (_, warnings) =
        check(depth(64, 48, |x, _| if x < 40 { 0.0 } else { 2.0 })).expect("holes are filled");
    assert!(warnings[0].contains("62 % of the depth are holes"), "{warnings:?}");
    assert!(
        message(depth(64, 48, |_, _| f32::NAN))
            .contains("depth.npy: depth: wanted at least one depth")
    );
    let (out, _) = check(depth(16, 12, |_, _| 2.0)).expect("the same aspect");
    assert_eq!(out.full_depth.0.size(), (64, 48));
    let text = message(depth(48, 64, |_, _| 2.0));
    assert!(
        text.contains("depth.npy: depth size: wanted the aspect ratio of")
            && text.contains("48 x 64"),
        "{text}"
    );
}

#[test]
fn the_view_through_a_window_does_not_fill_the_room() {
    let (out, _) = check(|dir, _| {
        // The window is columns 40..48 of rows 0..8 and shows 100 m; holes lie around it.
        let depth = npy((64, 48), |x, y| match (x, y) {
            (40..48, 0..8) => 100.0,
            (36..52, 0..12) => 0.0,
            _ => 2.0,
        });
        fs::write(dir.join("depth.npy"), depth).expect("writable");
    })
    .expect("a sound scene");
    assert_eq!(out.full_depth.0.get(44, 4), 100.0);
    assert!((38..40).all(|x| (out.full_depth.0.get(x, 4) - 2.0).abs() < 1e-5));
}

#[test]
fn masks_of_other_sizes_empty_or_full() {
    let mask = |width, height, value: fn(usize) -> bool| {
        move |dir: &Path, _: &mut ReadScene| {
            let mask = png(width, height, false, |x, _| gray(f32::from(u8::from(value(x)))));
            fs::write(dir.join("lamp_0.png"), mask).expect("writable");
        }
    };
    let (out, warnings) = check(mask(32, 24, |x| x < 4)).expect("the same aspect");
    assert!(
        warnings[0].contains("lamp_0.png: 32 x 24, resampled to the photo's 64 x 48"),
        "{warnings:?}"
    );
    assert_eq!(out.full_mask.0[0].1.0.get(2, 2), 1.0);
    assert!(
        message(mask(64, 40, |x| x < 4))
            .contains("lamp_0.png: mask size: wanted the aspect ratio of")
    );
    assert!(message(mask(64, 48, |_| false)).contains("lamp_0.png: mask: wanted white pixels"));
    assert!(message(mask(64, 48, |_| true)).contains("covers everything"));
    let text = message(|_, scene| scene.photo = File::new("/nowhere/photo.png"));
    assert!(text.starts_with("/nowhere/photo.png: cannot be read"), "{text}");
}

#[test]
fn photos_of_one_pixel_and_one_row() {
    for (width, height) in [(1, 1), (400, 1), (1, 7)] {
        let (out, _) = check(|dir, scene| {
            fs::write(dir.join("photo.png"), png(width, height, true, |_, _| gray(0.5)))
                .expect("writable");
            fs::write(dir.join("depth.npy"), npy((width, height), |_, _| 1.5)).expect("writable");
            scene.lights.clear();
            scene.long_side = 320;
        })
        .expect("a small photo");
        assert_eq!(out.photo.0.size(), (width, height));
        assert_eq!(out.depth.0.size(), (width.min(320), height));
        assert!(out.encoding.sixteen_bit);
    }
}

fn lamps(count: usize, mask: impl Fn(usize) -> String) -> BTreeMap<String, LightSpec> {
    (0..count).map(|i| (format!("l{i}"), LightSpec::Lamp { mask: File::new(mask(i)) })).collect()
}

#[test]
fn names_for_one_mask_are_not_counted() {
    let scene = ReadScene {
        photo: File::new("p.png"),
        depth: DepthSpec {
            path: File::new("d.exr"),
            kind: DepthKind::PlanarZ,
            scale: 1.0,
            shift: 0.0,
        },
        lights: lamps(100, |i| format!("m{}.png", i % 32)),
        ..ReadScene::default()
    };
    assert_eq!(scene.check(), Ok(()));
}

#[test]
fn parameters_out_of_range_are_named() {
    let wrong = |change: fn(&mut ReadScene), wanted: &str| {
        let text = message(|_, scene| change(scene));
        assert!(text.contains(wanted), "{text}");
    };
    wrong(|s| s.camera = CameraSpec::FovX(180.0), "camera: FovX: wanted 1..=175, got 180");
    wrong(
        |s| s.camera = CameraSpec::Pinhole { fx: f32::NAN, fy: 1.0, cx: 0.0, cy: 0.0 },
        "camera: fx",
    );
    wrong(|s| s.transfer = Transfer::Gamma(0.0), "transfer: Gamma");
    wrong(|s| s.depth.scale = -1.0, "depth: scale");
    wrong(|s| s.depth.shift = f32::NAN, "depth: shift");
    wrong(|s| s.exposure = Some(Exposure::Lux(0.0)), "exposure: Lux");
    wrong(|s| s.long_side = 0, "long_side");
    wrong(|s| s.photo.path.clear(), "photo: wanted a file");
    wrong(
        |s| s.lights = lamps(33, |i| format!("m{i}.png")),
        "lights: wanted at most 32 lights with masks of their own, got 33",
    );
    for id in ["", "0lamp", "a.b", "é", "rest", "inv_lamp"] {
        let text = message(|_, scene| {
            scene.lights.insert(id.into(), LightSpec::Lamp { mask: File::new("m.png") });
        });
        assert!(text.starts_with("lights:"), "{text}");
    }
}

const SMALL: (usize, usize) = (8, 6);

/// Runs with an albedo, a normal and a roughness file of these planes.
fn materials(
    albedo: Plane<Vec3>,
    normal: Option<Plane<Vec3>>,
    rough: Option<f32>,
) -> Result<ReadMaterialsOut, NodeError> {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let write = |name: &str, layers: ExrLayers| {
        let path = folder.path().join(name);
        fs::write(&path, layers.write(Compression::Zip).expect("sound layers"))
            .expect("it can be written to");
        file(&path)
    };
    let layers = |plane: &Plane<Vec3>| ExrLayers::new(plane.width(), plane.height());
    let mut colors = layers(&albedo);
    colors.float_rgb("", &albedo);
    let normal = normal.map(|plane| {
        let mut vectors = layers(&plane);
        vectors.float_xyz("", &plane);
        write("normal.exr", vectors)
    });
    let roughness = rough.map(|rough| {
        let mut gray = ExrLayers::new(SMALL.0, SMALL.1);
        gray.float("Y", &Plane::filled(SMALL.0, SMALL.1, rough));
        write("rough.exr", gray)
    });
    let stage = ReadMaterials {
        albedo: write("albedo.exr", colors),
        normal,
        roughness,
        ..ReadMaterials::default()
    };
    let inputs = ReadMaterialsIn {
        normal: Arc::new(Normal(Plane::filled(SMALL.0, SMALL.1, Vec3::Z))),
        camera: Arc::new(Camera::from_fov_x(SMALL.0, SMALL.1, 60.0)),
    };
    stage.run(inputs, &Context::default())
}

fn even((width, height): (usize, usize), value: f32) -> Plane<Vec3> {
    Plane::filled(width, height, Vec3::splat(value))
}

#[test]
fn files_of_working_size_pass_unchanged_and_larger_ones_are_averaged() {
    let albedo = Plane::from_fn(8, 6, |x, y| Vec3::new(x as f32 / 8.0, y as f32 / 6.0, 0.3));
    let out = materials(albedo.clone(), None, None).expect("it is sound");
    assert_eq!(out.albedo.0, albedo);
    assert_eq!((out.normal.0.get(3, 2), out.roughness.0.get(3, 2)), (Vec3::Z, 0.8));
    let checks = Plane::from_fn(16, 12, |x, y| Vec3::splat(((x + y) % 2) as f32));
    let out = materials(checks, None, Some(0.25)).expect("it is sound");
    assert!(out.albedo.0.pixels().iter().all(|&a| (a - 0.5).abs().max_element() < 1e-6));
    assert!(out.roughness.0.pixels().iter().all(|&r| r == 0.25));
}

#[test]
fn normals_have_unit_length_and_face_the_camera() {
    let read = Plane::from_fn(8, 6, |x, _| [Vec3::new(0.0, 6.0, 8.0), Vec3::ZERO, -Vec3::Z][x % 3]);
    let out = materials(even(SMALL, 0.5), Some(read), None).expect("it is sound");
    let got: Vec<Vec3> = (0..3).map(|x| out.normal.0.get(x, 0)).collect();
    assert_eq!(got, [Vec3::new(0.0, 0.6, 0.8), Vec3::Z, Vec3::Z]);
}

#[test]
fn what_is_no_material_is_named() {
    let message = |albedo, rough| match materials(albedo, None, rough) {
        Err(NodeError::BadFile { path, message }) => {
            format!("{}: {message}", path.rsplit('/').next().unwrap_or_default())
        }
        _ => panic!("a file is at fault"),
    };
    let over = message(even(SMALL, 1.5), None);
    assert_eq!(
        over,
        "albedo.exr: albedo: wanted 0..=1, got [1.5, 1.5, 1.5] at working pixel (0, 0)"
    );
    assert!(message(even(SMALL, f32::NAN), None).contains("wanted finite numbers"));
    assert!(
        message(even(SMALL, 0.5), Some(-0.1)).starts_with("rough.exr: roughness: wanted 0..=1")
    );
    let wanted = "albedo.exr: albedo size: wanted the aspect ratio of 8 x 6 to 2 %, got 6 x 8";
    assert_eq!(message(even((6, 8), 0.5), None), wanted);
}

#[test]
fn png_comes_back_in_every_transfer() {
    for transfer in [Transfer::Srgb, Transfer::Gamma(2.2), Transfer::Linear] {
        for (sixteen, step) in [(false, 1.0 / 255.0), (true, 1.0 / 65535.0)] {
            let picture =
                Plane::from_fn(61, 17, |x, y| Vec3::new(x as f32 / 60.0, y as f32 / 16.0, 0.3));
            let bytes = write_png(&Picture(picture.clone()), transfer, sixteen);
            let back = read_photo(NamedBytes::new("p.png", &bytes), transfer)
                .expect("what was written is read");
            assert_eq!(back.bits, if sixteen { Bits::Sixteen } else { Bits::Eight });
            for (got, wanted) in back.picture.0.pixels().iter().zip(picture.pixels()) {
                for axis in 0..3 {
                    let (got, wanted) = (transfer.encode(got[axis]), transfer.encode(wanted[axis]));
                    // Half a step of the file, and single precision.
                    assert!(
                        (got - wanted).abs() <= 0.5 * step + 2e-6,
                        "{transfer:?} {got} {wanted}"
                    );
                }
            }
        }
    }
    let clipped = write_png(
        &Picture(Plane::from_fn(2, 1, |x, _| gray([-1.0, 7.0][x]))),
        Transfer::Srgb,
        false,
    );
    let back = read_photo(NamedBytes::new("p.png", &clipped), Transfer::Srgb)
        .expect("what was written is read");
    assert_eq!((back.picture.0.get(0, 0), back.picture.0.get(1, 0)), (Vec3::ZERO, Vec3::ONE));
}

#[test]
fn exr_comes_back_with_every_compression_and_channel_kind() {
    let picture = Plane::from_fn(37, 23, |x, y| Vec3::new(x as f32 * 0.25, y as f32 * 0.125, -0.5));
    let depth = Plane::from_fn(37, 23, |x, y| 1.0 / 3.0 + x as f32 + 0.1 * y as f32);
    for compression in [Compression::None, Compression::Rle, Compression::Zip, Compression::Piz] {
        let mut layers = ExrLayers::new(37, 23);
        layers.rgb("", &picture);
        layers.rgb("light_lamp_0", &picture);
        layers.xyz("normal", &picture);
        layers.float("Z", &depth);
        layers.half("rough.Y", &depth);
        layers.half("large.Y", &depth.map(|_| 1e9));
        layers.rgb("small", &picture.map(|v| 1e-12 * v));
        layers.half("zero.Y", &depth.map(|_| 0.0));
        layers.comment("metres \u{3c0}");
        // Neither infinite nor black: values that halves cannot hold are floats, with its name and
        // largest magnitude.
        assert_eq!(
            layers.kept_as_float(),
            [("large.Y".to_owned(), 1e9), ("small".to_owned(), 1e-12 * 9.0)]
        );
        let bytes = layers.write(compression).expect("the layers are sound");
        let source = NamedBytes::new("p.exr", &bytes);
        // Quarters and eighths below 32 are exact in half precision, floats are exact.
        let back = read_photo(source, Transfer::Srgb).expect("what was written is read");
        assert_eq!((&back.picture.0, back.bits, back.warnings.len()), (&picture, Bits::Float, 0));
        assert_eq!(read_depth(source).expect("there is a Z channel").0, depth);
        let exr = exr_channels(&bytes);
        assert_eq!(exr["normal.X"], exr["light_lamp_0.R"]);
        assert!(exr["large.Y"].iter().all(|&v| v == 1e9));
        let small = picture.map(|v| 1e-12 * v.x);
        assert_eq!(exr["small.R"], small.pixels());
    }
}

#[test]
fn a_photo_with_an_exif_orientation_is_turned_upright() {
    let plain = {
        let mut file = std::io::Cursor::new(Vec::new());
        let left_white: Vec<u8> =
            (0..32 * 16).map(|at| if at % 32 < 16 { 255 } else { 0 }).collect();
        image::codecs::jpeg::JpegEncoder::new(&mut file)
            .encode(&left_white, 32, 16, image::ExtendedColorType::L8)
            .expect("a sound picture");
        file.into_inner()
    };
    // APP1 with one big-endian TIFF entry: tag 0x0112, one short, 6: the picture stands a quarter
    // turn to the left.
    let exif = b"\xff\xe1\x00\x22Exif\0\0MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0";
    let turned = [&plain[..2], exif, &plain[2..]].concat();
    let picture = read_photo(NamedBytes::new("p.jpg", &turned), Transfer::Srgb)
        .expect("a sound file")
        .picture
        .0;
    assert_eq!(picture.size(), (16, 32));
    assert!(picture.get(8, 4).x > 0.9 && picture.get(8, 28).x < 0.1);
}

#[test]
fn saturation_of_float_photos_is_a_plateau() {
    let clipped = |value: fn(usize, usize) -> f32| {
        let mut layers = ExrLayers::new(40, 30);
        layers.rgb("", &Plane::from_fn(40, 30, |x, y| gray(value(x, y))));
        let bytes = layers.write(Compression::Zip).expect("sound layers");
        let photo =
            read_photo(NamedBytes::new("p.exr", &bytes), Transfer::Linear).expect("a sound file");
        photo.clipped.0.pixels().iter().sum::<f32>()
    };
    assert_eq!(clipped(|x, y| if x < 6 && y < 6 { 8.0 } else { (x + y) as f32 / 64.0 }), 36.0);
    assert_eq!((clipped(|x, y| (40 * y + x) as f32 / 256.0), clipped(|_, _| 1.0)), (0.0, 0.0));
}

#[test]
fn the_white_of_a_photo_of_8_bits_may_lie_below_255() {
    // Levels up to 200, evenly, with 150 pixels in white.
    let clipped = |white: fn(usize) -> u8| {
        let level = |at: usize| if at < 150 { white(at) } else { (at % 200) as u8 };
        let levels: Vec<u8> = (0..60 * 40).map(level).collect();
        let mut file = std::io::Cursor::new(Vec::new());
        let encoder = image::codecs::png::PngEncoder::new(&mut file);
        image::ImageEncoder::write_image(encoder, &levels, 60, 40, image::ExtendedColorType::L8)
            .expect("a sound picture");
        let photo = read_photo(NamedBytes::new("p.png", file.get_ref()), Transfer::Srgb);
        let photo = photo.expect("a sound file");
        photo.clipped.0.pixels().iter().sum::<f32>()
    };
    assert_eq!(
        clipped(|at| 249 + (at % 4) as u8),
        150.0,
        "the white of a video or a resampled photo"
    );
    assert_eq!(clipped(|at| 254 + (at % 2) as u8), 150.0);
    assert_eq!(clipped(|at| 200 + (at % 50) as u8), 0.0, "bright, without a step");
    assert_eq!(clipped(|at| 236 + (at % 4) as u8), 0.0, "a bright wall");
}

fn exr_channels(bytes: &[u8]) -> BTreeMap<String, Vec<f32>> {
    use exr::prelude::{ReadChannels, ReadLayers, read};
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes();
    let image = image.from_buffered(std::io::Cursor::new(bytes)).expect("a sound file");
    assert_eq!(image.layer_data.len(), 1, "one part holds all layers");
    let list = image.layer_data[0].channel_data.list.iter();
    list.map(|c| (c.name.to_string(), c.sample_data.values_as_f32().collect())).collect()
}

/// Inputs of Write: `lights` lights, the first a window, planes of `small` pixels, pictures of
/// `size`.
fn write_inputs(size: (usize, usize), small: (usize, usize), lights: usize) -> WriteIn {
    // Smooth shading with a hundredth of noise, in 0..1, as renderings are.
    let noise = |x: usize, y: usize, n: usize| {
        let grain = ((x * 7919 + y * 104_729 + n * 1_299_709) % 1009) as f32 / 1009.0;
        let (x, y, n) = (x as f32, y as f32, n as f32);
        0.5 + 0.45 * (0.031 * x + n).sin() * (0.023 * y + 2.0 * n).cos() + 0.01 * grain
    };
    let plane = |n: usize| Plane::from_fn(small.0, small.1, |x, y| noise(x, y, n));
    let colors = |(w, h): (usize, usize), n: usize| {
        Plane::from_fn(w, h, |x, y| {
            Vec3::new(noise(x, y, n), 0.5 * noise(x, y, n), x as f32 / w as f32)
        })
    };
    let ids: Vec<(String, usize, usize)> =
        (0..lights).map(|i| (format!("light{i}"), if i == 0 { 3 } else { 1 }, 10 * i)).collect();
    let rest = colors(size, 5).map(|c| 0.1 * c);
    let lights: Vec<_> = ids.iter().map(|(id, _, n)| (id.clone(), colors(size, *n))).collect();
    let mut picture = rest.clone();
    for (_, layer) in &lights {
        picture.pixels_mut().iter_mut().zip(layer.pixels()).for_each(|(p, &l)| *p += l);
    }
    let layer = lights.into_iter().map(|(id, layer)| (id, Arc::new(Layer::new(layer)))).collect();
    let many = |lobes: usize, n: usize| (0..lobes).map(|k| plane(n + k)).collect::<Vec<_>>();
    let direct = ids.iter().map(|(id, lobes, n)| {
        (id.clone(), Arc::new(UnitDirect { lobes: many(*lobes, *n), stderr: many(*lobes, n + 3) }))
    });
    let visibility = ids.iter().map(|(id, lobes, n)| {
        let (lit, stderr, unknown) =
            (many(*lobes, n + 1), many(*lobes, n + 4), many(*lobes, n + 2));
        (id.clone(), Arc::new(Visibility { lit, stderr, unknown }))
    });
    let indirect = ids.iter().map(|(id, lobes, n)| {
        let shading = (0..*lobes).map(|k| Shading(colors(small, n + 4 + k))).collect();
        (
            id.clone(),
            Arc::new(UnitIndirect {
                lobes: shading,
                stderr: many(*lobes, n + 5),
                probes: vec![],
                cells: vec![],
            }),
        )
    });
    let radiance = ids.iter().map(|(id, lobes, _)| {
        (
            id.clone(),
            Arc::new(Radiance(
                (0..*lobes).map(|k| Vec3::new(1.0, 2.0, 3.0) * (k + 1) as f32).collect(),
            )),
        )
    });
    // Nothing is guessed about the second light.
    let room_error = ids.iter().enumerate().map(|(i, (id, _, n))| {
        let stderr = if i == 1 { plane(*n).map(|_| 0.0) } else { plane(n + 6) };
        (id.clone(), Arc::new(LayerError { stderr }))
    });
    WriteIn {
        layout: None,
        camera: None,
        picture: Arc::new(Picture(picture)),
        encoding: Arc::new(Encoding {
            transfer: Transfer::Srgb,
            lux: Some(1200.0),
            sixteen_bit: false,
            exif: Vec::new(),
        }),
        photo: Some(Arc::new(Picture(colors(size, 6)))),
        residual: Arc::new(Layer::new(rest)),
        direct: Gather(direct.collect()),
        visibility: Gather(visibility.collect()),
        indirect: Gather(indirect.collect()),
        radiance: Gather(radiance.collect()),
        room_error: Gather(room_error.collect()),
        mask: Gather(vec![("light0".to_owned(), Arc::new(light_mask(size)))]),
        glare: Gather(vec![("lamp".to_owned(), Arc::new(Picture(plane(12).map(Vec3::splat))))]),
        filled: Some(Arc::new(Mask(plane(11)))),
        layer: Gather(layer),
        albedo: Arc::new(Albedo(colors(small, 7))),
        normal: Arc::new(Normal(Plane::filled(small.0, small.1, Vec3::Z))),
        roughness: Arc::new(Roughness(plane(8))),
        specular: None,
        depth: Arc::new(Depth(plane(9).map(|z| z + 1.0))),
    }
}

/// A window in the left third, and a body that covers a quarter of all pixels.
fn light_mask((w, h): (usize, usize)) -> LightMask {
    let mask = Plane::from_fn(w, h, |x, _| if 3 * x < w { 1.0 } else { 0.0 });
    let photo = Picture(Plane::filled(w, h, Vec3::ONE));
    let own = GlareMask::of_window(&mask, &photo, &Mask(Plane::filled(w, h, 0.0)), 2.0);
    LightMask::new(Some(&own), Some(&Mask(Plane::filled(w, h, 0.25)))).expect("it is in view")
}

#[test]
fn the_filled_share_of_a_change_is_told() {
    let share = |changed: std::ops::Range<usize>| {
        let mut inputs = write_inputs((48, 36), (12, 9), 1);
        let photo = inputs.photo.clone().expect("it is there");
        let factor = |x: usize| if changed.contains(&x) { 0.5 } else { 1.0 };
        inputs.picture = Arc::new(Picture(Plane::from_fn(48, 36, |x, y| {
            factor(x) * photo.0.get(x, y).with_x(0.5)
        })));
        let photo = Plane::from_fn(48, 36, |x, y| photo.0.get(x, y).with_x(0.5));
        inputs.photo = Some(Arc::new(Picture(photo)));
        inputs.filled =
            Some(Arc::new(Mask(Plane::from_fn(12, 9, |x, _| if x < 3 { 1.0 } else { 0.0 }))));
        let context = Context::default();
        Write::default().run(inputs, &context).expect("sound inputs");
        let notes = context.notes();
        let told = notes.iter().find_map(|note| note.split_once(" % of the visible change"));
        told.map(|(share, _)| share.parse::<f64>().expect("a number"))
    };
    assert_eq!(share(0..12), Some(100.0));
    assert_eq!(share(12..48), Some(0.0));
    assert!((20.0..80.0).contains(&share(6..18).expect("there is a change")));
    assert_eq!(share(0..0), None);
}

#[test]
fn the_written_layers_are_what_they_say() {
    let inputs = write_inputs((48, 36), (48, 36), 3);
    let (direct, visibility) = (inputs.direct.0[0].1.clone(), inputs.visibility.0[0].1.clone());
    let (indirect, radiance) = (inputs.indirect.0[0].1.clone(), inputs.radiance.0[0].1.clone());
    let room_error = inputs.room_error.0[0].1.clone();
    let filled = inputs.filled.clone().expect("it is there");
    let photo: Vec<f32> =
        inputs.photo.iter().flat_map(|photo| photo.0.pixels()).map(|c| c.x).collect();
    let files = Write::default().run(inputs, &Context::default()).expect("sound inputs").files;
    assert_eq!(
        files.0.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(),
        ["picture.png", "picture.exr"]
    );
    let exr = exr_channels(&files.0[1].1);
    let close = |got: f32, wanted: f32, name: &str| {
        // Half precision: 2^-11 relative in each of two numbers.
        assert!(
            (got - wanted).abs() <= 1e-3 * wanted.abs() + 1e-6,
            "{name}: {got}, wanted {wanted}"
        );
    };
    for (at, _) in exr["R"].iter().enumerate() {
        for axis in ["R", "G", "B"] {
            let ids = ["light0", "light1", "light2", "rest"];
            let sum: f32 = ids.iter().map(|id| exr[&format!("light_{id}.{axis}")][at]).sum();
            close(sum, exr[axis][at], "the sum of the lights");
        }
        let (mut lit, mut bounced, mut shadow, mut unknown, mut total, mut variance, mut shared) =
            (0.0, 0.0, 0.0, 0.0, 0.0, 0.0f32, 0.0);
        for (k, w) in radiance.0.iter().enumerate() {
            let (d, v) = (direct.lobes[k].pixels()[at], visibility.lit[k].pixels()[at]);
            let y = 0.2126 * w.x + 0.7152 * w.y + 0.0722 * w.z;
            lit += w.y * d * v;
            bounced += w.y * indirect.lobes[k].0.pixels()[at].y;
            shadow += y * v;
            unknown += y * visibility.unknown[k].pixels()[at];
            total += y;
            variance += (y * direct.stderr[k].pixels()[at] * v).powi(2);
            variance += (y * visibility.stderr[k].pixels()[at] * d).powi(2);
            shared += y * indirect.stderr[k].pixels()[at];
        }
        close(exr["direct_light0.G"][at], lit, "direct");
        close(exr["indirect_light0.G"][at], bounced, "indirect");
        close(exr["shadow_light0.Y"][at], shadow / total, "shadow");
        close(exr["unknown_light0.Y"][at], unknown / total, "unknown");
        close(exr["photo.R"][at], photo[at], "photo");
        close(exr["stderr_light0.Y"][at], (variance + shared * shared).sqrt(), "stderr");
        close(exr["room_error_light0.Y"][at], room_error.stderr.pixels()[at], "room error");
        close(exr["filled.Y"][at], filled.0.pixels()[at], "filled");
        let share = if 3 * (at % 48) < 48 { 1.0 } else { 64.0 / 255.0 };
        close(exr["mask_light0.Y"][at], share, "mask");
    }
    for name in [
        "A",
        "albedo.R",
        "normal.X",
        "normal.Z",
        "rough.Y",
        "depth.Z",
        "direct_light2.B",
        "indirect_light1.R",
    ] {
        assert!(exr.contains_key(name), "{name}");
    }
    assert_eq!(exr.len(), 4 + 4 * 3 + 3 + 9 + 3 * 9 + 2 + 3 + 1);
    assert!(!exr.contains_key("room_error_light1.Y"), "nothing is guessed there");
}

#[test]
fn a_light_that_is_off_still_has_its_shadow() {
    let mut inputs = write_inputs((8, 6), (8, 6), 1);
    inputs.radiance = Gather(vec![("light0".into(), Arc::new(Radiance(vec![Vec3::ZERO; 3])))]);
    let lit = inputs.visibility.0[0].1.lit.clone();
    let files = Write::default().run(inputs, &Context::default()).expect("sound inputs").files;
    let exr = exr_channels(&files.0[1].1);
    for (at, got) in exr["shadow_light0.Y"].iter().enumerate() {
        let mean = lit.iter().map(|plane| plane.pixels()[at]).sum::<f32>() / 3.0;
        assert!((got - mean).abs() < 1e-3);
    }
}

#[test]
fn small_diagnostics_grow_to_the_photo_and_can_be_left_out() {
    let files = |diagnostics| {
        let write = Write { diagnostics, ..Write::default() };
        write
            .run(write_inputs((64, 48), (32, 24), 2), &Context::default())
            .expect("sound inputs")
            .files
    };
    assert!(exr_channels(&files(true).0[1].1).values().all(|c| c.len() == 64 * 48));
    assert_eq!(exr_channels(&files(false).0[1].1).len(), 4 + 3 * 3 + 3);
    let first = files(true);
    assert!((0..8).all(|_| files(true) == first), "same inputs, same bytes");
}

#[test]
fn what_is_no_number_is_not_written() {
    for (name, bad) in [("picture", f32::NAN), ("light_rest", f32::INFINITY)] {
        let mut inputs = write_inputs((8, 6), (8, 6), 1);
        let mut plane = inputs.picture.0.clone();
        plane.set(3, 2, Vec3::new(0.0, bad, 0.0));
        match name {
            "picture" => inputs.picture = Arc::new(Picture(plane)),
            _ => inputs.residual = Arc::new(Layer::new(plane)),
        }
        let error = Write::default()
            .run(inputs, &Context::default())
            .err()
            .expect("a bug upstream")
            .to_string();
        assert!(error.contains(name) && error.contains("(3, 2)"), "{error}");
    }
}

#[test]
fn a_16_bit_photo_gives_a_16_bit_picture() {
    let mut inputs = write_inputs((8, 6), (8, 6), 1);
    Arc::make_mut(&mut inputs.encoding).sixteen_bit = true;
    let files = Write::default().run(inputs, &Context::default()).expect("sound inputs").files;
    let photo =
        read_photo(NamedBytes::new("picture.png", &files.0[0].1), Transfer::Srgb).expect("a PNG");
    assert_eq!(photo.bits, Bits::Sixteen);
}

#[needs("../shared/data/photos")]
#[test]
fn real_photos_are_read() {
    let photos = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/photos");
    for dir in fs::read_dir(&photos).expect("a folder").map(|entry| entry.expect("an entry").path())
    {
        let masks = dir.join("masks");
        let mut scene = ReadScene {
            photo: file(&dir.join("photo.png")),
            depth: DepthSpec {
                path: file(&dir.join("depth.exr")),
                kind: DepthKind::PlanarZ,
                scale: 1.0,
                shift: 0.0,
            },
            ..ReadScene::default()
        };
        for mask in if masks.is_dir() { files_below(&masks) } else { Vec::new() } {
            match mask.file_stem().and_then(|name| name.to_str()).expect("a plain name") {
                "outside" => scene.ignore = Some(file(&mask)),
                id if id.starts_with("lamp") => {
                    drop(scene.lights.insert(id.into(), LightSpec::Lamp { mask: file(&mask) }))
                }
                id => drop(scene.lights.insert(id.into(), LightSpec::Window { mask: file(&mask) })),
            }
        }
        let start = Instant::now();
        let (out, warnings) = run(&scene).expect("a real photo");
        let seconds = start.elapsed().as_secs_f64();
        let range =
            out.depth.0.pixels().iter().fold((f32::MAX, 0f32), |(l, h), &z| (l.min(z), h.max(z)));
        let holes = out.holes.0.pixels().iter().sum::<f32>() / out.holes.0.len() as f32;
        println!(
            "{}: {:?}, depth {range:?}, holes {holes:.3}, {seconds:.3} s, {warnings:?}",
            dir.display(),
            out.photo.0.size()
        );
        assert_eq!(out.depth.0.size(), (320, 240));
        assert!(range.0 > 0.1 && range.1 < 100.0, "{range:?}");
    }
}

/// Prints the cost of Write by compression:
/// `cargo test --release --test images -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement"]
fn write_time() {
    for compression in [Compression::None, Compression::Rle, Compression::Zip, Compression::Piz] {
        let write = Write { compression, ..Write::default() };
        let mut best = f64::MAX;
        let mut bytes = 0;
        for _ in 0..5 {
            let inputs = write_inputs((320, 240), (320, 240), 4);
            let start = Instant::now();
            let files = write.run(inputs, &Context::default()).expect("sound inputs").files;
            best = best.min(start.elapsed().as_secs_f64());
            bytes = files.0[1].1.len();
        }
        println!("{compression:?}: {:.1} ms, {bytes} bytes", 1e3 * best);
    }
}

/// Reads `path` as photo, as depth and as mask. Each must end in a scene or in an error that names
/// the file. Gives how many roles were read.
fn try_all(path: &Path, photo: &Path, depth: &Path) -> usize {
    let sound = ReadScene {
        photo: file(photo),
        depth: DepthSpec { path: file(depth), kind: DepthKind::PlanarZ, scale: 1.0, shift: 0.0 },
        ..ReadScene::default()
    };
    let as_photo = ReadScene { photo: file(path), ..sound.clone() };
    let mut as_depth = sound.clone();
    as_depth.depth.path = file(path);
    let mut as_mask = sound;
    as_mask.lights.insert("lamp".into(), LightSpec::Lamp { mask: file(path) });
    let name = path.file_name().and_then(|name| name.to_str()).expect("corpora have plain names");
    let mut read = 0;
    for (role, scene) in [("photo", as_photo), ("depth", as_depth), ("mask", as_mask)] {
        let start = Instant::now();
        match catch_unwind(AssertUnwindSafe(|| run(&scene))) {
            Ok(Ok(_)) => read += 1,
            Ok(Err(error)) => {
                assert!(error.to_string().contains(name), "{name} as {role}: {error}")
            }
            Err(_) => panic!("{} as {role}: a panic", path.display()),
        }
        let seconds = start.elapsed().as_secs_f64();
        assert!(seconds < 20.0, "{} as {role} took {seconds} s", path.display());
    }
    read
}

fn companions(dir: &Path) -> (PathBuf, PathBuf) {
    let (photo, depth) = (dir.join("sound.png"), dir.join("sound.npy"));
    fs::write(&photo, png(32, 32, false, |_, _| gray(0.5))).expect("writable");
    fs::write(&depth, npy((32, 32), |_, _| 2.0)).expect("writable");
    (photo, depth)
}

fn files_below(dir: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(dir).expect("a folder").map(|entry| entry.expect("an entry").path());
    let mut files: Vec<PathBuf> = entries
        .flat_map(|path| if path.is_dir() { files_below(&path) } else { vec![path] })
        .collect();
    files.sort();
    files
}

#[test]
fn our_own_corpus_of_bad_pictures() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (photo, depth) = companions(dir.path());
    let files = files_below(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bad/pictures"));
    assert!(files.len() >= 20, "{} files", files.len());
    for path in files {
        assert!(
            fs::metadata(&path).expect("a file").len() < 2048,
            "{} is no small file",
            path.display()
        );
        assert_eq!(try_all(&path, &photo, &depth), 0, "{} was read", path.display());
    }
}

#[needs("../shared/data/corpora")]
#[test]
fn every_file_of_the_corpora_is_read_or_refused() {
    let corpora = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/corpora");
    // Archive, and how many files its README promises at least.
    for (archive, promised) in
        [("openexr_damaged", 186), ("pngsuite", 175), ("zune_fuzz", 2670), ("valid_odd", 70)]
    {
        let packed = corpora.join(format!("{archive}.tar.xz"));
        let dir = tempfile::tempdir().expect("a temporary folder");
        let unpacked = dir.path().join("files");
        fs::create_dir(&unpacked).expect("writable");
        let tar = std::process::Command::new("tar")
            .arg("xf")
            .arg(&packed)
            .arg("-C")
            .arg(&unpacked)
            .status();
        assert!(tar.expect("tar runs").success());
        let (photo, depth) = companions(dir.path());
        let files = files_below(&unpacked);
        assert!(files.len() >= promised, "{archive}: wanted {promised} files, got {}", files.len());
        let start = Instant::now();
        let read: usize = files.par_iter().map(|path| try_all(path, &photo, &depth)).sum();
        let seconds = start.elapsed().as_secs_f64();
        println!(
            "{archive}: {} files in 3 roles, {read} read, the rest refused, {seconds:.1} s",
            files.len()
        );
        if let Ok(status) = fs::read_to_string("/proc/self/status") {
            let peak = status
                .lines()
                .find_map(|line| line.strip_prefix("VmHWM:"))
                .expect("Linux tells it")
                .trim();
            let kib: usize = peak.trim_end_matches(" kB").parse().expect("a number");
            println!("  peak memory so far {} MiB", kib >> 10);
            assert!(kib < 4 << 20, "peak memory {kib} KiB");
        }
    }
}
