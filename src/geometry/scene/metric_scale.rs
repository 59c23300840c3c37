//! Metric depth from the output of depth networks and known lengths.
//!
//! A network for **relative** depth returns q = a / z + b of the planar depth z with unknown a > 0
//! and b: its training loss is invariant to both (MiDaS: Ranftl et al., TPAMI 2022; DPT: Ranftl et
//! al., ICCV 2021; Depth Anything: Yang et al., CVPR and NeurIPS 2024). So
//!
//! z = s / (q + t), s = 1 / a, t = -b / a in units of q.
//!
//! The **span** is how many times farther the farthest is than the nearest: the depths behind
//! which, and before which, `TUNING.tail` of the pixels lie. It is equivalent to t, and a person
//! can judge it: with e = q_far + t,
//!
//! e = (q_near - q_far) / (span - 1).
//!
//! One length gives s; two or more give t as well, where they lie at different depths. A network
//! for **metric** depth returns z in meters; its usual error is one common factor, which a known
//! length removes.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::geometry::Camera;
use crate::image::Plane;
use crate::tuning::tuning;

tuning! {
    /// Constants of metric depth from relative depth and known lengths.
    pub const TUNING: MetricScaleTuning {
        /// Fraction of the pixels that are taken neither for the nearest nor for the farthest of a
        /// room.
        tail: f64 = 0.05,
            unit "1", source Taste, effect "a larger value ignores more outliers";
        /// Largest depth over the farthest of the room: what lies there is the view from a window,
        /// or nothing at all.
        beyond: f64 = 4.0,
            unit "1", source Taste, effect "a larger value lets views through windows lie farther away";
        /// Relative variation of a network's output up to which it is rounding.
        min_variation: f64 = 1e-6,
            unit "1", source Derived("single precision"), effect "a larger value refuses more outputs";
        /// Spans between which lengths may choose.
        spans: (f64, f64) = (1.1, 50.0),
            unit "1", source Taste, effect "a wider range admits flatter and deeper rooms";
        /// Least gain of the fit at which lengths determine the span.
        min_gain: f64 = 1e-3,
            unit "fraction of the lengths", source Taste, effect "a larger value keeps the given span more often";
        /// Steps of the grid of spans.
        grid_steps: usize = 64,
            unit "steps", source Taste, effect "a smaller value may end in another minimum";
        /// Steps of the golden section after it.
        golden_steps: usize = 60,
            unit "steps", source Derived("the interval is then below the rounding of 64 bits"),
            effect "a smaller value is less exact";
    }
}

/// Two places in the photo, and how far apart they are in the room.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KnownLength {
    /// Photo pixels from the left and the top.
    pub from: [f32; 2],
    /// The second place, photo pixels from the left and the top.
    pub to: [f32; 2],
    /// The distance between the places, meters.
    #[serde(alias = "metres")]
    pub meters: f32,
}

/// Depth in meters.
#[derive(Clone, Debug, PartialEq)]
pub struct MetricDepth {
    /// Planar z; zero, negative or not finite where a metric network returned no depth.
    pub depth: Plane<f32>,
    /// Meters per unit of 1 / (q + t), or of the network's meters.
    pub scale: f32,
    /// The span of relative depth, as given or as determined by the lengths.
    pub span: Option<f32>,
    /// The largest error of a known length, as a share of it.
    pub misfit: f32,
}

/// Planar depth from the relative depth `network`, which has the aspect ratio of the camera's
/// photo.
///
/// # Errors
/// The known length that cannot be used, and the reason; none given; a network output without
/// variation.
pub fn relative_depth(
    network: &Plane<f32>,
    camera: &Camera,
    known: &[KnownLength],
    span: f32,
) -> Result<MetricDepth, String> {
    if known.is_empty() {
        return Err(
            "known_lengths: relative depth has no scale: wanted a known length in the photo, as --known-length \
            X,Y,X,Y=METERS, got none"
                .into(),
        );
    }
    let rulers = rulers(network, camera, known)?;
    let (far, near) = (quantile(network, TUNING.tail), quantile(network, 1.0 - TUNING.tail));
    // A real network's output on an even wall varies by more than this; rounding varies by less.
    if near - far <= TUNING.min_variation * near.abs().max(far.abs()) {
        return Err(format!(
            "the network returned no depth: wanted numbers that vary, got {near} nearly everywhere"
        ));
    }
    let least = |span: f64| (near - far) / (span - 1.0);
    let depth = |q: f64, span: f64| 1.0 / (q - far + least(span)).max(least(span) / TUNING.beyond);
    let fit = |span: f64| fit(&rulers, |q| depth(q, span));
    let span = if known.len() > 1 {
        best_span(f64::from(span), |span| fit(span).error)
    } else {
        f64::from(span)
    };
    for (i, ruler) in rulers.iter().enumerate() {
        if ruler.ends.iter().any(|(_, q)| q - far + least(span) <= least(span) / TUNING.beyond) {
            return Err(format!(
                "known_lengths: number {}: an end is beyond the range of the network; wanted one in the room",
                i + 1
            ));
        }
    }
    let ScaleFit { scale, misfit, .. } = fit(span);
    let meters = network.map(|q| (scale * depth(f64::from(q), span)) as f32);
    Ok(MetricDepth {
        depth: meters,
        scale: scale as f32,
        span: Some(span as f32),
        misfit: misfit as f32,
    })
}

/// Planar depth from the output of a metric network; unchanged without a known length.
///
/// # Errors
/// The known length that cannot be used, and the reason.
pub fn metric_depth(
    network: &Plane<f32>,
    camera: &Camera,
    known: &[KnownLength],
) -> Result<MetricDepth, String> {
    if known.is_empty() {
        return Ok(MetricDepth { depth: network.clone(), scale: 1.0, span: None, misfit: 0.0 });
    }
    let rulers = rulers(network, camera, known)?;
    for (i, ruler) in rulers.iter().enumerate() {
        if let Some((_, z)) = ruler.ends.iter().find(|(_, z)| *z <= 0.0) {
            return Err(format!(
                "known_lengths: number {}: wanted ends at which the network returns a depth, got {z} at one",
                i + 1
            ));
        }
    }
    let ScaleFit { scale, misfit, .. } = fit(&rulers, |z| z);
    let depth = network.map(|z| (scale * f64::from(z)) as f32);
    Ok(MetricDepth { depth, scale: scale as f32, span: None, misfit: misfit as f32 })
}

/// A known length: the ray of each end at planar depth 1, and the network's output there.
struct Ruler {
    ends: [(DVec3, f64); 2],
    meters: f64,
}

fn rulers(
    network: &Plane<f32>,
    camera: &Camera,
    known: &[KnownLength],
) -> Result<Vec<Ruler>, String> {
    let ruler = |(i, length): (usize, &KnownLength)| {
        let wrong = |what: String| Err(format!("known_lengths: number {}: {what}", i + 1));
        let &KnownLength { from, to, meters } = length;
        if !(1e-3..=1e3).contains(&meters) {
            return wrong(format!("wanted 0.001 to 1000 m, got {meters}"));
        }
        for [x, y] in [from, to] {
            if !camera.contains([x, y].into()) {
                let (width, height) = (camera.width, camera.height);
                return wrong(format!(
                    "({x}, {y}) is outside the photo, wanted 0..{width} and 0..{height}"
                ));
            }
        }
        if from == to {
            return wrong(format!("wanted two places, got ({}, {}) twice", from[0], from[1]));
        }
        let end = |[x, y]: [f32; 2]| {
            let pixel = |at: f32, from: usize, to: usize| {
                ((at / from as f32 * to as f32) as usize).min(to - 1)
            };
            let q = network.get(
                pixel(x, camera.width, network.width()),
                pixel(y, camera.height, network.height()),
            );
            (camera.unproject(x, y, 1.0).as_dvec3(), f64::from(q))
        };
        Ok(Ruler { ends: [end(from), end(to)], meters: f64::from(meters) })
    };
    known.iter().enumerate().map(ruler).collect()
}

struct ScaleFit {
    scale: f64,
    /// Root mean square of the errors of the lengths, as shares of them.
    error: f64,
    /// The largest of them.
    misfit: f64,
}

/// The scale s that makes sum (s r - 1)^2 least, r the length at scale 1 over the known one:
/// s = sum r / sum r^2.
fn fit(rulers: &[Ruler], depth: impl Fn(f64) -> f64) -> ScaleFit {
    let ratios: Vec<f64> = rulers
        .iter()
        .map(|Ruler { ends: [(a, at_a), (b, at_b)], meters }| {
            (*a * depth(*at_a) - *b * depth(*at_b)).length() / meters
        })
        .collect();
    let scale = ratios.iter().sum::<f64>() / ratios.iter().map(|r| r * r).sum::<f64>();
    let errors = || ratios.iter().map(|r| (scale * r - 1.0).abs());
    let error = (errors().map(|e| e * e).sum::<f64>() / ratios.len() as f64).sqrt();
    ScaleFit { scale, error, misfit: errors().fold(0.0, f64::max) }
}

/// The span of least error: the best of a grid, then golden section around it; `given` where the
/// error hardly depends on it.
fn best_span(given: f64, error: impl Fn(f64) -> f64) -> f64 {
    let (low, high) = ((TUNING.spans.0 - 1.0).ln(), (TUNING.spans.1 - 1.0).ln());
    let span = |u: f64| 1.0 + u.exp();
    let step = (high - low) / TUNING.grid_steps as f64;
    let errors =
        (0..=TUNING.grid_steps).map(|i| low + step * i as f64).map(|u| (u, error(span(u))));
    let (middle, _) = errors.min_by(|a, b| a.1.total_cmp(&b.1)).expect("a grid has points");
    let (mut a, mut b) = ((middle - step).max(low), (middle + step).min(high));
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    for _ in 0..TUNING.golden_steps {
        let (c, d) = (b - golden * (b - a), a + golden * (b - a));
        if error(span(c)) < error(span(d)) { b = d } else { a = c }
    }
    let best = span(0.5 * (a + b));
    if error(given) - error(best) < TUNING.min_gain { given } else { best }
}

/// The value below which this share of the pixels lies.
fn quantile(plane: &Plane<f32>, share: f64) -> f64 {
    let mut values = plane.pixels().to_vec();
    let at = ((values.len() - 1) as f64 * share).round() as usize;
    f64::from(*values.select_nth_unstable_by(at, f32::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (64, 48);

    fn camera() -> Camera {
        Camera::from_fov_x(640, 480, 60.0)
    }

    /// A floor that runs from 1.5 m to 6 m below a wall at 6 m: 1 / z is linear down the picture.
    fn room() -> Plane<f32> {
        Plane::from_fn(SIZE.0, SIZE.1, |_, y| {
            if y < 24 { 6.0 } else { 1.0 / (1.0 / 6.0 + 0.5 * (y - 24) as f32 / 23.0) }
        })
    }

    /// The room as the output of a network for relative depth.
    fn network(a: f32, b: f32) -> Plane<f32> {
        room().map(|z| a / z + b)
    }

    /// The true distance between two places of the photo.
    fn length(from: [f32; 2], to: [f32; 2]) -> KnownLength {
        let point = |[x, y]: [f32; 2]| {
            camera().unproject(x, y, room().get(x as usize / 10, y as usize / 10))
        };
        KnownLength { from, to, meters: point(from).distance(point(to)) }
    }

    fn span_of(depth: &Plane<f32>) -> f32 {
        (quantile(depth, 1.0 - TUNING.tail) / quantile(depth, TUNING.tail)) as f32
    }

    fn worst(got: &Plane<f32>) -> f32 {
        got.pixels()
            .iter()
            .zip(room().pixels())
            .map(|(a, b)| (a / b - 1.0).abs())
            .fold(0.0, f32::max)
    }

    #[test]
    fn one_length_and_the_span_give_the_room() {
        let known = [length([100.0, 50.0], [400.0, 50.0])];
        for (a, b) in [(1.0, 0.0), (20.0, 3.0), (0.01, -0.5), (500.0, 1000.0)] {
            let got = relative_depth(&network(a, b), &camera(), &known, span_of(&room()))
                .expect("it can be solved");
            // Single precision of q, of which b may take digits.
            assert!(worst(&got.depth) < 1e-4, "{a} {b}: {}", worst(&got.depth));
            assert!(got.misfit < 1e-6);
        }
    }

    #[test]
    fn the_known_length_comes_out_whatever_the_span() {
        let known = length([320.0, 100.0], [300.5, 470.0]);
        for span in [1.2, 2.5, 10.0] {
            let got = relative_depth(&network(3.0, 1.0), &camera(), &[known], span)
                .expect("it can be solved")
                .depth;
            let point = |[x, y]: [f32; 2]| {
                camera().unproject(x, y, got.get(x as usize / 10, y as usize / 10))
            };
            assert!(
                (point(known.from).distance(point(known.to)) / known.meters - 1.0).abs() < 1e-4
            );
            assert!((span_of(&got) / span - 1.0).abs() < 1e-3);
        }
    }

    #[test]
    fn two_lengths_tell_the_span() {
        let known = [length([100.0, 50.0], [400.0, 50.0]), length([200.0, 460.0], [500.0, 460.0])];
        let got =
            relative_depth(&network(3.0, 1.0), &camera(), &known, 2.0).expect("it can be solved");
        assert!(
            worst(&got.depth) < 1e-4 && got.misfit < 1e-5,
            "{} {}",
            worst(&got.depth),
            got.misfit
        );
        // On one wall they do not.
        let known = [length([100.0, 50.0], [400.0, 50.0]), length([100.0, 50.0], [100.0, 150.0])];
        let got =
            relative_depth(&network(3.0, 1.0), &camera(), &known, 2.0).expect("it can be solved");
        assert_eq!(got.span, Some(2.0));
        // Lengths that contradict each other are fitted as well as can be, with a large misfit.
        let twice = KnownLength { meters: 2.0 * known[0].meters, ..known[0] };
        let got = relative_depth(&network(3.0, 1.0), &camera(), &[known[0], twice], 2.0)
            .expect("it can be solved");
        assert!(got.misfit > 0.3);
    }

    #[test]
    fn metric_depth_takes_a_common_factor() {
        let network = room().map(|z| 0.7 * z);
        let known = [length([100.0, 50.0], [400.0, 50.0])];
        let got = metric_depth(&network, &camera(), &known).expect("it can be solved");
        assert!(worst(&got.depth) < 1e-5 && (got.scale * 0.7 - 1.0).abs() < 1e-5);
        assert_eq!(
            metric_depth(&network, &camera(), &[]).expect("it needs no length").depth,
            network
        );
    }

    #[test]
    fn what_is_behind_a_pane_is_held_back() {
        // A hundredth of the picture shows a sky, at infinity and below it.
        let mut q = network(3.0, 0.0);
        (0..30).for_each(|x| q.set(x, 0, -0.5 * x as f32));
        let known = length([100.0, 150.0], [400.0, 150.0]);
        let got = relative_depth(&q, &camera(), &[known], 4.0).expect("it can be solved").depth;
        let farthest = quantile(&got, 1.0 - TUNING.tail) as f32;
        assert!(got.pixels().iter().all(|&z| z > 0.0 && z <= 4.001 * farthest));
    }

    #[test]
    fn lengths_that_cannot_be_are_named() {
        let sound = length([100.0, 50.0], [400.0, 50.0]);
        let mut q = network(3.0, 0.0);
        q.set(0, 0, -50.0);
        let message = |length: KnownLength| {
            relative_depth(&q, &camera(), &[sound, length], 4.0).expect_err("it is wrong")
        };
        for (length, wanted) in [
            (
                KnownLength { to: sound.from, ..sound },
                "number 2: wanted two places, got (100, 50) twice",
            ),
            (
                KnownLength { to: [640.0, 1.0], ..sound },
                "number 2: (640, 1) is outside the photo, wanted 0..640 and 0..480",
            ),
            (KnownLength { from: [-0.1, 1.0], ..sound }, "number 2: (-0.1, 1) is outside"),
            (KnownLength { meters: 0.0, ..sound }, "number 2: wanted 0.001 to 1000 m, got 0"),
            (
                KnownLength { from: [5.0, 5.0], ..sound },
                "number 2: an end is beyond the range of the network",
            ),
        ] {
            assert!(message(length).contains(wanted), "{}", message(length));
        }
        assert!(
            relative_depth(&q, &camera(), &[], 4.0)
                .expect_err("it has no scale")
                .contains("--known-length X,Y,X,Y=METERS")
        );
        let even = Plane::filled(64, 48, 7.0);
        assert!(
            relative_depth(&even, &camera(), &[sound], 4.0)
                .expect_err("it is even")
                .contains("got 7 nearly everywhere")
        );
        let hole = room().map(|z| if z > 5.0 { 0.0 } else { z });
        assert!(
            metric_depth(&hole, &camera(), &[sound])
                .expect_err("a hole")
                .contains("wanted ends at which the network returns a depth, got 0")
        );
    }
}
