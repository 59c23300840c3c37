//! Points and normals from a depth map that may be noisy.
//!
//! On a plane n . P = d seen by a pinhole camera, the inverse depth w = 1/z is affine in the
//! picture: with P = z (u, v, -1),
//!
//! w(u, v) = (n_x u + n_y v - n_z) / d,  so  n is along (-dw/du, -dw/dv, w - u dw/du - v dw/dv),
//! facing the camera.
//!
//! Planes are therefore fitted to w, where the error of a disparity sensor is also uniform (its
//! steps in z grow with z^2). Two passes: a robust fit around every pixel, whose radius grows with
//! the noise; then each pixel takes the planes of the neighboring fits that predict its own depth,
//! the better fits counting more. Beside a crease these are the planes of its own side, so that
//! creases stay sharp at any radius. Errors that are smooth over many pixels are left to
//! `flatten_planes`.

use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::Camera;
use crate::image::{Depth, Normal, Plane, Points};
use crate::tuning::tuning;

/// The seen surface, estimated from a depth map.
pub struct Surface {
    /// Pixel centers on the surface; noise is smoothed away within its own size, exact depth is
    /// left exact.
    pub points: Points,
    /// Unit length, facing the camera.
    pub normal: Normal,
    /// Standard deviation of the inverse depth, 1/m: the depth of a point at z is uncertain by
    /// noise z^2.
    pub noise: f32,
}

tuning! {
    /// Constants of points and normals from a depth map.
    pub const TUNING: SurfaceTuning {
        /// Largest radius of a fit: a larger one costs more than it gains at working size.
        max_radius: usize = 8,
            unit "pixels", source Measured("run time; no page records it"),
            effect "a larger value smooths noisy depth more and takes longer";
        /// Residual below which rounding or slight curvature is assumed, not another surface.
        flatness: f32 = 2e-4,
            unit "fraction of the inverse depth", source Taste, effect "a larger value smooths fine relief";
        /// Least and largest depth of which the inverse is taken.
        depth_range: [f32; 2] = [1e-3, 1e6],
            unit "meters", source Derived("single precision"), effect "a narrower range cuts depth";
        /// Median of the absolute values of a normal distribution of standard deviation 1.
        noise_of_median: f32 = 0.6745,
            unit "1", source Derived("the normal distribution"), effect "a larger value estimates less noise";
        /// Standard deviation of the inverse depth up to which it counts as rounding.
        min_noise: f32 = 1e-5,
            unit "1 / meter", source Derived("rounding of 32-bit depth"),
            effect "a larger value trusts depth maps with little noise";
        /// Square of the radius of a fit over focal length times relative noise.
        radius_factor: f32 = 30.0,
            unit "1", source Derived("the normal is then uncertain by about 0.03"),
            effect "a larger value smooths more";
        /// Largest change of the inverse depth of a pixel by smoothing.
        smoothed: f32 = 2.0,
            unit "standard deviations of the noise", source Taste, effect "a larger value smooths outliers more";
        /// Scale of the Cauchy weights of a fit.
        fit_scale: f32 = 2.0,
            unit "standard deviations of the noise", source Taste, effect "a larger value lets outliers weigh more";
        /// Passes of a fit: least squares, then Cauchy weights.
        passes: i32 = 3,
            unit "passes", source Taste, effect "a larger value is slower and more robust";
        /// Relative difference of inverse depth above which a pixel lies on another surface.
        step: f32 = 0.12,
            unit "1", source Taste, effect "a larger value fits across steps";
        /// Determinant of the normal equations up to which they are singular.
        min_determinant: f32 = 1e-6,
            unit "cube of the sum of weights", source Derived("single precision"),
            effect "a larger value keeps the last plane more often";
    }
}

/// w = at + dx . (x - x0) + dy . (y - y0) around pixel (x0, y0), and how well it fits.
#[derive(Clone, Copy)]
struct LocalPlane {
    at: f32,
    dx: f32,
    dy: f32,
    /// Mean squared residual.
    residual: f32,
}

/// Points and normals of `depth`, which is seen by `camera` (of the same size).
pub fn surface(depth: &Depth, camera: &Camera) -> Surface {
    let (width, height) = depth.0.size();
    let inverse = depth.0.map(|z| 1.0 / z.clamp(TUNING.depth_range[0], TUNING.depth_range[1]));
    let noise = inverse_depth_noise(&inverse);
    let fits: Vec<LocalPlane> = per_pixel(width, height, |x, y| {
        fit(&inverse, x, y, radius(camera.fx, noise, inverse.get(x, y)), noise)
    });
    let smoothed: Vec<(Vec3, Vec3)> = per_pixel(width, height, |x, y| {
        let w = inverse.get(x, y);
        let (normal, smooth) =
            vote(&inverse, &fits, camera, x, y, radius(camera.fx, noise, w), noise);
        let w = smooth.clamp(w - TUNING.smoothed * noise, w + TUNING.smoothed * noise).max(1e-6);
        (camera.pixel_point(x, y, 1.0 / w), normal)
    });
    Surface {
        points: Points(Plane::new(width, height, smoothed.iter().map(|s| s.0).collect())),
        normal: Normal(Plane::new(width, height, smoothed.iter().map(|s| s.1).collect())),
        noise,
    }
}

fn per_pixel<T: Send>(
    width: usize,
    height: usize,
    value: impl Fn(usize, usize) -> T + Sync,
) -> Vec<T> {
    (0..width * height)
        .into_par_iter()
        .with_min_len(width.max(1))
        .map(|i| value(i % width, i / width))
        .collect()
}

/// Standard deviation of the inverse depth, from second differences: zero on planes, sqrt(6) sigma
/// under noise. The median passes over edges and creases; the largest of three strides sees the
/// steps of a quantized map too.
fn inverse_depth_noise(w: &Plane<f32>) -> f32 {
    let (width, height) = w.size();
    let of_stride = |stride: usize| {
        let mut second: Vec<f32> = Vec::with_capacity(2 * w.len());
        for y in 0..height {
            for x in 0..width {
                if x >= stride && x + stride < width {
                    second.push(
                        (w.get(x - stride, y) - 2.0 * w.get(x, y) + w.get(x + stride, y)).abs(),
                    );
                }
                if y >= stride && y + stride < height {
                    second.push(
                        (w.get(x, y - stride) - 2.0 * w.get(x, y) + w.get(x, y + stride)).abs(),
                    );
                }
            }
        }
        median(&mut second).unwrap_or(0.0)
    };
    let largest = [1, 2, 4].into_iter().map(of_stride).fold(0.0, f32::max);
    let sigma = largest / (TUNING.noise_of_median * 6f32.sqrt());
    // Rounding of 32-bit depth is not noise.
    if sigma.is_finite() && sigma > TUNING.min_noise { sigma } else { 0.0 }
}

/// The upper median; `None` without values.
pub(super) fn median(values: &mut [f32]) -> Option<f32> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// The slope of a fit over a (2r+1)^2 window is uncertain by sigma / (1.15 r^2) per pixel, the
/// normal by f z times that: this radius keeps it below about 0.03, were the noise of neighboring
/// pixels independent.
fn radius(focal: f32, noise: f32, w: f32) -> usize {
    ((TUNING.radius_factor * focal * noise / w).sqrt().ceil() as usize).clamp(1, TUNING.max_radius)
}

fn window(center: usize, radius: usize, size: usize) -> std::ops::Range<usize> {
    center.saturating_sub(radius)..(center + radius + 1).min(size)
}

/// A robust plane around one pixel: least squares, then twice again with Cauchy weights on the
/// residuals.
fn fit(inverse: &Plane<f32>, x0: usize, y0: usize, radius: usize, noise: f32) -> LocalPlane {
    let (width, height) = inverse.size();
    let center = inverse.get(x0, y0);
    let scale = TUNING.fit_scale * noise + TUNING.flatness * center;
    let mut plane = LocalPlane { at: center, dx: 0.0, dy: 0.0, residual: f32::INFINITY };
    for pass in 0..TUNING.passes {
        // Normal equations of (1, x, y), symmetric.
        let (mut s, mut sx, mut sy, mut sxx, mut sxy, mut syy) =
            (0.0f32, 0.0f32, 0.0f32, 0.0f32, 0.0f32, 0.0f32);
        let (mut b, mut bx, mut by, mut squares) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
        for y in window(y0, radius, height) {
            for x in window(x0, radius, width) {
                let (dx, dy) = (x as f32 - x0 as f32, y as f32 - y0 as f32);
                let w = inverse.get(x, y);
                let off = w - (plane.at + plane.dx * dx + plane.dy * dy);
                let weight = if pass == 0 {
                    // Another surface behind a depth step takes no part.
                    if off.abs() > TUNING.step * center.max(w) { continue } else { 1.0 }
                } else {
                    1.0 / (1.0 + (off / scale).powi(2))
                };
                let d = w - center;
                s += weight;
                sx += weight * dx;
                sy += weight * dy;
                sxx += weight * dx * dx;
                sxy += weight * dx * dy;
                syy += weight * dy * dy;
                b += weight * d;
                bx += weight * dx * d;
                by += weight * dy * d;
                squares += weight * off * off;
            }
        }
        if pass > 0 {
            plane.residual = squares / s;
        }
        let m = glam::Mat3::from_cols_array(&[s, sx, sy, sx, sxx, sxy, sy, sxy, syy]);
        if m.determinant().abs() > TUNING.min_determinant * s * s * s {
            let solved = m.inverse() * Vec3::new(b, bx, by);
            plane = LocalPlane { at: center + solved.x, dx: solved.y, dy: solved.z, ..plane };
        }
    }
    plane
}

/// The normal and inverse depth of one pixel from the fits around it.
fn vote(
    w: &Plane<f32>,
    fits: &[LocalPlane],
    camera: &Camera,
    x0: usize,
    y0: usize,
    radius: usize,
    noise: f32,
) -> (Vec3, f32) {
    let (width, height) = w.size();
    let center = w.get(x0, y0);
    let scale = noise + TUNING.flatness * center;
    let (mut normal, mut smooth, mut total) = (Vec3::ZERO, 0.0f32, 0.0f32);
    for y in window(y0, radius, height) {
        for x in window(x0, radius, width) {
            let fit = &fits[y * width + x];
            let (dx, dy) = (x0 as f32 - x as f32, y0 as f32 - y as f32);
            let predicted = fit.at + fit.dx * dx + fit.dy * dy;
            let off = (predicted - center) / scale;
            let quality = scale * scale / (scale * scale + fit.residual);
            let weight = quality * quality / (1.0 + off * off).powi(2);
            normal += weight * plane_normal(predicted, fit, camera, x0, y0);
            smooth += weight * predicted;
            total += weight;
        }
    }
    let own = &fits[y0 * width + x0];
    if total > 1e-6 && normal.length_squared() > 1e-12 * total * total {
        (normal.normalize(), smooth / total)
    } else {
        (plane_normal(own.at, own, camera, x0, y0), center)
    }
}

/// The normal of the plane with inverse depth `w` at pixel (x, y) and the slopes of `fit`, turned
/// to the camera.
fn plane_normal(w: f32, fit: &LocalPlane, camera: &Camera, x: usize, y: usize) -> Vec3 {
    let u = (x as f32 + 0.5 - camera.cx) / camera.fx;
    let v = (camera.cy - y as f32 - 0.5) / camera.fy;
    let (du, dv) = (fit.dx * camera.fx, -fit.dy * camera.fy);
    // n . (u, v, -1) = -w: it faces the camera wherever w is positive.
    Vec3::new(-du, -dv, w - u * du - v * dv).try_normalize().unwrap_or(Vec3::Z)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Depth of the plane n . P = d (n facing the camera, so d < 0).
    fn plane_depth(camera: &Camera, x: usize, y: usize, normal: Vec3, d: f32) -> f32 {
        d / normal.dot(camera.pixel_point(x, y, 1.0))
    }

    /// A corner of a room: a wall to the left and one at the back, meeting in a vertical crease.
    fn corner(camera: &Camera, x: usize, y: usize) -> (f32, Vec3) {
        let walls = [(Vec3::X, -1.0), (Vec3::new(-0.2, 0.1, 1.0).normalize(), -3.0)];
        let depths = walls.map(|(n, d)| (plane_depth(camera, x, y, n, d), n));
        depths.into_iter().filter(|(z, _)| *z > 0.0).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
    }

    fn mean_degrees(camera: &Camera, got: &Surface) -> f32 {
        let angle = |x, y| {
            let truth = corner(camera, x, y).1;
            got.normal.0.get(x, y).cross(truth).length().atan2(got.normal.0.get(x, y).dot(truth))
        };
        let sum: f32 = (0..camera.height)
            .flat_map(|y| (0..camera.width).map(move |x| (x, y)))
            .map(|(x, y)| angle(x, y))
            .sum();
        (sum / (camera.width * camera.height) as f32).to_degrees()
    }

    #[test]
    fn exact_depth_gives_exact_normals_up_to_the_crease() {
        let camera = Camera::from_fov_x(80, 60, 60.0);
        let depth = Depth(Plane::from_fn(80, 60, |x, y| corner(&camera, x, y).0));
        let got = surface(&depth, &camera);
        assert_eq!(got.noise, 0.0);
        assert!(mean_degrees(&camera, &got) < 0.2, "{}", mean_degrees(&camera, &got));
        let moved =
            got.points.0.pixels().iter().zip(depth.0.pixels()).map(|(p, z)| (p.z + z).abs() / z);
        assert!(moved.fold(0.0, f32::max) < 1e-5, "exact depth is left as it is");
    }

    #[test]
    fn steps_of_four_centimeters_are_smoothed() {
        let camera = Camera::from_fov_x(160, 120, 60.0);
        let depth = Depth(Plane::from_fn(160, 120, |x, y| {
            (corner(&camera, x, y).0 / 0.039).round() * 0.039
        }));
        let got = surface(&depth, &camera);
        // A plane through neighboring pixels would be off by 60 degrees at every step.
        assert!(mean_degrees(&camera, &got) < 6.0, "{}", mean_degrees(&camera, &got));
    }

    #[test]
    fn normals_are_unit_and_face_the_camera_whatever_the_depth() {
        let strange = [1e-30, 1e30, 0.5, 2.0, 70.0, 1.0, f32::MIN_POSITIVE];
        for (width, height) in [(0, 0), (1, 1), (1, 7), (7, 1), (13, 9)] {
            let depth =
                Depth(Plane::from_fn(width, height, |x, y| strange[(3 * x + 5 * y * y) % 7]));
            let camera = Camera { width, height, fx: 12.0, fy: 11.0, cx: 5.0, cy: 4.0 };
            let got = surface(&depth, &camera);
            for (n, p) in got.normal.0.pixels().iter().zip(got.points.0.pixels()) {
                assert!(p.is_finite() && (n.length() - 1.0).abs() < 1e-4, "{n} {p}");
                assert!(n.dot(p.normalize()) < 1e-3, "{n} {p}");
            }
        }
    }
}
