//! Direct light on places that are above their surface already: samples and probes of inserted
//! bodies.

use super::direct;
use super::shadow::{ShadowQuality, shadow};
use crate::geometry::{Own, RoomCell, RoomLayout, SceneMesh};
use crate::image::{Mask, Normal, Plane, Points};
use crate::optics::{DirectEstimate, Sampling, Shape};

/// Irradiance / pi that arrives from each lobe of a light of unit radiance, shadows of the room and
/// of all bodies included; `own` are the pixels of the light, which do not block it. Shadows are
/// traced at every `stride`th place along each axis. Also the number of rays.
pub fn arriving(
    mesh: &SceneMesh,
    points: &Plane<glam::Vec3>,
    normals: &Plane<glam::Vec3>,
    shape: &Shape,
    own: Option<&Own>,
    (sampling, stride): (Sampling, usize),
    stop: &(dyn Fn() -> bool + Sync),
) -> (Vec<Plane<f32>>, u64) {
    if points.is_empty() {
        return (vec![Plane::filled(points.width(), points.height(), 0.0); shape.lobes()], 0);
    }
    let (points, normals) = (Points(points.clone()), Normal(normals.clone()));
    let DirectEstimate { mut lobes, .. } = direct(&points, &normals, shape, &sampling, stop);
    let quality =
        ShadowQuality { sampling, stride, assume_lit: 1.0, outside_unknown: false, lifted: true };
    let none = Mask(Plane::filled(points.0.width(), points.0.height(), 0.0));
    let own = own.map(|own| (own, &none));
    let shadow = shadow(mesh, &points, &normals, shape, own, quality, stop);
    for (direct, lit) in lobes.iter_mut().zip(&shadow.lit) {
        direct.pixels_mut().iter_mut().zip(lit.pixels()).for_each(|(e, v)| *e *= v);
    }
    (lobes, shadow.rays)
}

/// Irradiance / pi that arrives from each lobe of a light of unit radiance at the cells of a room's
/// sides, one row, shadows included: the mean over four places of each cell. Also the number of
/// rays. One place would lie too close to a lamp under the ceiling.
pub fn arriving_at_cells(
    mesh: &SceneMesh,
    layout: &RoomLayout,
    shape: &Shape,
    own: Option<&Own>,
    sampling: Sampling,
    stop: &(dyn Fn() -> bool + Sync),
) -> (Vec<Plane<f32>>, u64) {
    let cells = layout.cells();
    let places = |cell: usize, place: usize| {
        let RoomCell { center, half, .. } = cells[cell];
        let sign = |bit: usize| if place & bit == 0 { -0.5 } else { 0.5 };
        center + half[0] * sign(1) + half[1] * sign(2)
    };
    let points = Plane::from_fn(4, cells.len(), |place, cell| places(cell, place));
    let normals = Plane::from_fn(4, cells.len(), |_, cell| cells[cell].normal);
    let (lobes, rays) = arriving(mesh, &points, &normals, shape, own, (sampling, 1), stop);
    let mean = |lobe: &Plane<f32>| {
        let cell = |four: &[f32]| 0.25 * four.iter().sum::<f32>();
        Plane::new(cells.len(), 1, lobe.pixels().chunks(4).map(cell).collect())
    };
    (lobes.iter().map(mean).collect(), rays)
}

#[cfg(test)]
mod tests {
    use glam::{Mat3, Vec3};

    use super::*;
    use crate::geometry::{Bodies, Body, Camera, Model};
    use crate::image::{Albedo, Shading};
    use crate::optics::{
        Bounces, Lamp, Probed, SphereLamp, indirect, sphere_irradiance, trace_bounces,
    };

    fn ball(center: Vec3, radius: f32) -> Bodies {
        let body = Body::placed(Model::sphere(), None, Mat3::IDENTITY, radius, Vec3::ZERO, center);
        Bodies::new(&[body], 400).0
    }

    /// A wall at 4 m that fills the view, or with `seen` false nothing at all.
    fn wall(seen: bool) -> (Camera, SceneMesh, Points, Normal) {
        let camera = Camera::from_fov_x(160, 120, 60.0);
        let points = Points(Plane::from_fn(160, 120, |x, y| camera.pixel_point(x, y, 4.0)));
        let mesh = SceneMesh::new(&points, camera.fx, 0.0, &Plane::filled(160, 120, !seen));
        (camera, mesh, points, Normal(Plane::filled(160, 120, Vec3::Z)))
    }

    fn lamp(center: Vec3) -> Shape {
        Shape::Lamp(Lamp::Sphere(SphereLamp { center, radius: 0.01 }))
    }

    const SAMPLING: fn() -> Sampling = || Sampling::fixed(16, 1);

    #[test]
    fn the_shadow_of_a_ball_has_the_area_of_its_cone() {
        let (camera, mesh, points, normal) = wall(true);
        let mesh = mesh.with_bodies(ball(Vec3::new(0.0, 0.0, -2.5), 0.2));
        let quality = ShadowQuality {
            sampling: SAMPLING(),
            stride: 1,
            assume_lit: 1.0,
            outside_unknown: false,
            lifted: false,
        };
        let shadow = shadow(
            &mesh,
            &points,
            &normal,
            &lamp(Vec3::new(0.0, 0.0, -1.0)),
            None,
            quality,
            &|| false,
        );
        let pixel = (4.0 / camera.fx) * (4.0 / camera.fy);
        let got: f32 = shadow.lit[0].pixels().iter().map(|lit| (1.0 - lit) * pixel).sum();
        // From 1 m before the camera the ball is seen within asin(0.2 / 1.5), and the wall is 3 m
        // away.
        let want = std::f32::consts::PI * (3.0 * (0.2f32 / 1.5).asin().tan()).powi(2);
        assert!((got / want - 1.0).abs() < 0.02, "{got} against {want} square metres");
    }

    #[test]
    fn a_ball_is_lit_as_the_closed_form_says_and_does_not_shade_its_lit_side() {
        let (_, mesh, ..) = wall(true);
        for radius in [0.0005, 0.2] {
            let center = Vec3::new(0.1, 0.0, -2.5);
            let mesh = mesh.with_bodies(ball(center, radius));
            let light = Vec3::new(0.5, 0.7, -1.0);
            let probes = mesh.bodies().probes();
            let (lobes, rays) = arriving(
                &mesh,
                &probes.points,
                &probes.normals,
                &lamp(light),
                None,
                (SAMPLING(), 1),
                &|| false,
            );
            assert!(rays > 0);
            let (mut got, mut want) = (0.0, 0.0);
            for i in 0..probes.len() {
                let (p, n) =
                    (probes.points.pixels()[i].as_dvec3(), probes.normals.pixels()[i].as_dvec3());
                want += sphere_irradiance(light.as_dvec3() - p, 0.01, n);
                got += f64::from(lobes[0].pixels()[i]);
            }
            assert!((got / want - 1.0).abs() < 0.005, "radius {radius}: {got} against {want}");
        }
    }

    /// Furnace: in an even surround a ball shows exactly its albedo, and where everything has one
    /// albedo and one direct light, all bounces together are the geometric series, on the wall as
    /// on the ball.
    #[test]
    fn an_even_surround_is_even_on_a_ball() {
        let (_, mesh, points, normal) = wall(false);
        let mesh = mesh.with_bodies(ball(Vec3::new(0.0, 0.0, -2.5), 0.3));
        let transport = trace_bounces(&mesh, &points, &normal, None, (8, 64), 0);
        let (_, probes) = transport.ambient_around(&points, &normal, &[Vec3::ONE; 400]);
        assert_eq!(probes.len(), 400);
        assert!(
            probes.iter().all(|a| (*a - Vec3::ONE).abs().max_element() < 1e-6),
            "nothing stands around it"
        );

        let (_, mesh, points, normal) = wall(true);
        let mesh = mesh.with_bodies(ball(Vec3::new(0.0, 0.0, -2.5), 0.3));
        let transport = trace_bounces(&mesh, &points, &normal, None, (8, 64), 0);
        let albedo = Vec3::new(0.5, 0.2, 0.8);
        let (direct, albedos) = (Plane::filled(160, 120, 1.0), vec![albedo; 400]);
        let probed = Probed { albedo: &albedos, direct: &[1.0; 400] };
        let bounces = Bounces { count: 4, unseen: 1.0 };
        let room = Albedo(Plane::filled(160, 120, albedo));
        let (Shading(wall), _, ball) =
            indirect(&transport, &points, &normal, &room, &direct, probed, bounces);
        let want = albedo / (Vec3::ONE - albedo);
        for e in wall.pixels().iter().chain(&ball) {
            assert!((*e / want - Vec3::ONE).abs().max_element() < 1e-4, "{e} against {want}");
        }
    }

    /// The wall beside a ball, or behind one that touches it, sees less of a uniform ambient. Its
    /// loss is the fraction of the cosine-weighted hemisphere that the ball occludes, which is the
    /// irradiance of a sphere lamp. Close to the ball every pixel is estimated, farther off only
    /// the receivers.
    #[test]
    fn a_ball_hides_its_share_of_the_ambient() {
        let (_, bare, points, normal) = wall(true);
        for center in [Vec3::new(0.0, 0.0, -3.4), Vec3::new(0.1, 0.0, -3.61)] {
            let transports = [&bare, &bare.with_bodies(ball(center, 0.39))]
                .map(|mesh| trace_bounces(mesh, &points, &normal, None, (8, 1024), 0));
            let was = transports[0].grid().upsample(&points, &normal, &transports[0].ambient());
            let (is, _) = transports[1].ambient_around(&points, &normal, &[Vec3::ZERO; 400]);
            let (mut near, mut sum) = (0, 0.0);
            for (i, (was, is)) in was.pixels().iter().zip(is.pixels()).enumerate() {
                let p = points.0.pixels()[i];
                let hidden =
                    sphere_irradiance((center - p).as_dvec3(), 0.39, glam::DVec3::Z) as f32;
                let off = (was.x - is.x - hidden).abs();
                let close = p.distance(center) < 2.0 * 0.39;
                assert!(
                    off < if close { 0.03 } else { 0.06 },
                    "at {p}: {was} - {is} against {hidden}"
                );
                if close {
                    near += 1;
                    sum += off;
                }
            }
            let mean = sum / near as f32;
            assert!(near > 500 && mean < 1e-3, "{near} pixels close to it, {mean} off on the mean");
        }
    }

    /// Furnace: where a ball touches a wall of its own albedo and direct light, neither is seen to
    /// touch.
    #[test]
    fn a_furnace_has_no_contact_shadow() {
        let (_, mesh, points, normal) = wall(true);
        let mesh = mesh.with_bodies(ball(Vec3::new(0.0, 0.0, -3.61), 0.39));
        let transport = trace_bounces(&mesh, &points, &normal, None, (8, 64), 0);
        let albedo = Vec3::new(0.5, 0.2, 0.8);
        let (direct, albedos) = (Plane::filled(160, 120, 1.0), vec![albedo; 400]);
        let probed = Probed { albedo: &albedos, direct: &[1.0; 400] };
        let room = Albedo(Plane::filled(160, 120, albedo));
        let bounces = Bounces { count: 4, unseen: 1.0 };
        let (Shading(wall), ..) =
            indirect(&transport, &points, &normal, &room, &direct, probed, bounces);
        let want = albedo / (Vec3::ONE - albedo);
        for (e, p) in wall.pixels().iter().zip(points.0.pixels()) {
            assert!(
                (*e / want - Vec3::ONE).abs().max_element() < 0.01,
                "at {p}: {e} against {want}"
            );
        }
    }
}
