//! From a graph file, an overlay and the registry to a graph that is ready to run.

use super::file::{GraphFile, Overlay};
use super::network::Graph;
use super::registry::Registry;
use super::source::Fault;

impl GraphFile {
    /// Looks up kinds, ports and files, sets all parameters, and makes one instance per node, or per node and member.
    /// All faults come at once.
    pub fn resolve(&self, registry: &Registry, overlay: &Overlay) -> Result<Graph, Vec<Fault>> {
        let _ = (registry, overlay);
        todo!()
    }
}
