//! Files of a scene as bytes: pictures, and arrays of numbers.

use glam::Vec3;
use relight::image::{Picture, Plane, Transfer, write_png};

/// A PNG of 8 bits whose stored numbers are `value(x, y)`, shares of full.
pub fn png_of(size: (usize, usize), value: impl FnMut(usize, usize) -> Vec3) -> Vec<u8> {
    write_png(&Picture(Plane::from_fn(size.0, size.1, value)), Transfer::Linear, false)
}

/// A NumPy file of little-endian 32-bit numbers of shape (height, width).
pub fn npy(size: (usize, usize), value: impl Fn(usize, usize) -> f32) -> Vec<u8> {
    npy_of("<f4", size, |x, y| value(x, y).to_le_bytes().to_vec())
}

/// A NumPy file of shape (height, width) whose numbers of this kind have these bytes.
pub fn npy_of(
    kind: &str,
    (width, height): (usize, usize),
    value: impl Fn(usize, usize) -> Vec<u8>,
) -> Vec<u8> {
    let mut header =
        format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({height}, {width}), }}");
    header.push_str(&" ".repeat(128 - 10 - 1 - header.len()));
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    for y in 0..height {
        (0..width).for_each(|x| bytes.extend(value(x, y)));
    }
    bytes
}
