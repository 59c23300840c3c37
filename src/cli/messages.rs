//! Messages for the person at the terminal.
//!
//! Texts of files, file names and texts of networks stand in messages, so each passes through [`escape`]. A standard error that
//! is full or closed loses the message and nothing else.

use std::fmt::Arguments;
use std::io::{self, Write};

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

/// Writes a text to standard error that holds escape sequences of our own, such as colors, and is escaped already.
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
