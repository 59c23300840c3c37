//! The plots: SVG, both axes logarithmic, one panel per subject, one line per series.

use plotters::coord::Shift;
use plotters::coord::combinators::{BindKeyPoints, IntoLogRange};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::error::{EXACT, Point};
use super::lights::{ADAPTIVE, STRATEGIES};
use crate::table::distinct;

/// A plot: its file without the ending, its title and its axes.
struct Plot {
    name: &'static str,
    title: &'static str,
    x: Axis,
    y: &'static str,
}

/// A quantity along x.
enum Axis {
    /// Wall time of the named work.
    Seconds(&'static str),
    Bandwidth,
}

const PLOTS: [Plot; 5] = [
    Plot {
        name: "strategies",
        title: "Direct light of a window, unshadowed: error against time",
        x: Axis::Seconds("time of Direct"),
        y: "relative error",
    },
    Plot {
        name: "bandwidths",
        title: "Direct light of a window: error against bandwidth at equal samples",
        x: Axis::Bandwidth,
        y: "relative error",
    },
    Plot {
        name: "shadows",
        title: "Direct light with its shadow: error against time",
        x: Axis::Seconds("time of Direct and Shadow"),
        y: "relative error",
    },
    Plot {
        name: "pipeline",
        title: "Whole pictures against truth: error of the change against time",
        x: Axis::Seconds("time of a run from nothing"),
        y: "error of the change",
    },
    Plot {
        name: "noise",
        title: "Whole pictures against their own limit: difference against time",
        x: Axis::Seconds("time of a run from nothing"),
        y: "mean difference",
    },
];

/// Draws every plot that has a mark: names and SVG texts of the files.
pub(super) fn draw_all(points: &[Point]) -> Vec<(String, String)> {
    let file = |plot: &Plot| Some((format!("{}.svg", plot.name), plot.draw(points)?));
    PLOTS.iter().filter_map(file).collect()
}

const PANEL: (i32, i32) = (430, 330);
const COLUMNS: i32 = 2;
const HEAD: i32 = 40;
const LEGEND_ROW: i32 = 24;
/// Invariant of every drawing call: writing to a string does not fail.
const SOUND: &str = "an SVG in memory can be written";

/// A palette for color-blind readers (Okabe and Ito 2008); the markers differ too.
const COLORS: [RGBColor; 8] = [
    RGBColor(213, 94, 0),
    RGBColor(0, 114, 178),
    RGBColor(0, 158, 115),
    RGBColor(86, 180, 233),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(0, 0, 0),
    RGBColor(120, 120, 120),
];

impl Plot {
    fn x(&self, point: &Point) -> Option<f64> {
        match self.x {
            Axis::Seconds(_) => Some(point.seconds),
            Axis::Bandwidth => point.bandwidth,
        }
    }

    /// The plot as SVG; `None` when no mark belongs to it.
    fn draw(&self, points: &[Point]) -> Option<String> {
        let of_plot = points.iter().filter(|point| point.plot == self.name && point.error > EXACT);
        let marks: Vec<(&Point, f64)> =
            of_plot.filter_map(|point| Some((point, self.x(point)?))).collect();
        if marks.is_empty() {
            return None;
        }
        let subjects = distinct(marks.iter().map(|(point, _)| point.subject.as_str()));
        let series = styled(distinct(marks.iter().map(|(point, _)| point.series.as_str())));
        let columns = COLUMNS.min(subjects.len() as i32);
        let rows = (subjects.len() as i32 + columns - 1) / columns;
        let legend_columns = 3.min(series.len() as i32).max(1);
        let legend_rows = (series.len() as i32 + legend_columns - 1) / legend_columns;
        let width = (columns * PANEL.0).max(640);
        let size = (width as u32, (HEAD + rows * PANEL.1 + legend_rows * LEGEND_ROW + 12) as u32);
        let mut svg = String::new();
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE).expect(SOUND);
        let title = text(17).pos(Pos::new(HPos::Center, VPos::Center));
        root.draw(&Text::new(self.title, (width / 2, HEAD / 2), title)).expect(SOUND);
        let (_, below) = root.split_vertically(HEAD);
        let (panels, legend) = below.split_vertically(rows * PANEL.1);
        // All panels share their ranges, so that they can be compared.
        let x = labels(marks.iter().map(|(_, x)| *x));
        let y = labels(marks.iter().map(|(point, _)| point.error));
        for (area, subject) in
            panels.split_evenly((rows as usize, columns as usize)).iter().zip(&subjects)
        {
            let of_panel: Vec<_> =
                marks.iter().filter(|(point, _)| point.subject == *subject).collect();
            let lines = series.iter().map(|&(style, name)| {
                let of_line = of_panel.iter().filter(|(point, _)| point.series == name);
                (style, of_line.map(|(point, x)| (*x, point.error)).collect())
            });
            self.panel(area, subject, (&x, &y), lines.collect());
        }
        draw_legend(&legend, &series, (legend_columns, width / legend_columns));
        drop((root, below, panels, legend));
        Some(svg)
    }

    fn panel(
        &self,
        area: &DrawingArea<SVGBackend, Shift>,
        subject: &str,
        (x, y): (&[f64], &[f64]),
        lines: Vec<(usize, Vec<(f64, f64)>)>,
    ) {
        let mut chart = ChartBuilder::on(area)
            .caption(subject, text(15))
            .margin_right(22)
            .margin_left(6)
            .margin_bottom(12)
            .x_label_area_size(46)
            .y_label_area_size(64)
            .build_cartesian_2d(
                (x[0]..x[x.len() - 1]).log_scale().with_key_points(x.to_vec()),
                (y[0]..y[y.len() - 1]).log_scale().with_key_points(y.to_vec()),
            )
            .expect(SOUND);
        let name = match self.x {
            Axis::Seconds(name) => name,
            Axis::Bandwidth => "bandwidth of the lobe",
        };
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(RGBColor(215, 215, 215))
            .axis_style(RGBColor(90, 90, 90))
            .label_style(text(12))
            .axis_desc_style(text(13))
            .x_desc(name)
            .y_desc(self.y)
            .x_label_formatter(&|x| match self.x {
                Axis::Seconds(_) => seconds(*x),
                Axis::Bandwidth => power(*x),
            })
            .y_label_formatter(&|y| percent(*y))
            .draw()
            .expect(SOUND);
        for (k, marks) in lines {
            chart.draw_series([PathElement::new(marks.clone(), stroke(k))]).expect(SOUND);
            chart.draw_series(marks.into_iter().map(|at| marker(k, at))).expect(SOUND);
        }
    }
}

/// Series with their style numbers, in drawing order. A strategy has the same color in every plot,
/// and the default one is drawn last.
fn styled(mut series: Vec<&str>) -> Vec<(usize, &str)> {
    let strategies: Vec<&str> =
        STRATEGIES.iter().map(|(_, name, _)| *name).chain([ADAPTIVE]).collect();
    let place = |name: &str| strategies.iter().position(|s| *s == name);
    series.sort_by_key(|name| place(name));
    series.into_iter().enumerate().map(|(k, name)| (place(name).unwrap_or(k), name)).collect()
}

/// Draws the legend in rows of `columns`, each `across` pixels wide.
fn draw_legend(
    area: &DrawingArea<SVGBackend, Shift>,
    series: &[(usize, &str)],
    (columns, across): (i32, i32),
) {
    for (k, &(style, name)) in series.iter().enumerate() {
        let at =
            (k as i32 % columns * across + 40, k as i32 / columns * LEGEND_ROW + LEGEND_ROW / 2);
        let line = PathElement::new(vec![(at.0, at.1), (at.0 + 34, at.1)], stroke(style));
        area.draw(&line).expect(SOUND);
        area.draw(&marker(style, (at.0 + 17, at.1))).expect(SOUND);
        let style = text(14).pos(Pos::new(HPos::Left, VPos::Center));
        area.draw(&Text::new(name.to_string(), (at.0 + 42, at.1), style)).expect(SOUND);
    }
}

fn text(size: i32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&RGBColor(30, 30, 30))
}

fn stroke(k: usize) -> ShapeStyle {
    COLORS[k % COLORS.len()].stroke_width(2)
}

/// The marker of a series; forms repeat with another period than colors.
fn marker<'svg, C>(k: usize, at: C) -> DynElement<'static, SVGBackend<'svg>, C>
where
    C: Clone + 'static,
{
    let color = COLORS[k % COLORS.len()];
    match k % 4 {
        0 => Circle::new(at, 4, color.filled()).into_dyn(),
        1 => TriangleMarker::new(at, 5, color.filled()).into_dyn(),
        2 => Cross::new(at, 4, color.stroke_width(2)).into_dyn(),
        _ => Circle::new(at, 4, color.stroke_width(2)).into_dyn(),
    }
}

/// Labels of an axis that contains all values: powers of ten, on a short axis with their multiples
/// by 2 and 5. The first and the last are the ends of the axis.
fn labels(values: impl Iterator<Item = f64> + Clone) -> Vec<f64> {
    let (low, high) = (values.clone().fold(f64::INFINITY, f64::min), values.fold(0.0, f64::max));
    let steps: &[f64] = if high / low > 100.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    let exponents = low.log10().floor() as i32 - 1..=high.log10().ceil() as i32 + 1;
    let all: Vec<f64> =
        exponents.flat_map(|e| steps.iter().map(move |step| step * 10f64.powi(e))).collect();
    let first = all.iter().rposition(|x| *x <= low * 1.0001).unwrap_or(0);
    let last = all.iter().position(|x| *x >= high * 0.9999).unwrap_or(all.len() - 1);
    all[first..=last.max(first + 1)].to_vec()
}

fn seconds(x: f64) -> String {
    match x {
        x if x < 0.99e-3 => format!("{} µs", short(x * 1e6)),
        x if x < 0.99 => format!("{} ms", short(x * 1e3)),
        x => format!("{} s", short(x)),
    }
}

fn percent(x: f64) -> String {
    format!("{} %", short(100.0 * x))
}

fn power(x: f64) -> String {
    match x.log10().round() as i32 {
        0 => "1".to_owned(),
        1 => "10".to_owned(),
        2 => "100".to_owned(),
        exponent => format!("1e{exponent}"),
    }
}

/// A number with one significant digit.
fn short(x: f64) -> String {
    let digits = (-(x.log10() + 1e-9).floor()).max(0.0) as usize;
    format!("{x:.digits$}")
}
