//! Lamps and windows proposed from a photo, and its depth where there is one.
//!
//! A light is brighter than what surrounds it and ends sharply; light on a wall fades. So the photo is cut in two at several
//! levels of brightness (Boykov and Jolly's energy, see [`grid_cut`]): with b the brightness over white and t the level, a pixel
//! gains `1 - ln b / ln t` by being a light, 1 at white, 0 at t, and two neighbours of colours c, c' that are parted cost
//! `smoothness exp(-beta |c - c'|^2) / distance`, 1 / beta twice the mean of |c - c'|^2. The gain falls with t, so the cuts are
//! nested and their parts form a tree, in which every light is taken at the level where its edge is sharpest: Matas' extremal regions
//! (BMVC 2002) with edges instead of stability.

use glam::Vec3;

use super::LightKind;
use super::evidence::white_level;
use crate::geometry::world_up;
use crate::image::{Mask, Normal, Picture, Plane, Points, distance, grid_cut, luminance, parts};

/// What is looked for.
#[derive(Clone, Copy, Debug)]
pub struct LightSearch {
    /// Brightness of the dimmest light, as a share of the photo's white; between 0 and 1.
    pub threshold: f32,
    /// What an edge along the outline costs, in units of what a white pixel gains.
    pub smoothness: f32,
    /// Pixels of the smallest light, as a share of the photo.
    pub smallest: f32,
    /// The most lights; larger ones first.
    pub most: usize,
}

/// A light that was found.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundLight {
    pub kind: LightKind,
    /// Its pixels.
    pub mask: Plane<bool>,
    /// How many there are.
    pub area: usize,
    /// Its brightness just inside its edge over that just outside, medians of the least channel.
    pub contrast: f32,
}

/// Levels between the threshold and white, each half as far from white as the one before: the last lies 1.6 % below it for the
/// threshold of 0.75, four steps of 8 bits.
const LEVELS: usize = 5;
/// Brightness inside over outside below which an edge is that of light on a surface: the median along the outline, and for three
/// quarters of it.
const CONTRAST: [f32; 2] = [1.28, 1.22];
/// A level is left for a higher one when that sharpens the contrast's logarithm by this factor.
const SHARPER: f32 = 1.15;
/// Share of the pixels that must be white in all channels, or bluer than all else.
const EMITTING: f32 = 0.15;
/// All channels of white, as a share of it.
const WHITE: f32 = 0.97;
/// log(blue / red) of daylight beside the photo's neutral.
const DAYLIGHT: f32 = 0.1;
/// What faces further up than this cosine is a floor, a table or a bed.
const FACES_UP: f32 = 0.5;
/// What lies lower than this below the camera, metres, is no lamp and no window.
const LOW: f32 = 0.8;
/// Parts of windows that are this near, as a share of the longer side, are panes of one.
const MUNTIN: f32 = 0.015;

/// Lights in `photo` (linear, with the share of each pixel that is `clipped`), the largest first. `room` holds the points and
/// normals of its pixels. Empty where nothing stands out, as in a photo of one colour.
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
    let view = View::new(photo.0.map(|pixel| (pixel / white).clamp(Vec3::ZERO, Vec3::ONE)), room);
    let (w, h) = view.photo.size();
    let smallest = (search.smallest * (w * h) as f32).max(1.0) as usize;

    let mut kept: Vec<Part> = Vec::new();
    for level in (0..LEVELS as i32).rev() {
        let threshold = 1.0 - (1.0 - search.threshold) * 0.5f32.powi(level);
        let label = view.cut(threshold, search.smoothness);
        let large = parts(&label).into_iter().filter(|pixels| pixels.len() >= smallest);
        let mut merged = Vec::new();
        for part in large.map(|pixels| view.part(pixels)) {
            let (inner, others) = kept.into_iter().partition(|inner: &Part| part.mask.pixels()[inner.pixels[0]]);
            kept = others;
            let sharpest = inner.iter().map(|inner| inner.contrast.ln()).fold(0.0, f32::max);
            let own = if view.emits(&part) { part.contrast.ln() } else { 0.0 };
            if SHARPER * own > sharpest { merged.push(part) } else { merged.extend(inner) }
        }
        kept = merged;
    }
    let (windows, lamps): (Vec<Part>, Vec<Part>) = kept.into_iter().partition(|part| view.is_window(part));
    let windows = join(windows, MUNTIN * w.max(h) as f32).into_iter().map(|pixels| view.part(pixels));
    let mut found: Vec<FoundLight> = windows
        .map(|part| part.light(LightKind::Window))
        .chain(lamps.into_iter().map(|part| part.light(LightKind::Lamp)))
        .collect();
    found.sort_by_key(|light| std::cmp::Reverse(light.area));
    found.truncate(search.most);
    found
}

/// A part of a cut.
struct Part {
    pixels: Vec<usize>,
    mask: Plane<bool>,
    /// Pixels up to four away from it.
    around: Vec<usize>,
    /// Inside over outside, in the least channel: its median along the outline, and that which three quarters reach.
    contrast: f32,
    least_contrast: f32,
    /// The same in brightness, for three quarters.
    frame: f32,
}

impl Part {
    fn light(self, kind: LightKind) -> FoundLight {
        FoundLight { kind, area: self.pixels.len(), contrast: self.contrast, mask: self.mask }
    }
}

/// The photo over its white, and what is known of it.
struct View<'a> {
    photo: Plane<Vec3>,
    /// Luminance, or blue where that is more: daylight is bright in it, and nothing in a room reflects so.
    bright: Plane<f32>,
    /// The least channel: white where all are, so that the warm light around a lamp is less than the lamp.
    least: Plane<f32>,
    /// log(blue / red) of the median pixel.
    neutral: f32,
    /// The photo as it is shown, and beta of the cost of its edges.
    shown: Plane<Vec3>,
    beta: f32,
    /// Points, normals, and the direction upwards.
    room: Option<(&'a Points, &'a Normal, Vec3)>,
}

impl<'a> View<'a> {
    fn new(photo: Plane<Vec3>, room: Option<(&'a Points, &'a Normal)>) -> View<'a> {
        // A square root stands for the curve of a display.
        let shown = photo.map(|c| Vec3::new(c.x.sqrt(), c.y.sqrt(), c.z.sqrt()));
        let (w, h) = photo.size();
        let (mut sum, mut count) = (0.0f64, 0.0f64);
        for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
            for (nx, ny) in [(x + 1, y), (x, y + 1)].into_iter().filter(|&(nx, ny)| nx < w && ny < h) {
                sum += f64::from(shown.get(x, y).distance_squared(shown.get(nx, ny)));
                count += 1.0;
            }
        }
        View {
            bright: photo.map(|c| luminance(c).max(c.z)),
            least: photo.map(Vec3::min_element),
            neutral: quantile(photo.pixels().iter().map(|&c| hue(c)), 0.5),
            beta: (count / (2.0 * sum).max(1e-6)) as f32,
            room: room.map(|(points, normal)| (points, normal, world_up(normal))),
            photo,
            shown,
        }
    }

    /// The pixels that are a light at this level, in thousandths so that the cut is exact.
    fn cut(&self, threshold: f32, smoothness: f32) -> Plane<bool> {
        let gain = self.bright.map(|b| (1000.0 * (1.0 - b.max(1e-6).ln() / threshold.ln()).clamp(-1.0, 1.0)) as i32);
        grid_cut(&gain, |x, y, nx, ny| {
            let step = self.shown.get(x, y).distance_squared(self.shown.get(nx, ny));
            let distance = if x == nx || y == ny { 1.0 } else { std::f32::consts::SQRT_2 };
            (1000.0 * smoothness * (-self.beta * step).exp() / distance) as i32
        })
    }

    fn part(&self, pixels: Vec<usize>) -> Part {
        let (w, h) = self.photo.size();
        let mut mask = Plane::filled(w, h, false);
        pixels.iter().for_each(|&i| mask.pixels_mut()[i] = true);
        let (away, into) = (distance(&mask), distance(&mask.map(|inside| !inside)));
        let within = |plane: &Plane<f32>, from: f32, to: f32| -> Vec<usize> {
            (0..w * h).filter(|&i| plane.pixels()[i] >= from && plane.pixels()[i] < to).collect()
        };
        // The pixels on either side of the edge itself are mixtures.
        let (rim, ring) = (within(&into, 1.0, 3.0), within(&away, 1.2, 3.0));
        let contrast = |plane: &Plane<f32>, share: f32| {
            let inside = quantile(rim.iter().map(|&i| plane.pixels()[i]), 0.5);
            let outside = quantile(ring.iter().map(|&i| plane.pixels()[i]), share);
            // What covers the photo stands out from nothing.
            if ring.is_empty() { 0.0 } else { inside / outside.max(0.01) }
        };
        Part {
            contrast: contrast(&self.least, 0.5),
            least_contrast: contrast(&self.least, 0.75),
            frame: contrast(&self.bright, 0.75),
            around: within(&away, 1.2, 5.0),
            pixels,
            mask,
        }
    }

    fn share(&self, part: &Part, test: impl Fn(usize) -> bool) -> f32 {
        part.pixels.iter().filter(|&&i| test(i)).count() as f32 / part.pixels.len() as f32
    }

    fn daylight(&self, part: &Part) -> f32 {
        self.share(part, |i| hue(self.photo.pixels()[i]) > DAYLIGHT + self.neutral.max(0.0))
    }

    /// Whether a part may be a light: sharp, as white or blue as its photo goes, and nowhere that only a lit thing can be.
    fn emits(&self, part: &Part) -> bool {
        let sharp = part.contrast > CONTRAST[0] && part.least_contrast > CONTRAST[1];
        let white = self.share(part, |i| self.least.pixels()[i] > WHITE);
        let placed = self.room.is_none_or(|(points, normal, up)| {
            let median = |plane: &Plane<Vec3>| quantile(part.pixels.iter().map(|&i| plane.pixels()[i].dot(up)), 0.5);
            median(&normal.0) < FACES_UP && median(&points.0) > -LOW
        });
        sharp && placed && white.max(self.daylight(part)) > EMITTING
    }

    /// Votes of a window against a lamp, each about -1..1: in the plane of what surrounds it, not before it; in a frame, not
    /// in its own glow; a rectangle; daylight. A warm glow on a wall lies in its plane too, so that one vote is not enough.
    fn is_window(&self, part: &Part) -> bool {
        let vote = |value: f32, zero: f32, one: f32| ((value - zero) / (one - zero)).clamp(-1.0, 1.0);
        let flush = self.room.map_or(0.5, |(points, ..)| {
            let depth = |pixels: &[usize], share| quantile(pixels.iter().map(|&i| -points.0.pixels()[i].z), share);
            // Before nearly all of it: a lamp may touch its table, and the wall of a window may recede.
            vote(depth(&part.pixels, 0.5) / depth(&part.around, 0.25), 0.95, 1.0)
        });
        let w = self.photo.width();
        let extent = |value: &dyn Fn(usize) -> usize| {
            let ends = part.pixels.iter().map(|&i| value(i));
            ends.clone().max().unwrap_or(0) - ends.min().unwrap_or(0) + 1
        };
        let fill = part.pixels.len() as f32 / (extent(&|i| i % w) * extent(&|i| i / w)) as f32;
        let frame = vote(part.frame.ln(), 0.35, 0.5);
        flush + frame + 0.5 * vote(fill, 0.7, 0.8) + vote(self.daylight(part), 0.0, 0.2) > 1.0
    }
}

/// log(blue / red), tame in the dark.
fn hue(colour: Vec3) -> f32 {
    ((colour.z + 0.01) / (colour.x + 0.01)).ln()
}

/// The value that this share of all lies below; 0 of none.
fn quantile(values: impl Iterator<Item = f32>, share: f32) -> f32 {
    let mut values: Vec<f32> = values.collect();
    if values.is_empty() {
        return 0.0;
    }
    let at = ((share * values.len() as f32) as usize).min(values.len() - 1);
    *values.select_nth_unstable_by(at, f32::total_cmp).1
}

/// The pixels of parts that come within `reach` of each other, together.
fn join(parts: Vec<Part>, reach: f32) -> Vec<Vec<usize>> {
    let mut joined: Vec<Vec<usize>> = Vec::new();
    for part in parts {
        let away = distance(&part.mask);
        let near = |pixels: &Vec<usize>| pixels.iter().any(|&i| away.pixels()[i] <= reach);
        let (near, others): (Vec<_>, Vec<_>) = joined.into_iter().partition(near);
        joined = others;
        joined.push(near.into_iter().flatten().chain(part.pixels).collect());
    }
    joined
}
