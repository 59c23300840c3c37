//! What is measured: errors against a converged reference, with the time they took.

use relight::nodes::artifacts::{UnitDirect, Visibility};
use serde::Serialize;

use super::session::{Session, Set};
use crate::cli::Stop;

/// Relative errors below this are those of single precision.
pub const EXACT: f64 = 1e-6;

/// One mark of a plot.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    pub plot: &'static str,
    /// The light and the lobe, or the edit: a panel of the plot.
    pub subject: String,
    /// The estimator: a line of the panel.
    pub series: String,
    /// Samples per pixel that were asked for; none where the error is what was asked for.
    pub samples: Option<u32>,
    /// Relative standard error that was asked for.
    pub target: Option<f64>,
    /// Bandwidth of the lobe, where that is what varies.
    pub bandwidth: Option<f64>,
    /// Wall time: of the stages that make the subject, or of the whole run.
    pub seconds: f64,
    pub rays: u64,
    /// Relative error; see docs/accuracy.md for each plot.
    pub error: f64,
    /// What the stages themselves say that the error is, in the same measure.
    pub claimed: Option<f64>,
}

/// One light's shading by unit radiance, per lobe, with its standard error, and what it took.
pub struct Estimate {
    pub lobes: Vec<[Vec<f32>; 2]>,
    pub seconds: f64,
    pub rays: u64,
}

/// Unshadowed direct shading of a light.
pub fn direct(session: &Session, light: &str, sets: &[Set]) -> Result<Estimate, Stop> {
    let (direct, _) = session.layers()?;
    let made = session.make::<UnitDirect>(&format!("{direct}[{light}]"), "direct", sets)?;
    let lobes = made.value.lobes.iter().zip(&made.value.stderr);
    let lobes = lobes.map(|(e, sd)| [e.pixels().to_vec(), sd.pixels().to_vec()]).collect();
    Ok(Estimate { lobes, seconds: made.seconds, rays: made.rays })
}

/// Direct shading of a light with its shadow.
pub fn shadowed(session: &Session, light: &str, sets: &[Set]) -> Result<Estimate, Stop> {
    let Estimate { mut lobes, seconds, rays } = direct(session, light, sets)?;
    let (_, shadow) = session.layers()?;
    let made = session.make::<Visibility>(&format!("{shadow}[{light}]"), "visibility", sets)?;
    let visibility = made.value.lit.iter().zip(&made.value.stderr);
    for ([e, sd], (v, sd_v)) in lobes.iter_mut().zip(visibility) {
        for ((e, sd), (&v, &sd_v)) in e.iter_mut().zip(sd).zip(v.pixels().iter().zip(sd_v.pixels())) {
            (*e, *sd) = (*e * v, (*sd * v).hypot(*e * sd_v));
        }
    }
    Ok(Estimate { lobes, seconds: seconds + made.seconds, rays: rays + made.rays })
}

/// The mean of independent estimates of a lobe.
pub struct Reference {
    pub mean: Vec<f64>,
    /// Mean over the pixels of the variance that is left in `mean`.
    variance: f64,
}

impl Reference {
    /// Of every lobe, from estimates that differ in their seed.
    pub fn of(estimates: &[Estimate]) -> Vec<Reference> {
        let n = estimates.len() as f64;
        let lobes = estimates.first().map_or(0, |e| e.lobes.len());
        let lobe = |k: usize| {
            let at = |i: usize| estimates.iter().map(move |e| f64::from(e.lobes[k][0][i]));
            let pixels = estimates[0].lobes[k][0].len();
            let mean: Vec<f64> = (0..pixels).map(|i| at(i).sum::<f64>() / n).collect();
            let squares: f64 = (0..pixels).map(|i| at(i).map(|x| (x - mean[i]).powi(2)).sum::<f64>()).sum();
            Reference { variance: squares / (n * (n - 1.0).max(1.0) * pixels.max(1) as f64), mean }
        };
        (0..lobes).map(lobe).collect()
    }

    /// Mean over the pixels.
    fn level(&self) -> f64 {
        self.mean.iter().sum::<f64>() / self.mean.len().max(1) as f64
    }

    /// Whether the lobe reaches anything that is seen.
    pub fn shines(&self) -> bool {
        self.level() > 1e-12
    }

    /// Mean square error of an estimate, without the part that is the reference's own; and that which it claims.
    fn squares(&self, [value, stderr]: &[Vec<f32>; 2]) -> [f64; 2] {
        let n = self.mean.len().max(1) as f64;
        let error: f64 = value.iter().zip(&self.mean).map(|(&x, mean)| (f64::from(x) - mean).powi(2)).sum();
        let claimed: f64 = stderr.iter().map(|&sd| f64::from(sd).powi(2)).sum();
        [error / n - self.variance, claimed / n]
    }
}

/// A lobe of some repeated estimates against its reference.
pub struct Measured {
    /// Root of the mean square error over the mean of the reference.
    pub error: f64,
    pub claimed: f64,
    /// Of the fastest repetition: other work only ever adds.
    pub seconds: f64,
    pub rays: u64,
}

const MOST_REPEATS: usize = 24;

/// Repeats an estimate with new seeds while that takes less than `within` seconds in all.
pub fn repeat(within: f64, mut estimate: impl FnMut() -> Result<Estimate, Stop>) -> Result<Vec<Estimate>, Stop> {
    let mut all = vec![estimate()?];
    while all.len() < MOST_REPEATS && all.iter().map(|e| e.seconds).sum::<f64>() < within {
        all.push(estimate()?);
    }
    Ok(all)
}

pub fn measure(estimates: &[Estimate], lobe: usize, reference: &Reference) -> Measured {
    let n = estimates.len() as f64;
    let squares: Vec<[f64; 2]> = estimates.iter().map(|e| reference.squares(&e.lobes[lobe])).collect();
    let [error, claimed] = [0, 1].map(|k| {
        let mean = squares.iter().map(|s| s[k]).sum::<f64>() / n;
        mean.max(0.0).sqrt() / reference.level()
    });
    let seconds = estimates.iter().map(|e| e.seconds).fold(f64::INFINITY, f64::min);
    Measured { error, claimed, seconds, rays: estimates[0].rays }
}

/// Exponent p of the power law y = c x^p that lies nearest in the logarithms; `None` for fewer than two marks.
pub fn slope(marks: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<(f64, f64)> =
        marks.iter().filter(|(x, y)| *x > 0.0 && *y > 0.0).map(|(x, y)| (x.ln(), y.ln())).collect();
    let n = logs.len() as f64;
    let (mx, my) = (logs.iter().map(|l| l.0).sum::<f64>() / n, logs.iter().map(|l| l.1).sum::<f64>() / n);
    let xx: f64 = logs.iter().map(|l| (l.0 - mx).powi(2)).sum();
    let xy: f64 = logs.iter().map(|l| (l.0 - mx) * (l.1 - my)).sum();
    (logs.len() >= 2 && xx > 0.0).then(|| xy / xx)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_has_its_slope() {
        let marks: Vec<(f64, f64)> = (0..6).map(|i| 4f64.powi(i)).map(|x| (x, 3.0 * x.powf(-0.75))).collect();
        assert!((slope(&marks).expect("there are enough marks") + 0.75).abs() < 1e-12);
        assert_eq!(slope(&marks[..1]), None);
    }

    /// Estimates whose error is known: the truth is 1, each is off by plus or minus `off`.
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
        Estimate { lobes: vec![[value, vec![off; pixels]]], seconds: 1.0, rays: 0 }
    }

    #[test]
    fn the_error_of_the_reference_is_taken_off() {
        let pixels = 20_000;
        let references: Vec<Estimate> = (0..4).map(|seed| estimate(pixels, seed, 0.2)).collect();
        let reference = &Reference::of(&references)[0];
        let measured = measure(&[estimate(pixels, 9, 0.2)], 0, reference);
        // Without the correction it would be 0.2 sqrt(1 + 1/4) = 0.224; 20,000 signs scatter by about 1 %.
        assert!((measured.error - 0.2).abs() < 0.006, "{}", measured.error);
        assert!((measured.claimed - 0.2).abs() < 0.002, "{}", measured.claimed);
    }
}
