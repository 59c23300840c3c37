//! Pixels of a light's mask, their surroundings, and their extent on a plane.

use glam::Vec3;

use crate::geometry::PlaneFit;
use crate::image::Mask;
use crate::tuning::tuning;

tuning! {
    /// Constants of the extent of a light's mask.
    pub const TUNING: MaskPixelsTuning {
        /// Fraction of a pixel that a light must exceed to own it.
        min_covered: f32 = 0.5,
            unit "1", source Taste, effect "a larger value makes lights smaller";
        /// Fraction of the largest value of a mask that suffices where it is below `min_covered`: a
        /// thin light may cover no pixel by half.
        thin_fraction: f32 = 0.999,
            unit "1", source Taste, effect "a smaller value makes thin lights wider";
        /// Fraction of the pixels that is left out at each end of an extent.
        outliers: f32 = 0.03,
            unit "1", source Derived("masks are ragged"), effect "a larger value ignores more outliers";
        /// Fraction of the pixels that remains, by which the extent is divided.
        inliers: f32 = 0.94,
            unit "1", source Derived("1 - 2 `outliers`"), effect "a larger value makes lights smaller";
        /// Least half extent: no light is a point.
        min_extent: f32 = 0.002,
            unit "fraction of the distance", source Derived("about one pixel"),
            effect "a larger value makes small lights larger";
        /// Vertical component of a plane's normal below which its upright edge is well defined.
        upright: f32 = 0.8,
            unit "1", source Taste, effect "another value changes the orientation of the rectangle only";
    }
}

/// Pixels (column, row) of the mask that a light covers by more than half.
pub(super) fn pixels_of(mask: &Mask) -> Vec<(usize, usize)> {
    let (w, h) = mask.0.size();
    // A thin light may cover no pixel by more than half at working size.
    let most = mask.0.pixels().iter().copied().fold(0.0, f32::max);
    let threshold = TUNING.min_covered.min(TUNING.thin_fraction * most);
    (0..w * h)
        .map(|i| (i % w, i / w))
        .filter(|&(x, y)| most > 0.0 && mask.0.get(x, y) > threshold)
        .collect()
}

/// Pixels (column, row) within `radius` of the mask's bounding box and outside of the mask.
pub(super) fn surroundings(mask: &Mask, radius: usize) -> Vec<(usize, usize)> {
    let pixels = pixels_of(mask);
    let (w, h) = mask.0.size();
    let range = |value: fn(&(usize, usize)) -> usize, end: usize| {
        let low = pixels.iter().map(value).min().unwrap_or(0);
        let high = pixels.iter().map(value).max().unwrap_or(0);
        low.saturating_sub(radius)..(high + radius + 1).min(end)
    };
    let (xs, ys) = (range(|p| p.0, w), range(|p| p.1, h));
    ys.flat_map(|y| xs.clone().map(move |x| (x, y)))
        .filter(|&(x, y)| mask.0.get(x, y) == 0.0)
        .collect()
}

/// Returns the upper median.
///
/// # Panics
/// There are no values.
pub(super) fn median(mut values: Vec<f32>) -> f32 {
    values.sort_by(f32::total_cmp);
    values[values.len() / 2]
}

/// Center and half edges of the rectangle on `plane` that contains the intersections with `rays`,
/// the outermost 3 % left out. One edge is level unless the plane is level itself; `x cross y` is
/// along the normal. `up` is a unit vector. `None` when no ray meets the plane.
pub(super) fn extent(rays: &[Vec3], plane: &PlaneFit, up: Vec3) -> Option<(Vec3, Vec3, Vec3)> {
    let hits: Vec<Vec3> = rays.iter().filter_map(|ray| plane.intersect(*ray)).collect();
    if hits.is_empty() {
        return None;
    }
    let n = plane.normal;
    let (x, y) = if n.dot(up).abs() < TUNING.upright {
        let x = up.cross(n).normalize();
        (x, n.cross(x))
    } else {
        let y = Vec3::Z.cross(n).cross(n).try_normalize().unwrap_or(Vec3::Z);
        (y.cross(n), y)
    };
    let range = |axis: Vec3| {
        let mut values: Vec<f32> = hits.iter().map(|p| p.dot(axis)).collect();
        values.sort_by(f32::total_cmp);
        let at = |share: f32| values[((values.len() - 1) as f32 * share) as usize];
        (at(TUNING.outliers), at(1.0 - TUNING.outliers))
    };
    let ((x0, x1), (y0, y1)) = (range(x), range(y));
    // One pixel, seen from afar, still has a size; the part left out is added back.
    let least = TUNING.min_extent * hits[0].length();
    let half = |low: f32, high: f32| (0.5 * (high - low) / TUNING.inliers).max(least);
    let center = x * (0.5 * (x0 + x1)) + y * (0.5 * (y0 + y1)) + n * plane.offset;
    Some((center, x * half(x0, x1), y * half(y0, y1)))
}
