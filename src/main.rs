//! `relight`: parse, load, run, report.

#![warn(clippy::print_stderr, clippy::print_stdout)]

mod cli;

use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;
use cli::{Cli, Command};

fn main() -> ExitCode {
    let began = Instant::now();
    let Cli { command, verbose } = Cli::parse();
    cli::log(verbose);
    let done = match &command {
        Command::Run(args) => cli::run(args, verbose, began),
        Command::Mix(args) => cli::mix(args, began),
        Command::Report(args) => cli::report(args, began),
        Command::Export(args) => cli::export(args, verbose),
        Command::Plan(args) => cli::plan(args),
        Command::Explain(args) => cli::explain(args),
        Command::Check(args) => cli::check(args),
        Command::Graph(args) => cli::graph(args),
        Command::Nodes(args) => cli::nodes(args),
        Command::Cache(args) => cli::cache(args),
        Command::Bench(args) => cli::bench(args, began),
        Command::Eval(args) => cli::eval(args, began),
        Command::RunNetwork(limits) => cli::run_network(limits),
    };
    done.unwrap_or_else(|trouble| trouble.tell()).into()
}
