//! `relight bench`: error against run time.

mod measure;
mod plot;
mod questions;
mod session;
mod tables;

use std::time::Instant;

use serde::Serialize;

use super::args::{Bench, Question};
use super::messages::message;
use super::write::{self, Output};
use super::{CliError, Exit, Stop, ended, report};
use measure::Point;
use plot::{Axis, Plot};
use session::{Session, Set};

/// How much is measured.
pub struct Effort {
    /// Longer side in pixels of the pictures on which single estimators are measured.
    side: u32,
    samples: Vec<u32>,
    /// Samples at which the bandwidths are swept.
    sweep: u32,
    /// Most shadow rays per pixel: each costs as much as ten samples.
    most_rays: u32,
    bandwidths: Vec<f64>,
    /// Relative errors that adaptive sampling is asked for.
    targets: Vec<f64>,
    /// Samples of whole pictures.
    pipeline: Vec<u32>,
    /// Whole pictures are as large as the graph makes them.
    whole: bool,
    /// Estimates of most samples that make a reference.
    references: usize,
    /// Time within which an estimate is repeated.
    repeat_seconds: f64,
}

impl Effort {
    fn new(args: &Bench) -> Effort {
        let mut samples = args.samples.clone();
        samples.sort_unstable();
        samples.dedup();
        let pipeline = samples.iter().copied().filter(|n| *n <= 64).collect();
        let all = Effort {
            side: args.side,
            samples,
            sweep: 64,
            most_rays: 256,
            bandwidths: (0..7).map(|exponent| 10f64.powi(exponent)).collect(),
            targets: vec![0.1, 0.03, 0.01],
            pipeline,
            whole: !args.quick,
            references: 4,
            repeat_seconds: 0.3,
        };
        if !args.quick {
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

    /// What makes the pictures small on which single estimators are measured; there windows have three lobes, whatever so small a photo asks for.
    fn small(&self) -> Vec<Set> {
        let outlook = ("InitLights", "outlook", "Daylight(1e4,1.5,1.5)".to_owned());
        vec![("ReadScene", "long_side", self.side.to_string()), outlook]
    }
}

const PLOTS: [Plot; 5] = [
    Plot {
        name: "strategies",
        title: "Direct light of a window, unshadowed: error against time",
        x: Axis::Seconds("time of Direct"),
        y: "relative error",
    },
    Plot {
        name: "bandwidths",
        title: "Direct light of a window: error against bandwidth at equal samples",
        x: Axis::Bandwidth,
        y: "relative error",
    },
    Plot {
        name: "shadows",
        title: "Direct light with its shadow: error against time",
        x: Axis::Seconds("time of Direct and Shadow"),
        y: "relative error",
    },
    Plot {
        name: "pipeline",
        title: "Whole pictures against truth: error of the change against time",
        x: Axis::Seconds("time of a run from nothing"),
        y: "error of the change",
    },
    Plot {
        name: "noise",
        title: "Whole pictures against their own limit: difference against time",
        x: Axis::Seconds("time of a run from nothing"),
        y: "mean difference",
    },
];

#[derive(Serialize)]
struct Report<'a> {
    relight: &'static str,
    graph: String,
    scene: Option<String>,
    threads: usize,
    seconds: f64,
    side: u32,
    points: &'a [Point],
}

pub fn bench(args: &Bench, began: Instant) -> Result<Exit, CliError> {
    ended(measured(args, began))
}

fn measured(args: &Bench, began: Instant) -> Result<(), Stop> {
    let effort = Effort::new(args);
    let session = Session::new(args)?;
    let out = Output::new(&args.out, [args.graph.clone()], false)?; // told before the work, not after it
    let asked = |question: Question| args.only.is_empty() || args.only.contains(&question);
    let mut points = Vec::new();
    type Ask = fn(&Session, &Effort) -> Result<Vec<Point>, Stop>;
    let questions: [(Question, Ask); 4] = [
        (Question::Strategies, questions::strategies),
        (Question::Bandwidths, questions::bandwidths),
        (Question::Shadows, questions::shadows),
        (Question::Pipeline, questions::pipeline),
    ];
    for (question, ask) in questions {
        if asked(question) {
            points.extend(ask(&session, &effort)?);
        }
    }
    let report = Report {
        relight: env!("CARGO_PKG_VERSION"),
        graph: args.graph.display().to_string(),
        scene: session.scene().map(|path| path.display().to_string()),
        threads: session.threads(),
        seconds: began.elapsed().as_secs_f64(),
        side: effort.side,
        points: &points,
    };
    let json = report::text(&report);
    let mut files = vec![("bench.json".to_owned(), json.clone()), ("bench.csv".to_owned(), tables::csv(&points))];
    for plot in &PLOTS {
        files.extend(plot.draw(&points).map(|svg| (format!("{}.svg", plot.name), svg)));
    }
    for path in out.write(&files)? {
        message!("{}", path.display());
    }
    let threads = session.threads();
    let seconds = report.seconds;
    let run =
        format!("{threads} threads, {seconds:.0} s in all; single estimators on {} pixels across.\n", effort.side);
    let text = if args.json { json } else { format!("<!-- table: run -->\n{run}\n{}", tables::markdown(&points)) };
    write::print(&text)?;
    Ok(())
}
