//! Creases: the straight lines at which a wall, a ceiling or a floor ends.
//!
//! A region that grows pixel by pixel has a ragged outline at faint edges of the photo in noisy
//! depth. Two planes with normals n and m and offsets d and e intersect in the rays r with
//! (n / d - m / e) . r = 0. Their fits to noisy depth err by some pixels, so the line is refined:
//! it has the largest `s / (s + step) + mean of exp(-(r / stray)^2)`, with s the mean log step of
//! the photo across the line and r the distances of outline points from it. A long straight outline
//! at a faint edge of the photo becomes a line without a second plane (Hough transform; Duda and
//! Hart, Communications of the ACM, 1972). At a sharp edge of the photo it keeps the matte.

use std::cmp::Reverse;
use std::f32::consts::PI;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::close_region::sides;
use super::grow_region::{self, plane_of};
use super::photo_edges::log_color;
use super::plane_fit::PlaneFit;
use crate::image::{Normal, Picture, Plane, Points, distance};
use crate::tuning::tuning;

tuning! {
    /// Constants of the creases at which a region ends.
    pub const TUNING: CreaseTuning {
        /// Distance from the line of two planes within which the outline of a region strays.
        near: f32 = 0.02,
            unit "fraction of the width", source Measured("19 surfaces of eight photographs"),
            effect "a larger value straightens curtains and furniture";
        /// Distance from a region within which pixels determine the planes beside it.
        beside: f32 = 0.06,
            unit "fraction of the width", source Taste, effect "a larger value finds planes behind furniture";
        /// Most planes beside a region.
        planes: usize = 8,
            unit "planes", source Derived("four sides and some furniture"), effect "a larger value is slower";
        /// Fewest pixels of such a plane, per pixel of the width.
        support: f32 = 0.3,
            unit "1", source Taste, effect "a larger value misses narrow surfaces";
        /// Least angle between the planes of a crease.
        angle: f32 = 25.0,
            unit "degrees", source Taste, effect "a smaller value takes unevenness for a crease";
        /// Largest distance from the plane beyond a crease of a point that confirms the crease.
        on_plane: f32 = 0.01,
            unit "fraction of the distance from the camera", source Measured("19 surfaces of eight photographs"),
            effect "a larger value takes the edges of furniture for creases";
        /// Least length of the outline beside a crease.
        length: f32 = 0.08,
            unit "fraction of the width", source Taste, effect "a smaller value straightens outlines of small things";
        /// Length along which the region lies on both sides of a line, over that of its outline
        /// there, from which on the line is not a crease.
        crossed: f32 = 0.5,
            unit "1", source Measured("19 surfaces of eight photographs"),
            effect "a larger value takes the planes of furniture for sides of the room";
        /// Length along which the steps of the photo across a line add up with their signs.
        piece: f32 = 0.08,
            unit "fraction of the width", source Taste, effect "a larger value finds fainter edges";
        /// Log step of the photo across a line that counts half.
        step: f32 = 0.08,
            unit "1", source Taste, effect "a smaller value follows fainter edges of the photo";
        /// Distance from a line at which the outline counts 1 / e.
        stray: f32 = 2.0,
            unit "working pixels", source Taste, effect "a larger value follows the photo more, the outline less";
        /// Least length of a straight outline.
        long: f32 = 0.2,
            unit "fraction of the width", source Measured("19 surfaces of eight photographs"),
            effect "a smaller value straightens curtains and furniture";
        /// Distance from its line within which an outline is straight.
        straight: f32 = 3.0,
            unit "working pixels", source Measured("19 surfaces of eight photographs"),
            effect "a larger value straightens curtains and furniture";
        /// Mean log step of the photo across a straight outline from which on its edge is sharp.
        sharp: f32 = 0.5,
            unit "1", source Measured("outlines in eight photographs: ceiling and curtain 0.17 to 0.34, furniture and frames 1 to 5"),
            effect "a larger value replaces the edges that the photo shows";
        /// Steps of angle in which straight outlines are counted.
        angles: usize = 180,
            unit "steps per half turn", source Derived("two pixels at the ends of a long outline"),
            effect "a larger value is slower";
        /// Width of the bins in which they are counted.
        bin: f32 = 2.0,
            unit "working pixels", source Taste, effect "a larger value finds more ragged outlines";
    }
}

/// Largest distance from a plane of a point on it, over that from the camera.
const OFF_PLANE: f32 = grow_region::TUNING.off_plane;

/// The creases at which a region ends.
pub struct Creases<'a> {
    plane: PlaneFit,
    points: &'a Points,
    all: Vec<Crease>,
}

/// A crease, and the places along it at which a region ends.
struct Crease {
    line: Line,
    /// Whole positions along the line, rising.
    places: Vec<i32>,
    /// Distance within which the outline strays, working pixels.
    reach: f32,
    /// The plane on the other side; `None` if the outline alone is straight.
    other: Option<PlaneFit>,
}

/// A line in the working picture, whose pixels have their centers at whole numbers.
struct Line {
    /// Unit normal, towards the region.
    normal: Vec2,
    offset: f32,
}

impl<'a> Creases<'a> {
    /// The creases at which the region `found` ends. It, `points` and `normal` have one size, that
    /// of the working picture; the `photo` may be larger. `None` if the region lies on no plane.
    pub fn find(
        found: &Plane<bool>,
        points: &'a Points,
        normal: &Normal,
        photo: &Picture,
    ) -> Option<Creases<'a>> {
        let region = Region::new(found, points, normal, photo)?;
        let mut all = region.with_planes_beside();
        region.add_straight(&mut all);
        Some(Creases { plane: region.plane, points, all })
    }

    /// Draws the region's outline along its creases into `mask`, its mask at the photo's size.
    /// Returns the indices of the pixels there, rising.
    pub fn draw(&self, mask: &mut Plane<f32>) -> Vec<u32> {
        if self.all.is_empty() {
            return Vec::new();
        }
        let (w, h) = mask.size();
        let row = |y: usize| -> Vec<(usize, f32)> {
            (0..w).filter_map(|x| Some((y * w + x, self.share((x, y), (w, h))?))).collect()
        };
        let rows: Vec<_> = (0..h).into_par_iter().map(row).collect();
        let drawn = rows.into_iter().flatten().map(|(i, share)| {
            mask.pixels_mut()[i] = share;
            i as u32
        });
        drawn.collect()
    }

    /// Fraction of the region in pixel (x, y) of a photo of this size; `None` where no crease is.
    fn share(&self, (x, y): (usize, usize), photo: (usize, usize)) -> Option<f32> {
        let (w, h) = self.points.0.size();
        let scale = Vec2::new(w as f32 / photo.0 as f32, h as f32 / photo.1 as f32);
        let at = (Vec2::new(x as f32, y as f32) + 0.5) * scale - 0.5;
        let point = || self.points.0.get(x * w / photo.0, y * h / photo.1);
        let is_of = |plane: &PlaneFit| plane.contains(point(), OFF_PLANE);
        // The band is wider beyond the crease, where it clears what the region has of the other
        // surface.
        let is_at = |(crease, off): &(&Crease, f32)| {
            (-2.0 * crease.reach..crease.reach).contains(off)
                && crease.other.is_none_or(|other| is_of(&self.plane) || is_of(&other))
        };
        let offs = self.all.iter().map(|crease| (crease, crease.line.distance(at)));
        let close: Vec<_> = offs.filter(is_at).collect();
        close.iter().find(|(crease, _)| crease.ends_within(0.5, at))?;
        // At a corner, the region lies on the inner side of both lines.
        let ends = close.iter().filter(|(crease, _)| crease.ends_within(crease.reach, at));
        let off = ends.map(|(_, off)| *off).fold(f32::MAX, f32::min);
        Some((0.5 + off / scale.x).clamp(0.0, 1.0))
    }
}

impl Crease {
    /// Whether the region ends at a place within this distance of a point, along the line.
    fn ends_within(&self, reach: f32, at: Vec2) -> bool {
        let along = self.line.along(at);
        let after = self.places.partition_point(|&place| (place as f32) < along - reach);
        self.places.get(after).is_some_and(|&place| place as f32 <= along + reach)
    }
}

impl Line {
    /// The line through two points, of which the region lies on the side of `towards`.
    fn through([a, b]: [Vec2; 2], towards: Vec2) -> Option<Line> {
        let normal = (b - a).perp().try_normalize()?;
        let normal = if normal.dot(towards) < 0.0 { -normal } else { normal };
        Some(Line { normal, offset: -normal.dot(a) })
    }

    /// The line at which two planes meet.
    fn of_planes(plane: &PlaneFit, other: &PlaneFit, points: &Points) -> Option<Line> {
        let (w, h) = points.0.size();
        let across = plane.normal / plane.offset - other.normal / other.offset;
        let value = |x: usize, y: usize| across.dot(points.0.get(x, y)) / -points.0.get(x, y).z;
        let origin = value(0, 0);
        let slope = Vec2::new(
            (value(w - 1, 0) - origin) / (w - 1) as f32,
            (value(0, h - 1) - origin) / (h - 1) as f32,
        );
        let line = Line { normal: slope / slope.length(), offset: origin / slope.length() };
        (line.normal.is_finite() && line.offset.is_finite()).then_some(line)
    }

    /// Signed distance of a point, positive on the side of the region.
    fn distance(&self, at: Vec2) -> f32 {
        self.normal.dot(at) + self.offset
    }

    /// Position of a point along the line.
    fn along(&self, at: Vec2) -> f32 {
        self.normal.perp().dot(at)
    }

    /// The point at a position along the line and at a distance from it.
    fn at(&self, along: f32, off: f32) -> Vec2 {
        self.normal.perp() * along + self.normal * (off - self.offset)
    }

    /// Whole positions along the line of the points beside it, rising.
    fn places(&self, beside: &[Vec2]) -> Vec<i32> {
        let mut places: Vec<i32> = beside.iter().map(|at| self.along(*at).round() as i32).collect();
        places.sort_unstable();
        places.dedup();
        places
    }
}

/// A region that lies on a plane, in the working picture.
struct Region<'a> {
    found: &'a Plane<bool>,
    points: &'a Points,
    normal: &'a Normal,
    photo: &'a Picture,
    plane: PlaneFit,
    /// The middles of the sides of pixels at which it ends.
    outline: Vec<Vec2>,
}

impl<'a> Region<'a> {
    /// `None` if the region lies on no plane.
    fn new(
        found: &'a Plane<bool>,
        points: &'a Points,
        normal: &'a Normal,
        photo: &'a Picture,
    ) -> Option<Region<'a>> {
        let (w, h) = found.size();
        let inside: Vec<usize> = (0..w * h).filter(|&i| found.pixels()[i]).collect();
        let at = |i: usize| Vec2::new((i % w) as f32, (i / w) as f32);
        let pairs = inside.iter().flat_map(|&i| sides((w, h), i).map(move |side| (i, side)));
        let ends = pairs.filter(|&(_, side)| !found.pixels()[side]);
        let outline = ends.map(|(i, side)| 0.5 * (at(i) + at(side))).collect();
        let plane = plane_of(&inside, points, normal)?;
        Some(Region { found, points, normal, photo, plane, outline })
    }

    fn width(&self) -> f32 {
        self.found.width() as f32
    }

    /// A fraction of the width, working pixels; at least twice the tolerance of straight outlines.
    fn length(&self, fraction: f32) -> f32 {
        f32::max(fraction * self.width(), 2.0 * TUNING.straight)
    }

    /// Distance from the line of two planes within which the outline strays.
    fn near(&self) -> f32 {
        f32::max(TUNING.near * self.width(), TUNING.straight)
    }

    /// The creases at which the plane of the region meets those of its surroundings.
    fn with_planes_beside(&self) -> Vec<Crease> {
        let point = |i: usize| self.points.0.pixels()[i];
        let away = distance(self.found);
        let reach = TUNING.beside * self.width();
        let is_beside = |i: &usize| {
            !self.found.pixels()[*i]
                && away.pixels()[*i] < reach
                && !self.plane.contains(point(*i), OFF_PLANE)
        };
        let mut left: Vec<usize> = (0..self.found.len()).filter(is_beside).collect();
        let mut creases = Vec::new();
        for _ in 0..TUNING.planes {
            let Some(other) = plane_of(&left, self.points, self.normal) else { break };
            let before = left.len();
            left.retain(|&i| !other.contains(point(i), OFF_PLANE));
            if ((before - left.len()) as f32) < TUNING.support * self.width() {
                break;
            }
            let cosine = self.plane.normal.dot(other.normal);
            if cosine < TUNING.angle.to_radians().cos()
                && let Some(line) = Line::of_planes(&self.plane, &other, self.points)
            {
                creases.extend(self.crease(line, other));
            }
        }
        creases
    }

    /// The crease at a `line` where the region's plane meets the plane `other`; `None` where hardly
    /// any of the outline is at the line.
    fn crease(&self, line: Line, other: PlaneFit) -> Option<Crease> {
        let near = self.near();
        let (reach, least) = ([near, 2.0 * near], self.length(TUNING.length));
        let line = self.toward_region(line);
        let mut outline = self.within(&line, near);
        outline.retain(|at| {
            let (is_found, i) = self.beside(&line, line.along(*at), reach);
            is_found == [true, false]
                && self.is_beyond(i, &other)
                && self.has_strayed(&line, *at, &other)
        });
        let places = line.places(&outline);
        let around = places.first()? - least as i32..places.last()? + least as i32;
        let is_crossed = |along: &i32| self.beside(&line, *along as f32, reach).0 == [true; 2];
        let crossed = around.filter(is_crossed).count() as f32;
        if (places.len() as f32) < least || crossed > TUNING.crossed * places.len() as f32 {
            return None;
        }
        let line = self.moved(line, &outline);
        let places = self.parted(&line, line.places(&outline), reach);
        Some(Crease { line, places, reach: near, other: Some(other) })
    }

    /// Whether a pixel lies on the plane `other` and not on that of the region.
    fn is_beyond(&self, i: usize, other: &PlaneFit) -> bool {
        let (point, normal) = (self.points.0.pixels()[i], self.normal.0.pixels()[i]);
        other.contains(point, TUNING.on_plane)
            && !self.plane.contains(point, OFF_PLANE)
            && normal.dot(other.normal) > normal.dot(self.plane.normal)
    }

    /// Whether the region has the depth of the plane `other` at a point of its outline beyond a
    /// line. If not, the outline is the edge of an occluder.
    fn has_strayed(&self, line: &Line, at: Vec2, other: &PlaneFit) -> bool {
        let inside = at + line.normal;
        let point = self.points.0.pixels()[self.pixel(inside).1];
        let depth = other.offset / other.normal.dot(point);
        line.distance(inside) > 0.0 || (depth - 1.0).abs() < 2.0 * OFF_PLANE
    }

    /// Whether the depth is continuous across a point of the outline: it has a step at the edge of
    /// an occluder.
    fn touches(&self, line: &Line, at: Vec2) -> bool {
        let (_, i) = self.pixel(at - TUNING.straight * line.normal);
        self.plane.contains(self.points.0.pixels()[i], 2.0 * OFF_PLANE)
    }

    /// Adds the straight parts of the outline that are at no crease.
    fn add_straight(&self, creases: &mut Vec<Crease>) {
        let is_at = |crease: &Crease, at: Vec2| {
            crease.line.distance(at).abs() < crease.reach && crease.ends_within(crease.reach, at)
        };
        let mut left = self.outline.clone();
        left.retain(|at| !creases.iter().any(|crease| is_at(crease, *at)));
        while let Some(line) = self.straightest(&left) {
            let is_near = |at: &Vec2| line.distance(*at).abs() < TUNING.straight;
            let (beside, others): (Vec<Vec2>, Vec<Vec2>) = left.iter().partition(|at| is_near(at));
            left = others;
            let line = self.moved(line, &beside);
            if self.straight_length(&line.places(&beside)) < self.length(TUNING.long) {
                break;
            }
            let touching = beside.iter().filter(|at| self.touches(&line, **at)).count();
            let across = 2.0 * self.width() / self.photo.0.width() as f32;
            let step = self.step_across(&line, &beside, (across, 1.0));
            if 2 * touching > beside.len() && step < TUNING.sharp {
                // Points at the next crease belong to this line, too.
                let beside = self.within(&line, TUNING.straight);
                let places = self.parted(&line, line.places(&beside), [TUNING.straight; 2]);
                creases.push(Crease { line, places, reach: TUNING.straight, other: None });
            }
        }
    }

    /// The points of the outline within a distance of a line.
    fn within(&self, line: &Line, reach: f32) -> Vec<Vec2> {
        self.outline.iter().copied().filter(|at| line.distance(*at).abs() < reach).collect()
    }

    /// `line` with the region on its positive side.
    fn toward_region(&self, line: Line) -> Line {
        let reach = 2.0 * self.near();
        let (w, h) = self.found.size();
        let side = |i: usize| {
            let off = line.distance(Vec2::new((i % w) as f32, (i / w) as f32));
            if off.abs() < reach { off.signum() } else { 0.0 }
        };
        let sum: f32 = (0..w * h).filter(|&i| self.found.pixels()[i]).map(side).sum();
        if sum < 0.0 { Line { normal: -line.normal, offset: -line.offset } } else { line }
    }

    /// Whether the region contains the pixel at a point, or the nearest one of the picture, and
    /// the index of that pixel.
    fn pixel(&self, at: Vec2) -> (bool, usize) {
        let (w, h) = self.found.size();
        let at = (at + 0.5).clamp(Vec2::ZERO, Vec2::new(w as f32, h as f32) - 1.0);
        let i = at.y as usize * w + at.x as usize;
        (self.found.pixels()[i], i)
    }

    /// Whether the region contains the pixels at these distances on the positive and negative side
    /// of a line, at a position along it, and the index of the second one.
    fn beside(&self, line: &Line, along: f32, [inside, outside]: [f32; 2]) -> ([bool; 2], usize) {
        let ((inside, _), (outside, i)) =
            (self.pixel(line.at(along, inside)), self.pixel(line.at(along, -outside)));
        ([inside, outside], i)
    }

    /// The `places` along a line, and those in gaps between them, at which the region lies on its
    /// positive side alone.
    fn parted(&self, line: &Line, places: Vec<i32>, reach: [f32; 2]) -> Vec<i32> {
        let gap = self.length(TUNING.length) as i32;
        let all = places
            .iter()
            .zip(places.iter().skip(1))
            .flat_map(|(&place, &next)| place..if next - place <= gap { next } else { place + 1 });
        let is_parted = |place: &i32| self.beside(line, *place as f32, reach).0 == [true, false];
        all.chain(places.last().copied()).filter(is_parted).collect()
    }

    /// Length of the gapless pieces of these `places` along a line; short ones do not count.
    fn straight_length(&self, places: &[i32]) -> f32 {
        let pieces = places.chunk_by(|a, b| ((b - a) as f32) < self.near());
        let lengths = pieces.map(|piece| piece.len() as f32);
        lengths.filter(|length| *length > self.length(TUNING.length)).sum()
    }

    /// The line near which most of these points of the outline lie.
    fn straightest(&self, points: &[Vec2]) -> Option<Line> {
        let (w, h) = self.found.size();
        let reach = (w + h) as f32;
        let bins = (2.0 * reach / TUNING.bin) as usize + 1;
        let mut count = vec![0u32; TUNING.angles * bins];
        let normal = |angle: usize| Vec2::from_angle(PI * angle as f32 / TUNING.angles as f32);
        for at in points {
            for angle in 0..TUNING.angles {
                let bin = ((normal(angle).dot(*at) + reach) / TUNING.bin) as usize;
                count[angle * bins + bin] += 1;
            }
        }
        let best = (0..count.len()).max_by_key(|&i| (count[i], Reverse(i)))?;
        let offset = reach - TUNING.bin * ((best % bins) as f32 + 0.5);
        let line = Line { normal: normal(best / bins), offset };
        (count[best] > 0).then(|| self.toward_region(line))
    }

    /// The line near `line` that the points `beside` it and the steps of the photo support most.
    fn moved(&self, line: Line, beside: &[Vec2]) -> Line {
        let near = self.near() as i32;
        let places = line.places(beside);
        let ends = [places.first(), places.last()].map(|place| place.map_or(0.0, |at| *at as f32));
        let shifted =
            |by: [f32; 2]| Line::through([0, 1].map(|k| line.at(ends[k], by[k])), line.normal);
        let photo_pixel = self.width() / self.photo.0.width() as f32;
        let piece = TUNING.piece * self.width();
        let score = |by: [f32; 2], reach: f32| {
            let Some(line) = shifted(by) else { return 0.0 };
            let agrees = |at: &Vec2| (-(line.distance(*at) / TUNING.stray).powi(2)).exp();
            let agreement = beside.iter().map(agrees).sum::<f32>() / beside.len().max(1) as f32;
            let step = self.step_across(&line, beside, (reach, piece));
            step / (step + TUNING.step) + agreement
        };
        let mut best = [0.0; 2];
        let (mut size, mut steps) = (1.0, near);
        while size > 0.5 * photo_pixel {
            let shifts = (-steps..=steps).flat_map(|a| (-steps..=steps).map(move |b| [a, b]));
            let shifts = shifts.map(|by| [0, 1].map(|k| best[k] + size * by[k] as f32));
            let scored = shifts.map(|by| (score(by, f32::max(size, 1.5 * photo_pixel)), by));
            let top = scored.reduce(|a, b| if b.0 > a.0 { b } else { a });
            best = top.map_or(best, |(_, by)| by);
            (size, steps) = (0.5 * size, 2);
        }
        shifted(best).unwrap_or(line)
    }

    /// Mean log step of the photo across a line, at the points `beside` it, from `reach` working
    /// pixels on one side to the same on the other. Steps add up with their signs within a `piece`
    /// of the line.
    fn step_across(&self, line: &Line, beside: &[Vec2], (reach, piece): (f32, f32)) -> f32 {
        let (w, h) = self.photo.0.size();
        let color = |at: Vec2| {
            let at = (at + 0.5) * (w as f32 / self.width());
            let is_inside = at.min_element() >= 0.0 && at.x < w as f32 && at.y < h as f32;
            is_inside.then(|| log_color(self.photo.0.get(at.x as usize, at.y as usize)))
        };
        let mut sums: Vec<(i32, Vec3)> = Vec::new();
        let mut count = 0;
        for place in line.places(beside) {
            let sides = [reach, -reach].map(|off| color(line.at(place as f32, off)));
            let [Some(inside), Some(outside)] = sides else { continue };
            let number = (place as f32 / piece).floor() as i32;
            count += 1;
            match sums.last_mut() {
                Some((last, sum)) if *last == number => *sum += inside - outside,
                _ => sums.push((number, inside - outside)),
            }
        }
        sums.iter().map(|(_, sum)| sum.length()).sum::<f32>() / f32::max(count as f32, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (160, 120);
    /// The column at which the wall before the camera meets the one at its right.
    const CORNER: f32 = 110.3;

    /// A wall that faces the camera, and at its right one that comes toward it. The photo has
    /// `ratio` times as many pixels and shows the corner as a step of the logarithm.
    fn corner(step: f32, ratio: usize) -> (Points, Normal, Picture) {
        let (w, h) = SIZE;
        let ray = |x: usize, y: usize| Vec3::new(x as f32 - 79.5, 59.5 - y as f32, -100.0) / 100.0;
        let beyond = |x: f32| x > CORNER;
        let end = (CORNER - 79.5) / 100.0;
        let depth = |x: usize| if beyond(x as f32) { end / ray(x, 0).x } else { 1.0 };
        let points = Plane::from_fn(w, h, |x, y| 3.0 * ray(x, y) * depth(x));
        let normal = Plane::from_fn(w, h, |x, _| if beyond(x as f32) { -Vec3::X } else { Vec3::Z });
        let photo = Plane::from_fn(ratio * w, ratio * h, |x, _| {
            let x = (x as f32 + 0.5) / ratio as f32 - 0.5;
            Vec3::splat(if beyond(x) { 0.3 * step.exp() } else { 0.3 })
        });
        (Points(points), Normal(normal), Picture(photo))
    }

    /// Pixels of a mask at the size of the photo that are wrong by more than a pixel after a region
    /// with this `end` in each row has been drawn, and before.
    fn wrong(step: f32, ratio: usize, end: impl Fn(usize) -> usize) -> [usize; 2] {
        let (points, normal, photo) = corner(step, ratio);
        let (w, h) = SIZE;
        let found = Plane::from_fn(w, h, |x, y| x < end(y));
        let before = Plane::from_fn(ratio * w, ratio * h, |x, y| {
            f32::from(u8::from(found.get(x / ratio, y / ratio)))
        });
        let mut after = before.clone();
        let creases = Creases::find(&found, &points, &normal, &photo).expect("it is on a plane");
        let drawn = creases.draw(&mut after);
        assert!(drawn.is_sorted());
        let changed = (0..before.len()).filter(|&i| before.pixels()[i] != after.pixels()[i]);
        assert!(changed.into_iter().all(|i| drawn.binary_search(&(i as u32)).is_ok()));
        let count = |mask: &Plane<f32>| {
            let is_wrong = |&i: &usize| {
                let x = (i % (ratio * w)) as f32;
                let beyond = x + 0.5 - (CORNER + 0.5) * ratio as f32;
                beyond.abs() > 1.0 && (mask.pixels()[i] > 0.5) == (beyond > 0.0)
            };
            (0..mask.len()).filter(is_wrong).count()
        };
        [count(&after), count(&before)]
    }

    /// An outline that strays by up to two working pixels.
    fn ragged(y: usize) -> usize {
        111 + (y / 5 * 7 % 5) - 2
    }

    #[test]
    fn the_outline_at_a_corner_is_the_line_of_two_planes() {
        for ratio in [1, 3] {
            let [after, before] = wrong(0.1, ratio, ragged);
            assert!(before > 40 * ratio * ratio, "{before}");
            assert!(after < before / 100 + 1, "{after} of {before}");
        }
    }

    #[test]
    fn an_outline_off_the_corner_moves_to_where_the_photo_shows_it() {
        // Three pixels too far in half of the rows.
        let [after, before] = wrong(0.1, 2, |y| if y < 60 { ragged(y) } else { ragged(y) + 3 });
        assert!(before > 600 && after < before / 20, "{after} of {before}");
    }

    #[test]
    fn an_outline_elsewhere_stays() {
        for end in [40.0, 80.0, 130.0] {
            let [after, before] = wrong(0.1, 1, |y| (end + 8.0 * (y as f32 / 3.0).sin()) as usize);
            assert_eq!(after, before, "{end}");
        }
    }

    #[test]
    fn a_long_straight_outline_without_depth_is_a_line_where_the_photo_is_faint() {
        let straightened = |step: f32| {
            let (w, h) = SIZE;
            let ray = |x: usize, y: usize| Vec3::new(x as f32 - 79.5, 59.5 - y as f32, -100.0);
            let points = Points(Plane::from_fn(w, h, |x, y| 0.03 * ray(x, y)));
            let normal = Normal(Plane::filled(w, h, Vec3::Z));
            // A ceiling that the depth shows as a part of the wall, above a slanted line.
            let line = |x: usize| 20.0 + 0.1 * x as f32;
            let photo = Picture(Plane::from_fn(w, h, |x, y| {
                Vec3::splat(if (y as f32) < line(x) { 0.3 * step.exp() } else { 0.3 })
            }));
            let ragged = |x: usize| line(x) + [-1.5, 0.0, 1.5][x / 4 % 3];
            let found = Plane::from_fn(w, h, |x, y| y as f32 >= ragged(x));
            let mut mask = found.map(|inside| f32::from(u8::from(inside)));
            let creases = Creases::find(&found, &points, &normal, &photo);
            creases.expect("it is on a plane").draw(&mut mask);
            let off = |x: usize| {
                let top = (0..h).find(|&y| mask.get(x, y) > 0.5).expect("the wall");
                (top as f32 - line(x)).abs()
            };
            (0..w).map(off).fold(0.0, f32::max)
        };
        assert!(straightened(0.15) < 1.2, "{}", straightened(0.15));
        assert!(straightened(1.0) > 1.5, "a sharp edge needs no line");
    }

    #[test]
    fn regions_of_a_few_pixels_stay() {
        for (w, h) in [(1, 1), (2, 1), (3, 3)] {
            let points = Points(Plane::from_fn(w, h, |x, y| Vec3::new(x as f32, y as f32, -3.0)));
            let normal = Normal(Plane::filled(w, h, Vec3::Z));
            let photo = Picture(Plane::filled(w, h, Vec3::ONE));
            for found in [Plane::filled(w, h, true), Plane::from_fn(w, h, |x, _| x == 0)] {
                let before = found.map(|inside| f32::from(u8::from(inside)));
                let mut mask = before.clone();
                if let Some(creases) = Creases::find(&found, &points, &normal, &photo) {
                    creases.draw(&mut mask);
                }
                assert_eq!(mask, before);
            }
        }
    }
}
