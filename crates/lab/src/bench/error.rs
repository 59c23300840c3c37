//! Errors of estimates against a converged reference, with their run times.

use serde::Serialize;

/// Relative error below which an estimate is exact to single precision.
pub(super) const EXACT: f64 = 1e-6;

/// One mark of a plot.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// Name of the plot that shows the mark.
    pub plot: &'static str,
    /// Light and lobe, or edit: a panel of the plot.
    pub subject: String,
    /// Estimator: a line of the panel.
    pub series: String,
    /// Requested samples per pixel; none where an error was requested.
    pub samples: Option<u32>,
    /// Requested relative standard error.
    pub target: Option<f64>,
    /// Bandwidth of the lobe, where that varies.
    pub bandwidth: Option<f64>,
    /// Wall time of the stages that estimate the subject, or of the whole run.
    pub seconds: f64,
    /// Rays traced by those stages.
    pub rays: u64,
    /// Relative error; docs/accuracy.md defines it for each plot.
    pub error: f64,
    /// Relative error by the stages' own standard errors.
    pub claimed: Option<f64>,
}

/// An estimated quantity of one lobe, with its standard error; one value per pixel each.
pub struct LobeEstimate {
    /// Estimated values, one per pixel.
    pub value: Vec<f32>,
    /// Standard errors of `value`, in its unit.
    pub stderr: Vec<f32>,
}

/// Layers of one light, per lobe of unit radiance, and their cost.
pub struct Estimate {
    /// One layer per lobe of the light.
    pub lobes: Vec<LobeEstimate>,
    /// Wall time of the stages that estimate the layers.
    pub seconds: f64,
    /// Rays traced by those stages.
    pub rays: u64,
}

impl Estimate {
    /// The product with a visibility of the same lobes; standard errors add in quadrature.
    pub fn shadowed(mut self, visibility: Estimate) -> Estimate {
        for (e, v) in self.lobes.iter_mut().zip(visibility.lobes) {
            let visible = v.value.iter().zip(v.stderr);
            for ((e, sd), (&v, sd_v)) in e.value.iter_mut().zip(&mut e.stderr).zip(visible) {
                (*e, *sd) = (*e * v, (*sd * v).hypot(*e * sd_v));
            }
        }
        Estimate {
            seconds: self.seconds + visibility.seconds,
            rays: self.rays + visibility.rays,
            ..self
        }
    }
}

/// The mean of independent estimates of a lobe.
pub(super) struct Reference {
    mean: Vec<f64>,
    /// Variance of `mean`, averaged over the pixels.
    variance: f64,
}

impl Reference {
    /// One reference per lobe, from estimates that differ in their seed.
    pub fn of(estimates: &[Estimate]) -> Vec<Reference> {
        let n = estimates.len() as f64;
        let lobes = estimates.first().map_or(0, |e| e.lobes.len());
        let lobe = |k: usize| {
            let at = |i: usize| estimates.iter().map(move |e| f64::from(e.lobes[k].value[i]));
            let pixels = estimates[0].lobes[k].value.len();
            let mean: Vec<f64> = (0..pixels).map(|i| at(i).sum::<f64>() / n).collect();
            let squares: f64 =
                (0..pixels).map(|i| at(i).map(|x| (x - mean[i]).powi(2)).sum::<f64>()).sum();
            Reference { variance: squares / (n * (n - 1.0).max(1.0) * pixels.max(1) as f64), mean }
        };
        (0..lobes).map(lobe).collect()
    }

    /// Mean over the pixels.
    fn level(&self) -> f64 {
        self.mean.iter().sum::<f64>() / self.mean.len().max(1) as f64
    }

    /// Whether the lobe reaches any pixel.
    pub fn shines(&self) -> bool {
        self.level() > 1e-12
    }

    /// Mean square error of an estimate less the variance of the reference, and the mean of its own
    /// variances.
    fn squares(&self, LobeEstimate { value, stderr }: &LobeEstimate) -> [f64; 2] {
        let n = self.mean.len().max(1) as f64;
        let error: f64 =
            value.iter().zip(&self.mean).map(|(&x, mean)| (f64::from(x) - mean).powi(2)).sum();
        let claimed: f64 = stderr.iter().map(|&sd| f64::from(sd).powi(2)).sum();
        [error / n - self.variance, claimed / n]
    }
}

/// The error of repeated estimates of a lobe against its reference.
pub(super) struct Measured {
    /// Root of the mean square error over the mean of the reference.
    pub error: f64,
    /// The same by the estimates' own standard errors.
    pub claimed: f64,
    /// Wall time of the fastest repetition: other work on the machine only ever adds.
    pub seconds: f64,
    pub rays: u64,
}

const MOST_REPEATS: usize = 24;

/// Repeats an estimate with new seeds while the sum of their times is below `within` seconds.
///
/// # Errors
/// Those of `estimate`.
pub(super) fn repeat<E>(
    within: f64,
    mut estimate: impl FnMut() -> Result<Estimate, E>,
) -> Result<Vec<Estimate>, E> {
    let mut all = vec![estimate()?];
    while all.len() < MOST_REPEATS && all.iter().map(|e| e.seconds).sum::<f64>() < within {
        all.push(estimate()?);
    }
    Ok(all)
}

/// Measures repeated estimates of one lobe.
pub(super) fn measure(estimates: &[Estimate], lobe: usize, reference: &Reference) -> Measured {
    let n = estimates.len() as f64;
    let squares: Vec<[f64; 2]> =
        estimates.iter().map(|e| reference.squares(&e.lobes[lobe])).collect();
    let [error, claimed] = [0, 1].map(|k| {
        let mean = squares.iter().map(|s| s[k]).sum::<f64>() / n;
        mean.max(0.0).sqrt() / reference.level()
    });
    let seconds = estimates.iter().map(|e| e.seconds).fold(f64::INFINITY, f64::min);
    Measured { error, claimed, seconds, rays: estimates[0].rays }
}

/// Exponent p of the power law y = c x^p by least squares in the logarithms; `None` for fewer than
/// two marks.
pub(super) fn slope(marks: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<(f64, f64)> =
        marks.iter().filter(|(x, y)| *x > 0.0 && *y > 0.0).map(|(x, y)| (x.ln(), y.ln())).collect();
    let n = logs.len() as f64;
    let (mx, my) =
        (logs.iter().map(|l| l.0).sum::<f64>() / n, logs.iter().map(|l| l.1).sum::<f64>() / n);
    let xx: f64 = logs.iter().map(|l| (l.0 - mx).powi(2)).sum();
    let xy: f64 = logs.iter().map(|l| (l.0 - mx) * (l.1 - my)).sum();
    (logs.len() >= 2 && xx > 0.0).then(|| xy / xx)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_has_its_slope() {
        let marks: Vec<(f64, f64)> =
            (0..6).map(|i| 4f64.powi(i)).map(|x| (x, 3.0 * x.powf(-0.75))).collect();
        assert!((slope(&marks).expect("there are enough marks") + 0.75).abs() < 1e-12);
        assert_eq!(slope(&marks[..1]), None);
    }

    /// An estimate of known error: the truth is 1, each pixel deviates by plus or minus `off`.
    fn estimate(pixels: usize, seed: usize, off: f32) -> Estimate {
        // The mixing step of SplitMix64: its bits are as good as independent.
        let sign = |i: usize| {
            let x = (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15)
                ^ (seed as u64 + 1).wrapping_mul(0xd1b5_4a32_d192_ed03);
            let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            if (x >> 63) == 0 { 1.0 } else { -1.0 }
        };
        let value = (0..pixels).map(|i| 1.0 + off * sign(i)).collect();
        Estimate {
            lobes: vec![LobeEstimate { value, stderr: vec![off; pixels] }],
            seconds: 1.0,
            rays: 0,
        }
    }

    #[test]
    fn standard_errors_of_a_product_add_in_quadrature() {
        let layer =
            |value: f32, stderr: f32| LobeEstimate { value: vec![value], stderr: vec![stderr] };
        let light = Estimate { lobes: vec![layer(2.0, 0.3)], seconds: 1.0, rays: 5 };
        let visibility = Estimate { lobes: vec![layer(0.5, 0.1)], seconds: 0.5, rays: 7 };
        let product = light.shadowed(visibility);
        // sd = sqrt((0.3 * 0.5)^2 + (2.0 * 0.1)^2) = 0.25
        assert_eq!((product.lobes[0].value[0], product.rays, product.seconds), (1.0, 12, 1.5));
        assert!((product.lobes[0].stderr[0] - 0.25).abs() < 1e-6, "{}", product.lobes[0].stderr[0]);
    }

    #[test]
    fn the_error_of_the_reference_is_subtracted() {
        let pixels = 20_000;
        let references: Vec<Estimate> = (0..4).map(|seed| estimate(pixels, seed, 0.2)).collect();
        let reference = &Reference::of(&references)[0];
        let measured = measure(&[estimate(pixels, 9, 0.2)], 0, reference);
        // Without the correction it would be 0.2 sqrt(1 + 1/4) = 0.224; 20,000 signs scatter by
        // about 1 %.
        assert!((measured.error - 0.2).abs() < 0.006, "{}", measured.error);
        assert!((measured.claimed - 0.2).abs() < 0.002, "{}", measured.claimed);
    }
}
