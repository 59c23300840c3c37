//! Figures of merit.

use serde::{Deserialize, Serialize};

/// One figure of how good something is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// A light, an edit, `all lights`, `materials`.
    pub subject: String,
    /// As the stage that measured calls it; docs/eval.md tells each.
    pub measure: String,
    pub value: f64,
}

/// Figures of how good something is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scores(pub Vec<Score>);
