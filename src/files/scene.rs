//! `scene.ron`: the photograph, its depth, its camera, and its visible lights.
//!
//! The fields become parameters of the same name of the graph's `ReadScene` stages, whose types
//! determine the allowed values; those of the photo alone also of its `ReadPhoto` stages. The names
//! of the lights, in the order of the file, become members of sets: `visible`, the lights seen in
//! the photo, and of these `visible_lamps` and `visible_windows`; `estimated`, the lights whose
//! place and strength are estimated (the graph adds the invisible ones); and `lights`, all that
//! emit in the result (an edit adds the lights that it inserts). Lights and materials that `truth`
//! names go to the stages `ReadLights` and `ReadMaterials`, facts about the `room` to `RoomBox`;
//! [`truth`] returns the other fields, which are for measurements.

use std::path::Path;
use std::sync::Arc;

use super::{INVISIBLE, check_light_name, fields};
use crate::graph::{
    Diagnostic, Diagnostics, Key, Member, Overlay, Raw, Reach, Setting, Source, Target,
};

/// The stages that take a scene: all of it, or its photo alone.
pub const STAGES: [&str; 2] = [SCENE, PHOTO];
const SCENE: &str = "ReadScene";
const PHOTO: &str = "ReadPhoto";
const FIELDS: [&str; 11] = [
    "version", "photo", "transfer", "camera", "depth", "lights", "ignore", "sunlight", "exposure",
    "room", "truth",
];
const OF_PHOTO: [&str; 4] = ["photo", "transfer", "camera", "exposure"];
/// The stage that takes the facts about the room.
const ROOM: &str = "RoomBox";
const NEEDED: [&str; 2] = ["photo", "camera"];
/// Field of `truth` -> the stage that reads it, and its parameter there.
const TRUTH: [(&str, &str, &str); 4] = [
    ("lights", "ReadLights", "path"),
    ("albedo", "ReadMaterials", "albedo"),
    ("normal", "ReadMaterials", "normal"),
    ("roughness", "ReadMaterials", "roughness"),
];
/// Fields of `truth` that no stage of a graph takes by itself: one file, or a map to files.
const MEASURED: [(&str, bool); 5] =
    [("depth", false), ("lighting", false), ("pictures", true), ("direct", true), ("edits", true)];
/// The sets that every light of a scene belongs to.
const SETS: [&str; 3] = ["visible", "estimated", "lights"];

/// And the set of those that are of one kind.
const OF_KIND: [(&str, &str); 2] = [("Lamp", "visible_lamps"), ("Window", "visible_windows")];

/// Reads `folder/scene.ron` for a graph with stages of these `kinds`: one that takes the photo
/// alone needs no depth. Without `kinds`, the needs of the stages stay unchecked.
///
/// # Errors
/// Every fault of the file that can be known without looking at the files it names.
pub fn read(folder: &Path, kinds: Option<&[&str]>) -> Result<Overlay, Vec<Diagnostic>> {
    read_within(folder, kinds, Reach::Anywhere)
}

/// Reads a scene that may name files within `reach` only.
///
/// # Errors
/// The errors of [`read`].
pub fn read_within(
    folder: &Path,
    kinds: Option<&[&str]>,
    reach: Reach,
) -> Result<Overlay, Vec<Diagnostic>> {
    let path = folder.join("scene.ron");
    if folder.is_file() {
        let help = "name the folder, not the file in it";
        return Err(vec![Diagnostic::file(folder, "wanted a scene folder, got a file").help(help)]);
    }
    let source = Source::read(&path, reach).map_err(|fault| {
        let help = "`relight new PHOTO --out DIR` makes the folder of a scene";
        vec![if path.exists() { fault } else { fault.help(help) }]
    })?;
    parse(&source, kinds)
}

/// Reads the text of a `scene.ron`, whose path need not exist.
///
/// # Errors
/// The errors of [`read`].
pub fn parse(source: &Arc<Source>, kinds: Option<&[&str]>) -> Result<Overlay, Vec<Diagnostic>> {
    let path = &source.path;
    let mut faults = Diagnostics::default();
    let fields = fields(source, "Scene", &FIELDS, &mut faults);
    if faults.is_empty() {
        for field in NEEDED {
            if fields.iter().all(|(key, _)| key.name != field) {
                faults.push(|| Diagnostic::file(path, format!("this scene has no `{field}`")));
            }
        }
        if kinds.is_some_and(|kinds| kinds.contains(&SCENE))
            && fields.iter().all(|(key, _)| key.name != "depth")
        {
            let help = "a network of yours can estimate it: graphs/depth.ron, docs/networks.md";
            faults.push(|| Diagnostic::file(path, "this scene has no `depth`").help(help));
        }
    }
    let mut overlay = Overlay::default();
    for (key, value) in fields {
        if key.name == "lights" {
            for (light, spec) in value.as_map(&mut faults) {
                if INVISIBLE.contains(&light.name.as_str()) {
                    let message =
                        format!("the name `{}` is reserved for an invisible light", light.name);
                    faults.push(|| Diagnostic::at(&light.origin, message));
                } else {
                    check_light_name(&light, &mut faults);
                }
                let of_kind =
                    spec.variant().and_then(|kind| OF_KIND.iter().find(|(name, _)| *name == kind));
                for set in SETS.into_iter().chain(of_kind.map(|(_, set)| *set)) {
                    let (name, origin) = (light.name.clone(), light.origin.clone());
                    overlay.members.push(Member { set: set.to_owned(), name, origin });
                }
            }
        }
        if key.name == "truth" {
            overlay.settings.extend(settings(&value, &mut faults));
            continue;
        }
        if key.name == "room" {
            let target = Target::Kind(ROOM.to_owned());
            overlay.settings.push(Setting { target, field: key.name, value });
            continue;
        }
        let stages = STAGES
            .into_iter()
            .filter(|stage| *stage == SCENE || OF_PHOTO.contains(&key.name.as_str()));
        overlay.settings.extend(stages.map(|stage| Setting {
            target: Target::Kind(stage.to_owned()),
            field: key.name.clone(),
            value: value.clone(),
        }));
    }
    if faults.is_empty() { Ok(overlay) } else { Err(faults.into_vec()) }
}

/// The fields of `truth` in `folder/scene.ron`; none if it does not contain `truth`.
///
/// # Errors
/// The errors of [`read`].
pub fn truth(folder: &Path) -> Result<Vec<(Key, Raw)>, Vec<Diagnostic>> {
    read(folder, None)?;
    let source =
        Source::read(&folder.join("scene.ron"), Reach::Anywhere).map_err(|fault| vec![fault])?;
    let mut faults = Diagnostics::default();
    let truth = fields(&source, "Scene", &FIELDS, &mut faults)
        .into_iter()
        .find(|(key, _)| key.name == "truth");
    Ok(truth.map(|(_, value)| known(&value, &mut faults)).unwrap_or_default())
}

/// The fields of `truth: (lights: "lights.json", ..)`.
fn known(value: &Raw, faults: &mut Diagnostics) -> Vec<(Key, Raw)> {
    let names: Vec<&str> = TRUTH
        .map(|(field, ..)| field)
        .into_iter()
        .chain(MEASURED.map(|(field, _)| field))
        .collect();
    value.as_struct(None, &names, faults)
}

/// The settings of `truth` for stages; graphs without these stages ignore them.
fn settings(value: &Raw, faults: &mut Diagnostics) -> Vec<Setting> {
    let mut settings = Vec::new();
    for (key, value) in known(value, faults) {
        if let Some((_, stage, field)) = TRUTH.into_iter().find(|(field, ..)| *field == key.name) {
            settings.push(Setting {
                target: Target::Kind(stage.to_owned()),
                field: field.to_owned(),
                value,
            });
            continue;
        }
        let many = MEASURED.contains(&(key.name.as_str(), true));
        let files = if many {
            value.as_map(faults).into_iter().map(|(_, file)| file).collect()
        } else {
            vec![value]
        };
        for file in files.iter().filter(|file| file.string().is_none()) {
            let message = || {
                format!(
                    "`{}` wanted the name of a file in quotes, got `{}`",
                    key.name,
                    file.short()
                )
            };
            faults.push(|| file.fault(message()));
        }
    }
    settings
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(text: &str) -> Result<Overlay, Vec<Diagnostic>> {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        std::fs::write(folder.path().join("scene.ron"), text).expect("it can be written to");
        read(folder.path(), Some(&["ReadScene"]))
    }

    #[test]
    fn fields_become_settings_and_lights_become_members() {
        let text = r#"Scene(version: 1, photo: "a.png", camera: FovX(60), depth: (path: "d.npy"),
            lights: { "b": Lamp(mask: "b.png"), "a": Window(mask: "a.png") })"#;
        let overlay = scene(text).expect("this scene is sound");
        let of = |stage: &str| {
            let settings =
                overlay.settings.iter().filter(|s| s.target == Target::Kind(stage.into()));
            settings.map(|s| (s.field.as_str(), s.value.text())).collect::<Vec<_>>()
        };
        let photo = [("photo", "\"a.png\""), ("camera", "FovX(60)")];
        assert_eq!(of("ReadScene")[..3], [photo[0], photo[1], ("depth", "(path: \"d.npy\")")]);
        assert_eq!(of("ReadPhoto"), photo);
        for set in SETS {
            let of_set = overlay.members.iter().filter(|m| m.set == set);
            assert_eq!(
                of_set.map(|m| m.name.as_str()).collect::<Vec<_>>(),
                ["b", "a"],
                "in the order of the file"
            );
        }
    }

    #[test]
    fn what_is_known_goes_to_the_stages_that_read_it() {
        let text = r#"Scene(version: 1, photo: "a.png", camera: FovX(60), depth: (path: "d.npy"),
            truth: (albedo: "a.exr", lights: "l.json"))"#;
        let overlay = scene(text).expect("this scene is sound");
        let of = |kind: &str| {
            let settings =
                overlay.settings.iter().filter(|s| s.target == Target::Kind(kind.into()));
            settings.map(|s| (s.field.as_str(), s.value.text())).collect::<Vec<_>>()
        };
        assert_eq!(of("ReadLights"), [("path", "\"l.json\"")]);
        assert_eq!(of("ReadMaterials"), [("albedo", "\"a.exr\"")]);
        assert_eq!(of("ReadScene").len(), 3);
        let faults = scene(&text.replace("albedo", "albdeo")).err().expect("it is not sound");
        assert_eq!(faults[0].message, "unknown field `albdeo`");
    }

    #[test]
    fn what_is_measured_against_is_kept_for_who_asks() {
        let text = r#"Scene(version: 1, photo: "a.png", camera: FovX(60), depth: (path: "d.npy"),
            truth: (lights: "l.json", depth: "t.exr", pictures: { "lamp_0": "p.exr" }, edits: { "a.ron": "b.exr" }))"#;
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let write = |text: &str| {
            std::fs::write(folder.path().join("scene.ron"), text).expect("it can be written to")
        };
        write(text);
        let fields = truth(folder.path()).expect("this scene is sound");
        let names: Vec<_> = fields.iter().map(|(key, _)| key.name.as_str()).collect();
        assert_eq!(names, ["lights", "depth", "pictures", "edits"]);
        let scene = read(folder.path(), None).expect("it is sound").settings;
        let paths: Vec<_> =
            scene.iter().filter(|s| s.field == "depth").map(|s| s.value.text()).collect();
        assert_eq!(paths, ["(path: \"d.npy\")"], "depth stays the scene's own");
        for (from, to, wanted) in [
            (r#""p.exr""#, "7", "`pictures` wanted the name of a file in quotes, got `7`"),
            (r#""t.exr""#, "(1, 2)", "`depth` wanted the name of a file in quotes, got `(1, 2)`"),
            (
                r#"{ "a.ron": "b.exr" }"#,
                r#""b.exr""#,
                "wanted `{ \"name\": value, .. }`, got `\"b.exr\"`",
            ),
        ] {
            write(&text.replace(from, to));
            let faults = truth(folder.path()).expect_err("it is not sound");
            assert_eq!(faults[0].message, wanted);
        }
    }

    #[test]
    fn facts_about_the_room_go_to_the_room_alone() {
        let text = r#"Scene(version: 1, photo: "a.png", camera: FovX(60), depth: (path: "d.npy"),
            room: (height: 2.7, ceiling: None))"#;
        let overlay = scene(text).expect("this scene is sound");
        let of_room: Vec<_> = overlay.settings.iter().filter(|s| s.field == "room").collect();
        assert_eq!(of_room.len(), 1);
        assert_eq!(of_room[0].target, Target::Kind("RoomBox".into()));
        assert_eq!(of_room[0].value.text(), "(height: 2.7, ceiling: None)");
    }

    /// Work that grows as the square of the lights takes minutes here.
    #[test]
    fn two_hundred_thousand_lights_are_read() {
        let text = |name: &str| {
            let lights: String =
                (0..200_000).map(|i| format!("\"{name}{i}\": Lamp(mask: \"a.png\"),\n")).collect();
            format!(
                "Scene(version: 1, photo: \"a.png\", camera: FovX(60), depth: (path: \"d.npy\"), lights: {{ {lights} }})"
            )
        };
        assert_eq!(scene(&text("l")).expect("it is sound").members.len(), 4 * 200_000);
        let faults = scene(&text("1")).err().expect("no name begins with a digit");
        assert_eq!(
            (faults.len(), faults[50].message.as_str()),
            (51, "and up to 199950 more errors")
        );
    }

    #[test]
    fn every_missing_field_is_told() {
        let faults = scene("Scene(version: 1)").err().expect("it is not sound");
        let messages: Vec<_> = faults.iter().map(|f| f.message.as_str()).collect();
        assert_eq!(
            messages,
            [
                "this scene has no `photo`",
                "this scene has no `camera`",
                "this scene has no `depth`"
            ]
        );
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let text = r#"Scene(version: 1, photo: "a.png", camera: FovX(60))"#;
        std::fs::write(folder.path().join("scene.ron"), text).expect("it can be written to");
        assert!(read(folder.path(), Some(&["ReadPhoto"])).is_ok(), "a photo has no depth");
    }
}
