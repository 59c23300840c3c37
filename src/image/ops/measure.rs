//! Errors of pictures and planes against the truth. Sums are in 64 bits and a fixed order.

use glam::Vec3;

use crate::image::{Normal, Plane, Transfer, distance};
use crate::tuning::tuning;

tuning! {
    /// Constants of the measures of saturated regions.
    pub const TUNING: SaturationScoreTuning {
        /// Level of the largest channel from which on a photo counts as saturated: 250 of 255 in
        /// sRGB, as edges of saturated regions are when a photo is made smaller.
        white: f32 = 0.95,
            unit "fraction of white", source Taste, effect "a smaller value counts bright surfaces";
        /// Width of the band around saturated regions.
        band: f32 = 20.0,
            unit "pixels", source Taste, effect "a wider band has more of the plain surface";
        /// Half the width of their edge.
        edge: f32 = 2.0,
            unit "pixels", source Taste, effect "a wider edge has more of the texture";
    }
}

/// Numbers as they came out beside those that are true, channel by channel, of the pixels that are
/// `counted`.
///
/// # Panics
/// The sizes differ.
pub fn pairs<'a>(
    got: &'a Plane<Vec3>,
    truth: &'a Plane<Vec3>,
    counted: &'a Plane<bool>,
) -> impl Iterator<Item = (f64, f64)> + Clone + 'a {
    assert!(
        got.size() == truth.size() && got.size() == counted.size(),
        "planes of one picture have one size"
    );
    let pixels = got.pixels().iter().zip(truth.pixels()).zip(counted.pixels());
    let counted = pixels.filter(|(_, counted)| **counted).map(|(pair, _)| pair);
    counted.flat_map(|(got, truth)| (0..3).map(move |c| (f64::from(got[c]), f64::from(truth[c]))))
}

/// Mean of `f(got, truth)`; `None` of nothing.
pub fn mean_error(
    pairs: impl Iterator<Item = (f64, f64)>,
    f: impl Fn(f64, f64) -> f64,
) -> Option<f64> {
    let (sum, n) = pairs.fold((0.0, 0u64), |(sum, n), (got, truth)| (sum + f(got, truth), n + 1));
    (n > 0).then(|| sum / n as f64)
}

/// Mean of (got - truth)^2.
pub fn square_error(pairs: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    mean_error(pairs, |got, truth| (got - truth).powi(2))
}

/// Mean of (s got - truth)^2 with the s that minimizes it, s = sum got truth / sum got^2: the error
/// that no common factor removes.
pub fn scale_invariant_error(pairs: impl Iterator<Item = (f64, f64)> + Clone) -> Option<f64> {
    let (cross, square) =
        pairs.clone().fold((0.0, 0.0), |(c, s), (got, truth)| (c + got * truth, s + got * got));
    let level = if square > 0.0 { cross / square } else { 0.0 };
    mean_error(pairs, |got, truth| (level * got - truth).powi(2))
}

/// Mean of (log(1 + got) - log(1 + truth))^2, natural logarithms; below zero counts as zero.
pub fn log_error(pairs: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    mean_error(pairs, |got, truth| (got.max(0.0).ln_1p() - truth.max(0.0).ln_1p()).powi(2))
}

/// Mean angle between unit normals, degrees.
pub fn normal_error(got: &Normal, truth: &Normal, counted: &Plane<bool>) -> Option<f64> {
    let pixels = got
        .0
        .pixels()
        .iter()
        .zip(truth.0.pixels())
        .zip(counted.pixels())
        .filter(|(_, counted)| **counted);
    // By the sine too: the cosine alone loses small angles to rounding.
    let angle =
        |(a, b): (&Vec3, &Vec3)| f64::from(a.cross(*b).length().atan2(a.dot(*b))).to_degrees();
    mean_error(pixels.map(|(pair, _)| (angle(pair), 0.0)), |angle, _| angle)
}

/// A relit picture against the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PictureScore {
    /// Peak signal to noise ratio of the sRGB picture of 8 bits, dB; at most 100.
    pub psnr: f64,
    /// That of the photo, as if nothing had been done.
    pub unchanged: f64,
    /// sum |got - truth| / sum |truth - photo| in linear light clipped to 0..=1: 0 is perfect, 1 is
    /// doing nothing; `None` where the truth is the photo.
    pub change: Option<f64>,
}

/// Scores a linear picture, seen as the 8-bit sRGB that it becomes, by the linear truth and the
/// linear photo, on the pixels that are `counted`; `None` when there is none.
pub fn score_picture(
    got: &Plane<Vec3>,
    truth: &Plane<Vec3>,
    photo: &Plane<Vec3>,
    counted: &Plane<bool>,
) -> Option<PictureScore> {
    let code = |linear: f64| f64::from(Transfer::Srgb.encode(linear.clamp(0.0, 1.0) as f32));
    let shown = got.map(|rgb| {
        Vec3::from_array(rgb.to_array().map(|x| {
            let stored = (Transfer::Srgb.encode(x.clamp(0.0, 1.0)) * 255.0).round();
            Transfer::Srgb.decode(stored / 255.0)
        }))
    });
    let psnr = |squares: f64| -10.0 * squares.max(1e-10).log10();
    let coded = |(got, truth): (f64, f64)| (code(got), code(truth));
    let clip = |(got, truth): (f64, f64)| (got.clamp(0.0, 1.0), truth.clamp(0.0, 1.0));
    let distance = |got: f64, truth: f64| (got - truth).abs();
    let missed = mean_error(pairs(&shown, truth, counted).map(clip), distance)?;
    let moved = mean_error(pairs(photo, truth, counted).map(clip), distance)?;
    Some(PictureScore {
        psnr: psnr(square_error(pairs(&shown, truth, counted).map(coded))?),
        unchanged: psnr(square_error(pairs(photo, truth, counted).map(coded))?),
        change: (moved > 0.0).then(|| missed / moved),
    })
}

/// A relit picture against the truth, by the saturation of the photo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SaturationScore {
    /// Mean absolute difference in saturated regions of the photo, in steps of the 8-bit sRGB
    /// picture.
    pub saturated: Option<f64>,
    /// The same in the band around them.
    pub band: Option<f64>,
    /// The same elsewhere.
    pub elsewhere: Option<f64>,
    /// Mean difference of neighbors at their edges, over that of the truth.
    pub step: Option<f64>,
}

/// Scores a linear picture by the linear truth, with the regions in which the linear `photo` is
/// saturated, on the pixels that are `counted`. A measure without a pixel is `None`.
pub fn score_saturation(
    got: &Plane<Vec3>,
    truth: &Plane<Vec3>,
    photo: &Plane<Vec3>,
    counted: &Plane<bool>,
) -> SaturationScore {
    let code = |linear: f32| 255.0 * Transfer::Srgb.encode(linear.clamp(0.0, 1.0));
    let [got, truth] =
        [got, truth].map(|plane| plane.map(|c| Vec3::from_array(c.to_array().map(code))));
    let white = Plane::from_fn(photo.width(), photo.height(), |x, y| {
        photo.get(x, y).max_element() >= TUNING.white && counted.get(x, y)
    });
    let (outside, inside) = (distance(&white), distance(&white.map(|white| !white)));
    let region = |holds: &dyn Fn(f32, f32) -> bool| {
        Plane::from_fn(photo.width(), photo.height(), |x, y| {
            counted.get(x, y) && holds(outside.get(x, y), inside.get(x, y))
        })
    };
    let error = |region: Plane<bool>| {
        mean_error(pairs(&got, &truth, &region), |got, truth| (got - truth).abs())
    };
    let edge = region(&|outside, inside| outside <= TUNING.edge && inside <= TUNING.edge);
    let [jump, true_jump] = [&got, &truth].map(|plane| jump(plane, &edge));
    SaturationScore {
        saturated: error(white.clone()),
        band: error(region(&|outside, _| outside > 0.0 && outside <= TUNING.band)),
        elsewhere: error(region(&|outside, _| outside > TUNING.band)),
        step: (true_jump > 0.0).then(|| jump / true_jump),
    }
}

/// Sum of the differences of neighbors to the right and below, of pixels of the `edge`.
fn jump(plane: &Plane<Vec3>, edge: &Plane<bool>) -> f64 {
    let pixel = |x: usize, y: usize| {
        let here = plane.get(x, y);
        let off = |to: Vec3| f64::from((to - here).abs().element_sum());
        off(plane.get(x + 1, y)) + off(plane.get(x, y + 1))
    };
    let (width, height) = plane.size();
    let row = |y: usize| (0..width.saturating_sub(1)).map(move |x| (x, y));
    let pixels = (0..height.saturating_sub(1)).flat_map(row);
    pixels.filter(|&(x, y)| edge.get(x, y)).map(|(x, y)| pixel(x, y)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn saturated_regions_by_hand() {
        let line = |value: &dyn Fn(usize) -> f32| {
            Plane::from_fn(60, 3, |x, _| Vec3::splat(Transfer::Srgb.decode(value(x) / 255.0)))
        };
        // White in 0..10, the band in 10..30.
        let photo = line(&|x| if x < 10 { 255.0 } else { 90.0 });
        let truth = line(&|x| if x < 10 { 100.0 } else { 80.0 });
        let got = line(&|x| match x {
            0..10 => 130.0,
            10..30 => 85.0,
            _ => 81.0,
        });
        let all = photo.map(|_| true);
        let score = score_saturation(&got, &truth, &photo, &all);
        let close = |got: Option<f64>, want: f64| {
            assert!((got.expect("it has pixels") - want).abs() < 1e-3, "{got:?} for {want}");
        };
        close(score.saturated, 30.0);
        close(score.band, 5.0);
        close(score.elsewhere, 1.0);
        close(score.step, 45.0 / 20.0);
        // A photo without white has one region and no edge.
        let score = score_saturation(&got, &truth, &truth, &all);
        assert_eq!((score.saturated, score.band, score.step), (None, None, None));
        close(score.elsewhere, (10.0 * 30.0 + 20.0 * 5.0 + 30.0) / 60.0);
    }

    fn plane(values: &[f32]) -> Plane<Vec3> {
        Plane::new(values.len(), 1, values.iter().map(|&v| Vec3::splat(v)).collect())
    }

    #[test]
    fn errors_by_hand() {
        let (got, truth) = (plane(&[1.0, 2.0, 9.0]), plane(&[2.0, 4.0, 0.0]));
        let counted = Plane::new(3, 1, vec![true, true, false]);
        let all = || pairs(&got, &truth, &counted);
        assert_eq!(square_error(all()), Some(2.5));
        assert_eq!(scale_invariant_error(all()), Some(0.0), "twice as much is the truth");
        let (a, b) = (1.5f64.ln(), (5.0f64 / 3.0).ln());
        assert!((log_error(all()).expect("two pixels") - (a * a + b * b) / 2.0).abs() < 1e-12);
        assert_eq!(square_error(pairs(&got, &truth, &Plane::filled(3, 1, false))), None);
        assert_eq!(
            scale_invariant_error([(0.0, 1.0), (0.0, 3.0)].into_iter()),
            Some(5.0),
            "black has no level"
        );
    }

    #[test]
    fn angles_by_hand() {
        let normal = |v: [Vec3; 2]| Normal(Plane::new(2, 1, v.map(Vec3::normalize).to_vec()));
        let (a, b) =
            (normal([Vec3::Z, Vec3::Z]), normal([Vec3::Z + 1e-4 * Vec3::X, Vec3::Z + Vec3::Y]));
        let counted = Plane::filled(2, 1, true);
        let wanted = (1e-4f64.atan().to_degrees() + 45.0) / 2.0;
        assert!((normal_error(&a, &b, &counted).expect("two pixels") - wanted).abs() < 1e-5);
    }

    #[test]
    fn the_truth_has_no_change_error_and_the_photo_has_one() {
        // Values of whole 8-bit steps, so that storing them takes nothing away.
        let step = |n: f32| Transfer::Srgb.decode(n / 255.0);
        let (photo, truth) =
            (plane(&[step(100.0), step(200.0), 3.0]), plane(&[step(50.0), step(200.0), 2.0]));
        let counted = Plane::filled(3, 1, true);
        let perfect = score_picture(&truth, &truth, &photo, &counted).expect("three pixels");
        assert_eq!((perfect.psnr, perfect.change), (100.0, Some(0.0)));
        let nothing = score_picture(&photo, &truth, &photo, &counted).expect("three pixels");
        assert!((nothing.change.expect("the truth differs") - 1.0).abs() < 1e-5);
        // One pixel of three is off by 50 of 255; values above white look white in both.
        let psnr = -10.0 * ((50.0f64 / 255.0).powi(2) / 3.0).log10();
        assert!(
            (nothing.psnr - psnr).abs() < 1e-3 && (nothing.unchanged - psnr).abs() < 1e-3,
            "{nothing:?}"
        );
        assert_eq!(
            score_picture(&photo, &photo, &photo, &counted).expect("three pixels").change,
            None
        );
        assert_eq!(score_picture(&truth, &truth, &photo, &Plane::filled(3, 1, false)), None);
    }
}
