//! RON cut into tokens: enough to find keys, values and brackets; the values themselves are left to
//! the `ron` crate.

use std::ops::Range;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Open(char),
    Close(char),
    Comma,
    Colon,
    Ident,
    Number,
    /// A string, byte string or character.
    Quoted,
    Other,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Token {
    pub kind: Kind,
    pub span: Range<usize>,
}

/// The tokens of `text` one after the other, comments left out; last the place and kind of a text
/// that is never closed, if there is one. The lexer reads nothing behind the last requested token.
pub(super) fn tokens(text: &str) -> Tokens<'_> {
    Tokens { text, at: 0 }
}

#[derive(Clone)]
pub(super) struct Tokens<'a> {
    text: &'a str,
    at: usize,
}

impl Iterator for Tokens<'_> {
    type Item = Result<Token, (Range<usize>, String)>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let (text, at) = (self.text, self.at);
            let rest = &text[at..];
            let c = rest.chars().next()?;
            let mut never_closed = |length: usize, what: &str| {
                self.at = text.len();
                Some(Err((at..at + length, format!("this {what} is never closed"))))
            };
            if c.is_whitespace() {
                self.at += c.len_utf8();
                continue;
            }
            if rest.starts_with("//") {
                self.at += rest.find('\n').unwrap_or(rest.len());
                continue;
            }
            if rest.starts_with("/*") {
                let Some(length) = comment(rest) else { return never_closed(2, "comment") };
                self.at += length;
                continue;
            }
            let (kind, length) = match c {
                '(' | '[' | '{' => (Kind::Open(c), 1),
                ')' | ']' | '}' => (Kind::Close(c), 1),
                ',' => (Kind::Comma, 1),
                ':' => (Kind::Colon, 1),
                _ => match quoted(rest) {
                    Some(Some(length)) => (Kind::Quoted, length),
                    Some(None) => return never_closed(1, "text"),
                    None if is_number(rest) => (Kind::Number, number(rest)),
                    None if c.is_alphabetic() || c == '_' => (Kind::Ident, word(rest)),
                    None => (Kind::Other, c.len_utf8()),
                },
            };
            self.at += length;
            return Some(Ok(Token { kind, span: at..self.at }));
        }
    }
}

/// Length of a nested block comment.
fn comment(text: &str) -> Option<usize> {
    let bytes = text.as_bytes();
    let (mut depth, mut at) = (0usize, 0);
    while at + 1 < bytes.len() {
        match &bytes[at..at + 2] {
            b"/*" => (depth, at) = (depth + 1, at + 2),
            b"*/" => (depth, at) = (depth - 1, at + 2),
            _ => at += 1,
        }
        if depth == 0 {
            return Some(at);
        }
    }
    None
}

/// Length of the string or character that `text` begins with; `Some(None)` when it is not
/// terminated.
fn quoted(text: &str) -> Option<Option<usize>> {
    let prefix = if text.starts_with("br") { 2 } else { usize::from(text.starts_with(['b', 'r'])) };
    let raw = text[..prefix].contains('r');
    let body = &text[prefix..];
    let hashes = if raw { body.len() - body.trim_start_matches('#').len() } else { 0 };
    let body = &body[hashes..];
    if raw && body.starts_with('"') {
        let end = format!("\"{}", "#".repeat(hashes));
        return Some(body[1..].find(&end).map(|i| prefix + hashes + 1 + i + end.len()));
    }
    let quote = body.chars().next().filter(|&c| !raw && (c == '"' || c == '\''))?;
    let mut escaped = false;
    for (i, c) in body.char_indices().skip(1) {
        if !escaped && c == quote {
            return Some(Some(prefix + i + 1));
        }
        escaped = !escaped && c == '\\';
    }
    Some(None)
}

fn is_number(text: &str) -> bool {
    let body = text.strip_prefix(['+', '-']).unwrap_or(text);
    let body = body.strip_prefix('.').unwrap_or(body);
    body.starts_with(|c: char| c.is_ascii_digit())
}

fn number(text: &str) -> usize {
    let hexadecimal = text.trim_start_matches(['+', '-']).starts_with("0x");
    let mut previous = ' ';
    for (i, c) in text.char_indices() {
        let sign =
            (c == '+' || c == '-') && (i == 0 || (!hexadecimal && matches!(previous, 'e' | 'E')));
        if !(sign || c.is_ascii_alphanumeric() || c == '_' || c == '.') {
            return i;
        }
        previous = c;
    }
    text.len()
}

fn word(text: &str) -> usize {
    text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len())
}
