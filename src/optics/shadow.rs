//! Which share of a light's direct shading arrives.
//!
//! Rays go to the samples of the light that direct shading is made of, and each counts with its part f of it: per lobe,
//! visibility = sum of f V / sum of f. So a sun lobe gets the sun's shadow, and a lamp half below the horizon that of its
//! upper half.

use glam::Vec3;
use rayon::prelude::*;

use super::estimate::{BATCHES, stream};
use super::{Emitter, Shape};
use crate::geometry::{Grid, Own, SceneMesh, Sight};
use crate::image::{Mask, Normal, Plane, Points};

/// How shadows are traced.
#[derive(Clone, Copy, Debug)]
pub struct ShadowQuality {
    /// Rays per traced pixel and lobe, rounded up to whole batches.
    pub samples: usize,
    pub seed: u64,
    /// 1 traces every pixel, 2 every second one along each axis, and so on.
    pub stride: usize,
    /// The share of unknown rays that counts as lit, 0..1.
    pub assume_lit: f32,
}

/// Per lobe, shares of the unshadowed direct shading, 0..1.
pub struct Shadow {
    /// Seen to be lit, plus `assume_lit` times unknown.
    pub lit: Vec<Plane<f32>>,
    /// Passing behind a depth edge, whatever was assumed about it.
    pub unknown: Vec<Plane<f32>>,
    pub rays: u64,
}

/// Shadows on all pixels of `points`, cast by `mesh`. `own` marks the light's own pixels (of the mesh): they cast no shadow, and
/// are themselves neither lit nor unknown, as no light reaches its own (convex) surface. Where no light arrives even without
/// shadows, a pixel counts as lit.
pub fn shadow(
    mesh: &SceneMesh,
    points: &Points,
    normal: &Normal,
    shape: &Shape,
    own: Option<&Mask>,
    quality: ShadowQuality,
) -> Shadow {
    let lobes = shape.lobes();
    if lobes == 0 {
        return Shadow { lit: Vec::new(), unknown: Vec::new(), rays: 0 };
    }
    let emitter = Emitter::new(shape);
    let is_own = |pixel: usize| own.is_some_and(|own| own.0.pixels()[pixel] > 0.5);
    let passes = own.map(Own::new);
    let grid = Grid::new(points.0.size(), quality.stride);
    let each = quality.samples.div_ceil(BATCHES);
    let trace = |i: usize| {
        let pixel = grid.pixel(i);
        let (point, n) = (points.0.pixels()[pixel], normal.0.pixels()[pixel]);
        let from = point + n * mesh.offset(point);
        let (mut all, mut lit, mut unknown, mut rays) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, 0);
        for lobe in 0..lobes {
            let seen = if is_own(pixel) { None } else { emitter.seen(lobe, point, n) };
            let Some(seen) = seen else { continue };
            for batch in 0..BATCHES {
                let stream = stream(quality.seed, pixel as u32, lobe, batch);
                for sample in (0..each).filter_map(|i| seen.sample(i, stream.get(i))) {
                    rays += 1;
                    all[lobe] += sample.part;
                    match mesh.visibility(from, sample.place, passes.as_ref()) {
                        Sight::Lit => lit[lobe] += sample.part,
                        Sight::Unknown => unknown[lobe] += sample.part,
                        Sight::Blocked => {}
                    }
                }
            }
        }
        // Lobes without any light here have no say in their neighbours' shadows.
        let valid = all.cmpgt(Vec3::splat(1e-30));
        let whole = Vec3::select(valid, all, Vec3::ONE);
        let valid = Vec3::select(valid, Vec3::ONE, Vec3::ZERO);
        ([lit / whole, unknown / whole, valid], rays)
    };
    let columns = grid.size().0.max(1);
    let traced: Vec<([Vec3; 3], u64)> = (0..grid.len()).into_par_iter().with_min_len(columns).map(trace).collect();
    let channels: [Vec<Vec3>; 3] = std::array::from_fn(|c| traced.iter().map(|(values, _)| values[c]).collect());
    let up = grid.upsample(points, normal, &channels);
    let (width, height) = points.0.size();
    // `dark` is the answer where no light arrives at all.
    let share = |k: usize, dark: f32, value: &dyn Fn(usize) -> f32| {
        let pixel = |i: usize| {
            let valid = up[2].pixels()[i][k];
            if is_own(i) {
                0.0
            } else if valid > 0.0 {
                (value(i) / valid).clamp(0.0, 1.0)
            } else {
                dark
            }
        };
        Plane::new(width, height, (0..width * height).map(pixel).collect())
    };
    let at = |channel: usize, k: usize, i: usize| up[channel].pixels()[i][k];
    let assume = quality.assume_lit;
    Shadow {
        lit: (0..lobes).map(|k| share(k, 1.0, &|i| at(0, k, i) + assume * at(1, k, i))).collect(),
        unknown: (0..lobes).map(|k| share(k, 0.0, &|i| at(1, k, i))).collect(),
        rays: traced.iter().map(|t| t.1).sum(),
    }
}
