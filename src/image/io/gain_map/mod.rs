//! The gain map of a photo: a second picture in its file that tells how much brighter the scene was
//! than the photo shows.
//!
//! In a JPEG, the second picture is found by the Multi-Picture Format (CIPA DC-007). Its numbers
//! have one of three forms: ISO 21496-1 (`iso.rs`), which wins where a file has several, Google's
//! Ultra HDR image format 1.1 (`ultra_hdr.rs`), and Apple's (`apple.rs`).

pub(super) mod apple;
mod gains;
mod iso;
mod ultra_hdr;

use ::image::ImageFormat;
use ::image::metadata::Orientation;

use super::jpeg_segments::{EXIF, XMP, segments};
use super::raster::{Raster, decode_turned};
use super::source::NamedBytes;
pub(in crate::image) use gains::Gains;
use gains::GainsOrReason;

/// Most pictures of one file that are looked at.
const MAX_PICTURES: usize = 16;

/// A gain map in a JPEG file, not decoded yet.
pub(in crate::image) struct GainMap<'a> {
    jpeg: &'a [u8],
    gains: Gains,
}

/// Finds the gain map of a JPEG file; `None` where there is none of a known form.
///
/// # Errors
/// There is one that cannot be used, and the reason.
pub(in crate::image) fn find(jpeg: &[u8]) -> Result<Option<GainMap<'_>>, &'static str> {
    let Some((at, places)) = segments(jpeg)
        .find(|(_, marker, payload)| *marker == 0xe2 && payload.starts_with(b"MPF\0"))
        .and_then(|(at, _, payload)| Some((at + 4, pictures(&payload[4..])?)))
    else {
        return Ok(None);
    };
    let found = places.into_iter().find_map(|(offset, size)| {
        let from = at.checked_add(offset)?;
        let picture = jpeg.get(from..from.checked_add(size)?)?;
        Some((picture, gains(picture, jpeg)?))
    });
    found.map(|(jpeg, gains)| Ok(GainMap { jpeg, gains: gains? })).transpose()
}

/// Finds and decodes the gain map of a JPEG file whose picture is turned by `orientation`.
///
/// # Errors
/// There is one that cannot be used, or is damaged or too large: the reason.
pub(in crate::image) fn read(
    source: NamedBytes,
    orientation: Orientation,
) -> Result<Option<(Raster, Gains)>, String> {
    let Some(map) = find(source.bytes)? else { return Ok(None) };
    let jpeg = NamedBytes { bytes: map.jpeg, ..source };
    let raster = decode_turned(jpeg, ImageFormat::Jpeg, Some(orientation));
    Ok(Some((raster.map_err(|e| e.message())?, map.gains)))
}

/// Offset from the block's own start and size of the pictures after the first.
fn pictures(tiff: &[u8]) -> Option<Vec<(usize, usize)>> {
    let little = match tiff.get(..4)? {
        b"II*\0" => true,
        b"MM\0*" => false,
        _ => return None,
    };
    let short = |at: usize| {
        let bytes = tiff.get(at..at.checked_add(2)?)?.try_into().ok()?;
        Some(if little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) })
    };
    let long = |at: usize| {
        let bytes = tiff.get(at..at.checked_add(4)?)?.try_into().ok()?;
        Some(if little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) } as usize)
    };
    let directory = long(4)?;
    let count = usize::from(short(directory)?);
    let entry = (0..count).map(|i| directory + 2 + 12 * i).find(|at| short(*at) == Some(0xb002))?;
    let (bytes, list) = (long(entry + 4)?, long(entry + 8)?);
    let entries = (0..(bytes / 16).min(MAX_PICTURES)).map(|i| list + 16 * i);
    let places = entries.map_while(|at| Some((long(at + 8)?, long(at + 4)?)));
    Some(places.filter(|(offset, _)| *offset > 0).collect())
}

/// The gains of a JPEG picture by the first of its forms that can be used; `None` where it is not a
/// gain map. `photo` is the file that contains it.
fn gains(picture: &[u8], photo: &[u8]) -> Option<GainsOrReason> {
    let exif = || {
        let (.., payload) = segments(photo)
            .find(|(_, marker, payload)| *marker == 0xe1 && payload.starts_with(EXIF))?;
        Some(&payload[EXIF.len()..])
    };
    let xmp = segments(picture)
        .find(|(_, marker, payload)| *marker == 0xe1 && payload.starts_with(XMP))
        .and_then(|(.., payload)| std::str::from_utf8(&payload[XMP.len()..]).ok());
    let iso = segments(picture)
        .filter(|(_, marker, _)| *marker == 0xe2)
        .find_map(|(.., payload)| iso::gains(payload.strip_prefix(iso::NAME)?));
    let forms = [iso, xmp.and_then(ultra_hdr::gains), xmp.and_then(|xmp| apple::gains(xmp, exif))];
    let found = || forms.into_iter().flatten();
    found().find(Result::is_ok).or_else(|| found().next())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Photo, Transfer, read_photo};
    use ::image::codecs::jpeg::JpegEncoder;
    use ::image::{ExtendedColorType, ImageEncoder};
    use glam::{Mat3, Vec3};

    const META: &str = r#"<x:xmpmeta><rdf:RDF><rdf:Description hdrgm:Version="1.0"
        hdrgm:GainMapMin="0" hdrgm:GainMapMax="3" hdrgm:Gamma="1" hdrgm:OffsetSDR="0" hdrgm:OffsetHDR="0"
        hdrgm:BaseRenditionIsHDR="False"/></rdf:RDF></x:xmpmeta>"#;

    fn encoded(size: (u32, u32), color: ExtendedColorType, pixels: &[u8]) -> Vec<u8> {
        let mut file = Vec::new();
        JpegEncoder::new_with_quality(&mut file, 100)
            .write_image(pixels, size.0, size.1, color)
            .expect("memory can be written to");
        file
    }

    /// A gray map of 16 x 8 pixels with a value for each column.
    fn map(value: impl Fn(usize) -> u8) -> Vec<u8> {
        let row: Vec<u8> = (0..16).map(value).collect();
        encoded((16, 8), ExtendedColorType::L8, &row.repeat(8))
    }

    fn with_segment(jpeg: &[u8], marker: u8, payload: &[u8]) -> Vec<u8> {
        let length = (payload.len() as u16 + 2).to_be_bytes();
        [&jpeg[..2], &[0xff, marker], &length, payload, &jpeg[2..]].concat()
    }

    /// A photo that is white on its right half.
    fn photo() -> Vec<u8> {
        let row = [[128; 96], [255; 96]].concat();
        encoded((64, 32), ExtendedColorType::Rgb8, &row.repeat(32))
    }

    /// A photo in a file with a second picture.
    fn with_picture(photo: &[u8], second: &[u8]) -> Vec<u8> {
        let mut mpf = b"MPF\0II*\0\x08\0\0\0".to_vec();
        mpf.extend(1u16.to_le_bytes());
        mpf.extend(0xb002u16.to_le_bytes());
        mpf.extend(7u16.to_le_bytes());
        mpf.extend(32u32.to_le_bytes());
        mpf.extend(26u32.to_le_bytes());
        mpf.extend(0u32.to_le_bytes());
        let size = photo.len() + 4 + mpf.len() + 32;
        // Offsets count from the TIFF header, which lies behind 2 + 4 + 4 bytes.
        for [size, offset] in [[size, 0], [second.len(), size - 10]] {
            mpf.extend(0u32.to_le_bytes());
            mpf.extend((size as u32).to_le_bytes());
            mpf.extend((offset as u32).to_le_bytes());
            mpf.extend(0u32.to_le_bytes());
        }
        let photo = with_segment(photo, 0xe2, &mpf);
        assert_eq!(photo.len(), size);
        [&photo[..], second].concat()
    }

    fn xmp(text: &str) -> Vec<u8> {
        [XMP, text.as_bytes()].concat()
    }

    /// A photo that is white on its right half, and a map of an eighth of its size.
    fn ultra_hdr(meta: &str, map_value: impl Fn(usize) -> u8) -> Vec<u8> {
        with_picture(&photo(), &with_segment(&map(map_value), 0xe1, &xmp(meta)))
    }

    fn read(file: &[u8]) -> Photo {
        read_photo(NamedBytes::new("photo.jpg", file), Transfer::Srgb).expect("it is sound")
    }

    #[test]
    fn saturated_highlights_come_back() {
        // 170 of 255 of three stops: a gain of 4.
        let photo = read(&ultra_hdr(META, |x| if x < 8 { 0 } else { 170 }));
        let [dark, bright] = [8, 56].map(|x| photo.picture.0.get(x, 16));
        assert!((dark.x - Transfer::Srgb.decode(128.0 / 255.0)).abs() < 0.01, "{dark}");
        assert!((bright.x - 4.0).abs() < 0.1, "{bright}");
        assert_eq!(photo.clipped.0.get(56, 16), 0.0);
        let photo = read(&ultra_hdr(META, |x| if x < 8 { 0 } else { 255 }));
        assert_eq!(photo.clipped.0.get(56, 16), 1.0, "the map is saturated, too");
    }

    #[test]
    fn lists_by_channel_are_read() {
        let list = META.replace(
            r#"hdrgm:GainMapMax="3""#,
            r#"x="<hdrgm:GainMapMax><rdf:Seq><rdf:li>3</rdf:li><rdf:li>2</rdf:li><rdf:li>1</rdf:li></rdf:Seq></hdrgm:GainMapMax>""#,
        );
        let bright = read(&ultra_hdr(&list, |_| 255)).picture.0.get(56, 16);
        assert!((bright - Vec3::new(8.0, 4.0, 2.0)).abs().max_element() < 0.1, "{bright}");
    }

    /// Numbers of ISO 21496-1 as fractions over `denominator`: the headrooms, then each channel.
    fn iso(flags: u8, denominator: u32, channels: &[[i32; 5]]) -> Vec<u8> {
        let mut block = [iso::NAME, &[0, 0, 0, 0, flags]].concat();
        let is_common = flags & 8 != 0;
        if is_common {
            block.extend(denominator.to_be_bytes());
        }
        for number in [0, 3 * denominator as i32].iter().chain(channels.iter().flatten()) {
            block.extend(number.to_be_bytes());
            if !is_common {
                block.extend(denominator.to_be_bytes());
            }
        }
        block
    }

    /// A bright pixel, and how far it is from `wanted`.
    fn bright(file: &[u8], wanted: Vec3) -> (Vec3, f32) {
        let photo = read(file);
        assert_eq!(photo.warnings, Vec::<String>::new());
        let bright = photo.picture.0.get(56, 16);
        (bright, (bright - wanted).abs().max_element())
    }

    #[test]
    fn maps_of_iso_21496_brighten_by_their_equation() {
        // Min -1, max 3, gamma 2, offsets 1/64 and 1/32, all over 64: at 170 of 255,
        // L = -1 + 4 (2/3)^(1/2) and the scene is (1 + 1/64) 2^L - 1/32.
        let numbers = [-64, 192, 128, 1, 2];
        let stops = -1.0 + 4.0 * (170.0f32 / 255.0).sqrt();
        let wanted = Vec3::splat((1.0 + 1.0 / 64.0) * stops.exp2() - 1.0 / 32.0);
        for flags in [0x40, 0x48] {
            let block = iso(flags, 64, &[numbers]);
            let map = with_segment(&map(|_| 170), 0xe2, &block);
            // The photo's own segment has the versions only; the map's XMP packet, of other
            // numbers, loses.
            let versions = [iso::NAME, &[0; 4]].concat();
            let photo = with_segment(&photo(), 0xe2, &versions);
            let file = with_picture(&photo, &with_segment(&map, 0xe1, &xmp(META)));
            let (got, off) = bright(&file, wanted);
            assert!(off < 0.02, "{flags:x}: {got}, wanted {wanted}");
        }
    }

    #[test]
    fn maps_of_three_channels_apply_before_the_color_profile() {
        let display_p3 = moxcms::ColorProfile::new_display_p3().encode().expect("it has a form");
        let icc = [b"ICC_PROFILE\0\x01\x01", &display_p3[..]].concat();
        // Of CSS Color 4; the photo is white, so its stored numbers are those of Display P3, too.
        let from_p3 = Mat3::from_cols(
            Vec3::new(1.224_94, -0.042_057, -0.019_638),
            Vec3::new(-0.224_94, 1.042_057, -0.078_636),
            Vec3::new(0.0, 0.0, 1.098_274),
        );
        let gray = |max: i32| [0, max, 1, 0, 0];
        let channels = [gray(2), gray(3), gray(1)];
        let gains = Vec3::new(4.0, 8.0, 2.0);
        let by = |flags| with_segment(&map(|_| 255), 0xe2, &iso(flags, 1, &channels));
        let colored = with_segment(&photo(), 0xe2, &icc);
        for (photo, map, wanted) in [
            (&photo(), by(0xc0), gains),
            (&colored, by(0xc0), from_p3 * gains),
            (&colored, with_segment(&by(0x80), 0xe2, &icc), from_p3 * gains),
            (&photo(), with_segment(&by(0x80), 0xe2, &icc), from_p3 * gains),
            (&photo(), with_segment(&by(0xc0), 0xe2, &icc), gains),
            (&colored, by(0x80), from_p3 * gains),
        ] {
            let (got, off) = bright(&with_picture(photo, &map), wanted.max(Vec3::ZERO));
            assert!(off < 0.02, "{got}, wanted {wanted}");
        }
    }

    /// An EXIF block whose maker note, from an iPhone, has two fractions over 1000.
    fn maker_note(headroom: i32, gain: i32) -> Vec<u8> {
        let mut note = b"Apple iOS\0\0\x01MM\0\x02".to_vec();
        for (tag, at) in [(0x21u16, 40u32), (0x30, 48)] {
            note.extend(tag.to_be_bytes());
            note.extend([0, 10, 0, 0, 0, 1]);
            note.extend(at.to_be_bytes());
        }
        for number in [headroom, 1000, gain, 1000] {
            note.extend(number.to_be_bytes());
        }
        assert_eq!(note.len(), 56);
        let directory = |tag: u16, kind: u8, count: u32, value: u32| {
            let mut bytes = vec![0, 1];
            bytes.extend(tag.to_be_bytes());
            bytes.extend([0, kind]);
            bytes.extend(count.to_be_bytes());
            bytes.extend(value.to_be_bytes());
            bytes.extend([0; 4]);
            bytes
        };
        let exif = directory(0x8769, 4, 1, 26);
        let maker = directory(0x927c, 7, note.len() as u32, 44);
        [EXIF, b"MM\0*\0\0\0\x08", &exif, &maker, &note].concat()
    }

    const APPLE: &str = "<rdf:Description><HDRGainMap:HDRGainMapVersion>65536</HDRGainMap:HDRGainMapVersion></rdf:Description>";

    /// A photo of an iPhone, whose map is 170 of 255 everywhere.
    fn iphone(exif: Option<&[u8]>, text: &str) -> Vec<u8> {
        let map = with_segment(&map(|_| 170), 0xe1, &xmp(text));
        let photo = exif.map_or(photo(), |exif| with_segment(&photo(), 0xe1, exif));
        with_picture(&photo, &map)
    }

    #[test]
    fn maps_of_apple_brighten_by_their_headroom() {
        // Rec. 709 of 2/3 is ((2/3 + 0.099) / 1.099)^(1 / 0.45) = 0.447.
        let decoded = ((170.0f32 / 255.0 + 0.099) / 1.099).powf(1.0 / 0.45);
        let wanted = |stops: f32| Vec3::splat(1.0 + (stops.exp2() - 1.0) * decoded);
        for (headroom, gain, stops) in
            [(800, 5, 1.7), (800, 1000, 1.5), (1010, 5, 2.65), (1010, 1000, 2.0)]
        {
            let (got, off) =
                bright(&iphone(Some(&maker_note(headroom, gain)), APPLE), wanted(stops));
            assert!(off < 0.02, "{headroom} {gain}: {got}, wanted {}", wanted(stops));
        }
        // Version 2 states the headroom, as an element or an attribute.
        let element = APPLE.replace(
            "</rdf",
            "<HDRGainMap:HDRGainMapHeadroom>4</HDRGainMap:HDRGainMapHeadroom></rdf",
        );
        let attributes = r#"<rdf:Description HDRGainMap:HDRGainMapVersion="131072" HDRGainMap:HDRGainMapHeadroom="4"/>"#;
        for text in [&element[..], attributes] {
            for exif in [None, Some(&maker_note(800, 5)[..])] {
                let (got, off) = bright(&iphone(exif, text), wanted(2.0));
                assert!(off < 0.02, "{got}, wanted {}", wanted(2.0));
            }
        }
    }

    #[test]
    fn maps_that_cannot_be_used_are_named_and_left_out() {
        let plain = read(&photo());
        let iso_map =
            |block: &[u8]| with_picture(&photo(), &with_segment(&map(|_| 255), 0xe2, block));
        let sound = iso(0x40, 1, &[[0, 3, 1, 0, 0]]);
        let cut = iso::NAME.len() + 5;
        let mut cases: Vec<(Vec<u8>, &str)> =
            (cut..sound.len()).map(|end| (iso_map(&sound[..end]), "cut off")).collect();
        let mut later = sound.clone();
        later[cut - 4] = 1;
        let mut backward = sound.clone();
        backward[cut + 3] = 5;
        let edited = iphone(None, APPLE);
        let mut cyclic = maker_note(800, 5);
        // The maker note's fraction lies in its own directory.
        let at = cyclic.len() - 56 + 16 + 8;
        cyclic[at..at + 4].copy_from_slice(&[0xff; 4]);
        cases.extend([
            (iso_map(&later), "later"),
            (iso_map(&backward), "HDR itself"),
            (iso_map(&iso(0x40, 0, &[[0, 3, 1, 0, 0]])), "numbers"),
            (iso_map(&iso(0x48, 0, &[[0, 0, 0, 0, 0]])), "numbers"),
            (iso_map(&iso(0x40, 1, &[[0, i32::MAX, 1, 0, 0]])), "numbers"),
            (iso_map(&iso(0x40, 1, &[[3, 0, 1, 0, 0]])), "numbers"),
            (iso_map(&iso(0x40, 1, &[[0, 3, 0, 0, 0]])), "numbers"),
            (iso_map(&iso(0x40, 1, &[[0, 3, 1, i32::MIN, 0]])), "numbers"),
            (edited, "lacks its headroom"),
            (iphone(Some(&maker_note(i32::MIN, i32::MIN)), APPLE), "numbers"),
            (iphone(Some(&cyclic), APPLE), "lacks its headroom"),
            (
                iphone(
                    None,
                    r#"HDRGainMap:HDRGainMapVersion="2" HDRGainMap:HDRGainMapHeadroom="inf""#,
                ),
                "lacks its headroom",
            ),
            (
                iphone(
                    None,
                    r#"HDRGainMap:HDRGainMapVersion="2" HDRGainMap:HDRGainMapHeadroom="1e9""#,
                ),
                "numbers",
            ),
        ]);
        // A map of 65535 x 65535 pixels in a few hundred bytes.
        let map = with_segment(&map(|_| 255), 0xe2, &sound);
        let mut huge = map.clone();
        let frame = huge.windows(2).position(|w| w == [0xff, 0xc0]).expect("it has a frame");
        huge[frame + 5..frame + 9].copy_from_slice(&[0xff; 4]);
        cases.push((with_picture(&photo(), &huge), "size in the header"));
        let mut torn = map;
        torn.truncate(frame);
        cases.push((with_picture(&photo(), &torn), "content"));
        for (file, why) in cases {
            let photo = read(&file);
            assert_eq!(photo.picture, plain.picture, "{why}");
            assert_eq!(photo.clipped, plain.clipped, "{why}");
            let [warning] = &photo.warnings[..] else { panic!("{why}: {:?}", photo.warnings) };
            assert!(
                warning.starts_with("its gain map is left out: ") && warning.contains(why),
                "{warning}"
            );
        }
    }

    #[test]
    fn maps_that_make_no_sense_are_left_out() {
        let plain = read(&photo());
        for (from, to) in [
            (r#"GainMapMax="3""#, r#"GainMapMax="400""#),
            (r#"GainMapMax="3""#, r#"GainMapMax="nan""#),
            (r#"GainMapMax="3""#, ""),
            (r#"Gamma="1""#, r#"Gamma="0""#),
            (r#"Version="1.0""#, ""),
            ("False", "True"),
        ] {
            let meta = META.replace(from, to).replace("hdrgm: ", "");
            let photo = read(&ultra_hdr(&meta, |_| 255));
            assert_eq!(photo.picture, plain.picture, "{from} -> {to}");
        }
        // Every truncation and every offset beyond the end.
        let whole = ultra_hdr(META, |_| 255);
        assert!((0..whole.len()).all(|end| matches!(find(&whole[..end]), Ok(None))));
        let iso = with_segment(&map(|_| 255), 0xe2, &iso(0x40, 1, &[[0, 3, 1, 0, 0]]));
        let iso = with_picture(&photo(), &iso);
        for whole in [whole, iso, iphone(Some(&maker_note(800, 5)), APPLE)] {
            for at in 0..whole.len() {
                for byte in [0, 0x7f, 0xff] {
                    let mut file = whole.clone();
                    file[at] = byte;
                    // Nothing panics; pictures that point at each other are not followed.
                    let _ = find(&file);
                }
            }
        }
    }
}
