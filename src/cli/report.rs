//! The report of a run: the table on standard error, and report.json.

use std::path::Path;
use std::time::Instant;

use relight::graph::{NodeReport, ResolvedGraph, RunReport, Status, escape_json};
use serde::Serialize;

/// The first fields of every report.json.
#[derive(Serialize)]
pub struct Head {
    relight: &'static str,
    graph: String,
    /// `None` where nothing is changed.
    edit: Option<String>,
    /// Wall time since the program began.
    pub seconds: f64,
    peak_bytes: Option<u64>,
    /// Backend of the networks; `None` without networks.
    backend: Option<String>,
    threads: usize,
}

impl Head {
    /// Creates the head of a run that began at `began`; the wall time ends at this call.
    pub fn new(
        graph: &Path,
        edit: Option<&Path>,
        began: Instant,
        backend: Option<String>,
        threads: usize,
    ) -> Head {
        Head {
            relight: env!("CARGO_PKG_VERSION"),
            graph: graph.display().to_string(),
            edit: edit.map(|edit| edit.display().to_string()),
            seconds: began.elapsed().as_secs_f64(),
            peak_bytes: peak_bytes(),
            backend,
            threads,
        }
    }
}

#[derive(Serialize)]
struct ReportJson<'a> {
    #[serde(flatten)]
    head: &'a Head,
    nodes: Vec<NodeJson<'a>>,
    warnings: &'a [String],
}

/// One node in report.json.
#[derive(Serialize)]
pub struct NodeJson<'a> {
    name: &'a str,
    kind: &'a str,
    pub status: Status,
    seconds: f64,
    rays: u64,
    samples: Option<f64>,
    stderr: Option<f64>,
    bytes: u64,
    key: Option<String>,
    why: Option<&'a str>,
    notes: &'a [String],
    /// Nodes that give its inputs; left out in the report of a sequence.
    #[serde(skip_serializing_if = "Option::is_none")]
    from: Option<Vec<&'a str>>,
}

/// The nodes of a run.
pub fn rows(run: &RunReport) -> impl Iterator<Item = NodeJson<'_>> {
    run.nodes.iter().map(|node| NodeJson {
        name: &node.name,
        kind: node.kind,
        status: node.status,
        seconds: node.seconds,
        rays: node.rays,
        samples: node.samples,
        stderr: node.stderr,
        bytes: node.bytes,
        key: node.key.map(|key| key.to_string()),
        why: node.error.as_deref().or(node.why.as_deref()),
        notes: &node.notes,
        from: None,
    })
}

/// report.json of one picture.
pub fn json(head: &Head, graph: &ResolvedGraph, run: &RunReport, warnings: &[String]) -> String {
    let nodes =
        rows(run).map(|row| NodeJson { from: Some(graph.takes_from(row.name)), ..row }).collect();
    text(&ReportJson { head, nodes, warnings })
}

/// A report as it is written.
pub fn text(report: &impl Serialize) -> String {
    escape_json(
        &(serde_json::to_string_pretty(report).expect("a report holds text and numbers only")
            + "\n"),
    )
}

/// All warnings of a run, each after the name of its node.
pub fn warnings(run: &RunReport) -> Vec<String> {
    let of_nodes = run
        .nodes
        .iter()
        .flat_map(|node| node.warnings.iter().map(move |w| format!("{}: {w}", node.name)));
    of_nodes.chain(run.warnings.iter().cloned()).collect()
}

/// The notes of the nodes whose outputs a run returned.
pub fn notes_of_outputs(run: &RunReport) -> impl Iterator<Item = &str> {
    let gave = |name: &str| {
        let wanted = run.outputs.iter().map(|(output, _)| output.as_str());
        wanted.filter_map(|output| output.split_once('.')).any(|(node, _)| node == name)
    };
    let nodes = run.nodes.iter().filter(move |node| gave(&node.name));
    nodes.flat_map(|node| node.notes.iter().map(String::as_str))
}

/// The table of a run, a row per node.
pub fn table(run: &RunReport) -> String {
    let width = run.nodes.iter().map(|node| node.name.chars().count()).max().unwrap_or(0).max(4);
    let (status, seconds, memory, rays, samples, error) =
        ("status", "seconds", "MB", "rays", "samples", "std error");
    let mut text = format!(
        "{:width$}  {status:9} {seconds:>9} {memory:>8} {rays:>12} {samples:>8} {error:>10}\n",
        "node"
    );
    for node in &run.nodes {
        text.push_str(&format!("{:width$}  {}\n", node.name, measures(node)));
    }
    text
}

/// Status, seconds, memory of the results, rays, mean samples and standard error: a row of the
/// table.
fn measures(node: &NodeReport) -> String {
    let ran = matches!(node.status, Status::Ran | Status::Failed);
    let seconds = if ran { format!("{:.3}", node.seconds) } else { "-".into() };
    let memory =
        if node.bytes > 0 { format!("{:.2}", node.bytes as f64 / 1e6) } else { "-".into() };
    let rays = if node.rays > 0 { node.rays.to_string() } else { "-".into() };
    let stderr = node.stderr.map_or("-".into(), |e| format!("{:.2} %", 100.0 * e));
    let samples = node.samples.map_or("-".into(), |samples| format!("{samples:.1}"));
    format!("{:9} {seconds:>9} {memory:>8} {rays:>12} {samples:>8} {stderr:>10}", node.status)
}

/// The line that summarizes a run.
pub fn summary(run: &RunReport, seconds: f64) -> String {
    let statuses = [Status::Hit, Status::Ran, Status::Failed, Status::Blocked, Status::Cancelled];
    let counts = statuses.into_iter().filter_map(|status| {
        let count = run.nodes.iter().filter(|node| node.status == status).count();
        (count > 0).then(|| format!("{count} {status}"))
    });
    let counts: Vec<String> = counts.collect();
    format!(
        "{} in {seconds:.2} s",
        if counts.is_empty() { "nothing to do".into() } else { counts.join(", ") }
    )
}

/// The largest resident memory of this process in bytes, on systems that report it.
pub fn peak_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(1024 * kibibytes)
}
