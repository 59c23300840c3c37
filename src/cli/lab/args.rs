//! The arguments of `relight bench` and `relight eval`.

use std::path::PathBuf;

use clap::Args;
use relight_lab::bench::Options;

use crate::cli::args::{CacheUse, Networks};
use crate::cli::shipped::graph_path;

#[derive(Args)]
pub struct Bench {
    /// The graph file, or the name of one that ships.
    #[arg(default_value = "demo", value_parser = graph_path)]
    pub graph: PathBuf,
    /// The scene folder, with a scene.ron; overrides the scene of the graph file.
    #[arg(long, value_name = "DIR")]
    pub scene: Option<PathBuf>,
    /// Set one parameter of one node, as RON; may be given several times.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    pub set: Vec<String>,
    /// The folder for bench.json, bench.csv and the plots, created if missing.
    #[arg(long, value_name = "DIR", default_value = "out/bench")]
    pub out: PathBuf,
    #[command(flatten)]
    pub options: Options,
    /// Number of worker threads. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Print bench.json on standard output instead of the tables.
    #[arg(long)]
    pub json: bool,
}

#[derive(Args)]
pub struct Eval {
    /// The scene folder, with a scene.ron that names its `truth`.
    pub scene: PathBuf,
    /// The graph file, or the name of one that ships.
    #[arg(long, value_name = "GRAPH", default_value = "indoor", value_parser = graph_path)]
    pub graph: PathBuf,
    /// Set one parameter of one node, as RON; may be given several times.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    pub set: Vec<String>,
    /// Measure the graph as it is, without the ablation that replaces its parts by the truth.
    #[arg(long)]
    pub no_ablation: bool,
    /// The old name of `--no-ablation`, read with a warning for one version.
    #[arg(long, hide = true)]
    pub no_ladder: bool,
    /// The folder for eval.json, created if missing.
    #[arg(long, value_name = "DIR", default_value = "out/eval")]
    pub out: PathBuf,
    #[command(flatten)]
    pub networks: Networks,
    #[command(flatten)]
    pub cache: CacheUse,
    /// Number of worker threads. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Print eval.json on standard output instead of the tables.
    #[arg(long)]
    pub json: bool,
}
