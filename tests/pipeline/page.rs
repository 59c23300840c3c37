//! report.html: whole in itself, harmless, and in a real browser its picture is that of the
//! program.

use std::path::{Path, PathBuf};
use std::process::Command;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use crate::mix::farthest;
use crate::project::*;

const RUN: &str = "run GRAPHS/physics.ron EDITS/none.ron --scene DEMO";

fn page(place: &Place) -> String {
    std::fs::read_to_string(place.path("run/report.html")).expect("the page was written")
}

/// The data that the page was given.
fn data(page: &str) -> serde_json::Value {
    let (_, after) = page
        .split_once(r#"<script type="application/json" id="data">"#)
        .expect("the page holds its data");
    serde_json::from_str(after.split_once("</script>").expect("it ends").0).expect("it is JSON")
}

#[test]
fn the_page_of_a_run() {
    let place = Place::new();
    place.check(&format!("{RUN} --out run --report"), 0);
    it_is_whole_in_itself(&place);
    its_pictures_are_those_of_the_program(&place);
    names_in_it_do_no_harm(&place);
    what_is_no_run_is_told(&place);
}

fn it_is_whole_in_itself(place: &Place) {
    let page = page(place);
    let elsewhere = page.replace("http://www.w3.org/2000/svg", "");
    for word in ["http:", "https:", "<link", "@import", "url("] {
        assert!(!elsewhere.contains(word), "the page holds {word}");
    }
    assert!(page.len() < 4_000_000, "{} bytes", page.len());
    let data = data(&page);
    let lights: Vec<&str> = data["lights"]
        .as_array()
        .expect("lights")
        .iter()
        .map(|l| l["id"].as_str().unwrap())
        .collect();
    assert_eq!(lights, ["inv_lamp", "inv_window", "lamp_0", "window_0"]);
    for light in ["lamp_0", "window_0"]
        .map(|id| &data["lights"][lights.iter().position(|l| *l == id).unwrap()])
    {
        for plane in ["shadow", "unknown", "stderr", "room_error"] {
            assert!(
                light[plane].as_str().is_some_and(|url| url.starts_with("data:image/png;base64,")),
                "{plane}"
            );
        }
        assert!(
            light["lit"].as_f64().is_some_and(|lit| lit > 0.1 && lit < 1.0),
            "{}",
            light["lit"]
        );
    }
    // The drawing has a box for every node, members in one.
    let nodes = data["report"]["nodes"]
        .as_array()
        .expect("nodes")
        .iter()
        .map(|node| node["name"].as_str().unwrap());
    let mut boxes: Vec<&str> = nodes.map(|name| name.split('[').next().unwrap()).collect();
    boxes.sort_unstable();
    boxes.dedup();
    assert_eq!(page.matches("class=\"box ").count(), boxes.len());
    assert!(page.contains("class=\"box ran\"") && page.contains("class=\"chip ran\""));
}

/// A browser that can be driven from a command line: the one that `CHROME` names, or one on the
/// path.
fn browser() -> Option<PathBuf> {
    let named = std::env::var_os("CHROME").map(PathBuf::from);
    let paths = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&paths).flat_map(|folder| {
        ["chromium", "chromium-browser", "google-chrome", "chrome"].map(|name| folder.join(name))
    });
    named.or_else(|| found.into_iter().find(|path| path.is_file()))
}

/// The picture that the page shows under this fragment, after `act` on the page, once its state is
/// `mixed`.
fn shown(browser: &Path, place: &Place, fragment: &str, act: &str, mixed: &str) -> image::RgbImage {
    let script = format!(
        r#"<script>(async () => {{
            const root = document.documentElement.dataset;
            const until = async (state) => {{ while (root.mixed !== state) await new Promise((done) => setTimeout(done, 20)); }};
            await until({fragment:?});
            {act}
            await until({mixed:?});
            document.body.append(Object.assign(document.createElement("output"),
                {{ id: "probe", textContent: document.getElementById("picture").toDataURL() }}));
        }})();</script>"#
    );
    place.write("run/probed.html", page(place) + &script);
    let url = format!("file://{}#{fragment}", place.path("run/probed.html").display());
    let output = Command::new(browser)
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--virtual-time-budget=100000",
            "--dump-dom",
        ])
        .arg(format!("--user-data-dir={}", place.path("browser").display()))
        .arg(url)
        .output()
        .expect("the browser starts");
    let dom = String::from_utf8_lossy(&output.stdout);
    let picture = dom
        .split_once(r#"id="probe">data:image/png;base64,"#)
        .and_then(|(_, after)| after.split_once('<'));
    let (picture, _) = picture.unwrap_or_else(|| {
        panic!(
            "{}: no picture at {mixed:?}; it reported:\n{}",
            browser.display(),
            String::from_utf8_lossy(&output.stderr)
        )
    });
    png(&STANDARD.decode(picture).expect("it is base64"))
}

fn its_pictures_are_those_of_the_program(place: &Place) {
    let Some(browser) = browser() else {
        return eprintln!("skipped: no browser was found; CHROME names one");
    };
    let read = |name: &str| png(&std::fs::read(place.path(name)).expect("it was written"));
    // Halves of layers, and an encoding by table: the page may be off by 2.
    let close = |what: &str, page: &image::RgbImage, program: &image::RgbImage| {
        let steps = farthest(page, program);
        assert!(steps <= 2, "{what}: the page is off by {steps} of 255");
    };
    let as_it_is = shown(&browser, place, "", "", "");
    close("as it is", &as_it_is, &read("run/picture.png"));

    // A person moves a slider; a run with this weight; the command with this weight.
    let act = r#"const slider = document.querySelector('[data-light="lamp_0"]'); slider.value = 0.5; slider.dispatchEvent(new Event("input"));"#;
    let moved = shown(&browser, place, "", act, "lamp_0=0.25");
    assert!(farthest(&moved, &as_it_is) > 20, "the slider does something");
    place.check("mix run --set lamp_0=0.25 --out mixed", 0);
    place.write("quarter.ron", r#"Edit(version: 1, lights: { "lamp_0": Scale(0.25) })"#);
    place.check("run GRAPHS/physics.ron quarter.ron --scene DEMO --out fresh", 0);
    let (mixed, fresh) = (read("mixed/picture.png"), read("fresh/picture.png"));
    close("a slider against mix", &moved, &mixed);
    close("a slider against a run", &moved, &fresh);
    assert!(farthest(&mixed, &fresh) <= 1, "mix against a run");

    // A state in the address: brighter, colored, out.
    let state = "inv_lamp=1.5,1,0.5&lamp_0=0&window_0=3";
    place.check("mix run --set inv_lamp=1.5,1,0.5 --set lamp_0=0 --set window_0=3 --out mixed", 0);
    close("a state", &shown(&browser, place, state, "", state), &read("mixed/picture.png"));
}

fn names_in_it_do_no_harm(place: &Place) {
    let report = std::fs::read_to_string(place.path("run/report.json")).expect("it was written");
    let mut report: serde_json::Value = serde_json::from_str(&report).expect("it is JSON");
    let evil = "</script><script>alert('{{data}}')</script>\"<b>&";
    report["edit"] = evil.into();
    report["nodes"][0]["name"] = evil.into();
    report["nodes"][0]["why"] = evil.into();
    report["warnings"] = vec![evil].into();
    place.write("run/report.json", report.to_string());
    place.check("report run", 0);
    let page = page(place);
    assert_eq!(page.matches("</script>").count(), 2, "the data's and the program's");
    assert!(!page.contains("<b>&") && !page.contains("<script>alert"));
    assert_eq!(data(&page)["report"]["edit"], evil, "and yet it is written as it is");
}

fn what_is_no_run_is_told(place: &Place) {
    let check = |line: &str, wanted: &str| {
        let message = place.check(line, 2);
        assert!(message.contains(wanted), "`relight {line}`: wanted {wanted:?}, got:\n{message}");
    };
    check("report nowhere", "nowhere: wanted the folder that `relight run` wrote to");
    check("report run/report.json", "wanted the folder that `relight run` wrote to");
    std::fs::create_dir(place.path("pictures")).expect("a folder can be made");
    std::fs::copy(place.path("run/picture.exr"), place.path("pictures/picture.exr"))
        .expect("it can be copied");
    check("report pictures", "pictures/report.json: cannot be read");
    place.write("run/report.json", r#"{ "edit": 3 }"#);
    check("report run", "run/report.json: wanted the report.json of a run of this version: ");
    check("report run --long-side 0", "--long-side");
    place.write(
        "frames.ron",
        r#"Edit(version: 1, frames: 2, lights: { "lamp_0": Scale(Keys([(0, 1), (1, 0)])) })"#,
    );
    check(
        "run GRAPHS/physics.ron frames.ron --scene DEMO --report",
        "--report: wanted an edit of one picture, got one of frames",
    );
}
