//! Depth in every format that is read, sound and hostile.

mod common;

use std::io::{Cursor, Write};

use common::files::npy_of;
use image::{ExtendedColorType, ImageEncoder};
use relight::image::{DepthFile, NamedBytes, Plane, read_depth_file};
use tiff::encoder::{TiffEncoder, colortype};

const SIZE: (usize, usize) = (4, 3);

fn read(bytes: &[u8]) -> DepthFile {
    read_depth_file(NamedBytes::new("depth", bytes)).expect("a sound file")
}

fn refused(bytes: &[u8]) -> String {
    read_depth_file(NamedBytes::new("depth", bytes)).expect_err("it must be refused").to_string()
}

/// Numbers that every type can hold.
fn number(x: usize, y: usize) -> u8 {
    (10 + 3 * x + 20 * y) as u8
}

fn wanted() -> Plane<f32> {
    Plane::from_fn(SIZE.0, SIZE.1, |x, y| number(x, y).into())
}

/// A NumPy file with this description and these bytes behind it.
fn array(kind: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
    let order = if fortran { "True" } else { "False" };
    let text = format!("{{'descr': '{kind}', 'fortran_order': {order}, 'shape': {shape}, }}");
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    bytes.extend(format!("{text:<117}\n").as_bytes());
    bytes.extend(data);
    bytes
}

fn floats(order: impl Iterator<Item = (usize, usize)>) -> Vec<u8> {
    order.flat_map(|(x, y)| f32::from(number(x, y)).to_le_bytes()).collect()
}

/// Places row by row.
fn rows() -> impl Iterator<Item = (usize, usize)> {
    (0..12).map(|i| (i % 4, i / 4))
}

#[test]
fn every_number_type_of_numpy() {
    macro_rules! both_orders {
        ($($kind:literal $number:ty),+) => {$(
            let little = npy_of(concat!("<", $kind), SIZE, |x, y| {
                <$number>::from(number(x, y)).to_le_bytes().to_vec()
            });
            let big = npy_of(concat!(">", $kind), SIZE, |x, y| {
                <$number>::from(number(x, y)).to_be_bytes().to_vec()
            });
            assert_eq!(read(&little).values, wanted(), concat!("<", $kind));
            assert_eq!(read(&big).values, wanted(), concat!(">", $kind));
        )+};
    }
    both_orders!(
        "f2" half::f16, "f4" f32, "f8" f64, "u2" u16, "u4" u32, "u8" u64, "i2" i16, "i4" i32,
        "i8" i64
    );
    for kind in ["|u1", "|i1"] {
        assert_eq!(read(&npy_of(kind, SIZE, |x, y| vec![number(x, y)])).values, wanted());
    }
    let text = refused(&npy_of("<c8", SIZE, |_, _| vec![0; 8]));
    assert!(text.contains("NPY numbers: wanted integers, f2, f4 or f8, got"), "{text}");
}

#[test]
fn shapes_and_orders_of_numpy() {
    for shape in ["(3, 4)", "(1, 3, 4)", "(3, 4, 1)", "(1, 1, 3, 4)", "(1, 3, 4, 1)"] {
        assert_eq!(read(&array("<f4", false, shape, &floats(rows()))).values, wanted(), "{shape}");
        let columns = (0..12).map(|i| (i / 3, i % 3));
        assert_eq!(read(&array("<f4", true, shape, &floats(columns))).values, wanted(), "{shape}");
    }
    for (shape, wanted) in [
        ("(12,)", "NPY shape: wanted one plane, (height, width), got [12]"),
        ("(3, 3, 4)", "wanted one plane, (height, width), got [3, 3, 4]"),
        ("(3, 0)", "size in the header: wanted at least one pixel"),
        ("(30, 40)", "NPY data: wanted 30 x 40 numbers of 4 bytes, got 176 bytes"),
        ("(3000000, 4000000)", "size in the header: wanted at most 64 megapixels"),
        ("(4294967296, 4294967296)", "size in the header: wanted at most 64 megapixels"),
    ] {
        let text = refused(&array("<f4", false, shape, &floats(rows())));
        assert!(text.contains(wanted), "{shape}: {text}");
    }
    assert!(refused(b"\x93NUMPY\x01").contains("NPY header: wanted a valid header"));
}

/// An archive of arrays, compressed.
fn npz(arrays: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in arrays {
        let options = zip::write::SimpleFileOptions::default()
            .compression_method(zip::CompressionMethod::Deflated);
        archive.start_file(*name, options).expect("a sound name");
        archive.write_all(bytes).expect("it fits");
    }
    archive.finish().expect("a sound archive").into_inner()
}

#[test]
fn arrays_of_an_archive() {
    let depth = || array("<f4", false, "(1, 3, 4)", &floats(rows()));
    let ones = array("<f4", false, "(3, 4)", &[0.5f32; 12].map(f32::to_le_bytes).concat());
    assert_eq!(read(&npz(&[("arr_0.npy", depth())])).values, wanted());
    assert_eq!(read(&npz(&[("anything.npy", depth())])).values, wanted());
    let both = read(&npz(&[("confidence.npy", ones.clone()), ("depth.npy", depth())]));
    assert_eq!((both.values, both.confidence), (wanted(), Some(Plane::filled(4, 3, 0.5))));
    let text = refused(&npz(&[("a.npy", depth()), ("b.npy", ones.clone()), ("c.txt", vec![])]));
    assert_eq!(text, "depth: NPZ: wanted an array named `depth`, got a, b");
    assert!(refused(&npz(&[])).contains("got none") || refused(&npz(&[])).contains("format"));
    let many: Vec<_> = (0..300).map(|i| (format!("{i}.npy"), Vec::new())).collect();
    let many: Vec<_> = many.iter().map(|(name, bytes)| (name.as_str(), bytes.clone())).collect();
    assert!(refused(&npz(&many)).contains("NPZ: wanted at most 256 arrays, got 300"));
    // A cut archive, and every single byte of a sound one changed: an error or another number.
    let sound = npz(&[("depth.npy", depth())]);
    for at in 0..sound.len() {
        let mut changed = sound.clone();
        changed[at] ^= 0x55;
        let _ = read_depth_file(NamedBytes::new("depth", &changed));
        let _ = read_depth_file(NamedBytes::new("depth", &sound[..at]));
    }
}

fn pfm(header: &str, big: bool) -> Vec<u8> {
    let mut bytes = header.as_bytes().to_vec();
    for (x, y) in rows() {
        let value = f32::from(number(x, 2 - y));
        bytes.extend(if big { value.to_be_bytes() } else { value.to_le_bytes() });
    }
    bytes
}

#[test]
fn portable_float_maps() {
    assert_eq!(read(&pfm("Pf\n4 3\n-1.0\n", false)).values, wanted());
    assert_eq!(read(&pfm("Pf\n4 3\n1\n", true)).values, wanted());
    assert_eq!(read(&pfm("Pf 4\r3 -0.5\n", false)).values, wanted());
    for (header, wanted) in [
        ("PF\n4 3\n-1\n", "PFM: wanted one gray channel, `Pf`, got three channels, `PF`"),
        ("Pf\n4 -3\n-1\n", "PFM header: wanted width and height, got -3"),
        ("Pf\n4 3\n0\n", "PFM scale: wanted a number other than 0, got 0"),
        ("Pf\n4 3\nnan\n", "PFM scale"),
        ("Pf\n400 300\n-1\n", "PFM data: wanted 400 x 300 numbers of 4 bytes, got 48 bytes"),
        ("Pf\n4294967295 4294967295\n-1\n", "size in the header"),
        ("Pf\n4 0\n-1\n", "size in the header: wanted at least one pixel"),
    ] {
        let text = refused(&pfm(header, false));
        assert!(text.contains(wanted), "{header:?}: {text}");
    }
    assert!(refused(b"Pf\n4").contains("PFM header"));
    assert!(refused(&[b"Pf\n".to_vec(), vec![b'1'; 4000]].concat()).contains("within 128 bytes"));
}

fn tiff<C: colortype::ColorType>(values: Vec<C::Inner>) -> Vec<u8>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).expect("it can begin");
    encoder.write_image::<C>(4, 3, &values).expect("a sound picture");
    bytes.into_inner()
}

#[test]
fn tiff_of_every_number_type() {
    fn values<T: From<u8>>() -> Vec<T> {
        rows().map(|(x, y)| number(x, y).into()).collect()
    }
    for bytes in [
        tiff::<colortype::Gray8>(values()),
        tiff::<colortype::Gray16>(values()),
        tiff::<colortype::Gray32>(values()),
        tiff::<colortype::GrayI16>(values()),
        tiff::<colortype::GrayI32>(values()),
        tiff::<colortype::Gray32Float>(values()),
        tiff::<colortype::Gray64Float>(values()),
    ] {
        assert_eq!(read(&bytes).values, wanted());
    }
    let text = refused(&tiff::<colortype::RGB8>(vec![7; 36]));
    assert!(text.contains("pixels of a depth TIFF: wanted one gray sample"), "{text}");
    let sound = tiff::<colortype::Gray32Float>(values());
    for at in 0..sound.len() {
        for change in [0x55, 0xff] {
            let mut changed = sound.clone();
            changed[at] ^= change;
            let _ = read_depth_file(NamedBytes::new("depth", &changed));
        }
        let _ = read_depth_file(NamedBytes::new("depth", &sound[..at]));
    }
}

fn png(data: &[u8], color: ExtendedColorType) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    encoder.write_image(data, 4, 3, color).expect("a sound picture");
    bytes.into_inner()
}

#[test]
fn gray_levels_of_png() {
    let gray: Vec<u8> = rows().map(|(x, y)| number(x, y)).collect();
    let eight = read(&png(&gray, ExtendedColorType::L8));
    assert_eq!(eight.values, wanted());
    assert!(eight.notes[0].contains("8 bits, 256 steps"), "{:?}", eight.notes);
    let wide: Vec<u16> = gray.iter().map(|&v| v.into()).collect();
    let sixteen = read(&png(bytemuck::cast_slice(&wide), ExtendedColorType::L16));
    assert_eq!((sixteen.values, sixteen.notes.len()), (wanted(), 0));
    let mut three: Vec<u8> = gray.iter().flat_map(|&v| [v; 3]).collect();
    assert_eq!(read(&png(&three, ExtendedColorType::Rgb8)).values, wanted());
    three[7] ^= 1;
    let text = refused(&png(&three, ExtendedColorType::Rgb8));
    assert!(text.contains("wanted gray levels, got colors: a picture of depth"), "{text}");
}

/// A JPEG whose extended metadata, in segments of 100 bytes, holds these properties of GDepth.
fn jpeg(properties: &str) -> Vec<u8> {
    let mut photo = Cursor::new(Vec::new());
    let encoder = image::codecs::jpeg::JpegEncoder::new(&mut photo);
    encoder.write_image(&[9; 12], 4, 3, ExtendedColorType::L8).expect("a sound picture");
    let packet = format!("<rdf:Description {properties}/>");
    let mut bytes = photo.get_ref()[..2].to_vec();
    for part in packet.as_bytes().chunks(100) {
        let name = b"http://ns.adobe.com/xmp/extension/\0";
        let length = (2 + name.len() + 40 + part.len()) as u16;
        bytes.extend([0xff, 0xe1]);
        bytes.extend(length.to_be_bytes());
        bytes.extend(name);
        bytes.extend([7; 40]);
        bytes.extend(part);
    }
    bytes.extend(&photo.get_ref()[2..]);
    bytes
}

#[test]
fn depth_inside_a_jpeg() {
    use base64::Engine;
    use relight::image::Measure;
    let base64 = |bytes: &[u8]| base64::engine::general_purpose::STANDARD.encode(bytes);
    let levels: Vec<u8> = (0..12).map(|i| 20 * i).collect();
    let data = base64(&png(&levels, ExtendedColorType::L8));
    let all = |format: &str| {
        format!(
            "GDepth:Format='{format}' GDepth:Near=\"0.5\" GDepth:Far=\"4\" GDepth:Units=\"m\" \
            GDepth:MeasureType=\"OpticRay\" GDepth:Data=\"{data}\" GDepth:Confidence=\"{data}\""
        )
    };
    for format in ["RangeLinear", "RangeInverse"] {
        let file = read(&jpeg(&all(format)));
        assert_eq!((file.measure, file.scale), (Some(Measure::RayLength), Some(1.0)));
        assert_eq!(file.confidence.expect("it is stated").get(1, 0), 20.0 / 255.0);
        for (i, got) in file.values.pixels().iter().enumerate() {
            let n = 20.0 * i as f32 / 255.0;
            let inverse = 1.0 / (1.0 / 0.5 + n * (1.0 / 4.0 - 1.0 / 0.5));
            let wanted = if format == "RangeLinear" { 0.5 + 3.5 * n } else { inverse };
            assert!((got - wanted).abs() < 1e-5, "{format} {i}: {got}, wanted {wanted}");
        }
    }
    for (from, to, wanted) in [
        ("GDepth:Data", "GDepth:Date", "wanted metadata with GDepth:Data or DepthMap:DepthURI"),
        ("\"0.5\"", "\"NaN\"", "GDepth:Near: wanted a number above 0, got NaN"),
        ("\"4\"", "\"0.25\"", "GDepth:Far: wanted more than Near, 0.5, got 0.25"),
        ("RangeLinear", "Other", "GDepth:Format: wanted RangeLinear or RangeInverse, got Other"),
        (&data, "????", "depth in a JPEG: wanted base64"),
        (&data, "AAAA", "depth in a JPEG: wanted PNG or JPEG, got another format"),
    ] {
        let text = refused(&jpeg(&all("RangeLinear").replace(from, to)));
        assert!(text.contains(wanted), "{text}");
    }
    let sound = jpeg(&all("RangeLinear"));
    for at in 0..sound.len() {
        let _ = read_depth_file(NamedBytes::new("depth", &sound[..at]));
    }
}

#[test]
fn frames_of_phone_captures() {
    use relight::image::{Intrinsics, polycam, record3d, stray_scanner};
    let wide: Vec<u16> = rows().map(|(x, y)| 100 * u16::from(number(x, y))).collect();
    let depth = png(bytemuck::cast_slice(&wide), ExtendedColorType::L16);
    let sure = png(&[0, 1, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2], ExtendedColorType::L8);
    let named = |bytes| NamedBytes::new("frame", bytes);
    let matrix = b"1500.5, 0.0, 960.0\n0.0, 1501.5, 720.0\n0.0, 0.0, 1.0\n";
    // Frame 7 of a phone that is held upright: the camera's x points down. Its y points to the
    // right of the person in a world whose y points up, and its z forward.
    let half = 0.5f32.sqrt();
    let poses = format!(
        "timestamp, frame, x, y, z, qx, qy, qz, qw\n0.1, 000006, 0, 0, 0, 1, 0, 0, 0\n\
         0.2, 000007, 0, 0, 0, {half}, {}, 0, 0\n0.3, 000008, 0, 0, 0, nan, 0, 0, 0\n",
        -half
    );
    let stray = |number| {
        let (sure, odometry) = (Some(named(&sure)), Some(named(poses.as_bytes())));
        let file = stray_scanner(named(&depth), sure, Some(named(matrix)), odometry, number);
        file.expect("a sound frame")
    };
    assert_eq!([6, 7, 8, 9].map(|number| stray(number).quarters()), [0, 1, 0, 0]);
    let file = stray(6);
    assert_eq!((file.values.get(1, 2), file.scale), (5300.0, Some(0.001)));
    let confidence = file.confidence.as_ref().expect("it is stated");
    assert_eq!([0, 1, 2].map(|x| confidence.get(x, 0)), [0.0, 0.5, 1.0]);
    let camera =
        Intrinsics { width: 1920.0, height: 1440.0, fx: 1500.5, fy: 1501.5, cx: 960.0, cy: 720.0 };
    assert_eq!(file.camera, Some(camera));
    let json =
        br#"{"fx": 1500.5, "fy": 1501.5, "cx": 900, "cy": 720, "width": 1920, "height": 1440,
        "t_00": 0, "t_10": -0.9, "t_11": 0.1, "t_12": 0.4, "blur_score": 90.5}"#;
    let file = polycam(named(&depth), Some(named(&sure)), Some(named(json))).expect("sound");
    assert_eq!(file.camera, Some(Intrinsics { cx: 900.0, ..camera }));
    assert_eq!(file.confidence.as_ref().expect("it is stated").get(2, 0), 2.0 / 255.0);
    // Up is at the left of the stored picture: a clockwise quarter turn brings it to the top, and
    // the lower left pixel to the upper left.
    assert_eq!(file.quarters(), 1);
    let turned = file.clone().turned(1);
    assert_eq!(turned.values.size(), (3, 4));
    assert_eq!(turned.values.get(0, 0), file.values.get(0, 2));
    assert_eq!(turned.values.get(2, 3), file.values.get(3, 0));
    let wanted =
        Intrinsics { width: 1440.0, height: 1920.0, fx: 1501.5, fy: 1500.5, cx: 720.0, cy: 900.0 };
    assert_eq!(turned.camera, Some(wanted));
    assert_eq!((turned.quarters(), file.clone().turned(4) == file), (0, true));
    let level = |up: (f32, f32)| DepthFile { up: Some(up.into()), ..file.clone() }.quarters();
    let ups = [(0.1, 0.9), (0.9, 0.1), (0.1, -0.9), (0.1, 0.1), (f32::NAN, 0.0)];
    assert_eq!(ups.map(level), [0, 3, 2, 0, 0]);

    let metadata = br#"{"w": 720, "h": 960, "K": [700, 0, 0, 0, 701, 0, 360, 480, 1],
        "perFrameIntrinsicCoeffs": [[690, 691, 361, 481]], "poses": []}"#;
    let floats = npy_of("<f4", SIZE, |x, y| f32::from(number(x, y)).to_le_bytes().to_vec());
    let focal = |number| {
        let file = record3d(named(&floats), Some(named(metadata)), number).expect("it is sound");
        assert_eq!((file.scale, file.quarters()), (Some(1.0), 0));
        file.camera.expect("it is stated").fx
    };
    assert_eq!([0, 1].map(focal), [690.0, 700.0]);

    let refused = |result: Result<DepthFile, relight::image::ReadError>| {
        result.expect_err("it must be refused").to_string()
    };
    let text = refused(stray_scanner(named(&depth), None, Some(named(b"1,2,x")), None, 0));
    assert!(text.contains("wanted three rows of three numbers, got 2 numbers"), "{text}");
    let text = refused(polycam(named(&depth), None, Some(named(b"{}"))));
    assert!(text.contains("wanted JSON with fx, fy, cx, cy, width and height"), "{text}");
    let flat = br#"{"fx": 0, "fy": 1, "cx": 0, "cy": 0, "width": 1, "height": 1}"#;
    assert!(refused(polycam(named(&depth), None, Some(named(flat)))).contains("wanted sizes"));
    let text = refused(record3d(named(&floats), Some(named(b"{\"w\": 1}")), 0));
    assert!(text.contains("wanted JSON with w, h and K, got missing field"), "{text}");
    for end in 0..metadata.len() {
        let _ = record3d(named(&floats), Some(named(&metadata[..end])), 0);
        let odometry = Some(named(&poses.as_bytes()[..end.min(poses.len())]));
        let _ = stray_scanner(named(&depth), None, None, odometry, 7);
    }
}
