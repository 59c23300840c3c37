//! Pictures packed for a page in a browser: halves, in few bytes.

use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use glam::Vec3;
use half::f16;

use crate::image::Plane;

/// A plane as zlib-packed halves.
///
/// Unpacked there are 2 x channels x pixels bytes: of a color red, green and blue one after the
/// other, row by row; of each number the difference from the number before it (the first from 0),
/// modulo 2^16, as neighbors differ little; first all low bytes, then all high bytes.
pub struct Packed {
    /// The packed halves.
    pub bytes: Vec<u8>,
    /// A stored half times this is the number. A power of two, so that nothing is lost to it.
    pub scale: f32,
}

/// Packs a plane of finite colors at a level of zlib, 0 (stored) to 9. The scale puts the largest
/// magnitude below 2^14: halves keep 11 bits of numbers up to 2^28 times smaller.
pub fn pack(plane: &Plane<Vec3>, level: u32) -> Packed {
    let channels = (0..3).flat_map(|axis| plane.pixels().iter().map(move |c| c[axis]));
    pack_numbers(channels, 3 * plane.len(), level)
}

/// Packs a plane of finite numbers, as [`pack`] does each channel.
pub fn pack_gray(plane: &Plane<f32>, level: u32) -> Packed {
    pack_numbers(plane.pixels().iter().copied(), plane.len(), level)
}

fn pack_numbers(numbers: impl Iterator<Item = f32> + Clone, count: usize, level: u32) -> Packed {
    let largest = numbers.clone().map(f32::abs).fold(0.0, f32::max);
    // A double holds the power of two of any single, subnormal or not, and its inverse.
    let exponent = if largest > 0.0 { f64::from(largest).log2().floor() as i32 - 13 } else { 0 };
    let scale = 2f64.powi(exponent.max(-126)) as f32;
    let (mut low, mut high, mut last) =
        (Vec::with_capacity(2 * count), Vec::with_capacity(count), 0);
    for number in numbers {
        let bits = f16::from_f64(f64::from(number) / f64::from(scale)).to_bits();
        let [l, h] = u16::wrapping_sub(bits, last).to_le_bytes();
        low.push(l);
        high.push(h);
        last = bits;
    }
    low.append(&mut high);
    let mut packed = ZlibEncoder::new(Vec::new(), Compression::new(level));
    let bytes =
        packed.write_all(&low).and_then(|()| packed.finish()).expect("memory takes all bytes");
    Packed { bytes, scale }
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    /// As the page does it.
    fn numbers(packed: &Packed) -> Vec<f32> {
        let mut bytes = Vec::new();
        flate2::read::ZlibDecoder::new(&packed.bytes[..])
            .read_to_end(&mut bytes)
            .expect("it is sound");
        let (low, high) = bytes.split_at(bytes.len() / 2);
        let mut bits = 0u16;
        let number = |(&l, &h): (&u8, &u8)| {
            bits = bits.wrapping_add(u16::from_le_bytes([l, h]));
            f16::from_bits(bits).to_f32() * packed.scale
        };
        low.iter().zip(high).map(number).collect()
    }

    fn unpack(packed: &Packed, pixels: usize) -> Vec<Vec3> {
        let numbers = numbers(packed);
        (0..pixels)
            .map(|p| Vec3::new(numbers[p], numbers[pixels + p], numbers[2 * pixels + p]))
            .collect()
    }

    #[test]
    fn what_is_packed_comes_back_to_eleven_bits() {
        for most in [1.0, 3e-5, 70_000.0, 3e38, 1e-40] {
            let value =
                |x: usize, y: usize| most * Vec3::new(x as f32 / 39.0, 1e-6 * y as f32, -0.25);
            let plane = Plane::from_fn(40, 30, value);
            let back = unpack(&pack(&plane, 4), plane.len());
            for (got, want) in back.iter().zip(plane.pixels()) {
                // Half a unit of the last of 11 bits, or of the smallest half under the scale.
                let off = (*got - *want).abs().max_element();
                assert!(
                    (off - 2f32.powi(-11) * want.abs().max_element()).max(0.0)
                        <= 1e-7 * most + 1e-45,
                    "{most}: {got} for {want}"
                );
            }
        }
        let black = Plane::filled(4, 4, Vec3::ZERO);
        assert_eq!(unpack(&pack(&black, 0), 16), black.pixels());
    }

    #[test]
    fn a_gray_plane_has_one_channel() {
        let plane = Plane::from_fn(7, 5, |x, y| 0.25 * x as f32 - y as f32);
        assert_eq!(numbers(&pack_gray(&plane, 1)), plane.pixels());
    }

    #[test]
    fn smooth_pictures_pack_well() {
        let plane = Plane::from_fn(320, 240, |x, y| {
            Vec3::splat(0.5 + 0.3 * (0.02 * x as f32).sin() * (0.03 * y as f32).cos())
        });
        assert!(pack(&plane, 4).bytes.len() < 320 * 240 * 3, "half of the halves");
    }
}
