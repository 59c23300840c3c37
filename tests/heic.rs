//! Photos in HEIC, by the feature `heic`; libheif's own `heif-enc` makes the files.

#![cfg(feature = "heic")]

use std::process::Command;

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};
use needs::needs;
use relight::image::{NamedBytes, Photo, ReadError, Transfer, read_photo, read_photo_header};

/// The photo of a phone, 64 x 48 pixels and turned by its EXIF block.
fn jpeg(orientation: u16) -> Vec<u8> {
    let pixels: Vec<u8> = (0..48)
        .flat_map(|y| (0..64).map(move |x| (x, y)))
        .flat_map(|(x, y)| [if x < 32 { 220 } else { 40 }, if y < 24 { 180 } else { 60 }, 100])
        .collect();
    // 0x0112 is the orientation, 0xa405 the equivalent focal length in the EXIF directory.
    let mut exif = b"II*\0\x08\0\0\0\x02\0\x12\x01\x03\0\x01\0\0\0".to_vec();
    exif.extend(u32::from(orientation).to_le_bytes());
    exif.extend(b"\x69\x87\x04\0\x01\0\0\0\x26\0\0\0\0\0\0\0");
    exif.extend(b"\x01\0\x05\xa4\x03\0\x01\0\0\0\x1a\0\0\0\0\0\0\0");
    let icc = moxcms::ColorProfile::new_display_p3().encode().expect("it has a form");
    let mut jpeg = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut jpeg, 100);
    encoder.set_exif_metadata(exif).expect("JPEG has EXIF");
    encoder.set_icc_profile(icc).expect("JPEG has profiles");
    encoder.write_image(&pixels, 64, 48, ExtendedColorType::Rgb8).expect("memory takes it");
    jpeg
}

/// The same photo in HEIC.
fn heic(orientation: u16) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let [from, to] = ["a.jpg", "a.heic"].map(|name| folder.path().join(name));
    std::fs::write(&from, jpeg(orientation)).expect("a file can be written");
    let mut command = Command::new("heif-enc");
    // The system's program takes the system's libheif, which has an encoder.
    command.env_remove("LD_LIBRARY_PATH");
    command.args(["-q", "95", "-p", "chroma=444", "-o"]).arg(&to).arg(&from);
    let made = command.output().expect("it starts");
    assert!(made.status.success(), "{made:?}");
    std::fs::read(to).expect("it was written")
}

fn read(file: &[u8]) -> Result<Photo, ReadError> {
    read_photo(NamedBytes::new("photo.heic", file), Transfer::Srgb)
}

#[needs("/usr/bin/heif-enc")]
#[test]
fn a_heic_is_read_as_the_jpeg_that_it_was_made_from() {
    let jpeg = jpeg(1);
    // heif-enc copies the EXIF block and writes no transformation of its own: ISO/IEC 23008-12 has
    // a reader ignore the orientation in EXIF.
    for heic in [heic(1), heic(6)] {
        let [wanted, got] = [&jpeg, &heic].map(|file| read(file).expect("it is sound"));
        assert_eq!(got.warnings, Vec::<String>::new());
        assert_eq!(got.picture.0.size(), (64, 48));
        let pairs = got.picture.0.pixels().iter().zip(wanted.picture.0.pixels());
        let off: Vec<f32> = pairs.map(|(a, b)| (*a - *b).abs().max_element()).collect();
        let mean = off.iter().sum::<f32>() / off.len() as f32;
        assert!(mean < 0.01, "{mean}");

        let header = |file: &[u8]| read_photo_header(NamedBytes::new("photo", file));
        let [wanted, got] = [&jpeg, &heic].map(|file| header(file).expect("it is sound"));
        assert_eq!((got.size, got.is_turned), ((64, 48), false));
        assert_eq!((got.profile, got.extension), (wanted.profile, "heic"));
        assert_eq!(got.lens.equivalent_mm, Some(26.0), "{:?}", got.lens);
    }
}

#[needs("/usr/bin/heif-enc")]
#[test]
fn damaged_files_are_errors() {
    let heic = heic(1);
    let sizes = heic.windows(4).position(|w| w == b"ispe").expect("it has a size") + 8;
    let mut huge = heic.clone();
    huge[sizes..sizes + 8].copy_from_slice(&[0, 1, 0, 0, 0, 1, 0, 0]);
    let error = read(&huge).expect_err("65536 x 65536 pixels");
    assert!(error.file == "photo.heic" && !error.message().is_empty(), "{error}");
    for end in (0..heic.len()).step_by(7) {
        let name = NamedBytes::new("photo.heic", &heic[..end]);
        // A header may be sound before pixels that are cut off.
        let _ = read_photo_header(name);
        assert!(read(&heic[..end]).is_err(), "{end} of {} bytes", heic.len());
    }
    // Every byte of the boxes before the pixels.
    let pixels = heic.windows(4).position(|w| w == b"mdat").expect("it has pixels");
    for at in 0..pixels {
        let mut file = heic.clone();
        file[at] ^= 0xff;
        if let Ok(photo) = read(&file) {
            assert!(photo.picture.0.len() <= 64 << 20);
        }
    }
}
