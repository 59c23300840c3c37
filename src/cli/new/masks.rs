//! The lights of a new scene: masks that a person gives, or proposals.

use std::fmt::Write as _;
use std::path::Path;

use relight::graph::{Diagnostic, MAX_FILE_BYTES, is_name, read};
use relight::image::{NamedBytes, read_mask};

use super::folder::listed;

/// Most files of a folder that are looked at.
const MAX_FILES: usize = 1000;

/// How the names of the files of lights begin, and their kinds.
const LIGHTS: [(&str, &str); 2] = [("lamp", "Lamp"), ("window", "Window")];

/// Fields of a scene for masks that are not those of lights, how the names of their files begin,
/// and a comment.
const OTHERS: [(&str, &[&str], &str); 2] = [
    ("ignore", &["ignore", "outside"], "Pixels that are not part of the room."),
    ("sunlight", &["sunlight"], "Pixels lit by the sun."),
];

/// The lights of a scene, and the files of their masks.
#[derive(Default)]
pub struct Lights {
    /// The fields `lights`, `ignore` and `sunlight` of scene.ron, with comments, indented.
    pub field: String,
    /// The names of the lights, in the order of the field.
    pub names: Vec<String>,
    /// Names below the scene's folder, and bytes.
    pub files: Vec<(String, Vec<u8>)>,
    /// Facts that a person should know.
    pub notes: Vec<String>,
}

/// Takes the masks of a folder: `lamp*` are lamps, `window*` windows, `ignore*` and `outside*`
/// pixels outside of the room, `sunlight*` those lit by the sun, `maybe_*` is passed over.
///
/// # Errors
/// The folder cannot be listed, has no mask, or a file of such a name has other content.
pub fn given(folder: &Path) -> Result<Lights, Diagnostic> {
    let names = listed(folder)?
        .take(MAX_FILES)
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut names: Vec<String> = names.collect();
    names.sort();
    let mut lights = Lights::default();
    let mut others = OTHERS.map(|_| None);
    let mut lines = String::new();
    for name in names {
        let stem = name.rsplit_once('.').map_or(&*name, |(stem, _)| stem).to_owned();
        let is = |start: &str| stem.starts_with(start);
        let light = LIGHTS.iter().find(|(start, _)| is(start)).map(|(_, kind)| kind);
        let other = OTHERS.iter().position(|(_, starts, _)| starts.iter().any(|start| is(start)));
        if light.is_none() && other.is_none() {
            if !is("maybe_") {
                lights.notes.push(format!(
                    "{name} is not used: wanted a name that begins with lamp, window, ignore, sunlight or maybe_"
                ));
            }
            continue;
        }
        let path = folder.join(&name);
        let fault = |message: String| Diagnostic::file(&path, message);
        let bytes =
            read(&path, MAX_FILE_BYTES).map_err(|e| fault(format!("cannot be read: {e}")))?;
        read_mask(NamedBytes::new(&name, &bytes)).map_err(|e| fault(e.message()))?;
        let file = format!("masks/{name}");
        if let Some(k) = other
            && others[k].replace(file.clone()).is_some()
        {
            let (field, ..) = OTHERS[k];
            return Err(fault(format!("wanted one mask for `{field}`, got a second one")));
        }
        if let Some(kind) = light {
            if !is_name(&stem) {
                let message = "wanted a name of letters, digits and _, as lamp_0.png";
                return Err(fault(message.into()));
            }
            writeln!(lines, "        {stem:?}: {kind}(mask: {file:?}),")
                .expect("memory can be written to");
            lights.names.push(stem);
        }
        lights.files.push((file, bytes));
    }
    if lights.files.is_empty() {
        let message = "wanted masks: lamp_0.png, window_0.png and the like, got none";
        return Err(Diagnostic::file(folder, message)
            .help("without --masks, lamps and windows are proposed"));
    }
    lights.field = field("Lamps and windows in view, by the masks that were given.", &lines);
    for ((field, _, comment), file) in OTHERS.iter().zip(others) {
        if let Some(file) = file {
            writeln!(lights.field, "    // {comment}\n    {field}: {file:?},")
                .expect("memory can be written to");
        }
    }
    Ok(lights)
}

/// The field `lights` with these lines under a comment.
fn field(comment: &str, lines: &str) -> String {
    format!("    // {comment}\n    lights: {{\n{lines}    }},\n")
}

/// Takes the files of `FindLights`: its masks, and its lines for scene.ron. `found.png` is left
/// out.
pub fn proposed(files: &[(String, Vec<u8>)]) -> Lights {
    let masks = files.iter().filter(|(name, _)| name.starts_with("masks/"));
    let text = files.iter().find(|(name, _)| name == "scene_lights.ron").map(|(_, text)| text);
    let text = text.map(|text| String::from_utf8_lossy(text)).unwrap_or_default();
    let lines = text
        .lines()
        .filter(|line| line.trim_start().starts_with(['"', '/']) && line.starts_with(' '));
    let lines: Vec<&str> = lines.map(str::trim).collect();
    let names = lines.iter().filter_map(|line| line.strip_prefix('"')?.split_once('"'));
    Lights {
        names: names.map(|(name, _)| name.to_owned()).collect(),
        field: field(
            "Lamps and windows in view, as proposed. Correct the masks with any painting program;\n    \
             // delete lines of masks that are not lights; change Lamp to Window where the kind is wrong.",
            &lines.iter().map(|line| format!("        {line}\n")).collect::<String>(),
        ),
        files: masks.cloned().collect(),
        notes: Vec::new(),
    }
}
