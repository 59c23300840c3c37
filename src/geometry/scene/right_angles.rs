//! The share of a room's surfaces that meet at right angles, under other lenses and other meanings
//! of its depth: most of a room is level or upright on two directions across each other
//! ("Manhattan world": Coughlan and Yuille, ICCV 1999), and a wrong lens bends these angles.

use glam::Vec3;

use super::level_sides::{Patches, areas};
use crate::tuning::tuning;

tuning! {
    /// Constants of the measure of right angles.
    pub const TUNING: RightAnglesTuning {
        /// Largest angle from level, from upright and from the walls' directions.
        tolerance: f32 = 6.0,
            unit "degrees", source Derived("the noise of a depth camera"), effect "a larger value tells less";
        /// Angles from the vertical within which normals turn it, one after the other.
        up_angles: [f32; 3] = [20.0, 12.0, 8.0],
            unit "degrees", source Measured("docs/room.md"), effect "larger values let slanted surfaces turn the room";
        /// Every how many patches one is taken.
        stride: usize = 7,
            unit "patches", source Derived("10,000 patches of a 320 x 240 depth"), effect "a smaller value is slower";
    }
}

/// How well the surfaces agree with right angles if the camera's tangents of view were `stretch`
/// times larger: the geometric mean of the shares of level and of upright surfaces, the latter
/// within the two most common directions across each other. 0 to 0.5.
pub(super) fn right_angles(patches: &Patches, stretch: f32) -> f32 {
    let every = |v: &[Vec3]| v.iter().copied().step_by(TUNING.stride).collect::<Vec<_>>();
    let points: Vec<Vec3> = every(&patches.points)
        .into_iter()
        .map(|p| Vec3::new(stretch * p.x, stretch * p.y, p.z))
        .collect();
    let normals: Vec<Vec3> = every(&patches.normals)
        .into_iter()
        .map(|n| Vec3::new(n.x / stretch, n.y / stretch, n.z).normalize_or(Vec3::Z))
        .collect();
    let areas = areas(&points, &normals);
    let total: f32 = areas.iter().sum();
    let sampled = Patches { points, normals, areas, unit: patches.unit };
    let up = exact_up(&sampled);
    let z = (Vec3::Z - up * up.z).normalize_or(Vec3::Z);
    let x = up.cross(z);
    let (sine, cosine) = TUNING.tolerance.to_radians().sin_cos();
    let mut level = 0.0;
    let mut upright = [0.0f32; 90];
    for (n, area) in sampled.normals.iter().zip(&sampled.areas) {
        let along = n.dot(up).abs();
        if along > cosine {
            level += area;
        } else if along < sine {
            let angle = n.dot(x).atan2(n.dot(z)).to_degrees().rem_euclid(90.0);
            upright[(angle as usize).min(89)] += area;
        }
    }
    let half = TUNING.tolerance as usize;
    let around = |at: usize| (0..2 * half + 1).map(|i| upright[(at + 90 + i - half) % 90]).sum();
    let walls: f32 = (0..90).map(around).fold(0.0, f32::max);
    (level * walls).sqrt() / total.max(f32::MIN_POSITIVE)
}

/// The direction that level surfaces face, near that of gravity, roll included.
pub(super) fn exact_up(patches: &Patches) -> Vec3 {
    let mut up = patches.up();
    for angle in TUNING.up_angles {
        let cosine = angle.to_radians().cos();
        let near =
            patches.normals.iter().zip(&patches.areas).filter(|(n, _)| n.dot(up).abs() > cosine);
        up = near.map(|(n, area)| *n * (area * n.dot(up).signum())).sum::<Vec3>().normalize_or(up);
    }
    up
}
