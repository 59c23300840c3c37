//! The shape of a lamp that is seen, from its pixels and the depth.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::candidates::{extent, median};
use super::surfels::{Body, LampPixels, closed, flat, thin};
use crate::geometry::PlaneFit;
use crate::image::Normal;
use crate::optics::{BoxLamp, Lamp, RectLamp, SphereLamp};

/// What kind of surface a visible lamp is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LampForm {
    /// Whichever of `Solid` and `Plates` explains the photo better.
    Likeliest,
    /// A ball, or a box where the outline is long.
    Solid,
    /// A box around the outline, as deep as that is narrow.
    Box,
    /// The seen surface, its mirror image and the ring between them.
    Plates,
}

/// How visible lamps are made.
#[derive(Clone, Copy, Debug)]
pub struct LampForms {
    pub form: LampForm,
    /// Most plates a lamp may have, at least one.
    pub plates: usize,
    /// Picks the plates that are kept.
    pub seed: u64,
}

impl Default for LampForms {
    fn default() -> LampForms {
        LampForms { form: LampForm::Solid, plates: 128, seed: 0 }
    }
}

/// What the pixels of a lamp tell of it, whatever shape it is then given. A lamp whose pixels lie flush in a ceiling is a panel.
///
/// A body in space is as deep as its outline is narrow, and stands behind its visible front by half of that.
pub(in crate::optics) struct SeenLamp<'a> {
    pixels: LampPixels<'a>,
    /// Through the pixels' centres, of unit depth.
    rays: Vec<Vec3>,
    /// The mean of `rays`.
    middle: Vec3,
    /// Where the pixels lie flush in what is around them.
    wall: Option<PlaneFit>,
    /// Median planar depth.
    depth: f32,
    /// Principal axes of the outline, in the plane through its middle that faces the camera, and half the extent along them.
    axes: [Vec3; 2],
    half: [f32; 2],
    /// Area of the pixels at `depth`, square metres.
    area: f32,
}

impl<'a> SeenLamp<'a> {
    /// `around` are the pixels that surround the lamp, `normal` is of the camera's size. `None` when the lamp has no pixel.
    pub fn new(pixels: LampPixels<'a>, normal: &Normal, around: &[(usize, usize)]) -> Option<SeenLamp<'a>> {
        if pixels.pixels.is_empty() {
            return None;
        }
        let LampPixels { points, camera, .. } = pixels;
        let own: Vec<Vec3> = pixels.pixels.iter().map(|&(x, y)| points.0.get(x, y)).collect();
        let (places, normals): (Vec<Vec3>, Vec<Vec3>) =
            around.iter().map(|&(x, y)| (points.0.get(x, y), normal.0.get(x, y))).unzip();
        let rays: Vec<Vec3> = pixels.pixels.iter().map(|&(x, y)| camera.pixel_point(x, y, 1.0)).collect();
        let on = |plane: &PlaneFit| {
            own.iter().filter(|p| (plane.normal.dot(**p) - plane.offset).abs() < 0.02 * p.length()).count()
        };
        let wall = PlaneFit::through(&places, &normals, 0.02)
            .filter(|plane| plane.support > 0.6 && on(plane) * 10 > own.len() * 8);

        let depth = median(own.iter().map(|p| -p.z).collect());
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
        Some(SeenLamp { pixels, rays, middle, wall, depth, axes, half, area })
    }

    /// The shapes that `forms` asks for, the likeliest first.
    pub fn shapes(&self, forms: LampForms) -> Vec<Lamp> {
        match forms.form {
            LampForm::Likeliest => [self.solid()].into_iter().chain(self.plates(forms)).collect(),
            LampForm::Solid => vec![self.solid()],
            LampForm::Box => vec![self.boxed()],
            LampForm::Plates => vec![self.plates(forms).unwrap_or_else(|| self.solid())],
        }
    }

    fn panel(&self) -> Option<PlaneFit> {
        self.wall.filter(|plane| plane.normal.y.abs() > 0.7)
    }

    fn rect(&self) -> Option<Lamp> {
        let plane = self.panel()?;
        let (center, x, y) = extent(&self.rays, &plane)?;
        Some(Lamp::Rect(RectLamp { center: center + plane.normal * PROUD, x, y }))
    }

    fn is_long(&self) -> bool {
        self.half[0] / self.half[1] >= 1.6
    }

    /// Of a ball, from the area, which a ragged outline changes less than its ends.
    fn radius(&self) -> f32 {
        let radius = (self.area / std::f32::consts::PI).sqrt();
        radius * (1.0 + self.before() * radius / self.depth)
    }

    /// How far the middle lies behind the median depth, in halves of the width across. Depth sensors see through bright
    /// shades to the wall: then the lamp stands before what was measured, else around it. The median of a ball's front lies
    /// 0.7 radius before its centre (half of the disc lies within r / sqrt 2).
    fn before(&self) -> f32 {
        if self.wall.is_some() { -1.0 } else { 0.7 }
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
        let a = a.min(self.area / (4.0 * b) * 1.3);
        let body = Lamp::Box(BoxLamp { center: self.center(b), axes: [long * a, short * b, Vec3::NEG_Z * b] });
        self.rect().unwrap_or(body)
    }

    fn plates(&self, forms: LampForms) -> Option<Lamp> {
        let all = match self.panel() {
            Some(plane) => flat(&self.pixels, &PlaneFit { offset: plane.offset + PROUD, ..plane }),
            None => {
                let half = if self.is_long() { self.half[1] } else { self.radius() };
                closed(&self.pixels, Body { center: self.center(half), half, seen: self.wall.is_none() })
            }
        };
        let plates = thin(&all, forms.plates, forms.seed);
        (!plates.is_empty()).then_some(Lamp::Surfels(plates))
    }
}

/// How far a panel stands out from its ceiling, metres.
const PROUD: f32 = 0.01;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;
    use crate::image::{Mask, Plane, Points};
    use crate::optics::inverse::visible_light;
    use crate::optics::{LightKind, Shape, Surfel};

    fn forms(form: LampForm) -> LampForms {
        LampForms { form, ..LampForms::default() }
    }

    fn shapes(form: LampForm, camera: &Camera, z: &Plane<f32>, mask: &Plane<bool>, normal: Vec3) -> Vec<Shape> {
        let points = Points(Plane::from_fn(z.width(), z.height(), |x, y| camera.pixel_point(x, y, z.get(x, y))));
        let mask = Mask(mask.map(|inside| if inside { 1.0 } else { 0.0 }));
        let normal = Normal(Plane::filled(z.width(), z.height(), normal));
        visible_light(LightKind::Lamp, forms(form), &mask, &points, &normal, camera, None)
    }

    #[test]
    fn a_ball_is_a_sphere_and_a_strip_is_a_box() {
        let camera = Camera::from_fov_x(160, 120, 60.0);
        let center = Vec3::new(0.4, 0.3, -2.5);
        let seen = Shape::Lamp(Lamp::Sphere(SphereLamp { center, radius: 0.25 }));
        let z =
            Plane::from_fn(160, 120, |x, y| seen.intersect(Vec3::ZERO, camera.pixel_point(x, y, 1.0)).unwrap_or(5.0));
        let made = |form: LampForm| shapes(form, &camera, &z, &z.map(|z| z < 5.0), Vec3::Z);
        let [Shape::Lamp(Lamp::Sphere(SphereLamp { center: got, radius }))] = made(LampForm::Solid)[..] else {
            panic!("a sphere")
        };
        assert!(got.distance(center) < 0.05 && (radius / 0.25 - 1.0).abs() < 0.05, "{got} {radius}");
        let [Shape::Lamp(Lamp::Box(BoxLamp { center: got, .. }))] = made(LampForm::Box)[..] else { panic!("a box") };
        assert!(got.distance(center) < 0.05, "{got}");
        let [Shape::Lamp(Lamp::Surfels(plates))] = &made(LampForm::Plates)[..] else { panic!("plates") };
        let area: f32 = plates.iter().map(|p| p.area).sum();
        let want = 4.0 * std::f32::consts::PI * 0.0625;
        assert!(plates.len() <= 128 && (area / want - 1.0).abs() < 0.05, "{} plates, {area} {want}", plates.len());
        assert_eq!(made(LampForm::Likeliest).len(), 2);

        let strip = Plane::from_fn(160, 120, |x, y| (40..120).contains(&x) && (50..60).contains(&y));
        let shape = shapes(LampForm::Solid, &camera, &strip.map(|s| if s { 2.0 } else { 5.0 }), &strip, Vec3::Z);
        assert!(matches!(shape[..], [Shape::Lamp(Lamp::Box(_))]), "{shape:?}");
    }

    #[test]
    fn a_panel_in_the_ceiling_emits_from_one_side() {
        let camera = Camera::from_fov_x(160, 120, 60.0);
        // A ceiling 1 m above the camera, seen in the upper half; walls 5 m away.
        let height = |y: usize| camera.pixel_point(0, y, 1.0).y;
        let z = Plane::from_fn(160, 120, |_, y| if height(y) > 0.2 { 1.0 / height(y) } else { 5.0 });
        let mask = Plane::from_fn(160, 120, |x, y| (60..100).contains(&x) && (8..20).contains(&y));
        let made = |form: LampForm| shapes(form, &camera, &z, &mask, Vec3::NEG_Y);
        assert!(matches!(made(LampForm::Solid)[..], [Shape::Lamp(Lamp::Rect(_))]));
        let [Shape::Lamp(Lamp::Surfels(plates))] = &made(LampForm::Plates)[..] else { panic!("plates") };
        assert!(plates.iter().all(|p| p.normal == Vec3::NEG_Y && (p.point.y - 0.99).abs() < 1e-3));
        // 40 pixels wide from where row 8 begins to where row 20 does: the integral of (40 / f) z dz.
        let [near, far] = [8.0, 20.0].map(|row| 0.99 * camera.fy / (camera.cy - row));
        let want = 20.0 / camera.fx * (far * far - near * near);
        let area = plates.iter().map(|p| p.area).sum::<f32>();
        assert!((area / want - 1.0).abs() < 0.01, "{area} {want}");
    }

    /// Where the depth shows the wall behind a lamp, the lamp stands before the wall, as deep as its outline is narrow.
    #[test]
    fn a_lamp_that_the_depth_does_not_show_stands_before_its_wall() {
        let camera = Camera::from_fov_x(160, 120, 60.0);
        let mask = Plane::from_fn(160, 120, |x, y| (x as f32 - 79.5).hypot(y as f32 - 59.5) < 10.0);
        let made = shapes(LampForm::Plates, &camera, &Plane::filled(160, 120, 3.0), &mask, Vec3::Z);
        let [Shape::Lamp(Lamp::Surfels(plates))] = &made[..] else { panic!("plates") };
        // At the depth of the wall, then at that of the lamp.
        let radius = 10.0 / camera.fx * 3.0;
        let radius = radius * (1.0 - radius / 3.0);
        let depth = |p: &Surfel| -p.point.z;
        let (near, far) = plates.iter().fold((f32::MAX, 0f32), |(a, b), p| (a.min(depth(p)), b.max(depth(p))));
        assert!((near - (3.0 - 2.0 * radius)).abs() < 0.1 * radius && (far - 3.0).abs() < 0.1 * radius, "{near} {far}");
    }
}
