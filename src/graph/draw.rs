//! A graph as a picture or as data.

use std::fmt::Write;

use serde_json::{Value, json};

use super::report::{RunReport, Status};
use super::resolved_graph::{Edge, InputSelector, Instance, ResolvedGraph};
use super::svg;

impl ResolvedGraph {
    /// Graphviz; with a run, boxes are colored by their final state.
    pub fn to_dot(&self, run: Option<&RunReport>) -> String {
        let mut text = String::from(
            "digraph {\n  rankdir=LR;\n  node [shape=box, style=filled, fillcolor=white];\n",
        );
        let mut line = |line: String| writeln!(text, "  {line}").expect("writing to a string");
        for (i, instance) in self.instances.iter().enumerate() {
            let kind = self.nodes[instance.node].kind;
            let color = status(run, &instance.name).map_or("white", color);
            line(format!("n{i} [label=\"{}\\n{kind}\", fillcolor={color}];", instance.name));
        }
        for arrow in self.arrows() {
            line(format!("n{} -> n{} [label=\"{}\"];", arrow.from, arrow.to, arrow.label()));
        }
        text.push_str("}\n");
        text
    }

    /// A Mermaid flowchart; with a run, boxes are colored by their final state.
    pub fn to_mermaid(&self, run: Option<&RunReport>) -> String {
        let mut text = String::from("flowchart LR\n");
        let mut line = |line: String| writeln!(text, "  {line}").expect("writing to a string");
        for (i, instance) in self.instances.iter().enumerate() {
            line(format!("n{i}[\"{}<br>{}\"]", instance.name, self.nodes[instance.node].kind));
            if let Some(status) = status(run, &instance.name) {
                line(format!("style n{i} fill:{}", color(status)));
            }
        }
        for arrow in self.arrows() {
            line(format!("n{} -->|{}| n{}", arrow.from, arrow.label(), arrow.to));
        }
        text
    }

    /// A drawing; with a run, boxes are colored by status and labeled with the seconds that they
    /// took.
    pub fn to_svg(&self, run: Option<&RunReport>) -> String {
        let drawn = |instance: &Instance| {
            let report =
                run.and_then(|run| run.nodes.iter().find(|node| node.name == *instance.name));
            svg::Drawn {
                name: instance.name.to_string(),
                kind: self.nodes[instance.node].kind.to_owned(),
                status: report.map(|report| report.status),
                seconds: report.map_or(0.0, |report| report.seconds),
                from: instance
                    .from
                    .iter()
                    .map(|&from| self.instances[from].name.to_string())
                    .collect(),
            }
        };
        svg::draw(&self.instances.iter().map(drawn).collect::<Vec<_>>())
    }

    /// `{ nodes: [{ name, kind, member, status }], edges: [{ from, from_port, to, to_port, type }]
    /// }`
    #[expect(clippy::missing_panics_doc, reason = "strings are always JSON")]
    pub fn to_json(&self, run: Option<&RunReport>) -> String {
        let nodes: Vec<Value> = self
            .instances
            .iter()
            .map(|instance| {
                json!({
                    "name": &*instance.name,
                    "kind": self.nodes[instance.node].kind,
                    "member": instance.member,
                    "status": status(run, &instance.name),
                })
            })
            .collect();
        let edges: Vec<Value> = self
            .arrows()
            .map(|e| {
                json!({
                    "from": &*self.instances[e.from].name,
                    "from_port": e.from_port,
                    "to": &*self.instances[e.to].name,
                    "to_port": e.to_port,
                    "type": e.type_name,
                })
            })
            .collect();
        let graph = json!({ "nodes": nodes, "edges": edges, "outputs": self.outputs() });
        serde_json::to_string_pretty(&graph).expect("names and strings are always JSON")
    }

    fn arrows(&self) -> impl Iterator<Item = Arrow> {
        self.instances.iter().enumerate().flat_map(move |(to, instance)| {
            let name = |port: usize| self.nodes[instance.node].inputs[port].name;
            let inputs = instance.ports().map(|(port, edge)| (name(port), edge));
            let all = inputs.chain(instance.when.iter().map(|edge| ("when", edge)));
            let arrow = |(to_port, edge): (&'static str, &Edge)| {
                let output = &self.nodes[self.instances[edge.instance].node].outputs[edge.port];
                let from_port = match &edge.selector {
                    InputSelector::Member(member) => format!("{}[{member}]", output.name),
                    InputSelector::Whole | InputSelector::All => output.name.to_owned(),
                };
                Arrow { from: edge.instance, from_port, to, to_port, type_name: output.type_name }
            };
            all.map(arrow).collect::<Vec<_>>()
        })
    }
}

struct Arrow {
    from: usize,
    from_port: String,
    to: usize,
    to_port: &'static str,
    type_name: &'static str,
}

impl Arrow {
    fn label(&self) -> String {
        if self.from_port == self.to_port {
            self.from_port.clone()
        } else {
            format!("{} to {}", self.from_port, self.to_port)
        }
    }
}

fn status(run: Option<&RunReport>, name: &str) -> Option<Status> {
    run?.nodes.iter().find(|n| n.name == name).map(|n| n.status)
}

fn color(status: Status) -> &'static str {
    match status {
        Status::Hit => "lightgrey",
        Status::Ran => "lightgreen",
        Status::Failed => "tomato",
        Status::Blocked => "orange",
        Status::Cancelled => "lightyellow",
    }
}
