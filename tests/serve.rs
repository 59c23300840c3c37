//! `relight serve` over a real socket, and `relight run --watch`: who may use the server, what
//! becomes of texts and files, and that its pictures are those of `relight run`.

#![cfg(feature = "serve")]

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// A working size at which the room takes a second.
const SIZE: [&str; 2] = ["--set", "scene.long_side=96"];
/// No wait of these tests is longer, on a busy machine either.
const PATIENCE: Duration = Duration::from_secs(120);
const NONE: &str = "Edit(version: 1)\n";
const OFF: &str = "Edit(\n    version: 1,\n    lights: { \"lamp_0\": Off },\n)\n";
const DESK: &str = r#""desk": Lamp(shape: Sphere(radius: 0.07), at: Point(0.12, -0.56, -2.94), radiance: (72, 44, 20))"#;

fn lights(entries: &str) -> String {
    format!("Edit(version: 1, lights: {{ {entries} }})")
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A folder with a copy of the small room, for a server or a command.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Place {
        let place = Place(tempfile::tempdir().expect("a temporary folder can be made"));
        let small = root().join("tests/scenes/small");
        std::fs::create_dir_all(place.path("room/masks")).expect("a folder can be made");
        for name in
            ["scene.ron", "photo.png", "depth.exr", "masks/lamp_0.png", "masks/window_0.png"]
        {
            std::fs::copy(small.join(name), place.path("room").join(name))
                .expect("it can be copied");
        }
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    fn write(&self, name: &str, text: impl AsRef<[u8]>) {
        std::fs::write(self.path(name), text).expect("a file can be written");
    }

    fn command(&self, words: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
        command.current_dir(self.0.path()).args(words).args(["--cache", "cache"]);
        command
            .env("HOME", self.path("home"))
            .env_remove("XDG_CONFIG_HOME")
            .env_remove("RELIGHT_LOG");
        // Any file serves as the key of a cache of tests.
        command.args(["--cache-key"]).arg(root().join("tests/scenes/small/scene.ron"));
        command
    }

    /// Runs `relight run` of an edit file.
    fn run(&self, edit: &str, out: &str) {
        let graph = root().join("graphs/physics.ron");
        let words = ["run", graph.to_str().expect("ASCII"), edit, "--scene", "room", "--out", out];
        let output = self.command(&[&words, &SIZE[..]].concat()).output().expect("it starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}

/// A running server; the end of the test kills it.
struct Server {
    child: Child,
    port: u16,
    token: String,
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

struct Response {
    status: u16,
    head: String,
    body: Vec<u8>,
}

impl Response {
    #[track_caller]
    fn json(&self) -> Value {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&self.body)))
    }
}

impl Server {
    fn start(place: &Place) -> Server {
        Server::with(place, &[])
    }

    fn with(place: &Place, words: &[&str]) -> Server {
        let graph = root().join("graphs/physics.ron");
        let own = ["serve", "room", "--graph", graph.to_str().expect("ASCII"), "--out", "out"];
        let mut command = place.command(&[&own, &SIZE[..], words].concat());
        let log = std::fs::File::create(place.path("log")).expect("a file can be made");
        let mut child = command.stdout(Stdio::piped()).stderr(log).spawn().expect("it starts");
        let mut line = String::new();
        let out = child.stdout.take().expect("it is piped");
        BufReader::new(out).read_line(&mut line).expect("it prints its address");
        let parts = line.trim().strip_prefix("http://127.0.0.1:");
        let parts = parts.and_then(|rest| rest.split_once("/?token="));
        let (port, token) = parts.unwrap_or_else(|| {
            panic!("got {line:?}: {}", String::from_utf8_lossy(&place.read("log")))
        });
        Server { child, port: port.parse().expect("a port"), token: token.to_owned() }
    }

    fn open(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> TcpStream {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a timeout can be set");
        let mut head = format!("{method} {path} HTTP/1.1\r\nConnection: close\r\n");
        for (name, value) in headers {
            head += &format!("{name}: {value}\r\n");
        }
        head += &format!("Content-Length: {}\r\n\r\n", body.len());
        stream.write_all(head.as_bytes()).expect("it reads");
        // A server that refuses a body need not read it.
        let _ = stream.write_all(body);
        stream
    }

    fn raw(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Response {
        let mut bytes = Vec::new();
        let _ = self.open(method, path, headers, body).read_to_end(&mut bytes);
        let at =
            bytes.windows(4).position(|four| four == b"\r\n\r\n").expect("an answer has a head");
        let head = String::from_utf8(bytes[..at].to_vec()).expect("a head is ASCII");
        let status = head.split(' ').nth(1).and_then(|code| code.parse().ok()).expect("a status");
        Response { status, head: head.to_lowercase(), body: bytes[at + 4..].to_vec() }
    }

    fn own(&self) -> [(String, String); 2] {
        let host = ("Host".to_owned(), format!("127.0.0.1:{}", self.port));
        [host, ("Authorization".to_owned(), format!("Bearer {}", self.token))]
    }

    fn ask(&self, method: &str, path: &str, body: &[u8]) -> Response {
        let own = self.own();
        let headers: Vec<(&str, &str)> =
            own.iter().map(|(n, v)| (n.as_str(), v.as_str())).collect();
        self.raw(method, path, &headers, body)
    }

    fn get(&self, path: &str) -> Response {
        self.ask("GET", path, b"")
    }

    fn state(&self) -> Value {
        self.get("/api/state").json()
    }

    fn put(&self, base: u64, text: &str) -> Response {
        self.ask("PUT", &format!("/api/edit?base={base}"), text.as_bytes())
    }

    /// Sends an accepted edit; returns its revision.
    #[track_caller]
    fn edit(&self, text: &str) -> u64 {
        let base = self.state()["edit"]["revision"].as_u64().expect("a revision");
        let answer = self.put(base, text);
        assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
        answer.json()["revision"].as_u64().expect("a revision")
    }

    /// Waits until the newest run is done; returns its revision.
    #[track_caller]
    fn done(&self) -> u64 {
        let began = Instant::now();
        loop {
            let run = self.state()["run"].clone();
            match run["status"].as_str() {
                Some("done") => return run["revision"].as_u64().expect("a revision"),
                Some("failed") => panic!("{run}"),
                _ => assert!(began.elapsed() < PATIENCE, "{run}"),
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn events(&self) -> Events {
        let own = self.own();
        let headers: Vec<(&str, &str)> =
            own.iter().map(|(n, v)| (n.as_str(), v.as_str())).collect();
        let mut events = Events {
            lines: BufReader::new(self.open("GET", "/api/events", &headers, b"")),
            all: vec![],
        };
        events.until("state", |_| true);
        events
    }
}

/// The events of a server, in order.
struct Events {
    lines: BufReader<TcpStream>,
    all: Vec<(String, Value)>,
}

impl Events {
    /// Reads up to the first event of this name that fits.
    #[track_caller]
    fn until(&mut self, name: &str, fits: impl Fn(&Value) -> bool) -> Value {
        let mut current = String::new();
        loop {
            let mut line = String::new();
            let count = self.lines.read_line(&mut line);
            assert!(count.is_ok_and(|n| n > 0), "no {name} among {:?}", self.all);
            if let Some(name) = line.trim_end().strip_prefix("event: ") {
                current = name.to_owned();
            }
            if let Some(data) = line.trim_end().strip_prefix("data: ") {
                let data: Value = serde_json::from_str(data).expect("events are JSON");
                self.all.push((current.clone(), data.clone()));
                if current == name && fits(&data) {
                    return data;
                }
            }
        }
    }

    #[track_caller]
    fn finished(&mut self, revision: u64) -> Value {
        self.until("finished", |data| data["revision"] == revision)
    }
}

#[test]
fn strangers_are_refused() {
    let place = Place::new();
    let server = Server::start(&place);
    let host = format!("127.0.0.1:{}", server.port);
    let bearer = format!("Bearer {}", server.token);
    let (host, bearer) = (("Host", host.as_str()), ("Authorization", bearer.as_str()));
    let status =
        |path: &str, headers: &[(&str, &str)]| server.raw("GET", path, headers, b"").status;
    assert_eq!(status("/api/state", &[host, bearer]), 200);
    for path in ["/", "/assets/main.js", "/api/state", "/api/events", "/api/nothing"] {
        assert_eq!(status(path, &[host]), 401, "{path}");
        assert_eq!(status(path, &[host, ("Authorization", "Bearer 00")]), 401, "{path}");
        assert_eq!(status(path, &[("Host", "evil.example"), bearer]), 421, "{path}");
        assert_eq!(status(path, &[host, bearer, ("Origin", "http://evil.example")]), 403, "{path}");
    }
    let edit =
        server.raw("PUT", "/api/edit?base=1", &[host, ("Origin", "null"), bearer], OFF.as_bytes());
    assert_eq!(edit.status, 403);
    assert!(!place.path("out/edit.ron").exists());

    // The printed address gives a cookie that scripts and other sites do not get.
    let opened = server.raw("GET", &format!("/?token={}", server.token), &[host], b"");
    assert_eq!(opened.status, 303);
    assert!(opened.head.contains("location: /\r\n"), "{}", opened.head);
    let cookie = opened.head.lines().find_map(|line| line.strip_prefix("set-cookie: "));
    let cookie = cookie.expect("a cookie is set").to_owned();
    assert!(cookie.contains("; httponly; samesite=strict"), "{cookie}");
    let cookie = ("Cookie", cookie.split(';').next().expect("a cookie"));
    let page = server.raw("GET", "/", &[host, cookie], b"");
    assert_eq!(page.status, 200);
    for header in [
        "content-security-policy: default-src 'none'",
        "x-content-type-options: nosniff",
        "cache-control: no-store",
    ] {
        assert!(page.head.contains(header), "{header}: {}", page.head);
    }
    assert_eq!(status("/?token=00", &[host]), 401);

    // Nothing of this is the end of it, and neither are bodies of any size or kind.
    assert_eq!(server.put(1, &" ".repeat(2 << 20)).status, 413);
    assert_eq!(server.ask("PUT", "/api/edit?base=1", b"\xff\xfe").status, 400);
    assert_eq!(server.ask("PUT", "/api/edit?base=x", b"").status, 400);
    assert_eq!(status("/api/state", &[host, bearer]), 200);
}

#[test]
fn a_bad_edit_loses_nothing_and_a_stale_one_is_told() {
    let place = Place::new();
    place.write("edit.ron", OFF);
    let server = Server::with(&place, &["--edit", "edit.ron"]);
    let bad = "Edit(\n    version: 1,\n    lights: { \"lamp_9\": Off },\n)\n";
    let answer = server.put(1, bad);
    assert_eq!(answer.status, 422);
    let fault = &answer.json()["diagnostics"][0];
    assert_eq!(
        (&fault["line"], &fault["column"], &fault["end_column"]),
        (&json!(3), &json!(15), &json!(23))
    );
    assert_eq!(fault["message"], "unknown light `lamp_9`");
    assert_eq!(fault["help"], "did you mean `lamp_0`?");
    assert_eq!(answer.json()["text"], bad);
    let outside = server.put(
        1,
        &lights(r#""a": Lamp(shape: Sphere(radius: 0.1), at: Pixel(x: 999, y: 1), flux: 1)"#),
    );
    assert_eq!(outside.status, 422);
    assert_eq!(outside.json()["diagnostics"][0]["line"], 1);
    let frames = server.put(1, "Edit(version: 1, frames: 3)");
    assert!(
        frames.json()["diagnostics"][0]["message"].as_str().is_some_and(|m| m.contains("3 frames"))
    );
    server.put(1, bad);
    let state = server.state();
    assert_eq!((&state["edit"]["text"], &state["edit"]["revision"]), (&json!(OFF), &json!(1)));
    assert_eq!(state["draft"]["text"], bad);
    assert_eq!(place.read("edit.ron"), OFF.as_bytes());

    // A kill loses neither text.
    drop(server);
    let server = Server::with(&place, &["--edit", "edit.ron"]);
    let state = server.state();
    assert_eq!((&state["edit"]["text"], &state["draft"]["text"]), (&json!(OFF), &json!(bad)));
    assert_eq!(state["draft"]["diagnostics"][0]["line"], 3);

    assert_eq!(server.edit(NONE), 2);
    assert_eq!(place.read("edit.ron"), NONE.as_bytes());
    assert_eq!(server.state()["draft"], Value::Null);
    let stale = server.put(1, OFF);
    assert_eq!(stale.status, 409);
    assert_eq!(stale.json(), json!({ "revision": 2, "text": NONE }));
    // An editor that saved a moment ago was faster, too.
    place.write("edit.ron", OFF);
    let stale = server.put(2, NONE);
    assert_eq!((stale.status, stale.json()["text"].as_str()), (409, Some(OFF)));
    assert_eq!(place.read("edit.ron"), OFF.as_bytes());
}

#[test]
fn pictures_of_the_server_are_those_of_the_command() {
    let place = Place::new();
    let server = Server::start(&place);
    server.done();
    std::fs::create_dir(place.path("before")).expect("a folder can be made");
    std::fs::copy(place.path("out/picture.exr"), place.path("before/picture.exr"))
        .expect("it is there");
    let mut events = server.events();

    let revision = server.edit(OFF);
    let finished = events.finished(revision);
    let ran: Vec<&str> = finished["ran"]
        .as_array()
        .expect("a list")
        .iter()
        .filter_map(|r| r["name"].as_str())
        .collect();
    assert!(ran.contains(&"compose") && !ran.contains(&"edited_shadow[lamp_0]"), "{ran:?}");
    place.run("out/edit.ron", "again");
    for name in ["picture.png", "picture.exr"] {
        assert!(
            place.read(&format!("out/{name}")) == place.read(&format!("again/{name}")),
            "{name}"
        );
    }
    assert_eq!(server.get("/api/picture.png").body, place.read("out/picture.png"));

    // Weights on the layers of the server, in the place of changes of radiance.
    let scaled = r#""lamp_0": [Scale(0.5)], "window_0": Scale(1.7), "inv_lamp": Off"#;
    let revision = server.edit(&lights(scaled));
    events.finished(revision);
    let weights = BTreeMap::from([("lamp_0", 0.5), ("window_0", 1.7), ("inv_lamp", 0.0)]);
    let mixed = mixed(&server, &weights);
    let set = ["--set", "lamp_0=0.5", "--set", "window_0=1.7", "--set", "inv_lamp=0"];
    let mut mix = Command::new(env!("CARGO_BIN_EXE_relight"));
    mix.current_dir(place.0.path()).args(["mix", "before", "--out", "mix.png"]).args(set);
    assert!(mix.status().expect("it starts").success());
    for name in ["mix.png", "out/picture.png"] {
        let picture = image::load_from_memory(&place.read(name)).expect("a picture").to_rgb8();
        let far = picture.iter().zip(&mixed).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(far.is_some_and(|far| far <= 2), "{name}: {far:?} of 255");
    }
    let manifest = server.get("/api/layers").json();
    let entries: Vec<&Value> =
        manifest["lights"].as_array().expect("a list").iter().map(|l| &l["entry"]).collect();
    assert_eq!(entries, [&Value::Null; 4], "the base has no change of radiance");

    // A light keeps its layer as long as nothing but radiances change, and only then.
    let layer = |id: &str| {
        let manifest = server.get("/api/layers").json();
        let all = manifest["lights"].as_array().expect("a list").clone();
        all.into_iter().find(|light| light["id"] == id).unwrap_or_default()
    };
    let before = layer("window_0")["digest"].clone();
    let revision = server.edit(&lights(&format!("{scaled}, {DESK}")));
    events.finished(revision);
    assert_ne!(layer("window_0")["digest"], before, "the new lamp hides a part of the room");
    let desk = layer("desk");
    assert_eq!((&desk["kind"], &desk["radiance"]), (&json!("Lamp"), &json!([[72.0, 44.0, 20.0]])));
    assert_eq!(desk["entry"].as_str(), DESK.split_once(": ").map(|(_, value)| value));

    // A preview has layers of its own and leaves all files as they are.
    let kept =
        ["edit.ron", "picture.png", "report.json"].map(|name| place.read(&format!("out/{name}")));
    let text = lights(&DESK.replace("0.12", "0.3"));
    let answer =
        server.ask("PUT", &format!("/api/edit?base={revision}&preview=1"), text.as_bytes());
    assert_eq!(answer.status, 200);
    events.finished(answer.json()["revision"].as_u64().expect("a revision"));
    let manifest = server.get("/api/layers").json();
    assert_eq!(
        (&manifest["preview"], &manifest["size"], &manifest["full"]),
        (&json!(true), &json!([96, 72]), &json!([320, 240]))
    );
    for (name, kept) in ["edit.ron", "picture.png", "report.json"].iter().zip(kept) {
        assert!(place.read(&format!("out/{name}")) == kept, "{name}");
    }
    assert_eq!(server.state()["edit"]["revision"], revision);
    for path in
        ["/api/photo", "/api/graph.svg", "/api/report.json", "/api/room", "/api/masks/lamp_0"]
    {
        assert_eq!(server.get(path).status, 200, "{path}");
    }
    for path in
        ["/api/blob/00", "/api/masks/inv_lamp", "/assets/..%2fauth.rs", "/api/masks/..%2f..%2flog"]
    {
        assert_eq!(server.get(path).status, 404, "{path}");
    }
}

/// The picture of the server's layers under these weights, as the page computes it.
fn mixed(server: &Server, weights: &BTreeMap<&str, f32>) -> Vec<u8> {
    let manifest = server.get("/api/layers").json();
    let unpack = |layer: &Value| -> Vec<f32> {
        let digest = layer["digest"].as_str().expect("a digest");
        let packed = server.get(&format!("/api/blob/{digest}"));
        assert!(packed.head.contains("immutable"), "{}", packed.head);
        let mut bytes = Vec::new();
        flate2::read::ZlibDecoder::new(&packed.body[..])
            .read_to_end(&mut bytes)
            .expect("it is sound");
        let (low, high) = bytes.split_at(bytes.len() / 2);
        let scale = layer["scale"].as_f64().expect("a number") as f32;
        let mut bits = 0u16;
        let number = |(&l, &h): (&u8, &u8)| {
            bits = bits.wrapping_add(u16::from_le_bytes([l, h]));
            half::f16::from_bits(bits).to_f32() * scale
        };
        low.iter().zip(high).map(number).collect()
    };
    let mut sum = unpack(&manifest["rest"]);
    for light in manifest["lights"].as_array().expect("a list") {
        let weight = weights.get(light["id"].as_str().expect("a name")).copied().unwrap_or(1.0);
        sum.iter_mut().zip(unpack(light)).for_each(|(sum, part)| *sum += weight * part);
    }
    assert_eq!(manifest["transfer"], "Srgb");
    let encode = |linear: f32| match linear.clamp(0.0, 1.0) {
        l if l <= 0.003_130_8 => l * 12.92,
        l => 1.055 * l.powf(1.0 / 2.4) - 0.055,
    };
    let pixels = sum.len() / 3;
    (0..pixels)
        .flat_map(|p| [0, 1, 2].map(|c| (255.0 * encode(sum[c * pixels + p])).round() as u8))
        .collect()
}

#[test]
fn a_newer_edit_cancels_the_run_of_the_older_one() {
    let place = Place::new();
    let server = Server::with(
        &place,
        &["--set", "edited_shadow.samples=512", "--set", "edited_shadow.max_samples=4096"],
    );
    server.done();
    let mut events = server.events();
    let older = server.edit(&lights(DESK));
    events.until("progress", |data| data["revision"] == older);
    let newer = server.edit(OFF);
    let finished = events.finished(newer);
    assert!(finished["seconds"].as_f64().is_some_and(|seconds| seconds > 0.0));
    assert!(!events.all.iter().any(|(name, data)| name == "finished" && data["revision"] == older));
    assert_eq!(place.read("out/edit.ron"), OFF.as_bytes());
}

#[test]
fn snapshots_have_plain_names() {
    let place = Place::new();
    let server = Server::start(&place);
    assert_eq!(server.get("/api/snapshots").json(), json!([]));
    for name in ["evening", "two%20lamps", "b%C3%BCro.1"] {
        assert_eq!(
            server.ask("PUT", &format!("/api/snapshots/{name}"), OFF.as_bytes()).status,
            200,
            "{name}"
        );
    }
    assert_eq!(server.get("/api/snapshots").json(), json!(["büro.1", "evening", "two lamps"]));
    assert_eq!(server.get("/api/snapshots/two%20lamps").body, OFF.as_bytes());
    assert_eq!(place.read("out/snapshots/evening.ron"), OFF.as_bytes());
    for name in [
        "..%2fevil",
        "..",
        "%2e%2e%2f%2e%2e%2fevil",
        ".hidden",
        "a%2fb",
        "masks%2fa",
        "a%5cb",
        "con",
        "a%00",
        "%20%20.%20",
    ] {
        let answer = server.ask("PUT", &format!("/api/snapshots/{name}"), b"theirs");
        assert!([400, 404].contains(&answer.status), "{name}: {}", answer.status);
        assert!(
            server.ask("DELETE", &format!("/api/snapshots/{name}"), b"").status >= 400,
            "{name}"
        );
    }
    let names: Vec<_> =
        std::fs::read_dir(place.path("out/snapshots")).expect("it is there").collect();
    assert_eq!(names.len(), 3);
    assert_eq!(server.ask("DELETE", "/api/snapshots/evening", b"").status, 200);
    assert_eq!(server.ask("DELETE", "/api/snapshots/evening", b"").status, 404);
    assert_eq!(server.get("/api/snapshots/evening").status, 404);
    #[cfg(unix)]
    {
        let _ = std::fs::remove_dir_all(place.path("out/snapshots"));
        std::os::unix::fs::symlink(place.path("room"), place.path("out/snapshots"))
            .expect("a link can be made");
        assert_eq!(server.ask("PUT", "/api/snapshots/evening", b"theirs").status, 400);
        assert!(!place.path("room/evening.ron").exists());
    }
}

#[test]
fn a_killed_server_finds_its_edit_again_and_an_editor_is_followed() {
    let place = Place::new();
    let server = Server::start(&place);
    server.edit(OFF);
    drop(server); // killed
    let server = Server::start(&place);
    assert_eq!(server.state()["edit"]["text"], OFF);
    server.done();
    place.run("out/edit.ron", "again");
    assert!(place.read("out/picture.png") == place.read("again/picture.png"));

    let mut events = server.events();
    let saved = lights(r#""window_0": Scale(0.5)"#);
    place.write("out/edit.ron", &saved);
    let edit = events.until("edit", |_| true);
    assert_eq!(edit["text"], saved);
    events.finished(edit["revision"].as_u64().expect("a revision"));
    place.run("out/edit.ron", "again");
    assert!(place.read("out/picture.png") == place.read("again/picture.png"));

    // A text with faults is what the editor has, so the page has it, too.
    place.write("out/edit.ron", "Edit(version: 1,\n lights: { \"lamp_0\": Of })");
    let problem = events.until("problem", |_| true);
    assert_eq!(problem["diagnostics"][0]["line"], 2, "{problem}");
    assert_eq!(server.state()["run"]["status"], "failed");
    place.write("out/edit.ron", NONE);
    let edit = events.until("edit", |data| data["text"] == NONE);
    events.finished(edit["revision"].as_u64().expect("a revision"));

    // The files of the scene are followed, too.
    let scene = String::from_utf8(place.read("room/scene.ron")).expect("it is text");
    place.write("room/scene.ron", scene.replace("FovX(64.0)", "FovX(0)"));
    events.until("problem", |data| {
        data["diagnostics"][0]["path"].as_str().is_some_and(|p| p.ends_with("scene.ron"))
    });
    place.write("room/scene.ron", scene.replace("FovX(64.0)", "FovX(60.0)"));
    let done = events.until("finished", |_| true);
    assert!(
        done["ran"].as_array().is_some_and(|ran| ran.iter().any(|row| row["name"] == "init")),
        "{done}"
    );
}

#[test]
fn masks_are_those_of_the_photo_and_stay_in_the_scene() {
    let place = Place::new();
    let server = Server::start(&place);
    server.done();
    let mut events = server.events();
    let old = place.read("room/masks/lamp_0.png");
    assert_eq!(server.get("/api/masks/lamp_0").body, old);
    let png = |width, height| {
        let mask = image::GrayImage::from_fn(width, height, |x, y| {
            image::Luma([if x / 40 == 2 && y / 40 == 2 { 255 } else { 0 }])
        });
        let mut bytes = std::io::Cursor::new(Vec::new());
        mask.write_to(&mut bytes, image::ImageFormat::Png).expect("a picture can be written");
        bytes.into_inner()
    };
    for bad in [png(32, 24), b"GIF89a".to_vec(), b"\x89PNG\r\n\x1a\nnot".to_vec()] {
        assert_eq!(server.ask("PUT", "/api/masks/lamp_0", &bad).status, 422);
    }
    assert_eq!(place.read("room/masks/lamp_0.png"), old);
    let new = png(320, 240);
    assert_eq!(server.ask("PUT", "/api/masks/lamp_0", &new).status, 200);
    assert_eq!(
        (place.read("room/masks/lamp_0.png"), place.read("room/masks/lamp_0.before.png")),
        (new, old)
    );
    let done = events.until("finished", |_| true);
    assert!(
        done["ran"].as_array().is_some_and(|ran| ran.iter().any(|row| row["name"] == "init")),
        "{done}"
    );

    // So is that of the sunlight, where the scene names one.
    assert_eq!(server.get("/api/masks/sunlight").status, 404);
    let scene = String::from_utf8(place.read("room/scene.ron")).expect("it is text");
    let sunny = scene.replacen("lights:", "sunlight: \"masks/sun.png\", lights:", 1);
    assert_ne!(sunny, scene);
    let none = image::GrayImage::new(320, 240);
    none.save(place.path("room/masks/sun.png")).expect("it can be written");
    place.write("room/scene.ron", &sunny);
    events.until("finished", |_| true);
    assert_eq!(server.state()["masks"], json!(["lamp_0", "window_0", "sunlight"]));
    assert_eq!(server.ask("PUT", "/api/masks/sunlight", &png(320, 240)).status, 200);
    let done = events.until("finished", |_| true);
    assert!(
        done["ran"].as_array().is_some_and(|ran| ran.iter().any(|row| row["name"] == "sun")),
        "{done}"
    );

    // A scene of a stranger may name any file, which a page then must not write to.
    place.write("victim.png", png(320, 240));
    place.write("room/scene.ron", scene.replace("masks/window_0.png", "../victim.png"));
    events.until("finished", |_| true);
    assert_eq!(server.ask("PUT", "/api/masks/window_0", &png(320, 240)).status, 403);
}

#[test]
fn one_server_has_a_folder_and_ctrl_c_ends_it() {
    let place = Place::new();
    // A folder of a stranger may have a link in the place of the edit.
    place.write("victim", NONE);
    std::fs::create_dir(place.path("out")).expect("a folder can be made");
    #[cfg(unix)]
    std::os::unix::fs::symlink("../victim", place.path("out/edit.ron"))
        .expect("a link can be made");
    let mut server = Server::start(&place);
    server.edit(OFF);
    assert_eq!((place.read("victim"), place.read("out/edit.ron")), (NONE.into(), OFF.into()));
    let graph = root().join("graphs/physics.ron");
    let words = ["serve", "room", "--graph", graph.to_str().expect("ASCII"), "--out", "out"];
    let second = place.command(&words).output().expect("it starts");
    let message = String::from_utf8_lossy(&second.stderr);
    assert_eq!(second.status.code(), Some(2), "{message}");
    assert!(
        message.contains(&format!("uses this folder at http://127.0.0.1:{}/", server.port)),
        "{message}"
    );
    assert!(!message.contains(&server.token), "{message}");

    let bad = place
        .command(&["serve", "nowhere", "--graph", "nothing", "--out", "other"])
        .output()
        .expect("it starts");
    assert_eq!(bad.status.code(), Some(2));
    #[cfg(unix)]
    {
        let _events = server.events();
        let pid = server.child.id().to_string();
        assert!(Command::new("kill").args(["-INT", &pid]).status().expect("it starts").success());
        let began = Instant::now();
        let status = server.child.wait().expect("it ends");
        assert_eq!(status.code(), Some(130));
        assert!(began.elapsed() < Duration::from_secs(3));
        // The folder is free again.
        server = Server::start(&place);
        server.state();
    }
}

#[test]
fn a_watched_run_runs_again() {
    let place = Place::new();
    place.write("edit.ron", NONE);
    let graph = root().join("graphs/physics.ron");
    let words = ["run", graph.to_str().expect("ASCII"), "edit.ron", "--scene", "room", "--watch"];
    let mut command = place.command(&[&words, &SIZE[..]].concat());
    let mut child =
        command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("it starts");
    let mut lines = BufReader::new(child.stderr.take().expect("it is piped"));
    let mut until = |wanted: &str| {
        let mut all = String::new();
        loop {
            let mut line = String::new();
            let count = lines.read_line(&mut line).expect("it writes text");
            all += &line;
            assert!(count > 0, "no {wanted:?} in {all}");
            if line.contains(wanted) {
                return all;
            }
        }
    };
    until("waiting for a change");
    let before = place.read("out/picture.png");
    place.write("edit.ron", OFF);
    until("waiting for a change");
    assert!(place.read("out/picture.png") != before);
    // A fault is shown, and the next change is waited for.
    place.write("edit.ron", "Edit(version: 1, lights: { \"lamp_9\": Off })");
    let shown = until("waiting for a change");
    assert!(shown.contains("unknown light `lamp_9`"), "{shown}");
    place.write("edit.ron", NONE);
    until("waiting for a change");
    assert!(place.read("out/picture.png") == before);
    // So is a file that the scene names and that is missing for a while.
    std::fs::rename(place.path("room/depth.exr"), place.path("depth.exr")).expect("it is there");
    until("waiting for a change");
    std::fs::rename(place.path("depth.exr"), place.path("room/depth.exr")).expect("it is there");
    let shown = until("waiting for a change");
    assert!(shown.contains("nodes") || shown.contains("hit"), "{shown}");
    #[cfg(unix)]
    {
        let pid = child.id().to_string();
        assert!(Command::new("kill").args(["-INT", &pid]).status().expect("it starts").success());
        assert_eq!(child.wait().expect("it ends").code(), Some(130));
    }
    let _ = child.kill();
    let _ = child.wait();
}
