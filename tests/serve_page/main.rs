//! The page of `relight serve` in a real browser, used as a person uses it. Without a browser these
//! tests are skipped, with a line that says so.

#![cfg(feature = "serve")]

mod browser;

use std::cell::Cell;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use browser::{Browser, Held, Page};
use image::RgbImage;

const WINDOW: (u32, u32) = (1280, 900);

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A copy of the small room, its results, and a browser.
struct Place {
    folder: tempfile::TempDir,
    /// The port of its server, which one that starts again keeps; 0 before there is one.
    port: Cell<u16>,
    browser: Browser,
}

impl Place {
    fn new() -> Option<Place> {
        let Some(program) = browser::find() else {
            eprintln!("skipped: no browser was found; CHROME names one");
            return None;
        };
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let scene = folder.path().join("scene");
        std::fs::create_dir_all(scene.join("masks")).expect("a folder can be made");
        let small = root().join("tests/scenes/small");
        for name in ["photo.png", "depth.exr", "masks/lamp_0.png", "masks/window_0.png"] {
            std::fs::copy(small.join(name), scene.join(name)).expect("it can be copied");
        }
        let text = std::fs::read_to_string(small.join("scene.ron")).expect("it can be read");
        let (kept, _) = text.split_once("    truth:").expect("the small room has a truth");
        std::fs::write(scene.join("scene.ron"), format!("{kept})\n")).expect("it can be written");
        let browser = Browser::start(&program, folder.path());
        Some(Place { folder, port: Cell::new(0), browser })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap_or_default()
    }

    /// The command in this folder. All tests share a cache, so that the room's lights are estimated
    /// once.
    fn command(&self, line: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
        command.current_dir(self.folder.path()).args(line.split_whitespace());
        command
            .env("HOME", Path::new(env!("CARGO_TARGET_TMPDIR")).join("serve_page"))
            .env_remove("XDG_CACHE_HOME")
            .env_remove("XDG_CONFIG_HOME")
            .env_remove("RELIGHT_LOG");
        command
    }

    fn check(&self, command: &mut Command) {
        let output = command.output().expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }

    /// A run of an edit as a person would start it.
    fn fresh(&self, edit: &str, out: &str) -> RgbImage {
        let graph = root().join("graphs/physics.ron");
        let line = format!("run {} {edit} --scene scene --out {out}", graph.display());
        self.check(&mut self.command(&line));
        self.image(&format!("{out}/picture.png"))
    }

    fn image(&self, name: &str) -> RgbImage {
        image::open(self.path(name)).expect("it was written").to_rgb8()
    }

    fn serve(&self) -> Server {
        let line = format!("serve scene --graph physics --out out --port {}", self.port.get());
        let mut child = self
            .command(&line)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        let mut url = String::new();
        let output = child.stdout.take().expect("its output is read");
        BufReader::new(output).read_line(&mut url).expect("it prints its address");
        assert!(url.starts_with("http://127.0.0.1:"), "{url:?}");
        let port = url["http://127.0.0.1:".len()..].split('/').next().and_then(|n| n.parse().ok());
        self.port.set(port.expect("the address has a port"));
        Server { child, url: url.trim().to_owned() }
    }

    fn open(&self, server: &Server) -> Page<'_> {
        self.browser.page(&server.url, WINDOW)
    }

    /// Waits until the text is taken and its run has finished.
    #[track_caller]
    fn settled(page: &Page) {
        page.until(
            "the run is done",
            "(({ model: { text, accepted, run, manifest, previewed } }) => text === accepted.text && run.status === 'done' && run.revision >= accepted.revision && manifest.revision === run.revision && !previewed)(relight)",
        );
    }

    /// Waits until the edit file is this text.
    #[track_caller]
    fn until_file(&self, name: &str, what: &str, holds: impl Fn(&str) -> bool) {
        let end = Instant::now() + Duration::from_secs(60);
        while !holds(&self.read(name)) {
            assert!(Instant::now() < end, "{name}: in vain until {what}: {}", self.read(name));
            std::thread::sleep(Duration::from_millis(25));
        }
    }
}

struct Server {
    child: Child,
    url: String,
}

impl Server {
    fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.kill();
    }
}

/// The largest difference of two pictures, of 255.
fn farthest(a: &RgbImage, b: &RgbImage) -> u8 {
    assert_eq!(a.dimensions(), b.dimensions());
    a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
}

/// The mean difference of two pictures, of 255.
fn mean_difference(a: &RgbImage, b: &RgbImage) -> f64 {
    let sum: f64 = a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    sum / a.as_raw().len() as f64
}

/// Halves of layers, and two ways to round: the page may be off by 2.
#[track_caller]
fn close(what: &str, page: &RgbImage, program: &RgbImage) {
    let steps = farthest(page, program);
    assert!(steps <= 2, "{what}: the page is off by {steps} of 255");
}

fn sets(page: &Page, label: &str, value: &str) {
    let selector = format!("[aria-label=\"{label}\"]");
    page.click_on(&selector);
    page.key("a", "KeyA", Held::Control);
    page.type_text(value);
    page.key("Enter", "Enter", Held::Nothing);
}

#[test]
fn sliders_are_those_of_the_program() {
    let Some(place) = Place::new() else { return };
    std::fs::write(place.path("none.ron"), "Edit(version: 1)\n").expect("it can be written");
    let none = place.fresh("none.ron", "base");
    let server = place.serve();
    let page = place.open(&server);
    Place::settled(&page);
    close("as it is", &page.picture(), &none);

    // A stop is twenty steps of the slider.
    page.eval("document.querySelector('[aria-label=\"lamp_0: stops\"]').focus()");
    (0..20).for_each(|_| page.key("ArrowLeft", "ArrowLeft", Held::Nothing));
    place.until_file("out/edit.ron", "the lamp is dimmed", |text| {
        text.contains("        \"lamp_0\": Scale(0.5),\n")
    });
    Place::settled(&page);
    let dimmed = page.picture();
    assert!(farthest(&dimmed, &none) > 20, "the slider does something");
    place.check(
        Command::new(env!("CARGO_BIN_EXE_relight")).current_dir(place.folder.path()).args([
            "mix",
            "base",
            "--set",
            "lamp_0=0.5",
            "--out",
            "mixed",
        ]),
    );
    close("a slider against mix", &dimmed, &place.image("mixed/picture.png"));
    close("a slider against a run", &dimmed, &place.fresh("out/edit.ron", "fresh"));
    close("a slider against the files of the server", &dimmed, &place.image("out/picture.png"));

    // Kelvin typed, another light brighter by the mouse, a color beside it.
    sets(&page, "lamp_0: kelvin", "2700");
    let (x, y) = page.middle("[aria-label=\"window_0: stops\"]");
    page.drag(&[(x + 9.0, y), (x + 18.0, y), (x + 22.0, y)]);
    sets(&page, "inv_lamp: stops, in numbers", "-1.5");
    Place::settled(&page);
    let text = place.read("out/edit.ron");
    assert!(text.contains("        \"lamp_0\": [Scale(0.5), Temperature(2700)],\n"), "{text}");
    assert!(text.contains("        \"inv_lamp\": Scale(0.354),\n"), "{text}");
    assert!(text.contains("        \"window_0\": Scale("), "{text}");
    close("all lights against a run", &page.picture(), &place.fresh("out/edit.ron", "fresh"));

    // The same without a GPU.
    page.open(&format!("http://127.0.0.1:{}/?2d", place.port.get()));
    Place::settled(&page);
    assert_eq!(page.eval("relight.renderer"), "canvas");
    close("without WebGL2", &page.picture(), &place.image("fresh/picture.png"));
    assert_eq!(page.faults(), Vec::<String>::new());
}

#[test]
fn a_lamp_is_inserted_moved_and_taken_back() {
    let Some(place) = Place::new() else { return };
    let server = place.serve();
    let page = place.open(&server);
    Place::settled(&page);
    let before = page.picture();
    page.key("l", "KeyL", Held::Nothing);
    page.click(page.at_pixel(170.0, 176.0));
    place.until_file("out/edit.ron", "there is a lamp", |text| {
        text.contains("        \"lamp\": Lamp(shape: Sphere(radius: 0.06), at: Pixel(x: 170, y: 176), flux: 800, temperature: 2700),\n")
    });
    Place::settled(&page);
    let inserted = page.picture();
    assert!(farthest(&inserted, &before) > 40, "it shines");
    close("a lamp", &inserted, &place.image("out/picture.png"));

    page.key("Escape", "Escape", Held::Nothing);
    // While it is dragged the layers are coarse, and the file stays.
    page.mouse("mouseMoved", page.at_pixel(170.0, 176.0), 0);
    page.mouse("mousePressed", page.at_pixel(170.0, 176.0), 1);
    for k in 1..=12 {
        page.mouse(
            "mouseMoved",
            page.at_pixel(170.0 - 5.0 * f64::from(k), 176.0 + f64::from(k)),
            1,
        );
    }
    page.until(
        "the last place is previewed",
        "relight.model.previewed?.lights.find((light) => light.id === 'lamp').entry.includes('x: 110, y: 188')",
    );
    let previewed = page.picture();
    assert!(place.read("out/edit.ron").contains("at: Pixel(x: 170, y: 176)"));
    page.mouse("mouseReleased", page.at_pixel(110.0, 188.0), 0);
    place.until_file("out/edit.ron", "the lamp is elsewhere", |text| {
        text.contains("at: Pixel(x: 110, y: 188)")
    });
    Place::settled(&page);
    let moved = page.picture();
    assert!(farthest(&moved, &inserted) > 40, "it is elsewhere");
    close("a moved lamp", &moved, &place.image("out/picture.png"));
    // This room is as small as previews are, so that they are exact but for their noise.
    let off = mean_difference(&previewed, &moved);
    assert!(off < 2.0, "the preview is off by {off} of 255 in the mean");
    let text = place.read("out/edit.ron");

    page.key("z", "KeyZ", Held::Control);
    place.until_file("out/edit.ron", "undone", |text| text.contains("at: Pixel(x: 170, y: 176)"));
    page.key("z", "KeyZ", Held::Control);
    place.until_file("out/edit.ron", "undone again", |text| !text.contains("Lamp("));
    Place::settled(&page);
    close("undone", &page.picture(), &before);
    page.key("z", "KeyZ", Held::ControlShift);
    page.key("z", "KeyZ", Held::ControlShift);
    place.until_file("out/edit.ron", "done again", |now| now == text);
    Place::settled(&page);
    close("done again", &page.picture(), &place.fresh("out/edit.ron", "fresh"));
    assert_eq!(page.faults(), Vec::<String>::new());
}

#[test]
fn a_window_of_four_corners_gets_a_sun() {
    let Some(place) = Place::new() else { return };
    let server = place.serve();
    let page = place.open(&server);
    Place::settled(&page);
    page.key("n", "KeyN", Held::Nothing);
    for (x, y) in [(104.0, 58.0), (142.0, 57.0), (143.0, 108.0), (105.0, 107.0)] {
        page.click(page.at_pixel(x, y));
    }
    page.key("Escape", "Escape", Held::Nothing);
    place.until_file("out/edit.ron", "there is a window", |text| {
        text.contains("        \"window\": Window(corners: [(104, 58), (142, 57), (143, 108), (105, 107)], sky: Radiance(4, 4.4, 5)),\n")
    });
    page.eval("document.querySelector('[data-light=window] details').open = true");
    page.click_on("[aria-label=\"window: sun\"]");
    sets(&page, "window: elevation of the sun, degrees", "20");
    place.until_file("out/edit.ron", "the sun is low", |text| {
        text.contains("sun: Direction(azimuth: 20, elevation: 20)")
    });
    // A click on the dial: to the right, halfway to the zenith.
    let (x, y) = page.middle("[data-light=window] .dial");
    let half = page.eval("document.querySelector('[data-light=window] .dial').getBoundingClientRect().width / 140 * 28");
    page.click((x + half.as_f64().expect("a number"), y));
    place.until_file("out/edit.ron", "the sun is to the right", |text| {
        text.contains("sun: Direction(azimuth: 90, elevation: 45)")
    });
    Place::settled(&page);
    close("a window", &page.picture(), &place.image("out/picture.png"));
    // The switch hides the entry in a comment.
    page.click_on("[aria-label=\"window: on\"]");
    place.until_file("out/edit.ron", "it is off", |text| text.contains("/* \"window\": Window("));
    Place::settled(&page);
    page.click_on("[aria-label=\"window: on\"]");
    place.until_file("out/edit.ron", "it is on", |text| !text.contains("/*"));
    assert_eq!(page.faults(), Vec::<String>::new());
}

#[test]
fn a_person_looks_at_single_pixels() {
    let Some(place) = Place::new() else { return };
    let server = place.serve();
    let page = place.open(&server);
    sets(&page, "lamp_0: stops, in numbers", "-2");
    page.until("it is dimmed", "relight.model.text.includes('Scale(0.25)')");
    Place::settled(&page);
    page.eval("document.getElementById('showhandles').click()");
    let (picture, photo) = (page.picture(), place.image("scene/photo.png"));
    // A wheel over a pixel: it stays under the pointer, whose place is in whole pixels.
    let (x, y) = page.at_pixel(100.0, 80.0);
    let (x, y) = (x.floor(), y.floor());
    let under = page.pixel_at(x, y);
    for _ in 0..4 {
        let wheel = serde_json::json!({ "type": "mouseWheel", "x": x, "y": y, "deltaX": 0, "deltaY": -240 });
        page.send("Input.dispatchMouseEvent", wheel);
    }
    page.until("it is near", "relight.view.zoom > 8");
    let now = page.pixel_at(x, y);
    let moved = (now.0 - under.0).abs().max((now.1 - under.1).abs());
    assert!(moved < 0.1, "{under:?} {now:?}");
    // Each photo pixel is a square of one color, of the picture or, left of the line, of the photo.
    let shown = |what: &str,
                 pixel: (u32, u32),
                 wanted: &dyn Fn([u8; 3]) -> [u8; 3],
                 of: &RgbImage| {
        let drawn = page.eval("document.documentElement.dataset.drawn").as_str().map(str::to_owned);
        std::thread::sleep(Duration::from_millis(300));
        let shot = page.window();
        let wanted = wanted(of.get_pixel(pixel.0, pixel.1).0);
        for off in [-0.35, 0.0, 0.35] {
            let (x, y) = page.at_pixel(f64::from(pixel.0) + off, f64::from(pixel.1) - off);
            let got = shot.get_pixel(x as u32, y as u32).0;
            let worst = (0..3).map(|c| got[c].abs_diff(wanted[c])).max();
            assert!(worst <= Some(2), "{what} {pixel:?}: {got:?} for {wanted:?}, drawn {drawn:?}");
        }
    };
    let same = |color: [u8; 3]| color;
    for pixel in [(100, 80), (103, 77), (97, 84)] {
        shown("picture", pixel, &same, &picture);
    }
    let stop = |color: [u8; 3]| {
        color.map(|v| {
            let v = f64::from(v) / 255.0;
            let linear = if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) };
            let l = (0.5 * linear).min(1.0);
            let v = if l <= 0.003_130_8 { 12.92 * l } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 };
            (255.0 * v).round() as u8
        })
    };
    sets(&page, "Exposure of the view in stops, in numbers", "-1");
    shown("a stop less", (100, 80), &stop, &picture);
    page.click_on("#exposurereset");
    page.key("Escape", "Escape", Held::Nothing);
    page.eval("document.getElementById('stage').focus()");
    page.key("w", "KeyW", Held::Nothing);
    page.until("there is a line", "!document.getElementById('wipe').hidden");
    page.drag(&[page.middle("#wipe"), page.at_pixel(101.0, 80.0)]);
    shown("photo", (97, 84), &same, &photo);
    shown("picture", (103, 77), &same, &picture);
    page.key("w", "KeyW", Held::Nothing);

    // Two fingers.
    page.eval("document.getElementById('fit').click()");
    let zoom = || page.eval("relight.view.zoom").as_f64().expect("a number");
    let before = zoom();
    let (x, y) = page.at_pixel(160.0, 120.0);
    let touch = |kind: &str, far: f64| {
        let points = if kind == "touchEnd" {
            serde_json::json!([])
        } else {
            serde_json::json!([{ "x": x - far, "y": y, "id": 0 }, { "x": x + far, "y": y, "id": 1 }])
        };
        page.send(
            "Input.dispatchTouchEvent",
            serde_json::json!({ "type": kind, "touchPoints": points }),
        );
    };
    touch("touchStart", 50.0);
    [60.0, 80.0, 100.0].into_iter().for_each(|far| {
        touch("touchMove", far);
    });
    touch("touchEnd", 0.0);
    assert!((zoom() / before - 2.0).abs() < 0.1, "{} from {before}", zoom());

    // Overlays have legends.
    for (name, legend) in [
        ("plane depth", " m"),
        ("plane shadow_lamp_0", "lit"),
        ("plane normal", "toward"),
        ("plane albedo", "reflectance"),
        ("plane room_error_inv_lamp", "guesses"),
        ("plane stderr_lamp_0", "standard error"),
        ("light lamp_0", "alone"),
    ] {
        page.eval(&format!("{{ const s = document.getElementById('show'); s.value = {name:?}; s.dispatchEvent(new Event('change')); }}"));
        page.until("its legend is shown", &format!("document.getElementById('legend').textContent.includes({legend:?}) && !document.getElementById('legend').hidden"));
    }
    page.eval("document.getElementById('room').click()");
    page.until("the room is shown", "document.querySelectorAll('#roombox line').length > 10");
    page.eval("document.getElementById('showgraph').click()");
    page.until("the graph is shown", "document.querySelectorAll('#graph .box').length > 20");
    assert_eq!(page.faults(), Vec::<String>::new());
}

#[test]
fn a_snapshot_outlives_the_page() {
    let Some(place) = Place::new() else { return };
    let server = place.serve();
    let page = place.open(&server);
    Place::settled(&page);
    page.eval("document.querySelector('#stage').focus()");
    page.key("1", "Digit1", Held::Nothing);
    place.until_file("out/edit.ron", "the lamp is off", |text| {
        text == "Edit(\n    version: 1,\n    lights: {\n        \"lamp_0\": Off,\n    },\n)\n"
    });
    let text = place.read("out/edit.ron");
    page.click_on("#snapshotname");
    page.type_text("evening");
    page.key("Enter", "Enter", Held::Nothing);
    place.until_file("out/snapshots/evening.ron", "it is saved", |saved| saved == text);
    page.until(
        "it is listed",
        "document.querySelector('#snapshots .load')?.textContent === 'evening'",
    );
    page.eval("document.querySelector('#stage').focus()");
    page.key("1", "Digit1", Held::Nothing);
    place.until_file("out/edit.ron", "the lamp is on", |text| !text.contains("Off"));

    page.open(&format!("http://127.0.0.1:{}/", place.port.get()));
    page.until("it is listed", "document.querySelector('#snapshots .load')");
    page.click_on("[aria-label=\"Load snapshot evening\"]");
    place.until_file("out/edit.ron", "it is loaded", |now| now == text);
    Place::settled(&page);
    close("loaded", &page.picture(), &place.fresh("out/snapshots/evening.ron", "fresh"));
    page.click_on("[aria-label=\"Delete snapshot evening\"]");
    page.until("it is deleted", "!document.querySelector('#snapshots .load')");
    assert!(!place.path("out/snapshots/evening.ron").exists());
}

#[test]
fn two_pages_follow_each_other() {
    let Some(place) = Place::new() else { return };
    let server = place.serve();
    let (one, other) = (place.open(&server), place.open(&server));
    Place::settled(&one);
    sets(&one, "lamp_0: stops, in numbers", "-2");
    other.until("the other follows", "relight.model.text.includes('Scale(0.25)')");
    sets(&other, "window_0: stops, in numbers", "-1");
    one.until("and back", "relight.model.text.includes('\"window_0\": Scale(0.5)')");
    // Both at once: neither change is lost.
    one.eval("0");
    other.eval("window.before = relight.model.accepted.revision");
    sets(&one, "lamp_0: kelvin", "3000");
    sets(&other, "inv_lamp: kelvin", "4000");
    for page in [&one, &other] {
        page.until(
            "both are kept",
            "relight.model.text.includes('[Scale(0.25), Temperature(3000)]') && relight.model.text.includes('\"inv_lamp\": Temperature(4000)') && relight.model.text === relight.model.accepted.text",
        );
    }
    Place::settled(&one);
    Place::settled(&other);
    assert_eq!(one.text("relight.model.text"), other.text("relight.model.text"));
    close("two pages", &one.picture(), &other.picture());

    // An editor changes the file.
    std::fs::write(
        place.path("out/edit.ron"),
        "// by hand\nEdit(version: 1, lights: { \"lamp_0\": Off })\n",
    )
    .expect("it can be written");
    for page in [&one, &other] {
        page.until("it follows the editor", "relight.model.text.startsWith('// by hand')");
    }
    // What a person wrote stays around what the page writes.
    sets(&one, "window_0: stops, in numbers", "-1");
    place.until_file("out/edit.ron", "both are there", |text| {
        text == "// by hand\nEdit(version: 1, lights: { \"lamp_0\": Off, \"window_0\": Scale(0.5) })\n"
    });
    // A page that is closed at once has still sent its last change.
    other.until("it follows", "relight.model.accepted.text.includes('window_0')");
    sets(&other, "inv_lamp: stops, in numbers", "-2");
    drop(other);
    place.until_file("out/edit.ron", "it is saved", |text| text.contains("Scale(0.25)"));
    assert_eq!(one.faults(), Vec::<String>::new());
}

#[test]
fn a_killed_server_loses_nothing() {
    let Some(place) = Place::new() else { return };
    let mut server = place.serve();
    let page = place.open(&server);
    Place::settled(&page);
    sets(&page, "lamp_0: stops, in numbers", "-1");
    place.until_file("out/edit.ron", "it is saved", |text| text.contains("Scale(0.5)"));
    server.kill();
    page.until("the page says so", "!document.getElementById('lost').hidden");
    sets(&page, "window_0: stops, in numbers", "-2");
    page.until("the GPU shows it", "relight.model.text.includes('\"window_0\": Scale(0.25)')");
    assert!(!place.read("out/edit.ron").contains("Scale(0.25)"));

    // A new server has a new token: the page asks for its address, and follows once it is open.
    page.eval("window.heard = ''; new MutationObserver(() => { heard += document.getElementById('said').textContent; }).observe(document.getElementById('said'), { childList: true })");
    let mut server = place.serve();
    page.until("it asks", "document.getElementById('lost').textContent.includes('address')");
    let other = place.open(&server);
    page.until("it is back", "relight.model.connected");
    page.until("it says so", "heard.includes('nothing is lost')");
    place.until_file("out/edit.ron", "both are saved", |text| {
        text.contains("Scale(0.5)") && text.contains("\"window_0\": Scale(0.25)")
    });
    assert_eq!(page.eval("document.getElementById('lost').hidden"), true);
    Place::settled(&page);
    close("after the kill", &page.picture(), &place.fresh("out/edit.ron", "fresh"));
    drop(other);

    // Killed again, and the page itself goes to the new address: what was not sent is in its
    // storage.
    server.kill();
    page.until("the page says so", "!document.getElementById('lost').hidden");
    sets(&page, "inv_lamp: stops, in numbers", "-3");
    let server = place.serve();
    page.open(&server.url);
    place.until_file("out/edit.ron", "all are saved", |text| {
        text.contains("Scale(0.5)") && text.contains("Scale(0.25)") && text.contains("Scale(0.125)")
    });
    assert_eq!(page.faults(), Vec::<String>::new());
}

#[test]
fn a_fault_stands_at_its_line() {
    let Some(place) = Place::new() else { return };
    let server = place.serve();
    let page = place.open(&server);
    Place::settled(&page);
    page.click_on("#text");
    page.key("a", "KeyA", Held::Control);
    page.type_text(
        "Edit(\n    version: 1,\n    lights: {\n        \"lamp_0\": Scal(0.5),\n    },\n)\n",
    );
    page.until(
        "the fault is shown",
        "document.querySelector('#faults li[data-line=\"4\"] .where')",
    );
    let shown = page.text("document.getElementById('faults').textContent");
    assert!(shown.contains("line 4, column 19") && shown.contains("Scale"), "{shown}");
    assert_eq!(page.eval("document.querySelector('#marks mark').textContent"), "Scal");
    assert_eq!(page.eval("document.querySelector('#lines .bad').textContent"), "4\n");
    assert!(!place.read("out/edit.ron").contains("Scal("), "it is not in the file");
    // A text that cannot even be read: the controls wait.
    page.click_on("#text");
    page.key("a", "KeyA", Held::Control);
    page.type_text("Edit(version: 1, lights: { \"lamp_0\": Off )");
    page.until("the fault is shown", "document.querySelector('#faults li[data-line=\"1\"]')");
    assert_eq!(page.eval("document.querySelector('[aria-label=\"lamp_0: on\"]').disabled"), true);
    page.key("z", "KeyZ", Held::Control);
    page.until("undone", "relight.model.faults.length === 0 && relight.model.text === relight.model.accepted.text && !document.querySelector('#faults li')");
    assert_eq!(page.eval("document.querySelector('[aria-label=\"lamp_0: on\"]').disabled"), false);
}

#[test]
fn a_brush_changes_a_mask() {
    let Some(place) = Place::new() else { return };
    let server = place.serve();
    let page = place.open(&server);
    Place::settled(&page);
    let before = place.image("scene/masks/lamp_0.png");
    page.key("b", "KeyB", Held::Nothing);
    page.until(
        "the mask is there",
        "document.querySelector('#options output')?.textContent === '320 x 240'",
    );
    let places: Vec<(f64, f64)> =
        (0..=8).map(|k| page.at_pixel(236.0 + 5.0 * f64::from(k), 60.0)).collect();
    page.drag(&places);
    page.until(
        "it is saved",
        "document.getElementById('said').textContent === 'Mask of lamp_0 saved'",
    );
    let after = place.image("scene/masks/lamp_0.png");
    assert!(before.get_pixel(250, 60).0[0] < 20 && after.get_pixel(250, 60).0[0] > 235);
    assert_eq!(place.image("scene/masks/lamp_0.before.png"), before);
    let changed = before.pixels().zip(after.pixels()).filter(|(a, b)| a.0[0].abs_diff(b.0[0]) > 8);
    let changed = changed.count();
    // A stroke of 40 pixels, 12 wide.
    assert!((450..750).contains(&changed), "{changed} pixels");
    page.until("it runs again", "relight.model.run.status === 'done'");
    page.click(page.middle("#options button"));
    page.until("undone", "document.getElementById('said').textContent === 'Mask of lamp_0 saved'");
    let end = Instant::now() + Duration::from_secs(30);
    while farthest(&place.image("scene/masks/lamp_0.png"), &before) > 1 {
        assert!(Instant::now() < end, "the stroke is taken back");
        std::thread::sleep(Duration::from_millis(25));
    }
    assert_eq!(page.faults(), Vec::<String>::new());
}

#[test]
fn a_wall_is_painted() {
    let Some(place) = Place::new() else { return };
    let server = place.serve();
    let page = place.open(&server);
    Place::settled(&page);
    let before = page.picture();
    page.key("p", "KeyP", Held::Nothing);
    page.click(page.at_pixel(160.0, 45.0));
    place.until_file("out/edit.ron", "it is painted", |text| {
        text.contains("    materials: [\n        Paint(region: Grow(160, 45), albedo: Srgb(\"#b5563c\")),\n    ],\n")
    });
    Place::settled(&page);
    let painted = page.picture();
    let (old, new) = (before.get_pixel(120, 60), painted.get_pixel(120, 60));
    assert!(new.0[0] > new.0[2] + 40 && old.0[0] < old.0[2] + 40, "{old:?} {new:?}");
    close("paint", &painted, &place.fresh("out/edit.ron", "fresh"));
    // A ball beside it, and off again.
    page.key("o", "KeyO", Held::Nothing);
    page.click(page.at_pixel(96.0, 205.0));
    place.until_file("out/edit.ron", "there is a ball", |text| {
        text.contains("        Sphere(radius: 0.1, at: Pixel(x: 96, y: 205), material: (albedo: Srgb(\"#c8c4bc\"))),\n")
    });
    page.click_on("[aria-label=\"sphere 1: remove\"]");
    place.until_file("out/edit.ron", "it is gone", |text| !text.contains("objects"));
    assert_eq!(page.faults(), Vec::<String>::new());
}

#[test]
fn the_keyboard_is_enough() {
    let Some(place) = Place::new() else { return };
    let server = place.serve();
    let page = place.open(&server);
    Place::settled(&page);
    let tabs = (1..60).find(|_| {
        page.key("Tab", "Tab", Held::Nothing);
        page.eval("document.activeElement.getAttribute('aria-label')") == "lamp_0: on"
    });
    assert!(tabs.is_some(), "the switch is reached by Tab");
    page.key(" ", "Space", Held::Nothing);
    place.until_file("out/edit.ron", "the lamp is off", |text| {
        text.contains("        \"lamp_0\": Off,\n")
    });
    Place::settled(&page);
    close("off", &page.picture(), &place.fresh("out/edit.ron", "fresh"));
    // A lamp by the cursor.
    page.key("l", "KeyL", Held::Nothing);
    for key in ["ArrowDown", "ArrowDown", "ArrowRight"] {
        page.key(key, key, Held::Nothing);
    }
    page.key("Enter", "Enter", Held::Nothing);
    place.until_file("out/edit.ron", "there is a lamp", |text| {
        text.contains("\"lamp\": Lamp(shape: Sphere(radius: 0.06), at: Pixel(x: 166, y: 132)")
    });
    page.key("?", "Slash", Held::Shift);
    assert_eq!(page.eval("document.getElementById('help').open"), true);
    page.key("Escape", "Escape", Held::Nothing);
    // Each control has a name.
    let nameless = page.eval(
        "[...document.querySelectorAll('button, input, select, textarea, [tabindex]')].filter((e) => !(e.getAttribute('aria-label') || e.getAttribute('aria-labelledby') || e.labels?.length || e.textContent.trim() || e.matches('.scroll'))).map((e) => e.outerHTML)",
    );
    assert_eq!(nameless, serde_json::json!([]));
}

#[test]
fn splices_keep_the_rest() {
    let Some(place) = Place::new() else { return };
    let server = place.serve();
    let page = place.open(&server);
    let cases = include_str!("splices.js");
    let faults = page.eval(&format!("(async () => {{ {cases} }})()"));
    assert_eq!(faults, serde_json::json!([]));
}

/// Pictures of the page for a person to look at: `cargo test --test serve_page -- --ignored` writes
/// them into target/serve_page.
#[test]
#[ignore = "it writes pictures for a person to look at"]
fn screenshots() {
    let Some(place) = Place::new() else { return };
    let folder = root().join("target/serve_page");
    std::fs::create_dir_all(&folder).expect("a folder can be made");
    let server = place.serve();
    for scheme in ["dark", "light"] {
        for (width, height) in [(400, 860), (1280, 800), (3840, 2160)] {
            let page = place.open(&server);
            let feature = serde_json::json!({ "name": "prefers-color-scheme", "value": scheme });
            page.send("Emulation.setEmulatedMedia", serde_json::json!({ "features": [feature] }));
            page.size(width, height);
            Place::settled(&page);
            std::thread::sleep(Duration::from_millis(500));
            let path = folder.join(format!("{scheme}_{width}.png"));
            page.window().save(path).expect("it can be written");
        }
    }
}
