//! Key manifests: everything that a result depends on, one fact a line. `explain` compares the same
//! text.

use std::fmt::Write;

use super::Digest;

/// Raised whenever key manifests or stored entries change their form: all older entries are then
/// unknown.
pub(super) const FORMAT: u32 = 5;

/// The prefix of a digest that replaces a file's path.
pub(super) const FILE: &str = "blake3:";

/// The lines that do not depend on inputs.
pub(super) fn head(kind: &str, version: u32, params: &[(&'static str, String)]) -> String {
    let mut text = format!("engine {FORMAT}\nkind {kind}\nversion {version}\n");
    for (name, value) in params {
        writeln!(text, "parameter {name}: {value}").expect("writing to a string");
    }
    text
}

/// One value at an input port; `member` where the port gathers.
pub(super) fn input_line(
    text: &mut String,
    port: &str,
    member: Option<&str>,
    type_name: &str,
    digest: &Digest,
) {
    match member {
        Some(member) => writeln!(text, "input {port}[{member}]: {type_name} {digest}"),
        None => writeln!(text, "input {port}: {type_name} {digest}"),
    }
    .expect("writing to a string");
}

/// An optional port without a value.
pub(super) fn missing_line(text: &mut String, port: &str) {
    writeln!(text, "input {port}: none").expect("writing to a string");
}

/// A gather port, before its members: so that the text contains an empty one as well.
pub(super) fn gather_line(text: &mut String, port: &str, members: usize) {
    writeln!(text, "members {port}: {members}").expect("writing to a string");
}

/// Computes the digest of a key manifest.
pub(super) fn digest(text: &str) -> Digest {
    Digest(*blake3::hash(text.as_bytes()).as_bytes())
}

/// Why a node has to run: the fact that changed, as it was, as it is, and in one sentence.
pub(super) struct Why {
    pub old: Option<String>,
    pub new: Option<String>,
    pub why: String,
}

impl Why {
    /// Creates a reason without lines to compare.
    pub fn plain(why: &str) -> Why {
        Why { old: None, new: None, why: why.to_owned() }
    }
}

/// The first fact that differs between two key manifests.
pub(super) fn first_change(old: &str, new: &str) -> Option<Why> {
    let fact = |line: &'_ str| -> (String, String) {
        let (label, value) =
            line.split_once(": ").or_else(|| line.split_once(' ')).unwrap_or((line, ""));
        (label.to_owned(), value.to_owned())
    };
    let olds: Vec<_> = old.lines().map(fact).collect();
    let news: Vec<_> = new.lines().map(fact).collect();
    let value = |facts: &[(String, String)], label: &str| {
        facts.iter().find(|f| f.0 == label).map(|f| f.1.clone())
    };
    let line = |label: &str, value: &str| {
        let between = if label.contains(' ') { ": " } else { " " };
        format!("{label}{between}{value}")
    };
    // A count of members changes because of a member; the member is the better answer, and is on
    // another line.
    let counts = |label: &str| label.starts_with("members ");
    for (label, now) in news.iter().filter(|(label, _)| !counts(label)) {
        let was = value(&olds, label);
        if was.as_ref() != Some(now) {
            let old = was.as_ref().map(|was| line(label, was));
            return Some(Why {
                old,
                why: sentence(label, was.as_deref(), Some(now)),
                new: Some(line(label, now)),
            });
        }
    }
    for (label, was) in olds.iter().filter(|(label, _)| !counts(label)) {
        if value(&news, label).is_none() {
            return Some(Why {
                old: Some(line(label, was)),
                new: None,
                why: sentence(label, Some(was), None),
            });
        }
    }
    // The same facts in another order: members of a gather port were put in another order.
    let (was, now) = olds.iter().zip(&news).find(|(was, now)| was != now)?;
    let port = now.0.split('[').next().unwrap_or(&now.0);
    let why = format!("{port}: members in another order");
    Some(Why { old: Some(line(&was.0, &was.1)), new: Some(line(&now.0, &now.1)), why })
}

fn sentence(label: &str, was: Option<&str>, now: Option<&str>) -> String {
    match (was, now) {
        (Some(was), Some(now))
            if label.starts_with("parameter ") && differ_in_files_only(was, now) =>
        {
            format!("{label}: file changed")
        }
        (Some("none"), Some(_)) | (None, Some(_)) if label.starts_with("input ") => {
            format!("{label} is new")
        }
        (Some(_), Some("none") | None) if label.starts_with("input ") => format!("{label} is gone"),
        (Some(_), Some(_)) if label.starts_with("input ") => format!("{label} changed"),
        (was, now) => {
            format!("{label}: {} -> {}", short(was.unwrap_or("none")), short(now.unwrap_or("none")))
        }
    }
}

fn short(value: &str) -> String {
    if value.chars().count() <= 60 {
        value.to_owned()
    } else {
        value.chars().take(57).chain("...".chars()).collect()
    }
}

fn differ_in_files_only(was: &str, now: &str) -> bool {
    let without_digests = |text: &str| {
        let mut parts = text.split(FILE);
        let first = parts.next().unwrap_or_default().to_owned();
        parts.fold(first, |all, part| all + FILE + part.get(64..).unwrap_or(part))
    };
    was.contains(FILE) && without_digests(was) == without_digests(now)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn why(old: &str, new: &str) -> Option<String> {
        first_change(old, new).map(|change| change.why)
    }

    #[test]
    fn the_first_changed_fact_is_told_in_one_sentence() {
        let d = |c: char| c.to_string().repeat(64);
        let (a, b) = (d('a'), d('b'));
        assert_eq!(why("kind A\nversion 1\n", "kind A\nversion 1\n"), None);
        assert_eq!(why("version 1\n", "version 2\n").unwrap(), "version: 1 -> 2");
        assert_eq!(why("parameter n: 16\n", "parameter n: 32\n").unwrap(), "parameter n: 16 -> 32");
        let file = |digest: &str| format!("parameter photo: \"{FILE}{digest}\"\n");
        assert_eq!(why(&file(&a), &file(&b)).unwrap(), "parameter photo: file changed");
        assert_eq!(
            why(&format!("input x: T {a}"), &format!("input x: T {b}")).unwrap(),
            "input x changed"
        );
        assert_eq!(why("input x: none", &format!("input x: T {b}")).unwrap(), "input x is new");
        let one = format!("members x: 1\ninput x[m]: T {a}\n");
        let two = format!("members x: 2\ninput x[n]: T {b}\ninput x[m]: T {a}\n");
        assert_eq!(why(&one, &two).unwrap(), "input x[n] is new");
        assert_eq!(why(&two, &one).unwrap(), "input x[n] is gone");
        let turned = format!("members x: 2\ninput x[m]: T {a}\ninput x[n]: T {b}\n");
        assert_eq!(why(&two, &turned).unwrap(), "input x: members in another order");
    }
}
