//! The command line: arguments, exit status, and all messages.

mod args;
mod batch;
mod cache;
mod check;
mod engine;
mod exit;
mod export;
mod frames;
mod inspect;
mod install;
#[cfg(feature = "lab")]
mod lab;
mod load;
mod memory;
mod messages;
mod mix;
mod networks;
mod new;
mod page;
mod picture;
mod progress;
mod provenance;
mod reference;
mod report;
mod results;
mod run;
#[cfg(feature = "serve")]
mod serve;
mod shipped;
mod store;
mod watch;
mod write;

use std::process::ExitCode;
use std::time::Instant;

use clap::{CommandFactory, Parser, Subcommand};

/// Edit the lighting of one indoor photograph: switch, dim, color, move and insert lights.
///
/// A graph file describes the pipeline, a scene folder contains the photograph with its depth and
/// masks, an edit file lists the changes. A cache keeps all results, so that a run computes only
/// the nodes that its edit affects.
#[derive(Parser)]
#[command(name = "relight", version, after_help = EXAMPLES, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Write more to standard error: a line and a row of measures per node (-v), steps of the
    /// engine (-vv), everything (-vvv).
    ///
    /// The environment variable RELIGHT_LOG takes tracing levels, such as `relight=debug`, and
    /// overrides this option.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Write errors only to standard error; report.json has the warnings.
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,
}

const EXAMPLES: &str = "\
Example: switch a lamp off in the scene that ships with relight
  relight check graphs/demo.ron edits/lamp_off.ron   # checks the files and pictures
  relight plan  graphs/demo.ron edits/lamp_off.ron   # lists the nodes that would run, and hits
  relight run   graphs/demo.ron edits/lamp_off.ron   # writes out/picture.png and more

A photograph of your own, with its depth (docs/new.md):
  relight new photo.jpg --depth depth.png --out my_room
  relight run graphs/indoor.ron my_room/edit.ron --scene my_room --out my_room/out

Exit status: 0 done, 1 a stage failed, 2 bad arguments or files, 130 interrupted.";

#[derive(Subcommand)]
enum Command {
    /// Make a scene folder from a photo: camera, depth, masks of lamps and windows, scene.ron.
    New(args::NewArgs),
    /// Relight the photo: compute the nodes that an edit affects and write the pictures.
    Run(args::RunArgs),
    /// Open a page in the browser that edits a scene and shows it at once.
    #[cfg(feature = "serve")]
    Serve(serve::ServeArgs),
    /// Relight many photos: photos x edits x frames of a list, here or as tasks on a cluster.
    Batch(batch::BatchArgs),
    /// Reweight the lights of a finished run in milliseconds: dim, brighten, tint.
    Mix(args::MixArgs),
    /// Write report.html of a finished run: before and after, a slider per light, the nodes that
    /// ran.
    Report(args::ReportArgs),
    /// Write the room as USD, for Blender and others: visible surface, albedo, camera, edited
    /// lights.
    Export(args::Export),
    /// Show the state of each node before a run: hit, run, or unknown until its inputs have run.
    Plan(args::Plan),
    /// Explain why a node would run again, by the first line of its key that differs; or how a
    /// picture was made.
    Explain(args::Explain),
    /// Check the files, photo, depth and masks too, and report every error; compute nothing else.
    Check(args::JobArgs),
    /// Print the graph with scene and edit applied, for a drawing program.
    Graph(args::Graph),
    /// Print the reference of all stages, or of one.
    Nodes(args::Nodes),
    /// Count, shrink, verify or empty the cache.
    Cache(args::Cache),
    /// Measure error against run time: sampling strategies, shadows, whole pictures.
    #[cfg(feature = "lab")]
    Bench(lab::Bench),
    /// Measure estimates and pictures against a scene's truth, with an ablation of the graph's
    /// parts.
    #[cfg(feature = "lab")]
    Eval(lab::Eval),
    /// Print the script with which a shell completes the arguments of this program.
    Completions(install::Completions),
    /// Print the manual page, or write those of all commands.
    Man(install::Man),
    /// Compute a third-party network for the run that starts this process.
    #[command(hide = true)]
    RunNetwork(args::RunNetwork),
}

/// Parses the arguments, runs the command and returns its exit status.
pub fn main() -> ExitCode {
    let began = Instant::now();
    memory::return_large_blocks();
    let Cli { command, verbose, quiet } = Cli::parse();
    messages::start(verbose, quiet);
    let outcome = match &command {
        Command::New(args) => new::new(args, verbose),
        Command::Run(args) => run::run(args, verbose, began),
        #[cfg(feature = "serve")]
        Command::Serve(args) => serve::serve(args),
        Command::Batch(args) => batch::batch(args, began),
        Command::Mix(args) => mix::mix(args, began),
        Command::Report(args) => page::report(args, began),
        Command::Export(args) => export::export(args, verbose),
        Command::Plan(args) => inspect::plan(args),
        Command::Explain(args) => inspect::explain(args),
        Command::Check(args) => check::check(args),
        Command::Graph(args) => inspect::graph(args),
        Command::Nodes(args) => inspect::nodes(args),
        Command::Cache(args) => cache::cache(args),
        #[cfg(feature = "lab")]
        Command::Bench(args) => lab::bench(args, began),
        #[cfg(feature = "lab")]
        Command::Eval(args) => lab::eval(args, began),
        Command::Completions(args) => install::completions(args, Cli::command()),
        Command::Man(args) => install::man(args, Cli::command()),
        Command::RunNetwork(limits) => networks::run_network(limits),
    };
    outcome.unwrap_or_else(|error| error.report()).into()
}
