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

use fearless_simd::{Level, Simd, dispatch, f32x8, prelude::*};
use glam::{Mat3, Vec3};
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

/// Pixels of a row that are computed side by side.
const LANES: usize = 8;
type Lanes = [f32; LANES];

/// `planes` planes of one size, row by row. Zeros frame each row, so that windows of [`LANES`]
/// pixels do not end within.
struct Framed {
    planes: usize,
    stride: usize,
    values: Vec<f32>,
}

impl Framed {
    fn zeros(planes: usize, (width, height): (usize, usize)) -> Framed {
        let stride = width.next_multiple_of(LANES) + 2 * TUNING.max_radius;
        Framed { planes, stride, values: vec![0.0; planes * stride * height] }
    }

    fn new(plane: &Plane<f32>) -> Framed {
        let mut framed = Framed::zeros(1, plane.size());
        let rows = plane.pixels().chunks(plane.width().max(1));
        for (to, row) in framed.values.chunks_mut(framed.stride).zip(rows) {
            to[TUNING.max_radius..][..row.len()].copy_from_slice(row);
        }
        framed
    }

    /// The values of a plane from pixel (x + right - `max_radius`, y) on.
    #[inline(always)]
    fn at(&self, plane: usize, (x, right): (usize, usize), y: usize) -> &[f32] {
        &self.values[(y * self.planes + plane) * self.stride + x + right..][..LANES]
    }

    /// The rows of all planes, and their numbers.
    fn rows_mut(&mut self) -> impl IndexedParallelIterator<Item = (usize, Vec<&mut [f32]>)> {
        let (stride, inner) = (self.stride, TUNING.max_radius);
        let rows = self.values.par_chunks_mut(self.planes * stride).enumerate();
        rows.map(move |(y, row)| (y, row.chunks_mut(stride).map(|row| &mut row[inner..]).collect()))
    }
}

/// The inverse depth w, and what else a window around a pixel needs. A plane is
/// w = at + dx . (x - x0) + dy . (y - y0) around pixel (x0, y0).
struct InverseDepth<'a> {
    w: Framed,
    size: (usize, usize),
    camera: &'a Camera,
    noise: f32,
}

/// Points and normals of `depth`, which is seen by `camera` (of the same size).
pub fn surface(depth: &Depth, camera: &Camera) -> Surface {
    let size @ (width, height) = depth.0.size();
    let inverse = depth.0.map(|z| 1.0 / z.clamp(TUNING.depth_range[0], TUNING.depth_range[1]));
    let noise = inverse_depth_noise(&inverse);
    let seen = InverseDepth { w: Framed::new(&inverse), size, camera, noise };
    let level = Level::new();
    let mut fits = Framed::zeros(4, size);
    fits.rows_mut().for_each(|(y, mut planes)| {
        for x in (0..width).step_by(LANES) {
            let fitted = dispatch!(level, simd => seen.fit(simd, x, y));
            planes
                .iter_mut()
                .zip(fitted)
                .for_each(|(row, of)| row[x..x + LANES].copy_from_slice(&of));
        }
    });
    let mut smoothed = vec![(Vec3::ZERO, Vec3::ZERO); width * height];
    smoothed.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, row)| {
        for (i, row) in row.chunks_mut(LANES).enumerate() {
            let (normals, depths) = dispatch!(level, simd => seen.vote(simd, &fits, i * LANES, y));
            for (lane, to) in row.iter_mut().enumerate() {
                let (x, [nx, ny, nz]) = (i * LANES + lane, normals.map(|of| of[lane]));
                let w = inverse.get(x, y);
                let most = TUNING.smoothed * noise;
                let w = depths[lane].clamp(w - most, w + most).max(1e-6);
                *to = (camera.pixel_point(x, y, 1.0 / w), Vec3::new(nx, ny, nz));
            }
        }
    });
    Surface {
        points: Points(Plane::new(width, height, smoothed.iter().map(|s| s.0).collect())),
        normal: Normal(Plane::new(width, height, smoothed.iter().map(|s| s.1).collect())),
        noise,
    }
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

impl InverseDepth<'_> {
    /// The radii of pixels (x, y) to (x + `LANES` - 1, y), and the largest of them; 0 beyond the
    /// border.
    #[inline(always)]
    fn radii(&self, x: usize, y: usize) -> (Lanes, usize) {
        let (mut radii, mut largest) = ([0.0; LANES], 0);
        let inside = LANES.min(self.size.0 - x);
        let w = &self.w.at(0, (x, TUNING.max_radius), y)[..inside];
        for (to, &w) in radii.iter_mut().zip(w) {
            let radius = radius(self.camera.fx, self.noise, w);
            largest = largest.max(radius);
            *to = radius as f32;
        }
        (radii, largest)
    }

    /// Robust planes around pixels (x0, y0) to (x0 + `LANES` - 1, y0): least squares, then twice
    /// again with Cauchy weights on the residuals. Their `at`, `dx`, `dy` and mean squared
    /// residuals.
    #[inline(always)]
    fn fit<S: Simd>(&self, simd: S, x0: usize, y0: usize) -> [Lanes; 4] {
        let splat = |value: f32| f32x8::splat(simd, value);
        let (radii, reach) = self.radii(x0, y0);
        let radii = f32x8::simd_from(simd, radii);
        let load = |right, y| f32x8::from_slice(simd, self.w.at(0, (x0, right), y));
        let center = load(TUNING.max_radius, y0);
        let scale = splat(TUNING.fit_scale * self.noise) + splat(TUNING.flatness) * center;
        let (zero, one) = (splat(0.0), splat(1.0));
        let (mut at, mut slope, mut residual) = (center, [zero; 2], splat(f32::INFINITY));
        for pass in 0..TUNING.passes {
            // Normal equations of (1, x, y), symmetric; their right side; squares of residuals.
            let mut m = [zero; 6];
            let mut b = [zero; 3];
            let mut squares = zero;
            for y in window(y0, reach, self.size.1) {
                let dy = splat(y as f32 - y0 as f32);
                let in_column = dy.abs().simd_le(radii);
                for right in TUNING.max_radius - reach..=TUNING.max_radius + reach {
                    let dx = splat(right as f32 - TUNING.max_radius as f32);
                    let w = load(right, y);
                    let off = w - (at + slope[0] * dx + slope[1] * dy);
                    let mut inside = in_column & dx.abs().simd_le(radii) & w.simd_gt(zero);
                    let weight = if pass == 0 {
                        // Another surface behind a depth step takes no part.
                        inside &= off.abs().simd_le(splat(TUNING.step) * center.max(w));
                        one
                    } else {
                        let relative = off / scale;
                        one / (one + relative * relative)
                    };
                    let weight = inside.select(weight, zero);
                    let (wx, wy, d) = (weight * dx, weight * dy, w - center);
                    m = add(m, [weight, wx, wy, wx * dx, wx * dy, wy * dy]);
                    b = add(b, [weight * d, wx * d, wy * d]);
                    squares += weight * off * off;
                }
            }
            if pass > 0 {
                residual = squares / m[0];
            }
            let (m, b) = (m.map(Lanes::from), b.map(Lanes::from));
            let (mut solved, mut dx, mut dy) =
                (Lanes::from(at), Lanes::from(slope[0]), Lanes::from(slope[1]));
            let center = Lanes::from(center);
            for lane in 0..LANES {
                let [s, sx, sy, sxx, sxy, syy] = m.map(|of| of[lane]);
                let m = Mat3::from_cols_array(&[s, sx, sy, sx, sxx, sxy, sy, sxy, syy]);
                if m.determinant().abs() > TUNING.min_determinant * s * s * s {
                    let plane = m.inverse() * Vec3::from_array(b.map(|of| of[lane]));
                    (solved[lane], dx[lane], dy[lane]) = (center[lane] + plane.x, plane.y, plane.z);
                }
            }
            at = f32x8::simd_from(simd, solved);
            slope = [dx, dy].map(|of| f32x8::simd_from(simd, of));
        }
        [at, slope[0], slope[1], residual].map(Lanes::from)
    }

    /// The normals and inverse depths of pixels (x0, y0) to (x0 + `LANES` - 1, y0) from the planes
    /// of [`fit`](Self::fit) around them.
    #[inline(always)]
    fn vote<S: Simd>(&self, simd: S, fits: &Framed, x0: usize, y0: usize) -> ([Lanes; 3], Lanes) {
        let splat = |value: f32| f32x8::splat(simd, value);
        let (radii, reach) = self.radii(x0, y0);
        let radii = f32x8::simd_from(simd, radii);
        let load = |right, y| f32x8::from_slice(simd, self.w.at(0, (x0, right), y));
        let center = load(TUNING.max_radius, y0);
        let scale = splat(self.noise) + splat(TUNING.flatness) * center;
        let (zero, one) = (splat(0.0), splat(1.0));
        let (mut normal, mut smooth, mut total) = ([zero; 3], zero, zero);
        let plane =
            |right, y| [0, 1, 2, 3].map(|k| f32x8::from_slice(simd, fits.at(k, (x0, right), y)));
        for y in window(y0, reach, self.size.1) {
            let dy = splat(y0 as f32 - y as f32);
            let in_column = dy.abs().simd_le(radii);
            for right in TUNING.max_radius - reach..=TUNING.max_radius + reach {
                let dx = splat(TUNING.max_radius as f32 - right as f32);
                let [at, slope_x, slope_y, residual] = plane(right, y);
                let predicted = at + slope_x * dx + slope_y * dy;
                let off = (predicted - center) / scale;
                let quality = scale * scale / (scale * scale + residual);
                let spread = one + off * off;
                let weight = quality * quality / (spread * spread);
                let inside = in_column & dx.abs().simd_le(radii) & load(right, y).simd_gt(zero);
                let weight = inside.select(weight, zero);
                let of_plane = self.normals(simd, predicted, [slope_x, slope_y], x0, y0);
                normal = add(normal, of_plane.map(|n| weight * n));
                smooth += weight * predicted;
                total += weight;
            }
        }
        let [at, slope_x, slope_y, _] = plane(TUNING.max_radius, y0);
        let own = self.normals(simd, at, [slope_x, slope_y], x0, y0);
        let square = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2];
        let agreed = total.simd_gt(splat(1e-6)) & square.simd_gt(splat(1e-12) * total * total);
        let inverse = one / square.sqrt();
        let normals = [0, 1, 2].map(|k| agreed.select(normal[k] * inverse, own[k]));
        (normals.map(Lanes::from), agreed.select(smooth / total, center).into())
    }

    /// The normals of the planes with inverse depth `w` and these slopes at pixels (x, y) to
    /// (x + `LANES` - 1, y), turned to the camera.
    #[inline(always)]
    fn normals<S: Simd>(
        &self,
        simd: S,
        w: f32x8<S>,
        [dx, dy]: [f32x8<S>; 2],
        x: usize,
        y: usize,
    ) -> [f32x8<S>; 3] {
        let splat = |value: f32| f32x8::splat(simd, value);
        let camera = self.camera;
        let column: Lanes =
            std::array::from_fn(|lane| ((x + lane) as f32 + 0.5 - camera.cx) / camera.fx);
        let u = f32x8::simd_from(simd, column);
        let v = splat((camera.cy - y as f32 - 0.5) / camera.fy);
        let (du, dv) = (dx * splat(camera.fx), -(dy * splat(camera.fy)));
        // n . (u, v, -1) = -w: it faces the camera wherever w is positive.
        let n = [-du, -dv, w - u * du - v * dv];
        let inverse = splat(1.0) / (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
        let is_finite = inverse.simd_gt(splat(0.0)) & inverse.simd_lt(splat(f32::INFINITY));
        let axis = [0.0, 0.0, 1.0].map(splat);
        [0, 1, 2].map(|k| is_finite.select(n[k] * inverse, axis[k]))
    }
}

#[inline(always)]
fn add<S: Simd, const N: usize>(mut sums: [f32x8<S>; N], terms: [f32x8<S>; N]) -> [f32x8<S>; N] {
    sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
    sums
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
    fn a_pixel_has_the_same_depth_in_each_lane() {
        // The noise repeats after nine columns: the next lane.
        let noisy = |x, y| 2.0 + 0.01 * y as f32 + 0.03 * ((7 * (x % 9) + 5 * y * y) % 11) as f32;
        let camera = Camera::from_fov_x(96, 20, 60.0);
        let got = surface(&Depth(Plane::from_fn(96, 20, noisy)), &camera);
        let depth = |x, y| got.points.0.get(x, y).z;
        for (x, y) in (24..56).flat_map(|x| (0..20).map(move |y| (x, y))) {
            assert_ne!(-depth(x, y), noisy(x, y), "it is smoothed");
            assert_eq!(depth(x, y), depth(x + 9, y), "({x}, {y})");
        }
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
