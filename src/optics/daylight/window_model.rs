//! The surrounding of a window as three spherical Gaussians: sun, sky and ground fitted to a
//! picture.
//!
//! A surrounding is a picture of all directions, radiance L(l) by direction l. Through a window
//! whose wall faces out along n comes the flux integral of L(l) max(0, n . l), so that each
//! direction counts with m = (n . l) d omega. The fit is in two steps, since a sun is a thousand
//! times brighter than its sky and a thousand times smaller.
//!
//! 1. Sun: the excess, around the brightest direction, over the radiance of the annulus around it.
//!    A lobe of bandwidth b has the mean direction d with |mean of l| = coth b - 1/b, from which b
//!    follows; its radiance is that of the same flux.
//! 2. Sky and ground: two broad lobes with least sum of m |L - w1 G1 - w2 G2|^2 over the other
//!    directions. Their radiances w are eliminated (non-negative, per channel); their directions
//!    and bandwidths come from damped steps (Levenberg and Marquardt). Then both are scaled, so
//!    that the flux is the surrounding's.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use crate::image::{Plane, luminance};
use crate::optics::nnls::solve_free;
use crate::optics::{Lobe, nnls};
use crate::tuning::tuning;

/// The orientation of a picture of a surrounding.
///
/// The picture is equirectangular: from left to right a full turn, to the right about the vertical,
/// with `ahead` in the middle; from straight up in the first row to straight down in the last.
#[derive(Clone, Copy, Debug)]
pub struct Heading {
    /// Unit length.
    pub up: Vec3,
    /// The direction of the center of the picture: unit length, orthogonal to `up`.
    pub ahead: Vec3,
}

impl Heading {
    /// The unit direction of a position in the picture, `u` and `v` in 0..1 from the upper left.
    pub(in crate::optics) fn direction(&self, u: f64, v: f64) -> DVec3 {
        let (up, ahead) = (self.up.as_dvec3(), self.ahead.as_dvec3());
        let right = ahead.cross(up);
        let (azimuth, polar) = ((u - 0.5) * 2.0 * PI, v * PI);
        (ahead * azimuth.cos() + right * azimuth.sin()) * polar.sin() + up * polar.cos()
    }
}

/// Three lobes that stand for a surrounding.
#[derive(Clone, Debug)]
pub struct WindowModel {
    /// Sun, sky, ground.
    pub lobes: [Lobe; 3],
    /// Linear RGB in the units of the picture.
    pub radiance: [Vec3; 3],
    /// The fraction of the luminous flux through the window with another direction than in the
    /// surrounding, 0..=1.
    ///
    /// It is the integral of m |L - lobes| / 2 over that of m L. The whole flux is the
    /// surrounding's.
    pub misplaced: f64,
}

/// A direction of the surrounding and its radiance.
#[derive(Clone, Copy)]
struct Sample {
    direction: DVec3,
    radiance: DVec3,
    /// Steradians.
    solid: f64,
    /// Steradians times the cosine to the window's outward normal.
    weight: f64,
}

tuning! {
    /// Constants of the fit of sun, sky and ground to a picture of a surrounding.
    pub const TUNING: WindowModelTuning {
        /// Largest width of a picture, 0.35 degrees a pixel; wider ones are averaged.
        max_width: usize = 1024,
            unit "pixels", source Taste, effect "a larger value is slower and finds the sun's position more exactly";
        /// Edge of the tiles to which sky and ground are fitted, 2.8 degrees.
        tile: usize = 8,
            unit "pixels", source Taste, effect "a larger value is faster and coarser";
        /// Least number of tiles in the width of a picture.
        min_tiles: usize = 16,
            unit "tiles", source Taste, effect "a larger value fits small pictures more finely";
        /// Range of the bandwidth of a sun: a broader peak is a part of the sky.
        sun_bandwidth: [f64; 2] = [30.0, 1e5],
            unit "1", source Derived("the sun's disc has about the largest"),
            effect "a larger least value finds fewer suns";
        /// Least flux of a sun.
        sun_flux: f64 = 0.01,
            unit "the flux of the surrounding", source Taste, effect "a larger value finds fewer suns";
        /// Angle from the brightest direction within which the sun is sought at first.
        sun_radius: f64 = 0.1,
            unit "radians", source Taste, effect "a larger value takes more of the bright sky for the sun";
        /// Outer radius of the annulus that shows the sky around the sun.
        annulus: f64 = 1.6,
            unit "its inner radius", source Taste, effect "a larger value averages more of the sky";
        /// Iterations of the sun's fit, each of which moves and narrows the circle.
        sun_iterations: usize = 16,
            unit "iterations", source Taste, effect "a larger value is slower and more exact";
        /// Exponent at the boundary of the sun: exp(-8) of its radiance is left there.
        sun_exponent: f64 = 8.0,
            unit "1", source Taste, effect "a larger value makes the circle wider";
        /// Least cosine of the sun's radius: 20 degrees.
        sun_cosine: f64 = 0.94,
            unit "1", source Taste, effect "a larger value makes the largest circle narrower";
        /// Bandwidth of the sun's lobe where there is not a sun.
        no_sun_bandwidth: f32 = 1e4,
            unit "1", source Taste, effect "none: that lobe has no radiance";
        /// Range of the bandwidths of sky and ground.
        broad: [f64; 2] = [0.05, 60.0],
            unit "1", source Taste, effect "a wider range lets them become sharper or more even";
        /// Bandwidth of sky and ground at the start of the descent.
        broad_start: f64 = 1.5,
            unit "1", source Taste, effect "another value may end in another minimum";
        /// Starts of the descent: the upward part of the direction of the sky, and the downward
        /// part of that of the ground.
        broad_starts: [[f64; 2]; 3] = [[1.0, 1.0], [0.2, 0.2], [4.0, 0.3]],
            unit "the outward normal", source Taste, effect "more starts are slower and find a better minimum";
        /// Largest number of steps of the descent.
        max_steps: usize = 60,
            unit "steps", source Taste, effect "a larger value is slower and more exact";
        /// Step of the finite differences.
        difference: f64 = 1e-4,
            unit "units of the parameters", source Taste, effect "a larger value makes the derivatives less exact";
        /// Longest step of a parameter.
        longest_step: f64 = 0.5,
            unit "radians; logarithm of the bandwidth", source Taste,
            effect "a larger value converges faster or fails";
        /// Damping of the descent: at the start, least, and largest, beyond which it ends.
        damping: [f64; 3] = [1e-3, 1e-9, 1e8],
            unit "1", source Paper("Marquardt 1963"), effect "another value changes the speed of convergence";
        /// Factors of the damping after a step that lowers the cost, and after one that does not.
        damping_factors: [f64; 2] = [0.3, 4.0],
            unit "1", source Taste, effect "other values change the speed of convergence";
        /// Least decrease of the cost that continues the descent.
        min_decrease: f64 = 1e-9,
            unit "the cost", source Taste, effect "a larger value ends the descent earlier";
        /// Least curvature of a parameter.
        min_curvature: f64 = 1e-12,
            unit "the largest curvature", source Taste, effect "a larger value slows parameters with little effect";
    }
}

/// The sun, sky and ground fitted to the part of `picture` that a window in a wall with the outward
/// normal `outside` shows. Without `has_sun`, sky and ground take all of it.
pub fn fit_window_model(
    picture: &Plane<Vec3>,
    heading: Heading,
    outside: Vec3,
    has_sun: bool,
) -> WindowModel {
    let fine = reduced(picture, picture.width().div_ceil(TUNING.max_width).max(1));
    let normal = outside.as_dvec3();
    let samples = samples(&fine, heading, normal);
    let sun = has_sun.then(|| sun(&samples, PI / fine.height() as f64)).flatten();
    // Without the sun, and coarser.
    let rest = match &sun {
        Some(sun) => without(&fine, heading, sun),
        None => fine.clone(),
    };
    let broad: Vec<Sample> = self::samples(
        &reduced(&rest, TUNING.tile.min(fine.width() / TUNING.min_tiles).max(1)),
        heading,
        normal,
    );
    let [(sky, sky_radiance), (ground, ground_radiance)] =
        broad_lobes(&broad, heading.up.as_dvec3(), normal);
    let daylight = Lobe { direction: sky.direction, bandwidth: TUNING.no_sun_bandwidth };
    let (inside, sun_flux) = match &sun {
        Some(sun) => {
            (sun.boundary, sun.excess * sun.lobe.direction.as_dvec3().dot(normal).max(0.0))
        }
        None => (f64::INFINITY, DVec3::ZERO),
    };
    let center = sun.as_ref().map_or(sky.direction, |sun| sun.lobe.direction).as_dvec3();

    // Sky and ground carry the remaining radiance per channel: least squares alone lose some of it.
    let from_broad = |l: DVec3| sky_radiance * value(&sky, l) + ground_radiance * value(&ground, l);
    let (mut whole, mut from_both) = (DVec3::ZERO, DVec3::ZERO);
    for s in &samples {
        whole += s.weight * s.radiance;
        from_both += s.weight * from_broad(s.direction);
    }
    let factor = [0, 1, 2].map(|c| {
        if from_both[c] > 0.0 { ((whole - sun_flux)[c] / from_both[c]).max(0.0) } else { 0.0 }
    });
    let factor = DVec3::from_array(factor);

    // The sun may be smaller than a pixel, so that its pixels count as one.
    let y = |rgb: DVec3| f64::from(luminance(rgb.as_vec3()));
    let (mut apart, mut near) = (0.0, -sun_flux);
    for s in &samples {
        let differs = s.weight * (s.radiance - factor * from_broad(s.direction));
        if s.direction.dot(center) > inside { near += differs } else { apart += y(differs).abs() }
    }
    let misplaced = 0.5 * (apart + y(near).abs()) / y(whole).max(f64::MIN_POSITIVE);
    let (sun, sun_radiance) = sun.map_or((daylight, DVec3::ZERO), |sun| (sun.lobe, sun.radiance));
    let radiance =
        [sun_radiance, factor * sky_radiance, factor * ground_radiance].map(|w| w.as_vec3());
    WindowModel { lobes: [sun, sky, ground], radiance, misplaced }
}

fn value(lobe: &Lobe, l: DVec3) -> f64 {
    (f64::from(lobe.bandwidth) * (lobe.direction.as_dvec3().dot(l) - 1.0)).exp()
}

/// Means of blocks of `by` x `by` pixels, weighted by the solid angle of their rows; not finite
/// counts as black.
fn reduced(picture: &Plane<Vec3>, by: usize) -> Plane<Vec3> {
    let (width, height) = (picture.width().div_ceil(by), picture.height().div_ceil(by));
    let row_weight = |y: usize| (PI * (y as f64 + 0.5) / picture.height() as f64).sin();
    let block = |x: usize, y: usize| {
        let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
        for py in y * by..((y + 1) * by).min(picture.height()) {
            for px in x * by..((x + 1) * by).min(picture.width()) {
                let pixel = picture.get(px, py);
                let weight = row_weight(py);
                sum += if pixel.is_finite() {
                    pixel.max(Vec3::ZERO).as_dvec3() * weight
                } else {
                    DVec3::ZERO
                };
                weights += weight;
            }
        }
        (sum / weights).as_vec3()
    };
    Plane::new(width, height, (0..width * height).map(|i| block(i % width, i / width)).collect())
}

/// The directions of a picture in front of the wall.
fn samples(picture: &Plane<Vec3>, heading: Heading, outside: DVec3) -> Vec<Sample> {
    let (width, height) = (picture.width() as f64, picture.height() as f64);
    let sample = |(i, pixel): (usize, &Vec3)| {
        let (x, y) = ((i % picture.width()) as f64, (i / picture.width()) as f64);
        let direction = heading.direction((x + 0.5) / width, (y + 0.5) / height);
        // The exact solid angle of the pixel.
        let band = (PI * y / height).cos() - (PI * (y + 1.0) / height).cos();
        let (solid, cosine) = (band * 2.0 * PI / width, direction.dot(outside));
        (cosine > 0.0).then(|| Sample {
            direction,
            radiance: pixel.as_dvec3(),
            solid,
            weight: solid * cosine,
        })
    };
    picture.pixels().iter().enumerate().filter_map(sample).collect()
}

struct SunDisc {
    lobe: Lobe,
    radiance: DVec3,
    /// Its radiance times its solid angle.
    excess: DVec3,
    /// Cosine of the sun's radius.
    boundary: f64,
    /// Radiance of the sky in the annulus around it.
    annulus: DVec3,
}

/// The sun among these directions, `pixel` radians apart.
fn sun(samples: &[Sample], pixel: f64) -> Option<SunDisc> {
    let y = |rgb: DVec3| f64::from(luminance(rgb.as_vec3()));
    let brighter =
        |a: Option<&'_ Sample>, b: &'_ Sample| a.is_none_or(|a| y(b.radiance) > y(a.radiance));
    let mut peak: Option<&Sample> = None;
    for sample in samples {
        if brighter(peak, sample) {
            peak = Some(sample);
        }
    }
    let peak = peak?;
    let (mut direction, mut radius, mut bandwidth, mut annulus) =
        (peak.direction, TUNING.sun_radius, 0.0, DVec3::ZERO);
    let mut excess = DVec3::ZERO;
    for _ in 0..TUNING.sun_iterations {
        let (boundary, outer) = (f64::cos(radius), f64::cos(TUNING.annulus * radius));
        let near =
            samples.iter().map(|s| (s, s.direction.dot(direction))).filter(|(_, cos)| *cos > outer);
        let (mut around, mut around_solid) = (DVec3::ZERO, 0.0);
        for (s, _) in near.clone().filter(|(_, cos)| *cos <= boundary) {
            around += s.radiance * s.solid;
            around_solid += s.solid;
        }
        annulus = if around_solid > 0.0 { around / around_solid } else { DVec3::ZERO };
        let (mut moment, mut sum) = (DVec3::ZERO, 0.0);
        excess = DVec3::ZERO;
        for (s, _) in near.filter(|(_, cos)| *cos > boundary) {
            let rises = (s.radiance - annulus).max(DVec3::ZERO) * s.solid;
            excess += rises;
            // About the middle found so far, so that no digits are lost.
            moment += y(rises) * (s.direction - direction);
            sum += y(rises);
        }
        if sum <= 0.0 {
            return None;
        }
        let mean = moment / sum;
        // 1 - |mean of l| = 1/b for a sharp lobe; the pixels themselves are that wide: pixel^2 /
        // 12.
        let to_mean = direction + mean;
        let fall = (-(2.0 * mean.dot(direction) + mean.length_squared())
            / (1.0 + to_mean.length()))
            - pixel * pixel / 12.0;
        bandwidth =
            (1.0 / fall.max(1.0 / TUNING.sun_bandwidth[1])).clamp(1.0, TUNING.sun_bandwidth[1]);
        direction = to_mean.normalize();
        radius =
            (1.0 - TUNING.sun_exponent / bandwidth).max(TUNING.sun_cosine).acos().max(2.0 * pixel);
    }
    let flux: f64 = samples.iter().map(|s| s.solid * y(s.radiance)).sum();
    if bandwidth < TUNING.sun_bandwidth[0] || y(excess) < TUNING.sun_flux * flux {
        return None;
    }
    let solid = 2.0 * PI * -(-2.0 * bandwidth).exp_m1() / bandwidth;
    let lobe = Lobe { direction: direction.as_vec3(), bandwidth: bandwidth as f32 };
    Some(SunDisc { lobe, radiance: excess / solid, excess, boundary: radius.cos(), annulus })
}

/// The surrounding with the sky around the sun in place of the sun.
fn without(picture: &Plane<Vec3>, heading: Heading, sun: &SunDisc) -> Plane<Vec3> {
    let (width, height) = (picture.width(), picture.height());
    let center = sun.lobe.direction.as_dvec3();
    let pixel = |i: usize| {
        let (u, v) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        let inside =
            heading.direction(u / width as f64, v / height as f64).dot(center) > sun.boundary;
        let old = picture.pixels()[i];
        if inside { old.min(sun.annulus.as_vec3()) } else { old }
    };
    Plane::new(width, height, (0..width * height).map(pixel).collect())
}

/// Directions (on the tangent plane of where they began) and logarithms of bandwidths of two lobes.
type LobePair = [f64; 6];

/// The upper and the lower lobe with their radiances.
fn broad_lobes(samples: &[Sample], up: DVec3, outside: DVec3) -> [(Lobe, DVec3); 2] {
    let towards = |up: DVec3| (up + outside).try_normalize().unwrap_or(outside);
    let starts =
        TUNING.broad_starts.map(|[sky, ground]| [towards(up * sky), towards(-up * ground)]);
    let fits =
        starts.into_iter().map(|start| descend(samples, start, [TUNING.broad_start.ln(); 2]));
    let best = fits.reduce(|a, b| if b.0 < a.0 { b } else { a }).expect("there are starts").1;
    let radiance = radiances(samples, &best);
    let mut all = [0, 1].map(|k| (best[k], radiance[k]));
    if all[0].0.direction.as_dvec3().dot(up) < all[1].0.direction.as_dvec3().dot(up) {
        all.swap(0, 1);
    }
    all
}

fn lobes(start: &[DVec3; 2], form: &LobePair) -> [Lobe; 2] {
    [0, 1].map(|k| {
        let (s, t) = start[k].any_orthonormal_pair();
        let direction = (start[k] + s * form[3 * k] + t * form[3 * k + 1]).normalize();
        let bandwidth = form[3 * k + 2].exp().clamp(TUNING.broad[0], TUNING.broad[1]);
        Lobe { direction: direction.as_vec3(), bandwidth: bandwidth as f32 }
    })
}

/// The cost and the lobes at the end of a Levenberg-Marquardt descent from these directions.
fn descend(samples: &[Sample], start: [DVec3; 2], log_bandwidth: [f64; 2]) -> (f64, [Lobe; 2]) {
    let mut form: LobePair = [0.0, 0.0, log_bandwidth[0], 0.0, 0.0, log_bandwidth[1]];
    let mut residual = residuals(samples, &lobes(&start, &form));
    let cost = |residual: &[f64]| residual.iter().map(|r| r * r).sum::<f64>();
    let mut best = cost(&residual);
    let mut damping = TUNING.damping[0];
    for _ in 0..TUNING.max_steps {
        let columns: Vec<Vec<f64>> = (0..6)
            .map(|k| {
                let mut moved = form;
                moved[k] += TUNING.difference;
                let moved = residuals(samples, &lobes(&start, &moved));
                moved.iter().zip(&residual).map(|(a, b)| (a - b) / TUNING.difference).collect()
            })
            .collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let gram: Vec<f64> =
            columns.iter().flat_map(|a| columns.iter().map(|b| dot(a, b))).collect();
        let slope: Vec<f64> = columns.iter().map(|a| -dot(a, &residual)).collect();
        // A parameter without effect, such as the direction of a uniform lobe, has a slope of zero
        // and stays.
        let floor =
            TUNING.min_curvature * (0..6).map(|k| gram[7 * k]).fold(f64::MIN_POSITIVE, f64::max);
        let mut improved = false;
        while damping < TUNING.damping[2] {
            let mut damped = gram.clone();
            (0..6).for_each(|k| damped[7 * k] += damping * gram[7 * k] + floor);
            let Some(step) = solve_free(&damped, &slope, &[true; 6]) else {
                damping *= TUNING.damping_factors[1];
                continue;
            };
            let moved: LobePair = std::array::from_fn(|k| {
                form[k] + step[k].clamp(-TUNING.longest_step, TUNING.longest_step)
            });
            let moved_residual = residuals(samples, &lobes(&start, &moved));
            let now = cost(&moved_residual);
            if now < best {
                improved = best - now > TUNING.min_decrease * best;
                (form, residual, best) = (moved, moved_residual, now);
                damping = (damping * TUNING.damping_factors[0]).max(TUNING.damping[1]);
                break;
            }
            damping *= TUNING.damping_factors[1];
        }
        if !improved {
            break;
        }
    }
    (best, lobes(&start, &form))
}

/// The residuals sqrt(m) (L - w1 G1 - w2 G2), channel by channel, with the best radiances w.
fn residuals(samples: &[Sample], lobes: &[Lobe; 2]) -> Vec<f64> {
    let w = radiances(samples, lobes);
    let residual = |s: &Sample| {
        let modeled = w[0] * value(&lobes[0], s.direction) + w[1] * value(&lobes[1], s.direction);
        ((s.radiance - modeled) * s.weight.sqrt()).to_array()
    };
    samples.iter().flat_map(residual).collect()
}

/// The non-negative radiances of two lobes with the least squares; per channel.
fn radiances(samples: &[Sample], lobes: &[Lobe; 2]) -> [DVec3; 2] {
    let (mut aa, mut ab, mut bb, mut al, mut bl) = (0.0, 0.0, 0.0, DVec3::ZERO, DVec3::ZERO);
    for s in samples {
        let (a, b) = (value(&lobes[0], s.direction), value(&lobes[1], s.direction));
        aa += s.weight * a * a;
        ab += s.weight * a * b;
        bb += s.weight * b * b;
        al += s.weight * a * s.radiance;
        bl += s.weight * b * s.radiance;
    }
    let channel = |c: usize| nnls(&[aa, ab, ab, bb], &[al[c], bl[c]]);
    let [r, g, b] = [channel(0), channel(1), channel(2)];
    [0, 1].map(|k| DVec3::new(r[k], g[k], b[k]))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADING: Heading = Heading { up: Vec3::Y, ahead: Vec3::NEG_Z };

    fn painted(width: usize, radiance: impl Fn(DVec3) -> DVec3) -> Plane<Vec3> {
        let height = width / 2;
        let pixel = |i: usize| {
            let (u, v) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            radiance(HEADING.direction(u / width as f64, v / height as f64)).as_vec3()
        };
        Plane::new(width, height, (0..width * height).map(pixel).collect())
    }

    #[test]
    fn the_middle_lies_ahead_and_the_right_to_the_right() {
        let at = |u: f64, v: f64| HEADING.direction(u, v).as_vec3();
        for (u, v, wanted) in [
            (0.5, 0.5, Vec3::NEG_Z),
            (0.75, 0.5, Vec3::X),
            (0.25, 0.5, Vec3::NEG_X),
            (0.5, 0.0, Vec3::Y),
        ] {
            assert!((at(u, v) - wanted).length() < 1e-6, "{u} {v}");
        }
    }

    #[test]
    fn three_known_lobes_are_found_again() {
        let outside = Vec3::new(0.3, 0.0, -1.0).normalize();
        let towards = |x: f32, y: f32, z: f32| Vec3::new(x, y, z).normalize();
        for (sharp, width) in [(300.0, 512), (4000.0, 1024)] {
            let wanted = [
                (
                    Lobe { direction: towards(0.4, 0.6, -0.8), bandwidth: sharp },
                    DVec3::new(900.0, 800.0, 600.0),
                ),
                (
                    Lobe { direction: towards(0.2, 0.7, -0.6), bandwidth: 2.0 },
                    DVec3::new(2.0, 3.0, 5.0),
                ),
                (
                    Lobe { direction: towards(-0.3, -0.8, -0.5), bandwidth: 3.0 },
                    DVec3::new(1.5, 1.2, 0.8),
                ),
            ];
            let picture =
                painted(width, |l| wanted.iter().map(|(lobe, w)| *w * value(lobe, l)).sum());
            let got = fit_window_model(&picture, HEADING, outside, true);
            for (k, (lobe, w)) in wanted.iter().enumerate() {
                let angle = got.lobes[k].direction.angle_between(lobe.direction).to_degrees();
                // A sharp lobe is a few pixels wide, and the sky below it slopes.
                let most = if k == 0 { 0.1 } else { 1.0 };
                assert!(angle < most, "{sharp}: lobe {k} is {angle} degrees off");
                let ratio = got.lobes[k].bandwidth / lobe.bandwidth;
                assert!((ratio - 1.0).abs() < 0.05, "{sharp}: bandwidth of lobe {k} times {ratio}");
                let ratio = got.radiance[k].as_dvec3() / *w;
                assert!(
                    (ratio - 1.0).abs().max_element() < 0.05,
                    "{sharp}: radiance of lobe {k} times {ratio}"
                );
            }
            assert!(got.misplaced < 0.02, "{}", got.misplaced);
        }
    }

    #[test]
    fn an_even_sky_has_no_sun() {
        let got = fit_window_model(
            &painted(128, |_| DVec3::new(1.0, 2.0, 3.0)),
            HEADING,
            Vec3::NEG_Z,
            true,
        );
        assert_eq!(got.radiance[0], Vec3::ZERO);
        assert!(got.misplaced < 0.02, "{}", got.misplaced);
    }

    /// The light through the window is as much as before, for any environment.
    #[test]
    fn no_light_is_lost() {
        let patches = |l: DVec3| {
            let sun =
                if l.dot(DVec3::new(0.3, 0.5, -0.8).normalize()) > 0.999 { 500.0 } else { 0.0 };
            let street =
                if l.y < 0.1 { DVec3::new(0.4, 0.3, 0.2) } else { DVec3::new(1.0, 1.5, 3.0) };
            street * (1.5 + (9.0 * l.x).sin() * (7.0 * l.y).cos()) + DVec3::splat(sun)
        };
        let picture = painted(512, patches);
        let got = fit_window_model(&picture, HEADING, Vec3::NEG_Z, true);
        let through = |radiance: &dyn Fn(DVec3) -> DVec3| -> DVec3 {
            samples(&painted(512, radiance), HEADING, DVec3::NEG_Z)
                .iter()
                .map(|s| s.weight * s.radiance)
                .sum()
        };
        let lobes =
            |l: DVec3| (0..3).map(|k| got.radiance[k].as_dvec3() * value(&got.lobes[k], l)).sum();
        let ratio = through(&lobes) / through(&patches);
        assert!((ratio - 1.0).abs().max_element() < 0.01, "{ratio}");
        assert!((0.02..0.3).contains(&got.misplaced), "{}", got.misplaced);
    }

    #[test]
    fn whatever_the_picture_the_answer_is_finite() {
        let strange = [
            painted(16, |_| DVec3::ZERO),
            painted(2, |_| DVec3::ONE),
            Plane::filled(1, 1, Vec3::ONE),
            painted(64, |l| DVec3::splat(if l.y > 0.999 { 1e30 } else { 0.0 })),
            painted(64, |l| DVec3::splat(if l.x > 0.5 { f64::INFINITY } else { -1.0 })),
            painted(64, |l| DVec3::splat(if l.z < -0.995 { 1e4 } else { 0.0 })),
        ];
        for picture in &strange {
            let got = fit_window_model(picture, HEADING, Vec3::NEG_Z, true);
            assert!(
                got.lobes
                    .iter()
                    .all(|lobe| lobe.direction.is_normalized() && lobe.bandwidth.is_finite())
            );
            assert!(
                got.radiance.iter().all(|w| w.is_finite() && w.min_element() >= 0.0),
                "{:?}",
                got.radiance
            );
            assert!(got.misplaced.is_finite());
        }
    }
}
