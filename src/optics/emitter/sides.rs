//! One-sided rectangles that do not cover each other: a panel, or the sides of a box.

use glam::DVec3;

use super::form::{FormSampler, PreparedForm};
use super::gradient::{Gradient, outline_gradient};
use crate::optics::sampling::Points2;
use crate::optics::sampling::product_sampler::ProductSampler;
use crate::optics::sampling::rectangle::Rectangle;

/// Rectangles of which those that face one point do not cover each other: one, or up to six sides
/// of a box.
pub(super) struct Sides(pub Vec<Rectangle>);

impl PreparedForm for Sides {
    fn irradiance(&self, _: usize, point: DVec3, normal: DVec3) -> Option<f64> {
        Some(self.0.iter().map(|side| side.irradiance(point, normal)).sum())
    }

    fn sampler_at(
        &self,
        _: usize,
        point: DVec3,
        normal: DVec3,
    ) -> Option<Box<dyn FormSampler + '_>> {
        Some(Box::new(SidesSampler::new(&self.0, (point, normal))?))
    }

    fn gradient(&self, _: usize, point: DVec3, normal: DVec3, pivot: DVec3) -> Gradient {
        let outlines = self.0.iter().filter_map(|side| side.outline(point, normal));
        outlines
            .map(|outline| outline_gradient(&outline, normal, pivot))
            .fold(Gradient::default(), Gradient::plus)
    }
}

/// A side, its sampler, and its irradiance over pi.
type SampledSide<'a> = (&'a Rectangle, ProductSampler, f64);

/// A sampler of the sides that face a receiver: at most three.
struct SidesSampler<'a> {
    receiver: (DVec3, DVec3),
    sides: [Option<SampledSide<'a>>; 3],
    /// Irradiance over pi of all of them.
    whole: f64,
}

impl<'a> SidesSampler<'a> {
    fn new(sides: &'a [Rectangle], (point, normal): (DVec3, DVec3)) -> Option<SidesSampler<'a>> {
        let mut facing = sides.iter().filter_map(|side| {
            let outline = side.outline(point, normal)?;
            let irradiance = outline.irradiance(normal);
            let sampler = ProductSampler::new(side, &outline, None, (point, normal))?;
            (irradiance > 0.0).then_some((side, sampler, irradiance))
        });
        let sides = [facing.next(), facing.next(), facing.next()];
        let whole = sides.iter().flatten().map(|side| side.2).sum();
        (whole > 0.0).then_some(SidesSampler { receiver: (point, normal), sides, whole })
    }
}

impl FormSampler for SidesSampler<'_> {
    /// The side is chosen with probability proportional to its irradiance.
    fn sample(&self, points: &Points2, i: usize) -> Option<(DVec3, f64)> {
        let [u, v] = points.get(i);
        let mut left = u * self.whole;
        let mut sides = self.sides.iter().flatten().peekable();
        while let Some((side, sampler, irradiance)) = sides.next() {
            if left < *irradiance || sides.peek().is_none() {
                let (position, sampled) =
                    sampler.sample(side, self.receiver, [(left / irradiance).min(1.0), v])?;
                return Some((self.receiver.0 + position, sampled * (self.whole / irradiance)));
            }
            left -= irradiance;
        }
        None
    }
}
