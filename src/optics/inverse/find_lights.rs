//! Lamps and windows proposed from a photo, and its depth where there is one.
//!
//! A light is brighter than what surrounds it and ends sharply; light on a wall fades. So the photo is cut in two at several
//! levels of brightness (Boykov and Jolly's energy, see [`graph_cut`]): with b the brightness over white and t the level, a pixel
//! gains `1 - ln b / ln t` by being a light, 1 at white, 0 at t, and two neighbours of colours c, c' that are parted cost
//! `smoothness exp(-beta |c - c'|^2) / distance`, 1 / beta twice the mean of |c - c'|^2. The gain falls with t, so the cuts are
//! nested and their parts form a tree, in which every light is taken at the level where its edge is sharpest: Matas' extremal regions
//! (BMVC 2002) with edges instead of stability.

use glam::Vec3;

use super::observations::white_level;
use crate::geometry::world_up;
use crate::image::{Mask, Normal, Picture, Plane, Points, connected_components, distance, graph_cut, luminance};
use crate::optics::LightKind;

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
/// threshold of 0.75, two steps of 8 bits.
const LEVELS: usize = 5;
/// Brightness inside over outside below which an edge is that of light on a surface: the median along the outline, and for three
/// quarters of it.
const CONTRAST: [f32; 2] = [1.28, 1.22];
/// A level is left for a higher one when that sharpens the contrast's logarithm by this factor.
const SHARPER: f32 = 1.15;
/// Share of the pixels that must be white in all channels, or bluer than all else.
const EMITTING: f32 = 0.15;
/// All channels of white, as a share of it.
const WHITE: f32 = 0.93;
/// log(blue / red) of daylight beside the photo's neutral.
const DAYLIGHT: f32 = 0.1;
/// What faces further up than this cosine is a floor, a table or a bed.
const FACES_UP: f32 = 0.5;
/// What lies lower than this below the camera, metres, is no lamp and no window.
const LOW: f32 = 0.8;
/// Parts of windows that are this near, as a share of the longer side, are panes of one.
const MUNTIN: f32 = 0.015;
/// Pixels around a part that are looked at.
const REACH: usize = 6;

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
        let large = connected_components(&label).into_iter().filter(|pixels| pixels.len() >= smallest);
        let mut merged = Vec::new();
        for part in large.map(|pixels| view.part(pixels, &label)) {
            let (inner, others) =
                kept.into_iter().partition(|inner: &Part| part.pixels.binary_search(&inner.pixels[0]).is_ok());
            kept = others;
            let sharpest = inner.iter().map(|inner| inner.contrast.ln()).fold(0.0, f32::max);
            let own = if view.emits(&part) { part.contrast.ln() } else { 0.0 };
            if SHARPER * own > sharpest { merged.push(part) } else { merged.extend(inner) }
        }
        kept = merged;
    }
    let (windows, lamps): (Vec<Part>, Vec<Part>) = kept.into_iter().partition(|part| view.is_window(part));
    let windows = join(windows, (w, h)).into_iter().map(|part| (LightKind::Window, part));
    let mut found: Vec<_> = windows.chain(lamps.into_iter().map(|part| (LightKind::Lamp, part))).collect();
    found.sort_by_key(|(_, part)| std::cmp::Reverse(part.pixels.len()));
    found.truncate(search.most);
    let light = |(kind, part): (LightKind, Part)| {
        let (area, contrast) = (part.pixels.len(), part.contrast);
        FoundLight { kind, mask: mask(&part.pixels, (w, h)), area, contrast }
    };
    found.into_iter().map(light).collect()
}

fn mask(pixels: &[usize], (w, h): (usize, usize)) -> Plane<bool> {
    let mut mask = Plane::filled(w, h, false);
    pixels.iter().for_each(|&i| mask.pixels_mut()[i] = true);
    mask
}

/// A part of a cut.
struct Part {
    pixels: Vec<usize>,
    /// Share of its bounding box.
    fill: f32,
    /// Pixels up to four away from it.
    around: Vec<usize>,
    /// Inside over outside, in the least channel: its median along the outline, and that which three quarters reach.
    contrast: f32,
    least_contrast: f32,
    /// The same in brightness, for three quarters.
    frame: f32,
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
        graph_cut(&gain, |x, y, nx, ny| {
            let step = self.shown.get(x, y).distance_squared(self.shown.get(nx, ny));
            let distance = if x == nx || y == ny { 1.0 } else { std::f32::consts::SQRT_2 };
            (1000.0 * smoothness * (-self.beta * step).exp() / distance) as i32
        })
    }

    /// A part of `label`; what surrounds it is what no part covers.
    fn part(&self, pixels: Vec<usize>, label: &Plane<bool>) -> Part {
        let (w, h) = self.photo.size();
        let extent = |value: &dyn Fn(usize) -> usize| {
            let ends = |(least, most): (usize, usize), &i: &usize| (least.min(value(i)), most.max(value(i)));
            pixels.iter().fold((usize::MAX, 0), ends)
        };
        let ((left, right), (top, bottom)) = (extent(&|i| i % w), extent(&|i| i / w));
        // Only what is near is looked at, so that many small parts cost no more than a large one.
        let (x0, x1) = (left.saturating_sub(REACH), (right + REACH + 1).min(w));
        let (y0, y1) = (top.saturating_sub(REACH), (bottom + REACH + 1).min(h));
        let mut inside = Plane::filled(x1 - x0, y1 - y0, false);
        pixels.iter().for_each(|&i| inside.set(i % w - x0, i / w - y0, true));
        let (away, into) = (distance(&inside), distance(&inside.map(|inside| !inside)));
        let within = |plane: &Plane<f32>, from: f32, to: f32| -> Vec<usize> {
            let near = (0..plane.len()).filter(|&i| plane.pixels()[i] >= from && plane.pixels()[i] < to);
            near.map(|i| (y0 + i / (x1 - x0)) * w + x0 + i % (x1 - x0)).collect()
        };
        // The pixels on either side of the edge itself are mixtures.
        let mut ring = within(&away, 1.2, 3.0);
        ring.retain(|&i| !label.pixels()[i]);
        let rim = within(&into, 1.0, 3.0);
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
            fill: pixels.len() as f32 / ((right - left + 1) * (bottom - top + 1)) as f32,
            pixels,
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
            // Before two thirds of it: a lamp may touch its table, and the wall of a window may recede.
            vote(depth(&part.pixels, 0.5) / depth(&part.around, 0.35), 0.98, 1.0)
        });
        let frame = vote(part.frame.ln(), 0.35, 0.5);
        flush + frame + 0.5 * vote(part.fill, 0.7, 0.8) + vote(self.daylight(part), 0.0, 0.2) > 1.0
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

/// Parts that come within [`MUNTIN`] of each other in a picture of this size as one, with the contrast of the largest.
fn join(parts: Vec<Part>, size: (usize, usize)) -> Vec<Part> {
    let reach = MUNTIN * size.0.max(size.1) as f32;
    let mut joined: Vec<Part> = Vec::new();
    for mut part in parts {
        let away = distance(&mask(&part.pixels, size));
        let is_near = |other: &Part| other.pixels.iter().any(|&i| away.pixels()[i] <= reach);
        let (near, others) = joined.into_iter().partition(is_near);
        joined = others;
        for mut other in near {
            if other.pixels.len() > part.pixels.len() {
                std::mem::swap(&mut part, &mut other);
            }
            part.pixels.extend(other.pixels);
        }
        joined.push(part);
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;

    const SEARCH: LightSearch = LightSearch { threshold: 0.75, smoothness: 1.0, smallest: 0.001, most: 16 };
    const SIZE: (usize, usize) = (160, 120);

    /// The value of `value` clipped at 1, with noise of a few steps of 8 bits, and where it is clipped.
    fn photo(value: impl Fn(usize, usize) -> Vec3) -> (Picture, Mask) {
        let noise = |x: usize, y: usize| ((x * 7919 + y * 104_729) % 13) as f32 / 13.0 - 0.5;
        let photo = Plane::from_fn(SIZE.0, SIZE.1, |x, y| (value(x, y) * (1.0 + 0.02 * noise(x, y))).min(Vec3::ONE));
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
        pairs().filter(|(a, b)| **a && **b).count() as f32 / pairs().filter(|(a, b)| **a || **b).count() as f32
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
        if disc(x, y) { Vec3::new(6.0, 5.0, 3.0) } else { Vec3::new(1.0, 0.75, 0.5) * (400.0 / (200.0 + away * away)) }
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
            assert_eq!(found.iter().map(|light| light.kind).collect::<Vec<_>>(), [LightKind::Window]);
            let overlap = overlap(&found[0].mask, glass);
            assert!(overlap > 0.9, "intersection over union {overlap}");
        }
    }

    #[test]
    fn fading_light_specks_and_even_photos_are_none() {
        let far = |x: usize, y: usize| (x as f32 - 60.0).hypot(y as f32 - 50.0);
        assert_eq!(find(|x, y| Vec3::splat(1.5 / (1.0 + (far(x, y) / 60.0).powi(2)))), [], "light on a wall");
        assert_eq!(find(|x, y| if far(x, y) < 2.0 { Vec3::ONE } else { Vec3::splat(0.1) }), [], "a speck of 13 pixels");
        for level in [0.0, 0.3, 1.0] {
            assert_eq!(find(|_, _| Vec3::splat(level)), [], "{level} everywhere");
        }
        for (size, level) in [((1, 1), 1.0), ((1, 1), 0.0), ((2, 1), 1.0), ((0, 0), 0.0)] {
            let plane = |value| Plane::filled(size.0, size.1, value);
            let (photo, clipped) = (Picture(plane(1.0).map(|_| Vec3::splat(level))), Mask(plane(level)));
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
        let (photo, clear) = (Plane::from_fn(SIZE.0, SIZE.1, value), Plane::filled(SIZE.0, SIZE.1, 0.0));
        let found = find_lights(&Picture(photo), &Mask(clear), None, &SEARCH);
        assert_eq!(found.len(), 1);
        assert_eq!(overlap(&found[0].mask, disc), 1.0);
    }

    /// Two white rectangles, one in the wall and one half a metre before it, and a bright table.
    #[test]
    fn depth_tells_a_shade_from_a_pane_and_a_table_from_both() {
        let shade = |x: usize, y: usize| (20..50).contains(&x) && (30..55).contains(&y);
        let table = |x: usize, y: usize| (40..120).contains(&x) && (100..115).contains(&y);
        let camera = Camera::from_fov_x(SIZE.0, SIZE.1, 60.0);
        let points =
            Plane::from_fn(SIZE.0, SIZE.1, |x, y| camera.pixel_point(x, y, if shade(x, y) { 2.5 } else { 3.0 }));
        let normal = Plane::from_fn(SIZE.0, SIZE.1, |x, y| if table(x, y) { Vec3::Y } else { Vec3::Z });
        let bright = |x, y| shade(x, y) || pane(x, y) || table(x, y);
        let (photo, clipped) = photo(|x, y| Vec3::splat(if bright(x, y) { 1.5 } else { 0.2 }));
        let found = find_lights(&photo, &clipped, Some((&Points(points), &Normal(normal))), &SEARCH);
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
