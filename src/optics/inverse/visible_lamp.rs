//! Shape of a visible lamp, from its pixels and the depth.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::mask_pixels::{extent, median};
use super::surfels::{LampDepth, LampPixels, closed, flat, thin};
use crate::geometry::PlaneFit;
use crate::image::Normal;
use crate::optics::{BoxLamp, Lamp, RectLamp, SphereLamp};
use crate::tuning::tuning;

tuning! {
    /// Constants of the shape of a visible lamp.
    pub const TUNING: VisibleLampTuning {
        /// Distance of pixels from the plane around them up to which they lie flush in it.
        flush: f32 = 0.02,
            unit "fraction of the distance", source Derived("noise of depth maps"),
            effect "a larger value makes more panels";
        /// Least fraction of the surroundings on their common plane.
        min_support: f32 = 0.6,
            unit "1", source Taste, effect "a smaller value makes more panels";
        /// Least fraction of a lamp's pixels that lie flush in that plane.
        min_flush: usize = 8,
            unit "tenths", source Taste, effect "a smaller value makes more panels";
        /// Upward component of a plane's normal above which it is a ceiling.
        ceiling: f32 = 0.7,
            unit "1", source Taste, effect "a smaller value makes panels of lamps on walls";
        /// Ratio of an outline's length to its width above which a lamp is a box, not a ball.
        long: f32 = 1.6,
            unit "1", source Taste, effect "a larger value makes more balls";
        /// Distance of a ball's center behind the median depth of its front.
        center_behind_front: f32 = 0.7,
            unit "radii", source Derived("half of a disc lies within r / sqrt 2"),
            effect "a larger value moves lamps away from the camera";
        /// Distance of a ball's center before the measured depth where a depth sensor sees through
        /// the lamp to its wall.
        center_before_wall: f32 = 1.0,
            unit "radii", source Derived("a ball that touches its wall"),
            effect "a larger value moves lamps toward the camera";
        /// Length of a box over its area by its width, which bounds the length of a ragged outline.
        max_length: f32 = 1.3,
            unit "1", source Taste, effect "a larger value makes longer boxes";
        /// Distance of a panel from its ceiling: shadow rays do not start in the ceiling.
        panel_distance: f32 = 0.01,
            unit "meters", source Taste, effect "a larger value moves panels down";
    }
}

/// Kind of surface that a visible lamp is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LampForm {
    /// The one of `Solid` and `Surfels` that explains the photo better.
    #[serde(alias = "Likeliest")]
    Best,
    /// A ball, or a box where the outline is long.
    Solid,
    /// A box around the outline, as deep as the outline is narrow.
    Box,
    /// The visible surface, its mirror image and the annulus between them, in surfels.
    #[serde(alias = "Plates")]
    Surfels,
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
    /// Unit vector upward.
    up: Vec3,
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
    /// size, and `up` a unit vector. `None` when the lamp does not have a pixel.
    pub fn new(
        pixels: LampPixels<'a>,
        normal: &Normal,
        around: &[(usize, usize)],
        up: Vec3,
    ) -> Option<VisibleLamp<'a>> {
        if pixels.pixels.is_empty() {
            return None;
        }
        let LampPixels { points, camera, .. } = pixels;
        let own_points: Vec<Vec3> =
            pixels.pixels.iter().map(|&(x, y)| points.0.get(x, y)).collect();
        let (positions, normals): (Vec<Vec3>, Vec<Vec3>) =
            around.iter().map(|&(x, y)| (points.0.get(x, y), normal.0.get(x, y))).unzip();
        let rays: Vec<Vec3> =
            pixels.pixels.iter().map(|&(x, y)| camera.pixel_point(x, y, 1.0)).collect();
        let on = |plane: &PlaneFit| {
            own_points.iter().filter(|p| plane.contains(**p, TUNING.flush)).count()
        };
        let wall = PlaneFit::through(&positions, &normals, TUNING.flush).filter(|plane| {
            plane.support > TUNING.min_support
                && on(plane) * 10 > own_points.len() * TUNING.min_flush
        });

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
        let half = axes.map(|axis| {
            depth * (rays.iter().map(|r| (*r - middle).dot(axis).abs()).fold(0.0, f32::max) + pixel)
        });
        let area = rays.len() as f32 * (depth / camera.fx) * (depth / camera.fy);
        Some(VisibleLamp { pixels, rays, middle, wall, up, depth, axes, half, area })
    }

    /// Shapes of the form that `forms` names, the preferred one first.
    pub fn shapes(&self, forms: LampForms) -> Vec<Lamp> {
        match forms.form {
            LampForm::Best => [self.solid()].into_iter().chain(self.surfels(forms)).collect(),
            LampForm::Solid => vec![self.solid()],
            LampForm::Box => vec![self.boxed()],
            LampForm::Surfels => vec![self.surfels(forms).unwrap_or_else(|| self.solid())],
        }
    }

    fn panel(&self) -> Option<PlaneFit> {
        self.wall.filter(|plane| plane.normal.dot(self.up).abs() > TUNING.ceiling)
    }

    fn rect(&self) -> Option<Lamp> {
        let plane = self.panel()?;
        let (center, x, y) = extent(&self.rays, &plane, self.up)?;
        Some(Lamp::Rect(RectLamp { center: center + plane.normal * TUNING.panel_distance, x, y }))
    }

    fn is_long(&self) -> bool {
        self.half[0] / self.half[1] >= TUNING.long
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
        if self.wall.is_some() { -TUNING.center_before_wall } else { TUNING.center_behind_front }
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
        let a = a.min(self.area / (4.0 * b) * TUNING.max_length);
        let body = Lamp::Box(BoxLamp {
            center: self.center(b),
            axes: [long * a, short * b, Vec3::NEG_Z * b],
        });
        self.rect().unwrap_or(body)
    }

    fn surfels(&self, forms: LampForms) -> Option<Lamp> {
        let all = match self.panel() {
            Some(plane) => flat(
                &self.pixels,
                &PlaneFit { offset: plane.offset + TUNING.panel_distance, ..plane },
            ),
            None => {
                let half = if self.is_long() { self.half[1] } else { self.radius() };
                closed(
                    &self.pixels,
                    LampDepth { center: self.center(half), half, seen: self.wall.is_none() },
                )
            }
        };
        let surfels = thin(&all, forms.most_surfels, forms.seed);
        (!surfels.is_empty()).then_some(Lamp::Surfels(surfels))
    }
}
