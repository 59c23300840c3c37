//! The figures as tables in Markdown, each under a line that names it.

use super::{Figure, name};
use crate::table::{distinct, table};

/// Formats all tables that have a row.
pub(super) fn markdown(figures: &[Figure]) -> String {
    let of = |measures: &[&str]| -> Vec<&Figure> {
        figures
            .iter()
            .filter(|f| {
                !f.substitution.lights
                    && !f.substitution.materials
                    && measures.contains(&f.measure.as_str())
            })
            .collect()
    };
    let tables = [
        ("lights", pivot(&of(&["Chamfer", "E_j", "shadow"]))),
        ("shading", pivot(&of(&["E_d", "E", "lighting"]))),
        ("materials", pivot(&of(&["albedo", "albedo before the fit", "normal", "roughness"]))),
        ("edits", pivot(&of(&["PSNR", "unchanged", "change error"]))),
        ("saturation", pivot(&of(&["saturated", "band", "elsewhere", "step"]))),
        ("ablation", ablation(figures)),
    ];
    let shown = tables.into_iter().filter(|(_, text)| !text.is_empty());
    shown.map(|(name, text)| format!("<!-- table: {name} -->\n{text}\n")).collect()
}

/// A row per subject and a column per measure, those with true depth beside the others; a row of
/// means where there are several rows.
fn pivot(figures: &[&Figure]) -> String {
    let columns = distinct(figures.iter().map(|f| (f.measure.clone(), f.substitution.depth)));
    let subjects = distinct(figures.iter().map(|f| f.subject.clone()));
    let head = columns.iter().map(|(measure, depth)| match depth {
        true => format!("{measure}, true depth"),
        false => measure.clone(),
    });
    let head: Vec<String> = [String::new()].into_iter().chain(head).collect();
    let values = |subject: Option<&String>, (measure, depth): &(String, bool)| -> Vec<f64> {
        let here = |f: &&&Figure| {
            f.measure == *measure
                && f.substitution.depth == *depth
                && subject.is_none_or(|s| f.subject == *s)
        };
        figures.iter().filter(here).map(|f| f.value).collect()
    };
    let row = |name: &str, subject: Option<&String>| -> Vec<String> {
        let cells = columns.iter().map(|column| cell(mean(&values(subject, column))));
        [name.to_owned()].into_iter().chain(cells).collect()
    };
    let mut rows: Vec<Vec<String>> =
        subjects.iter().map(|subject| row(subject, Some(subject))).collect();
    if rows.len() > 1 {
        rows.push(row("mean", None));
    }
    table(&head, rows)
}

/// A row per substitution: shading errors, and the change error of each edit.
fn ablation(figures: &[Figure]) -> String {
    let substitutions = distinct(figures.iter().map(|f| f.substitution));
    if substitutions.len() < 2 {
        return String::new();
    }
    let has_depth = substitutions.iter().any(|substitution| substitution.depth);
    let columns = distinct(
        figures
            .iter()
            .filter(|f| ["E_d", "E", "change error"].contains(&f.measure.as_str()))
            .map(|f| (f.measure.clone(), f.subject.clone())),
    );
    let shading = |measure: &str| measure != "change error";
    let edits = columns.iter().filter(|(measure, _)| !shading(measure)).count();
    let fixed = ["depth", "lights", "materials"].map(str::to_owned);
    let named = columns
        .iter()
        .map(|(measure, subject)| if shading(measure) { measure.clone() } else { subject.clone() });
    let mean_of = (edits > 1).then(|| "mean of edits".to_owned());
    let head: Vec<String> = fixed.into_iter().chain(named).chain(mean_of.clone()).collect();
    let rows = substitutions.into_iter().map(|substitution| {
        let here = |measure: &str, subject: &str| -> Vec<f64> {
            let here = |f: &&Figure| {
                f.substitution == substitution && f.measure == measure && f.subject == subject
            };
            figures.iter().filter(here).map(|f| f.value).collect()
        };
        let values: Vec<Option<f64>> =
            columns.iter().map(|(measure, subject)| mean(&here(measure, subject))).collect();
        let changes = columns.iter().zip(&values).filter(|((measure, _), _)| !shading(measure));
        let changes: Vec<f64> = changes.filter_map(|(_, value)| *value).collect();
        let depth = if has_depth { name(substitution.depth) } else { "given" };
        let last = mean_of.as_ref().map(|_| cell(mean(&changes)));
        [depth, name(substitution.lights), name(substitution.materials)]
            .into_iter()
            .map(str::to_owned)
            .chain(values.into_iter().map(cell))
            .chain(last)
            .collect()
    });
    table(&head, rows.collect())
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// A number with three significant digits, at most five decimals.
fn cell(value: Option<f64>) -> String {
    let Some(value) = value else { return "-".to_owned() };
    let digits = (2.0 - value.abs().max(1e-4).log10().floor()).clamp(0.0, 5.0) as usize;
    format!("{value:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eval::Substitution;

    #[test]
    fn numbers_have_three_digits() {
        for (value, wanted) in
            [(0.5, "0.500"), (0.01234, "0.0123"), (31.416, "31.4"), (0.000_012, "0.00001")]
        {
            assert_eq!(cell(Some(value)), wanted);
        }
        assert_eq!(cell(None), "-");
    }

    #[test]
    fn true_depth_stands_beside_estimated() {
        let figure = |depth: bool, subject: &str, value: f64| Figure {
            substitution: Substitution { depth, ..Substitution::default() },
            subject: subject.to_owned(),
            measure: "E_j".to_owned(),
            value,
        };
        let figures = [figure(false, "a", 1.0), figure(false, "b", 3.0), figure(true, "a", 0.5)];
        let wanted = "|  | E_j | E_j, true depth |\n| --- | --- | --- |\n| a | 1.00 | 0.500 |\n| b | 3.00 | - |\n\
                      | mean | 2.00 | 0.500 |\n";
        assert_eq!(pivot(&figures.iter().collect::<Vec<_>>()), wanted);
    }
}
