//! Inputs of an instance: the values at each port, and the key manifest made of them.

use std::sync::Arc;

use super::cache::{Entry, Header};
use super::resolved_graph::{Edge, Input, InputSelector, ResolvedGraph};
use super::{Arity, Digest, PortSpec, key};

/// A value of a result: the instance that gave it, and its index there.
#[derive(Clone, Copy)]
pub(super) struct Slot {
    pub instance: usize,
    pub index: usize,
}

/// The values at one input port.
pub(super) enum ResolvedInput {
    Missing,
    One(Slot),
    Many(Vec<(String, Slot)>),
}

/// The results that an instance takes from, by instance; none of one that its conditions left out.
pub(super) struct Before(pub Vec<(usize, Option<Arc<Entry>>)>);

impl Before {
    fn header(&self, instance: usize) -> Option<&Header> {
        let entry = self.0.iter().find(|(at, _)| *at == instance);
        let (_, entry) =
            entry.expect("the results of all instances that it takes from are gathered first");
        entry.as_ref().map(|entry| &*entry.header)
    }
}

/// Whether the condition `when` holds by the result of its instance.
pub(super) fn holds(when: &Edge, result: &Header) -> bool {
    result.port(when.port).next().is_some()
}

/// Resolves the inputs of instance `at`, port by port.
///
/// # Errors
/// A selected member does not exist, or one input receives a member twice.
pub(super) fn resolve_inputs(
    graph: &ResolvedGraph,
    at: usize,
    before: &Before,
) -> Result<Vec<ResolvedInput>, String> {
    let instance = &graph.instances[at];
    let ports = &graph.nodes[instance.node].inputs;
    let mut all = Vec::with_capacity(ports.len());
    for (port, input) in ports.iter().zip(&instance.inputs) {
        let mut many = Vec::new();
        let mut one = ResolvedInput::Missing;
        for edge in input.edges() {
            let Some(from) = before.header(edge.instance) else { continue };
            let slot = |index| Slot { instance: edge.instance, index };
            let name = |index: usize| from.values[index].member.clone().unwrap_or_default();
            match (&edge.selector, input) {
                (InputSelector::All, _) => {
                    many.extend(from.port(edge.port).map(|i| (name(i), slot(i))))
                }
                (InputSelector::Whole, Input::Many(_)) => {
                    let member = graph.instances[edge.instance].member.clone().unwrap_or_default();
                    many.extend(from.port(edge.port).map(|i| (member.clone(), slot(i))));
                }
                (InputSelector::Whole, _) => {
                    one = from
                        .port(edge.port)
                        .next()
                        .map_or(ResolvedInput::Missing, |i| ResolvedInput::One(slot(i)))
                }
                (InputSelector::Member(member), _) => {
                    let own = from
                        .port(edge.port)
                        .find(|&i| from.values[i].member.as_ref() == Some(member));
                    if own.is_none() && port.arity == Arity::One {
                        return Err(no_member(graph, port, edge, member, from));
                    }
                    one = own.map_or(ResolvedInput::Missing, |i| ResolvedInput::One(slot(i)));
                }
            }
        }
        all.push(match input {
            Input::Many(_) => {
                for (i, (member, _)) in many.iter().enumerate() {
                    if many[..i].iter().any(|(other, _)| other == member) {
                        return Err(format!(
                            "input `{}` gets the member `{member}` twice",
                            port.name
                        ));
                    }
                }
                ResolvedInput::Many(many)
            }
            _ => one,
        });
    }
    Ok(all)
}

fn no_member(
    graph: &ResolvedGraph,
    port: &PortSpec,
    edge: &Edge,
    member: &str,
    from: &Header,
) -> String {
    let node = &graph.nodes[graph.instances[edge.instance].node];
    let there: Vec<&str> =
        from.port(edge.port).filter_map(|i| from.values[i].member.as_deref()).collect();
    let there = if there.is_empty() { "none".to_owned() } else { there.join(", ") };
    let output = node.outputs[edge.port].name;
    format!(
        "input `{}` wanted the member `{member}` of `{}.{output}`, which gives: {there}",
        port.name, node.name
    )
}

/// The key manifest of instance `at`, from its inputs.
pub(super) fn key_manifest(
    graph: &ResolvedGraph,
    at: usize,
    inputs: &[ResolvedInput],
    before: &Before,
) -> String {
    let node = &graph.nodes[graph.instances[at].node];
    let mut text = String::with_capacity(node.key_head.len() + 100 * (inputs.len() + 1));
    text.push_str(&node.key_head);
    let digest = |slot: &Slot| {
        let header = before.header(slot.instance).expect("a slot stands in a result");
        Digest(header.values[slot.index].digest)
    };
    for (port, input) in node.inputs.iter().zip(inputs) {
        match input {
            ResolvedInput::Missing => key::missing_line(&mut text, port.name),
            ResolvedInput::One(slot) => {
                key::input_line(&mut text, port.name, None, port.type_name, &digest(slot))
            }
            ResolvedInput::Many(all) => {
                key::gather_line(&mut text, port.name, all.len());
                for (member, slot) in all {
                    key::input_line(
                        &mut text,
                        port.name,
                        Some(member),
                        port.type_name,
                        &digest(slot),
                    );
                }
            }
        }
    }
    text
}
