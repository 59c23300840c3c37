//! Text from strangers made safe to show.

use std::borrow::Cow;
use std::fmt::Write;

/// The text with control characters and bidirectional formatting characters written as `\u{..}`;
/// line ends and tabs stay.
///
/// A terminal acts on control characters (ECMA-48), and bidirectional formatting characters change
/// the order in which a line is shown (Unicode Standard Annex 9; Boucher and Anderson, "Trojan
/// Source", 2021). File names, names in files and text of networks reach a person only through this
/// function.
pub fn escape(text: &str) -> Cow<'_, str> {
    if !text.contains(is_hostile) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match c {
            c if is_hostile(c) => {
                write!(out, "\\u{{{:x}}}", u32::from(c)).expect("writing to a string")
            }
            c => out.push(c),
        }
    }
    Cow::Owned(out)
}

/// [`escape`] for text that is part of one line: line ends and tabs become spaces.
pub fn escape_line(text: &str) -> String {
    escape(text).replace(['\n', '\t'], " ")
}

/// The text for XML and HTML, in attributes too; control characters but the line end become U+FFFD.
pub fn escape_markup(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c if c.is_control() && c != '\n' => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// JSON in which the characters that [`escape`] writes by number are written so by JSON's own
/// rules.
pub fn escape_json(json: &str) -> String {
    let mut out = String::with_capacity(json.len());
    for c in json.chars() {
        match c {
            // All of them lie in the basic plane, and JSON has them within strings only.
            c if is_hostile(c) => {
                write!(out, "\\u{:04x}", u32::from(c)).expect("writing to a string")
            }
            c => out.push(c),
        }
    }
    out
}

fn is_hostile(c: char) -> bool {
    (c.is_control() && !matches!(c, '\n' | '\t'))
        || is_bidirectional(c)
        || matches!(c, '\u{2028}' | '\u{2029}')
}

/// Embeddings, overrides, isolates and marks of direction.
fn is_bidirectional(c: char) -> bool {
    matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_and_bidirectional_characters_become_their_numbers() {
        assert_eq!(escape("größe 部屋\nsecond line"), "größe 部屋\nsecond line");
        assert_eq!(
            escape("a\u{1b}[31mb\u{9b}2Jc\rd\u{7f}\te"),
            "a\\u{1b}[31mb\\u{9b}2Jc\\u{d}d\\u{7f}\te"
        );
        assert_eq!(
            escape("lamp\u{202e}gnp.\u{2066}x\u{200f}"),
            "lamp\\u{202e}gnp.\\u{2066}x\\u{200f}"
        );
        assert_eq!(escape_line("a\nb\u{7}"), "a b\\u{7}");
        assert_eq!(escape_json("{\n \"a\u{202e}\u{9b}é\": 1}"), "{\n \"a\\u202e\\u009bé\": 1}");
    }
}
