//! Figures against ground truth: the tables of `relight eval`.

mod tables;

use serde::Serialize;

/// The parts of a graph that are replaced by the truth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Substitution {
    /// Whether the true depth replaces the estimate.
    pub depth: bool,
    /// Whether the true lights replace the estimates.
    pub lights: bool,
    /// Whether the true materials replace the estimates.
    pub materials: bool,
}

impl Substitution {
    /// All substitutions within `known`, the parts whose truth is known; the one without any first,
    /// the one of all parts last.
    pub fn all(known: Substitution) -> Vec<Substitution> {
        let one = |n: usize| Substitution {
            depth: n & 4 != 0,
            lights: n & 2 != 0,
            materials: n & 1 != 0,
        };
        let possible = |s: &Substitution| {
            (known.depth || !s.depth)
                && (known.lights || !s.lights)
                && (known.materials || !s.materials)
        };
        (0..8).map(one).filter(possible).collect()
    }

    /// A line that names the source of each part; without true depth (`has_depth`), the depth is
    /// given.
    pub fn title(self, has_depth: bool) -> String {
        let depth = if has_depth { name(self.depth) } else { "given" };
        format!("{depth} depth, {} lights, {} materials", name(self.lights), name(self.materials))
    }
}

fn name(substituted: bool) -> &'static str {
    if substituted { "true" } else { "estimated" }
}

/// A measured number, with the substitution under which it was measured.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// Parts of the graph that were replaced.
    #[serde(flatten)]
    pub substitution: Substitution,
    /// Light, edit, or group of either.
    pub subject: String,
    /// Name of the error measure.
    pub measure: String,
    /// Value, in the unit of the measure.
    pub value: f64,
}

/// The content of eval.json.
#[derive(Serialize)]
pub struct EvalReport {
    /// Version of the program.
    pub relight: &'static str,
    /// Path of the graph file.
    pub graph: String,
    /// Path of the scene.
    pub scene: String,
    /// Worker threads of the engine.
    pub threads: usize,
    /// Wall time of all runs.
    pub seconds: f64,
    /// All measured numbers.
    pub figures: Vec<Figure>,
    /// Measures that are missing, each with its reason.
    pub left_out: Vec<String>,
}

impl EvalReport {
    /// The tables in Markdown, each under a line that names it, and the measures that are missing.
    pub fn markdown(&self) -> String {
        let left_out: String =
            self.left_out.iter().map(|line| format!("left out: {line}\n")).collect();
        tables::markdown(&self.figures) + &left_out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn substitutions_go_from_none_to_all_that_is_known() {
        let known = Substitution { depth: false, lights: true, materials: true };
        let titles: Vec<String> =
            Substitution::all(known).into_iter().map(|s| s.title(false)).collect();
        let wanted = [
            "given depth, estimated lights, estimated materials",
            "given depth, estimated lights, true materials",
            "given depth, true lights, estimated materials",
            "given depth, true lights, true materials",
        ];
        assert_eq!(titles, wanted);
        assert_eq!(Substitution::all(Substitution { depth: true, ..known }).len(), 8);
    }
}
