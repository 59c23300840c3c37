//! Numbers of an edit that change over time.
//!
//! `frames: 48` makes an edit a sequence of 48 pictures, and in the place of any value may then stand
//! `Keys([(0, a), (24, b), (47, c)])`: in frame 0 the value is a, in frame 24 it is b, between them each number v in it is
//! v_a + (v_b - v_a) (k - 0) / (24 - 0); before the first key and after the last one the value stands still. The values of one `Keys` are alike
//! but for their numbers: `0.5`, `(1, 0.9, 0.8)`, `Point(0, 1.2, -2)`.
//!
//! A frame is an edit like any other: its text is that of the file with each `Keys(..)` replaced in its own place, so that a fault is told
//! where it stands in the file.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use crate::graph::{Fault, Raw, Reach, Source};

/// More than a person waits for.
const MOST_FRAMES: u32 = 100_000;

/// An edit file: one edit, or with `frames` one for each frame.
pub struct EditFile {
    source: Arc<Source>,
    frames: Option<u32>,
    tracks: Vec<Track>,
    /// What is wrong with `frames` and `Keys`; told with all else that is wrong with the edit.
    pub(super) faults: Vec<Fault>,
}

/// One `Keys(..)`.
struct Track {
    place: Range<usize>,
    /// By frame, ascending; at least one.
    keys: Vec<Moment>,
}

struct Moment {
    frame: u32,
    value: Vec<Word>,
}

#[derive(Clone)]
struct Word {
    text: String,
    /// What it is worth, where it is a number.
    number: Option<f64>,
}

impl EditFile {
    /// Reads an edit file.
    ///
    /// # Errors
    /// It cannot be read, or not be split into fields.
    pub fn read(path: &Path) -> Result<EditFile, Vec<Fault>> {
        EditFile::read_within(path, Reach::Anywhere)
    }

    /// The same of a file that may name others within `reach` only.
    ///
    /// # Errors
    /// Those of [`EditFile::read`].
    pub fn read_within(path: &Path, reach: Reach) -> Result<EditFile, Vec<Fault>> {
        EditFile::parse(Source::read(path, reach).map_err(|fault| vec![fault])?)
    }

    fn parse(source: Arc<Source>) -> Result<EditFile, Vec<Fault>> {
        let mut faults = Vec::new();
        let Some(document) = Raw::document(&source, &mut faults) else { return Err(faults) };
        if !faults.is_empty() {
            // Whoever reads the fields finds them again, and more.
            return Ok(EditFile { source, frames: None, tracks: Vec::new(), faults: Vec::new() });
        }
        let fields = document.as_struct(None, &["frames"], &mut Vec::new()); // other fields are not looked at here
        let frames = fields.first().and_then(|(_, value)| {
            let count = value.parse::<u32>().ok().filter(|count| (1..=MOST_FRAMES).contains(count));
            if count.is_none() {
                faults.push(value.fault(format!("wanted 1 to {MOST_FRAMES} frames, got `{}`", value.text())));
            }
            count
        });
        let keyed = keyed(&document);
        if let (Some(first), true) = (keyed.first(), fields.is_empty()) {
            let message = "`Keys(..)` changes over time, and this edit is one picture";
            faults.push(Fault::at(&first.variant_origin(), message).help("give the edit `frames: 48,`"));
        }
        let track = |keys: &Raw| track(keys, frames.unwrap_or(MOST_FRAMES), &mut faults);
        let tracks = keyed.iter().filter_map(track).collect();
        Ok(EditFile { source, frames, tracks, faults })
    }

    /// How many pictures the edit makes, where it says so.
    pub fn frames(&self) -> Option<u32> {
        self.frames
    }

    /// The text of the edit in one frame.
    pub(super) fn at(&self, frame: u32) -> Arc<Source> {
        if self.tracks.is_empty() {
            return self.source.clone();
        }
        let mut text = String::with_capacity(self.source.text.len());
        let mut from = 0;
        for track in &self.tracks {
            text.push_str(&self.source.text[from..track.place.start]);
            text.push_str(&fitted(track.at(frame), &self.source.text[track.place.clone()]));
            from = track.place.end;
        }
        text.push_str(&self.source.text[from..]);
        Source::within(&self.source.path, text, self.source.reach)
    }
}

/// Every `Keys(..)` in `value`; not those inside of another one.
fn keyed(value: &Raw) -> Vec<Raw> {
    let words = value.words();
    let mut found = Vec::new();
    let mut next = 0;
    while next < words.len() {
        let begins = words[next].0.text() == "Keys" && words.get(next + 1).is_some_and(|(w, _)| w.text() == "(");
        let mut depth = 0;
        let closes = |(word, _): &(Raw, bool)| {
            depth += match word.text() {
                "(" | "[" | "{" => 1,
                ")" | "]" | "}" => -1,
                _ => 0,
            };
            depth == 0
        };
        match words[next + 1..].iter().position(closes).filter(|_| begins) {
            Some(length) => {
                found.push(words[next].0.through(&words[next + 1 + length].0));
                next += length + 2;
            }
            None => next += 1,
        }
    }
    found
}

/// `Keys([(frame, value), ..])` of an edit with so many frames; `None` left a fault.
fn track(keys: &Raw, frames: u32, faults: &mut Vec<Fault>) -> Option<Track> {
    let before = faults.len();
    let what = "wanted `Keys([(frame, value), ..])`";
    let list = keys.as_tuple(faults);
    let [list] = &list[..] else {
        faults.push(keys.fault(format!("{what}, got {} values", list.len())));
        return None;
    };
    let mut moments: Vec<Moment> = Vec::new();
    let items = list.as_list(faults);
    if items.is_empty() && faults.len() == before {
        faults.push(list.fault(format!("{what}, got none")));
    }
    for item in items {
        let pair = item.as_tuple(&mut Vec::new());
        let [frame, value] = &pair[..] else {
            faults.push(item.fault(format!("wanted `(frame, value)`, got `{}`", item.text())));
            continue;
        };
        let Some(frame) = number_of_frame(frame, frames, moments.last().map(|m| m.frame), faults) else { continue };
        match words(value) {
            Err(fault) => faults.push(fault),
            Ok(words) => match moments.first() {
                Some(first) if !alike(&first.value, &words) => {
                    let message = format!(
                        "wanted a value like that of frame {}, `{}`, but for its numbers, got `{}`",
                        first.frame,
                        joined(&first.value),
                        value.text()
                    );
                    faults.push(value.fault(message));
                }
                _ => moments.push(Moment { frame, value: words }),
            },
        }
    }
    (faults.len() == before).then(|| Track { place: keys.origin.span.clone(), keys: moments })
}

fn number_of_frame(raw: &Raw, frames: u32, last: Option<u32>, faults: &mut Vec<Fault>) -> Option<u32> {
    let Ok(frame) = raw.parse::<u32>() else {
        faults.push(raw.fault(format!("wanted the number of a frame, got `{}`", raw.text())));
        return None;
    };
    let wrong = match last {
        _ if frame >= frames => {
            format!("wanted a frame up to {}, the last of {frames}, got {frame}", frames - 1)
        }
        Some(last) if frame == last => format!("frame {frame} is given twice"),
        Some(last) if frame < last => format!("wanted a frame after {last}, got {frame}: keys go up"),
        _ => return Some(frame),
    };
    faults.push(raw.fault(wrong));
    None
}

/// The words of a value with at least one number.
fn words(value: &Raw) -> Result<Vec<Word>, Fault> {
    let mut all = Vec::new();
    for (word, is_number) in value.words() {
        if word.text() == "Keys" {
            return Err(word.fault("`Keys` may not stand within `Keys`"));
        }
        let number = match is_number.then(|| word.parse::<f64>()) {
            Some(Err(_)) => return Err(word.fault(format!("wanted a number, got `{}`", word.text()))),
            number => number.and_then(Result::ok),
        };
        all.push(Word { text: word.text().to_owned(), number });
    }
    if all.iter().any(|word| word.number.is_some()) {
        Ok(all)
    } else {
        Err(value.fault(format!("wanted a value with numbers, which alone change over time, got `{}`", value.text())))
    }
}

fn alike(a: &[Word], b: &[Word]) -> bool {
    let same = |(a, b): (&Word, &Word)| (a.number.is_some() && b.number.is_some()) || a.text == b.text;
    a.len() == b.len() && a.iter().zip(b).all(same)
}

fn joined(words: &[Word]) -> String {
    words.iter().map(|word| word.text.as_str()).collect()
}

impl Track {
    /// The value in one frame.
    fn at(&self, frame: u32) -> String {
        let next = self.keys.partition_point(|key| key.frame <= frame);
        let (a, b) = match (next.checked_sub(1).and_then(|at| self.keys.get(at)), self.keys.get(next)) {
            (Some(a), Some(b)) => (a, b),
            (Some(held), None) | (None, Some(held)) => return joined(&held.value),
            (None, None) => unreachable!("a track has a key"),
        };
        let t = f64::from(frame - a.frame) / f64::from(b.frame - a.frame);
        let word = |(a, b): (&Word, &Word)| match (a.number, b.number) {
            // A key's own value as it is written, so that what stands still keeps its bits.
            (Some(v), Some(w)) if v != w && t > 0.0 => number(v + (w - v) * t),
            _ => a.text.clone(),
        };
        a.value.iter().zip(&b.value).map(word).collect()
    }
}

/// In single precision, as parameters are; a whole number as such, which integers and fractions both take.
fn number(value: f64) -> String {
    let value = value as f32;
    if value.fract() == 0.0 && value.abs() < 1e9 { format!("{value:.0}") } else { format!("{value:?}") }
}

/// `value` with blanks and line breaks, so that what follows stands on the line and in the column where it stands after `old`.
fn fitted(value: String, old: &str) -> String {
    let (before, last) = old.rsplit_once('\n').map_or((None, old), |(before, last)| (Some(before), last));
    let mut text = value;
    match before {
        Some(before) => {
            text.extend(std::iter::repeat_n('\n', 1 + before.matches('\n').count()));
            text.extend(std::iter::repeat_n(' ', last.chars().count()));
        }
        None => {
            let missing = last.chars().count().saturating_sub(text.chars().count());
            text.extend(std::iter::repeat_n(' ', missing));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edit(text: &str) -> EditFile {
        EditFile::parse(Source::new("edit.ron", text)).unwrap_or_else(|faults| panic!("{}", faults[0]))
    }

    /// The values of `Keys(keys)` in these frames of 48.
    fn check(keys: &str, wanted: &[(u32, &str)]) {
        let file = edit(&format!("Edit(frames: 48, lights: Keys({keys}))"));
        assert!(file.faults.is_empty(), "{keys}: {}", file.faults[0]);
        for (frame, value) in wanted {
            let text = &file.at(*frame).text;
            let got = text.strip_prefix("Edit(frames: 48, lights: ").and_then(|t| t.strip_suffix(')'));
            assert_eq!(got.expect("the rest stays").trim_end(), *value, "{keys} in frame {frame}");
        }
    }

    #[test]
    fn numbers_are_interpolated_and_held() {
        check("[(0, 1), (24, 2.0), (47, 2.0)]", &[(0, "1"), (6, "1.25"), (12, "1.5"), (24, "2.0"), (30, "2.0")]);
        check(
            "[(10, -0.5), (20, 1e3)]",
            &[(0, "-0.5"), (9, "-0.5"), (10, "-0.5"), (15, "499.75"), (20, "1e3"), (47, "1e3")],
        );
        check("[(5, 7)]", &[(0, "7"), (5, "7"), (47, "7")]);
        // A step of one frame; whole numbers stay whole, so that they fit where integers are wanted.
        check("[(3, 0), (4, 100)]", &[(3, "0"), (4, "100")]);
        check("[(0, 0), (10, 100)]", &[(3, "30")]);
    }

    #[test]
    fn values_made_of_numbers_change_number_by_number() {
        check("[(0, (0, 1, -2)), (4, (1, 1, -4))]", &[(1, "(0.25,1,-2.5)"), (4, "(1,1,-4)")]);
        check("[(0, Point(0, 1.2, -2)), (2, Point(2, 1.2, -2))]", &[(0, "Point(0,1.2,-2)"), (1, "Point(1,1.2,-2)")]);
        check(r#"[(0, (a: "x, 1", b: [1])), (2, (a: "x, 1", b: [2]))]"#, &[(1, r#"(a:"x, 1",b:[1.5])"#)]);
    }

    #[test]
    fn a_frame_keeps_the_places_of_the_file() {
        let text = "Edit(frames: 3, a: Keys([(0, 1), (2, 2)]), b: Keys([ // ü\n  (0, 1), /* Keys(3) */\n  (2, 3),\n]), c: \"Keys([\")";
        let file = edit(text);
        let frame = file.at(1);
        assert_eq!(frame.text.matches('\n').count(), text.matches('\n').count());
        let place = |text: &str, what: &str| {
            let at = text.find(what).expect("it is there");
            let line = text[..at].rfind('\n').map_or(0, |i| i + 1);
            (text[..at].matches('\n').count(), text[line..at].chars().count())
        };
        for what in [" b:", ", c:"] {
            assert_eq!(place(&frame.text, what), place(text, what), "{}", frame.text);
        }
        let words: String = frame.text.split_whitespace().collect();
        assert_eq!(words, "Edit(frames:3,a:1.5,b:2,c:\"Keys([\")");
    }

    #[test]
    fn what_is_wrong_is_told_where_it_stands() {
        for (text, wanted) in [
            (
                "Edit(a: Keys([(0, 1)]), b: Keys([(0, 2)]))",
                &["1:9: `Keys(..)` changes over time, and this edit is one picture"][..],
            ),
            ("Edit(frames: 0)", &["1:14: wanted 1 to 100000 frames, got `0`"]),
            ("Edit(frames: 4.5)", &["1:14: wanted 1 to 100000 frames, got `4.5`"]),
            (
                "Edit(frames: 8, a: Keys([(4, 1), (2, 1), (4, 3), (8, 1), (-1, 1), (5.5, 1), 3, (6,)]))",
                &[
                    "1:35: wanted a frame after 4, got 2: keys go up",
                    "1:43: frame 4 is given twice",
                    "1:51: wanted a frame up to 7, the last of 8, got 8",
                    "1:59: wanted the number of a frame, got `-1`",
                    "1:68: wanted the number of a frame, got `5.5`",
                    "1:77: wanted `(frame, value)`, got `3`",
                    "1:80: wanted `(frame, value)`, got `(6,)`",
                ],
            ),
            (
                "Edit(frames: 8, a: Keys([(0, Off), (1, 1)]), b: Keys([(0, 1), (1, (1, 2))]), c: Keys(), d: Keys([]))",
                &[
                    "1:30: wanted a value with numbers, which alone change over time, got `Off`",
                    "1:67: wanted a value like that of frame 0, `1`, but for its numbers, got `(1, 2)`",
                    "1:81: wanted `Keys([(frame, value), ..])`, got 0 values",
                    "1:97: wanted `Keys([(frame, value), ..])`, got none",
                ],
            ),
            ("Edit(frames: 8, a: Keys([(0, Keys([(0, 1)]))]))", &["1:30: `Keys` may not stand within `Keys`"]),
        ] {
            let told = |fault: &Fault| {
                let (line, column) = fault.origin.as_ref().expect("it has a place").line_column();
                format!("{line}:{column}: {}", fault.message)
            };
            let got: Vec<String> = edit(text).faults.iter().map(told).collect();
            assert_eq!(got, wanted, "{text}");
        }
    }
}
