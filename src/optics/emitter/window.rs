//! The window: a rectangle through which a distant surrounding of three spherical Gaussians shines.

use std::f64::consts::PI;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::form::{Form, PreparedForm};
use super::rect_lamp::RectLamp;
use super::window_sampler::{PreparedWindow, Strategy};
use crate::optics::sampling::Lobe;
use crate::tuning::tuning;

/// The names of the lobes of a window, in their order.
pub const LOBES: [&str; 3] = ["sun", "sky", "ground"];

tuning! {
    /// Constants of windows: the surrounding whose sun is not visible, and the flux of a lobe.
    pub const TUNING: WindowTuning {
        /// Bandwidth of the sun's lobe.
        daylight_sun: f32 = 1e4,
            unit "1", source Taste, effect "another value changes the start of the fit of a window";
        /// Bandwidth of the sky's lobe.
        daylight_sky: f32 = 1.5,
            unit "1", source Taste, effect "another value changes the start of the fit of a window";
        /// Bandwidth of the ground's lobe.
        daylight_ground: f32 = 1.5,
            unit "1", source Taste, effect "another value changes the start of the fit of a window";
        /// Directions by which the flux of a lobe is summed.
        flux_samples: u32 = 4096,
            unit "directions", source Derived("a relative error below 1e-3"),
            effect "a smaller value makes the flux of windows less exact";
        /// Least bandwidth in that sum, below which a lobe is uniform.
        min_flux_bandwidth: f64 = 1e-4,
            unit "1", source Derived("single precision"),
            effect "a larger value makes the flux of broad lobes less exact";
    }
}

/// A rectangular opening in a wall; the room lies on the side to which `x cross y` points.
///
/// ```
/// use glam::Vec3;
/// use relight::optics::{Emitter, Shape, Window};
///
/// // A window of 2 m x 1 m in the wall behind the camera; the room lies at negative z.
/// let lobes = Window::daylight(Vec3::NEG_Z, Vec3::Y);
/// let window = Shape::Window(Window { center: Vec3::Z, x: Vec3::NEG_X, y: Vec3::Y * 0.5, lobes });
/// assert_eq!(window.lobes(), 3);
/// // The sky lights a floor below the window, and the ground lights a ceiling.
/// let emitter = Emitter::new(&window);
/// let [sun, sky, ground] = [0, 1, 2].map(|lobe| emitter.irradiance(lobe, Vec3::NEG_Y, Vec3::Y));
/// assert!(sky > ground && sun < sky);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Window {
    /// Camera space, meters.
    pub center: Vec3,
    /// Half edge, meters.
    pub x: Vec3,
    /// Half edge, meters, orthogonal to `x`.
    pub y: Vec3,
    /// Sun, sky, ground.
    pub lobes: [Lobe; 3],
}

impl Window {
    /// The lobes of a surrounding whose sun is not visible, for a window with the unit `normal`
    /// into the room and the unit vector `up`.
    ///
    /// The sun's lobe stands at half height; sky and ground are broad, above and below the outward
    /// normal.
    pub fn daylight(normal: Vec3, up: Vec3) -> [Lobe; 3] {
        let towards = |height: f32| (up * height - normal).try_normalize().unwrap_or(-normal);
        [
            Lobe { direction: towards(1.0), bandwidth: TUNING.daylight_sun },
            Lobe { direction: towards(1.0), bandwidth: TUNING.daylight_sky },
            Lobe { direction: towards(-1.0), bandwidth: TUNING.daylight_ground },
        ]
    }

    /// The radiance along unit `direction`, from the scene outwards, for one `radiance` per lobe,
    /// linear RGB.
    pub fn emitted(&self, radiance: &[Vec3], direction: Vec3) -> Vec3 {
        self.lobes
            .iter()
            .zip(radiance)
            .map(|(lobe, &w)| w * (lobe.bandwidth * (lobe.direction.dot(direction) - 1.0)).exp())
            .sum()
    }

    /// The rectangle of the window, which emits into the room.
    fn rect(&self) -> RectLamp {
        RectLamp { center: self.center, x: self.x, y: self.y }
    }

    /// The window with its center mapped by `position` and its lengths multiplied by `scale`.
    pub(super) fn transformed(&self, position: &dyn Fn(Vec3) -> Vec3, scale: f32) -> Window {
        let RectLamp { center, x, y } = self.rect().transformed(position, scale);
        Window { center, x, y, lobes: self.lobes }
    }

    /// The window prepared for sampling by `strategy`; `None` without area.
    pub(super) fn prepared(&self, strategy: Strategy) -> Option<PreparedWindow> {
        Some(PreparedWindow::new(self.rect().rectangle()?, &self.lobes, strategy))
    }
}

impl Form for Window {
    fn lobes(&self) -> usize {
        self.lobes.len()
    }

    fn area(&self) -> f32 {
        self.rect().area()
    }

    fn bounding_sphere(&self) -> Option<(Vec3, f32)> {
        self.rect().bounding_sphere()
    }

    fn extent(&self, direction: Vec3) -> f32 {
        self.rect().extent(direction)
    }

    fn intersect(&self, origin: Vec3, ray: Vec3) -> Option<f32> {
        self.rect().intersect(origin, ray)
    }

    fn emission(&self, lobe: usize, direction: Vec3) -> f32 {
        let Lobe { direction: peak, bandwidth } = self.lobes[lobe];
        (bandwidth * (peak.dot(direction) - 1.0)).exp()
    }

    /// For a lobe of bandwidth lambda and a window of area S and normal n into the room, S times
    /// the integral of exp(lambda (d . l - 1)) max(0, -n . l) over directions l. Zero where there
    /// is not such a lobe.
    fn flux(&self, lobe: usize) -> f32 {
        self.lobes.get(lobe).map_or(0.0, |lobe| lobe_flux(self, lobe))
    }

    fn triangles(&self) -> Vec<[Vec3; 3]> {
        self.rect().triangles()
    }

    fn prepare(&self) -> Option<Box<dyn PreparedForm>> {
        Some(Box::new(self.prepared(Strategy::default())?))
    }
}

/// [`Form::flux`] by directions distributed like the lobe itself, so that the sun's error is the
/// sky's.
fn lobe_flux(window: &Window, lobe: &Lobe) -> f32 {
    let (normal, area) = (window.x.cross(window.y), 4.0 * window.x.cross(window.y).length());
    let Some(normal) = normal.try_normalize() else { return 0.0 };
    let d = lobe.direction;
    let bandwidth = f64::from(lobe.bandwidth).max(TUNING.min_flux_bandwidth);
    let (s, t) = d.any_orthonormal_pair();
    let golden = PI * (3.0 - 5f64.sqrt());
    let cosine = |i: u32| {
        let u = (f64::from(i) + 0.5) / f64::from(TUNING.flux_samples);
        // 1 - cos of the angle to d, by the inverse of the distribution.
        let fall = -(u * (-2.0 * bandwidth).exp_m1()).ln_1p() / bandwidth;
        let sine = (fall * (2.0 - fall)).max(0.0).sqrt();
        let azimuth = golden * f64::from(i);
        let direction: Vec3 = s * (sine * azimuth.cos()) as f32
            + t * (sine * azimuth.sin()) as f32
            + d * (1.0 - fall) as f32;
        f64::from(-normal.dot(direction)).max(0.0)
    };
    let mean = (0..TUNING.flux_samples).map(cosine).sum::<f64>() / f64::from(TUNING.flux_samples);
    (f64::from(area) * mean * 2.0 * PI * -(-2.0 * bandwidth).exp_m1() / bandwidth) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flux_has_its_closed_forms() {
        let window = |direction: Vec3, bandwidth: f32| {
            let lobe = Lobe { direction, bandwidth };
            Window { center: Vec3::ZERO, x: Vec3::X, y: Vec3::Y * 0.5, lobes: [lobe; 3] }
        };
        // Uniform: the cosine over a hemisphere is pi. The area is 2 square meters, the room lies
        // at +z.
        assert!((window(Vec3::NEG_Z, 0.0).flux(1) / (2.0 * PI) as f32 - 1.0).abs() < 1e-3);
        // Narrow: all of its 2 pi / lambda comes in at its own cosine.
        let slant = Vec3::new(0.6, 0.0, -0.8);
        assert!(
            (window(slant, 1e4).flux(0) / (2.0 * 0.8 * 2.0 * PI / 1e4) as f32 - 1.0).abs() < 1e-3
        );
        // The flux of a sun is pi times its irradiance / pi on the opening of 2 square meters.
        for slant in [slant, Vec3::new(0.94, 0.0, -0.341).normalize()] {
            let sun = Lobe { direction: slant, bandwidth: 1e4 };
            let wanted = window(slant, 1e4).flux(0) / (2.0 * PI as f32);
            let got = sun.distant_irradiance(Vec3::NEG_Z);
            assert!((got / wanted - 1.0).abs() < 0.01, "{got} against {wanted}");
        }
        assert_eq!(window(Vec3::Z, 1e4).flux(0), 0.0, "from behind");
        assert_eq!(window(slant, 1e4).flux(3), 0.0, "there is not such a lobe");
    }
}
