//! The kinds of nodes that graph files may name, with their types forgotten.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use super::artifact::digest_of;
use super::{
    Context, Digest, File, Inputs, Node, NodeError, Outputs, ParamSpec, Params, PortSpec,
    PortValue, Value,
};

/// The list of node kinds.
#[derive(Default)]
pub struct Registry {
    kinds: Vec<KindSpec>,
    /// Current kinds by their old names.
    old_kinds: BTreeMap<&'static str, &'static str>,
    /// Current parameters, inputs and outputs by kind and old name.
    old_fields: BTreeMap<(&'static str, &'static str), &'static str>,
    /// The folder of files that stages name by default, and the help shown when one is missing.
    pub(super) library: Option<(PathBuf, String)>,
}

/// A kind's description: the source of checks, of messages and of the node reference.
pub struct KindSpec {
    /// Name of the kind in graph files.
    pub kind: &'static str,
    /// [`Node::VERSION`] of the stage.
    pub version: u32,
    /// Documentation of the stage.
    pub doc: &'static str,
    /// Parameters, in the order of declaration.
    pub params: Vec<ParamSpec>,
    /// Input ports, in the order of declaration.
    pub inputs: Vec<PortSpec>,
    /// Output ports, in the order of declaration.
    pub outputs: Vec<PortSpec>,
    pub(super) make: fn() -> Box<dyn AnyNode>,
}

impl Registry {
    /// Creates an empty list.
    pub fn new() -> Registry {
        Registry::default()
    }

    /// Adds a kind at the end of the list.
    ///
    /// # Panics
    /// A kind of this name is in the list.
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

    /// Lets files use the old name `old` of the kind `new`, with a warning.
    ///
    /// # Panics
    /// No kind is called `new`, or one is called `old`.
    pub fn renamed(mut self, old: &'static str, new: &'static str) -> Registry {
        assert!(
            self.get(new).is_some() && self.get(old).is_none(),
            "{old} cannot be an old name of {new}"
        );
        self.old_kinds.insert(old, new);
        self
    }

    /// Lets files use the old name `old` of `new`, a parameter, an input or an output of the kind
    /// `kind`, with a warning.
    ///
    /// # Panics
    /// The kind has nothing of the name `new`.
    pub fn renamed_field(
        mut self,
        kind: &'static str,
        old: &'static str,
        new: &'static str,
    ) -> Registry {
        let has = |spec: &KindSpec| {
            let ports = spec.inputs.iter().chain(&spec.outputs).map(|port| port.name);
            ports.chain(spec.params.iter().map(|param| param.name)).any(|name| name == new)
        };
        assert!(self.get(kind).is_some_and(has), "{kind} has no {new}");
        self.old_fields.insert((kind, old), new);
        self
    }

    /// The current name of a kind that is called `name` in a file, which is `name` itself unless
    /// that is an old one.
    pub(super) fn current_kind<'a>(&self, name: &'a str) -> &'a str {
        self.old_kinds.get(name).copied().unwrap_or(name)
    }

    /// The current name of a parameter, an input or an output of a kind; `known` lists the current
    /// names.
    pub(super) fn current_field<'a>(
        &self,
        kind: &'static str,
        name: &'a str,
        mut known: impl Iterator<Item = &'static str>,
    ) -> &'a str {
        if known.any(|known| known == name) {
            return name;
        }
        // The name lives as long as its key in the table.
        let found = self.old_fields.iter().find(|((of, old), _)| *of == kind && *old == name);
        found.map_or(name, |(_, new)| new)
    }

    /// Sets the folder of the files that stages name by default; `help` is shown when one of them
    /// is missing.
    pub fn with_library(mut self, folder: PathBuf, help: impl Into<String>) -> Registry {
        self.library = Some((folder, help.into()));
        self
    }

    /// All kinds, in the order of the list.
    pub fn kinds(&self) -> impl Iterator<Item = &KindSpec> {
        self.kinds.iter()
    }

    /// Returns the description of a kind.
    pub fn get(&self, kind: &str) -> Option<&KindSpec> {
        self.kinds.iter().find(|k| k.kind == kind)
    }

    /// The types that the kinds give, each once.
    pub fn types(&self) -> BTreeSet<&'static str> {
        self.kinds.iter().flat_map(|kind| &kind.outputs).map(|port| port.type_name).collect()
    }

    /// A value of a type from its stored form, with the checks of a value that comes from the
    /// cache; none for a type that no kind gives. The digest is that of the bytes.
    ///
    /// # Errors
    /// The message states the wanted and the actual content.
    pub fn decode(&self, type_name: &str, bytes: &[u8]) -> Option<Result<Value, String>> {
        let port =
            |kind: &KindSpec| kind.outputs.iter().position(|port| port.type_name == type_name);
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
    fn stored_up_to(&self) -> u64;
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

    fn stored_up_to(&self) -> u64 {
        N::STORED_UP_TO
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
