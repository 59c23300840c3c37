//! The arguments of each command; the help texts are their doc comments.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand, ValueEnum};
use relight::graph::Reach;
use relight::nodes::output::mix_layers::srgb;

use super::shipped::graph_path;

pub use super::new::GivenKind;

/// The files of a run.
#[derive(Args, Clone, Default)]
pub struct SceneFiles {
    /// The scene folder, with a scene.ron; overrides the scene of the graph file.
    #[arg(long, value_name = "DIR")]
    pub scene: Option<PathBuf>,
    /// One frame, from 0, of an edit with `frames`. Default: all frames for `run` and `check`, else
    /// the first.
    #[arg(long, value_name = "N", value_parser = whole::<u32>(0, 99_999))]
    pub frame: Option<u32>,
    /// Set one parameter of one node, as RON; may be given several times, and overrides graph,
    /// scene and edit.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    pub set: Vec<String>,
    /// The standard error to reach, as `1%` or `0.01`: sets the parameter `target_error` of every
    /// node that has it.
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub target_error: Option<f32>,
    #[command(flatten)]
    pub lengths: KnownLengths,
    #[command(flatten)]
    pub confined: Confined,
    #[command(flatten)]
    pub networks: Networks,
}

impl SceneFiles {
    /// The files that the files of the run may name.
    pub fn reach(&self) -> Reach {
        self.confined.reach()
    }
}

/// The trust in the files of a run.
#[derive(Args, Clone, Copy, Default)]
pub struct Confined {
    /// Restrict scene, edit, graph and models to files below their own folders: for untrusted
    /// files.
    #[arg(long)]
    pub confined: bool,
}

impl Confined {
    /// The files that such files may name.
    pub fn reach(self) -> Reach {
        if self.confined { Reach::OwnFolder } else { Reach::Anywhere }
    }
}

/// Lengths that a person knows in the photo.
#[derive(Args, Clone, Default)]
pub struct KnownLengths {
    /// Two pixels of the photo and the distance between them in meters, as `212,80,212,395=2.03`;
    /// may be given several times.
    ///
    /// Scales depth, of `new` and of a network (graphs/depth.ron); two or more at different depths
    /// also determine the offset of relative depth.
    #[arg(long, value_name = "X,Y,X,Y=METERS", value_parser = known_length)]
    pub known_length: Vec<String>,
}

/// The folder and the backend of the networks.
#[derive(Args, Clone, Default)]
pub struct Networks {
    /// The folder of the networks. Default: `models` beside the program, or in a folder above it.
    #[arg(long, value_name = "DIR")]
    pub models: Option<PathBuf>,
    /// The backend of the networks: `ort` is ONNX Runtime, `rten` is part of this program, `auto`
    /// uses ONNX Runtime where its library is found.
    #[arg(long, value_enum, default_value_t)]
    pub backend: WhichBackend,
    /// The library of ONNX Runtime (libonnxruntime.so, .dylib, .dll). Default: that of the
    /// environment variable ORT_DYLIB_PATH, else the system's.
    #[arg(long, value_name = "PATH")]
    pub onnxruntime: Option<PathBuf>,
}

#[derive(Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum WhichBackend {
    #[default]
    Auto,
    Ort,
    Rten,
}

#[derive(Args)]
pub struct JobArgs {
    /// The graph file, or the name of one that ships: indoor, physics, networks, ..
    #[arg(value_parser = graph_path)]
    pub graph: PathBuf,
    /// The edit file. Default: no changes.
    pub edit: Option<PathBuf>,
    #[command(flatten)]
    pub files: SceneFiles,
}

#[derive(Args, Clone, Default)]
pub struct CacheAt {
    /// The cache folder, created if missing. Default: `relight` in the user's own cache
    /// folder (on Linux ~/.cache/relight), shared by all projects. Runs limit a cache to 10 GiB:
    /// the least recently used results are dropped.
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// A file with the secret that signs the entries of a cache which several users share; entries
    /// with another signature are not used. Default: a key of the user's own, created when first
    /// needed (on Linux ~/.config/relight/cache.key).
    #[arg(long, value_name = "FILE")]
    pub cache_key: Option<PathBuf>,
}

#[derive(Args, Clone, Default)]
pub struct CacheUse {
    #[command(flatten)]
    pub at: CacheAt,
    /// Neither read nor write a cache on disk.
    #[arg(long, conflicts_with_all = ["cache", "cache_key"])]
    pub no_cache: bool,
    /// A store behind the cache folder that machines share: s3://BUCKET/PREFIX, gs://, az:// or
    /// file:///FOLDER. Results that it has are not computed again; what fails there is computed.
    #[cfg(feature = "store")]
    #[arg(long, value_name = "URL", conflicts_with = "no_cache")]
    pub cache_store: Option<String>,
}

#[derive(Args, Clone, Default)]
pub struct RunArgs {
    /// The graph file, or the name of one that ships: indoor, physics, networks, ..
    #[arg(value_parser = graph_path)]
    pub graph: PathBuf,
    /// The edit file. Default: no changes.
    pub edit: Option<PathBuf>,
    #[command(flatten)]
    pub files: SceneFiles,
    /// The folder for the results, created if missing.
    #[arg(long, value_name = "DIR", default_value = "out")]
    pub out: PathBuf,
    /// Allow results to replace files that the run reads.
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub cache: CacheUse,
    /// Number of worker threads; the result is the same for any number. Default: one per core.
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1, 1024))]
    pub threads: Option<u16>,
    /// Time limit for each light's direct light and each light's shadow, as `500ms`, `2s` or
    /// `1min`.
    ///
    /// A result that is cut short serves the pictures of this run; the cache does not keep it.
    #[arg(long, value_name = "TIME", value_parser = duration, conflicts_with = "verify")]
    pub budget: Option<Duration>,
    /// Evaluate this node, or this member of a set such as `direct[lamp_0]`, and its inputs only.
    #[arg(long, value_name = "NODE")]
    pub only: Option<String>,
    /// Also write picture.exr with all layers for each frame of a sequence.
    #[arg(long)]
    pub exr: bool,
    /// Frames per second of film.mp4, which a whole sequence gets where ffmpeg is on PATH.
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = whole::<u16>(1, 240))]
    pub fps: u16,
    /// Print report.json on standard output instead of the paths written.
    #[arg(long)]
    pub json: bool,
    /// Also write report.html, as `relight report` does.
    #[arg(long, conflicts_with_all = ["verify", "only"])]
    pub report: bool,
    /// Compute all cached results of this run again and compare; writes no pictures.
    #[arg(long, conflicts_with = "no_cache")]
    pub verify: bool,
    /// First write preview.png, the picture at working size: of edits of lights.
    #[arg(long, conflicts_with_all = ["verify", "only"])]
    pub preview: bool,
    /// Run again whenever edit, scene, graph or a file that they name changes, until Ctrl-C.
    #[arg(long, conflicts_with = "verify")]
    pub watch: bool,
}

#[derive(Args)]
pub struct NewArgs {
    /// The photo: PNG, JPEG, WebP, HDR or EXR; or the folder of a capture by Polycam, Stray Scanner
    /// or Record3D, which has depth and camera. The photo is copied.
    pub photo: PathBuf,
    /// The frame of a capture, from 0. Default: the first.
    #[arg(long, value_name = "N", value_parser = whole::<u32>(0, 999_999))]
    pub frame: Option<u32>,
    /// Depth of the photo: EXR, PNG, NPY, NPZ, PFM, TIFF, or a JPEG with depth inside. Whole
    /// numbers above 100 are millimeters, others meters, unless the file states its unit.
    #[arg(long, value_name = "FILE", conflicts_with = "depth_network")]
    pub depth: Option<PathBuf>,
    /// The quantity in the depth file. Default: that which the file states, else `planar`.
    #[arg(long, value_enum, conflicts_with = "depth_network")]
    pub depth_kind: Option<GivenKind>,
    /// Meters per unit of the depth file; for `disparity`, of 1 / unit.
    #[arg(long, value_name = "METERS", conflicts_with = "depth_network", value_parser = positive)]
    pub depth_scale: Option<f32>,
    /// The horizontal field of view of the upright photo in degrees, from 1 to 175. Default: from
    /// EXIF, else 65 degrees along the longer side.
    #[arg(long, value_name = "DEGREES", value_parser = field_of_view)]
    pub fov: Option<f32>,
    /// Height of the camera above the seen floor in meters: scales the depth of --depth, and the
    /// relative depth of --depth-network. Default for relative depth: 1.5.
    #[arg(long, value_name = "METERS", value_parser = height, conflicts_with_all = ["known_length", "room_height"])]
    pub camera_height: Option<f32>,
    /// Height of the room in meters, where the photo shows floor and ceiling: scales the depth of
    /// --depth.
    #[arg(long, value_name = "METERS", value_parser = height, conflicts_with_all = ["known_length", "depth_network"])]
    pub room_height: Option<f32>,
    /// A network for depth in ONNX (docs/networks.md), as `--set depth.convention=Metric3d` and the
    /// like describe it.
    #[arg(long, value_name = "ONNX")]
    pub depth_network: Option<PathBuf>,
    #[command(flatten)]
    pub lengths: KnownLengths,
    /// A folder of masks: lamp*.png, window*.png, ignore.png, sunlight.png. Default: lamps and
    /// windows are proposed.
    #[arg(long, value_name = "DIR")]
    pub masks: Option<PathBuf>,
    /// The folder of the scene, created if missing. Files in it that you changed are kept.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Set one parameter of a step, as `find.threshold=0.6` or `depth.kind=Metric`; may be given
    /// several times.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    pub set: Vec<String>,
    #[command(flatten)]
    pub networks: Networks,
    #[command(flatten)]
    pub cache: CacheUse,
}

#[derive(Args)]
pub struct MixArgs {
    /// The folder that `relight run` wrote to (its --out), or a picture.exr.
    pub run: PathBuf,
    /// The factor of a light, in linear light: `0.5`, `2,1,0.5` (red, green, blue), `#ffd0a0` (an
    /// sRGB color) or `0.5*#ffd0a0`; may be given once for each light.
    #[arg(long, value_name = "LIGHT=WEIGHT", value_parser = weight)]
    pub set: Vec<(String, [f32; 3])>,
    /// The folder for picture.png and picture.exr, created if missing; or one file, NAME.png
    /// or NAME.exr.
    #[arg(long, value_name = "FILE|DIR", default_value = "out/mix")]
    pub out: PathBuf,
    /// Allow results to replace the file that is read.
    #[arg(long)]
    pub force: bool,
}

#[derive(Args)]
pub struct ReportArgs {
    /// The folder that `relight run` wrote to (its --out); report.html is written into it.
    pub run: PathBuf,
    /// Longer side of the pictures in the page, in pixels.
    #[arg(long, value_name = "PIXELS", default_value_t = LONG_SIDE, value_parser = whole::<u32>(1, 4096))]
    pub long_side: u32,
}

#[derive(Args)]
pub struct Export {
    #[command(flatten)]
    pub job: JobArgs,
    /// The USD file: NAME.usda, whose texture is written beside it, or NAME.usdz with the texture
    /// inside.
    #[arg(long, value_name = "FILE", default_value = "out/room.usda", value_parser = usda)]
    pub out: PathBuf,
    /// Frames per second of an edit with `frames`, whose values become time samples.
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = whole::<u16>(1, 240))]
    pub fps: u16,
    /// Allow results to replace files that the run reads.
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub cache: CacheUse,
}

/// No camera and no room is higher, meters.
const MAX_HEIGHT: f32 = 50.0;
/// Default longest side, in pixels, of the pictures in a page.
pub const LONG_SIDE: u32 = 640;

#[derive(Args)]
pub struct Plan {
    #[command(flatten)]
    pub job: JobArgs,
    #[command(flatten)]
    pub cache: CacheUse,
    /// Plan for this node and its inputs only.
    #[arg(long, value_name = "NODE")]
    pub only: Option<String>,
    /// Print the plan as JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Args)]
pub struct Explain {
    /// A graph file, or the name of one that ships; or a PNG or EXR picture of a run.
    #[arg(value_name = "GRAPH|PICTURE", value_parser = graph_path)]
    pub first: PathBuf,
    /// After a graph, the edit file; after a picture, a graph whose picture is compared with it.
    #[arg(value_name = "EDIT|GRAPH", value_parser = graph_path)]
    pub second: Option<PathBuf>,
    /// After graph and edit, the node, such as `mix` or `direct[lamp_0]`; after a picture and a
    /// graph, the edit file.
    #[arg(value_name = "NODE|EDIT")]
    pub third: Option<String>,
    #[command(flatten)]
    pub files: SceneFiles,
    #[command(flatten)]
    pub cache: CacheUse,
}

#[derive(Args)]
pub struct Graph {
    #[command(flatten)]
    pub job: JobArgs,
    /// The output format.
    #[arg(long, value_enum, default_value_t = GraphFormat::Dot)]
    pub format: GraphFormat,
    /// Print the text of the graph file instead, to begin a graph of your own with.
    #[arg(long, conflicts_with_all = ["format", "edit"])]
    pub source: bool,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum GraphFormat {
    Dot,
    Mermaid,
    Svg,
    Json,
}

#[derive(Args)]
pub struct Nodes {
    /// One stage, such as `Direct`. Default: the list of all stages.
    pub kind: Option<String>,
    /// Print the whole reference as Markdown, the content of docs/nodes.md.
    #[arg(long, conflicts_with = "kind")]
    pub markdown: bool,
    /// Print the constants of all algorithms as Markdown, the content of docs/tuning.md.
    #[arg(long, conflicts_with_all = ["kind", "markdown"])]
    pub tuning: bool,
}

#[derive(Args)]
pub struct RunNetwork {
    /// The most memory, in bytes.
    pub memory_bytes: u64,
    /// The most processor time, in seconds.
    pub cpu_seconds: u64,
}

#[derive(Args)]
pub struct Cache {
    #[command(subcommand)]
    pub action: CacheAction,
}

#[derive(Subcommand)]
pub enum CacheAction {
    /// Print the number of entries and of bytes.
    Stat {
        #[command(flatten)]
        at: CacheAt,
        /// Count the blobs of this store instead: s3://BUCKET/PREFIX, gs://, az:// or
        /// file:///FOLDER.
        #[cfg(feature = "store")]
        #[arg(long, value_name = "URL", conflicts_with_all = ["cache", "cache_key"])]
        store: Option<String>,
    },
    /// Drop the least recently used entries until the cache fits its size, and remainders of
    /// crashed runs.
    Gc {
        #[command(flatten)]
        at: CacheAt,
        /// The size limit in bytes. Default: the limit of runs.
        #[arg(long, value_parser = whole::<u64>(0, u64::MAX))]
        bytes: Option<u64>,
    },
    /// Read every entry and drop the damaged ones.
    Verify(CacheAt),
    /// Drop every entry.
    Clear(CacheAt),
}

/// `1%` or `0.01`.
fn share(text: &str) -> Result<f32, String> {
    let (number, unit) = text.strip_suffix('%').map_or((text, 1.0), |number| (number, 0.01));
    let share = number.trim().parse::<f64>().map(|number| (number * unit) as f32);
    share
        .ok()
        .filter(|share| *share > 0.0 && *share < 1.0)
        .ok_or("wanted a share above 0 and below 1, as `1%`".into())
}

/// `lamp_0=0.5`, `lamp_0=2,1,0.5`, `lamp_0=#ffd0a0`, `lamp_0=0.5*#ffd0a0`.
fn weight(text: &str) -> Result<(String, [f32; 3]), String> {
    let number = |text: &str| {
        text.trim().parse::<f32>().ok().filter(|number| number.is_finite() && *number >= 0.0)
    };
    let parts = text.split_once('=').and_then(|(id, value)| {
        let (factor, color) = value.rsplit_once('*').unwrap_or(("1", value));
        let factor = number(factor)?;
        let color = match color.trim().strip_prefix('#') {
            Some(digits) => srgb(digits)?,
            None => match color.split(',').map(number).collect::<Option<Vec<f32>>>()?[..] {
                [gray] => [gray; 3],
                [r, g, b] => [r, g, b],
                _ => return None,
            },
        };
        Some((id.trim().to_owned(), color.map(|channel| factor * channel)))
    });
    let finite =
        parts.filter(|(id, weight)| !id.is_empty() && weight.iter().all(|w| w.is_finite()));
    finite
        .ok_or("wanted a light and a weight of 0 or more, as `lamp_0=0.5`, `lamp_0=2,1,0.5` or `lamp_0=#ffd0a0`".into())
}

/// `room.usda` or `room.usdz`.
fn usda(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let sound = path.extension().is_some_and(|ending| ending == "usda" || ending == "usdz");
    if sound {
        Ok(path)
    } else {
        Err("wanted NAME.usda, USD as text, or NAME.usdz, a package of it and its texture".into())
    }
}

/// `212,80,212,395=2.03`, as RON.
fn known_length(text: &str) -> Result<String, String> {
    let number = |text: &str| text.trim().parse::<f32>().ok().filter(|number| number.is_finite());
    let parts = text.split_once('=').and_then(|(pixels, meters)| {
        let pixels = pixels.split(',').map(number).collect::<Option<Vec<f32>>>()?;
        Some((<[f32; 4]>::try_from(pixels).ok()?, number(meters.trim().trim_end_matches('m'))?))
    });
    let ([ax, ay, bx, by], meters) =
        parts.ok_or("wanted two pixels and the meters between them, as `212,80,212,395=2.03`")?;
    Ok(format!("(from: ({ax:?}, {ay:?}), to: ({bx:?}, {by:?}), meters: {meters:?})"))
}

/// `500ms`, `2s`, `1.5min`.
fn duration(text: &str) -> Result<Duration, String> {
    let digits = text.find(|c: char| c.is_alphabetic()).unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let unit =
        [("ms", 1e-3), ("s", 1.0), ("min", 60.0)].into_iter().find(|(name, _)| *name == unit);
    let seconds = unit.and_then(|(_, seconds)| Some(number.trim().parse::<f64>().ok()? * seconds));
    let time = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    time.filter(|time| !time.is_zero())
        .ok_or("wanted a number and a unit, as `500ms`, `2s` or `1min`".into())
}

/// A number above 0.
fn positive(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(number) if number > 0.0 && number.is_finite() => Ok(number),
        _ => Err("wanted a number above 0, as `1.5`, without a unit".into()),
    }
}

/// A field of view, degrees.
fn field_of_view(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|degrees| (1.0..=175.0).contains(degrees)).ok_or_else(|| {
        "wanted degrees from 1 to 175, as `67.4`; phones have 60 to 75 in a lying photo".into()
    })
}

/// A height in a room, meters.
fn height(text: &str) -> Result<f32, String> {
    let meters = positive(text)?;
    let centimeters = meters / 100.0;
    match meters {
        ..=MAX_HEIGHT => Ok(meters),
        _ => Err(format!(
            "wanted meters up to {MAX_HEIGHT}; if these are centimeters, write `{centimeters}`"
        )),
    }
}

/// Reads a whole number from `low` to `high`.
pub fn whole<T: TryFrom<u64>>(low: u64, high: u64) -> impl Fn(&str) -> Result<T, String> + Clone {
    move |text| {
        let number = text.parse::<u64>().ok().filter(|number| (low..=high).contains(number));
        let up_to = if high == u64::MAX { String::new() } else { format!(" to {high}") };
        number
            .and_then(|number| T::try_from(number).ok())
            .ok_or_else(|| format!("wanted a whole number from {low}{up_to}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_and_durations_are_read_as_people_write_them() {
        for (text, wanted) in [("1%", 0.01), ("0.01", 0.01), ("2.5 %", 0.025)] {
            assert_eq!(share(text), Ok(wanted), "{text}");
        }
        for (text, wanted) in [("500ms", 500), ("2s", 2000), ("0.5 s", 500), ("1min", 60_000)] {
            assert_eq!(duration(text), Ok(Duration::from_millis(wanted)), "{text}");
        }
        for text in ["212,80,212.5,395=2.03", " 212, 80, 212.5, 395 = 2.03 m"] {
            assert_eq!(
                known_length(text).as_deref(),
                Ok("(from: (212.0, 80.0), to: (212.5, 395.0), meters: 2.03)"),
                "{text}"
            );
        }
        for text in [
            "",
            "1,2,3=4",
            "1,2,3,4",
            "1,2,3,4=",
            "1,2,3,4,5=6",
            "1,2,3,nan=4",
            "1;2;3;4=5",
            "1,2,3,4=2km",
            "1,2,3,4=inf",
        ] {
            assert!(known_length(text).is_err(), "{text}");
        }
        for text in ["", "%", "0", "-1%", "100%", "nan", "inf%", "one"] {
            assert!(share(text).is_err(), "{text}");
        }
        for (text, wanted) in [
            ("lamp_0=0.5", [0.5; 3]),
            (" lamp_0 = 2, 1, 0.5", [2.0, 1.0, 0.5]),
            ("lamp_0=#ff0080", [1.0, 0.0, 0.215_860_5]),
            ("lamp_0=0.5*#ff00ff", [0.5, 0.0, 0.5]),
            ("lamp_0=0", [0.0; 3]),
        ] {
            let (id, got) = weight(text).expect(text);
            assert_eq!(id, "lamp_0");
            assert!(
                got.iter().zip(wanted).all(|(got, wanted)| (got - wanted).abs() < 1e-6),
                "{text}: {got:?}"
            );
        }
        for text in [
            "",
            "lamp_0",
            "=1",
            "a=",
            "a=-1",
            "a=nan",
            "a=inf",
            "a=1,2",
            "a=1,2,3,4",
            "a=#fff",
            "a=#ggffff",
            "a=#-12345",
            "a=1*2*3",
            "a=3e38*2",
        ] {
            assert!(weight(text).is_err(), "{text}");
        }
        for text in ["", "500", "ms", "-1s", "0s", "nans", "infs", "1h", "1e300s"] {
            assert!(duration(text).is_err(), "{text}");
        }
    }
}
