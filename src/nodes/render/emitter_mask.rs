//! `EmitterMask`: the pixels of the picture that show a light itself.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::Camera;
use crate::graph::{Context, Node, NodeError};
use crate::image::{Depth, Mask, Plane};
use crate::optics::{Shape, Silhouette};
use crate::tuning::tuning;
use crate::{params, ports};

tuning! {
    /// Constants of the mask of an inserted light.
    pub const TUNING: EmitterMaskTuning {
        /// Distance of a window over the depth of a pixel, up to which the window is visible there:
        /// depth is uneven, and a window lies in its wall.
        window_slack: f32 = 1.05,
            unit "1", source Taste, effect "a larger value shows windows behind other surfaces";
        /// Distance of a lamp over the depth of a pixel, up to which the lamp is visible there: it
        /// may stand on a table.
        lamp_slack: f32 = 1.02,
            unit "1", source Taste, effect "a larger value shows lamps behind other surfaces";
        /// Distance up to which the photo's blur is computed.
        blur_reach: f32 = 3.0,
            unit "standard deviations", source Derived("beyond it 0.3 % of a Gaussian, half a step of white"),
            effect "a larger value is slower, and more exact for very bright lamps";
        /// Least depth of the farthest point of a light in view.
        near: f32 = 1e-3,
            unit "meters", source Derived("single precision"), effect "a larger value drops lights around the camera";
    }
}

params! {
    /// Draws the mask of a light's body: its coverage of each photo pixel, less its occluders.
    ///
    /// A light that the scene's masks show, and that was not replaced, needs no drawing: its pixels
    /// are in the photo.
    ///
    /// A lamp is so much brighter than white that a pixel of which it covers a twentieth is white:
    /// without the blur of lens and sensor its outline would be a flight of steps.
    pub struct EmitterMask {
        /// Samples per pixel side for smooth edges; 1..=16.
        supersampling: usize = 4, in 1..=16,
        /// Standard deviation of the blur by lens and sensor, pixels; 0..=10. From 0.4 on outlines
        /// have no steps.
        blur: f32 = 0.4, in 0.0..=10.0,
    }
}

ports! {
    pub input EmitterMaskIn {
        /// The light.
        shape: Arc<Shape>,
        /// The same light as estimated; missing for an inserted one.
        estimated: Option<Arc<Shape>>,
        /// The camera of the photo.
        camera: Arc<Camera>,
        /// Planar depth at the photo's size.
        depth: Arc<Depth>,
    }
}

ports! {
    pub output EmitterMaskOut {
        /// Coverage of each pixel by the light's body, 0..=1, photo size.
        coverage: Arc<Mask>,
    }
}

impl Node for EmitterMask {
    const KIND: &'static str = "EmitterMask";
    const VERSION: u32 = 3;
    type In = EmitterMaskIn;
    type Out = EmitterMaskOut;

    fn run(&self, inputs: EmitterMaskIn, _: &Context) -> Result<EmitterMaskOut, NodeError> {
        let camera = &inputs.camera;
        let mut coverage = Plane::filled(camera.width, camera.height, 0.0f32);
        // Estimated lights are in the photo if they are visible, and out of view otherwise.
        if inputs.estimated.is_none_or(|e| e != inputs.shape)
            && let Some(area) = bounds(&inputs.shape, camera)
        {
            let [x0, y0, x1, y1] = area;
            let n = self.supersampling;
            let step = 1.0 / n as f32;
            let body = Silhouette::new(&inputs.shape);
            coverage
                .pixels_mut()
                .par_chunks_mut(camera.width)
                .enumerate()
                .skip(y0)
                .take(y1 - y0)
                .for_each(|(y, row)| {
                    for (x, share) in row.iter_mut().enumerate().take(x1).skip(x0) {
                        let z = inputs.depth.0.get(x, y);
                        let hits = (0..n * n).filter(|i| {
                            let (u, v) = ((i % n) as f32 + 0.5, (i / n) as f32 + 0.5);
                            let ray =
                                camera.unproject(x as f32 + u * step, y as f32 + v * step, 1.0);
                            let slack = if matches!(*inputs.shape, Shape::Window(_)) {
                                TUNING.window_slack
                            } else {
                                TUNING.lamp_slack
                            };
                            body.intersect(Vec3::ZERO, ray).is_some_and(|t| t <= z * slack)
                        });
                        *share = hits.count() as f32 * step * step;
                    }
                });
            blur(&mut coverage, area, self.blur);
        }
        Ok(EmitterMaskOut { coverage: Arc::new(Mask(coverage)) })
    }
}

/// Convolves a plane, which is 0 outside of the rectangle `area`, with a Gaussian of standard
/// deviation `sigma`, pixels. Beyond the border a plane is as at its border.
fn blur(plane: &mut Plane<f32>, [x0, y0, x1, y1]: [usize; 4], sigma: f32) {
    let reach = (TUNING.blur_reach * sigma).ceil() as usize;
    let weight = |away: usize| (-0.5 * (away as f32 / sigma).powi(2)).exp();
    let weights: Vec<f32> =
        (0..=reach).map(|away| if away == 0 { 1.0 } else { weight(away) }).collect();
    let sum = weights[0] + 2.0 * weights[1..].iter().sum::<f32>();
    let (w, h) = plane.size();
    let (left, right) = (x0.saturating_sub(reach), (x1 + reach).min(w));
    let (top, bottom) = (y0.saturating_sub(reach), (y1 + reach).min(h));
    // The mean around place `i` of a line of `n` values.
    let mean = |line: &dyn Fn(usize) -> f32, i: usize, n: usize| {
        let pairs = weights.iter().enumerate().skip(1).map(|(away, weight)| {
            weight * (line(i.saturating_sub(away)) + line((i + away).min(n - 1)))
        });
        ((weights[0] * line(i) + pairs.sum::<f32>()) / sum).min(1.0)
    };
    plane.pixels_mut().par_chunks_mut(w).skip(y0).take(y1 - y0).for_each(|row| {
        let line = row[left..right].to_vec();
        for (x, value) in row[left..right].iter_mut().enumerate() {
            *value = mean(&|x| line[x], x, line.len());
        }
    });
    let rows = plane.pixels()[top * w..bottom * w].to_vec();
    let changed = plane.pixels_mut().par_chunks_mut(w).skip(top).take(bottom - top);
    changed.enumerate().for_each(|(y, row)| {
        for (x, value) in row.iter_mut().enumerate().take(right).skip(left) {
            *value = mean(&|y| rows[y * w + x], y, bottom - top);
        }
    });
}

/// Pixel rectangle (x0, y0, x1, y1; ends excluded) that holds the light's body, or `None` when it
/// is out of view.
fn bounds(shape: &Shape, camera: &Camera) -> Option<[usize; 4]> {
    let (center, reach) = shape.bounding_sphere()?;
    if -center.z + reach <= TUNING.near {
        return None;
    }
    let corners = (0..8).map(|i| {
        center
            + reach * Vec3::from_array([0, 1, 2].map(|b| if i >> b & 1 == 0 { -1.0 } else { 1.0 }))
    });
    let (mut low, mut high) = (glam::Vec2::INFINITY, glam::Vec2::NEG_INFINITY);
    for corner in corners {
        match camera.project(corner) {
            Some(at) => (low, high) = (low.min(at), high.max(at)),
            // Reaches behind the camera: it may be anywhere.
            None => (low, high) = (glam::Vec2::ZERO, glam::Vec2::splat(f32::MAX)),
        }
    }
    let limit = |v: f32, end: usize| v.clamp(0.0, end as f32) as usize;
    let area = [
        limit(low.x.floor(), camera.width),
        limit(low.y.floor(), camera.height),
        limit(high.x.ceil(), camera.width),
        limit(high.y.ceil(), camera.height),
    ];
    (area[0] < area[2] && area[1] < area[3]).then_some(area)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Lamp, SphereLamp};

    fn cover(shape: Shape, wall: f32) -> Plane<f32> {
        blurred(shape, wall, EmitterMask::default().blur)
    }

    fn blurred(shape: Shape, wall: f32, blur: f32) -> Plane<f32> {
        let camera = Camera::from_fov_x(80, 60, 60.0);
        let inputs = EmitterMaskIn {
            shape: Arc::new(shape),
            estimated: None,
            camera: Arc::new(camera),
            depth: Arc::new(Depth(Plane::filled(80, 60, wall))),
        };
        let node = EmitterMask { blur, ..EmitterMask::default() };
        let glow = node.run(inputs, &Context::default()).expect("runs");
        glow.coverage.0.clone()
    }

    fn sphere() -> Shape {
        let center = Vec3::new(0.0, 0.0, -2.0);
        Shape::Lamp(Lamp::Sphere(SphereLamp { center, radius: 0.2 }))
    }

    /// The outline of that sphere, on the axis, is a circle of radius f tan(asin(r / d)).
    fn outline() -> f32 {
        Camera::from_fov_x(80, 60, 60.0).fx * 0.1f32.asin().tan()
    }

    #[test]
    fn an_outline_is_an_edge_that_a_gaussian_blurs() {
        for sigma in [0.7, 1.0] {
            let got = blurred(sphere(), 5.0, sigma);
            // The normal distribution, by its logistic approximation, exact to 0.01; a pixel is a
            // box of variance 1 / 12.
            let scale = (sigma * sigma + 1.0 / 12.0).sqrt();
            for x in 41..60 {
                let inside = (outline() - (x as f32 + 0.5 - 40.0).hypot(0.5)) / scale;
                let want = 1.0 / (1.0 + (-1.702 * inside).exp());
                let got = got.get(x, 30);
                assert!((got - want).abs() < 0.05, "{sigma}, {x}: {got} against {want}");
            }
        }
        let sharp = blurred(sphere(), 5.0, 0.0);
        assert_eq!((sharp.get(40, 30), sharp.get(50, 30)), (1.0, 0.0));
    }

    #[test]
    fn a_sphere_covers_its_disc() {
        let sphere = sphere();
        let got: f32 = cover(sphere.clone(), 5.0).pixels().iter().sum();
        let want = std::f32::consts::PI * outline().powi(2);
        assert!((got / want - 1.0).abs() < 0.01, "{got} against {want} pixels");
        assert_eq!(
            cover(sphere, 1.0).pixels().iter().sum::<f32>(),
            0.0,
            "a wall before it hides it"
        );
    }

    #[test]
    fn lights_behind_or_around_the_camera_are_sound() {
        let behind =
            Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::new(0.0, 0.0, 3.0), radius: 0.5 }));
        assert_eq!(cover(behind, 5.0).pixels().iter().sum::<f32>(), 0.0);
        let around = Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::ZERO, radius: 0.5 }));
        assert!(cover(around, 5.0).pixels().iter().all(|c| (0.0..=1.0).contains(c)));
        assert_eq!(cover(Shape::Absent, 5.0).pixels().iter().sum::<f32>(), 0.0);
    }
}
