//! Chromium, driven by a person's clicks and keys: its debugging protocol on two named pipes, one
//! JSON message after the other, each ended by a zero byte.

use std::cell::RefCell;
use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};

/// Longest wait for anything: the machine may do other work as well.
const PATIENCE: Duration = Duration::from_secs(120);

/// A browser that can be driven: the one that `CHROME` names, or one on the path.
pub fn find() -> Option<PathBuf> {
    let named = std::env::var_os("CHROME").map(PathBuf::from);
    let paths = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&paths).flat_map(|folder| {
        ["chromium", "chromium-browser", "google-chrome", "chrome"].map(|name| folder.join(name))
    });
    named.or_else(|| found.into_iter().find(|path| path.is_file()))
}

/// A running browser.
pub struct Browser {
    child: Child,
    pipe: RefCell<File>,
    answers: Receiver<Value>,
    last: RefCell<u64>,
    /// Exceptions of pages, and requests that a policy refused.
    faults: RefCell<Vec<String>>,
}

/// Keys held with another.
#[derive(Clone, Copy)]
pub enum Held {
    Nothing = 0,
    Control = 2,
    Shift = 8,
    ControlShift = 10,
}

impl Browser {
    /// Starts a browser whose files lie in `folder`.
    pub fn start(program: &Path, folder: &Path) -> Browser {
        let pipes = ["to", "from"].map(|name| folder.join(name));
        let made = Command::new("mkfifo").args(&pipes).status().expect("mkfifo starts");
        assert!(made.success(), "pipes can be made");
        let child = Command::new("sh")
            .args(["-c", r#"to=$1 from=$2; shift 2; exec "$0" "$@" 3<"$to" 4>"$from""#])
            .arg(program)
            .args(&pipes)
            .args(["--headless=new", "--no-sandbox", "--remote-debugging-pipe"])
            .args(["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run"])
            .arg(format!("--user-data-dir={}", folder.join("profile").display()))
            .arg("about:blank")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the shell starts");
        let pipe = OpenOptions::new().write(true).open(&pipes[0]).expect("the browser reads");
        let from = File::open(&pipes[1]).expect("the browser writes");
        let (sender, answers) = channel();
        std::thread::spawn(move || {
            let mut from = BufReader::new(from);
            let mut message = Vec::new();
            while from.read_until(0, &mut message).is_ok_and(|count| count > 0) {
                message.pop();
                let value = serde_json::from_slice(&message).expect("the browser writes JSON");
                message.clear();
                if sender.send(value).is_err() {
                    break;
                }
            }
        });
        Browser {
            child,
            pipe: RefCell::new(pipe),
            answers,
            last: RefCell::new(0),
            faults: RefCell::default(),
        }
    }

    fn send(&self, session: Option<&str>, method: &str, parameters: Value) -> Value {
        let id = *self.last.borrow() + 1;
        *self.last.borrow_mut() = id;
        let mut message = json!({ "id": id, "method": method, "params": parameters });
        if let Some(session) = session {
            message["sessionId"] = session.into();
        }
        let mut bytes = message.to_string().into_bytes();
        bytes.push(0);
        self.pipe.borrow_mut().write_all(&bytes).expect("the browser runs");
        let end = Instant::now() + PATIENCE;
        loop {
            let left = end.saturating_duration_since(Instant::now());
            let answer = self
                .answers
                .recv_timeout(left)
                .unwrap_or_else(|e| panic!("{method} has no answer: {e}"));
            if answer["id"] == id {
                assert!(answer["error"].is_null(), "{method}: {}", answer["error"]);
                return answer["result"].clone();
            }
            let fault = match answer["method"].as_str() {
                Some("Runtime.exceptionThrown") => {
                    let details = &answer["params"]["exceptionDetails"];
                    Some(format!("{} {}", details["text"], details["exception"]["description"]))
                }
                Some("Log.entryAdded") => {
                    let entry = &answer["params"]["entry"];
                    (entry["source"] == "security" || entry["source"] == "javascript")
                        .then(|| entry["text"].to_string())
                }
                _ => None,
            };
            self.faults.borrow_mut().extend(fault);
        }
    }

    /// Opens a page of this size.
    pub fn page(&self, url: &str, (width, height): (u32, u32)) -> Page<'_> {
        let target = self.send(None, "Target.createTarget", json!({ "url": "about:blank" }));
        let attached = self.send(
            None,
            "Target.attachToTarget",
            json!({ "targetId": target["targetId"], "flatten": true }),
        );
        let session = attached["sessionId"].as_str().expect("a session has a name").to_owned();
        let page = Page { browser: self, session };
        for domain in ["Page.enable", "Runtime.enable", "Log.enable"] {
            page.send(domain, json!({}));
        }
        page.size(width, height);
        page.open(url);
        page
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// An open page.
pub struct Page<'a> {
    browser: &'a Browser,
    session: String,
}

impl Drop for Page<'_> {
    /// Closes it, as the stream of its events takes one of the few connections to a server.
    fn drop(&mut self) {
        if !std::thread::panicking() {
            self.send("Page.close", json!({}));
        }
    }
}

impl Page<'_> {
    pub fn send(&self, method: &str, parameters: Value) -> Value {
        self.browser.send(Some(&self.session), method, parameters)
    }

    pub fn size(&self, width: u32, height: u32) {
        let size =
            json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        self.send("Emulation.setDeviceMetricsOverride", size);
    }

    /// Goes to an address, and waits until the page shows a picture.
    pub fn open(&self, url: &str) {
        self.send("Page.navigate", json!({ "url": url }));
        self.until(
            "the page shows a picture",
            "window.relight?.model.manifest && document.documentElement.dataset.drawn",
        );
    }

    /// The value of an expression or a promise.
    pub fn eval(&self, script: &str) -> Value {
        let parameters =
            json!({ "expression": script, "awaitPromise": true, "returnByValue": true });
        let result = self.send("Runtime.evaluate", parameters);
        let fault = &result["exceptionDetails"];
        assert!(fault.is_null(), "{script}: {}", fault["exception"]["description"]);
        result["result"]["value"].clone()
    }

    /// Waits until a condition of the page holds.
    #[track_caller]
    pub fn until(&self, what: &str, condition: &str) {
        let end = Instant::now() + PATIENCE;
        while self.eval(&format!("Boolean({condition})")) != true {
            if Instant::now() > end {
                let said = self.eval("JSON.stringify([document.getElementById('said')?.textContent, relight.model.run, relight.model.faults, relight.model.text])");
                panic!("in vain until {what}: {said}");
            }
            std::thread::sleep(Duration::from_millis(25));
        }
    }

    pub fn text(&self, script: &str) -> String {
        self.eval(script).as_str().unwrap_or_else(|| panic!("{script} gives no text")).to_owned()
    }

    /// The middle of an element, in pixels of the window.
    pub fn middle(&self, selector: &str) -> (f64, f64) {
        let place = self.eval(&format!(
            "(() => {{ const e = document.querySelector({selector:?}); e.scrollIntoView({{ block: 'nearest' }}); const b = e.getBoundingClientRect(); return [b.left + b.width / 2, b.top + b.height / 2]; }})()"
        ));
        (place[0].as_f64().expect("a number"), place[1].as_f64().expect("a number"))
    }

    /// The place of a photo pixel in the window.
    pub fn at_pixel(&self, x: f64, y: f64) -> (f64, f64) {
        let place = self.eval(&format!(
            "(() => {{ const b = document.getElementById('stage').getBoundingClientRect(), p = relight.toStage({x}, {y}); return [b.left + p.x, b.top + p.y]; }})()"
        ));
        (place[0].as_f64().expect("a number"), place[1].as_f64().expect("a number"))
    }

    /// The photo pixel at a place in the window.
    pub fn pixel_at(&self, x: f64, y: f64) -> (f64, f64) {
        let pixel = self.eval(&format!("(({{ x, y }}) => [x, y])(relight.toPhoto({x}, {y}))"));
        (pixel[0].as_f64().expect("a number"), pixel[1].as_f64().expect("a number"))
    }

    pub fn mouse(&self, kind: &str, (x, y): (f64, f64), buttons: u32) {
        let button = if kind == "mouseMoved" && buttons == 0 { "none" } else { "left" };
        let count = u32::from(kind != "mouseMoved");
        let event = json!({ "type": kind, "x": x, "y": y, "button": button, "buttons": buttons, "clickCount": count });
        self.send("Input.dispatchMouseEvent", event);
    }

    pub fn click(&self, at: (f64, f64)) {
        self.drag(&[at]);
    }

    pub fn click_on(&self, selector: &str) {
        self.click(self.middle(selector));
    }

    /// Presses at the first place, moves over the others, and lets go at the last.
    pub fn drag(&self, places: &[(f64, f64)]) {
        self.mouse("mouseMoved", places[0], 0);
        self.mouse("mousePressed", places[0], 1);
        for &place in &places[1..] {
            self.mouse("mouseMoved", place, 1);
        }
        self.mouse("mouseReleased", places[places.len() - 1], 0);
    }

    /// Presses a key: `key` as `KeyboardEvent.key` names it, with its code.
    pub fn key(&self, key: &str, code: &str, held: Held) {
        let number = match code.as_bytes() {
            [b'K', b'e', b'y', letter] => u32::from(*letter),
            [b'D', b'i', b'g', b'i', b't', digit] => u32::from(*digit),
            _ => match code {
                "Tab" => 9,
                "Enter" => 13,
                "Escape" => 27,
                "Space" => 32,
                "ArrowLeft" => 37,
                "ArrowUp" => 38,
                "ArrowRight" => 39,
                "ArrowDown" => 40,
                _ => 0,
            },
        };
        let types = key.chars().count() == 1 && !matches!(held, Held::Control | Held::ControlShift);
        let mut event = json!({ "type": if types { "keyDown" } else { "rawKeyDown" }, "key": key, "code": code, "modifiers": held as u32, "windowsVirtualKeyCode": number });
        if types {
            event["text"] = key.into();
        } else if key == "Enter" {
            event["type"] = "keyDown".into();
            event["text"] = "\r".into();
        }
        self.send("Input.dispatchKeyEvent", event.clone());
        event["type"] = "keyUp".into();
        self.send("Input.dispatchKeyEvent", event);
    }

    /// Types a text where the focus is.
    pub fn type_text(&self, text: &str) {
        self.send("Input.insertText", json!({ "text": text }));
    }

    /// The picture that the page shows, at the size of its layers.
    pub fn picture(&self) -> image::RgbImage {
        let url = self.text(
            "(() => { const image = relight.readPicture(), c = document.createElement('canvas'); c.width = image.width; c.height = image.height; c.getContext('2d').putImageData(image, 0, 0); return c.toDataURL(); })()",
        );
        let bytes = STANDARD.decode(url.trim_start_matches("data:image/png;base64,"));
        image::load_from_memory(&bytes.expect("it is base64")).expect("it is a PNG").to_rgb8()
    }

    /// The window as a person sees it.
    pub fn window(&self) -> image::RgbImage {
        let shot = self.send("Page.captureScreenshot", json!({ "format": "png" }));
        let bytes = STANDARD.decode(shot["data"].as_str().expect("a picture")).expect("base64");
        image::load_from_memory(&bytes).expect("it is a PNG").to_rgb8()
    }

    /// Faults of scripts and refusals of the page's policy so far.
    pub fn faults(&self) -> Vec<String> {
        self.eval("0");
        self.browser.faults.borrow().clone()
    }
}
