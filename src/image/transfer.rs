//! Transfer functions between stored numbers and linear light.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

/// Transfer function of a photo. Both sides are 0..1 within a display's range; larger values pass
/// through the same curve, and negative ones are mirrored, so that decoding and encoding are
/// inverse everywhere.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Transfer {
    /// The piecewise curve of IEC 61966-2-1.
    Srgb,
    /// value = linear^(1/gamma).
    Gamma(f32),
    /// The numbers are linear already (EXR, HDR).
    Linear,
}

impl Transfer {
    /// Exponents that a parameter may name.
    pub const GAMMA: RangeInclusive<f32> = 0.1..=10.0;

    /// From a stored number to linear light.
    pub fn decode(self, value: f32) -> f32 {
        let v = value.abs();
        let linear = match self {
            Transfer::Srgb if v <= 0.04045 => v / 12.92,
            Transfer::Srgb => ((v + 0.055) / 1.055).powf(2.4),
            Transfer::Gamma(gamma) => v.powf(gamma),
            Transfer::Linear => v,
        };
        linear.copysign(value)
    }

    /// From linear light to a stored number.
    pub fn encode(self, linear: f32) -> f32 {
        let l = linear.abs();
        let value = match self {
            Transfer::Srgb if l <= 0.003_130_8 => l * 12.92,
            Transfer::Srgb => 1.055 * l.powf(1.0 / 2.4) - 0.055,
            Transfer::Gamma(gamma) => l.powf(1.0 / gamma),
            Transfer::Linear => l,
        };
        value.copysign(linear)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Transfer; 4] =
        [Transfer::Srgb, Transfer::Gamma(2.2), Transfer::Gamma(1.8), Transfer::Linear];

    #[test]
    fn known_values() {
        // sRGB: 0.5 is 0.21404 linear; the two pieces meet at 0.04045 / 12.92.
        assert!((Transfer::Srgb.decode(0.5) - 0.214_041).abs() < 1e-6);
        assert!((Transfer::Srgb.decode(0.04045) - 0.003_130_8).abs() < 1e-7);
        assert!((Transfer::Gamma(2.0).decode(0.5) - 0.25).abs() < 1e-7);
        for transfer in ALL {
            assert_eq!(transfer.decode(0.0), 0.0);
            assert!((transfer.decode(1.0) - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn both_ways_are_inverse() {
        for transfer in ALL {
            for step in -2000..=4000 {
                let value = step as f32 / 1000.0;
                let back = transfer.encode(transfer.decode(value));
                // Two powf of relative error 1e-7 each, the exponent 2.4 times it; the published
                // constants of the sRGB join leave a step of 3e-8.
                assert!(
                    (back - value).abs() <= 2e-6 * value.abs().max(0.1),
                    "{transfer:?} {value} {back}"
                );
            }
        }
    }

    #[test]
    fn eight_bits_come_back_exactly() {
        for transfer in ALL {
            for value in 0..=255u8 {
                let back = transfer.encode(transfer.decode(f32::from(value) / 255.0)) * 255.0;
                assert_eq!(back.round() as u8, value, "{transfer:?}");
            }
        }
    }
}
