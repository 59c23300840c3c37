//! Proposals for lamps and windows, from a photo and its depth where there is one.
//!
//! A light is brighter than its surroundings and ends sharply; light on a wall fades. So the photo
//! is cut in two at several levels of brightness (Boykov and Jolly's energy, see [`graph_cut`]).
//! With b the brightness over white and t the level, a pixel gains `1 - ln b / ln t` by being a
//! light: 1 at white, 0 at t. Two neighbors of colors c, c' that are separated cost `smoothness
//! exp(-beta |c - c'|^2) / distance`, 1 / beta twice the mean of |c - c'|^2. The gain falls with t,
//! so the cuts are nested and their regions form a tree, in which every light is taken at the level
//! of its sharpest edge: Matas' extremal regions (BMVC 2002) with edges instead of stability.

use glam::Vec3;

use super::observations::white_level;
use crate::geometry::world_up;
use crate::image::{
    Mask, Normal, Picture, Plane, Points, connected_components, distance, graph_cut, luminance,
};
use crate::optics::LightKind;
use crate::tuning::tuning;

/// Settings of [`find_lights`].
#[derive(Clone, Copy, Debug)]
pub struct LightSearch {
    /// Brightness of the dimmest light, as a fraction of the photo's white, in 0..1.
    pub threshold: f32,
    /// Cost of an edge along the outline, in units of the gain of a white pixel; >= 0.
    pub smoothness: f32,
    /// Pixels of the smallest light, as a fraction of the photo, 0..=1.
    pub smallest: f32,
    /// Most lights; larger ones first.
    pub most: usize,
}

/// A proposed light.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundLight {
    /// Lamp or window.
    pub kind: LightKind,
    /// Its pixels, of the photo's size.
    pub mask: Plane<bool>,
    /// Number of its pixels.
    pub area: usize,
    /// Brightness just inside its edge over that just outside, medians of the least channel.
    pub contrast: f32,
    /// Confidence that it is a light of its kind, 0..=1; not a probability.
    pub confidence: f32,
}

impl FoundLight {
    /// Whether the confidence is enough for the light to be used without a person's check.
    pub fn is_certain(&self) -> bool {
        self.confidence >= TUNING.certain
    }
}

tuning! {
    /// Constants of the proposals for lamps and windows.
    pub const TUNING: FindLightsTuning {
        /// Levels between the threshold and white, each half as far from white as the one before:
        /// the last lies 1.6 % below it for the threshold of 0.75, two steps of 8 bits.
        levels: usize = 5,
            unit "levels", source Measured("docs/find-lights.md"), effect "a larger value finds sharper outlines";
        /// Steps in which the gains and edge costs of a cut are rounded to whole numbers, so that
        /// the cut is exact.
        cut_scale: f32 = 1000.0,
            unit "steps per gain of a white pixel", source Taste,
            effect "a larger value rounds less; sums along a path must stay below 2^31";
        /// Least brightness of which the logarithm is taken.
        darkest: f32 = 1e-6,
            unit "fraction of white", source Derived("gains are clamped to -1 far above it"),
            effect "none above the least subnormal number";
        /// Least sum of squared color steps by which the number of steps is divided.
        min_step_energy: f64 = 1e-6,
            unit "1", source Taste, effect "a larger value makes the edges of an even photo cost more";
        /// Brightness inside over outside below which an edge is that of light on a surface: the
        /// median along the outline, and for three quarters of it.
        contrast: [f32; 2] = [1.28, 1.22],
            unit "1", source Measured("docs/find-lights.md"), effect "a larger value proposes fewer lights";
        /// Quantile of the surroundings' brightness that three quarters of an outline exceed in
        /// contrast.
        contrast_quantile: f32 = 0.75,
            unit "1", source Measured("docs/find-lights.md"), effect "a larger value proposes fewer lights";
        /// Least brightness outside by which that inside is divided.
        min_outside: f32 = 0.01,
            unit "fraction of white", source Taste,
            effect "a larger value lowers the contrast of lights before darkness";
        /// Factor by which a higher level must raise the logarithm of the contrast to be taken.
        contrast_factor: f32 = 1.15,
            unit "1", source Measured("no page records it"),
            effect "a larger value keeps lower levels, and larger masks";
        /// Least fraction of the pixels that are white in all channels, or of the color of
        /// daylight.
        emitting: f32 = 0.15,
            unit "1", source Measured("no page records it"), effect "a larger value proposes fewer lights";
        /// Least channel of a white pixel.
        white: f32 = 0.93,
            unit "fraction of white", source Measured("no page records it"),
            effect "a larger value proposes fewer lights";
        /// Least log(blue / red) of daylight above the photo's neutral.
        daylight: f32 = 0.1,
            unit "1", source Measured("no page records it"), effect "a larger value finds fewer windows";
        /// Offset of blue and red in log(blue / red), which bounds it in the dark.
        hue_offset: f32 = 0.01,
            unit "fraction of white", source Taste, effect "a larger value makes dark pixels more neutral";
        /// Cosine between the upward direction and the median normal above which a surface is a
        /// floor, a table or a bed.
        max_upward: f32 = 0.5,
            unit "1", source Measured("no page records it"), effect "a smaller value proposes fewer lights";
        /// Distance below the camera beyond which there are neither lamps nor windows.
        max_below: f32 = 0.8,
            unit "meters", source Taste, effect "a smaller value proposes fewer lights";
        /// Largest distance between panes of one window.
        muntin: f32 = 0.015,
            unit "fraction of the longer side", source Measured("no page records it"),
            effect "a larger value joins more panes";
        /// Distances outside of a region from which and to which its surroundings are measured: the
        /// pixels on the edge itself are mixtures.
        annulus: [f32; 2] = [1.2, 3.0],
            unit "pixels", source Taste, effect "a larger value compares a light with what is farther away";
        /// Distances from the edge, inside of a region, from which and to which its boundary is
        /// measured.
        boundary: [f32; 2] = [1.0, 3.0],
            unit "pixels", source Taste, effect "a larger value measures more of the inside";
        /// Distances outside of a region from which and to which the depth of its surroundings is
        /// measured.
        around: [f32; 2] = [1.2, 5.0],
            unit "pixels", source Taste,
            effect "a larger value compares the depth of a window with what is farther away";
        /// Radius around a region in which its surroundings are computed.
        context_radius: usize = 6,
            unit "pixels", source Derived("the largest distance of `around`, and one pixel"),
            effect "a larger value is slower; no result changes";
        /// Quantile of the depth of the surroundings with which that of a region is compared: a
        /// lamp may touch its table, and the wall of a window may recede.
        around_quantile: f32 = 0.35,
            unit "1", source Measured("no page records it"), effect "a larger value finds fewer windows";
        /// Depth of a region over that of its surroundings at which a window's vote is 0 and 1.
        flush_vote: [f32; 2] = [0.98, 1.0],
            unit "1", source Measured("docs/find-lights.md"), effect "larger values find fewer windows";
        /// Log of the contrast of a frame at which a window's vote is 0 and 1.
        frame_vote: [f32; 2] = [0.35, 0.5],
            unit "1", source Measured("docs/find-lights.md"), effect "larger values find fewer windows";
        /// Fraction of its bounding box that a region covers, at which a window's vote is 0 and 1.
        rectangle_vote: [f32; 2] = [0.7, 0.8],
            unit "1", source Measured("docs/find-lights.md"), effect "larger values find fewer windows";
        /// Fraction of daylight at which a window's vote is 0 and 1.
        daylight_vote: [f32; 2] = [0.0, 0.2],
            unit "1", source Measured("docs/find-lights.md"), effect "larger values find fewer windows";
        /// Vote on the depth of a region of a photo without depth.
        unknown_flush: f32 = 0.5,
            unit "votes", source Taste, effect "a larger value finds more windows in photos without depth";
        /// Weight of the vote on the rectangle.
        rectangle_weight: f32 = 0.5,
            unit "1", source Taste, effect "a larger value lets the outline decide more";
        /// Sum of votes above which a region is a window: one vote is not enough for a warm glow on
        /// a wall, which lies in its plane too.
        min_votes: f32 = 1.0,
            unit "votes", source Measured("docs/find-lights.md"), effect "a larger value finds fewer windows";
        /// Fractions of a region that are white and that are daylight, together, at which it emits
        /// with a confidence of 0 and 1.
        emission: [f32; 2] = [0.4, 0.8],
            unit "1", source Measured("docs/find-lights.md"), effect "larger values doubt more lights";
        /// Fraction of its bounding box that a window covers, at which the confidence is 0 and 1.
        pane_fill: [f32; 2] = [0.25, 0.65],
            unit "1", source Measured("docs/find-lights.md"), effect "larger values doubt more windows";
        /// Fraction of daylight at which the confidence in a window is 0 and 1.
        pane_daylight: [f32; 2] = [0.0, 0.4],
            unit "1", source Measured("docs/find-lights.md"), effect "larger values doubt more windows";
        /// Depth of a lamp over that of its surroundings at which the confidence is 0 and 1.
        behind: [f32; 2] = [1.14, 1.0],
            unit "1", source Measured("docs/find-lights.md"), effect "smaller values doubt more lamps";
        /// Least confidence of a light that is used without a person's check.
        certain: f32 = 0.5,
            unit "1", source Measured("docs/find-lights.md"), effect "a larger value doubts more lights";
    }
}

/// Proposes the lights in `photo` (linear, with the `clipped` fraction of each pixel), the largest
/// first.
///
/// All planes are of one size. `room` holds the points (meters, camera space) and unit normals of
/// its pixels. The result is empty where nothing stands out, as in a photo of one color.
pub fn find_lights(
    photo: &Picture,
    clipped: &Mask,
    room: Option<(&Points, &Normal)>,
    search: &LightSearch,
) -> Vec<FoundLight> {
    let pixels = photo.0.pixels().iter().zip(clipped.0.pixels());
    let white = white_level(pixels.map(|(&pixel, &clipped)| (pixel, clipped > 0.5)));
    if white <= 0.0 {
        return Vec::new();
    }
    let cues = Cues::new(photo.0.map(|pixel| (pixel / white).clamp(Vec3::ZERO, Vec3::ONE)), room);
    let (w, h) = cues.photo.size();
    let smallest = (search.smallest * (w * h) as f32).max(1.0) as usize;

    let mut kept: Vec<BrightRegion> = Vec::new();
    for level in (0..TUNING.levels as i32).rev() {
        let threshold = 1.0 - (1.0 - search.threshold) * 0.5f32.powi(level);
        let label = cues.cut(threshold, search.smoothness);
        let large =
            connected_components(&label).into_iter().filter(|pixels| pixels.len() >= smallest);
        let mut merged = Vec::new();
        for region in large.map(|pixels| cues.region(pixels, &label)) {
            let (inner, others) = kept.into_iter().partition(|inner: &BrightRegion| {
                region.pixels.binary_search(&inner.pixels[0]).is_ok()
            });
            kept = others;
            let sharpest = inner.iter().map(|inner| inner.contrast.ln()).fold(0.0, f32::max);
            let contrast = if cues.emits(&region) { region.contrast.ln() } else { 0.0 };
            if TUNING.contrast_factor * contrast > sharpest {
                merged.push(region)
            } else {
                merged.extend(inner)
            }
        }
        kept = merged;
    }
    let (windows, lamps): (Vec<BrightRegion>, Vec<BrightRegion>) =
        kept.into_iter().partition(|region| cues.votes(region) > TUNING.min_votes);
    let windows = join(windows, (w, h)).into_iter().map(|region| (LightKind::Window, region));
    let mut found: Vec<_> =
        windows.chain(lamps.into_iter().map(|region| (LightKind::Lamp, region))).collect();
    found.sort_by_key(|(_, region)| std::cmp::Reverse(region.pixels.len()));
    found.truncate(search.most);
    let light = |(kind, region): (LightKind, BrightRegion)| {
        let (area, contrast) = (region.pixels.len(), region.contrast);
        let confidence = cues.confidence(kind, &region);
        FoundLight { kind, mask: mask(&region.pixels, (w, h)), area, contrast, confidence }
    };
    found.into_iter().map(light).collect()
}

fn mask(pixels: &[usize], (w, h): (usize, usize)) -> Plane<bool> {
    let mut mask = Plane::filled(w, h, false);
    pixels.iter().for_each(|&i| mask.pixels_mut()[i] = true);
    mask
}

/// A connected region of a cut.
struct BrightRegion {
    pixels: Vec<usize>,
    /// Fraction of its bounding box that it covers.
    fill: f32,
    /// Pixels up to four away from it.
    around: Vec<usize>,
    /// Brightness inside over outside, in the least channel: its median along the outline, and the
    /// value that three quarters reach.
    contrast: f32,
    least_contrast: f32,
    /// The same in brightness, for three quarters.
    frame: f32,
}

/// The photo over its white, and quantities derived from it.
struct Cues<'a> {
    photo: Plane<Vec3>,
    /// Luminance, or blue if that is more: daylight is bright in it, and no surface in a room
    /// reflects so.
    bright: Plane<f32>,
    /// The least channel: white where all are, so that the warm light around a lamp is below the
    /// lamp.
    least: Plane<f32>,
    /// log(blue / red) of the median pixel.
    neutral: f32,
    /// The display-encoded photo, and beta of the cost of its edges.
    shown: Plane<Vec3>,
    beta: f32,
    /// Points, normals, and the upward direction.
    room: Option<(&'a Points, &'a Normal, Vec3)>,
}

impl<'a> Cues<'a> {
    fn new(photo: Plane<Vec3>, room: Option<(&'a Points, &'a Normal)>) -> Cues<'a> {
        // A square root approximates the curve of a display.
        let shown = photo.map(|c| Vec3::new(c.x.sqrt(), c.y.sqrt(), c.z.sqrt()));
        let (w, h) = photo.size();
        let (mut sum, mut count) = (0.0f64, 0.0f64);
        for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
            for (nx, ny) in
                [(x + 1, y), (x, y + 1)].into_iter().filter(|&(nx, ny)| nx < w && ny < h)
            {
                sum += f64::from(shown.get(x, y).distance_squared(shown.get(nx, ny)));
                count += 1.0;
            }
        }
        Cues {
            bright: photo.map(|c| luminance(c).max(c.z)),
            least: photo.map(Vec3::min_element),
            neutral: quantile(photo.pixels().iter().map(|&c| hue(c)), 0.5),
            beta: (count / (2.0 * sum).max(TUNING.min_step_energy)) as f32,
            room: room.map(|(points, normal)| (points, normal, world_up(normal))),
            photo,
            shown,
        }
    }

    /// Pixels that are a light at this level; gains are in thousandths so that the cut is exact.
    fn cut(&self, threshold: f32, smoothness: f32) -> Plane<bool> {
        let gain = |b: f32| {
            TUNING.cut_scale * (1.0 - b.max(TUNING.darkest).ln() / threshold.ln()).clamp(-1.0, 1.0)
        };
        let gain = self.bright.map(|b| gain(b) as i32);
        graph_cut(&gain, |x, y, nx, ny| {
            let step = self.shown.get(x, y).distance_squared(self.shown.get(nx, ny));
            let distance = if x == nx || y == ny { 1.0 } else { std::f32::consts::SQRT_2 };
            (TUNING.cut_scale * smoothness * (-self.beta * step).exp() / distance) as i32
        })
    }

    /// The region of these pixels; its surroundings are the pixels outside of `label`.
    fn region(&self, pixels: Vec<usize>, label: &Plane<bool>) -> BrightRegion {
        let (w, h) = self.photo.size();
        let extent = |value: &dyn Fn(usize) -> usize| {
            let ends = |(least, most): (usize, usize), &i: &usize| {
                (least.min(value(i)), most.max(value(i)))
            };
            pixels.iter().fold((usize::MAX, 0), ends)
        };
        let ((left, right), (top, bottom)) = (extent(&|i| i % w), extent(&|i| i / w));
        // Only a window around it is processed, so that many small regions cost no more than a
        // large one.
        let (x0, x1) = (
            left.saturating_sub(TUNING.context_radius),
            (right + TUNING.context_radius + 1).min(w),
        );
        let (y0, y1) = (
            top.saturating_sub(TUNING.context_radius),
            (bottom + TUNING.context_radius + 1).min(h),
        );
        let mut inside = Plane::filled(x1 - x0, y1 - y0, false);
        pixels.iter().for_each(|&i| inside.set(i % w - x0, i / w - y0, true));
        let (away, into) = (distance(&inside), distance(&inside.map(|inside| !inside)));
        let within = |plane: &Plane<f32>, [from, to]: [f32; 2]| -> Vec<usize> {
            let near =
                (0..plane.len()).filter(|&i| plane.pixels()[i] >= from && plane.pixels()[i] < to);
            near.map(|i| (y0 + i / (x1 - x0)) * w + x0 + i % (x1 - x0)).collect()
        };
        // The pixels on either side of the edge itself are mixtures.
        let mut annulus = within(&away, TUNING.annulus);
        annulus.retain(|&i| !label.pixels()[i]);
        let boundary = within(&into, TUNING.boundary);
        let contrast = |plane: &Plane<f32>, fraction: f32| {
            let inside = quantile(boundary.iter().map(|&i| plane.pixels()[i]), 0.5);
            let outside = quantile(annulus.iter().map(|&i| plane.pixels()[i]), fraction);
            // A region that covers the photo stands out from nothing.
            if annulus.is_empty() { 0.0 } else { inside / outside.max(TUNING.min_outside) }
        };
        BrightRegion {
            contrast: contrast(&self.least, 0.5),
            least_contrast: contrast(&self.least, TUNING.contrast_quantile),
            frame: contrast(&self.bright, TUNING.contrast_quantile),
            around: within(&away, TUNING.around),
            fill: pixels.len() as f32 / ((right - left + 1) * (bottom - top + 1)) as f32,
            pixels,
        }
    }

    fn fraction(&self, region: &BrightRegion, test: impl Fn(usize) -> bool) -> f32 {
        region.pixels.iter().filter(|&&i| test(i)).count() as f32 / region.pixels.len() as f32
    }

    fn daylight(&self, region: &BrightRegion) -> f32 {
        self.fraction(region, |i| {
            hue(self.photo.pixels()[i]) > TUNING.daylight + self.neutral.max(0.0)
        })
    }

    /// Returns whether a region may be a light: it is sharp, as white or as blue as the photo gets,
    /// and not on a floor or table.
    fn emits(&self, region: &BrightRegion) -> bool {
        let sharp =
            region.contrast > TUNING.contrast[0] && region.least_contrast > TUNING.contrast[1];
        let white = self.fraction(region, |i| self.least.pixels()[i] > TUNING.white);
        let placed = self.room.is_none_or(|(points, normal, up)| {
            let median = |plane: &Plane<Vec3>| {
                quantile(region.pixels.iter().map(|&i| plane.pixels()[i].dot(up)), 0.5)
            };
            median(&normal.0) < TUNING.max_upward && median(&points.0) > -TUNING.max_below
        });
        sharp && placed && white.max(self.daylight(region)) > TUNING.emitting
    }

    /// Sum of the votes for a window, of about -1..1 each: it lies in the plane of
    /// its surroundings, not before it; in a frame, not in its own glow; it is a rectangle; it has
    /// daylight. A warm glow on a wall lies in its plane too, so that one vote is not enough.
    fn votes(&self, region: &BrightRegion) -> f32 {
        let vote =
            |value: f32, [zero, one]: [f32; 2]| ((value - zero) / (one - zero)).clamp(-1.0, 1.0);
        let flush =
            self.recession(region).map_or(TUNING.unknown_flush, |r| vote(r, TUNING.flush_vote));
        let frame = vote(region.frame.ln(), TUNING.frame_vote);
        flush
            + frame
            + TUNING.rectangle_weight * vote(region.fill, TUNING.rectangle_vote)
            + vote(self.daylight(region), TUNING.daylight_vote)
    }

    /// Confidence in a region as a light of this kind: the least of its cues. Of either,
    /// that it is as white or as blue as the photo gets; of a window, that it fills a rectangle or
    /// has daylight, which the sun on a wall does not; of a lamp, that it does not lie behind its
    /// surroundings.
    fn confidence(&self, kind: LightKind, region: &BrightRegion) -> f32 {
        let share =
            |value: f32, [zero, one]: [f32; 2]| ((value - zero) / (one - zero)).clamp(0.0, 1.0);
        let white = self.fraction(region, |i| self.least.pixels()[i] > TUNING.white);
        let daylight = self.daylight(region);
        let emits = share(white + daylight, TUNING.emission);
        emits.min(match kind {
            LightKind::Window => {
                share(region.fill, TUNING.pane_fill).max(share(daylight, TUNING.pane_daylight))
            }
            LightKind::Lamp => self.recession(region).map_or(1.0, |r| share(r, TUNING.behind)),
        })
    }

    /// Median depth of a region over that of its surroundings; `None` without depth.
    fn recession(&self, region: &BrightRegion) -> Option<f32> {
        let (points, ..) = self.room?;
        let depth = |pixels: &[usize], fraction| {
            quantile(pixels.iter().map(|&i| -points.0.pixels()[i].z), fraction)
        };
        // Before two thirds of it: a lamp may touch its table, and the wall of a window may recede.
        Some(depth(&region.pixels, 0.5) / depth(&region.around, TUNING.around_quantile))
    }
}

/// log(blue / red), bounded in the dark.
fn hue(color: Vec3) -> f32 {
    ((color.z + TUNING.hue_offset) / (color.x + TUNING.hue_offset)).ln()
}

/// The quantile `fraction` of the values, 0..=1; 0 of none.
pub fn quantile(values: impl Iterator<Item = f32>, fraction: f32) -> f32 {
    let mut values: Vec<f32> = values.collect();
    if values.is_empty() {
        return 0.0;
    }
    let at = ((fraction * values.len() as f32) as usize).min(values.len() - 1);
    *values.select_nth_unstable_by(at, f32::total_cmp).1
}

/// Joins regions within `TUNING.muntin` of each other in a picture of this size, with the contrast
/// of the largest.
fn join(parts: Vec<BrightRegion>, size: (usize, usize)) -> Vec<BrightRegion> {
    let reach = TUNING.muntin * size.0.max(size.1) as f32;
    let mut joined: Vec<BrightRegion> = Vec::new();
    for mut region in parts {
        let away = distance(&mask(&region.pixels, size));
        let is_near =
            |other: &BrightRegion| other.pixels.iter().any(|&i| away.pixels()[i] <= reach);
        let (near, others) = joined.into_iter().partition(is_near);
        joined = others;
        for mut other in near {
            if other.pixels.len() > region.pixels.len() {
                std::mem::swap(&mut region, &mut other);
            }
            region.pixels.extend(other.pixels);
        }
        joined.push(region);
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;

    const SEARCH: LightSearch =
        LightSearch { threshold: 0.75, smoothness: 1.0, smallest: 0.001, most: 16 };
    const SIZE: (usize, usize) = (160, 120);

    /// The value of `value` clipped at 1, with noise of a few steps of 8 bits, and where it is
    /// clipped.
    fn photo(value: impl Fn(usize, usize) -> Vec3) -> (Picture, Mask) {
        let noise = |x: usize, y: usize| ((x * 7919 + y * 104_729) % 13) as f32 / 13.0 - 0.5;
        let photo = Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            (value(x, y) * (1.0 + 0.02 * noise(x, y))).min(Vec3::ONE)
        });
        let clipped = photo.map(|c| if c.max_element() >= 0.99 { 1.0 } else { 0.0 });
        (Picture(photo), Mask(clipped))
    }

    fn find(value: impl Fn(usize, usize) -> Vec3) -> Vec<FoundLight> {
        let (photo, clipped) = photo(value);
        find_lights(&photo, &clipped, None, &SEARCH)
    }

    fn overlap(got: &Plane<bool>, inside: impl Fn(usize, usize) -> bool) -> f32 {
        let wanted = Plane::from_fn(got.width(), got.height(), inside);
        let pairs = || got.pixels().iter().zip(wanted.pixels());
        pairs().filter(|(a, b)| **a && **b).count() as f32
            / pairs().filter(|(a, b)| **a || **b).count() as f32
    }

    fn disc(x: usize, y: usize) -> bool {
        (x as f32 - 50.0).hypot(y as f32 - 40.0) < 9.0
    }

    fn pane(x: usize, y: usize) -> bool {
        (100..135).contains(&x) && (20..70).contains(&y)
    }

    /// A warm lamp whose light fades over a wall that it saturates nearby.
    fn lamp(x: usize, y: usize) -> Vec3 {
        let away = (x as f32 - 50.0).hypot(y as f32 - 40.0);
        if disc(x, y) {
            Vec3::new(6.0, 5.0, 3.0)
        } else {
            Vec3::new(1.0, 0.75, 0.5) * (400.0 / (200.0 + away * away))
        }
    }

    #[test]
    fn a_lamp_is_told_from_its_light_on_the_wall() {
        let found = find(lamp);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].kind, LightKind::Lamp);
        let overlap = overlap(&found[0].mask, disc);
        assert!(overlap > 0.95, "intersection over union {overlap}");
    }

    #[test]
    fn a_window_is_one_with_its_muntins_and_blue_where_it_is_not_clipped() {
        let glass = |x: usize, y: usize| pane(x, y) && x != 117 && y != 45;
        for sky in [Vec3::new(0.5, 0.7, 1.0), Vec3::splat(2.0)] {
            let found = find(|x, y| if glass(x, y) { sky } else { Vec3::splat(0.2) });
            assert_eq!(
                found.iter().map(|light| light.kind).collect::<Vec<_>>(),
                [LightKind::Window]
            );
            let overlap = overlap(&found[0].mask, glass);
            assert!(overlap > 0.9, "intersection over union {overlap}");
        }
    }

    #[test]
    fn fading_light_specks_and_even_photos_are_none() {
        let far = |x: usize, y: usize| (x as f32 - 60.0).hypot(y as f32 - 50.0);
        assert_eq!(
            find(|x, y| Vec3::splat(1.5 / (1.0 + (far(x, y) / 60.0).powi(2)))),
            [],
            "light on a wall"
        );
        assert_eq!(
            find(|x, y| if far(x, y) < 2.0 { Vec3::ONE } else { Vec3::splat(0.1) }),
            [],
            "a speck of 13 pixels"
        );
        for level in [0.0, 0.3, 1.0] {
            assert_eq!(find(|_, _| Vec3::splat(level)), [], "{level} everywhere");
        }
        for (size, level) in [((1, 1), 1.0), ((1, 1), 0.0), ((2, 1), 1.0), ((0, 0), 0.0)] {
            let plane = |value| Plane::filled(size.0, size.1, value);
            let (photo, clipped) =
                (Picture(plane(1.0).map(|_| Vec3::splat(level))), Mask(plane(level)));
            assert_eq!(find_lights(&photo, &clipped, None, &SEARCH), [], "{size:?} of {level}");
        }
    }

    #[test]
    fn exposure_does_not_matter() {
        let (photo, clipped) = photo(lamp);
        let wanted = find_lights(&photo, &clipped, None, &SEARCH);
        for scale in [2f32.powi(-30), 2f32.powi(30)] {
            let scaled = Picture(photo.0.map(|c| c * scale));
            assert_eq!(find_lights(&scaled, &clipped, None, &SEARCH), wanted, "{scale}");
        }
    }

    /// A photo that was never clipped: white is twice the 90th percentile of the wall.
    #[test]
    fn a_photo_of_high_dynamic_range_shows_its_lamp() {
        let value = |x, y| if disc(x, y) { Vec3::splat(300.0) } else { Vec3::splat(0.3) };
        let (photo, clear) =
            (Plane::from_fn(SIZE.0, SIZE.1, value), Plane::filled(SIZE.0, SIZE.1, 0.0));
        let found = find_lights(&Picture(photo), &Mask(clear), None, &SEARCH);
        assert_eq!(found.len(), 1);
        assert_eq!(overlap(&found[0].mask, disc), 1.0);
    }

    /// Two white rectangles, one in the wall and one half a meter before it, and a bright table.
    #[test]
    fn depth_tells_a_shade_from_a_pane_and_a_table_from_both() {
        let shade = |x: usize, y: usize| (20..50).contains(&x) && (30..55).contains(&y);
        let table = |x: usize, y: usize| (40..120).contains(&x) && (100..115).contains(&y);
        let camera = Camera::from_fov_x(SIZE.0, SIZE.1, 60.0);
        let points = Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            camera.pixel_point(x, y, if shade(x, y) { 2.5 } else { 3.0 })
        });
        let normal =
            Plane::from_fn(SIZE.0, SIZE.1, |x, y| if table(x, y) { Vec3::Y } else { Vec3::Z });
        let bright = |x, y| shade(x, y) || pane(x, y) || table(x, y);
        let (photo, clipped) = photo(|x, y| Vec3::splat(if bright(x, y) { 1.5 } else { 0.2 }));
        let found =
            find_lights(&photo, &clipped, Some((&Points(points), &Normal(normal))), &SEARCH);
        let kinds: Vec<LightKind> = found.iter().map(|light| light.kind).collect();
        assert_eq!(kinds, [LightKind::Window, LightKind::Lamp]);
        for (light, inside) in found.iter().zip([&pane as &dyn Fn(usize, usize) -> bool, &shade]) {
            let overlap = overlap(&light.mask, inside);
            assert!(overlap > 0.95, "intersection over union {overlap}");
        }
        let (room, one) = (None, LightSearch { most: 1, ..SEARCH });
        assert_eq!(find_lights(&photo, &clipped, room, &one).len(), 1, "the most that are wanted");
    }
}
