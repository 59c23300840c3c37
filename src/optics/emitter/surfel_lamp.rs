//! Surfels: the visible surface of a lamp, one small oriented disc a pixel.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::form::{Form, FormSampler, PreparedForm};
use super::gradient::{Gradient, outline_gradient};
use super::pieces::{PieceChoice, PieceSet, bounding_sphere, extent};
use super::rect_lamp::RectLamp;
use crate::optics::sampling::Points2;
use crate::optics::sampling::polygon::Outline;
use crate::tuning::tuning;

/// A small piece of emitting surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Surfel {
    /// The center: camera space, meters.
    pub point: Vec3,
    /// Unit length, on the emitting side.
    pub normal: Vec3,
    /// Square meters.
    pub area: f32,
}

impl Surfel {
    /// The square of this area and normal as two triangles, counter-clockwise as seen from the
    /// emitting side.
    pub fn square(&self) -> [[Vec3; 3]; 2] {
        let x = self.normal.any_orthonormal_vector() * (0.5 * self.area.sqrt());
        RectLamp { center: self.point, x, y: self.normal.cross(x) }.halves()
    }
}

/// The surfels with their centers mapped by `position` and their lengths multiplied by `scale`.
pub(super) fn transformed(
    surfels: &[Surfel],
    position: &dyn Fn(Vec3) -> Vec3,
    scale: f32,
) -> Vec<Surfel> {
    let moved = |p: &Surfel| Surfel {
        point: position(p.point),
        normal: p.normal,
        area: p.area * scale * scale,
    };
    surfels.iter().map(moved).collect()
}

impl Form for Vec<Surfel> {
    fn heap_bytes(&self) -> usize {
        size_of_val(self.as_slice())
    }

    fn area(&self) -> f32 {
        self.iter().map(|p| p.area).sum()
    }

    fn bounding_sphere(&self) -> Option<(Vec3, f32)> {
        bounding_sphere(self.iter().map(|p| p.point))
    }

    fn extent(&self, direction: Vec3) -> f32 {
        extent(self.iter().map(|p| p.point), direction)
    }

    /// No intersection: thinned surfels have gaps, and the pixels they come from are the lamp's own
    /// in the photo.
    fn intersect(&self, _: Vec3, _: Vec3) -> Option<f32> {
        None
    }

    fn triangles(&self) -> Vec<[Vec3; 3]> {
        self.iter().flat_map(Surfel::square).collect()
    }

    fn prepare(&self) -> Option<Box<dyn PreparedForm>> {
        let valid = self.iter().filter(|p| p.point.is_finite() && p.normal.is_finite());
        Some(Box::new(PreparedSurfels(PieceSet::new(
            valid.map(|surfel| (*surfel, f64::from(surfel.area))),
        ))))
    }
}

struct PreparedSurfels(PieceSet<Surfel>);

impl PreparedForm for PreparedSurfels {
    fn irradiance(&self, _: usize, point: DVec3, normal: DVec3) -> Option<f64> {
        Some(self.0.few()?.iter().map(|surfel| contribution(surfel, point, normal).1).sum())
    }

    fn sampler_at(
        &self,
        _: usize,
        point: DVec3,
        normal: DVec3,
    ) -> Option<Box<dyn FormSampler + '_>> {
        let choice = self.0.choice(|surfel| contribution(surfel, point, normal).1)?;
        Some(Box::new(SurfelSampler { point, normal, choice }))
    }

    fn gradient(&self, _: usize, point: DVec3, normal: DVec3, pivot: DVec3) -> Gradient {
        let surfels = self.0.pieces.iter();
        surfels.map(|p| gradient(p, point, normal, pivot)).fold(Gradient::default(), Gradient::plus)
    }
}

struct SurfelSampler<'a> {
    point: DVec3,
    normal: DVec3,
    choice: PieceChoice<'a, Surfel>,
}

impl FormSampler for SurfelSampler<'_> {
    fn sample(&self, points: &Points2, i: usize) -> Option<(DVec3, f64)> {
        let (surfel, inverse, _) = self.choice.at(points.get(i)[0]);
        let (position, irradiance) = contribution(surfel, self.point, self.normal);
        Some((position, irradiance * inverse))
    }
}

tuning! {
    /// Constants of lamps that consist of surfels.
    pub const TUNING: SurfelLampTuning {
        /// Distance up to which a surfel is a square, of which only the part above the horizon
        /// counts.
        near: f64 = 8.0,
            unit "the square's edge", source Derived("beyond it the disc differs from the square by less than 1 %"),
            effect "a larger value is slower and more exact";
    }
}

/// The position of a surfel's sample, and its irradiance over pi. A distant one is a small disc at
/// its center, cos cos' A / (pi d^2 + A).
fn contribution(surfel: &Surfel, point: DVec3, normal: DVec3) -> (DVec3, f64) {
    let (center, front, area) =
        (surfel.point.as_dvec3(), surfel.normal.as_dvec3(), f64::from(surfel.area));
    let d = center - point;
    let distance_squared = d.length_squared();
    let facing = -front.dot(d);
    if facing <= 0.0 {
        return (center, 0.0);
    }
    if distance_squared > TUNING.near * TUNING.near * area {
        let cosines = normal.dot(d).max(0.0) * facing / distance_squared;
        return (center, cosines * area / (PI * distance_squared + area));
    }
    let Some(outline) = Outline::above(&square(front, area).map(|corner| d + corner), normal)
    else {
        return (center, 0.0);
    };
    let edges = outline.edges();
    let middle = edges.iter().map(|edge| edge.start).sum::<DVec3>() / edges.len() as f64;
    (point + middle, outline.irradiance(normal))
}

/// The corners of a surfel's square about its center, counter-clockwise as seen from the emitting
/// side.
fn square(front: DVec3, area: f64) -> [DVec3; 4] {
    let front = front.normalize();
    let x = front.any_orthonormal_vector();
    let (x, y) = (x * (0.5 * area.sqrt()), front.cross(x) * (0.5 * area.sqrt()));
    [-x - y, x - y, x + y, y - x]
}

/// The gradient of [`contribution`].
fn gradient(surfel: &Surfel, point: DVec3, normal: DVec3, pivot: DVec3) -> Gradient {
    let (front, area) = (surfel.normal.as_dvec3(), f64::from(surfel.area));
    let d = surfel.point.as_dvec3() - point;
    let (facing, distance_squared) = (-front.dot(d), d.length_squared());
    if facing <= 0.0 {
        return Gradient::default();
    }
    if distance_squared <= TUNING.near * TUNING.near * area {
        let outline = Outline::above(&square(front, area).map(|corner| d + corner), normal);
        return outline
            .map_or(Gradient::default(), |outline| outline_gradient(&outline, normal, pivot));
    }
    let cos = normal.dot(d);
    if cos <= 0.0 {
        return Gradient::default();
    }
    // E = N A / D with N = cos facing, D = d^2 (pi d^2 + A).
    let (above, disc) = (cos * facing, PI * distance_squared + area);
    let below = distance_squared * disc;
    let by_above = normal * facing - front * cos;
    let by_below = d * (4.0 * PI * distance_squared + 2.0 * area);
    let value = above * area / below;
    let position = (by_above * area - value * by_below) / below;
    let by_area = above * PI / (disc * disc);
    Gradient {
        value,
        position,
        size: 2.0 * area * by_area + position.dot(d - pivot),
        ..Gradient::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Emitter, Lamp, Shape, estimate};

    #[test]
    fn many_surfels_are_sampled_to_the_same_sum() {
        let surfel = |i: usize| Surfel {
            point: Vec3::new((i as f32 * 0.618).fract(), 1.0, (i as f32 * 0.755).fract()),
            normal: Vec3::NEG_Y,
            area: 1e-3,
        };
        let emitter = Emitter::new(&Shape::Lamp(Lamp::Surfels((0..1000).map(surfel).collect())));
        assert!(emitter.irradiance(0, Vec3::ZERO, Vec3::Y).is_none());
        let exact: f64 = (0..1000).map(|i| contribution(&surfel(i), DVec3::ZERO, DVec3::Y).1).sum();
        let mean = (0..500)
            .map(|pixel| estimate(&emitter, 0, (Vec3::ZERO, Vec3::Y), 8, 1, pixel).0)
            .sum::<f64>()
            / 500.0;
        // 32 of 1000 surfels whose contributions differ by a factor of 9: 5 % a pixel, 0.3 % over
        // 500.
        assert!((mean / exact - 1.0).abs() < 0.01, "{mean} {exact}");
    }
}
