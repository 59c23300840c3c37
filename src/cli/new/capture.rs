//! A frame of a phone capture in the folder that its application exports: photo, depth, camera.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use relight::graph::{Diagnostic, read};
use relight::image::{
    DepthFile, NamedBytes, ReadError, polycam, record3d, stray_scanner, turned_photo,
};

use super::folder::listed;

/// Most files of a folder that are looked at: half an hour of video.
const MAX_FRAMES: usize = 100_000;
/// The largest file of a frame that is read, bytes.
const MAX_BYTES: u64 = 256 << 20;
/// Degrees of a quarter turn.
const QUARTER: u32 = 90;

/// One frame, turned upright by the camera's pose where the capture states it.
pub struct Capture {
    /// The file of the photo, with the orientation of the frame.
    pub photo: Vec<u8>,
    /// The place of the photo.
    pub photo_path: PathBuf,
    /// Depth, confidence and camera.
    pub depth: DepthFile,
    /// The place of the depth.
    pub depth_path: PathBuf,
    /// The application and the frame, in words.
    pub origin: String,
}

/// The places of a frame's files.
struct Frame {
    photo: PathBuf,
    depth: PathBuf,
    /// The application, and this frame among those that there are.
    origin: String,
}

/// Opens a frame of a capture: the frame with this number, else the first one.
///
/// # Errors
/// The folder is not an export that is known, has no such frame, or a file of it is damaged.
pub fn open(folder: &Path, number: Option<u32>) -> Result<Capture, Diagnostic> {
    let inner = folder.join("EXR_RGBD");
    if folder.join("keyframes").is_dir() {
        polycam_frame(folder, number)
    } else if folder.join("camera_matrix.csv").is_file() {
        stray_frame(folder, number)
    } else if folder.join("metadata.json").is_file() {
        record3d_frame(folder, number)
    } else if inner.join("metadata.json").is_file() {
        record3d_frame(&inner, number)
    } else if folder.join("rgbd").is_dir() {
        let message = "the depth of Record3D's own format (.r3d) is not read";
        Err(Diagnostic::file(folder, message).help("export the recording as `EXR + JPG`"))
    } else {
        let message = "wanted a photo, or the folder of a capture by Polycam (`keyframes`), Stray \
                       Scanner (`camera_matrix.csv`) or Record3D (`metadata.json`), got another folder";
        Err(Diagnostic::file(folder, message).help("docs/new.md describes the folders"))
    }
}

/// A keyframe of Polycam: frames count in the order of their names, which are times. The pictures
/// as they were taken fit the depth; the corrected ones have black edges.
fn polycam_frame(folder: &Path, number: Option<u32>) -> Result<Capture, Diagnostic> {
    let part = |name: &str| folder.join("keyframes").join(name);
    let mut photos = numbered(&part("images"), &["jpg", "jpeg", "png"])?;
    let depths = numbered(&part("depth"), &["png"])?;
    photos.retain(|name, _| depths.contains_key(name));
    let wanted = "a picture in keyframes/images with a depth of the same name in keyframes/depth";
    let frames: Vec<(u32, u64)> = (0..).zip(photos.keys().copied()).collect();
    let (at, name) = chosen(folder, number, wanted, &frames)?;
    let origin = format!("Polycam, frame {at} of 0 to {}", frames.len() - 1);
    let frame = Frame { photo: photos[&name].clone(), depth: depths[&name].clone(), origin };
    let beside = |folder: &str, ending: &str| {
        Some(part(folder).join(frame.depth.file_stem()?).with_extension(ending))
    };
    let (confidence, camera) = (beside("confidence", "png"), beside("cameras", "json"));
    whole(&frame, [confidence, camera], |depth, [confidence, camera]| {
        polycam(depth, confidence, camera)
    })
}

/// A frame of Stray Scanner, whose pictures are a video: the frame's picture lies beside it under
/// the name of the frame's depth.
fn stray_frame(folder: &Path, number: Option<u32>) -> Result<Capture, Diagnostic> {
    let photos = numbered(folder, &["png", "jpg", "jpeg"])?;
    let depths = numbered(&folder.join("depth"), &["png"])?;
    let frames = by_name(depths.keys());
    let with_photo = frames.iter().find(|(_, name)| photos.contains_key(name));
    let number = number.or(with_photo.map(|(number, _)| *number));
    let (number, name) = chosen(folder, number, "depth/000000.png and on", &frames)?;
    let Some(photo) = photos.get(&name) else {
        let video = folder.join("rgb.mp4");
        let picture = folder.join(format!("{number:06}.png"));
        let message =
            format!("wanted frame {number} of the video as a picture beside it, got none");
        return Err(Diagnostic::file(&video, message).help(format!(
            "make it with: ffmpeg -noautorotate -i {:?} -vf \"select=eq(n\\,{number})\" -frames:v 1 {picture:?}",
            video.display().to_string()
        )));
    };
    let origin =
        format!("Stray Scanner, frame {number} of 0 to {}", depths.keys().last().unwrap_or(&0));
    let frame = Frame { photo: photo.clone(), depth: depths[&name].clone(), origin };
    let confidence = frame.depth.file_name().map(|name| folder.join("confidence").join(name));
    let [matrix, odometry] =
        ["camera_matrix.csv", "odometry.csv"].map(|name| Some(folder.join(name)));
    whole(&frame, [confidence, matrix, odometry], |depth, [confidence, matrix, odometry]| {
        stray_scanner(depth, confidence, matrix, odometry, number)
    })
}

/// A frame of Record3D's export `EXR + JPG`.
fn record3d_frame(folder: &Path, number: Option<u32>) -> Result<Capture, Diagnostic> {
    let photos = numbered(&folder.join("rgb"), &["jpg", "jpeg", "png"])?;
    let depths = numbered(&folder.join("depth"), &["exr"])?;
    let frames = by_name(photos.keys().filter(|name| depths.contains_key(name)));
    let wanted = "rgb/0.jpg with depth/0.exr, and on";
    let (number, name) = chosen(folder, number, wanted, &frames)?;
    let origin = format!("Record3D, frame {number} of 0 to {}", photos.keys().last().unwrap_or(&0));
    let frame = Frame { photo: photos[&name].clone(), depth: depths[&name].clone(), origin };
    whole(&frame, [Some(folder.join("metadata.json"))], |depth, [metadata]| {
        record3d(depth, metadata, number)
    })
}

/// The number of a frame and its name, of the frames that there are.
fn chosen(
    folder: &Path,
    number: Option<u32>,
    wanted: &str,
    frames: &[(u32, u64)],
) -> Result<(u32, u64), Diagnostic> {
    let (Some(first), Some(last)) = (frames.first(), frames.last()) else {
        return Err(Diagnostic::file(folder, format!("wanted {wanted}, got none")));
    };
    let Some(number) = number else { return Ok(*first) };
    frames.iter().find(|(other, _)| *other == number).copied().ok_or_else(|| {
        let place = folder.display();
        let message = format!("wanted a frame of {place}, {} to {}, got {number}", first.0, last.0);
        Diagnostic::file("--frame".as_ref(), message)
    })
}

/// The frames whose names are their numbers.
fn by_name<'a>(names: impl Iterator<Item = &'a u64>) -> Vec<(u32, u64)> {
    names.filter_map(|name| Some((u32::try_from(*name).ok()?, *name))).collect()
}

/// Reads the files of a frame and turns it upright; files of `beside` may be missing.
fn whole<const N: usize>(
    frame: &Frame,
    beside: [Option<PathBuf>; N],
    depth: impl FnOnce(NamedBytes, [Option<NamedBytes>; N]) -> Result<DepthFile, ReadError>,
) -> Result<Capture, Diagnostic> {
    let fault = |e: ReadError| Diagnostic::file(e.file.as_ref(), e.message());
    let file = |path: &Path| {
        let bytes = read(path, MAX_BYTES);
        let bytes = bytes.map_err(|e| Diagnostic::file(path, format!("cannot be read: {e}")))?;
        Ok::<_, Diagnostic>((path.display().to_string(), bytes))
    };
    let photo = file(&frame.photo)?;
    let stored = file(&frame.depth)?;
    let mut others = [const { None }; N];
    for (other, path) in others.iter_mut().zip(beside) {
        *other = path.filter(|path| path.is_file()).map(|path| file(&path)).transpose()?;
    }
    let others = others.each_ref().map(|other| other.as_ref().map(named));
    let depth = depth(named(&stored), others).map_err(fault)?;
    let quarters = depth.quarters();
    // Without a direction of up, the photo keeps its own orientation.
    let bytes = match depth.up {
        Some(_) => turned_photo(named(&photo), quarters).map_err(fault)?,
        None => photo.1,
    };
    let mut origin = frame.origin.clone();
    if quarters > 0 {
        origin += &format!("; turned clockwise by {} degrees", QUARTER * u32::from(quarters));
    }
    Ok(Capture {
        photo: bytes,
        photo_path: frame.photo.clone(),
        depth: depth.turned(quarters),
        depth_path: frame.depth.clone(),
        origin,
    })
}

fn named((name, bytes): &(String, Vec<u8>)) -> NamedBytes<'_> {
    NamedBytes::new(name, bytes)
}

/// The files of a folder whose names are a number and one of these endings; none where the folder
/// is missing.
fn numbered(folder: &Path, endings: &[&str]) -> Result<BTreeMap<u64, PathBuf>, Diagnostic> {
    if !folder.is_dir() {
        return Ok(BTreeMap::new());
    }
    let names = listed(folder)?
        .take(MAX_FRAMES)
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let number = |name: &str| {
        let (stem, ending) = name.rsplit_once('.')?;
        let is_frame = stem.bytes().all(|byte| byte.is_ascii_digit())
            && endings.contains(&&*ending.to_ascii_lowercase());
        is_frame.then(|| stem.parse().ok()).flatten()
    };
    Ok(names.filter_map(|name| Some((number(&name)?, folder.join(name)))).collect())
}
