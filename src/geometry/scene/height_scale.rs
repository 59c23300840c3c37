//! Metric depth from a height that a person knows: of the camera above the floor, or of the room.

use super::level_sides::{level_sides, patches};
use super::right_angles::right_angles;
use crate::geometry::Camera;
use crate::image::{Depth, Plane, fit, resize};
use crate::tuning::tuning;

tuning! {
    /// Constants of the scale from a known height.
    pub const TUNING: HeightScaleTuning {
        /// Height of the camera where nobody states it: of a standing person's.
        camera: f32 = 1.5,
            unit "meters", source Taste, effect "a larger value makes rooms larger";
        /// Longer side of the plane on which the shift of relative depth is searched.
        long_side: usize = 160,
            unit "pixels", source Taste, effect "a larger value is slower";
        /// Fraction of the pixels that are taken neither for the nearest nor for the farthest.
        tail: f32 = 0.05,
            unit "1", source Taste, effect "a larger value ignores more outliers";
        /// Smallest and largest ratio of the farthest to the nearest depth that is tried.
        spans: [f32; 2] = [1.3, 8.0],
            unit "1", source Measured("docs/networks.md"), effect "a wider range admits flatter and deeper rooms";
        /// Steps between them, even in their logarithm.
        steps: usize = 24,
            unit "steps", source Taste, effect "a larger value is slower and more exact";
        /// Largest depth over the farthest of the room: the view from a window.
        beyond: f32 = 4.0,
            unit "1", source Taste, effect "a larger value lets views through windows lie farther away";
    }
}

/// A height that a person knows, meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum KnownHeight {
    /// From the floor to the camera.
    Camera(f32),
    /// From the floor to the ceiling.
    Ceiling(f32),
}

impl KnownHeight {
    /// The height, meters.
    pub fn meters(self) -> f32 {
        match self {
            KnownHeight::Camera(meters) | KnownHeight::Ceiling(meters) => meters,
        }
    }
}

impl Default for KnownHeight {
    fn default() -> KnownHeight {
        KnownHeight::Camera(TUNING.camera)
    }
}

/// Meters per unit of a planar depth without holes. Pixels where `outside` is above 0 (panes, what
/// is not part of the room) do not count. All have one size.
///
/// # Errors
/// The photo does not show the floor or the ceiling, or the height is not positive.
pub fn scale_from_height(
    depth: &Depth,
    camera: &Camera,
    outside: &Plane<f32>,
    known: KnownHeight,
) -> Result<f32, String> {
    let (KnownHeight::Camera(height) | KnownHeight::Ceiling(height)) = known;
    if !(height > 0.0 && height.is_finite()) {
        return Err(format!("wanted a height above 0 m, got {height}"));
    }
    let sides = level_sides(depth, camera, outside);
    let missing = |side: &str| {
        format!("the photo does not show the {side}: wanted a known length instead of a height")
    };
    let floor = sides.floor.ok_or_else(|| missing("floor"))?;
    match known {
        KnownHeight::Camera(_) => Ok(height / floor),
        KnownHeight::Ceiling(_) => {
            Ok(height / (floor + sides.ceiling.ok_or_else(|| missing("ceiling"))?))
        }
    }
}

/// Scale and shift of relative depth: planar z = `scale` / (q + `shift`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativeScale {
    /// Meters times units of q.
    pub scale: f32,
    /// Units of q.
    pub shift: f32,
}

/// Scale and shift of relative depth `q` = a / z + b with unknown a > 0 and b, larger is nearer.
/// The shift is the one under which most surfaces meet at right angles, the scale follows from the
/// height. Planes and camera have one size.
///
/// # Errors
/// The numbers do not vary, and the errors of [`scale_from_height`].
pub fn relative_from_height(
    q: &Plane<f32>,
    camera: &Camera,
    outside: &Plane<f32>,
    known: KnownHeight,
) -> Result<RelativeScale, String> {
    let (width, height) = fit(q.width(), q.height(), TUNING.long_side);
    let (q, outside) = (resize(q, width, height), resize(outside, width, height));
    let camera = camera.resized(width, height);
    let mut sorted: Vec<f32> = q.pixels().iter().copied().filter(|q| q.is_finite()).collect();
    sorted.sort_by(f32::total_cmp);
    let at = |share: f32| sorted.get((share * sorted.len().saturating_sub(1) as f32) as usize);
    let (far, near) = match (at(TUNING.tail), at(1.0 - TUNING.tail)) {
        (Some(&far), Some(&near)) if near > far => (far, near),
        _ => return Err("wanted numbers that vary, got one number nearly everywhere".into()),
    };
    // The farthest has this number after the shift, by the ratio of the farthest to the nearest.
    let least = |span: f32| (near - far) / (span - 1.0);
    let depth = |span: f32| {
        let least = least(span);
        Depth(q.map(|q| 1.0 / (q - far + least).max(least / TUNING.beyond)))
    };
    let [first, last] = TUNING.spans.map(|span| (span - 1.0).ln());
    let spans = (0..=TUNING.steps)
        .map(|i| 1.0 + (first + (last - first) * i as f32 / TUNING.steps as f32).exp());
    let scored =
        spans.map(|span| (right_angles(&patches(&depth(span), &camera, &outside), 1.0), span));
    let (_, span) = scored.fold((-1.0, 0.0), |a, b| if b.0 > a.0 { b } else { a });
    let scale = scale_from_height(&depth(span), &camera, &outside, known)?;
    Ok(RelativeScale { scale, shift: least(span) - far })
}
