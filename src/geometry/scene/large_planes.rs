//! Walls, floors and ceilings of a noisy depth map: planes that large parts of the surface lie on.
//!
//! Depth cameras have errors that are smooth over many pixels. On a wall that a lamp grazes, they
//! turn the normals by more than the light can bear. A fit around each pixel cannot see them, a fit
//! of the whole wall can.

use glam::{DMat3, DVec3, Vec3};

use super::join_by_photo::join_by_photo;
use super::padding::{Run, padding};
use super::plane_fit::most_supported;
use super::surface::{Surface, median};
use crate::geometry::Camera;
use crate::image::{Depth, Mask, Picture, Plane, smooth_step};
use crate::tuning::tuning;

tuning! {
    /// Constants of the large planes of a noisy depth map.
    pub const TUNING: LargePlanesTuning {
        /// Standard deviation of the inverse depth from which on planes are looked for.
        min_noise: f32 = 5e-4,
            unit "1 / meter", source Measured("normals of four rooms by other people; docs/render.md"),
            effect "a smaller value flattens what exact depth shows of relief, such as recessed windows";
        /// Least support of a plane.
        min_support: f32 = 0.03,
            unit "fraction of all pixels", source Taste,
            effect "a smaller value flattens furniture, too";
        /// Most planes that are looked for.
        max_planes: usize = 8,
            unit "planes", source Derived("six sides of a room and two pieces of furniture"),
            effect "a larger value is slower";
        /// Pixels between those that search for a plane, along each axis.
        stride: usize = 4,
            unit "pixels", source Measured("run time; no page records it"),
            effect "a smaller value is slower";
        /// Pixels whose own planes are tried.
        tries: usize = 256,
            unit "planes", source Measured("run time; no page records it"),
            effect "a larger value is slower and finds smaller planes";
        /// Largest deviation of the inverse depth of a pixel from a plane that it supports. Pixels
        /// farther off than twice this never lie on it, whatever the noise.
        tolerance: f32 = 0.025,
            unit "fraction of the inverse depth", source Derived("smooth errors of structured light at 3 m"),
            effect "a larger value joins a wall and what hangs on it";
        /// Angles between the normals of a pixel and of a plane up to which the pixel lies wholly
        /// on it, and from which on it does not.
        angles: [f32; 2] = [25.0, 40.0],
            unit "degrees", source Taste, effect "larger values flatten rounded furniture";
        /// Deviations of the inverse depth up to which a pixel lies wholly on a plane, and from
        /// which on it does not.
        deviations: [f32; 2] = [3.0, 6.0],
            unit "standard deviations on this plane", source Taste,
            effect "larger values flatten what stands before a wall";
        /// Distance from padding to a pixel that lies on a plane, over the length of the padding,
        /// up to which the plane goes on: fits reach into the padding.
        beside_padding: f32 = 1.0,
            unit "1", source Derived("radius of the fits"),
            effect "a larger value extends walls over things at the border";
        /// Largest change of the inverse depth of padding.
        padding_change: f32 = 0.2,
            unit "fraction of the inverse depth", source Taste,
            effect "a larger value extends walls that end at the border";
        /// Distance from the border of the photo within which depth may err by more than its noise.
        near_border: f32 = 0.15,
            unit "fraction of the width", source Measured("six photographs with depth by a sensor"),
            effect "a larger value flattens other surfaces of a wall's color";
        /// Largest error of the inverse depth of a pixel that looks as the plane around it does.
        bulge: f32 = 0.08,
            unit "fraction of the inverse depth", source Measured("six photographs with depth by a sensor: 0.06 to 0.1"),
            effect "a larger value flattens things of a wall's color before it";
        /// Weighted fits of a plane to its supporters.
        passes: usize = 4,
            unit "passes", source Taste, effect "a larger value is slower and more robust";
    }
}

/// A plane: inverse depth w = a . (u, v, 1), with (u, v, -1) the view ray of a pixel.
#[derive(Clone, Copy)]
struct InversePlane {
    a: Vec3,
    /// Standard deviation of the inverse depth of its supporters.
    deviation: f32,
}

impl InversePlane {
    fn at(&self, uv: [f32; 2]) -> f32 {
        self.a.dot(Vec3::new(uv[0], uv[1], 1.0))
    }

    fn normal(&self) -> Vec3 {
        Vec3::new(-self.a.x, -self.a.y, self.a.z).try_normalize().unwrap_or(Vec3::Z)
    }
}

/// Moves the pixels that lie on large planes, up to the noise of the depth, onto these planes, and
/// gives them their normals. Depth with little noise stays as it is.
///
/// A plane is that which most pixels support (Fischler and Bolles 1981, over the pixels' own planes
/// at even steps instead of at random), fitted to the inverse depth of its supporters with Cauchy
/// weights; the next is that of the pixels that are left. A pixel near the limits is blended, so
/// that no step arises.
///
/// The `padding` of `depth`, the map of the surface with its holes, supports no plane. Where a
/// plane ends beside it, it goes on over the padding.
///
/// With the `photo` and the saturated fraction of its pixels, pixels near the border that are
/// farther off than the noise lie on a plane, too, if they look as it does around them, without an
/// edge between.
///
/// Pixels of which `left_out` holds stay, too.
///
/// # Panics
/// `depth`, `holes`, `photo` or `left_out` has another size than the surface.
pub fn flatten_planes(
    surface: &mut Surface,
    (depth, holes): (&Depth, Option<&Mask>),
    photo: Option<(&Picture, Option<&Mask>)>,
    camera: &Camera,
    left_out: &Plane<bool>,
) {
    assert_eq!(left_out.size(), surface.points.0.size(), "planes of one size");
    assert_eq!(depth.0.size(), surface.points.0.size(), "the depth of the surface");
    if surface.noise < TUNING.min_noise {
        return;
    }
    let padding = padding(&depth.0, holes);
    let mut is_seen = left_out.map(|out| !out);
    for run in padding.iter().flatten() {
        (0..run.length).for_each(|k| is_seen.pixels_mut()[run.pixel(k)] = false);
    }
    let (width, height) = surface.points.0.size();
    let uv = |i: usize| {
        let ray = camera.pixel_point(i % width, i / width, 1.0);
        [ray.x, ray.y]
    };
    let all: Vec<usize> = (0..height)
        .step_by(TUNING.stride)
        .flat_map(|y| (0..width).step_by(TUNING.stride).map(move |x| y * width + x))
        .filter(|&i| is_seen.pixels()[i])
        .collect();
    let mut left = all.clone();
    let mut planes = Vec::new();
    while planes.len() < TUNING.max_planes {
        let Some(plane) = largest(surface, &left, uv) else { break };
        let before = left.len();
        left.retain(|&i| weight(surface, i, &plane, uv(i)) == 0.0);
        if ((before - left.len()) as f32) < TUNING.min_support * all.len() as f32 {
            break;
        }
        planes.push(plane);
    }
    let mut on: Plane<Option<usize>> = Plane::filled(width, height, None);
    for i in (0..width * height).filter(|&i| !left_out.pixels()[i]) {
        let weights = planes.iter().enumerate();
        let weights = weights.map(|(k, plane)| (weight(surface, i, plane, uv(i)), k));
        let Some((weight, k)) = weights.reduce(|a, b| if b.0 > a.0 { b } else { a }) else {
            return;
        };
        on.pixels_mut()[i] = (weight >= 0.5).then_some(k);
        move_towards(surface, i, planes[k].at(uv(i)), (weight, planes[k].normal()));
    }
    if let Some(photo) = photo {
        join_planes(surface, &mut on, &planes, photo, |i| left_out.pixels()[i], uv);
    }
    let on: Vec<Option<InversePlane>> = on.pixels().iter().map(|k| k.map(|k| planes[k])).collect();
    for runs in &padding {
        extend_over(surface, runs, (&on, left_out), uv);
    }
}

/// Adds pixels to `planes` that belong to one by the photo, and moves them onto it. `on` are the
/// planes, by index, of the pixels that lie on one. Saturated pixels show nothing and stay.
fn join_planes(
    surface: &mut Surface,
    on: &mut Plane<Option<usize>>,
    planes: &[InversePlane],
    (photo, clipped): (&Picture, Option<&Mask>),
    is_left_out: impl Fn(usize) -> bool,
    uv: impl Fn(usize) -> [f32; 2],
) {
    let (width, height) = on.size();
    let before = on.clone();
    join_by_photo(on, planes.len(), photo, |i, k| {
        let (x, y) = (i % width, i / width);
        let to_border = x.min(width - 1 - x).min(y).min(height - 1 - y) as f32;
        let w = -1.0 / surface.points.0.pixels()[i].z;
        let is_white = clipped.is_some_and(|clipped| clipped.0.pixels()[i] > 0.0);
        !is_left_out(i)
            && !is_white
            && to_border < TUNING.near_border * width as f32
            && (planes[k].at(uv(i)) - w).abs() < TUNING.bulge * w
    });
    for (i, (before, after)) in before.pixels().iter().zip(on.pixels()).enumerate() {
        if before.is_none()
            && let Some(plane) = after.map(|k| planes[k])
        {
            move_towards(surface, i, plane.at(uv(i)), (1.0, plane.normal()));
        }
    }
}

/// Moves pixel `i` towards the inverse depth `to` and its normal towards `normal`, by the fraction
/// `weight` of the way.
fn move_towards(surface: &mut Surface, i: usize, to: f32, (weight, normal): (f32, Vec3)) {
    if weight > 0.0 {
        let point = &mut surface.points.0.pixels_mut()[i];
        let w = -1.0 / point.z;
        *point *= w / (w + weight * (to - w));
        let old = &mut surface.normal.0.pixels_mut()[i];
        *old = old.lerp(normal, weight).normalize_or(*old);
    }
}

/// Extends the planes that end at the padding of one side over it, and over what lies between.
/// `on` are the planes of the pixels that lie on one.
///
/// A run beside which no plane ends takes that of the nearest one: a lamp may stand there.
fn extend_over(
    surface: &mut Surface,
    runs: &[Run],
    (on, left_out): (&[Option<InversePlane>], &Plane<bool>),
    uv: impl Fn(usize) -> [f32; 2],
) {
    let end = |run: &Run| {
        let reach = run.length + (TUNING.beside_padding * run.length as f32) as usize;
        let mut beside = run.length..reach.min(run.across);
        beside.find_map(|k| Some((k, on[run.pixel(k)]?)))
    };
    let ends: Vec<Option<(usize, InversePlane)>> = runs.iter().map(end).collect();
    let ended = || runs.iter().zip(&ends).filter_map(|(run, end)| Some((run.line, (*end)?.1)));
    for (run, end) in runs.iter().zip(&ends) {
        let nearest = || ended().min_by_key(|(line, _)| line.abs_diff(run.line));
        let Some((end, plane)) = end.or_else(|| Some((run.length, nearest()?.1))) else { return };
        for i in (0..end).map(|k| run.pixel(k)).filter(|&i| !left_out.pixels()[i]) {
            let (w, to) = (-1.0 / surface.points.0.pixels()[i].z, plane.at(uv(i)));
            if (to - w).abs() < TUNING.padding_change * w {
                move_towards(surface, i, to, (1.0, plane.normal()));
            }
        }
    }
}

/// The plane that most of the pixels `left` support.
fn largest(
    surface: &Surface,
    left: &[usize],
    uv: impl Fn(usize) -> [f32; 2],
) -> Option<InversePlane> {
    let (points, normals) = (surface.points.0.pixels(), surface.normal.0.pixels());
    let is_alike = TUNING.angles[0].to_radians().cos();
    let supports = |plane: &InversePlane, i: usize| {
        let w = -1.0 / points[i].z;
        (plane.at(uv(i)) - w).abs() < TUNING.tolerance * w
            && normals[i].dot(plane.normal()) > is_alike
    };
    let own = |k: usize| {
        let i = left[k];
        let n = normals[i] / normals[i].dot(points[i]);
        // n . P = d gives w = (n_x u + n_y v - n_z) / d.
        let a = Vec3::new(n.x, n.y, -n.z);
        a.is_finite().then_some(InversePlane { a, deviation: 0.0 })
    };
    let mut plane =
        most_supported(left.len(), TUNING.tries, own, |plane, k| supports(plane, left[k]))?;
    for _ in 0..TUNING.passes {
        let inside: Vec<usize> = left.iter().copied().filter(|&i| supports(&plane, i)).collect();
        let offs: Vec<f32> =
            inside.iter().map(|&i| (plane.at(uv(i)) + 1.0 / points[i].z).abs()).collect();
        let deviation = median(&mut offs.clone())? / super::surface::TUNING.noise_of_median;
        let scale = f64::from(deviation.max(surface.noise));
        let (mut m, mut b) = (DMat3::ZERO, DVec3::ZERO);
        for (&i, &off) in inside.iter().zip(&offs) {
            let [u, v] = uv(i).map(f64::from);
            let row = DVec3::new(u, v, 1.0);
            let weight = 1.0 / (1.0 + (f64::from(off) / scale).powi(2));
            m += DMat3::from_cols(row * (u * weight), row * (v * weight), row * weight);
            b += row * (-weight / f64::from(points[i].z));
        }
        let a = (m.inverse() * b).as_vec3();
        if !a.is_finite() {
            return None;
        }
        plane = InversePlane { a, deviation: scale as f32 };
    }
    Some(plane)
}

/// The weight with which pixel `i` lies on a plane, 0..=1.
fn weight(surface: &Surface, i: usize, plane: &InversePlane, uv: [f32; 2]) -> f32 {
    let w = -1.0 / surface.points.0.pixels()[i].z;
    let far = [TUNING.tolerance, 2.0 * TUNING.tolerance].map(|part| part * w);
    let [on, off] = [0, 1].map(|k| far[k].min(TUNING.deviations[k] * plane.deviation));
    let near = 1.0 - smooth_step(on, off, (plane.at(uv) - w).abs());
    let [on, off] = TUNING.angles;
    let angle = surface.normal.0.pixels()[i].angle_between(plane.normal()).to_degrees();
    near * (1.0 - smooth_step(on, off, angle))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::surface;

    /// Two walls that meet in a vertical crease, and a ball before them.
    fn room(camera: &Camera, x: usize, y: usize) -> (f32, Option<Vec3>) {
        let ray = camera.pixel_point(x, y, 1.0);
        let walls = [(Vec3::X, -1.0), (Vec3::new(-0.2, 0.0, 1.0).normalize(), -3.0)];
        let hits = walls.map(|(n, d)| (d / n.dot(ray), Some(n)));
        let wall = hits.into_iter().filter(|(z, _)| *z > 0.0).min_by(|a, b| a.0.total_cmp(&b.0));
        let (center, radius) = (Vec3::new(0.3, -0.2, -2.0), 0.3);
        let (b, c) = (ray.dot(center), center.length_squared() - radius * radius);
        let root = b * b - ray.length_squared() * c;
        match root > 0.0 {
            true => ((b - root.sqrt()) / ray.length_squared(), None),
            false => wall.expect("one of the walls is before the camera"),
        }
    }

    /// Mean angle between the normals of the walls and their truth, degrees; largest movement of a
    /// point of the ball, meters.
    fn errors(noise: f32) -> [(f32, f32); 2] {
        let camera = Camera::from_fov_x(160, 120, 60.0);
        // Smooth errors, as of structured light, and those of each pixel.
        let error = |x: usize, y: usize| {
            let (u, v) = (x as f32, y as f32);
            let grain = ((x * 7919 + y * 104_729) % 1000) as f32 / 500.0 - 1.0;
            noise * ((u / 9.0).sin() + (v / 7.0 + 1.0).sin() + (0.11 * u + 0.13 * v).cos() + grain)
        };
        let depth = Depth(Plane::from_fn(160, 120, |x, y| {
            1.0 / (1.0 / room(&camera, x, y).0 + error(x, y))
        }));
        let first = surface(&depth, &camera);
        let measure = |got: &Surface| {
            let (mut angles, mut count, mut moved) = (0.0, 0, 0.0f32);
            for (i, (normal, point)) in
                got.normal.0.pixels().iter().zip(got.points.0.pixels()).enumerate()
            {
                match room(&camera, i % 160, i / 160).1 {
                    Some(truth) => {
                        angles += normal.angle_between(truth).to_degrees();
                        count += 1;
                    }
                    None => moved = moved.max((point.z - first.points.0.pixels()[i].z).abs()),
                }
            }
            (angles / count as f32, moved)
        };
        let mut flat = surface(&depth, &camera);
        flatten_planes(
            &mut flat,
            (&depth, None),
            None,
            &camera,
            &Plane::from_fn(160, 120, |x, _| x >= 150),
        );
        assert!(
            (0..160 * 120).filter(|i| i % 160 >= 150).all(|i| {
                flat.points.0.pixels()[i] == first.points.0.pixels()[i]
                    && flat.normal.0.pixels()[i] == first.normal.0.pixels()[i]
            }),
            "pixels that are left out stay"
        );
        [measure(&first), measure(&flat)]
    }

    #[test]
    fn walls_become_flat_and_a_ball_before_them_stays() {
        let [before, after] = errors(2e-3);
        assert!(before.0 > 4.0, "the noise matters: {before:?}");
        assert!(after.0 < 0.3 * before.0, "{after:?} against {before:?}");
        // The noise moves points of the ball, 1.7 m away, by up to 2.3 cm.
        assert!(after.1 < 0.05, "points of the ball stay within twice the noise: {after:?}");
    }

    #[test]
    fn a_wall_goes_on_over_padding_beside_it_and_a_thing_before_it_stays() {
        // A wall that comes nearer to the right, a box before it at the border, and 5 columns of
        // padding.
        let camera = Camera::from_fov_x(160, 120, 60.0);
        let normal = Vec3::new(-0.6, 0.0, 0.8);
        let is_box = |x: usize, y: usize| x > 130 && (50..70).contains(&y);
        let depth = |x: usize, y: usize| match is_box(x, y) {
            true => 1.0,
            false => -2.0 / normal.dot(camera.pixel_point(x, y, 1.0)),
        };
        let noise = |x: usize, y: usize| ((x * 7919 + y * 104_729) % 1000) as f32 / 500.0 - 1.0;
        let noisy = |x: usize, y: usize| 1.0 / (1.0 / depth(x, y) + 2e-3 * noise(x, y));
        let padded = Depth(Plane::from_fn(160, 120, |x, y| noisy(x.min(154), y)));
        let mut flat = surface(&padded, &camera);
        let before = flat.normal.0.clone();
        flatten_planes(&mut flat, (&padded, None), None, &camera, &Plane::filled(160, 120, false));
        let off = |normals: &Plane<Vec3>, x: usize, y: usize| {
            normals.get(x, y).angle_between(normal).to_degrees()
        };
        for y in (5..45).chain(75..115) {
            assert!(off(&before, 158, y) > 20.0, "the padding faces the camera");
            for x in [140, 154, 159] {
                assert!(off(&flat.normal.0, x, y) < 2.0, "({x}, {y})");
                let z = -flat.points.0.get(x, y).z;
                assert!((z / depth(x, y) - 1.0).abs() < 0.01, "({x}, {y}): {z}");
            }
        }
        for y in 52..68 {
            assert!((-flat.points.0.get(157, y).z - 1.0).abs() < 0.05, "the box stays");
        }
    }

    #[test]
    fn what_lies_far_behind_a_door_stays_there() {
        // A wall at 3 m, with a door to something at 40 m that faces the camera as the wall does.
        let camera = Camera::from_fov_x(80, 60, 60.0);
        let grain = |x: usize, y: usize| ((x * 7919 + y * 104_729) % 1000) as f32 / 500.0 - 1.0;
        let depth = Depth(Plane::from_fn(80, 60, |x, y| {
            let z = if (30..45).contains(&x) { 40.0 } else { 3.0 };
            1.0 / (1.0 / z + 3e-3 * grain(x, y))
        }));
        let first = surface(&depth, &camera);
        let mut flat = surface(&depth, &camera);
        flatten_planes(&mut flat, (&depth, None), None, &camera, &Plane::filled(80, 60, false));
        for (before, after) in first.points.0.pixels().iter().zip(flat.points.0.pixels()) {
            assert!(
                after.is_finite() && (after.z / before.z - 1.0).abs() < 0.06,
                "{before} {after}"
            );
        }
    }

    #[test]
    fn a_wall_that_bulges_in_a_corner_is_flat_where_the_photo_is_even() {
        let camera = Camera::from_fov_x(160, 120, 60.0);
        let grain = |x: usize, y: usize| ((x * 7919 + y * 104_729) % 1000) as f32 / 500.0 - 1.0;
        let bulge = |x: usize, y: usize| {
            let (x, y) = (x as f32 - 8.0, y as f32 - 8.0);
            0.06 * (-(x * x + y * y) / 50.0).exp()
        };
        let depth = Depth(Plane::from_fn(160, 120, |x, y| {
            1.0 / ((1.0 + bulge(x, y)) / 3.0 + 1e-3 * grain(x, y))
        }));
        let off = |photo: Option<(&Picture, Option<&Mask>)>| {
            let mut flat = surface(&depth, &camera);
            flatten_planes(
                &mut flat,
                (&depth, None),
                photo,
                &camera,
                &Plane::filled(160, 120, false),
            );
            let angle = |(x, y)| flat.normal.0.get(x, y).angle_between(Vec3::Z).to_degrees();
            [(3, 8), (8, 3), (13, 8), (8, 13)].map(angle).into_iter().fold(0.0, f32::max)
        };
        assert!(off(None) > 15.0, "the bulge matters: {}", off(None));
        let even = Picture(Plane::filled(160, 120, Vec3::splat(0.3)));
        assert!(off(Some((&even, None))) < 1.0, "{}", off(Some((&even, None))));
        let white = Mask(Plane::filled(160, 120, 1.0));
        assert_eq!(off(Some((&even, Some(&white)))), off(None), "a saturated photo shows nothing");
        let ball = Picture(Plane::from_fn(160, 120, |x, y| {
            Vec3::splat(if bulge(x, y) > 0.01 { 0.15 } else { 0.3 })
        }));
        assert_eq!(off(Some((&ball, None))), off(None), "a thing of another color stays");
    }

    #[test]
    fn depth_of_little_noise_is_left_as_it_is() {
        let [before, after] = errors(1e-5);
        assert_eq!((before, after.1), (after, 0.0));
    }
}
