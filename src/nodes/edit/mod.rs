//! What an edit changes.

pub mod edit_lights;
pub mod edit_materials;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::image::Transfer;

/// An albedo as a person writes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Colour {
    /// As pictures show it: `"#c8642a"`.
    Srgb(String),
    /// Linear Rec.709, 0..=1.
    Linear(f32, f32, f32),
}

impl Colour {
    /// Linear Rec.709.
    fn linear(&self) -> Result<Vec3, String> {
        match self {
            Colour::Srgb(text) => {
                let digits =
                    text.strip_prefix('#').filter(|d| d.len() == 6 && d.chars().all(|c| c.is_ascii_hexdigit()));
                let number = digits.and_then(|digits| u32::from_str_radix(digits, 16).ok());
                let number = number.ok_or_else(|| format!("Srgb: wanted a colour like \"#c8642a\", got {text:?}"))?;
                let [_, rgb @ ..] = number.to_be_bytes();
                Ok(Vec3::from_array(rgb.map(|c| Transfer::Srgb.decode(f32::from(c) / 255.0))))
            }
            &Colour::Linear(r, g, b) => {
                let colour = Vec3::new(r, g, b);
                let within = colour.cmpge(Vec3::ZERO).all() && colour.cmple(Vec3::ONE).all();
                if within { Ok(colour) } else { Err(format!("Linear: wanted 0..=1 per channel, got ({r}, {g}, {b})")) }
            }
        }
    }
}
