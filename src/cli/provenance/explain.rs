//! `relight explain PICTURE`: how a picture was made, and whether given inputs make it again.

use std::path::Path;

use relight::files::EditFile;
use relight::graph::Diagnostic;

use super::{Inputs, Provenance};
use crate::cli::args::SceneFiles;
use crate::cli::load::load;

/// The text of `relight explain PICTURE`; where `inputs` has a graph and an edit, also whether
/// they make the picture again.
///
/// # Errors
/// The picture has no record, or the inputs cannot be used.
pub fn explain(
    picture: &Path,
    inputs: Option<(&Path, Option<&Path>)>,
    files: &SceneFiles,
) -> Result<String, Vec<Diagnostic>> {
    let record = Provenance::read(picture).map_err(|fault| vec![fault])?;
    let mut text = format!("{}: {}", picture.display(), made(&record));
    let Some((graph, edit)) = inputs else {
        text.push_str("to compare them: relight explain PICTURE GRAPH EDIT --scene DIR\n");
        return Ok(text);
    };
    let frame = record.frame.or(files.frame);
    let files = SceneFiles { frame, ..files.clone() };
    let resolved = load(graph, edit, &files)?;
    let edit = edit.map(|edit| EditFile::read_within(edit, files.reach())).transpose()?;
    let edit = edit.as_ref().map(EditFile::text);
    let given = Inputs { graph, budget: None, edit, frame };
    let given = given.provenance(&resolved, &record.output).map_err(|fault| vec![fault])?;
    text.push_str(&compared(&record, &given));
    Ok(text)
}

/// The text of the record.
fn made(record: &Provenance) -> String {
    let mut text = format!(
        "made by relight {}, output `{}` of the graph `{}`",
        record.relight, record.output, record.graph
    );
    if let Some(frame) = record.frame {
        text.push_str(&format!(", frame {frame}"));
    }
    text.push('\n');
    match &record.edit {
        None => text.push_str("edit: none\n"),
        Some(edit) => {
            text.push_str("edit:\n");
            edit.lines().for_each(|line| text.push_str(&format!("    {line}\n")));
        }
    }
    text.push_str("files, by BLAKE3:\n");
    for (name, digest) in &record.files {
        text.push_str(&format!("    {digest}  {name}\n"));
    }
    for (light, [r, g, b]) in &record.mix {
        text.push_str(&format!("mixed after the run: {light} x {r}, {g}, {b}\n"));
    }
    if let Some(budget) = record.budget {
        text.push_str(&format!("under --budget {budget}s: results depend on the machine\n"));
    }
    text
}

/// Whether `given` makes the picture of `record` again, and what differs.
fn compared(record: &Provenance, given: &Provenance) -> String {
    let mut differ = Vec::new();
    if record.relight != given.relight {
        differ.push(format!("this is relight {}", given.relight));
    }
    if record.edit != given.edit {
        differ.push("the text of the edit differs".to_owned());
    }
    for (name, digest) in &record.files {
        match given.files.get(name) {
            Some(now) if now == digest => {}
            Some(_) => differ.push(format!("{name} has another content")),
            None => differ.push(format!("{name} is not read")),
        }
    }
    let new = given.files.keys().filter(|name| !record.files.contains_key(*name));
    differ.extend(new.map(|name| format!("{name} is read, too")));
    let is_same = record.inputs == given.inputs;
    let verdict = match (is_same, record.mix.is_empty() && record.budget.is_none()) {
        (true, true) => "these inputs make this picture again",
        (true, false) => "these inputs make the picture of that run again",
        (false, _) => "these inputs make another picture",
    };
    if !is_same && differ.is_empty() {
        differ.push("a stage, a parameter or a wire of the graph differs".to_owned());
    }
    let details = differ.iter().map(|line| format!("    {line}\n"));
    format!("{verdict}\n{}", details.collect::<String>())
}
