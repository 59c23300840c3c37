//! Numbers of an edit that change over time.
//!
//! `frames: 48` makes an edit a sequence of 48 pictures, and any value may then be
//! `Keys([(0, a), (24, b), (47, c)])`: in frame 0 the value is a, in frame 24 it is b, between them
//! each number v in it is v_a + (v_b - v_a) (k - 0) / (24 - 0); before the first key and after the
//! last one the value is constant. The values of one `Keys` differ only in their numbers: `0.5`,
//! `(1, 0.9, 0.8)`, `Point(0, 1.2, -2)`.
//!
//! A frame is an edit like any other: its text is that of the file with each `Keys(..)` replaced by
//! its value, with anchors that give a fault its place in the file.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use crate::graph::{Anchor, Diagnostic, Diagnostics, Raw, Reach, Source, from_ron};

/// More than a person waits for.
const MOST_FRAMES: u32 = 100_000;
/// Most bytes of all frames that change, each of which is read and checked: some hundred seconds of
/// work.
const MOST_TEXT: usize = 1 << 30;

/// An edit file: one edit, or with `frames` one for each frame.
pub struct EditFile {
    source: Arc<Source>,
    frames: Option<u32>,
    tracks: Vec<Track>,
    /// Diagnostics of `frames` and `Keys`, reported with all others of the edit.
    pub(super) faults: Diagnostics,
}

/// One `Keys(..)`.
struct Track {
    place: Range<usize>,
    /// The places of its first byte and of the first byte after it.
    anchors: [Anchor; 2],
    /// By frame, ascending; at least one.
    keys: Vec<Keyframe>,
}

struct Keyframe {
    frame: u32,
    value: Vec<Word>,
}

#[derive(Clone)]
struct Word {
    text: String,
    /// The value of a number.
    number: Option<f64>,
}

impl EditFile {
    /// Reads an edit file.
    ///
    /// # Errors
    /// It cannot be read, or not be split into fields.
    pub fn read(path: &Path) -> Result<EditFile, Vec<Diagnostic>> {
        EditFile::read_within(path, Reach::Anywhere)
    }

    /// Reads an edit file that may name others within `reach` only.
    ///
    /// # Errors
    /// The errors of [`EditFile::read`].
    pub fn read_within(path: &Path, reach: Reach) -> Result<EditFile, Vec<Diagnostic>> {
        EditFile::parse(Source::read(path, reach).map_err(|fault| vec![fault])?)
    }

    /// The text of the file.
    pub fn text(&self) -> &str {
        &self.source.text
    }

    /// Reads the text of an edit file, which need not exist.
    ///
    /// # Errors
    /// The text cannot be split into fields.
    pub fn parse(source: Arc<Source>) -> Result<EditFile, Vec<Diagnostic>> {
        let mut faults = Diagnostics::default();
        let Some(document) = Raw::document(&source, &mut faults) else {
            return Err(faults.into_vec());
        };
        if !faults.is_empty() {
            // Whoever reads the fields finds them again, and more.
            return Ok(EditFile {
                source,
                frames: None,
                tracks: Vec::new(),
                faults: Diagnostics::default(),
            });
        }
        let fields = document.as_struct(None, &["frames"], &mut Diagnostics::ignored()); // other fields are not looked at here
        let frames = fields.first().and_then(|(_, value)| {
            let count = value.parse::<u32>().filter(|count| (1..=MOST_FRAMES).contains(count));
            if count.is_none() {
                faults.push(|| {
                    value
                        .fault(format!("wanted 1 to {MOST_FRAMES} frames, got `{}`", value.short()))
                });
            }
            count
        });
        let keyed = keyed(&document);
        if let (Some(first), true) = (keyed.first(), fields.is_empty()) {
            let message = "`Keys(..)` changes over time, and this edit is one picture";
            faults.push(|| {
                Diagnostic::at(&first.variant_origin(), message).help("give the edit `frames: 48,`")
            });
        }
        let mut anchor = Anchor { at: 0, line: 1, column: 1 };
        let mut tracks = Vec::new();
        for keys in &keyed {
            let place = keys.origin.span.clone();
            let begin = anchor.moved(&source.text, place.start);
            anchor = begin.moved(&source.text, place.end);
            let keys = track(keys, frames.unwrap_or(MOST_FRAMES), &mut faults);
            tracks.extend(keys.map(|keys| Track { place, anchors: [begin, anchor], keys }));
        }
        let mut file = EditFile { source, frames, tracks, faults };
        if let (Some(count), Some((_, value))) = (frames, fields.first()) {
            let bytes = file.at(0).text.len();
            if !file.tracks.is_empty() && bytes * count as usize > MOST_TEXT {
                let most = MOST_TEXT / bytes;
                let wanted = format!("wanted at most {most} frames of an edit of {bytes} bytes");
                file.faults.push(|| value.fault(format!("{wanted}, got {count}")));
            }
        }
        Ok(file)
    }

    /// The number of pictures of a sequence; none for a single picture.
    pub fn frames(&self) -> Option<u32> {
        self.frames
    }

    /// The text of the edit in one frame.
    pub(super) fn at(&self, frame: u32) -> Arc<Source> {
        if self.tracks.is_empty() {
            return self.source.clone();
        }
        let mut text = String::new();
        let mut anchors = Vec::with_capacity(2 * self.tracks.len());
        let mut from = 0;
        for track in &self.tracks {
            text.push_str(&self.source.text[from..track.place.start]);
            anchors.push(Anchor { at: text.len(), ..track.anchors[0] });
            track.write(frame, &mut text);
            anchors.push(Anchor { at: text.len(), ..track.anchors[1] });
            from = track.place.end;
        }
        text.push_str(&self.source.text[from..]);
        Arc::new(Source { path: self.source.path.clone(), text, anchors, reach: self.source.reach })
    }

    /// Whether the edit is in this frame as in the one before it.
    pub fn stands_still(&self, frame: u32) -> bool {
        let value = |track: &Track, frame: u32| {
            let mut text = String::new();
            track.write(frame, &mut text);
            text
        };
        frame > 0 && self.tracks.iter().all(|track| value(track, frame - 1) == value(track, frame))
    }
}

/// Every `Keys(..)` in `value`; not those inside of another one.
fn keyed(value: &Raw) -> Vec<Raw> {
    let words = value.words();
    let mut found = Vec::new();
    let mut next = 0;
    while next < words.len() {
        let begins = words[next].0.text() == "Keys"
            && words.get(next + 1).is_some_and(|(w, _)| w.text() == "(");
        let mut depth = 0;
        let closes = |(word, _): &(Raw, bool)| {
            depth += match word.text() {
                "(" | "[" | "{" => 1,
                ")" | "]" | "}" => -1,
                _ => 0,
            };
            depth == 0
        };
        match begins.then(|| words[next + 1..].iter().position(closes)).flatten() {
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
fn track(keys: &Raw, frames: u32, faults: &mut Diagnostics) -> Option<Vec<Keyframe>> {
    let before = faults.found();
    let what = "wanted `Keys([(frame, value), ..])`";
    let list = keys.as_tuple(faults);
    let [list] = &list[..] else {
        faults.push(|| keys.fault(format!("{what}, got {} values", list.len())));
        return None;
    };
    let mut keyframes: Vec<Keyframe> = Vec::new();
    let items = list.as_list(faults);
    if items.is_empty() && faults.found() == before {
        faults.push(|| list.fault(format!("{what}, got none")));
    }
    for item in items {
        let pair = item.as_tuple(&mut Diagnostics::ignored());
        let [frame, value] = &pair[..] else {
            faults.push(|| item.fault(format!("wanted `(frame, value)`, got `{}`", item.short())));
            continue;
        };
        let Some(frame) = number_of_frame(frame, frames, keyframes.last().map(|m| m.frame), faults)
        else {
            continue;
        };
        let Some(words) = words(value, faults) else { continue };
        match keyframes.first() {
            Some(first) if !alike(&first.value, &words) => faults.push(|| {
                let (frame, like, got) = (first.frame, short(&first.value), value.short());
                value.fault(format!(
                    "wanted a value like that of frame {frame}, `{like}`, except for its numbers, got `{got}`"
                ))
            }),
            _ => keyframes.push(Keyframe { frame, value: words }),
        }
    }
    (faults.found() == before).then_some(keyframes)
}

fn number_of_frame(
    raw: &Raw,
    frames: u32,
    last: Option<u32>,
    faults: &mut Diagnostics,
) -> Option<u32> {
    let frame = from_ron::<u32>(raw.text()).ok();
    if frame.is_some_and(|frame| frame < frames && last.is_none_or(|last| frame > last)) {
        return frame;
    }
    faults.push(|| {
        let wrong = match (frame, last) {
            (None, _) => format!("wanted the number of a frame, got `{}`", raw.short()),
            (Some(frame), _) if frame >= frames => {
                format!("wanted a frame up to {}, the last of {frames}, got {frame}", frames - 1)
            }
            (Some(frame), Some(last)) if frame < last => {
                format!("wanted a frame after {last}, got {frame}: keyframes ascend")
            }
            (Some(frame), _) => format!("frame {frame} is given twice"),
        };
        raw.fault(wrong)
    });
    None
}

/// The words of a value with at least one number; `None` left a fault.
fn words(value: &Raw, faults: &mut Diagnostics) -> Option<Vec<Word>> {
    let mut all = Vec::new();
    for (word, is_number) in value.words() {
        if word.text() == "Keys" {
            faults.push(|| word.fault("`Keys` cannot contain `Keys`"));
            return None;
        }
        let number = is_number.then(|| from_ron::<f64>(word.text()).ok()).flatten();
        if is_number && number.is_none() {
            faults.push(|| word.fault(format!("wanted a number, got `{}`", word.short())));
            return None;
        }
        all.push(Word { text: word.text().to_owned(), number });
    }
    if all.iter().all(|word| word.number.is_none()) {
        let wanted = "wanted a value with numbers, since only numbers change over time";
        faults.push(|| value.fault(format!("{wanted}, got `{}`", value.short())));
        return None;
    }
    Some(all)
}

fn alike(a: &[Word], b: &[Word]) -> bool {
    let same =
        |(a, b): (&Word, &Word)| (a.number.is_some() && b.number.is_some()) || a.text == b.text;
    a.len() == b.len() && a.iter().zip(b).all(same)
}

/// The beginning of a value, for messages.
fn short(words: &[Word]) -> String {
    words.iter().flat_map(|word| word.text.chars()).take(40).collect()
}

impl Track {
    /// Adds the value in one frame to `text`.
    fn write(&self, frame: u32, text: &mut String) {
        let next = self.keys.partition_point(|key| key.frame <= frame);
        let (a, b) =
            match (next.checked_sub(1).and_then(|at| self.keys.get(at)), self.keys.get(next)) {
                (Some(a), Some(b)) => (a, b),
                (Some(held), None) | (None, Some(held)) => (held, held),
                (None, None) => unreachable!("a track has a key"),
            };
        let t = f64::from(frame.saturating_sub(a.frame)) / f64::from((b.frame - a.frame).max(1));
        for (a, b) in a.value.iter().zip(&b.value) {
            match (a.number, b.number) {
                // The value of a keyframe as it is written, so that a constant value keeps its
                // bits.
                (Some(v), Some(w)) if v != w && t > 0.0 => text.push_str(&number(v + (w - v) * t)),
                _ => text.push_str(&a.text),
            }
        }
    }
}

/// In single precision, as parameters are; a whole number as such, which integers and fractions
/// both take.
fn number(value: f64) -> String {
    let value = value as f32;
    if value.fract() == 0.0 && value.abs() < 1e9 {
        format!("{value:.0}")
    } else {
        format!("{value:?}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::Origin;

    fn edit(text: &str) -> EditFile {
        EditFile::parse(Source::new("edit.ron", text))
            .unwrap_or_else(|faults| panic!("{}", faults[0]))
    }

    /// The values of `Keys(keys)` in these frames of 48.
    fn check(keys: &str, wanted: &[(u32, &str)]) {
        let file = edit(&format!("Edit(frames: 48, lights: Keys({keys}))"));
        assert!(file.faults.is_empty(), "{keys}: {:?}", file.faults.into_vec());
        for (frame, value) in wanted {
            let text = &file.at(*frame).text;
            let got =
                text.strip_prefix("Edit(frames: 48, lights: ").and_then(|t| t.strip_suffix(')'));
            assert_eq!(got.expect("the rest stays").trim_end(), *value, "{keys} in frame {frame}");
        }
    }

    #[test]
    fn numbers_are_interpolated_and_held() {
        check(
            "[(0, 1), (24, 2.0), (47, 2.0)]",
            &[(0, "1"), (6, "1.25"), (12, "1.5"), (24, "2.0"), (30, "2.0")],
        );
        check(
            "[(10, -0.5), (20, 1e3)]",
            &[(0, "-0.5"), (9, "-0.5"), (10, "-0.5"), (15, "499.75"), (20, "1e3"), (47, "1e3")],
        );
        check("[(5, 7)]", &[(0, "7"), (5, "7"), (47, "7")]);
        // A step of one frame; whole numbers stay whole, so that they fit where integers are
        // wanted.
        check("[(3, 0), (4, 100)]", &[(3, "0"), (4, "100")]);
        check("[(0, 0), (10, 100)]", &[(3, "30")]);
    }

    #[test]
    fn values_made_of_numbers_change_number_by_number() {
        check("[(0, (0, 1, -2)), (4, (1, 1, -4))]", &[(1, "(0.25,1,-2.5)"), (4, "(1,1,-4)")]);
        check(
            "[(0, Point(0, 1.2, -2)), (2, Point(2, 1.2, -2))]",
            &[(0, "Point(0,1.2,-2)"), (1, "Point(1,1.2,-2)")],
        );
        check(
            r#"[(0, (a: "x, 1", b: [1])), (2, (a: "x, 1", b: [2]))]"#,
            &[(1, r#"(a:"x, 1",b:[1.5])"#)],
        );
    }

    #[test]
    fn a_frame_keeps_the_places_of_the_file() {
        let text = "Edit(frames: 3, a: Keys([(0, 1), (2, 2)]), b: Keys([ // ü\n  (0, 1), /* Keys(3) */\n  (2, 3),\n]), c: \"Keys([\")";
        let file = edit(text);
        let frame = file.at(1);
        let place = |source: &Arc<Source>, what: &str| {
            let at = source.text.find(what).expect("it is there");
            Origin { source: source.clone(), span: at..at + what.len() }.line_column()
        };
        for what in ["frames", "a:", " b:", ", c:", "Keys([\""] {
            assert_eq!(place(&frame, what), place(&file.source, what), "{what} in {}", frame.text);
        }
        // A value's location is the start of its keys.
        assert_eq!((place(&frame, "1.5"), place(&frame, "2, c")), ((1, 20), (1, 47)));
        assert!(frame.text.len() < 60, "no longer than its values need: {}", frame.text);
        let words: String = frame.text.split_whitespace().collect();
        assert_eq!(words, "Edit(frames:3,a:1.5,b:2,c:\"Keys([\")");
    }

    /// Work that grows as the square of the keys takes minutes here.
    #[test]
    fn many_keys_and_many_frames_are_in_proportion() {
        let keys = |count: u32| (0..count).map(|i| format!("({i}, {i}),")).collect::<String>();
        let file = edit(&format!("Edit(frames: 100000, a: Keys([{}]), b: 1)", keys(100_000)));
        assert!(file.faults.is_empty());
        assert_eq!(
            file.at(54_321).text.trim_end(),
            "Edit(frames: 100000, a: 54321, b: 1)",
            "no trace of the other keys"
        );
        let beyond =
            edit(&format!("Edit(frames: 2, a: Keys([{}]))", keys(200_000))).faults.into_vec();
        assert_eq!(
            (beyond.len(), beyond[50].message.as_str()),
            (51, "and up to 199948 more errors")
        );

        let large = |frames: u32| {
            let name = "x".repeat(1 << 20);
            edit(&format!("Edit(frames: {frames}, a: Keys([(0, 1), (9, 2)]), b: \"{name}\")"))
                .faults
                .into_vec()
        };
        assert_eq!(large(1000), []);
        assert_eq!(
            large(1024)[0].message,
            "wanted at most 1023 frames of an edit of 1048607 bytes, got 1024"
        );
    }

    #[test]
    fn a_frame_stands_still_where_no_value_changes() {
        let file = edit("Edit(frames: 9, a: Keys([(2, 1), (4, 2), (6, 2)]), b: Keys([(0, 7)]))");
        let still: Vec<u32> = (0..9).filter(|frame| file.stands_still(*frame)).collect();
        assert_eq!(still, [1, 2, 5, 6, 7, 8]);
        assert!(still.iter().all(|&frame| file.at(frame).text == file.at(frame - 1).text));
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
                    "1:35: wanted a frame after 4, got 2: keyframes ascend",
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
                    "1:30: wanted a value with numbers, since only numbers change over time, got `Off`",
                    "1:67: wanted a value like that of frame 0, `1`, except for its numbers, got `(1, 2)`",
                    "1:81: wanted `Keys([(frame, value), ..])`, got 0 values",
                    "1:97: wanted `Keys([(frame, value), ..])`, got none",
                ],
            ),
            (
                "Edit(frames: 8, a: Keys([(0, Keys([(0, 1)]))]))",
                &["1:30: `Keys` cannot contain `Keys`"],
            ),
        ] {
            let message = |fault: &Diagnostic| {
                let (line, column) = fault.origin.as_ref().expect("it has a place").line_column();
                format!("{line}:{column}: {}", fault.message)
            };
            let got: Vec<String> = edit(text).faults.into_vec().iter().map(message).collect();
            assert_eq!(got, wanted, "{text}");
        }
    }
}
