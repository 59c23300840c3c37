//! Texts of errors without secrets.

/// Parts of the names of variables whose values are secrets.
const NAMES: [&str; 6] = ["KEY", "SECRET", "TOKEN", "SAS", "PASSWORD", "SIGNATURE"];
const PREFIXES: [&str; 3] = ["AWS_", "AZURE_", "GOOGLE_"];
/// A shorter value may be part of any text.
const SHORTEST: usize = 6;
/// Characters of a message of a store that are shown.
const LONGEST: usize = 240;

/// Values that no message may contain.
pub struct Secrets(Vec<String>);

impl Secrets {
    /// The secrets of the environment, and `more`.
    pub fn new(more: impl IntoIterator<Item = String>) -> Secrets {
        let is_secret = |name: &str| {
            PREFIXES.iter().any(|prefix| name.starts_with(prefix))
                && NAMES.iter().any(|part| name.contains(part))
        };
        let of_environment = std::env::vars_os().filter_map(|(name, value)| {
            is_secret(&name.to_string_lossy().to_ascii_uppercase())
                .then(|| value.to_string_lossy().into_owned())
        });
        let mut all: Vec<String> =
            of_environment.chain(more).filter(|value| value.len() >= SHORTEST).collect();
        all.sort_by_key(|value| std::cmp::Reverse(value.len()));
        Secrets(all)
    }

    /// One line of an error, without secrets and without the queries of addresses, which may carry
    /// signatures.
    pub fn redact(&self, text: &str) -> String {
        let mut text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        for secret in &self.0 {
            text = text.replace(secret.as_str(), "***");
        }
        let mut shown = String::new();
        let mut in_query = false;
        for c in text.chars().take(LONGEST) {
            match c {
                '?' => {
                    in_query = true;
                    shown.push_str("?..");
                }
                ' ' | '"' | ')' | '>' | '\'' => in_query = false,
                _ => {}
            }
            if !in_query {
                shown.push(c);
            }
        }
        shown
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_has_neither_secrets_nor_queries() {
        let secrets = Secrets::new(["wJalrXUtnFEMI/K7MDENG".to_owned(), "abc".to_owned()]);
        let text = "GET https://a.blob.core.windows.net/c/x?sig=Zm9v%3D&se=2026: wJalrXUtnFEMI/K7MDENG\nabc";
        assert_eq!(
            secrets.redact(text),
            "GET https://a.blob.core.windows.net/c/x?.. *** abc",
            "secrets that are parts of words stay"
        );
        assert!(secrets.redact(&"x".repeat(5000)).len() <= LONGEST);
    }
}
