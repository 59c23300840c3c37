//! Pieces of surface, one of which is chosen with probability proportional to a weight.

use std::borrow::Cow;

use glam::{DVec3, Vec3};

use crate::geometry::bounds;
use crate::tuning::tuning;

tuning! {
    /// Constants of the choice among pieces of surface.
    pub const PIECES: PiecesTuning {
        /// Largest number of pieces that are summed one by one; a larger number is sampled.
        max_exact: usize = 512,
            unit "pieces", source Taste, effect "a larger value makes a receiver slower and its estimate less noisy";
    }
}

/// Pieces of positive, finite area.
pub(super) struct PieceSet<T> {
    pub pieces: Vec<T>,
    /// Running sum of their areas, square meters.
    areas: Vec<f64>,
}

impl<T> PieceSet<T> {
    /// The pieces of positive, finite area, each given with its area.
    pub fn new(pieces: impl Iterator<Item = (T, f64)>) -> PieceSet<T> {
        let (pieces, areas): (_, Vec<f64>) =
            pieces.filter(|(_, area)| *area > 0.0 && area.is_finite()).unzip();
        PieceSet { pieces, areas: running_sum(areas) }
    }

    /// The pieces, if they are few enough to be summed one by one.
    pub fn few(&self) -> Option<&[T]> {
        (self.pieces.len() <= PIECES.max_exact).then_some(&self.pieces)
    }

    /// The choice of a piece by its `weight`, or among many by its area; `None` where all weights
    /// are zero.
    pub fn choice(&self, weight: impl Fn(&T) -> f64) -> Option<PieceChoice<'_, T>> {
        let sums = if self.pieces.len() > PIECES.max_exact {
            Cow::Borrowed(&self.areas[..])
        } else {
            Cow::Owned(running_sum(self.pieces.iter().map(weight)))
        };
        let total = *sums.last()?;
        (total > 0.0 && total.is_finite()).then_some(PieceChoice {
            pieces: &self.pieces,
            sums,
            total,
        })
    }
}

/// The running sum of `weights`.
pub(super) fn running_sum(weights: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let add = |sum: &mut f64, weight: f64| {
        *sum += weight;
        Some(*sum)
    };
    weights.into_iter().scan(0.0, add).collect()
}

/// The index at which a fraction of a running sum ends, `target` being that fraction times the
/// total.
pub(super) fn find(sums: &[f64], target: f64) -> usize {
    sums.partition_point(|&sum| sum <= target).min(sums.len() - 1)
}

/// A choice among pieces with probability proportional to their weights.
pub(super) struct PieceChoice<'a, T> {
    pieces: &'a [T],
    /// Running sum of the weights.
    sums: Cow<'a, [f64]>,
    total: f64,
}

impl<T> PieceChoice<'_, T> {
    /// The piece at the fraction `u` of the weights, one over its probability, and the fraction of
    /// its own weight that `u` reaches, 0..=1.
    pub fn at(&self, u: f64) -> (&T, f64, f64) {
        let target = u * self.total;
        let i = find(&self.sums, target);
        let before = if i == 0 { 0.0 } else { self.sums[i - 1] };
        let weight = self.sums[i] - before;
        (&self.pieces[i], self.total / weight, ((target - before) / weight).clamp(0.0, 1.0))
    }
}

/// The sphere about the axis-aligned bounding box of `points`; `None` without points.
pub(super) fn bounding_sphere(points: impl Iterator<Item = Vec3>) -> Option<(Vec3, f32)> {
    let (low, high) = bounds(points);
    low.is_finite().then(|| (0.5 * (low + high), 0.5 * (high - low).length()))
}

/// The largest distance of `points` from the center of their axis-aligned bounding box along a unit
/// `direction`, meters.
pub(super) fn extent(points: impl Iterator<Item = Vec3> + Clone, direction: Vec3) -> f32 {
    let (low, high) = bounds(points.clone());
    let center = 0.5 * (low + high);
    points.map(|p| (p - center).dot(direction)).fold(0.0, f32::max)
}

/// Twice the area of a triangle along its normal, square meters.
pub(super) fn doubled_area([a, b, c]: &[DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// The position in a triangle of a point of the unit square, uniform over its area; the first
/// coordinate as its root.
pub(super) fn point_in_triangle(t: &[DVec3; 3], root: f64, v: f64) -> DVec3 {
    t[0] + (t[1] - t[0]) * (root * (1.0 - v)) + (t[2] - t[0]) * (root * v)
}
