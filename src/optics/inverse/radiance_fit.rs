//! How strong each light is: radiances and segment albedos that explain a photo together.
//!
//! The photo is `I_p = A_s(p) sum_k w_k u_k(p)` per colour channel, with u_k the unit layer of light k (its own shadow and its
//! own indirect light included), w_k >= 0 its radiance and A_s one albedo for all pixels of a segment. What tells the
//! lights apart is how shading varies *inside* a segment; the albedo of a segment takes up the rest, so that texture and
//! paint are never pressed into a light. Solved by turns: given w, each A_s is a ratio of sums; given A, w is a non-negative
//! least squares problem in what the albedos cannot take up (variable projection); a Cauchy weight keeps highlights and wrong
//! shadows from pulling (iteratively reweighted).
//!
//! All of it is in units of the photo's white and of each layer's mean, so that neither the photo's exposure nor the size and
//! distance of a light matter. Layers are f32, sums f64. Normal equations square the condition number, and lose nothing here:
//! columns that differ by a share d are told apart to 1e-16 / d^2 by 64-bit sums, to 6e-8 / d by 32-bit layers, which is
//! the larger for every d above 2e-9.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::Evidence;
use super::conditioning::{Conditioning, conditioning};
use crate::optics::nnls;
use crate::optics::nnls::nnls_from;

/// The most lights that a photo is asked for: each costs rays of its own, and a fit grows with the square of their number.
pub const MOST_LIGHTS: usize = 32;

/// Unknowns up to which each round of a fit solves for them from nothing; more start from the round before.
const FROM_NOTHING: usize = 99;

/// One light lobe's unit layer on the pixels of an [`Evidence`], and how much it must earn its place.
pub struct Column<'a> {
    pub layer: &'a [Vec3],
    /// Cost of explaining the whole photo by this column, as a share of the photo's weighted energy; 0 for a light that is
    /// seen.
    pub penalty: f64,
    /// Weight of the guess that it gives as much as each other column, as a share of the photo's weighted energy: it decides what
    /// the photo leaves open, and weighs against what the photo hardly tells.
    pub pull: f64,
}

/// What a fit found, and how it went.
#[derive(Clone, Debug)]
pub struct RadianceFit {
    /// Radiance per column.
    pub radiance: Vec<Vec3>,
    /// Albedo per segment.
    pub albedo: Vec<Vec3>,
    /// Mean of log(1 + r^2), r the residual over its expected size: 0 is perfect.
    pub loss: f64,
    /// The same at the start, where every light gives an equal share.
    pub loss_before: f64,
    /// How well the lights can be told apart, in the channel in which that is hardest.
    pub conditioning: Conditioning,
    /// Turns taken.
    pub turns: usize,
    /// Largest relative change of a light in the last turn.
    pub change: f64,
    /// Columns that still changed by more than `SETTLED` in the last turn: empty when the fit converged.
    pub moving: Vec<usize>,
    /// Columns whose layer is black on all of the evidence: nothing is known of them, and their radiance is 0.
    pub dark: Vec<usize>,
    /// Unknowns per channel: columns that are equal share one, and what it gives.
    pub unknowns: usize,
    /// Unsaturated pixels beyond one per segment. What a segment's albedo takes up says nothing of the lights: fewer than the
    /// columns that are not dark, less one for the gauge, leave radiances open.
    pub spare: usize,
}

/// Expected model error of a pixel, in whites: a share of it, plus a floor at about two 8-bit steps.
fn sigma(value: f64) -> f64 {
    0.15 * value + 0.01
}

/// A light has a colour of daylight or bulbs unless the photo says otherwise: weight of what is not, relative to the data.
const COLOUR_PULL: f64 = 0.3;

/// Least channel of a light over its largest, in the gauge in which the mean light is white: a bulb of 2500 K has 0.07. Without
/// it a change of colour would be a division by zero.
const PUREST: f64 = 0.07;

/// Largest share of each computed step that is taken: weights and projection belong to the last state, full steps overshoot.
/// Halved whenever a step goes back on the last one, since turns may circle around where they would settle.
pub(in crate::optics) const STEP: f64 = 0.7;

/// Growth of the share of a step from one turn that goes on to the next.
const REGAIN: f64 = 1.1;

/// A fit has converged when no light changes by more than this share of itself in a turn.
pub const SETTLED: f64 = 1e-4;

/// A light that gives less than this share of the mean shading is off: between 1e6 times and nothing there is room.
const OFF: f64 = 1e-9;

/// A layer with a smaller mean is black: radiances up to 1e30 times the photo's white are finite in 32 bits.
const FAINTEST: f64 = 1e-30;

/// Weight of staying where one is, relative to the data. Light is not moved for nothing between lights that cannot be told
/// apart, so that equal ones share equally; columns that differ by more than 1e-4 do not feel it.
const INERTIA: f64 = 1e-9;

/// Fits radiances in at most `turns` rounds. The gauge (a light twice as bright in a room half as white looks the same) is set
/// so that the mean shading of each channel is 1; [`RadianceFit::with_albedo_of`] sets another. A black photo gives
/// radiances of 0.
pub fn fit_radiances(evidence: &Evidence, columns: &[Column], turns: usize) -> RadianceFit {
    fit_until(evidence, columns, turns, SETTLED)
}

fn fit_until(evidence: &Evidence, columns: &[Column], turns: usize, settled: f64) -> RadianceFit {
    let n = evidence.photo.len();
    let white = f64::from(evidence.white);
    let alike = alike(columns);
    let distinct: Vec<&Column> = alike.iter().map(|all| &columns[all[0]]).collect();
    let counts: Vec<f64> = alike.iter().map(|all| all.len() as f64).collect();
    let members = |some: &dyn Fn(usize) -> bool| {
        let mut all: Vec<usize> =
            (0..alike.len()).filter(|&j| some(j)).flat_map(|j| alike[j].iter().copied()).collect();
        all.sort_unstable();
        all
    };
    let scale = scales(distinct.iter().copied());
    let lit: f64 = counts.iter().zip(&scale).map(|(count, &s)| if s > 0.0 { *count } else { 0.0 }).sum();
    let mut fit = RadianceFit {
        radiance: vec![Vec3::ZERO; columns.len()],
        albedo: vec![Vec3::ZERO; evidence.segments],
        loss: 0.0,
        loss_before: 0.0,
        conditioning: Conditioning::default(),
        turns: 0,
        change: 0.0,
        moving: Vec::new(),
        dark: members(&|j| scale[j] == 0.0),
        unknowns: distinct.len(),
        spare: spare(evidence),
    };
    if white == 0.0 || lit == 0.0 {
        return fit;
    }
    let k = distinct.len();
    let problem = Problem::shared(evidence, &distinct, counts, &scale, white);
    // Of equal columns together.
    let mut w: Vec<[f64; 3]> =
        scale.iter().zip(&problem.count).map(|(&s, count)| [if s > 0.0 { count / lit } else { 0.0 }; 3]).collect();
    fit.loss_before = (0..3).map(|c| problem.explained(&w, c).1).sum::<f64>() / (3 * n) as f64;
    // A small step is no sign of having arrived: changes are those of a step of the usual share.
    let (mut step, mut way) = (STEP, vec![[0.0; 3]; k]);
    let mut grams: [Vec<f64>; 3] = Default::default();
    while fit.turns < turns {
        let (last, taken) = (w.clone(), step);
        grams = problem.turn(&mut w, step);
        fit.turns += 1;
        let moved = w.iter().zip(&last).map(|(w, last)| [0, 1, 2].map(|c| w[c] - last[c])).collect();
        let before = std::mem::replace(&mut way, moved);
        let on: f64 = way.iter().flatten().zip(before.iter().flatten()).map(|(a, b)| a * b).sum();
        step = if on < 0.0 { 0.5 * step } else { (REGAIN * step).min(STEP) };
        // Per light, so that the smallest is as well known as the largest.
        let changes = w.iter().zip(&last).map(|(w, last)| {
            let (size, moved) = (0..3).fold((0.0f64, 0.0f64), |(s, m), c| (s.max(w[c]), m.max((w[c] - last[c]).abs())));
            if moved > 0.0 { moved / size.max(OFF) * STEP / taken } else { 0.0 }
        });
        let changes: Vec<f64> = changes.collect();
        fit.change = changes.iter().copied().fold(0.0, f64::max);
        fit.moving = members(&|j| changes[j] > settled);
        if fit.moving.is_empty() {
            break;
        }
    }
    if fit.turns > 0 {
        fit.conditioning = told_apart(&grams, &alike, &scale);
    }
    for c in 0..3 {
        let mean: f64 = w.iter().zip(&problem.mean[c]).map(|(w, mean)| w[c] * mean).sum();
        if mean > OFF {
            w.iter_mut().for_each(|v| v[c] /= mean);
        }
    }
    for w in &mut w {
        let least = PUREST * w[0].max(w[1]).max(w[2]);
        w.iter_mut().for_each(|v| *v = v.max(least));
    }
    for c in 0..3 {
        let (albedo, loss) = problem.explained(&w, c);
        fit.loss += loss / (3 * n) as f64;
        fit.albedo.iter_mut().zip(&albedo).for_each(|(fitted, &a)| fitted[c] = (a * white) as f32);
    }
    for (j, all) in alike.iter().enumerate() {
        let each = (DVec3::from_array(w[j]) * scale[j] / problem.count[j]).as_vec3();
        all.iter().for_each(|&i| fit.radiance[i] = each);
    }
    fit
}

/// Columns that are equal, each list in order, by their first. No photo tells them apart, so that the fit has one unknown for
/// all of them: a hundred names for one lamp cost as much as one.
fn alike(columns: &[Column]) -> Vec<Vec<usize>> {
    let mut alike: Vec<Vec<usize>> = Vec::new();
    for (i, column) in columns.iter().enumerate() {
        let equal = |other: &Column| {
            (other.penalty, other.pull) == (column.penalty, column.pull) && other.layer == column.layer
        };
        match alike.iter_mut().find(|all| equal(&columns[all[0]])) {
            Some(all) => all.push(i),
            None => alike.push(vec![i]),
        }
    }
    alike
}

/// How well the columns can be told apart, from the Gram matrices of those that are `alike` together.
fn told_apart(grams: &[Vec<f64>; 3], alike: &[Vec<usize>], scale: &[f64]) -> Conditioning {
    if let Some((all, _)) = alike.iter().zip(scale).find(|(all, s)| all.len() > 1 && **s > 0.0) {
        return Conditioning::of_equals([all[0], all[1]]);
    }
    let hardest = grams.iter().fold(Conditioning::default(), |hardest, gram| {
        let found = conditioning(gram, alike.len());
        if found.number > hardest.number { found } else { hardest }
    });
    Conditioning { alike: hardest.alike.map(|pair| pair.map(|j| alike[j][0])), ..hardest }
}

/// Factors that bring each column to mean 1, so that the start, the penalty and the tolerances mean the same for each; 0 for a
/// black one.
pub(in crate::optics) fn scales<'c>(columns: impl Iterator<Item = &'c Column<'c>>) -> Vec<f64> {
    let scale = |c: &Column| {
        let mean = c.layer.iter().map(|v| f64::from(v.element_sum())).sum::<f64>() / (3 * c.layer.len()) as f64;
        if mean > FAINTEST { 1.0 / mean } else { 0.0 }
    };
    columns.map(scale).collect()
}

/// Unsaturated pixels beyond one per segment.
fn spare(evidence: &Evidence) -> usize {
    let mut seen = vec![false; evidence.segments];
    let mut spare = 0;
    for (&segment, _) in evidence.segment.iter().zip(&evidence.saturated).filter(|(_, saturated)| !**saturated) {
        spare += usize::from(std::mem::replace(&mut seen[segment as usize], true));
    }
    spare
}

/// A fit's data in 64 bits: the photo in units of its white, layers of mean 1.
pub(in crate::optics) struct Problem<'a> {
    evidence: &'a Evidence,
    penalty: Vec<f64>,
    pull: Vec<f64>,
    /// How many equal columns each one stands for.
    count: Vec<f64>,
    /// What each column gives that is pulled, when all give alike.
    even: f64,
    /// Per channel and pixel.
    photo: [Vec<f64>; 3],
    /// What a pixel counts before the Cauchy weight.
    weight: [Vec<f64>; 3],
    /// Per channel, one row of all columns per pixel.
    pub layer: [Vec<f64>; 3],
    /// Mean of each column, per channel.
    mean: [Vec<f64>; 3],
}

impl<'a> Problem<'a> {
    pub fn new(evidence: &'a Evidence, columns: &[Column], scale: &[f64], white: f64) -> Problem<'a> {
        Problem::shared(evidence, &columns.iter().collect::<Vec<_>>(), vec![1.0; columns.len()], scale, white)
    }

    /// The same with columns that stand for `count` equal ones each; their weights are of all of them together.
    fn shared(evidence: &'a Evidence, columns: &[&Column], count: Vec<f64>, scale: &[f64], white: f64) -> Problem<'a> {
        let (n, k) = (evidence.photo.len(), columns.len());
        let photo = [0, 1, 2].map(|c| evidence.photo.iter().map(|v| f64::from(v[c]) / white).collect::<Vec<f64>>());
        let layer = [0, 1, 2].map(|c| {
            let rows = (0..n).flat_map(|p| columns.iter().zip(scale).map(move |(j, s)| f64::from(j.layer[p][c]) * s));
            rows.collect::<Vec<f64>>()
        });
        Problem {
            evidence,
            penalty: columns.iter().map(|c| c.penalty).collect(),
            pull: columns.iter().map(|c| c.pull).collect(),
            even: {
                let pulled = columns.iter().zip(scale).zip(&count).filter(|((c, s), _)| c.pull > 0.0 && **s > 0.0);
                1.0 / pulled.map(|(_, count)| count).sum::<f64>().max(1.0)
            },
            count,
            weight: photo.each_ref().map(|photo| photo.iter().map(|i| i.sqrt() / (i + 0.05).powi(2)).collect()),
            photo,
            mean: layer
                .each_ref()
                .map(|layer| (0..k).map(|j| layer.iter().skip(j).step_by(k).sum::<f64>() / n as f64).collect()),
            layer,
        }
    }

    /// One round: moves `w` towards what solves the problem linearised at `w`. Returns the Gram matrix of each channel.
    pub fn turn(&self, w: &mut [[f64; 3]], step: f64) -> [Vec<f64>; 3] {
        let k = w.len();
        // The channels' equations, coupled only by the pull on each light's colour: unknown c k + i is light i in channel c.
        let size = 3 * k;
        let (mut all, mut right) = (vec![0.0; size * size], vec![0.0; size]);
        let mut pulls = vec![0.0; k];
        let mut grams: [Vec<f64>; 3] = Default::default();
        let channels: Vec<Equations> = (0..3).into_par_iter().map(|c| self.equations(w, c)).collect();
        for (c, Equations { mut gram, mut b, energy }) in channels.into_iter().enumerate() {
            let gauge: f64 = self.weight[c].iter().zip(&self.photo[c]).map(|(weight, i)| weight * i * i).sum();
            for i in 0..k {
                pulls[i] += COLOUR_PULL / 3.0 * gram[i * k + i] / self.count[i];
                // The gauge, mean shading 1, as one more equation.
                b[i] += gauge * self.mean[c][i] - 0.5 * energy * self.penalty[i];
                for j in 0..k {
                    gram[i * k + j] += gauge * self.mean[c][i] * self.mean[c][j];
                }
            }
            grams[c] = gram.clone();
            for i in 0..k {
                b[i] += INERTIA * gram[i * k + i] * w[i][c];
                gram[i * k + i] *= 1.0 + INERTIA;
                b[i] += gauge * self.pull[i] * self.even;
                gram[i * k + i] += gauge * self.pull[i] / self.count[i];
                right[c * k + i] = b[i];
                all[(c * k + i) * size + c * k..][..k].copy_from_slice(&gram[i * k..][..k]);
            }
        }
        for i in 0..k {
            // |w - d (d . w)|^2 with d the likely colour: costs what is across it, and nothing along it.
            let d = likely_colour(w[i]);
            for (c, e) in (0..9).map(|n| (n / 3, n % 3)) {
                let across = f64::from(u8::from(c == e)) - d[c] * d[e];
                all[(c * k + i) * size + e * k + i] += pulls[i] * across;
            }
        }
        let start: Vec<f64> = (0..size).map(|i| w[i % k][i / k]).collect();
        let solved = if size > FROM_NOTHING { nnls_from(&all, &right, &start) } else { nnls(&all, &right) };
        for (i, solved) in solved.into_iter().enumerate() {
            let old = &mut w[i % k][i / k];
            *old += step * (solved - *old);
            if solved == 0.0 && *old < OFF {
                *old = 0.0;
            }
        }
        grams
    }

    pub fn shading(&self, w: &[[f64; 3]], c: usize) -> Vec<f64> {
        self.layer[c].chunks_exact(w.len()).map(|row| row.iter().zip(w).map(|(u, w)| u * w[c]).sum()).collect()
    }

    /// Residual of each pixel and its weight, 0 where a saturated pixel may be as bright as it is.
    pub fn residuals(&self, albedo: &[f64], shading: &[f64], c: usize) -> (Vec<f64>, Vec<f64>) {
        let Evidence { segment, saturated, .. } = self.evidence;
        let both = (0..shading.len()).map(|p| {
            let (wanted, model) = (self.photo[c][p], albedo[segment[p] as usize] * shading[p]);
            if saturated[p] && model >= wanted {
                return (0.0, 0.0);
            }
            let residual = wanted - model;
            (residual, self.weight[c][p] / (1.0 + (residual / sigma(wanted)).powi(2)))
        });
        both.unzip()
    }

    /// Gram matrix and right side of the step from `w`, after each segment's albedo has answered: what a light moves along the
    /// shading of a segment is taken up by its albedo (variable projection, Golub and Pereyra 1973, linearised). Each column
    /// is projected before it is multiplied: the difference of two large products would lose what tells like lights apart.
    fn equations(&self, w: &[[f64; 3]], c: usize) -> Equations {
        let (k, segment) = (w.len(), &self.evidence.segment);
        let shading = self.shading(w, c);
        let albedo = self.albedo(&shading, c);
        let (residual, weight) = self.residuals(&albedo, &shading, c);
        let rows = || self.layer[c].chunks_exact(k).enumerate();
        let mut norm = vec![0.0; self.evidence.segments];
        let mut along = vec![0.0; self.evidence.segments * k];
        for (p, row) in rows() {
            let s = segment[p] as usize;
            norm[s] += weight[p] * shading[p] * shading[p];
            let along = &mut along[s * k..][..k];
            along.iter_mut().zip(row).for_each(|(a, u)| *a += weight[p] * u * shading[p]);
        }
        for (along, norm) in along.chunks_exact_mut(k).zip(&norm) {
            along.iter_mut().for_each(|a| *a = if *norm > 0.0 { *a / norm } else { 0.0 });
        }
        let (mut gram, mut b) = (vec![0.0; k * k], vec![0.0; k]);
        let mut v = vec![0.0; k];
        for (p, row) in rows() {
            let s = segment[p] as usize;
            for i in 0..k {
                v[i] = albedo[s] * (row[i] - along[s * k + i] * shading[p]);
                b[i] += weight[p] * albedo[s] * row[i] * residual[p];
                for j in 0..=i {
                    gram[i * k + j] += weight[p] * v[i] * v[j];
                }
            }
        }
        for i in 0..k {
            for j in 0..i {
                gram[j * k + i] = gram[i * k + j];
            }
        }
        for i in 0..k {
            b[i] += (0..k).map(|j| gram[i * k + j] * w[j][c]).sum::<f64>();
        }
        let energy = weight.iter().zip(&self.photo[c]).map(|(weight, i)| weight * i * i).sum();
        Equations { gram, b, energy }
    }

    /// Least-squares albedo of each segment under this shading: sum(w I E) / sum(w E^2).
    pub fn albedo(&self, shading: &[f64], c: usize) -> Vec<f64> {
        let mut top = vec![0.0; self.evidence.segments];
        let mut bottom = vec![0.0; self.evidence.segments];
        for p in (0..shading.len()).filter(|&p| !self.evidence.saturated[p]) {
            let (s, weight) = (self.evidence.segment[p] as usize, self.weight[c][p]);
            top[s] += weight * self.photo[c][p] * shading[p];
            bottom[s] += weight * shading[p] * shading[p];
        }
        // A segment that is clipped everywhere, or in full shadow, is taken as white: it says nothing of the lights.
        top.iter().zip(&bottom).map(|(t, b)| if *b > 0.0 { (t / b).max(1e-3) } else { 1.0 }).collect()
    }

    /// The photo's weighted energy.
    pub fn energy(&self) -> f64 {
        let channel = |c: usize| -> f64 { self.weight[c].iter().zip(&self.photo[c]).map(|(w, i)| w * i * i).sum() };
        (0..3).map(channel).sum()
    }

    /// What the turns bring down, but for the pull on colours: the sum of the Cauchy losses sigma^2 log(1 + r^2), weighted, and of
    /// the penalties, as a share of the photo's weighted energy.
    pub fn objective(&self, w: &[[f64; 3]]) -> f64 {
        let energy = self.energy();
        let channel = |c: usize| -> f64 {
            let shading = self.shading(w, c);
            let (residual, _) = self.residuals(&self.albedo(&shading, c), &shading, c);
            let cauchy = |p: usize| {
                let sigma = sigma(self.photo[c][p]);
                self.weight[c][p] * sigma * sigma * (residual[p] / sigma).powi(2).ln_1p()
            };
            (0..residual.len()).map(cauchy).sum()
        };
        let misfit: f64 = (0..3).map(channel).sum();
        let cost: f64 = self.penalty.iter().zip(w).map(|(penalty, w)| penalty * w.iter().sum::<f64>() / 3.0).sum();
        if energy > 0.0 { misfit / energy + cost } else { cost }
    }

    /// Albedos of one channel, and the sum of log(1 + r^2).
    fn explained(&self, w: &[[f64; 3]], c: usize) -> (Vec<f64>, f64) {
        let shading = self.shading(w, c);
        let albedo = self.albedo(&shading, c);
        let (residual, _) = self.residuals(&albedo, &shading, c);
        let misfit = residual.iter().zip(&self.photo[c]).map(|(r, &wanted)| (r / sigma(wanted)).powi(2).ln_1p());
        (albedo, misfit.sum())
    }
}

/// Normal equations `gram w = b` of one channel, and the photo's weighted energy.
struct Equations {
    gram: Vec<f64>,
    b: Vec<f64>,
    energy: f64,
}

impl RadianceFit {
    /// The same fit in the gauge in which albedo agrees, in the geometric mean over `segment`s, with `albedo`.
    pub fn with_albedo_of(mut self, segment: &[u32], albedo: &[Vec3]) -> RadianceFit {
        let mut factor = Vec3::ONE;
        for c in 0..3 {
            let (mut sum, mut count) = (0.0f64, 0);
            for (&s, wanted) in segment.iter().zip(albedo) {
                let got = self.albedo[s as usize][c];
                if got > 0.0 && wanted[c] > 0.0 {
                    sum += f64::from(got / wanted[c]).ln();
                    count += 1;
                }
            }
            if count > 0 {
                factor[c] = (sum / f64::from(count)).exp() as f32;
            }
        }
        self.radiance.iter_mut().for_each(|w| *w *= factor);
        self.albedo.iter_mut().for_each(|a| *a /= factor);
        self
    }
}

/// The nearest colour to `w` that daylight or a bulb may have, unit length, in the gauge in which the mean light is white.
///
/// Black bodies lie near the line log(r / g, b / g) = t (0.55, -0.835): 2700 K is at t = 1.7 from 6500 K. The same holds for
/// their ratios, and so in any white balance.
fn likely_colour(w: [f64; 3]) -> [f64; 3] {
    const WARM: [f64; 3] = [0.55, 0.0, -0.835];
    const MOST: f64 = 1.5;
    let floor = 0.02 * w.iter().sum::<f64>() + 1e-12;
    let [r, g, b] = w.map(|v| v.max(floor).ln());
    let t = (WARM[0] * (r - g) + WARM[2] * (b - g)).clamp(-MOST, MOST);
    let colour = WARM.map(|v| (v * t).exp());
    let length = colour.iter().map(|v| v * v).sum::<f64>().sqrt();
    colour.map(|v| v / length)
}

#[cfg(test)]
#[path = "stiff.rs"]
mod stiff;

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of pixels in four segments under two lights that fall off from either end.
    fn row() -> (Evidence, Vec<Vec3>, Vec<Vec3>) {
        let n = 400;
        let from = |x: f32| Vec3::splat(1.0 / (0.3 + x * x));
        let left: Vec<Vec3> = (0..n).map(|i| from(i as f32 / n as f32)).collect();
        let right: Vec<Vec3> = (0..n).map(|i| from(1.0 - i as f32 / n as f32)).collect();
        let paint = [Vec3::splat(0.8), Vec3::new(0.7, 0.2, 0.1), Vec3::new(0.1, 0.3, 0.6), Vec3::splat(0.3)];
        let segment: Vec<u32> = (0..n).map(|i| i as u32 / 100).collect();
        let (w0, w1) = (Vec3::new(0.3, 0.25, 0.2), Vec3::new(0.05, 0.1, 0.15));
        let photo = (0..n).map(|i| paint[i / 100] * (w0 * left[i] + w1 * right[i])).collect();
        (Evidence { photo, segment, segments: 4, saturated: vec![false; n], white: 1.0 }, left, right)
    }

    fn columns<'a>(layers: &[&'a [Vec3]]) -> Vec<Column<'a>> {
        layers.iter().map(|layer| Column { layer, penalty: 0.0, pull: 0.0 }).collect()
    }

    #[test]
    fn shares_of_two_lights_over_unknown_paint_are_found() {
        let (evidence, left, right) = row();
        let fit = fit_radiances(&evidence, &columns(&[&left, &right]), 60);
        // Only the share of each light in each channel is determined: 0.3 : 0.05, 0.25 : 0.1, 0.2 : 0.15.
        let ratio = fit.radiance[1] / fit.radiance[0];
        let truth = Vec3::new(0.05 / 0.3, 0.4, 0.75);
        // The second light is 0.3 off the line of likely colours in log(r / g); the pull draws it half of the way.
        assert!(((ratio - truth) / truth).abs().max_element() < 0.2, "{ratio} against {truth}");
        assert!(fit.loss < 1e-2, "loss {}", fit.loss);
    }

    #[test]
    fn what_the_photo_leaves_open_is_shared_evenly_and_what_it_tells_stays() {
        let (evidence, left, right) = row();
        // Even inside each segment, so that its albedos take all of it up.
        let open: Vec<Vec3> = (0..400).map(|i| Vec3::splat([0.2, 1.0, 3.0, 0.5][i / 100])).collect();
        let mean = |layer: &[Vec3]| layer.iter().map(|v| v.y).sum::<f32>() / 400.0;
        let shares = |pull: f64, penalty: f64| {
            let mut columns = columns(&[&left, &right, &open]);
            columns.iter_mut().for_each(|c| c.pull = pull);
            columns[2].penalty = penalty;
            let fit = fit_radiances(&evidence, &columns, 200);
            let gives: Vec<f32> =
                fit.radiance.iter().zip([&left, &right, &open]).map(|(w, layer)| w.y * mean(layer)).collect();
            let all: f32 = gives.iter().sum();
            [gives[1] / gives[0], gives[2] / all]
        };
        let ([ratio, nothing], [pulled, share]) = (shares(0.0, 1e-3), shares(3e-3, 1e-3));
        assert!(nothing < 1e-3 && (share - 1.0 / 3.0).abs() < 0.15, "share {nothing}, pulled {share}");
        assert!((pulled / ratio - 1.0).abs() < 0.3, "{pulled} against {ratio}");
        // A heavier guess weighs against what the photo tells.
        let [heavy, _] = shares(0.03, 1e-3);
        assert!(heavy > pulled && heavy < 1.0, "{heavy}");
    }

    #[test]
    fn a_light_that_explains_nothing_gets_nothing() {
        let (evidence, left, right) = row();
        let stripes: Vec<Vec3> = (0..400).map(|i| Vec3::splat(if i % 2 == 0 { 1.0 } else { 0.0 })).collect();
        let mut columns = columns(&[&left, &right, &stripes]);
        columns[2].penalty = 0.02;
        let fit = fit_radiances(&evidence, &columns, 60);
        assert!(fit.radiance[2].max_element() < 1e-3 * fit.radiance[0].min_element(), "{:?}", fit.radiance);
    }

    #[test]
    fn clipped_pixels_do_not_darken_a_light() {
        let (mut evidence, left, right) = row();
        for p in 0..400 {
            // The left segment is white and clipped near its lamp.
            if evidence.photo[p].max_element() > 0.6 {
                evidence.saturated[p] = true;
                evidence.photo[p] = evidence.photo[p].min(Vec3::splat(0.6));
            }
        }
        let fit = fit_radiances(&evidence, &columns(&[&left, &right]), 60);
        let ratio = fit.radiance[1].y / fit.radiance[0].y;
        assert!((ratio - 0.4).abs() < 0.08, "ratio {ratio}");
    }

    #[test]
    fn degenerate_evidence_is_finite() {
        let empty = Evidence { photo: vec![], segment: vec![], segments: 0, saturated: vec![], white: 0.0 };
        assert!(fit_radiances(&empty, &[], 5).radiance.is_empty());
        let n = 10;
        for photo in [vec![Vec3::ZERO; n], vec![Vec3::ONE; n]] {
            for saturated in [false, true] {
                let (segment, white) = (vec![0; n], photo[0].x);
                let saturated = vec![saturated; n];
                let evidence = Evidence { photo: photo.clone(), segment, segments: 1, saturated, white };
                let (zero, one) = (vec![Vec3::ZERO; n], vec![Vec3::ONE; n]);
                let fit = fit_radiances(&evidence, &columns(&[&zero, &one, &one]), 10);
                assert!(fit.radiance.iter().all(|w| w.is_finite() && w.min_element() >= 0.0), "{fit:?}");
                assert!(fit.loss.is_finite() && fit.conditioning.number >= 1.0, "{fit:?}");
            }
        }
    }
}
