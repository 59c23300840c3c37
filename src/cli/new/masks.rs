//! The lights of a new scene: masks that a person gives, or proposals.

use std::fmt::Write as _;
use std::path::Path;

use relight::graph::{Diagnostic, MAX_FILE_BYTES, is_name, read};
use relight::image::{NamedBytes, read_mask};

use super::folder::listed;

/// Most files of a folder that are looked at.
const MAX_FILES: usize = 1000;

/// The lights of a scene, and the files of their masks.
#[derive(Default)]
pub struct Lights {
    /// The fields `lights` and `ignore` of scene.ron, with comments, indented.
    pub field: String,
    /// The names of the lights, in the order of the field.
    pub names: Vec<String>,
    /// Names below the scene's folder, and bytes.
    pub files: Vec<(String, Vec<u8>)>,
    /// Facts that a person should know.
    pub notes: Vec<String>,
}

/// Takes the masks of a folder: `lamp*` are lamps, `window*` windows, `ignore*` and `outside*`
/// pixels outside of the room, `maybe_*` is passed over.
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
    let mut ignore = None;
    let mut lines = String::new();
    for name in names {
        let stem = name.rsplit_once('.').map_or(&*name, |(stem, _)| stem).to_owned();
        let kind = match &stem {
            stem if stem.starts_with("lamp") => "Lamp",
            stem if stem.starts_with("window") => "Window",
            stem if stem.starts_with("ignore") || stem.starts_with("outside") => "ignore",
            stem if stem.starts_with("maybe_") => continue,
            _ => {
                lights.notes.push(format!(
                    "{name} is not used: wanted a name that begins with lamp, window, ignore or maybe_"
                ));
                continue;
            }
        };
        let path = folder.join(&name);
        let fault = |message: String| Diagnostic::file(&path, message);
        let bytes =
            read(&path, MAX_FILE_BYTES).map_err(|e| fault(format!("cannot be read: {e}")))?;
        read_mask(NamedBytes::new(&name, &bytes)).map_err(|e| fault(e.message()))?;
        let file = format!("masks/{name}");
        if kind == "ignore" {
            if ignore.replace(file.clone()).is_some() {
                let message = "wanted one mask of pixels outside of the room, got a second one";
                return Err(fault(message.into()));
            }
        } else {
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
    if let Some(file) = ignore {
        writeln!(
            lights.field,
            "    // Pixels that are not part of the room.\n    ignore: {file:?},"
        )
        .expect("memory can be written to");
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
