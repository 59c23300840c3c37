//! Draws faults: file:line:column, the line, a caret under the place, and help.

use std::ops::Range;

use codespan_reporting::diagnostic::{self, Label};
use codespan_reporting::files::{Error, Files};
use codespan_reporting::term::{self, Chars, Config, termcolor::Buffer};

use crate::graph::{Diagnostic, Origin, escape, escape_line};

/// Characters of a source line that are shown on each side of the place.
const CONTEXT: usize = 60;
/// Characters of the place itself that are underlined.
const WIDEST: usize = 40;
/// Characters of a message, which may quote what a person wrote.
const LONGEST: usize = 600;

/// All faults as text, in the order given; with colors and box drawing on a terminal, plain ASCII
/// elsewhere.
#[expect(clippy::missing_panics_doc, reason = "a string takes all text")]
pub fn draw(faults: &[Diagnostic], terminal: bool) -> String {
    let mut buffer = if terminal { Buffer::ansi() } else { Buffer::no_color() };
    let chars = if terminal { Chars::box_drawing() } else { Chars::ascii() };
    let config = Config { chars, tab_width: 1, ..Config::default() };
    for fault in faults {
        let excerpt = fault.origin.as_ref().map(Excerpt::of).unwrap_or_default();
        let mut diagnostic = diagnostic::Diagnostic::error();
        if fault.origin.is_some() {
            diagnostic = diagnostic
                .with_message(printable(&fault.message))
                .with_label(Label::primary((), excerpt.place.clone()));
        } else {
            let path = escape_line(&fault.path.display().to_string());
            let message = if path.is_empty() {
                fault.message.clone()
            } else {
                format!("{path}: {}", fault.message)
            };
            diagnostic = diagnostic.with_message(printable(&message));
        }
        diagnostic.notes =
            fault.help.iter().map(|help| format!("help: {}", printable(help))).collect();
        term::emit_to_write_style(&mut buffer, &config, &excerpt, &diagnostic)
            .expect("a buffer takes everything, and an excerpt holds its own place");
    }
    String::from_utf8_lossy(buffer.as_slice()).into_owned()
}

/// The line that a fault points into, cut to what fits a screen.
///
/// Only this line is looked at, so that a fault in a file of one very long line is drawn as fast as
/// any other.
#[derive(Default)]
struct Excerpt {
    name: String,
    text: String,
    /// The place within `text`.
    place: Range<usize>,
    /// Line and column in the file; both start from 1, columns count characters.
    line: usize,
    column: usize,
}

impl Excerpt {
    fn of(origin: &Origin) -> Excerpt {
        let source = &origin.source;
        let text = source.text.as_str();
        let start = floor_char(text, origin.span.start);
        let end = floor_char(text, origin.span.end).max(start);

        let line_start = text[..start].rfind('\n').map_or(0, |at| at + 1);
        let line_end = text[start..].find('\n').map_or(text.len(), |at| start + at);
        let before: Vec<char> = text[line_start..start].chars().rev().take(CONTEXT + 1).collect();
        let inside: Vec<char> = text[start..end.min(line_end)].chars().take(WIDEST).collect();
        let shown = start + inside.iter().map(|c| c.len_utf8()).sum::<usize>();
        let after: Vec<char> = text[shown..line_end].chars().take(CONTEXT + 1).collect();

        let mut line = String::new();
        if before.len() > CONTEXT {
            line.push_str("...");
        }
        line.push_str(&visible(before.iter().take(CONTEXT).rev()));
        let place_start = line.len();
        line.push_str(&visible(inside.iter()));
        let place_end = line.len();
        line.push_str(&visible(after.iter().take(CONTEXT)));
        if after.len() > CONTEXT {
            line.push_str("...");
        }
        let (line_number, column) = origin.line_column();
        Excerpt {
            name: escape_line(&source.path.display().to_string()),
            text: line,
            place: place_start..place_end,
            line: line_number,
            column,
        }
    }
}

fn floor_char(text: &str, at: usize) -> usize {
    text.floor_char_boundary(at.min(text.len()))
}

/// A part of one line; the carriage return of a line end from another system is a space.
fn visible<'a>(characters: impl Iterator<Item = &'a char>) -> String {
    let part: String = characters.map(|&c| if c == '\r' { ' ' } else { c }).collect();
    escape_line(&part)
}

fn printable(message: &str) -> String {
    let mut characters = message.chars();
    let mut text: String = characters.by_ref().take(LONGEST).collect();
    if characters.next().is_some() {
        text.push_str("...");
    }
    escape(&text).into_owned()
}

impl<'a> Files<'a> for Excerpt {
    type FileId = ();
    type Name = &'a str;
    type Source = &'a str;

    fn name(&'a self, _: ()) -> Result<&'a str, Error> {
        Ok(&self.name)
    }

    fn source(&'a self, _: ()) -> Result<&'a str, Error> {
        Ok(&self.text)
    }

    fn line_index(&'a self, _: (), _: usize) -> Result<usize, Error> {
        Ok(0)
    }

    fn line_number(&'a self, _: (), _: usize) -> Result<usize, Error> {
        Ok(self.line)
    }

    fn column_number(&'a self, _: (), _: usize, _: usize) -> Result<usize, Error> {
        Ok(self.column)
    }

    fn line_range(&'a self, _: (), _: usize) -> Result<Range<usize>, Error> {
        Ok(0..self.text.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::Source;

    fn drawn(text: &str, span: Range<usize>) -> String {
        let origin = Origin { source: Source::new("dir/edit.ron", text), span };
        draw(&[Diagnostic::at(&origin, "wanted this, got that").help("do this")], false)
    }

    #[test]
    fn the_caret_stands_under_the_place_and_columns_count_characters() {
        let text = "Edit(\n  größe: Off,\n)";
        let at = text.find("Off").expect("it is there");
        let wanted = "error: wanted this, got that\n  --> dir/edit.ron:2:10\n  |\n2 |   größe: Off,\n  |          ^^^\n  |\n  = help: do this\n\n";
        assert_eq!(drawn(text, at..at + 3), wanted);
    }

    #[test]
    fn a_long_line_is_cut_around_the_place() {
        let text = format!("{}X{}", "ä".repeat(100_000), "ö".repeat(100_000));
        let out = drawn(&text, 200_000..200_001);
        assert!(out.contains("dir/edit.ron:1:100001"), "{out}");
        assert!(out.contains(&format!("...{}X{}...", "ä".repeat(60), "ö".repeat(60))), "{out}");
        assert!(out.lines().all(|line| line.chars().count() < 140), "{out}");
    }

    #[test]
    fn a_place_of_several_lines_is_marked_on_its_first_and_control_characters_stay_out() {
        let out = drawn("a\u{1b}[31m (b\nc)", 7..12);
        assert!(out.contains("a\\u{1b}[31m (b\n") && !out.contains('\u{1b}'), "{out}");
        assert!(out.contains("|             ^^"), "{out}");
    }

    #[test]
    fn places_outside_of_the_text_are_drawn_at_its_end() {
        assert!(drawn("", 0..0).contains("dir/edit.ron:1:1"));
        assert!(drawn("é", 1..9).contains("dir/edit.ron:1:1"));
        assert!(drawn("ab", 7..9).contains("dir/edit.ron:1:3"));
    }

    #[test]
    fn a_fault_of_a_whole_file_names_it() {
        let fault = Diagnostic::file("no/such.ron".as_ref(), "cannot be read");
        assert_eq!(draw(&[fault], false).trim_end(), "error: no/such.ron: cannot be read");
    }
}
