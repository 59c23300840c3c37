//! The color of a black body.

use glam::Vec3;

use crate::image::luminance;

/// The linear Rec.709 color of a black body at `kelvin`, of luminance 1; 1667 K to 25000 K, nearer
/// ends outside.
///
/// Chromaticity by the cubic fit of Kim et al. (US patent 7024034, 2002) to the Planckian locus;
/// the white of the photo is taken as D65, so 6500 K is close to (1, 1, 1). Colors outside Rec.709
/// (below about 1900 K) lose their negative part.
pub fn black_body(kelvin: f32) -> Vec3 {
    let t = f64::from(kelvin).clamp(1667.0, 25000.0);
    let (a, b, c) = (1e9 / (t * t * t), 1e6 / (t * t), 1e3 / t);
    let x = if t <= 4000.0 {
        -0.2661239 * a - 0.2343589 * b + 0.8776956 * c + 0.179910
    } else {
        -3.0258469 * a + 2.1070379 * b + 0.2226347 * c + 0.240390
    };
    let y = if t <= 2222.0 {
        -1.1063814 * x.powi(3) - 1.34811020 * x.powi(2) + 2.18555832 * x - 0.20219683
    } else if t <= 4000.0 {
        -0.9549476 * x.powi(3) - 1.37418593 * x.powi(2) + 2.09137015 * x - 0.16748867
    } else {
        3.0817580 * x.powi(3) - 5.87338670 * x.powi(2) + 3.75112997 * x - 0.37001483
    };
    let (big_x, big_z) = (x / y, (1.0 - x - y) / y);
    let rgb = Vec3::new(
        (3.2404542 * big_x - 1.5371385 - 0.4985314 * big_z) as f32,
        (-0.9692660 * big_x + 1.8760108 + 0.0415560 * big_z) as f32,
        (0.0556434 * big_x - 0.2040259 + 1.0572252 * big_z) as f32,
    )
    .max(Vec3::ZERO);
    rgb / luminance(rgb)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn daylight_is_white_and_incandescent_is_warm() {
        let day = black_body(6504.0);
        // The Planckian locus passes D65 at a distance of 0.003 in xy: about 5 % in a channel.
        assert!((day - Vec3::ONE).abs().max_element() < 0.06, "{day}");
        let warm = black_body(2700.0);
        assert!(warm.x > 1.5 && warm.z < 0.4 && warm.x > warm.y && warm.y > warm.z, "{warm}");
        for kelvin in [1000.0, 1667.0, 2222.0, 4000.0, 25000.0, 1e6] {
            let color = black_body(kelvin);
            assert!(
                (luminance(color) - 1.0).abs() < 1e-5 && color.min_element() >= 0.0,
                "{kelvin} K: {color}"
            );
        }
    }

    #[test]
    fn the_fit_is_continuous_at_its_joints() {
        for joint in [2222.0, 4000.0] {
            assert!(
                (black_body(joint - 0.5) - black_body(joint + 0.5)).abs().max_element() < 5e-3,
                "{joint} K"
            );
        }
    }
}
