//! Graph files: parsed with the locations of all their parts, a child over the graph that it
//! extends. Kinds and ports are looked up later, by [`GraphFile::resolve`].

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::diagnostics::Diagnostics;
use super::raw::{Key, Raw};
use super::registry::{KindSpec, Registry};
use super::source::{Diagnostic, Origin, Reach, Source, is_name};

/// The version of graph files that this program reads.
const VERSION: u32 = 1;
/// More than any person or program writes; keeps a hostile file from costing minutes.
const MAX_NODES: usize = 10_000;

/// A graph file with everything that it extends.
///
/// ```
/// use relight::graph::{GraphFile, Source};
///
/// let text = r#"Graph(version: 1, nodes: {
///     "scene": (op: ReadScene()),
///     "room": (op: Mesh(), in: {"depth": "scene.depth"}),
/// })"#;
/// let file = GraphFile::parse(Source::new("room.ron", text)).expect("the text is a graph");
/// assert!(file.nodes().map(|node| node.kind).eq(["ReadScene", "Mesh"]));
/// assert!(file.wired("room", "depth").eq(["scene.depth"]));
/// ```
pub struct GraphFile {
    path: PathBuf,
    /// This file and those that it extends.
    pub(super) sources: Vec<PathBuf>,
    scene: Option<Key>,
    pub(super) sets: Vec<SetDecl>,
    pub(super) nodes: Vec<NodeDecl>,
    pub(super) outputs: Vec<Key>,
    /// Diagnostics that do not hinder looking for more: [`GraphFile::resolve`] reports them with
    /// its own.
    pub(super) faults: Diagnostics,
    /// Old names that the file uses.
    pub(super) warnings: Vec<Diagnostic>,
}

/// A set of member names, as the graph file gives it.
pub struct SetInfo<'a> {
    /// Name of the set.
    pub name: &'a str,
    /// Members, in the order of the file.
    pub members: Vec<&'a str>,
}

/// A node, as the graph file gives it.
pub struct NodeInfo<'a> {
    /// Name of the node.
    pub name: &'a str,
    /// Kind of its stage, as the file spells it; empty where the file names none.
    pub kind: &'a str,
    /// The set that the node has an instance for each member of.
    pub each: Option<&'a str>,
}

/// An overlay holds the settings of a scene, an edit and the command line over a graph file.
///
/// Settings for a kind that no node of the graph has, and members of a set that the graph does not
/// have, are passed over: a graph need not use all that a scene offers.
#[derive(Clone, Default)]
pub struct Overlay {
    /// In order: a later one wins.
    pub settings: Vec<Setting>,
    /// Additional members, in order.
    pub members: Vec<Member>,
}

/// One parameter given from outside of the graph file. Relative paths in it start from the folder
/// of its source.
#[derive(Clone)]
pub struct Setting {
    /// The nodes that the parameter is set in.
    pub target: Target,
    /// Name of the parameter.
    pub field: String,
    /// Value, as RON.
    pub value: Raw,
}

/// The owner of a parameter that is set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// All nodes of this kind.
    Kind(String),
    /// The node of this name.
    Node(String),
}

/// One more member of a set.
#[derive(Clone)]
pub struct Member {
    /// Name of the set.
    pub set: String,
    /// Name of the member.
    pub name: String,
    /// Location of the name, for messages.
    pub origin: Origin,
}

pub(super) struct SetDecl {
    pub name: Key,
    pub members: Vec<Key>,
}

#[derive(Clone)]
pub(super) struct NodeDecl {
    pub name: Key,
    /// `None` in a child that only rewires or repeats.
    pub kind: Option<Key>,
    pub params: Vec<(Key, Raw)>,
    pub each: Option<Key>,
    /// The output that must be there for the node to run.
    pub when: Option<Key>,
    pub wires: Vec<Wire>,
    /// Nodes of other kinds that it replaced, the lowest first; one whose kind is the same under an
    /// old name is merged after all.
    replaced: Vec<NodeDecl>,
}

#[derive(Clone)]
pub(super) struct Wire {
    pub port: Key,
    /// `node` or `node.port`; several only for a gather port.
    pub from: Vec<Key>,
}

/// One file by itself.
struct GraphLayer {
    extends: Option<Key>,
    scene: Option<Key>,
    sets: Vec<SetDecl>,
    nodes: Vec<NodeDecl>,
    outputs: Vec<Key>,
}

impl GraphFile {
    /// Reads a graph file and the files that it extends. Fails only if a file is unreadable, its
    /// brackets do not match, or a parent is missing. All other faults are reported by
    /// [`GraphFile::resolve`], at once.
    ///
    /// # Errors
    /// The file or one that it extends cannot be read or split into fields.
    pub fn read(path: &Path) -> Result<GraphFile, Vec<Diagnostic>> {
        GraphFile::read_within(path, Reach::Anywhere)
    }

    /// Reads a file like [`GraphFile::read`], which may name others within `reach` only.
    ///
    /// # Errors
    /// The errors of [`GraphFile::read`], and a file outside of `reach`.
    pub fn read_within(path: &Path, reach: Reach) -> Result<GraphFile, Vec<Diagnostic>> {
        GraphFile::parse(Source::read(path, reach).map_err(|fault| vec![fault])?)
    }

    /// Parses a text like [`GraphFile::read`]; `extends` is looked for beside `source.path`.
    ///
    /// # Errors
    /// The errors of [`GraphFile::read`].
    pub fn parse(source: Arc<Source>) -> Result<GraphFile, Vec<Diagnostic>> {
        let mut faults = Diagnostics::default();
        let path = source.path.clone();
        let mut chain = vec![identity(&path)];
        let (mut layers, mut sources) = (Vec::new(), Vec::new());
        let mut next = Some(source);
        while let Some(source) = next.take() {
            sources.push(source.path.clone());
            let Some(layer) = parse_layer(&source, &mut faults) else {
                return Err(faults.into_vec());
            };
            if let Some(parent) = &layer.extends {
                match read_parent(&source, parent, &mut chain) {
                    Ok(source) => next = Some(source),
                    // Without the parent, the child would only show faults that are not its own.
                    Err(fault) => {
                        faults.push(|| fault);
                        return Err(faults.into_vec());
                    }
                }
            }
            layers.push(layer);
        }
        let mut file = GraphFile {
            path,
            sources,
            scene: None,
            sets: vec![],
            nodes: vec![],
            outputs: vec![],
            faults,
            warnings: vec![],
        };
        layers.into_iter().rev().for_each(|layer| file.lay_over(layer));
        Ok(file)
    }

    /// Returns the path of the graph file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The faults found before kinds and ports are looked up; [`GraphFile::resolve`] reports them
    /// too.
    pub fn faults(&self) -> Vec<Diagnostic> {
        self.faults.clone().into_vec()
    }

    /// The scene folder that the graph names, from the folder of the file that names it.
    ///
    /// # Errors
    /// A confined file names a folder elsewhere.
    pub fn scene(&self) -> Result<Option<PathBuf>, Diagnostic> {
        let Some(Key { name, origin }) = &self.scene else { return Ok(None) };
        let folder = origin.source.folder().join(name);
        match origin.source.may_name(&folder) {
            Ok(()) => Ok(Some(folder)),
            Err(e) => Err(Diagnostic::at(origin, format!("{}: {e}", folder.display()))
                .help("name the scene's folder with --scene DIR")),
        }
    }

    /// Lists the sets, in the order of the file.
    pub fn sets(&self) -> impl Iterator<Item = SetInfo<'_>> {
        self.sets.iter().map(|set| SetInfo {
            name: &set.name.name,
            members: set.members.iter().map(|m| m.name.as_str()).collect(),
        })
    }

    /// Lists the nodes, in the order of the file.
    pub fn nodes(&self) -> impl Iterator<Item = NodeInfo<'_>> {
        self.nodes.iter().map(|node| NodeInfo {
            name: &node.name.name,
            kind: node.kind.as_ref().map_or("", |kind| &kind.name),
            each: node.each.as_ref().map(|each| each.name.as_str()),
        })
    }

    /// The outputs wired to an input of a node, as `node` or `node.port`; none if the graph does
    /// not have such a node or wire.
    pub fn wired(&self, node: &str, input: &str) -> impl Iterator<Item = &str> {
        let node = self.nodes.iter().find(|n| n.name.name == node);
        let wire = node.and_then(|node| node.wires.iter().find(|w| w.port.name == input));
        wire.into_iter().flat_map(|wire| &wire.from).map(|from| from.name.as_str())
    }

    /// Adds a node `name` that has the kind, the parameters and the wires of the node `from`.
    pub fn copy(&mut self, from: &str, name: &str) {
        let copy = self.nodes.iter().find(|node| node.name.name == from).cloned();
        self.nodes.extend(
            copy.map(|node| NodeDecl { name: Key { name: name.to_owned(), ..node.name }, ..node }),
        );
    }

    /// Lets all that takes the output `from` take the output `to`, both as `node.port`, or `node`
    /// where it has one output.
    pub fn redirect(&mut self, from: &str, to: &str) {
        self.redirect_in(None, from, to);
    }

    /// [`GraphFile::redirect`] for the nodes of these kinds alone, or with `None` for all.
    pub fn redirect_in(&mut self, kinds: Option<&[&str]>, from: &str, to: &str) {
        let takes = |node: &NodeDecl| {
            let kind = node.kind.as_ref().map_or("", |kind| &kind.name);
            kinds.is_none_or(|kinds| kinds.contains(&kind))
        };
        let same = |a: &str, b: &str| match (a.split_once('.'), b.split_once('.')) {
            (None, Some((node, _))) => a == node,
            (Some((node, _)), None) => b == node,
            _ => a == b,
        };
        for node in self.nodes.iter_mut().filter(|node| takes(node)) {
            let ends = node.wires.iter_mut().flat_map(|wire| &mut wire.from).chain(&mut node.when);
            ends.filter(|end| same(&end.name, from)).for_each(|end| to.clone_into(&mut end.name));
        }
    }

    /// Puts the current names of `registry` in the place of old ones of kinds, inputs and outputs,
    /// each with a warning ([`super::ResolvedGraph::warnings`]). A node of an old kind lies over
    /// one of its new name.
    #[expect(clippy::missing_panics_doc, reason = "a node is its own last layer")]
    pub fn accept_old_names(&mut self, registry: &Registry) {
        let warnings = &mut self.warnings;
        for node in &mut self.nodes {
            let mut layers = std::mem::take(&mut node.replaced);
            layers.push(node.clone());
            let mut merged: Option<NodeDecl> = None;
            for mut layer in layers {
                layer.rename(registry, warnings);
                let of_kind = |node: &NodeDecl| node.kind.as_ref().map(|kind| kind.name.clone());
                match &mut merged {
                    Some(below) if of_kind(below) == of_kind(&layer) => below.lay_over(layer),
                    _ => merged = Some(layer),
                }
            }
            *node = merged.expect("a node is its own last layer");
        }
        let kinds: BTreeMap<String, &KindSpec> = self
            .nodes
            .iter()
            .filter_map(|node| {
                Some((node.name.name.clone(), registry.get(&node.kind.as_ref()?.name)?))
            })
            .collect();
        let wires = self
            .nodes
            .iter_mut()
            .flat_map(|node| node.wires.iter_mut().flat_map(|w| &mut w.from).chain(&mut node.when));
        for end in wires.chain(&mut self.outputs) {
            let Some((node, port)) = end.name.split_once('.') else { continue };
            let Some(kind) = kinds.get(node) else { continue };
            let new =
                registry.current_field(kind.kind, port, kind.outputs.iter().map(|port| port.name));
            if new != port {
                warnings.push(old_name(&end.origin, &end.name, &format!("{node}.{new}")));
                end.name = format!("{node}.{new}");
            }
        }
    }

    /// A set of a name that is there already is replaced; outputs are added; a node is changed
    /// field by field, unless it becomes another kind: then nothing of the old one stays.
    fn lay_over(&mut self, layer: GraphLayer) {
        self.scene = layer.scene.or(self.scene.take());
        let mut known = places(self.sets.iter().map(|set| &set.name));
        for set in layer.sets {
            match known.get(&set.name.name) {
                Some(&old) => self.sets[old] = set,
                None => {
                    known.insert(set.name.name.clone(), self.sets.len());
                    self.sets.push(set);
                }
            }
        }
        let mut known = places(self.nodes.iter().map(|node| &node.name));
        for node in layer.nodes {
            let same_kind = |old: &NodeDecl| {
                let names =
                    (old.kind.as_ref().map(|k| &k.name), node.kind.as_ref().map(|k| &k.name));
                names.1.is_none() || names.0 == names.1
            };
            match known.get(&node.name.name).map(|&old| &mut self.nodes[old]) {
                Some(old) if same_kind(old) => old.lay_over(node),
                Some(old) => {
                    let mut replaced = std::mem::take(&mut old.replaced);
                    replaced.push(std::mem::replace(old, node));
                    old.replaced = replaced;
                }
                None => {
                    if node.kind.is_none() {
                        let message = format!(
                            "node `{}` has no `op`, and no file above gives it one",
                            node.name.name
                        );
                        self.faults.push(|| Diagnostic::at(&node.name.origin, message));
                    }
                    known.insert(node.name.name.clone(), self.nodes.len());
                    self.nodes.push(node);
                }
            }
        }
        let mut known: BTreeSet<String> =
            self.outputs.iter().map(|output| output.name.clone()).collect();
        self.outputs
            .extend(layer.outputs.into_iter().filter(|output| known.insert(output.name.clone())));
    }
}

/// The place of each name in its list.
fn places<'a>(names: impl Iterator<Item = &'a Key>) -> BTreeMap<String, usize> {
    names.enumerate().map(|(place, key)| (key.name.clone(), place)).collect()
}

/// The warning that `old` is the old name of `new`.
pub(super) fn old_name(origin: &Origin, old: &str, new: &str) -> Diagnostic {
    let message = format!("`{old}` is an old name, which the next version does not accept");
    Diagnostic::at(origin, message).help(format!("write `{new}`"))
}

impl NodeDecl {
    /// Puts current names in the place of old ones of its kind and its inputs.
    fn rename(&mut self, registry: &Registry, warnings: &mut Vec<Diagnostic>) {
        let Some(kind) = &mut self.kind else { return };
        let new = registry.current_kind(&kind.name);
        if new != kind.name {
            warnings.push(old_name(&kind.origin, &kind.name, new));
            kind.name = new.to_owned();
        }
        let Some(spec) = registry.get(&kind.name) else { return };
        for Wire { port, .. } in &mut self.wires {
            let new = registry.current_field(
                spec.kind,
                &port.name,
                spec.inputs.iter().map(|port| port.name),
            );
            if new != port.name {
                warnings.push(old_name(&port.origin, &port.name, new));
                port.name = new.to_owned();
            }
        }
    }

    fn lay_over(&mut self, child: NodeDecl) {
        self.params.extend(child.params);
        self.each = child.each.or(self.each.take());
        self.when = child.when.or(self.when.take());
        let known = places(self.wires.iter().map(|wire| &wire.port));
        for wire in child.wires {
            match known.get(&wire.port.name) {
                Some(&old) => self.wires[old] = wire,
                None => self.wires.push(wire),
            }
        }
    }
}

fn read_parent(
    source: &Source,
    parent: &Key,
    chain: &mut Vec<PathBuf>,
) -> Result<Arc<Source>, Diagnostic> {
    let path = source.folder().join(&parent.name);
    if chain.contains(&identity(&path)) {
        let message = format!("`{}` extends itself: {}", parent.name, show_chain(chain, &path));
        return Err(Diagnostic::at(&parent.origin, message));
    }
    chain.push(identity(&path));
    let extended =
        |e| Diagnostic::at(&parent.origin, format!("{} (extended here): {e}", path.display()));
    source.may_name(&path).map_err(extended)?;
    Source::read(&path, source.reach).map_err(|fault| {
        Diagnostic::at(
            &parent.origin,
            format!("{} (extended here): {}", fault.path.display(), fault.message),
        )
    })
}

/// A path under which the same file is known again.
fn identity(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}

fn show_chain(chain: &[PathBuf], again: &Path) -> String {
    let again = identity(again);
    let names = chain.iter().skip_while(|p| **p != again).chain([&again]);
    let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    names.map(name).collect::<Vec<_>>().join(" -> ")
}

fn parse_layer(source: &Arc<Source>, faults: &mut Diagnostics) -> Option<GraphLayer> {
    let document = Raw::document(source, faults)?;
    let mut layer =
        GraphLayer { extends: None, scene: None, sets: vec![], nodes: vec![], outputs: vec![] };
    let known = ["version", "extends", "scene", "sets", "nodes", "outputs"];
    let fields = document.as_struct(Some("Graph"), &known, faults);
    let is_graph =
        document.variant().map_or(document.text().starts_with('('), |name| name == "Graph");
    if is_graph && !fields.iter().any(|(key, _)| key.name == "version") {
        let fault = Diagnostic::at(&document.variant_origin(), "`version` is missing");
        faults.push(|| fault.help(format!("begin with `Graph(version: {VERSION},`")));
    }
    for (key, value) in fields {
        match key.name.as_str() {
            "version" => check_version(&value, faults),
            "extends" => layer.extends = value.as_key(faults),
            "scene" => layer.scene = value.as_key(faults),
            "sets" => layer.sets = parse_sets(&value, faults),
            "nodes" => {
                let mut entries = value.as_map(faults);
                if let Some((name, _)) = entries.get(MAX_NODES) {
                    let message =
                        format!("wanted at most {MAX_NODES} nodes, got {}", entries.len());
                    faults.push(|| Diagnostic::at(&name.origin, message));
                    entries.truncate(MAX_NODES);
                }
                layer.nodes = entries
                    .into_iter()
                    .map(|(name, body)| parse_node(name, &body, faults))
                    .collect();
            }
            _ => layer.outputs = names(&value.as_list(faults), faults),
        }
    }
    Some(layer)
}

fn check_version(value: &Raw, faults: &mut Diagnostics) {
    if value.parse() != Some(VERSION) {
        faults.push(|| value.fault(format!("wanted version {VERSION}, got {}", value.short())));
    }
}

fn parse_sets(value: &Raw, faults: &mut Diagnostics) -> Vec<SetDecl> {
    let mut sets = Vec::new();
    for (name, members) in value.as_map(faults) {
        check_name(&name.name, &name.origin, "set", faults);
        let members = names(&members.as_list(faults), faults);
        members
            .iter()
            .for_each(|member| check_name(&member.name, &member.origin, "member", faults));
        sets.push(SetDecl { name, members });
    }
    sets
}

fn parse_node(name: Key, body: &Raw, faults: &mut Diagnostics) -> NodeDecl {
    check_name(&name.name, &name.origin, "node", faults);
    let mut node = NodeDecl {
        name,
        kind: None,
        params: vec![],
        each: None,
        when: None,
        wires: vec![],
        replaced: vec![],
    };
    for (key, value) in body.as_struct(None, &["op", "each", "when", "in"], faults) {
        match key.name.as_str() {
            "op" => match value.variant() {
                Some(kind) => {
                    node.kind = Some(Key { name: kind.to_owned(), origin: value.variant_origin() });
                    node.params = value.fields(&format!("`{kind}(parameter: value, ..)`"), faults);
                }
                None => faults
                    .push(|| value.fault(format!("wanted `Kind(..)`, got `{}`", value.short()))),
            },
            "each" => node.each = value.as_key(faults),
            "when" => node.when = value.as_key(faults),
            _ => {
                node.wires = value
                    .as_map(faults)
                    .into_iter()
                    .map(|(port, v)| parse_wire(port, &v, faults))
                    .collect()
            }
        }
    }
    node
}

fn parse_wire(port: Key, value: &Raw, faults: &mut Diagnostics) -> Wire {
    let list = value.text().starts_with('[');
    let from = if list { value.as_list(faults) } else { vec![value.clone()] };
    Wire { port, from: names(&from, faults) }
}

/// Strings, each given once.
fn names(values: &[Raw], faults: &mut Diagnostics) -> Vec<Key> {
    let mut keys: Vec<Key> = Vec::new();
    let mut seen = BTreeSet::new();
    for value in values {
        let Some(key) = value.as_key(faults) else { continue };
        if seen.insert(key.name.clone()) {
            keys.push(key);
        } else {
            faults.push(|| Diagnostic::at(&key.origin, format!("`{}` is given twice", key.name)));
        }
    }
    keys
}

/// Adds a fault unless `name` is a name: letters, digits and `_`, a letter first.
pub(super) fn check_name(name: &str, origin: &Origin, what: &str, faults: &mut Diagnostics) {
    if !is_name(name) {
        let message =
            || format!("wanted a {what} name of letters, digits and _, letter first, got `{name}`");
        faults.push(|| Diagnostic::at(origin, message()));
    }
}
