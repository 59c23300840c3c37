//! The arguments of `relight serve`.

use std::path::PathBuf;

use crate::cli::args::{CacheUse, Confined, Networks, RunArgs, SceneFiles, whole};
use crate::cli::shipped::graph_path;

#[derive(clap::Args)]
pub struct ServeArgs {
    /// The scene folder, with a scene.ron.
    pub scene: PathBuf,
    /// The graph file, or the name of one that ships.
    #[arg(long, value_name = "GRAPH", default_value = "indoor", value_parser = graph_path)]
    pub graph: PathBuf,
    /// The edit file, which the page changes; created at the first change if missing. Default:
    /// edit.ron in the folder of --out.
    #[arg(long, value_name = "FILE")]
    pub edit: Option<PathBuf>,
    /// The port on 127.0.0.1. Default: a free one.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole::<u16>(0, 65535))]
    pub port: u16,
    /// The folder for the results, created if missing.
    #[arg(long, value_name = "DIR", default_value = "out")]
    pub out: PathBuf,
    /// Allow results to replace files that the run reads.
    #[arg(long)]
    pub force: bool,
    /// Set one parameter of one node, as RON; may be given several times, and overrides graph,
    /// scene and edit.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    pub set: Vec<String>,
    #[command(flatten)]
    pub confined: Confined,
    #[command(flatten)]
    pub networks: Networks,
    #[command(flatten)]
    pub cache: CacheUse,
    /// Number of worker threads; the result is the same for any number. Default: one per core.
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1, 1024))]
    pub threads: Option<u16>,
}

impl ServeArgs {
    /// The run that gives the same pictures.
    pub fn job(&self) -> RunArgs {
        RunArgs {
            graph: self.graph.clone(),
            edit: Some(self.edit.clone().unwrap_or_else(|| self.out.join("edit.ron"))),
            files: SceneFiles {
                scene: Some(self.scene.clone()),
                set: self.set.clone(),
                confined: self.confined,
                networks: self.networks.clone(),
                ..SceneFiles::default()
            },
            out: self.out.clone(),
            force: self.force,
            cache: self.cache.clone(),
            threads: self.threads,
            ..RunArgs::default()
        }
    }
}
