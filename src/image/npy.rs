//! NumPy arrays as depth.

use npyz::{NpyFile, NpyHeader, Order};

use super::Plane;
use super::read::{ReadError, Source};

/// Bytes of magic, version and length before the header's text.
const PREFIX: usize = 12;
/// A 2-D array needs about 120 bytes of header; longer ones are refused because the parser recurses on brackets.
const MAX_HEADER: usize = 1024;

/// A 2-D array in C order of f32, f64 or u16, as f32.
pub(super) fn read(source: Source) -> Result<Plane<f32>, ReadError> {
    let bad = |e: std::io::Error| source.error("NPY header", "a sound header", e);
    if source.bytes.len() < PREFIX {
        return Err(source.error("NPY header", "a sound header", format!("{} bytes", source.bytes.len())));
    }
    let length = match source.bytes[6] {
        1 => u32::from(u16::from_le_bytes([source.bytes[8], source.bytes[9]])),
        _ => u32::from_le_bytes([source.bytes[8], source.bytes[9], source.bytes[10], source.bytes[11]]),
    };
    if length as usize > MAX_HEADER {
        return Err(source.error("NPY header", format!("at most {MAX_HEADER} bytes"), format!("{length} bytes")));
    }
    let mut data = source.bytes;
    let header = NpyHeader::from_reader(&mut data).map_err(bad)?;
    let &[height, width] = header.shape() else {
        return Err(source.error("NPY shape", "(height, width)", format!("{:?}", header.shape())));
    };
    if header.order() != Order::C {
        return Err(source.error("NPY order", "C order", "Fortran order"));
    }
    source.check_size(width, height, 8)?;
    let dtype = header.dtype();
    let file = NpyFile::with_header(header, data);
    let cut = |e: std::io::Error| source.error("NPY data", format!("{height} x {width} numbers"), e);
    let file = match file.try_data::<f32>() {
        Ok(values) => return plane(width, height, values.collect::<Result<_, _>>().map_err(cut)?),
        Err(file) => file,
    };
    let file = match file.try_data::<f64>() {
        Ok(values) => {
            return plane(width, height, values.map(|v| v.map(|v| v as f32)).collect::<Result<_, _>>().map_err(cut)?);
        }
        Err(file) => file,
    };
    match file.try_data::<u16>() {
        Ok(values) => plane(width, height, values.map(|v| v.map(f32::from)).collect::<Result<_, _>>().map_err(cut)?),
        Err(_) => Err(source.error("NPY numbers", "f4, f8 or u2", dtype.descr())),
    }
}

fn plane(width: u64, height: u64, values: Vec<f32>) -> Result<Plane<f32>, ReadError> {
    Ok(Plane::new(width as usize, height as usize, values))
}
