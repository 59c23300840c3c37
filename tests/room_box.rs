//! The cuboid of a room, found from the depth of rooms in closed form.

mod common;

use glam::{Quat, Vec2, Vec3};
use relight::geometry::{Camera, KnownSide, LayoutGuess, RoomLayout, SIDES, SideSource};
use relight::graph::{Context, Node};
use relight::nodes::render::transport::{Transport, TransportIn};
use relight::nodes::scene::room_box::{RoomBox, RoomBoxIn, RoomSpec};

use SideSource::{Guessed, Open, Seen};
use common::boxes::Boxes;
use common::room::Room;

/// A room around a camera: distances of its sides in meters, and blocks in it.
struct Built {
    boxes: Boxes,
    /// From the room's axes to camera space.
    rotation: Quat,
    /// Relative error of the depth.
    noise: f32,
}

impl Built {
    fn new([left, right, floor, ceiling, front, back]: [f32; 6]) -> Built {
        let room = [-Vec3::new(left, floor, front), Vec3::new(right, ceiling, back)];
        Built { boxes: Boxes { room, blocks: Vec::new() }, rotation: Quat::IDENTITY, noise: 0.0 }
    }

    /// With a camera that looks to the right by `yaw` and upward by `pitch` degrees.
    fn turned(mut self, yaw: f32, pitch: f32) -> Built {
        let camera =
            Quat::from_rotation_y(-yaw.to_radians()) * Quat::from_rotation_x(pitch.to_radians());
        self.rotation = camera.inverse();
        self
    }

    fn seen(&self) -> Room {
        let camera = Camera::from_fov_x(160, 120, 75.0);
        let inverse = self.rotation.inverse();
        Room::new(camera, |x, y| {
            let bump = (x as f32 / 23.0).sin() * (y as f32 / 19.0 + 1.0).sin();
            let hit = self.boxes.cast(Vec3::ZERO, inverse * camera.pixel_point(x, y, 1.0));
            hit.t * (1.0 + self.noise * bump)
        })
    }
}

fn found(room: &Room, guess: &LayoutGuess) -> (RoomLayout, Vec<String>) {
    RoomLayout::find_with_doubts(&room.mesh, &room.points, &room.normal, &room.camera, guess)
}

/// Checks axes within `degrees`, and sources and distances (meters, within `error`) of all sides;
/// an unseen side has no distance.
fn check(name: &str, built: &Built, sides: [(SideSource, f32); 6], degrees: f32, error: f32) {
    let (layout, doubts) = found(&built.seen(), &LayoutGuess::default());
    let turned = (layout.rotation.inverse() * built.rotation).to_axis_angle().1.to_degrees();
    let context = format!("{name}: {} ({turned:.1} degrees; {doubts:?})", layout.summary());
    assert!(turned.min(360.0 - turned) < degrees, "{context}");
    for (side, (source, wanted)) in sides.into_iter().enumerate() {
        assert_eq!(layout.sides[side], source, "{} of {context}", SIDES[side]);
        let distance = layout.distances()[side];
        match source {
            Seen => assert!((distance - wanted).abs() < error, "{} of {context}", SIDES[side]),
            // A guess lies beyond all that is seen.
            _ => assert!(distance > wanted, "{} of {context}", SIDES[side]),
        }
    }
}

const PLAIN: [f32; 6] = [2.0, 2.2, 1.4, 1.2, 4.0, 2.0];

fn seen_but_the_back(distances: [f32; 6]) -> [(SideSource, f32); 6] {
    std::array::from_fn(|side| if side == 5 { (Guessed, 0.0) } else { (Seen, distances[side]) })
}

#[test]
fn the_seen_sides_of_a_closed_box_are_found() {
    check("a box", &Built::new(PLAIN), seen_but_the_back(PLAIN), 0.5, 0.05);
}

#[test]
fn the_camera_may_be_turned_and_its_depth_may_err() {
    let turned = Built::new([2.0, 3.0, 1.4, 1.2, 3.4, 2.5]).turned(30.0, -15.0);
    let sides =
        [(Guessed, 0.3), (Seen, 3.0), (Seen, 1.4), (Guessed, 0.3), (Seen, 3.4), (Guessed, 0.3)];
    check("a turned camera", &turned, sides, 1.0, 0.06);
    check("and depth that errs", &Built { noise: 0.03, ..turned }, sides, 3.0, 0.25);
}

#[test]
fn a_camera_in_a_corner_sees_the_sides_across() {
    let corner = Built::new([3.5, 0.4, 1.5, 1.1, 3.5, 0.4]).turned(-40.0, -5.0);
    let sides =
        [(Seen, 3.5), (Guessed, 0.3), (Seen, 1.5), (Seen, 1.1), (Seen, 3.5), (Guessed, 0.3)];
    check("a corner", &corner, sides, 1.0, 0.06);
}

/// A strip of the wall on the right, one percent of what is seen, with nothing behind it.
#[test]
fn a_strip_of_a_wall_is_enough_where_it_is_the_last_thing_seen() {
    let strip = [2.0, 2.98, 1.4, 1.2, 4.0, 2.0];
    check("a strip", &Built::new(strip), seen_but_the_back(strip), 0.5, 0.05);
}

#[test]
fn a_corridor_has_no_end_that_is_near() {
    let corridor = Built::new([0.8, 0.8, 1.4, 1.1, 12.0, 3.0]);
    let (layout, _) = found(&corridor.seen(), &LayoutGuess::default());
    let [left, right, floor, ceiling, front, _] = layout.distances();
    for (got, wanted) in [(left, 0.8), (right, 0.8), (floor, 1.4), (ceiling, 1.1)] {
        assert!((got - wanted).abs() < 0.05, "{}", layout.summary());
    }
    assert!(front > 11.9, "{}", layout.summary());
}

/// The wall on the right belongs to a block that ends before the camera: the room goes on there.
#[test]
fn a_side_past_which_the_camera_sees_is_a_guess() {
    let mut shape = Built::new([2.0, 4.0, 1.4, 1.2, 6.0, 2.0]);
    shape.boxes.blocks = vec![[Vec3::new(1.8, -1.4, -6.0), Vec3::new(4.0, 1.2, -4.5)]];
    let sides =
        [(Seen, 2.0), (Guessed, 3.3), (Seen, 1.4), (Seen, 1.2), (Seen, 6.0), (Guessed, 0.3)];
    check("an L", &shape, sides, 0.5, 0.05);
}

#[test]
fn a_room_without_an_end_is_open_there() {
    let hall = Built::new([1.5, 1.5, 1.4, 1.3, 90.0, 3.0]);
    let (layout, _) = found(&hall.seen(), &LayoutGuess::default());
    assert_eq!(layout.sides[4], Open, "{}", layout.summary());
    assert!(layout.cells().iter().all(|cell| cell.side != 4), "{}", layout.summary());
}

/// A bed fills the lower half of the picture, and a strip of the floor is seen beside it.
#[test]
fn a_bed_is_not_the_floor() {
    let mut room = Built::new([2.0, 2.2, 1.4, 1.2, 4.0, 2.0]);
    room.boxes.blocks = vec![[Vec3::new(-2.0, -1.4, -4.0), Vec3::new(0.4, -0.8, -1.0)]];
    check("a bed", &room, seen_but_the_back(PLAIN), 0.5, 0.05);
}

/// A ray that leaves the room through any cell meets no surface that the camera sees behind it.
#[test]
fn no_cell_hides_what_the_camera_sees() {
    for built in [Built::new(PLAIN), Built::new(PLAIN).turned(20.0, -10.0)] {
        let room = built.seen();
        let (layout, _) = found(&room, &LayoutGuess::default());
        for cell in layout.cells() {
            let at: Option<Vec2> = room.camera.project(cell.center);
            if let Some(at) = at.filter(|at| room.camera.contains(*at)) {
                let depth = room.depth.0.get(at.x as usize, at.y as usize);
                assert!(-cell.center.z > depth, "{} before {depth}", cell.center);
            }
        }
    }
}

#[test]
fn what_a_scene_states_takes_the_place_of_guesses() {
    let room = Built::new(PLAIN).seen();
    let stated = |side: usize, known: KnownSide, height| {
        let mut guess = LayoutGuess { height, ..LayoutGuess::default() };
        guess.sides[side] = known;
        found(&room, &guess)
    };
    let (layout, doubts) = stated(5, KnownSide::At(2.0), None);
    assert_eq!((layout.sides[5], layout.distances()[5]), (SideSource::Given, 2.0));
    assert!(doubts.is_empty(), "{doubts:?}");
    let (layout, _) = stated(5, KnownSide::Open, None);
    assert!(layout.sides[5] == Open && layout.cells().iter().all(|cell| cell.side != 5));
    let (_, doubts) = stated(4, KnownSide::At(2.5), None);
    assert!(
        doubts.iter().any(|d| d.starts_with("room: front: the scene states 2.50 m")),
        "{doubts:?}"
    );
    let (_, doubts) = stated(5, KnownSide::Unknown, Some(3.2));
    assert!(
        doubts.iter().any(|d| d.starts_with("room: height: the scene states 3.20 m")),
        "{doubts:?}"
    );
}

#[test]
fn contradictions_of_a_statement_are_errors() {
    let check = |room: RoomSpec| RoomBox { room, ..RoomBox::default() }.check();
    let at = KnownSide::At;
    assert_eq!(check(RoomSpec { left: at(1.2), height: Some(2.7), ..RoomSpec::default() }), Ok(()));
    for (room, wanted) in [
        (RoomSpec { left: at(0.0), ..RoomSpec::default() }, "room: left: wanted"),
        (RoomSpec { back: at(51.0), ..RoomSpec::default() }, "room: back: wanted"),
        (RoomSpec { height: Some(270.0), ..RoomSpec::default() }, "room: height: wanted"),
        (
            RoomSpec { height: Some(2.7), floor: at(1.4), ceiling: at(1.6), ..RoomSpec::default() },
            "room: height: wanted floor + ceiling = 3.00 m",
        ),
        (
            RoomSpec { height: Some(2.7), ceiling: at(2.8), ..RoomSpec::default() },
            "room: height: wanted more than",
        ),
    ] {
        let message = check(room).expect_err("it contradicts itself");
        assert!(message.starts_with(wanted), "{message}");
    }
}

/// The fractions sum to one, and an open side takes its rays from those of guessed sides.
#[test]
fn rays_are_counted_by_what_they_meet() {
    let room = Built::new(PLAIN).seen();
    let fractions = |back: KnownSide| {
        let stage =
            RoomBox { room: RoomSpec { back, ..RoomSpec::default() }, ..RoomBox::default() };
        let ctx = Context::default();
        let inputs = RoomBoxIn {
            mesh: room.mesh.clone(),
            points: room.points.clone(),
            normal: room.normal.clone(),
            camera: room.camera.clone(),
        };
        let layout = stage.run(inputs, &ctx).expect("the room is sound").layout;
        assert!(ctx.notes()[0].starts_with("left 2.0"), "{:?}", ctx.notes());
        let inputs = TransportIn {
            mesh: room.mesh.clone(),
            points: room.points.clone(),
            normal: room.normal.clone(),
            layout: Some(layout.clone()),
        };
        let ctx = Context::default();
        let out = Transport::default().run(inputs, &ctx).expect("the room is sound");
        assert!(ctx.notes()[0].contains("% guessed sides"), "{:?}", ctx.notes());
        out.transport.ray_fractions(&layout.sides)
    };
    let (guessed, open) = (fractions(KnownSide::Unknown), fractions(KnownSide::Open));
    for f in [guessed, open] {
        assert!((f.surface + f.seen + f.guessed + f.nothing - 1.0).abs() < 1e-4, "{f:?}");
    }
    assert!(guessed.guessed > 0.05 && open.guessed == 0.0, "{guessed:?} {open:?}");
    assert!(open.nothing > guessed.nothing + 0.03, "{guessed:?} {open:?}");
}
