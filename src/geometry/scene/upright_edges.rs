//! The direction of gravity by the upright edges of a photo: door frames, corners, shelves and
//! curtains are parallel to it, and meet in its vanishing point.

use glam::{Vec2, Vec3};

use crate::geometry::Camera;
use crate::image::Plane;
use crate::tuning::tuning;

tuning! {
    /// Constants of the search for upright edges.
    pub const TUNING: UprightEdgesTuning {
        /// Fraction of the pixels, those of the steepest brightness, that are taken for edges.
        edges: f32 = 0.2,
            unit "fraction of all pixels", source Taste, effect "a larger value admits grain";
        /// Largest angle of an edge from the columns of the photo.
        from_column: f32 = 30.0,
            unit "degrees", source Taste, effect "a larger value admits edges of the floor";
        /// Angle between an edge and the vanishing point beyond which it gets no weight.
        tolerance: f32 = 3.0,
            unit "degrees", source Derived("the noise of a gradient over 3 pixels"), effect "a larger value is less exact";
        /// Largest roll and pitch of the search.
        reach: [i32; 2] = [15, 40],
            unit "degrees", source Taste, effect "larger values find steeper cameras and take longer";
        /// Least weight of the edges that agree.
        agreement: f32 = 0.09,
            unit "fraction of the edges", source Measured("tests/plausibility.rs"), effect "a larger value finds a direction in fewer photos";
        /// Least number of edges.
        count: usize = 300,
            unit "pixels", source Taste, effect "a larger value finds a direction in fewer photos";
    }
}

/// The edges near the columns of a photo.
pub(super) struct UprightEdges(Vec<Edge>);

/// An edge: its place at depth 1 and its unit direction in the picture, upward.
struct Edge {
    at: Vec2,
    along: Vec2,
}

impl UprightEdges {
    /// The edges of a luminance: the pixels of its steepest logarithm.
    pub fn new(photo: &Plane<f32>, camera: &Camera) -> Self {
        let (width, height) = photo.size();
        if width < 3 || height < 3 {
            return Self(Vec::new());
        }
        let brightness = photo.map(|y| y.max(1e-3).ln());
        let at = |x: usize, y: usize| brightness.get(x, y);
        let mut found = Vec::new();
        for y in 1..height - 1 {
            for x in 1..width - 1 {
                // Scharr's operator, whose direction hardly depends on the grid.
                let column = |x: usize| 3.0 * (at(x, y - 1) + at(x, y + 1)) + 10.0 * at(x, y);
                let row = |y: usize| 3.0 * (at(x - 1, y) + at(x + 1, y)) + 10.0 * at(x, y);
                let gradient = Vec2::new(column(x + 1) - column(x - 1), row(y - 1) - row(y + 1));
                found.push((gradient.length(), x, y, gradient));
            }
        }
        let kept = ((found.len() as f32 * TUNING.edges) as usize).min(found.len() - 1);
        found.select_nth_unstable_by(kept, |a, b| b.0.total_cmp(&a.0));
        let cosine = TUNING.from_column.to_radians().cos();
        let edge = |&(length, x, y, gradient): &(f32, usize, usize, Vec2)| {
            let across = gradient / length.max(f32::MIN_POSITIVE);
            let along = Vec2::new(-across.y, across.x) * across.x.signum();
            let point = camera.pixel_point(x, y, 1.0);
            (along.y > cosine).then_some(Edge { at: Vec2::new(point.x, point.y), along })
        };
        Self(found[..kept].iter().filter_map(edge).collect())
    }

    /// Fraction of the edges that point to the vanishing point of `up`, a unit vector in camera
    /// space: each counts 1 - (e / 3 degrees)^2, e being its angle to that direction.
    ///
    /// At the point (x, y) at depth 1, up = (a, b, c) is seen along (a + x c, b + y c). The room as
    /// "Manhattan world": Coughlan and Yuille, ICCV 1999.
    pub fn agreement(&self, up: Vec3) -> f32 {
        let sine = TUNING.tolerance.to_radians().sin();
        let weight = |edge: &Edge| {
            let seen = Vec2::new(up.x + edge.at.x * up.z, up.y + edge.at.y * up.z);
            let off = seen.normalize_or(Vec2::X).perp_dot(edge.along) / sine;
            (1.0 - off * off).max(0.0)
        };
        self.0.iter().map(weight).sum::<f32>() / self.0.len().max(1) as f32
    }

    /// The world's up in camera space on which most edges agree; `None` where too few do.
    pub fn up(&self) -> Option<Vec3> {
        if self.0.len() < TUNING.count {
            return None;
        }
        let direction = |(roll, pitch): (f32, f32)| {
            let (roll, pitch) = (roll.to_radians(), pitch.to_radians());
            Vec3::new(roll.sin() * pitch.cos(), roll.cos() * pitch.cos(), pitch.sin())
        };
        let best = |tried: &mut dyn Iterator<Item = (f32, f32)>| {
            tried
                .map(|angles| (self.agreement(direction(angles)), angles))
                .fold((0.0, (0.0, 0.0)), |a, b| if b.0 > a.0 { b } else { a })
        };
        let grid = |[rolls, pitches]: [i32; 2], step: f32| {
            (-rolls..=rolls).flat_map(move |roll| {
                (-pitches..=pitches).map(move |pitch| (step * roll as f32, step * pitch as f32))
            })
        };
        let (_, (roll, pitch)) = best(&mut grid(TUNING.reach, 1.0));
        let near = |(r, p): (f32, f32)| (roll + r, pitch + p);
        let (agreement, angles) = best(&mut grid([4, 4], 0.25).map(near));
        (agreement >= TUNING.agreement).then(|| direction(angles))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bars that are upright in the world, seen by a camera that is rolled and pitched.
    #[test]
    fn bars_point_up() {
        let camera = Camera::from_fov_x(320, 240, 65.0);
        for (roll, pitch) in [(0.0f32, 0.0f32), (4.0, 12.0), (-7.0, -20.0)] {
            let turn = glam::Mat3::from_rotation_z(-roll.to_radians())
                * glam::Mat3::from_rotation_x(pitch.to_radians());
            let photo = Plane::from_fn(320, 240, |x, y| {
                let ray = turn.transpose() * camera.pixel_point(x, y, 1.0);
                0.5 + 0.4 * (12.0 * ray.x / ray.z).sin()
            });
            let found = UprightEdges::new(&photo, &camera).up().expect("all edges agree");
            let angle = found.angle_between(turn * Vec3::Y).to_degrees();
            assert!(angle < 0.6, "roll {roll}, pitch {pitch}: {angle} degrees off");
        }
    }

    #[test]
    fn a_photo_without_edges_has_no_direction() {
        let camera = Camera::from_fov_x(64, 48, 65.0);
        for value in [0.5, f32::NAN] {
            assert_eq!(UprightEdges::new(&Plane::filled(64, 48, value), &camera).up(), None);
        }
        let tiny = Camera::from_fov_x(2, 2, 65.0);
        assert_eq!(UprightEdges::new(&Plane::filled(2, 2, 0.5), &tiny).up(), None);
    }
}
