//! The kinds of nodes that graph files may name, with their types forgotten.

use std::collections::BTreeSet;
use std::path::PathBuf;

use super::artifact::digest_of;
use super::{Context, Digest, File, Inputs, Node, NodeError, Outputs, ParamSpec, Params, PortSpec, PortValue, Value};

/// The list of node kinds.
#[derive(Default)]
pub struct Registry {
    kinds: Vec<KindSpec>,
    /// Where files that a stage names by default lie, and what to do when they do not.
    pub(super) library: Option<(PathBuf, String)>,
}

/// What a kind of node is: the source of checks, of messages and of the node reference.
pub struct KindSpec {
    pub kind: &'static str,
    pub version: u32,
    pub doc: &'static str,
    pub params: Vec<ParamSpec>,
    pub inputs: Vec<PortSpec>,
    pub outputs: Vec<PortSpec>,
    pub(super) make: fn() -> Box<dyn AnyNode>,
}

impl Registry {
    pub fn new() -> Registry {
        Registry::default()
    }

    /// The same list with one more kind at its end.
    pub fn with<N: Node>(mut self) -> Registry {
        assert!(self.get(N::KIND).is_none(), "the kind {} is listed twice", N::KIND);
        self.kinds.push(KindSpec {
            kind: N::KIND,
            version: N::VERSION,
            doc: N::DOC,
            params: N::params(),
            inputs: N::In::ports(),
            outputs: N::Out::ports(),
            make: || Box::new(N::default()),
        });
        self
    }

    /// The same list, with the folder of the files that stages name by default; `help` is told when one of them is not there.
    pub fn with_library(mut self, folder: PathBuf, help: impl Into<String>) -> Registry {
        self.library = Some((folder, help.into()));
        self
    }

    /// All kinds, in the order of the list.
    pub fn kinds(&self) -> impl Iterator<Item = &KindSpec> {
        self.kinds.iter()
    }

    pub fn get(&self, kind: &str) -> Option<&KindSpec> {
        self.kinds.iter().find(|k| k.kind == kind)
    }

    /// The types that the kinds give, each once.
    pub fn types(&self) -> BTreeSet<&'static str> {
        self.kinds.iter().flat_map(|kind| &kind.outputs).map(|port| port.type_name).collect()
    }

    /// A value of a type from its stored form, with the checks of a value that comes from the cache; none for a type that no
    /// kind gives. The digest is that of the bytes.
    ///
    /// # Errors
    /// What was wanted and what was got.
    pub fn decode(&self, type_name: &str, bytes: &[u8]) -> Option<Result<Value, String>> {
        let port = |kind: &KindSpec| kind.outputs.iter().position(|port| port.type_name == type_name);
        let (kind, port) = self.kinds.iter().find_map(|kind| Some((kind, port(kind)?)))?;
        Some((kind.make)().decode(port, bytes.to_vec(), digest_of(type_name, bytes)))
    }
}

/// A [`Node`] with its type forgotten.
pub(super) trait AnyNode: Send + Sync {
    fn set(&mut self, name: &str, ron: &str) -> Option<Result<(), ron::error::SpannedError>>;
    fn values(&self) -> Vec<(&'static str, String)>;
    fn files(&mut self) -> Vec<&mut File>;
    fn check(&self) -> Result<(), String>;
    fn decode(&self, port: usize, bytes: Vec<u8>, digest: Digest) -> Result<Value, String>;
    fn run(&self, inputs: Vec<PortValue>, ctx: &Context) -> Result<Vec<PortValue>, NodeError>;
    fn boxed_clone(&self) -> Box<dyn AnyNode>;
}

impl<N: Node> AnyNode for N {
    fn set(&mut self, name: &str, ron: &str) -> Option<Result<(), ron::error::SpannedError>> {
        Params::set(self, name, ron)
    }

    fn values(&self) -> Vec<(&'static str, String)> {
        Params::values(self)
    }

    fn files(&mut self) -> Vec<&mut File> {
        Node::files(self)
    }

    fn check(&self) -> Result<(), String> {
        Node::check(self)
    }

    fn decode(&self, port: usize, bytes: Vec<u8>, digest: Digest) -> Result<Value, String> {
        N::Out::decode(port, bytes, digest)
    }

    fn run(&self, inputs: Vec<PortValue>, ctx: &Context) -> Result<Vec<PortValue>, NodeError> {
        Node::run(self, N::In::take(inputs), ctx).map(Outputs::give)
    }

    fn boxed_clone(&self) -> Box<dyn AnyNode> {
        Box::new(self.clone())
    }
}
