//! A graph as a picture or as data.

use super::network::Graph;
use super::report::RunReport;

impl Graph {
    /// Graphviz; with a run, boxes are coloured by what became of them.
    pub fn to_dot(&self, run: Option<&RunReport>) -> String {
        let _ = run;
        todo!()
    }

    pub fn to_mermaid(&self, run: Option<&RunReport>) -> String {
        let _ = run;
        todo!()
    }

    /// `{ nodes: [{ name, kind, member, status }], edges: [{ from, from_port, to, to_port, type }] }`
    pub fn to_json(&self, run: Option<&RunReport>) -> String {
        let _ = run;
        todo!()
    }
}
