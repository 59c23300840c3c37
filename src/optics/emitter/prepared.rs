//! Lights prepared for rendering: closed forms, samples and gradients of any form.

use glam::{DVec3, Vec3};

use super::form::{FormSampler, PreparedForm};
use super::{Gradient, Shape, Strategy};
use crate::optics::sampling::Points2;

/// A position on a light and its contribution to the irradiance over pi of one lobe of unit
/// radiance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// Camera space, meters.
    pub position: Vec3,
    /// Positive and finite.
    pub contribution: f32,
}

/// A light prepared for closed forms and sampling.
///
/// ```
/// use glam::Vec3;
/// use relight::optics::{Emitter, Lamp, Points2, Shape, SphereLamp};
///
/// // A globe of 10 cm radius, 1 m above a floor: E / (pi L) = (r / d)^2.
/// let globe = Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::Y, radius: 0.1 }));
/// let emitter = Emitter::new(&globe);
/// let exact = emitter.irradiance(0, Vec3::ZERO, Vec3::Y).expect("a sphere has a closed form");
/// assert!((exact - 0.01).abs() < 1e-6);
///
/// // Samples estimate the same number, and give positions to which shadow rays can go.
/// let sampler = emitter.sampler_at(0, Vec3::ZERO, Vec3::Y).expect("it is above the horizon");
/// let points = Points2::new(0, 0, 0);
/// let samples = (0..64).filter_map(|i| sampler.sample(&points, i));
/// let sum: f32 = samples.map(|sample| sample.contribution).sum();
/// assert!((sum / 64.0 / exact - 1.0).abs() < 1e-2);
/// ```
pub struct Emitter {
    /// `None` emits nothing.
    form: Option<Box<dyn PreparedForm>>,
    lobes: usize,
}

impl Emitter {
    /// The prepared light. A form without size or with a number that is not finite emits nothing.
    pub fn new(shape: &Shape) -> Emitter {
        Emitter { form: shape.form().and_then(|form| form.prepare()), lobes: shape.lobes() }
    }

    /// [`Emitter::new`] with the directions to a window from `strategy`, to compare it with the
    /// default.
    pub fn with_strategy(shape: &Shape, strategy: Strategy) -> Emitter {
        match shape {
            Shape::Window(window) => {
                let form =
                    window.prepared(strategy).map(|form| Box::new(form) as Box<dyn PreparedForm>);
                Emitter { form, lobes: shape.lobes() }
            }
            _ => Emitter::new(shape),
        }
    }

    /// The number of lobes: 0, 1 or 3.
    pub fn lobes(&self) -> usize {
        self.lobes
    }

    /// The irradiance over pi, E / L in 0..=1, of one lobe of unit radiance at `point` with the
    /// unit `normal`.
    ///
    /// `None` without a closed form, or where it would be slower than sampling.
    pub fn irradiance(&self, lobe: usize, point: Vec3, normal: Vec3) -> Option<f32> {
        let e = match &self.form {
            Some(form) => form.irradiance(lobe, point.as_dvec3(), normal.as_dvec3())?,
            None => 0.0,
        };
        Some(if e.is_finite() { e as f32 } else { 0.0 })
    }

    /// The sampler of one lobe for a receiver at `point` with the unit `normal`; `None` where
    /// nothing arrives.
    pub fn sampler_at(&self, lobe: usize, point: Vec3, normal: Vec3) -> Option<EmitterSampler<'_>> {
        if !(point.is_finite() && normal.is_finite()) {
            return None;
        }
        Some(EmitterSampler(self.form.as_ref()?.sampler_at(
            lobe,
            point.as_dvec3(),
            normal.as_dvec3(),
        )?))
    }

    /// The irradiance over pi of one lobe and its derivatives; `pivot` is the point about which the
    /// light grows.
    ///
    /// Zero where nothing arrives, and for meshes that hide parts of themselves, which no fit
    /// moves.
    pub fn gradient(&self, lobe: usize, point: Vec3, normal: Vec3, pivot: Vec3) -> Gradient {
        let (point, normal): (DVec3, DVec3) = (point.as_dvec3(), normal.as_dvec3());
        let pivot = pivot.as_dvec3() - point;
        self.form.as_ref().map_or_else(Gradient::default, |form| {
            form.gradient(lobe, point, normal, pivot).or_zero()
        })
    }
}

/// A sampler of one lobe of a light for one receiver.
pub struct EmitterSampler<'a>(Box<dyn FormSampler + 'a>);

impl EmitterSampler<'_> {
    /// The `i`th sample of these `points`; its contribution is by itself an unbiased estimate of E
    /// / L.
    ///
    /// A direction that cannot contribute gives `None` and counts as zero.
    pub fn sample(&self, points: &Points2, i: usize) -> Option<LightSample> {
        let (position, contribution) = self.0.sample(points, i)?;
        let contribution = contribution as f32;
        let valid = contribution > 0.0 && contribution.is_finite();
        valid.then(|| LightSample { position: position.as_vec3(), contribution })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{
        BoxLamp, Lamp, Lobe, MeshLamp, RectLamp, SphereLamp, Surfel, Window, estimate, stream,
    };

    fn lamps() -> Vec<(&'static str, Lamp)> {
        let surfel = |i: usize| {
            let normal = Vec3::new((i as f32).sin(), -1.0, (i as f32 * 2.0).cos()).normalize();
            Surfel {
                point: Vec3::new(0.1 * i as f32, 1.5, 0.05 * i as f32),
                normal,
                area: 0.01 + 0.002 * i as f32,
            }
        };
        let axes = [Vec3::X * 0.3, Vec3::new(0.0, 0.2, 0.1), Vec3::new(0.0, -0.1, 0.2)];
        let tetrahedron = vec![
            Vec3::new(0.0, 1.0, 0.0),
            Vec3::new(0.5, 1.2, 0.0),
            Vec3::new(0.0, 1.7, 0.1),
            Vec3::new(0.1, 1.2, 0.6),
        ];
        vec![
            ("sphere", Lamp::Sphere(SphereLamp { center: Vec3::new(0.5, 0.8, 0.2), radius: 0.3 })),
            (
                "sphere on the horizon",
                Lamp::Sphere(SphereLamp { center: Vec3::new(1.0, 0.1, 0.2), radius: 0.5 }),
            ),
            (
                "rectangle",
                Lamp::Rect(RectLamp {
                    center: Vec3::new(0.3, 1.0, 0.2),
                    x: Vec3::X * 0.6,
                    y: Vec3::Z * 0.4,
                }),
            ),
            (
                "rectangle through the horizon",
                Lamp::Rect(RectLamp {
                    center: Vec3::new(1.0, 0.1, 0.0),
                    x: Vec3::Z * 0.6,
                    y: Vec3::Y * 0.6,
                }),
            ),
            ("box", Lamp::Box(BoxLamp { center: Vec3::new(0.4, 0.9, 0.1), axes })),
            (
                "left-handed box",
                Lamp::Box(BoxLamp {
                    center: Vec3::new(0.4, 0.9, 0.1),
                    axes: [axes[1], axes[0], axes[2]],
                }),
            ),
            ("surfels", Lamp::Surfels((0..20).map(surfel).collect())),
            (
                "mesh",
                Lamp::Mesh(MeshLamp::without_occlusion(
                    tetrahedron,
                    vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
                )),
            ),
        ]
    }

    #[test]
    fn samples_agree_with_the_closed_forms() {
        for (name, lamp) in lamps() {
            let emitter = Emitter::new(&Shape::Lamp(lamp));
            for normal in [Vec3::Y, Vec3::new(-0.4, 0.7, 0.2).normalize(), Vec3::X] {
                let exact = f64::from(emitter.irradiance(0, Vec3::ZERO, normal).unwrap());
                let pixels = 4000;
                let (mut mean, mut square, mut claimed) = (0.0, 0.0, 0.0);
                for pixel in 0..pixels {
                    let (e, error) = estimate(&emitter, 0, (Vec3::ZERO, normal), 4, 3, pixel);
                    mean += e / f64::from(pixels);
                    square += e.powi(2) / f64::from(pixels);
                    claimed += error.powi(2) / f64::from(pixels);
                }
                let variance = (square - mean * mean).max(0.0);
                // 24 comparisons: four standard errors, and single-precision rounding.
                let bound = 4.0 * (variance / f64::from(pixels)).sqrt() + 2e-6;
                assert!((mean - exact).abs() < bound, "{name} {normal}: {mean} {exact} {bound}");
                // The mean of 4000 variances of three degrees of freedom is known to about 2 %.
                let ratio = (claimed + 1e-12) / (variance + 1e-12);
                assert!(
                    (0.85..1.15).contains(&ratio),
                    "{name} {normal}: claimed over true variance {ratio}"
                );
            }
        }
    }

    #[test]
    fn both_hands_of_a_box_are_the_same_box() {
        let all = lamps();
        let e = |i: usize| {
            Emitter::new(&Shape::Lamp(all[i].1.clone())).irradiance(0, Vec3::ZERO, Vec3::Y).unwrap()
        };
        assert!((e(4) - e(5)).abs() < 1e-6 && e(4) > 0.01, "{} {}", e(4), e(5));
    }

    #[test]
    fn pieces_are_chosen_by_what_arrives() {
        for (name, bound) in [("surfels", 1e-6), ("mesh", 0.5)] {
            let lamp = lamps().into_iter().find(|(other, _)| *other == name).unwrap().1;
            let emitter = Emitter::new(&Shape::Lamp(lamp));
            for normal in [Vec3::Y, Vec3::new(-0.4, 0.7, 0.2).normalize(), Vec3::X] {
                let exact = emitter.irradiance(0, Vec3::ZERO, normal).unwrap();
                let sampler = emitter.sampler_at(0, Vec3::ZERO, normal).unwrap();
                // No sample is lost on a piece that faces away. The contributions of surfels are
                // all equal.
                let all =
                    (0..64).map(|i| sampler.sample(&stream(3, 7, 0, 0), i).unwrap().contribution);
                let spread = all.map(|one| (one / exact - 1.0).powi(2)).sum::<f32>() / 64.0;
                assert!(spread.sqrt() < bound, "{name} {normal}: {}", spread.sqrt());
            }
        }
    }

    #[test]
    fn whatever_the_light_and_the_point_the_answer_is_finite_and_not_negative() {
        let strange =
            [Vec3::ZERO, Vec3::X, Vec3::splat(1e-30), Vec3::splat(1e20), Vec3::NAN, Vec3::INFINITY];
        for a in strange {
            for b in strange {
                let shapes = [
                    Shape::Absent,
                    Shape::Lamp(Lamp::Sphere(SphereLamp { center: a, radius: b.x })),
                    Shape::Lamp(Lamp::Rect(RectLamp { center: a, x: b, y: Vec3::Y })),
                    Shape::Lamp(Lamp::Box(BoxLamp { center: a, axes: [b, Vec3::Y, Vec3::Z] })),
                    Shape::Lamp(Lamp::Surfels(vec![Surfel { point: a, normal: b, area: 1.0 }])),
                    Shape::Lamp(Lamp::Surfels(Vec::new())),
                    Shape::Lamp(Lamp::Mesh(MeshLamp::without_occlusion(
                        vec![a, b, Vec3::Z],
                        vec![[0, 1, 2], [0, 1, 9]],
                    ))),
                    Shape::Window(Window {
                        center: a,
                        x: b,
                        y: Vec3::Z,
                        lobes: [0.0, 1e7, f32::NAN]
                            .map(|bandwidth| Lobe { direction: b, bandwidth }),
                    }),
                ];
                for emitter in shapes.iter().map(Emitter::new) {
                    for point in strange {
                        for lobe in 0..emitter.lobes() {
                            let e = emitter.irradiance(lobe, point, Vec3::Y).unwrap_or(0.0);
                            assert!(e.is_finite() && e >= 0.0);
                            let sampler = emitter.sampler_at(lobe, point, Vec3::Y);
                            let samples = (0..8)
                                .filter_map(|i| sampler.as_ref()?.sample(&stream(0, 0, 0, 0), i));
                            samples.for_each(|sample| {
                                assert!(
                                    sample.contribution.is_finite() && sample.contribution > 0.0
                                )
                            });
                        }
                    }
                }
            }
        }
    }
}
