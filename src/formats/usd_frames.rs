//! The rooms of the frames of a sequence as one USD text, in which values change over time.
//!
//! USD interpolates numbers between time samples. Rooms are those of whole frames, so that a value
//! that stays has a sample before it changes.

use std::fmt::Write as _;

/// The frames put together so far, from the texts of their rooms.
pub struct UsdFrames {
    /// The lines of the stage itself.
    head: Vec<String>,
    prims: Vec<Prim>,
    first: u32,
    last: u32,
}

/// A `def` with its attributes and those below it.
struct Prim {
    /// Its lines up to the brace.
    head: Vec<String>,
    attributes: Vec<Attribute>,
    children: Vec<Prim>,
}

/// The values of an attribute by frame, ascending, each where it changes.
struct Attribute {
    /// Type and name; a declaration without a value has no samples.
    key: String,
    samples: Vec<(u32, String)>,
    /// Frame of the last room that has it.
    seen: u32,
}

/// Attributes by which a light that is left out of a frame is dark there.
const DARK: [(&str, &str); 2] =
    [("float inputs:intensity", "0"), ("color3f inputs:emissiveColor", "(0, 0, 0)")];

impl UsdFrames {
    /// The sequence that begins with the room `text` of the frame `first`.
    pub fn new(first: u32, text: &str) -> UsdFrames {
        let mut lines = text.lines();
        let (head, prims) = parse(&mut lines, first);
        UsdFrames { head: head.head, prims, first, last: first }
    }

    /// Adds the room of the next frame.
    pub fn add(&mut self, text: &str) {
        self.last += 1;
        let (_, prims) = parse(&mut text.lines(), self.last);
        merge(&mut self.prims, prims, (self.first, self.last));
    }

    /// The text of all frames, whose time codes are their numbers.
    pub fn text(&self, frames_per_second: u16) -> String {
        let mut text = String::new();
        for line in &self.head {
            if line.trim() == ")" {
                let codes = [
                    ("startTimeCode", self.first),
                    ("endTimeCode", self.last),
                    ("timeCodesPerSecond", u32::from(frames_per_second)),
                ];
                for (name, value) in codes {
                    writeln!(text, "    {name} = {value}").expect("writing to a string");
                }
            }
            text.push_str(line);
            text.push('\n');
        }
        self.prims.iter().for_each(|prim| prim.write(&mut text, 0));
        text
    }
}

/// A prim of the lines before the first `def`, and the prims up to the closing brace or the end.
fn parse<'a>(lines: &mut impl Iterator<Item = &'a str>, frame: u32) -> (Prim, Vec<Prim>) {
    let mut own = Prim { head: Vec::new(), attributes: Vec::new(), children: Vec::new() };
    let mut prims = Vec::new();
    while let Some(line) = lines.next() {
        match line.trim() {
            "}" => break,
            def if def.starts_with("def ") => {
                let mut head = vec![def.to_owned()];
                head.extend(
                    lines.by_ref().map(str::trim).take_while(|l| *l != "{").map(Into::into),
                );
                let (mut prim, children) = parse(lines, frame);
                (prim.head, prim.children) = (head, children);
                prims.push(prim);
            }
            attribute => {
                own.head.push(line.to_owned());
                let (key, value) = attribute.split_once(" = ").unwrap_or((attribute, ""));
                if !key.is_empty() {
                    let samples =
                        if value.is_empty() { vec![] } else { vec![(frame, value.into())] };
                    own.attributes.push(Attribute { key: key.into(), samples, seen: frame });
                }
            }
        }
    }
    (own, prims)
}

/// Adds the prims of the frame `now` to those of the frames from `first` on.
fn merge(all: &mut Vec<Prim>, new: Vec<Prim>, (first, now): (u32, u32)) {
    for mut prim in new {
        let known = all.iter_mut().find(|known| known.head[0] == prim.head[0]);
        let Some(known) = known else {
            prim.dark_before(first, now);
            all.push(prim);
            continue;
        };
        for attribute in prim.attributes {
            match known.attributes.iter_mut().find(|known| known.key == attribute.key) {
                Some(known) => {
                    known.seen = now;
                    attribute.samples.into_iter().for_each(|(_, value)| known.push(now, value));
                }
                None => known.attributes.push(attribute),
            }
        }
        merge(&mut known.children, prim.children, (first, now));
    }
    all.iter_mut().for_each(|prim| prim.dark_where_missing(now));
}

impl Attribute {
    fn push(&mut self, frame: u32, value: String) {
        let Some((last, old)) = self.samples.last().cloned() else { return };
        if old != value {
            if last + 1 < frame {
                self.samples.push((frame - 1, old));
            }
            self.samples.push((frame, value));
        }
    }
}

impl Prim {
    /// A prim that comes in the frame `now` is dark from `first` on.
    fn dark_before(&mut self, first: u32, now: u32) {
        for (key, dark) in DARK {
            for attribute in self.attributes.iter_mut().filter(|a| a.key == key) {
                let shown = std::mem::take(&mut attribute.samples);
                attribute.samples = vec![(first, dark.into())];
                shown.into_iter().for_each(|(_, value)| attribute.push(now, value));
            }
        }
        self.children.iter_mut().for_each(|child| child.dark_before(first, now));
    }

    fn dark_where_missing(&mut self, now: u32) {
        for (key, dark) in DARK {
            let missing = |a: &&mut Attribute| a.key == key && a.seen < now;
            self.attributes.iter_mut().filter(missing).for_each(|a| a.push(now, dark.into()));
        }
        self.children.iter_mut().for_each(|child| child.dark_where_missing(now));
    }

    fn write(&self, text: &mut String, depth: usize) {
        let mut line = |depth: usize, line: &str| {
            writeln!(text, "{:1$}{line}", "", 4 * depth).expect("writing to a string");
        };
        self.head.iter().for_each(|head| line(depth, head));
        line(depth, "{");
        for Attribute { key, samples, .. } in &self.attributes {
            match &samples[..] {
                [] => line(depth + 1, key),
                [(_, value)] => line(depth + 1, &format!("{key} = {value}")),
                many => {
                    let many: Vec<String> =
                        many.iter().map(|(frame, value)| format!("{frame}: {value}")).collect();
                    line(depth + 1, &format!("{key}.timeSamples = {{ {} }}", many.join(", ")));
                }
            }
        }
        self.children.iter().for_each(|child| child.write(text, depth + 1));
        writeln!(text, "{:1$}}}", "", 4 * depth).expect("writing to a string");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn room(lamps: &[(&str, u32)]) -> String {
        let lamp = |(name, intensity): &(&str, u32)| {
            format!(
                "        def SphereLight \"{name}\"\n        {{\n            float inputs:intensity = {intensity}\n        }}\n"
            )
        };
        let lamps: String = lamps.iter().map(lamp).collect();
        format!(
            "#usda 1.0\n(\n    upAxis = \"Y\"\n)\n\ndef Xform \"Room\"\n{{\n    def Mesh \"Surface\" (\n        \
             prepend apiSchemas = []\n    )\n    {{\n        int[] faces = [1, 2]\n        token outputs:surface\n    \
             }}\n\n    def Scope \"Lights\"\n    {{\n{lamps}    }}\n}}\n"
        )
    }

    fn frames(rooms: &[&[(&str, u32)]]) -> String {
        let mut frames = UsdFrames::new(0, &room(rooms[0]));
        rooms[1..].iter().for_each(|lamps| frames.add(&room(lamps)));
        frames.text(24)
    }

    #[test]
    fn frames_that_are_alike_have_no_samples() {
        let text = frames(&[&[("a", 3)], &[("a", 3)]]);
        assert!(!text.contains("timeSamples"), "{text}");
        for wanted in [
            "    endTimeCode = 1\n    timeCodesPerSecond = 24\n)\n",
            "        int[] faces = [1, 2]\n        token outputs:surface\n",
            "            float inputs:intensity = 3\n",
        ] {
            assert!(text.contains(wanted), "{text}");
        }
    }

    #[test]
    fn values_change_where_frames_do_and_a_light_that_is_left_out_is_dark() {
        let text = frames(&[
            &[("a", 3)],
            &[("a", 3)],
            &[("a", 3)],
            &[("a", 5), ("b", 7)],
            &[("b", 7)],
            &[("a", 5), ("b", 7)],
        ]);
        let samples = |name: &str| {
            let after = text.split_once(&format!("\"{name}\"")).expect("it is there").1;
            let line = after.lines().find(|line| line.contains("intensity")).expect("it shines");
            line.split_once("{ ").expect("it changes").1.to_owned()
        };
        assert_eq!(samples("a"), "0: 3, 2: 3, 3: 5, 4: 0, 5: 5 }");
        assert_eq!(samples("b"), "0: 0, 2: 0, 3: 7 }");
        assert_eq!(text.matches('{').count(), text.matches('}').count());
    }
}
