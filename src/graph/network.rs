//! A graph ready to run: one instance per node, or per node and member, and the wires between them.

use std::sync::Arc;

use super::registry::AnyNode;
use super::source::Fault;
use super::{Digest, File, PortSpec};

/// A graph that was checked against the registry: running it cannot fail for want of a name, a type or a file.
pub struct Graph {
    pub(super) nodes: Vec<GraphNode>,
    /// Every instance comes after all that it takes from.
    pub(super) instances: Vec<Instance>,
    pub(super) outputs: Vec<String>,
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
    pub instances: std::ops::Range<usize>,
}

pub(super) struct Instance {
    pub name: Arc<str>,
    pub node: usize,
    pub member: Option<String>,
    /// One per input port of the node.
    pub inputs: Vec<Input>,
}

pub(super) enum Input {
    Missing,
    One(Feed),
    Many(Vec<Feed>),
}

/// One output port of an instance, and how it is taken.
#[derive(Clone)]
pub(super) struct Feed {
    pub instance: usize,
    pub port: usize,
    pub take: Take,
}

#[derive(Clone)]
pub(super) enum Take {
    /// The one value, under the member name of the instance that gave it.
    Whole,
    /// This member of a scatter.
    Member(String),
    /// All members of a scatter.
    All,
}

/// What a run is asked for.
#[derive(Clone)]
pub struct Wanted {
    pub(super) outputs: Vec<WantedOutput>,
    /// Per instance, whether it is needed.
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

impl Graph {
    /// The outputs that the graph file names.
    pub fn outputs(&self) -> &[String] {
        &self.outputs
    }

    /// What is needed for these: `node`, `node[member]`, `node.port`, `node[member].port`; a node without a port means
    /// all its ports. `None` means the outputs of the graph file.
    pub fn wanted(&self, names: Option<&[String]>) -> Result<Wanted, Fault> {
        let _ = names;
        todo!()
    }

    /// Names of all instances, in the order in which a run reports them.
    pub fn instances(&self) -> impl Iterator<Item = &str> {
        self.instances.iter().map(|i| &*i.name)
    }
}
