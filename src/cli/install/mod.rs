//! `relight completions` and `relight man`: files for the shell and for `man`, made from the
//! arguments by clap's own crates.

use std::path::PathBuf;

use clap::{Args, Command};
use clap_complete::Shell;
use relight::graph::Diagnostic;

use super::exit::{CliError, Exit};
use super::write;

/// Arguments of `relight completions`.
#[derive(Args)]
pub struct Completions {
    /// The shell that reads the script.
    pub shell: Shell,
}

/// Arguments of `relight man`.
#[derive(Args)]
pub struct Man {
    /// Write a page for each command into this folder, created if missing, instead of the main
    /// page on standard output.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Prints the completion script of a shell.
///
/// # Errors
/// Standard output cannot be written.
pub fn completions(args: &Completions, command: Command) -> Result<Exit, CliError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut visible(command), "relight", &mut script);
    print(script)
}

/// Prints the main page, or writes all pages into a folder.
///
/// # Errors
/// Standard output or the folder cannot be written.
pub fn man(args: &Man, command: Command) -> Result<Exit, CliError> {
    let command = visible(command);
    let Some(folder) = &args.out else {
        let mut page = Vec::new();
        clap_mangen::Man::new(command).render(&mut page).expect("memory can be written");
        return print(page);
    };
    std::fs::create_dir_all(folder)
        .and_then(|()| clap_mangen::generate_to(command, folder))
        .map_err(|e| Diagnostic::file(folder, format!("the pages cannot be written: {e}")))?;
    write::print_paths(std::slice::from_ref(folder))?;
    Ok(Exit::Done)
}

/// The command without its hidden commands, which clap's generators would list.
fn visible(command: Command) -> Command {
    let hidden = |command: &&Command| !command.is_hide_set();
    let shown: Vec<Command> = command.get_subcommands().filter(hidden).cloned().collect();
    let mut bare = Command::new("relight").version(env!("CARGO_PKG_VERSION"));
    bare = bare.args(command.get_arguments().cloned()).subcommands(shown);
    if let Some(about) = command.get_about() {
        bare = bare.about(about.clone());
    }
    if let Some(about) = command.get_long_about() {
        bare = bare.long_about(about.clone());
    }
    if let Some(after) = command.get_after_help() {
        bare = bare.after_help(after.clone());
    }
    bare.subcommand_required(true)
}

fn print(text: Vec<u8>) -> Result<Exit, CliError> {
    write::print(&String::from_utf8(text).expect("clap writes text"))?;
    Ok(Exit::Done)
}
