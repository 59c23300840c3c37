//! Edges of a photo between neighboring pixels: sharp, blurred over two pixels, or faint
//! (`FaintEdges`). A step within the photo's noise is not an edge, nor is a ramp.

use glam::Vec3;

use super::close_region::sides;
use super::faint_edges::FaintEdges;
use super::surface::median;
use crate::image::{Picture, Plane, intensity_and_chroma, log_above};
use crate::tuning::tuning;

tuning! {
    /// Constants of the edges at which a surface ends.
    pub const TUNING: PhotoEdgesTuning {
        /// Log step of the level of the picture between neighbors of which only one is of the
        /// surface.
        edge: f32 = 0.3,
            unit "1", source Taste, effect "a larger value crosses fainter edges";
        /// The same step of log chromaticity, which no shadow changes as much.
        chroma_edge: f32 = 0.12,
            unit "1", source Taste, effect "a larger value crosses fainter edges";
        /// Least step of an edge that is blurred over two pixels.
        blurred: f32 = 1.5,
            unit "steps of a sharp edge", source Measured("the baseboard of scenes/demo: 1.7 to 2"),
            effect "a smaller value stops at soft shadows";
        /// Least step over four pixels of a ramp; a blurred edge has a smaller one.
        ramp: f32 = 1.5,
            unit "steps over the two pixels in the middle", source Derived("an edge has 1, an even ramp 2"),
            effect "a larger value stops at the halos of lamps";
        /// Least value of the photo of which the logarithm is taken.
        dark: f32 = 0.004,
            unit "units of the photo", source Derived("quantization of 8-bit photos"),
            effect "a larger value hides edges in the dark";
        /// Ratio of a step to the median step up to which the step is noise.
        noises: f32 = 5.0,
            unit "1", source Taste, effect "a larger value crosses fainter edges of textured surfaces";
    }
}

/// The logarithm of a photo, in which edges are found.
pub fn log_photo(photo: &Picture) -> Plane<Vec3> {
    photo.0.map(log_color)
}

/// The logarithm of a color of a photo.
pub fn log_color(color: Vec3) -> Vec3 {
    log_above(TUNING.dark, color)
}

/// The edges of a photo at which a surface ends.
pub struct PhotoEdges<'a> {
    /// Logarithm of the photo.
    seen: &'a Plane<Vec3>,
    /// Largest log step of noise, per channel.
    noise: &'a Plane<Vec3>,
    faint: &'a FaintEdges,
    /// Log steps of level and chromaticity of a sharp edge.
    least: [f32; 2],
}

impl<'a> PhotoEdges<'a> {
    /// The edges of `seen`, the logarithm of the photo, in which steps up to `noise` are noise, and
    /// so are those that are usual within `surface`. All planes have one size.
    pub fn new(
        seen: &'a Plane<Vec3>,
        noise: &'a Plane<Vec3>,
        faint: &'a FaintEdges,
        surface: &Plane<bool>,
    ) -> PhotoEdges<'a> {
        let (w, h) = seen.size();
        let mut edges = PhotoEdges { seen, noise, faint, least: [TUNING.edge, TUNING.chroma_edge] };
        // Most neighbors on a surface differ by noise alone.
        let inside = |&i: &usize| surface.pixels()[i] && i % w + 1 < w && surface.pixels()[i + 1];
        let steps: Vec<[f32; 2]> =
            (0..w * h).filter(inside).map(|i| edges.step(i, i + 1)).collect();
        for (k, least) in edges.least.iter_mut().enumerate() {
            let mut values: Vec<f32> = steps.iter().map(|step| step[k]).chain([0.0]).collect();
            *least = least.max(TUNING.noises * median(&mut values).unwrap_or(0.0));
        }
        edges
    }

    /// Whether an edge is between two neighbors.
    pub fn between(&self, a: usize, b: usize) -> bool {
        self.sharpness(a, b) > 1.0 || self.faint.between(a, b)
    }

    /// The pixels of `set` that hang together with one of `starts` without a side that is an edge.
    /// Beyond those, the path leads through pixels without any edge, so that a gap of one pixel in
    /// an edge is closed.
    pub fn reached(&self, set: &Plane<bool>, starts: &[usize]) -> Plane<bool> {
        let (w, h) = set.size();
        let mut found = Plane::filled(w, h, false);
        starts.iter().for_each(|&start| found.pixels_mut()[start] = true);
        let mut front = starts.to_vec();
        while !front.is_empty() {
            let mut next = Vec::new();
            for (i, side) in front.into_iter().flat_map(|i| sides((w, h), i).map(move |s| (i, s))) {
                if set.pixels()[side] && !found.pixels()[side] && !self.parts(i, side) {
                    found.pixels_mut()[side] = true;
                    next.push(side);
                }
            }
            next.retain(|&i| !self.ends_at(i));
            front = next;
        }
        found
    }

    /// Whether an edge of any kind is on a side of a pixel.
    pub fn ends_at(&self, i: usize) -> bool {
        sides(self.seen.size(), i).any(|side| self.parts(i, side))
    }

    /// Whether an edge of any kind is between two neighbors, or on the next side in line.
    fn parts(&self, a: usize, b: usize) -> bool {
        let next = |a: usize, b: usize| in_line(self.seen.size(), a, b).unwrap_or(b);
        // A ramp continues on both sides, an edge does not.
        let is_blurred = |a: usize, b: usize, c: usize| {
            let across = self.sharpness(a, c);
            across > TUNING.blurred && self.sharpness(next(b, a), next(b, c)) < TUNING.ramp * across
        };
        let is_slope = || is_blurred(a, b, next(a, b)) || is_blurred(next(b, a), a, b);
        self.between(a, b) || self.sharpness(a, b) > 0.5 && is_slope()
    }

    /// The larger step between two pixels, of level or chromaticity, as a multiple of that of a
    /// sharp edge.
    fn sharpness(&self, a: usize, b: usize) -> f32 {
        let noise = self.noise.pixels()[a].max(self.noise.pixels()[b]).max_element();
        let steps = self.step(a, b).into_iter().zip(self.least);
        steps.map(|(step, least)| step / least.max(noise)).fold(0.0, f32::max)
    }

    /// Log steps of level and chromaticity between two pixels.
    fn step(&self, a: usize, b: usize) -> [f32; 2] {
        let (level, chroma) = intensity_and_chroma(self.seen.pixels()[a] - self.seen.pixels()[b]);
        [level.abs(), chroma.length()]
    }
}

/// The pixel that follows on the neighbors `a` and `b`, in the same direction.
fn in_line((w, h): (usize, usize), a: usize, b: usize) -> Option<usize> {
    let next = (2 * b).checked_sub(a).filter(|next| *next < w * h)?;
    (a.abs_diff(b) == w || next / w == b / w).then_some(next)
}
