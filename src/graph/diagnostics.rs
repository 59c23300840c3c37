//! The faults of one file: the first of them, and the number of the others.

use super::source::Diagnostic;

/// Messages per file: a file that is broken everywhere needs no more.
const MAX_FAULTS: usize = 50;

/// Diagnostics in the order in which they are found, each once. The first fifty are kept. The
/// others are counted and never made, so that a file with a million faults costs little more than
/// reading it.
#[derive(Clone)]
pub struct Diagnostics {
    kept: Vec<Diagnostic>,
    most: usize,
    found: usize,
    /// Diagnostics that found no room; one that is kept already may be among them.
    left_out: usize,
}

impl Default for Diagnostics {
    fn default() -> Diagnostics {
        Diagnostics { kept: Vec::new(), most: MAX_FAULTS, found: 0, left_out: 0 }
    }
}

impl Diagnostics {
    /// A list that keeps no fault, for a reader whose faults another one reports.
    pub fn ignored() -> Diagnostics {
        Diagnostics { most: 0, ..Diagnostics::default() }
    }

    /// Adds a fault, which is made only where there is room for it.
    pub fn push(&mut self, fault: impl FnOnce() -> Diagnostic) {
        self.found += 1;
        if self.kept.len() == self.most {
            self.left_out += 1;
            return;
        }
        let fault = fault();
        if !self.kept.contains(&fault) {
            self.kept.push(fault);
        }
    }

    /// The number of faults that were pushed; it grows with each.
    pub fn found(&self) -> usize {
        self.found
    }

    /// Whether no fault was found.
    pub fn is_empty(&self) -> bool {
        self.found == 0
    }

    /// The faults that are kept.
    pub(super) fn kept(&self) -> &[Diagnostic] {
        &self.kept
    }

    /// The faults to show; the last one gives the number of those that are left out.
    pub fn into_vec(mut self) -> Vec<Diagnostic> {
        if let Some(last) = self.kept.last().filter(|_| self.left_out > 0) {
            let path = last.path.clone();
            self.kept
                .push(Diagnostic::file(&path, format!("and up to {} more errors", self.left_out)));
        }
        self.kept
    }
}
