//! Reflection of rough surfaces: GGX in the form of Karis, "Real Shading in Unreal Engine 4"
//! (SIGGRAPH 2013 course).
//!
//! f(v, l) = D(n.h) F(v.h) G(n.l, n.v) / (4 n.l n.v) with h the half vector, a = roughness^2,
//! k = a / 2: D = a^2 / (pi ((n.h)^2 (a^2 - 1) + 1)^2), G = G1(n.l) G1(n.v), G1(c) = c / (c
//! (1 - k) + k), F = F0 + (1 - F0) 2^((-5.55473 v.h - 6.98316) v.h), F0 = 0.08 specular, of metals
//! the base color.

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use crate::image::Gloss;
use crate::tuning::tuning;

/// A rough reflecting surface as seen from one side.
#[derive(Clone, Copy, Debug)]
pub struct Ggx {
    normal: Vec3,
    /// Unit length, from the surface to who looks at it.
    view: Vec3,
    /// Roughness squared.
    alpha: f32,
    f0: Vec3,
}

tuning! {
    /// Constants of the microfacet model.
    pub const TUNING: GgxTuning {
        /// Least roughness squared: below it a lobe is narrower than single precision can follow.
        min_alpha: f32 = 1e-4,
            unit "1", source Derived("single precision"), effect "a larger value blurs mirrors";
        /// Roughness squared up to which a surface reflects single points rather than a blur.
        mirror_alpha: f32 = 1e-3,
            unit "1", source Taste, effect "a larger value traces single rays for more surfaces";
        /// Least cosine between the view and the half vector by which a density is divided.
        min_cosine: f32 = 1e-4,
            unit "1", source Derived("single precision"), effect "a larger value changes densities at grazing angles";
    }
}

impl Ggx {
    /// `None` where nothing is reflected: dull, or seen from behind.
    pub fn new(normal: Vec3, view: Vec3, albedo: Vec3, gloss: Gloss) -> Option<Ggx> {
        let Gloss { roughness, specular, metallic } = gloss;
        let f0 = Vec3::splat(0.08 * specular * (1.0 - metallic)) + albedo * metallic;
        let dull = roughness >= 1.0 && metallic <= 0.0;
        let sound = !dull && f0.max_element() > 0.0 && normal.dot(view) > 0.0;
        sound.then_some(Ggx {
            normal,
            view,
            alpha: (roughness * roughness).clamp(TUNING.min_alpha, 1.0),
            f0,
        })
    }

    /// Whether it shows single points rather than a blur.
    pub fn is_mirror(&self) -> bool {
        self.alpha <= TUNING.mirror_alpha
    }

    fn fresnel(&self, vh: f32) -> Vec3 {
        self.f0 + (Vec3::ONE - self.f0) * ((-5.55473 * vh - 6.98316) * vh).exp2()
    }

    fn shadowing(&self, cosine: f32) -> f32 {
        let k = 0.5 * self.alpha;
        cosine / (cosine * (1.0 - k) + k)
    }

    fn distribution(&self, half: Vec3) -> f32 {
        // 1 - (n.h)^2 by the cross product, which loses nothing near the peak.
        let sine = self.normal.cross(half).length_squared();
        let a2 = self.alpha * self.alpha;
        a2 / (PI * (a2 * (1.0 - sine) + sine).powi(2))
    }

    /// Density of [`Ggx::sample`] at a direction above the surface, per steradian.
    pub fn density(&self, light: Vec3) -> f32 {
        let half = (light + self.view).normalize_or_zero();
        let vh = self.view.dot(half).max(TUNING.min_cosine);
        self.distribution(half) * self.normal.dot(half).max(0.0) / (4.0 * vh)
    }

    /// f(view, `light`), per steradian; `light` has unit length.
    pub fn value(&self, light: Vec3) -> Vec3 {
        let (nl, nv) = (self.normal.dot(light), self.normal.dot(self.view));
        let half = (light + self.view).normalize_or_zero();
        if nl <= 0.0 || half == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let d = self.distribution(half);
        let g = self.shadowing(nl) * self.shadowing(nv);
        self.fresnel(self.view.dot(half)) * (d * g / (4.0 * nl * nv))
    }

    /// A direction with density D n.h / (4 v.h), and f n.l over that density; `None` below the
    /// surface.
    pub fn sample(&self, [u, v]: [f64; 2]) -> Option<(Vec3, Vec3)> {
        let (u, v) = (u as f32, v as f32);
        let a2 = self.alpha * self.alpha;
        let cosine = ((1.0 - u) / (1.0 + (a2 - 1.0) * u)).max(0.0).sqrt();
        let (sin, cos) = (TAU * v).sin_cos();
        let (x, y) = self.normal.any_orthonormal_pair();
        let half =
            self.normal * cosine + (x * cos + y * sin) * (1.0 - cosine * cosine).max(0.0).sqrt();
        let vh = self.view.dot(half);
        let light = (2.0 * vh * half - self.view).normalize_or_zero();
        let (nl, nv) = (self.normal.dot(light), self.normal.dot(self.view));
        if nl <= 0.0 || vh <= 0.0 {
            return None;
        }
        let g = self.shadowing(nl) * self.shadowing(nv);
        Some((light, self.fresnel(vh) * (g * vh / (cosine * nv))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Points2;

    fn surface(roughness: f32, cosine: f32) -> Ggx {
        let view = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
        Ggx::new(Vec3::Z, view, Vec3::ONE, Gloss { roughness, specular: 0.5, metallic: 1.0 })
            .expect("it reflects")
    }

    #[test]
    fn a_white_metal_mirror_reflects_all_and_a_rough_one_no_more() {
        for roughness in [0.0, 0.1, 0.3, 0.6, 0.9] {
            for cosine in [0.1, 0.5, 0.95] {
                let surface = surface(roughness, cosine);
                let points = Points2::new(1, 2, 3);
                let n = 4096;
                let sum: f32 =
                    (0..n).filter_map(|i| surface.sample(points.get(i))).map(|(_, w)| w.x).sum();
                let whole = sum / n as f32;
                assert!(whole <= 1.001, "roughness {roughness}, cosine {cosine}: {whole}");
                // Light that the surface masks at grazing angles is lost: the model has one bounce.
                assert!(
                    roughness > 0.1 || cosine < 0.2 || whole > 0.97,
                    "roughness {roughness}, cosine {cosine}: {whole}"
                );
            }
        }
    }

    #[test]
    fn samples_and_values_are_of_one_function() {
        // The integral of f n.l, once by samples of the lobe and once by even directions of the
        // hemisphere.
        for (roughness, cosine) in [(0.4, 0.8), (0.7, 0.4), (0.9, 0.95)] {
            let surface = surface(roughness, cosine);
            let points = Points2::new(7, 0, 0);
            let n = 60_000;
            let lobe = (0..n)
                .filter_map(|i| surface.sample(points.get(i)))
                .map(|(_, w)| f64::from(w.x))
                .sum::<f64>()
                / n as f64;
            let even = (0..n).map(|i| {
                let [u, v] = points.get(i).map(|x| x as f32);
                let (sin, cos) = (TAU * v).sin_cos();
                let r = (1.0 - u * u).sqrt();
                let l = Vec3::new(r * cos, r * sin, u);
                f64::from(surface.value(l).x * u * TAU)
            });
            let even = even.sum::<f64>() / n as f64;
            assert!(
                (lobe / even - 1.0).abs() < 0.02,
                "roughness {roughness}: {lobe} against {even}"
            );
        }
    }

    #[test]
    fn the_density_is_that_of_the_samples() {
        // The density's integral over a cap around the peak, by even directions of the cap, is the
        // fraction of samples that fall into it.
        for (roughness, cosine) in [(0.4, 0.8), (0.7, 0.5)] {
            let surface = surface(roughness, cosine);
            let peak = Vec3::new(-(1.0f32 - cosine * cosine).sqrt(), 0.0, cosine);
            let (x, y) = peak.any_orthonormal_pair();
            let (points, n, low) = (Points2::new(3, 0, 0), 60_000, 0.95f32);
            let inside = (0..n)
                .filter(|&i| surface.sample(points.get(i)).is_some_and(|(l, _)| l.dot(peak) > low))
                .count();
            let even = (0..n).map(|i| {
                let [u, v] = points.get(i).map(|x| x as f32);
                let (c, (sin, cos)) = (low + (1.0 - low) * u, (TAU * v).sin_cos());
                f64::from(surface.density(peak * c + (x * cos + y * sin) * (1.0 - c * c).sqrt()))
            });
            let want = even.sum::<f64>() / n as f64 * f64::from(TAU * (1.0 - low));
            let got = inside as f64 / n as f64;
            assert!((got / want - 1.0).abs() < 0.03, "roughness {roughness}: {got} against {want}");
        }
    }

    #[test]
    fn a_mirror_looks_along_the_reflected_ray() {
        let (light, weight) =
            surface(0.0, 0.6).sample([0.3, 0.7]).expect("it is above the surface");
        assert!(
            light.distance(Vec3::new(-0.8, 0.0, 0.6)) < 1e-3 && (weight.x - 1.0).abs() < 1e-3,
            "{light} {weight}"
        );
        let glass = Ggx::new(
            Vec3::Z,
            Vec3::Z,
            Vec3::ONE,
            Gloss { roughness: 0.0, specular: 0.5, metallic: 0.0 },
        )
        .expect("it reflects");
        assert!(
            (glass.sample([0.0, 0.0]).expect("straight back").1.x - 0.04).abs() < 1e-3,
            "4 % at normal incidence"
        );
        assert!(
            Ggx::new(
                Vec3::Z,
                Vec3::Z,
                Vec3::ONE,
                Gloss { roughness: 1.0, specular: 0.5, metallic: 0.0 }
            )
            .is_none(),
            "dull"
        );
    }
}
