//! The power that a light sends into the room.

use std::f64::consts::PI;

use glam::Vec3;

use crate::optics::{Lobe, Shape, Window, escaping};

/// Power per unit radiance of lobe `lobe`, square metres.
///
/// A lamp of area S sends pi S, less what its parts send to each other; a lobe of bandwidth lambda through a window of area S and normal n into the room sends S times the
/// integral of exp(lambda (d . l - 1)) max(0, -n . l) over directions l. Zero where there is no such lobe.
pub fn flux(shape: &Shape, lobe: usize) -> f32 {
    match shape {
        Shape::Absent => 0.0,
        Shape::Lamp(lamp) => std::f32::consts::PI * lamp.area() * escaping(lamp),
        Shape::Window(window) => window.lobes.get(lobe).map_or(0.0, |lobe| through(window, lobe)),
    }
}

/// Directions drawn evenly from the lobe itself, so that a sun is as exact as a sky.
fn through(window: &Window, lobe: &Lobe) -> f32 {
    const SAMPLES: u32 = 4096;
    let (normal, area) = (window.x.cross(window.y), 4.0 * window.x.cross(window.y).length());
    let Some(normal) = normal.try_normalize() else { return 0.0 };
    let d = lobe.direction;
    let bandwidth = f64::from(lobe.bandwidth).max(1e-4);
    let (s, t) = d.any_orthonormal_pair();
    let golden = PI * (3.0 - 5f64.sqrt());
    let cosine = |i: u32| {
        let u = (f64::from(i) + 0.5) / f64::from(SAMPLES);
        // 1 - cos of the angle to d, by the inverse of the distribution.
        let fall = -(u * (-2.0 * bandwidth).exp_m1()).ln_1p() / bandwidth;
        let sine = (fall * (2.0 - fall)).max(0.0).sqrt();
        let turn = golden * f64::from(i);
        let way: Vec3 = s * (sine * turn.cos()) as f32 + t * (sine * turn.sin()) as f32 + d * (1.0 - fall) as f32;
        f64::from(-normal.dot(way)).max(0.0)
    };
    let mean = (0..SAMPLES).map(cosine).sum::<f64>() / f64::from(SAMPLES);
    (f64::from(area) * mean * 2.0 * PI * -(-2.0 * bandwidth).exp_m1() / bandwidth) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Lamp;

    #[test]
    fn closed_forms() {
        let sphere = Shape::Lamp(Lamp::Sphere { center: Vec3::ZERO, radius: 0.5 });
        assert!((flux(&sphere, 0) / (PI * PI) as f32 - 1.0).abs() < 1e-6, "pi times 4 pi r^2");
        let window = |direction: Vec3, bandwidth: f32| {
            let lobe = Lobe { direction, bandwidth };
            Shape::Window(Window { center: Vec3::ZERO, x: Vec3::X, y: Vec3::Y * 0.5, lobes: [lobe; 3] })
        };
        // Uniform: the cosine over a hemisphere is pi. The area is 2 square metres, the room lies at +z.
        assert!((flux(&window(Vec3::NEG_Z, 0.0), 1) / (2.0 * PI) as f32 - 1.0).abs() < 1e-3);
        // Narrow: all of its 2 pi / lambda comes in at its own cosine.
        let slant = Vec3::new(0.6, 0.0, -0.8);
        assert!((flux(&window(slant, 1e4), 0) / (2.0 * 0.8 * 2.0 * PI / 1e4) as f32 - 1.0).abs() < 1e-3);
        assert_eq!(flux(&window(Vec3::Z, 1e4), 0), 0.0, "from behind");
        assert_eq!(flux(&Shape::Absent, 0), 0.0);
    }
}
