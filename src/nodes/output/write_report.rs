//! WriteReport: a finished run as one page for a browser, with its lights on sliders.
//!
//! The page sums the light layers as `MixLayers` does, linear, and encodes the sum as the photo is
//! encoded. Nothing in it comes from elsewhere.

use std::sync::Arc;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::Vec3;
use rayon::prelude::*;
use serde::Deserialize;
use serde_json::{Value, json};

use super::read_run;
use crate::graph::svg::{self, Drawn};
use crate::graph::{Context, File, Node, NodeError, Status, escape_markup};
use crate::image::{
    ExrFile, Layer, Picture, Plane, Transfer, fit, luminance, pack, resize, write_png,
};
use crate::nodes::artifacts::Files;
use crate::{params, ports};

params! {
    /// Writes `report.html` of a finished run: before and after, a slider and a color for each
    /// light, shadows and errors, the nodes that ran and the reasons. `relight report` runs it.
    pub struct WriteReport {
        /// The `picture.exr` of a run.
        layers: File = File::default(),
        /// The `report.json` of the same run.
        report: File = File::default(),
        /// Longest side of the pictures in the page, in pixels, 1..=4096; a larger picture is
        /// brought down to it, light by light.
        long_side: u32 = 640, in 1..=4096,
    }
}

ports! { pub input WriteReportIn {} }
ports! {
    pub output WriteReportOut {
        /// `report.html`.
        files: Arc<Files>,
    }
}

/// Level of zlib: the page is a file, so its size counts.
const PACKING: u32 = 4;
/// Longest side of pictures that serve as previews.
const SMALL: usize = 320;

/// The fields of report.json for the drawing of the graph; the page itself reads the others.
#[derive(Deserialize)]
struct GraphOfReport {
    edit: Option<String>,
    nodes: Vec<NodeOfReport>,
}

#[derive(Deserialize)]
struct NodeOfReport {
    name: String,
    kind: String,
    status: Status,
    seconds: f64,
    from: Vec<String>,
}

impl Node for WriteReport {
    const KIND: &'static str = "WriteReport";
    const VERSION: u32 = 3;
    type In = WriteReportIn;
    type Out = WriteReportOut;

    fn files(&mut self) -> Vec<&mut File> {
        vec![&mut self.layers, &mut self.report]
    }

    fn run(&self, _: WriteReportIn, ctx: &Context) -> Result<WriteReportOut, NodeError> {
        let path = self.report.location().display().to_string();
        let bad = |e: serde_json::Error| NodeError::BadFile {
            path: path.clone(),
            message: format!("wanted the report.json of a run of this version: {e}"),
        };
        let value: Value = serde_json::from_slice(&ctx.read(&self.report)?).map_err(bad)?;
        let report = GraphOfReport::deserialize(&value).map_err(bad)?;
        let run = read_run(&self.layers, ctx, |_| true)?;
        let (width, height) = run.rest.size();
        let size = fit(width, height, self.long_side as usize);

        let layer = |id: &str, layer: &Layer| {
            let packed = pack(&resize(&layer.picture().0, size.0, size.1), PACKING);
            let mut entry = json!({
                "id": id, "scale": packed.scale, "packed": STANDARD.encode(&packed.bytes),
                "dark": layer.is_black(),
            });
            diagnostics(id, &run.file, &mut entry);
            entry
        };
        let lights: Vec<Value> =
            run.lights.par_iter().map(|(id, light)| layer(id, light)).collect();
        let photo = run.file.rgb("photo").map(|photo| {
            let small = Picture(resize(&photo, size.0, size.1));
            url(&write_png(&small, run.encoding.transfer, false))
        });
        let data = json!({
            "report": value, "size": size, "full": (width, height), "transfer": run.encoding.transfer, "photo": photo,
            "room": super::read_room(&run.file), "lights": lights, "rest": layer(crate::nodes::artifacts::REST, &run.rest),
        });
        // A script must not contain `<`, which could end it.
        let data = data.to_string().replace('<', "\\u003c");
        let edit = report.edit.as_deref().unwrap_or("no change");
        let title = escape_markup(&format!("{edit} - relight"));
        let drawn: Vec<Drawn> = report.nodes.into_iter().map(drawn).collect();
        let page = fill(
            PAGE,
            &[
                ("title", &title),
                ("style", include_str!("report/page.css")),
                ("script", &script()),
                ("graph", &svg::draw(&drawn)),
                ("data", &data),
            ],
        );
        Ok(WriteReportOut {
            files: Arc::new(Files(vec![("report.html".into(), page.into_bytes())])),
        })
    }
}

const PAGE: &str = include_str!("report/page.html");

/// The module that this page shares with that of `relight serve`, as part of a classic script, and
/// the page's own text.
fn script() -> String {
    let shared = include_str!("report/layers.js").replace("\nexport ", "\n");
    shared + include_str!("report/page.js")
}

fn drawn(row: NodeOfReport) -> Drawn {
    Drawn {
        name: row.name,
        kind: row.kind,
        status: Some(row.status),
        seconds: row.seconds,
        from: row.from,
    }
}

/// Shadow, unknown fraction and standard errors of a light, if the run wrote them: small pictures,
/// and their means.
fn diagnostics(id: &str, file: &ExrFile, entry: &mut Value) {
    let small = |name: &str| {
        let plane = file.number(&format!("{name}_{id}.Y"))?;
        let (width, height) = fit(plane.width(), plane.height(), SMALL);
        Some(resize(&plane, width, height))
    };
    let mean = |plane: &Plane<f32>| {
        plane.pixels().iter().map(|&v| f64::from(v)).sum::<f64>() / plane.len() as f64
    };
    let picture = |plane: &Plane<f32>, white: f32| {
        let shown = plane.map(|v| Vec3::splat(if white > 0.0 { v / white } else { 0.0 }));
        url(&write_png(&Picture(shown), Transfer::Linear, false))
    };
    for (name, average) in [("shadow", "lit"), ("unknown", "unknown_share")] {
        if let Some(plane) = small(name) {
            entry[name] = picture(&plane, 1.0).into();
            entry[average] = mean(&plane).into();
        }
    }
    if let Some(plane) = small("stderr") {
        // A few pixels at edges err far more than all others.
        let mut sorted = plane.pixels().to_vec();
        sorted.sort_by(f32::total_cmp);
        let white = sorted[(sorted.len() - 1) * 199 / 200];
        entry["stderr"] = picture(&plane, white).into();
        entry["stderr_white"] = white.into();
    }
    let shading = || {
        let [direct, indirect] =
            ["direct", "indirect"].map(|part| file.rgb(&format!("{part}_{id}")));
        let (mut sum, indirect) = (direct?, indirect?);
        sum.pixels_mut().iter_mut().zip(indirect.pixels()).for_each(|(sum, part)| *sum += *part);
        let (width, height) = fit(sum.width(), sum.height(), SMALL);
        Some(resize(&sum, width, height).map(luminance))
    };
    if let (Some(error), Some(shading)) = (small("room_error"), shading()) {
        entry["room_error"] =
            url(&write_png(&guesswork(&shading, &error), Transfer::Srgb, false)).into();
        entry["room_share"] = (mean(&error) / mean(&shading).max(f64::MIN_POSITIVE)).into();
    }
}

/// Shading in gray, up to its 99th percentile, which turns to orange where its standard error
/// approaches the shading itself.
fn guesswork(shading: &Plane<f32>, error: &Plane<f32>) -> Picture {
    const ORANGE: Vec3 = Vec3::new(1.0, 0.3, 0.0);
    let mut sorted = shading.pixels().to_vec();
    sorted.sort_by(f32::total_cmp);
    let white = sorted[(sorted.len() - 1) * 99 / 100].max(f32::MIN_POSITIVE);
    let color = |x: usize, y: usize| {
        let (value, error) = (shading.get(x, y), error.get(x, y));
        let share = (error / value.max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
        let gray = Vec3::splat((value / white).clamp(0.0, 1.0));
        // The luminance stays, so that shadows are not taken for certain pixels.
        let orange = ORANGE * (gray.x / luminance(ORANGE)).min(1.0);
        gray.lerp(orange, share)
    };
    Picture(Plane::from_fn(shading.width(), shading.height(), color))
}

fn url(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", STANDARD.encode(png))
}

/// The template with each `{{name}}` replaced; inserted text is not scanned again.
fn fill(template: &str, values: &[(&str, &str)]) -> String {
    let mut page = String::new();
    for (at, part) in template.split("{{").enumerate() {
        let Some((name, text)) = part.split_once("}}").filter(|_| at > 0) else {
            page.push_str(part);
            continue;
        };
        let value = values.iter().find(|(known, _)| *known == name);
        page.push_str(value.expect("the template of the program names what there is").1);
        page.push_str(text);
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_filled_in_is_not_filled_again() {
        assert_eq!(
            fill("<a>{{x}}</a>{{y}}{{x}}!", &[("x", "{{y}}"), ("y", "2")]),
            "<a>{{y}}</a>2{{y}}!"
        );
    }
}
