//! The gain map of an Ultra HDR photo: a second picture in a JPEG file that tells how much brighter
//! the scene was than the photo shows.
//!
//! The form is that of Google's Ultra HDR image format 1.1: the second picture is found by the
//! Multi-Picture Format (CIPA DC-007), its numbers are in its XMP packet under `hdrgm`. With g the
//! map in 0..1, the logarithm of the gain is L = min + (max - min) g^(1 / gamma), and the scene is
//! (photo + offset_sdr) 2^L - offset_hdr, all in linear light.

use glam::Vec3;

use super::jpeg_segments::{XMP, segments};
use super::raster::{Raster, decode_turned};
use super::source::{NamedBytes, ReadError};
use crate::image::{Plane, resize};

/// Most pictures of one file that are looked at.
const MAX_PICTURES: usize = 16;
/// The largest exponent of a gain that is believed: cameras write 2 to 4.
const MAX_STOPS: f32 = 10.0;

/// A gain map in a file, not decoded yet.
pub(in crate::image) struct GainMap<'a> {
    jpeg: &'a [u8],
    min: Vec3,
    max: Vec3,
    gamma: Vec3,
    offset_sdr: Vec3,
    offset_hdr: Vec3,
}

/// Finds the gain map of a JPEG file; `None` where there is none, or none of this form.
pub(in crate::image) fn find(jpeg: &[u8]) -> Option<GainMap<'_>> {
    let (at, payload) = segments(jpeg)
        .find(|(_, marker, payload)| *marker == 0xe2 && payload.starts_with(b"MPF\0"))
        .map(|(at, _, payload)| (at + 4, &payload[4..]))?;
    pictures(payload)?.into_iter().find_map(|(offset, size)| {
        let from = at.checked_add(offset)?;
        gain_map(jpeg.get(from..from.checked_add(size)?)?)
    })
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

/// A JPEG picture as a gain map, where its XMP packet says that it is one.
fn gain_map(jpeg: &[u8]) -> Option<GainMap<'_>> {
    let xmp = segments(jpeg)
        .find(|(_, marker, payload)| *marker == 0xe1 && payload.starts_with(XMP))
        .and_then(|(.., payload)| std::str::from_utf8(&payload[XMP.len()..]).ok())?;
    let base_is_hdr = xmp.contains("hdrgm:BaseRenditionIsHDR=\"True\"");
    if !xmp.contains("hdrgm:Version") || base_is_hdr {
        return None;
    }
    let number = |name: &str, usual: f32| numbers(xmp, name, usual);
    let map = GainMap {
        jpeg,
        min: number("GainMapMin", 0.0)?,
        max: number("GainMapMax", f32::NAN)?,
        gamma: number("Gamma", 1.0)?,
        offset_sdr: number("OffsetSDR", 1.0 / 64.0)?,
        offset_hdr: number("OffsetHDR", 1.0 / 64.0)?,
    };
    let stops = map.min.abs().max(map.max.abs()).max_element();
    let offsets = map.offset_sdr.abs().max(map.offset_hdr.abs()).max_element();
    let is_sensible = map.max.is_finite()
        && stops <= MAX_STOPS
        && map.min.cmple(map.max).all()
        && map.gamma.min_element() > 1e-3
        && map.gamma.max_element() < 1e3
        && offsets <= 1.0;
    is_sensible.then_some(map)
}

/// The numbers of `hdrgm:name`, as an attribute for all channels or as a list of three; `usual`
/// where it is missing.
fn numbers(xmp: &str, name: &str, usual: f32) -> Option<Vec3> {
    let number = |text: &str| text.trim().parse::<f32>().ok().filter(|n| n.is_finite());
    if let Some((_, rest)) = xmp.split_once(&format!("hdrgm:{name}=\"")) {
        return number(rest.split_once('"')?.0).map(Vec3::splat);
    }
    let Some((_, rest)) = xmp.split_once(&format!("<hdrgm:{name}>")) else {
        return Some(Vec3::splat(usual));
    };
    let (list, _) = rest.split_once(&format!("</hdrgm:{name}>"))?;
    let items = list.split("<rdf:li>").skip(1).take(3);
    let items: Option<Vec<f32>> = items.map(|item| number(item.split_once('<')?.0)).collect();
    match items?[..] {
        [] => number(list).map(Vec3::splat),
        [all] => Some(Vec3::splat(all)),
        [r, g, b] => Some(Vec3::new(r, g, b)),
        _ => None,
    }
}

impl GainMap<'_> {
    /// Brightens a linear picture to the light of the scene. A pixel is saturated no more where the
    /// map has a gain for it below its largest number.
    ///
    /// # Errors
    /// The map is damaged or too large.
    pub(in crate::image) fn apply(
        &self,
        source: NamedBytes,
        photo: &Raster,
        picture: &mut Plane<Vec3>,
        clipped: &mut Plane<f32>,
    ) -> Result<(), ReadError> {
        let map = decode_turned(
            NamedBytes { bytes: self.jpeg, ..source },
            ::image::ImageFormat::Jpeg,
            Some(photo.orientation),
        )?;
        let stored = resize(&map.colors(|v| v), picture.width(), picture.height());
        let pixels = picture.pixels_mut().iter_mut().zip(clipped.pixels_mut()).zip(stored.pixels());
        for ((pixel, clipped), &g) in pixels {
            let g = Vec3::from_array(std::array::from_fn(|c| g[c].powf(self.gamma[c].recip())));
            let stops = self.min + (self.max - self.min) * g;
            let gain = Vec3::from_array(stops.to_array().map(f32::exp2));
            *pixel = ((*pixel + self.offset_sdr) * gain - self.offset_hdr).max(Vec3::ZERO);
            if g.max_element() < 253.5 / 255.0 {
                *clipped = 0.0;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Photo, Transfer, read_photo};
    use ::image::codecs::jpeg::JpegEncoder;
    use ::image::{ExtendedColorType, ImageEncoder};

    const META: &str = r#"<x:xmpmeta><rdf:RDF><rdf:Description hdrgm:Version="1.0"
        hdrgm:GainMapMin="0" hdrgm:GainMapMax="3" hdrgm:Gamma="1" hdrgm:OffsetSDR="0" hdrgm:OffsetHDR="0"
        hdrgm:BaseRenditionIsHDR="False"/></rdf:RDF></x:xmpmeta>"#;

    fn jpeg((width, height): (u32, u32), value: impl Fn(u32, u32) -> u8) -> Vec<u8> {
        let pixels: Vec<u8> = (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .map(|(x, y)| value(x, y))
            .collect();
        let mut file = Vec::new();
        JpegEncoder::new_with_quality(&mut file, 100)
            .write_image(&pixels, width, height, ExtendedColorType::L8)
            .expect("memory can be written to");
        file
    }

    fn with_segment(jpeg: &[u8], marker: u8, payload: &[u8]) -> Vec<u8> {
        let length = (payload.len() as u16 + 2).to_be_bytes();
        [&jpeg[..2], &[0xff, marker], &length, payload, &jpeg[2..]].concat()
    }

    /// A photo that is white on its right half, and a map of an eighth of its size.
    fn ultra_hdr(meta: &str, map_value: impl Fn(u32, u32) -> u8) -> Vec<u8> {
        let photo = jpeg((64, 32), |x, _| if x < 32 { 128 } else { 255 });
        let xmp = [b"http://ns.adobe.com/xap/1.0/\0", meta.as_bytes()].concat();
        let map = with_segment(&jpeg((16, 8), map_value), 0xe1, &xmp);
        let mut mpf = b"MPF\0II*\0\x08\0\0\0".to_vec();
        mpf.extend(1u16.to_le_bytes());
        mpf.extend(0xb002u16.to_le_bytes());
        mpf.extend(7u16.to_le_bytes());
        mpf.extend(32u32.to_le_bytes());
        mpf.extend(26u32.to_le_bytes());
        mpf.extend(0u32.to_le_bytes());
        let size = photo.len() + 4 + mpf.len() + 32;
        // Offsets count from the TIFF header, which lies behind 2 + 4 + 4 bytes.
        for [size, offset] in [[size, 0], [map.len(), size - 10]] {
            mpf.extend(0u32.to_le_bytes());
            mpf.extend((size as u32).to_le_bytes());
            mpf.extend((offset as u32).to_le_bytes());
            mpf.extend(0u32.to_le_bytes());
        }
        let photo = with_segment(&photo, 0xe2, &mpf);
        assert_eq!(photo.len(), size);
        [photo, map].concat()
    }

    fn read(file: &[u8]) -> Photo {
        read_photo(NamedBytes::new("photo.jpg", file), Transfer::Srgb).expect("it is sound")
    }

    #[test]
    fn saturated_highlights_come_back() {
        // 170 of 255 of three stops: a gain of 4.
        let photo = read(&ultra_hdr(META, |x, _| if x < 8 { 0 } else { 170 }));
        let [dark, bright] = [8, 56].map(|x| photo.picture.0.get(x, 16));
        assert!((dark.x - Transfer::Srgb.decode(128.0 / 255.0)).abs() < 0.01, "{dark}");
        assert!((bright.x - 4.0).abs() < 0.1, "{bright}");
        assert_eq!(photo.clipped.0.get(56, 16), 0.0);
        let photo = read(&ultra_hdr(META, |x, _| if x < 8 { 0 } else { 255 }));
        assert_eq!(photo.clipped.0.get(56, 16), 1.0, "the map is saturated, too");
    }

    #[test]
    fn lists_by_channel_are_read() {
        let list = META.replace(
            r#"hdrgm:GainMapMax="3""#,
            r#"x="<hdrgm:GainMapMax><rdf:Seq><rdf:li>3</rdf:li><rdf:li>2</rdf:li><rdf:li>1</rdf:li></rdf:Seq></hdrgm:GainMapMax>""#,
        );
        let bright = read(&ultra_hdr(&list, |_, _| 255)).picture.0.get(56, 16);
        assert!((bright - Vec3::new(8.0, 4.0, 2.0)).abs().max_element() < 0.1, "{bright}");
    }

    #[test]
    fn maps_that_make_no_sense_are_left_out() {
        let plain = read(&jpeg((64, 32), |x, _| if x < 32 { 128 } else { 255 }));
        for (from, to) in [
            (r#"GainMapMax="3""#, r#"GainMapMax="400""#),
            (r#"GainMapMax="3""#, r#"GainMapMax="nan""#),
            (r#"GainMapMax="3""#, ""),
            (r#"Gamma="1""#, r#"Gamma="0""#),
            (r#"Version="1.0""#, ""),
            ("False", "True"),
        ] {
            let meta = META.replace(from, to).replace("hdrgm: ", "");
            let photo = read(&ultra_hdr(&meta, |_, _| 255));
            assert_eq!(photo.picture, plain.picture, "{from} -> {to}");
        }
        // Every truncation and every offset beyond the end.
        let whole = ultra_hdr(META, |_, _| 255);
        assert!((0..whole.len()).all(|end| find(&whole[..end]).is_none()));
        for at in 0..120 {
            let mut file = whole.clone();
            file[at] = 0xff;
            find(&file);
        }
    }
}
