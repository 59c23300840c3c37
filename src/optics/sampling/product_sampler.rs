//! Directions through a rectangle, by the strategy that suits what is seen through it.

use std::f64::consts::PI;

use glam::DVec3;

use super::gaussian::Gaussian;
use super::lobe_irradiance::Reach;
use super::polar_sampler::{Polar, Product};
use super::polygon::Outline;
use super::rectangle::{Rectangle, SeenRectangle};

/// Samples of G(l) cos(theta), or of cos(theta) alone, through a rectangle.
pub enum Through {
    /// The lobe lies wholly within: from the lobe alone.
    Lobe(Gaussian),
    /// The product is nearly a bilinear function on the rectangle: from that, by Ureña's map. Hart et al., "Practical Product
    /// Strategy by Fitting and Composing Warps", EGSR 2020.
    Warped(SeenRectangle, [[f64; 2]; 2], Option<Gaussian>),
    /// The lobe or the horizon cuts through it.
    Polar(Box<Polar>),
}

/// The corners' mean may miss the middle by this much of it.
const BILINEAR: f64 = 0.5;

/// Width over perimeter below which an outline is a slit.
const SLIT: f64 = 2e-3;

impl Through {
    /// `outline` is the rectangle's, as seen from `point`; `None` where nothing arrives.
    pub fn new(
        rectangle: &Rectangle,
        outline: &Outline,
        gaussian: Option<Gaussian>,
        (point, normal): (DVec3, DVec3),
    ) -> Option<Through> {
        let product = match gaussian {
            None => Product::AboutNormal(None, normal),
            Some(gaussian) => match gaussian.reach(outline) {
                Reach::Outside => return None,
                Reach::Inside => return Some(Through::Lobe(gaussian)),
                Reach::Across => Product::of(gaussian, normal),
            },
        };
        // In a slit narrower than the lobe nearly all azimuths about the lobe hold next to nothing.
        let around: f64 = outline.edges().iter().map(|edge| edge.angle).sum();
        let width = 2.0 * outline.solid_angle() / around;
        let spread = gaussian.map_or(1.0, |gaussian| 1.0 / gaussian.bandwidth.max(1.0).sqrt());
        if width < SLIT * around && width < spread {
            return Some(Through::Warped(rectangle.seen_from(point)?, [[1.0; 2]; 2], gaussian));
        }
        if outline.edges().len() == 4 {
            let seen = rectangle.seen_from(point)?;
            let value = |place: DVec3| value(gaussian, normal, place.normalize_or_zero()) / seen.pdf(place);
            let corners = [0.0, 1.0].map(|v| [0.0, 1.0].map(|u| value(seen.place(u, v))));
            let all = corners.as_flattened();
            let (low, high) = all.iter().fold((f64::INFINITY, 0.0), |(low, high), &c| (c.min(low), c.max(high)));
            let (mean, middle) = (0.25 * all.iter().sum::<f64>(), value(seen.sample([0.5, 0.5])));
            if low > 0.01 * high && (mean - middle).abs() < BILINEAR * middle {
                return Some(Through::Warped(seen, corners, gaussian));
            }
        }
        Polar::new(outline, product).map(|polar| Through::Polar(Box::new(polar)))
    }

    /// A place, relative to `point`, and its part of E.
    pub fn sample(&self, rectangle: &Rectangle, (point, normal): (DVec3, DVec3), uv: [f64; 2]) -> Option<(DVec3, f64)> {
        match self {
            Through::Lobe(gaussian) => {
                let direction = gaussian.sample(uv);
                let place = rectangle.meet(point, direction)?;
                let cos = normal.dot(direction);
                (cos > 0.0).then(|| (place, cos * gaussian.solid_angle() / PI))
            }
            Through::Warped(seen, [[a, b], [c, d]], gaussian) => {
                let v = line(uv[1], a + b, c + d);
                let (left, right) = (a + v * (c - a), b + v * (d - b));
                let u = line(uv[0], left, right);
                let warp = 4.0 * (left + u * (right - left)) / (a + b + c + d);
                let place = seen.sample([u, v]);
                let value = value(*gaussian, normal, place.normalize_or_zero());
                Some((place, value / (PI * warp * seen.pdf(place))))
            }
            Through::Polar(polar) => {
                let (direction, integral) = polar.sample(uv)?;
                Some((rectangle.through(point, direction)?, integral / PI))
            }
        }
    }
}

fn value(gaussian: Option<Gaussian>, normal: DVec3, direction: DVec3) -> f64 {
    normal.dot(direction).max(0.0) * gaussian.map_or(1.0, |gaussian| gaussian.value(direction))
}

/// Inverts the distribution on 0..1 whose density runs in a line from `a` to `b`.
pub fn line(u: f64, a: f64, b: f64) -> f64 {
    let root = (a * a + u * (b * b - a * a)).max(0.0).sqrt();
    let sum = a + root;
    if sum > 0.0 { (u * (a + b) / sum).min(1.0) } else { u }
}
