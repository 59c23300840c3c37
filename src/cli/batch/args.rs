//! The arguments of `relight batch`.

use std::path::PathBuf;

use crate::cli::args::{CacheUse, Confined, Networks, whole};

#[derive(clap::Args, Clone, Default)]
pub struct BatchArgs {
    /// The list of photos, edits and frames (docs/farm.md).
    #[arg(value_name = "JOBS.ron")]
    pub jobs: PathBuf,
    /// The folder for the results, created if missing. Default: that of the list, or `out` beside
    /// it.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write the scripts that run this list on a cluster into DIR, and run nothing: `slurm` writes
    /// a job array, `openjd` a template of Open Job Description.
    #[arg(long, num_args = 2, value_names = ["slurm|openjd", "DIR"], conflicts_with_all = ["task", "finish"])]
    pub plan: Option<Vec<String>>,
    /// Most jobs in one task of a plan.
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = whole::<u32>(1, 100_000), requires = "plan")]
    pub jobs_per_task: u32,
    /// Run the jobs of one task of a plan: the rows of the table with this number in the column
    /// `task`.
    #[arg(long, value_name = "K", value_parser = whole::<u32>(0, 999_999))]
    pub task: Option<u32>,
    /// Run nothing; make films, index.html and results.csv of the jobs that have run so far.
    #[arg(long, conflicts_with = "task")]
    pub finish: bool,
    /// Number of worker threads for all photos together. Default: one per core.
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1, 1024))]
    pub threads: Option<u16>,
    /// Most photos at a time. Default: as many as there are threads, and as memory allows.
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1, 1024))]
    pub photos: Option<u16>,
    /// Most memory in GiB, which limits the photos at a time. Default: two thirds of the memory
    /// that is free at the start.
    #[arg(long, value_name = "GIB", value_parser = whole::<u32>(1, 65_536))]
    pub memory: Option<u32>,
    /// Run every job again, also those that are done.
    #[arg(long)]
    pub again: bool,
    #[command(flatten)]
    pub confined: Confined,
    #[command(flatten)]
    pub networks: Networks,
    #[command(flatten)]
    pub cache: CacheUse,
}
