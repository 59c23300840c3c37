//! The record of its making inside each picture of a run, and what `explain` reads from it.

use crate::project::*;

/// The demo small, and nothing but what decides its picture.
const RUN: &str = "run DEMO.ron edit.ron --set scene.long_side=48 --no-cache";
const OFF: &str = "Edit(version: 1, lights: { \"lamp_0\": Off }) // evening\n";

fn explained(place: &Place, line: &str) -> String {
    let output = place.command(line).output().expect("the program starts");
    check_output(line, &output, 0);
    String::from_utf8(output.stdout).expect("it is text")
}

#[test]
fn a_picture_tells_how_it_was_made_and_whether_these_inputs_make_it_again() {
    let place = Place::new();
    place.write("edit.ron", OFF);
    place.check(&format!("{RUN} --out one"), 0);
    // The same inputs give the same bytes, whatever the folder is called.
    place.check(&format!("{RUN} --out two --threads 1"), 0);
    assert_eq!(place.pictures("one"), place.pictures("two"));
    for picture in ["one/picture.png", "one/picture.exr"] {
        let text = explained(&place, &format!("explain {picture}"));
        for wanted in
            ["output `write.files` of the graph `small`", "// evening", "masks/lamp_0.png"]
        {
            assert!(text.contains(wanted), "{text}");
        }
        assert!(!text.contains(env!("CARGO_MANIFEST_DIR")), "no path of this machine: {text}");
        let again =
            |more: &str| explained(&place, &format!("explain {picture} DEMO.ron edit.ron {more}"));
        assert!(again("--set scene.long_side=48").contains("these inputs make this picture again"));
        let other = again("--set scene.long_side=47");
        assert!(other.contains("make another picture\n    a stage, a parameter"), "{other}");
    }
    place.write("edit.ron", OFF.replace("Off", "Scale(0.5)"));
    let line = "explain one/picture.png DEMO.ron edit.ron --set scene.long_side=48";
    let text = explained(&place, line);
    assert!(text.contains("make another picture\n    the text of the edit differs\n"), "{text}");
    // Another comment makes the same picture.
    place.write("edit.ron", OFF.replace("evening", "night"));
    let text = explained(&place, line);
    assert!(text.contains("make this picture again\n    the text of the edit differs\n"), "{text}");

    place.check("mix one --set window_0=0.5 --out mixed", 0);
    place.check("mix mixed --set window_0=0.5 --out again.png", 0);
    for (picture, weight) in [("mixed/picture.exr", "0.5"), ("again.png", "0.25")] {
        let text = explained(&place, &format!("explain {picture}"));
        let wanted = format!("mixed after the run: window_0 x {weight}, {weight}, {weight}\n");
        assert!(text.contains(&wanted), "{text}");
    }
}

#[test]
fn a_frame_tells_its_number_and_other_pictures_tell_nothing() {
    let place = Place::new();
    let edit = "Edit(version: 1, frames: 3, lights: { \"lamp_0\": Scale(Keys([(0, 1), (2, 0)])) })";
    place.write("edit.ron", edit);
    place.check(&format!("{RUN} --out film --frame 1"), 0);
    let line = "explain film/picture_0001.png DEMO.ron edit.ron --set scene.long_side=48";
    let text = explained(&place, line);
    assert!(text.contains(", frame 1\n") && text.contains("make this picture again"), "{text}");

    place.write("other.png", b"\x89PNG\r\n\x1a\nand no more".as_slice());
    for (line, wanted) in [
        ("explain other.png", "wanted a PNG or EXR picture with the record of its making"),
        ("explain nowhere.exr", "nowhere.exr"),
        ("explain DEMO.ron edit.ron", "wanted GRAPH EDIT NODE, or a PNG or EXR picture"),
    ] {
        let message = place.check(line, 2);
        assert!(message.contains(wanted), "{line}: {message}");
    }
}
