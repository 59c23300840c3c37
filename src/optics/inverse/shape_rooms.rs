//! Rooms whose lights are known: from a start that is off, the fit must find back.

use super::*;
use crate::geometry::SceneMesh;
use crate::image::{Albedo, Normal as Normals, Picture, Plane, Points, Segments};
use crate::optics::inverse::SeenRoom;
use crate::optics::{
    Bounces, Lamp, LightTransport, Lobe, Probed, RectLamp, Sampling, ShadowQuality, SphereLamp,
    Window, direct, indirect, shadow, trace_bounces,
};

const SIZE: (usize, usize) = (160, 120);

/// A bare room of 4 x 2.5 x 13 m with a block on its floor, each side of either of its own paint.
struct Room {
    camera: Camera,
    points: Points,
    normal: Normals,
    mesh: SceneMesh,
    transport: LightTransport,
    albedo: Albedo,
    segments: Segments,
    dark: Mask,
}

impl Room {
    fn new() -> Room {
        let (w, h) = SIZE;
        let camera = Camera::from_fov_x(w, h, 75.0);
        let boxes = [
            (Vec3::new(-2.0, -1.2, -4.0), Vec3::new(2.0, 1.3, 9.0), -1.0),
            (Vec3::new(0.2, -1.3, -3.2), Vec3::new(0.8, -0.5, -2.6), 1.0),
        ];
        // The nearest side along a ray, its normal and its number: of the room the far ones, of the
        // block the near ones.
        let met = |ray: Vec3| {
            let hit = |side: u32| {
                let (low, high, out) = boxes[side as usize / 6];
                let axis = side as usize % 3;
                let (end, sign) = if side % 6 < 3 { (low, -out) } else { (high, out) };
                let t = end[axis] / ray[axis];
                let at = ray * t;
                let inside = (0..3).all(|k| k == axis || (low[k]..=high[k]).contains(&at[k]));
                (t > 0.0 && sign * ray[axis] < 0.0 && inside)
                    .then(|| (t, Vec3::AXES[axis] * sign, side))
            };
            (0..12)
                .filter_map(hit)
                .reduce(|a, b| if b.0 < a.0 { b } else { a })
                .expect("a closed room")
        };
        let ray = |x, y| camera.pixel_point(x, y, 1.0);
        let points = Points(Plane::from_fn(w, h, |x, y| ray(x, y) * met(ray(x, y)).0));
        let normal = Normals(Plane::from_fn(w, h, |x, y| met(ray(x, y)).1));
        let mesh = SceneMesh::new(&points, camera.fx, 0.0, &Plane::filled(w, h, false));
        let transport = trace_bounces(&mesh, &points, &normal, None, (4, 32), 0);
        let paint =
            |side: u32| Vec3::new(0.5, 0.35, 0.25).lerp(Vec3::splat(0.7), side as f32 / 11.0);
        let label = Plane::from_fn(w, h, |x, y| met(ray(x, y)).2);
        Room {
            albedo: Albedo(label.map(paint)),
            segments: Segments { label, count: 12 },
            dark: Mask(Plane::filled(w, h, 0.0)),
            camera,
            points,
            normal,
            mesh,
            transport,
        }
    }

    /// The photo under these lights, 16 shadow rays a pixel.
    fn photo(&self, lights: &[(Shape, Vec<Vec3>)]) -> Picture {
        let sampling = Sampling::fixed(16, 3);
        let quality = ShadowQuality {
            sampling,
            stride: 1,
            assume_lit: 1.0,
            outside_unknown: false,
            lifted: false,
        };
        let mut sum = Plane::filled(SIZE.0, SIZE.1, Vec3::ZERO);
        for (shape, radiance) in lights {
            let direct = direct(&self.points, &self.normal, shape, &sampling, &|| false);
            let shadow =
                shadow(&self.mesh, &self.points, &self.normal, shape, None, quality, &|| false);
            for ((e, lit), w) in direct.lobes.iter().zip(&shadow.lit).zip(radiance) {
                let lit = Plane::from_fn(SIZE.0, SIZE.1, |x, y| e.get(x, y) * lit.get(x, y));
                let bounces = Bounces { count: 2, unseen: 0.5 };
                let (bounced, ..) = indirect(
                    &self.transport,
                    &self.points,
                    &self.normal,
                    &self.albedo,
                    &lit,
                    Probed::NONE,
                    bounces,
                );
                sum = Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
                    sum.get(x, y) + *w * (bounced.0.get(x, y) + Vec3::splat(lit.get(x, y)))
                });
            }
        }
        Picture(Plane::from_fn(SIZE.0, SIZE.1, |x, y| sum.get(x, y) * self.albedo.0.get(x, y)))
    }

    fn fit(&self, photo: &Picture, lights: &[(Shape, DegreesOfFreedom)]) -> ShapeFit {
        let Room { points, normal, mesh, transport, albedo, segments, dark, camera } = self;
        let (clipped, layout) = (dark, None);
        let room =
            SeenRoom { photo, clipped, points, normal, mesh, transport, layout, albedo, segments };
        let receivers = Receivers::new(room, std::iter::empty(), usize::MAX);
        let movable = |(shape, freedom): &(Shape, DegreesOfFreedom)| LightVariable {
            shape: shape.clone(),
            mask: None,
            freedom: *freedom,
            in_view: *freedom == DegreesOfFreedom::InView,
        };
        let lights: Vec<LightVariable> = lights.iter().map(movable).collect();
        let search = ShapeSearch {
            quality: LayerQuality { samples: 16, bounces: Bounces { count: 2, unseen: 0.5 } },
            rounds: 4,
            steps: 10,
            min_gain: 0.02,
            prior: LightPrior { ambient: 0.01, ..LightPrior::default() },
        };
        fit_shapes(&receivers, &lights, &Bounds { camera, room: None }, &search)
    }
}

fn sphere(center: Vec3, radius: f32) -> Shape {
    Shape::Lamp(Lamp::Sphere(SphereLamp { center, radius }))
}

fn center(shape: &Shape) -> Vec3 {
    shape.bounding_sphere().expect("a light").0
}

/// A window in the left wall.
fn window(lobes: [(Vec3, f32); 3]) -> Shape {
    let lobes =
        lobes.map(|(direction, bandwidth)| Lobe { direction: direction.normalize(), bandwidth });
    Shape::Window(Window {
        center: Vec3::new(-1.99, 0.2, -2.6),
        x: Vec3::NEG_Z * 0.6,
        y: Vec3::Y * 0.6,
        lobes,
    })
}

const WHITE: Vec3 = Vec3::new(20.0, 19.0, 18.0);

#[test]
fn lamps_come_back() {
    let room = Room::new();
    let seen = Vec3::new(-0.6, 0.4, -3.0);
    let unseen = Vec3::new(0.8, 1.0, 0.3);
    let photo =
        room.photo(&[(sphere(seen, 0.12), vec![WHITE]), (sphere(unseen, 0.2), vec![WHITE * 2.0])]);
    // The unseen one starts 0.4 m off; the prior keeps a third of it.
    let start = [
        (sphere(seen * 1.02, 0.12 * 1.02), DegreesOfFreedom::InView),
        (sphere(unseen + Vec3::new(-0.3, 0.1, 0.25), 0.2), DegreesOfFreedom::OutOfView),
    ];
    let fit = room.fit(&photo, &start);
    assert!(center(&fit.shapes[0]).distance(seen) < 0.5 * 0.02 * seen.length(), "{fit:?}");
    assert!(center(&fit.shapes[1]).distance(unseen) < 0.16, "{fit:?}");
    // The remainder is the noise of shadows.
    assert!(fit.loss[1] < 0.6 * fit.loss[0], "{fit:?}");
    assert!(fit.saved.iter().all(|saved| *saved > 0.02), "{fit:?}");
}

#[test]
fn what_a_window_looks_out_on_comes_back() {
    let room = Room::new();
    let (sun, sky, ground) =
        (Vec3::new(-1.0, 0.6, 0.1), Vec3::new(-1.0, 1.0, -0.3), Vec3::new(-1.0, -0.7, 0.0));
    let truth = window([(sun, 1e4), (sky, 3.0), (ground, 1.5)]);
    let photo = room.photo(&[(truth, vec![WHITE * 1000.0, WHITE * 0.5, WHITE * 0.2])]);
    let start = window([
        (sun + Vec3::new(0.0, 0.01, -0.01), 1e4),
        (sky + Vec3::new(0.0, -0.3, 0.2), 1.5),
        (ground, 1.5),
    ]);
    let fit = room.fit(&photo, &[(start, DegreesOfFreedom::InView)]);
    let Shape::Window(found) = &fit.shapes[0] else { panic!("a window") };
    let off = |k: usize, truth: Vec3| found.lobes[k].direction.angle_between(truth);
    // The sun started a lobe's width off, the sky 0.26 rad; it is broad, and a broader one in
    // between looks much the same.
    assert!(off(0, sun.normalize()) < 0.003, "{fit:?}");
    assert!(off(1, sky.normalize()) < 0.18, "{fit:?}");
    assert!(fit.loss[1] < 0.75 * fit.loss[0], "{fit:?}");
}

#[test]
fn what_is_right_stays_to_the_bit() {
    let room = Room::new();
    let lamp = sphere(Vec3::new(0.8, 1.0, 0.3), 0.2);
    let photo = room.photo(&[(lamp.clone(), vec![WHITE])]);
    for freedom in [DegreesOfFreedom::InView, DegreesOfFreedom::OutOfView, DegreesOfFreedom::Fixed]
    {
        let fit = room
            .fit(&photo, &[(lamp.clone(), freedom), (Shape::Absent, DegreesOfFreedom::OutOfView)]);
        assert_eq!(fit.shapes, [lamp.clone(), Shape::Absent]);
        assert_eq!(fit.saved, [0.0; 2]);
    }
}

#[test]
fn lights_in_one_place_are_told_and_finite() {
    let room = Room::new();
    let lamp = sphere(Vec3::new(0.8, 1.0, 0.3), 0.2);
    let photo = room.photo(&[(lamp.clone(), vec![WHITE])]);
    let start = Parameter::Shift(Vec3::X * 0.3).moved(&lamp, -1.0);
    let fit = room.fit(
        &photo,
        &[(start.clone(), DegreesOfFreedom::OutOfView), (start, DegreesOfFreedom::OutOfView)],
    );
    assert!(fit.conditioning.number > 1e6 && fit.conditioning.most_correlated.is_some(), "{fit:?}");
    assert!(fit.shapes.iter().all(|shape| center(shape).is_finite()), "{fit:?}");
    assert!(fit.loss[1] <= fit.loss[0], "{fit:?}");
}

#[test]
fn nothing_seen_moves_nothing() {
    let room = Room::new();
    let lamp = sphere(Vec3::new(0.8, 1.0, 0.3), 0.2);
    let black = Picture(Plane::filled(SIZE.0, SIZE.1, Vec3::ZERO));
    assert_eq!(room.fit(&black, &[(lamp.clone(), DegreesOfFreedom::OutOfView)]).shapes[0], lamp);
    assert!(room.fit(&black, &[]).shapes.is_empty());
    // A lamp that lights no seen surface.
    let photo = room.photo(&[(lamp, vec![WHITE])]);
    let away =
        Shape::Lamp(Lamp::Rect(RectLamp { center: Vec3::Z, x: Vec3::X * 0.1, y: Vec3::Y * 0.1 }));
    assert_eq!(room.fit(&photo, &[(away.clone(), DegreesOfFreedom::OutOfView)]).shapes, [away]);
}
