//! Messages for the user at the terminal.
//!
//! Messages contain texts of files, file names and texts of networks, so each passes through
//! [`escape`]. A standard error that is full or closed loses the message and nothing else.

use std::fmt::Arguments;
use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};

use relight::graph::escape;

/// Writes a line to standard error, unless the program is quiet: `message!("{made} frames")`.
macro_rules! message {
    ($($arg:tt)*) => { $crate::cli::messages::line(format_args!($($arg)*)) };
}
pub(super) use message;

/// Writes a line to standard error after the word "error", also in a quiet program.
macro_rules! error {
    ($($arg:tt)*) => { $crate::cli::messages::error_line(format_args!($($arg)*)) };
}
pub(super) use error;

/// The program writes errors only.
static QUIET: AtomicBool = AtomicBool::new(false);

/// Writes a line to standard error, unless the program is quiet.
pub fn line(text: Arguments) {
    if !QUIET.load(Ordering::Relaxed) {
        write_line(text);
    }
}

/// Writes an error to standard error.
pub fn error_line(text: Arguments) {
    write_line(format_args!("error: {text}"));
}

fn write_line(text: Arguments) {
    let _ = Escaped.write_all(format!("{text}\n").as_bytes());
}

/// Writes a text to standard error that is escaped already and may contain our own escape
/// sequences, such as colors.
pub fn raw(text: &str) {
    let _ = io::stderr().lock().write_all(text.as_bytes());
}

/// Standard error for the log; each write is one whole event.
pub struct Escaped;

impl Write for Escaped {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        raw(&escape(&String::from_utf8_lossy(bytes)));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Whether standard error is a terminal that takes colors; the variable `NO_COLOR` turns them off.
pub fn terminal() -> bool {
    io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Whether standard error is a terminal that shows progress.
pub fn shows_progress() -> bool {
    terminal() && !QUIET.load(Ordering::Relaxed)
}

/// Sends the log to standard error. The level rises with `verbose`; the variable `RELIGHT_LOG` wins
/// over it. A quiet program writes errors only.
pub fn start(verbose: u8, quiet: bool) {
    QUIET.store(quiet, Ordering::Relaxed);
    use tracing_subscriber::{filter::Targets, fmt, prelude::*};
    // The report of a run contains the engine's warnings, and its command shows them.
    let level = match verbose {
        0 | 1 => "relight=error",
        2 => "relight=debug",
        _ => "relight=trace",
    };
    let given = std::env::var("RELIGHT_LOG").ok().and_then(|text| text.parse::<Targets>().ok());
    let filter = given.unwrap_or_else(|| level.parse().expect("our own filters are sound"));
    // Without colors, so that every escape sequence in the log is a foreign one.
    let log = fmt::layer().with_writer(|| Escaped).with_ansi(false).without_time();
    tracing_subscriber::registry().with(filter).with(log.log_internal_errors(false)).init();
}
