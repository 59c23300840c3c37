//! The direction of gravity for a camera that looks up or down.

use glam::Vec3;

use crate::image::Normal;
use crate::tuning::tuning;

tuning! {
    /// Constants of the search for the direction of gravity.
    pub const TUNING: GravityTuning {
        /// Largest number of normals that are sampled.
        max_normals: usize = 2000,
            unit "normals", source Derived("enough for a fraction of a degree"),
            effect "a larger value is slower and more exact";
        /// Angle from a wall's or floor's direction beyond which a normal gets no weight.
        tolerance: f32 = 10.0,
            unit "degrees", source Derived("the noise of a depth camera"),
            effect "a larger value lets slanted surfaces turn the room";
        /// Largest pitch of the search.
        max_pitch: f32 = 35.0,
            unit "degrees", source Taste, effect "a larger value finds steeper cameras and takes longer";
        /// Steps of the second search on either side of the best pitch of the first.
        fine_steps: i32 = 10,
            unit "steps", source Derived("a step of the first search is 1 degree"),
            effect "a smaller value misses the best pitch";
        /// Step of the second search.
        fine_step: f32 = 0.1,
            unit "degrees", source Taste, effect "a smaller value is slower and more exact";
        /// Weight of the preference for a small pitch: a wall that faces the camera does not
        /// determine it.
        prior: f32 = 0.1,
            unit "1", source Taste, effect "a larger value keeps cameras level";
        /// Least weight of the normals that agree with a pitch.
        min_agreement: f32 = 0.3,
            unit "fraction of the normals", source Taste, effect "a larger value keeps cameras level";
        /// Least ratio of that weight to the weight without a pitch.
        min_gain: f32 = 1.02,
            unit "1", source Taste, effect "a larger value keeps cameras level";
    }
}

/// The world's up in camera space, for a camera that may be pitched but is not rolled: the unit
/// direction across x that floors and ceilings face and walls are orthogonal to.
///
/// The pitch that most normals agree with: each counts 1 - (a / 10 degrees)^2, a being its angle to
/// that direction or to the plane across it. A roll is not looked for: a bed or a roof that slopes
/// sideways would pass for one, and photos are held level. Exactly +y when less than 30 % of the
/// normals' weight agrees with any pitch, or hardly more than with none.
pub fn world_up(normal: &Normal) -> Vec3 {
    let pixels = normal.0.pixels();
    let normals: Vec<Vec3> =
        pixels.iter().step_by(pixels.len().div_ceil(TUNING.max_normals).max(1)).copied().collect();
    let reach = TUNING.tolerance.to_radians().sin();
    let direction =
        |degrees: f32| Vec3::new(0.0, degrees.to_radians().cos(), degrees.to_radians().sin());
    // Small angles: the sine stands for the angle.
    let off = |up: Vec3, n: Vec3| n.dot(up).abs().min(n.cross(up).length());
    let score = |degrees: f32| -> f32 {
        let up = direction(degrees);
        // A wall that faces the camera does not determine the pitch: of equals, the smallest.
        let prior = (1.0 - TUNING.prior) + TUNING.prior * up.y;
        prior * normals.iter().map(|&n| (1.0 - (off(up, n) / reach).powi(2)).max(0.0)).sum::<f32>()
    };
    let best = |tried: &mut dyn Iterator<Item = f32>| {
        tried
            .map(|degrees| (score(degrees), degrees))
            .fold((0.0, 0.0), |a, b| if b.0 > a.0 { b } else { a })
    };
    let (_, coarse) =
        best(&mut (0..=2 * TUNING.max_pitch as i32).map(|i| i as f32 - TUNING.max_pitch));
    let (found, pitch) = best(
        &mut (-TUNING.fine_steps..=TUNING.fine_steps).map(|i| coarse + TUNING.fine_step * i as f32),
    );
    if found > TUNING.min_agreement * normals.len() as f32 && found > TUNING.min_gain * score(0.0) {
        direction(pitch)
    } else {
        Vec3::Y
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Plane;
    use glam::Mat3;

    /// Normals of a room whose up is `up`: counts of floor, back wall, side wall and clutter, with
    /// `noise` on each.
    fn room(up: Vec3, counts: [usize; 4], noise: f32) -> Normal {
        let back = (Vec3::new(0.3, 0.0, 1.0) - up * up.z).normalize();
        let back = (back - up * up.dot(back)).normalize();
        let mut state = 7u32;
        let mut number = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        let mut random = || Vec3::new(number(), number(), number());
        let mut normals = Vec::new();
        for (count, n) in counts.into_iter().zip([Some(up), Some(back), Some(up.cross(back)), None])
        {
            for _ in 0..count {
                let n = n.unwrap_or_else(&mut random).normalize();
                normals.push((n + noise * random()).normalize());
            }
        }
        Normal(Plane::new(normals.len(), 1, normals))
    }

    #[test]
    fn a_pitched_camera_is_found_through_noise_and_clutter() {
        for (pitch, counts) in [
            (6.0f32, [900, 900, 600, 800]),
            (-25.0, [900, 900, 600, 800]),
            (30.0, [900, 300, 0, 800]),
            (-12.0, [0, 900, 900, 400]),
        ] {
            let up = Mat3::from_rotation_x(pitch.to_radians()) * Vec3::Y;
            let got = world_up(&room(up, counts, 0.1));
            assert!(got.angle_between(up).to_degrees() < 1.0, "{pitch}: {got} against {up}");
        }
    }

    #[test]
    fn a_level_camera_clutter_and_nothing_give_y() {
        assert_eq!(world_up(&room(Vec3::Y, [900, 900, 600, 0], 0.0)), Vec3::Y);
        assert_eq!(world_up(&room(Vec3::Y, [0, 0, 0, 3000], 0.0)), Vec3::Y);
        assert_eq!(world_up(&Normal(Plane::filled(0, 0, Vec3::Z))), Vec3::Y);
        assert_eq!(world_up(&Normal(Plane::filled(4, 4, Vec3::NAN))), Vec3::Y);
    }
}
