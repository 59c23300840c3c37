//! PLY, ASCII and binary.

use std::io::Cursor;

use glam::{Vec2, Vec3};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{
    ElementDef, Encoding, Property, PropertyAccess, PropertyAccessResult, PropertyType, ScalarType,
};

use super::{Budget, Model, SHOWN, fan};
use crate::image::Transfer;

/// One element of either kind: a vertex has numbers, a face a list.
#[derive(Default)]
struct Element {
    position: Vec3,
    normal: Vec3,
    uv: Vec2,
    /// Red, green, blue as the file has them, 0..=1 in sRGB.
    color: Vec3,
    corners: Vec<u32>,
    /// A corner below zero, or a list of no whole numbers.
    bad: bool,
}

impl PropertyAccess for Element {
    fn new() -> Element {
        Element::default()
    }

    fn set_property(&mut self, name: &str, value: Property) -> PropertyAccessResult {
        if matches!(name, "vertex_indices" | "vertex_index") {
            let whole: Option<Vec<u32>> = match &value {
                Property::ListChar(v) => v.iter().map(|&i| u32::try_from(i).ok()).collect(),
                Property::ListUChar(v) => v.iter().map(|&i| Some(i.into())).collect(),
                Property::ListShort(v) => v.iter().map(|&i| u32::try_from(i).ok()).collect(),
                Property::ListUShort(v) => v.iter().map(|&i| Some(i.into())).collect(),
                Property::ListInt(v) => v.iter().map(|&i| u32::try_from(i).ok()).collect(),
                Property::ListUInt(v) => Some(v.clone()),
                _ => None,
            };
            self.bad = whole.is_none();
            self.corners = whole.unwrap_or_default();
            return PropertyAccessResult::Set;
        }
        let number = match value {
            Property::Char(v) => v.into(),
            Property::UChar(v) => v.into(),
            Property::Short(v) => v.into(),
            Property::UShort(v) => v.into(),
            Property::Int(v) => v as f32,
            Property::UInt(v) => v as f32,
            Property::Float(v) => v,
            Property::Double(v) => v as f32,
            _ => return PropertyAccessResult::Ignored,
        };
        // Whole numbers fill their type; others are shares already.
        let whole = match value {
            Property::UChar(_) => 255.0,
            Property::UShort(_) => 65535.0,
            _ => 1.0,
        };
        let slot = match name {
            "x" => &mut self.position.x,
            "y" => &mut self.position.y,
            "z" => &mut self.position.z,
            "nx" => &mut self.normal.x,
            "ny" => &mut self.normal.y,
            "nz" => &mut self.normal.z,
            "u" | "s" | "texture_u" => &mut self.uv.x,
            "v" | "t" | "texture_v" => &mut self.uv.y,
            "red" | "diffuse_red" => return set(&mut self.color.x, number / whole),
            "green" | "diffuse_green" => return set(&mut self.color.y, number / whole),
            "blue" | "diffuse_blue" => return set(&mut self.color.z, number / whole),
            _ => return PropertyAccessResult::Ignored,
        };
        *slot = number;
        PropertyAccessResult::Set
    }
}

fn set(slot: &mut f32, value: f32) -> PropertyAccessResult {
    *slot = value;
    PropertyAccessResult::Set
}

/// Property names of vertex colors.
const COLORS: [[&str; 3]; 2] =
    [["red", "green", "blue"], ["diffuse_red", "diffuse_green", "diffuse_blue"]];

fn linear(color: Vec3) -> Vec3 {
    let share = |c: f32| if c.is_finite() { Transfer::Srgb.decode(c.clamp(0.0, 1.0)) } else { 0.0 };
    Vec3::from_array(color.to_array().map(share))
}

/// Elements that are read at a time: a file of one-byte elements would otherwise take 70 times its
/// size.
const AT_A_TIME: usize = 1 << 16;

/// The least bytes that an element takes.
fn least(element: &ElementDef, encoding: Encoding) -> usize {
    let size = |kind: &ScalarType| match kind {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    };
    let least = element.properties.values().map(|property| match (encoding, &property.data_type) {
        // A digit and its separator.
        (Encoding::Ascii, _) => 2,
        (_, PropertyType::Scalar(kind) | PropertyType::List(kind, _)) => size(kind),
    });
    // The last line may end without a line end.
    least.sum::<usize>().saturating_sub(usize::from(encoding == Encoding::Ascii)).max(1)
}

/// Reads a model from PLY, text or binary.
///
/// # Errors
/// The file cannot be used; the message states the wanted and the actual content.
pub fn read(bytes: &[u8]) -> Result<Model, String> {
    let bad = |e: &dyn std::fmt::Display| {
        let message: String = e.to_string().chars().take(SHOWN).collect();
        format!("wanted a valid PLY file: {message}")
    };
    let mut input = Reader::new(Cursor::new(bytes));
    let parser = Parser::<Element>::new();
    let header = parser.read_header(&mut input).map_err(|e| bad(&e))?;
    let mut budget = Budget::new(bytes.len());
    let mut model = Model::default();
    let mut claimed = 0usize;
    for (name, element) in &header.elements {
        // A count beyond the file's end is an error before anything is allocated.
        claimed =
            claimed.saturating_add(element.count.saturating_mul(least(element, header.encoding)));
        if claimed > bytes.len() {
            return Err(bad(&format!(
                "{} elements `{name}` in {} bytes",
                element.count,
                bytes.len()
            )));
        }
        let colored = COLORS
            .iter()
            .any(|names| names.iter().all(|name| element.properties.contains_key(*name)));
        if name == "vertex" {
            budget.take(element.count, 0)?;
            model.positions.reserve_exact(element.count);
            model.normals.reserve_exact(element.count);
            model.uvs.reserve_exact(element.count);
            model.colors.reserve_exact(if colored { element.count } else { 0 });
        }
        let mut some = element.clone();
        for first in (0..element.count).step_by(AT_A_TIME) {
            some.count = AT_A_TIME.min(element.count - first);
            let elements =
                parser.read_payload_for_element(&mut input, &some, &header).map_err(|e| bad(&e))?;
            match name.as_str() {
                "vertex" => {
                    model.positions.extend(elements.iter().map(|e| e.position));
                    model.normals.extend(elements.iter().map(|e| e.normal));
                    model.uvs.extend(elements.iter().map(|e| e.uv));
                    if colored {
                        model.colors.extend(elements.iter().map(|e| linear(e.color)));
                    }
                }
                "face" => {
                    if let Some(at) = elements.iter().position(|e| e.bad) {
                        return Err(bad(&format!(
                            "face {}: wanted whole numbers from 0",
                            first + at
                        )));
                    }
                    budget.take(
                        0,
                        elements.iter().map(|e| e.corners.len().saturating_sub(2)).sum(),
                    )?;
                    model.triangles.extend(elements.iter().flat_map(|e| fan(&e.corners)));
                }
                _ => {}
            }
        }
    }
    Ok(model)
}
