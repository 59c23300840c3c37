//! Per-pixel lighting: incoming radiance at each part of a picture, from all directions.

use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Steps of the angle from the normal.
pub const THETAS: usize = 8;
/// Steps around the normal.
pub const PHIS: usize = 16;
/// Directions of a map.
pub const TEXELS: usize = THETAS * PHIS;

/// Incoming radiance over the hemisphere of the normal, for each cell of a grid over the picture.
///
/// Texel (i, j) of a cell, `i` slow: theta = (i + 0.5) / 8 pi / 2 from the normal,
/// phi = (j + 0.5) / 16 2 pi - pi about it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightMaps {
    /// Cells in a row of the grid.
    pub columns: usize,
    /// Rows of the grid.
    pub rows: usize,
    /// `TEXELS` for each cell, cells row by row; linear, in units of the photo. A cell with a
    /// number that is not finite is one that nothing is known of.
    pub radiance: Vec<Vec3>,
}

impl LightMaps {
    /// Solid angle of each texel; all together 2 pi.
    fn solid_angles() -> [f64; TEXELS] {
        let edge = |i: usize| (i as f64 / THETAS as f64 * std::f64::consts::FRAC_PI_2).cos();
        std::array::from_fn(|k| {
            (edge(k / PHIS) - edge(k / PHIS + 1)) * 2.0 * std::f64::consts::PI / PHIS as f64
        })
    }

    /// Mean squared difference of log(1 + radiance) over the hemisphere, by solid angle, and over
    /// the cells of which the truth is known; `None` when the grids differ or nothing is known. The
    /// per-pixel lighting error of IndoorLightEditing (Li et al., ECCV 2022).
    pub fn log_error(&self, truth: &LightMaps) -> Option<f64> {
        if (self.columns, self.rows) != (truth.columns, truth.rows) {
            return None;
        }
        let weights = Self::solid_angles();
        let of_cell = |(got, truth): (&[Vec3], &[Vec3])| -> f64 {
            let square = |got: f32, truth: f32| {
                (f64::from(got.max(0.0)).ln_1p() - f64::from(truth.max(0.0)).ln_1p()).powi(2)
            };
            let texel = |(got, truth): (&Vec3, &Vec3)| {
                (0..3).map(|c| square(got[c], truth[c])).sum::<f64>() / 3.0
            };
            let squares = got.iter().zip(truth).map(texel);
            squares.zip(weights).map(|(square, weight)| square * weight).sum::<f64>()
                / weights.iter().sum::<f64>()
        };
        let cells = self.radiance.chunks_exact(TEXELS).zip(truth.radiance.chunks_exact(TEXELS));
        let known = cells.filter(|(_, truth)| truth.iter().all(|rgb| rgb.is_finite()));
        let errors: Vec<f64> = known.map(of_cell).collect();
        (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(cells: &[f32]) -> LightMaps {
        let radiance = cells.iter().flat_map(|&v| [Vec3::splat(v); TEXELS]).collect();
        LightMaps { columns: cells.len(), rows: 1, radiance }
    }

    #[test]
    fn the_hemisphere_is_whole() {
        let sum: f64 = LightMaps::solid_angles().iter().sum();
        assert!((sum - 2.0 * std::f64::consts::PI).abs() < 1e-12);
    }

    #[test]
    fn errors_by_hand() {
        let wanted = (4.0f64.ln() - 2.0f64.ln()).powi(2);
        let got = grid(&[3.0, 7.0]).log_error(&grid(&[1.0, 7.0])).expect("one grid");
        assert!((got - wanted / 2.0).abs() < 1e-12);
        assert_eq!(
            grid(&[3.0, 7.0]).log_error(&grid(&[f32::NAN, 7.0])),
            Some(0.0),
            "the first is not known"
        );
        assert_eq!(grid(&[3.0]).log_error(&grid(&[3.0, 7.0])), None);
        assert_eq!(grid(&[3.0]).log_error(&grid(&[f32::NAN])), None);
    }

    #[test]
    fn texels_count_by_their_solid_angle() {
        let truth = grid(&[0.0]);
        let error = |row: usize| {
            let mut got = truth.clone();
            got.radiance[row * PHIS..(row + 1) * PHIS].fill(Vec3::ONE);
            got.log_error(&truth).expect("one grid")
        };
        // A belt at the horizon has sin(theta) as much as one of the same width elsewhere.
        let ratio = (7.5f64 / 8.0 * std::f64::consts::FRAC_PI_2).sin()
            / (0.5f64 / 8.0 * std::f64::consts::FRAC_PI_2).sin();
        assert!((error(7) / error(0) - ratio).abs() < 1e-9 * ratio);
    }
}
