//! Files of results, and the encoding of their pictures.

use std::ops::Range;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::image::{Bytes, Transfer, rule};

/// Encoding of the photo and its EXIF block, for results that have the same.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Encoding {
    /// Transfer function of the samples.
    pub transfer: Transfer,
    /// Illuminance in lux at which a white surface shows 1; `None` when the scene does not give it.
    pub lux: Option<f32>,
    /// Samples have 16 bits, else 8.
    pub sixteen_bit: bool,
    /// EXIF block of pictures that are made of the photo, empty for none.
    pub exif: Vec<u8>,
}

/// The sub-folders of files of results.
const RESULT_FOLDERS: [&str; 1] = ["masks"];
/// Names of devices on Windows, with any extension.
const DEVICES: [&str; 6] = ["con", "prn", "aux", "nul", "com", "lpt"];

/// Checks the name of a file of the results: one plain name that every system takes, in no folder
/// or in one of those that stages declare (`masks`).
///
/// # Errors
/// The name is not one of these.
pub fn check_file_name(name: &str) -> Result<(), String> {
    let (folder, file) =
        name.split_once('/').map_or((None, name), |(folder, file)| (Some(folder), file));
    let stem = file.split('.').next().unwrap_or_default().trim_end().to_ascii_lowercase();
    let is_device = DEVICES.iter().any(|device| match stem.strip_prefix(device) {
        Some("") => !matches!(*device, "com" | "lpt"),
        Some(number) => matches!(*device, "com" | "lpt") && number.len() == 1 && number != "0",
        None => false,
    });
    let is_plain = !file.is_empty()
        && file.len() <= 255
        && !file.ends_with(['.', ' '])
        && !file.contains(|c: char| c.is_control() || r#"/\:*?"<>|"#.contains(c))
        && !is_device;
    if is_plain && folder.is_none_or(|folder| RESULT_FOLDERS.contains(&folder)) {
        return Ok(());
    }
    let folders = RESULT_FOLDERS.join(", ");
    Err(format!(
        "wanted the plain name of a file, in no folder or in one of these: {folders}; got {name:?}"
    ))
}

/// Files to be written, by name; [`check_file_name`] holds for each.
#[derive(Clone, Debug, PartialEq)]
pub struct Files(pub Vec<(String, Vec<u8>)>);

impl Files {
    /// Files from their canonical bytes. The largest keeps their buffer: the layers of a large
    /// photo take gigabytes.
    ///
    /// # Errors
    /// The bytes are not the canonical form of files.
    pub(super) fn from_canonical(mut bytes: Vec<u8>) -> Result<Files, String> {
        let bad = |e: postcard::Error| e.to_string();
        let (count, mut rest) = postcard::take_from_bytes::<usize>(&bytes).map_err(bad)?;
        let mut places = Vec::new();
        for _ in 0..count {
            let ((name, Bytes(file)), after) =
                postcard::take_from_bytes::<(String, Bytes)>(rest).map_err(bad)?;
            let end = bytes.len() - after.len();
            places.push((name, end - file.len()..end));
            rest = after;
        }
        rule(rest.is_empty(), "nothing after the files")?;
        let largest = (0..places.len()).max_by_key(|&i| places[i].1.len());
        let copy = |(i, (name, place)): (usize, &(String, Range<usize>))| {
            (
                name.clone(),
                if Some(i) == largest { Vec::new() } else { bytes[place.clone()].to_vec() },
            )
        };
        let mut files: Vec<(String, Vec<u8>)> = places.iter().enumerate().map(copy).collect();
        if let Some(i) = largest {
            bytes.truncate(places[i].1.end);
            bytes.drain(..places[i].1.start);
            files[i].1 = bytes;
        }
        Ok(Files(files))
    }
}

impl Serialize for Files {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().map(|(name, bytes)| (name, Bytes(bytes))))
    }
}

impl<'de> Deserialize<'de> for Files {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Files, D::Error> {
        let files: Vec<(String, Bytes<'de>)> = Deserialize::deserialize(deserializer)?;
        Ok(Files(files.into_iter().map(|(name, bytes)| (name, bytes.0.to_vec())).collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::Artifact;

    #[test]
    fn files_come_back_whichever_is_the_largest() {
        let lists: [&[(&str, &[u8])]; 4] = [
            &[],
            &[("a.png", b"")],
            &[("a.png", b"short"), ("b.exr", b"much longer"), ("c.ron", b"")],
            &[("a.png", b"the longest of all"), ("b.exr", b"short")],
        ];
        for list in lists {
            let files = Files(
                list.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.to_vec())).collect(),
            );
            let bytes = postcard::to_stdvec(&files).expect("it can be encoded");
            assert_eq!(Files::decode(bytes.clone()).as_ref(), Ok(&files));
            for cut in 0..bytes.len() {
                assert!(
                    Files::decode(bytes[..cut].to_vec()).is_err(),
                    "{cut} of {} bytes",
                    bytes.len()
                );
            }
            assert!(Files::decode([&bytes[..], b"x"].concat()).is_err());
        }
    }

    #[test]
    fn names_of_results_are_plain() {
        for name in [
            "picture.png",
            "picture_0001.png",
            "masks/lamp_0.png",
            "Gr\u{f6}\u{df}e 1.usda",
            "console.png",
            "com.png",
        ] {
            assert_eq!(check_file_name(name), Ok(()), "{name}");
        }
        let long = "a".repeat(256);
        for name in [
            "",
            ".",
            "..",
            "/",
            "/etc/passwd",
            "../x",
            "masks/../x",
            "masks/",
            "other/x",
            "a/b/c",
            "a\\b",
            "C:x",
            "a\0b",
            "x\n",
            "con",
            "NUL.txt",
            "com1",
            "LPT9.png",
            "masks/aux.png",
            "x.",
            "x ",
            "x?",
            long.as_str(),
        ] {
            assert!(check_file_name(name).is_err(), "{name:?}");
        }
    }
}
