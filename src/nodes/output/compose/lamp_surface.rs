//! The surface of a lamp in view: what its shade or globe reflects of other light.

use glam::{DMat3, DVec3, Vec3};

use crate::image::{GlareMask, Plane};
use crate::tuning::tuning;

tuning! {
    /// Constants of the surface of a lamp in view.
    pub const TUNING: LampSurfaceTuning {
        /// Least number of working pixels of a lamp whose shading is a plane of its own.
        min_pixels: usize = 6,
            unit "working pixels", source Derived("twice the unknowns of a plane"),
            effect "a larger value leaves small lamps to the depth map";
        /// Light that arrives from behind a lamp, over that from before it.
        behind: f32 = 0.4,
            unit "1", source Taste, effect "a larger value makes a lamp that is off look flatter";
        /// Rows over which the outline of a lamp is averaged, over its height.
        outline: f32 = 0.1,
            unit "1", source Taste, effect "a larger value rounds the outline of ragged masks more";
    }
}

/// The shadings of a lamp's surface.
///
/// A depth map is unreliable at lamps: sensors fail at them, and normals follow its noise. So each
/// shading is affine in the picture over the lamp, by least squares, within its least and largest
/// value. The lamp is round about an upright axis: at its outline half of the light comes from
/// behind.
pub struct LampSurface {
    /// First row of the photo in which the lamp is.
    top: usize,
    /// Center and half of the width of the lamp in each row, photo pixels.
    rows: Vec<[f32; 2]>,
    /// The fit to each working plane.
    shadings: Vec<Affine>,
    /// Working pixels per photo pixel.
    scale: [f32; 2],
}

/// A value a . (x, y, 1) at a working pixel, within limits.
struct Affine {
    a: [Vec3; 3],
    limits: [Vec3; 2],
}

impl LampSurface {
    /// The surface of the lamp with the own pixels of `mask`, from planes of working size; `None`
    /// for a lamp of few pixels.
    pub fn new(mask: &GlareMask, planes: &[&Plane<Vec3>]) -> Option<LampSurface> {
        let (width, height) = mask.size();
        let (w, h) = planes.first()?.size();
        let inside: Vec<usize> = (0..w * h)
            .filter(|i| {
                let (x, y) = (i % w, i / w);
                mask.is_own((2 * y + 1) * height / (2 * h) * width + (2 * x + 1) * width / (2 * w))
            })
            .collect();
        if inside.len() < TUNING.min_pixels {
            return None;
        }
        let (top, rows) = outline(mask);
        let place = |i: usize| DVec3::new((i % w) as f64, (i / w) as f64, 1.0);
        let moments = inside.iter().map(|&i| outer(place(i), place(i)));
        let inverse = moments.fold(DMat3::ZERO, |sum, m| sum + m).inverse();
        let fit = |plane: &&Plane<Vec3>| {
            let values = || inside.iter().map(|&i| plane.pixels()[i]);
            let sums = inside.iter().map(|&i| outer(plane.pixels()[i].as_dvec3(), place(i)));
            let a = sums.fold(DMat3::ZERO, |sum, m| sum + m) * inverse;
            let mean = values().sum::<Vec3>() / inside.len() as f32;
            let a = match a.is_finite() {
                true => [a.x_axis, a.y_axis, a.z_axis].map(|a| a.as_vec3()),
                false => [Vec3::ZERO, Vec3::ZERO, mean],
            };
            let limits = [values().fold(mean, Vec3::min), values().fold(mean, Vec3::max)];
            Affine { a, limits }
        };
        let scale = [w as f32 / width as f32, h as f32 / height as f32];
        Some(LampSurface { top, rows, shadings: planes.iter().map(fit).collect(), scale })
    }

    /// The values of all planes at a pixel of the photo.
    pub fn values(&self, (x, y): (usize, usize), values: &mut [Vec3]) {
        let at = |at: usize, scale: f32| (at as f32 + 0.5) * scale - 0.5;
        let (u, v) = (at(x, self.scale[0]), at(y, self.scale[1]));
        for (value, Affine { a, limits }) in values.iter_mut().zip(&self.shadings) {
            *value = (a[0] * u + a[1] * v + a[2]).clamp(limits[0], limits[1]);
        }
    }

    /// Fraction of the light of a surface that faces the camera that a pixel of the photo has.
    pub fn form(&self, (x, y): (usize, usize)) -> f32 {
        let row = y.saturating_sub(self.top).min(self.rows.len() - 1);
        let [center, half] = self.rows[row];
        let side = ((x as f32 + 0.5 - center) / half).clamp(-1.0, 1.0);
        let facing = (1.0 - side * side).sqrt();
        0.5 * (1.0 + facing) + 0.5 * (1.0 - facing) * TUNING.behind
    }
}

/// The matrix a b^T.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// The first row of a lamp, and the center and half width of its own pixels in each row from there
/// on, averaged over neighboring rows.
fn outline(mask: &GlareMask) -> (usize, Vec<[f32; 2]>) {
    let (width, height) = mask.size();
    let ends = |y: usize| {
        let own = |x: &usize| mask.is_own(y * width + x);
        Some([(0..width).find(own)? as f32, (0..width).rfind(own)? as f32 + 1.0])
    };
    let rows: Vec<(usize, [f32; 2])> = (0..height).filter_map(|y| Some((y, ends(y)?))).collect();
    let (Some(top), Some(bottom)) = (rows.first(), rows.last()) else { return (0, vec![]) };
    let (top, reach) = (top.0, 0.5 * TUNING.outline * (bottom.0 + 1 - top.0) as f32);
    let average = |y: usize| {
        let near = rows.iter().filter(|(row, _)| (row.abs_diff(y) as f32) <= reach.max(0.5));
        // A row without own pixels takes the nearest one's.
        let near: Vec<[f32; 2]> = match near.map(|(_, ends)| *ends).collect::<Vec<_>>() {
            near if near.is_empty() => rows
                .iter()
                .min_by_key(|(row, _)| row.abs_diff(y))
                .map(|(_, e)| *e)
                .into_iter()
                .collect(),
            near => near,
        };
        let mean = |k: usize| near.iter().map(|ends| ends[k]).sum::<f32>() / near.len() as f32;
        [0.5 * (mean(0) + mean(1)), (0.5 * (mean(1) - mean(0))).max(0.5)]
    };
    (top, (top..=bottom.0).map(average).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Mask, Picture};

    fn mask(width: usize, height: usize, own: impl Fn(usize, usize) -> bool) -> GlareMask {
        let photo = Picture(Plane::filled(width, height, Vec3::ONE));
        let own = Plane::from_fn(width, height, |x, y| f32::from(u8::from(own(x, y))));
        GlareMask::of_window(&own, &photo, &Mask(Plane::filled(width, height, 1.0)), 1.0)
    }

    #[test]
    fn a_gradient_stays_and_a_tear_goes() {
        let own = mask(80, 60, |x, y| (20..60).contains(&x) && (10..50).contains(&y));
        let ramp = Plane::from_fn(40, 30, |x, y| Vec3::new(x as f32, y as f32, 1.0) / 40.0);
        // The depth map tears the lamp in two halves, with noise on one of them.
        let torn = Plane::from_fn(40, 30, |x, y| {
            Vec3::splat(if x < 20 { 0.2 } else { 0.4 + 0.1 * ((x * 5 + y * 3) % 7) as f32 / 7.0 })
        });
        let surface = LampSurface::new(&own, &[&ramp, &torn]).expect("large enough");
        let at = |x: usize, y: usize| {
            let mut values = [Vec3::ZERO; 2];
            surface.values((x, y), &mut values);
            values
        };
        for (x, y) in [(21, 11), (40, 30), (58, 48)] {
            let want = Vec3::new((x as f32 + 0.5) / 2.0 - 0.5, (y as f32 + 0.5) / 2.0 - 0.5, 1.0);
            let want = (want / 40.0).clamp(ramp.get(10, 5), ramp.get(29, 24));
            assert!((at(x, y)[0] - want).abs().max_element() < 1e-4, "{x} {y}: {:?}", at(x, y));
        }
        let steps = (21..59).map(|x| (at(x + 1, 30)[1] - at(x, 30)[1]).abs().max_element());
        assert!(steps.fold(0.0, f32::max) < 0.02, "no step is left");
        let range = [0.2, 0.5].map(Vec3::splat);
        assert!(
            (0..80)
                .all(|x| at(x, 30)[1].cmpge(range[0]).all() && at(x, 30)[1].cmple(range[1]).all())
        );
    }

    #[test]
    fn a_shade_is_darker_at_its_outline() {
        // A cone, wider below, with a ragged edge.
        let own = mask(80, 60, |x, y| {
            let half = 10 + y / 4 + (y * 7) % 3;
            (10..50).contains(&y) && x.abs_diff(40) <= half
        });
        let plane = Plane::filled(80, 60, Vec3::ONE);
        let surface = LampSurface::new(&own, &[&plane]).expect("large enough");
        for y in [12, 30, 47] {
            let half = 11 + y / 4;
            let [left, middle, right] = [40 - half, 40, 40 + half].map(|x| surface.form((x, y)));
            assert!(middle > 0.999, "{middle}");
            // Seven tenths of the light are left where half of it comes from behind.
            let outline = 0.5 * (1.0 + TUNING.behind);
            assert!(
                (left - outline).abs() < 0.15 && (right - outline).abs() < 0.15,
                "{left} {right}"
            );
            let row: Vec<f32> = (40..40 + half).map(|x| surface.form((x, y))).collect();
            assert!(row.windows(2).all(|pair| pair[1] <= pair[0]), "{row:?}");
        }
    }

    #[test]
    fn a_lamp_of_few_pixels_has_no_surface_of_its_own() {
        let plane = Plane::filled(40, 30, Vec3::ONE);
        assert!(LampSurface::new(&mask(80, 60, |x, y| x < 2 && y < 2), &[&plane]).is_none());
        assert!(LampSurface::new(&mask(80, 60, |_, _| false), &[&plane]).is_none());
        assert!(LampSurface::new(&mask(80, 60, |_, _| true), &[]).is_none());
    }
}
