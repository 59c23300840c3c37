//! Requests and bytes of a store.

use serde::{Deserialize, Serialize};

/// Requests and bytes between a command and its store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Traffic {
    /// Blobs that were requested.
    pub gets: u64,
    /// Blobs that were returned.
    pub found: u64,
    pub bytes_in: u64,
    /// Blobs that were sent.
    pub puts: u64,
    pub bytes_out: u64,
    /// Requests without an answer, or with an error.
    pub failed: u64,
    /// Results that were not uploaded.
    pub left_out: u64,
}

impl std::fmt::Display for Traffic {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Traffic { gets, found, bytes_in, puts, bytes_out, failed, left_out } = self;
        let [bytes_in, bytes_out] = [bytes_in, bytes_out].map(|bytes| *bytes as f64 * 1e-6);
        write!(
            f,
            "{found} of {gets} blobs found ({bytes_in:.1} MB), {puts} sent ({bytes_out:.1} MB)"
        )?;
        if *failed + *left_out > 0 {
            write!(f, ", {failed} requests failed, {left_out} results not uploaded")?;
        }
        Ok(())
    }
}

impl std::ops::Add for Traffic {
    type Output = Traffic;

    fn add(self, other: Traffic) -> Traffic {
        Traffic {
            gets: self.gets + other.gets,
            found: self.found + other.found,
            bytes_in: self.bytes_in + other.bytes_in,
            puts: self.puts + other.puts,
            bytes_out: self.bytes_out + other.bytes_out,
            failed: self.failed + other.failed,
            left_out: self.left_out + other.left_out,
        }
    }
}
