//! A cheap check of a network's file before a loader reads it. It refuses files on which loaders
//! abort or hang: lengths beyond the end of the file, deep nesting, constants that are larger than
//! their bytes, constants in other files.
//!
//! The work is linear in the bytes, and nothing is allocated. Field numbers are those of onnx.proto
//! (github.com/onnx/onnx). rten's own reader of protocol buffers cannot be used: it is the part
//! that hangs.

/// The largest file, bytes; protocol buffers have no more.
const MAX_BYTES: usize = i32::MAX as usize;
/// The most nodes, those of subgraphs included.
const MAX_NODES: usize = 100_000;
/// The deepest nesting of messages: a graph in a node takes three levels.
const MAX_DEPTH: usize = 40;

/// Messages of ONNX that contain others, or of which a field is checked.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Message {
    Model,
    Graph,
    Function,
    Node,
    Attribute,
    Tensor,
    ValueInfo,
    Type,
    /// `SequenceTypeProto` and its like, whose field 1 or 2 is a type.
    TypeOf,
    TensorType,
    Shape,
    /// A message without messages inside.
    Leaf,
    /// `SparseTensorProto`, which declares any size in a few bytes.
    Sparse,
}

use Message::*;

/// Returns the type of the message in this field; `None` for a text, bytes or packed numbers.
fn inner(message: Message, field: u64) -> Option<Message> {
    match (message, field) {
        (Model, 7) | (Attribute, 6 | 11) => Some(Graph),
        (Model, 25) => Some(Function),
        (Model, 8 | 14) | (Graph, 16) | (Function, 9) | (Tensor, 13) | (Shape, 1) => Some(Leaf),
        (Graph, 1) | (Function, 7) => Some(Node),
        (Graph, 5) | (Attribute, 5 | 10) => Some(Tensor),
        (Graph, 11..=13) | (Function, 12) => Some(ValueInfo),
        (Graph, 15) | (Attribute, 22 | 23) => Some(Sparse),
        (Node, 5) | (Function, 11) => Some(Attribute),
        (ValueInfo, 2) | (Attribute, 14 | 15) | (TypeOf, 1 | 2) => Some(Type),
        (Type, 1 | 8) => Some(TensorType),
        (Type, 4 | 5 | 9) => Some(TypeOf),
        (TensorType, 2) => Some(Shape),
        _ => None,
    }
}

/// Checks whether `bytes` may be given to a loader of ONNX.
///
/// # Errors
/// The message states the wanted and the actual content.
pub fn precheck(bytes: &[u8]) -> Result<(), String> {
    if bytes.len() > MAX_BYTES {
        return Err(format!("wanted at most {MAX_BYTES} bytes, got {}", bytes.len()));
    }
    let mut nodes = 0;
    walk(bytes, Model, 0, &mut nodes)?;
    if nodes == 0 { Err("wanted a graph with nodes, got none".into()) } else { Ok(()) }
}

fn walk(mut rest: &[u8], message: Message, depth: usize, nodes: &mut usize) -> Result<(), String> {
    if depth > MAX_DEPTH {
        return Err(format!("wanted at most {MAX_DEPTH} nested messages, got more"));
    }
    match message {
        Sparse => return Err("wanted dense constants, got a sparse one".into()),
        Node => *nodes += 1,
        _ => {}
    }
    if *nodes > MAX_NODES {
        return Err(format!("wanted at most {MAX_NODES} nodes, got more"));
    }
    let size = rest.len();
    let mut numbers: Option<u64> = Some(1);
    while !rest.is_empty() {
        let tag = varint(&mut rest)?;
        let field = tag >> 3;
        match tag & 7 {
            0 => {
                let value = varint(&mut rest)?;
                match (message, field) {
                    (Tensor, 1) => numbers = times(numbers, value),
                    (Tensor, 14) if value != 0 => {
                        return Err(
                            "wanted constants inside the file, got one in another file".into()
                        );
                    }
                    _ => {}
                }
            }
            1 => drop(take(&mut rest, 8)?),
            2 => {
                let length = varint(&mut rest)?;
                let mut bytes = take(&mut rest, length)?;
                if let Some(inner) = inner(message, field) {
                    walk(bytes, inner, depth + 1, nodes)?;
                } else if (message, field) == (Tensor, 1) {
                    while !bytes.is_empty() {
                        numbers = times(numbers, varint(&mut bytes)?);
                    }
                }
            }
            5 => drop(take(&mut rest, 4)?),
            kind => return Err(format!("wanted protocol buffers, got a field of type {kind}")),
        }
    }
    // The smallest numbers that ONNX has share a byte among four.
    match numbers {
        Some(numbers) if message != Tensor || numbers <= 8 * size as u64 => Ok(()),
        _ => Err(format!(
            "wanted constants with all their numbers, got {size} bytes for a shape of more"
        )),
    }
}

/// Multiplies a count of numbers by a dimension; `None` if no file has so many.
fn times(numbers: Option<u64>, size: u64) -> Option<u64> {
    numbers?.checked_mul(size).filter(|numbers| *numbers <= 8 * MAX_BYTES as u64)
}

fn take<'a>(rest: &mut &'a [u8], length: u64) -> Result<&'a [u8], String> {
    let taken = usize::try_from(length).ok().and_then(|length| rest.split_at_checked(length));
    let (taken, left) = taken
        .ok_or_else(|| format!("wanted {length} more bytes, the file has {} there", rest.len()))?;
    *rest = left;
    Ok(taken)
}

fn varint(rest: &mut &[u8]) -> Result<u64, String> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let byte = take(rest, 1)?[0];
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Ok(value);
        }
    }
    Err("wanted protocol buffers, got a number of more than ten bytes".into())
}
