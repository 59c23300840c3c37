//! Depth in NPZ, a ZIP archive of NumPy arrays, as `numpy.savez` and Depth Pro write it.

use std::io::{Cursor, Read};

use zip::ZipArchive;
use zip::result::ZipError;

use super::{DepthFile, share};
use crate::image::Plane;
use crate::image::io::npy;
use crate::image::io::source::{NamedBytes, ReadError};

/// Most arrays of a file.
const MAX_ARRAYS: usize = 256;
/// Names of depth, the first that is there.
const DEPTH: [&str; 5] = ["depth", "depths", "depth_map", "pred", "arr_0"];
/// Names of its confidence, 0..1.
const CONFIDENCE: [&str; 3] = [super::CONFIDENCE, "conf", "depth_conf"];

/// Reads the array `depth` of an archive, or one of the other usual names, or the only array; and
/// `confidence`, if it has the same size.
///
/// # Errors
/// The content is not a valid archive, no array can be told to be the depth, or it is not a plane;
/// it exceeds the limits of `source`.
pub(in crate::image) fn read(source: NamedBytes) -> Result<DepthFile, ReadError> {
    let bad = |e: ZipError| source.error("content", "a valid NPZ archive", e);
    let mut archive = ZipArchive::new(Cursor::new(source.bytes)).map_err(bad)?;
    if archive.len() > MAX_ARRAYS {
        let wanted = format!("at most {MAX_ARRAYS} arrays");
        return Err(source.error("NPZ", wanted, archive.len()));
    }
    let names = archive.file_names().map(|name| Ok(name?.strip_suffix(".npy").map(str::to_owned)));
    let names: Vec<Option<String>> = names.collect::<Result<_, ZipError>>().map_err(bad)?;
    let names: Vec<String> = names.into_iter().flatten().collect();
    let find = |wanted: &[&str]| {
        let found = |name: &&str| names.iter().any(|have| have == name);
        wanted.iter().copied().find(found).map(str::to_owned)
    };
    let only = || (names.len() == 1).then(|| names[0].clone());
    let depth = find(&DEPTH).or_else(only).ok_or_else(|| {
        let got = names.iter().take(20).map(String::as_str).collect::<Vec<_>>().join(", ");
        source.error("NPZ", "an array named `depth`", if names.is_empty() { "none" } else { &got })
    })?;
    let mut file = DepthFile::plain(array(source, &mut archive, &depth)?);
    if let Some(name) = find(&CONFIDENCE).filter(|name| *name != depth) {
        let confidence = array(source, &mut archive, &name)?;
        if confidence.size() == file.values.size() {
            file.confidence = Some(confidence.map(share));
        } else {
            file.notes.push(format!("its `{name}` has another size than its depth: left out"));
        }
    }
    Ok(file)
}

/// Reads one array of the archive.
fn array(
    source: NamedBytes,
    archive: &mut ZipArchive<Cursor<&[u8]>>,
    name: &str,
) -> Result<Plane<f32>, ReadError> {
    let bad = |e: ZipError| source.error("content", "a valid NPZ archive", e);
    let entry = archive.by_name(&format!("{name}.npy")).map_err(bad)?;
    let available = entry.size().min(source.most);
    npy::read(source, std::io::BufReader::new(entry.take(available)), available)
}
