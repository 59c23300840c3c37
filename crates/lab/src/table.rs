//! Tables in Markdown.

/// Formats rows under a head; returns an empty text without rows.
pub(crate) fn table(head: &[String], rows: Vec<Vec<String>>) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let rule = "| --- ".repeat(head.len()) + "|\n";
    if rows.is_empty() {
        String::new()
    } else {
        line(head) + &rule + &rows.iter().map(|r| line(r)).collect::<String>()
    }
}

/// Returns each value once, in the order of first occurrence.
pub(crate) fn distinct<T: PartialEq>(values: impl Iterator<Item = T>) -> Vec<T> {
    let mut all = Vec::new();
    for value in values {
        if !all.contains(&value) {
            all.push(value);
        }
    }
    all
}
