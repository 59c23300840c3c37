//! The panes of windows in view: glass in which the room is reflected.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::geometry::{Camera, SceneMesh};
use crate::image::{GlareMask, Plane, rule};
use crate::optics::{Lamp, RectLamp, Shape, Window};
use crate::tuning::tuning;

tuning! {
    /// Constants of the panes of windows in view.
    pub const TUNING: PaneTuning {
        /// Refractive index of glass.
        refraction: f32 = 1.52,
            unit "1", source Derived("soda-lime glass"), effect "a larger value brightens reflections";
        /// Distance before a pane at which a reflected ray starts: depth is uncertain there.
        lift: f32 = 0.05,
            unit "meters", source Taste, effect "a smaller value lets a pane reflect its own wall";
        /// Least albedo of a pane by which its reflection is divided.
        min_albedo: f32 = 1e-3,
            unit "albedo", source Derived("single precision"),
            effect "a larger value makes reflections fainter in panes without an albedo";
    }
}

/// The rays that the pane of a window reflects into the room.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PaneRays {
    /// (width, height) of the working size.
    pub size: (usize, usize),
    rays: Vec<PaneRay>,
}

/// A reflected ray.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PaneRay {
    /// Index of the working pixel that shows the pane.
    pixel: u32,
    /// Fraction of the light that the glass reflects.
    share: f32,
    /// Start, meters, camera space.
    pub origin: Vec3,
    /// Unit vector.
    pub direction: Vec3,
    /// Index of the working pixel of the surface that it meets, and the distance, meters; `None`
    /// where it meets the unseen part of the room.
    pub hit: Option<(u32, f32)>,
}

impl PaneRays {
    /// The rays of a window of this shape with the own pixels of `mask`, in a room of which the
    /// camera sees the surfaces of `mesh`; none for a shape that is not a rectangle.
    pub fn new(mask: &GlareMask, shape: &Shape, mesh: &SceneMesh, camera: &Camera) -> PaneRays {
        let rect = match shape {
            Shape::Window(Window { center, x, y, .. })
            | Shape::Lamp(Lamp::Rect(RectLamp { center, x, y })) => Some((*center, x.cross(*y))),
            Shape::Lamp(_) | Shape::Absent => None,
        };
        let size = mesh.size();
        let (w, h) = size;
        let camera = camera.resized(w, h);
        let is_own = |i: usize| mask.is_own(mask.pixel_at((i % w, i / w), size));
        let ray = |(pixel, center, normal): (usize, Vec3, Vec3)| {
            let towards = camera.pixel_point(pixel % w, pixel / w, 1.0).try_normalize()?;
            let facing = -towards.dot(normal);
            let distance = -center.dot(normal) / facing;
            if facing <= 0.0 || !(distance > 0.0 && distance.is_finite()) {
                return None;
            }
            let place = towards * distance;
            let origin = place + normal * (TUNING.lift + mesh.offset(place));
            let direction = (towards + 2.0 * facing * normal).normalize();
            let hit = mesh.closest(origin, direction);
            // A pane is not seen in itself.
            let hit = hit.map(|hit| (hit.pixel, hit.distance));
            let hit = hit.filter(|&(hit, _)| (hit as usize) < w * h && !is_own(hit as usize));
            Some(PaneRay {
                pixel: pixel as u32,
                share: reflected_share(facing),
                origin,
                direction,
                hit,
            })
        };
        let normal = rect.and_then(|(center, normal)| Some((center, normal.try_normalize()?)));
        let pixels = normal.into_iter().flat_map(|(center, normal)| {
            (0..w * h).filter(|&i| is_own(i)).map(move |i| (i, center, normal))
        });
        PaneRays { size, rays: pixels.filter_map(ray).collect() }
    }

    /// The number of rays.
    pub fn len(&self) -> usize {
        self.rays.len()
    }

    /// No pane, or one of which the camera sees nothing.
    pub fn is_empty(&self) -> bool {
        self.rays.is_empty()
    }

    /// Memory, bytes.
    pub fn bytes(&self) -> usize {
        self.rays.len() * size_of::<PaneRay>()
    }

    /// Whether rays that were read from disk belong to pixels of the working size.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub fn check(&self) -> Result<(), String> {
        let pixels = self.size.0.saturating_mul(self.size.1);
        let inside = |pixel: u32| (pixel as usize) < pixels;
        let sound = |ray: &PaneRay| {
            inside(ray.pixel)
                && ray.hit.is_none_or(|(hit, away)| inside(hit) && away >= 0.0)
                && (0.0..=1.0).contains(&ray.share)
                && ray.origin.is_finite()
                && ray.direction.is_normalized()
        };
        rule(self.rays.iter().all(sound), "rays of pixels of the working size")
    }

    /// The working planes as the pane shows them, of `albedo`: the `shadings` have the reflection
    /// on top. A surface reflects its shading times `reflectance`, the unseen part of the room
    /// `unseen` times its mean, and `emitted` gives the light of lamps by the plane that it is in.
    pub fn reflect(
        &self,
        planes: &[&Plane<Vec3>],
        (shadings, reflectance): (&[usize], &Plane<Vec3>),
        (albedo, unseen): (f32, f32),
        emitted: impl Fn(&PaneRay) -> Vec<(usize, Vec3)>,
    ) -> Vec<Plane<Vec3>> {
        let mut shown: Vec<Plane<Vec3>> = planes.iter().map(|&plane| plane.clone()).collect();
        let albedo = albedo.max(TUNING.min_albedo);
        for &k in shadings {
            let surface = |i: usize| reflectance.pixels()[i] * planes[k].pixels()[i];
            let mean = (0..planes[k].len()).map(surface).sum::<Vec3>();
            let mean = unseen * mean / planes[k].len().max(1) as f32;
            for ray in &self.rays {
                let light = ray.hit.map_or(mean, |(hit, _)| surface(hit as usize));
                shown[k].pixels_mut()[ray.pixel as usize] += ray.share / albedo * light;
            }
        }
        for ray in &self.rays {
            for (k, light) in emitted(ray) {
                shown[k].pixels_mut()[ray.pixel as usize] += ray.share / albedo * light;
            }
        }
        shown
    }
}

/// Fraction of unpolarized light that a pane reflects at this cosine of the angle of incidence: by
/// Fresnel's equations, R at one surface, and 2 R / (1 + R) by both and all reflections in between.
fn reflected_share(cosine: f32) -> f32 {
    let cosine = cosine.clamp(0.0, 1.0);
    let n = TUNING.refraction;
    let inside = (1.0 - (1.0 - cosine * cosine) / (n * n)).sqrt();
    let across = (cosine - n * inside) / (cosine + n * inside);
    let along = (n * cosine - inside) / (n * cosine + inside);
    let share = |amplitude: f32| {
        let one = amplitude * amplitude;
        2.0 * one / (1.0 + one)
    };
    // Each polarization by itself: light between the surfaces keeps its own.
    0.5 * (share(across) + share(along))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Mask, Picture, Points};

    #[test]
    fn glass_reflects_by_fresnel() {
        // ((n - 1) / (n + 1))^2 = 0.0426 at each of two surfaces.
        assert!((reflected_share(1.0) - 0.0817).abs() < 1e-4, "{}", reflected_share(1.0));
        assert!((reflected_share(0.0) - 1.0).abs() < 1e-6);
        // At Brewster's angle one polarization passes.
        let brewster = (TUNING.refraction.atan()).cos();
        let n2 = TUNING.refraction.powi(2);
        let one = ((1.0 - n2) / (1.0 + n2)).powi(2);
        assert!((reflected_share(brewster) - one / (1.0 + one)).abs() < 1e-5);
    }

    #[test]
    fn a_pane_shows_the_mirror_image_of_the_room() {
        // A wall at 4 m; the pane stands upright at x = 1, seen from the side.
        let (w, h) = (32, 24);
        let camera = Camera::from_fov_x(w, h, 60.0);
        let points = Points(Plane::from_fn(w, h, |x, y| camera.pixel_point(x, y, 4.0)));
        let focal = camera.pixel_point(1, 0, 1.0).distance(camera.pixel_point(0, 0, 1.0)).recip();
        let mesh = SceneMesh::new(&points, focal, 0.0, &Plane::filled(w, h, false));
        let own = Plane::from_fn(w, h, |x, _| if x > 24 { 1.0 } else { 0.0 });
        let photo = Picture(Plane::filled(w, h, Vec3::ONE));
        let mask = GlareMask::of_window(&own, &photo, &Mask(own.map(|_| 0.0)), 1e-3);
        let (center, x, y) = (Vec3::new(1.0, 0.0, -2.5), Vec3::Z, Vec3::Y);
        let rect = RectLamp { center, x: x * 1.5, y };
        assert!(x.cross(y).x < 0.0, "it faces the room");
        let rays = PaneRays::new(&mask, &Shape::Lamp(Lamp::Rect(rect)), &mesh, &camera);
        assert_eq!(rays.rays.len(), 7 * h);
        let mut hits = 0;
        for ray in &rays.rays {
            let Some((hit, distance)) = ray.hit else { continue };
            hits += 1;
            // The mirror image of the place that it meets lies on the ray of its pixel.
            let place = ray.origin + ray.direction * distance;
            let image = Vec3::new(
                2.0 * (1.0 - TUNING.lift - mesh.offset(center)) - place.x,
                place.y,
                place.z,
            );
            let pixel = ray.pixel as usize;
            let towards = camera.pixel_point(pixel % w, pixel / w, 1.0);
            assert!(image.angle_between(towards) < 0.05, "{image} along {towards}");
            assert!(points.0.pixels()[hit as usize].distance(place) < 0.3);
        }
        assert!(hits > 20, "{hits} of {} meet the wall", rays.rays.len());
        assert_eq!(rays.check(), Ok(()));
        assert!(PaneRays { size: (w, h - 1), ..rays.clone() }.check().is_err(), "a smaller photo");
        // Half of the light of a wall of reflectance 0.5, and 3 where the room is not seen.
        let reflectance = Plane::filled(w, h, Vec3::splat(0.5));
        let (shading, other) = (Plane::filled(w, h, Vec3::ONE), Plane::filled(w, h, Vec3::ZERO));
        let emitted = |ray: &PaneRay| match ray.hit {
            Some(_) => vec![],
            None => vec![(1, Vec3::splat(3.0))],
        };
        let shown = rays.reflect(&[&shading, &other], (&[0], &reflectance), (0.1, 0.2), emitted);
        for ray in &rays.rays {
            let want = match ray.hit {
                Some(_) => [1.0 + ray.share / 0.1 * 0.5, 0.0],
                None => [1.0 + ray.share / 0.1 * 0.2 * 0.5, ray.share / 0.1 * 3.0],
            };
            for (shown, want) in shown.iter().zip(want) {
                let got = shown.pixels()[ray.pixel as usize];
                assert!((got - Vec3::splat(want)).abs().max_element() < 1e-5, "{got} for {want}");
            }
        }
    }
}
