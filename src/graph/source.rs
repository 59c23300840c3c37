//! RON texts that people write, cut into raw entries that remember where they stand, and the faults found in them.
//!
//! `serde` alone stops at the first fault and forgets places. Here a text is checked and split first, and each piece is
//! parsed by itself, so that all faults of a file show in one pass, each with its own caret.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::de::DeserializeOwned;

use super::faults::Faults;
use super::lexer::{Kind, Token, tokens};
use super::{File, from_ron, reading};

/// No file that a person writes is larger.
const MAX_BYTES: u64 = 16 << 20;
/// RON's own parser recurses; beyond this depth a text is refused before it gets there.
const MAX_DEPTH: usize = 64;
/// Names that a wrong one is compared with.
const MAX_COMPARED: usize = 1000;
/// Bytes of a name that is compared with others, which takes work as the product of both lengths.
const LONGEST_COMPARED: usize = 200;

/// The files that a text may name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reach {
    /// Any that the person who runs the program may read.
    #[default]
    Anywhere,
    /// Those in the folder of the text's own file, or below it, once symbolic links are followed.
    OwnFolder,
}

/// A text and the file it came from.
#[derive(Debug, PartialEq, Eq)]
pub struct Source {
    /// The file, or what stands for one (`--set`); relative paths in the text start from its folder.
    pub path: PathBuf,
    pub text: String,
    pub reach: Reach,
    /// By ascending `at`, for a text that differs from that of its file: where its pieces stand there.
    pub anchors: Vec<Anchor>,
}

/// From byte `at` on, a text stands at this line and column of its file, both counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Anchor {
    pub at: usize,
    pub line: usize,
    pub column: usize,
}

impl Source {
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
    pub fn read(path: &Path, reach: Reach) -> Result<Arc<Source>, Fault> {
        let bytes = reading::read(path, MAX_BYTES).map_err(|e| Fault::file(path, format!("cannot be read: {e}")))?;
        let text = String::from_utf8(bytes).map_err(|e| {
            let before = &e.as_bytes()[..e.utf8_error().valid_up_to()];
            let line = 1 + before.iter().filter(|&&b| b == b'\n').count();
            Fault::file(path, format!("wanted UTF-8 text, got another byte in line {line}"))
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

    /// Makes `file` one that this text names: found from its folder, and confined to it where the text is.
    pub(super) fn adopt(&self, file: &mut File) {
        file.base = Some(self.folder().to_owned());
        file.within = (self.reach == Reach::OwnFolder).then(|| self.folder().to_owned());
    }

    /// Whether this text may name the file or folder at `path`; always where it is not confined.
    ///
    /// # Errors
    /// What was wanted and what was got.
    pub(super) fn may_name(&self, path: &Path) -> std::io::Result<()> {
        match self.reach {
            Reach::Anywhere => Ok(()),
            Reach::OwnFolder => reading::below(self.folder(), path).map(drop),
        }
    }
}

impl Anchor {
    /// The same for a later byte of `text`, where no other anchor lies between.
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

/// Where a piece of text stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin {
    pub source: Arc<Source>,
    /// Byte range in the text.
    pub span: Range<usize>,
}

impl Origin {
    pub fn text(&self) -> &str {
        &self.source.text[self.span.clone()]
    }

    /// Line and column of the first character in the file, from 1, columns in characters. A place past the end counts as the end.
    pub fn line_column(&self) -> (usize, usize) {
        let Source { text, anchors, .. } = &*self.source;
        let start = text.floor_char_boundary(self.span.start.min(text.len()));
        let before = anchors[..anchors.partition_point(|anchor| anchor.at <= start)].last();
        let anchor = before.copied().unwrap_or(Anchor { at: 0, line: 1, column: 1 });
        let Anchor { line, column, .. } = anchor.moved(text, start);
        (line, column)
    }
}

/// Something wrong in what a person wrote, found before any work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The place in the text, where there is one.
    pub origin: Option<Origin>,
    /// The file.
    pub path: PathBuf,
    /// What was wanted, what was got.
    pub message: String,
    /// What to do about it.
    pub help: Option<String>,
}

impl Fault {
    pub fn at(origin: &Origin, message: impl Into<String>) -> Fault {
        let path = origin.source.path.clone();
        Fault { origin: Some(origin.clone()), path, message: message.into(), help: None }
    }

    /// A fault of a whole file, or of no file at all where `path` is empty.
    pub fn file(path: &Path, message: impl Into<String>) -> Fault {
        Fault { origin: None, path: path.to_owned(), message: message.into(), help: None }
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

    pub fn help(mut self, help: impl Into<String>) -> Fault {
        self.help = Some(help.into());
        self
    }

    /// The same, with the nearest of `known` as help, or the whole list where it is short and nothing is near.
    pub fn suggest<'a>(self, name: &str, known: impl IntoIterator<Item = &'a str>) -> Fault {
        let known: Vec<&str> = known.into_iter().take(MAX_COMPARED).collect();
        match nearest(name, known.iter().copied()) {
            Some(near) => self.help(format!("did you mean `{near}`?")),
            None if known.is_empty() => self.help("there are none"),
            None if known.len() <= 12 => self.help(format!("known: {}", known.join(", "))),
            None => self,
        }
    }
}

impl std::fmt::Display for Fault {
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

impl std::error::Error for Fault {}

/// The name most like `name`, if any is like it. A very long one is like no other.
pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let known = known.into_iter().filter(|other| other.len().max(name.len()) <= LONGEST_COMPARED);
    let name = name.to_lowercase();
    let likeness = |other: &str| strsim::jaro_winkler(&name, &other.to_lowercase());
    let best = known.map(|other| (likeness(other), other)).max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best.0 >= 0.8).then_some(best.1)
}

/// Whether `name` may name a node, a set or a member: `[A-Za-z][A-Za-z0-9_]*`.
pub fn is_name(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_alphabetic()) && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

/// Whether `text` is a field name.
fn is_word(text: &str) -> bool {
    text.starts_with(|c: char| c.is_alphabetic() || c == '_') && text.chars().all(|c| c.is_alphanumeric() || c == '_')
}

/// The name of an entry, and where it stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Key {
    pub name: String,
    pub origin: Origin,
}

/// A RON value still as text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Raw {
    pub origin: Origin,
}

impl Raw {
    /// The one value of a whole text, after checking all of it: brackets, nesting, no duplicate key, no NaN, no
    /// infinite number. `None` when it cannot be split.
    pub fn document(source: &Arc<Source>, faults: &mut Faults) -> Option<Raw> {
        let whole = Raw { origin: Origin { source: source.clone(), span: 0..source.text.len() } };
        let tokens = whole.tokens(faults)?;
        let sound = check_nesting(&whole, &tokens, faults);
        check_values(&whole, &tokens, faults);
        let (first, last) = (tokens.first(), tokens.last());
        let Some((first, last)) = first.zip(last) else {
            faults.push(|| Fault::file(&source.path, "wanted a RON value, got an empty file"));
            return None;
        };
        sound.then(|| whole.part(first.span.start..last.span.end))
    }

    pub fn text(&self) -> &str {
        self.origin.text()
    }

    pub fn fault(&self, message: impl Into<String>) -> Fault {
        Fault::at(&self.origin, message)
    }

    /// The identifier that the value begins with: `Lamp` of `Lamp(radius: 1)`, `Off` of `Off`.
    pub fn variant(&self) -> Option<&str> {
        let first = tokens(self.text()).next()?.ok()?;
        (first.kind == Kind::Ident).then(|| &self.text()[first.span])
    }

    /// Every word, number, text and bracket of the value, in order, and whether it is a number; comments are left out.
    pub fn words(&self) -> Vec<(Raw, bool)> {
        let base = self.origin.span.start;
        let word = |t: Token| (self.part(base + t.span.start..base + t.span.end), t.kind == Kind::Number);
        tokens(self.text()).map_while(Result::ok).map(word).collect()
    }

    /// From the beginning of this value to the end of `last`, a later one of the same text.
    pub fn through(&self, last: &Raw) -> Raw {
        self.part(self.origin.span.start..last.origin.span.end)
    }

    /// The place of the identifier that the value begins with, or of the whole value.
    pub fn variant_origin(&self) -> Origin {
        let length = self.variant().map_or(self.origin.span.len(), str::len);
        self.part(self.origin.span.start..self.origin.span.start + length).origin
    }

    /// The fields of `Name(a: .., b: ..)` or `(a: .., b: ..)`. With `name`, another name is a fault; a field that is
    /// not `known` is one too, and is left out.
    pub fn as_struct(&self, name: Option<&str>, known: &[&str], faults: &mut Faults) -> Vec<(Key, Raw)> {
        if let (Some(wanted), Some(got)) = (name, self.variant())
            && wanted != got
        {
            faults.push(|| Fault::at(&self.variant_origin(), format!("wanted `{wanted}(..)`, got `{got}`")));
            return Vec::new();
        }
        let what = name.map_or("`(field: value, ..)`".to_owned(), |name| format!("`{name}(field: value, ..)`"));
        let mut fields = self.fields(&what, faults);
        fields.retain(|(key, _)| {
            let is_known = known.contains(&key.name.as_str());
            if !is_known {
                faults.push(|| {
                    let fault = Fault::at(&key.origin, format!("unknown field `{}`", key.name));
                    fault.suggest(&key.name, known.iter().copied())
                });
            }
            is_known
        });
        fields
    }

    /// The fields of `Name(a: .., b: ..)`, whatever they are called; none for a mere `Name`.
    pub(super) fn fields(&self, what: &str, faults: &mut Faults) -> Vec<(Key, Raw)> {
        if self.variant().is_some_and(|v| v.len() == self.text().len()) {
            return Vec::new();
        }
        let mut fields = Vec::new();
        for item in self.items('(', what, faults).unwrap_or_default() {
            match item.split_key() {
                Some((key, value)) if is_word(key.text()) => {
                    fields.push((Key { name: key.text().to_owned(), origin: key.origin }, value));
                }
                _ => faults.push(|| item.fault(format!("wanted {what}, got `{}`", item.short()))),
            }
        }
        fields
    }

    /// The entries of `{ "name": value, .. }`.
    pub fn as_map(&self, faults: &mut Faults) -> Vec<(Key, Raw)> {
        let what = "`{ \"name\": value, .. }`";
        let mut entries = Vec::new();
        for item in self.items('{', what, faults).unwrap_or_default() {
            match item.split_key().map(|(key, value)| (key.string(), key, value)) {
                Some((Some(name), key, value)) => entries.push((Key { name, origin: key.origin }, value)),
                _ => faults.push(|| item.fault(format!("wanted {what}, got `{}`", item.short()))),
            }
        }
        entries
    }

    /// The items of `[a, b, ..]`.
    pub fn as_list(&self, faults: &mut Faults) -> Vec<Raw> {
        self.items('[', "a list `[..]`", faults).unwrap_or_default()
    }

    /// The items of `(a, b, ..)` or `Name(a, b, ..)`.
    pub fn as_tuple(&self, faults: &mut Faults) -> Vec<Raw> {
        self.items('(', "`(a, b, ..)`", faults).unwrap_or_default()
    }

    /// The value as `T`; the fault points at the place inside.
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, Fault> {
        from_ron(self.text()).map_err(|e| self.locate(e))
    }

    /// A string with its place: how names stand in files. `None` left a fault.
    pub fn as_key(&self, faults: &mut Faults) -> Option<Key> {
        let name = self.string();
        if name.is_none() {
            faults.push(|| self.fault(format!("wanted a name in quotes, got `{}`", self.short())));
        }
        Some(Key { name: name?, origin: self.origin.clone() })
    }

    /// The value of a string, `None` for anything else.
    pub fn string(&self) -> Option<String> {
        let text = self.text();
        let plain = text.strip_prefix('"').and_then(|text| text.strip_suffix('"'));
        match plain.filter(|text| !text.contains(['"', '\\'])) {
            Some(plain) => Some(plain.to_owned()),
            None => text.contains('"').then(|| from_ron(text).ok())?,
        }
    }

    /// Turns RON's own error, whose position counts from the start of this value, into a fault at its token.
    pub(super) fn locate(&self, error: ron::error::SpannedError) -> Fault {
        let text = self.text();
        let start = error.span.start;
        let line = text.split_inclusive('\n').take(start.line.saturating_sub(1)).map(str::len).sum::<usize>();
        let column = text[line..].char_indices().nth(start.col.saturating_sub(1)).map_or(text.len(), |(i, _)| line + i);
        let before = tokens(text).map_while(Result::ok).take_while(|token| token.span.start <= column);
        let token = before.last().map_or(0..text.len(), |token| token.span);
        let base = self.origin.span.start;
        self.part(base + token.start..base + token.end).fault(error.code.to_string())
    }

    /// The beginning of the text, for messages.
    pub fn short(&self) -> String {
        let line = self.text().lines().next().unwrap_or_default();
        let short: String = line.chars().take(40).collect();
        if short.len() < self.text().len() { format!("{short}..") } else { short }
    }

    fn part(&self, span: Range<usize>) -> Raw {
        Raw { origin: Origin { source: self.origin.source.clone(), span } }
    }

    fn tokens(&self, faults: &mut Faults) -> Option<Vec<Token>> {
        let base = self.origin.span.start;
        let tokens: Result<Vec<Token>, _> = tokens(self.text()).collect();
        tokens
            .map_err(|(span, message)| faults.push(|| self.part(base + span.start..base + span.end).fault(message)))
            .ok()
    }

    /// The comma-separated items between the brackets that begin with `open`, after an optional identifier.
    fn items(&self, open: char, wanted: &str, faults: &mut Faults) -> Option<Vec<Raw>> {
        let tokens = self.tokens(faults)?;
        let skip = usize::from(open == '(' && tokens.first().is_some_and(|t| t.kind == Kind::Ident));
        if tokens.get(skip).map(|t| t.kind) != Some(Kind::Open(open)) {
            faults.push(|| {
                let fault = self.fault(format!("wanted {wanted}, got `{}`", self.short()));
                let attribute = self.text().starts_with("#!");
                if attribute { fault.help("leave `#![enable(..)]` out") } else { fault }
            });
            return None;
        }
        let base = self.origin.span.start;
        let mut items = Vec::new();
        let mut begin: Option<usize> = None;
        let (mut end, mut depth) = (0, 0);
        for (index, token) in tokens.iter().enumerate().skip(skip) {
            let closes = matches!(token.kind, Kind::Close(_)) && depth == 1;
            if closes || (token.kind == Kind::Comma && depth == 1) {
                match begin.take() {
                    Some(from) => items.push(self.part(base + from..base + end)),
                    None if !closes => {
                        let place = base + token.span.start..base + token.span.end;
                        faults.push(|| self.part(place).fault("wanted a value, got a comma"));
                    }
                    None => {}
                }
            } else if depth >= 1 {
                begin.get_or_insert(token.span.start);
            }
            match token.kind {
                Kind::Open(_) => depth += 1,
                Kind::Close(_) => depth -= 1,
                _ => {}
            }
            end = token.span.end;
            if depth == 0 {
                if let Some(extra) = tokens.get(index + 1) {
                    let place = base + extra.span.start..base + extra.span.end;
                    faults.push(|| self.part(place).fault(format!("wanted nothing more after {wanted}")));
                }
                break;
            }
        }
        Some(items)
    }

    /// `key: value`.
    fn split_key(&self) -> Option<(Raw, Raw)> {
        let base = self.origin.span.start;
        let (mut depth, mut key_end) = (0, None);
        let mut tokens = tokens(self.text()).map_while(Result::ok);
        while let Some(token) = tokens.next() {
            match token.kind {
                Kind::Open(_) => depth += 1,
                Kind::Close(_) => depth -= 1,
                Kind::Colon if depth == 0 => {
                    let value = tokens.next()?.span.start;
                    return Some((self.part(base..base + key_end?), self.part(base + value..self.origin.span.end)));
                }
                _ => {}
            }
            key_end = Some(token.span.end);
        }
        None
    }
}

/// Brackets match and stay shallow; whether the text may be split.
fn check_nesting(whole: &Raw, tokens: &[Token], faults: &mut Faults) -> bool {
    let mut open: Vec<(char, &Token)> = Vec::new();
    for token in tokens {
        match token.kind {
            Kind::Open(bracket) if open.len() == MAX_DEPTH => {
                let message = format!("wanted at most {MAX_DEPTH} levels of brackets, got another `{bracket}`");
                faults.push(|| whole.part(token.span.clone()).fault(message));
                return false;
            }
            Kind::Open(bracket) => open.push((bracket, token)),
            Kind::Close(bracket) => match open.pop() {
                Some((opened, _)) if closing(opened) == bracket => {}
                Some((opened, at)) => {
                    let (line, _) = whole.part(at.span.clone()).origin.line_column();
                    let message =
                        format!("wanted `{}` for the `{opened}` of line {line}, got `{bracket}`", closing(opened));
                    faults.push(|| whole.part(token.span.clone()).fault(message));
                    return false;
                }
                None => {
                    faults.push(|| whole.part(token.span.clone()).fault(format!("`{bracket}` closes nothing")));
                    return false;
                }
            },
            _ => {}
        }
    }
    let Some((bracket, token)) = open.pop() else { return true };
    faults.push(|| whole.part(token.span.clone()).fault(format!("`{bracket}` is never closed")));
    false
}

fn closing(open: char) -> char {
    match open {
        '(' => ')',
        '[' => ']',
        _ => '}',
    }
}

/// No number that is not finite, no key twice in the same brackets.
fn check_values(whole: &Raw, tokens: &[Token], faults: &mut Faults) {
    let text = whole.text();
    // Of the brackets that are open: the keys so far, and the first token of an entry whose key has not ended.
    let mut open: Vec<(BTreeSet<String>, Option<usize>)> = vec![(BTreeSet::new(), Some(0))];
    for (index, token) in tokens.iter().enumerate() {
        let part = || whole.part(token.span.clone());
        match (token.kind, open.last_mut()) {
            (Kind::Open(_), _) => {
                if open.len() > MAX_DEPTH {
                    return; // that is told already
                }
                open.push((BTreeSet::new(), Some(index + 1)));
            }
            (Kind::Close(_), _) => drop(open.pop()),
            (Kind::Comma, Some((_, entry))) => *entry = Some(index + 1),
            (Kind::Colon, Some((keys, entry))) => {
                let Some(first) = entry.take().filter(|first| *first < index) else { continue };
                let key = whole.part(tokens[first].span.start..tokens[index - 1].span.end);
                let name = key.string().unwrap_or_else(|| key.text().to_owned());
                if keys.contains(&name) {
                    faults.push(|| key.fault(format!("`{name}` is given twice")));
                } else {
                    keys.insert(name);
                }
            }
            (Kind::Ident, _) if is_not_finite(&text[token.span.clone()]) => {
                faults.push(|| part().fault(format!("wanted a finite number, got {}", &text[token.span.clone()])));
            }
            (Kind::Number, _) => {
                let number = text[token.span.clone()].replace('_', "");
                let number = number.trim_end_matches("f32").trim_end_matches("f64");
                if number.parse::<f64>().is_ok_and(f64::is_infinite) {
                    faults.push(|| part().fault(format!("wanted a finite number, got {number}")));
                }
            }
            _ => {}
        }
    }
}

fn is_not_finite(word: &str) -> bool {
    matches!(word, "inf" | "inff32" | "inff64" | "NaN" | "NaNf32" | "NaNf64")
}

/// Whether a value written by [`super::to_ron`] holds a number that is not finite.
pub(super) fn holds_non_finite(ron: &str) -> bool {
    let mut tokens = tokens(ron).map_while(Result::ok);
    tokens.any(|token| token.kind == Kind::Ident && is_not_finite(&ron[token.span]))
}
