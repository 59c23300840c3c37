//! An edit file: the changes of a picture.
//!
//! `lights`, `materials` and `objects` become the parameters of the same name of the stages
//! `EditLights`, `EditMaterials` and `EditObjects`, whose types determine the allowed values. A
//! light that the edit inserts becomes a member of the set `lights`. A list of changes of one light
//! becomes the value `Changes([..])`.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use super::{EditFile, INVISIBLE, check_light_name, fields};
use crate::graph::{
    Anchor, Diagnostic, Diagnostics, Key, Member, Origin, Overlay, Raw, Setting, Source, Target,
};

const FIELDS: [&str; 5] = ["version", "lights", "materials", "objects", "frames"];
/// An entry that begins so makes a light; any other changes one that is there.
const MAKERS: [&str; 2] = ["Lamp", "Window"];
/// The variant that has a list of changes as its value.
const CHANGES: &str = "Changes";
/// The change that no window takes.
const ON: &str = "On";

/// Reads an edit of the scene that `scene` describes, for a graph that has the stages `kinds`; a
/// `None` could not be read, and nothing is checked against it. The result for a sequence is its
/// first frame.
///
/// # Errors
/// Every fault of the file that can be known without running anything.
pub fn read(
    path: &Path,
    scene: Option<&Overlay>,
    kinds: Option<&[&str]>,
) -> Result<Overlay, Vec<Diagnostic>> {
    frame(&EditFile::read(path)?, 0, scene, kinds)
}

/// Reads one frame of an edit, like [`read`].
///
/// # Errors
/// The errors of [`read`].
pub fn frame(
    edit: &EditFile,
    frame: u32,
    scene: Option<&Overlay>,
    kinds: Option<&[&str]>,
) -> Result<Overlay, Vec<Diagnostic>> {
    let (overlay, faults) = frame_and_faults(edit, frame, scene, kinds);
    if faults.is_empty() { Ok(overlay) } else { Err(faults) }
}

/// Reads one frame of an edit, and every fault that can be known without the graph: the entries can
/// then be checked beside them. It is empty where fields, numbers or keyframes have faults.
pub fn frame_and_faults(
    edit: &EditFile,
    frame: u32,
    scene: Option<&Overlay>,
    kinds: Option<&[&str]>,
) -> (Overlay, Vec<Diagnostic>) {
    let mut faults = edit.faults.clone();
    let mut overlay = Overlay::default();
    let fields = fields(&edit.at(frame), "Edit", &FIELDS, &mut faults);
    let is_whole = faults.is_empty();
    for (key, mut value) in fields {
        let (stage, is_empty) = match key.name.as_str() {
            "lights" => {
                let entries = value.as_map(&mut faults);
                overlay.members.extend(inserted(&entries, scene, &mut faults));
                check_switches(&entries, scene, &mut faults);
                value = with_changes(&value, &entries);
                ("EditLights", entries.is_empty())
            }
            "materials" => ("EditMaterials", value.as_list(&mut faults).is_empty()),
            "objects" => ("EditObjects", value.as_list(&mut faults).is_empty()),
            _ => continue, // `frames`: the file has been read by it
        };
        if is_empty {
            continue;
        }
        if kinds.is_some_and(|kinds| !kinds.contains(&stage)) {
            let message =
                format!("this graph has no {stage} stage, so it cannot change {}", key.name);
            faults.push(|| Diagnostic::at(&key.origin, message));
        }
        overlay.settings.push(Setting {
            target: Target::Kind(stage.to_owned()),
            field: key.name,
            value,
        });
    }
    if !is_whole {
        overlay = Overlay::default();
    }
    (overlay, faults.into_vec())
}

/// The lights that are there before the edit.
fn of_scene(scene: Option<&Overlay>) -> impl Iterator<Item = &str> {
    let visible = scene.into_iter().flat_map(|scene| &scene.members).filter(|m| m.set == "lights");
    visible.map(|m| m.name.as_str()).chain(INVISIBLE)
}

/// The lights that an edit makes; a change of a light that does not exist is a fault.
fn inserted(
    entries: &[(Key, Raw)],
    scene: Option<&Overlay>,
    faults: &mut Diagnostics,
) -> Vec<Member> {
    let makes = |value: &Raw| value.variant().is_some_and(|variant| MAKERS.contains(&variant));
    let present: BTreeSet<&str> = of_scene(scene).collect();
    let made = entries.iter().filter(|(_, value)| makes(value)).map(|(key, _)| key.name.as_str());
    let known: Vec<&str> = of_scene(scene).chain(made).collect();
    let mut members = Vec::new();
    for (key, value) in entries.iter().filter(|(key, _)| !present.contains(key.name.as_str())) {
        if makes(value) {
            if check_light_name(key, faults) {
                let (name, origin) = (key.name.clone(), key.origin.clone());
                members.push(Member { set: "lights".to_owned(), name, origin });
            }
        } else if scene.is_some() {
            faults.push(|| {
                let fault = Diagnostic::at(&key.origin, format!("unknown light `{}`", key.name));
                fault.suggest(&key.name, known.iter().copied())
            });
        }
    }
    members
}

/// A window that is switched on is a fault, since only a lamp can be.
fn check_switches(entries: &[(Key, Raw)], scene: Option<&Overlay>, faults: &mut Diagnostics) {
    let switches = entries.iter().filter_map(|(key, value)| {
        let on = |change: &Raw| change.variant() == Some(ON);
        let of_list = || value.as_list(&mut Diagnostics::ignored()).into_iter().find(on);
        let switch = if is_list(value) { of_list() } else { Some(value.clone()).filter(on) };
        switch.map(|switch| (key, switch))
    });
    let switches: Vec<(&Key, Raw)> = switches.collect();
    if switches.is_empty() {
        return;
    }
    let lights = scene.into_iter().flat_map(|scene| &scene.settings).find(|s| s.field == "lights");
    let lights =
        lights.map(|lights| lights.value.as_map(&mut Diagnostics::ignored())).unwrap_or_default();
    let windows = lights.iter().filter(|(_, light)| light.variant() == Some("Window"));
    let windows: BTreeSet<&str> =
        windows.map(|(key, _)| key.name.as_str()).chain(["inv_window"]).collect();
    for (key, switch) in switches.iter().filter(|(key, _)| windows.contains(key.name.as_str())) {
        faults.push(|| {
            let message = format!("wanted a lamp for `{ON}`, got the window `{}`", key.name);
            Diagnostic::at(&switch.variant_origin(), message)
                .help("brighten it with `Scale(..)`, or put a `Window(..)` in its place")
        });
    }
}

/// The changes of a light's radiance alone: its layer under them is a multiple of its layer without
/// them.
const RADIANCE: [&str; 4] = ["Off", "Scale", "Color", "Temperature"];

/// The edit without changes of radiance (`Off`, `Scale`, `Color`, `Temperature`), each replaced by
/// spaces, so that all else keeps its line. A text that cannot be split stays as it is.
pub fn without_radiance(source: &Arc<Source>) -> Arc<Source> {
    let ignored = &mut Diagnostics::ignored();
    let Some(document) = Raw::document(source, ignored) else { return source.clone() };
    let is_radiance =
        |value: &Raw| value.variant().is_some_and(|variant| RADIANCE.contains(&variant));
    let mut gone: Vec<Range<usize>> = Vec::new();
    for (key, value) in light_entries(&document) {
        let changes = changes(&value);
        if is_radiance(&value) || (!changes.is_empty() && changes.iter().all(is_radiance)) {
            gone.push(key.origin.span.start..value.origin.span.end);
        } else {
            gone.extend(changes.iter().filter(|c| is_radiance(c)).map(|c| c.origin.span.clone()));
        }
    }
    // The comma after each goes with it.
    let words = document.words();
    for span in &mut gone {
        let next = words.partition_point(|(word, _)| word.origin.span.start < span.end);
        if let Some((comma, _)) = words.get(next).filter(|(word, _)| word.text() == ",") {
            span.end = comma.origin.span.end;
        }
    }
    let mut text = String::with_capacity(source.text.len());
    let mut from = 0;
    for span in gone {
        text.push_str(&source.text[from..span.start]);
        text.extend(source.text[span.clone()].chars().map(|c| if c == '\n' { c } else { ' ' }));
        from = span.end;
    }
    text.push_str(&source.text[from..]);
    Source::within(source.path.clone(), text, source.reach)
}

/// Whether an edit has neither materials nor objects.
pub fn changes_lights_alone(source: &Arc<Source>) -> bool {
    let ignored = &mut Diagnostics::ignored();
    let Some(document) = Raw::document(source, ignored) else { return false };
    let others = document.as_struct(None, &["materials", "objects"], ignored);
    others.iter().all(|(_, value)| value.as_list(&mut Diagnostics::ignored()).is_empty())
}

/// The entry of each light, as the text of an edit has it.
pub fn entries(source: &Arc<Source>) -> Vec<(String, String)> {
    let document = Raw::document(source, &mut Diagnostics::ignored());
    let entries = document.iter().flat_map(light_entries);
    entries.map(|(key, value)| (key.name, value.text().to_owned())).collect()
}

fn light_entries(document: &Raw) -> Vec<(Key, Raw)> {
    let ignored = &mut Diagnostics::ignored();
    let fields = document.as_struct(None, &["lights"], ignored);
    fields.first().map(|(_, lights)| lights.as_map(ignored)).unwrap_or_default()
}

/// The changes in a list `[..]` or `Changes([..])`; none for any other value.
fn changes(value: &Raw) -> Vec<Raw> {
    let ignored = &mut Diagnostics::ignored();
    match value.variant() {
        Some(CHANGES) => value.as_tuple(ignored).first().map(changes).unwrap_or_default(),
        _ if is_list(value) => value.as_list(ignored),
        _ => Vec::new(),
    }
}

fn is_list(value: &Raw) -> bool {
    value.text().starts_with('[')
}

/// The map `lights` of these entries with each list `[a, b]` written as `Changes([a, b])`, in a
/// text whose anchors give each piece its place in the file.
fn with_changes(lights: &Raw, entries: &[(Key, Raw)]) -> Raw {
    let lists: Vec<_> =
        entries.iter().filter(|(_, value)| is_list(value)).map(|(_, value)| value).collect();
    if lists.is_empty() {
        return lights.clone();
    }
    let source = &lights.origin.source;
    let mut text = String::with_capacity(source.text.len() + lists.len() * (CHANGES.len() + 2));
    let mut anchors = Vec::new();
    let mut known = source.anchors.iter().copied().peekable();
    let mut last = Anchor { at: 0, line: 1, column: 1 };
    let mut copied = 0;
    // Copies up to byte `end`, and returns the anchor of that byte.
    let mut copy = |end: usize, text: &mut String, anchors: &mut Vec<Anchor>| {
        while let Some(anchor) = known.next_if(|anchor| anchor.at <= end) {
            anchors.push(Anchor { at: text.len() + anchor.at - copied, ..anchor });
            last = anchor;
        }
        text.push_str(&source.text[copied..end]);
        copied = end;
        last = last.moved(&source.text, end);
        last
    };
    for list in &lists {
        let open = copy(list.origin.span.start, &mut text, &mut anchors);
        anchors.push(Anchor { at: text.len(), ..open });
        text.push_str(CHANGES);
        text.push('(');
        anchors.push(Anchor { at: text.len(), ..open });
        let close = copy(list.origin.span.end, &mut text, &mut anchors);
        text.push(')');
        anchors.push(Anchor { at: text.len(), ..close });
    }
    copy(source.text.len(), &mut text, &mut anchors);
    let grown = text.len() - source.text.len();
    let span = lights.origin.span.start..lights.origin.span.end + grown;
    let source = Source { path: source.path.clone(), text, reach: source.reach, anchors };
    Raw { origin: Origin { source: Arc::new(source), span } }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::Source;

    const KINDS: [&str; 2] = ["ReadScene", "EditLights"];

    fn edit(text: &str) -> Result<Overlay, Vec<Diagnostic>> {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let path = folder.path().join("edit.ron");
        std::fs::write(&path, text).expect("it can be written to");
        let origin = crate::graph::Origin { source: Source::new("scene.ron", ""), span: 0..0 };
        let lamp = Member { set: "lights".into(), name: "lamp_0".into(), origin };
        let scene = Overlay { members: vec![lamp], ..Overlay::default() };
        read(&path, Some(&scene), Some(&KINDS))
    }

    fn check_faults(text: &str, wanted: &[&str]) {
        let faults = edit(text).err().unwrap_or_default();
        let got: Vec<String> = faults
            .iter()
            .map(|f| {
                let (line, column) =
                    f.origin.as_ref().expect("every fault of a text has a place").line_column();
                format!(
                    "{line}:{column}: {}{}",
                    f.message,
                    f.help.iter().map(|h| format!(" ({h})")).collect::<String>()
                )
            })
            .collect();
        assert_eq!(got, wanted, "{text}");
    }

    #[test]
    fn the_identity_sets_nothing() {
        for text in ["Edit(version: 1)", "Edit(version: 1, lights: {}, materials: [], objects: [])"]
        {
            let overlay = edit(text).expect("it is sound");
            assert!(overlay.settings.is_empty() && overlay.members.is_empty(), "{text}");
        }
    }

    #[test]
    fn new_lamps_and_windows_become_members() {
        let text = r#"Edit(version: 1, lights: {
            "west": Window(corners: []), "lamp_0": Off, "inv_lamp": Lamp(), "desk": Lamp(), "inv_window": Scale(2) })"#;
        let overlay = edit(text).expect("it is sound");
        let members: Vec<_> =
            overlay.members.iter().map(|m| (m.set.as_str(), m.name.as_str())).collect();
        assert_eq!(members, [("lights", "west"), ("lights", "desk")]);
        assert_eq!(overlay.settings.len(), 1);
        assert_eq!(overlay.settings[0].target, Target::Kind("EditLights".into()));
    }

    #[test]
    fn a_list_of_changes_keeps_the_places_of_the_file() {
        let text = "Edit(version: 1, frames: 3, lights: {\n \"lamp_0\": [Scale(Keys([(0, 1), (2, 2)])), // ü [\n Off], \"inv_lamp\": [Off], \"x\": Lamp() }, materials: [])";
        let file = {
            let folder = tempfile::tempdir().expect("a temporary folder can be made");
            let path = folder.path().join("edit.ron");
            std::fs::write(&path, text).expect("it can be written to");
            EditFile::read(&path).unwrap_or_else(|faults| panic!("{}", faults[0]))
        };
        let overlay = frame(&file, 1, None, None).unwrap_or_else(|faults| panic!("{}", faults[0]));
        let value = &overlay.settings[0].value;
        let words: String = value.words().iter().map(|(word, _)| word.text().to_owned()).collect();
        assert_eq!(
            words,
            r#"{"lamp_0":Changes([Scale(1.5),Off]),"inv_lamp":Changes([Off]),"x":Lamp()}"#
        );
        // Each word where the file has it; a value of keyframes stands at their start.
        for (word, _) in value.words() {
            let place = word.origin.line_column();
            let wanted = match word.text() {
                "{" => (1, 37),
                "\"lamp_0\"" => (2, 2),
                "Scale" => (2, 13),
                "1.5" => (2, 19),
                "\"inv_lamp\"" => (3, 8),
                "\"x\"" => (3, 27),
                "Lamp" => (3, 32),
                "}" => (3, 39),
                _ => continue,
            };
            assert_eq!(place, wanted, "{}", word.text());
        }
        assert_eq!(
            value.words().last().map(|(word, _)| word.text().to_owned()).as_deref(),
            Some("}")
        );
    }

    #[test]
    fn a_window_is_not_switched_on() {
        let help = "(brighten it with `Scale(..)`, or put a `Window(..)` in its place)";
        check_faults(
            r#"Edit(version: 1, lights: { "lamp_0": On(), "inv_window": [Scale(2), On(flux: 1)] })"#,
            &[&format!("1:69: wanted a lamp for `On`, got the window `inv_window` {help}")],
        );
    }

    #[test]
    fn objects_and_materials_are_left_to_their_stages() {
        let kinds = ["EditMaterials", "EditObjects"];
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let path = folder.path().join("edit.ron");
        let text = r#"Edit(version: 1, // roughness: 0.1
            objects: [Mesh(path: "materials/chair.obj", at: Pixel(x: 1, y: 1), height: 1)],
            materials: [Paint(region: Mask("roughness: 1"), roughness: 0.2)])"#;
        std::fs::write(&path, text).expect("it can be written to");
        let overlay =
            read(&path, None, Some(&kinds)).unwrap_or_else(|faults| panic!("{}", faults[0]));
        assert!(overlay.members.is_empty());
        assert_eq!(
            overlay.settings.iter().map(|s| s.field.as_str()).collect::<Vec<_>>(),
            ["objects", "materials"]
        );
    }

    #[test]
    fn what_is_not_there_is_told_with_the_nearest_name() {
        check_faults(
            r#"Edit(version: 1, lights: { "lamp_1": Off, "inv_lmap": Off, "rest": Lamp(), "my lamp": Lamp() })"#,
            &[
                "1:28: unknown light `lamp_1` (did you mean `lamp_0`?)",
                "1:43: unknown light `inv_lmap` (did you mean `inv_lamp`?)",
                "1:60: the name `rest` is reserved: it is the light that no light source explains",
                "1:76: wanted a light name that matches [A-Za-z][A-Za-z0-9_]*, got \"my lamp\"",
            ],
        );
        check_faults(
            "Edit(version: 1, ligths: {})",
            &["1:18: unknown field `ligths` (did you mean `lights`?)"],
        );
    }

    /// Work that grows as the square of the names takes minutes here.
    #[test]
    fn two_hundred_thousand_unknown_lights_are_counted() {
        let all = |value: &str| {
            (0..200_000).map(|i| format!("\"nobody_{i}\": {value},\n")).collect::<String>()
        };
        let off = format!("Edit(version: 1, lights: {{ {} }})", all("Off"));
        let faults = edit(&off).err().expect("there are no such lights");
        assert_eq!(faults[0].message, "unknown light `nobody_0`");
        assert_eq!(faults[0].help.as_deref(), Some("known: lamp_0, inv_lamp, inv_window"));
        assert_eq!(faults.len(), 51);
        assert_eq!(faults[50].message, "and up to 199950 more errors");
        // Nor does it take work as the product of the lengths of two names.
        let (long, other) = ("a".repeat(2_000_000), "b".repeat(2_000_000));
        let faults =
            edit(&format!("Edit(version: 1, lights: {{ \"{long}\": Lamp(), \"{other}\": Off }})"));
        assert_eq!(faults.err().expect("there is no such light").len(), 1);
        let lamps = edit(&format!("Edit(version: 1, lights: {{ {} }})", all("Lamp()")))
            .expect("they may be made");
        assert_eq!(lamps.members.len(), 200_000);
    }

    #[test]
    fn faults_of_keys_stand_beside_all_others() {
        check_faults(
            r#"Edit(version: 1, frames: 4, objects: [Sphere()], lights: { "lamp_0": Scale(Keys([(4, 1)])), "lamp": Off })"#,
            &[
                "1:83: wanted a frame up to 3, the last of 4, got 4",
                "1:29: this graph has no EditObjects stage, so it cannot change objects",
                "1:93: unknown light `lamp` (did you mean `lamp_0`?)",
            ],
        );
    }

    #[test]
    fn each_frame_is_an_edit() {
        let text =
            r#"Edit(version: 1, frames: 3, lights: { "lamp_0": Scale(Keys([(0, 1), (2, 0)])) })"#;
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let path = folder.path().join("edit.ron");
        std::fs::write(&path, text).expect("it can be written to");
        let file = EditFile::read(&path).unwrap_or_else(|faults| panic!("{}", faults[0]));
        assert_eq!(file.frames(), Some(3));
        for (number, wanted) in [(0, "Scale(1)"), (1, "Scale(0.5)"), (2, "Scale(0)")] {
            let overlay =
                frame(&file, number, None, None).unwrap_or_else(|faults| panic!("{}", faults[0]));
            let words: String = overlay.settings[0].value.text().split_whitespace().collect();
            assert_eq!(words, format!(r#"{{"lamp_0":{wanted}}}"#));
        }
    }

    #[test]
    fn changes_of_radiance_leave_the_edit_and_all_else_keeps_its_line() {
        for (text, wanted) in [
            (r#"{ "lamp_0": Off, "inv_lamp": Scale(2), }"#, r#"{ }"#),
            (r#"{ "lamp_0": Off }"#, r#"{ }"#),
            (
                r#"{ "a": [Scale(2), Move(by: (1, 0, 0))], "b": [On(), Scale(2)] }"#,
                r#"{ "a": [ Move(by: (1, 0, 0))], "b": [On(), ] }"#,
            ),
            (
                r#"{ "a": Changes([Scale(2), Off]), "b": Changes([Off, On()]) }"#,
                r#"{ "b": Changes([ On()]) }"#,
            ),
            (
                r#"{ "desk": Lamp(shape: Sphere(radius: 1)), "lamp_0": /* ü */ Color(1, 1, 1) /* why */ , }"#,
                r#"{ "desk": Lamp(shape: Sphere(radius: 1)), }"#,
            ),
            (
                r#"{ "lamp_0": Temperature(2700) // warm,
                , "window_0": On() }"#,
                r#"{ "window_0": On() }"#,
            ),
        ] {
            let text = format!("Edit(version: 1, // Off\n lights: {text},\n materials: [])");
            let source = Source::new("edit.ron", text.clone());
            let base = without_radiance(&source);
            let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
            let wanted =
                words(&format!("Edit(version: 1, // Off\n lights: {wanted},\n materials: [])"));
            assert_eq!(words(&base.text), wanted);
            assert_eq!(base.text.lines().count(), text.lines().count());
            EditFile::parse(base).unwrap_or_else(|faults| panic!("{wanted}: {}", faults[0]));
        }
        for (rest, wanted) in
            [("", true), ("objects: [], materials: []", true), ("objects: [Sphere()]", false)]
        {
            let text = format!("Edit(version: 1, lights: {{}}, {rest})");
            assert_eq!(changes_lights_alone(&Source::new("edit.ron", text)), wanted, "{rest}");
        }
        let broken = Source::new("edit.ron", "Edit(version: 1, lights: { \"lamp_0\": Off ");
        assert_eq!(without_radiance(&broken).text, broken.text);
        let source =
            Source::new("edit.ron", r#"Edit(version: 1, lights: { "a": [Off], "b": On() })"#);
        let wanted = [("a", "[Off]"), ("b", "On()")].map(|(a, b)| (a.to_owned(), b.to_owned()));
        assert_eq!(entries(&source), wanted);
    }

    #[test]
    fn a_version_is_needed() {
        check_faults("Edit()", &["1:1: this Edit has no version (write `version: 1,` first)"]);
        check_faults("Edit(version: 2)", &["1:15: wanted version 1, got 2"]);
    }
}
