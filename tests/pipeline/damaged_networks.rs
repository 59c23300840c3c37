//! Regression corpus of the shipped networks with damage: missing, cut, of another version, mixed
//! up. Messages are compared word for word.

use crate::project::*;

const LINE: &str = "run GRAPHS/indoor.ron EDITS/none.ron --scene DEMO --no-cache --out out --only mnet --models models";

/// A folder `models` with the network as it ships.
fn place() -> Place {
    let place = Place::new();
    std::fs::create_dir(place.path("models")).expect("a folder can be made");
    for entry in std::fs::read_dir(root().join("models")).expect("the project has models") {
        let path = entry.expect("it can be listed").path();
        let name = path.file_name().expect("it is a file");
        std::fs::copy(&path, place.path("models").join(name)).expect("it can be copied");
    }
    place
}

fn shipped(name: &str) -> Vec<u8> {
    std::fs::read(root().join("models").join(name)).expect("the project has it")
}

/// Exit status 2, and every line of `wanted`.
fn check(place: &Place, line: &str, wanted: &[&str]) {
    let message = place.check(line, 2);
    for part in wanted {
        assert!(message.contains(part), "`{line}`: wanted {part:?}, got:\n{message}");
    }
}

#[test]
fn networks_as_they_ship_are_used() {
    place().check(LINE, 0);
}

#[test]
fn a_missing_network_is_named_before_any_work() {
    let place = place();
    std::fs::remove_file(place.path("models/mnet.onnx")).expect("it is there");
    check(
        &place,
        LINE,
        &[
            "node `mnet` (MNet): models/mnet.onnx cannot be read: No such file or directory",
            "the networks ship in the folder models/: keep it beside the program, or name it with --models DIR",
        ],
    );
    assert!(!place.path("out").exists());
    check(
        &place,
        &LINE.replace("--models models", "--models nowhere"),
        &["nowhere/mnet.onnx cannot be read", "--models DIR"],
    );
    // A path of one's own is not looked for in --models, and its fault stands where it was written.
    check(
        &place,
        &format!(r#"{LINE} --set mnet.model="mine.onnx""#),
        &["mine.onnx cannot be read", "--set mnet.model:1:1"],
    );
}

#[test]
fn a_damaged_network_is_no_network() {
    let place = place();
    let sound = shipped("mnet.onnx");
    let mut flipped = sound.clone();
    flipped[sound.len() / 2] ^= 1;
    for (name, bytes) in [
        ("cut", sound[..sound.len() / 2].to_vec()),
        ("one bit", flipped),
        ("empty", Vec::new()),
        ("a page", b"<html>404 Not Found</html>".to_vec()),
        ("another network", shipped("vislampnet.onnx")),
    ] {
        place.write("models/mnet.onnx", bytes);
        let message = place.check(LINE, 2);
        let wanted = [
            "error: mnet: models/mnet.onnx: it is damaged, or of another version of relight: wanted SHA-256 ",
            "; take models/mnet.onnx of this version, or give a network of your own another name",
        ];
        assert!(wanted.iter().all(|part| message.contains(part)), "{name}: {message}");
    }
}

#[test]
fn a_network_under_a_name_of_ones_own_must_fit() {
    let place = place();
    let line = format!(r#"{LINE} --set mnet.model="own.onnx""#);
    // The same network under another name is sound.
    place.write("own.onnx", shipped("mnet.onnx"));
    place.check(&line, 0);
    for (bytes, wanted) in [
        (
            shipped("vislampnet.onnx"),
            "error: mnet: own.onnx: input `photo`: wanted [1, 3, 240, 320], got [1, 3, 120, 160]",
        ),
        (shipped("indirectnet.onnx"), "error: mnet: own.onnx: wanted an input `photo`, got "),
        (
            shipped("mnet.onnx")[..100_000].to_vec(),
            "error: mnet: own.onnx: wanted a network in ONNX that",
        ),
        (b"a text".to_vec(), "error: mnet: own.onnx: wanted a network in ONNX that"),
    ] {
        place.write("own.onnx", bytes);
        check(&place, &line, &[wanted]);
    }
}

#[test]
fn a_backend_that_is_not_there_is_told() {
    let place = place();
    place.write("no.so", "this is no library");
    check(
        &place,
        &format!("{LINE} --onnxruntime no.so"),
        &[
            "no.so: wanted a library of ONNX Runtime 1.17 or later (--onnxruntime): ",
            "--backend rten needs no library",
        ],
    );
    place.check(&format!("{LINE} --backend rten --onnxruntime no.so"), 0);
}
