//! Shape of a visible lamp, from its pixels and the depth.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::mask_pixels::{extent, median};
use super::surfels::{Body, LampPixels, closed, flat, thin};
use crate::geometry::PlaneFit;
use crate::image::Normal;
use crate::optics::{BoxLamp, Lamp, RectLamp, SphereLamp};

/// Distance of pixels from the plane around them up to which they lie flush in it.
/// Unit: fraction of the distance; source: noise of depth maps; effect: larger values make more
/// panels.
const FLUSH: f32 = 0.02;

/// Least fraction of the surroundings on their common plane, and of the lamp's pixels flush in it,
/// in tenths.
/// Unit: 1, tenths; source: taste; effect: smaller values make more panels.
const LEAST_SUPPORT: f32 = 0.6;
const LEAST_FLUSH: usize = 8;

/// Upward component of a plane's normal above which it is a ceiling.
/// Unit: 1; source: taste; effect: smaller values make panels of lamps on walls.
const CEILING: f32 = 0.7;

/// Ratio of an outline's length to its width above which a lamp is a box, not a ball.
/// Unit: 1; source: taste; effect: larger values make more balls.
const LONG: f32 = 1.6;

/// Distance of a ball's center behind the median depth of its front.
/// Unit: radii; source: half of a disc lies within r / sqrt 2; effect: position of lamps.
const CENTER_BEHIND_FRONT: f32 = 0.7;

/// Length of a box over its area by its width: bounds the length of a ragged outline.
/// Unit: 1; source: taste; effect: larger values make longer boxes.
const MOST_LENGTH: f32 = 1.3;

/// Kind of surface that a visible lamp is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LampForm {
    /// The one of `Solid` and `Plates` that explains the photo better.
    Likeliest,
    /// A ball, or a box where the outline is long.
    Solid,
    /// A box around the outline, as deep as the outline is narrow.
    Box,
    /// The visible surface, its mirror image and the annulus between them, in surfels.
    Plates,
}

/// Form of visible lamps, and the number of their surfels.
#[derive(Clone, Copy, Debug)]
pub struct LampForms {
    /// Form of the lamps.
    pub form: LampForm,
    /// Most surfels of a lamp, at least one.
    pub most_surfels: usize,
    /// Seed of the random choice of the surfels that are kept.
    pub seed: u64,
}

impl Default for LampForms {
    fn default() -> LampForms {
        LampForms { form: LampForm::Solid, most_surfels: 128, seed: 0 }
    }
}

/// Measurements of a lamp's pixels, on which all forms are based. A lamp whose pixels lie flush in
/// a ceiling is a panel.
///
/// A body in space is as deep as its outline is narrow, and its center is behind its visible front
/// by half of that.
pub(in crate::optics) struct VisibleLamp<'a> {
    pixels: LampPixels<'a>,
    /// Rays through the pixels' centers, of unit depth.
    rays: Vec<Vec3>,
    /// Mean of `rays`.
    middle: Vec3,
    /// Plane of the surroundings, if the pixels lie flush in it.
    wall: Option<PlaneFit>,
    /// Median planar depth, meters.
    depth: f32,
    /// Principal axes of the outline, in the plane through its middle that faces the camera, and
    /// half the extent along them, meters.
    axes: [Vec3; 2],
    half: [f32; 2],
    /// Area of the pixels at `depth`, square meters.
    area: f32,
}

impl<'a> VisibleLamp<'a> {
    /// Measures the lamp. `around` lists the pixels that surround it; `normal` is of the camera's
    /// size. `None` when the lamp does not have a pixel.
    pub fn new(pixels: LampPixels<'a>, normal: &Normal, around: &[(usize, usize)]) -> Option<VisibleLamp<'a>> {
        if pixels.pixels.is_empty() {
            return None;
        }
        let LampPixels { points, camera, .. } = pixels;
        let own_points: Vec<Vec3> = pixels.pixels.iter().map(|&(x, y)| points.0.get(x, y)).collect();
        let (positions, normals): (Vec<Vec3>, Vec<Vec3>) =
            around.iter().map(|&(x, y)| (points.0.get(x, y), normal.0.get(x, y))).unzip();
        let rays: Vec<Vec3> = pixels.pixels.iter().map(|&(x, y)| camera.pixel_point(x, y, 1.0)).collect();
        let on = |plane: &PlaneFit| {
            own_points.iter().filter(|p| (plane.normal.dot(**p) - plane.offset).abs() < FLUSH * p.length()).count()
        };
        let wall = PlaneFit::through(&positions, &normals, FLUSH)
            .filter(|plane| plane.support > LEAST_SUPPORT && on(plane) * 10 > own_points.len() * LEAST_FLUSH);

        let depth = median(own_points.iter().map(|p| -p.z).collect());
        let middle = rays.iter().sum::<Vec3>() / rays.len() as f32;
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for ray in &rays {
            let d = *ray - middle;
            (xx, xy, yy) = (xx + d.x * d.x, xy + d.x * d.y, yy + d.y * d.y);
        }
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let (sin, cos) = angle.sin_cos();
        let axes = [Vec3::new(cos, sin, 0.0), Vec3::new(-sin, cos, 0.0)];
        // A pixel has extent of its own: half a pixel on each side.
        let pixel = 0.5 / camera.fx;
        let half =
            axes.map(|axis| depth * (rays.iter().map(|r| (*r - middle).dot(axis).abs()).fold(0.0, f32::max) + pixel));
        let area = rays.len() as f32 * (depth / camera.fx) * (depth / camera.fy);
        Some(VisibleLamp { pixels, rays, middle, wall, depth, axes, half, area })
    }

    /// Shapes of the form that `forms` names, the preferred one first.
    pub fn shapes(&self, forms: LampForms) -> Vec<Lamp> {
        match forms.form {
            LampForm::Likeliest => [self.solid()].into_iter().chain(self.surfels(forms)).collect(),
            LampForm::Solid => vec![self.solid()],
            LampForm::Box => vec![self.boxed()],
            LampForm::Plates => vec![self.surfels(forms).unwrap_or_else(|| self.solid())],
        }
    }

    fn panel(&self) -> Option<PlaneFit> {
        self.wall.filter(|plane| plane.normal.y.abs() > CEILING)
    }

    fn rect(&self) -> Option<Lamp> {
        let plane = self.panel()?;
        let (center, x, y) = extent(&self.rays, &plane)?;
        Some(Lamp::Rect(RectLamp { center: center + plane.normal * PROUD, x, y }))
    }

    fn is_long(&self) -> bool {
        self.half[0] / self.half[1] >= LONG
    }

    /// Radius of the lamp as a ball, meters: from the area, which a ragged outline changes less
    /// than its ends.
    fn radius(&self) -> f32 {
        let radius = (self.area / std::f32::consts::PI).sqrt();
        radius * (1.0 + self.before() * radius / self.depth)
    }

    /// Distance of the center behind the median depth, in halves of the width across.
    ///
    /// A depth sensor sees through a bright shade to the wall: then the lamp stands before the
    /// measured depth, else around it. The median of a ball's front lies 0.7 radius before its
    /// center (half of the disc lies within r / sqrt 2).
    fn before(&self) -> f32 {
        if self.wall.is_some() { -1.0 } else { CENTER_BEHIND_FRONT }
    }

    fn center(&self, half: f32) -> Vec3 {
        self.middle * (self.depth + self.before() * half)
    }

    fn solid(&self) -> Lamp {
        if self.is_long() {
            return self.boxed();
        }
        let radius = self.radius();
        self.rect().unwrap_or(Lamp::Sphere(SphereLamp { center: self.center(radius), radius }))
    }

    fn boxed(&self) -> Lamp {
        let ([long, short], [a, b]) = (self.axes, self.half);
        let a = a.min(self.area / (4.0 * b) * MOST_LENGTH);
        let body = Lamp::Box(BoxLamp { center: self.center(b), axes: [long * a, short * b, Vec3::NEG_Z * b] });
        self.rect().unwrap_or(body)
    }

    fn surfels(&self, forms: LampForms) -> Option<Lamp> {
        let all = match self.panel() {
            Some(plane) => flat(&self.pixels, &PlaneFit { offset: plane.offset + PROUD, ..plane }),
            None => {
                let half = if self.is_long() { self.half[1] } else { self.radius() };
                closed(&self.pixels, Body { center: self.center(half), half, seen: self.wall.is_none() })
            }
        };
        let surfels = thin(&all, forms.most_surfels, forms.seed);
        (!surfels.is_empty()).then_some(Lamp::Surfels(surfels))
    }
}

/// Distance of a panel from its ceiling. Unit: meters; source: taste; effect: shadow rays do not
/// start in the ceiling.
const PROUD: f32 = 0.01;
