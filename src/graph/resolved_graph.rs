//! A graph ready to run: one instance per node, or per node and member, and the wires between them.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::raw::Raw;
use super::registry::AnyNode;
use super::source::Diagnostic;
use super::{Digest, File, PortSpec, key};

/// A graph that was checked against the registry: every name, type and file of a run is present.
pub struct ResolvedGraph {
    pub(super) nodes: Vec<GraphNode>,
    /// Every instance comes after all that it takes from.
    pub(super) instances: Vec<Instance>,
    pub(super) outputs: Vec<String>,
    /// The graph file and those that it extends.
    pub(super) sources: Vec<PathBuf>,
    /// Values that scene, edit and command line give, used or not.
    pub(super) settings: Vec<Raw>,
    pub(super) warnings: Vec<Diagnostic>,
}

pub(super) struct GraphNode {
    pub name: String,
    pub kind: &'static str,
    pub each: Option<String>,
    pub op: Box<dyn AnyNode>,
    pub inputs: Vec<PortSpec>,
    pub outputs: Vec<PortSpec>,
    /// The lines of the key that do not depend on inputs: kind, version, parameters.
    pub key_head: String,
    pub files: Vec<(File, Digest)>,
    /// Its instances are a range of [`Graph::instances`].
    pub instances: Range<usize>,
}

pub(super) struct Instance {
    pub name: Arc<str>,
    pub node: usize,
    pub member: Option<String>,
    /// One per input port of the node.
    pub inputs: Vec<Input>,
    /// The output that must have a value; without one, the instance is not run.
    pub when: Option<Edge>,
    /// The instances that decide whether it runs, each once, ascending: that of `when`, and those
    /// behind inputs that it needs which may not be run themselves. No other node runs on its
    /// behalf before their results are known.
    pub conditions: Vec<usize>,
    /// The instances that it takes from and those of `conditions`, each once, ascending.
    pub from: Vec<usize>,
}

pub(super) enum Input {
    Missing,
    One(Edge),
    Many(Vec<Edge>),
}

/// One output port of an instance, and how it is taken.
#[derive(Clone)]
pub(super) struct Edge {
    pub instance: usize,
    pub port: usize,
    pub selector: InputSelector,
}

#[derive(Clone)]
pub(super) enum InputSelector {
    /// The one value, under the member name of the instance that gave it.
    Whole,
    /// This member of a scatter.
    Member(String),
    /// All members of a scatter.
    All,
}

/// The requested outputs of a run.
#[derive(Clone)]
pub struct Wanted {
    pub(super) outputs: Vec<WantedOutput>,
    /// Per instance, whether it may be needed; which of them are depends on conditions.
    pub(super) needed: Vec<bool>,
}

#[derive(Clone)]
pub(super) struct WantedOutput {
    pub name: String,
    pub port: usize,
    pub instances: Vec<usize>,
    /// Each instance's value is one member's.
    pub by_member: bool,
}

impl Input {
    /// Returns the wires that end at the input, in member order.
    pub fn edges(&self) -> &[Edge] {
        match self {
            Input::Missing => &[],
            Input::One(edge) => std::slice::from_ref(edge),
            Input::Many(edges) => edges,
        }
    }
}

impl Instance {
    /// Everything it takes, with the index of the input port.
    pub fn ports(&self) -> impl Iterator<Item = (usize, &Edge)> {
        self.inputs
            .iter()
            .enumerate()
            .flat_map(|(port, input)| input.edges().iter().map(move |edge| (port, edge)))
    }
}

impl Wanted {
    /// Per instance, whether it is wanted itself.
    pub(super) fn is_root(&self, instances: usize) -> Vec<bool> {
        let mut roots = vec![false; instances];
        self.outputs.iter().flat_map(|output| &output.instances).for_each(|&at| roots[at] = true);
        roots
    }
}

impl ResolvedGraph {
    /// The files that a run of this graph reads, and those that its scene and its edit name,
    /// whether a stage reads them or not: a run must not overwrite them. The list contains existing
    /// files only.
    pub fn inputs(&self) -> BTreeSet<PathBuf> {
        let of_nodes =
            self.nodes.iter().flat_map(|node| node.files.iter().map(|(file, _)| file.location()));
        let named = self.settings.iter().flat_map(|value| {
            let folder = value.origin.source.folder();
            let name = |word: Raw| word.parse::<String>().map(|name| folder.join(name));
            value.words().into_iter().filter_map(move |(word, _)| name(word))
        });
        let texts = self.settings.iter().map(|value| value.origin.source.path.clone());
        let all = of_nodes.chain(named).chain(texts).chain(self.sources.iter().cloned());
        all.filter(|path| path.is_file()).collect()
    }

    /// The files that the stages of the wanted outputs read, with the digests of their contents.
    pub fn files(&self, wanted: &Wanted) -> impl Iterator<Item = (&File, Digest)> {
        let nodes = self.needed(wanted).map(|at| &self.nodes[self.instances[at].node]);
        nodes.flat_map(|node| node.files.iter().map(|(file, digest)| (file, *digest)))
    }

    /// The digest of all that decides the wanted outputs: kinds, versions and parameters of the
    /// nodes, contents of the files that they read, and wires.
    pub fn digest(&self, wanted: &Wanted) -> Digest {
        let mut text = String::new();
        for at in self.needed(wanted) {
            let instance = &self.instances[at];
            let node = &self.nodes[instance.node];
            let mut line = |line: &dyn std::fmt::Display| {
                writeln!(text, "{line}").expect("writing to a string");
            };
            line(&format_args!("node {}", instance.name));
            line(&node.key_head);
            let wire = |edge: &Edge| {
                let from = &self.instances[edge.instance].name;
                let member = match &edge.selector {
                    InputSelector::Whole => "",
                    InputSelector::All => "[]",
                    InputSelector::Member(member) => member,
                };
                format!("{from} {} {member}", edge.port)
            };
            for (port, edge) in instance.ports() {
                line(&format_args!("input {}: {}", node.inputs[port].name, wire(edge)));
            }
            instance.when.iter().for_each(|edge| line(&format_args!("when {}", wire(edge))));
        }
        for output in &wanted.outputs {
            writeln!(text, "output {}", output.name).expect("writing to a string");
        }
        key::digest(&text)
    }

    fn needed<'a>(&self, wanted: &'a Wanted) -> impl Iterator<Item = usize> + 'a {
        (0..self.instances.len()).filter(|&at| wanted.needed[at])
    }

    /// Old names that its files use, each with its new one.
    pub fn warnings(&self) -> &[Diagnostic] {
        &self.warnings
    }

    /// The outputs that the graph file names.
    pub fn outputs(&self) -> &[String] {
        &self.outputs
    }

    /// Selects outputs by name: `node`, `node[member]`, `node.port`, `node[member].port`; a node
    /// without a port means all its ports. `None` means the outputs of the graph file.
    ///
    /// # Errors
    /// A name that the graph does not have, or no name at all.
    pub fn wanted(&self, names: Option<&[String]>) -> Result<Wanted, Diagnostic> {
        let names = names.unwrap_or(&self.outputs);
        if names.is_empty() {
            return Err(Diagnostic::file(
                Path::new(""),
                "wanted an output, got none: the graph names no outputs",
            ));
        }
        let mut wanted = Wanted { outputs: Vec::new(), needed: vec![false; self.instances.len()] };
        for name in names {
            let (node_name, port_name) = match name.split_once('.') {
                Some((node, port)) => (node, Some(port)),
                None => (name.as_str(), None),
            };
            let (node, instances) = self.find(node_name)?;
            let by_member = node.each.is_some()
                && instances.len() == node.instances.len()
                && !node_name.contains('[');
            for instance in instances.clone() {
                wanted.needed[instance] = true;
            }
            let ports: Vec<usize> = match port_name {
                None => (0..node.outputs.len()).collect(),
                Some(port) => {
                    vec![node.outputs.iter().position(|p| p.name == port).ok_or_else(|| {
                        let message =
                            format!("node `{node_name}` ({}) has no output `{port}`", node.kind);
                        Diagnostic::file(Path::new(""), message)
                            .suggest(port, node.outputs.iter().map(|p| p.name))
                    })?]
                }
            };
            for &port in &ports {
                let name = if port_name.is_some() || ports.len() == 1 {
                    name.clone()
                } else {
                    format!("{name}.{}", node.outputs[port].name)
                };
                wanted.outputs.push(WantedOutput {
                    name,
                    port,
                    instances: instances.clone().collect(),
                    by_member,
                });
            }
        }
        for instance in
            (0..self.instances.len()).rev().filter(|&i| wanted.needed[i]).collect::<Vec<_>>()
        {
            self.mark(instance, &mut wanted.needed);
        }
        Ok(wanted)
    }

    /// The node, and those of its instances that `name` (`node` or `node[member]`) means.
    ///
    /// # Errors
    /// The graph does not have such a node or member.
    pub(super) fn find(&self, name: &str) -> Result<(&GraphNode, Range<usize>), Diagnostic> {
        if let Some(node) = self.nodes.iter().find(|n| n.name == name) {
            return Ok((node, node.instances.clone()));
        }
        if let Some(at) = self.instances.iter().position(|i| &*i.name == name) {
            return Ok((&self.nodes[self.instances[at].node], at..at + 1));
        }
        let known = self.nodes.iter().map(|n| n.name.as_str()).chain(self.instances());
        Err(Diagnostic::file(Path::new(""), format!("the graph has no node `{name}`"))
            .suggest(name, known))
    }

    /// The output that decides whether an instance runs, as `node.port`.
    pub(super) fn condition(&self, instance: usize) -> Option<String> {
        let Edge { instance, port, .. } = self.instances[instance].when.as_ref()?;
        let node = &self.nodes[self.instances[*instance].node];
        Some(format!("{}.{}", self.instances[*instance].name, node.outputs[*port].name))
    }

    /// Marks all that `instance` takes from. Iterative, because graphs may be long chains.
    fn mark(&self, instance: usize, needed: &mut [bool]) {
        let mut stack = vec![instance];
        while let Some(at) = stack.pop() {
            for &from in &self.instances[at].from {
                if !std::mem::replace(&mut needed[from], true) {
                    stack.push(from);
                }
            }
        }
    }

    /// The nodes of this kind.
    pub fn of_kind(&self, kind: &str) -> impl Iterator<Item = &str> {
        self.nodes.iter().filter(move |node| node.kind == kind).map(|node| node.name.as_str())
    }

    /// The instances that this one takes from.
    pub fn takes_from(&self, instance: &str) -> Vec<&str> {
        let found = self.instances.iter().find(|i| &*i.name == instance);
        found.map_or(Vec::new(), |i| {
            i.from.iter().map(|&from| &*self.instances[from].name).collect()
        })
    }

    /// The outputs that each input port of a node takes, as [`ResolvedGraph::wanted`] names them;
    /// an empty list for a port without a wire. `None` where the graph does not have the node.
    pub fn feeds(&self, node: &str) -> Option<Vec<Vec<String>>> {
        let node = self.nodes.iter().find(|n| n.name == node)?;
        let mut feeds = vec![Vec::new(); node.inputs.len()];
        for (port, edge) in self.instances[node.instances.clone()].iter().flat_map(Instance::ports)
        {
            let from = &self.nodes[self.instances[edge.instance].node];
            let output = format!("{}.{}", from.name, from.outputs[edge.port].name);
            if !feeds[port].contains(&output) {
                feeds[port].push(output);
            }
        }
        Some(feeds)
    }

    /// Names of all instances, in the order in which a run reports them.
    pub fn instances(&self) -> impl Iterator<Item = &str> {
        self.instances.iter().map(|i| &*i.name)
    }
}
