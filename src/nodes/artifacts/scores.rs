//! Figures of merit.

use serde::{Deserialize, Serialize};

/// One score of an estimate or a picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// The thing measured: a light, an edit, `all lights`, `materials`.
    pub subject: String,
    /// Name of the measure; docs/eval.md defines each.
    pub measure: String,
    /// The figure, in the unit of its measure.
    pub value: f64,
}

/// Scores of estimates and pictures.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scores(pub Vec<Score>);
