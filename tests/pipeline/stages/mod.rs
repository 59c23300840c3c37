//! Single stages, called without an engine, on a room whose lights, albedo and shading are known.

mod edit;
mod estimate;
mod find;
mod render;

use std::sync::OnceLock;

use glam::Vec3;
use relight::optics::{Lamp, Lobe, Shape, SphereLamp, Window};

use crate::common::scene::Scene;

/// Width and height of photos.
const SIZE: (usize, usize) = (128, 96);
/// A lamp in view.
const LAMP: (Vec3, f32) = (Vec3::new(-0.6, 0.4, -3.0), 0.15);
/// A lamp over the camera, out of view.
const UNSEEN: (Vec3, f32) = (Vec3::new(0.8, 1.0, 0.3), 0.2);
const WARM: Vec3 = Vec3::new(22.0, 19.0, 14.0);
const WHITE: Vec3 = Vec3::new(16.0, 15.5, 15.0);
/// Radiance of sun, sky and ground.
const DAY: [Vec3; 3] = [Vec3::ZERO, Vec3::new(2.4, 2.7, 3.0), Vec3::new(1.0, 0.95, 0.85)];

fn sphere((center, radius): (Vec3, f32)) -> Shape {
    Shape::Lamp(Lamp::Sphere(SphereLamp { center, radius }))
}

/// A window in the left wall, 1.2 m wide and high, in view.
fn window() -> Window {
    let lobe = |direction: Vec3, bandwidth| Lobe { direction: direction.normalize(), bandwidth };
    let (sun, sky, ground) =
        (Vec3::new(-1.0, 0.6, 0.1), Vec3::new(-1.0, 1.0, -0.3), Vec3::new(-1.0, -0.7, 0.0));
    let lobes = [lobe(sun, 1e4), lobe(sky, 1.5), lobe(ground, 1.5)];
    Window { center: Vec3::new(-1.99, 0.2, -3.3), x: Vec3::NEG_Z * 0.6, y: Vec3::Y * 0.6, lobes }
}

/// The room under a lamp and a window in view and a lamp out of view.
fn scene() -> &'static Scene {
    static SCENE: OnceLock<Scene> = OnceLock::new();
    SCENE.get_or_init(|| {
        let lights = vec![
            ("lamp", sphere(LAMP), vec![WARM]),
            ("window", Shape::Window(window()), DAY.to_vec()),
            ("inv_lamp", sphere(UNSEEN), vec![WHITE]),
        ];
        Scene::new(SIZE, lights)
    })
}

fn center(shape: &Shape) -> Vec3 {
    shape.bounding_sphere().expect("there is a light").0
}

/// Largest difference of a channel over the largest wanted channel.
fn off(got: Vec3, wanted: Vec3) -> f32 {
    (got - wanted).abs().max_element() / wanted.max_element()
}
