//! The list of a batch: photos, edits and frames, as patterns, lists, and a table in CSV.
//!
//! The list names files and opens none but itself and its table; the command looks for the files
//! that a pattern matches.

use std::path::Path;
use std::sync::Arc;

use super::fields;
use crate::graph::{Diagnostic, Diagnostics, Key, Origin, Raw, Reach, Source, is_name, nearest};

const FIELDS: [&str; 9] =
    ["version", "graph", "scenes", "edits", "table", "frames", "chunk", "set", "out"];
/// Columns of a table beside those that set a parameter.
const COLUMNS: [&str; 6] = ["scene", "edit", "first", "last", "out", "task"];
/// As many frames as an edit may have.
const MOST_FRAMES: u32 = 100_000;
/// Rows of a table, above which a list is better split.
const MOST_ROWS: usize = 1_000_000;

/// `Batch(..)`. Texts are as they stand in the file, with their places.
#[derive(Debug, Default)]
pub struct Batch {
    /// The graph file, or the name of one that ships; `None` is the default of the command.
    pub graph: Option<Key>,
    /// Scene folders, or patterns of them.
    pub scenes: Vec<Key>,
    /// Edit files, or patterns of them. Without any, photos stay unedited.
    pub edits: Vec<Key>,
    /// The first and the last frame of edits that are sequences; `None` is all.
    pub frames: Option<(u32, u32)>,
    /// Frames that one job has at most; `None` is all of an edit.
    pub chunk: Option<u32>,
    /// Settings of parameters, as `NODE.PARAM=VALUE`.
    pub set: Vec<String>,
    /// The folder for the results, relative to that of the list; `None` is `out`.
    pub out: Option<String>,
    /// Rows of the table.
    pub rows: Vec<Row>,
}

/// A row of the table: one job, or the frames of one.
#[derive(Debug)]
pub struct Row {
    /// The scene folder.
    pub scene: Key,
    /// The edit file.
    pub edit: Option<Key>,
    /// First and last frame.
    pub frames: Option<(u32, u32)>,
    /// The folder for the results, within that of the batch.
    pub out: Option<Key>,
    /// The task of a plan that has this row.
    pub task: Option<u32>,
    /// Settings of parameters, as `NODE.PARAM=VALUE`.
    pub set: Vec<String>,
}

/// Reads the list at `path`, and its table.
///
/// # Errors
/// All faults of both files.
pub fn read(path: &Path) -> Result<Batch, Vec<Diagnostic>> {
    let source = Source::read(path, Reach::Anywhere).map_err(|fault| vec![fault])?;
    parse(&source)
}

fn parse(source: &Arc<Source>) -> Result<Batch, Vec<Diagnostic>> {
    let mut faults = Diagnostics::default();
    let mut batch = Batch::default();
    let mut table = None;
    for (key, value) in fields(source, "Batch", &FIELDS, &mut faults) {
        match key.name.as_str() {
            "graph" => batch.graph = value.as_key(&mut faults),
            "scenes" => batch.scenes = texts(&value, &mut faults),
            "edits" => batch.edits = texts(&value, &mut faults),
            "table" => table = value.as_key(&mut faults),
            "frames" => {
                let range = value.parse::<(u32, u32)>();
                let range = range.filter(|(first, last)| first <= last && *last < MOST_FRAMES);
                if range.is_none() {
                    faults.push(|| {
                        let message = format!(
                            "wanted the first and the last frame, as `(0, 239)`, got `{}`",
                            value.short()
                        );
                        value.fault(message)
                    });
                }
                batch.frames = range;
            }
            "chunk" => {
                let chunk = value.parse::<u32>().filter(|chunk| (1..=MOST_FRAMES).contains(chunk));
                if chunk.is_none() {
                    let wanted = format!("wanted a number of frames from 1 to {MOST_FRAMES}");
                    faults.push(|| value.fault(format!("{wanted}, got `{}`", value.short())));
                }
                batch.chunk = chunk;
            }
            "set" => {
                let settings = texts(&value, &mut faults);
                batch.set.extend(settings.into_iter().map(|setting| setting.name));
            }
            _ => batch.out = value.as_key(&mut faults).map(|key| key.name),
        }
    }
    if let Some(name) = table {
        batch.rows = read_table(&name, &mut faults);
    } else if batch.scenes.is_empty() && faults.is_empty() {
        let help = "write `scenes: [\"rooms/*\"],` or `table: \"jobs.csv\",`";
        faults.push(|| Diagnostic::file(&source.path, "this batch has no photos").help(help));
    }
    if faults.is_empty() { Ok(batch) } else { Err(faults.into_vec()) }
}

fn texts(list: &Raw, faults: &mut Diagnostics) -> Vec<Key> {
    let items = list.as_list(faults);
    items.iter().filter_map(|item| item.as_key(faults)).collect()
}

/// The rows of the table that a list names.
fn read_table(name: &Key, faults: &mut Diagnostics) -> Vec<Row> {
    let path = name.origin.source.folder().join(&name.name);
    let source = match Source::read(&path, Reach::Anywhere) {
        Ok(source) => source,
        Err(fault) => {
            let message = format!("the table `{}`: {}", name.name, fault.message);
            faults.push(|| Diagnostic::at(&name.origin, message));
            return Vec::new();
        }
    };
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .trim(csv::Trim::All)
        .flexible(true)
        .comment(Some(b'#'))
        .from_reader(source.text.as_bytes());
    let mut columns: Vec<String> = Vec::new();
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = match record {
            Ok(record) => record,
            Err(e) => {
                faults.push(|| Diagnostic::file(&source.path, format!("wanted CSV: {e}")));
                break;
            }
        };
        let line = Line::new(&source, &record);
        if columns.is_empty() {
            columns = header(&line, faults);
            if !faults.is_empty() {
                break;
            }
        } else if record.len() != columns.len() {
            let message = format!("wanted {} cells, got {}", columns.len(), record.len());
            faults.push(|| Diagnostic::at(&line.origin(0), message));
        } else if rows.len() == MOST_ROWS {
            let message = format!("wanted at most {MOST_ROWS} rows: split the table");
            faults.push(|| Diagnostic::at(&line.origin(0), message));
            break;
        } else {
            rows.extend(row(&columns, &line, faults));
        }
    }
    if columns.is_empty() && faults.is_empty() {
        faults.push(|| {
            Diagnostic::file(&source.path, "wanted a line of columns, got an empty table")
        });
    }
    rows
}

/// A record, and its place.
struct Line<'a> {
    source: &'a Arc<Source>,
    record: &'a csv::StringRecord,
    start: usize,
}

impl Line<'_> {
    fn new<'a>(source: &'a Arc<Source>, record: &'a csv::StringRecord) -> Line<'a> {
        let start = record.position().map_or(0, |position| position.byte() as usize);
        Line { source, record, start: start.min(source.text.len()) }
    }

    fn cell(&self, column: usize) -> &str {
        self.record.get(column).unwrap_or_default()
    }

    /// The place of a cell: the first text like it behind the cells before it.
    fn origin(&self, column: usize) -> Origin {
        let mut span = self.start..self.start;
        for cell in (0..=column).map(|column| self.cell(column)) {
            let rest = self.source.text.get(span.end..).unwrap_or_default();
            let found = rest.find(cell).map_or(span.end, |at| span.end + at);
            span = found..found + cell.len();
        }
        Origin { source: self.source.clone(), span }
    }

    fn key(&self, column: usize) -> Option<Key> {
        let name = self.cell(column);
        (!name.is_empty()).then(|| Key { name: name.to_owned(), origin: self.origin(column) })
    }
}

/// The columns of a table.
fn header(line: &Line, faults: &mut Diagnostics) -> Vec<String> {
    let columns: Vec<String> = line.record.iter().map(str::to_owned).collect();
    for (at, column) in columns.iter().enumerate() {
        let is_setting =
            column.split_once('.').is_some_and(|(node, field)| is_name(node) && is_name(field));
        if !is_setting && !COLUMNS.contains(&column.as_str()) {
            faults.push(|| {
                let known = format!("{} and NODE.PARAM", COLUMNS.join(", "));
                let fault = Diagnostic::at(&line.origin(at), format!("unknown column `{column}`"));
                match nearest(column, COLUMNS) {
                    Some(near) => fault.help(format!("did you mean `{near}`? Columns are {known}")),
                    None => fault.help(format!("columns are {known}")),
                }
            });
        }
        if columns[..at].contains(column) {
            let message = format!("the column `{column}` is there twice");
            faults.push(|| Diagnostic::at(&line.origin(at), message));
        }
    }
    if !columns.iter().any(|column| column == "scene") {
        let message = "this table has no column `scene`";
        faults.push(|| Diagnostic::at(&line.origin(0), message));
    }
    columns
}

fn row(columns: &[String], line: &Line, faults: &mut Diagnostics) -> Option<Row> {
    let before = faults.found();
    let at = |name: &str| columns.iter().position(|column| column == name);
    let key = |name: &str| at(name).and_then(|column| line.key(column));
    let mut number = |name: &str| {
        let (column, text) = at(name).map(|column| (column, line.cell(column)))?;
        let number = text.parse::<u32>().ok().filter(|number| *number < MOST_FRAMES * 10);
        if !text.is_empty() && number.is_none() {
            let message = format!("wanted a whole number in `{name}`, got `{text}`");
            faults.push(|| Diagnostic::at(&line.origin(column), message));
        }
        number
    };
    let (first, last, task) = (number("first"), number("last"), number("task"));
    let frames = match (first, last) {
        (Some(first), Some(last)) if first <= last && last < MOST_FRAMES => Some((first, last)),
        (None, None) => None,
        _ => {
            let column = at("first").or(at("last")).unwrap_or(0);
            let message = "wanted a first and a last frame, in this order, or neither";
            faults.push(|| Diagnostic::at(&line.origin(column), message));
            None
        }
    };
    let scene = key("scene");
    if scene.is_none() {
        let column = at("scene").unwrap_or(0);
        faults.push(|| Diagnostic::at(&line.origin(column), "this row has no scene"));
    }
    let set = columns.iter().enumerate().filter(|(_, column)| column.contains('.'));
    let set = set
        .filter(|(column, _)| !line.cell(*column).is_empty())
        .map(|(column, name)| format!("{name}={}", line.cell(column)));
    let row =
        Row { scene: scene?, edit: key("edit"), frames, out: key("out"), task, set: set.collect() };
    (faults.found() == before).then_some(row)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn faults(text: &str) -> Vec<String> {
        let faults = parse(&Source::new("jobs.ron", text)).expect_err("it has faults");
        faults.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_list_has_its_fields_and_a_fault_its_place() {
        let text = r#"Batch(version: 1, scenes: ["rooms/*"], frames: (0, 239), chunk: 24, set: ["a.b=1"])"#;
        let batch = parse(&Source::new("jobs.ron", text)).expect("it is sound");
        assert_eq!((batch.frames, batch.chunk), (Some((0, 239)), Some(24)));
        assert_eq!(batch.scenes[0].name, "rooms/*");
        for (text, wanted) in [
            (r#"Batch(version: 1, scenes: [], frame: (0, 1))"#, "unknown field `frame`"),
            (r#"Batch(version: 1, scenes: ["a"], frames: (9, 1))"#, "as `(0, 239)`"),
            (r#"Batch(version: 1, scenes: ["a"], chunk: 0)"#, "from 1 to 100000"),
            (r#"Batch(version: 1)"#, "no photos"),
        ] {
            assert!(faults(text)[0].contains(wanted), "{text}: {:?}", faults(text));
        }
    }

    #[test]
    fn a_table_gives_rows_and_places() {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let list = folder.path().join("jobs.ron");
        std::fs::write(&list, r#"Batch(version: 1, table: "jobs.csv")"#).expect("it is written");
        let table = |text: &str| {
            std::fs::write(folder.path().join("jobs.csv"), text).expect("it is written");
            read(&list)
        };
        let batch = table(
            "scene,edit,first,last,direct.samples\n# a comment\nhall,\"a, b.ron\",0,9,32\nhall,,,,\n",
        );
        let rows = batch.expect("it is sound").rows;
        assert_eq!(rows.len(), 2);
        assert_eq!(rows[0].edit.as_ref().map(|edit| edit.name.as_str()), Some("a, b.ron"));
        assert_eq!(
            (rows[0].frames, &rows[0].set[..]),
            (Some((0, 9)), &["direct.samples=32".into()][..])
        );
        assert!(rows[1].edit.is_none() && rows[1].set.is_empty());
        for (text, wanted, place) in [
            ("scene,edti\nhall,a\n", "unknown column `edti`", (1, 7)),
            ("scene,first,last\nhall,3,x\n", "got `x`", (2, 8)),
            ("scene,first,last\nhall,3,1\n", "in this order", (2, 6)),
            ("scene,edit\nhall\n", "wanted 2 cells, got 1", (2, 1)),
            ("scene,edit\n,a\n", "this row has no scene", (2, 1)),
        ] {
            let fault = table(text).expect_err(text).remove(0);
            assert!(fault.message.contains(wanted), "{text}: {fault}");
            assert_eq!(fault.origin.expect("it has a place").line_column(), place, "{text}");
        }
    }
}
