//! `ShadeObjects`, `InsertSpecular` and `OccludeResidual` on a ball.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{Mat3, Vec2, Vec3};
use relight::geometry::{Bodies, Body, Camera, Drawing, Material, Model, Objects, SceneMesh, draw};
use relight::graph::{Context, Gather, Node, NodeError};
use relight::image::{Plane, Shading};
use relight::nodes::artifacts::{ObjectLight, UnitIndirect};
use relight::nodes::render::insert_specular::{InsertSpecular, InsertSpecularIn};
use relight::nodes::render::light_objects::{LightObjects, LightObjectsIn};
use relight::nodes::render::occlude_residual::{
    OccludeResidual, OccludeResidualIn, OccludeResidualOut,
};
use relight::nodes::render::shade_objects::{ShadeObjects, ShadeObjectsIn, ShadeObjectsOut};
use relight::nodes::render::transport::{Transport, TransportIn};
use relight::optics::{Radiance, ReflectedHit, Reflections, Shape};

use super::*;
use crate::common::room::Room;
use crate::common::scene::Scene;

/// Number of points on a ball at which its bounces are computed.
const PROBES: usize = 400;

/// A ball in a room: its visible pixels, and the room with it.
struct Ball {
    center: Vec3,
    radius: f32,
    objects: Arc<Objects>,
    mesh: Arc<SceneMesh>,
}

impl Ball {
    fn new(room: &Room, center: Vec3, radius: f32, material: Material) -> Ball {
        let bodies = [Body::placed(
            Model::sphere(),
            Some(material),
            Mat3::IDENTITY,
            radius,
            Vec3::ZERO,
            center,
        )];
        let (solid, materials) = Bodies::new(&bodies, PROBES);
        let drawing = Drawing { supersampling: 4, most: 60_000 };
        let error = |z: f32| room.mesh.depth_error(z);
        let objects =
            draw(&bodies, (&solid, &materials), &room.camera, &room.depth, error, drawing);
        Ball {
            center,
            radius,
            objects: Arc::new(objects),
            mesh: Arc::new(room.mesh.with_bodies(solid)),
        }
    }

    /// Pixels that it covers wholly, with the place and the normal at their middle, in closed form.
    fn pixels<'a>(&'a self, camera: &'a Camera) -> impl Iterator<Item = (usize, Vec3, Vec3)> + 'a {
        let (w, h) = self.objects.coverage.size();
        let whole = (0..w * h).filter(|&i| self.objects.coverage.pixels()[i] == 1.0);
        whole.filter_map(move |i| {
            let ray = camera.pixel_point(self.objects.left + i % w, self.objects.top + i / w, 1.0);
            let t = sphere((self.center, self.radius)).intersect(Vec3::ZERO, ray)?;
            Some((i, ray * t, (ray * t - self.center) / self.radius))
        })
    }
}

fn wall() -> Room {
    Room::new(Camera::from_fov_x(96, 72, 60.0), |_, _| 4.0)
}

const MATTE: Material =
    Material { albedo: Vec3::new(0.2, 0.6, 0.9), roughness: 1.0, specular: 0.5, metallic: 0.25 };

fn shade(
    ball: &Ball,
    light: ObjectLight,
    indirect: Vec3,
    radiance: &[Vec3],
) -> Result<ShadeObjectsOut, NodeError> {
    let probes = light.lobes.iter().map(|_| Plane::filled(PROBES, 1, indirect)).collect();
    let inputs = ShadeObjectsIn {
        objects: ball.objects.clone(),
        light: Arc::new(light),
        indirect: Arc::new(UnitIndirect { lobes: vec![], stderr: vec![], probes, cells: vec![] }),
        radiance: Arc::new(Radiance(radiance.to_vec())),
    };
    ShadeObjects {}.run(inputs, &Context::default())
}

/// Irradiance / pi of a sphere of radius r at distance d, wholly above the horizon, is (r / d)^2
/// cos(theta). The ball is of 20,480 triangles with smooth normals, and its lit side is not in its
/// own shadow: 1 %.
#[test]
fn shade_objects_gives_a_matte_ball_its_closed_form() {
    let room = wall();
    let ball = Ball::new(&room, Vec3::new(0.1, 0.0, -2.5), 0.4, MATTE);
    let lamp = (Vec3::new(0.7, 0.9, -0.8), 0.1);
    let inputs = LightObjectsIn {
        objects: ball.objects.clone(),
        mesh: ball.mesh.clone(),
        shape: Arc::new(sphere(lamp)),
    };
    let light =
        LightObjects::default().run(inputs, &Context::default()).expect("the light is sound").light;
    let bounced = Vec3::new(0.002, 0.003, 0.001);
    let shown = shade(&ball, ObjectLight::clone(&light), bounced, &[WARM]).expect("one lobe").shown;
    assert_eq!(ball.objects.step, 1, "each pixel has a sample of its own");
    let (mut count, mut worst) = (0, 0.0f32);
    for (i, ..) in ball.pixels(&room.camera) {
        let point = ball.objects.points.pixels()[i];
        let (normal, way) = ((point - ball.center).normalize(), lamp.0 - point);
        let cos = normal.dot(way.normalize());
        if cos < 0.2 {
            continue;
        }
        let direct = lamp.1 * lamp.1 / way.length_squared() * cos;
        let wanted = MATTE.albedo * (1.0 - MATTE.metallic) * WARM * (Vec3::splat(direct) + bounced);
        count += 1;
        worst = worst.max(off(shown.0.pixels()[i], wanted));
    }
    assert!(count > 300 && worst < 0.01, "{count} pixels, at most {worst} off");

    // Linear in the radiance; without light there is nothing; a lobe too many is an error.
    let twice =
        shade(&ball, ObjectLight::clone(&light), bounced, &[2.0 * WARM]).expect("one lobe").shown;
    assert_eq!(twice.0, shown.0.map(|shown| 2.0 * shown));
    let dark =
        shade(&ball, ObjectLight::clone(&light), bounced, &[Vec3::ZERO]).expect("one lobe").shown;
    assert!(dark.0.pixels().iter().all(|shown| *shown == Vec3::ZERO));
    let message = shade(&ball, ObjectLight::clone(&light), bounced, &[WARM; 2])
        .map(drop)
        .expect_err("a lobe is missing");
    assert!(
        message.to_string().contains("`light` has 1 lobes of bodies, wanted 2 as `radiance`"),
        "{message}"
    );
}

fn reflected(scene: &Scene, ball: &Ball, shape: Gather<Shape>) -> Arc<Reflections> {
    let inputs = InsertSpecularIn {
        objects: ball.objects.clone(),
        mesh: ball.mesh.clone(),
        camera: scene.camera.clone(),
        points: scene.points.clone(),
        normal: scene.normal.clone(),
        mask: scene.masks(),
        shape,
        layout: None,
        lighting: None,
    };
    InsertSpecular::default().run(inputs, &Context::default()).expect("the room is sound").reflected
}

fn metal(roughness: f32) -> Material {
    Material { albedo: Vec3::ONE, roughness, specular: 0.5, metallic: 1.0 }
}

/// White metal reflects all that it meets and no more: the weights of a pixel's rays sum to one for
/// a mirror, and to less the rougher it is, by the shadowing of its facets. Single pixels of 32
/// rays stray by a tenth.
#[test]
fn weights_of_reflections_sum_to_at_most_one() {
    let scene = Scene::new((96, 72), vec![]);
    for roughness in [0.0, 0.2, 0.5, 0.9] {
        let ball = Ball::new(&scene.room, Vec3::new(-0.3, -0.2, -2.6), 0.6, metal(roughness));
        let of = reflected(&scene, &ball, Gather(vec![]));
        let rays = of.hits.width();
        let (mut low, mut high, mut mean, mut count) = (f32::MAX, 0.0f32, 0.0, 0.0);
        for (i, ..) in ball.pixels(&scene.camera) {
            let weights = &of.weight.pixels()[i * rays..(i + 1) * rays];
            assert!(weights.iter().all(|weight| weight.min_element() >= 0.0));
            let sum = weights.iter().sum::<Vec3>().max_element();
            (low, high, mean, count) = (low.min(sum), high.max(sum), mean + sum, count + 1.0);
        }
        assert!(
            count > 100.0 && high < 1.1 && mean / count <= 1.0,
            "{roughness}: up to {high}, {}",
            mean / count
        );
        if roughness == 0.0 {
            assert!(low > 0.99 && high < 1.0 + 1e-5, "a mirror: {low} to {high}");
        }
    }
}

/// The direction of a mirror is `d - 2 (d . n) n`; its pixel shows the point where that ray meets
/// the room, in closed form. The mean over the rays of a pixel, which start all over it, is that of
/// its middle to second order.
#[test]
fn a_mirror_looks_where_it_should() {
    let scene = Scene::new((160, 120), vec![]);
    let ball = Ball::new(&scene.room, Vec3::new(-0.4, -0.1, -2.6), 0.8, metal(0.0));
    let of = reflected(&scene, &ball, Gather(vec![]));
    let camera = &scene.camera;
    let rays = of.hits.width();
    let mut far = Vec::new();
    for (i, point, normal) in ball.pixels(camera) {
        let way = point - 2.0 * point.dot(normal) * normal;
        let place = point + way * scene.boxes.cast(point, way).t;
        let Some(wanted) = camera.project(place).filter(|at| camera.contains(*at)) else {
            continue;
        };
        let hits = of.hits.pixels()[i * rays..(i + 1) * rays].iter().map(|end| end.hit());
        let hits: Vec<ReflectedHit> = hits.filter(|hit| *hit != ReflectedHit::Nothing).collect();
        let of_photo = |hit: &ReflectedHit| match *hit {
            ReflectedHit::Pixel(i) if i < camera.width * camera.height => {
                Some(Vec2::new((i % camera.width) as f32 + 0.5, (i / camera.width) as f32 + 0.5))
            }
            _ => None,
        };
        let Some(at) = hits.iter().map(of_photo).collect::<Option<Vec<Vec2>>>() else { continue };
        let mean = at.iter().sum::<Vec2>() / at.len() as f32;
        far.push(mean.distance(wanted));
    }
    far.sort_by(f32::total_cmp);
    assert!(far.len() > 500, "{} pixels show what is seen", far.len());
    let [median, most] = [far[far.len() / 2], far[far.len() * 9 / 10]];
    // The position of a hit pixel is exact to half a pixel; one ray in ten passes an edge of the
    // block.
    assert!(
        median < 0.5 && most < 1.5,
        "half of them within {median}, nine of ten within {most} pixels"
    );
}

/// A mirror of white metal shows a lamp of unit radiance as bright as it is, where its direction
/// meets the lamp.
#[test]
fn a_mirror_shows_a_lamp_where_its_direction_meets_it() {
    let scene = Scene::new((160, 120), vec![]);
    let ball = Ball::new(&scene.room, Vec3::new(-0.4, -0.1, -2.6), 0.6, metal(0.0));
    let lamp = sphere((Vec3::new(0.9, 0.8, -1.0), 0.4));
    let of = reflected(&scene, &ball, Gather(vec![("lamp".into(), Arc::new(lamp.clone()))]));
    let shown = &of.lights[0].1[0];
    let (mut inside, mut outside) = (Vec::new(), Vec::new());
    let (w, _) = ball.objects.coverage.size();
    let meets: BTreeMap<usize, bool> = ball
        .pixels(&scene.camera)
        .map(|(i, point, normal)| {
            (i, lamp.intersect(point, point - 2.0 * point.dot(normal) * normal).is_some())
        })
        .collect();
    for &i in meets.keys() {
        // Away from the outline of the lamp, whose pixels are mixtures.
        let around =
            [i, i.wrapping_sub(1), i + 1, i.wrapping_sub(w), i + w].map(|j| meets.get(&j).copied());
        if around == [Some(true); 5] {
            inside.push(shown.pixels()[i].x);
        } else if around == [Some(false); 5] {
            outside.push(shown.pixels()[i].x);
        }
    }
    assert!(
        inside.len() > 5 && outside.len() > 500,
        "{} pixels of the lamp, {} of none",
        inside.len(),
        outside.len()
    );
    assert!(inside.iter().all(|shown| (shown - 1.0).abs() < 0.01), "{inside:?}");
    assert!(outside.iter().all(|shown| *shown < 1e-4), "{outside:?}");
}

/// `residual` of the room where a ball stands before its wall.
fn occlude(room: &Room, ball: &Ball, residual: &Arc<Shading>) -> OccludeResidualOut {
    let trace = |mesh: &Arc<SceneMesh>| {
        let inputs = TransportIn {
            mesh: mesh.clone(),
            points: room.points.clone(),
            normal: room.normal.clone(),
            layout: None,
        };
        let stage = Transport { rays: 512, ..Transport::default() };
        stage.run(inputs, &Context::default()).expect("the room is sound").transport
    };
    let inputs = OccludeResidualIn {
        residual: residual.clone(),
        before: trace(&room.mesh),
        after: trace(&ball.mesh),
        points: room.points.clone(),
        normal: room.normal.clone(),
        objects: ball.objects.clone(),
    };
    OccludeResidual {}.run(inputs, &Context::default()).expect("the room is sound")
}

/// A wall that sees nothing but the ambient loses to a black ball its share of the cosine-weighted
/// hemisphere, (R / d)^2 cos(theta), which 512 rays estimate to 0.02 (one standard error at a
/// half), less the mean over neighbors.
#[test]
fn occlude_rest_takes_what_the_ball_hides() {
    let room = wall();
    let black = Material { albedo: Vec3::ZERO, ..MATTE };
    let (center, radius) = (Vec3::new(0.0, 0.0, -3.4), 0.39);
    let ball = Ball::new(&room, center, radius, black);
    let level = Vec3::new(0.3, 0.2, 0.1);
    let residual = Arc::new(Shading(room.points.0.map(|_| level)));
    let out = occlude(&room, &ball, &residual);
    let (mut near, mut away, mut least, mut worst) = (0, 0, 1.0f32, 0.0f32);
    for (left, point) in out.residual.0.pixels().iter().zip(room.points.0.pixels()) {
        let share = (*left / level).x;
        assert!((0.0..=1.0 + 1e-6).contains(&share), "{share} at {point}");
        let way = center - *point;
        let hidden = radius * radius / way.length_squared() * (way.z / way.length());
        worst = worst.max((1.0 - share - hidden).abs());
        near += usize::from(way.length() < 2.0 * radius);
        if way.length() > 5.0 * radius {
            away += 1;
            assert!(share > 0.98, "far from the ball, {share} at {point}");
        }
        least = least.min(share);
    }
    assert!(
        near > 300 && away > 300 && least < 0.6,
        "{near} pixels close to it, {away} far from it, {least}"
    );
    assert!(worst < 0.03, "{worst}");
    assert!(
        out.shown.0.pixels().iter().all(|shown| *shown == Vec3::ZERO),
        "a black ball shows nothing"
    );

    // A matte ball shows the ambient that reaches it times its color: at its front all of it.
    let ball = Ball::new(&room, center, radius, MATTE);
    let shown = occlude(&room, &ball, &residual).shown;
    let mut worst = 0.0f32;
    for (i, point, normal) in ball.pixels(&room.camera) {
        if normal.dot(-point.normalize()) > 0.9 {
            worst =
                worst.max(off(shown.0.pixels()[i], level * MATTE.albedo * (1.0 - MATTE.metallic)));
        }
    }
    // Rays of 400 probes, and the mean over eight of them.
    assert!(worst > 0.0 && worst < 0.01, "{worst}");
}

#[test]
fn without_bodies_the_rest_passes_through() {
    let room = wall();
    let residual = Arc::new(Shading(room.points.0.map(|p| Vec3::splat(0.1 * p.x.abs()))));
    let inputs = OccludeResidualIn {
        residual: residual.clone(),
        before: room.transport.clone(),
        after: room.transport.clone(),
        points: room.points.clone(),
        normal: room.normal.clone(),
        objects: Arc::new(Objects::unseen(&[])),
    };
    let out = OccludeResidual {}.run(inputs, &Context::default()).expect("the room is sound");
    assert!(Arc::ptr_eq(&out.residual, &residual) && out.shown.0.is_empty());
}
