//! NumPy arrays as depth and as maps of directions.

use std::io::Read;

use glam::Vec3;
use half::f16;
use npyz::{NpyFile, NpyHeader, Order};

use super::source::{NamedBytes, ReadError};
use crate::image::Plane;

/// Bytes of magic, version and length before the header's text.
const PREFIX: usize = 12;
/// A 2-D array needs about 120 bytes of header; longer ones are refused because the parser recurses
/// on brackets.
const MAX_HEADER: usize = 1024;

/// The header of an array, which is read from the start of `data`.
fn header(source: NamedBytes, data: &mut impl Read) -> Result<NpyHeader, ReadError> {
    let bad = |e: std::io::Error| source.error("NPY header", "a valid header", e);
    let mut start = [0; PREFIX];
    data.read_exact(&mut start).map_err(bad)?;
    let length = match start[6] {
        1 => u32::from(u16::from_le_bytes([start[8], start[9]])),
        _ => u32::from_le_bytes([start[8], start[9], start[10], start[11]]),
    };
    if length as usize > MAX_HEADER {
        return Err(source.error(
            "NPY header",
            format!("at most {MAX_HEADER} bytes"),
            format!("{length} bytes"),
        ));
    }
    NpyHeader::from_reader(start.chain(data)).map_err(bad)
}

/// Maps over directions for each cell of a grid, [rows, columns, `directions`, 3] of f32: rows,
/// columns, and the colors, the last axes fastest. Numbers that are not finite are passed on.
///
/// # Errors
/// The file does not hold such an array.
pub fn read_maps(
    source: NamedBytes,
    directions: [usize; 2],
) -> Result<(usize, usize, Vec<Vec3>), ReadError> {
    if !source.bytes.starts_with(b"\x93NUMPY") {
        return Err(source.error("file format", "maps of directions: NPY", "another one"));
    }
    let mut data = source.bytes;
    let header = header(source, &mut data)?;
    if header.order() != Order::C {
        return Err(source.error("NPY order", "C order", "Fortran order"));
    }
    let [thetas, phis] = directions.map(|n| n as u64);
    let &[rows, columns, t, p, 3] = header.shape() else {
        return Err(source.error(
            "NPY shape",
            format!("(rows, columns, {thetas}, {phis}, 3)"),
            format!("{:?}", header.shape()),
        ));
    };
    if [t, p] != [thetas, phis] {
        let got = format!("{:?}", header.shape());
        return Err(source.error(
            "NPY shape",
            format!("(rows, columns, {thetas}, {phis}, 3)"),
            got,
        ));
    }
    source.check_size(columns.saturating_mul(t * p), rows, 12)?;
    let dtype = header.dtype().descr();
    let file = NpyFile::with_header(header, data);
    let cut = |e: std::io::Error| source.error("NPY data", format!("{rows} x {columns} maps"), e);
    let values = file.try_data::<f32>().map_err(|_| source.error("NPY numbers", "f4", dtype))?;
    let values: Vec<f32> = values.collect::<Result<_, _>>().map_err(cut)?;
    let colors = values.chunks_exact(3).map(|c| Vec3::new(c[0], c[1], c[2])).collect();
    Ok((rows as usize, columns as usize, colors))
}

/// A plane from an array of one plane: (height, width), and axes of length 1 before or behind.
/// Integers of every width, floating-point numbers of 2, 4 and 8 bytes and both byte orders become
/// f32; Fortran order is turned. `data` holds at most `available` bytes.
///
/// # Errors
/// The content is not such an array, exceeds the limits of `source`, or claims more than
/// `available` bytes.
pub(in crate::image) fn read(
    source: NamedBytes,
    mut data: impl Read,
    available: u64,
) -> Result<Plane<f32>, ReadError> {
    let header = header(source, &mut data)?;
    let mut shape = header.shape();
    while shape.len() > 2 {
        shape = match shape {
            [1, rest @ ..] | [rest @ .., 1] => rest,
            _ => break,
        };
    }
    let &[height, width] = shape else {
        let wanted = "one plane, (height, width)";
        return Err(source.error("NPY shape", wanted, format!("{:?}", header.shape())));
    };
    source.check_size(width, height, 8)?;
    let dtype = header.dtype();
    let bytes = dtype.num_bytes().unwrap_or(1) as u64;
    if width * height * bytes > available {
        let wanted = format!("{height} x {width} numbers of {bytes} bytes");
        return Err(source.error("NPY data", wanted, format!("{available} bytes")));
    }
    let fortran = header.order() == Order::Fortran;
    let file = NpyFile::with_header(header, data);
    let values = numbers(file).map_err(|error| match error {
        Some(e) => source.error("NPY data", format!("{height} x {width} numbers"), e),
        None => source.error("NPY numbers", "integers, f2, f4 or f8", dtype.descr()),
    })?;
    let (width, height) = (width as usize, height as usize);
    if fortran {
        return Ok(Plane::from_fn(width, height, |x, y| values[x * height + y]));
    }
    Ok(Plane::new(width, height, values))
}

/// All numbers of a file in the order in which they lie there; `None` as the error of another type.
fn numbers(file: NpyFile<impl Read>) -> Result<Vec<f32>, Option<std::io::Error>> {
    macro_rules! as_one_of {
        ($file:ident, $($number:ty: $to_f32:expr),+) => {$(
            let $file = match $file.try_data::<$number>() {
                Ok(values) => {
                    return values.map(|v| v.map($to_f32)).collect::<Result<_, _>>().map_err(Some);
                }
                Err(file) => file,
            };
        )+};
    }
    as_one_of!(
        file, f32: |v| v, u16: f32::from, f64: |v| v as f32, f16: f32::from, u8: f32::from,
        i16: f32::from, i8: f32::from, i32: |v| v as f32, u32: |v| v as f32, i64: |v| v as f32,
        u64: |v| v as f32
    );
    let _ = file;
    Err(None)
}
