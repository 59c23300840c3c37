//! Messages for the user at the terminal.
//!
//! Messages contain texts of files, file names and texts of networks, so each passes through
//! [`escape`]. A standard error that is full or closed loses the message and nothing else.

use std::fmt::Arguments;
use std::io::{self, IsTerminal, Write};

use relight::graph::escape;

/// Writes a line to standard error: `message!("{made} frames")`.
macro_rules! message {
    ($($arg:tt)*) => { $crate::cli::messages::line(format_args!($($arg)*)) };
}
pub(super) use message;

/// Writes a line to standard error.
pub fn line(text: Arguments) {
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

/// Sends the log to standard error. The level rises with `verbose`; the variable `RELIGHT_LOG` wins
/// over it.
pub fn log(verbose: u8) {
    use tracing_subscriber::{EnvFilter, fmt};
    // The report of a run contains the engine's warnings, and its command shows them.
    let level = match verbose {
        0 | 1 => "relight=error",
        2 => "relight=debug",
        _ => "relight=trace",
    };
    let filter = EnvFilter::try_from_env("RELIGHT_LOG").unwrap_or_else(|_| EnvFilter::new(level));
    // Without colors, so that every escape sequence in the log is a foreign one.
    let log = fmt().with_env_filter(filter).with_writer(|| Escaped).with_ansi(false).without_time();
    log.log_internal_errors(false).init();
}
