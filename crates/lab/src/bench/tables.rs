//! The results as CSV, and as the Markdown tables of docs/accuracy.md, each under a line that names
//! it.

use super::error::{EXACT, Point, slope};
use super::lights::ADAPTIVE;
use crate::table::{distinct, table};

/// Formats one line per mark, under a head.
pub(super) fn csv(points: &[Point]) -> String {
    let mut text =
        String::from("plot,subject,series,samples,target,bandwidth,seconds,rays,error,claimed\n");
    for p in points {
        let some = |x: Option<f64>| x.map_or(String::new(), |x| x.to_string());
        let samples = p.samples.map_or(String::new(), |n| n.to_string());
        text.push_str(&format!(
            "{},\"{}\",\"{}\",{samples},{},{},{:.6},{},{:.4e},{}\n",
            p.plot,
            p.subject,
            p.series,
            some(p.target),
            some(p.bandwidth),
            p.seconds,
            p.rays,
            p.error,
            p.claimed.map_or(String::new(), |x| format!("{x:.4e}")),
        ));
    }
    text
}

/// Formats all tables that have a row.
pub(super) fn markdown(points: &[Point]) -> String {
    let of = |plot: &str| -> Vec<&Point> { points.iter().filter(|p| p.plot == plot).collect() };
    let tables = [
        ("slopes", slopes(&of("strategies"))),
        ("bandwidths", bandwidths(&of("bandwidths"))),
        ("equal samples", ratios(&of("bandwidths"), |p| p.error.powi(2))),
        ("equal time", ratios(&of("bandwidths"), |p| p.error.powi(2) * p.seconds)),
        ("calibration", calibration(points)),
        ("shadows", slopes(&of("shadows"))),
        ("adaptive", adaptive(&of("shadows"))),
        ("pipeline", pictures(&of("pipeline"))),
        ("noise", pictures(&of("noise"))),
    ];
    let shown = tables.into_iter().filter(|(_, text)| !text.is_empty());
    shown.map(|(name, text)| format!("<!-- table: {name} -->\n{text}\n")).collect()
}

/// A table with a cell per subject and series.
fn by_subject(points: &[&Point], series: &[String], cell: impl Fn(&[&Point]) -> String) -> String {
    let head: Vec<String> = [String::new()].into_iter().chain(series.iter().cloned()).collect();
    let rows = distinct(points.iter().map(|p| p.subject.clone())).into_iter().map(|subject| {
        let cells = series.iter().map(|series| {
            let marks: Vec<&Point> = points
                .iter()
                .copied()
                .filter(|p| p.subject == subject && p.series == *series)
                .collect();
            cell(&marks)
        });
        [subject.clone()].into_iter().chain(cells).collect()
    });
    table(&head, rows.collect())
}

/// Exponent of the error as a power of the number of samples.
fn slopes(points: &[&Point]) -> String {
    let sampled: Vec<&Point> = points.iter().copied().filter(|p| p.samples.is_some()).collect();
    let series = distinct(sampled.iter().map(|p| p.series.clone()));
    by_subject(&sampled, &series, |marks| {
        if marks.iter().all(|p| p.error < EXACT) {
            return if marks.is_empty() { "-".to_owned() } else { "exact".to_owned() };
        }
        let marks: Vec<(f64, f64)> =
            marks.iter().map(|p| (f64::from(p.samples.unwrap_or(1)), p.error)).collect();
        slope(&marks).map_or("-".into(), |slope| format!("{slope:.2}"))
    })
}

fn power(x: f64) -> String {
    if x < 1000.0 { format!("{x}") } else { format!("{x:e}") }
}

/// A table with a cell per bandwidth and series.
fn by_bandwidth(
    points: &[&Point],
    series: &[String],
    cell: impl Fn(&Point, &[&Point]) -> String,
) -> String {
    let head: Vec<String> =
        ["", "bandwidth"].map(str::to_owned).into_iter().chain(series.iter().cloned()).collect();
    let lines = distinct(points.iter().filter_map(|p| Some((p.subject.clone(), p.bandwidth?))));
    let rows = lines.into_iter().map(|(subject, bandwidth)| {
        let of_row = points
            .iter()
            .copied()
            .filter(|p| p.subject == subject && p.bandwidth == Some(bandwidth));
        let here: Vec<&Point> = of_row.collect();
        let cells = series.iter().map(|series| {
            here.iter().find(|p| p.series == *series).map_or("-".into(), |point| cell(point, &here))
        });
        [subject, power(bandwidth)].into_iter().chain(cells).collect()
    });
    table(&head, rows.collect())
}

fn bandwidths(points: &[&Point]) -> String {
    by_bandwidth(points, &distinct(points.iter().map(|p| p.series.clone())), |point, _| {
        percent(point.error)
    })
}

/// Cost of each strategy over the smaller cost of area and lobe alone.
fn ratios(points: &[&Point], cost: fn(&Point) -> f64) -> String {
    let single = ["area only", "lobe only"];
    let series = distinct(points.iter().map(|p| p.series.clone()));
    by_bandwidth(points, &series, |point, here| {
        let singles = here.iter().filter(|p| single.contains(&p.series.as_str())).map(|p| cost(p));
        if point.error < EXACT {
            return "exact".to_owned();
        }
        let ratio = cost(point) / singles.fold(f64::INFINITY, f64::min);
        if ratio < 100.0 { format!("{ratio:.2}") } else { format!("{ratio:.0}") }
    })
}

/// Claimed over measured error of the default strategy.
fn calibration(points: &[Point]) -> String {
    let own = |p: &&Point| ["ours", ADAPTIVE].contains(&p.series.as_str());
    let points: Vec<&Point> =
        points.iter().filter(own).filter(|p| p.plot != "bandwidths" && p.error > EXACT).collect();
    let head: Vec<String> = ["", "series", "least", "median", "most"].map(str::to_owned).to_vec();
    let lines = distinct(points.iter().map(|p| (p.subject.clone(), p.series.clone())));
    let rows = lines.into_iter().filter_map(|(subject, series)| {
        let of_line = points.iter().filter(|p| p.subject == subject && p.series == series);
        let mut ratios: Vec<f64> = of_line.filter_map(|p| Some(p.claimed? / p.error)).collect();
        ratios.sort_by(f64::total_cmp);
        let (least, most) = (*ratios.first()?, *ratios.last()?);
        let numbers = [least, ratios[ratios.len() / 2], most].map(|ratio| format!("{ratio:.2}"));
        Some([subject, series].into_iter().chain(numbers).collect())
    });
    table(&head, rows.collect())
}

/// Error and time of adaptive sampling, and the time of a fixed number of samples at the same
/// error.
fn adaptive(points: &[&Point]) -> String {
    let head = [
        "",
        "asked for",
        "error",
        "claimed",
        "seconds",
        "seconds of a fixed number for this error",
        "gain",
    ];
    let rows = points.iter().filter(|p| p.series == ADAPTIVE).map(|p| {
        let fixed = points.iter().filter(|f| f.series == "ours" && f.subject == p.subject);
        let fixed = seconds_for(p.error, &fixed.map(|f| (f.error, f.seconds)).collect::<Vec<_>>());
        vec![
            p.subject.clone(),
            percent(p.target.unwrap_or(0.0)),
            percent(p.error),
            p.claimed.map_or("-".into(), percent),
            format!("{:.3}", p.seconds),
            fixed.map_or("-".into(), |s| format!("{s:.3}")),
            fixed.map_or("-".into(), |s| format!("{:.2}", s / p.seconds)),
        ]
    });
    table(&head.map(str::to_owned), rows.collect())
}

/// Time for an error between two marks (error, seconds), by linear interpolation of the logarithms;
/// `None` outside all marks.
fn seconds_for(error: f64, marks: &[(f64, f64)]) -> Option<f64> {
    marks.windows(2).find_map(|pair| {
        let [(e0, s0), (e1, s1)] = [pair[0], pair[1]];
        let share = (e0.ln() - error.ln()) / (e0.ln() - e1.ln());
        (0.0..=1.0).contains(&share).then(|| (s0.ln() + share * (s1.ln() - s0.ln())).exp())
    })
}

/// A row per pipeline and size, a column per edit.
fn pictures(points: &[&Point]) -> String {
    let subjects = distinct(points.iter().map(|p| p.subject.clone()));
    let fixed = ["", "samples or target", "seconds"].map(str::to_owned);
    let head: Vec<String> = fixed.into_iter().chain(subjects.iter().cloned()).collect();
    let ways = distinct(points.iter().map(|p| (p.series.clone(), p.samples, p.target)));
    let rows = ways.into_iter().map(|(series, samples, target)| {
        let of_way: Vec<&&Point> = points
            .iter()
            .filter(|p| p.series == series && p.samples == samples && p.target == target)
            .collect();
        let asked = match (samples, target) {
            (Some(n), _) => n.to_string(),
            (None, Some(target)) => percent(target),
            (None, None) => String::new(),
        };
        let seconds = of_way.first().map_or(0.0, |p| p.seconds);
        let cells = subjects.iter().map(|subject| {
            of_way.iter().find(|p| p.subject == *subject).map_or("-".into(), |p| percent(p.error))
        });
        [series, asked, format!("{seconds:.2}")].into_iter().chain(cells).collect()
    });
    table(&head, rows.collect())
}

/// A share in percent with three significant digits.
fn percent(x: f64) -> String {
    if x < EXACT {
        return "exact".to_owned();
    }
    let x = 100.0 * x;
    let digits = (2.0 - x.abs().max(1e-6).log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{x:.digits$} %")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_for_an_error_lies_on_the_line_between_two_marks() {
        let marks = [(0.4, 1.0), (0.1, 4.0), (0.02, 40.0)];
        assert!((seconds_for(0.2, &marks).expect("it is between") - 2.0).abs() < 1e-9);
        assert_eq!(seconds_for(0.5, &marks), None);
        assert_eq!(seconds_for(0.01, &marks), None);
    }

    #[test]
    fn numbers_have_three_digits() {
        for (x, wanted) in [
            (0.5, "50.0 %"),
            (0.01234, "1.23 %"),
            (0.000_012_34, "0.00123 %"),
            (12.0, "1200 %"),
            (1e-7, "exact"),
        ] {
            assert_eq!(percent(x), wanted);
        }
    }
}
