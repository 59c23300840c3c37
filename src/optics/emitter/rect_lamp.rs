//! The rectangle: a ceiling panel.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::form::{Form, PreparedForm};
use super::sides::Sides;
use crate::optics::sampling::rectangle::Rectangle;

/// A rectangle that emits from the side to which `x cross y` points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RectLamp {
    /// Camera space, meters.
    pub center: Vec3,
    /// Half edge, meters.
    pub x: Vec3,
    /// Half edge, meters, orthogonal to `x`.
    pub y: Vec3,
}

impl RectLamp {
    /// The rectangle in double precision; `None` without area or with a number that is not finite.
    pub(super) fn rectangle(&self) -> Option<Rectangle> {
        Rectangle::new(self.center, self.x, self.y)
    }

    /// The two triangles, counter-clockwise as seen from the emitting side.
    pub(in crate::optics) fn halves(&self) -> [[Vec3; 3]; 2] {
        let corner = |u: f32, v: f32| self.center + u * self.x + v * self.y;
        [
            [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0)],
            [corner(-1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
        ]
    }

    /// The rectangle with its center mapped by `position` and its lengths multiplied by `scale`.
    pub(super) fn transformed(&self, position: &dyn Fn(Vec3) -> Vec3, scale: f32) -> RectLamp {
        RectLamp { center: position(self.center), x: self.x * scale, y: self.y * scale }
    }
}

impl Form for RectLamp {
    fn area(&self) -> f32 {
        4.0 * self.x.cross(self.y).length()
    }

    fn bounding_sphere(&self) -> Option<(Vec3, f32)> {
        let RectLamp { center, x, y } = self;
        Some((*center, (*x + *y).length().max((*x - *y).length())))
    }

    fn extent(&self, direction: Vec3) -> f32 {
        self.x.dot(direction).abs() + self.y.dot(direction).abs()
    }

    fn intersect(&self, origin: Vec3, ray: Vec3) -> Option<f32> {
        let RectLamp { x, y, .. } = *self;
        let center = self.center - origin;
        let normal = x.cross(y);
        let facing = normal.dot(ray);
        let t = normal.dot(center) / facing;
        let at = ray * t - center;
        let within = at.dot(x).abs() <= x.length_squared() && at.dot(y).abs() <= y.length_squared();
        (facing < 0.0 && t > 0.0 && within).then_some(t)
    }

    fn triangles(&self) -> Vec<[Vec3; 3]> {
        self.halves().to_vec()
    }

    fn prepare(&self) -> Option<Box<dyn PreparedForm>> {
        Some(Box::new(Sides(self.rectangle().into_iter().collect())))
    }
}
