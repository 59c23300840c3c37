//! The box: a tube or a lantern.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::form::{Form, PreparedForm};
use super::rect_lamp::RectLamp;
use super::sides::Sides;

/// A box that emits outwards.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoxLamp {
    /// Camera space, meters.
    pub center: Vec3,
    /// Half edges, meters, orthogonal to each other, of either handedness.
    pub axes: [Vec3; 3],
}

impl BoxLamp {
    /// The six sides, each of which emits outwards.
    fn sides(&self) -> [RectLamp; 6] {
        let BoxLamp { center, axes: [x, y, z] } = *self;
        // The other two axes of each side, ordered so that their cross product points outwards.
        let hand = if x.cross(y).dot(z) < 0.0 { -1.0 } else { 1.0 };
        let pair = |out: Vec3, a: Vec3, b: Vec3| {
            [
                RectLamp { center: center + out, x: a * hand, y: b },
                RectLamp { center: center - out, x: b, y: a * hand },
            ]
        };
        let [[a, b], [c, d], [e, f]] = [pair(x, y, z), pair(y, z, x), pair(z, x, y)];
        [a, b, c, d, e, f]
    }

    /// The box with its center mapped by `position` and its lengths multiplied by `scale`.
    pub(super) fn transformed(&self, position: &dyn Fn(Vec3) -> Vec3, scale: f32) -> BoxLamp {
        BoxLamp { center: position(self.center), axes: self.axes.map(|axis| axis * scale) }
    }
}

impl Form for BoxLamp {
    fn area(&self) -> f32 {
        let [a, b, c] = self.axes;
        8.0 * (a.cross(b).length() + b.cross(c).length() + c.cross(a).length())
    }

    fn bounding_sphere(&self) -> Option<(Vec3, f32)> {
        let [a, b, c] = self.axes;
        Some((self.center, (a.length_squared() + b.length_squared() + c.length_squared()).sqrt()))
    }

    fn extent(&self, direction: Vec3) -> f32 {
        self.axes.iter().map(|axis| axis.dot(direction).abs()).sum()
    }

    fn intersect(&self, origin: Vec3, ray: Vec3) -> Option<f32> {
        self.sides().iter().filter_map(|side| side.intersect(origin, ray)).reduce(f32::min)
    }

    fn triangles(&self) -> Vec<[Vec3; 3]> {
        let BoxLamp { center, axes } = *self;
        let pairs = [(0, 1, 2), (1, 2, 0), (2, 0, 1)];
        let half = |(i, j, n): (usize, usize, usize), sign: f32| {
            RectLamp { center: center + sign * axes[n], x: axes[i], y: axes[j] }.halves()
        };
        pairs
            .into_iter()
            .flat_map(|pair| [1.0, -1.0].into_iter().flat_map(move |sign| half(pair, sign)))
            .collect()
    }

    fn prepare(&self) -> Option<Box<dyn PreparedForm>> {
        Some(Box::new(Sides(self.sides().iter().filter_map(RectLamp::rectangle).collect())))
    }
}
