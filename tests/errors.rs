//! Calibration of standard errors: intervals contain the truth as often as they should, targets are
//! reached, and errors fall at the expected rate. The truth is the same estimate with many more
//! samples of another seed.

mod common;

use std::sync::Arc;

use glam::{Quat, Vec3};
use relight::geometry::{Camera, KnownSide, LayoutGuess, RoomLayout, SideSource};
use relight::graph::{Context, Node};
use relight::image::{Albedo, Plane, Shading, luminance};
use relight::nodes::artifacts::{UnitDirect, UnitIndirect, Visibility};
use relight::nodes::render::direct::Direct;
use relight::nodes::render::draw_rooms::{DrawRooms, DrawRoomsIn};
use relight::nodes::render::light_draws::{LightDraws, LightDrawsIn};
use relight::nodes::render::room_error::{RoomError, RoomErrorIn};
use relight::nodes::render::shadow::Shadow;
use relight::nodes::render::trace_indirect::{TraceIndirect, TraceIndirectIn};
use relight::nodes::render::transport::{Transport, TransportIn};
use relight::optics::{
    DrawDifferences, GuessDraw, INTERVAL, Lamp, Lobe, Radiance, RoomDraws, Shape, SphereLamp,
    Strategy, Window,
};

use common::room::Room;

/// A camera whose focal length is its width.
fn camera(width: usize) -> Camera {
    let (height, focal) = (width * 3 / 4, width as f32);
    Camera { width, height, fx: focal, fy: focal, cx: focal / 2.0, cy: height as f32 / 2.0 }
}

/// Returns the standard error and the mean number of samples that the stage recorded, too.
fn direct(room: &Room, stage: &Direct, shape: &Shape) -> (Arc<UnitDirect>, f64, f64) {
    let ctx = Context::default();
    let direct = stage.run(room.direct_in(shape), &ctx).unwrap().direct;
    (direct, ctx.stderr().unwrap(), ctx.samples().unwrap())
}

fn shadow(room: &Room, stage: &Shadow, shape: &Shape) -> (Arc<Visibility>, f64, f64) {
    let ctx = Context::default();
    let visibility = stage.run(room.shadow_in(shape, None), &ctx).unwrap().visibility;
    (visibility, ctx.stderr().unwrap(), ctx.samples().unwrap())
}

fn indirect(room: &Room, rays: u32, seed: u64, direct: &Arc<UnitDirect>) -> Arc<UnitIndirect> {
    let (points, normal) = (room.points.clone(), room.normal.clone());
    let inputs = TransportIn { mesh: room.mesh.clone(), points, normal, layout: None };
    let stage = Transport { rays, seed, ..Transport::default() };
    let transport = stage.run(inputs, &Context::default()).unwrap().transport;
    let (width, height) = room.size();
    let albedo = Arc::new(Albedo(Plane::from_fn(width, height, |x, _| {
        Vec3::splat(0.3 + 0.1 * (x / 4 % 5) as f32)
    })));
    let one: Vec<_> = direct.lobes.iter().map(|lobe| lobe.map(|_| 1.0)).collect();
    let zero: Vec<_> = direct.lobes.iter().map(|lobe| lobe.map(|_| 0.0)).collect();
    let visibility = Arc::new(Visibility { lit: one, stderr: zero.clone(), unknown: zero });
    let inputs = TraceIndirectIn { transport, ..room.indirect_in(&albedo, direct, &visibility) };
    TraceIndirect::default().run(inputs, &Context::default()).unwrap().indirect
}

/// A window behind the camera with a sun, a sky and an even lobe.
fn window(sun: f32) -> Shape {
    let lobe = |direction: Vec3, bandwidth| Lobe { direction: direction.normalize(), bandwidth };
    let lobes = [
        lobe(Vec3::new(0.4, 0.0, 1.0), sun),
        lobe(Vec3::new(0.3, 0.5, 1.0), 3.0),
        lobe(Vec3::NEG_Y, 0.5),
    ];
    Shape::Window(Window {
        center: Vec3::new(0.5, 0.0, 1.0),
        x: Vec3::NEG_X * 1.5,
        y: Vec3::Y,
        lobes,
    })
}

fn sphere() -> Shape {
    Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::new(0.5, 0.0, 0.0), radius: 0.3 }))
}

/// Number of the estimates, and of those whose interval contains the truth.
#[derive(Default)]
struct Coverage {
    all: usize,
    held: usize,
}

impl Coverage {
    fn add(
        &mut self,
        value: &Plane<f32>,
        stderr: &Plane<f32>,
        truth: &Plane<f32>,
        counts: impl Fn(f32, f32) -> bool,
    ) {
        for ((v, s), t) in value.pixels().iter().zip(stderr.pixels()).zip(truth.pixels()) {
            if counts(*t, *s) {
                self.all += 1;
                self.held += usize::from(f64::from((v - t).abs()) <= INTERVAL * f64::from(*s));
            }
        }
    }

    fn check(&self, what: &str) {
        let share = self.held as f64 / self.all as f64;
        println!("{what}: {:.1} % of {} intervals hold the truth", 100.0 * share, self.all);
        if self.all == 0 {
            return; // a closed form errs nowhere
        }
        assert!(self.all > 300, "{what}: {} are too few to judge", self.all);
        assert!((0.93..=0.98).contains(&share), "{what}: {share}");
    }
}

#[test]
fn intervals_of_direct_light_hold_the_truth() {
    let room = Room::square_before_wall(camera(48));
    let shape = window(30.0);
    let (truth, ..) =
        direct(&room, &Direct { samples: 1024, seed: 99, ..Direct::default() }, &shape);
    for (samples, target_error) in [(16, 0.0), (32, 0.0), (128, 0.0), (16, 0.01)] {
        for (k, bandwidth) in [30.0, 3.0, 0.5].into_iter().enumerate() {
            let mut coverage = Coverage::default();
            let mut used = 0.0;
            for seed in 0..3 {
                // With the default parameters it is a closed form without error.
                let stage = Direct {
                    samples,
                    target_error,
                    max_samples: 256,
                    seed,
                    sampling: Strategy::Area,
                };
                let (direct, _, mean) = direct(&room, &stage, &shape);
                used += mean / 3.0;
                coverage.add(&direct.lobes[k], &direct.stderr[k], &truth.lobes[k], |_, error| {
                    error > 0.0
                });
            }
            coverage.check(&format!(
                "direct, bandwidth {bandwidth}, {used:.0} samples, target {target_error}"
            ));
        }
    }
}

#[test]
fn intervals_of_shadows_hold_the_truth() {
    let room = Room::square_before_wall(camera(64));
    for (shape, name) in [(sphere(), "sphere"), (window(300.0), "window")] {
        let half = false;
        let (truth, ..) =
            shadow(&room, &Shadow { samples: 1024, seed: 99, half, ..Shadow::default() }, &shape);
        for (samples, target_error) in [(8, 0.0), (32, 0.0), (8, 0.01)] {
            let mut coverage = Coverage::default();
            let mut used = 0.0;
            for seed in 0..2 {
                let stage = Shadow { samples, target_error, seed, half, ..Shadow::default() };
                let (visibility, estimated, mean) = shadow(&room, &stage, &shape);
                assert!(target_error == 0.0 || estimated <= f64::from(target_error), "{estimated}");
                used += mean / 2.0;
                for (k, truth) in truth.lit.iter().enumerate() {
                    let penumbra =
                        |truth: f32, error: f32| error > 0.0 && (0.005..0.995).contains(&truth);
                    coverage.add(&visibility.lit[k], &visibility.stderr[k], truth, penumbra);
                }
            }
            coverage.check(&format!("penumbra of a {name}, {used:.0} rays, target {target_error}"));
        }
    }
}

#[test]
fn intervals_of_indirect_light_hold_the_truth() {
    let room = Room::floor_and_wall(camera(64));
    let (direct, ..) = direct(&room, &Direct::default(), &sphere());
    let bright = |indirect: &UnitIndirect| indirect.lobes[0].0.map(luminance);
    let truth = bright(&indirect(&room, 4096, 99, &direct));
    for rays in [64, 128, 256] {
        let mut coverage = Coverage::default();
        for seed in 0..6 {
            let indirect = indirect(&room, rays, seed, &direct);
            coverage.add(&bright(&indirect), &indirect.stderr[0], &truth, |_, _| true);
        }
        coverage.check(&format!("indirect, {rays} rays"));
    }
}

#[test]
fn a_target_is_reached_where_the_same_rays_spread_evenly_miss_it() {
    let room = Room::square_before_wall(camera(64));
    let shape = sphere();
    let (truth, ..) =
        shadow(&room, &Shadow { samples: 1024, seed: 9, half: false, ..Shadow::default() }, &shape);
    let (direct, ..) = direct(&room, &Direct::default(), &shape);
    // The errors that were really made, weighted by the light that the visibility is a share of:
    // their mean over the mean of the light, and that of their squares.
    let made = |visibility: &Visibility| {
        let (mut off, mut squares, mut all) = (0.0, 0.0, 0.0);
        for (i, e) in direct.lobes[0].pixels().iter().enumerate() {
            let (v, t) = (visibility.lit[0].pixels()[i], truth.lit[0].pixels()[i]);
            off += f64::from(e * (v - t).abs());
            squares += f64::from(e * (v - t)).powi(2);
            all += f64::from(e * t);
        }
        (off / all, squares)
    };
    for target_error in [0.02, 0.005] {
        let stage = Shadow { target_error, half: false, ..Shadow::default() };
        let (adaptive, estimated, used) = shadow(&room, &stage, &shape);
        let evenly =
            Shadow { samples: 4 * (used / 4.0).round() as u32, target_error: 0.0, ..stage };
        let ((off, squares), (_, even_squares)) =
            (made(&adaptive), made(&shadow(&room, &evenly, &shape).0));
        let gain = even_squares / squares;
        println!(
            "target {target_error}: estimated {estimated:.4}, made {off:.4}, {used:.1} rays; variance {gain:.2} x when even"
        );
        assert!(
            estimated <= f64::from(target_error) && off <= estimated,
            "{target_error}: estimated {estimated}, made {off}"
        );
        assert!(gain > 1.3, "{target_error}: {gain}");
    }
}

/// Root mean square of the difference of two seeds, over sqrt 2.
fn noise(a: &Plane<f32>, b: &Plane<f32>) -> f64 {
    let squares: f64 =
        a.pixels().iter().zip(b.pixels()).map(|(a, b)| f64::from(a - b).powi(2)).sum();
    (squares / (2.0 * a.len() as f64)).sqrt()
}

#[test]
fn errors_fall_as_the_root_of_the_samples_or_faster() {
    let room = Room::square_before_wall(camera(24));
    let counts = [4u32, 16, 64, 256, 1024];
    let slope = |errors: &[f64]| {
        let (first, last) = (errors[0], errors[errors.len() - 1]);
        (last / first).ln() / (f64::from(counts[counts.len() - 1]) / f64::from(counts[0])).ln()
    };
    let mut all: Vec<(String, Vec<f64>)> = Vec::new();
    for k in 0..3 {
        all.push((format!("direct light of lobe {k}"), Vec::new()));
    }
    all.push(("penumbra".into(), Vec::new()));
    for samples in counts {
        let direct =
            |seed| direct(&room, &Direct { samples, seed, ..Direct::default() }, &window(300.0)).0;
        let shadow = |seed| {
            shadow(&room, &Shadow { samples, seed, half: false, ..Shadow::default() }, &sphere()).0
        };
        let (a, b) = (direct(1), direct(2));
        (0..3).for_each(|k| all[k].1.push(noise(&a.lobes[k], &b.lobes[k])));
        all[3].1.push(noise(&shadow(1).lit[0], &shadow(2).lit[0]));
    }
    // A lobe in closed form has zero noise.
    for (what, errors) in all.iter().filter(|(_, errors)| errors[0] > 0.0) {
        println!("{what}: {errors:.5?}, slope {:.2}", slope(errors));
        assert!(slope(errors) <= -0.5, "{what}: {errors:?}");
    }
}

#[test]
fn thread_counts_change_no_bit_of_an_adaptive_estimate() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let room = Room::square_before_wall(camera(40));
            let lit = Direct { samples: 4, target_error: 0.02, ..Direct::default() };
            let shaded = Shadow { samples: 4, target_error: 0.02, ..Shadow::default() };
            (direct(&room, &lit, &window(300.0)), shadow(&room, &shaded, &window(300.0)))
        })
    };
    assert!(run(1) == run(3));
}

/// Angle of the camera to the left wall of [`closed_room`], radians.
const TURN: f32 = 0.733;

/// A closed room of 4 x 2.6 x 4 m. The camera stands near the edge between the left and the back
/// wall and looks at the opposite one, so that it sees parts of all six sides.
fn closed_room() -> Room {
    let camera = Camera::from_fov_x(96, 72, 116.0);
    let view = camera;
    Room::new(camera, move |x, y| {
        let ray = view.pixel_point(x, y, 1.0);
        let (sin, cos) = TURN.sin_cos();
        let across = [ray.x * cos - ray.z * sin, ray.x * sin + ray.z * cos];
        let wall = |along: f32, low: f32, high: f32| {
            (if along > 0.0 { high } else { low }) / along.abs().max(1e-6)
        };
        wall(across[0], 0.4, 3.6).min(wall(across[1], 3.6, 0.4)).min(wall(ray.y, 1.3, 1.3))
    })
}

/// The layout of [`closed_room`] in which these sides are guesses; every other side is seen at some
/// receiver.
fn layout(room: &Room, guessed: &[usize]) -> RoomLayout {
    let sides = std::array::from_fn(|side| match guessed.contains(&side) {
        true => SideSource::Guessed,
        false => SideSource::Seen,
    });
    let (width, height) = room.size();
    let at = |x: usize, y: usize| (x / 8 + y / 8) % 6;
    let seen =
        |x: usize, y: usize| if guessed.contains(&at(x, y)) { 0 } else { at(x, y) as u8 + 1 };
    let corners = Vec3::new(0.4, 1.3, 3.6);
    let rotation = Quat::from_rotation_y(TURN);
    RoomLayout::new(
        (rotation, -corners, Vec3::new(3.6, 1.3, 0.4)),
        sides,
        (&room.camera, &room.points),
        Plane::from_fn(width, height, seen),
        4,
    )
}

fn draws(room: &Room, layout: RoomLayout) -> Arc<RoomDraws> {
    let inputs = DrawRoomsIn {
        layout: Arc::new(layout),
        mesh: room.mesh.clone(),
        points: room.points.clone(),
        normal: room.normal.clone(),
        camera: room.camera.clone(),
    };
    let stage = DrawRooms { stride: 8, ..DrawRooms::default() };
    stage.run(inputs, &Context::default()).expect("the room is sound").draws
}

fn differences(room: &Room, draws: &Arc<RoomDraws>, shape: &Shape) -> Arc<DrawDifferences> {
    let (width, height) = room.size();
    let (direct, ..) = direct(room, &Direct::default(), shape);
    let (visibility, ..) = shadow(room, &Shadow::default(), shape);
    let inputs = LightDrawsIn {
        draws: draws.clone(),
        mesh: room.mesh.clone(),
        shape: Arc::new(shape.clone()),
        mask: None,
        albedo: Arc::new(Albedo(Plane::filled(width, height, Vec3::new(0.6, 0.5, 0.4)))),
        direct,
        visibility,
    };
    let stage = LightDraws::default();
    stage.run(inputs, &Context::default()).expect("the light is sound").differences
}

/// The standard error by guesses, and its mean over that of a shading of one.
fn room_error(
    room: &Room,
    differences: &Arc<DrawDifferences>,
    radiance: &[Vec3],
) -> (Plane<f32>, f64) {
    let (width, height) = room.size();
    let inputs = RoomErrorIn {
        differences: differences.clone(),
        radiance: Arc::new(Radiance(radiance.to_vec())),
        light: Arc::new(Shading(Plane::filled(width, height, Vec3::ONE))),
        points: room.points.clone(),
        normal: room.normal.clone(),
    };
    let ctx = Context::default();
    let out = RoomError {}.run(inputs, &ctx).expect("the light is sound");
    (out.error.stderr.clone(), ctx.stderr().expect("the stage reports its error"))
}

/// A lamp in the middle of [`closed_room`].
fn lamp_in_room() -> Shape {
    Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::new(0.2, 0.5, -1.8), radius: 0.1 }))
}

#[test]
fn a_closed_room_of_which_all_is_known_has_no_error() {
    let room = closed_room();
    let shape = lamp_in_room();
    // As the search finds it from the depth, and with sides that the scene states.
    for known in [KnownSide::Unknown, KnownSide::At(0.4)] {
        let mut guess = LayoutGuess::default();
        (guess.sides[0], guess.sides[5]) = (known, known);
        let layout = RoomLayout::find(&room.mesh, &room.points, &room.normal, &room.camera, &guess);
        assert!(!layout.is_guessed(), "{:?}", layout.sides);
        let draws = draws(&room, layout);
        assert!(draws.rooms.is_empty());
        let (error, mean) = room_error(&room, &differences(&room, &draws, &shape), &[Vec3::ONE]);
        assert_eq!((error, mean), (Plane::filled(96, 72, 0.0), 0.0));
    }
}

#[test]
fn the_error_grows_with_the_share_of_guessed_sides() {
    let room = closed_room();
    let shape = lamp_in_room();
    let error = |guessed: &[usize]| {
        let draws = draws(&room, layout(&room, guessed));
        room_error(&room, &differences(&room, &draws, &shape), &[Vec3::ONE]).1
    };
    // Two walls one by one, then the floor and the ceiling, whose draws are one height.
    let errors = [error(&[]), error(&[5]), error(&[5, 0]), error(&[5, 0, 3, 2])];
    assert_eq!(errors[0], 0.0);
    assert!(errors.windows(2).all(|pair| pair[1] > 1.1 * pair[0]), "{errors:?}");
}

#[test]
fn the_error_is_linear_in_the_radiance_and_lobes_are_mixed_draw_by_draw() {
    let room = closed_room();
    let draws = draws(&room, layout(&room, &[5, 0, 3]));
    let lamp = differences(&room, &draws, &lamp_in_room());
    let (one, mean) = room_error(&room, &lamp, &[Vec3::new(1.0, 2.0, 0.5)]);
    let (three, triple) = room_error(&room, &lamp, &[Vec3::new(3.0, 6.0, 1.5)]);
    assert!(mean > 0.0 && (triple / mean - 3.0).abs() < 1e-5, "{triple} {mean}");
    for (three, one) in three.pixels().iter().zip(one.pixels()) {
        assert!((three - 3.0 * one).abs() <= 1e-5 * three, "{three} {one}");
    }
    assert_eq!(room_error(&room, &lamp, &[Vec3::ZERO]).1, 0.0);
    // Of two lobes with opposite differences, equal radiances cancel in every draw.
    let opposite = lamp.lobes[0].map(|v| -v);
    let lobes = vec![lamp.lobes[0].clone(), opposite];
    let both = Arc::new(DrawDifferences { grid: lamp.grid, lobes });
    assert_eq!(room_error(&room, &both, &[Vec3::ONE; 2]).1, 0.0);
    let (_, single) = room_error(&room, &lamp, &[Vec3::ONE]);
    let (_, rest) = room_error(&room, &both, &[3.0 * Vec3::ONE, 2.0 * Vec3::ONE]);
    assert!((rest / single - 1.0).abs() < 1e-4, "{rest} {single}");
}

#[test]
fn draws_of_the_room_are_the_same_bits_for_any_threads() {
    let room = closed_room();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let draws = draws(&room, layout(&room, &[5, 0]));
            let differences = differences(&room, &draws, &lamp_in_room());
            let (error, mean) = room_error(&room, &differences, &[Vec3::ONE]);
            (draws, differences, error, mean)
        })
    };
    let one = run(1);
    assert!(one.3 > 0.0);
    for threads in [2, 5] {
        assert!(run(threads) == one, "{threads} threads");
    }
}

#[test]
fn draws_of_the_room_cover_their_documented_ranges_evenly() {
    for count in [2usize, 4, 8, 16] {
        let draws: Vec<GuessDraw> = (0..count).map(|i| GuessDraw::new(i, count, 0)).collect();
        type Value<'a> = &'a dyn Fn(&GuessDraw) -> f32;
        let ranges: [(f32, f32, Value); 3] = [
            // Of the least distance of a wall; the layout has 1.4.
            (0.7f32.ln(), 2f32.ln(), &|draw| (draw.layout.distance * 1.4).ln()),
            (2.3, 3.5, &|draw| draw.layout.height),
            (0.5f32.ln(), 1.6f32.ln(), &|draw| draw.albedo.ln()),
        ];
        for (low, high, value) in ranges {
            let mean = draws.iter().map(value).sum::<f32>() / count as f32;
            assert!((mean - 0.5 * (low + high)).abs() < 1e-5, "{count}: {mean}");
            let mut parts: Vec<f32> =
                draws.iter().map(|d| (value(d) - low) / (high - low) * count as f32).collect();
            parts.sort_by(f32::total_cmp);
            for (i, part) in parts.iter().enumerate() {
                assert!((part - 0.5 - i as f32).abs() < 1e-3, "{count}: {parts:?}");
            }
        }
    }
}
