//! RON texts, cut into raw entries that keep their locations.
//!
//! `serde` alone stops at the first fault and forgets places. Here a text is checked and split
//! first, and each piece is parsed by itself, so that all faults of a file show in one pass, each
//! with its own caret.

use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::Arc;

use serde::de::DeserializeOwned;

use super::diagnostics::Diagnostics;
use super::form::syntax;
use super::from_ron;
use super::lexer::{Kind, Token, tokens};
use super::source::{Diagnostic, Origin, Source};

/// RON's own parser recurses; beyond this depth a text is refused before it gets there.
const MAX_DEPTH: usize = 64;

/// Whether `text` is a field name.
fn is_word(text: &str) -> bool {
    text.starts_with(|c: char| c.is_alphabetic() || c == '_')
        && text.chars().all(|c| c.is_alphanumeric() || c == '_')
}

/// The name of an entry, and its location.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Key {
    /// The name.
    pub name: String,
    /// Its location in the file.
    pub origin: Origin,
}

/// A RON value still as text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Raw {
    /// The location of the value, which contains its text.
    pub origin: Origin,
}

impl Raw {
    /// The one value of a whole text, after checking all of it: brackets, nesting, no duplicate
    /// key, no NaN, no infinite number. `None` when it cannot be split.
    pub fn document(source: &Arc<Source>, faults: &mut Diagnostics) -> Option<Raw> {
        let whole = Raw { origin: Origin { source: source.clone(), span: 0..source.text.len() } };
        let tokens = whole.tokens(faults)?;
        let sound = check_nesting(&whole, &tokens, faults);
        let sound = syntax::check(source, &tokens, faults) && sound;
        if sound {
            check_values(&whole, &tokens, faults);
        }
        let (first, last) = (tokens.first(), tokens.last());
        let Some((first, last)) = first.zip(last) else {
            faults.push(|| Diagnostic::file(&source.path, "wanted a RON value, got an empty file"));
            return None;
        };
        sound.then(|| whole.part(first.span.start..last.span.end))
    }

    /// Returns the text of the value.
    pub fn text(&self) -> &str {
        self.origin.text()
    }

    /// Creates a fault at this value.
    pub fn fault(&self, message: impl Into<String>) -> Diagnostic {
        Diagnostic::at(&self.origin, message)
    }

    /// The identifier that the value begins with: `Lamp` of `Lamp(radius: 1)`, `Off` of `Off`.
    pub fn variant(&self) -> Option<&str> {
        let first = tokens(self.text()).next()?.ok()?;
        (first.kind == Kind::Ident).then(|| &self.text()[first.span])
    }

    /// Every word, number, text and bracket of the value, in order, and whether it is a number;
    /// comments are left out.
    pub fn words(&self) -> Vec<(Raw, bool)> {
        let base = self.origin.span.start;
        let word =
            |t: Token| (self.part(base + t.span.start..base + t.span.end), t.kind == Kind::Number);
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

    /// The fields of `Name(a: .., b: ..)` or `(a: .., b: ..)`. With `name`, another name is a
    /// fault; a field that is not `known` is one too, and is left out.
    pub fn as_struct(
        &self,
        name: Option<&str>,
        known: &[&str],
        faults: &mut Diagnostics,
    ) -> Vec<(Key, Raw)> {
        if let (Some(wanted), Some(got)) = (name, self.variant())
            && wanted != got
        {
            faults.push(|| {
                let message = format!("wanted `{wanted}(..)`, got `{got}`");
                Diagnostic::at(&self.variant_origin(), message).help(mistaken(wanted, got))
            });
            return Vec::new();
        }
        if let Some(wanted) = name
            && !self.text().starts_with(['(', '#'])
            && self.variant().is_none()
        {
            faults.push(|| {
                let message = format!("wanted `{wanted}(..)`, got `{}`", self.short());
                self.part(self.origin.span.start..self.origin.span.start + 1)
                    .fault(message)
                    .help(mistaken(wanted, self.text()))
            });
            return Vec::new();
        }
        let what = match name {
            Some(name) => format!("`{name}(field: value, ..)`"),
            None => format!("`({}: ..)` or a part of it", known.join(": .., ")),
        };
        let mut fields = self.fields(&what, faults);
        fields.retain(|(key, _)| {
            let is_known = known.contains(&key.name.as_str());
            if !is_known {
                faults.push(|| {
                    let fault =
                        Diagnostic::at(&key.origin, format!("unknown field `{}`", key.name));
                    fault.suggest(&key.name, known.iter().copied())
                });
            }
            is_known
        });
        fields
    }

    /// The fields of `Name(a: .., b: ..)`, for any name; none for a mere `Name`.
    pub(super) fn fields(&self, what: &str, faults: &mut Diagnostics) -> Vec<(Key, Raw)> {
        if self.variant().is_some_and(|v| v.len() == self.text().len()) {
            return Vec::new();
        }
        let mut fields: Vec<(Key, Raw)> = Vec::new();
        for item in self.items('(', what, faults).unwrap_or_default() {
            match item.split_key() {
                Some((key, value)) if is_word(key.text()) => {
                    fields.push((Key { name: key.text().to_owned(), origin: key.origin }, value));
                }
                _ => faults.push(|| {
                    let fault = item.fault(format!("wanted {what}, got `{}`", item.short()));
                    let last = fields.last();
                    let comma = last.and_then(|(_, last)| last.decimal_comma(&item));
                    comma.into_iter().fold(fault, Diagnostic::help)
                }),
            }
        }
        fields
    }

    /// The entries of `{ "name": value, .. }`.
    pub fn as_map(&self, faults: &mut Diagnostics) -> Vec<(Key, Raw)> {
        let what = "`{ \"name\": value, .. }`";
        let mut entries = Vec::new();
        for item in self.items('{', what, faults).unwrap_or_default() {
            match item.split_key().map(|(key, value)| (key.string(), key, value)) {
                Some((Some(name), key, value)) => {
                    entries.push((Key { name, origin: key.origin }, value))
                }
                Some((None, key, _)) if is_word(key.text()) => faults.push(|| {
                    key.fault(format!("wanted a name in quotes, got `{}`", key.text()))
                        .help(format!("write \"{}\"", key.text()))
                }),
                _ => faults.push(|| item.fault(format!("wanted {what}, got `{}`", item.short()))),
            }
        }
        entries
    }

    /// The items of `[a, b, ..]`.
    pub fn as_list(&self, faults: &mut Diagnostics) -> Vec<Raw> {
        self.items('[', "a list `[..]`", faults).unwrap_or_default()
    }

    /// The items of `(a, b, ..)` or `Name(a, b, ..)`.
    pub fn as_tuple(&self, faults: &mut Diagnostics) -> Vec<Raw> {
        self.items('(', "`(a, b, ..)`", faults).unwrap_or_default()
    }

    /// The value as `T`; `None` where it is another.
    pub fn parse<T: DeserializeOwned>(&self) -> Option<T> {
        from_ron(self.text()).ok()
    }

    /// The one item of `(a)` or `Name(a)`; `None` for several, and for a field `(name: a)`.
    pub(super) fn only_item(&self) -> Option<Raw> {
        let mut items = self.as_tuple(&mut Diagnostics::ignored());
        items.pop().filter(|item| items.is_empty() && item.split_key().is_none())
    }

    /// The likely meaning of two values that a comma separates, `1,5` in the place of `1.5`.
    pub(super) fn decimal_comma(&self, next: &Raw) -> Option<String> {
        let (head, tail) = (self.text(), next.text());
        let start = head.rfind(|c: char| !c.is_ascii_digit()).map_or(0, |at| at + 1);
        let is_digits = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
        let touch = self.origin.span.end + 1 == next.origin.span.start;
        let both = touch && is_digits(&head[start..]) && is_digits(tail);
        both.then(|| format!("a decimal comma? Write `{}.{tail}`", &head[start..]))
    }

    /// A string with its location, such as a name in a file. `None` left a fault.
    pub fn as_key(&self, faults: &mut Diagnostics) -> Option<Key> {
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

    /// The beginning of the text, for messages.
    pub fn short(&self) -> String {
        let line = self.text().lines().next().unwrap_or_default();
        let short: String = line.chars().take(40).collect();
        if short.len() < self.text().len() { format!("{short}..") } else { short }
    }

    fn part(&self, span: Range<usize>) -> Raw {
        Raw { origin: Origin { source: self.origin.source.clone(), span } }
    }

    fn tokens(&self, faults: &mut Diagnostics) -> Option<Vec<Token>> {
        let base = self.origin.span.start;
        let tokens: Result<Vec<Token>, _> = tokens(self.text()).collect();
        tokens
            .map_err(|(span, message)| {
                faults.push(|| self.part(base + span.start..base + span.end).fault(message))
            })
            .ok()
    }

    /// The comma-separated items between the brackets that begin with `open`, after an optional
    /// identifier.
    fn items(&self, open: char, wanted: &str, faults: &mut Diagnostics) -> Option<Vec<Raw>> {
        let tokens = self.tokens(faults)?;
        let skip =
            usize::from(open == '(' && tokens.first().is_some_and(|t| t.kind == Kind::Ident));
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
                    faults.push(|| {
                        self.part(place).fault(format!("wanted nothing more after {wanted}"))
                    });
                }
                break;
            }
        }
        Some(items)
    }

    /// `key: value`.
    pub(super) fn split_key(&self) -> Option<(Raw, Raw)> {
        let base = self.origin.span.start;
        let (mut depth, mut key_end) = (0, None);
        let mut tokens = tokens(self.text()).map_while(Result::ok);
        while let Some(token) = tokens.next() {
            match token.kind {
                Kind::Open(_) => depth += 1,
                Kind::Close(_) => depth -= 1,
                Kind::Colon if depth == 0 => {
                    let value = tokens.next()?.span.start;
                    return Some((
                        self.part(base..base + key_end?),
                        self.part(base + value..self.origin.span.end),
                    ));
                }
                _ => {}
            }
            key_end = Some(token.span.end);
        }
        None
    }
}

/// The likely mistake where a file begins with `got` instead of `wanted`.
fn mistaken(wanted: &str, got: &str) -> String {
    let near = super::source::nearest(got, [wanted]).filter(|_| is_word(got));
    match (wanted, got) {
        ("Graph", "Edit") | ("Edit", "Graph") => {
            "GRAPH and EDIT swapped? The graph comes first: `relight run GRAPH EDIT`".to_owned()
        }
        ("Graph" | "Edit", "Scene") => {
            "this is a scene: name its folder with `--scene DIR`".to_owned()
        }
        ("Scene", "Graph" | "Edit") => {
            format!("this is a file for the command line: {}", got.to_uppercase())
        }
        _ if near.is_some() => format!("did you mean `{wanted}`?"),
        _ if got.starts_with(['{', '[']) => format!(
            "JSON? A file here begins with `{wanted}(version: 1,`: fields stand in parentheses, and \
             their names have no quotes"
        ),
        _ => format!(
            "a file begins with `{wanted}(version: 1,` and ends with `)`; JSON, YAML and TOML are \
             not read"
        ),
    }
}

/// Brackets match and stay shallow; whether the text may be split.
fn check_nesting(whole: &Raw, tokens: &[Token], faults: &mut Diagnostics) -> bool {
    let mut open: Vec<(char, &Token)> = Vec::new();
    for token in tokens {
        match token.kind {
            Kind::Open(bracket) if open.len() == MAX_DEPTH => {
                let message = format!(
                    "wanted at most {MAX_DEPTH} levels of brackets, got another `{bracket}`"
                );
                faults.push(|| whole.part(token.span.clone()).fault(message));
                return false;
            }
            Kind::Open(bracket) => open.push((bracket, token)),
            Kind::Close(bracket) => match open.pop() {
                Some((opened, _)) if closing(opened) == bracket => {}
                Some((opened, at)) => {
                    let (line, _) = whole.part(at.span.clone()).origin.line_column();
                    let message = format!(
                        "wanted `{}` for the `{opened}` of line {line}, got `{bracket}`",
                        closing(opened)
                    );
                    faults.push(|| whole.part(token.span.clone()).fault(message));
                    return false;
                }
                None => {
                    faults.push(|| {
                        whole.part(token.span.clone()).fault(format!("`{bracket}` closes nothing"))
                    });
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
fn check_values(whole: &Raw, tokens: &[Token], faults: &mut Diagnostics) {
    let text = whole.text();
    // For each open bracket: the keys so far, and the first token of an entry whose key has not
    // ended.
    let mut open: Vec<(BTreeSet<String>, Option<usize>)> = vec![(BTreeSet::new(), Some(0))];
    for (index, token) in tokens.iter().enumerate() {
        let part = || whole.part(token.span.clone());
        match (token.kind, open.last_mut()) {
            (Kind::Open(_), _) => {
                if open.len() > MAX_DEPTH {
                    return; // reported by `check_nesting`
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
                faults.push(|| {
                    part()
                        .fault(format!("wanted a finite number, got {}", &text[token.span.clone()]))
                });
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
