//! Texture for hidden parts of a surface, copied from an exemplar: a part of the same surface that
//! the photo shows.
//!
//! Each pixel of a hole gets a source, the pixel at an offset that many pixels of the hole share
//! (shift maps: Pritch et al. 2009, He and Sun 2012). A few offsets are chosen one after the other:
//! each is one that gives most of the remaining pixels a source, and whose surroundings resemble
//! those of the hole best. Only the differences of neighbors are copied, as the guidance of
//! Poisson's equation (Perez et al. 2003), so that the level and the rim stay those of the hole.

use glam::{BVec3, Vec3};
use rayon::prelude::*;

use super::TUNING as FILL;
use crate::image::{Normal, Plane, Points, connected_components, inpaint_surfaces};
use crate::tuning::tuning;

tuning! {
    /// Constants of the texture that is copied into hidden parts of a surface.
    pub const TUNING: ExemplarTuning {
        /// Area from which on a hole gets texture.
        least: usize = 64,
            unit "working pixels", source Taste, effect "a larger value leaves small holes smooth";
        /// Largest number of holes that get texture, the largest ones.
        holes: usize = 32,
            unit "1", source Derived("bounded time: each takes 4 million comparisons at most"),
            effect "a smaller value leaves more holes smooth";
        /// Largest offset along each axis.
        reach: usize = 80,
            unit "working pixels", source Taste,
            effect "a larger value takes texture from farther away, where its scale differs, and takes longer";
        /// Step between the offsets that are tried.
        stride: usize = 2,
            unit "working pixels", source Taste, effect "a larger value misses offsets at which patterns match";
        /// Pixels of a hole by which offsets are compared.
        samples: usize = 100,
            unit "pixels", source Taste, effect "a larger value takes longer";
        /// Largest number of offsets of one hole.
        offsets: usize = 6,
            unit "1", source Taste, effect "a smaller value leaves parts of wide holes smooth";
        /// Part of the pixels that the best offset covers, from which on another may be chosen for
        /// its surroundings.
        nearly: f32 = 0.9,
            unit "1", source Taste, effect "a smaller value prefers patterns that match to large copies";
        /// Distance over which texture is averaged: what is coarser is not copied.
        coarsest: usize = 4,
            unit "working pixels", source Measured("lamps of nyu_0996, nyu_0958 and nyu_0189 that are off, with 3 to 5; by eye"),
            effect "a larger value copies stains of the shading";
        /// Width of the rim of a hole by which offsets are compared.
        rim: usize = 2,
            unit "working pixels", source Taste, effect "a larger value compares more of the surroundings";
        /// Cosine between normals on one surface that must be exceeded.
        same_normal: f32 = 0.9,
            unit "1", source Taste, effect "a smaller value copies across edges of the room";
        /// Distance of a point from the plane of another one on the same surface, over its depth.
        same_plane: f32 = 0.05,
            unit "1", source Taste, effect "a larger value copies from things before a wall";
        /// Largest ratio of the depths of a pixel and its source.
        same_scale: f32 = 1.4,
            unit "1", source Taste, effect "a larger value copies texture of another size";
    }
}

/// Inpaints the logarithms of a reflectance where it is `hidden`, see [`inpaint_surfaces`], and
/// gives the `holes`, parts of what is hidden, the texture of their surroundings.
pub fn inpaint_with_texture(
    logs: &mut Plane<Vec3>,
    (hidden, holes): (&Plane<bool>, &Plane<bool>),
    (points, normal): (&Points, &Normal),
    link: impl Fn(usize, usize) -> (Vec3, f32) + Sync,
) {
    let unknown = hidden.map(BVec3::splat);
    inpaint_surfaces(logs, unknown.clone(), (points, normal), &link);
    let smooth = logs.clone();
    let surface = Surface { logs: &smooth, hidden, points, normal };
    if let Some(texture) = Texture::new(surface, holes) {
        inpaint_surfaces(logs, unknown, (points, normal), |i, j| {
            let (step, weight) = link(i, j);
            (step + texture.step(i, j), weight)
        });
    }
}

/// The texture of holes.
struct Texture<'a> {
    surface: Surface<'a>,
    holes: &'a Plane<bool>,
    /// The source of each pixel of a hole, by index.
    source: Vec<Option<usize>>,
    /// Logarithms of the reflectance of sources and their neighbors, less their mean around.
    detail: Plane<Vec3>,
}

impl<'a> Texture<'a> {
    /// The texture of `holes`; `None` where no part of the picture is an exemplar.
    fn new(surface: Surface<'a>, holes: &'a Plane<bool>) -> Option<Texture<'a>> {
        let mut source = vec![None; holes.len()];
        let mut parts = connected_components(holes);
        parts.retain(|hole| hole.len() >= TUNING.least);
        parts.sort_by_key(|hole| std::cmp::Reverse(hole.len()));
        for hole in parts.into_iter().take(TUNING.holes) {
            surface.find_sources(hole, &mut source);
        }
        let sources: Vec<usize> = source.iter().copied().flatten().collect();
        (!sources.is_empty()).then(|| {
            let detail = surface.detail(&sources);
            Texture { surface, holes, source, detail }
        })
    }

    /// The logarithm of the reflectance of pixel `i` over that of its neighbor `j` in the texture
    /// of a hole; zero without texture.
    fn step(&self, i: usize, j: usize) -> Vec3 {
        let Texture { surface, holes, source, detail } = self;
        let is_surface = |i: usize| holes.pixels()[i] || !surface.hidden.pixels()[i];
        let from = |i: usize, j: usize| {
            let source = source[i].filter(|_| is_surface(j))?;
            let beside = surface.source(j, surface.offset(i, source))?;
            let is_alike = surface.are_alike(source, beside);
            is_alike.then(|| detail.pixels()[source] - detail.pixels()[beside])
        };
        match (from(i, j), from(j, i).map(|step| -step)) {
            (Some(a), Some(b)) => 0.5 * (a + b),
            (a, b) => a.or(b).unwrap_or(Vec3::ZERO),
        }
    }
}

/// A picture of surfaces.
#[derive(Clone, Copy)]
struct Surface<'a> {
    /// Logarithms of the reflectance, smooth where it is hidden.
    logs: &'a Plane<Vec3>,
    hidden: &'a Plane<bool>,
    points: &'a Points,
    normal: &'a Normal,
}

impl Surface<'_> {
    /// Finds a `source` for pixels of one hole.
    fn find_sources(&self, mut hole: Vec<usize>, source: &mut [Option<usize>]) {
        let rim = self.rim(&hole);
        for _ in 0..TUNING.offsets {
            let Some(offset) = self.best_offset(&hole, &rim) else { return };
            let before = hole.len();
            hole.retain(|&i| {
                source[i] = self.source(i, offset);
                source[i].is_none()
            });
            if hole.len() < TUNING.least || before - hole.len() < TUNING.least {
                return;
            }
        }
    }

    /// The offset that gives most pixels of a hole a source, or nearly so, and at which the
    /// surroundings resemble the `rim` best.
    fn best_offset(&self, hole: &[usize], rim: &[usize]) -> Option<[isize; 2]> {
        let [hole, rim] = [hole, rim].map(|pixels| -> Vec<usize> {
            let every = pixels.len().div_ceil(TUNING.samples).max(1);
            pixels.iter().copied().step_by(every).collect()
        });
        let reach = TUNING.reach as isize;
        let along = || (-reach..=reach).step_by(TUNING.stride);
        let offsets: Vec<[isize; 2]> =
            along().flat_map(|dy| along().map(move |dx| [dx, dy])).collect();
        let covered = offsets
            .par_iter()
            .map(|&offset| hole.iter().filter(|&&i| self.source(i, offset).is_some()).count());
        let covered: Vec<usize> = covered.collect();
        let most = *covered.iter().max().filter(|most| **most > 0)?;
        let is_nearly = |covered: usize| covered as f32 >= TUNING.nearly * most as f32;
        let misfits = offsets.into_par_iter().zip(covered).filter(|(_, n)| is_nearly(*n));
        let misfits: Vec<([isize; 2], f32)> =
            misfits.map(|(offset, _)| (offset, self.misfit(&rim, offset))).collect();
        misfits.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)).map(|(offset, _)| offset)
    }

    /// The differences between the `rim` of a hole and the pixels at an offset from it, less their
    /// mean, squared and summed; a pixel without a source counts as one that is not alike.
    fn misfit(&self, rim: &[usize], offset: [isize; 2]) -> f32 {
        let difference = |&i: &usize| {
            let source = self.source(i, offset)?;
            Some((self.logs.pixels()[i] - self.logs.pixels()[source]).element_sum() / 3.0)
        };
        let differences: Vec<f32> = rim.iter().filter_map(difference).collect();
        let mean = differences.iter().sum::<f32>() / differences.len().max(1) as f32;
        let squares = differences.iter().map(|step| (step - mean).powi(2)).sum::<f32>();
        squares + FILL.edge[0].powi(2) * (rim.len() - differences.len()) as f32
    }

    /// The known pixels within `TUNING.rim` of a hole.
    fn rim(&self, hole: &[usize]) -> Vec<usize> {
        let around = hole.iter().flat_map(|&i| self.around(i, TUNING.rim));
        let mut rim: Vec<usize> = around.filter(|&j| !self.hidden.pixels()[j]).collect();
        rim.sort_unstable();
        rim.dedup();
        rim
    }

    /// Logarithms of the reflectance of the pixels `of` and their neighbors, less their mean over
    /// the surface around; 0 elsewhere.
    fn detail(&self, of: &[usize]) -> Plane<Vec3> {
        let mut is_wanted = self.hidden.map(|_| false);
        for i in of.iter().flat_map(|&i| self.around(i, 1)) {
            is_wanted.pixels_mut()[i] = !self.hidden.pixels()[i];
        }
        let detail = |(i, is_wanted): (usize, &bool)| {
            if !is_wanted {
                return Vec3::ZERO;
            }
            let around = self.around(i, TUNING.coarsest);
            let alike = around.filter(|&j| !self.hidden.pixels()[j] && self.are_alike(i, j));
            let (sum, count) = alike.fold((Vec3::ZERO, 0), |(sum, count), j| {
                (sum + self.logs.pixels()[i] - self.logs.pixels()[j], count + 1)
            });
            // Without a normal, a pixel is not even like itself.
            sum / count.max(1) as f32
        };
        let (w, h) = self.logs.size();
        Plane::new(w, h, is_wanted.pixels().par_iter().enumerate().map(detail).collect())
    }

    /// The pixel at an offset from `i`, if it is known and of the same surface.
    fn source(&self, i: usize, offset: [isize; 2]) -> Option<usize> {
        let source = self.shifted(i, offset)?;
        (!self.hidden.pixels()[source] && self.are_alike(i, source)).then_some(source)
    }

    /// Whether two pixels are of one surface and alike in reflectance.
    fn are_alike(&self, i: usize, j: usize) -> bool {
        let (points, normals) = (self.points.0.pixels(), self.normal.0.pixels());
        let (a, b) = (-points[i].z, -points[j].z);
        let difference = self.logs.pixels()[i] - self.logs.pixels()[j];
        difference.abs().max_element() < FILL.edge[0]
            && a.max(b) < TUNING.same_scale * a.min(b)
            && normals[i].dot(normals[j]) > TUNING.same_normal
            && normals[i].dot(points[j] - points[i]).abs() < TUNING.same_plane * a
    }

    /// The pixels of the square around pixel `i`.
    fn around(&self, i: usize, reach: usize) -> impl Iterator<Item = usize> {
        let (w, h) = self.logs.size();
        let along = |at: usize, end: usize| at.saturating_sub(reach)..(at + reach + 1).min(end);
        let (columns, rows) = (along(i % w, w), along(i / w, h));
        rows.flat_map(move |y| columns.clone().map(move |x| y * w + x))
    }

    /// The pixel at an offset from `i`, within the picture.
    fn shifted(&self, i: usize, [dx, dy]: [isize; 2]) -> Option<usize> {
        let (w, h) = self.logs.size();
        let (x, y) = ((i % w).checked_add_signed(dx)?, (i / w).checked_add_signed(dy)?);
        (x < w && y < h).then_some(y * w + x)
    }

    /// The offset from pixel `i` to pixel `j`.
    fn offset(&self, i: usize, j: usize) -> [isize; 2] {
        let w = self.logs.width();
        let along = |from: usize, to: usize| to as isize - from as isize;
        [along(i % w, j % w), along(i / w, j / w)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (96, 60);

    /// A wall with the logarithms of the reflectance `log`, of which a hole is filled, first with
    /// no texture and then with it.
    fn filled(
        log: impl Fn(usize, usize) -> f32,
        is_hole: impl Fn(usize, usize) -> bool,
    ) -> [Plane<Vec3>; 2] {
        let points = Points(Plane::filled(SIZE.0, SIZE.1, Vec3::NEG_Z));
        let normal = Normal(Plane::filled(SIZE.0, SIZE.1, Vec3::Z));
        let surfaces = (&points, &normal);
        let holes = Plane::from_fn(SIZE.0, SIZE.1, is_hole);
        let mut smooth = Plane::from_fn(SIZE.0, SIZE.1, |x, y| Vec3::splat(log(x, y)));
        let mut textured = smooth.clone();
        let link = |_, _| (Vec3::ZERO, 1.0);
        inpaint_surfaces(&mut smooth, holes.map(BVec3::splat), surfaces, link);
        inpaint_with_texture(&mut textured, (&holes, &holes), surfaces, link);
        [smooth, textured]
    }

    fn in_hole(x: usize, y: usize) -> bool {
        (40..60).contains(&x) && (20..40).contains(&y)
    }

    /// Root mean square of `value` over the hole.
    fn rms(value: impl Fn(usize, usize) -> f32) -> f32 {
        let pixels = (20..40).flat_map(|y| (40..60).map(move |x| (x, y)));
        let squares: f32 = pixels.map(|(x, y)| value(x, y).powi(2)).sum();
        (squares / 400.0).sqrt()
    }

    #[test]
    fn stripes_go_on_in_a_hole() {
        let stripes =
            |x: usize, y: usize| 0.1 * (std::f32::consts::PI * (x + 2 * y) as f32 / 4.0).sin();
        let [smooth, textured] = filled(stripes, in_hole);
        let off = |got: &Plane<Vec3>| rms(|x, y| got.get(x, y).x - stripes(x, y));
        assert!(off(&smooth) > 0.06, "{}", off(&smooth));
        assert!(off(&textured) < 0.1 * off(&smooth), "{} of {}", off(&textured), off(&smooth));
    }

    #[test]
    fn grain_has_the_strength_of_the_wall_and_its_slope_stays_out() {
        let grain = |x: usize, y: usize| ((x * 7919 + y * 104_729) % 1000) as f32 / 5000.0 - 0.1;
        let wall = |x: usize, y: usize| 0.004 * x as f32 + grain(x, y);
        let [smooth, textured] = filled(wall, in_hole);
        let strength = rms(|x, y| textured.get(x, y).x - smooth.get(x, y).x);
        assert!((strength / rms(grain) - 1.0).abs() < 0.2, "{strength} of {}", rms(grain));
    }

    #[test]
    fn a_hole_without_an_exemplar_stays_as_it_is() {
        let grain = |x: usize, y: usize| ((x * 7919 + y * 104_729) % 1000) as f32 / 5000.0;
        let [smooth, textured] = filled(grain, |_, _| true);
        assert_eq!(smooth, textured);
        // A small hole is left smooth.
        let [smooth, textured] = filled(grain, |x, y| x.abs_diff(50) < 4 && y.abs_diff(30) < 4);
        assert_eq!(smooth, textured);
    }

    #[test]
    fn a_picture_on_the_wall_is_not_copied() {
        // A dark picture beside the hole, on an even wall.
        let picture = |x: usize, y: usize| if x < 30 && y > 10 { -1.0 } else { 0.0 };
        let [smooth, textured] = filled(picture, in_hole);
        assert!(rms(|x, y| textured.get(x, y).x - smooth.get(x, y).x) < 1e-3);
    }
}
