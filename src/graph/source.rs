//! Texts that people write, places in them, and the faults found there.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::reading::{self, File};

/// No file that a person writes is larger.
const MAX_BYTES: u64 = 16 << 20;
/// Names that a wrong one is compared with.
const MAX_COMPARED: usize = 1000;
/// Bytes of a name that is compared with others, which takes work as the product of both lengths.
const LONGEST_COMPARED: usize = 200;

/// The files that a text may name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reach {
    /// Any file that the user may read.
    #[default]
    Anywhere,
    /// Those in the folder of the text's own file, or below it, once symbolic links are followed.
    OwnFolder,
}

/// A text and the file it came from.
#[derive(Debug, PartialEq, Eq)]
pub struct Source {
    /// The file, or a name for another origin (`--set`); relative paths in the text start from its
    /// folder.
    pub path: PathBuf,
    /// The text.
    pub text: String,
    /// The files that the text may name.
    pub reach: Reach,
    /// By ascending `at`, for a text that differs from that of its file: the locations of its
    /// pieces there.
    pub anchors: Vec<Anchor>,
}

/// The line and column in its file, both counted from 1, of a text from byte `at` on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Anchor {
    /// Byte offset in the text.
    pub at: usize,
    /// Line in the file, from 1.
    pub line: usize,
    /// Column in the file, from 1.
    pub column: usize,
}

impl Source {
    /// Creates a text that may name any file.
    pub fn new(path: impl Into<PathBuf>, text: impl Into<String>) -> Arc<Source> {
        Source::within(path, text, Reach::Anywhere)
    }

    /// A text that may name files within `reach` only.
    pub fn within(path: impl Into<PathBuf>, text: impl Into<String>, reach: Reach) -> Arc<Source> {
        Arc::new(Source { path: path.into(), text: text.into(), reach, anchors: Vec::new() })
    }

    /// Reads a file of at most 16 MB of UTF-8, which may name files within `reach` only.
    ///
    /// # Errors
    /// It cannot be read, is too large, or holds something else.
    pub fn read(path: &Path, reach: Reach) -> Result<Arc<Source>, Diagnostic> {
        let bytes = reading::read(path, MAX_BYTES).map_err(|e| {
            let fault = Diagnostic::file(path, format!("cannot be read: {e}"));
            path_help(&path.to_string_lossy()).into_iter().fold(fault, Diagnostic::help)
        })?;
        let text = String::from_utf8(bytes).map_err(|e| {
            let before = &e.as_bytes()[..e.utf8_error().valid_up_to()];
            let line = 1 + before.iter().filter(|&&b| b == b'\n').count();
            let message = format!("wanted UTF-8 text, got another byte in line {line}");
            Diagnostic::file(path, message).help(
                "wanted a text file in RON: is this a picture, or a text in another encoding?",
            )
        })?;
        Ok(Source::within(path, text.strip_prefix('\u{feff}').unwrap_or(&text), reach))
    }

    /// The folder that relative paths in this text start from.
    pub fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }

    /// The file that this text names so.
    pub fn file(&self, name: &str) -> File {
        let mut file = File::new(name);
        self.adopt(&mut file);
        file
    }

    /// Makes `file` one that this text names: found from its folder, and confined to it where the
    /// text is.
    pub(super) fn adopt(&self, file: &mut File) {
        file.base = Some(self.folder().to_owned());
        file.within = (self.reach == Reach::OwnFolder).then(|| self.folder().to_owned());
    }

    /// Whether this text may name the file or folder at `path`; always where it is not confined.
    ///
    /// # Errors
    /// The message states the wanted and the actual place.
    pub(super) fn may_name(&self, path: &Path) -> std::io::Result<()> {
        match self.reach {
            Reach::Anywhere => Ok(()),
            Reach::OwnFolder => reading::below(self.folder(), path).map(drop),
        }
    }
}

impl Anchor {
    /// Moves the anchor to a later byte of `text`, where no other anchor lies between.
    pub fn moved(self, text: &str, at: usize) -> Anchor {
        let between = &text[self.at..at];
        match between.rfind('\n') {
            Some(last) => {
                let line = self.line + between.matches('\n').count();
                Anchor { at, line, column: 1 + between[last + 1..].chars().count() }
            }
            None => Anchor { at, line: self.line, column: self.column + between.chars().count() },
        }
    }
}

/// The place of a piece of text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin {
    /// The text that contains the place.
    pub source: Arc<Source>,
    /// Byte range in the text.
    pub span: Range<usize>,
}

impl Origin {
    /// Returns the text at this place.
    pub fn text(&self) -> &str {
        &self.source.text[self.span.clone()]
    }

    /// Line and column of the first character in the file, from 1, columns in characters. A place
    /// past the end counts as the end.
    pub fn line_column(&self) -> (usize, usize) {
        let Source { text, anchors, .. } = &*self.source;
        let start = text.floor_char_boundary(self.span.start.min(text.len()));
        let before = anchors[..anchors.partition_point(|anchor| anchor.at <= start)].last();
        let anchor = before.copied().unwrap_or(Anchor { at: 0, line: 1, column: 1 });
        let Anchor { line, column, .. } = anchor.moved(text, start);
        (line, column)
    }
}

/// A fault in a file or an argument, found before any work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// The place in the text, where there is one.
    pub origin: Option<Origin>,
    /// The file.
    pub path: PathBuf,
    /// The wanted and the actual content.
    pub message: String,
    /// A remedy.
    pub help: Option<String>,
}

impl Diagnostic {
    /// Creates a fault at a place.
    pub fn at(origin: &Origin, message: impl Into<String>) -> Diagnostic {
        let path = origin.source.path.clone();
        Diagnostic { origin: Some(origin.clone()), path, message: message.into(), help: None }
    }

    /// A fault of a whole file, or of no file at all where `path` is empty.
    pub fn file(path: &Path, message: impl Into<String>) -> Diagnostic {
        Diagnostic { origin: None, path: path.to_owned(), message: message.into(), help: None }
    }

    /// Whether its place lies in `origin`.
    pub(super) fn is_inside(&self, origin: &Origin) -> bool {
        let inside = |own: &Origin| {
            Arc::ptr_eq(&own.source, &origin.source)
                && origin.span.start <= own.span.start
                && own.span.end <= origin.span.end
        };
        self.origin.as_ref().is_some_and(inside)
    }

    /// Adds a line of help.
    pub fn help(mut self, help: impl Into<String>) -> Diagnostic {
        self.help = Some(help.into());
        self
    }

    /// Adds the nearest of `known` as help, or the whole list where it is short and nothing is
    /// near.
    pub fn suggest<'a>(self, name: &str, known: impl IntoIterator<Item = &'a str>) -> Diagnostic {
        let known: Vec<&str> = known.into_iter().take(MAX_COMPARED).collect();
        match nearest(name, known.iter().copied()) {
            Some(near) => self.help(format!("did you mean `{near}`?")),
            None if known.is_empty() => self.help("there are none"),
            None if known.len() <= 12 => self.help(format!("known: {}", known.join(", "))),
            None => self,
        }
    }
}

impl std::fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.origin {
            Some(origin) => {
                let (line, column) = origin.line_column();
                write!(f, "{}:{line}:{column}: {}", self.path.display(), self.message)?;
            }
            None if self.path.as_os_str().is_empty() => write!(f, "{}", self.message)?,
            None => write!(f, "{}: {}", self.path.display(), self.message)?,
        }
        self.help.as_ref().map_or(Ok(()), |help| write!(f, " ({help})"))
    }
}

impl std::error::Error for Diagnostic {}

/// The name most like `name`, if any is like it. A very long one is like no other.
pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let known = known.into_iter().filter(|other| other.len().max(name.len()) <= LONGEST_COMPARED);
    let name = name.to_lowercase();
    let likeness = |other: &str| strsim::jaro_winkler(&name, &other.to_lowercase());
    let best = known.map(|other| (likeness(other), other)).max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best.0 >= 0.8).then_some(best.1)
}

/// The likely mistake in a path that leads to no file.
pub(super) fn path_help(path: &str) -> Option<String> {
    path.contains('\\')
        .then(|| format!("write `/` between folders: \"{}\"", path.replace('\\', "/")))
}

/// Whether `name` may name a node, a set or a member: `[A-Za-z][A-Za-z0-9_]*`.
pub fn is_name(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_alphabetic())
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}
