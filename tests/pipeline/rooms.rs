//! Path-traced rooms whose edits have a known truth: the small room, and the rooms of
//! ../shared/truth.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use relight::geometry::Camera;
use relight::image::{
    LUMINANCE, NamedBytes, Picture, Plane, Transfer, mean_error, pairs, read_mask, resize,
    score_picture, write_png,
};
use serde_json::Value;
use tempfile::TempDir;

use crate::project::*;

/// Measure -> value.
pub type Scores = BTreeMap<String, f64>;

/// One edit of a scene, and its truth. All planes have the photo's size.
pub struct Case {
    pub subject: String,
    scene: PathBuf,
    edit: PathBuf,
    /// The photo, linear and not clipped.
    before: Plane<Vec3>,
    /// The true picture, as `before`.
    truth: Plane<Vec3>,
    /// Pixels that show no light.
    counted: Plane<bool>,
    /// Pixels in which the change is compared.
    near: Plane<bool>,
    /// The side, in pixels, of the squares whose means the change is compared in.
    square: usize,
}

impl Case {
    /// PSNR in dB of the 8-bit picture and of the unchanged photo, and the error of the change: 0
    /// is perfect, 1 is doing nothing.
    pub fn score(&self, graph: &str) -> Scores {
        let graph = load(&root().join("graphs").join(graph), &self.scene, &self.edit);
        let graph = graph.unwrap_or_else(|faults| panic!("{}: {}", self.subject, faults[0]));
        let picture = png(&written(&run(shared_engine(), &graph, &[]), "picture.png"));
        let got = Plane::from_fn(self.before.width(), self.before.height(), |x, y| {
            let stored = picture.get_pixel(x as u32, y as u32).0;
            Vec3::from_array(stored.map(|byte| Transfer::Srgb.decode(f32::from(byte) / 255.0)))
        });
        let score =
            score_picture(&got, &self.truth, &self.before, &self.counted).expect("pixels count");
        let [got, truth, before] = [&got, &self.truth, &self.before].map(|plane| self.means(plane));
        let all = truth.map(|_| true);
        let off = |a, b| mean_error(pairs(a, b, &all), |a, b| (a - b).abs()).expect("pixels count");
        let change = off(&got, &truth) / off(&before, &truth);
        [("PSNR", score.psnr), ("unchanged", score.unchanged), ("change error", change)]
            .map(|(measure, value)| (measure.to_owned(), value))
            .into()
    }

    /// The plane, clipped, black where the change is not compared, in means of squares.
    fn means(&self, plane: &Plane<Vec3>) -> Plane<Vec3> {
        let (width, height) = plane.size();
        let near = |x, y| {
            if self.near.get(x, y) {
                plane.get(x, y).clamp(Vec3::ZERO, Vec3::ONE)
            } else {
                Vec3::ZERO
            }
        };
        resize(&Plane::from_fn(width, height, near), width / self.square, height / self.square)
    }
}

fn json(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).expect("it is JSON")
}

fn number(value: &Value) -> f32 {
    value.as_f64().expect("a number") as f32
}

fn vec3(value: &Value) -> Vec3 {
    Vec3::from_array([0, 1, 2].map(|c| number(&value[c])))
}

fn names(value: &Value) -> Vec<&str> {
    value.as_array().expect("a list").iter().map(|name| name.as_str().expect("a name")).collect()
}

/// a + share * b.
fn plus(a: &Plane<Vec3>, b: &Plane<Vec3>, share: Vec3) -> Plane<Vec3> {
    Plane::from_fn(a.width(), a.height(), |x, y| a.get(x, y) + share * b.get(x, y))
}

fn sum<'a>(mut planes: impl Iterator<Item = &'a Plane<Vec3>>) -> Plane<Vec3> {
    let first = planes.next().expect("a room has lights").clone();
    planes.fold(first, |sum, plane| plus(&sum, plane, Vec3::ONE))
}

/// Pixels of a mask's file that are not black.
fn lit(path: &Path) -> Plane<bool> {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let mask = read_mask(NamedBytes::new("mask", &bytes)).expect("it is sound").0;
    mask.map(|share| share > 0.0)
}

fn outside(masks: &[Plane<bool>]) -> Plane<bool> {
    Plane::from_fn(masks[0].width(), masks[0].height(), |x, y| {
        masks.iter().all(|mask| !mask.get(x, y))
    })
}

/// The edits of the project in the small room, whose truth its lights' pictures make.
pub fn small() -> Vec<Case> {
    let meta = json(&demo().join("truth/meta.json"));
    let picture = |name: &str| exr(&demo().join(format!("truth/{name}.exr")));
    let lights = ["lamp_0", "window_0", "inv_lamp"].map(|id| (id, picture(&format!("light_{id}"))));
    let before = sum(lights.iter().map(|(_, light)| light));
    let but = |name: &str, share: Vec3| {
        let (_, light) =
            lights.iter().find(|(id, _)| *id == name).expect("the room has this light");
        plus(&before, light, share)
    };
    let ceiling = vec3(&meta["lights"]["inv_lamp"]["radiance"]);
    let warm = black_body(2700.0) * ceiling.dot(LUMINANCE) / ceiling;
    let truths = [
        ("lamp_off", but("lamp_0", -Vec3::ONE)),
        ("out_of_view_off", but("inv_lamp", -Vec3::ONE)),
        ("window_dim", but("window_0", Vec3::splat(-0.6))),
        ("warm", but("inv_lamp", warm - Vec3::ONE)),
        ("insert_lamp", picture("insert_lamp")),
        ("open_window", picture("open_window")),
    ];
    let masks = ["lamp_0", "window_0"].map(|id| lit(&demo().join(format!("masks/{id}.png"))));
    let cases = truths.into_iter().map(|(edit, truth)| {
        let counted = outside(&[&masks[..], &[inserted(edit, &meta, before.size())]].concat());
        Case {
            subject: edit.to_owned(),
            scene: demo(),
            edit: edits().join(edit).with_extension("ron"),
            before: before.clone(),
            truth,
            near: counted.clone(),
            counted,
            square: 1,
        }
    });
    cases.collect()
}

/// Pixels that the body of an inserted light covers, with a pixel of margin.
fn inserted(edit: &str, meta: &Value, (width, height): (usize, usize)) -> Plane<bool> {
    let camera = Camera::from_fov_x(width, height, number(&meta["fov_x"]));
    let (globe, pane) = (&meta["edits"]["insert_lamp"], &meta["edits"]["open_window"]);
    let (center, radius) = (vec3(&globe["center"]), number(&globe["radius"]) + 0.01);
    let corner = |k: usize| [0, 1].map(|c| number(&pane["corners"][k % 4][c]));
    Plane::from_fn(width, height, |x, y| {
        let ray = camera.pixel_point(x, y, 1.0).normalize();
        match edit {
            "insert_lamp" => center.length_squared() - ray.dot(center).powi(2) < radius * radius,
            "open_window" => (0..4).all(|k| {
                let ([ax, ay], [bx, by]) = (corner(k), corner(k + 1));
                let side = (bx - ax) * (y as f32 + 0.5 - ay) - (by - ay) * (x as f32 + 0.5 - ax);
                side > -(bx - ax).hypot(by - ay)
            }),
            _ => false,
        }
    })
}

/// Linear Rec.709 of unit luminance: Planck's locus after Kim et al. 2002, for 2222..4000 K.
fn black_body(kelvin: f64) -> Vec3 {
    let t = 1e3 / kelvin;
    let x = -0.2661239 * t.powi(3) - 0.2343589 * t.powi(2) + 0.8776956 * t + 0.179910;
    let y = -0.9549476 * x.powi(3) - 1.37418593 * x.powi(2) + 2.09137015 * x - 0.16748867;
    let xyz = DVec3::new(x / y, 1.0, (1.0 - x - y) / y);
    let rgb = DVec3::new(
        xyz.dot(DVec3::new(3.2404542, -1.5371385, -0.4985314)),
        xyz.dot(DVec3::new(-0.9692660, 1.8760108, 0.0415560)),
        xyz.dot(DVec3::new(0.0556434, -0.2040259, 1.0572252)),
    );
    let rgb = rgb.max(DVec3::ZERO).as_vec3();
    rgb / rgb.dot(LUMINANCE)
}

/// A room of ../shared/truth, with the scenes and edits that its meta.json describes.
pub struct TruthRoom {
    pub cases: Vec<Case>,
    source: PathBuf,
    meta: Value,
    /// Picture of each light alone.
    lights: BTreeMap<String, Plane<Vec3>>,
    /// Scenes and edits.
    folder: TempDir,
}

impl TruthRoom {
    /// Every kind of edit: each light off, the visible lamp inserted into the room without it,
    /// paint and an object.
    pub fn new(view: &str) -> TruthRoom {
        let source =
            root().join("../shared/truth").join(view).canonicalize().expect("the room is there");
        let meta = json(&source.join("meta.json"));
        let light = |id: &&str| (id.to_string(), exr(&source.join(format!("olat_{id}.exr"))));
        let lights = names(&meta["lights"]).iter().map(light).collect();
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let mut room = TruthRoom { cases: Vec::new(), source, meta, lights, folder };
        let total = sum(room.lights.values());
        let visible: Vec<String> =
            names(&room.meta["visible"]).into_iter().map(str::to_owned).collect();
        // Edits skip a window that is out of view and not named `inv_window`.
        let known = |id: &String| id.starts_with("inv") || visible.contains(id);
        for (id, light) in room.lights.clone().into_iter().filter(|(id, _)| known(id)) {
            let lights = if id.starts_with("inv") {
                "\"inv_lamp\": Off, \"inv_window\": Off"
            } else {
                &format!("{id:?}: Off")
            };
            room.add(
                &format!("{id} off"),
                None,
                &format!("lights: {{{lights}}}"),
                plus(&total, &light, -Vec3::ONE),
            );
        }
        let lamp = &room.meta["lamps"]["lamp_0"];
        let lamp = format!(
            "shape: Sphere(radius: {}), at: Point{}, radiance: {}",
            lamp["radius"],
            triple(&lamp["center"]),
            triple(&lamp["radiance"])
        );
        room.add(
            "insert lamp_0",
            Some("lamp_0"),
            &format!("lights: {{\"desk\": Lamp({lamp})}}"),
            total,
        );
        let paint = format!(
            "materials: [Paint(region: Mask({:?}), albedo: Linear{})]",
            room.source.join("mask_paint.png"),
            triple(&room.meta["edits"]["paint"]["albedo"])
        );
        room.add("paint", None, &paint, exr(&room.source.join("paint.exr")));
        let ball = &room.meta["edits"]["object"];
        let ball = format!(
            "objects: [Sphere(radius: {}, at: Point{}, material: (albedo: Linear(0.8, 0.8, 0.8), roughness: 1))]",
            ball["radius"],
            triple(&ball["center"])
        );
        room.add("insert object", None, &ball, exr(&room.source.join("object.exr")));
        // Their truth has noise of its own.
        let [.., paint, object] = &mut room.cases[..] else { unreachable!("they were added") };
        (paint.square, object.square) = (4, 4);
        let around = around(&lit(&room.source.join("mask_object.png")));
        object.near = Plane::from_fn(around.width(), around.height(), |x, y| {
            around.get(x, y) && object.near.get(x, y)
        });
        room
    }

    /// Adds an edit of the scene, or of the scene without one light.
    fn add(&mut self, subject: &str, without: Option<&str>, edit: &str, truth: Plane<Vec3>) {
        let visible: Vec<String> =
            names(&self.meta["visible"]).into_iter().map(str::to_owned).collect();
        let mask = |id: &String| self.source.join(format!("mask_{id}.png"));
        let masks: Vec<Plane<bool>> = visible.iter().map(|id| lit(&mask(id))).collect();
        let counted = outside(&masks);
        let before =
            sum(self.lights.iter().filter(|(id, _)| without != Some(id)).map(|(_, light)| light));
        let scene = self.folder.path().join(without.unwrap_or("whole"));
        std::fs::create_dir_all(&scene).expect("a folder can be made");
        let photo = write_png(&Picture(before.clone()), Transfer::Srgb, false);
        std::fs::write(scene.join("photo.png"), photo).expect("a file can be written");
        let mut lights = String::new();
        for id in visible.iter().filter(|id| without != Some(id)) {
            let kind = if id.starts_with("window") { "Window" } else { "Lamp" };
            write!(lights, "{id:?}: {kind}(mask: {:?}), ", mask(id)).expect("text can grow");
        }
        let text = format!(
            "Scene(version: 1, photo: \"photo.png\", transfer: Srgb, camera: FovX({:?}), depth: (path: {:?}, kind: PlanarZ), \
             lights: {{{lights}}})",
            number(&self.meta["fov_x"]),
            self.source.join("depth.exr")
        );
        std::fs::write(scene.join("scene.ron"), text).expect("a file can be written");
        let file = self.folder.path().join(format!("{subject}.ron"));
        std::fs::write(&file, format!("Edit(version: 1, {edit})")).expect("a file can be written");
        let case = Case {
            subject: subject.to_owned(),
            scene,
            edit: file,
            before,
            truth,
            near: counted.clone(),
            counted,
            square: 1,
        };
        self.cases.push(case);
    }
}

/// Three numbers, as files of the program have them.
fn triple(value: &Value) -> String {
    format!("({}, {}, {})", value[0], value[1], value[2])
}

/// The box around the pixels of a mask, grown by its own size on each side.
fn around(mask: &Plane<bool>) -> Plane<bool> {
    let (width, height) = mask.size();
    let column = |x: usize| (0..height).any(|y| mask.get(x, y));
    let row = |y: usize| (0..width).any(|x| mask.get(x, y));
    let grown =
        |first: usize, last: usize| first.saturating_sub(last - first + 1)..=2 * last + 1 - first;
    let range = |n: usize, lit: &dyn Fn(usize) -> bool| {
        let ends = (0..n).find(|&i| lit(i)).zip((0..n).rfind(|&i| lit(i)));
        ends.map(|(first, last)| grown(first, last)).expect("the mask is not black")
    };
    let (columns, rows) = (range(width, &column), range(height, &row));
    Plane::from_fn(width, height, |x, y| columns.contains(&x) && rows.contains(&y))
}
