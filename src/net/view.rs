//! The room as the networks take it: planes of one size, exposure and scale as they were trained
//! with.

use glam::Vec3;

use super::{InputLayer, Tensor, planes_of};
use crate::geometry::Camera;
use crate::image::{Depth, Mask, Normal, Picture, Plane, resize, resize_depth};
use crate::tuning::tuning;

/// Columns and rows that MNet sees.
pub const FULL: (usize, usize) = (320, 240);
/// Columns and rows that the others see.
pub const HALF: (usize, usize) = (160, 120);

tuning! {
    /// Constants of the room as the networks take it. The networks were trained with them.
    pub const TUNING: ViewTuning {
        /// Quantile of the pixels outside of lights that is brought to `exposure`.
        bright: usize = 98,
            unit "percent", source Derived("training of the networks"),
            effect "another value shows the networks another exposure than they were trained with";
        /// Level of that quantile.
        exposure: f32 = 0.95,
            unit "level of the photo for a network", source Derived("training of the networks"),
            effect "another value shows the networks another exposure than they were trained with";
        /// Least level by which the photo is divided.
        min_level: f32 = 1e-4,
            unit "units of the photo", source Taste, effect "a larger value shows black photos darker";
    }
}

/// A photo in the exposure that the networks expect, and the pixels of its lights.
pub struct View {
    /// Clipped at 1; [`FULL`].
    pub photo: Plane<Vec3>,
    /// Gain of the photo: the networks' radiances are in units of the photo times this gain.
    pub gain: f32,
    /// 1 at pixels of visible lights, else 0; [`FULL`].
    pub light: Plane<f32>,
}

impl View {
    /// A photo of any size, with the masks of its visible lights.
    pub fn new<'a>(photo: &Picture, masks: impl Iterator<Item = &'a Mask>) -> View {
        let photo = resize(&photo.0, FULL.0, FULL.1);
        let light = light_mask(masks);
        let room = photo.pixels().iter().zip(light.pixels()).filter(|(_, light)| **light == 0.0);
        let mut levels: Vec<f32> = room.map(|(p, _)| p.element_sum() / 3.0).collect();
        let at = levels.len().saturating_sub(1) * TUNING.bright / 100;
        let level = if levels.is_empty() {
            0.0
        } else {
            *levels.select_nth_unstable_by(at, f32::total_cmp).1
        };
        let gain = TUNING.exposure / level.max(TUNING.min_level);
        View { photo: photo.map(|p| (p * gain).clamp(Vec3::ZERO, Vec3::ONE)), gain, light }
    }

    /// The photo at [`HALF`].
    pub fn half_photo(&self) -> Plane<Vec3> {
        resize(&self.photo, HALF.0, HALF.1)
    }

    /// 1 where a visible light has a pixel, [`HALF`].
    pub fn half_light(&self) -> Plane<f32> {
        any(&self.light)
    }
}

/// 1 at pixels of visible lights, else 0; [`FULL`].
fn light_mask<'a>(masks: impl Iterator<Item = &'a Mask>) -> Plane<f32> {
    let mut light = Plane::filled(FULL.0, FULL.1, 0.0f32);
    for mask in masks {
        light
            .pixels_mut()
            .iter_mut()
            .zip(own(mask).pixels())
            .for_each(|(light, own)| *light = light.max(*own));
    }
    light
}

/// 1 where a visible light has a pixel, [`HALF`].
pub fn seen_half<'a>(masks: impl Iterator<Item = &'a Mask>) -> Plane<f32> {
    any(&light_mask(masks))
}

/// 1 where more than half of a pixel is the light's, else 0; [`FULL`].
fn own(mask: &Mask) -> Plane<f32> {
    resize(&mask.0, FULL.0, FULL.1).map(|share| if share > 0.5 { 1.0 } else { 0.0 })
}

/// 1 where more than half of one of the [`FULL`] pixels of a [`HALF`] pixel is the light's.
pub fn own_half(mask: &Mask) -> Plane<f32> {
    any(&own(mask))
}

/// The largest of 2 x 2 pixels.
fn any(full: &Plane<f32>) -> Plane<f32> {
    Plane::from_fn(HALF.0, HALF.1, |x, y| {
        let at = |dx: usize, dy: usize| full.get(2 * x + dx, 2 * y + dy);
        at(0, 0).max(at(1, 0)).max(at(0, 1)).max(at(1, 1))
    })
}

/// Normals and points of a room, one size.
pub struct Geometry {
    /// Unit normals in camera space.
    pub normal: Plane<Vec3>,
    /// Meters.
    pub points: Plane<Vec3>,
}

impl Geometry {
    /// The geometry that MNet takes: points of the depth at [`FULL`], normals from their central
    /// differences.
    pub fn raw(depth: &Depth, camera: &Camera) -> Geometry {
        let camera = camera.resized(FULL.0, FULL.1);
        let depth = resize_depth(depth, FULL.0, FULL.1);
        let points =
            Plane::from_fn(FULL.0, FULL.1, |x, y| camera.pixel_point(x, y, depth.0.get(x, y)));
        let at = |x: isize, y: isize| {
            points.get(
                x.clamp(0, FULL.0 as isize - 1) as usize,
                y.clamp(0, FULL.1 as isize - 1) as usize,
            )
        };
        let normal = Plane::from_fn(FULL.0, FULL.1, |x, y| {
            let (x, y) = (x as isize, y as isize);
            let n = (at(x, y + 1) - at(x, y - 1))
                .cross(at(x + 1, y) - at(x - 1, y))
                .normalize_or_zero();
            if n.dot(at(x, y)) > 0.0 { -n } else { n }
        });
        Geometry { normal, points }
    }

    /// The geometry that the other networks take: [`HALF`], with given normals.
    pub fn half(depth: &Depth, camera: &Camera, normal: &Normal) -> Geometry {
        let camera = camera.resized(HALF.0, HALF.1);
        let depth = resize(&resize_depth(depth, FULL.0, FULL.1).0, HALF.0, HALF.1);
        let points =
            Plane::from_fn(HALF.0, HALF.1, |x, y| camera.pixel_point(x, y, depth.get(x, y)));
        let normal =
            resize(&normal.0, HALF.0, HALF.1).map(|n| n.try_normalize().unwrap_or(Vec3::Z));
        Geometry { normal, points }
    }

    /// Channels: normal, points.
    pub fn tensor(&self) -> Tensor {
        planes_of(&[InputLayer::Color(&self.normal), InputLayer::Color(&self.points)])
    }
}

/// The position of a visible light by mask and depth, [`HALF`]: center (m) and half extents across
/// the view (m). Depth is the median over the mask; of a window that over a ring of two pixels
/// around it, as depth of a pane may be that of the view outside. `None` for an empty mask.
pub fn start(
    points: &Plane<Vec3>,
    own: &Plane<f32>,
    light: &Plane<f32>,
    is_window: bool,
) -> Option<[f32; 5]> {
    let (width, height) = points.size();
    let inside: Vec<Vec3> = points
        .pixels()
        .iter()
        .zip(own.pixels())
        .filter(|(_, own)| **own > 0.0)
        .map(|(p, _)| *p)
        .collect();
    if inside.is_empty() {
        return None;
    }
    let near = |x: usize, y: usize| {
        let (xs, ys) =
            (x.saturating_sub(2)..(x + 3).min(width), y.saturating_sub(2)..(y + 3).min(height));
        ys.clone().any(|y| xs.clone().any(|x| own.get(x, y) > 0.0))
    };
    let ring =
        (0..points.len()).filter(|i| light.pixels()[*i] == 0.0 && near(i % width, i / width));
    let ring: Vec<f32> =
        if is_window { ring.map(|i| -points.pixels()[i].z).collect() } else { Vec::new() };
    let mut depths = if ring.len() >= 4 { ring } else { inside.iter().map(|p| -p.z).collect() };
    let middle = (depths.len() - 1) / 2;
    let depth = *depths.select_nth_unstable_by(middle, f32::total_cmp).1;
    let count = inside.len() as f32;
    let ray = |p: &Vec3| *p / -p.z;
    let mean = inside.iter().map(ray).sum::<Vec3>() / count;
    let spread = inside.iter().map(|p| (ray(p) - mean) * (ray(p) - mean)).sum::<Vec3>() / count;
    let half = |variance: f32| (3.0 * variance).sqrt() * depth + 0.01;
    let center = mean * depth;
    Some([center.x, center.y, center.z, half(spread.x), half(spread.y)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposure_passes_over_lights() {
        let photo = Picture(Plane::from_fn(640, 480, |x, y| {
            Vec3::splat(if x < 64 { 50.0 } else { 0.01 * (y % 100) as f32 })
        }));
        let mask = Mask(Plane::from_fn(640, 480, |x, _| if x < 64 { 1.0 } else { 0.0 }));
        let view = View::new(&photo, [&mask].into_iter());
        let bright = view
            .photo
            .pixels()
            .iter()
            .zip(view.light.pixels())
            .filter(|(p, l)| **l == 0.0 && p.x > TUNING.exposure)
            .count();
        assert!(bright <= 288 * 240 / 50, "{bright} pixels above the level");
        assert_eq!(view.light.pixels().iter().sum::<f32>(), 32.0 * 240.0);
        assert!(view.photo.pixels().iter().all(|p| p.max_element() <= 1.0));
    }

    #[test]
    fn a_black_photo_and_one_that_is_all_light_have_an_exposure() {
        for share in [0.0, 1.0] {
            let mask = Mask(Plane::filled(4, 3, share));
            let view = View::new(&Picture(Plane::filled(4, 3, Vec3::ZERO)), [&mask].into_iter());
            assert!(view.gain.is_finite() && view.photo.pixels().iter().all(|p| *p == Vec3::ZERO));
        }
    }

    #[test]
    fn the_normals_of_a_plane_are_its_own() {
        let camera = Camera::from_fov_x(320, 240, 60.0);
        let n = Vec3::new(0.3, 0.2, 1.0).normalize();
        let depth = Depth(Plane::from_fn(320, 240, |x, y| {
            let ray = camera.pixel_point(x, y, 1.0);
            -3.0 * n.z / n.dot(ray)
        }));
        let seen = Geometry::raw(&depth, &camera);
        // Single precision over differences of two pixels.
        assert!(seen.normal.pixels().iter().all(|got| got.dot(n) > 0.9999));
        let half = Geometry::half(&depth, &camera, &Normal(Plane::filled(320, 240, n)));
        assert!((n.dot(half.points.get(80, 60)) + 3.0 * n.z).abs() < 1e-3);
    }

    #[test]
    fn a_light_starts_in_the_middle_of_its_mask() {
        let camera = Camera::from_fov_x(160, 120, 60.0);
        let own = Plane::from_fn(160, 120, |x, y| {
            if (60..100).contains(&x) && (50..70).contains(&y) { 1.0 } else { 0.0 }
        });
        let depth = |x: usize, y: usize| if own.get(x, y) > 0.0 { 50.0 } else { 4.0 };
        let points = Plane::from_fn(160, 120, |x, y| camera.pixel_point(x, y, depth(x, y)));
        let [x, y, z, half_x, half_y] = start(&points, &own, &own, true).expect("there is a mask");
        assert!(
            (z + 4.0).abs() < 1e-5 && x.abs() < 1e-4 && y.abs() < 1e-4,
            "in the wall, got {x} {y} {z}"
        );
        // Half of 40 and 20 pixels at 4 m; the variance of n pixels in a row is (n^2 - 1) / 12.
        assert!(
            (half_x / (20.0 * 4.0 / camera.fx + 0.01) - 1.0).abs() < 0.01
                && (half_y / half_x - 0.5).abs() < 0.02
        );
        assert_eq!(start(&points, &own, &own, false).expect("there is a mask")[2], -50.0);
        assert_eq!(start(&points, &Plane::filled(160, 120, 0.0), &own, true), None);
    }
}
