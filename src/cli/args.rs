//! The arguments, declared once: the help text is made from here.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};
use relight::graph::Reach;
use relight::nodes::output::mix_layers::srgb;

/// One indoor photograph in, the same room under other light out.
///
/// A graph file describes the pipeline, a scene folder holds the photograph with its depth and masks, an edit file says
/// what shall change. Results are kept in a cache, so that only what an edit changes is computed again.
#[derive(Parser)]
#[command(name = "relight", version, after_help = EXAMPLES, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
    /// Tell more on standard error: one line per node (-v), what the engine does (-vv), everything (-vvv).
    ///
    /// The environment variable RELIGHT_LOG takes a tracing filter, such as `relight=debug`, and wins over this.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
}

const EXAMPLES: &str = "\
Example: switch a lamp off in the scene that ships with relight
  relight check graphs/demo.ron edits/lamp_off.ron   # are the files right? computes nothing
  relight plan  graphs/demo.ron edits/lamp_off.ron   # what would run, what is in the cache
  relight run   graphs/demo.ron edits/lamp_off.ron   # writes out/picture.png and more

A photograph of your own: put scene.ron beside it (docs/files.md), then
  relight run graphs/indoor.ron edits/none.ron --scene my_room --out my_room/out

Exit status: 0 done, 1 a stage failed, 2 bad arguments or files, 130 interrupted.";

#[derive(Subcommand)]
pub enum Command {
    /// Relight: compute what the edit changes and write the pictures.
    Run(Run),
    /// Weight the lights of a finished run anew, in milliseconds: dim, brighten, colour.
    Mix(Mix),
    /// Write report.html of a finished run: before and after, a slider per light, what ran and why.
    Report(Report),
    /// Write the room as USD, for Blender and others: seen surface, albedo, camera, lights as the edit leaves them.
    Export(Export),
    /// Show what `run` would do: taken from the cache, run, or unknown until something upstream has run.
    Plan(Plan),
    /// Tell why a node would run again: the first line of its key that differs.
    Explain(Explain),
    /// Check the files and report every fault; computes nothing.
    Check(Job),
    /// Print the graph as it stands with scene and edit, for a drawing program.
    Graph(Graph),
    /// Print the reference of all stages, or of one.
    Nodes(Nodes),
    /// Look after the cache.
    Cache(Cache),
    /// Measure error against run time: sampling strategies, shadows, whole pictures.
    Bench(Bench),
    /// Measure what a graph estimates and renders against a scene's truth, and which part loses what.
    Eval(Eval),
    /// Compute a network that does not ship with relight, for the run that starts this process.
    #[command(hide = true)]
    RunNetwork(RunNetwork),
}

/// The files of a run.
#[derive(Args, Default)]
pub struct Files {
    /// The scene: a folder with a scene.ron; instead of the one that the graph file names.
    #[arg(long, value_name = "DIR")]
    pub scene: Option<PathBuf>,
    /// One frame, from 0, of an edit with `frames`. Default: all of them where pictures are made, else the first.
    #[arg(long, value_name = "N")]
    pub frame: Option<u32>,
    /// Set one parameter of one node, as RON; may be given several times, and wins over graph, scene and edit.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    pub set: Vec<String>,
    /// The standard error to reach, as `1%` or `0.01`: sets the parameter `target_error` of every node that has it.
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub target_error: Option<f32>,
    /// Two pixels of the photo and the metres between them in the room, as `212,80,212,395=2.03`; may be given several times.
    ///
    /// Gives depth by a network its scale (graphs/depth.ron); two or more at different depths give its span too.
    #[arg(long, value_name = "X,Y,X,Y=METRES", value_parser = known_length)]
    pub known_length: Vec<String>,
    /// Scene, edit, graph and models may only name files below their own folders: for files of strangers.
    #[arg(long)]
    pub confined: bool,
    #[command(flatten)]
    pub networks: Networks,
}

impl Files {
    /// The files that those of the run may name.
    pub fn reach(&self) -> Reach {
        if self.confined { Reach::OwnFolder } else { Reach::Anywhere }
    }
}

/// Where the networks lie, and who computes them.
#[derive(Args, Clone, Default)]
pub struct Networks {
    /// The folder of the networks. Default: `models` beside the program, or in a folder above it.
    #[arg(long, value_name = "DIR")]
    pub models: Option<PathBuf>,
    /// Who computes the networks: `ort` is ONNX Runtime, `rten` is part of this program, `auto` takes ONNX Runtime where its library is found.
    #[arg(long, value_enum, default_value_t)]
    pub backend: WhichBackend,
    /// The library of ONNX Runtime (libonnxruntime.so, .dylib, .dll); else that of the environment variable ORT_DYLIB_PATH, else the system's.
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
pub struct Job {
    /// The graph file.
    pub graph: PathBuf,
    /// The edit file; without it nothing is changed.
    pub edit: Option<PathBuf>,
    #[command(flatten)]
    pub files: Files,
}

#[derive(Args)]
pub struct CacheAt {
    /// The cache folder, made when it is not there. Default: `relight` in the user's own cache folder (on Linux
    /// ~/.cache/relight), shared by all projects. Runs keep a cache to 10 GiB: the results used longest ago are dropped.
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// A file with the secret that signs the entries of a cache which several users share; entries with another signature
    /// are not used. Default: a key of the user's own, made when first needed (on Linux ~/.config/relight/cache.key).
    #[arg(long, value_name = "FILE")]
    pub cache_key: Option<PathBuf>,
}

#[derive(Args)]
pub struct CacheUse {
    #[command(flatten)]
    pub at: CacheAt,
    /// Neither read nor write a cache on disk.
    #[arg(long, conflicts_with_all = ["cache", "cache_key"])]
    pub no_cache: bool,
}

#[derive(Args)]
pub struct Run {
    /// The graph file.
    pub graph: PathBuf,
    /// The edit file (edits/none.ron changes nothing).
    pub edit: PathBuf,
    #[command(flatten)]
    pub files: Files,
    /// The folder for the results; made when it is not there.
    #[arg(long, value_name = "DIR", default_value = "out")]
    pub out: PathBuf,
    /// Let results replace files that the run reads.
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub cache: CacheUse,
    /// How many threads work; the result is the same for any number. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Time for each light's direct light and each light's shadow, as `500ms`, `2s` or `1min`; it stops with what it has then.
    ///
    /// What is cut short is used for this run's pictures and not kept in the cache.
    #[arg(long, value_name = "TIME", value_parser = duration, conflicts_with = "verify")]
    pub budget: Option<Duration>,
    /// Evaluate this node, or this member of a set such as `direct[lamp_0]`, and what it needs, and nothing else.
    #[arg(long, value_name = "NODE")]
    pub only: Option<String>,
    /// Of a sequence, write picture.exr with all layers for each frame too.
    #[arg(long)]
    pub exr: bool,
    /// Frames per second of film.mp4, which a whole sequence becomes where ffmpeg is on PATH.
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u16).range(1..=240))]
    pub fps: u16,
    /// Print report.json on standard output instead of the paths written.
    #[arg(long)]
    pub json: bool,
    /// Write report.html too, as `relight report` does.
    #[arg(long, conflicts_with_all = ["verify", "only"])]
    pub report: bool,
    /// Compute everything again that the cache holds for this run, and compare; writes no pictures.
    #[arg(long, conflicts_with = "no_cache")]
    pub verify: bool,
}

#[derive(Args)]
pub struct Mix {
    /// The folder that `relight run` wrote to (its --out), or a picture.exr.
    pub run: PathBuf,
    /// What a light is multiplied by, in linear light: `0.5`, `2,1,0.5` (red, green, blue), `#ffd0a0` (an sRGB colour) or `0.5*#ffd0a0`; may
    /// be given once for each light.
    #[arg(long, value_name = "LIGHT=WEIGHT", value_parser = weight)]
    pub set: Vec<(String, [f32; 3])>,
    /// The folder for picture.png and picture.exr, made when it is not there; or the name of one file, by its ending.
    #[arg(long, value_name = "FILE|DIR", default_value = "out/mix")]
    pub out: PathBuf,
    /// Let results replace the file that is read.
    #[arg(long)]
    pub force: bool,
}

#[derive(Args)]
pub struct Report {
    /// The folder that `relight run` wrote to (its --out); report.html is written into it.
    pub run: PathBuf,
    /// Longest side of the pictures in the page, in pixels.
    #[arg(long, value_name = "PIXELS", default_value_t = LONG_SIDE, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub long_side: u32,
}

#[derive(Args)]
pub struct Export {
    #[command(flatten)]
    pub job: Job,
    /// The USD file, NAME.usda; its texture goes beside it.
    #[arg(long, value_name = "FILE", default_value = "out/room.usda", value_parser = usda)]
    pub out: PathBuf,
    /// Let results replace files that the run reads.
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub cache: CacheUse,
}

/// What a page shows of a large photo when nobody says more.
pub const LONG_SIDE: u32 = 640;

#[derive(Args)]
pub struct Plan {
    #[command(flatten)]
    pub job: Job,
    #[command(flatten)]
    pub cache: CacheUse,
    /// Plan for this node and what it needs, and nothing else.
    #[arg(long, value_name = "NODE")]
    pub only: Option<String>,
    /// Print the plan as JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Args)]
pub struct Explain {
    /// The graph file.
    pub graph: PathBuf,
    /// The edit file.
    pub edit: PathBuf,
    /// The node, such as `mix` or `direct[lamp_0]`.
    pub node: String,
    #[command(flatten)]
    pub files: Files,
    #[command(flatten)]
    pub cache: CacheUse,
}

#[derive(Args)]
pub struct Graph {
    #[command(flatten)]
    pub job: Job,
    #[arg(long, value_enum, default_value_t = Format::Dot)]
    pub format: Format,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum Format {
    Dot,
    Mermaid,
    Svg,
    Json,
}

#[derive(Args)]
pub struct Nodes {
    /// One stage, such as `Direct`; without it the list of all.
    pub kind: Option<String>,
    /// The whole reference as Markdown: docs/nodes.md is made from it.
    #[arg(long, conflicts_with = "kind")]
    pub markdown: bool,
    /// The constants of all algorithms as Markdown: docs/tuning.md is made from it.
    #[arg(long, conflicts_with_all = ["kind", "markdown"])]
    pub tuning: bool,
}

#[derive(Args)]
pub struct Bench {
    /// The graph file.
    #[arg(default_value = "graphs/demo.ron")]
    pub graph: PathBuf,
    /// The scene: a folder with a scene.ron; instead of the one that the graph file names.
    #[arg(long, value_name = "DIR")]
    pub scene: Option<PathBuf>,
    /// Set one parameter of one node, as RON; may be given several times.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    pub set: Vec<String>,
    /// The folder for bench.json, bench.csv and the plots; made when it is not there.
    #[arg(long, value_name = "DIR", default_value = "out/bench")]
    pub out: PathBuf,
    /// Samples per pixel at which estimators are measured; each has at least four, one per batch.
    #[arg(long, value_name = "N,..", value_delimiter = ',', default_value = "4,16,64,256,1024,4096",
          value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub samples: Vec<u32>,
    /// Longer side, in pixels, of the pictures on which single estimators are measured; whole pictures keep the graph's size.
    #[arg(long, value_name = "PIXELS", default_value_t = 64, value_parser = clap::value_parser!(u32).range(8..=4096))]
    pub side: u32,
    /// Ask these questions only.
    #[arg(long, value_enum, value_name = "QUESTION,..", value_delimiter = ',')]
    pub only: Vec<Question>,
    /// Little of each, and whole pictures of `--side` too. Tells that it works, not how well.
    #[arg(long)]
    pub quick: bool,
    /// How many threads work. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Print bench.json on standard output instead of the tables.
    #[arg(long)]
    pub json: bool,
}

#[derive(Args)]
pub struct Eval {
    /// The scene: a folder with a scene.ron that names its `truth`.
    pub scene: PathBuf,
    /// The graph file.
    #[arg(long, value_name = "GRAPH", default_value = "graphs/indoor.ron")]
    pub graph: PathBuf,
    /// Set one parameter of one node, as RON; may be given several times.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    pub set: Vec<String>,
    /// Measure the graph as it is, without the steps that replace its parts by the truth.
    #[arg(long)]
    pub no_ladder: bool,
    /// The folder for eval.json; made when it is not there.
    #[arg(long, value_name = "DIR", default_value = "out/eval")]
    pub out: PathBuf,
    #[command(flatten)]
    pub networks: Networks,
    #[command(flatten)]
    pub cache: CacheUse,
    /// How many threads work. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Print eval.json on standard output instead of the tables.
    #[arg(long)]
    pub json: bool,
}

#[derive(Args)]
pub struct RunNetwork {
    /// The most memory, in bytes.
    pub memory_bytes: u64,
    /// The most processor time, in seconds.
    pub cpu_seconds: u64,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Question {
    /// Every sampling strategy for windows, by lobe.
    Strategies,
    /// The same by bandwidth of the lobe.
    Bandwidths,
    /// Direct light with its shadow: fixed numbers of samples against adaptive sampling.
    Shadows,
    /// Whole pictures against truth and against their own limit.
    Pipeline,
}

#[derive(Args)]
pub struct Cache {
    #[command(subcommand)]
    pub action: CacheAction,
}

#[derive(Subcommand)]
pub enum CacheAction {
    /// How many entries, how many bytes.
    Stat(CacheAt),
    /// Drop the entries used longest ago until the cache keeps to its size, and what crashed runs left behind.
    Gc {
        #[command(flatten)]
        at: CacheAt,
        /// The size to keep to, in bytes; the size that runs keep to when not given.
        #[arg(long)]
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
    share.ok().filter(|share| *share > 0.0 && *share < 1.0).ok_or("wanted a share above 0 and below 1, as `1%`".into())
}

/// `lamp_0=0.5`, `lamp_0=2,1,0.5`, `lamp_0=#ffd0a0`, `lamp_0=0.5*#ffd0a0`.
fn weight(text: &str) -> Result<(String, [f32; 3]), String> {
    let number = |text: &str| text.trim().parse::<f32>().ok().filter(|number| number.is_finite() && *number >= 0.0);
    let parts = text.split_once('=').and_then(|(id, value)| {
        let (factor, colour) = value.rsplit_once('*').unwrap_or(("1", value));
        let factor = number(factor)?;
        let colour = match colour.trim().strip_prefix('#') {
            Some(digits) => srgb(digits)?,
            None => match colour.split(',').map(number).collect::<Option<Vec<f32>>>()?[..] {
                [grey] => [grey; 3],
                [r, g, b] => [r, g, b],
                _ => return None,
            },
        };
        Some((id.trim().to_owned(), colour.map(|channel| factor * channel)))
    });
    let finite = parts.filter(|(id, weight)| !id.is_empty() && weight.iter().all(|w| w.is_finite()));
    finite
        .ok_or("wanted a light and a weight of 0 or more, as `lamp_0=0.5`, `lamp_0=2,1,0.5` or `lamp_0=#ffd0a0`".into())
}

/// `room.usda`.
fn usda(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let sound = path.extension().is_some_and(|ending| ending == "usda");
    if sound { Ok(path) } else { Err("wanted a file NAME.usda: USD as text is what is written".into()) }
}

/// `212,80,212,395=2.03`, as RON.
fn known_length(text: &str) -> Result<String, String> {
    let number = |text: &str| text.trim().parse::<f32>().ok().filter(|number| number.is_finite());
    let parts = text.split_once('=').and_then(|(pixels, metres)| {
        let pixels = pixels.split(',').map(number).collect::<Option<Vec<f32>>>()?;
        Some((<[f32; 4]>::try_from(pixels).ok()?, number(metres.trim().trim_end_matches('m'))?))
    });
    let ([ax, ay, bx, by], metres) =
        parts.ok_or("wanted two pixels and the metres between them, as `212,80,212,395=2.03`")?;
    Ok(format!("(from: ({ax:?}, {ay:?}), to: ({bx:?}, {by:?}), metres: {metres:?})"))
}

/// `500ms`, `2s`, `1.5min`.
fn duration(text: &str) -> Result<Duration, String> {
    let digits = text.find(|c: char| c.is_alphabetic()).unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let unit = [("ms", 1e-3), ("s", 1.0), ("min", 60.0)].into_iter().find(|(name, _)| *name == unit);
    let seconds = unit.and_then(|(_, seconds)| Some(number.trim().parse::<f64>().ok()? * seconds));
    let time = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    time.filter(|time| !time.is_zero()).ok_or("wanted a number and a unit, as `500ms`, `2s` or `1min`".into())
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
                Ok("(from: (212.0, 80.0), to: (212.5, 395.0), metres: 2.03)"),
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
            assert!(got.iter().zip(wanted).all(|(got, wanted)| (got - wanted).abs() < 1e-6), "{text}: {got:?}");
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
