//! Marks between values: the commas, colons and quotes that a file lacks, and characters that mean
//! nothing in it.

use std::sync::Arc;

use crate::graph::diagnostics::Diagnostics;
use crate::graph::lexer::{Kind, Token};
use crate::graph::source::{Diagnostic, Origin, Source};

/// Suffixes of numbers that RON knows.
const SUFFIXES: [&str; 12] =
    ["f32", "f64", "i8", "i16", "i32", "i64", "i128", "u8", "u16", "u32", "u64", "u128"];

/// Checks each token of a whole text and what stands between two of them; `false` left a fault.
pub(in crate::graph) fn check(
    source: &Arc<Source>,
    tokens: &[Token],
    faults: &mut Diagnostics,
) -> bool {
    let before = faults.found();
    let text = |token: &Token| &source.text[token.span.clone()];
    // For each open bracket: the bracket, and whether the entry so far has a colon.
    let mut open: Vec<(char, bool)> = Vec::new();
    // The rest of a broken text or of a wrong comment means nothing by itself.
    let mut skip_to = 0;
    for (at, token) in tokens.iter().enumerate() {
        if token.span.start < skip_to {
            continue;
        }
        let fault = |message: String| {
            Diagnostic::at(&Origin { source: source.clone(), span: token.span.clone() }, message)
        };
        let last = at.checked_sub(1).map(|last| &tokens[last]);
        let mark = last.zip(open.last()).and_then(|(last, o)| missing(last, token, *o, text));
        if let Some(mark) = mark {
            faults.push(|| fault(format!("wanted `{mark}` before `{}`, got none", text(token))));
        }
        match token.kind {
            Kind::Open(bracket) => open.push((bracket, false)),
            Kind::Close(_) => drop(open.pop()),
            Kind::Comma | Kind::Colon => {
                open.last_mut().into_iter().for_each(|o| o.1 = token.kind == Kind::Colon);
            }
            Kind::Quoted if text(token).starts_with('\'') => faults.push(|| {
                let inner = text(token).trim_matches('\'');
                fault(format!("wanted double quotes, got `{}`", text(token)))
                    .help(format!("write \"{inner}\""))
            }),
            Kind::Number if !is_number(text(token)) => faults.push(|| {
                let fault = fault(format!("wanted a number, got `{}`", text(token)));
                let number = leading_number(text(token));
                number.into_iter().fold(fault, |fault, number| {
                    fault.help(format!("write the number alone, without a unit: `{number}`"))
                })
            }),
            Kind::Other => {
                let rest = &source.text[token.span.start..];
                if rest.starts_with("#!") || (open.is_empty() && rest.starts_with('=')) {
                    break; // whoever reads the fields has a better message
                }
                let unsigned = rest.trim_start_matches(['-', '+']);
                if unsigned.starts_with("inf") || unsigned.starts_with("NaN") {
                    continue; // a check of its own names a number that is not finite
                }
                let line = rest.find(['\n', ',']).unwrap_or(rest.len());
                let is_text = is_quote(rest) || rest.starts_with('#');
                skip_to = token.span.start + if is_text { line } else { 1 };
                faults.push(|| {
                    let (wanted, help) = meaning(rest);
                    fault(format!("{wanted}, got `{}`", text(token))).help(help)
                });
            }
            _ => {}
        }
    }
    faults.found() == before
}

/// The mark that is missing between two tokens in brackets.
fn missing<'a>(
    last: &Token,
    token: &Token,
    (bracket, colon): (char, bool),
    text: impl Fn(&Token) -> &'a str,
) -> Option<char> {
    let ends = matches!(last.kind, Kind::Number | Kind::Quoted | Kind::Ident | Kind::Close(_));
    let begins = matches!(token.kind, Kind::Number | Kind::Quoted | Kind::Ident | Kind::Open(_));
    let is_call = last.kind == Kind::Ident && token.kind == Kind::Open('(');
    if !ends || !begins || is_call {
        return None;
    }
    let is_name = match bracket {
        '{' => last.kind == Kind::Quoted,
        '(' => last.kind == Kind::Ident && text(last).starts_with(char::is_lowercase),
        _ => false,
    };
    Some(if is_name && !colon { ':' } else { ',' })
}

/// Whether a token that begins as a number is one.
fn is_number(text: &str) -> bool {
    let digits = text.replace('_', "");
    let plain = SUFFIXES.iter().find_map(|suffix| digits.strip_suffix(suffix)).unwrap_or(&digits);
    let based = plain.trim_start_matches(['+', '-']);
    let in_base = |prefix: &str, base: u32| {
        based.strip_prefix(prefix).is_some_and(|d| d.chars().all(|c| c.is_digit(base)))
    };
    plain.parse::<f64>().is_ok() || in_base("0x", 16) || in_base("0o", 8) || in_base("0b", 2)
}

/// The number that `2700K` begins with.
fn leading_number(text: &str) -> Option<&str> {
    let end = text.find(|c: char| !matches!(c, '0'..='9' | '.' | '-' | '+')).unwrap_or(text.len());
    let number = text[..end].trim_end_matches('.');
    number.parse::<f64>().is_ok().then_some(number)
}

fn is_quote(text: &str) -> bool {
    text.starts_with(['“', '”', '„', '‟', '«', '»', '‘', '’', '‚', '`', '´'])
}

/// The wanted mark in the place of a character that means nothing, and the remedy.
fn meaning(text: &str) -> (&'static str, String) {
    let hex = text.chars().skip(1).take_while(char::is_ascii_hexdigit).count();
    let found = text.chars().next().unwrap_or(' ');
    let (wanted, help) = match found {
        '=' => ("wanted `:` between a name and its value", "write `name: value`"),
        ';' => ("wanted `,` between values", "write `,`"),
        '%' => ("wanted a number without a unit", "write a fraction: `0.5` for 50 %"),
        '°' => ("wanted a number without a unit", "write the number alone; angles are in degrees"),
        '#' if hex == 6 || hex == 3 => {
            let color = &text[..=hex];
            let help =
                format!("write \"{color}\" where a text is wanted, else three numbers from 0");
            return ("wanted a color in quotes", help);
        }
        '#' => ("wanted a comment that begins with `//`", "write `// ..`"),
        '–' | '—' | '−' => ("wanted the minus sign of the keyboard", "write `-`"),
        '/' | '*' | '+' => ("wanted a number, not a calculation", "write its result"),
        '\\' | '.' => {
            ("wanted a text in quotes", "names of files have quotes: \"folder/file.png\"")
        }
        _ if is_quote(text) => (
            "wanted straight quotes `\"`",
            "write `\"`; word processors put curved quotes in its place",
        ),
        _ => ("wanted a value, a name, a comma or a bracket", "delete it"),
    };
    (wanted, help.to_owned())
}
