//! Error against run time: the experiments of `relight bench`.

mod error;
mod lights;
mod pictures;
#[cfg(feature = "plots")]
mod plot;
mod tables;

use clap::{Args, ValueEnum};
use serde::Serialize;

pub use error::{Estimate, LobeEstimate, Point};

/// One parameter of all stages of a kind: kind, name and value as RON.
pub type ParamSetting = (&'static str, &'static str, String);

/// A light of the scene.
pub struct SceneLight {
    /// Member of the graph's set of lights.
    pub name: String,
    /// Whether the photo shows it.
    pub visible: bool,
}

/// A picture in linear light, red, green and blue of each pixel in turn.
pub struct Picture {
    /// Linear Rec. 709 radiance, three values per pixel.
    pub channels: Vec<f64>,
    /// Wall time of the whole run.
    pub seconds: f64,
    /// Rays traced in the run.
    pub rays: u64,
}

/// The ground truth of a scene.
#[derive(Default)]
pub struct Truth {
    /// Lights by name with the linear picture by that light alone; their sum is the photo.
    pub lights: Vec<(String, Vec<f64>)>,
    /// Whether a pixel shows a light; such a pixel does not count.
    pub emitters: Vec<bool>,
}

/// The program under measurement: a graph on a scene, run with other parameters again and again.
pub trait Renderer {
    /// Error of a run; it ends the experiment.
    type Error;

    /// Returns a seed that no other call has returned. A cached result would not take any run time.
    fn seed(&self) -> u64;

    /// Lists the lights of the scene, in the order of the graph's set.
    ///
    /// # Errors
    /// The graph cannot be read or run.
    fn lights(&self) -> Result<Vec<SceneLight>, Self::Error>;

    /// Estimates the unshadowed direct shading of a light, per lobe of unit radiance.
    ///
    /// # Errors
    /// The run fails or is cancelled.
    fn direct(&self, light: &str, settings: &[ParamSetting]) -> Result<Estimate, Self::Error>;

    /// Estimates the visibility of a light, 0..=1 per lobe.
    ///
    /// # Errors
    /// The run fails or is cancelled.
    fn visibility(&self, light: &str, settings: &[ParamSetting]) -> Result<Estimate, Self::Error>;

    /// Reads the ground truth; without any, `lights` is empty.
    ///
    /// # Errors
    /// The files of the truth cannot be read, or have another size than the scene.
    fn truth(&self) -> Result<Truth, Self::Error>;

    /// Renders edited pictures under one group of settings after the other, from an empty cache:
    /// the first one computes everything, each later one reuses the results that its settings do
    /// not change.
    ///
    /// # Errors
    /// A run fails or is cancelled.
    fn pictures(&self, settings: &[Vec<ParamSetting>]) -> Result<Vec<Picture>, Self::Error>;

    /// Shows one line of progress.
    fn message(&self, text: &str);
}

/// An experiment of `relight bench`.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Question {
    /// Every sampling strategy for windows, by lobe.
    Strategies,
    /// Every sampling strategy, by bandwidth of the lobe.
    Bandwidths,
    /// Direct light with its shadow: fixed numbers of samples against adaptive sampling.
    Shadows,
    /// Whole pictures against the truth and against their own limit.
    Pipeline,
}

/// Arguments that determine which experiments run, and at which sizes.
#[derive(Args)]
pub struct Options {
    /// Samples per pixel at which estimators are measured; each has at least four, one per batch.
    #[arg(long, value_name = "N,..", value_delimiter = ',', default_value = "4,16,64,256,1024,4096",
          value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub samples: Vec<u32>,
    /// Longer side, in pixels, of the pictures on which single estimators are measured; whole
    /// pictures keep the graph's size.
    #[arg(long, value_name = "PIXELS", default_value_t = 64, value_parser = clap::value_parser!(u32).range(8..=4096))]
    pub side: u32,
    /// Run these experiments only.
    #[arg(long, value_enum, value_name = "QUESTION,..", value_delimiter = ',')]
    pub only: Vec<Question>,
    /// Run a short version of each, with whole pictures of `--side` too: a check that it works, not
    /// a measurement.
    #[arg(long)]
    pub quick: bool,
}

/// Sizes of the experiments.
struct Effort {
    /// Longer side, in pixels, of the pictures on which single estimators are measured.
    side: u32,
    /// Samples per pixel and lobe, ascending, at least one.
    samples: Vec<u32>,
    /// Samples at which the bandwidths are swept.
    sweep: u32,
    /// Largest number of shadow rays per pixel; each costs as much as ten samples.
    most_rays: u32,
    bandwidths: Vec<f64>,
    /// Relative errors that adaptive sampling must reach.
    targets: Vec<f64>,
    /// Samples of whole pictures.
    pipeline: Vec<u32>,
    /// Whether whole pictures are as large as the graph makes them.
    whole: bool,
    /// Number of estimates, at most samples, of which a reference is the mean.
    references: usize,
    /// Time within which an estimate is repeated.
    repeat_seconds: f64,
}

impl Effort {
    fn new(options: &Options) -> Effort {
        let mut samples = options.samples.clone();
        samples.sort_unstable();
        samples.dedup();
        let pipeline = samples.iter().copied().filter(|n| *n <= 64).collect();
        let all = Effort {
            side: options.side,
            samples,
            sweep: 64,
            most_rays: 256,
            bandwidths: (0..7).map(|exponent| 10f64.powi(exponent)).collect(),
            targets: vec![0.1, 0.03, 0.01],
            pipeline,
            whole: !options.quick,
            references: 4,
            repeat_seconds: 0.3,
        };
        if !options.quick {
            return all;
        }
        let least: Vec<u32> = all.samples.iter().copied().take(2).collect();
        Effort {
            sweep: least[least.len() - 1],
            bandwidths: vec![1.0, 1e4],
            targets: vec![0.1],
            pipeline: least.iter().copied().take(1).collect(),
            samples: least,
            references: 2,
            repeat_seconds: 0.0,
            ..all
        }
    }

    fn most(&self) -> u32 {
        self.samples[self.samples.len() - 1]
    }

    /// Settings of the small pictures on which single estimators are measured. Windows have three
    /// lobes there, independent of the choice of `InitLights` for the small photo.
    fn small(&self) -> Vec<ParamSetting> {
        let emission = ("InitLights", "window_emission", "Daylight(1e4,1.5,1.5)".to_owned());
        vec![("ReadScene", "long_side", self.side.to_string()), emission]
    }
}

/// A quantity that a line of a plot varies.
#[derive(Clone, Copy)]
enum At {
    /// Samples per pixel and lobe.
    Samples(u32),
    /// Relative standard error.
    Target(f64),
}

impl At {
    fn settings(self) -> Vec<ParamSetting> {
        match self {
            At::Samples(n) => [both("samples", n), both("target_error", 0)].concat(),
            At::Target(target) => both("target_error", target),
        }
    }

    fn samples(self) -> Option<u32> {
        match self {
            At::Samples(n) => Some(n),
            At::Target(_) => None,
        }
    }

    fn target(self) -> Option<f64> {
        match self {
            At::Samples(_) => None,
            At::Target(target) => Some(target),
        }
    }
}

/// One parameter of all stages that sample lights.
fn both(field: &'static str, value: impl ToString) -> Vec<ParamSetting> {
    let value = value.to_string();
    vec![("Direct", field, value.clone()), ("Shadow", field, value)]
}

/// All settings in order, and a new seed.
fn seeded(renderer: &impl Renderer, settings: &[Vec<ParamSetting>]) -> Vec<ParamSetting> {
    let seed = both("seed", renderer.seed());
    settings.iter().flatten().cloned().chain(seed).collect()
}

/// Runs the experiments that `options` selects and returns their marks in order.
///
/// # Errors
/// Those of `renderer`.
pub fn measure<R: Renderer>(renderer: &R, options: &Options) -> Result<Vec<Point>, R::Error> {
    let effort = Effort::new(options);
    type Experiment<R> = fn(&R, &Effort) -> Result<Vec<Point>, <R as Renderer>::Error>;
    let experiments: [(Question, Experiment<R>); 4] = [
        (Question::Strategies, lights::strategies),
        (Question::Bandwidths, lights::bandwidths),
        (Question::Shadows, lights::shadows),
        (Question::Pipeline, pictures::pipeline),
    ];
    let mut points = Vec::new();
    for (question, run) in experiments {
        if options.only.is_empty() || options.only.contains(&question) {
            points.extend(run(renderer, &effort)?);
        }
    }
    Ok(points)
}

/// The content of bench.json.
#[derive(Serialize)]
pub struct BenchReport {
    /// Version of the program.
    pub relight: &'static str,
    /// Path of the graph file.
    pub graph: String,
    /// Path of the scene, if one was given.
    pub scene: Option<String>,
    /// Worker threads of the engine.
    pub threads: usize,
    /// Wall time of all experiments.
    pub seconds: f64,
    /// Longer side, in pixels, of the pictures on which single estimators are measured.
    pub side: u32,
    /// All measured marks.
    pub points: Vec<Point>,
}

impl BenchReport {
    /// bench.csv and, with the feature `plots`, one SVG per plot that has a mark: names and texts.
    pub fn files(&self) -> Vec<(String, String)> {
        let csv = ("bench.csv".to_owned(), tables::csv(&self.points));
        #[cfg(feature = "plots")]
        let plots = plot::draw_all(&self.points);
        #[cfg(not(feature = "plots"))]
        let plots = Vec::new();
        [csv].into_iter().chain(plots).collect()
    }

    /// The tables in Markdown, each under a line that names it.
    pub fn markdown(&self) -> String {
        let BenchReport { threads, seconds, side, .. } = self;
        let run = format!(
            "{threads} threads, {seconds:.0} s in all; single estimators on {side} pixels across.\n"
        );
        format!("<!-- table: run -->\n{run}\n{}", tables::markdown(&self.points))
    }
}
