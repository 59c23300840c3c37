//! Events for the pages, and what they contain.

use relight::graph::{Diagnostic, NodeReport, Origin, Status, escape, escape_json, escape_line};
use serde::Serialize;

/// One event, as pages receive it.
#[derive(Clone)]
pub struct Event {
    pub name: &'static str,
    pub data: String,
}

impl Event {
    pub fn new(name: &'static str, data: &impl Serialize) -> Event {
        Event { name, data: text(data) }
    }
}

/// JSON in which no control character is left.
pub fn text(data: &impl Serialize) -> String {
    escape_json(&serde_json::to_string(data).expect("texts and numbers are JSON"))
}

/// A fault, for a page.
#[derive(Clone, Debug, Serialize)]
pub struct Fault {
    pub message: String,
    pub path: String,
    pub line: Option<usize>,
    pub column: Option<usize>,
    /// The first column after the place, on the same line.
    pub end_column: Option<usize>,
    pub help: Option<String>,
}

impl Fault {
    pub fn of(fault: &Diagnostic) -> Fault {
        let place = fault.origin.as_ref().map(Origin::line_column);
        let width = fault.origin.as_ref().map_or(0, |origin| {
            let text = origin.source.text.get(origin.span.clone()).unwrap_or_default();
            text.lines().next().unwrap_or_default().chars().count()
        });
        Fault {
            message: escape(&fault.message).into_owned(),
            path: escape_line(&fault.path.display().to_string()),
            line: place.map(|(line, _)| line),
            column: place.map(|(_, column)| column),
            end_column: place.map(|(_, column)| column + width),
            help: fault.help.as_ref().map(|help| escape(help).into_owned()),
        }
    }

    pub fn all(faults: &[Diagnostic]) -> Vec<Fault> {
        faults.iter().map(Fault::of).collect()
    }
}

/// A node that a run computed.
#[derive(Clone, Serialize)]
pub struct Row {
    name: String,
    status: Status,
    seconds: f64,
    rays: u64,
    why: Option<String>,
}

/// The nodes of a run that are not hits.
pub fn rows(nodes: &[NodeReport]) -> impl Iterator<Item = Row> {
    nodes.iter().filter(|node| node.status != Status::Hit).map(|node| Row {
        name: node.name.clone(),
        status: node.status,
        seconds: node.seconds,
        rays: node.rays,
        why: node.error.as_ref().or(node.why.as_ref()).map(|why| escape(why).into_owned()),
    })
}
