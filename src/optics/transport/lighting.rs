//! The light that arrives at each place, direction by direction: spherical Gaussians in a local
//! frame.

use std::f32::consts::PI;

use glam::{Mat3, Vec3};
use serde::{Deserialize, Serialize};

use crate::image::rule;
use crate::optics::{LightMaps, PHIS, TEXELS, THETAS};

/// One spherical Gaussian of radiance: w exp(sharpness (axis . l - 1)), l and `axis` in the frame
/// of the cell.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LocalLobe {
    /// Unit length.
    pub axis: Vec3,
    /// Sharpness of the lobe; >= 0.
    pub sharpness: f32,
    /// Radiance along the axis, linear RGB in units of the photo.
    pub weight: Vec3,
}

/// Incoming radiance on a coarse grid of cells over the picture, rows from the top; in units of the
/// photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lighting {
    /// Cells in a row of the grid.
    pub columns: usize,
    /// Rows of the grid.
    pub rows: usize,
    /// As many for each cell, cell after cell.
    pub lobes: Vec<LocalLobe>,
}

impl Lighting {
    /// Whether each cell has as many lobes.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub fn check(&self) -> Result<(), String> {
        let cells = self.columns.checked_mul(self.rows).filter(|&cells| cells > 0);
        rule(
            cells.is_some_and(|cells| self.lobes.len().is_multiple_of(cells)),
            "as many lobes for each cell",
        )
    }

    /// The lobes of a cell.
    pub fn cell(&self, column: usize, row: usize) -> &[LocalLobe] {
        let each = self.lobes.len() / (self.columns * self.rows).max(1);
        &self.lobes[(row * self.columns + column) * each..][..each]
    }

    /// Radiance that arrives at a cell from `direction`, unit length, in its frame
    /// ([`local_frame`]).
    pub fn radiance(&self, column: usize, row: usize, direction: Vec3) -> Vec3 {
        let lobe = |l: &LocalLobe| l.weight * (l.sharpness * (l.axis.dot(direction) - 1.0)).exp();
        self.cell(column, row).iter().map(lobe).sum()
    }

    /// The hemisphere of each cell: the radiance at the middle of each texel.
    pub fn maps(&self) -> LightMaps {
        let cells =
            (0..self.rows).flat_map(|row| (0..self.columns).map(move |column| (column, row)));
        let texels: Vec<Vec3> = (0..TEXELS).map(texel).collect();
        let radiance = cells.flat_map(|(column, row)| {
            texels.iter().map(move |way| self.radiance(column, row, *way))
        });
        LightMaps { columns: self.columns, rows: self.rows, radiance: radiance.collect() }
    }
}

/// Direction of the middle of texel `i` of a hemisphere map in the local frame.
fn texel(i: usize) -> Vec3 {
    let theta = ((i / PHIS) as f32 + 0.5) / THETAS as f32 * PI / 2.0;
    let phi = ((i % PHIS) as f32 + 0.5) / PHIS as f32 * 2.0 * PI - PI;
    Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
}

/// Axes x, y, n (columns) of the local frame at a surface: y towards camera up, or ahead where the
/// normal is vertical.
pub fn local_frame(normal: Vec3) -> Mat3 {
    let up = if normal.y.abs() > 0.99 { Vec3::NEG_Z } else { Vec3::Y };
    let y = (up - up.dot(normal) * normal).normalize_or(Vec3::Y);
    Mat3::from_cols(y.cross(normal), y, normal)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_lobe_is_the_same_from_everywhere() {
        let lobe = LocalLobe { axis: Vec3::Z, sharpness: 0.0, weight: Vec3::new(1.0, 2.0, 3.0) };
        let lighting = Lighting { columns: 2, rows: 1, lobes: vec![lobe; 6] };
        assert!(lighting.maps().radiance.iter().all(|&radiance| radiance == 3.0 * lobe.weight));
    }

    #[test]
    fn frames_are_right_handed() {
        for normal in [Vec3::Z, Vec3::Y, Vec3::NEG_Y, Vec3::new(0.3, -0.5, 0.8).normalize()] {
            let frame = local_frame(normal);
            assert!((frame.determinant() - 1.0).abs() < 1e-5, "{normal}");
            assert!((frame * Vec3::Z - normal).length() < 1e-6);
        }
    }
}
