//! From a graph file, an overlay and the registry to a graph that is ready to run.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap, VecDeque};
use std::ffi::OsString;
use std::io::Read;
use std::path::PathBuf;
use std::sync::Arc;

use petgraph::graph::DiGraph;

use super::artifact::{Artifact, Flag};
use super::diagnostics::Diagnostics;
use super::file::{GraphFile, NodeDecl, Overlay, Setting, Target, Wire, check_name, old_name};
use super::raw::{Key, Raw, holds_non_finite};
use super::registry::{AnyNode, KindSpec, Registry};
use super::resolved_graph::{Edge, GraphNode, Input, InputSelector, Instance, ResolvedGraph};
use super::source::{Diagnostic, Origin, path_help};
use super::{Arity, Digest, File, MAX_FILE_BYTES, PortSpec, key};

/// Most instances of nodes and wires between them; a thousand lights come to some ten thousand.
const MAX_SIZE: usize = 1_000_000;

type Sets = BTreeMap<String, Members>;

/// The members of a set, in order.
#[derive(Default, PartialEq)]
struct Members {
    names: Vec<String>,
    places: BTreeMap<String, usize>,
}

impl Members {
    /// Whether the name is new.
    fn add(&mut self, name: &str) -> bool {
        let is_new = !self.places.contains_key(name);
        if is_new {
            self.places.insert(name.to_owned(), self.names.len());
            self.names.push(name.to_owned());
        }
        is_new
    }
}

/// One end of a wire: a node by its place in the file, and one of its output ports.
#[derive(Clone, Copy)]
struct End {
    node: usize,
    port: usize,
}

/// The wires of one node.
#[derive(Default)]
struct Wired {
    /// By input port; `None` without a wire.
    ports: Vec<Option<Vec<End>>>,
    when: Option<End>,
}

impl Wired {
    fn ends(&self) -> impl Iterator<Item = &End> {
        self.ports.iter().flatten().flatten().chain(&self.when)
    }
}

/// Results of resolving a graph file that hold for other overlays too: digests of files, and nodes
/// and wires by their declarations.
///
/// Makes the cost of a frame of a sequence proportional to its changes. It belongs to one graph
/// file and one registry.
#[derive(Default)]
pub struct Resolved {
    digests: FileDigests,
    nodes: Vec<Option<Built>>,
    wiring: Option<Wiring>,
}

struct Wiring {
    sets: Sets,
    wired: Vec<Wired>,
    order: Vec<usize>,
}

impl GraphFile {
    /// Looks up kinds, ports and files, sets all parameters, and makes one instance per node, or
    /// per node and member. All faults come at once.
    ///
    /// # Errors
    /// All faults of the files and settings, and files that cannot be read.
    pub fn resolve(
        &self,
        registry: &Registry,
        overlay: &Overlay,
    ) -> Result<ResolvedGraph, Vec<Diagnostic>> {
        self.resolve_next(registry, overlay, &mut Resolved::default())
    }

    /// Resolves one of many overlays; `before` holds the results of those before it.
    ///
    /// # Errors
    /// The errors of [`GraphFile::resolve`].
    pub fn resolve_next(
        &self,
        registry: &Registry,
        overlay: &Overlay,
        before: &mut Resolved,
    ) -> Result<ResolvedGraph, Vec<Diagnostic>> {
        self.check(registry, overlay, before)?;
        let settings = overlay.settings.iter().map(|setting| setting.value.clone()).collect();
        let of_nodes = before.nodes.iter().flatten().flat_map(|built| &built.warnings);
        let mut warnings = self.warnings.clone();
        for setting in &overlay.settings {
            if let Target::Kind(kind) = &setting.target
                && registry.current_kind(kind) != kind
            {
                warnings.push(old_name(&setting.value.origin, kind, registry.current_kind(kind)));
            }
        }
        for warning in of_nodes {
            if !warnings.contains(warning) {
                warnings.push(warning.clone());
            }
        }
        Ok(ResolvedGraph { settings, warnings, ..self.expand(before) })
    }

    /// The faults of [`GraphFile::resolve_next`] without its graph.
    ///
    /// # Errors
    /// The errors of [`GraphFile::resolve`].
    pub fn check(
        &self,
        registry: &Registry,
        overlay: &Overlay,
        before: &mut Resolved,
    ) -> Result<(), Vec<Diagnostic>> {
        let mut faults = self.faults.clone();
        let sets = self.merged_sets(overlay, &mut faults);
        let kinds: Vec<Option<&KindSpec>> =
            self.nodes.iter().map(|n| kind_of(n, registry, &mut faults)).collect();
        let places: BTreeMap<&str, usize> = self.node_names().zip(0..).collect();
        self.check_targets(registry, overlay, &places, &mut faults);

        let Resolved { digests, nodes, wiring } = before;
        let settings = Settings::new(overlay, registry);
        nodes.resize_with(self.nodes.len(), || None);
        for ((decl, kind), node) in self.nodes.iter().zip(&kinds).zip(nodes) {
            let Some(kind) = kind else { continue };
            let settings = settings.of(kind.kind, &decl.name.name);
            if !node.as_ref().is_some_and(|built| built.is_made_of(&settings)) {
                *node = build(decl, kind, registry, &settings, digests, &mut faults);
            }
        }
        if wiring.as_ref().is_none_or(|known| known.sets != sets) {
            *wiring = self.wiring(&kinds, &places, sets, &mut faults);
        }
        if faults.is_empty() { Ok(()) } else { Err(faults.into_vec()) }
    }

    /// All wires between nodes. `None` left a fault.
    fn wiring(
        &self,
        kinds: &[Option<&KindSpec>],
        places: &BTreeMap<&str, usize>,
        sets: Sets,
        faults: &mut Diagnostics,
    ) -> Option<Wiring> {
        let before = faults.found();
        if !self.is_small(&sets, |_| 0, faults) {
            return None;
        }
        let mut wired = Vec::new();
        for (decl, kind) in self.nodes.iter().zip(kinds) {
            wired.push(
                kind.map(|kind| self.wire(decl, kind, kinds, places, &sets, faults))
                    .unwrap_or_default(),
            );
        }
        let order = self.order(&wired, faults);
        for output in &self.outputs {
            self.end(output, kinds, places, faults);
        }
        if faults.found() > before {
            return None;
        }
        let width = |(port, ends): (&PortSpec, &Option<Vec<End>>)| match port.arity {
            Arity::Many => ends.iter().flatten().map(|end| self.count(end.node, &sets)).sum(),
            Arity::One | Arity::Optional => 1,
        };
        let wires = |node: usize| {
            kinds[node]
                .map_or(0, |kind| kind.inputs.iter().zip(&wired[node].ports).map(width).sum())
        };
        self.is_small(&sets, wires, faults).then_some(Wiring { sets, wired, order })
    }

    /// The number of instances of a node.
    fn count(&self, node: usize, sets: &Sets) -> usize {
        let each = self.nodes[node].each.as_ref();
        each.map_or(1, |each| sets.get(&each.name).map_or(0, |members| members.names.len()))
    }

    /// Whether there are few enough instances, each with as many wires as `wires` has for its node;
    /// else it is a fault.
    fn is_small(
        &self,
        sets: &Sets,
        wires: impl Fn(usize) -> usize,
        faults: &mut Diagnostics,
    ) -> bool {
        let of_node = |node: usize| self.count(node, sets).saturating_mul(1 + wires(node));
        let size = (0..self.nodes.len()).map(of_node).fold(0, usize::saturating_add);
        if size > MAX_SIZE {
            let message = format!(
                "wanted at most {MAX_SIZE} instances of nodes and wires between them, got {size}"
            );
            let largest = sets.iter().max_by_key(|(_, members)| members.names.len());
            let help = largest
                .map(|(set, members)| format!("set `{set}` has {} members", members.names.len()));
            faults.push(|| Diagnostic { help, ..Diagnostic::file(self.path(), message) });
        }
        size <= MAX_SIZE
    }

    fn merged_sets(&self, overlay: &Overlay, faults: &mut Diagnostics) -> Sets {
        let mut sets = Sets::new();
        for set in &self.sets {
            let members = sets.entry(set.name.name.clone()).or_default();
            set.members.iter().for_each(|member| _ = members.add(&member.name));
        }
        for member in &overlay.members {
            check_name(&member.name, &member.origin, "member", faults);
            if let Some(members) = sets.get_mut(&member.set)
                && !members.add(&member.name)
            {
                let message =
                    format!("set `{}` already has a member `{}`", member.set, member.name);
                faults.push(|| Diagnostic::at(&member.origin, message));
            }
        }
        sets
    }

    fn check_targets(
        &self,
        registry: &Registry,
        overlay: &Overlay,
        places: &BTreeMap<&str, usize>,
        faults: &mut Diagnostics,
    ) {
        for setting in &overlay.settings {
            match &setting.target {
                Target::Kind(kind) if registry.get(registry.current_kind(kind)).is_none() => faults
                    .push(|| {
                        let fault = setting.value.fault(format!("unknown kind of node `{kind}`"));
                        fault.suggest(kind, registry.kinds().map(|k| k.kind))
                    }),
                Target::Node(name) if !places.contains_key(name.as_str()) => faults.push(|| {
                    let fault = setting.value.fault(format!("the graph has no node `{name}`"));
                    fault.suggest(name, self.node_names())
                }),
                _ => {}
            }
        }
    }

    fn node_names(&self) -> impl Iterator<Item = &str> {
        self.nodes.iter().map(|n| n.name.name.as_str())
    }

    /// Looks up `node` or `node.port`. `None` left a fault, here or at the node's kind.
    fn end(
        &self,
        named: &Key,
        kinds: &[Option<&KindSpec>],
        places: &BTreeMap<&str, usize>,
        faults: &mut Diagnostics,
    ) -> Option<End> {
        let (node_name, port_name) = match named.name.split_once('.') {
            Some((node, port)) => (node, Some(port)),
            None => (named.name.as_str(), None),
        };
        let Some(&node) = places.get(node_name) else {
            faults.push(|| {
                let fault = Diagnostic::at(&named.origin, format!("unknown node `{node_name}`"));
                fault.suggest(node_name, self.node_names())
            });
            return None;
        };
        let kind = kinds[node]?;
        let list = || {
            kind.outputs
                .iter()
                .map(|p| format!("{node_name}.{}", p.name))
                .collect::<Vec<_>>()
                .join(", ")
        };
        let port = match port_name {
            Some(name) => kind.outputs.iter().position(|p| p.name == name),
            None => (kind.outputs.len() == 1).then_some(0),
        };
        if port.is_none() {
            faults.push(|| match port_name {
                Some(name) => {
                    let message =
                        format!("node `{node_name}` ({}) has no output `{name}`", kind.kind);
                    Diagnostic::at(&named.origin, message)
                        .suggest(name, kind.outputs.iter().map(|p| p.name))
                }
                None => {
                    let message = format!(
                        "node `{node_name}` ({}) has {} outputs",
                        kind.kind,
                        kind.outputs.len()
                    );
                    Diagnostic::at(&named.origin, message).help(format!("name one: {}", list()))
                }
            });
        }
        Some(End { node, port: port? })
    }

    fn wire(
        &self,
        decl: &NodeDecl,
        kind: &KindSpec,
        kinds: &[Option<&KindSpec>],
        places: &BTreeMap<&str, usize>,
        sets: &Sets,
        faults: &mut Diagnostics,
    ) -> Wired {
        let name = &decl.name.name;
        if let Some(each) = &decl.each {
            if !sets.contains_key(&each.name) {
                faults.push(|| {
                    let fault =
                        Diagnostic::at(&each.origin, format!("unknown set `{}`", each.name));
                    fault.suggest(&each.name, sets.keys().map(String::as_str))
                });
            }
            if let Some(port) = kind.outputs.iter().find(|p| p.arity == Arity::Many) {
                let message = format!(
                    "{} gives one `{}` per member by itself, so it has no `each`",
                    kind.kind, port.name
                );
                faults.push(|| Diagnostic::at(&each.origin, message));
            }
        }
        let mut all_known = true;
        for wire in &decl.wires {
            if !kind.inputs.iter().any(|p| p.name == wire.port.name) {
                faults.push(|| {
                    let message =
                        format!("node `{name}` ({}) has no input `{}`", kind.kind, wire.port.name);
                    let fault = Diagnostic::at(&wire.port.origin, message);
                    fault.suggest(&wire.port.name, kind.inputs.iter().map(|p| p.name))
                });
                all_known = false;
            }
        }
        let mut wired =
            Wired { ports: Vec::new(), when: self.when(decl, kind, kinds, places, sets, faults) };
        for port in &kind.inputs {
            let wire = decl.wires.iter().find(|w| w.port.name == port.name);
            let empty = wire.is_none_or(|w| w.from.is_empty());
            // A wire to a misspelt port is the fault, not the port without it.
            if empty
                && all_known
                && (port.arity == Arity::One || (port.arity == Arity::Many && wire.is_none()))
            {
                let message = format!(
                    "node `{name}` ({}): nothing is wired to input `{}` ({})",
                    kind.kind, port.name, port.type_name
                );
                faults.push(|| Diagnostic::at(&decl.name.origin, message));
            }
            let ends = wire.map(|wire| {
                let end = |from| Some((self.end(from, kinds, places, faults)?, from));
                let ends: Vec<(End, &Key)> = wire.from.iter().filter_map(end).collect();
                self.check_wire(decl, kind, port, wire, &ends, kinds, sets, faults);
                ends.into_iter().map(|(end, _)| end).collect()
            });
            wired.ports.push(ends);
        }
        wired
    }

    /// The output that decides whether a node runs. `None` left a fault, or there is none.
    fn when(
        &self,
        decl: &NodeDecl,
        kind: &KindSpec,
        kinds: &[Option<&KindSpec>],
        places: &BTreeMap<&str, usize>,
        sets: &Sets,
        faults: &mut Diagnostics,
    ) -> Option<End> {
        let named = decl.when.as_ref()?;
        let end = self.end(named, kinds, places, faults)?;
        let port = PortSpec { name: "when", type_name: Flag::TYPE, arity: Arity::One, doc: "" };
        let wire = Wire { port: named.clone(), from: vec![named.clone()] };
        self.check_wire(decl, kind, &port, &wire, &[(end, named)], kinds, sets, faults);
        Some(end)
    }

    /// Types and arity of the wires to one port.
    #[expect(
        clippy::too_many_arguments,
        reason = "a wire is judged by both of its ends and the sets they run over"
    )]
    fn check_wire(
        &self,
        decl: &NodeDecl,
        kind: &KindSpec,
        port: &PortSpec,
        wire: &Wire,
        ends: &[(End, &Key)],
        kinds: &[Option<&KindSpec>],
        sets: &Sets,
        faults: &mut Diagnostics,
    ) {
        let input = format!("input `{}` of node `{}` ({})", port.name, decl.name.name, kind.kind);
        if port.arity != Arity::Many
            && let Some(second) = wire.from.get(1)
        {
            let message = format!("{input} wanted one wire, got {}", wire.from.len());
            faults.push(|| Diagnostic::at(&second.origin, message));
        }
        let no_members = Members::default();
        let members = |each: &Option<Key>| {
            each.as_ref().and_then(|e| sets.get(&e.name)).unwrap_or(&no_members)
        };
        let (mut seen, mut seen_sets) = (BTreeSet::new(), BTreeSet::new());
        for (at, &(end, named)) in ends.iter().enumerate() {
            let Some(from_kind) = kinds[end.node] else { continue };
            let from = &self.nodes[end.node];
            let from_port = &from_kind.outputs[end.port];
            let place = &named.origin;
            if port.type_name != from_port.type_name {
                let (wanted, got) = (port.type_name, from_port.type_name);
                let message = format!("{input} wanted {wanted}, got {got} from `{}`", named.name);
                faults.push(|| Diagnostic::at(place, message));
                continue;
            }
            let many = match &from.each {
                Some(each) => Some(format!("one per member of `{}`", each.name)),
                None => (from_port.arity == Arity::Many).then(|| "one per member".to_owned()),
            };
            match (port.arity, many) {
                (Arity::Many, None) => {
                    let message = format!(
                        "{input} wanted one {} per member, got a single one",
                        port.type_name
                    );
                    faults.push(|| Diagnostic::at(place, message));
                }
                (Arity::Many, Some(_)) if from.each.is_some() => {
                    let is_new = seen_sets.insert(from.each.as_ref().map(|each| &each.name));
                    for member in &members(&from.each).names {
                        if !(is_new && seen.insert(member)) {
                            let message = format!("{input} gets the member `{member}` twice");
                            faults.push(|| Diagnostic::at(place, message));
                        }
                    }
                }
                (Arity::One | Arity::Optional, Some(many)) if decl.each.is_none() => {
                    let message = format!("{input} wanted one {}, got {many}", port.type_name);
                    faults.push(|| Diagnostic::at(place, message).help("give the node an `each`"));
                }
                // Several wires are a fault already, so the first alone is checked.
                (Arity::One, Some(_)) if from.each.is_some() && at == 0 => {
                    let there = &members(&from.each).places;
                    let own = &members(&decl.each).names;
                    for member in own.iter().filter(|member| !there.contains_key(*member)) {
                        let name = &from.name.name;
                        let message =
                            format!("{input} wanted one for member `{member}`, `{name}` has none");
                        faults.push(|| Diagnostic::at(place, message));
                    }
                }
                _ => {}
            }
        }
    }

    /// Topological order: each node comes after its sources, otherwise as declared. Cycles are
    /// faults.
    fn order(&self, wired: &[Wired], faults: &mut Diagnostics) -> Vec<usize> {
        let mut graph = DiGraph::<usize, ()>::new();
        let indices: Vec<_> = (0..wired.len()).map(|node| graph.add_node(node)).collect();
        let mut waits = vec![0; wired.len()];
        for (to, ports) in wired.iter().enumerate() {
            for end in ports.ends() {
                graph.add_edge(indices[end.node], indices[to], ());
                waits[to] += 1;
            }
        }
        for component in petgraph::algo::tarjan_scc(&graph) {
            let first = component.iter().copied().min().expect("a component has a node");
            if component.len() > 1 || graph.contains_edge(first, first) {
                faults.push(|| {
                    let names = shortest_loop(&graph, first)
                        .into_iter()
                        .map(|node| self.nodes[node].name.name.as_str());
                    let names = names.collect::<Vec<_>>().join(" -> ");
                    let place = &self.nodes[graph[first]].name.origin;
                    Diagnostic::at(place, format!("these nodes form a cycle: {names}"))
                });
            }
        }
        let mut ready: BinaryHeap<_> =
            (0..wired.len()).filter(|&n| waits[n] == 0).map(Reverse).collect();
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

    /// One instance per node, or per node and member, and the edges between them.
    fn expand(&self, resolved: &Resolved) -> ResolvedGraph {
        let Wiring { sets, wired, order } = resolved.wiring.as_ref().expect("it was checked");
        let members = |node: usize| {
            self.nodes[node].each.as_ref().map(|each| sets.get(&each.name).expect("checked"))
        };
        let built = resolved.nodes.iter().map(|built| built.as_ref().expect("it was checked"));
        let mut nodes: Vec<GraphNode> =
            built.zip(&self.nodes).map(|(built, decl)| built.node(decl)).collect();
        let mut instances: Vec<Instance> = Vec::new();
        for &node in order {
            let start = instances.len();
            let own: Vec<Option<&String>> =
                members(node).map_or(vec![None], |m| m.names.iter().map(Some).collect());
            for member in own {
                let edges = |end: &End, arity: Arity| {
                    let own_place =
                        |m: &String| members(end.node).and_then(|all| all.places.get(m).copied());
                    edges(&nodes[end.node], end.port, arity, member, own_place)
                };
                let inputs =
                    nodes[node].inputs.iter().zip(&wired[node].ports).map(|(port, ends)| {
                        let ends = ends.as_deref().unwrap_or_default();
                        let mut edges: Vec<Edge> =
                            ends.iter().flat_map(|end| edges(end, port.arity)).collect();
                        match port.arity {
                            Arity::Many => Input::Many(edges),
                            _ => edges.pop().map_or(Input::Missing, Input::One),
                        }
                    });
                let inputs: Vec<Input> = inputs.collect();
                let when = wired[node].when.and_then(|end| edges(&end, Arity::One).pop());
                instances.push(instance(&nodes[node], node, member, inputs, when, &instances));
            }
            nodes[node].instances = start..instances.len();
        }
        let outputs = self.outputs.iter().map(|o| o.name.clone()).collect();
        ResolvedGraph {
            nodes,
            instances,
            outputs,
            sources: self.sources.clone(),
            settings: Vec::new(),
            warnings: Vec::new(),
        }
    }
}

/// The edges of one wire from `port` of the node `from` to an input of `arity`, of the instance of
/// `member`; `own_place` gives the place of a member in the set of `from`.
fn edges(
    from: &GraphNode,
    port: usize,
    arity: Arity,
    member: Option<&String>,
    own_place: impl Fn(&String) -> Option<usize>,
) -> Vec<Edge> {
    let scatters = from.outputs[port].arity == Arity::Many;
    let range = from.instances.clone();
    let (chosen, selector) = match (member, arity) {
        (_, Arity::Many) if scatters => (range, InputSelector::All),
        (Some(m), Arity::One | Arity::Optional) if scatters => {
            (range, InputSelector::Member(m.clone()))
        }
        (Some(m), Arity::One | Arity::Optional) if from.each.is_some() => (
            own_place(m).map_or(0..0, |at| range.start + at..range.start + at + 1),
            InputSelector::Whole,
        ),
        _ => (range, InputSelector::Whole),
    };
    chosen.map(|instance| Edge { instance, port, selector: selector.clone() }).collect()
}

/// The instance of `member` of the node at `place`; `before` are those that it may take from.
fn instance(
    node: &GraphNode,
    place: usize,
    member: Option<&String>,
    inputs: Vec<Input>,
    when: Option<Edge>,
    before: &[Instance],
) -> Instance {
    let needed = node.inputs.iter().zip(&inputs).filter(|(port, _)| port.arity == Arity::One);
    let needed = needed.flat_map(|(_, input)| input.edges()).map(|edge| edge.instance);
    let conditions = needed.filter(|&from| !before[from].conditions.is_empty());
    let conditions = sorted(conditions.chain(when.iter().map(|when| when.instance)));
    let from = inputs.iter().flat_map(Input::edges).map(|edge| edge.instance);
    let from = sorted(from.chain(conditions.iter().copied()));
    let name =
        member.map_or_else(|| node.name.clone(), |member| format!("{}[{member}]", node.name));
    Instance {
        name: name.into(),
        node: place,
        member: member.cloned(),
        inputs,
        when,
        conditions,
        from,
    }
}

/// Each once, ascending.
fn sorted(instances: impl Iterator<Item = usize>) -> Vec<usize> {
    let mut all: Vec<usize> = instances.collect();
    all.sort_unstable();
    all.dedup();
    all
}

fn kind_of<'a>(
    decl: &NodeDecl,
    registry: &'a Registry,
    faults: &mut Diagnostics,
) -> Option<&'a KindSpec> {
    let kind = decl.kind.as_ref()?;
    let found = registry.get(&kind.name);
    if found.is_none() {
        faults.push(|| {
            let fault =
                Diagnostic::at(&kind.origin, format!("unknown kind of node `{}`", kind.name));
            fault.suggest(&kind.name, registry.kinds().map(|k| k.kind))
        });
    }
    found
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

/// The settings of an overlay, by their targets.
struct Settings<'a> {
    all: &'a [Setting],
    of_kind: BTreeMap<&'a str, Vec<usize>>,
    of_node: BTreeMap<&'a str, Vec<usize>>,
}

impl<'a> Settings<'a> {
    fn new(overlay: &'a Overlay, registry: &Registry) -> Settings<'a> {
        let mut settings =
            Settings { all: &overlay.settings, of_kind: BTreeMap::new(), of_node: BTreeMap::new() };
        for (place, setting) in overlay.settings.iter().enumerate() {
            let (targets, name) = match &setting.target {
                Target::Kind(kind) => (&mut settings.of_kind, registry.current_kind(kind)),
                Target::Node(node) => (&mut settings.of_node, node.as_str()),
            };
            targets.entry(name).or_default().push(place);
        }
        settings
    }

    /// The settings of one node, in order.
    fn of(&self, kind: &str, node: &str) -> Vec<&'a Setting> {
        let mut places = [self.of_kind.get(kind), self.of_node.get(node)]
            .into_iter()
            .flatten()
            .flatten()
            .collect::<Vec<_>>();
        places.sort_unstable();
        places.into_iter().map(|&place| &self.all[place]).collect()
    }
}

/// A node with all its parameters set and its files read.
struct Built {
    /// The settings of the overlay that are in it.
    settings: Vec<(String, Raw)>,
    kind: &'static str,
    op: Box<dyn AnyNode>,
    inputs: Vec<PortSpec>,
    outputs: Vec<PortSpec>,
    key_head: String,
    files: Vec<(File, Digest)>,
    /// Old names of its parameters.
    warnings: Vec<Diagnostic>,
}

impl Built {
    /// Whether it would come out of these settings too: the same texts, and the same folder for
    /// files that they name.
    fn is_made_of(&self, settings: &[&Setting]) -> bool {
        let same_value = |a: &Origin, b: &Origin| {
            Arc::ptr_eq(&a.source, &b.source) && a.span == b.span
                || a.source.path == b.source.path && a.text() == b.text()
        };
        let same = |((field, value), setting): (&(String, Raw), &&Setting)| {
            *field == setting.field && same_value(&value.origin, &setting.value.origin)
        };
        self.settings.len() == settings.len() && self.settings.iter().zip(settings).all(same)
    }

    fn node(&self, decl: &NodeDecl) -> GraphNode {
        GraphNode {
            name: decl.name.name.clone(),
            kind: self.kind,
            each: decl.each.as_ref().map(|e| e.name.clone()),
            op: self.op.boxed_clone(),
            inputs: self.inputs.clone(),
            outputs: self.outputs.clone(),
            key_head: self.key_head.clone(),
            files: self.files.clone(),
            instances: 0..0,
        }
    }
}

fn build(
    decl: &NodeDecl,
    kind: &KindSpec,
    registry: &Registry,
    settings: &[&Setting],
    digests: &mut FileDigests,
    faults: &mut Diagnostics,
) -> Option<Built> {
    let before = faults.found();
    let mut op = (kind.make)();
    for file in op.files().into_iter().filter(|file| !file.path.is_empty()) {
        file.base =
            Some(registry.library.as_ref().map_or_else(PathBuf::new, |(folder, _)| folder.clone()));
    }
    let places = set_all(&mut *op, decl, kind, registry, settings, faults)?;
    let declared = decl.kind.as_ref().map_or(&decl.name.origin, |k| &k.origin);
    if let Err(message) = op.check() {
        let mut words = message.split(|c: char| !c.is_alphanumeric() && c != '_');
        let value = words.find_map(|word| places.set.get(word));
        let place = value.map_or_else(|| declared.clone(), |value| place_within(value, &message));
        // A person who wrote an edit or a scene need not know the nodes that read it.
        let is_in_graph = Arc::ptr_eq(&place.source, &decl.name.origin.source);
        faults.push(|| match is_in_graph {
            true => {
                let node = format!("node `{}` ({})", decl.name.name, kind.kind);
                Diagnostic::at(&place, format!("{node}: {message}"))
            }
            false => Diagnostic::at(&place, message),
        });
    }
    let files: Vec<File> = op.files().into_iter().map(|file| file.clone()).collect();
    let mut read = Vec::new();
    for file in files {
        match digests.of(&file) {
            Ok(digest) => read.push((file, digest)),
            // `check` has reported the missing file.
            Err(_) if file.path.is_empty() && faults.found() > before => {}
            Err(message) => faults.push(|| {
                let named = places.named.get(&file).copied();
                let message = format!("node `{}` ({}): {message}", decl.name.name, kind.kind);
                let fault = Diagnostic::at(named.unwrap_or(declared), message);
                let help =
                    registry.library.as_ref().filter(|_| named.is_none() && !file.path.is_empty());
                let help = help.map(|(_, help)| help.clone()).or_else(|| path_help(&file.path));
                help.into_iter().fold(fault, Diagnostic::help)
            }),
        }
    }
    if faults.found() > before {
        return None;
    }
    let mut anonymous = op.boxed_clone();
    for (file, (_, digest)) in anonymous.files().into_iter().zip(&read) {
        file.path = format!("{}{digest}", key::FILE);
    }
    let key_head = key::head(kind.kind, kind.version, &anonymous.values());
    let (inputs, outputs) = (kind.inputs.clone(), kind.outputs.clone());
    let settings = settings.iter().map(|s| (s.field.clone(), s.value.clone())).collect();
    let warnings = places.warnings;
    Some(Built { settings, kind: kind.kind, op, inputs, outputs, key_head, files: read, warnings })
}

/// The place in a parameter's `value` that the message of a check names: after the parameter, each
/// part up to a colon may be a key of a map in quotes, or `item 2` of a list, from 1. A variant of
/// one value counts as that value.
fn place_within(value: &Raw, message: &str) -> Origin {
    let mut place = value.clone();
    let ignored = &mut Diagnostics::ignored();
    for part in message.split(": ").skip(1) {
        let mut only = if place.variant().is_some() { place.as_tuple(ignored) } else { vec![] };
        let outer = only.pop().filter(|_| only.is_empty()).unwrap_or_else(|| place.clone());
        let item = part.strip_prefix("item ").and_then(|number| number.parse::<usize>().ok());
        let inner = if part.starts_with('"') && outer.text().starts_with('{') {
            let mut entries = outer.as_map(ignored).into_iter();
            entries.find(|(key, _)| format!("{:?}", key.name) == part).map(|(_, value)| value)
        } else if let (Some(number), true) = (item, outer.text().starts_with('[')) {
            number.checked_sub(1).and_then(|at| outer.as_list(ignored).into_iter().nth(at))
        } else {
            None
        };
        let Some(inner) = inner else { break };
        place = inner;
    }
    place.origin
}

/// Places in the texts that set the parameters of a node.
#[derive(Default)]
struct ParamOrigins<'a> {
    /// The place where each parameter was last set.
    set: BTreeMap<&'a str, &'a Raw>,
    /// The place where each file was named.
    named: BTreeMap<File, &'a Origin>,
    /// Old names.
    warnings: Vec<Diagnostic>,
}

/// Sets all parameters of a node. `None` left a fault.
fn set_all<'a>(
    op: &mut dyn AnyNode,
    decl: &'a NodeDecl,
    kind: &KindSpec,
    registry: &Registry,
    settings: &[&'a Setting],
    faults: &mut Diagnostics,
) -> Option<ParamOrigins<'a>> {
    let mut sound = true;
    let mut places = ParamOrigins::default();
    let from_file = decl.params.iter().map(|(key, value)| (key.name.as_str(), &key.origin, value));
    let from_overlay = settings.iter().map(|s| (s.field.as_str(), &s.value.origin, &s.value));
    for (field, place, value) in from_file.chain(from_overlay) {
        let old = field;
        let field =
            registry.current_field(kind.kind, field, kind.params.iter().map(|param| param.name));
        if field != old {
            places.warnings.push(old_name(place, old, field));
        }
        if !set(op, kind, field, place, value, faults) {
            sound = false;
            continue;
        }
        places.set.insert(field, value);
        // A file with a folder may name further ones.
        let mut named = true;
        while named {
            named = false;
            for file in op.files() {
                if file.base.is_none() && !file.path.is_empty() {
                    value.origin.source.adopt(file);
                    places.named.insert(file.clone(), &value.origin);
                    named = true;
                }
            }
        }
    }
    sound &= is_finite(op, &places.set, faults);
    sound.then_some(places)
}

/// Sets one parameter; `false` where that is a fault.
fn set(
    op: &mut dyn AnyNode,
    kind: &KindSpec,
    field: &str,
    place: &Origin,
    value: &Raw,
    faults: &mut Diagnostics,
) -> bool {
    let Some(spec) = kind.params.iter().find(|p| p.name == field) else {
        refuse(value, faults, || {
            let fault = Diagnostic::at(place, format!("{} has no parameter `{field}`", kind.kind));
            fault.suggest(field, kind.params.iter().map(|p| p.name))
        });
        return false;
    };
    let Some(Err(_)) = op.set(field, value.text()) else { return true };
    if is_sound_so_far(value, faults) {
        spec.form.refuse(field, value, faults);
    }
    false
}

/// Whether all parameters are finite. A number too large for single precision is not, which shows
/// once it is set.
fn is_finite(op: &dyn AnyNode, set_at: &BTreeMap<&str, &Raw>, faults: &mut Diagnostics) -> bool {
    let mut finite = true;
    for (field, _) in op.values().into_iter().filter(|(_, ron)| holds_non_finite(ron)) {
        let Some(value) = set_at.get(field) else { continue };
        finite = false;
        refuse(value, faults, || {
            let message = format!("`{field}` wanted finite numbers, got `{}`", value.short());
            let place = large_number(&value.origin).unwrap_or_else(|| value.origin.clone());
            Diagnostic::at(&place, message).help("numbers reach up to 3.4e38")
        });
    }
    finite
}

/// The first number in a text that is too large for single precision.
fn large_number(value: &Origin) -> Option<Origin> {
    let is_part = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '+' | '-' | '_');
    let mut at = value.span.start;
    for word in value.text().split_inclusive(|c: char| !is_part(c)) {
        let number = word.trim_end_matches(|c: char| !is_part(c));
        if number.parse::<f32>().is_ok_and(|number| !number.is_finite()) {
            return Some(Origin { source: value.source.clone(), span: at..at + number.len() });
        }
        at += word.len();
    }
    None
}

/// A fault of a value, where none was found in it yet: a setting for a kind is tried on every node
/// of it.
fn refuse(value: &Raw, faults: &mut Diagnostics, fault: impl FnOnce() -> Diagnostic) {
    if is_sound_so_far(value, faults) {
        faults.push(fault);
    }
}

/// Whether no fault was found in a value yet.
fn is_sound_so_far(value: &Raw, faults: &Diagnostics) -> bool {
    !faults.kept().iter().any(|message| message.is_inside(&value.origin))
}

/// Digests of files by place and confinement, so that a file that many nodes read is read once.
#[derive(Default)]
struct FileDigests(BTreeMap<(OsString, Option<PathBuf>), Result<Digest, String>>);

impl FileDigests {
    fn of(&mut self, file: &File) -> Result<Digest, String> {
        if file.path.is_empty() {
            return Err("wanted a file, and nothing names it".to_owned());
        }
        let place = (file.location().into_os_string(), file.within.clone());
        let digest = self.0.entry(place).or_insert_with_key(|(path, _)| {
            let cannot = |e: std::io::Error| format!("{} cannot be read: {e}", path.display());
            let mut hasher = blake3::Hasher::new();
            let opened = file.open().map_err(cannot)?;
            hasher.update_reader(opened.take(MAX_FILE_BYTES)).map_err(cannot)?;
            Ok(Digest(*hasher.finalize().as_bytes()))
        });
        digest.clone()
    }
}
