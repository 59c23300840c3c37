//! NumPy arrays as depth and as maps of directions.

use glam::Vec3;
use npyz::{NpyFile, NpyHeader, Order};

use super::source::{NamedBytes, ReadError};
use crate::image::Plane;

/// Bytes of magic, version and length before the header's text.
const PREFIX: usize = 12;
/// A 2-D array needs about 120 bytes of header; longer ones are refused because the parser recurses
/// on brackets.
const MAX_HEADER: usize = 1024;

/// The header of an array in C order, and the bytes behind it.
fn header<'a>(source: NamedBytes<'a>) -> Result<(NpyHeader, &'a [u8]), ReadError> {
    let bad = |e: std::io::Error| source.error("NPY header", "a valid header", e);
    if source.bytes.len() < PREFIX {
        return Err(source.error(
            "NPY header",
            "a valid header",
            format!("{} bytes", source.bytes.len()),
        ));
    }
    let length = match source.bytes[6] {
        1 => u32::from(u16::from_le_bytes([source.bytes[8], source.bytes[9]])),
        _ => u32::from_le_bytes([
            source.bytes[8],
            source.bytes[9],
            source.bytes[10],
            source.bytes[11],
        ]),
    };
    if length as usize > MAX_HEADER {
        return Err(source.error(
            "NPY header",
            format!("at most {MAX_HEADER} bytes"),
            format!("{length} bytes"),
        ));
    }
    let mut data = source.bytes;
    let header = NpyHeader::from_reader(&mut data).map_err(bad)?;
    if header.order() != Order::C {
        return Err(source.error("NPY order", "C order", "Fortran order"));
    }
    Ok((header, data))
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
    let (header, data) = header(source)?;
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

/// A 2-D array in C order of f32, f64 or u16, as f32.
///
/// # Errors
/// The content is not such an array, or exceeds the limits of `source`.
pub(in crate::image) fn read(source: NamedBytes) -> Result<Plane<f32>, ReadError> {
    let (header, data) = header(source)?;
    let &[height, width] = header.shape() else {
        return Err(source.error("NPY shape", "(height, width)", format!("{:?}", header.shape())));
    };
    source.check_size(width, height, 8)?;
    let dtype = header.dtype();
    let file = NpyFile::with_header(header, data);
    let cut =
        |e: std::io::Error| source.error("NPY data", format!("{height} x {width} numbers"), e);
    let file = match file.try_data::<f32>() {
        Ok(values) => return plane(width, height, values.collect::<Result<_, _>>().map_err(cut)?),
        Err(file) => file,
    };
    let file = match file.try_data::<f64>() {
        Ok(values) => {
            return plane(
                width,
                height,
                values.map(|v| v.map(|v| v as f32)).collect::<Result<_, _>>().map_err(cut)?,
            );
        }
        Err(file) => file,
    };
    match file.try_data::<u16>() {
        Ok(values) => plane(
            width,
            height,
            values.map(|v| v.map(f32::from)).collect::<Result<_, _>>().map_err(cut)?,
        ),
        Err(_) => Err(source.error("NPY numbers", "f4, f8 or u2", dtype.descr())),
    }
}

fn plane(width: u64, height: u64, values: Vec<f32>) -> Result<Plane<f32>, ReadError> {
    Ok(Plane::new(width as usize, height as usize, values))
}
