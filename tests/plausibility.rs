//! Doubts about scenes, and the scale of depth from a known height: sound rooms raise none and keep
//! their scale, wrong ones are told by their cause.

use std::path::{Path, PathBuf};

use needs::needs;
use relight::geometry::{
    Camera, Doubt, KnownHeight, SeenRoom, doubts, level_sides, relative_from_height,
    scale_from_height,
};
use relight::image::{
    Depth, Mask, Measure, NamedBytes, Picture, Plane, Transfer, fit, inpaint_depth, read_depth,
    read_mask, read_photo, resize, resize_depth,
};

struct Room {
    name: String,
    camera: Camera,
    depth: Depth,
    photo: Picture,
    masks: Vec<(String, Mask)>,
    outside: Plane<f32>,
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

impl Room {
    /// A folder of our own scenes, of ../shared/truth or of ../shared/data/photos, at 320 pixels.
    fn read(folder: &Path) -> Room {
        let bytes = |name: &str| std::fs::read(folder.join(name));
        let photo = ["photo.png", "photo.jpg", "input.png"].into_iter().find_map(|n| bytes(n).ok());
        let photo = photo.expect("the folder has a photo");
        let photo = read_photo(NamedBytes::new("photo", &photo), Transfer::Srgb);
        let photo = photo.expect("a sound photo").picture.0;
        let (width, height) = photo.size();
        let json = ["about.json", "meta.json"].into_iter().find_map(|n| bytes(n).ok());
        let facts: serde_json::Value = json
            .map_or_else(|| "{\"fov_x\": 64}".into(), |j| String::from_utf8(j).expect("text"))
            .parse()
            .expect("sound JSON");
        let number = |name: &str| facts[name].as_f64().map(|n| n as f32);
        let camera = match number("fov_x_deg").or(number("fov_x")) {
            Some(degrees) => Camera::from_fov_x(width, height, degrees),
            None => {
                let [fx, fy, cx, cy] =
                    ["fx", "fy", "cx", "cy"].map(|n| number(n).expect("a camera"));
                Camera { width, height, fx, fy, cx, cy }
            }
        };
        let (w, h) = fit(width, height, 320);
        let mut masks = Vec::new();
        let mut outside = Plane::filled(w, h, 0.0f32);
        for (id, file) in mask_files(folder) {
            let bytes = std::fs::read(file).expect("it can be read");
            let mask = read_mask(NamedBytes::new("mask", &bytes)).expect("a sound mask");
            let mask = resize(&mask.0, w, h);
            if !id.starts_with("lamp") {
                let pairs = outside.pixels_mut().iter_mut().zip(mask.pixels());
                pairs.for_each(|(o, &m)| *o = o.max(m));
            }
            if id != "outside" {
                masks.push((id, Mask(mask)));
            }
        }
        let stored = read_depth(NamedBytes::new("depth", &bytes("depth.exr").expect("a depth")));
        let stored = stored.expect("a sound depth").0;
        let (depth, _) = inpaint_depth(&stored, &stored.map(|_| 0.0)).expect("it has readings");
        Room {
            name: folder.file_name().expect("a name").to_string_lossy().into_owned(),
            camera: camera.resized(w, h),
            depth: resize_depth(&depth, w, h),
            photo: Picture(resize(&photo, w, h)),
            masks,
            outside,
        }
    }

    /// Depth as f of the depth and the length of the ray at depth 1.
    fn with_depth(&self, f: impl Fn(f32, f32) -> f32) -> Depth {
        let (w, h) = self.depth.0.size();
        let ray = |x, y| self.camera.pixel_point(x, y, 1.0).length();
        Depth(Plane::from_fn(w, h, |x, y| f(self.depth.0.get(x, y), ray(x, y))))
    }

    fn doubts_of(&self, depth: &Depth, camera: &Camera, masks: &[(String, Mask)]) -> Vec<Doubt> {
        doubts(&SeenRoom {
            depth,
            camera,
            measure: Measure::PlanarZ,
            outside: &self.outside,
            photo: &self.photo,
            lights: masks.iter().map(|(id, mask)| (id.as_str(), mask)).collect(),
        })
    }

    fn doubts_of_depth(&self, f: impl Fn(f32, f32) -> f32) -> Vec<Doubt> {
        self.doubts_of(&self.with_depth(f), &self.camera, &[])
    }

    fn doubts_under(&self, degrees: f32) -> Vec<Doubt> {
        let (w, h) = self.depth.0.size();
        self.doubts_of(&self.depth, &Camera::from_fov_x(w, h, degrees), &[])
    }

    /// Doubts about a rectangle around a place, shares of the picture.
    fn doubts_of_mask(&self, [cx, cy]: [f32; 2]) -> Vec<Doubt> {
        let (w, h) = self.depth.0.size();
        let near = |at: usize, n: usize, center: f32| ((at as f32 / n as f32) - center).abs() < 0.1;
        let mask = Plane::from_fn(w, h, |x, y| f32::from(near(x, w, cx) && near(y, h, cy)));
        self.doubts_of(&self.depth, &self.camera, &[("lamp_9".into(), Mask(mask))])
    }
}

fn mask_files(folder: &Path) -> Vec<(String, PathBuf)> {
    let list = |folder: PathBuf| std::fs::read_dir(folder).into_iter().flatten();
    let files = list(folder.join("masks")).chain(list(folder.into()));
    let mut files: Vec<(String, PathBuf)> = files
        .map(|entry| entry.expect("it can be listed").path())
        .filter_map(|path| {
            let name = path.file_stem()?.to_str()?.trim_start_matches("mask_").to_owned();
            let of_masks = path.parent()?.ends_with("masks") || path.to_str()?.contains("/mask_");
            let known = ["lamp_", "window_", "outside"].iter().any(|start| name.starts_with(start));
            (of_masks && known).then_some((name, path))
        })
        .collect();
    files.sort();
    files
}

fn rooms(folder: &str) -> Vec<Room> {
    let entries = std::fs::read_dir(root().join(folder)).expect("the folder can be listed");
    let mut folders: Vec<PathBuf> =
        entries.map(|e| e.expect("an entry").path()).filter(|path| path.is_dir()).collect();
    folders.sort();
    folders.iter().map(|folder| Room::read(folder)).collect()
}

fn ours() -> Vec<Room> {
    ["scenes/demo", "tests/scenes/small"].map(|folder| Room::read(&root().join(folder))).into()
}

fn assert_sound(rooms: &[Room]) {
    for room in rooms {
        let found = room.doubts_of(&room.depth, &room.camera, &room.masks);
        assert!(found.is_empty(), "{}: {found:?}", room.name);
    }
}

#[test]
fn our_rooms_raise_no_doubt() {
    assert_sound(&ours());
}

#[needs("../shared/truth")]
#[test]
fn rooms_of_others_raise_no_doubt() {
    assert_sound(&rooms("../shared/truth"));
}

#[needs("../shared/data/photos")]
#[test]
fn photos_raise_no_doubt() {
    assert_sound(&rooms("../shared/data/photos"));
}

#[test]
fn wrong_units_kinds_lenses_and_masks_are_told() {
    for room in ours() {
        let millimeters = room.doubts_of_depth(|z, _| 1000.0 * z);
        assert!(matches!(millimeters[..], [Doubt::Distance { .. }]), "{millimeters:?}");
        assert!(
            millimeters[0].to_string().contains("multiply `scale` by 0.001; in scene.ron: `depth")
        );
        let disparity = room.doubts_of_depth(|z, _| 1.0 / z);
        assert!(matches!(disparity[..], [Doubt::Inverted { .. }]), "{disparity:?}");
        assert!(disparity[0].to_string().contains("`depth: (.., kind: Disparity)`"));
        let ray = room.doubts_of_depth(|z, ray| z * ray);
        assert!(
            matches!(ray[..], [Doubt::Kind { likely: Measure::RayLength, .. }]),
            "{}: {ray:?}",
            room.name
        );
        assert!(ray[0].to_string().contains("`depth: (.., kind: RayLength)`"));
        let lens = room.doubts_under(120.0);
        let [Doubt::Lens { likely, .. }] = lens[..] else { panic!("{}: {lens:?}", room.name) };
        assert!((50.0..80.0).contains(&likely), "64 degrees are true, got {likely}");
        let radians = room.doubts_under(1.117);
        assert!(matches!(radians[..], [Doubt::Radians { .. }]), "{radians:?}");
        assert!(radians[0].to_string().contains("radians? Then it is 64 degrees"), "{radians:?}");
        assert!(lens[0].to_string().contains("in scene.ron: `camera: FovX("));
        let mask = room.doubts_of_mask([0.2, 0.8]);
        assert!(matches!(mask[..], [Doubt::DimMask { .. }]), "{mask:?}");
        assert!(mask[0].to_string().contains("`lights: { \"lamp_9\": .. }`"));
    }
}

/// Four photos, four faults each; the numbers of detected faults on all rooms.
#[needs("../shared/data/photos")]
#[test]
fn faults_of_photos_are_told() {
    let all: Vec<Room> = ours()
        .into_iter()
        .chain(rooms("../shared/truth"))
        .chain(rooms("../shared/data/photos"))
        .collect();
    let count = |what: &str, told: &dyn Fn(&Room) -> bool| {
        let missed: Vec<&str> =
            all.iter().filter(|room| !told(room)).map(|room| room.name.as_str()).collect();
        println!("{what}: {} of {}, missed {missed:?}", all.len() - missed.len(), all.len());
        let four = ["bedroom", "nyu_0987", "nyu_0996", "nyu_1070"];
        assert!(four.iter().all(|name| !missed.contains(name)), "{what}: {missed:?}");
    };
    let first = |found: Vec<Doubt>, is: fn(&Doubt) -> bool| found.first().is_some_and(is);
    let distance: fn(&Doubt) -> bool = |d| matches!(d, Doubt::Distance { .. });
    count("millimeters", &|r| first(r.doubts_of_depth(|z, _| 1000.0 * z), distance));
    count("a tenth", &|r| first(r.doubts_of_depth(|z, _| 0.1 * z), distance));
    count("disparity", &|r| {
        first(r.doubts_of_depth(|z, _| 1.0 / z), |d| matches!(d, Doubt::Inverted { .. }))
    });
    count("ray length", &|r| {
        first(r.doubts_of_depth(|z, ray| z * ray), |d| matches!(d, Doubt::Kind { .. }))
    });
    count("120 degrees", &|r| first(r.doubts_under(120.0), |d| matches!(d, Doubt::Lens { .. })));
    // Faults that not each photo shows: the least numbers of rooms.
    let some = |what: &str, least: usize, told: &dyn Fn(&Room) -> bool| {
        let missed: Vec<&str> =
            all.iter().filter(|room| !told(room)).map(|room| room.name.as_str()).collect();
        println!("{what}: {} of {}, missed {missed:?}", all.len() - missed.len(), all.len());
        assert!(all.len() - missed.len() >= least, "{what}: {missed:?}");
    };
    for (degrees, least) in [(30.0, 3), (90.0, 5), (100.0, 10)] {
        let is_lens: fn(&Doubt) -> bool =
            |d| matches!(d, Doubt::Lens { .. } | Doubt::Leaning { likely: Some(_), .. });
        some(&format!("{degrees} degrees"), least, &|r| first(r.doubts_under(degrees), is_lens));
    }
    let turned = |room: &Room, turn: fn(usize, usize, usize, usize) -> (usize, usize)| {
        let (w, h) = room.depth.0.size();
        let depth = Plane::from_fn(w, h, |x, y| {
            let (x, y) = turn(x, y, w, h);
            room.depth.0.get(x, y)
        });
        !room.doubts_of(&Depth(depth), &room.camera, &[]).is_empty()
    };
    some("upside down", 6, &|r| turned(r, |x, y, _, h| (x, h - 1 - y)));
    some("turned by 180 degrees", 4, &|r| turned(r, |x, y, w, h| (w - 1 - x, h - 1 - y)));
    let places = [[0.5, 0.85], [0.2, 0.8]];
    let dim = places.map(|at| all.iter().filter(|r| !r.doubts_of_mask(at).is_empty()).count());
    println!("masks beside the light told: {dim:?} of {} each", all.len());
    assert!(dim.iter().all(|told| *told >= 11), "{dim:?}");
}

/// Median and largest of |ln|, as factors.
fn factors(name: &str, errors: &mut [(f32, String)]) -> (f32, f32) {
    errors.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (middle, (worst, which)) =
        (errors[errors.len() / 2].0.exp(), errors.last().expect("there are some"));
    println!(
        "{name}: {} rooms, median factor {middle:.3}, worst {:.3} ({which})",
        errors.len(),
        worst.exp()
    );
    (middle, worst.exp())
}

/// The scale that a stated height gives depth in a foreign unit, and the scale and shift that it
/// gives relative depth: against the metric depth of rooms.
#[needs("../shared/data/photos")]
#[test]
fn known_heights_give_the_scale() {
    let all: Vec<Room> = ours()
        .into_iter()
        .chain(rooms("../shared/truth"))
        .chain(rooms("../shared/data/photos"))
        .collect();
    let (mut camera, mut ceiling, mut usual, mut relative) = (vec![], vec![], vec![], vec![]);
    for room in &all {
        let sides = level_sides(&room.depth, &room.camera, &room.outside);
        println!("{}: {sides:?}", room.name);
        let Some(floor) = sides.floor else { continue };
        let foreign = room.with_depth(|z, _| 37.0 * z);
        let scale = |known| scale_from_height(&foreign, &room.camera, &room.outside, known);
        let error = |scale: f32| ((37.0 * scale).ln().abs(), room.name.clone());
        camera.push(error(scale(KnownHeight::Camera(floor)).expect("a floor")));
        usual.push(error(scale(KnownHeight::default()).expect("a floor")));
        if let Some(height) = sides.ceiling.map(|ceiling| floor + ceiling) {
            ceiling.push(error(scale(KnownHeight::Ceiling(height)).expect("floor and ceiling")));
        }
        let q = room.with_depth(|z, _| 20.0 / z - 3.0).0;
        let known = KnownHeight::Camera(floor);
        match relative_from_height(&q, &room.camera, &room.outside, known) {
            Err(e) => println!("{}: {e}", room.name),
            Ok(found) => {
                let ratio = |(q, z): (&f32, &f32)| (found.scale / (q + found.shift) / z).ln().abs();
                let mut ratios: Vec<f32> =
                    q.pixels().iter().zip(room.depth.0.pixels()).map(ratio).collect();
                ratios.sort_by(f32::total_cmp);
                relative.push((ratios[ratios.len() / 2], room.name.clone()));
            }
        }
    }
    // The unit does not matter: the same floor is found.
    assert!(factors("a stated camera height", &mut camera).1 < 1.02);
    assert!(factors("a stated ceiling height", &mut ceiling).1 < 1.02);
    factors("1.5 m assumed", &mut usual);
    assert!(factors("relative depth, median of each room", &mut relative).1 < 1.2);
}

#[test]
fn rooms_of_ours_have_their_scale_from_a_height() {
    for room in ours() {
        // The camera stands 1.35 m above the floor and 1.2 m below the ceiling.
        let foreign = room.with_depth(|z, _| 1000.0 * z);
        for known in [KnownHeight::Camera(1.35), KnownHeight::Ceiling(2.55)] {
            let scale = scale_from_height(&foreign, &room.camera, &room.outside, known);
            let scale = scale.expect("floor and ceiling are seen");
            assert!((1000.0 * scale - 1.0).abs() < 0.03, "{known:?}: {scale}");
        }
        let q = room.with_depth(|z, _| 5.0 / z + 2.0).0;
        let found =
            relative_from_height(&q, &room.camera, &room.outside, KnownHeight::Camera(1.35))
                .expect("the floor is seen");
        let at = |q: f32| found.scale / (q + found.shift);
        for z in [2.0, 3.0, 4.0, 5.0] {
            assert!((at(5.0 / z + 2.0) / z - 1.0).abs() < 0.15, "{z} m: {}", at(5.0 / z + 2.0));
        }
        let wall = Plane::filled(room.depth.0.width(), room.depth.0.height(), 2.0);
        let known = KnownHeight::default();
        let error = scale_from_height(&Depth(wall.clone()), &room.camera, &room.outside, known);
        assert!(error.expect_err("a wall").contains("does not show the floor"));
        let error = relative_from_height(&wall, &room.camera, &room.outside, known);
        assert!(error.expect_err("a wall").contains("wanted numbers that vary"));
    }
}
