//! Directions through a polygon with density proportional to a lobe times the cosine.
//!
//! In polar coordinates about a pole a convex outline is, for each azimuth phi, one interval of 1 -
//! cos(theta) = t. Along it one factor of the integrand is exact: e^(-b t) about the lobe's
//! direction, or the cosine itself, 1 - t, about the receiver's normal. The other factor depends
//! little on v, the fraction of the interval's mass, and is fitted by a line in v. The integral
//! over an azimuth's interval is fitted by lines between few azimuths. Both fits are sampled
//! exactly, and each sample's weight corrects their error.

use std::f64::consts::TAU;

use glam::DVec3;

use super::gaussian::{GAUSSIAN, Gaussian};
use super::linear::invert_linear;
use super::polygon::Outline;
use crate::tuning::tuning;

/// The integrand, G(l) cos(theta) or cos(theta) alone, and the pole of its polar coordinates.
#[derive(Clone, Copy)]
pub enum Product {
    /// The pole is the lobe's direction; G is exact.
    AboutLobe(Gaussian, DVec3),
    /// The pole is the normal; the cosine is exact.
    AboutNormal(Option<Gaussian>, DVec3),
}

impl Product {
    /// The product about the pole of the factor that varies more.
    pub fn about_sharper(gaussian: Gaussian, normal: DVec3) -> Product {
        if gaussian.bandwidth > TUNING.sharp_bandwidth {
            Product::AboutLobe(gaussian, normal)
        } else {
            Product::AboutNormal(
                (gaussian.bandwidth > GAUSSIAN.uniform_bandwidth).then_some(gaussian),
                normal,
            )
        }
    }

    fn pole(&self) -> DVec3 {
        match self {
            Product::AboutLobe(gaussian, _) => gaussian.direction,
            Product::AboutNormal(_, normal) => *normal,
        }
    }

    /// The integral of the exact factor over t in t0..t1.
    fn mass(&self, t0: f64, t1: f64) -> f64 {
        match self {
            Product::AboutLobe(gaussian, _) => {
                let b = gaussian.bandwidth;
                (-b * t0).exp() * -(-b * (t1 - t0)).exp_m1() / b
            }
            Product::AboutNormal(..) => 0.5 * (t1 - t0) * (2.0 - t0 - t1).max(0.0),
        }
    }

    /// The t below which the fraction `v` of that integral lies.
    fn quantile(&self, t0: f64, t1: f64, v: f64) -> f64 {
        let t = match self {
            Product::AboutLobe(gaussian, _) => {
                let b = gaussian.bandwidth;
                t0 - (v * (-b * (t1 - t0)).exp_m1()).ln_1p() / b
            }
            Product::AboutNormal(..) => {
                // Even in sin^2.
                let [s0, s1] = [t0, t1].map(|t| t * (2.0 - t));
                let s = s0 + v * (s1 - s0);
                s / (1.0 + (1.0 - s).max(0.0).sqrt())
            }
        };
        t.clamp(t0, t1)
    }

    /// [`Product::mass`] and [`Product::quantile`] at 1/4 and 3/4, faster and less exact:
    /// sufficient for a fit.
    fn quarters(&self, t0: f64, t1: f64) -> (f64, [f64; 2]) {
        match self {
            Product::AboutLobe(gaussian, _) => {
                let b = gaussian.bandwidth;
                let [e0, e1] = [(-b * t0).exp(), (-b * t1).exp()];
                let at = |v: f64| -(e0 + v * (e1 - e0)).ln() / b;
                ((e0 - e1) / b, [at(0.25).clamp(t0, t1), at(0.75).clamp(t0, t1)])
            }
            Product::AboutNormal(..) => {
                (self.mass(t0, t1), [self.quantile(t0, t1, 0.25), self.quantile(t0, t1, 0.75)])
            }
        }
    }

    /// The other factor, which is fitted.
    fn fitted(&self, direction: DVec3) -> f64 {
        match self {
            Product::AboutLobe(_, normal) => normal.dot(direction).max(0.0),
            Product::AboutNormal(Some(gaussian), _) => gaussian.value(direction),
            Product::AboutNormal(None, _) => 1.0,
        }
    }
}

/// A sampler of the integrand over an outline.
pub struct PolarSampler {
    product: Product,
    /// Pole and two directions across it.
    axes: [DVec3; 3],
    /// Per edge: true where t ends there (false: begins), and cot(theta) of its great circle as a
    /// sum of cos(phi) and sin(phi).
    edges: [(bool, [f64; 2]); Outline::MOST],
    edge_count: usize,
    nodes: [AzimuthNode; TUNING.max_nodes],
    node_count: usize,
}

/// The fit at one azimuth.
#[derive(Clone, Copy, Default)]
struct AzimuthNode {
    azimuth: f64,
    /// Density over azimuth, not normalized.
    density: f64,
    /// Density at v = 0 over the sum of the densities at v = 0 and v = 1.
    tilt: f64,
    /// Integral of the density up to here.
    sum: f64,
}

tuning! {
    /// Constants of the fit of the polar sampler. Each changes the noise and the time, and no mean.
    pub const TUNING: PolarSamplerTuning {
        /// Bandwidth above which the pole is the lobe's direction, not the normal.
        sharp_bandwidth: f64 = 1.0,
            unit "1", source Derived("the lobe then varies more than the cosine"),
            effect "another value changes the noise and the time, and no mean";
        /// Largest number of nodes of the fit over azimuth.
        max_nodes: usize = 32,
            unit "nodes", source Measured("benches/windows.rs"),
            effect "a larger value lowers the noise and takes longer";
        /// Largest error of a line over an interval of azimuth at its middle. As the middle becomes
        /// a node too, about a quarter of that error is left.
        max_error: f64 = 0.03,
            unit "the whole integral", source Measured("benches/windows.rs"),
            effect "a larger value is noisier and faster";
        /// Least density of a node: a flank between two nodes is not undersampled.
        min_density: f64 = 0.25,
            unit "its neighbors' density", source Measured("benches/windows.rs"),
            effect "a larger value samples flanks more";
        /// Ratio of two densities below which there is a step between them.
        step: f64 = 0.25,
            unit "1", source Measured("benches/windows.rs"), effect "a larger value takes more intervals for steps";
        /// Fraction of the allowed error in an interval with a step: halving it leaves half of the
        /// error, and one without a step a quarter.
        allowed_at_step: f64 = 0.25,
            unit "1", source Measured("benches/windows.rs"), effect "a smaller value places more nodes at steps";
        /// Distance of the first and last node from their corners, where the outline is closed.
        inside: f64 = 1e-9,
            unit "the range of azimuth", source Measured("benches/windows.rs"),
            effect "a larger value measures farther from the corners";
        /// Least height of an edge's great circle over the pole, so that one through the pole has a
        /// finite slope.
        min_rise: f64 = 1e-100,
            unit "1", source Derived("range of 64 bits"), effect "none above the range of 64 bits";
        /// Least and largest tilt of a node: the fitted line stays above a tenth of its mean.
        tilt_range: [f64; 2] = [0.05, 0.95],
            unit "1", source Measured("benches/windows.rs"),
            effect "a wider range follows the integrand more, with larger weights";
    }
}

/// One azimuth, measured.
#[derive(Clone, Copy, Default)]
struct Slice {
    azimuth: f64,
    cos: f64,
    sin: f64,
    density: f64,
    tilt: f64,
}

impl PolarSampler {
    /// The sampler of `product` over `outline`; `None` where the integrand is zero.
    pub fn new(outline: &Outline, product: Product) -> Option<PolarSampler> {
        let pole = product.pole();
        let edges = outline.edges();
        let center: DVec3 = edges.iter().map(|edge| edge.start.normalize()).sum();
        let towards = (center - pole * pole.dot(center)).try_normalize();
        let x = towards.unwrap_or_else(|| pole.any_orthonormal_vector());
        let y = pole.cross(x);
        let mut polar = PolarSampler {
            product,
            axes: [pole, x, y],
            edges: [(false, [0.0; 2]); Outline::MOST],
            edge_count: edges.len(),
            nodes: [AzimuthNode::default(); TUNING.max_nodes],
            node_count: 0,
        };
        for (slot, edge) in polar.edges.iter_mut().zip(edges) {
            let rise = edge.inward.dot(pole);
            let rise = if rise.abs() < TUNING.min_rise { TUNING.min_rise } else { rise };
            *slot = (rise > 0.0, [-edge.inward.dot(x) / rise, -edge.inward.dot(y) / rise]);
        }
        // Between the azimuths of the corners everything is smooth.
        let mut corners = [0.0; Outline::MOST + 1];
        for (corner, edge) in corners.iter_mut().zip(edges) {
            *corner = edge.start.dot(y).atan2(edge.start.dot(x));
        }
        let mut count = edges.len();
        corners[..count].sort_unstable_by(f64::total_cmp);
        let about =
            |upper: bool| polar.edges[..polar.edge_count].iter().all(|edge| edge.0 == upper);
        if about(true) || about(false) {
            corners[count] = corners[0] + TAU;
            count += 1;
        }
        polar.fit(&corners[..count]);
        (polar.nodes[polar.node_count - 1].sum > 0.0).then_some(polar)
    }

    /// Places the nodes so close that a line between neighbors has an error of at most
    /// `TUNING.max_error`.
    fn fit(&mut self, corners: &[f64]) {
        let last = corners.len() - 1;
        // An interval that a corner closes is measured just inside of it.
        let inside = TUNING.inside * (corners[last] - corners[0]);
        let mut known = [Slice::default(); 2 * Outline::MOST + 1];
        for (i, &azimuth) in corners.iter().enumerate() {
            let shift = if i == 0 {
                inside
            } else if i == last {
                -inside
            } else {
                0.0
            };
            known[2 * i] = Slice { azimuth, ..self.measure(azimuth + shift) };
        }
        let mut whole = 0.0;
        for i in 0..last {
            let (a, b) = (known[2 * i], known[2 * i + 2]);
            known[2 * i + 1] = self.measure(0.5 * (a.azimuth + b.azimuth));
            whole += (a.density + 4.0 * known[2 * i + 1].density + b.density) / 6.0
                * (b.azimuth - a.azimuth);
        }
        for i in 0..last {
            self.divide(
                [known[2 * i], known[2 * i + 1], known[2 * i + 2]],
                TUNING.max_error * whole,
            );
        }
        self.push(known[2 * last]);
        let nodes = &mut self.nodes[..self.node_count];
        let mut before = 0.0;
        for i in 0..nodes.len() {
            let density = nodes[i].density;
            let after = nodes.get(i + 1).map_or(0.0, |node| node.density);
            nodes[i].density = density.max(TUNING.min_density * f64::max(before, after));
            before = density;
        }
        for i in 1..nodes.len() {
            let width = nodes[i].azimuth - nodes[i - 1].azimuth;
            nodes[i].sum =
                nodes[i - 1].sum + 0.5 * width * (nodes[i].density + nodes[i - 1].density);
        }
    }

    /// Adds the node `a` and the nodes needed before `b`.
    fn divide(&mut self, [a, middle, b]: [Slice; 3], allowed: f64) {
        let miss = (2.0 / 3.0)
            * (middle.density - 0.5 * (a.density + b.density)).abs()
            * (b.azimuth - a.azimuth);
        // Halving an interval with a step in it leaves half of the error, and one without a
        // quarter.
        let step = a.density.min(b.density) < TUNING.step * a.density.max(b.density);
        let allowed_here = if step { TUNING.allowed_at_step * allowed } else { allowed };
        // Room is kept for the corners still to come.
        if miss > allowed_here && self.node_count + 2 * Outline::MOST + 3 < TUNING.max_nodes {
            let [left, right] = [a, b].map(|end| self.halve(end, middle));
            self.divide([a, left, middle], allowed);
            self.divide([middle, right, b], allowed);
        } else {
            self.push(a);
            self.push(middle);
        }
    }

    fn push(&mut self, slice: Slice) {
        if self.node_count < TUNING.max_nodes {
            let Slice { azimuth, density, tilt, .. } = slice;
            self.nodes[self.node_count] = AzimuthNode { azimuth, density, tilt, sum: 0.0 };
            self.node_count += 1;
        }
    }

    fn measure(&self, azimuth: f64) -> Slice {
        let (sin, cos) = azimuth.sin_cos();
        self.slice(azimuth, cos, sin)
    }

    /// The slice half way between two azimuths less than half a turn apart.
    fn halve(&self, a: Slice, b: Slice) -> Slice {
        let (cos, sin) = (a.cos + b.cos, a.sin + b.sin);
        let length = (cos * cos + sin * sin).sqrt();
        self.slice(0.5 * (a.azimuth + b.azimuth), cos / length, sin / length)
    }

    fn slice(&self, azimuth: f64, cos: f64, sin: f64) -> Slice {
        let [t0, t1] = self.interval(cos, sin);
        let (mut density, mut tilt) = (0.0, 0.5);
        if t1 > t0 {
            let (mass, at) = self.product.quarters(t0, t1);
            let [a, b] = at.map(|t| self.product.fitted(self.direction(t, cos, sin)));
            density = mass * 0.5 * (a + b);
            if a + b > 0.0 {
                tilt = ((1.5 * a - 0.5 * b) / (a + b))
                    .clamp(TUNING.tilt_range[0], TUNING.tilt_range[1]);
            }
        }
        Slice { azimuth, cos, sin, density, tilt }
    }

    /// The t at which the polygon begins and ends at one azimuth.
    fn interval(&self, cos: f64, sin: f64) -> [f64; 2] {
        // cot(theta) falls from infinity to minus infinity.
        let (mut high, mut low) = (f64::INFINITY, f64::NEG_INFINITY);
        for (end, [a, b]) in &self.edges[..self.edge_count] {
            let cot = a * cos + b * sin;
            if *end {
                low = low.max(cot);
            } else {
                high = high.min(cot);
            }
        }
        [high, low].map(|cot| {
            let sin2 = 1.0 / (1.0 + cot * cot);
            let cos = (1.0 - sin2).max(0.0).sqrt();
            if cot > 0.0 { sin2 / (1.0 + cos) } else { 1.0 + cos }
        })
    }

    fn direction(&self, t: f64, cos: f64, sin: f64) -> DVec3 {
        let [pole, x, y] = self.axes;
        (1.0 - t) * pole + (t * (2.0 - t)).max(0.0).sqrt() * (cos * x + sin * y)
    }

    /// A unit direction, and the integrand there over the density, from a point of the unit square.
    ///
    /// The quotient is an unbiased estimate of the integral over the outline; `None` counts as
    /// zero.
    pub fn sample(&self, [u, v]: [f64; 2]) -> Option<(DVec3, f64)> {
        let nodes = &self.nodes[..self.node_count];
        let total = nodes[nodes.len() - 1].sum;
        let target = u * total;
        let i = nodes[1..nodes.len() - 1].partition_point(|node| node.sum <= target);
        let (a, b) = (&nodes[i], &nodes[i + 1]);
        let fraction = ((target - a.sum) / (b.sum - a.sum)).clamp(0.0, 1.0);
        let along = invert_linear(fraction, a.density, b.density);
        let azimuth = a.azimuth + along * (b.azimuth - a.azimuth);
        let mix = |a: f64, b: f64| a + along * (b - a);
        let tilt = mix(a.tilt, b.tilt);
        let v = invert_linear(v, tilt, 1.0 - tilt);
        let density =
            mix(a.density, b.density) * 2.0 * ((1.0 - v) * tilt + v * (1.0 - tilt)) / total;
        let (sin, cos) = azimuth.sin_cos();
        let [t0, t1] = self.interval(cos, sin);
        if !(t1 > t0 && density > 0.0) {
            return None;
        }
        let direction = self.direction(self.product.quantile(t0, t1, v), cos, sin);
        Some((direction, self.product.mass(t0, t1) * self.product.fitted(direction) / density))
    }
}
