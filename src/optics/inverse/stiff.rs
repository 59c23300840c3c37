//! Stiff cases of the fit, and the same fit by other means: albedos and radiances simply in turns,
//! nothing projected; rows instead of normal equations, Householder's QR instead of Cholesky, every
//! set of active bounds instead of Lawson and Hanson's path.

use super::*;
use crate::optics::inverse::fit_problem::likely_color;
use crate::optics::inverse::observations::white_level;
use crate::optics::rows::{Rows, enumerated};

/// A hundred names for one light are one unknown, whose light they share evenly.
#[test]
fn equal_columns_are_one_unknown() {
    let layers = vec![falloff(400, 0.0), falloff(400, 1.0)];
    let row = row(layers.clone(), &[Vec3::new(0.3, 0.25, 0.2), Vec3::new(0.05, 0.1, 0.15)], 4);
    let observations = row.observations();
    let plain = |layer| Column::new(Role::Visible, layer);
    let prior = LightPrior { sun: 0.1, ..LightPrior::default() };
    let of = |columns: &[Column]| fit_radiances(&observations, columns, &prior, 60);
    let one = of(&[plain(&layers[0]), plain(&layers[1])]);
    let names: Vec<Column> = (0..101).map(|i| plain(&layers[usize::from(i == 50)])).collect();
    let many = of(&names);
    assert_eq!((one.unknowns, many.unknowns, many.radiance.len()), (2, 2, 101));
    assert!(many.radiance.iter().enumerate().all(|(i, w)| i == 50 || *w == many.radiance[0]));
    let off = |got: Vec3, want: Vec3| ((got - want) / want).abs().max_element();
    assert!(
        off(100.0 * many.radiance[0], one.radiance[0]) < 1e-2,
        "{:?} of {:?}",
        many.radiance[0],
        one.radiance[0]
    );
    assert!(
        off(many.radiance[50], one.radiance[1]) < 1e-2,
        "{:?} of {:?}",
        many.radiance[50],
        one.radiance[1]
    );
    assert_eq!(many.conditioning.most_correlated, Some([0, 1]));
    assert!(many.conditioning.number >= 1e15 && one.conditioning.number < 1e6);
    // Another cost is another column.
    let dear = Column::new(Role::Sun, &layers[0]);
    assert_eq!(of(&[plain(&layers[0]), dear]).unknowns, 2);
}

/// `pixels` in `segments` stretches of paint under lights that fall off from places along the row.
struct PixelRow {
    layers: Vec<Vec<Vec3>>,
    photo: Vec<Vec3>,
    segment: Vec<u32>,
}

fn falloff(pixels: usize, from: f32) -> Vec<Vec3> {
    (0..pixels)
        .map(|p| Vec3::splat(1.0 / (0.3 + (p as f32 / pixels as f32 - from).powi(2))))
        .collect()
}

fn row(layers: Vec<Vec<Vec3>>, radiance: &[Vec3], segments: usize) -> PixelRow {
    let n = layers[0].len();
    let paint =
        [Vec3::splat(0.8), Vec3::new(0.7, 0.3, 0.2), Vec3::new(0.2, 0.3, 0.6), Vec3::splat(0.4)];
    let segment: Vec<u32> = (0..n).map(|p| (p * segments / n) as u32).collect();
    let lit = |p: usize| layers.iter().zip(radiance).map(|(u, w)| *w * u[p]).sum::<Vec3>();
    let photo = (0..n).map(|p| paint[segment[p] as usize % 4] * lit(p)).collect();
    PixelRow { layers, photo, segment }
}

impl PixelRow {
    fn observations(&self) -> Observations {
        let segments = self.segment.iter().max().map_or(0, |s| *s as usize + 1);
        Observations {
            photo: self.photo.clone(),
            segment: self.segment.clone(),
            segments,
            saturated: vec![false; self.photo.len()],
            white: white_level(self.photo.iter().map(|&pixel| (pixel, false))),
        }
    }

    fn columns(&self) -> Vec<Column<'_>> {
        self.layers.iter().map(|layer| Column::new(Role::Visible, layer)).collect()
    }

    fn fit(&self) -> RadianceFit {
        fit_until(&self.observations(), &self.columns(), &LightPrior::default(), 400, 1e-13)
    }
}

/// The radiances that [`fit_radiances`] settles at, without penalties and saturation.
fn twin(row: &PixelRow, iterations: usize) -> Vec<[f64; 3]> {
    let (n, k) = (row.photo.len(), row.layers.len());
    let segments = row.observations().segments;
    let white = f64::from(row.observations().white);
    let sum_of = |j: usize, c: usize| row.layers[j].iter().map(|v| f64::from(v[c])).sum::<f64>();
    let means: Vec<f64> =
        (0..k).map(|j| (sum_of(j, 0) + sum_of(j, 1) + sum_of(j, 2)) / (3 * n) as f64).collect();
    let mut w = vec![[1.0 / k as f64; 3]; k];
    for _ in 0..iterations {
        let mut rows: Rows = Vec::new();
        let mut color_weights = vec![0.0; k];
        for c in 0..3 {
            let mut push = |entries: &dyn Fn(usize) -> f64, right: f64| {
                let mut line = vec![0.0; 3 * k + 1];
                (0..k).for_each(|j| line[c * k + j] = entries(j));
                line[3 * k] = right;
                rows.push(line);
            };
            let u = |j: usize, p: usize| f64::from(row.layers[j][p][c]) / means[j];
            let photo = |p: usize| f64::from(row.photo[p][c]) / white;
            let base = |p: usize| photo(p).sqrt() / (photo(p) + 0.05).powi(2);
            let shading = |p: usize| (0..k).map(|j| w[j][c] * u(j, p)).sum::<f64>();
            let energy: f64 = (0..n).map(|p| base(p) * photo(p).powi(2)).sum();
            for s in 0..segments {
                let own: Vec<usize> = (0..n).filter(|&p| row.segment[p] as usize == s).collect();
                let sum = |f: &dyn Fn(usize) -> f64| own.iter().map(|&p| f(p)).sum::<f64>();
                let albedo = sum(&|p| base(p) * photo(p) * shading(p))
                    / sum(&|p| base(p) * shading(p).powi(2));
                let residual = |p: usize| photo(p) - albedo * shading(p);
                let weight =
                    |p: usize| base(p) / (1.0 + (residual(p) / (0.15 * photo(p) + 0.01)).powi(2));
                own.iter().for_each(|&p| {
                    push(&|j| weight(p).sqrt() * albedo * u(j, p), weight(p).sqrt() * photo(p))
                });
                let norm = sum(&|p| weight(p) * shading(p).powi(2));
                for (j, weight_of) in color_weights.iter_mut().enumerate() {
                    let along = sum(&|p| weight(p) * u(j, p) * shading(p)) / norm;
                    let left =
                        sum(&|p| weight(p) * (albedo * (u(j, p) - along * shading(p))).powi(2));
                    *weight_of += FIT_PROBLEM.color_weight / 3.0 * left;
                }
            }
            push(&|j| energy.sqrt() * sum_of(j, c) / means[j] / n as f64, energy.sqrt());
        }
        for (j, weight_of) in color_weights.iter().enumerate() {
            let d = likely_color(w[j]);
            for c in 0..3 {
                let mut line = vec![0.0; 3 * k + 1];
                (0..3).for_each(|e| {
                    line[e * k + j] = weight_of.sqrt() * (f64::from(u8::from(c == e)) - d[c] * d[e])
                });
                rows.push(line);
            }
        }
        for (i, x) in enumerated(&rows).into_iter().enumerate() {
            w[i % k][i / k] += FIT_PROBLEM.step_fraction * (x - w[i % k][i / k]);
        }
    }
    for c in 0..3 {
        let mean: f64 = (0..k).map(|j| w[j][c] * sum_of(j, c) / means[j] / n as f64).sum();
        w.iter_mut().for_each(|v| v[c] /= mean);
    }
    w.iter()
        .zip(&means)
        .map(|(w, mean)| {
            w.map(|v| v.max(RADIANCE_FIT.min_channel * w[0].max(w[1]).max(w[2])) / mean)
        })
        .collect()
}

/// Largest relative difference of a light's radiances from the twin's.
fn distance(fit: &RadianceFit, twin: &[[f64; 3]]) -> f64 {
    let pairs = fit
        .radiance
        .iter()
        .zip(twin)
        .flat_map(|(a, b)| (0..3).map(move |c| (f64::from(a[c]), b[c])));
    pairs.map(|(a, b)| (a - b).abs() / b.abs().max(1e-30)).fold(0.0, f64::max)
}

const W: [Vec3; 3] =
    [Vec3::new(0.3, 0.25, 0.2), Vec3::new(0.2, 0.2, 0.2), Vec3::new(0.1, 0.1, 0.12)];

/// Two lights 0.3 of the row apart and one at its end.
fn three() -> PixelRow {
    row(vec![falloff(60, 0.0), falloff(60, 0.3), falloff(60, 1.0)], &W, 3)
}

/// Radiances are rounded to 32 bits (6e-8); the twin has settled to far less.
#[test]
fn lights_that_differ_agree_with_the_twin() {
    let row = three();
    let fit = row.fit();
    let off = distance(&fit, &twin(&row, 600));
    assert!(off < 1e-6 && fit.unsettled.is_empty(), "{off:e} {fit:?}");
}

/// A light that gives nothing must end at the bound, and the others where they were without it.
#[test]
fn a_light_at_its_bound_agrees_with_the_twin() {
    let PixelRow { layers, segment, .. } = three();
    let row = PixelRow {
        photo: row(layers.clone(), &[W[0], Vec3::ZERO, W[2]], 3).photo,
        layers,
        segment,
    };
    let (fit, twin) = (row.fit(), twin(&row, 600));
    // The pull on the colors of the other two leaves it a ten-thousandth in blue.
    assert!(fit.radiance[1].max_element() < 1e-4, "{fit:?}");
    for i in [0, 2] {
        for (c, want) in twin[i].into_iter().enumerate() {
            let got = f64::from(fit.radiance[i][c]);
            assert!((got / want - 1.0).abs() < 1e-5, "light {i}: {got} against {want}");
        }
    }
}

/// Lights a thousandth of the row apart: their separate radiances are underdetermined, their sum is
/// determined, and the fit names the two.
#[test]
fn nearly_equal_lights_are_named_and_their_sum_is_found() {
    let near = row(vec![falloff(60, 0.0), falloff(60, 1e-3), falloff(60, 1.0)], &W, 3);
    let fit = fit_radiances(&near.observations(), &near.columns(), &LightPrior::default(), 200);
    assert_eq!(fit.conditioning.most_correlated, Some([0, 1]));
    assert!(
        fit.conditioning.number > 1e6 && fit.conditioning.correlation > 0.99999,
        "{:?}",
        fit.conditioning
    );
    let share = (fit.radiance[0] + fit.radiance[1]) / fit.radiance[2];
    let truth = (W[0] + W[1]) / W[2];
    // The pull towards likely colors moves light between the two and the third by some percent.
    assert!(((share - truth) / truth).abs().max_element() < 0.05, "{share} against {truth}");
}

/// Nothing distinguishes equal lights: half each is as good as any share, and does not depend on
/// the last bit.
#[test]
fn equal_lights_share_equally() {
    let equal = row(vec![falloff(60, 0.0), falloff(60, 0.0), falloff(60, 1.0)], &W, 3);
    let fit = fit_radiances(&equal.observations(), &equal.columns(), &LightPrior::default(), 200);
    let off = ((fit.radiance[0] - fit.radiance[1]) / fit.radiance[0]).abs().max_element();
    // As near as a fit of ten turns to 1e-4 can be.
    assert!(off < 1e-3 && fit.unsettled.is_empty(), "{fit:?}");
    assert!(
        fit.conditioning.number > 1e12 && fit.conditioning.most_correlated == Some([0, 1]),
        "{fit:?}"
    );
}

/// A far or tiny lamp has a layer 1e6 times (or 1e20 times) smaller: its radiance is that much
/// larger, and nothing else changes.
#[test]
fn a_small_layer_is_not_taken_for_a_bad_one() {
    let plain = three().fit();
    for factor in [1e-6, 1e6, 1e-20] {
        let mut small = three();
        small.layers[1].iter_mut().for_each(|u| *u *= factor);
        let fit = small.fit();
        for (i, back) in [1.0, factor, 1.0].into_iter().enumerate() {
            let off = ((fit.radiance[i] * back - plain.radiance[i]) / plain.radiance[i])
                .abs()
                .max_element();
            assert!(off < 1e-4, "light {i} at {factor:e}: off by {off:e}");
        }
        let number = fit.conditioning.number / plain.conditioning.number;
        assert!((number - 1.0).abs() < 1e-3, "conditioning changed by {number}");
    }
}

/// One light gives 1e6 times less than the other. The photo's 32 bits (6e-8) leave one digit of it:
/// the strong light is right, the weak one no larger than it is by more than that and the pull on
/// its color, and both are the twin's.
#[test]
fn a_light_a_million_times_weaker_is_found_as_the_twin_finds_it() {
    let weak = row(vec![falloff(60, 0.0), falloff(60, 1.0)], &[W[0], W[0] * 1e-6], 2);
    let fit = weak.fit();
    let ratio = fit.radiance[1] / fit.radiance[0];
    assert!(ratio.max_element() < 3e-6 && fit.conditioning.number < 1e3, "{ratio} {fit:?}");
    let twin = twin(&weak, 600);
    for (c, (strong, faint)) in twin[0].into_iter().zip(twin[1]).enumerate() {
        let off = (f64::from(fit.radiance[0][c]) / strong - 1.0).abs();
        let weak = (f64::from(fit.radiance[1][c]) - faint).abs() / strong;
        assert!(off < 1e-6 && weak < 1e-7, "{off:e} {weak:e}");
    }
}

/// All is relative to the photo's white: another exposure is another scale of the radiances, and no
/// other fit.
#[test]
fn radiances_scale_with_the_photo() {
    let albedo = vec![Vec3::splat(0.5); 60];
    let plain = three();
    let plain_fit =
        fit_radiances(&plain.observations(), &plain.columns(), &LightPrior::default(), 200)
            .with_albedo_of(&plain.segment, &albedo);
    for factor in [1e-6, 1e6] {
        let mut scaled = three();
        scaled.photo.iter_mut().for_each(|v| *v *= factor);
        let fit =
            fit_radiances(&scaled.observations(), &scaled.columns(), &LightPrior::default(), 200)
                .with_albedo_of(&scaled.segment, &albedo);
        for (got, want) in fit.radiance.iter().zip(&plain_fit.radiance) {
            let off = ((*got / factor - *want) / *want).abs().max_element();
            assert!(off < 1e-4, "{factor:e}: {got} against {want}");
        }
    }
}

#[test]
fn nothing_to_go_by_is_zero_and_told() {
    let sound = |fit: &RadianceFit| {
        assert!(fit.radiance.iter().all(|w| w.is_finite() && w.min_element() >= 0.0), "{fit:?}");
        assert!(fit.albedo.iter().all(|a| a.is_finite()) && fit.loss.is_finite(), "{fit:?}");
    };
    // No light at all: every layer is black.
    let mut none = three();
    none.layers = vec![vec![Vec3::ZERO; 60]; 2];
    let fit = none.fit();
    sound(&fit);
    assert!(fit.dark == [0, 1] && fit.radiance == [Vec3::ZERO; 2], "{fit:?}");
    // A black photo needs no light.
    let mut black = three();
    black.photo = vec![Vec3::ZERO; 60];
    let fit = black.fit();
    sound(&fit);
    assert!(fit.radiance == [Vec3::ZERO; 3] && fit.iterations == 0, "{fit:?}");
    // If every pixel is saturated, any bright light fits, and no pixel distinguishes the lights.
    let mut white = three().observations();
    white.photo = vec![Vec3::ONE; 60];
    white.saturated = vec![true; 60];
    let fit = fit_radiances(&white, &three().columns(), &LightPrior::default(), 200);
    sound(&fit);
    assert!(
        fit.degrees_of_freedom == 0 && fit.radiance.iter().all(|w| w.min_element() > 0.0),
        "{fit:?}"
    );
    // Two pixels of one segment under three lights: one number for two ratios.
    let few = row(vec![falloff(2, 0.0), falloff(2, 0.3), falloff(2, 1.0)], &W, 1);
    let fit = fit_radiances(&few.observations(), &few.columns(), &LightPrior::default(), 200);
    sound(&fit);
    assert_eq!(fit.degrees_of_freedom, 1);
}

#[test]
fn a_fit_cut_short_names_what_still_moves() {
    let row = three();
    let fit = fit_radiances(&row.observations(), &row.columns(), &LightPrior::default(), 1);
    assert!(
        fit.iterations == 1 && fit.unsettled == [0, 1, 2] && fit.change > RADIANCE_FIT.tolerance,
        "{fit:?}"
    );
}
