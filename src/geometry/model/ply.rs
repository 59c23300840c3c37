//! PLY, ASCII and binary.

use std::io::Cursor;

use glam::{Vec2, Vec3};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{Property, PropertyAccess, PropertyAccessResult};

use super::{Model, fan};
use crate::image::Transfer;

/// One element of either kind: a vertex has numbers, a face a list.
#[derive(Default)]
struct Element {
    position: Vec3,
    normal: Vec3,
    uv: Vec2,
    /// Red, green, blue as the file has them, 0..=1 in sRGB.
    colour: Vec3,
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
            "red" | "diffuse_red" => return set(&mut self.colour.x, number / whole),
            "green" | "diffuse_green" => return set(&mut self.colour.y, number / whole),
            "blue" | "diffuse_blue" => return set(&mut self.colour.z, number / whole),
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

/// What the colours of vertices are called.
const COLOURS: [[&str; 3]; 2] = [["red", "green", "blue"], ["diffuse_red", "diffuse_green", "diffuse_blue"]];

fn linear(colour: Vec3) -> Vec3 {
    let share = |c: f32| if c.is_finite() { Transfer::Srgb.decode(c.clamp(0.0, 1.0)) } else { 0.0 };
    Vec3::from_array(colour.to_array().map(share))
}

pub fn read(bytes: &[u8]) -> Result<Model, String> {
    let bad = |e: &dyn std::fmt::Display| format!("wanted a sound PLY file: {e}");
    let mut input = Reader::new(Cursor::new(bytes));
    let parser = Parser::<Element>::new();
    let header = parser.read_header(&mut input).map_err(|e| bad(&e))?;
    let mut model = Model::default();
    for (name, element) in &header.elements {
        // No element takes less than a byte, so that a count beyond the file is a lie, told before anything is made of it.
        if element.count > bytes.len() {
            return Err(bad(&format!("{} elements `{name}` in {} bytes", element.count, bytes.len())));
        }
        let elements = parser.read_payload_for_element(&mut input, element, &header).map_err(|e| bad(&e))?;
        match name.as_str() {
            "vertex" => {
                model.positions = elements.iter().map(|e| e.position).collect();
                model.normals = elements.iter().map(|e| e.normal).collect();
                model.uvs = elements.iter().map(|e| e.uv).collect();
                if COLOURS.iter().any(|names| names.iter().all(|name| element.properties.contains_key(*name))) {
                    model.colours = elements.iter().map(|e| linear(e.colour)).collect();
                }
            }
            "face" => {
                if let Some(at) = elements.iter().position(|e| e.bad) {
                    return Err(bad(&format!("face {at}: wanted whole numbers from 0")));
                }
                model.triangles = elements.iter().flat_map(|e| fan(&e.corners)).collect();
            }
            _ => {}
        }
    }
    Ok(model)
}
