//! The surface of a lamp in view: what its shade or globe reflects of other light.

use glam::{DMat3, DVec3, Vec3};

use crate::image::{GlareMask, Plane, smooth_step};
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
        /// Fraction of the light of a shade that is switched on that its inside has scattered: it
        /// is alike everywhere.
        scattered: f32 = 0.5,
            unit "1", source Derived("a white inside of a shade, of albedo 0.5 to 0.7"),
            effect "a larger value makes the glow of such a shade flatter";
        /// Widths of rows, over the widest one, up to which they are a foot or a stem, and from
        /// which on they are the shade.
        stem: [f32; 2] = [0.3, 0.45],
            unit "1", source Measured("lamps of real photos switched on; by eye"),
            effect "larger values let wider feet stay dark";
        /// Least fraction of the rows of a lamp that are its foot or stem: fewer narrow ones are
        /// the ragged end of a mask.
        least_stem: f32 = 0.15,
            unit "1", source Measured("lamps of real photos switched on; by eye"),
            effect "a larger value lets short feet shine";
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
    /// Radiance of each row when the lamp is switched on, over the mean of the lamp's.
    glow: Vec<f32>,
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
        let inside: Vec<usize> =
            (0..w * h).filter(|i| mask.is_own(mask.pixel_at((i % w, i / w), (w, h)))).collect();
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
        let glow = glow(&rows);
        Some(LampSurface { top, rows, glow, shadings: planes.iter().map(fit).collect(), scale })
    }

    /// The values of all planes at a pixel of the photo.
    pub fn values(&self, (x, y): (usize, usize), values: &mut [Vec3]) {
        let at = |at: usize, scale: f32| (at as f32 + 0.5) * scale - 0.5;
        let (u, v) = (at(x, self.scale[0]), at(y, self.scale[1]));
        for (value, Affine { a, limits }) in values.iter_mut().zip(&self.shadings) {
            *value = (a[0] * u + a[1] * v + a[2]).clamp(limits[0], limits[1]);
        }
    }

    /// Radiance that a lamp that is switched on shows at a pixel of the photo, over the mean of its
    /// pixels.
    pub fn glow(&self, (_, y): (usize, usize)) -> f32 {
        self.glow[self.row(y)]
    }

    fn row(&self, y: usize) -> usize {
        y.saturating_sub(self.top).min(self.rows.len() - 1)
    }

    /// Fraction of the light of a surface that faces the camera that a pixel of the photo has.
    pub fn form(&self, (x, y): (usize, usize)) -> f32 {
        let [center, half] = self.rows[self.row(y)];
        let side = ((x as f32 + 0.5 - center) / half).clamp(-1.0, 1.0);
        let facing = (1.0 - side * side).sqrt();
        0.5 * (1.0 + facing) + 0.5 * (1.0 - facing) * TUNING.behind
    }
}

/// The radiance of each row of a lamp that is switched on, of mean 1 over its pixels.
///
/// A bulb stands in the middle of the shade, of radius R. At the height z from it, the shade gets
/// `R^3 / (R^2 + z^2)^(3/2)` of the light at its own height: the cosine law of a cylinder about a
/// point. Light that the inside has scattered is added, alike everywhere. Narrow rows are a foot or
/// a stem, which does not shine.
fn glow(rows: &[[f32; 2]]) -> Vec<f32> {
    let radius = rows.iter().fold(0.0, |most: f32, [_, half]| most.max(*half));
    let [from, to] = TUNING.stem.map(|share| share * radius);
    let narrow = rows.iter().filter(|[_, half]| *half < to).count() as f32;
    let has_stem = narrow >= TUNING.least_stem * rows.len() as f32;
    let shade = |half: f32| if has_stem { smooth_step(from, to, half) } else { 1.0 };
    let mean = |of: &dyn Fn(usize) -> f32| {
        let weights = || rows.iter().map(|[_, half]| half * shade(*half));
        weights().enumerate().map(|(y, weight)| of(y) * weight).sum::<f32>()
            / weights().sum::<f32>()
    };
    let bulb = mean(&|y| y as f32);
    let direct = |y: usize| (1.0 + ((y as f32 - bulb) / radius).powi(2)).powf(-1.5);
    let scattered = mean(&direct) * TUNING.scattered / (1.0 - TUNING.scattered);
    let row = |y: usize| shade(rows[y][1]) * (direct(y) + scattered);
    let total: f32 = rows.iter().enumerate().map(|(y, [_, half])| half * row(y)).sum();
    let width: f32 = rows.iter().map(|[_, half]| half).sum();
    (0..rows.len()).map(|y| row(y) * width / total).collect()
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
    fn a_shade_glows_most_at_its_bulb_and_its_foot_does_not() {
        // A cylinder of 21 x 40 pixels on a foot of 5 x 10.
        let own = mask(80, 60, |x, y| {
            x.abs_diff(40) <= 10 && (5..45).contains(&y)
                || x.abs_diff(40) <= 2 && (45..55).contains(&y)
        });
        let plane = Plane::filled(80, 60, Vec3::ONE);
        let surface = LampSurface::new(&own, &[&plane]).expect("large enough");
        let glow = |y: usize| surface.glow((40, y));
        assert_eq!(glow(52), 0.0);
        // Of the direct light, (1 + (19 / 10.5)^2)^(-3/2) is left at the upper end.
        let (middle, end) = (glow(24), glow(5));
        let direct = |z: f32| (1.0 + (z / 10.5).powi(2)).powf(-1.5);
        let mean = (0..40).map(|y| direct(y as f32 - 19.5)).sum::<f32>() / 40.0;
        let want = (direct(19.5) + mean) / (direct(0.5) + mean);
        assert!((end / middle / want - 1.0).abs() < 0.05, "{end} of {middle}, wanted {want}");
        let pixels = (0..80 * 60).filter(|&i| own.is_own(i));
        let (count, sum) = pixels.fold((0, 0.0), |(n, sum), i| (n + 1, sum + glow(i / 80)));
        assert!((sum / count as f32 - 1.0).abs() < 0.03, "{sum} of {count} pixels");
    }

    #[test]
    fn a_lamp_of_few_pixels_has_no_surface_of_its_own() {
        let plane = Plane::filled(40, 30, Vec3::ONE);
        assert!(LampSurface::new(&mask(80, 60, |x, y| x < 2 && y < 2), &[&plane]).is_none());
        assert!(LampSurface::new(&mask(80, 60, |_, _| false), &[&plane]).is_none());
        assert!(LampSurface::new(&mask(80, 60, |_, _| true), &[]).is_none());
    }
}
