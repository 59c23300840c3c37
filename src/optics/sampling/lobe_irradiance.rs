//! Irradiance from a spherical Gaussian through a polygon: Lambert's formula with weights along the
//! edges.
//!
//! For f on the sphere and a region with inward normals nu (tangent to the sphere), the divergence
//! theorem says 2 integral of f l = integral of grad f + contour integral of f nu. With c = d . l,
//! t = 1 - c, x = b t and G = exp(-x):
//!
//! - for m perpendicular to d, m . grad f = -f' c (m . l), so f = H with (c^2 H)' = c G gives
//!   integral of G (m . l) = contour integral of H (nu . m);
//! - d . grad f = f' (1 - c^2), so f = R with (R (1 - c^2))' = D - c G gives integral of G (d . l)
//!   = D Omega + contour integral of R (nu . d), Omega being the solid angle and D the mean of c G
//!   over the whole sphere, by which R is regular at both poles.
//!
//! With p1(x) = (1 - e^-x) / x and p2(x) = (p1(x) - e^-x) / x:
//!
//!   D = p1(2b) - 2 p2(2b) = (coth b - 1/b) (1 - e^-2b) / 2b,
//!   R = (p1(x) - t p2(x) - D) / (2 - t),   H = e^-b p2(-b c).
//!
//! For b = 0 both R and H are 1/2 and D is 0: Lambert's formula. Along an edge c = cos(delta)
//! cos(s), a smooth function of the arc s, which Gauss-Legendre quadrature integrates to the error
//! stated at [`Gaussian::irradiance`].

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::DVec3;

use super::gaussian::Gaussian;
use super::polygon::{ArcEdge, Outline};
use crate::tuning::tuning;

tuning! {
    /// Constants of the irradiance of a lobe through an outline.
    pub const LOBE_IRRADIANCE: LobeIrradianceTuning {
        /// Exponent beyond which G counts as zero: e^-18 = 1.5e-8.
        faint: f64 = 18.0,
            unit "1", source Derived("the error stated at `Gaussian::irradiance`"),
            effect "a larger value lengthens the arcs that are integrated";
        /// Argument up to which p2 is computed by its series.
        series: f64 = 0.25,
            unit "1", source Derived("its 11 terms are exact to 64 bits there"),
            effect "a larger value truncates the series";
        /// Largest t before R at the pole opposite to the lobe's direction is replaced by its
        /// limit.
        pole: f64 = 2.0 - 1e-6,
            unit "1", source Derived("R loses half of its digits there"), effect "a larger value loses more digits";
        /// Length of an arc, times the rate, below which five nodes of the quadrature suffice.
        short_arc: f64 = 0.75,
            unit "1", source Measured("the error stated at `quadrature`"),
            effect "a larger value is faster and less exact";
    }
}

/// The overlap of a lobe and an outline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overlap {
    /// The lobe, but for e^-18 of it, lies outside.
    Disjoint,
    /// The lobe, but for e^-18 of it, lies inside.
    Within,
    /// The outline cuts the lobe.
    Partial,
}

impl Gaussian {
    /// The overlap of this lobe and `outline`.
    pub fn overlap(&self, outline: &Outline) -> Overlap {
        let mut overlap = Overlap::Within;
        for edge in outline.edges() {
            let sin = edge.inward.dot(self.direction);
            // 1 - cos of the distance from the edge's great circle.
            let t = sin * sin / (1.0 + (1.0 - sin * sin).max(0.0).sqrt());
            if self.bandwidth * t < LOBE_IRRADIANCE.faint {
                overlap = Overlap::Partial;
            } else if sin < 0.0 {
                return Overlap::Disjoint;
            }
        }
        overlap
    }

    /// The irradiance over pi, E = (1/pi) integral of G cos(theta) over `outline`, for a receiver
    /// of unit `normal`.
    ///
    /// The error is below 1e-7 of the whole lobe's E at normal incidence, for every bandwidth.
    pub fn irradiance(&self, outline: &Outline, normal: DVec3) -> f64 {
        let along = normal.dot(self.direction);
        let mean = p1_p2(2.0 * self.bandwidth);
        let mean = mean[0] - 2.0 * mean[1];
        let sum = match self.overlap(outline) {
            Overlap::Disjoint => 0.0,
            Overlap::Within => along * mean * 2.0 * TAU,
            Overlap::Partial => {
                let across = normal - along * self.direction;
                let edges = outline.edges().iter().map(|edge| {
                    let [r, h] = self.along_edge(edge, mean);
                    along * r + across.dot(edge.inward) * h
                });
                along * mean * outline.solid_angle() + edges.sum::<f64>()
            }
        };
        sum.max(0.0) / PI
    }

    /// The integrals of R (nu . d) and of H along an edge.
    fn along_edge(&self, edge: &ArcEdge, mean: f64) -> [f64; 2] {
        let b = self.bandwidth;
        let arc = Arc::new(self, edge);
        let sums = arc.near(self, |sin_half, _| {
            let t = arc.rise(sin_half);
            let (x, y) = (b * t, b * (1.0 - t));
            let e = (-x).exp();
            let [p1, p2] = p1_p2_of(x, e);
            // At the pole opposite to d: (D - G c) / 2c, both evaluated at c = -1.
            let r = if t < LOBE_IRRADIANCE.pole {
                (p1 - t * p2 - mean) / (2.0 - t)
            } else {
                0.5 * (mean + e)
            };
            let h = if y.abs() > LOBE_IRRADIANCE.series {
                ((y - 1.0) * e + (-b).exp()) / (y * y)
            } else {
                (-b).exp() * p2_series(-y)[0]
            };
            [r, h]
        });
        [sums[0] * arc.sin_delta + 2.0 * mean * arc.beyond(), sums[1]]
    }
}

/// An edge, parametrized by its arc length s from the point nearest to a lobe's axis.
pub(in crate::optics) struct Arc {
    /// Sine and cosine of the distance of the edge's great circle from the axis; positive inside.
    sin_delta: f64,
    cos_delta: f64,
    /// Arc length from the start of the edge to the nearest point of its great circle, radians.
    pub nearest: f64,
    /// The edge, the middle of it within -pi..pi.
    from: f64,
    to: f64,
    /// Beyond this distance from the nearest point G counts as zero.
    width: f64,
}

impl Arc {
    /// The arc of `edge` about the axis of `lobe`.
    pub fn new(lobe: &Gaussian, edge: &ArcEdge) -> Arc {
        let sin_delta = edge.inward.dot(lobe.direction);
        let cos_delta = (1.0 - sin_delta * sin_delta).max(0.0).sqrt();
        let first = edge.start.normalize();
        let forward = first.cross(edge.inward);
        let nearest = lobe.direction.dot(forward).atan2(lobe.direction.dot(first));
        let middle = 0.5 * edge.angle - nearest;
        let middle = if middle > PI { middle - TAU } else { middle };
        let cut = LOBE_IRRADIANCE.faint / lobe.bandwidth;
        let width = if cut >= 1.0 {
            f64::INFINITY
        } else {
            ((1.0 - cut) / cos_delta).clamp(-1.0, 1.0).acos()
        };
        Arc {
            sin_delta,
            cos_delta,
            nearest,
            from: middle - 0.5 * edge.angle,
            to: middle + 0.5 * edge.angle,
            width,
        }
    }

    /// The value of t = 1 - d . l at the arc length s with sin(s/2) = `sin_half`.
    pub fn rise(&self, sin_half: f64) -> f64 {
        // 1 - cos(delta).
        let least = self.sin_delta * self.sin_delta / (1.0 + self.cos_delta);
        least + 2.0 * self.cos_delta * sin_half * sin_half
    }

    /// The integrals of a function of sin(s/2) and cos(s/2) over the part of the edge where the
    /// lobe is not zero.
    pub fn near<const N: usize>(
        &self,
        lobe: &Gaussian,
        f: impl Fn(f64, f64) -> [f64; N],
    ) -> [f64; N] {
        let (from, to) =
            (self.from.clamp(-self.width, self.width), self.to.clamp(-self.width, self.width));
        if to > from { quadrature(from, to, lobe.bandwidth.max(1.0).sqrt(), f) } else { [0.0; N] }
    }

    /// The integral of (nu . d) / 2t over the other part, where H is zero and R = 2 D / 2t.
    pub fn beyond(&self) -> f64 {
        if self.width >= FRAC_PI_2 {
            return 0.0;
        }
        let ratio = self.sin_delta.abs() / (1.0 + self.cos_delta);
        let turn = |s: f64| (0.5 * s).sin().atan2(ratio * (0.5 * s).cos());
        let between = |from: f64, to: f64| if to > from { turn(to) - turn(from) } else { 0.0 };
        let far = between(self.from.max(self.width), self.to)
            + between(self.from, self.to.min(-self.width));
        far * self.sin_delta.signum()
    }
}

/// The functions p1(x) and p2(x) for x >= 0.
pub(in crate::optics) fn p1_p2(x: f64) -> [f64; 2] {
    p1_p2_of(x, (-x).exp())
}

/// [`p1_p2`] with `e` = e^-x given.
pub(in crate::optics) fn p1_p2_of(x: f64, e: f64) -> [f64; 2] {
    if x > LOBE_IRRADIANCE.series {
        let p1 = (1.0 - e) / x;
        [p1, (p1 - e) / x]
    } else {
        let [p2, _] = p2_series(x);
        [e + x * p2, p2]
    }
}

/// The series p2(x) = sum over k of (k + 1) (-x)^k / (k + 2)!, and its derivative, for |x| <=
/// `LOBE_IRRADIANCE.series`.
pub(in crate::optics) fn p2_series(x: f64) -> [f64; 2] {
    const TERMS: [f64; 11] = [
        1.0 / 2.0,
        -1.0 / 3.0,
        1.0 / 8.0,
        -1.0 / 30.0,
        1.0 / 144.0,
        -1.0 / 840.0,
        1.0 / 5760.0,
        -1.0 / 45360.0,
        1.0 / 403200.0,
        -1.0 / 3991680.0,
        1.0 / 43545600.0,
    ];
    TERMS.iter().rev().fold([0.0; 2], |[sum, slope], term| [sum * x + term, slope * x + sum])
}

/// Positive nodes and weights of Gauss-Legendre quadrature with five nodes.
const FIVE: [[f64; 2]; 3] = [
    [0.0, 0.5 * 0.568_888_888_888_888_9],
    [0.538_469_310_105_683_1, 0.478_628_670_499_366_5],
    [0.906_179_845_938_664, 0.236_926_885_056_189_1],
];
/// The same with ten nodes.
const TEN: [[f64; 2]; 5] = [
    [0.148_874_338_981_631_2, 0.295_524_224_714_752_9],
    [0.433_395_394_129_247_2, 0.269_266_719_309_996_3],
    [0.679_409_568_299_024_4, 0.219_086_362_515_982],
    [0.865_063_366_688_984_5, 0.149_451_349_150_580_6],
    [0.973_906_528_517_171_7, 0.066_671_344_308_688_1],
];

/// The integral over s of a function of sin(s/2) and cos(s/2) that changes over lengths of 1 /
/// `rate`.
///
/// There are ten nodes for each length of pi / rate, five for a short arc; the error is below 1e-8
/// of exp(-(rate s)^2 / 2).
fn quadrature<const N: usize>(
    from: f64,
    to: f64,
    rate: f64,
    f: impl Fn(f64, f64) -> [f64; N],
) -> [f64; N] {
    let scaled = (to - from) * rate;
    let rule: &[[f64; 2]] = if scaled < LOBE_IRRADIANCE.short_arc { &FIVE } else { &TEN };
    let panels = (scaled / PI).ceil().max(1.0);
    let half = 0.5 * (to - from) / panels;
    let mut sums = [0.0; N];
    for panel in 0..panels as usize {
        let (sin_middle, cos_middle) = (0.5 * (from + half * (2 * panel + 1) as f64)).sin_cos();
        for [node, weight] in rule {
            let (sin, cos) = (0.5 * half * node).sin_cos();
            let [ss, sc, cs, cc] =
                [sin_middle * sin, sin_middle * cos, cos_middle * sin, cos_middle * cos];
            let (a, b) = (f(sc + cs, cc - ss), f(sc - cs, cc + ss));
            sums.iter_mut().zip(a).zip(b).for_each(|((sum, a), b)| *sum += weight * half * (a + b));
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::sampling::{Lobe, Points2};
    use glam::Vec3;

    /// The slow, obvious twin: product quadrature over a fan of triangles in the polygon's plane.
    fn twin(g: &Gaussian, outline: &Outline, normal: DVec3) -> f64 {
        let panels = 40;
        let nodes: Vec<[f64; 2]> = (0..panels)
            .flat_map(|p| {
                FIVE.iter().flat_map(move |[node, weight]| {
                    let at = |x: f64| {
                        [
                            (f64::from(p) + 0.5 + 0.5 * x) / f64::from(panels),
                            0.5 * weight / f64::from(panels),
                        ]
                    };
                    [at(*node), at(-node)]
                })
            })
            .collect();
        let edges = outline.edges();
        let a = edges[0].start;
        let mut sum = 0.0;
        for edge in &edges[1..edges.len() - 1] {
            let (b, c) = (edge.start, edge.end);
            let twice_area = (b - a).cross(c - a);
            for [u, wu] in &nodes {
                for [v, wv] in &nodes {
                    let position = a + *u * ((b - a) + *v * (c - b));
                    let l = position.normalize();
                    sum += wu * wv * u * twice_area.dot(l).abs() / position.length_squared()
                        * normal.dot(l)
                        * g.value(l);
                }
            }
        }
        sum / PI
    }

    /// Windows of all sizes and places, lobes of all bandwidths about as wide as they are,
    /// receivers of all inclinations.
    #[test]
    fn agrees_with_its_twin_to_a_ten_millionth_of_the_lobe() {
        let points = [0, 1, 2, 3].map(|stream| Points2::new(4, 0, stream));
        let (mut compared, mut cut) = (0, 0);
        for i in 0..150 {
            let [[a, b], [c, d], [e, f], [g, h]] = points.map(|p| p.get(i));
            let bandwidth = if i % 10 == 0 { 0.0 } else { 10f64.powf(-3.0 + 10.0 * a) };
            // Half edges from a fifth to five times the lobe's width, at most three times the
            // distance.
            let size = (0.2 * 25f64.powf(b) / bandwidth.sqrt()).min(3.0);
            let x = DVec3::X * size;
            let y = DVec3::Y * size * (0.3 + c);
            let center = DVec3::new(2.0 * (d - 0.5), 2.0 * (e - 0.5), -1.0);
            let aim = center + x * 3.0 * (f - 0.5) + y * 3.0 * (g - 0.5);
            let lobe = Lobe { direction: aim.as_vec3(), bandwidth: bandwidth as f32 };
            let gaussian = Gaussian::new(&lobe);
            // Half of the horizons pass through the window's neighborhood.
            let across = aim.cross(DVec3::new(h - 0.5, a - 0.5, 0.3)).normalize();
            let normal =
                if i % 2 == 0 { across } else { DVec3::new(h - 0.5, b - 0.5, -0.7).normalize() };
            let Some(outline) = Outline::above(
                &[center - x - y, center + x - y, center + x + y, center - x + y],
                normal,
            ) else {
                continue;
            };
            let (got, wanted) =
                (gaussian.irradiance(&outline, normal), twin(&gaussian, &outline, normal));
            let whole = gaussian.solid_angle() / PI;
            assert!(
                (got - wanted).abs() < 1e-7 * whole,
                "{i} {bandwidth}: {got} {wanted} {whole} {size}"
            );
            compared += 1;
            cut += usize::from(outline.edges().len() == 5);
        }
        assert!(compared > 100 && cut > 5, "{compared} {cut}");
    }

    #[test]
    fn a_whole_sphere_of_directions_has_the_mean_cosine() {
        for bandwidth in [1e-6f32, 0.1, 0.2, 1.0, 30.0, 1e4, 1e7] {
            let b = f64::from(bandwidth);
            let g = Gaussian::new(&Lobe { direction: Vec3::Z, bandwidth });
            let mean = p1_p2(2.0 * b);
            let coth = if b < 0.2 {
                b / 3.0 - b.powi(3) / 45.0 + 2.0 * b.powi(5) / 945.0
            } else {
                1.0 / b.tanh() - 1.0 / b
            };
            let exact = coth * g.solid_angle() / (2.0 * TAU);
            let got = mean[0] - 2.0 * mean[1];
            assert!((got / exact - 1.0).abs() < 1e-6, "{bandwidth}: {got} {exact}");
        }
    }
}
