//! A plane through noisy points.

use glam::Vec3;

use crate::tuning::tuning;

tuning! {
    /// Constants of planes through noisy points.
    pub const TUNING: PlaneFitTuning {
        /// Cosine between the normals of a point and of the plane that must be exceeded.
        same_normal: f32 = 0.85,
            unit "1", source Taste, effect "a larger value leaves more points out";
        /// Largest number of points whose planes are tried.
        max_tries: usize = 200,
            unit "planes", source Measured("run time; no page records it"),
            effect "a larger value is slower and finds smaller planes";
        /// Times that the plane becomes the mean of its supporters.
        means: usize = 2,
            unit "times", source Taste, effect "a larger value is slower and more exact";
    }
}

/// The plane `normal . p = offset`; `normal` has unit length and faces the camera at the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneFit {
    /// Unit normal, facing the camera.
    pub normal: Vec3,
    /// Signed distance of the plane from the origin along `normal`, meters; not above 0.
    pub offset: f32,
    /// Share of the points within the tolerance.
    pub support: f32,
    /// Root mean square distance of those points, meters.
    pub spread: f32,
}

impl PlaneFit {
    /// The plane that most of `points` lie on, to `tolerance` times their distance from the camera;
    /// `normals` belong to the points. `None` for fewer than three points or when no three of them
    /// span a plane.
    ///
    /// Random sample consensus (Fischler and Bolles 1981) over the points' own planes, taken at
    /// even steps instead of at random, so that the same points give the same plane; then the mean
    /// of the supporters.
    pub fn through(points: &[Vec3], normals: &[Vec3], tolerance: f32) -> Option<PlaneFit> {
        if points.len() < 3 {
            return None;
        }
        let supports = |normal: Vec3, offset: f32, i: usize| {
            (normal.dot(points[i]) - offset).abs() < tolerance * points[i].length()
                && normals[i].dot(normal) > TUNING.same_normal
        };
        let own = |i: usize| Some((normals[i], normals[i].dot(points[i])));
        let (mut normal, mut offset) =
            most_supported(points.len(), TUNING.max_tries, own, |&(n, d), i| supports(n, d, i))?;
        let mut spread = 0.0;
        let mut count = 0;
        for _ in 0..TUNING.means {
            let inside: Vec<usize> =
                (0..points.len()).filter(|&i| supports(normal, offset, i)).collect();
            count = inside.len();
            if count < 3 {
                return None;
            }
            normal = inside.iter().map(|&i| normals[i]).sum::<Vec3>().try_normalize()?;
            offset = inside.iter().map(|&i| normal.dot(points[i])).sum::<f32>() / count as f32;
            let squares: f32 =
                inside.iter().map(|&i| (normal.dot(points[i]) - offset).powi(2)).sum();
            spread = (squares / count as f32).sqrt();
        }
        let sign = if offset > 0.0 { -1.0 } else { 1.0 };
        Some(PlaneFit {
            normal: normal * sign,
            offset: offset * sign,
            support: count as f32 / points.len() as f32,
            spread,
        })
    }

    /// [`PlaneFit::through`] of the `points` and `normals` of some pixels; of more than
    /// `max_points`, every nth is taken.
    pub fn of_pixels(
        pixels: &[usize],
        (points, normals): (&[Vec3], &[Vec3]),
        max_points: usize,
        tolerance: f32,
    ) -> Option<PlaneFit> {
        let some = pixels.iter().step_by(pixels.len().div_ceil(max_points).max(1));
        let (points, normals): (Vec<Vec3>, Vec<Vec3>) =
            some.map(|&i| (points[i], normals[i])).unzip();
        PlaneFit::through(&points, &normals, tolerance)
    }

    /// Distance of a point from the plane, meters.
    pub fn distance(&self, point: Vec3) -> f32 {
        (self.normal.dot(point) - self.offset).abs()
    }

    /// Whether a point lies on the plane, to `tolerance` times its distance from the camera.
    pub fn contains(&self, point: Vec3, tolerance: f32) -> bool {
        self.distance(point) < tolerance * point.length()
    }

    /// The intersection of the ray from the camera along `direction` with the plane, in front of
    /// the camera; `None` without one.
    pub fn intersect(&self, direction: Vec3) -> Option<Vec3> {
        let t = self.offset / self.normal.dot(direction);
        (t.is_finite() && t > 0.0).then(|| direction * t)
    }
}

/// The model that most of `count` members support, among those of at most `tries` members at even
/// steps: random sample consensus without chance. The first of several; `None` without a model.
pub(super) fn most_supported<T>(
    count: usize,
    tries: usize,
    model: impl Fn(usize) -> Option<T>,
    supports: impl Fn(&T, usize) -> bool,
) -> Option<T> {
    let tries = count.min(tries);
    let models = (0..tries).filter_map(|t| model(t * count / tries));
    let counted = models.map(|model| ((0..count).filter(|&i| supports(&model, i)).count(), model));
    counted.reduce(|a, b| if b.0 > a.0 { b } else { a }).map(|(_, model)| model)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_with_clutter_before_it_is_found() {
        let normal = Vec3::new(0.3, 0.1, 0.9).normalize();
        let mut points = Vec::new();
        for i in 0..200 {
            let direction =
                Vec3::new((i % 20) as f32 / 20.0 - 0.5, (i / 20) as f32 / 20.0 - 0.25, -1.0);
            points.push(direction * (-3.0 / normal.dot(direction)));
        }
        let mut normals = vec![normal; 200];
        for i in (0..200).step_by(3) {
            points[i] *= 0.7;
            normals[i] = Vec3::X;
        }
        let plane = PlaneFit::through(&points, &normals, 0.02).expect("a plane");
        assert!(
            plane.normal.dot(normal) > 0.9999 && (plane.offset + 3.0).abs() < 1e-3,
            "{plane:?}"
        );
        let met = plane.intersect(Vec3::new(0.1, 0.1, -1.0)).expect("in front");
        assert!((normal.dot(met) + 3.0).abs() < 1e-3);
        assert!(plane.intersect(Vec3::Z).is_none());
        assert!(plane.contains(met, 1e-3) && !plane.contains(0.7 * met, 0.1));
    }

    #[test]
    fn too_few_points_are_no_plane() {
        assert!(PlaneFit::through(&[Vec3::ONE; 2], &[Vec3::Z; 2], 0.1).is_none());
    }
}
