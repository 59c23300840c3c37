//! From a graph file, an overlay and the registry to a graph that is ready to run.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, VecDeque};
use std::io::Read;
use std::path::PathBuf;

use petgraph::graph::DiGraph;

use super::file::{GraphFile, NodeDecl, Overlay, Target, Wire, check_name};
use super::network::{Feed, Graph, GraphNode, Input, Instance, Take};
use super::registry::{AnyNode, KindSpec, Registry};
use super::source::{Fault, Key, MAX_FAULTS, Origin, Raw, holds_non_finite};
use super::{Arity, Digest, File, MAX_FILE_BYTES, PortSpec, key};

/// Members of each set, in order.
type Sets = BTreeMap<String, Vec<String>>;

/// One end of a wire: a node by its place in the file, and one of its output ports.
struct End<'a> {
    node: usize,
    port: usize,
    named: &'a Key,
}

/// The wires of one node, by input port; `None` where there is no wire.
type Wired<'a> = Vec<Option<Vec<End<'a>>>>;

impl GraphFile {
    /// Looks up kinds, ports and files, sets all parameters, and makes one instance per node, or per node and member.
    /// All faults come at once.
    pub fn resolve(&self, registry: &Registry, overlay: &Overlay) -> Result<Graph, Vec<Fault>> {
        let mut faults = self.faults.clone();
        let sets = self.merged_sets(overlay, &mut faults);
        let kinds: Vec<Option<&KindSpec>> = self.nodes.iter().map(|n| kind_of(n, registry, &mut faults)).collect();
        self.check_targets(registry, overlay, &mut faults);

        let mut digests = FileDigests::default();
        let mut built = Vec::new();
        for (decl, kind) in self.nodes.iter().zip(&kinds) {
            built.push(kind.and_then(|kind| build(decl, kind, registry, overlay, &mut digests, &mut faults)));
        }
        let mut wired = Vec::new();
        for (decl, kind) in self.nodes.iter().zip(&kinds) {
            wired.push(kind.map(|kind| self.wire(decl, kind, &kinds, &sets, &mut faults)).unwrap_or_default());
        }
        let order = self.order(&wired, &mut faults);
        for output in &self.outputs {
            self.end(output, &kinds, &mut faults);
        }

        if !faults.is_empty() {
            return Err(distinct(faults));
        }
        let nodes = built.into_iter().map(|node| node.expect("a node that was not built left a fault")).collect();
        let settings = overlay.settings.iter().map(|setting| setting.value.clone()).collect();
        Ok(Graph { settings, ..self.expand(nodes, &wired, &order, &sets) })
    }

    fn merged_sets(&self, overlay: &Overlay, faults: &mut Vec<Fault>) -> Sets {
        let names = |members: &[Key]| members.iter().map(|m| m.name.clone()).collect();
        let mut sets: Sets = self.sets.iter().map(|s| (s.name.name.clone(), names(&s.members))).collect();
        for member in &overlay.members {
            let key = Key { name: member.name.clone(), origin: member.origin.clone() };
            check_name(&key, "member", faults);
            if let Some(members) = sets.get_mut(&member.set) {
                if members.contains(&member.name) {
                    let message = format!("set `{}` already has a member `{}`", member.set, member.name);
                    faults.push(Fault::at(&member.origin, message));
                } else {
                    members.push(member.name.clone());
                }
            }
        }
        sets
    }

    fn check_targets(&self, registry: &Registry, overlay: &Overlay, faults: &mut Vec<Fault>) {
        for setting in &overlay.settings {
            match &setting.target {
                Target::Kind(kind) if registry.get(kind).is_none() => {
                    let fault = setting.value.fault(format!("there is no kind of node `{kind}`"));
                    faults.push(fault.suggest(kind, registry.kinds().map(|k| k.kind)));
                }
                Target::Node(name) if self.nodes.iter().all(|n| n.name.name != *name) => {
                    let fault = setting.value.fault(format!("the graph has no node `{name}`"));
                    faults.push(fault.suggest(name, self.node_names()));
                }
                _ => {}
            }
        }
    }

    fn node_names(&self) -> impl Iterator<Item = &str> {
        self.nodes.iter().map(|n| n.name.name.as_str())
    }

    /// Looks up `node` or `node.port`. `None` left a fault, here or at the node's kind.
    fn end<'a>(&self, named: &'a Key, kinds: &[Option<&KindSpec>], faults: &mut Vec<Fault>) -> Option<End<'a>> {
        let (node_name, port_name) = match named.name.split_once('.') {
            Some((node, port)) => (node, Some(port)),
            None => (named.name.as_str(), None),
        };
        let Some(node) = self.nodes.iter().position(|n| n.name.name == node_name) else {
            let fault = Fault::at(&named.origin, format!("there is no node `{node_name}`"));
            faults.push(fault.suggest(node_name, self.node_names()));
            return None;
        };
        let kind = kinds[node]?;
        let list = || kind.outputs.iter().map(|p| format!("{node_name}.{}", p.name)).collect::<Vec<_>>().join(", ");
        let port = match port_name {
            Some(name) => kind.outputs.iter().position(|p| p.name == name).ok_or_else(|| {
                let message = format!("node `{node_name}` ({}) has no output `{name}`", kind.kind);
                Fault::at(&named.origin, message).suggest(name, kind.outputs.iter().map(|p| p.name))
            }),
            None if kind.outputs.len() == 1 => Ok(0),
            None => {
                let message = format!("node `{node_name}` ({}) has {} outputs", kind.kind, kind.outputs.len());
                Err(Fault::at(&named.origin, message).help(format!("name one: {}", list())))
            }
        };
        let port = port.map_err(|fault| faults.push(fault)).ok()?;
        Some(End { node, port, named })
    }

    fn wire<'a>(
        &self,
        decl: &'a NodeDecl,
        kind: &KindSpec,
        kinds: &[Option<&KindSpec>],
        sets: &Sets,
        faults: &mut Vec<Fault>,
    ) -> Wired<'a> {
        let name = &decl.name.name;
        if let Some(each) = &decl.each {
            if !sets.contains_key(&each.name) {
                let fault = Fault::at(&each.origin, format!("there is no set `{}`", each.name));
                faults.push(fault.suggest(&each.name, sets.keys().map(String::as_str)));
            }
            if let Some(port) = kind.outputs.iter().find(|p| p.arity == Arity::Many) {
                let message =
                    format!("{} gives one `{}` per member by itself, so it has no `each`", kind.kind, port.name);
                faults.push(Fault::at(&each.origin, message));
            }
        }
        let mut all_known = true;
        for wire in &decl.wires {
            if !kind.inputs.iter().any(|p| p.name == wire.port.name) {
                let message = format!("node `{name}` ({}) has no input `{}`", kind.kind, wire.port.name);
                let fault = Fault::at(&wire.port.origin, message);
                faults.push(fault.suggest(&wire.port.name, kind.inputs.iter().map(|p| p.name)));
                all_known = false;
            }
        }
        let mut wired = Vec::new();
        for port in &kind.inputs {
            let wire = decl.wires.iter().find(|w| w.port.name == port.name);
            let empty = wire.is_none_or(|w| w.from.is_empty());
            // A wire to a misspelt port is the fault, not the port without it.
            if empty && all_known && (port.arity == Arity::One || (port.arity == Arity::Many && wire.is_none())) {
                let message = format!(
                    "node `{name}` ({}): nothing is wired to input `{}` ({})",
                    kind.kind, port.name, port.type_name
                );
                faults.push(Fault::at(&decl.name.origin, message));
            }
            let ends = wire.map(|wire| {
                let ends: Vec<End> = wire.from.iter().filter_map(|from| self.end(from, kinds, faults)).collect();
                self.check_wire(decl, kind, port, wire, &ends, kinds, sets, faults);
                ends
            });
            wired.push(ends);
        }
        wired
    }

    /// Types and arity of the wires to one port.
    #[expect(clippy::too_many_arguments, reason = "a wire is judged by both of its ends and the sets they run over")]
    fn check_wire(
        &self,
        decl: &NodeDecl,
        kind: &KindSpec,
        port: &PortSpec,
        wire: &Wire,
        ends: &[End],
        kinds: &[Option<&KindSpec>],
        sets: &Sets,
        faults: &mut Vec<Fault>,
    ) {
        let input = format!("input `{}` of node `{}` ({})", port.name, decl.name.name, kind.kind);
        if port.arity != Arity::Many
            && let Some(second) = wire.from.get(1)
        {
            faults.push(Fault::at(&second.origin, format!("{input} wanted one wire, got {}", wire.from.len())));
        }
        let no_members = Vec::new();
        let members = |each: &Option<Key>| each.as_ref().and_then(|e| sets.get(&e.name)).unwrap_or(&no_members).clone();
        let mut seen: Vec<String> = Vec::new();
        for end in ends {
            let Some(from_kind) = kinds[end.node] else { continue };
            let from = &self.nodes[end.node];
            let from_port = &from_kind.outputs[end.port];
            let place = &end.named.origin;
            if port.type_name != from_port.type_name {
                let message =
                    format!("{input} wanted {}, got {} from `{}`", port.type_name, from_port.type_name, end.named.name);
                faults.push(Fault::at(place, message));
                continue;
            }
            let many = match &from.each {
                Some(each) => Some(format!("one per member of `{}`", each.name)),
                None => (from_port.arity == Arity::Many).then(|| "one per member".to_owned()),
            };
            match (port.arity, many) {
                (Arity::Many, None) => {
                    let message = format!("{input} wanted one {} per member, got a single one", port.type_name);
                    faults.push(Fault::at(place, message));
                }
                (Arity::Many, Some(_)) if from.each.is_some() => {
                    for member in members(&from.each) {
                        if seen.contains(&member) {
                            faults.push(Fault::at(place, format!("{input} gets the member `{member}` twice")));
                        }
                        seen.push(member);
                    }
                }
                (Arity::One | Arity::Optional, Some(many)) if decl.each.is_none() => {
                    let message = format!("{input} wanted one {}, got {many}", port.type_name);
                    faults.push(Fault::at(place, message).help("give the node an `each`"));
                }
                (Arity::One, Some(_)) if from.each.is_some() => {
                    let there = members(&from.each);
                    for member in members(&decl.each).iter().filter(|m| !there.contains(m)) {
                        let message =
                            format!("{input} wanted one for member `{member}`, `{}` has none", from.name.name);
                        faults.push(Fault::at(place, message));
                    }
                }
                _ => {}
            }
        }
    }

    /// Nodes in an order in which each comes after what it takes from, otherwise as declared. Cycles are faults.
    fn order(&self, wired: &[Wired], faults: &mut Vec<Fault>) -> Vec<usize> {
        let mut graph = DiGraph::<usize, ()>::new();
        let indices: Vec<_> = (0..wired.len()).map(|node| graph.add_node(node)).collect();
        let mut waits = vec![0; wired.len()];
        for (to, ports) in wired.iter().enumerate() {
            for end in ports.iter().flatten().flatten() {
                graph.add_edge(indices[end.node], indices[to], ());
                waits[to] += 1;
            }
        }
        for component in petgraph::algo::tarjan_scc(&graph) {
            let first = component.iter().copied().min().expect("a component has a node");
            if component.len() > 1 || graph.contains_edge(first, first) {
                let names: Vec<&str> =
                    shortest_loop(&graph, first).iter().map(|&node| self.nodes[node].name.name.as_str()).collect();
                let message = format!("these nodes wait for each other: {}", names.join(" -> "));
                faults.push(Fault::at(&self.nodes[graph[first]].name.origin, message));
            }
        }
        let mut ready: BinaryHeap<_> = (0..wired.len()).filter(|&n| waits[n] == 0).map(Reverse).collect();
        let mut order = Vec::new();
        while let Some(Reverse(node)) = ready.pop() {
            order.push(node);
            for next in graph.neighbors(indices[node]) {
                waits[next.index()] -= 1;
                if waits[next.index()] == 0 {
                    ready.push(Reverse(next.index()));
                }
            }
        }
        order
    }

    /// One instance per node, or per node and member, and the feeds between them.
    fn expand(&self, built: Vec<Built>, wired: &[Wired], order: &[usize], sets: &Sets) -> Graph {
        let members =
            |node: usize| self.nodes[node].each.as_ref().map(|each| sets.get(&each.name).expect("checked").as_slice());
        let mut nodes: Vec<GraphNode> = built.into_iter().zip(&self.nodes).map(|(b, decl)| b.into_node(decl)).collect();
        let mut instances: Vec<Instance> = Vec::new();
        for &node in order {
            let start = instances.len();
            let own: Vec<Option<&String>> = members(node).map_or(vec![None], |m| m.iter().map(Some).collect());
            for member in own {
                let inputs = nodes[node].inputs.iter().zip(&wired[node]).map(|(port, ends)| {
                    let ends = ends.as_deref().unwrap_or_default();
                    let feeds = ends.iter().flat_map(|end| {
                        let from = &nodes[end.node];
                        let scatters = from.outputs[end.port].arity == Arity::Many;
                        let range = from.instances.clone();
                        let of_member = |m| members(end.node).and_then(|all| all.iter().position(|n| n == m));
                        let (chosen, take) = match (member, port.arity) {
                            (_, Arity::Many) if scatters => (range, Take::All),
                            (Some(m), Arity::One | Arity::Optional) if scatters => (range, Take::Member(m.clone())),
                            (Some(m), Arity::One | Arity::Optional) if from.each.is_some() => {
                                let own = of_member(m).map_or(0..0, |at| range.start + at..range.start + at + 1);
                                (own, Take::Whole)
                            }
                            _ => (range, Take::Whole),
                        };
                        chosen.map(move |instance| Feed { instance, port: end.port, take: take.clone() })
                    });
                    let mut feeds: Vec<Feed> = feeds.collect();
                    match port.arity {
                        Arity::Many => Input::Many(feeds),
                        _ => feeds.pop().map_or(Input::Missing, Input::One),
                    }
                });
                let inputs: Vec<Input> = inputs.collect();
                let mut from: Vec<usize> = inputs.iter().flat_map(Input::feeds).map(|feed| feed.instance).collect();
                from.sort_unstable();
                from.dedup();
                let name = match member {
                    Some(member) => format!("{}[{member}]", nodes[node].name),
                    None => nodes[node].name.clone(),
                };
                instances.push(Instance { name: name.into(), node, member: member.cloned(), inputs, from });
            }
            nodes[node].instances = start..instances.len();
        }
        let outputs = self.outputs.iter().map(|o| o.name.clone()).collect();
        Graph { nodes, instances, outputs, sources: self.sources.clone(), settings: Vec::new() }
    }
}

fn kind_of<'a>(decl: &NodeDecl, registry: &'a Registry, faults: &mut Vec<Fault>) -> Option<&'a KindSpec> {
    let kind = decl.kind.as_ref()?;
    let found = registry.get(&kind.name);
    if found.is_none() {
        let fault = Fault::at(&kind.origin, format!("there is no kind of node `{}`", kind.name));
        faults.push(fault.suggest(&kind.name, registry.kinds().map(|k| k.kind)));
    }
    found
}

/// Each fault once: a setting for a kind is tried on every node of it.
fn distinct(faults: Vec<Fault>) -> Vec<Fault> {
    let mut distinct: Vec<Fault> = Vec::new();
    let count = faults.len();
    for (i, fault) in faults.into_iter().enumerate() {
        if distinct.len() == MAX_FAULTS {
            let path = fault.path.clone();
            distinct.push(Fault::file(&path, format!("and up to {} faults more", count - i)));
            break;
        }
        if !distinct.contains(&fault) {
            distinct.push(fault);
        }
    }
    distinct
}

/// The shortest way from `first` back to itself.
fn shortest_loop(graph: &DiGraph<usize, ()>, first: petgraph::graph::NodeIndex) -> Vec<usize> {
    let mut came_from = BTreeMap::new();
    let mut queue = VecDeque::from([first]);
    while let Some(at) = queue.pop_front() {
        for next in graph.neighbors(at) {
            if next == first {
                let mut path = vec![graph[first]];
                let mut back = at;
                while back != first {
                    path.push(graph[back]);
                    back = came_from[&back];
                }
                path.push(graph[first]);
                path.reverse();
                return path;
            }
            came_from.entry(next).or_insert_with(|| {
                queue.push_back(next);
                at
            });
        }
    }
    vec![graph[first]]
}

/// A node with all its parameters set and its files read.
struct Built {
    kind: &'static str,
    op: Box<dyn AnyNode>,
    inputs: Vec<PortSpec>,
    outputs: Vec<PortSpec>,
    key_head: String,
    files: Vec<(File, Digest)>,
}

impl Built {
    fn into_node(self, decl: &NodeDecl) -> GraphNode {
        let Built { kind, op, inputs, outputs, key_head, files } = self;
        let each = decl.each.as_ref().map(|e| e.name.clone());
        GraphNode { name: decl.name.name.clone(), kind, each, op, inputs, outputs, key_head, files, instances: 0..0 }
    }
}

fn build(
    decl: &NodeDecl,
    kind: &KindSpec,
    registry: &Registry,
    overlay: &Overlay,
    digests: &mut FileDigests,
    faults: &mut Vec<Fault>,
) -> Option<Built> {
    let before = faults.len();
    let mut sound = true;
    let mut op = (kind.make)();
    for file in op.files().into_iter().filter(|file| !file.path.is_empty()) {
        file.base = Some(registry.library.as_ref().map_or_else(PathBuf::new, |(folder, _)| folder.clone()));
    }
    // Where each parameter was last set, and where each file was named.
    let mut set_at: BTreeMap<String, Origin> = BTreeMap::new();
    let mut named_at: Vec<(File, Origin)> = Vec::new();
    let from_file = decl.params.iter().map(|(key, value)| (key.name.as_str(), &key.origin, value));
    let from_overlay = overlay.settings.iter().filter(|s| match &s.target {
        Target::Kind(name) => name == kind.kind,
        Target::Node(name) => *name == decl.name.name,
    });
    let from_overlay = from_overlay.map(|s| (s.field.as_str(), &s.value.origin, &s.value));
    for (field, place, value) in from_file.chain(from_overlay) {
        if let Err(fault) = set(&mut *op, kind, field, place, value) {
            if !faults.iter().any(|told| told.is_inside(&value.origin)) {
                faults.push(fault);
            }
            sound = false;
            continue;
        }
        set_at.insert(field.to_owned(), value.origin.clone());
        // A file with a folder may name further ones.
        loop {
            let known = named_at.len();
            for file in op.files() {
                if file.base.is_none() && !file.path.is_empty() {
                    value.origin.source.adopt(file);
                    named_at.push((file.clone(), value.origin.clone()));
                }
            }
            if named_at.len() == known {
                break;
            }
        }
    }
    if !sound {
        return None;
    }
    let declared = decl.kind.as_ref().map_or(&decl.name.origin, |k| &k.origin);
    if let Err(message) = op.check() {
        let words = |text: &str| text.split(|c: char| !c.is_alphanumeric() && c != '_').map(str::to_owned).collect();
        let words: Vec<String> = words(&message);
        let place = words.iter().find_map(|word| set_at.get(word)).unwrap_or(declared);
        faults.push(Fault::at(place, format!("node `{}` ({}): {message}", decl.name.name, kind.kind)));
    }
    let files: Vec<File> = op.files().into_iter().map(|file| file.clone()).collect();
    let mut read = Vec::new();
    for file in files {
        let named = named_at.iter().rev().find(|(f, _)| *f == file).map(|(_, origin)| origin);
        match digests.of(&file) {
            Ok(digest) => read.push((file, digest)),
            // The stage said what it lacks.
            Err(_) if file.path.is_empty() && faults.len() > before => {}
            Err(message) => {
                let message = format!("node `{}` ({}): {message}", decl.name.name, kind.kind);
                let fault = Fault::at(named.unwrap_or(declared), message);
                let help = registry.library.as_ref().filter(|_| named.is_none() && !file.path.is_empty());
                faults.push(help.into_iter().fold(fault, |fault, (_, help)| fault.help(help)));
            }
        }
    }
    if faults.len() > before {
        return None;
    }
    let mut anonymous = op.boxed_clone();
    for (file, (_, digest)) in anonymous.files().into_iter().zip(&read) {
        file.path = format!("{}{digest}", key::FILE);
    }
    let key_head = key::head(kind.kind, kind.version, &anonymous.values());
    let (inputs, outputs) = (kind.inputs.clone(), kind.outputs.clone());
    Some(Built { kind: kind.kind, op, inputs, outputs, key_head, files: read })
}

fn set(op: &mut dyn AnyNode, kind: &KindSpec, field: &str, place: &Origin, value: &Raw) -> Result<(), Fault> {
    let Some(spec) = kind.params.iter().find(|p| p.name == field) else {
        let fault = Fault::at(place, format!("{} has no parameter `{field}`", kind.kind));
        return Err(fault.suggest(field, kind.params.iter().map(|p| p.name)));
    };
    let wanted = || format!("parameter `{field}` of {} wanted {}", kind.kind, spec.type_name);
    if let Some(Err(error)) = op.set(field, value.text()) {
        // RON takes the `6` of `6.4` for an integer and stumbles over the rest: what was wanted says more.
        let detail = match error.code {
            ron::Error::TrailingCharacters => String::new(),
            _ => format!(": {}", error.code),
        };
        return Err(Fault { message: format!("{}, got `{}`{detail}", wanted(), value.short()), ..value.locate(error) });
    }
    let is_finite = op.values().iter().all(|(name, ron)| *name != field || !holds_non_finite(ron));
    if is_finite {
        Ok(())
    } else {
        Err(value.fault(format!("{} with finite numbers, got `{}`", wanted(), value.short())))
    }
}

/// Digests of files by place and confinement, so that a file that many nodes read is read once.
#[derive(Default)]
struct FileDigests(BTreeMap<(PathBuf, Option<PathBuf>), Result<Digest, String>>);

impl FileDigests {
    fn of(&mut self, file: &File) -> Result<Digest, String> {
        if file.path.is_empty() {
            return Err("wanted a file, and nothing names it".to_owned());
        }
        let digest = self.0.entry((file.location(), file.within.clone())).or_insert_with_key(|(path, _)| {
            let cannot = |e: std::io::Error| format!("{} cannot be read: {e}", path.display());
            let mut hasher = blake3::Hasher::new();
            let opened = file.open().map_err(cannot)?;
            hasher.update_reader(opened.take(MAX_FILE_BYTES)).map_err(cannot)?;
            Ok(Digest(*hasher.finalize().as_bytes()))
        });
        digest.clone()
    }
}
