//! Free parameters of a light's shape, each in units of its likely error.

use glam::{Quat, Vec3};

use crate::optics::{Gradient, LOBES, Lamp, Shape, Window};
use crate::tuning::tuning;

/// Degrees of freedom of a light's shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DegreesOfFreedom {
    /// The shape is known.
    Fixed,
    /// A lamp keeps its outline in the photo and may be nearer or farther. A window keeps its
    /// frame, and its lobes may change.
    InView,
    /// A lamp may have another position and size. A window may have another position in its plane,
    /// another size and other lobes.
    OutOfView,
}

/// One degree of freedom of a shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Parameter {
    /// Logarithm of the distance from the camera and of the size together; its likely error.
    Distance(f32),
    /// Translation of the whole light; the vector is one likely error long.
    Shift(Vec3),
    /// Logarithm of the size about its middle.
    Size,
    /// Rotation of a lobe's direction about this unit axis.
    Turn(usize, Vec3),
    /// log(1 + bandwidth) of a lobe.
    Bandwidth(usize),
}

tuning! {
    /// Constants of the free parameters of a light's shape.
    pub const TUNING: ParametersTuning {
        /// Likely error of the distance of a visible lamp: the depth is that of its front, not of
        /// its middle.
        distance: f32 = 0.5,
            unit "radii", source Taste, effect "a larger value lets lamps move farther";
        /// Likely error of the logarithm of the size.
        size: f32 = 0.4,
            unit "1", source Taste, effect "a larger value lets lights change their size more";
        /// Likely error of a lobe's direction.
        turn: f32 = 0.2,
            unit "radians", source Taste, effect "a larger value lets lobes turn more";
        /// Likely error of log(1 + bandwidth).
        bandwidth: f32 = 1.0,
            unit "1", source Taste, effect "a larger value lets lobes become broader and narrower";
        /// Likely error of the position of a light out of view.
        shift: f32 = 0.15,
            unit "fraction of its distance from the receivers", source Taste,
            effect "a larger value lets lights move farther";
        /// Largest bandwidth: a lobe beyond it is a direction.
        max_bandwidth: f32 = 1e5,
            unit "1", source Derived("the sun's disc is about 1e5"), effect "a larger value widens the search";
    }
}

/// Parameters of a light with these degrees of freedom. `lit` is the mean position of the
/// receivers, meters, camera space. The axes are those of the present shape.
pub fn parameters(shape: &Shape, freedom: DegreesOfFreedom, lit: Vec3) -> Vec<Parameter> {
    let Some((middle, radius)) =
        shape.bounding_sphere().filter(|_| freedom != DegreesOfFreedom::Fixed)
    else {
        return Vec::new();
    };
    let reach = TUNING.shift * middle.distance(lit);
    match (shape, freedom) {
        // A visible panel lies in its ceiling.
        (Shape::Absent, _) | (Shape::Lamp(Lamp::Rect(_)), DegreesOfFreedom::InView) => Vec::new(),
        (Shape::Lamp(_), DegreesOfFreedom::InView) => {
            vec![Parameter::Distance(TUNING.distance * radius / middle.length())]
        }
        (Shape::Lamp(_), _) => Vec3::AXES
            .map(|axis| Parameter::Shift(axis * reach))
            .into_iter()
            .chain([Parameter::Size])
            .collect(),
        (Shape::Window(window), _) => {
            let position =
                [window.x, window.y].map(|edge| Parameter::Shift(edge.normalize_or_zero() * reach));
            let position = position
                .into_iter()
                .chain([Parameter::Size])
                .filter(|_| freedom == DegreesOfFreedom::OutOfView);
            let lobe = |k: usize| {
                let (a, b) = window.lobes[k].direction.any_orthonormal_pair();
                [Parameter::Turn(k, a), Parameter::Turn(k, b), Parameter::Bandwidth(k)]
            };
            position.chain((0..3).flat_map(lobe)).collect()
        }
    }
}

impl Parameter {
    /// Derivative of the irradiance E of a lobe of `shape`, per likely error of this parameter.
    pub fn rate(&self, shape: &Shape, lobe: usize, gradient: &Gradient) -> f64 {
        let middle = || shape.bounding_sphere().map_or(Vec3::ZERO, |(middle, _)| middle).as_dvec3();
        match self {
            Parameter::Distance(error) => {
                f64::from(*error) * (gradient.size + gradient.position.dot(middle()))
            }
            Parameter::Shift(axis) => gradient.position.dot(axis.as_dvec3()),
            Parameter::Size => f64::from(TUNING.size) * gradient.size,
            Parameter::Turn(k, axis) if *k == lobe => {
                f64::from(TUNING.turn) * gradient.turn.dot(axis.as_dvec3())
            }
            Parameter::Bandwidth(k) if *k == lobe => {
                f64::from(TUNING.bandwidth) * gradient.bandwidth * (1.0 + bandwidth(shape, *k))
            }
            Parameter::Turn(..) | Parameter::Bandwidth(_) => 0.0,
        }
    }

    /// Offset of `shape` from `start` along this parameter, in likely errors; 0 where it is
    /// undefined.
    pub fn offset(&self, start: &Shape, shape: &Shape) -> f64 {
        let (Some((from, before)), Some((to, now))) =
            (start.bounding_sphere(), shape.bounding_sphere())
        else {
            return 0.0;
        };
        let offset = match self {
            Parameter::Distance(error) => (to.length() / from.length()).ln() / error,
            Parameter::Shift(axis) => (to - from).dot(*axis) / axis.length_squared(),
            Parameter::Size => (now / before).ln() / TUNING.size,
            Parameter::Turn(k, axis) => match (start, shape) {
                (Shape::Window(start), Shape::Window(window)) => {
                    let [from, to] =
                        [start, window].map(|window| window.lobes[*k].direction.as_dvec3());
                    let across = from.cross(to);
                    let angle = across.length().atan2(from.dot(to));
                    (angle * across.normalize_or_zero().dot(axis.as_dvec3())) as f32 / TUNING.turn
                }
                _ => 0.0,
            },
            Parameter::Bandwidth(k) => {
                (((1.0 + bandwidth(shape, *k)) / (1.0 + bandwidth(start, *k))).ln()
                    / f64::from(TUNING.bandwidth)) as f32
            }
        };
        if offset.is_finite() { f64::from(offset) } else { 0.0 }
    }

    /// The shape after a step of `step` likely errors.
    pub fn moved(&self, shape: &Shape, step: f64) -> Shape {
        let step = step as f32;
        match self {
            Parameter::Distance(error) => {
                resized(shape, (error * step).exp(), Vec3::ZERO, Vec3::ZERO)
            }
            Parameter::Shift(axis) => resized(shape, 1.0, Vec3::ZERO, *axis * step),
            Parameter::Size => {
                let middle = shape.bounding_sphere().map_or(Vec3::ZERO, |(middle, _)| middle);
                resized(shape, (TUNING.size * step).exp(), middle, Vec3::ZERO)
            }
            Parameter::Turn(k, axis) => with_lobe(shape, |window| {
                let turned =
                    Quat::from_axis_angle(*axis, TUNING.turn * step) * window.lobes[*k].direction;
                window.lobes[*k].direction = turned.normalize();
            }),
            Parameter::Bandwidth(k) => with_lobe(shape, |window| {
                let grown = ((f64::from(window.lobes[*k].bandwidth)).ln_1p()
                    + f64::from(TUNING.bandwidth * step))
                .exp_m1();
                window.lobes[*k].bandwidth = (grown as f32).clamp(0.0, TUNING.max_bandwidth);
            }),
        }
    }

    /// Name of the parameter in messages.
    pub fn name(&self) -> String {
        match self {
            Parameter::Distance(_) => "distance".into(),
            Parameter::Shift(_) => "place".into(),
            Parameter::Size => "size".into(),
            Parameter::Turn(k, _) => format!("direction of the {}", LOBES[*k]),
            Parameter::Bandwidth(k) => format!("bandwidth of the {}", LOBES[*k]),
        }
    }
}

fn bandwidth(shape: &Shape, lobe: usize) -> f64 {
    if let Shape::Window(window) = shape { f64::from(window.lobes[lobe].bandwidth) } else { 0.0 }
}

fn with_lobe(shape: &Shape, change: impl Fn(&mut Window)) -> Shape {
    let mut shape = shape.clone();
    if let Shape::Window(window) = &mut shape {
        change(window);
    }
    shape
}

/// The light scaled by `factor` about `pivot`, then translated by `shift` (meters).
fn resized(shape: &Shape, factor: f32, pivot: Vec3, shift: Vec3) -> Shape {
    shape.transformed(&|p| pivot + (p - pivot) * factor + shift, factor)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{BoxLamp, RectLamp, SphereLamp};
    use crate::optics::{Emitter, Surfel};

    fn lights() -> Vec<(Shape, DegreesOfFreedom)> {
        let (center, x, y) = (Vec3::new(0.3, 0.4, -2.0), Vec3::X * 0.4, Vec3::Y * 0.3);
        let mut lobes = Window::daylight(Vec3::Z, Vec3::Y);
        lobes[0].bandwidth = 100.0;
        let surfels = (0..4)
            .map(|i| Surfel { point: center + Vec3::X * i as f32, normal: Vec3::Z, area: 0.01 })
            .collect();
        vec![
            (
                Shape::Lamp(Lamp::Sphere(SphereLamp { center, radius: 0.1 })),
                DegreesOfFreedom::InView,
            ),
            (Shape::Lamp(Lamp::Surfels(surfels)), DegreesOfFreedom::InView),
            (
                Shape::Lamp(Lamp::Box(BoxLamp { center, axes: [x, y, Vec3::Z * 0.2] })),
                DegreesOfFreedom::OutOfView,
            ),
            (Shape::Lamp(Lamp::Rect(RectLamp { center, x, y })), DegreesOfFreedom::OutOfView),
            (Shape::Window(Window { center, x, y, lobes }), DegreesOfFreedom::InView),
            (Shape::Window(Window { center, x, y, lobes }), DegreesOfFreedom::OutOfView),
        ]
    }

    #[test]
    fn rates_agree_with_finite_differences_and_steps_are_counted() {
        let (point, normal) = (Vec3::new(0.1, -0.5, -0.7), Vec3::new(0.1, 0.5, -1.0).normalize());
        for (shape, freedom) in lights() {
            let (pivot, _) = shape.bounding_sphere().expect("a light");
            for parameter in parameters(&shape, freedom, Vec3::ZERO) {
                let h = 1e-2;
                let [less, more] = [-h, h].map(|step| parameter.moved(&shape, step));
                let offset = parameter.offset(&shape, &more);
                assert!((offset / h - 1.0).abs() < 1e-2, "{parameter:?}: {offset}");
                for lobe in 0..shape.lobes() {
                    let e = |s: &Shape| {
                        f64::from(Emitter::new(s).irradiance(lobe, point, normal).expect("closed"))
                    };
                    let by = (e(&more) - e(&less)) / (2.0 * h);
                    let got = parameter.rate(
                        &shape,
                        lobe,
                        &Emitter::new(&shape).gradient(lobe, point, normal, pivot),
                    );
                    let tolerance = 1e-2 * got.abs() + 1e-4 * e(&shape) + 1e-9;
                    assert!((by - got).abs() < tolerance, "{parameter:?} {lobe}: {by} {got}");
                }
            }
        }
    }

    #[test]
    fn what_is_seen_keeps_its_outline_and_its_frame() {
        let panel =
            Shape::Lamp(Lamp::Rect(RectLamp { center: Vec3::NEG_Z, x: Vec3::X, y: Vec3::Y }));
        assert_eq!(parameters(&panel, DegreesOfFreedom::InView, Vec3::ZERO), []);
        for (shape, freedom) in lights() {
            assert_eq!(parameters(&shape, DegreesOfFreedom::Fixed, Vec3::ZERO), []);
            for parameter in parameters(&shape, freedom, Vec3::ZERO)
                .into_iter()
                .filter(|_| freedom == DegreesOfFreedom::InView)
            {
                let (from, to) = (
                    shape.bounding_sphere().unwrap(),
                    parameter.moved(&shape, 2.0).bounding_sphere().unwrap(),
                );
                // The same cone of directions.
                assert!((from.0.normalize() - to.0.normalize()).length() < 1e-6);
                assert!((from.1 / from.0.length() - to.1 / to.0.length()).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn bandwidths_stay_within_bounds() {
        let (shape, _) = &lights()[4];
        for step in [-1e3, 1e3] {
            let Shape::Window(window) = Parameter::Bandwidth(0).moved(shape, step) else {
                panic!("a window")
            };
            assert!((0.0..=TUNING.max_bandwidth).contains(&window.lobes[0].bandwidth));
        }
    }
}
